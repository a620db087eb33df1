"""What all drives so far tell of a robot, as the loop learns it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

from energyplan.diagnosis import diagnose, result
from energyplan.errors import DriveLogError, NotIdentifiableError
from energyplan.fit import identify
from energyplan.logs import DriveLog
from energyplan.physics.design import Explanation
from energyplan.power import PowerModel
from energyplan.vehicle import Vehicle

SHORTEST = 18.0
"""Shortest drive that diagnosis learns from, with some to spare [s]."""
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
    """Diagnose all drives so far: the last part of each is held out, the rest is learned from.

    Where there is too little to hold any of it out, only the paper's parameters are identified.

    Parameters
    ----------
    logs : sequence of DriveLog
        The drives.
    vehicle : Vehicle
        The vehicle.

    Returns
    -------
    Learned
        Model and effects.
    """
    try:
        return _learned(logs, vehicle)
    except (NotIdentifiableError, DriveLogError) as reason:
        return Learned(None, (), note=f"nothing learned: {reason}")


def _learned(logs: Sequence[DriveLog], vehicle: Vehicle) -> Learned:
    train: list[DriveLog] = []
    held: list[DriveLog] = []
    for log in logs:
        parts = int(log.duration // SHORTEST)
        blocks = log.blocks(log.duration / parts) if parts > 1 else [log]
        train += blocks[:-1] or blocks
        held += blocks[-1:] if parts > 1 else []
    if not held and len(train) > 1:
        held = [train.pop()]
    if held:
        told = diagnose(train, held, vehicle)
        found = tuple(Found(e.name, e.value, e.std_error, e.unit) for e in told.effects)
        likely = [e for e in told.explanations if e.probability >= LIKELY]
        return Learned(told.model, found, tuple(map(_explanation, likely)))
    model = identify(train, vehicle, method="huber").model
    note = (
        f"one drive of {train[0].duration:.0f} s is too short to look for effects; "
        "its own resistance and friction were identified"
    )
    return Learned(model, (), note=note)


def _explanation(found: result.Explanation) -> Explanation:
    model = found.model
    sizes = {term.name: model.coefficient(term.name) for term in model.terms}
    return Explanation(found.effects, found.probability, sizes)
