"""Identification against simulated truth, closed forms and second algorithms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from by_day import by_day
from scipy.optimize import linprog
from scipy.signal import lfilter
from scipy.stats import binom, chi2

from energyplan import simulate
from energyplan.errors import (
    InvalidInputError,
    MissingChannelError,
    NotIdentifiableError,
    UnknownNameError,
)
from energyplan.fit import ICREstimate, fit_icr, fit_residual, icr_from_spin, identify, solvers
from energyplan.fit.drive import Drive
from energyplan.fit.identification import PowerRegression
from energyplan.io.husky import read_husky
from energyplan.logs import DriveLog
from energyplan.output import documents
from energyplan.power import HOTEL, SLIP, TABLE_II, TRACTION, PowerModel, Term, effects
from energyplan.simulate import Setpoint
from energyplan.vehicle import TreadICR, Vehicle

NOISE = {"power_noise": 5.0, "speed_noise": 0.005, "correlation_time": 0.3}


@pytest.fixture(scope="module")
def truth() -> PowerModel:
    return PowerModel.preset("quadriga:full:concrete")


@pytest.fixture(scope="module")
def spiral(truth: PowerModel) -> DriveLog:
    return simulate.drive(truth, "spiral", seed=1, **NOISE)


# -- noise in the speeds ------------------------------------------------------------------------


def read_by(encoder: float, log: DriveLog) -> DriveLog:
    """Return a log whose speeds are counts over each sample, in steps of a speed [m/s]."""
    channels = dict(log.channels)
    for name in ("v_left", "v_right"):
        counts = np.floor(np.cumsum(channels[name]) / encoder)
        channels[name] = encoder * np.diff(counts, prepend=0.0)
    return DriveLog(channels)


@pytest.mark.parametrize("rate", [2.0, 5.0, 20.0, 100.0])
@pytest.mark.parametrize(
    ("noise", "step"), [(0.01, 0.0), (0.1, 0.0), (0.03, 0.05), (0.1, 0.05), (0.0, 0.3)]
)
def test_noisy_speeds_bias_nothing(rate: float, noise: float, step: float) -> None:
    """Errors in variables: K by too little and a load at rest by too much, were they ignored.

    Shares of the usual speed; the mean error of three drives against a drive's standard error. By
    chance it is 1.2 such errors in one case of twenty.
    """
    speed = 0.6
    truth = PowerModel.preset("quadriga:empty:concrete").with_term(HOTEL, 30.0)
    pattern = [(name, 0.7 * time) for name, time in simulate.IDENTIFICATION]
    misses = []
    for seed in range(3):
        log = simulate.drive(
            truth, pattern, rate=rate, speed=speed, accel_limit=0.4, power_noise=8.0,
            speed_noise=noise * speed, seed=seed,
        )  # fmt: skip
        log = read_by(step * speed, log) if step else log
        found = identify(log, truth.vehicle, terms=(SLIP, TRACTION, HOTEL))
        errors = np.array([found.std_error[term.name] for term in truth.terms])
        misses.append((found.model.coefficients - truth.coefficients) / errors)
    assert np.all(np.abs(np.mean(misses, axis=0)) < 2.0)


# -- the fits -----------------------------------------------------------------------------------


def _linear_program(X: np.ndarray, y: np.ndarray, bounds: solvers.Bounds) -> np.ndarray:
    """Eq. 7 in its textbook form: residuals split into positive and negative parts."""
    n, p = X.shape
    cost = np.concatenate([np.zeros(p), np.ones(2 * n)])
    equations = np.hstack([X, np.eye(n), -np.eye(n)])
    limits = [*zip(bounds.lower, bounds.upper, strict=True), *[(0, None)] * (2 * n)]
    return linprog(cost, A_eq=equations, b_eq=y, bounds=limits, method="highs-ipm").x[:p]


def _regression(n: int, p: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    X = np.abs(rng.normal(size=(n, p))) * 10.0 ** np.arange(p)
    noise = lfilter([1.0], [1.0, -0.9], rng.standard_t(2, n))
    return X, X @ (1.0 + np.arange(p)) + 3.0 * noise


@pytest.mark.parametrize(("n", "p", "seed"), [(60, 1, 0), (200, 2, 1), (400, 4, 2)])
def test_lad_is_the_textbook_linear_program(n: int, p: int, seed: int) -> None:
    X, y = _regression(n, p, seed)
    free = solvers.Bounds(np.full(p, -np.inf), np.full(p, np.inf))
    np.testing.assert_allclose(solvers.lad(X, y, free), _linear_program(X, y, free), rtol=1e-6)
    tight = solvers.Bounds(np.zeros(p), np.full(p, 1.5))
    bounded = solvers.lad(X, y, tight)
    other = _linear_program(X, y, tight)
    assert np.abs(y - X @ bounded).sum() == pytest.approx(np.abs(y - X @ other).sum(), rel=1e-9)
    assert np.all(bounded <= 1.5)


@pytest.mark.parametrize("seed", range(4))
def test_lad_of_many_rows_is_certified_optimal(seed: int) -> None:
    """A vertex is optimal where its rows' multipliers balance all other rows with |d| <= 1."""
    n, p = 30_000, 3
    X, y = _regression(n, p, seed)
    c = solvers.lad(X, y, solvers.Bounds(np.full(p, -np.inf), np.full(p, np.inf)))
    residual = y - X @ c
    basis = np.argsort(np.abs(residual))[:p]
    assert np.all(np.abs(residual[basis]) < 1e-9 * np.abs(y).max())
    others = np.delete(np.arange(n), basis)
    pull = X[others].T @ np.sign(residual[others])
    assert np.all(np.abs(np.linalg.solve(X[basis].T, -pull)) <= 1 + 1e-6)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(
    ("levels", "step"), [(6, 1.0), (3, 3.0), (6, 10.0)], ids=["fine", "few arcs", "coarse power"]
)
def test_lad_of_quantised_speeds_has_ties(levels: int, step: float, seed: int) -> None:
    """A reading may be the fitted power exactly, in more rows than any band holds."""
    rng = np.random.default_rng(seed)
    X = rng.integers(0, levels, (30_000, 2)) / 5.0
    y = step * np.round((X @ [3.0, 7.0] + rng.normal(size=len(X))) / step)
    free = solvers.Bounds(np.full(2, -np.inf), np.full(2, np.inf))
    found = solvers.lad(X, y, free)
    rows, counts = np.unique(np.column_stack([X, y]), axis=0, return_counts=True)
    weighted = _linear_program(rows[:, :2] * counts[:, None], rows[:, 2] * counts, free)
    best = np.abs(y - X @ weighted).sum()
    assert np.abs(y - X @ found).sum() == pytest.approx(best, rel=1e-9)


def test_huber_between_mean_and_median() -> None:
    rng = np.random.default_rng(3)
    X, free = np.ones((4000, 1)), solvers.Bounds(np.array([-np.inf]), np.array([np.inf]))
    y = rng.normal(10.0, 1.0, 4000)
    clean = solvers.huber(X, y, free)[0]
    assert clean == pytest.approx(y.mean(), abs=0.02)
    y[:400] = 1000.0
    assert solvers.huber(X, y, free)[0] == pytest.approx(10.0, abs=0.3)
    assert y.mean() > 100.0


def test_simplex_agrees_with_the_linear_program(truth: PowerModel, spiral: DriveLog) -> None:
    for log in (spiral, simulate.identification_drive(truth, seed=5, **NOISE)):
        exact = identify(log, truth.vehicle, method="lad").model.coefficients
        searched = identify(log, truth.vehicle, method="simplex").model.coefficients
        np.testing.assert_allclose(searched, exact, rtol=1e-3)


# -- the paper ----------------------------------------------------------------------------------


@pytest.mark.parametrize("method", ["lad", "simplex", "huber"])
@pytest.mark.parametrize("pair", sorted(TABLE_II))
def test_table_two_from_a_noisy_spiral(pair: str, method: str) -> None:
    model = PowerModel.preset(pair)
    log = simulate.drive(model, "spiral", seed=2, power_noise=5.0, speed_noise=0.005)
    found = identify(log, model.vehicle, method=method)
    np.testing.assert_allclose(found.model.coefficients, model.coefficients, rtol=0.02)
    assert found.icr.half_track == pytest.approx(0.47, rel=0.005)
    other = simulate.drive(model, "figure8", seed=3, power_noise=5.0, speed_noise=0.005)
    assert abs(fit_residual(found.model, other).energy_error) < 0.02


def _hoisted(log: DriveLog) -> DriveLog:
    still = {name: np.zeros(len(log)) for name in ("x", "y", "yaw", "yaw_rate")}
    return DriveLog({**log.channels, **still}, "hoisted")


def test_hoisted_vehicle() -> None:
    vehicle = Vehicle.preset("quadriga:empty")
    log = _hoisted(simulate.drive(PowerModel.paper(vehicle, 59.0, 0.0), "spiral", seed=4, **NOISE))
    found = identify(log, vehicle, terms=[TRACTION])
    assert found.model.coefficient("traction_resistance") == pytest.approx(59.0, rel=0.02)
    assert any("tread ICRs were kept" in text for text in found.warnings)
    with pytest.raises(NotIdentifiableError, match=r"\(mu\).* did not turn .* --hoisted"):
        identify(log, vehicle)
    straight = _hoisted(simulate.drive(PowerModel.paper(vehicle, 59.0, 0.0), "straight", seed=4))
    with pytest.raises(NotIdentifiableError, match=r"slip_friction \(mu\).*spin"):
        identify(straight, vehicle)


# -- standard errors ----------------------------------------------------------------------------


@pytest.mark.parametrize("drives", by_day([20, 200], [20]))
@pytest.mark.parametrize("method", ["lad", "huber"])
def test_standard_errors_are_those_of_many_drives(method: str, drives: int) -> None:
    model = PowerModel.preset("quadriga:empty:concrete")
    score = []
    for seed in range(drives):
        log = simulate.drive(
            model, "spiral", seed=seed, power_noise=10.0, speed_noise=0.005, correlation_time=0.5
        )
        found = identify(log, model.vehicle, method=method)
        error = found.model.coefficients - model.coefficients
        score.append(error / np.array(list(found.std_error.values())))
    # errors in standard errors: their squares' sum is chi-squared, the hits of 95 % are binomial
    squares = np.sum(np.square(score), axis=0)
    assert np.all(squares > chi2.ppf(1e-3, drives))
    assert np.all(squares < chi2.ppf(1 - 1e-3, drives))
    hits = np.sum(np.abs(score) < 1.96, axis=0)
    assert np.all(hits >= binom.ppf(1e-3, drives, 0.95))
    assert np.all(hits <= 0.99 * drives) or drives < 100


def test_error_of_the_tread_icrs_is_passed_on(truth: PowerModel) -> None:
    """What the covariance takes over is what identification with another ICR would find."""
    log = simulate.drive(truth, "spiral")
    error = 0.005
    near, far = (
        identify(log, truth.vehicle, icr=TreadICR.symmetric(0.6 + shift), method="huber")
        for shift in (-error, error)
    )
    change = 0.5 * (far.model.coefficients - near.model.coefficients)
    covariance = np.zeros((3, 3))
    covariance[:2, :2] = error**2
    off = truth.vehicle.with_icr(TreadICR.symmetric(0.6))
    model = identify(log, off, icr="vehicle", method="huber").model
    estimate = ICREstimate(off.icr, covariance, 10.0, "yaw")
    passed = PowerRegression([Drive.of(log, off)], model).inherited(model, estimate)
    np.testing.assert_allclose(passed, np.outer(change, change), rtol=0.05, atol=1e-12)
    assert identify(log, off, icr="vehicle").icr_std_error is None


# -- tread ICRs ---------------------------------------------------------------------------------


def test_icr_from_a_spin_is_equation_five(truth: PowerModel) -> None:
    log = simulate.drive(truth, "spin", seed=1, speed_noise=0.005, noise={"yaw": 0.02})
    found = icr_from_spin(log)
    assert found.icr.left == pytest.approx(0.47, abs=3 * found.std_error["left"])
    assert 0 < found.std_error["left"] < 0.01
    exact = simulate.drive(truth, "spin")
    counted = float(np.sum(np.abs(np.diff(exact.channel("yaw")))))
    bare = DriveLog({k: exact.channel(k) for k in ("t", "v_left", "v_right", "p_left", "p_right")})
    by_hand = icr_from_spin(bare, angle=counted, angle_error=0.01 * counted)
    assert by_hand.icr.left == pytest.approx(0.47, rel=1e-3)
    assert by_hand.std_error["left"] == pytest.approx(0.0047, rel=1e-3)
    with pytest.raises(NotIdentifiableError, match="angle"):
        icr_from_spin(bare)
    with pytest.raises(NotIdentifiableError, match="no spin"):
        icr_from_spin(simulate.drive(truth, "spiral"))


def test_icr_from_a_biased_noisy_yaw_rate(truth: PowerModel) -> None:
    log = simulate.drive(
        truth, ["straight", "spiral"], seed=2, noise={"yaw_rate": 0.05}, biases={"yaw_rate": 0.02},
        without=("x", "y", "yaw"), **NOISE,
    )  # fmt: skip
    found = fit_icr(log, TreadICR.symmetric(0.3))
    assert found.source == "yaw_rate"
    assert found.icr.left == found.icr.right
    assert found.icr.left == pytest.approx(0.47, abs=3 * found.std_error["left"])
    assert found.std_error["left"] < 0.003


def test_icr_does_not_shrink_with_speed_noise(truth: PowerModel) -> None:
    """Least squares of yaw rate on speeds this noisy would be 5 % out; the instrument is not."""
    log = simulate.drive(
        truth, ["spin", "spiral"], seed=6, speed_noise=0.15, without=("x", "y", "yaw")
    )
    difference = log.channel("v_right") - log.channel("v_left")
    rate = log.channel("yaw_rate")
    naive = float(difference @ difference / (difference @ rate)) / 2
    found = fit_icr(log, truth.vehicle.icr)
    assert abs(naive - 0.47) > 0.02
    assert found.icr.left == pytest.approx(0.47, abs=3 * found.std_error["left"])
    assert found.std_error["left"] < 0.004


def test_asymmetric_icrs_from_a_pose(truth: PowerModel) -> None:
    icr = TreadICR(0.50, 0.42, 0.06)
    model = PowerModel.paper(truth.vehicle.with_icr(icr), 118.0, 0.647)
    log = simulate.identification_drive(
        model, seed=1, noise={"x": 0.01, "y": 0.01, "yaw": 0.01}, **NOISE
    )
    found = identify(log, truth.vehicle)
    errors = found.icr_std_error
    assert errors is not None
    for name in ("left", "right", "longitudinal"):
        assert getattr(found.icr, name) == pytest.approx(getattr(icr, name), abs=3 * errors[name])
        assert 0 < errors[name] < 0.005
    np.testing.assert_allclose(found.model.coefficients, [0.647, 118.0], rtol=0.02)


def test_symmetric_fit_keeps_the_known_offset(truth: PowerModel) -> None:
    icr = TreadICR(0.50, 0.42, 0.06)
    model = PowerModel.paper(truth.vehicle.with_icr(icr), 118.0, 0.647)
    log = simulate.drive(model, "spiral", seed=1, without=("x", "y"), **NOISE)
    found = fit_icr(log, TreadICR(0.6, 0.52, 0.06))
    assert found.icr.left == pytest.approx(0.50, abs=0.003)
    assert found.icr.right == pytest.approx(0.42, abs=0.003)
    assert found.icr.longitudinal == 0.06


def test_an_icr_that_is_hardly_known_is_kept_and_said_so(truth: PowerModel) -> None:
    """Read once a second, where commands last as long, the slip track is 0.65 +- 0.69 m."""
    speeds = np.random.default_rng(3).uniform(-0.6, 0.6, (40, 2))
    log = simulate.drive(
        truth, [simulate.Setpoint(*pair, hold=1.0) for pair in speeds], rate=1.0, accel_limit=3.0,
        speed_noise=0.02, noise={"yaw_rate": 0.02}, without=("x", "y", "yaw"), seed=3,
    )  # fmt: skip
    with pytest.raises(NotIdentifiableError, match=r"slip track is .* \+- .* more often"):
        fit_icr(log, truth.vehicle.icr)
    found = identify(log, truth.vehicle)
    assert found.icr == truth.vehicle.icr
    assert any("were kept" in text and "more often" in text for text in found.warnings)


def test_no_friction_drives_a_robot_on() -> None:
    """Noise puts a small resistance below zero: it is none then, and the other term fits that."""
    vehicle = Vehicle.preset("husky_a200")
    truth = PowerModel.paper(vehicle, K=0.3, mu=0.6)
    found = [
        identify(
            simulate.identification_drive(truth, power_noise=8.0, seed=seed), vehicle,
            method="windows",
        ).model for seed in range(8)
    ]  # fmt: skip
    K = np.array([model.coefficient("traction_resistance") for model in found])
    assert np.all(K >= 0.0)
    assert np.any(K == 0.0)
    for model, error in zip(found, K - 0.3, strict=True):
        assert abs(error) < 4.0 * (model.std_error("traction_resistance") or 0.0)
        assert model.coefficient("slip_friction") == pytest.approx(0.6, abs=0.01)


def test_without_yaw_the_icr_is_kept_and_said_so(truth: PowerModel) -> None:
    log = simulate.drive(truth, "spiral", seed=1, without=("x", "y", "yaw", "yaw_rate"), **NOISE)
    found = identify(log, truth.vehicle)
    assert found.icr == truth.vehicle.icr
    assert found.icr_std_error is None
    assert any("no yaw" in text for text in found.warnings)
    with pytest.raises(NotIdentifiableError, match="yaw"):
        identify(log, truth.vehicle, icr="symmetric")
    with pytest.raises(NotIdentifiableError, match="pose"):
        fit_icr(simulate.drive(truth, "spin", without=("x", "y")), truth.vehicle.icr,
                asymmetric=True)  # fmt: skip


# -- what cannot be identified ------------------------------------------------------------------


@pytest.mark.parametrize(
    ("pattern", "terms", "words"),
    [
        ("straight", (SLIP, TRACTION), r"slip_friction \(mu\).*a spin on the spot"),
        ("spin", (SLIP, TRACTION), r"slip_friction.*traction.*straight lines"),
        ([Setpoint(0.3, 0.6, 30.0)], (SLIP, TRACTION), r"slip_friction.*traction.*straight lines"),
        # no motor generates then, so that every power has the same factor
        (["spin", "straight"], (SLIP, TRACTION, effects.DRIVE_LOSS), "drive_efficiency"),
    ],
)
def test_what_a_drive_does_not_show_is_refused(
    truth: PowerModel, pattern: object, terms: tuple[Term, ...], words: str
) -> None:
    log = simulate.drive(truth, pattern, seed=1, **NOISE)
    log = log if effects.DRIVE_LOSS in terms else log.segment(2.5, 29.0)
    with pytest.raises(NotIdentifiableError, match=words):
        identify(log, truth.vehicle, terms=terms)


def test_drives_tell_together_what_each_does_not(truth: PowerModel) -> None:
    line, spin = (simulate.drive(truth, one, seed=1, **NOISE) for one in ("straight", "spin"))
    together = identify([line, spin], truth.vehicle).model
    np.testing.assert_allclose(together.coefficients, truth.coefficients, rtol=0.03)
    alone = identify(line, truth.vehicle, terms=[TRACTION]).model
    assert alone.coefficient("traction_resistance") == pytest.approx(118.0, rel=0.02)


def test_a_copy_of_a_log_is_learned_from_once(truth: PowerModel) -> None:
    """It made standard errors smaller by the root of two."""
    log = simulate.identification_drive(truth, seed=1, **NOISE)
    copy, part = replace(log, name="copy"), replace(log.segment(40.0, 90.0), name="part")
    other = replace(simulate.identification_drive(truth, seed=2, **NOISE), name="other")
    alone = identify(log, truth.vehicle)
    for second, twice in ((copy, True), (part, True), (other, False)):
        found = identify([log, second], truth.vehicle)
        assert any(f"{second.name} holds the same" in t for t in found.warnings) == twice
        assert np.array_equal(found.model.covariance, alone.model.covariance) == twice


def test_power_must_be_measured(truth: PowerModel, spiral: DriveLog) -> None:
    silent = {"power": np.zeros(len(spiral)), "p_left": spiral.t, "p_right": -spiral.t}
    with pytest.raises(NotIdentifiableError, match="zero throughout; check"):
        identify(DriveLog({**spiral.channels, **silent}), truth.vehicle)


def test_outliers_do_not_pull(truth: PowerModel, spiral: DriveLog) -> None:
    spikes = np.array(spiral.channel("p_left"))
    spikes[::50] += 5000.0
    log = DriveLog({**spiral.channels, "p_left": spikes})
    for method in ("lad", "huber"):
        found = identify(log, truth.vehicle, method=method)
        np.testing.assert_allclose(found.model.coefficients, truth.coefficients, rtol=0.04)


def test_missing_channel_is_named(truth: PowerModel, spiral: DriveLog) -> None:
    with pytest.raises(MissingChannelError, match="slope"):
        identify(spiral, truth.vehicle, terms=[SLIP, TRACTION, effects.GRADE])


def test_bad_requests(truth: PowerModel, spiral: DriveLog) -> None:
    with pytest.raises(InvalidInputError, match="no logs"):
        identify([], truth.vehicle)
    with pytest.raises(InvalidInputError, match="no terms"):
        identify(spiral, truth.vehicle, terms=[])
    with pytest.raises(UnknownNameError, match="method"):
        identify(spiral, truth.vehicle, method="ols")
    with pytest.raises(InvalidInputError, match="icr"):
        identify(spiral, truth.vehicle, icr="guess")
    with pytest.raises(InvalidInputError, match="level"):
        identify(spiral, truth.vehicle).interval("slip_friction", 95.0)


# -- any terms ----------------------------------------------------------------------------------


def test_nonlinear_fit_of_exact_data_is_exact(truth: PowerModel) -> None:
    model = truth.with_term(effects.COPPER_LOSS, 2e-4).with_term(effects.REGENERATION_LOSS, 0.6)
    log = simulate.identification_drive(model)
    found = identify(log, truth.vehicle, terms=model.terms)
    np.testing.assert_allclose(found.model.coefficients, model.coefficients, rtol=1e-4)


def test_battery_log_gives_the_motor_side_model(truth: PowerModel) -> None:
    vehicle = Vehicle.preset("quadriga:full")
    lossy = replace(vehicle, drive_efficiency=0.8, regen_efficiency=0.3)
    model = PowerModel.paper(lossy, 118.0, 0.647)
    log = simulate.identification_drive(model.battery_side(), measured="battery", seed=1)
    assert log.battery_side
    found = identify(log, lossy)
    np.testing.assert_allclose(found.model.coefficients, [0.647, 118.0], rtol=1e-3)
    assert abs(found.residual.energy_error) < 0.002
    blind = identify(log, vehicle)
    assert blind.model.coefficient("traction_resistance") > 1.15 * 118.0


def test_bounds_are_respected_and_reported(truth: PowerModel) -> None:
    model = truth.with_coefficients([0.647, 118.0]).with_term(HOTEL, 0.0)
    log = simulate.identification_drive(model, seed=1, biases={"p_left": -20.0}, **NOISE)
    for method in ("lad", "simplex", "huber"):
        found = identify(log, truth.vehicle, terms=model.terms, method=method)
        assert found.model.coefficient("hotel_load") == 0.0
        assert any("hotel_load" in t and "nothing of it shows" in t for t in found.warnings)
    light = Vehicle.from_geometry(
        "light", mass=0.2 * truth.vehicle.mass, wheelbase=0.475, track=0.5, length=1.0, width=0.6
    )
    found = identify(simulate.identification_drive(truth, seed=1, **NOISE), light)
    assert found.model.coefficient("slip_friction") == 2.0
    assert any("slip_friction" in t and "vehicle's mass" in t for t in found.warnings)


# -- logs together, residuals -------------------------------------------------------------------


def test_a_gap_is_no_time_driven(truth: PowerModel, spiral: DriveLog) -> None:
    kept = (spiral.t < 20.0) | (spiral.t > 40.0)
    log = DriveLog({k: v[kept] for k, v in spiral.channels.items()})
    found = identify(log, truth.vehicle)
    np.testing.assert_allclose(found.model.coefficients, truth.coefficients, rtol=0.03)
    assert found.residual.duration == pytest.approx(40.0, abs=0.2)


def test_an_error_of_energy_where_none_was_measured_has_its_sign() -> None:
    model = PowerModel.preset("quadriga:empty:marble")
    t = np.linspace(0.0, 20.0, 201)
    moving = {"t": t, "v_left": 0 * t + 0.5, "v_right": 0 * t + 0.5, "power": 0 * t}
    assert fit_residual(model, DriveLog(moving)).energy_error == np.inf
    pushed = PowerModel.paper(model.vehicle, -10.0, 0.0)
    assert fit_residual(pushed, DriveLog(moving)).energy_error == -np.inf
    resting = {**moving, "v_left": 0 * t, "v_right": 0 * t}
    assert fit_residual(model, DriveLog(resting)).energy_error == 0.0


def test_residual_statistics(truth: PowerModel) -> None:
    log = simulate.drive(truth, "spiral", duration=600.0, seed=1, power_noise=10.0,
                         correlation_time=1.0, biases={"power": 3.0}, measured="total")  # fmt: skip
    found = fit_residual(truth, log)
    assert found.bias == pytest.approx(3.0, abs=2.0)
    assert found.rmse == pytest.approx(np.hypot(10.0, found.bias), rel=0.1)
    assert found.mae == pytest.approx(np.sqrt(2 / np.pi) * found.rmse, rel=0.05)
    assert found.correlation_time == pytest.approx(1.0, rel=0.3)
    assert found.duration == pytest.approx(600.0)
    energy = float(np.trapezoid(truth.power(log.motion(truth.vehicle.icr)), log.t))
    assert found.energy_error == pytest.approx(energy / log.energy - 1, abs=1e-6)


# -- other robots than the simulator's own ------------------------------------------------------


@pytest.mark.shared
@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize(
    ("scenario", "pair"),
    [
        ("none", "quadriga:full:concrete"),
        ("none_concrete_empty", "quadriga:empty:concrete"),
        ("none_marble_full", "quadriga:full:marble"),
        ("none_marble_empty", "quadriga:empty:marble"),
    ],
)
def test_physics_engine(shared_data, scenario: str, pair: str, seed: int) -> None:
    folder = shared_data / "quadriga_mujoco"
    log = DriveLog.read(folder / f"{scenario}_s{seed}_ident.csv.gz")
    K, mu = TABLE_II[pair]
    found = identify(log, Vehicle.preset(pair.rpartition(":")[0]))
    np.testing.assert_allclose(found.model.coefficients, [mu, K], rtol=0.02)
    assert found.icr.half_track == pytest.approx(0.4756, rel=0.01)
    other = DriveLog.read(folder / f"{scenario}_s{seed}_valid.csv.gz")
    assert abs(fit_residual(found.model, other).energy_error) < 0.02


@pytest.mark.shared
def test_real_husky_indoors_and_on_ice(shared_data) -> None:
    vehicle = Vehicle.preset("husky_a200")
    floor = identify(read_husky(shared_data / "borealtc" / "FLOORING" / "pro_00.csv"), vehicle)
    ice = identify(read_husky(shared_data / "borealtc" / "ICE" / "pro_00.csv"), vehicle)
    assert floor.model.coefficient("slip_friction") > 3 * ice.model.coefficient("slip_friction")
    for found in (floor, ice):
        assert found.std_error["traction_resistance"] < 5.0
        assert found.icr_std_error is not None
        # The yaw rate is 0.55 to 0.7 of that of wheels on the 0.555 m track.
        assert 0.555 / 0.7 - 0.05 < found.icr.slip_track < 0.555 / 0.55 + 0.05


def _without_yaw(log: DriveLog) -> DriveLog:
    return DriveLog({k: v for k, v in log.channels.items() if k != "yaw_rate"}, log.name)


@pytest.mark.shared
def test_real_husky_logs_that_tell_less(shared_data) -> None:
    vehicle, ice = Vehicle.preset("husky_a200"), shared_data / "borealtc" / "ICE"
    blind = identify(_without_yaw(read_husky(ice / "pro_01.csv")), vehicle)
    assert blind.icr == vehicle.icr
    assert any("no yaw" in text for text in blind.warnings)
    with pytest.raises(NotIdentifiableError, match="slip_friction"):
        identify(read_husky(ice / "pro_05.csv"), vehicle)  # one straight line
    both = [read_husky(ice / "pro_00.csv"), _without_yaw(read_husky(ice / "pro_01.csv"))]
    together = identify(both, vehicle)
    assert together.icr_std_error is not None


def test_samples_that_were_left_out_are_counted():
    truth = PowerModel.preset("quadriga:empty:marble")
    log = simulate.identification_drive(truth, power_noise=2.0, seed=3)
    channels = {name: np.array(log.channel(name)) for name in ("t", "v_left", "v_right", "yaw")}
    channels["power"] = np.array(log.power)
    channels["power"][[30, 31, 70]] = np.nan
    found = identify(DriveLog.from_columns(channels, name="holes"), truth.vehicle)
    [(drive, reasons)] = found.set_aside.items()
    assert (drive, sum(reasons.values())) == ("holes", 3)
    assert documents.identification(found)["set_aside"] == {"holes": dict(reasons)}
    assert "3 samples" in str(found)


# -- what is missing ----------------------------------------------------------------------------


def test_a_model_that_lacks_something_is_told() -> None:
    """Losses, which friction takes over, and a warm-up, which nothing does."""
    truth = PowerModel.preset("quadriga:full:concrete")
    lossy = truth.with_term(effects.DRIVE_LOSS, 0.25).with_term(effects.REGENERATION_LOSS, 0.5)
    found, warming, plain = (
        identify(simulate.identification_drive(model, power_noise=5.0, seed=1), truth.vehicle)
        for model in (lossy, truth.with_term(effects.term("warm_up"), 60.0), truth)
    )
    off = found.model.coefficient("traction_resistance") - 118.0
    assert off > 5.0 * found.std_error["traction_resistance"]
    assert any("K from 2" in text and "diagnose" in text for text in found.warnings)
    assert not warming.adequacy.adequate
    assert any("standard errors" in text for text in warming.warnings)
    assert plain.adequacy.adequate
    assert plain.adequacy.noise == pytest.approx(np.hypot(5.0, 5.0), rel=0.2)
    assert plain.warnings == ()


def test_inertia_that_every_drive_has_is_no_alarm() -> None:
    truth = PowerModel.preset("quadriga:full:concrete").with_term(effects.LINEAR_INERTIA, 147.0)
    log = simulate.identification_drive(truth, power_noise=5.0, seed=1)
    found = identify(log, truth.vehicle)
    assert found.residual.rmse > 1.2 * found.adequacy.residual
    assert found.adequacy.adequate
    assert found.warnings == ()


def test_a_yaw_that_never_changes_leaves_the_yaw_rate_to_tell() -> None:
    """As of a driver that fills in no attitude: slip had been called zero throughout."""
    truth = PowerModel.preset("quadriga:empty:marble")
    log = simulate.drive(truth, "spiral", seed=1)
    turning = {k: v for k, v in log.channels.items() if k not in ("x", "y", "yaw")}
    still = {**turning, "yaw": np.zeros(len(log))}
    found, usual = (fit_icr(DriveLog(one), truth.vehicle.icr) for one in (still, turning))
    assert found.source == "yaw_rate"
    assert found.icr == usual.icr


def test_turns_that_speeds_hide_are_found_by_their_losses() -> None:
    """A side is 0.5 mm/s faster, below the noise: without the turns, K would be 23 N."""
    robot = Vehicle.from_geometry(
        "rover", mass=18.0, wheelbase=0.35, track=0.38, length=0.6, width=0.45
    )
    model = PowerModel.paper(robot, K=5.0, mu=0.7).with_term(effects.COPPER_LOSS, 0.013)
    slight = [
        part for v in (0.6, 0.3)
        for part in (Setpoint(v, v + 5e-4, hold=8.0), Setpoint(0.0, 0.0))
    ]  # fmt: skip
    log = simulate.drive(
        model, [("spin", 25.0), ("straight", 20.0), ("figure8", 20.0), *slight], rate=20.0,
        speed=0.7, speed_noise=0.006, power_noise=0.5, measured="total", seed=1,
    )  # fmt: skip
    terms = (SLIP, TRACTION, effects.COPPER_LOSS)
    found = identify(log, robot, terms=terms, method="windows").model
    errors = np.sqrt(np.diag(found.covariance))
    assert np.all(np.abs(found.coefficients - model.coefficients) < 3.0 * errors)
    assert np.all(errors < 0.05 * model.coefficients)
