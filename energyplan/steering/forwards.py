"""Motions that never drive backwards: two turns with a straight line, or a third turn, between.

A turn is an arc of the track's radius, or a spin where these are allowed; of a static cost both
take the same energy. The energy without this restriction is a lower bound of theirs.
"""

from __future__ import annotations

from math import acos, atan2, cos, hypot, inf, pi, sin, sqrt

from energyplan.compilation import Floats, inner
from energyplan.cost.steering import StaticSteering
from energyplan.path import Pose

TWO_PI = 2.0 * pi


@inner
def _turned(side: float, before: float, after: float) -> float:
    """Return the turn to one side from a heading to another [rad], in [0, 2 pi)."""
    turn = (side * (after - before)) % TWO_PI
    return 0.0 if turn > TWO_PI - 1e-12 else turn


@inner
def forwards(
    pose: Pose, to: Pose, cost: StaticSteering, spins: bool, ds: Floats, dtheta: Floats
) -> int:
    """Write the cheapest of these motions between two poses of the point between the tread ICRs."""
    best = inf
    count = 0
    for first in range(4):
        for last in range(4):
            if not spins and (first >= 2 or last >= 2):
                continue
            s1 = 1.0 if first % 2 == 0 else -1.0
            s2 = 1.0 if last % 2 == 0 else -1.0
            r1 = cost.half_track if first < 2 else 0.0
            r2 = cost.half_track if last < 2 else 0.0
            # between the centres of both turns
            x = to.x - s2 * r2 * sin(to.yaw) - pose.x + s1 * r1 * sin(pose.yaw)
            y = to.y + s2 * r2 * cos(to.yaw) - pose.y - s1 * r1 * cos(pose.yaw)
            far = hypot(x, y)
            aside = s2 * r2 - s1 * r1
            if far >= abs(aside):
                length = sqrt((far - aside) * (far + aside))
                way = atan2(y, x) - atan2(aside, length)
                if length < 1e-12 and aside == 0.0:
                    way = pose.yaw
                a = _turned(s1, pose.yaw, way)
                b = _turned(s2, way, to.yaw)
                total = cost.per_metre * length + cost.per_radian * (a + b)
                if total < best:
                    best = total
                    count = 3
                    ds[0], dtheta[0] = r1 * a, s1 * a
                    ds[1], dtheta[1] = length, 0.0
                    ds[2], dtheta[2] = r2 * b, s2 * b
            if r1 == 0.0 or r1 != r2 or s1 != s2 or far > 4.0 * r1:
                continue
            for bent in (-1.0, 1.0):
                towards = atan2(y, x) + bent * acos(far / (4.0 * r1))
                back = atan2(2.0 * r1 * sin(towards) - y, 2.0 * r1 * cos(towards) - x)
                way = towards + s1 * 0.5 * pi
                on = back + s1 * 0.5 * pi
                a = _turned(s1, pose.yaw, way)
                m = _turned(-s1, way, on)
                b = _turned(s1, on, to.yaw)
                total = cost.per_radian * (a + m + b)
                if total < best:
                    best = total
                    count = 3
                    ds[0], dtheta[0] = r1 * a, s1 * a
                    ds[1], dtheta[1] = r1 * m, -s1 * m
                    ds[2], dtheta[2] = r1 * b, s1 * b
    n = 0
    for k in range(count):
        if ds[k] != 0.0 or dtheta[k] != 0.0:
            ds[n], dtheta[n] = ds[k], dtheta[k]
            n += 1
    return n
