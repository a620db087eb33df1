"""What is told about a drive as it happens."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from energyplan.mission import MissionReport
from energyplan.path import Pose
from energyplan.power import PowerModel


@dataclass(frozen=True)
class Trouble:
    """Something that could not be used."""

    place: str  # where, such as ``"line 12"``
    reason: str  # what was wrong, and what was done
    count: int = 1  # how often it came


@dataclass(frozen=True)
class Learned:
    """The model as it is known now."""

    t: float  # time [s]
    model: PowerModel  # the model of the ground at hand, with covariance
    samples: int  # samples so far


@dataclass(frozen=True)
class Changed:
    """The ground changed."""

    t: float  # when it was noticed [s]
    onset: float  # about when it happened [s]
    statistic: float  # how clear it is
    before: PowerModel  # the model up to then


@dataclass(frozen=True)
class Done:
    """A task was done."""

    t: float  # time [s]
    task: str  # its name


@dataclass(frozen=True)
class Reassessed:
    """The rest of the mission, as it looks now."""

    t: float  # time [s]
    pose: Pose  # where the robot is
    soc: float  # state of charge
    done: tuple[str, ...]  # tasks that are done
    report: MissionReport | None  # the rest of the mission


@dataclass(frozen=True)
class Ended:
    """The log has ended, or nobody wants to know more."""

    samples: int  # samples that were learned from
    changes: int  # changes of the ground
    models: tuple[PowerModel, ...]  # what was learned
    set_aside: Mapping[str, int] = field(default_factory=dict)


Event = Trouble | Learned | Changed | Done | Reassessed | Ended
