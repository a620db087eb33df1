"""Colour of a residual: told by chance and by what is as good as nothing, at any length."""

from __future__ import annotations

import numpy as np
import pytest
from by_day import by_day

from energyplan import DriveLog, PowerModel, diagnose, identify, simulate
from energyplan.diagnosis import Diagnosis
from energyplan.diagnosis.candidates import Part
from energyplan.diagnosis.judge import final_fit
from energyplan.fit.doubts import Adequacy, adequacy, left_over, predicted, shown_of_contacts
from energyplan.fit.drive import prepared
from energyplan.fit.estimate import Problem, problem_of
from energyplan.output import documents
from energyplan.path import FloatArray
from energyplan.power import HOTEL, TABLE_II
from energyplan.power.effects import COPPER_LOSS, catalogue

ROBOT = PowerModel.preset("quadriga:full:concrete")
CLEAN = simulate.drive(ROBOT, simulate.IDENTIFICATION, rate=10.0, measured="total")
SIZE = float(np.sqrt(np.mean(CLEAN.power**2)))


def judged(more: FloatArray) -> Adequacy:
    """Adequacy of the paper's model on a drive of which the log shows so much more power."""
    log = DriveLog({**CLEAN.channels, "power": CLEAN.power + more}, "drive")
    problem = Problem(prepared([log], ROBOT.vehicle), ROBOT.vehicle)
    return adequacy(problem.drives, left_over(final_fit(problem, ()).model, problem.drives))


@pytest.mark.parametrize("share", [0.005, 0.03, 0.15])
def test_white_noise_has_no_colour(share: float) -> None:
    for seed in range(8):
        noise = np.random.default_rng(seed).normal(0.0, share * SIZE, len(CLEAN))
        assert judged(noise).adequate


@pytest.mark.parametrize("period", [1.7, 6.0, 40.0])
def test_what_lasts_is_coloured_though_it_is_less_than_noise(period: float) -> None:
    noise = np.random.default_rng(5).normal(0.0, 0.04 * SIZE, len(CLEAN))
    driving = CLEAN.channel("v_left") != 0.0  # at rest, nothing could tell it from noise
    left = judged(noise + driving * 0.04 * SIZE * np.sin(2 * np.pi * CLEAN.t / period))
    assert left.residual < 2.0 * left.noise
    assert left.coloured
    assert left.time < period


def test_what_contacts_hold_on_straights_is_no_residual() -> None:
    truth = ROBOT.with_term(COPPER_LOSS, 0.002)
    log = simulate.drive(
        truth, simulate.IDENTIFICATION, rate=10.0, power_noise=3.0,
        speed_noise=0.003, noise={"yaw_rate": 0.01}, seed=3,
    )  # fmt: skip
    problem = problem_of([log], ROBOT.vehicle, ())
    fitted = final_fit(problem, [Part(catalogue()["copper_loss"])])
    (drive,) = problem.drives
    known = shown_of_contacts(fitted.model, drive)
    assert known is not None
    left = drive.power - predicted(fitted.model, drive)
    straight = drive.holds & (drive.held.v_left != 0.0) & (drive.settled > 0.0)
    before, after = (float(np.sqrt(np.mean(r[straight] ** 2))) for r in (left, left - known))
    noise = 3.0 * np.sqrt(drive.equations)
    assert before > 3.0 * noise
    assert after < 2.0 * noise


@pytest.mark.parametrize("preset", sorted(TABLE_II))
@pytest.mark.parametrize("seed", [6, 17])
def test_noise_that_a_sensor_remembers_for_a_moment_is_no_effect(preset: str, seed: int) -> None:
    """Drives as of the demo, which obey the model: noise of 10 W a side, correlated over 0.2 s."""
    truth = PowerModel.preset(preset)
    spiral, figure8 = (
        simulate.drive(
            truth, shape, duration=duration, power_noise=10.0, correlation_time=0.2,
            speed_noise=0.005, seed=seed, name=shape,
        )
        for shape, duration in (("spiral", 90.0), ("figure8", 40.0))
    )  # fmt: skip
    for log in (spiral, figure8):
        found = identify(log, truth.vehicle)
        assert found.adequacy.adequate
        assert not [text for text in found.warnings if "lacks something" in text]
    assert diagnose(spiral, figure8, truth.vehicle).verdict != "unexplained"


def runs_of_one_robot(seed: int, bumps: float = 0.0, hotel: float = 0.0) -> list[DriveLog]:
    """Runs that differ as a whole by 2 %, on ground with bumps of a share of K."""
    rng = np.random.default_rng(seed)
    K, way = ROBOT.coefficient("traction_resistance"), 1.3
    logs = []
    for k in range(5):
        factor = float(np.exp(0.02 * rng.standard_normal()))
        truth = ROBOT.with_coefficients(factor * np.array(ROBOT.coefficients))
        truth = truth.with_term(HOTEL, hotel) if hotel else truth
        parts = [simulate.IDENTIFICATION[i] for i in rng.permutation(len(simulate.IDENTIFICATION))]
        log = simulate.drive(
            truth, parts, rate=10.0, power_noise=8.0, speed_noise=0.003, correlation_time=0.1,
            measured="total", without={"accel_x"}, seed=100 * seed + k, name=f"run {k}",
        )  # fmt: skip
        speed = 0.5 * np.abs(log.channel("v_left") + log.channel("v_right"))
        at = np.cumsum(0.1 * speed) / way + float(rng.uniform())
        more = bumps * K * 2.0 * speed * np.sin(2 * np.pi * at)
        logs.append(DriveLog({**log.channels, "power": log.power + more}, log.name))
    return logs


def of_one_robot(seed: int, bumps: float = 0.0, hotel: float = 0.0) -> Diagnosis:
    """Diagnose such runs, of which the last judges."""
    logs = runs_of_one_robot(seed, bumps, hotel)
    return diagnose(logs[:-1], logs[-1], ROBOT.vehicle)


@pytest.mark.parametrize("seed", by_day(list(range(6)), [0, 1]))
def test_runs_that_differ_as_a_whole_lack_no_effect(seed: int) -> None:
    found = of_one_robot(seed)
    assert found.adequacy.adequate
    assert found.verdict == "no_effect"
    assert documents.diagnosis(found)["explanations"][0]["probability"] > 0.5
    assert documents.diagnosis(found)["no_probability"] is None


@pytest.mark.parametrize("seed", by_day([0, 1, 2], [0]))
def test_what_is_missing_is_no_factor_of_a_run_and_has_no_probability(seed: int) -> None:
    found = of_one_robot(seed, bumps=0.3)
    assert found.verdict == "unexplained"
    document = documents.diagnosis(found)
    assert all(one["probability"] is None for one in document["explanations"])
    assert all(one["probability"] is None for one in document["effects"])
    assert "none of those known" in document["no_probability"]
    assert "best of those known" in str(found)


@pytest.mark.parametrize("bumps", [0.0, 0.3])
def test_identify_does_not_call_a_difference_between_runs_a_lack(bumps: float) -> None:
    found = identify(runs_of_one_robot(1, bumps), ROBOT.vehicle)
    assert found.adequacy.adequate == (bumps == 0.0)
    lacks = any("the model lacks something" in warning for warning in found.warnings)
    assert lacks == (bumps > 0.0)


def test_an_effect_is_found_where_runs_differ() -> None:
    found = of_one_robot(3, hotel=60.0)
    assert [one.name for one in found.effects] == ["hotel_load"]
    assert found.verdict == "effect_found"
    assert found.no_probability is None
