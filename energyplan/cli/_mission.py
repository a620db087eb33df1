"""The commands about what a charge lasts for: range and mission."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer

from energyplan.cli._planning import Drive, Site, Start, problem_of, warn_of_surfaces
from energyplan.cli.answers import answer, progress, verdict, write_report
from energyplan.cli.app import app
from energyplan.cli.inputs import number, parse_pose
from energyplan.cli.options import IMAGES, Json, Report, Strict, writes, writes_folder
from energyplan.errors import InvalidInputError

EachEffort = Annotated[
    int | None,
    typer.Option(
        help="Work to spend on each route instead of time: the same answer on any machine."
    ),
]


@app.command(
    name="range",
    epilog="Example: energyplan range --map warehouse.yaml --model quadriga:empty:concrete "
    "--start 2,2,0 --energy 5000 --return --confidence 0.95 --coefficient-spread 0.05",
)
def reach(
    site: Site,
    drive: Drive,
    start: Start,
    energy: Annotated[float | None, typer.Option(help="Energy at hand [J].")] = None,
    reserve: Annotated[
        float, typer.Option(min=0.0, max=0.99, help="Fraction of it to keep.")
    ] = 0.0,
    battery: Annotated[
        str | None,
        typer.Option(
            metavar="BATTERY", help="Take the energy from this battery: the name of a preset."
        ),
    ] = None,
    soc: Annotated[
        str | None,
        typer.Option(help="State of charge of that battery, such as 50%. Default: full."),
    ] = None,
    confidence: Annotated[
        float | None,
        typer.Option(help="Probability that a place shown as reachable really is, such as 0.95."),
    ] = None,
    spread: Annotated[
        float,
        typer.Option(
            "--coefficient-spread",
            help="Relative standard deviation of each coefficient from day to day.",
        ),
    ] = 0.0,
    back: Annotated[
        bool, typer.Option("--return", help="The robot must still get back to the start.")
    ] = False,
    charger: Annotated[
        str | None,
        typer.Option(metavar="X,Y,YAW", help="The robot must still reach this charger afterwards."),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            callback=writes(".asc"), help="Write the energies [J] to this ESRI ASCII grid."
        ),
    ] = None,
    contours: Annotated[
        Path | None,
        typer.Option(
            callback=writes(".geojson", ".json"),
            help="Write the areas within reach to this GeoJSON file.",
        ),
    ] = None,
    plot: Annotated[
        Path | None,
        typer.Option(
            callback=writes(*IMAGES),
            help="Draw the map and the areas into this file: .png, .svg or .pdf.",
        ),
    ] = None,
    json: Json = False,
) -> None:
    """Find how far a given energy takes the robot.

    Computes the energy that it takes to reach each place of a map, and to come back if asked.
    """
    from energyplan.io.energy_map import write_contours, write_energies
    from energyplan.io.files import atomic_write
    from energyplan.io.mission import read_battery
    from energyplan.output import documents, plots, text
    from energyplan.output.report import image
    from energyplan.studies.energy_map import energy_map, energy_of_charge

    if battery and energy is not None:
        raise InvalidInputError("--battery and --energy both set the energy at hand; give one")
    if soc is not None and battery is None:
        raise InvalidInputError("--soc is the charge of a battery; give --battery, or leave it out")
    if spread != 0 and confidence is None:
        raise InvalidInputError("--coefficient-spread needs --confidence; give both")
    pose = parse_pose(start)
    if battery:  # what a battery delivers is counted at the battery
        drive = replace(drive, at_battery=True)
    problem = problem_of(site, drive, pose, pose)
    home = parse_pose(charger) if charger else pose
    if battery:
        charge = 1.0 if soc is None else number("--soc", "fraction", soc)
        energy = energy_of_charge(problem.cost, read_battery(battery), charge)
    usable = None if energy is None else (1.0 - reserve) * energy
    with progress("searching"):
        found = energy_map(
            problem, energy=math.inf if usable is None else usable,
            back=home if back or charger else None,
            confidence=confidence, coefficient_spread=spread,
        )  # fmt: skip
    areas = found.areas(usable)
    if out:
        write_energies(found, out)
    if contours:
        write_contours(areas, contours)
    if plot:
        atomic_write(plot, image(plots.energy_map(found, problem.map), plot.suffix))
    answer(documents.energy_map(found, areas), text.energy_map(found, areas), json=json)


def _task(text: str) -> dict[str, str]:
    """Return what a task's option says, as a mission's file would hold it."""
    name, _, rest = text.partition("=")
    parts = [part.strip() for part in rest.split(",")]
    if not name.strip() or not 3 <= len(parts) <= 5:
        raise InvalidInputError(
            f"task {text!r} cannot be read; write NAME=X,Y,YAW[,DWELL[,POWER]], such as "
            "meter=3.9,2,90deg,5 min,30 W"
        )
    task = {"name": name.strip(), "pose": ",".join(parts[:3])}
    return task | dict(zip(("dwell", "power"), parts[3:], strict=False))


@app.command(epilog="Example: energyplan mission mission_warehouse.yaml --report mission.html")
def mission(
    file: Annotated[
        Path | None,
        typer.Argument(help="Mission YAML file; without it the options describe the mission."),
    ] = None,
    map_file: Annotated[
        Path | None, typer.Option("--map", help="The map: a YAML file of ROS map_server.")
    ] = None,
    model: Annotated[
        str | None, typer.Option(metavar="MODEL", help="A preset or a YAML file.")
    ] = None,
    battery: Annotated[
        str | None, typer.Option(metavar="BATTERY", help="The name of a preset.")
    ] = None,
    start: Annotated[
        str | None,
        typer.Option(metavar="X,Y,YAW", help="In metres and radians; 90deg is in degrees."),
    ] = None,
    task: Annotated[
        list[str] | None,
        typer.Option(
            metavar="TASK...",
            help="Task NAME=X,Y,YAW[,DWELL[,POWER]], as meter=3.9,2,90deg,5 min,30 W; repeatable.",
        ),
    ] = None,
    soc: Annotated[
        str | None, typer.Option(help="State of charge at the start. Default: 100 %.")
    ] = None,
    reserve: Annotated[
        str | None, typer.Option(help="What must be left at the end. Default: 20 %.")
    ] = None,
    back: Annotated[bool, typer.Option("--return", help="Return to the start.")] = False,
    confidence: Annotated[
        float | None,
        typer.Option(help="Probability that a verdict holds. Default: the file's, or 0.95."),
    ] = None,
    spread: Annotated[
        float | None,
        typer.Option(
            help="Relative standard deviation of the model's coefficients from day to day, as 0.05."
        ),
    ] = None,
    fail: Annotated[
        str | None,
        typer.Option(
            metavar="NAME@TIME",
            help="Suppose that this robot of several fails at this time [s]: who takes over?",
        ),
    ] = None,
    effort: EachEffort = None,
    report: Report = None,
    trajectories: Annotated[
        Path | None,
        typer.Option(
            callback=writes_folder,
            help="Write each drive to this folder (t,x,y,yaw,v,omega), and into --json.",
        ),
    ] = None,
    json: Json = False,
    strict: Strict = False,
) -> None:
    """Find out whether the battery lasts for a mission.

    Names the tasks that cannot be done, why, and what would change that. A file with robots is
    shared between them: which robot does which task, and when it charges.
    """
    from energyplan.io.fleet import names_robots
    from energyplan.io.mission import mission_from, read_mission
    from energyplan.mission import evaluate
    from energyplan.output import documents, text
    from energyplan.output.pages import mission_page

    told_by: dict[str, Any] = {
        "map": map_file,
        "model": model,
        "battery": battery,
        "start": start,
        "task": task,
    }
    if file is not None:
        told_by |= {"soc": soc, "reserve": reserve, "return": back}
        clash = [f"--{name}" for name, value in told_by.items() if value]
        if clash:
            raise InvalidInputError(
                f"the mission's file already sets what {', '.join(clash)} would; drop "
                f"{'it' if len(clash) == 1 else 'them'}, or give no file"
            )
        if names_robots(file):
            if report or trajectories or confidence is not None or spread is not None:
                raise InvalidInputError(
                    f"{file} is a mission of several robots, for which --report, --trajectories, "
                    "--confidence and --spread do not work yet; leave them out"
                )
            _robots(file, fail, effort, json, strict)
            return
        asked = read_mission(file)
    else:
        missing = [f"--{name}" for name, value in told_by.items() if not value]
        if missing:
            raise InvalidInputError(
                f"without a mission's file {', '.join(missing)} must be given; docs/missions lists "
                "what a file may contain"
            )
        asked = mission_from(
            {
                "name": "mission", "model": model, "map": str(map_file), "battery": battery,
                "start": start, "soc": soc or "100 %", "reserve": reserve or "20 %",
                "return_to": "start" if back else "any",
                "tasks": [_task(text) for text in task or []],
            }
        )  # fmt: skip
    if fail is not None:
        raise InvalidInputError("--fail goes with a mission's file that has robots; leave it out")
    stated: dict[str, Any] = {
        "planning_effort": effort,
        "confidence": confidence,
        "coefficient_spread": spread,
    }
    asked = replace(asked, **{name: value for name, value in stated.items() if value is not None})
    if asked.surfaces is not None:
        warn_of_surfaces(asked.model.vehicle, asked.surfaces)
    with progress("evaluating the mission"):
        told = evaluate(asked)
    if trajectories:
        from energyplan.io.trajectory import write_trajectory

        trajectories.mkdir(parents=True, exist_ok=True)
        for k, leg in enumerate(told.trajectories, start=1):
            write_trajectory(leg, trajectories / f"leg_{k:02d}.csv")
    if report:
        write_report(mission_page(told), report)
    answer(documents.mission(told, bool(trajectories)), text.mission(told), json=json)
    verdict(told.feasible, strict)


def _robots(file: Path, fail: str | None, effort: int | None, json: bool, strict: bool) -> None:
    """Share the tasks of a mission between its robots."""
    from energyplan.fleet import Fleet, evaluate_fleet
    from energyplan.io.fleet import read_fleet
    from energyplan.output import documents, text

    name, instant = _failure(fail)
    asked = read_fleet(file)
    if effort is not None:
        robots = [
            replace(robot, mission=replace(robot.mission, planning_effort=effort))
            for robot in asked.robots
        ]
        asked = Fleet(tuple(robots), asked.places, asked.name)
    with progress("evaluating the fleet"):
        told = evaluate_fleet(asked)
        after = evaluate_fleet(told.after_failure(name, instant)) if name else None
    document, lines = documents.fleet(told), text.fleet(told)
    if after is not None:
        document["after_failure"] = {"robot": name, "time": instant, **documents.fleet(after)}
        lines += [f"if {name} fails at {instant:g} s:", *text.fleet(after)]
    answer(document, lines, json=json)
    verdict(told.feasible and (after is None or after.feasible), strict)


def _failure(text: str | None) -> tuple[str, float]:
    """Return which robot fails, and when; an empty name where none does."""
    if text is None:
        return "", 0.0
    name, _, instant = text.rpartition("@")
    try:
        time = float(instant)
    except ValueError:
        name = ""
        time = 0.0
    if not name:
        raise InvalidInputError(f"--fail {text!r} cannot be read; write NAME@SECONDS, as beta@600")
    return name, time
