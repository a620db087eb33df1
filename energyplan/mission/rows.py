"""Tasks along paths, row after row: the order to compare with that a search found."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from energyplan.mission.routes import Legs


def row_after_row(legs: Legs, tasks: Sequence[int]) -> list[int]:
    """Return tasks with paths in the order in which they lie side by side, the nearer side first.

    They are sorted across their common direction.
    """
    options = [legs.mission.tasks[k].options[0] for k in tasks]
    ends = np.array([[one.entry[:2], one.exit[:2]] for one in options])
    along = ends[:, 1] - ends[:, 0]
    double = 2 * np.arctan2(along[:, 1], along[:, 0])  # a row and its reverse have one direction
    size = np.hypot(*along.T)
    angle = 0.5 * np.arctan2(size @ np.sin(double), size @ np.cos(double))
    side = np.argsort(ends.mean(axis=1) @ [-np.sin(angle), np.cos(angle)], kind="stable")
    order = [tasks[k] for k in side]
    bounds = legs.lower_bounds(legs.mission.payload)[0]
    first, last = (min(bounds[node] for node in legs.ways(k)) for k in (order[0], order[-1]))
    return order if first <= last else order[::-1]
