"""Which column of a file is which channel, and in which unit."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping
from math import isfinite, pi
from typing import NamedTuple

import numpy as np

from energyplan.errors import DriveLogError
from energyplan.logs.tables import Table
from energyplan.path import FloatArray


class Scale(NamedTuple):
    """SI value = factor times reading, plus offset."""

    factor: float = 1.0
    offset: float = 0.0


_TIME = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0}
_LENGTH = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "ft": 0.3048, "in": 0.0254}
_SPEED = {"m/s": 1.0, "cm/s": 1e-2, "mm/s": 1e-3, "km/h": 1 / 3.6, "mph": 0.44704, "ft/s": 0.3048}
_ANGLE = {"rad": 1.0, "deg": pi / 180, "mrad": 1e-3, "rev": 2 * pi}
_RATE = {"rad/s": 1.0, "deg/s": pi / 180, "rpm": pi / 30, "rev/s": 2 * pi, "mrad/s": 1e-3}
_POWER = {"W": 1.0, "kW": 1e3, "mW": 1e-3, "hp": 745.69987, "PS": 735.49875}

UNITS: dict[str, dict[str, float]] = {
    "t": _TIME,
    "x": _LENGTH,
    "y": _LENGTH,
    "v_left": _SPEED,
    "v_right": _SPEED,
    "p_left": _POWER,
    "p_right": _POWER,
    "power": _POWER,
    "voltage": {"V": 1.0, "mV": 1e-3},
    "current": {"A": 1.0, "mA": 1e-3},
    "yaw": _ANGLE,
    "slope": _ANGLE,
    "yaw_rate": _RATE,
    "accel_x": {"m/s^2": 1.0, "g": 9.80665},
    "temperature": {"degC": 1.0, "K": 1.0, "degF": 5 / 9},
    "payload": {"kg": 1.0, "lb": 0.45359237},
}
"""Units by channel; the first is the one of the library."""
_OFFSETS = {"K": -273.15, "degF": -160 / 9}
_ALIASES = {
    "sec": "s", "secs": "s", "second": "s", "seconds": "s", "msec": "ms", "millisecond": "ms",
    "milliseconds": "ms", "usec": "us", "\u00b5s": "us", "\u03bcs": "us", "microseconds": "us",
    "nsec": "ns", "nanoseconds": "ns", "minutes": "min", "hours": "h",
    "meter": "m", "meters": "m", "metre": "m", "metres": "m",
    "mps": "m/s", "m s-1": "m/s", "m s^-1": "m/s", "meters/s": "m/s", "kmh": "km/h",
    "kph": "km/h", "kmph": "km/h",
    "radian": "rad", "radians": "rad", "degree": "deg", "degrees": "deg", "\u00b0": "deg",
    "rads": "rad/s", "radps": "rad/s", "rad s-1": "rad/s", "rad s^-1": "rad/s",
    "radians/s": "rad/s", "rad/sec": "rad/s", "\u00b0/s": "deg/s", "dps": "deg/s",
    "degrees/s": "deg/s", "deg/sec": "deg/s", "1/min": "rpm", "r/min": "rpm", "u/min": "rpm",
    "min-1": "rpm", "min^-1": "rpm", "rps": "rev/s",
    "watt": "W", "watts": "W", "kilowatt": "kW", "horsepower": "hp",
    "milliwatt": "mW", "volt": "V", "volts": "V",
    "amp": "A", "amps": "A", "ampere": "A", "amperes": "A", "milliampere": "mA",
    "m/s2": "m/s^2", "m/s\u00b2": "m/s^2", "m/s/s": "m/s^2", "mps2": "m/s^2",
    "\u00b0c": "degC", "celsius": "degC", "\u00b0f": "degF", "fahrenheit": "degF",
    "kelvin": "K", "kilogram": "kg", "lbs": "lb", "pounds": "lb",
}  # fmt: skip
"""Other ways to write a unit, in small letters."""
_WHEEL_CHANNELS = ("v_left", "v_right")


class Column(NamedTuple):
    """A column of a file that serves as a channel.

    Parameters
    ----------
    source : str
        Name of the column.
    scale : Scale
        Conversion to the library's unit.
    unit : str
        The unit that the conversion came from, as it was written; empty where it is the library's.
    times : str, optional
        A further column to multiply by, as a voltage by a current.
    """

    source: str
    scale: Scale = Scale()
    unit: str = ""
    times: str | None = None

    def described(self) -> dict[str, str | None]:
        """Return the column as a project's file holds it."""
        return {"column": self.source, "unit": self.unit, "times": self.times}


def known_unit(channel: str, unit: str) -> str | None:
    """Return a channel's unit by its usual spelling; None where the channel has no such unit.

    Parameters
    ----------
    channel : str
        The channel.
    unit : str
        A unit as people write it, such as ``"RPM"`` or ``"degrees"``.

    Returns
    -------
    str or None
        The unit. Rates of wheels count as units of tread speeds.

    Examples
    --------
    >>> known_unit("v_left", "RPM"), known_unit("yaw", "m")
    ('rpm', None)
    """
    known = {**UNITS.get(channel, {}), **(_RATE if channel in _WHEEL_CHANNELS else {})}
    bare = unit.strip()
    if bare in known:
        return bare
    folded = {name.lower(): name for name in known if name.lower() not in ("kw", "mw", "ma", "mv")}
    spelt = _ALIASES.get(bare.lower(), folded.get(bare.lower()))
    if spelt is None and bare.lower() in ("kw", "mw", "ma", "mv"):  # M would be a million
        spelt = {"kw": "kW", "mw": None, "ma": "mA", "mv": "mV"}[bare.lower()]
    return spelt if spelt in known else None


def is_wheel_rate(unit: str) -> bool:
    """Tell whether a unit of tread speeds is one of wheel rates, which take a wheel radius."""
    return unit in _RATE


def scale_of(channel: str, unit: str) -> Scale:
    """Return the conversion from a unit.

    Parameters
    ----------
    channel : str
        The channel.
    unit : str
        A unit's name, a factor after ``*``, or both, with a minus before it where the sign is
        opposite: ``"deg"``, ``"-A"``, ``"*0.165"``, ``"rpm*0.165"``.

    Returns
    -------
    Scale
        The conversion.

    Raises
    ------
    DriveLogError
        If the channel cannot be in that unit, or the factor is none.
    """
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
        rates = ", wheel rates such as rpm with the wheel radius, as in [rpm*0.165]"
        raise DriveLogError(
            f"{channel} cannot be in [{unit}]; it can be in {', '.join(known)}"
            f"{rates if channel in _WHEEL_CHANNELS else ''}, with a minus "
            "before it where the sign is opposite, or give a factor such as [*0.001]"
        )
    if spelt not in known:
        if not star:
            raise DriveLogError(
                f"{channel} in [{unit}] is a wheel's rate; give the wheel radius with it, as in "
                f"{channel}=NAME[{spelt}*0.165] for 0.165 m"
            )
        return Scale(sign * factor * _RATE[spelt])
    return Scale(sign * factor * known[spelt], _OFFSETS.get(spelt, 0.0))


def column_from(
    channel: str, column: str, unit: str | None = None, times: str | None = None
) -> Column:
    """Return the column of a name that serves as a channel.

    Parameters
    ----------
    channel : str
        The channel.
    column : str
        Name of the column, whatever signs it holds.
    unit : str, optional
        As for `scale_of`; the library's where not given.
    times : str, optional
        A further column to multiply by.

    Returns
    -------
    Column
        The column.

    Raises
    ------
    DriveLogError
        If the channel cannot be in that unit.
    """
    return Column(column, scale_of(channel, unit) if unit else Scale(), unit or "", times)


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


_BRACKETED = re.compile(r"(.*\S)\s*[\[(]\s*([^\[\]()]*?)\s*[\])]")
_UNIT_AFTER = re.compile(r"(.*\S)\s*\[\s*([^\[\]]*?)\s*\]")


def split_unit(name: str) -> tuple[str, str]:
    """Split a column's name from the unit in brackets at its end; empty where there is none."""
    match = _BRACKETED.fullmatch(name.strip())
    return (match[1], match[2]) if match else (name.strip(), "")


def _resolve(entry: _Entry, names: Collection[str]) -> Column:
    """Find what a mapping's entry means: a name as a whole, or a name with a unit after it."""
    if entry.unit:
        return column_from(entry.channel, entry.text, entry.unit)
    if entry.quoted or entry.text in names:
        # What a name says of its unit, such as "speed [km/h]", is believed.
        unit = split_unit(entry.text)[1]
        spelt = known_unit(entry.channel, unit) if unit else None
        return column_from(entry.channel, entry.text, spelt)
    match = _UNIT_AFTER.fullmatch(entry.text)
    source, unit = (match[1], match[2]) if match else (entry.text, "")
    if source.count("[") != source.count("]"):
        raise _unreadable(f"{entry.channel}={entry.text}")
    if "*" in source and source not in names:
        first, second = (part.strip() for part in source.split("*", 1))
        if first in names and second in names:
            return column_from(entry.channel, first, unit, second)
    return column_from(entry.channel, source, unit)


def parse_columns(
    columns: str | Mapping[str, str | Column] | None, names: Collection[str] = ()
) -> dict[str, Column]:
    """Read which column serves as which channel.

    Parameters
    ----------
    columns : str or mapping of str to str or Column, optional
        ``"v_left=velL,yaw=heading[deg]"``, or ``{"v_left": "velL", "yaw": "heading[deg]"}``. In
        brackets stands the unit where it is not the library's, with a minus before it where the
        sign is opposite (``current=i[-A]``), a factor (``v_left=wheel_rate[*0.165]``), or both
        (``v_left=wheel_rate[rpm*0.165]``). A name with commas or brackets stands in quotes
        (``v_left="speed, left [km/h]"[km/h]``). Two columns can be multiplied
        (``p_left=voltage_left*current_left``).
    names : collection of str
        Names of the columns there are: a name among them needs no quotes, and what it says of its
        unit is believed.

    Returns
    -------
    dict of str to Column
        The columns by channel.

    Raises
    ------
    DriveLogError
        If an entry cannot be read, names a channel twice, or gives a unit that does not fit.

    Examples
    --------
    >>> parse_columns("yaw=heading[deg]")["yaw"].source
    'heading'
    >>> parse_columns('v_left="wheel speed, left"[km/h]')["v_left"].source
    'wheel speed, left'
    """
    if columns is None or isinstance(columns, str):
        return {entry.channel: _resolve(entry, names) for entry in _entries(columns)}
    made = {key: item for key, item in columns.items() if isinstance(item, Column)}
    rest = {key: item for key, item in columns.items() if isinstance(item, str)}
    return {**made, **{entry.channel: _resolve(entry, names) for entry in _entries(rest)}}


class Chosen(NamedTuple):
    """Channels taken from a table, and its columns of text that nobody asked for."""

    channels: dict[str, FloatArray]
    unread: list[str]


def choose_columns(
    table: Table, columns: str | Mapping[str, str | Column] | None, others: bool = True
) -> Chosen:
    """Take a log's channels from a table.

    Parameters
    ----------
    table : Table
        The table.
    columns : str or mapping of str to str or Column, optional
        As in `parse_columns`; columns that bear a channel's name, and any others of numbers, need
        no mention.
    others : bool
        Whether to take those that are not mentioned.

    Returns
    -------
    Chosen
        The channels in the library's units.

    Raises
    ------
    DriveLogError
        If the mapping is malformed, or a column is missing or holds text.
    """
    wanted = parse_columns(columns, (*table.columns, *table.text))
    taken = {name for column in wanted.values() for name in (column.source, column.times)}
    for name in (*table.columns, *table.text):
        useful = name in table.columns or name in UNITS
        if others and useful and name not in wanted and name not in taken:
            wanted[name] = Column(name)
    with np.errstate(over="ignore", invalid="ignore"):  # what overflows is out of range anyway
        channels = {channel: _taken(table, column) for channel, column in wanted.items()}
    unread = [name for name in table.text if others and name not in channels]
    return Chosen(channels, unread)


def _taken(table: Table, column: Column) -> FloatArray:
    """Return a column's readings in the library's unit."""
    values = table.column(column.source)
    if column.times is not None:
        values = values * table.column(column.times)
    return values * column.scale.factor + column.scale.offset
