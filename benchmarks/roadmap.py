"""Roadmaps: what it is worth to pay for turns.

``python benchmarks/roadmap.py`` prints routes between random nodes of street-like grids: the energy
of the route that a search over places alone takes (Dijkstra over the energies of the edges, as any
graph library does it) against the route of the search over arriving headings, both driven and
priced the same way.
"""

from __future__ import annotations

import time
from itertools import pairwise

import networkx as nx
import numpy as np

from energyplan.cost import EnergyCost
from energyplan.planning.graphs import Roadmap, price_edges
from energyplan.power import PowerModel


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


if __name__ == "__main__":
    main()
