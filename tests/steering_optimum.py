"""An independent optimum for steering: a linear program over discretised headings.

For a range of headings that the motion visits, the cheapest motion is a linear program: how far to
turn left and right within each cell of headings, at which of the cost's corner elements, and how
far to drive straight at each heading. Any walk over the range is allowed, with any number of
reversals; only that every cell is visited, and that the walk leads from start to goal, is asked.
The range is then searched. Within a cell the robot drives an arc, so every solution is a motion
that can be driven: the program's optimum is never below the true one, and approaches it with the
square of the cell's width.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linprog, minimize
from scipy.sparse import coo_matrix

FEWEST = 8  # cells of each part of the range, so that short excursions are resolved too


@dataclass(frozen=True)
class Corners:
    """Elements of motion: turns with (m = ds/dtheta, joules per radian), straight joules per m."""

    left: tuple[tuple[float, float], ...]
    right: tuple[tuple[float, float], ...]
    ahead: float
    behind: float


def _towards(heading: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.array([np.cos(heading), np.sin(heading)])


def _range_optimum(
    d: NDArray[np.float64], turn: float, lo: float, hi: float, corners: Corners, cell: float
) -> float:
    """Cheapest motion that visits the headings from -lo to turn + hi (or the mirror of it)."""
    sign = 1.0 if turn >= 0 else -1.0
    span = abs(turn)
    pieces = [(-lo, 0.0, 0.0), (0.0, span, 1.0), (span, span + hi, 0.0)]
    edges, net = [-lo], []
    for a, b, flow in pieces:
        # An even number, for switches in the middle of the range are common.
        n = 2 * max(int(np.ceil((b - a) / (2 * cell))), FEWEST // 2) if b > a else 0
        edges += list(np.linspace(a, b, n + 1)[1:]) if n else []
        net += [flow] * n
    edges_, flow_ = np.array(edges), np.array(net)
    width, middle = np.diff(edges_), 0.5 * (edges_[1:] + edges_[:-1])
    n = len(width)
    outward, back = (corners.left, corners.right)[:: 1 if sign > 0 else -1]
    m, g = np.array([*outward, *back]).T
    net_turn = np.repeat([1.0, -1.0], [len(outward) * n, len(back) * n])
    # a column for each element in each cell, then one for each way ahead and behind
    arcs = np.sinc(width / (2 * np.pi)) * _towards(sign * middle)
    ahead = _towards(sign * edges_)
    xy = np.hstack([*(m_ * arcs for m_ in m), ahead, -ahead])
    cost = np.concatenate([np.repeat(g, n), np.repeat([corners.ahead, corners.behind], n + 1)])
    cells, turning, columns = np.tile(np.arange(n), len(m)), len(m) * n, len(cost)
    rows = np.concatenate([np.repeat([0, 1], columns), cells + 2])
    cols = np.concatenate([np.arange(columns), np.arange(columns), np.arange(turning)])
    values = np.concatenate([xy.ravel(), net_turn])
    equal = coo_matrix((values, (rows, cols)), shape=(n + 2, columns))
    passes = coo_matrix((-np.ones(turning), (cells, np.arange(turning))), shape=(n, columns))
    found = linprog(
        cost,
        A_eq=equal,
        b_eq=np.concatenate([d, flow_ * width]),
        A_ub=passes if n else None,
        b_ub=-width * np.where(flow_ == 0.0, 2.0, 1.0) if n else None,  # out and back again
        method="highs",
        options={"primal_feasibility_tolerance": 1e-10, "dual_feasibility_tolerance": 1e-10},
    )
    return float(found.fun) if found.status == 0 else np.inf


def optimum(d: NDArray[np.float64], turn: float, corners: Corners, cell: float = 0.04) -> float:
    """Least energy from the pose (0, 0, 0) to (d, turn), from above."""
    best = np.inf
    for way in (turn % (2 * np.pi), turn % (2 * np.pi) - 2 * np.pi):
        coarse = sorted(
            (_range_optimum(d, way, lo, hi, corners, 0.3), lo, hi)
            for lo in (0.0, 0.05, 0.2, 0.6)
            for hi in (0.0, 0.05, 0.2, 0.6)
        )
        if coarse[0][0] > 1.2 * best:
            continue
        starts = [row for row in coarse[:2] if row[0] < 1.2 * min(best, coarse[0][0])]
        for _, lo, hi in starts:
            free = np.array([lo > 0, hi > 0])

            def value(e: NDArray[np.float64], way: float = way) -> float:
                return _range_optimum(d, way, abs(e[0]), abs(e[1]), corners, cell)

            base = np.array([lo, hi])
            best = min(best, value(base))
            if not free.any():
                continue
            axes = np.flatnonzero(free)

            def along(
                v: NDArray[np.float64],
                base: NDArray[np.float64] = base,
                axes: NDArray[np.int64] = axes,
            ) -> float:
                e = base.copy()
                e[axes] = v
                return value(e)

            found = minimize(
                along,
                base[axes],
                method="Nelder-Mead",
                options={"xatol": 5e-4, "fatol": 1e-6, "maxfev": 50},
            )
            best = min(best, float(found.fun))
    return best
