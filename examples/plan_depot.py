"""Plan a route of least energy, compare it with the shortest one, and trade energy against time.

    python examples/plan_depot.py [MAP.yaml] [--start X,Y,DEG] [--goal X,Y,DEG] [--out FOLDER]

Without a map the warehouse that comes with the library is used, with its marble and concrete.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np

from energyplan.cost import EnergyCost
from energyplan.errors import PlanningError
from energyplan.io.geojson import read_surfaces
from energyplan.io.maps import read_map
from energyplan.output import plots
from energyplan.output.report import png
from energyplan.planning import Plan, PlanningProblem, plan
from energyplan.power import HOTEL, PowerModel
from energyplan.power.effects import VISCOUS_LOSS
from energyplan.studies.comparison import compare
from energyplan.studies.pareto import ParetoFront, pareto
from energyplan.terrain import Surface, SurfaceMap

WAREHOUSE = Path(__file__).parents[1] / "maps" / "warehouse.yaml"


def pose(text: str) -> tuple[float, float, float]:
    """Read x, y [m] and heading [degrees]."""
    x, y, degrees = (float(part) for part in text.split(","))
    return x, y, float(np.radians(degrees))


def tell(name: str, found: Plan) -> None:
    """Print what a plan costs and how good it is known to be."""
    print(
        f"{name:14s} {found.energy:8.0f} J  {found.length:6.2f} m  "
        f"{np.degrees(found.turning):5.0f} deg  {found.duration:6.1f} s  "
        f"at most {100 * found.gap:.1f} % above the least; first plan after "
        f"{1e3 * found.first_time:.0f} ms"
    )


def stiff(model: PowerModel) -> PowerModel:
    """Return a model that knows of speed: 80 N per m/s on each side, and 40 W of computers."""
    return model.with_term(VISCOUS_LOSS, 80.0).with_term(HOTEL, 40.0)


def trade(problem: PlanningProblem) -> ParetoFront:
    """Trade energy against time for a robot whose resistance rises with speed."""
    surfaces = problem.surfaces
    if surfaces is not None:
        # surfaces of one model share what is tabulated of it
        models = {surface.model.name: stiff(surface.model) for surface in surfaces.surfaces}
        surfaces = SurfaceMap(
            tuple(Surface(s.area, models[s.model.name], s.name) for s in surfaces.surfaces),
            surfaces.keep_out,
        )
    cost = EnergyCost(stiff(problem.cost.model))
    problem = replace(problem, cost=cost, surfaces=surfaces)
    # what one planner overlooks another may find: its route is tried at every speed
    known = []
    try:
        known.append(plan(problem, "roadmap", effort=150_000).path)
    except PlanningError as error:
        print(f"no route from the visibility graph: {error}")
    return pareto(problem, effort=150_000, initial=known)


def main() -> None:
    """Run the example."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("map", nargs="?", type=Path, default=WAREHOUSE)
    parser.add_argument("--start", type=pose, default=pose("2,2,0"))
    parser.add_argument("--goal", type=pose, default=None)
    parser.add_argument("--out", type=Path, default=Path("plan_depot"))
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)

    grid = read_map(given.map)
    areas = given.map.with_name(given.map.stem + "_surfaces.geojson")
    surfaces = read_surfaces(areas) if areas.exists() else None
    width, height = grid.size
    goal = given.goal or (width - 2.0, height - 2.0, np.pi)
    cost = EnergyCost(PowerModel.preset("quadriga:full:concrete"))
    problem = PlanningProblem(grid, cost, given.start, goal, surfaces)

    # the route of least energy against the shortest one, priced by the same models
    told = compare(problem, effort=100_000)
    tell("least energy", told.energy_optimal)
    tell("shortest", told.shortest)
    print(f"saving: {100 * told.saving:.1f} % of the shortest route's energy; by term:")
    for name, joules in told.by_term.items():
        print(f"  {name:22s} {joules:8.0f} J")

    front = trade(problem)
    for point in front.points:
        tell(f"{point.time_value:.0f} J/s", point.plan)

    drawn = surfaces.polygons if surfaces else ()
    both = {
        f"{name}: {found.energy:.0f} J": found.path
        for name, found in (("least energy", told.energy_optimal), ("shortest", told.shortest))
    }
    figure = plots.figure(2, 1, size=(plots.WIDTH, 7.6))
    above, below = figure.axes
    plots.pareto(above, front)
    plots.occupancy(below, grid)
    frugal, hasty = front.points[0], front.points[-1]
    for point, color, dash in ((frugal, plots.BLUE, "-"), (hasty, plots.RED, "--")):
        label = f"{point.time_value:.0f} J/s: {point.plan.length:.1f} m"
        plots.route(below, point.plan.path, label, color, dash)
    plots.legend(below, above=True)
    for name, picture in (("routes", plots.routes(grid, both, surfaces=drawn)), ("pareto", figure)):
        (given.out / f"{name}.png").write_bytes(png(picture))
        print(f"wrote {given.out / name}.png")


if __name__ == "__main__":
    main()
