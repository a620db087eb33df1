"""Models for runs to come: averaged by how they predict whole runs that were left out."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from made_drives import sized

from energyplan import DriveLog, Vehicle, diagnose, identify, simulate
from energyplan.diagnosis.averaging import averaged
from energyplan.diagnosis.candidates import Part
from energyplan.diagnosis.judge import final_fit, predict
from energyplan.fit.drive import Drive, prepared
from energyplan.fit.estimate import Problem
from energyplan.motion import Motion
from energyplan.power import HOTEL, PowerModel, effects
from energyplan.power.effects import Effect, catalogue, term

VEHICLE = Vehicle.preset("husky_a200")


def runs(count: int, spread: float, hotel: float = 0.0, seed: int = 0) -> list[DriveLog]:
    """Runs of one robot whose friction differs from run to run."""
    rng = np.random.default_rng(seed)
    made = []
    for k in range(count):
        K, mu = np.array([45.0, 0.5]) * np.exp(spread * rng.standard_normal(2))
        model = PowerModel.paper(VEHICLE, K, mu)
        if hotel:
            model = model.with_term(HOTEL, hotel)
        log = simulate.identification_drive(
            model, seed=seed + k, duration=130.0, rate=6.5, power_noise=3.0, speed_noise=0.003
        )
        made.append(replace(log, name=f"run {k}"))
    return made


def fitted(logs: list[DriveLog], parts: tuple[Part, ...], vehicle: Vehicle = VEHICLE):
    problem = Problem(prepared(logs, vehicle), vehicle)
    return problem, final_fit(problem, parts)


def test_few_runs_without_an_effect_are_left_as_they_are() -> None:
    problem, fit = fitted(runs(3, 0.1), ())
    assert averaged(problem, fit) is None


def one_way(rate: float, measured: str, size: float) -> tuple[DriveLog, DriveLog, Vehicle]:
    """Turns to one side alone, then to the other; friction that differs with the kind of turn.

    Wide turns take less than the model has for them, so that in left turns alone a drag of the
    outer side is as good a reason as any: and says nothing true of right turns.
    """
    vehicle = sized(size)
    K, mu = 0.04 * vehicle.mass * 9.81, 0.7
    model = PowerModel.paper(vehicle, K, mu).with_term(effects.MOBILISATION, 0.6 * mu)
    rng = np.random.default_rng(3)
    logs = []
    for k, side in enumerate((1.0, -1.0)):
        t = np.arange(0.0, 96.0, 1.0 / rate)
        piece = (t / 8.0).astype(int)
        v = np.array([0.3, 0.6, 0.9, 0.5, 0.0, 0.7] * 2)[piece]
        w = side * np.array([0.0, 0.15, 0.3, 0.6, 0.8, 0.0, 0.1, -0.5, 0.0, 0.2, 0.9, 0.4])[piece]
        half = vehicle.icr.half_track
        motion = Motion(v - half * w, v + half * w, vehicle.icr)
        # What no entry of the catalogue has: the ground changes every few seconds.
        ground = 1.0 + 0.25 * rng.standard_normal(30)[(t / 3.3).astype(int)]
        power = model.power(motion) * ground + 0.05 * K * rng.standard_normal(len(t))
        channels = {"t": t, "v_left": motion.v_left, "v_right": motion.v_right, "yaw_rate": w}
        if measured == "battery":
            channels |= {"voltage": np.full(len(t), 24.0), "current": power / 24.0}
        else:
            channels["power"] = power
        logs.append(DriveLog(channels, f"drive {k}"))
    return logs[0], logs[1], vehicle


ROBOTS = {
    "20 Hz": (20.0, "total", 1.0),
    "20 kg at 2 Hz": (2.0, "total", 0.7),
    "20 kg, battery side": (20.0, "battery", 0.7),
    "half a ton": (10.0, "total", 2.0),
}


@pytest.mark.parametrize("count", [1, 3])
@pytest.mark.parametrize("robot", ROBOTS)
def test_what_other_motions_do_not_bear_counts_little(robot: str, count: int) -> None:
    """An explanation of left turns, put into the fit of few runs; then the robot turns right."""
    seen, unseen, vehicle = one_way(*ROBOTS[robot])
    cut = np.linspace(0.0, seen.t[-1], count + 1)
    logs = [seen.segment(a, b) for a, b in pairwise(cut.tolist())]
    problem = Problem(prepared(logs, vehicle), vehicle)
    parts = (Part(catalogue()["turn_asymmetry"]),)
    alone = final_fit(problem, parts)
    told = averaged(problem, alone, parts)
    assert told is not None
    assert told.average is not None
    assert told.average.weight < 0.3
    assert told.average.left_out == "kind of motion" or count > 1
    (drive,) = prepared([unseen], vehicle)
    energy = float(drive.weights @ drive.power)
    errors = [
        abs(float(drive.weights @ predict(model, parts, drive).power) / energy - 1.0)
        for model in (alone.model, told.fitted.model)
    ]
    assert errors[1] < 0.5 * errors[0] + 0.02


def test_one_short_run_of_a_small_robot_gives_an_honest_interval() -> None:
    """20 kg, battery side, 2 Hz: what is left out may be two windows."""
    seen, unseen, vehicle = one_way(2.0, "battery", 0.7)
    told = diagnose(seen.segment(0.0, 20.0), unseen, vehicle)
    (one,) = told.predictions
    low, high = one.energy_interval
    assert low <= one.measured <= high
    assert any("fewer than three training drives" in line for line in told.advice)


def test_an_explanation_that_leaves_nothing_stays_alone() -> None:
    """One run, exact: also where all that is left out is told by nothing else."""
    truth = PowerModel.paper(VEHICLE, 45.0, 0.5).with_term(effects.TOWING_FORCE, 20.0)
    log = simulate.identification_drive(truth, seed=1, power_noise=1.0)
    problem = Problem(prepared([log], VEHICLE), VEHICLE)
    parts = (Part(catalogue()["towing_force"]),)
    assert averaged(problem, final_fit(problem, parts), parts) is None


def test_an_effect_the_hold_out_cannot_show_is_not_looked_for() -> None:
    """Learned with an accelerometer, judged without: an answer, and a word about it."""
    truth = PowerModel.paper(VEHICLE, 45.0, 0.5).with_term(effects.SPECIFIC_FORCE, VEHICLE.mass)
    log = simulate.identification_drive(truth, seed=1, power_noise=3.0)
    unseen = simulate.validation_drive(truth, seed=2, power_noise=3.0, without={"accel_x"})
    told = diagnose(log, unseen, VEHICLE)
    assert "specific_force" not in [effect.name for effect in told.effects]
    assert any("hold-out has no channel 'accel_x'" in line for line in told.advice)


def test_an_explanation_that_foretells_runs_counts_alone() -> None:
    """A load that every run has: two terms miss it by far, the explanation does not."""
    parts = (Part(Effect.of(HOTEL)),)
    problem, fit = fitted(runs(6, 0.0, hotel=60.0), parts)
    told = averaged(problem, fit, parts, [term("viscous_loss"), term("friction_mobilisation")])
    assert told is not None
    assert told.average is None or told.average.weight > 0.9


def test_intervals_are_no_narrower_than_what_runs_left_out_are_missed_by() -> None:
    """A fit to few runs leaves less of them than of others: of 36 the interval holds 80 to 98 %."""
    held = []
    for seed in range(6):
        logs = runs(10, 0.12, seed=100 * seed)
        told = diagnose(logs[:4], logs[4:], VEHICLE, effects=[catalogue()["hotel_load"]])
        held += [
            one.energy_interval[0] <= one.measured <= one.energy_interval[1]
            for one in told.predictions
        ]
    assert 0.8 <= np.mean(held) <= 0.98


def energy_error(model: PowerModel, logs: list[DriveLog]) -> float:
    """Mean relative error of the energies of drives."""
    drives = [Drive.of(log, model.vehicle) for log in logs]
    energies = [float(one.weights @ model.power(one.motion)) for one in drives]
    return float(
        np.mean([abs(e / log.energy - 1.0) for e, log in zip(energies, logs, strict=True)])
    )


def test_runs_that_nothing_explains_are_predicted_as_well_as_by_two_terms() -> None:
    logs = runs(16, 0.25, seed=10)
    problem, fit = fitted(logs[:8], ())
    told = averaged(problem, fit, (), [term("viscous_loss"), term("friction_mobilisation")])
    assert told is not None
    assert told.average is not None
    assert told.average.weight == 0.0
    model = told.fitted.model
    paper = identify(logs[:8], VEHICLE).model
    assert energy_error(model, logs[8:]) < 1.03 * energy_error(paper, logs[8:])
    assert [term.name for term in model.terms][:2] == ["slip_friction", "traction_resistance"]
    assert model.covariance is not None
    assert np.all(np.linalg.eigvalsh(model.covariance) > -1e-9)
    assert told.fitted.run_spread is not None
    assert told.fitted.run_spread == pytest.approx(0.2, abs=0.15)


@pytest.mark.parametrize("seed", [2000, 3000, 5000, 6000])
def test_a_further_term_that_left_out_runs_want_has_most_of_the_weight(seed: int) -> None:
    """Runs differ by 15 %, and all draw 30 W more: nothing was found, but it predicts better."""
    problem, fit = fitted(runs(5, 0.15, hotel=30.0, seed=seed), ())
    common = [one for entry in catalogue().values() if entry.common for one in entry.terms]
    told = averaged(problem, fit, (), common)
    assert told is not None
    assert told.average is not None
    assert told.average.extensions["hotel_load"] > 0.7
    assert told.fitted.model.coefficient("hotel_load") == pytest.approx(30.0, abs=8.0)


@pytest.mark.parametrize("seed", [3000, 7000])
def test_of_models_that_predict_four_runs_alike_none_has_most_of_the_weight(seed: int) -> None:
    """Friction differs by 15 % and nothing is hidden: four runs do not say which term is there."""
    problem, fit = fitted(runs(4, 0.15, seed=seed), ())
    common = [one for entry in catalogue().values() if entry.common for one in entry.terms]
    found = averaged(problem, fit, (), common)
    assert found is not None
    assert found.average is not None
    assert max(found.average.extensions.values()) < 0.25


def test_units_and_size_of_the_robot_do_not_matter() -> None:
    """A thousand times the mass and the power: the same weight and friction."""
    small = runs(5, 0.2, seed=3)
    large = [
        DriveLog({n: v * (1e3 if n.startswith("p_") else 1.0) for n, v in log.channels.items()},
                 log.name)
        for log in small
    ]  # fmt: skip
    heavy = VEHICLE.with_mass(1e3 * VEHICLE.mass)
    one, other = averaged(*fitted(small, ())), averaged(*fitted(large, (), heavy))
    assert one is not None
    assert other is not None
    assert one.average is not None
    assert other.average is not None
    assert other.average.weight == pytest.approx(one.average.weight, rel=1e-6)
    np.testing.assert_allclose(
        other.fitted.model.coefficients, [1.0, 1e3] * one.fitted.model.coefficients, rtol=1e-6
    )


def test_a_run_at_rest_says_nothing_and_breaks_nothing() -> None:
    logs = runs(5, 0.1, seed=20)
    still = {name: 0.0 * values for name, values in logs[0].channels.items() if name != "t"}
    logs.append(DriveLog({"t": logs[0].t, **still}, "rest"))
    told = averaged(*fitted(logs, ()))
    assert told is not None
    assert np.all(np.isfinite(told.fitted.model.coefficients))


def straights(model: PowerModel, seed: int, wear: float) -> DriveLog:
    """Straight lines at many speeds, and a power that goes up and down with time."""
    rng = np.random.default_rng(seed)
    speeds, holds = rng.uniform(-0.3, 1.0, 14), rng.uniform(1.0, 6.0, 14)
    log = simulate.drive(
        model, [simulate.Setpoint(v, v, hold=float(h)) for v, h in zip(speeds, holds, strict=True)],
        accel_limit=3.0, power_noise=2.0, speed_noise=0.02, measured="battery", seed=seed,
        without=("x", "y", "yaw", "yaw_rate", "accel_x"),
    )  # fmt: skip
    current = log.channels["current"] * (1.0 + wear * np.sin(log.t / 6.0 + seed))
    return DriveLog({**log.channels, "current": current}, "straight lines")


@pytest.mark.parametrize("seed", [2, 3])
def test_a_friction_that_no_drive_shows_is_as_usual_in_the_average_too(seed: int) -> None:
    """Two terms fitted to straight lines alone had mu = 40, from the noise of the speeds."""
    model = PowerModel.paper(VEHICLE, 40.0, 0.6)
    model = model.with_term(catalogue()["linear_inertia"].terms[0], VEHICLE.mass)
    train = straights(model.with_term(HOTEL, 30.0), seed, wear=0.2)
    unseen = simulate.validation_drive(
        model.with_term(HOTEL, 30.0), power_noise=2.0, measured="battery", seed=seed,
        without=("x", "y", "yaw", "yaw_rate", "accel_x"),
    )  # fmt: skip
    told = diagnose(train, unseen, VEHICLE)
    assert told.average is not None
    assert told.model.coefficient("slip_friction") == pytest.approx(0.6, abs=0.05)
    assert told.model.std_error("slip_friction") == pytest.approx(0.3, rel=0.1)
    assert told.after.rmse < told.before.rmse
