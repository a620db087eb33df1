"""Logs as robots write them, however strange: an answer or a named error, never a traceback."""

from __future__ import annotations

import json
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from by_day import by_day
from made_drives import pair, sized

from energyplan import DriveLog, diagnose, identify, simulate
from energyplan.errors import EnergyPlanError, InvalidInputError, NotIdentifiableError
from energyplan.fit.drive import quiet
from energyplan.io.given import Given
from energyplan.io.start import start
from energyplan.live import lines_of, watch
from energyplan.output import documents
from energyplan.path import FloatArray
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


@pytest.mark.usefixtures("few_effects")
def test_a_copy_makes_nothing_surer_and_is_no_test() -> None:
    log, unseen = pair(MODEL, **NOISE)
    copies = [DriveLog(dict(log.channels), f"copy {k}") for k in range(4)]
    once = diagnose(log, unseen, MODEL.vehicle)
    often = diagnose([log, *copies], unseen, MODEL.vehicle)
    assert often.model == once.model
    assert often.training == (log.name,)
    assert often.predictions == once.predictions
    for told, copy in zip(often.advice, copies, strict=False):
        assert told.startswith(f"{copy.name} holds the same readings as {log.name}")
    for part in (copies[0], log.segment(-np.inf, np.inf), log.segment(5.0, 40.0)):
        with pytest.raises(InvalidInputError, match=f"same readings as {log.name}, which is lear"):
            diagnose(log, [unseen, part], MODEL.vehicle)


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


FACTORS = (1e-6, 1e-3, 1e3, 1e6)
Channels = dict[str, FloatArray]


def robot(mass: float) -> PowerModel:
    return PowerModel.paper(sized((mass / 60.0) ** (1 / 3)), K=0.05 * mass * 9.81, mu=0.6)


WAYS = 18


def strange(channels: Channels, rng: np.random.Generator, way: int) -> Channels:
    """Spoil a log in one way."""
    made = {name: np.array(values) for name, values in channels.items()}
    count = len(made["t"])
    name = str(rng.choice([each for each in made if each != "t"]))
    speeds, factor = ("v_left", "v_right"), float(rng.choice(FACTORS))
    first = int(rng.integers(0, count))
    match way:
        case 0:
            few = int(rng.integers(2, 6))
            return {each: values[:few] for each, values in made.items()}
        case 1:
            made[name][:] = 0.0
        case 2 | 3 as kind:
            made |= {each: np.full(count, 0.5 * (kind - 2)) for each in speeds}
        case 4:
            made[name][first : first + int(rng.integers(1, count))] = np.nan
        case 5:
            made["t"][first:] -= rng.choice([0.01, 1.0, 100.0])
        case 6:
            made[name] *= factor
        case 7:
            made = {each: v * (1.0 if each == "t" else factor) for each, v in made.items()}
        case 8:
            made[name][:] = rng.normal()
        case 9:
            made["t"] *= factor
        case 10:
            made[name][first] = rng.choice([np.inf, -np.inf, 1e300, 1e18])
        case 11:
            made[name] = rng.normal(size=count)
        case 12:
            made[name] = -made[name]
        case 13:  # one manoeuvre, or less
            part = slice(first, first + int(rng.integers(2, 100)))
            return {each: values[part] for each, values in made.items()}
        case 14:
            made |= {each: np.round(8 * made[each] / made[each].max()) for each in speeds}
        case 15:
            made |= {each: np.zeros(count) for each in ("x", "y", "yaw", "yaw_rate")}
        case 16:
            made |= {each: np.zeros(count) for each in made if each.startswith("p")}
        case _:
            kept = rng.random(count) < 0.3
            kept[:2] = True
            return {each: values[kept] for each, values in made.items()}
    return made


@pytest.mark.parametrize("seed", by_day(range(90), range(WAYS)))
def test_each_command_answers_or_refuses_by_name(tmp_path: Path, seed: int) -> None:
    rng = np.random.default_rng(seed)
    mass = float(rng.choice([1.0, 3.0, 60.0, 470.0, 5000.0]))
    model = robot(mass)
    drive: dict[str, Any] = {"duration": 40.0, "rate": 5.0, "power_noise": 0.01 * mass}
    pattern = str(rng.choice(["survey", "stop_and_go"]))
    log = simulate.drive(model, pattern, speed_noise=0.003, seed=seed, **drive)
    other = simulate.drive(model, "survey", seed=seed + 1, **drive)
    channels = strange(dict(log.channels), rng, seed % WAYS)
    if seed >= WAYS and rng.random() < 0.3:
        channels = strange(channels, rng, int(rng.integers(0, WAYS)))
    file = tmp_path / "strange.csv"
    header = ",".join(channels)
    np.savetxt(file, np.column_stack(list(channels.values())), "%.9g", ",", header=header,
               comments="")  # fmt: skip

    def watched() -> list[Any]:
        with file.open("rb") as lines:
            return [
                documents.event(event)
                for event in watch(lines_of(lines), model.vehicle, None, name="strange")
            ]

    def read() -> DriveLog:
        return DriveLog.read(file)

    given = Given(track=0.5, wheelbase=0.5, mass=mass)
    commands: dict[str, Callable[[], Any]] = {
        "start": lambda: documents.start(start(file, given)),
        "identify": lambda: documents.identification(identify(read(), model.vehicle)),
        "learned from": lambda: documents.diagnosis(diagnose(read(), other, model.vehicle)),
        "held out": lambda: documents.diagnosis(diagnose(other, read(), model.vehicle)),
        "watch": watched,
    }
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)  # NumPy's: a NaN on its way
        for name, command in commands.items():
            try:
                told = command()
            except EnergyPlanError as problem:
                assert len(str(problem)) > 25, name
                continue
            json.dumps(told, allow_nan=False)
