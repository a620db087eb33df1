"""The drives that a regression sees: clean speeds, pieces between gaps, readings that are held."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from energyplan import DriveLog, PowerModel, identify, simulate
from energyplan.fit.drive import Drive, prepared, quiet
from energyplan.fit.regressors import linearise_drive, power_of
from energyplan.motion import Motion
from energyplan.power import HOTEL, SLIP, TRACTION, effects
from energyplan.simulate import Setpoint

MODEL = PowerModel.preset("quadriga:full:concrete").with_term(HOTEL, 30.0)
ROBOT = PowerModel.preset("quadriga:full:concrete")
ICR = MODEL.vehicle.icr
PERIOD = 0.05


def _speeds(rng: np.random.Generator) -> np.ndarray:
    """Straights, arcs, spins, pivots about either tread and rests, each a second or two."""
    kinds = [(0.6, 0.6), (0.5, -0.5), (0.7, 0.0), (0.0, 0.0), (0.0, 0.7), (-0.4, -0.4), (0.3, 0.8),
             (-0.6, 0.0), (0.0, 0.0), (-0.5, 0.5), (0.0, -0.6), (0.8, 0.3)]  # fmt: skip
    wanted = np.repeat(kinds, rng.integers(20, 40, len(kinds)), axis=0)
    return np.vstack([wanted, np.flipud(wanted)])


@pytest.mark.parametrize("seed", range(3))
def test_a_drive_in_the_mirror_tells_the_same(seed: int) -> None:
    rng = np.random.default_rng(seed)
    v = _speeds(rng)
    power = MODEL.power(Motion(v[:, 0], v[:, 1], ICR)) + rng.normal(0.0, 8.0, len(v))
    v = v + rng.normal(0.0, 0.004, v.shape) * (v != 0.0)
    t = PERIOD * np.arange(len(v))
    rate = (v[:, 1] - v[:, 0]) / ICR.slip_track

    def told(left: int, right: int, way: float) -> np.ndarray:
        log = DriveLog.from_columns(
            {"t": t, "v_left": v[:, left], "v_right": v[:, right], "power": power,
             "yaw_rate": way * rate}
        )  # fmt: skip
        return identify(log, MODEL.vehicle, terms=(SLIP, TRACTION, HOTEL)).model.coefficients

    assert_allclose(told(1, 0, -1.0), told(0, 1, 1.0), rtol=1e-6)


def test_a_gyroscope_without_noise_is_not_smoothed() -> None:
    """Where the wheels' noise hides a slight turn, the gyroscope tells its edges to the sample."""
    rng = np.random.default_rng(1)
    n = 400
    t = PERIOD * np.arange(n)
    turn = np.zeros(n)
    turn[150:200], turn[300:350] = 0.02, -0.02
    turn[:40] = 0.6
    wheels = turn[:, None] * [-0.5, 0.5] + 0.6 + rng.normal(0.0, 0.01, (n, 2))
    clean = quiet(Motion(*wheels.T, ICR, {"yaw_rate": turn / ICR.slip_track}), t)
    at = np.arange(60, n)
    assert_allclose(np.sign(clean.omega[at]), np.sign(turn[at]))


def test_derivatives_count_that_what_contacts_hold_follows_the_coefficients() -> None:
    """Its mean over a moment of time does, where both sides were logged and losses make it cost."""
    model = PowerModel.preset("quadriga:full:concrete").with_term(effects.COPPER_LOSS, 4.5e-4)
    log = simulate.identification_drive(
        model, seed=3, rate=10.0, power_noise=4.0, speed_noise=0.004, without={"accel_x"}
    )
    (drive,) = prepared([log], model.vehicle)
    drive = replace(drive, breakaway=0.05, fields={})
    driven = drive.holds & (drive.held.v_left != 0.0)
    values, terms = model.coefficients, model.terms
    about = linearise_drive(drive, model.vehicle, terms, values)
    for k, value in enumerate(values):
        step = 1e-3 * value * np.eye(len(values))[k]
        more, less = (
            linearise_drive(drive, model.vehicle, terms, values + s) for s in (step, -step)
        )
        slope = (more.power - less.power)[driven, 0] / (2e-3 * value)
        told = about.columns[driven, 0, k]
        assert np.quantile(np.abs(told - slope), 0.9) < 0.02 * np.sqrt(np.mean(slope**2))
        assert told.sum() == pytest.approx(slope.sum(), rel=0.02)


def test_a_prediction_knows_nothing_of_the_power_that_was_measured() -> None:
    """Of friction and losses in turns that the noise of wheels hides, the power alone tells."""
    truth = PowerModel.preset("quadriga:full:concrete").with_term(effects.COPPER_LOSS, 4.5e-4)
    log = simulate.drive(
        truth,
        [("rest", 3.0), ("spin", 20.0), ("straight", 16.0), ("spiral", 30.0), ("survey", 20.0),
         ("rest", 3.0), Setpoint(0.4992, 0.5008, hold=8.0), ("rest", 3.0),
         Setpoint(-0.3992, -0.4008, hold=6.0)],
        rate=10.0, power_noise=4.0, speed_noise=0.003, measured="total",
        without={"x", "y", "yaw", "yaw_rate", "accel_x"},
    )  # fmt: skip
    (drive,) = prepared([log], truth.vehicle)
    unseen = replace(drive, power=np.zeros(len(drive.t)), fields={})
    assert_allclose(power_of(truth, drive), power_of(truth, unseen), rtol=0, atol=0)


def test_a_part_of_a_drive_goes_on_warming_up() -> None:
    (warm_up,) = effects.catalogue()["warm_up"].terms
    truth = PowerModel.preset("quadriga:full:concrete").with_term(warm_up, 60.0)
    log = simulate.drive(truth, "spiral", rate=10.0)
    later = log.segment(40.0, 80.0).segment(50.0, 70.0)
    left = later.power - power_of(truth, Drive.of(later, truth.vehicle))
    assert np.abs(left).max() < 1e-6 * np.abs(later.power).max()


@pytest.mark.parametrize("accel", [0.1, 0.4])
@pytest.mark.parametrize("rate", [10.0, 20.0, 100.0])
def test_starts_and_stops_in_noise_last_as_long_as_they_do(accel: float, rate: float) -> None:
    """Treads move while they do, but for a sample or two; most of the time they rest here."""
    rng = np.random.default_rng(5)
    t = np.arange(0.0, 60.0, 1.0 / rate)
    way = np.where(t % 30.0 < 15.0, 1.0, -1.0)
    v = way * np.clip(accel * np.minimum(t % 15.0 - 4.0, 11.0 - t % 15.0), 0.0, 0.6)
    noisy = v[:, None] + rng.normal(0.0, 0.005, (len(t), 2))
    found = quiet(Motion(noisy[:, 0], noisy[:, 1], ICR), t)
    assert np.array_equal(found.v_left == 0.0, found.v_right == 0.0)
    rest, called = v == 0.0, found.v_left == 0.0
    # eight starts and stops; a tenth of a second each at most, or a sample
    most = 8 * max(0.1 * rate, 1.0)
    assert np.count_nonzero(rest & ~called) <= most
    assert np.count_nonzero(~rest & called) <= most


NOISE = 5.0
EACH = 20  # rows a reading


def read_seldom(mean: bool, measured: str) -> DriveLog:
    """A drive whose powers are read in every twentieth row, by a meter or a sampler."""
    log = simulate.drive(ROBOT, simulate.IDENTIFICATION, rate=20.0, power_noise=NOISE, seed=2)
    start = np.arange(len(log)) // EACH * EACH
    channels = dict(log.channels)
    for name in ("p_left", "p_right"):
        values = channels[name]
        if mean:
            total = np.concatenate([[0.0], np.cumsum(values)])
            last = np.maximum(start, EACH)
            values = (total[last] - total[last - EACH]) / EACH
        channels[name] = values[start]
    if measured == "total":
        channels["power"] = channels.pop("p_left") + channels.pop("p_right")
    return DriveLog(channels, "seldom")


@pytest.mark.parametrize("measured", ["sides", "total"])
@pytest.mark.parametrize("mean", [False, True])
def test_readings_are_predicted_as_what_they_are(mean: bool, measured: str) -> None:
    log = read_seldom(mean, measured)
    drive = Drive.of(log, ROBOT.vehicle)
    assert drive.hold is not None
    assert (drive.hold.mean, drive.hold.rows) == (mean, EACH)
    found = identify(log, ROBOT.vehicle)
    # Of readings at rest nothing is told, and their noise is that of both sides.
    noise = np.sqrt(2.0) * NOISE / (np.sqrt(EACH) if mean else 1.0)
    assert found.residual.rmse < 1.5 * noise + 0.01 * np.abs(log.power).max()
    np.testing.assert_allclose(found.model.coefficients, ROBOT.coefficients, rtol=0.02)
    thin = prepared([log], ROBOT.vehicle)[0].thinned(4).hold
    assert thin is not None
    assert thin.rows == EACH // 4
    assert np.all(thin.starts % (EACH // 4) == 0)


def test_what_is_read_with_every_row_or_side_by_side_is_not_held() -> None:
    """Where sides are read in turn, their sum is no reading at any instant."""
    log = simulate.drive(ROBOT, "spiral", rate=20.0, power_noise=NOISE, seed=2)
    assert Drive.of(log, ROBOT.vehicle).hold is None
    together = read_seldom(False, "sides")
    late = np.maximum(np.arange(len(together)) - EACH // 2, 0)
    apart = {**together.channels, "p_right": together.channels["p_right"][late]}
    assert Drive.of(together, ROBOT.vehicle).hold is not None
    assert Drive.of(DriveLog(apart, "apart"), ROBOT.vehicle).hold is None
