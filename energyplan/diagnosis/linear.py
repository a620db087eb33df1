"""A drive's power about given coefficients, and its derivatives (private).

`energyplan.fit.identifiability.linearise` answers the same for one model and one motion. Selection
asks hundreds of times for the same drives and terms, so that here the force of each term is
computed once a drive and kept; only the losses are evaluated anew.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from energyplan.diagnosis.windows import Drive, field_of, held_field_of
from energyplan.path import FloatArray
from energyplan.power import DRIVE_LOSS, REGENERATION_LOSS, Sides, Term
from energyplan.vehicle import Vehicle

_STEP = 1e-4


@dataclass(frozen=True)
class Linear:
    """Power of a drive and its derivatives.

    Parameters
    ----------
    power : ndarray, shape (n,)
        Predicted power [W].
    columns : ndarray, shape (n, k)
        Its derivative by each coefficient [W per unit].
    """

    power: FloatArray
    columns: FloatArray


def is_lossy(drive: Drive, terms: Sequence[Term]) -> bool:
    """Tell whether the power is not linear in the coefficients."""
    return drive.battery or any(term.kind == "loss" for term in terms)


def linearise(
    drive: Drive,
    vehicle: Vehicle,
    terms: Sequence[Term],
    values: FloatArray,
    wanted: Sequence[int] | None = None,
) -> Linear:
    """Linearise the power of a drive about coefficients.

    Parameters
    ----------
    drive : Drive
        The drive.
    vehicle : Vehicle
        The vehicle; its efficiencies count where power was measured at the battery.
    terms : sequence of Term
        The terms.
    values : ndarray, shape (k,)
        Their coefficients.
    wanted : sequence of int, optional
        Terms to differentiate by; all where not given.

    Returns
    -------
    Linear
        Power, and one column for each wanted term.
    """
    motion, held = drive.motion, drive.held
    names = {term.name for term in terms}
    losses = [
        (term, float(value)) for term, value in zip(terms, values, strict=True)
        if term.kind == "loss"
    ]  # fmt: skip
    if drive.battery:
        known = (
            (DRIVE_LOSS, 1 / vehicle.drive_efficiency - 1),
            (REGENERATION_LOSS, 1 - vehicle.regen_efficiency),
        )
        losses += [(term, value) for term, value in known if term.name not in names and value > 0]
    total = Sides(np.zeros(motion.shape), np.zeros(motion.shape))
    for term, value in zip(terms, values, strict=True):
        if term.kind == "force":
            total = total + held_field_of(term, drive, vehicle) * float(value)

    def lost(forces: Sides) -> FloatArray:
        power = np.zeros(motion.shape)
        for term, value in losses:
            if value != 0.0:
                power = power + value * term.function(held, vehicle, forces, **term.params).total
        return np.asarray(power)

    losing = any(value != 0.0 for _, value in losses)
    columns = []
    for k in range(len(terms)) if wanted is None else wanted:
        term = terms[k]
        if term.kind == "loss":
            columns.append(term.function(held, vehicle, total, **term.params).total)
        elif term.kind == "power":
            columns.append(field_of(term, drive, vehicle))
        else:
            force = field_of(term, drive, vehicle)
            own = force.left * motion.v_left + force.right * motion.v_right
            if losing:
                acting = held_field_of(term, drive, vehicle)
                step = _step(acting, total)
                ahead, behind = lost(total + acting * step), lost(total + acting * -step)
                own = own + (ahead - behind) / (2 * step)
            columns.append(own)
    power = lost(total)
    for term, value in zip(terms, values, strict=True):
        field = None if term.kind == "loss" else field_of(term, drive, vehicle)
        if isinstance(field, Sides):
            field = field.left * motion.v_left + field.right * motion.v_right
        if field is not None:
            power = power + value * field
    table = np.column_stack(columns) if columns else np.zeros((len(drive.t), 0))
    return Linear(np.asarray(power), table)


def _step(force: Sides, total: Sides) -> float:
    """Step of a coefficient that moves the forces by a small part of what they are."""
    unit = max(float(np.max(np.abs(force.left))), float(np.max(np.abs(force.right))), 1e-12)
    whole = max(float(np.max(np.abs(total.left))), float(np.max(np.abs(total.right))), 1.0)
    return _STEP * whole / unit
