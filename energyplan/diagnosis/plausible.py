"""Is what an effect asks for what this robot can do? (private)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from energyplan.diagnosis.part import Part
from energyplan.fit.drives.columns import field_of
from energyplan.fit.drives.late import ON_TIME, Late
from energyplan.fit.drives.linear import held_loss
from energyplan.fit.least_squares import Fit
from energyplan.fit.problem import PAPER, Problem
from energyplan.path import FloatArray
from energyplan.power import SLIP, TRACTION, PowerModel, Sides, Term
from energyplan.power.effect_terms import SLIP_CHANGE, TRACTION_CHANGE
from energyplan.vehicle import GRAVITY, Vehicle

_MARGIN = 1.5  # over what the vehicle's description gives
_OVER = 0.05  # over the upper end of a coefficient, by which noise of the speeds may put it beyond
_MASS = 0.4  # standard deviation of the logarithm of a robot's mass over that of its description
_USUAL = 0.99  # quantile over the samples: single ones may be noise of a speed's derivative


def likeness(vehicle: Vehicle, parts: Sequence[Part], found: Fit) -> float:
    """Return how likely the masses that effects find are, by the vehicle's own.

    Powers tell forces and masses over an efficiency (docs/theory, section 6): of two explanations
    that drives cannot tell apart, the vehicle's mass may tell which is right.
    """
    apart, at = 0.0, len(PAPER)
    for part in parts:
        if part.effect.of_mass is not None and part.effect.of_mass[0] > 0.0:
            mass = max(float(found.values[at]), 1e-9 * vehicle.mass)
            known = float(found.covariance[at, at]) / mass**2  # a mass that noise hides tells none
            apart += np.log(mass / vehicle.mass) ** 2 / (_MASS**2 + known)
        at += len(part.terms)
    return float(np.exp(-0.5 * apart))


def drivable(problem: Problem, terms: Sequence[Term], model: PowerModel) -> bool:
    """Tell whether the force of an effect is one that this robot's treads can have given.

    The drives were driven, so that no part of what the motors gave exceeds what they can: their
    force, their peak power at the speed of the tread, and the weight, beyond which wheels spin.
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


def most_held(problem: Problem, terms: Sequence[Term], values: FloatArray) -> float:
    """Return the most that losses may take at rest in any drive [W]."""
    return max(held_loss(problem.vehicle, terms, values, drive) for drive in problem.drives)


def drags(terms: Sequence[Term], values: FloatArray) -> bool:
    """Tell whether friction and resistance still drag after a change, as plans take them then."""
    now = {term.name: float(value) for term, value in zip(terms, values, strict=True)}
    return all(
        now.get(usual.name, 0.0) + now[change.name] >= 0.0
        for usual, change in ((SLIP, SLIP_CHANGE), (TRACTION, TRACTION_CHANGE))
        if change.name in now
    )


class Rest:
    """What the robot draws at rest, where the drives show it."""

    def __init__(self, problem: Problem) -> None:
        self.drives = problem.drives
        self._drawn: dict[Late, tuple[int, float]] = {}

    def drawn(self, late: Late) -> tuple[int, float]:
        """Return how many samples show the robot at rest, and the mean of their power [W].

        Where the power is logged late, what a sample shows is of before.
        """
        if late not in self._drawn:
            late_drives = [replace(drive, late=late) for drive in self.drives]
            power = np.concatenate([drive.power[drive.rests] for drive in late_drives])
            self._drawn[late] = len(power), float(power.mean()) if len(power) else 0.0
        return self._drawn[late]

    def allows(self, constant: float, held: float = 0.0, late: Late = ON_TIME) -> bool:
        """Tell whether a constant power agrees with what is drawn at rest."""
        count, mean = self.drawn(late)
        if count < 10 or constant == 0.0:
            return True
        slack = 0.5 * abs(constant)
        return -slack <= mean - constant <= slack + held

    def agrees(self, problem: Problem, parts: Sequence[Part], found: Fit) -> bool:
        """Tell whether coefficients are possible, and what the robot draws at rest too."""
        terms = [*PAPER, *(term for part in parts for term in part.terms)]
        slack = 3 * np.sqrt(np.maximum(np.diag(found.covariance), 0.0))
        for term, value, wide in zip(terms, found.values, slack, strict=True):
            low, high = term.bounds
            # What is at its upper end is estimated beyond it as often as not; none is no effect.
            above = float(wide) + _OVER * abs(high)
            if not low - (float(wide) if term in PAPER else 0.0) <= value <= high + above:
                return False
        most = np.array([term.bounds[1] for term in terms])
        model = PowerModel(problem.vehicle, tuple(terms), np.minimum(found.values, most))
        for part in parts:
            if not part.terms:
                continue
            low, high = part.effect.limits(problem.vehicle)
            if not low <= part.effect.value(model) <= high:
                return False
        if not all(drivable(problem, part.terms, model) for part in parts):
            return False
        if not drags(terms, found.values):
            return False
        constant = {term.name for part in parts for term in part.terms if term.kind == "power"}
        resting = sum(
            float(value)
            for term, value in zip(terms, found.values, strict=True)
            if term.name in constant
        )
        held = most_held(problem, terms, found.values)
        return self.allows(resting, held, problem.drives[0].late)
