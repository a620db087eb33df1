"""Columns of power terms on a drive, what contacts hold, window means (private)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d, minimum_filter1d, uniform_filter1d

from energyplan.compilation import AnyInts, AnyTable, FloatBlock, njit
from energyplan.fit.drive import (
    MOMENT,
    ON_TIME,
    SCALES,
    Drive,
    columns_of,
    field_of,
    of_equations,
    speed_noise,
)
from energyplan.motion import Motion
from energyplan.path import FloatArray
from energyplan.power import DRIVE_LOSS, REGENERATION_LOSS, SLIP, PowerModel, Sides, Term
from energyplan.vehicle import Vehicle

# -- what contacts that hold push the sides against each other by ----------------------------------

_BISECTIONS = 16
_INSIDE = 12  # bisections by which a moment differs from its limit
_TOLD = 5.0  # noise that the largest moment exceeds where its size can be told
_GAP = 2.0  # time for which contacts may slide within what is one stretch [s]
_LONGEST = 4.0  # time for which they hold one moment where steering drifts, at most [s]
_STATIC = 1.5  # moment that contacts hold, over that of sliding, at most
_FEW = 3  # moving windows, or samples, that tell a scatter
_NOTHING = 0.01  # of the root mean square power, that a mean is known to at best
_USUAL = 1  # scale of the windows that tell what a model misses: two seconds


def lost_power(
    losses: Sequence[tuple[Term, float]], motion: Motion, vehicle: Vehicle, forces: Sides
) -> Sides:
    """Power of each side that losses take [W]."""
    whole = Sides(np.zeros(motion.shape), np.zeros(motion.shape))
    for term, value in losses:
        whole = whole + term.function(motion, vehicle, forces, **term.params) * value
    return whole


@dataclass(frozen=True)
class Held:
    """Samples at which contacts hold: their motion, forces, and what losses take without more."""

    vehicle: Vehicle
    losses: Sequence[tuple[Term, float]]
    motion: Motion
    forces: Sides
    without: FloatArray

    @classmethod
    def of(
        cls, drive: Drive, vehicle: Vehicle, losses: Sequence[tuple[Term, float]], forces: Sides,
        some: slice | NDArray[np.intp] = slice(None),
    ) -> Held:  # fmt: skip
        """Take some of the samples of a drive at which contacts hold."""
        held, at = drive.held, np.flatnonzero(drive.holds)[some]
        channels = {name: values[at] for name, values in held.channels.items()}
        motion = Motion(held.v_left[at], held.v_right[at], held.icr, channels)
        own = Sides(forces.left[at], forces.right[at])
        return cls(vehicle, losses, motion, own, lost_power(losses, motion, vehicle, own).total)

    def _lost(self, moment: FloatArray) -> tuple[Sides, Sides]:
        """Tread forces with a moment between the sides, and what losses take of them."""
        push = moment / self.motion.icr.slip_track
        acting = Sides(self.forces.left - push, self.forces.right + push)
        return acting, lost_power(self.losses, self.motion, self.vehicle, acting)

    def cost(self, moment: FloatArray) -> FloatArray:
        """Power that losses take because of a moment between the sides [W]."""
        return np.asarray(self._lost(moment)[1].total - self.without)

    def powers(self, moment: FloatArray) -> Sides:
        """Power of each side with a moment between them [W]."""
        acting, lost = self._lost(moment)
        through = Sides(acting.left * self.motion.v_left, acting.right * self.motion.v_right)
        return through + lost


@dataclass(frozen=True)
class Preload:
    """The moment by which the sides push against each other while contacts hold."""

    moment: FloatArray  # (n,): the moment [N m]
    forces: Sides  # tread forces of the moment [N]
    told: FloatArray  # (n,) [W/(N m)]
    cost: FloatArray  # (n,): by how much the total rises with it [W/(N m)]
    ends: FloatArray  # (n,)
    sure: FloatArray  # (n,): mean square of `told` over the samples around each
    width: int  # samples over which it is taken for one
    alone: NDArray[np.bool_]  # (n,): samples that have a moment of their own

    def followed(self, between: FloatArray, limits: FloatArray) -> FloatArray:
        """Return by how much the total falls as the moment follows coefficients."""
        pulled = self.told[:, None] * between - self.ends[:, None] * limits
        moved = _smoothed(pulled, self.width, self.alone)
        return np.asarray((self.cost / self.sure)[:, None] * moved)


def _alone(held: NDArray[np.bool_], width: int) -> NDArray[np.bool_]:
    """Tell which held samples cannot be averaged over so many with their neighbours."""
    long = maximum_filter1d(minimum_filter1d(held.astype(float), width), width) > 0.0
    beside = maximum_filter1d((~held).astype(float), 3) > 0.0
    return np.asarray(held & (beside | ~long))


def _smoothed(values: FloatArray, width: int, alone: NDArray[np.bool_]) -> FloatArray:
    """Return means over so many samples along the first axis, but of those that stand alone."""
    alone = alone.reshape(-1, *[1] * (values.ndim - 1))
    means = uniform_filter1d(np.where(alone, 0.0, values), width, axis=0)
    return np.where(alone, values, means)


def preload(
    drive: Drive,
    between: FloatArray,
    vehicle: Vehicle,
    losses: Sequence[tuple[Term, float]],
    forces: Sides,
    limit: float,
) -> Preload:
    """Find the moment between the sides from the measured difference of their powers."""
    at, held = drive.holds, Held.of(drive, vehicle, losses, forces)
    sign = np.sign(held.motion.v_left + held.motion.v_right)
    track = drive.motion.icr.slip_track
    wanted = drive.in_time(between)[at]

    def too_large(moment: FloatArray) -> NDArray[np.bool_]:
        both = held.powers(moment)
        return np.asarray(sign * (both.right - both.left - wanted) > 0.0)

    if losses:
        found = _bisected(too_large, np.full(len(wanted), -limit), np.full(len(wanted), limit))
    else:
        speed, still = held.motion.v_left + held.motion.v_right, held.powers(np.zeros(len(wanted)))
        free = track * (wanted - still.right + still.left)
        found = np.divide(free, speed, out=np.zeros(len(free)), where=speed != 0.0)
        found = np.clip(found, -limit, limit)
    step = max(1e-3 * limit, 1e-9)
    ahead, behind = held.powers(found + step), held.powers(found - step)
    rise = sign * ((ahead.right - ahead.left) - (behind.right - behind.left)) / (2 * step)
    clear = rise * limit > _TOLD * drive.between_noise
    inside = clear & (np.abs(found) < (1.0 - 2.0**-_INSIDE) * limit)
    weight, moment, told, cost, ends = (np.zeros(len(drive.t)) for _ in range(5))
    weight[at] = np.where(clear, rise, 0.0) ** 2
    moment[at] = found
    told[at] = np.where(inside, sign * rise, 0.0)
    ends[at] = np.where(clear & ~inside, np.sign(found) * rise**2, 0.0)
    width = drive.samples_in(MOMENT)
    alone = _alone(at, width)
    sure = _smoothed(weight, width, alone)
    driving = at & ((drive.held.v_left != 0.0) | (drive.held.v_right != 0.0)) & (sure > 0.0)
    sure = np.where(driving, sure, 1.0)
    smooth = np.where(driving, _smoothed(weight * moment, width, alone) / sure, 0.0)
    cost[at] = (held.cost(smooth[at] + step) - held.cost(smooth[at] - step)) / (2 * step)
    cost = np.where(driving, cost, 0.0)
    forces = Sides(-smooth / track, smooth / track)
    return Preload(smooth, forces, told, cost, ends, sure, width, alone)


def _bisected(
    too_large: Callable[[FloatArray], NDArray[np.bool_]], low: FloatArray, high: FloatArray
) -> FloatArray:
    """Return the largest moments, between bounds, that are not too large."""
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        above = too_large(middle)
        low, high = np.where(above, low, middle), np.where(above, middle, high)
    return 0.5 * (low + high)


def _told(
    share: FloatArray, most: FloatArray, error: FloatArray
) -> tuple[FloatArray, NDArray[np.bool_], FloatArray]:
    """Tell which stretches hold a moment, at what share of its largest cost, and at what odds."""
    error = np.where(error > 0.0, error, np.inf)  # without a known error nothing is told
    taken = np.clip(share, 0.0, 1.0)
    gain = 0.5 * (most / error) ** 2 * taken * (2.0 * share - taken)
    odds = np.log(np.maximum(most / (np.sqrt(2.0 * np.pi) * error), 1e-300))
    return taken, (odds > 0.0) & (gain > odds), odds


@dataclass(frozen=True)
class Straights:
    """What contacts hold on each stretch on which they do, told by the total power alone."""

    forces: Sides  # tread forces of the moments [N]
    pattern: FloatArray  # (n,) [W]
    label: NDArray[np.intp]  # (n,): stretch that each sample shows, as the log does
    odds: float  # logarithm of what it took from the likelihood that the moments were not known

    def without(self, table: FloatArray) -> FloatArray:
        """Take from columns, shape (n, ...), what an unknown moment would take up of them."""
        at = np.flatnonzero(self.pattern)
        if not len(at):
            return table
        table = np.array(table)
        pattern, label = self.pattern[at], self.label[at]
        count = int(label.max()) + 1
        size = np.bincount(label, pattern**2, count)
        flat = table.reshape(len(table), -1)
        for k in range(flat.shape[1]):
            share = np.bincount(label, pattern * flat[at, k], count) / np.maximum(size, 1e-300)
            flat[at, k] -= share[label] * pattern
        return flat.reshape(table.shape)


def straights(
    drive: Drive,
    vehicle: Vehicle,
    losses: Sequence[tuple[Term, float]],
    forces: Sides,
    limit: float,
    power: FloatArray,
) -> Straights | None:
    """Find the moments between the sides from what a drive's total power shows beyond a model."""
    at = np.flatnonzero(drive.holds)
    if not len(at) or not limit > 0.0:
        return None
    limit *= _STATIC
    label, shown = _stretches(drive), _shown(drive)
    count = int(label[-1]) + 1
    held = Held.of(drive, vehicle, losses, forces)
    ends = [held.cost(np.full(len(at), sign * limit)) for sign in (-1.0, 1.0)]
    means = [np.bincount(label, end, count) for end in ends]
    sign = np.where(means[1] >= means[0], 1.0, -1.0)
    most = np.maximum(np.where(sign[label] > 0.0, ends[1], ends[0]), 0.0)

    whole = np.zeros(len(drive.t))
    whole[at] = most
    pattern = np.asarray(drive.seen(whole))
    size = np.bincount(shown, pattern**2, count)
    total = np.bincount(shown, pattern, count)
    width = np.divide(size, total, out=np.zeros(count), where=total > 0.0)
    beyond = drive.power - power
    share = np.bincount(shown, pattern * beyond, count) / np.maximum(size, 1e-300)
    samples = np.divide(total**2, size, out=np.ones(count), where=size > 0.0)
    error = _error(drive, beyond, samples)
    taken, free, odds = _told(share, width, error)
    if not free.any():
        return None
    some = np.flatnonzero(free[label])
    mine, pull = label[some], most[some]
    wanted = taken * np.bincount(mine, pull**2, count)
    few = Held.of(drive, vehicle, losses, forces, some)

    def too_large(held: FloatArray) -> NDArray[np.bool_]:
        return ~(np.bincount(mine, pull * few.cost((sign * held)[mine]), count) < wanted)

    found = _bisected(too_large, np.zeros(count), np.full(count, limit))
    moment = np.zeros(len(drive.t))
    moment[at[some]] = (sign * np.where(taken < 1.0, found, limit))[mine]
    push = moment / drive.motion.icr.slip_track
    inside = free & (taken < 1.0)
    return Straights(
        Sides(-push, push), np.where(inside[shown], pattern, 0.0), shown, float(odds[free].sum())
    )


def _stretches(drive: Drive) -> NDArray[np.intp]:
    """Return the number of the stretch that each sample at which contacts hold belongs to."""
    if "stretches" not in drive.fields:
        at = np.flatnonzero(drive.holds)
        t, way = drive.t[at], np.sign(drive.held.v_left[at])  # which is that of both
        slid = np.diff(t) > _GAP
        turns = np.concatenate([[at[0] > 0], slid, [at[-1] < len(drive.t) - 1]])
        starts = np.concatenate([[True], (np.diff(way) != 0.0) | slid])
        whole = np.cumsum(starts) - 1
        first = np.flatnonzero(starts)
        last = np.append(first[1:], len(at)) - 1
        long = t[last] - t[first] > 3.0 * MOMENT
        begins = (long & turns[first])[whole] & (t - t[first][whole] < MOMENT)
        ends = (long & turns[last + 1])[whole] & (t[last][whole] - t < MOMENT)
        since, lasts = t - t[first][whole], (t[last] - t[first])[whole]
        longest = _LONGEST if drive.breakaway > 0.0 else np.inf
        pieces = np.maximum(np.ceil(lasts / longest), 1.0)
        piece = np.minimum(np.floor(since * pieces / np.maximum(lasts, 1e-9)), pieces - 1)
        part = np.where(begins, -1.0, np.where(ends, -2.0, piece))
        new = (np.diff(whole, prepend=0) != 0) | (np.diff(part, prepend=part[0]) != 0.0)
        drive.fields["stretches"] = np.cumsum(new).astype(np.intp)
    found: NDArray[np.intp] = drive.fields["stretches"]
    return found


def _shown(drive: Drive) -> NDArray[np.intp]:
    """Return the stretch that each sample of the log shows: late, and until the next one."""
    key = ("shown", drive.late.delay)
    if key not in drive.fields:
        at = np.flatnonzero(drive.holds)
        seen = np.searchsorted(drive.t[at], drive.t - drive.late.delay, side="right") - 1
        drive.fields[key] = _stretches(drive)[np.maximum(seen, 0)]
    found: NDArray[np.intp] = drive.fields[key]
    return found


def _error(drive: Drive, beyond: FloatArray, samples: FloatArray) -> FloatArray:
    """Return the standard error of means over so many samples [W]: noise, and what is missed."""
    windows = drive.windows[_USUAL]
    if "moving" not in drive.fields:
        speed = np.abs(drive.motion.v_left) + np.abs(drive.motion.v_right)
        drive.fields["moving"] = windows.mean(speed) > 0.0
    moving: NDArray[np.bool_] = drive.fields["moving"]
    means = windows.mean(beyond)
    usual = 1.4826 * float(np.median(np.abs(means[moving]))) if moving.sum() >= _FEW else 0.0
    nothing = _NOTHING * float(np.sqrt(np.mean(drive.power**2)))
    if "noise" not in drive.fields:
        drive.fields["noise"] = speed_noise(drive.power) if len(drive.power) > _FEW else 0.0
    noise: float = drive.fields["noise"]
    return np.asarray(np.sqrt(usual**2 + nothing**2 + noise**2 / samples))


# -- a drive's power about given coefficients, and its derivatives ---------------------------------

_STEP = 1e-4


@dataclass(frozen=True)
class Linear:
    """Power of a drive and its derivatives, as `Drive.observed` shows them."""

    power: FloatArray  # (n, e): predicted power of each equation [W]
    columns: FloatArray  # (n, e, k): its derivative by each coefficient [W per unit]
    odds: float = 0.0


def is_lossy(drive: Drive, terms: Sequence[Term]) -> bool:
    """Tell whether the power is not linear in the coefficients."""
    return drive.battery or any(term.kind == "loss" for term in terms)


def linearise_drive(
    drive: Drive,
    vehicle: Vehicle,
    terms: Sequence[Term],
    values: FloatArray,
    wanted: Sequence[int] | None = None,
) -> Linear:
    """Linearise the power of a drive about coefficients."""
    held = drive.held
    losses = losses_of(drive, vehicle, terms, values)
    total = held_forces(drive, vehicle, terms, values)
    fight = held_by = power = None
    limit = vehicle.slip_moment * slip_limit(terms, values)
    if drive.between is not None and is_lossy(drive, terms):
        fight = preload(drive, drive.between, vehicle, losses, total, limit)
        total = total + fight.forces
    elif drive.fitted and losses:
        power = _power(drive, vehicle, terms, values, losses, total)
        shown = drive.observed(power)[:, 0]
        held_by = straights(drive, vehicle, losses, total, limit, shown)
        if held_by is not None:
            total, power = total + held_by.forces, None
    if power is None:
        power = _power(drive, vehicle, terms, values, losses, total)

    rise = _rise(losses, drive, vehicle, total) if losses else None
    columns, held_apart, limits = [], [], []
    for k in range(len(terms)) if wanted is None else wanted:
        term = terms[k]
        if term.kind == "loss":
            own = of_equations(term.function(held, vehicle, total, **term.params), drive)
        else:
            own = columns_of(term, drive, vehicle)
        apart = own[:, -1]  # what it makes the sides differ by where contacts hold
        if term.kind == "force" and rise is not None:
            acting = field_of(term, drive, vehicle, held=True)
            lost = rise.left * acting.left[:, None] + rise.right * acting.right[:, None]
            own = own + lost
            if fight is not None:
                apart = acting.right * held.v_right - acting.left * held.v_left + lost[:, -1]
        columns.append(own)
        held_apart.append(apart)
        limits.append(vehicle.slip_moment if term.name == SLIP.name else 0.0)
    table = np.stack(columns, axis=-1) if columns else np.zeros((*power.shape, 0))
    if fight is not None and columns:
        apart = np.stack(held_apart, axis=-1)
        table[:, 0] -= fight.followed(apart, np.array(limits))
    shown = drive.observed(table)
    if held_by is not None:
        return Linear(drive.observed(power), held_by.without(shown), held_by.odds)
    return Linear(drive.observed(power), shown)


def _power(
    drive: Drive,
    vehicle: Vehicle,
    terms: Sequence[Term],
    values: FloatArray,
    losses: Sequence[tuple[Term, float]],
    forces: Sides,
) -> FloatArray:
    """Power in each equation, before a log shows it late, shape (n, equations) [W]."""
    power = np.zeros((len(drive.t), drive.equations))
    if losses:
        power = power + of_equations(lost_power(losses, drive.held, vehicle, forces), drive)
    for term, value in zip(terms, values, strict=True):
        if term.kind != "loss":
            power = power + float(value) * columns_of(term, drive, vehicle)
    return power


def equations_of(model: PowerModel, drive: Drive) -> FloatArray:
    """Return the power of a drive by a model in each equation, as the log shows it [W]."""
    for term in model.terms:
        for name in term.channels:
            drive.motion.channel(name, f"the term {term.name!r}")
    return linearise_drive(drive, model.vehicle, model.terms, model.coefficients, ()).power


def power_of(model: PowerModel, drive: Drive) -> FloatArray:
    """Return the power of a drive by a model, with contacts that hold on a straight [W]."""
    alone = replace(drive, between=None, fitted=False, late=ON_TIME, hold=None)
    return equations_of(model, alone)[:, 0]


def losses_of(
    drive: Drive, vehicle: Vehicle, terms: Sequence[Term], values: FloatArray
) -> list[tuple[Term, float]]:
    """Return the losses that are there, with their coefficients, known efficiencies included."""
    names = {term.name for term in terms}
    losses = [
        (term, float(value)) for term, value in zip(terms, values, strict=True)
        if term.kind == "loss" and value != 0.0
    ]  # fmt: skip
    if drive.battery:
        known = (
            (DRIVE_LOSS, 1 / vehicle.drive_efficiency - 1),
            (REGENERATION_LOSS, 1 - vehicle.regen_efficiency),
        )
        losses += [(term, value) for term, value in known if term.name not in names and value > 0]
    return losses


def held_forces(drive: Drive, vehicle: Vehicle, terms: Sequence[Term], values: FloatArray) -> Sides:
    """Tread forces of a drive with contacts that hold, without what they hold [N]."""
    total = Sides(np.zeros(drive.motion.shape), np.zeros(drive.motion.shape))
    for term, value in zip(terms, values, strict=True):
        if term.kind == "force":
            total = total + field_of(term, drive, vehicle, held=True) * float(value)
    return total


def slip_limit(terms: Sequence[Term], values: FloatArray) -> float:
    """Return the friction coefficient that bounds what contacts hold."""
    for term, value in zip(terms, values, strict=True):
        if term.name == SLIP.name:
            return max(float(value), 0.0)
    return 0.0


def _rise(
    losses: Sequence[tuple[Term, float]], drive: Drive, vehicle: Vehicle, forces: Sides
) -> Sides:
    """Rise of the losses in each equation with the force of each side, (n, equations) each."""
    size = max(float(np.max(np.abs(forces.left))), float(np.max(np.abs(forces.right))), 1.0)
    step = _STEP * size

    def lost(left: float, right: float) -> FloatArray:
        moved = Sides(forces.left + left, forces.right + right)
        return of_equations(lost_power(losses, drive.held, vehicle, moved), drive)

    return Sides(
        (lost(step, 0.0) - lost(-step, 0.0)) / (2 * step),
        (lost(0.0, step) - lost(0.0, -step)) / (2 * step),
    )


# -- drives as regression data: columns averaged over windows of several lengths -------------------


@njit
def block_grams(table: AnyTable, block: AnyInts, count: int) -> FloatBlock:
    """Gram matrix of the rows of each block, shape (count, k, k)."""
    rows, width = table.shape
    total = np.zeros((count, width, width))
    for n in range(rows):
        into = total[block[n]]
        for i in range(width):
            for j in range(i + 1):
                into[i, j] += table[n, i] * table[n, j]
    for b in range(count):
        for i in range(width):
            for j in range(i):
                total[b, j, i] = total[b, i, j]
    return total


_MUCH = 0.4  # share of all blocks that no drive may exceed to be left out as a whole
_IDLE = 0.01  # share of the usual size of a block's columns below which it says nothing


@dataclass(frozen=True)
class Design:
    """Window means of columns and power, block by block, at every scale."""

    rows: tuple[FloatArray, ...]  # (w, k + 1)
    blocks: tuple[np.ndarray[tuple[int], np.dtype[np.intp]], ...]  # (w,)
    drives: np.ndarray[tuple[int], np.dtype[np.intp]]  # (b,): drive that each block belongs to
    ended: FloatArray | None = None  # (k,)

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
