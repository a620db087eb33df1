"""Logs as robots write them, however strange: an answer or a named error, never a traceback."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from made_drives import pair, sized

from energyplan import DriveLog, diagnose, identify, simulate
from energyplan.errors import NotIdentifiableError
from energyplan.fit.drive import quiet
from energyplan.power import PowerModel

MODEL = PowerModel.preset("quadriga:full:concrete")
NOISE = {"power_noise": 5.0, "speed_noise": 0.005}


def test_a_robot_that_only_stands_is_told_so() -> None:
    log = simulate.identification_drive(MODEL, seed=1, **NOISE)
    still = DriveLog.from_columns(
        {**log.channels, "v_left": 0 * log.t, "v_right": 0 * log.t}, "parked"
    )
    with pytest.raises(NotIdentifiableError, match="parked: the robot stands still"):
        diagnose(still, log, MODEL.vehicle)


def test_standstill_says_nothing_about_friction_and_makes_nothing_surer() -> None:
    log = simulate.identification_drive(MODEL, seed=1, **NOISE)
    count = 20_000
    parked = {
        name: np.append(values, np.full(count, 0.0 if name[:2] in ("v_", "p_") else values[-1]))
        for name, values in log.channels.items()
    }
    parked["t"][len(log) :] += 0.05 * np.arange(1, count + 1)
    short, long = (identify(one, MODEL.vehicle) for one in (log, DriveLog(parked)))
    for name, error in short.std_error.items():
        assert long.model.coefficient(name) == pytest.approx(short.model.coefficient(name))
        assert long.std_error[name] == pytest.approx(error, rel=0.1)


def test_a_speed_that_beats_with_its_encoder_is_still_a_speed() -> None:
    t = np.arange(0.0, 40.0, 1 / 6.5)
    beat = np.where(np.arange(len(t)) % 4 == 3, 0.29, 0.57)
    beat[:26] = 0.0
    log = DriveLog({"t": t, "v_left": beat, "v_right": beat, "power": 150 * beat})
    cleaned = quiet(log.motion(MODEL.vehicle.icr), t)
    driving = np.arange(len(t)) > 30
    assert np.all(cleaned.v_left[driving] > 0.3)
    assert cleaned.v_left[driving].mean() == pytest.approx(beat[driving].mean(), rel=0.01)
    assert np.all(cleaned.v_left[:20] == 0.0)


def test_a_copy_makes_nothing_surer_and_is_no_test() -> None:
    log, unseen = pair(MODEL, **NOISE)
    copies = [DriveLog(dict(log.channels), f"copy {k}") for k in range(4)]
    once = diagnose(log, [unseen, copies[3]], MODEL.vehicle)
    often = diagnose([log, *copies[:3]], [unseen, copies[3]], MODEL.vehicle)
    assert often.model == once.model
    assert often.training == (log.name,)
    assert often.predictions == once.predictions
    for told, copy in zip(often.advice, copies, strict=False):
        assert told.startswith(f"{copy.name} holds the same readings as {log.name}")


def test_what_is_at_an_end_of_its_range_is_told() -> None:
    """The drives of a robot of 4 t, as if it were one of 60 kg."""
    small, large = sized(1.0), sized(4.0)
    model = PowerModel.paper(large, K=0.05 * large.mass * 9.81, mu=0.6)
    logs = [
        simulate.drive(model, "survey", duration=60.0, rate=5.0, power_noise=40.0, seed=seed)
        for seed in (1, 2)
    ]
    told = diagnose(*logs, small)
    assert told.model.coefficient("slip_friction") == 2.0
    assert any("slip_friction (mu) is at the end 2 of its" in line for line in told.advice)


def test_a_holdout_in_another_state_is_no_proof_that_nothing_is_missing() -> None:
    log, _ = pair(MODEL, **NOISE)
    heavy = replace(MODEL, coefficients=1.4 * MODEL.coefficients)
    told = diagnose(log, simulate.validation_drive(heavy, seed=2, **NOISE), MODEL.vehicle)
    assert not told.effects
    assert told.adequacy.adequate
    assert told.verdict == "unexplained"
    assert any(
        "alone fit the training drives" in line and "not the hold-out drives" in line
        for line in told.advice
    )
