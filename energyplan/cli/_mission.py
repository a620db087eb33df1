"""The command mission."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from energyplan.cli.answers import answer, progress, verdict, write_report
from energyplan.cli.app import app
from energyplan.cli.options import Json, Report, Strict, writes_folder
from energyplan.errors import InvalidInputError

if TYPE_CHECKING:
    from energyplan.mission import Mission


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
            help="NAME=X,Y,YAW[,DWELL[,POWER]], as meter=3.9,2,90deg,5 min,30 W: all up to the "
            "next option.",
        ),
    ] = None,
    requests: Annotated[
        Path | None,
        typer.Option(help="Tasks from Open-RMF requests (JSON) instead of the file's own."),
    ] = None,
    soc: Annotated[
        str | None, typer.Option(help="State of charge at the start. Default: 100 %.")
    ] = None,
    reserve: Annotated[
        str | None, typer.Option(help="What must be left at the end. Default: 20 %.")
    ] = None,
    back: Annotated[bool, typer.Option("--return", help="Return to the start.")] = False,
    effort: Annotated[
        int | None,
        typer.Option(
            help="Work to spend on each route instead of time: the same answer on any machine."
        ),
    ] = None,
    report: Report = None,
    trajectories: Annotated[
        Path | None,
        typer.Option(
            callback=writes_folder,
            help="Write each drive between two stops to this folder, as t,x,y,yaw,v,omega.",
        ),
    ] = None,
    json: Json = False,
    strict: Strict = False,
) -> None:
    """Find out whether the battery lasts for a mission.

    Names the tasks that cannot be done, why, and what would change that.
    """
    from energyplan.io.mission import mission_from, read_mission
    from energyplan.mission import evaluate
    from energyplan.mission.legs import compiling
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
            raise InvalidInputError(f"{', '.join(clash)} and a mission's file: give one of them")
        asked = read_mission(file) if requests is None else _requested(file, requests)
    elif requests is not None:
        raise InvalidInputError("--requests needs a mission's file, which names the places")
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
    if effort is not None:
        asked = replace(asked, planning_effort=effort)
    with progress("evaluating the mission"), compiling(asked):
        told = evaluate(asked)
    if trajectories:
        from energyplan.io.trajectory import write_trajectory

        trajectories.mkdir(parents=True, exist_ok=True)
        for k, leg in enumerate(told.trajectories, start=1):
            write_trajectory(leg, trajectories / f"leg_{k:02d}.csv")
    if report:
        write_report(mission_page(told), report)
    answer(documents.mission(told), text.mission(told), json=json)
    verdict(told.feasible, strict)


def _requested(file: Path, requests: Path) -> Mission:
    """Return a mission with the tasks of Open-RMF's requests."""
    from energyplan.io.fleet import read_mission_for
    from energyplan.openrmf.tasks import read_requests, tasks_of

    asked = read_requests(requests)
    return read_mission_for(file, lambda places: tasks_of(asked, places, requests.name))


@app.command(epilog="Example: energyplan fleet examples/fleet_warehouse.yaml --fail alpha@100")
def fleet(
    file: Annotated[Path, typer.Argument(help="Fleet YAML file.")],
    fail: Annotated[
        str | None,
        typer.Option(
            metavar="NAME@TIME",
            help="Suppose that this robot fails at this time [s]: who takes over?",
        ),
    ] = None,
    effort: Annotated[
        int | None,
        typer.Option(
            help="Work to spend on each route instead of time: the same answer on any machine."
        ),
    ] = None,
    json: Json = False,
    strict: Strict = False,
) -> None:
    """Share tasks between robots.

    Says which robot does which task, when it charges, and what is left in its battery.
    """
    from energyplan.fleet import Fleet, evaluate_fleet
    from energyplan.io.fleet import read_fleet
    from energyplan.mission.legs import compiling
    from energyplan.output import documents, text

    name, instant = _failure(fail)
    asked = read_fleet(file)
    if effort is not None:
        robots = [
            replace(robot, mission=replace(robot.mission, planning_effort=effort))
            for robot in asked.robots
        ]
        asked = Fleet(tuple(robots), asked.places, asked.name)
    missions = [robot.mission for robot in asked.robots]
    with progress("evaluating the fleet"), compiling(*missions):
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
