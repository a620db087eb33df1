"""Units as people write them: one table for logs, files of missions, robots and batteries."""

from __future__ import annotations

from collections.abc import Collection
from math import pi

_PREFIXES = {"n": 1e-9, "u": 1e-6, "m": 1e-3, "c": 1e-2, "d": 0.1, "k": 1e3, "M": 1e6}


def _prefixed(unit: str, size: float = 1.0, prefixes: str = "m c d k u") -> dict[str, float]:
    """Return a unit, and the same with prefixes, as ``mV`` of ``V``."""
    return {unit: size} | {f"{one}{unit}": size * _PREFIXES[one] for one in prefixes.split()}


TIME = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0, "d": 86400.0}
LENGTH = {**_prefixed("m", 1.0, "c m d k"), "ft": 0.3048, "in": 0.0254, "yd": 0.9144}
SPEED = {"m/s": 1.0, "cm/s": 1e-2, "mm/s": 1e-3, "km/h": 1 / 3.6, "mph": 0.44704, "ft/s": 0.3048,
          "in/s": 0.0254, "kn": 0.514444, "m/min": 1 / 60, "ft/min": 0.3048 / 60, "dm/s": 0.1,
          "cm/min": 1 / 6000, "mm/min": 1 / 60_000, "m/h": 1 / 3600}  # fmt: skip
ANGLE = {**_prefixed("rad", 1.0, "m u"), **_prefixed("deg", pi / 180, "c m"), "rev": 2 * pi}
RATES = {"rad/s": 1.0, "deg/s": pi / 180, "rpm": pi / 30, "rev/s": 2 * pi, "mrad/s": 1e-3,
         "mdps": pi / 180_000, "cdeg/s": pi / 18_000, "urad/s": 1e-6, "rad/min": 1 / 60,
         "deg/min": pi / 10_800}  # fmt: skip
ENERGY = {**_prefixed("J", 1.0, "k M m"), **_prefixed("Wh", 3.6e3, "m k"),
           **_prefixed("Ws", 1.0, "m k")}  # fmt: skip
CHARGE = {**_prefixed("Ah", 3.6e3, "m u"), **_prefixed("C", 1.0, "m u k"),
           **_prefixed("As", 1.0, "m")}  # fmt: skip
POWER = {**_prefixed("W", 1.0, "k m u"), "hp": 745.69987, "PS": 735.49875}
VOLTAGE, CURRENT = _prefixed("V"), _prefixed("A")
TEMPERATURE = {"degC": 1.0, "K": 1.0, "degF": 5 / 9}
MASS = {"kg": 1.0, "g": 1e-3, "lb": 0.45359237}

OFFSETS = {"K": -273.15, "degF": -160 / 9}
_ALIASES = {
    "sec": "s", "secs": "s", "second": "s", "seconds": "s", "msec": "ms", "millisecond": "ms",
    "milliseconds": "ms", "usec": "us", "\u00b5s": "us", "\u03bcs": "us", "microseconds": "us",
    "nsec": "ns", "nanoseconds": "ns", "minutes": "min", "hours": "h", "day": "d", "days": "d",
    "meter": "m", "meters": "m", "metre": "m", "metres": "m",
    "cmps": "cm/s", "mmps": "mm/s", "mps": "m/s", "m s-1": "m/s", "m s^-1": "m/s",
    "meters/s": "m/s", "kmh": "km/h",
    "kph": "km/h", "kmph": "km/h", "ips": "in/s", "inch/s": "in/s", "inches/s": "in/s",
    "knot": "kn", "knots": "kn", "kt": "kn", "kts": "kn", "fpm": "ft/min",
    "fps": "ft/s", "feet/s": "ft/s", "inch": "in", "inches": "in", "feet": "ft", "foot": "ft",
    "radian": "rad", "radians": "rad", "degree": "deg", "degrees": "deg", "\u00b0": "deg",
    "rads": "rad/s", "radps": "rad/s", "rad s-1": "rad/s", "rad s^-1": "rad/s",
    "radians/s": "rad/s", "rad/sec": "rad/s", "\u00b0/s": "deg/s", "dps": "deg/s",
    "degrees/s": "deg/s", "deg/sec": "deg/s", "mdeg/s": "mdps", "millidps": "mdps",
    "millideg/s": "mdps", "millidegrees/s": "mdps", "cdps": "cdeg/s", "centideg/s": "cdeg/s",
    "centidegrees/s": "cdeg/s", "millirad/s": "mrad/s", "mradps": "mrad/s", "mrads": "mrad/s",
    "centideg": "cdeg", "centidegree": "cdeg", "centidegrees": "cdeg", "millidegrees": "mdeg",
    "milliradians": "mrad", "rev/min": "rpm", "turns/min": "rpm", "revs/min": "rpm",
    "rotations/min": "rpm", "turns/s": "rev/s", "rotations/s": "rev/s", "revs/s": "rev/s",
    "1/min": "rpm", "r/min": "rpm", "u/min": "rpm", "umdr/min": "rpm", "tr/min": "rpm",
    "min-1": "rpm", "min^-1": "rpm", "rps": "rev/s",
    "watt": "W", "watts": "W", "kilowatt": "kW", "horsepower": "hp",
    "watthours": "Wh", "watt/hours": "Wh", "watt/hour": "Wh", "w/h": "Wh", "amphours": "Ah",
    "amp/hours": "Ah", "amp/hour": "Ah", "ampere/hours": "Ah", "milliamp/hours": "mAh",
    "kilowatt/hours": "kWh", "joule": "J", "joules": "J", "kilojoule": "kJ", "kilojoules": "kJ",
    "megajoules": "MJ", "millijoules": "mJ", "watt/seconds": "Ws", "watt/second": "Ws",
    "w/s": "Ws", "wattseconds": "Ws", "milliwatt/hours": "mWh",
    "coulomb": "C", "coulombs": "C", "amp/seconds": "As", "ampere/seconds": "As",
    "ampseconds": "As", "millicoulombs": "mC", "microamp/hours": "uAh",
    "millivolt": "mV", "millivolts": "mV", "centivolts": "cV", "decivolts": "dV",
    "kilowatts": "kW", "milliwatts": "mW", "milliamp": "mA", "milliamps": "mA",
    "milliamperes": "mA", "centiamps": "cA", "deciamps": "dA", "microamps": "uA",
    "milliwatt": "mW", "volt": "V", "volts": "V",
    "amp": "A", "amps": "A", "ampere": "A", "amperes": "A", "milliampere": "mA",
    "m/s2": "m/s^2", "m/s\u00b2": "m/s^2", "m/s/s": "m/s^2", "mps2": "m/s^2",
    "\u00b0c": "degC", "celsius": "degC", "\u00b0f": "degF", "fahrenheit": "degF",
    "tick": "ticks", "counts": "ticks", "count": "ticks", "cts": "ticks", "pulses": "ticks",
    "tps": "ticks/s", "counts/s": "ticks/s", "cps": "ticks/s", "pulses/s": "ticks/s",
    "tick/s": "ticks/s", "ticks/sec": "ticks/s", "qpps": "ticks/s", "pps": "ticks/s",
    "counts/sample": "ticks/sample",
    "kelvin": "K", "kilogram": "kg", "lbs": "lb", "pounds": "lb",
}  # fmt: skip
"""Other ways to write a unit, in small letters."""
_EXACT = {
    "mohm",
    "mW",
    "mWh",
    "MJ",
    "mJ",
    "mWs",
    *(one for one in CHARGE if not one.endswith("Ah")),
}
"""Units whose capitals count: M is a million, and small letters may be an index or a word."""


def standard(unit: str, known: Collection[str]) -> str | None:
    """Return the standard spelling of a unit that is one of those known; None of any other one."""
    bare = unit.strip()
    if bare in known:
        return bare
    folded = {name.lower(): name for name in known if name not in _EXACT}
    found = _ALIASES.get(bare.lower(), folded.get(bare.lower()))
    return found if found in known else None
