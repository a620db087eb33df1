"""What it costs that the sides push against each other on straights (private)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import brentq
from scipy.stats import norm

from energyplan.diagnosis.result import Evidence, FoundEffect
from energyplan.fit.drives.drive import Drive
from energyplan.fit.drives.linear import (
    equations_of,
    held_forces,
    is_lossy,
    losses_of,
    slip_limit,
)
from energyplan.fit.drives.preload import lost_power, preload, straights
from energyplan.fit.drives.windows import BLOCK
from energyplan.fit.problem import Problem
from energyplan.path import FloatArray
from energyplan.power import PowerModel, Sides
from energyplan.power.effect_terms import WHEEL_FIGHT
from energyplan.power.effects import Effect

_WORTH = 0.01  # share of the energy that is worth naming
_CHANCE = 0.01  # chance that none is there, from which on it is not named


@dataclass(frozen=True)
class WheelFight:
    """The moment that contacts hold on straights, as one that costs as much at any time."""

    size: float  # friction that it uses
    std_error: float  # friction that it uses
    share: float  # share of the drives' energy that it costs
    p_value: float  # chance that another drive as long pays nothing for it, from blocks
    model: PowerModel  # the model with the term

    def effect(self, entry: Effect) -> FoundEffect:
        """Return it as an effect of a diagnosis."""
        return FoundEffect(
            entry.name, entry.symbol, self.size, entry.unit, self.std_error,
            Evidence(0.0, 0.0, self.p_value), 1.0 - self.p_value, (),
            {"share of the energy": self.share}, entry.meaning, entry.planner,
        )  # fmt: skip


def find_wheel_fight(problem: Problem, model: PowerModel) -> WheelFight | None:
    """Find what the moment between the sides costs while contacts hold.

    Without losses it costs nothing: what one side pushes the other gets back (docs/theory,
    section 6). With them it does. The power of both sides shows it at each instant, a total what
    it costs on each stretch.
    """
    if not all(is_lossy(drive, model.terms) for drive in problem.drives):
        return None
    cases = [_Case.of(drive, problem, model) for drive in problem.drives]
    spent = np.concatenate([case.by_block(case.cost(case.moment)) for case in cases])
    total = float(spent.sum())
    energy = sum(float(drive.weights @ drive.power) for drive in problem.drives)
    if not total > _WORTH * abs(energy):
        return None

    def steady(size: float) -> FloatArray:
        parts = [case.by_block(case.cost(size * case.unit)) for case in cases]
        return np.concatenate(parts)

    most = max(slip_limit(model.terms, model.coefficients), 1e-6)
    size = most
    if steady(most).sum() > total:
        size = float(brentq(lambda one: float(steady(one).sum()) - total, 0.0, most))
    # The moment is not steady: blocks differ from what a steady one costs.
    error = float(np.linalg.norm(spent - steady(size)))
    low, high = 0.99 * size, 1.01 * size
    slope = float((steady(high) - steady(low)).sum()) / (high - low)
    if not slope > 0.0:
        return None
    deviation = error / slope
    chance = float(norm.sf(total / max(error, 1e-12)))
    if chance > _CHANCE:
        return None
    return WheelFight(size, deviation, total / energy, chance, _with_fight(model, size, deviation))


def _with_fight(model: PowerModel, size: float, deviation: float) -> PowerModel:
    extended = model.with_term(WHEEL_FIGHT, size)
    if extended.covariance is None:
        return extended
    covariance = np.array(extended.covariance)
    covariance[-1, -1] = deviation**2
    return extended.with_coefficients(extended.coefficients, covariance)


@dataclass(frozen=True)
class _Case:
    """A drive, its losses, and the moment between its sides."""

    drive: Drive
    model: PowerModel
    forces: Sides
    moment: FloatArray
    unit: FloatArray

    @classmethod
    def of(cls, drive: Drive, problem: Problem, model: PowerModel) -> _Case:
        vehicle, terms, values = problem.vehicle, model.terms, model.coefficients
        model = replace(model, vehicle=vehicle)
        losses = losses_of(drive, vehicle, terms, values)
        forces = held_forces(drive, vehicle, terms, values)
        limit = vehicle.slip_moment * slip_limit(terms, values)
        if drive.between is not None:
            found = preload(drive, drive.between, vehicle, losses, forces, limit)
            # Where contacts hardly hold, a turn begins or ends: that costs friction of turning.
            moment = np.where(found.alone, 0.0, found.moment)
            unit = vehicle.slip_moment * np.sign(moment)
        else:
            power = equations_of(model, replace(drive, fitted=False))[:, 0]
            told = straights(drive, vehicle, losses, forces, limit, power)
            moment = np.zeros(len(drive.t))
            driven = drive.holds & (drive.held.v_left != 0.0)
            if told is not None:
                moment = np.where(driven, told.forces.right * drive.motion.icr.slip_track, 0.0)
            # A steady moment that costs as much is one on all straights.
            unit = vehicle.slip_moment * driven
        return cls(drive, model, forces, moment, unit)

    def cost(self, moment: FloatArray) -> FloatArray:
        """Power that losses take because of a moment between the sides [W]."""
        vehicle, track = self.model.vehicle, self.drive.motion.icr.slip_track
        losses = losses_of(self.drive, vehicle, self.model.terms, self.model.coefficients)
        push = Sides(-moment / track, moment / track)
        with_it, without = (
            lost_power(losses, self.drive.held, vehicle, forces).total
            for forces in (self.forces + push, self.forces)
        )
        return np.asarray(with_it - without)

    def by_block(self, power: FloatArray) -> FloatArray:
        """Energy of each block [J]."""
        t = self.drive.t
        block = np.minimum((t / BLOCK).astype(int), max(int(t[-1] / BLOCK + 0.5), 1) - 1)
        return np.asarray(np.bincount(block, self.drive.weights * power), float)
