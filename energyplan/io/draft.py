"""Which series of a log may serve as which channels: by names, units and types of messages."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from math import isfinite, nan, pi
from types import MappingProxyType
from typing import NamedTuple, NoReturn

import numpy as np
from numpy.typing import NDArray

from energyplan.errors import DriveLogError
from energyplan.io.bags import (
    TOPIC_MAPS,
    Typed,
    electrical_rates,
    held_of,
    of_body,
    of_types,
    serving,
    untyped,
)
from energyplan.io.given import Given, known_measures
from energyplan.io.logs import named_columns, tasks_of
from energyplan.logs.align import Series, align, integral, usable
from energyplan.logs.checks import grows
from energyplan.logs.clean import POWER_WAYS
from energyplan.logs.consistency import POWERS, correlation
from energyplan.logs.guess import (
    ENCODER,
    electric,
    guess,
    guess_ahead,
    guess_encoders,
    guess_turns,
    numbered_speeds,
    siblings,
    side_of,
    voltages_of,
    words,
)
from energyplan.logs.mapping import (
    COUNTS,
    RATE,
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
from energyplan.logs.tables import Recording, counts_rows, find_clock, find_stamp, quaternions
from energyplan.path import FloatArray
from energyplan.units import RATES


def _measured(recording: Recording, name: str) -> bool:
    """Return whether a series holds a reading; a power that is zero all along is none."""
    values = recording.columns[name]
    known = np.isfinite(values)
    return bool(known.any() and (np.any(values[known]) or not electric(name, recording.columns)))


def _refuse_blank(recording: Recording, needed: Sequence[str]) -> None:
    """Refuse a log whose column for what is needed holds no reading at all."""
    for channel in needed:
        ways = (channel,) if channel != "power" else ("power", "current", "p_left", "voltage")
        found = guess(recording.columns)
        for one in (found[way] for way in ways if way in found):
            if not _measured(recording, one.field):
                known = np.isfinite(recording.column(one.field)).any()
                raise DriveLogError(
                    f"{recording.source}: {one.field} is never measured: it is "
                    f"{'0' if known else 'nan'} in all rows, as "
                    "of a driver without that sensor; log one that measures it, or map another "
                    f"column, as in --columns {one.channel}=NAME"
                )


_CONSUMED = {
    "current": {"ah", "mah", "charge", "amphours", "coulomb", "coulombs"},
    "power": {"wh", "kwh", "energy", "joule", "joules", "consumed", "used"},
}
"""Words of counters of charge and of energy."""


def refuse(recording: Recording, needed: Sequence[str]) -> NoReturn:
    """Say what is missing, and why what could be it is not."""
    _refuse_blank(recording, needed)
    _refuse_text(recording, needed)
    names, columns, hint = [*recording.columns, *recording.text], recording.columns, ""
    if kinds := serving(recording, "current" if "power" in needed else "v_left"):
        # Their messages are known, so that other names are no hint, but for those of motors.
        names = [name for name in names if "rpm" in words(name)]
        columns = {name: columns[name] for name in names}
        hint = f"; {' or '.join(kinds)} holds it: have the flight controller log that"
    lost = [note for topic, note in recording.notes.items() if topic not in recording.kinds]
    hint += "".join(f"; {note}" for note in lost[:3])
    wanted = {*needed, "p_left", "p_right"}
    wanted |= {"voltage", "current"} if "power" in needed else set()
    for name in names:
        bare, unit = split_unit(name)
        if unit and not is_unit(unit) and {*guess([bare])} & wanted:
            hint += f"; the unit of {name!r} is not known: give its factor, as in NAME[*0.01]"
            break
    if {*SPEEDS} & set(needed):
        hint += _of_speeds(recording, names, columns)
    if "t" in needed:
        number = next((n for n, values in columns.items() if counts_rows(values)), "")
        counts = f"{number!r} counts rows: if they" if number else "where rows"
        hint += (
            f"; {counts} come at a steady rate, give the time from row to row, as in "
            f"t={number or ROW}[*0.05] for 50 ms"
        )
    if "power" in needed:
        hint += _of_drawn(recording, columns) + _of_torques(names)
    raise DriveLogError(
        f"{recording.source}: nothing seems to be {' or '.join(needed)}{hint}; the columns are "
        f"{', '.join([*recording.columns, *recording.text][:30])}; say which it is with --columns "
        f"{needed[0]}=NAME"
    )


def _refuse_text(recording: Recording, needed: Sequence[str]) -> None:
    """Refuse a log where what is needed stands in a column that holds no numbers."""
    text = guess(recording.text)
    for channel in needed:
        ways = (channel,) if channel != "power" else ("power", "p_left", "current", "voltage")
        for one in (text[way] for way in ways if way in text):
            recording.column(one.field)  # says which cell is no number
    for name, cell in recording.text.items():
        if "t" in needed and re.search(r"is '\d{1,4}[-./]\d{1,2}[-./]\d{1,4}", cell):
            recording.column(name)  # says how to write instants


def _of_speeds(
    recording: Recording, names: Sequence[str], columns: Mapping[str, FloatArray]
) -> str:
    """Say what of a log may be the speeds of the sides, once it is mapped."""
    hint = "; v_left and v_right are the speeds of the left and right wheels"
    encoders = [name for name in names if ENCODER & set(words(name))]
    numbered = numbered_speeds(names)
    rates = electrical_rates(recording)
    rates += [name for name in names if "erpm" in words(name)]
    if numbered and not rates:
        first, second = numbered[:2]
        return hint + (
            f"; of {', '.join(map(repr, numbered[:4]))} nobody but you knows which side each "
            f'is: give --columns "v_left={first}[UNIT],v_right={second}[UNIT]", with UNIT such '
            "as rpm*RADIUS, rev/s*RADIUS, or ticks*METRES_PER_COUNT (ticks*1 of metres gone)"
        )
    if rates:
        return hint + (
            f"; {rates[0]!r} seems to be a motor's electrical rate: give v_left="
            f"{rates[0]}[rpm*F], with F the wheel radius over gear ratio times pole pairs, "
            "and v_right alike"
        )
    if encoders:
        return hint + (
            f"; {encoders[0]!r} seems to be an encoder's: map those of the left and of the "
            f"right wheels with the metres per count, as in v_left={encoders[0]}[ticks*0.0001] "
            "where it counts on, [ticks/sample*0.0001] where it counts from row to row, "
            "[ticks/s*0.0001] where it counts in a second"
        )
    if guess_ahead(columns) and guess_turns(columns):
        return hint + (
            "; of the body's speed V and turn rate W they are made as in v_left=V-0.25*W,"
            "v_right=V+0.25*W with half the track, though slip is then unseen"
        )
    return hint


def _of_drawn(recording: Recording, columns: Mapping[str, FloatArray]) -> str:
    """Say what of a log may be a power, once it is mapped: a counter, or a current."""
    hint = ""
    used = [
        (name, channel)
        for name, values in columns.items() if grows(values)
        for channel in ("current", "power") if _CONSUMED[channel] & set(words(name))
    ]  # fmt: skip
    if used:
        name, channel = used[0]
        hint = (
            f"; {name!r} seems to count what was used: map its rate of change by its unit, as in "
            f"{' or '.join(_counter_ways(recording, name, (channel,)))}"
        )
    amps = guess(columns).get("current")
    if amps is not None and len(amps.plus) == 1:
        return hint + (
            f"; {amps.field!r} and {amps.plus[0]!r} make powers with the battery's voltage: of two "
            f"sides, give current_left={amps.field}[UNIT],current_right={amps.plus[0]}[UNIT],"
            "voltage=NAME[UNIT]"
        )
    if amps is not None:
        return hint + (
            f"; {amps.field!r} makes a power with a voltage beside it, or the battery's usual one, "
            f"as in power={amps.written}[*25.6]"
        )
    return hint


_COUNTED = {"current": ("mAh", "Ah", "C"), "power": ("Wh", "J", "kJ")}


class DraftLimits(NamedTuple):
    """What robots draw, and how alike columns are."""

    drawn: tuple[float, float] = (0.2, 2e4)  # what robots draw in the mean, and more [W]
    voltage: float = 24.0  # a usual voltage of a robot's battery [V]
    alike: float = 0.99  # correlation from which two speeds are one
    # by how much voltages may differ to be of one bus: as much as powers do then
    one_voltage: float = 0.01


_DRAFT = DraftLimits()


def _counter_ways(recording: Recording, name: str, channels: Sequence[str]) -> list[str]:
    """Return how to map what counts charge or energy, in units in which it is a robot's."""
    found = guess(recording.columns)
    t = recording.clock(name)
    if t is None and "t" in found:
        t = recording.series(found["t"]).values
        t = t * scale_of("t", time_units(t)[0]).factor if not found["t"].unit else t
    values = recording.column(name)
    span = nan if t is None or len(t) < 2 else float(np.nanmax(t) - np.nanmin(t))
    rate = float(np.nanmax(values) - np.nanmin(values)) / span if span > 0 else nan
    ways = []
    for channel in channels:
        stated = unit_in(channel, name).unit
        volts = _DRAFT.voltage if channel == "current" else 1.0
        for unit in (stated,) if stated else _COUNTED[channel]:
            drawn = rate * scale_of(channel, unit).factor * volts
            if stated or not isfinite(drawn) or _DRAFT.drawn[0] <= drawn <= _DRAFT.drawn[1]:
                ways.append(f"{channel}={name}[{unit}]")
    return ways or [f"{channel}={name}[UNIT]" for channel in channels]


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


FULL_TURN = 6.5  # [rad]; headings beyond are unwrapped, or degrees
SPEEDS = ("v_left", "v_right")
SOME = 20_000  # readings that suffice to recognize a unit
_CHARGE = {"percentage", "percent", "soc", "pct"}  # words of how full a battery is


def size_of(recording: Recording, column: Column) -> float:
    """Return how large readings get, strays left out."""
    values = np.abs(recording.series(column).values)
    values = values[np.isfinite(values)]
    return float(np.quantile(values, 0.99)) if len(values) else 0.0


class Draft(NamedTuple):
    """Columns that serve as channels, those whose units are to be found, and what to say."""

    columns: dict[str, Column]
    free: dict[str, Column]  # by channel, as they were guessed
    notes: list[str]
    given: Mapping[str, Column] = MappingProxyType({})  # those that are named by hand
    named: tuple[str, ...] = ()  # columns whose names alone say what they are


_ELEMENT = re.compile(r"\.\d+$")  # of an array, of which some elements are named by hand


def draft(recording: Recording, known: Given) -> Draft:
    """Guess by names, and by types of messages, which series serve as which channels."""
    given = named_columns(recording, known.columns)
    columns = _of_sides(given)
    if not columns and tasks_of(recording, 1.0) is not None:
        raise DriveLogError(
            f"{recording.source}: a row is a task, not an instant of a drive: energyplan identify "
            f"{recording.source} --vehicle VEHICLE learns from their distances, turning and "
            "energies"
        )
    stock = _of_topic_map(recording, known, columns)
    if stock:
        return Draft(
            stock | columns, {}, [f"the topics are those of the topic map {known.topics!r}"], given
        )
    # A factor of a power, such as a wheel's rate, may serve for itself too.
    taken = {name for one in columns.values() for name in (one.field, *one.plus)}
    arrays = {_ELEMENT.sub("", name) for one in columns.values() for name in one.names
              if _ELEMENT.search(name)}  # fmt: skip
    taken |= {name for name in recording.columns if _ELEMENT.sub("", name) in arrays}
    speeds, there = {*SPEEDS}, [*recording.columns]
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
    stamp = None if recording.times else find_stamp(recording.columns)
    if stamp is not None and not taken & {*stamp.names}:
        found["t"] = stamp
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
    lacks = [name for name in ("t", *SPEEDS) if name not in channels]
    if not any(set(way) <= channels for way in POWER_WAYS):
        lacks.append("power")
    if lacks:
        refuse(recording, lacks)
    columns |= _as_channels(found)
    for channel in sorted({"slope", "temperature", "payload"} & {*recording.columns} - {*columns}):
        columns[channel] = Column(field=channel, channel=channel)
    notes += _of_compass(recording, columns, found)
    return Draft(columns, found, notes, given, tuple(there))


def _as_channels(found: Mapping[str, Column]) -> dict[str, Column]:
    """Return columns as channels; what takes a radius is a rate without a unit until then."""
    result = {}
    for channel, one in found.items():
        unit = one.unit
        if channel in SPEEDS and unit in (*RATES, *COUNTS):
            unit = "" if unit in RATES else f"{unit}*1"
        result[channel] = one.model_copy(update={"unit": unit}).mean()
    return result


def _of_topic_map(
    recording: Recording, known: Given, columns: Collection[str]
) -> dict[str, Column]:
    """Return the channels of the preset topic map of a bag's robot, where it holds all of them."""
    own = known.topics if recording.kinds else None
    stock = {} if own is None else held_of(recording, TOPIC_MAPS[own])
    if not ({*SPEEDS} <= {*stock} and any(set(way) <= {*stock} for way in POWER_WAYS)):
        return {}
    powers = {*POWERS, "voltage"}  # one of these that is named by hand replaces all
    stock = {c: one for c, one in stock.items() if not powers & {*columns} or c not in powers}
    if isfinite(known.wheel_radius):
        rate = f"rad/s*{known.wheel_radius:.6g}"
        stock |= {channel: stock[channel].changed(unit=rate) for channel in SPEEDS}
    return stock


def _of_sides(given: Mapping[str, Column]) -> dict[str, Column]:
    """Make the sides' powers of currents and voltages of sides that are named by hand."""
    columns = dict(given)
    for side in ("left", "right"):
        current = columns.pop(f"current_{side}", None)
        volts = columns.pop(f"voltage_{side}", columns.get("voltage"))
        if current is None or volts is None or current.plus or volts.plus:
            columns |= {} if current is None else {f"current_{side}": current}
            continue
        factor = scale_of("current", current.unit).factor * scale_of("voltage", volts.unit).factor
        columns[f"p_{side}"] = current.changed(
            channel=f"p_{side}", times=volts.field, unit="" if factor == 1.0 else f"*{factor:g}"
        )
    return columns


def _of_compass(
    recording: Recording, columns: dict[str, Column], found: dict[str, Column]
) -> list[str]:
    """Turn a pose of east and north, whose heading is that of a compass, to axes of its own."""
    if not {"x", "y", "yaw"} <= set(found) or "east" not in found["x"].field.lower():
        return []
    rows = None if recording.times else recording.series(columns["t"]).values
    series = {name: recording.series(columns[name], rows) for name in (*SPEEDS, "x", "y", "yaw")}
    period = 360.0 if size_of(recording, columns["yaw"]) > FULL_TURN else 2 * pi
    t, heading = usable(series["yaw"])
    unwrapped = Series(t, np.unwrap(heading, period=period) * (2 * pi / period))
    compass = counts_from_north(
        Recorded(series["v_left"], series["v_right"], series["x"], series["y"], unwrapped)
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
    lengths = {c: unit_in("x", one.field).unit for c, one in encoders.items()}
    ways = {_way_of_counting(recording.column(one.field)) for one in encoders.values()}
    if all(lengths.values()) and len(ways) == 1 and "" not in ways:
        return {
            c: one.changed(unit=f"{next(iter(ways))}*{scale_of('x', lengths[c]).factor:g}").mean()
            for c, one in encoders.items()
        }
    metres = 2 * pi * known.wheel_radius / known.counts_per_revolution
    largest = [np.nanmax(np.abs(recording.column(one.field))) for one in encoders.values()]
    # counts that would be no speed, and so no distance from row to row either, count on
    counted = TOTAL if metres * min(largest) > _FASTEST else ""
    if isfinite(metres) and all(one.unit or counted for one in encoders.values()):
        return {
            channel: one.changed(unit=f"{one.unit or counted}*{metres:.8g}").mean()
            for channel, one in encoders.items()
        }
    size = f"{metres / (1 + len(encoders['v_left'].plus)):.6g}" if isfinite(metres) else "0.0001"
    stated = ",".join(
        f"{channel}={one.written}[{one.unit or TOTAL}*{size}]" for channel, one in encoders.items()
    )
    how = "" if encoders["v_left"].unit else (
        f" where they count on, {SINCE} where they count from row to row, {RATE} where they count "
        "in a second"
    )  # fmt: skip
    wanted = "and how it counts is not known: give that in brackets" if isfinite(metres) else (
        "and how far a count goes is not known: give --counts-per-revolution with --wheel-radius, "
        "or the metres per count (1 if it counts metres) and, in brackets, how it counts"
    )  # fmt: skip
    raise DriveLogError(
        f"{recording.source}: {encoders['v_left'].field!r} is an encoder's, {wanted}, as in "
        f'--columns "{stated}"{how}'
    )


_FASTEST = 50.0  # beyond which no robot's treads are read to go [m/s]


def _way_of_counting(values: FloatArray) -> str:
    """Return whether a distance counts on, or from row to row; empty where that is not clear."""
    known = values[np.isfinite(values)]
    steps = np.abs(np.diff(known))
    if not np.any(steps):
        return ""
    far = float(np.ptp(known) / np.quantile(steps, 0.99))
    return TOTAL if far > 20.0 else SINCE if far < 5.0 else ""


_ELECTRIC = ("power", "p_left", "p_right", "current", "current_left", "current_right")


def _guesses(
    recording: Recording, there: Iterable[str], taken: Collection[str],
    columns: Mapping[str, Column],
) -> dict[str, Column]:  # fmt: skip
    """Guess which column is which channel; a counter of energy or charge is no power of its own."""
    names = [
        name for name in there if name not in taken and _measured(recording, name)
    ]  # fmt: skip
    counters = {name for name in names if grows(recording.columns[name][:SOME])}
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
    every = (*POWER_WAYS, ("current_left", "current_right"))
    if not any(set(way) <= {*found, *columns} for way in every):
        found |= {c: one for c, one in kept.items() if c not in columns}
        if grown and not kept:
            ways = _counter_ways(recording, grown, ("current", "power"))
            listed = " or ".join(f"--columns '{way}'" for way in ways)
            raise DriveLogError(
                f"{recording.source}: {grown!r} only ever grows or falls: it counts energy or "
                "charge, and is no power and no current; map its rate of change by its unit, which "
                f"nobody but you knows, as in {listed}"
            )
    return found


def _from_twist(
    recording: Recording, columns: dict[str, Column], found: dict[str, Column], known: Given
) -> list[str]:
    """Make tread speeds from the speed and the turn rate of the body, where a log has no others."""
    used = {name for one in columns.values() for name in one.names}
    several = guess_ahead(name for name in recording.columns if name not in used)
    alike = all(
        correlation(*recording.together(several[0], name)) > _DRAFT.alike for name in several[1:]
    )  # else these may be the speeds of sides, of which no name says so
    ahead = several[0] if several and alike else None
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
    typical = [float(np.nanmedian(recording.column(name))) for name in there]
    if max(typical) - min(typical) <= _DRAFT.one_voltage * max(map(abs, typical)):
        return power.changed(times=volts.field)
    stated = "+".join(f"{name}*{there[0]}" for name in names)
    raise DriveLogError(
        f"{recording.source}: {' and '.join(there[:4])} are voltages that differ, and not each "
        f"current of {' and '.join(names[:4])} has one of its own by name; say which belongs to "
        f"which, as in --columns '{channel}={stated}'"
    )


class HeadingTest(NamedTuple):
    """How dead reckoning and a pose are compared."""

    chance: float = 4.0  # standard errors beyond which an effect is none by chance
    windows: int = 400  # stretches that are compared, at most
    blocks: int = 20  # parts of the drive that are taken for independent of each other
    steps: int = 3  # readings of the slowest sensor in a stretch, at least


_TEST = HeadingTest()


class Recorded(NamedTuple):
    """What shows how a robot moves, each on a clock of its own."""

    left: Series  # speeds, in any unit
    right: Series
    east: Series
    north: Series
    yaw: Series  # heading [rad], unwrapped


def counts_from_north(motion: Recorded) -> bool | None:
    """Return whether a heading counts clockwise from the north; None where nothing shows it.

    The robot goes where it heads: dead reckoning by the wheels' speed and the heading, read in
    both ways, is compared with the pose over stretches of time. One of them must explain the pose
    better than the other by more than `_TEST.chance` standard errors, which hold the noise of the
    drive itself. Which side of the robot is which does not matter to this. Where the robot goes
    hardly anywhere, or along one line, the turning of the wheels decides, by the same bound.
    """
    left, right, east, north, yaw = map(usable, motion)
    if min(map(len, (left.t, right.t, east.t, north.t, yaw.t))) < _TEST.blocks:
        return None
    t = left.t
    other, angle = (align(one, t).values for one in (right, yaw))
    known = np.isfinite(other) & np.isfinite(angle)
    start = max(one.t[0] for one in (left, right, east, north, yaw))
    end = min(one.t[-1] for one in (left, right, east, north, yaw))
    step = max(float(np.median(np.diff(one.t))) for one in (left, right, east, north, yaw))
    count = int(min(_TEST.windows, (end - start) / (_TEST.steps * step)))
    if count < 2 * _TEST.blocks:
        return None
    edges = np.linspace(start, end, count + 1)
    block = np.arange(count) * _TEST.blocks // count
    lost = np.diff(np.interp(edges, t, integral(t, np.where(known, 0.0, 1.0))))
    whole = lost < 0.5 * (edges[1] - edges[0])

    def over(rate: FloatArray) -> FloatArray:
        gone = np.interp(edges, t, integral(t, np.where(known, rate, 0.0)))
        return np.asarray(np.diff(gone)[whole])

    moved = np.concatenate([np.diff(np.interp(edges, *one))[whole] for one in (east, north)])
    twice = np.tile(block[whole], 2)
    fits = []
    for speed in (left.values + other, left.values - other):  # a motor may sit in the mirror
        along, across = over(speed * np.cos(angle)), over(speed * np.sin(angle))
        ways = np.concatenate([along, across]), np.concatenate([across, along])
        fits.append(_fit(np.stack(ways, axis=1), moved, twice))
    best = min(fits, key=lambda one: one.rest)
    by_pose = best.apart(np.array([-1.0, 1.0]) * np.sign(best.values))
    if abs(by_pose) > _TEST.chance:
        return by_pose > 0.0
    rotation = np.diff(np.interp(edges, *yaw))[whole]
    treads = _fit(over(other - left.values)[:, None], rotation, block[whole])
    by_turning = treads.apart(np.ones(1))
    return by_turning < 0.0 if abs(by_turning) > _TEST.chance else None


class _LeastSquares(NamedTuple):
    values: FloatArray  # (k,): factors of the columns
    covariance: FloatArray  # (k, k): theirs, of blocks that are independent
    rest: float  # sum of the squares that are left

    def apart(self, weights: FloatArray) -> float:
        """Return how far a sum of the factors is from 0, in its standard errors."""
        error = float(np.sqrt(max(float(weights @ self.covariance @ weights), 0.0)))
        value = float(weights @ self.values)
        return value / error if error > 0.0 else 0.0


def _fit(columns: FloatArray, y: FloatArray, block: NDArray[np.intp]) -> _LeastSquares:
    """Fit columns to readings by least squares; whole blocks of readings may share an error."""
    size = columns.shape[1]
    gram = columns.T @ columns
    if not np.all(np.diag(gram) > 0.0) or np.linalg.cond(gram) > 1e10:
        return _LeastSquares(np.zeros(size), np.zeros((size, size)), float(y @ y))
    inverse = np.linalg.inv(gram)
    values = inverse @ (columns.T @ y)
    rest = y - columns @ values
    scores = np.stack([
        np.bincount(block, column * rest, _TEST.blocks) for column in columns.T
    ])  # fmt: skip
    covariance = inverse @ (scores @ scores.T) @ inverse * _TEST.blocks / (_TEST.blocks - 1)
    # Readings without any noise are exact to rounding.
    floor = (1e-12 * float(y @ y) / len(y)) * inverse
    return _LeastSquares(values, covariance + floor, float(rest @ rest))
