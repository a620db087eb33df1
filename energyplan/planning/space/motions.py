"""Kernels that price motions and join poses, on the ground and among the obstacles of one problem.

Everything here is in the frame of the centre that `CompiledProblem` follows, mostly the point
midway between the tread ICRs: `KernelProblem.body` is the footprint seen from there.

A price is a positively homogeneous function of (ds, dtheta). It is held as its values on
`DIRECTIONS` rays of the plane ``(ds, C dtheta)`` and is linear between them. The kinks of the
static model, at straight motion, spin and pivot, lie on rays, so its price is exact.

On slopes there is such a row for each of `Hills.bins` slopes, less the potential energy,
so that no price is negative; between two slopes the price is linear. Where prices depend on the
heading, there are these rows for each of `Hills.headings` headings, and it is linear between two.
"""

from __future__ import annotations

from math import atan2, ceil, cos, hypot, inf, pi, sin
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray

from energyplan.compilation import READONLY, ByteTable, Floats, FloatTable, inner, lean, njit
from energyplan.cost.steering import StaticSteering
from energyplan.path import STILL, Pose
from energyplan.steering.forwards import arcs_forwards, forward_energy, forward_path
from energyplan.steering.kernels import (
    MAX_SEGMENTS,
    arc_end,
    chord_factor,
    steer_energy,
    steer_path,
)
from energyplan.terrain.collision import Body, Space, in_cells, motion_free

DIRECTIONS = 128  # rays of the price table; a multiple of 8
TURN = 0.1  # turn by which heading and slope along it are looked up anew [rad]


class Hills(NamedTuple):
    """Heights of the ground, as the kernels see them."""

    heights: Annotated[NDArray[np.float64], 2, READONLY]  # heights at the nodes [m]
    x: float  # x of node (0, 0) [m]
    y: float  # y of node (0, 0) [m]
    cos: float  # cosine of the raster's yaw
    sin: float  # sine of the raster's yaw
    resolution: float  # distance between nodes [m]
    steepest: float  # steepest slope, as rise over run
    bins: int  # slopes in the price table, from ``-steepest`` to ``steepest``
    headings: int  # headings in the price table, from 0 round to 2 pi; 1 where none matters
    piece: float  # length of the parts that motions are priced in [m]


_FLAT = np.zeros((1, 1))
_FLAT.setflags(write=False)  # as those of a `HeightMap`: the kernels are compiled for one kind
LEVEL = Hills(_FLAT, 0.0, 0.0, 1.0, 0.0, 1.0, 1.0, 1, 1, 1.0)  # level ground


class KernelProblem(NamedTuple):
    """What a search needs to know about its problem."""

    space: Space  # obstacles
    body: Body  # footprint, seen from the centre of the tread ICRs [m]
    prices: FloatTable  # (classes * headings * slopes, DIRECTIONS + 1)
    surface: ByteTable  # (rows, columns): class of the surface in each cell
    hills: Hills  # heights of the ground
    steering: StaticSteering  # the static cost that steering solves
    half_track: float  # half the slip track [m]
    least_radius: float  # of arcs; zero where any turn is allowed [m]
    radii: Floats  # (classes,): the same on each class of surface [m]
    widest: float  # the largest of these [m]
    wide: StaticSteering  # the static cost that steering on arcs of that radius solves
    gear: int  # 0 drives both ways, 1 forwards only; -1 that searched from the end
    lateral: float  # y of the centre of the tread ICRs in the body frame [m]
    reach: float  # distance of the body's furthest corner [m]
    least_metre: float  # least cost of a metre, plus `least_radian` for each radian
    least_radian: float  # least cost of a radian
    stop: float  # price of each motion of those that `join` chooses, beyond what it costs
    start: Pose  # pose of the centre of the tread ICRs at the start
    goal: Pose  # pose of the centre of the tread ICRs at the goal


@lean
def price(prices: FloatTable, kind: int, half_track: float, ds: float, dtheta: float) -> float:
    """Price of a motion on one class of surface."""
    across = half_track * dtheta
    size = hypot(ds, across)
    if size == 0.0:
        return 0.0
    spread = 2.0 * pi / DIRECTIONS
    place = (atan2(across, ds) % (2.0 * pi)) / spread
    k = min(int(place), DIRECTIONS - 1)
    into = (place - k) * spread
    return float(
        size
        * (prices[kind, k] * sin(spread - into) + prices[kind, k + 1] * sin(into))
        / sin(spread)
    )


@inner
def turn_prices(setting: KernelProblem) -> Floats:
    """Price of a radian of turning on each class of surface, on the level.

    Half of it are spins, half pivots, whose progress ahead is not lost; where arcs have a
    least radius both are driven on these, to and fro or ahead.
    """
    bins = setting.hills.bins
    headings = setting.hills.headings
    half = setting.half_track
    found = np.empty(len(setting.prices) // (bins * headings))
    for k in range(len(found)):
        spin = pivot = 0.0
        least = setting.radii[k]
        aside = max(half, least)
        for heading in range(headings):
            row = bins * (headings * k + heading) + bins // 2
            for side in (-1.0, 1.0):
                spin += 0.5 * price(setting.prices, row, half, least, side)
                pivot += 0.5 * price(setting.prices, row, half, aside, side)
            pivot -= price(setting.prices, row, half, aside, 0.0)
        found[k] = max(0.5 * (spin + pivot) / headings, setting.least_radian)
    return found


@lean
def surface_at(setting: KernelProblem, pose: Pose) -> int:
    """Class of the surface that the robot is on, that of the nearest cell outside the map."""
    rows, columns = setting.surface.shape
    x = pose.x + setting.lateral * sin(pose.yaw)
    y = pose.y - setting.lateral * cos(pose.yaw)
    here = in_cells(setting.space, x, y)
    row = int(here.row)
    column = int(here.column)
    return int(setting.surface[min(max(row, 0), rows - 1), min(max(column, 0), columns - 1)])


@lean
def least_radius_at(setting: KernelProblem, pose: Pose) -> float:
    """Least radius of arcs on the ground at a pose; zero where any turn is allowed."""
    if setting.widest == setting.least_radius:
        return setting.least_radius
    return float(setting.radii[surface_at(setting, pose)])


@lean
def allowed(setting: KernelProblem, pose: Pose, ds: float, dtheta: float) -> bool:
    """Return whether robot and ground allow a motion: its direction, and how tightly it turns."""
    if ds * setting.gear < -STILL:
        return False
    turn = abs(dtheta) * (1.0 - 1e-7)
    if abs(ds) >= setting.widest * turn:
        return True
    if setting.widest == setting.least_radius:
        return False
    furthest = max(abs(ds), abs(ds + setting.lateral * dtheta))
    pieces = max(ceil(max(2.0 * furthest / setting.space.resolution, abs(dtheta) / TURN)), 1)
    part_turn = dtheta / pieces
    part_ds = ds / pieces
    here = pose
    for _ in range(pieces):
        # at the ends of the parts too: the border of a surface may be touched between
        if abs(ds) < least_radius_at(setting, here) * turn:
            return False
        middle = arc_end(here, 0.5 * part_ds, 0.5 * part_turn)
        if abs(ds) < least_radius_at(setting, middle) * turn:
            return False
        here = arc_end(here, part_ds, part_turn)
    return bool(abs(ds) >= least_radius_at(setting, here) * turn)


@lean
def permitted(setting: KernelProblem, pose: Pose, ds: float, dtheta: float) -> bool:
    """Return whether a motion may be driven: robot and ground allow it, and the body is free."""
    return allowed(setting, pose, ds, dtheta) and bool(
        motion_free(setting.space, setting.body, pose.x, pose.y, pose.yaw, ds, dtheta, 0.0)
    )


@lean
def height_at(hills: Hills, x: float, y: float) -> float:
    """Height of a point, bilinear between the nodes; that of the raster's edge beyond it."""
    dx = x - hills.x
    dy = y - hills.y
    rows, columns = hills.heights.shape
    along = (hills.cos * dx + hills.sin * dy) / hills.resolution
    across = (-hills.sin * dx + hills.cos * dy) / hills.resolution
    along = min(max(along, 0.0), columns - 1.0)
    across = min(max(across, 0.0), rows - 1.0)
    j = min(int(along), columns - 2)
    i = min(int(across), rows - 2)
    u = along - j
    v = across - i
    low = hills.heights[i, j] * (1.0 - u) + hills.heights[i, j + 1] * u
    high = hills.heights[i + 1, j] * (1.0 - u) + hills.heights[i + 1, j + 1] * u
    return float(low * (1.0 - v) + high * v)


@lean
def cost_in_parts(setting: KernelProblem, pose: Pose, ds: float, dtheta: float) -> float:
    """Price of a motion in parts, by heading and slope, less the potential energy of the height."""
    hills = setting.hills
    across = setting.half_track * dtheta
    size = hypot(ds, across)
    if size == 0.0:
        return 0.0
    pieces = max(ceil(max(abs(ds) / hills.piece, abs(dtheta) / TURN)), 1)
    # place among the rays, the same for every part
    spread = 2.0 * pi / DIRECTIONS
    place = (atan2(across, ds) % (2.0 * pi)) / spread
    ray = min(int(place), DIRECTIONS - 1)
    into = (place - ray) * spread
    before = size / pieces * sin(spread - into) / sin(spread)
    after = size / pieces * sin(into) / sin(spread)

    several = len(setting.prices) > hills.bins * hills.headings
    sloping = hills.bins > 1
    travel = (ds + setting.lateral * dtheta) / pieces
    turn = dtheta / pieces
    chord = ds / pieces * chord_factor(turn)
    x, y, yaw = pose
    px = x + setting.lateral * sin(yaw)
    py = y - setting.lateral * cos(yaw)
    height = height_at(hills, px, py) if sloping else 0.0
    total = 0.0
    steep = 0.0
    for k in range(pieces):
        mid = yaw + (k + 0.5) * turn
        row = 0
        if several:
            mx = x + 0.5 * chord * cos(mid)
            my = y + 0.5 * chord * sin(mid)
            row = surface_at(setting, Pose(mx, my, mid)) * hills.headings
        x += chord * cos(mid)
        y += chord * sin(mid)
        if not sloping:
            pass
        elif abs(travel) > STILL:
            px = x + setting.lateral * sin(mid + 0.5 * turn)
            py = y - setting.lateral * cos(mid + 0.5 * turn)
            next_height = height_at(hills, px, py)
            steep = (next_height - height) / travel
            height = next_height
        else:
            nearby = 1e-4 * hills.resolution
            dx = nearby * cos(mid)
            dy = nearby * sin(mid)
            rise = height_at(hills, px + dx, py + dy) - height_at(hills, px - dx, py - dy)
            steep = 0.5 * rise / nearby
        at = (min(max(steep / hills.steepest, -1.0), 1.0) + 1.0) * 0.5 * (hills.bins - 1)
        low = max(min(int(at), hills.bins - 2), 0)
        part = at - low
        round_ = (mid % (2.0 * pi)) / (2.0 * pi) * hills.headings
        heading = min(int(round_), hills.headings - 1)
        share = 1.0 if hills.headings == 1 else 1.0 - (round_ - heading)
        prices = setting.prices
        for beside in range(min(hills.headings, 2)):
            at_row = (row + (heading + beside) % hills.headings) * hills.bins + low
            total += share * (1.0 - part) * (
                before * prices[at_row, ray] + after * prices[at_row, ray + 1]
            )  # fmt: skip
            if sloping:
                total += share * part * (
                    before * prices[at_row + 1, ray] + after * prices[at_row + 1, ray + 1]
                )  # fmt: skip
            share = 1.0 - share
    return total


@njit
def motion_cost(setting: KernelProblem, pose: Pose, ds: float, dtheta: float) -> float:
    """Price of a motion of constant curvature that starts at a pose."""
    if setting.surface.size == 1:
        return price(setting.prices, 0, setting.half_track, ds, dtheta)
    if setting.hills.bins * setting.hills.headings > 1:
        return cost_in_parts(setting, pose, ds, dtheta)
    furthest = max(abs(ds), abs(ds + setting.lateral * dtheta))
    pieces = max(ceil(2.0 * furthest / setting.space.resolution), 1)
    part_ds = ds / pieces
    part_turn = dtheta / pieces
    chord = part_ds * chord_factor(part_turn)
    x, y, yaw = pose
    total = 0.0
    last = -1
    unit = 0.0
    for k in range(pieces):
        mid = yaw + (k + 0.5) * part_turn
        mx = x + 0.5 * chord * cos(mid)
        my = y + 0.5 * chord * sin(mid)
        kind = surface_at(setting, Pose(mx, my, mid))
        if kind != last:
            unit = price(setting.prices, kind, setting.half_track, part_ds, part_turn)
            last = kind
        total += unit
        x += chord * cos(mid)
        y += chord * sin(mid)
    return total


@njit
def free_energy(setting: KernelProblem, pose: Pose) -> float:
    """Least cost from a pose to the goal if there were no obstacles."""
    goal = setting.goal
    dx = goal.x - pose.x
    dy = goal.y - pose.y
    if setting.gear != 0:
        return forward_energy(dx, dy, pose.yaw, goal.yaw, setting.steering)
    return steer_energy(dx, dy, pose.yaw, goal.yaw, setting.steering)


@lean
def motions_cost(
    setting: KernelProblem, pose: Pose, ds: Floats, dtheta: Floats, count: int, limit: float
) -> float:
    """Cost of a sequence of motions from a pose, whatever lies in its way; infinite at `limit`."""
    total = 0.0
    here = pose
    for k in range(count):
        total += motion_cost(setting, here, ds[k], dtheta[k])
        if total >= limit:
            return inf
        here = arc_end(here, ds[k], dtheta[k])
    return total


@lean
def drive(
    setting: KernelProblem, pose: Pose, ds: Floats, dtheta: Floats, count: int, limit: float
) -> float:
    """Cost of motions from a pose; infinite if one is not permitted or it reaches `limit`."""
    # what is permitted after the costs, which are cheaper to find out
    total = motions_cost(setting, pose, ds, dtheta, count, limit)
    if total == inf:
        return inf
    here = pose
    for k in range(count):
        if not permitted(setting, here, ds[k], dtheta[k]):
            return inf
        here = arc_end(here, ds[k], dtheta[k])
    return total


@lean
def spin_drive_spin(pose: Pose, to: Pose, backwards: bool, ds: Floats, dtheta: Floats) -> int:
    """Write the motion that turns on the spot, drives straight, and turns on the spot."""
    dx = to.x - pose.x
    dy = to.y - pose.y
    way = atan2(dy, dx) + (pi if backwards else 0.0)
    length = hypot(dx, dy)
    if length < 1e-9:
        way = pose.yaw
    ds[0] = 0.0
    dtheta[0] = pi - (pi - (way - pose.yaw)) % (2 * pi)
    ds[1] = -length if backwards else length
    dtheta[1] = 0.0
    ds[2] = 0.0
    dtheta[2] = pi - (pi - (to.yaw - way)) % (2 * pi)
    return 3


@lean
def backs_up(ds: Floats, count: int) -> bool:
    """Return whether any of some motions drives backwards."""
    least = 0.0
    for k in range(count):
        least = min(least, ds[k])
    return least < 0.0


@lean
def pose_at(poses: FloatTable, k: int) -> Pose:
    """Return a row of poses as a pose."""
    return Pose(poses[k, 0], poses[k, 1], poses[k, 2])


@lean
def put_pose(poses: FloatTable, k: int, pose: Pose) -> None:
    """Write a pose into a row; Numba takes a second to compile a general assignment to a row."""
    poses[k, 0] = pose.x
    poses[k, 1] = pose.y
    poses[k, 2] = pose.yaw


@lean
def price_of_stops(setting: KernelProblem, ds: Floats, dtheta: Floats, count: int) -> float:
    """Price of the stops between motions and at their end."""
    total = 0.0
    if setting.stop > 0.0:
        for k in range(count):
            if abs(ds[k]) + abs(dtheta[k]) > STILL:
                total += setting.stop
    return total


@lean
def _exact(setting: KernelProblem, pose: Pose, to: Pose, ds: Floats, dtheta: Floats) -> int:
    """Write the exact motion from one pose to another, forwards if the robot does not reverse."""
    dx = to.x - pose.x
    dy = to.y - pose.y
    count = steer_path(dx, dy, pose.yaw, to.yaw, setting.steering, ds, dtheta)
    if setting.gear == 0 or not backs_up(ds, count):
        return count
    if setting.least_radius > 0.0:
        return arcs_forwards(pose, to, setting.steering, ds, dtheta)
    return forward_path(dx, dy, pose.yaw, to.yaw, setting.steering, ds, dtheta)


@lean
def _other_way(
    setting: KernelProblem, pose: Pose, to: Pose, way: int, ds: Floats, dtheta: Floats
) -> int:
    """Write another motion to a pose: on the widest arcs, or turn-drive-turn; or return none."""
    if way > 0:
        spins = setting.least_radius == 0.0 and (way == 1 or setting.gear == 0)
        return spin_drive_spin(pose, to, way == 2, ds, dtheta) if spins else 0
    if setting.gear != 0 or setting.widest == setting.least_radius:
        return 0
    return steer_path(to.x - pose.x, to.y - pose.y, pose.yaw, to.yaw, setting.wide, ds, dtheta)


@njit
def join(
    setting: KernelProblem, pose: Pose, to: Pose, limit: float, ds: Floats, dtheta: Floats
) -> tuple[float, int]:
    """Join two poses by the cheapest free motion known, if it costs less than `limit`.

    Tried are the exact minimum-energy motion, the same on the widest arcs that some ground asks
    for, and turn-drive-turn both ways, which needs less room at times.
    """
    least = -inf
    if setting.surface.size == 1:
        dx = to.x - pose.x
        dy = to.y - pose.y
        least = steer_energy(dx, dy, pose.yaw, to.yaw, setting.steering)
        if least >= limit:
            return inf, 0
    count = _exact(setting, pose, to, ds, dtheta)
    stops = price_of_stops(setting, ds, dtheta, count)
    cost = drive(setting, pose, ds, dtheta, count, limit - stops) + stops
    # what is found depends on the limit only in whether it costs less
    if cost <= least * (1.0 + 1e-9):
        return cost, count
    other_ds = np.empty(MAX_SEGMENTS)
    other_dtheta = np.empty(MAX_SEGMENTS)
    for way in range(3):
        n = _other_way(setting, pose, to, way, other_ds, other_dtheta)
        if n == 0:
            continue
        stops = price_of_stops(setting, other_ds, other_dtheta, n)
        other = drive(setting, pose, other_ds, other_dtheta, n, min(limit, cost) - stops) + stops
        if other < cost:
            cost = other
            count = n
            for k in range(n):
                ds[k] = other_ds[k]
                dtheta[k] = other_dtheta[k]
    return cost, count


@njit
def steering_cost(setting: KernelProblem, pose: Pose, to: Pose) -> float:
    """Cost of the exact steering motion between two poses, whatever lies in its way."""
    dx = to.x - pose.x
    dy = to.y - pose.y
    if setting.surface.size == 1:
        return float(steer_energy(dx, dy, pose.yaw, to.yaw, setting.steering))
    ds = np.empty(MAX_SEGMENTS)
    dtheta = np.empty(MAX_SEGMENTS)
    count = steer_path(dx, dy, pose.yaw, to.yaw, setting.steering, ds, dtheta)
    return motions_cost(setting, pose, ds, dtheta, count, inf)
