"""The cheapest motion that never drives backwards, in closed form but for one root.

Units and frame are those of `static_words`: half the slip track, straight driving at 1 per unit,
turning at ``1 + c`` per radian, and a main sweep of headings from ``-eta`` to ``eta``. While it
turns, the robot moves ahead by up to 1 per radian at no further cost: a dual vector of direction
``psi`` says where, at the headings ``phi`` with ``cos(phi - psi) > 0``; elsewhere it spins. It
drives straight at one heading of the sweep, or at an end of it, or at both ends. Beyond an end
with a line of length ``L`` an excursion, passed twice, pays as far as ``L tan(psi - end) = 2 c``.
So each word is a constant ``K`` and a number ``m`` of unit vectors, which say in which part of the
schedule the robot begins, or ceases, to move ahead (docs/planner.md).

Where it may not spin, a motion is two arcs of the track's radius and a straight line, or a third
arc, between them.
"""

from __future__ import annotations

from math import acos, atan2, cos, hypot, inf, pi, sin, sqrt
from typing import NamedTuple

from energyplan.compilation import Floats, FloatTable, lean, njit
from energyplan.cost.steering import StaticSteering
from energyplan.path import ANGLE, Pose
from energyplan.steering.kernels import (
    MIN_RATIO,
    RelativePose,
    between_poses,
    free_switches,
    straight,
    sweep,
)
from energyplan.steering.static_words import HALF_PI, TWO_PI, free


class Forward(NamedTuple):
    """A word: its cost, the ends of its schedule, and the straight lines on the way."""

    cost: float
    lo: float
    hi: float
    at_lo: float
    at_hi: float
    within: float  # line at the heading psi
    psi: float  # 9 where the sweep alone leads there


@lean
def _without_excursion(x: float, y: float, eta: float, base: float, best: Forward) -> Forward:
    """Return the cheapest word with one line in the sweep or with one at both ends, or the best."""
    k, s = cos(eta), sin(eta)
    # K and m: all of the sweep leads ahead, or what lies below psi + pi/2, above psi - pi/2, both
    for kx, ky, m, kind in (
        (2.0 * s, 0.0, 0.0, 0), (s, k, 1.0, 1), (s, -k, 1.0, 2), (0.0, 0.0, 2.0, 3),
        (2.0 * s, 0.0, 2.0, 4),
    ):  # fmt: skip
        length = hypot(x - kx, y - ky) - m
        if length < 0.0 or base + length >= best.cost:
            continue
        psi = atan2(y - ky, x - kx)
        below = psi - HALF_PI > -eta + ANGLE  # spins below psi - pi/2
        above = psi + HALF_PI < eta - ANGLE
        far = abs(psi) - 3.0 * HALF_PI > -eta + ANGLE
        fits = (
            (kind == 0 and not below and not above)
            or (kind == 1 and not below and above and not far)
            or (kind == 2 and below and not above and not far)
            or (kind == 3 and below and above)
            or (kind == 4 and far)
        )
        if fits and abs(psi) <= eta + ANGLE:
            best = Forward(base + length, -eta, eta, 0.0, 0.0, length, psi)
    if eta > HALF_PI + ANGLE:
        both, less = (x - 2.0 * s + 2.0) / k, y / s
        if both >= abs(less) and base + both < best.cost:
            halves = 0.5 * (both - less), 0.5 * (both + less)
            best = Forward(base + both, -eta, eta, halves[0], halves[1], 0.0, pi)
    return best


@lean
def _root(far: float, m: float, c: float) -> float:
    """Length ``L`` at which ``L u + m u(tau) - 2 n`` is so far, with ``L tan(tau) = 2 c``."""
    low, high, length = 0.0, far, far
    for _ in range(80):
        q = sqrt(length * length + 4.0 * c * c)
        value = length * length + 2.0 * m * (length * length - 4.0 * c) / q + m * m + 4.0
        value -= far * far
        if value > 0.0:
            high = length
        else:
            low = length
        slope = 2.0 * length + 2.0 * m * length * (2.0 / q - (length * length - 4.0 * c) / q**3)
        step = length - value / slope if slope > 0.0 else low
        if not low < step < high:
            step = 0.5 * (low + high)
        if abs(step - length) <= 1e-15 * length:
            break
        length = step
    return length


@lean
def _angle(q: float, rest: float) -> float:
    """Return the angle whose sine is q, which is so much below 1: exact near a right angle too."""
    return atan2(q, sqrt(max(rest, 0.0) * (1.0 + q)))


@lean
def _at_upper_end(x: float, y: float, eta: float, c: float, side: float, best: Forward) -> Forward:
    """Return the cheapest word with a line at the upper end (lower: `side` -1), or the best."""
    k, s, turn = cos(eta), sin(eta), 1.0 + c
    base = 2.0 * turn * eta
    # no excursion: the robot moves ahead above z, and maybe below z - pi
    for kx, ky, m in ((s, -k, 1.0), (2.0 * s, 0.0, 2.0)):
        vx, vy = x - kx, y - ky
        along = vx * k + vy * s
        inside = along * along - (vx * vx + vy * vy) + m * m
        root = sqrt(max(inside, 0.0))
        for length in (along - root, along + root):
            if inside < 0.0 or length < 0.0 or base + length >= best.cost:
                continue
            z = atan2(length * k - vx, vy - length * s)
            wraps = z - pi > -eta + ANGLE
            if -eta - ANGLE <= z <= eta + ANGLE and wraps == (m == 2.0) and z + pi >= eta - ANGLE:
                best = _ended(base + length, eta, eta, 0.0, length, z + HALF_PI, side, best)
    for kx, ky, m, kind in (
        (0.0, 2.0 * k, 0.0, 0), (-s, k, 1.0, 1), (0.0, 0.0, 2.0, 2), (0.0, 2.0 * k, 2.0, 3),
        (s, k, 3.0, 4),
    ):  # fmt: skip
        far = hypot(x - kx, y - ky)
        if far < abs(m - 2.0):
            continue
        length = sqrt(far * far - 4.0) if m == 0.0 else _root(far, m, c)
        if base + length >= best.cost:
            continue
        tau = atan2(2.0 * c, length)
        h = atan2(y - ky, x - kx) - atan2(m * sin(tau) - 2.0, length + m * cos(tau))
        h += TWO_PI * -((h - eta + ANGLE) // TWO_PI)
        h = max(h, eta)
        z = h + tau - HALF_PI
        low, in_main, wraps = z < -eta - ANGLE, z < eta, z - pi > -eta
        fits = (
            (kind == 0 and z <= -eta + ANGLE)
            or (kind == 1 and not low and in_main and not wraps)
            or (kind == 2 and not in_main and not wraps)
            or (kind == 3 and in_main and wraps)
            or (kind == 4 and not in_main and wraps and z - pi <= eta)
        )
        if fits:
            cost = 2.0 * turn * h + length
            best = _ended(cost, eta, h, 0.0, length, h + tau, side, best)
    # an excursion beyond this end, and a line at the other one as well
    for kx, ky, m in ((s, k, 3.0), (0.0, 2.0 * k, 2.0)):
        vx, vy = x - kx, y - ky
        across = vx * s + vy * k
        inside = m * m + 16.0 * turn * (4.0 * c + 2.0 + across)
        root = sqrt(max(inside, 0.0))
        other_root = -2.0 * (4.0 * c + 2.0 + across) / (m + root)
        for q in ((m + root) / (8.0 * turn), other_root):
            if inside < 0.0 or not 0.0 < q <= 1.0:
                continue
            tau = _angle(q, (2.0 - m - across) / (4.0 * turn + 4.0 * turn * q - m))
            length = 2.0 * c * cos(tau) / q
            h = TWO_PI - 2.0 * tau - eta
            other = vx * k - vy * s - length * cos(2.0 * tau) + 2.0 * sin(2.0 * tau) - m * cos(tau)
            if h < eta - ANGLE or other < 0.0:
                continue
            if (h + tau - HALF_PI >= eta) == (m == 3.0):
                cost = 2.0 * turn * h + length + other
                best = _ended(cost, eta, h, other, length, h + tau, side, best)
    return best


@lean
def _ended(
    cost: float, eta: float, h: float, other: float, length: float, psi: float, side: float,
    best: Forward,
) -> Forward:  # fmt: skip
    """Return a word with a line at one end, as it is without a mirror, if it is the better one."""
    if cost >= best.cost:
        return best
    if side > 0.0:
        return Forward(cost, -eta, h, other, length, 0.0, psi)
    return Forward(cost, -h, eta, length, other, 0.0, -psi)


@lean
def _beyond_both_ends(x: float, y: float, eta: float, c: float, best: Forward) -> Forward:
    """Return the cheapest word with excursions beyond both ends, or the best so far."""
    k, s, turn = cos(eta), sin(eta), 1.0 + c
    for kx, ky, m, upper, lower in (
        (0.0, 0.0, 4.0, True, True), (-s, k, 3.0, False, True), (-s, -k, 3.0, True, False),
        (-2.0 * s, 0.0, 2.0, False, False),
    ):  # fmt: skip
        far = hypot(x - kx, y - ky)
        root = sqrt((m - far) ** 2 + 64.0 * turn * c)
        q = (m - far + root) / (8.0 * turn) if far < m else 8.0 * c / (root + far - m)
        if not 0.0 < q <= 1.0:
            continue
        tau = _angle(q, (4.0 + far - m) * q / (4.0 * (turn * q + c)))
        length = 2.0 * c * cos(tau) / q
        cost = turn * (4.0 * (pi - tau) - 2.0 * eta) + 2.0 * length
        if cost >= best.cost:
            continue
        psi = atan2(y - ky, x - kx)
        psi += TWO_PI * -((psi - tau - eta + ANGLE) // TWO_PI)
        lo, z = psi + tau - TWO_PI, psi - HALF_PI
        if lo <= -eta + ANGLE and (z >= eta) == upper and (z - pi <= -eta) == lower:
            best = Forward(cost, lo, psi - tau, length, length, 0.0, psi)
    return best


@lean
def best_forward(x: float, y: float, eta: float, c: float, bound: float) -> Forward:
    """Return the cheapest word for one sweep; its cost is `bound` where there is none below."""
    base = 2.0 * (1.0 + c) * eta
    best = Forward(bound, -eta, eta, 0.0, 0.0, 0.0, 9.0)
    if base >= bound:
        return best
    # half a pivot, and half a pivot forwards or backwards
    if free(2.0 * (x - sin(eta)), 2.0 * y, eta):
        return Forward(base, -eta, eta, 0.0, 0.0, 0.0, 9.0)
    best = _without_excursion(x, y, eta, base, best)
    best = _at_upper_end(x, y, eta, c, 1.0, best)
    best = _at_upper_end(x, -y, eta, c, -1.0, best)
    return _beyond_both_ends(x, y, eta, c, best)


@lean
def _part(start: float, stop: float, psi: float, ds: Floats, dtheta: Floats, n: int) -> int:
    """Append a sweep of headings that moves ahead where ``cos(heading - psi) > 0``."""
    side = 1.0 if stop >= start else -1.0
    here = start
    while side * (stop - here) > 0.0:
        # that changes at headings half a turn from each other
        passed = (side * (here - psi) - HALF_PI + ANGLE) // pi + 1.0
        edge = psi + side * (passed * pi + HALF_PI)
        if side * (stop - edge) < 0.0:
            edge = stop
        turn = edge - here
        ds[n] = abs(turn) if cos(0.5 * (here + edge) - psi) > 0.0 else 0.0
        dtheta[n] = turn
        n += 1
        here = edge
    return n


@lean
def _written(word: Forward, x: float, y: float, eta: float, ds: Floats, dtheta: Floats) -> int:
    """Write the segments of a word, in its units, for a sweep to the left."""
    if word.psi == 9.0:
        switches = free_switches(2.0 * (x - sin(eta)), 2.0 * y, eta)
        n = sweep(-eta, eta, switches.z1, switches.z2, switches.sign, ds, dtheta, 0)
        for i in range(n):
            ds[i] = max(ds[i], 0.0)
        return n
    n = _part(-eta, word.lo, word.psi, ds, dtheta, 0)
    n = straight(word.at_lo, ds, dtheta, n)
    if word.within > 0.0:
        n = _part(word.lo, word.psi, word.psi, ds, dtheta, n)
        n = straight(word.within, ds, dtheta, n)
        n = _part(word.psi, word.hi, word.psi, ds, dtheta, n)
    else:
        n = _part(word.lo, word.hi, word.psi, ds, dtheta, n)
    n = straight(word.at_hi, ds, dtheta, n)
    return _part(word.hi, eta, word.psi, ds, dtheta, n)


class _Two(NamedTuple):
    """Two poses as both ways of turning see them, and the cheapest word of either."""

    between: RelativePose
    left: Forward
    right: Forward  # in a mirror, from the opposite middle heading; the better one if it is finite


@lean
def _cheapest(dx: float, dy: float, theta0: float, theta1: float, cost: StaticSteering) -> _Two:
    track = cost.half_track
    seen = between_poses(dx, dy, theta0, theta1, track, cost.longitudinal, cost.lateral)
    c = max(cost.per_radian / (cost.per_metre * track) - 1.0, MIN_RATIO)
    left = best_forward(seen.x, seen.y, 0.5 * seen.turn, c, inf)
    right = best_forward(-seen.x, seen.y, pi - 0.5 * seen.turn, c, left.cost)
    return _Two(seen, left, right)


@lean
def forward_energy(
    dx: float, dy: float, theta0: float, theta1: float, cost: StaticSteering
) -> float:
    """Least energy of a motion forwards, as that of `steer_energy`."""
    found = _cheapest(dx, dy, theta0, theta1, cost)
    return cost.per_metre * cost.half_track * min(found.left.cost, found.right.cost)


@njit
def forward_energies(
    starts: FloatTable, goals: FloatTable, cost: StaticSteering, out: Floats
) -> None:
    """Fill `out` with the least energies forwards between rows of poses, as `steer_energies`."""
    for i in range(len(out)):
        out[i] = forward_energy(
            goals[i, 0] - starts[i, 0], goals[i, 1] - starts[i, 1], starts[i, 2], goals[i, 2], cost
        )


@njit
def forward_path(
    dx: float, dy: float, theta0: float, theta1: float, cost: StaticSteering, ds: Floats,
    dtheta: Floats,
) -> int:  # fmt: skip
    """Write the segments of the cheapest motion forwards, as `steer_path`."""
    found = _cheapest(dx, dy, theta0, theta1, cost)
    x, y, eta = found.between.x, found.between.y, 0.5 * found.between.turn
    side = -1.0 if found.right.cost < found.left.cost else 1.0
    if side < 0.0:
        n = _written(found.right, -x, y, pi - eta, ds, dtheta)
    else:
        n = _written(found.left, x, y, eta, ds, dtheta)
    for i in range(n):
        dtheta[i] *= side
        ds[i] = cost.half_track * ds[i] + cost.lateral * dtheta[i]
    return n


@lean
def _turned(side: float, before: float, after: float) -> float:
    """Return the turn to one side from a heading to another [rad], in [0, 2 pi)."""
    turn = (side * (after - before)) % TWO_PI
    return 0.0 if turn > TWO_PI - ANGLE else turn


@lean
def arcs_forwards(pose: Pose, to: Pose, cost: StaticSteering, ds: Floats, dtheta: Floats) -> int:
    """Write the cheapest of the motions of arcs of one radius with a line or an arc between."""
    radius, best = cost.half_track, inf
    for both in range(4):
        s1 = 1.0 if both % 2 == 0 else -1.0
        s2 = 1.0 if both < 2 else -1.0
        # between the centres of both arcs
        x = to.x - s2 * radius * sin(to.yaw) - pose.x + s1 * radius * sin(pose.yaw)
        y = to.y + s2 * radius * cos(to.yaw) - pose.y - s1 * radius * cos(pose.yaw)
        far, aside = hypot(x, y), (s2 - s1) * radius
        for bent in (-1.0, 0.0, 1.0):
            length, middle = 0.0, 0.0
            if bent == 0.0:
                if far < abs(aside):
                    continue
                length = sqrt((far - aside) * (far + aside))
                way = atan2(y, x) - atan2(aside, length) if far > 0.0 else pose.yaw
                on = way
            else:
                if s1 != s2 or far > 4.0 * radius:
                    continue
                towards = atan2(y, x) + bent * acos(far / (4.0 * radius))
                back = atan2(2.0 * radius * sin(towards) - y, 2.0 * radius * cos(towards) - x)
                way, on = towards + s1 * HALF_PI, back + s1 * HALF_PI
                middle = _turned(-s1, way, on)
            a, b = _turned(s1, pose.yaw, way), _turned(s2, on, to.yaw)
            total = cost.per_metre * length + cost.per_radian * (a + middle + b)
            if total < best:
                best = total
                ds[0], dtheta[0] = radius * a, s1 * a
                ds[1], dtheta[1] = length + radius * middle, -s1 * middle
                ds[2], dtheta[2] = radius * b, s2 * b
    return 3
