"""The least energy of driving a path, at any speeds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from energyplan.cost import EnergyCost, speeds
from energyplan.errors import ModelError
from energyplan.path import FloatArray, Path
from energyplan.vehicle import MotorLimits

STANDSTILL = 1e-6
"""Part of the largest rate that stands for none: what depends on speed is gone but for it."""

SCAN = 145
"""Rates that are tried down to there, as close together as where a robot has to get on."""


def least_energy(path: Path, cost: EnergyCost) -> float:
    """Return what no way of driving a path's arcs on level ground takes less than [J].

    Every arc counts at the speed at which it takes least, of all that the tread speeds and the yaw
    rate allow: however slow, and also those that the motors bear for a short while alone. A robot
    that stands still between two arcs takes no less, however it speeds up and brakes; one that
    drives on can carry motion from an arc on which a side returns power to another.

    Source: docs/theory, section 3.
    """
    motor = MotorLimits(speed=cost.vehicle.motor.speed)
    model = replace(cost.model, vehicle=replace(cost.vehicle, motor=motor))
    free = replace(cost, model=model, speed="cheapest", time_value=0.0)
    x, y, *_ = free._moving(path)
    limit = free._admissible_rate(x, y)

    def energy(rate: FloatArray) -> FloatArray:
        return free._element_energy(x, y, rate=rate)

    if free._static:
        return float(energy(limit).sum())
    if not np.all(np.isfinite(limit)):
        raise ModelError(
            f"the energy of the model {model.name!r} depends on speed, but the vehicle "
            f"{free.vehicle.name!r} has no speed limit; set its motor speed"
        )
    return float(energy(speeds.cheapest_rate(STANDSTILL * limit, limit, energy, SCAN)).sum())
