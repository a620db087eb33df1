"""What is known of a robot before its log is read, and the vehicle that is built of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import isfinite, nan
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree

import numpy as np

from energyplan.errors import ConfigError, InvalidInputError
from energyplan.io.bags import (
    topic_map_of,
)
from energyplan.io.config import read_vehicle
from energyplan.io.documents import MAX_BYTES, load, read_bytes, unused, warn_of_unused
from energyplan.logs import DriveLog
from energyplan.logs.consistency import (
    Measures,
    Observed,
)
from energyplan.logs.guess import (
    side_of,
)
from energyplan.logs.mapping import (
    Column,
)
from energyplan.vehicle import MotorLimits, TreadICR, Vehicle

_SLIP = 0.93  # slip track over that of equal point loads, as of Huskies and a Warthog
_DENSITY = 250.0  # mass over wheelbase times track of a robot that nobody weighed [kg/m^2]


@dataclass(frozen=True)
class Given:
    """What is known of the robot before its log is read; NaN where it is not."""

    wheel_radius: float = nan  # radius of the wheels [m]
    track: float = nan  # distance between left and right wheels [m]
    wheelbase: float = nan  # distance between front and rear wheels [m]
    mass: float = nan  # mass as it drives [kg]
    length: float = nan  # length of the footprint [m]
    width: float = nan  # width of the footprint [m]
    name: str = ""  # what to call the robot
    like: Vehicle | None = None  # a vehicle to take the rest from
    columns: str | Mapping[str, Column] | None = None  # those that are known
    counts_per_revolution: float = nan  # what an encoder counts while the wheel turns once
    unsigned: bool = False  # whether the sensors of its powers see no sign

    def __post_init__(self) -> None:
        for key in ("wheel_radius", "track", "wheelbase", "mass", "length", "width",
                    "counts_per_revolution"):  # fmt: skip
            value = getattr(self, key)
            if not (np.isnan(value) or (isfinite(value) and value > 0)):
                raise InvalidInputError(f"{key} is {value}; give a positive number")

    @property
    def topics(self) -> str | None:
        """Name of the preset topic map of the vehicle to take the rest from, if it has one."""
        return None if self.like is None else topic_map_of(self.like.name)


_ROBOTS = {"a200": "husky_a200", "j100": "jackal"}
"""Presets by the beginning of Clearpath's serial numbers."""
_GEOMETRY = {"wheel_separation": "track", "wheel_radius": "wheel_radius"}
"""Parameters of ros2_control's diff_drive_controller."""
_IDLE = frozenset({
    "left_wheel_names", "right_wheel_names", "wheels_per_side",  # a log names its own
    "odom_frame_id", "base_frame_id", "odom_frame", "base_frame", "tf_frame_prefix",
    "tf_frame_prefix_enable", "enable_odom_tf", "publish_rate",  # how odometry is published
    "pose_covariance_diagonal", "twist_covariance_diagonal", "publish_limited_velocity",
    "open_loop", "position_feedback", "velocity_rolling_window_size",  # how it is computed
    "cmd_vel_timeout", "use_stamped_vel", "type", "update_rate", "use_sim_time",  # of commands
})  # fmt: skip
"""Parameters beside these that change no measure of the robot."""


def read_like(source: str) -> dict[str, Any]:
    """Return what a vehicle, or a robot's file of another tool, gives: arguments of `Given`."""
    file = Path(source)
    if file.suffix.lower() in (".urdf", ".xacro", ".xml"):
        return _of_urdf(file)
    if file.suffix.lower() not in (".yaml", ".yml"):
        return {"like": read_vehicle(source)}
    data = load(file, ConfigError).data
    if "serial_number" in data:
        serial = str(data["serial_number"]).partition("-")[0].lower()
        if serial in _ROBOTS:
            return {"like": read_vehicle(_ROBOTS[serial])}
        raise ConfigError(
            f"{file.name} is Clearpath's robot.yaml of a {serial}, whose measures are not known; "
            f"give --track, --wheelbase and --mass, or --like {' or '.join(_ROBOTS.values())}"
        )
    found: dict[str, float] = {}
    parts = [data]
    while parts:
        part = parts.pop()
        parts += [one for one in part.values() if isinstance(one, dict)]
        if {*part} & {*_GEOMETRY}:
            keys = [key for key in part if not str(key).endswith("_multiplier")]
            warn_of_unused(file.name, unused(keys, _GEOMETRY, _IDLE))
        for key, name in _GEOMETRY.items():
            size = part.get(key)
            if isinstance(size, int | float) and size > 0:
                scale = part.get(f"{key}_multiplier", part.get(f"left_{key}_multiplier", 1.0))
                # The multiplier of a skid-steer's separation stands for slip, which is learned.
                found[name] = float(size) * (1.0 if name == "track" else float(scale))
    return found or {"like": read_vehicle(source)}


def _of_urdf(file: Path) -> dict[str, Any]:
    """Return the mass of a URDF's links, and the measures of its wheels."""
    content = read_bytes(file, MAX_BYTES, ConfigError, "give the robot's URDF")
    if b"${" in content or b"xacro:" in content:
        raise ConfigError(
            f"{file.name} holds macros: xacro {file.name} > robot.urdf makes a URDF of it; give "
            "--like robot.urdf"
        )
    try:
        result = _measured(ElementTree.fromstring(content))
    except (ElementTree.ParseError, ValueError) as problem:
        raise ConfigError(f"{file.name} is no sound URDF: {problem}") from None
    if not result:
        raise ConfigError(
            f"{file.name}: no masses of links and no continuous joints of left and right wheels; "
            "give --track, --wheelbase and --mass"
        )
    return result


def _measured(root: ElementTree.Element) -> dict[str, Any]:
    """Return mass, distances and radius of the wheels of a URDF, as far as it holds them."""
    masses = [float(one.get("value", 0.0)) for one in root.iterfind("link/inertial/mass")]
    joints = [one.get("name", "") for one in root.iterfind("joint")]
    wheels = [
        one for one in root.iterfind("joint")
        if one.get("type") == "continuous" and side_of(one.get("name", ""), joints)
    ]  # fmt: skip
    places = [
        [float(part) for part in origin.get("xyz", "0 0 0").split()]
        for one in wheels if (origin := one.find("origin")) is not None
    ]  # fmt: skip
    result: dict[str, Any] = {"mass": sum(masses)} if sum(masses) > 0 else {}
    if places:
        size = np.ptp(np.array(places), axis=0)
        result |= {key: float(d) for key, d in zip(("wheelbase", "track"), size[:2], strict=True)
                 if d > 0}  # fmt: skip
    names = {child.get("link") for one in wheels if (child := one.find("child")) is not None}
    for link in (one for one in root.iterfind("link") if one.get("name") in names):
        for shape in link.iterfind("*/geometry/cylinder"):
            result["wheel_radius"] = float(shape.get("radius", "nan"))
    return result


def known_measures(known: Given) -> Measures:
    """Return the measures that are given, by themselves or by a vehicle alike."""
    like = Measures() if known.like is None else Measures.of(known.like)
    track, wheelbase, mass = (
        getattr(known, key) if isfinite(getattr(known, key)) else getattr(like, key)
        for key in ("track", "wheelbase", "mass")
    )
    return Measures(track, wheelbase, mass, known.wheel_radius)


class _Built(NamedTuple):
    """A vehicle, and what of it nobody gave: what it is by what was taken for it."""

    vehicle: Vehicle
    assumed: dict[str, str]


def build_vehicle(file: Path, log: DriveLog, drive: Observed, known: Given) -> _Built:
    """Build a vehicle from what is given; the rest from the log, or as robots usually are."""
    assumed: dict[str, str] = {}
    measures = known_measures(known)
    track, wheelbase, mass = measures.track, measures.wheelbase, measures.mass
    slip = drive.slip_track
    if not isfinite(track):
        if not isfinite(slip):
            raise InvalidInputError(
                f"{file.name}: the log does not show the track: give the distance between "
                "left and right wheels [m], as in --track 0.555"
            )
        # of a robot a tenth longer than wide, as most are
        ratio = (wheelbase / slip) if isfinite(wheelbase) else nan
        whole = slip / _SLIP
        root = whole**2 / 4 - wheelbase**2 if isfinite(ratio) else nan
        track = whole / 2 + np.sqrt(root) if isfinite(root) and root > 0 else whole / 1.81
        assumed["track"] = f"{track:.3g} m, from the turning"
    if not isfinite(wheelbase):
        wheelbase = 0.9 * track
        square = (slip / _SLIP - track) * track if isfinite(slip) else nan
        if isfinite(square) and 0.25 < square / track**2 < 4:
            wheelbase = float(np.sqrt(square))
        assumed["wheelbase"] = f"{wheelbase:.3g} m, " + (
            "from the turning" if isfinite(square) else "as of most robots"
        )
    if not isfinite(mass):
        mass = _DENSITY * track * wheelbase
        if isfinite(drive.inertia):
            mass = drive.inertia
        assumed["mass"] = (
            f"{mass:.3g} kg, {'from speeding up' if isfinite(drive.inertia) else 'a guess'}; "
            "only its product with the friction coefficient shows in the power"
        )
    like = known.like
    size = None if like is None else np.ptp(like.footprint, axis=0)
    length, width = known.length, known.width
    if not isfinite(length):
        length = float(size[0]) if size is not None else 1.75 * wheelbase
        assumed |= {} if size is not None else {"length": f"{length:.3g} m, 1.75 times wheelbase"}
    if not isfinite(width):
        width = float(size[1]) if size is not None else 1.22 * track
        assumed |= {} if size is not None else {"width": f"{width:.3g} m, 1.22 times track"}
    icr = None
    if isfinite(slip) and 0.6 < slip / (track + wheelbase**2 / track) < 1.45:
        icr = TreadICR.symmetric(float(slip) / 2)
    motor = like.motor if like is not None else _limits(log, assumed)
    vehicle = Vehicle.from_geometry(
        known.name or (like.name if like is not None else file.stem.split(".")[0]),
        mass=mass, wheelbase=wheelbase, track=track, length=length, width=width, icr=icr,
        motor=motor,
        drive_efficiency=1.0 if like is None else like.drive_efficiency,
        regen_efficiency=1.0 if like is None else like.regen_efficiency,
    )  # fmt: skip
    return _Built(vehicle, assumed)


def _limits(log: DriveLog, assumed: dict[str, str]) -> MotorLimits:
    """Limits of a side's motor: what it did in the log, and a typical acceleration."""
    speed = 1.1 * max(
        float(np.quantile(np.abs(log.channel(name)), 0.999)) for name in ("v_left", "v_right")
    )
    sides = log.sides
    drawn = (sides.left, sides.right) if sides is not None else (log.power,)
    peak = 1.5 * max(float(np.quantile(values, 0.999)) for values in drawn)
    found: dict[str, float] = {"acceleration": 1.0}
    assumed["acceleration"] = "1 m/s^2, a usual one"
    if speed > 0:
        found["speed"] = speed
        assumed["speed"] = f"{speed:.3g} m/s, a tenth above what the log reaches"
    if peak > 0:
        found["peak_power"] = peak
        assumed["peak_power"] = f"{peak:.3g} W a side, half above what the log reaches"
    return MotorLimits(**found)
