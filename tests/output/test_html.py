"""What results show of themselves in a notebook, and where they are printed."""

from __future__ import annotations

import dataclasses
from html.parser import HTMLParser

import numpy as np
import pytest

import energyplan as ep
from energyplan import PowerModel, simulate
from energyplan.html import Readable, Summary, number
from energyplan.power import HOTEL

MODEL = PowerModel.preset("quadriga:full:concrete")


class Reader(HTMLParser):
    """Collects the cells of tables, and refuses tags that are not closed."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.cells: list[str] = []
        self.text = ""
        self.feed(text)
        assert self.open == []

    def handle_starttag(self, tag: str, attributes: object) -> None:
        self.open.append(tag)
        if tag in ("td", "th"):
            self.cells.append("")

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text += data
        if self.open and self.open[-1] in ("td", "th"):
            self.cells[-1] += data


def shown(found: Readable) -> Reader:
    page = Reader(found._repr_html_())
    printed = str(found)
    assert all(cell in printed for cell in page.cells)
    return page


def test_text_is_escaped_and_numbers_are_rounded() -> None:
    text = "<script>&"
    page = Reader(Summary(text, ("a", text), [(text, 1234.5678), (True, 2)], [text]).html())
    assert page.cells == ["a", text, text, "1235", "True", "2"]
    assert "<script>" not in Summary(text, (text,), [(text,)], [text]).html()
    assert Reader(Summary(text, (), []).html()).cells == []


def test_printed_tables_are_aligned() -> None:
    rows = [("energy [J]", 1234.5678), ("gap", 0.5)]
    assert Summary("plan", ("", ""), rows).text() == "plan\n  energy [J]  1235\n  gap          0.5"
    told = Summary("all", ("a", "long"), [("one", "x")], ["said"]).text()
    assert told == "all\n  a    long\n  one  x\n- said"
    assert Summary("none", ("a", "b"), []).text() == "none"


@pytest.fixture(scope="module")
def drives() -> list[ep.DriveLog]:
    truth = MODEL.with_term(HOTEL, 40.0)
    return [
        simulate.identification_drive(truth, power_noise=5.0, seed=1),
        simulate.validation_drive(truth, power_noise=5.0, seed=2),
    ]


def test_identification_shows_every_coefficient(drives: list[ep.DriveLog]) -> None:
    found = ep.identify(drives[0], MODEL.vehicle)
    cells = shown(found).cells
    for term in found.model.terms:
        place = cells.index(term.name)
        assert cells[place + 2] == number(found.model.coefficient(term.name))
        assert cells[place + 3] == number(found.std_error[term.name])


@pytest.mark.usefixtures("few_effects")
def test_diagnosis_shows_effects_and_both_errors(drives: list[ep.DriveLog]) -> None:
    told = ep.diagnose(drives[:1], holdout=drives[1:], vehicle=MODEL.vehicle)
    page = shown(told)
    assert "effect found" in page.text
    assert "hotel_load" in page.cells
    shown_error = page.cells[page.cells.index("after") + 1]
    assert float(shown_error.split()[0]) == pytest.approx(told.after.rmse, rel=0.05)


@pytest.fixture(scope="module")
def problem() -> ep.PlanningProblem:
    hall = ep.OccupancyGrid(np.zeros((60, 60), bool), resolution=0.1)
    return ep.PlanningProblem(hall, ep.EnergyCost(MODEL), (2, 2, 0), (4, 3, 1.5))


def test_plan_and_comparison_show_their_energy(problem: ep.PlanningProblem) -> None:
    told = ep.compare(problem, effort=10_000)
    plan = shown(told.energy_optimal).cells
    both = shown(told).cells
    driven = "energy as driven, with its stops [J]"
    assert plan[plan.index(driven) + 1] == number(told.energy_optimal.energy_driven)
    place = both.index(driven)
    energies = [number(p.energy_driven) for p in (told.energy_optimal, told.shortest)]
    assert both[place + 1 : place + 3] == energies
    # a bound stands below what it bounds
    steady = both.index("energy at steady speeds [J]")
    assert both[steady + 3] == "lower bound of energy at steady speeds [J]"
    assert float(both[steady + 4]) <= float(both[steady + 1])
    length = ep.plan(dataclasses.replace(problem, objective="length"), effort=5_000)
    cells = shown(length).cells
    cost, bound = (cells.index(name) + 1 for name in (
        "cost: length and a little energy [m]", "lower bound of the cost [m]"))  # fmt: skip
    assert float(cells[bound]) <= float(cells[cost]) == pytest.approx(length.cost, rel=1e-3)


def test_rounding_is_not_printed_as_a_number() -> None:
    assert [number(x, whole=5e3) for x in (-3.183e-12, 1.421e-14, -0.0, 2e-5)] == [
        "0", "0", "0", "2e-05",
    ]  # fmt: skip
    assert number(-0.0) == "0"
    assert number(1.421e-14) == "1.421e-14"


def test_feasibility_shows_violations(problem: ep.PlanningProblem) -> None:
    timed = ep.speed.profile(ep.plan(problem, effort=10_000).path, MODEL)
    assert shown(ep.check(timed, MODEL)).text.startswith("feasible")
    report = ep.check(timed.scaled(3.0), MODEL)
    page = shown(report)
    assert page.text.startswith("not feasible")
    kinds = page.cells[6::6]
    assert kinds and all(kind.endswith((" [W]", " [m/s]", " [rad/s]", " [m/s²]")) for kind in kinds)
    assert len(page.cells) == 6 * (1 + len(report.violations))


def test_mission_shows_every_task(problem: ep.PlanningProblem) -> None:
    mission = ep.Mission(
        model=MODEL, map=problem.map, battery=ep.Battery.preset("quadriga"), start=(2, 2, 0),
        tasks=[ep.Task("near", (4, 4, 0)), ep.Task("too long", (3, 3, 0), dwell=1e6, power=500.0)],
        coefficient_spread=0.05,
    )  # fmt: skip
    cells = shown(ep.evaluate(mission)).cells
    assert cells[7:9] == ["too long", "unreachable"]
    assert cells[cells.index("near") + 1] == "reachable"


def test_what_goes_in_shows_itself_too(drives: list[ep.DriveLog]) -> None:
    evil = "<b>&"
    vehicle = dataclasses.replace(MODEL.vehicle, name=evil)
    model = dataclasses.replace(MODEL, vehicle=vehicle, name=evil)
    log = ep.DriveLog({**drives[0].channels, evil: drives[0].t}, name=evil)
    battery = dataclasses.replace(ep.Battery.preset("quadriga"), name=evil)
    hall = ep.OccupancyGrid(np.array([[True, False], [False, False]]), resolution=0.5)
    mission = ep.Mission(model=model, map=ep.OccupancyGrid(np.zeros((60, 60), bool), 0.1),
                         battery=battery, start=(2, 2, 0), tasks=[ep.Task(evil, (4, 4, 0))],
                         name=evil)  # fmt: skip
    cells = {}
    for thing in (vehicle, model, log, battery, hall, mission):
        page = shown(thing)
        assert "<b>&" not in thing._repr_html_().replace("<div><b>", "")
        assert len(thing._repr_html_()) < 4000
        cells[type(thing).__name__] = page.cells
    assert cells["Vehicle"][cells["Vehicle"].index("mass [kg]") + 1] == number(vehicle.mass)
    place = cells["OccupancyGrid"].index("occupied [%]")
    assert cells["OccupancyGrid"][place + 1] == "25"
    assert cells["OccupancyGrid"][cells["OccupancyGrid"].index("size [m]") + 1] == "1 x 1"
    known = cells["DriveLog"]
    assert known[known.index("v_left") + 3] == number(float(log.channel("v_left").max()))
    assert cells["Mission"][5:7] == [evil, "4, 4, 0"]
    assert number(MODEL.coefficient("slip_friction")) in cells["PowerModel"]
