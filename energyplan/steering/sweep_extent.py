"""How far beyond the headings of start and goal a motion should turn.

An excursion beyond an end of the sweep costs its turning, out and back, and pays by the better
heading for the straight line that is driven there. The derivative of the schedule's energy with
respect to the excursion is known from the dual solution, so the best excursion is a root
(docs/steering.md).
"""

from __future__ import annotations

import math

from energyplan.compilation import inner
from energyplan.compilation.arrays import FloatTable
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


@inner
def _pays(
    px: float,
    py: float,
    end: float,
    outward: float,
    length: float,
    left: FloatTable,
    right: FloatTable,
) -> float:
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


@inner
def _extend(
    dx: float,
    dy: float,
    lo: float,
    hi: float,
    eta: float,
    af: float,
    ab: float,
    left: FloatTable,
    right: FloatTable,
    upper: bool,
) -> tuple[float, float]:
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


@inner
def _both(
    dx: float,
    dy: float,
    lo: float,
    hi: float,
    eta: float,
    side: int,
    af: float,
    ab: float,
    left: FloatTable,
    right: FloatTable,
) -> tuple[float, float, bool]:
    """Best extent ``(lo, hi, found)`` beyond both ends, by Newton's method.

    Straight lines at both ends, and both excursions exactly worth their cost.
    """
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


@inner
def _gains(
    dx: float,
    dy: float,
    a: float,
    b: float,
    eta: float,
    side: int,
    af: float,
    ab: float,
    left: FloatTable,
    right: FloatTable,
) -> tuple[float, float]:
    """Return by how much both excursions pay, given the logarithms of their sizes."""
    lo, hi = -eta - math.exp(min(a, 1.0)), eta + math.exp(min(b, 1.0))
    _, px, py, at_lo, at_hi = corner_dual(dx, dy, lo, hi, eta, side, af, ab, left, right)
    return (
        _pays(px, py, lo, -1.0, at_lo, left, right),
        _pays(px, py, hi, 1.0, at_hi, left, right),
    )


@inner
def best_extent(
    dx: float,
    dy: float,
    eta: float,
    af: float,
    ab: float,
    left: FloatTable,
    right: FloatTable,
    bound: float,
) -> tuple[float, float, float]:
    """Return ``(energy, lo, hi)`` of the best schedule that sweeps to the left.

    The search is given up once no schedule can cost less than `bound`; the energy returned is then
    infinite.
    """
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
