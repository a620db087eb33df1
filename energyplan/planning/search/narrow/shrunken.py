"""Narrow passages that the free configurations tested do not show.

Where a body passes with a centimetre to spare, hardly any of the poses tested is free, and no
lattice comes by. A shrunken body passes easily, and its way is found at once. Then it grows back to
its size a little at a time, and each time the poses of the way that are in its way move aside.
Where they cannot the passage is closed, and the next way is sought.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from energyplan.path import Path, Pose
from energyplan.planning.budget import SHARES, UNITS, Budget, Work
from energyplan.planning.search.follow import follow_route
from energyplan.planning.search.lattice import Search, lattice_for
from energyplan.planning.search.optimise import Refiner
from energyplan.planning.space.compiled import Segments
from energyplan.planning.space.configurations import HEADINGS, grown
from energyplan.planning.space.cost_to_go import (
    CostToGo,
    cost_at_start,
    cost_through_passages,
    regions_for,
)
from energyplan.planning.space.motions import KernelProblem
from energyplan.terrain.collision import Body, motions_free, poses_free


class Settings(NamedTuple):
    """Constants of the search with a shrunken footprint."""

    least: float = 800.0  # units of work below which none is sought
    guides: float = 6.0  # the same in units of what a cost-to-go takes
    left: float = 0.5  # what stays of half the body's smaller side at least [1]
    expansions: int = 2000  # expansions of the search for the shrunken body's way
    step: float = 1.0 / 3.0  # part of the shrinkage that is taken back first
    finest: float = 5e-3  # least such part: where it fails the passage is closed
    moved: float = 2.0  # how far poses move aside at most [reaches]
    gain: float = 0.98  # length over the known way's above which a way is not tried [1]
    close: float = 0.02  # distance between poses where a closed place is sought [reaches, rad]
    polish: int = 400  # attempts to make the shrunken body's way shorter
    poses: int = 24  # poses that a way through a passage is cut into
    ways: int = 6  # ways that are tried at most


SETTINGS = Settings()


def passage_work(
    setting: KernelProblem,
    known: CostToGo,
    cost: float,
    budget: Budget,
    enter: Callable[[Segments | None], object],
) -> list[Work]:
    """Return the search for a shorter way through narrow passages, where it may pay."""
    units = SHARES.aside * budget.left
    if units < max(SETTINGS.least, SETTINGS.guides * known.work / UNITS.nodes):
        return []

    def run(own: Budget) -> Segments | None:
        own.beside(lambda: regions_for(setting, enlarged=True))
        return path_through_passages(setting, known, cost, own)

    return [Work(run, units, enter)]


def path_through_passages(
    setting: KernelProblem, known: CostToGo | None, cost: float, budget: Budget
) -> Segments | None:
    """Return the shortest way through narrow passages that fits, if one is found."""
    limit = np.inf if known is None else SETTINGS.gain * cost_at_start(known, setting)
    by = shrinkage(setting)
    thin = shrunken(setting, by)
    closed: list[Pose] = []
    for _ in range(SETTINGS.ways):
        to_go = cost_through_passages(setting, limit, closed)
        budget.spend(to_go.work / UNITS.nodes)
        if budget.over or not cost_at_start(to_go, setting) < limit:
            return None
        way = follow_route(thin, to_go, budget).motions
        if way is None:
            search = Search(thin, to_go, lattice_for(setting))
            search.run(budget, SETTINGS.expansions, cost)
            if not search.found:
                return None
            way = search.segments()
        refiner = Refiner(thin, way)
        refiner.shortcut(budget)
        refiner.polish(budget, most=SETTINGS.polish)
        if refiner.cost >= cost:
            return None
        found = _opened(setting, refiner.segments, by, budget)
        if isinstance(found, Segments):
            return found
        if not found:
            return None
        closed += found
    return None


def _opened(
    setting: KernelProblem, way: Segments, by: float, budget: Budget
) -> Segments | list[Pose]:
    """Return the whole body's way, or the poses where it does not fit."""
    start = setting.start
    piece = setting.reach
    fine = Path(start, way.ds, way.dtheta).subdivide(max_ds=piece, max_dtheta=1.0)
    poses = [Pose(*pose) for pose in fine.vertices.tolist()]
    poses[-1] = setting.goal
    starts = fine.vertices[:-1]
    tight = ~motions_free(setting.space, setting.body, starts, fine.ds, fine.dtheta, 0.0)
    # with a motion before and after, in which what leads there can change
    tight |= np.append(tight[1:], False) | np.append(False, tight[:-1])
    cuts = [0, *(np.flatnonzero(np.diff(tight)) + 1).tolist(), len(tight)]
    parts = {
        (first, end): Segments(fine.ds[first:end], fine.dtheta[first:end])
        for first, end in pairwise(cuts)
    }
    for first, end in parts:
        if tight[first]:
            through = setting._replace(start=poses[first], goal=poses[end])
            found = grow(through, parts[first, end], by, budget)
            if isinstance(found, list):
                return found
            parts[first, end] = found
    return Segments(*(np.concatenate([part[n] for part in parts.values()]) for n in range(2)))


def shrinkage(setting: KernelProblem) -> float:
    """How much shrunken a body is to be so that it passes wherever the whole one may [m]."""
    body = setting.body
    half = 0.5 * min(body.x_max - body.x_min, body.y_max - body.y_min)
    apart = np.sqrt(0.5) * setting.space.resolution + setting.reach * np.pi / HEADINGS
    return min(float(apart), (1.0 - SETTINGS.left) * half)


def shrunken(setting: KernelProblem, by: float) -> KernelProblem:
    """Return the problem of a body that is smaller on every side [m]."""
    return setting._replace(body=grown(setting.body, -by))


def grow(setting: KernelProblem, way: Segments, by: float, budget: Budget) -> Segments | list[Pose]:
    """Return the way of a shrunken body as one of the whole body, or where that does not fit."""
    refiner = Refiner(shrunken(setting, by), way, poses=SETTINGS.poses)
    refiner.shortcut(budget)
    lacking, step, failed = 1.0, SETTINGS.step, 0
    while lacking > 0.0:
        wanted = max(lacking - step, 0.0)
        blocked = refiner.move_to(
            shrunken(setting, by * wanted), SETTINGS.moved * setting.reach, budget
        )
        if not blocked.any():
            lacking, step = wanted, 2.0 * step
            continue
        step *= 0.5
        failed += 1
        if step < SETTINGS.finest or budget.over:
            body = shrunken(setting, by * wanted).body
            return _blocked(setting, refiner.segments, body)
        if failed % 3:
            refiner.halve(blocked)
        else:
            refiner.shortcut(budget)
    return refiner.segments


def _blocked(setting: KernelProblem, way: Segments, body: Body) -> list[Pose]:
    """Return the poses on a way at which a body is not free."""
    start = setting.start
    piece = SETTINGS.close * setting.reach
    fine = Path(start, way.ds, way.dtheta).subdivide(max_ds=piece, max_dtheta=SETTINGS.close)
    for fitting in (body, setting.body):
        poses = fine.vertices[~poses_free(setting.space, fitting, fine.vertices)]
        if len(poses):
            break
    return [Pose(*pose) for pose in poses.tolist()]
