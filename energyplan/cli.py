"""Command line: argument parsing only; every command is one library call."""

from __future__ import annotations

import json as jsonlib
import math
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, NoReturn

import typer

from energyplan.errors import (
    EnergyPlanError,
    InvalidInputError,
    MissingDependencyError,
    NoPathError,
    TimeLimitError,
)

if TYPE_CHECKING:
    from energyplan.logs import DriveLog
    from energyplan.path import Pose
    from energyplan.planning import PlanningProblem

app = typer.Typer(
    add_completion=False,
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    help="Energy-aware path planning for wheeled skid-steer robots.",
)

Json = Annotated[bool, typer.Option("--json", help="Print one JSON document and nothing else.")]
Strict = Annotated[bool, typer.Option("--strict", help="Exit with 3 if the answer is no.")]
Logs = Annotated[
    list[Path],
    typer.Argument(help="Drive logs: CSV, CSV.gz, Parquet, bags, Husky recordings."),
]
VehicleName = Annotated[
    str, typer.Option("--vehicle", help="Preset such as quadriga:full, or a YAML file.")
]
ModelName = Annotated[
    str, typer.Option("--model", help="Preset such as quadriga:full:marble, or a YAML file.")
]
Method = Annotated[
    Literal["lad", "simplex", "huber"],
    typer.Option(help="lad (exact), simplex (the paper's), huber (robust)."),
]
Columns = Annotated[
    str | None, typer.Option(help="Other column names, such as v_left=velL,yaw=heading[deg].")
]
Topics = Annotated[
    str, typer.Option(help="Topic map of bags: husky, jackal, warthog, or a YAML file.")
]
OutModel = Annotated[Path | None, typer.Option("--out", help="Write the model to this YAML file.")]
Report = Annotated[Path | None, typer.Option("--report", help="Write a report to this HTML file.")]

NO, INTERRUPTED = 3, 130
"""Exit codes of a negative answer with ``--strict``, and of Ctrl-C."""


def _say(text: str) -> None:
    sys.stdout.write(text + "\n")


def _warn(text: str) -> None:
    sys.stderr.write(text + "\n")


def _answer(document: dict[str, Any], lines: list[str], *, json: bool) -> None:
    if json:
        _say(jsonlib.dumps(document, indent=1, allow_nan=False))
    else:
        _say("\n".join(lines))


def _verdict(yes: bool, strict: bool) -> None:
    if strict and not yes:
        raise typer.Exit(NO)


@contextmanager
def _progress(text: str) -> Iterator[Any]:
    """Show on stderr that work goes on; yields ``update(fraction, text)``."""
    if not sys.stderr.isatty():
        yield lambda fraction, note="": None
        return
    from rich.console import Console
    from rich.progress import Progress

    with Progress(console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(text, total=1.0)
        yield lambda fraction, note="": bar.update(
            task, completed=fraction, description=note or text
        )


def _logs(paths: list[Path], columns: str | None, topics: str) -> list[DriveLog]:
    from energyplan.io.logs import read_log

    with _progress("reading") as update:
        return [read_log(path, columns, topics=topics, progress=update) for path in paths]


def _notes(logs: list[DriveLog]) -> list[str]:
    return [f"{log.name}: {warning}" for log in logs for warning in log.warnings]


def _pose(text: str) -> Pose:
    from energyplan.path import Pose

    parts = text.split(",")
    try:
        if len(parts) != 3:
            raise ValueError(text)
        yaw = parts[2].strip()
        turn = math.radians(float(yaw[:-3])) if yaw.endswith("deg") else float(yaw)
        pose = Pose(float(parts[0]), float(parts[1]), turn)
        if not all(math.isfinite(value) for value in pose):
            raise ValueError(text)
    except ValueError:
        raise InvalidInputError(
            f"pose {text!r} is not X,Y,YAW; write it like 2.0,3.5,90deg or 2.0,3.5,1.57"
        ) from None
    if abs(pose.yaw) > 6.3:
        raise InvalidInputError(
            f"the yaw of pose {text!r} is more than a full turn in radians; for degrees write "
            f"{parts[2].strip().removesuffix('deg')}deg, up to 360"
        )
    return pose


@app.command(
    epilog="Example: energyplan identify spiral.csv --vehicle quadriga:full --out model.yaml"
)
def identify(
    logs: Logs,
    vehicle: VehicleName,
    method: Method = "lad",
    out: OutModel = None,
    columns: Columns = None,
    topics: Topics = "husky",
    json: Json = False,
) -> None:
    """Find a robot's power parameters on some ground from its drive logs."""
    from energyplan.fit import identify as run
    from energyplan.io.config import read_vehicle, write_model
    from energyplan.output import documents
    from energyplan.output import text as _lines

    robot = read_vehicle(vehicle)
    drives = _logs(logs, columns, topics)
    found = run(drives, robot, method=method)
    found = replace(found, warnings=(*_notes(drives), *found.warnings))
    if out:
        write_model(found.model, out)
    _answer(documents.identification(found), _lines.identification(found), json=json)


@app.command(
    epilog="Example: energyplan diagnose a.csv b.csv --holdout c.csv --vehicle quadriga "
    "--out extended.yaml --report diagnosis.html"
)
def diagnose(
    logs: Logs,
    holdout: Annotated[list[Path], typer.Option(help="Drives kept for judging; repeatable.")],
    vehicle: VehicleName,
    out: OutModel = None,
    report: Report = None,
    columns: Columns = None,
    topics: Topics = "husky",
    json: Json = False,
    strict: Strict = False,
) -> None:
    """Trace the residual of the power model to an effect, add it, and report before and after."""
    from energyplan.diagnosis import diagnose as run
    from energyplan.io.config import read_vehicle, write_model
    from energyplan.io.files import atomic_write
    from energyplan.output import documents
    from energyplan.output import text as _lines
    from energyplan.output.pages import diagnosis_page

    robot = read_vehicle(vehicle)
    for path in {path.resolve() for path in logs} & {path.resolve() for path in holdout}:
        raise InvalidInputError(f"{path.name} is learned from and held out; give it to one of them")
    training, judging = _logs(logs, columns, topics), _logs(holdout, columns, topics)
    for note in _notes([*training, *judging]):
        _warn(note)
    with _progress("diagnosing") as update:
        told = run(training, holdout=judging, vehicle=robot, progress=update)
    if out:
        write_model(told.model, out)
    if report:
        atomic_write(report, diagnosis_page(told, judging).html())
    _answer(documents.diagnosis(told), _lines.diagnosis(told), json=json)
    _verdict(told.verdict != "unexplained", strict)


MapFile = Annotated[Path, typer.Option("--map", help="map_server YAML file.")]
Start = Annotated[str, typer.Option(help="X,Y,YAW; YAW in radians, or like 90deg.")]
Surfaces = Annotated[Path | None, typer.Option(help="GeoJSON polygons that name a model each.")]
Heights = Annotated[Path | None, typer.Option(help="Heights of the ground: ESRI ASCII grid.")]
Battery = Annotated[bool, typer.Option("--battery", help="Count energy at the battery.")]
Planner = Annotated[str, typer.Option(help="lattice, roadmap, or another planner's name.")]
Objective = Annotated[str, typer.Option(help="energy, length or time.")]
TimeLimit = Annotated[float, typer.Option(help="Time for improving the plan [s].")]
OutPath = Annotated[Path | None, typer.Option("--out", help="Write the path to this CSV file.")]
Plot = Annotated[Path | None, typer.Option(help="Draw the map and the route to this PNG file.")]


def _problem(
    map_file: Path,
    model: str,
    start: str,
    goal: str,
    surfaces: Path | None,
    heights: Path | None,
    battery: bool,
    objective: str,
) -> PlanningProblem:
    from energyplan.cost import EnergyCost
    from energyplan.io.config import read_model
    from energyplan.io.geojson import read_surfaces
    from energyplan.io.heights import read_heights
    from energyplan.io.maps import read_map
    from energyplan.planning import PlanningProblem
    from energyplan.power.effects import reads_slope, with_weight
    from energyplan.terrain import with_weights

    power = read_model(model)
    ground = read_surfaces(surfaces) if surfaces else None
    hills = read_heights(heights) if heights else None
    if hills is not None:
        if not reads_slope(power):
            _warn(f"no term of {power.name} reads slopes: {power.vehicle.mass:.4g} kg are added")
        power, ground = with_weight(power), with_weights(ground) if ground else None
    return PlanningProblem(
        read_map(map_file), EnergyCost(power, battery=battery), _pose(start), _pose(goal),
        surfaces=ground, objective=objective, heights=hills,
    )  # fmt: skip


@app.command(
    epilog="Example: energyplan plan --map warehouse.yaml --model quadriga:empty:concrete "
    "--start 2,2,0 --goal 20,12,90deg --plot route.png"
)
def plan(
    map_file: MapFile,
    model: ModelName,
    start: Start,
    goal: Start,
    surfaces: Surfaces = None,
    heights: Heights = None,
    battery: Battery = False,
    planner: Planner = "lattice",
    objective: Objective = "energy",
    time_limit: TimeLimit = 1.0,
    out: OutPath = None,
    plot: Plot = None,
    json: Json = False,
    strict: Strict = False,
) -> None:
    """Plan the route of least energy, and say how far from optimal it can be at most."""
    from energyplan.io.trajectory import write_path
    from energyplan.output import documents
    from energyplan.output import text as _lines
    from energyplan.planning import plan as run

    problem = _problem(map_file, model, start, goal, surfaces, heights, battery, objective)
    try:
        with _progress("planning"):
            made = run(problem, planner=planner, time_limit=time_limit)
    except NoPathError as error:
        _no_path(error, json, strict)
    if out:
        write_path(made.path, out)
    if plot:
        _draw(problem, {planner: made.path}, plot)
    _answer(documents.plan(made), _lines.plan(made, objective), json=json)


@app.command(
    epilog="Example: energyplan compare --map warehouse.yaml --model quadriga:empty:concrete "
    "--start 2,2,0 --goal 20,12,90deg --report routes.html"
)
def compare(
    map_file: MapFile,
    model: ModelName,
    start: Start,
    goal: Start,
    surfaces: Surfaces = None,
    heights: Heights = None,
    battery: Battery = False,
    planner: Planner = "lattice",
    objective: Objective = "energy",
    time_limit: TimeLimit = 1.0,
    out: OutPath = None,
    plot: Plot = None,
    report: Report = None,
    json: Json = False,
    strict: Strict = False,
) -> None:
    """Compare the route of least energy with the shortest one, both priced by the same model."""
    from energyplan.io.files import atomic_write
    from energyplan.io.trajectory import write_path
    from energyplan.output import documents
    from energyplan.output import text as _lines
    from energyplan.output.pages import comparison_page
    from energyplan.studies.comparison import compare as run

    problem = _problem(map_file, model, start, goal, surfaces, heights, battery, objective)
    try:
        with _progress("planning"):
            made = run(problem, planner=planner, time_limit=time_limit)
    except NoPathError as error:
        _no_path(error, json, strict)
    if out:
        write_path(made.energy_optimal.path, out)
    if plot:
        both = {"least energy": made.energy_optimal.path, "shortest": made.shortest.path}
        _draw(problem, both, plot)
    if report:
        atomic_write(report, comparison_page(made, problem).html())
    _answer(documents.comparison(made), _lines.comparison(made), json=json)


def _no_path(error: NoPathError, json: bool, strict: bool) -> NoReturn:
    _answer({"path": None, "reason": str(error)}, [f"no path: {error}"], json=json)
    raise typer.Exit(NO if strict else 0)


def _draw(problem: PlanningProblem, paths: dict[str, Any], file: Path) -> None:
    from energyplan.io.files import atomic_write
    from energyplan.output import plots
    from energyplan.output.report import png

    ground = problem.surfaces.polygons if problem.surfaces else ()
    made = plots.routes(problem.map, paths, surfaces=ground)
    if problem.heights is not None:
        problem.heights.contours(made.axes[0])
    atomic_write(file, png(made))


@app.command(epilog="Example: energyplan check trajectory.csv --model quadriga:full:concrete")
def check(
    trajectory: Annotated[Path, typer.Argument(help="CSV with columns t,x,y,yaw,v,omega.")],
    model: ModelName,
    vehicle: Annotated[
        str | None, typer.Option(help="Whose limits hold; the model's vehicle by default.")
    ] = None,
    json: Json = False,
    strict: Strict = False,
) -> None:
    """Tell whether the motors can drive a trajectory; where not, and how fast they could."""
    from energyplan.io.config import read_model, read_vehicle
    from energyplan.io.trajectory import read_trajectory
    from energyplan.limits.feasibility import check as run
    from energyplan.output import documents
    from energyplan.output import text as _lines

    law, limits = read_model(model), read_vehicle(vehicle) if vehicle else None
    report = run(read_trajectory(trajectory), law, limits)
    _answer(documents.feasibility(report), _lines.feasibility(report), json=json)
    _verdict(report.feasible, strict)


@app.command(epilog="Example: energyplan mission mission_warehouse.yaml --report mission.html")
def mission(
    file: Annotated[Path, typer.Argument(help="Mission YAML file.")],
    report: Report = None,
    json: Json = False,
    strict: Strict = False,
) -> None:
    """Budget a mission's battery, and flag the tasks that cannot be reached, with the reason."""
    from energyplan.io.files import atomic_write
    from energyplan.io.mission import read_mission
    from energyplan.mission import evaluate
    from energyplan.output import documents
    from energyplan.output import text as _lines
    from energyplan.output.pages import mission_page

    asked = read_mission(file)
    with _progress("evaluating the mission"):
        told = evaluate(asked)
    if report:
        atomic_write(report, mission_page(told).html())
    _answer(documents.mission(told), _lines.mission(told), json=json)
    _verdict(told.feasible, strict)


log = typer.Typer(no_args_is_help=True, help="Look into drive logs.")
app.add_typer(log, name="log")


@log.command(epilog="Example: energyplan log info drive.csv")
def info(
    file: Annotated[Path, typer.Argument(help="A table or a bag.")], json: Json = False
) -> None:
    """List what a log holds, and what it could serve for."""
    from energyplan.io.logs import describe_log
    from energyplan.output import documents
    from energyplan.output import text as _lines

    told = describe_log(file)
    _answer(documents.plain(told), _lines.log(told), json=json)


@app.command(epilog="Example: energyplan demo --out demo")
def demo(
    out: Annotated[Path, typer.Option(help="Folder for the files.")] = Path("demo"),
    json: Json = False,
) -> None:
    """Run the whole chain on input that comes with the library; makes pictures and a web page."""
    from energyplan.demo import run

    files = run(out, say=(lambda text: None) if json else _warn)
    names = [str(name) for name in files]
    _answer({"files": names}, [*names, f"open {out / 'index.html'} in a browser"], json=json)


def main() -> None:
    """Entry point: map errors to exit codes and one line on stderr."""
    try:
        code = app(standalone_mode=False) or 0
    except (TimeLimitError, MissingDependencyError) as error:
        code = _fail(str(error), 1)
    except (EnergyPlanError, OSError) as error:
        code = _fail(str(error), 2)
    except typer.TyperException as error:
        code = _fail(error.format_message(), error.exit_code)
    if code == INTERRUPTED:  # typer turns Ctrl-C into an exit with this code
        _fail("interrupted; files are as they were", code)
    sys.exit(code)


def _fail(message: str, code: int) -> int:
    _warn("energyplan: " + " ".join(message.split()))
    return code
