"""One pass of a drive through the power models against all limits."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from energyplan.limits.drive import Drive, Pieces
from energyplan.limits.motor import ROUNDING, Limit, Limits
from energyplan.limits.motor_kernels import intervals, window_mean
from energyplan.path import FloatArray


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

    def use(self, k: int, scale: float) -> float:
        """Return the largest load over limit in the k-th block, without what needs a past."""
        pieces = self.drive.pieces(k)
        return max(
            float(np.max(self.limits.use(part.model, part.motion)))
            for part in self.drive.parts(pieces, scale)
        )

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
        self.peaks: dict[tuple[str, str], Peak] = {}
        self.excesses: list[Excess] = []
        self._latest: dict[tuple[str, str], int] = {}

    def see(self, bound: Limit, t: FloatArray, value: FloatArray) -> None:
        key = bound.kind, bound.side
        k = int(np.argmax(value))
        top = float(value[k])
        if key not in self.peaks or top > self.peaks[key].value:
            self.peaks[key] = Peak(bound, float(t[k]), top, _use(top, bound.limit))
        tolerance = ROUNDING * max(bound.limit, 1.0)
        if top <= bound.limit + tolerance:
            return
        for start, end, peak, _ in zip(*intervals(t, value, bound.limit, tolerance), strict=True):
            last = self._latest.get(key)
            if last is not None and self.excesses[last].end == start:
                old = self.excesses[last]
                self.excesses[last] = Excess(bound, old.start, float(end), max(old.peak, peak))
            else:
                self._latest[key] = len(self.excesses)
                self.excesses.append(Excess(bound, float(start), float(end), float(peak)))


def _use(value: float, limit: float) -> float:
    if limit > 0:
        return value / limit
    return np.inf if value > ROUNDING else 0.0
