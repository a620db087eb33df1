"""What OMPL is told of a problem: its objective, which poses and motions are free, its states."""

from __future__ import annotations

from collections.abc import Mapping
from math import inf
from typing import Any

import numpy as np
from ompl import base
from typing_extensions import override

from energyplan.compilation import njit
from energyplan.errors import TimeLimitError, UnknownNameError
from energyplan.planning.budget import UNLIMITED, Budget
from energyplan.planning.scene.compiled import CompiledProblem
from energyplan.planning.scene.motions import KernelProblem, drive, steering_cost
from energyplan.steering.kernels import MAX_SEGMENTS, steer_energy, steer_path
from energyplan.terrain.collision import pose_free

CALL = 0.5
"""Units of work that a motion that OMPL asks for counts as."""

ASKED = 0.1
"""Units of work that each round of a planner, and each cost that it only estimates, count as."""

_NO_PARAMETER = ("setName", "setProblemDefinition", "setup")


class DirectedObjective(base.OptimizationObjective):
    """An objective in which motions alone cost, and the way back need not cost the same."""

    @override
    def isSymmetric(self) -> bool:
        """Tell OMPL that the cost is directed."""
        return False

    @override
    def stateCost(self, state: Any) -> Any:
        """Return the cost of being in a state: none."""
        return base.Cost(0.0)


class EnergyObjective(DirectedObjective):
    """Cost of the exact minimum-energy motion between two states.

    The cost is directed: driving back the way one came costs the same on level ground, but not on
    every model, so that OMPL must not take it for symmetric.
    """

    def __init__(
        self, information: Any, query: CompiledProblem, budget: Budget = UNLIMITED
    ) -> None:
        super().__init__(information)
        self._setting = query.setting
        self._budget = budget
        self.setCostThreshold(base.Cost(0.0))

    @override
    def motionCost(self, first: Any, second: Any) -> Any:
        """Return the cost of the exact motion from one state to another."""
        self._budget.spend(CALL)
        return base.Cost(
            steering_cost(
                self._setting,
                first.getX(),
                first.getY(),
                first.getYaw(),
                second.getX(),
                second.getY(),
                second.getYaw(),
            )
        )

    @override
    def motionCostHeuristic(self, first: Any, second: Any) -> Any:
        """Return what no motion from one state to another costs less than."""
        self._budget.spend(ASKED)
        return base.Cost(
            steer_energy(
                second.getX() - first.getX(),
                second.getY() - first.getY(),
                first.getYaw(),
                second.getYaw(),
                self._setting.steering,
            )
        )


@njit
def steering_free(
    setting: KernelProblem, x: float, y: float, yaw: float, to_x: float, to_y: float, to_yaw: float
) -> bool:
    """Tell whether the body is free along the exact steering motion between two poses."""
    ds = np.empty(MAX_SEGMENTS)
    dtheta = np.empty(MAX_SEGMENTS)
    count = steer_path(to_x - x, to_y - y, yaw, to_yaw, setting.steering, ds, dtheta)
    return drive(setting, x, y, yaw, ds, dtheta, count, inf) < inf


class SteeringValidator(base.MotionValidator):
    """Tells whether the exact motion between two states is free for the whole footprint."""

    def __init__(
        self, information: Any, query: CompiledProblem, budget: Budget = UNLIMITED
    ) -> None:
        super().__init__(information)
        self._setting = query.setting
        self._budget = budget

    @override
    def checkMotion(self, first: Any, second: Any) -> bool:
        """Tell whether the motion from one state to another is free."""
        self._budget.spend(CALL)
        return bool(
            steering_free(
                self._setting,
                first.getX(),
                first.getY(),
                first.getYaw(),
                second.getX(),
                second.getY(),
                second.getYaw(),
            )
        )


class PoseChecker(base.StateValidityChecker):
    """Tells whether the footprint is free at a state."""

    def __init__(self, information: Any, query: CompiledProblem) -> None:
        super().__init__(information)
        self._setting = query.setting

    @override
    def isValid(self, state: Any) -> bool:
        """Tell whether the footprint is free."""
        x, y, yaw = state.getX(), state.getY(), state.getYaw()
        return bool(pose_free(self._setting.space, self._setting.body, x, y, yaw))


def pose_space(query: CompiledProblem) -> Any:
    """Return OMPL's space of the poses on the map."""
    space = base.SE2StateSpace()
    corners = query.grid.corners
    bounds = base.RealVectorBounds(2)
    for axis in range(2):
        bounds.setLow(axis, float(corners[:, axis].min()))
        bounds.setHigh(axis, float(corners[:, axis].max()))
    space.setBounds(bounds)
    # distances count a radian as what it costs in metres of straight driving
    setting = query.setting
    turn = setting.least_radian / setting.least_metre + setting.half_track
    space.setSubspaceWeight(1, turn)
    return space


def pose_state(space: Any, x: float, y: float, yaw: float) -> Any:
    """Return a state of OMPL's at a pose; Python owns it."""
    state = space.allocState()
    place(state, x, y, yaw)
    return state


def place(state: Any, x: float, y: float, yaw: float) -> None:
    """Put a state of OMPL's to a pose."""
    state.setX(x)
    state.setY(y)
    state.setYaw(float(np.remainder(yaw + np.pi, 2 * np.pi) - np.pi))


def end_states(space: Any, query: CompiledProblem) -> tuple[Any, Any]:
    """Return states of OMPL's at start and goal."""
    here = query.setting
    return (
        pose_state(space, here.start_x, here.start_y, here.start_yaw),
        pose_state(space, here.goal_x, here.goal_y, here.goal_yaw),
    )


def set_parameters(planner: Any, name: str, parameters: Mapping[str, object]) -> None:
    """Call the setters of one of OMPL's planners."""
    for key, value in parameters.items():
        setter = "set" + "".join(word.capitalize() for word in key.split("_"))
        if not hasattr(planner, setter):
            known = [m[3:] for m in dir(planner) if m.startswith("set") and m not in _NO_PARAMETER]
            raise UnknownNameError(f"parameter of {name}", key, known)
        getattr(planner, setter)(value)


def condition(budget: Budget) -> Any:
    """Return OMPL's termination condition for a budget."""

    def over() -> bool:
        # asking counts too: not every round of a planner tries a motion
        budget.spend(ASKED)
        return budget.over

    return base.PlannerTerminationCondition(over)


def none_in(name: str, budget: Budget, query: CompiledProblem, last: Any) -> TimeLimitError:
    """Return the error that says that a planner of OMPL's found nothing within its budget.

    `last` is the pose nearest to the goal that it reached; None where there is none.
    """
    near = ""
    if last is not None:
        x, y = last.getX(), last.getY()
        left = float(np.hypot(x - query.setting.goal_x, y - query.setting.goal_y))
        near = f"; it got as near to the goal as ({x:.2f}, {y:.2f}), {left:.2f} m from it"
    return TimeLimitError(
        f"{name} found no path in {budget.name}{near}; give more {budget.remedy}, or use the "
        "planner 'lattice'"
    )
