"""Columns of terms on a drive, computed once and kept (private)."""

from __future__ import annotations

from typing import Any

import numpy as np

from energyplan.fit.drives.drive import Drive
from energyplan.path import FloatArray
from energyplan.power import Sides, Term
from energyplan.vehicle import Vehicle

_KEPT = 96  # forces and columns of terms kept a drive


def field_of(term: Term, drive: Drive, vehicle: Vehicle, held: bool = False) -> Any:
    """Return force or power per unit of a term that is no loss, computed once a drive.

    With `held` it is that of contacts that hold.
    """
    key = ("held" if held else "driven", term.name, tuple(term.params.items()), vehicle.slip_moment)
    if key not in drive.fields:
        if len(drive.fields) > _KEPT:
            drive.fields.clear()
        motion = drive.held if held else drive.motion
        drive.fields[key] = term.function(motion, vehicle, **term.params)
    return drive.fields[key]


def column(term: Term, drive: Drive, vehicle: Vehicle) -> FloatArray:
    """Total power per unit of a linear term's coefficient at each sample [W per unit]."""
    value = field_of(term, drive, vehicle)
    if term.kind == "force":
        motion = drive.motion
        return np.asarray(value.left * motion.v_left + value.right * motion.v_right)
    return np.asarray(value.total if isinstance(value, Sides) else value)


def columns_of(term: Term, drive: Drive, vehicle: Vehicle) -> FloatArray:
    """Power per unit of a linear term's coefficient in each equation, shape (n, equations)."""
    key = (drive.equations, term.name, tuple(term.params.items()), vehicle.slip_moment)
    if key not in drive.fields:
        value = field_of(term, drive, vehicle)
        if term.kind == "force":
            motion = drive.motion
            value = Sides(value.left * motion.v_left, value.right * motion.v_right)
        drive.fields[key] = of_equations(value, drive)
    found: FloatArray = drive.fields[key]
    return found


def of_equations(value: Sides | FloatArray, drive: Drive) -> FloatArray:
    """Return a power in each equation, shape (n, equations); a common one is no side's more."""
    total = value.total if isinstance(value, Sides) else value
    total = np.broadcast_to(total, drive.t.shape)
    if drive.equations == 1:
        return np.asarray(total[:, None])
    more = value.right - value.left if isinstance(value, Sides) else 0.0 * total
    return np.column_stack([total, np.broadcast_to(more, drive.t.shape)])
