"""Which column of a file is which channel, and in which unit."""

from __future__ import annotations

import re
from collections.abc import Mapping
from math import isfinite, pi
from typing import NamedTuple

import numpy as np

from energyplan.errors import DriveLogError
from energyplan.logs.tables import Table
from energyplan.path import FloatArray


class Scale(NamedTuple):
    """SI value = factor times reading, plus offset."""

    factor: float = 1.0
    offset: float = 0.0


_TIME = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0}
_LENGTH = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "ft": 0.3048}
_SPEED = {"m/s": 1.0, "cm/s": 1e-2, "mm/s": 1e-3, "km/h": 1 / 3.6, "mph": 0.44704}
_ANGLE = {"rad": 1.0, "deg": pi / 180}
_RATE = {"rad/s": 1.0, "deg/s": pi / 180, "rpm": pi / 30}
_POWER = {"W": 1.0, "kW": 1e3, "mW": 1e-3}

UNITS: dict[str, dict[str, float]] = {
    "t": _TIME,
    "x": _LENGTH,
    "y": _LENGTH,
    "v_left": _SPEED,
    "v_right": _SPEED,
    "p_left": _POWER,
    "p_right": _POWER,
    "power": _POWER,
    "voltage": {"V": 1.0, "mV": 1e-3},
    "current": {"A": 1.0, "mA": 1e-3},
    "yaw": _ANGLE,
    "slope": _ANGLE,
    "yaw_rate": _RATE,
    "accel_x": {"m/s^2": 1.0, "g": 9.80665},
    "temperature": {"degC": 1.0, "K": 1.0, "degF": 5 / 9},
    "payload": {"kg": 1.0, "lb": 0.45359237},
}
"""Units by channel; the first is the one of the library."""
_OFFSETS = {"K": -273.15, "degF": -160 / 9}

_ENTRY = re.compile(r"\s*([^=\[\]]+?)\s*=\s*([^\[\]]+?)\s*(?:\[\s*([^\[\]]*?)\s*\])?\s*\Z")


class Column(NamedTuple):
    """A column of a file that serves as a channel.

    Parameters
    ----------
    source : str
        Name of the column.
    scale : Scale
        Conversion to the library's unit.
    """

    source: str
    scale: Scale = Scale()


def _scale(channel: str, unit: str) -> Scale:
    """Conversion from `unit`: a unit's name, a minus before it, or ``*`` and a factor."""
    sign = -1.0 if unit.startswith("-") else 1.0
    bare = unit.lstrip("-").strip()
    if bare.startswith("*"):
        try:
            factor = float(bare[1:])
        except ValueError:
            factor = float("nan")
        if not isfinite(factor) or factor == 0:
            raise DriveLogError(f"{channel}: [{unit}] is no factor; write one such as [*0.165]")
        return Scale(sign * factor)
    known = UNITS.get(channel)
    if known is None:
        raise DriveLogError(
            f"{channel}: the unit of a channel of your own is yours; leave [{unit}] out, or give a "
            "factor such as [*0.001]"
        )
    if bare not in known:
        raise DriveLogError(
            f"{channel} cannot be in [{unit}]; it can be in {', '.join(known)}, with a minus "
            "before it where the sign is opposite, or give a factor such as [*0.001]"
        )
    return Scale(sign * known[bare], _OFFSETS.get(bare, 0.0))


def parse_columns(columns: str | Mapping[str, str] | None) -> dict[str, Column]:
    """Read which column serves as which channel.

    Parameters
    ----------
    columns : str or mapping of str to str, optional
        ``"v_left=velL,yaw=heading[deg]"``, or ``{"v_left": "velL", "yaw": "heading[deg]"}``. In
        brackets stands the unit where it is not the library's, with a minus before it where the
        sign is opposite (``current=i[-A]``), or a factor (``v_left=wheel_rate[*0.165]``).

    Returns
    -------
    dict of str to Column
        The columns by channel.

    Raises
    ------
    DriveLogError
        If an entry cannot be read, names a channel twice, or gives a unit that does not fit.

    Examples
    --------
    >>> parse_columns("yaw=heading[deg]")["yaw"].source
    'heading'
    """
    if columns is None:
        return {}
    if isinstance(columns, str):
        entries = [entry for entry in columns.split(",") if entry.strip()]
    else:
        entries = [f"{channel}={source}" for channel, source in columns.items()]
    found: dict[str, Column] = {}
    for entry in entries:
        match = _ENTRY.match(entry)
        if match is None:
            raise DriveLogError(
                f"column mapping {entry.strip()!r} cannot be read; write CHANNEL=COLUMN or "
                "CHANNEL=COLUMN[UNIT], such as yaw=heading[deg]"
            )
        channel, source, unit = match.groups()
        if channel in found:
            raise DriveLogError(f"column mapping names the channel {channel!r} twice; drop one")
        found[channel] = Column(source, _scale(channel, unit) if unit else Scale())
    return found


class Chosen(NamedTuple):
    """Channels taken from a table, and its columns of text that nobody asked for."""

    channels: dict[str, FloatArray]
    unread: list[str]


def choose_columns(table: Table, columns: str | Mapping[str, str] | None) -> Chosen:
    """Take a log's channels from a table.

    Parameters
    ----------
    table : Table
        The table.
    columns : str or mapping of str to str, optional
        As in `parse_columns`; columns that bear a channel's name, and any others of numbers, need
        no mention.

    Returns
    -------
    Chosen
        The channels in the library's units.

    Raises
    ------
    DriveLogError
        If the mapping is malformed, or a column is missing or holds text.
    """
    wanted = parse_columns(columns)
    taken = {column.source for column in wanted.values()}
    for name in (*table.columns, *table.text):
        useful = name in table.columns or name in UNITS
        if useful and name not in wanted and name not in taken:
            wanted[name] = Column(name)
    with np.errstate(over="ignore"):  # what overflows is out of range in any unit
        channels = {
            channel: table.column(column.source) * column.scale.factor + column.scale.offset
            for channel, column in wanted.items()
        }
    return Chosen(channels, [name for name in table.text if name not in channels])
