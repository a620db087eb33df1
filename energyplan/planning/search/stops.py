"""Paths that take less once they are driven: fewer stops may be worth a longer way.

Energy at a steady speed knows no stops. Driven, each one takes the kinetic energy that the drive
does not recover, and time in which the computers draw power. What a stop of the best path takes is
its price. Routes with fewer turns are sought once more, at what the stops take per radian;
shortcuts are sought at the price, and all that come of it are driven.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import suppress
from typing import NamedTuple

import numpy as np

from energyplan.errors import InfeasibleMotionError, InvalidInputError, PlanningError
from energyplan.path import Path
from energyplan.planning.budget import Budget
from energyplan.planning.driven import DrivenPath, drive_plan
from energyplan.planning.search.optimise import Refiner
from energyplan.planning.search.routes import ways_with_turns
from energyplan.planning.space.compiled import CompiledProblem, Segments
from energyplan.planning.space.cost_to_go import DistanceToGo
from energyplan.planning.space.motions import DIRECTIONS, KernelProblem

WORTH = 1e-3
"""Part of the energy that stops must take for them to be looked at."""

PRICES = (1.0, 3.0)
"""Prices of a stop, in units of what one takes on the best path, at which shortcuts are sought."""

DRIVE = 500
"""Units of work that driving a path counts as."""

SHARE = 0.25
"""Part of the budget that is kept for it; what can come of it decides how much of that it has."""

DEAR = 0.03
"""Part of the energy that stops must take for another way to be searched for."""

POLISH = 800
"""Attempts to refine what is found along other routes."""


class Stops(NamedTuple):
    """What stops take of a path that is driven."""

    energy: float  # energy of the drive [J]
    extra: float  # what that is above driving steadily [J]
    each: float  # that for each stop [J]

    @property
    def share(self) -> float:
        """Part of what is kept for other paths that is worth it: stops cannot give more back."""
        part = self.extra / abs(self.energy) if self.energy else 0.0
        return min(max((part - WORTH) / (DEAR - WORTH), 0.0), 1.0)


def stops_of(query: CompiledProblem, path: Path, budget: Budget) -> Stops:
    """Return what stops take of a path."""
    told = _driven(query, path, budget)
    if told is None:
        return Stops(np.inf, 0.0, 0.0)
    still = (told.trajectory.v == 0.0) & (told.trajectory.omega == 0.0)
    extra = told.energy - query.problem.terrain.price(path, query.problem.cost).energy
    return Stops(told.energy, extra, extra / max(int(np.count_nonzero(still)) - 1, 1))


def _driven(query: CompiledProblem, path: Path, budget: Budget) -> DrivenPath | None:
    budget.spend(DRIVE)
    try:
        return drive_plan(query.problem, path)
    except (InfeasibleMotionError, InvalidInputError):
        return None


def least_driven(
    query: CompiledProblem,
    path: Path,
    stops: Stops,
    others: Iterable[Segments],
    to_go: DistanceToGo,
    budget: Budget,
    rivals: Sequence[Path] = (),
) -> Path:
    """Return the path that takes least energy when it is driven; no rival takes less."""
    best, least, extra = path, stops.energy, stops.extra
    known = {_key(path)}

    def weigh(candidate: Path) -> None:
        """Drive a path, and keep it where that takes less."""
        nonlocal best, least
        if _key(candidate) in known:
            return
        known.add(_key(candidate))
        found = _driven(query, candidate, budget)
        if found is not None and found.energy < least:
            best, least = candidate, found.energy

    for rival in rivals:
        weigh(rival)
    if stops.share == 0.0:
        return best
    looked = [query.of_centre(path.ds, path.dtheta), *others]
    if extra > DEAR * abs(least) and path.turning > 0:
        dear = _with_dear_turns(query.setting, extra / path.turning)
        looked[1:1] = _searched(dear, to_go, budget)
    for motions in looked:
        for factor in PRICES:
            if budget.over:
                return best
            fewer = Refiner(query.setting, motions).with_fewer_stops(factor * stops.each, budget)
            with suppress(PlanningError):
                weigh(query.path(fewer))
    return best


def _with_dear_turns(setting: KernelProblem, per_radian: float) -> KernelProblem:
    """Return a problem in which turning costs so much more [J/rad]."""
    angle = np.linspace(0.0, 2 * np.pi, DIRECTIONS + 1)
    turned = np.abs(np.sin(angle)) / setting.half_track
    steering = setting.steering
    return setting._replace(
        prices=setting.prices + per_radian * turned,
        steering=steering._replace(per_radian=steering.per_radian + per_radian),
        least_radian=setting.least_radian + per_radian,
    )


def _searched(setting: KernelProblem, to_go: DistanceToGo, budget: Budget) -> list[Segments]:
    """Return the motions along the routes that are cheapest at these prices, refined a little."""
    found = []
    for way in ways_with_turns(setting, to_go, budget.part(0.6)):
        refiner = Refiner(setting, way)
        refiner.shortcut(budget)
        refiner.polish(budget.part(0.5), most=POLISH)
        found.append(refiner.segments)
    return found


def _key(path: Path) -> tuple[int, float]:
    """Return what tells paths apart."""
    return len(path), round(path.length, 6)
