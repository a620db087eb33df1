"""Energy and path for costs with many corners: both turning directions, and the motion itself.

Units: half the slip track and joules, in the frame of the middle heading (`_gauge`).
"""

from __future__ import annotations

import math

from energyplan.compilation import njit
from energyplan.path import FloatArray
from energyplan.steering.dual import EXACT, NARROW, maximise
from energyplan.steering.sweep_extent import best_extent

TWO_PI = 2.0 * math.pi
HALF_PI = 0.5 * math.pi
AHEAD, BEHIND, N_LEFT, N_RIGHT, DATA = 6, 7, 8, 9, 16
CLOSED = 1e-11  # straight pieces below this length would only make up for rounding


@njit
def _tables(params: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Rows m, g, slope of the corners to the left and to the right."""
    n, k = int(params[N_LEFT]), int(params[N_RIGHT])
    middle = DATA + 3 * n
    return params[DATA:middle].reshape(3, n), params[middle : middle + 3 * k].reshape(3, k)


@njit
def polygon_energy(x: float, y: float, eta: float, params: FloatArray) -> float:
    """Least energy [J] for the displacement (x, y); see `_kernels`."""
    left, right = _tables(params)
    af, ab = params[AHEAD], params[BEHIND]
    best = best_extent(x, y, eta, af, ab, left, right, math.inf)[0]
    # In a mirror, seen from the opposite middle heading, a turn to the right is one to the left.
    other = best_extent(-x, y, math.pi - eta, af, ab, right, left, best)[0]
    return float(min(best, other))


@njit
def _corner_at(q: float, table: FloatArray) -> int:
    """Index of the cheapest corner where ``p.u = q``."""
    best, index = math.inf, 0
    for k in range(table.shape[1]):
        value = table[1, k] - table[0, k] * q
        if value < best:
            best, index = value, k
    return index


@njit
def _sweep(
    start: float,
    stop: float,
    px: float,
    py: float,
    table: FloatArray,
    ds: FloatArray,
    dtheta: FloatArray,
    n: int,
) -> int:
    """Append the turns from heading `start` to `stop`, each at its cheapest corner."""
    if start == stop:
        return n
    rho, psi = math.hypot(px, py), math.atan2(py, px)
    a, b = min(start, stop), max(start, stop)
    edges = [a, b]
    for k in range(table.shape[1] - 1):
        ratio = table[2, k] / rho if rho > 0.0 else math.inf
        if not -1.0 < ratio < 1.0:
            continue
        half = math.acos(ratio)
        for way in range(2):
            edge = psi - half if way == 0 else psi + half
            edge += TWO_PI * math.ceil((a - edge) / TWO_PI)
            while edge < b:
                edges.append(edge)
                edge += TWO_PI
    edges.sort()
    count = len(edges) - 1
    for i in range(count):
        j = i if stop > start else count - 1 - i
        turn = edges[j + 1] - edges[j]
        if turn <= 0.0:
            continue
        middle = 0.5 * (edges[j] + edges[j + 1])
        corner = _corner_at(px * math.cos(middle) + py * math.sin(middle), table)
        ds[n] = table[0, corner] * turn
        dtheta[n] = turn if stop > start else -turn
        n += 1
    return n


@njit
def _travel(eta: float, ds: FloatArray, dtheta: FloatArray, n: int) -> tuple[float, float]:
    """Displacement of the first n segments from the heading -eta."""
    heading, x, y = -eta, 0.0, 0.0
    for i in range(n):
        half = 0.5 * dtheta[i]
        chord = ds[i] * (math.sin(half) / half if half != 0.0 else 1.0)
        x += chord * math.cos(heading + half)
        y += chord * math.sin(heading + half)
        heading += dtheta[i]
    return x, y


@njit
def _schedule_path(
    x: float,
    y: float,
    eta: float,
    lo: float,
    hi: float,
    af: float,
    ab: float,
    left: FloatArray,
    right: FloatArray,
    ds: FloatArray,
    dtheta: FloatArray,
) -> int:
    """Write the segments of the best motion with the headings [lo, hi], sweeping to the left."""
    half = max(eta, 0.5 * NARROW)
    _, px, py, at_lo, at_hi = maximise(x, y, lo, hi, half, af, ab, left, right, EXACT)
    n = _sweep(-eta, lo, px, py, right, ds, dtheta, 0)
    n = _sweep(lo, hi, px, py, left, ds, dtheta, n)
    n = _sweep(hi, eta, px, py, right, ds, dtheta, n)
    fx, fy = _travel(eta, ds, dtheta, n)
    rx, ry = x - fx, y - fy
    # Straight lines cover the rest at two headings: where the dual says, and where rounding is
    # made up for.
    first, second = lo, hi
    if at_lo == 0.0 and at_hi != 0.0:
        first, second = hi, lo
    elif at_lo == 0.0 and math.hypot(rx, ry) > 1e-9:
        first = math.atan2(py, px)
        first += math.pi * math.ceil((lo - first) / math.pi)
        if first > hi:
            first = hi if first - hi < lo - (first - math.pi) else lo
        second = lo if first - lo > hi - first else hi
    if at_lo * at_hi == 0.0 and abs(second - first) > HALF_PI:
        second = first + HALF_PI if first + HALF_PI <= hi else first - HALF_PI
    det = math.sin(second - first)
    if abs(det) > 0.0:
        one = (rx * math.sin(second) - ry * math.cos(second)) / det
        two = (ry * math.cos(first) - rx * math.sin(first)) / det
    else:
        one, two = rx * math.cos(first) + ry * math.sin(first), 0.0
    if first > second:
        first, second, one, two = second, first, two, one
    n = _sweep(-eta, lo, px, py, right, ds, dtheta, 0)
    n = _sweep(lo, first, px, py, left, ds, dtheta, n)
    if abs(one) > CLOSED:
        ds[n], dtheta[n] = one, 0.0
        n += 1
    n = _sweep(first, second, px, py, left, ds, dtheta, n)
    if abs(two) > CLOSED:
        ds[n], dtheta[n] = two, 0.0
        n += 1
    n = _sweep(second, hi, px, py, left, ds, dtheta, n)
    return _sweep(hi, eta, px, py, right, ds, dtheta, n)


@njit
def polygon_path(
    x: float, y: float, eta: float, params: FloatArray, ds: FloatArray, dtheta: FloatArray
) -> int:
    """Write the segments of a motion of least energy; see `_kernels`."""
    left, right = _tables(params)
    af, ab = params[AHEAD], params[BEHIND]
    best = best_extent(x, y, eta, af, ab, left, right, math.inf)
    other = best_extent(-x, y, math.pi - eta, af, ab, right, left, best[0])
    if other[0] < best[0]:
        n = _schedule_path(
            -x, y, math.pi - eta, other[1], other[2], af, ab, right, left, ds, dtheta
        )
        for i in range(n):
            dtheta[i] = -dtheta[i]
        return n
    return _schedule_path(x, y, eta, best[1], best[2], af, ab, left, right, ds, dtheta)
