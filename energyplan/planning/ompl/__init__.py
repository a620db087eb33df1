"""OMPL's planners on the true energy, and the lattice planner as one of OMPL's.

States are poses of the point midway between the tread ICRs. A motion between two states is the
exact minimum-energy one: the objective prices it, the motion validator tests it with the whole
footprint, and the path that comes back is made of it. OMPL's own interpolation between states is
used for new samples only, never for motions, so that no path slides sideways.

Some of OMPL 2.0.1's planners are left out, since they do not bear a Python objective: PRM and PRM*
wait for Python's lock for ever, and AORRTC ignores the objective.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from itertools import pairwise
from typing import Any

import numpy as np
from ompl import base, geometric, util
from typing_extensions import override

from energyplan.cost import EnergyCost
from energyplan.errors import TimeLimitError
from energyplan.path import Path
from energyplan.planning import plan
from energyplan.planning.budget import Budget
from energyplan.planning.contract import Candidate
from energyplan.planning.ompl.parts import (
    EnergyObjective,
    PoseChecker,
    SteeringValidator,
    condition,
    end_states,
    none_in,
    pose_space,
    pose_state,
    set_parameters,
)
from energyplan.planning.problem import Plan, PlanningProblem
from energyplan.planning.scene.closure import check_way
from energyplan.planning.scene.compiled import CompiledProblem, Segments
from energyplan.steering.kernels import MAX_SEGMENTS, steer_path
from energyplan.terrain import OccupancyGrid, SurfaceMap
from energyplan.vehicle import Vehicle

__all__ = [
    "EnergyObjective",
    "LatticePlanner",
    "PoseChecker",
    "SteeringValidator",
    "bitstar",
    "fmt",
    "informed_rrtstar",
    "pose_space",
    "pose_state",
    "rrtstar",
]

SPACING = 0.05
"""Distance [m] and turn [rad] between the states of a path that is handed to OMPL."""


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
    query = CompiledProblem(problem)
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


def rrtstar(
    problem: PlanningProblem, budget: Budget, *, seed: int = 1, **parameters: object
) -> Candidate:
    """Plan with OMPL's RRT* on the objective of the problem."""
    return _geometric(geometric.RRTstar, "rrtstar", problem, budget, seed, parameters)


def informed_rrtstar(
    problem: PlanningProblem, budget: Budget, *, seed: int = 1, **parameters: object
) -> Candidate:
    """Plan with OMPL's informed RRT*; parameters as in `rrtstar`."""
    make = geometric.InformedRRTstar
    return _geometric(make, "informed_rrtstar", problem, budget, seed, parameters)


def bitstar(
    problem: PlanningProblem, budget: Budget, *, seed: int = 1, **parameters: object
) -> Candidate:
    """Plan with OMPL's BIT*; parameters as in `rrtstar`."""
    return _geometric(geometric.BITstar, "bitstar", problem, budget, seed, parameters)


def fmt(
    problem: PlanningProblem, budget: Budget, *, seed: int = 1, **parameters: object
) -> Candidate:
    """Plan with OMPL's FMT*; parameters as in `rrtstar`.

    FMT* is not anytime: it draws ``num_samples`` samples, then searches once.
    """
    return _geometric(geometric.FMT, "fmt", problem, budget, seed, parameters)


class LatticePlanner(base.Planner):
    """The lattice planner for OMPL: for ``SimpleSetup`` and OMPL's benchmark.

    Its states are poses of the body frame, in any state space whose states have ``setXY`` and
    ``setYaw``. Take ``ReedsSheppStateSpace(C)`` with `C` half the slip track: the states of the
    path lie so close together that OMPL's interpolation between them drives what was planned.
    """

    def __init__(
        self,
        information: Any,
        grid: OccupancyGrid,
        cost: EnergyCost,
        *,
        surfaces: SurfaceMap | None = None,
        objective: str | Mapping[str, float] = "energy",
        vehicle: Vehicle | None = None,
        gap: float = 1e-3,
    ) -> None:
        super().__init__(information, "EnergyLattice")
        self._make = lambda start, goal: PlanningProblem(
            grid, cost, start, goal, surfaces, objective, vehicle
        )
        self._information = information
        self._gap = gap
        self.plan: Plan | None = None

    @override
    def solve(self, condition: Any) -> Any:
        """Plan until OMPL's termination condition holds, or nothing is left to gain."""
        until = condition
        limit = time.perf_counter() + (until if isinstance(until, (int, float)) else np.inf)

        def over() -> bool:
            return time.perf_counter() >= limit or bool(hasattr(until, "eval") and until.eval())

        definition = self.getProblemDefinition()
        # not through getStartState: Python would free what the problem definition owns
        inputs = self.getPlannerInputStates()
        inputs.restart()
        first, last = inputs.nextStart(), inputs.nextGoal()
        problem = self._make(
            (first.getX(), first.getY(), first.getYaw()), (last.getX(), last.getY(), last.getYaw())
        )
        self.plan = None
        known: list[Path] = []
        share = 0.1
        while not over():
            share = min(2.0 * share, 0.4, max(limit - time.perf_counter(), 1e-3))
            try:
                self.plan = plan(problem, time_limit=share, gap=self._gap, initial=known)
            except TimeLimitError:
                continue
            known = [self.plan.path]
            # it also ends where nothing is gained any more
            if self.plan.gap <= self._gap or self.plan.planning_time < 0.9 * share:
                break
        if self.plan is None:
            return base.PlannerStatus(base.PlannerStatus.TIMEOUT)
        way = geometric.PathGeometric(self._information)
        state = self._information.allocState()
        for x, y, yaw in self.plan.path.poses(SPACING, SPACING):
            state.setXY(float(x), float(y))
            state.setYaw(float(np.remainder(yaw + np.pi, 2 * np.pi) - np.pi))
            way.append(state)
        definition.addSolutionPath(way, False, 0.0, "EnergyLattice")
        return base.PlannerStatus(base.PlannerStatus.EXACT_SOLUTION)
