"""The command mission."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from energyplan.cli.common import (
    Json,
    Report,
    Strict,
    answer,
    app,
    progress,
    verdict,
    writes_folder,
)

if TYPE_CHECKING:
    pass


@app.command(epilog="Example: energyplan mission mission_warehouse.yaml --report mission.html")
def mission(
    file: Annotated[Path, typer.Argument(help="Mission YAML file.")],
    effort: Annotated[
        int | None,
        typer.Option(help="Units of work for each route in place of time."),
    ] = None,
    report: Report = None,
    trajectories: Annotated[
        Path | None,
        typer.Option(
            callback=writes_folder, help="Write every leg as t,x,y,yaw,v,omega to this folder."
        ),
    ] = None,
    json: Json = False,
    strict: Strict = False,
) -> None:
    """Budget a mission's battery, and flag the tasks that cannot be reached, with the reason."""
    from energyplan.io.files import atomic_write
    from energyplan.io.mission import read_mission
    from energyplan.mission import evaluate
    from energyplan.output import documents, text
    from energyplan.output.pages import mission_page

    asked = read_mission(file)
    if effort is not None:
        asked = replace(asked, planning_effort=effort)
    with progress("evaluating the mission"):
        told = evaluate(asked)
    if trajectories:
        from energyplan.io.trajectory import write_trajectory

        trajectories.mkdir(parents=True, exist_ok=True)
        for k, leg in enumerate(told.trajectories, start=1):
            write_trajectory(leg, trajectories / f"leg_{k:02d}.csv")
    if report:
        atomic_write(report, mission_page(told).html())
    answer(documents.mission(told), text.mission(told), json=json)
    verdict(told.feasible, strict)
