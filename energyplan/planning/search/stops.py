"""Paths that take less once they are driven: fewer stops may justify a longer way.

Energy at a steady speed knows no stops. Driven, each one takes the kinetic energy that the drive
does not recover, and time in which the computers draw power. What a stop of the best path takes is
its price. Routes with fewer turns are searched once more, at what the stops take per radian;
shortcuts are searched at the price, and all paths that result are driven.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import suppress
from typing import NamedTuple

import numpy as np

from energyplan.errors import InfeasibleMotionError, InvalidInputError, PlanningError
from energyplan.path import Path
from energyplan.planning.budget import SHARES, UNITS, Budget
from energyplan.planning.driven import DrivenPath, drive_plan
from energyplan.planning.search.optimise import Refiner
from energyplan.planning.search.routes import cheapest_routes
from energyplan.planning.settings import STOPS
from energyplan.planning.space.compiled import CompiledProblem, Segments
from energyplan.planning.space.cost_to_go import CostToGo
from energyplan.planning.space.motions import DIRECTIONS, KernelProblem


class Stops(NamedTuple):
    """A path, and what its stops take when it is driven."""

    path: Path
    driven: DrivenPath | None = None  # None where the motors cannot drive it
    extra: float = 0.0  # energy above driving steadily [J]
    each: float = 0.0  # that for each stop [J]

    @property
    def energy(self) -> float:
        """Energy of the drive [J]; infinite where there is none."""
        return np.inf if self.driven is None else self.driven.energy

    @property
    def share(self) -> float:
        """Fraction of the budget for paths with fewer stops, by what the stops could give back."""
        part = self.extra / abs(self.energy) if self.energy else 0.0
        return min(max((part - STOPS.least) / (STOPS.most - STOPS.least), 0.0), 1.0)


def stops_of(query: CompiledProblem, path: Path, budget: Budget) -> Stops:
    """Return what stops take of a path."""
    drive = _driven(query, path, budget)
    if drive is None:
        return Stops(path)
    still = (drive.trajectory.v == 0.0) & (drive.trajectory.omega == 0.0)
    extra = drive.energy - query.problem.terrain.price(path, query.problem.cost).energy
    return Stops(path, drive, extra, extra / max(int(np.count_nonzero(still)) - 1, 1))


def _driven(query: CompiledProblem, path: Path, budget: Budget) -> DrivenPath | None:
    budget.spend(UNITS.drive)
    try:
        return drive_plan(query.problem, path)
    except (InfeasibleMotionError, InvalidInputError):
        return None


def least_driven(
    query: CompiledProblem,
    stops: Stops,
    others: Iterable[Segments],
    to_go: CostToGo,
    budget: Budget,
    rivals: Sequence[Path] = (),
) -> Stops:
    """Return the path that takes least energy when it is driven; no rival takes less."""
    best, path = stops, stops.path
    known = {_key(path)}

    def weigh(candidate: Path) -> None:
        """Drive a path, and keep it where that takes less."""
        nonlocal best
        if _key(candidate) in known:
            return
        known.add(_key(candidate))
        found = _driven(query, candidate, budget)
        if found is not None and found.energy < best.energy:
            best = Stops(candidate, found)

    for rival in rivals:
        weigh(rival)
    if stops.share == 0.0:
        return best
    looked = [query.of_centre(path.ds, path.dtheta), *others]
    if stops.extra > STOPS.most * abs(best.energy) and path.turning > 0:
        expensive = _with_expensive_turns(query.setting, stops.extra / path.turning)
        looked[1:1] = _searched(expensive, to_go, budget)
    for motions in looked:
        for factor in STOPS.prices:
            if budget.over:
                return best
            fewer = Refiner(query.setting, motions).with_fewer_stops(factor * stops.each, budget)
            with suppress(PlanningError):
                weigh(query.path(fewer))
    return best


def _with_expensive_turns(setting: KernelProblem, per_radian: float) -> KernelProblem:
    """Return a problem in which turning costs so much more [J/rad]."""
    angle = np.linspace(0.0, 2 * np.pi, DIRECTIONS + 1)
    sideways = np.abs(np.sin(angle)) / setting.half_track
    steering = setting.steering
    return setting._replace(
        prices=setting.prices + per_radian * sideways,
        steering=steering._replace(per_radian=steering.per_radian + per_radian),
        least_radian=setting.least_radian + per_radian,
    )


def _searched(setting: KernelProblem, to_go: CostToGo, budget: Budget) -> list[Segments]:
    """Return the motions along the routes that are cheapest at these prices, refined a little."""
    found = []
    for way in cheapest_routes(setting, to_go, budget.part(SHARES.stage)):
        refiner = Refiner(setting, way)
        refiner.shortcut(budget)
        refiner.polish(budget.part(SHARES.stage), most=STOPS.polish)
        found.append(refiner.segments)
    return found


def _key(path: Path) -> tuple[bytes, bytes]:
    """Return a key that identifies a path."""
    ds, dtheta = (np.round(part, 6) + 0.0 for part in (path.ds, path.dtheta))  # no zero below 0
    return ds.tobytes(), dtheta.tobytes()
