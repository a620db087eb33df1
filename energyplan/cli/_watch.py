"""The command that learns while driving: watch."""

from __future__ import annotations

import json as jsonlib
import signal
import sys
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Annotated, Any

import typer

from energyplan.cli.answers import give_up_stdout, say, warn_of_presets
from energyplan.cli.app import app
from energyplan.cli.inputs import number
from energyplan.cli.options import YAML, Columns, Json, OutModel
from energyplan.errors import InvalidInputError

if TYPE_CHECKING:
    from energyplan.live import Event, Line, Restart

_POLL = 0.2
"""Time between two looks at a file that does not grow [s]."""


@app.command(
    epilog="Example: energyplan watch drive.csv --vehicle husky_a200 --once --out model.yaml"
)
def watch(
    log: Annotated[str, typer.Argument(help="A CSV log that grows, or - for standard input.")],
    model: Annotated[
        str | None,
        typer.Option(metavar="MODEL", help="Model to begin with: a preset or a YAML file."),
    ] = None,
    vehicle: Annotated[
        str | None,
        typer.Option(
            metavar="VEHICLE",
            help="Instead of a model: the vehicle alone, a preset or a YAML file.",
        ),
    ] = None,
    mission: Annotated[
        Path | None, typer.Option(help="YAML file of the mission that the robot is on.")
    ] = None,
    columns: Columns = None,
    once: Annotated[
        bool, typer.Option("--once", help="Stop at the end of the file; do not wait for more.")
    ] = False,
    every: Annotated[float, typer.Option(help="Time between two reports [s].")] = 10.0,
    mission_every: Annotated[
        float, typer.Option(help="Time between two assessments of the rest of the mission [s].")
    ] = 60.0,
    near: Annotated[
        float,
        typer.Option(
            help="Largest distance from a task's place at which a resting robot does the task [m]."
        ),
    ] = 0.5,
    soc: Annotated[
        str | None,
        typer.Option(help="State of charge at the start of the log. Default: the mission's."),
    ] = None,
    done: Annotated[
        list[str] | None, typer.Option(metavar="NAME...", help="Tasks that are already done.")
    ] = None,
    out: OutModel = None,
    json: Json = False,
) -> None:
    """Follow a drive while it happens.

    Learns the robot's model, says when the ground changes, and evaluates the rest of the mission.
    One line for each event; with --json each is a JSON document. Ctrl-C ends it.
    """
    from energyplan.io.config import read_model, read_vehicle, write_model
    from energyplan.io.mission import read_mission
    from energyplan.live import Ended, Learned, follow, lines_of
    from energyplan.live import watch as events
    from energyplan.live.watcher import Settings
    from energyplan.output import documents, text

    if model and vehicle:
        raise InvalidInputError("--model and --vehicle: a model has its vehicle; give one of them")
    if not (model or vehicle or mission):
        raise InvalidInputError("the robot is not known; give --model, --vehicle or --mission")
    for name, given in (("--soc", soc), ("--done", done)):
        if given is not None and mission is None:
            raise InvalidInputError(f"{name} goes with --mission; give both or neither")
    prior = read_model(model) if model else read_vehicle(vehicle) if vehicle else None
    settings = Settings(
        every, mission_every, near, None if soc is None else number("--soc", "fraction", soc),
        tuple(done or ()),
    )  # fmt: skip
    asked = read_mission(mission) if mission else None
    lines = lines_of(sys.stdin.buffer) if log == "-" else follow(log, None if once else _wait)
    learned: Any = None
    try:
        with _until_interrupted(lines) as wanted:
            found = events(
                wanted, prior, asked, columns=_mapping(columns), name=log, settings=settings
            )
            for k, event in enumerate(found):
                if k == 0:
                    warn_of_presets()  # with the answer: an error stays one line
                _tell(event, json, documents.event, text.event)
                if isinstance(event, Learned | Ended):
                    learned = event.model if isinstance(event, Learned) else learned
                    if out and learned is not None:
                        write_model(learned, out)
    except BrokenPipeError:
        give_up_stdout()  # whoever read has seen enough
        if out and learned is not None:
            write_model(learned, out)


def _mapping(columns: str | None) -> Any:
    """Return a column mapping, from its file if it is one."""
    from energyplan.io.project import read_columns

    return read_columns(columns) if columns and columns.endswith(YAML) else columns


def _wait() -> bool:
    time.sleep(_POLL)
    return True


def _tell(event: Event, json: bool, document: Any, lines: Any) -> None:
    if json:
        say(jsonlib.dumps(document(event), allow_nan=False))
    else:
        say("\n".join(lines(event)))
    sys.stdout.flush()


@contextmanager
def _until_interrupted(
    lines: Iterable[Line | Restart],
) -> Iterator[Iterator[Line | Restart]]:
    """Let Ctrl-C end the lines, so that what follows from them is still told."""
    stopped = waiting = False

    def stop(number: int, frame: FrameType | None) -> None:
        nonlocal stopped
        stopped = True
        if waiting:
            raise KeyboardInterrupt

    def wanted() -> Iterator[Line | Restart]:
        nonlocal waiting
        source = iter(lines)
        while not stopped:
            waiting = True
            try:
                line = next(source, None)
            except KeyboardInterrupt:
                return
            finally:
                waiting = False
            if line is None:
                return
            yield line

    try:
        before = signal.signal(signal.SIGINT, stop)
    except ValueError:  # not the main thread, which alone gets signals
        yield wanted()
        return
    try:
        yield wanted()
    finally:
        signal.signal(signal.SIGINT, before)
