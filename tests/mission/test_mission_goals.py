"""Tasks at places: the mission chooses the headings that cost least together."""

import importlib
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from energyplan import Goal, OccupancyGrid, PowerModel
from energyplan.battery import Battery
from energyplan.errors import MissionError
from energyplan.io.files import bundled
from energyplan.io.mission import mission_from
from energyplan.mission import Mission, Task, evaluate

sys.path.append(str(Path(__file__).resolve().parents[2] / "benchmarks"))
brute_force = importlib.import_module("places")

MODEL = PowerModel.preset("quadriga:empty:concrete")


def mission(poses, start=(2.0, 2.0, 0.5), walls=False, order="free") -> Mission:
    """Return a mission of tasks at some poses or places in a hall of 20 x 12 m."""
    cells = np.zeros((120, 200), bool)
    if walls:
        cells[:80, 70:73] = True
    return Mission(
        map=OccupancyGrid(cells, resolution=0.1), model=MODEL,
        battery=Battery.preset("quadriga"), start=start, order=order, return_to="start",
        tasks=tuple(Task(f"t{k}", pose) for k, pose in enumerate(poses)),
        planning_effort=1000, confidence=0.5,
    )  # fmt: skip


def test_free_places_cost_what_the_best_of_16_headings_do():
    """Order and headings are within 1 % of brute force, and better than heading 0 in the mean."""
    saved = []
    for seed in (1, 2, 3):
        rng = np.random.default_rng(seed)
        places = [tuple(place) for place in rng.uniform((1.5, 1.5), (18.5, 10.5), (5, 2)).round(1)]
        free = evaluate(mission(places))
        fixed = evaluate(mission([(*place, 0.0) for place in places]))
        assert free.feasible
        assert free.energy <= 1.01 * brute_force.least(places)
        assert all(one.goals for one in free.mission.tasks)
        saved.append(1.0 - free.energy / fixed.energy)
    assert np.mean(saved) > 0.03


def test_headings_suit_the_ways_around_walls():
    """Around a wall the headings are those of the way, not of the straight line."""
    places = [(5.0, 1.5), (9.5, 1.5)]
    free = evaluate(mission(places, walls=True, order="given"))
    others = [
        evaluate(mission([(*places[0], a), (*places[1], b)], walls=True, order="given")).energy
        for a in np.arange(4) * np.pi / 2 for b in np.arange(4) * np.pi / 2
    ]  # fmt: skip
    assert free.energy <= 1.01 * min(others)


def test_one_of_several_docks_is_chosen():
    """A task at one of two poses is done at that which costs less."""
    near, far = (5.0, 2.5, 0.5), (15.0, 9.0, 0.0)
    found = evaluate(mission([[far, near]]))
    assert found.mission.tasks[0].pose == pytest.approx(near)
    assert found.warnings == evaluate(mission([near])).warnings


def test_a_pose_of_several_at_which_the_robot_cannot_stand_is_named():
    """One in a wall, or beyond the map, is no hindrance, but the answer says so."""
    found = evaluate(mission([[(7.1, 4.0), (5.0, 2.5, 0.5), (99.0, 2.0)]], walls=True))
    assert found.feasible
    said = [note for note in found.warnings if "is left out" in note]
    assert [note.split(" at any")[0] for note in said] == [
        "task 't0': (7.1, 4)",
        "task 't0': (99, 2)",
    ]


def test_a_place_whose_headings_are_closed_in_part():
    """A place beside a wall is done at a heading that is free there."""
    beside = (6.6, 4.0)
    asked = mission([beside], walls=True)
    found = evaluate(asked)
    assert found.feasible
    assert asked.free_map.footprint_free(found.mission.tasks[0].pose, asked.vehicle)
    with pytest.raises(MissionError, match="touches an obstacle"):
        mission([(7.1, 4.0)], walls=True)


def test_places_in_python_and_in_files():
    """Files and Python name goals alike, and a single pose stays one."""
    from_python = Task("a", (4.0, 2.0))
    assert from_python.goals == (Goal(4, 2),)
    assert Task("a", (4.0, 2.0, 0.0)).goals == ()
    assert Task("a", Goal(4, 2, 1.0, "either")).goals == (Goal(4, 2, 1.0, "either"),)
    assert Task(name="a", pose=[4, 2, 1.0], heading="any").goals == (Goal(4, 2),)
    assert len(Task("a", [(4.0, 2.0), (5.0, 2.0, 0.0)]).goals) == 2
    assert replace(from_python, dwell=5.0).goals == from_python.goals
    for wrong in ((4.0,), "4", [(4.0, 2.0), "x"], [], [(4.0, 2.0), []]):
        with pytest.raises(MissionError):
            Task("a", wrong)
    with pytest.raises(MissionError, match="heading is to be either"):
        Task(name="a", pose=(4.0, 2.0), heading="either")
    with pytest.raises(MissionError, match="one of given, either, any"):
        Task(name="a", pose=(4.0, 2.0), heading="sideways")


def test_goals_of_a_missions_file():
    """A file has places, headings, lists of poses, and the names of places."""
    values = {
        "map": str(bundled("warehouse.yaml")), "model": "quadriga:empty:concrete",
        "battery": "quadriga", "start": [2, 2, 0], "confidence": 0.5,
        "places": {"gate": [8, 2], "shelf": [10, 2, "90deg"]},
        "tasks": [
            {"name": "a", "pose": [4, 2]},
            {"name": "b", "pose": [5, 2, "90deg"], "heading": "either", "radius": "20 cm"},
            {"name": "c", "pose": "gate"},
            {"name": "d", "pose": ["gate", "shelf"]},
            {"name": "e", "pose": "shelf"},
        ],
    }  # fmt: skip
    tasks = mission_from(values).tasks
    assert [task.goals for task in tasks] == [
        (Goal(4, 2),), (Goal(5, 2, np.pi / 2, "either", 0.2),), (Goal(8, 2),),
        (Goal(8, 2), Goal(10, 2, np.pi / 2)), (),
    ]  # fmt: skip
    assert tasks[4].pose == pytest.approx((10, 2, np.pi / 2))
