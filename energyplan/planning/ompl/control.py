"""OMPL's planners in the space of controls, within the limits of each side's motor.

A control is a direction in the plane of arc length and turn, from straight ahead over pivots and
spins to straight back. It is driven at the fastest speed that the vehicle's limits of tread speed,
yaw rate and power per side allow for it, so that every motion of the tree is one the motors can
hold.

A state is a pose with what was spent to get there. So OMPL's RRT, which knows of no cost, is made
to find ever cheaper paths: once a path is known, states that cannot be on one cheaper by `GAIN`
are invalid, and the tree grows anew, in the space of poses and costs (Hauser and Zhou 2016,
Asymptotically optimal planning by feasible kinodynamic planning in a state-cost space).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from ompl import base, control, util
from typing_extensions import override

from energyplan.errors import UnsupportedPlannerError
from energyplan.path import FloatArray, Path
from energyplan.planning.budget import Budget
from energyplan.planning.contract import Candidate
from energyplan.planning.ompl.parts import (
    CALL,
    DirectedObjective,
    condition,
    none_in,
    place,
    pose_space,
    set_parameters,
)
from energyplan.planning.problem import PlanningProblem
from energyplan.planning.scene.closure import check_way
from energyplan.planning.scene.compiled import CompiledProblem, Segments
from energyplan.planning.scene.motions import connection, drive, free_energy, join
from energyplan.steering.kernels import MAX_SEGMENTS

RAYS = 360
"""Directions for which the speed is tabulated."""

STEP = 0.1
"""Time step of propagation [s]."""

REACH = 0.6
"""Distance from the goal at which a branch may end and be joined to it [m, a radian as 0.3 m]."""


def driving_rates(query: CompiledProblem) -> FloatArray:
    """Return how fast the vehicle drives in each direction of the plane ``(ds, C dtheta)`` [m/s].

    It is the speed of the cost: the cheapest within the limits, which is the fastest one where
    speed costs nothing.
    """
    cost = query.problem.cost
    if not (np.isfinite(cost.vehicle.motor.speed) or cost.speed):
        raise UnsupportedPlannerError(
            f"controls take time, but the vehicle {cost.vehicle.name!r} has no speed limit; "
            "set its motor speed, or use 'lattice'"
        )
    angle = np.arange(RAYS) * (2 * np.pi / RAYS)
    motion = query.reference(np.cos(angle), np.sin(angle) / cost.half_track)
    start, c_x = query.problem.start, cost.icr.longitudinal
    return np.array(
        [
            1.0 / cost.duration(Path(start, motion.ds[k : k + 1], motion.dtheta[k : k + 1], c_x))
            for k in range(RAYS)
        ]
    )


GAIN = 0.01
"""By how much less than the path known the next one must cost, as a fraction."""


class _Spent(DirectedObjective):
    """Cost of a motion: the difference of what the states have spent."""

    @override
    def motionCost(self, first: Any, second: Any) -> Any:
        """Return the cost of the motion from one state to another."""
        return base.Cost(second[1][0] - first[1][0])


class _Checker(base.StateValidityChecker):
    """Tells whether a state was reached freely and can be on a cheaper path than the one known."""

    def __init__(self, information: Any, query: CompiledProblem, ceiling: float) -> None:
        super().__init__(information)
        self._setting = query.setting
        self._ceiling = ceiling

    @override
    def isValid(self, state: Any) -> bool:
        """Tell whether a state is of use."""
        x, y, yaw = state[0].getX(), state[0].getY(), state[0].getYaw()
        return bool(state[1][0] + free_energy(self._setting, x, y, yaw) < self._ceiling)


class _Goal(base.Goal):
    """The neighbourhood of the goal from which exact steering reaches it cheaply enough."""

    def __init__(self, information: Any, query: CompiledProblem, ceiling: float) -> None:
        super().__init__(information)
        self._setting = query.setting
        self._ceiling = ceiling

    @override
    def isSatisfied(self, state: Any) -> bool:
        """Tell whether the goal can be joined from a state."""
        setting = self._setting
        x, y, yaw = state[0].getX(), state[0].getY(), state[0].getYaw()
        turn = abs(np.remainder(yaw - setting.goal_yaw + np.pi, 2 * np.pi) - np.pi)
        if np.hypot(setting.goal_x - x, setting.goal_y - y) + 0.3 * turn > REACH:
            return False
        return bool(state[1][0] + connection(setting, x, y, yaw, np.inf) < self._ceiling)


def control_rrt(
    problem: PlanningProblem, budget: Budget, *, seed: int = 1, **parameters: object
) -> Candidate:
    """Plan with OMPL's RRT over controls that the motors can hold.

    It is started again until the budget is over, each time for a path that costs less by `GAIN`
    than the one known. The last stretch to the goal, less than `REACH`, is the exact steering
    motion.
    """
    query = CompiledProblem(problem)
    check_way(query)
    setting = query.setting
    rates = driving_rates(query)
    util.setLogLevel(util.LOG_NONE)
    util.RNG.setSeed(seed)

    def motion(action: Any, duration: float) -> tuple[float, float]:
        """Return the arc length and turn of a control that is held for some time."""
        angle = float(action[0])
        size = float(rates[int(angle / (2 * np.pi) * RAYS) % RAYS]) * duration
        return size * np.cos(angle), size * np.sin(angle) / setting.half_track

    def propagate(state: Any, action: Any, duration: float, result: Any) -> None:
        budget.spend(CALL)
        ds, turn = motion(action, duration)
        half = 0.5 * turn
        chord = ds * np.sinc(half / np.pi)
        pose = state[0].getX(), state[0].getY(), state[0].getYaw()
        spent = drive(setting, *pose, np.array([ds]), np.array([turn]), 1, np.inf)
        x = float(pose[0] + chord * np.cos(pose[2] + half))
        y = float(pose[1] + chord * np.sin(pose[2] + half))
        place(result[0], x, y, pose[2] + turn)
        # infinite where the footprint is not free
        result[1][0] = float(state[1][0] + spent)

    best, ceiling = Segments(np.empty(0), np.empty(0)), np.inf
    last: Any = None
    first = budget.elapsed
    while not budget.over:
        space = _space(query, ceiling)
        information = _information(space, propagate)
        checker = _Checker(information, query, ceiling)
        information.setStateValidityChecker(checker)
        information.setup()
        definition = base.ProblemDefinition(information)
        start = space.allocState()
        place(start[0], setting.start_x, setting.start_y, setting.start_yaw)
        start[1][0] = 0.0
        definition.addStartState(start)
        definition.setGoal(_Goal(information, query, ceiling))
        definition.setOptimizationObjective(_Spent(information))
        planner = control.RRT(information)
        set_parameters(planner, "control_rrt", parameters)
        planner.setProblemDefinition(definition)
        planner.setup()
        planner.solve(condition(budget))
        if not definition.hasExactSolution():
            if definition.hasApproximateSolution():
                last = definition.getSolutionPath().getStates()[-1][0]
            break
        way = definition.getSolutionPath()
        motions = [
            motion(action, duration)
            for action, duration in zip(way.getControls(), way.getControlDurations(), strict=True)
        ]
        state = way.getStates()[-1][0]
        cost, found = _completed(query, motions, (state.getX(), state.getY(), state.getYaw()))
        if cost < ceiling:
            if not np.isfinite(ceiling):
                first = budget.elapsed
            best, ceiling = found, cost * (1.0 - GAIN)
    if not np.isfinite(ceiling):
        raise none_in("control_rrt", budget, query, last)
    return Candidate(query.path(best), first_time=first)


def _space(query: CompiledProblem, ceiling: float) -> Any:
    """Return OMPL's space of poses and of what was spent to get there."""
    spent = base.RealVectorStateSpace(1)
    bounds = base.RealVectorBounds(1)
    bounds.setLow(0.0)
    # before a path is known nothing is said of cost
    bounds.setHigh(ceiling if np.isfinite(ceiling) else 1.0)
    spent.setBounds(bounds)
    space = base.CompoundStateSpace()
    space.addSubspace(pose_space(query), 1.0)
    weight = 1.0 / query.setting.least_metre if np.isfinite(ceiling) else 0.0
    space.addSubspace(spent, weight)
    space.lock()
    return space


def _information(space: Any, propagate: Any) -> Any:
    """Return OMPL's information on controls: one angle, held for 1 to 20 steps."""
    controls = control.RealVectorControlSpace(space, 1)
    bounds = base.RealVectorBounds(1)
    bounds.setLow(0.0)
    bounds.setHigh(2 * np.pi)
    controls.setBounds(bounds)
    information = control.SpaceInformation(space, controls)
    information.setStatePropagator(propagate)
    information.setPropagationStepSize(STEP)
    information.setMinMaxControlDuration(1, 20)
    return information


def _completed(
    query: CompiledProblem, motions: list[tuple[float, float]], last: tuple[float, float, float]
) -> tuple[float, Segments]:
    """Return motions joined to the goal, with their cost."""
    setting = query.setting
    ds, dtheta = np.empty(MAX_SEGMENTS), np.empty(MAX_SEGMENTS)
    _, count = join(
        setting, *last, setting.goal_x, setting.goal_y, setting.goal_yaw, np.inf, ds, dtheta
    )
    whole = Segments(
        np.concatenate([[ds for ds, _ in motions], ds[:count]]),
        np.concatenate([[turn for _, turn in motions], dtheta[:count]]),
    )
    start = setting.start_x, setting.start_y, setting.start_yaw
    return drive(setting, *start, whole.ds, whole.dtheta, len(whole.ds), np.inf), whole
