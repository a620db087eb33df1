"""Identification, diagnosis and the online estimator agree on one log with the same terms."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from energyplan import diagnose, identify, simulate
from energyplan.fit.online import OnlineIdentifier
from energyplan.power import HOTEL, SLIP, TRACTION, PowerModel
from energyplan.power.effects import catalogue
from energyplan.vehicle import Vehicle


def _robot(seed: int) -> PowerModel:
    if seed == 0:
        return PowerModel.preset("quadriga:full:concrete")
    rng = np.random.default_rng(seed)
    size = float(rng.uniform(0.5, 1.1))
    vehicle = Vehicle.from_geometry(
        "random", mass=70.0 * size**3, wheelbase=0.5 * size, track=0.55 * size, length=0.9 * size,
        width=0.7 * size,
    )  # fmt: skip
    K = float(rng.uniform(0.06, 0.1)) * vehicle.mass * 9.81 / 2
    return PowerModel.paper(vehicle, K=K, mu=float(rng.uniform(0.4, 0.8)))


@pytest.mark.parametrize("tau", [0.0, 1.0], ids=["white", "correlated"])
@pytest.mark.parametrize("seed", range(4))
def test_three_ways_to_the_same_terms_agree_within_their_errors(seed: int, tau: float) -> None:
    model = _robot(seed)
    K = model.coefficient("traction_resistance")
    truth = model.with_term(HOTEL, 0.3 * K)
    noise: dict[str, Any] = {"power_noise": 0.05 * K, "speed_noise": 0.002, "correlation_time": tau}
    noise |= {"measured": "total"}  # the same data for all three
    log = simulate.identification_drive(truth, seed=seed, **noise)
    unseen = simulate.validation_drive(truth, seed=seed + 50, **noise)
    terms = (SLIP, TRACTION, HOTEL)
    found = identify(log, model.vehicle, terms=terms)
    told = diagnose(
        log, unseen, model.vehicle, effects=[catalogue()["hotel_load"]], choose=False
    ).model
    # Nothing is forgotten where the whole log is one surface.
    online = OnlineIdentifier(found.model.vehicle, terms=terms, memory=1e9)
    assert online.run(log) == ()
    for term in terms:
        ways = [
            (one.coefficient(term.name), one.std_error(term.name) or 0.0)
            for one in (found.model, told, online.model)
        ]
        values, errors = np.array(ways).T
        # Three estimators of one number: no further apart than errors of their own.
        assert np.ptp(values) < 4 * errors.max()
        assert errors.max() < 3 * errors.min()


def test_what_a_log_cannot_tell_is_said_first() -> None:
    model = PowerModel.preset("quadriga:full:concrete")
    noise = {"power_noise": 5.0, "without": {"accel_x"}}
    log = simulate.drive(model, [("straight", 60.0)], seed=1, **noise)
    unseen = simulate.validation_drive(model, seed=2, **noise)
    told = diagnose(log, unseen, model.vehicle)
    assert told.advice[0].startswith("slip_friction (mu) cannot be identified")
