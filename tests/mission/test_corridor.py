"""Missions in a corridor, whose answers are sums of straight drives: 180 J a metre."""

from __future__ import annotations

from typing import Any

import numpy as np
from worlds import tiny

from energyplan.mission import Charger, Mission, Spreads, Task, evaluate
from energyplan.path import Pose
from energyplan.power import PowerModel
from energyplan.power.effects import with_weight
from energyplan.terrain import HeightMap, OccupancyGrid

METRE = 180.0
"""Energy of a metre [J]: 90 N on each side."""


CORRIDOR = OccupancyGrid(np.zeros((30, 350), bool), 0.1)
"""One map for all missions along it, so that each route is planned once."""


def corridor(energy: float, tasks: dict[str, float], start: float, **changes: Any) -> Mission:
    """A mission along a corridor of 35 m with tasks at so many metres, at the expectation."""
    values: dict[str, Any] = {
        "model": PowerModel.preset("quadriga:empty:marble"),
        "map": CORRIDOR,
        "battery": tiny(energy), "start": Pose(start, 1.5, 0.0), "planning_effort": 10_000,
        "tasks": tuple(Task(name, Pose(x, 1.5, 0.0)) for name, x in tasks.items()),
        "reserve": 0.0, "confidence": 0.5, "spreads": Spreads.none(),
    }  # fmt: skip
    return Mission(**{**values, **changes})


def charger(x: float, name: str) -> Charger:
    return Charger(name, Pose(x, 1.5, 0.0), power=500.0, until=1.0)


def test_energies_that_cancel_do_not_blow_the_power_up() -> None:
    """Up and down a hill the energy nearly cancels; the uncertainty of the power does not."""
    x = np.linspace(0, 35, 71)
    hill = np.interp(x, [0, 7, 11, 24, 35], [0.0, 0.0, 0.3, -1.1, -1.1])
    model = with_weight(PowerModel.preset("quadriga:empty:marble"))
    asked = corridor(
        1e6, {"below": 25.0}, 5.0, model=model, heights=HeightMap(np.tile(hill, (8, 1)), 0.5),
        confidence=0.95, coefficient_spread=0.05, return_to="any",
    )  # fmt: skip
    report = evaluate(asked)
    line = report.timeline
    there = line.t <= report.task("below").start
    # the charge at the bound never falls faster than a quarter above what is expected at most
    moving = np.diff(line.t[there]) > 0
    step = np.diff(line.t[there])[moving]
    fall = -np.diff(line.soc[there])[moving] / step
    bound = -np.diff(line.soc_lower[there])[moving] / step
    assert bound.max() < 1.35 * fall.max()
    assert report.energy_upper > report.energy
