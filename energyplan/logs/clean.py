"""Cleaning of a drive log's samples: unusable ones are left out, and their number is reported."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass
from math import nan
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from energyplan.errors import DriveLogError
from energyplan.logs.align import AS_LOGGED, Series, align, gap_limit, usable, usable_rows
from energyplan.logs.mapping import ROW
from energyplan.motion import LOGGED
from energyplan.path import FloatArray
from energyplan.records import described

if TYPE_CHECKING:  # which imports this module
    from energyplan.logs import DriveLog

LIMITS = {name: (one.least, one.most, one.unit) for name, one in LOGGED.items()}
"""Range in which a reading is possible at all, by channel."""
ANY = (-1e30, 1e30, "in its unit")
"""The same of other channels."""


class CleaningLimits(NamedTuple):
    """How much of a log may be mended, and from which on it is clear how."""

    most: float = 0.99  # share of readings that are possible where a channel is in its unit
    few: float = 0.05  # share of readings that glitches may have
    enough: int = 20  # readings below which nothing is concluded
    # share of a channel's rows that hold the others too, from which rows are whole
    together: float = 0.8
    # repeated readings that must be expected, were readings written whatever they are
    expected: float = 5.0
    # share of readings out of range that is taken for glitches, not for a wrong unit
    stray: float = 0.01
    bridge: float = 1.0  # longest hole in a further channel that is bridged by interpolation [s]
    late: float = 0.01  # share of the rows that may come late
    latest: float = 5.0  # how late they may come [s]
    shared: float = 0.2  # share of the rows that may have the time of another
    one_time: int = 8  # rows of one time, at most
    # share of the steps in which a heading may change by more than a third of a turn
    far: float = 0.01
    sparse: float = 0.1  # share of rows that may be set aside for want of a further channel


_CLEANING = CleaningLimits()
_OTHER_UNITS = {
    "s": "ns", "rad": "deg", "rad/s": "deg/s", "V": "mV", "A": "mA", "W": "mW",
    "m/s": "km/h], [cm/s] or [mm/s], of wheels' rates [rad/s*RADIUS] or [rpm*RADIUS], or, if "
    "these are the motors', divide by the gear ratio, too, as in [rpm*0.0033",
}  # fmt: skip
"""In which unit readings are that are impossible in the library's."""
_TURNS = {"deg/s": 600.0, "mrad/s": 6e3, "cdeg/s": 3e4, "mdps": 6e5}
"""In which unit turn rates are, by how large they get."""


def possible(channels: Mapping[str, FloatArray]) -> bool:
    """Return whether nearly all readings are such as a robot's channels can hold."""
    for name, values in channels.items():
        low, high, _ = LIMITS.get(name, ANY)
        if np.mean((values >= low) & (values <= high)) < _CLEANING.most:
            return False
    return True


_STANDS_OUT = {
    **dict.fromkeys(("v_left", "v_right"), (3.0, 0.0)),
    **dict.fromkeys(("p_left", "p_right", "power", "current"), (8.0, 0.0)),
    "yaw_rate": (8.0, 3.0),  # [rad/s]
}
"""By how much a glitch stands out, and how large it is, by channel.

In units of what the channel holds for three readings. Of some 120 real drives and drives of a
physics engine, also at one reading in two seconds, speeds stood out by 1.6 at most, powers by 3.2.
"""


def find_glitches(channel: str, values: FloatArray) -> NDArray[np.bool_]:
    """Return which readings stand out from those around as nothing that lasts does."""
    lost = np.zeros(len(values), bool)
    known = np.flatnonzero(np.isfinite(values))
    if channel not in _STANDS_OUT or len(known) < _CLEANING.enough:
        return lost
    factor, least = _STANDS_OUT[channel]
    readings = values[known]
    lasting = np.median(sliding_window_view(np.pad(readings, 2, mode="reflect"), 5), axis=-1)
    typical = float(np.quantile(np.abs(lasting), 0.99))
    apart = (np.abs(readings - lasting) > factor * typical) & (np.abs(readings) > least)
    if typical > 0.0 and np.mean(apart) <= _CLEANING.few:
        lost[known[apart]] = True
    return lost


RECORDING = 20
"""Rows from which a stretch counts as a recording of its own."""


def writes_changes(values: FloatArray) -> bool:
    """Return whether a logger wrote a reading only where it differs from the one before."""
    known = np.flatnonzero(np.isfinite(values))
    readings = values[known]
    if len(readings) in (0, len(values)):
        return False
    counts = np.unique(readings, return_counts=True)[1]
    expected = float(np.sum(counts * (counts - 1.0))) / len(readings)
    repeats = np.count_nonzero(np.diff(readings) == 0.0)
    between = np.diff(known)  # readings of a slow sensor come at a steady rate
    slow = len(between) and np.median(between) > 1 and np.mean(between == np.median(between)) > 0.9
    return bool(expected >= _CLEANING.expected and repeats <= 0.2 * expected and not slow)


class Joined(NamedTuple):
    """Channels of several sources on the rows of one of them."""

    channels: dict[str, FloatArray]  # (n,): the channels
    rows: NDArray[np.intp]  # (n,): the rows that were kept
    how: dict[str, str]  # how channels came that had rows of their own


def join_rows(series: Mapping[str, Series], needed: Collection[str]) -> Joined | None:
    """Bring channels to the times of the left tread speed; None where all stand in its rows."""
    own = series["v_left"].t
    known = {name: np.isfinite(one.values) for name, one in series.items()}
    clock = np.flatnonzero(np.isfinite(own) & known["v_left"])
    table = all(one.t is own for one in series.values())
    if table:
        fewest = min(np.count_nonzero(known[name]) for name in needed)
        whole = np.count_nonzero(np.all([known[name] for name in needed], axis=0))
        steps = np.diff(own[clock])
        if (
            fewest < RECORDING
            or whole >= _CLEANING.together * fewest
            or np.any(steps <= 0)
            or not len(steps)
        ):
            return None
    else:  # of messages with one time the first counts
        clock = clock[np.append(True, np.diff(own[clock]) > 0)[: len(clock)]]
    t = own[clock]
    found, how = {"t": t}, {}
    for name, one in series.items():
        if name == "t":
            continue
        if one.t is own and np.count_nonzero(known[name][clock]) > _CLEANING.together * len(clock):
            found[name] = one.values[clock]
            continue
        times = one.t[np.isfinite(one.t) & known[name]]
        there = usable(one)
        if table and (np.any(np.diff(times) < 0) or len(there.t) < 2):
            return None
        values = np.unwrap(there.values) if name == "yaw" else there.values
        aligned = align(Series(there.t, values), t)
        found[name] = aligned.values
        if aligned.how != AS_LOGGED:
            how[name] = aligned.how
    return Joined(found, clock, how)


Place = Callable[[int], str]


@dataclass(frozen=True)
class SetAside:
    """Samples that a log left out or mended, and why."""

    reason: str  # what was wrong with them, and what was done
    count: int  # how many samples
    where: str  # where the first ones were

    def __str__(self) -> str:
        return f"{self.count} samples: {self.reason} ({self.where})"


def set_aside_by_drive(logs: Iterable[DriveLog]) -> dict[str, dict[str, int]]:
    """Count samples that were left out or mended, by drive and reason."""
    counts: dict[str, Counter[str]] = {}
    for log in logs:
        for item in log.set_aside:
            counts.setdefault(log.name, Counter())[item.reason] += item.count
    return {name: dict(reasons) for name, reasons in counts.items()}


@dataclass(frozen=True)
class Cleaned:
    """Channels fit for a log, and what was done to get them."""

    channels: dict[str, FloatArray]
    rows: NDArray[np.intp]
    set_aside: list[SetAside]
    warnings: list[str]


POWER_WAYS = (("p_left", "p_right"), ("power",), ("voltage", "current"))
"""Channels that make a power, by preference."""


def total_power(channels: Mapping[str, FloatArray]) -> FloatArray:
    """Return the power from whichever channels there are [W], positive when drawn."""
    one, *other = next(way for way in POWER_WAYS if set(way) <= set(channels))
    if not other:
        return channels[one]
    left, right = channels[one], channels[other[0]]
    return left * right if one == "voltage" else left + right


def needed_channels(names: Collection[str], label: str) -> tuple[str, ...]:
    """Channels without which a sample is of no use: time, tread speeds and power."""
    if not isinstance(names, Iterable):
        raise DriveLogError(f"{label} is {described(names)}; give channels by name")
    there = ", ".join(sorted(names)[:20]) or "nothing"
    if {"x", "y", "yaw"} <= set(names) <= {"t", "x", "y", "yaw", "v", "omega"}:
        raise DriveLogError(
            f"{label} looks like a path or a trajectory, with {there}: energyplan check reads it; "
            "a drive log has t, v_left, v_right and a power"
        )
    for channel in ("t", "v_left", "v_right"):
        if channel not in names:
            raise DriveLogError(
                f"{label}: the channel {channel!r} is missing; the log has {there}; map a column to"
                f" it, such as {channel}=NAME, or let energyplan start find the columns"
            )
    for way in POWER_WAYS:
        if set(way) <= set(names):
            return ("t", "v_left", "v_right", *way)
    raise DriveLogError(
        f"{label}: power is missing; give p_left and p_right, or power, or voltage and current; "
        f"the log has {there}"
    )


def clean(series: Mapping[str, Series], label: str, place: Place) -> Cleaned:
    """Set aside what cannot be used, and refuse what cannot be mended."""
    needed = needed_channels({"t", *series}, label)
    cleaner = _Cleaner(series, label, place)
    for name in [*cleaner.channels]:
        cleaner.hold(name)
        if cleaner.many_strays(name):
            cleaner.blank_glitches(name)  # several in a short log are no other unit
        cleaner.blank_strays(name)
        cleaner.blank_glitches(name)
    cleaner.join(needed)
    for name in needed:
        cleaner.drop(
            ~np.isfinite(cleaner.channels[name]), f"{name} has no usable reading; left out"
        )
    cleaner.order()
    for name in [name for name in cleaner.channels if name not in needed]:
        cleaner.bridge(name)
    cleaner.follow_heading()
    if len(cleaner.rows) < 2:
        said = "".join(f"; {item}" for item in cleaner.aside)
        raise DriveLogError(
            f"{label}: {len(cleaner.rows)} usable samples are left, two are needed{said}"
        )
    return Cleaned(cleaner.channels, cleaner.rows, cleaner.aside, cleaner.warnings)


class _Cleaner:
    """Channels on their way to a log; each step keeps count of what it takes away."""

    def __init__(self, series: Mapping[str, Series], label: str, place: Place) -> None:
        own = series["v_left"].t
        self.apart = {name: one.t for name, one in series.items() if one.t is not own}
        self.channels = {} if "t" in series else {"t": np.array(own, float)}
        self.channels |= {name: np.array(one.values, float) for name, one in series.items()}
        self.label, self.place = label, place
        self.rows = np.arange(len(own))
        self.aside: list[SetAside] = []
        self.warnings: list[str] = []

    def note(self, lost: NDArray[np.bool_], reason: str, name: str = "") -> None:
        """Count samples."""
        if np.any(lost):
            where = self.where(lost, name)
            self.aside.append(SetAside(reason, int(np.count_nonzero(lost)), where))

    def where(self, chosen: NDArray[np.bool_], name: str = "") -> str:
        """Name the first few of the chosen samples."""
        some = np.flatnonzero(chosen)[:4]
        t = self.apart.get(name)
        names = ", ".join(
            self.place(int(self.rows[k])) if t is None else f"{t[k]:.3f} s" for k in some[:3]
        )
        return f"{names}, ..." if len(some) > 3 else names

    def drop(self, lost: NDArray[np.bool_], reason: str) -> None:
        """Take samples away."""
        if np.any(lost):
            self.note(lost, reason)
            self.channels = {name: values[~lost] for name, values in self.channels.items()}
            self.rows = self.rows[~lost]

    def strays(self, name: str) -> NDArray[np.bool_]:
        """Return which readings are impossible."""
        low, high, _ = LIMITS.get(name, ANY)
        return np.asarray((self.channels[name] < low) | (self.channels[name] > high))

    def many_strays(self, name: str) -> bool:
        """Return whether more readings are impossible than glitches are."""
        stray = self.strays(name)
        return bool(np.count_nonzero(stray) > max(1.0, _CLEANING.stray * len(stray)))

    def blank_strays(self, name: str) -> None:
        """Blank the few readings that are impossible; many of them mean a wrong unit."""
        low, high, unit = LIMITS.get(name, ANY)
        values, stray = self.channels[name], self.strays(name)
        if self.many_strays(name):
            count = int(np.count_nonzero(stray))
            value = float(values[stray][0])
            kinds = np.unique(values[stray])
            other = _OTHER_UNITS.get(unit, "*0.001")
            if unit == "rad/s":
                typical = float(np.quantile(np.abs(values[np.isfinite(values)]), 0.99))
                other = next((u for u, high in _TURNS.items() if typical <= high), "*FACTOR")
            blank = f"; where {value:g} stands for no reading, leave the cell empty"
            raise DriveLogError(
                f"{self.label}, {self.where(stray, name)}: {name} is {value:g} {unit}, which no "
                f"robot reaches; {count} of {len(values)} readings are outside {low:g} to {high:g} "
                f"{unit}; name its unit, as in {name}=NAME[{other}]"
                f"{blank if len(kinds) == 1 and count < len(values) else ''}"
            )
        self.note(stray, f"{name} is outside {low:g} to {high:g} {unit}; blanked", name)
        values[stray] = np.nan

    def blank_glitches(self, name: str) -> None:
        """Blank readings that stand out."""
        lost = find_glitches(name, self.channels[name])
        self.note(lost, f"{name} stands out for one reading or two; blanked", name)
        self.channels[name][lost] = np.nan

    def hold(self, name: str) -> None:
        """Fill the blanks of a channel whose logger writes what changes alone."""
        values = self.channels[name]
        if name == "t" or not writes_changes(values):
            return
        last = np.maximum.accumulate(np.where(np.isnan(values), -1, np.arange(len(values))))
        blank = np.isnan(values) & (last >= 0)
        self.note(blank, f"{name} is blank, as what does not change; held", name)
        self.channels[name] = np.where(last >= 0, values[last], np.nan)

    def join(self, needed: Collection[str]) -> None:
        """Bring channels that stand in rows of their own to those of the left tread speed."""
        own = self.channels["t"]
        joined = join_rows(
            {name: Series(self.apart.get(name, own), v) for name, v in self.channels.items()},
            needed,
        )
        if joined is None:
            return
        if self.apart:
            for name, values in self.channels.items():
                lost = ~usable_rows(Series(self.apart.get(name, own), values))
                self.note(lost, f"{name}: no value, or the time of that before; left out", name)
        self.channels, self.rows = joined.channels, self.rows[joined.rows]
        said = ", ".join(f"{name} {how}" for name, how in joined.how.items())
        rows = "" if self.apart else "each row holds some of the channels; "
        if said:
            self.warnings.append(f"{rows}at the times of v_left: {said}")

    def order(self) -> None:
        """Sort a few late rows, average those of one time, and refuse what is out of order."""
        again = np.ones(len(self.rows) - 1, bool) if len(self.rows) else np.zeros(0, bool)
        for values in self.channels.values():
            again &= (values[1:] == values[:-1]) | (np.isnan(values[1:]) & np.isnan(values[:-1]))
        self.drop(
            np.append(False, again)[: len(self.rows)], "the row repeats the one before; left out"
        )
        steps = np.diff(self.channels["t"])
        if len(steps) >= RECORDING and np.mean(steps < 0) > 0.9:
            self.pick(np.arange(len(self.rows))[::-1])
            self.warnings.append("the rows stand newest first; they are read backwards")
        elif np.any(steps < 0):
            self.drop(self.seen_before(), "the row repeats an earlier one; left out")
        self.sort()
        self.average()
        t = self.channels["t"]
        back = np.append(False, np.diff(t) <= 0)[: len(t)]
        if not np.any(back):
            return
        k = int(np.flatnonzero(back)[0])
        steps = np.diff(t)
        typical = float(np.median(np.abs(steps[steps != 0.0]))) if np.any(steps) else nan
        steady = f"of rows at a steady rate, map t={ROW}[*PERIOD] with the time from row to row [s]"
        why = (
            "recordings follow each other, a part stands twice, or the clock was set back or ran "
            f"over: give each recording a file of its own; or, {steady}"
        )
        if not np.any(steps < 0.0):
            coarse = f"counts in steps of {typical:.3g} s, or " if typical > 0.0 else ""
            why = f"the clock {coarse}stood still: {steady}"
        raise DriveLogError(
            f"{self.label}, {self.where(back)}: t does not increase: {t[k]:.6f} s follows "
            f"{t[k - 1]:.6f} s ({np.count_nonzero(back)} such steps in all): {why}"
        )

    def sort(self) -> None:
        """Sort rows of which a few came late."""
        t = self.channels["t"]
        late = np.append(False, np.diff(t) < 0)[: len(t)]
        if not np.any(late):
            return
        if (
            np.mean(late) > _CLEANING.late
            or np.max(np.maximum.accumulate(t) - t) > _CLEANING.latest
        ):
            return
        self.note(late, "the row is older than the one before; sorted by time")
        self.pick(np.argsort(t, kind="stable"))

    def pick(self, rows: NDArray[np.intp]) -> None:
        """Keep some rows, in their order."""
        self.channels = {name: values[rows] for name, values in self.channels.items()}
        self.rows = self.rows[rows]

    def seen_before(self) -> NDArray[np.bool_]:
        """Return which rows repeat an earlier one with its time, as where a part is repeated."""
        table = np.nan_to_num(np.column_stack(list(self.channels.values())), nan=np.inf)
        _, first = np.unique(table, axis=0, return_index=True)
        again = np.ones(len(table), bool)
        again[first] = False
        return again

    def average(self) -> None:
        """Average rows of one time, if there are few; spread those of a clock of whole steps."""
        t = self.channels["t"]
        steps = np.diff(t)
        if not np.any(steps == 0) or np.any(steps < 0):
            return
        first = np.flatnonzero(np.append(True, steps > 0))
        sizes = np.diff(np.append(first, len(t)))
        if len(first) >= RECORDING and np.median(sizes) > 1:
            rows, step = np.arange(len(t)), float(np.median(np.diff(t[first])))
            line = np.polynomial.Polynomial.fit(rows, t, 1)(rows)
            if np.max(np.abs(line - t)) < step:  # rows of a steady rate lie on a line
                self.note(np.repeat(sizes, sizes) > 1, "the row's time is that of another; spread")
                self.channels["t"] = line
                return
        if np.mean(steps == 0) > _CLEANING.shared or np.max(sizes) > _CLEANING.one_time:
            return  # the clock stood still, or is too coarse
        self.note(np.repeat(sizes, sizes) > 1, "the row's time is that of another; averaged")
        for name, values in self.channels.items():
            angle = name == "yaw"
            known = np.isfinite(values)
            filled = np.where(known, values, 0.0)
            filled = np.where(known, np.exp(1j * filled), 0.0) if angle else filled
            total = np.add.reduceat(filled, first)
            count = np.add.reduceat(known.astype(float), first)
            with np.errstate(invalid="ignore"):
                mean = np.angle(total) if angle else total / count
            self.channels[name] = np.where(count > 0, mean, np.nan)
        self.channels["t"], self.rows = t[first], self.rows[first]

    def bridge(self, name: str) -> None:
        """Fill short holes of a further channel; leave it out where most of it is missing."""
        values, t = self.channels[name], self.channels["t"]
        hole = ~np.isfinite(values)
        if not np.any(hole):
            return
        known = np.flatnonzero(~hole)
        if len(known):
            after = np.minimum(np.searchsorted(known, np.arange(len(t))), len(known) - 1)
            before = np.maximum(after - 1, 0)
            width = t[known[after]] - t[known[before]]
            inside = (t >= t[known[0]]) & (t <= t[known[-1]]) & (width <= _CLEANING.bridge)
            mended = hole & inside
            known_values = values[known]
            if name == "yaw":
                known_values = np.unwrap(known_values)
            filled = values.copy()
            filled[mended] = np.interp(t[mended], t[known], known_values)
            if name == "yaw":
                filled[known] = known_values
            self.note(mended, f"{name} has no usable reading; interpolated")
            self.channels[name], hole = filled, hole & ~mended
        share = np.count_nonzero(hole) / max(1, len(hole))
        if share > _CLEANING.sparse:
            self.warnings.append(
                f"{name} is left out: {share:.0%} of its readings are missing ({self.where(hole)})"
            )
            del self.channels[name]
        else:
            self.drop(
                hole, f"{name} has no usable reading for more than {_CLEANING.bridge:g} s; left out"
            )

    def follow_heading(self) -> None:
        """Leave out a heading, from 0 to one turn, that is read too seldom to show the turns."""
        yaw, t = self.channels.get("yaw"), self.channels["t"]
        if yaw is None or len(t) < 3 or np.ptp(yaw) > 2 * np.pi:
            return
        change = np.abs(np.angle(np.exp(1j * np.diff(yaw))))[np.diff(t) <= gap_limit(t)]
        far = np.count_nonzero(change > 2 * np.pi / 3)
        if far > max(1.0, _CLEANING.far * len(change)):
            self.warnings.append(
                f"yaw is left out: in {far / len(change):.0%} of the steps from reading to reading "
                "it changes by more than a third of a turn, which does not tell how far the robot"
                " turned, or which way; log it more often"
            )
            del self.channels["yaw"]
