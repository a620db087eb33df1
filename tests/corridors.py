"""Missions in a corridor, whose answers are sums of straight drives: 180 J a metre."""

from __future__ import annotations

from typing import Any

import numpy as np
from worlds import tiny

from energyplan.mission import Charger, Mission, Spreads, Task
from energyplan.path import Pose
from energyplan.power import PowerModel
from energyplan.terrain import OccupancyGrid

METRE = 180.0
"""Energy of a metre [J]: 90 N on each side."""

CORRIDOR = OccupancyGrid(np.zeros((30, 350), bool), 0.1)
"""One map for all missions along it, so that each route is planned once."""


def at(name: str, x: float, **changes: Any) -> Task:
    """Return a task at so many metres."""
    return Task(name, Pose(x, 1.5, 0.0), **changes)


def corridor(
    energy: float, tasks: dict[str, float] | tuple[Task, ...], start: float, **changes: Any
) -> Mission:
    """Return a mission along 35 m with tasks, by their metres at least, at the expectation."""
    values: dict[str, Any] = {
        "model": PowerModel.preset("quadriga:empty:marble"),
        "map": CORRIDOR,
        "battery": tiny(energy), "start": Pose(start, 1.5, 0.0), "planning_effort": 10_000,
        "tasks": tuple(at(*one) for one in tasks.items()) if isinstance(tasks, dict) else tasks,
        "reserve": 0.0, "confidence": 0.5, "spreads": Spreads.none(),
    }  # fmt: skip
    return Mission(**{**values, **changes})


def charger(x: float, name: str) -> Charger:
    """Return a charger of 500 W that fills batteries."""
    return Charger(name, Pose(x, 1.5, 0.0), power=500.0, until=1.0)
