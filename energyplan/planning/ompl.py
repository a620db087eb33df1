"""OMPL's geometric planners on the true energy.

States are poses of the point midway between the tread ICRs. A motion between two states is the
exact minimum-energy one: the objective prices it, the motion validator tests it with the whole
footprint, and the returned path consists of it. OMPL's own interpolation between states is
used for new samples only, never for motions, so that no path slides sideways.

Some of OMPL 2.0.1's planners are left out, since they do not bear a Python objective: PRM and PRM*
wait for Python's lock for ever, and AORRTC ignores the objective.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from math import inf
from typing import Any

import numpy as np
from ompl import base, geometric, util
from typing_extensions import override

from energyplan.compilation import njit
from energyplan.errors import TimeLimitError, UnknownNameError
from energyplan.path import ROUNDING, Pose
from energyplan.planning.budget import UNLIMITED, Budget
from energyplan.planning.driven import Candidate
from energyplan.planning.problem import PlanningProblem
from energyplan.planning.search.narrow.infeasible import check_configurations
from energyplan.planning.space.compiled import CompiledProblem, Segments, compiled
from energyplan.planning.space.cost_to_go import cost_to_go
from energyplan.planning.space.motions import KernelProblem, drive, steering_cost
from energyplan.steering.kernels import MAX_SEGMENTS, steer_energy, steer_path
from energyplan.terrain.collision import pose_free

MOTION, ESTIMATE = 0.5, 0.1
"""Units of work per motion that OMPL requests, and per round or cost that it estimates."""


def _pose(state: Any) -> Pose:
    return Pose(state.getX(), state.getY(), state.getYaw())


class EnergyObjective(base.OptimizationObjective):
    """Cost of the exact minimum-energy motion between two states; it is directed."""

    def __init__(
        self, information: Any, query: CompiledProblem, budget: Budget = UNLIMITED
    ) -> None:
        super().__init__(information)
        self._setting = query.setting
        self._budget = budget
        self.setCostThreshold(base.Cost(0.0))

    @override
    def isSymmetric(self) -> bool:
        """Return False: the cost depends on the direction."""
        return False

    @override
    def stateCost(self, state: Any) -> Any:
        """Return the cost of being in a state: none."""
        return base.Cost(0.0)

    @override
    def motionCost(self, first: Any, second: Any) -> Any:
        """Return the cost of the exact motion from one state to another."""
        self._budget.spend(MOTION)
        return base.Cost(steering_cost(self._setting, _pose(first), _pose(second)))

    @override
    def motionCostHeuristic(self, first: Any, second: Any) -> Any:
        """Return what no motion costs less than, even by rounding, at which BIT* crashes."""
        self._budget.spend(ESTIMATE)
        a, b = _pose(first), _pose(second)
        least = steer_energy(b.x - a.x, b.y - a.y, a.yaw, b.yaw, self._setting.steering)
        # the costs of the parts of a motion may add up to less than that of the whole
        return base.Cost(least * (1.0 - ROUNDING))


@njit
def steering_free(setting: KernelProblem, pose: Pose, to: Pose) -> bool:
    """Return whether the body is free along the exact steering motion between two poses."""
    ds = np.empty(MAX_SEGMENTS)
    dtheta = np.empty(MAX_SEGMENTS)
    dx = to.x - pose.x
    dy = to.y - pose.y
    count = steer_path(dx, dy, pose.yaw, to.yaw, setting.steering, ds, dtheta)
    return drive(setting, pose, ds, dtheta, count, inf) < inf


class SteeringValidator(base.MotionValidator):
    """Checks whether the exact motion between two states is free for the whole footprint."""

    def __init__(
        self, information: Any, query: CompiledProblem, budget: Budget = UNLIMITED
    ) -> None:
        super().__init__(information)
        self._setting = query.setting
        self._budget = budget

    @override
    def checkMotion(self, first: Any, second: Any) -> bool:
        """Return whether the motion from one state to another is free."""
        self._budget.spend(MOTION)
        return bool(steering_free(self._setting, _pose(first), _pose(second)))


class PoseChecker(base.StateValidityChecker):
    """Checks whether the footprint is free at a state."""

    def __init__(self, information: Any, query: CompiledProblem) -> None:
        super().__init__(information)
        self._setting = query.setting

    @override
    def isValid(self, state: Any) -> bool:
        """Return whether the footprint is free."""
        return bool(pose_free(self._setting.space, self._setting.body, *_pose(state)))


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


def ompl_planner(make: Callable[[Any], Any], name: str) -> Callable[..., Candidate]:
    """Return the planner that lets one of OMPL's solve a problem.

    Motions between its states are those of exact steering, and its objective is the problem's.

    Parameters
    ----------
    make : callable
        A geometric planner of OMPL, such as ``ompl.geometric.RRTConnect``; called with OMPL's
        space information.
    name : str
        What messages call it.

    Returns
    -------
    callable
        For `energyplan.Planner`: a function ``(problem, budget, *, seed, **parameters)``, where
        parameters are those of OMPL's planner, in lower case with underscores.

    Examples
    --------
    >>> from ompl import geometric
    >>> import energyplan as ep
    >>> connect = ompl_planner(geometric.RRTConnect, "rrt_connect")
    >>> planner = ep.Planner(connect, surfaces=True, heights=True, effort=True, turning=True)
    """

    def plan(
        problem: PlanningProblem, budget: Budget, *, seed: int = 1, **parameters: object
    ) -> Candidate:
        query = compiled(problem)
        check_configurations(query, cost_to_go(query.setting))
        util.setLogLevel(util.LOG_NONE)
        util.RNG.setSeed(seed)
        space = pose_space(query)
        information = base.SpaceInformation(space)
        checker = PoseChecker(information, query)  # OMPL holds these no longer than Python does
        validator = SteeringValidator(information, query, budget)
        information.setStateValidityChecker(checker)
        information.setMotionValidator(validator)
        information.setup()
        definition = base.ProblemDefinition(information)
        ends = (pose_state(space, *end) for end in (query.setting.start, query.setting.goal))
        definition.setStartAndGoalStates(*ends)
        objective = EnergyObjective(information, query, budget)
        definition.setOptimizationObjective(objective)
        planner = make(information)
        for key, value in parameters.items():
            setter = "set" + "".join(word.capitalize() for word in key.split("_"))
            if not hasattr(planner, setter):
                known = sorted({m[3:] for m in dir(planner) if m.startswith("set")})
                raise UnknownNameError(f"parameter of {name}", key, known)
            getattr(planner, setter)(value)
        planner.setProblemDefinition(definition)
        planner.setup()

        def over() -> bool:
            budget.spend(ESTIMATE)  # not every round of a planner tries a motion
            return budget.over

        planner.solve(base.PlannerTerminationCondition(over))
        if not definition.hasExactSolution():
            text, goal = "", query.setting.goal
            if definition.hasApproximateSolution():
                near = _pose(definition.getSolutionPath().getStates()[-1])
                text = (
                    f"; it got as near to the goal as ({near.x:.2f}, {near.y:.2f}), "
                    f"{np.hypot(near.x - goal.x, near.y - goal.y):.2f} m from it"
                )
            raise TimeLimitError(
                f"{name} found no path in {budget.name}{text}; give more {budget.remedy}, or use "
                "the planner 'lattice'",
                budget.remedy,
            )
        poses = [_pose(state) for state in definition.getSolutionPath().getStates()]
        ds, dtheta = np.empty(MAX_SEGMENTS), np.empty(MAX_SEGMENTS)
        parts = [np.empty((2, 0))]
        for a, b in pairwise(poses):
            steering = query.setting.steering
            count = steer_path(b.x - a.x, b.y - a.y, a.yaw, b.yaw, steering, ds, dtheta)
            parts.append(np.array([ds[:count], dtheta[:count]]))
        return Candidate(query.path(Segments(*np.concatenate(parts, axis=1))))

    plan.__name__ = plan.__qualname__ = name
    return plan


rrtstar = ompl_planner(geometric.RRTstar, "rrtstar")
informed_rrtstar = ompl_planner(geometric.InformedRRTstar, "informed_rrtstar")
bitstar = ompl_planner(geometric.BITstar, "bitstar")
fmt = ompl_planner(
    geometric.FMT, "fmt"
)  # not anytime: draws num_samples samples, then searches once
