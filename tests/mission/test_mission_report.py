"""What a mission's report says in text, on the page and in JSON: headline, route, times."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from statistics import NormalDist

import numpy as np
import pytest
from corridors import METRE, at, charger, corridor

from energyplan.battery import Battery
from energyplan.io.files import bundled
from energyplan.io.mission import read_mission
from energyplan.mission import Charger, MissionReport, Routes, Spreads, Task, evaluate
from energyplan.output import documents, text
from energyplan.output.pages import mission_page
from energyplan.path import Pose
from energyplan.power import PowerModel, Residual


def optional(report: MissionReport, names: str) -> MissionReport:
    """The mission again, with only the tasks named by a letter required."""
    tasks = [replace(task, required=task.name in names) for task in report.mission.tasks]
    return evaluate(replace(report.mission, tasks=tuple(tasks)))


def test_a_notebook_tells_energy_and_charge_left() -> None:
    report = evaluate(corridor(1e4, {"x": 20.0}, 5.0))
    told = float(report._repr_html_().partition(" Wh, at 50 %")[0].rpartition(" ")[2])
    assert told == pytest.approx(report.energy / 3600, rel=0.02)
    assert f"{100 * report.soc_end:.0f} % of charge at the end" in report._repr_html_()


HEADLINES = [
    (1e6, "abc", "all 3 tasks can be done", True),
    (1e6, "", "all 3 tasks can be done", True),
    (5000.0, "ab", "all required tasks can be done; 1 of 3 tasks, optional, is left out", True),
    (3000.0, "a", "all required tasks can be done; 2 of 3 tasks, optional, are left out", True),
    (3000.0, "", "2 of 3 tasks, optional, are left out", True),
    (5000.0, "abc", "not feasible as asked: 1 of 3 tasks cannot be done", False),
    (3000.0, "ab", "not feasible as asked: 2 of 3 tasks cannot be done, 1 of them required", False),
]


@pytest.mark.parametrize(("energy", "required", "headline", "feasible"), HEADLINES)
def test_headline_counts_and_flags_agree(
    energy: float, required: str, headline: str, feasible: bool
) -> None:
    """Tasks at 6, 12 and 24 m from the start: there and back 2160, 4320, 8640 J."""
    asked = evaluate(corridor(energy, {"a": 11.0, "b": 17.0, "c": 29.0}, 5.0))
    report = optional(asked, required)
    document = documents.mission(report)
    assert (report.headline, report.feasible) == (headline, feasible)
    single = evaluate(corridor(energy, {"c": 29.0}, 5.0)).headline
    done = "the task can be done" if energy > 8640 else None
    assert single == (done or "not feasible as asked: the only task cannot be done")
    assert (document["headline"], document["feasible"]) == (headline, feasible)
    assert text.mission(report)[0].startswith(headline)
    if required == "ab":  # where it ends well and where it does not
        assert headline[1:] in mission_page(report).html()
    left = sum(task["verdict"] == "unreachable" for task in document["tasks"])
    assert (f"{left} of 3" in headline) == (left > 0)


def test_route_and_times_are_those_of_the_drive() -> None:
    """5 m at 0.5 m/s to a window at 60 s, 30 s of work; charge; 10 s of work; home."""
    tasks = at("early", 10.0, dwell=30.0, window=(60.0, 1e4)), at("far", 25.0, dwell=10.0)
    asked = corridor(5000.0, tasks, 5.0, speed=0.5, chargers=(charger(15, "dock"),))
    report = evaluate(asked)
    early, far = report.tasks
    assert (early.start, early.departure) == (60.0, 90.0)
    assert 10.0 < early.arrival < 20.0  # the robot has to speed up and slow down
    assert early.soc_lower == pytest.approx(1 - METRE * 5 / 5000, rel=1e-3)
    assert far.departure - far.arrival == pytest.approx(10.0)
    names = [(stop.name, stop.kind) for stop in report.route]
    assert names[0] == ("start", "start")
    assert [name for name in names if name[1] == "task"] == [("early", "task"), ("far", "task")]
    assert names[-1] == (report.end, "end")
    assert ("dock", "charge") in names
    times = [t for stop in report.route for t in (stop.arrival, stop.departure)]
    assert np.all(np.diff(times) >= -1e-9)
    assert report.route[-1].arrival == pytest.approx(report.duration)
    assert report.route[-1].soc == report.soc_end
    document = documents.mission(report)
    assert document["route"][0] == {
        "name": "start", "kind": "start", "pose": [5.0, 1.5, 0.0], "arrival": 0.0,
        "departure": 0.0, "soc": 1.0, "soc_lower": 1.0,
    }  # fmt: skip
    assert document["tasks"][0]["pose"] == [10.0, 1.5, 0.0]
    assert document["tasks"][0]["arrival"] == early.arrival
    assert document["duration"] == report.duration
    assert document["proven"] is True


def test_legs_and_chargers_are_told_for_programs() -> None:
    asked = corridor(5000.0, {"a": 9.0, "b": 25.0}, 5.0, chargers=(charger(15, "dock"),))
    report = evaluate(replace(asked, confidence=0.95, coefficient_spread=0.05))
    assert "trajectory" not in documents.mission(report)["legs"][0]
    document = documents.mission(report, trajectories=True)
    assert (document["end"], document["gap"]) == (report.end, 0.0)
    assert document["soc_end_lower"] == report.soc_end_lower < report.soc_end
    for before, stop, leg in zip(report.route, report.route[1:], document["legs"], strict=False):
        assert (leg["start"], leg["goal"]) == (before.name, stop.name)
        assert leg["departure"] == pytest.approx(before.departure)
        drive = leg["trajectory"]
        assert {len(column) for column in drive.values()} == {len(drive["t"])}
        assert drive["x"][0] == pytest.approx(before.pose.x, abs=1e-6)
        assert drive["x"][-1] == pytest.approx(stop.pose.x, abs=1e-6)
        assert drive["soc"][0] == pytest.approx(before.soc, abs=1e-6)
        assert drive["soc_lower"][0] == pytest.approx(before.soc_lower, abs=1e-6)
    assert sum(leg["energy"] for leg in document["legs"]) == pytest.approx(report.energy)
    (dock,) = document["chargers"]
    assert (dock["name"], dock["visits"]) == ("dock", 1)
    assert dock["energy"] == pytest.approx(500.0 * dock["duration"], rel=0.2)


def test_the_timetable_has_no_gap_and_the_headline_tells_how_long_it_charges() -> None:
    tasks = at("a", 9.0, dwell=30.0, window=(60.0, 1e4)), at("b", 25.0)
    report = evaluate(corridor(5000.0, tasks, 5.0, chargers=(charger(15, "dock"),)))
    told = report.timetable
    drives = [one for one in told if one.kind == "drive"]
    for name in ("peak_power", "peak_current"):
        assert [getattr(one, name) for one in drives] == [getattr(one, name) for one in report.legs]
        assert all(getattr(one, name) == 0 for one in told if one.kind == "charge")
    assert (
        f"{drives[0].peak_current:.3g}"
        in next(one for one in report.tables if one.title == "Timetable").text()
    )
    assert [one.kind for one in told][:4] == ["drive", "wait", "work", "drive"]
    for before, after in pairwise(told):
        assert after.start == pytest.approx(before.end, abs=1e-6)
        assert after.soc_start == pytest.approx(before.soc_end, abs=1e-6)
    assert told[-1].end == pytest.approx(report.duration)
    assert told[-1].soc_end == pytest.approx(report.soc_end)
    (charge,) = [one for one in told if one.kind == "charge"]
    assert charge.soc_end > charge.soc_start
    minutes = (charge.end - charge.start) / 60
    said = f"; {report.duration / 60:.0f} min, {minutes:.0f} min of which charging"
    assert report.sentence == report.headline + said
    for shown in (*text.mission(report), report._repr_html_(), mission_page(report).html()):
        if "charge" in shown and "dock" in shown:
            assert f"{minutes:.1f}" in shown
    assert documents.mission(report)["timetable"][1]["place"] == "a"


def test_a_report_says_what_the_bands_of_its_map_are() -> None:
    """The paths of tasks are wide bands; where all tasks are at places there are none."""
    place = at("a", 11.0)
    x, y, _ = place.pose
    row = Task("row", path=[(x, y), (x + 3.0, y)])
    pages = [mission_page(evaluate(corridor(1e5, (one,), 5.0))).html() for one in (row, place)]
    assert ["Wide bands are the paths of tasks" in page for page in pages] == [True, False]


def test_what_is_not_done_has_no_times() -> None:
    document = documents.mission(evaluate(corridor(1e3, {"a": 11.0}, 5.0)))
    (task,) = document["tasks"]
    assert document["uncertainty"] == []  # nothing is uncertain
    assert (task["arrival"], task["departure"], task["soc_lower"]) == (None, None, None)


def test_sources_that_contribute_nothing_have_no_row() -> None:
    residual = Residual(rmse=1e-4, mae=1e-4, bias=0.0, energy_error=0.03, correlation_time=2.0)
    model = replace(PowerModel.preset("quadriga:empty:marble"), residual=residual)
    report = evaluate(
        corridor(1e6, {"a": 25.0}, 5.0, model=model, confidence=0.95, coefficient_spread=0.05)
    )
    assert "noise of the drive" in {doubt.source for doubt in report.uncertainty}
    shown = "\n".join(text.mission(report))
    assert "coefficient spread" in shown and "hold-out error" in shown
    assert "noise of the drive" not in shown


def test_sources_of_doubt_add_up_to_the_bound() -> None:
    residual = Residual(rmse=15.0, mae=12.0, bias=0.0, energy_error=0.03, correlation_time=2.0)
    model = PowerModel.preset("quadriga:empty:marble")
    model = model.with_coefficients(model.coefficients, np.diag((0.04 * model.coefficients) ** 2))
    asked = corridor(
        1e6, {"a": 25.0}, 5.0, model=replace(model, residual=residual), confidence=0.95,
        coefficient_spread=0.05,
    )  # fmt: skip
    report = evaluate(asked)
    told = {doubt.source: doubt.energy for doubt in report.uncertainty}
    # 40 m straight: all energy is that of one coefficient
    assert told["coefficient_spread"] == pytest.approx(0.05 * 40 * METRE, rel=1e-3)
    assert told[f"coefficients of {model.name}"] == pytest.approx(0.04 * 40 * METRE, rel=1e-3)
    assert told[f"hold-out error of {model.name}"] == pytest.approx(0.03 * 40 * METRE, rel=1e-3)
    assert told["noise of the drive"] == pytest.approx(
        np.sqrt(2 * 15.0**2 * 2.0 * report.duration), rel=1e-3
    )
    assert list(told.values()) == sorted(told.values(), reverse=True)
    std = np.sqrt(sum(value**2 for value in told.values()))
    margin = NormalDist().inv_cdf(0.95) * std
    assert report.energy_upper - report.energy == pytest.approx(margin, rel=1e-6)
    listed = documents.mission(report)["uncertainty"]
    assert listed[0]["source"] == "coefficient_spread"
    assert listed[0]["energy"] == told["coefficient_spread"]
    # without it the others would still hold back theirs
    rest = NormalDist().inv_cdf(0.95) * np.sqrt(std**2 - told["coefficient_spread"] ** 2)
    assert listed[0]["saving"] == pytest.approx(margin - rest, rel=1e-6)
    assert text.mission(report)[-len(told)].startswith("  coefficient spread")


@pytest.mark.nightly
def test_in_the_yard_the_route_decides_and_a_remedy_saves_the_task_out_of_reach() -> None:
    """The shortest routes take more than the battery holds above its reserve."""
    mission, routes = read_mission(bundled("mission_yard.yaml")), Routes()
    report = evaluate(mission, routes=routes)
    assert report.feasible
    (mast,) = [task for task in report.tasks if task.verdict == "unreachable"]
    remedy = next(one for one in mast.remedies if one.kind == "charge")
    saved = evaluate(mission.with_remedy(remedy), routes=routes)
    assert [task.verdict for task in saved.tasks] == ["reachable"] * len(mission.tasks)
    shortest = evaluate(replace(mission, objective="length", soc=1.0), routes=routes)
    length = [sum(path.length for path in one.paths) for one in (saved, shortest)]
    assert length[1] < 0.9 * length[0]
    held = mission.battery.usable_energy(50.0, [mission.soc, mission.reserve])
    assert saved.energy_upper < held[0] - held[1] < shortest.energy


@pytest.mark.parametrize(
    ("words", "why"),
    [
        ("24 V 4 Ah lead-acid 10 mohm, 25 degC", "deliver more current than it may"),
        ("24 V 20 Ah lead-acid 700 mohm", "the voltage sags below cut-off"),
    ],
)
def test_why_a_task_is_left_out_is_in_every_answer(words: str, why: str) -> None:
    """The battery has enough charge; what it lacks is power, which the reason alone would hide."""
    tool = at("drill", 11.0, dwell=60.0, power=600.0)
    report = evaluate(corridor(1.0, (tool,), 5.0, battery=Battery.of(words)))
    (task,) = report.tasks
    assert task.reason == "battery"
    assert (task.shortfall, why in task.detail) == (0.0, True)
    assert any(task.detail in line for line in text.mission(report))
    assert documents.mission(report)["tasks"][0]["detail"] == task.detail
    assert task.detail in mission_page(report).html()
    assert task.detail in report._repr_html_()


def test_a_remedy_names_the_tasks_that_are_done_before() -> None:
    """24 m there and back after two tasks on the way: the larger battery is for all three."""
    tasks = {"a": 11.0, "b": 17.0, "c": 29.0}
    (*_, last) = evaluate(corridor(5000.0, tasks, 5.0)).tasks
    assert "(with 'a', 'b' done before it)" in last.remedy
    (only,) = evaluate(corridor(5000.0, {"c": 29.0}, 5.0)).tasks
    assert "before it" not in only.remedy
    assert only.remedies


def test_at_the_instant_of_a_departure_what_begins_then_is_under_way() -> None:
    """A stay that begins at the instant in question is completed; a drive stands at its start."""
    report = evaluate(corridor(1e5, (at("a", 11.0, dwell=60.0), at("b", 17.0)), 5.0))
    stay = next(one for one in report.route if one.name == "a")
    assert stay.departure == pytest.approx(stay.arrival + 60.0)
    begun, just_before = report.at(stay.arrival), report.at(np.nextafter(stay.arrival, 0.0))
    assert (begun.done, begun.time) == (("a",), stay.departure)
    assert (just_before.done, just_before.time < stay.arrival) == ((), True)
    left = report.at(stay.departure)
    assert (left.done, left.time, left.pose[:2]) == (("a",), stay.departure, (11.0, 1.5))
    assert left.soc == pytest.approx(stay.soc)


def test_the_order_has_a_charger_at_the_end_once() -> None:
    dock = charger(25.0, "dock")
    task = {"a": 20.0}
    ends = evaluate(corridor(1e5, task, 15.0, chargers=(dock,), return_to="charger"))
    assert (ends.order, ends.end) == (("a", "dock"), "dock")
    home = evaluate(corridor(1e5, task, 15.0, chargers=(dock,), return_to="start"))
    assert (home.order, home.end) == (("a",), "start")
    # it charges where it ends
    stays = evaluate(
        corridor(25 * METRE, {"a": 27.0}, 15.0, chargers=(dock,), return_to="charger", soc=0.5)
    )
    assert (stays.order, stays.end) == (("dock", "a", "dock"), "dock")
    k = next(k for k, part in enumerate(stays.trip) if part.kind == "charge")
    last = replace(stays.trip[-1], start="dock", goal="dock", pose=stays.trip[k].pose)
    assert replace(stays, trip=(*stays.trip[: k + 1], last)).order == ("dock",)


@pytest.mark.parametrize("order", ["given", "free"])
@pytest.mark.parametrize("power", [600.0, 6000.0])
def test_a_battery_takes_no_more_current_than_it_may(power: float, order: str) -> None:
    """Lead-acid takes 0.3 times its capacity an hour: 6 A, of which 90 % is stored."""
    dock = Charger("dock", Pose(15.0, 1.5, 0.0), power=power, until=0.6)
    pack = Battery.of("24 V 20 Ah lead-acid 28 mohm")
    report = evaluate(
        corridor(
            1.0, (at("a", 20.0, dwell=3600.0, power=150.0),), 15.0, battery=pack, soc=0.25,
            reserve=0.2, chargers=(dock,), order=order,
        )
    )  # fmt: skip
    assert report.feasible
    (charge,) = report.charges
    hours = (charge.arrival - charge.departure) / 3600
    assert hours == pytest.approx((0.6 - 0.25) * 20 / (0.9 * 6.0), rel=0.01)
    assert report.order == ("dock", "a")


def test_chargers_supply_what_an_ideal_battery_takes() -> None:
    """Nothing is lost in a battery without resistance: the energy is that of the charge."""
    dock = charger(15.0, "dock")
    report = evaluate(
        corridor(40 * METRE, {"a": 30.0}, 15.0, chargers=(dock,), soc=0.2, spreads=Spreads.none())
    )
    taken = sum(part.soc[-1] - part.soc[0] for part in report.charges) * 40 * METRE
    assert sum(one.energy for one in report.chargers) == pytest.approx(taken, rel=0.01)
    assert taken > 0


def test_an_order_of_many_tasks_says_how_much_a_better_one_could_save() -> None:
    """Seventeen tasks there and back along a corridor: beyond what is proven by the search."""
    places = {f"t{k}": 6.0 + 1.5 * (7 * k % 17) for k in range(17)}
    report = evaluate(corridor(1e6, places, 5.0, order="free"))
    assert not report.left_out
    assert 0.0 <= report.gap < 0.1
    document = documents.mission(report)
    assert (document["proven"], document["gap"]) == (report.proven, report.gap)
    said = f"a better order could save at most {100 * report.gap:.1f} % of the energy"
    assert (said in text.mission(report)) is not report.proven
    assert (f"A{said[1:]}." in mission_page(report).html()) is not report.proven


def test_an_order_that_leaves_tasks_out_does_not_say_that_it_is_the_best() -> None:
    places = {f"t{k}": 6.0 + 1.5 * (7 * k % 17) for k in range(17)}
    report = evaluate(corridor(4000.0, places, 5.0, order="free"))
    assert report.left_out
    assert np.isnan(report.gap)
    assert "how much a better order could save is not known" in text.mission(report)
