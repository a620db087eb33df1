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

from energyplan.compilation import lean
from energyplan.path import ANGLE, ROUNDING

TWO_PI = 2.0 * math.pi
HALF_PI = 0.5 * math.pi

# Codes of the words. The letter of the group: N, no excursion; E, excursion at one end; B, at both.
FREE, N_STRAIGHT, N_INNER, N_END, N_ENDS, N_TWO_ZEROS = range(6)
E_PLAIN, E_ZERO, E_ZERO_OUT, E_ENDS, E_ENDS_OUT, B_ZERO, B_ZERO_OUT = range(6, 13)


class Word(NamedTuple):
    """A word that reaches the displacement."""

    cost: float  # its cost
    code: int  # which word it is
    sx: float  # sign by which x was flipped before the word was fitted
    sy: float  # sign by which y was flipped before the word was fitted
    q1: float  # first number of the word, a heading [rad]
    q2: float  # second number of the word, a length in half slip tracks
    q3: float  # third number of the word, a heading [rad] or a length in half slip tracks


@lean
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


@lean
def free(x: float, y: float, eta: float) -> bool:
    """Return whether pivots within the sweep reach ``(x, y)`` without any straight driving."""
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


class Sweep(NamedTuple):
    """A sweep from ``-eta`` to ``eta`` and its displacement, flipped by signs."""

    x: float
    y: float
    sx: float
    sy: float
    eta: float
    k: float  # cosine of eta
    g: float  # sine of eta
    c: float
    reach: float  # distance from (0, 2 k)
    base: float  # cost of the sweep alone
    least: float  # no word costs less


@lean
def _without_excursion(at: Sweep, best: Word) -> Word:
    """Return the cheapest word of the sweep alone, or the best so far."""
    x, y, sx, sy, eta, k, g, base = at.x, at.y, at.sx, at.sy, at.eta, at.k, at.g, at.base
    if sy > 0:
        L = math.hypot(x - 2.0 * g, y)
        if base + L < best.cost:
            psi = math.atan2(y, x - 2.0 * g)
            if abs(psi) <= eta + ANGLE:
                best = Word(base + L, N_STRAIGHT, sx, sy, psi, L, 0.0)
        L = math.hypot(x + 2.0 * g, y) - 4.0
        if eta > HALF_PI and L >= 0.0 and base + L < best.cost:
            psi = math.atan2(y, x + 2.0 * g)
            if abs(psi) <= eta - HALF_PI + ANGLE:
                best = Word(base + L, N_TWO_ZEROS, sx, sy, psi, L, 0.0)
    N = at.reach
    if N >= 2.0 and base + N - 2.0 < best.cost:
        psi = math.atan2(y - 2.0 * k, x)
        if -eta - ANGLE <= psi <= eta - HALF_PI + ANGLE:
            best = Word(base + N - 2.0, N_INNER, sx, sy, psi, N - 2.0, 0.0)
    if eta >= HALF_PI:
        return best
    wx, wy = x, y + 2.0 * k
    along = wx * k + wy * g
    inside = along * along - (wx * wx + wy * wy) + 4.0
    if inside >= 0.0:
        root = math.sqrt(inside)
        for L in (along - root, along + root):
            if L >= 0.0 and base + L < best.cost:
                z = math.atan2(-(wx - L * k), wy - L * g)
                if abs(z) <= eta + ANGLE:
                    best = Word(base + L, N_END, sx, sy, z, L, 0.0)
    if sx > 0 and g > 0:
        both, less = (y - 2.0 + 2.0 * k) / g, x / k
        if both >= abs(less) and base + both < best.cost:
            halves = 0.5 * (both + less), 0.5 * (both - less)
            best = Word(base + both, N_ENDS, sx, sy, 0.0, halves[0], halves[1])
    return best


@lean
def _beyond_one_end(at: Sweep, best: Word) -> Word:
    """Return the cheapest word with an excursion beyond the upper end, or the best so far."""
    x, y, sx, sy, eta, k, g, c, N, base, least = at
    turn = 1.0 + c
    if N >= 2.0:
        L = math.sqrt(N * N - 4.0)
        h = math.atan2(y - 2.0 * k, x) + math.atan2(2.0, L)
        if h < eta - ANGLE:
            h += TWO_PI
        cost = 2.0 * turn * max(h, eta) + L
        if h >= eta - ANGLE and least <= cost < best.cost:
            best = Word(cost, E_PLAIN, sx, sy, h, L, 0.0)
    # e: what pivots give, with the zero of p.u inside the sweep or out in the excursion
    for e, px, py in ((2.0, x + 2.0 * g, y), (4.0, x, y + 2.0 * k)):
        length = math.hypot(px, py)
        if e == 4.0 and length < 2.0:
            continue
        w = _cubic(c, e, length)
        t = math.sqrt(w * w - 1.0)
        L = 2.0 * c * t
        if base + L >= best.cost:
            continue
        h = math.atan2(py, px) - math.atan2(e / w - 2.0, e * t / w + L)
        z = h - math.atan(t)
        cost = 2.0 * turn * max(h, eta) + L
        if h >= eta - ANGLE and least <= cost < best.cost:
            if e == 2.0 and abs(z) <= eta + ANGLE:
                best = Word(cost, E_ZERO, sx, sy, h, L, z)
            elif e == 4.0 and z >= eta - ANGLE:
                best = Word(cost, E_ZERO_OUT, sx, sy, h, L, z)
    for e, px, py in ((2.0, x + 2.0 * g, y), (4.0, x, y + 2.0 * k)):
        across, along = px * g + py * k, px * k - py * g
        inside = e * e - 16.0 * turn * (across - 2.0 - 4.0 * c)
        if inside < 0.0:
            continue
        root = math.sqrt(inside)
        for q in ((e + root) / (8.0 * turn), (e - root) / (8.0 * turn)):
            if not 0.0 < q <= 1.0:
                continue
            s = math.sqrt(1.0 - q * q)
            L = 2.0 * c * s / q
            L0 = 4.0 * s * q - e * s + L * (2.0 * q * q - 1.0) - along
            if L0 < 0.0 or base + L + L0 >= best.cost:
                continue
            tau = math.acos(q)
            h = 2.0 * tau - eta
            cost = 2.0 * turn * max(h, eta) + L + L0
            if h < eta - ANGLE or not least <= cost < best.cost:
                continue
            if (tau <= 2.0 * eta) == (e == 2.0):
                best = Word(cost, E_ENDS if e == 2.0 else E_ENDS_OUT, sx, sy, h, L, L0)
    return best


@lean
def _beyond_both_ends(at: Sweep, best: Word) -> Word:
    """Return the cheapest word with excursions beyond both ends, or the best so far."""
    x, y, sx, sy, eta, k, g, c, N, _, least = at
    turn = 1.0 + c
    vx, vy = x, y - 2.0 * k
    ox, oy = x - 2.0 * g, y
    cases = (
        (2.0, N, vx, -vy), (2.0, -N, -vx, vy), (4.0, -math.hypot(ox, oy), -ox, oy),
    )  # fmt: skip
    for e, value, across, along in cases:
        if e == 2.0 and (sx < 0 or value > 2.0):
            continue
        root = math.sqrt((e + value) ** 2 + 64.0 * turn * c)
        q = (e + value + root) / (8.0 * turn) if value > -e else 8.0 * c / (root - e - value)
        q = min(q, 1.0)
        tau, L = math.acos(q), 2.0 * c * math.sqrt(1.0 - q * q) / q
        cost = turn * max(4.0 * tau - 2.0 * eta, 2.0 * eta) + 2.0 * L
        if not least <= cost < best.cost:
            continue
        z = math.atan2(across, along)
        if e == 2.0 and abs(z) <= eta + ANGLE and tau >= eta + abs(z) - ANGLE:
            best = Word(cost, B_ZERO, sx, sy, z + tau, L, z)
        elif e == 4.0 and z >= eta - ANGLE and tau >= eta + z - ANGLE:
            best = Word(cost, B_ZERO_OUT, sx, sy, z + tau, L, z)
    return best


@lean
def best_word(x: float, y: float, eta: float, c: float, bound: float) -> Word:
    """Return the cheapest word for one sweep."""
    base = 2.0 * (1.0 + c) * eta
    best = Word(bound, -1, 1.0, 1.0, 0.0, 0.0, 0.0)
    if base >= best.cost:
        return best
    if free(x, y, eta):
        return Word(base, FREE, 1.0, 1.0, 0.0, 0.0, 0.0)
    # no word costs less than the distance: what seems to is a difference lost to rounding
    least = math.hypot(x, y) * (1.0 - ROUNDING)
    k, g = math.cos(eta), math.sin(eta)
    for sx, sy in ((1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)):
        N = math.hypot(sx * x, sy * y - 2.0 * k)
        at = Sweep(sx * x, sy * y, sx, sy, eta, k, g, c, N, base, least)
        best = _without_excursion(at, best)
        best = _beyond_one_end(at, best)
        best = _beyond_both_ends(at, best)
    return best
