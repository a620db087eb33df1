"""The page in a real browser: clicks, keys, a phone's width; no error, nothing from elsewhere."""

from __future__ import annotations

import json
import re
import shutil
import socket
import subprocess
import sys
import time
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd
import pytest
import yaml

import energyplan as ep
from energyplan import simulate
from energyplan.power import HOTEL

ROOT = Path(__file__).resolve().parents[2]
pytest.importorskip("fastapi", reason="the service needs the extra serve")


@contextmanager
def served(folder: Path, *options: str) -> Iterator[str]:
    """Serve a folder, and give the address of its page."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    options = options or ("--no-token",)
    command = ["-m", "energyplan", "serve", str(folder), "--port", str(port), *options]
    server = subprocess.Popen([sys.executable, *command])
    try:
        for _ in range(600):
            try:
                urllib.request.urlopen(f"http://127.0.0.1:{port}/health", timeout=5)
                break
            except OSError:
                assert server.poll() is None, "the service ended"
                time.sleep(0.1)
        yield f"http://127.0.0.1:{port}/"
    finally:
        server.terminate()
        server.wait(30)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("data")
    for file in (ROOT / "maps").glob("warehouse*"):
        shutil.copy(file, made)
    model = ep.PowerModel.preset("quadriga:full:concrete")
    ep.write_model(model.with_term(HOTEL, 40.0), made / "hotel.yaml")
    return made


@pytest.fixture(scope="module")
def address(folder: Path) -> Iterator[str]:
    with served(folder) as at:
        yield at


ROUND = """\
model: ours.yaml
map: office.yaml
battery: 24 V 20 Ah lead-acid
coefficient_spread: 5 %
order: free
return_to: start
planning_effort: 1000
start: [1.2, 2.0, 90deg]
time: 1 h
places: {door: [3.9, 2.0, 90deg]}
chargers: [{name: dock, pose: [1.2, 2.0, 90deg], power: 100 W}]
tasks:
  - {name: pump, pose: door, dwell: {mean: 20 min, std: 1 min}, power: 60 W, window: [0, 3 h]}
  - {name: meter, pose: [3.9, 5.0, 90deg], dwell: 5 min, power: 30 W}
  - {name: hall, pose: [6, 2, 0], dwell: 4 h, power: 200 W, required: false}
"""


@pytest.fixture(scope="module")
def prepared(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """The address of a folder with a mission of a robot of one's own, not at its top."""
    top = tmp_path_factory.mktemp("prepared")
    (top / "north").mkdir()
    for file in ("office.yaml", "office.png"):
        shutil.copy(ROOT / "maps" / file, top / "north")
    model = replace(ep.PowerModel.preset("husky_a200:flooring"), name="ours")
    ep.write_model(model, top / "north" / "ours.yaml")
    (top / "north" / "round.yaml").write_text(ROUND)
    with served(top) as at:
        yield at


DONE = "#verdicts tr:not(.total)"
"""Rows of what is done, without those of totals."""


class Opened:
    """A page, with what went wrong on it and what it loaded from elsewhere."""

    def __init__(
        self, browser: Any, address: str, width: int, scheme: str = "light",
        surfaces: str | None = "warehouse_surfaces.geojson", locale: str = "en-GB",
    ) -> None:  # fmt: skip
        size = {"width": width, "height": 850}
        self.page = browser.new_page(viewport=size, color_scheme=scheme, locale=locale)
        self.errors: list[str] = []
        self.elsewhere: list[str] = []
        self.page.on("pageerror", lambda error: self.errors.append(str(error)))
        self.page.on(
            "console",
            lambda told: self.errors.append(told.text) if told.type == "error" else None,
        )
        self.page.on(
            "request",
            lambda asked: (
                None
                if asked.url.startswith((address, "data:"))
                else self.elsewhere.append(asked.url)
            ),
        )
        self.page.goto(address)
        self.page.wait_for_selector(".walls")
        if surfaces is None:
            return
        self.page.select_option("select[name=surfaces]", surfaces)
        self.page.wait_for_selector(".leaflet-overlay-pane path")
        self.box = self.page.locator("#map").bounding_box()

    def click(self, across: float, down: float) -> None:
        self.page.mouse.click(
            self.box["x"] + self.box["width"] * across, self.box["y"] + self.box["height"] * down
        )

    def hours(self) -> list[float]:
        """Return when what was done began, and when the mission ended."""
        times = self.page.locator(f"{DONE} td:nth-child(2)").all_inner_texts()
        return [int(text.partition(":")[0]) + int(text.partition(":")[2]) / 60 for text in times]

    def robot(self) -> str:
        """Return how the disc of the robot is drawn, which says where it is."""
        return self.page.locator("path.robot").get_attribute("d")

    def ring(self, name: str) -> Any:
        """Return the handle by which a pose is turned."""
        return self.page.locator(f"[data-hint=heading_of][data-name='{name}']")

    def route(self) -> str:
        """Place start and goal, and return the energy that is told."""
        self.click(0.25, 0.75)
        self.page.wait_for_selector(".pin")
        self.click(0.72, 0.42)
        self.page.wait_for_selector("#answer table", timeout=120_000)
        return self.page.inner_text("#answer .big")


@pytest.mark.parametrize(
    ("width", "scheme"),
    [pytest.param(1300, "light", marks=pytest.mark.nightly), (390, "dark")],
)
def test_two_clicks_make_a_route(browser: Any, address: str, width: int, scheme: str) -> None:
    opened = Opened(browser, address, width, scheme)
    # the folder's own model: at rest it draws power, too
    assert opened.page.input_value("input[name=model]") == "hotel.yaml"
    told = opened.route()
    assert told.endswith(" Wh")
    rows = opened.page.inner_text("#answer table")
    assert "slip friction" in rows
    assert "no route takes less than" in rows
    # the saving is what the two energies beside it give, and their parts add up
    driven = re.search(r"energy as driven, with its stops\s+([\d.]+) Wh\s+([\d.]+) Wh", rows)
    assert driven is not None and told == f"{driven[1]} Wh"
    least, most = map(float, driven.groups())
    said = re.search(r"saves ([\d.]+) %", opened.page.inner_text("#answer p"))
    assert said is not None
    assert float(said[1]) == pytest.approx(100 * (1 - least / most), abs=0.1)
    parts = re.findall(r"^[a-z ]+\t([-\d.]+) Wh\t", rows.partition("energy as")[0], re.M)
    assert sum(map(float, parts)) == pytest.approx(least, abs=3e-3)
    assert opened.page.evaluate("document.documentElement.scrollWidth") <= width
    assert (opened.errors, opened.elsewhere) == ([], [])


def test_a_change_plans_again_and_a_wrong_one_is_said_in_words(browser: Any, address: str) -> None:
    opened = Opened(browser, address, 1300)
    before = opened.route()
    opened.page.locator("[title=S].leaflet-marker-icon").focus()
    opened.page.keyboard.press("Shift+ArrowLeft")  # plans again
    # no script of the test's own: the page's policy forbids it
    opened.page.locator("#answer .big").filter(has_not_text=before).wait_for(timeout=120_000)
    opened.page.fill("input[name=model]", "no:such:model")
    opened.page.keyboard.press("Enter")
    opened.page.wait_for_selector("#status.bad")
    assert "no:such:model" in opened.page.inner_text("#status")


def lightly(route: Any) -> None:
    """Let a mission go on with little effort for its routes."""
    asked = route.request.post_data_json
    asked["document"]["planning_effort"] = 1000
    route.continue_(post_data=json.dumps(asked))


def test_tasks_get_verdicts_and_a_charge(browser: Any, address: str) -> None:
    opened = Opened(browser, address, 1300)
    opened.page.route("**/api/mission", lightly)
    opened.click(0.25, 0.75)
    opened.page.click("#tab-mission")
    opened.page.fill("input[name=pack]", "quadriga")
    opened.click(0.3, 0.22)
    opened.click(0.75, 0.72)
    opened.page.click("text=Will it last?")
    opened.page.wait_for_selector("#verdicts table, #status.bad", timeout=120_000)
    assert "tasks can be done" in opened.page.inner_text("#status")
    assert opened.page.locator(DONE).count() == 4
    hours = opened.hours()
    assert hours == sorted(hours)
    names = opened.page.locator(f"{DONE} td:nth-child(1)").all_inner_texts()
    assert names == [
        "task 2",
        "task 1",
        "end, at start",
    ]  # not in the order in which they were placed
    assert opened.page.locator("#charge canvas").count() == 1
    drawn = opened.page.locator(".leaflet-overlay-pane path[stroke='#0072b2']")
    assert drawn.count() >= 3  # out, between and back
    at = [opened.robot()]
    for key in ("End", "Home"):
        opened.page.locator("[aria-label='time of the mission']").press(key)
        at.append(opened.robot())
    assert at[0] == at[1] == at[2]  # it ends where it began
    opened.page.locator("[aria-label='time of the mission']").press("PageUp")
    assert opened.robot() != at[0]
    opened.page.locator("[title='1'].leaflet-marker-icon").focus()
    opened.page.keyboard.press("ArrowLeft")
    assert opened.page.locator("#verdicts.stale").count() == 1
    assert "ask again" in opened.page.inner_text("#status")
    assert drawn.count() == 0
    assert opened.errors == []


def test_a_wall_is_refused_and_a_mission_is_kept(browser: Any, folder: Path, address: str) -> None:
    opened = Opened(browser, address, 1300)
    opened.click(0.002, 0.5)
    assert "There is a wall" in opened.page.inner_text("#status")
    assert opened.page.locator(".pin").count() == 0
    opened.click(0.25, 0.75)
    opened.page.click("#tab-mission")
    opened.page.fill("input[name=pack]", "48 V 30 Ah LiFePO4, -5 degC")
    opened.click(0.3, 0.22)
    opened.page.on("dialog", lambda dialog: dialog.accept("night round"))
    opened.page.click("text=Save as mission")
    opened.page.wait_for_selector("#status:has-text('Kept as')")
    kept = folder / "night round.yaml"
    try:
        assert opened.page.input_value("[name=file]") == kept.name
        mission = ep.read_mission(kept)
        assert [task.name for task in mission.tasks] == ["task 1"]
        assert opened.page.input_value("[name=pack]") == "48 V 30 Ah LiFePO4, -5 degC"
    finally:
        kept.unlink(missing_ok=True)
    assert opened.errors == []


@pytest.mark.parametrize("width", [1300, pytest.param(390, marks=pytest.mark.nightly)])
def test_the_mission_that_was_prepared_is_opened_changed_and_answered(
    browser: Any, prepared: str, width: int
) -> None:
    opened = Opened(browser, prepared, width, surfaces=None)
    page, sent = opened.page, list[Any]()
    page.on("request", lambda one: sent.append(one.post_data_json) if one.post_data else None)
    page.wait_for_selector("#tasks tr")
    shown = {key: page.input_value(f"[name={key}]") for key in ("map", "model", "pack", "file")}
    assert shown == {
        "map": "north/office.yaml", "model": "north/ours.yaml", "pack": "24 V 20 Ah lead-acid",
        "file": "north/round.yaml",
    }  # fmt: skip
    rows = [
        [one.input_value() for one in row.locator("input[type=number]").all()]
        for row in page.locator("#tasks tr:has(td)").all()
    ]
    assert rows == [["20", "60", "", "180"], ["5", "30", "", ""], ["240", "200", "", ""]]
    page.click("text=Will it last?")
    page.wait_for_selector("#verdicts table", timeout=120_000)
    as_it_is = yaml.safe_load(ROUND)
    assert sent.pop() == {"mission": "north/round.yaml", "document": as_it_is}
    before = page.inner_text("#verdicts")
    assert "hall: out of reach; the battery does not last. With the way back it takes " in before
    assert "Wh more than there is above the reserve. Remedy: " in before
    assert re.search(r"\d J|no_path|out of reach: ", before) is None
    names = page.locator(f"{DONE} td:nth-child(1)").all_inner_texts()
    hours = opened.hours()
    assert hours == sorted(hours) and names[-1] == "end, at start" and {"pump", "meter"} < {*names}
    assert hours[0] >= 1.0  # on the clock of the mission, which begins at one
    assert page.locator(f"{DONE} td:nth-child(4)").last.inner_text() == "–"  # no energy
    page.locator("[title='2'].leaflet-marker-icon").focus()
    page.keyboard.press("Shift+ArrowUp")
    assert page.locator("#verdicts.stale").count() == 1
    page.fill("[aria-label='watts of pump']", "120")
    page.fill("[aria-label='minutes of hall']", "1")
    page.click("text=Will it last?")
    page.wait_for_selector("#verdicts:not(.stale) table", timeout=120_000)
    assert "All 3 tasks can be done" in page.inner_text("#status")
    changed = sent.pop()["document"]
    moved = changed["tasks"][1].pop("pose")
    assert moved == pytest.approx([3.9, 5.5, 1.5708], abs=1e-4)
    as_it_is["tasks"][0]["power"], as_it_is["tasks"][2]["dwell"] = 120, 60
    del as_it_is["tasks"][1]["pose"]
    assert changed == as_it_is  # what was not touched stands as the file says it
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    assert (opened.errors, opened.elsewhere) == ([], [])


def test_a_mission_of_several_robots_is_opened_changed_and_answered(
    browser: Any, tmp_path: Path
) -> None:
    for file in (ROOT / "maps").glob("warehouse*"):
        shutil.copy(file, tmp_path)
    fleet = (ROOT / "examples" / "fleet_warehouse.yaml").read_text()
    (tmp_path / "fleet.yaml").write_text(fleet.replace("effort: 3000", "effort: 100"))
    with served(tmp_path) as at:
        opened = Opened(browser, at, 390, surfaces=None)
        page, sent = opened.page, list[Any]()
        page.on("request", lambda one: sent.append(one.post_data_json) if one.post_data else None)
        page.wait_for_selector("#tasks tr")
        assert page.locator(".pin:text('S')").count() == 3
        page.locator("[title='S2'].leaflet-marker-icon").focus()
        page.keyboard.press("ArrowLeft")
        page.click("text=Will it last?")
        page.wait_for_selector("#verdicts table", timeout=120_000)
        assert "All 4 tasks can be done" in page.inner_text("#status")
        asked, plain = sent.pop()["document"], yaml.safe_load(fleet)
        assert asked["robots"][1].pop("start")[:2] == pytest.approx([2.4, 8.0])
        del plain["robots"][1]["start"]
        assert asked["robots"] == plain["robots"] and "start" not in asked
        names = page.locator(f"{DONE} td:nth-child(1)").all_inner_texts()
        assert {name.partition(":")[0] for name in names} == {"alpha", "beta", "gamma"}
        assert {"alpha: end, at start", "gamma: scan the far shelf"} < {*names}
        totals = page.locator("#verdicts tr.total").all_inner_texts()
        assert [one.split("\t")[0] for one in totals] == [
            "alpha: total", "beta: total", "gamma: total", "total",
            "total, at the confidence asked for",
        ]  # fmt: skip
        shown = [one.split("\t")[-2].removesuffix(" Wh") for one in totals]
        energies = [float(one) for one in shown]
        rounding = sum(0.5 * 10.0 ** -len(one.partition(".")[2]) for one in shown[:4])
        assert sum(energies[:3]) == pytest.approx(energies[3], abs=rounding)
        assert energies[3] < energies[4]
        hours = opened.hours()
        assert hours == sorted(hours)
        tints = {one.get_attribute("stroke") for one in page.locator("path[fill=none]").all()}
        assert {"#0072b2", "#009e73"} <= tints  # each robot has its own
        assert page.locator("#charge .u-legend tr").count() == 8  # with the reserve
        assert page.evaluate(
            "Math.max(...[...document.querySelectorAll('table')].map("
            "(one) => one.getBoundingClientRect().right))"
        ) <= 390  # fmt: skip
        assert (opened.errors, opened.elsewhere) == ([], [])


def test_it_begins_without_a_mouse(browser: Any, address: str) -> None:
    opened = Opened(browser, address, 1300)
    opened.page.locator("#map").focus()
    opened.page.keyboard.press("Enter")
    assert opened.page.locator("[title=S].leaflet-marker-icon").count() == 1
    assert opened.page.locator(".leaflet-control-scale-line").count() == 1
    assert opened.page.locator("#legend .tint").count() > 2


def test_a_log_is_read_for_the_robot_that_is_named_and_its_model_used(
    browser: Any, address: str, folder: Path, tmp_path: Path
) -> None:
    log = simulate.identification_drive(ep.PowerModel.preset("quadriga:full:concrete"), seed=1)
    made = {"stamp": log.t, "left_speed": log.channel("v_left"), "power_W": log.power,
            "right_speed": log.channel("v_right"), "gyro_z": log.channel("yaw_rate")}  # fmt: skip
    pd.DataFrame(made).to_csv(tmp_path / "own.csv", index=False)
    opened = Opened(browser, address, 1300)
    opened.page.click("#tab-logs")
    choose = opened.page.locator("#drop input")
    choose.set_input_files(tmp_path / "own.csv")
    opened.page.wait_for_selector("text=Which robot is this?")
    for key, value in (("track", "0.5"), ("wheelbase", "0.475"), ("mass", "147")):
        opened.page.fill(f"#drives input[name={key}]", value)
    opened.page.keyboard.press("Tab")  # the log that was sent is read again
    opened.page.wait_for_selector("#found h2:has-text('Identified')", timeout=120_000)
    assert "left_speed [m/s]" in opened.page.inner_text("#found")
    assert len([*folder.glob("logs/*-own.csv")]) == 1
    opened.page.click("text=Keep this model and use it")
    opened.page.wait_for_selector("text=Download it")
    (kept,) = folder.glob("models/*.yaml")
    assert opened.page.input_value("input[name=model]") == f"models/{kept.name}"
    with opened.page.expect_download() as loaded:
        opened.page.click("text=Download it")
    model = ep.read_model(kept)
    assert Path(loaded.value.path()).read_text() == kept.read_text()
    assert model.coefficient("slip_friction") == pytest.approx(0.647, rel=0.05)
    opened.page.click("#tab-route")
    assert opened.route().endswith(" Wh")
    assert opened.errors == []


@pytest.mark.nightly
def test_places_in_reach_are_drawn(browser: Any, address: str) -> None:
    opened = Opened(browser, address, 390)
    before = opened.page.locator(".leaflet-overlay-pane path").count()
    opened.click(0.25, 0.75)
    opened.page.click("#tab-mission")
    opened.page.fill("input[name=pack]", "24 V 22 Ah lead-acid")
    opened.page.fill("input[name=soc]", "21")
    opened.page.click("#tab-route")
    opened.page.click("text=How far on this charge?")
    opened.page.wait_for_selector("#answer table, #status.bad", timeout=120_000)
    assert opened.page.locator(".energy").count() >= 5
    assert "are in reach, and back, with 95 % confidence" in opened.page.inner_text("#status")
    assert opened.page.locator(".leaflet-overlay-pane path").count() > before
    assert opened.page.evaluate("document.documentElement.scrollWidth") <= 390
    assert opened.errors == []


def test_paths_are_drawn_as_lines_and_asked_for_as_they_are(browser: Any, tmp_path: Path) -> None:
    """Those of a file of lines stand in the document that is sent as tasks of their own."""
    for file in ("office.yaml", "office.png"):
        shutil.copy(ROOT / "maps" / file, tmp_path)
    lines = [([[1.2, 2.5], [1.2, 4.5]], {"name": "west", "power": 30}),
             ([[3.9, 4.5], [3.9, 2.5]], {"direction": "given", "speed": 0.3})]  # fmt: skip
    features = [
        {"type": "Feature", "properties": keys,
         "geometry": {"type": "LineString", "coordinates": points}}
        for points, keys in lines
    ]  # fmt: skip
    collection = {"type": "FeatureCollection", "features": features}
    (tmp_path / "rows.geojson").write_text(json.dumps(collection))
    head = ROUND.partition("places:")[0].replace("ours.yaml", "husky_a200:flooring")
    (tmp_path / "round.yaml").write_text(head + "tasks: rows.geojson\n")
    with served(tmp_path) as address:
        opened = Opened(browser, address, 1300, surfaces=None)
        page, sent = opened.page, list[Any]()
        page.on("request", lambda one: sent.append(one.post_data_json) if one.post_data else None)
        page.wait_for_selector("#tasks tr")
        assert page.locator("path.row").count() == 2
        assert page.locator("[aria-label='minutes of west']").is_disabled()
        page.click("text=Will it last?")
        page.wait_for_selector("#verdicts table", timeout=120_000)
        assert "All 2 tasks can be done" in page.inner_text("#status")
        west, other = sent.pop()["document"]["tasks"]
        assert west["path"] == [[1.2, 2.5], [1.2, 4.5]] and west["power"] == 30
        assert (other["direction"], other["speed"]) == ("given", 0.3)
        assert (opened.errors, opened.elsewhere) == ([], [])


PAGE = ROOT / "energyplan" / "serve" / "page"
TEXTS = {file.stem: json.loads(file.read_text("utf-8")) for file in PAGE.glob("texts/*.json")}


def test_a_click_is_a_place_and_its_ring_gives_a_heading(browser: Any, address: str) -> None:
    opened = Opened(browser, address, 1300)
    page, sent = opened.page, list[Any]()
    page.on("request", lambda one: sent.append(one.post_data_json) if one.post_data else None)
    free = float(opened.route().removesuffix(" Wh"))
    assert len(sent.pop()["goal"]) == 2
    assert "arrives at the heading" in page.inner_text("#answer table")
    assert page.locator(".arrow.free").count() == 1  # that of the start is given

    def planned(action: Any) -> Any:
        with page.expect_response("**/api/compare"):
            action()
        page.wait_for_selector("#answer table")
        return sent[-1]["goal"]

    box = opened.ring("G").bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    pin = page.locator("[title=G].leaflet-marker-icon").bounding_box()
    end = pin["x"] + pin["width"] / 2, pin["y"] - 30  # across the way, so that it has to turn

    def drag() -> None:
        page.mouse.move(x, y)
        page.mouse.down()
        page.mouse.move(*end, steps=4)
        page.mouse.up()

    *_, yaw = planned(drag)
    assert yaw == pytest.approx(1.57, abs=0.2)
    page.wait_for_selector("#answer table:not(:has-text('arrives'))")
    assert page.locator(".arrow.free").count() == 0
    assert float(page.inner_text("#answer .big").removesuffix(" Wh")) > free
    assert len(planned(opened.ring("G").click)) == 2
    page.locator("[title=G].leaflet-marker-icon").focus()
    assert len(planned(lambda: page.keyboard.press("q"))) == 3
    assert len(planned(lambda: page.keyboard.press("f"))) == 2
    assert opened.errors == []


def test_an_address_without_its_token_is_explained(browser: Any, folder: Path) -> None:
    """What the service says of it is for programs."""
    with served(folder, "--token", "secret") as at:
        page = browser.new_page()
        page.goto(at)
        page.wait_for_selector("#status:not(:empty)")
        assert page.inner_text("#status") == TEXTS["en"]["no_token"]
        page.goto(f"{at}#token=secret")
        page.reload()
        page.wait_for_selector("select[name=map] option", state="attached")
        page.close()


def test_the_page_speaks_the_browsers_language_and_the_one_that_is_chosen(
    browser: Any, prepared: str
) -> None:
    """What stands on it is of that language alone, before and after the other one is chosen."""
    opened = Opened(browser, prepared, 1300, surfaces=None, locale="de-DE")
    page = opened.page
    page.wait_for_selector("#tasks tr")
    page.click("text=Reicht der Akku?")
    page.wait_for_selector("#verdicts table", timeout=120_000)
    for name, other in (("de", "en"), ("en", "de")):
        page.select_option("#language", name)
        page.wait_for_selector(f"html[lang={name}]")
        shown = page.inner_text("body")
        mine, foreign = TEXTS[name], TEXTS[other]
        for key in ("will_it_last", "col_what", "total", "reason.battery", "mission_hint"):
            assert mine[key] in shown and foreign[key] not in shown
        labels = page.evaluate(
            "[...document.querySelectorAll('[aria-label]')].map(e => e.ariaLabel)"
        )
        assert mine["minutes_of"].format(name="pump") in labels
    page.click("#explain")
    assert page.locator("#glossary dd").first.is_visible()
    assert page.locator("#glossary dt").all_inner_texts() == [
        term for term, _ in TEXTS["en"]["terms"]
    ]
    page.reload()
    page.wait_for_selector("html[lang=en]")  # what was chosen is kept
    assert opened.errors == []
