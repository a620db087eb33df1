"""The command that writes the cost of motion as a table."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from energyplan.cli._planning import model_without_map
from energyplan.cli.answers import answer
from energyplan.cli.app import app
from energyplan.cli.options import Json, ModelName, writes
from energyplan.errors import InvalidInputError


@app.command(epilog="Example: energyplan cost-table --model quadriga:empty:concrete --out cost.csv")
def cost_table(
    model: ModelName,
    out: Annotated[
        Path, typer.Option("--out", callback=writes(".csv"), help="Write the table to this file.")
    ],
    speeds: Annotated[
        str | None,
        typer.Option(help="Tread speeds [m/s], such as 0.2,0.5,1. Default: the cheapest one."),
    ] = None,
    battery: Annotated[
        bool,
        typer.Option(
            "--battery",
            help="Count the energy that the battery gives, losses of the drives included.",
        ),
    ] = False,
    tolerance: Annotated[
        float, typer.Option(help="Largest relative error of interpolating between entries.")
    ] = 1e-3,
    json: Json = False,
) -> None:
    """Write the energy of motions as a table.

    A planner in any language can read it.
    """
    from energyplan.cost import EnergyCost
    from energyplan.cost.table import tabulate
    from energyplan.io.cost_table import write_cost_table

    try:
        asked = None if speeds is None else [float(text) for text in speeds.split(",")]
    except ValueError:
        raise InvalidInputError(
            f"--speeds is {speeds!r}; write metres per second with commas between, like 0.2,0.5"
        ) from None
    made = tabulate(EnergyCost(model_without_map(model), battery=battery), asked, tolerance)
    write_cost_table(made, out)
    size = {"directions": len(made.angle), "speeds": len(made.speed)}
    lines = [
        f"{size['directions']} directions, {size['speeds']} speeds: {out}",
        f"read with straight lines between entries, energies are right to {made.error:.1g}",
    ]
    document = {**size, "half_track": made.half_track, "error": made.error}
    answer(document, lines, json=json)
