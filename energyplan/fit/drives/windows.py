"""Consecutive windows of a drive, whose means a fit explains (private)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from energyplan.path import FloatArray

SCALES = (0.5, 2.0, 8.0)
"""Window lengths [s]; each divides the next."""

BLOCK = 8.0
"""Length of the blocks that cross-validation leaves out [s]."""


@dataclass(frozen=True)
class Windows:
    """Consecutive windows of one length over a drive."""

    starts: np.ndarray[tuple[int], np.dtype[np.intp]]  # (w,): first sample of each window
    counts: FloatArray  # (w,): samples in each window
    blocks: np.ndarray[tuple[int], np.dtype[np.intp]]  # (w,)
    length: float  # their length [s]

    @classmethod
    def of(cls, t: FloatArray, length: float) -> Windows:
        """Cut times into windows; a last one shorter than half its length joins its neighbour."""
        count = max(int(np.floor(t[-1] / length + 0.5)), 1)
        index = np.minimum((t / length).astype(np.intp), count - 1)
        _, starts = np.unique(index, return_index=True)
        counts = np.diff(np.append(starts, len(t))).astype(float)
        number = max(int(np.floor(t[-1] / BLOCK + 0.5)), 1)
        block = np.minimum((t / BLOCK).astype(np.intp), number - 1)
        blocks = np.searchsorted(np.unique(block), block[starts])
        return cls(starts.astype(np.intp), counts, blocks, length)

    def mean(self, values: FloatArray) -> FloatArray:
        """Return means over the windows; the first axis is time."""
        total = np.add.reduceat(values, self.starts, axis=0)
        return np.asarray(total / self.counts.reshape(-1, *[1] * (values.ndim - 1)))
