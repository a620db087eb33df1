"""Paths that take less once they are driven: fewer stops may justify a longer way.

The objective at a steady speed knows no stops. Driven, each one takes time, the kinetic energy that
the drive does not recover, and what the computers draw meanwhile. What a stop of the best path
takes is its price. Routes with fewer turns are searched once more, at what the stops take per
radian; shortcuts are searched at the price, and all paths that result are driven.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import suppress
from typing import NamedTuple

import numpy as np

from energyplan.errors import InfeasibleMotionError, InvalidInputError, PlanningError
from energyplan.path import Path
from energyplan.planning.budget import SHARES, UNITS, Budget
from energyplan.planning.driven import DrivenPath, drive_plan, driven_share
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
    value: float = np.inf  # the objective's value of the drive; infinite where there is none
    extra: float = 0.0  # what of it is above driving steadily
    each: float = 0.0  # that for each stop

    @property
    def share(self) -> float:
        """Fraction of the budget for paths with fewer stops, by what the stops could give back."""
        part = self.extra / abs(self.value) if self.value else 0.0
        return min(max((part - STOPS.least) / (STOPS.most - STOPS.least), 0.0), 1.0)


def stops_of(query: CompiledProblem, path: Path, budget: Budget) -> Stops:
    """Return what stops take of a path."""
    drive = _driven(query, path, budget)
    if drive is None:
        return Stops(path)
    still = (drive.trajectory.v == 0.0) & (drive.trajectory.omega == 0.0)
    value = query.driven_value(path, drive)
    extra = value - query.value(path)
    return Stops(path, drive, value, extra, extra / max(int(np.count_nonzero(still)) - 1, 1))


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
    """Return the path that takes least when it is driven; no rival takes less."""
    best, path = stops, stops.path
    known = {_key(path)}

    def weigh(candidate: Path) -> None:
        """Drive a path, and keep it where that takes less."""
        nonlocal best
        if _key(candidate) in known:
            return
        known.add(_key(candidate))
        found = _driven(query, candidate, budget)
        if found is not None and (value := query.driven_value(candidate, found)) < best.value:
            best = Stops(candidate, found, value)

    for rival in rivals:
        if not _certainly_more(query, rival, best.value):
            weigh(rival)
    if stops.share == 0.0:
        return best
    candidates: list[tuple[float, Path]] = []
    searching = budget.part(1.0 - SHARES.aside)

    def shorten(motions: Segments, factor: float) -> None:
        """Look for a path with fewer stops near another one; estimate what driving it takes."""
        if searching.over:
            return
        if factor:
            setting = query.setting._replace(stop=factor * stops.each)
            motions = Refiner(setting, motions).with_fewer_stops(searching, STOPS.polish)
        with suppress(PlanningError):
            found = query.path(motions)
            candidates.append((query.value(found) + stops.each * len(found), found))

    own, first = query.of_centre(path.ds, path.dtheta), STOPS.prices[0]
    shorten(own, first)
    ways = [*others]
    if stops.extra > STOPS.most * abs(best.value) and path.turning > 0:
        expensive = _with_expensive_turns(query.setting, stops.extra / path.turning)
        ways = [*_searched(expensive, to_go, searching), *ways]
    for factor in (*STOPS.prices, 0.0):
        for motions in ways if factor == first else [own, *ways]:
            shorten(motions, factor)
    for _, candidate in sorted(candidates, key=lambda one: one[0]):
        if budget.over:
            break
        weigh(candidate)
    return best


def _certainly_more(query: CompiledProblem, path: Path, value: float) -> bool:
    """Return whether driving a path takes more than a value at any speed."""
    if query.problem.heights is not None or query.value(path) <= value:
        return False
    share = driven_share(query.problem)
    return share is not None and share * query.value(path) > value


def _with_expensive_turns(setting: KernelProblem, per_radian: float) -> KernelProblem:
    """Return a problem in which a radian of turning costs so much more."""
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
