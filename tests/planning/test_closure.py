"""Closed rooms: that there is certainly no way, that none leads over close poses, or neither."""

from __future__ import annotations

import pickle
from dataclasses import replace

import networkx as nx
import numpy as np
import pytest
from by_day import by_day
from worlds import room as boxes

from energyplan import EnergyCost, OccupancyGrid, PlanningProblem, Pose, plan
from energyplan.errors import NoPathError, TimeLimitError
from energyplan.planning.budget import Budget
from energyplan.planning.search.narrow import infeasible
from energyplan.planning.search.narrow.infeasible import chain_between, look_closer, none_in_time
from energyplan.planning.settings import PROOF
from energyplan.planning.space.compiled import CompiledProblem
from energyplan.planning.space.configurations import HEADINGS
from energyplan.planning.space.places import RIM, places_for
from energyplan.terrain.collision import Body, poses_free


def robot(length: float, width: float, ahead: float = 0.5) -> EnergyCost:
    """Return what motion costs a robot of that size; a part of it is ahead of the tread ICRs."""
    cost = EnergyCost.from_coefficients(per_metre=200.0, per_radian=80.0, icr=0.7 * width)
    box = np.array([[(ahead - 1.0) * length, -0.5 * width], [ahead * length, 0.5 * width]])
    return EnergyCost(replace(cost.model, vehicle=replace(cost.vehicle, footprint=box)))


def room(
    rng: np.random.Generator, size: float, wall: float, door: float, cell: float, turn: float
) -> tuple[OccupancyGrid, Pose, Pose]:
    """Return a room in a hall, turned, with a door in one wall, and poses inside and outside.

    The map's axes are those of the room, whose door is as wide as a number of cells.
    """
    half, thick, wide = (max(round(v / cell), 1) for v in (0.5 * size, wall, door))
    n = 2 * (5 * half // 2 + thick)
    i, j = np.indices((n, n)) - n // 2
    from_middle = np.maximum(np.abs(i + 0.5), np.abs(j + 0.5))
    occupied = (from_middle > half) & (from_middle < half + thick)
    first = int(rng.integers(1 - half, half - wide))
    occupied[n // 2 + first : n // 2 + first + wide, n // 2 + half - 1 : n // 2 + half + thick] = 0
    grid = OccupancyGrid(np.rot90(occupied, rng.integers(4)), cell, (1.0, -2.0, turn))
    (x, y), (u, v) = grid.to_world([(n / 2, n / 2), (0.75 * half, 0.75 * half)]).tolist()
    return grid, Pose(x, y, rng.uniform(-3, 3)), Pose(u, v, rng.uniform(-3, 3))


def drawn(seed: int, spare: float) -> PlanningProblem:
    """Return a room whose door is wider by `spare` than a robot of some size that must get out."""
    rng = np.random.default_rng(seed)
    length = rng.uniform(0.3, 3.0)
    width = rng.uniform(0.5, 1.0) * length
    cell = max(min(rng.choice([0.012, 0.025, 0.05, 0.1]), 0.2 * width), length / 50)
    door = round(width / cell) * cell
    scale = (door - spare) / width
    size = 1.8 * np.hypot(length, width) * scale
    made = room(rng, size, rng.uniform(0.1, 0.4) * length, door, cell, rng.choice([0.0, 0.7]))
    return PlanningProblem(made[0], robot(length * scale, width * scale), *made[1:])


def looked(problem: PlanningProblem, tested: bool = True) -> infeasible.Proof:
    """Return what is known of the ways of a problem, with or without the poses that were tested."""
    closer = infeasible.Prover(CompiledProblem(problem).setting, Budget(effort=10**7))
    if not tested:
        closer.tested[:] = closer.known[:] = 0
    return closer.found()


WIDEST, SMALLEST = 1, 3
"""Seeds of robots."""


@pytest.mark.parametrize("seed", by_day(range(4), [WIDEST, SMALLEST]))
@pytest.mark.parametrize("tested", [True, False])
def test_a_door_that_the_robot_passes_is_never_closed(seed, tested):
    """By how much does not matter where it is more than poses lie apart on either side."""
    for spare in (0.012, 0.03):
        problem = drawn(seed, spare)
        found = looked(problem, tested)
        assert not found.proven
        assert spare < 2.0 * max(PROOF.finest, PROOF.part * problem.map.resolution) or (
            found.resolution == np.inf and len(found.reached) == 0
        )
    assert not looked(drawn(seed, 1e-4), tested).proven


@pytest.mark.parametrize("seed", by_day(range(4), [WIDEST, SMALLEST]))
def test_a_door_too_narrow_is_proven_to_be(seed):
    for lacking in (0.012, 0.03):
        problem = drawn(seed, -lacking)
        found = looked(problem)
        assert found.proven
        assert len(found.reached) > 0
        # whether poses were tested before makes no difference
        assert looked(problem, tested=False).proven


def test_places_are_the_same_however_the_body_is_enlarged():
    """Where cells are a place each but for the margin of planning."""
    for width in np.linspace(0.3, 0.5, 21):
        hall = boxes(40, 40, 0.05)
        asked = PlanningProblem(hall, robot(0.6, width), (1.0, 1.0, 0), (1.1, 1.0, 0))
        kernel = CompiledProblem(asked).setting
        assert len(places_for(kernel).masks) == len(places_for(kernel, enlarged=True).masks)


def verdict(door: float, length: float = 0.9, width: float = 0.6, ahead: float = 0.5, **given):
    """Plan out of a room through a door; return the plan or the error."""
    made = room(np.random.default_rng(3), 2.4, 0.1, door, 0.02, 0.3)
    try:
        return plan(PlanningProblem(made[0], robot(length, width, ahead), *made[1:]), **given)
    except (NoPathError, TimeLimitError) as error:
        return error


def test_three_verdicts_are_told_apart():
    narrow = verdict(0.5, effort=6000)
    assert (type(narrow), narrow.certainty) == (NoPathError, "proven")
    again = pickle.loads(pickle.dumps(narrow))
    assert (again.certainty, str(again)) == ("proven", str(narrow))
    # one of 0.3 m about the tread ICRs, which lie far behind, would
    behind = verdict(0.58, ahead=0.83, effort=6000)
    assert (type(behind), behind.certainty) == (NoPathError, "proven")
    assert "whichever way it turns" in str(behind)
    # a centimetre more than the robot
    assert verdict(0.62, width=0.61, effort=20_000).length > 1.0
    # a tenth of a millimetre: too little to be seen, and nobody says that there is none
    hair = verdict(0.6, width=0.5999, effort=20_000)
    assert isinstance(hair, TimeLimitError) or hair.certainty == "at_resolution"
    if isinstance(hair, NoPathError):
        assert 0 < hair.resolution <= 2 * PROOF.finest
        assert "mm apart" in str(hair)
        assert "clearance" in str(hair)
    # not enough to tell
    assert isinstance(verdict(0.58, ahead=0.83, effort=50), TimeLimitError)


def test_a_budget_that_ends_before_any_search_names_the_start():
    ends = (1.5, 1.25, 0), (1.5, 2.25, 0)
    query = CompiledProblem(PlanningProblem(boxes(60, 60, 0.05), robot(0.6, 0.4), *ends))
    error = none_in_time(query, Budget(effort=1), "nothing was searched", [])
    assert "(1.50, 1.25), 1.00 m from it" in str(error)


def test_looking_closer_agrees_with_poses_at_random():
    rng = np.random.default_rng(0)
    grid = OccupancyGrid(rng.random((60, 60)) < 0.01, 0.05, (1.0, 2.0, 0.4))
    ends = (1.5, 1.5, 0), (1.6, 1.5, 0)
    query = CompiledProblem(PlanningProblem(boxes(60, 60, 0.05), robot(0.6, 0.4), *ends))
    kernel = query.setting._replace(space=grid.space)
    places = places_for(kernel, enlarged=True)
    body = Body(-0.3, -0.2, 0.3, 0.2)
    across = places.columns + 2 * RIM
    some = np.flatnonzero(places.masks)
    which = rng.choice(some, 60, replace=False)
    seen = look_closer(grid.space, body, places, which, places.masks[which], 3, 1 << 40)
    closed = undecided = 0
    for place, may, free in zip(which, seen.may, seen.free, strict=True):
        assert free & ~may == 0
        row, column = np.array(divmod(place, across)) - RIM
        for h in np.flatnonzero([int(places.masks[place]) >> h & 1 for h in range(HEADINGS)]):
            off = rng.uniform(-0.5, 0.5, (200, 3))
            at = (np.array([column, row]) + 0.5 + off[:, :2]) * places.spacing / grid.resolution
            yaw = 0.4 + (h + off[:, 2]) * 2 * np.pi / HEADINGS
            poses = np.column_stack([grid.to_world(at), yaw])
            is_free = poses_free(grid.space, body, poses)
            if not int(may) >> int(h) & 1:
                assert not is_free.any()
                closed += 1
            undecided += not int(free) >> int(h) & 1
            # where a tenth of all poses is free, one of those tested is
            assert int(free) >> int(h) & 1 or is_free.mean() < 0.1
    assert closed > 50
    assert undecided > closed
    # what is not tested any more counts as free
    cut = look_closer(grid.space, body, places, which, places.masks[which], 3, 100)
    assert np.all(cut.may[5:] == places.masks[which][5:])


@pytest.mark.parametrize("seed", range(20))
def test_ways_over_places_agree_with_networkx(seed):
    rng = np.random.default_rng(seed)
    rows, columns = 9, 11
    share = rng.uniform(0.1, 0.35)
    bits = rng.random((rows, columns, HEADINGS)) < share
    known = bits & (rng.random(bits.shape) < 0.5)
    bits[[0, -1]] = bits[:, [0, -1]] = False
    weight = np.uint64(1) << np.arange(HEADINGS, dtype=np.uint64)
    words, tested = ((part * weight).sum(axis=2, dtype=np.uint64).ravel() for part in (bits, known))
    graph = nx.Graph()
    for r, c, h in np.argwhere(bits).tolist():
        graph.add_node((r * columns + c, h))
        for dr, dc, dh in [(0, 0, 1), (0, 1, 0), (1, -1, 0), (1, 0, 0), (1, 1, 0)]:
            near = (h + dh) % HEADINGS
            if bits[r + dr, c + dc, near]:
                graph.add_edge((r * columns + c, h), ((r + dr) * columns + c + dc, near))
    ends = [tuple(n) for n in rng.permutation(list(graph.nodes))[:2].tolist()]
    found = chain_between(words, tested, columns, *ends[0], *ends[1])
    assert (len(found.place) > 0) == nx.has_path(graph, *ends)
    led_to = {place for place, _ in nx.node_connected_component(graph, ends[0])}
    reached = set(np.flatnonzero(found.reached).tolist())
    assert reached == led_to if not len(found.place) else reached <= led_to
    if len(found.place):
        assert (found.place[0], found.place[-1]) == (ends[0][0], ends[1][0])
        assert np.all(found.headings & ~words[found.place] == 0)
        off = np.abs(np.diff(found.place))
        assert np.isin(off, [0, 1, columns - 1, columns, columns + 1]).all()
