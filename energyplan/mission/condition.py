"""Where the robot stands on its way: charge, time and payload, and what it did so far."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from energyplan.mission.energy import Estimate
from energyplan.mission.legs import Leg
from energyplan.path import FloatArray

_ROUNDING = 1e-9
_INSTANT = 1e-6


class Charge(NamedTuple):
    """The battery at one instant.

    Parameters
    ----------
    soc : float
        State of charge.
    polarisation : float
        Voltage of its RC pair [V].
    failure : str
        Why it gave up on the way; ``"none"`` if it did not.
    instant, load : float
        When it gave up [s], and under which power [W].
    """

    soc: float
    polarisation: float = 0.0
    failure: str = "none"
    instant: float = np.inf
    load: float = 0.0


@dataclass(frozen=True)
class Piece:
    """A stretch of the mission: a drive, a stay or a charge.

    Parameters
    ----------
    kind : {"drive", "work", "wait", "charge"}
        What the robot does.
    goal : int
        Node at its end.
    t : ndarray, shape (n,)
        Time [s].
    power : ndarray, shape (n,)
        Power from each time to the next [W]; the last value repeats.
    soc, soc_lower : ndarray, shape (n,)
        State of charge, expected and at the bound.
    leg : Leg or None
        The drive.
    """

    kind: str
    goal: int
    t: FloatArray
    power: FloatArray
    soc: FloatArray
    soc_lower: FloatArray
    leg: Leg | None = None


@dataclass(frozen=True)
class Condition:
    """Where the robot stands.

    Parameters
    ----------
    node : int
        Place.
    payload : float
        Payload [kg].
    time : float
        Time as expected [s].
    lateness : ndarray, shape (n,)
        How the time changes with each shared unknown [s].
    spent, total : Estimate
        Energy since the last charge as the battery feels it, what is open about the battery
        included, and energy in all.
    origin : tuple of float
        State of charge and time after the last charge.
    stretches : tuple of Estimate
        What was spent between one charge and the next, so far.
    expected, worst : Charge
        The battery as expected, and where the energy is at its bound.
    pieces : tuple of Piece
        What it did so far.
    """

    node: int
    payload: float
    time: float
    lateness: FloatArray
    spent: Estimate
    total: Estimate
    origin: tuple[float, float]
    expected: Charge
    worst: Charge
    pieces: tuple[Piece, ...] = ()
    stretches: tuple[Estimate, ...] = ()

    @property
    def time_spread(self) -> float:
        """Standard deviation of the time [s]."""
        return float(np.linalg.norm(self.lateness))


class Attempt(NamedTuple):
    """What comes of a task.

    Parameters
    ----------
    reason : str
        ``"none"`` if it can be done, else ``"no_path"``, ``"motor"``, ``"battery"``, ``"late"``
        or ``"payload"``.
    after : Condition
        When it is done; where the attempt ended if it cannot be.
    safe : Condition
        At the nearest safe place after it.
    detail : str
        Why not, in one sentence.
    begin : float
        When it begins at the bound [s].
    """

    reason: str
    after: Condition
    safe: Condition
    detail: str = ""
    begin: float = np.nan


def as_good(one: Condition, other: Condition) -> bool:
    """Tell whether a condition is as good as another at the same place in every respect."""
    return (
        one.total.mean <= other.total.mean + _ROUNDING
        and one.time <= other.time + _INSTANT
        and one.time_spread <= other.time_spread + _INSTANT
        and one.worst.soc >= other.worst.soc - _ROUNDING
        and one.payload == other.payload
        and one.node == other.node
    )
