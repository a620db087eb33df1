"""The command for Open-RMF: rmf."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from energyplan.cli.answers import answer, progress
from energyplan.cli.app import app
from energyplan.cli.options import YAML, Json, ModelName, writes
from energyplan.errors import InvalidInputError


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
