"""What is told about a drive as it happens."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from energyplan.mission import MissionReport
from energyplan.path import Pose
from energyplan.power import PowerModel


@dataclass(frozen=True)
class Trouble:
    """Something that could not be used.

    Parameters
    ----------
    place : str
        Where, such as ``"line 12"``.
    reason : str
        What was wrong, and what was done.
    count : int
        How often it came. A kind of trouble is told when it comes first; how often it came again,
        with the next report.
    """

    place: str
    reason: str
    count: int = 1


@dataclass(frozen=True)
class Learned:
    """The model as it is known now.

    Parameters
    ----------
    t : float
        Time [s].
    model : PowerModel
        The model of the ground at hand, with covariance.
    samples : int
        Samples so far.
    """

    t: float
    model: PowerModel
    samples: int


@dataclass(frozen=True)
class Changed:
    """The ground changed.

    Parameters
    ----------
    t : float
        When it was noticed [s].
    onset : float
        About when it happened [s].
    statistic : float
        How clear it is: chi-squared, with one degree of freedom a coefficient.
    before : PowerModel
        The model up to then.
    """

    t: float
    onset: float
    statistic: float
    before: PowerModel


@dataclass(frozen=True)
class Done:
    """A task was done.

    Parameters
    ----------
    t : float
        Time [s].
    task : str
        Its name.
    """

    t: float
    task: str


@dataclass(frozen=True)
class Reassessed:
    """The rest of the mission, as it looks now.

    Parameters
    ----------
    t : float
        Time [s].
    pose : Pose
        Where the robot is.
    soc : float
        State of charge.
    done : tuple of str
        Tasks that are done.
    report : MissionReport or None
        The rest of the mission; None where all tasks are done.
    """

    t: float
    pose: Pose
    soc: float
    done: tuple[str, ...]
    report: MissionReport | None


@dataclass(frozen=True)
class Ended:
    """The log has ended, or nobody wants to know more.

    Parameters
    ----------
    samples : int
        Samples that were learned from.
    set_aside : mapping of str to int
        Samples and lines that could not be used, by reason.
    changes : int
        Changes of the ground.
    models : tuple of PowerModel
        What was learned: a model for each ground of the map that was driven on.
    """

    samples: int
    changes: int
    models: tuple[PowerModel, ...]
    set_aside: Mapping[str, int] = field(default_factory=dict)


Event = Trouble | Learned | Changed | Done | Reassessed | Ended
