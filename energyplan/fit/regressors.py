"""Columns of power terms on a drive, losses linearised, window means (private)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from energyplan.compilation import AnyInts, AnyTable, FloatBlock, njit
from energyplan.fit.contacts import lost_power, preload
from energyplan.fit.drive import (
    ON_TIME,
    SCALES,
    Drive,
    columns_of,
    field_of,
    of_equations,
)
from energyplan.path import FloatArray
from energyplan.power import DRIVE_LOSS, REGENERATION_LOSS, SLIP, PowerModel, Sides, Term
from energyplan.vehicle import Vehicle

# -- a drive's power about given coefficients, and its derivatives ---------------------------------

_STEP = 1e-4


@dataclass(frozen=True)
class Linear:
    """Power of a drive and its derivatives, as `Drive.observed` shows them."""

    power: FloatArray  # (n, e): predicted power of each equation [W]
    columns: FloatArray  # (n, e, k): its derivative by each coefficient [W per unit]


def is_lossy(drive: Drive, terms: Sequence[Term]) -> bool:
    """Return whether the power is not linear in the coefficients."""
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
    fight = None
    if drive.between is not None and is_lossy(drive, terms):
        limit = vehicle.slip_moment * slip_limit(terms, values)
        fight = preload(drive, drive.between, vehicle, losses, total, limit)
        total = total + fight.forces
    power = _power(drive, vehicle, terms, values, losses, total)

    rise = _rise(losses, drive, vehicle, total) if losses else None
    columns, held_differences, limits = [], [], []
    for k in range(len(terms)) if wanted is None else wanted:
        term = terms[k]
        if term.kind == "loss":
            own = of_equations(term.function(held, vehicle, total, **term.params), drive)
        else:
            own = columns_of(term, drive, vehicle)
        difference = own[:, -1]  # what it makes the sides differ by where contacts hold
        if term.kind == "force" and rise is not None:
            acting = field_of(term, drive, vehicle, held=True)
            lost = rise.left * acting.left[:, None] + rise.right * acting.right[:, None]
            own = own + lost
            if fight is not None:
                difference = acting.right * held.v_right - acting.left * held.v_left + lost[:, -1]
        columns.append(own)
        held_differences.append(difference)
        limits.append(vehicle.slip_moment if term.name == SLIP.name else 0.0)
    table = np.stack(columns, axis=-1) if columns else np.zeros((*power.shape, 0))
    if fight is not None and columns:
        difference = np.stack(held_differences, axis=-1)
        table[:, 0] -= fight.followed(difference, np.array(limits))
    return Linear(drive.observed(power), drive.observed(table))


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
    alone = replace(drive, between=None, late=ON_TIME, hold=None)
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
_IDLE = 0.01  # share of the typical size of a block's columns below which it is not used


@dataclass(frozen=True)
class DesignMatrix:
    """Window means of columns and power, block by block, at every scale."""

    rows: tuple[FloatArray, ...]  # (w, k + 1)
    blocks: tuple[np.ndarray[tuple[int], np.dtype[np.intp]], ...]  # (w,)
    drives: np.ndarray[tuple[int], np.dtype[np.intp]]  # (b,): drive that each block belongs to
    ended: FloatArray | None = None  # (k,)

    @classmethod
    def of(
        cls, drives: Sequence[Drive], columns: Sequence[FloatArray], targets: Sequence[FloatArray]
    ) -> DesignMatrix:
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

    def joined(self, extra: Sequence[FloatArray]) -> DesignMatrix:
        """Return the design with further columns, window means at each scale, before the power."""
        rows = tuple(
            np.column_stack([table[:, :-1], more, table[:, -1]])
            for table, more in zip(self.rows, extra, strict=True)
        )
        return replace(self, rows=rows, ended=None)

    def picked(self, columns: Sequence[int]) -> DesignMatrix:
        """Return the design with some of its columns."""
        keep = [*columns, -1]
        return replace(self, rows=tuple(table[:, keep] for table in self.rows))

    @property
    def comparable(self) -> bool:
        """Whether whole drives predict each other: four or more, none with most of the driving."""
        share = np.bincount(self.drives) / len(self.drives)
        return len(share) >= 4 and float(share.max()) <= _MUCH

    def fixed(self, which: NDArray[np.bool_], values: FloatArray) -> DesignMatrix:
        """Return the design without some columns, whose coefficients are given."""
        rows = tuple(
            np.column_stack(
                [table[:, :-1][:, ~which], table[:, -1] - table[:, :-1][:, which] @ values[which]]
            )
            for table in self.rows
        )
        return replace(self, rows=rows, ended=None)

    def with_folds(self, most: int) -> DesignMatrix:
        """Return the design with blocks joined to `most` at most: whole drives where comparable."""
        number = self.drives if self.comparable else np.arange(len(self.drives))
        count = int(number.max()) + 1
        if count > most:
            number = number * most // count
        groups, number = np.unique(number, return_inverse=True)
        owner = np.array([self.drives[np.argmax(number == k)] for k in range(len(groups))])
        return DesignMatrix(self.rows, tuple(number[block] for block in self.blocks), owner)

    def of_drives(self, chosen: NDArray[np.intp]) -> DesignMatrix:
        """Return the design of some drives only, given in ascending order."""
        kept = np.isin(self.drives, chosen)
        number = np.cumsum(kept) - 1
        masks = [kept[block] for block in self.blocks]
        return DesignMatrix(
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
