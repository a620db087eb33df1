"""Amounts as people write them: a number with a unit, or one in SI units."""

from __future__ import annotations

import re
from math import radians
from typing import Any

UNITS: dict[str, dict[str, float]] = {
    "time": {"s": 1.0, "min": 60.0, "h": 3600.0},
    "power": {"W": 1.0, "kW": 1e3},
    "charge": {"C": 1.0, "Ah": 3600.0},
    "energy": {"J": 1.0, "Wh": 3600.0, "kWh": 3.6e6},
    "mass": {"kg": 1.0, "g": 1e-3},
    "fraction": {"%": 0.01},
    "speed": {"m/s": 1.0, "km/h": 1 / 3.6},
    "temperature": {"C": 1.0},
    "angle": {"rad": 1.0, "deg": radians(1.0)},
}
_AMOUNT = re.compile(r"\s*([-+]?[0-9.]+(?:[eE][-+]?[0-9]+)?)\s*([A-Za-z/%]*)\s*")


def amount(kind: str, value: Any) -> Any:
    """Read ``5 min``, ``20 %`` or a plain number in SI units.

    Parameters
    ----------
    kind : str
        What it is an amount of: a key of `UNITS`.
    value : object
        What a file or a person gave.

    Returns
    -------
    object
        The number in SI units; what is no number with a unit comes back as it is.

    Raises
    ------
    ValueError
        If it has a unit of something else.

    Examples
    --------
    >>> amount("time", "5 min"), amount("fraction", 0.2)
    (300.0, 0.2)
    """
    if not isinstance(value, str):
        return value
    found = _AMOUNT.fullmatch(value)
    units = UNITS[kind]
    if value == "inf" or found is None:
        return value
    if found[2] and found[2] not in units:
        raise ValueError(f"the unit of a {kind} is one of {', '.join(units)}, or none for SI")
    return float(found[1]) * units.get(found[2], 1.0)
