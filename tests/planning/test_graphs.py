"""Energy graphs, routes on them, and edges planned among obstacles."""

from __future__ import annotations

import itertools
import json
from dataclasses import replace

import networkx as nx
import numpy as np
import pytest
import shapely
from worlds import COST, MODEL, room

import energyplan as ep
from energyplan.errors import InvalidInputError, NoPathError
from energyplan.export.graph import read_route_graph, write_route_graph
from energyplan.path import wrap_angle
from energyplan.planning.graphs import Roadmap, plan_edges, price_edges, round_corner
from energyplan.power import HOTEL
from energyplan.terrain import Surface

A, BETA, C = 226.0, 0.627 * MODEL.vehicle.slip_moment, 0.47
SPIN = A * C + BETA


def grid_graph(rng, side=4, size=2.0):
    graph = nx.grid_2d_graph(side, side)
    for x, y in graph:
        jitter = rng.uniform(-0.4, 0.4, 2)
        graph.nodes[x, y]["pos"] = (size * x + jitter[0], size * y + jitter[1])
    return graph


def brute_force(graph, source, target, start_yaw, goal_yaw, reverse, metre=A, radian=SPIN):
    """Every simple path, every gear on every edge, priced by the closed form."""
    place = nx.get_node_attributes(graph, "pos")
    best = np.inf
    for nodes in nx.all_simple_paths(graph, source, target):
        points = np.array([place[n] for n in nodes])
        step = np.diff(points, axis=0)
        length = np.hypot(*step.T).sum()
        heading = np.arctan2(step[:, 1], step[:, 0])
        for gears in itertools.product((0, 1) if reverse else (0,), repeat=len(heading)):
            yaw = [heading + np.pi * np.array(gears)]
            if start_yaw is not None:
                yaw.insert(0, [start_yaw])
            if goal_yaw is not None:
                yaw.append([goal_yaw])
            turning = np.abs(wrap_angle(np.diff(np.concatenate(yaw)))).sum()
            best = min(best, metre * length + radian * turning)
    return best


@pytest.mark.parametrize("reverse", [False, True])
@pytest.mark.parametrize("ends", [(None, None), (2.0, None), (1.0, -3.0)])
def test_routes_are_the_best_of_all(reverse, ends):
    rng = np.random.default_rng(21)
    for _ in range(3):
        graph = grid_graph(rng, side=3)
        yaws = dict(zip(("start_yaw", "goal_yaw"), ends, strict=True))
        route = Roadmap(graph, COST, reverse=reverse).route((0, 0), (2, 2), **yaws)
        expected = brute_force(graph, (0, 0), (2, 2), *ends, reverse)
        assert route.energy == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize(
    "objective", ["energy", "length", "time", {"energy": 1.0, "time": 300.0, "length": 20.0}]
)
def test_routes_are_the_best_of_all_at_every_objective(objective):
    """Hotel load and a limit of power: a turn and a metre have prices of their own in each."""
    vehicle = replace(MODEL.vehicle, motor=ep.MotorLimits(continuous_power=150.0, speed=1.2))
    cost = ep.EnergyCost(replace(MODEL, vehicle=vehicle).with_term(HOTEL, 90.0))
    weights = {objective: 1.0} if isinstance(objective, str) else objective

    def price(ds, turn):
        """By hand: what `Plan.cost` is said to be."""
        motion = ep.Path(ep.Pose(0, 0, 0), [ds], [turn])
        energy = cost.energy(motion)
        tied = abs(ds) + 0.01 * energy / cost.energy(ep.Path(ep.Pose(0, 0, 0), [1.0], [0.0]))
        total = weights.get("energy", 0) * energy + weights.get("length", 0) * tied
        return total + weights.get("time", 0) * cost.duration(motion)

    rng = np.random.default_rng(28)
    for _ in range(4):
        graph = grid_graph(rng, side=3)
        route = Roadmap(graph, cost, objective=objective).route((0, 0), (2, 2), start_yaw=1.5)
        prices = price(1.0, 0.0), price(0.0, 1.0)
        expected = brute_force(graph, (0, 0), (2, 2), 1.5, None, True, *prices)
        assert route.cost == pytest.approx(expected, rel=1e-6)
        assert route.energy == pytest.approx(cost.energy(route.path), rel=1e-12)


def test_a_route_ends_where_it_should():
    rng = np.random.default_rng(22)
    graph = grid_graph(rng)
    nx.set_node_attributes(graph, 0.5, "radius")
    ahead = MODEL.vehicle.with_icr(ep.TreadICR(0.5, 0.45, 0.1))
    cost = ep.EnergyCost(ep.PowerModel.paper(ahead, 113.0, 0.627))
    route = Roadmap(graph, cost).route((0, 0), (3, 2), start_yaw=2.5, goal_yaw=-1.0)
    end, start = route.path.end, route.path.start
    for pose, node in ((start, (0, 0)), (end, (3, 2))):
        point = np.array(pose[:2]) + 0.1 * np.array([np.cos(pose.yaw), np.sin(pose.yaw)])
        assert np.allclose(point, graph.nodes[node]["pos"], atol=1e-9)
    assert start.yaw == 2.5
    assert wrap_angle(end.yaw + 1.0) == pytest.approx(0.0, abs=1e-9)
    assert route.energy == pytest.approx(cost.energy(route.path))


def test_the_weights_along_a_route_add_up_to_its_energy():
    """Also with rounded corners, on two surfaces."""
    rng = np.random.default_rng(23)
    graph = grid_graph(rng)
    marble = ep.PowerModel.preset("quadriga:empty:marble")
    ground = ep.SurfaceMap([Surface(shapely.box(3, -5, 20, 20), marble)])
    for radius, surfaces in ((0.0, ground), (0.6, None)):
        roadmap = Roadmap(graph, COST, surfaces=surfaces, radius=radius)
        route = roadmap.route((0, 0), (3, 3))
        arcs = [roadmap.states[a][b]["weight"] for a, b in itertools.pairwise(route.states)]
        first = roadmap.states.nodes[route.states[0]]["cost"]
        assert route.energy == pytest.approx(first + sum(arcs), rel=1e-9)


def test_turns_change_the_best_route():
    """A staircase is no longer than an L, and costs five quarter turns more."""
    graph = nx.grid_2d_graph(4, 4)
    nx.set_node_attributes(graph, {n: n for n in graph}, "pos")
    route = Roadmap(graph, COST).route((0, 0), (3, 3))
    turns = np.count_nonzero(route.path.dtheta)
    assert turns == 1
    assert route.energy == pytest.approx(6 * A + SPIN * np.pi / 2)


def test_backing_out_of_a_dead_end_is_cheaper_than_turning_round():
    graph = nx.path_graph(3)
    nx.set_node_attributes(graph, {0: (0, 0), 1: (2, 0), 2: (5, 0)}, "pos")
    route = Roadmap(graph, COST).route(2, 0, start_yaw=0.0)
    assert [s.gear for s in route.states] == [-1, -1]
    assert route.energy == pytest.approx(5 * A)
    forward = Roadmap(graph, COST, reverse=False).route(2, 0, start_yaw=0.0)
    assert forward.energy == pytest.approx(5 * A + SPIN * np.pi)


def test_any_kind_of_graph_will_do():
    energies = []
    for kind in (nx.Graph, nx.DiGraph, nx.MultiGraph, nx.MultiDiGraph):
        graph = kind([(0, 1), (1, 2)])
        nx.set_node_attributes(graph, {0: 0, 1: 1, 2: 1}, "x")
        nx.set_node_attributes(graph, {0: 0, 1: 0, 2: 1}, "y")
        energies.append(Roadmap(graph, COST).route(0, 2).energy)
        if graph.is_directed():
            said = r"nearest node that is reached is 2 at \(1.00, 1.00\), 1.41 m"
            with pytest.raises(NoPathError, match=said):
                Roadmap(graph, COST).route(2, 0)
    assert np.allclose(energies, 2 * A + SPIN * np.pi / 2)


def test_malformed_graphs_are_refused():
    graph = nx.path_graph(2)
    with pytest.raises(InvalidInputError, match="position"):
        Roadmap(graph, COST).route(0, 1)
    nx.set_node_attributes(graph, (0, 0), "pos")
    with pytest.raises(InvalidInputError, match="length"):
        Roadmap(graph, COST).route(0, 1)
    with pytest.raises(InvalidInputError, match="not in the graph"):
        Roadmap(graph, COST).route(0, 7)


# -- rounded corners --------------------------------------------------------------------------


def straight_lines(cost):
    """Return the energy of straight lines by their length."""
    return lambda ds: cost.segment_energy(ds, 0.0)


def test_without_losses_the_widest_corner_is_best():
    """Per radian a R costs nothing extra up to C, and beyond the shorter way still pays."""
    turn, limit = np.array([0.3, 1.5, 2.5]), np.array([0.3, 0.47, 2.0])
    corner = round_corner(COST.segment_energy, straight_lines(COST), C, turn, limit, np.ones(3))
    assert np.allclose(corner.radius, limit)
    expected = A * (np.maximum(limit, C) * turn - 2 * limit * np.tan(turn / 2)) + BETA * turn
    assert np.allclose(corner.price, expected)


def test_with_losses_the_pivot_beats_wide_arcs():
    """Where an inner motor's power is lost, an arc wider than C pays for power going round."""
    vehicle = replace(MODEL.vehicle, regen_efficiency=0.0)
    wasteful = ep.EnergyCost(ep.PowerModel.paper(vehicle, 113.0, 0.627), battery=True)
    turn, limit = np.array([0.1, -0.3]), np.array([3.0, 3.0])
    corner = round_corner(
        wasteful.segment_energy, straight_lines(wasteful), C, turn, limit, np.array([1.0, -1.0])
    )
    radii = np.linspace(0, 3, 3001)
    for k in range(2):
        size = abs(turn[k])
        arcs = wasteful.segment_energy(radii * size, np.full(len(radii), size))
        every = arcs - wasteful.segment_energy(2 * radii * np.tan(size / 2), 0.0)
        assert corner.radius[k] == pytest.approx(C)
        assert corner.price[k] == pytest.approx(every.min(), rel=1e-3)


def test_rounded_corners_lie_within_the_lines():
    graph = nx.path_graph(3)
    nx.set_node_attributes(graph, {0: (0, 0), 1: (2, 0), 2: (2, 3)}, "pos")
    roadmap = Roadmap(graph, COST, radius=0.6)
    route = roadmap.route(0, 2)
    assert np.allclose(np.abs(route.path.ds), [1.4, 0.6 * np.pi / 2, 2.4])
    assert route.path.end[:2] == pytest.approx((2, 3))
    # a radius that does not fit into half an edge is cut down
    wide = Roadmap(graph, COST, radius=9.0).route(0, 2)
    assert np.allclose(np.abs(wide.path.ds), [1.0, 1.0 * np.pi / 2, 2.0])


# -- edges planned among obstacles ------------------------------------------------------------


def problem(*boxes: tuple[slice, slice]) -> ep.PlanningProblem:
    """Return a hall of 10 m by 8 m with boxes of cells."""
    return ep.PlanningProblem(room(160, 200, 0.05, *boxes), COST, (1, 1, 0), (1, 1, 0))


def square(kind=nx.DiGraph) -> nx.Graph:
    graph = kind()
    for node, place in enumerate([(2, 2), (8, 2), (8, 6), (2, 6)]):
        graph.add_node(node, pos=place)
    graph.add_edges_from([(0, 1), (1, 2), (2, 3), (3, 0), (0, 3)])
    return graph


def test_free_edges_are_straight_and_pay_for_turns():
    found = plan_edges(square(), problem())
    assert found.closed == ()
    straight = price_edges(square(), COST)
    spin = float(COST.segment_energy(0.0, np.pi / 2))
    for source, target, data in found.graph.edges(data=True):
        expected = straight.edges[source, target]["cost"]
        # from place 3 the way leads on to 0 or back, from 2 on to 3 alone, and so on
        assert data["cost"] == pytest.approx(expected + (spin if (source, target) != (0, 3) else 0))
    path = found.route(0, 2)
    # at place 1 the robot does not have to stop and turn on the spot
    assert 0.9 * (10 * 226.0 + spin) < COST.energy(path) < 10 * 226.0 + spin
    assert np.allclose(path.end[:2], (8, 6))


@pytest.mark.parametrize("kind", [nx.DiGraph, nx.MultiDiGraph, nx.Graph])
def test_an_obstacle_on_an_edge_is_driven_around(kind):
    asked = problem(np.s_[30:50, 90:110])
    found = plan_edges(square(kind), asked)
    assert found.closed == ()
    state = next(s for s in found.paths if {s.source, s.target} == {0, 1})
    path = found.paths[state]
    assert asked.map.path_free(path, COST.vehicle)
    assert found.energies[state] == pytest.approx(COST.energy(path))
    assert found.energies[state] > 6 * 226.0 * 1.02
    assert found.energies[state] >= ep.steering.energy(path.start, path.end, COST) * (1 - 1e-9)
    route = found.route(0, 2)
    assert asked.map.path_free(route, COST.vehicle)


def test_closed_edges_are_told_and_left_out(tmp_path):
    walled = problem(np.s_[:, 100:104])
    found = plan_edges(square(), walled)
    assert {(edge.source, edge.target) for edge in found.closed} == {(0, 1), (2, 3)}
    assert "certainly" in found.closed[0].reason
    assert not found.graph.has_edge(0, 1)
    with pytest.raises(NoPathError, match="2 edges are closed"):
        found.route(0, 2)
    with pytest.raises(InvalidInputError):
        found.route(0, 7)
    # and of a file that was read
    write_route_graph(square(), tmp_path / "read.geojson")
    graph = read_route_graph(tmp_path / "read.geojson")
    write_route_graph(plan_edges(graph, walled).graph, tmp_path / "planned.geojson")
    again = read_route_graph(tmp_path / "planned.geojson")
    assert sorted(again.edges()) == [(0, 3), (1, 2), (3, 0)]
    told = json.loads((tmp_path / "planned.geojson").read_text())
    edges = [f["properties"] for f in told["features"] if "startid" in f["properties"]]
    assert all(edge["cost"] > 0 and edge["overridable"] is False for edge in edges)
    assert sum("startid" not in f["properties"] for f in told["features"]) == 4


def test_a_place_in_an_obstacle_closes_its_edges():
    found = plan_edges(square(), problem(np.s_[110:130, 30:50]))
    assert {(edge.source, edge.target) for edge in found.closed} == {(2, 3), (3, 0), (0, 3)}
    assert all("touches an obstacle" in edge.reason for edge in found.closed)


# -- goals of routes -------------------------------------------------------------------------------


@pytest.mark.parametrize("reverse", [False, True])
def test_a_route_ends_either_way_round_or_at_the_nearest_of_several_places(reverse):
    rng = np.random.default_rng(24)
    graph = grid_graph(rng, side=3)
    roadmap = Roadmap(graph, COST, reverse=reverse)
    for yaw in (0.4, -2.0):
        route = roadmap.route((0, 0), (2, 2), start_yaw=1.0, goal_yaw=yaw, goal_heading="either")
        both = [brute_force(graph, (0, 0), (2, 2), 1.0, one, reverse) for one in (yaw, yaw + np.pi)]
        assert route.energy == pytest.approx(min(both), rel=1e-9)
        assert np.sin(route.path.end.yaw - yaw) == pytest.approx(0.0, abs=1e-9)
        back = roadmap.route((2, 2), (0, 0), start_yaw=yaw, start_heading="either")
        both = [
            brute_force(graph, (2, 2), (0, 0), one, None, reverse) for one in (yaw, yaw + np.pi)
        ]
        assert back.energy == pytest.approx(min(both), rel=1e-9)
        docks = [(2, 1), (0, 2), (2, 2)]
        route = roadmap.route((0, 0), docks, start_yaw=yaw, goal_yaw=0.3)
        each = [brute_force(graph, (0, 0), dock, yaw, 0.3, reverse) for dock in docks]
        assert route.energy == pytest.approx(min(each), rel=1e-9)
        assert route.nodes[-1] == docks[int(np.argmin(each))]


def test_a_route_to_where_it_starts_turns_to_the_nearer_of_both_yaws():
    route = Roadmap(square(), COST).route(
        0, [2, 0], start_yaw=0.5, goal_yaw=3.0, goal_heading="either"
    )
    assert route.nodes == (0,)
    assert route.energy == pytest.approx(SPIN * (0.5 - (3.0 - np.pi)))


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"target": []}, "no target"),
        ({"target": [2, 9]}, "node 9 is not in the graph"),
        ({"target": 2, "goal_heading": "either"}, "the goal of the route: .* no yaw is given"),
        ({"target": 2, "start_heading": "back"}, "the start of the route: .* 'back'"),
        ({"target": {"x": 1}}, "is not in the graph"),
    ],
)
def test_goals_that_no_route_has_are_refused_by_name(given, message):
    target, ends = given.pop("target"), given
    for graph in (Roadmap(square(), COST), plan_edges(square(), problem())):
        with pytest.raises(InvalidInputError, match=message):
            graph.route(0, target, **ends)


def by_brute_force(places, starts, goals, headings=36):
    """Least energy over places at so many headings each, on open ground [J]."""
    every = np.arange(headings) * 2 * np.pi / headings
    cost = np.zeros(len(starts))
    yaws = np.array(starts)
    for k, (here, there) in enumerate(itertools.pairwise(places)):
        to = np.array(goals) if k + 2 == len(places) and len(goals) else every
        legs = ep.steering.energy(
            np.array([(*here, yaw) for yaw in np.repeat(yaws, len(to))]),
            np.array([(*there, yaw) for yaw in np.tile(to, len(yaws))]),
            COST,
        ).reshape(len(yaws), len(to))
        cost, yaws = (cost[:, None] + legs).min(axis=0), to
    return cost.min()


@pytest.mark.parametrize(
    ("ends", "headings"),
    [
        ({}, (None, ())),
        ({"start_yaw": 2.0, "goal_yaw": -1.0}, ([2.0], [-1.0])),
        (
            {"start_yaw": 2.0, "goal_yaw": 1.0, "goal_heading": "either"},
            ([2.0], [1.0, 1.0 + np.pi]),
        ),
        ({"goal_yaw": 1.0}, (None, [1.0])),
    ],
)
def test_planned_routes_pass_places_at_the_headings_that_cost_least(ends, headings):
    """Not only in the direction of an edge; on open ground each leg is an exact motion."""
    planned = plan_edges(square(), problem())
    path = planned.route(0, 3, **ends)
    starts = np.arange(36) * np.pi / 18 if headings[0] is None else headings[0]
    goals = headings[1]
    ways = [[(2, 2), (2, 6)], [(2, 2), (8, 2), (8, 6), (2, 6)]]
    least = min(by_brute_force(way, starts, goals) for way in ways)
    assert COST.energy(path) <= least * (1 + 1e-9)
    assert COST.energy(path) >= 0.98 * least
    far = planned.route(0, 2, **ends)
    least = by_brute_force([(2, 2), (8, 2), (8, 6)], starts, goals)
    assert 0.98 * least <= COST.energy(far) <= least * (1 + 1e-9)
    spins = 10 * 226.0 + float(COST.segment_energy(0.0, np.pi / 2))
    assert ends or COST.energy(far) < 0.99 * spins
    for route, place in ((path, (2, 6)), (far, (8, 6))):
        assert problem().map.path_free(route, COST.vehicle)
        assert route.start[:2] == pytest.approx((2, 2)) and route.end[:2] == pytest.approx(place)


def test_planned_routes_lead_to_the_place_of_several_that_takes_least():
    asked = problem(np.s_[30:50, 90:110])
    planned = plan_edges(square(), asked)
    path = planned.route(0, [2, 1], start_yaw=0.0)
    assert path.end[:2] == pytest.approx((8, 2))
    assert asked.map.path_free(path, COST.vehicle)
    own = planned.paths[next(s for s in planned.paths if (s.source, s.target) == (0, 1))]
    assert COST.energy(path) <= COST.energy(own) * (1 + 1e-9)


def test_without_room_to_turn_an_end_at_another_yaw_is_refused():
    """A lane as wide as the robot, and its ends across it."""
    lane = problem(np.s_[0:31, :], np.s_[48:160, :])
    graph = nx.DiGraph([(0, 1)])
    nx.set_node_attributes(graph, {0: (2, 1.975), 1: (6, 1.975)}, "pos")
    planned = plan_edges(graph, lane)
    assert planned.closed == ()
    assert COST.energy(planned.route(0, 1)) == pytest.approx(4 * 226.0)
    with pytest.raises(NoPathError, match="no room to turn"):
        planned.route(0, 1, goal_yaw=np.pi / 2)
