"""Nav2's actions ComputePathToPose and ComputePathThroughPoses: requests and answers.

Humble's results have no error code; what a result does not have is not filled in.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np

from energyplan.cost import EnergyCost
from energyplan.errors import (
    CancelledError,
    EnergyPlanError,
    FrameError,
    MessageError,
    NoViapointsError,
    UnsupportedPlannerError,
)
from energyplan.path import Pose
from energyplan.planning import Plan, PlanningProblem, cancellable, plan, planners
from energyplan.planning.ends import checked_ends
from energyplan.planning.ready import compiled as compile_kernels
from energyplan.planning.replanning import replan
from energyplan.ros.codes import ThroughPosesError, ToPoseError, codes_of, error_code
from energyplan.ros.messages import (
    Factory,
    field,
    path_to_message,
    pose_from_message,
    pose_from_transform,
)
from energyplan.terrain import OccupancyGrid
from energyplan.vehicle import Vehicle

_SHARED = ("cost", "surfaces", "vehicle", "heights", "costmap")
_EQUAL = ("goal", "objective", "clearance", "costmap_weight")


def request_to_problems(
    request: Any,
    grid: OccupancyGrid,
    cost: EnergyCost,
    *,
    frame: str = "map",
    base: str = "base_link",
    lookup: Callable[[str], Any] | None = None,
    **options: Any,
) -> tuple[PlanningProblem, ...]:
    """Return what a goal of ComputePathToPose or ComputePathThroughPoses asks for.

    Parameters
    ----------
    request : object
        The action's goal, of Humble or newer. ``goals`` may be a list or a nav_msgs/Goals;
        ``viapoints`` of newer goals of ComputePathToPose are driven through in order.
    grid : OccupancyGrid
        The map.
    cost : EnergyCost
        Cost of motions.
    frame : str
        Frame of the map.
    base : str
        Frame of the robot's body, whose pose is the start where the request does not bring one.
    lookup : callable, optional
        Takes a frame's name, and returns the geometry_msgs/TransformStamped that brings what is in
        it into the map's frame; raises FrameError where it cannot. For poses in other frames, and
        for the robot's own.
    **options : object
        Further fields of `PlanningProblem`.

    Returns
    -------
    tuple of PlanningProblem
        One problem for each leg, in order.

    Raises
    ------
    FrameError
        If a pose cannot be brought into the map's frame, or the robot's pose is not known.
    NoViapointsError
        If a request through poses has no goals.
    MessageError
        If a field is missing or malformed.

    Examples
    --------
    >>> import numpy as np
    >>> import energyplan as ep
    >>> hall = ep.OccupancyGrid(np.zeros((40, 60), bool), resolution=0.1)
    >>> model = ep.PowerModel.preset("quadriga:empty:marble")
    >>> from types import SimpleNamespace as Message
    >>> turned = Message(x=0.0, y=0.0, z=0.0, w=1.0)
    >>> def stamped(x, y):
    ...     place = Message(position=Message(x=x, y=y, z=0.0), orientation=turned)
    ...     return Message(header=Message(frame_id="map"), pose=place)
    ...
    >>> start, there = stamped(1.0, 2.0), stamped(4.0, 2.0)
    >>> goal = Message(start=start, goal=there, use_start=True, planner_id="")
    >>> (problem,) = request_to_problems(goal, hall, ep.EnergyCost(model))
    >>> problem.goal.x
    4.0
    """

    def pose(message: Any) -> Pose:
        name = str(field(message, "header.frame_id"))
        if lookup is None or name.lstrip("/") == frame.lstrip("/"):
            return pose_from_message(message, frame)
        x, y, yaw = pose_from_message(message)
        base = pose_from_transform(lookup(name))
        c, s = np.cos(base.yaw), np.sin(base.yaw)
        return Pose(
            float(base.x + c * x - s * y), float(base.y + s * x + c * y), float(base.yaw + yaw)
        )

    if hasattr(request, "goals"):
        goals = request.goals.goals if hasattr(request.goals, "goals") else request.goals
        if len(goals) == 0:
            raise NoViapointsError("the request has no goals; give at least one")
    else:
        between = getattr(request, "viapoints", ())
        between = between.goals if hasattr(between, "goals") else between
        goals = [*between, field(request, "goal")]
    if field(request, "use_start"):
        start = pose(field(request, "start"))
    elif lookup is not None:
        start = pose_from_transform(lookup(base))
    else:
        raise FrameError("the robot's pose is not known; give a start, and set use_start")
    stops = [start, *(pose(goal) for goal in goals)]
    return tuple(
        PlanningProblem(grid, cost, here, there, **options) for here, there in pairwise(stops)
    )


def planner_of(planner_id: str, default: str = "lattice") -> str:
    """Return the library's planner for Nav2's ``planner_id``.

    Parameters
    ----------
    planner_id : str
        A planner's name, or empty or ``"GridBased"``, which is what Nav2 asks for by default.
    default : str
        Planner for these two.

    Returns
    -------
    str
        Name of the planner.

    Raises
    ------
    UnsupportedPlannerError
        If there is no such planner.

    Examples
    --------
    >>> planner_of("GridBased"), planner_of("roadmap")
    ('lattice', 'roadmap')
    """
    name = default if planner_id in ("", "GridBased") else planner_id
    if name not in planners():
        raise UnsupportedPlannerError(
            f"there is no planner {name!r}; known: {', '.join(planners())}"
        )
    return name


@dataclass(frozen=True)
class Answer:
    """What became of a request.

    Attributes
    ----------
    plans : tuple of Plan
        A plan for each leg; none after an error.
    code : ToPoseError or ThroughPosesError
        Nav2's error code.
    message : str
        What went wrong, and what helps; empty if nothing did.
    planning_time : float
        Time spent [s].
    problems : tuple of PlanningProblem
        What each leg asked for; none after an error.

    Examples
    --------
    >>> import numpy as np
    >>> import energyplan as ep
    >>> hall = ep.OccupancyGrid(np.zeros((40, 60), bool), resolution=0.1)
    >>> model = ep.PowerModel.preset("quadriga:empty:marble")
    >>> from types import SimpleNamespace as Message
    >>> turned = Message(x=0.0, y=0.0, z=0.0, w=1.0)
    >>> def stamped(x, y):
    ...     place = Message(position=Message(x=x, y=y, z=0.0), orientation=turned)
    ...     return Message(header=Message(frame_id="map"), pose=place)
    ...
    >>> start, there = stamped(1.0, 2.0), stamped(4.0, 2.0)
    >>> goal = Message(start=start, goal=there, use_start=True, planner_id="")
    >>> told = answer(goal, hall, ep.EnergyCost(model), effort=1000)
    >>> told.code.name, round(told.energy), told.lower_bound <= told.energy
    ('NONE', 540, True)
    """

    plans: tuple[Plan, ...]
    code: ToPoseError | ThroughPosesError
    message: str
    planning_time: float
    problems: tuple[PlanningProblem, ...] = ()

    @property
    def energy(self) -> float:
        """Energy of all legs [J]."""
        return float(sum(plan.energy for plan in self.plans))

    @property
    def notes(self) -> tuple[str, ...]:
        """What was done about ends that lack the clearance, or a start that touches an obstacle."""
        return tuple(note for plan in self.plans for note in plan.notes)

    @property
    def lower_bound(self) -> float:
        """What no paths through the same poses can cost less than, in the objective's unit."""
        return float(sum(plan.lower_bound for plan in self.plans))


def answer(
    request: Any,
    grid: OccupancyGrid | None,
    cost: EnergyCost,
    *,
    planner: str = "lattice",
    time_limit: float = 1.0,
    effort: int | None = None,
    unwanted: Callable[[], bool] = lambda: False,
    former: Answer | None = None,
    **options: Any,
) -> Answer:
    """Plan what a request asks for; every error of the library becomes a code and a message.

    Parameters
    ----------
    request : object
        Goal of ComputePathToPose or ComputePathThroughPoses.
    grid : OccupancyGrid, optional
        The map; None where none has come yet, which is an error of the answer.
    cost : EnergyCost
        Cost of motions.
    planner : str
        Planner where the request names none.
    time_limit : float
        Time for all legs together [s].
    effort : int, optional
        Units of work for all legs together, in place of the time limit.
    unwanted : callable
        Tells whether the goal was cancelled; asked often.
    former : Answer, optional
        The answer before. Where it led to the same goals, what is left of its plans is where to
        start from: while that is free it is returned at once, see `replan`.
    **options : object
        What `request_to_problems` takes besides.

    Returns
    -------
    Answer
        The plans, or why there are none.

    Raises
    ------
    CancelledError
        If the goal was cancelled.

    Examples
    --------
    >>> import numpy as np
    >>> import energyplan as ep
    >>> hall = ep.OccupancyGrid(np.zeros((40, 60), bool), resolution=0.1)
    >>> model = ep.PowerModel.preset("quadriga:empty:marble")
    >>> from types import SimpleNamespace as Message
    >>> turned = Message(x=0.0, y=0.0, z=0.0, w=1.0)
    >>> def stamped(x, y):
    ...     place = Message(position=Message(x=x, y=y, z=0.0), orientation=turned)
    ...     return Message(header=Message(frame_id="map"), pose=place)
    ...
    >>> start, there = stamped(1.0, 2.0), stamped(4.0, 2.0)
    >>> goal = Message(start=start, goal=there, use_start=True, planner_id="")
    >>> answer(goal, hall, ep.EnergyCost(model), effort=1000).code.name
    'NONE'
    >>> answer(goal, None, ep.EnergyCost(model)).message
    'no map has come yet; publish one, or name its topic'
    """
    began = time.perf_counter()
    codes = codes_of(request)
    problem = None
    plans: list[Plan] = []
    try:
        if grid is None:
            raise MessageError("no map has come yet; publish one, or name its topic")
        name = planner_of(str(field(request, "planner_id")), planner)
        problems = request_to_problems(request, grid, cost, **options)
        for problem in problems:
            checked_ends(problem)
        share = None if effort is None else max(effort // len(problems), 1)
        with cancellable(unwanted):
            for leg, problem in enumerate(problems):
                known = _known(problem, len(problems) - leg, former) if name == "lattice" else None
                make: Callable[..., Plan] = partial(plan, problem, name)
                if known is not None:
                    make = partial(replan, *known, start=problem.start, map=grid)
                plans.append(make(time_limit=time_limit / len(problems), effort=share))
    except CancelledError:
        raise
    except EnergyPlanError as error:
        spent = time.perf_counter() - began
        return Answer((), error_code(error, codes, problem), str(error), spent)
    return Answer(tuple(plans), codes["NONE"], "", time.perf_counter() - began, problems)


def aborted(request: Any, message: str) -> Answer:
    """Return the answer to a request that was given up."""
    return Answer((), codes_of(request)["UNKNOWN"], message, 0.0)


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
        compile_kernels(problem, tight=True)
        former = plan(problem, planner, time_limit=0.2)
        replan(problem, former, start=former.path.poses(size, 1.0)[1], time_limit=0.2)


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
    problem: PlanningProblem, left: int, former: Answer | None
) -> tuple[PlanningProblem, Plan] | None:
    """Return the leg of an answer before that has as many left, if it asked for the same."""
    if former is None or left > len(former.plans):
        return None
    before, found = former.problems[-left], former.plans[-left]
    same = [getattr(before, name) is getattr(problem, name) for name in _SHARED]
    same += [getattr(before, name) == getattr(problem, name) for name in _EQUAL]
    return (before, found) if all(same) else None


def fill_result(result: Any, answer: Answer, frame: str, stamp: Any, factory: Factory) -> Any:
    """Fill in the result of an action.

    Parameters
    ----------
    result : object
        The result; of its fields ``path``, ``planning_time``, ``error_code`` and ``error_msg``
        those are set that it has.
    answer : Answer
        What became of the request.
    frame : str
        Frame of the map.
    stamp : object
        A builtin_interfaces/Time.
    factory : callable
        Gives a message's class by its name, see `path_to_message`.

    Returns
    -------
    object
        The same result.

    Examples
    --------
    >>> from rosbags.typesys import Stores, get_typestore
    >>> factory = get_typestore(Stores.ROS2_HUMBLE).types.__getitem__
    >>> stamp = factory("builtin_interfaces/msg/Time")(sec=0, nanosec=0)
    >>> nothing = Answer((), ToPoseError.TIMEOUT, "no path was found in time", 1.5)
    >>> from types import SimpleNamespace
    >>> result = SimpleNamespace(path=None, planning_time=None, error_code=0, error_msg="")
    >>> fill_result(result, nothing, "map", stamp, factory).error_code
    207
    """
    seconds = int(answer.planning_time)
    rest = min(round((answer.planning_time - seconds) * 1e9), 10**9 - 1)
    duration = factory("builtin_interfaces/msg/Duration")
    path = path_to_message([plan.path for plan in answer.plans], frame, stamp, factory)
    values: Sequence[tuple[str, Any]] = (
        ("path", path),
        ("planning_time", duration(sec=seconds, nanosec=rest)),
        ("error_code", int(answer.code)),
        ("error_msg", answer.message),
    )
    for name, value in values:
        if hasattr(result, name):
            setattr(result, name, value)
    return result
