"""Roadmaps: what it is worth to pay for turns, and the time of the roadmap planner.

``python benchmarks/roadmap.py`` prints two tables, each measured in one run:

1. Routes between random nodes of street-like grids: the energy of the route that a search over
   places alone takes (Dijkstra over the energies of the edges, as any graph library does it)
   against the route of the search over arriving headings, both driven and priced the same way.
2. The planner on the library's own maps against the lattice planner in the same time.
"""

from __future__ import annotations

import time
from itertools import pairwise

import networkx as nx
import numpy as np

from energyplan.cost import EnergyCost
from energyplan.io.files import bundled
from energyplan.io.geojson import read_surfaces
from energyplan.io.maps import read_map
from energyplan.planning import PlanningProblem, plan
from energyplan.planning.roadmap import Roadmap, price_edges
from energyplan.power import PowerModel

CASES = {
    "office": ("empty", (1.0, 4.4, 0.0), (19.0, 4.0, -90.0)),
    "warehouse": ("full", (2.0, 2.0, 0.0), (20.0, 12.0, 90.0)),
    "orchard": ("empty", (2.0, 1.5, 90.0), (14.0, 17.0, 0.0)),
}


def streets(side: int, seed: int) -> nx.Graph:
    """Return a grid of crossings 3 m apart, moved at random, with a tenth of the edges missing."""
    rng = np.random.default_rng(seed)
    graph = nx.grid_2d_graph(side, side)
    for node in graph:
        graph.nodes[node]["pos"] = tuple(3.0 * np.array(node) + rng.uniform(-0.6, 0.6, 2))
    edges = list(graph.edges)
    graph.remove_edges_from([edges[k] for k in rng.choice(len(edges), len(edges) // 10, False)])
    return graph.subgraph(max(nx.connected_components(graph), key=len)).copy()


def main() -> None:
    """Measure and print."""
    cost = EnergyCost(PowerModel.preset("quadriga:full:concrete"))
    print("nodes  states  build [s]  query [ms]  saved by paying for turns: median  largest")
    for side in (5, 10, 20):
        graph = streets(side, 1)
        begun = time.perf_counter()
        roadmap = Roadmap(graph, cost)
        states = roadmap.states.number_of_nodes()
        build = time.perf_counter() - begun
        priced = price_edges(graph, cost)
        rng = np.random.default_rng(2)
        nodes = sorted(graph)
        saved, took = [], []
        for _ in range(20):
            source, target = (nodes[k] for k in rng.choice(len(nodes), 2, False))
            begun = time.perf_counter()
            best = roadmap.route(source, target)
            took.append(time.perf_counter() - begun)
            blind = nx.dijkstra_path(priced, source, target, weight="cost")
            line = graph.edge_subgraph(list(pairwise(blind)))
            other = Roadmap(line, cost).route(source, target)
            saved.append(1 - best.energy / other.energy)
        print(
            f"{len(graph):5d}  {states:6d}  {build:9.2f}  {1e3 * np.median(took):10.1f}  "
            f"{100 * np.median(saved):39.1f} %  {100 * max(saved):5.1f} %"
        )

    print("\nmap         planner   energy [J]  gap    first plan [s]  whole [s]")
    for name, (load, start, goal) in CASES.items():
        grid = read_map(bundled(f"{name}.yaml"))
        ground = read_surfaces(bundled(f"{name}_surfaces.geojson"))
        ends = []
        for x, y, degrees in (start, goal):
            place = grid.to_world(np.array([x, y]) / grid.resolution)
            ends.append((*place, np.deg2rad(degrees) + grid.origin.yaw))
        own = EnergyCost(PowerModel.preset(f"quadriga:{load}:concrete"))
        problem = PlanningProblem(grid, own, *ends, surfaces=ground)
        for planner in ("roadmap", "lattice"):
            plan(problem, planner=planner)
            found = plan(problem, planner=planner, time_limit=2.0)
            print(
                f"{name:<11} {planner:<8} {found.energy:11.0f}  {found.gap:.3f}  "
                f"{found.first_time:14.2f}  {found.planning_time:9.2f}"
            )


if __name__ == "__main__":
    main()
