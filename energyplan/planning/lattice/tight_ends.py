"""Ends so tight that the margin of planning does not fit: a short motion leads out of each.

Best paths touch obstacles, and one that was planned without a margin may be free or not by
rounding. If it is not, planning is done anew between two poses nearby that have room.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from energyplan.path import Path, Pose
from energyplan.planning.problem import PlanningProblem
from energyplan.planning.scene.compiled import CompiledProblem

TRAVEL = (0.0, 0.02, 0.05, 0.1, 0.2, 0.3, 0.4, 0.6, 0.8, 1.0, 1.3, 1.6)
"""Distances to drive out of a tight place [m]."""

TURNS = (0.0, 0.02, 0.05, 0.1, 0.2, 0.4, 0.8, 1.6)
"""Turns on the way out [rad]."""


@dataclass(frozen=True)
class Eased:
    """A problem between roomy poses, and the motions that lead from its ends to the true ones."""

    problem: PlanningProblem
    out: Path
    back: Path

    def whole(self, inner: Path) -> Path:
        """Return the path from the true start to the true goal by way of a path in between."""
        return replace(
            self.out,
            ds=np.concatenate([self.out.ds, inner.ds, -self.back.ds[::-1]]),
            dtheta=np.concatenate([self.out.dtheta, inner.dtheta, -self.back.dtheta[::-1]]),
        )


def ease(query: CompiledProblem) -> Eased | None:
    """Return the problem between roomy poses; None where the ends are roomy, or none is near."""
    problem = query.problem
    if query.ends_roomy:
        return None
    out = _way_out(query, problem.start, problem.goal)
    back = _way_out(query, problem.goal, problem.start)
    if out is None or back is None:
        return None
    return Eased(replace(problem, start=out.end, goal=back.end), out, back)


def _way_out(query: CompiledProblem, pose: Pose, far: Pose) -> Path | None:
    """Return the short motion from a pose to a roomy one that goes best on the way to another."""
    metre = query.setting.least_metre

    def promise(path: Path) -> float:
        rest = np.hypot(far.x - path.end.x, far.y - path.end.y)
        return query.value(path) + metre * float(rest)

    longitudinal = query.problem.cost.icr.longitudinal
    found: list[Path] = []
    for travel in TRAVEL:
        for turn in TURNS:
            for ds in {travel, -travel}:
                for dtheta in {turn, -turn}:
                    path = Path(pose, np.array([ds]), np.array([dtheta]), longitudinal)
                    if query.roomy(path.end) and query.grid.path_free(path, query.problem.robot):
                        found.append(path)
        if found:
            return min(found, key=promise)
    return None
