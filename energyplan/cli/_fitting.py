"""The commands that read drive logs: identify, diagnose, log."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from energyplan.cli.common import (
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
    pass


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
    holdout: Annotated[list[Path], typer.Option(help="Drives kept for judging; repeatable.")],
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
    for path in {path.resolve() for path in logs} & {path.resolve() for path in holdout}:
        raise InvalidInputError(f"{path.name} is learned from and held out; give it to one of them")
    training, judging = read_logs(logs, columns, topics), read_logs(holdout, columns, topics)
    for note in notes([*training, *judging]):
        warn(note)
    with progress("diagnosing") as update:
        told = run(training, holdout=judging, vehicle=robot, progress=update)
    if out:
        write_model(told.model, out)
    if report:
        atomic_write(report, diagnosis_page(told, judging).html())
    answer(documents.diagnosis(told), text.diagnosis(told), json=json)
    verdict(told.verdict != "unexplained", strict)


log = typer.Typer(no_args_is_help=True, help="Look into drive logs.")
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
