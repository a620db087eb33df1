"""Mistakes that people make with a log or a robot's measures: each is caught, with its remedy."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

import energyplan as ep
from energyplan import simulate
from energyplan.errors import DriveLogError, NotIdentifiableError
from energyplan.io.logs import read_log
from energyplan.logs.consistency import Measures, Observed, check_consistency
from energyplan.power import HOTEL, PowerModel
from energyplan.power.effects import LINEAR_INERTIA
from energyplan.vehicle import Vehicle

RADIUS = 0.11
ROBOT = Vehicle.from_geometry(
    "own robot", mass=30.0, wheelbase=0.62, track=0.4, length=0.8, width=0.5
)
MODEL = PowerModel.paper(ROBOT, K=22.0, mu=0.6).with_term(LINEAR_INERTIA, 30.0)
Columns = dict[str, np.ndarray]
HUSKY, JACKAL = 0.1651, 0.098


def drive(seed: int, battery: bool = False) -> Columns:
    """Columns of a drive with noise, the pose jittering by a centimetre."""
    model = MODEL.with_term(HOTEL, 12.0) if battery else MODEL
    log = simulate.identification_drive(
        model, power_noise=3.0, speed_noise=0.004, seed=seed, without={"accel_x"},
        noise={"x": 0.01, "y": 0.01, "yaw": 0.005}, measured="battery" if battery else "sides",
    )  # fmt: skip
    return {name: np.array(values) for name, values in log.channels.items()}


def told(columns: Columns, measures: Measures) -> list[str]:
    """Return what is said against a log and a robot's measures."""
    try:
        log = ep.DriveLog.from_columns(columns, "drive")
    except DriveLogError as error:
        return [str(error)]
    checks = check_consistency(Observed(log.channels, log.power, log.runs), measures)
    warnings = [text for text in log.warnings if "lags" not in text and "leads" not in text]
    return [*warnings, *(str(check) for check in checks if not check.ok)]


def scaled(**factors: float) -> Callable[[Columns], Columns]:
    """Return a mistake of units: readings times a factor."""
    return lambda made: {name: values * factors.get(name, 1.0) for name, values in made.items()}


def speeds(factor: float) -> Callable[[Columns], Columns]:
    return scaled(v_left=factor, v_right=factor)


def powers(factor: float) -> Callable[[Columns], Columns]:
    return scaled(p_left=factor, p_right=factor)


def swapped(one: str, other: str) -> Callable[[Columns], Columns]:
    return lambda made: {**made, one: made[other], other: made[one]}


def stepped(step: float, *names: str) -> Callable[[Columns], Columns]:
    """Return a sensor of few digits."""
    return lambda made: {**made, **{name: step * np.round(made[name] / step) for name in names}}


def backwards(made: Columns) -> Columns:
    return {**made, "v_left": -made["v_left"], "v_right": -made["v_right"]}


def without(change: Callable[[Columns], Columns], *names: str) -> Callable[[Columns], Columns]:
    return lambda made: {k: v for k, v in change(made).items() if k not in names}


def turned(made: Columns) -> Columns:
    return {**made, "yaw": made["yaw"] - np.pi / 2}


def motor_current(made: Columns) -> Columns:
    """The current of the motors, which is their torque, times the battery's voltage."""
    effort = np.abs(made["v_left"]) + np.abs(made["v_right"])
    total = made["p_left"] + made["p_right"]
    force = np.where(effort > 0.02, np.abs(total) / np.maximum(effort, 0.02), 0.0)
    rest = {name: values for name, values in made.items() if name not in ("p_left", "p_right")}
    return {**rest, "voltage": np.full(len(total), 26.0), "current": 0.1 * force}


def in_one_column(name: str, other: str) -> Callable[[Columns], Columns]:
    return lambda made: {**made, other: made[name]}


def unsigned(made: Columns) -> Columns:
    return {**made, "v_left": np.abs(made["v_left"]), "v_right": np.abs(made["v_right"])}


def twist(made: Columns) -> Columns:
    """Forward speed and yaw rate where tread speeds belong."""
    return {**made, "v_left": 0.5 * (made["v_left"] + made["v_right"]), "v_right": made["yaw_rate"]}


def pointing_down(made: Columns) -> Columns:
    return {**made, "y": -made["y"], "yaw": -made["yaw"], "yaw_rate": -made["yaw_rate"]}


def hanging(made: Columns) -> Columns:
    """Power sensors that show their last reading again for a second, now and then."""
    at = np.arange(len(made["t"]))
    last = np.maximum.accumulate(np.where(made["t"] % 13.0 < 1.0, 0, at))
    return {**made, "p_left": made["p_left"][last], "p_right": made["p_right"][last]}


def dropping_out(made: Columns) -> Columns:
    there = made["t"] % 17.0 > 1.0
    return {**made, "p_left": made["p_left"] * there, "p_right": made["p_right"] * there}


def dead(name: str, value: float = 0.0) -> Callable[[Columns], Columns]:
    return lambda made: {**made, name: np.full(len(made["t"]), value)}


def dying(made: Columns) -> Columns:
    return {**made, "p_left": made["p_left"] * (made["t"] < 0.4 * made["t"][-1])}


def at_its_end(made: Columns) -> Columns:
    most = {name: float(np.quantile(made[name], 0.7)) for name in ("p_left", "p_right")}
    return {**made, **{name: np.minimum(made[name], most[name]) for name in most}}


OWN = Measures.of(ROBOT)
POSE = ("x", "y", "yaw")
LOGS = {
    "speeds in rad/s": (speeds(1 / RADIUS), r"wheels' rates in rad/s.*\[rad/s\*0\.1[01]"),
    "speeds in rad/s, without a pose": (
        without(speeds(1 / RADIUS), *POSE), r"wheels' rates in rad/s"),
    "speeds in km/h, without pose and heading": (
        without(speeds(3.6), *POSE, "yaw_rate"), r"km/h"),
    "power in tenths, of one voltage": (powers(10.0), r"in tenths: map p_left=NAME\[\*0\.1\]"),
    "speeds without signs and heading": (
        without(lambda made: unsigned(made), *POSE, "yaw_rate"), r"lost their sign"),
    "a speed stuck for a while": (
        lambda made: {**made, "v_left": np.where((made["t"] > 40.0) & (made["t"] < 60.0),
                                                 made["v_left"][800], made["v_left"])},
        r"v_left stays at .* its sensor is dead there"),
    "a gyroscope dead for a while": (
        lambda made: {**made, "yaw_rate": made["yaw_rate"] * (np.abs(made["t"] - 50.0) > 20.0)},
        r"yaw_rate stays at 0 .* its sensor is dead there"),
    "a heading that freezes": (
        lambda made: {**made, "yaw": np.where(made["t"] > 80.0, 0.0, made["yaw"])},
        r"yaw stays at 0 from t = 80\.05"),
    "a gyroscope that wakes up late": (
        lambda made: {**made, "yaw_rate": made["yaw_rate"] * (made["t"] >= 60.0)},
        r"yaw_rate stays at 0 from t = 0\.00"),
    "speeds in rpm": (speeds(30 / np.pi / RADIUS), r"rpm\*"),
    "speeds in km/h": (speeds(3.6), r"\[km/h\]"),
    "speeds in mm/s": (speeds(1e3), r"mm/s"),
    "speeds in cm/s": (speeds(100.0), r"cm/s"),
    "time in ms": (scaled(t=1e3), r"t=NAME\[ms\]"),
    "time in us": (scaled(t=1e6), r"t=NAME\[us\]"),
    "time in ns": (scaled(t=1e9), r"t=NAME\[ns\]"),
    "time in minutes": (scaled(t=1 / 60), r"t=NAME\[min\]"),
    "power in kW": (powers(1e-3), r"NAME\[kW\]"),
    "power in mW": (powers(1e3), r"NAME\[mW\]"),
    "yaw in degrees": (scaled(yaw=180 / np.pi), r"yaw=NAME\[deg\]"),
    "yaw in degrees, wrapped": (
        lambda made: {**made, "yaw": np.degrees(made["yaw"]) % 360}, r"yaw=NAME\[deg\]"),
    "one side's power in mW": (scaled(p_left=1e3), r"p_left=NAME\[mW\]"),
    "currents with the sign of the direction": (
        lambda made: {**made, **{f"p_{side}": made[f"p_{side}"] * np.sign(made[f"v_{side}"])
                                 for side in ("left", "right")}},
        r"p_left and p_right are positive forwards and negative backwards.*CURRENT\*SPEED"),
    "yaw rate in deg/s": (scaled(yaw_rate=180 / np.pi), r"yaw_rate=NAME\[deg/s\]"),
    "gyroscope's axis flipped": (scaled(yaw_rate=-1.0), r"gyroscope's axis is flipped.*\[-rad/s\]"),
    "yaw clockwise": (scaled(yaw=-1.0), r"yaw counts clockwise.*yaw=NAME\[-rad\]"),
    "yaw from the y axis": (turned, r"90 degrees beside"),
    "left and right speeds swapped": (swapped("v_left", "v_right"), r"left and right are swapped"),
    "left and right powers swapped": (swapped("p_left", "p_right"), r"p_left and p_right seem"),
    "both speeds backwards": (backwards, r"backwards.*\[-m/s\]"),
    "one speed backwards": (scaled(v_right=-1.0), r"v_right counts the other way.*\[-m/s"),
    "one speed in km/h": (scaled(v_left=3.6), r"one side is in another unit"),
    "power's sign": (powers(-1.0), r"wrong sign"),
    "one side's power's sign": (scaled(p_right=-1.0), r"p_right has the wrong sign"),
    "a Husky's wheel radius": (speeds(HUSKY / RADIUS), r"wheel radius is not.*0\.6[0-9]* times"),
    "a wheel's diameter for its radius": (speeds(2.0), r"diameter is in the place of its radius"),
    "the radius of a small wheel": (speeds(0.5), r"wheel radius is not.*(2|2\.0\d|1\.9\d) times"),
    "pose in mm": (scaled(x=1e3, y=1e3), r"x=NAME\[mm\]"),
    "pose in cm": (scaled(x=100.0, y=100.0), r"x=NAME\[cm\]"),
    "gear ratio of 30 missing": (speeds(30.0), r"divide by the gear ratio"),
    "gear ratio of 30 missing, in rpm": (
        speeds(30 * 30 / np.pi / RADIUS), r"divide by the gear ratio"),
    "gear ratio of 9 missing": (speeds(9.0), r"before their gear.*about (9|8\.9\d)"),
    "speeds in mph": (speeds(1 / 0.44704), r"\[mph\]"),
    "speeds without their sign": (unsigned, r"lost their sign"),
    "speed and yaw rate for tread speeds": (twist, r"follows v_right alone"),
    "one column for both speeds": (in_one_column("v_left", "v_right"), r"v_left and v_right are"),
    "one column for both powers": (in_one_column("p_left", "p_right"), r"power=NAME"),
    "power in horsepower": (powers(1 / 745.7), r"NAME\[hp\]"),
    "one side's power in kW": (scaled(p_right=1e-3), r"another unit.*p_right=NAME\[kW\]"),
    "yaw rate in rpm": (scaled(yaw_rate=30 / np.pi), r"yaw_rate=NAME\[rpm\]"),
    "time in hours": (scaled(t=1 / 3600), r"t=NAME\[h\]"),
    "pose in feet": (scaled(x=1 / 0.3048, y=1 / 0.3048), r"x=NAME\[ft\]"),
    "x and y swapped": (swapped("x", "y"), r"x and y are swapped"),
    "y to the right": (scaled(y=-1.0), r"y=NAME\[-m\]"),
    "z axis down": (pointing_down, r"NED.*y=NAME\[-m\]"),
    "power's sensors hang": (hanging, r"p_left hangs in .*driving"),
    "power's sensors drop out": (dropping_out, r"p_left drops out to 0"),
    "a power's sensor dead": (dead("p_left"), r"p_left is 0 throughout .* sensor is dead"),
    "a power's sensor stuck": (dead("p_right", 7.3), r"p_right is 7\.3 throughout"),
    "a power's sensor dies": (dying, r"p_left stays at 0 from t = .* sensor is dead there"),
    "all power's sensors die": (
        lambda made: {**{k: v for k, v in made.items() if k[:2] != "p_"},
                      "power": (made["p_left"] + made["p_right"]) * (made["t"] < 60.0)},
        r"power stays at 0 from t = 60"),
    "rows filled with 0": (
        lambda made: {**{k: v for k, v in made.items() if k[:2] != "p_"},
                      "power": np.where(np.arange(len(made["t"])) % 2, made["p_left"], 0.0)},
        r"power falls to 0 for a moment .* leave such cells empty"),
    "an encoder stuck": (
        lambda made: {**made, "v_left": made["v_left"][np.minimum(np.arange(len(made["t"])), 900)]},
        r"v_left stays at .* its sensor is dead there"),
    "counters for a side's power": (
        lambda made: {**made, **{f"p_{side}": 0.05 * np.cumsum(made[f"p_{side}"])
                                 for side in ("left", "right")}},
        r"p_left only ever grows.*it counts energy.*p_left=NAME\[Wh\]"),
    "an encoder dead": (
        without(dead("v_left"), *POSE, "yaw_rate"), r"v_left is 0 throughout"),
    "power's sensors at their end": (at_its_end, r"p_right ends at .* end of its range"),
    # a Husky's steady speed of 0.24 m/s, read as 0.2, made its resistance a sixth too large
    "speeds of few digits": (stepped(0.1, "v_left", "v_right"), r"come in steps of 0\.1 m/s"),
    "power of few digits": (
        lambda made: {**{k: v for k, v in made.items() if k[:2] != "p_"},
                      "power": 12.0 * np.round((made["p_left"] + made["p_right"]) / 12.0)},
        r"power comes in steps of 12 W"),
    "motor current for battery current": (motor_current, r"motor's current"),
}  # fmt: skip
BATTERY = {  # the same of a drive whose battery is measured
    "current's sign": (scaled(current=-1.0), r"current has the wrong sign.*\[-A\]"),
    "current in mA": (scaled(current=1e3), r"current=NAME\[mA\]"),
    "power in kW beside voltage and current": (
        lambda made: {**made, "power": 1e-3 * made["voltage"] * made["current"]},
        r"power over voltage times current: 0.001.*power=NAME\[kW\]"),
    "current of few digits": (stepped(0.5, "current"), r"current comes in steps of 0\.5 A"),
    "voltage in mV": (scaled(voltage=1e3), r"voltage=NAME\[mV\]"),
}  # fmt: skip
MEASURES = {
    "track and wheelbase in cm": (Measures(40.0, 62.0, 30.0), r"track and wheelbase are in cm"),
    "track and wheelbase in mm": (Measures(400.0, 620.0, 30.0), r"track and wheelbase are in mm"),
    "wheelbase in cm": (Measures(0.4, 62.0, 30.0), r"the wheelbase is in cm"),
    "track in mm": (Measures(400.0, 0.62, 30.0), r"the track is in mm"),
    "track and wheelbase swapped": (Measures(0.62, 0.4, 30.0), r"swapped"),
    "mass in g": (Measures(0.4, 0.62, 30e3), r"the mass is in g"),
    "track and wheelbase in inches": (Measures(15.75, 24.41, 30.0), r"in inches"),
    "mass as a weight": (Measures(0.4, 0.62, 294.3), r"a weight in N"),
    "mass in t": (Measures(0.4, 0.62, 0.03), r"the mass is in t"),
    "mass in lb": (Measures(0.4, 0.62, 66.1), r"the mass is in lb"),
}
SEEDS = (1, 2)


def test_a_drive_without_mistakes_raises_no_alarm() -> None:
    for seed in (1, 2, 3, 4):
        assert told(drive(seed), OWN) == []
        assert told(drive(seed, battery=True), OWN) == []
        assert told(stepped(0.05, "current")(drive(seed, battery=True)), OWN) == []
        assert told(stepped(0.01, "v_left", "v_right")(drive(seed)), OWN) == []
        assert told(without(speeds(1.0), *POSE)(drive(seed)), OWN) == []


@pytest.mark.parametrize("name", [*LOGS, *BATTERY, *MEASURES])
def test_a_mistake_is_caught_with_its_remedy(name: str) -> None:
    change, remedy = {**LOGS, **BATTERY, **MEASURES}[name]
    for seed in SEEDS:
        made = drive(seed, battery=name in BATTERY)
        measures = change if isinstance(change, Measures) else OWN
        said = " | ".join(told(made if measures is change else change(made), measures))
        assert re.search(remedy, said), said


HALVES = ("a power's sensor dead", "a power's sensor stuck", "one side's power in kW",
          "one column for both powers", "one column for both speeds",
          "speeds without their sign")  # fmt: skip


@pytest.mark.parametrize("name", HALVES)
def test_nothing_is_identified_from_half_of_what_is_needed(name: str) -> None:
    """K would come out at half of what it is, with a small standard error."""
    change, reason = LOGS[name]
    log, whole = (
        ep.DriveLog.from_columns(columns, "drive") for columns in (change(drive(1)), drive(2))
    )
    with pytest.raises(NotIdentifiableError, match=reason):
        ep.identify([whole, log], ROBOT)
    with pytest.raises(NotIdentifiableError, match=reason):
        ep.diagnose(whole, log, ROBOT)


@pytest.mark.parametrize(("name", "value"), [("p_left", 0.0), ("p_right", 40.0), ("v_right", 0.3)])
def test_a_side_that_is_dead_is_not_told_as_another_mistake(name: str, value: float) -> None:
    """Turning mostly one way, sides seem to be swapped, or the other's power to be negative."""
    made = drive(1)
    turn = made["v_right"] > made["v_left"] + 0.05
    one_way = {key: values[turn | (made["v_right"] == 0.0)] for key, values in made.items()}
    said = told(dead(name, value)(one_way), OWN)
    assert any(f"{name} is {value:g} throughout" in text for text in said), said


@pytest.mark.parametrize("count", [3, 12])
@pytest.mark.parametrize(
    ("name", "value"), [("v_left", 15.0), ("p_right", 2e4), ("p_right", 1e9), ("yaw_rate", -18.0)]
)
def test_readings_that_stand_out_are_set_aside(name: str, value: float, count: int) -> None:
    """Three speeds of 15 m/s among 800 readings moved the friction by forty standard errors."""
    made = drive(1)
    rows = np.random.default_rng(count).choice(len(made["t"]), count, replace=False)
    values = made[name].copy()
    values[rows] = value
    log = ep.DriveLog.from_columns({**made, name: values}, "drive")
    assert sum(item.count for item in log.set_aside if "blanked" in item.reason) == count
    clean = ep.identify(ep.DriveLog.from_columns(made, "drive"), ROBOT)
    found = ep.identify(log, ROBOT).model.coefficients
    error = [clean.std_error[term.name] for term in clean.model.terms]
    assert np.all(np.abs(found - clean.model.coefficients) < error)


def test_what_lasts_is_no_glitch() -> None:
    """A robot that creeps and drives ten times as fast for a second; a motor that starts."""
    made = drive(1)
    first = np.flatnonzero(made["v_left"] > 0.1)[40]
    for name in ("v_left", "v_right"):
        made[name] = 0.1 * made[name]
        made[name][first : first + 20] *= 10.0
    made["p_left"][first] = 5.0 * made["p_left"].max()
    assert not ep.DriveLog.from_columns(made, "drive").set_aside


def test_powers_that_are_held_between_readings_are_told() -> None:
    """A Warthog's are read once a second, so half a second late in the mean."""
    made = drive(1)
    last = np.arange(len(made["t"])) // 20 * 20  # once a second
    for name in ("p_left", "p_right"):
        made[name] = made[name][last]
    warnings = ep.DriveLog.from_columns(made, "drive").warnings
    (told_once,) = (text for text in warnings if "read every" in text)
    assert "p_left and p_right are read every 1 s only" in told_once
    # That a reading is held makes it late: no second warning says so.
    assert not any("hangs" in text or "lags behind" in text for text in warnings), warnings
    last = np.maximum(last - 30, 0)  # a second and a half later still
    for name in ("p_left", "p_right"):
        made[name] = made[name][last]
    warnings = ep.DriveLog.from_columns(made, "drive").warnings
    assert any("power lags behind" in text for text in warnings), warnings


def real_logs(data: Path) -> Iterator[tuple[ep.DriveLog, Measures]]:
    """Drives of real robots and of a physics engine, with the robots' measures."""
    husky, warthog = Measures(0.555, 0.512, 70.0), Measures(1.13, 0.91, 470.0)
    for folder in ("borealtc", "vulpi"):
        for file in sorted((data / folder).glob("*/pro_*.csv")):
            yield read_log(file, topics="husky"), husky
    yield read_log(data / "drive" / "warthog_grass.csv", "yaw_rate=gyro_z"), warthog
    for file in sorted((data / "drive").glob("husky_hoisted_*.csv")):
        yield read_log(file, topics="husky"), husky
    for file in sorted((data / "quadriga_mujoco").glob("*_s2_valid.csv.gz")):
        yield read_log(file), Measures(0.5, 0.475, 83.1 if "empty" in file.name else 147.1)


@pytest.mark.shared
def test_real_drives_raise_no_alarm(shared_data: Path) -> None:
    """Not even those with quantised speeds, poses that jitter, and wheels in snow or in the air."""
    alarms = []
    count = 0
    for log, measures in real_logs(shared_data):
        count += 1
        checks = check_consistency(Observed(log.channels, log.power, log.runs), measures)
        alarms += [f"{log.name}: {check}" for check in checks if not check.ok]
        words = ("counts the other way", "another unit", "backwards", "beside", "jumps up",
                 "swapped", "as far as", "their sign", "alone",
                 "mirror", "are the same", "repeats a reading", "never negative")  # fmt: skip
        alarms += [f"{log.name}: {text}" for text in log.warnings if any(w in text for w in words)]
    assert count > 90
    assert alarms == []


def test_a_current_in_steps_on_a_steady_drive_does_not_hang() -> None:
    """A reading a second, of a machine that keeps its speed: the step is wider than the noise."""
    log = simulate.drive(
        MODEL, simulate.IDENTIFICATION, duration=300.0, rate=1.0, speed_noise=0.01, speed=1.2,
        accel_limit=0.4, measured="battery",
    )  # fmt: skip
    seen = {**log.channels, "current": np.round(log.channel("current"), 2)}
    assert not any("hangs" in text for text in ep.DriveLog.from_columns(seen).warnings)


def test_on_the_spot_a_flipped_gyroscope_is_no_mirrored_motor() -> None:
    """With one side turned round, nothing would contradict the gyroscope: nothing would turn."""
    log = simulate.drive(MODEL, "spin", power_noise=3.0, speed_noise=0.004, seed=1)
    flipped = {**log.channels, "yaw_rate": -log.channel("yaw_rate")}
    with pytest.raises(DriveLogError, match=r"-1\.00\): the gyroscope's axis is flipped; map yaw_"):
        ep.DriveLog.from_columns(flipped)
