"""Energy and path for costs with many corners: both turning directions, and the motion itself.

The contract is that of `energyplan.steering.kernels`; it takes about a hundred microseconds. Units
here: half the slip track and joules, in the frame of the middle heading.

An excursion beyond an end of the sweep costs its turning, out and back, and pays by the better
heading for the straight line that is driven there. The derivative of the schedule's energy with
respect to the excursion is known from the dual solution, so the best excursion is a root
(docs/planner.md).
"""

from __future__ import annotations

import math

from energyplan.compilation import Floats, FloatTable, lean, njit
from energyplan.cost.steering import PolygonSteering
from energyplan.path import ANGLE, Pose
from energyplan.steering.dual import (
    EXACT,
    NARROW,
    SEARCH,
    between,
    corner_dual,
    dual_value,
    least,
    maximise,
)
from energyplan.steering.kernels import arc_end, between_poses
from energyplan.steering.static_words import HALF_PI, TWO_PI


@lean
def _pays(
    px: float, py: float, end: float, outward: float, length: float, left: FloatTable,
    right: FloatTable,
) -> float:  # fmt: skip
    """Logarithm of what a further excursion saves over what it costs, within +-60.

    Straight driving of `length` at the heading `end` gains from going further out as far as the
    dual ``p.u`` grows there.
    """
    c, s = math.cos(end), math.sin(end)
    gain = length * (py * c - px * s) * outward
    if gain <= 0.0:
        return -60.0
    q = px * c + py * s
    cost = least(q, left[0], left[1]) + least(q, right[0], right[1])
    if cost <= 0.0:
        return 60.0
    return min(max(math.log(gain / cost), -60.0), 60.0)


@lean
def _extend(
    dx: float, dy: float, lo: float, hi: float, eta: float, af: float, ab: float, left: FloatTable,
    right: FloatTable, upper: bool,
) -> tuple[float, float]:  # fmt: skip
    """Best extent ``(lo, hi)`` when only its upper end, or only its lower one, moves outwards."""
    near, far = (hi, max(lo + math.pi, hi)) if upper else (lo, min(hi - math.pi, lo))
    f_near, f_far, last, end = 0.0, 0.0, 0, near
    for i in range(60):
        if i > 0:
            end = between(near, far, f_near, f_far)
        a, b = (lo, end) if upper else (end, hi)
        _, px, py, at_lo, at_hi = maximise(dx, dy, a, b, eta, af, ab, left, right, SEARCH)
        f = _pays(px, py, end, 1.0 if upper else -1.0, at_hi if upper else at_lo, left, right)
        f = min(max(f, -2.0), 2.0)
        if f > 0.0:
            near, f_near, f_far, last = end, f, f_far * (0.5 if last == 1 else 1.0), 1
        else:
            far, f_far, f_near, last = end, f, f_near * (0.5 if last == -1 else 1.0), -1
        if (i == 0 and f <= 0.0) or abs(f) < 1e-3 or abs(far - near) < 1e-9:
            break
    return (lo, end) if upper else (end, hi)


@lean
def _both(
    dx: float, dy: float, lo: float, hi: float, eta: float, side: int, af: float, ab: float,
    left: FloatTable, right: FloatTable,
) -> tuple[float, float, bool]:  # fmt: skip
    """Best extent ``(lo, hi, found)`` with straight lines beyond both ends, by Newton's method."""
    if not (lo < -eta and hi > eta):
        return lo, hi, False
    a, b = math.log(-eta - lo), math.log(hi - eta)  # logarithms keep both excursions positive
    step = 1e-6
    for _ in range(30):
        fa, fb = _gains(dx, dy, a, b, eta, side, af, ab, left, right)
        if max(abs(fa), abs(fb)) < 1e-7:
            return -eta - math.exp(a), eta + math.exp(b), True
        aa, ba = _gains(dx, dy, a + step, b, eta, side, af, ab, left, right)
        ab_, bb = _gains(dx, dy, a, b + step, eta, side, af, ab, left, right)
        j00, j01, j10, j11 = aa - fa, ab_ - fa, ba - fb, bb - fb
        det = j00 * j11 - j01 * j10
        if not abs(det) > 0.0:
            break
        da, db = step * (j11 * fa - j01 * fb) / det, step * (j00 * fb - j10 * fa) / det
        size = max(abs(da), abs(db), 1.0)
        a, b = a - da / size, b - db / size
    return lo, hi, False


@lean
def _gains(
    dx: float, dy: float, a: float, b: float, eta: float, side: int, af: float, ab: float,
    left: FloatTable, right: FloatTable,
) -> tuple[float, float]:  # fmt: skip
    """Return by how much both excursions pay, given the logarithms of their sizes."""
    lo, hi = -eta - math.exp(min(a, 1.0)), eta + math.exp(min(b, 1.0))
    _, px, py, at_lo, at_hi = corner_dual(dx, dy, lo, hi, eta, side, af, ab, left, right)
    return (_pays(px, py, lo, -1.0, at_lo, left, right), _pays(px, py, hi, 1.0, at_hi, left, right))


@lean
def best_extent(
    dx: float, dy: float, eta: float, af: float, ab: float, left: FloatTable, right: FloatTable,
    bound: float,
) -> tuple[float, float, float]:  # fmt: skip
    """Return ``(energy, lo, hi)`` of the best schedule to the left; infinite above `bound`."""
    # A dual vector within both straight costs is feasible for every schedule, and an excursion
    # never lowers its value: it bounds all of them from below.
    d = math.hypot(dx, dy)
    floor = 0.0
    q = 0.999999 * min(af, ab)
    if d > 0.0:
        floor, _, _ = dual_value(q * dx / d, q * dy / d, dx, dy, -eta, eta, eta, left, right)
    rest, _, _ = dual_value(0.0, 0.0, dx, dy, -eta, eta, eta, left, right)
    if max(floor, rest) >= bound:
        return math.inf, -eta, eta
    half = max(eta, 0.5 * NARROW)
    lo, hi = -half, half
    energy, px, py, at_lo, at_hi = maximise(dx, dy, lo, hi, half, af, ab, left, right, EXACT)
    best = energy, lo, hi
    if hi - lo >= math.pi:
        return best
    up = _pays(px, py, hi, 1.0, at_hi, left, right) > 0.0
    down = _pays(px, py, lo, -1.0, at_lo, left, right) > 0.0
    for first in range(2):
        if not (up if first == 0 else down):
            continue
        # An excursion beyond one end alone may be a local optimum, so each is tried.
        lo, hi = _extend(dx, dy, -half, half, half, af, ab, left, right, first == 0)
        energy, px, py, at_lo, at_hi = maximise(dx, dy, lo, hi, half, af, ab, left, right, EXACT)
        other = (lo, -1.0, at_lo) if first == 0 else (hi, 1.0, at_hi)
        more = _pays(px, py, *other, left, right) > 0.0
        for k in range(40):  # one end after the other, until Newton's method takes over
            side = 1 if at_hi - at_lo > 0.0 else -1
            # Two excursions turn about as much together as one of them alone would.
            share = 0.5 * (hi - half + -half - lo)
            a, b = (-half - share, half + share) if k == 0 else (lo, hi)
            a, b, found = _both(dx, dy, a, b, half, side, af, ab, left, right)
            if found and b - a < math.pi:
                tight = maximise(dx, dy, a, b, half, af, ab, left, right, EXACT)
                if tight[0] <= energy:
                    energy, lo, hi = tight[0], a, b
                    break
            if not more:
                break
            before = energy
            if (k % 2 == 0) == (first == 1):
                lo, hi = _extend(dx, dy, lo, half, half, af, ab, left, right, True)
            else:
                lo, hi = _extend(dx, dy, -half, hi, half, af, ab, left, right, False)
            energy, px, py, at_lo, at_hi = maximise(
                dx, dy, lo, hi, half, af, ab, left, right, EXACT
            )
            if before - energy <= 1e-9 * energy:
                break
        if energy < best[0]:
            best = energy, lo, hi
    return best


CLOSED = 1e-11  # straight segments below this length would only make up for rounding


@lean
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
            goals[i, 0] - starts[i, 0], goals[i, 1] - starts[i, 1], starts[i, 2], goals[i, 2], cost
        )


@lean
def _corner_at(q: float, table: FloatTable) -> int:
    """Index of the cheapest corner where ``p.u = q``."""
    best, index = math.inf, 0
    for k in range(table.shape[1]):
        value = table[1, k] - table[0, k] * q
        if value < best:
            best, index = value, k
    return index


@lean
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
            if ANGLE < ahead < nearest:
                nearest = ahead
    return heading + side * nearest if nearest < abs(stop - heading) else stop


@lean
def _sweep(
    start: float, stop: float, px: float, py: float, table: FloatTable, ds: Floats, dtheta: Floats,
    n: int,
) -> int:  # fmt: skip
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


@lean
def _travel(eta: float, ds: Floats, dtheta: Floats, n: int) -> Pose:
    """Where the first n segments lead from the heading -eta."""
    here = Pose(0.0, 0.0, -eta)
    for i in range(n):
        here = arc_end(here, ds[i], dtheta[i])
    return here


@lean
def _schedule_path(
    x: float, y: float, eta: float, lo: float, hi: float, af: float, ab: float, left: FloatTable,
    right: FloatTable, ds: Floats, dtheta: Floats,
) -> int:  # fmt: skip
    """Write the segments of the best motion with the headings [lo, hi], sweeping to the left."""
    half = max(eta, 0.5 * NARROW)
    _, px, py, at_lo, at_hi = maximise(x, y, lo, hi, half, af, ab, left, right, EXACT)
    n = _sweep(-eta, lo, px, py, right, ds, dtheta, 0)
    n = _sweep(lo, hi, px, py, left, ds, dtheta, n)
    n = _sweep(hi, eta, px, py, right, ds, dtheta, n)
    here = _travel(eta, ds, dtheta, n)
    rx, ry = x - here.x, y - here.y
    # Straight lines cover the rest at two headings: where the dual says, and where they take up
    # rounding.
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
    dx: float, dy: float, theta0: float, theta1: float, cost: PolygonSteering, ds: Floats,
    dtheta: Floats,
) -> int:  # fmt: skip
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
