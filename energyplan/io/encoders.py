"""How encoders count, and how far a robot goes per count, from what else its log tells."""

from __future__ import annotations

from collections.abc import Mapping
from math import isfinite, nan, pi
from typing import NamedTuple

import numpy as np

from energyplan.errors import DriveLogError
from energyplan.io.robot import Given
from energyplan.logs.align import find_runs
from energyplan.logs.clean import join_rows
from energyplan.logs.consistency import correlation, distance_ratio, yaw_rates
from energyplan.logs.guess import Guess, guess_ahead, guess_position
from energyplan.logs.mapping import RATE, SINCE, TOTAL, Column, column_from, unit_in
from energyplan.logs.tables import Table
from energyplan.path import FloatArray

_SOME = 20_000  # readings that suffice
_ENOUGH = 20  # of them
_ONE_WAY = 0.9  # mean sign of the steps of readings that go one way
_ALIKE = 0.9  # correlation from which a speed of the robot is that of its treads
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
        if len(mean) >= _ENOUGH and abs(correlation(np.abs(mean), np.abs(speed))) > _ALIKE:
            ratio = float(np.abs(mean) @ np.abs(speed)) / float(mean @ mean)
            return ratio, f"from {columns[_AHEAD].source}"
    return nan, ""
