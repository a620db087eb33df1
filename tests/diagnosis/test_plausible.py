"""What is handed on is possible: by the log at rest, by the vehicle's mass, by its error."""

from __future__ import annotations

import numpy as np
import pytest

from energyplan import DriveLog, PowerModel, Vehicle, diagnose, simulate
from energyplan.diagnosis import Diagnosis
from energyplan.diagnosis.candidates import Part
from energyplan.diagnosis.judge import doubt
from energyplan.diagnosis.search import Gain
from energyplan.fit.estimate import Fitted
from energyplan.fit.run import RunEffect
from energyplan.motion import Motion
from energyplan.power import HOTEL
from energyplan.power.effects import ANGULAR_INERTIA, COPPER_LOSS, LINEAR_INERTIA, catalogue

ROBOT = PowerModel.preset("quadriga:full:concrete")
EFFECTS = [catalogue()[name] for name in ("hotel_load", "viscous_loss", "payload_change")]


def told(more: float, friction: float) -> Diagnosis:
    """Diagnose drives that take more power while they move, on less friction from a time on."""
    slippery = ROBOT.with_coefficients(ROBOT.coefficients * friction)
    drives = []
    for seed, pattern in enumerate((simulate.IDENTIFICATION, simulate.VALIDATION)):
        log = simulate.drive(
            ROBOT, pattern, power_noise=3.0, speed_noise=0.002, seed=seed,
            changes=[(60.0, slippery)] if friction < 1.0 else [],
        )  # fmt: skip
        moves = np.maximum(abs(log.channel("v_left")), abs(log.channel("v_right"))) > 0.02
        own = {side: log.channel(side) + 0.5 * more * moves for side in ("p_left", "p_right")}
        drives.append(DriveLog({**log.channels, **own}, f"drive {seed}"))
    return diagnose(drives[0], drives[1], ROBOT.vehicle, effects=EFFECTS)


def test_no_constant_load_where_the_power_is_zero_at_rest() -> None:
    found = told(17.0, 1.0)
    assert "hotel_load" not in [effect.name for effect in found.effects]
    still = Motion.from_twist(0.0, 0.0, found.model.vehicle.icr)
    assert float(found.model.power(still)) < 1.0


def test_a_robot_sets_down_no_more_than_half_of_itself() -> None:
    """Friction that falls by 0.6 is another surface: no 88 kg of 147 kg were set down."""
    found = told(0.0, 0.4)
    assert "payload_change" not in [effect.name for effect in found.effects]
    assert found.verdict == "unexplained"


@pytest.mark.parametrize(
    ("size", "error", "missing", "why"),
    [
        (40.0, 5.0, 0.01, None),
        (40.0, 25.0, 0.01, "size"),
        (40.0, 5.0, 0.03, "missing"),
        (1e6, 5.0, 0.01, "range"),
    ],
)
def test_an_effect_is_named_by_its_size_over_its_error_and_over_what_is_missing(
    size: float, error: float, missing: float, why: str | None
) -> None:
    part = Part(catalogue()["warm_up"], (("time_constant", 60.0),))
    model = ROBOT.with_term(part.terms[0], size)
    model = model.with_coefficients(model.coefficients, np.diag([0.01, 1.0, error**2]))
    gain = Gain(1.0, 0.1, 0.0, 20.0, share=0.05, lasting=1.0)
    most, reason = doubt(part, gain, Fitted(model, RunEffect(), (), np.zeros((0, 0))), missing)
    assert (reason if most >= 1.0 else None) == why


def test_a_load_at_rest_beside_losses_is_as_far_off_as_its_error_says() -> None:
    """Noise at rest is no moment that contacts hold, and a noisy start is no long one."""
    truth = ROBOT.with_term(HOTEL, 30.0).with_term(COPPER_LOSS, 4e-4)
    effects = [catalogue()[name] for name in ("copper_loss", "hotel_load")]
    pattern = [*simulate.IDENTIFICATION, ("rest", 60.0)]
    beside = []
    for seed in range(6):
        noise = {"power_noise": 10.0, "speed_noise": 0.005}
        train = simulate.drive(truth, pattern, seed=100 + seed, **noise)
        unseen = simulate.validation_drive(truth, seed=99, **noise)
        told = diagnose(train, unseen, ROBOT.vehicle, effects=effects, choose=False)
        (load,) = (one for one in told.effects if one.name == "hotel_load")
        assert load.std_error < 1.0
        beside.append((load.value - 30.0) / load.std_error)
    assert np.sqrt(np.mean(np.square(beside))) < 1.6
    assert abs(np.mean(beside)) < 1.2


def test_no_effect_is_told_whose_size_is_anything() -> None:
    """Straight lines and turns at one speed each, read in steps of a twentieth of it."""
    vehicle = Vehicle.from_geometry(
        "own", mass=15.0, wheelbase=0.32, track=0.34, length=0.5, width=0.44
    )
    truth = PowerModel.paper(vehicle, K=6.4, mu=0.64).with_term(HOTEL, 1.3)
    truth = truth.with_term(LINEAR_INERTIA, 15.0).with_term(ANGULAR_INERTIA, 0.4)
    rng = np.random.default_rng(5)
    points: list[simulate.Setpoint] = []
    while sum(point.hold for point in points) < 100.0:
        v, side = (0.43, 0.0) if rng.random() < 0.6 else (0.0, 0.25 * rng.choice([-1, 1]))
        hold = float(rng.uniform(0.5, 8.0))
        points.append(simulate.Setpoint(v - side, v + side, hold=hold, ramp=0.3))
    noise = {"power_noise": 0.4, "noise": {"yaw_rate": 0.01}, "without": ("x", "y", "yaw")}
    log = simulate.drive(
        truth, points, accel_limit=3.0, speed_noise=0.001, rate=50.0, seed=5, **noise
    )
    steps = {n: 0.0215 * np.round(log.channels[n] / 0.0215) for n in ("v_left", "v_right")}
    unseen = simulate.validation_drive(truth, speed=0.43, seed=105, **noise)
    told = diagnose(DriveLog({**log.channels, **steps}, "survey"), unseen, vehicle)
    searched = {name for name, entry in catalogue().items() if entry.grid}
    for effect in told.effects:
        assert effect.name not in searched or effect.std_error < abs(effect.value), effect
    assert told.after.rmse <= told.before.rmse
