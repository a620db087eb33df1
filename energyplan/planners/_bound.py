"""What no path can cost less than."""

from __future__ import annotations

from math import hypot

from energyplan.planners._motion_kernels import free_energy
from energyplan.planners._query import Query


def lower_bound(query: Query, deadline: float, cost: float) -> float:
    """Return a lower bound on the cost of every path from start to goal."""
    setting = query.setting
    free = free_energy(setting, setting.start_x, setting.start_y, setting.start_yaw)
    far = hypot(setting.goal_x - setting.start_x, setting.goal_y - setting.start_y)
    return float(max(free, setting.least_metre * far))
