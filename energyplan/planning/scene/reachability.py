"""Whether there is a way at all, and where it ends if there is none."""

from __future__ import annotations

import numpy as np

from energyplan.errors import NoPathError
from energyplan.planning.lattice.search import cell_of, field_for
from energyplan.planning.scene.compiled import CompiledProblem


def no_path(query: CompiledProblem, why: str, near: tuple[float, float]) -> NoPathError:
    """Return the error that says that no path leads from start to goal.

    Parameters
    ----------
    query : CompiledProblem
        The problem.
    why : str
        What was tried.
    near : tuple of float
        The place nearest to the goal that was reached, x and y [m].

    Returns
    -------
    NoPathError
        The error.
    """
    start, goal = query.problem.start, query.problem.goal
    left = float(np.hypot(goal.x - near[0], goal.y - near[1]))
    return NoPathError(
        f"no path leads from ({start.x:.2f}, {start.y:.2f}) to ({goal.x:.2f}, {goal.y:.2f}): "
        f"{why}; the nearest place to the goal that was reached is ({near[0]:.2f}, {near[1]:.2f}), "
        f"{left:.2f} m from it; check the map for closed doors and unknown cells"
    )


def check_way(query: CompiledProblem) -> None:
    """Check that a disc inside the footprint gets from start to goal.

    Raises
    ------
    NoPathError
        If not; the message names the place nearest to the goal that it gets to.
    """
    setting = query.setting
    field = field_for(setting)
    stride = max(int(field.spacing / setting.space.resolution + 0.5), 1)
    if np.isfinite(field.distance[cell_of(setting, setting.start_x, setting.start_y, stride)]):
        return
    back = setting._replace(
        start_x=setting.goal_x,
        start_y=setting.goal_y,
        goal_x=setting.start_x,
        goal_y=setting.start_y,
    )
    row, column = np.nonzero(np.isfinite(field_for(back).distance))
    place = query.grid.to_world(np.column_stack([column + 0.5, row + 0.5]) * stride)
    goal = np.array(query.problem.goal[:2])
    x, y = place[np.argmin(np.hypot(*(place - goal).T))].tolist()
    raise no_path(query, "a disc inside the footprint cannot get through", (x, y))
