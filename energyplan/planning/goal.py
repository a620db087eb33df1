"""Where a plan may end: a pose, a place at any heading, either way round, or within a radius."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import copysign, cos, hypot, pi, sin, sqrt
from typing import Any

import numpy as np

from energyplan.errors import InvalidInputError
from energyplan.path import FloatArray, Pose, as_pose, parse_pose, wrap_angle
from energyplan.records import check_fields, described

HEADINGS = ("given", "either", "any")
"""How the heading at a goal is wanted: as given, that or its opposite, or any."""

ARRIVED = 1e-6  # how far from where it should a path may begin and end [m], [rad]: rounding


@dataclass(frozen=True)
class Goal:
    """Where a plan may end.

    A pose as such is a goal too, and so is a pair ``(x, y)``, at any heading; `PlanningProblem`
    takes either, and a list of goals, of which the plan reaches the one that costs least.

    Parameters
    ----------
    x, y : float
        The place of the body frame [m].
    yaw : float, optional
        The heading [rad]; any where left out.
    heading : {"given", "either", "any"}, optional
        Whether the heading is as given, that or its opposite, or any.
    radius : float
        How far from the place the plan may end [m].

    Raises
    ------
    InvalidInputError
        If a number is not finite, the radius is negative, or a heading is wanted and none given.

    Examples
    --------
    >>> Goal(4.0, 2.0).heading
    'any'
    >>> Goal(4.0, 2.0, 0.0, heading="either").reached_by((4.0, 2.0, 3.141592653589793))
    True
    """

    x: float
    y: float
    yaw: float | None = None
    heading: str = ""
    radius: float = 0.0

    def __post_init__(self) -> None:
        check_fields(self, InvalidInputError)
        heading = self.heading or ("any" if self.yaw is None else "given")
        if heading not in HEADINGS:
            raise InvalidInputError(
                f"the heading of a goal is {heading!r}; give one of {', '.join(HEADINGS)}"
            )
        if not 0.0 <= self.radius < np.inf:
            raise InvalidInputError(
                f"the radius of a goal is {self.radius}; give a number of 0 or more [m]"
            )
        if heading != "any" and self.yaw is None:
            raise InvalidInputError(
                f"the heading of the goal ({self.x:g}, {self.y:g}) is to be {heading}, and no yaw "
                "is given; give one, or the heading any"
            )
        pose = as_pose((self.x, self.y, self.yaw or 0.0), "the goal")
        object.__setattr__(self, "x", pose.x)
        object.__setattr__(self, "y", pose.y)
        object.__setattr__(self, "radius", float(self.radius))
        object.__setattr__(self, "heading", heading)
        object.__setattr__(self, "yaw", None if heading == "any" else pose.yaw)

    @property
    def headings(self) -> tuple[float, ...]:
        """The headings at which it may be reached [rad]; none where all are allowed."""
        if self.yaw is None:
            return ()
        return (self.yaw, self.yaw + pi) if self.heading == "either" else (self.yaw,)

    @property
    def pose(self) -> Pose | None:
        """The only pose that it consists of, if it is one."""
        single = self.heading == "given" and self.radius == 0.0 and self.yaw is not None
        return Pose(self.x, self.y, float(self.yaw or 0.0)) if single else None

    def reached_by(self, pose: Sequence[float]) -> bool:
        """Return whether a pose is one of those at which a plan may end."""
        x, y, yaw = pose
        if not hypot(x - self.x, y - self.y) <= self.radius + ARRIVED:
            return False
        off = [abs(float(wrap_angle(yaw - other))) for other in self.headings]
        return not off or min(off) <= ARRIVED

    def samples(self, headings: int, around: int, toward: float = 0.0) -> FloatArray:
        """Return poses of it, shape (n, 3): its place, and so many on the edge of its circle.

        Where all headings are allowed so many are used, from one on [rad].
        """
        yaws = self.headings or tuple(toward + 2.0 * pi * k / headings for k in range(headings))
        places = [(self.x, self.y)]
        if self.radius > 0.0:
            for k in range(around):
                angle = toward + 2.0 * pi * k / around
                places.append(
                    (self.x + self.radius * cos(angle), self.y + self.radius * sin(angle))
                )
        return np.array([(x, y, yaw) for x, y in places for yaw in yaws])

    def nearest(self, pose: Pose) -> Pose:
        """Return the pose of it that is nearest to another, the place before the heading."""
        away = hypot(pose.x - self.x, pose.y - self.y)
        part = min(self.radius / away, 1.0) if away > 0.0 else 0.0
        yaw = min(
            self.headings or (pose.yaw,), key=lambda one: abs(float(wrap_angle(one - pose.yaw)))
        )
        return Pose(self.x + part * (pose.x - self.x), self.y + part * (pose.y - self.y), yaw)

    def first_from(self, pose: Pose) -> FloatArray:
        """Return the poses of it nearest to another, and where that first is straight ahead."""
        near = self.nearest(pose)
        found = [(near.x, near.y, yaw) for yaw in self.headings or (pose.yaw,)]
        c, s = cos(pose.yaw), sin(pose.yaw)
        dx, dy = self.x - pose.x, self.y - pose.y
        ahead, aside = c * dx + s * dy, c * dy - s * dx
        if self.yaw is None and abs(aside) < self.radius < hypot(dx, dy):
            ahead -= copysign(sqrt(self.radius**2 - aside**2), ahead)
            found.append((pose.x + c * ahead, pose.y + s * ahead, pose.yaw))
        return np.array(found)

    def describe(self) -> str:
        """Say what it is."""
        where = f"({self.x:g}, {self.y:g})"
        if self.yaw is None:
            where += " at any heading"
        else:
            way = " either way round" if self.heading == "either" else ""
            where = f"({self.x:g}, {self.y:g}, {np.degrees(self.yaw):.1f} deg){way}"
        return where + (f" within {self.radius:g} m" if self.radius else "")


def as_goals(value: Any, heading: str = "", radius: float = 0.0) -> tuple[Goal, ...]:
    """Return the goals that a value stands for, of which one is to be reached.

    Parameters
    ----------
    value : Goal, array_like, str, mapping, or a sequence of these
        A goal; a pose x, y, yaw or a place x, y, as numbers or as the text ``X,Y,YAW`` or ``X,Y``;
        a mapping with the parameters of `Goal`; or several of them.
    heading : str
        The heading of those that do not name one; see `Goal`.
    radius : float
        The radius of those that do not name one [m].

    Raises
    ------
    InvalidInputError
        If it is none of these.

    Examples
    --------
    >>> [goal.describe() for goal in as_goals(["4,2", (1, 2, 0.0)])]
    ['(4, 2) at any heading', '(1, 2, 0.0 deg)']
    """
    if isinstance(value, Sequence | np.ndarray) and not isinstance(value, str):
        texts = [one for one in value if isinstance(one, str)]
        pose = len(texts) == len(value) in (2, 3) and not any("," in text for text in texts)
        if (
            len(value)
            and not pose
            and all(isinstance(one, Goal | str | Mapping) or np.ndim(one) for one in value)
        ):
            return tuple(goal for one in value for goal in as_goals(one, heading, radius))
    if isinstance(value, Goal):
        return (value,)
    if isinstance(value, Mapping):
        known = {"heading": heading, "radius": radius, **value}
        try:
            return (Goal(**known),)
        except TypeError:
            raise InvalidInputError(
                f"the goal {described(value)} has other keys than x, y, yaw, heading and radius"
            ) from None
    return (_goal_at(value, heading, radius),)


def _goal_at(value: Any, heading: str, radius: float) -> Goal:
    """Return the goal that a pose or a place stands for."""
    texts = value.split(",") if isinstance(value, str) else value
    try:
        count = len(texts)
    except TypeError:
        count = 0
    if count not in (2, 3) and not isinstance(value, str):
        as_pose(value, "goal")
    if count not in (2, 3):
        raise InvalidInputError(
            f"goal {described(value)} is neither X,Y,YAW nor X,Y; write it like 2.0,3.5,90deg, or "
            "2.0,3.5 for any heading"
        )
    if count == 2:
        if heading not in ("", "any"):
            if heading != "either":
                Goal(0.0, 0.0, 0.0, heading)  # which says what a heading may be
            raise InvalidInputError(
                f"goal {described(value)} has no yaw, and its heading is to be {heading}; write "
                "X,Y,YAW, or give the heading any"
            )
        texts = [*texts, 0.0]
    if any(isinstance(one, str) for one in texts):
        pose = parse_pose([str(one) for one in texts])
    else:
        pose = as_pose(texts, "goal")
    return Goal(pose.x, pose.y, pose.yaw if count == 3 else None, heading, radius)


def only_pose(goals: Sequence[Goal]) -> Pose | None:
    """Return the pose that some goals come to, if they do."""
    return goals[0].pose if len(goals) == 1 else None
