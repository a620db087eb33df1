"""Units as people write them, by channel, and what a column's name says of its own."""

from __future__ import annotations

import re
from math import isfinite, pi
from typing import NamedTuple

from energyplan.errors import DriveLogError


class Scale(NamedTuple):
    """SI value = factor times reading, plus offset."""

    factor: float = 1.0
    offset: float = 0.0


_TIME = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0, "d": 86400.0}
_LENGTH = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "ft": 0.3048, "in": 0.0254}
_SPEED = {"m/s": 1.0, "cm/s": 1e-2, "mm/s": 1e-3, "km/h": 1 / 3.6, "mph": 0.44704, "ft/s": 0.3048}
_ANGLE = {"rad": 1.0, "deg": pi / 180, "mrad": 1e-3, "rev": 2 * pi}
_RATE = {"rad/s": 1.0, "deg/s": pi / 180, "rpm": pi / 30, "rev/s": 2 * pi, "mrad/s": 1e-3}
_COUNTS = {"ticks": 1.0, "ticks/sample": 1.0, "ticks/s": 1.0}
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
    "nsec": "ns", "nanoseconds": "ns", "minutes": "min", "hours": "h", "day": "d", "days": "d",
    "meter": "m", "meters": "m", "metre": "m", "metres": "m",
    "mps": "m/s", "m s-1": "m/s", "m s^-1": "m/s", "meters/s": "m/s", "kmh": "km/h",
    "kph": "km/h", "kmph": "km/h",
    "radian": "rad", "radians": "rad", "degree": "deg", "degrees": "deg", "\u00b0": "deg",
    "grad": "deg", "grad/s": "deg/s", "tr/min": "rpm", "umdr/min": "rpm", "rad/sek": "rad/s",
    "rads": "rad/s", "radps": "rad/s", "rad s-1": "rad/s", "rad s^-1": "rad/s",
    "radians/s": "rad/s", "rad/sec": "rad/s", "\u00b0/s": "deg/s", "dps": "deg/s",
    "degrees/s": "deg/s", "deg/sec": "deg/s", "1/min": "rpm", "r/min": "rpm", "u/min": "rpm",
    "min-1": "rpm", "min^-1": "rpm", "rps": "rev/s",
    "watt": "W", "watts": "W", "kilowatt": "kW", "horsepower": "hp",
    "milliwatt": "mW", "volt": "V", "volts": "V",
    "amp": "A", "amps": "A", "ampere": "A", "amperes": "A", "milliampere": "mA",
    "m/s2": "m/s^2", "m/s\u00b2": "m/s^2", "m/s/s": "m/s^2", "mps2": "m/s^2",
    "\u00b0c": "degC", "celsius": "degC", "\u00b0f": "degF", "fahrenheit": "degF",
    "tick": "ticks", "counts": "ticks", "count": "ticks", "cts": "ticks", "pulses": "ticks",
    "tps": "ticks/s", "counts/s": "ticks/s", "cps": "ticks/s", "pulses/s": "ticks/s",
    "tick/s": "ticks/s", "ticks/sec": "ticks/s", "counts/sample": "ticks/sample",
    "kelvin": "K", "kilogram": "kg", "lbs": "lb", "pounds": "lb",
}  # fmt: skip
"""Other ways to write a unit, in small letters."""
_WHEEL_CHANNELS = ("v_left", "v_right")
_OF_WHEELS = {**_RATE, **_COUNTS}


def known_unit(channel: str, unit: str) -> str | None:
    """Return a channel's unit by its usual spelling; None where the channel has no such unit."""
    known = {**UNITS.get(channel, {}), **(_OF_WHEELS if channel in _WHEEL_CHANNELS else {})}
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


def is_count(unit: str) -> bool:
    """Tell whether a unit of tread speeds is one of encoders, which takes the metres per count."""
    return unit in _COUNTS


def scale_of(channel: str, unit: str) -> Scale:
    """Return the conversion from a unit."""
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
        if not star and is_count(spelt):
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
    return Scale(sign * factor * known[spelt], _OFFSETS.get(spelt, 0.0))


_BRACKETED = re.compile(r"(.*\S)\s*[\[(]\s*([^\[\]()]*?)\s*[\])]")


def split_unit(name: str) -> tuple[str, str]:
    """Split a column's name from the unit in brackets at its end; empty where there is none."""
    match = _BRACKETED.fullmatch(name.strip())
    return (match[1], match[2]) if match else (name.strip(), "")


_ANYWHERE = {
    "ms", "us", "ns", "kmh", "kph", "mps", "mph", "rpm", "dps", "radps", "rads", "deg", "degrees",
    "kw", "mv", "ma", "mm", "cm", "hp",
}  # fmt: skip
"""Words that are units wherever in a name they stand; others are only at its end."""


_CAPITALS = {"kW", "mW", "mV", "mA", "degC", "degF"}
"""Units that hold a capital after a small letter."""


def split_words(name: str) -> list[str]:
    """Split a name at signs, and where small letters turn to capitals."""
    found: list[str] = []
    for part in re.split(r"[^A-Za-z0-9\u00b0\u00b5^]+", name):
        if part in _CAPITALS:
            found.append(part)
            continue
        spaced = re.sub(r"([a-z0-9])([A-Z])", r"\1 \2", part)
        found += re.sub(r"([A-Z]+)([A-Z][a-z])", r"\1 \2", spaced).split()
    return found


class NamedUnit(NamedTuple):
    """A name without its unit, and the unit in its usual spelling."""

    bare: str
    unit: str


def unit_in(channel: str, name: str) -> NamedUnit | None:
    """Return the unit that a column's name tells, if the channel can be in it.

    It stands in brackets at the end, as in ``speed [km/h]``, or is a word of the name, as in
    ``current_mA``, ``yaw_rate_deg_s`` or ``rpm_left``.
    """
    bare, told = split_unit(name)
    if told:
        spelt = known_unit(channel, told)
        return None if spelt is None else NamedUnit(bare, spelt)
    words = split_words(name)
    for count in (3, 2, 1):
        tail = [word for word in words[-count:] if word.lower() != "per"]
        if len(words) <= count or (count > 1 and len(tail) != 2):
            continue
        spelt = known_unit(channel, "/".join(tail))
        if spelt is not None:
            return NamedUnit("_".join(words[:-count]), spelt)
    for k, word in enumerate(words):
        spelt = known_unit(channel, word) if word.lower() in _ANYWHERE else None
        if spelt is not None:
            return NamedUnit("_".join(words[:k] + words[k + 1 :]), spelt)
    return None


def is_unit(text: str) -> bool:
    """Tell whether a text is a unit of any channel."""
    bare = text.strip().strip("[]()").strip()
    return any(known_unit(channel, bare) is not None for channel in UNITS)
