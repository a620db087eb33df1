"""What the nodes answer: Nav2's planning actions, diagnostics, missions, a model while driving.

The actions are ComputePathToPose and ComputePathThroughPoses, with the error codes that nav2_msgs
has since Iron. Humble's results have no error code; what a result does not have is not filled in.
"""

from __future__ import annotations

import json
import time
from cmath import rect
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import IntEnum
from functools import partial
from itertools import pairwise
from math import inf, isfinite
from pathlib import Path
from typing import Any

import numpy as np
import shapely

from energyplan import errors
from energyplan.cost import EnergyCost
from energyplan.fit.online import OnlineIdentifier
from energyplan.io.bags import TopicMap, read_message
from energyplan.io.mission import mission_from
from energyplan.io.sites import models_of, with_presets
from energyplan.logs.clean import POWER_WAYS, total_power
from energyplan.mission import evaluate
from energyplan.output import documents
from energyplan.path import Pose
from energyplan.planning import Goal, Plan, PlanningProblem, cancellable, plan, planners
from energyplan.planning.budget import EFFORT
from energyplan.planning.driven import drive_plan
from energyplan.planning.ends import checked_ends
from energyplan.planning.plans import spending
from energyplan.planning.replanning import replan
from energyplan.planning.search.planner import compile_planning
from energyplan.power import PowerModel
from energyplan.ros.messages import (
    Factory,
    field,
    path_to_message,
    pose_from_message,
    pose_from_transform,
    speed_limit_from_message,
)  # fmt: skip
from energyplan.terrain import OccupancyGrid, with_limits
from energyplan.vehicle import Vehicle


class ToPoseError(IntEnum):
    """Error codes of nav2_msgs/action/ComputePathToPose."""

    NONE, UNKNOWN, INVALID_PLANNER, TF_ERROR = 0, 200, 201, 202
    START_OUTSIDE_MAP, GOAL_OUTSIDE_MAP, START_OCCUPIED, GOAL_OCCUPIED = 203, 204, 205, 206
    TIMEOUT, NO_VALID_PATH = 207, 208


class ThroughPosesError(IntEnum):
    """Error codes of nav2_msgs/action/ComputePathThroughPoses."""

    NONE, UNKNOWN, INVALID_PLANNER, TF_ERROR = 0, 300, 301, 302
    START_OUTSIDE_MAP, GOAL_OUTSIDE_MAP, START_OCCUPIED, GOAL_OCCUPIED = 303, 304, 305, 306
    TIMEOUT, NO_VALID_PATH = 307, 308
    NO_VIAPOINTS_GIVEN = 309


Codes = type[ToPoseError] | type[ThroughPosesError]

_NAMES: tuple[tuple[type[errors.EnergyPlanError], str], ...] = (
    (errors.NoViapointsError, "NO_VIAPOINTS_GIVEN"),
    (errors.UnsupportedPlannerError, "INVALID_PLANNER"),
    (errors.FrameError, "TF_ERROR"),
    (errors.StartInCollisionError, "START_OCCUPIED"),
    (errors.GoalInCollisionError, "GOAL_OCCUPIED"),
    (errors.TimeLimitError, "TIMEOUT"),
    (errors.NoPathError, "NO_VALID_PATH"),
)


def codes_of(request: Any) -> Codes:
    """Return the error codes of the action that a goal belongs to."""
    return ThroughPosesError if hasattr(request, "goals") else ToPoseError


def error_code(
    error: errors.EnergyPlanError, codes: Codes, problem: PlanningProblem | None = None
) -> ToPoseError | ThroughPosesError:
    """Return the code of Nav2's planner server for an error of the library."""
    if isinstance(error, errors.OutsideMapError) and problem is not None:
        on_map = problem.terrain.obstacles.inside(problem.start[:2])
        return codes["GOAL_OUTSIDE_MAP" if bool(on_map) else "START_OUTSIDE_MAP"]
    for kind, name in _NAMES:
        if isinstance(error, kind):
            return codes[name]
    return codes["UNKNOWN"]


HEADING_MODES = {"DEFAULT": "given", "BIDIRECTIONAL": "either", "ALL_DIRECTION": "any"}
"""Which heading of a `Goal` each value of Smac's ``goal_heading_mode`` stands for."""

_SHARED = ("cost", "surfaces", "vehicle", "heights", "costmap")
_EQUAL = ("goals", "objective", "clearance", "costmap_weight", "turning")


def request_to_problems(
    request: Any,
    grid: OccupancyGrid,
    cost: EnergyCost,
    *,
    frame: str = "map",
    base: str = "base_link",
    lookup: Callable[[str], Any] | None = None,
    heading_mode: str = "DEFAULT",
    tolerance: float = 0.0,
    **options: Any,
) -> tuple[PlanningProblem, ...]:
    """Return what a goal of ComputePathToPose or ComputePathThroughPoses asks for.

    A path ends within the tolerance of each goal [m], at a heading that the mode (of
    `HEADING_MODES`) allows. Where that leaves a choice, `answer` has the next path begin where the
    one before ends.
    """
    if heading_mode not in HEADING_MODES:
        raise errors.InvalidInputError(
            f"the goal_heading_mode is {heading_mode!r}; give one of {', '.join(HEADING_MODES)}"
        )

    def pose(message: Any) -> Pose:
        try:
            return pose_from_message(message, frame)
        except errors.FrameError:
            if lookup is None:
                raise
        x, y, yaw = pose_from_message(message)
        base = pose_from_transform(lookup(message.header.frame_id))
        place = complex(base.x, base.y) + complex(x, y) * rect(1.0, base.yaw)
        return Pose(place.real, place.imag, base.yaw + yaw)

    if hasattr(request, "goals"):
        goals = request.goals.goals if hasattr(request.goals, "goals") else request.goals
        if len(goals) == 0:
            raise errors.NoViapointsError("the request has no goals; give at least one")
    else:
        between = getattr(request, "viapoints", ())
        between = between.goals if hasattr(between, "goals") else between
        goals = [*between, field(request, "goal")]
    if field(request, "use_start"):
        start = pose(field(request, "start"))
    elif lookup is not None:
        start = pose_from_transform(lookup(base))
    else:
        raise errors.FrameError("the robot's pose is not known; give a start, and set use_start")
    stops = [start, *(pose(goal) for goal in goals)]

    def goal(there: Pose) -> Any:
        return Goal(*there, heading=HEADING_MODES[heading_mode], radius=tolerance)

    return tuple(
        PlanningProblem(grid, cost, here, goal(there), **options) for here, there in pairwise(stops)
    )


def planner_of(planner_id: str, default: str = "lattice") -> str:
    """Return the library's planner for Nav2's ``planner_id``."""
    name = default if planner_id in ("", "GridBased") else planner_id
    if name not in planners():
        raise errors.UnsupportedPlannerError(
            f"there is no planner {name!r}; known: {', '.join(planners())}"
        )
    return name


@dataclass(frozen=True)
class PlanResult:
    """What became of a request."""

    plans: tuple[Plan, ...]
    code: ToPoseError | ThroughPosesError
    message: str
    planning_time: float

    @property
    def energy(self) -> float:
        """Energy of all legs [J]: as driven if the motors can drive all, else steady."""
        return float(sum(one.energy for one in spending(*self.plans)))

    @property
    def energy_steady(self) -> float:
        """Energy of all legs at steady speeds [J]."""
        return float(sum(plan.energy_steady for plan in self.plans))

    @property
    def notes(self) -> tuple[str, ...]:
        """What was done about ends that lack the clearance, or a start that touches an obstacle."""
        return tuple(note for plan in self.plans for note in plan.all_notes)

    @property
    def lower_bound(self) -> float | None:
        """What no paths through the same poses can cost less than, in the objective's unit.

        A bound of driving them; None where none is known.
        """
        bounds = [plan.lower_bound for plan in self.plans]
        return None if None in bounds else float(sum(one for one in bounds if one is not None))


def answer(
    request: Any,
    grid: OccupancyGrid | None,
    cost: EnergyCost,
    *,
    planner: str = "lattice",
    time_limit: float = inf,
    effort: int | None = None,
    unwanted: Callable[[], bool] = lambda: False,
    former: PlanResult | None = None,
    missing: str = "no map has come yet; publish one, or name its topic",
    **options: Any,
) -> PlanResult:
    """Plan what a request asks for; every error of the library becomes a code and a message."""
    began = time.perf_counter()
    codes = codes_of(request)
    problem = None
    plans: list[Plan] = []
    try:
        if grid is None:
            raise errors.MessageError(missing)
        name = planner_of(str(field(request, "planner_id")), planner)
        problems = request_to_problems(request, grid, cost, **options)
        for problem in problems:
            if not problem.goals:  # where there is a choice, planning checks
                checked_ends(problem)
        share = max((EFFORT if effort is None else effort) // len(problems), 1)
        with cancellable(unwanted):
            for leg, problem in enumerate(problems):
                if plans and problems[leg - 1].goals:
                    problem = replace(problem, start=plans[-1].path.end)
                known = _known(problem, len(problems) - leg, former) if name == "lattice" else None
                make: Callable[..., Plan] = partial(plan, problem, name)
                if known is not None:
                    make = partial(replan, *known, start=problem.start, map=grid)
                plans.append(make(time_limit=time_limit / len(problems), effort=share))
    except errors.CancelledError:
        raise
    except errors.EnergyPlanError as error:
        spent = time.perf_counter() - began
        return PlanResult((), error_code(error, codes, problem), str(error), spent)
    return PlanResult(tuple(plans), codes["NONE"], "", time.perf_counter() - began)


def aborted(request: Any, message: str) -> PlanResult:
    """Return the answer to a request that was given up."""
    return PlanResult((), codes_of(request)["UNKNOWN"], message, 0.0)


def warm_up(
    cost: EnergyCost, planner: str = "lattice", unwanted: Callable[[], bool] = lambda: False
) -> None:
    """Compile what planning and replanning need, so that no request waits for it."""
    size = float(np.ptp(cost.vehicle.footprint, axis=0).max())
    hall = OccupancyGrid(np.zeros((40, 80), bool), resolution=0.15 * size)
    problem = PlanningProblem(
        hall, cost, Pose(2 * size, 3 * size, 0.0), Pose(9 * size, 3 * size, 1.0),
        clearance=0.1 * size,
    )  # fmt: skip
    with cancellable(unwanted):
        compile_planning(problem, tight=True)
        former = plan(problem, planner)
        replan(problem, former, start=former.path.poses(size, 1.0)[1])


def blocked_poses(
    path: Any,
    grid: OccupancyGrid,
    vehicle: Vehicle,
    frame: str = "map",
    lookup: Callable[[str], Any] | None = None,
    base: str = "base_link",
) -> list[int]:
    """Return the indices of a nav_msgs/Path's poses where the footprint is not free.

    With a `lookup` as in `request_to_problems`, those from where the robot is on alone.
    """
    poses = np.array([pose_from_message(pose, frame) for pose in field(path, "poses")])
    if len(poses) == 0:
        return []
    first = 0
    if lookup is not None:
        here = pose_from_transform(lookup(base))
        first = int(np.argmin(np.hypot(*(poses[:, :2] - here[:2]).T)))
    free = grid.footprint_free(poses[first:], vehicle)
    return [first + int(k) for k in np.flatnonzero(~free)]


def _known(
    problem: PlanningProblem, left: int, former: PlanResult | None
) -> tuple[PlanningProblem, Plan] | None:
    """Return the former answer's leg with as many left, if it was for the same problem."""
    found = former.plans[-left] if former and left <= len(former.plans) else None
    before = found.problem if found else None
    if found is None or before is None:
        return None
    same = [getattr(before, name) is getattr(problem, name) for name in _SHARED]
    same += [getattr(before, name) == getattr(problem, name) for name in _EQUAL]
    same.append(bool(problem.goals) or before.goal == problem.goal)  # one of several, or the pose
    return (before, found) if all(same) else None


def fill_result(result: Any, answer: PlanResult, frame: str, stamp: Any, factory: Factory) -> Any:
    """Fill in the result of an action."""
    seconds = int(answer.planning_time)
    rest = min(round((answer.planning_time - seconds) * 1e9), 10**9 - 1)
    duration = factory("builtin_interfaces/msg/Duration")
    path = path_to_message([plan.path for plan in answer.plans], frame, stamp, factory)
    values = {
        "path": path, "planning_time": duration(sec=seconds, nanosec=rest),
        "error_code": int(answer.code), "error_msg": answer.message,
    }  # fmt: skip
    for name, value in values.items():
        if hasattr(result, name):
            setattr(result, name, value)
    return result


STALE = 1.0
"""Age at which the last value of a channel is no longer taken for the present one [s]."""


ENOUGH = 100
"""Samples from which on the sign of the power can be told."""


class DriveFeed:
    """Feeds an `OnlineIdentifier` from the messages of several topics.

    A sample is made at every message that brings the power. Channels that came more often since
    the sample before are averaged; the last value of one that came less often is kept for a
    second. Nothing is fed while a channel is missing.

    Where a topic map names the power in several ways, the first of `POWER_WAYS` that comes within a
    second is used from then on: mixed, they would be measured at different places.
    """

    def __init__(self, identifier: OnlineIdentifier, topics: TopicMap) -> None:
        channels = topics.channels
        self._ways = [names for names in POWER_WAYS if set(names) <= set(channels)]
        missing = [name for name in ("v_left", "v_right") if name not in channels]
        if missing or not self._ways:
            raise errors.MessageError(
                f"the topic map {topics.name!r} names no {' and '.join(missing or ['power'])}; "
                "name v_left, v_right, and power, p_left and p_right, or voltage and current"
            )
        self.identifier = identifier
        self.samples = 0  # fed so far
        self._below = 0  # of them with a power below zero
        self._topics = topics
        self._sums: dict[str, tuple[float, int]] = {}
        self._last: dict[str, tuple[float, float]] = {}
        self._t, self._power_since = float("-inf"), float("inf")

    @property
    def wrong_sign(self) -> str:
        """Say that the power is below zero in most samples; empty where it is not."""
        if self.samples < ENOUGH or self._below <= self.samples / 2:
            return ""
        names = self._ways[0]
        topics = (one.topic for name in names for one in self._topics.channels[name])
        return (
            f"the power is below zero in {self._below} of {self.samples} samples, as if driving "
            f"charged the battery; give the other sign to the scale of {names[-1]} in the topic "
            f"map ({' or '.join(dict.fromkeys(topics))})"
        )

    @property
    def topics(self) -> Sequence[str]:
        """Names of the topics to listen to."""
        sources = (one for many in self._topics.channels.values() for one in many)
        return tuple(dict.fromkeys(source.topic for source in sources))

    def missing(self, t: float) -> str:
        """Name the channels that have not come for a second, and the topics that bring them."""
        known = {name for name, (_, at) in self._last.items() if t - at <= STALE}
        wanted = {"v_left", "v_right"} - known
        if not any(set(way) <= known for way in self._ways):
            wanted.update(*(set(way) - known for way in self._ways))
        return ", ".join(
            f"{name} ({' or '.join(source.topic for source in sources)})"
            for name, sources in self._topics.channels.items() if name in wanted
        )  # fmt: skip

    def take(self, topic: str, message: Any, t: float) -> bool:
        """Take a message."""
        fresh = set()
        for name, sources in self._topics.channels.items():
            values = (read_message(one, message) for one in sources if one.matches(topic))
            value = next(filter(isfinite, values), None)
            if value is not None:
                total, count = self._sums.get(name, (0.0, 0))
                self._sums[name] = total + value, count + 1
                self._last[name] = value, t
                fresh.add(name)
        come = [way for way in self._ways if set(way) <= set(self._last)]
        if come:
            self._power_since = min(self._power_since, t)
            if come[0] == self._ways[0] or t - self._power_since > STALE:
                self._ways = come[:1]
        if len(self._ways) > 1 or self._ways[0][-1] not in fresh or not t > self._t:
            return False
        return self._feed(t)

    def _feed(self, t: float) -> bool:
        """Feed what has come since the last sample, if it is all there."""
        known = {name: value for name, (value, at) in self._last.items() if t - at <= STALE}
        known |= {name: total / count for name, (total, count) in self._sums.items()}
        self._sums.clear()
        (way,) = self._ways
        if not {"v_left", "v_right", *way} <= set(known):
            return False
        power = float(total_power({name: np.array(known.pop(name)) for name in way}))
        needed = {name for term in self.identifier.model.terms for name in term.channels}
        more = {name: value for name, value in known.items() if name in needed}
        left, right = known["v_left"], known["v_right"]
        changed = self.identifier.update(t, left, right, power, **more)
        self._t = t
        self.samples += 1
        self._below += power < 0
        return changed


def plan_values(answer: PlanResult, limit: Any = None) -> dict[str, str]:
    """Return the values of a plan for diagnostics: energy, bound [J] and the time it took [s].

    With a nav2_msgs/SpeedLimit also what driving the paths takes under it.
    """
    if not answer.plans:
        return {"error": answer.message}
    bound = answer.lower_bound
    return {
        "energy [J]": f"{answer.energy:.6g}",
        "energy at steady speeds [J]": f"{answer.energy_steady:.6g}",
        **({} if bound is None else {"lower bound [J]": f"{bound:.6g}"}),
        "length [m]": f"{sum(plan.length for plan in answer.plans):.6g}",
        "planning time [s]": f"{answer.planning_time:.3g}",
        **(_limited(answer.plans, limit) if limit is not None else {}),
        **{f"note {k}": note for k, note in enumerate(answer.notes, start=1)},
    }


def _limited(plans: Sequence[Plan], message: Any) -> dict[str, str]:
    """Return what driving plans takes under a speed limit that holds everywhere."""
    vertices = np.concatenate([plan.path.poses() for plan in plans])
    area = shapely.box(*vertices[:, :2].min(axis=0) - 1.0, *vertices[:, :2].max(axis=0) + 1.0)
    unit = "% of the top speed" if field(message, "percentage") else "m/s"
    name = f"speed limit {field(message, 'speed_limit'):g} {unit}"
    try:
        limit = speed_limit_from_message(message, area)
        if limit is None:
            return {}
        driven = []
        for plan in plans:
            problem = plan.problem
            assert problem is not None  # a plan that was just made has one
            slow = replace(problem, surfaces=with_limits(problem.surfaces, [limit]))
            driven.append(drive_plan(slow, plan.path))
    except errors.EnergyPlanError as error:
        return {name: f"left out: {error}"}
    return {
        name: "counts in what follows; the route was chosen without it",
        "driven energy [J]": f"{sum(one.energy for one in driven):.6g}",
        "driving time [s]": f"{sum(one.duration for one in driven):.6g}",
    }


def model_values(model: PowerModel) -> dict[str, str]:
    """Return the values of a model for diagnostics: each coefficient, with its standard error."""
    values = {}
    for term, value in zip(model.terms, model.coefficients.tolist(), strict=True):
        error = model.std_error(term.name)
        told = f"{value:.5g}" + ("" if error is None else f" +- {error:.2g}")
        values[f"{term.name} [{term.unit}]"] = told
    return values


def diagnostics_message(
    name: str, message: str, values: Mapping[str, str], stamp: Any, factory: Factory,
    *, error: bool = False,
) -> Any:  # fmt: skip
    """Return a diagnostic_msgs/DiagnosticArray with one status."""
    status = factory("diagnostic_msgs/msg/DiagnosticStatus")
    pair = factory("diagnostic_msgs/msg/KeyValue")
    level: Any = getattr(status, "ERROR" if error else "OK")
    one = status(
        level=level, name=name, message=message, hardware_id="",
        values=[pair(key=key, value=value) for key, value in values.items()],
    )  # fmt: skip
    header = factory("std_msgs/msg/Header")(stamp=stamp, frame_id="")
    return factory("diagnostic_msgs/msg/DiagnosticArray")(header=header, status=[one])


def mission_answer(text: str, folder: str | Path) -> str:
    """Return whether a mission can be done, as JSON, from its text."""
    try:
        mission = mission_from(text, folder)
        answer = with_presets(documents.mission(evaluate(mission)), models_of(mission))
        return json.dumps(answer)
    except errors.EnergyPlanError as error:
        return json.dumps({"error": " ".join(str(error).split())})
