"""EnergyCost against the closed forms of the static model and against the power model itself."""

from __future__ import annotations

import numpy as np

from energyplan.cost import EnergyCost
from energyplan.power import PowerModel

MODEL = PowerModel.preset("quadriga:empty:concrete")


def test_static_cost_is_the_closed_form() -> None:
    cost = EnergyCost(MODEL)
    a = 2 * MODEL.coefficient("traction_resistance")
    beta = MODEL.coefficient("slip_friction") * MODEL.vehicle.slip_moment
    rng = np.random.default_rng(1)
    ds, dtheta = rng.normal(size=(2, 1000))
    expected = a * np.maximum(abs(ds), cost.half_track * abs(dtheta)) + beta * abs(dtheta)
    np.testing.assert_allclose(cost.segment_energy(ds, dtheta), expected, rtol=1e-9)
