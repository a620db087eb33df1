"""Tables of energy over the direction of motion, and their convex hull.

Steady motion at the cheapest admissible speed costs energy that is homogeneous in the path
element: twice the element, twice the energy. So it is known from its values on a closed curve
around the origin of the plane ``(x, y) = (ds, C dtheta)``. The curve here is the square
``max(|x|, |y|) = 1``. Its eight octants meet at the eight special directions: straight, spin, and
the pivots about either tread's ICR, where the power of the usual terms has its kinks. Within an
octant a direction is told by the ratio of the smaller to the larger component.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from energyplan.compilation import njit
from energyplan.path import FloatArray
from energyplan.vehicle import TreadICR

SNAP = 1e-9  # directions this close to a special one are taken as that one
_EDGE = 1e-6  # an octant's limits towards its ends are extrapolated from here


@njit
def element_energy(
    x: FloatArray, y: FloatArray, table: FloatArray, special: FloatArray, out: FloatArray
) -> None:
    """Energy of path elements, by linear interpolation of a gauge's table.

    Parameters
    ----------
    x, y : ndarray, shape (m,)
        Arc length of the centre and turn times half the slip track [m].
    table : ndarray, shape (8, n + 1)
        Energy on the square at the ratios ``0, 1/n, ..., 1`` of each octant.
    special : ndarray, shape (8,)
        Energy in the special directions, ordered as in `SPECIAL`.
    out : ndarray, shape (m,)
        Filled with the energies [J].
    """
    last = table.shape[1] - 1
    for i in range(len(out)):
        a, b = abs(x[i]), abs(y[i])
        back, right = int(x[i] < 0.0), int(y[i] < 0.0)
        spin = b > a
        big, small = (b, a) if spin else (a, b)
        if small <= SNAP * big:
            out[i] = big * special[2 + right if spin else back]
        elif small >= (1.0 - SNAP) * big:
            out[i] = big * special[4 + 2 * right + back]
        else:
            place = small / big * last
            k = min(int(place), last - 1)
            row = table[4 * int(spin) + 2 * right + back]
            out[i] = big * (row[k] + (place - k) * (row[k + 1] - row[k]))


SPECIAL = np.array([(1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (-1, 1), (1, -1), (-1, -1)], float)
"""Special directions (x, y): straight, spin left and right, then the pivots."""


@dataclass(frozen=True)
class Gauge:
    """Energy over the direction of motion.

    Parameters
    ----------
    table : ndarray, shape (8, n + 1)
        Energy on the square within each octant, with one-sided limits at its ends [J/m].
    special : ndarray, shape (8,)
        Energy in the special directions [J/m].
    error : float
        Largest relative error of interpolating the table, measured between its nodes.
    """

    table: FloatArray
    special: FloatArray
    error: float

    def __call__(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """Return the energy [J] of elements ``(x, y)`` of any shape [m]."""
        wide_x, wide_y = np.broadcast_arrays(np.asarray(x, float), np.asarray(y, float))
        out = np.empty(wide_x.size)
        element_energy(
            np.ascontiguousarray(wide_x).ravel(),
            np.ascontiguousarray(wide_y).ravel(),
            self.table,
            self.special,
            out,
        )
        return out.reshape(wide_x.shape)

    @property
    def directions(self) -> FloatArray:
        """Directions on the square that the table and the special values stand for, (m, 2)."""
        n = self.table.shape[1] - 1
        if n == 1:
            return SPECIAL
        x, y = octant_directions(np.arange(1, n) / n)
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
        equal = np.allclose(self.special[[0, 1]], straight, rtol=1e-9) and np.allclose(
            self.special[4:], pivot, rtol=1e-9
        )
        x, y = np.abs(self.directions.T)
        least = straight * np.maximum(x, y) + (pivot - straight) * y
        return bool(
            equal and pivot >= straight * (1 - 1e-9) and np.all(self.values >= least * (1 - 1e-9))
        )

    def corners(self, most: int = 40) -> Corners:
        """Return the corners of the cheapest mixtures.

        Parameters
        ----------
        most : int
            Largest number of corners for either turning direction.

        Returns
        -------
        Corners
            All corners where there are few; a selection with its error where a smooth energy has
            many.
        """
        points = self.directions / self.values[:, None]
        points[len(SPECIAL) :] *= 1.0 - 1e-12  # special directions win ties
        hull = _convex_hull(points)
        tolerance = 1e-7
        while True:
            chosen, error = _simplify(hull, tolerance)
            turns = np.abs(chosen[:, 1]) > 1e-9 * np.abs(chosen[:, 0])
            left = chosen[turns & (chosen[:, 1] > 0)]
            right = chosen[turns & (chosen[:, 1] < 0)]
            if max(len(left), len(right)) <= most:
                return Corners(left, right, error)
            tolerance *= 2.0


@dataclass(frozen=True)
class Corners:
    """Corners of the elements ``(x, y)`` that one joule can pay for, mixtures included [m].

    Parameters
    ----------
    left, right : ndarray, shape (m, 2)
        Corners that turn left, and right.
    error : float
        How much the energy of a mixture may exceed the least one, as a fraction.
    """

    left: FloatArray
    right: FloatArray
    error: float


def steering_parameters(gauge: Gauge, corners: Corners, icr: TreadICR) -> FloatArray:
    """Return what the compiled kernels read; laid out in `energyplan.steering.kernels`."""
    C, (lx, ly) = icr.half_track, icr.centre
    ahead, behind, pivot = (float(gauge.special[k]) for k in (0, 1, 4))
    head = np.zeros(16)
    head[:8] = [0.0, C, lx, ly, ahead, pivot * C, ahead * C, behind * C]
    if gauge.is_static:
        return head
    left = _turn_table(corners.left, C, ahead * C)
    right = _turn_table(corners.right * [1.0, -1.0], C, ahead * C)
    head[0], head[8], head[9] = 1.0, left.shape[1], right.shape[1]
    return np.concatenate([head, left.ravel(), right.ravel()])


def _turn_table(corners: FloatArray, half_track: float, straight: float) -> FloatArray:
    """Rows ``m``, ``g``, and the slopes to the next corner, of one turning direction's corners."""
    order = np.argsort(corners[:, 0] / corners[:, 1])
    x, y = corners[order].T
    m, g = x / y, half_track / y
    slope = np.diff(g) / np.diff(m)
    flat = np.flatnonzero(np.abs(slope) < 1e-7 * straight)
    if len(flat):
        # Along a flat edge every mixture costs the same and the dual says nothing about which to
        # take. A corner in its middle, cheaper by a rounding error, makes up its mind.
        k = int(flat[0]) + 1
        m, g = np.insert(m, k, 0.5 * (m[k - 1] + m[k])), np.insert(g, k, g[k - 1 : k + 1].min())
        g[k] *= 1.0 - 1e-8
        slope = np.diff(g) / np.diff(m)
    return np.vstack([m, g, np.append(slope, np.inf)])


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
) -> Gauge:
    """Tabulate a homogeneous energy, as finely as interpolation within `tolerance` needs.

    Parameters
    ----------
    energy : callable
        ``energy(x, y)`` [J] of elements [m], arrays of any one shape.
    tolerance : float
        Largest relative error wanted.
    most : int
        Largest number of intervals per octant.

    Returns
    -------
    Gauge
        The table with its measured error. Piecewise linear energies need one interval.
    """
    special = energy(SPECIAL[:, 0], SPECIAL[:, 1])
    n = 1
    while True:
        table = _nodes(energy, n)
        between = (np.arange(n) + 0.5) / n
        straight_line = 0.5 * (table[:, 1:] + table[:, :-1])
        true = energy(*octant_directions(between))
        offset = 0.25 / n  # two more places, off the middle, so that a kink there is seen
        quarter = energy(*octant_directions(between + offset))
        line = 0.25 * table[:, :-1] + 0.75 * table[:, 1:]
        error = max(
            float(np.max(np.abs(straight_line / true - 1.0))),
            float(np.max(np.abs(line / quarter - 1.0))),
        )
        if error <= tolerance or n >= most:
            return Gauge(table, special, error)
        n *= 4


def _nodes(energy: Callable[[FloatArray, FloatArray], FloatArray], n: int) -> FloatArray:
    """Energies at the nodes of every octant, with one-sided limits at its ends."""
    ends = np.array([_EDGE, 2 * _EDGE, 1 - 2 * _EDGE, 1 - _EDGE])
    inner = np.arange(1, n) / n
    value = energy(*octant_directions(np.concatenate([inner, ends])))
    near = value[:, n - 1 :]
    first, last = 2 * near[:, 0] - near[:, 1], 2 * near[:, 3] - near[:, 2]
    return np.column_stack([first, value[:, : n - 1], last])


def _simplify(hull: FloatArray, tolerance: float) -> tuple[FloatArray, float]:
    """Drop vertices of a convex polygon about the origin; return the rest and the error made.

    The error is the largest fraction by which a dropped vertex lies outside of what is left.
    """
    # Vertices in special directions stay: the motions there are simple, and both halves alike.
    x, y = np.abs(hull.T)
    first = np.flatnonzero((np.minimum(x, y) < 1e-9) | (np.abs(x - y) < 1e-9 * x)).tolist()
    n = len(hull)
    stack = list(zip(first, [*first[1:], first[0] + n], strict=True))
    keep, error = set(first), 0.0
    while stack:
        i, j = stack.pop()
        if j - i < 2:
            continue
        a, b = hull[i % n], hull[j % n]
        normal = np.array([b[1] - a[1], a[0] - b[0]])
        between = np.arange(i + 1, j) % n
        excess = hull[between] @ normal / (a @ normal) - 1.0
        worst = int(np.argmax(excess))
        if excess[worst] <= tolerance:
            error = max(error, float(excess[worst]))
            continue
        middle = i + 1 + worst
        keep.add(middle % n)
        stack += [(i, middle), (middle, j)]
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
