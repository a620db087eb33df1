"""Of paths of one cost the quicker: turns that a single spin can do are not pivots to and fro."""

from __future__ import annotations

import numpy as np

from energyplan.path import Path
from energyplan.planning.scene.compiled import CompiledProblem

SAME = 1e-9
"""Distance [m], and part of the cost, by which two count as one: rounding."""


def with_fewer_motions(query: CompiledProblem, path: Path) -> Path:
    """Return a path of the same cost in which a single spin stands for pivots that end in place.

    A spin and pivots of the same turning cost the same where only the turning counts. The spin is
    driven at once; each pivot begins and ends with a stop.

    Parameters
    ----------
    query : CompiledProblem
        The problem.
    path : Path
        A path that is free.

    Returns
    -------
    Path
        The path, with as few motions as that gives; free, and no dearer.
    """
    ahead, lateral = query.problem.cost.icr.centre
    ds, dtheta = path.ds, path.dtheta
    first = 0
    while first < len(ds):
        x, y, yaw = path.vertices.T
        centre = np.column_stack([
            x + ahead * np.cos(yaw) - lateral * np.sin(yaw),
            y + ahead * np.sin(yaw) + lateral * np.cos(yaw),
        ])  # fmt: skip
        away = np.hypot(*(centre[first + 2 :] - centre[first]).T)
        for last in (np.flatnonzero(away <= SAME) + first + 2)[::-1]:
            turn = float(dtheta[first:last].sum())
            # turning back and forth is not what a spin does
            if np.abs(dtheta[first:last]).sum() > abs(turn) + SAME:
                continue
            fewer = Path(
                path.start,
                np.concatenate([ds[:first], [lateral * turn], ds[last:]]),
                np.concatenate([dtheta[:first], [turn], dtheta[last:]]),
                path.longitudinal,
            )
            free = query.grid.path_free(fewer, query.problem.robot)
            if free and query.value(fewer) <= query.value(path) * (1.0 + SAME):
                path, ds, dtheta = fewer, fewer.ds, fewer.dtheta
                break
        first += 1
    return path
