"""The commands about routes: plan, compare, check."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer

from energyplan.cli.answers import NO, answer, progress, verdict, warn, write_report
from energyplan.cli.app import app
from energyplan.cli.inputs import parse_pose, warn_of_another_robot
from energyplan.cli.options import IMAGES, TABLES, Json, ModelName, Report, Strict, writes
from energyplan.errors import InfeasibleMotionError, InvalidInputError, NoPathError

if TYPE_CHECKING:
    from energyplan.cost import EnergyCost
    from energyplan.path import Pose
    from energyplan.planning import Plan, PlanningProblem
    from energyplan.planning.driven import DrivenPath
    from energyplan.power import PowerModel
    from energyplan.terrain import HeightMap, SurfaceMap
    from energyplan.vehicle import Vehicle

RECORDING = ".mcap"
MapFile = Annotated[Path, typer.Option("--map", help="The map: a YAML file of ROS map_server.")]
Start = Annotated[
    str, typer.Option(metavar="X,Y,YAW", help="In metres and radians; 90deg is in degrees.")
]
Surfaces = Annotated[
    Path | None, typer.Option(help="Areas of other ground: GeoJSON polygons, each with a model.")
]
Heights = Annotated[
    Path | None,
    typer.Option(help="Heights of the ground: .asc, GeoTIFF, a YAML file with a PNG, or a bag."),
]
AtBattery = Annotated[
    bool,
    typer.Option(
        "--at-battery", help="Report the energy at the battery, with the losses of the drives."
    ),
]
Planner = Annotated[str, typer.Option(help="lattice, roadmap, or the name of another planner.")]
Objective = Annotated[str, typer.Option(help="What to make least: energy, length or time.")]
TimeLimit = Annotated[
    float, typer.Option(help="Time for planning [s]; the best plan found by then counts.")
]
Work = Annotated[
    int | None,
    typer.Option(
        help="Work to spend instead of time: the same plan on any machine. 50000 is about 1 s."
    ),
]
Clearance = Annotated[float, typer.Option(help="Distance to keep from obstacles [m].")]
Keepout = Annotated[
    Path | None, typer.Option(help="A second map; the robot stays out of its occupied cells.")
]
Costmap = Annotated[
    Path | None,
    typer.Option(help="A map of soft costs, such as an inflated costmap; takes --costmap-weight."),
]
CostmapWeight = Annotated[
    float,
    typer.Option(
        min=0.0,
        help="Price of one metre at the highest soft cost, in the objective's unit [J for energy].",
    ),
]
OutPath = Annotated[
    Path | None,
    typer.Option(
        "--out",
        callback=writes(*TABLES, RECORDING),
        help="Write the path to this file: .csv, or .mcap for nav_msgs/Path with the map.",
    ),
]
OutTrajectory = Annotated[
    Path | None,
    typer.Option(
        "--trajectory",
        callback=writes(*TABLES),
        help="Write the timed path to this CSV file: t,x,y,yaw,v,omega, within the motors' limits.",
    ),
]
Speed = Annotated[
    str | None,
    typer.Option(
        help="Tread speed to drive at [m/s], or 'cheapest'. Default: the vehicle's usual speed; "
        "without one, as fast as its motors go."
    ),
]
Tolerance = Annotated[
    float | None,
    typer.Option(
        help="How far the robot may leave its path to round corners [m]. Default: the "
        "vehicle's tracking tolerance."
    ),
]
Plot = Annotated[
    Path | None,
    typer.Option(
        callback=writes(*IMAGES),
        help="Draw the map and the route into this file: .png, .svg or .pdf.",
    ),
]


@dataclass(frozen=True)
class Site:
    """The place: its map, and what closes parts of it."""

    map_file: MapFile
    keepout: Keepout = None
    clearance: Clearance = 0.0


@dataclass(frozen=True)
class Drive:
    """What drives, on which ground, and how fast."""

    model: ModelName
    surfaces: Surfaces = None
    heights: Heights = None
    at_battery: AtBattery = False
    speed: Speed = None


@dataclass(frozen=True)
class Effort:
    """How long to plan."""

    time_limit: TimeLimit = 1.0
    effort: Work = None


def problem_of(
    site: Site,
    drive: Drive,
    start: Pose,
    goal: Pose,
    objective: str = "energy",
    tolerance: float | None = None,
    costmap: Path | None = None,
    costmap_weight: float = 0.0,
) -> PlanningProblem:
    """Return the problem that options name."""
    from energyplan.io.maps import read_costmap, read_map
    from energyplan.planning import PlanningProblem

    if (costmap is None) != (costmap_weight == 0.0):
        raise InvalidInputError("--costmap and --costmap-weight go together; give both or neither")
    ground = ground_of(drive, tolerance)
    grid = read_map(site.map_file)
    for note in () if ground.surfaces is None else ground.surfaces.notes_on(grid):
        warn(note)
    if site.keepout:
        mask = read_map(site.keepout)
        closing = grid.note_of_mask(mask)
        grid = grid.with_mask(mask)
        if closing is not None:
            warn(closing)
    return PlanningProblem(
        grid, ground.cost, start, goal, surfaces=ground.surfaces, objective=objective,
        heights=ground.heights, clearance=site.clearance,
        costmap=read_costmap(costmap) if costmap else None, costmap_weight=costmap_weight,
    )  # fmt: skip


class PricedGround(NamedTuple):
    """What is driven on, and what motions cost there."""

    cost: EnergyCost
    surfaces: SurfaceMap | None
    heights: HeightMap | None


def ground_of(drive: Drive, tolerance: float | None = None) -> PricedGround:
    """Return the ground that options name, and what motions cost on it at the wanted speed."""
    from energyplan.cost import EnergyCost
    from energyplan.cost.speeds import asked_speed
    from energyplan.io.config import read_model
    from energyplan.io.geojson import read_surfaces
    from energyplan.io.heights import read_heights
    from energyplan.power.effects import reads_slope, with_weight
    from energyplan.terrain import knows_ground, with_weights

    power = read_model(drive.model)
    if tolerance is not None:
        power = replace(power, vehicle=replace(power.vehicle, tracking_tolerance=tolerance))
    ground = read_surfaces(drive.surfaces) if drive.surfaces else None
    if ground is not None:
        warn_of_surfaces(power.vehicle, ground)
    hills = read_heights(drive.heights) if drive.heights else None
    if knows_ground(power):
        warn(
            f"{power.name} contains ground: it counts unless a file of surfaces or heights is given"
        )
    if hills is not None:
        if not reads_slope(power):
            warn(
                f"no term of {power.name} depends on slope: the weight of "
                f"{power.vehicle.mass:.4g} kg is added"
            )
        power, ground = with_weight(power), with_weights(ground) if ground else None
    speed = asked_speed(drive.speed, power.vehicle)
    return PricedGround(EnergyCost(power, battery=drive.at_battery, speed=speed), ground, hills)


def warn_of_surfaces(vehicle: Vehicle, ground: SurfaceMap) -> None:
    """Say where the model of a surface is of another robot than the one that drives."""
    others = (surface.model.vehicle for surface in ground.surfaces)
    warn_of_another_robot("models of the surfaces are", vehicle, others)


def model_without_map(name: str) -> PowerModel:
    """Read the model of what knows no map; say so where it contains ground of some place."""
    from energyplan.io.config import read_model
    from energyplan.terrain import knows_ground

    power = read_model(name)
    if knows_ground(power):
        warn(
            f"{power.name} contains ground of some place, such as a slope: it is left out, because "
            "what is written holds for level ground anywhere"
        )
    return power


def driven(made: Plan, trajectory: Path | None) -> DrivenPath | None:
    """Drive a plan and write its trajectory; None with a word why where it cannot be driven."""
    from energyplan.io.trajectory import write_trajectory

    if trajectory is None and made.length == 0.0 and made.turning == 0.0:
        warn("start and goal are the same pose: there is nothing to drive")
        return None
    try:
        told = made.driven
    except (InfeasibleMotionError, InvalidInputError) as error:
        if trajectory:
            raise
        warn(f"the path cannot be timed: {error}")
        return None
    if trajectory:
        write_trajectory(told.trajectory, trajectory)
    return told


@app.command(
    epilog="Example: energyplan plan --map warehouse.yaml --model quadriga:empty:concrete "
    "--start 2,2,0 --goal 20,12,90deg --plot route.png"
)
def plan(
    site: Site,
    drive: Drive,
    start: Start,
    goal: Annotated[
        str | None,
        typer.Option(metavar="X,Y,YAW", help="Where to go. With --former: the end of that path."),
    ] = None,
    former: Annotated[
        Path | None,
        typer.Option(
            help="A path that is being driven, as plan --out writes it. What is left of it is kept "
            "if it is still free and no obstacle is gone."
        ),
    ] = None,
    former_map: Annotated[
        Path | None,
        typer.Option(help="The map of that path. Default: no obstacle is gone since then."),
    ] = None,
    tolerance: Tolerance = None,
    costmap: Costmap = None,
    costmap_weight: CostmapWeight = 0.0,
    planner: Planner = "lattice",
    objective: Objective = "energy",
    limits: Effort = Effort(),
    out: OutPath = None,
    trajectory: OutTrajectory = None,
    plot: Plot = None,
    json: Json = False,
    strict: Strict = False,
) -> None:
    """Plan the route of least energy.

    Prints its energy, and how far from optimal it can be at most.
    """
    from energyplan.io.trajectory import read_path
    from energyplan.output import documents, text
    from energyplan.planning import plan as run
    from energyplan.planning.replanning import replan

    _writable(out)
    here = parse_pose(start)
    options = (objective, tolerance, costmap, costmap_weight)
    _goes_with_former(former, former_map, goal, planner)
    problem = problem_of(site, drive, here, parse_pose(goal) if goal else here, *options)
    effort: dict[str, Any] = asdict(limits)
    if former is None:
        with planning(problem, json, strict):
            made = run(problem, planner=planner, **effort)
    else:
        path = read_path(former, problem.cost.icr.longitudinal)
        grid, problem = problem.map, replace(problem, goal=path.end)
        before = replace(problem, start=path.start)
        if former_map:
            known = problem_of(replace(site, map_file=former_map), drive, here, here, *options)
            before = replace(before, map=known.map)
        with planning(before, json, strict):
            made = replan(before, path, start=here, map=grid, **effort)
    told = driven(made, trajectory)
    if out:
        write_plans(out, problem, plan=made)
    if plot:
        _draw(problem, {planner: made.path}, plot)
    document = {**documents.plan(made), **documents.driven_path(told)}
    answer(document, [*text.plan(made, objective), *text.driven_path(made, told)], json=json)


def _goes_with_former(
    former: Path | None, former_map: Path | None, goal: str | None, planner: str
) -> None:
    """Refuse options that do not go together with a former path, or without one."""
    if former is None:
        if goal is None:
            raise InvalidInputError("--goal is missing; give X,Y,YAW, or a path by --former")
        if former_map is not None:
            raise InvalidInputError("--former-map goes with --former; give both or neither")
    elif goal is not None:
        raise InvalidInputError("--former has its own goal, the end of the path; leave --goal out")
    elif planner != "lattice":
        raise InvalidInputError(f"--former needs the planner lattice, not {planner}")


@app.command(
    epilog="Example: energyplan compare --map warehouse.yaml --model quadriga:empty:concrete "
    "--start 2,2,0 --goal 20,12,90deg --report routes.html"
)
def compare(
    site: Site,
    drive: Drive,
    start: Start,
    goal: Start,
    tolerance: Tolerance = None,
    planner: Planner = "lattice",
    objective: Objective = "energy",
    limits: Effort = Effort(),
    out: OutPath = None,
    trajectory: OutTrajectory = None,
    plot: Plot = None,
    report: Report = None,
    json: Json = False,
    strict: Strict = False,
) -> None:
    """Compare the cheapest route with the shortest.

    Plans the route of least energy and the shortest one, and prices both by the same model.
    """
    from energyplan.output import documents, text
    from energyplan.output.pages import comparison_page
    from energyplan.studies.comparison import compare as run

    _writable(out)
    problem = problem_of(site, drive, parse_pose(start), parse_pose(goal), objective, tolerance)
    with planning(problem, json, strict):
        made = run(problem, planner=planner, time_limit=limits.time_limit, effort=limits.effort)
    best = driven(made.energy_optimal, trajectory)
    one = made.shortest.path == made.energy_optimal.path
    shortest = best if one else driven(made.shortest, None)
    if out:
        write_plans(out, problem, least_energy=made.energy_optimal, shortest=made.shortest)
    if plot:
        both = (("least energy", made.energy_optimal), ("shortest", made.shortest))
        _draw(problem, {f"{name}: {route.energy:.0f} J": route.path for name, route in both}, plot)
    if report:
        write_report(comparison_page(made, problem), report)
    document = documents.comparison(made)
    document["energy_optimal"] |= documents.driven_path(best)
    document["shortest"] |= documents.driven_path(shortest)
    lines = text.comparison(made)
    lines += [f"least energy, {line}" for line in text.driven_path(made.energy_optimal, best)]
    lines += [f"shortest, {line}" for line in text.driven_path(made.shortest, shortest)]
    answer(document, lines, json=json)


def _writable(out: Path | None) -> None:
    """Refuse a recording that could not be written, before any work."""
    if out and out.suffix == RECORDING:
        from energyplan.ros.recording import need_rosbags

        need_rosbags()


def write_plans(out: Path, problem: PlanningProblem, **plans: Plan) -> None:
    """Write the first of some plans as a table, or all of them as a recording."""
    from energyplan.io.trajectory import write_path
    from energyplan.ros.recording import write_recording

    if out.suffix == RECORDING:
        write_recording({f"/{name}": p.path for name, p in plans.items()}, out, problem.map)
    else:
        write_path(next(iter(plans.values())).path, out)


@contextmanager
def planning(problem: PlanningProblem, json: bool, strict: bool) -> Iterator[None]:
    """Show progress, and answer where there is no path."""
    from energyplan.output import documents, text

    try:
        with progress("planning"):
            yield
    except NoPathError as error:
        answer(documents.no_path(error), text.no_path(error), json=json)
        raise typer.Exit(NO if strict else 0) from None


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
    trajectory: Annotated[
        Path,
        typer.Argument(
            help="CSV with columns t,x,y,yaw,v,omega; or x,y,yaw, a path, which is timed."
        ),
    ],
    drive: Drive,
    vehicle: Annotated[
        str | None,
        typer.Option(help="Vehicle whose motor limits count; else the model's."),
    ] = None,
    tolerance: Tolerance = None,
    json: Json = False,
    strict: Strict = False,
) -> None:
    """Check whether the motors can drive a trajectory.

    If they cannot, says where and why, and how fast the robot could drive it.
    """
    from energyplan.cost.speeds import asked_speed
    from energyplan.io.config import read_vehicle
    from energyplan.io.trajectory import read_drive
    from energyplan.limits.feasibility import check as run
    from energyplan.output import documents, text
    from energyplan.path import Trajectory
    from energyplan.planning.driven import counted, drive_path

    cost, ground, hills = ground_of(drive, tolerance)
    limits = read_vehicle(vehicle) if vehicle else None
    if limits is not None:
        warn_of_another_robot("the motor limits are", cost.vehicle, [limits])
    found = read_drive(trajectory, cost.icr.longitudinal)
    if not isinstance(found, Trajectory):
        if limits is not None:
            cost = replace(cost, speed=asked_speed(drive.speed, limits))
        found = drive_path(found, cost, ground, hills, vehicle=limits).trajectory
    elif drive.speed is not None or tolerance is not None:
        raise InvalidInputError(
            f"{trajectory} is a trajectory, whose speeds are given; leave --speed and --tolerance "
            "out, or give a path of x,y,yaw"
        )
    law, ground = counted(cost, ground)
    report = run(found, law, limits, surfaces=ground, heights=hills)
    answer(documents.feasibility(report), text.feasibility(report), json=json)
    verdict(report.feasible, strict)
