"""Drive logs as different robots and people write them, each made from a simulated drive.

`READ` are logs from which the right coefficients must come, `REFUSED` those that are refused, with
what is said and what has them read then. All are tables of *name: what is written*.
"""

from __future__ import annotations

import gzip
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

import energyplan as ep
from energyplan import simulate
from energyplan.vehicle import Vehicle

EPOCH = 1_770_000_000.25
RPM, DEG = 30 / np.pi, 180 / np.pi
WHEELS = ("fl", "fr", "rl", "rr")


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

    def joints(self, name: str, left: float = 1.0, right: float = 1.0) -> dict[str, np.ndarray]:
        """Return the rates of both sides' wheels times factors, by a name with the side in it."""
        rates = left * self.left / self.robot.radius, right * self.right / self.robot.radius
        return {
            name.format(side): rate for side, rate in zip(("left", "right"), rates, strict=True)
        }

    def counts(self, per_metre: float) -> tuple[np.ndarray, np.ndarray]:
        """Return what encoders of the left and the right side have counted."""
        left, right = (np.floor(per_metre * self.summed(v)) for v in (self.left, self.right))
        return left, right

    def summed(self, values: np.ndarray) -> np.ndarray:
        """Return an integral over the time."""
        steps = 0.5 * np.diff(self.t) * (values[1:] + values[:-1])
        return np.concatenate([[0.0], np.cumsum(steps)])

    def speeds(self) -> dict[str, np.ndarray]:
        """Return the time, both sides' speeds and the yaw rate by names that are understood."""
        return {
            "time": self.t, "left_speed": self.left, "right_speed": self.right,
            "gyro_z": self.yaw_rate,
        }  # fmt: skip


Files = dict[str, bytes]
"""What is written, by how the names of the files end."""


def csv(
    columns: object, suffix: str = ".csv", *, head: str = "", encoding: str = "utf-8",
    **options: Any,
) -> Files:  # fmt: skip
    """Return columns as text, with something before them if need be."""
    data = (head + pd.DataFrame(columns).to_csv(index=False, **options)).encode(encoding)
    return {suffix: gzip.compress(data) if suffix.endswith(".gz") else data}


Writer = Callable[[At], Files]


def write(name: str, at: At, folder: Path) -> Path:
    """Write a log; of several files, the names are joined as a reader is given them."""
    made = REFUSED[name].write(at) if name in REFUSED else READ[name](at)
    for suffix, data in made.items():
        (folder / f"{name}{suffix}").write_bytes(data)
    return Path("+".join(str(folder / f"{name}{suffix}") for suffix in made))


# -- what takes more than a line -------------------------------------------------------------------


def words_for_nothing(at: At) -> Files:
    """As loggers write what is missing, and zeros at the end as after a loss of power."""
    cells = at.house().map("{:.6f}".format)
    words = ("nan", "NULL", "-", "inf", "n/a", "#N/A", "-inf", "None", "NaN", "---", "?", "N/A",
             "missing", "--", "1.#QNAN", "1.#INF")  # fmt: skip
    for k, word in enumerate(words):
        cells.loc[30 + 17 * k, ("power", "v_left", "yaw_rate")[k % 3]] = word
    cells.iloc[0] = "nan"
    return {".csv": csv(cells)[".csv"] + bytes(99)}


def units_in_a_second_row(at: At) -> Files:
    names = ("time", "wheel speed left", "wheel speed right", "bus voltage", "bus current", "yaw")
    head = ",".join(f'"{name}"' for name in names) + '\n"ms","rpm","rpm","V","A","deg"\n'
    wheels = at.joints("{}", RPM, RPM).values()
    cells = (1e3 * at.t, *wheels, at.volts, at.amps, DEG * at.yaw)
    return csv(np.stack(cells, axis=1), head=head, header=False)


def json_lines(at: At) -> Files:
    """An object a row, with objects in it; one row is empty."""
    rows = (
        {"stamp": EPOCH + t, "wheels": {"left": left, "right": right},
         "battery": {"voltage": volts, "current": amps}, "imu": {"gyro": [0.0, 0.0, rate]}}
        for t, left, right, volts, amps, rate in zip(
            at.t, at.left, at.right, at.volts, at.amps, at.yaw_rate, strict=True)
    )  # fmt: skip
    return {".jsonl": "\n".join(["", *map(json.dumps, rows)]).encode()}


def sides_in_turn(at: At) -> Files:
    """Each row holds the power of one side; at rest, of both."""
    even = np.arange(len(at.t)) % 2 == 0
    rest = (np.abs(at.left) < 0.01) & (np.abs(at.right) < 0.01)
    powers = {"p_left": np.where(even | rest, at.p_left, np.nan),
              "p_right": np.where(~even | rest, at.p_right, np.nan)}  # fmt: skip
    return csv({**at.house().drop(columns="power"), **powers})


def what_changed_alone(at: At) -> Files:
    """A reading is written where it differs from the one before, to a thousandth of its range."""
    columns = {"v_left": at.left, "v_right": at.right, "p_left": at.p_left, "p_right": at.p_right,
               "yaw_rate": at.yaw_rate}  # fmt: skip
    sizes = {name: 1e-3 * np.ptp(values) for name, values in columns.items()}
    rows = pd.DataFrame({n: np.round(v / sizes[n]) * sizes[n] for n, v in columns.items()})
    written = rows.where(rows.ne(rows.shift()))
    return csv(written.assign(t=at.t)[written.notna().any(axis=1)])


def readings_in_rows(at: At) -> Files:
    """A reading a row, as a broker of messages stores them."""
    readings = {**at.joints("wheel/{}/velocity"), "battery/voltage": at.volts, "battery/current":
                at.amps, "imu/angular_velocity/z": at.yaw_rate,
                "mode": ["auto"] * len(at.t)}  # fmt: skip
    rows = pd.concat([pd.DataFrame({"timestamp": at.stamps, "topic": name, "value": values})
                      for name, values in readings.items()])  # fmt: skip
    return csv(rows.sort_values("timestamp", kind="stable"))


def signals_with_units(at: At) -> Files:
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
    return csv(rows.sort_values("Timestamp"))


def in_rows(time: str, *parts: tuple[np.ndarray, dict[str, np.ndarray]]) -> Files:
    """Return a row for each message, of topics that each have a clock and columns of their own."""
    rows = pd.concat([pd.DataFrame({time: t, **columns}) for t, columns in parts])
    return csv(rows.sort_values(time))


def stamps_in_two_columns(at: At) -> Files:
    """As stamps of ROS messages are flattened."""
    seconds = np.floor(EPOCH + at.t)
    return csv({
        "header.stamp.sec": seconds.astype(int),
        "header.stamp.nanosec": np.round((EPOCH + at.t - seconds) * 1e9).astype(int),
        **at.joints("wheel_{}.velocity"), "battery.voltage": at.volts, "battery.current": -at.amps,
        "imu.angular_velocity.z": at.yaw_rate,
    })  # fmt: skip


def flight_controller(at: At) -> Files:
    """A row for each message: encoders, battery, gyroscope and position of an autopilot."""
    degree = 111_195.08
    position = {
        "gps.latitude": 48.0 + at.log.channel("y") / degree,
        "gps.longitude": 11.0 + at.log.channel("x") / degree / np.cos(np.radians(48.0)),
    }
    left, right = at.counts(1e4)
    us = np.round(1e6 * at.t)
    return in_rows(
        "TimeUS", (us, {"WENC.LeftTicks": left, "WENC.RightTicks": right}),
        (us + 3e3, {"BAT.Volt": at.volts, "BAT.Curr": at.amps}),
        (us + 5e3, {"IMU.GyrZ": at.yaw_rate}),
        (us[::2] + 6e3, {name: values[::2] for name, values in position.items()}),
    )  # fmt: skip


def flattened_messages(at: At) -> Files:
    """As messages are flattened: w is a part of a quaternion, x and y are of a magnetometer too."""
    turn = {"x": 0.0 * at.yaw, "y": 0.0 * at.yaw, "z": np.sin(0.5 * at.yaw),
            "w": np.cos(0.5 * at.yaw)}  # fmt: skip
    return csv({
        "__time": EPOCH + at.t, **at.joints("/joint_states/{}_wheel_joint/velocity"),
        **{f"/imu/orientation/{axis}": cells for axis, cells in turn.items()},
        "/tf/base_link/rotation/w": turn["w"], "/imu/angular_velocity/z": at.yaw_rate,
        "/imu/mag/x": np.cos(at.yaw), "/imu/mag/y": -np.sin(at.yaw),
        "/battery_state/voltage": at.volts, "/battery_state/current": -at.amps,
        "/battery_state/percentage": 0.9 - 1e-5 * at.t,
    })  # fmt: skip


def rows_in_bursts(at: At) -> Files:
    """Five rows at once, with the times of their arrival."""
    rows = np.arange(len(at.t))
    last = np.minimum(rows // 5 * 5 + 4, rows[-1])
    arrival = at.t[last] + 1e-4 * (rows - last) + 0.01 * np.sin(last)
    return csv(at.house().assign(t=arrival))


def files_of_controllers(at: At, speed_of: str = "speed_rad_s") -> Files:
    """A file for each side's motor controller, and one for the battery."""
    sides = {"left": (at.t, at.left, at.p_left), "right": (at.t + 0.003, at.right, at.p_right)}
    files: Files = {}
    for name, (t, speed, power) in sides.items():
        amps = np.round(10 * power / at.volts, 3)
        files |= csv(
            {"t": t, speed_of: speed / at.robot.radius, "current_dA": amps}, f"-{name}.csv"
        )
    return files | csv({"t": at.t[::5], "voltage": at.volts[::5]}, "-pack.csv")


def status_topic(at: At) -> Files:
    """As a controller's status messages and odometry come out of a bag."""
    left, right = at.counts(7000.0)
    return csv({
        "Time": EPOCH + at.t, "status.header.seq": np.arange(len(at.t)),
        "status.left_driver_current": at.p_left / at.volts,
        "status.right_driver_current": at.p_right / at.volts,
        "status.left_driver_voltage": at.volts, "status.right_driver_voltage": at.volts,
        "status.left_motor_temp": 31.0, "status.right_motor_temp": 32.0,
        "status.left_ticks": left % 65536, "status.right_ticks": right % 65536,
        "odom.twist.twist.linear.x": 0.5 * (at.left + at.right),
        "odom.twist.twist.angular.z": at.yaw_rate,
    })  # fmt: skip


def torques(at: At) -> Files:
    """As a simulator writes what its joints do."""
    columns = {"sim_time": at.t, **at.joints("{}_wheel_joint_velocity"), "world_yaw": at.yaw}
    for side, power in (("left", at.p_left), ("right", at.p_right)):
        rate = columns[f"{side}_wheel_joint_velocity"]
        columns[f"{side}_wheel_joint_effort"] = np.divide(
            power, rate, out=np.zeros_like(rate), where=rate != 0
        )
    return csv(columns)


def two_robots(at: At) -> Files:
    other, shift = At(drive(at.robot, seed=4), at.robot), len(at.t) // 3
    return csv({
        "time": at.t, "robot1/left_speed": at.left, "robot1/right_speed": at.right,
        "robot1/power": at.power, "robot2/left_speed": np.roll(other.left, shift),
        "robot2/right_speed": np.roll(other.right, shift),
        "robot2/power": np.roll(other.power, shift),
    })  # fmt: skip


def one_wheel(at: At, name: str, factor: float) -> Files:
    """Return four wheels' rates of which that of one is another."""
    wheels = at.wheels(RPM, ("fl_rpm", "fr_rpm", "rl_rpm", "rr_rpm"))
    return csv({"time": at.t, **wheels, name: factor * wheels[name], "power": at.power})


def no_names(at: At) -> Files:
    """As of ``ros2 topic echo --csv``, which repeats values and writes words and nan."""
    frame = pd.DataFrame({"sec": 1731300000, "nsec": np.round(1e9 * (at.t % 1)).astype(int),
                          "frame": "base_link", "v": at.volts, "t": "nan", "i": at.amps,
                          "c": "nan"})  # fmt: skip
    return csv(frame, header=False)


def cells_missing_in_some_rows(at: At) -> Files:
    lines = at.house().to_csv(index=False).splitlines()
    lines[200::20] = [line.partition(",")[2] for line in lines[200::20]]
    return {".csv": "\n".join(lines).encode()}


def no_reading_by_a_number(at: At) -> Files:
    house = at.house()
    house.loc[100:140, "v_left"] = -9999.0
    return csv(house)


# -- the tables ------------------------------------------------------------------------------------

READ: dict[str, Writer] = {
    "Fahrt 1": lambda at: csv({
        "Uhrzeit": [stamp.isoformat() for stamp in at.stamps.tz_localize("Europe/Berlin")],
        "v links [km/h]": 3.6 * at.left, "v rechts [km/h]": 3.6 * at.right,
        "Leistung [kW]": 1e-3 * at.power, "Gierrate [°/s]": DEG * at.yaw_rate,
    }, sep=";", decimal=",", encoding="cp1252"),
    # milliseconds in sixteen bits
    "a_counter_that_overflows": lambda at: csv(
        {"t_ms": (np.round(1e3 * at.t) + 30_000) % 65_536, **at.house().drop(columns="t")}),
    "minutes_and_seconds": lambda at: csv(
        at.house().assign(t=[f"{t // 60:02.0f}:{t % 60:06.3f}" for t in at.t])),
    "four_wheels_in_rpm": lambda at: csv({
        "timestamp_ms": np.round(1e3 * (EPOCH + at.t)).astype(np.int64),
        **at.wheels(RPM, ("FL (rpm)", "FR (rpm)", "RL (rpm)", "RR (rpm)")), "batt_V": at.volts,
        "batt_I [mA]": 1e3 * at.amps, "gyro_z_dps": DEG * at.yaw_rate,
    }),
    "four_motors": lambda at: csv({
        "Time": at.t, **at.wheels(1.0, tuple(f"wheel_{w}_speed_radps" for w in WHEELS)),
        "current_fl_wheel_mA": 600.0 * at.p_left / at.volts,
        "current_fr_wheel_mA": 450.0 * at.p_right / at.volts,
        "current_rl_wheel_mA": 400.0 * at.p_left / at.volts,
        "current_rr_wheel_mA": 550.0 * at.p_right / at.volts,
        "vbat_mV": 1e3 * at.volts, "imu_wz": at.yaw_rate,
    }),
    "byte_order_mark": lambda at: csv(at.house().rename(columns=" {} ".format),
                                      encoding="utf-8-sig"),
    "units_in_a_second_row": units_in_a_second_row,
    "remarks_before_the_names": lambda at: csv({
        "Time_s": at.t, "velL_cm_s": 100 * at.left, "velR_cm_s": 100 * at.right,
        "power_kW": 1e-3 * at.power, "yaw_rate_rad_s": at.yaw_rate,
    }, head="# robot: rover 7\n# firmware 2.1, started 2026-05-04\n\n"),
    "words_for_nothing": words_for_nothing,
    "coarse_stamps": lambda at: csv(at.house().assign(t=np.round(at.t * 4) / 4)),
    "topics_named_for_power": lambda at: csv({
        "Time": EPOCH + at.t, **at.joints("/joint_states/{}_wheel/velocity"),
        "/power/battery/voltage": at.volts, "/power/battery/current": -at.amps,
        "/odom/pose/pose/position.x": at.log.channel("x"),
        "/odom/pose/pose/position.y": at.log.channel("y"), "/imu/angular_velocity.z": at.yaw_rate,
    }),
    # sides with no more than their name, and units that the weight alone tells
    "bare_names_in_thousandths": lambda at: csv({
        "ts": at.nanoseconds // 1000, "left_cmd": 1.1 * at.left, "left_meas": at.left,
        "right_cmd": 1.1 * at.right, "right_meas": at.right, "v_batt": np.round(1e3 * at.volts),
        "i_batt": np.round(1e3 * at.amps), "Drehrate [Grad/s]": DEG * at.yaw_rate,
    }),
    # as of a logger that loses its connection and sends its buffer again
    "a_part_twice": lambda at: csv(pd.concat([at.house()[:600], at.house()[500:]])),
    "stamps_in_whole_seconds": lambda at: csv(
        at.house().assign(t=at.stamps.strftime("%I:%M:%S %p")).rename(columns={"t": "Time"})),
    "sides_in_turn": sides_in_turn,
    "what_changed_alone": what_changed_alone,
    "readings_in_rows": readings_in_rows,
    # as PlotJuggler writes what several topics hold
    "a_row_for_each_message": lambda at: in_rows(
        "__time", (EPOCH + at.t, at.joints("/joints/{}_wheel/velocity")),
        (EPOCH + at.t + 0.006,
         {"/battery_state/voltage": at.volts, "/battery_state/current": -at.amps}),
        (EPOCH + at.t + 0.004, {"/imu/data/angular_velocity/z": at.yaw_rate})),
    "stamps_in_two_columns": stamps_in_two_columns,
    "date_and_time_of_day": lambda at: csv({
        "date": at.stamps.strftime("%d.%m.%Y"), "time": at.stamps.strftime("%H:%M:%S.%f"),
        **at.house().drop(columns="t"),
    }),
    "aligned_by_spaces": lambda at: {
        ".txt": f"# {at.house().to_string(index=False, float_format='%.6f')}\n".encode()},
    "newest_first": lambda at: csv(at.house()[::-1]),
    "units_in_names": lambda at: csv({
        "t_ms": 1e3 * at.t, "v_left_kmh": 3.6 * at.left, "v_right_kmh": 3.6 * at.right,
        "current_mA": 1e3 * at.amps, "voltage_mV": 1e3 * at.volts, "yaw_deg": DEG * at.yaw,
        "yaw_rate_deg_s": DEG * at.yaw_rate,
    }, ".csv.gz"),
    "rostopic_echo": lambda at: csv({
        "%time": at.nanoseconds, "field.header.seq": np.arange(len(at.t)),
        "field.header.stamp": at.nanoseconds, "field.left_vel": at.left,
        "field.right_vel": at.right, "field.voltage": at.volts, "field.current": -at.amps,
    }),
    "flattened_messages": flattened_messages,
    # as spreadsheets count time
    "days": lambda at: csv({
        "Date Time": 46_000.0 + at.t / 86400.0, **at.house().drop(columns="t")}),
    # rates of motors before a gear; those of the left turn backwards on the way ahead
    "motors_in_the_mirror": lambda at: csv({
        "time": at.t, **at.joints("motor_{}_rpm", -30 * RPM, 30 * RPM), "gyro_z": at.yaw_rate,
        "x": 5e5 + at.log.channel("x"), "y": 5e6 + at.log.channel("y"), "power": at.power,
    }),
    "rates_beside_a_blank_gyroscope": lambda at: csv({
        "t": at.t, "power": at.power, "yaw_rate": np.full(len(at.t), np.nan),
        **at.joints("wheel_{} [rad/s]"),
    }),
    "energy_counter": lambda at: csv({
        **at.speeds(), "watt_hours": 17.0 + at.summed(at.power) / 3600.0}),
    "energy_counter_beside_the_current": lambda at: csv({
        **at.speeds(), "watt_hours": 17.0 + at.summed(at.power) / 3600.0,
        "input_voltage": at.volts, "current_in": at.amps,
    }),
    "speed_and_yaw_rate": lambda at: csv({
        "time": at.t, "linear_velocity_x": 0.5 * (at.left + at.right), "angular_velocity_z":
        (at.right - at.left) / at.robot.track, "battery_voltage": at.volts,
        "battery_current": at.amps,
    }),
    "signals_with_units": signals_with_units,
    "knots": lambda at: csv({
        "utc": at.stamps, "left_speed_kn": at.left / 0.514444,
        "right_speed_kn": at.right / 0.514444, "watts": at.power, "gyro_z": at.yaw_rate,
    }),
    "files_of_controllers": files_of_controllers,
}  # fmt: skip
"""Logs from which the right coefficients must come."""


class Refused(NamedTuple):
    """A log that must be refused, with the words of the remedy, and what is given to read it."""

    write: Writer
    said: str
    given: Mapping[str, Any] = MappingProxyType({})


def of_encoders(left: str, right: str, metres: float, unit: str = "ticks") -> dict[str, Any]:
    return {"columns": f"v_left={left}[{unit}*{metres}],v_right={right}[{unit}*{metres}]"}


REFUSED: dict[str, Refused] = {
    # either power fits a whole robot's as well as the other: one alone is half of it
    "sides_in_letters": Refused(
        lambda at: csv({**at.speeds(), "power_a": at.p_left, "power_b": at.p_right}),
        r"power_a and power_b could each .* 'p_left=power_a,p_right=power_b'"),
    "charge_counter": Refused(
        lambda at: csv({
            **at.speeds(), "BAT.Volt": at.volts, "BAT.CurrTot": 17.0 + at.summed(at.amps) / 3.6}),
        r"only ever grows .* 'current=BAT.CurrTot\[mAh\]'",
        {"columns": "current=BAT.CurrTot[mAh]"}),
    "names_one_too_many": Refused(
        lambda at: csv(
            at.house()[["t", "v_left", "v_right", "yaw_rate", "power"]].assign(voltage=at.volts),
            head="t,v_left,v_right,yaw_rate,imu_ok,power,voltage\n", header=False),
        "line 1 names 7 columns, but the rows have 6 cells"),
    "cells_missing_in_some_rows": Refused(
        cells_missing_in_some_rows,
        "line 201: the row has fewer cells than the 5 names, and so have"),
    "no_names": Refused(no_names, "line 1 holds numbers, and no line names the columns"),
    "hundredths": Refused(
        lambda at: csv({
            **at.speeds(), "batVoltage": np.round(100 * at.volts),
            "dcCurr": np.round(100 * at.amps)}),
        r"2\d\.\d V in .*voltage=batVoltage\[\*0.01\]",
        {"columns": "voltage=batVoltage[*0.01],current=dcCurr[*0.01]"}),
    "utf16": Refused(
        lambda at: csv({
            " time [ns] ": at.nanoseconds, " left speed [mm/s] ": 1e3 * at.left,
            " right speed [mm/s] ": 1e3 * at.right, " power [W] ": at.power,
            " heading [deg] ": DEG * at.yaw % 360,
        }, sep="\t", encoding="utf-16"),
        "UTF-16 text; save it as UTF-8"),
    # the second with its own line of names, and its own clock
    "two_recordings": Refused(
        lambda at: csv(At(drive(at.robot, seed=9), at.robot).house(),
                       head=at.house().to_csv(index=False)),
        "line 1503: 't' is 't', .* give each recording a file of its own"),
    "json_lines": Refused(json_lines, r"pandas.json_normalize\(ROWS\)"),
    "american_dates": Refused(
        lambda at: csv(at.house().assign(t=at.stamps.strftime("%m/%d/%Y %I:%M:%S.%f %p"))),
        "ISO 8601, as in 2026-05-04T23:58:30.125"),
    # counters of 16 bits; those of the left count down on the way ahead
    "encoders_of_four_wheels": Refused(
        lambda at: csv({
            "time": at.t, "enc_fl": -at.counts(8000.0)[0] % 65536,
            "enc_fr": at.counts(8000.0)[1] % 65536, "enc_rl": -at.counts(8000.0)[0] % 65536,
            "enc_rr": (at.counts(8000.0)[1] + 40000) % 65536, "x": at.log.channel("x"),
            "y": at.log.channel("y"), "yaw": at.yaw, "power_w": at.power}),
        r'"v_left=enc_fl \+ enc_rl\[ticks\*0.0001\].* ticks/s where',
        of_encoders("enc_fl + enc_rl", "enc_fr + enc_rr", 0.5 / 8000)),
    "encoders_from_row_to_row": Refused(
        lambda at: csv({
            "time": at.t, "encoder_count_l": np.diff(at.counts(5e4)[0], prepend=0.0),
            "encoder_count_r": np.diff(at.counts(5e4)[1], prepend=0.0),
            "ground speed [km/h]": 1.8 * (at.left + at.right), "gyro_z": at.yaw_rate,
            "power": at.power}),
        r"ticks/sample where they count from row to row",
        of_encoders("encoder_count_l", "encoder_count_r", 2e-5, "ticks/sample")),
    "encoders_that_went_far": Refused(  # 200 m before, which is no speed
        lambda at: csv({
            "time": at.t, "enc_left": 1e7 + at.counts(5e4)[0], "enc_right": 1e7 + at.counts(5e4)[1],
            "gyro_z": at.yaw_rate, "power": at.power}),
        r"how far a count goes is not known: give --counts-per-revolution",
        {"counts_per_revolution": 0.22 * np.pi * 5e4}),
    "encoders_that_tell_a_rate": Refused(
        lambda at: csv({
            "time": at.t, "enc_left_tps": np.round(4e4 * at.left),
            "enc_right_tps": np.round(4e4 * at.right), "pose_x": at.log.channel("x"),
            "pose_y": at.log.channel("y"), "heading": at.yaw, "power_w": at.power}),
        r'"v_left=enc_left_tps\[ticks/s\*0.0001\]',
        of_encoders("enc_left_tps", "enc_right_tps", 2.5e-5, "ticks/s")),
    "status_topic": Refused(
        status_topic, r'--counts-per-revolution .* "v_left=status.left_ticks\[ticks\*0.0001\]',
        of_encoders("status.left_ticks", "status.right_ticks", 1 / 7000)),
    "flight_controller": Refused(
        flight_controller, r'"v_left=WENC.LeftTicks\[ticks\*0.0001\]',
        {"counts_per_revolution": 0.22 * np.pi * 1e4}),
    "numbered_axes": Refused(
        lambda at: csv({
            "time": at.t, "axis0.encoder.vel_estimate": at.left / (2 * np.pi * at.robot.radius),
            "axis1.encoder.vel_estimate": at.right / (2 * np.pi * at.robot.radius),
            "vbus_voltage": at.volts, "ibus": at.amps}, sep=";"),
        r'which side .* "v_left=axis0.encoder.vel_estimate\[UNIT\]',
        {"columns": "v_left=axis0.encoder.vel_estimate[rev/s*0.11],"
                    "v_right=axis1.encoder.vel_estimate[rev/s*0.11]"}),
    "electrical_rates": Refused(
        lambda at: csv({
            "ms_today": np.round(1e3 * at.t) + 4321, "input_voltage": at.volts,
            "left_erpm": np.round(140 * RPM / at.robot.radius * at.left),
            "right_erpm": np.round(140 * RPM / at.robot.radius * at.right),
            "left_current_motor": 2 * at.p_left / at.volts,
            "right_current_motor": 2 * at.p_right / at.volts,
            "left_current_in": at.p_left / at.volts, "right_current_in": at.p_right / at.volts,
        }, sep=";"),
        r"v_left=left_erpm\[rpm\*F\]",
        {"columns": f"v_left=left_erpm[rpm*{0.11 / 140}],v_right=right_erpm[rpm*{0.11 / 140}]"}),
    "torques": Refused(
        torques, r"p_left=left_wheel_joint_effort\*left_wheel_joint_velocity,p_right=right_wheel_j",
        {"columns": "p_left=left_wheel_joint_effort*left_wheel_joint_velocity,"
                    "p_right=right_wheel_joint_effort*right_wheel_joint_velocity"}),
    "units_in_cells": Refused(
        lambda at: csv(at.house().assign(v_left=[f"{v:.4f} m/s" for v in at.left])),
        "line 2: 'v_left' is '.* m/s', which is no number"),
    "two_robots": Refused(
        two_robots,
        "robot1/left_speed and robot2/left_speed .* do not go alike .* of two robots"),
    "packs_in_series": Refused(
        lambda at: csv({
            **at.speeds(), "battery1_voltage": 0.5 * at.volts, "battery2_voltage": 0.5 * at.volts,
            "battery_current": at.amps}),
        r"series .* 'voltage=battery1_voltage\+battery2_voltage'",
        {"columns": "voltage=battery1_voltage+battery2_voltage"}),
    "row_numbers": Refused(
        lambda at: csv({"n": np.arange(len(at.t)), **at.house().drop(columns="t")}),
        r"'n' counts rows: .* t=n\[\*0.05\]", {"columns": "t=n[*0.1]"}),
    "a_dead_wheel": Refused(
        lambda at: one_wheel(at, "rl_rpm", 0.0),
        "fl_rpm and rl_rpm .* do not go alike .* one is dead"),
    "a_wheel_in_the_mirror": Refused(
        lambda at: one_wheel(at, "rr_rpm", -1.0), "fr_rpm and rr_rpm .* go opposite ways"),
    "no_time": Refused(
        lambda at: csv(at.house().drop(columns="t"), sep=";",
                       head="started;2026-05-04 10:00:00\nsample rate;10 Hz\n"),
        r"rows come at a steady rate, .* t=row\[\*0.05\]"),
    "no_reading_by_a_number": Refused(
        no_reading_by_a_number, "where -9999 stands for no reading, leave the cell empty"),
    "commas_in_decimals": Refused(
        lambda at: csv(at.house().map("{:.3f}".format).replace(r"\.", ",", regex=True),
                       quoting=3, escapechar=" "),
        "more cells than the 5 names .* write decimals with a point"),
    "unknown_units": Refused(
        lambda at: csv(at.house().rename(columns={
            "v_left": "left speed [furlong/h]", "v_right": "right speed [furlong/h]"})),
        r"unit of 'left speed \[furlong/h\]' is not known: .* NAME\[\*0.01\]"),
    "dates_of_a_spreadsheet": Refused(
        lambda at: csv({"Date": at.stamps.strftime("%d/%m/%Y %H:%M:%S.%f"),
                        **at.house().drop(columns="t")}),
        "line 2: 'Date' is '04/05/2026 .* write instants by ISO 8601"),
    "current_alone": Refused(
        lambda at: csv({**at.house().drop(columns="power"), "bus_current": at.amps}),
        r"the battery's usual one, as in power=bus_current\[\*25.6\]"),
    # nothing else shows how far the wheels roll: these may be kilometres an hour
    "speeds_of_controllers": Refused(
        lambda at: files_of_controllers(at, "speed"),
        r"left.speed could be in rad/s\*0.11 or km/h",
        {"columns": "v_left=speeds_of_controllers-left.speed[rad/s*0.11],"
                    "v_right=speeds_of_controllers-right.speed[rad/s*0.11]"}),
    "power_in_percent": Refused(
        lambda at: csv({**at.house().drop(columns="power"),
                        "power_pct": 100.0 * at.power / np.max(at.power)}),
        "'power_pct' is a share, .* which is no power: log the battery's voltage"),
    "powers_of_front_wheels": Refused(
        lambda at: csv({
            "time": at.t, **at.wheels(at.robot.radius, tuple(f"{w}_speed" for w in WHEELS)),
            "fl_power": 0.5 * at.p_left, "fr_power": 0.5 * at.p_right}),
        r"fl_power is of one wheel, and fl_speed \+ rl_speed of several"),
    "matlab": Refused(
        lambda at: {".mat": b"MATLAB 7.3 MAT-file"},
        r"matlab.mat is of MATLAB; writetable\(struct2table\(LOG\)"),
    "workbook": Refused(
        lambda at: {".xlsx": b"PK"}, r"workbook\.xlsx is a workbook; save the sheet .* CSV"),
    "thousands": Refused(
        lambda at: csv({**at.house().drop(columns="power"),
                        "power [mW]": [f"{1e3 * power:,.1f}" for power in at.power]}),
        r"line \d+: 'power \[mW\]' is '-?\d+,\d+.\d', which is no .* without marks"),
    "rows_in_bursts": Refused(
        rows_in_bursts, r"map t=row\[\*PERIOD\]", {"columns": "t=row[*0.1]"}),
    "currents_without_sign": Refused(
        lambda at: csv({
            **at.speeds(), "u": at.volts, "i_left": np.abs(at.p_left / at.volts),
            "i_right": np.abs(at.p_right / at.volts)}),
        "log signed currents"),
}  # fmt: skip
"""Logs that must be refused or doubted, with the words of the remedy."""
