"""What a robot does from its start to its end: segments in time, and the stops that they make."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Literal

import numpy as np

from energyplan.mission.energy import Consumption, Estimate
from energyplan.path import FloatArray, Path, Pose, Trajectory

_INSTANT = 0.5
"""Shortest wait that the timetable lists [s]."""

Kind = Literal["start", "drive", "wait", "work", "charge", "end"]
StopKind = Literal["start", "task", "charge", "end"]


@dataclass(frozen=True)
class Leg:
    """A drive from one place to another."""

    path: Path  # its route
    trajectory: Trajectory | None  # when the robot is where
    consumption: Consumption  # what it takes
    trouble: str = ""
    detail: str = ""  # what the trouble is

    @property
    def energy(self) -> Estimate:
        """Its energy."""
        return self.consumption.energy

    @property
    def duration(self) -> float:
        """Duration [s]."""
        return 0.0 if self.trajectory is None else self.trajectory.duration


@dataclass(frozen=True, eq=False)
class Segment:
    """A stretch of a mission: a drive, a stay or a charge; an instant at its start and its end."""

    kind: Kind  # what the robot does
    start: str  # place where it begins
    goal: str  # place where it ends
    pose: Pose  # pose at the end
    t: FloatArray  # (n,): time [s]
    power: FloatArray  # (n,): power at the battery from each time to the next [W]
    soc: FloatArray  # (n,): state of charge, as expected
    soc_lower: FloatArray  # (n,): the same at the bound
    leg: Leg | None = None  # the drive

    @property
    def departure(self) -> float:
        """Time of its begin [s]."""
        return float(self.t[0])

    @property
    def arrival(self) -> float:
        """Time of its end [s]."""
        return float(self.t[-1])

    @property
    def trajectory(self) -> Trajectory:
        """The drive, from time 0."""
        assert self.leg is not None and self.leg.trajectory is not None
        return self.leg.trajectory

    @property
    def energy(self) -> float:
        """Energy at the battery, as expected [J]; negative while charging."""
        drawn = float(self.power[:-1] @ np.diff(self.t))
        return drawn if self.leg is None else self.leg.energy.mean

    @property
    def poses(self) -> FloatArray:
        """Pose at each time, shape (n, 3)."""
        if self.leg is None:
            return np.tile(self.pose, (len(self.t), 1))
        drive = self.trajectory
        return np.column_stack([drive.x, drive.y, drive.yaw])


@dataclass(frozen=True)
class Stop:
    """A place at which the robot stops, and when."""

    name: str  # the place
    kind: StopKind  # purpose of the stop
    pose: Pose  # where [m], [rad]
    arrival: float  # when it gets there [s]
    departure: float  # when it leaves [s]
    soc: float  # state of charge on leaving, as expected
    soc_lower: float  # the same at the bound


@dataclass(frozen=True)
class Activity:
    """A line of a mission's timetable."""

    start: float  # when it begins [s]
    end: float  # when it ends [s]
    kind: Kind  # what the robot does
    place: str  # where; of a drive, from where to where
    soc_start: float  # state of charge before it, as expected
    soc_end: float  # state of charge after it, as expected


@dataclass(frozen=True)
class ChargerReport:
    """How a charger is used."""

    name: str  # the charger
    visits: int  # how often the robot charges there
    duration: float  # how long in all [s]
    energy: float  # energy that it supplies, as expected [J]


@dataclass(frozen=True)
class Timeline:
    """The mission over time; arrays of one shape."""

    t: FloatArray  # (n,): time [s]
    x: FloatArray  # (n,): x of the pose [m]
    y: FloatArray  # (n,): y of the pose [m]
    yaw: FloatArray  # (n,): heading of the pose [rad]
    power: FloatArray  # (n,): power at the battery from each time to the next [W]
    soc: FloatArray  # (n,): state of charge, as expected
    soc_lower: FloatArray  # (n,): the same at the bound

    @property
    def soc_upper(self) -> FloatArray:
        """As far above the expected state of charge as the bound is below."""
        return np.minimum(2 * self.soc - self.soc_lower, 1.0)


def stops(trip: Sequence[Segment]) -> tuple[Stop, ...]:
    """Return the start, the tasks and charges in the order of their times, and the end."""
    kinds: dict[Kind, StopKind] = {
        "start": "start", "work": "task", "charge": "charge", "end": "end"
    }  # fmt: skip
    found = []
    for _, parts in groupby(trip, lambda part: (part.goal, part.kind in ("start", "end"))):
        stays = [part for part in parts if part.kind != "drive"]
        for part in stays:
            if kind := kinds.get(part.kind):
                begin = stays[0].departure if kind == "task" else part.departure
                soc = float(part.soc[-1]), float(part.soc_lower[-1])
                found.append(Stop(part.goal, kind, part.pose, begin, part.arrival, *soc))
    return tuple(found)


def activities(trip: Sequence[Segment]) -> tuple[Activity, ...]:
    """Return what the robot does from when to when, in the order of time."""
    found = []
    for kind, group in groupby(trip, lambda part: part.kind):
        parts = list(group)
        waited = parts[-1].arrival - parts[0].departure
        if kind in ("start", "end") or (kind == "wait" and waited <= _INSTANT):
            continue
        spans = [(parts[0], parts[-1])] if kind == "wait" else [(part, part) for part in parts]
        for first, last in spans:
            place = f"{first.start} to {first.goal}" if kind == "drive" else first.goal
            soc = float(first.soc[0]), float(last.soc[-1])
            found.append(Activity(first.departure, last.arrival, kind, place, *soc))
    return tuple(found)


def uses(trip: Sequence[Segment], chargers: Sequence[str]) -> tuple[ChargerReport, ...]:
    """Return how each charger is used."""
    charges = [part for part in trip if part.kind == "charge"]
    return tuple(
        ChargerReport(
            name, len(here), sum(part.arrival - part.departure for part in here),
            -sum(part.energy for part in here),
        )
        for name in chargers
        for here in [[part for part in charges if part.goal == name]]
    )  # fmt: skip


def timeline(trip: Sequence[Segment]) -> Timeline:
    """Return a trip over time."""
    x, y, yaw = np.concatenate([part.poses for part in trip]).T
    t, power, soc, low = (
        np.concatenate([getattr(part, name) for part in trip])
        for name in ("t", "power", "soc", "soc_lower")
    )
    return Timeline(t, x, y, yaw, power, soc, low)
