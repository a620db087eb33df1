"""A drive held against all limits, and how much faster or slower it may be driven."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from energyplan.limits.drive import Drive, Pieces
from energyplan.limits.motor import ROUNDING, Limit, Limits
from energyplan.limits.motor_kernels import intervals, shortest_window, window_mean
from energyplan.path import FloatArray
from energyplan.vehicle import MotorLimits


class Excess(NamedTuple):
    """An interval in which a bound is exceeded."""

    bound: Limit
    start: float
    end: float
    peak: float


class Peak(NamedTuple):
    """Where a bound is used most: time, value, and value over limit."""

    bound: Limit
    t: float
    value: float
    use: float


class Thermal(NamedTuple):
    """Shaft power that the left and the right side draw over time, shape (2, n)."""

    t: FloatArray
    drawn: FloatArray

    def scale(self, motor: MotorLimits) -> float:
        """Largest factor on the speed within the continuous power, if forces do not change."""
        if not np.isfinite(motor.continuous_power) or not self.drawn.any():
            return np.inf
        budget = motor.continuous_power * motor.thermal_time
        if budget <= 0:
            return motor.continuous_power / float(self.drawn.max())
        shortest = min(shortest_window(self.t, power, budget) for power in self.drawn)
        return shortest / motor.thermal_time


class PieceLoads(NamedTuple):
    """Shaft power of each side, power under the model [W], and what each bound limits."""

    left: FloatArray
    right: FloatArray
    power: FloatArray
    values: list[FloatArray]


class Survey(NamedTuple):
    """What one pass finds."""

    peaks: list[Peak]
    excesses: list[Excess]
    energy: float
    thermal: Thermal

    @property
    def hot(self) -> bool:
        """Whether a thermal window exceeds the continuous power."""
        return any(excess.bound.kind == "continuous_power" for excess in self.excesses)

    @property
    def warmth(self) -> float:
        """Power in the warmest thermal window, over the continuous power."""
        kind = "continuous_power"
        return max((peak.use for peak in self.peaks if peak.bound.kind == kind), default=0.0)


@dataclass(frozen=True)
class LimitedDrive:
    """A drive with the limits that hold on it."""

    drive: Drive
    limits: Limits

    @property
    def rated(self) -> list[Limit]:
        """The bounds that need more than one instant: acceleration and continuous power."""
        motor = self.limits.motor
        bounds = (
            Limit(kind, side, limit)
            for kind, limit in (
                ("acceleration", motor.acceleration),
                ("continuous_power", motor.continuous_power),
            )
            for side in ("left", "right")
        )
        return [bound for bound in bounds if np.isfinite(bound.limit)]

    def survey(self, scale: float = 1.0) -> Survey:
        """Evaluate every limit at the beginning, the middle and the end of every piece."""
        drive = self.drive
        watch = _Watch()
        energy = 0.0
        times: list[FloatArray] = []
        drawn: list[FloatArray] = []
        for k in range(drive.block_count):
            pieces = drive.pieces(k)
            t = drive.times(pieces, scale).reshape(-1)
            loads = self.loads(pieces, scale)
            for bound, value in zip(self.limits.bounds, loads.values, strict=True):
                watch.see(bound, t, value.reshape(-1))
            if drive.ground.has_speed_limits:
                limits, speeds = drive.speed_limits(pieces), drive.speeds(pieces, scale)
                for limit in np.unique(limits[np.isfinite(limits)]):
                    bound = Limit("ground_speed", "both", float(limit))
                    watch.see(bound, t, np.where(limits == limit, speeds, 0.0).reshape(-1))
            self._see_acceleration(watch, pieces, scale)
            if np.isfinite(self.limits.motor.continuous_power):
                sides = np.stack([loads.left, loads.right])
                drawn.append(np.maximum(sides, 0.0).reshape(2, -1))
                times.append(t)
            energy += sum(
                float(mean @ drive.widths(some, scale))
                for some, mean in drive.refined(pieces, loads.power, scale)
            )
        thermal = Thermal(np.zeros(0), np.zeros((2, 0)))
        if drawn:
            thermal = Thermal(np.concatenate(times), np.concatenate(drawn, axis=1))
            window = self.limits.motor.thermal_time
            for bound, power in zip(self.rated[-2:], thermal.drawn, strict=True):
                mean = window_mean(thermal.t, power, window) if window > 0 else power
                watch.see(bound, thermal.t, mean)
        return Survey(list(watch.peaks.values()), watch.excesses, energy, thermal)

    def loads(self, pieces: Pieces, scale: float) -> PieceLoads:
        """Evaluate what pieces ask for, ground by ground; arrays of shape (m, 3)."""
        count = len(pieces.interval)
        out = np.empty((3 + len(self.limits.bounds), count, 3))  # for more than one ground
        for part in self.drive.parts(pieces, scale):
            found = self.limits.loads(part.model, part.motion)
            # A model of forces alone spends exactly its shaft power.
            lossless = all(term.kind == "force" for term in part.model.terms)
            power = found.left + found.right if lossless else part.model.power(part.motion)
            if len(part.which) == count:
                return PieceLoads(found.left, found.right, power, found.values)
            for row, value in zip(
                out, (found.left, found.right, power, *found.values), strict=True
            ):
                row[part.which] = value
        return PieceLoads(out[0], out[1], out[2], list(out[3:]))

    def _see_acceleration(self, watch: _Watch, pieces: Pieces, scale: float) -> None:
        if not np.isfinite(self.limits.motor.acceleration):
            return
        path, icr = self.drive.trajectory, self.drive.ground.model.vehicle.icr
        part = slice(int(pieces.interval[0]), int(pieces.interval[-1]) + 2)
        step = np.diff(path.t[part])
        t = path.t[0] + (path.t[part] - path.t[0]) / scale
        v, omega = path.v[part], path.omega[part]
        for bound, speed in zip(
            self.rated[:2], (v - icr.left * omega, v + icr.right * omega), strict=True
        ):
            rate = scale**2 * np.abs(np.diff(speed)) / step
            watch.see(bound, np.repeat(t, 2)[1:-1], np.repeat(rate, 2))


class _Watch:
    """Collects peaks and excesses, joining intervals that meet where two blocks do."""

    def __init__(self) -> None:
        self.peaks: dict[Limit, Peak] = {}
        self.excesses: list[Excess] = []
        self._latest: dict[Limit, int] = {}

    def see(self, bound: Limit, t: FloatArray, value: FloatArray) -> None:
        k = int(np.argmax(value))
        top = float(value[k])
        if bound not in self.peaks or top > self.peaks[bound].value:
            self.peaks[bound] = Peak(bound, float(t[k]), top, _use(top, bound.limit))
        tolerance = ROUNDING * max(bound.limit, 1.0)
        if top <= bound.limit + tolerance:
            return
        for start, end, peak, _ in zip(*intervals(t, value, bound.limit, tolerance), strict=True):
            last = self._latest.get(bound)
            if last is not None and self.excesses[last].end == start:
                old = self.excesses[last]
                self.excesses[last] = Excess(bound, old.start, float(end), max(old.peak, peak))
            else:
                self._latest[bound] = len(self.excesses)
                self.excesses.append(Excess(bound, float(start), float(end), float(peak)))


def _use(value: float, limit: float) -> float:
    if limit > 0:
        return value / limit
    return np.inf if value > ROUNDING else 0.0


SLOWEST, FASTEST, STEP = 1e-4, 1e6, 1.1
"""Range of speed scales that the search tries, and the ratio of neighbouring ones."""

KINEMATIC = {
    "speed": 1, "ground_speed": 1, "yaw_rate": 1, "acceleration": 2, "lateral_acceleration": 2,
}  # fmt: skip
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
        factor = min(
            _closed_form(survey, KINEMATIC | STATIC), survey.thermal.scale(drive.limits.motor)
        )
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


def _search(drive: LimitedDrive, ceiling: float) -> float:
    """Look downwards for the first feasible scale, then bisect towards the last infeasible one."""
    if ceiling == 0:
        return 0.0
    bounded = np.isfinite(ceiling)
    high = ceiling if bounded else FASTEST

    def exceeded(scale: float) -> bool:
        return max(peak.use for peak in drive.survey(scale).peaks) > 1 + ROUNDING

    if not exceeded(high):
        return high if bounded else np.inf
    low = _below(high)
    while exceeded(low):
        high, low = low, _below(low)
        if low < SLOWEST:
            return 0.0
    while high / low > 1 + ROUNDING:
        middle = np.sqrt(low * high)
        if exceeded(middle):
            high = middle
        else:
            low = middle
    return float(low)


def _below(scale: float) -> float:
    """Return the next scale to try; the trajectory as it is always is one."""
    lower = scale / STEP
    return 1.0 if lower < 1.0 < scale else lower


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
        if factor < 1.00005:
            return "some limit is reached: the robot can drive this path no faster"
        return f"every limit holds up to {factor:.4g} times the speed"
    digits = 4 if factor < 0.999 else 7
    return f"too fast: {what}; feasible at {factor:.{digits}g} times the speed"
