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
    """Error codes of nav2_msgs/action/ComputePathToPose."""

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
    """Error codes of nav2_msgs/action/ComputePathThroughPoses."""

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
    """Return the error codes of the action that a goal belongs to."""
    return ThroughPosesError if hasattr(request, "goals") else ToPoseError


def error_code(
    error: EnergyPlanError, codes: Codes, problem: PlanningProblem | None = None
) -> ToPoseError | ThroughPosesError:
    """Return the code of Nav2's planner server for an error of the library."""
    if isinstance(error, OutsideMapError) and problem is not None:
        on_map = problem.terrain.obstacles.inside(problem.start[:2])
        return codes["GOAL_OUTSIDE_MAP" if bool(on_map) else "START_OUTSIDE_MAP"]
    for kind, name in _NAMES:
        if isinstance(error, kind):
            return codes[name]
    return codes["UNKNOWN"]
