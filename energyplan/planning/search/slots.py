"""Ways through slots that the free configurations tested do not show.

Where a body passes with a centimetre to spare, hardly any of the poses tested is free, and no
lattice comes by. A slimmer body passes easily, and its way is found at once. Then it grows back to
its size a little at a time, and each time the poses of the way that are in its way move aside.
Where they cannot the slot is closed, and the next way is sought.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from energyplan.path import FloatArray, Path, Pose
from energyplan.planning.budget import Budget, Work
from energyplan.planning.search.follow import way_along
from energyplan.planning.search.lattice import Search, lattice_for
from energyplan.planning.search.optimise import Refiner
from energyplan.planning.space.compiled import Segments
from energyplan.planning.space.cost_to_go import (
    HEADINGS,
    TURNS,
    DistanceToGo,
    distance_at_start,
    distance_through_slots,
    regions_for,
)
from energyplan.planning.space.motions import KernelProblem
from energyplan.terrain.collision import Body, motions_free, poses_free

AGAIN = 0.5
"""How much slimmer it is where a first way through a slot does not grow and another one is tried,
in units of how much slimmer it was."""

SHARE = 0.25
"""Part of what searches may take that a way through slots may."""

LEAST, GUIDES = 800.0, 6.0
"""Units of work below which none is sought: as they are, and in those of a distance to go."""

LEAST_LEFT = 0.5
"""What is left of half the body's smaller side, at least."""

WEIGHT = 2.0
"""Weight of the search for a slim body's way."""

EXPANSIONS = 2000
"""Its expansions, at most."""

STEP = 1.0 / 3.0
"""Part of what the body lacks by which it grows first; twice as much after each success."""

FINEST = 5e-3
"""And the least part: where that fails the slot is closed."""

MOVED = 2.0
"""How far poses move aside at most, in units of the body's reach."""

GAIN = 0.98
"""Length of a way through slots, in units of the one known, above which it is not tried."""

CLOSE = 0.02
"""Distance between the poses among which those are sought where it does not fit [reaches, rad]."""

POLISH = 400
"""Attempts to make the slim body's way shorter."""

ACROSS = 600
"""Expansions of a search through a slot, at most."""

POSES = 24
"""Poses that a slim body's way through a slot is cut into, about."""

NEARLY = 0.2
"""What the body lacks at most, in units of what it lacked at first, where it tries once more."""

SIZES = 8
"""Sizes of the body that tell how tight a motion is."""

WAYS = 6
"""Ways that are tried, at most."""


def slot_work(
    setting: KernelProblem,
    known: DistanceToGo,
    cost: float,
    budget: Budget,
    enter: Callable[[Segments | None], None],
) -> list[Work]:
    """Return the search for a way through slots shorter than those known, where it may pay."""
    units = SHARE * budget.left
    if units < max(LEAST, GUIDES * known.work / TURNS):
        return []

    def run(own: Budget) -> Segments | None:
        own.beside(lambda: regions_for(setting, enlarged=True))
        return way_through_slots(setting, known, cost, own)

    return [Work(run, units, enter)]


def way_through_slots(
    setting: KernelProblem, known: DistanceToGo | None, cost: float, budget: Budget
) -> Segments | None:
    """Return the shortest way through slots that fits, if one is found."""
    limit = np.inf if known is None else GAIN * distance_at_start(known, setting)
    by = slack(setting)
    slim = slimmer(setting, by)
    closed: list[Pose] = []
    for _ in range(WAYS):
        to_go = distance_through_slots(setting, limit, closed)
        budget.spend(to_go.work / TURNS)
        if budget.over or not distance_at_start(to_go, setting) < limit:
            return None
        way = way_along(slim, to_go, budget)
        if way is None:
            search = Search(slim, to_go, lattice_for(setting), WEIGHT)
            search.run(budget, EXPANSIONS, cost)
            if not search.found:
                return None
            way = search.segments()
        refiner = Refiner(slim, way)
        refiner.shortcut(budget)
        refiner.polish(budget, most=POLISH)
        if refiner.cost >= cost:
            return None
        found = _opened(setting, refiner.segments, to_go, by, budget)
        if isinstance(found, Segments):
            return found
        if not found:
            return None
        closed += found
    return None


def _opened(
    setting: KernelProblem, way: Segments, to_go: DistanceToGo, by: float, budget: Budget
) -> Segments | list[Pose]:
    """Return the whole body's way, or the poses where it does not fit."""
    start = setting.start
    piece = setting.reach
    fine = Path(start, way.ds, way.dtheta).subdivide(max_ds=piece, max_dtheta=1.0)
    poses = [Pose(*pose) for pose in fine.vertices.tolist()]
    poses[-1] = setting.goal
    needed = _needed(setting, fine, by)
    tight = needed > 0.0
    # with a motion before and after, in which what leads there can change
    tight |= np.append(tight[1:], False) | np.append(False, tight[:-1])
    cuts = [0, *(np.flatnonzero(np.diff(tight)) + 1).tolist(), len(tight)]
    parts = {
        (first, end): Segments(fine.ds[first:end], fine.dtheta[first:end])
        for first, end in pairwise(cuts)
    }
    # the one that is least likely to open comes first
    for first, end in sorted(parts, key=lambda ends: -needed[ends[0] : ends[1]].max()):
        if tight[first]:
            through = setting._replace(start=poses[first], goal=poses[end])
            found = _through(through, parts[first, end], to_go, by, budget)
            if isinstance(found, list):
                return found
            parts[first, end] = found
    return Segments(*(np.concatenate([part[n] for part in parts.values()]) for n in range(2)))


def _needed(setting: KernelProblem, way: Path, by: float) -> FloatArray:
    """Return how much slimmer the body has to be for each motion of a way to be free [m]."""
    needed = np.zeros(len(way))
    for size in np.linspace(by, 0.0, SIZES, endpoint=False)[::-1]:
        body = slimmer(setting, float(size - by / SIZES)).body
        starts = way.vertices[:-1]
        free = motions_free(setting.space, body, starts, way.ds, way.dtheta, 0.0)
        needed[~free] = size
    return needed


def _through(
    setting: KernelProblem, slim: Segments, to_go: DistanceToGo, by: float, budget: Budget
) -> Segments | list[Pose]:
    """Return the motions of the whole body through a slot, or the poses where it does not fit."""
    grown = grow(setting, slim, by, budget)
    if grown.motions is None and grown.lacking < NEARLY and not budget.over:
        grown = min(grown, grow(setting, slim, by, budget, seed=2), key=lambda one: one.lacking)
    if grown.motions is None and not budget.over:
        lattice = lattice_for(setting, AGAIN)
        search = Search(slimmer(setting, AGAIN * by), to_go, lattice, WEIGHT)
        search.run(budget, ACROSS)
        if search.found:
            other = grow(setting, search.segments(), AGAIN * by, budget)
            if AGAIN * other.lacking < grown.lacking:
                grown = other
    return grown.closed if grown.motions is None else grown.motions


class Grown(NamedTuple):
    """What became of a slim body's way."""

    motions: Segments | None  # the way of the whole body
    closed: list[Pose]  # where it does not fit
    lacking: float  # what the body lacked there still, in units of what it lacked at first


def slack(setting: KernelProblem) -> float:
    """How much slimmer a body is to be so that it passes wherever the whole one may [m].

    A point of the body is no further from where it is at the nearest pose tested.
    """
    body = setting.body
    half = 0.5 * min(body.x_max - body.x_min, body.y_max - body.y_min)
    apart = np.sqrt(0.5) * setting.space.resolution + setting.reach * np.pi / HEADINGS
    return min(float(apart), (1.0 - LEAST_LEFT) * half)


def slimmer(setting: KernelProblem, by: float) -> KernelProblem:
    """Return the problem of a body that is smaller on every side [m]."""
    body = setting.body
    slim = Body(body.x_min + by, body.y_min + by, body.x_max - by, body.y_max - by)
    return setting._replace(body=slim)


def grow(setting: KernelProblem, way: Segments, by: float, budget: Budget, seed: int = 1) -> Grown:
    """Make the way of a slimmer body one of the whole body."""
    refiner = Refiner(slimmer(setting, by), way, seed, POSES)
    refiner.shortcut(budget)
    lacking, step, failed = 1.0, STEP, 0
    while lacking > 0.0:
        wanted = max(lacking - step, 0.0)
        blocked = refiner.move_to(slimmer(setting, by * wanted), MOVED * setting.reach, budget)
        if not blocked.any():
            lacking, step = wanted, 2.0 * step
            continue
        step *= 0.5
        failed += 1
        if step < FINEST or budget.over:
            body = slimmer(setting, by * wanted).body
            return Grown(None, _blocked(setting, refiner.segments, body), lacking)
        if failed % 3:
            refiner.halve(blocked)
        else:
            refiner.shortcut(budget)
    return Grown(refiner.segments, [], 0.0)


def _blocked(setting: KernelProblem, way: Segments, body: Body) -> list[Pose]:
    """Return the poses on a way at which a body is not free."""
    start = setting.start
    piece = CLOSE * setting.reach
    fine = Path(start, way.ds, way.dtheta).subdivide(max_ds=piece, max_dtheta=CLOSE)
    for fitting in (body, setting.body):
        poses = fine.vertices[~poses_free(setting.space, fitting, fine.vertices)]
        if len(poses):
            break
    return [Pose(*pose) for pose in poses.tolist()]
