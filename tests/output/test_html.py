"""What results show of themselves in a notebook, where they are printed, and on pages."""

from __future__ import annotations

import dataclasses
import math
import re
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

import energyplan as ep
from energyplan import PowerModel, __version__, simulate
from energyplan.errors import InvalidInputError
from energyplan.html import (
    Readable,
    Summary,
    chance,
    clock,
    column,
    listed,
    number,
    quantity,
    set_aside,
    share,
    spanned,
    unit,
)
from energyplan.output import plots
from energyplan.output.pages import Page
from energyplan.output.plots import svg
from energyplan.power import HOTEL

MODEL = PowerModel.preset("quadriga:full:concrete")


class Reader(HTMLParser):
    """Collects text, cells of tables and what would be loaded; refuses tags that are not closed."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.cells: list[str] = []
        self.links: list[str] = []
        self.text = ""
        self.feed(text)
        assert self.open == []

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        self.links += [value or "" for name, value in attributes if name in ("src", "href")]
        if tag not in ("meta", "img"):
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
    assert both[steady + 3] == "lower bound of energy as driven [J]"
    assert float(both[steady + 4]) <= float(both[place + 1])
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


# -- pages and numbers ---------------------------------------------------------------------------


def test_pages_load_nothing_and_text_from_files_cannot_become_markup() -> None:
    evil = "<script>alert(1)</script>"
    page = Page(evil)
    page.heading(evil)
    page.paragraph(evil, "flag")
    page.bullets([evil])
    page.table((evil, "value"), [(evil, 1.5)])
    page.command(evil)
    figure = plots.figure()
    figure.axes[0].plot([0, 1], [0, 1])
    page.picture(figure, "A line")
    assert "<script" not in page.html()
    read = Reader(page.html())
    assert read.text.count(evil) == 8
    assert len(read.links) == 1 and read.links[0].startswith("data:image/svg+xml;base64,")


def test_the_footer_says_what_made_the_page(tmp_path: Path) -> None:
    page = Page("Title")
    file = tmp_path / "a<b>.csv"
    file.write_bytes(b"abc")
    model = PowerModel.preset("quadriga:full:marble")
    page.made_from(call="energyplan <x>", files=[file], model=model)
    page.made_from(files=[file], model=model)
    text = Reader(page.html()).text
    assert text.count("energyplan <x>") == text.count("Model") == text.count("Vehicle") == 1
    assert f"energyplan {__version__}" in text
    assert text.count(f"{file} ") == 1
    # FIPS 180-2, appendix B.1
    known = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"
    assert f"SHA-256 {known}" in text
    assert "quadriga:full: 147.1 kg" in text
    with pytest.raises(InvalidInputError, match="checksum"):
        page.made_from(files=[tmp_path / "absent.csv"])


def test_the_date_of_a_page_can_be_given(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "86400")
    assert "1970-01-02 00:00 UTC" in Reader(Page("Title").html()).text
    for wrong in ("now", "1e99", "9" * 30):
        monkeypatch.setenv("SOURCE_DATE_EPOCH", wrong)
        with pytest.raises(InvalidInputError, match="SOURCE_DATE_EPOCH"):
            Page("Title").html()


def test_cells_of_wide_tables_carry_their_header() -> None:
    wide = Summary("", ("a", "b", "c", "d", "<e>"), [(1, 2, 3, 4, "x")]).html()
    assert wide.count("data-label=") == 5
    assert 'data-label="&lt;e&gt;"' in wide
    assert "data-label=" not in Summary("", ("a", "b"), [(1, 2)]).html()


def test_columns_of_numbers_stand_to_the_right_and_what_is_absent_is_told() -> None:
    rows = [("a 1", "1 to 2", "-", 1.5), ("b", "-", "-", 2)]
    made = Summary("", ("name", "span", "gone", "size"), rows).html()
    assert made.count('<th style="text-align:right">') == 2
    assert re.findall(r'<td class="([a-z ]+)"[^>]*>([^<]*)', made) == [
        ("number", "1 to 2"), ("none", "-"), ("number", "1.5"),
        ("number none", "-"), ("none", "-"), ("number", "2"),
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("value", "error", "symbol", "text"),
    [
        (144.1963, 2.794, "kg", "144.2 ± 2.8 kg"), (26161.0, 412.0, "J", "26161 ± 412 J"),
        (6.907e-4, 1.3e-5, "W/N^2", "0.000691 ± 0.000013 W/N²"), (0.5, 0.0, "1", "0.5"),
        (1.5e-12, 2e-13, "m", "1.5e-12 ± 2e-13 m"), (2.0, float("nan"), "m", "2 m"),
    ],
)  # fmt: skip
def test_an_error_decides_on_the_digits(value: float, error: float, symbol: str, text: str) -> None:
    assert quantity(value, error, symbol) == text


def test_numbers_that_are_compared_have_the_decimals_of_the_largest() -> None:
    assert column([23.41, 1.26, 9.4e-5]) == ["23", "1", "0"]
    assert column([0.0712, 0.0056, 1e-9]) == ["0.071", "0.006", "0.000"]
    assert column([1e3, -1e-12], 4) == ["1000", "0"]
    assert column([0.0]) == ["0"] and column([]) == []


def test_a_part_of_a_limit_that_is_printed_keeps_the_limit() -> None:
    parts = (2 / 3, 1.0, 0.99999, 2.5, 0.012345, 0.0)
    assert [share(one) for one in parts] == ["66.6 %", "100 %", "99.9 %", "250 %", "1.23 %", "0 %"]


def test_the_width_of_an_interval_decides_on_the_digits() -> None:
    assert spanned(12.3456, 11.9, 12.8) == "12.346 (11.900 to 12.800)"
    assert spanned(1234.56, 1000.0, 1400.0) == "1235 (1000 to 1400)"
    assert spanned(5.0, 4.0, 14.0) == "5.0 (4.0 to 14.0)"
    assert spanned(2.0, 2.0, 2.0) == "2 (2 to 2)"
    assert spanned(2.0, 1.0, math.inf) == "2 (1 to inf)"
    assert spanned(2.0, 2.0, 2.0 + 1e-6) == "2.00000000 (2.00000000 to 2.00000100)"


def test_of_many_names_the_rest_is_a_number() -> None:
    assert listed(["a", "b", "a", "c"]) == "a, b, c"
    assert listed(["a", "b", "c", "d"]) == "a, b and 2 more"
    counts = {"one": {"gap": 2, "spike": 1}, "two": {"gap": 3}}
    assert set_aside(counts) == [
        "set aside in one, two: 5 samples: gap", "set aside in one: 1 samples: spike",
    ]  # fmt: skip


def test_times_are_hours_minutes_and_seconds() -> None:
    seconds = (0.4, 59.6, 3599.4, 3600.0, 90061.0)
    assert [clock(s) for s in seconds] == ["0:00:00", "0:01:00", "0:59:59", "1:00:00", "25:01:01"]


def test_probabilities_and_large_numbers_have_the_digits_that_they_bear() -> None:
    chances = (0.0, 0.0099, 0.01, 0.5, 0.99, 0.991, 1.0)
    assert [chance(p) for p in chances] == [
        "below 0.01", "below 0.01", "0.01", "0.50", "0.99", "above 0.99", "above 0.99",
    ]  # fmt: skip
    assert [number(x) for x in (12345.6, -12345.6, 9.9994e8, 1e9, 1e-5)] == [
        "12346", "-12346", "999940000", "1e+09", "1e-05",
    ]  # fmt: skip


def test_units_are_printed_with_raised_powers() -> None:
    assert [unit(u) for u in ("m/s^2", "kg m^2", "m^-1", "1", "W")] == [
        "m/s²", "kg m²", "m⁻¹", "", "W",
    ]  # fmt: skip


def test_a_figure_is_the_same_bytes_twice() -> None:
    drawn = []
    for _ in range(2):
        figure = plots.figure()
        figure.axes[0].plot([0, 1], [0, 1], label="a")
        figure.axes[0].legend()
        drawn.append(svg(figure))
    assert drawn[0] == drawn[1]
