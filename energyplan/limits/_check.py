"""One pass of a trajectory through the power model against all limits, and the speed search.

The trajectory goes through the model in blocks that stay in the processor's cache; neighbouring
blocks share one sample, so that an interval between samples lies in exactly one block.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from energyplan.errors import InvalidInputError
from energyplan.limits.motor import ROUNDING, Bound, Limits, Loads
from energyplan.limits.motor_kernels import intervals, tread_motion, window_mean
from energyplan.motion import Motion
from energyplan.path import FloatArray, Trajectory
from energyplan.power import PowerModel

BLOCK = 16384
"""Samples per block."""


class Excess(NamedTuple):
    """An interval in which a bound is exceeded."""

    bound: Bound
    start: float
    end: float
    peak: float


class Peak(NamedTuple):
    """Where a bound is used most: time, value, and value over limit."""

    bound: Bound
    t: float
    value: float
    use: float


class Survey(NamedTuple):
    """What one pass finds."""

    peaks: list[Peak]
    excesses: list[Excess]
    energy: float
    drawn: tuple[FloatArray, FloatArray]


class Block(NamedTuple):
    """Samples [first, last) of a trajectory as a motion."""

    first: int
    last: int
    t: FloatArray
    motion: Motion


@dataclass(frozen=True)
class Drive:
    """A trajectory with the model that prices it and the limits that hold."""

    trajectory: Trajectory
    model: PowerModel
    limits: Limits
    channels: Mapping[str, ArrayLike]

    def __post_init__(self) -> None:
        wide = {}
        for name, value in self.channels.items():
            array = np.asarray(value, float)
            if array.shape not in ((), (len(self.trajectory),)):
                raise InvalidInputError(
                    f"channel {name!r} has shape {array.shape}; give one value, or one for each "
                    f"of the trajectory's {len(self.trajectory)} samples"
                )
            wide[name] = array
        object.__setattr__(self, "channels", wide)

    @property
    def rated(self) -> list[Bound]:
        """The bounds that need more than one instant: acceleration and continuous power."""
        motor = self.limits.motor
        bounds = (
            Bound(kind, side, limit)
            for kind, limit in (
                ("acceleration", motor.acceleration),
                ("continuous_power", motor.continuous_power),
            )
            for side in ("left", "right")
        )
        return [bound for bound in bounds if np.isfinite(bound.limit)]

    def blocks(self, scale: float) -> Iterator[Block]:
        """Yield the trajectory, driven `scale` times as fast, in blocks."""
        return (self.block(k, scale) for k in range(self.block_count))

    @property
    def block_count(self) -> int:
        """Number of blocks."""
        return -(-(len(self.trajectory) - 1) // (BLOCK - 1))

    def block(self, k: int, scale: float = 1.0) -> Block:
        """Return the k-th block of the trajectory, driven `scale` times as fast."""
        path, icr = self.trajectory, self.model.vehicle.icr
        first = k * (BLOCK - 1)
        last = min(first + BLOCK, len(path))
        part = slice(first, last)
        v_left, v_right, accel, yaw_accel = tread_motion(
            path.t, path.v, path.omega, icr.left, icr.right, first, last, scale
        )
        t = path.t[part]
        if scale != 1.0:
            t = path.t[0] + (t - path.t[0]) / scale
        known: dict[str, FloatArray] = {
            "t": t,
            "x": path.x[part],
            "y": path.y[part],
            "yaw": path.yaw[part],
            "accel": accel,
            "yaw_accel": yaw_accel,
            "slope": np.zeros(()),
        }
        for name, value in self.channels.items():
            array = np.asarray(value)
            known[name] = array[part] if array.ndim else array
        return Block(first, last, t, Motion(v_left, v_right, icr, known))

    def block_at(self, t: float, scale: float = 1.0) -> int:
        """Return the block that holds the instant `t` of the scaled trajectory."""
        since = (t - self.trajectory.t[0]) * scale + self.trajectory.t[0]
        k = int(np.searchsorted(self.trajectory.t, since))
        return min(k // (BLOCK - 1), self.block_count - 1)

    def survey(self, scale: float = 1.0) -> Survey:
        """Evaluate every limit at every sample."""
        thermal = np.isfinite(self.limits.motor.continuous_power)
        count = len(self.trajectory) if thermal else 0
        drawn = np.empty(count), np.empty(count)
        watch = _Watch()
        lossless = all(term.kind == "force" for term in self.model.terms)
        energy = 0.0
        for block in self.blocks(scale):
            loads = self.limits.loads(self.model, block.motion)
            for bound, value in zip(self.limits.bounds, loads.values, strict=True):
                watch.see(bound, block.t, value)
            self._see_acceleration(watch, block)
            if thermal:
                np.maximum(loads.left, 0.0, out=drawn[0][block.first : block.last])
                np.maximum(loads.right, 0.0, out=drawn[1][block.first : block.last])
            power = self._power(block, loads, lossless)
            energy += float(np.dot(power[1:] + power[:-1], np.diff(block.t))) / 2
        if thermal:
            t0 = self.trajectory.t[0]
            t = t0 + (self.trajectory.t - t0) / scale
            window = self.limits.motor.thermal_time
            for bound, power in zip(self.rated[-2:], drawn, strict=True):
                watch.see(bound, t, window_mean(t, power, window) if window > 0 else power)
        return Survey(list(watch.peaks.values()), watch.excesses, energy, drawn)

    def _power(self, block: Block, loads: Loads, lossless: bool) -> FloatArray:
        # A model of forces alone spends exactly its shaft power.
        return loads.left + loads.right if lossless else self.model.power(block.motion)

    def _see_acceleration(self, watch: _Watch, block: Block) -> None:
        if not np.isfinite(self.limits.motor.acceleration):
            return
        step = np.diff(block.t)
        twice = np.repeat(block.t, 2)[1:-1]
        sides = (block.motion.v_left, block.motion.v_right)
        for bound, speed in zip(self.rated[:2], sides, strict=True):
            rate = np.abs(np.diff(speed)) / step
            if rate.max() > bound.limit:
                watch.see(bound, twice, np.repeat(rate, 2))
            else:
                watch.see(bound, block.t, rate)


class _Watch:
    """Collects peaks and excesses, joining intervals that meet where two blocks do."""

    def __init__(self) -> None:
        self.peaks: dict[tuple[str, str], Peak] = {}
        self.excesses: list[Excess] = []
        self._latest: dict[tuple[str, str], int] = {}

    def see(self, bound: Bound, t: FloatArray, value: FloatArray) -> None:
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
