"""Ground on which each second has a price, as where people wait."""

from __future__ import annotations

import json
from dataclasses import replace

import networkx as nx
import numpy as np
import pytest
import shapely
from worlds import COST, MODEL, room

import energyplan as ep
from energyplan.errors import MapError
from energyplan.io.geojson import write_surfaces
from energyplan.planning.graphs import Roadmap
from energyplan.terrain import SpeedLimit, Surface

HALL = room(100, 200, 0.1)
AREA = shapely.box(8, 2, 12, 8)


def across(second, **more):
    ground = ep.SurfaceMap([Surface(AREA, MODEL, "people", second)])
    return ep.PlanningProblem(HALL, COST, (2, 5, 0), (18, 5, 0), surfaces=ground, **more)


def test_the_price_of_a_second_decides_whether_the_way_leads_through():
    through, round_ = (ep.plan(across(second), effort=4000) for second in (20.0, 1000.0))
    assert through.cost_steady == pytest.approx(16 * 226 + 20 * 4 / 1.2, rel=1e-6)
    assert through.energy_driven == pytest.approx(16 * 226, rel=1e-6)
    # stops lie outside, where the top speed is reached
    assert through.cost == pytest.approx(through.cost_steady, rel=1e-3)
    free = ep.plan(replace(across(0.0), surfaces=None), effort=4000)
    assert free.cost < round_.cost < 16 * 226 + 1000 * 4 / 1.2
    assert 1.1 * free.energy_driven < round_.energy_driven < 1.25 * free.energy_driven
    for plan in (through, round_):
        assert plan.lower_bound <= plan.cost


@pytest.mark.parametrize("objective", ["energy", "time", {"energy": 1.0, "time": 100.0}])
@pytest.mark.parametrize("seed", range(3))
def test_no_path_costs_less_than_the_bound(objective, seed):
    rng = np.random.default_rng(seed)
    second = float(rng.uniform(0.5, 300.0))
    limit = [SpeedLimit(shapely.box(9, 0, 15, 10), float(rng.uniform(0.1, 1.0)))]
    ground = ep.SurfaceMap(
        [Surface(AREA, MODEL, "people", second)], speed_limits=limit * (seed % 2)
    )
    problem = replace(across(0.0), surfaces=ground, objective=objective)
    found = ep.plan(problem, effort=1500)
    weights = problem.weights
    values = []
    for path in (found.path, ep.steering.path(problem.start, problem.goal, COST)):
        price = problem.terrain.price(path, COST)
        value = weights.get("energy", 0) * price.energy + weights.get("time", 0) * price.duration
        values.append(value + price.seconds)
        assert found.lower_bound_steady <= values[-1] * (1 + 1e-9)
    assert found.cost_steady == pytest.approx(values[0], rel=1e-9)
    assert found.lower_bound is None or found.lower_bound <= found.cost * (1 + 1e-9)


def test_what_seconds_add_is_that_of_the_drive():
    """Beginning in the area, the robot speeds up on it."""
    ground = ep.SurfaceMap([Surface(shapely.box(0, 0, 6, 10), MODEL, "people", 50.0)])
    found = ep.plan(replace(across(0.0), surfaces=ground), effort=500)
    driven = found.driven.trajectory
    x = np.interp(np.linspace(0, driven.t[-1], 200_001), driven.t, driven.x)
    inside = driven.t[-1] * np.mean(x < 6)
    assert found.cost == pytest.approx(16 * 226 + 50 * inside, rel=1e-4)
    assert found.cost > found.cost_steady == pytest.approx(16 * 226 + 50 * 4 / 1.2)


def test_graphs_go_round_and_ranges_and_the_shortest_path_do_not_count_it():
    graph = nx.Graph()
    for name, place in {"a": (2, 5), "b": (18, 5), "c": (2, 9), "d": (18, 9)}.items():
        graph.add_node(name, pos=place)
    graph.add_edges_from(["ab", "ac", "cd", "db"])
    for second, nodes in ((20.0, "ab"), (5000.0, "acdb")):
        route = Roadmap(graph, COST, across(second).surfaces).route("a", "b")
        assert "".join(route.nodes) == nodes
    assert route.cost == pytest.approx(route.energy)
    both = [ep.energy_map(across(second)).energy for second in (0.0, 5000.0)]
    assert np.array_equal(*both)
    found = ep.compare(across(1000.0), effort=3000)
    assert found.shortest.length == pytest.approx(16.0)


def test_files_hold_the_price_of_a_second(tmp_path):
    file = tmp_path / "ground.geojson"
    write_surfaces(across(20.0).surfaces, file)
    text = json.loads(file.read_text())
    text["features"][0]["properties"]["model"] = "quadriga:empty:concrete"
    file.write_text(json.dumps(text))
    assert ep.read_surfaces(file).surfaces[0].second == 20.0
    for wrong, says in ((-1, "second is -1"), ("soon", "second is 'soon'; give a number")):
        text["features"][0]["properties"]["second"] = wrong
        file.write_text(json.dumps(text))
        with pytest.raises(MapError, match=f"feature 0: .*{says}"):
            ep.read_surfaces(file)
