"""Several robots in a corridor, whose answers are sums of straight drives."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import Run
from corridors import METRE, at, corridor
from worlds import tiny

from energyplan import watch
from energyplan.errors import InvalidInputError, MissionError
from energyplan.html import clock
from energyplan.io.maps import write_map
from energyplan.io.mission import read_mission
from energyplan.mission import (
    Charger,
    Mission,
    MissionReport,
    Robot,
    RobotState,
    Spreads,
    Task,
    evaluate,
)
from energyplan.output import documents, text
from energyplan.output.pages import mission_page
from energyplan.path import Pose
from energyplan.ros import mission_answer
from energyplan.terrain import OccupancyGrid

TASKS = at("a", 6.0), at("b", 12.0), at("c", 30.0)
ROOT = Path(__file__).resolve().parents[2]


def robot(name: str, x: float, energy: float = 1e5, **changes: Any) -> Robot:
    start = Pose(x, 1.5, 0.0)
    return Robot(name, changes={"start": start, "battery": tiny(energy), **changes})


def shared(*robots: Robot, tasks: tuple[Task, ...] = TASKS, **changes: Any) -> Mission:
    values = {"order": "free", "return_to": "start", "spreads": Spreads(), **changes}
    return corridor(1e5, tasks, 4.0, robots=robots, **values)


def names(report: MissionReport) -> tuple[str, ...]:
    return tuple(task.name for task in report.tasks)


def test_each_does_what_lies_near_it() -> None:
    """From 4 m to 12 m and back, from 28 m to 30 m and back; nothing is cheaper."""
    report = evaluate(shared(robot("west", 4.0), robot("east", 28.0)))
    assert set(names(report.robot("west"))) == {"a", "b"}
    assert names(report.robot("east")) == ("c",)
    assert report.energy == pytest.approx(METRE * (16 + 4), rel=1e-3)
    assert report.feasible


def test_each_ones_budget_is_that_of_its_own_mission() -> None:
    both = shared(robot("west", 4.0), robot("east", 28.0), confidence=0.95, coefficient_spread=0.1)
    told = evaluate(both).robot("west")
    alone = evaluate(replace(both.parts[0], tasks=tuple(TASKS[k] for k in (0, 1))))
    assert told.energy == pytest.approx(alone.energy, rel=1e-6)
    assert told.energy_upper == pytest.approx(alone.energy_upper, rel=1e-6)
    assert told.soc_end_lower == pytest.approx(alone.soc_end_lower, rel=1e-6)
    assert told.energy_upper > told.energy


def test_a_weak_battery_leaves_a_task_to_the_other() -> None:
    """East has 1.5 m of charge; west goes all the way, 26 m and back."""
    report = evaluate(shared(robot("west", 4.0), robot("east", 28.0, 1.5 * METRE)))
    assert set(names(report.robot("west"))) == {"a", "b", "c"}
    assert names(report.robot("east")) == ()
    assert report.energy == pytest.approx(METRE * 52, rel=1e-3)


def test_a_shared_charger_is_waited_for_and_two_places_spare_that() -> None:
    """Both hold 9 m of charge; with the 40 m that the dock gives they do the rest."""
    tasks = at("w", 3.0, needs=("w",)), at("e", 31.0, needs=("e",))
    dock = Charger("dock", Pose(17.0, 1.5, 0.0), power=50.0, until=1.0)
    robots = [replace(robot(name, x, 40 * METRE, soc=0.225), skills=(task,))
              for name, x, task in (("left", 14.0, "e"), ("right", 20.0, "w"))]  # fmt: skip
    waited = {
        count: [
            r.waiting
            for r in evaluate(
                shared(*robots, tasks=tasks, chargers=(replace(dock, places=count),))
            ).robots
        ]
        for count in (1, 2)
    }
    assert waited[2] == [0.0, 0.0]
    first, second = sorted(waited[1])
    assert first == 0.0
    # they get there at once; the first takes 40 m less the 6 m that are left, at 50 W
    assert second == pytest.approx(METRE * (40 - 6) / 50.0, abs=31.0)
    report = evaluate(shared(*robots, tasks=tasks, chargers=(dock,)))
    stays = sorted(
        (s.departure, s.arrival) for r in report.robots for s in r.route if s.kind == "charge"
    )
    assert len(stays) == 2
    assert report.feasible


def test_who_fails_is_replaced_by_whom_it_costs_least() -> None:
    """West fails on its way; what it has done stays done, and the others go from where they are."""
    report = evaluate(shared(robot("west", 4.0), robot("middle", 16.0), robot("east", 28.0)))
    assert {r.mission.name: names(r) for r in report.robots} == {
        "west": ("a",), "middle": ("b",), "east": ("c",),
    }  # fmt: skip
    rest = report.after_failure("west", 0.0)
    assert [r.name for r in rest.robots] == ["middle", "east"]
    after = evaluate(rest)
    assert set(names(after.robot("middle"))) == {"a", "b"}
    late = max(stop.departure for stop in report.robot("west").route if stop.kind == "task")
    again = report.after_failure("west", late + 1e-6)
    assert "a" not in {task.name for task in again.tasks}
    with pytest.raises(MissionError, match="no robot is called 'north'; the robots are west"):
        report.after_failure("north", 0.0)
    with pytest.raises(MissionError, match="no robot is left"):
        report.after_failure("west", 1e9)


def test_where_a_robot_is_at_some_time() -> None:
    told = evaluate(shared(robot("one", 4.0))).robot("one")
    stop = next(stop for stop in told.route if stop.kind == "task")
    early, half = told.at(-1.0), told.at(stop.arrival / 2)
    assert early.pose == Pose(4.0, 1.5, 0.0)
    assert 4.0 < half.pose.x < stop.pose.x
    assert half.done == ()
    last = told.at(1e9)
    assert last.done == names(told)
    assert last.soc == pytest.approx(told.soc_end)
    assert last.pose == pytest.approx((4.0, 1.5, 0.0), abs=1e-6)


def test_what_no_robot_can_do_is_told_with_its_reasons() -> None:
    report = evaluate(shared(robot("west", 4.0, 20 * METRE), robot("middle", 14.0, 20 * METRE)))
    [left] = report.left_out
    assert left.name == "c"
    assert left.reasons == ("battery", "battery")
    assert (left.reason, left.reachable_alone) == ("battery", False)
    for name in ("west", "middle"):
        assert re.search(rf"{name}: with the way back to start it may take \d+ Wh, ", left.detail)
    assert left.detail in "\n".join(text.mission(report))
    (out,) = documents.mission(report)["left_out"]
    assert (out["name"], out["detail"]) == ("c", left.detail)
    assert not report.feasible


def test_many_robots_and_tasks() -> None:
    """Eleven tasks in a row, three robots: at best each goes once to and fro over its own part.

    From 3 m to 14 and back, from 16 m to 21.5 and back, from 30 m to 24 and back.
    """
    tasks = tuple(at(f"t{k}", 4.0 + 2.5 * k) for k in range(11))
    report = evaluate(shared(*(robot(f"r{x}", x) for x in (3.0, 16.0, 30.0)), tasks=tasks))
    assert report.left_out == ()
    assert not report.proven
    assert report.energy <= METRE * 2 * (11 + 5.5 + 6) + 1


def test_chargers_are_never_taken_twice() -> None:
    """Four robots that all have to charge at one dock with two places."""
    tasks = tuple(at(f"t{k}", 4.0 + 8.0 * k, required=False, needs=(f"t{k}",)) for k in range(4))
    dock = Charger("dock", Pose(17.0, 1.5, 0.0), power=50.0, until=1.0, places=2)
    robots = [replace(robot(f"r{k}", x, 40 * METRE, soc=0.25), skills=(f"t{k}",))
              for k, x in enumerate((20.0, 22.0, 12.0, 14.0))]  # fmt: skip
    report = evaluate(shared(*robots, tasks=tasks, chargers=(dock,)))
    stays = [(s.departure, s.arrival) for r in report.robots for s in r.route
             if s.kind == "charge"]  # fmt: skip
    assert len(stays) >= 3
    for end, _ in stays:
        assert sum(begin < end - 1e-6 <= other for other, begin in stays) <= 2


def test_robots_that_make_no_sense_are_refused() -> None:
    one = robot("one", 4.0)
    with pytest.raises(MissionError, match="the name 'one' stands twice"):
        shared(one, one)
    with pytest.raises(MissionError, match="colour: a robot has no such key"):
        robot("one", 4.0, colour="red")
    with pytest.raises(MissionError, match="robot 'one': task 'a'") as refused:
        shared(one, tasks=(at("x", 8.0, needs=("arm",)), at("a", -1.0)))
    assert refused.value.place == ("tasks", 1, "pose")
    with pytest.raises(MissionError, match="'one' has the skills for no task"):
        shared(one, tasks=(replace(TASKS[0], needs=("arm",)),))
    with pytest.raises(MissionError, match=r"robot 'one': .*soc.* is 1\.6") as refused:
        shared(replace(one, changes={**one.changes, "soc": 1.6}))
    assert refused.value.place[:2] == ("robots", 0)
    with pytest.raises(MissionError, match="no robot is called three"):
        shared(one).resume_robots({"three": RobotState(Pose(1, 1, 0), 1.0)})
    with pytest.raises(MissionError, match="several robots; use resume_robots"):
        shared(one).resume((1, 1, 0), 1.0)


def test_a_log_is_of_one_robot() -> None:
    both = shared(robot("west", 4.0), robot("east", 28.0))
    with pytest.raises(InvalidInputError, match=r"several robots \(west, east\), and a log is of"):
        next(iter(watch([], mission=both)))


def test_a_report_of_several_robots_is_read_as_one() -> None:
    """Sums and longest times of the robots; each has an end of its own."""
    report = evaluate(shared(robot("west", 4.0), robot("east", 28.0)))
    assert report.headline == "all 3 tasks can be done"
    assert report.duration == max(one.duration for one in report.robots)
    assert len(report.legs) == sum(len(one.legs) for one in report.robots)
    assert [one.name for one in report.tasks] == ["a", "b", "c"]
    with pytest.raises(MissionError, match=r"use report.robot\(NAME\).end, where NAME is one of"):
        _ = report.soc_end
    page = mission_page(report).html()
    assert page.count("<figure>") == 4
    assert ">west</h2>" in page


@pytest.mark.parametrize(
    "read",
    [
        lambda report: report.at(10.0), lambda report: report.timeline,
        lambda report: report.route, lambda report: report.order,
        lambda report: report.timetable, lambda report: report.done_by(10.0),
    ],
    ids=["at", "timeline", "route", "order", "timetable", "done_by"],
)  # fmt: skip
def test_what_each_of_several_robots_has_is_read_of_one(read: Any) -> None:
    report = evaluate(shared(robot("west", 4.0), robot("east", 28.0)))
    with pytest.raises(MissionError, match=r"report\.robot\(NAME\)\.\w+, where .*'west', 'east'"):
        read(report)
    read(report.robot("west"))


def test_a_task_for_whose_skills_no_robot_is_left_is_not_done() -> None:
    """The only robot with an arm fails before it does anything."""
    tasks = (*TASKS[:2], replace(TASKS[2], needs=("arm",)))
    both = shared(replace(robot("arm", 16.0), skills=("arm",)), robot("west", 4.0), tasks=tasks)
    report = evaluate(evaluate(both).after_failure("arm", 0.0))
    [left] = report.left_out
    assert (left.name, left.reasons, report.feasible) == ("c", (), False)


# -- files and the command -----------------------------------------------------------------------


def test_a_file_gives_each_robot_what_it_has_the_skills_for() -> None:
    mission = read_mission(ROOT / "examples" / "fleet_warehouse.yaml")
    able = {part.name: [task.name for task in part.tasks] for part in mission.parts}
    assert "turn the valve" in able["alpha"]
    assert "turn the valve" not in able["beta"]
    assert [part.soc for part in mission.parts] == pytest.approx([1.0, 0.6, 0.35])
    assert [part.home == part.start for part in mission.parts] == [True] * 3
    assert mission.parts[0].map is mission.parts[1].map


@pytest.mark.parametrize(
    ("before", "after", "message"),
    [
        ("soc: 60 %", "soc: 160 %", r"fleet\.yaml, line 19, soc: give 0 to 1"),
        ("needs: [arm]", "needs: [wings]", r"line \d+, tasks\.1\.needs: no robot has wings"),
        ("skills: [arm]", "colour: red", r"robots\.0\.colour: a robot has no such key"),
        ("places: 1", "places: 0", r"chargers\.0\.places"),
        ("robots:", "robot:", "did you mean robots?"),
        ("pose: [16.0, 7.2, 0]", "pose: [0, 0, 0]", r"tasks\.1\.pose: task 'turn the valve'"),
    ],
)
def test_what_is_wrong_with_a_file_is_told_with_its_line(
    before: str, after: str, message: str, tmp_path: Path
) -> None:
    text = (ROOT / "examples" / "fleet_warehouse.yaml").read_text()
    file = tmp_path / "fleet.yaml"
    file.write_text(text.replace(before, after, 1))
    with pytest.raises(MissionError, match=message):
        read_mission(file)


def test_the_command_tells_who_does_what_and_who_takes_over(tmp_path: Path, run: Run) -> None:
    """The example in a hall without walls; the example itself stands in the documentation."""
    text = (ROOT / "examples" / "fleet_warehouse.yaml").read_text()
    text = text.replace("map: warehouse.yaml", "map: hall.yaml")
    text = text.replace("surfaces: warehouse_surfaces.geojson\n", "")
    write_map(OccupancyGrid(np.zeros((65, 115), bool), 0.2), tmp_path / "hall.yaml")
    file = tmp_path / "fleet.yaml"
    file.write_text(text)
    page, drives = tmp_path / "page.html", tmp_path / "drives"
    told = run("mission", file, "--json", "--fail", "alpha@100", "--effort", 500,
               "--report", page, "--trajectories", drives).json  # fmt: skip
    assert told["feasible"]
    names = [task["name"] for one in told["robots"] for task in one["tasks"]]
    assert len(names) == len(set(names)) == 4
    assert told["after_failure"]["robot"] == "alpha"
    rest = told["after_failure"]["robots"]
    assert {one["name"] for one in rest} <= {"beta", "gamma"}
    spans = [(one["timetable"][0]["start"], one["timetable"][-1]["end"]) for one in rest]
    first, last = min(begin for begin, _ in spans), max(end for _, end in spans)
    assert told["after_failure"]["duration"] == pytest.approx(last - first, abs=1.0)
    assert sum(len(one["legs"]) for one in told["robots"]) == len([*drives.iterdir()])
    shown = page.read_text()
    assert all(f">{one}</h2>" in shown for one in ("alpha", "beta", "gamma"))
    failed = "alpha fails at 0:01:40, without having done read the west meter"
    before, _, after = shown.partition(f"<h2>If {failed}</h2>")
    assert "after the failure" not in before
    taken_over = {one["name"] for one in rest if "read the west meter" in one["order"]}
    assert all(f"<h2>{one}, after the failure</h2>" in after for one in taken_over)
    for begin, end in spans:  # durations are those of the timetable
        assert f">{clock(begin)}</td>" in after and f">{clock(end)}</td>" in after
    answered = json.loads(mission_answer(text.replace("3000", "500"), tmp_path))
    assert [one["tasks"] for one in answered["robots"]] == [one["tasks"] for one in told["robots"]]
    left = run("mission", file, "--fail", "alpha")
    assert left.code == 2
    assert "write NAME@SECONDS" in left.err


# -- one clock -------------------------------------------------------------------------------------


def meeting(*starts: float, soc: float = 0.225, **changes: Any) -> Mission:
    """Return robots that all have to charge at the dock at 17 m, then drive to a task of their own.

    The tasks lie 10 m beyond the dock; each robot has a full charge of 40 m.
    """
    dock = {"name": "dock", "pose": Pose(17.0, 1.5, 0.0), "power": 50.0, "until": 1.0, **changes}
    tasks = tuple(at(f"t{k}", 27.0 + k, needs=(f"t{k}",)) for k in range(len(starts)))
    robots = [
        replace(robot(f"r{k}", x, 40 * METRE, soc=soc), skills=(f"t{k}",))
        for k, x in enumerate(starts)
    ]
    return shared(*robots, tasks=tasks, chargers=(Charger(**dock),), return_to="any")


def stays(report: MissionReport) -> list[tuple[float, float]]:
    """Return when each robot charges, in the order of the robots."""
    return [(c.departure, c.arrival) for one in report.robots for c in one.charges]


def test_who_comes_first_is_served_first() -> None:
    """Of three robots the one that stands farthest off is listed first and charges last."""
    report = evaluate(meeting(11.0, 16.0, 13.0))
    (third, second, first) = (stays(report)[k] for k in (0, 2, 1))
    assert first[0] < second[0] < third[0]
    assert second[0] == pytest.approx(first[1], abs=1e-6)
    assert third[0] == pytest.approx(second[1], abs=1e-6)
    assert report.feasible


def test_a_robot_comes_between_two_charges_of_another() -> None:
    """The first one charges twice; another that comes meanwhile does not wait for both."""
    tasks = (
        at("x", 2.0, needs=("a",)), at("y", 32.0, needs=("a",)), at("z", 25.0, needs=("b",)),
    )  # fmt: skip
    dock = Charger("dock", Pose(17.0, 1.5, 0.0), power=50.0, until=1.0)
    robots = (
        replace(robot("a", 16.0, 36 * METRE, soc=0.2), skills=("a",)),
        replace(robot("b", 11.0, 36 * METRE, soc=0.25), skills=("b",)),
    )
    report = evaluate(shared(*robots, tasks=tasks, chargers=(dock,), return_to="any"))
    twice, once = (report.robot(name).charges for name in ("a", "b"))
    assert [len(twice), len(once)] == [2, 1]
    assert twice[0].arrival == pytest.approx(once[0].departure, abs=1e-6)
    assert once[0].arrival <= twice[1].departure + 1e-6


def test_robots_share_the_power_of_a_charger() -> None:
    """The second comes while the first charges; then each has half, and the last all again."""
    lone = evaluate(meeting(16.0, 12.0, power=20.0, places=2))
    both = evaluate(meeting(16.0, 12.0, power=20.0, places=2, shared=True))
    (a, b), (c, d) = stays(both)
    assert a < c < b < d
    energy = sum(-one.energy for one in both.charges)
    # while anybody is there all of the power is used
    assert energy == pytest.approx(20.0 * (d - a), rel=1e-3)
    alone = [end - begin for begin, end in stays(lone)]
    # of its own charge the first gets all until the second comes
    assert b - c == pytest.approx(2 * (alone[0] - (c - a)), rel=1e-3)
    assert d - b == pytest.approx(alone[1] - 0.5 * (b - c), rel=1e-3)
    assert both.feasible


def test_a_place_for_one_is_not_shared() -> None:
    with pytest.raises(MissionError, match="'dock' shares its power and has one place; give it 2"):
        Charger("dock", Pose(17.0, 1.5, 0.0), power=50.0, shared=True)


def test_robots_charge_no_more_than_they_need() -> None:
    """Each needs the way to its task and back to the dock: 20 m and 22 m of the 40 m."""
    full = evaluate(meeting(16.0, 12.0))
    least = evaluate(meeting(16.0, 12.0, enough=True))
    levels = [one.charges[0].soc[-1] for one in least.robots]
    assert levels == pytest.approx([20 / 40, 22 / 40], abs=0.0101)
    assert all(level >= need / 40 for level, need in zip(levels, (20, 22), strict=True))
    assert names(least) == names(full)
    assert least.energy == pytest.approx(full.energy, rel=1e-9)
    assert least.duration < 0.7 * full.duration
    assert min(one.soc_end_lower for one in least.robots) >= 0.0
    ((_, first), (second, _)) = stays(least)
    assert second == pytest.approx(first, abs=1e-6)
