"""Whether there is a way at all, and what can be said for certain if none was found."""

from __future__ import annotations

from math import sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from energyplan.errors import NoPathError
from energyplan.planning.scene.closure import Closure
from energyplan.planning.scene.compiled import CompiledProblem
from energyplan.planning.scene.guide import distance_to_go, places_for, reached
from energyplan.planning.scene.guide_kernels import RIM, DistanceToGo, Places
from energyplan.planning.scene.motions import KernelProblem

CANNOT = "the footprint cannot get through, whichever way it turns, so there certainly is none"
"""What is said where that is proven."""


def _parts(query: CompiledProblem) -> NDArray[np.int32]:
    """Return the connected parts of the map's cells in which the centre of a disc may lie.

    The disc is the largest one about the centre of the tread ICRs inside the footprint. Where its
    centre is anywhere in a cell, the clearance of the cell's centre is at least the disc's radius
    less half a diagonal. So the centre's way leads through such cells only, from each to one of
    the eight around it: two parts that do not touch are apart for certain.
    """
    body, grid = query.body, query.grid
    radius = max(min(-body.x_min, body.x_max, -body.y_min, body.y_max), 0.0)
    # a thousandth of a cell is far above rounding
    least = radius - (sqrt(0.5) + 1e-3) * grid.resolution

    def label() -> NDArray[np.int32]:
        from scipy import ndimage  # slow to import, and rarely needed

        found, _ = ndimage.label(grid.clearance >= least, np.ones((3, 3)))
        return np.asarray(found, np.int32)

    return query.terrain.bare.remember(("parts a disc can be in", least), label)


def _cells(query: CompiledProblem) -> list[tuple[int, int]]:
    """Return row and column of the cells that hold the centre of the tread ICRs at both ends."""
    grid = query.grid
    ends = [query.centre(pose)[:2] for pose in (query.problem.start, query.problem.goal)]
    rows, columns = grid.shape
    cells = np.floor(grid.to_cells(ends)).astype(int)
    return [(min(max(r, 0), rows - 1), min(max(c, 0), columns - 1)) for c, r in cells.tolist()]


def check_way(query: CompiledProblem) -> None:
    """Check that a disc inside the footprint may get from start to goal.

    Raises
    ------
    NoPathError
        If it certainly cannot; the message names the place nearest to the goal that it gets to.
    """
    parts, (start, goal) = _parts(query), _cells(query)
    if parts[start] == parts[goal] or 0 in (parts[start], parts[goal]):
        return
    row, column = np.nonzero(parts == parts[start])
    place = query.grid.to_world(np.column_stack([column + 0.5, row + 0.5]))
    end = np.array(query.problem.goal[:2])
    x, y = place[np.argmin(np.hypot(*(place - end).T))].tolist()
    raise NoPathError(
        _told(
            query,
            "a disc inside the footprint cannot get through, so there certainly is none",
            (x, y),
        ),
        certainty="proven",
    )


def check_configurations(query: CompiledProblem, to_go: DistanceToGo) -> None:
    """Check that the footprint may get from start to goal.

    Parameters
    ----------
    query : CompiledProblem
        The problem.
    to_go : DistanceToGo
        Its distance to go, as `distance_to_go` returns it.

    Raises
    ------
    NoPathError
        If it certainly cannot; the message names the place nearest to the goal that it gets to.
    """
    setting = query.setting
    if reached(to_go, setting):
        return
    check_way(query)
    back = setting._replace(
        start_x=setting.goal_x, start_y=setting.goal_y, start_yaw=setting.goal_yaw,
        goal_x=setting.start_x, goal_y=setting.start_y, goal_yaw=setting.start_yaw,
    )  # fmt: skip
    away = distance_to_go(back)
    homes = away.places.home[np.isfinite(away.distance)]
    raise _none(query, away.places, homes, CANNOT, certainty="proven")


def check_closer(query: CompiledProblem, setting: KernelProblem, closed: Closure) -> None:
    """Check that looking closer left a way from start to goal.

    Parameters
    ----------
    query : CompiledProblem
        The problem.
    setting : KernelProblem
        The problem between the poses where searches begin and end.
    closed : Closure
        What looking closer told.

    Raises
    ------
    NoPathError
        If there is none, or none over poses that lie close together; the message names the place
        nearest to the goal that it gets to.
    """
    if len(closed.reached) == 0:
        return
    places = places_for(setting, enlarged=True)
    if closed.proven:
        raise _none(query, places, closed.reached, CANNOT, certainty="proven")
    why = (
        f"none leads over poses {1e3 * closed.resolution:.2g} mm apart, though one might through a "
        "gap that leaves less room than that (finer cells of the map, or a smaller clearance, may "
        "show one)"
    )
    raise _none(query, places, closed.reached, why, resolution=closed.resolution)


def _none(
    query: CompiledProblem, places: Places, homes: NDArray[np.integer], why: str, **verdict: Any
) -> NoPathError:
    """Return the error that names the nearest to the goal of some places."""
    row, column = np.divmod(homes, places.columns + 2 * RIM)
    cells = np.column_stack([column, row]) - RIM + 0.5
    place = query.grid.to_world(cells * places.spacing / query.grid.resolution)
    end = np.array(query.problem.goal[:2])
    x, y = place[np.argmin(np.hypot(*(place - end).T))].tolist()
    return NoPathError(_told(query, why, (x, y)), **verdict)


def none_found(query: CompiledProblem, cell: float, near: tuple[float, float]) -> NoPathError:
    """Return the error that says that none was found at a resolution, or that there is none.

    Parameters
    ----------
    query : CompiledProblem
        The problem.
    cell : float
        Size of the cells in which the search was exhausted [m].
    near : tuple of float
        The place nearest to the goal that was reached, x and y [m].
    """
    try:
        check_way(query)
    except NoPathError as proven:
        return proven
    why = (
        f"none was found in cells of {cell:.3g} m, though a finer search might find one (the "
        "lattice planner's option finest halves them)"
    )
    return NoPathError(_told(query, why, near), resolution=cell)


def _told(query: CompiledProblem, why: str, near: tuple[float, float]) -> str:
    start, goal = query.problem.start, query.problem.goal
    left = float(np.hypot(goal.x - near[0], goal.y - near[1]))
    return (
        f"no path leads from ({start.x:.2f}, {start.y:.2f}) to ({goal.x:.2f}, {goal.y:.2f}): "
        f"{why}; the nearest place to the goal that was reached is ({near[0]:.2f}, {near[1]:.2f}), "
        f"{left:.2f} m from it; check the map for closed doors and unknown cells"
    )
