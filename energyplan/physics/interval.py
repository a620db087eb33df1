"""What drives take beyond a model, and the interval of an energy that it predicts."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import astuple
from typing import NamedTuple

import numpy as np
from scipy.stats import t as student

from energyplan.errors import MissingChannelError
from energyplan.logs import DriveLog
from energyplan.motion import Motion
from energyplan.path import FloatArray, Trajectory
from energyplan.physics.driving import energy_told
from energyplan.physics.robot import Ground
from energyplan.planning import PlanningProblem
from energyplan.power import PowerModel, Sides
from energyplan.power.effects import with_weight
from energyplan.terrain import HeightMap
from energyplan.vehicle import TreadICR

NORMAL = 1.96
"""Half width of a 95 % interval in standard deviations."""

USUAL = 0.005
"""Relative error of energies told by a model that lacks nothing: that of the engine's drives."""
PRIOR = 4
"""Drives that count for it beside those made."""
ALIKE = 0.02
"""How far tread ICRs may differ for controllers to steer alike, over half the slip track [1]."""


class Overhead(NamedTuple):
    """What drives take beyond what a model says of the routes that were asked."""

    share: float  # what they took more, over what the model says
    deviation: float  # how much that differs from drive to drive, relative


def overhead(ratios: Sequence[float]) -> Overhead:
    """Learn from drives made what the next one takes beyond what a model says of its route.

    A controller turns more than it is asked to, treads slip, and no sum of terms is all of a robot.
    """
    share = float(np.mean(ratios)) - 1.0 if len(ratios) else 0.0
    freedom = PRIOR + max(len(ratios) - 1, 0)
    scatter = float(np.sum(np.square(np.array(ratios) - 1.0 - share)))
    variance = (PRIOR * USUAL**2 + scatter) / freedom * (1.0 + 1.0 / max(len(ratios), 1))
    return Overhead(share, float(np.sqrt(variance) * student.ppf(0.975, freedom) / NORMAL))


def retold(model: PowerModel, log: DriveLog) -> float:
    """Return the energy that a model predicts for the motion of a log [J]."""
    return float(log.weights @ model.battery_side().power(log.motion(model.vehicle.icr)))


class Steered(NamedTuple):
    """A drive that followed a trajectory, and the tread ICRs that its controller believed in."""

    asked: Trajectory  # what was to be driven
    log: DriveLog  # what was driven
    icr: TreadICR  # the tread ICRs


def asked_energy(trajectory: Trajectory, problem: PlanningProblem) -> float:
    """Return what the model and the ground of a problem say that a trajectory takes [J]."""
    ground = Ground(problem.surfaces, problem.heights)
    return sum(energy_told(trajectory, problem.cost.model, ground).values())


def ratio(
    drive: Steered, model: PowerModel, asked: PlanningProblem, heights: HeightMap | None
) -> float:
    """Return the energy that a drive took, over what a model says of it; at least one.

    A controller leaves its route, and that takes more than the route does. With other tread ICRs in
    mind it leaves it in another way, which says nothing of the drives to come: then the motion that
    was made counts. No controller saves energy: a drive that took less was asked for more than
    motors do, or its route lies along the edge of some ground.
    """
    icr = model.vehicle.icr
    apart = np.subtract(astuple(icr), astuple(drive.icr))
    told = asked_energy(drive.asked, asked)
    if np.abs(apart).max() > ALIKE * icr.half_track:
        on_slopes = model if heights is None else with_weight(model)
        with suppress(MissingChannelError):  # a sensor less than the model asks for
            told = retold(on_slopes, drive.log)
    return max(drive.log.energy / told, 1.0)


def interval(
    energy: float, model: PowerModel, motion: Motion, weights: FloatArray, share: float
) -> tuple[float, float] | None:
    """Return the 95 % interval of an energy."""
    if model.covariance is None:
        return None

    def total(column: Sides | FloatArray) -> float:
        power = column.total if isinstance(column, Sides) else column
        return float(weights @ np.broadcast_to(power, weights.shape))

    try:
        gradient = np.array([total(column) for column in model.regressors(motion)])
    except MissingChannelError:
        return None
    variance = float(gradient @ model.covariance @ gradient)
    if model.residual is not None:
        misfit, duration = model.residual, float(weights.sum())
        correlated = 2.0 * max(misfit.correlation_time, 0.05) * duration
        variance += misfit.rmse**2 * correlated + (misfit.bias * duration) ** 2
    half = NORMAL * float(np.sqrt(variance + (share * energy) ** 2))
    return energy - half, energy + half
