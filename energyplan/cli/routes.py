"""The commands about routes and how far a battery lasts: plan, compare, check, range, mission."""

from __future__ import annotations

import json as jsonlib
import math
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer import Argument, Option

from energyplan.cli import options as opt
from energyplan.cli.answers import (
    NO,
    answer,
    following,
    progress,
    say,
    verdict,
    warn,
    write_report,
)
from energyplan.cli.app import app
from energyplan.cli.options import (
    BatteryOptions,
    DriveOptions,
    Effort,
    GoalOptions,
    Pack,
    ReturnOptions,
    SiteOptions,
    fraction,
)
from energyplan.errors import InvalidInputError, NoPathError

if TYPE_CHECKING:
    from energyplan.io.sites import ModelOnSite
    from energyplan.mission import Mission, MissionReport
    from energyplan.path import Pose, Trajectory
    from energyplan.planning import Goal, Plan, PlanningProblem
    from energyplan.power import PowerModel
    from energyplan.reach import UsableCharge
    from energyplan.terrain import Site

    Goals = tuple[Goal, ...]


@dataclass(frozen=True)
class Routing:
    """How a route is searched, and where it is written."""

    turning: Annotated[
        str,
        Option(
            metavar="any|forward|RADIUS",
            help="How the robot may turn: in any way, without treads against each other, or on "
            "arcs of this radius at least [m].",
        ),
    ] = "any"
    reverse: opt.Reverse = None
    planner: Annotated[str, Option(help="lattice, or the name of another planner.")] = "lattice"
    out: Annotated[
        Path | None,
        opt.output(
            "Write the path to this file: .csv, or .mcap for nav_msgs/Path with the map.",
            *opt.TABLES,
            opt.RECORDING,
        ),
    ] = None
    trajectory: Annotated[
        Path | None,
        opt.output(
            "Write the timed path to this CSV file: t,x,y,yaw,v,omega, within the motors' limits.",
            *opt.TABLES,
        ),
    ] = None
    plot: opt.Plot = None

    def problem(
        self, site: SiteOptions, drive: DriveOptions, start: Pose, goal: Pose | Goals, **more: Any
    ) -> PlanningProblem:
        """Return what is to be planned."""
        turning: str | float = self.turning
        with suppress(ValueError):
            turning = float(turning)
        return problem_of(site, drive, start, goal, self.reverse, turning=turning, **more)

    def next(self, site: SiteOptions) -> str:
        """Return the command after a plan: the check of its trajectory, or what writes one."""
        if self.trajectory is None:
            return following("plan", "--trajectory", "drive.csv", keep=opt.OF_ROUTE)
        ground = "--map " if site.resolution is None else ""
        return following("check", self.trajectory, keep=f"{ground}--model --battery --soc")

    def write(self, problem: PlanningProblem, plans: dict[str, Plan]) -> None:
        """Write the first of some plans as a table, or all as a recording; draw them all."""
        from energyplan.io.files import atomic_write
        from energyplan.io.tables import write_path

        if self.out and self.out.suffix == opt.RECORDING:
            from energyplan.ros.messages import write_recording

            topics = {f"/{name.replace(' ', '_')}": planned.path for name, planned in plans.items()}
            write_recording(topics, self.out, problem.map)
        elif self.out:
            write_path(next(iter(plans.values())).path, self.out)
        if self.plot:
            from energyplan.output import plots
            from energyplan.output.plots import image

            picture = plots.planned(problem, plots.priced(plans))
            atomic_write(self.plot, image(picture, self.plot.suffix))


def ground_of(drive: DriveOptions, place: Site | None) -> ModelOnSite:
    """Return the model that drives on the ground of a site; say what there is to know of it."""
    from energyplan.io.config import read_model
    from energyplan.io.sites import on_site

    ground = on_site(read_model(drive.model), place)
    for note in ground.notes:
        warn(note)
    return ground


def level_model(name: str) -> PowerModel:
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


def problem_of(
    site: SiteOptions,
    drive: DriveOptions,
    start: Pose,
    goal: Pose | Goals,
    reverse: str | None = None,
    **more: Any,
) -> PlanningProblem:
    """Return the problem that options name."""
    from energyplan.io.config import read_model
    from energyplan.io.sites import SiteFile, load_site, problem_from

    names: dict[str, Any] = {
        key: str(value) for key, value in vars(site).items() if isinstance(value, Path)
    }
    named = SiteFile(map=names.pop("map_file"), **names).model_copy(
        update={"clearance": site.clearance or 0.0, "resolution": site.resolution}
    )
    place = load_site(named, lambda key, name, read: read(Path(name)))
    asked = problem_from(
        place, read_model(drive.model), (start, goal), battery=drive.at_battery, speed=drive.speed,
        reverse=reverse == "yes" if reverse else None, **more,
    )  # fmt: skip
    for note in asked.notes:
        warn(note)
    return asked.problem


@contextmanager
def planning(json: bool, strict: bool) -> Iterator[None]:
    """Show progress, and answer where there is no path."""
    from energyplan.output import documents, text

    try:
        with progress("planning"):
            yield
    except NoPathError as error:
        answer(documents.no_path(error), text.no_path(error), json=json)
        raise typer.Exit(NO if strict else 0) from None


def drive_to(trajectory: Path | None, planned: Plan, *others: Plan) -> None:
    """Drive plans and write the first one's trajectory; say why where they cannot be driven."""
    from energyplan.io.tables import write_trajectory

    if trajectory:
        write_trajectory(planned.driven.trajectory, trajectory)
    for why in dict.fromkeys(plan.why_not_driven for plan in (planned, *others)):
        if why:
            warn(f"the path cannot be timed: {why}")


@app.command(
    epilog="Example: energyplan plan --map warehouse.yaml --model quadriga:empty:concrete "
    "--start 2,2,0 --goal 20,12,90deg --plot route.png"
)
def plan(
    site: SiteOptions,
    drive: DriveOptions,
    start: opt.PoseText,
    effort: Effort,
    routing: Routing,
    goals: GoalOptions,
    supply: BatteryOptions,
    former: Annotated[
        Path | None,
        Option(
            help="A path being driven, as plan --out writes it: the new plan costs no more than "
            "what is left of it, if that is still free."
        ),
    ] = None,
    objective: Annotated[
        str, Option(help="What to make least: energy, length or time.")
    ] = "energy",
    costmap_weight: Annotated[
        float,
        Option(
            min=0.0,
            help="Price of a metre at the highest soft cost of the site's costmap [unit of the "
            "objective].",
        ),
    ] = 0.0,
    json: opt.Json = False,
    strict: opt.Strict = False,
) -> None:
    """Plan the route of least energy.

    Prints its energy, and how far from optimal it can be at most.
    """
    from energyplan.io.tables import read_path
    from energyplan.output import documents, text
    from energyplan.path import parse_pose
    from energyplan.planning import plan as search
    from energyplan.planning.replanning import replan

    if former is None and not goals.goal:
        raise InvalidInputError(
            "--goal is missing; give X,Y,YAW, X,Y for any heading there, or a path by --former"
        )
    if former is not None and goals.goal:
        raise InvalidInputError("--former has its own goal, the end of the path; leave --goal out")
    if former is not None and routing.planner != "lattice":
        raise InvalidInputError(f"--former needs the planner lattice, not {routing.planner}")
    here, pack = parse_pose(start), supply.pack
    there = goals.goals if goals.goal else here
    problem = routing.problem(
        site, supply.measured(drive), here, there, objective=objective,
        costmap_weight=costmap_weight,
    )  # fmt: skip
    if costmap_weight and problem.costmap is None:
        raise InvalidInputError("--costmap-weight needs a site's file that names a costmap")
    spent = asdict(effort)
    if former is None:
        with planning(json, strict):
            result = search(problem, planner=routing.planner, **spent)
    else:
        path = read_path(former, problem.cost.icr.longitudinal)
        with planning(json, strict):
            result = replan(replace(problem, goal=path.end), path, start=here, **spent)
    drive_to(routing.trajectory, result)
    routing.write(problem, {"plan": result})
    then = routing.next(site) if former is None else ""
    run = None if pack is None else result.drawn(*pack)
    lines = [result, *text.battery(run)]
    answer(documents.plan(result, run), lines, json=json, then=then)


@app.command(
    epilog="Example: energyplan compare --map warehouse.yaml --model quadriga:empty:concrete "
    "--start 2,2,0 --goal 20,12,90deg --report routes.html"
)
def compare(
    site: SiteOptions,
    drive: DriveOptions,
    start: opt.PoseText,
    effort: Effort,
    routing: Routing,
    goals: GoalOptions,
    supply: BatteryOptions,
    report: opt.Report = None,
    json: opt.Json = False,
    strict: opt.Strict = False,
) -> None:
    """Compare the cheapest route with the shortest.

    Plans the route of least energy and the shortest one, and prices both by the same model.
    """
    from energyplan.comparison import compare as search
    from energyplan.output import documents, text
    from energyplan.path import parse_pose

    pack = supply.pack
    problem = routing.problem(site, supply.measured(drive), parse_pose(start), goals.goals)
    with planning(json, strict):
        result = search(problem, planner=routing.planner, **asdict(effort))
    drive_to(routing.trajectory, result.energy_optimal, result.shortest)
    routing.write(problem, {"least energy": result.energy_optimal, "shortest": result.shortest})
    if report:
        from energyplan.output.pages import comparison_page

        write_report(comparison_page(result, problem), report)
    both = result.energy_optimal, result.shortest
    runs = [None if pack is None else one.drawn(*pack) for one in both]
    named = zip(runs, ("least energy", "shortest"), strict=True)
    lines = [str(result), *(line for one in named for line in text.battery(*one))]
    answer(documents.comparison(result, *runs), lines, json=json, then=routing.next(site))


@app.command(epilog="Example: energyplan check trajectory.csv --model quadriga:full:concrete")
def check(
    trajectory: Annotated[
        Path,
        Argument(help="CSV with columns t,x,y,yaw,v,omega; or x,y,yaw, a path, which is timed."),
    ],
    drive: DriveOptions,
    supply: BatteryOptions,
    map_file: opt.MaybeSite = None,
    vehicle: Annotated[str | None, Option(help="Vehicle of the motor limits.")] = None,
    out: Annotated[
        Path | None,
        opt.output(
            "Write what the motors can drive: the trajectory, slowed if it must be, or the path as "
            "it was timed.",
            *opt.TABLES,
        ),
    ] = None,
    json: opt.Json = False,
    strict: opt.Strict = False,
) -> None:
    """Check whether the motors can drive a trajectory.

    If they cannot, says where and why, and how fast the robot could drive it.
    """
    from energyplan.cost.speeds import CHEAPEST, parse_speed, tread_speed
    from energyplan.io.config import read_vehicle
    from energyplan.io.sites import of_another_robot, read_site
    from energyplan.io.tables import read_drive
    from energyplan.limits.drive import Ground, Traversal
    from energyplan.limits.feasibility import check as test
    from energyplan.output import documents, text
    from energyplan.path import Trajectory
    from energyplan.planning.driven import drive_path, priced_models

    driven, pack = ground_of(drive, read_site(map_file) if map_file else None), supply.pack
    cost = driven.cost(supply.measured(drive).at_battery, drive.speed)
    ground, hills = (driven.site.surfaces, driven.site.heights) if driven.site else (None, None)
    limits = read_vehicle(vehicle) if vehicle else None
    if limits is not None:
        for note in of_another_robot("the motor limits are", cost.vehicle, [limits]):
            warn(note)
    found = read_drive(trajectory, cost.icr.longitudinal)
    if not isinstance(found, Trajectory):
        if limits is not None:
            speed = tread_speed(parse_speed(drive.speed, limits), limits)
            cost = replace(cost, speed=speed or CHEAPEST)
        found = drive_path(found, cost, ground, hills, vehicle=limits).trajectory
    elif drive.speed is not None:
        raise InvalidInputError(
            f"{trajectory} is a trajectory, whose speeds are given; leave --speed out, or give a "
            "path of x,y,yaw"
        )
    law, ground = priced_models(cost, ground)
    report = test(found, law, limits, surfaces=ground, heights=hills)
    run = None
    if pack is not None:
        run = Traversal(found, Ground(law, ground, hills)).drawn(*pack)
    document = {**documents.feasibility(report, run), "out_duration": None}
    lines = [*str(report).splitlines(), *text.battery(run)]
    share = 1.0 if report.feasible else report.max_speed_scale
    if out and share > 0:
        slowed = found if report.feasible else found.scaled(share)
        document["out_duration"] = slowed.duration
        lines.append(_write_slowed(slowed, share, out))
    elif out:
        warn(f"{out} is not written: the motors drive this trajectory at no speed")
    then = following("mission", "MISSION.yaml", keep="")
    if not report.feasible:
        kept = "--map --model --at-battery --battery --soc --speed --vehicle"
        slower = following("check", trajectory, "--out", "slower.csv", keep=kept)
        then = "" if out or report.max_speed_scale <= 0 else slower
    answer(document, lines, json=json, then=then)
    verdict(report.feasible, strict)


def _write_slowed(slowed: Trajectory, part: float, out: Path) -> str:
    """Write a trajectory that the motors can drive; return the line that says so."""
    from energyplan.html import number, share
    from energyplan.io.tables import write_trajectory

    write_trajectory(slowed, out)
    return f"{out}: {number(slowed.duration)} s, at {share(part)} of these speeds"


@dataclass(frozen=True)
class EnergyOptions:
    """The energy at hand, where no battery says it, and what is kept of either."""

    energy: Annotated[float | None, Option(help="Energy at hand [J].")] = None
    reserve: Annotated[
        str,
        Option(help="State of charge to keep, as 20%; with --energy, which part of it to keep."),
    ] = "0"

    def usable(self, problem: PlanningProblem, pack: Pack | None) -> float | UsableCharge | None:
        """Return what may be used of it, or of a battery; None where neither is given."""
        from energyplan.reach import UsableCharge

        kept = fraction("--reserve", self.reserve)
        if pack is not None:
            return UsableCharge(problem.cost, *pack, kept)
        if self.energy is not None and kept == 1.0:
            raise InvalidInputError(
                f"--reserve {self.reserve} leaves nothing of the energy; keep less"
            )
        return None if self.energy is None else (1.0 - kept) * self.energy


@app.command(
    name="range",
    epilog="Example: energyplan range --map warehouse.yaml --model quadriga:empty:concrete "
    "--start 2,2,0 --energy 5000 --return --confidence 0.95 --spread 0.05",
)
def reach(
    map_file: opt.MapFile,
    model: opt.ModelName,
    start: opt.PoseText,
    home: ReturnOptions,
    supply: BatteryOptions,
    at_hand: EnergyOptions,
    at_battery: opt.AtBattery = False,
    confidence: Annotated[
        float | None,
        Option(help="Probability that a place shown as reachable really is, such as 0.95."),
    ] = None,
    spread: Annotated[
        float | None, Option(help="Relative spread of the model's coefficients, as 0.05.")
    ] = None,
    out: Annotated[
        Path | None, opt.output("Write energies [J] to this ASCII grid.", ".asc")
    ] = None,
    contours: Annotated[
        Path | None, opt.output("Write the areas within reach to this GeoJSON.", *opt.GEOJSON)
    ] = None,
    plot: opt.Plot = None,
    reverse: opt.Reverse = None,
    json: opt.Json = False,
) -> None:
    """Find how far a given energy takes the robot.

    Computes the energy that it takes to reach each place of a map, and to come back with
    --return or --return-to.
    """
    from energyplan.io.tables import write_contours, write_energies
    from energyplan.output import documents, text
    from energyplan.path import parse_pose
    from energyplan.reach import energy_map

    if supply.battery and at_hand.energy is not None:
        raise InvalidInputError("--battery and --energy both set the energy at hand; give one")
    if at_hand.energy == math.inf:
        raise InvalidInputError("--energy is infinite; leave it out for the whole map")
    if spread and confidence is None:
        raise InvalidInputError("--spread needs --confidence; give both")
    pose, pack = parse_pose(start), supply.pack
    drive = supply.measured(DriveOptions(model, at_battery=at_battery))
    problem = problem_of(SiteOptions(map_file), drive, pose, pose, reverse)
    usable = at_hand.usable(problem, pack)
    with progress("searching"):
        found = energy_map(
            problem, energy=math.inf if usable is None else usable,
            back=home.goals(pose) or None, confidence=confidence, coefficient_spread=spread or 0.0,
        )  # fmt: skip
    areas = found.areas(usable)
    if out:
        write_energies(found, out)
    if contours:
        write_contours(areas, contours)
    if plot:
        from energyplan.io.files import atomic_write
        from energyplan.output import plots
        from energyplan.output.plots import image

        atomic_write(plot, image(plots.energy_map(found, problem.map), plot.suffix))
    answer(documents.energy_map(found, areas), text.energy_map(found, areas), json=json)


@dataclass(frozen=True)
class ClusterOptions:
    """Where many missions are evaluated, and where their lines go."""

    cluster: Annotated[
        str | None,
        Option(
            metavar="ADDRESS",
            help="Evaluate many missions on Dask's scheduler at tls://HOST:8786, or on the cores "
            "of this machine, local: a JSON line for each.",
        ),
    ] = None
    insecure_cluster: Annotated[
        bool,
        Option(
            "--insecure-cluster",
            help="Allow a --cluster without TLS: anyone who reaches it runs code as you.",
        ),
    ] = False
    cluster_ca: Annotated[
        Path | None,
        Option(
            "--cluster-ca", metavar="FILE", help="Certificate of the cluster's authority (PEM)."
        ),
    ] = None
    cluster_cert: Annotated[
        Path | None,
        Option("--cluster-cert", metavar="FILE", help="Your certificate for the cluster (PEM)."),
    ] = None
    cluster_key: Annotated[
        Path | None,
        Option("--cluster-key", metavar="FILE", help="The private key of --cluster-cert (PEM)."),
    ] = None
    results: Annotated[
        Path | None,
        opt.output(
            "With --cluster: add the lines to this file; missions that it has are skipped.",
            ".jsonl",
        ),
    ] = None

    @property
    def access(self) -> dict[str, Any]:
        """What a cluster is reached with."""
        return {
            "insecure": self.insecure_cluster, "ca": self.cluster_ca,
            "certificate": self.cluster_cert, "key": self.cluster_key,
        }  # fmt: skip


@app.command(epilog="Example: energyplan mission mission_warehouse.yaml --report mission.html")
def mission(
    files: Annotated[
        list[Path],
        Argument(metavar="MISSION.yaml...", help="Its keys are listed in docs/missions."),
    ],
    *,
    effort: opt.Work = None,
    reverse: opt.Reverse = None,
    fail: Annotated[
        str | None,
        Option(
            metavar="NAME@TIME",
            help="Suppose that this robot of several fails at this time [s]: who takes over?",
        ),
    ] = None,
    report: opt.Report = None,
    trajectories: Annotated[
        Path | None,
        opt.output("Write each drive to this folder (t,x,y,yaw,v,omega), and into --json."),
    ] = None,
    many: ClusterOptions,
    json: opt.Json = False,
    strict: opt.Strict = False,
) -> None:
    """Find out whether the battery lasts for a mission.

    Names the tasks that cannot be done, why, and what would change that. A file with robots is
    shared between them: which robot does which task, and when it charges.
    """
    from energyplan.mission import evaluate
    from energyplan.output import documents, text

    if many.cluster is not None:
        if report or trajectories or fail or strict:
            raise InvalidInputError(
                "--report, --trajectories, --fail and --strict are of one mission; leave them out"
            )
        _many(files, many.cluster, many.access, many.results, effort=effort, reverse=reverse)
        return
    if many.cluster_ca or many.cluster_cert or many.cluster_key:
        raise InvalidInputError("--cluster-ca, --cluster-cert and --cluster-key need --cluster")
    if len(files) > 1 or many.results:
        raise InvalidInputError("several missions and --results need --cluster ADDRESS, or local")
    wanted = _read_mission(files[0], effort, reverse)
    if fail is not None and not wanted.robots:
        raise InvalidInputError("--fail goes with a mission's file that has robots; leave it out")
    name, instant = _failure(fail) if fail else ("", 0.0)
    with progress("evaluating the mission"):
        result = evaluate(wanted)
        after = evaluate(result.after_failure(name, instant)) if name else None
    failure = text.failure(result, name, instant) if name else ""
    if trajectories:
        _write_trajectories(result, trajectories)
    if report:
        from energyplan.output.pages import mission_page

        write_report(mission_page(result, failure, after), report)
    document, lines = documents.mission(result, bool(trajectories)), text.mission(result)
    if after is not None:
        document["after_failure"] = {"robot": name, "time": instant, **documents.mission(after)}
        lines += [f"if {failure}:", *text.mission(after)]
    shown = following("mission", files[0], "--report", "mission.html", keep="")
    then = following("serve", files[0].parent, keep="") if report else shown
    answer(document, lines, json=json, then=then)
    verdict(result.feasible and (after is None or after.feasible), strict)


def _write_trajectories(result: MissionReport, folder: Path) -> None:
    """Write each drive of a mission to a file of its own."""
    from energyplan.io.tables import write_trajectory

    folder.mkdir(parents=True, exist_ok=True)
    for r, one in enumerate(result.robots or (result,), start=1):
        robot = f"robot_{r:02d}_" if result.robots else ""
        for k, leg in enumerate(one.legs, start=1):
            write_trajectory(leg.trajectory, folder / f"{robot}leg_{k:02d}.csv")


def _many(
    files: list[Path],
    address: str,
    access: dict[str, Any],
    results: Path | None,
    **settings: Any,
) -> None:
    """Print a JSON line for each of many missions; one that fails stops no other."""
    from energyplan.io.many import answers, cluster

    failed = 0
    with cluster(address, **access) as executor:
        work = partial(evaluated_mission, **settings)
        for line in answers(work, files, executor, results, settings):
            say(jsonlib.dumps(line, allow_nan=False))
            sys.stdout.flush()
            failed += "error" in line
    if failed:
        warn(f"{failed} of {len(set(files))} missions failed; their lines say why")
        raise typer.Exit(1)


def evaluated_mission(file: Path, effort: int | None, reverse: str | None) -> dict[str, Any]:
    """Return the answer to a mission's file, as a worker does."""
    from energyplan.io.sites import models_of, with_presets
    from energyplan.mission import evaluate
    from energyplan.output import documents

    wanted = _read_mission(file, effort, reverse)
    models = [model for part in wanted.parts or (wanted,) for model in models_of(part)]
    return with_presets(documents.mission(evaluate(wanted)), models)


def _read_mission(file: Path, effort: int | None, reverse: str | None) -> Mission:
    """Read a mission, and give it, and each of several robots, what the command says."""
    from energyplan.io.mission import read_mission

    wanted = read_mission(file)

    def changed(name: str, value: Any) -> Any:
        if name == "planning_effort" and effort is not None:
            return effort
        if name == "model" and reverse:
            return replace(value, vehicle=replace(value.vehicle, reverse=reverse == "yes"))
        return value

    keys = ("planning_effort", "model")
    robots = tuple(
        replace(one, changes={key: changed(key, value) for key, value in one.changes.items()})
        for one in wanted.robots
    )
    whole = {key: changed(key, getattr(wanted, key)) for key in keys}
    return wanted.changed(robots=robots, **whole)


def _failure(text: str) -> tuple[str, float]:
    """Return which robot fails, and when."""
    name, _, instant = text.rpartition("@")
    try:
        if not name:
            raise ValueError(text)
        return name, float(instant)
    except ValueError:
        raise InvalidInputError(
            f"--fail {text!r} cannot be read; write NAME@SECONDS, as beta@600"
        ) from None
