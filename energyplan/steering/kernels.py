"""Compiled minimum-energy steering for single pose pairs, called by `steering` and by planners.

Contract
--------
``steer_energy(dx, dy, theta0, theta1, params) -> float``
    Least energy [J] from the pose ``(0, 0, theta0)`` to ``(dx, dy, theta1)`` of the body frame
    (world axes; headings of any size, taken modulo full turns).
``steer_path(dx, dy, theta0, theta1, params, ds, dtheta) -> int``
    Writes the segments of a motion that attains it into ``ds`` and ``dtheta`` (arrays of length
    `MAX_SEGMENTS` or more), in the convention of `Path`: ``ds`` belongs to the reference point
    ``(longitudinal, 0)``. Returns how many segments there are.
``steer_energies(starts, goals, params, out)``
    The first one over rows of poses.

``params`` is ``EnergyCost.steering_parameters``, a float array laid out as
``[KIND, C, longitudinal, lateral, a, b, ...]``: half slip track, body coordinates of the point
midway between the tread ICRs, joules per metre straight, joules per radian within the slip track.
`KIND` 0 is the case that these two numbers describe completely; it is solved in closed form, in one
or two microseconds. `KIND` 1 is a polygon of cost with more corners, solved by `_gauge` in
about a hundred; its data are ``[6]``, ``[7]`` joules per half slip track forwards and backwards,
``[8]``, ``[9]`` numbers of corners to the left and right, and from ``[16]`` on for each side the
rows ``m``, ``g`` and slopes.
"""

from __future__ import annotations

import math

import numpy as np

from energyplan.compilation import njit
from energyplan.path import FloatArray
from energyplan.steering import static_words as words
from energyplan.steering.polygon import polygon_energy, polygon_path
from energyplan.steering.static_words import best_word

MAX_SEGMENTS = 256
KIND, HALF_TRACK, LONGITUDINAL, LATERAL, PER_METRE, PER_RADIAN = range(6)
MIN_RATIO = 1e-9  # beta / (a C); below it the excursion equation degenerates
TWO_PI = 2.0 * math.pi
HALF_PI = 0.5 * math.pi


@njit
def _middle_frame(
    dx: float, dy: float, theta0: float, theta1: float, params: FloatArray
) -> tuple[float, float, float]:
    """Return ``(x, y, turn)``: displacement of the centre in the frame of the middle heading.

    The unit of length is half the slip track; ``turn`` in [0, 2 pi) is the turn to the left.
    """
    lx, ly = params[LONGITUDINAL], params[LATERAL]
    if lx != 0.0 or ly != 0.0:
        c0, s0, c1, s1 = math.cos(theta0), math.sin(theta0), math.cos(theta1), math.sin(theta1)
        dx += lx * (c1 - c0) - ly * (s1 - s0)
        dy += lx * (s1 - s0) + ly * (c1 - c0)
    turn = (theta1 - theta0) % TWO_PI
    if turn > TWO_PI - 1e-12:
        turn = 0.0
    middle = theta0 + 0.5 * turn
    c, s = math.cos(middle), math.sin(middle)
    C = params[HALF_TRACK]
    return (c * dx + s * dy) / C, (c * dy - s * dx) / C, turn


@njit
def steer_energy(dx: float, dy: float, theta0: float, theta1: float, params: FloatArray) -> float:
    """Least energy between two poses [J]; see the module's contract."""
    x, y, turn = _middle_frame(dx, dy, theta0, theta1, params)
    scale = params[PER_METRE] * params[HALF_TRACK]
    c = max(params[PER_RADIAN] / scale - 1.0, MIN_RATIO)
    eta = 0.5 * turn
    if params[KIND] != 0.0:
        return polygon_energy(x, y, eta, params)
    if eta > HALF_PI:
        eta = math.pi - eta  # the shorter way round first: it prunes the longer one
    short = best_word(x, y, eta, c, math.inf)
    far = best_word(x, y, math.pi - eta, c, short[0])
    return float(scale * far[0])


@njit
def steer_energies(
    starts: FloatArray, goals: FloatArray, params: FloatArray, out: FloatArray
) -> None:
    """Fill `out` with the least energies between rows of poses, shapes (n, 3), (n, 3), (n,)."""
    for i in range(len(out)):
        out[i] = steer_energy(
            goals[i, 0] - starts[i, 0],
            goals[i, 1] - starts[i, 1],
            starts[i, 2],
            goals[i, 2],
            params,
        )


@njit
def _free_switches(x: float, y: float, eta: float) -> tuple[float, float, float]:
    """Return ``(sign, z1, z2)``: pivots that reach ``(x, y)`` within the sweep.

    The pivots have `sign` (1 forwards) below the heading ``z1`` and above ``z2`` and the other
    one between. As ``sign * d = U(eta) - U(-eta) - 2 (U(z2) - U(z1))``, a chord of the unit circle
    gives both switches.
    """
    best, choice = math.inf, (1.0, 0.0, 0.0)
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
            choice = (sign, max(middle - half, -eta), min(middle + half, eta))
    return choice


@njit
def _sweep(
    start: float,
    stop: float,
    z1: float,
    z2: float,
    sign: float,
    ds: FloatArray,
    dtheta: FloatArray,
    n: int,
) -> int:
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


@njit
def _straight(length: float, ds: FloatArray, dtheta: FloatArray, n: int) -> int:
    """Append a straight line unless its length is zero."""
    if length == 0.0:
        return n
    ds[n], dtheta[n] = length, 0.0
    return n + 1


@njit
def _word_path(
    word: tuple[float, int, float, float, float, float, float],
    x: float,
    y: float,
    eta: float,
    ds: FloatArray,
    dtheta: FloatArray,
) -> int:
    """Write the segments of a word, in its units, for a sweep to the left."""
    _, code, sx, sy, q1, q2, q3 = word
    lo, hi, z1, z2, sign = -eta, eta, 9.0, 9.0, 1.0  # pivots go by `sign` below z1 and above z2
    at_lo, at_hi, psi, inner = 0.0, 0.0, 0.0, 0.0
    if code == words.FREE:
        sign, z1, z2 = _free_switches(x, y, eta)
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
    n = _sweep(-eta, lo, z1, z2, sign, ds, dtheta, 0)
    n = _straight(at_lo, ds, dtheta, n)
    if inner != 0.0:
        n = _sweep(lo, psi, z1, z2, sign, ds, dtheta, n)
        n = _straight(inner, ds, dtheta, n)
        n = _sweep(psi, hi, z1, z2, sign, ds, dtheta, n)
    else:
        n = _sweep(lo, hi, z1, z2, sign, ds, dtheta, n)
    n = _straight(at_hi, ds, dtheta, n)
    return _sweep(hi, eta, z1, z2, sign, ds, dtheta, n)


@njit
def steer_path(
    dx: float,
    dy: float,
    theta0: float,
    theta1: float,
    params: FloatArray,
    ds: FloatArray,
    dtheta: FloatArray,
) -> int:
    """Write the segments of a motion of least energy; see the module's contract."""
    x, y, turn = _middle_frame(dx, dy, theta0, theta1, params)
    C = params[HALF_TRACK]
    c = max(params[PER_RADIAN] / (params[PER_METRE] * C) - 1.0, MIN_RATIO)
    eta = 0.5 * turn
    if params[KIND] != 0.0:
        n = polygon_path(x, y, eta, params, ds, dtheta)
        for i in range(n):
            ds[i] = C * ds[i] + params[LATERAL] * dtheta[i]
        return n
    left = best_word(x, y, eta, c, math.inf)
    # A turn to the right is one to the left, seen in a mirror from the opposite middle heading.
    right = best_word(-x, y, math.pi - eta, c, left[0])
    if right[1] >= 0:
        n = _word_path(right, -x, y, math.pi - eta, ds, dtheta)
    else:
        n = _word_path(left, x, y, eta, ds, dtheta)
    side = -1.0 if right[1] >= 0 else 1.0
    for i in range(n):
        dtheta[i] *= side
        ds[i] = C * ds[i] + params[LATERAL] * dtheta[i]
    return n


@njit
def steer_paths_end(
    starts: FloatArray, goals: FloatArray, params: FloatArray, out: FloatArray
) -> None:
    """Fill `out` (n, 3) with each path's miss of the goal in x, y [m] and yaw [rad]."""
    ds, dtheta = np.empty(MAX_SEGMENTS), np.empty(MAX_SEGMENTS)
    lx = params[LONGITUDINAL]
    for i in range(len(out)):
        yaw = starts[i, 2]
        x = starts[i, 0] + lx * math.cos(yaw)
        y = starts[i, 1] + lx * math.sin(yaw)
        n = steer_path(
            goals[i, 0] - starts[i, 0],
            goals[i, 1] - starts[i, 1],
            yaw,
            goals[i, 2],
            params,
            ds,
            dtheta,
        )
        for k in range(n):
            half = 0.5 * dtheta[k]
            chord = ds[k] * (math.sin(half) / half if half != 0.0 else 1.0)
            x += chord * math.cos(yaw + half)
            y += chord * math.sin(yaw + half)
            yaw += dtheta[k]
        out[i, 0] = x - lx * math.cos(yaw) - goals[i, 0]
        out[i, 1] = y - lx * math.sin(yaw) - goals[i, 1]
        out[i, 2] = (yaw - goals[i, 2] + math.pi) % TWO_PI - math.pi
