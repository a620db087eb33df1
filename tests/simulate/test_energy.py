"""What the noise of simulated sensors does to energies: told and measured."""

from __future__ import annotations

import numpy as np

import energyplan as ep

MODEL = ep.PowerModel.preset("quadriga:empty:marble")
SEEDS = range(8)
DEVIATION, TAU, DURATION = 10.0, 0.2, 120.0
NOISE = {"power_noise": DEVIATION, "correlation_time": TAU, "speed_noise": 0.005}


def test_a_prediction_is_off_by_noise_alone() -> None:
    """No systematic part: judged against the energy without noise, and against the measured one."""
    told, measured = [], []
    for seed in SEEDS:
        train = ep.simulate.identification_drive(MODEL, seed=seed, **NOISE)
        found = ep.identify(train, MODEL.vehicle).model
        noisy, true = (
            ep.simulate.validation_drive(MODEL, seed=100 + seed, **noise) for noise in (NOISE, {})
        )
        predicted = float(true.weights @ found.power(true.motion(MODEL.vehicle.icr)))
        told.append(predicted / true.energy - 1.0)
        measured.append(noisy.energy - true.energy)
    sure = float(np.std(told, ddof=1)) / np.sqrt(len(SEEDS))
    assert abs(float(np.mean(told))) < 3.0 * sure < 0.01
    # Integral of a first-order Markov process on each of two sides, of which 8 are drawn.
    wanted = np.sqrt(2 * 2 * DEVIATION**2 * TAU * DURATION)
    assert 0.4 * wanted < np.std(measured, ddof=1) < 1.7 * wanted
