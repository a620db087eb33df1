"""What all commands share: the app, options, output, progress."""

from __future__ import annotations

import json as jsonlib
import math
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from energyplan.errors import InvalidInputError

if TYPE_CHECKING:
    from energyplan.logs import DriveLog
    from energyplan.path import Pose

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


def say(text: str) -> None:
    """Print a line of the answer."""
    sys.stdout.write(text + "\n")


def warn(text: str) -> None:
    """Print a line that is no part of the answer."""
    sys.stderr.write(text + "\n")


def answer(document: dict[str, Any], lines: list[str], *, json: bool) -> None:
    """Print the answer, as JSON or as lines of text."""
    if json:
        say(jsonlib.dumps(document, indent=1, allow_nan=False))
    else:
        say("\n".join(lines))


def verdict(yes: bool, strict: bool) -> None:
    """End with another exit code where the answer is no and ``--strict`` was given."""
    if strict and not yes:
        raise typer.Exit(NO)


@contextmanager
def progress(text: str) -> Iterator[Any]:
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


def read_logs(paths: list[Path], columns: str | None, topics: str) -> list[DriveLog]:
    """Read drive logs."""
    from energyplan.io.logs import read_log

    with progress("reading") as update:
        return [read_log(path, columns, topics=topics, progress=update) for path in paths]


def notes(logs: list[DriveLog]) -> list[str]:
    """Return what the readers of logs warned of."""
    return [f"{log.name}: {warning}" for log in logs for warning in log.warnings]


def parse_pose(text: str) -> Pose:
    """Return the pose that ``X,Y,YAW`` stands for."""
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
