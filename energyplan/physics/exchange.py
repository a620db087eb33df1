"""A design improved by exchanging one part of it after the other."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from energyplan.path import FloatArray

_MOST = 20  # exchanges
_WORTH = 1e-3  # gain of the criterion that is worth one


def exchanged(
    gain: Callable[[FloatArray, FloatArray], float],
    grams: Sequence[FloatArray],
    times: FloatArray,
    chosen: Sequence[int],
    duration: float,
) -> list[int]:
    """Exchange parts of a design, one at a time, for what improves the whole of it most.

    Source: Fedorov (1972), "Theory of optimal experiments".
    """
    design = list(chosen)
    for _ in range(_MOST):
        whole = np.sum([grams[k] for k in design], axis=0)
        left = duration - float(times[design].sum())
        best, swap = 0.0, (0, 0)
        for place, old in enumerate(design):
            rest = whole - grams[old]
            for new in np.flatnonzero(times <= left + times[old]).tolist():
                more = gain(whole, rest + grams[new]) if new != old else 0.0
                if more > best:
                    best, swap = more, (place, new)
        if not best > _WORTH:
            break
        design[swap[0]] = swap[1]
    return design
