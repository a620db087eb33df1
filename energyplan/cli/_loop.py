"""The commands that drive a robot in a physics engine: drive, close-the-loop, design."""

from __future__ import annotations

import json as jsonlib
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from energyplan.cli._planning import Drive, Heights, MapFile, Start, Surfaces, Work, ground_of
from energyplan.cli.answers import answer, progress, verdict, write_report
from energyplan.cli.app import app
from energyplan.cli.inputs import parse_pose, read_logs
from energyplan.cli.options import TABLES, Json, ModelName, OutModel, Report, Strict, writes
from energyplan.errors import InvalidInputError

if TYPE_CHECKING:
    from energyplan.physics import Effect, Ground, Robot
    from energyplan.power import PowerModel

Effects = Annotated[
    list[str] | None,
    typer.Option(
        "--effect",
        metavar="NAME=SIZE[,DETAIL=VALUE]",
        help="An effect that the simulated robot has and the model lacks; repeatable.",
    ),
]
Hidden = Annotated[
    int | None,
    typer.Option(help="Give the simulated robot one or two secret effects, drawn by this seed."),
]
Truth = Annotated[
    Path | None,
    typer.Option(
        callback=writes(".json"), help="Write the effects that the robot has to this JSON file."
    ),
]


def chosen_effects(
    robot: Robot,
    effects: list[str] | None,
    hidden: int | None,
    truth: Path | None,
    around: tuple[float, float],
) -> tuple[Effect, ...]:
    """Return the effects that were declared, and those that were drawn."""
    from energyplan.io.files import atomic_write
    from energyplan.output.documents import plain
    from energyplan.physics import Effect, draw_effects

    chosen = tuple(Effect.parse(text) for text in effects or ())
    if hidden is not None:
        chosen += draw_effects(robot, hidden, around=around)
    if truth:
        rows = [{"name": e.name, "size": e.size, "details": plain(e.details)} for e in chosen]
        atomic_write(truth, jsonlib.dumps({"effects": rows}, indent=1) + "\n")
    return chosen


def _believed(model: str, surfaces: Path | None, heights: Path | None) -> tuple[PowerModel, Ground]:
    """Return the model and the ground that options name; on heights every model has a weight."""
    from energyplan.physics import Ground

    cost, regions, hills = ground_of(Drive(model, surfaces, heights, at_battery=True))
    return cost.model, Ground(regions, hills)


@app.command(
    epilog="Example: energyplan drive trajectory.csv --model quadriga:full:concrete "
    "--effect viscous_loss=60 --out log.csv"
)
def drive(
    trajectory: Annotated[Path, typer.Argument(help="CSV with columns t,x,y,yaw,v,omega.")],
    model: ModelName,
    effect: Effects = None,
    hidden: Hidden = None,
    truth: Truth = None,
    surfaces: Surfaces = None,
    heights: Annotated[
        Path | None,
        typer.Option(
            help="Heights of the ground: .asc, GeoTIFF, a YAML file with a PNG, or a bag."
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", callback=writes(*TABLES), help="Write the drive log to this file."),
    ] = None,
    sensors: Annotated[
        str,
        typer.Option(
            metavar="NAME=VALUE,...",
            help="How the drive is recorded: rate [Hz], power_noise [W], speed_noise, speed_step "
            "[m/s], current_step [A], delay [s], unsigned=true, measured=sides, total or battery.",
        ),
    ] = "",
    seed: Annotated[int, typer.Option(help="Seed of the sensors' noise.")] = 0,
    json: Json = False,
    strict: Strict = False,
) -> None:
    """Drive a trajectory in a physics engine.

    Prints the predicted energy and the energy that the drive took.
    """
    from energyplan.io.trajectory import read_trajectory, write_log
    from energyplan.output import documents, text
    from energyplan.physics import Robot, Sensors, switch_on
    from energyplan.physics import drive as run

    asked = read_trajectory(trajectory)
    law, ground = _believed(model, surfaces, heights)
    recording = Sensors.parse(sensors, seed)
    robot = Robot.from_model(law)
    middle = asked.poses[len(asked) // 2]
    effects = chosen_effects(robot, effect, hidden, truth, (float(middle[0]), float(middle[1])))
    with progress("driving"):
        made = run(asked, switch_on(robot, effects), law, ground=ground)
    if out:
        write_log(recording.log(made.run, out.name), out)
    secret = hidden is not None
    answer(documents.driven(made, secret=secret), text.driven(made, secret=secret), json=json)
    verdict(made.arrived, strict)


@app.command(
    epilog="Example: energyplan close-the-loop --map warehouse.yaml --model quadriga:full:concrete "
    "--start 2,2,0 --goal 20,12,90deg --hidden 4 --effort 50000 "
    "--report loop.html"
)
def close_the_loop(
    map_file: MapFile,
    model: ModelName,
    start: Start,
    goal: Start,
    surfaces: Surfaces = None,
    heights: Heights = None,
    logs: Annotated[
        Path | None,
        typer.Option(
            help="Folder of a real robot's drive logs, one a round in the order of their names."
        ),
    ] = None,
    effect: Effects = None,
    hidden: Hidden = None,
    truth: Truth = None,
    rounds: Annotated[int, typer.Option(help="Largest number of rounds.")] = 3,
    error: Annotated[
        float,
        typer.Option(help="Stop when the predicted energy is off by less than this fraction."),
    ] = 0.01,
    speed: Annotated[
        float | None,
        typer.Option(
            help="Tread speed to drive at [m/s]. Default: the vehicle's usual speed; without one, "
            "three fifths of its motors', which leaves the controller room."
        ),
    ] = None,
    survey: Annotated[
        float,
        typer.Option(
            help="Longest duration of the test drive after the first wrong prediction [s]; 0: none."
        ),
    ] = 60.0,
    time_limit: Annotated[float, typer.Option(help="Time for each plan [s].")] = 5.0,
    effort: Work = None,
    out: OutModel = None,
    report: Report = None,
    json: Json = False,
    strict: Strict = False,
) -> None:
    """Plan, drive, diagnose, and plan again.

    Diagnoses with all drives so far, until the predicted energy is right.
    """
    from energyplan.cost import EnergyCost
    from energyplan.io.config import write_model
    from energyplan.io.maps import read_map
    from energyplan.output import documents, text
    from energyplan.output.pages import loop_page
    from energyplan.physics import EngineDrives, Robot, close_loop, switch_on
    from energyplan.physics.loop import Source
    from energyplan.planning import PlanningProblem

    law, ground = _believed(model, surfaces, heights)
    problem = PlanningProblem(
        read_map(map_file), EnergyCost(law, battery=True), parse_pose(start), parse_pose(goal),
        surfaces=ground.surfaces, heights=ground.heights,
    )  # fmt: skip
    source: Source
    if logs is not None:
        if effect or hidden is not None:
            raise InvalidInputError("--logs are of a real robot; leave out --effect and --hidden")
        if not logs.is_dir():
            raise InvalidInputError(f"{str(logs)!r} is no folder; give one that holds the logs")
        files = sorted(file for file in logs.iterdir() if file.suffix in TABLES)
        if not files:
            raise InvalidInputError(
                f"{str(logs)!r} holds no log that ends with {', '.join(TABLES)}"
            )
        source = read_logs(files, None, None, problem.cost.vehicle.name)
    else:
        robot = Robot.from_model(problem.cost.model)
        middle = (
            0.5 * (problem.start.x + problem.goal.x),
            0.5 * (problem.start.y + problem.goal.y),
        )
        effects = chosen_effects(robot, effect, hidden, truth, middle)
        source = EngineDrives(switch_on(robot, effects), ground)
    with progress("closing the loop") as update:
        made = close_loop(
            problem, source, rounds=rounds, tolerance=error, speed=speed, survey=survey,
            time_limit=time_limit, effort=effort, progress=update,
        )  # fmt: skip
    if out:
        write_model(made.model, out)
    if report:
        write_report(loop_page(made, problem), report)
    answer(documents.loop(made), text.loop(made), json=json)
    verdict(made.closed, strict)


@app.command(
    epilog="Example: energyplan design --model quadriga:full:concrete --duration 40 --out next.csv"
)
def design(
    model: ModelName,
    diagnosis: Annotated[
        Path | None,
        typer.Option(help="Output of diagnose --json: which explanations to separate."),
    ] = None,
    map_file: Annotated[
        Path | None, typer.Option("--map", help="Map to drive on; without it, an empty square.")
    ] = None,
    square: Annotated[float, typer.Option(help="Side of the empty square [m].")] = 6.0,
    start: Annotated[
        str | None,
        typer.Option(metavar="X,Y,YAW", help="Where to begin; default: where most room is."),
    ] = None,
    duration: Annotated[float, typer.Option(help="Longest time of the drive [s].")] = 60.0,
    speed: Annotated[float | None, typer.Option(help="Largest tread speed [m/s].")] = None,
    noise: Annotated[
        float, typer.Option(help="Standard deviation of the noise of the power [W].")
    ] = 5.0,
    screen: Annotated[
        bool,
        typer.Option("--screen", help="Without --diagnosis: look for every effect."),
    ] = False,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out", callback=writes(*TABLES), help="Write the trajectory to this CSV file."
        ),
    ] = None,
    json: Json = False,
) -> None:
    """Design the next test drive.

    It is the one that best separates the explanations that are left.
    """
    from energyplan.io.config import read_model
    from energyplan.io.maps import read_map
    from energyplan.io.trajectory import write_trajectory
    from energyplan.output import documents, text
    from energyplan.physics.design import design as run
    from energyplan.physics.design import explanations_of

    law = read_model(model)
    explanations = explanations_of(_document(diagnosis)) if diagnosis else ()
    made = run(
        law, explanations, grid=read_map(map_file) if map_file else None, square=square,
        start=parse_pose(start) if start else None, duration=duration, speed=speed, noise=noise,
        screen=screen,
    )  # fmt: skip
    if out:
        write_trajectory(made.trajectory, out)
    answer(documents.design(made), text.design(made), json=json)


def _document(file: Path) -> dict[str, Any]:
    from energyplan.io.documents import MAX_JSON, read_json

    remedy = "give what diagnose --json printed"
    found = read_json(file, MAX_JSON, InvalidInputError, remedy)
    if not isinstance(found, dict):
        raise InvalidInputError(f"{file} is no JSON document; {remedy}")
    return found
