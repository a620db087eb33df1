"""Smooth terms of one channel, for what no entry of the catalogue explains (private).

Such a term has a carrier, which says what scales with the channel (power, the traction resistance
of both sides, the slip moment, the whole power of the forces, or a force along the ground's x or y
axis), and a piecewise linear shape over knots of the channel.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from functools import partial
from typing import Any, Literal, NamedTuple

import numpy as np

from energyplan.errors import UnknownNameError
from energyplan.motion import CHANNELS, Motion
from energyplan.path import FloatArray
from energyplan.power import Sides, Term, tread_forces
from energyplan.vehicle import Vehicle

CARRIERS = {"power": "W", "traction": "N", "slip": "N m", "whole": "1", "ground": "N"}
"""What may scale with a channel, and the unit of the shape."""

GROUND = {"x": 0.0, "y": 0.5 * np.pi}
"""Channels over which a force along the ground may change, and the direction of that force."""


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
    "since_start": Described("time since a tread started or turned round", "s"),
    "displacement": Described("distance from the start", "m"),
}
"""Signals that a motion has in addition to its channels."""

_NEEDS = {"since_start": {"t"}, "displacement": {"x", "y"}}
"""Channels of a drive that derived signals are worked out from, sample after sample."""

_SINCE = 2.0  # time after which a tread's start is long past [s]


def described(name: str) -> Described:
    """Return a channel, or a signal derived from the tread speeds, in words."""
    if name in DERIVED:
        return DERIVED[name]
    words, _, symbol = CHANNELS.get(name, "").partition("[")
    return Described(words.partition(",")[0].strip() or name, symbol.rstrip("]") or "its own unit")


def _is_known(motion: Motion, name: str) -> bool:
    if name in _NEEDS and name not in motion.channels:
        return _NEEDS[name] <= set(motion.channels) and len(motion.shape) == 1
    return name in motion.channels or name in DERIVED


def _since_start(motion: Motion) -> FloatArray:
    """Time since the last start or reversal of a tread; `_SINCE` at rest [s]."""
    t = motion.channels["t"]
    found = np.full(motion.shape, _SINCE)
    for speed in (motion.v_left, motion.v_right):
        way = np.sign(speed)
        reversals = np.concatenate([[False], (way[1:] != way[:-1]) & (way[1:] != 0)])
        last = np.maximum.accumulate(np.where(reversals, t, -np.inf))
        found = np.where(way != 0, np.minimum(found, t - last), found)
    return found


def signal(motion: Motion, name: str) -> FloatArray:
    """Return a channel or a signal derived from the motion; zero where it is not known."""
    if name == "v":
        return motion.v
    if name == "omega":
        return motion.omega
    if name == "curvature":
        speed = np.where(np.abs(motion.v) > 1e-3, motion.v, 1e-3)
        return np.clip(motion.omega / speed, -20.0, 20.0)
    if name in _NEEDS and name not in motion.channels:
        if not _is_known(motion, name):
            return np.zeros(motion.shape)
        if name == "since_start":
            return _since_start(motion)
        away = (motion.channels[axis] - motion.channels[axis][:1] for axis in ("x", "y"))
        return np.asarray(np.hypot(*away))
    return motion.channels.get(name, np.zeros(motion.shape))


def carries(carrier: str, name: str, known: Collection[str]) -> bool:
    """Return whether a carrier may scale with a channel, of a motion that has the `known` ones."""
    return carrier != "ground" or (name in GROUND and "yaw" in known)


def carry(
    motion: Motion,
    vehicle: Vehicle,
    carrier: str,
    channel: str,
    shape: FloatArray,
    forces: Sides | None = None,
) -> Sides | FloatArray:
    """Return a shape over a channel as the force or power of its carrier."""
    if carrier == "power":
        return shape
    if carrier == "traction":
        return Sides(shape * np.sign(motion.v_left), shape * np.sign(motion.v_right))
    if carrier == "slip":
        return tread_forces(motion, moment=shape * np.sign(motion.omega))
    if carrier == "ground":
        yaw = motion.channels.get("yaw")
        along = np.zeros(motion.shape) if yaw is None else np.cos(yaw - GROUND[channel])
        return tread_forces(motion, longitudinal=shape * along)
    if forces is None:
        return Sides(np.zeros(motion.shape), np.zeros(motion.shape))
    return Sides(shape * forces.left, shape * forces.right)


def _shape(motion: Motion, channel: str, params: Mapping[str, float]) -> FloatArray:
    count = sum(key.startswith("x") for key in params)
    knots = [params[f"x{k}"] for k in range(count)]
    values = [params[f"y{k}"] for k in range(count)]
    if not count or not _is_known(motion, channel):
        return np.zeros(motion.shape)
    return np.asarray(np.interp(signal(motion, channel), knots, values))


def _empirical(
    motion: Motion, vehicle: Vehicle, *, channel: str, carrier: str, **params: float
) -> Sides | FloatArray:
    return carry(motion, vehicle, carrier, channel, _shape(motion, channel, params))


def _empirical_whole(
    motion: Motion, vehicle: Vehicle, forces: Sides, *, channel: str, **params: float
) -> Sides:
    shape = _shape(motion, channel, params)
    more = Sides(shape * forces.left, shape * forces.right)
    return Sides(more.left * motion.v_left, more.right * motion.v_right)


def empirical_term(name: str, knots: Sequence[float] = (), values: Sequence[float] = ()) -> Term:
    """Return the term ``empirical_<carrier>_<channel>`` with its shape at some knots."""
    head, _, rest = name.partition("_")
    carrier, _, channel = rest.partition("_")
    if (
        head != "empirical"
        or not channel
        or carrier not in CARRIERS
        or not carries(carrier, channel, {"yaw"})
    ):
        known = [f"empirical_{carrier}_CHANNEL" for carrier in CARRIERS]
        raise UnknownNameError("empirical term", name, known)
    params = {f"x{k}": float(x) for k, x in enumerate(knots)}
    params |= {f"y{k}": float(y) for k, y in enumerate(values)}
    kind: Literal["force", "power", "loss"] = "force"
    function: Callable[..., Any] = partial(_empirical, channel=channel, carrier=carrier)
    if carrier == "power":
        kind = "power"
    elif carrier == "whole":
        kind, function = "loss", partial(_empirical_whole, channel=channel)
    return Term(
        name, "s", "1", kind, function, params,
        meaning=f"empirical: {carrier} as a smooth function of {channel}",
    )  # fmt: skip
