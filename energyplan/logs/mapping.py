"""Which column of a file is which channel: units as people write them, formulas, counters."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Mapping, Sequence
from functools import lru_cache
from itertools import pairwise
from math import isfinite, prod
from typing import Any, NamedTuple
from unicodedata import combining, normalize

import numpy as np
from numpy.typing import NDArray
from pydantic import AliasChoices, ConfigDict, Field, model_validator

from energyplan.errors import DriveLogError
from energyplan.logs.align import derivative, gap_limit
from energyplan.motion import LOGGED
from energyplan.path import FloatArray
from energyplan.records import Checked, described
from energyplan.units import (
    ANGLE,
    CHARGE,
    CURRENT,
    ENERGY,
    LENGTH,
    MASS,
    OFFSETS,
    POWER,
    RATES,
    SPEED,
    TEMPERATURE,
    TIME,
    VOLTAGE,
    standard,
)  # fmt: skip

ROW = "row"
"""Stands for the number of a row in a mapping: the time, of rows that come at a steady rate."""


class Scale(NamedTuple):
    """SI value = factor times reading, plus offset."""

    factor: float = 1.0
    offset: float = 0.0


COUNTS = {"ticks": 1.0, "ticks/sample": 1.0, "ticks/s": 1.0}
_POWER = {**POWER, **ENERGY}  # the rate of an energy is a power

_OTHERS = {
    "s": TIME, "m": LENGTH, "m/s": SPEED, "W": _POWER, "V": VOLTAGE, "A": {**CURRENT, **CHARGE},
    "rad": ANGLE, "rad/s": RATES, "m/s^2": {"m/s^2": 1.0, "g": 9.80665}, "degC": TEMPERATURE,
    "kg": MASS,
}  # fmt: skip
"""Units that a channel may be read in, by that of the library."""

UNITS = {name: _OTHERS.get(one.unit, {one.unit: 1.0}) for name, one in LOGGED.items()}
"""Units by channel; the first is the one of the library."""
_WHEEL_CHANNELS = ("v_left", "v_right", "cmd_left", "cmd_right")
_OF_WHEELS = {**RATES, **COUNTS}


def known_unit(channel: str, unit: str) -> str | None:
    """Return a channel's unit by its standard spelling; None where the channel has no such unit."""
    wheels = _OF_WHEELS if channel in _WHEEL_CHANNELS else {}
    return standard(unit, {**UNITS.get(channel, {}), **wheels})


@lru_cache(maxsize=512)
def scale_of(channel: str, unit: str) -> Scale:
    """Return the conversion from a unit."""
    if not unit:
        return Scale()
    sign = -1.0 if unit.startswith("-") else 1.0
    bare = unit.lstrip("-").strip()
    name, star, number = bare.rpartition("*")
    factor = 1.0
    if star:
        bare = name.strip()
        try:
            factor = float(number)
        except ValueError:
            factor = float("nan")
        if not isfinite(factor) or factor == 0:
            raise DriveLogError(f"{channel}: [{unit}] is no factor; write one such as [*0.165]")
    if not bare:
        return Scale(sign * factor)
    known = UNITS.get(channel)
    if known is None:
        raise DriveLogError(
            f"{channel}: the unit of a channel of your own is yours; leave [{unit}] out, or give a "
            "factor such as [*0.001]"
        )
    spelt = known_unit(channel, bare)
    if spelt is None:
        rates = (
            ", wheel rates such as rpm with the wheel radius, as in [rpm*0.165], encoder counts "
            "with the metres per count, as in [ticks*0.0001]"
        )
        raise DriveLogError(
            f"{channel} cannot be in [{unit}]; it can be in {', '.join(known)}"
            f"{rates if channel in _WHEEL_CHANNELS else ''}, with a minus "
            "before it where the sign is opposite, or give a factor such as [*0.001]"
        )
    if spelt not in known:
        if not star and spelt in COUNTS:
            raise DriveLogError(
                f"{channel} in [{unit}] is an encoder's count; give the metres per count with it, "
                f"as in {channel}=NAME[{spelt}*0.0001] for 0.1 mm"
            )
        if not star:
            raise DriveLogError(
                f"{channel} in [{unit}] is a wheel's rate; give the wheel radius with it, as in "
                f"{channel}=NAME[{spelt}*0.165] for 0.165 m"
            )
        return Scale(sign * factor * _OF_WHEELS[spelt])
    return Scale(sign * factor * known[spelt], OFFSETS.get(spelt, 0.0))


_BRACKETED = re.compile(r"(.*\S)\s*[\[(]\s*([^\[\]()]*?)\s*[\])]")


def split_unit(name: str) -> tuple[str, str]:
    """Split a column's name from the unit in brackets at its end; empty where there is none."""
    match = _BRACKETED.fullmatch(name.strip())
    # The heading of an orientation is written yaw(NAME), as of a bag's messages.
    of_orientation = name.startswith("yaw(")
    return (match[1], match[2]) if match and not of_orientation else (name.strip(), "")


_SCALED = re.compile(r"(.*[^\W\d])[\W_]+(10+|0\.0*1)([A-Za-z/]+)")
"""A name that ends with the size of its steps, such as ``current_10mA``."""
_SIZED = re.compile(r"[x*]?\s*(\d*\.?\d+)\s*[x*]?\s*([^\W\d].*?)(?:/(?:bit|lsb|digit|count))?")
"""The same in brackets, such as ``0.1 A`` or ``0.05 V/bit``."""
_ANYWHERE = {
    "ms", "us", "ns", "kmh", "kph", "mps", "mph", "rpm", "dps", "radps", "rads", "deg", "degrees",
    "kw", "mv", "ma", "mm", "cm", "hp", "ips", "wh", "kwh", "mwh", "ah", "mah", "mdps", "cdeg",
    "mrad", "kj", "coulomb", "coulombs", "joule", "joules", "amphours", "watthours", "milliamps",
    "millivolts", "milliwatts",
}  # fmt: skip
"""Words that are units wherever in a name they stand; others are only at its end."""


_CAPITALS = re.compile("[kmcdnuM\u00b5](?:[VAWJC]h?|As|Ws)|deg[CF]")
"""Units that hold a capital after a small letter."""


def split_words(name: str) -> list[str]:
    """Split a name at signs, and where small letters turn to capitals."""
    found: list[str] = []
    plain = "".join(one for one in normalize("NFD", name) if not combining(one))
    for part in re.split(r"[^A-Za-z0-9\u00b0\u00b5^]+", plain):
        if _CAPITALS.fullmatch(part):
            found.append(part)
            continue
        spaced = re.sub(r"([a-z0-9])([A-Z])", r"\1 \2", part)
        found += re.sub(r"([A-Z]+)([A-Z][a-z])", r"\1 \2", spaced).split()
    alone = found[1:] and found[-1] == "data"  # as messages call it that hold one number alone
    return found[:-1] if alone else found


class NamedUnit(NamedTuple):
    """A name without its unit, and the unit in its standard spelling; empty where it has none."""

    bare: str
    unit: str = ""


@lru_cache(maxsize=4096)
def unit_in(channel: str, name: str) -> NamedUnit:
    """Return the unit that a column's name gives, if the channel can be in it."""
    bare, stated = split_unit(name)
    if stated:
        sized = _SIZED.fullmatch(stated)
        known = known_unit(channel, sized[2] if sized else stated) or ""
        if sized and known:
            return NamedUnit(bare, "" if known in _OF_WHEELS else f"{known}*{sized[1]}")
        return NamedUnit(bare, known)
    scaled = _SCALED.fullmatch(bare)
    spelt = known_unit(channel, scaled[3]) if scaled else None
    if scaled and spelt is not None and spelt not in _OF_WHEELS:
        return NamedUnit(scaled[1], f"{spelt}*{scaled[2]}")
    words = split_words(name)
    for count in (3, 2, 1):
        tail = [word for word in words[-count:] if word.lower() != "per"]
        if len(words) < count + (count == 1) or (count > 1 and len(tail) != 2):
            continue
        if [word.lower() for word in words[-2:-1]] == ["of"]:  # as in the time of day
            continue
        spelt = known_unit(channel, "/".join(tail))
        if spelt is not None:
            return NamedUnit("_".join(words[:-count]), spelt)
    for k, word in enumerate(words):
        spelt = known_unit(channel, word) if word.lower() in _ANYWHERE else None
        if spelt is not None:
            return NamedUnit("_".join(words[:k] + words[k + 1 :]), spelt)
    return NamedUnit(name)


class ClockLimits(NamedTuple):
    """What a clock's readings show of its unit."""

    # days after which spreadsheets' dates begin, at least: such a clock may count days
    date: float = 1e4
    epoch: tuple[float, float] = (5e8, 4e9)  # seconds since 1970 of recordings
    rare: float = 2.5  # time from row to row that is rare in a drive's log [s]


_CLOCK = ClockLimits()


SHORTEST_STEP, LONGEST_STEP = 2e-5, 20.0  # that which is possible [s]


def dated(times: FloatArray) -> bool:
    """Return whether times in seconds are those of a calendar."""
    return bool(_CLOCK.epoch[0] <= np.nanmedian(times) <= _CLOCK.epoch[1])


def time_units(times: FloatArray) -> tuple[str, ...]:
    """Return the units in which times may be, the likeliest first; empty ones are seconds."""
    steps = np.diff(times)
    steps = steps[np.isfinite(steps) & (steps > 0)]
    if not len(steps):
        return ("",)
    step = float(np.median(steps))
    sizes = {"": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
    for name, size in sizes.items():  # gaps between rows of a calendar's time may be long
        if dated(size * times) and step * size <= 3600.0:
            return (name,)
    if np.nanmedian(times) > _CLOCK.date:
        sizes |= {"d": 86400.0}
    typical = tuple(name for name, size in sizes.items() if 5e-4 <= step * size <= _CLOCK.rare)[:1]
    return ("", *typical) if _CLOCK.rare < step <= LONGEST_STEP else typical or ("",)


def is_unit(text: str) -> bool:
    """Return whether a text is a unit of any channel."""
    bare = text.strip().strip("[]()").strip()
    return any(known_unit(channel, bare) is not None for channel in UNITS)


# -- counters----------------------------------------------------------------------

TOTAL, SINCE, RATE = "ticks", "ticks/sample", "ticks/s"
"""How an encoder counts: on and on, since the row before, or in a second."""
CONSUMED = "consumed"
"""How a counter of energy or charge counts: on and on, in steps that may be seldom."""


class CounterSizes(NamedTuple):
    """When a counter runs over, or is set back."""

    sizes: tuple[int, int, int] = (8, 16, 32)  # bits of counters that run over
    jump: float = 10.0  # times the fastest counting, from which on a counter was set back


_COUNTER = CounterSizes()


def counting(channel: str, unit: str) -> str:
    """Return how a unit counts: `TOTAL`, `SINCE`, `CONSUMED`; empty where a factor suffices."""
    bare = known_unit(channel, unit.lstrip("-").partition("*")[0]) or ""
    return CONSUMED if bare in {**ENERGY, **CHARGE} else bare if bare in (TOTAL, SINCE) else ""


def count_rate(t: FloatArray, counts: FloatArray, unit: str) -> FloatArray:
    """Return how fast an encoder, or a counter of energy or charge, counts."""
    rate = np.full(len(t), np.nan)
    rows = np.flatnonzero(np.isfinite(t) & np.isfinite(counts))
    if not len(rows):
        return rate
    if len(rows) > 1 and np.mean(np.diff(t[rows]) < 0) > 0.5:  # newest first
        rows = rows[::-1]
    known = counts[rows]
    total = np.cumsum(known) if unit == SINCE else _unrolled(known)
    time = t[rows]
    if unit == CONSUMED:  # between two steps of a coarse counter the rate is their mean
        steps = np.flatnonzero(np.diff(total, prepend=np.nan) != 0.0)
        total = np.interp(time, time[steps], total[steps]) if np.all(np.diff(time) >= 0) else total
    # Rows of one time are one reading, the last of them.
    last = np.append(time[1:] != time[:-1], True)
    rate[rows] = _slopes(time[last], total[last])[np.cumsum(np.append(0, last[:-1]))]
    return rate


def _unrolled(counts: FloatArray) -> FloatArray:
    """Count on where a counter ran over."""
    steps = np.abs(np.diff(counts))
    low, high = float(np.min(counts)), float(np.max(counts))
    for bits in _COUNTER.sizes:
        whole = 2.0**bits
        inside = (low >= 0 and high < whole) or (low >= -whole / 2 and high < whole / 2)
        if inside:
            over = steps > 0.75 * whole
            return np.unwrap(counts, period=whole) if over.any() else counts
    return counts


def _slopes(t: FloatArray, total: FloatArray) -> FloatArray:
    """Differentiate between the places where time or the counter breaks off."""
    if len(t) < 2:
        return np.zeros(len(t))
    step, count = np.diff(t), np.abs(np.diff(total))
    forward = step > 0
    if not forward.any():
        return np.zeros(len(t))
    speed = np.divide(count, step, out=np.zeros(len(step)), where=forward)
    counted = speed[speed > 0]
    fastest = float(np.quantile(counted, 0.9)) if len(counted) else 0.0
    broken: NDArray[np.bool_] = ~forward | (step > gap_limit(t)) | (speed > _COUNTER.jump * fastest)
    edges = [0, *(np.flatnonzero(broken) + 1).tolist(), len(t)]
    return derivative(t, total, [slice(a, b) for a, b in pairwise(edges)], 0.0)


# -- columns ----------------------------------------------------------------------


class Column(Checked):
    """A column of a table, or a field of a bag's messages, that serves as a channel."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    topic: str = ""  # of a bag; empty for a column of a table
    field: str = Field(validation_alias=AliasChoices("field", "column"))  # name of the column
    unit: str = ""  # as it was written
    times: str | None = None  # a further column to multiply by, as a voltage by a current
    plus: tuple[str, ...] = ()  # columns to add, before that
    weights: tuple[float, ...] = ()  # factors of the field and of those; none: all are one
    unsigned: bool = False  # whether it is a power, or a current, whose sensor sees no sign
    each: tuple[str, ...] = ()  # columns to multiply the field and those by, empty for none
    channel: str = ""  # the channel that it serves as

    @model_validator(mode="before")
    @classmethod
    def _scaled(cls, value: Any) -> Any:
        """Take the factor of a topic map for a unit."""
        if not isinstance(value, dict) or "scale" not in value:
            return value
        scale = value["scale"]
        if isinstance(scale, bool) or not isinstance(scale, int | float) or not isfinite(scale):
            raise ValueError(f"scale should be a number, not {scale!r}")
        rest = {key: part for key, part in value.items() if key != "scale"}
        return {**rest, "unit": f"*{scale!r}"}

    @model_validator(mode="after")
    def _weighed(self) -> Column:
        if self.weights and len(self.weights) != 1 + len(self.plus):
            raise ValueError(
                f"{len(self.weights)} weights of {1 + len(self.plus)} columns; give one for each"
            )
        if self.each and (len(self.each) != 1 + len(self.plus) or self.times is not None):
            raise ValueError(
                f"{len(self.each)} columns to multiply {1 + len(self.plus)} by; give one for each, "
                "and no other for the sum"
            )
        return self

    @property
    def conversion(self) -> Scale:
        """Conversion to the library's unit."""
        return scale_of(self.channel, self.unit)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all the columns."""
        factors = self.each if self.times is None else (self.times,)
        return tuple(dict.fromkeys((self.field, *self.plus, *filter(None, factors))))

    @property
    def written(self) -> str:
        """What is computed of the columns, before the conversion."""
        text = ""
        for weight, name, other in self._terms():
            factor = "" if abs(weight) == 1.0 else f"{abs(weight):.10g}*"
            text += f" {'-' if weight < 0 else '+'} {factor}{name}{other and '*'}{other}"
        added = text.removeprefix(" + ").strip()
        if self.times is None:
            return added
        return f"({added}) * {self.times}" if self.plus else f"{added} * {self.times}"

    def _terms(self) -> list[tuple[float, str, str]]:
        """Return factor, column and the column that it is multiplied by, if any, of each term."""
        names = (self.field, *self.plus)
        some = len(names)
        return list(zip(self.weights or (1.0,) * some, names, self.each or ("",) * some,
                        strict=True))  # fmt: skip

    def value(self, reading: Callable[[str], Any], rate: Callable[[str], Any] | None = None) -> Any:
        """Return the channel in the library's unit from the readings, or rates, of columns."""
        added = rate or reading
        parts = [
            (added(name) if weight == 1.0 else weight * added(name))
            * (reading(other) if other else 1.0)
            for weight, name, other in self._terms()
        ]
        value = sum(parts[1:], start=parts[0])
        if self.times is not None:
            value = value * reading(self.times)
        scale = self.conversion
        return value * scale.factor + scale.offset

    @property
    def counts(self) -> str:
        """How the column counts; empty where its readings are the channel's, but for a factor."""
        return counting(self.channel, self.unit)

    def joined(self) -> Column:
        """Return a field of messages as a recording names it, ``/topic.field``."""
        if not self.topic:
            return self

        def full(name: str) -> str:
            return name if name.startswith("/") else f"/{self.topic.strip('/')}.{name}"

        return self.renamed(full, topic="")

    def renamed(self, new: Callable[[str], str], **parts: Any) -> Column:
        """Return the same of columns with other names."""
        return self.changed(
            field=new(self.field), plus=tuple(map(new, self.plus)),
            each=tuple(name and new(name) for name in self.each),
            times=None if self.times is None else new(self.times), **parts,
        )  # fmt: skip

    def matches(self, topic: str) -> bool:
        """Return whether a bag's topic is meant."""
        wanted = self.topic.strip("/")
        return topic.strip("/") == wanted or topic.endswith(f"/{wanted}")

    def described(self) -> dict[str, Any]:
        """Return the column as a project's file, or a topic map, holds it."""
        said: dict[str, Any]
        if self.topic:
            said = {"topic": self.topic, "field": self.written if self.plus else self.field}
        else:
            said = {"column": self.field, "plus": [*self.plus], "weights": [*self.weights],
                    "each": [*self.each]}  # fmt: skip
        said |= {"unit": self.unit, "times": self.times, "unsigned": self.unsigned}
        return {key: value for key, value in said.items() if value}

    def changed(self, **parts: Any) -> Column:
        """Return the column with other parts; its unit is checked."""
        result = self.model_copy(update=parts)
        _ = result.conversion
        return result

    def mean(self) -> Column:
        """Return a column whose speeds of a side's wheels are averaged, not summed."""
        if not self.plus or self.weights or not self.channel.startswith("v_"):
            return self.changed()
        bare, _, factor = self.unit.rpartition("*") if "*" in self.unit else (self.unit, "", "1")
        return self.changed(unit=f"{bare}*{float(factor) / (1 + len(self.plus)):.6g}")

    def negative(self) -> Column:
        """Return the column with the opposite sign."""
        unit = self.unit or next(iter(UNITS[self.channel]))
        return self.changed(unit=unit[1:] if unit.startswith("-") else f"-{unit}")


def column_from(
    channel: str,
    column: str,
    unit: str | None = None,
    times: str | None = None,
    plus: Sequence[str] = (),
    weights: Sequence[float] = (),
    each: Sequence[str] = (),
) -> Column:
    """Return the column of a name that serves as a channel."""
    result = Column(field=column, unit=unit or "", times=times, plus=tuple(plus),
                  weights=tuple(weights), each=tuple(each), channel=channel)  # fmt: skip
    _ = result.conversion  # refuses an unknown unit
    return result


def _unreadable(entry: str) -> DriveLogError:
    return DriveLogError(
        f"column mapping {entry.strip()!r} cannot be read; write CHANNEL=COLUMN or "
        "CHANNEL=COLUMN[UNIT], such as yaw=heading[deg], with quotes around a name that holds "
        "commas"
    )


def _split(text: str) -> list[str]:
    """Split at commas outside quotes and brackets."""
    parts, depth, quote = [""], 0, ""
    for letter in text:
        if quote:
            quote = "" if letter == quote else quote
        elif letter in "\"'":
            quote = letter
        else:
            depth += (letter in "[(") - (letter in "])" and depth > 0)
        if letter == "," and not quote and not depth:
            parts.append("")
        else:
            parts[-1] += letter
    return [part for part in parts if part.strip()]


_QUOTED = re.compile(r"""(?:"([^"]+)"|'([^']+)')\s*(?:\[\s*([^\[\]]*?)\s*\])?""")


_UNIT_AFTER = re.compile(r"(.*\S)\s*\[\s*([^\[\]]*?)\s*\]")


def _resolve(channel: str, text: str, names: Collection[str]) -> Column:
    """Find what a mapping's entry means: a name as a whole, or a name with a unit after it."""
    quoted = _QUOTED.fullmatch(text)
    source = text if quoted is None else quoted[1] or quoted[2]
    if quoted is not None and quoted[3]:
        return column_from(channel, source, quoted[3])
    if quoted is not None or source in names:
        # What a name says of its unit, such as "speed [km/h]" or "speed_kmh", is believed.
        return column_from(channel, source, unit_in(channel, source).unit)
    match = _UNIT_AFTER.fullmatch(source)
    # What ends with a name, or a number, in brackets ends with an element of an array.
    element = match and (match[2].isdecimal() or any(
        source.endswith(name) for name in names if name.endswith("]")))  # fmt: skip
    source, unit = (match[1], match[2]) if match and not element else (source, "")
    if source.count("[") != source.count("]"):
        raise _unreadable(f"{channel}={text}")
    known = "|".join(re.escape(name) for name in sorted(names, key=len, reverse=True) if name)
    result = None if source in names or not known else formula(source, known)
    if result is None:
        return column_from(channel, source, unit)
    written = unit or _unit_of(channel, result)
    first, *plus = result.names
    return column_from(channel, first, written, result.times, plus, result.weights, result.each)


_NUMBER = r"\d+\.?\d*(?:[eE][-+]?\d+)?|\.\d+"


class Formula(NamedTuple):
    """A sum of columns or fields with factors, and what it, or each of them, is multiplied by."""

    names: tuple[str, ...]
    weights: tuple[float, ...]  # none where all are one
    times: str | None
    each: tuple[str, ...] = ()  # second column of each term, empty where it has none


def formula(text: str, name: str) -> Formula | None:
    """Read a sum of names, or of products of two, with factors; None where it is no such sum."""
    by = rf"(?:\s*\*\s*({_NUMBER})(?![\w.]))?"
    term = rf"(?:({_NUMBER})\s*\*\s*)?({name}){by}(?:\s*\*\s*({name}))?{by}"
    added = rf"\s*[-+]?\s*{term}(?:\s*[-+]\s*{term})*\s*"
    inner, times = text.strip(), None
    if not re.fullmatch(added, inner):
        outer = re.fullmatch(rf"\((.*)\)(?:\s*\*\s*({name}))?", inner)
        if outer is None or not re.fullmatch(added, outer[1]):
            return None
        inner, times = outer[1], outer[2]
    names, weights, each = [], [], []
    for sign, one, first, two, other, three in re.findall(rf"([-+]?)\s*{term}", inner):
        weight = float(one or 1.0) * float(two or 1.0) * float(three or 1.0)
        names.append(first)
        weights.append(-weight if sign == "-" else weight)
        each.append(other)
    if times is not None and any(each):
        return None
    if len(names) == 1 and each[0]:
        times, each = each[0], [""]
    plain = all(weight == 1.0 for weight in weights)
    return Formula(
        tuple(names), () if plain else tuple(weights), times, tuple(each) if any(each) else ()
    )


def _unit_of(channel: str, found: Formula) -> str:
    """Return the unit in the names of a formula's columns, if it is in all of them."""
    names, kinds = found.names, ("current", "voltage", "yaw_rate")

    def stated(name: str) -> tuple[str, str]:
        return next(((k, u) for k in kinds if (u := unit_in(k, name).unit)), ("current", ""))

    def size(*units: tuple[str, str]) -> float:
        return prod(UNITS[kind].get(unit, 1.0) for kind, unit in units)

    if found.times is not None:
        factor = size(*dict.fromkeys(map(stated, names)), stated(found.times))
        return "" if factor == 1.0 else f"*{factor:.10g}"
    if found.each:
        sizes = {
            size(stated(name), stated(other)) if other else
            scale_of(channel, unit_in(channel, name).unit).factor
            for name, other in zip(names, found.each, strict=True)
        }  # fmt: skip
        units = {"" if one == 1.0 else f"*{one:.10g}" for one in sizes}
    else:
        plain = next(iter(UNITS.get(channel, {"": 1.0})))
        units = {unit_in(channel, name).unit for name in names}
        units = {""} if units <= {"", plain} else units
    if len(units) == 1:
        return units.pop()
    raise DriveLogError(
        f"{channel}: {' and '.join(names)} do not tell one unit; give the unit after the "
        f"formula, or factors in it, as in {channel}={names[0]}-0.25*{names[-1]}[m/s]"
    )


def clock_in(columns: str | Mapping[str, str | Column] | None) -> Column | None:
    """Return the column that is said to hold the time, if any."""
    return parse_columns(columns, only="t").get("t")


def parse_columns(
    columns: str | Mapping[str, str | Column] | None,
    names: Collection[str] = (),
    only: str = "",
) -> dict[str, Column]:
    """Read which column serves as which channel, or as one alone."""
    if columns is None or isinstance(columns, str):
        entries = [entry.partition("=") for entry in _split(columns or "")]
        pairs = [(name, equals + text) for name, equals, text in entries]
    else:
        for key, item in columns.items():
            if not isinstance(item, str | Column):
                raise DriveLogError(f"the column of {key!r} is {described(item)}; give its name")
        pairs = [(name, f"={item}") for name, item in columns.items() if isinstance(item, str)]
    result = {} if columns is None or isinstance(columns, str) else {
        key: item for key, item in columns.items() if isinstance(item, Column)
    }  # fmt: skip
    for name, text in pairs:
        channel, source = name.strip(), text[1:].strip()
        if not text or not channel or not source or re.search(r"[\[\]\"']", channel):
            raise _unreadable(f"{name}{text}")
        if channel in result:
            raise DriveLogError(f"column mapping names the channel {channel!r} twice; drop one")
        if only in ("", channel):
            result[channel] = _resolve(channel, source, names)
    return result


def map_channels(
    columns: str | Mapping[str, str | Column] | None,
    names: Collection[str],
    text: Collection[str] = (),
) -> dict[str, Column]:
    """Return which column serves as which channel: as given, and others by their own names."""
    wanted = parse_columns(columns, names)
    taken = {name for column in wanted.values() for name in column.names}
    left = [name for name in names if name and name not in taken]
    found = {n: Column(field=n, channel=n) for n in left if n in UNITS and n not in wanted}
    for name in left:
        stated = {c: unit_in(c, name) for c in UNITS if name.startswith(c) and name != c}
        channel = next((c for c, one in stated.items() if one.unit and one.bare == c), "")
        if channel and channel not in {**wanted, **found}:
            found[channel] = column_from(channel, name, stated[channel].unit)
        elif name not in {*wanted, *found, *text}:
            found[name] = Column(field=name, channel=name)
    if {"voltage", "current"} <= {*wanted}:  # what is named by hand is the power
        found.pop("power", None)
    return {**wanted, **found}
