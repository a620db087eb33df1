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
    """The battery at one instant."""

    soc: float  # state of charge
    polarisation: float = 0.0  # voltage of its RC pair [V]
    failure: str = "none"  # why it gave up on the way
    instant: float = np.inf  # when it gave up [s], and under which power [W]
    load: float = 0.0  # when it gave up [s], and under which power [W]


@dataclass(frozen=True)
class Piece:
    """A stretch of the mission: a drive, a stay or a charge."""

    kind: str  # what the robot does
    goal: int  # node at its end
    t: FloatArray  # (n,): time [s]
    power: FloatArray  # (n,): power from each time to the next [W]
    soc: FloatArray  # (n,): state of charge, expected and at the bound
    soc_lower: FloatArray  # (n,): state of charge, expected and at the bound
    leg: Leg | None = None  # the drive


@dataclass(frozen=True)
class Condition:
    """Where the robot stands."""

    node: int  # place
    payload: float  # payload [kg]
    time: float  # time as expected [s]
    lateness: FloatArray  # (n,): how the time changes with each shared unknown [s]
    spent: Estimate
    total: Estimate
    origin: tuple[float, float]  # state of charge and time after the last charge
    expected: Charge  # the battery as expected, and where the energy is at its bound
    worst: Charge  # the battery as expected, and where the energy is at its bound
    pieces: tuple[Piece, ...] = ()  # what it did so far
    stretches: tuple[Estimate, ...] = ()  # what was spent between one charge and the next, so far

    @property
    def time_spread(self) -> float:
        """Standard deviation of the time [s]."""
        return float(np.linalg.norm(self.lateness))


class Attempt(NamedTuple):
    """What comes of a task."""

    reason: str
    after: Condition  # when it is done
    safe: Condition  # at the nearest safe place after it
    detail: str = ""  # why not, in one sentence
    begin: float = np.nan  # when it begins at the bound [s]


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
