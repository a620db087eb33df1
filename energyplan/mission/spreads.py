"""How far off the plain numbers of a mission usually are."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from energyplan.mission.checks import require
from energyplan.power import USUAL_RUN_SPREAD


@dataclass(frozen=True)
class Spreads:
    """Standard deviations of what a mission takes as a number.

    The defaults are round figures for robots that nobody has measured; what is known better is
    better said. A battery that is not a `Battery` has no health and no temperature of its own:
    all its uncertainty counts as that of the capacity.

    Parameters
    ----------
    soc : float
        State of charge that a gauge shows, at the start and after charging, absolute. Gauges that
        count charge drift by 1 to 5 % between full charges.
    capacity : float
        Capacity of the battery, relative. New stationary lead-acid blocks must hold 95 % of what
        is printed on them (IEC 60896-21): half of that is taken.
    health : float
        Health of the battery, absolute. Estimates of it are good to some 5 %.
    temperature : float
        Temperature of the battery [K]: that of the pack against that of the air.
    power : float
        Power of each tool, relative; for tasks that do not say their own.
    dwell : float
        Duration of each task, relative; for tasks that do not say their own.
    run : float
        Energy of all driving from run to run, relative, for models that do not bring it: what
        diagnosis found is in ``PowerModel.residual.run_spread``.
    speed : float
        Time of all driving from run to run, relative: robots slow down for people, and followers
        lag. It makes arrivals uncertain; what it takes in energy is part of `run`.
    waiting : float
        Waiting at each task, relative; 1 is that of waiting times that come at random
        (exponential).

    Raises
    ------
    MissionError
        If a value is negative or not finite.

    Examples
    --------
    >>> Spreads(soc=0.03, run=0.08).dwell  # what is not given has its default
    0.1
    """

    soc: float = 0.02
    capacity: float = 0.025
    health: float = 0.05
    temperature: float = 3.0
    power: float = 0.1
    dwell: float = 0.1
    run: float = USUAL_RUN_SPREAD
    speed: float = 0.05
    waiting: float = 1.0

    def __post_init__(self) -> None:
        for item in fields(self):
            value = getattr(self, item.name)
            require(
                np.isfinite(value) and value >= 0,
                f"the spread of {item.name} is {value}; give 0 or more",
                "spreads", item.name,
            )  # fmt: skip

    @classmethod
    def none(cls) -> Spreads:
        """Return spreads for numbers that are exact."""
        return cls(**dict.fromkeys((item.name for item in fields(cls)), 0.0))
