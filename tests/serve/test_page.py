"""The page in a real browser: clicks, keys, a phone's width; no error, nothing from elsewhere."""

from __future__ import annotations

import re
import shutil
import socket
import subprocess
import sys
import time
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

import energyplan as ep
from energyplan import simulate
from energyplan.power import HOTEL

ROOT = Path(__file__).resolve().parents[2]
pytest.importorskip("fastapi", reason="the service needs the extra serve")


@pytest.fixture(scope="module")
def address(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    folder = tmp_path_factory.mktemp("data")
    for file in (ROOT / "maps").glob("warehouse*"):
        shutil.copy(file, folder)
    model = ep.PowerModel.preset("quadriga:full:concrete")
    ep.write_model(model.with_term(HOTEL, 40.0), folder / "hotel.yaml")
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    server = subprocess.Popen(
        [
            sys.executable,
            "-m",
            "energyplan",
            "serve",
            str(folder),
            "--port",
            str(port),
            "--no-token",
        ]
    )
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


class Opened:
    """A page, with what went wrong on it and what it loaded from elsewhere."""

    def __init__(self, browser: Any, address: str, width: int, scheme: str = "light") -> None:
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
        surfaces = self.page.locator("select[name=surfaces]")
        surfaces.select_option("warehouse_surfaces.geojson")
        self.page.wait_for_selector(".leaflet-overlay-pane path")
        self.box = self.page.locator("#map").bounding_box()

    def click(self, across: float, down: float) -> None:
        self.page.mouse.click(
            self.box["x"] + self.box["width"] * across, self.box["y"] + self.box["height"] * down
        )

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
    opened.page.fill("input[name=model]", "hotel.yaml")  # at rest it draws power, too
    told = opened.route()
    assert told.endswith(" J")
    rows = opened.page.inner_text("#answer table")
    assert "slip friction" in rows
    assert "no route takes less than" in rows
    # the saving is what the two energies beside it give, and their parts add up
    driven = re.search(r"energy as driven, with its stops\s+([\d,]+) J\s+([\d,]+) J", rows)
    assert driven is not None and told == f"{driven[1]} J"
    least, most = (float(text.replace(",", "")) for text in driven.groups())
    said = re.search(r"saves ([\d.]+) %", opened.page.inner_text("#answer p"))
    assert said is not None
    assert float(said[1]) == pytest.approx(100 * (1 - least / most), abs=0.1)
    parts = re.findall(r"^[a-z ]+\t([-\d,]+) J\t", rows.partition("energy as")[0], re.M)
    assert sum(float(part.replace(",", "")) for part in parts) == pytest.approx(least, abs=3)
    assert opened.page.evaluate("document.documentElement.scrollWidth") <= width
    assert (opened.errors, opened.elsewhere) == ([], [])


@pytest.mark.nightly
def test_a_key_moves_a_pose_and_plans_again(browser: Any, address: str) -> None:
    opened = Opened(browser, address, 1300)
    before = opened.route()
    opened.page.locator("[title=S].leaflet-marker-icon").focus()
    opened.page.keyboard.press("Shift+ArrowLeft")
    opened.page.wait_for_function(
        "before => document.querySelector('#answer .big')?.textContent !== before", arg=before
    )
    assert opened.errors == []


def test_a_pose_in_a_wall_is_told_in_words(browser: Any, address: str) -> None:
    opened = Opened(browser, address, 1300)
    opened.route()
    opened.page.fill("input[name=model]", "no:such:model")
    opened.page.keyboard.press("Enter")
    opened.page.wait_for_selector("#status.bad")
    assert "no:such:model" in opened.page.inner_text("#status")


def test_tasks_get_verdicts_and_a_charge(browser: Any, address: str) -> None:
    opened = Opened(browser, address, 1300)
    opened.click(0.25, 0.75)
    opened.page.click("#tab-mission")
    opened.click(0.3, 0.22)
    opened.click(0.75, 0.72)
    opened.page.click("text=Will it last?")
    opened.page.wait_for_selector("#verdicts table, #status.bad", timeout=120_000)
    assert "tasks can be done" in opened.page.inner_text("#status")
    assert opened.page.locator("#verdicts tr").count() == 3
    times = opened.page.locator("#verdicts tr td:nth-child(3)").all_inner_texts()
    hours = [int(text.partition(":")[0]) + int(text.partition(":")[2]) / 60 for text in times]
    assert hours == sorted(hours)
    names = opened.page.locator("#verdicts tr td:nth-child(1)").all_inner_texts()
    assert names == ["task 2", "task 1"]  # not in the order in which they were placed
    assert opened.page.locator("#charge canvas").count() == 1
    drawn = opened.page.locator(".leaflet-overlay-pane path[stroke='#0072b2']")
    assert drawn.count() >= 3  # out, between and back
    opened.page.locator("[title='1'].leaflet-marker-icon").focus()
    opened.page.keyboard.press("ArrowLeft")
    assert opened.page.locator("#verdicts.stale").count() == 1
    assert "ask again" in opened.page.inner_text("#status")
    assert drawn.count() == 0
    assert opened.errors == []


def test_it_begins_without_a_mouse(browser: Any, address: str) -> None:
    opened = Opened(browser, address, 1300)
    opened.page.locator("#map").focus()
    opened.page.keyboard.press("Enter")
    assert opened.page.locator("[title=S].leaflet-marker-icon").count() == 1
    assert opened.page.locator(".leaflet-control-scale-line").count() == 1
    assert opened.page.locator("#legend .tint").count() > 2


def test_a_log_is_read_for_the_robot_that_is_named(
    browser: Any, address: str, tmp_path: Path
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
    choose.set_input_files([])
    choose.set_input_files(tmp_path / "own.csv")
    opened.page.wait_for_selector("#found h2:has-text('Identified')", timeout=120_000)
    assert "left_speed [m/s]" in opened.page.inner_text("#found")
    assert opened.errors == []


@pytest.mark.nightly
def test_places_in_reach_are_drawn(browser: Any, address: str) -> None:
    opened = Opened(browser, address, 390)
    before = opened.page.locator(".leaflet-overlay-pane path").count()
    opened.click(0.25, 0.75)
    opened.page.click("#tab-mission")
    opened.page.fill("input[name=soc]", "21")
    opened.page.click("#tab-route")
    opened.page.click("text=How far on this charge?")
    opened.page.wait_for_selector("#answer table, #status.bad", timeout=120_000)
    assert opened.page.locator(".energy").count() >= 5
    assert "are in reach, and back, with 95 % confidence" in opened.page.inner_text("#status")
    assert opened.page.locator(".leaflet-overlay-pane path").count() > before
    assert opened.page.evaluate("document.documentElement.scrollWidth") <= 390
    assert opened.errors == []
