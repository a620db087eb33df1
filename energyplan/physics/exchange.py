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

    Parameters
    ----------
    gain : callable
        ``gain(before, after)``: by how much products of regressors are better.
    grams : sequence of ndarray
        Products of regressors of each part that there is.
    times : ndarray, shape (n,)
        Time that each takes [s].
    chosen : sequence of int
        The design to begin with.
    duration : float
        Longest time that it may take [s].

    Returns
    -------
    list of int
        A design as long that is no worse.

    References
    ----------
    Fedorov (1972), "Theory of optimal experiments".

    Examples
    --------
    >>> better = lambda before, after: float(after[0, 0] - before[0, 0])
    >>> grams = [np.array([[value]]) for value in (1.0, 3.0, 9.0)]
    >>> exchanged(better, grams, np.array([1.0, 1.0, 5.0]), [0, 0], 3.0)
    [1, 1]
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
