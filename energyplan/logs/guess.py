"""Which column or field is which channel, guessed from its name and, where it says so, its unit."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Sequence
from typing import NamedTuple

from energyplan.logs.mapping import Column, counting, split_unit, split_words, unit_in
from energyplan.units import SPEED

_WORDS = {
    "left": {"left", "l", "lh", "lhs", "lft", "port", "fl", "rl", "bl", "ml", "lf", "lr", "lb",
             "lm"},
    "right": {"right", "r", "rh", "rhs", "rgt", "starboard", "stbd", "fr", "rr", "br", "mr", "rf",
              "rb", "rm"},
    "speed": {
        "v", "vel", "velocity", "speed", "wheel", "wheels", "track", "tread", "rpm", "omega",
        "rate", "spd", "w", "velocities", "speeds", "angvel", "rotation",
    },
    "power": {"p", "pw", "power", "watt", "watts", "pwr"},
    "voltage": {"u", "volt", "volts", "voltage", "vbat", "vbatt", "ubat", "vbus"},
    "current": {"i", "cur", "curr", "current", "amp", "amps", "ampere", "amperes", "currents",
                "ibat", "ibatt", "ibus"},
    "time": {"t", "time", "timestamp", "stamp", "sec", "secs", "seconds", "clock", "elapsed",
             "epoch", "utc", "ts", "datetime", "today", "tstamp", "millis", "micros", "nanos",
             "tow", "itow", "uptime"},
    "yaw": {"yaw", "heading", "theta", "psi", "hdg", "course", "azimuth", "compass"},
    "turn": {"gyro", "angular", "yawrate", "wz", "gz", "gyr", "omega"},
    "accel": {"acc", "accel", "acceleration", "ax"},
    "temperature": {"temp", "temperature"},
}  # fmt: skip
_OTHER_LANGUAGES = {
    "left": "links linke linkes linker gauche izquierda izquierdo esquerda sinistra sinistro",
    "right": "rechts rechte rechtes rechter droite droit derecha derecho direita destra destro",
    "speed": "geschwindigkeit drehzahl vitesse velocidad velocidade velocita",
    "power": "leistung puissance potencia potenza",
    "voltage": "spannung tension voltaje voltagem tensione tensao",
    "current": "strom courant corriente corrente",
    "time": "zeit uhrzeit zeitstempel temps tiempo tempo heure hora fecha",
    "yaw": "gierwinkel lacet guinada rumbo imbardata",
    "turn": "gierrate drehrate",
}
"""The same in German, French, Spanish, Portuguese and Italian, without accents."""
for _kind, _others in _OTHER_LANGUAGES.items():
    _WORDS[_kind] |= set(_others.split())
_NOT_MEASURED = {
    "cmd", "command", "commanded", "set", "setpoint", "target", "desired", "ref", "reference",
    "goal", "request", "requested", "cov", "covariance", "std", "error", "err", "torque", "effort",
    "ticks", "count", "encoder", "position", "temp", "temperature", "limit", "max", "min",
    "raw", "health", "technology", "capacity", "charge", "percentage", "percent", "pct",
    "present", "adc", "lsb", "norm", "normalized", "normalised", "duty", "dutycycle", "pwm", "erpm",
    "throttle", "fraction",
}  # fmt: skip
"""Words of commands, and of what is no speed and no power."""


ENCODER = {"enc", "encoder", "encoders", "tick", "ticks", "count", "counts", "counter", "pulses",
            "odometer", "odo", "distance", "dist"}  # fmt: skip
"""Words of what counts the turns of a wheel."""
_GONE = {"odom", "odometry", "travel", "travelled", "traveled", "path", "rolled", "way", "mileage"}
"""The same of what is a distance where its unit is a length."""


_PLACES = {
    "front": "", "rear": "", "back": "", "mid": "", "middle": "", "center": "", "centre": "",
    **{f"{place}{side}": side for place in "frbm" for side in "lr"},
    **{f"{side}{place}": side for place in "frbm" for side in "lr" if f"{side}{place}" != "rl"},
}  # fmt: skip
"""Words for one of a side's wheels, with the side."""
_MEASURED = {
    "meas", "measured", "actual", "act", "feedback", "fb", "real", "side", "sensor", "state",
}  # fmt: skip
"""Words that say that a reading is one, and not of what."""
_BATTERY = {"battery", "bat", "batt", "bus", "bms", "pack", "batterie", "akku", "bateria",
            "batteria"}  # fmt: skip
_KNOWN = frozenset[str]().union(*_WORDS.values(), _NOT_MEASURED, ENCODER, _MEASURED, _BATTERY)
"""Words whose plural means the same."""
_SHORTEST = 3  # letters up to which a word is no plural
_ELECTRIC = ("power", "voltage", "current")
_TOLD_BY_UNIT = {"power": "power", "voltage": "voltage", "current": "current", "v_left": "speed"}


_ROLLING = {"wheel", "wheels", "track", "tread"}  # words of a speed, where nothing else is said
_WHOLE = {"curr"}  # no abbreviation of a quantity and a side
_ROTATIONS = {"orientation", "rotation", "quat", "quaternion"}
_COMPASS = {"x": {"east", "easting"}, "y": {"north", "northing"}}
_NO_PLACE = {
    *_ROTATIONS, "vel", "velocity", "speed", "linear", "twist",
    "mag", "magnetic", "magnetometer", "magnet", "compass", "field", "gravity", "force", "torque",
    "euler", "tilt", "angle", "joy", "stick", "imu",
}  # fmt: skip
"""Words of vectors that are no place."""


_TAG = re.compile(r"(?<![A-Z])(?<![a-z](?=[lr]))([lrLR])([0-9]+)(?![0-9a-z])")
"""A letter and a number, such as the second motor on the left, or the tag of the first robot."""


def spelled(name: str, names: Collection[str]) -> str:
    """Return a name with ``l2`` spelled as ``left2`` where the same with ``r2`` stands beside."""

    def side(tag: re.Match[str]) -> str:
        letter = tag[1]
        other = "lrLR"["rlRL".index(letter)]
        twin = f"{name[: tag.start()]}{other}{name[tag.end(1) :]}" in names
        return f"{'left' if letter in 'lL' else 'right'}{tag[2]}" if twin else tag[0]

    return _TAG.sub(side, name)


_QUANTITY = "speed|velocity|vel|rpm|wheel|motor|power|current|voltage"
_SIDE = "left|right|port|starboard"
_JOINED = re.compile(rf"({_QUANTITY})({_SIDE})|({_SIDE})({_QUANTITY})")
"""A quantity and a side without a sign between them."""


def words(name: str) -> list[str]:
    """Split a name into its words, in small letters; ``r1`` alone may be anything, and is none."""
    found: list[str] = []
    for part in split_words(re.sub(r"[0-9]+", " ", _TAG.sub(" ", split_unit(name)[0]))):
        word = part.lower()
        if word in _WHOLE:
            found.append(word)
            continue
        short = re.fullmatch(r"(v|w|p|i|u|rpm|vel|cur|omega|n)(l|r)", word)
        if joined := _JOINED.fullmatch(word):
            found += [part for part in joined.groups() if part]
            continue
        plural = len(word) > _SHORTEST and word not in _KNOWN and word.removesuffix("s") in _KNOWN
        found += [short[1], short[2]] if short else [word.removesuffix("s") if plural else word]
    return found


def side_of(name: str, names: Collection[str] = ()) -> str:
    """Return the side that a name among others gives, ``"left"`` or ``"right"``; empty for none."""
    said = set(words(spelled(name, names)))
    sides = [side for side in ("left", "right") if said & _WORDS[side]]
    return sides[0] if len(sides) == 1 else ""


def _groups(names: Iterable[str]) -> dict[str, tuple[str, ...]]:
    """Return names that differ in nothing but the wheel or the number of the motor."""
    alike: dict[object, list[str]] = {}
    every = list(names)
    for name in every:
        stated, unit = words(spelled(name, every)), split_unit(name)[1]
        number = re.search(r"(?<![.\d])\d+", split_unit(name)[0])
        if number is None and not set(stated) & set(_PLACES):
            continue
        key = tuple(word for word in (_PLACES.get(word, word) for word in stated) if word)
        alike.setdefault((key, unit, number is None), []).append(name)
    return {name: tuple(group) for group in alike.values() for name in group}


_OWN = 10.0  # score of a name that is the channel's own


def _quantities(name: str) -> dict[str, bool]:
    """Return of which quantities, and of which side, a name speaks."""
    stated = words(name)
    said = set(stated)
    has = {kind: bool(said & names) for kind, names in _WORDS.items()}
    last, units = stated[-1:], []
    for quantity, kind in _TOLD_BY_UNIT.items():
        unit = unit_in(quantity, name).unit
        units += [kind] if unit else []
        last = stated[-2:-1] if [unit.lower()] == stated[-1:] else last
    spoken = [kind for kind in _ELECTRIC if has[kind]]
    has |= dict.fromkeys(units, True)
    if "v" in said and said & _BATTERY:
        has["voltage"], has["speed"] = True, bool(said & (_WORDS["speed"] - {"v", "w"}))
    # Of several quantities, as where topics are named for one, the name ends with its own.
    ends = [kind for kind in ("speed", *_ELECTRIC) if _WORDS[kind] & {*last} - _ROLLING]
    if len(ends) == 1 and len(last[0]) > 1:
        has |= {kind: kind in ends for kind in ("speed", *_ELECTRIC)}
    stating = [kind for kind in units if kind in _ELECTRIC]
    if len(stating) == 1 and spoken and stating[0] not in spoken:  # power_v holds volts
        has |= {kind: kind in stating for kind in ("speed", *_ELECTRIC)}
    return has


def _score(channel: str, name: str) -> float:
    """How well a name fits a channel; 0 if not at all."""
    stated = words(name)
    said, has = set(stated), _quantities(name)
    if name.strip() == channel:
        return _OWN
    other = _NOT_MEASURED - {"position"} if channel in ("x", "y") else _NOT_MEASURED
    if counting(channel, unit_in(channel, name).unit):  # of charge or energy, which its unit says
        other = other - {"charge", "capacity", "count"}
    if channel.startswith("v_") and unit_in(channel, name).unit in SPEED:  # of no count
        other = other - {"encoder", "min"}
    wanted = bool(said & other) or stated[-1:] == ["status"]
    wanted = wanted or ("input" in said and not any(has[kind] for kind in _ELECTRIC))
    quantity, _, side = channel.partition("_")
    sided = has["left"] != has["right"]
    if channel == "t":
        return (3.0 if stated and stated[-1] in _WORDS["time"] else 2.0) * has["time"]
    if wanted and channel != "temperature":
        return 0.0
    if side in ("left", "right"):
        if not (sided and has[side]):
            return 0.0
        kinds = {"v": "speed", "p": "power", "voltage": "voltage", "current": "current"}
        electric = has["power"] or has["voltage"] or has["current"]
        if quantity == "v":
            bare = said <= _WORDS[side] | _MEASURED and not electric
            sure = 0.5 * bool(said & _WORDS["speed"] - _ROLLING)
            return 0.0 if electric else (1.5 + sure) * has["speed"] or 1.0 * bare
        own = 0.5 * bool(said & {"motor", "phase", "iq"})  # a motor's, not what it draws
        return (2.0 - own) * has[kinds[quantity]]
    if sided and not (said & {"x", "y"}):
        return 0.0
    if channel in ("power", "voltage", "current"):
        others = [kind for kind in _ELECTRIC if kind != channel]
        whole = 0.5 * bool(said & (_BATTERY | {"total"}))
        return (2.0 + whole) * has[channel] * (not any(has[other] for other in others))
    if channel in ("x", "y"):
        last = words(unit_in("x", name).bare)[-1:]
        if channel in "xy" and last and last[0] in _COMPASS[channel]:
            return 1.5
        place = said & {"pos", "pose", "position", "odom", "odometry", "slam", "gps", "map"}
        vector = has["turn"] or has["accel"] or bool(said & _NO_PLACE)
        return (1.0 + bool(place)) * (last == [channel]) * (not vector)
    if channel == "yaw":
        return 2.0 * has["yaw"] * (not (said & {"rate", "vel", "velocity", "speed", "dot"}))
    if channel == "yaw_rate":
        named = has["yaw"] and said & {"rate", "vel", "velocity", "speed", "dot"}
        z = "z" in said and has["turn"]
        alone = said & {"yawrate", "wz", "gz", "gierrate", "drehrate"}
        named = named or ("turn" in said and said & {"rate", "speed", "velocity"})
        return 3.0 * bool(named) + 2.0 * bool(z) + 2.0 * bool(alone)
    if channel == "accel_x":
        return 2.0 * (has["accel"] and bool(said & {"x", "ax"}))
    if channel == "temperature":
        return 0.0  # a name does not show whose it is
    return 0.0


def _quaternions(names: Collection[str]) -> set[str]:
    """Return names of the w components of quaternions, which hold no watts."""
    there = {name.lower() for name in names}
    return {
        name for name in names if name.lower().endswith("w")
        and (f"{name.lower()[:-1]}z" in there or _ROTATIONS & set(words(name)))
    }  # fmt: skip


def guess_encoders(names: Iterable[str]) -> dict[str, Column]:
    """Guess which names are encoders' of the left and right wheels; none where one is missing."""
    wanted = {"cmd", "command", "set", "setpoint", "target", "desired", "ref", "goal", "err",
             "error", "cov", "covariance", "temp"}  # fmt: skip
    every = list(names)
    counted = [
        n for n in every if not wanted & set(words(n))
        and (ENCODER & set(words(n)) or (_GONE & set(words(n)) and unit_in("x", n).unit))
    ]  # fmt: skip
    groups = _groups(counted)
    found: dict[str, Column] = {}
    for side in ("left", "right"):
        own = [n for n in counted if side_of(n, counted) == side]
        name, channel = next(iter(own), ""), f"v_{side}"
        rest = tuple(n for n in groups.get(name, ()) if n != name and n in own)
        if name:
            unit = unit_in(channel, name).unit
            found[channel] = Column(field=name, unit=unit, plus=rest, channel=channel)
    return found if len(found) == 2 else {}


def numbered_speeds(names: Iterable[str]) -> tuple[str, ...]:
    """Return names of wheels' or motors' speeds that a number distinguishes, not a side."""
    kinds = _WORDS["speed"] | ENCODER | {"dist", "distance"}
    groups: dict[tuple[str, ...], list[str]] = {}
    every = list(names)
    for name in every:
        rail = re.search(r"\d_?v\d*$", name, re.IGNORECASE)  # of 12 V, no wheel's
        if rail or side_of(name, every) or electric(name, every):
            continue
        if re.search(r"\d", name) and kinds & set(words(name)):
            groups.setdefault(tuple(words(name)), []).append(name)
    return tuple(next((group for group in groups.values() if len(group) > 1), ()))


def of_one_wheel(name: str) -> bool:
    """Return whether a name is that of a wheel, or its motor, of which a side has several."""
    return bool(set(words(name)) & set(_PLACES))


def halves(name: str, others: Iterable[str]) -> list[str]:
    """Return names that differ from one in a single word alone: of another side, it may be."""
    stated = _tokens(name)
    found = []
    for other in others:
        pairs = list(zip(stated, _tokens(other), strict=False))
        same = {one for one, twin in pairs if one == twin}
        alike = len(stated) == len(_tokens(other)) == len(pairs) == len(same) + 1
        if alike and same:
            found.append(other)
    return found


_OF_ALL = {"total", "sum", "overall", "whole", "combined"}
_OF_SUPPLY = {*_BATTERY, "vbus", "ibus", "vbat", "vbatt", "ibat", "ibatt", "ubat", "input",
              "in", "supply", "system", "psu", "dc"}  # fmt: skip
_OF_FEEDS = {
    "solar", "pv", "panel", "panels", "photovoltaic", "mppt", "charger", "charging", "charge",
    "dock", "docking", "generator", "genset", "alternator", "dynamo", "fuelcell", "harvester",
    "shore", "grid", "mains",
}  # fmt: skip
_OF_MOTORS = {"motor", "motors", "phase", "iq", "esc", "winding", "stator", "armature"}
_PROCESSED = {
    "filtered", "filt", "filter", "avg", "average", "averaged", "mean", "smooth", "smoothed",
    "raw", "lp", "lowpass", "median", "rms", "inst", "instant", "instantaneous", "est", "estimated",
}  # fmt: skip
_SECOND = {
    "aux", "auxiliary", "second", "secondary", "backup", "spare", "upper", "lower", "top", "bottom",
    "front", "rear", "back", "mid", "middle", "centre", "center", "slave", "inner", "outer", "b",
}  # fmt: skip
"""Words for one of several of a kind."""


def rank(name: str, channel: str = "") -> int:
    """Return how surely a name is that of the whole robot: of all, of its supply, of any."""
    said = set(_tokens(name)) | set(words(name))
    if name.strip() == channel or said & _OF_ALL:
        return 2
    return 1 if said & _OF_SUPPLY else 0


def feeds(name: str) -> bool:
    """Return whether a name is of what feeds a robot beside its battery."""
    return bool(set(_tokens(name)) & _OF_FEEDS)


def of_motor(name: str) -> bool:
    """Return whether a name is of a motor's own current or power."""
    return bool(set(_tokens(name)) & _OF_MOTORS)


def same_reading(name: str, other: str) -> bool:
    """Return whether two names differ in how a reading was processed alone."""
    one, two = ({*_tokens(part)} for part in (name, other))
    return one != two and one - _PROCESSED == two - _PROCESSED


def plainer(name: str, other: str) -> bool:
    """Return whether a name says less than another one, which is thus of a part."""
    one, two = ({*_tokens(part)} for part in (name, other))
    more = two - one
    return one < two and not more & _SECOND and not any(part.isdecimal() for part in more)


def siblings(one: Column, names: Iterable[str]) -> list[str]:
    """Return names like a power's, or a torque's, that differ in the wheel or a number alone."""
    side = one.channel.removeprefix("p_") if one.channel.startswith("p_") else ""
    summed = {one.field, *one.plus}
    every = list(names)
    alike = {name for group in [_groups(every)] for own in summed for name in group.get(own, ())}
    return sorted(
        name for name in alike - {*one.names} if side_of(name, every) in ("", side) or not side
    )


def voltages_of(currents: Iterable[str], names: Iterable[str]) -> tuple[str, ...]:
    """Return the voltage that is named like each current but for the quantity, where it is."""
    every = list(names)

    def key(name: str, kind: str) -> tuple[list[str], list[str]]:
        bare = unit_in(kind, spelled(name, every)).bare
        return [word for word in words(bare) if word not in _WORDS[kind]], re.findall(r"\d+", bare)

    there = [
        name for name in every if not set(words(name)) & _NOT_MEASURED
        and (set(words(name)) & _WORDS["voltage"] or unit_in("voltage", name).unit)
    ]  # fmt: skip
    found = []
    for current in currents:
        own = [name for name in there if key(name, "voltage") == key(current, "current")]
        found += own if len(own) == 1 else []
    return tuple(found)


def _tokens(name: str) -> list[str]:
    return re.findall(r"[^\W_]+", name.lower())


def guess_ahead(names: Iterable[str]) -> list[str]:
    """Return names that seem to be of the robot's own speed, of no side of it."""
    found = []
    for name in names:
        said = set(words(name))
        other = said & (_NOT_MEASURED | _WORDS["left"] | _WORDS["right"] | {"angular", "y", "z"})
        fast = said & {"speed", "velocity", "vel", "groundspeed", "spd", "speeds", "linear", "vx"}
        wheel = said & {"wheel", "wheels", "motor", "rpm", "angular", "fan", "wind"}
        if fast and not other and not wheel:
            found.append(name)
    return found


def guess_turns(names: Iterable[str]) -> list[str]:
    """Return names that seem to be of the robot's own turn rate."""
    return [name for name in names if _score("yaw_rate", name) > 0.0]


CHANNELS = (
    "t", "v_left", "v_right", "p_left", "p_right", "current_left", "current_right", "voltage_left",
    "voltage_right", "power", "voltage", "current", "x", "y", "yaw", "yaw_rate", "accel_x",
)  # fmt: skip


class ColumnCandidate(NamedTuple):
    """A name that may serve as a channel, how well it fits, and why."""

    column: Column
    score: float
    reason: str


def candidates(
    names: Iterable[str], taken: Collection[str] = ()
) -> dict[str, tuple[ColumnCandidate, ...]]:
    """Return which names may be which channel, the best first, with their units if they say so."""
    every = list(names)
    alias = {name: _lettered(spelled(name, every), every) for name in every}
    others = {*taken, *_quaternions(every)}
    left = [name for name in every if name not in others]
    found: dict[str, tuple[ColumnCandidate, ...]] = {}
    for channel in CHANNELS:
        quantity = channel.partition("_")[0]
        quantity = quantity if quantity in ("current", "voltage") else channel
        rated = []
        for name in left:
            score, unit = _score(channel, alias[name]), unit_in(quantity, name).unit
            why = "its name is the channel's" if score >= _OWN else "by its name"
            if unit:
                score += 1.0 * (score > 0.0)
                why = f"by its name, in [{unit}]"
            elif split_unit(name)[1] and channel != "t":
                score = min(score, 0.5)  # it says that it is something else
            if score >= 1.0:
                rated.append(
                    ColumnCandidate(Column(field=name, unit=unit, channel=channel), score, why)
                )
        found[channel] = tuple(sorted(rated, key=lambda one: -one.score))
    return found


def reasons(channel: str, chosen: Iterable[str], names: Iterable[str]) -> str:
    """Say why each of some names among all may serve as a channel, and how well it fits."""
    rated = {one.column.field: one for one in candidates(names).get(channel, ())}
    return ", ".join(
        f"{name} {rated[name].reason} (score {rated[name].score:g})" if name in rated
        else f"{name} by its side, number or readings"
        for name in dict.fromkeys(chosen)
    )  # fmt: skip


def guess(names: Iterable[str], taken: Collection[str] = ()) -> dict[str, Column]:
    """Guess which name is which channel, and in which unit if it says so."""
    every = list(names)
    groups = _groups([name for name in every if name not in {*taken, *_quaternions(every)}])
    rated = [
        (-one.score, every.index(one.column.field), one.column)
        for several in candidates(every, taken).values() for one in several
    ]  # fmt: skip
    found = _stamp([name for name in every if name not in taken])
    used: set[str] = {name for one in found.values() for name in one.names}
    for _, _, one in sorted(rated, key=lambda item: item[:2]):
        if one.channel in found or one.field in used:
            continue
        if one.channel.partition("_")[0] in ("v", "p", "current", "power"):
            alike = groups.get(one.field, (one.field,))
            one = one.model_copy(update={"plus": tuple(n for n in alike if n != one.field)})
        found[one.channel] = one
        used |= set(one.names)
    return {channel: found[channel] for channel in CHANNELS if channel in found}


_LETTER = re.compile(r"(.*[a-z0-9][\W_])([a-f])", re.IGNORECASE)


def _lettered(name: str, names: Collection[str]) -> str:
    """Return a name whose last letter counts, as of ``power_a`` beside ``power_b``, without it."""
    match = _LETTER.fullmatch(name)
    if match is None:
        return name
    letters = "abcdef" if match[2].islower() else "ABCDEF"
    twins = [letter for letter in letters if f"{match[1]}{letter}" in names]
    counts = len(twins) > 1 and twins == [*letters[: len(twins)]]
    return f"{match[1]}{letters.index(match[2]) + 1}" if counts else name


def electric(name: str, names: Collection[str] = ()) -> str:
    """Return the quantity of a name that is no command: power, voltage or current; else empty."""
    alias = _lettered(spelled(name, names), names)
    said = set(words(alias))
    if said & (_NOT_MEASURED - {"charge"}) or said & ENCODER:
        return ""
    has = _quantities(alias)
    return next((kind for kind in _ELECTRIC if has[kind]), "") if not has["speed"] else ""


def _stamp(names: Sequence[str]) -> dict[str, Column]:
    """Return the time of whole seconds and nanoseconds, as stamps of ROS messages are flattened."""
    for name in names:
        match = re.fullmatch(r"(.*stamp[\W_]*)secs?", name)
        parts = [
            n for n in names if match and re.fullmatch(re.escape(match[1]) + "n(ano)?secs?", n)
        ]
        if len(parts) == 1:
            weights = (1.0, 1e-9)
            return {
                "t": Column(field=name, unit="s", plus=(parts[0],), weights=weights, channel="t")
            }
    return {}
