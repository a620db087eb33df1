"""Smooth terms of one channel, for what no entry of the catalogue explains (private).

Such a term has a carrier, which says what scales with the channel (power, the traction resistance
of both sides, or the slip moment), and a piecewise linear shape over knots of the channel.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import numpy as np

from energyplan.errors import UnknownNameError
from energyplan.motion import CHANNELS, Motion
from energyplan.path import FloatArray
from energyplan.power import Sides, Term, tread_forces
from energyplan.vehicle import Vehicle

CARRIERS = {"power": "W", "traction": "N", "slip": "N m"}
"""What may scale with a channel, and the unit of the shape."""


class Described(NamedTuple):
    """A channel or signal in words: its name, and its unit."""

    name: str
    unit: str

    def __str__(self) -> str:
        return f"{self.name} [{self.unit}]"


DERIVED = {
    "v": Described("forward speed", "m/s"),
    "omega": Described("yaw rate", "rad/s"),
    "curvature": Described("curvature", "1/m"),
}
"""Signals that every motion has beside its channels."""


_PLACE = "place_"


def place(x: float, y: float) -> str:
    """Return the name of the signal that is the distance from a place [m]."""
    return f"{_PLACE}{x:.3g}_{y:.3g}"


def described(name: str) -> Described:
    """Return a channel, or a signal derived from the tread speeds, in words.

    Examples
    --------
    >>> str(described("omega")), str(described("slope"))
    ('yaw rate [rad/s]', 'ground slope along the heading [rad]')
    """
    if name.startswith(_PLACE):
        x, _, y = name.removeprefix(_PLACE).partition("_")
        return Described(f"distance from ({x} m, {y} m)", "m")
    if name in DERIVED:
        return DERIVED[name]
    words, _, symbol = CHANNELS.get(name, "").partition("[")
    return Described(words.partition(",")[0].strip() or name, symbol.rstrip("]") or "its own unit")


def _is_known(motion: Motion, name: str) -> bool:
    if name.startswith(_PLACE):
        return {"x", "y"} <= set(motion.channels)
    return name in motion.channels or name in DERIVED


def signal(motion: Motion, name: str) -> FloatArray:
    """Return a channel or a signal derived from the motion; zero where it is not known.

    Parameters
    ----------
    motion : Motion, shape (...)
        The motion.
    name : str
        A channel, one of `DERIVED` (curvature is limited to 20 per metre), or a name that `place`
        gives.

    Returns
    -------
    ndarray, shape (...)
        The signal.
    """
    if name == "v":
        return motion.v
    if name == "omega":
        return motion.omega
    if name == "curvature":
        speed = np.where(np.abs(motion.v) > 1e-3, motion.v, 1e-3)
        return np.clip(motion.omega / speed, -20.0, 20.0)
    if name.startswith(_PLACE) and _is_known(motion, name):
        x, _, y = name.removeprefix(_PLACE).partition("_")
        return np.hypot(motion.channels["x"] - float(x), motion.channels["y"] - float(y))
    return motion.channels.get(name, np.zeros(motion.shape))


def carry(motion: Motion, vehicle: Vehicle, carrier: str, shape: FloatArray) -> Sides | FloatArray:
    """Return a shape as the force or power of its carrier."""
    if carrier == "power":
        return shape
    if carrier == "traction":
        return Sides(shape * np.sign(motion.v_left), shape * np.sign(motion.v_right))
    return tread_forces(motion, moment=shape * np.sign(motion.omega))


def _empirical(
    motion: Motion, vehicle: Vehicle, *, channel: str, carrier: str, **params: float
) -> Sides | FloatArray:
    count = sum(key.startswith("x") for key in params)
    knots = [params[f"x{k}"] for k in range(count)]
    values = [params[f"y{k}"] for k in range(count)]
    shape = np.zeros(motion.shape)
    if count and _is_known(motion, channel):
        shape = np.interp(signal(motion, channel), knots, values)
    return carry(motion, vehicle, carrier, shape)


def empirical_term(name: str, knots: Sequence[float] = (), values: Sequence[float] = ()) -> Term:
    """Return the empirical term of that name.

    Parameters
    ----------
    name : str
        ``empirical_<carrier>_<channel>``.
    knots, values : sequence of float
        Channel at the knots, and the shape there in the carrier's unit.

    Returns
    -------
    Term
        A term whose coefficient 1 gives that shape.

    Raises
    ------
    UnknownNameError
        If the name has no such form.

    Examples
    --------
    >>> made = empirical_term("empirical_traction_v", knots=[0.0, 1.0], values=[0.0, 30.0])
    >>> made.name, made.params["y1"]
    ('empirical_traction_v', 30.0)
    """
    head, _, rest = name.partition("_")
    carrier, _, channel = rest.partition("_")
    if head != "empirical" or carrier not in CARRIERS or not channel:
        known = [f"empirical_{carrier}_CHANNEL" for carrier in CARRIERS]
        raise UnknownNameError("empirical term", name, known)
    params = {f"x{k}": float(x) for k, x in enumerate(knots)}
    params |= {f"y{k}": float(y) for k, y in enumerate(values)}
    return Term(
        name, "s", "1", "power" if carrier == "power" else "force",
        partial(_empirical, channel=channel, carrier=carrier), params,
        meaning=f"empirical: {carrier} as a smooth function of {channel}",
    )  # fmt: skip
