"""The commands that write what other programs calculate with: cost-table, rmf."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from energyplan.cli._planning import model_without_map
from energyplan.cli.answers import answer, progress
from energyplan.cli.app import app
from energyplan.cli.options import YAML, Json, ModelName, writes
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


@app.command(
    epilog="Example: energyplan rmf --model quadriga:full:concrete --battery quadriga "
    "--map warehouse.yaml --surfaces warehouse_surfaces.geojson --charging-current 10 "
    "--out config.yaml"
)
def rmf(
    model: ModelName,
    battery: Annotated[str, typer.Option(metavar="BATTERY", help="The name of a preset.")],
    charging_current: Annotated[
        float | None,
        typer.Option(help="Charging current [A]. Default: the largest that the battery takes."),
    ] = None,
    tool_power: Annotated[float, typer.Option(min=0.0, help="Power of the tool [W].")] = 0.0,
    inertia: Annotated[
        float | None,
        typer.Option(help="Moment of inertia about the vertical [kg m^2]. Default: of a plate."),
    ] = None,
    map_file: Annotated[
        Path | None,
        typer.Option("--map", help="Also measure how wrong Open-RMF's estimate is on this map."),
    ] = None,
    surfaces: Annotated[
        Path | None,
        typer.Option(help="Areas of other ground: GeoJSON polygons, each with a model."),
    ] = None,
    routes: Annotated[
        int, typer.Option(min=4, help="Number of random routes to measure the error on.")
    ] = 20,
    seed: Annotated[int, typer.Option(help="Seed of the routes.")] = 0,
    fit: Annotated[
        bool,
        typer.Option(
            "--fit", help="Fit the friction coefficient to half of the routes, judge on the rest."
        ),
    ] = False,
    out: Annotated[
        Path | None,
        typer.Option(
            callback=writes(*YAML),
            help="Write the fleet adapter's configuration to this YAML file.",
        ),
    ] = None,
    json: Json = False,
) -> None:
    """Write what Open-RMF's battery estimate needs.

    With a map, also measures how wrong that estimate is.
    """
    from dataclasses import replace

    import yaml

    from energyplan.battery import Battery
    from energyplan.io.config import read_model
    from energyplan.io.files import atomic_write
    from energyplan.io.geojson import read_surfaces
    from energyplan.io.maps import read_map
    from energyplan.openrmf import fleet_config, power_error
    from energyplan.output import documents, text

    if map_file is None and (fit or surfaces):
        raise InvalidInputError("--fit and --surfaces go with --map; give it too")
    known, cells = read_model(model), Battery.preset(battery)
    config = fleet_config(
        known, cells, charging_current=charging_current, tool_power=tool_power,
        moment_of_inertia=inertia,
    )  # fmt: skip
    error = None
    if map_file is not None:
        with progress("planning routes"):
            error = power_error(
                config, known, cells, read_map(map_file),
                surfaces=read_surfaces(surfaces) if surfaces else None, routes=routes, seed=seed,
            )  # fmt: skip
        if fit:
            config = replace(config, friction_coefficient=error.fitted_friction)
    if out:
        atomic_write(out, yaml.safe_dump(config.document(), sort_keys=False))
    document = {
        **config.document(),
        "notes": list(config.notes),
        "error": None if error is None else documents.plain(error),
    }
    answer(document, text.rmf(config, error), json=json)
