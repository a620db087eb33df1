"""What all drives so far tell of a robot, as the loop learns it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from energyplan.diagnosis import diagnose, result
from energyplan.errors import DriveLogError, NotIdentifiableError
from energyplan.fit import identify
from energyplan.logs import DriveLog
from energyplan.physics.design import Explanation
from energyplan.power import PowerModel
from energyplan.vehicle import Vehicle

SHORTEST = 16.0
"""Shortest drive that diagnosis learns from [s]."""
DIAGNOSED = 36.0
"""Driving in which effects are looked for; less shows too few manoeuvres [s]."""
LIKELY = 0.02
"""Probability from which an explanation counts where the next drive is designed."""


@dataclass(frozen=True)
class Found:
    """An effect in the model of the next round: its name, size, standard error and unit."""

    name: str
    value: float
    std_error: float
    unit: str


class Learned(NamedTuple):
    """A model of all drives so far, the effects in it, and what else may explain them.

    The model is None where nothing could be learned; the note then says why.
    """

    model: PowerModel | None
    effects: tuple[Found, ...]
    explanations: tuple[Explanation, ...] = ()
    note: str = ""


def learn(logs: Sequence[DriveLog], vehicle: Vehicle) -> Learned:
    """Diagnose all drives so far, all of each of them.

    None is held out: the next round is the test, whose energy is predicted before it is driven.
    Drives under `SHORTEST` show no effects. With less than `DIAGNOSED` of longer ones,
    only the paper's parameters are identified, from all.
    """
    try:
        return _learned(logs, vehicle)
    except (NotIdentifiableError, DriveLogError) as reason:
        return Learned(None, (), note=f"nothing learned: {reason}")


def _learned(logs: Sequence[DriveLog], vehicle: Vehicle) -> Learned:
    long = [log for log in logs if log.duration >= SHORTEST]
    total = sum(log.duration for log in long)
    if total < DIAGNOSED:
        model = identify(logs, vehicle, method="huber").model
        note = (
            f"{total:.0f} s of driving are too short to look for effects; "
            "resistance and friction alone were identified"
        )
        return Learned(model, (), note=note)
    told = diagnose(long, [log.segment(float(log.t[0]), np.inf) for log in long], vehicle)
    found = tuple(Found(e.name, e.value, e.std_error, e.unit) for e in told.effects)
    most = told.explanations[0].probability
    likely = [e for e in told.explanations if e.probability > LIKELY * most]
    return Learned(told.model, found, tuple(map(_explanation, likely)))


def _explanation(found: result.Explanation) -> Explanation:
    model = found.model
    sizes = {term.name: model.coefficient(term.name) for term in model.terms}
    return Explanation(found.effects, found.probability, sizes)
