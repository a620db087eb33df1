"""The first step with a robot's own log: which channel is what, in which unit, and does it fit."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from math import isfinite, nan, pi
from pathlib import Path
from typing import Any, NamedTuple, NoReturn
from xml.etree import ElementTree

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from energyplan.errors import ConfigError, DriveLogError, InvalidInputError
from energyplan.io.bags import (
    TOPIC_MAPS,
    TopicMap,
    Typed,
    held_of,
    of_body,
    of_types,
    serving,
    topic_map_of,
    topics_of,
    untyped,
)
from energyplan.io.config import Project, read_vehicle
from energyplan.io.documents import MAX_BYTES, load, read_bytes
from energyplan.io.husky import known_husky
from energyplan.io.logs import named_columns, read_log, read_recording, tasks_of
from energyplan.logs import DriveLog
from energyplan.logs.align import Series, find_runs, usable
from energyplan.logs.checks import grows, mirrored_side, without_copies
from energyplan.logs.clean import POWER_WAYS, RECORDING, join_rows, possible, total_power
from energyplan.logs.compass import Recorded, counts_from_north
from energyplan.logs.consistency import (
    POWERS,
    Check,
    Measures,
    Observed,
    check_consistency,
    contradictions,
    correlation,
    strain,
)
from energyplan.logs.guess import (
    ENCODER,
    guess,
    guess_ahead,
    guess_encoders,
    guess_turns,
    halves,
    numbered_speeds,
    of_batteries,
    of_one_wheel,
    siblings,
    side_of,
    voltages_of,
    words,
)
from energyplan.logs.mapping import (
    COUNTS,
    RATE,
    RATES,
    ROW,
    SINCE,
    TOTAL,
    Column,
    column_from,
    counting,
    is_unit,
    scale_of,
    split_unit,
    time_units,
    unit_in,
)
from energyplan.logs.tables import Recording, counts_rows, find_clock, quaternions
from energyplan.path import FloatArray
from energyplan.vehicle import GRAVITY, MotorLimits, TreadICR, Vehicle

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


_ALIKE = 0.9  # correlation from which two columns carry the same quantity
_ONE_SIDE = 0.7  # correlation through the origin of the speeds of one side's wheels, at least
_HALF = 0.2  # of the larger, that powers or currents of two sides are at least


_CONSUMED = {
    "current": {"ah", "mah", "charge", "amphours"},
    "power": {"wh", "kwh", "energy", "joule", "joules", "consumed", "used"},
}
"""Words of counters of charge and of energy."""


def refuse(recording: Recording, needed: Sequence[str]) -> NoReturn:
    """Say what is missing, and why what could be it is not."""
    text = guess(recording.text)
    for channel in needed:
        ways = (channel,) if channel != "power" else ("power", "p_left", "current", "voltage")
        for one in (text[way] for way in ways if way in text):
            recording.column(one.field)  # says which cell is no number
    names, columns, hint = [*recording.columns, *recording.text], recording.columns, ""
    if kinds := serving(recording, "current" if "power" in needed else "v_left"):
        # Their messages are known, so that other names are no hint, but for those of motors.
        names = [name for name in names if "rpm" in words(name)]
        columns = {name: columns[name] for name in names}
        hint = f"; {' or '.join(kinds)} holds it: have the flight controller log that"
    for name, cell in recording.text.items():
        if "t" in needed and re.search(r"is '\d{1,4}[-./]\d{1,2}[-./]\d{1,4}", cell):
            recording.column(name)  # says how to write instants
    for name in names:
        bare, unit = split_unit(name)
        if unit and not is_unit(unit) and {*guess([bare])} & {*needed, "p_left", "p_right"}:
            hint += f"; the unit of {name!r} is not known: give its factor, as in NAME[*0.01]"
            break
    if {"v_left", "v_right"} & set(needed):
        hint += "; v_left and v_right are the speeds of the left and right wheels"
        counted = [name for name in names if ENCODER & set(words(name))]
        numbered = numbered_speeds(names)
        electric = [name for name in names if "erpm" in words(name)]
        if numbered:
            first, second = numbered[:2]
            hint += (
                f"; of {', '.join(map(repr, numbered[:4]))} nobody but you knows which side each "
                f'is: give --columns "v_left={first}[UNIT],v_right={second}[UNIT]", with UNIT such '
                "as rpm*RADIUS, rev/s*RADIUS, or ticks*METRES_PER_COUNT (ticks*1 of metres gone)"
            )
        elif electric:
            hint += (
                f"; {electric[0]!r} seems to be a motor's electrical rate: give v_left="
                f"{electric[0]}[rpm*F], with F the wheel radius over gear ratio times pole pairs"
            )
        elif counted:
            hint += (
                f"; {counted[0]!r} seems to be an encoder's: map those of the left and of the "
                f"right wheels with the metres per count, as in v_left={counted[0]}[ticks*0.0001] "
                "where it counts on, [ticks/sample*0.0001] where it counts from row to row, "
                "[ticks/s*0.0001] where it counts in a second"
            )
        else:
            hint += (
                "; of the body's speed V and turn rate W they are made as in v_left=V-0.25*W,"
                "v_right=V+0.25*W with half the track, though slip is then unseen"
            )
    if "t" in needed:
        number = next((n for n, values in columns.items() if counts_rows(values)), "")
        counts = f"{number!r} counts rows: if they" if number else "where rows"
        hint += (
            f"; {counts} come at a steady rate, give the time from row to row, as in "
            f"t={number or ROW}[*0.05] for 50 ms"
        )
    used = [
        (name, channel, unit)
        for name, values in columns.items() if grows(values)
        for channel, unit in (("current", "mAh"), ("power", "Wh"))
        if _CONSUMED[channel] & set(words(name))
    ]  # fmt: skip
    if "power" in needed and used:
        name, channel, unit = used[0]
        unit = unit_in(channel, name).unit or unit
        hint += (
            f"; {name!r} seems to count what was used: map its rate of change by its unit, as in "
            f"{channel}={name}[{unit}]"
        )
    amps = guess(columns).get("current")
    if "power" in needed and amps is not None:
        hint += (
            f"; {amps.field!r} makes a power with a voltage beside it, or the battery's usual one, "
            f"as in power={amps.field}[*25.6]"
        )
    if "power" in needed:
        hint += _of_torques(names)
    raise DriveLogError(
        f"{recording.source}: nothing seems to be {' or '.join(needed)}{hint}; the columns are "
        f"{', '.join([*recording.columns, *recording.text][:30])}; say which it is with --columns "
        f"{needed[0]}=NAME"
    )


_TORQUES = {"effort", "torque"}


def _of_torques(names: Sequence[str]) -> str:
    """Say how the torques of all wheels make the powers of the sides."""
    torques = [name for name in names if _TORQUES & set(words(name))]
    result = []
    for side in ("left", "right"):
        own = [name for name in torques if side_of(name, names) == side]
        others = [
            name for name in names
            if own and name not in torques and side_of(name, names) == side
            and set(words(name)) >= set(words(own[0])) - _TORQUES
            and {"velocity", "vel", "speed", "rate", "omega", "rpm"} & set(words(name))
        ]  # fmt: skip
        if own:
            summed = own[0] if len(own) == 1 else f"({'+'.join(own)})"
            result.append(f"p_{side}={summed}*{others[0] if others else 'RATE'}")
    if not torques:
        return ""
    stated = ",".join(result) if len(result) == 2 else f"p_left={torques[0]}*RATE"
    return (
        f"; {torques[0]!r} seems to be a torque: those of all wheels of a side times the wheels' "
        f'rate in rad/s make its power, as in --columns "{stated}"'
    )


def _left_out(recording: Recording, columns: Mapping[str, Column]) -> list[Check]:
    """Find powers that count some of the wheels, motors or batteries alone."""
    used = {name for one in columns.values() for name in one.names}
    found = []
    for channel, one in columns.items():
        if channel not in POWERS:
            continue
        own = np.nanmean(np.abs(recording.column(one.field)))
        rest = [
            name for name in siblings(one, recording.columns)
            if name not in used and np.nanmean(np.abs(recording.columns[name])) > _PART * own
        ]  # fmt: skip
        if rest:
            summed = "+".join((one.field, *one.plus, *rest))
            whole = summed if one.times is None else f"({summed})*{one.times}"
            if one.each:
                whole = " + ".join((one.written, *(f"{name}*VOLTAGE" for name in rest)))
            found.append(Check(
                f"{channel} counts {' and '.join((one.field, *one.plus))}, and not "
                f"{' and '.join(rest)}, which is of another wheel, motor or battery",
                f"count all of them, as in --columns '{channel}={whole}'",
            ))  # fmt: skip
    return found


_PART = 0.05  # of a power, that another one of its kind is at least


def refuse_halves(recording: Recording, found: Mapping[str, Column], channels: set[str]) -> None:
    """Refuse to take one of two columns that are named alike, and differ, for the whole power."""
    one = found.get("power" if "power" in channels else "current")
    if one is None or {"p_left", "p_right"} <= channels:
        return
    volts = found.get("voltage")
    if "power" not in channels and volts is not None and not one.plus:
        _refuse_packs(recording, volts.field)
    used = {name for other in found.values() for name in other.names}
    for name in halves(one.field, [other for other in recording.columns if other not in used]):
        pair = recording.together(one.field, name)
        if not len(pair[0]) or min(map(np.ptp, pair)) == 0.0:
            continue
        alike = np.corrcoef(*pair)[0, 1]
        sizes = np.abs(pair).mean(axis=1)
        twins = of_batteries(one.field)  # which share what is drawn
        if (alike < _ALIKE or twins) and sizes.min() > _HALF * sizes.max():
            raise DriveLogError(
                f"{recording.source}: {one.field} and {name} could each be the power or current of "
                "the whole robot, and differ; where they are those of two sides say so, as in "
                f"--columns 'p_left={one.field},p_right={name}' for powers, where they add up, as "
                f"those of two batteries do, as in --columns '{one.channel}={one.field}+{name}', "
                f"else name the whole, as in --columns '{one.channel}={one.field}'"
            )


def _refuse_packs(recording: Recording, name: str) -> None:
    """Refuse several numbered battery voltages where one current is that of the whole."""
    alike = re.sub(r"\d+", "0", name)
    packs = [other for other in recording.columns if re.sub(r"\d+", "0", other) == alike]
    usual = [float(np.nanmedian(recording.columns[pack])) for pack in packs]
    if len(packs) > 1 and min(usual) > _ALIKE * max(usual):
        raise DriveLogError(
            f"{recording.source}: {' and '.join(packs[:3])} are several voltages beside one "
            "current; where they are in series say so, as in --columns "
            f"'voltage={'+'.join(packs)}', else as in --columns 'voltage={name}'"
        )


def refuse_unlike(recording: Recording, found: Mapping[str, Column]) -> None:
    """Refuse to take the mean of one side's wheels where these do not go alike."""
    for channel in ("v_left", "v_right"):
        one = found.get(channel)
        if one is None:
            continue
        power = found.get(f"p_{channel[2:]}", one)
        if one.plus and not power.plus and of_one_wheel(power.field):
            raise DriveLogError(
                f"{recording.source}: {power.field} is of one wheel, and {one.written} of several; "
                "name the powers of all, or of the driven one, as in --columns "
                f"'p_{channel[2:]}={power.field}'"
            )
        for name in one.plus:
            first, second = recording.together(one.field, name)
            if not np.any(first) and not np.any(second):
                continue
            alike = correlation(first, second)
            if alike < _ONE_SIDE:
                way = "go opposite ways" if alike < -_ONE_SIDE else "do not go alike"
                raise DriveLogError(
                    f"{recording.source}: {one.field} and {name} seem to be speeds of the same "
                    f"side, and {way} (correlation {alike:.2f}): one is dead or counts the other "
                    "way, or they are of two robots; name those that are right, the power among "
                    f"them, as in --columns '{channel}={one.field}'"
                )


_SOME = 20_000  # readings that suffice to recognize a unit
_CLOSE = 0.005  # time between them below which they do not [s]
_FASTEST_TURN = 3.0  # yaw rate that hardly a robot reaches that skids [rad/s]
_FULL_TURN = 6.5  # [rad]; headings beyond are unwrapped, or degrees
_TURNS = 3 * _FULL_TURN  # beyond, they are rather degrees
_VOLTS = {"mV": (4.5, 450.0), "*0.01": (4.5, 100.0), "*0.1": (4.5, 100.0)}  # typical ranges [V]
_HIGHEST_VOLTAGE = 1000.0  # of a battery [V]
_USUAL_FORCE = (0.02, 2.0)  # power over weight times speed that does not surprise
_SPEEDS = ("v_left", "v_right")
_NEEDED = {"t", "v_left", "v_right", "p_left", "p_right", "power", "voltage", "current"}
_CHARGE = {"percentage", "percent", "soc", "pct"}  # words of how full a battery is
_ROLLING = {**RATES, **COUNTS}  # units of wheels, that take a radius
_SMALLEST_RADIUS, _LARGEST_RADIUS = 2e-4, 0.8  # of a wheel, or of one over its gear ratio [m]
_RADIUS = 0.15  # radius of wheels of which it is not known yet [m]


@dataclass(frozen=True)
class Start:
    """A robot's project, and how well its log bears it out."""

    project: Project  # vehicle, columns or topics, and what was assumed
    checks: tuple[Check, ...]  # what was held against what
    notes: tuple[str, ...]  # what is uncertain about the log

    @property
    def sound(self) -> bool:
        """Whether nothing contradicts anything."""
        return all(check.ok for check in self.checks)


def start_all(paths: Sequence[Path], given: Given) -> Start:
    """Start from the first of a robot's drives, and hold the others against what comes of it."""
    result, first = _started(paths[0], given)
    if len(paths) == 1:
        return result
    project, checks, notes = result.project, [*result.checks], [*result.notes]
    drives = [first]
    for path in paths[1:]:
        log = read_log(path, dict(project.columns) or None, topics=project.topics)
        wrong = [one for one in log.checks if one.refuses] + contradictions(log, project.vehicle)
        said = {str(one): replace(one, what=f"{log.name}: {one.what}") for one in wrong}
        checks += said.values()
        notes += [f"{log.name}: {one}" for one in (*log.set_aside, *log.warnings)
                  if str(one) not in said]  # fmt: skip
        drives.append(log)
    notes += without_copies(drives, [])[1]
    return replace(result, checks=tuple(checks), notes=tuple(notes))


def start(path: str | Path, given: Given | None = None) -> Start:
    """Guess what a log's columns or topics are, and hold them against the robot."""
    return _started(Path(path), given or Given())[0]


def _started(file: Path, known: Given) -> tuple[Start, DriveLog]:
    """Read a file once, map its series to channels, and build the vehicle."""
    recording = read_recording(file, known.columns)
    husky = known_husky(recording, file, known.topics) if known.columns is None else None
    if husky is not None:
        return _finish(file, husky, known, {}, TOPIC_MAPS["husky"], {}), husky
    draft = _draft(recording, known)
    columns, assumed = _with_units(recording, draft, known)
    log, columns, turned = _signed(recording, columns)
    if known.unsigned:
        columns = {c: one.changed(unsigned=c in POWERS) for c, one in columns.items()}
        log = replace(log, signed=False)
    topics = topics_of(recording, columns, file.stem) if recording.kinds else None

    def holds(units: Mapping[str, str]) -> bool:
        """Return whether a log that is read in other units contradicts nothing."""
        changed = {c: columns[c].changed(unit=unit) for c, unit in units.items() if c in columns}
        try:
            other = DriveLog.of(recording, columns | changed, refuse=False)
        except DriveLogError:  # impossible readings, as others than glitches are
            return False
        compared = check_consistency(other.observed, known_measures(known))
        return not any(one.refuses == "reading" for one in other.checks) and all(
            one.ok or one.value is None for one in compared
        )

    result = _finish(file, log, known, columns, topics, assumed, holds)
    checks = (*result.checks, *_left_out(recording, columns))
    notes = [*draft.notes, *turned, *result.notes]
    used = {name for one in columns.values() for name in one.names}
    idle = [] if recording.kinds else [name for name in recording.columns if name not in used]
    if idle:
        notes.insert(len(draft.notes), f"columns that serve for nothing: {', '.join(idle[:20])}")
    return replace(result, checks=checks, notes=tuple(notes)), log


# -- which series serve as which channels --------------------------------------------------------


class _Draft(NamedTuple):
    """Columns that serve as channels, those whose units are to be found, and what to say."""

    columns: dict[str, Column]
    free: dict[str, Column]  # by channel, as they were guessed
    notes: list[str]


_ELEMENT = re.compile(r"\.\d+$")  # of an array, of which some elements are named by hand


def _draft(recording: Recording, known: Given) -> _Draft:
    """Guess by names, and by types of messages, which series serve as which channels."""
    columns = named_columns(recording, known.columns)
    if not columns and tasks_of(recording, 1.0) is not None:
        raise DriveLogError(
            f"{recording.source}: a row is a task, not an instant of a drive: energyplan identify "
            f"{recording.source} --vehicle VEHICLE learns from their distances, turning and "
            "energies"
        )
    own = known.topics if recording.kinds else None
    stock = {} if own is None else held_of(recording, TOPIC_MAPS[own])
    if {*_SPEEDS} <= {*stock} and any(set(way) <= {*stock} for way in POWER_WAYS):
        electric = {*POWERS, "voltage"}  # one of these that is named by hand replaces all
        stock = {
            c: one for c, one in stock.items() if not electric & {*columns} or c not in electric
        }
        if isfinite(known.wheel_radius):
            rate = f"rad/s*{known.wheel_radius:.6g}"
            stock |= {channel: stock[channel].changed(unit=rate) for channel in _SPEEDS}
        return _Draft(stock | columns, {}, [f"the topics are those of the topic map {own!r}"])
    # A factor of a power, such as a wheel's rate, may serve for itself too.
    taken = {name for one in columns.values() for name in (one.field, *one.plus)}
    arrays = {_ELEMENT.sub("", name) for one in columns.values() for name in one.names
              if _ELEMENT.search(name)}  # fmt: skip
    taken |= {name for name in recording.columns if _ELEMENT.sub("", name) in arrays}
    speeds, there = {*_SPEEDS}, [*recording.columns]
    notes: list[str] = []
    typed = Typed({}, {}, ())
    if recording.kinds:
        notes += [note for topic, note in recording.notes.items() if topic not in recording.kinds]
        there = untyped(recording)
        named = {c: one for c, one in guess(there, taken).items() if c in speeds}
        typed = of_types(recording, columns, named, known_measures(known).track)
        notes += typed.notes
        if typed.sources.get("v_left", Column(field="")).plus:
            notes.append(_of_body(known, f"those of {typed.sources['v_left'].field}"))
        columns = typed.sources | columns
    found = _guesses(recording, there, taken, columns)
    if {"voltage", "current"} <= {*typed.sources}:  # surer than a name
        found.pop("power", None)
    if recording.times:
        found.pop("t", None)
    found |= {channel: one for channel, one in typed.rates.items() if channel not in columns}
    _powers(recording, columns, found)
    found = {channel: one for channel, one in found.items() if channel not in columns}
    if not {"t"} & {*columns, *found} and not recording.times:
        used = taken.union(*(one.names for one in found.values()))
        clock = find_clock({n: v for n, v in recording.columns.items() if n not in used})
        columns |= {} if clock is None else {"t": clock}
    _refuse_percentages(recording.source, recording.columns, {*columns, *found})
    encoders = {
        name: found.pop(name) for name in [*found]
        if found[name].unit in COUNTS and name not in typed.rates
    }  # fmt: skip
    used = {name for one in (*columns.values(), *found.values()) for name in one.names}
    if not speeds & {*columns, *found, *encoders} and not recording.kinds:
        encoders = guess_encoders(name for name in recording.columns if name not in used)
    if encoders:
        columns |= _counted(recording, encoders, known)
    elif not speeds & {*columns, *found} and not recording.kinds:
        notes += _from_twist(recording, columns, found, known)
    channels = {*columns, *found} | ({"t"} if recording.times else set())
    lacks = [name for name in ("t", *_SPEEDS) if name not in channels]
    if not any(set(way) <= channels for way in POWER_WAYS):
        lacks.append("power")
    if lacks:
        refuse(recording, lacks)
    refuse_halves(recording, found, channels)
    refuse_unlike(recording, found)
    for channel, one in found.items():
        unit = one.unit
        if channel in speeds and unit in (*RATES, *COUNTS):  # takes a radius, below
            unit = "" if unit in RATES else f"{unit}*1"
        columns[channel] = one.model_copy(update={"unit": unit}).mean()
    for channel in ("slope", "temperature", "payload"):
        if channel in recording.columns and channel not in columns:
            columns[channel] = Column(field=channel, channel=channel)
    notes += _of_compass(recording, columns, found)
    return _Draft(columns, found, notes)


def _of_compass(
    recording: Recording, columns: dict[str, Column], found: dict[str, Column]
) -> list[str]:
    """Turn a pose of east and north, whose heading is that of a compass, to axes of its own."""
    if not {"x", "y", "yaw"} <= set(found) or "east" not in found["x"].field.lower():
        return []
    rows = None if recording.times else recording.series(columns["t"]).values
    series = {name: recording.series(columns[name], rows) for name in (*_SPEEDS, "x", "y", "yaw")}
    period = 360.0 if _size(recording, columns["yaw"]) > _FULL_TURN else 2 * pi
    t, heading = usable(series["yaw"])
    turned = Series(t, np.unwrap(heading, period=period) * (2 * pi / period))
    compass = counts_from_north(
        Recorded(series["v_left"], series["v_right"], series["x"], series["y"], turned)
    )
    if compass is None:
        return [
            "whether the heading counts from the east, or clockwise from the north as a compass "
            "does, does not show: it is taken as counted from the east; drive in several directions"
        ]
    if not compass:
        return []
    north, east = columns["y"], columns["x"]
    columns["x"] = found["x"] = north.changed(channel="x")
    columns["y"] = east.changed(channel="y").negative()
    found.pop("y")
    found["y"] = columns["y"]
    columns["yaw"] = columns["yaw"].changed(unit=columns["yaw"].unit or (
        "deg" if period == 360.0 else "rad")).negative()  # fmt: skip
    found["yaw"] = columns["yaw"]
    return ["the heading counts clockwise from the north, as a compass: x is north, y is west"]


def _refuse_percentages(source: str, names: Iterable[str], there: Collection[str]) -> None:
    """Refuse a log that has nothing but shares in percent, of which no power comes."""
    if any(set(way) <= {*there} for way in POWER_WAYS):
        return
    for name in names:
        if "%" in name or _CHARGE & set(words(name)):
            raise DriveLogError(
                f"{source}: {name!r} is a share, as of a battery's charge, which is no power: log "
                "the battery's voltage and current, or what it counts in Wh or mAh"
            )


def _counted(
    recording: Recording, encoders: Mapping[str, Column], known: Given
) -> dict[str, Column]:
    """Return the speeds of encoders whose way of counting and metres per count are known."""
    metres = 2 * pi * known.wheel_radius / known.counts_per_revolution
    if isfinite(metres) and all(one.unit for one in encoders.values()):
        return {
            channel: one.changed(unit=f"{one.unit}*{metres:.8g}").mean()
            for channel, one in encoders.items()
        }
    size = f"{metres / (1 + len(encoders['v_left'].plus)):.6g}" if isfinite(metres) else "0.0001"
    stated = ",".join(
        f"{channel}={one.written}[{one.unit or TOTAL}*{size}]" for channel, one in encoders.items()
    )
    ways = "" if encoders["v_left"].unit else (
        f" where they count on, {SINCE} where they count from row to row, {RATE} where they count "
        "in a second"
    )  # fmt: skip
    raise DriveLogError(
        f"{recording.source}: {encoders['v_left'].field!r} is an encoder's, and how far a count "
        f"goes is not known: give --counts-per-revolution with --wheel-radius, or the metres per "
        "count (1 if it counts metres) and, in brackets, how it counts, as in "
        f'--columns "{stated}"{ways}'
    )


_ELECTRIC = ("power", "p_left", "p_right", "current", "current_left", "current_right")


def _guesses(
    recording: Recording, there: Iterable[str], taken: Collection[str],
    columns: Mapping[str, Column],
) -> dict[str, Column]:  # fmt: skip
    """Guess which column is which channel; a counter of energy or charge is no power of its own."""
    names = [name for name in there if name not in taken]
    counters = {name for name in names if grows(recording.columns[name][:_SOME])}
    names += [name for name in quaternions(recording.columns) if np.ptp(
        recording.column(name)) > 0.0]  # fmt: skip
    kept: dict[str, Column] = {}
    grown = ""
    while True:
        found = guess(names)
        other = next(
            (c for c in _ELECTRIC if c in found
             and (found[c].field in counters or counting(c, found[c].unit))), None
        )  # fmt: skip
        if other is None:
            break
        one = found[other]
        if counting(other, one.unit):
            kept.setdefault(other, one)
        else:
            grown = one.field
        names = [name for name in names if name not in one.names]
    ways = (*POWER_WAYS, ("current_left", "current_right"))
    if not any(set(way) <= {*found, *columns} for way in ways):
        found |= {c: one for c, one in kept.items() if c not in columns}
        if grown and not kept:
            raise DriveLogError(
                f"{recording.source}: {grown!r} only ever grows or falls: it counts energy or "
                "charge, and is no power and no current; map its rate of change by its unit, as in "
                f"--columns 'current={grown}[mAh]' or --columns 'power={grown}[Wh]'"
            )
    return found


def _from_twist(
    recording: Recording, columns: dict[str, Column], found: dict[str, Column], known: Given
) -> list[str]:
    """Make tread speeds from the speed and the turn rate of the body, where a log has no others."""
    used = {name for one in columns.values() for name in one.names}
    ahead = next(iter(guess_ahead(name for name in recording.columns if name not in used)), None)
    turns = guess_turns(name for name in recording.columns if name not in used)
    if ahead is None or not turns:
        return []
    turn = max(turns, key=lambda name: len(set(words(name)) & set(words(ahead))))
    note = _of_body(known, f"{ahead} and {turn}")
    columns |= of_body(
        column_from("v_left", ahead, unit_in("v_left", ahead).unit),
        column_from("yaw_rate", turn, unit_in("yaw_rate", turn).unit),
        known_measures(known).track,
    )
    # A heading of the same odometry shows no slip, but would be believed to.
    for channel in ("yaw_rate", "yaw"):
        found.pop(channel, None)
    return [note]


def _of_body(known: Given, what: str) -> str:
    """Say what is unseen where tread speeds are computed from the body's speed and turn rate."""
    track = known_measures(known).track
    if not isfinite(track):
        raise DriveLogError(
            f"the log has speed and turn rate of the body, {what}, and no speeds of the wheels: "
            "give the distance between left and right wheels [m] to make them, as in --track "
            "0.555; or log the wheels' speeds, as of /joint_states"
        )
    return (
        f"tread speeds are made from speed and turn rate of the body, {what}, and the track of "
        f"{track:g} m: how the wheels slip in turns is unseen; log the wheels' speeds, as of "
        "/joint_states, to learn it"
    )


def _powers(recording: Recording, columns: dict[str, Column], guesses: dict[str, Column]) -> None:
    """Take each side's power, or its voltages times its currents, or the battery's."""
    for side in ("left", "right"):
        power = f"p_{side}"
        current = guesses.pop(f"current_{side}", None)
        voltage = guesses.pop(f"voltage_{side}", None)
        if power in columns or power in guesses or current is None:
            continue
        volts = voltage or guesses.get("voltage")
        if volts is None:
            continue
        columns[power] = _product(recording, current, volts)
    sides = {"p_left", "p_right"} <= {*columns, *guesses}
    if not sides:
        for side in ("p_left", "p_right"):
            columns.pop(side, None)
            guesses.pop(side, None)
    current, volts = guesses.get("current"), guesses.get("voltage")
    if current is None or volts is None or not current.plus or sides:
        return
    if {"power", "current", "voltage"} & {*columns, *guesses} == {"current", "voltage"}:
        product = _product(recording, current, volts)
        if product.each:
            guesses["power"] = product
            del guesses["current"], guesses["voltage"]


_ONE_VOLTAGE = 0.01  # by how much voltages may differ to be of one bus: as much as powers do then


def _product(recording: Recording, current: Column, volts: Column) -> Column:
    """Return the power of a current times its voltage, each of several times its own."""
    names = (current.field, *current.plus)
    channel = current.channel.replace("current_", "p_").replace("current", "power")
    factor = scale_of("current", current.unit).factor * scale_of("voltage", volts.unit).factor
    power = current.changed(channel=channel, unit="" if factor == 1.0 else f"*{factor:g}")
    own = voltages_of(names, recording.columns)
    if len(own) == len(names):
        alone = len(set(own)) == 1
        return power.changed(**({"times": own[0]} if alone else {"each": own}))
    there = sorted({volts.field, *own, *siblings(volts, recording.columns)})
    usual = [float(np.nanmedian(recording.column(name))) for name in there]
    if max(usual) - min(usual) <= _ONE_VOLTAGE * max(map(abs, usual)):
        return power.changed(times=volts.field)
    stated = "+".join(f"{name}*{there[0]}" for name in names)
    raise DriveLogError(
        f"{recording.source}: {' and '.join(there[:4])} are voltages that differ, and not each "
        f"current of {' and '.join(names[:4])} has one of its own by name; say which belongs to "
        f"which, as in --columns '{channel}={stated}'"
    )


class _Choice(NamedTuple):
    """Channels that share a unit that is not given, and what it may be, the likeliest first."""

    channels: tuple[str, ...]
    units: tuple[str, ...]  # those that end with a star take the wheel radius


def _choices(
    recording: Recording, columns: Mapping[str, Column], found: Mapping[str, Column], known: Given
) -> list[_Choice]:
    # A speed or a place that bears the channel's own name is in its unit; angles often are not.
    free = {
        channel for channel, one in found.items()
        if not one.unit and not (one.field == channel and channel in (*_SPEEDS, "x", "y"))
    }  # fmt: skip
    size = {c: _size(recording, columns[c]) for c in ("yaw_rate", "yaw", "voltage") if c in free}
    rates = [found[name].unit for name in _SPEEDS if name in found and found[name].unit in _ROLLING]
    wheels = ("rad/s*", "rpm*", "rev/s*") if isfinite(known.wheel_radius) else ()
    result = []
    if rates:
        result.append(_Choice(_SPEEDS, (f"{rates[0]}*",)))
    elif {*_SPEEDS} <= free:
        result.append(_Choice(_SPEEDS, ("m/s", *wheels, "km/h", "mm/s", "cm/s")))
    if size.get("yaw_rate", 0.0) > _FASTEST_TURN:
        result.append(_Choice(("yaw_rate",), ("rad/s", "deg/s")))
    if size.get("yaw", 0.0) > _FULL_TURN:  # else these are no degrees
        result.append(_Choice(("yaw",), ("deg", "rad") if size["yaw"] > _TURNS else ("rad", "deg")))
    if size.get("voltage", 0.0) > _HIGHEST_VOLTAGE:
        result.append(_Choice(("voltage",), (_unit_of_voltage(recording, columns["voltage"]),)))
    # A thousand is more than robots' resistances differ by: their weight shows which it is.
    watts = ("W", "mW", "kW")
    for channels, units in (
        (("current",), ("A", "mA")), (("power",), watts), (("p_left", "p_right"), watts),
        (("x", "y"), ("m", "mm", "cm")),
    ):  # fmt: skip
        if set(channels) <= free:
            result.append(_Choice(channels, units))
    return result


def _readings(head: Recording, columns: Mapping[str, Column]) -> dict[str, FloatArray]:
    """Return rows that hold every channel; a mirrored side changes sign, as in `_signed`."""
    rows = None if head.times else head.series(columns["t"]).values
    series = {c: head.series(one, rows) for c, one in columns.items() if c != "t" or not head.times}
    if rows is not None:
        series["t"] = Series(rows, rows)
    joined = join_rows(series, [name for name in series if name in _NEEDED])
    raw = {"t": series["v_left"].t} | {c: one.values for c, one in series.items()}
    raw = raw if joined is None else joined.channels
    raw = _whole_rows(raw)
    if len(raw["t"]) >= RECORDING:
        mirrored = mirrored_side(Observed(raw, raw["t"], find_runs(raw["t"])).averaged())
        raw |= {mirrored: -raw[mirrored]} if mirrored else {}
    return raw


def _with_units(
    recording: Recording, draft: _Draft, known: Given
) -> tuple[dict[str, Column], dict[str, str]]:
    """Choose the units that are not given so that all that a log holds twice agrees."""
    columns, found = draft.columns, draft.free
    name, whole = columns["v_left"].field, recording
    recording = whole.head(name, _SOME)
    if not recording.times and not columns["t"].unit:  # in which a drive log's step is typical
        unit = _unit_of_time(recording, columns)
        columns = {**columns, "t": columns["t"].changed(unit=unit)}
    t = recording.clock(name) if recording.times else recording.series(columns["t"]).values
    if t is not None and np.median(np.diff(t)) < _CLOSE:
        recording = whole.head(name, 4 * _SOME)
    choices = _choices(recording, columns, found, known)
    raw = _readings(recording, columns)
    measures, radius = known_measures(known), known.wheel_radius
    assumed: dict[str, str] = {}
    chosen = {channel: one.units[0] for one in choices for channel in one.channels}
    rolling = {c for c, unit in chosen.items() if unit.endswith("*") and not isfinite(radius)}
    best, agreed = np.inf, None
    for units in product(*(one.units for one in choices)):
        picked = list(zip(choices, units, strict=True))
        each = {channel: unit for one, unit in picked for channel in one.channels}
        trial = {c: v * _factor(c, each.get(c, ""), known) for c, v in raw.items()}
        sized = {c: v for c, v in trial.items() if c not in rolling}
        if len(trial["t"]) < RECORDING or not possible(sized):
            continue
        drive = Observed(trial, total_power(trial), find_runs(trial["t"])).averaged()
        # The measures may be what is wrong: they only decide where the log alone does not.
        cost = strain(drive, Measures()) + 0.2 * strain(drive, measures)
        cost += 0.01 * sum(one.units.index(unit) for one, unit in picked)
        # A heading in another unit does not turn with the treads, or a gyroscope, at all.
        cost += 0.5 * bool(np.isnan(drive.slip_track))
        cost += 0.5 * ({"yaw", "yaw_rate"} <= set(trial) and bool(np.isnan(drive.rotation)))
        if cost < best - 1e-9:
            best, chosen, agreed = cost, each, drive
    if agreed is not None:
        _sure_of_current(recording, columns, chosen, agreed.force / (measures.mass * GRAVITY))
        units = next((one.units for one in choices if "v_left" in one.channels), ())
        _sure_of_speeds(recording, columns, units, chosen, agreed, known)
    if any(unit.endswith("*") for unit in chosen.values()) and not isfinite(radius):
        radius = nan if agreed is None else _radius_of(agreed.distance / _RADIUS)
        if not isfinite(radius):
            raise InvalidInputError(f"{recording.source}: {_no_radius(raw)}")
        assumed["wheel_radius"] = f"{radius:.4g} m, from the pose"
    result = dict(columns)
    for channel, unit in chosen.items():
        if channel in result:
            written = f"{unit}{radius:.6g}" if unit.endswith("*") else unit
            plain = written in ("m/s", "rad", "rad/s", "m", "A", "W")
            result[channel] = result[channel].changed(unit="" if plain else written).mean()
    return result, assumed


def _unit_of_time(recording: Recording, columns: Mapping[str, Column]) -> str:
    """Return the unit of a clock whose name has none; speeds jump between rows seconds apart."""
    units = time_units(recording.column(columns["t"].field))
    if len(units) < 2:
        return units[0]
    jumps = []
    for one in (recording.column(columns[name].field) for name in _SPEEDS):
        lasting = np.median(sliding_window_view(one[np.isfinite(one)], 5), axis=-1)
        steps, size = (np.quantile(np.abs(part), 0.99) for part in (np.diff(lasting), lasting))
        jumps.append(float(steps / max(size, 1e-300)))
    jump = max(jumps)
    if _JUMP[0] < jump < _JUMP[1]:
        why = "could count seconds or milliseconds: the speeds change too little to tell"
        _ask_unit(recording, columns["t"], why, ("s", "ms"))
    return "s" if jump >= _JUMP[1] else units[-1]


_JUMP = (0.08, 0.25)  # change of speed in a row, as a share of the largest, that shows no unit


def _ask_unit(recording: Recording, column: Column, why: str, units: Iterable[str]) -> NoReturn:
    """Refuse to guess a unit, and say how to give it."""
    ways = " or ".join(f"{column.channel}={column.field}[{unit}]" for unit in units)
    raise DriveLogError(
        f"{recording.source}: {column.field} {why}; give its unit with --columns, and those of "
        f"others that may have the same fault{f', as in {ways}' if ways else ''}"
    )


def _unit_of_voltage(recording: Recording, column: Column) -> str:
    """Return the unit of a voltage that is none in volts, where it can be one alone."""
    size = _size(recording, column)
    volts = {u: size * scale_of("voltage", u).factor for u in _VOLTS}
    could = [u for u, (low, high) in _VOLTS.items() if low <= volts[u] <= high]
    if could != ["mV"]:
        result = (
            f", but {' or '.join(f'{volts[u]:.3g} V in [{u}]' for u in could)}" if could else ""
        )
        why = f"is up to {size:.6g}, which is no voltage of a robot in V{result}"
        _ask_unit(recording, column, why, could)
    return "mV"


_SURE = 0.1  # relative error of a distance up to which its unit is sure
_NEAR = 1.35  # ratio of two units up to which turning does not distinguish them


def _sure_of_speeds(
    recording: Recording, columns: Mapping[str, Column], units: Sequence[str],
    chosen: Mapping[str, str], drive: Observed, known: Given,
) -> None:  # fmt: skip
    """Refuse a unit of speeds where another one is as likely: near it, or, by the pose, too."""
    way = abs(np.log(drive.distance)) if isfinite(drive.distance) else np.log(_NEAR)
    if len(units) < 2 or way < _SURE:
        return
    size = {unit: _factor("v_left", unit, known) / _factor("v_left", chosen["v_left"], known)
            for unit in units}  # fmt: skip
    gone = drive.distance if isfinite(drive.distance) else 1.0
    near = [f"{u}{known.wheel_radius:.4g}" if u.endswith("*") else u
            for u in units if abs(np.log(gone * size[u])) < np.log(_NEAR)]  # fmt: skip
    if len(near) > 1:
        why = f"could be in {' or '.join(near)}, of which nothing tells the one from the other"
        _ask_unit(recording, columns["v_left"], why, near[:1])


def _sure_of_current(
    recording: Recording, columns: Mapping[str, Column], chosen: Mapping[str, str], force: float
) -> None:
    """Refuse a unit of current or power if tenths or hundredths of it are as likely by size."""
    for channel in ("current", "power"):
        unit = chosen.get(channel, "")
        if not unit.startswith("m") or not isfinite(force):
            continue
        readings = recording.series(columns[channel]).values
        sizes = {"*0.1": 100.0 * force, "*0.01": 10.0 * force}
        usual = any(_USUAL_FORCE[0] <= size <= _USUAL_FORCE[1] for size in sizes.values())
        if usual and not np.any(np.mod(readings[np.isfinite(readings)], 1.0)):
            why = "comes in whole numbers, whose unit their size does not tell for sure"
            _ask_unit(recording, columns[channel], why, (*sizes, unit))


def _whole_rows(raw: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
    """Return rows that hold every channel; without those that leave too few rows."""
    clock = np.append(True, np.diff(np.fmax.accumulate(raw["t"])) > 0)
    known = {channel: np.isfinite(values) for channel, values in raw.items()}
    others = sorted((c for c in raw if c not in _NEEDED), key=lambda c: np.count_nonzero(known[c]))
    while True:
        whole = clock & np.all(list(known.values()), axis=0)
        if np.count_nonzero(whole) >= RECORDING or not others:
            return {channel: raw[channel][whole] for channel in known}
        del known[others.pop(0)]


def _size(recording: Recording, column: Column) -> float:
    """Return how large readings get, strays left out."""
    values = np.abs(recording.series(column).values)
    values = values[np.isfinite(values)]
    return float(np.quantile(values, 0.99)) if len(values) else 0.0


def _factor(channel: str, unit: str, known: Given) -> float:
    if not unit:
        return 1.0
    if unit.endswith("*"):
        radius = known.wheel_radius if isfinite(known.wheel_radius) else _RADIUS
        return _ROLLING[unit[:-1]] * radius
    return scale_of(channel, unit).factor


def _radius_of(angle: float) -> float:
    """Return the radius at which wheels, or motors before their gear, roll so far in a metre."""
    return 1.0 / angle if 1.0 / _LARGEST_RADIUS <= angle <= 1.0 / _SMALLEST_RADIUS else nan


def _no_radius(channels: Collection[str]) -> str:
    """Say why no wheel radius is known."""
    why = "there is no pose to find the radius from"
    if {"x", "y"} <= set(channels):
        why = (
            "the pose does not tell the radius: the wheels hardly ever roll straight ahead by it, "
            "as where one side counts the other way"
        )
    return (
        f"the tread speeds are the wheels' rates, and {why}; give the wheel radius [m], as in "
        "--wheel-radius 0.165"
    )


# -- the answer ---------------------------------------------------------------------------------


def _finish(
    file: Path,
    log: DriveLog,
    known: Given,
    columns: Mapping[str, Column],
    topics: TopicMap | None,
    assumed: dict[str, str],
    holds: Callable[[Mapping[str, str]], bool] = lambda units: True,
) -> Start:
    """Build the vehicle, and hold the log against it."""
    drive = log.observed
    robot = build_vehicle(file, log, drive, known)
    compared = check_consistency(drive, known_measures(known), columns, holds)
    rules = {one.rule for one in compared}  # with the measures, which show more
    doubts = [one for one in compared if not one.ok and one.value is None]
    checks = [one for one in compared if one not in doubts]
    checks += [one for one in log.checks if one.refuses and one.rule not in rules]
    project = Project(
        name=robot.vehicle.name, vehicle=robot.vehicle, topics=topics,
        columns={} if topics else columns,
        log=file.name, defaults={**assumed, **robot.assumed},
    )  # fmt: skip
    said = {str(one) for one in log.checks if one.refuses or one.rule in rules}
    warnings = (one for one in log.warnings if one not in said)
    notes = (*map(str, log.set_aside), *map(str, doubts), *warnings)
    return Start(
        project,
        tuple(replace(one, remedy=_named(one.remedy, columns)) for one in checks),
        tuple(_named(note, columns) for note in notes),
    )


def _named(remedy: str, columns: Mapping[str, Column]) -> str:
    """Name the columns that a remedy is about, in the units that they are read in."""

    def named(stated: re.Match[str]) -> str:
        channel, unit = stated.groups()
        one = columns.get(channel)
        if one is None or (one.unit and unit[0] != "-"):
            return stated[0]
        return f"{channel}={one.written}[{one.negative().unit if unit[0] == '-' else unit}]"

    return re.sub(r"(\w+)=NAME\[([^]]+)\]", named, remedy)


class _Signed(NamedTuple):
    """A log, the columns it was read by, and notes on the signs that were changed."""

    log: DriveLog
    columns: dict[str, Column]
    notes: tuple[str, ...]


def _signed(recording: Recording, columns: Mapping[str, Column]) -> _Signed:
    """Build a log, and turn round what counts the other way."""
    notes: list[str] = []
    result, done = dict(columns), set[str]()
    while True:
        log = DriveLog.of(recording, result, refuse=False)
        wrong = next((one for one in log.checks if one.refuses == "reading"), None)
        if wrong is None:
            side = mirrored_side(log.observed)
            turned: tuple[str, ...] = (side,) if side and side not in done else ()
        else:
            turned = tuple(name for name in wrong.turned if name in result)
            if not turned or done & set(turned):
                raise DriveLogError(_named(f"{log.name}: {wrong}", result))
        if not turned:
            return _Signed(log, result, tuple(notes))
        result |= {name: result[name].negative() for name in turned}
        done |= set(turned)
        notes.append(f"{' and '.join(turned)} had the opposite sign, which was corrected")
