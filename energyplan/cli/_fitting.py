"""The commands that read drive logs: identify, diagnose, log."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from energyplan.cli.common import (
    App,
    Columns,
    Json,
    Logs,
    Method,
    OutModel,
    Report,
    Strict,
    Topics,
    VehicleName,
    answer,
    app,
    notes,
    progress,
    read_logs,
    verdict,
    warn,
)
from energyplan.errors import (
    InvalidInputError,
)

if TYPE_CHECKING:
    from energyplan.logs import DriveLog


@app.command(
    epilog="Example: energyplan identify spiral.csv --vehicle quadriga:full --out model.yaml"
)
def identify(
    logs: Logs,
    vehicle: VehicleName,
    method: Method = "lad",
    out: OutModel = None,
    columns: Columns = None,
    topics: Topics = "husky",
    json: Json = False,
) -> None:
    """Find a robot's power parameters on some ground from its drive logs."""
    from energyplan.fit import identify as run
    from energyplan.io.config import read_vehicle, write_model
    from energyplan.output import documents, text

    robot = read_vehicle(vehicle)
    drives = read_logs(logs, columns, topics)
    found = run(drives, robot, method=method)
    found = replace(found, warnings=(*notes(drives), *found.warnings))
    if out:
        write_model(found.model, out)
    answer(documents.identification(found), text.identification(found), json=json)


@app.command(
    epilog="Example: energyplan diagnose a.csv b.csv --holdout c.csv --vehicle quadriga "
    "--out extended.yaml --report diagnosis.html"
)
def diagnose(
    logs: Logs,
    holdout: Annotated[
        list[Path],
        typer.Option(metavar="LOG...", help="Drives kept for judging: all up to the next option."),
    ],
    vehicle: VehicleName,
    out: OutModel = None,
    report: Report = None,
    columns: Columns = None,
    topics: Topics = "husky",
    json: Json = False,
    strict: Strict = False,
) -> None:
    """Trace the residual of the power model to an effect, add it, and report before and after."""
    from energyplan.diagnosis import diagnose as run
    from energyplan.io.config import read_vehicle, write_model
    from energyplan.io.files import atomic_write
    from energyplan.output import documents, text
    from energyplan.output.pages import diagnosis_page

    robot = read_vehicle(vehicle)
    _apart(logs, holdout)
    training, judging = read_logs(logs, columns, topics), read_logs(holdout, columns, topics)
    parts = {"training": _names(training), "judging": _names(judging)}
    for note in notes([*training, *judging]):
        warn(note)
    with progress("diagnosing") as update:
        told = run(training, holdout=judging, vehicle=robot, progress=update)
    if out:
        write_model(told.model, out)
    if report:
        page = diagnosis_page(told, judging)
        page.bullets([f"{part}: {', '.join(names)}" for part, names in parts.items()])
        atomic_write(report, page.html())
    lines = [f"{part}: {', '.join(names)}" for part, names in parts.items()]
    answer({**parts, **documents.diagnosis(told)}, [*lines, *text.diagnosis(told)], json=json)
    verdict(told.verdict != "unexplained", strict)


def _apart(logs: list[Path], holdout: list[Path]) -> None:
    """Refuse a drive that is to be learned from and judged on, by whatever name."""
    for path in logs:
        for other in holdout:
            if path.exists() and other.exists() and path.samefile(other):
                raise InvalidInputError(
                    f"{path.name} is learned from and held out; give it to one of them"
                )


def _names(drives: list[DriveLog]) -> list[str]:
    return [drive.name for drive in drives]


log = App(rich_markup_mode=None, help="Look into drive logs.")
app.add_typer(log, name="log")


@log.command(epilog="Example: energyplan log info drive.csv")
def info(
    file: Annotated[Path, typer.Argument(help="A table or a bag.")], json: Json = False
) -> None:
    """List what a log holds, and what it could serve for."""
    from energyplan.io.logs import describe_log
    from energyplan.output import documents, text

    told = describe_log(file)
    answer(documents.plain(told), text.log(told), json=json)
