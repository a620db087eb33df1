"""Maps with two ways to the goal: what a hidden effect makes dear changes which one is best.

Both ways are corridors about a line each, with a room at the start for a designed drive. The
second way is longer, or turns more, by a share of what the effect takes on the first one.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import shapely
from numpy.typing import ArrayLike

import energyplan as ep
from energyplan.physics import EngineGround, HiddenEffect
from energyplan.terrain import HeightMap

WIDTH, ROOM, RESOLUTION = 1.8, 1.7, 0.1
"""Width of corridors, radius of the room at the start, and size of the map's cells [m]."""


class Fork(NamedTuple):
    """A problem whose best route depends on effects, and the ground that is known."""

    name: str
    grid: ep.OccupancyGrid
    start: ep.Pose
    goal: ep.Pose
    effects: tuple[HiddenEffect, ...]
    ground: EngineGround | None = None

    def problem(self, model: ep.PowerModel) -> ep.PlanningProblem:
        """Return the problem as a model sees it."""
        heights = None if self.ground is None else self.ground.heights
        return ep.PlanningProblem(
            self.grid, ep.EnergyCost(model, battery=True), self.start, self.goal, heights=heights
        )


def corridors(*ways: ArrayLike) -> ep.OccupancyGrid:
    """Return a map on which corridors about lines, and a room at their common start, are free."""
    lines = [shapely.LineString(np.asarray(way, float)) for way in ways]
    free = shapely.union_all(
        [line.buffer(WIDTH / 2, join_style="mitre") for line in lines]
        + [shapely.Point(lines[0].coords[0]).buffer(ROOM)]
    )
    x0, y0, x1, y1 = free.bounds
    box = (x0 - 0.5, y0 - 0.5, x1 + 0.5, y1 + 0.5)
    return ep.OccupancyGrid.from_polygons([shapely.box(*box) - free], box, RESOLUTION)


def rough(share: float) -> Fork:
    """Lay rough ground beyond a line, through which the shorter way goes."""
    short = [(0, 0), (0, 2.2), (9, 2.2), (9, 0)]
    long = [(0, 0), (0, -2.2 - share), (9, -2.2 - share), (9, 0)]
    effect = HiddenEffect("surface_border", 0.3, {"direction": np.pi / 2, "offset": 1.1})
    start, goal = ep.Pose(0, 0, 0.0), ep.Pose(9, 0, 0.0)
    return Fork("rough ground", corridors(short, long), start, goal, (effect,))


def viscous(share: float) -> Fork:
    """Lay a viscous floor: the way with fewer metres and more turns is better then."""
    deep, far = 2.6, 9.0
    zigzag = [(0, 0), (2.0, 0), (2.0, deep), (5.0, deep), (5.0, 0), (far, 0)]
    length = 15.7 - share
    angle = float(np.arccos(far / length))
    wide = [(0, 0), (far / 2, -length / 2 * np.sin(angle)), (far, 0)]
    effect = HiddenEffect("viscous_loss", 250.0)
    start, goal = ep.Pose(0, 0, -angle), ep.Pose(far, 0, angle)
    return Fork("viscous floor", corridors(zigzag, wide), start, goal, (effect,))


def dragging(share: float) -> Fork:
    """Let a wheel drag: the way, or the gear, that turns the other way round is better then."""
    top, bottom = 2.5, -2.5
    over = [(0, 0), (0, top), (8, top), (8, 0)]
    under = [(0, 0), (0, bottom), (8, bottom), (8, 0)]
    effect = HiddenEffect("dragging_wheel_left", 150.0)
    # Turned a little, so that without the drag one way round is the cheaper one.
    start, goal = ep.Pose(0, 0, 0.1 * share), ep.Pose(8, 0, np.pi - 0.1 * share)
    return Fork("dragging left wheel", corridors(over, under), start, goal, (effect,))


def ridge(share: float) -> Fork:
    """Raise a known ridge across the shorter way, with motors that return nothing downhill."""
    short = [(0, 0), (0, 2.2), (10, 2.2), (10, 0)]
    down = -2.2 - 0.8 * share
    long = [(0, 0), (0, down), (10, down), (10, 0)]
    size, rows, columns = 0.25, 60, 80
    y = -8.0 + size * np.arange(rows)
    x = -5.0 + size * np.arange(columns)
    up = np.clip(1.0 - np.abs(x - 5.0) / 3.5, 0.0, None)
    across = np.clip((y - 0.2) / 1.0, 0.0, 1.0)
    heights = HeightMap(1.0 * across[:, None] * up, size, ep.Pose(-5.0, -8.0, 0.0))
    start, goal = ep.Pose(0, 0, 0.0), ep.Pose(10, 0, 0.0)
    effect = HiddenEffect("regeneration_efficiency", 1.0)
    return Fork(
        "ridge, nothing returned", corridors(short, long), start, goal, (effect,),
        EngineGround(heights=heights),
    )  # fmt: skip


FORKS: tuple[Callable[[float], Fork], ...] = (rough, viscous, dragging, ridge)
"""Families of such maps; each takes how much the second way is worse without the effect [m]."""
