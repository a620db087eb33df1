from __future__ import annotations

import re
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import shapely
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.quiver import Quiver

from energyplan import (
    Battery,
    Mission,
    OccupancyGrid,
    Path,
    Pose,
    PowerModel,
    SurfaceMap,
    Task,
    evaluate,
    simulate,
)
from energyplan.mission import Charger, MissionReport
from energyplan.output import plots
from energyplan.output.plots import image
from energyplan.output.plots.style import DPI
from energyplan.terrain.surfaces import Surface

MODEL = PowerModel.preset("quadriga:empty:marble")


def assert_axes_have_units(ax: Axes) -> None:
    for label in (ax.get_xlabel(), ax.get_ylabel()):
        assert re.search(r"\[.+\]$", label), f"axis label {label!r} lacks its unit"


def test_a_notebook_shows_a_picture_as_an_image() -> None:
    figure = plots.figure()
    assert isinstance(figure, Figure)
    content, size = figure._repr_png_()  # as IPython asks for
    assert content == plots.png(figure)
    assert size == {"width": 520}


def test_prediction_shows_speeds_power_and_energy() -> None:
    drive = simulate.drive(MODEL, "figure8", power_noise=5.0)
    stamped = {**drive.channels, "t": drive.t + 1.76416e9}  # time since 1970
    log = replace(drive, channels=stamped)
    expected = MODEL.power(log.motion(MODEL.vehicle.icr))
    figure = plots.prediction(log, {"model": expected}, "Figure-8")
    speeds, power, energy = figure.axes
    assert [ax.get_title(loc="left") for ax in figure.axes] == [
        "Tread speeds",
        "Power",
        "Energy since the start",
    ]
    assert_axes_have_units(energy)
    measured, predicted = power.get_lines()
    assert measured.get_ydata() == pytest.approx(log.power)
    assert predicted.get_ydata() == pytest.approx(expected)
    drawn = np.asarray(energy.get_lines()[0].get_ydata(), float)
    assert drawn[-1] == pytest.approx(np.trapezoid(log.power, log.t) / 1e3)
    assert len(speeds.get_lines()) == 2
    for line in (line for ax in figure.axes for line in ax.get_lines()):
        assert np.asarray(line.get_xdata())[[0, -1]] == pytest.approx([0, log.duration], abs=1e-6)


def test_bin_means_of_the_residual() -> None:
    rng = np.random.default_rng(0)
    x = rng.uniform(0, 1, 4000)
    ax = plots.figure().axes[0]
    plots.residual_against(ax, x, {"before": 3 * x}, "slope [rad]", bins=10)
    means = ax.get_lines()[1]
    assert np.asarray(means.get_ydata()) == pytest.approx(3 * np.asarray(means.get_xdata()))
    assert_axes_have_units(ax)


@pytest.mark.parametrize("free", [False, True])
def test_what_a_map_does_not_know_is_not_drawn_as_free(free: bool) -> None:
    cells = np.zeros((3, 4, 6), bool)
    cells[0, :, 0] = cells[1, :, :2] = True
    grid = OccupancyGrid(cells[0], 0.1, unknown=cells[1] & ~cells[0], unknown_is_free=free)
    (shown,) = plots.occupancy(plots.figure().axes[0], grid).get_images()
    greys = np.ma.filled(shown.get_array().astype(float), 1.0)
    assert (np.diff(greys[:, :3]) > 0.1).all()
    assert (greys[:, 2:] == 1.0).all()


@pytest.mark.parametrize(("length", "turn"), [(2.0, 1.2), (-2.0, 0.0)])
def test_arrows_point_where_the_robot_goes_and_the_last_as_it_stands(
    length: float, turn: float
) -> None:
    """Also after a turn on the spot, where the path goes no further; what is reversed is said."""
    path = Path(Pose(1, 2, 0), [length, 0.0], [0.0, turn])
    ax = plots.figure().axes[0]
    plots.route(ax, path, "route")
    arrows = next(one for one in ax.collections if isinstance(one, Quiver))
    assert np.asarray(arrows.U[:-1]) == pytest.approx(np.full(len(arrows.U) - 1, np.sign(length)))
    assert (arrows.U[-1], arrows.V[-1]) == pytest.approx((np.cos(turn), np.sin(turn)))
    assert ("2.0 m in reverse" in str(ax.get_lines()[0].get_label())) == (length < 0)
    ends = [float(line.get_xdata()[0]) for line in ax.get_lines()[1:]]
    assert ends == pytest.approx([1.0, 1.0 + length])


def test_breakdown_bars_add_up() -> None:
    ax = plots.figure().axes[0]
    plots.breakdown(ax, {"a": {"slip": 1000.0, "roll": 500.0}, "b": {"slip": 200.0}})
    reach = max(bar.get_x() + bar.get_width() for bar in ax.patches)
    assert reach == pytest.approx(1.5)


@pytest.fixture(scope="module")
def crowded() -> MissionReport:
    """A mission whose tasks lie closer together than their names are long."""
    hall = OccupancyGrid(np.zeros((80, 120), bool), 0.1)
    places = ((6.0, 4.0), (6.4, 4.3), (6.2, 3.6), (11.4, 7.4), (0.6, 7.4))
    tasks = [
        Task(f"a task with a long name {k}", Pose(x, y, 0.0), dwell=60.0)
        for k, (x, y) in enumerate(places)
    ]
    return evaluate(
        Mission(
            MODEL,
            hall,
            Battery.preset("quadriga"),
            Pose(1.0, 4.0, 0.0),
            tuple(tasks),
            planning_effort=2_000,
            coefficient_spread=0.05,
        )
    )


def test_places_have_the_numbers_under_which_the_legend_names_them(crowded: MissionReport) -> None:
    tasks = (*crowded.mission.tasks, replace(crowded.mission.tasks[0], name="again"))
    again = replace(crowded.tasks[0], name="again", verdict="unreachable")
    mission = replace(crowded.mission, tasks=tasks)
    figure = plots.mission_map(replace(crowded, mission=mission, tasks=(*crowded.tasks, again)))
    (legend,) = figure.legends
    names = [text.get_text().split(maxsplit=1) for text in legend.get_texts()]
    stops = [stop.name for stop in crowded.route if stop.kind == "task"]
    assert [name for _, name in names] == ["start", *stops, "again (out of reach)"]
    signs = {note.xy: note.get_text() for note in figure.axes[0].texts}
    at = {task.name: (task.pose.x, task.pose.y) for task in tasks}
    for sign, name in names[1:]:
        assert sign in signs[at[name.removesuffix(" (out of reach)")]].split(",")
    image(figure, ".png")
    box = legend.get_window_extent()
    assert box.x1 <= figure.bbox.x1 and box.y0 >= figure.bbox.y0 - 1.0


@pytest.mark.parametrize(
    ("sides", "yaw", "chargers"),
    [((16, 24), 0, 0), ((24, 16), 0, 1), ((8, 40), 0, 1), ((16, 20), 0.4, 9)],
)
def test_nothing_about_a_map_with_colours_lies_over_another_or_is_cut(
    crowded: MissionReport, sides: tuple[int, int], yaw: float, chargers: int
) -> None:
    """Legends, the axis' label, the bar of colours and its label, from top to bottom."""
    high, wide = sides
    hall = OccupancyGrid(np.zeros((10 * high, 10 * wide), bool), 0.1, origin=(0, 0, yaw))
    ground = SurfaceMap([Surface(shapely.box(0, 0, 0.5 * wide, high), MODEL, "marble")])
    docks = [Charger(f"dock {k}", Pose(1.0, 4.0, 0.0), 100.0) for k in range(chargers)]
    mission = replace(crowded.mission, map=hall, surfaces=ground, chargers=docks)
    figure = plots.mission_map(replace(crowded, mission=mission))
    image(figure, ".png")
    figure.set_dpi(DPI)  # as it was drawn
    (ax,) = figure.axes
    (bar,) = ax.child_axes
    legend = ax.get_legend()
    assert legend is not None
    parts = [legend, ax.patch, ax.xaxis, bar.patch, bar.xaxis, *figure.legends]
    boxes = [part.get_tightbbox() for part in parts]
    assert boxes[0].y1 <= figure.bbox.y1 and boxes[-1].y0 >= -1.0
    assert all(upper.y0 >= lower.y1 - 1.0 for upper, lower in pairwise(boxes))
    assert all(box.x0 >= -1.0 and box.x1 <= figure.bbox.x1 + 1.0 for box in boxes)


def test_a_missions_colours_span_from_the_reserve_to_a_full_battery(crowded: MissionReport) -> None:
    """However little the mission takes; arrows and white lines say which way it is driven."""
    ax = plots.mission_map(crowded).axes[0]
    lines = [one for one in ax.collections if isinstance(one, LineCollection)]
    charge = next(one for one in lines if one.get_array() is not None)
    assert np.ptp(np.asarray(charge.get_array())) < 5.0
    assert charge.get_clim() == pytest.approx((100 * crowded.mission.reserve, 100))
    assert any(isinstance(one, Quiver) for one in ax.collections)
    white = next(one for one in lines if one.get_array() is None)
    length = sum(float(np.hypot(*np.diff(one, axis=0).T).sum()) for one in white.get_segments())
    backwards = sum(path.reverse_length for path in crowded.paths)
    assert length == pytest.approx(backwards, rel=0.02) and backwards > 1.0
    assert f"{backwards:.1f} m in reverse" in ax.child_axes[0].get_xlabel()


def test_nothing_lies_over_the_charge_or_outside_the_picture(crowded: MissionReport) -> None:
    figure = plots.mission_charge(crowded)
    image(figure, ".svg")
    figure.draw_without_rendering()
    charge = figure.axes[0]
    legend = charge.get_legend()
    assert legend is not None
    assert legend.get_window_extent().y0 >= charge.get_window_extent().y1
    assert len(charge.texts) == 0
    whole = figure.bbox.padded(1.0)
    inked = figure.get_tightbbox().transformed(figure.dpi_scale_trans)
    assert whole.x0 <= inked.x0 and inked.x1 <= whole.x1
    assert whole.y0 <= inked.y0 and inked.y1 <= whole.y1
