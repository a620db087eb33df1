"""Paths whose cost depends on the radius of their turns, made cheaper by arcs of any radius.

The kernels join poses by straight lines and pivots, which are best where the power is piecewise
linear. Where wide arcs cost less, exact steering for the model itself joins some poses of the
finished path once more.
"""

from __future__ import annotations

import numpy as np

from energyplan import steering
from energyplan.cost.steering import StaticSteering
from energyplan.path import FloatArray, Path
from energyplan.planning.problem import objective_weights
from energyplan.planning.scene.compiled import CompiledProblem

MOST_POSES = 20
"""Poses of the path that are joined, any two of them."""


def with_wide_arcs(query: CompiledProblem, path: Path) -> Path:
    """Return a path that costs no more, with arcs where these are cheaper.

    Parameters
    ----------
    query : CompiledProblem
        The problem.
    path : Path
        A path that is free.

    Returns
    -------
    Path
        The path itself where straight lines and pivots are best, or where the ground is not even
        and of one kind, or energy is not all that counts.
    """
    problem = query.problem
    cost = problem.cost
    even = problem.surfaces is None and problem.heights is None
    if not even or set(objective_weights(problem.objective)) != {"energy"} or len(path) == 0:
        return path
    if isinstance(cost.steering_parameters, StaticSteering):
        return path
    chosen = np.unique(np.linspace(0, len(path), MOST_POSES).round().astype(int))
    poses = path.vertices[chosen]
    spent = np.concatenate([[0.0], np.cumsum(cost.segment_energy(path.ds, path.dtheta, 0.0))])
    least = steering.energy(poses[:, None], poses[None, :], cost)
    best = np.full(len(poses), np.inf)
    best[0] = 0.0
    parts: list[tuple[FloatArray, FloatArray]] = []
    whole: list[list[int]] = [[]]
    for j in range(1, len(poses)):
        kept = slice(chosen[j - 1], chosen[j])
        best[j] = best[j - 1] + spent[chosen[j]] - spent[chosen[j - 1]]
        parts.append((path.ds[kept], path.dtheta[kept]))
        whole.append([*whole[j - 1], len(parts) - 1])
        totals = best[:j] + least[:j, j]
        for i in np.argsort(totals, kind="stable"):
            if totals[i] >= best[j] * (1.0 - 1e-6):
                break
            joined = steering.path(poses[i], poses[j], cost)
            if problem.terrain.obstacles.path_free(joined, problem.robot):
                best[j] = totals[i]
                parts.append((joined.ds, joined.dtheta))
                whole[j] = [*whole[i], len(parts) - 1]
                break
    ds, dtheta = (np.concatenate([parts[k][n] for k in whole[-1]]) for n in (0, 1))
    found = Path(path.start, ds, dtheta, path.longitudinal)
    free = problem.terrain.obstacles.path_free(found, problem.robot)
    return found if free and query.value(found) < query.value(path) else path
