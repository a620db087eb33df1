"""Sums of products over blocks of windows, compiled (private).

With a million samples the products of all columns at each window would take gigabytes; here they
go straight into the sum of their block.
"""

from __future__ import annotations

import numpy as np

from energyplan.compilation import AnyInts, AnyTable, FloatBlock, njit


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
