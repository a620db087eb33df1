"""What a log lacks, and what of it could be meant."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import NoReturn

import numpy as np

from energyplan.errors import DriveLogError
from energyplan.logs.consistency import correlation
from energyplan.logs.guess import ENCODER, Guess, guess, halves, numbered_speeds, words
from energyplan.logs.tables import Table
from energyplan.path import FloatArray

_ALIKE = 0.9  # correlation from which two columns tell the same
_ONE_SIDE = 0.7  # correlation through the origin of the speeds of one side's wheels, at least
_HALF = 0.2  # of the larger, that powers or currents of two sides are at least


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
    numbers = [name for name, values in table.columns.items() if counts_rows(values)]
    if "t" in needed and numbers:
        hint += (
            f"; {numbers[0]!r} counts rows: if they come at a steady rate, give the time from row "
            f"to row, as in t={numbers[0]}[*0.05] for 50 ms"
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
