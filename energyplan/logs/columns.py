"""Which column of a file is which channel, and in which unit."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from energyplan.errors import DriveLogError
from energyplan.kinds import described
from energyplan.logs.cells import Table
from energyplan.logs.counts import count_rate, counting
from energyplan.logs.units import UNITS, Scale, scale_of, unit_in
from energyplan.path import FloatArray


class Column(NamedTuple):
    """A column of a file that serves as a channel."""

    source: str  # name of the column
    scale: Scale = Scale()  # conversion to the library's unit
    unit: str = ""  # the unit that the conversion came from, as it was written
    times: str | None = None  # A further column to multiply by, as a voltage by a current
    plus: tuple[str, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all the columns."""
        return (self.source, *self.plus, *(() if self.times is None else (self.times,)))

    @property
    def written(self) -> str:
        """What is computed of the columns, before the conversion."""
        added = " + ".join((self.source, *self.plus))
        if self.times is None:
            return added
        return f"({added}) * {self.times}" if self.plus else f"{added} * {self.times}"

    def value(self, reading: Callable[[str], Any]) -> Any:
        """Return the channel in the library's unit from the readings of columns."""
        value = sum((reading(name) for name in self.plus), start=reading(self.source))
        if self.times is not None:
            value = value * reading(self.times)
        return value * self.scale.factor + self.scale.offset

    def over(self, t: FloatArray | None, reading: Callable[[str], FloatArray]) -> FloatArray:
        """Return the channel over time [s], as `value`; of an encoder that counts on, its rate."""
        kind = counting(self.unit)
        if not kind or t is None:
            return np.asarray(self.value(reading))
        return np.asarray(self.value(lambda name: count_rate(t, reading(name), kind)))

    def described(self) -> dict[str, str | list[str] | None]:
        """Return the column as a project's file holds it."""
        return {
            "column": self.source, "plus": list(self.plus), "unit": self.unit, "times": self.times
        }  # fmt: skip


def column_from(
    channel: str,
    column: str,
    unit: str | None = None,
    times: str | None = None,
    plus: Sequence[str] = (),
) -> Column:
    """Return the column of a name that serves as a channel."""
    scale = scale_of(channel, unit) if unit else Scale()
    return Column(column, scale, unit or "", times, tuple(plus))


def _unreadable(entry: str) -> DriveLogError:
    return DriveLogError(
        f"column mapping {entry.strip()!r} cannot be read; write CHANNEL=COLUMN or "
        "CHANNEL=COLUMN[UNIT], such as yaw=heading[deg], with quotes around a name that holds "
        "commas"
    )


class _Entry(NamedTuple):
    """An entry of a column mapping as written: what is a name in it the table decides."""

    channel: str
    text: str
    quoted: bool
    unit: str


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


def _entries(columns: str | Mapping[str, str] | None) -> list[_Entry]:
    if columns is None:
        return []
    if isinstance(columns, str):
        pairs = [entry.partition("=") for entry in _split(columns)]
    else:
        pairs = [(channel, "=", str(source)) for channel, source in columns.items()]
    found: list[_Entry] = []
    for name, equals, text in pairs:
        channel, source = name.strip(), text.strip()
        if not equals or not channel or not source or re.search(r"[\[\]\"']", channel):
            raise _unreadable(f"{name}{equals}{text}")
        if channel in {entry.channel for entry in found}:
            raise DriveLogError(f"column mapping names the channel {channel!r} twice; drop one")
        quoted = _QUOTED.fullmatch(source)
        if quoted is not None:
            inner = quoted[1] or quoted[2]
            found.append(_Entry(channel, inner, True, quoted[3] or ""))
        else:
            found.append(_Entry(channel, source, False, ""))
    return found


_UNIT_AFTER = re.compile(r"(.*\S)\s*\[\s*([^\[\]]*?)\s*\]")


def _resolve(entry: _Entry, names: Collection[str]) -> Column:
    """Find what a mapping's entry means: a name as a whole, or a name with a unit after it."""
    if entry.unit:
        return column_from(entry.channel, entry.text, entry.unit)
    if entry.quoted or entry.text in names:
        # What a name says of its unit, such as "speed [km/h]" or "speed_kmh", is believed.
        told = unit_in(entry.channel, entry.text)
        return column_from(entry.channel, entry.text, told.unit if told else None)
    match = _UNIT_AFTER.fullmatch(entry.text)
    source, unit = (match[1], match[2]) if match else (entry.text, "")
    if source.count("[") != source.count("]"):
        raise _unreadable(f"{entry.channel}={entry.text}")
    if source not in names:
        first, star, second = (part.strip() for part in source.rpartition("*"))
        added = (first if star else source).removeprefix("(").removesuffix(")")
        parts = [part.strip() for part in added.split("+")]
        if {*parts, *([second] if star else [])} <= set(names):
            return column_from(entry.channel, parts[0], unit, second if star else None, parts[1:])
    return column_from(entry.channel, source, unit)


def parse_columns(
    columns: str | Mapping[str, str | Column] | None, names: Collection[str] = ()
) -> dict[str, Column]:
    """Read which column serves as which channel."""
    if columns is None or isinstance(columns, str):
        return {entry.channel: _resolve(entry, names) for entry in _entries(columns)}
    for key, item in columns.items():
        if not isinstance(item, str | Column):
            raise DriveLogError(f"the column of {key!r} is {described(item)}; give its name")
    made = {key: item for key, item in columns.items() if isinstance(item, Column)}
    rest = {key: item for key, item in columns.items() if isinstance(item, str)}
    return {**made, **{entry.channel: _resolve(entry, names) for entry in _entries(rest)}}


class Chosen(NamedTuple):
    """Channels taken from a table, the columns that served, and those of text nobody asked for."""

    channels: dict[str, FloatArray]
    used: set[str]
    unread: list[str]


def choose_columns(
    table: Table, columns: str | Mapping[str, str | Column] | None, others: bool = True
) -> Chosen:
    """Take a log's channels from a table."""
    wanted = parse_columns(columns, (*table.columns, *table.text))
    if others:
        own = own_columns((*table.columns, *table.text), wanted)
        wanted |= {k: c for k, c in own.items() if k in UNITS or c.source in table.columns}
    with np.errstate(over="ignore", invalid="ignore"):  # what overflows is out of range anyway
        t = wanted["t"].value(table.column) if "t" in wanted else None
        channels = {channel: column.over(t, table.column) for channel, column in wanted.items()}
    used = {name for column in wanted.values() for name in column.names}
    unread = [name for name in table.text if others and name not in used]
    return Chosen(channels, used, unread)


def own_columns(names: Iterable[str], wanted: Mapping[str, Column]) -> dict[str, Column]:
    """Return the channels that columns are by their own names."""
    taken = {name for column in wanted.values() for name in column.names}
    left = [name for name in names if name and name not in taken]
    found = {name: Column(name) for name in left if name in UNITS and name not in wanted}
    for name in left:
        named = _named_channel(name)
        if named is not None and named.channel not in {**wanted, **found}:
            found[named.channel] = column_from(named.channel, name, named.unit)
        elif name not in {**wanted, **found}:
            found[name] = Column(name)
    return found


class _NamedChannel(NamedTuple):
    """A channel, and the unit that a column's name tells beside it."""

    channel: str
    unit: str


def _named_channel(name: str) -> _NamedChannel | None:
    """Return the channel that a column's name is, with a unit of that channel after it."""
    for channel in UNITS:
        told = unit_in(channel, name) if name.startswith(channel) and name != channel else None
        if told is not None and told.bare == channel:
            return _NamedChannel(channel, told.unit)
    return None
