"""Energy and path for costs with many corners: both turning directions, and the motion itself.

The contract is that of `energyplan.steering.kernels`; it takes about a hundred microseconds. Units
here: half the slip track and joules, in the frame of the middle heading.
"""

from __future__ import annotations

import math

from energyplan.compilation import inner, njit
from energyplan.compilation.arrays import Floats, FloatTable
from energyplan.cost.steering import PolygonSteering
from energyplan.path import Pose
from energyplan.steering.arcs import arc_end
from energyplan.steering.dual import EXACT, NARROW, maximise
from energyplan.steering.kernels import between_poses
from energyplan.steering.sweep_extent import best_extent

TWO_PI = 2.0 * math.pi
HALF_PI = 0.5 * math.pi
SAME = 1e-12  # headings that differ by less are one [rad]
CLOSED = 1e-11  # straight pieces below this length would only make up for rounding


@njit
def polygon_energy(
    dx: float, dy: float, theta0: float, theta1: float, cost: PolygonSteering
) -> float:
    """Least energy between two poses [J]."""
    x, y, turn = between_poses(
        dx, dy, theta0, theta1, cost.half_track, cost.longitudinal, cost.lateral
    )
    eta, af, ab = 0.5 * turn, cost.ahead, cost.behind
    best = best_extent(x, y, eta, af, ab, cost.left, cost.right, math.inf)[0]
    # In a mirror, seen from the opposite middle heading, a turn to the right is one to the left.
    other = best_extent(-x, y, math.pi - eta, af, ab, cost.right, cost.left, best)[0]
    return min(best, other)


@njit
def polygon_energies(
    starts: FloatTable, goals: FloatTable, cost: PolygonSteering, out: Floats
) -> None:
    """Fill `out` with the least energies between rows of poses, shapes (n, 3), (n, 3), (n,)."""
    for i in range(len(out)):
        out[i] = polygon_energy(
            goals[i, 0] - starts[i, 0],
            goals[i, 1] - starts[i, 1],
            starts[i, 2],
            goals[i, 2],
            cost,
        )


@inner
def _corner_at(q: float, table: FloatTable) -> int:
    """Index of the cheapest corner where ``p.u = q``."""
    best, index = math.inf, 0
    for k in range(table.shape[1]):
        value = table[1, k] - table[0, k] * q
        if value < best:
            best, index = value, k
    return index


@inner
def _next_edge(heading: float, stop: float, px: float, py: float, table: FloatTable) -> float:
    """Return where, from a heading towards `stop`, another corner becomes the cheapest."""
    rho, psi = math.hypot(px, py), math.atan2(py, px)
    side = 1.0 if stop > heading else -1.0
    nearest = abs(stop - heading)
    for k in range(table.shape[1] - 1):
        ratio = table[2, k] / rho if rho > 0.0 else math.inf
        if not -1.0 < ratio < 1.0:
            continue
        half = math.acos(ratio)
        for way in range(2):
            edge = psi - half if way == 0 else psi + half
            ahead = (side * (edge - heading)) % TWO_PI
            if SAME < ahead < nearest:
                nearest = ahead
    return heading + side * nearest if nearest < abs(stop - heading) else stop


@inner
def _sweep(
    start: float,
    stop: float,
    px: float,
    py: float,
    table: FloatTable,
    ds: Floats,
    dtheta: Floats,
    n: int,
) -> int:
    """Append the turns from heading `start` to `stop`, each at its cheapest corner."""
    here = start
    while here != stop:
        edge = _next_edge(here, stop, px, py, table)
        middle = 0.5 * (here + edge)
        corner = _corner_at(px * math.cos(middle) + py * math.sin(middle), table)
        ds[n] = table[0, corner] * abs(edge - here)
        dtheta[n] = edge - here
        n += 1
        here = edge
    return n


@inner
def _travel(eta: float, ds: Floats, dtheta: Floats, n: int) -> Pose:
    """Where the first n segments lead from the heading -eta."""
    here = Pose(0.0, 0.0, -eta)
    for i in range(n):
        here = arc_end(here, ds[i], dtheta[i])
    return here


@inner
def _schedule_path(
    x: float,
    y: float,
    eta: float,
    lo: float,
    hi: float,
    af: float,
    ab: float,
    left: FloatTable,
    right: FloatTable,
    ds: Floats,
    dtheta: Floats,
) -> int:
    """Write the segments of the best motion with the headings [lo, hi], sweeping to the left."""
    half = max(eta, 0.5 * NARROW)
    _, px, py, at_lo, at_hi = maximise(x, y, lo, hi, half, af, ab, left, right, EXACT)
    n = _sweep(-eta, lo, px, py, right, ds, dtheta, 0)
    n = _sweep(lo, hi, px, py, left, ds, dtheta, n)
    n = _sweep(hi, eta, px, py, right, ds, dtheta, n)
    here = _travel(eta, ds, dtheta, n)
    rx, ry = x - here.x, y - here.y
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
    dx: float,
    dy: float,
    theta0: float,
    theta1: float,
    cost: PolygonSteering,
    ds: Floats,
    dtheta: Floats,
) -> int:
    """Write the segments of a motion of least energy, and return how many there are."""
    C = cost.half_track
    x, y, turn = between_poses(dx, dy, theta0, theta1, C, cost.longitudinal, cost.lateral)
    eta, af, ab, left, right = 0.5 * turn, cost.ahead, cost.behind, cost.left, cost.right
    best = best_extent(x, y, eta, af, ab, left, right, math.inf)
    other = best_extent(-x, y, math.pi - eta, af, ab, right, left, best[0])
    side = 1.0
    if other[0] < best[0]:
        side = -1.0
        best = other
        x, eta, left, right = -x, math.pi - eta, right, left
    n = _schedule_path(x, y, eta, best[1], best[2], af, ab, left, right, ds, dtheta)
    for i in range(n):
        dtheta[i] *= side
        ds[i] = C * ds[i] + cost.lateral * dtheta[i]
    return n
