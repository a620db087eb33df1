"""Drives as regression data: columns averaged over windows of several lengths (private).

A residual has causes on several time scales: inertia lives in the ramps, a hotel load or a slope
in whole manoeuvres. Least squares on single samples sees mostly noise and ramps. Here every drive
is averaged over windows of half a second, two and eight seconds, and an error counts relative to
the present error on its own scale.

Where the power of both sides was logged there are two equations: for their sum, and for what the
right side draws more than the left one (docs/theory, section 6).
"""

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
from energyplan.fit.drives.late import ON_TIME, Late, delayed, lagged
from energyplan.fit.drives.window_kernels import block_grams
from energyplan.logs import DriveLog
from energyplan.logs.align import time_weights
from energyplan.logs.checks import find_runs
from energyplan.motion import Motion
from energyplan.path import FloatArray
from energyplan.vehicle import TreadICR, Vehicle

SCALES = (0.5, 2.0, 8.0)
"""Window lengths [s]; each divides the next."""

BLOCK = 8.0
"""Length of the blocks that cross-validation leaves out [s]."""

MOMENT = 0.5
"""Time over which what contacts hold is taken for one [s]."""

_ALL = 0.999  # share of a reading's time in which contacts slide
_MUCH = 0.4  # share of all blocks that no drive may exceed to be left out as a whole
_IDLE = 0.01  # share of the usual size of a block's columns below which it says nothing
_MANY = 200_000  # samples that selection works on


@dataclass(frozen=True)
class Drive:
    """A log ready for regression.

    Parameters
    ----------
    name : str
        Name of the log.
    t : ndarray, shape (n,)
        Time since the start [s].
    motion : Motion, shape (n,)
        The motion, with the channels ``accel``, ``yaw_accel`` and ``distance``.
    power : ndarray, shape (n,)
        Measured total power [W].
    battery : bool
        Whether it was measured at the battery.
    late : Late
        By how much the logged power is behind the motion.
    factor : float
        Power of this drive over that of the model: what differs from drive to drive as a whole.
    between : ndarray, shape (n,), optional
        Measured power of the right side less that of the left one [W], where both are used.
    breakaway : float
        Yaw rate up to which contacts hold [rad/s]; zero for straight lines alone.
    drift : float
        Yaw rate by which steering drifts about a straight [rad/s]: nothing tells which way, so that
        contacts are taken to hold there too.
    fitted : bool
        Whether a model is fitted to it: only then its power may tell what contacts hold.
    steps : Steps
        Of the speeds' sensors.
    hold : Hold, optional
        Readings of the power, where they stand in several rows each.
    fields : dict
        Forces of terms, kept for `field_of`.
    """

    name: str
    t: FloatArray
    motion: Motion
    power: FloatArray
    battery: bool = False
    late: Late = ON_TIME
    factor: float = 1.0
    between: FloatArray | None = None
    breakaway: float = 0.0
    drift: float = 0.0
    fitted: bool = False
    steps: Steps = NO_STEPS
    hold: Hold | None = None
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

    @cached_property
    def runs(self) -> tuple[slice, ...]:
        """Stretches without a gap."""
        return tuple(find_runs(self.t))

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
        by = round(self.late.mean / float(np.median(np.diff(self.t))))
        at = np.clip(np.arange(len(self.t)) - by, 0, len(self.t) - 1)
        shown = np.asarray(settled[at], float)
        return shown if self.hold is None else (self.hold.shown(shown) > _ALL).astype(float)

    @cached_property
    def between_noise(self) -> float:
        """Noise of the measured difference of the sides [W]."""
        return 0.0 if self.between is None else speed_noise(self.between)

    def samples_in(self, time: float) -> int:
        """Return the odd number of samples closest to a time [s]."""
        return 2 * round(0.5 * time / float(np.median(np.diff(self.t)))) + 1

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
            late = np.concatenate([delayed(late[r], self.t[r], self.late.delay) for r in self.runs])
        if self.late.lag > 0.0:
            late = np.concatenate([lagged(late[r], self.t[r], self.late.lag) for r in self.runs])
        late = late if self.hold is None else self.hold.shown(late)
        return late if self.factor == 1.0 else late * self.factor

    def thinned(self, step: int) -> Drive:
        """Return every `step`-th sample of the drive."""
        motion = self.motion
        channels = {name: values[::step] for name, values in motion.channels.items()}
        few = Motion(motion.v_left[::step], motion.v_right[::step], motion.icr, channels)
        between = None if self.between is None else self.between[::step]
        return replace(
            self, t=self.t[::step], motion=few, power=self.power[::step], between=between,
            fields={}, hold=None if self.hold is None else self.hold.thinned(step),
        )  # fmt: skip

    @cached_property
    def windows(self) -> tuple[Windows, ...]:
        """Windows of each scale."""
        period = float(np.median(np.diff(self.t)))
        return tuple(Windows.of(self.t, max(scale, 3 * period)) for scale in SCALES)


@dataclass(frozen=True)
class Windows:
    """Consecutive windows of one length over a drive.

    Parameters
    ----------
    starts : ndarray of int, shape (w,)
        First sample of each window.
    counts : ndarray, shape (w,)
        Samples in each window.
    blocks : ndarray of int, shape (w,)
        Block that each window lies in.
    length : float
        Their length [s].
    """

    starts: np.ndarray[tuple[int], np.dtype[np.intp]]
    counts: FloatArray
    blocks: np.ndarray[tuple[int], np.dtype[np.intp]]
    length: float

    @classmethod
    def of(cls, t: FloatArray, length: float) -> Windows:
        """Cut times into windows; a last one shorter than half its length joins its neighbour."""
        count = max(int(np.floor(t[-1] / length + 0.5)), 1)
        index = np.minimum((t / length).astype(np.intp), count - 1)
        _, starts = np.unique(index, return_index=True)
        counts = np.diff(np.append(starts, len(t))).astype(float)
        number = max(int(np.floor(t[-1] / BLOCK + 0.5)), 1)
        blocks = np.minimum((t[starts] / BLOCK).astype(np.intp), number - 1)
        return cls(starts.astype(np.intp), counts, blocks, length)

    def mean(self, values: FloatArray) -> FloatArray:
        """Return means over the windows; the first axis is time."""
        total = np.add.reduceat(values, self.starts, axis=0)
        return np.asarray(total / self.counts.reshape(-1, *[1] * (values.ndim - 1)))


def check_long_enough(*lists: Sequence[DriveLog]) -> None:
    """Refuse drives too short to be cut into blocks, each or all of a list together.

    Raises
    ------
    DriveLogError
        If a log is shorter than half a block, or all of a list together than two.
    """
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
    period = max(float(np.median(np.diff(drive.t))) for drive in drives)
    step = min(int(np.ceil(total / _MANY)), int(SCALES[0] / (4 * period)))
    return [drive.thinned(step) for drive in drives] if step > 1 else drives


@dataclass(frozen=True)
class Design:
    """Window means of columns and power, block by block, at every scale.

    Parameters
    ----------
    rows : tuple of ndarray, shape (w, k + 1)
        At each scale, window means of the k columns and, last, of the power; first of the total
        power at all scales, then of the difference of the sides where it is used.
    blocks : tuple of ndarray of int, shape (w,)
        At each scale, the block of each window, counted over all drives.
    drives : ndarray of int, shape (b,)
        Drive that each block belongs to.
    ended : ndarray, shape (k,), optional
        Coefficients that a fit with losses ended at, where the least squares of columns linearised
        about them lie elsewhere and explain less.
    """

    rows: tuple[FloatArray, ...]
    blocks: tuple[np.ndarray[tuple[int], np.dtype[np.intp]], ...]
    drives: np.ndarray[tuple[int], np.dtype[np.intp]]
    ended: FloatArray | None = None

    @classmethod
    def of(
        cls, drives: Sequence[Drive], columns: Sequence[FloatArray], targets: Sequence[FloatArray]
    ) -> Design:
        """Average columns, shape (n, e, k), and power, shape (n, e), of each drive over windows."""
        tables = [
            np.concatenate([values, target[..., None]], axis=-1)
            for values, target in zip(columns, targets, strict=True)
        ]
        counts = [int(drive.windows[0].blocks[-1]) + 1 for drive in drives]
        first = np.concatenate([[0], np.cumsum(counts)])
        blocks = [
            np.concatenate(
                [d.windows[k].blocks + start for d, start in zip(drives, first[:-1], strict=True)]
            )
            for k in range(len(SCALES))
        ]
        rows = window_means(drives, tables)
        owner = np.repeat(np.arange(len(drives)), counts)
        return cls(tuple(rows), tuple(blocks * (len(rows) // len(SCALES))), owner)

    @property
    def longest(self) -> tuple[FloatArray, np.ndarray[tuple[int], np.dtype[np.intp]]]:
        """Means of the total over the longest windows, and the drive of each window."""
        return self.rows[len(SCALES) - 1], self.drives[self.longest_blocks]

    @property
    def longest_blocks(self) -> NDArray[np.intp]:
        """Block of each of the longest windows."""
        return self.blocks[len(SCALES) - 1]

    def joined(self, extra: Sequence[FloatArray]) -> Design:
        """Return the design with further columns, window means at each scale, before the power."""
        rows = tuple(
            np.column_stack([table[:, :-1], more, table[:, -1]])
            for table, more in zip(self.rows, extra, strict=True)
        )
        return replace(self, rows=rows, ended=None)

    def picked(self, columns: Sequence[int]) -> Design:
        """Return the design with some of its columns."""
        keep = [*columns, -1]
        return replace(self, rows=tuple(table[:, keep] for table in self.rows))

    @property
    def comparable(self) -> bool:
        """Whether whole drives foretell each other: four or more, none with most of the driving."""
        share = np.bincount(self.drives) / len(self.drives)
        return len(share) >= 4 and float(share.max()) <= _MUCH

    def fixed(self, which: NDArray[np.bool_], values: FloatArray) -> Design:
        """Return the design without some columns, whose coefficients are given."""
        rows = tuple(
            np.column_stack(
                [table[:, :-1][:, ~which], table[:, -1] - table[:, :-1][:, which] @ values[which]]
            )
            for table in self.rows
        )
        return replace(self, rows=rows, ended=None)

    def with_folds(self, most: int) -> Design:
        """Return the design with blocks joined to `most` at most: whole drives where comparable."""
        number = self.drives if self.comparable else np.arange(len(self.drives))
        count = int(number.max()) + 1
        if count > most:
            number = number * most // count
        groups, number = np.unique(number, return_inverse=True)
        owner = np.array([self.drives[np.argmax(number == k)] for k in range(len(groups))])
        return Design(self.rows, tuple(number[block] for block in self.blocks), owner)

    def of_drives(self, chosen: NDArray[np.intp]) -> Design:
        """Return the design of some drives only, given in ascending order."""
        kept = np.isin(self.drives, chosen)
        number = np.cumsum(kept) - 1
        masks = [kept[block] for block in self.blocks]
        return Design(
            tuple(table[mask] for table, mask in zip(self.rows, masks, strict=True)),
            tuple(number[block[mask]] for block, mask in zip(self.blocks, masks, strict=True)),
            np.searchsorted(chosen, self.drives[kept]),
        )

    @cached_property
    def grams(self) -> FloatArray:
        """Gram matrix of each scale and block, power included, shape (scales, b, k+1, k+1)."""
        return np.stack(
            [
                block_grams(np.ascontiguousarray(table), block, len(self.drives))
                for table, block in zip(self.rows, self.blocks, strict=True)
            ]
        )

    @cached_property
    def counts(self) -> FloatArray:
        """Number of windows at each scale; of the sides' difference, those in which they slide."""
        return np.array(
            [
                len(table) if k < len(SCALES) else max(np.count_nonzero(table[:, -1]), 1)
                for k, table in enumerate(self.rows)
            ],
            float,
        )

    @cached_property
    def telling(self) -> NDArray[np.bool_]:
        """Blocks that say something: those of a robot at rest are no evidence of anything."""
        power = np.abs(np.diagonal(self.grams[0], axis1=-2, axis2=-1)[:, :2])
        share = power / np.maximum(power.mean(axis=0), 1e-300)
        found: NDArray[np.bool_] = np.any(share > _IDLE, axis=1)
        return found

    @property
    def evidence(self) -> FloatArray:
        """Number of windows at each scale in blocks that say something."""
        return np.asarray(self.counts * float(np.mean(self.telling)))


def window_means(drives: Sequence[Drive], columns: Sequence[FloatArray]) -> list[FloatArray]:
    """Window means of columns, shape (n, e, k), of all drives: of one equation after the other."""
    means = [
        np.concatenate(
            [drive.windows[k].mean(values) for drive, values in zip(drives, columns, strict=True)]
        )
        for k in range(len(SCALES))
    ]
    equations = columns[0].shape[1]
    return [np.ascontiguousarray(table[:, e]) for e in range(equations) for table in means]


def channels_of(drives: Sequence[Drive]) -> frozenset[str]:
    """Return the channels that every drive carries."""
    common: Mapping[str, object] = drives[0].motion.channels
    names = set(common)
    for drive in drives[1:]:
        names &= set(drive.motion.channels)
    return frozenset(names)
