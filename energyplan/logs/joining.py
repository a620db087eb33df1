"""Rows that hold a part of the channels each: of several sources, or of what changed alone."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from energyplan.logs.align import Series, align
from energyplan.path import FloatArray

RECORDING = 20
"""Rows from which a stretch counts as a recording of its own."""

_TOGETHER = 0.8
"""Share of a channel's rows that hold the others too, from which rows are whole."""

_EXPECTED = 5.0
"""Repeated readings that must be expected, were readings written whatever they are."""

_FEW = 0.2
"""Part of the repeats to expect up to which a logger writes only what changed."""

_REGULAR = 0.9
"""Share of readings that come after the usual number of rows where they are more seldom than rows,
not blank for want of a change."""


class Held(NamedTuple):
    """Columns with the readings that held, and the rows of each in which a blank was filled."""

    columns: dict[str, FloatArray]
    rows: dict[str, NDArray[np.intp]]


def hold_unchanged(columns: Mapping[str, FloatArray]) -> Held:
    """Fill the blanks of a table whose logger writes a reading only where it differs.

    Such a column never repeats the reading before, though it has few values: of `n` readings, drawn
    in any order, ``n`` times the sum of the squared shares of its values would. Where readings are
    left out for another reason, or come more seldom than rows, they do repeat.
    """
    blanks = {name: np.isnan(values) for name, values in columns.items()}
    found, changing = [], False
    for name, blank in blanks.items():
        readings = columns[name][~blank]
        if len(readings) < 2 or not np.any(blank):
            continue
        counts = np.unique(readings, return_counts=True)[1]
        expected = float(np.sum(counts * (counts - 1.0))) / len(readings)
        if np.count_nonzero(np.diff(readings) == 0.0) > _FEW * expected:
            continue
        changing |= expected >= _EXPECTED
        between = np.diff(np.flatnonzero(~blank))
        usual = int(np.median(between))
        if usual == 1 or np.mean(between == usual) < _REGULAR:
            found.append(name)
    if not changing:
        return Held(dict(columns), {})
    whole = [values for name, values in columns.items() if not np.any(blanks[name])]
    ends = _instants(whole, len(next(iter(columns.values()))))
    made, rows = dict(columns), {}
    for name in found:
        blank, values = blanks[name], columns[name]
        last = np.maximum.accumulate(np.where(blank, -1, np.arange(len(blank))))[ends]
        made[name] = np.where(last >= 0, values[last], np.nan)
        rows[name] = np.flatnonzero(blank & (last >= 0))
    return Held(made, rows)


def _instants(whole: Sequence[FloatArray], count: int) -> NDArray[np.intp]:
    """Return the last row of each row's instant: rows alike in the columns without a blank."""
    if not whole:
        return np.arange(count)
    ends = np.append(np.any([np.diff(values) != 0.0 for values in whole], axis=0), True)
    at = np.flatnonzero(ends)
    return np.asarray(np.repeat(at, np.diff(at, prepend=-1)))


class Joined(NamedTuple):
    """Channels of several sources on the rows of one of them."""

    channels: dict[str, FloatArray]  # (n,): the channels
    rows: NDArray[np.intp]  # (n,): the rows that were kept
    how: dict[str, str]  # how channels came that had rows of their own


def join_rows(channels: Mapping[str, FloatArray], needed: Collection[str]) -> Joined | None:
    """Join rows that hold a part of the channels each, as of messages from several sources."""
    known = {name: np.isfinite(values) for name, values in channels.items()}
    clock = np.flatnonzero(known["t"] & known["v_left"])
    fewest = min(np.count_nonzero(known[name]) for name in needed)
    whole = np.count_nonzero(np.all([known[name] for name in needed], axis=0))
    t = channels["t"][clock]
    apart = whole < _TOGETHER * fewest
    if fewest < RECORDING or not apart or len(t) < 2 or np.any(np.diff(t) <= 0):
        return None
    found, how = {"t": t}, {}
    for name, values in channels.items():
        there = np.flatnonzero(known["t"] & known[name])
        if name == "t" or np.count_nonzero(known[name][clock]) > _TOGETHER * len(clock):
            found.setdefault(name, values[clock])
            continue
        own, readings = channels["t"][there], values[there]
        later = np.append(True, np.diff(own) > 0)
        if not np.all(np.diff(own) >= 0) or np.count_nonzero(later) < 2:
            return None
        readings = np.unwrap(readings) if name == "yaw" else readings
        aligned = align(Series(own[later], readings[later]), t)
        found[name], how[name] = aligned.values, aligned.how
    return Joined(found, clock, how)
