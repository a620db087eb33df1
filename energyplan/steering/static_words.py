"""The finite list of words among which the cheapest static motion is found.

Units here: half the slip track is the unit of length, straight driving costs 1 per unit, turning
within the slip track ``1 + c`` per radian. The frame's x axis is the middle of the two headings, so
that the main sweep runs from ``-eta`` to ``+eta``, and ``(x, y)`` is the displacement.

What a schedule of headings costs depends only on how often each heading is passed. Passing a
heading twice that was already there never pays (docs/planner.md), so an optimal schedule is the
main sweep, passed once, with an excursion beyond either end, passed twice. A dual vector ``p``
says what happens along it: the robot pivots forwards where ``p.u > 0``, backwards where
``p.u < 0``, and drives straight where ``|p.u| = 1``. The cases that this leaves are solved in
closed form; one needs a root of a cubic.

Every word is a motion that can be driven, so the least of them is never below the optimum; that
one of them attains it is what docs/planner.md derives.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from energyplan.compilation import njit

TINY = 1e-12  # slack of conditions on headings; what it gives away is a rounding error
HALF_PI = 0.5 * math.pi

# Codes of the words. The letter of the group: N, no excursion; E, excursion at one end; B, at both.
FREE = 0
N_STRAIGHT = 1
N_INNER = 2
N_END = 3
N_ENDS = 4
N_TWO_ZEROS = 5
E_PLAIN = 6
E_ZERO = 7
E_ZERO_OUT = 8
E_ENDS = 9
E_ENDS_OUT = 10
B_ZERO = 11
B_ZERO_OUT = 12


class Word(NamedTuple):
    """A word that reaches the displacement."""

    cost: float  # its cost
    code: int  # which word it is
    sx: float  # signs by which the displacement was flipped before the word was fitted
    sy: float  # signs by which the displacement was flipped before the word was fitted
    q1: float  # the word's numbers
    q2: float  # the word's numbers
    q3: float  # the word's numbers


@njit
def _cubic(c: float, k: float, N: float) -> float:
    """Root ``w >= 1`` of the excursion equation ``c^2 w^3 + k c w^2 + B w - k (1 + c) = 0``.

    ``B = k^2/4 + 1 - c^2 - N^2/4``. The cubic is convex for ``w > 0`` with one positive root, so
    Newton's method from above falls onto it monotonically.
    """
    B = 0.25 * k * k + 1.0 - c * c - 0.25 * N * N
    w = 1.0 + 0.5 * N / c
    for _ in range(100):
        value = ((c * c * w + k * c) * w + B) * w - k * (1.0 + c)
        slope = (3.0 * c * c * w + 2.0 * k * c) * w + B
        step = value / slope
        if not step > 1e-16 * w:
            break
        w -= step
    return max(w, 1.0)


@njit
def free(x: float, y: float, eta: float) -> bool:
    """Tell whether pivots within the sweep reach ``(x, y)`` without any straight driving."""
    ax, ay = abs(x), abs(y)
    if eta < HALF_PI:
        # a disc about (0, -2 cos(eta)), written so that near the origin nothing cancels
        return ax * ax + ay * (ay + 4.0 * math.cos(eta)) <= 4.0 * math.sin(eta) ** 2
    rest = eta - HALF_PI  # a half turn reaches a disc of radius 2, the rest adds a lens
    # The lens of the rest lies along the y axis: its headings surround +-90 degrees.
    k, g = 2.0 * math.cos(rest), 2.0 * math.sin(rest)
    if ay >= g and ax <= (ay - g) * math.tan(HALF_PI - rest):
        return ax * ax + (ay - g) ** 2 <= 4.0
    return (ax + k) ** 2 + ay * ay <= 16.0


@njit
def best_word(x: float, y: float, eta: float, c: float, bound: float) -> Word:
    """Return the cheapest word for one sweep."""
    base = 2.0 * (1.0 + c) * eta
    best, code, bx, by, q1, q2, q3 = bound, -1, 1.0, 1.0, 0.0, 0.0, 0.0
    if base >= best:
        return Word(best, code, bx, by, q1, q2, q3)
    if free(x, y, eta):
        return Word(base, FREE, bx, by, q1, q2, q3)
    turn = 1.0 + c
    # no word costs less than the distance: what seems to is a difference lost to rounding
    least = math.hypot(x, y) * (1.0 - 1e-9)
    k, g = math.cos(eta), math.sin(eta)
    for flip in range(4):
        sx = 1.0 if flip < 2 else -1.0
        sy = 1.0 if flip % 2 == 0 else -1.0
        X, Y = sx * x, sy * y

        # -- no excursion -----------------------------------------------------------------------
        if sy > 0:
            vx, vy = X - 2.0 * g, Y
            L = math.hypot(vx, vy)
            if base + L < best and abs(math.atan2(vy, vx)) <= eta + TINY:
                best, code, bx, by, q1, q2 = base + L, N_STRAIGHT, sx, sy, math.atan2(vy, vx), L
            if eta > HALF_PI:
                vx = X + 2.0 * g
                L = math.hypot(vx, vy) - 4.0
                if L >= 0 and base + L < best:
                    psi = math.atan2(vy, vx)
                    if abs(psi) <= eta - HALF_PI + TINY:
                        best, code, bx, by, q1, q2 = base + L, N_TWO_ZEROS, sx, sy, psi, L
        vx, vy = X, Y - 2.0 * k
        N = math.hypot(vx, vy)
        if N >= 2.0 and base + N - 2.0 < best:
            psi = math.atan2(vy, vx)
            if -eta - TINY <= psi <= eta - HALF_PI + TINY:
                best, code, bx, by, q1, q2 = base + N - 2.0, N_INNER, sx, sy, psi, N - 2.0
        wx, wy = X, Y + 2.0 * k
        M2 = wx * wx + wy * wy
        if eta < HALF_PI:
            along = wx * k + wy * g
            inside = along * along - M2 + 4.0
            if inside >= 0.0:
                root = math.sqrt(inside)
                for j in range(2):
                    L = along - root if j == 0 else along + root
                    if L >= 0.0 and base + L < best:
                        z = math.atan2(-(wx - L * k), wy - L * g)
                        if abs(z) <= eta + TINY:
                            best, code, bx, by, q1, q2 = base + L, N_END, sx, sy, z, L
            if sx > 0 and g > 0:
                both, less = (Y - 2.0 + 2.0 * k) / g, X / k
                if both >= abs(less) and base + both < best:
                    best, code, bx, by = base + both, N_ENDS, sx, sy
                    q1, q2, q3 = 0.0, 0.5 * (both + less), 0.5 * (both - less)

        # -- excursion beyond the upper end -------------------------------------------------------
        if N >= 2.0:
            L = math.sqrt(N * N - 4.0)
            h = math.atan2(vy, vx) + math.atan2(2.0, L)
            if h < eta - TINY:
                h += 2.0 * math.pi
            cost = 2.0 * turn * max(h, eta) + L
            if h >= eta - TINY and least <= cost < best:
                best, code, bx, by, q1, q2 = cost, E_PLAIN, sx, sy, h, L
        ax, ay = X + 2.0 * g, Y
        A = math.hypot(ax, ay)
        w = _cubic(c, 2.0, A)
        t = math.sqrt(w * w - 1.0)
        L = 2.0 * c * t
        if base + L < best:
            h = math.atan2(ay, ax) - math.atan2(2.0 / w - 2.0, 2.0 * t / w + L)
            cost = 2.0 * turn * max(h, eta) + L
            if h >= eta - TINY and least <= cost < best:
                z = h - math.atan(t)
                if abs(z) <= eta + TINY:
                    best, code, bx, by, q1, q2, q3 = cost, E_ZERO, sx, sy, h, L, z
        M = math.sqrt(M2)
        if M >= 2.0:
            w = _cubic(c, 4.0, M)
            t = math.sqrt(w * w - 1.0)
            L = 2.0 * c * t
            if base + L < best:
                h = math.atan2(wy, wx) - math.atan2(4.0 / w - 2.0, 4.0 * t / w + L)
                cost = 2.0 * turn * max(h, eta) + L
                z = h - math.atan(t)
                if z >= eta - TINY and least <= cost < best:
                    best, code, bx, by, q1, q2, q3 = cost, E_ZERO_OUT, sx, sy, h, L, z
        for out in range(2):
            e = 2.0 if out == 0 else 4.0
            px, py = (ax, ay) if out == 0 else (wx, wy)
            across, along = px * g + py * k, px * k - py * g
            inside = e * e - 16.0 * turn * (across - 2.0 - 4.0 * c)
            if inside < 0.0:
                continue
            root = math.sqrt(inside)
            for j in range(2):
                q = (e + root if j == 0 else e - root) / (8.0 * turn)
                if not 0.0 < q <= 1.0:
                    continue
                s = math.sqrt(1.0 - q * q)
                L = 2.0 * c * s / q
                L0 = 4.0 * s * q - e * s + L * (2.0 * q * q - 1.0) - along
                if L0 < 0.0 or base + L + L0 >= best:
                    continue
                tau = math.acos(q)
                h = 2.0 * tau - eta
                cost = 2.0 * turn * max(h, eta) + L + L0
                if h < eta - TINY or not least <= cost < best:
                    continue
                if (tau <= 2.0 * eta) == (out == 0):
                    best, code, bx, by = cost, E_ENDS if out == 0 else E_ENDS_OUT, sx, sy
                    q1, q2, q3 = h, L, L0

        # -- excursions beyond both ends ----------------------------------------------------------
        if sx > 0:
            for j in range(2):
                value = N if j == 0 else -N
                if value > 2.0:
                    continue
                root = math.sqrt((2.0 + value) ** 2 + 64.0 * turn * c)
                if value > -2.0:
                    q = (2.0 + value + root) / (8.0 * turn)
                else:
                    q = 8.0 * c / (root - 2.0 - value)
                q = min(q, 1.0)
                tau, L = math.acos(q), 2.0 * c * math.sqrt(1.0 - q * q) / q
                cost = turn * max(4.0 * tau - 2.0 * eta, 2.0 * eta) + 2.0 * L
                if least <= cost < best:
                    z = math.atan2(vx, -vy) if j == 0 else math.atan2(-vx, vy)
                    if abs(z) <= eta + TINY and tau >= eta + abs(z) - TINY:
                        best, code, bx, by, q1, q2, q3 = cost, B_ZERO, sx, sy, z + tau, L, z
        ox, oy = X - 2.0 * g, Y
        value = -math.hypot(ox, oy)
        root = math.sqrt((4.0 + value) ** 2 + 64.0 * turn * c)
        q = (4.0 + value + root) / (8.0 * turn) if value > -4.0 else 8.0 * c / (root - 4.0 - value)
        q = min(q, 1.0)
        tau, L = math.acos(q), 2.0 * c * math.sqrt(1.0 - q * q) / q
        cost = turn * max(4.0 * tau - 2.0 * eta, 2.0 * eta) + 2.0 * L
        if least <= cost < best:
            z = math.atan2(-ox, oy)
            if z >= eta - TINY and tau >= eta + z - TINY:
                best, code, bx, by, q1, q2, q3 = cost, B_ZERO_OUT, sx, sy, z + tau, L, z
    return Word(best, code, bx, by, q1, q2, q3)
