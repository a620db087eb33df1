"""The commands that read drive logs: start, identify, diagnose."""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from energyplan.cli.answers import answer, progress, verdict, warn, write_report
from energyplan.cli.app import app
from energyplan.cli.inputs import contradictions, notes, number, read_logs
from energyplan.cli.options import (
    YAML,
    Columns,
    Json,
    Logs,
    OutModel,
    Report,
    Strict,
    Topics,
    VehicleName,
    writes,
)
from energyplan.errors import InvalidInputError, NotIdentifiableError, UnknownNameError

if TYPE_CHECKING:
    from energyplan.fit import ICREstimate
    from energyplan.fit.hoisted import InternalFriction
    from energyplan.logs import DriveLog
    from energyplan.power import Term


@app.command(
    epilog="Example: energyplan start foreign.csv --track 0.5 --wheelbase 0.475 --mass 147 "
    "--out robot.yaml"
)
def start(
    log: Annotated[Path, typer.Argument(help="A drive log: a table or a bag.")],
    out: Annotated[
        Path | None,
        typer.Option(
            callback=writes(*YAML),
            help="Write the project to this YAML file. Without it: list what the log holds.",
        ),
    ] = None,
    wheel_radius: Annotated[float | None, typer.Option(help="Radius of the wheels [m].")] = None,
    track: Annotated[
        float | None,
        typer.Option(help="Distance between the left and the right wheels' contact points [m]."),
    ] = None,
    wheelbase: Annotated[
        float | None,
        typer.Option(help="Distance between the front and the rear wheels' contact points [m]."),
    ] = None,
    mass: Annotated[
        float | None,
        typer.Option(help="Mass of the robot as it drives, payload included [kg]."),
    ] = None,
    counts_per_revolution: Annotated[
        float | None,
        typer.Option(metavar="N", help="What an encoder counts while the wheel turns once."),
    ] = None,
    length: Annotated[float | None, typer.Option(help="Length of the footprint [m].")] = None,
    width: Annotated[float | None, typer.Option(help="Width of the footprint [m].")] = None,
    name: Annotated[str, typer.Option(help="Name of the robot.")] = "",
    like: Annotated[
        str | None,
        typer.Option(
            metavar="VEHICLE",
            help="Start from this vehicle, a preset or a YAML file; other options override it.",
        ),
    ] = None,
    columns: Annotated[
        str | None,
        typer.Option(help="Columns that you know, such as v_left=velL; the others are guessed."),
    ] = None,
    accept: Annotated[
        bool, typer.Option("--accept", help="Accept a log that contradicts itself or the robot.")
    ] = False,
    json: Json = False,
    strict: Strict = False,
) -> None:
    """Write a project from a drive log.

    Shows what the log contains, and checks it against the robot: a log that contradicts itself or
    the robot makes no project, unless you accept that. Guesses columns, topics and units. What it
    cannot know it takes from the options, or asks for on a terminal. Other commands read the
    project with --project.
    """
    from energyplan.io.config import read_vehicle
    from energyplan.io.given import Given
    from energyplan.io.logs import describe_log
    from energyplan.io.project import write_project
    from energyplan.io.start import start as run
    from energyplan.output import documents, text

    if out is None:
        held = describe_log(log)
        lines = [*text.log(held), "give --out PROJECT.yaml to check it and write a project"]
        answer(documents.plain(held), lines, json=json)
        return
    told = {
        "wheel_radius": wheel_radius, "track": track, "wheelbase": wheelbase, "mass": mass,
        "length": length, "width": width, "counts_per_revolution": counts_per_revolution,
    }  # fmt: skip
    vehicle = None if like is None else read_vehicle(like)
    if vehicle is None and not json and sys.stdin.isatty() and sys.stderr.isatty():
        for key, question in _QUESTIONS.items():
            if told[key] is None:
                told[key] = _ask(question)
    given = Given(
        **{key: math.nan if value is None else value for key, value in told.items()},
        name=name, like=vehicle, columns=columns,
    )  # fmt: skip
    with progress("looking into the log"):
        made = run(log, given)
    written = made.sound or accept
    if written:
        write_project(made.project, out)
    done = (
        f"written: {out}"
        if written
        else (f"not written: {out}; mend what is WRONG, or write it all the same with --accept")
    )
    answer(documents.start(made), [*text.start(made), done], json=json)
    verdict(made.sound, strict or not written)


_QUESTIONS = {
    "track": "Distance of the left from the right wheels' contact points [m]",
    "wheelbase": "Distance of the front from the rear wheels' contact points [m]",
    "mass": "Mass as it drives [kg]",
}


def _ask(question: str) -> float | None:
    """Ask for a number on the terminal; an empty answer leaves it to the log."""
    text = typer.prompt(f"{question}, empty for a guess", default="", show_default=False, err=True)
    try:
        return float(text) if text.strip() else None
    except ValueError:
        raise InvalidInputError(f"{text!r} is no number; write it like 0.555") from None


Method = Annotated[
    Literal["lad", "simplex", "huber", "windows"],
    typer.Option(
        help="lad: least absolute deviations, exact; simplex: the same by the paper's search; "
        "huber: robust least squares; windows: as diagnose fits, both sides, means over 0.5 to 8 s."
    ),
]


@app.command(
    epilog="Example: energyplan identify spiral.csv --vehicle quadriga:full --out model.yaml"
)
def identify(
    logs: Logs,
    vehicle: VehicleName,
    method: Method = "lad",
    terms: Annotated[
        str | None,
        typer.Option(
            metavar="NAME,NAME",
            help="Terms of the model. Default: slip_friction,traction_resistance.",
        ),
    ] = None,
    without: Annotated[
        str | None,
        typer.Option(metavar="NAME,NAME", help="Terms to leave out, such as slip_friction."),
    ] = None,
    hoisted: Annotated[
        bool,
        typer.Option(
            "--hoisted", help="The wheels were off the ground: find the friction inside each side."
        ),
    ] = False,
    motor_constant: Annotated[
        float | None,
        typer.Option(
            metavar="K", help="With --hoisted: force per ampere of each side's motor [N/A]."
        ),
    ] = None,
    spin: Annotated[
        bool,
        typer.Option(
            "--spin",
            help="The log holds one spin on the spot: find the tread ICRs alone (Morales et al. "
            "2010, Eq. 5). --out then writes the vehicle with them.",
        ),
    ] = False,
    angle: Annotated[
        str | None,
        typer.Option(
            help="With --spin: angle turned through, such as 3600deg. Default: from the log's yaw."
        ),
    ] = None,
    angle_error: Annotated[
        str, typer.Option(help="With --angle: its standard error, such as 5deg.")
    ] = "0deg",
    out: OutModel = None,
    columns: Columns = None,
    topics: Topics = None,
    json: Json = False,
) -> None:
    """Find a robot's power parameters from drive logs.

    The method lad minimises the cost of Morales et al. (2010), "the paper", Eq. 7, exactly; simplex
    does so by the paper's search.
    """
    from energyplan.fit import identify as run
    from energyplan.fit.hoisted import doubts_off_the_ground
    from energyplan.fit.hoisted import hoisted as inside
    from energyplan.io.config import read_vehicle, write_model, write_vehicle
    from energyplan.output import documents, text

    robot = read_vehicle(vehicle)
    if motor_constant is not None and not hoisted:
        raise InvalidInputError("--motor-constant goes with --hoisted; give both or neither")
    if angle is not None and not spin:
        raise InvalidInputError("--angle goes with --spin; give both or neither")
    if spin and (hoisted or terms or without):
        raise InvalidInputError("--spin finds the tread ICRs alone; leave other options out")
    if spin and len(logs) > 1:
        raise InvalidInputError("--spin takes one log; cut the spin out, or leave --spin out")
    drives = read_logs(logs, columns, topics, vehicle)
    if spin:
        icr = _icr_of_spin(drives[0], angle, angle_error)
        if out:
            write_vehicle(robot.with_icr(icr.icr), out)
        answer(documents.icr(icr), text.icr(icr), json=json)
        return
    if hoisted:
        if out or terms or without:
            raise InvalidInputError("--hoisted makes no model; leave out --out and the terms")
        sides = inside(drives, motor_constant)
        drives = [replace(log, warnings=doubts_off_the_ground(log)) for log in drives]
        told = [*notes(drives), *_doubts_inside(sides, motor_constant)]
        document = {"sides": documents.plain(sides), "warnings": told}
        answer(document, [*text.hoisted(sides), *_noted(told)], json=json)
        return
    found = run(drives, robot, terms=_terms(terms, without), method=method)
    doubts = (*notes(drives, found.warnings), *contradictions(drives, robot))
    found = replace(found, warnings=(*doubts, *found.warnings))
    if out:
        write_model(found.model, out)
    answer(documents.identification(found), text.identification(found), json=json)


def _icr_of_spin(drive: DriveLog, angle: str | None, angle_error: str) -> ICREstimate:
    """Return the tread ICRs from one spin; doubt an angle that the log contradicts."""
    from energyplan.fit import icr_from_spin

    turned = None if angle is None else number("--angle", "angle", angle)
    found = icr_from_spin(drive, turned, number("--angle-error", "angle", angle_error))
    with suppress(NotIdentifiableError):  # the log need not show the angle
        shown = icr_from_spin(drive).turning
        if abs(shown - found.turning) > 0.1 * found.turning:
            warn(
                f"--angle {angle} is {found.turning:.4g} rad, but by its yaw the log turns "
                f"through {shown:.4g} rad in all, to either side; which is right?"
            )
    return found


def _doubts_inside(sides: Sequence[InternalFriction], motor_constant: float | None) -> list[str]:
    """Warn where a force falls with speed as if the power did not depend on it."""
    if motor_constant is not None:
        return []
    return [
        f"{side.side}: the power hardly grows with speed, as if it were voltage times motor "
        "current; then give the force per ampere, as in --motor-constant 21.4 for a Husky"
        for side in sides
        if side.slope < -0.5 * side.force / side.speed and side.slope < -3 * side.slope_error
    ]


def _noted(lines: list[str]) -> list[str]:
    return [f"note: {line}" for line in lines]


def _terms(terms: str | None, without: str | None) -> list[Term]:
    """Return the terms that a model is to have."""
    from energyplan.power import SLIP, TRACTION
    from energyplan.power.effects import term

    names = [name.strip() for name in (terms or "").split(",") if name.strip()]
    chosen = [term(name) for name in names] if names else [SLIP, TRACTION]
    for name in [name.strip() for name in (without or "").split(",") if name.strip()]:
        if name not in [one.name for one in chosen]:
            raise UnknownNameError("term to leave out", name, [one.name for one in chosen])
        chosen = [one for one in chosen if one.name != name]
    if not chosen:
        raise InvalidInputError("--without leaves no term to identify; leave one in")
    return chosen


@app.command(
    epilog="Example: energyplan diagnose a.csv b.csv --holdout c.csv --vehicle quadriga "
    "--out extended.yaml --report diagnosis.html"
)
def diagnose(
    logs: Logs,
    vehicle: VehicleName,
    holdout: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="LOG...",
            help="Drives kept for validation. Default: the last 40 % of each drive; of drives "
            "under 40 s some as a whole.",
        ),
    ] = None,
    out: OutModel = None,
    report: Report = None,
    columns: Columns = None,
    topics: Topics = None,
    json: Json = False,
    strict: Strict = False,
) -> None:
    """Find out why the model and the logs differ.

    Traces the residual of the power model to effects, adds them to the model, and reports the error
    before and after on hold-out drives.
    """
    from energyplan.diagnosis import diagnose as run
    from energyplan.fit import split_drives
    from energyplan.io.config import read_vehicle, write_model
    from energyplan.logs.clean import set_aside_by_drive
    from energyplan.output import documents, text
    from energyplan.output.pages import diagnosis_page

    robot = read_vehicle(vehicle)
    _apart(logs, holdout or [])
    training = read_logs(logs, columns, topics, vehicle)
    judging = read_logs(holdout, columns, topics, vehicle) if holdout else []
    read = [*training, *judging]
    for note in (*notes(read), *contradictions(read, robot)):
        warn(note)
    if not judging:
        training, judging = split_drives(training)
    parts = {"training": _names(training), "judging": _names(judging)}
    with progress("diagnosing") as update:
        told = run(training, holdout=judging, vehicle=robot, progress=update)
    told = replace(told, set_aside=set_aside_by_drive(read))
    if out:
        write_model(told.model, out)
    if report:
        page = diagnosis_page(told, judging)
        page.heading("Drives")
        page.bullets([f"{part}: {', '.join(names)}" for part, names in parts.items()])
        write_report(page, report)
    lines = [f"{part}: {', '.join(names)}" for part, names in parts.items()]
    answer({**parts, **documents.diagnosis(told)}, [*lines, *text.diagnosis(told)], json=json)
    verdict(told.verdict != "unexplained", strict)


def _apart(logs: list[Path], holdout: list[Path]) -> None:
    """Refuse a drive that is to be learned from and judged on, by whatever name."""
    for path in logs:
        for other in holdout:
            if path.exists() and other.exists() and path.samefile(other):
                raise InvalidInputError(
                    f"{path.name} is both a training and a hold-out drive; leave it in one list"
                )


def _names(drives: list[DriveLog]) -> list[str]:
    return [drive.name for drive in drives]
