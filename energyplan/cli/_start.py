"""The command start."""

from __future__ import annotations

import math
import sys
from pathlib import Path
from typing import Annotated

import typer

from energyplan.cli.answers import answer, progress, verdict
from energyplan.cli.app import app
from energyplan.cli.options import YAML, Json, Strict, writes
from energyplan.errors import InvalidInputError


@app.command(
    epilog="Example: energyplan start foreign.csv --track 0.5 --wheelbase 0.475 --mass 147 "
    "--out robot.yaml"
)
def start(
    log: Annotated[Path, typer.Argument(help="A drive log: a table or a bag.")],
    out: Annotated[
        Path, typer.Option(callback=writes(*YAML), help="Write the project to this YAML file.")
    ],
    wheel_radius: Annotated[
        float | None, typer.Option(metavar="M", help="Radius of the wheels.")
    ] = None,
    track: Annotated[
        float | None,
        typer.Option(
            metavar="M", help="Distance between the left and the right wheels' contact points."
        ),
    ] = None,
    wheelbase: Annotated[
        float | None,
        typer.Option(
            metavar="M", help="Distance between the front and the rear wheels' contact points."
        ),
    ] = None,
    mass: Annotated[
        float | None,
        typer.Option(metavar="KG", help="Mass of the robot as it drives, payload included."),
    ] = None,
    counts_per_revolution: Annotated[
        float | None,
        typer.Option(metavar="N", help="What an encoder counts while the wheel turns once."),
    ] = None,
    length: Annotated[
        float | None, typer.Option(metavar="M", help="Length of the footprint.")
    ] = None,
    width: Annotated[
        float | None, typer.Option(metavar="M", help="Width of the footprint.")
    ] = None,
    name: Annotated[str, typer.Option(help="Name of the robot.")] = "",
    like: Annotated[
        str | None,
        typer.Option(
            metavar="VEHICLE",
            help="Take what is not given from this vehicle: a preset or a YAML file.",
        ),
    ] = None,
    columns: Annotated[
        str | None,
        typer.Option(help="Columns that you know, such as v_left=velL; the others are guessed."),
    ] = None,
    json: Json = False,
    strict: Strict = False,
) -> None:
    """Write a project from a drive log.

    Shows what the log contains, and checks it against the robot. Guesses columns, topics and
    units. What it cannot know it takes from the options, or asks for on a terminal. Other commands
    read the project with --project.
    """
    from energyplan.io.config import read_vehicle
    from energyplan.io.project import write_project
    from energyplan.io.robot import Given
    from energyplan.io.start import start as run
    from energyplan.output import documents, text

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
    write_project(made.project, out)
    answer(documents.start(made), [*text.start(made), f"written: {out}"], json=json)
    verdict(made.sound, strict)


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
