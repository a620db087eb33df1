"""Error codes of Nav2's actions ComputePathToPose and ComputePathThroughPoses.

They are those of nav2_msgs since Iron.
"""

from __future__ import annotations

from enum import IntEnum
from typing import Any

from energyplan.errors import (
    EnergyPlanError,
    FrameError,
    GoalInCollisionError,
    NoPathError,
    NoViapointsError,
    OutsideMapError,
    StartInCollisionError,
    TimeLimitError,
    UnsupportedPlannerError,
)
from energyplan.planning import PlanningProblem


class ToPoseError(IntEnum):
    """Error codes of nav2_msgs/action/ComputePathToPose.

    Examples
    --------
    >>> ToPoseError.NO_VALID_PATH.value
    208
    """

    NONE = 0
    UNKNOWN = 200
    INVALID_PLANNER = 201
    TF_ERROR = 202
    START_OUTSIDE_MAP = 203
    GOAL_OUTSIDE_MAP = 204
    START_OCCUPIED = 205
    GOAL_OCCUPIED = 206
    TIMEOUT = 207
    NO_VALID_PATH = 208


class ThroughPosesError(IntEnum):
    """Error codes of nav2_msgs/action/ComputePathThroughPoses.

    Examples
    --------
    >>> ThroughPosesError.NO_VIAPOINTS_GIVEN.value
    309
    """

    NONE = 0
    UNKNOWN = 300
    INVALID_PLANNER = 301
    TF_ERROR = 302
    START_OUTSIDE_MAP = 303
    GOAL_OUTSIDE_MAP = 304
    START_OCCUPIED = 305
    GOAL_OCCUPIED = 306
    TIMEOUT = 307
    NO_VALID_PATH = 308
    NO_VIAPOINTS_GIVEN = 309


Codes = type[ToPoseError] | type[ThroughPosesError]

_NAMES: tuple[tuple[type[EnergyPlanError], str], ...] = (
    (NoViapointsError, "NO_VIAPOINTS_GIVEN"),
    (UnsupportedPlannerError, "INVALID_PLANNER"),
    (FrameError, "TF_ERROR"),
    (StartInCollisionError, "START_OCCUPIED"),
    (GoalInCollisionError, "GOAL_OCCUPIED"),
    (TimeLimitError, "TIMEOUT"),
    (NoPathError, "NO_VALID_PATH"),
)


def codes_of(request: Any) -> Codes:
    """Return the error codes of the action that a goal belongs to.

    Examples
    --------
    >>> from types import SimpleNamespace as Message
    >>> codes_of(Message(goals=[])).__name__
    'ThroughPosesError'
    """
    return ThroughPosesError if hasattr(request, "goals") else ToPoseError


def error_code(
    error: EnergyPlanError, codes: Codes, problem: PlanningProblem | None = None
) -> ToPoseError | ThroughPosesError:
    """Return the code of Nav2's planner server for an error of the library.

    Parameters
    ----------
    error : EnergyPlanError
        The error.
    codes : type
        `ToPoseError` or `ThroughPosesError`.
    problem : PlanningProblem, optional
        What was to be planned: it shows whether start or goal lies outside the map.

    Returns
    -------
    ToPoseError or ThroughPosesError
        The code; ``UNKNOWN`` for what Nav2 has no name for, such as a malformed message.

    Examples
    --------
    >>> from energyplan.errors import TimeLimitError
    >>> error_code(TimeLimitError("no path was found in time"), ToPoseError).name
    'TIMEOUT'
    """
    if isinstance(error, OutsideMapError) and problem is not None:
        on_map = problem.terrain.obstacles.inside(problem.start[:2])
        return codes["GOAL_OUTSIDE_MAP" if bool(on_map) else "START_OUTSIDE_MAP"]
    for kind, name in _NAMES:
        if isinstance(error, kind):
            return codes[name]
    return codes["UNKNOWN"]
