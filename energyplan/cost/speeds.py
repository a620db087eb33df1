"""How fast an element may be driven, and how fast it is cheapest.

An element ``(x, y) = (ds, C dtheta)`` driven at the rate r (elements per second) has the tread
speeds ``r (x - y)`` and ``r (x + y)``.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from energyplan.errors import InvalidInputError
from energyplan.html import number
from energyplan.path import FloatArray
from energyplan.power import Sides
from energyplan.records import NO_NUMBER
from energyplan.vehicle import Vehicle

CHEAPEST: Final = "cheapest"
"""The speed where every motion is to be driven as slowly as is cheapest."""


class SpeedSearch(NamedTuple):
    """The search for the cheapest speeds."""

    unlimited: float = 1e6  # tread speed [m/s] beyond which a power limit is not looked for
    slowest: float = 0.05  # slowest tread speed, as a fraction of the vehicle's limit
    scan: int = 25  # rates tried before the best is refined
    parts: int = 8  # parts in which an interval is cut first, all at once
    cuts: int = 64  # how often it is cut, at least by half: 2^-60 is below what numbers resolve
    same: float = 1e-13  # part by which forces, and energies, may differ by rounding
    at_once: int = 1 << 18  # numbers in an array of rates to try
    zooms: int = 12  # rounds in which the best is enclosed
    tried: int = 5  # rates tried in each of them


_SEARCH = SpeedSearch()


def tread_speed(given: float | str | None, vehicle: Vehicle) -> float | None:
    """Return the tread speed that motions are priced and driven at, None for the cheapest.

    Where none is given it is the vehicle's driving speed, or as fast as its motors go; where
    neither is known, the cheapest.
    """
    if given is None:
        driving = vehicle.driving_speed
        return driving if np.isfinite(driving) else None
    return None if given == CHEAPEST else float(given)


def parse_speed(text: str | None, vehicle: Vehicle) -> float | Literal["cheapest"] | None:
    """Return the speed of an option, within what the vehicle can do."""
    if text is None:
        return None
    if text == CHEAPEST:
        return CHEAPEST
    try:
        speed = float(text)
    except NO_NUMBER:
        speed = np.nan
    if not 0 < speed < np.inf:
        raise InvalidInputError(
            f"speed {text!r} is neither metres per second > 0 nor {CHEAPEST!r}; write it like 0.6"
        )
    top = number(vehicle.motor.speed)  # as it is printed, which may be rounded up
    if speed > max(vehicle.motor.speed, float(top)):
        raise InvalidInputError(
            f"speed {text} m/s is more than the treads of {vehicle.name} can do; give "
            f"{top} m/s at most"
        )
    return min(speed, vehicle.motor.speed)


def admissible_rate(
    x: FloatArray,
    y: FloatArray,
    vehicle: Vehicle,
    forces: Callable[[FloatArray, FloatArray, FloatArray], Sides],
    fastest: float = np.inf,
) -> FloatArray:
    """Return the largest rate within the limits of tread speed, yaw rate and motor power."""
    motor = vehicle.motor
    with np.errstate(divide="ignore"):
        limit = np.minimum(
            min(motor.speed, fastest) / (np.abs(x) + np.abs(y)),
            vehicle.max_yaw_rate * vehicle.icr.half_track / np.abs(y),
        )
    if not (np.isfinite(motor.continuous_power) or np.isfinite(motor.regeneration)):
        return limit

    def powers(force: Sides, x: FloatArray, y: FloatArray, rate: FloatArray) -> list[FloatArray]:
        left, right = force.left * rate * (x - y), force.right * rate * (x + y)
        return [np.maximum(left, right), -np.minimum(left, right)]

    def used(drawn: FloatArray, returned: FloatArray) -> FloatArray:
        parts = ((drawn, motor.continuous_power), (returned, motor.regeneration))
        left, right = (_relative(value, (1.0 + 1e-12) * most) for value, most in parts)
        return np.asarray(np.maximum(left, right))

    high = np.minimum(limit, _SEARCH.unlimited / (np.abs(x) + np.abs(y)))
    force = forces(x, y, high)
    drawn, returned = powers(force, x, y, high)
    bad = np.logical_not(used(drawn, returned) <= 1)
    if not np.any(bad):
        return limit
    limit = np.array(limit)
    x, y, high, drawn, returned, left, right = (
        np.broadcast_to(part, limit.shape)[bad]
        for part in (x, y, high, drawn, returned, force.left, force.right)
    )
    # power rises with speed, so the limit is where it is first reached: in proportion, where
    # forces are the same at any speed
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.fmin(
            np.where(drawn > 0, motor.continuous_power / drawn, np.inf),
            np.where(returned > 0, motor.regeneration / returned, np.inf),
        )
    found = high * share
    other = forces(x, y, found)
    moved = ~(
        np.isclose(other.left, left, rtol=_SEARCH.same, atol=0.0)
        & np.isclose(other.right, right, rtol=_SEARCH.same, atol=0.0)
    )
    if np.any(moved):
        x, y, high = x[moved], y[moved], high[moved]

        def use(rate: FloatArray) -> FloatArray:
            return used(*powers(forces(x, y, rate), x, y, rate))

        found[moved] = last_within(use, np.zeros(len(high)), high)
    limit[bad] = found
    return limit


def _relative(value: FloatArray, limit: float) -> FloatArray:
    """Return a value over its limit; over a limit of zero, infinite where it is positive."""
    if limit > 0:
        return np.asarray(value / limit)
    return np.where(value > 0, np.inf, 0.0)


def last_within(
    use: Callable[[FloatArray], FloatArray], low: FloatArray, high: FloatArray
) -> FloatArray:
    """Return the largest values up to which all that are tried are within limits."""
    parts = np.arange(1, _SEARCH.parts).reshape(-1, *[1] * np.ndim(low)) / _SEARCH.parts
    cuts = low + (high - low) * parts
    below, above = np.full(np.shape(low), np.nan), use(high[None])[0]
    for _ in range(_SEARCH.cuts):
        used = use(cuts)
        first = np.logical_and.accumulate(~(used > 1), axis=0).sum(axis=0, keepdims=True)
        going = high - low > 2 * np.spacing(high)
        edges = np.concatenate([low[None], cuts, high[None]])
        uses = np.concatenate([below[None], used, above[None]])
        (low, below), (high, above) = (
            [
                np.where(going, np.take_along_axis(table, first + end, axis=0)[0], former)
                for table, former in zip((edges, uses), formers, strict=True)
            ]
            for end, formers in enumerate(((low, below), (high, above)))
        )
        width = high - low
        if not np.any(width > 2 * np.spacing(high)):
            break
        # where a straight line between both ends says, close on either side of it, and half-way
        with np.errstate(divide="ignore", invalid="ignore"):
            share = (1.0 - below) / (above - below)
            guess = low + width * np.where((share >= 0) & (share <= 1), share, 0.5)
            near = np.fmax(np.minimum(0.25, width / high) * width, 8 * np.spacing(high))
        cuts = np.sort(
            [np.fmax(guess - near, low), low + 0.5 * width, np.fmin(guess + near, high)], axis=0
        )
    return low


def slowest_rate(x: FloatArray, y: FloatArray, limit: FloatArray, vehicle: Vehicle) -> FloatArray:
    """Return the slowest rate [1/s] to try.

    A model whose energy falls with speed all the way, because time costs nothing in it, would have
    the robot stand still; it is driven at a twentieth of its speed limit instead.
    """
    top = vehicle.motor.speed
    if not np.isfinite(top):
        return np.asarray(_SEARCH.slowest * limit)
    return np.asarray(np.minimum(limit, _SEARCH.slowest * top / (np.abs(x) + np.abs(y))))


def cheapest_rate(
    slowest: FloatArray,
    limit: FloatArray,
    energy: Callable[[FloatArray], FloatArray],
    scan: int = _SEARCH.scan,
) -> FloatArray:
    """Return the rate of least energy between `slowest` and `limit`."""
    ratio = (limit / slowest) ** (1.0 / (scan - 1))
    best = np.full(limit.shape, np.inf)
    place = np.zeros(limit.shape, int)
    steps = np.arange(scan).reshape(-1, *[1] * limit.ndim)

    def same(value: FloatArray, least: FloatArray) -> NDArray[np.bool_]:
        return np.asarray(value <= least + _SEARCH.same * np.abs(least))

    for some in np.array_split(steps, np.ceil(scan * limit.size / _SEARCH.at_once) or 1):
        values = energy(slowest * ratio**some)
        for k, value in zip(some.flat, values, strict=True):
            place = np.where(same(value, best), k, place)
            best = np.minimum(value, best)
    low = slowest * ratio ** np.maximum(place - 1, 0)
    high = slowest * ratio ** np.minimum(place + 1, scan - 1)
    parts = np.arange(1, _SEARCH.tried + 1).reshape(-1, *[1] * limit.ndim) / (_SEARCH.tried + 1)
    for _ in range(_SEARCH.zooms):
        gap = high - low
        values = energy(low + gap * parts)
        last = _SEARCH.tried - 1 - np.argmax(same(values, values.min(axis=0))[::-1], axis=0)
        low = low + gap * (last / (_SEARCH.tried + 1))
        high = low + gap * (2 / (_SEARCH.tried + 1))
    rate = 0.5 * (low + high)
    rate = np.where(same(energy(rate), energy(slowest)), rate, slowest)
    return np.where(same(energy(limit), energy(rate)), limit, rate)
