"""Is what an effect asks for what this robot can do? (private)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from energyplan.diagnosis.columns import field_of
from energyplan.diagnosis.fitting import Problem
from energyplan.power import PowerModel, Sides, Term
from energyplan.vehicle import GRAVITY

_MARGIN = 1.5  # over what the vehicle's description gives
_USUAL = 0.99  # quantile over the samples: single ones may be noise of a speed's derivative


def drivable(problem: Problem, terms: Sequence[Term], model: PowerModel) -> bool:
    """Tell whether the force of an effect is one that this robot's treads can have given.

    The drives were driven, so that no part of what the motors gave exceeds what they can: their
    force, their peak power at the speed of the tread, and the weight, beyond which wheels spin.

    Parameters
    ----------
    problem : Problem
        The drives.
    terms : sequence of Term
        Terms of the effect.
    model : PowerModel
        The fitted model, which holds them.

    Returns
    -------
    bool
        True also for an effect that is no force.
    """
    forces = [term for term in terms if term.kind == "force"]
    if not forces:
        return True
    vehicle = problem.vehicle
    strongest = _MARGIN * min(vehicle.motor.force, vehicle.mass * GRAVITY)
    most = _MARGIN * vehicle.motor.peak_power
    for drive in problem.drives:
        motion = drive.motion
        total = Sides(np.zeros(motion.shape), np.zeros(motion.shape))
        for term in forces:
            total = total + field_of(term, drive, vehicle) * model.coefficient(term.name)
        for force, speed in ((total.left, motion.v_left), (total.right, motion.v_right)):
            if float(np.quantile(np.abs(force), _USUAL)) > strongest:
                return False
            if np.isfinite(most) and float(np.quantile(np.abs(force * speed), _USUAL)) > most:
                return False
    return True
