"""The commands that drive a robot in a physics engine: drive, close-the-loop, design."""

from __future__ import annotations

import json as jsonlib
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import Argument, Option

from energyplan.cli import options as opt
from energyplan.cli.answers import answer, progress, verdict, write_report
from energyplan.cli.app import app
from energyplan.cli.options import DriveOptions, SiteOptions
from energyplan.cli.routes import ground_of, problem_of
from energyplan.errors import InvalidInputError

if TYPE_CHECKING:
    from energyplan.physics import EngineRobot, HiddenEffect


@dataclass(frozen=True)
class Truth:
    """What the simulated robot has and the model lacks."""

    effect: Annotated[
        list[str] | None,
        Option(
            metavar="NAME=SIZE[,DETAIL=VALUE]",
            help="An effect that the simulated robot has and the model lacks; repeatable.",
        ),
    ] = None
    hidden: Annotated[int | None, Option(help="Give it secret effects, drawn by this seed.")] = None
    truth: Annotated[Path | None, opt.output("Write its effects to this JSON file.", ".json")] = (
        None
    )

    def effects(self, robot: EngineRobot, x: float, y: float) -> tuple[HiddenEffect, ...]:
        """Return the effects that were declared, and those that were drawn around a place."""
        from energyplan.io.files import atomic_write
        from energyplan.output.documents import plain
        from energyplan.physics import HiddenEffect, draw_effects

        chosen = tuple(HiddenEffect.parse(text) for text in self.effect or ())
        if self.hidden is not None:
            chosen += draw_effects(robot, self.hidden, around=(x, y))
        if self.truth:
            rows = [{"name": e.name, "size": e.size, "details": plain(e.details)} for e in chosen]
            atomic_write(self.truth, jsonlib.dumps({"effects": rows}, indent=1) + "\n")
        return chosen


@app.command(
    epilog="Example: energyplan drive trajectory.csv --model quadriga:full:concrete "
    "--effect viscous_loss=60 --out log.csv"
)
def drive(
    trajectory: Annotated[Path, Argument(help="CSV with columns t,x,y,yaw,v,omega.")],
    model: opt.ModelName,
    robot: Truth,
    map_file: opt.MaybeSite = None,
    out: Annotated[
        Path | None, opt.output("Write the drive log to this file.", *opt.TABLES)
    ] = None,
    sensors: Annotated[
        str,
        Option(
            metavar="NAME=VALUE,...",
            help="How the drive is recorded: rate [Hz], power_noise [W], speed_noise, speed_step "
            "[m/s], current_step [A], delay [s], unsigned=true, measured=sides, total or battery; "
            "seed of the noise.",
        ),
    ] = "",
    json: opt.Json = False,
    strict: opt.Strict = False,
) -> None:
    """Drive a trajectory in a physics engine.

    Prints the predicted energy and the energy that the drive took.
    """
    from energyplan.io.sites import read_site
    from energyplan.io.tables import read_trajectory, write_log
    from energyplan.output import documents
    from energyplan.physics import EngineGround as Floor
    from energyplan.physics import EngineRobot, Sensors, switch_on
    from energyplan.physics import drive as run

    wanted = read_trajectory(trajectory)
    place = read_site(map_file) if map_file else None
    ground = ground_of(DriveOptions(model), place)
    surfaces, heights = (ground.site.surfaces, ground.site.heights) if ground.site else (None, None)
    recording = Sensors.parse(sensors)
    simulated = EngineRobot.from_model(ground.model)
    x, y, _ = wanted.poses[len(wanted) // 2]
    simulated = switch_on(simulated, robot.effects(simulated, float(x), float(y)))
    with progress("driving"):
        result = run(wanted, simulated, ground.model, ground=Floor(surfaces, heights))
    if out:
        write_log(recording.log(result.run, out.name), out)
    secret = robot.hidden is not None
    (energy,) = result.tables
    if secret:  # what was taken by term would show the effects
        rows = [row[:2] for row in energy.rows if row[1]]
        energy = energy._replace(header=energy.header[:2], rows=rows)
    answer(documents.driven(result, secret=secret), energy.text(), json=json)
    verdict(result.arrived, strict)


@app.command(
    epilog="Example: energyplan close-the-loop --map warehouse.yaml --model quadriga:full:concrete "
    "--start 2,2,0 --goal 20,12,90deg --hidden 4 --effort 50000 "
    "--report loop.html"
)
def close_the_loop(
    map_file: opt.MapFile,
    model: opt.ModelName,
    start: opt.PoseText,
    goal: opt.PoseText,
    robot: Truth,
    effort: opt.Work = None,
    logs: Annotated[
        Path | None,
        Option(help="Folder of a real robot's logs, one a round in the order of their names."),
    ] = None,
    rounds: Annotated[int, Option(help="Largest number of rounds.")] = 3,
    error: Annotated[float, Option(help="Error of the prediction at which to stop.")] = 0.01,
    survey: Annotated[float, Option(help="Longest test drive in between [s]; 0: none.")] = 60.0,
    out: opt.OutModel = None,
    report: opt.Report = None,
    json: opt.Json = False,
    strict: opt.Strict = False,
) -> None:
    """Plan, drive, diagnose, and plan again.

    Diagnoses with all drives so far, until the predicted energy is right.
    """
    from energyplan.io.config import write_model
    from energyplan.io.logs import read_drives
    from energyplan.output import documents
    from energyplan.output.pages import loop_page
    from energyplan.path import parse_pose
    from energyplan.physics import EngineDrives, EngineRobot, close_loop, switch_on
    from energyplan.physics import EngineGround as Floor
    from energyplan.physics.loop import Source

    priced = DriveOptions(model, at_battery=True)
    problem = problem_of(SiteOptions(map_file), priced, parse_pose(start), parse_pose(goal))
    source: Source
    if logs is not None:
        if robot.effect or robot.hidden is not None:
            raise InvalidInputError("--logs are of a real robot; leave out --effect and --hidden")
        if not logs.is_dir():
            raise InvalidInputError(f"{str(logs)!r} is no folder; give one that holds the logs")
        files = sorted(file for file in logs.iterdir() if file.suffix in opt.TABLES)
        if not files:
            raise InvalidInputError(
                f"{str(logs)!r} holds no log that ends with {', '.join(opt.TABLES)}"
            )
        source = read_drives(files, problem.cost.vehicle.name)
    else:
        simulated = EngineRobot.from_model(problem.cost.model)
        x = 0.5 * (problem.start.x + problem.goal.x)
        y = 0.5 * (problem.start.y + problem.goal.y)
        simulated = switch_on(simulated, robot.effects(simulated, x, y))
        source = EngineDrives(simulated, Floor(problem.surfaces, problem.heights))
    with progress("closing the loop") as update:
        result = close_loop(
            problem,
            source,
            rounds=rounds,
            tolerance=error,
            survey=survey,
            progress=update,
            effort=effort,
        )
    if out:
        write_model(result.model, out)
    if report:
        write_report(loop_page(result, problem), report)
    answer(documents.loop(result), result, json=json)
    verdict(result.closed, strict)


@app.command(
    epilog="Example: energyplan design --model quadriga:full:concrete --duration 40 --out next.csv"
)
def design(
    model: opt.ModelName,
    diagnosis: Annotated[Path | None, Option(help="What diagnose --json printed.")] = None,
    map_file: Annotated[
        Path | None, Option("--map", help="Default: an empty square of 6 m.")
    ] = None,
    start: Annotated[
        str | None, Option(metavar="X,Y,YAW", help="In metres and radians, or as 90deg.")
    ] = None,
    duration: Annotated[float, Option(help="Longest time of the drive [s].")] = 60.0,
    max_speed: Annotated[float | None, Option(help="Largest tread speed [m/s].")] = None,
    screen: Annotated[bool, Option("--screen", help="Look for every effect.")] = False,
    out: Annotated[
        Path | None, opt.output("Write the trajectory to this CSV file.", *opt.TABLES)
    ] = None,
    json: opt.Json = False,
) -> None:
    """Design the next test drive.

    It is the one that best separates the explanations that are left. Begins at --start, or where
    there is most room.
    """
    from energyplan.diagnosis.design import design as run
    from energyplan.diagnosis.design import explanations_of
    from energyplan.io.config import read_model
    from energyplan.io.sites import read_site
    from energyplan.io.tables import write_trajectory
    from energyplan.output import documents, text
    from energyplan.path import parse_pose

    law = read_model(model)
    explanations = explanations_of(_document(diagnosis)) if diagnosis else ()
    result = run(
        law, explanations, grid=read_site(map_file).grid if map_file else None,
        start=parse_pose(start) if start else None, duration=duration, speed=max_speed,
        screen=screen,
    )  # fmt: skip
    if out:
        write_trajectory(result.trajectory, out)
    answer(documents.design(result), text.design(result), json=json)


def _document(file: Path) -> dict[str, Any]:
    from energyplan.io.documents import MAX_JSON, read_json

    remedy = "give what diagnose --json printed"
    found = read_json(file, MAX_JSON, InvalidInputError, remedy)
    if not isinstance(found, dict):
        raise InvalidInputError(f"{file} is no JSON document; {remedy}")
    return found
