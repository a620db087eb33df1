"""Many missions over an executor: each comes back once, or its error in its place."""

from __future__ import annotations

import pickle
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import energyplan as ep
from energyplan.mission import Mission, Routes, evaluate, evaluate_many


def rooms(**changes: Any) -> Mission:
    """A mission round two walls, whose routes are no straight lines."""
    cells = np.zeros((60, 100), bool)
    cells[:40, 35:38] = cells[20:, 65:68] = True
    places = {"a": (2.0, 4.0), "b": (5.0, 1.0), "c": (8.5, 5.0), "d": (8.5, 1.5)}
    mission = Mission(
        ep.PowerModel.preset("quadriga:empty:marble"), ep.OccupancyGrid(cells, 0.1),
        ep.Battery.preset("quadriga"), ep.Pose(1.0, 1.0, 0.0),
        tuple(ep.Task(name, ep.Pose(x, y, 0.0)) for name, (x, y) in places.items()),
        confidence=0.5, planning_effort=200,
    )  # fmt: skip
    return replace(mission, **changes)


def unwell() -> Mission:
    """A mission whose evaluation fails: nothing is known of its models' uncertainty."""
    return rooms(confidence=0.95)


@pytest.mark.parametrize("pools", [ThreadPoolExecutor, ProcessPoolExecutor])
def test_every_mission_comes_back_once_and_a_failed_one_with_its_error(pools: Any) -> None:
    missions = [rooms(soc=0.9), unwell(), rooms(soc=0.5)]
    with pools(2) as pool:
        found = {one.index: one for one in evaluate_many(missions, pool)}
        assert pool.submit(sum, (1, 2)).result() == 3  # it stays open
    assert sorted(found) == [0, 1, 2]
    assert found[1].report is None
    assert isinstance(found[1].error, ep.errors.MissionError)
    for k in (0, 2):
        report = found[k].report
        assert report is not None
        assert report.energy == evaluate(missions[k]).energy


def test_routes_are_planned_first_and_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """For all that does not change them, also where they come from another process."""
    battery = replace(rooms().battery, health=0.9)
    routes, variants = Routes(), [rooms(soc=0.9), rooms(battery=battery), rooms(reserve=0.25)]
    planned: list[tuple[Any, Any]] = []
    monkeypatch.setattr(
        "energyplan.mission.routes.plan",
        lambda p, *a, **b: (planned.append((p.start, p.goal)), ep.plan(p, *a, **b))[1],
    )
    with ThreadPoolExecutor(2) as pool:
        assert all(one.error is None for one in evaluate_many(variants, pool, routes))
    assert len({frozenset(pair) for pair in planned}) == len(planned) > 0
    again = len(planned)
    for same in (rooms(soc=0.8), rooms(time=5.0, name="b")):
        evaluate(same, routes=routes)
        evaluate(same, routes=pickle.loads(pickle.dumps(routes)))
    assert len(planned) == again
    for other in (rooms(soc=0.8), rooms(model=ep.PowerModel.preset("quadriga:empty:concrete"))):
        evaluate(other)
        assert len(planned) > again
        again = len(planned)
