"""The power model that a static cost comes from, for those who know only its coefficients."""

from __future__ import annotations

import numpy as np

from energyplan.errors import InvalidInputError
from energyplan.power import SLIP, TRACTION, PowerModel
from energyplan.vehicle import MotorLimits, TreadICR, Vehicle


def static_model(
    per_metre: float, per_radian: float, icr: float | TreadICR, speed: float
) -> PowerModel:
    """Return the paper's model with these coefficients; see `EnergyCost.from_coefficients`."""
    if not (np.isfinite(per_metre) and per_metre > 0):
        raise InvalidInputError(f"per_metre is {per_metre}; give joules per metre > 0")
    if not (np.isfinite(per_radian) and per_radian >= 0):
        raise InvalidInputError(f"per_radian is {per_radian}; give joules per radian >= 0")
    treads = icr if isinstance(icr, TreadICR) else TreadICR.symmetric(icr)
    width = treads.slip_track
    vehicle = Vehicle.from_geometry(
        "coefficients",
        mass=1.0,
        wheelbase=width,
        track=width,
        length=2 * width,
        width=2 * width,
        icr=treads,
        motor=MotorLimits(speed=speed),
    )
    mu = per_radian / vehicle.slip_moment
    return PowerModel(vehicle, (SLIP, TRACTION), np.array([mu, per_metre / 2]), name="coefficients")
