"""Power that depends on the heading, as along and across the rows of a field."""

from __future__ import annotations

import heapq
from dataclasses import replace

import networkx as nx
import numpy as np
import pytest
import shapely
from worlds import room

import energyplan as ep
from energyplan.battery import Battery
from energyplan.errors import MissingChannelError
from energyplan.export.lattice import control_set
from energyplan.export.table import tabulate
from energyplan.mission import Mission, Spreads, Task, evaluate
from energyplan.path import wrap_angle
from energyplan.planning.bound import lower_bound
from energyplan.planning.bound.headings import heading_forces
from energyplan.planning.driven import drive_plan
from energyplan.planning.graphs import Roadmap, price_edges
from energyplan.planning.space.compiled import compiled
from energyplan.power import Sides, Term
from energyplan.power.effects import term, with_weight
from energyplan.terrain import Surface

BARE = ep.PowerModel.preset("quadriga:empty:marble")
K = BARE.coefficient("traction_resistance")
SLIP = BARE.coefficient("slip_friction") * BARE.vehicle.slip_moment
HALL = room(160, 160, 0.1)


def depending(force, size):
    """Return a model with a force on both sides [N] as a function of the heading."""

    def both(motion, vehicle):
        share = force(motion.channels["yaw"])
        return Sides(share * np.sign(motion.v_left), share * np.sign(motion.v_right))

    return BARE.with_term(Term("crop_rows", "c", "N", "force", both, channels=("yaw",)), size)


def rows(yaw):
    return np.abs(np.sin(yaw))


def axes(yaw):
    return np.abs(np.sin(2 * (yaw - 0.3)))


def uneven(yaw):
    return 1.0 + 0.7 * np.cos(yaw - 0.8) + 0.3 * np.sin(3 * yaw)


CROP = ep.EnergyCost(depending(rows, 100.0))
AXES = ep.EnergyCost(depending(axes, 200.0))


def integrated(path, force, size, steps=4000):
    """Energy of a path in small steps, by the model's formula alone [J]."""
    total, yaw, icr = 0.0, path.start.yaw, BARE.vehicle.icr
    for ds, turn in zip(path.ds, path.dtheta, strict=True):
        at = yaw + turn * (np.arange(steps) + 0.5) / steps
        treads = abs(ds - icr.left * turn) + abs(ds + icr.right * turn)
        total += treads * np.mean(K + size * force(at)) + SLIP * abs(turn)
        yaw += turn
    return total


@pytest.mark.parametrize(("goal", "joules"), [((12, 4, 0), 1440), ((4, 12, np.pi / 2), 3040)])
def test_a_straight_line_along_rows_takes_less_than_one_across(goal, joules):
    found = ep.plan(ep.PlanningProblem(HALL, CROP, (4, 4, goal[2]), goal), effort=1000)
    assert found.energy_driven == pytest.approx(joules, rel=1e-9)
    assert found.energy_steady == pytest.approx(joules, rel=1e-9)
    assert found.lower_bound <= joules * (1 + 1e-9)
    check = ep.check(found.driven.trajectory, CROP.model)
    assert check.energy == pytest.approx(joules, rel=1e-9)


@pytest.mark.parametrize("force", [rows, axes, uneven])
@pytest.mark.parametrize("seed", range(3))
def test_the_energy_of_a_plan_is_the_integral_of_the_power_along_its_path(force, seed):
    rng = np.random.default_rng(seed)
    x, y = rng.integers(40, 90, 2)
    grid = room(160, 160, 0.1, np.s_[y : y + 30, x : x + 30])
    ends = [(3, 3, rng.uniform(-3, 3)), (13, 13, rng.uniform(-3, 3))]
    cost = ep.EnergyCost(depending(force, 60.0))
    found = ep.plan(ep.PlanningProblem(grid, cost, *ends), effort=2000)
    expected = integrated(found.path, force, 60.0)
    assert found.energy_steady == pytest.approx(expected, rel=1e-4)
    assert found.energy_driven == pytest.approx(expected, rel=1e-4)
    assert sum(found.driven.breakdown.values()) == pytest.approx(found.energy_driven)
    assert cost.energy(found.path) == pytest.approx(expected, rel=1e-4)
    assert found.lower_bound <= expected


def by_brute_force(grid, force, size, start, goal, spacing=0.5, headings=24):
    """Least energy on a grid of places and headings, by a search of its own [J].

    Motions are spins by one heading, and straight lines to places up to three apart that lie along
    the heading, for which the robot turns a little and back.
    """
    turn = 2 * np.pi / headings

    def line(x, y, to, yaw, gear):
        dx, dy = to[0] - x, to[1] - y
        way = np.arctan2(dy, dx) + (0 if gear > 0 else np.pi)
        off = (way - yaw + np.pi) % (2 * np.pi) - np.pi
        ds, turns = np.array([0, gear * np.hypot(dx, dy), 0]), np.array([off, 0, -off])
        path = ep.Path((x, y, yaw), ds, turns)
        free = abs(off) <= 0.51 * turn and grid.path_free(path, BARE.vehicle)
        return integrated(path, force, size, 20) if free else np.inf

    reach = [(i, j) for i in range(-3, 4) for j in range(-3, 4) if np.gcd(i, j) == 1]
    best, heap = {start: 0.0}, [(0.0, start)]
    while heap:
        g, here = heapq.heappop(heap)
        if here == goal:
            return g
        if g > best[here]:
            continue
        column, row, h = here
        x, y, yaw = column * spacing, row * spacing, h * turn
        onward = []
        for side in (-1, 1):
            spin = ep.Path((x, y, yaw), [0.0], [side * turn])
            if grid.path_free(spin, BARE.vehicle):
                onward.append(((column, row, (h + side) % headings),
                               integrated(spin, force, size, 20)))  # fmt: skip
        for i, j in reach:
            to = (x + spacing * i, y + spacing * j)
            if not np.all((np.array(to) > 0.5) & (np.array(to) < np.array(grid.size) - 0.5)):
                continue
            onward += [((column + i, row + j, h), line(x, y, to, yaw, gear)) for gear in (1, -1)]
        for there, price in onward:
            if g + price < best.get(there, np.inf):
                best[there] = g + price
                heapq.heappush(heap, (g + price, there))
    return np.inf


def test_no_path_of_a_small_map_takes_less_than_the_plan_and_none_less_than_the_bound():
    """Along the axes of the ground, two lines take less than the one across them."""

    def along_axes(yaw):
        return np.abs(np.sin(2 * yaw))

    grid = room(60, 60, 0.1)
    cost = ep.EnergyCost(depending(along_axes, 200.0))
    problem = ep.PlanningProblem(grid, cost, (1, 1, 0), (5, 5, 0))
    found = ep.plan(problem, effort=10_000)
    least = by_brute_force(grid, along_axes, 200.0, (2, 2, 0), (10, 10, 0))
    straight = ep.Path(problem.start, [0, 4 * np.sqrt(2), 0], [np.pi / 4, 0, -np.pi / 4])
    assert found.lower_bound <= found.energy_driven <= least * (1 + 1e-6)
    assert least < 0.8 * problem.terrain.price(straight, cost).energy


def of_waves(rng):
    """Return a force that varies around the circle, with a few waves of any phase."""
    size, phase = rng.uniform(0, 1, 4), rng.uniform(0, 2 * np.pi, 4)

    def force(yaw):
        waves = [
            a * np.cos(k * (yaw - p)) for k, (a, p) in enumerate(zip(size, phase, strict=True), 1)
        ]
        return size.sum() + np.sum(waves, axis=0)

    return force


@pytest.mark.parametrize(("goal", "gap"), [((12, 4, 0), 1e-9), ((4, 12, np.pi / 2), 1e-4)])
def test_the_bound_knows_the_direction_of_the_way(goal, gap):
    """Across the rows it was half of what the straight line takes."""
    found = ep.plan(ep.PlanningProblem(HALL, CROP, (4, 4, goal[2]), goal), effort=1000)
    assert -1e-9 < found.gap < gap


def test_the_bound_goes_about_obstacles_in_the_directions_that_cost_least():
    """A wall along the rows, whose end is 6 m away across them: there and back again."""
    grid = room(160, 160, 0.1, np.s_[20:160, 78:82])
    found = ep.plan(ep.PlanningProblem(grid, CROP, (4, 8, 0), (12, 8, 0)), effort=8000)
    assert 0 < found.gap < 0.2
    across = 2 * 100.0 * 2 * (8.0 - 2.0)
    assert found.lower_bound > across + 2 * K * 2 * np.hypot(4.0, 6.0)


@pytest.mark.parametrize("seed", range(4))
def test_no_path_about_an_obstacle_takes_less_than_the_bound(seed):
    rng = np.random.default_rng(seed)
    row, column = rng.integers(18, 28, 2)
    grid = room(60, 60, 0.1, np.s_[row : row + 14, column : column + 14])
    force = of_waves(rng)
    cost = ep.EnergyCost(depending(force, 150.0))
    start, goal = (2, 2, int(rng.integers(24))), (10, 10, int(rng.integers(24)))
    ends = [(0.5 * x, 0.5 * y, h * np.pi / 12) for x, y, h in (start, goal)]
    least = by_brute_force(grid, force, 150.0, start, goal)
    bound = lower_bound(compiled(ep.PlanningProblem(grid, cost, *ends)), 3.0 * least).value
    assert 0.0 < bound <= least * (1 + 1e-9)


@pytest.mark.parametrize("seed", range(20))
def test_no_zigzag_on_open_ground_takes_less_than_the_bound(seed):
    """A thousand paths to one pose, of straight lines and turns on the spot, and arcs."""
    rng = np.random.default_rng(seed)
    force = of_waves(rng) if seed % 2 else rows if seed % 4 else axes
    cost = ep.EnergyCost(depending(force, rng.uniform(20, 300)))
    ends = (3, 3, rng.uniform(-3, 3)), (rng.uniform(6, 13), rng.uniform(3, 13), rng.uniform(-3, 3))
    problem = ep.PlanningProblem(HALL, cost, *ends)
    bound = lower_bound(compiled(problem), 1e9).value
    forces = heading_forces(compiled(problem)).total
    assert bound >= np.abs(forces @ (np.array(ends[1][:2]) - ends[0][:2])).max()
    for _ in range(50):
        via = rng.uniform(3, 13, (rng.integers(0, 4), 2))
        places = np.array([ends[0][:2], *via, ends[1][:2]])
        yaw, moves = ends[0][2], []
        for step in np.diff(places, axis=0):
            gear = rng.choice([-1, 1])
            way = np.arctan2(step[1], step[0]) + (0 if gear > 0 else np.pi)
            moves += [(0.0, wrap_angle(way - yaw)), (gear * np.hypot(*step), 0.0)]
            yaw = way
        moves.append((0.0, wrap_angle(ends[1][2] - yaw)))
        path = ep.Path(ends[0], *np.array(moves, float).T)
        assert problem.terrain.price(path, cost).energy >= bound * (1 - 1e-9)


def test_no_drive_at_any_speed_takes_less_than_the_bound_by_direction():
    """Rows count for less where a loss that grows with speed adds to them."""
    viscous = CROP.model.with_term(term("viscous_loss"), 60.0)
    problem = ep.PlanningProblem(
        HALL, ep.EnergyCost(viscous), (4, 4, np.pi / 2), (4, 12, np.pi / 2)
    )
    found = ep.plan(problem, effort=200)
    for speed in (0.05, 0.2, 1.0):
        slow = replace(problem, cost=ep.EnergyCost(viscous, speed=speed))
        assert found.lower_bound <= drive_plan(slow, found.path).energy
    assert found.lower_bound > 0.7 * 8 * 2 * (K + 100.0)


def test_a_field_that_is_turned_with_its_rows_has_the_same_energies():
    turned = ep.OccupancyGrid(HALL.occupied, 0.1, (0.0, 0.0, 0.9))
    cost = ep.EnergyCost(depending(lambda yaw: uneven(yaw - 0.9), 60.0))
    first = ep.PlanningProblem(
        HALL, ep.EnergyCost(depending(uneven, 60.0)), (3, 4, 0.2), (12, 9, 2.0)
    )
    ends = [
        (*turned.to_world([10 * x, 10 * y]), yaw + 0.9) for x, y, yaw in (first.start, first.goal)
    ]
    second = ep.PlanningProblem(turned, cost, *ends)
    found = [ep.plan(problem, effort=3000) for problem in (first, second)]
    assert found[0].energy_driven == pytest.approx(found[1].energy_driven, rel=0.01)
    assert found[0].lower_bound_steady == pytest.approx(found[1].lower_bound_steady, rel=1e-5)


def test_a_cost_without_a_heading_is_the_least_of_all_headings():
    cost = ep.EnergyCost(depending(uneven, 60.0))
    angle = np.linspace(-np.pi, np.pi, 37)
    ds, turn = np.cos(angle), np.sin(angle) / cost.half_track
    every = cost.segment_energy(ds, turn, yaw=np.linspace(-np.pi, np.pi, 20_001)[:, None])
    assert cost.segment_energy(ds, turn) == pytest.approx(every.min(axis=0), rel=1e-6)
    assert np.all(cost.segment_energy(ds, turn) <= every.min(axis=0) * (1 + 1e-9))
    bound = cost.lower_bound()
    assert np.all(bound.energy(ds, turn) <= every.min(axis=0) * (1 + 1e-9))


def test_rows_of_a_surface_hold_on_it_alone():
    ground = ep.SurfaceMap([Surface(shapely.box(4, 0, 8, 16), CROP.model, "field")])
    problem = ep.PlanningProblem(
        HALL, ep.EnergyCost(BARE), (2, 8, 0.0), (10, 8, 0.0), surfaces=ground
    )
    turned = ep.Path((2, 8, 0.0), [0, 8, 0], [0.5, 0, -0.5])
    energy = problem.terrain.price(turned, problem.cost).energy
    plain = integrated(turned, rows, 0.0)
    assert energy == pytest.approx(plain + 2 * 4 / np.cos(0.5) * 100.0 * np.sin(0.5), rel=1e-9)
    found = ep.plan(problem, effort=1000)
    assert found.energy_driven == pytest.approx(8 * 2 * K, rel=1e-9)


def test_rows_on_a_slope_are_priced_with_it():
    slope = ep.HeightMap(0.1 * np.arange(18.0) * np.ones((18, 1)), 1.0, ep.Pose(-1.0, -1.0, 0.0))
    model = with_weight(CROP.model)
    cost = ep.EnergyCost(model)
    problem = ep.PlanningProblem(HALL, cost, (4, 4, 0.4), (12, 9, 0.4), heights=slope)
    found = ep.plan(problem, effort=2000)
    climb = model.coefficient("grade") * 9.80665 * 0.1 * 8
    flat = integrated(found.path, rows, 100.0)
    assert flat + climb < found.energy_driven < 1.01 * (flat + climb)
    assert found.lower_bound <= found.energy_driven


def test_graphs_range_and_missions_know_the_rows():
    graph = nx.Graph()
    for name, place in {"a": (4, 4), "b": (12, 4), "c": (4, 12), "d": (12, 12)}.items():
        graph.add_node(name, pos=place)
    graph.add_edges_from(["ab", "ac", "bd", "cd"])
    priced = price_edges(graph, CROP)
    assert [priced.edges["a", end]["cost"] for end in "bc"] == pytest.approx([1440, 3040])
    route = Roadmap(graph, CROP, radius=1.0).route("a", "d", start_yaw=0.4)
    assert route.energy == pytest.approx(integrated(route.path, rows, 100.0), rel=1e-4)
    assert route.cost == pytest.approx(route.energy, rel=1e-4)
    within = ep.energy_map(ep.PlanningProblem(HALL, CROP, (4, 4, 0), (4, 4, 0)))
    along, across = within.energy_at([(12, 4), (4, 12)])
    assert 1400 < along < 1600
    assert 3040 < across < 3500
    upper = ep.energy_map(
        ep.PlanningProblem(HALL, CROP, (4, 4, 0), (4, 4, 0)),
        confidence=0.9, coefficient_spread=0.05, back=(4, 4, 0),
    )  # fmt: skip
    assert 2 * along < upper.energy_at((12, 4)) < 2 * across
    mission = Mission(
        model=CROP.model, map=HALL, start=(4, 4, 0), battery=Battery.preset("quadriga"),
        tasks=(Task("along", (12, 4, 0)), Task("across", (12, 12, np.pi / 2))),
        spreads=Spreads.none(), planning_effort=1000, confidence=0.5,
    )  # fmt: skip
    report = evaluate(mission)
    spin = integrated(ep.Path((0, 0, 0), [0.0], [np.pi / 2]), rows, 100.0)
    assert report.task("along").energy == pytest.approx(1440, rel=1e-6)
    # turning with one side ahead takes less than turning on the spot
    assert 3040 < report.task("across").energy < 3040 + spin


def test_what_holds_for_any_heading_refuses_a_term_that_reads_it():
    wanted = "'crop_rows' of the model .* depends on the heading, and {} holds for any"
    with pytest.raises(MissingChannelError, match=wanted.format("exact steering")):
        ep.steering.path((0, 0, 0), (1, 0, 0), CROP)
    with pytest.raises(MissingChannelError, match=wanted.format("a table of costs")):
        tabulate(CROP)
    with pytest.raises(MissingChannelError, match=wanted.format("a control set")):
        control_set(CROP, 0.1)
    with pytest.raises(MissingChannelError, match=wanted.format("the energy at a given speed")):
        CROP.per_metre(0.0, speed=0.5)
    along = replace(CROP, channels={"yaw": 0.0})
    assert float(ep.steering.energy((0, 0, 0), (1, 0, 0), along)) == pytest.approx(2 * K)


@pytest.mark.parametrize("size", [200.0, 300.0])
def test_a_zigzag_along_two_axes_pays_for_the_turns_between_them(size):
    """Its bound knows them, and stays below the best of all zigzags along two directions."""
    cost, (start, goal) = ep.EnergyCost(depending(axes, size)), ((3, 3, 1.09), (10, 12, 1.09))
    problem = ep.PlanningProblem(HALL, cost, start, goal)
    query = compiled(problem)
    bound = lower_bound(query, 1e9).value
    along, across = np.abs(
        np.array([[np.cos(a), np.sin(a)] for a in (0.3, 0.3 + np.pi / 2)]) @ [7, 9]
    )
    metres = query.least.metre * (along + across)
    assert bound > metres + 0.9 * query.least.radian * np.pi / 2
    for turn in np.arange(0.0, np.pi, np.pi / 36):
        ways = [(0.3 + turn, 0.3 + np.pi / 2), (0.3 + turn, 0.3 + turn + np.pi / 2)]
        for one, two in ways:
            basis = np.array([[np.cos(one), np.cos(two)], [np.sin(one), np.sin(two)]])
            if abs(np.linalg.det(basis)) < 0.1:
                continue
            lengths, yaw, moves = np.linalg.solve(basis, [7, 9]), 1.09, []
            for way, length in zip((one, two), lengths, strict=True):
                moves += [(0.0, wrap_angle(2 * (way - yaw)) / 2), (length, 0.0)]
                # either end of the robot leads: the nearer turn
                ahead = yaw + moves[-2][1]
                moves[-1] = (length * np.sign(np.cos(ahead - way)), 0.0)
                yaw = ahead
            moves.append((0.0, wrap_angle(1.09 - yaw)))
            path = ep.Path(start, *np.array(moves, float).T)
            assert np.hypot(*np.subtract(path.end[:2], goal[:2])) < 1e-6
            assert problem.terrain.price(path, cost).energy >= bound * (1 - 1e-9)
