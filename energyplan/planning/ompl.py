"""OMPL's geometric planners on the true energy.

States are poses of the point midway between the tread ICRs. A motion between two states is the
exact minimum-energy one: the objective prices it, the motion validator tests it with the whole
footprint, and the path that comes back is made of it. OMPL's own interpolation between states is
used for new samples only, never for motions, so that no path slides sideways.

Some of OMPL 2.0.1's planners are left out, since they do not bear a Python objective: PRM and PRM*
wait for Python's lock for ever, and AORRTC ignores the objective.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from itertools import pairwise
from math import inf
from typing import Any

import numpy as np
from ompl import base, geometric, util
from typing_extensions import override

from energyplan.compilation import njit
from energyplan.errors import TimeLimitError, UnknownNameError
from energyplan.planning.budget import UNLIMITED, Budget
from energyplan.planning.contract import Candidate
from energyplan.planning.problem import PlanningProblem
from energyplan.planning.space.closure import check_way
from energyplan.planning.space.compiled import CompiledProblem, Segments, compiled
from energyplan.planning.space.motions import KernelProblem, drive, steering_cost
from energyplan.steering.kernels import MAX_SEGMENTS, steer_energy, steer_path
from energyplan.terrain.collision import pose_free

CALL = 0.5
"""Units of work that a motion that OMPL asks for counts as."""

ASKED = 0.1
"""Units of work that each round of a planner, and each cost that it only estimates, count as."""

_NO_PARAMETER = ("setName", "setProblemDefinition", "setup")


class EnergyObjective(base.OptimizationObjective):
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
    def isSymmetric(self) -> bool:
        """Tell OMPL that the cost is directed."""
        return False

    @override
    def stateCost(self, state: Any) -> Any:
        """Return the cost of being in a state: none."""
        return base.Cost(0.0)

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
    state.setX(x)
    state.setY(y)
    state.setYaw(float(np.remainder(yaw + np.pi, 2 * np.pi) - np.pi))
    return state


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


def _joined(query: CompiledProblem, states: list[tuple[float, float, float]]) -> Segments:
    """Return the exact motions from one state to the next."""
    ds, dtheta = np.empty(MAX_SEGMENTS), np.empty(MAX_SEGMENTS)
    parts = [Segments(np.empty(0), np.empty(0))]
    for (x, y, yaw), (to_x, to_y, to_yaw) in pairwise(states):
        count = steer_path(to_x - x, to_y - y, yaw, to_yaw, query.setting.steering, ds, dtheta)
        parts.append(Segments(ds[:count].copy(), dtheta[:count].copy()))
    return Segments(
        np.concatenate([part.ds for part in parts]), np.concatenate([part.dtheta for part in parts])
    )


def _geometric(
    make: Callable[[Any], Any],
    name: str,
    problem: PlanningProblem,
    budget: Budget,
    seed: int,
    parameters: Mapping[str, object],
) -> Candidate:
    """Let one of OMPL's geometric planners solve a problem."""
    query = compiled(problem)
    check_way(query)
    util.setLogLevel(util.LOG_NONE)
    util.RNG.setSeed(seed)
    space = pose_space(query)
    information = base.SpaceInformation(space)
    checker = PoseChecker(information, query)
    validator = SteeringValidator(information, query, budget)
    information.setStateValidityChecker(checker)
    information.setMotionValidator(validator)
    information.setup()
    definition = base.ProblemDefinition(information)
    definition.setStartAndGoalStates(*end_states(space, query))
    objective = EnergyObjective(information, query, budget)
    definition.setOptimizationObjective(objective)
    planner = make(information)
    set_parameters(planner, name, parameters)
    planner.setProblemDefinition(definition)
    planner.setup()
    planner.solve(condition(budget))
    if not definition.hasExactSolution():
        known = definition.hasApproximateSolution()
        last = definition.getSolutionPath().getStates()[-1] if known else None
        raise none_in(name, budget, query, last)
    states = [
        (state.getX(), state.getY(), state.getYaw())
        for state in definition.getSolutionPath().getStates()
    ]
    return Candidate(query.path(_joined(query, states)))


def _planner(make: Callable[[Any], Any], name: str) -> Callable[..., Candidate]:
    """Return the planner that lets one of OMPL's solve a problem."""

    def plan(
        problem: PlanningProblem, budget: Budget, *, seed: int = 1, **parameters: object
    ) -> Candidate:
        return _geometric(make, name, problem, budget, seed, parameters)

    plan.__name__ = plan.__qualname__ = name
    return plan


rrtstar = _planner(geometric.RRTstar, "rrtstar")
informed_rrtstar = _planner(geometric.InformedRRTstar, "informed_rrtstar")
bitstar = _planner(geometric.BITstar, "bitstar")
fmt = _planner(geometric.FMT, "fmt")  # not anytime: draws num_samples samples, then searches once
