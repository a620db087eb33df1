"""Reports in a real browser: no error, nothing cut off on a phone, plots drawn, pictures printed.

The browser is Chromium of the distribution's packages, driven by its command line. Its window has
a least width that is more than a phone's, so the report is shown in a frame of a phone's width.
"""

from __future__ import annotations

import html
import json
import re
import shutil
import subprocess
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely

from energyplan import simulate
from energyplan.battery import Battery
from energyplan.cost import EnergyCost
from energyplan.diagnosis import diagnose
from energyplan.mission import Mission, MissionReport, Task, evaluate
from energyplan.output import pages as _pages
from energyplan.path import Pose
from energyplan.planning import PlanningProblem
from energyplan.power import HOTEL, PowerModel
from energyplan.studies.comparison import compare
from energyplan.terrain import OccupancyGrid, Surface, SurfaceMap

BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser"))), None)
PHONE, DESKTOP = 390, 1200
MODEL = PowerModel.preset("quadriga:full:marble")

pytestmark = pytest.mark.skipif(BROWSER is None, reason="no chromium on the PATH")

PROBE = """<script>
addEventListener("load", () => setTimeout(() => {
  const root = document.documentElement;
  const box = (e) => e.getBoundingClientRect();
  const kept = (e) => e.closest(".scroll");
  parent.postMessage({
    view: name, width: innerWidth, scroll: root.scrollWidth, height: root.scrollHeight,
    cut: [...document.body.querySelectorAll("*")].filter(
      (e) => !kept(e) && box(e).width > 0 && box(e).right > innerWidth + 1
    ).map((e) => e.outerHTML.slice(0, 80)),
    images: [...document.querySelectorAll("img")].filter((e) => box(e).width > 0).length,
    broken: [...document.querySelectorAll("img")].filter((e) => !e.naturalWidth).length,
  }, "*");
}, 300));
</script>"""
FRAME = """<!doctype html><html><head><title>-</title></head><body style="margin:0">
{frames}
<pre id="told"></pre><script>
const told = {{}};
addEventListener("message", (m) => {{
  told[m.data.view] = m.data;
  document.getElementById("told").textContent = JSON.stringify(told);
}});
</script></body></html>"""
VIEW = """<iframe style="border:0;position:absolute;top:0" name="{name}" width="{width}"
 height="844" src="{source}"></iframe>"""


def chromium(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run the browser on a profile of its own, without a network."""
    assert BROWSER is not None
    return subprocess.run(
        [
            BROWSER, "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic",
            "--no-first-run", "--disable-background-networking", "--disable-component-update",
            "--disable-sync", "--host-resolver-rules=MAP * ~NOTFOUND",
            f"--user-data-dir={folder / 'profile'}", "--enable-logging=stderr", "--v=0",
            *arguments,
        ],
        capture_output=True, text=True, timeout=60, check=True,
    )  # fmt: skip


def shown(views: Mapping[str, tuple[Path, int]], folder: Path) -> dict[str, dict[str, Any]]:
    """Show pages at widths, all of them at once.

    Returns what the probe of each view found, and the lines on the console that it is the source
    of.
    """
    frames = ""
    for name, (page, width) in views.items():
        probed = folder / f"{name}.html"
        probed.write_text(page.read_text().replace("</body>", PROBE + "</body>"))
        frames += VIEW.format(name=name, width=width, source=probed.as_uri())
    frame = folder / "frame.html"
    frame.write_text(FRAME.format(frames=frames))
    result = chromium(
        folder, "--window-size=1400,1000", "--virtual-time-budget=5000", "--dump-dom",
        frame.as_uri(),
    )  # fmt: skip
    found = re.search(r'<pre id="told">(.*?)</pre>', result.stdout, re.DOTALL)
    assert found is not None and found[1], f"no page told anything: {result.stderr[-2000:]}"
    told: dict[str, dict[str, Any]] = json.loads(html.unescape(found[1]))
    assert set(told) == set(views)
    lines = [line for line in result.stderr.splitlines() if "CONSOLE" in line]
    assert [line for line in lines if not any(f"{name}.html" in line for name in views)] == []
    return {
        name: {**told[name], "console": [line for line in lines if f"{name}.html" in line]}
        for name in views
    }


@pytest.fixture(scope="module")
def mission() -> MissionReport:
    hall = OccupancyGrid(np.zeros((100, 140), bool), 0.1)
    tasks = (
        Task("look at the gate of the hall", Pose(11.0, 5.0, 0.0), dwell=600.0, power=50.0),
        Task("wash all of it", Pose(3.0, 3.0, 0.0), dwell=1e6, power=500.0),
    )
    start, battery = Pose(1.0, 5.0, 0.0), Battery.preset("quadriga")
    return evaluate(
        Mission(MODEL, hall, battery, start, tasks, planning_effort=10_000, coefficient_spread=0.05)
    )


@pytest.fixture(scope="module")
def pages(
    mission: MissionReport, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[dict[str, Path]]:
    truth = MODEL.with_term(HOTEL, 40.0)
    train = simulate.identification_drive(truth, power_noise=5.0, seed=1)
    judge = [simulate.validation_drive(truth, power_noise=5.0, seed=2)]
    told = diagnose(train, holdout=judge, vehicle=MODEL.vehicle)
    wet = PowerModel.preset("quadriga:full:concrete")
    ground = SurfaceMap([Surface(shapely.box(2.5, 0, 4, 10), wet, "wet concrete")])
    occupied = np.zeros((100, 100), bool)
    occupied[30:60, 45:50] = True
    hall = OccupancyGrid(occupied, resolution=0.1)
    problem = PlanningProblem(hall, EnergyCost(MODEL), (2, 5, 0), (7, 6, 2.0), surfaces=ground)
    made = {
        "diagnosis": _pages.diagnosis_page(told, judge),
        "comparison": _pages.comparison_page(compare(problem, effort=10_000), problem),
        "mission": _pages.mission_page(mission),
    }
    folder = tmp_path_factory.mktemp("pages")
    files = {name: folder / f"{name}.html" for name in made}
    for name, page in made.items():
        files[name].write_text(page.html())
    yield files


def test_reports_are_sound_in_a_browser(pages: dict[str, Path], tmp_path: Path) -> None:
    wanted = {
        f"{name}-{width}": (page, width) for name, page in pages.items()
        for width in (PHONE, DESKTOP)
    }  # fmt: skip
    for view, told in shown(wanted, tmp_path).items():
        width = wanted[view][1]
        assert told["console"] == [], view
        assert told["width"] == width, view
        assert told["scroll"] <= width, (view, told["cut"])
        assert told["cut"] == [], view
        assert 844 < told["height"] < 6000, view
        pictures = 3 if view.startswith("comparison") else 2
        assert (told["images"], told["broken"]) == (pictures, 0), view


def test_the_probe_would_see_errors_and_overflow(tmp_path: Path) -> None:
    page = tmp_path / "written.html"
    page.write_text(
        "<!doctype html><html><body><p style='width:800px'>wide</p>"
        "<script>console.error('seen'); absent.field;</script></body></html>"
    )
    told = shown({"bad": (page, PHONE), "worse": (page, PHONE)}, tmp_path)
    for view in told.values():
        assert view["scroll"] > PHONE
        assert len(view["cut"]) == 1
        assert [re.search("seen|not defined", line)[0] for line in view["console"]] == [
            "seen", "not defined",
        ]  # fmt: skip


def test_print_takes_the_pictures(pages: dict[str, Path], tmp_path: Path) -> None:
    file = tmp_path / "mission.pdf"
    chromium(
        tmp_path, "--virtual-time-budget=3000", "--no-pdf-header-footer",
        f"--print-to-pdf={file}", pages["mission"].as_uri(),
    )  # fmt: skip
    data = file.read_bytes()
    widths = [int(w) for w in re.findall(rb"/Subtype /Image\s+/Width (\d+)", data)]
    pictures = pages["mission"].read_text().count("<img")
    assert pictures == 2
    # each is drawn in one part or several, at its full width
    assert len([w for w in widths if w > 700]) >= pictures
