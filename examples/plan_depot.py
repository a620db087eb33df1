"""Plan a route of least energy and compare it with the shortest one.

    python examples/plan_depot.py [MAP.yaml] [--start X,Y,DEG] [--goal X,Y,DEG] [--out FOLDER]

Without a map the warehouse that comes with the library is used, with its marble and concrete.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from energyplan import EnergyCost, PowerModel, compare, read_map, read_surfaces
from energyplan.output import plots
from energyplan.output.plots import png
from energyplan.planning import Plan, PlanningProblem

WAREHOUSE = Path(__file__).parents[1] / "maps" / "warehouse.yaml"


def pose(text: str) -> tuple[float, float, float]:
    """Read x, y [m] and heading [degrees]."""
    x, y, degrees = (float(part) for part in text.split(","))
    return x, y, float(np.radians(degrees))


def tell(name: str, found: Plan) -> None:
    """Print what a plan costs and how good it is known to be."""
    print(
        f"{name:14s} {found.energy_driven:8.0f} J  {found.length:6.2f} m  "
        f"{np.degrees(found.turning):5.0f} deg  {found.driven.duration:6.1f} s  "
        f"at most {100 * found.gap:z.1f} % above the least; first plan after "
        f"{1e3 * found.first_time:.0f} ms"
    )


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
    comparison = compare(problem, effort=100_000)
    tell("least energy", comparison.energy_optimal)
    tell("shortest", comparison.shortest)
    print(f"saving: {100 * comparison.saving:.1f} % of the shortest route's energy; by term:")
    for name, joules in comparison.by_term.items():
        print(f"  {name:22s} {joules:8.0f} J")

    drawn = surfaces.polygons if surfaces else ()
    both = {
        f"{name}: {found.energy_driven:.0f} J": found.path
        for name, found in (
            ("least energy", comparison.energy_optimal),
            ("shortest", comparison.shortest),
        )
    }
    picture = given.out / "routes.png"
    picture.write_bytes(png(plots.routes(grid, both, surfaces=drawn)))
    print(f"wrote {picture}")


if __name__ == "__main__":
    main()
