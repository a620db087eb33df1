"""Tasks along a path: their energy by hand, and the order of rows against every order."""

from __future__ import annotations

from dataclasses import replace
from itertools import permutations, product
from typing import Any

import numpy as np
import pytest

from energyplan.battery import Battery
from energyplan.cost import EnergyCost
from energyplan.errors import MissionError
from energyplan.limits.drive import Ground, Traversal
from energyplan.mission import Charger, Mission, Spreads, Task, evaluate
from energyplan.mission.routes import Legs, Routes
from energyplan.path import Path, Pose
from energyplan.planning import PlanningProblem, plan
from energyplan.planning.driven import drive_path
from energyplan.power import PowerModel
from energyplan.terrain import OccupancyGrid, SurfaceMap

ROUTES = Routes()  # of all missions here: they share a field and a model
MODEL = replace(PowerModel.preset("quadriga:empty:marble"), covariance=None, residual=None)
FIELD = OccupancyGrid(np.zeros((90, 120), bool), 0.2)
HOME = Pose(2.0, 2.0, 0.0)
EFFORT = 400


def mission(tasks: list[Task], **changes: Any) -> Mission:
    values: dict[str, Any] = {
        "model": MODEL, "map": FIELD, "battery": Battery.preset("quadriga"), "start": HOME,
        "tasks": tuple(tasks), "planning_effort": EFFORT, "spreads": Spreads.none(),
        "confidence": 0.5, "return_to": "start",
    }  # fmt: skip
    return Mission(**{**values, **changes})


def row(name: str, y: float, begin: float = 4.0, end: float = 16.0, **keys: Any) -> Task:
    return Task(name, path=[(begin, y), (end, y)], **keys)


def joules(path: Path, model: PowerModel = MODEL, speed: float | None = None) -> tuple[float, ...]:
    """Energy and duration of a path at the battery, driven within the limits."""
    cost = EnergyCost(model, battery=True, speed=speed or model.vehicle.usual_speed)
    drive = drive_path(path, cost, grid=FIELD, period=0.1).trajectory
    return Traversal(drive, Ground(model.battery_side())).energy(), drive.duration


def planned(start: Pose, goal: Pose) -> Path:
    cost = EnergyCost(MODEL, battery=True, speed=MODEL.vehicle.usual_speed)
    return plan(PlanningProblem(FIELD, cost, start, goal), effort=EFFORT).path


# -- energies --------------------------------------------------------------------------------------


def test_a_mission_of_two_rows_takes_what_its_legs_and_its_rows_take_by_hand() -> None:
    there, back = row("there", 4.0, power=60.0), row("back", 7.0, 16.0, 4.0, power=30.0)
    report = evaluate(mission([there, back]), routes=ROUTES)
    ends = [HOME, Pose(4, 4, 0), Pose(16, 4, 0), Pose(16, 7, np.pi), Pose(4, 7, np.pi), HOME]
    routes = [planned(ends[k], ends[k + 1]) for k in (0, 2, 4)]
    by_hand = sum(joules(path)[0] for path in routes)
    for k, power in ((1, 60.0), (3, 30.0)):
        energy, duration = joules(Path(ends[k], [12.0], [0.0]))
        by_hand += energy + power * duration
    assert report.energy == pytest.approx(by_hand, rel=1e-12)
    assert [leg.goal for leg in report.legs] == ["there", "there", "back", "back", "start"]


def test_a_row_is_driven_at_its_own_speed() -> None:
    energy, duration = joules(Path(Pose(4, 4, 0), [12.0], [0.0]), speed=0.3)
    report = evaluate(mission([row("slow", 4.0, speed=0.3, power=5.0)]), routes=ROUTES)
    work = next(part for part in report.trip if part.kind == "work")
    assert work.energy == pytest.approx(energy + 5.0 * duration, rel=1e-12)
    assert work.arrival - work.departure == pytest.approx(duration, rel=1e-12)
    assert duration > 12.0 / 0.3
    task = report.task("slow")
    assert (task.start, task.departure) == (work.departure, work.arrival)


def test_lines_turn_on_the_spot_at_their_points_and_poses_are_joined_by_arcs() -> None:
    bent = Task("bent", path=[(4, 4), (10, 4), (10, 9)])
    (forth, back) = bent.options
    assert bent.length == 11.0 and forth.exit == Pose(10, 9, np.pi / 2)
    assert back.entry == Pose(10, 9, -np.pi / 2) and back.exit == Pose(4, 4, np.pi)
    for reference in (0.0, 0.2):
        path = forth.path(reference)
        np.testing.assert_allclose(path.end, forth.exit, atol=1e-12)
        corner = path.points[[1, 2]]
        np.testing.assert_allclose(corner, [[10, 4], [10, 4]], atol=1e-12)
        assert path.length == pytest.approx(11.0)
    arc = Task("arc", path=[(4, 4, 0.0), (6, 6, np.pi / 2)])
    assert arc.length == pytest.approx(np.pi)
    assert arc.options[1].entry == pytest.approx(Pose(6, 6, -np.pi / 2))
    assert arc.options[1].exit == pytest.approx(Pose(4, 4, np.pi))


def test_the_load_on_a_row_falls_with_the_distance() -> None:
    """Each metre at its own payload: where the power is linear in it, the mean of both ends."""
    heavy = replace(MODEL, coefficients=1.5 * MODEL.coefficients)
    loaded = mission(
        [row("spray", 4.0, payload_per_metre=-2.0)], payload=40.0,
        payload_models={MODEL.name: {40.0: heavy}},
    )  # fmt: skip
    report = evaluate(loaded)
    work = next(part for part in report.trip if part.kind == "work")
    assert work.leg is not None and work.leg.trajectory is not None
    drive = work.leg.trajectory
    full = Traversal(drive, Ground(heavy.battery_side())).interval_energies()
    none = Traversal(drive, Ground(MODEL.battery_side())).interval_energies()
    steps = np.diff(drive.x)
    middle = (np.cumsum(steps) - steps / 2) / steps.sum()
    load = (40.0 - 24.0 * middle) / 40.0
    assert work.energy == pytest.approx(float(load @ full + (1 - load) @ none), rel=1e-12)
    last = report.legs[-1]
    assert last.leg is not None and last.leg.trajectory is not None
    between = replace(MODEL, coefficients=(1 + 0.5 * 16 / 40) * MODEL.coefficients)
    home = Traversal(last.leg.trajectory, Ground(between.battery_side())).energy()
    assert last.energy == pytest.approx(home, rel=1e-9)


# -- order and direction ---------------------------------------------------------------------------


def best_of_all(asked: Mission) -> float:
    """Least energy of all orders and directions, on the legs of the mission."""
    legs = Legs(asked, routes=ROUTES)
    n = len(asked.tasks)
    size = 1 + 2 * n
    ways = np.full((size, size), np.inf)
    for i in range(size):
        for j in range(size):
            if i == 0 or j == 0 or (i - 1) // 2 != (j - 1) // 2:
                ways[i, j] = legs.leg(i, j, 0.0).energy.mean
    rows = [legs.row(1 + k, 0.0) for k in range(2 * n)]
    work = np.array([0.0, *(row.energy.mean for row in rows if row is not None)])
    ways += work[None, :]
    orders = np.array(list(permutations(range(n))))
    least = np.inf
    for sides in product(range(2), repeat=n):  # the direction of each row
        nodes = 1 + 2 * orders + np.array(sides)[orders]
        first, last = ways[0, nodes[:, 0]], ways[nodes[:, -1], 0]
        inner = ways[nodes[:, :-1], nodes[:, 1:]].sum(axis=1)
        least = min(least, float((first + inner + last).min()))
    return least


def test_rows_are_done_in_the_best_of_all_orders_and_directions() -> None:
    """Eight rows, uneven: 40320 orders in 256 directions each."""
    begins, ends = (4, 4, 6, 5, 4, 8, 4, 5), (16, 15, 16, 13, 12, 16, 17, 16)
    tasks = [
        row(
            f"row {k}", 3.0 + 1.1 * k, begins[k], ends[k], direction="given" if k == 3 else "either"
        )
        for k in range(8)
    ]
    asked = mission(tasks, order="free")
    found = evaluate(asked, routes=ROUTES)
    assert found.proven
    free = mission([replace(one, direction="either") for one in tasks], order="free")
    report = evaluate(free, routes=ROUTES)
    assert report.proven and not report.left_out
    assert report.energy == pytest.approx(best_of_all(free), rel=1e-9)
    assert report.energy <= found.energy
    given = evaluate(mission([*free.tasks]), routes=ROUTES)
    assert report.energy < given.energy and not given.alternatives
    compared = {one.order: one for one in report.alternatives}
    assert compared["given"].energy == pytest.approx(given.energy, rel=1e-12)
    saving = 1.0 - report.energy / given.energy
    assert compared["given"].saving == pytest.approx(saving, rel=1e-9)
    assert f"{100 * saving:.1f} % less than in the order given" in report.compared
    mixed = mission([free.tasks[k] for k in (4, 0, 6, 2, 7, 5, 1, 3)], order="free")
    again = {one.order: one.energy for one in evaluate(mixed, routes=ROUTES).alternatives}
    assert again["row after row"] == pytest.approx(given.energy, rel=1e-9)
    assert again["given"] > 1.05 * given.energy


def best_with_a_tank(asked: Mission, legs: Legs) -> float:
    """Least energy of all orders and directions, each drive with what is on board then."""
    least, n = np.inf, len(asked.tasks)
    for order in permutations(range(n)):
        for sides in product(range(2), repeat=n):
            here, load, energy = 0, asked.payload, 0.0
            for k in order:
                node = 1 + 2 * k + sides[k]
                row = legs.row(node, load)
                assert row is not None
                energy += legs.leg(here, node, load).energy.mean + row.energy.mean
                here, load = node, load + asked.tasks[k].change
            least = min(least, energy + legs.leg(here, 0, load).energy.mean)
    return least


@pytest.mark.parametrize("middle", [(), (25.0,)])
def test_few_loads_are_priced_and_the_order_is_the_best_at_all_of_them(
    middle: tuple[float, ...],
) -> None:
    """Four rows of different lengths leave 16 loads; models of two loads, and of three."""
    models = {load: replace(MODEL, coefficients=(1.0 + 0.01 * load) * MODEL.coefficients)
              for load in (60.0,)}  # fmt: skip
    models |= {load: replace(MODEL, coefficients=1.1 * MODEL.coefficients) for load in middle}
    tasks = [
        row(f"row {k}", 4.0 + 1.5 * k, 4.0 + 0.37 * k, 16.0 - 0.81 * k**2, payload_per_metre=-1.0)
        for k in range(4)
    ]
    asked = mission(
        tasks, order="free", payload=60.0, payload_models={MODEL.name: models}, planning_effort=200
    )
    routes, lines = Routes(), list[str]()
    report = evaluate(asked, lines.append, routes=routes)
    assert report.proven and not report.left_out
    planned = sum(line.startswith("planning") for line in lines)
    assert len(routes) < 20 * planned  # routes and drives, those along the rows among them
    best = best_with_a_tank(asked, Legs(asked, routes=routes))
    assert report.energy == pytest.approx(best, rel=1e-9)


def test_a_given_order_enters_each_row_at_its_better_end() -> None:
    tasks = [row("one", 4.0), row("two", 6.0), row("three", 8.0)]
    found = evaluate(mission(tasks), routes=ROUTES)
    assert found.proven and found.order == ("one", "two", "three")
    every = [
        evaluate(
            mission([
                replace(one, path=one.path[::side], direction="given")
                for one, side in zip(tasks, sides, strict=True)
            ]),
            routes=ROUTES,
        ).energy
        for sides in product((1, -1), repeat=3)
    ]  # fmt: skip
    assert found.energy == min(every)
    assert found.energy < every[0]
    assert [path.start.x for path in found.rows.values()] == [4.0, 16.0, 4.0]


def test_rows_charge_on_the_way_and_many_of_them_are_all_done() -> None:
    """Beyond the exact search, on a battery that needs the charger."""
    tasks = [row(f"row {k}", 3.0 + 0.7 * k, 4.0, 9.0, power=500.0) for k in range(17)]
    small = replace(Battery.preset("quadriga"), capacity=3600.0)
    dock = Charger("dock", (3.0, 14.0, 0.0), power=500.0)
    asked = mission(tasks, order="free", battery=small, chargers=(dock,), soc=0.7)
    report = evaluate(asked, routes=ROUTES)
    assert report.feasible and not report.left_out
    assert sum(one.visits for one in report.chargers) >= 1
    assert report.soc_end >= 0.2
    assert all(report.energy <= one.energy for one in report.alternatives)


def test_a_tank_that_is_emptied_too_early_is_refused() -> None:
    tasks = [row("one", 4.0, payload_per_metre=-2.0), row("two", 6.0, payload_per_metre=-2.0)]
    report = evaluate(mission(tasks, payload=30.0), routes=ROUTES)
    assert report.task("one").verdict == "reachable"
    assert report.task("two").reason == "blocked_by_earlier"
    assert "leaves 24 kg, and 6 kg are on board" in report.task("two").detail
    with_it = evaluate(mission(tasks, payload=48.0), routes=ROUTES)
    assert with_it.feasible


def test_a_window_holds_for_the_begin_of_a_row() -> None:
    late = evaluate(mission([row("row", 4.0, window=(0.0, 1.0))]), routes=ROUTES)
    assert late.task("row").reason == "late"
    waits = evaluate(mission([row("row", 4.0, window=(100.0, 200.0))]), routes=ROUTES)
    assert waits.task("row").start == 100.0


# -- what is refused -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"path": [(1, 1)]}, "a path of 1 points"),
        ({"path": [(1, 1), (1, 1)]}, "points 1 and 2 are the same"),
        ({"path": [(1, 1), (1, 1, 0.5)]}, "give it for all, or for none"),
        ({"path": [(1, 1), (2,)]}, "point 2"),
        ({"path": "rows.csv"}, "a path is the text"),
        ({"path": [(1, 1), (np.nan, 2)]}, "all finite"),
        ({"path": [(1, 1), (2, 1)], "pose": (1, 1, 0)}, "both a pose and a path"),
        ({}, "neither a pose nor a path"),
        ({"path": [(1, 1), (2, 1)], "dwell": 5.0}, "leave dwell out"),
        ({"pose": (1, 1, 0), "payload_per_metre": 1.0}, "payload_per_metre is for tasks with a"),
        ({"pose": (1, 1, 0), "speed": 1.0}, "speed is for tasks with a path"),
        ({"pose": (1, 1, 0), "direction": "given"}, "direction is for tasks with a path"),
    ],
)
def test_a_task_that_is_no_row_is_refused(keys: dict[str, Any], words: str) -> None:
    with pytest.raises(MissionError, match=words):
        Task("row", **keys)


def test_a_row_through_an_obstacle_is_refused_with_its_place() -> None:
    occupied = np.zeros((90, 120), bool)
    occupied[20, 50] = True  # at (10, 4)
    blocked = OccupancyGrid(occupied, 0.2)
    with pytest.raises(MissionError, match=r"'row': on its path the robot at \(9\.") as caught:
        mission([row("row", 4.0)], map=blocked)
    assert caught.value.place == ("tasks", 0, "path")
    report = evaluate(mission([row("row", 4.0, required=False)], map=blocked))
    assert report.task("row").reason == "no_path"
    with pytest.raises(MissionError, match="sideways") as caught:
        mission([Task("slide", path=[(4, 4, 0.0), (4, 8, 0.0)])])
    assert caught.value.place == ("tasks", 0, "path")


def test_surfaces_under_a_row_count() -> None:
    import shapely

    from energyplan.terrain import Surface

    rough = replace(MODEL, name="rough", coefficients=2.0 * MODEL.coefficients)
    half = SurfaceMap((Surface(shapely.box(10, 0, 24, 18), rough, "rough"),))
    plain, both = (
        next(one for one in evaluate(mission([row("row", 4.0)], surfaces=ground)).trip
             if one.kind == "work").energy
        for ground in (None, half)
    )  # fmt: skip
    assert 1.4 * plain < both < 1.6 * plain
