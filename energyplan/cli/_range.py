"""The command about how far an energy leads."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

import typer

from energyplan.cli._planning import AtBattery, Heights, MapFile, Speed, Surfaces, ground_of
from energyplan.cli.answers import answer, progress
from energyplan.cli.app import app
from energyplan.cli.inputs import parse_pose
from energyplan.cli.options import IMAGES, Json, ModelName, writes


@app.command(
    name="range",
    epilog="Example: energyplan range --map warehouse.yaml --model quadriga:empty:concrete "
    "--from 2,2,0 --energy 5000 --return --confidence 0.95 --coefficient-spread 0.05",
)
def reach(
    map_file: MapFile,
    model: ModelName,
    start: Annotated[
        str,
        typer.Option(
            "--from", metavar="X,Y,YAW", help="In metres and radians; 90deg is in degrees."
        ),
    ],
    energy: Annotated[float | None, typer.Option(help="Energy at hand [J].")] = None,
    reserve: Annotated[
        float, typer.Option(min=0.0, max=0.99, help="Fraction of it to keep.")
    ] = 0.0,
    pack: Annotated[
        str | None,
        typer.Option(
            metavar="BATTERY", help="Take the energy from this battery: the name of a preset."
        ),
    ] = None,
    soc: Annotated[
        float | None,
        typer.Option(min=0.0, max=1.0, help="State of charge of that battery. Default: full."),
    ] = None,
    confidence: Annotated[
        float | None,
        typer.Option(
            help="Call a place within reach only if it is with this probability, such as 0.95."
        ),
    ] = None,
    spread: Annotated[
        float,
        typer.Option(
            "--coefficient-spread",
            help="Relative standard deviation of each coefficient from day to day.",
        ),
    ] = 0.0,
    back: Annotated[
        bool, typer.Option("--return", help="Count the way back to the start as well.")
    ] = False,
    charger: Annotated[
        str | None,
        typer.Option(
            metavar="X,Y,YAW", help="Count the way on to this pose instead of the way back."
        ),
    ] = None,
    surfaces: Surfaces = None,
    heights: Heights = None,
    battery: AtBattery = False,
    speed: Speed = None,
    out: Annotated[
        Path | None,
        typer.Option(
            callback=writes(".asc"), help="Write the energies [J] to this ESRI ASCII grid."
        ),
    ] = None,
    contours: Annotated[
        Path | None,
        typer.Option(
            callback=writes(".geojson", ".json"),
            help="Write the areas within reach to this GeoJSON file.",
        ),
    ] = None,
    plot: Annotated[
        Path | None,
        typer.Option(
            callback=writes(*IMAGES),
            help="Draw the map and the areas into this file: .png, .svg or .pdf.",
        ),
    ] = None,
    json: Json = False,
) -> None:
    """Find how far a given energy takes the robot.

    Computes the energy that it takes to reach each place of a map, and to come back if asked.
    """
    from energyplan.battery import Battery
    from energyplan.errors import InvalidInputError
    from energyplan.io.energy_map import write_contours, write_energies
    from energyplan.io.files import atomic_write
    from energyplan.io.maps import read_map
    from energyplan.output import documents, plots, text
    from energyplan.output.report import image
    from energyplan.planning import PlanningProblem
    from energyplan.planning.ready import compiling_search
    from energyplan.studies.doubt import energy_of_charge
    from energyplan.studies.energy_map import energy_map

    if pack and energy is not None:
        raise InvalidInputError("--pack and --energy both set the energy at hand; give one")
    if soc is not None and pack is None:
        raise InvalidInputError("--soc is the charge of a battery; give --pack, or leave it out")
    if spread != 0 and confidence is None:
        raise InvalidInputError("--coefficient-spread needs --confidence; give both")
    pose = parse_pose(start)
    # what a battery delivers is counted at the battery
    cost, ground, hills = ground_of(model, surfaces, heights, battery or pack is not None, speed)
    problem = PlanningProblem(read_map(map_file), cost, pose, pose, surfaces=ground, heights=hills)
    home = parse_pose(charger) if charger else pose
    if pack:
        energy = energy_of_charge(cost, Battery.preset(pack), 1.0 if soc is None else soc)
    usable = None if energy is None else (1.0 - reserve) * energy
    with progress("searching"), compiling_search(problem):
        found = energy_map(
            problem, energy=math.inf if usable is None else usable,
            back=home if back or charger else None,
            confidence=confidence, coefficient_spread=spread,
        )  # fmt: skip
    areas = found.areas(usable)
    if out:
        write_energies(found, out)
    if contours:
        write_contours(areas, contours)
    if plot:
        atomic_write(plot, image(plots.energy_map(found, problem.map), plot.suffix))
    answer(documents.energy_map(found, areas), text.energy_map(found, areas), json=json)
