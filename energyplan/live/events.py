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

    Examples
    --------
    >>> trouble = Trouble("line 12", "5 cells, where 6 are needed", count=3)
    >>> f"{trouble.place}: {trouble.reason} ({trouble.count} times)"
    'line 12: 5 cells, where 6 are needed (3 times)'
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

    Examples
    --------
    >>> from energyplan.power import PowerModel
    >>> event = Learned(10.0, PowerModel.preset("quadriga:full:marble"), samples=100)
    >>> round(event.model.coefficient("slip_friction"), 3)
    0.431
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

    Examples
    --------
    >>> from energyplan.power import PowerModel
    >>> event = Changed(61.0, 58.5, 44.0, PowerModel.preset("quadriga:full:marble"))
    >>> event.t - event.onset  # noticed so much later [s]
    2.5
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

    Examples
    --------
    >>> Done(95.0, "gate").task
    'gate'
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

    Examples
    --------
    >>> from energyplan.path import Pose
    >>> Reassessed(60.0, Pose(3.0, 1.0, 0.0), soc=0.72, done=("gate",), report=None).done
    ('gate',)
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

    Examples
    --------
    >>> Ended(samples=5900, changes=0, models=(), set_aside={"no number": 3}).set_aside
    {'no number': 3}
    """

    samples: int
    changes: int
    models: tuple[PowerModel, ...]
    set_aside: Mapping[str, int] = field(default_factory=dict)


Event = Trouble | Learned | Changed | Done | Reassessed | Ended
