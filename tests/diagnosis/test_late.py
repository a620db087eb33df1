"""Power that is logged late, by a delay and by the lag of a sensor that filters."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from by_day import by_day
from made_drives import pair

from energyplan import DriveLog, Vehicle, diagnose, simulate
from energyplan.diagnosis.judge import _between_samples
from energyplan.fit.drive import Drive, SampleTimes
from energyplan.fit.estimate import Problem
from energyplan.motion import Motion
from energyplan.power import PowerModel
from energyplan.power.effects import LINEAR_INERTIA, catalogue


@pytest.mark.parametrize("late_by", by_day([(0.4, 0.0), (0.1, 0.5)], [(0.1, 0.5)]))
def test_delay_and_lag_are_found_beside_each_other(late_by: tuple[float, float]) -> None:
    delay, lag = late_by
    truth = PowerModel.preset("quadriga:full:concrete").with_term(LINEAR_INERTIA, 147.0)

    def late(log: DriveLog, seed: int) -> DriveLog:
        log = log.shifted(p_left=delay, p_right=delay)
        rng, sides = np.random.default_rng(seed), {}
        for name in ("p_left", "p_right"):
            power = log.channel(name)
            seen = power if lag == 0.0 else SampleTimes(log.t).lagged(power, lag)
            sides[name] = seen + 5.0 * rng.standard_normal(len(power))
        return DriveLog({**log.channels, **sides}, log.name)

    train, unseen = pair(truth, seed=3, speed_noise=0.003)
    told = diagnose(late(train, 5), late(unseen, 6), truth.vehicle)
    (found,) = (effect for effect in told.effects if effect.name == "time_offset")
    assert found.value == pytest.approx(delay + lag, abs=0.05)
    assert found.details.get("lag", 0.0) == pytest.approx(lag, abs=0.1)
    # Scored on the power as it was logged: what is left is the noise, and no smoother.
    assert told.after.rmse == pytest.approx(np.hypot(5.0, 5.0), rel=0.25)


@pytest.mark.shared
@pytest.mark.nightly
def test_two_drives_of_a_warthog_on_grass_tell_its_mass_roughly(shared_data: Path) -> None:
    from energyplan.io.given import Given
    from energyplan.io.start import start

    vehicle, logs = Vehicle.preset("warthog"), []
    for name in ("warthog_grass.csv", "warthog_grass_2.csv"):
        file = shared_data / "drive" / name
        columns = start(file, Given(like=vehicle)).project.columns
        logs.append(DriveLog.read(file, columns, others=False))
    first, second = logs
    half, end = float(second.t[-1]) / 2, float(second.t[-1])
    found = diagnose([first, second.segment(0.0, half)], second.segment(half, end), vehicle)
    effects = {effect.name: effect for effect in found.effects}
    mass = effects["specific_force"]
    assert mass.std_error < 0.4 * mass.value
    assert abs(mass.value - vehicle.mass) < 1.96 * mass.std_error
    assert "regeneration_efficiency" in effects
    assert found.verdict == "unexplained"


@pytest.mark.parametrize("changes", [1, 4])
def test_a_delay_is_known_no_better_than_when_between_samples_power_changed(changes: int) -> None:
    """Jumps at any time between samples, by the mean of many: against what the variance says."""
    vehicle = Vehicle.preset("quadriga:full")
    t, period = np.arange(0.0, 40.0, 0.5), 0.5
    at = np.arange(1, changes + 1) * 10
    rise = np.zeros((len(t), 1))
    rise[at] = 200.0
    speed = np.ones(len(t))
    problem = Problem([Drive("d", t, Motion(speed, speed, vehicle.icr), speed)], vehicle)
    late = np.random.default_rng(3).uniform(-period / 2, period / 2, (200_000, changes))
    expected = float(np.var(late.mean(axis=1)))
    assert _between_samples(problem, [rise]) == pytest.approx(expected, rel=0.02)


def test_errors_of_delays_hold_also_at_two_readings_a_second() -> None:
    model = PowerModel.preset("quadriga:full:concrete")
    beside = []
    for seed in range(8):
        delay = 0.2 + 0.05 * seed
        options = {"power_noise": 1.0, "rate": 2.0, "delays": {"p_left": delay, "p_right": delay}}
        logs = pair(model, 2 * seed, **options)
        effects = [catalogue()["time_offset"]]
        (found,) = diagnose(*logs, model.vehicle, effects=effects, choose=False).effects
        beside.append((found.value - delay) / found.std_error)
        assert found.std_error > 0.005
    assert np.sum(np.abs(beside) < 1.96) >= 7


def test_a_delay_that_nearly_nothing_tells_is_one_of_those_looked_for() -> None:
    """Under so much noise blocks of a straight line leave it open by +- 6 s."""
    model = PowerModel.preset("quadriga:full:concrete")
    log = simulate.drive(model, [("straight", 60.0)], seed=5, power_noise=3000.0, speed_noise=0.005)
    entries = [catalogue()["time_offset"]]
    vehicle = model.vehicle
    told = diagnose(log, simulate.validation_drive(model), vehicle, effects=entries, choose=False)
    (late,) = told.effects
    assert late.std_error == pytest.approx(2.0 / np.sqrt(12.0))
    assert late.std_error == late.details["delay_std_error"]
