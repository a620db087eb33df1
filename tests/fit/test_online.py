"""Recursive identification against batch solutions, simulated truth and a physics engine."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from energyplan import simulate
from energyplan.errors import InvalidInputError, MissingChannelError
from energyplan.fit import identify
from energyplan.fit import online as kernel
from energyplan.fit.online import OnlineIdentifier
from energyplan.logs import DriveLog
from energyplan.power import HOTEL, SLIP, TRACTION, PowerModel, effects
from energyplan.simulate import Setpoint
from energyplan.vehicle import Vehicle

MARBLE = PowerModel.preset("quadriga:empty:marble")
CONCRETE = PowerModel.preset("quadriga:empty:concrete")
NOISE = {"power_noise": 5.0, "speed_noise": 0.005}

MIXED = [
    Setpoint(0.7, 0.7, 1.0), Setpoint(0.6, 0.1, 1.0), Setpoint(0.7, 0.7, 1.0),
    Setpoint(-0.5, 0.5, 1.0), Setpoint(0.5, 0.7, 1.0), Setpoint(0.1, 0.7, 1.0),
]  # fmt: skip
"""Straight lines, arcs and spins, a new one every two seconds or so."""


def _mixed(before: PowerModel, after: PowerModel, seed: int, tau: float) -> DriveLog:
    return simulate.drive(
        before, MIXED * 8, changes=[(60.0, after)], seed=seed, correlation_time=tau,
        accel_limit=0.8, **NOISE,
    )  # fmt: skip


# -- the recursion ------------------------------------------------------------------------------


def _state(p: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    matrices, vectors = np.zeros((2, p, p)), np.zeros((2, p))
    ring, scalars = np.zeros((kernel.LONGEST + 1, p + p * p + 1)), np.zeros(kernel.SCALARS)
    kernel.restart(matrices, vectors, ring, scalars)
    scalars[[kernel.VARIANCE, kernel.SAMPLES, kernel.REPEATS]] = 25.0, 40.0, 10.0
    scalars[[kernel.BLOCKS, kernel.MEAN_SIZE, kernel.MEAN_SQUARES]] = 4.0, 25.0, 100.0
    return matrices, vectors, ring, scalars


@pytest.mark.parametrize("p", [1, 2, 5])
def test_without_forgetting_it_is_the_batch_solution(p: int) -> None:
    rng = np.random.default_rng(p)
    matrices, vectors, ring, scalars = _state(p)
    scalars[kernel.SAMPLES], scalars[kernel.BLOCK_TIME] = 1e18, -1e18  # the noise is known
    phi = rng.normal(size=(400, p)) * 20.0
    power = phi @ np.linspace(0.5, 1.5, p) + rng.normal(0.0, 5.0, 400)
    settings = np.array([1e18, 1e18, np.inf, 0.0, 0.0])
    vectors[kernel.COEFFICIENTS] = 1.0
    assert kernel.advance_all(
        phi, power, np.full(400, 0.05), matrices, vectors, ring, scalars, settings
    ) == 400  # fmt: skip
    information = np.eye(p) + phi.T @ phi / 250.0
    batch = np.linalg.solve(information, np.ones(p) + phi.T @ power / 250.0)
    np.testing.assert_allclose(vectors[kernel.COEFFICIENTS], batch, rtol=1e-9)
    np.testing.assert_allclose(matrices[kernel.COVARIANCE], np.linalg.inv(information), rtol=1e-9)


def test_a_robot_that_hardly_moves_teaches_nothing() -> None:
    """What hardly is depends on how it moves otherwise: one that is always slow is learned from."""
    settings, period = np.array([1e18, 30.0, np.inf, 0.0, 0.0]), np.full(400, 0.05)
    driving, creeping = np.full((400, 1), 20.0), np.full((400, 1), 1.0)
    state = _state(1)
    kernel.advance_all(driving, 24.0 * np.ones(400), period, *state, settings)
    learned, noise = state[1].copy(), state[3][kernel.VARIANCE]
    kernel.advance_all(creeping, np.full(400, 9.0), period, *state, settings)
    np.testing.assert_array_equal(state[1], learned)
    assert state[3][kernel.VARIANCE] == noise
    slow = _state(1)
    kernel.advance_all(creeping, np.full(400, 9.0), period, *slow, settings)
    assert slow[1][kernel.COEFFICIENTS, 0] > 1.0


@pytest.mark.parametrize("other", [0.3, 0.1])
def test_a_power_that_is_always_zero_makes_nothing_surer_than_a_meter_could(other: float) -> None:
    online = OnlineIdentifier(MARBLE.vehicle)
    for k in range(300):
        online.update(200.0 * k, 0.5, other if k % 2 else 0.3, 0.0)
    covariance = online.model.covariance
    assert covariance is not None
    assert np.sqrt(covariance[1, 1]) > 1e-6 * MARBLE.vehicle.mass  # of the traction resistance [N]


def test_statistic_of_a_known_change_has_its_expectation() -> None:
    """White noise and known coefficients: the 8 s window's statistic is non-central chi-squared."""
    rng, found = np.random.default_rng(4), []
    for _ in range(60):
        matrices, vectors, ring, scalars = _state(1)
        scalars[kernel.REPEATS], scalars[kernel.SAMPLES] = 1.0, 1e18
        scalars[kernel.BLOCK_TIME] = -1e18
        matrices[kernel.INFORMATION] = 1e12
        settings = np.array([1e18, 1e18, np.inf, 0.0, 0.0])
        phi, power = np.full((160, 1), 10.0), rng.normal(2.0, 5.0, 160)
        kernel.advance_all(
            phi, power, np.full(160, 0.05), matrices, vectors, ring, scalars, settings
        )
        assert scalars[kernel.STRETCH] in (1.0, 2.0, 4.0, 8.0)
        found.append(scalars[kernel.STATISTIC])
    # 160 samples of mean 0.4 standard deviations: 160 * 0.16 + 1, and a little for the best of 4.
    assert np.mean(found) == pytest.approx(26.6, abs=4.0)


# -- surfaces -----------------------------------------------------------------------------------


@pytest.mark.parametrize("tau", [0.0, 0.3])
@pytest.mark.parametrize("load", ["empty", "full"])
def test_marble_to_concrete_within_ten_seconds(load: str, tau: float) -> None:
    before = PowerModel.preset(f"quadriga:{load}:marble")
    after = PowerModel.preset(f"quadriga:{load}:concrete")
    errors, delays = [], []
    for seed in range(10):
        log = _mixed(before, after, seed, tau)
        online = OnlineIdentifier(before.vehicle)
        assert online.run(log.segment(0.0, 60.0)) == ()
        known = online.model
        np.testing.assert_allclose(known.coefficients, before.coefficients, rtol=0.05)
        [change] = online.run(log.segment(60.0, 70.0))
        delays.append(change.t - 60.0)
        assert abs(change.onset - 60.0) < 4.0
        np.testing.assert_allclose(change.before.coefficients, before.coefficients, rtol=0.15)
        errors.append(np.abs(online.model.coefficients / after.coefficients - 1.0))
    assert max(delays) < 6.0
    assert np.median(np.array(errors), axis=0).max() < 0.05
    assert np.max(errors) < 0.15


def test_a_sure_prior_on_other_ground_is_given_up() -> None:
    """A mission that starts on concrete with a model identified on marble."""
    errors = []
    for seed in range(6):
        known = identify(simulate.identification_drive(MARBLE, seed=seed, **NOISE), MARBLE.vehicle)
        online = OnlineIdentifier(known.model)
        drive = simulate.drive(CONCRETE, MIXED * 4, seed=seed, accel_limit=0.8, **NOISE)
        [change] = online.run(drive.segment(0.0, 12.0))
        assert change.t < 8.0
        errors.append(np.abs(online.model.coefficients / CONCRETE.coefficients - 1.0))
    assert np.max(errors) < 0.1


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("tau", [0.0, 0.5, 2.0])
def test_no_false_alarm_in_an_hour(tau: float, seed: int) -> None:
    log = simulate.drive(
        CONCRETE, ["survey", "stop_and_go", "spiral", "rest"] * 10, duration=3600.0, seed=seed,
        correlation_time=tau, **NOISE,
    )  # fmt: skip
    assert len(log) >= 72_000
    for prior in (CONCRETE.vehicle, CONCRETE):
        online = OnlineIdentifier(prior)
        assert online.run(log) == ()
        np.testing.assert_allclose(online.model.coefficients, CONCRETE.coefficients, rtol=0.03)


def test_covariance_holds_on_correlated_noise() -> None:
    hits, drives = np.zeros(2), 60
    for seed in range(drives):
        log = simulate.drive(
            CONCRETE, MIXED * 8, seed=seed, accel_limit=0.8, power_noise=10.0, correlation_time=0.5
        )
        online = OnlineIdentifier(CONCRETE.vehicle)
        online.run(log)
        found = online.model
        error = np.abs(found.coefficients - CONCRETE.coefficients)
        hits += error < 1.96 * np.sqrt(np.diag(found.covariance))
    assert np.all(hits >= 0.88 * drives)


def test_what_is_not_excited_becomes_uncertain_and_no_more() -> None:
    online = OnlineIdentifier(CONCRETE.vehicle)
    online.run(simulate.drive(CONCRETE, "survey", duration=120.0, seed=1, **NOISE))
    known = online.model
    straight = simulate.drive(CONCRETE, [Setpoint(0.6, 0.6, 3600.0)], seed=2, power_noise=5.0)
    online.run(straight)
    later = online.model
    assert later.std_error("slip_friction") > 5 * known.std_error("slip_friction")
    assert later.std_error("slip_friction") < 0.5 * 0.627 * 1.1
    assert later.std_error("traction_resistance") < 2.0
    assert later.coefficient("slip_friction") == pytest.approx(0.627, rel=0.05)


# -- in and out ---------------------------------------------------------------------------------


def test_samples_one_by_one_are_the_log() -> None:
    log = _mixed(MARBLE, CONCRETE, 0, 0.0).segment(0.0, 75.0)
    whole, single = OnlineIdentifier(MARBLE), OnlineIdentifier(MARBLE)
    whole.run(log)
    # The first sample sets the clock of one that has no log to learn the period from.
    single.update(-0.05, 0.0, 0.0, 0.0)
    alarms = [
        single.update(t, left, right, power)
        for t, left, right, power in zip(
            log.t, log.channel("v_left"), log.channel("v_right"), log.power, strict=True
        )
    ]
    assert sum(alarms) == len(whole.changes) == len(single.changes) == 1
    assert log.t[alarms.index(True)] == whole.changes[0].t
    np.testing.assert_allclose(single.model.coefficients, whole.model.coefficients, rtol=1e-6)
    np.testing.assert_allclose(single.model.covariance, whole.model.covariance, rtol=1e-6)


def test_resumes_from_the_model_it_exports() -> None:
    log = simulate.drive(CONCRETE, "survey", duration=240.0, seed=3, **NOISE)
    through, first = OnlineIdentifier(CONCRETE.vehicle), OnlineIdentifier(CONCRETE.vehicle)
    through.run(log)
    first.run(log.segment(0.0, 120.0))
    saved = first.model
    assert saved.covariance is not None
    assert saved.residual is not None
    second = OnlineIdentifier(saved)
    at_once = second.model
    np.testing.assert_allclose(at_once.coefficients, saved.coefficients)
    np.testing.assert_allclose(at_once.covariance, saved.covariance, rtol=1e-2)
    second.run(log.segment(120.0, 241.0))
    np.testing.assert_allclose(second.model.coefficients, through.model.coefficients, rtol=0.005)
    np.testing.assert_allclose(
        np.diag(second.model.covariance), np.diag(through.model.covariance), rtol=0.3
    )


def test_battery_power_with_losses() -> None:

    vehicle = replace(Vehicle.preset("quadriga:empty"), drive_efficiency=0.8, regen_efficiency=0.5)
    truth = PowerModel(vehicle, (SLIP, TRACTION, HOTEL), [0.627, 113.0, 30.0])
    log = simulate.identification_drive(truth.battery_side(), measured="total", power_noise=5.0)
    online = OnlineIdentifier(vehicle, terms=truth.terms, battery=True)
    assert online.run(log) == ()
    np.testing.assert_allclose(online.model.coefficients, truth.coefficients, rtol=0.05)
    single = OnlineIdentifier(truth, battery=True)
    for k in range(400):
        assert not single.update(*(float(log.channel(c)[k]) for c in
                                   ("t", "v_left", "v_right", "power")))  # fmt: skip
    np.testing.assert_allclose(single.model.coefficients, truth.coefficients, rtol=0.1)


def test_terms_with_channels() -> None:
    truth = CONCRETE.with_term(effects.GRADE, 83.1)
    log = simulate.drive(truth, "survey", duration=120.0, slope=0.05, seed=1, **NOISE)
    online = OnlineIdentifier(CONCRETE.vehicle, terms=truth.terms)
    online.run(log)
    np.testing.assert_allclose(online.model.coefficients, truth.coefficients, rtol=0.05)
    single = OnlineIdentifier(truth)
    single.update(0.0, 0.5, 0.5, 100.0, slope=0.01)
    with pytest.raises(MissingChannelError, match="slope"):
        single.update(0.05, 0.5, 0.5, 100.0)


def test_bad_input() -> None:
    for setting in ({"memory": 0.0}, {"spread": -1.0}, {"false_alarms": np.nan}, {"material": 1.0}):
        with pytest.raises(InvalidInputError, match=next(iter(setting))):
            OnlineIdentifier(CONCRETE, **setting)
    online = OnlineIdentifier(CONCRETE)
    online.update(1.0, 0.5, 0.5, 100.0)
    with pytest.raises(InvalidInputError, match="time must increase"):
        online.update(1.0, 0.5, 0.5, 100.0)
    with pytest.raises(InvalidInputError, match="finite"):
        online.update(1.1, 0.5, np.nan, 100.0)


# -- other robots than the simulator's own ------------------------------------------------------


@pytest.mark.shared
@pytest.mark.parametrize("drive", ["s1_ident", "s1_valid", "s2_ident", "s2_valid"])
def test_physics_engine(shared_data, drive: str) -> None:
    folder = shared_data / "quadriga_mujoco"
    still = OnlineIdentifier(Vehicle.preset("quadriga:full"))
    assert still.run(DriveLog.read(folder / f"none_{drive}.csv.gz")) == ()
    np.testing.assert_allclose(still.model.coefficients, [0.647, 118.0], rtol=0.02)
    told = json.loads((folder / f"load_change_{drive}.json").read_text())
    [when] = [v for k, v in told["effects"]["load_change"].items() if k.startswith("time")]
    loaded = OnlineIdentifier(Vehicle.preset("quadriga:full"))
    [change] = loaded.run(DriveLog.read(folder / f"load_change_{drive}.csv.gz"))
    assert when < change.t < when + 10.0


@pytest.mark.parametrize("ticks", [3, 4, 11, 32, 45])
def test_a_change_is_told_by_the_score_test_of_the_window_that_shows_it_best(ticks: int) -> None:
    """Windows of 4, 8, 16 and 32 ticks back from the last, by linear algebra of another library."""
    rng, p = np.random.default_rng(ticks), 3
    ring = np.zeros((kernel.LONGEST + 1, p + p * p + 1))
    for row in ring[: min(ticks, kernel.LONGEST)]:
        phi = rng.normal(size=(5, p))
        row[:] = [*rng.normal(size=p), *(phi.T @ phi).ravel(), rng.uniform(1, 9)]
    root = rng.normal(size=(p, p))
    covariance, repeats, variance = root @ root.T, 1.7, 2.3
    matrices, vectors = np.stack([np.eye(p), covariance]), np.zeros((2, p))
    scalars = np.zeros(kernel.SCALARS)
    scalars[[kernel.TICKS, kernel.REPEATS, kernel.VARIANCE]] = ticks, repeats, variance
    kernel.look(matrices, vectors, ring, scalars)
    last_first = [ring[k % kernel.LONGEST] for k in range(ticks - 1, -1, -1)]
    best, expected = 0.0, (0.0, 0.0, 0.0)
    shift = np.zeros(p)
    for size in (4, 8, 16, 32):
        if size > ticks:
            break
        summed = np.sum(last_first[:size], axis=0)
        score, window = summed[:p], summed[p:-1].reshape(p, p)
        chance = repeats * window + window @ covariance @ window
        statistic = score @ np.linalg.solve(chance, score)
        if statistic > best:
            best, shift = statistic, np.linalg.solve(np.eye(p) + window / repeats, score / repeats)
            material = np.sqrt(shift @ window @ shift * variance / summed[-1])
            expected = (statistic, 0.25 * size, material)
    found = scalars[[kernel.STATISTIC, kernel.STRETCH, kernel.MATERIAL]]
    assert found == pytest.approx(expected, rel=1e-4)
    assert vectors[kernel.SHIFT] == pytest.approx(shift, rel=1e-9)
