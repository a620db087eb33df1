"""The commands for other programs: replan, plan-edges, nav2-lattice, cost-table.

They read routes that others keep, and write what planners calculate with.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from energyplan.cli._planning import (
    AtBattery,
    Clearance,
    Effort,
    Heights,
    Keepout,
    MapFile,
    Objective,
    OutPath,
    OutTrajectory,
    Speed,
    Surfaces,
    TimeLimit,
    driven,
    model_without_map,
    planning,
    problem_of,
    write_plans,
)
from energyplan.cli.answers import answer, progress
from energyplan.cli.app import app
from energyplan.cli.inputs import parse_pose
from energyplan.cli.options import Json, ModelName, Strict, writes
from energyplan.errors import InvalidInputError


@app.command(
    epilog="Example: energyplan replan route.csv --map warehouse.yaml "
    "--model quadriga:empty:concrete --from 5,2,0 --out rest.csv"
)
def replan(
    path: Annotated[Path, typer.Argument(help="The path being driven, as plan --out writes it.")],
    map_file: MapFile,
    model: ModelName,
    start: Annotated[
        str,
        typer.Option("--from", metavar="X,Y,YAW", help="Where the robot is; 90deg is in degrees."),
    ],
    former_map: Annotated[
        Path | None,
        typer.Option(help="The map that the path was planned on. Default: no obstacle is gone."),
    ] = None,
    surfaces: Surfaces = None,
    heights: Heights = None,
    battery: AtBattery = False,
    clearance: Clearance = 0.0,
    keepout: Keepout = None,
    objective: Objective = "energy",
    time_limit: TimeLimit = 1.0,
    effort: Effort = None,
    speed: Speed = None,
    out: OutPath = None,
    trajectory: OutTrajectory = None,
    json: Json = False,
    strict: Strict = False,
) -> None:
    """Plan again from where the robot is.

    Keeps the rest of the path if it is free and no obstacle is gone. Otherwise plans around what is
    closed.
    """
    from energyplan.io.trajectory import read_path
    from energyplan.output import documents, text
    from energyplan.planning.replanning import replan as run

    here = parse_pose(start)
    now = problem_of(
        map_file, model, here, here, surfaces, heights, battery, objective, speed, None,
        clearance, keepout,
    )  # fmt: skip
    former = read_path(path, now.cost.icr.longitudinal)
    problem = replace(now, start=former.start, goal=former.end)
    if former_map:
        before = problem_of(
            former_map, model, former.start, former.end, surfaces, heights, battery, objective,
            speed, None, clearance, keepout,
        )  # fmt: skip
        problem = replace(problem, map=before.map)
    with planning(problem, json, strict):
        made = run(problem, former, start=here, map=now.map, time_limit=time_limit, effort=effort)
    told = driven(made, trajectory)
    if out:
        write_plans(out, replace(now, goal=former.end), plan=made)
    document = {**documents.plan(made), **documents.driven_path(told)}
    answer(document, [*text.plan(made, objective), *text.driven_path(made, told)], json=json)


@app.command(
    epilog="Example: energyplan plan-edges graph.geojson --map warehouse.yaml "
    "--model quadriga:empty:concrete --out priced.geojson"
)
def plan_edges(
    graph: Annotated[Path, typer.Argument(help="A route graph of Nav2's route server (GeoJSON).")],
    map_file: MapFile,
    model: ModelName,
    surfaces: Surfaces = None,
    heights: Heights = None,
    battery: AtBattery = False,
    clearance: Clearance = 0.0,
    keepout: Keepout = None,
    speed: Speed = None,
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

    places = read_route_graph(graph)
    if len(places) == 0:
        raise InvalidInputError(f"{graph} holds no nodes; give points with an id")
    # where a plan would start and end does not matter to its edges
    somewhere = as_pose((*next(iter(places.nodes(data="pos")))[1], 0.0), "a node")
    problem = problem_of(
        map_file, model, somewhere, somewhere, surfaces, heights, battery, "energy", speed,
        None, clearance, keepout,
    )  # fmt: skip
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


@app.command(
    name="nav2-lattice",
    epilog="Example: energyplan nav2-lattice --model quadriga:empty:concrete --resolution 0.05 "
    "--out lattice.json --penalties planner.yaml",
)
def nav2_lattice(
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
    battery: AtBattery = False,
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
    cost = EnergyCost(power, battery=battery, speed=asked_speed(speed, power.vehicle))
    controls = control_set(cost, resolution, headings=headings, radius=radius)
    found = penalties(controls, cost)
    write_lattice(controls, out)
    if parameters:
        write_penalties(found, parameters, out)
    told = {name: round(value, 6) for name, value in found._asdict().items()}
    lines = [f"{len(controls.primitives)} primitives, {headings} headings: {out}"]
    lines += [f"{name}: {value:.4g}" for name, value in told.items()]
    answer({"primitives": len(controls.primitives), "penalties": told}, lines, json=json)


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
