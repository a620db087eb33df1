"""A drive's power about given coefficients, and its derivatives (private).

Selection asks hundreds of times for the same drives and terms, so that the force of each term is
computed once a drive and kept; only the losses are evaluated anew.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from energyplan.fit.drives.columns import columns_of, field_of, of_equations
from energyplan.fit.drives.drive import Drive
from energyplan.fit.drives.late import ON_TIME
from energyplan.fit.drives.preload import at_rest, lost_power, preload, straights
from energyplan.motion import Motion
from energyplan.path import FloatArray
from energyplan.power import DRIVE_LOSS, REGENERATION_LOSS, SLIP, PowerModel, Sides, Term
from energyplan.vehicle import Vehicle

_STEP = 1e-4


@dataclass(frozen=True)
class Linear:
    """Power of a drive and its derivatives, as `Drive.observed` shows them."""

    power: FloatArray  # (n, e): predicted power of each equation [W]
    columns: FloatArray  # (n, e, k): its derivative by each coefficient [W per unit]
    odds: float = 0.0


def is_lossy(drive: Drive, terms: Sequence[Term]) -> bool:
    """Tell whether the power is not linear in the coefficients."""
    return drive.battery or any(term.kind == "loss" for term in terms)


def linearise_drive(
    drive: Drive,
    vehicle: Vehicle,
    terms: Sequence[Term],
    values: FloatArray,
    wanted: Sequence[int] | None = None,
) -> Linear:
    """Linearise the power of a drive about coefficients."""
    held = drive.held
    losses = losses_of(drive, vehicle, terms, values)
    total = held_forces(drive, vehicle, terms, values)
    fight = held_by = power = None
    limit = vehicle.slip_moment * slip_limit(terms, values)
    if drive.between is not None and is_lossy(drive, terms):
        fight = preload(drive, drive.between, vehicle, losses, total, limit)
        total = total + fight.forces
    elif drive.fitted and losses:
        power = _power(drive, vehicle, terms, values, losses, total)
        shown = drive.observed(power)[:, 0]
        held_by = straights(drive, vehicle, losses, total, limit, shown)
        if held_by is not None:
            total, power = total + held_by.forces, None
    if power is None:
        power = _power(drive, vehicle, terms, values, losses, total)

    rise = _rise(losses, drive, vehicle, total) if losses else None
    columns, held_apart, limits = [], [], []
    for k in range(len(terms)) if wanted is None else wanted:
        term = terms[k]
        if term.kind == "loss":
            own = of_equations(term.function(held, vehicle, total, **term.params), drive)
        else:
            own = columns_of(term, drive, vehicle)
        apart = own[:, -1]  # what it makes the sides differ by where contacts hold
        if term.kind == "force" and rise is not None:
            acting = field_of(term, drive, vehicle, held=True)
            lost = rise.left * acting.left[:, None] + rise.right * acting.right[:, None]
            own = own + lost
            if fight is not None:
                apart = acting.right * held.v_right - acting.left * held.v_left + lost[:, -1]
        columns.append(own)
        held_apart.append(apart)
        limits.append(vehicle.slip_moment if term.name == SLIP.name else 0.0)
    table = np.stack(columns, axis=-1) if columns else np.zeros((*power.shape, 0))
    if fight is not None:
        if columns:
            apart = np.stack(held_apart, axis=-1)
            table[:, 0] -= fight.followed(apart, np.array(limits))
        known, most = at_rest(drive, power[:, 0], held_loss(vehicle, terms, values, drive))
        power[:, 0] += most
        table[known, 0] = 0.0
    shown = drive.observed(table)
    if held_by is not None:
        return Linear(drive.observed(power), held_by.without(shown), held_by.odds)
    return Linear(drive.observed(power), shown)


def _power(
    drive: Drive,
    vehicle: Vehicle,
    terms: Sequence[Term],
    values: FloatArray,
    losses: Sequence[tuple[Term, float]],
    forces: Sides,
) -> FloatArray:
    """Power in each equation, before a log shows it late, shape (n, equations) [W]."""
    power = np.zeros((len(drive.t), drive.equations))
    if losses:
        power = power + of_equations(lost_power(losses, drive.held, vehicle, forces), drive)
    for term, value in zip(terms, values, strict=True):
        if term.kind != "loss":
            power = power + float(value) * columns_of(term, drive, vehicle)
    return power


def equations_of(model: PowerModel, drive: Drive) -> FloatArray:
    """Return the power of a drive by a model in each equation, as the log shows it [W]."""
    for term in model.terms:
        for name in term.channels:
            drive.motion.channel(name, f"the term {term.name!r}")
    return linearise_drive(drive, model.vehicle, model.terms, model.coefficients, ()).power


def power_of(model: PowerModel, drive: Drive) -> FloatArray:
    """Return the power of a drive by a model, with contacts that hold on a straight [W]."""
    alone = replace(drive, between=None, fitted=False, late=ON_TIME, factor=1.0, hold=None)
    return equations_of(model, alone)[:, 0]


def held_loss(vehicle: Vehicle, terms: Sequence[Term], values: FloatArray, drive: Drive) -> float:
    """Return what losses take at most at rest, where contacts hold all that friction allows [W]."""
    push = np.array(vehicle.slip_moment * slip_limit(terms, values) / drive.motion.icr.slip_track)
    losses = losses_of(drive, vehicle, terms, values)
    still = Motion(np.array(0.0), np.array(0.0), drive.motion.icr)
    return float(lost_power(losses, still, vehicle, Sides(-push, push)).total)


def losses_of(
    drive: Drive, vehicle: Vehicle, terms: Sequence[Term], values: FloatArray
) -> list[tuple[Term, float]]:
    """Return the losses that are there, with their coefficients, known efficiencies included."""
    names = {term.name for term in terms}
    losses = [
        (term, float(value)) for term, value in zip(terms, values, strict=True)
        if term.kind == "loss" and value != 0.0
    ]  # fmt: skip
    if drive.battery:
        known = (
            (DRIVE_LOSS, 1 / vehicle.drive_efficiency - 1),
            (REGENERATION_LOSS, 1 - vehicle.regen_efficiency),
        )
        losses += [(term, value) for term, value in known if term.name not in names and value > 0]
    return losses


def held_forces(drive: Drive, vehicle: Vehicle, terms: Sequence[Term], values: FloatArray) -> Sides:
    """Tread forces of a drive with contacts that hold, without what they hold [N]."""
    total = Sides(np.zeros(drive.motion.shape), np.zeros(drive.motion.shape))
    for term, value in zip(terms, values, strict=True):
        if term.kind == "force":
            total = total + field_of(term, drive, vehicle, held=True) * float(value)
    return total


def slip_limit(terms: Sequence[Term], values: FloatArray) -> float:
    """Return the friction coefficient that bounds what contacts hold."""
    for term, value in zip(terms, values, strict=True):
        if term.name == SLIP.name:
            return max(float(value), 0.0)
    return 0.0


def _rise(
    losses: Sequence[tuple[Term, float]], drive: Drive, vehicle: Vehicle, forces: Sides
) -> Sides:
    """Rise of the losses in each equation with the force of each side, shape (n, equations) each.

    Central differences: exact where losses are linear or quadratic in the forces.
    """
    size = max(float(np.max(np.abs(forces.left))), float(np.max(np.abs(forces.right))), 1.0)
    step = _STEP * size

    def lost(left: float, right: float) -> FloatArray:
        moved = Sides(forces.left + left, forces.right + right)
        return of_equations(lost_power(losses, drive.held, vehicle, moved), drive)

    return Sides(
        (lost(step, 0.0) - lost(-step, 0.0)) / (2 * step),
        (lost(0.0, step) - lost(0.0, -step)) / (2 * step),
    )
