"""The first step with a robot's own log: which channel is what, in which unit, and does it fit."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
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
    choose,
    is_bag,
    list_fields,
    opened_bag,
    topic_map_of,
    wanted,
)
from energyplan.io.config import Project, read_vehicle
from energyplan.io.documents import MAX_BYTES, load, read_bytes
from energyplan.io.husky import is_husky
from energyplan.io.logs import read_log, tasks_of
from energyplan.logs import DriveLog, UnfitLogError
from energyplan.logs.align import find_runs
from energyplan.logs.checks import POWERS, find_checks, grows, mirrored_side, without_copies
from energyplan.logs.clean import POWER_WAYS, RECORDING, join_rows, possible, total_power
from energyplan.logs.consistency import (
    Check,
    Drive,
    Measures,
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
    parse_columns,
    scale_of,
    split_unit,
    time_units,
    unit_in,
)
from energyplan.logs.tables import Table, counts_rows, find_clock, quaternions, read_table
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

    def __post_init__(self) -> None:
        for key in ("wheel_radius", "track", "wheelbase", "mass", "length", "width",
                    "counts_per_revolution"):  # fmt: skip
            value = getattr(self, key)
            if not (np.isnan(value) or (isfinite(value) and value > 0)):
                raise InvalidInputError(f"{key} is {value}; give a positive number")


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
        made = _measured(ElementTree.fromstring(content))
    except (ElementTree.ParseError, ValueError) as problem:
        raise ConfigError(f"{file.name} is no sound URDF: {problem}") from None
    if not made:
        raise ConfigError(
            f"{file.name}: no masses of links and no continuous joints of left and right wheels; "
            "give --track, --wheelbase and --mass"
        )
    return made


def _measured(root: ElementTree.Element) -> dict[str, Any]:
    """Return mass, distances and radius of the wheels of a URDF, as far as it holds them."""
    masses = [float(one.get("value", 0.0)) for one in root.iterfind("link/inertial/mass")]
    wheels = [
        one for one in root.iterfind("joint")
        if one.get("type") == "continuous" and side_of(one.get("name", ""))
    ]  # fmt: skip
    places = [
        [float(part) for part in origin.get("xyz", "0 0 0").split()]
        for one in wheels if (origin := one.find("origin")) is not None
    ]  # fmt: skip
    made: dict[str, Any] = {"mass": sum(masses)} if sum(masses) > 0 else {}
    if places:
        size = np.ptp(np.array(places), axis=0)
        made |= {key: float(d) for key, d in zip(("wheelbase", "track"), size[:2], strict=True)
                 if d > 0}  # fmt: skip
    names = {child.get("link") for one in wheels if (child := one.find("child")) is not None}
    for link in (one for one in root.iterfind("link") if one.get("name") in names):
        for shape in link.iterfind("*/geometry/cylinder"):
            made["wheel_radius"] = float(shape.get("radius", "nan"))
    return made


def known_measures(known: Given) -> Measures:
    """Return the measures that are given, by themselves or by a vehicle alike."""
    like = Measures() if known.like is None else Measures.of(known.like)
    track, wheelbase, mass = (
        getattr(known, key) if isfinite(getattr(known, key)) else getattr(like, key)
        for key in ("track", "wheelbase", "mass")
    )
    return Measures(track, wheelbase, mass, known.wheel_radius)


class Robot(NamedTuple):
    """A vehicle, and what of it nobody gave: what it is by what was taken for it."""

    vehicle: Vehicle
    assumed: dict[str, str]


def build_vehicle(file: Path, log: DriveLog, drive: Drive, known: Given) -> Robot:
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
    return Robot(vehicle, assumed)


def _limits(log: DriveLog, assumed: dict[str, str]) -> MotorLimits:
    """Limits of a side's motor: what it did in the log, and a usual acceleration."""
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


_ALIKE = 0.9  # correlation from which two columns tell the same
_ONE_SIDE = 0.7  # correlation through the origin of the speeds of one side's wheels, at least
_HALF = 0.2  # of the larger, that powers or currents of two sides are at least


_CONSUMED = {
    "current": {"ah", "mah", "charge", "amphours"},
    "power": {"wh", "kwh", "energy", "joule", "joules", "consumed", "used"},
}
"""Words of counters of charge and of energy."""


def refuse(table: Table, needed: Sequence[str]) -> NoReturn:
    """Say what is missing, and why what could be it is not."""
    text = guess(table.text)
    for channel in needed:
        ways = (channel,) if channel != "power" else ("power", "p_left", "current", "voltage")
        for one in (text[way] for way in ways if way in text):
            table.column(one.field)  # says which cell is no number
    names = (*table.columns, *table.text)
    hint = ""
    for name, cell in table.text.items():
        if "t" in needed and re.search(r"is '\d{1,4}[-./]\d{1,2}[-./]\d{1,4}", cell):
            table.column(name)  # says how to write instants
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
        number = next((n for n, values in table.columns.items() if counts_rows(values)), "")
        counts = f"{number!r} counts rows: if they" if number else "where rows"
        hint += (
            f"; {counts} come at a steady rate, give the time from row to row, as in "
            f"t={number or ROW}[*0.05] for 50 ms"
        )
    used = [
        (name, channel, unit)
        for name, values in table.columns.items() if grows(values)
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
    amps = guess(table.columns).get("current")
    if "power" in needed and amps is not None:
        hint += (
            f"; {amps.field!r} makes a power with a voltage beside it, or the battery's usual one, "
            f"as in power={amps.field}[*25.6]"
        )
    if "power" in needed:
        hint += _of_torques(names)
    raise DriveLogError(
        f"{table.source}: nothing seems to be {' or '.join(needed)}{hint}; the columns are "
        f"{', '.join(names[:30])}; say which it is with --columns {needed[0]}=NAME"
    )


_TORQUES = {"effort", "torque"}


def _of_torques(names: Sequence[str]) -> str:
    """Say how the torques of all wheels make the powers of the sides."""
    torques = [name for name in names if _TORQUES & set(words(name))]
    made = []
    for side in ("left", "right"):
        own = [name for name in torques if side_of(name) == side]
        others = [
            name for name in names
            if own and name not in torques and side_of(name) == side
            and set(words(name)) >= set(words(own[0])) - _TORQUES
            and {"velocity", "vel", "speed", "rate", "omega", "rpm"} & set(words(name))
        ]  # fmt: skip
        if own:
            summed = own[0] if len(own) == 1 else f"({'+'.join(own)})"
            made.append(f"p_{side}={summed}*{others[0] if others else 'RATE'}")
    if not torques:
        return ""
    told = ",".join(made) if len(made) == 2 else f"p_left={torques[0]}*RATE"
    return (
        f"; {torques[0]!r} seems to be a torque: those of all wheels of a side times the wheels' "
        f'rate in rad/s make its power, as in --columns "{told}"'
    )


def _left_out(table: Table, columns: Mapping[str, Column]) -> list[Check]:
    """Find powers that count some of the wheels, motors or batteries alone."""
    used = {name for one in columns.values() for name in one.names}
    found = []
    for channel, one in columns.items():
        if channel not in POWERS:
            continue
        own = np.nanmean(np.abs(table.column(one.field)))
        rest = [
            name for name in siblings(one, table.columns)
            if name not in used and np.nanmean(np.abs(table.columns[name])) > _PART * own
        ]  # fmt: skip
        if rest:
            summed = "+".join((one.field, *one.plus, *rest))
            whole = summed if one.times is None else f"({summed})*{one.times}"
            found.append(Check(
                f"{channel} counts {' and '.join((one.field, *one.plus))}, and not "
                f"{' and '.join(rest)}, which is of another wheel, motor or battery",
                f"count all of them, as in --columns '{channel}={whole}'",
            ))  # fmt: skip
    return found


_PART = 0.05  # of a power, that another one of its kind is at least


def refuse_halves(table: Table, found: Mapping[str, Column], channels: set[str]) -> None:
    """Refuse to take one of two columns that are named alike, and differ, for the whole power."""
    one = found.get("power" if "power" in channels else "current")
    if one is None or {"p_left", "p_right"} <= channels:
        return
    volts = found.get("voltage")
    if "power" not in channels and volts is not None and not one.plus:
        _refuse_packs(table, volts.field)
    used = {name for other in found.values() for name in other.names}
    for name in halves(one.field, [other for other in table.columns if other not in used]):
        pair = np.array([table.columns[each] for each in (one.field, name)], float)
        pair = pair[:, np.isfinite(pair).all(axis=0)]
        if not pair.size or np.ptp(pair, axis=1).min() == 0.0:
            continue
        alike = np.corrcoef(pair)[0, 1]
        sizes = np.abs(pair).mean(axis=1)
        twins = of_batteries(one.field)  # which share what is drawn
        if (alike < _ALIKE or twins) and sizes.min() > _HALF * sizes.max():
            raise DriveLogError(
                f"{table.source}: {one.field} and {name} could each be the power or current of the "
                "whole robot, and differ; where they are those of two sides say so, as in "
                f"--columns 'p_left={one.field},p_right={name}' for powers, where they add up, as "
                f"those of two batteries do, as in --columns '{one.channel}={one.field}+{name}', "
                f"else name the whole, as in --columns '{one.channel}={one.field}'"
            )


def _refuse_packs(table: Table, name: str) -> None:
    """Refuse to take one of several numbered voltages beside one current for the whole."""
    alike = re.sub(r"\d+", "0", name)
    packs = [other for other in table.columns if re.sub(r"\d+", "0", other) == alike]
    usual = [float(np.nanmedian(table.columns[pack])) for pack in packs]
    if len(packs) > 1 and min(usual) > _ALIKE * max(usual):
        raise DriveLogError(
            f"{table.source}: {' and '.join(packs[:3])} are several voltages beside one current; "
            f"where they are in series say so, as in --columns 'voltage={'+'.join(packs)}', else "
            f"as in --columns 'voltage={name}'"
        )


def refuse_unlike(table: Table, found: Mapping[str, Column]) -> None:
    """Refuse to take the mean of one side's wheels where these do not go alike."""
    for channel in ("v_left", "v_right"):
        one = found.get(channel)
        if one is None:
            continue
        power = found.get(f"p_{channel[2:]}", one)
        if one.plus and not power.plus and of_one_wheel(power.field):
            raise DriveLogError(
                f"{table.source}: {power.field} is of one wheel, and {one.written} of several; "
                "name the powers of all, or of the driven one, as in --columns "
                f"'p_{channel[2:]}={power.field}'"
            )
        for name in one.plus:
            first, second = (table.columns[each] for each in (one.field, name))
            both = np.isfinite(first) & np.isfinite(second)
            if not np.any(first[both]) and not np.any(second[both]):
                continue
            alike = correlation(first[both], second[both])
            if alike < _ONE_SIDE:
                way = "go opposite ways" if alike < -_ONE_SIDE else "do not go alike"
                raise DriveLogError(
                    f"{table.source}: {one.field} and {name} seem to be speeds of the same side, "
                    f"and {way} (correlation {alike:.2f}): one is dead or counts the other way, or "
                    "they are of two robots; name those that are right, the power among them, as "
                    f"in --columns '{channel}={one.field}'"
                )


_SOME = 20_000  # readings that suffice to tell a unit
_FASTEST_TURN = 3.0  # yaw rate that hardly a robot reaches that skids [rad/s]
_FULL_TURN = 6.5  # [rad]; headings beyond are unwrapped, or degrees
_TURNS = 3 * _FULL_TURN  # beyond, they are rather degrees
_VOLTS = {"mV": (4.5, 450.0), "*0.01": (4.5, 100.0), "*0.1": (4.5, 100.0)}  # usual ranges [V]
_HIGHEST_VOLTAGE = 1000.0  # of a battery [V]
_USUAL_FORCE = (0.02, 2.0)  # power over weight times speed that does not surprise
_SPEEDS = ("v_left", "v_right")
_NEEDED = {"t", "v_left", "v_right", "p_left", "p_right", "power", "voltage", "current"}
_CHARGE = {"percentage", "percent", "soc", "pct"}  # words of how full a battery is
_SMALLEST_RADIUS, _LARGEST_RADIUS = 2e-4, 0.8  # of a wheel, or of one over its gear ratio [m]
_RADIUS = 0.15  # radius of wheels of which it is not known yet [m]


@dataclass(frozen=True)
class Start:
    """A robot's project, and how well its log bears it out."""

    project: Project  # vehicle, columns or topics, and what was assumed
    checks: tuple[Check, ...]  # what was held against what
    notes: tuple[str, ...]  # what is doubtful about the log

    @property
    def sound(self) -> bool:
        """Whether nothing contradicts anything."""
        return all(check.ok for check in self.checks)


def start_all(paths: Sequence[Path], given: Given) -> Start:
    """Start from the first of a robot's drives, and hold the others against what comes of it."""
    made = start(paths[0], given)
    if len(paths) == 1:
        return made
    project, checks, notes = made.project, [*made.checks], [*made.notes]
    drives = [read_log(paths[0], dict(project.columns) or None, topics=project.topics)]
    for path in paths[1:]:
        log = read_log(path, dict(project.columns) or None, topics=project.topics)
        found = find_checks(log.channels, log.power, log.runs)
        wrong = [one for one in found if one.refuses] + contradictions(log, project.vehicle)
        told = {str(one): replace(one, what=f"{log.name}: {one.what}") for one in wrong}
        checks += told.values()
        notes += [f"{log.name}: {one}" for one in (*log.set_aside, *log.warnings)
                  if str(one) not in told]  # fmt: skip
        drives.append(log)
    notes += without_copies(drives, [])[1]
    return replace(made, checks=tuple(checks), notes=tuple(notes))


def start(path: str | Path, given: Given | None = None) -> Start:
    """Guess what a log's columns or topics are, and hold them against the robot."""
    known = given or Given()
    if is_bag(path):
        return _start_bag(Path(path), known)
    if known.columns is None and is_husky(path):
        like = "" if known.like is None else known.like.name
        log = read_log(path, topics=topic_map_of(like))
        return _finish(Path(path), log, known, {}, TOPIC_MAPS["husky"], {})
    return _start_table(Path(path), known)


# -- tables -------------------------------------------------------------------------------------


def _start_table(file: Path, known: Given) -> Start:
    table = read_table(file, DriveLogError, parse_columns(known.columns).get("t"))
    columns = parse_columns(known.columns, (*table.columns, *table.text))
    if not columns and tasks_of(table, 1.0) is not None:
        raise DriveLogError(
            f"{table.source}: a row is a task, not an instant of a drive: energyplan identify "
            f"{file.name} --vehicle VEHICLE learns from their distances, turning and energies"
        )
    # A factor of a power, such as a wheel's rate, may serve for itself too.
    taken = {name for one in columns.values() for name in (one.field, *one.plus)}
    found = _guesses(table, taken, columns)
    _powers(columns, found)
    found = {channel: one for channel, one in found.items() if channel not in columns}
    if "t" not in columns and "t" not in found:
        used = taken.union(*(one.names for one in found.values()))
        clock = find_clock({n: v for n, v in table.columns.items() if n not in used})
        columns |= {} if clock is None else {"t": clock}
    _refuse_percentages(table.source, table.columns, {*columns, *found})
    encoders = {name: found.pop(name) for name in [*found] if found[name].unit in COUNTS}
    speeds = {*_SPEEDS}
    notes: list[str] = []
    used = {name for one in (*columns.values(), *found.values()) for name in one.names}
    if not speeds & {*columns, *found, *encoders}:
        encoders = guess_encoders(name for name in table.columns if name not in used)
    if encoders:
        columns |= _counted(table, encoders, known)
    elif not speeds & {*columns, *found}:
        notes = _from_twist(table, columns, found, known)
    there = {*columns, *found}
    needed = [name for name in ("t", "v_left", "v_right") if name not in there]
    if not any(set(way) <= there for way in POWER_WAYS):
        needed.append("power")
    if needed:
        refuse(table, needed)
    refuse_halves(table, found, there)
    refuse_unlike(table, found)
    for channel, one in found.items():
        bare = one.unit in RATES and channel in speeds  # takes a radius, below
        columns[channel] = _mean(one.model_copy(update={"unit": "" if bare else one.unit}))
    for channel in ("slope", "temperature", "payload"):
        if channel in table.columns and channel not in columns:
            columns[channel] = Column(field=channel, channel=channel)
    notes += _of_compass(table, columns, found)
    columns = _with_units(table, columns, found, known)
    log = read_signed(partial(DriveLog.read, file, others=False), columns)
    used = {name for one in log.columns.values() for name in one.names}
    idle = [name for name in table.columns if name not in used]
    notes += [f"columns that serve for nothing: {', '.join(idle[:20])}"] if idle else []
    made = _finish(file, log.log, known, log.columns, None, {})
    made = replace(made, checks=(*made.checks, *_left_out(table, log.columns)))
    return replace(made, notes=(*notes, *log.notes, *made.notes))


def _of_compass(table: Table, columns: dict[str, Column], found: dict[str, Column]) -> list[str]:
    """Turn a pose of east and north, whose heading is that of a compass, to axes of its own."""
    if not {"x", "y", "yaw"} <= set(found) or "east" not in found["x"].field.lower():
        return []
    yaw = table.column(found["yaw"].field)[:_SOME]
    left, right = (table.column(columns[name].field)[:_SOME] for name in _SPEEDS)
    period = 360.0 if _size(table, columns["yaw"]) > _FULL_TURN else 2 * pi
    rate = np.gradient(np.unwrap(yaw, period=period))
    known = np.isfinite(rate + left + right)
    if correlation(rate[known], (right - left)[known]) >= 0.0:
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


def _counted(table: Table, encoders: Mapping[str, Column], known: Given) -> dict[str, Column]:
    """Return the speeds of encoders whose way of counting and metres per count are known."""
    metres = 2 * pi * known.wheel_radius / known.counts_per_revolution
    if isfinite(metres) and all(one.unit for one in encoders.values()):
        return {
            channel: _mean(one.changed(unit=f"{one.unit}*{metres:.8g}"))
            for channel, one in encoders.items()
        }
    size = f"{metres / (1 + len(encoders['v_left'].plus)):.6g}" if isfinite(metres) else "0.0001"
    told = ",".join(
        f"{channel}={one.written}[{one.unit or TOTAL}*{size}]" for channel, one in encoders.items()
    )
    ways = "" if encoders["v_left"].unit else (
        f" where they count on, {SINCE} where they count from row to row, {RATE} where they count "
        "in a second"
    )  # fmt: skip
    raise DriveLogError(
        f"{table.source}: {encoders['v_left'].field!r} is an encoder's, and how far a count goes "
        f"is not known: give --counts-per-revolution with --wheel-radius, or the metres per count "
        f'(1 if it counts metres) and, in brackets, how it counts, as in --columns "{told}"{ways}'
    )


_ELECTRIC = ("power", "p_left", "p_right", "current", "current_left", "current_right")


def _guesses(
    table: Table, taken: Collection[str], columns: Mapping[str, Column]
) -> dict[str, Column]:
    """Guess which column is which channel; a counter of energy or charge is no power of its own."""
    names = [name for name in table.columns if name not in taken]
    counters = {name for name in names if grows(table.columns[name][:_SOME])}
    names += [name for name in quaternions(table.columns) if np.ptp(_some(table, Column(
        field=name, channel="yaw"))) > 0.0]  # fmt: skip
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
                f"{table.source}: {grown!r} only ever grows or falls: it counts energy or charge, "
                "and is no power and no current; map its rate of change by its unit, as in "
                f"--columns 'current={grown}[mAh]' or --columns 'power={grown}[Wh]'"
            )
    return found


def _from_twist(
    table: Table, columns: dict[str, Column], found: dict[str, Column], known: Given
) -> list[str]:
    """Make tread speeds from the speed and the turn rate of the body, where a log has no others."""
    used = {name for one in columns.values() for name in one.names}
    ahead = next(iter(guess_ahead(name for name in table.columns if name not in used)), None)
    turns = guess_turns(name for name in table.columns if name not in used)
    if ahead is None or not turns:
        return []
    turn = max(turns, key=lambda name: len(set(words(name)) & set(words(ahead))))
    note = _of_body(known, f"{ahead} and {turn}")
    track = known_measures(known).track
    speed_scale = scale_of("v_left", unit_in("v_left", ahead).unit).factor
    rate_scale = scale_of("yaw_rate", unit_in("yaw_rate", turn).unit).factor
    half = 0.5 * track * rate_scale
    for channel, sign in (("v_left", -1.0), ("v_right", 1.0)):
        columns[channel] = column_from(
            channel, ahead, None, None, (turn,), (speed_scale, sign * half)
        )
    # A heading of the same odometry tells nothing of slip, but would be believed to.
    for channel in ("yaw_rate", "yaw"):
        found.pop(channel, None)
    return [note]


def _of_body(known: Given, what: str) -> str:
    """Say what is unseen where tread speeds are made from speed and turn rate of the body."""
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


def _mean(one: Column) -> Column:
    """Return a column; of a side's wheels the mean speed, and all that their motors draw."""
    unit = one.unit
    if one.plus and one.channel.startswith("v_"):
        bare, _, factor = unit.rpartition("*") if "*" in unit else (unit, "", "1")
        unit = f"{bare}*{float(factor) / (1 + len(one.plus)):.6g}"
    return one.changed(unit=unit)


def _powers(columns: dict[str, Column], guesses: dict[str, Column]) -> None:
    """Take each side's power, or its voltage times its current, or the battery's."""
    for side in ("left", "right"):
        power = f"p_{side}"
        current = guesses.pop(f"current_{side}", None)
        voltage = guesses.pop(f"voltage_{side}", None)
        if power in columns or power in guesses or current is None:
            continue
        volts = voltage or guesses.get("voltage")
        if volts is None:
            continue
        factor = scale_of("current", current.unit).factor * scale_of("voltage", volts.unit).factor
        unit = "" if factor == 1.0 else f"*{factor:g}"
        columns[power] = current.changed(channel=power, unit=unit, times=volts.field)
    sides = {"p_left", "p_right"} <= {*columns, *guesses}
    if not sides:
        for side in ("p_left", "p_right"):
            columns.pop(side, None)
            guesses.pop(side, None)


class _Choice(NamedTuple):
    """Channels that are in one unit, which nobody told, and what it may be, the likeliest first."""

    channels: tuple[str, ...]
    units: tuple[str, ...]  # those that end with a star take the wheel radius


def _choices(
    table: Table, columns: Mapping[str, Column], found: Mapping[str, Column], known: Given
) -> list[_Choice]:
    # A speed or a place that bears the channel's own name is in its unit; angles often are not.
    free = {
        channel for channel, one in found.items()
        if not one.unit and not (one.field == channel and channel in (*_SPEEDS, "x", "y"))
    }  # fmt: skip
    size = {c: _size(table, columns[c]) for c in ("yaw_rate", "yaw", "voltage") if c in free}
    rates = [found[name].unit for name in _SPEEDS if name in found and found[name].unit in RATES]
    wheels = ("rad/s*", "rpm*", "rev/s*") if isfinite(known.wheel_radius) else ()
    made = []
    if rates:
        made.append(_Choice(_SPEEDS, (f"{rates[0]}*",)))
    elif {*_SPEEDS} <= free:
        made.append(_Choice(_SPEEDS, ("m/s", *wheels, "km/h", "mm/s", "cm/s")))
    if size.get("yaw_rate", 0.0) > _FASTEST_TURN:
        made.append(_Choice(("yaw_rate",), ("rad/s", "deg/s")))
    if size.get("yaw", 0.0) > _FULL_TURN:  # else these are no degrees
        made.append(_Choice(("yaw",), ("deg", "rad") if size["yaw"] > _TURNS else ("rad", "deg")))
    if size.get("voltage", 0.0) > _HIGHEST_VOLTAGE:
        made.append(_Choice(("voltage",), (_unit_of_voltage(table, columns["voltage"]),)))
    # A thousand is more than robots' resistances differ by: their weight tells which it is.
    watts = ("W", "mW", "kW")
    for channels, units in (
        (("current",), ("A", "mA")), (("power",), watts), (("p_left", "p_right"), watts),
        (("x", "y"), ("m", "mm", "cm")),
    ):  # fmt: skip
        if set(channels) <= free:
            made.append(_Choice(channels, units))
    return made


def _readings(table: Table, columns: Mapping[str, Column]) -> dict[str, FloatArray]:
    """Return rows that hold every channel; a mirrored side is turned, as `read_signed` does."""
    t = _some(table, columns["t"])
    raw = {channel: _some(table, column, t) for channel, column in columns.items()}
    joined = join_rows(raw, [name for name in raw if name in _NEEDED])
    raw = _whole_rows(raw if joined is None else joined.channels)
    if len(raw["t"]) >= RECORDING:
        mirrored = mirrored_side(Drive(raw, raw["t"], find_runs(raw["t"])))
        raw |= {mirrored: -raw[mirrored]} if mirrored else {}
    return raw


def _with_units(
    table: Table, columns: dict[str, Column], found: Mapping[str, Column], known: Given
) -> dict[str, Column]:
    """Choose the units that nobody told, so that all that a log tells twice agrees."""
    clock = columns["t"]
    if not clock.unit:  # that in which a drive log's step is usual
        columns = {**columns, "t": clock.changed(unit=_unit_of_time(table, columns))}
    choices = _choices(table, columns, found, known)
    raw = _readings(table, columns)
    measures, radius = known_measures(known), known.wheel_radius
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
        drive = Drive(trial, total_power(trial), find_runs(trial["t"]))
        # The measures may be what is wrong: they only decide where the log alone does not.
        cost = strain(drive, Measures()) + 0.2 * strain(drive, measures)
        cost += 0.01 * sum(one.units.index(unit) for one, unit in picked)
        # A heading in another unit does not turn with the treads, or a gyroscope, at all.
        cost += 0.5 * bool(np.isnan(drive.slip_track))
        cost += 0.5 * ({"yaw", "yaw_rate"} <= set(trial) and bool(np.isnan(drive.rotation)))
        if cost < best - 1e-9:
            best, chosen, agreed = cost, each, drive
    if agreed is not None:
        _sure_of_current(table, columns, chosen, agreed.force / (measures.mass * GRAVITY))
        units = next((one.units for one in choices if "v_left" in one.channels), ())
        _sure_of_speeds(table, columns, units, chosen, agreed, known)
    if any(unit.endswith("*") for unit in chosen.values()) and not isfinite(radius):
        radius = nan if agreed is None else _radius_of(agreed.distance / _RADIUS)
        if not isfinite(radius):
            raise InvalidInputError(f"{table.source}: {_no_radius(raw)}")
    made = dict(columns)
    for channel, unit in chosen.items():
        if channel in made:
            written = f"{unit}{radius:.6g}" if unit.endswith("*") else unit
            plain = written in ("m/s", "rad", "rad/s", "m", "A", "W")
            made[channel] = _mean(made[channel].changed(unit="" if plain else written))
    return made


def _unit_of_time(table: Table, columns: Mapping[str, Column]) -> str:
    """Return the unit of a clock that no name tells; of rows seconds apart the speeds jump."""
    units = time_units(table.column(columns["t"].field)[:_SOME])
    if len(units) < 2:
        return units[0]
    jumps = []
    for one in (table.column(columns[name].field)[:_SOME] for name in _SPEEDS):
        lasting = np.median(sliding_window_view(one[np.isfinite(one)], 5), axis=-1)
        steps, size = (np.quantile(np.abs(part), 0.99) for part in (np.diff(lasting), lasting))
        jumps.append(float(steps / max(size, 1e-300)))
    jump = max(jumps)
    if _JUMP[0] < jump < _JUMP[1]:
        why = "could count seconds or milliseconds: the speeds change too little to tell"
        _ask_unit(table, columns["t"], why, ("s", "ms"))
    return "s" if jump >= _JUMP[1] else units[-1]


_JUMP = (0.08, 0.25)  # change of speed in a row, as a share of the largest, that tells no unit


def _ask_unit(table: Table, column: Column, why: str, units: Iterable[str]) -> NoReturn:
    """Refuse to guess a unit, and say how to give it."""
    ways = " or ".join(f"{column.channel}={column.field}[{unit}]" for unit in units)
    raise DriveLogError(
        f"{table.source}: {column.field} {why}; give its unit with --columns, and those of others "
        f"that may have the same fault{f', as in {ways}' if ways else ''}"
    )


def _unit_of_voltage(table: Table, column: Column) -> str:
    """Return the unit of a voltage that is none in volts, where it can be one alone."""
    size = _size(table, column)
    volts = {u: size * scale_of("voltage", u).factor for u in _VOLTS}
    could = [u for u, (low, high) in _VOLTS.items() if low <= volts[u] <= high]
    if could != ["mV"]:
        made = f", but {' or '.join(f'{volts[u]:.3g} V in [{u}]' for u in could)}" if could else ""
        why = f"is up to {size:.6g}, which is no voltage of a robot in V{made}"
        _ask_unit(table, column, why, could)
    return "mV"


_SURE = 0.1  # relative error of a distance up to which its unit is sure
_NEAR = 1.35  # ratio of two units up to which turning does not tell one from the other


def _sure_of_speeds(
    table: Table, columns: Mapping[str, Column], units: Sequence[str],
    chosen: Mapping[str, str], drive: Drive, known: Given,
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
        _ask_unit(table, columns["v_left"], why, near[:1])


def _sure_of_current(
    table: Table, columns: Mapping[str, Column], chosen: Mapping[str, str], force: float
) -> None:
    """Refuse a unit of current or power that its size does not tell from tenths or hundredths."""
    for channel in ("current", "power"):
        unit = chosen.get(channel, "")
        if not unit.startswith("m") or not isfinite(force):
            continue
        readings = _some(table, columns[channel])
        sizes = {"*0.1": 100.0 * force, "*0.01": 10.0 * force}
        usual = any(_USUAL_FORCE[0] <= size <= _USUAL_FORCE[1] for size in sizes.values())
        if usual and not np.any(np.mod(readings[np.isfinite(readings)], 1.0)):
            why = "comes in whole numbers, whose unit their size does not tell for sure"
            _ask_unit(table, columns[channel], why, (*sizes, unit))


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


def _size(table: Table, column: Column) -> float:
    """Return how large readings get, strays left out."""
    values = np.abs(_some(table, column))
    values = values[np.isfinite(values)]
    return float(np.quantile(values, 0.99)) if len(values) else 0.0


def _some(table: Table, column: Column, t: FloatArray | None = None) -> FloatArray:
    """Return the first readings of a column, in the library's unit as far as it is known."""
    return column.over(t, lambda name: table.column(name)[:_SOME])


def _factor(channel: str, unit: str, known: Given) -> float:
    if not unit:
        return 1.0
    if unit.endswith("*"):
        radius = known.wheel_radius if isfinite(known.wheel_radius) else _RADIUS
        return RATES[unit[:-1]] * radius
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


# -- bags ---------------------------------------------------------------------------------------


def _start_bag(file: Path, known: Given) -> Start:
    track = known_measures(known).track
    with opened_bag(file) as bag:
        fields = list_fields(bag)
        given = fields.parse(known.columns)
        recording = bag.collect(wanted(fields, given, track))
        notes = [*bag.notes]
    chosen = choose(fields, recording, given, track)
    sources = chosen.sources
    notes += chosen.notes
    lacks = [name for name in _SPEEDS if name not in sources]
    if not any(set(way) <= set(sources) for way in POWER_WAYS):
        lacks.append("power")
    _refuse_percentages(file.name, fields.fields, sources)
    if lacks:
        there = [f"/{name.removeprefix('/')}" for name in fields.fields]
        raise DriveLogError(
            f"{file.name}: no field of a message seems to be {' or '.join(lacks)}"
            f"{fields.torques(sources) if lacks == ['power'] else ''}; the fields are "
            f"{', '.join(there[:30])}; say which it is with --columns {lacks[0]}=FIELD"
            f"{''.join(f'; {note}' for note in notes)}"
        )
    if sources["v_left"].field.startswith("twist."):
        notes.append(_of_body(known, f"those of {sources['v_left'].topic}"))
        sources = {c: one for c, one in sources.items() if c not in ("yaw", "yaw_rate")} | given
    rates, radius = fields.wheel_rates(sources), known.wheel_radius

    def read(size: float) -> Signed:
        mapped = fields.topic_map(sources, size, file.stem).channels
        return read_signed(recording.log, {channel: many[0] for channel, many in mapped.items()})

    made = read(radius if isfinite(radius) else 1.0)
    assumed: dict[str, str] = {}
    if rates and not isfinite(radius):
        drive = Drive(made.log.channels, made.log.power, made.log.runs)
        radius = _radius_of(drive.distance)
        if not isfinite(radius):
            raise InvalidInputError(f"{file.name}: {_no_radius(made.log.channels)}")
        assumed["wheel_radius"] = f"{radius:.4g} m, from the pose"
        made = read(radius)
    topics = TopicMap(name=file.stem, channels={c: [one] for c, one in made.columns.items()})
    told = _finish(file, made.log, known, {}, topics, assumed)
    return replace(told, notes=(*notes, *made.notes, *told.notes))


# -- the answer ---------------------------------------------------------------------------------


def _finish(
    file: Path,
    log: DriveLog,
    known: Given,
    columns: Mapping[str, Column],
    topics: TopicMap | None,
    assumed: dict[str, str],
) -> Start:
    """Build the vehicle, and hold the log against it."""
    drive = Drive(log.channels, log.power, log.runs)
    robot = build_vehicle(file, log, drive, known)
    found = [one for one in find_checks(log.channels, log.power, log.runs) if one.refuses]
    compared = check_consistency(drive, known_measures(known), columns)
    told = {one.what for one in compared}  # with the measures, which tell more
    doubts = [one for one in compared if not (one.ok or isfinite(one.value))]
    checks = [one for one in compared if one not in doubts]
    checks += [one for one in found if one.what not in told]
    project = Project(
        name=robot.vehicle.name, vehicle=robot.vehicle, columns=columns, topics=topics,
        log=file.name, defaults={**assumed, **robot.assumed},
    )  # fmt: skip
    known_already = (*map(str, found), *(one.what for one in doubts))
    warnings = (one for one in log.warnings if not one.startswith(known_already))
    notes = (*map(str, log.set_aside), *map(str, doubts), *warnings)
    return Start(
        project,
        tuple(replace(one, remedy=_named(one.remedy, columns)) for one in checks),
        tuple(_named(note, columns) for note in notes),
    )


def _named(remedy: str, columns: Mapping[str, Column]) -> str:
    """Name the columns that a remedy is about, in the units that they are read in."""

    def named(told: re.Match[str]) -> str:
        channel, unit = told.groups()
        one = columns.get(channel)
        if one is None or (one.unit and unit[0] != "-"):
            return told[0]
        return f"{channel}={one.written}[{one.negative().unit if unit[0] == '-' else unit}]"

    return re.sub(r"(\w+)=NAME\[([^]]+)\]", named, remedy)


class Signed(NamedTuple):
    """A log, the columns it was read by, and what was turned to read it."""

    log: DriveLog
    columns: dict[str, Column]
    notes: tuple[str, ...]


def read_signed(
    read: Callable[[Mapping[str, Column]], DriveLog], columns: Mapping[str, Column]
) -> Signed:
    """Read a log, and turn round what counts the other way."""
    notes: list[str] = []
    made = dict(columns)
    done: set[str] = set()
    while True:
        try:
            log = read(made)
        except UnfitLogError as problem:
            turned = tuple(name for name in problem.check.turned if name in made)
            if not turned or done & set(turned):
                raise UnfitLogError(_named(str(problem), made), problem.check) from None
        else:
            side = mirrored_side(Drive(log.channels, log.power, log.runs))
            if not side or side in done:
                return Signed(log, made, tuple(notes))
            turned = (side,)
        made |= {name: made[name].negative() for name in turned}
        done |= set(turned)
        notes.append(f"{' and '.join(turned)} had the opposite sign, which was corrected")
