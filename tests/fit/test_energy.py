"""Energy of a run to come, with its interval: one way, whoever asks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from energyplan import DriveLog, PowerModel, diagnose, identify, simulate
from energyplan.errors import InvalidInputError
from energyplan.fit.drive import Drive
from energyplan.fit.online import OnlineIdentifier
from energyplan.fit.run import RunEffect
from energyplan.physics.loop import LEVEL, with_interval

MODEL = PowerModel.preset("quadriga:empty:concrete")
SPREAD = 0.06


def run(seed: int, spread: float = SPREAD) -> DriveLog:
    """Half a minute of turns and straights, of which all took more or less as a whole."""
    log = simulate.drive(
        MODEL, "survey", duration=30.0, rate=10.0, power_noise=5.0, measured="total", seed=seed
    )
    factor = 1.0 + spread * np.random.default_rng(seed).standard_normal()
    return replace(log, channels={**log.channels, "power": factor * log.channel("power")})


def test_so_many_runs_to_come_are_within_their_intervals() -> None:
    """Of a model of few runs that differ by 6 %, ninety intervals of a hundred hold the energy."""
    seeds, hits, widths = iter(range(1000)), [], []
    for _ in range(12):
        found = identify([run(next(seeds)) for _ in range(5)], MODEL.vehicle)
        assert found.residual.run_spread == found.run.deviation
        for log in (run(next(seeds)) for _ in range(4)):
            energy, low, high = found.energy(log)
            hits.append(low <= log.energy <= high)
            widths.append((high - low) / energy)
            assert energy == pytest.approx(
                log.weights @ found.model.power(log.motion(found.icr)), rel=1e-3
            )
    assert 0.8 < np.mean(hits) < 0.99
    assert 0.15 < np.mean(widths) < 0.45


def test_what_runs_share_is_known_no_better_by_identify_than_by_diagnose() -> None:
    drives = [run(seed) for seed in range(6)]
    found = identify(drives, MODEL.vehicle)
    value = found.model.coefficient("traction_resistance")
    assert found.std_error["traction_resistance"] > 0.9 * found.run.deviation * value / np.sqrt(6)
    alike = identify([run(seed, 0.0) for seed in range(6)], MODEL.vehicle)
    assert alike.std_error["traction_resistance"] < 0.3 * found.std_error["traction_resistance"]
    assert alike.residual.run_spread < 0.01
    assert identify(drives[0], MODEL.vehicle).residual.run_spread is None
    with pytest.raises(InvalidInputError, match="probability"):
        found.energy(drives[0], 1.0)


def test_diagnosis_and_the_closed_loop_say_the_same_of_a_model() -> None:
    drives, other = [run(seed) for seed in range(4)], run(9)
    told = diagnose(drives, [other], MODEL.vehicle, effects=())
    (one,) = told.predictions
    effect = RunEffect.known(told.model.residual)
    same = effect.energy(told.model, Drive.of(other, told.model.vehicle), LEVEL)
    assert same.mean == pytest.approx(one.energy, rel=1e-3)
    motion = other.motion(told.model.vehicle.icr)
    loop = with_interval(same.mean, effect, told.model, motion, other.weights)
    assert loop == pytest.approx(same, rel=1e-2)


def test_what_former_runs_differed_by_is_not_forgotten_while_driving() -> None:
    found = identify([run(seed) for seed in range(5)], MODEL.vehicle)
    online = OnlineIdentifier(found.model)
    online.run(run(11))
    assert online.model.residual.run_spread == found.run.deviation
