"""A log ready for regression: its motion, its power, and how the one shows the other (private)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from energyplan.errors import DriveLogError
from energyplan.fit.drives.denoise import NO_STEPS, Steps, quiet, speed_noise
from energyplan.fit.drives.hold import Hold, find_hold
from energyplan.fit.drives.late import ON_TIME, Clock, Late
from energyplan.fit.drives.windows import BLOCK, SCALES, Windows
from energyplan.logs import DriveLog
from energyplan.logs.align import time_weights
from energyplan.motion import Motion
from energyplan.path import FloatArray
from energyplan.vehicle import TreadICR, Vehicle

MOMENT = 0.5
"""Time over which what contacts hold is taken for one [s]."""

_ALL = 0.999  # share of a reading's time in which contacts slide
_STILL = 0.99  # of a sample that shows the robot at rest, at least
_ROUNDING = 1e-6  # of samples a period
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
    factor: float = 1.0  # power of this drive over that of the model
    between: FloatArray | None = None  # (n,) [W]
    breakaway: float = 0.0  # yaw rate up to which contacts hold [rad/s]
    drift: float = 0.0  # yaw rate by which steering drifts about a straight [rad/s]
    fitted: bool = False  # whether a model is fitted to it
    steps: Steps = NO_STEPS  # of the speeds' sensors
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
        sides = log.sides
        return cls(
            log.name, t, motion, log.power, log.battery_side,
            between=None if sides is None else np.asarray(sides.right - sides.left),
            steps=Steps.of(np.concatenate([log.channel("v_left"), log.channel("v_right")])),
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
    def clock(self) -> Clock:
        """When its samples were taken."""
        if "clock" not in self.fields:
            self.fields["clock"] = Clock(self.t)
        found: Clock = self.fields["clock"]
        return found

    @property
    def runs(self) -> tuple[slice, ...]:
        """Stretches without a gap."""
        return self.clock.runs

    @cached_property
    def held(self) -> Motion:
        """The motion for losses: contacts that hardly slip sideways hold, and carry no moment.

        The moment of friction is anything up to its limit while they hold (docs/theory, section
        6). Its power is nothing then, but a loss counts the force: with the sign of the least turn
        a straight line would cost what a spin does.
        """
        motion = self.motion
        mean = 0.5 * (motion.v_left + motion.v_right)
        left, right = (np.where(self.holds, mean, v) for v in (motion.v_left, motion.v_right))
        return replace(motion, v_left=left, v_right=right)

    @cached_property
    def holds(self) -> NDArray[np.bool_]:
        """Tell where contacts hold, so that the moment of friction is anything up to its limit."""
        return np.asarray(np.abs(self.motion.omega) <= max(self.breakaway, self.drift))

    @cached_property
    def holding(self) -> Motion:
        """The motion of samples at which contacts hold."""
        held, at = self.held, self.holds
        channels = {name: values[at] for name, values in held.channels.items()}
        return Motion(held.v_left[at], held.v_right[at], held.icr, channels)

    @property
    def equations(self) -> int:
        """Number of equations: two where the power of both sides is used."""
        return 1 if self.between is None else 2

    @cached_property
    def measured(self) -> FloatArray:
        """Measured power of each equation, shape (n, equations) [W]; see `observed`."""
        if self.between is None:
            return self.power[:, None]
        return np.column_stack([self.power, self.between * self.slides])

    @cached_property
    def slides(self) -> FloatArray:
        """One where the difference of the sides follows from the motion, else zero.

        Friction turns with the sign of the yaw rate, and the difference with it: around a reversal
        it is anything between. What the log shows late counts late.
        """
        turn = np.where(self.holds, 0.0, np.sign(self.motion.omega))
        width = self.samples_in(MOMENT)
        settled = np.abs(uniform_filter1d(turn, width, mode="nearest")) > 1.0 - 0.5 / width
        # Whole samples later, so that no delay makes the samples that count fewer.
        by = round(self.late.mean / self.clock.period)
        at = np.clip(np.arange(len(self.t)) - by, 0, len(self.t) - 1)
        shown = np.asarray(settled[at], float)
        return shown if self.hold is None else (self.hold.shown(shown) > _ALL).astype(float)

    @cached_property
    def between_noise(self) -> float:
        """Noise of the measured difference of the sides [W]."""
        return 0.0 if self.between is None else speed_noise(self.between)

    def samples_in(self, time: float) -> int:
        """Return the odd number of samples closest to a time [s]."""
        return 2 * round(0.5 * time / self.clock.period) + 1

    def observed(self, table: FloatArray) -> FloatArray:
        """Return predictions of each equation, shape (n, equations, ...), as the log shows them.

        The difference of the sides counts only where contacts slide.
        """
        seen = self.seen(table)
        if self.between is not None:
            seen = np.array(seen)
            seen[:, 1] *= self.slides.reshape(-1, *[1] * (table.ndim - 2))
        return seen

    @cached_property
    def weights(self) -> FloatArray:
        """Time that each sample stands for [s]; gaps count for nothing."""
        return time_weights(self.t, self.runs)

    def seen(self, power: FloatArray) -> FloatArray:
        """Return a predicted power, shape (n, ...), as the log shows it: late, and by the factor.

        The prediction is shifted and lags, and the measurement is left as it is: a shifted
        measurement is smoother, and flatters whoever predicts it.
        """
        late = power
        if self.late.delay != 0.0:
            late = self.clock.delayed(late, self.late.delay)
        if self.late.lag > 0.0:
            late = self.clock.lagged(late, self.late.lag)
        late = late if self.hold is None else self.hold.shown(late)
        return late if self.factor == 1.0 else late * self.factor

    @cached_property
    def rests(self) -> NDArray[np.bool_]:
        """Which samples show the power of the robot at rest: where it is late, that of before."""
        still = (self.motion.v_left == 0) & (self.motion.v_right == 0)
        return self.seen(still.astype(float)) > _STILL * self.factor

    def in_time(self, measured: FloatArray) -> FloatArray:
        """Return a measured power as the model has it: not late, and without the run's factor."""
        early = replace(self, late=Late(-self.late.mean), factor=1.0, hold=None)
        return np.asarray(early.seen(measured) / self.factor)

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
        """Return pieces of the drive, evenly spread, that are a share of it, or one at least.

        `turn`, from zero to one, tells where they begin: other drives show what this one does not.
        """
        number = len(self.t)
        least = _PIECE / self.clock.period
        count = max(int(number / max(least, share * number / _PIECES)), 1)
        kept = max(round(share * count), 1)
        chosen = ((np.arange(kept) + turn) * count / kept).astype(np.intp)
        piece = np.arange(number) * count // number
        return self.some(np.flatnonzero(np.isin(piece, chosen)))

    def averaged(self, period: float) -> Drive:
        """Return means over a period [s], none across a gap; the drive where it has no more.

        Powers whose readings stand in several rows are thinned instead: means would mix readings.
        """
        step = int(period / self.clock.period + _ROUNDING)
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


def parted(total: FloatArray, between: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the power of the left side and of the right one, of their sum and difference."""
    return 0.5 * (total - between), 0.5 * (total + between)


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
    """Prepare training drives; very many samples are thinned, to four a shortest window at least.

    Speeds are cleaned before: only the averaging of noise suffers, of which there is plenty left.
    """
    drives = [replace(Drive.of(log, vehicle), fitted=True) for log in logs]
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
