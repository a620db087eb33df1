"""Logs as robots write them, however strange: an answer or a named error, never a traceback."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import pytest
from by_day import by_day

from energyplan import DriveLog, diagnose, identify, simulate
from energyplan.errors import EnergyPlanError, NotIdentifiableError
from energyplan.fit.drive import quiet
from energyplan.path import FloatArray
from energyplan.power import PowerModel
from energyplan.vehicle import Vehicle

MODEL = PowerModel.preset("quadriga:full:concrete")
NOISE = {"power_noise": 5.0, "speed_noise": 0.005}
Channels = dict[str, FloatArray]


def _kept(channels: Channels, keep: slice | FloatArray) -> Channels:
    return {name: values[keep] for name, values in channels.items()}


def _with(**changes: Callable[[FloatArray], FloatArray]) -> Callable[[Channels], Channels]:
    return lambda channels: {
        **channels, **{name: change(channels[name]) for name, change in changes.items()}
    }  # fmt: skip


def _zero(values: FloatArray) -> FloatArray:
    return np.zeros_like(values)


def _half(values: FloatArray) -> FloatArray:
    return np.full_like(values, 0.5)


def _holes(values: FloatArray) -> FloatArray:
    values = values.copy()
    for first in range(100, len(values), 400):
        values[first : first + 60] = np.nan
    return values


def _coarse(values: FloatArray) -> FloatArray:
    return np.asarray(np.round(8 * values) / 8)


def _spike(values: FloatArray) -> FloatArray:
    values = values.copy()
    values[7] = 4e4
    return values


def _back(values: FloatArray) -> FloatArray:
    return np.where(np.arange(len(values)) > 500, values - 3.0, values)


def _broken(channels: Channels) -> Channels:
    return _kept(channels, np.arange(len(channels["t"])) % 60 < 20)


STRANGE: dict[str, Callable[[Channels], Channels]] = {
    "two samples": lambda c: _kept(c, slice(2)),
    "three samples": lambda c: _kept(c, slice(400, 403)),
    "ten seconds": lambda c: _kept(c, slice(200)),
    "a sample every two seconds": lambda c: _kept(c, slice(None, None, 40)),
    "two hertz": lambda c: _kept(c, slice(None, None, 10)),
    "gaps": _broken,
    "constant speed": _with(v_left=_half, v_right=_half),
    "straight only": lambda c: _kept(c, (c["t"] > 28) & (c["t"] < 45)),
    "spin only": lambda c: _kept(c, (c["t"] > 4) & (c["t"] < 23)),
    "standstill": _with(v_left=_zero, v_right=_zero),
    "no power": _with(p_left=_zero, p_right=_zero),
    "one power dead": _with(p_left=_zero),
    "one speed dead": _with(v_left=_zero),
    "holes": _with(p_left=_holes, v_right=lambda values: np.roll(_holes(values), 200)),
    "time going back": _with(t=_back),
    "coarse speeds": _with(v_left=_coarse, v_right=_coarse),
    "a spike": _with(p_left=_spike),
    "pose that never changes": _with(x=_zero, y=_zero, yaw=_zero, yaw_rate=_zero),
    "nanowatts": _with(p_left=lambda p: 1e-9 * p, p_right=lambda p: 1e-9 * p),
}


def _strange(name: str) -> DriveLog | None:
    """Return a strange log; None where it is refused, by its name."""
    sound = simulate.identification_drive(MODEL, seed=1, **NOISE)
    try:
        return DriveLog.from_columns(STRANGE[name](dict(sound.channels)), name)
    except EnergyPlanError as problem:
        assert name in str(problem)
        return None


@pytest.fixture(autouse=True)
def no_nan_on_its_way() -> Iterator[None]:
    """NumPy warns where one is made."""
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        yield


@pytest.mark.parametrize("name", STRANGE)
def test_any_log_is_identified_or_refused_by_a_named_error(name: str) -> None:
    log = _strange(name)
    if log is None:
        return
    try:
        found = identify(log, MODEL.vehicle)
    except EnergyPlanError as problem:
        assert len(str(problem)) > 30
        return
    assert np.all(np.isfinite(found.model.coefficients))


def _answered(train: DriveLog, unseen: DriveLog) -> None:
    try:
        told = diagnose(train, unseen, MODEL.vehicle)
    except EnergyPlanError as problem:
        assert len(str(problem)) > 30
        return
    assert np.isfinite(told.before.rmse) and np.isfinite(told.after.rmse)
    assert np.all(np.isfinite(told.model.coefficients))


REFUSED = "two samples", "ten seconds", "constant speed", "standstill", "one power dead"
"""Logs that take no time to try: there is an error, or little to be searched."""


@pytest.mark.parametrize(
    "name", by_day(STRANGE, (*REFUSED, "spin only", "holes", "pose that never changes"))
)
def test_any_log_is_learned_from_or_refused_by_a_named_error(name: str) -> None:
    if (log := _strange(name)) is not None:
        _answered(log, simulate.validation_drive(MODEL, seed=2, **NOISE))


@pytest.mark.parametrize("name", by_day(STRANGE, (*REFUSED, "no power", "gaps")))
def test_any_log_judges_or_is_refused_by_a_named_error(name: str) -> None:
    if (log := _strange(name)) is not None:
        _answered(simulate.identification_drive(MODEL, seed=1, **NOISE), log)


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
    late = log.t[-1] + 0.05 * np.arange(1, count + 1)
    parked = {
        name: np.concatenate([values, np.full(count, values[-1])])
        for name, values in log.channels.items()
    }
    still = dict.fromkeys(("v_left", "v_right", "p_left", "p_right"), np.zeros(count))
    for name, values in still.items():
        parked[name] = np.concatenate([log.channels[name], values])
    parked["t"] = np.concatenate([log.t, late])
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


def test_a_drive_that_is_given_twice_makes_nothing_surer() -> None:
    log = simulate.identification_drive(MODEL, seed=1, **NOISE)
    unseen = simulate.validation_drive(MODEL, seed=2, **NOISE)
    copies = [DriveLog(dict(log.channels), f"copy {k}") for k in range(4)]
    once, often = (diagnose(train, unseen, MODEL.vehicle) for train in (log, [log, *copies]))
    assert often.model == once.model
    assert often.training == (log.name,)
    assert often.predictions == once.predictions
    for k in range(4):
        assert f"copy {k} holds the same readings as {log.name}" in often.advice[k]


def test_a_drive_that_was_learned_from_is_no_test() -> None:
    log = simulate.identification_drive(MODEL, seed=1, **NOISE)
    told = diagnose(log, DriveLog(dict(log.channels), "copy"), MODEL.vehicle)
    assert told.advice[0].startswith(f"copy holds the same readings as {log.name}")


def test_what_is_at_an_end_of_its_range_is_told() -> None:
    """The drives of a robot of 4 t, as if it were one of 60 kg."""
    size = 4.0
    small, large = (
        Vehicle.from_geometry(
            "any", mass=60.0 * by**3, wheelbase=0.5 * by, track=0.55 * by, length=0.9 * by,
            width=0.7 * by,
        )
        for by in (1.0, size)
    )  # fmt: skip
    model = PowerModel.paper(large, K=0.05 * large.mass * 9.81, mu=0.6)
    logs = [
        simulate.drive(model, "survey", duration=60.0, rate=5.0, power_noise=40.0, seed=seed)
        for seed in (1, 2)
    ]
    told = diagnose(*logs, small)
    assert told.model.coefficient("slip_friction") == 2.0
    assert any("slip_friction (mu) is at the end 2 of its" in line for line in told.advice)


def test_a_holdout_in_another_state_is_no_proof_that_nothing_is_missing() -> None:
    log = simulate.identification_drive(MODEL, seed=1, **NOISE)
    heavy = replace(MODEL, coefficients=1.4 * MODEL.coefficients)
    told = diagnose(log, simulate.validation_drive(heavy, seed=2, **NOISE), MODEL.vehicle)
    assert not told.effects
    assert told.adequacy.adequate
    assert told.verdict == "unexplained"
    assert any(
        "alone fit the training drives" in line and "not the hold-out drives" in line
        for line in told.advice
    )
