"""Motion without the noise of the speed sensors (private)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d, uniform_filter1d
from scipy.signal import savgol_filter

from energyplan.logs.align import find_runs
from energyplan.motion import Motion
from energyplan.path import FloatArray

_SMOOTHING = 0.45  # width of the local parabola [s]
_LONGER = (1.0, 2.0, 4.0)  # averages that may still tell a slight turn [s]
_SIGMA = 4.0  # standard deviations that noise does not exceed
_NOISELESS = 1e-4  # speed noise not worth smoothing [m/s]
_ROUNDING = 1e-6  # a smaller difference of noiseless speeds is none [m/s]
_CREEP = 2e-3  # a slower tread is at rest [m/s]
_DRIVING = 0.1  # share of the usual speed that is driving, whatever the noise
_KEPT = 0.9  # share of the differences that noise makes, the rest being corners
_KEPT_SQUARE = 0.6231  # mean square of that share of standard normal values
_AGREES = 0.7  # correlation of another sensor of the turn with the wheels, from which it is one
_RESTING = 20  # samples at rest that tell an offset
_SHORTEST = 7  # samples in a stretch below which nothing is smoothed
_HARMONICS = np.arange(1.0, 9.0)  # of the rounding error, of which the higher ones are nothing
_NOISES = np.linspace(0.0, 1.0, 101)  # over the step: more of it averages rounding out
_LATTICE = 1e-3  # of a step, by which readings lie beside a whole number of them
_FEWEST = 8  # readings that tell a step
_STEADY = 0.25  # of a step, by which a steady state changes at most


@dataclass(frozen=True)
class Turning:
    """How a robot turns, by another sensor than its wheels."""

    difference: FloatArray  # (n,) [m/s]
    noise: float  # standard deviation of the white noise of a sample [m/s]
    offset_error: float  # standard error of the offset that was taken off [m/s]

    @classmethod
    def of(cls, rate: FloatArray, motion: Motion) -> Turning | None:
        """Compare a yaw rate with the wheels."""
        seen = motion.icr.slip_track * rate
        wheels = motion.v_right - motion.v_left
        if np.std(seen) == 0.0 or np.std(wheels) == 0.0:
            return None
        if np.corrcoef(seen, wheels)[0, 1] < _AGREES:
            return None
        rest = np.maximum(np.abs(motion.v_left), np.abs(motion.v_right)) < _CREEP
        # At rest the sensor shows its offset alone; else what it shows more than the wheels do.
        free = seen[rest] if np.count_nonzero(rest) >= _RESTING else seen - wheels
        scatter = 1.4826 * float(np.median(np.abs(free - np.median(free))))
        error = 1.25 * scatter / np.sqrt(len(free))
        return cls(seen - float(np.median(free)), reading_noise(seen), float(error))


def turning(motion: Motion, t: FloatArray) -> Turning | None:
    """Return what tells best how a robot turns beside its wheels: a gyroscope, or a heading."""
    rates = []
    if len(t) < _SHORTEST:
        return None
    if "yaw_rate" in motion.channels:
        rates.append(np.asarray(motion.channels["yaw_rate"]))
    if "yaw" in motion.channels:
        rates.append(np.gradient(np.unwrap(motion.channels["yaw"]), t))
    told = [found for rate in rates if (found := Turning.of(rate, motion)) is not None]
    return min(told, key=lambda one: one.noise + one.offset_error, default=None)


def quiet(motion: Motion, t: FloatArray) -> Motion:
    """Return a motion without the noise of its speed sensors.

    Friction turns with the sign of a speed, and noise about zero has any sign. Speeds are smoothed
    by a local parabola. A speed that noise can explain is zero. A difference of both treads'
    speeds that noise can explain is averaged over longer and longer stretches, and zero where it
    stays within the noise: the friction of a slight turn is that of a sharp one, so that it matters
    which way the robot turned, however little. Where a gyroscope or a heading tells slight turns
    better than the wheels do, it decides. Without noise only creep at rest is taken out.
    """
    left, right = np.array(motion.v_left), np.array(motion.v_right)
    other = turning(motion, t)
    for run in find_runs(t):
        seen = None if other is None else replace(other, difference=other.difference[run])
        left[run], right[run] = _quiet_run(left[run], right[run], t[run], seen)
    return replace(motion, v_left=left, v_right=right)


def _quiet_run(
    left: FloatArray, right: FloatArray, t: FloatArray, other: Turning | None
) -> tuple[FloatArray, FloatArray]:
    """Return both tread speeds of a stretch without a gap, freed of noise."""
    if len(t) < _SHORTEST:
        return left, right
    noise = max(reading_noise(left), reading_noise(right))
    period = float(np.median(np.diff(t)))
    width = 2 * round(0.5 * _SMOOTHING / period) + 1
    level = _SIGMA * noise
    # Readings that beat with the encoder scatter by a good part of the speed, but are no standstill
    # and no turn: whatever the noise, a good part of the usual speed is driving.
    moving = np.maximum(np.abs(left), np.abs(right))
    # Of a robot that stands for longer than it drives, most readings are noise.
    clear = moving > level if np.any(moving > level) else moving > 0.0
    usual = float(np.median(moving[clear])) if np.any(clear) else 0.0
    most = _DRIVING * usual
    if noise > _NOISELESS and 5 <= width <= len(t):
        left, right = (savgol_filter(v, width, 2) for v in (left, right))
        level *= 1.5 / np.sqrt(width)  # a parabola leaves 9 / 4n of the variance at its middle
    elif level > most and len(t) >= 2 * _SHORTEST:
        size = min(2 * round(0.5 * _LONGER[0] / period) + 1, _SHORTEST)
        left, right = (uniform_filter1d(v, max(size, 3)) for v in (left, right))
    level = min(level, most)
    mean = 0.5 * (left + right)
    moving = np.maximum(np.abs(left), np.abs(right)) > max(level, _CREEP)
    level, wide = np.sqrt(2) * level, np.sqrt(2) * _SIGMA * noise
    sample = None if other is None else _SIGMA * np.hypot(other.noise, other.offset_error)
    if other is None or sample is None or sample >= wide:
        turn = _turn(right - left, level, wide, moving, period)
    else:
        turn = _told_turn(right - left, level, other, moving, width, period)
    level /= np.sqrt(2)
    left, right = mean - 0.5 * turn, mean + 0.5 * turn
    reach = width if level > _CREEP else 1
    return _at_rest(left, right, max(level, _CREEP), reach)


def _at_rest(
    left: FloatArray, right: FloatArray, level: float, reach: int
) -> tuple[FloatArray, FloatArray]:
    """Return both speeds with zeros where noise explains them, but for starts and stops.

    A start passes through the noise in some samples: as many as the speed beyond it takes to rise
    as far. Were they zero, as many samples at rest would show the power of driving; were they more,
    losses that depend on forces, not on speeds, would be expected of a robot at rest. Treads start
    together: where neither is clear of the noise, one does not move alone.
    """
    driven = [np.abs(v) >= level for v in (left, right)]
    moves = [_passing(np.abs(v), d, reach // 2) for v, d in zip((left, right), driven, strict=True)]
    together = (moves[0] & moves[1]) | driven[0] | driven[1]
    return np.where(moves[0] & together, left, 0.0), np.where(moves[1] & together, right, 0.0)


def _passing(size: FloatArray, driven: NDArray[np.bool_], reach: int) -> NDArray[np.bool_]:
    """Tell where a tread moves: where it is driven, and while it starts or stops."""
    moves, change = np.array(driven), np.diff(driven.astype(int))
    starts, stops = np.flatnonzero(change > 0) + 1, np.flatnonzero(change < 0)
    for ends, way in ((starts, 1), (stops, -1)):
        within = np.clip(ends + way * reach, 0, len(size) - 1)
        steps = np.abs(within - ends)
        rise = np.where(driven[within], size[within] - size[ends], 0.0)
        passed = np.divide(size[ends] * steps, rise, out=np.full(len(ends), np.inf), where=rise > 0)
        for end, count in zip(ends, np.minimum(passed, reach).astype(int), strict=True):
            low, high = sorted((end - way * count, end))
            moves[max(low, 0) : high + 1] = True
    return moves


def _told_turn(
    wheels: FloatArray, level: float, other: Turning, moving: NDArray[np.bool_], width: int,
    period: float,
) -> FloatArray:  # fmt: skip
    """Difference of the tread speeds, told by another sensor where the wheels' noise hides it."""
    seen, noise = other.difference, _SIGMA * other.noise
    if other.noise > _NOISELESS and 5 <= width <= len(seen):
        seen, noise = savgol_filter(seen, width, 2), noise * 1.5 / np.sqrt(width)
    offset = _SIGMA * other.offset_error
    told = _turn(seen, noise + offset, _SIGMA * other.noise, moving, period, offset)
    turn = np.where(np.abs(wheels) < level, told, wheels)
    # Both are right about a clear turn; a faint one of the wheels alone is their noise.
    return np.where((told == 0.0) & (np.abs(wheels) < 2.0 * level), 0.0, turn)


def _turn(
    difference: FloatArray, level: float, sample: float, moving: NDArray[np.bool_], period: float,
    offset: float = 0.0,
) -> FloatArray:  # fmt: skip
    """Difference of the tread speeds, zero where noise or an offset can explain it."""
    straight = np.abs(difference) < max(level, _ROUNDING)
    turn = np.where(straight, 0.0, difference)
    if sample < _NOISELESS:
        return turn
    for length in _LONGER:
        size = 2 * round(0.5 * length / period) + 1
        if size > len(turn):
            break
        # Only where the whole stretch is straight so far: nothing leaks in from a turn beside it.
        calm = maximum_filter1d((~straight | ~moving).astype(float), size) == 0.0
        average = uniform_filter1d(difference, size)
        told = calm & (np.abs(average) > sample / np.sqrt(size) + offset)
        # A stretch ends where the turn does: carry the finding to its ends.
        reach = maximum_filter1d(told.astype(float), size) > 0.0
        near = reach & straight & moving
        if near.any():
            filled = np.interp(np.arange(len(turn)), np.flatnonzero(told), average[told])
            turn = np.where(near & (turn == 0.0), filled, turn)
    return turn


@dataclass(frozen=True)
class Steps:
    """Steps of a sensor."""

    size: float = 0.0  # between neighbouring readings
    error: float = 0.0  # standard deviation, over steady states, of the mean of readings of one

    @classmethod
    def of(cls, values: FloatArray, expected: FloatArray | None = None) -> Steps:
        """Return the steps of readings.

        Source: Widrow and Kollar (2008), Quantization Noise, chapters 4 and 19.
        """
        levels = np.unique(values)
        gaps = np.diff(levels)
        gaps = gaps[gaps > 1e-9 * np.max(np.abs(levels), initial=0.0)]
        if len(values) < _FEWEST:
            return cls()
        if not len(gaps):
            only = 0.0 if expected is None else float(np.max(np.abs(levels)))
            return cls(only, only / np.sqrt(12.0))
        size = float(np.min(gaps))
        if np.any(np.abs(gaps / size - np.round(gaps / size)) > _LATTICE * gaps / size):
            return cls()
        # Noise and rounding make all of the readings' square error: the mean's, and their scatter.
        damped = np.exp(-((2.0 * np.pi * np.outer(_NOISES, _HARMONICS)) ** 2))
        square = 0.5 * damped @ (np.pi * _HARMONICS) ** -2.0
        scatter = _NOISES**2 + square[0] - square
        noise = reading_noise(values, None if expected is None else _steady(expected, size))
        left = np.interp((noise / size) ** 2, scatter, square)
        return cls(size, size * float(np.sqrt(left)))

    def states(self, values: FloatArray) -> NDArray[np.int64]:
        """Return the number of the step that each value lies in."""
        return np.asarray(np.round(values / self.size), np.int64)


NO_STEPS = Steps()
"""Of a sensor without steps."""


def speed_noise(values: FloatArray) -> float:
    """Return the deviation of white noise on a smooth signal, from its third differences."""
    return float(1.4826 * np.median(np.abs(np.diff(values, 3))) / np.sqrt(20.0))


def _steady(expected: FloatArray, size: float) -> NDArray[np.bool_] | None:
    """Return at which third differences readings are expected to stay within a part of a step.

    None where that is nearly nowhere.
    """
    if len(expected) < _FEWEST:
        return None
    around = np.lib.stride_tricks.sliding_window_view(expected, 4)
    steady: NDArray[np.bool_] = np.ptp(around, axis=1) < _STEADY * size
    return steady if np.count_nonzero(steady) >= _FEWEST else None


def reading_noise(values: FloatArray, steady: NDArray[np.bool_] | None = None) -> float:
    """Return the deviation of white noise on a smooth signal that is read in steps.

    Of readings that mostly repeat, the median third difference is zero though they flicker between
    two steps: the mean square of all but the largest tenth counts too, up to half a step. Of normal
    noise both give the same. Readings of nothing but zero are a sensor at rest: however long it
    stands, they say nothing of its noise in motion.
    """
    rest = values == 0.0
    told = ~(rest[3:] & rest[2:-1] & rest[1:-2] & rest[:-3])
    if steady is not None:
        told &= steady
    differences = np.abs(np.diff(values, 3)[told])
    if not len(differences) or np.ptp(values) == 0.0:
        return 0.0
    white = float(1.4826 * np.median(differences) / np.sqrt(20.0))
    square = np.sort(differences**2)[: max(int(_KEPT * len(differences)), 1)]
    kept = float(np.sqrt(np.mean(square) / _KEPT_SQUARE / 20.0))
    step = float(np.median(np.diff(np.unique(values))))
    return max(white, min(kept, 0.5 * step))
