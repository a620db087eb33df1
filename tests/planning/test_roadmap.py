"""Energy graphs, visibility graphs and the roadmap planner."""

from __future__ import annotations

import itertools
from dataclasses import replace

import networkx as nx
import numpy as np
import pytest
import shapely

from energyplan import steering
from energyplan.cost import EnergyCost
from energyplan.errors import InvalidInputError, NoPathError, StartInCollisionError
from energyplan.export.graph import read_route_graph
from energyplan.path import Path, Pose, wrap_angle
from energyplan.planning import PlanningProblem, plan
from energyplan.planning import roadmap as rm
from energyplan.planning.roadmap import traced
from energyplan.planning.roadmap.routes import round_corner
from energyplan.planning.space.compiled import CompiledProblem
from energyplan.power import HOTEL, PowerModel
from energyplan.power.effects import VISCOUS_LOSS
from energyplan.terrain import OccupancyGrid, Surface, SurfaceMap
from energyplan.vehicle import MotorLimits, TreadICR

MODEL = PowerModel.preset("quadriga:empty:concrete")
COST = EnergyCost(MODEL)
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
        route = rm.Roadmap(graph, COST, reverse=reverse).route(
            (0, 0), (2, 2), start_yaw=ends[0], goal_yaw=ends[1]
        )
        expected = brute_force(graph, (0, 0), (2, 2), *ends, reverse)
        assert route.energy == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize(
    "objective", ["energy", "length", "time", {"energy": 1.0, "time": 300.0, "length": 20.0}]
)
def test_routes_are_the_best_of_all_at_every_objective(objective):
    """Hotel load and a limit of power: a turn and a metre have prices of their own in each."""
    vehicle = replace(MODEL.vehicle, motor=MotorLimits(continuous_power=150.0, speed=1.2))
    cost = EnergyCost(replace(MODEL, vehicle=vehicle).with_term(HOTEL, 90.0))
    weights = {objective: 1.0} if isinstance(objective, str) else objective

    def price(ds, turn):
        """By hand: what `Plan.cost` is said to be."""
        motion = Path(Pose(0, 0, 0), [ds], [turn])
        energy = cost.energy(motion)
        tied = abs(ds) + 0.01 * energy / cost.energy(Path(Pose(0, 0, 0), [1.0], [0.0]))
        total = weights.get("energy", 0) * energy + weights.get("length", 0) * tied
        return total + weights.get("time", 0) * cost.duration(motion)

    rng = np.random.default_rng(28)
    for _ in range(4):
        graph = grid_graph(rng, side=3)
        roadmap = rm.Roadmap(graph, cost, objective=objective)
        route = roadmap.route((0, 0), (2, 2), start_yaw=1.5)
        expected = brute_force(
            graph, (0, 0), (2, 2), 1.5, None, True, price(1.0, 0.0), price(0.0, 1.0)
        )
        assert route.cost == pytest.approx(expected, rel=1e-6)
        assert route.energy == pytest.approx(cost.energy(route.path), rel=1e-12)


def test_a_route_ends_where_it_should():
    rng = np.random.default_rng(22)
    graph = grid_graph(rng)
    nx.set_node_attributes(graph, 0.5, "radius")
    ahead = MODEL.vehicle.with_icr(TreadICR(0.5, 0.45, 0.1))
    cost = EnergyCost(PowerModel.paper(ahead, 113.0, 0.627))
    route = rm.Roadmap(graph, cost).route((0, 0), (3, 2), start_yaw=2.5, goal_yaw=-1.0)
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
    ground = SurfaceMap(
        [Surface(shapely.box(3, -5, 20, 20), PowerModel.preset("quadriga:empty:marble"))]
    )
    for radius, surfaces in ((0.0, ground), (0.6, None)):
        roadmap = rm.Roadmap(graph, COST, surfaces=surfaces, radius=radius)
        route = roadmap.route((0, 0), (3, 3))
        arcs = [roadmap.states[a][b]["weight"] for a, b in itertools.pairwise(route.states)]
        first = roadmap.states.nodes[route.states[0]]["cost"]
        assert route.energy == pytest.approx(first + sum(arcs), rel=1e-9)


def test_turns_change_the_best_route():
    """A staircase is no longer than an L, and costs five quarter turns more."""
    graph = nx.grid_2d_graph(4, 4)
    nx.set_node_attributes(graph, {n: n for n in graph}, "pos")
    route = rm.Roadmap(graph, COST).route((0, 0), (3, 3))
    turns = np.count_nonzero(route.path.dtheta)
    assert turns == 1
    assert route.energy == pytest.approx(6 * A + SPIN * np.pi / 2)


def test_backing_out_of_a_dead_end_is_cheaper_than_turning_round():
    graph = nx.path_graph(3)
    nx.set_node_attributes(graph, {0: (0, 0), 1: (2, 0), 2: (5, 0)}, "pos")
    route = rm.Roadmap(graph, COST).route(2, 0, start_yaw=0.0)
    assert [s.gear for s in route.states] == [-1, -1]
    assert route.energy == pytest.approx(5 * A)
    forward = rm.Roadmap(graph, COST, reverse=False).route(2, 0, start_yaw=0.0)
    assert forward.energy == pytest.approx(5 * A + SPIN * np.pi)


def test_any_kind_of_graph_will_do():
    place = {0: (0, 0), 1: (1, 0), 2: (1, 1)}
    energies = []
    for kind in (nx.Graph, nx.DiGraph, nx.MultiGraph, nx.MultiDiGraph):
        graph = kind([(0, 1), (1, 2)])
        nx.set_node_attributes(graph, {n: x for n, (x, _) in place.items()}, "x")
        nx.set_node_attributes(graph, {n: y for n, (_, y) in place.items()}, "y")
        energies.append(rm.Roadmap(graph, COST).route(0, 2).energy)
        if graph.is_directed():
            with pytest.raises(
                NoPathError, match=r"nearest node that is reached is 2 at \(1.00, 1.00\), 1.41 m"
            ):
                rm.Roadmap(graph, COST).route(2, 0)
    assert np.allclose(energies, 2 * A + SPIN * np.pi / 2)


def test_malformed_graphs_are_refused():
    graph = nx.path_graph(2)
    with pytest.raises(InvalidInputError, match="position"):
        rm.Roadmap(graph, COST).route(0, 1)
    nx.set_node_attributes(graph, (0, 0), "pos")
    with pytest.raises(InvalidInputError, match="length"):
        rm.Roadmap(graph, COST).route(0, 1)
    with pytest.raises(InvalidInputError, match="not in the graph"):
        rm.Roadmap(graph, COST).route(0, 7)


# -- rounded corners --------------------------------------------------------------------------


def test_without_losses_the_widest_corner_is_best():
    """Per radian a R costs nothing extra up to C, and beyond the shorter way still pays."""
    turn, limit = np.array([0.3, 1.5, 2.5]), np.array([0.3, 0.47, 2.0])
    corner = round_corner(COST.segment_energy, C, turn, limit, np.ones(3))
    assert np.allclose(corner.radius, limit)
    expected = A * (np.maximum(limit, C) * turn - 2 * limit * np.tan(turn / 2)) + BETA * turn
    assert np.allclose(corner.price, expected)


def test_with_losses_the_pivot_beats_wide_arcs():
    """Where an inner motor's power is lost, an arc wider than C pays for power going round."""
    vehicle = replace(MODEL.vehicle, regen_efficiency=0.0)
    wasteful = EnergyCost(PowerModel.paper(vehicle, 113.0, 0.627), battery=True)
    turn, limit = np.array([0.1, -0.3]), np.array([3.0, 3.0])
    corner = round_corner(wasteful.segment_energy, C, turn, limit, np.array([1.0, -1.0]))
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
    roadmap = rm.Roadmap(graph, COST, radius=0.6)
    route = roadmap.route(0, 2)
    assert np.allclose(np.abs(route.path.ds), [1.4, 0.6 * np.pi / 2, 2.4])
    assert route.path.end[:2] == pytest.approx((2, 3))
    # a radius that does not fit into half an edge is cut down
    wide = rm.Roadmap(graph, COST, radius=9.0).route(0, 2)
    assert np.allclose(np.abs(wide.path.ds), [1.0, 1.0 * np.pi / 2, 2.0])


def test_the_best_radius_is_as_good_as_any():
    """Where a viscous loss makes slow arcs cheap, no radius of three thousand is much better."""
    cost = EnergyCost(MODEL.with_term(HOTEL, 60.0).with_term(VISCOUS_LOSS, 300.0))
    turn, limit = np.array([0.4, 1.2, -2.0]), np.array([2.0, 1.5, 0.9])
    corner = round_corner(cost.segment_energy, C, turn, limit, np.ones(3))
    for k in range(3):
        radii, size = np.linspace(0, limit[k], 3001), abs(turn[k])
        arcs = cost.segment_energy(radii * size, np.full(len(radii), turn[k]))
        every = arcs - cost.segment_energy(2 * radii * np.tan(size / 2), 0.0)
        assert corner.price[k] <= every.min() + 1e-3 * abs(every.min())


# -- visibility graphs ------------------------------------------------------------------------


def test_shortest_way_round_a_box():
    """Against the length by hand: over the mitred corners of the box grown by the clearance."""
    graph = rm.visibility_graph(shapely.box(2, -1, 4, 3), 0.5, [(0, 0), (6, 0)])
    length = nx.dijkstra_path_length(graph, 0, 1, weight="length")
    assert length == pytest.approx(2 * np.hypot(1.5, 1.5) + 3.0)
    assert all(data["radius"] == 0.5 for node, data in graph.nodes(data=True) if node > 1)


def test_tracing_covers_the_map_closely():
    rng = np.random.default_rng(25)
    discs = [shapely.Point(*rng.uniform(1, 5, 2)).buffer(0.4) for _ in range(5)]
    grid = OccupancyGrid.from_polygons(discs, (0, 0, 6, 6), 0.05)
    area = traced(grid, 0.05)
    row, column = np.nonzero(grid.blocked)
    cells = shapely.union_all(shapely.box(column, row, column + 1, row + 1))
    cells = shapely.transform(cells, grid.to_world)
    assert cells.difference(area.buffer(0.03)).area == 0
    assert area.difference(cells.buffer(0.06, join_style="mitre")).area < 1e-12
    assert shapely.get_num_coordinates(area) < 0.6 * shapely.get_num_coordinates(cells)


# -- the planner ------------------------------------------------------------------------------


def road(problem, **options):
    return plan(problem, "roadmap", effort=1_000_000, **options)


def hall(*boxes, size=(12.0, 10.0)):
    return OccupancyGrid.from_polygons([shapely.box(*b) for b in boxes], (0, 0, *size), 0.05)


def test_plan_in_an_empty_hall_turns_drives_and_turns():
    problem = PlanningProblem(hall((11, 9, 12, 10)), COST, (1, 1, 0.4), (6, 5, 1.2))
    found = road(problem, refine=False)
    bearing = np.arctan2(4, 5)
    turning = abs(bearing - 0.4) + abs(1.2 - bearing)
    assert found.energy == pytest.approx(A * np.hypot(4, 5) + SPIN * turning)
    assert found.lower_bound <= found.energy
    assert found.lower_bound >= 0.999 * float(steering.energy(problem.start, problem.goal, COST))
    assert found.planner == "roadmap"
    # exact steering does better than turning on the spot
    assert road(problem).energy == pytest.approx(found.lower_bound, rel=1e-3)


def test_plans_are_free_and_end_at_the_goal():
    rng = np.random.default_rng(26)
    boxes = [(x, y, x + 0.8, y + 0.6) for x in (2, 4.5, 7, 9.5) for y in (1.5, 4, 6.5)]
    grid = hall(*boxes)
    vehicle = MODEL.vehicle
    poses = np.column_stack(
        [rng.uniform(0.6, 11, 40), rng.uniform(0.6, 9, 40), rng.uniform(-3, 3, 40)]
    )
    poses = poses[grid.footprint_free(poses, vehicle)]
    for start, goal in zip(poses[:6], poses[6:12], strict=True):
        try:
            found = road(PlanningProblem(grid, COST, start, goal))
        except NoPathError:
            # the corner of a body that cannot turn on the spot where it stands
            circle = [[(*p[:2], yaw) for yaw in np.linspace(0, 6.28, 60)] for p in (start, goal)]
            assert not np.all(grid.footprint_free(circle, vehicle))
            continue
        assert grid.path_free(found.path, vehicle)
        assert np.allclose(found.path.end[:2], goal[:2], atol=1e-6)
        assert wrap_angle(found.path.end.yaw - goal[2]) == pytest.approx(0.0, abs=1e-6)
        assert found.lower_bound <= found.energy * (1 + 1e-9)


@pytest.mark.parametrize("objective", ["energy", "length", "time", {"energy": 1, "time": 200}])
def test_plans_follow_the_objective(objective):
    """No dearer than the lattice planner's by more than a little, and above its bound."""
    boxes = [(x, y, x + 0.8, y + 0.6) for x in (2, 4.5, 7, 9.5) for y in (1.5, 4, 6.5)]
    problem = PlanningProblem(hall(*boxes), COST, (1, 1, 0.4), (11, 8.5, 1.2), objective=objective)
    found, other = road(problem), plan(problem, effort=10_000)
    assert found.cost == pytest.approx(CompiledProblem(problem).value(found.path))
    assert max(found.lower_bound, other.lower_bound) <= found.cost <= 1.02 * other.cost
    assert problem.map.path_free(found.path, MODEL.vehicle)


def test_objectives_differ_in_what_they_make_least():
    boxes = [(x, y, x + 0.8, y + 0.6) for x in (2, 4.5, 7, 9.5) for y in (1.5, 4, 6.5)]
    problem = PlanningProblem(hall(*boxes), COST, (1, 1, 0.4), (11, 8.5, -2.0))
    plans = [
        road(replace(problem, objective=name), refine=False)
        for name in ("energy", "length", "time")
    ]
    for k, values in enumerate(
        zip(*((p.energy, p.length, p.duration) for p in plans), strict=True)
    ):
        assert values[k] <= min(values) * (1 + 1e-9)
        assert values[k] < max(values)


def test_plan_on_a_given_graph():
    """Its edges through obstacles are not driven."""
    grid = hall((4, 0, 5, 6))
    graph = nx.Graph([("low", "right"), ("low", "high"), ("high", "right")])
    place = {"low": (2, 2), "high": (4.5, 8), "right": (8, 2)}
    nx.set_node_attributes(graph, place, "pos")
    problem = PlanningProblem(grid, COST, (1, 2, 0), (10, 2, 0))
    found = road(problem, graph=graph)
    assert found.path.poses()[:, 1].max() > 7
    blocked = graph.copy()
    blocked.remove_node("high")
    with pytest.raises(NoPathError):
        road(problem, graph=blocked)


def test_what_cannot_be_planned_is_refused():
    grid = hall((4, 0, 5, 10))
    with pytest.raises(NoPathError, match=r"\(1.00, 2.00\) to .* at \(10.00, 2.00\).*lattice"):
        road(PlanningProblem(grid, COST, (1, 2, 0), (10, 2, 0)))
    with pytest.raises(StartInCollisionError):
        road(PlanningProblem(grid, COST, (4.5, 2, 0), (10, 2, 0)))


@pytest.mark.shared
def test_nav2_graph_routes_cost_at_least_the_free_minimum(shared_data):
    graph = read_route_graph(shared_data / "route_graphs" / "turtlebot4_graph.geojson")
    roadmap = rm.Roadmap(graph, COST)
    nodes = sorted(graph)
    for target in nodes[1::5]:
        route = roadmap.route(nodes[0], target, start_yaw=0.3, goal_yaw=1.0)
        least = float(steering.energy(route.path.start, route.path.end, COST))
        assert route.energy >= least * (1 - 1e-9)
