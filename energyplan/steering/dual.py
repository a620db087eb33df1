"""Steering for costs whose polygon has more corners than straight lines and equal pivots.

Hotel load with wheel-speed limits makes a spin quicker, and so cheaper, than a pivot; losses that
differ between the sides make left and right turns differ. The cost is then a convex polygon: the
cheapest elements are mixtures of its corners. For each turning direction the corners are turns with
``m = ds/dtheta`` (unit: half the slip track), at ``g`` joules per radian; straight driving costs
``af`` forwards and ``ab`` backwards per unit of length.

The energy of a schedule of headings that sweeps from ``-eta`` to ``eta`` with excursions to ``lo``
and ``hi`` is the maximum over the dual vector p of

    p.d + integral over [lo, hi] of G_left(p.u) + integral over both excursions of G_right(p.u),
    subject to -ab <= p.u <= af at every heading visited,   G(q) = min over corners of g - m q.

The gradient ``r`` of this concave function is the displacement that pivots leave to straight lines.
The maximum is looked for along the boundary of the constraints, and along the ray to it where the
boundary is not reached.
"""

from __future__ import annotations

import math

from energyplan.compilation import Floats, FloatTable, lean
from energyplan.steering.static_words import HALF_PI, TWO_PI

NARROW = 1e-9  # least width of the headings visited; a single one cannot hold a sideways dual

SEARCH, EXACT = 1e-6, 1e-15  # tolerances of `maximise` [rad]
COARSE = 1e-3  # of the fraction of a ray; Newton's method refines it

# Where a constraint is active; its side is 1 forwards, -1 backwards, 0 none.
INSIDE, AT_LO, AT_HI = 0, -1, 1


@lean
def least(q: float, m: Floats, g: Floats) -> float:
    """``G(q)``: least of ``g - m q`` over the corners."""
    best = math.inf
    for k in range(len(m)):
        best = min(best, g[k] - m[k] * q)
    return best


@lean
def _integral(
    rho: float, psi: float, a: float, b: float, m: Floats, g: Floats, q: Floats,
) -> tuple[float, float, float]:  # fmt: skip
    """Cost, and displacement along x and y, of the best corners for ``p = rho n(psi)``.

    Headings run from `a` to `b`. At a heading the best corner is the last one whose breakpoint
    ``q[k - 1]`` lies below ``p.u``.
    """
    cost = g[0] * (b - a)
    fx = m[0] * (math.sin(b) - math.sin(a))
    fy = m[0] * (math.cos(a) - math.cos(b))
    for k in range(1, len(m)):
        edge = q[k - 1]
        if edge >= rho:
            break  # breakpoints rise
        half = math.pi if edge <= -rho else math.acos(edge / rho)
        centre = psi + TWO_PI * math.ceil((a - psi - half) / TWO_PI)
        dm, dg = m[k] - m[k - 1], g[k] - g[k - 1]
        while centre - half < b:
            s, e = max(a, centre - half), min(b, centre + half)
            if e > s:
                cost += dg * (e - s)
                fx += dm * (math.sin(e) - math.sin(s))
                fy += dm * (math.cos(s) - math.cos(e))
            centre += TWO_PI
    return cost, fx, fy


@lean
def dual_value(
    px: float, py: float, dx: float, dy: float, lo: float, hi: float, eta: float, left: FloatTable,
    right: FloatTable,
) -> tuple[float, float, float]:  # fmt: skip
    """Dual function and its gradient, the displacement left to straight lines."""
    rho, psi = math.hypot(px, py), math.atan2(py, px)
    cost, fx, fy = _integral(rho, psi, lo, hi, left[0], left[1], left[2])
    if lo < -eta:
        e, x, y = _integral(rho, psi, lo, -eta, right[0], right[1], right[2])
        cost, fx, fy = cost + e, fx + x, fy + y
    if hi > eta:
        e, x, y = _integral(rho, psi, eta, hi, right[0], right[1], right[2])
        cost, fx, fy = cost + e, fx + x, fy + y
    rx, ry = dx - fx, dy - fy
    return cost + px * rx + py * ry, rx, ry


@lean
def _reach(ex: float, ey: float, lo: float, hi: float) -> tuple[float, int]:
    """Largest ``e.u`` over the headings visited, and where it is."""
    if (math.atan2(ey, ex) - lo) % TWO_PI <= hi - lo:
        return math.hypot(ex, ey), INSIDE
    at_lo = ex * math.cos(lo) + ey * math.sin(lo)
    at_hi = ex * math.cos(hi) + ey * math.sin(hi)
    return (at_hi, AT_HI) if at_hi > at_lo else (at_lo, AT_LO)


@lean
def _boundary(
    t: float, stretch: float, lo: float, hi: float, af: float, ab: float
) -> tuple[float, float, int, int]:
    """Point of the constraints' boundary in direction `t`, and which constraint is active there."""
    ex, ey = math.cos(t), stretch * math.sin(t)
    ahead, where = _reach(ex, ey, lo, hi)
    behind, place = _reach(-ex, -ey, lo, hi)
    if behind * af > ahead * ab:
        scale = ab / behind
        return scale * ex, scale * ey, -1, place
    scale = af / ahead
    return scale * ex, scale * ey, 1, where


@lean
def between(a: float, b: float, f_a: float, f_b: float) -> float:
    """Next point of a bracketed root search: regula falsi (Illinois), or the middle."""
    middle = 0.5 * (a + b)
    if f_a * f_b >= 0.0:
        return middle
    x = (a * f_b - b * f_a) / (f_b - f_a)
    return x if min(a, b) < x < max(a, b) else middle


@lean
def _ray(
    px: float, py: float, dx: float, dy: float, lo: float, hi: float, eta: float, left: FloatTable,
    right: FloatTable, tolerance: float,
) -> float:  # fmt: skip
    """Fraction of p at which the dual function is greatest along the ray to p."""
    low, high, f_low, f_high, last = 0.0, 1.0, 0.0, 0.0, 0
    for i in range(160):
        f = between(low, high, f_low, f_high) if i % 3 != 2 else 0.5 * (low + high)
        _, rx, ry = dual_value(f * px, f * py, dx, dy, lo, hi, eta, left, right)
        slope = rx * px + ry * py
        if slope > 0.0:
            low, f_low, f_high, last = f, slope, f_high * (0.5 if last == 1 else 1.0), 1
        else:
            high, f_high, f_low, last = f, slope, f_low * (0.5 if last == -1 else 1.0), -1
        if high - low <= tolerance * high or slope == 0.0:
            break
    return 0.5 * (low + high)


@lean
def _curvature(
    rho: float, psi: float, a: float, b: float, m: Floats, q: Floats
) -> tuple[float, float, float]:
    """Second derivatives (xx, xy, yy) of minus the integral of G over the headings a to b."""
    xx, xy, yy = 0.0, 0.0, 0.0
    for k in range(1, len(m)):
        ratio = q[k - 1] / rho
        if not -1.0 < ratio < 1.0:
            continue
        half = math.acos(ratio)
        weight = (m[k] - m[k - 1]) / (rho * math.sqrt(1.0 - ratio * ratio))
        for way in range(2):
            heading = psi - half if way == 0 else psi + half
            heading += TWO_PI * math.ceil((a - heading) / TWO_PI)
            while heading < b:
                c, s = math.cos(heading), math.sin(heading)
                xx, xy, yy = xx + weight * c * c, xy + weight * c * s, yy + weight * s * s
                heading += TWO_PI
    return xx, xy, yy


@lean
def _interior(
    px: float, py: float, dx: float, dy: float, lo: float, hi: float, eta: float, left: FloatTable,
    right: FloatTable,
) -> tuple[float, float, float, float]:  # fmt: skip
    """Return ``(energy, px, py, |r|)``: a maximum regardless of the constraints, by Newton."""
    value, rx, ry = dual_value(px, py, dx, dy, lo, hi, eta, left, right)
    for _ in range(40):
        rho, psi = math.hypot(px, py), math.atan2(py, px)
        xx, xy, yy = _curvature(rho, psi, lo, hi, left[0], left[2])
        if lo < -eta:
            x, m, y = _curvature(rho, psi, lo, -eta, right[0], right[2])
            xx, xy, yy = xx + x, xy + m, yy + y
        if hi > eta:
            x, m, y = _curvature(rho, psi, eta, hi, right[0], right[2])
            xx, xy, yy = xx + x, xy + m, yy + y
        det = xx * yy - xy * xy
        if not det > 1e-14 * xx * yy:
            break
        sx, sy = (yy * rx - xy * ry) / det, (xx * ry - xy * rx) / det
        step, better = 1.0, False
        for _ in range(8):
            nx, ny = px + step * sx, py + step * sy
            trial, tx, ty = dual_value(nx, ny, dx, dy, lo, hi, eta, left, right)
            if tx * tx + ty * ty < rx * rx + ry * ry:
                better = True
                break
            step *= 0.5
        if not better:
            break
        px, py, value, rx, ry = nx, ny, trial, tx, ty
        if rx * rx + ry * ry < 1e-28:
            break
    return value, px, py, math.hypot(rx, ry)


@lean
def _inside(px: float, py: float, lo: float, hi: float, af: float, ab: float) -> bool:
    """Return whether p satisfies the constraints."""
    return _reach(px, py, lo, hi)[0] <= af and _reach(-px, -py, lo, hi)[0] <= ab


@lean
def corner_dual(
    dx: float, dy: float, lo: float, hi: float, eta: float, side: int, af: float, ab: float,
    left: FloatTable, right: FloatTable,
) -> tuple[float, float, float, float, float]:  # fmt: skip
    """Dual vector at which both ends' constraints are active: `side` at hi, ``-side`` at lo.

    Returned as by `maximise`; it is the maximum if ``side * at_hi`` and ``-side * at_lo`` are not
    negative.
    """
    q0, q1 = (-ab, af) if side > 0 else (af, -ab)
    c0, s0, c1, s1 = math.cos(lo), math.sin(lo), math.cos(hi), math.sin(hi)
    det = math.sin(hi - lo)
    px, py = (q0 * s1 - q1 * s0) / det, (q1 * c0 - q0 * c1) / det
    value, rx, ry = dual_value(px, py, dx, dy, lo, hi, eta, left, right)
    return value, px, py, (rx * s1 - ry * c1) / det, (ry * c0 - rx * s0) / det


@lean
def maximise(
    dx: float, dy: float, lo: float, hi: float, eta: float, af: float, ab: float, left: FloatTable,
    right: FloatTable, tolerance: float,
) -> tuple[float, float, float, float, float]:  # fmt: skip
    """Return ``(energy, px, py, at_lo, at_hi)`` of the schedule with extent [lo, hi].

    `tolerance` is that of the direction of p [rad]. The last two are the signed lengths of
    straight driving at the ends of the extent; the rest of ``r(p)``, if any, is driven along p.
    """
    _, rx, ry = dual_value(0.0, 0.0, dx, dy, lo, hi, eta, left, right)
    stretch = 1.0 / max(math.sin(min(0.5 * (hi - lo), HALF_PI)), 0.5 * NARROW)
    middle = math.atan2(stretch * ry, rx)
    low, high = middle - HALF_PI, middle + HALF_PI
    f_low, f_high, last = 0.0, 0.0, 0
    side_low, side_high, where_low, where_high = 0, 0, 0, 0
    best, px, py, side, where = -math.inf, 0.0, 0.0, 0, 0
    tested, t = False, middle
    for i in range(120):
        # Kinks of the boundary make the rise jump; bisection now and then gets across them.
        t = between(low, high, f_low, f_high) if i % 4 != 3 else 0.5 * (low + high)
        px, py, side, where = _boundary(t, stretch, lo, hi, af, ab)
        best, rx, ry = dual_value(px, py, dx, dy, lo, hi, eta, left, right)
        if rx * px + ry * py < 0.0:
            side, where = 0, INSIDE
            fine = max(min(COARSE, COARSE * (high - low)), 4e-16)
            f = _ray(px, py, dx, dy, lo, hi, eta, left, right, fine)
            px, py = f * px, f * py
            best, rx, ry = dual_value(px, py, dx, dy, lo, hi, eta, left, right)
            if i % 4 == 0:  # the maximum may lie inside, where its gradient vanishes
                inner = _interior(px, py, dx, dy, lo, hi, eta, left, right)
                if inner[3] < 1e-12 and _inside(inner[1], inner[2], lo, hi, af, ab):
                    return inner[0], inner[1], inner[2], 0.0, 0.0
        if where == INSIDE:
            rise = px * ry - py * rx
        else:
            end = lo if where == AT_LO else hi
            rise = side * (math.cos(end) * ry - math.sin(end) * rx)
        if rise > 0.0:
            low, f_low, side_low, where_low = t, rise, side, where
            f_high, last = f_high * (0.5 if last == 1 else 1.0), 1
        else:
            high, f_high, side_high, where_high = t, rise, side, where
            f_low, last = f_low * (0.5 if last == -1 else 1.0), -1
        if rise == 0.0 or high - low <= tolerance:
            break
        if not tested and where_low * where_high == -1 and side_low * side_high == -1:
            # A corner of the region lies between: straight lines at both ends may share the rest.
            tested = True
            s1 = side_high if where_low == AT_LO else side_low
            corner = corner_dual(dx, dy, lo, hi, eta, s1, af, ab, left, right)
            if corner[3] * s1 <= 0.0 and corner[4] * s1 >= 0.0:
                return corner
    if side == 0:
        px, py, _, _ = _boundary(t, stretch, lo, hi, af, ab)
        f = _ray(px, py, dx, dy, lo, hi, eta, left, right, 4e-16)
        px, py = f * px, f * py
        best, _, _ = dual_value(px, py, dx, dy, lo, hi, eta, left, right)
        return best, px, py, 0.0, 0.0
    if where == AT_LO:
        return best, px, py, rx * math.cos(lo) + ry * math.sin(lo), 0.0
    if where == AT_HI:
        return best, px, py, 0.0, rx * math.cos(hi) + ry * math.sin(hi)
    return best, px, py, 0.0, 0.0
