"""How fast an element may be driven, and how fast it is cheapest.

An element ``(x, y) = (ds, C dtheta)`` driven at the rate r (elements per second) has the tread
speeds ``r (x - y)`` and ``r (x + y)``.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from energyplan.path import FloatArray
from energyplan.power import Sides
from energyplan.vehicle import Vehicle

_UNLIMITED = 1e6  # tread speed [m/s] beyond which a power limit is not looked for
_SLOWEST = 10**-2.5  # slowest rate tried, as a fraction of the admissible one
_INVERSE_GOLDEN = 0.5 * (5**0.5 - 1)


def admissible_rate(
    x: FloatArray, y: FloatArray, vehicle: Vehicle, forces: Callable[[FloatArray], Sides]
) -> FloatArray:
    """Return the largest rate within the limits of tread speed, yaw rate and motor power.

    Parameters
    ----------
    x, y : ndarray, shape (...)
        Elements [m].
    vehicle : Vehicle
        Its motor's speed, continuous power and regeneration, and its yaw rate, are the limits.
    forces : callable
        Tread forces [N] at given rates.

    Returns
    -------
    ndarray, shape (...)
        Rates [1/s], infinite where there is no limit.
    """
    motor = vehicle.motor
    with np.errstate(divide="ignore"):
        limit = np.minimum(
            motor.speed / (np.abs(x) + np.abs(y)),
            vehicle.max_yaw_rate * vehicle.icr.half_track / np.abs(y),
        )
    if not (np.isfinite(motor.continuous_power) or np.isfinite(motor.regeneration)):
        return limit

    def within(rate: FloatArray) -> FloatArray:
        force = forces(rate)
        left, right = force.left * rate * (x - y), force.right * rate * (x + y)
        most, least = np.maximum(left, right), np.minimum(left, right)
        slack = 1.0 + 1e-12
        return np.asarray(
            (most <= slack * motor.continuous_power) & (least >= -slack * motor.regeneration)
        )

    high = np.minimum(limit, _UNLIMITED / (np.abs(x) + np.abs(y)))
    good = within(high)
    low = np.where(good, high, 0.0)
    if np.all(good):
        return limit
    for _ in range(60):  # power rises with speed, so the limit is where it is first reached
        middle = 0.5 * (low + high)
        fine = within(middle)
        low, high = np.where(fine, middle, low), np.where(fine, high, middle)
    return np.where(good, limit, low)


def cheapest_rate(limit: FloatArray, energy: Callable[[FloatArray], FloatArray]) -> FloatArray:
    """Return the rate of least energy at or below `limit`.

    Parameters
    ----------
    limit : ndarray, shape (...)
        Largest rates [1/s], finite.
    energy : callable
        Energy [J] of the elements at given rates.

    Returns
    -------
    ndarray, shape (...)
        Rates [1/s]: the least of a scan over the admissible range, refined by golden section.
    """
    scan = np.geomspace(_SLOWEST, 1.0, 33)
    best = np.full(limit.shape, np.inf)
    place = np.zeros(limit.shape, int)
    for k, fraction in enumerate(scan):
        value = energy(limit * fraction)
        better = value <= best
        best, place = np.where(better, value, best), np.where(better, k, place)
    low = limit * scan[np.maximum(place - 1, 0)]
    high = limit * scan[np.minimum(place + 1, len(scan) - 1)]
    for _ in range(45):
        gap = _INVERSE_GOLDEN * (high - low)
        down = energy(high - gap) < energy(low + gap)
        low, high = np.where(down, low, high - gap), np.where(down, low + gap, high)
    middle = 0.5 * (low + high)
    return np.where(energy(limit) <= energy(middle), limit, middle)
