"""The commands about routes: plan, compare, check."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NoReturn

import typer

from energyplan.cli.common import (
    IMAGES,
    NO,
    TABLES,
    Json,
    ModelName,
    Report,
    Strict,
    answer,
    app,
    parse_pose,
    progress,
    verdict,
    warn,
    writes,
)
from energyplan.errors import (
    NoPathError,
)

if TYPE_CHECKING:
    from energyplan.planning import PlanningProblem

MapFile = Annotated[Path, typer.Option("--map", help="map_server YAML file.")]
Start = Annotated[str, typer.Option(help="X,Y,YAW; YAW in radians, or like 90deg.")]
Surfaces = Annotated[Path | None, typer.Option(help="GeoJSON polygons that name a model each.")]
Heights = Annotated[Path | None, typer.Option(help="Heights of the ground: ESRI ASCII grid.")]
Battery = Annotated[bool, typer.Option("--battery", help="Count energy at the battery.")]
Planner = Annotated[str, typer.Option(help="lattice, roadmap, or another planner's name.")]
Objective = Annotated[str, typer.Option(help="energy, length or time.")]
TimeLimit = Annotated[float, typer.Option(help="Time for improving the plan [s].")]
Effort = Annotated[
    int | None,
    typer.Option(help="Units of work in place of the time: the same plan on any machine."),
]
OutPath = Annotated[
    Path | None,
    typer.Option("--out", callback=writes(*TABLES), help="Write the path to this CSV file."),
]
Plot = Annotated[
    Path | None,
    typer.Option(
        callback=writes(*IMAGES),
        help="Draw the map and the route to this file, .png, .svg or .pdf.",
    ),
]


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
            warn(f"no term of {power.name} reads slopes: {power.vehicle.mass:.4g} kg are added")
        power, ground = with_weight(power), with_weights(ground) if ground else None
    return PlanningProblem(
        read_map(map_file), EnergyCost(power, battery=battery), parse_pose(start), parse_pose(goal),
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
    effort: Effort = None,
    out: OutPath = None,
    plot: Plot = None,
    json: Json = False,
    strict: Strict = False,
) -> None:
    """Plan the route of least energy, and say how far from optimal it can be at most."""
    from energyplan.io.trajectory import write_path
    from energyplan.output import documents, text
    from energyplan.planning import plan as run

    problem = _problem(map_file, model, start, goal, surfaces, heights, battery, objective)
    try:
        with progress("planning"):
            made = run(problem, planner=planner, time_limit=time_limit, effort=effort)
    except NoPathError as error:
        _no_path(error, json, strict)
    if out:
        write_path(made.path, out)
    if plot:
        _draw(problem, {planner: made.path}, plot)
    answer(documents.plan(made), text.plan(made, objective), json=json)


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
    effort: Effort = None,
    out: OutPath = None,
    plot: Plot = None,
    report: Report = None,
    json: Json = False,
    strict: Strict = False,
) -> None:
    """Compare the route of least energy with the shortest one, both priced by the same model."""
    from energyplan.io.files import atomic_write
    from energyplan.io.trajectory import write_path
    from energyplan.output import documents, text
    from energyplan.output.pages import comparison_page
    from energyplan.studies.comparison import compare as run

    problem = _problem(map_file, model, start, goal, surfaces, heights, battery, objective)
    try:
        with progress("planning"):
            made = run(problem, planner=planner, time_limit=time_limit, effort=effort)
    except NoPathError as error:
        _no_path(error, json, strict)
    if out:
        write_path(made.energy_optimal.path, out)
    if plot:
        both = {"least energy": made.energy_optimal.path, "shortest": made.shortest.path}
        _draw(problem, both, plot)
    if report:
        atomic_write(report, comparison_page(made, problem).html())
    answer(documents.comparison(made), text.comparison(made), json=json)


def _no_path(error: NoPathError, json: bool, strict: bool) -> NoReturn:
    from energyplan.output import documents, text

    answer(documents.no_path(error), text.no_path(error), json=json)
    raise typer.Exit(NO if strict else 0)


def _draw(problem: PlanningProblem, paths: dict[str, Any], file: Path) -> None:
    from energyplan.io.files import atomic_write
    from energyplan.output import plots
    from energyplan.output.report import image

    ground = problem.surfaces.polygons if problem.surfaces else ()
    made = plots.routes(problem.map, paths, surfaces=ground)
    if problem.heights is not None:
        problem.heights.contours(made.axes[0])
    atomic_write(file, image(made, file.suffix))


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
    from energyplan.output import documents, text

    law, limits = read_model(model), read_vehicle(vehicle) if vehicle else None
    report = run(read_trajectory(trajectory), law, limits)
    answer(documents.feasibility(report), text.feasibility(report), json=json)
    verdict(report.feasible, strict)
