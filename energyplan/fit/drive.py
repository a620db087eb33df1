"""A log prepared for regression: denoised speeds, delays, windows of time (private)."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d, minimum_filter1d, uniform_filter1d
from scipy.optimize import minimize_scalar
from scipy.signal import lfilter, savgol_filter

from energyplan.errors import DriveLogError, InvalidInputError
from energyplan.logs import DriveLog
from energyplan.logs.align import find_runs, time_weights
from energyplan.logs.checks import held_periods
from energyplan.logs.consistency import POWERS
from energyplan.motion import Motion
from energyplan.path import FloatArray
from energyplan.power import Sides, Term
from energyplan.records import checked
from energyplan.vehicle import TreadICR, Vehicle

# -- consecutive windows of a drive, whose means a fit explains ------------------------------------

SCALES = (0.5, 2.0, 8.0)
"""Window lengths [s]; each divides the next."""

BLOCK = 8.0
"""Length of the blocks that cross-validation leaves out [s]."""


def cut(t: FloatArray, length: float) -> NDArray[np.intp]:
    """Return the stretch that each time is in; a last one shorter than half joins its neighbour."""
    count = max(int(np.floor(t[-1] / length + 0.5)), 1)
    return np.minimum((t / length).astype(np.intp), count - 1)


@dataclass(frozen=True)
class Windows:
    """Consecutive windows of one length over a drive."""

    starts: np.ndarray[tuple[int], np.dtype[np.intp]]  # (w,): first sample of each window
    counts: FloatArray  # (w,): samples in each window
    blocks: np.ndarray[tuple[int], np.dtype[np.intp]]  # (w,)
    length: float  # their length [s]

    @classmethod
    def of(cls, t: FloatArray, length: float) -> Windows:
        """Cut times into windows."""
        index = cut(t, length)
        _, starts = np.unique(index, return_index=True)
        counts = np.diff(np.append(starts, len(t))).astype(float)
        block = cut(t, BLOCK)
        blocks = np.searchsorted(np.unique(block), block[starts])
        return cls(starts.astype(np.intp), counts, blocks, length)

    def mean(self, values: FloatArray) -> FloatArray:
        """Return means over the windows; the first axis is time."""
        total = np.add.reduceat(values, self.starts, axis=0)
        return np.asarray(total / self.counts.reshape(-1, *[1] * (values.ndim - 1)))


# -- motion without the noise of the speed sensors -------------------------------------------------

_SMOOTHING = 0.45  # width of the local parabola [s]
_LONGER = (1.0, 2.0, 4.0)  # averages that may still show a slight turn [s]
_SIGMA = 4.0  # standard deviations that noise does not exceed
_NOISELESS = 1e-4  # speed noise that needs no smoothing [m/s]
_ROUNDING = 1e-6  # a smaller difference of noiseless speeds is none [m/s]
_CREEP = 2e-3  # a slower tread is at rest [m/s]
_DRIVING = 0.1  # share of the typical speed that is driving, whatever the noise
_KEPT = 0.9  # share of the differences that noise makes, the rest being corners
_KEPT_SQUARE = 0.6231  # mean square of that share of standard normal values
_LATTICE = 1e-3  # deviation of readings from a whole number of steps, relative to that number
_AGREES = 0.7  # correlation of another sensor of the turn with the wheels, from which it is one
_RESTING = 20  # samples at rest that determine an offset
_SHORTEST = 7  # samples in a stretch below which nothing is smoothed


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
    """Return the best sensor of a robot's turn other than its wheels: a gyroscope, or a heading."""
    rates = []
    if len(t) < _SHORTEST:
        return None
    if "yaw_rate" in motion.channels:
        rates.append(np.asarray(motion.channels["yaw_rate"]))
    if "yaw" in motion.channels:
        rates.append(np.gradient(np.unwrap(motion.channels["yaw"]), t))
    sensors = [found for rate in rates if (found := Turning.of(rate, motion)) is not None]
    return min(sensors, key=lambda one: one.noise + one.offset_error, default=None)


def quiet(motion: Motion, t: FloatArray) -> Motion:
    """Return a motion without the noise of its speed sensors."""
    # Friction changes direction with the sign of a speed, and noise about zero has any sign.
    # Friction in a slight turn is that in a sharp one, so the direction of any turn matters.
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
    # and no turn: whatever the noise, a good part of the typical speed is driving.
    moving = np.maximum(np.abs(left), np.abs(right))
    # Of a robot that stands for longer than it drives, most readings are noise.
    clear = moving > level if np.any(moving > level) else moving > 0.0
    typical = float(np.median(moving[clear])) if np.any(clear) else 0.0
    most = _DRIVING * typical
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
        turn = _sensed_turn(right - left, level, other, moving, width, period)
    level /= np.sqrt(2)
    left, right = mean - 0.5 * turn, mean + 0.5 * turn
    reach = width if level > _CREEP else 1
    return _at_rest(left, right, max(level, _CREEP), reach)


def _at_rest(
    left: FloatArray, right: FloatArray, level: float, reach: int
) -> tuple[FloatArray, FloatArray]:
    """Return both speeds with zeros where noise explains them, but for starts and stops."""
    driven = [np.abs(v) >= level for v in (left, right)]
    moves = [_passing(np.abs(v), d, reach // 2) for v, d in zip((left, right), driven, strict=True)]
    together = (moves[0] & moves[1]) | driven[0] | driven[1]
    return np.where(moves[0] & together, left, 0.0), np.where(moves[1] & together, right, 0.0)


def _passing(size: FloatArray, driven: NDArray[np.bool_], reach: int) -> NDArray[np.bool_]:
    """Return where a tread moves: where it is driven, and while it starts or stops."""
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


def _sensed_turn(
    wheels: FloatArray, level: float, other: Turning, moving: NDArray[np.bool_], width: int,
    period: float,
) -> FloatArray:  # fmt: skip
    """Difference of the tread speeds, from another sensor where the wheels' noise hides it."""
    seen, noise = other.difference, _SIGMA * other.noise
    if other.noise > _NOISELESS and 5 <= width <= len(seen):
        seen, noise = savgol_filter(seen, width, 2), noise * 1.5 / np.sqrt(width)
    offset = _SIGMA * other.offset_error
    sensed = _turn(seen, noise + offset, _SIGMA * other.noise, moving, period, offset)
    turn = np.where(np.abs(wheels) < level, sensed, wheels)
    # Both are right about a clear turn; a faint one of the wheels alone is their noise.
    return np.where((sensed == 0.0) & (np.abs(wheels) < 2.0 * level), 0.0, turn)


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
        # Only where the whole stretch is straight so far: nothing leaks in from an adjacent turn.
        calm = maximum_filter1d((~straight | ~moving).astype(float), size) == 0.0
        average = uniform_filter1d(difference, size)
        clear = calm & (np.abs(average) > sample / np.sqrt(size) + offset)
        # A stretch ends where the turn does: carry the finding to its ends.
        reach = maximum_filter1d(clear.astype(float), size) > 0.0
        near = reach & straight & moving
        if near.any():
            filled = np.interp(np.arange(len(turn)), np.flatnonzero(clear), average[clear])
            turn = np.where(near & (turn == 0.0), filled, turn)
    return turn


def speed_noise(values: FloatArray) -> float:
    """Return the deviation of white noise on a smooth signal, from its third differences."""
    return float(1.4826 * np.median(np.abs(np.diff(values, 3))) / np.sqrt(20.0))


def reading_step(values: FloatArray) -> float:
    """Return the step of a sensor whose readings are whole numbers of it; 0 where they are not."""
    levels = np.unique(values)
    gaps = np.diff(levels)
    gaps = gaps[gaps > 1e-9 * np.max(np.abs(levels))]
    size = float(np.min(gaps, initial=np.inf))
    whole = np.abs(gaps / size - np.round(gaps / size)) <= _LATTICE * gaps / size
    return size if 0 < len(gaps) < 0.5 * len(values) and np.all(whole) else 0.0


def reading_noise(values: FloatArray) -> float:
    """Return the deviation of white noise on a smooth signal that is read in steps."""
    # Readings that mostly repeat flicker between two steps: the mean square of all but the largest
    # tenth counts too, up to half a step. Readings of zero alone are those of a sensor at rest.
    rest = values == 0.0
    changing = ~(rest[3:] & rest[2:-1] & rest[1:-2] & rest[:-3])
    differences = np.abs(np.diff(values, 3)[changing])
    if not len(differences) or np.ptp(values) == 0.0:
        return 0.0
    white = float(1.4826 * np.median(differences) / np.sqrt(20.0))
    square = np.sort(differences**2)[: max(int(_KEPT * len(differences)), 1)]
    kept = float(np.sqrt(np.mean(square) / _KEPT_SQUARE / 20.0))
    step = float(np.median(np.diff(np.unique(values))))
    return max(white, min(kept, 0.5 * step))


# -- powers that are read more seldom than rows come -----------------------------------------------

_TOGETHER = 0.9  # share of the readings that either side takes part in
_DELAYS = 5  # delays up to a period that are tried for either kind of sensor
_EACH = 4.0  # readings for each coefficient that the kinds are compared by


@dataclass(frozen=True)
class Hold:
    """Readings that stand in several rows each."""

    starts: NDArray[np.intp]  # (n,): row in which each row's reading stands first
    rows: int  # rows from one reading to the next
    mean: bool = False

    @cached_property
    def first(self) -> NDArray[np.intp]:
        """Rows in which a reading stands first."""
        return np.unique(self.starts)

    def shown(self, power: FloatArray) -> FloatArray:
        """Return a power, shape (n, ...), as the readings show it."""
        if not self.mean:
            return np.asarray(power[self.starts])
        first = self.first
        total = np.concatenate([0.0 * power[:1], np.cumsum(power, axis=0)])
        last = np.maximum(first, 1)
        low = np.maximum(last - self.rows, 0)
        width = (last - low).reshape(-1, *[1] * (power.ndim - 1))
        means = (total[last] - total[low]) / width
        return np.asarray(means[np.searchsorted(first, self.starts)])

    def some(self, rows: NDArray[np.intp]) -> Hold | None:
        """Return the readings in some of the rows; None where each row is then a reading."""
        step = float(np.median(np.diff(rows)))
        if self.rows <= step:
            return None
        starts = np.searchsorted(rows, self.starts[rows])
        return replace(self, starts=starts, rows=max(round(self.rows / step), 1))


def find_hold(channels: Mapping[str, FloatArray], motion: Motion, power: FloatArray) -> Hold | None:
    """Find the readings of a power that stand in several rows each, and which kind they are."""
    there = [name for name in POWERS if name in channels]
    sides = [name for name in there if name.startswith("p_")]
    used = sides if len(sides) == 2 else [name for name in there if name not in sides][:1]
    if not used or not set(used) <= set(held_periods(channels)):
        return None
    changes = [np.diff(channels[name]) != 0.0 for name in used]
    fresh = np.append(True, np.any(changes, axis=0))
    first = np.flatnonzero(fresh)
    if _TOGETHER * len(first) > min(np.count_nonzero(one) for one in changes):
        return None
    starts = np.maximum.accumulate(np.where(fresh, np.arange(len(power)), 0))
    v = np.abs(motion.v_left) + np.abs(motion.v_right)
    driven = np.logical_and.reduceat(v > 0.0, first)[:-1]
    rows = int(np.median(np.diff(first)[driven] if np.any(driven) else np.diff(first)))
    sampled = Hold(starts, rows)
    turn = np.abs(motion.v_right - motion.v_left)
    X = np.stack([v, turn, motion.channels["accel"] * motion.v, np.ones(len(v))], axis=1)
    if len(first) < _EACH * X.shape[1]:
        return sampled
    kinds = (sampled, replace(sampled, mean=True))
    return min(kinds, key=lambda kind: _unexplained(kind, X, power))


def _unexplained(kind: Hold, X: FloatArray, power: FloatArray) -> float:
    """Return the sum of squares that columns leave of the readings, at the best delay [W^2]."""
    found, first = [], kind.first
    for late in np.unique(np.linspace(0, kind.rows, _DELAYS).astype(int)):
        at = np.maximum(np.arange(len(X)) - late, 0)
        columns = kind.shown(X[at])[first]
        rest = power[first] - columns @ np.linalg.lstsq(columns, power[first], rcond=None)[0]
        found.append(float(rest @ rest))
    return min(found)


# -- how the logged power is behind the motion: by a delay, and by the lag of its sensor -----------

DELAYS = np.round(np.arange(-1.0, 1.01, 0.1), 1)
"""Delays of the power that are tried first [s]."""

_LAGS = (0.1, 0.2, 0.4, 0.8, 1.6)  # of its sensor [s]
_SHARES = (0.6, 1.0)  # of a lag, by which it is as good as a delay


class Late(NamedTuple):
    """How the logged power is behind the motion."""

    delay: float = 0.0  # time after which it is logged [s]
    lag: float = 0.0  # [s]

    @property
    def mean(self) -> float:
        """Mean time by which the power is late [s]."""
        return self.delay + self.lag

    @property
    def params(self) -> tuple[tuple[str, float], ...]:
        """Parameters by name; the lag where there is one."""
        both = (("delay", self.delay), ("lag", self.lag))
        return both if self.lag > 0.0 else both[:1]

    @classmethod
    def of(cls, params: Sequence[tuple[str, float]]) -> Late:
        """Return what parameters by name say; a lag is not negative."""
        named = dict(params)
        return cls(named["delay"], max(named.get("lag", 0.0), 0.0))


ON_TIME = Late()


class SampleTimes:
    """When the samples of a log were taken, and what they show late."""

    def __init__(self, t: FloatArray) -> None:
        self.t = t
        self.runs = tuple(find_runs(t))
        self.period = _period(t)
        self._periods = [_period(t[run]) for run in self.runs]
        self._before: dict[bool, tuple[float, NDArray[np.intp], FloatArray]] = {}

    def delayed(self, values: FloatArray, delay: float) -> FloatArray:
        """Return values, shape (n, ...), as they were a time before: linear between samples."""
        known, k, share = self._before.get(delay < 0.0, (np.nan, None, None))
        if known != delay or k is None or share is None:
            parts = [(run.start, *_before(self.t[run], delay)) for run in self.runs]
            k = np.concatenate([start + at for start, at, _ in parts])
            share = np.concatenate([part for _, _, part in parts])
            self._before[delay < 0.0] = delay, k, share
        share = share.reshape(-1, *[1] * (values.ndim - 1))
        after = np.minimum(k + 1, len(values) - 1)
        return np.asarray(values[k] * (1.0 - share) + values[after] * share)

    def lagged(self, values: FloatArray, lag: float) -> FloatArray:
        """Return values, shape (n, ...), as a first-order lag shows them, each run from rest."""
        pairs = zip(self.runs, self._periods, strict=True)
        return np.concatenate([_lagged(values[run], period, lag) for run, period in pairs])


def _period(t: FloatArray) -> float:
    """Return the median time between samples; infinite where there is one."""
    return float(np.median(np.diff(t))) if len(t) > 1 else np.inf


def _before(t: FloatArray, delay: float) -> tuple[NDArray[np.intp], FloatArray]:
    """Return the sample that was last a time before each, and the share of the next one."""
    if len(t) < 2:
        return np.zeros(len(t), np.intp), np.zeros(len(t))
    at = t - delay
    k = np.clip(np.searchsorted(t, at) - 1, 0, len(t) - 2)
    return k, np.clip((at - t[k]) / (t[k + 1] - t[k]), 0.0, 1.0)


def _lagged(values: FloatArray, period: float, lag: float) -> FloatArray:
    """Return values, shape (n, ...), as a first-order lag passes them on, at rest to begin with."""
    ratio = period / lag
    fade = float(np.exp(-ratio))
    new = 1.0 + np.expm1(-ratio) / ratio
    old = 1.0 - fade - new
    start = (1.0 - new) * values[:1]
    found, _ = lfilter([new, old], [1.0, -fade], values, axis=0, zi=start)
    return np.asarray(found)


def least_late(loss: Callable[[Late], float], worth: float, shortest: float) -> Late:
    """Return the time offset of least loss."""
    losses = np.array([loss(Late(delay)) for delay in DELAYS.tolist()])
    near = np.pad(losses, 1, constant_values=np.inf)
    lowest = np.flatnonzero((losses <= near[:-2]) & (losses < near[2:]))
    return min(_near(loss, k, worth, shortest) for k in lowest.tolist())[1]


def _near(
    loss: Callable[[Late], float], k: int, worth: float, shortest: float
) -> tuple[float, Late]:
    """Return the least loss near a delay that was tried, and its time offset."""
    found = minimize_scalar(
        lambda delay: loss(Late(float(delay))),
        bounds=(float(DELAYS[max(k - 1, 0)]), float(DELAYS[min(k + 1, len(DELAYS) - 1)])),
        method="bounded",
        options={"xatol": 0.005},
    )
    least, delay = float(found.fun), float(found.x)
    if delay < shortest:
        return least, Late(delay)
    trials = [
        Late(delay - share * lag, lag)
        for lag in _LAGS for share in _SHARES if share * lag <= delay + shortest
    ]  # fmt: skip
    losses = [loss(trial) for trial in trials]
    if not losses or min(losses) >= least - worth:
        return least, Late(delay)
    return min(losses), trials[int(np.argmin(losses))]


# -- a log ready for regression: its motion, its power, and how the one shows the other ------------

MOMENT = 0.5
"""Time over which what contacts hold is taken for one [s]."""

_CLEAR = 4.0  # of the yaw rate up to which contacts may hold, from which on they slide
_ALL = 0.999  # share of a reading's time in which contacts slide
_STILL = 0.99  # of a sample that shows the robot at rest, at least
_PERIOD_ROUNDING = 1e-6  # of samples a period
_ROWS = 4  # that a reading stands in, at least, where rows are left out: else it seems late
_PIECE = 4 * BLOCK  # length of the pieces that stand for a drive, at least [s]
_PIECES = 16  # so many of them, at most
_MANY = 200_000  # samples that selection works on


@dataclass(frozen=True)
class Drive:
    """A log ready for regression."""

    name: str  # name of the log
    t: FloatArray  # (n,): time since the start [s]
    motion: Motion  # (n,): the motion, with the channels ``accel``, ``yaw_accel`` and ``distance``
    power: FloatArray  # (n,): measured total power [W]
    battery: bool = False  # whether it was measured at the battery
    late: Late = ON_TIME  # by how much the logged power is behind the motion
    between: FloatArray | None = None  # (n,) [W]
    breakaway: float = 0.0  # yaw rate up to which contacts may hold [rad/s]
    hold: Hold | None = None  # readings of the power, where they stand in several rows each
    fields: dict[Any, Any] = field(default_factory=dict, repr=False, compare=False)

    @classmethod
    def of(cls, log: DriveLog, vehicle: Vehicle) -> Drive:
        """Prepare a log."""
        t = np.asarray(log.t - log.t[0])
        motion = quiet(log.motion(vehicle.icr), t)
        since = np.asarray(log.t - (log.t[0] if log.began is None else log.began))
        steps = 0.5 * np.diff(t) * (np.abs(motion.v[1:]) + np.abs(motion.v[:-1]))
        distance = np.concatenate([[0.0], np.cumsum(steps)])
        motion = motion.with_channels(t=since, distance=distance)
        sides = None if log.signed is False else log.sides
        return cls(
            log.name, t, motion, log.power, log.battery_side,
            between=None if sides is None else np.asarray(sides.right - sides.left),
            hold=find_hold(log.channels, motion, log.power),
        )  # fmt: skip

    @classmethod
    def at(cls, motion: Motion, battery: bool = False) -> Drive:
        """Return instants of a motion, shape (n,), that belong to no log."""
        count = motion.shape[0]
        return cls("instants", np.arange(float(count)), motion, np.zeros(count), battery)

    def with_channels(self, **channels: FloatArray) -> Drive:
        """Return the drive with channels added to its motion."""
        return replace(self, motion=self.motion.with_channels(**channels), fields={})

    def with_icr(self, icr: TreadICR) -> Drive:
        """Return the drive of a robot with other tread ICRs."""
        return replace(self, motion=replace(self.motion, icr=icr), fields={})

    @property
    def clock(self) -> SampleTimes:
        """When its samples were taken."""
        if "clock" not in self.fields:
            self.fields["clock"] = SampleTimes(self.t)
        found: SampleTimes = self.fields["clock"]
        return found

    @property
    def runs(self) -> tuple[slice, ...]:
        """Stretches without a gap."""
        return self.clock.runs

    @cached_property
    def held(self) -> Motion:
        """The motion for losses: contacts that hardly slip sideways hold, and carry no moment."""
        motion = self.motion
        mean = 0.5 * (motion.v_left + motion.v_right)
        left, right = (np.where(self.holds, mean, v) for v in (motion.v_left, motion.v_right))
        return replace(motion, v_left=left, v_right=right)

    @cached_property
    def holds(self) -> NDArray[np.bool_]:
        """Return where contacts hold: the moment of friction is anything up to its limit."""
        return np.asarray(np.abs(self.motion.omega) <= self.breakaway)

    @property
    def equations(self) -> int:
        """Number of equations: two where the power of both sides is used."""
        return 1 if self.between is None else 2

    @cached_property
    def measured(self) -> FloatArray:
        """Measured power of each equation, shape (n, equations) [W]; see `observed`."""
        if self.between is None:
            return self.power[:, None]
        return np.column_stack([self.power * self.settled, self.between * self.slides])

    @cached_property
    def slides(self) -> FloatArray:
        """The sign of the turn where the difference of the sides follows from it, else zero."""
        clear = np.abs(self.motion.omega) > _CLEAR * self.breakaway
        turn = np.where(clear, np.sign(self.motion.omega), 0.0)
        mean = uniform_filter1d(turn, width := self.samples_in(MOMENT), mode="nearest")
        return self._throughout(np.where(np.abs(mean) > 1.0 - 0.5 / width, turn, 0.0))

    @cached_property
    def settled(self) -> FloatArray:
        """Zero while contacts change from holding to sliding or back, else one."""
        if self.breakaway == 0.0:
            return np.ones(len(self.t))
        ends = (minimum_filter1d, maximum_filter1d)
        width, holds = self.samples_in(2.0 * MOMENT), self.holds.astype(float)
        least, most = (end(holds, width, mode="nearest") for end in ends)
        return self._throughout(np.where(least == most, 1.0, 0.0))

    def _throughout(self, signs: FloatArray) -> FloatArray:
        """Return signs of samples as the log shows them, zero where a reading mixes them."""
        # Whole samples later, so that no delay makes the samples that count fewer.
        by = round(self.late.mean / self.clock.period)
        shown = signs[np.clip(np.arange(len(self.t)) - by, 0, len(self.t) - 1)]
        if self.hold is None:
            return np.asarray(shown)
        mean = self.hold.shown(shown)
        return np.where(np.abs(mean) > _ALL, np.sign(mean), 0.0)

    @cached_property
    def between_noise(self) -> float:
        """Noise of the measured difference of the sides [W]."""
        return 0.0 if self.between is None else speed_noise(self.between)

    def samples_in(self, time: float) -> int:
        """Return the odd number of samples closest to a time [s]."""
        return 2 * round(0.5 * time / self.clock.period) + 1

    def observed(self, table: FloatArray) -> FloatArray:
        """Return predictions of each equation, shape (n, equations, ...), as the log shows them."""
        seen = self.seen(table)
        if self.between is not None:
            counts = np.column_stack([self.settled, self.slides])
            seen = seen * counts.reshape(*counts.shape, *[1] * (table.ndim - 2))
        return seen

    @cached_property
    def weights(self) -> FloatArray:
        """Time that each sample stands for [s]; gaps count for nothing."""
        return time_weights(self.t, self.runs)

    def seen(self, power: FloatArray) -> FloatArray:
        """Return a predicted power, shape (n, ...), as the log shows it."""
        late = power
        if self.late.delay != 0.0:
            late = self.clock.delayed(late, self.late.delay)
        if self.late.lag > 0.0:
            late = self.clock.lagged(late, self.late.lag)
        return late if self.hold is None else self.hold.shown(late)

    @cached_property
    def rests(self) -> NDArray[np.bool_]:
        """Which samples show the power of the robot at rest: where it is late, that of before."""
        still = (self.motion.v_left == 0) & (self.motion.v_right == 0)
        return self.seen(still.astype(float)) > _STILL

    def in_time(self, measured: FloatArray) -> FloatArray:
        """Return a measured power as the model has it: not late."""
        return replace(self, late=Late(-self.late.mean), hold=None).seen(measured)

    def some(self, rows: NDArray[np.intp]) -> Drive:
        """Return the drive with some of its samples, ascending; what is left out is a gap."""
        motion = self.motion
        channels = {name: values[rows] for name, values in motion.channels.items()}
        few = Motion(motion.v_left[rows], motion.v_right[rows], motion.icr, channels)
        between = None if self.between is None else self.between[rows]
        return replace(
            self, t=self.t[rows], motion=few, power=self.power[rows], between=between,
            fields={}, hold=None if self.hold is None else self.hold.some(rows),
        )  # fmt: skip

    def thinned(self, step: int) -> Drive:
        """Return every `step`-th sample of the drive."""
        return self.some(np.arange(0, len(self.t), step))

    def pieces(self, share: float, turn: float) -> Drive:
        """Return pieces of the drive, evenly spread, that are a share of it, or one at least."""
        number = len(self.t)
        least = _PIECE / self.clock.period
        count = max(int(number / max(least, share * number / _PIECES)), 1)
        kept = max(round(share * count), 1)
        chosen = ((np.arange(kept) + turn) * count / kept).astype(np.intp)
        piece = np.arange(number) * count // number
        return self.some(np.flatnonzero(np.isin(piece, chosen)))

    def averaged(self, period: float) -> Drive:
        """Return means over a period [s], none across a gap; the drive where it has no more."""
        step = int(period / self.clock.period + _PERIOD_ROUNDING)
        if self.hold is not None:
            step = min(step, self.hold.rows // _ROWS)
        if step < 2:
            return self
        if self.hold is not None:
            return self.thinned(step)
        starts = np.concatenate([np.arange(run.start, run.stop, step) for run in self.runs])
        counts = np.diff(np.append(starts, len(self.t)))

        def mean(values: FloatArray) -> FloatArray:
            return np.asarray(np.add.reduceat(values, starts) / counts)

        motion = self.motion
        whole = {**motion.channels}
        if "yaw" in whole:
            whole["yaw"] = np.unwrap(whole["yaw"])
        channels = {name: mean(values) for name, values in whole.items()}
        means = Motion(mean(motion.v_left), mean(motion.v_right), motion.icr, channels)
        between = None if self.between is None else mean(self.between)
        return replace(
            self, t=mean(self.t), motion=means, power=mean(self.power), between=between, fields={}
        )

    def changed_as(self, means: Drive) -> Drive:
        """Return the drive with the channel ``changed`` of its means."""
        after = np.searchsorted(0.5 * (means.t[1:] + means.t[:-1]), self.t)
        return self.with_channels(changed=means.motion.channels["changed"][after])

    @cached_property
    def windows(self) -> tuple[Windows, ...]:
        """Windows of each scale."""
        period = self.clock.period
        return tuple(Windows.of(self.t, max(scale, 3 * period)) for scale in SCALES)


def check_long_enough(*lists: Sequence[DriveLog]) -> None:
    """Refuse drives too short to be cut into blocks, each or all of a list together."""
    cases = [(log.name, [log], 0.5 * BLOCK) for logs in lists for log in logs]
    cases += [(", ".join(log.name for log in logs[:3]), [*logs], 2 * BLOCK) for logs in lists]
    for name, logs, least in cases:
        seconds = sum(float(log.t[-1] - log.t[0]) for log in logs)
        if seconds < least:
            raise DriveLogError(
                f"{name}: {seconds:.1f} s are too short to learn from, or to judge by; give "
                f"{least:.0f} s or more"
            )


def prepared(logs: Sequence[DriveLog], vehicle: Vehicle) -> list[Drive]:
    """Prepare training drives."""
    return enough_of([Drive.of(log, vehicle) for log in logs])


def enough_of(drives: list[Drive]) -> list[Drive]:
    """Return drives, of which very many samples are thinned, to four a window at least."""
    total = sum(len(drive.t) for drive in drives)
    period = max(drive.clock.period for drive in drives)
    step = min(int(np.ceil(total / _MANY)), int(SCALES[0] / (4 * period)))
    return [drive.thinned(step) for drive in drives] if step > 1 else drives


def channels_of(drives: Sequence[Drive]) -> frozenset[str]:
    """Return the channels that every drive carries."""
    common: Mapping[str, object] = drives[0].motion.channels
    names = set(common)
    for drive in drives[1:]:
        names &= set(drive.motion.channels)
    return frozenset(names)


# -- columns of terms on a drive, computed once and kept -------------------------------------------

_CACHED = 96  # forces and columns of terms kept a drive


def field_of(term: Term, drive: Drive, vehicle: Vehicle, held: bool = False) -> Any:
    """Return force or power per unit of a term that is no loss, computed once a drive."""
    key = ("held" if held else "driven", term.name, tuple(term.params.items()), vehicle.slip_moment)
    if key not in drive.fields:
        if len(drive.fields) > _CACHED:
            drive.fields.clear()
        motion = drive.held if held else drive.motion
        drive.fields[key] = term.function(motion, vehicle, **term.params)
    return drive.fields[key]


def column(term: Term, drive: Drive, vehicle: Vehicle) -> FloatArray:
    """Total power per unit of a linear term's coefficient at each sample [W per unit]."""
    value = field_of(term, drive, vehicle)
    if term.kind == "force":
        motion = drive.motion
        return np.asarray(value.left * motion.v_left + value.right * motion.v_right)
    return np.asarray(value.total if isinstance(value, Sides) else value)


def columns_of(term: Term, drive: Drive, vehicle: Vehicle) -> FloatArray:
    """Power per unit of a linear term's coefficient in each equation, shape (n, equations)."""
    key = (drive.equations, term.name, tuple(term.params.items()), vehicle.slip_moment)
    if key not in drive.fields:
        value = field_of(term, drive, vehicle)
        if term.kind == "force":
            motion = drive.motion
            value = Sides(value.left * motion.v_left, value.right * motion.v_right)
        drive.fields[key] = of_equations(value, drive)
    found: FloatArray = drive.fields[key]
    return found


def of_equations(value: Sides | FloatArray, drive: Drive) -> FloatArray:
    """Return a power in each equation, shape (n, equations); a common one is no side's more."""
    total = value.total if isinstance(value, Sides) else value
    total = np.broadcast_to(total, drive.t.shape)
    if drive.equations == 1:
        return np.asarray(total[:, None])
    more = value.right - value.left if isinstance(value, Sides) else 0.0 * total
    return np.column_stack([total, np.broadcast_to(more, drive.t.shape)])


# -- drives parted into what to learn from and what to judge by ------------------------------------

_JUDGED = 0.4  # share of the driving that is judged by

_CUT = 2.0 * BLOCK / _JUDGED
"""Length from which a drive is cut [s]: both parts are then long enough by themselves."""


@checked()
def split_drives(drives: Sequence[DriveLog]) -> tuple[list[DriveLog], list[DriveLog]]:
    """Part drives into what to learn from and, two fifths of the time, what to judge by."""
    if not drives:
        raise InvalidInputError("no logs; give at least one drive")
    learned: list[DriveLog] = []
    judged: list[DriveLog] = []
    for drive in drives:
        if drive.duration >= _CUT or len(drives) == 1:
            cut = float(drive.t[0] + (1.0 - _JUDGED) * (drive.t[-1] - drive.t[0]))
            learned.append(drive.segment(float(drive.t[0]), cut))
            judged.append(drive.segment(cut, math.nextafter(float(drive.t[-1]), math.inf)))
        else:
            total = _seconds([*learned, *judged, drive])
            nearer = _seconds(judged) + 0.5 * drive.duration < _JUDGED * total
            (judged if nearer else learned).append(drive)
    check_long_enough(learned, judged)
    return learned, judged


def _seconds(drives: Sequence[DriveLog]) -> float:
    return sum(drive.duration for drive in drives)
