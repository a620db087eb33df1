"""The whole chain on bundled input: drives, models, routes, limits, a mission, a closed loop."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from shapely import box

from energyplan import __version__, simulate
from energyplan.comparison import Comparison, compare
from energyplan.compilation import compile_kernels, compiling_shown
from energyplan.cost import EnergyCost
from energyplan.diagnosis import diagnose
from energyplan.errors import MissingDependencyError
from energyplan.fit import identify
from energyplan.html import Summary, quantity, words
from energyplan.io.config import write_model
from energyplan.io.files import atomic_write, bundled, files_behind
from energyplan.io.geojson import read_surfaces
from energyplan.io.maps import read_map
from energyplan.io.mission import read_mission
from energyplan.io.tables import write_log, write_path, write_trajectory
from energyplan.limits.feasibility import check, feasible_region
from energyplan.limits.speed import profile
from energyplan.logs import DriveLog
from energyplan.mission import MissionReport, evaluate
from energyplan.output import pages, plots
from energyplan.output.pages import Page, Picture
from energyplan.output.plots import png
from energyplan.path import Path as Route
from energyplan.path import Pose
from energyplan.physics import EngineDrives, EngineRobot, HiddenEffect, Loop, close_loop
from energyplan.physics.engine import require_mujoco
from energyplan.planning import PlanningProblem
from energyplan.planning.search.planner import kernels
from energyplan.power import HOTEL, TABLE_II, PowerModel, effects
from energyplan.terrain import OccupancyGrid
from energyplan.vehicle import Vehicle

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SHOWN = "quadriga:full:marble"  # the drive that comes first
FIGURES = {
    "quadriga:empty:marble": 6, "quadriga:full:marble": 7, "quadriga:empty:concrete": 8,
    "quadriga:full:concrete": 9,
}  # fmt: skip
"""Which figure of Morales et al. (2010) has the drive of a preset."""
DRIVEN = "demo_driven.json"
"""The file of what the part with the physics engine found when it was last run."""


def _drive(model: PowerModel, pattern: str | Sequence[simulate.Part], **options: Any) -> DriveLog:
    """Simulate a drive with sensor noise of 10 W, correlated over 0.2 s, and 5 mm/s per side."""
    return simulate.drive(
        model, pattern, power_noise=10.0, correlation_time=0.2, speed_noise=0.005, **options
    )


@dataclass
class _Demo:
    """The page under way and the files written so far."""

    out: Path
    say: Callable[[str], None]
    page: Page
    files: list[Path] = field(default_factory=list)
    results: list[tuple[str, str]] = field(default_factory=list)  # label and value

    def path(self, name: str) -> Path:
        file = self.out / name
        file.parent.mkdir(parents=True, exist_ok=True)
        self.files.append(file)
        return file

    def picture(self, name: str, figure: Figure, caption: str) -> None:
        atomic_write(self.path(f"{name}.png"), png(figure))
        figure.set_layout_engine("none")  # it has been laid out, and the page shows it as it is
        self.page.picture(figure, caption)

    def pictures(self, part: str, pictures: Iterable[Picture]) -> None:
        for name, figure, caption in pictures:
            self.picture(f"{part}-{name}", figure, caption)


def run(out: Path, say: Callable[[str], None]) -> list[Path]:
    """Run the chain and write its files."""
    demo = _Demo(out, say, Page("energyplan: from drive logs to a mission's battery"))
    demo.page.paragraph(
        "Everything on this page was computed just now from the files beside it. The drives are "
        "simulated: the robot obeys a model whose parameters are known, so that every estimate can "
        "be compared with the truth.",
        "lead",
    )
    with compiling_shown(lambda how_far: say(str(how_far)) if how_far.done % 20 == 0 else None):
        compile_kernels(*kernels(surfaces=True), "energyplan.fit", "energyplan.battery")
    with ThreadPoolExecutor(1) as beside:
        say("1/7 identifying Quadriga on four grounds")
        _identification(demo)
        say("2/7 diagnosing a residual")
        _diagnosis(demo)
        say("3/7 planning")
        result = _routes(demo)
        say("4/7 checking motor limits")
        _limits(demo, result)
        say("5/7 driving it in a physics engine")
        report = beside.submit(evaluate, read_mission(bundled("mission_warehouse.yaml")))
        _driven(demo)
        say("6/7 budgeting a mission")
        _mission(demo, report.result())
    say("7/7 writing the page")
    demo.page.results(demo.results)
    _next_steps(demo.page)
    demo.page.made_from(call="energyplan demo")
    atomic_write(demo.path("index.html"), demo.page.html())
    return demo.files


def _identification(demo: _Demo) -> None:
    page = demo.page
    page.heading("1. What are my robot's power parameters on this ground?")
    page.paragraph(
        "For each of the four grounds and loads of Morales et al. (2010), the model is fitted to a "
        "spiral and judged on a figure-8 that it was not fitted to."
    )
    rows, errors, pictures = [], [], dict[str, "Figure"]()
    for number, (preset, (K, mu)) in enumerate(TABLE_II.items(), start=6):
        truth = PowerModel.preset(preset)
        drives = {
            shape: _drive(truth, shape, duration=duration, seed=number, name=f"{shape}.csv")
            for shape, duration in (("spiral", 90.0), ("figure8", 40.0))
        }
        label = preset.replace(":", "-")
        for shape, log in drives.items():
            write_log(log, demo.path(f"drives/{label}-{shape}.csv"))
        found = identify(drives["spiral"], truth.vehicle)
        write_model(found.model, demo.path(f"models/{label}.yaml"))
        unseen = drives["figure8"]
        measured = float(np.trapezoid(unseen.power, unseen.t))
        power = found.model.power(unseen.motion(found.icr))
        predicted = float(np.trapezoid(power, unseen.t))
        errors.append(100 * (predicted / measured - 1))
        rows.append(
            (
                preset, K, _value(found.model, "traction_resistance"), mu,
                _value(found.model, "slip_friction"), measured / 1e3, predicted / 1e3,
                f"{errors[-1]:+.2f} %",
            )
        )  # fmt: skip
        title = f"Figure-8, {preset}: Fig. {FIGURES[preset]} of the paper"
        pictures[label] = plots.prediction(unseen, {"predicted": power}, title)
    worst = max(map(abs, errors))
    page.paragraph(f"The energy of a figure-8 is predicted with an error of at most {worst:.1f} %.")
    demo.results.append(("Energy of a drive predicted within", f"{worst:.1f} %"))
    page.table(
        ("model", "true K [N]", "found K [N]", "true mu", "found mu", "figure-8 measured [kJ]",
         "predicted [kJ]", "error"),
        rows,
    )  # fmt: skip
    demo.picture(
        f"prediction-{(first := SHOWN.replace(':', '-'))}",
        pictures.pop(first),
        "Measured and predicted power and energy on a figure-8 that was not fitted. The paper's "
        "curves are published as pictures: measured here means simulated with its parameters.",
    )
    for label, picture in pictures.items():
        demo.picture(f"prediction-{label}", picture, "The same on another ground, or load.")
    page.command(
        "energyplan identify drives/quadriga-full-marble-spiral.csv --vehicle quadriga:full"
    )


def _value(model: PowerModel, term: str) -> str:
    return quantity(model.coefficient(term), model.std_error(term), "1")


def _diagnosis(demo: _Demo) -> None:
    page = demo.page
    page.heading("2. Why does the prediction differ from what I measured?")
    slope, load = math.radians(4.0), 30.0
    vehicle = Vehicle.preset("quadriga:full")
    truth = replace(PowerModel.preset("quadriga:full:concrete"), name="hidden")
    truth = truth.with_term(effects.GRADE, vehicle.mass).with_term(HOTEL, load)
    drives = [
        _drive(truth, simulate.IDENTIFICATION, slope=slope, uphill=0.7, seed=seed)
        for seed in (1, 2)
    ]
    unseen = _drive(truth, simulate.VALIDATION, slope=slope, uphill=0.7, seed=3)
    for name, log in zip(("train-1", "train-2", "holdout"), (*drives, unseen), strict=True):
        write_log(log, demo.path(f"drives/hidden-{name}.csv"))
    report = diagnose(drives, holdout=[unseen], vehicle=vehicle)
    write_model(report.model, demo.path("models/extended.yaml"))
    page.paragraph(
        f"A robot drives on ground tilted by {math.degrees(slope):.0f} degrees and its computers "
        f"draw {load:.0f} W; the paper's model knows of neither. The residual is traced to an "
        "effect, the effect is added, and the error is reported on a drive not fitted to."
    )
    found = ", ".join(words(effect.name) for effect in report.effects) or "no effect"
    demo.results.append(("Hidden effects found", found))
    page.summaries(report.tables)
    demo.pictures("diagnosis", pages.diagnosis_pictures(report, [unseen]))
    page.command(
        "energyplan diagnose drives/hidden-train-1.csv drives/hidden-train-2.csv "
        "--holdout drives/hidden-holdout.csv --vehicle quadriga:full --report diagnosis.html"
    )


def _routes(demo: _Demo) -> Comparison:
    page = demo.page
    page.heading("3. Which route takes the least energy?")
    ground = read_surfaces(bundled("warehouse_surfaces.geojson"))
    grid = read_map(bundled("warehouse.yaml"))
    inputs = ("warehouse.yaml", "warehouse_surfaces.geojson", "mission_warehouse.yaml")
    files = dict.fromkeys(file for name in inputs for file in files_behind(bundled(name)))
    page.made_from(files=files, model=PowerModel.preset("quadriga:full:concrete"))
    cost = EnergyCost(PowerModel.preset("quadriga:full:concrete"))
    problem = PlanningProblem(
        grid, cost, Pose(2.0, 2.0, 0.0), Pose(20.0, 12.0, math.pi / 2), surfaces=ground
    )
    result = compare(problem, effort=20_000)
    demo.results.append(("Energy saved against the shortest route", f"{100 * result.saving:.0f} %"))
    write_path(result.energy_optimal.path, demo.path("routes/least-energy.csv"))
    write_path(result.shortest.path, demo.path("routes/shortest.csv"))
    page.summaries(result.tables)
    demo.pictures("routes", pages.comparison_pictures(result, problem))
    return result


def _limits(demo: _Demo, result: Comparison) -> None:
    page = demo.page
    page.heading("4. Can the motors drive it?")
    model = PowerModel.preset("quadriga:full:concrete")
    trajectory = profile(result.energy_optimal.path, model)
    write_trajectory(trajectory, demo.path("routes/least-energy-trajectory.csv"))
    report = check(trajectory, model)
    fast = check(trajectory.scaled(1.5), model)
    page.paragraph(
        f"The route, timed to the motors' limits, takes {trajectory.duration:.0f} s and is "
        f"{'feasible' if report.feasible else 'not feasible'}. "
        f"At 1.5 times the speed it is {fast.reason}."
    )
    region = feasible_region(model, np.linspace(-3, 3, 181), np.linspace(0.05, 1.4, 109))
    figure = plots.figure()
    plots.feasible_region(figure.axes[0], region)
    demo.picture(
        "limits",
        figure,
        "Curvatures and speeds that the motors can drive: full, concrete. Straight ahead the "
        "treads do not slip, so the point in the middle lies above the rest.",
    )


def _driven(demo: _Demo) -> None:
    page = demo.page
    page.heading("5. What does it take when it is driven?")
    model = PowerModel.preset("quadriga:full:concrete")
    model = replace(model, vehicle=model.vehicle.with_mass(model.vehicle.mass))  # centred
    hall, block = box(-2.0, -4.2, 11.0, 3.6), box(1.2, -1.9, 7.8, 1.1)
    walls = [hall.buffer(0.5, join_style="mitre") - hall, block]
    grid = OccupancyGrid.from_polygons(walls, hall.buffer(0.5).bounds, 0.1)
    border = {"direction": math.pi / 2, "offset": 1.1}
    try:
        require_mujoco()
    except MissingDependencyError as reason:
        found = json.loads(bundled(DRIVEN).read_text(encoding="utf-8"))
        page.paragraph(
            f"This part was not run: {reason}. What follows was found by version "
            f"{found['version']}."
        )
    else:
        problem = PlanningProblem(grid, EnergyCost(model), Pose(0, 0, 0), Pose(9, 0, 0))
        robot = HiddenEffect("surface_border", 0.3, border).on(EngineRobot.from_model(model))
        found = _recorded(close_loop(
            problem, EngineDrives(robot), rounds=3, tolerance=0.0, survey=40.0, effort=20_000
        ))  # fmt: skip
        text = json.dumps(found, indent=1, allow_nan=False) + "\n"
        atomic_write(demo.path(f"routes/{DRIVEN}"), text)
    page.paragraph(
        "A physics engine that knows nothing of the model drives the planned route. It hides that "
        f"the ground is rougher above y = {border['offset']} m. The error of "
        f"the first prediction is {found['error']:+.1f} %. The drives, one of them designed for "
        f"it, show why; the route of the last round takes {found['saving']:.0f} % less than the "
        "first one."
    )
    page.summaries(Summary(*one) for one in found["tables"])
    rough = box(-2.0, border["offset"], 11.0, 3.6)
    paths = {
        f"round {k}": Route(Pose(0, 0, 0), *motions) for k, motions in enumerate(found["routes"], 1)
    }
    demo.picture(
        "loop",
        plots.routes(grid, paths, surfaces=[("rough ground", rough)]),
        "What was learned changes the route.",
    )


def _recorded(result: Loop) -> dict[str, Any]:
    """Return what the page shows of a closed loop, as JSON can hold it."""
    first, last = result.rounds[0], result.rounds[-1]
    paths = [one.plan.path for one in result.rounds]
    return {
        "version": __version__,
        "error": 100 * first.error,
        "saving": 100 * (1 - last.energy_measured / first.energy_measured),
        "tables": [
            (one.title, list(one.header), [[*map(_cell, row)] for row in one.rows], [*one.notes])
            for one in result.tables
        ],
        "routes": [(p.ds.tolist(), p.dtheta.tolist(), p.longitudinal) for p in paths],
    }


def _cell(value: object) -> str | float:
    return value if isinstance(value, str | int | float) else str(value)


def _mission(demo: _Demo, report: MissionReport) -> None:
    page = demo.page
    page.heading("6. Will the battery last?")
    done = sum(task.verdict == "reachable" for task in report.tasks)
    summary = f"{done} of {len(report.tasks)} tasks"
    page.paragraph(f"The battery lasts for {summary}.")
    demo.results.append(("The battery lasts for", summary))
    page.summaries(report.tables)
    demo.pictures("mission", pages.mission_pictures(report))


def _next_steps(page: Page) -> None:
    """Say what to do next with a log of one's own."""
    page.heading("Your own robot")
    page.paragraph(
        "Drive a spiral and a straight line, and log both wheel speeds and the motors' power. "
        "The first command below reads the log, checks it and writes a project file."
    )
    page.command(
        "energyplan start drive.csv --track 0.5 --wheelbase 0.475 --mass 147 --out robot.yaml"
    )
    page.command(
        "energyplan diagnose drive.csv --project robot.yaml --out model.yaml "
        "--report diagnosis.html"
    )
