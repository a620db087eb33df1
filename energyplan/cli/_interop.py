"""The commands that write for other planners: export graph, export lattice, export table."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from energyplan.cli._planning import (
    AtBattery,
    Drive,
    Site,
    Speed,
    model_without_map,
    problem_of,
)
from energyplan.cli.answers import answer, progress
from energyplan.cli.app import App, app
from energyplan.cli.options import Json, ModelName, writes
from energyplan.errors import InvalidInputError

export = App(rich_markup_mode=None, help="Write energies for other planners.")
app.add_typer(export, name="export")


@export.command(
    epilog="Example: energyplan export graph graph.geojson --map warehouse.yaml "
    "--model quadriga:empty:concrete --out priced.geojson"
)
def graph(
    file: Annotated[Path, typer.Argument(help="A route graph of Nav2's route server (GeoJSON).")],
    site: Site,
    drive: Drive,
    effort: Annotated[
        int | None, typer.Option(min=1, help="Work to spend on each edge. 50000 is about 1 s.")
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            callback=writes(".geojson", ".json"),
            help="Write the graph with the energies as costs, less the closed edges, to this file.",
        ),
    ] = None,
    json: Json = False,
) -> None:
    """Plan the edges of a route graph among obstacles.

    Prices each edge with the energy of the path found along it, and names those that are closed.
    """
    from energyplan.io.route_graph import read_route_graph, write_route_graph
    from energyplan.path import as_pose
    from energyplan.planning.roadmap.planned import EFFORT
    from energyplan.planning.roadmap.planned import plan_edges as run

    places = read_route_graph(file)
    if len(places) == 0:
        raise InvalidInputError(f"{file} holds no nodes; give points with an id")
    # where a plan would start and end does not matter to its edges
    somewhere = as_pose((*next(iter(places.nodes(data="pos")))[1], 0.0), "a node")
    problem = problem_of(site, drive, somewhere, somewhere)
    with progress("planning"):
        made = run(places, problem, effort=EFFORT if effort is None else effort)
    if out:
        write_route_graph(made.graph, out)
    edges = [
        {"source": state.source, "target": state.target, "energy": energy}
        for state, energy in made.energies.items()
    ]
    lines = [f"{edge['source']} to {edge['target']}: {edge['energy']:.0f} J" for edge in edges]
    lines += [f"{one.source} to {one.target} is closed: {one.reason}" for one in made.closed]
    answer({"edges": edges, "closed": [one._asdict() for one in made.closed]}, lines, json=json)


@export.command(
    epilog="Example: energyplan export lattice --model quadriga:empty:concrete --resolution 0.05 "
    "--out lattice.json --penalties planner.yaml",
)
def lattice(
    model: ModelName,
    out: Annotated[
        Path, typer.Option(callback=writes(".json"), help="Write the primitives to this file.")
    ],
    resolution: Annotated[float, typer.Option(help="Size of a cell of the costmap [m].")] = 0.05,
    headings: Annotated[int, typer.Option(help="Number of headings, a multiple of 8.")] = 16,
    radius: Annotated[
        float | None,
        typer.Option(help="Smallest radius of arcs [m]. Default: that of a pivot about a tread."),
    ] = None,
    parameters: Annotated[
        Path | None,
        typer.Option(
            "--penalties",
            callback=writes(".yaml", ".yml"),
            help="Write the planner's parameters to this file.",
        ),
    ] = None,
    at_battery: AtBattery = False,
    speed: Speed = None,
    json: Json = False,
) -> None:
    """Write primitives and penalties for Nav2's SmacPlannerLattice.

    They come nearest to the energy of the model. Prints the error that remains.
    """
    from energyplan.cost import EnergyCost
    from energyplan.cost.speeds import asked_speed
    from energyplan.io.nav2_lattice import write_lattice, write_penalties
    from energyplan.studies.control_set import control_set, penalties

    power = model_without_map(model)
    cost = EnergyCost(power, battery=at_battery, speed=asked_speed(speed, power.vehicle))
    controls = control_set(cost, resolution, headings=headings, radius=radius)
    found = penalties(controls, cost)
    write_lattice(controls, out)
    if parameters:
        write_penalties(found, parameters, out)
    told = {name: round(value, 6) for name, value in found._asdict().items()}
    lines = [f"{len(controls.primitives)} primitives, {headings} headings: {out}"]
    lines += [f"{name}: {value:.4g}" for name, value in told.items()]
    answer({"primitives": len(controls.primitives), "penalties": told}, lines, json=json)


@export.command(
    epilog="Example: energyplan export table --model quadriga:empty:concrete --out cost.csv"
)
def table(
    model: ModelName,
    out: Annotated[
        Path, typer.Option("--out", callback=writes(".csv"), help="Write the table to this file.")
    ],
    speeds: Annotated[
        str | None,
        typer.Option(help="Tread speeds [m/s], such as 0.2,0.5,1. Default: the cheapest one."),
    ] = None,
    at_battery: AtBattery = False,
    error: Annotated[
        float, typer.Option(help="Largest relative error of interpolating between entries.")
    ] = 1e-3,
    json: Json = False,
) -> None:
    """Write the energy of motions as a table.

    A planner in any language can read it.
    """
    from energyplan.cost import EnergyCost
    from energyplan.io.cost_table import tabulate, write_cost_table

    try:
        asked = None if speeds is None else [float(text) for text in speeds.split(",")]
    except ValueError:
        raise InvalidInputError(
            f"--speeds is {speeds!r}; write metres per second with commas between, like 0.2,0.5"
        ) from None
    made = tabulate(EnergyCost(model_without_map(model), battery=at_battery), asked, error)
    write_cost_table(made, out)
    size = {"directions": len(made.angle), "speeds": len(made.speed)}
    lines = [
        f"{size['directions']} directions, {size['speeds']} speeds: {out}",
        f"read with straight lines between entries, energies are right to {made.error:.1g}",
    ]
    document = {**size, "half_track": made.half_track, "error": made.error}
    answer(document, lines, json=json)
