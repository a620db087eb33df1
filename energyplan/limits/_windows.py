"""Windows of a thermal limit on a profile, and linear programs over the times in them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linprog
from scipy.sparse import csr_array, diags_array, hstack, vstack

from energyplan.path import FloatArray

KNOTS, CLOSE = 12, 24
"""Knots per thermal window between which a program changes rates: at least, and on short paths."""

SHORT = 240
"""Knots up to which they are as close as on short paths."""

FEWEST, MOST = 60, 400
"""Knots at least and at most."""

PARTS = 4
"""Parts of a cell in which windows begin and end."""

STEEP = 10.0
"""Longest time per joule, in units of the window's, that counts where a window ends."""


class Window(NamedTuple):
    """The continuous power [W] and the time [s] over which its mean is taken."""

    power: float
    time: float

    @property
    def energy(self) -> float:
        """What a side may draw in one window [J]."""
        return self.power * self.time


class Fine(NamedTuple):
    """A profile at places between its points: a window may begin and end anywhere."""

    rate: FloatArray  # (m,): rates [m/s], times [s]
    time: FloatArray  # (m,): rates [m/s], times [s]
    drawn: FloatArray  # (2, m): what either side drew up to there [J]
    cell: NDArray[np.intp]  # (m,): the cell in which the place lies
    part: FloatArray  # (m,): which part of the cell's time has gone

    @classmethod
    def of(cls, rate: FloatArray, time: FloatArray, drawn: FloatArray) -> Fine:
        """Cut every cell into parts of one duration, in each of which `drawn` is drawn."""
        cell = np.append(np.repeat(np.arange(len(rate) - 1), PARTS), len(rate) - 2)
        part = np.append(np.tile(np.arange(PARTS) / PARTS, len(rate) - 1), 1.0)
        here = rate[cell] + part * np.diff(rate)[cell]
        total = time[cell] + part * np.diff(time)[cell]
        energy = np.hstack([np.zeros((2, 1)), np.cumsum(drawn.reshape(2, -1), axis=1)])
        return cls(here, total, energy, cell, part)

    def at(self, rows: csr_array) -> csr_array:
        """Return what is known at the points, one row each, at the places."""
        m = np.arange(len(self.cell))
        weight = np.concatenate([1 - self.part, self.part])
        place = np.concatenate([m, m]), np.concatenate([self.cell, self.cell + 1])
        return csr_array(csr_array((weight, place), shape=(len(m), rows.shape[0])) @ rows)


def _gone(way: FloatArray, first: FloatArray, here: FloatArray, last: FloatArray) -> FloatArray:
    """Part of a cell's time that has gone after a part of its way: squared rates run straight."""
    sums = first + here
    return np.divide(way * (first + last), sums, out=np.ones_like(way) * way, where=sums > 0)


class Sums(NamedTuple):
    """Sums over cells by the factors at knots: from knot to knot, and from the knot behind on."""

    whole: FloatArray
    inside: FloatArray


class Basis(NamedTuple):
    """Knots among the points, and the hat functions between them."""

    knots: NDArray[np.intp]  # (k,): the points that are knots
    behind: NDArray[np.intp]  # (n,): the knot at or before each point
    hats: FloatArray  # (n, k): weights of the knots at each point

    @classmethod
    def over(cls, time: FloatArray, drawn: FloatArray, window: Window) -> Basis:
        """Spread knots evenly over time and drawn energy together."""
        n = len(time)
        place = time / time[-1] + drawn / drawn[-1]
        windows = drawn[-1] / window.energy
        count = int(np.clip(max(min(CLOSE * windows, SHORT), KNOTS * windows), FEWEST, MOST))
        wanted = np.linspace(0.0, place[-1], min(count, n))
        knots = np.unique(np.append(np.searchsorted(place, wanted).clip(0, n - 1), [0, n - 1]))
        behind = np.searchsorted(knots, np.arange(n), side="right") - 1
        after = np.minimum(behind + 1, len(knots) - 1)
        gap = place[knots[after]] - place[knots[behind]]
        part = np.divide(place - place[knots[behind]], gap, out=np.zeros(n), where=gap > 0)
        hats = np.zeros((n, len(knots)))
        hats[np.arange(n), behind] = 1 - part
        hats[np.arange(n), after] += part
        return cls(knots, behind, hats)

    @property
    def size(self) -> int:
        """Number of knots."""
        return len(self.knots)

    @property
    def middles(self) -> NDArray[np.intp]:
        """First point of the part that is nearest to each knot."""
        return np.append(0, (self.knots[:-1] + self.knots[1:] + 1) // 2)

    @property
    def picked(self) -> FloatArray:
        """For each point, 1 at the knot at or before it."""
        out = np.zeros_like(self.hats)
        out[np.arange(len(out)), self.behind] = 1.0
        return out

    def cumulated(self, before: FloatArray, after: FloatArray) -> FloatArray:
        """Sum over cells, up to each point, of what factors at their ends change, shape (n, k)."""
        each = before[:, None] * self.hats[:-1] + after[:, None] * self.hats[1:]
        return np.vstack([np.zeros(self.size), np.cumsum(each, axis=0)])

    def between(self, total: FloatArray) -> Sums:
        """Split sums up to each point at the knots."""
        at_knots = total[self.knots]
        return Sums(np.diff(at_knots, axis=0), total - at_knots[self.behind])

    def accelerations(self, side: FloatArray, rate: FloatArray, length: FloatArray) -> FloatArray:
        """Acceleration of a tread by the knots' factors, at the telling cells.

        With s the share of the tread in the rate r, it is ``s' r^2 + s (r^2)' / 2``.
        """
        square, safe = rate**2, np.where(length > 0, 2 * length, np.inf)
        turn, mean = np.diff(side), 0.5 * (side[1:] + side[:-1])
        first, last = (turn - mean) * square[:-1] / safe, (turn + mean) * square[1:] / safe
        now = first + last
        cells = []
        for pick in (np.argmax, np.argmin):
            for a, b in zip(self.knots[:-1], self.knots[1:], strict=True):
                cells.append(a + int(pick(now[a:b])))
        which = np.unique(np.append(cells, self.knots[1:] - 1))
        matrix = first[which, None] * self.hats[which] + last[which, None] * self.hats[which + 1]
        return np.asarray(matrix)


class Windows(NamedTuple):
    """Windows of one side: from or to a point, over the energy that one window may hold."""

    side: int  # left or right
    forward: bool  # whether they begin, or end, at the points
    point: NDArray[np.intp]  # (m,): the points
    cell: NDArray[np.intp]  # (m,): cell in which the other end lies
    part: FloatArray  # (m,): where in the cell, as a fraction
    lasts: FloatArray  # (m,): how long they last [s]
    least: float  # how long they must last [s]

    @classmethod
    def found(cls, fine: Fine, window: Window, side: int, forward: bool) -> Windows:
        """Find the windows of a profile."""
        time, drawn = fine.time, fine.drawn[side]
        wanted = drawn + (window.energy if forward else -window.energy)
        point = np.flatnonzero((wanted <= drawn[-1]) & (wanted >= 0.0))
        goal = wanted[point]
        # Where nothing is drawn, the place nearest to the point.
        after = np.searchsorted(drawn, goal, side="left" if forward else "right")
        cell = np.clip(after - 1, 0, len(drawn) - 2)
        rise = drawn[cell + 1] - drawn[cell]
        way = np.divide(goal - drawn[cell], rise, out=np.ones_like(rise), where=rise > 0)
        first, last = fine.rate[cell], fine.rate[cell + 1]
        here = np.sqrt(np.maximum(first**2 + way * (last**2 - first**2), 0.0))
        part = _gone(way, first, here, last)
        place = time[cell] + part * (time[cell + 1] - time[cell])
        lasts = np.abs(place - time[point])
        return cls(side, forward, point, cell, part, lasts, window.time)

    def tightest(self, basis: Basis, fine: Fine, longest: float) -> Windows:
        """Return the shortest window between any two knots, and the first one; none too long."""
        between = basis.behind[fine.cell[self.point]]
        order = np.lexsort((self.lasts, between))
        _, shortest = np.unique(between[order], return_index=True)
        _, first = np.unique(between, return_index=True)
        which = np.unique(np.append(order[shortest], first)).astype(int)
        which = which[self.lasts[which] < longest]
        return self._replace(
            point=self.point[which], cell=self.cell[which], part=self.part[which],
            lasts=self.lasts[which],
        )  # fmt: skip

    def rows(self, fine: Fine, reached: Sequence[csr_array], power: float) -> csr_array:
        """Return how long the windows last by the program's unknowns, but for a constant.

        `reached` are the rows of time, and where they change those of the drawn energies.
        """
        sign = 1.0 if self.forward else -1.0
        change = self._across(reached[0])
        if len(reached) > 1:
            span, rise = np.diff(fine.time)[self.cell], np.diff(fine.drawn[self.side])[self.cell]
            # Seconds per joule where the window ends: more energy before it moves the end.
            pace = np.divide(span, rise, out=np.zeros_like(span), where=rise > 0)
            pace = np.minimum(pace, STEEP / power)
            change = change - _times(pace, self._across(reached[1 + self.side]))
        return csr_array(sign * change)

    def _across(self, rows: csr_array) -> csr_array:
        """Return what lies between the points and the windows' other ends."""
        there = _times(1 - self.part, rows[self.cell]) + _times(self.part, rows[self.cell + 1])
        return csr_array(there - rows[self.point])


class Rows:
    """Rows of a linear program: unknowns at a present value, and what they must not exceed."""

    def __init__(self, now: FloatArray) -> None:
        self.now = now
        self._above: list[csr_array] = []
        self._limit: list[FloatArray] = []
        self._equal: list[csr_array] = []

    def below(self, rows: csr_array, limit: FloatArray) -> None:
        """Demand that rows do not exceed a limit."""
        self._above.append(rows)
        self._limit.append(limit)

    def unchanged(self, rows: csr_array) -> None:
        """Demand that rows stay what they are."""
        self._equal.append(rows)

    def solved(self, price: FloatArray, bounds: FloatArray) -> FloatArray:
        """Return the cheapest unknowns; the present ones where none were found."""
        equal = vstack(self._equal, format="csr")
        above = vstack(self._above, format="csr")
        # scipy's annotations know no sparse matrices.
        found = linprog(  # type: ignore[call-overload]
            price, above, np.concatenate(self._limit), equal, equal @ self.now, bounds
        )
        return self.now if found.x is None else np.asarray(found.x)


def _times(factor: FloatArray, rows: csr_array) -> csr_array:
    return csr_array(diags_array(factor) @ rows)


def placed(width: int, *blocks: tuple[int, FloatArray]) -> csr_array:
    """Return a sparse matrix with blocks from given columns on."""
    parts, column = [], 0
    height = blocks[0][1].shape[0]
    for first, block in blocks:
        parts += [csr_array((height, first - column)), csr_array(block)]
        column = first + block.shape[1]
    return csr_array(hstack([*parts, csr_array((height, width - column))], format="csr"))
