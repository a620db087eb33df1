from dataclasses import replace
from itertools import product

import networkx as nx
import numpy as np
import pytest
import shapely
from by_day import by_day
from random_models import random_model
from scipy import ndimage
from worlds import COST, MAPS, cluttered, free_poses, room

from energyplan import steering
from energyplan.cost import EnergyCost
from energyplan.cost.steering import StaticSteering
from energyplan.errors import NoPathError, TimeLimitError
from energyplan.io.maps import read_map
from energyplan.path import Path, Pose
from energyplan.planning import PlanningProblem, bound, plan
from energyplan.planning.bound import EFFORT, corners, line, lower_bound
from energyplan.planning.bound.corners import DiscEnds, ways_to_goal
from energyplan.planning.bound.headings import EUCLIDEAN
from energyplan.planning.bound.line import (
    HEADINGS,
    MOST,
    NORMALS,
    Beyond,
    Rates,
    Section,
    gate,
    to_gate,
)
from energyplan.planning.bound.outline import (
    DETAILS,
    _level_set,
    no_links,
    outline_for,
    sight,
)
from energyplan.planning.bound.surfaces import _certain_regions, least_excess, least_steps
from energyplan.planning.driven import drive_path
from energyplan.planning.settings import OUTLINES
from energyplan.planning.space.compiled import CompiledProblem
from energyplan.power import HOTEL, PowerModel
from energyplan.power.effects import term
from energyplan.terrain import OccupancyGrid, Surface, SurfaceMap, Terrain
from energyplan.terrain.collision import Body

SPACING = 2 * np.pi / HEADINGS


def outline(grid, radius, detail=DETAILS[0]):
    return outline_for(grid, radius, detail)


def nearly_a_point(metre, radian, half_track=0.01, size=0.05):
    """A robot for which the relaxed problem of the bound is almost the problem itself."""
    cost = EnergyCost.from_coefficients(metre, radian, half_track)
    footprint = [[-size, -size], [size, size]]
    vehicle = replace(cost.vehicle, footprint=np.array(footprint))
    return EnergyCost(replace(cost.model, vehicle=vehicle))


# -- the outline -----------------------------------------------------------------------------------


@pytest.mark.parametrize("exact", [True, False])
def test_outline_lies_within_the_grown_obstacles(exact, monkeypatch):
    if not exact:
        monkeypatch.setattr("energyplan.planning.bound.outline.MOST_RUNS", 0)
    grid = cluttered(2)
    radius = 0.318
    corners = outline(grid, radius)
    assert len(corners.point) > 20
    ends = corners.edges.reshape(-1, 2, 2)
    along = np.linspace(0, 1, 9)[:, None, None]
    points = (ends[:, 0] * (1 - along) + ends[:, 1] * along).reshape(-1, 2)
    blocked = np.argwhere(grid.blocked)[:, ::-1] * grid.resolution
    # distance from points to the nearest blocked cell's area
    low, high = blocked, blocked + grid.resolution
    worst = 0.0
    for chunk in np.array_split(points, 40):
        gap = np.maximum(np.maximum(low - chunk[:, None], chunk[:, None] - high), 0)
        worst = max(worst, float(np.hypot(gap[..., 0], gap[..., 1]).min(axis=1).max()))
    edge = np.minimum(points.min(axis=1), (np.array(grid.size) - points).min(axis=1))
    assert worst <= radius + 1e-9 or np.any(edge < radius)
    assert worst > corners.inside - 1e-9


def test_lines_through_obstacles_are_closed_and_others_open():
    grid = room(100, 100, 0.05, np.s_[40:60, 40:60])
    corners = outline(grid, 0.3)
    assert not sight(grid.space, corners, 1.0, 2.5, 4.0, 2.5).free
    assert sight(grid.space, corners, 1.0, 1.0, 4.0, 1.0).free
    # between two corners of one side, along the outline
    low = corners.point[np.argsort(corners.point[:, 1])]
    assert sight(grid.space, corners, *low[0], *low[1]).free


@pytest.mark.parametrize("factor", [1e-4, 1e4])
def test_joules_of_another_size_scale_the_bound(factor):
    """A robot of a few grams, or one of many tons, in the same rooms: all energies as one."""

    def bound(size):
        cost = EnergyCost.from_coefficients(per_metre=120.0 * size, per_radian=90.0 * size, icr=0.3)
        for start, goal in zip(poses[::2], poses[1::2], strict=True):
            query = CompiledProblem(PlanningProblem(grid, cost, start, goal))
            most = 3.0 * float(steering.energy(start, goal, cost))
            yield lower_bound(query, most).value / size

    grid = cluttered(1)
    vehicle = EnergyCost.from_coefficients(per_metre=1.0, per_radian=1.0, icr=0.3).vehicle
    poses = free_poses(grid, 8, 1, vehicle)
    assert list(bound(factor)) == pytest.approx(list(bound(1.0)), rel=1e-6)


@pytest.mark.parametrize("seed", range(2))
def test_in_a_mirror_or_turned_round_the_bound_is_the_same(seed):
    grid = cluttered(seed)
    width, height = grid.size
    cells = np.array(grid.occupied)
    images = [
        (cells, lambda x, y, yaw: (x, y, yaw)),
        (cells[::-1], lambda x, y, yaw: (x, height - y, -yaw)),
        (cells[:, ::-1], lambda x, y, yaw: (width - x, y, np.pi - yaw)),
        (cells.T, lambda x, y, yaw: (y, x, np.pi / 2 - yaw)),
        (cells[::-1, ::-1], lambda x, y, yaw: (width - x, height - y, yaw + np.pi)),
    ]
    poses = free_poses(grid, 4, seed, COST.vehicle)
    for pair in zip(poses[::2], poses[1::2], strict=True):
        values = []
        for seen, image in images:
            ends = (image(*pose) for pose in pair)
            problem = PlanningProblem(OccupancyGrid(seen, grid.resolution), COST, *ends)
            values.append(lower_bound(CompiledProblem(problem), 1e4).value)
        assert values == pytest.approx([values[0]] * len(images), rel=1e-9)


def test_bound_is_close_around_one_pillar():
    grid = room(200, 300, 0.05, np.s_[60:140, 140:160])
    found = plan(PlanningProblem(grid, COST, (2, 5, 0), (13, 5, 0)), effort=10_000)
    assert found.gap < 0.03


# -- one line --------------------------------------------------------------------------------------


def shortest_ways(direction, strict_left, strict_right):
    """Length of the shortest way along a line of 1 m whose headings are nodes a to a + b, (a, b).

    Metres at each heading, forwards or backwards, add up to the line; beside a side that is not
    strict only what they go along it counts. Found by trying all headings and all pairs of them.
    """
    n = HEADINGS
    heading = SPACING * np.arange(n)
    u = np.column_stack([np.cos(heading), np.sin(heading)])
    along = np.array([np.cos(direction), np.sin(direction)])
    aside = (heading - direction) % np.pi
    left = aside <= np.pi / 2
    free = ~np.where(left, strict_left, strict_right)
    with np.errstate(divide="ignore", invalid="ignore"):
        one = np.where(free, 1.0 / np.abs(u @ along), np.inf)
        # solve m u_a + k u_b = line for all pairs
        cross = u[:, None, 0] * u[None, :, 1] - u[:, None, 1] * u[None, :, 0]
        m = (along[0] * u[None, :, 1] - along[1] * u[None, :, 0]) / cross
        k = (u[:, None, 0] * along[1] - u[:, None, 1] * along[0]) / cross
        pair = np.where(np.abs(cross) > 1e-9, np.abs(m) + np.abs(k), np.inf)
    length = np.full((n, n), np.inf)
    length[:, 0] = one
    for b in range(1, n):
        a = np.arange(n)
        end = (a + b) % n
        length[:, b] = np.minimum(
            pair[a, end], np.minimum(length[:, b - 1], length[a - n + 1, b - 1])
        )
    return length


@pytest.mark.parametrize("strict", [(True, True), (True, False), (False, False)])
def test_past_a_line_no_way_over_the_nodes_costs_less_and_the_best_hardly_more(strict):
    """All sweeps over the headings are tried: from any node, over any range, to any node."""
    rng = np.random.default_rng(6)
    rates, n = Rates(226.0, 165.0, 0.0, 0.0, 0.0, static(226.0, 165.0, 0.47)), HEADINGS
    turn = rates.radian * SPACING
    for length in (0.05, 0.6, 4.0):
        before = rng.uniform(0, 500, n)
        line.spread(before, turn)
        direction = rng.uniform(-np.pi, np.pi)
        ways = rates.metre * length * shortest_ways(direction, *strict)
        best = np.full(n, np.inf)
        for b in range(n // 2 + 1):  # half a turn has every direction
            # from the i-th node of a range to its j-th one, at both of its ends in between
            i = np.arange(b + 1)
            place = (np.arange(n)[:, None] + i) % n
            up = (before[place] - turn * i).min(axis=1, keepdims=True) + turn * (2 * b + i)
            down = (before[place] + turn * i).min(axis=1, keepdims=True) + turn * (2 * b - i)
            there = np.minimum(up, down) + ways[:, b, None]
            np.minimum.at(best, place, there)
        found = line.along_line(before, direction, length, rates, *strict)
        assert np.all(found <= best * (1 + 1e-9))
        # a node stands for the headings up to its neighbours, before and after; how far a way's
        # headings spread is told in classes, which hardly matters along long lines
        if not any(strict) or length == 4.0:
            assert np.all(best - found <= 2.01 * turn)


# -- gates -----------------------------------------------------------------------------------------


def test_a_gate_forbids_only_what_cannot_cross_it():
    grid = room(80, 80, 0.05, np.s_[38:42, :33], np.s_[38:42, 48:])  # a door of 0.75 m
    vehicle = COST.vehicle
    (x_min, y_min), (x_max, y_max) = vehicle.footprint.tolist()
    corners = outline(grid, 0.318)
    corner = corners.point[np.argmin(np.hypot(*(corners.point - (1.968, 2.0)).T))]
    closed = np.ones(HEADINGS, bool)
    body = Body(x_min, y_min, x_max, y_max)
    width, barred = gate(grid.space, body, corners, 0.0, *corner, 1.0, 0.0, closed)
    assert barred
    # the disc's centre gets no nearer to the other side than the disc is wide
    assert 2.4 - 0.318 <= corner[0] + width <= 2.4 - 0.318 + 0.05
    # brute force over places on the gate and headings in between the nodes
    across = corner[0] + np.arange(0, 2.18 - corner[0], 0.01)
    headings = (np.arange(4 * HEADINGS) + 0.5) * SPACING / 4
    poses = np.array([(x, corner[1], h) for x in across for h in headings])
    free = grid.footprint_free(poses, vehicle).reshape(len(across), -1).any(axis=0)
    for node in range(HEADINGS):
        around = free[(4 * node + np.arange(-4, 4)) % len(free)]
        assert not (closed[node] and around.any())
    # along the wall nothing passes, and through it something does
    assert closed[0]
    assert not closed[HEADINGS // 4]


# -- the ends --------------------------------------------------------------------------------------


def room_to_work():
    return Beyond(*(np.empty((NORMALS, MOST + 1)) for _ in range(4)))


def static(metre, radian, half_track):
    return StaticSteering(half_track, 0.0, 0.0, metre, metre * half_track + radian)


@pytest.mark.parametrize("seed", range(4))
def test_to_a_gate_no_motion_takes_less(seed):
    """Exact steering to 61 places on the gate, for gates of all lengths, far and near."""
    rng = np.random.default_rng(seed)
    losses = []
    for k in range(60):
        metre, radian, half_track = 10.0 ** rng.uniform((1, 0.5, -1.5), (3, 3, 0.3))
        x, y = 10.0 ** rng.uniform(-1.5, 1.2) * half_track * rng.normal(size=2)
        start, end, direction = rng.uniform(-np.pi, np.pi, 3)
        width = float(rng.choice([0.0, 0.3, 3.0]) * half_track)
        section = Section(x, y, float(np.cos(direction)), float(np.sin(direction)), width)
        steering_cost = static(metre, radian, half_track)
        found = to_gate(section, start, end, steering_cost, 1e9, room_to_work()).cost
        out = np.linspace(0.0, width, 61 if width else 1)[:, None]
        places = np.array([x, y]) + out * [np.cos(direction), np.sin(direction)]
        goals = np.column_stack([places, np.full(len(places), end)])
        cost = EnergyCost.from_coefficients(metre, radian, half_track)
        exact = float(steering.energy(np.array([0.0, 0.0, start]), goals, cost).min())
        assert found <= exact * (1 + 1e-9)
        losses.append(1 - found / exact)
        # what is of no interest is left out, and what is found does not depend on it
        low, high = 0.9 * found, 1.1 * found
        assert to_gate(section, start, end, steering_cost, low, room_to_work()).cost == low
        assert to_gate(section, start, end, steering_cost, high, room_to_work()).cost == (
            pytest.approx(found)
        )
        if k < 3:
            plain = to_gate.py_func(section, start, end, steering_cost, high, room_to_work())
            assert plain.cost == pytest.approx(found)
    assert np.median(losses) < 0.01


def test_of_a_gate_without_end_only_the_way_straight_to_it_is_charged():
    across, along = (3.0, 0.0, 0.0, 1.0), static(200.0, 80.0, 0.4)
    for width in (0.0, 1.0, np.inf):
        ahead = to_gate(Section(*across, width), 0.0, 0.0, along, 1e9, room_to_work()).cost
        assert ahead == pytest.approx(600.0)
    # with the gate on the side that the turn leads to, the turn is driven: b - C |cos| a radian
    turned = to_gate(Section(*across, np.inf), 0.0, 0.5, along, 1e9, room_to_work()).cost
    assert turned == pytest.approx(600.0 + 160.0 * 0.5 - 200.0 * 0.4 * np.sin(0.5))


@pytest.mark.parametrize("seed", range(3))
def test_first_and_last_lines_cost_no_more_than_any_crossing(seed):
    """Headings between the nodes and all places on the gate are tried."""
    rng = np.random.default_rng(seed)
    metre, radian, half_track = 226.0, 165.0, 0.47
    cost = EnergyCost.from_coefficients(metre, radian, half_track)
    start, goal = rng.uniform(-3, 3, 2)
    rates = Rates(metre, radian, start, goal, 0.0, static(metre, radian, half_track))
    nodes = goal + SPACING * np.arange(HEADINGS)
    to_goal = radian * np.abs(np.angle(np.exp(1j * (nodes - goal))))
    direction = rng.uniform(-np.pi, np.pi)
    x, y, width = 1.5 * np.cos(direction), 1.5 * np.sin(direction), 0.3
    gate_x, gate_y = float(-np.sin(direction)), float(np.cos(direction))
    section = Section(x, y, gate_x, gate_y, width)
    headings = goal + rng.uniform(-np.pi, np.pi, 400)
    out = rng.uniform(0.0, width, 400)
    poses = np.column_stack([x + out * gate_x, y + out * gate_y, headings])
    # out from the start
    before = radian * np.abs(np.angle(np.exp(1j * (nodes - start)))) + metre * 1.5
    past = before.copy()
    line.from_start(past, section, to_goal, 1e6, rates, room_to_work())
    assert np.all(past >= before)
    exact = steering.energy(np.array([0.0, 0.0, start]), poses, cost)
    apart = np.abs(np.angle(np.exp(1j * (nodes[:, None] - headings))))
    assert np.all(past <= (exact + radian * apart).min(axis=1) + 1e-6)
    assert past.min() > before.min() + 1.0
    # and in to the goal
    reached = np.full(HEADINGS, 100.0) + rng.uniform(0, 400, HEADINGS)
    line.spread(reached, radian * SPACING)
    found = line.to_end(reached, section, to_goal, 1e6, rates, room_to_work()).cost
    last = steering.energy(
        np.column_stack([np.zeros((400, 2)), headings]),
        np.column_stack([poses[:, :2], np.full(400, goal)]),
        cost,
    )
    crossing = np.interp(
        np.mod(headings - goal, 2 * np.pi),
        np.append(SPACING * np.arange(HEADINGS), 2 * np.pi),
        np.append(reached, reached[0]),
    )
    assert found <= (crossing + last).min()
    assert found > 100.0 + metre * 1.5


def test_turns_behind_doors_take_what_steering_takes(monkeypatch):
    """Out of a room and into the next, turning behind both doors: the disc would spin there."""
    grid = read_map(MAPS / "office.yaml")
    problem = PlanningProblem(grid, COST, (1.57, 9.14, -1.1), (5.48, 9.84, 3.1))
    found = plan(problem, effort=10_000, gap=0.0)

    def disc_alone(*given):
        return corners.least_over_corners(*given[:-1], False)

    monkeypatch.setattr("energyplan.planning.bound.least_over_corners", disc_alone)
    before = lower_bound(CompiledProblem(problem), found.energy).value
    assert found.lower_bound - before > 0.4 * (found.energy - before)


# -- shortest ways ---------------------------------------------------------------------------------


def shortest(grid, radius, start, goal):
    """Length of the disc's shortest way, over the visibility graph of the grown blocked cells."""
    cells = np.argwhere(grid.blocked)[:, ::-1] * grid.resolution
    boxes = shapely.box(*cells.T, *(cells + grid.resolution).T)
    area = shapely.union_all(shapely.buffer(boxes, radius, quad_segs=8))
    inside = shapely.buffer(area, -1e-6)
    shapely.prepare(inside)
    points = np.vstack([start, goal, shapely.get_coordinates(shapely.simplify(area, 1e-3))])
    one, two = np.triu_indices(len(points), 1)
    lines = shapely.linestrings(np.stack([points[one], points[two]], axis=1))
    seen = ~shapely.intersects(inside, lines)
    graph = nx.Graph()
    graph.add_nodes_from(range(len(points)))
    length = np.hypot(*(points[one] - points[two]).T)
    graph.add_weighted_edges_from(zip(one[seen], two[seen], length[seen], strict=True))
    try:
        return nx.dijkstra_path_length(graph, 0, 1)
    except nx.NetworkXNoPath:
        return np.inf


def ways(grid, radius, start, goal, limit=1e3, effort=np.inf, detail=DETAILS[0]):
    drawn = outline(grid, radius, detail)
    ends = DiscEnds(*start, *goal)
    paid = np.zeros(len(drawn.point), bool)
    links = no_links(len(drawn.point))
    return ways_to_goal(grid.space, drawn, links, paid, ends, EUCLIDEAN, limit, effort, 0.0)


@pytest.mark.parametrize("seed", range(3))
def test_the_shortest_way_agrees_with_a_visibility_graph(seed):
    rng = np.random.default_rng(seed)
    occupied = np.zeros((60, 80), bool)
    for _ in range(9):
        row, column = rng.integers(4, 50), rng.integers(4, 70)
        occupied[row : row + rng.integers(2, 12), column : column + rng.integers(2, 12)] = True
    grid, radius = OccupancyGrid(occupied, 0.1), 0.3
    free = rng.uniform((0.4, 0.4), (7.6, 5.6), (200, 2))
    column, row = grid.to_cells(free).astype(int).T
    free = free[grid.clearance[row, column] > radius + 0.1]
    bent = 0
    for start, goal in zip(free[:12:2], free[1:12:2], strict=True):
        exact = shortest(grid, radius, start, goal)
        for detail in DETAILS:
            found = ways(grid, radius, start, goal, detail=detail).least
            # outlines lie inside of what they stand for
            assert found <= exact + 1e-6
            assert found >= min(exact, 1e3) * (1 - 0.6 * detail.slack) - 0.02
        bent += exact > np.hypot(*(goal - start)) + 1e-3
        # what is known when the search is stopped is less, and never more
        for effort in (0.0, 1e3, 1e4, 1e5):
            assert ways(grid, radius, start, goal, effort=effort).least <= exact + 1e-6
    assert bent >= 2


@pytest.mark.parametrize("origin", [(0.0, 0.0), (-7.0, 3.0)])
def test_corners_are_linked_to_all_that_they_see_along_both_outlines(origin):
    """What one obstacle hides is not looked for again: all the same, no line is missing."""
    grid, radius = OccupancyGrid(cluttered(1).occupied, 0.1, (*origin, 0.0)), 0.3
    drawn = outline(grid, radius, DETAILS[-1])
    point, tiny = drawn.point, 1e-9
    near, far = (np.add(origin, at) for at in ((1.0, 1.0), np.array(grid.size) - 1.0))
    links = ways(grid, radius, near, far, detail=DETAILS[-1]).links
    along = point[None] - point[:, None]  # from each corner to each other

    def touches(to, corner):
        sides = [
            to[..., 0] * (end - point)[corner][..., 1] - to[..., 1] * (end - point)[corner][..., 0]
            for end in (drawn.before, drawn.after)
        ]
        left = np.all([one >= -tiny for one in sides], axis=0)
        return left | np.all([one <= tiny for one in sides], axis=0)

    each = np.arange(len(point))
    both = touches(along, each[:, None]) & touches(along, each[None]) & (each[:, None] != each)
    compared = 0
    for k in np.flatnonzero(links.first >= 0)[:40]:
        seen = links.seen[links.first[k] : links.first[k] + links.number[k]]
        others = np.flatnonzero(both[k])
        free = [v for v in others if sight(grid.space, drawn, *point[k], *point[v]).free]
        assert set(seen.tolist()) == set(free)
        compared += len(free)
    assert compared > 100


def test_gaps_that_the_disc_does_not_pass_are_closed_however_coarse_the_outline():
    for cells, passes in ((11, False), (12, False), (13, True)):
        # a gap, and another way
        boxes = np.s_[:5, 78:82], np.s_[25:60, 78:82], np.s_[60 + cells :, 78:82]
        grid = room(120, 160, 0.05, *boxes)
        for detail in DETAILS:
            for exact in (True, False):
                with pytest.MonkeyPatch.context() as patch:
                    if not exact:
                        patch.setattr("energyplan.planning.bound.outline.MOST_RUNS", 0)
                    found = ways(grid, 0.32, (2.0, 3.3), (6.0, 3.3), detail=detail).least
                    assert (found < 4.3) == passes
                    assert passes or found > 5.5


def test_the_disc_of_the_bound_is_no_larger_than_the_robot():
    """A door that the robot clears by half a millimetre a side: no margin of planning fits."""
    cost = EnergyCost.from_coefficients(200.0, 80.0, 0.2)
    wide = np.array([[-0.4, -0.3245], [0.4, 0.3245]])
    cost = EnergyCost(replace(cost.model, vehicle=replace(cost.vehicle, footprint=wide)))
    grid = room(100, 100, 0.05, np.s_[:44, 50], np.s_[57:, 50])
    path = Path(Pose(1.0, 2.525, 0.0), [3.0], [0.0])
    assert grid.path_free(path, cost.vehicle)
    query = CompiledProblem(PlanningProblem(grid, cost, path.start, path.end))
    assert lower_bound(query, 3 * cost.energy(path)).value <= cost.energy(path)


def hall_of_pillars():
    """A hall of many pillars with three walls across, so that the way winds along all of it."""
    walls = [
        (slice(None, -30) if k % 2 == 0 else slice(30, None), slice(column, column + 2))
        for k, column in enumerate((225, 450, 675))
    ]
    places = np.random.default_rng(4).integers((40, 10), (960, 890), (300, 2))
    pillars = [(slice(row, row + 2), slice(column, column + 2)) for row, column in places]
    return room(1000, 900, 0.05, *walls, *pillars)


def test_the_bound_never_gives_up(monkeypatch):
    """However many corners there are, the way of the disc is counted."""
    monkeypatch.setattr(bound, "BOUND", bound.BOUND._replace(corners=100))
    grid = hall_of_pillars()
    start, goal = (2.0, 1.0, 0.0), (43.0, 1.0, 0.0)
    query = CompiledProblem(PlanningProblem(grid, COST, start, goal))
    # up along the first wall, down along the second, up along the third, and down again
    corners = np.array([(2, 1), (11.25, 48.5), (22.5, 1.5), (33.75, 48.5), (43, 1)])
    least = 226.0 * np.hypot(*np.diff(corners, axis=0).T).sum()
    assert lower_bound(query, 1.2 * least, 4 * EFFORT).value >= 0.99 * least
    # stopped earlier it knows part of that, and more than that the goal is 41 m away
    assert lower_bound(query, 1.2 * least).value > 2.0 * 226.0 * 41.0
    assert lower_bound(query, 1.2 * least, 1e6).value > 226.0 * 41.0


def test_what_is_kept_with_a_map_changes_no_bound_and_little_effort_lowers_it():
    poses = free_poses(cluttered(1), 12, 1, COST.vehicle)
    efforts = (1e4, 1e5, 1e6)
    fresh, kept = [], []
    grid = cluttered(1)
    for effort in (*efforts, np.inf):
        for start, goal in zip(poses[::2], poses[1::2], strict=True):
            new = CompiledProblem(PlanningProblem(cluttered(1), COST, start, goal))
            old = CompiledProblem(PlanningProblem(grid, COST, start, goal))
            fresh.append(lower_bound(new, 1e5, effort))
            kept.append(lower_bound(old, 1e5, effort))
    assert fresh == kept
    # little effort gives a lower bound, and says so
    whole = fresh[-len(poses) // 2 :]
    assert all(one.final for one in whole)
    assert not all(one.final for one in fresh)
    for few in np.split(np.array([one.value for one in fresh]), len(efforts) + 1):
        assert np.all(few <= [one.value for one in whole])
    # the same effort once more comes further where what was found is known and paid
    gained = 0.0
    for start, goal in zip(poses[::2], poses[1::2], strict=True):
        query = CompiledProblem(PlanningProblem(grid, COST, start, goal))
        spent = {}
        once, twice = (lower_bound(query, 1e5, 4e5, spent).value for _ in range(2))
        assert once == lower_bound(query, 1e5, 4e5).value
        assert twice >= once
        gained += twice - once
    assert gained > 0


# -- expensive surfaces ----------------------------------------------------------------------------


def on_two_grounds(left):
    """Models of a cheap and of an expensive ground whose robot has its left tread ICR elsewhere."""
    models = [PowerModel.preset(f"quadriga:empty:{ground}") for ground in ("marble", "concrete")]
    icr = replace(models[0].vehicle.icr, left=left(models[0].vehicle.icr))
    return [replace(model, vehicle=replace(model.vehicle, icr=icr)) for model in models]


@pytest.mark.parametrize("seed", range(3))
def test_cells_that_an_edge_of_a_surface_crosses_are_of_no_certain_ground(seed):
    rng = np.random.default_rng(seed)
    grid = room(24, 32, 0.25, origin=(1.0, -2.0, 0.4 * seed))
    boxes = shapely.box(0.0, 0.0, *rng.uniform(0.5, 4.0, (2, 6)))
    corner, angle = grid.to_world(rng.uniform(-4, 30, (6, 2))), rng.uniform(0, 90, 6)
    placed = [
        shapely.affinity.rotate(shapely.affinity.translate(boxes[k], *corner[k]), angle[k])
        for k in range(6)
    ]
    surfaces = SurfaceMap(tuple(Surface(box, COST.model) for box in placed))
    region = np.broadcast_to(Terrain(grid, surfaces).regions, grid.shape)
    found = _certain_regions(surfaces, grid, region)
    column, row = np.meshgrid(np.arange(32), np.arange(24))
    corners = np.stack([column, row], -1)[:, :, None] + [(0, 0), (1, 0), (1, 1), (0, 1)]
    cells = shapely.polygons(grid.to_world(corners.reshape(-1, 2)).reshape(24, 32, 4, 2))
    edges = shapely.union_all(shapely.boundary(np.array(placed)))
    away = shapely.distance(cells, edges)
    assert np.all(found[away == 0.0] == -1)
    assert np.array_equal(found[away > 0.25], region[away > 0.25])
    assert len(np.unique(found)) > 3


@pytest.mark.parametrize(("lateral", "reach"), [(0.0, 1), (0.08, 2), (0.15, 3)])
@pytest.mark.parametrize("edge", [8.0, 8.05])
def test_of_a_dear_strip_all_is_charged_but_what_may_touch_its_edges(lateral, reach, edge):
    """At each edge the cells that it touches, and as many as the treads reach aside and one."""
    marble, dear = on_two_grounds(lambda icr: icr.right + 2 * lateral)
    grid = room(100, 200, 0.1)
    cheap = shapely.difference(shapely.box(-1, -1, 21, 11), shapely.box(edge, -2, edge + 4, 12))
    ends = (2.0, 5.0, 0.0), (18.0, 5.0, 0.0)
    surfaces = SurfaceMap((Surface(cheap, marble),))
    query = CompiledProblem(PlanningProblem(grid, EnergyCost(dear), *ends, surfaces))
    touched = 1 if edge == 8.0 else 0.5  # half a cell of the strip, where the edge crosses it
    charged = 4.0 - 2 * 0.1 * (reach + touched)
    per_metre = 2.0 * (113.0 - 90.0)
    assert least_excess(query, 0.3, 1e6) == pytest.approx(charged * per_metre)
    limit = 0.5 * charged * per_metre
    assert least_excess(query, 0.3, limit) == pytest.approx(limit)


@pytest.mark.parametrize("resolution", [0.05, 0.1, 0.2])
@pytest.mark.parametrize("inset", [-1.0, 0.0, 1e-9, 0.05])
@pytest.mark.parametrize("lateral", [0.0, 0.15])
def test_a_dear_surface_that_ends_at_the_edge_of_the_map_is_charged(resolution, inset, lateral):
    # the narrow rim of cheap ground that may be left is no place for the robot
    marble, concrete = on_two_grounds(lambda icr: icr.left + 2 * lateral)
    area = shapely.box(inset, inset, 10.0 - inset, 10.0 - inset)
    cells = round(10.0 / resolution)
    grid = room(cells, cells, resolution)
    surfaces = SurfaceMap((Surface(area, concrete),))
    cost = EnergyCost(marble)
    query = CompiledProblem(PlanningProblem(grid, cost, (1, 5, 0), (9, 5, 0), surfaces))
    assert abs(cost.icr.centre[1]) == pytest.approx(lateral, abs=1e-3)
    radius = 0.32 - lateral
    per_metre = float(query.least_prices.metre_excess()[1])
    excess = least_excess(query, radius, 1e6)
    # the neighbourhoods of the ends are not charged
    near = 2 * resolution * (1 + np.ceil(lateral / resolution))
    rim = max(inset, 0.0) + resolution
    charged = radius - lateral > rim + np.sqrt(2) * resolution
    assert (8.0 - near) * per_metre * charged <= excess <= 8.0 * per_metre


def test_least_steps_agree_with_networkx():
    rng = np.random.default_rng(7)
    step = rng.choice([0.0, 1.0, 2.5], (12, 15))
    passable = rng.random((12, 15)) < 0.8
    graph = nx.DiGraph()
    for r, c in np.ndindex(step.shape):
        for rr, cc in np.ndindex(step.shape):
            if passable[rr, cc] and max(abs(r - rr), abs(c - cc)) == 1:
                graph.add_edge((r, c), (rr, cc), weight=step[r, c])
    lengths = nx.single_source_dijkstra_path_length(graph, (1, 1))
    for goal in ((10, 13), (2, 12), (11, 1)):
        around = product(*((n - 1, n, n + 1) for n in goal))
        near = min(lengths.get(cell, np.inf) for cell in around)
        given = (step, passable, 1, 1, *goal, 1e9, 0.0)
        assert least_steps(*given) == pytest.approx(near)
        assert least_steps.py_func(*given) == pytest.approx(near)


# -- the whole bound -------------------------------------------------------------------------------


def test_a_turn_the_other_way_beside_a_corner_is_not_overlooked():
    """Forward along 0, a turn of 150 degrees to the left, back: less turning than along the string.

    The string bends around a corner that hardly reaches into the chord; whoever drives along it
    turns by 180 degrees.
    """
    leg, turn = 1.5, np.radians(150)
    cost = nearly_a_point(226.0, 165.0)
    travel = np.radians(-30)
    tip = np.array([leg, 0.0])
    end = tip + leg * np.array([np.cos(travel), np.sin(travel)])
    # a pillar just inside the triangle of start, tip and end
    column, row = ((0.5 * end + (1.02, 2.59)) / 0.025).astype(int)
    pillar = np.s_[row - 6 : row, column : column + 2]
    grid = room(200, 200, 0.025, pillar, origin=(-1.0, -2.5, 0.0))
    path = Path(Pose(0.0, 0.0, 0.0), [leg, 0.0, -leg], [0.0, turn, 0.0])
    assert grid.path_free(path, cost.vehicle)
    problem = PlanningProblem(grid, cost, path.start, path.end)
    bound = lower_bound(CompiledProblem(problem), 5000.0)
    assert bound.value <= cost.energy(path)
    assert bound.value > 0.97 * cost.energy(path)


# -- models of every kind --------------------------------------------------------------------------


def arc_problem(cost, length, radius):
    """A problem on an empty map that one arc solves, and the arc."""
    hall = room(200, 240, 0.1)
    arc = Path(Pose(3.0, 10.0, 0.3), [length], [length / radius], cost.icr.longitudinal)
    assert hall.path_free(arc, cost.vehicle)
    return PlanningProblem(hall, cost, arc.start, arc.end), arc


@pytest.mark.parametrize("radius", by_day([8.0, 30.0, -100.0], [8.0, -100.0]))
def test_where_turning_gets_cheaper_with_the_radius_no_arc_beats_bound_or_plan(radius):
    model = COST.model
    mobilised = replace(term("friction_mobilisation"), params={"radius": 10.0})
    slower = model.with_term(HOTEL, 100.0).with_term(term("slip_speed_friction"), 0.2)
    for made in (model.with_term(mobilised, 0.627), slower):
        problem, arc = arc_problem(EnergyCost(made), 5.0, radius)
        least = problem.cost.energy(arc)
        found = plan(problem, effort=3_000)
        assert 0.9 * least <= found.lower_bound_steady <= least
        assert found.lower_bound <= drive_path(arc, problem.cost).energy
        assert found.energy_steady <= least * 1.001


@pytest.mark.parametrize("seed", range(4))
def test_no_plan_and_no_arc_of_a_random_model_beats_the_bound(seed):
    cost = random_model(seed)
    if cost is None:
        pytest.skip("no model: some motion would cost nothing")
    rng = np.random.default_rng(seed)
    for radius in 10.0 ** rng.uniform(0.0, 3.0, 4):
        problem, arc = arc_problem(cost, 6.0, rng.choice([-1, 1]) * radius)
        least = cost.energy(arc)
        bound = lower_bound(CompiledProblem(problem), 2.0 * least).value
        assert bound <= least * (1 + 1e-9)
    assert bound <= plan(problem, effort=1_000).energy * (1 + 1e-9)


AMONG = [(kind, seed) for kind, seeds in (("paper", 6), ("surfaces", 2), ("random", 6))
         for seed in range(seeds)]  # fmt: skip


@pytest.mark.parametrize("case", by_day(AMONG, [one for one in AMONG if one[1] < 2]))
def test_no_plan_among_obstacles_beats_the_bound(case):
    kind, seed = case
    grid, cost, surfaces, rng = cluttered(seed), COST, None, np.random.default_rng(seed)
    if kind == "surfaces":
        marble = PowerModel.preset("quadriga:empty:marble")
        boxes = [shapely.box(x, y, x + 3, y + 2) for x, y in rng.uniform((0, 0), (7, 6), (4, 2))]
        surfaces = SurfaceMap(tuple(Surface(box, marble) for box in boxes))
    elif kind == "random":
        cost = random_model(seed)
        if cost is None:
            pytest.skip("no model: some motion would cost nothing")
        size = rng.uniform(0.15, 0.6, 2)
        footprint = np.array([-size * rng.uniform(0.6, 1.4, 2), size])
        robot = replace(cost.vehicle, contacts=0.3 * cost.vehicle.contacts, footprint=footprint)
        cost = EnergyCost(replace(cost.model, vehicle=robot))
    poses = free_poses(grid, 8, seed, cost.vehicle)
    raised = 0
    for start, goal in zip(poses[::2], poses[1::2], strict=True):
        problem = PlanningProblem(grid, cost, start, goal, surfaces)
        try:
            found = plan(problem, effort=4_000, gap=0.0)
        except (NoPathError, TimeLimitError):
            continue
        # the bound does not depend on what is known: computed afresh it is no higher than the plan
        query = CompiledProblem(problem)
        for most, effort in ((2.0, EFFORT), (1.5, np.inf)):
            assert lower_bound(query, most * found.cost, effort).value <= found.cost * (1 + 1e-9)
        if kind == "paper":
            assert float(steering.energy(start, goal, cost)) <= found.lower_bound * (1 + 1e-9)
        raised += kind == "surfaces" and least_excess(query, 0.3, found.energy) > 0
    assert raised or kind != "surfaces"


@pytest.mark.parametrize("cells", [900, 4000])
def test_outlines_of_a_large_map_are_those_of_the_whole(monkeypatch, cells):
    """Contours computed a few rows at a time join to the same lines."""
    rng = np.random.default_rng(3)
    grid = OccupancyGrid(ndimage.binary_dilation(rng.random((150, 120)) < 0.01, iterations=3), 0.05)

    def edges(limit):
        monkeypatch.setattr(
            "energyplan.planning.bound.outline.OUTLINES", OUTLINES._replace(cells=limit)
        )
        point, first = _level_set(grid, 3.3)
        within = np.delete(np.arange(len(point) - 1), first[1:-1] - 1)
        return len(first), {
            (*begin, *end)
            for begin, end in zip(point[within].tolist(), point[within + 1].tolist(), strict=True)
        }

    assert len(edges(1 << 21)[1]) > 100
    assert edges(cells) == edges(1 << 21)
