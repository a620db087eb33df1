"""Logs with nothing wrong look like no mistake; sides that differ are told from what arcs make."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from made_drives import sized

import energyplan as ep
from energyplan import simulate
from energyplan.errors import DriveLogError
from energyplan.io.given import Given
from energyplan.io.start import start
from energyplan.logs.checks import find_lost_sign
from energyplan.power import PowerModel
from energyplan.power.effects import ANGULAR_INERTIA, LINEAR_INERTIA
from energyplan.simulate import Setpoint, drive

Columns = dict[str, np.ndarray]
KINDS = ("teleop", "survey", "path", "spins", "straights", "circles")
ALARMS = (
    "wrong sign", "lost their sign", "swapped", "counts", "straight stretches", "alone, as",
    "beside", "mirror", "degrees", "hangs",
)  # fmt: skip


def robot(rng: np.random.Generator) -> PowerModel:
    """Return a robot of 5 kg to 2 t, whose turns cost much or little."""
    mass = float(np.exp(rng.uniform(np.log(5.0), np.log(2000.0))))
    size = (mass / 60.0) ** (1 / 3)
    vehicle = sized(size)
    K, mu = float(rng.uniform(0.015, 0.1)) * mass * 9.81 / 2, float(rng.uniform(0.2, 1.0))
    model = PowerModel.paper(vehicle, K=K, mu=mu).with_term(LINEAR_INERTIA, mass)
    return model.with_term(ANGULAR_INERTIA, mass * (0.3 * size) ** 2)


def commands(
    kind: str, speed: float, half_track: float, rng: np.random.Generator
) -> list[Setpoint]:
    """Return a minute or less of one kind of driving."""
    made: list[Setpoint] = []
    spin = speed / half_track * float(rng.uniform(0.5, 1.2))
    longest = float(rng.uniform(15.0, 60.0))
    while sum(point.hold for point in made) < longest:
        ahead, turning = {
            "teleop": (rng.choice([0, 1, 1, -0.5]) * rng.uniform(0.3, 1), rng.choice([0, 1, -1])),
            "survey": (1.0, 0.0) if rng.random() < 0.6 else (0.0, 0.6 * rng.choice([-1, 1])),
            "path": (rng.uniform(0.6, 1), 0.25 * rng.normal()),
            "spins": (0.0, rng.uniform(-1, 1)),
            "straights": (rng.uniform(-0.3, 1), 0.0),
            "circles": (rng.uniform(0.3, 1), rng.uniform(-1, 1)),
        }[kind]
        hold = float(rng.uniform(1.0, 8.0)) * (4.0 if kind == "circles" else 1.0)
        v, side = float(ahead) * speed, float(turning) * spin * half_track
        made.append(Setpoint(v - side, v + side, hold=hold, ramp=0.3))
    return made


def sound(seed: int, kind: str) -> Columns:
    """Return the columns of a random robot's drive of a kind, by random sensors."""
    rng = np.random.default_rng([seed, KINDS.index(kind)])
    model = robot(rng)
    half_track = model.vehicle.icr.half_track
    speed = float(rng.uniform(0.4, 1.5))
    rate = float(rng.choice([1.0, 2.0, 10.0, 50.0]))
    noise = {"yaw_rate": 0.01, "yaw": 0.01, **dict.fromkeys("xy", float(rng.choice([0.02, 0.5])))}
    K = model.coefficient("traction_resistance")
    log = drive(
        model, commands(kind, speed, half_track, rng), rate=rate, speed=speed, accel_limit=3.0,
        power_noise=float(rng.uniform(0.01, 0.1)) * K * speed, noise=noise,
        speed_noise=float(rng.choice([0.002, 0.03])) * speed, seed=seed,
        delays=dict.fromkeys(("p_left", "p_right"), float(rng.choice([0.0, 0.15, 0.5]))),
        without={"accel_x"} | ({"yaw_rate"} if rng.random() < 0.5 else set()),
    )  # fmt: skip
    made = {name: np.array(values) for name, values in log.channels.items()}
    made["yaw"] = np.angle(np.exp(1j * made["yaw"]))
    step = float(rng.choice([0.0, 0.03])) * speed
    for name in ("v_left", "v_right"):
        made[name] = step * np.round(made[name] / step) if step else made[name]
    return made


@pytest.mark.parametrize("kind", KINDS)
def test_no_sound_log_is_refused_or_called_a_mistake(kind: str) -> None:
    for seed in range(25):
        log = ep.DriveLog.from_columns(sound(seed, kind), f"{kind} {seed}")
        alarms = [text for text in log.warnings if any(word in text for word in ALARMS)]
        assert alarms == [], (seed, alarms)


def of(*points: Setpoint, rate: float = 20.0, mu: float = 0.9, K: float = 4.0) -> Columns:
    """Return the columns of a drive of a robot whose slip costs far more than its wheels."""
    model = PowerModel.paper(sized(1.0), K=K, mu=mu)
    log = drive(model, points, rate=rate, power_noise=0.5, speed_noise=0.002, without={"accel_x"})
    return {name: np.array(values) for name, values in log.channels.items()}


@pytest.mark.parametrize("side", ["p_left", "p_right"])
def test_a_side_that_returns_power_in_a_gentle_arc_has_its_sign(side: str) -> None:
    made = of(Setpoint(0.50, 0.52, hold=20.0) if side == "p_left" else Setpoint(0.52, 0.5, hold=20))
    assert np.mean(made[side]) < -20.0
    log = ep.DriveLog.from_columns(made, "arc")
    assert log.warnings == ()
    np.testing.assert_array_equal(log.channels[side], made[side])


LINE, TURN = Setpoint(0.6, 0.6, hold=6.0, ramp=0.5), Setpoint(-0.3, 0.3, hold=3.0, ramp=0.5)


@pytest.mark.parametrize(
    ("points", "K", "side"),
    [((Setpoint(0.5, 0.5, hold=20.0),), 60.0, "p_left"),
     ((LINE, TURN, LINE, TURN, LINE), 30.0, "p_right")],
)  # fmt: skip
def test_straight_lines_and_turns_on_the_spot_show_a_sign(
    points: tuple[Setpoint, ...], K: float, side: str
) -> None:
    made = of(*points, K=K)
    ep.DriveLog.from_columns(made, "sound")
    made[side] = -made[side]
    with pytest.raises(DriveLogError, match=rf"{side} has the wrong sign"):
        ep.DriveLog.from_columns(made, "wrong")


def test_a_stop_that_returns_power_does_not_show_a_sign() -> None:
    arc, stop = Setpoint(0.9, 0.12, hold=14.0), Setpoint(-0.05, 0.1, hold=0.5)
    made = of(arc, stop)
    t = made["t"]
    made["p_right"] = np.where(t > t[-1] - 0.5, -80.0, made["p_right"])
    log = ep.DriveLog.from_columns(made, "stop")
    assert log.warnings == ()
    np.testing.assert_array_equal(log.channels["p_right"], made["p_right"])


def test_wide_arcs_of_both_ways_are_no_lost_signs() -> None:
    made = of(*(Setpoint(1.0 + s, 1.0 - s, hold=6.0) for s in (0.13, -0.12, 0.09, -0.13, 0.12)))
    assert np.quantile(np.abs(made["yaw_rate"]), 0.9) < 0.3  # of this robot; a smaller one is:
    made["yaw_rate"], made["yaw"] = 2.5 * made["yaw_rate"], 2.5 * made["yaw"]
    log = ep.DriveLog.from_columns({k: v for k, v in made.items() if k not in "xy"}, "arcs")
    assert not any("lost their sign" in text for text in log.warnings)


def test_a_heading_read_once_in_half_a_turn_is_left_out_with_a_warning() -> None:
    made = of(*(Setpoint(-s, s, hold=12.0, ramp=1.0) for s in (1.3, -1.5, 1.6)), rate=1.0)
    assert np.max(np.abs(np.diff(made["yaw"]))) > 2.5
    wrapped = np.angle(np.exp(1j * made["yaw"]))
    log = ep.DriveLog.from_columns({**made, "yaw": wrapped}, "spins")
    assert not log.has("yaw")
    assert any("yaw is left out" in text and "more often" in text for text in log.warnings)
    assert ep.DriveLog.from_columns({**made, "yaw": made["yaw"]}, "unwrapped").has("yaw")


def test_a_jittering_pose_does_not_accuse_the_wheel_radius() -> None:
    made = of(*(Setpoint(0.4, 0.4, hold=20.0) for _ in range(3)))
    rng = np.random.default_rng(3)
    for jitter, factor, told in ((0.5, 1.0, False), (0.02, 1.0, False), (0.02, 2.0, True)):
        shaken = {name: made[name] + rng.normal(0.0, jitter, len(made[name])) for name in "xy"}
        speeds = {name: factor * made[name] for name in ("v_left", "v_right")}
        log = ep.DriveLog.from_columns({**made, **shaken, **speeds}, "straight")
        assert any("distance by the treads" in text for text in log.warnings) == told, jitter


def test_few_readings_of_driving_are_not_called_a_standstill() -> None:
    made = of(Setpoint(0.5, 0.3, hold=15.0), rate=1.0)
    log = ep.DriveLog.from_columns(made, "short")
    (told,) = [text for text in log.warnings if "cannot be found" in text]
    assert "readings" in told and "hardly" not in told


def test_a_robot_that_hardly_moves_contradicts_nothing(tmp_path: Path) -> None:
    """One jerk at the end of a minute shows no side, no unit and no axis."""
    t = np.arange(0.0, 60.0, 0.05)
    before, jerk = (np.exp(-(((t - at) / 0.15) ** 2)) for at in (59.3, 59.6))
    rng = np.random.default_rng(2)
    noise = [rng.normal(0.0, size, len(t)) for size in (1e-4, 1e-4, 1e-3, 0.02, 5.0)]
    columns = {
        "t": t, "v_left": 0.7 * before, "v_right": 1.2 * jerk, "yaw_rate": 0.36 * jerk,
        "yaw": 0.02 * np.cumsum(jerk) * 0.05, "power": 300.0 * jerk,
    }  # fmt: skip
    made = {k: v + e for (k, v), e in zip(columns.items(), [0.0, *noise], strict=True)}
    pd.DataFrame(made).to_csv(tmp_path / "jerk.csv", index=False)
    begun = start(tmp_path / "jerk.csv", Given(track=1.1, wheelbase=0.9, mass=470.0))
    assert begun.sound, begun.checks
    assert any("hardly moves" in note for note in begun.notes)


@pytest.mark.parametrize(("unit", "said"), [(1.0, False), (1e-3, True)])
def test_a_side_in_kilowatts_is_told_from_one_that_takes_next_to_nothing(
    unit: float, said: bool
) -> None:
    """Straight on with 100 W a side, then turns on which the left side takes 1 W."""
    turns = np.repeat([0.0, 1.0], 50)
    made = {"t": 0.1 * np.arange(100), "v_left": 0.5 - 0.3 * turns, "v_right": 0.5 + 0.3 * turns,
            "p_left": unit * (100.0 - 99.0 * turns), "p_right": 100.0 + 100.0 * turns}  # fmt: skip
    warnings = " ".join(ep.DriveLog.from_columns(made).warnings)
    assert ("map both in one unit, as in p_left=NAME[kW]" in warnings) == said == bool(warnings)


def test_powers_without_sign_are_told_where_the_robot_turns_one_way_alone() -> None:
    """The inner side of left turns is held back more than a straight line costs."""
    model = ep.PowerModel.preset("quadriga:full:concrete")
    parts = (("straight", 20.0), ("figure8", 30.0), ("rest", 3.0))
    log = simulate.drive(model, parts, power_noise=5.0, speed_noise=0.005, seed=1)
    left = log.channel("v_right") >= log.channel("v_left")
    channels = {name: values[left] for name, values in log.channels.items()}
    found = ep.identify(ep.DriveLog.from_columns(channels), model.vehicle)
    assert not any("log signed currents" in text for text in found.warnings)
    lost = {name: np.abs(channels[name]) for name in ("p_left", "p_right")}
    found = ep.identify(ep.DriveLog.from_columns({**channels, **lost}), model.vehicle)
    assert any("log signed currents" in text for text in found.warnings)


@pytest.mark.parametrize("side", ["p_left", "p_right"])
def test_a_side_that_alone_lost_its_sign_is_told(side: str) -> None:
    """A machine of 3 t, once a second: K was a fifth too large without a word about it."""
    vehicle = ep.Vehicle.from_geometry(
        "mule", mass=3000, wheelbase=1.3, track=1.3, length=2, width=2
    )
    model = ep.PowerModel.paper(vehicle, K=1000.0, mu=0.5)
    log = simulate.drive(
        model, simulate.IDENTIFICATION, rate=1.0, speed=1.1, accel_limit=0.5, power_noise=20.0,
        speed_noise=0.003, seed=13,
    )  # fmt: skip
    lost = {**log.channels, side: np.abs(log.channel(side))}
    assert find_lost_sign(log.channels) == ""
    assert find_lost_sign(lost).startswith(f"{side} is never negative")


def _survey(seed: int = 1) -> dict[str, np.ndarray]:
    model = ep.PowerModel.preset("quadriga:full:concrete")
    log = simulate.identification_drive(model, power_noise=5.0, speed_noise=0.005, seed=seed)
    return {name: np.array(values) for name, values in log.channels.items()}


def test_a_steady_turn_by_a_gyroscope_of_few_digits_is_no_frozen_one() -> None:
    spot = [simulate.Setpoint(-0.3, 0.3, hold=20.0), simulate.Setpoint(0.5, 0.2, hold=40.0)]
    model = ep.PowerModel.preset("quadriga:full:concrete")
    made = {**simulate.drive(model, spot, speed_noise=0.005, seed=1).channels}
    made["yaw_rate"] = np.round(made["yaw_rate"], 1)
    log = ep.DriveLog.from_columns({k: v[:-60] for k, v in made.items() if k != "yaw"})
    assert np.ptp(log.channel("yaw_rate")[-400:]) == 0.0
    assert not any("stays at" in text for text in log.warnings)


def test_the_noise_of_a_dead_ammeter_is_in_no_other_unit(tmp_path: Path) -> None:
    """It had been taken for kilowatts, in which a robot's power may be that small."""
    made = _survey()
    rng = np.random.default_rng(3)
    made |= {name: rng.normal(0.0, 0.5, len(made["t"])) for name in ("p_left", "p_right")}
    pd.DataFrame(made).to_csv(tmp_path / "dead.csv", index=False)
    begun = start(tmp_path / "dead.csv", Given(track=0.5, wheelbase=0.475, mass=147.0))
    assert {begun.project.columns[name].unit for name in ("p_left", "p_right")} == {""}
