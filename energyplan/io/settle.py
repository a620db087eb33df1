"""Choosing among what a log's series may be, by what must hold: units, signs, and what adds up."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import product
from math import isfinite, nan
from typing import NamedTuple, NoReturn

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from energyplan.errors import DriveLogError, InvalidInputError
from energyplan.io.draft import FULL_TURN, SOME, SPEEDS, Draft, size_of
from energyplan.io.given import Given, known_measures
from energyplan.logs import DriveLog
from energyplan.logs.align import Series, find_runs
from energyplan.logs.checks import grows, mirrored_side
from energyplan.logs.clean import RECORDING, join_rows, possible, total_power
from energyplan.logs.consistency import (
    POWERS,
    Check,
    Measures,
    Observed,
    correlation,
    strain,
)
from energyplan.logs.guess import (
    electric,
    feeds,
    halves,
    of_motor,
    of_one_wheel,
    plainer,
    rank,
    reasons,
    same_reading,
    siblings,
    side_of,
    words,
)
from energyplan.logs.mapping import (
    COUNTS,
    UNITS,
    Column,
    known_unit,
    scale_of,
    time_units,
    unit_in,
)
from energyplan.logs.tables import Recording
from energyplan.path import FloatArray
from energyplan.units import RATES
from energyplan.vehicle import GRAVITY


class Plausible(NamedTuple):
    """What is plausible of a robot and of its columns."""

    alike: float = 0.9  # correlation from which two columns carry the same quantity
    # correlation through the origin of the speeds of one side's wheels, at least
    one_side: float = 0.7
    part: float = 0.05  # of a power, that another one of its kind is at least
    whole: float = 0.9  # of a part, that the whole is at least
    one_voltage: float = 0.02  # by how much voltages of one circuit differ, as a share
    close: float = 0.005  # time between rows of no log of a drive, in seconds, at most [s]
    fastest_turn: float = 3.0  # yaw rate that hardly a robot reaches that skids [rad/s]
    highest_voltage: float = 1000.0  # of a battery [V]
    force: tuple[float, float] = (0.02, 2.0)  # power over weight times speed that does not surprise
    smallest_radius: float = 2e-4  # of a wheel over its gear ratio [m]
    largest_radius: float = 0.8  # of a wheel [m]
    radius: float = 0.15  # radius of wheels of which it is not known yet [m]
    # change of speed in a row, as a share of the largest, that shows no unit
    jump: tuple[float, float] = (0.08, 0.25)
    sure: float = 0.1  # relative error of a distance up to which its unit is sure
    near: float = 1.35  # ratio of two units up to which turning does not distinguish them
    speed: tuple[float, float] = (0.1, 5.0)  # largest speed of a robot that does not surprise [m/s]
    # power over weight times speed, ten times less to ten times more of which does
    middle_force: float = 0.2


_PLAUSIBLE = Plausible()


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
            if name not in used
            and np.nanmean(np.abs(recording.columns[name])) > _PLAUSIBLE.part * own
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


class Rival(NamedTuple):
    """A column beside the one that serves, of the same quantity, and readings of both."""

    own: Column
    name: str
    sizes: tuple[float, float]  # mean sizes of the two
    alike: float  # their correlation


def _ask_for_rivals(recording: Recording, draft: Draft) -> None:
    """Ask where beside what serves a column of the same quantity differs, and nothing decides."""
    found, channels = draft.free, {*draft.columns}
    _ask_for_wheels(recording, draft)
    if {"p_left", "p_right"} <= channels:
        return
    used = {name for one in draft.columns.values() for name in one.names}
    there = [name for name in draft.named if name not in used]
    one = found.get("power" if "power" in channels else "current")
    if one is not None and one.field in draft.named:
        kind = "current" if one.channel == "current" or one.each or one.times else "power"
        rivals = [
            rival for name in there if electric(name, there) == kind and not side_of(name, there)
            if (rival := _rival(recording, one, name)) is not None and not _decided(rival)
        ]  # fmt: skip
        if rivals:
            _ask_for_the_whole(recording, draft, one, rivals, kind)
    volts = found.get("voltage")
    if volts is None or "power" in channels or volts.field not in draft.named:
        return
    packs = [
        name for name in there if electric(name, there) == "voltage" and not side_of(name, there)
        if (rival := _rival(recording, volts, name)) is not None and not _one_circuit(rival)
    ]  # fmt: skip
    if packs:
        several = [volts.field, *packs]
        usual = ", ".join(
            f"{float(np.nanmedian(recording.column(name))):.4g}" for name in several[:4]
        )
        raise DriveLogError(
            f"{recording.source}: {' and '.join(several[:4])} are several voltages beside one "
            f"current (in the middle {usual}), and nothing tells which it flows at: where they are "
            f"in series say so, as in --columns 'voltage={'+'.join(several)}', else name the one "
            f"that counts, as in --columns 'voltage={volts.field}'; "
            + _why(draft, "voltage", several[:4])
        )


def _rival(recording: Recording, own: Column, name: str) -> Rival | None:
    """Compare what serves with another column; None where that shows next to nothing."""
    one, other = recording.together(own.field, name)
    if not len(one) or not np.any(other) or grows(recording.columns[name][:SOME]):
        return None
    one = one * (1.0 + len(own.plus))  # of a sum, the others are about as large
    sizes = float(np.mean(np.abs(one))), float(np.mean(np.abs(other)))
    if sizes[1] <= _PLAUSIBLE.part * sizes[0]:
        return None
    varies = min(float(np.ptp(one)), float(np.ptp(other))) > 0.0
    return Rival(own, name, sizes, float(np.corrcoef(one, other)[0, 1]) if varies else 0.0)


def _decided(rival: Rival) -> bool:
    """Return whether names say that a rival of the whole robot's power or current is none."""
    own, other = rank(rival.own.field, rival.own.channel), rank(rival.name)
    if feeds(rival.name):  # then the battery's is not all that is drawn
        return False
    smaller = rival.sizes[0] < _PLAUSIBLE.whole * rival.sizes[1]  # as no whole is than its part
    if same_reading(rival.own.field, rival.name):
        return rival.alike > _PLAUSIBLE.alike and not smaller
    if own > other or plainer(rival.own.field, rival.name):
        return not smaller or of_motor(rival.name)
    return False


def _one_circuit(rival: Rival) -> bool:
    """Return whether a rival voltage is not that of another battery, or not the one that counts."""
    own, other = rank(rival.own.field, rival.own.channel), rank(rival.name)
    if same_reading(rival.own.field, rival.name):
        return True
    if own > other or plainer(rival.own.field, rival.name):
        return True
    alike = abs(rival.sizes[0] - rival.sizes[1]) <= _PLAUSIBLE.one_voltage * max(rival.sizes)
    return alike and not halves(rival.own.field, [rival.name])


def _ask_for_the_whole(
    recording: Recording, draft: Draft, one: Column, rivals: Sequence[Rival], kind: str
) -> NoReturn:
    """Ask which of several powers, or currents, is the whole robot's."""
    names = [rival.name for rival in rivals[:3]]
    factor = f"*{one.times}" if one.times else ""
    volts = draft.free.get("voltage")
    sided = factor or (f"*{volts.field}" if kind == "current" and volts is not None else "")
    given = "power" if factor else one.channel
    every = [one.field, *one.plus, *names]
    summed = f"({'+'.join(every)}){factor}" if factor else _sum_of(every, kind)
    which = " or ".join(f"--columns '{given}={name}{factor}'" for name in names)
    if source := [name for name in names if feeds(name)]:
        loads = [name for name in every if name not in source and not rank(name)]
        added = "+".join(name for name in every if name not in loads)
        text = f"{loads[0]}{factor}" if loads else f"({added}){factor}" if factor else added
        how = (
            f"{' and '.join(source)} feeds the robot too, so that no battery's {kind} is all that "
            f"it draws: name what it draws, as in --columns '{given}={text}'"
        )
    else:
        how = (
            "where they are those of two sides say so, as in --columns "
            f"'p_left={one.field}{sided},p_right={names[0]}{sided}', where they add up, as those "
            f"of two batteries do, as in --columns '{given}={summed}', else name the whole, as in "
            f"--columns '{given}={one.written}' or {which}"
        )
    raise DriveLogError(
        f"{recording.source}: {' and '.join((one.field, *names))} could each be the {kind} of the "
        f"whole robot, and differ; {how}; {_why(draft, kind, (one.field, *names))}"
    )


def _sum_of(names: Sequence[str], kind: str) -> str:
    """Write a sum of powers or currents, each with its factor where their units differ."""
    sizes = [scale_of(kind, unit_in(kind, name).unit).factor for name in names]
    if len({*sizes}) == 1:
        return "+".join(names)
    unit = next(iter(UNITS[kind]))
    terms = (f"{size:g}*{name}" for size, name in zip(sizes, names, strict=True))
    return f"{'+'.join(terms)}[{unit}]"


def _why(draft: Draft, channel: str, names: Iterable[str]) -> str:
    """Say why names may serve as a channel."""
    return f"why as {channel}: {reasons(channel, names, draft.named)}"


def _ask_for_wheels(recording: Recording, draft: Draft) -> None:
    """Ask where the powers of the sides count another number of wheels each, or one of several."""
    left, right = (draft.columns.get(f"p_{side}") for side in ("left", "right"))
    if left is None or right is None or not {left.field, right.field} <= {*draft.named}:
        return
    if {"p_left", "p_right"} & {*draft.given}:
        return
    if len(left.plus) != len(right.plus):
        less, more = sorted((left, right), key=lambda one: len(one.plus))
        raise DriveLogError(
            f"{recording.source}: {more.channel} counts {' and '.join((more.field, *more.plus))}, "
            f"and {less.channel} {' and '.join((less.field, *less.plus))} alone: a wheel's is "
            f"missing; log it, or the battery's, or say that the missing one draws as much, as in "
            f"--columns '{more.channel}={more.written},"
            f"{less.channel}={_times(less, (1 + len(more.plus)) / (1 + len(less.plus)))}'"
        )
    of_one = [one for one in (left, right) if not one.plus and of_one_wheel(one.field)]
    if len(of_one) == 2 and not any(
        of_one_wheel(one.field) for c, one in draft.columns.items() if c in SPEEDS
    ):
        stated = ",".join(f"{one.channel}={_times(one, 2)}" for one in (left, right))
        alone = ",".join(f"{one.channel}={one.written}" for one in (left, right))
        raise DriveLogError(
            f"{recording.source}: {left.field} and {right.field} are of one wheel a side by their "
            "names, and no other's is there: log the others', or the battery's, or say that they "
            f"draw as much, as in --columns '{stated}', or that no other wheel is driven, as in "
            f"--columns '{alone}'"
        )


def _times(one: Column, factor: float) -> str:
    """Write a power of some wheels as that of more of them."""
    names = (one.field, *one.plus)
    each = one.each or ((one.times or "",) * len(names))
    return "+".join(
        f"{factor:g}*{name}{'*' + other if other else ''}"
        for name, other in zip(names, each, strict=True)
    )


def _refuse_unlike(recording: Recording, found: Mapping[str, Column]) -> None:
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
            if alike < _PLAUSIBLE.one_side:
                way = "go opposite ways" if alike < -_PLAUSIBLE.one_side else "do not go alike"
                raise DriveLogError(
                    f"{recording.source}: {one.field} and {name} seem to be speeds of the same "
                    f"side, and {way} (correlation {alike:.2f}): one is dead or counts the other "
                    "way, or they are of two robots; name those that are right, the power among "
                    f"them, as in --columns '{channel}={one.field}'"
                )


_TURNS = 3 * FULL_TURN  # beyond, they are rather degrees
_VOLTS = {"mV": (4.5, 450.0), "*0.01": (4.5, 100.0), "*0.1": (4.5, 100.0)}  # typical ranges [V]
_NEEDED = {"t", "v_left", "v_right", "p_left", "p_right", "power", "voltage", "current"}
_ROLLING = {**RATES, **COUNTS}  # units of wheels, that take a radius


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
        if not one.unit and not (one.field == channel and channel in (*SPEEDS, "x", "y"))
    }  # fmt: skip
    size = {c: size_of(recording, columns[c]) for c in ("yaw_rate", "yaw", "voltage") if c in free}
    rates = [found[name].unit for name in SPEEDS if name in found and found[name].unit in _ROLLING]
    wheels = ("rad/s*", "rpm*", "rev/s*", "deg/s*") if isfinite(known.wheel_radius) else ()
    result = []
    if rates:
        result.append(_Choice(SPEEDS, (f"{rates[0]}*",)))
    elif {*SPEEDS} <= free:
        result.append(_Choice(SPEEDS, ("m/s", *wheels, "km/h", "mm/s", "cm/s")))
    if size.get("yaw_rate", 0.0) > _PLAUSIBLE.fastest_turn:
        result.append(_Choice(("yaw_rate",), ("rad/s", "deg/s")))
    if size.get("yaw", 0.0) > FULL_TURN:  # else these are no degrees
        result.append(_Choice(("yaw",), ("deg", "rad") if size["yaw"] > _TURNS else ("rad", "deg")))
    if size.get("voltage", 0.0) > _PLAUSIBLE.highest_voltage:
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
    recording: Recording, draft: Draft, known: Given
) -> tuple[dict[str, Column], dict[str, str]]:
    """Choose the units that are not given so that all that a log holds twice agrees."""
    columns, found = draft.columns, draft.free
    name, whole = columns["v_left"].field, recording
    recording = whole.head(name, SOME)
    if not recording.times and not columns["t"].unit:  # in which a drive log's step is typical
        unit = _unit_of_time(recording, columns)
        columns = {**columns, "t": columns["t"].changed(unit=unit)}
    t = recording.clock(name) if recording.times else recording.series(columns["t"]).values
    if t is not None and np.median(np.diff(t)) < _PLAUSIBLE.close:
        recording = whole.head(name, 4 * SOME)
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
        radius = nan if agreed is None else _radius_of(agreed.distance / _PLAUSIBLE.radius)
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
    for one in (recording.column(columns[name].field) for name in SPEEDS):
        lasting = np.median(sliding_window_view(one[np.isfinite(one)], 5), axis=-1)
        steps, size = (np.quantile(np.abs(part), 0.99) for part in (np.diff(lasting), lasting))
        jumps.append(float(steps / max(size, 1e-300)))
    jump = max(jumps)
    if _PLAUSIBLE.jump[0] < jump < _PLAUSIBLE.jump[1]:
        why = "could count seconds or milliseconds: the speeds change too little to tell"
        _ask_unit(recording, columns["t"], why, ("s", "ms"))
    return "s" if jump >= _PLAUSIBLE.jump[1] else units[-1]


def _ask_unit(recording: Recording, column: Column, why: str, units: Iterable[str]) -> NoReturn:
    """Refuse to guess a unit, and say how to give it."""
    ways = " or ".join(f"--columns '{column.channel}={column.field}[{unit}]'" for unit in units)
    raise DriveLogError(
        f"{recording.source}: {column.field} {why}; give its unit with --columns, and those of "
        f"others that may have the same fault{f', as in {ways}' if ways else ''}; why as "
        f"{column.channel}: {reasons(column.channel, [column.field], recording.columns)}"
    )


def _unit_of_voltage(recording: Recording, column: Column) -> str:
    """Return the unit of a voltage that is none in volts, where it can be one alone."""
    size = size_of(recording, column)
    volts = {u: size * scale_of("voltage", u).factor for u in _VOLTS}
    could = [u for u, (low, high) in _VOLTS.items() if low <= volts[u] <= high]
    if could != ["mV"]:
        result = (
            f", but {' or '.join(f'{volts[u]:.3g} V in [{u}]' for u in could)}" if could else ""
        )
        why = f"is up to {size:.6g}, which is no voltage of a robot in V{result}"
        _ask_unit(recording, column, why, could)
    return "mV"


_TURN_UNITS = ("rad/s", "deg/s", "rpm", "mrad/s", "cdeg/s", "mdps")
_OF_RATES = {"motor", "motors", "omega", "rotor", "rotation", "angvel"}
"""Words of what may be a rate in radians or turns as well as a speed."""


def _sure_of_speeds(
    recording: Recording, columns: Mapping[str, Column], units: Sequence[str],
    chosen: Mapping[str, str], drive: Observed, known: Given,
) -> None:  # fmt: skip
    """Ask for a unit of speeds where another one is as likely, by pose and turning, if they are."""
    way = abs(np.log(drive.distance)) if isfinite(drive.distance) else np.log(_PLAUSIBLE.near)
    if len(units) < 2 or way < _PLAUSIBLE.sure:
        return
    size = {unit: _factor("v_left", unit, known) / _factor("v_left", chosen["v_left"], known)
            for unit in units}  # fmt: skip
    gone = drive.distance if isfinite(drive.distance) else 1.0
    near = [u for u in units if abs(np.log(gone * size[u])) < np.log(_PLAUSIBLE.near)]
    unseen = False
    if chosen.get("yaw_rate") and not isfinite(drive.distance):  # both may be in another unit
        own = scale_of("yaw_rate", chosen["yaw_rate"]).factor
        turns = [scale_of("yaw_rate", unit).factor / own for unit in _TURN_UNITS]
        near += [
            u for u in units if u not in near
            and any(abs(np.log(size[u] / turn)) < np.log(_PLAUSIBLE.near) for turn in turns)
            and _PLAUSIBLE.speed[0] <= drive.top_speed * size[u] <= _PLAUSIBLE.speed[1]
        ]  # fmt: skip
    measures = known_measures(known)
    if not isfinite(drive.distance) and not (
        isfinite(drive.slip_track) and isfinite(measures.track)
    ):
        joined = recording.times and not recording.kinds  # names begin with the file's
        name = columns["v_left"].field.partition(".")[2 if joined else 0]
        named = {*words(name)} & _OF_RATES
        if chosen["v_left"] == "m/s" and not named:
            return
        weight = measures.mass * GRAVITY
        near = [
            u for u in units
            if _PLAUSIBLE.speed[0] <= drive.top_speed * size[u] <= _PLAUSIBLE.speed[1]
            and not abs(np.log(drive.force / weight / size[u] / _PLAUSIBLE.middle_force))
            > np.log(10.0)
        ]  # fmt: skip
        if chosen["v_left"] != "m/s":  # that others would surprise more is no proof
            near = [*dict.fromkeys((chosen["v_left"], *near))]
            unseen = True
    if len(near) > 1 or unseen:
        told = [f"{u}{known.wheel_radius:.4g}" if u.endswith("*") else u for u in near]
        left, right = (columns[name].field for name in SPEEDS)
        ways = " or ".join(f"'v_left={left}[{u}],v_right={right}[{u}]'" for u in told)
        other = ", or in another unit" if unseen else ""
        raise DriveLogError(
            f"{recording.source}: {left} could be in {' or '.join(told)}, of which nothing tells "
            f"the one from the other{other}; give its unit, as in --columns {ways}; why as v_left "
            f"and v_right: {reasons('v_left', [left], recording.columns)}, "
            f"{reasons('v_right', [right], recording.columns)}"
        )


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
        usual = any(_PLAUSIBLE.force[0] <= size <= _PLAUSIBLE.force[1] for size in sizes.values())
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


def _factor(channel: str, unit: str, known: Given) -> float:
    if not unit:
        return 1.0
    if unit.endswith("*"):
        radius = known.wheel_radius if isfinite(known.wheel_radius) else _PLAUSIBLE.radius
        return _ROLLING[unit[:-1]] * radius
    return scale_of(channel, unit).factor


def _radius_of(angle: float) -> float:
    """Return the radius at which wheels, or motors before their gear, roll so far in a metre."""
    return (
        1.0 / angle
        if 1.0 / _PLAUSIBLE.largest_radius <= angle <= 1.0 / _PLAUSIBLE.smallest_radius
        else nan
    )


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


def named_in(remedy: str, columns: Mapping[str, Column]) -> str:
    """Name the columns that a remedy is about; a unit that is the mapped one is no remedy."""

    def named(stated: re.Match[str]) -> str:
        channel, unit = stated.groups()
        one = columns.get(channel)
        if one is None:
            return stated[0]
        if one.unit and unit[0] != "-":
            bare = one.unit.partition("*")[0]
            same = known_unit(channel, unit) == known_unit(channel, bare)
            return f"{channel}={one.written}[{f'{bare}*FACTOR' if same else unit}]"
        return f"{channel}={one.written}[{one.negative().unit if unit[0] == '-' else unit}]"

    return re.sub(r"(\w+)=NAME\[([^]]+)\]", named, remedy)


class _Signed(NamedTuple):
    """A log, the columns it was read by, and notes on the signs that were changed."""

    log: DriveLog
    columns: dict[str, Column]
    notes: tuple[str, ...]


def _turned_round(recording: Recording, columns: Mapping[str, Column]) -> _Signed:
    """Build a log, and turn round what counts the other way."""
    notes: list[str] = []
    result, done = dict(columns), set[str]()
    while True:
        try:
            log = DriveLog.of(recording, result, refuse=False)
        except DriveLogError as error:
            raise DriveLogError(named_in(str(error), result)) from None
        wrong = next((one for one in log.checks if one.refuses == "reading"), None)
        if wrong is None:
            side = mirrored_side(log.observed)
            turned: tuple[str, ...] = (side,) if side and side not in done else ()
        else:
            turned = tuple(name for name in wrong.turned if name in result)
            if not turned or done & set(turned):
                raise DriveLogError(named_in(f"{log.name}: {wrong}", result))
        if not turned:
            return _Signed(log, result, tuple(notes))
        result |= {name: result[name].negative() for name in turned}
        done |= set(turned)
        notes.append(f"{' and '.join(turned)} had the opposite sign, which was corrected")


class Settled(NamedTuple):
    """A log, the columns that it is read by, what was assumed for that, and what to say of it."""

    log: DriveLog
    columns: dict[str, Column]
    assumed: dict[str, str]
    checks: tuple[Check, ...]
    notes: tuple[str, ...]


def _ask_for_given(recording: Recording, draft: Draft, known: Given) -> None:
    """Ask about what is mapped by hand against what its name says, or as a sum that is a mean."""
    for channel, one in draft.given.items():
        bare = one.unit.lstrip("-").partition("*")[0]
        stated = unit_in(channel, one.field).unit.partition("*")[0]
        named = known_unit(channel, bare) or ""
        if (
            stated
            and named
            and not one.weights  # which may be factors of units
            and abs(np.log(_size_of(channel, named) / _size_of(channel, stated))) > 0.01
        ):
            size = one.conversion.factor / _size_of(channel, stated)
            raise DriveLogError(
                f"{recording.source}: the name of {one.field} says [{stated}], and it is mapped as "
                f"[{one.unit}]: map it in [{stated}], or, if its name is wrong, by a factor, as in "
                f"--columns '{channel}={one.field}[{stated}*{size:.6g}]'"
            )
        if channel in SPEEDS and one.plus and not one.weights and _one_speed(recording, one):
            count = 1 + len(one.plus)
            size = one.conversion.factor / _size_of(channel, named)
            if isfinite(known.wheel_radius) and named in _ROLLING:
                added = size > (0.5 + 0.5 / count) * known.wheel_radius
            else:
                added = size > 0.75 or (named in _ROLLING and not isfinite(known.wheel_radius))
            if added:
                mean = ",".join(
                    f"{c}={'+'.join(f'{1 / count:.4g}*{name}' for name in (it.field, *it.plus))}"
                    f"[{it.unit or 'm/s'}]"
                    for c, it in draft.given.items()
                    if c in SPEEDS and it.plus and not it.weights
                )
                raise DriveLogError(
                    f"{recording.source}: {channel} is mapped as the sum of "
                    f"{' and '.join((one.field, *one.plus))}, which are each a speed of that side: "
                    f"write their mean, as in --columns '{mean}'"
                )


def _size_of(channel: str, unit: str) -> float:
    """Return the factor of a unit; of a wheel's rate, without its radius."""
    return scale_of(channel, f"{unit}*1" if unit in _ROLLING else unit).factor if unit else 1.0


def _one_speed(recording: Recording, one: Column) -> bool:
    """Return whether columns that are added each show about the same speed."""
    for name in one.plus:
        first, second = recording.together(one.field, name)
        size = float(np.linalg.norm(second)) / max(float(np.linalg.norm(first)), 1e-300)
        if correlation(first, second) < _PLAUSIBLE.one_side or not 0.6 < size < 1.6:
            return False
    return True


def settle(recording: Recording, draft: Draft, known: Given) -> Settled:
    """Choose units and signs by what must hold; where nothing decides, ask."""
    _ask_for_given(recording, draft, known)
    _ask_for_rivals(recording, draft)
    _refuse_unlike(recording, draft.free)
    columns, assumed = _with_units(recording, draft, known)
    log, columns, turned = _turned_round(recording, columns)
    if known.unsigned:
        columns = {c: one.changed(unsigned=c in POWERS) for c, one in columns.items()}
        log = replace(log, signed=False)
    return Settled(log, columns, assumed, tuple(_left_out(recording, columns)), turned)
