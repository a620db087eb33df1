"""What is known of a robot and its log's columns, what they lack, and what encoders count."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import isfinite, nan, pi
from pathlib import Path
from typing import NamedTuple, NoReturn

import numpy as np

from energyplan.errors import DriveLogError, InvalidInputError
from energyplan.logs import DriveLog
from energyplan.logs.align import find_runs
from energyplan.logs.checks import grows
from energyplan.logs.clean import join_rows
from energyplan.logs.consistency import Evidence, Measures, correlation, distance_ratio, yaw_rates
from energyplan.logs.guess import (
    ENCODER,
    Guess,
    guess,
    guess_ahead,
    guess_position,
    halves,
    numbered_speeds,
    words,
)
from energyplan.logs.mapping import RATE, SINCE, TOTAL, Column, column_from, unit_in
from energyplan.logs.tables import Table
from energyplan.path import FloatArray
from energyplan.vehicle import MotorLimits, TreadICR, Vehicle

_SLIP = 0.93  # slip track over that of equal point loads, as of Huskies and a Warthog
_DENSITY = 250.0  # mass over wheelbase times track of a robot that nobody weighed [kg/m^2]


@dataclass(frozen=True)
class Given:
    """What is known of the robot before its log is read; NaN where it is not."""

    wheel_radius: float = nan  # radius of the wheels [m]
    track: float = nan  # radius of the wheels [m]
    wheelbase: float = nan  # radius of the wheels [m]
    mass: float = nan  # mass as it drives [kg]
    length: float = nan  # footprint [m]
    width: float = nan  # footprint [m]
    name: str = ""  # what to call the robot
    like: Vehicle | None = None  # A vehicle to take the rest from
    columns: str | None = None  # columns that are known, as for `DriveLog.read`
    counts_per_revolution: float = nan  # what an encoder counts while the wheel turns once

    def __post_init__(self) -> None:
        for key in ("wheel_radius", "track", "wheelbase", "mass", "length", "width",
                    "counts_per_revolution"):  # fmt: skip
            value = getattr(self, key)
            if not (np.isnan(value) or (isfinite(value) and value > 0)):
                raise InvalidInputError(f"{key} is {value}; give a positive number")


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


def build_vehicle(file: Path, log: DriveLog, evidence: Evidence, known: Given) -> Robot:
    """Build a vehicle from what is given; the rest from the log, or as robots usually are."""
    assumed: dict[str, str] = {}
    measures = known_measures(known)
    track, wheelbase, mass = measures.track, measures.wheelbase, measures.mass
    slip = evidence.slip_track
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
        if isfinite(evidence.inertia):
            mass = evidence.inertia
        assumed["mass"] = (
            f"{mass:.3g} kg, {'from speeding up' if isfinite(evidence.inertia) else 'a guess'}; "
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
            table.column(one.name)  # says which cell is no number
    names = (*table.columns, *table.text)
    hint = ""
    if {"v_left", "v_right"} & set(needed):
        hint = "; v_left and v_right are the speeds of the left and right wheels"
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
    numbers = [name for name, values in table.columns.items() if counts_rows(values)]
    if "t" in needed and numbers:
        hint += (
            f"; {numbers[0]!r} counts rows: if they come at a steady rate, give the time from row "
            f"to row, as in t={numbers[0]}[*0.05] for 50 ms"
        )
    used = [
        (name, channel, unit)
        for name, values in table.columns.items() if grows(values)
        for channel, unit in (("current", "mAh"), ("power", "Wh"))
        if _CONSUMED[channel] & set(words(name))
    ]  # fmt: skip
    if "power" in needed and used:
        name, channel, unit = used[0]
        named = unit_in(channel, name)
        unit = named.unit if named is not None else unit
        hint += (
            f"; {name!r} seems to count what was used: map its rate of change by its unit, as in "
            f"{channel}={name}[{unit}]"
        )
    torques = [name for name in names if {"effort", "torque"} & set(words(name))]
    if "power" in needed and torques:
        hint += (
            f"; {torques[0]!r} seems to be a torque: its power is torque times the wheel's rate in "
            f"rad/s, as in p_left={torques[0]}*RATE"
        )
    raise DriveLogError(
        f"{table.source}: nothing seems to be {' or '.join(needed)}{hint}; the columns are "
        f"{', '.join(names[:30])}; say which it is with --columns {needed[0]}=NAME"
    )


def counts_rows(values: FloatArray) -> bool:
    """Tell whether a column is the number of its row: that is no time."""
    return len(values) > 1 and bool(np.all(np.diff(values) == 1.0))


def refuse_halves(table: Table, found: Mapping[str, Guess], channels: set[str]) -> None:
    """Refuse to take one of two columns that are named alike, and differ, for the whole power.

    They may be those of two sides in words that nobody knows here: half of the power would be lost.
    """
    one = found.get("power" if "power" in channels else "current")
    if one is None or {"p_left", "p_right"} <= channels:
        return
    volts = found.get("voltage")
    if "power" not in channels and volts is not None and not one.fellows:
        _refuse_packs(table, volts.name)
    used = {name for other in found.values() for name in (other.name, *other.fellows)}
    for name in halves(one.name, [other for other in table.columns if other not in used]):
        pair = np.array([table.columns[each] for each in (one.name, name)], float)
        pair = pair[:, np.isfinite(pair).all(axis=0)]
        if not pair.size or np.ptp(pair, axis=1).min() == 0.0:
            continue
        alike = np.corrcoef(pair)[0, 1]
        sizes = np.abs(pair).mean(axis=1)
        if alike < _ALIKE and sizes.min() > _HALF * sizes.max():
            raise DriveLogError(
                f"{table.source}: {one.name} and {name} could each be the power or current of the "
                "whole robot, and differ; where they are those of two sides say so, as in "
                f"--columns 'p_left={one.name},p_right={name}' for powers, else name the whole, as "
                f"in --columns 'power={one.name}'"
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


def refuse_unlike(table: Table, found: Mapping[str, Guess]) -> None:
    """Refuse to take the mean of one side's wheels where these do not go alike.

    One may be dead or count the other way, or they may be of two robots.
    """
    for channel in ("v_left", "v_right"):
        one = found.get(channel)
        if one is None:
            continue
        for name in one.fellows:
            first, second = (table.columns[each] for each in (one.name, name))
            both = np.isfinite(first) & np.isfinite(second)
            if not np.any(first[both]) and not np.any(second[both]):
                continue
            alike = correlation(first[both], second[both])
            if alike < _ONE_SIDE:
                way = "go opposite ways" if alike < -_ONE_SIDE else "do not go alike"
                raise DriveLogError(
                    f"{table.source}: {one.name} and {name} seem to be speeds of the same side, "
                    f"and {way} (correlation {alike:.2f}): one is dead or counts the other way, or "
                    "they are of two robots; name those that are right, the power among them, as "
                    f"in --columns '{channel}={one.name}'"
                )


_SOME = 20_000  # readings that suffice
_ENOUGH = 20  # of them
_ONE_WAY = 0.9  # mean sign of the steps of readings that go one way
_AS_AHEAD = 0.9  # correlation from which a speed of the robot is that of its treads
_BETTER = 0.05  # share of what is explained, from which on another direction is believed
_EARTH = 6_371_008.8  # mean radius [m]
_AHEAD = "ahead"


class Counted(NamedTuple):
    """Columns with the speeds of encoders, and what was taken for what nobody gave."""

    columns: dict[str, Column]
    assumed: dict[str, str]


def position_columns(table: Table, taken: set[str]) -> dict[str, Column]:
    """Return latitude and longitude as ``y`` and ``x`` on a plane; none where there are none."""
    named = guess_position([name for name in table.columns if name not in taken])
    if named is None:
        return {}
    lat = table.columns[named[0]][:_SOME]
    lat = lat[np.isfinite(lat) & (lat != 0.0)]
    if not len(lat):
        return {}
    north = float(np.median(lat))
    degree = next((size for size in (1.0, 1e-7) if abs(north * size) <= 90.0), nan)
    if not isfinite(degree):
        return {}
    metres = degree * _EARTH * pi / 180
    east = metres * float(np.cos(np.radians(north * degree)))
    return {
        "x": column_from("x", named[1], f"*{east:.9g}"),
        "y": column_from("y", named[0], f"*{metres:.9g}"),
    }


def counted_columns(
    table: Table, columns: Mapping[str, Column], encoders: Mapping[str, Guess], known: Given
) -> Counted:
    """Find out how encoders count and how far a count goes."""
    others = dict(columns)
    taken = {name for one in columns.values() for name in one.names}
    ahead = guess_ahead(name for name in table.columns if name not in taken)
    if ahead:
        unit = unit_in("v_left", ahead[0])
        others[_AHEAD] = column_from("v_left", ahead[0], unit.unit if unit else None)
    named = encoders["v_left"].unit
    kinds = (named,) if named else (TOTAL, SINCE if _whole(table, encoders) else RATE)
    if not named and all(_goes_on(table.columns[one.name]) for one in encoders.values()):
        kinds = (TOTAL,)
    read = {kind: _read(table, others, encoders, kind) for kind in kinds}
    kind = max(kinds, key=lambda one: _likeness(read[one]))
    channels = _turned(read[kind])
    signs = {
        name: -1.0 if float(np.sum(channels[name] * read[kind][name])) < 0 else 1.0
        for name in ("v_left", "v_right")
    }
    metres, why = _metres(channels, others, known)
    name = encoders["v_left"].name
    if not isfinite(metres):
        other = encoders["v_right"].name
        raise DriveLogError(
            f"{table.source}: {name!r} is an encoder's, and nothing in the log says how far a "
            "count goes: no pose, no position by satellite, no speed of the robot; give "
            "--counts-per-revolution with --wheel-radius, or the metres per count, as in "
            f'--columns "v_left={name}[{kind}*0.0001],v_right={other}[{kind}*0.0001]"'
        )
    made = dict(columns)
    for channel, one in encoders.items():
        factor = metres / (1 + len(one.fellows))
        written = f"{'-' if signs[channel] < 0 else ''}{kind}*{factor:.6g}"
        made[channel] = column_from(channel, one.name, written, None, one.fellows)
    assumed = {"count": f"{metres:.4g} m a count, {why}"} if why else {}
    turned = [encoders[channel].name for channel, sign in signs.items() if sign < 0]
    if turned:
        assumed["direction"] = f"{' and '.join(turned)} count backwards"
    return Counted(made, assumed)


def _goes_on(values: FloatArray) -> bool:
    """Tell whether readings go one way all along, as no speed does: those of a counter."""
    steps = np.diff(values[np.isfinite(values)][:_SOME])
    steps = steps[steps != 0.0]
    return len(steps) >= _ENOUGH and abs(float(np.mean(np.sign(steps)))) > _ONE_WAY


def _whole(table: Table, encoders: Mapping[str, Guess]) -> bool:
    """Tell whether an encoder's readings are whole numbers."""
    values = table.columns[encoders["v_left"].name][:_SOME]
    return bool(np.all(np.mod(values[np.isfinite(values)], 1.0) == 0.0))


def _read(
    table: Table, others: Mapping[str, Column], encoders: Mapping[str, Guess], kind: str
) -> dict[str, FloatArray]:
    """Read the channels, each encoder in counts a second, on one clock."""
    columns = dict(others)
    for channel, one in encoders.items():
        unit = f"{kind}*{1 / (1 + len(one.fellows)):.6g}"
        columns[channel] = column_from(channel, one.name, unit, None, one.fellows)

    def reading(name: str) -> FloatArray:
        return table.column(name)[:_SOME]

    t = np.asarray(columns["t"].value(reading))
    raw = {channel: column.over(t, reading) for channel, column in columns.items()}
    joined = join_rows(raw, [name for name in raw if name not in ("x", "y", "yaw", _AHEAD)])
    raw = raw if joined is None else joined.channels
    sound = np.isfinite(raw["t"]) & np.isfinite(raw["v_left"]) & np.isfinite(raw["v_right"])
    clock = np.where(sound, raw["t"], -np.inf)
    sound &= np.append(True, np.diff(np.maximum.accumulate(clock)) > 0)
    return {name: values[sound] for name, values in raw.items()}


def _likeness(channels: Mapping[str, FloatArray]) -> float:
    """How well power and turning follow from what the encoders would be the speeds of."""
    left, right, power = channels["v_left"], channels["v_right"], total_power(channels)
    turns = [correlation(rate, right - left) ** 2 for rate in _rates(channels)]
    known = np.isfinite(power)
    spread = float(np.var(power[known])) if np.count_nonzero(known) >= _ENOUGH else 0.0
    if spread == 0.0:
        return float(np.sum(turns))
    effort, turning = np.abs(left) + np.abs(right), np.abs(right - left)
    X = np.stack([effort, turning, np.ones(len(left))], axis=1)[known]
    X /= np.maximum(np.abs(X).max(axis=0), 1e-300)
    rest = power[known] - X @ np.linalg.lstsq(X, power[known], rcond=None)[0]
    return float(np.sum(turns)) + 1.0 - float(np.var(rest)) / spread


def _rates(channels: Mapping[str, FloatArray]) -> list[FloatArray]:
    """Return the yaw rates that are known throughout."""
    sound = {
        name: values for name, values in channels.items()
        if name in ("t", "yaw", "yaw_rate") and np.all(np.isfinite(values))
    }  # fmt: skip
    return list(yaw_rates(sound, find_runs(channels["t"])).values())


def total_power(channels: Mapping[str, FloatArray]) -> FloatArray:
    """Return the power of both sides together, from whichever channels there are [W]."""
    if {"p_left", "p_right"} <= set(channels):
        return channels["p_left"] + channels["p_right"]
    if "power" in channels:
        return channels["power"]
    return channels["voltage"] * channels["current"]


def _turned(channels: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
    """Turn the encoder round that counts down on the way ahead, as of a motor that faces back."""
    as_they_are = dict(channels)
    left = {**channels, "v_left": -channels["v_left"]}
    if _likeness(left) < _likeness(as_they_are) + _BETTER:
        return as_they_are
    right = {**channels, "v_right": -channels["v_right"]}
    rates = _rates(channels)
    turn = sum(correlation(rate, left["v_right"] - left["v_left"]) for rate in rates)
    way = float(np.sum(left["v_left"] + left["v_right"]))
    return left if (turn > 0 if rates else way > 0) else right


def _metres(
    channels: Mapping[str, FloatArray], columns: Mapping[str, Column], known: Given
) -> tuple[float, str]:
    """Return metres per count, and where they come from; empty where they were given."""
    if isfinite(known.counts_per_revolution) and isfinite(known.wheel_radius):
        return 2 * pi * known.wheel_radius / known.counts_per_revolution, ""
    placed = {
        name: values for name, values in channels.items()
        if name in ("t", "v_left", "v_right", "x", "y")
    }  # fmt: skip
    sound = np.all([np.isfinite(values) for values in placed.values()], axis=0)
    if {"x", "y"} <= set(placed) and np.count_nonzero(sound) >= _ENOUGH:
        placed = {name: values[sound] for name, values in placed.items()}
        counts = distance_ratio(placed, find_runs(placed["t"]))
        if isfinite(counts) and counts > 0:
            return 1.0 / counts, f"from {columns['x'].source} and {columns['y'].source}"
    if _AHEAD in channels:
        mean, speed = 0.5 * (channels["v_left"] + channels["v_right"]), channels[_AHEAD]
        sound = np.isfinite(speed)
        mean, speed = mean[sound], speed[sound]
        if len(mean) >= _ENOUGH and abs(correlation(np.abs(mean), np.abs(speed))) > _AS_AHEAD:
            ratio = float(np.abs(mean) @ np.abs(speed)) / float(mean @ mean)
            return ratio, f"from {columns[_AHEAD].source}"
    return nan, ""
