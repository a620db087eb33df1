"""Drive logs as different robots and people write them, each made from a simulated drive."""

from __future__ import annotations

import gzip
import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

import energyplan as ep
from energyplan import simulate
from energyplan.vehicle import Vehicle

EPOCH = 1_770_000_000.25
RPM, DEG = 30 / np.pi, 180 / np.pi


@dataclass(frozen=True)
class Robot:
    """A robot, its power parameters, the radius of its wheels, its usual speed and voltage."""

    name: str
    mass: float
    wheelbase: float
    track: float
    radius: float
    speed: float
    K: float
    mu: float
    voltage: float

    @property
    def vehicle(self) -> Vehicle:
        return Vehicle.from_geometry(
            self.name, mass=self.mass, wheelbase=self.wheelbase, track=self.track,
            length=1.3 * self.wheelbase + self.radius, width=1.2 * self.track,
        )  # fmt: skip

    @property
    def model(self) -> ep.PowerModel:
        return ep.PowerModel.paper(self.vehicle, K=self.K, mu=self.mu)

    @property
    def measures(self) -> dict[str, float]:
        return {
            "mass": self.mass, "wheelbase": self.wheelbase, "track": self.track,
            "wheel_radius": self.radius,
        }  # fmt: skip


TOY = Robot("toy", 1.1, 0.11, 0.13, 0.03, 0.25, 0.5, 0.6, 7.4)
ROVER = Robot("rover", 30.0, 0.5, 0.45, 0.11, 0.8, 14.0, 0.6, 25.6)
HEAVY = Robot("heavy", 480.0, 0.95, 1.1, 0.3, 1.0, 180.0, 0.55, 48.0)
LOADER = Robot("loader", 5000.0, 1.4, 1.6, 0.45, 1.2, 1500.0, 0.5, 400.0)
ROBOTS = (TOY, ROVER, HEAVY, LOADER)


def drive(robot: Robot, rate: float = 10.0, seed: int = 1) -> ep.DriveLog:
    """Simulate the drive that a log is made from."""
    return simulate.drive(
        robot.model, simulate.IDENTIFICATION, rate=rate, speed=robot.speed,
        accel_limit=0.5 * robot.speed, power_noise=0.02 * robot.K * robot.speed,
        speed_noise=0.004 * robot.speed, seed=seed,
    )  # fmt: skip


class At:
    """What a robot's sensors show in a drive."""

    def __init__(self, log: ep.DriveLog, robot: Robot) -> None:
        self.log, self.robot, self.t, self.power = log, robot, log.t, log.power
        self.left, self.right = log.channel("v_left"), log.channel("v_right")
        self.p_left, self.p_right = log.channel("p_left"), log.channel("p_right")
        self.yaw, self.yaw_rate = log.channel("yaw"), log.channel("yaw_rate")
        # A battery's voltage sags a little.
        self.volts = robot.voltage * (1 - 0.03 * log.power / np.max(np.abs(log.power)))
        self.amps = log.power / self.volts
        start = pd.Timestamp("2026-05-04T23:58:30.125")  # midnight comes on the way
        self.stamps = pd.DatetimeIndex(start + pd.to_timedelta(np.round(log.t, 6), unit="s"))
        self.nanoseconds = np.round(1e9 * (EPOCH + log.t)).astype(np.int64)

    def house(self) -> pd.DataFrame:
        """Return the columns as the library itself names them."""
        return pd.DataFrame({
            "t": self.t, "v_left": self.left, "v_right": self.right, "power": self.power,
            "yaw_rate": self.yaw_rate,
        })  # fmt: skip

    def wheels(self, rate: float, names: tuple[str, ...]) -> dict[str, np.ndarray]:
        """Return four wheels' rates: front left, front right, rear left, rear right."""
        noise = np.random.default_rng(3).normal(0, 0.002 * self.robot.speed, (2, len(self.t)))
        rates = [side + sign * extra for sign in (1, -1)
                 for side, extra in zip((self.left, self.right), noise, strict=True)]  # fmt: skip
        return {n: r * rate / self.robot.radius for n, r in zip(names, rates, strict=True)}


def csv(
    columns: object, file: Path, *, head: str = "", encoding: str = "utf-8", **options: Any
) -> Path:
    """Write columns as text, with something before them if need be."""
    data = (head + pd.DataFrame(columns).to_csv(index=False, **options)).encode(encoding)
    file.write_bytes(gzip.compress(data) if file.suffix == ".gz" else data)
    return file


# -- logs that are to be read -----------------------------------------------------------------


def four_wheels_in_rpm(at: At, folder: Path) -> Path:
    return csv({
        "timestamp_ms": np.round(1e3 * (EPOCH + at.t)).astype(np.int64),
        **at.wheels(RPM, ("FL (rpm)", "FR (rpm)", "RL (rpm)", "RR (rpm)")), "batt_V": at.volts,
        "batt_I [mA]": 1e3 * at.amps, "gyro_z_dps": DEG * at.yaw_rate,
    }, folder / "telemetry.csv")  # fmt: skip


def four_motors(at: At, folder: Path) -> Path:
    names = tuple(f"wheel_{wheel}_speed_radps" for wheel in ("fl", "fr", "rl", "rr"))
    left, right = 1e3 * at.p_left / at.volts, 1e3 * at.p_right / at.volts
    return csv({
        "Time": at.t, **at.wheels(1.0, names), "current_fl_wheel_mA": 0.6 * left,
        "current_fr_wheel_mA": 0.45 * right, "current_rl_wheel_mA": 0.4 * left,
        "current_rr_wheel_mA": 0.55 * right, "vbat_mV": 1e3 * at.volts, "imu_wz": at.yaw_rate,
    }, folder / "motors.csv")  # fmt: skip


def german(at: At, folder: Path) -> Path:
    return csv({
        "Uhrzeit": [stamp.isoformat() for stamp in at.stamps.tz_localize("Europe/Berlin")],
        "v links [km/h]": 3.6 * at.left, "v rechts [km/h]": 3.6 * at.right,
        "Leistung [kW]": 1e-3 * at.power, "Gierrate [°/s]": DEG * at.yaw_rate,
    }, folder / "Fahrt 1.csv", sep=";", decimal=",", encoding="cp1252")  # fmt: skip


def utf16(at: At, folder: Path) -> Path:
    return csv({
        " time [ns] ": at.nanoseconds, " left speed [mm/s] ": 1e3 * at.left,
        " right speed [mm/s] ": 1e3 * at.right, " power [W] ": at.power,
        " heading [deg] ": DEG * at.yaw % 360,
    }, folder / "unicode.csv", sep="\t", encoding="utf-16")  # fmt: skip


def byte_order_mark(at: At, folder: Path) -> Path:
    house = at.house().rename(columns=" {} ".format)
    return csv(house, folder / "bom.csv", encoding="utf-8-sig")


def units_in_a_second_row(at: At, folder: Path) -> Path:
    names = ("time", "wheel speed left", "wheel speed right", "bus voltage", "bus current", "yaw")
    head = ",".join(f'"{name}"' for name in names) + '\n"ms","rpm","rpm","V","A","deg"\n'
    rate = RPM / at.robot.radius
    cells = (1e3 * at.t, rate * at.left, rate * at.right, at.volts, at.amps, DEG * at.yaw)
    return csv(np.stack(cells, axis=1), folder / "two_rows.csv", head=head, header=False)


def remarks_before_the_names(at: At, folder: Path) -> Path:
    return csv({
        "Time_s": at.t, "velL_cm_s": 100 * at.left, "velR_cm_s": 100 * at.right,
        "power_kW": 1e-3 * at.power, "yaw_rate_rad_s": at.yaw_rate,
    }, folder / "remarks.csv", head="# robot: rover 7\n# firmware 2.1, started 2026-05-04\n\n"
    )  # fmt: skip


def words_for_nothing(at: At, folder: Path) -> Path:
    cells = at.house().map("{:.6f}".format)
    words = ("nan", "NULL", "-", "inf", "n/a", "#N/A", "-inf", "None", "NaN", "---", "?", "N/A",
             "missing", "--", "1.#QNAN", "1.#INF")  # fmt: skip
    for k, word in enumerate(words):
        cells.loc[30 + 17 * k, ("power", "v_left", "yaw_rate")[k % 3]] = word
    cells.iloc[0] = "nan"
    file = csv(cells, folder / "words.csv")
    file.write_bytes(file.read_bytes() + bytes(99))  # as after a loss of power
    return file


def two_recordings(at: At, folder: Path) -> Path:
    """The second with its own line of names, and its own clock."""
    second = At(drive(at.robot, seed=9), at.robot).house()
    return csv(second, folder / "both.csv", head=at.house().to_csv(index=False))


def a_part_twice(at: At, folder: Path) -> Path:
    """As a logger writes that loses its connection and sends its buffer again."""
    house = at.house()
    return csv(pd.concat([house[:600], house[500:]]), folder / "twice.csv")


def stamps_in_whole_seconds(at: At, folder: Path) -> Path:
    stamps = at.stamps.strftime("%I:%M:%S %p")
    return csv(at.house().assign(t=stamps).rename(columns={"t": "Time"}), folder / "seconds.csv")


def json_lines(at: At, folder: Path) -> Path:
    """An object a row, with objects in it; one row is empty."""
    file = folder / "telemetry.jsonl"
    rows = (
        {"stamp": EPOCH + t, "wheels": {"left": left, "right": right},
         "battery": {"voltage": volts, "current": amps}, "imu": {"gyro": [0.0, 0.0, rate]}}
        for t, left, right, volts, amps, rate in zip(
            at.t, at.left, at.right, at.volts, at.amps, at.yaw_rate, strict=True)
    )  # fmt: skip
    file.write_text("\n".join(["", *map(json.dumps, rows)]))
    return file


def topics_named_for_power(at: At, folder: Path) -> Path:
    wheel = "/joint_states/{}_wheel/velocity".format
    return csv({
        "Time": EPOCH + at.t, wheel("left"): at.left / at.robot.radius,
        wheel("right"): at.right / at.robot.radius, "/power/battery/voltage": at.volts,
        "/power/battery/current": -at.amps, "/odom/pose/pose/position.x": at.log.channel("x"),
        "/odom/pose/pose/position.y": at.log.channel("y"), "/imu/angular_velocity.z": at.yaw_rate,
    }, folder / "paths.csv")  # fmt: skip


def bare_names_in_thousandths(at: At, folder: Path) -> Path:
    """Sides with no more than their name, and units that the weight alone tells."""
    return csv({
        "ts": at.nanoseconds // 1000, "left_cmd": 1.1 * at.left, "left_meas": at.left,
        "right_cmd": 1.1 * at.right, "right_meas": at.right, "v_batt": np.round(1e3 * at.volts),
        "i_batt": np.round(1e3 * at.amps), "Drehrate [Grad/s]": DEG * at.yaw_rate,
    }, folder / "bare.csv")  # fmt: skip


def sides_in_turn(at: At, folder: Path) -> Path:
    """Each row holds the power of one side; at rest, of both."""
    even = np.arange(len(at.t)) % 2 == 0
    rest = (np.abs(at.left) < 0.01) & (np.abs(at.right) < 0.01)
    return csv({
        "t": at.t, "v_left": at.left, "v_right": at.right, "yaw_rate": at.yaw_rate,
        "p_left": np.where(even | rest, at.p_left, np.nan),
        "p_right": np.where(~even | rest, at.p_right, np.nan),
    }, folder / "in_turn.csv")  # fmt: skip


def what_changed_alone(at: At, folder: Path) -> Path:
    """A reading is written where it differs from the one before, to a thousandth of its range."""
    columns = {"v_left": at.left, "v_right": at.right, "p_left": at.p_left, "p_right": at.p_right,
               "yaw_rate": at.yaw_rate}  # fmt: skip
    sizes = {name: 1e-3 * np.ptp(values) for name, values in columns.items()}
    rows = pd.DataFrame({n: np.round(v / sizes[n]) * sizes[n] for n, v in columns.items()})
    written = rows.where(rows.ne(rows.shift()))
    return csv(written.assign(t=at.t)[written.notna().any(axis=1)], folder / "on_change.csv")


def readings_in_rows(at: At, folder: Path) -> Path:
    """A reading a row, as a broker of messages stores them."""
    readings = {"wheel/left/velocity": at.left / at.robot.radius, "battery/voltage": at.volts,
                "wheel/right/velocity": at.right / at.robot.radius, "battery/current": at.amps,
                "imu/angular_velocity/z": at.yaw_rate, "mode": ["auto"] * len(at.t)}  # fmt: skip
    rows = pd.concat([pd.DataFrame({"timestamp": at.stamps, "topic": name, "value": values})
                      for name, values in readings.items()])  # fmt: skip
    return csv(rows.sort_values("timestamp", kind="stable"), folder / "readings.csv")


def signals_with_units(at: At, folder: Path) -> Path:
    """A signal a row with its number and unit, each at its own time, as a bus is recorded."""
    signals = (
        ("WheelSpeedLeft", 3.6 * at.left, "km/h"),
        ("BattVoltage", at.volts, "V"),
        ("WheelSpeedRight", 3.6 * at.right, "km/h"),
        ("BattCurrent", at.amps, "A"),
    )
    rows = pd.concat([
        pd.DataFrame({"Timestamp": at.t + 0.002 * k, "Id": 257 + k, "Signal": name, "Value": values,
                      "Unit": unit}) for k, (name, values, unit) in enumerate(signals)
    ])  # fmt: skip
    return csv(rows.sort_values("Timestamp"), folder / "bus.csv")


def knots(at: At, folder: Path) -> Path:
    return csv({
        "utc": at.stamps, "left_speed_kn": at.left / 0.514444,
        "right_speed_kn": at.right / 0.514444, "watts": at.power, "gyro_z": at.yaw_rate,
    }, folder / "boat.csv")  # fmt: skip


def coarse_stamps(at: At, folder: Path) -> Path:
    return csv(at.house().assign(t=np.round(at.t * 4) / 4), folder / "coarse.csv")


def a_row_for_each_message(at: At, folder: Path) -> Path:
    """As PlotJuggler writes what several topics hold."""
    joints = {"__time": EPOCH + at.t, "/joints/left_wheel/velocity": at.left / at.robot.radius,
              "/joints/right_wheel/velocity": at.right / at.robot.radius}  # fmt: skip
    battery = {"__time": EPOCH + at.t + 0.006, "/battery_state/voltage": at.volts,
               "/battery_state/current": -at.amps}  # fmt: skip
    imu = {"__time": EPOCH + at.t + 0.004, "/imu/data/angular_velocity/z": at.yaw_rate}
    rows = pd.concat([pd.DataFrame(part) for part in (joints, battery, imu)])
    return csv(rows.sort_values("__time"), folder / "plotjuggler.csv")


def stamps_in_two_columns(at: At, folder: Path) -> Path:
    """As stamps of ROS messages are flattened."""
    seconds = np.floor(EPOCH + at.t)
    return csv({
        "header.stamp.sec": seconds.astype(int),
        "header.stamp.nanosec": np.round((EPOCH + at.t - seconds) * 1e9).astype(int),
        "wheel_left.velocity": at.left / at.robot.radius,
        "wheel_right.velocity": at.right / at.robot.radius,
        "battery.voltage": at.volts, "battery.current": -at.amps,
        "imu.angular_velocity.z": at.yaw_rate,
    }, folder / "stamps.csv")  # fmt: skip


def date_and_time_of_day(at: At, folder: Path) -> Path:
    frame = at.house().assign(t=at.stamps.strftime("%H:%M:%S.%f")).rename(columns={"t": "time"})
    return csv({"date": at.stamps.strftime("%d.%m.%Y"), **frame}, folder / "clock.csv")


def american_dates(at: At, folder: Path) -> Path:
    written = at.stamps.strftime("%m/%d/%Y %I:%M:%S.%f %p")
    return csv(at.house().assign(t=written), folder / "american.csv")


def aligned_by_spaces(at: At, folder: Path) -> Path:
    file = folder / "aligned.txt"
    file.write_text(f"# {at.house().to_string(index=False, float_format='%.6f')}\n")
    return file


def newest_first(at: At, folder: Path) -> Path:
    return csv(at.house()[::-1], folder / "newest_first.csv")


def units_in_names(at: At, folder: Path) -> Path:
    return csv({
        "t_ms": 1e3 * at.t, "v_left_kmh": 3.6 * at.left, "v_right_kmh": 3.6 * at.right,
        "current_mA": 1e3 * at.amps, "voltage_mV": 1e3 * at.volts, "yaw_deg": DEG * at.yaw,
        "yaw_rate_deg_s": DEG * at.yaw_rate,
    }, folder / "suffixes.csv.gz")  # fmt: skip


def rostopic_echo(at: At, folder: Path) -> Path:
    return csv({
        "%time": at.nanoseconds, "field.header.seq": np.arange(len(at.t)),
        "field.header.stamp": at.nanoseconds, "field.left_vel": at.left,
        "field.right_vel": at.right, "field.voltage": at.volts, "field.current": -at.amps,
    }, folder / "echo.csv")  # fmt: skip


def counts(at: At, side: np.ndarray, per_metre: float, first: float = 0.0) -> np.ndarray:
    """Return what an encoder of a side has counted."""
    steps = 0.5 * np.diff(at.t) * (side[1:] + side[:-1])
    return np.floor(first + per_metre * np.concatenate([[0.0], np.cumsum(steps)]))


def position(at: At) -> dict[str, np.ndarray]:
    """Return where a satellite receiver sees the robot, 48 degrees north."""
    degree = 111_195.08
    return {
        "gps.latitude": 48.0 + at.log.channel("y") / degree,
        "gps.longitude": 11.0 + at.log.channel("x") / degree / np.cos(np.radians(48.0)),
    }


def encoders_of_four_wheels(at: At, folder: Path) -> Path:
    """Counters of 16 bits; those of the left count down on the way ahead."""
    left, right = counts(at, at.left, 8000.0), counts(at, at.right, 8000.0)
    return csv({
        "time": at.t, "enc_fl": -left % 65536, "enc_fr": right % 65536, "enc_rl": -left % 65536,
        "enc_rr": (right + 40000) % 65536, "x": at.log.channel("x"), "y": at.log.channel("y"),
        "yaw": at.yaw, "power_w": at.power,
    }, folder / "wheels.csv")  # fmt: skip


def encoders_from_row_to_row(at: At, folder: Path) -> Path:
    left, right = (np.diff(counts(at, side, 5e4), prepend=0.0) for side in (at.left, at.right))
    return csv({
        "time": at.t, "encoder_count_l": left, "encoder_count_r": right,
        "ground speed [km/h]": 1.8 * (at.left + at.right), "gyro_z": at.yaw_rate,
        "power": at.power,
    }, folder / "steps.csv")  # fmt: skip


def encoders_that_tell_a_rate(at: At, folder: Path) -> Path:
    return csv({
        "time": at.t, "enc_left_tps": np.round(4e4 * at.left),
        "enc_right_tps": np.round(4e4 * at.right), "pose_x": at.log.channel("x"),
        "pose_y": at.log.channel("y"), "heading": at.yaw, "power_w": at.power,
    }, folder / "rates.csv")  # fmt: skip


def status_topic(at: At, folder: Path) -> Path:
    """As a controller's status messages and odometry come out of a bag."""
    return csv({
        "Time": EPOCH + at.t, "status.header.seq": np.arange(len(at.t)),
        "status.left_driver_current": at.p_left / at.volts,
        "status.right_driver_current": at.p_right / at.volts,
        "status.left_driver_voltage": at.volts, "status.right_driver_voltage": at.volts,
        "status.left_motor_temp": 31.0, "status.right_motor_temp": 32.0,
        "status.left_ticks": counts(at, at.left, 7000.0) % 65536,
        "status.right_ticks": counts(at, at.right, 7000.0) % 65536,
        "odom.twist.twist.linear.x": 0.5 * (at.left + at.right),
        "odom.twist.twist.angular.z": at.yaw_rate,
    }, folder / "status.csv")  # fmt: skip


def flight_controller(at: At, folder: Path) -> Path:
    """A row for each message: encoders, battery, gyroscope and position of an autopilot."""
    parts: tuple[tuple[dict[str, np.ndarray], int, float], ...] = (
        ({"WENC.LeftTicks": counts(at, at.left, 1e4),
          "WENC.RightTicks": counts(at, at.right, 1e4)}, 1, 0.0),
        ({"BAT.Volt": at.volts, "BAT.Curr": at.amps}, 1, 3e3),
        ({"IMU.GyrZ": at.yaw_rate}, 1, 5e3),
        (position(at), 2, 6e3),
    )  # fmt: skip
    rows = [
        pd.DataFrame({"TimeUS": np.round(1e6 * at.t + late), **columns})[::step]
        for columns, step, late in parts
    ]
    return csv(pd.concat(rows).sort_values("TimeUS"), folder / "rover.csv")


def flattened_messages(at: At, folder: Path) -> Path:
    """As messages are flattened: w is a part of a quaternion, x and y are of a magnetometer too."""
    wheel = "/joint_states/{}_wheel_joint/velocity".format
    turn = {"z": np.sin(0.5 * at.yaw), "w": np.cos(0.5 * at.yaw)}
    still = dict.fromkeys("xy", np.zeros(len(at.t)))
    return csv({
        "__time": EPOCH + at.t, wheel("left"): at.left / at.robot.radius,
        wheel("right"): at.right / at.robot.radius,
        **{f"/imu/orientation/{axis}": cells for axis, cells in {**still, **turn}.items()},
        "/tf/base_link/rotation/w": turn["w"], "/imu/angular_velocity/z": at.yaw_rate,
        "/imu/mag/x": np.cos(at.yaw), "/imu/mag/y": -np.sin(at.yaw),
        "/battery_state/voltage": at.volts, "/battery_state/current": -at.amps,
        "/battery_state/percentage": 0.9 - 1e-5 * at.t,
    }, folder / "flat.csv")  # fmt: skip


def days(at: At, folder: Path) -> Path:
    """As spreadsheets count time."""
    house = at.house().assign(t=46_000.0 + at.t / 86400.0)
    return csv(house.rename(columns={"t": "Date Time"}), folder / "sheet.csv")


def motors_in_the_mirror(at: At, folder: Path) -> Path:
    """Rates of motors before a gear; those of the left turn backwards on the way ahead."""
    rate = 30 * RPM / at.robot.radius
    return csv({
        "time": at.t, "motor_left_rpm": -rate * at.left, "motor_right_rpm": rate * at.right,
        "x": 5e5 + at.log.channel("x"), "y": 5e6 + at.log.channel("y"), "gyro_z": at.yaw_rate,
        "power": at.power,
    }, folder / "mirror.csv")  # fmt: skip


def rows_in_bursts(at: At, folder: Path) -> Path:
    """Five rows at once, with the times of their arrival."""
    rows = np.arange(len(at.t))
    last = np.minimum(rows // 5 * 5 + 4, rows[-1])
    arrival = at.t[last] + 1e-4 * (rows - last) + 0.01 * np.sin(last)
    return csv(at.house().assign(t=arrival), folder / "bursts.csv")


def rates_beside_a_blank_gyroscope(at: At, folder: Path) -> Path:
    house = at.house().assign(yaw_rate=np.nan)
    wheels = {f"wheel_{side}": house[f"v_{side}"] / at.robot.radius for side in ("left", "right")}
    named = house.drop(columns=["v_left", "v_right"]).assign(
        **{f"{name} [rad/s]": values for name, values in wheels.items()}
    )
    return csv(named, folder / "blank.csv")


def a_counter_that_overflows(at: At, folder: Path) -> Path:
    """Milliseconds in sixteen bits."""
    house = at.house().assign(t=(np.round(1e3 * at.t) + 30_000) % 65_536)
    return csv(house.rename(columns={"t": "t_ms"}), folder / "overflow.csv")


def files_of_controllers(at: At, folder: Path) -> Path:
    """A file for each side's motor controller, and one for the battery."""
    sides = {"left": (at.t, at.left, at.p_left), "right": (at.t + 0.003, at.right, at.p_right)}
    for name, (t, speed, power) in sides.items():
        amps = np.round(10 * power / at.volts, 3)
        csv({"t": t, "speed": speed / at.robot.radius, "current_dA": amps}, folder / f"{name}.csv")
    pack = csv({"t": at.t[::5], "voltage": at.volts[::5]}, folder / "pack.csv")
    return Path(f"{folder}/left.csv+{folder}/right.csv+{pack}")


# -- logs that are to be refused, or doubted ------------------------------------------------------


def speed_and_yaw_rate(at: At, folder: Path) -> Path:
    turn = (at.right - at.left) / at.robot.track
    return csv({
        "time": at.t, "linear_velocity_x": 0.5 * (at.left + at.right), "angular_velocity_z": turn,
        "battery_voltage": at.volts, "battery_current": at.amps,
    }, folder / "odometry.csv")  # fmt: skip


def numbered_axes(at: At, folder: Path) -> Path:
    turns = 1 / (2 * np.pi * at.robot.radius)
    return csv({
        "time": at.t, "axis0.encoder.vel_estimate": turns * at.left,
        "axis1.encoder.vel_estimate": turns * at.right, "vbus_voltage": at.volts, "ibus": at.amps,
    }, folder / "axes.csv", sep=";")  # fmt: skip


def electrical_rates(at: At, folder: Path) -> Path:
    rate = 7 * 20 * RPM / at.robot.radius
    return csv({
        "ms_today": np.round(1e3 * at.t) + 4321, "input_voltage": at.volts,
        "left_erpm": np.round(rate * at.left), "right_erpm": np.round(rate * at.right),
        "left_current_motor": 2 * at.p_left / at.volts,
        "right_current_motor": 2 * at.p_right / at.volts,
        "left_current_in": at.p_left / at.volts, "right_current_in": at.p_right / at.volts,
    }, folder / "controllers.csv", sep=";")  # fmt: skip


def torques(at: At, folder: Path) -> Path:
    """As a simulator writes what its joints do."""
    columns = {"sim_time": at.t}
    for side, speed, power in (("left", at.left, at.p_left), ("right", at.right, at.p_right)):
        rate = speed / at.robot.radius
        columns[f"{side}_wheel_joint_velocity"] = rate
        columns[f"{side}_wheel_joint_effort"] = np.divide(
            power, rate, out=np.zeros_like(rate), where=rate != 0
        )
    return csv({**columns, "world_yaw": at.yaw}, folder / "joints.csv")


def sides_in_letters(at: At, folder: Path) -> Path:
    """Either power fits a whole robot's as well as the other: one alone is half of it."""
    return csv({
        "time": at.t, "v_left": at.left, "v_right": at.right, "power_a": at.p_left,
        "power_b": at.p_right, "yaw_rate": at.yaw_rate,
    }, folder / "letters.csv")  # fmt: skip


def units_in_cells(at: At, folder: Path) -> Path:
    house = at.house()
    return csv(house.assign(v_left=house["v_left"].map("{:.4f} m/s".format)), folder / "cells.csv")


def thousands(at: At, folder: Path) -> Path:
    written = (1e3 * at.house()["power"]).map("{:,.1f}".format)
    return csv({**at.house().drop(columns="power"), "power [mW]": written}, folder / "k.csv")


def currents_without_sign(at: At, folder: Path) -> Path:
    return csv({
        "time": at.t, "v_left": at.left, "v_right": at.right, "yaw_rate": at.yaw_rate,
        "u": at.volts, "i_left": np.abs(at.p_left / at.volts),
        "i_right": np.abs(at.p_right / at.volts),
    }, folder / "unsigned.csv")  # fmt: skip


def two_robots(at: At, folder: Path) -> Path:
    other = At(drive(at.robot, seed=4), at.robot)
    shift = len(at.t) // 3
    return csv({
        "time": at.t, "robot1/left_speed": at.left, "robot1/right_speed": at.right,
        "robot1/power": at.power, "robot2/left_speed": np.roll(other.left, shift),
        "robot2/right_speed": np.roll(other.right, shift),
        "robot2/power": np.roll(other.power, shift),
    }, folder / "two.csv")  # fmt: skip


def packs_in_series(at: At, folder: Path) -> Path:
    return csv({
        "time": at.t, "v_left": at.left, "v_right": at.right, "battery1_voltage": 0.5 * at.volts,
        "battery2_voltage": 0.5 * at.volts, "battery_current": at.amps, "yaw_rate": at.yaw_rate,
    }, folder / "packs.csv")  # fmt: skip


def row_numbers(at: At, folder: Path) -> Path:
    return csv(at.house().assign(t=np.arange(len(at.t))).rename(columns={"t": "n"}),
               folder / "rows.csv")  # fmt: skip


def a_dead_wheel(at: At, folder: Path) -> Path:
    wheels = at.wheels(RPM, ("fl_rpm", "fr_rpm", "rl_rpm", "rr_rpm"))
    wheels["rl_rpm"] = 0.0 * wheels["rl_rpm"]
    return csv({"time": at.t, **wheels, "power": at.power}, folder / "dead.csv")


def a_wheel_in_the_mirror(at: At, folder: Path) -> Path:
    wheels = at.wheels(RPM, ("fl_rpm", "fr_rpm", "rl_rpm", "rr_rpm"))
    wheels["rr_rpm"] = -wheels["rr_rpm"]
    return csv({"time": at.t, **wheels, "power": at.power}, folder / "turned.csv")


def counted(at: At, flow: np.ndarray, unit: float) -> np.ndarray:
    """Return what a counter counts of a power or current since some start."""
    mean = 0.5 * (flow[1:] + flow[:-1]) * np.diff(at.t)
    return 17.0 + np.append(0.0, np.cumsum(mean)) / unit


def energy_counter(at: At, folder: Path) -> Path:
    return csv({
        "time": at.t, "left_speed": at.left, "right_speed": at.right, "gyro_z": at.yaw_rate,
        "watt_hours": counted(at, at.power, 3600.0),
    }, folder / "vesc.csv")  # fmt: skip


def energy_counter_beside_the_current(at: At, folder: Path) -> Path:
    return csv({
        "time": at.t, "left_speed": at.left, "right_speed": at.right, "gyro_z": at.yaw_rate,
        "watt_hours": counted(at, at.power, 3600.0), "input_voltage": at.volts,
        "current_in": at.amps,
    }, folder / "both.csv")  # fmt: skip


def charge_counter(at: At, folder: Path) -> Path:
    return csv({
        "time": at.t, "left_speed": at.left, "right_speed": at.right, "gyro_z": at.yaw_rate,
        "BAT.Volt": at.volts, "BAT.CurrTot": counted(at, at.amps, 3.6),
    }, folder / "ardupilot.csv")  # fmt: skip


def names_one_too_many(at: At, folder: Path) -> Path:
    head = "t,v_left,v_right,yaw_rate,imu_ok,power,voltage\n"
    frame = at.house()[["t", "v_left", "v_right", "yaw_rate", "power"]].assign(voltage=at.volts)
    return csv(frame, folder / "firmware.csv", head=head, header=False)


def cells_missing_in_some_rows(at: At, folder: Path) -> Path:
    lines = at.house().to_csv(index=False).splitlines()
    lines[200::20] = [line.partition(",")[2] for line in lines[200::20]]
    file = folder / "missing.csv"
    file.write_text("\n".join(lines))
    return file


def no_names(at: At, folder: Path) -> Path:
    """As of ``ros2 topic echo --csv``, which repeats values and writes words and nan."""
    frame = pd.DataFrame({"sec": 1731300000, "nsec": np.round(1e9 * (at.t % 1)).astype(int),
                          "frame": "base_link", "v": at.volts, "t": "nan", "i": at.amps,
                          "c": "nan"})  # fmt: skip
    return csv(frame, folder / "echo.csv", header=False)


def hundredths(at: At, folder: Path) -> Path:
    return csv({
        "time": at.t, "left_speed": at.left, "right_speed": at.right, "gyro_z": at.yaw_rate,
        "batVoltage": np.round(100 * at.volts), "dcCurr": np.round(100 * at.amps),
    }, folder / "hoverboard.csv")  # fmt: skip


def no_time(at: At, folder: Path) -> Path:
    head = "started;2026-05-04 10:00:00\nsample rate;10 Hz\n"
    return csv(at.house().drop(columns="t"), folder / "no_time.csv", head=head, sep=";")


def no_reading_by_a_number(at: At, folder: Path) -> Path:
    house = at.house()
    house.loc[100:140, "v_left"] = -9999.0
    return csv(house, folder / "sentinel.csv")


def minutes_and_seconds(at: At, folder: Path) -> Path:
    written = [f"{t // 60:02.0f}:{t % 60:06.3f}" for t in at.t]
    return csv(at.house().assign(t=written), folder / "stopwatch.csv")


def commas_in_decimals(at: At, folder: Path) -> Path:
    return csv(at.house().map("{:.3f}".format).replace(r"\.", ",", regex=True),
               folder / "commas.csv", quoting=3, escapechar=" ")  # fmt: skip


def unknown_units(at: At, folder: Path) -> Path:
    names = {"v_left": "left speed [furlong/h]", "v_right": "right speed [furlong/h]"}
    return csv(at.house().rename(columns=names), folder / "furlongs.csv")


def dates_of_a_spreadsheet(at: At, folder: Path) -> Path:
    stamps = at.stamps.strftime("%d/%m/%Y %H:%M:%S.%f")
    return csv(at.house().drop(columns="t").assign(Date=stamps), folder / "dates.csv")


def current_alone(at: At, folder: Path) -> Path:
    house = at.house().drop(columns="power").assign(bus_current=at.amps)
    return csv(house, folder / "amps.csv")


def power_in_percent(at: At, folder: Path) -> Path:
    share = 100.0 * at.power / np.max(at.power)
    return csv(at.house().drop(columns="power").assign(power_pct=share), folder / "share.csv")


def powers_of_front_wheels(at: At, folder: Path) -> Path:
    names = ("fl_speed", "fr_speed", "rl_speed", "rr_speed")
    return csv({
        "time": at.t, **at.wheels(at.robot.radius, names), "fl_power": 0.5 * at.p_left,
        "fr_power": 0.5 * at.p_right,
    }, folder / "front.csv")  # fmt: skip


def matlab(at: At, folder: Path) -> Path:
    (folder / "drive.mat").write_bytes(b"MATLAB 7.3 MAT-file")
    return folder / "drive.mat"


Writer = Callable[[At, Path], Path]
READ: tuple[Writer, ...] = (
    four_wheels_in_rpm, four_motors, byte_order_mark, units_in_a_second_row,
    remarks_before_the_names, words_for_nothing, coarse_stamps, topics_named_for_power,
    bare_names_in_thousandths, a_part_twice, stamps_in_whole_seconds, sides_in_turn,
    what_changed_alone, readings_in_rows, a_row_for_each_message, stamps_in_two_columns,
    date_and_time_of_day, aligned_by_spaces, newest_first, units_in_names, rostopic_echo,
    flattened_messages, days, motors_in_the_mirror, rates_beside_a_blank_gyroscope,
    energy_counter, energy_counter_beside_the_current, speed_and_yaw_rate, signals_with_units,
    knots, files_of_controllers,
)  # fmt: skip
"""Logs from which the right coefficients must come."""
REFUSED: dict[Writer, str] = {
    sides_in_letters: r"power_a and power_b could each .* 'p_left=power_a,p_right=power_b'",
    charge_counter: r"only ever grows .* 'current=BAT.CurrTot\[mAh\]'",
    names_one_too_many: "line 1 names 7 columns, but the rows have 6 cells",
    cells_missing_in_some_rows: "line 201: the row has fewer cells than the 5 names, and so have",
    no_names: "line 1 holds numbers, and no line names the columns",
    hundredths: r"2\d\.\d V in .*voltage=batVoltage\[\*0.01\]",
    german: "the columns are Uhrzeit, .* say which it is with --columns v_left=NAME",
    utf16: "UTF-16 text; save it as UTF-8",
    two_recordings: "line 1503: 't' is 't', .* give each recording a file of its own",
    json_lines: r"pandas.json_normalize\(ROWS\)",
    american_dates: "ISO 8601, as in 2026-05-04T23:58:30.125",
    a_counter_that_overflows: r"line 358, .* ran over: .* map t=row\[\*PERIOD\]",
    encoders_of_four_wheels: r'"v_left=enc_fl \+ enc_rl\[ticks\*0.0001\].* ticks/s where',
    encoders_from_row_to_row: r"ticks/sample where they count from row to row",
    encoders_that_tell_a_rate: r'"v_left=enc_left_tps\[ticks/s\*0.0001\]',
    status_topic: r'--counts-per-revolution .* "v_left=status.left_ticks\[ticks\*0.0001\]',
    flight_controller: r'"v_left=WENC.LeftTicks\[ticks\*0.0001\]',
    numbered_axes: r'which side .* "v_left=axis0.encoder.vel_estimate\[UNIT\]',
    electrical_rates: r"v_left=left_erpm\[rpm\*F\]",
    torques: r"p_left=left_wheel_joint_effort\*left_wheel_joint_velocity,p_right=right_wheel_j",
    units_in_cells: "line 2: 'v_left' is '.* m/s', which is no number",
    two_robots: "robot1/left_speed and robot2/left_speed .* do not go alike .* of two robots",
    packs_in_series: r"series .* 'voltage=battery1_voltage\+battery2_voltage'",
    row_numbers: r"'n' counts rows: .* t=n\[\*0.05\]",
    a_dead_wheel: "fl_rpm and rl_rpm .* do not go alike .* one is dead",
    a_wheel_in_the_mirror: "fr_rpm and rr_rpm .* go opposite ways",
    no_time: r"rows come at a steady rate, .* t=row\[\*0.05\]",
    no_reading_by_a_number: "where -9999 stands for no reading, leave the cell empty",
    minutes_and_seconds: "line 2: 't' is '00:00.000', .* times since the start in seconds",
    commas_in_decimals: "more cells than the 5 names .* write decimals with a point",
    unknown_units: r"unit of 'left speed \[furlong/h\]' is not known: .* NAME\[\*0.01\]",
    dates_of_a_spreadsheet: "line 2: 'Date' is '04/05/2026 .* write instants by ISO 8601",
    current_alone: r"the battery's usual one, as in power=bus_current\[\*25.6\]",
    power_in_percent: "'power_pct' is a share, .* which is no power: log the battery's voltage",
    powers_of_front_wheels: r"fl_power is of one wheel, and fl_speed \+ rl_speed of several",
    matlab: r"drive.mat is of MATLAB; writetable\(struct2table\(LOG\)",
    thousands: r"line \d+: 'power \[mW\]' is '-?\d+,\d+.\d', which is no .* without marks",
}
"""Logs that must be refused, and the words of the remedy."""
