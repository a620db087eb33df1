"""Compiled minimum-energy steering for costs that two numbers describe, in closed form.

Contract
--------
``steer_energy(dx, dy, theta0, theta1, cost) -> float``
    Least energy [J] from the pose ``(0, 0, theta0)`` to ``(dx, dy, theta1)`` of the body frame
    (world axes; headings of any size, taken modulo full turns), in one or two microseconds.
``steer_path(dx, dy, theta0, theta1, cost, ds, dtheta) -> int``
    Writes the segments of a motion that attains it into ``ds`` and ``dtheta`` (arrays of length
    `MAX_SEGMENTS` or more), in the convention of `Path`: ``ds`` belongs to the reference point
    ``(longitudinal, 0)``. Returns how many segments there are.
``steer_energies(starts, goals, cost, out)``
    The first one over rows of poses.

Other costs are solved by `energyplan.steering.polygon`, with the same contract. Whoever goes along
an arc takes its step from `arc_end`.
"""

from __future__ import annotations

import math
from math import cos, sin
from typing import NamedTuple

from energyplan.compilation import Floats, FloatTable, lean, njit
from energyplan.cost.steering import StaticSteering
from energyplan.path import ANGLE, Pose
from energyplan.steering import static_words as words
from energyplan.steering.static_words import HALF_PI, TWO_PI, Word, best_word

MAX_SEGMENTS = 256
MIN_RATIO = 1e-9  # beta / (a C); below it the excursion equation degenerates


class RelativePose(NamedTuple):
    """Two poses, seen from the middle of their headings."""

    x: float  # x of the displacement of the midpoint of the tread ICRs, in half slip tracks
    y: float  # y of that displacement, in half slip tracks
    turn: float  # turn to the left [rad], in [0, 2 pi)


@lean
def between_poses(
    dx: float, dy: float, theta0: float, theta1: float, half_track: float, longitudinal: float,
    lateral: float,
) -> RelativePose:  # fmt: skip
    """Return two poses as they are seen from the middle of their headings."""
    if longitudinal != 0.0 or lateral != 0.0:
        c0, s0, c1, s1 = math.cos(theta0), math.sin(theta0), math.cos(theta1), math.sin(theta1)
        dx += longitudinal * (c1 - c0) - lateral * (s1 - s0)
        dy += longitudinal * (s1 - s0) + lateral * (c1 - c0)
    turn = (theta1 - theta0) % TWO_PI
    if turn > TWO_PI - ANGLE:
        turn = 0.0
    middle = theta0 + 0.5 * turn
    c, s = math.cos(middle), math.sin(middle)
    return RelativePose((c * dx + s * dy) / half_track, (c * dy - s * dx) / half_track, turn)


@njit
def steer_energy(dx: float, dy: float, theta0: float, theta1: float, cost: StaticSteering) -> float:
    """Least energy between two poses [J]; see the module's contract."""
    x, y, turn = between_poses(
        dx, dy, theta0, theta1, cost.half_track, cost.longitudinal, cost.lateral
    )
    scale = cost.per_metre * cost.half_track
    c = max(cost.per_radian / scale - 1.0, MIN_RATIO)
    eta = 0.5 * turn
    if eta > HALF_PI:
        eta = math.pi - eta  # the shorter way round first: it prunes the longer one
    short = best_word(x, y, eta, c, math.inf)
    far = best_word(x, y, math.pi - eta, c, short.cost)
    return scale * far.cost


@njit
def steer_energies(
    starts: FloatTable, goals: FloatTable, cost: StaticSteering, out: Floats
) -> None:
    """Fill `out` with the least energies between rows of poses, shapes (n, 3), (n, 3), (n,)."""
    for i in range(len(out)):
        out[i] = steer_energy(
            goals[i, 0] - starts[i, 0], goals[i, 1] - starts[i, 1], starts[i, 2], goals[i, 2], cost
        )


class Switches(NamedTuple):
    """Pivots of `sign` (1 forwards) below the heading `z1` and above `z2`, else of the other."""

    sign: float
    z1: float
    z2: float


@lean
def free_switches(x: float, y: float, eta: float) -> Switches:
    """Return the pivots that reach ``(x, y)`` within the sweep: a chord gives both switches."""
    best, choice = math.inf, Switches(1.0, 0.0, 0.0)
    for j in range(4):
        sign = 1.0 if j % 2 == 0 else -1.0
        cx, cy = 2.0 * math.sin(eta) - sign * x, -sign * y
        half = math.asin(min(1.0, 0.25 * math.hypot(cx, cy)))
        middle = math.atan2(cy, cx)
        if j >= 2:
            half = math.pi - half
        excess = max(abs(middle) + half - eta, 0.0)
        if excess < best:
            best = excess
            choice = Switches(sign, max(middle - half, -eta), min(middle + half, eta))
    return choice


@lean
def sweep(
    start: float, stop: float, z1: float, z2: float, sign: float, ds: Floats, dtheta: Floats,
    n: int,
) -> int:  # fmt: skip
    """Append the pivots of a sweep of headings; they change direction at ``z1`` and ``z2``."""
    up = stop >= start
    here = start
    for j in range(3):
        edge = stop
        if j < 2:
            edge = z1 if (j == 0) == up else z2
            edge = min(max(edge, here), stop) if up else max(min(edge, here), stop)
        turn = edge - here
        if turn != 0.0:
            middle = 0.5 * (here + edge)
            way = -sign if z1 < middle < z2 else sign
            ds[n], dtheta[n] = way * abs(turn), turn
            n += 1
        here = edge
    return n


@lean
def straight(length: float, ds: Floats, dtheta: Floats, n: int) -> int:
    """Append a straight line unless its length is zero."""
    if length == 0.0:
        return n
    ds[n], dtheta[n] = length, 0.0
    return n + 1


@lean
def _word_path(
    word: Word, x: float, y: float, eta: float, ds: Floats, dtheta: Floats,
) -> int:  # fmt: skip
    """Write the segments of a word, in its units, for a sweep to the left."""
    code, sx, sy, q1, q2, q3 = word.code, word.sx, word.sy, word.q1, word.q2, word.q3
    lo, hi, z1, z2, sign = -eta, eta, 9.0, 9.0, 1.0  # pivots go by `sign` below z1 and above z2
    at_lo, at_hi, psi, inner = 0.0, 0.0, 0.0, 0.0
    if code == words.FREE:
        switches = free_switches(x, y, eta)
        sign, z1, z2 = switches.sign, switches.z1, switches.z2
    elif code == words.N_STRAIGHT:
        psi, inner = q1, q2
    elif code == words.N_INNER:
        psi, inner, z1 = q1, q2, q1 + HALF_PI
    elif code == words.N_TWO_ZEROS:
        psi, inner, sign, z1, z2 = q1, q2, -1.0, q1 - HALF_PI, q1 + HALF_PI
    elif code == words.N_END:
        z1, sign, at_hi = q1, -1.0, q2
    elif code == words.N_ENDS:
        z1, sign, at_hi, at_lo = q1, -1.0, q2, -q3
    elif code == words.E_PLAIN:
        hi, at_hi = q1, q2
    elif code == words.E_ZERO or code == words.E_ZERO_OUT:
        hi, at_hi, z1, sign = q1, q2, q3, -1.0
    elif code == words.E_ENDS or code == words.E_ENDS_OUT:
        hi, at_hi, at_lo, z1, sign = q1, q2, -q3, 0.5 * (q1 - eta), -1.0
    else:
        hi, lo, at_hi, at_lo, z1, sign = q1, 2.0 * q3 - q1, q2, -q2, q3, -1.0
    if sx < 0:
        sign, at_lo, at_hi, inner = -sign, -at_lo, -at_hi, -inner
    if sx * sy < 0:
        lo, hi, psi, at_lo, at_hi = -hi, -lo, -psi, at_hi, at_lo
        if z2 == 9.0:  # a single switch, or none: the other sign lies below it
            z1, sign = (-z1, -sign) if z1 != 9.0 else (z1, sign)
        else:
            z1, z2 = -z2, -z1
    n = sweep(-eta, lo, z1, z2, sign, ds, dtheta, 0)
    n = straight(at_lo, ds, dtheta, n)
    if inner != 0.0:
        n = sweep(lo, psi, z1, z2, sign, ds, dtheta, n)
        n = straight(inner, ds, dtheta, n)
        n = sweep(psi, hi, z1, z2, sign, ds, dtheta, n)
    else:
        n = sweep(lo, hi, z1, z2, sign, ds, dtheta, n)
    n = straight(at_hi, ds, dtheta, n)
    return sweep(hi, eta, z1, z2, sign, ds, dtheta, n)


@njit
def steer_path(
    dx: float, dy: float, theta0: float, theta1: float, cost: StaticSteering, ds: Floats,
    dtheta: Floats,
) -> int:  # fmt: skip
    """Write the segments of a motion of least energy; see the module's contract."""
    C = cost.half_track
    x, y, turn = between_poses(dx, dy, theta0, theta1, C, cost.longitudinal, cost.lateral)
    c = max(cost.per_radian / (cost.per_metre * C) - 1.0, MIN_RATIO)
    eta = 0.5 * turn
    left = best_word(x, y, eta, c, math.inf)
    # A turn to the right is one to the left, seen in a mirror from the opposite middle heading.
    right = best_word(-x, y, math.pi - eta, c, left.cost)
    side = -1.0 if right.code >= 0 else 1.0
    if right.code >= 0:
        n = _word_path(right, -x, y, math.pi - eta, ds, dtheta)
    else:
        n = _word_path(left, x, y, eta, ds, dtheta)
    for i in range(n):
        dtheta[i] *= side
        ds[i] = C * ds[i] + cost.lateral * dtheta[i]
    return n


@lean
def chord_factor(dtheta: float) -> float:
    """Length of the chord of an arc, in units of the arc's length."""
    half = 0.5 * dtheta
    return sin(half) / half if half != 0.0 else 1.0


@njit
def arc_end(pose: Pose, ds: float, dtheta: float) -> Pose:
    """Return where the motion ends that turns by `dtheta` over the arc length `ds`."""
    middle = pose.yaw + 0.5 * dtheta
    chord = ds * chord_factor(dtheta)
    return Pose(pose.x + chord * cos(middle), pose.y + chord * sin(middle), pose.yaw + dtheta)
