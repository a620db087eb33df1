"""Costs of random models: effects of the catalogue, empirical terms, limits and efficiencies."""

from dataclasses import replace

import numpy as np

from energyplan import EnergyCost, MotorLimits, PowerModel, TreadICR
from energyplan.errors import ModelError
from energyplan.power.effects import term
from energyplan.power.empirical import empirical_term

MODEL = PowerModel.preset("quadriga:empty:concrete")
SIZES = {
    "hotel_load": 200.0, "viscous_loss": 80.0, "air_drag": 40.0, "copper_loss": 1e-3,
    "dragging_wheel_left": 60.0, "turn_asymmetry": 0.2, "slip_speed_friction": 0.4,
    "friction_mobilisation": 0.627, "towing_force": 60.0, "towed_drag": 60.0,
    "stribeck_friction": 0.3,
}  # fmt: skip
"""Effects that a planner can use on level ground, and the greatest size tried."""


def random_model(seed):
    """Return the cost of a model of random effects, None where it would be no model."""
    rng = np.random.default_rng(seed)
    icr = TreadICR(*rng.uniform(0.2, 0.7, 2), rng.uniform(-0.1, 0.1))
    vehicle = replace(
        MODEL.vehicle,
        icr=icr,
        motor=MotorLimits(speed=rng.uniform(0.5, 3.0)),
        drive_efficiency=rng.uniform(0.6, 1.0),
        regen_efficiency=rng.uniform(0.0, 1.0),
    )
    model = replace(MODEL, vehicle=vehicle)
    for name in rng.choice(sorted(SIZES), rng.integers(1, 4), replace=False):
        made = term(str(name))
        if made.params:
            made = replace(made, params={k: 10.0 ** rng.uniform(-1, 1.5) for k in made.params})
        sign = rng.choice([-1.0, 1.0]) if made.bounds[0] < 0 else 1.0
        model = model.with_term(made, sign * rng.uniform(0.1, 1.0) * SIZES[str(name)])
    if rng.random() < 0.5:
        carrier, size = [("traction", 40.0), ("slip", 60.0), ("power", 30.0)][rng.integers(3)]
        channel = ["curvature", "omega", "v"][rng.integers(3)]
        knots = np.sort(rng.uniform(-3, 3, 6))
        shape = empirical_term(f"empirical_{carrier}_{channel}", knots, rng.uniform(-size, size, 6))
        model = model.with_term(shape, 1.0)
    try:
        return EnergyCost(model, battery=bool(rng.random() < 0.3))
    except ModelError:
        return None
