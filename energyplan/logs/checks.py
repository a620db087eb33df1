"""What is wrong with a drive log's samples: cleaning, with a count of what was set aside."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from energyplan.errors import DriveLogError
from energyplan.kinds import described, numbers
from energyplan.logs.align import gap_limit
from energyplan.logs.clock import spread_bursts, unwrap_clock
from energyplan.logs.glitches import find_glitches
from energyplan.logs.joining import RECORDING, join_rows
from energyplan.logs.reach import ANY, LIMITS, likely_unit
from energyplan.path import FloatArray

Place = Callable[[int], str]

_STRAY = 0.01  # share of readings out of range that is taken for glitches, not for a wrong unit
_BRIDGE = 1.0  # longest hole in a further channel that is bridged by interpolation [s]
_PAUSE = 10.0  # time between recordings whose clocks begin anew [s]
_LATE = 0.01  # share of the rows that may come late
_LATEST = 5.0  # how late they may come [s]
_FAR = 0.01  # share of the steps in which a heading may change by more than a third of a turn
_SPARSE = 0.1  # share of rows that may be set aside for want of a further channel


@dataclass(frozen=True)
class SetAside:
    """Samples that a log left out or mended, and why."""

    reason: str  # what was wrong with them, and what was done
    count: int  # how many samples
    where: str  # where the first ones were

    def __str__(self) -> str:
        return f"{self.count} samples: {self.reason} ({self.where})"


def unchanged(
    held: Mapping[str, NDArray[np.intp]], used: Collection[str], place: Place
) -> list[SetAside]:
    """Count the cells of columns in use that are blank because the reading before still holds."""
    return [
        SetAside(
            f"{name} is blank, as what did not change is in this log; it holds",
            len(rows), ", ".join(place(int(row)) for row in rows[:3]),
        )
        for name, rows in held.items() if name in used
    ]  # fmt: skip


class _Cleaned(Protocol):
    """What has a name and says what was set aside, such as a drive log."""

    @property
    def name(self) -> str: ...
    @property
    def set_aside(self) -> tuple[SetAside, ...]: ...


def set_aside_by_drive(logs: Iterable[_Cleaned]) -> dict[str, dict[str, int]]:
    """Count samples that were left out or mended, by drive and reason."""
    counts: dict[str, dict[str, int]] = {}
    for log in logs:
        for item in log.set_aside:
            reasons = counts.setdefault(log.name, {})
            reasons[item.reason] = reasons.get(item.reason, 0) + item.count
    return counts


@dataclass(frozen=True)
class Cleaned:
    """Channels fit for a log, and what was done to get them."""

    channels: dict[str, FloatArray]
    rows: NDArray[np.intp]
    set_aside: list[SetAside]
    warnings: list[str]


def find_runs(t: FloatArray) -> list[slice]:
    """Stretches of samples without a gap."""
    cuts = np.flatnonzero(np.diff(t) > gap_limit(t)) + 1
    bounds = [0, *(int(cut) for cut in cuts), len(t)]
    return [slice(a, b) for a, b in pairwise(bounds)]


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
    for way in (("p_left", "p_right"), ("power",), ("voltage", "current")):
        if all(channel in names for channel in way):
            return ("t", "v_left", "v_right", *way)
    raise DriveLogError(
        f"{label}: power is missing; give p_left and p_right, or power, or voltage and current; "
        f"the log has {there}"
    )


def clean(columns: Mapping[str, ArrayLike], label: str, place: Place) -> Cleaned:
    """Set aside what cannot be used, and refuse what cannot be mended."""
    needed = needed_channels(columns, label)
    channels = {k: np.array(numbers(columns[k], f"{label}: {k}", DriveLogError)) for k in columns}
    shapes = {values.shape for values in channels.values()}
    if len(shapes) != 1 or len(next(iter(shapes))) != 1:
        raise DriveLogError(f"{label}: channels have shapes {shapes}; give rows of equal length")
    cleaner = _Cleaner(channels, label, place)
    for name in channels:
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
    for name in [name for name in channels if name not in needed]:
        cleaner.bridge(name)
    cleaner.follow_heading()
    if len(cleaner.rows) < 2:
        told = "".join(f"; {item}" for item in cleaner.aside)
        raise DriveLogError(
            f"{label}: {len(cleaner.rows)} usable samples are left, two are needed{told}"
        )
    return Cleaned(cleaner.channels, cleaner.rows, cleaner.aside, cleaner.warnings)


class _Cleaner:
    """Channels on their way to a log; each step keeps count of what it takes away."""

    def __init__(self, channels: dict[str, FloatArray], label: str, place: Place) -> None:
        self.channels, self.label, self.place = channels, label, place
        self.rows = np.arange(len(channels["t"]))
        self.aside: list[SetAside] = []
        self.warnings: list[str] = []

    def note(self, lost: NDArray[np.bool_], reason: str) -> None:
        """Count samples."""
        if np.any(lost):
            where = self.where(lost)
            self.aside.append(SetAside(reason, int(np.count_nonzero(lost)), where))

    def where(self, chosen: NDArray[np.bool_]) -> str:
        """Name the first few of the chosen samples."""
        some = self.rows[np.flatnonzero(chosen)[:4]]
        names = ", ".join(self.place(int(row)) for row in some[:3])
        return f"{names}, ..." if len(some) > 3 else names

    def drop(self, lost: NDArray[np.bool_], reason: str) -> None:
        """Take samples away."""
        if np.any(lost):
            self.note(lost, reason)
            self.channels = {name: values[~lost] for name, values in self.channels.items()}
            self.rows = self.rows[~lost]

    def strays(self, name: str) -> NDArray[np.bool_]:
        """Tell which readings are impossible."""
        low, high, _ = LIMITS.get(name, ANY)
        return np.asarray((self.channels[name] < low) | (self.channels[name] > high))

    def many_strays(self, name: str) -> bool:
        """Tell whether more readings are impossible than glitches are."""
        stray = self.strays(name)
        return bool(np.count_nonzero(stray) > max(1.0, _STRAY * len(stray)))

    def blank_strays(self, name: str) -> None:
        """Blank the few readings that are impossible; many of them mean a wrong unit."""
        low, high, unit = LIMITS.get(name, ANY)
        values, stray = self.channels[name], self.strays(name)
        if self.many_strays(name):
            count = int(np.count_nonzero(stray))
            value = float(values[stray][0])
            raise DriveLogError(
                f"{self.label}, {self.where(stray)}: {name} is {value:g} {unit}, which no robot "
                f"reaches; {count} of {len(values)} readings are outside {low:g} to {high:g} "
                f"{unit}; name its unit, as in {name}=NAME[{likely_unit(name, unit, values)}]"
            )
        self.note(stray, f"{name} is outside {low:g} to {high:g} {unit}; blanked")
        values[stray] = np.nan

    def blank_glitches(self, name: str) -> None:
        """Blank readings that stand out."""
        lost = find_glitches(name, self.channels[name])
        self.note(lost, f"{name} stands out for one reading or two; blanked")
        self.channels[name][lost] = np.nan

    def join(self, needed: Collection[str]) -> None:
        """Bring channels that stand in rows of their own to those of the left tread speed."""
        joined = join_rows(self.channels, needed)
        if joined is None:
            return
        self.channels, self.rows = joined.channels, self.rows[joined.rows]
        told = ", ".join(f"{name} {how}" for name, how in joined.how.items())
        self.warnings.append(f"each row holds some of the channels; at the times of v_left: {told}")

    def order(self) -> None:
        """Put rows in the order of time, and average those of one time."""
        if len(self.rows) < 2:
            return
        again = np.ones(len(self.rows) - 1, bool)
        for values in self.channels.values():
            again &= (values[1:] == values[:-1]) | (np.isnan(values[1:]) & np.isnan(values[:-1]))
        self.drop(np.append(False, again), "the row repeats the one before; left out")
        if len(self.rows) >= RECORDING and np.mean(np.diff(self.channels["t"]) < 0) > 0.9:
            self.pick(np.arange(len(self.rows))[::-1])
            self.warnings.append("the rows stand newest first; they are read backwards")
        if np.any(np.diff(self.channels["t"]) < 0):
            again = self.seen_before()
            if np.all(np.diff(self.channels["t"][~again]) > 0):
                self.drop(again, "the row repeats an earlier one; left out")
        if np.any(np.diff(self.channels["t"]) < 0):
            self.unwrap()
        if np.any(np.diff(self.channels["t"]) < 0):
            self.restart()
        if np.any(np.diff(self.channels["t"]) < 0):
            self.sort()
        if np.any(np.diff(self.channels["t"]) == 0):
            self.average()
        if np.all(np.diff(self.channels["t"]) > 0):
            self.spread()
        t = self.channels["t"]
        back = np.append(False, np.diff(t) <= 0)
        if np.any(back):
            k = int(np.flatnonzero(back)[0])
            raise DriveLogError(
                f"{self.label}, {self.where(back)}: t does not increase: {t[k]:.6f} s follows "
                f"{t[k - 1]:.6f} s ({np.count_nonzero(back)} such steps in all); if several "
                "recordings follow each other, or the clock was set back, give each part a file of "
                "its own; else sort the rows by time, and drop those with a time of another row"
            )

    def seen_before(self) -> NDArray[np.bool_]:
        """Tell which rows repeat an earlier one with its time, as where a part stands twice."""
        table = np.nan_to_num(np.column_stack(list(self.channels.values())), nan=np.inf)
        _, first = np.unique(table, axis=0, return_index=True)
        again = np.ones(len(table), bool)
        again[first] = False
        return again

    def pick(self, rows: NDArray[np.intp]) -> None:
        """Keep some rows, in their order."""
        self.channels = {name: values[rows] for name, values in self.channels.items()}
        self.rows = self.rows[rows]

    def unwrap(self) -> None:
        """Let a clock go on that overflowed."""
        t = self.channels["t"]
        times = unwrap_clock(t)
        if times is not None:
            where = self.where(np.append(False, np.diff(t) < 0))
            self.channels["t"] = times
            self.warnings.append(f"t overflows at {where}, as a counter does, and goes on")

    def restart(self) -> None:
        """Put recordings one after the other that were appended to each other."""
        t = self.channels["t"]
        cuts = np.flatnonzero(np.diff(t) < 0) + 1
        bounds = [slice(a, b) for a, b in pairwise([0, *cuts.tolist(), len(t)])]
        parts = [t[one] for one in bounds]
        if min(map(len, parts)) < RECORDING:
            return
        place = ", ".join(self.place(int(self.rows[cut])) for cut in cuts[:3])
        first = sorted(range(len(parts)), key=lambda k: float(parts[k][0]))
        if all(parts[a][-1] < parts[b][0] for a, b in pairwise(first)):
            self.pick(np.concatenate([np.arange(bounds[k].start, bounds[k].stop) for k in first]))
            self.warnings.append(f"t goes back at {place}: recordings were put in their order")
            return
        begins = np.array([part[0] for part in parts])
        shortest = min(float(np.ptp(part)) for part in parts)
        if np.ptp(begins) > max(5.0, 0.1 * shortest):
            return  # no clock that begins anew
        step = float(np.median(np.diff(t)))
        pause = max(_PAUSE, 10 * step)
        counted = t.copy()
        for before, one in pairwise(bounds):
            counted[one] += counted[before][-1] + pause - t[one][0]
        self.channels["t"] = counted
        told = f"{len(parts)} recordings in one file, which are taken as one drive with gaps of"
        more = f"{pause:g} s; separate files tell diagnose more"
        self.warnings.append(f"t begins anew at {place}: {told} {more}")

    def sort(self) -> None:
        """Sort rows of which a few came late."""
        t = self.channels["t"]
        late = np.append(False, np.diff(t) < 0)
        if np.mean(late) > _LATE or np.max(np.maximum.accumulate(t) - t) > _LATEST:
            return
        self.note(late, "the row is older than the one before; sorted by time")
        self.pick(np.argsort(t, kind="stable"))

    def average(self) -> None:
        """Average rows of one time, unless they come so evenly that their times are known."""
        t = self.channels["t"]
        if np.any(np.diff(t) < 0):
            return
        first = np.flatnonzero(np.append(True, np.diff(t) > 0))
        sizes = np.diff(np.append(first, len(t)))
        if len(first) >= RECORDING and np.median(sizes) > 1:
            # Of stamps in whole seconds: rows of a steady rate lie on a line.
            rows, step = np.arange(len(t)), float(np.median(np.diff(t[first])))
            line = np.polynomial.Polynomial.fit(rows, t, 1)(rows)
            if np.max(np.abs(line - t)) < step:
                self.note(np.repeat(sizes, sizes) > 1, "the row's time is that of another; spread")
                self.channels["t"] = line
                return
        if len(first) < RECORDING or np.max(sizes) > max(8, 8 * float(np.median(sizes))):
            return  # the clock stood still
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

    def spread(self) -> None:
        """Give rows that were buffered, and came several at once, the times of their readings."""
        t, speeds = self.channels["t"], [self.channels[name] for name in ("v_left", "v_right")]
        times = spread_bursts(t, np.stack(speeds))
        if times is not None:
            self.note(times != t, "the row came with others in one burst; spread over the time")
            self.channels["t"] = times

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
            inside = (t >= t[known[0]]) & (t <= t[known[-1]]) & (width <= _BRIDGE)
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
        if share > _SPARSE:
            self.warnings.append(
                f"{name} is left out: {share:.0%} of its readings are missing ({self.where(hole)})"
            )
            del self.channels[name]
        else:
            self.drop(hole, f"{name} has no usable reading for more than {_BRIDGE:g} s; left out")

    def follow_heading(self) -> None:
        """Leave out a heading, from 0 to one turn, that is read too seldom to tell the turns."""
        yaw, t = self.channels.get("yaw"), self.channels["t"]
        if yaw is None or len(t) < 3 or np.ptp(yaw) > 2 * np.pi:
            return
        change = np.abs(np.angle(np.exp(1j * np.diff(yaw))))[np.diff(t) <= gap_limit(t)]
        far = np.count_nonzero(change > 2 * np.pi / 3)
        if far > max(1.0, _FAR * len(change)):
            self.warnings.append(
                f"yaw is left out: in {far / len(change):.0%} of the steps from reading to reading "
                "it changes by more than a third of a turn, which does not tell how far the robot"
                " turned, or which way; log it more often"
            )
            del self.channels["yaw"]
