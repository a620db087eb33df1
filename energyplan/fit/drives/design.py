"""Drives as regression data: columns averaged over windows of several lengths (private).

A residual has causes on several time scales: inertia lives in the ramps, a hotel load or a slope
in whole manoeuvres. Least squares on single samples sees mostly noise and ramps. Here every drive
is averaged over windows of half a second, two and eight seconds, and an error counts relative to
the present error on its own scale.

Where the power of both sides was logged there are two equations: for their sum, and for what the
right side draws more than the left one (docs/theory, section 6).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from energyplan.compilation import AnyInts, AnyTable, FloatBlock, njit
from energyplan.fit.drives.drive import Drive
from energyplan.fit.drives.windows import SCALES
from energyplan.path import FloatArray


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
