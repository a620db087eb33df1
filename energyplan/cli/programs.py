"""The commands for other programs, and the demo: export, serve, warmup, demo."""

from __future__ import annotations

from dataclasses import dataclass
from math import degrees
from pathlib import Path
from typing import Annotated, Any, Literal

from typer import Argument, Option

from energyplan.cli import options as opt
from energyplan.cli.answers import answer, progress, warn
from energyplan.cli.app import App, app
from energyplan.cli.options import DriveOptions, SiteOptions
from energyplan.cli.routes import level_model, problem_of
from energyplan.errors import InvalidInputError

export = App(rich_markup_mode=None, help="Write energies for other planners.")
app.add_typer(export, name="export")


@dataclass(frozen=True)
class GraphRoute:
    """A route along the edges of a graph."""

    source: Annotated[int | None, Option(metavar="ID", help="Node at which a route starts.")] = None
    target: Annotated[
        list[int] | None,
        Option(
            metavar="ID",
            help="Node to which it leads. Given several times, the one that takes least.",
        ),
    ] = None
    start_yaw: Annotated[
        str | None, Option(help="Its heading at the start, such as 90deg; any if left out.")
    ] = None
    goal_yaw: Annotated[str | None, Option(help="Its heading at the end; any if left out.")] = None
    goal_heading: Annotated[
        Literal["given", "either", "any"] | None,
        Option(help="Whether the heading at the end is as given, that or its opposite, or any."),
    ] = None

    @property
    def yaws(self) -> dict[str, Any]:
        """Yaws and heading as `PlannedGraph.route` takes them."""
        from energyplan.path import parse_pose

        if (self.source is None) != (not self.target):
            raise InvalidInputError("a route has a --source and a --target; give the other one too")
        found: dict[str, Any] = {
            name: parse_pose(["0", "0", text]).yaw
            for name, text in (("start_yaw", self.start_yaw), ("goal_yaw", self.goal_yaw))
            if text is not None
        }
        if self.goal_heading:
            found["goal_heading"] = self.goal_heading
        if found and self.source is None:
            raise InvalidInputError(
                "--start-yaw, --goal-yaw and --goal-heading are of a route; give --source and "
                "--target too"
            )
        return found


@export.command(
    epilog="Example: energyplan export graph graph.geojson --map warehouse.yaml "
    "--model quadriga:empty:concrete --out priced.geojson"
)
def graph(
    file: Annotated[Path, Argument(help="A route graph of Nav2's route server (GeoJSON).")],
    map_file: opt.MapFile,
    model: opt.ModelName,
    ends: GraphRoute,
    at_battery: opt.AtBattery = False,
    effort: Annotated[
        int | None, Option(min=1, help="Work for each edge; 50000 is about 1 s.")
    ] = None,
    out: Annotated[
        Path | None,
        opt.output(
            "Write the graph with the energies as costs, less the closed edges, to this file.",
            *opt.GEOJSON,
        ),
    ] = None,
    json: opt.Json = False,
) -> None:
    """Plan the edges of a route graph among obstacles.

    Prices each edge with the energy of the path found along it, and names those that are closed.
    With --source and --target, prints the route of least energy along them too.
    """
    from energyplan.export.graph import read_route_graph, write_route_graph
    from energyplan.path import as_pose
    from energyplan.planning.graphs import EFFORT
    from energyplan.planning.graphs import plan_edges as run

    yaws = ends.yaws
    places = read_route_graph(file)
    if len(places) == 0:
        raise InvalidInputError(f"{file} holds no nodes; give points with an id")
    # where a plan would start and end does not matter to its edges
    somewhere = as_pose((*next(iter(places.nodes(data="pos")))[1], 0.0), "a node")
    problem = problem_of(
        SiteOptions(map_file), DriveOptions(model, at_battery), somewhere, somewhere
    )
    with progress("planning"):
        result = run(places, problem, effort=EFFORT if effort is None else effort)
    if out:
        write_route_graph(result.graph, out)
    edges = [{"source": one.source, "target": one.target, "energy": energy}
             for one, energy in result.energies.items()]  # fmt: skip
    lines = [f"{edge['source']} to {edge['target']}: {edge['energy']:.0f} J" for edge in edges]
    lines += [f"{one.source} to {one.target} is closed: {one.reason}" for one in result.closed]
    route = None
    if ends.source is not None:
        path = result.route(ends.source, ends.target, **yaws)
        energy = problem.terrain.price(path, problem.cost).energy
        x, y, yaw = path.end
        at = f"({x:.2f}, {y:.2f}, {degrees(yaw):.1f} deg)"
        lines.append(f"route from {ends.source} to {at}: {energy:.0f} J, {path.length:.2f} m")
        route = {
            "energy": energy, "length": path.length, "end": list(path.end),
            "path": path.vertices.tolist(),
        }  # fmt: skip
    closed = [one._asdict() for one in result.closed]
    answer({"edges": edges, "closed": closed, "route": route}, lines, json=json)


@export.command(
    epilog="Example: energyplan export lattice --model quadriga:empty:concrete --resolution 0.05 "
    "--out lattice.json --penalties planner.yaml",
)
def lattice(
    model: opt.ModelName,
    out: Annotated[Path, opt.output("Write the primitives there.", ".json")],
    resolution: Annotated[float, Option(help="Size of a cell of the costmap [m].")] = 0.05,
    parameters: Annotated[
        Path | None,
        opt.output("Write the planner's parameters to this file.", *opt.YAML, name="--penalties"),
    ] = None,
    json: opt.Json = False,
) -> None:
    """Write primitives and penalties for Nav2's SmacPlannerLattice.

    They come nearest to the energy of the model. Prints the error that remains.
    """
    from energyplan.cost import EnergyCost
    from energyplan.export.lattice import control_set, penalties, write_lattice, write_penalties
    from energyplan.html import number as figure

    cost = EnergyCost(level_model(model))
    controls = control_set(cost, resolution)
    found = penalties(controls, cost)
    write_lattice(controls, out)
    if parameters:
        write_penalties(found, parameters, out)
    rounded = {name: round(value, 6) for name, value in found._asdict().items()}
    lines = [f"{len(controls.primitives)} primitives: {out}"]
    lines += [f"{name}: {figure(value)}" for name, value in rounded.items()]
    answer({"primitives": len(controls.primitives), "penalties": rounded}, lines, json=json)


@export.command(
    epilog="Example: energyplan export table --model quadriga:empty:concrete --out cost.csv"
)
def table(
    model: opt.ModelName,
    out: Annotated[Path, opt.output("Write the table there.", ".csv")],
    speeds: Annotated[str | None, Option(help="Tread speeds [m/s], such as 0.2,0.5,1.")] = None,
    at_battery: opt.AtBattery = False,
    json: opt.Json = False,
) -> None:
    """Write the energy of motions as a table.

    A planner in any language can read it.
    """
    from energyplan.cost import EnergyCost
    from energyplan.export.table import tabulate, write_cost_table

    try:
        wanted = None if speeds is None else [float(text) for text in speeds.split(",")]
    except ValueError:
        raise InvalidInputError(
            f"--speeds is {speeds!r}; write metres per second with commas between, like 0.2,0.5"
        ) from None
    result = tabulate(EnergyCost(level_model(model), battery=at_battery), wanted)
    write_cost_table(result, out)
    size = {"directions": len(result.angle), "speeds": len(result.speed)}
    lines = [
        f"{size['directions']} directions, {size['speeds']} speeds: {out}",
        f"read with straight lines between entries, energies are right to {result.error:.1g}",
    ]
    document = {**size, "half_track": result.half_track, "error": result.error}
    answer(document, lines, json=json)


@app.command(epilog="Example: energyplan serve maps --port 8321")
def serve(
    folder: Annotated[Path, Argument(help="Folder with maps, models, missions and logs.")],
    host: Annotated[str, Option(help="Address to listen on.")] = "127.0.0.1",
    port: Annotated[int, Option(min=0, max=65535, help="Port.")] = 8321,
    token: Annotated[
        str | None,
        Option(
            envvar="ENERGYPLAN_TOKEN",
            help="Secret that each request must carry; the environment keeps it from the list of "
            "processes. Default: a random one, printed with the address.",
        ),
    ] = None,
    no_token: Annotated[
        bool, Option("--no-token", help="Ask users of this machine for none.")
    ] = False,
    workers: Annotated[
        int | None, Option(min=1, help="Requests at once. Default: one a core.")
    ] = None,
    waiting: Annotated[int, Option(min=0, help="Requests that may wait.")] = 32,
) -> None:
    """Serve plans and missions over HTTP.

    Also serves checks and diagnoses, and a page to try them on.
    """
    from energyplan.serve import run

    run(folder, host, port, token, workers, waiting, no_token)


@app.command(epilog="Example: energyplan warmup --json")
def warmup(
    json: opt.Json = False,
) -> None:
    """Compile all kernels ahead.

    In a container image or on a test machine, later commands then start at once.
    """
    from importlib import import_module

    from energyplan.compilation import cache_folder, compile_kernels, kernel_modules

    modules = kernel_modules()
    with progress("compiling"):
        for module in modules:
            import_module(module)
        result = compile_kernels(*modules, processes=2)
    document = {
        "folder": str(cache_folder()), "compiled": list(result.compiled), "found": result.found,
        "kept": result.kept, "processes": result.processes, "seconds": result.seconds,
    }  # fmt: skip
    text = (
        f"{len(result.compiled)} kernels compiled in {result.seconds:.1f} s by {result.processes} "
        f"process{'es' if result.processes > 1 else ''}, {result.found} found; "
    )
    where = (
        f"kept in {cache_folder()}" if result.kept else "not kept: the next process compiles too"
    )
    answer(document, [text + where], json=json)


@app.command(epilog="Example: energyplan demo --out demo")
def demo(
    out: Annotated[Path, opt.output("Folder for the files.")] = Path("demo"),
    json: opt.Json = False,
) -> None:
    """Run the whole chain on bundled input.

    Makes pictures and a web page.
    """
    from energyplan.demo import run

    files = run(out, say=(lambda text: None) if json else warn)
    names = [str(name) for name in files]
    answer({"files": names}, [*names, f"open {out / 'index.html'} in a browser"], json=json)
