"""Paths are compared by what driving them takes: a stop takes time, and energy that is lost.

The objective at a steady speed knows no stops. Driven, each one takes time, the kinetic energy that
the drive does not recover, and what the computers draw meanwhile. What the stops of the first path
take is their price: with it routes are searched, and paths are refined. The best of these are
driven, and the one that takes least is the answer.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from energyplan.errors import InfeasibleMotionError, InvalidInputError, PlanningError
from energyplan.path import Path
from energyplan.planning.budget import UNITS, Budget
from energyplan.planning.driven import DrivenPath, drive_plan, driven_share
from energyplan.planning.settings import STOPS
from energyplan.planning.space.compiled import CompiledProblem
from energyplan.planning.space.motions import DIRECTIONS, KernelProblem


class Weighed(NamedTuple):
    """A path, and the objective's value of it."""

    path: Path
    driven: DrivenPath | None
    value: float


class Answer:
    """The best of the paths that were weighed: by what driving them takes, or at steady speeds."""

    def __init__(self, query: CompiledProblem, driven: bool) -> None:
        self._query = query
        self._known: set[tuple[bytes, bytes]] = set()
        self.drives = driven
        self.path: Path | None = None
        self.driven: DrivenPath | None = None
        self.value = np.inf
        """The objective's value of it."""

    def weigh(self, path: Path, budget: Budget) -> None:
        """Take a path where it is better than those before."""
        self.take(self.weighed(path, budget))

    def weighed(self, path: Path, budget: Budget) -> Weighed | None:
        """Return a path with its value, if it may be better than those before."""
        if _key(path) in self._known:
            return None
        if not self.drives:
            return Weighed(path, None, self._query.value(path))
        if self._certainly_more(path) or (drive := self._drive(path, budget)) is None:
            return Weighed(path, None, np.inf)
        return Weighed(path, drive, self._query.driven_value(path, drive))

    def take(self, found: Weighed | None) -> None:
        """Take a path that was weighed where it is better than those before."""
        if found is not None:
            self._known.add(_key(found.path))
            if found.value < self.value:
                self.path, self.driven, self.value = found

    def best(self) -> Path:
        """Return the path."""
        if self.path is None:
            raise PlanningError("no path was weighed; please report this map")
        return self.path

    def _drive(self, path: Path, budget: Budget) -> DrivenPath | None:
        """Return the drive of a path, None where the motors cannot drive it."""
        budget.spend(UNITS.drive)
        try:
            return drive_plan(self._query.problem, path)
        except (InfeasibleMotionError, InvalidInputError):
            return None

    def _certainly_more(self, path: Path) -> bool:
        """Return whether driving a path takes more than the best one does, at any speed."""
        query = self._query
        if query.problem.heights is not None or query.value(path) <= self.value:
            return False
        share = driven_share(query.problem)
        return share is not None and share * query.value(path) > self.value

    @property
    def extra(self) -> float:
        """What the stops of the path take, where that is not negligible; else 0."""
        if self.driven is None or self.path is None:
            return 0.0
        extra = self.value - self._query.value(self.path)
        return extra if extra > STOPS.least * abs(self.value) else 0.0

    @property
    def each(self) -> float:
        """What each of its stops takes."""
        if self.driven is None or not self.extra:
            return 0.0
        timed = self.driven.trajectory
        still = int(np.count_nonzero((timed.v == 0.0) & (timed.omega == 0.0)))
        return self.extra / max(still - 1, 1)


def with_expensive_turns(setting: KernelProblem, per_radian: float) -> KernelProblem:
    """Return a problem in which a radian of turning costs so much more."""
    angle = np.linspace(0.0, 2 * np.pi, DIRECTIONS + 1)
    sideways = np.abs(np.sin(angle)) / setting.half_track
    steering = setting.steering
    return setting._replace(
        prices=setting.prices + per_radian * sideways,
        steering=steering._replace(per_radian=steering.per_radian + per_radian),
        least_radian=setting.least_radian + per_radian,
    )


def _key(path: Path) -> tuple[bytes, bytes]:
    """Return a key that identifies a path."""
    ds, dtheta = (np.round(part, 6) + 0.0 for part in (path.ds, path.dtheta))  # no zero below 0
    return ds.tobytes(), dtheta.tobytes()
