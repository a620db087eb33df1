"""Plans of a robot that may not drive backwards."""

from dataclasses import replace
from pathlib import Path as File

import numpy as np
import pytest
from worlds import MAPS, free_poses, room

import energyplan as ep
from energyplan.errors import InvalidPathError, UnsupportedPlannerError
from energyplan.io.tables import read_trajectory
from energyplan.planning import Candidate, Planner

MODEL = ep.read_model("quadriga:full:concrete")
FORWARDS = replace(MODEL.vehicle, reverse=False)
COST = ep.EnergyCost(MODEL)
ROOMY = replace(FORWARDS, footprint=FORWARDS.footprint * 1.5)
HALL = room(200, 300, 0.05)


def problem(place, start, goal, vehicle=FORWARDS, **more) -> ep.PlanningProblem:
    return ep.PlanningProblem(place, COST, start, goal, vehicle=vehicle, **more)


@pytest.mark.parametrize(
    ("name", "more"),
    [
        *((name, {}) for name in ("warehouse", "office", "orchard", "yard")),
        ("warehouse", {"objective": "length"}),
        ("office", {"objective": "length"}),
        ("warehouse", {"turning": "forward"}),
        ("yard", {"turning": "forward"}),
    ],
)
def test_no_plan_drives_backwards_on_any_bundled_map(name: str, more: dict) -> None:
    grid = ep.read_map(MAPS / f"{name}.yaml")
    ends = free_poses(grid, 4, len(name), ROOMY)
    for start, goal in zip(ends[::2], ends[1::2], strict=True):
        plan = ep.plan(problem(grid, start, goal, **more), effort=4000)
        assert plan.path.reverse_length == 0.0
        assert (plan.path.ds >= -1e-9).all()
        with_it = ep.plan(problem(grid, start, goal, MODEL.vehicle, **more), effort=4000)
        assert plan.cost >= with_it.lower_bound * (1 - 1e-9)


def test_a_goal_behind_is_reached_by_turning_and_a_plan_says_how_far_it_reverses() -> None:
    ends = (8.0, 5.0, 0.0), (6.0, 5.0, 0.0)
    back = ep.plan(problem(HALL, *ends, MODEL.vehicle), effort=2000)
    assert back.path.reverse_length == pytest.approx(2.0)
    round_about = ep.plan(problem(HALL, *ends), effort=2000)
    assert round_about.path.reverse_length == 0.0
    # on open ground the exact motion is known, and is the plan
    exact = float(ep.steering.energy(*ends, COST, reverse=False))
    assert round_about.energy == pytest.approx(exact, rel=1e-3)
    assert round_about.gap < 1e-3


def test_a_path_that_reverses_is_refused_whoever_made_it() -> None:
    asked = problem(HALL, (8.0, 5.0, 0.0), (6.0, 5.0, 0.0))

    def reversing(asked: ep.PlanningProblem, budget: object) -> Candidate:
        return Candidate(ep.Path(asked.start, np.array([-2.0]), np.array([0.0]), 0.0))

    with pytest.raises(InvalidPathError, match="segment 0 drives backwards"):
        ep.plan(asked, planner=Planner(reversing, forwards=True), time_limit=1.0)
    with pytest.raises(UnsupportedPlannerError, match="does not reverse"):
        ep.plan(asked, planner=Planner(reversing), time_limit=1.0)


def test_a_way_there_and_back_costs_no_less_and_a_comparison_keeps_to_it() -> None:
    grid = ep.read_map(MAPS / "warehouse.yaml")
    start, goal = (2.0, 2.0, 0.0), (20.0, 12.0, np.pi / 2)
    found = ep.compare(problem(grid, start, goal), effort=4000)
    assert found.energy_optimal.path.reverse_length == found.shortest.path.reverse_length == 0.0
    maps = [
        ep.energy_map(problem(grid, start, start, vehicle), energy=1500.0, back=start)
        for vehicle in (MODEL.vehicle, FORWARDS)
    ]
    reached = np.isfinite(maps[1].energy)
    assert (maps[1].energy[reached] >= maps[0].energy[reached] - 1e-6).all()
    assert 0 < reached.sum() < np.isfinite(maps[0].energy).sum()


def test_the_vehicles_file_and_the_option_say_it(tmp_path: File, run) -> None:
    file = tmp_path / "robot.yaml"
    file.write_text("preset: quadriga:full\nreverse: no\n")
    assert not ep.read_vehicle(file).reverse
    command = [
        "plan", "--map", MAPS / "warehouse.yaml", "--model", "quadriga:full:concrete",
        "--start", "8,2,0", "--goal", "6,2,0", "--effort", 2000, "--json",
    ]  # fmt: skip
    lengths = [
        run(*command, *more).json["reverse_length"]
        for more in ([], ["--reverse", "yes"], ["--reverse", "no"])
    ]
    assert lengths[0] == lengths[1] > 1.9
    assert lengths[2] == 0.0


def test_no_leg_of_a_mission_drives_backwards(tmp_path: File, run) -> None:
    file = MAPS.parent / "examples" / "mission_warehouse.yaml"
    slowest = []
    for more in ("yes", "no"):
        legs = tmp_path / more
        done = run("mission", file, "--reverse", more, "--effort", 500, "--trajectories", legs)
        assert done.code == 0, done.err
        slowest.append(min(read_trajectory(leg).v.min() for leg in legs.glob("*.csv")))
    assert slowest[0] < -0.1
    assert slowest[1] >= -1e-9
