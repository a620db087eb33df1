"""How much faster or slower a trajectory may be driven: the search behind `max_speed_scale`."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from energyplan.limits._check import LimitedDrive, Peak, Survey
from energyplan.limits.motor import ROUNDING
from energyplan.limits.motor_kernels import shortest_window

SLOWEST, FASTEST, STEP = 1e-4, 1e6, 1.1
"""Range of speed scales that the search tries, and the ratio of neighbouring ones."""

KINEMATIC = {"speed": 1, "yaw_rate": 1, "acceleration": 2, "lateral_acceleration": 2}
"""Power of the speed scale with which a limited quantity grows, whatever the model."""

STATIC = {"peak_power": 1, "regeneration": 1, "force": 0, "battery_power": 1, "battery_return": 1}
"""The same for a model whose forces do not depend on speed."""


class SpeedScale(NamedTuple):
    """Largest feasible factor on the speed, and one sentence for the user."""

    factor: float
    reason: str


def largest_scale(drive: LimitedDrive) -> SpeedScale:
    """Return the largest feasible speed scale and say what limits it."""
    survey = drive.survey()
    if not survey.peaks:
        return SpeedScale(np.inf, "nothing limits the speed")
    if _is_static(drive):
        factor = min(_closed_form(survey, KINEMATIC | STATIC), _thermal(drive, survey))
        slowest = survey
    else:
        factor = _search(drive, _closed_form(survey, KINEMATIC))
        slowest = survey if factor > 0 else drive.survey(SLOWEST)
    return SpeedScale(factor, _reason(factor, survey.peaks, slowest.peaks))


def _is_static(drive: LimitedDrive) -> bool:
    """Tell whether every limited quantity grows with the pure powers of `STATIC`."""
    for k in range(drive.drive.block_count):
        pieces = drive.drive.pieces(k)
        now = drive.loads(pieces, 1.0)
        for scale in (0.5, 2.0):
            then = drive.loads(pieces, scale)
            pairs = [(now.left * scale, then.left), (now.right * scale, then.right)]
            for bound, a, b in zip(drive.limits.bounds, now.values, then.values, strict=True):
                if bound.kind in STATIC:
                    pairs.append((a * scale ** STATIC[bound.kind], b))
            for expected, found in pairs:
                size = float(np.max(np.abs(expected)))
                if np.max(np.abs(expected - found)) > 1e-12 * size:
                    return False
    return True


def _closed_form(survey: Survey, exponents: dict[str, int]) -> float:
    """Return the scale at which the first of the quantities with known growth meets its limit."""
    factor = np.inf
    for peak in survey.peaks:
        exponent = exponents.get(peak.bound.kind)
        if exponent is None or peak.value <= 0:
            continue
        ratio = peak.bound.limit / peak.value
        if exponent:
            factor = min(factor, ratio ** (1 / exponent))
        elif ratio < 1 - ROUNDING:
            factor = 0.0
    return float(factor)


def _thermal(drive: LimitedDrive, survey: Survey) -> float:
    motor = drive.limits.motor
    if not np.isfinite(motor.continuous_power):
        return np.inf
    window, (t, drawn) = motor.thermal_time, survey.thermal
    top = float(drawn.max())
    if top <= 0:
        return np.inf
    budget = motor.continuous_power * window
    if budget <= 0:
        return motor.continuous_power / top
    return min(shortest_window(t, power, budget) for power in drawn) / window


def _search(drive: LimitedDrive, ceiling: float) -> float:
    """Look downwards for the first feasible scale, then bisect towards the last infeasible one."""
    if ceiling == 0:
        return 0.0
    bounded = np.isfinite(ceiling)
    high = ceiling if bounded else FASTEST
    order = _Order(drive)
    if not order.exceeded(high):
        return high if bounded else np.inf
    low = _below(high)
    while order.exceeded(low):
        high, low = low, _below(low)
        if low < SLOWEST:
            return 0.0
    while high / low > 1 + ROUNDING:
        middle = np.sqrt(low * high)
        if order.exceeded(middle):
            high = middle
        else:
            low = middle
    return float(low)


def _below(scale: float) -> float:
    """Return the next scale to try; the trajectory as it is always is one."""
    lower = scale / STEP
    return 1.0 if lower < 1.0 < scale else lower


class _Order:
    """Tells whether a scale is infeasible, asking first the block that last said so."""

    def __init__(self, drive: LimitedDrive) -> None:
        self._drive = drive
        self._suspect = 0

    def exceeded(self, scale: float) -> bool:
        drive = self._drive
        if drive.use(self._suspect, scale) > 1 + ROUNDING:
            return True
        survey = drive.survey(scale)
        worst = max(survey.peaks, key=lambda peak: peak.use)
        if worst.use <= 1 + ROUNDING:
            return False
        self._suspect = drive.drive.block_at(worst.t, scale)
        return True


def _reason(factor: float, peaks: list[Peak], slowest: list[Peak]) -> str:
    if factor == np.inf:
        return "nothing limits the speed"
    worst = max(peaks if factor > 0 else slowest, key=lambda peak: peak.use)
    what = f"at {worst.t:.3g} s {worst.bound.describe(worst.value)}"
    if factor == 0:
        return (
            f"no speed is feasible: {what} however slowly the robot drives; it takes other "
            "ground, less load, another path or stronger motors"
        )
    if factor >= 1 - ROUNDING:
        return f"every limit holds up to {factor:.4g} times the speed"
    return f"too fast: {what}; feasible at {factor:.4g} times the speed"
