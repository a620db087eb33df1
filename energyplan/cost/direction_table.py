"""Tables of energy over the direction of motion, and their convex hull.

Steady motion at the cheapest admissible speed costs energy that is homogeneous in the path
element: twice the element, twice the energy. So it is known from its values on a closed curve
around the origin of the plane ``(x, y) = (ds, C dtheta)``. The curve here is the square
``max(|x|, |y|) = 1``. Its eight octants meet at the eight special directions: straight, spin, and
the pivots about either tread's ICR, where the power of the standard terms has its kinks. Within an
octant a direction is known by the ratio of the smaller to the larger component.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from heapq import heappop, heappush

import numpy as np

from energyplan.compilation import Floats, FloatTable, njit
from energyplan.path import ROUNDING, FloatArray

_EDGE = 1e-6  # an octant's limits towards its ends are extrapolated from here


@njit
def element_energy(
    x: Floats, y: Floats, ratio: Floats, table: FloatTable, special: Floats, out: Floats
) -> None:
    """Energy of path elements, by linear interpolation of a direction table."""
    last = len(ratio) - 1
    for i in range(len(out)):
        a, b = abs(x[i]), abs(y[i])
        back, right = int(x[i] < 0.0), int(y[i] < 0.0)
        spin = b > a
        big, small = (b, a) if spin else (a, b)
        if small <= ROUNDING * big:
            out[i] = big * special[2 + right if spin else back]
        elif small >= (1.0 - ROUNDING) * big:
            out[i] = big * special[4 + 2 * right + back]
        else:
            place = small / big
            low, high = 0, last
            while high - low > 1:
                middle = (low + high) // 2
                if ratio[middle] <= place:
                    low = middle
                else:
                    high = middle
            part = (place - ratio[low]) / (ratio[high] - ratio[low])
            row = table[4 * int(spin) + 2 * right + back]
            out[i] = big * (row[low] + part * (row[high] - row[low]))


SPECIAL = np.array([(1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (-1, 1), (1, -1), (-1, -1)], float)
"""Special directions (x, y): straight, spin left and right, then the pivots."""

MOST_CORNERS = 40  # largest number of corners of the cheapest mixtures for either turning direction
OUTSIDE = 1e-7  # fraction by which a corner that is left out may lie outside of the others


@dataclass(frozen=True)
class DirectionTable:
    """Energy over the direction of motion."""

    ratio: FloatArray  # (n + 1,): nodes in each octant, from 0 to 1
    table: FloatArray  # (8, n + 1) [J/m]
    special: FloatArray  # (8,): energy in the special directions [J/m]
    error: float  # largest relative error of interpolating the table, measured between its nodes

    def __call__(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """Return the energy [J] of elements ``(x, y)`` of any shape [m]."""
        wide_x, wide_y = np.broadcast_arrays(np.asarray(x, float), np.asarray(y, float))
        out = np.empty(wide_x.size)
        element_energy(
            np.array(wide_x, order="C").ravel(),  # NumPy warns of views from broadcasting
            np.array(wide_y, order="C").ravel(),
            self.ratio,
            self.table,
            self.special,
            out,
        )
        return out.reshape(wide_x.shape)

    @property
    def directions(self) -> FloatArray:
        """Directions on the square that the table and the special values cover, (m, 2)."""
        x, y = octant_directions(self.ratio[1:-1])
        return np.vstack([SPECIAL, np.column_stack([x.ravel(), y.ravel()])])

    @property
    def values(self) -> FloatArray:
        """Energies in `directions` [J/m], shape (m,)."""
        return np.concatenate([self.special, self.table[:, 1:-1].ravel()])

    @property
    def is_static(self) -> bool:
        """Whether the cheapest mixtures are those of straights and pivots of one price each.

        The energy is then ``a max(|x|, |y|) + beta |y|`` as soon as mixtures are allowed: an arc
        that costs more, because returned power is partly lost, is none of them.
        """
        straight, pivot = self.special[0], self.special[4]
        equal = np.allclose(self.special[[0, 1]], straight, rtol=ROUNDING) and np.allclose(
            self.special[4:], pivot, rtol=ROUNDING
        )
        x, y = np.abs(self.directions.T)
        least = straight * np.maximum(x, y) + (pivot - straight) * y
        return bool(
            equal
            and pivot >= straight * (1 - ROUNDING)
            and np.all(self.values >= least * (1 - ROUNDING))
        )

    def corners(self) -> Corners:
        """Return the corners of the cheapest mixtures."""
        points = self.directions / self.values[:, None]
        points[len(SPECIAL) :] *= 1.0 - 1e-12  # special directions win ties
        chosen, error = _simplify(_convex_hull(points))
        turns = np.abs(chosen[:, 1]) > ROUNDING * np.abs(chosen[:, 0])
        left, right = (chosen[turns & (side * chosen[:, 1] > 0)] for side in (1, -1))
        return Corners(left, right, error)


@dataclass(frozen=True)
class Corners:
    """Corners of the elements ``(x, y)`` that one joule can pay for, mixtures included [m]."""

    left: FloatArray  # (m, 2): corners that turn left [m]
    right: FloatArray  # (m, 2): corners that turn right [m]
    error: float  # how much the energy of a mixture may exceed the least one, as a fraction


def octant_directions(ratio: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return ``(x, y)`` on the square, shape (8, n), at these ratios of every octant."""
    octant = np.arange(8)[:, None]
    back, right, spin = octant % 2, octant // 2 % 2, octant // 4
    x = np.where(spin == 1, ratio, 1.0) * (1.0 - 2.0 * back)
    y = np.where(spin == 1, 1.0, ratio) * (1.0 - 2.0 * right)
    return x, y


def tabulate(
    energy: Callable[[FloatArray, FloatArray], FloatArray],
    tolerance: float = 1e-7,
    most: int = 1024,
) -> DirectionTable:
    """Tabulate a homogeneous energy, as finely as interpolation within `tolerance` needs."""
    special = energy(SPECIAL[:, 0], SPECIAL[:, 1])
    near = energy(*octant_directions(np.array([_EDGE, 2 * _EDGE, 1 - 2 * _EDGE, 1 - _EDGE])))
    ends = np.column_stack([2 * near[:, 0] - near[:, 1], 2 * near[:, 3] - near[:, 2]])
    scan = scan_ratios(16)[1:-1]
    value = energy(*octant_directions(scan))
    line = ends[:, :1] + scan * (ends[:, 1:] - ends[:, :1])
    error = float(np.abs(line / value - 1.0).max())
    if error <= tolerance:
        return DirectionTable(np.array([0.0, 1.0]), ends, special, error)
    ratio = np.concatenate([[0.0], scan, [1.0]])
    table = np.column_stack([ends[:, 0], value, ends[:, 1]])
    errors = np.full(len(ratio) - 1, np.inf)
    middle = np.empty((8, len(errors)))
    while True:
        new = np.flatnonzero(np.isinf(errors))
        low, width = ratio[new], np.diff(ratio)[new]
        places = low + width * np.array([[0.25], [0.5], [0.75]])
        value = energy(*octant_directions(places.ravel())).reshape(8, 3, -1)
        part = np.array([[0.25], [0.5], [0.75]])
        line = table[:, None, new] * (1.0 - part) + table[:, None, new + 1] * part
        errors[new] = np.abs(line / value - 1.0).max(axis=(0, 1))
        middle[:, new] = value[:, 1]
        split = np.flatnonzero((errors > tolerance) & (np.diff(ratio) > _EDGE))
        room = most - len(errors)
        if len(split) > room:
            split = np.sort(split[np.argsort(-errors[split])[:room]])
        if not len(split):
            return DirectionTable(ratio, table, special, float(errors.max()))
        ratio = np.insert(ratio, split + 1, 0.5 * (ratio[split] + ratio[split + 1]))
        table = np.insert(table, split + 1, middle[:, split], axis=1)
        errors[split] = np.inf
        errors = np.insert(errors, split + 1, np.inf)
        middle = np.insert(middle, split + 1, 0.0, axis=1)


def scan_ratios(even: int) -> FloatArray:
    """Return ratios of an octant to look at first: `even` intervals, and ever less to its ends."""
    fine = np.geomspace(1e-7, 1.0 / even, 25)[:-1]
    inner = np.concatenate([fine, np.arange(1, even) / even, 1.0 - fine[::-1]])
    return np.concatenate([[0.0], inner, [1.0]])


def _simplify(hull: FloatArray) -> tuple[FloatArray, float]:
    """Drop vertices of a convex polygon about the origin; return the rest and the error.

    The error is the largest fraction by which a dropped vertex lies outside of what is left. The
    vertex that lies farthest outside is put back first, until none lies outside by more than
    `OUTSIDE`, or `MOST_CORNERS` of a turning direction are kept.
    """
    # Vertices in special directions stay: the motions there are simple, and both halves alike.
    x, y = np.abs(hull.T)
    first = np.flatnonzero((np.minimum(x, y) < ROUNDING) | (np.abs(x - y) < ROUNDING * x)).tolist()
    n = len(hull)
    if not first:  # arcs are cheaper than straights and than pivots: begin anywhere
        first = [0]
    keep, error = set(first), 0.0
    side = np.where(np.abs(hull[:, 1]) > ROUNDING * np.abs(hull[:, 0]), np.sign(hull[:, 1]), 0.0)
    count = {s: sum(side[k] == s for k in first) for s in (-1.0, 0.0, 1.0)}
    waiting: list[tuple[float, int, int, int]] = []

    def look(i: int, j: int) -> None:
        """Note the vertex between two that lies farthest outside of their chord."""
        if j - i < 2:
            return
        a, b = hull[i % n], hull[j % n]
        normal = np.array([b[1] - a[1], a[0] - b[0]])
        if a @ normal <= 1e-6 * (a @ a):  # half a turn or more: the chord does not bound it
            heappush(waiting, (-np.inf, i, (i + j) // 2, j))
            return
        excess = hull[np.arange(i + 1, j) % n] @ normal / (a @ normal) - 1.0
        worst = int(np.argmax(excess))
        heappush(waiting, (-float(excess[worst]), i, i + 1 + worst, j))

    for i, j in zip(first, [*first[1:], first[0] + n], strict=True):
        look(i, j)
    while waiting:
        excess, i, middle, j = heappop(waiting)
        half = float(side[middle % n])
        full = half != 0.0 and count[half] >= MOST_CORNERS
        if -excess <= OUTSIDE or (full and np.isfinite(excess)):
            error = max(error, -excess)
            continue
        keep.add(middle % n)
        count[half] += 1
        look(i, middle)
        look(middle, j)
    return hull[sorted(keep)], error


def _convex_hull(points: FloatArray) -> FloatArray:
    """Vertices of the convex hull, counter-clockwise, without points on its edges."""
    order = points[np.lexsort((points[:, 1], points[:, 0]))]
    tolerance = 1e-10 * float(np.max(np.abs(points))) ** 2
    chain: list[FloatArray] = []
    for rows in (order, order[::-1]):
        half: list[FloatArray] = []
        for p in rows:
            while len(half) > 1:
                (ax, ay), (bx, by) = half[-1] - half[-2], p - half[-1]
                if ax * by - ay * bx > tolerance:
                    break
                half.pop()
            half.append(p)
        chain.extend(half[:-1])
    return np.array(chain)
