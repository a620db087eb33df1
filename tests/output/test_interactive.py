"""Plots of the reports: sound by plotly's own check, true to the results that they show."""

from __future__ import annotations

import base64
import importlib.util
import io
import re
from dataclasses import replace

import numpy as np
import pytest
import shapely
from PIL import Image

from energyplan import simulate
from energyplan.battery import Battery
from energyplan.cost import EnergyCost
from energyplan.diagnosis import Diagnosis, diagnose
from energyplan.logs import DriveLog
from energyplan.mission import Mission, MissionReport, Task, evaluate
from energyplan.output import interactive, pages
from energyplan.output.interactive.map import map_plot
from energyplan.output.interactive.parts import MOST_POINTS, Plot, thin
from energyplan.output.report import Page
from energyplan.path import Pose
from energyplan.planning import PlanningProblem
from energyplan.power import HOTEL, PowerModel
from energyplan.studies.comparison import Comparison, compare
from energyplan.terrain import OccupancyGrid, Surface, SurfaceMap

MODEL = PowerModel.preset("quadriga:full:marble")
EVIL = "</script><b>x"
pytest.importorskip("plotly", reason="plotly draws the plots")


@pytest.fixture(scope="module")
def diagnosis() -> tuple[Diagnosis, list[DriveLog]]:
    truth = MODEL.with_term(HOTEL, 40.0)
    train = simulate.identification_drive(truth, power_noise=5.0, seed=1)
    judge = [simulate.validation_drive(truth, power_noise=5.0, seed=2)]
    return diagnose(train, holdout=judge, vehicle=MODEL.vehicle), judge


@pytest.fixture(scope="module")
def comparison() -> tuple[Comparison, PlanningProblem]:
    wet = PowerModel.preset("quadriga:full:concrete")
    ground = SurfaceMap([Surface(shapely.box(2.5, 0, 4, 10), wet, EVIL)])
    hall = OccupancyGrid(np.zeros((100, 100), bool), resolution=0.1)
    problem = PlanningProblem(hall, EnergyCost(MODEL), (2, 5, 0), (7, 6, 2.0), surfaces=ground)
    return compare(problem, time_limit=0.2), problem


@pytest.fixture(scope="module")
def mission() -> MissionReport:
    hall = OccupancyGrid(np.zeros((100, 140), bool), 0.1)
    tasks = (
        Task("look at the gate", Pose(11.0, 5.0, 0.0), dwell=600.0, power=50.0),
        Task(EVIL, Pose(3.0, 3.0, 0.0), dwell=1e6, power=500.0),
    )
    start, battery = Pose(1.0, 5.0, 0.0), Battery.preset("quadriga")
    return evaluate(
        Mission(MODEL, hall, battery, start, tasks, planning_time=0.2, coefficient_spread=0.05)
    )


@pytest.fixture(scope="module")
def plots(
    diagnosis: tuple[Diagnosis, list[DriveLog]],
    comparison: tuple[Comparison, PlanningProblem],
    mission: MissionReport,
) -> dict[str, Plot]:
    made = {
        "diagnosis": interactive.diagnosis_plots(*diagnosis),
        "comparison": interactive.comparison_plots(*comparison),
        "mission": interactive.mission_plots(mission),
    }
    return {f"{page} {name}": plot for page, all_ in made.items() for name, plot in all_.items()}


def test_plotly_finds_every_plot_sound(plots: dict[str, Plot]) -> None:
    from plotly.graph_objects import Figure

    assert len(plots) == 7
    for name, plot in plots.items():
        made = Figure(plot)  # raises at a key or a value that plotly does not know
        assert len(made.data) > 1, name
        for axis in ("xaxis",) if name == "comparison terms" else ("xaxis", "yaxis"):
            assert re.search(r"\[.+\]", made.layout[axis].title.text), f"{name} {axis}: no unit"


def test_text_from_files_cannot_become_markup(
    comparison: tuple[Comparison, PlanningProblem], mission: MissionReport
) -> None:
    for page in (pages.comparison_page(*comparison), pages.mission_page(mission)):
        made = page.html()
        assert EVIL not in made
        tail = made[made.index("<body>") :]
        assert "<b>x" not in re.sub(r"base64,[^\"]+", "", tail)


def test_the_library_comes_once_and_nothing_from_elsewhere(mission: MissionReport) -> None:
    page = pages.mission_page(mission).html()
    head, _, body = page.partition("<body>")
    assert head.count(interactive.library()) == 1
    assert "src=" not in re.sub(r'src="data:[^"]+"', "", body)
    assert len(re.findall(r'class="plot( tall| low)?"', body)) == body.count("<img") == 2
    assert "stand still" not in body


def test_without_plotly_the_pictures_stand_still_and_the_page_says_so(
    mission: MissionReport, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = importlib.util.find_spec
    monkeypatch.setattr(
        interactive, "find_spec", lambda name: None if name == "plotly" else found(name)
    )
    page = pages.mission_page(mission).html()
    assert "<script" not in page
    assert page.count("<img") == 2
    assert page.count("energyplan[reports]") == 1


def test_energy_along_a_route_ends_with_its_plan(
    comparison: tuple[Comparison, PlanningProblem],
) -> None:
    made, problem = comparison
    for plan in (made.energy_optimal, made.shortest):
        metres, joules, places = interactive.energy_along(plan.path, problem)
        assert joules[-1] == pytest.approx(plan.energy, rel=1e-6)
        assert metres[-1] == pytest.approx(plan.length)
        assert np.all(np.diff(joules) >= 0)
        assert places[-1, :2] == pytest.approx(problem.goal[:2], abs=1e-6)
    marble = replace(problem, surfaces=None)
    bare = interactive.energy_along(made.shortest.path, marble).joules[-1]
    assert bare == pytest.approx(marble.cost.energy(made.shortest.path), rel=1e-6)
    assert bare != pytest.approx(made.shortest.energy, rel=1e-3)


def test_each_channel_has_its_button(diagnosis: tuple[Diagnosis, list[DriveLog]]) -> None:
    told, judge = diagnosis
    plot = interactive.diagnosis_plots(told, judge)["residual"]
    buttons = plot["layout"]["updatemenus"][0]["buttons"]
    assert buttons[0]["label"].split()[0] == told.dependences_before[0].channel
    shown = np.array([button["args"][0]["visible"] for button in buttons])
    assert np.all(shown.sum(axis=0) == 1)  # each curve belongs to one channel
    assert np.all(shown.sum(axis=1) == 4)  # dots and means, before and after
    assert [trace["visible"] for trace in plot["data"]] == list(shown[0])


def test_bin_means_are_those_of_the_samples() -> None:
    x = np.repeat([1.0, 2.0, 3.0], 40)
    residual = np.where(x == 2, 6.0, np.tile([1.0, -1.0], 60))
    plot = interactive.residual_by_channel({"v": x}, {"before": residual})
    _, means = plot["data"]
    assert np.interp([1.0, 2.0, 3.0], means["x"], means["y"])[:2] == pytest.approx([0.0, 6.0], 1e-9)


def picture(grid: OccupancyGrid) -> tuple[np.ndarray, dict]:
    layout = map_plot(grid, ())["layout"]
    data = base64.b64decode(layout["images"][0]["source"].partition(",")[2])
    return np.asarray(Image.open(io.BytesIO(data)))[..., 1] > 0, layout["images"][0]


@pytest.mark.parametrize("yaw", [0.0, np.pi / 2, 0.7])
def test_the_map_shows_obstacles_where_they_are(yaw: float) -> None:
    occupied = np.random.default_rng(5).random((12, 20)) < 0.3
    occupied = np.kron(occupied, np.ones((10, 10), bool))
    grid = OccupancyGrid(occupied, resolution=0.1, origin=(3.0, -2.0, yaw))
    shown, image = picture(grid)
    rows, columns = np.mgrid[5:120:10, 5:200:10]  # centres of the blocks
    x, y = np.moveaxis(grid.to_world(np.stack([columns, rows], axis=-1)), -1, 0)
    across = ((x - image["x"]) / image["sizex"] * shown.shape[1]).astype(int)
    down = ((image["y"] - y) / image["sizey"] * shown.shape[0]).astype(int)
    assert np.array_equal(shown[down, across], occupied[rows, columns])


def test_thin_walls_of_a_large_map_stay() -> None:
    occupied = np.zeros((4000, 500), bool)
    occupied[1237] = True
    shown, _ = picture(OccupancyGrid(occupied, resolution=0.05))
    assert max(shown.shape) <= 1600
    assert shown.any(axis=0).all()


def test_thinned_curves_keep_their_peaks() -> None:
    noise = np.random.default_rng(3).normal(size=100_003)
    noise[[51_234, 99_999]] = 50.0, -50.0
    kept = thin(noise)
    assert len(kept) <= MOST_POINTS + 2
    assert {0, 51_234, 99_999, 100_002} <= set(kept)
    assert np.array_equal(thin(noise[:100]), np.arange(100))


def test_a_page_without_script_hides_nothing() -> None:
    assert "<script" not in Page("Title").html()
