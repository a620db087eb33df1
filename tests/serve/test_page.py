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
def served(folder: Path) -> Iterator[str]:
    """Serve a folder, and give the address of its page."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    command = ["-m", "energyplan", "serve", str(folder), "--port", str(port), "--no-token"]
    server = subprocess.Popen([sys.executable, *command])
    try:
        for _ in range(600):
            try:
                urllib.request.urlopen(f"http://127.0.0.1:{port}/api/health", timeout=5)
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


class Opened:
    """A page, with what went wrong on it and what it loaded from elsewhere."""

    def __init__(
        self, browser: Any, address: str, width: int, scheme: str = "light",
        surfaces: str | None = "warehouse_surfaces.geojson",
    ) -> None:  # fmt: skip
        self.page = browser.new_page(viewport={"width": width, "height": 850}, color_scheme=scheme)
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
        times = self.page.locator("#verdicts tr td:nth-child(2)").all_inner_texts()
        return [int(text.partition(":")[0]) + int(text.partition(":")[2]) / 60 for text in times]

    def robot(self) -> str:
        """Return how the disc of the robot is drawn, which says where it is."""
        return self.page.locator("path.robot").get_attribute("d")

    def route(self) -> str:
        """Place start and goal, and return the energy that is told."""
        self.click(0.25, 0.75)
        self.page.wait_for_selector("text=Now click where the goal is")
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


def test_tasks_get_verdicts_and_a_charge(browser: Any, address: str) -> None:
    opened = Opened(browser, address, 1300)
    opened.click(0.25, 0.75)
    opened.page.click("#tab-mission")
    opened.page.fill("input[name=pack]", "quadriga")
    opened.click(0.3, 0.22)
    opened.click(0.75, 0.72)
    opened.page.click("text=Will it last?")
    opened.page.wait_for_selector("#verdicts table, #status.bad", timeout=120_000)
    assert "tasks can be done" in opened.page.inner_text("#status")
    assert opened.page.locator("#verdicts tr").count() == 4
    hours = opened.hours()
    assert hours == sorted(hours)
    names = opened.page.locator("#verdicts tr td:nth-child(1)").all_inner_texts()
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
    assert "hall: out of reach; the battery does not last. With the way back to " in before
    assert "Wh more than there is above the reserve. Remedy: " in before
    assert re.search(r"\d J|no_path|out of reach: ", before) is None
    names = page.locator("#verdicts tr td:nth-child(1)").all_inner_texts()
    hours = opened.hours()
    assert hours == sorted(hours) and names[-1] == "end, at start" and {"pump", "meter"} < {*names}
    assert hours[0] >= 1.0  # on the clock of the mission, which begins at one
    assert page.locator("#verdicts tr:last-child td:nth-child(4)").inner_text() == "–"  # no energy
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
        names = page.locator("#verdicts tr td:nth-child(1)").all_inner_texts()
        assert {name.partition(":")[0] for name in names} == {"alpha", "beta", "gamma"}
        assert {"alpha: end, at start", "gamma: scan the far shelf"} < {*names}
        assert re.search(
            r"alpha takes [\d.]+ Wh, beta .* Wh\. The whole", page.inner_text("#verdicts")
        )
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
