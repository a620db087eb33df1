"""Drive logs: named channels over time, checked where they are built."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from os import PathLike
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from energyplan import html
from energyplan.errors import DriveLogError, MissingChannelError, needs_extra
from energyplan.logs.align import (
    Series,
    block_bounds,
    derivative,
    find_runs,
    interval_means,
    shift,
    time_weights,
)
from energyplan.logs.checks import checks_of
from energyplan.logs.clean import Place, SetAside, clean, needed_channels, total_power
from energyplan.logs.consistency import POWERS, Check, Observed
from energyplan.logs.mapping import Column, clock_in, parse_columns
from energyplan.logs.readers import read_recorded
from energyplan.logs.tables import Recording, table_of
from energyplan.motion import Motion
from energyplan.path import FloatArray
from energyplan.power import Sides
from energyplan.records import ReadOnly, checked, numbers
from energyplan.vehicle import TreadICR

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["DriveLog", "SetAside", "parse_columns"]

_MOST_INTERVALS = 50_000_000
_EPOCH = 1e6  # times beyond are those of a calendar, not of a drive [s]


@dataclass(frozen=True, eq=False, repr=False)
class DriveLog(ReadOnly, html.Readable):
    """One drive: named channels over time.

    `from_columns` and `read` correct what can be corrected, and count it; this takes no faults.

    Parameters
    ----------
    channels : mapping of str to array_like, shape (n,)
        ``t`` [s], increasing; ``v_left`` and ``v_right`` [m/s]; and power as ``p_left`` and
        ``p_right`` [W], or ``power`` [W], or ``voltage`` [V] with ``current`` [A]; further
        channels as in `energyplan.motion.CHANNELS`, or of one's own.
    name : str
        What to call the log in messages.
    set_aside : tuple of SetAside
        Samples that were left out or mended, and why.
    warnings : tuple of str
        What is uncertain about the log.
    checks : tuple of Check
        What of that checks of its readings found.
    began : float, optional
        When the drive began that it was cut from [s]: what warms up does so from then on.
    signed : bool, optional
        Whether the sensors of its powers see a sign, so that what a side returns reads negative;
        None where nobody said. Of powers without one, only the total is used.

    Raises
    ------
    DriveLogError
        If a channel is missing, differs in length or is not finite, or time does not increase.

    Examples
    --------
    >>> log = DriveLog({"t": [0.0, 1.0, 2.0], "v_left": [0.5] * 3, "v_right": [0.5] * 3,
    ...                 "power": [120.0] * 3})
    >>> log.duration, log.energy
    (2.0, 240.0)
    """

    channels: Mapping[str, FloatArray]
    name: str = "log"
    set_aside: tuple[SetAside, ...] = ()
    warnings: tuple[str, ...] = ()
    checks: tuple[Check, ...] = ()
    began: float | None = None
    signed: bool | None = None

    def __post_init__(self) -> None:
        needed_channels(self.channels, self.name)
        arrays = {key: np.array(value, float) for key, value in self.channels.items()}
        t = arrays["t"]
        if t.ndim != 1 or len(t) < 2:
            raise DriveLogError(f"{self.name}: t has shape {t.shape}; give two samples or more")
        for key, value in arrays.items():
            if value.shape != t.shape:
                raise DriveLogError(
                    f"{self.name}: {key} has shape {value.shape}, t has {t.shape}; give one value "
                    "of each per sample"
                )
            lost = np.flatnonzero(~np.isfinite(value))
            if len(lost):
                raise DriveLogError(
                    f"{self.name}: {key} is not finite at sample {lost[0]}; "
                    "DriveLog.from_columns sets such samples aside"
                )
            value.setflags(write=False)
        back = np.flatnonzero(np.diff(t) <= 0)
        if len(back):
            raise DriveLogError(
                f"{self.name}: t does not increase at sample {int(back[0]) + 1}: "
                f"{t[back[0] + 1]:g} s follows {t[back[0]]:g} s; sort the samples"
            )
        object.__setattr__(self, "channels", MappingProxyType(arrays))
        object.__setattr__(self, "set_aside", tuple(self.set_aside))
        object.__setattr__(self, "warnings", tuple(self.warnings))

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in super().__getstate__().items() if name != "observed"}

    def __len__(self) -> int:
        return len(self.t)

    def __repr__(self) -> str:
        length = f"{len(self)} samples over {self.duration:.1f} s, {self.energy / 1e3:.2f} kJ"
        return f"<DriveLog {self.name!r}: {length}; {', '.join(self.channels)}>"

    def _summaries(self) -> list[html.Summary]:
        title = (
            f"{self.name}: {len(self)} samples over {self.duration:.1f} s, "
            f"{html.number(self.energy / 1e3)} kJ"
        )
        shares = (0.0, 0.5, 1.0)
        rows = [(key, *np.quantile(v, shares).tolist()) for key, v in self.channels.items()]
        notes = [*(f"set aside: {one}" for one in self.set_aside), *self.warnings]
        return [html.Summary(title, ("channel", "least", "median", "most"), rows, notes)]

    def to_frame(self) -> pd.DataFrame:
        """Return the log as a pandas DataFrame with a column for each channel."""
        with needs_extra("logs", "a DataFrame"):
            import pandas as pd

        return pd.DataFrame({key: np.array(values) for key, values in self.channels.items()})

    # -- building -------------------------------------------------------------------------------

    @classmethod
    @checked(DriveLogError)
    def read(
        cls,
        source: str | Path | pd.DataFrame,
        columns: str | Mapping[str, str | Column] | None = None,
        others: bool = True,
    ) -> DriveLog:
        """Read a log from a file or from a pandas DataFrame.

        Parameters
        ----------
        source : str, Path or DataFrame
            A ``.csv``, ``.csv.gz`` or ``.parquet`` file with one row of column names; a file that
            another package has a reader for (entry point ``energyplan.logs``); or a DataFrame,
            whose dates count as seconds since 1970.
        columns : str or mapping of str to str or Column, optional
            Which column serves as which channel, and its unit where it is not the library's:
            ``"v_left=velL,yaw=heading[deg]"``, or the same as a mapping; `parse_columns` lists all
            that can be written. Columns that bear a channel's name need no mention.
        others : bool
            Whether to take columns of numbers that are not mentioned, as channels of their own.

        Returns
        -------
        DriveLog
            The log. `set_aside` counts what was left out or mended; `warnings` lists doubts.

        Raises
        ------
        DriveLogError
            If the file is malformed, a channel is missing or makes no sense; the message names
            the file, the line and the channel.
        MissingDependencyError
            If a Parquet file is read without pyarrow.

        Examples
        --------
        >>> import pandas as pd
        >>> frame = pd.DataFrame({"t": [0.0, 1.0], "velL": 50.0, "velR": 50.0, "power": 120.0})
        >>> DriveLog.read(frame, "v_left=velL[cm/s],v_right=velR[cm/s]").energy
        120.0
        """
        if isinstance(source, str | PathLike):
            recording = read_recorded(source, clock_in(columns))
        else:
            recording = table_of(source, DriveLogError)
        return cls.of(recording, recording.mapping(columns, others))

    @classmethod
    def of(
        cls, recording: Recording, mapping: Mapping[str, Column], refuse: bool = True
    ) -> DriveLog:
        """Build a log from what was recorded, by which column serves as which channel.

        Series with times of their own are brought to those of the left tread speed.

        Parameters
        ----------
        recording : Recording
            The series, as `energyplan.logs.tables.read_table` reads them from a file.
        mapping : mapping of str to Column
            Which column serves as which channel, and its unit.
        refuse : bool
            Whether to raise what `checks` says that must not be read.

        Returns
        -------
        DriveLog
            The log, with `set_aside`, `warnings` and `checks`.

        Raises
        ------
        DriveLogError
            As from `from_columns`.
        """
        name, place = recording.source, recording.place
        mapping = {c: one for c, one in mapping.items() if c != "t" or not recording.times}
        needed_channels({*mapping, *(["t"] if recording.times else [])}, name)
        rows = None if recording.times else recording.series(mapping["t"]).values
        series = {channel: recording.series(one, rows) for channel, one in mapping.items()}
        clock = series["v_left"].t
        if rows is None:
            place = lambda row: f"{clock[row]:.3f} s"  # noqa: E731
        else:
            series["t"] = Series(rows, rows)
        log = _cleaned(series, name, place, recording.notes_of(mapping), refuse)
        unsigned = any(mapping[one].unsigned for one in mapping if one in POWERS)
        return replace(log, signed=False) if unsigned else log

    @classmethod
    def from_columns(
        cls, columns: Mapping[str, ArrayLike], name: str = "log", place: Place | None = None
    ) -> DriveLog:
        """Build a log from raw columns, setting aside what cannot be used.

        Rows without time, speeds or power, and rows that repeat the one before, are left out; holes
        of up to a second in another channel are interpolated.

        Parameters
        ----------
        columns : mapping of str to array_like, shape (n,)
            Channels in the library's units; NaN where there is no reading.
        name : str
            What to call the log.
        place : callable, optional
            Names the place of a row for messages; ``"sample k"`` where not given.

        Returns
        -------
        DriveLog
            The log, with `set_aside`, `warnings` and `checks`.

        Raises
        ------
        DriveLogError
            If a channel is missing, mostly out of range, or contradicts others (swapped sides).
        """
        needed_channels(columns, name)
        read = {k: numbers(columns[k], f"{name}: {k}", DriveLogError) for k in columns}
        shapes = {values.shape for values in read.values()}
        if len(shapes) != 1 or len(next(iter(shapes))) != 1:
            raise DriveLogError(f"{name}: channels have shapes {shapes}; give rows of equal length")
        t = read["t"]
        series = {channel: Series(t, values) for channel, values in read.items()}
        return _cleaned(series, name, place or "sample {}".format)

    # -- channels -------------------------------------------------------------------------------

    def has(self, channel: str) -> bool:
        """Return whether the log carries a channel."""
        return channel in self.channels

    def channel(self, name: str) -> FloatArray:
        """Return a channel.

        Raises
        ------
        MissingChannelError
            If the log does not carry it.
        """
        if name not in self.channels:
            raise MissingChannelError(
                f"{self.name}: there is no channel {name!r}; the log has "
                f"{', '.join(sorted(self.channels))}"
            )
        return self.channels[name]

    @property
    def t(self) -> FloatArray:
        """Time [s]."""
        return self.channels["t"]

    @property
    def duration(self) -> float:
        """Time from the first to the last sample, gaps left out [s]."""
        return float(sum(self.t[run][-1] - self.t[run][0] for run in self.runs))

    @property
    def sides(self) -> Sides | None:
        """Measured power of each side [W], or None where only the total was logged."""
        if self.has("p_left") and self.has("p_right"):
            return Sides(self.channels["p_left"], self.channels["p_right"])
        return None

    @property
    def battery_side(self) -> bool:
        """Whether power was measured at the battery, so that it holds drive losses and hotel load.

        So it is where it comes from voltage and current.
        """
        return self.sides is None and not self.has("power")

    @cached_property
    def power(self) -> FloatArray:
        """Measured total power [W], positive when drawn."""
        return total_power(self.channels)

    @cached_property
    def runs(self) -> tuple[slice, ...]:
        """Stretches without a gap: a gap is four times the median time step, 0.2 s at least."""
        return tuple(find_runs(self.t))

    @cached_property
    def observed(self) -> Observed:
        """What the channels show of the robot."""
        return Observed(self.channels, self.power, self.runs).averaged()

    @cached_property
    def weights(self) -> FloatArray:
        """Time that each sample stands for [s]: the trapezoidal rule, gaps left out."""
        return time_weights(self.t, self.runs)

    @property
    def energy(self) -> float:
        """Measured energy [J], gaps left out."""
        return float(self.weights @ self.power)

    @checked(DriveLogError)
    def motion(self, icr: TreadICR, smoothing: float = 0.4) -> Motion:
        """Return the log as a motion, with accelerations derived from the tread speeds.

        Parameters
        ----------
        icr : TreadICR
            Tread ICRs.
        smoothing : float
            Window of the local quadratic fit that the channels ``accel`` and ``yaw_accel`` come
            from [s]; three samples at least. A channel of that name in the log is kept.

        Returns
        -------
        Motion
            The motion, with the log's further channels.
        """
        speeds = ("v_left", "v_right")
        others = {key: value for key, value in self.channels.items() if key not in speeds}
        motion = Motion(self.channels["v_left"], self.channels["v_right"], icr, others)
        derived = {
            "accel": derivative(self.t, motion.v, self.runs, smoothing),
            "yaw_accel": derivative(self.t, motion.omega, self.runs, smoothing),
        }
        return motion.with_channels(**{k: v for k, v in derived.items() if not self.has(k)})

    # -- parts ----------------------------------------------------------------------------------

    def _part(self, samples: slice, name: str) -> DriveLog:
        channels = {k: v[samples] for k, v in self.channels.items()}
        began = float(self.t[0]) if self.began is None else self.began
        return replace(self, channels=channels, name=name, began=began)

    @checked(DriveLogError)
    def segment(self, t0: float, t1: float) -> DriveLog:
        """Return the samples with ``t0 <= t < t1`` [s].

        `set_aside` of a segment is empty: what was left out is reported for the whole log.

        Raises
        ------
        DriveLogError
            If fewer than two samples lie there.
        """
        first, last = np.searchsorted(self.t, [t0, t1])
        if last - first < 2:
            raise DriveLogError(
                f"{self.name}: {max(0, int(last - first))} samples lie in {t0:g} <= t < {t1:g} s, "
                f"two are needed; the log covers {self.t[0]:g} to {self.t[-1]:g} s"
            )
        since = float(self.t[0]) if self.t[0] > _EPOCH else 0.0
        label = f"{self.name} from {round(t0 - since, 2):g} to {round(t1 - since, 2):g} s"
        return replace(self._part(slice(int(first), int(last)), label), set_aside=())

    @checked(DriveLogError)
    def blocks(self, duration: float) -> list[DriveLog]:
        """Cut the log into blocks of about equal length that hold every sample once.

        Parameters
        ----------
        duration : float
            Length of a block [s]; the blocks of a run without a gap share its length evenly.

        Returns
        -------
        list of DriveLog
            The blocks. None crosses a gap, unless a sample alone between two gaps had to join the
            block before it.

        Raises
        ------
        DriveLogError
            If `duration` is not positive.
        """
        if not duration > 0:
            raise DriveLogError(f"{self.name}: blocks of {duration} s; give a positive duration")
        bounds = block_bounds(self.t, self.runs, duration)
        return [
            self._part(slice(a, b), f"{self.name}, block {k + 1} of {len(bounds) - 1}")
            for k, (a, b) in enumerate(pairwise(bounds))
        ]

    @checked(DriveLogError)
    def resample(self, period: float) -> DriveLog:
        """Return the log as means over successive intervals, which keeps integrals such as energy.

        Parameters
        ----------
        period : float
            Length of an interval [s].

        Returns
        -------
        DriveLog
            The log; ``t`` holds the intervals' centres. What is left at the end of a run is set
            aside. Power is averaged as such: of voltage and current, the current is then the one
            that gives the mean power at the mean voltage.

        Raises
        ------
        DriveLogError
            If `period` is not positive, or fewer than two intervals fit.
        """
        if not (np.isfinite(period) and period > 0):
            raise DriveLogError(f"{self.name}: resampling every {period} s; give a positive period")
        if self.duration > period * _MOST_INTERVALS:
            raise DriveLogError(f"{self.name}: every {period:g} s is absurd; give a longer period")
        raw = {**self.channels}
        if "yaw" in raw:
            raw["yaw"] = np.unwrap(raw["yaw"])
        if self.battery_side:
            raw["current"] = self.power
        means, unused = interval_means(self.t, raw, self.runs, period)
        if len(means["t"]) < 2:
            raise DriveLogError(
                f"{self.name}: {len(means['t'])} intervals of {period:g} s fit into "
                f"{self.duration:.3g} s; two are needed"
            )
        if self.battery_side:
            voltage = means["voltage"]
            means["current"] = means["current"] / np.where(voltage != 0, voltage, 1.0)
        aside = self.set_aside
        if unused:
            reason = f"ends of runs that do not fill {period:g} s; left out"
            aside = (*aside, SetAside(reason, unused, "ends of runs"))
        return replace(self, channels=means, set_aside=aside)

    @checked(DriveLogError)
    def shifted(self, **seconds: float) -> DriveLog:
        """Return the log with channels moved in time, to mend a clock offset.

        Parameters
        ----------
        **seconds : float
            By how much to move each channel [s]: negative for one that lags behind. ``power``
            moves all channels of the power.

        Returns
        -------
        DriveLog
            The log; samples that a moved channel no longer reaches are set aside.

        Raises
        ------
        MissingChannelError
            If there is no such channel.
        DriveLogError
            If fewer than two samples are left.
        """
        moves = dict(seconds)
        if "power" in moves and not self.has("power"):
            by = moves.pop("power")
            moves |= dict.fromkeys(needed_channels(self.channels, self.name)[3:], by)
        channels = {**self.channels}
        reached = np.ones(len(self), bool)
        for name, by in moves.items():
            values = self.channel(name)
            values = np.unwrap(values) if name == "yaw" else values
            channels[name], known = shift(self.t, values, self.runs, by)
            reached &= known
        lost = int(np.count_nonzero(~reached))
        if len(self) - lost < 2:
            raise DriveLogError(
                f"{self.name}: shifting {', '.join(moves)} leaves {len(self) - lost} samples; "
                "shift by less than the log's length"
            )
        moved = ", ".join(f"{name} by {by:+.3f} s" for name, by in moves.items())
        aside = self.set_aside
        if lost:
            reason = f"out of reach of the channels moved ({moved}); left out"
            aside = (*aside, SetAside(reason, lost, "ends of runs"))
        # What was said of these channels' clocks no longer holds.
        stale = [
            one for one in self.checks if one.rule == "late" and one.channel in {*seconds, *moves}
        ]
        gone = {str(one) for one in stale}
        return replace(
            self,
            channels={name: values[reached] for name, values in channels.items()},
            set_aside=aside,
            warnings=tuple(text for text in self.warnings if text not in gone),
            checks=tuple(one for one in self.checks if one not in stale),
        )


def _cleaned(
    series: Mapping[str, Series], name: str, place: Place, notes: Sequence[str] = (),
    refuse: bool = True,
) -> DriveLog:  # fmt: skip
    """Build a log from series, with what was found wrong with it."""
    done = clean(series, name, place)
    raw = DriveLog(done.channels, name)
    checks = tuple(checks_of(raw.observed))
    wrong = next((one for one in checks if refuse and one.refuses == "reading"), None)
    if wrong is not None:
        raise DriveLogError(f"{name}: {wrong}")
    warnings = (*done.warnings, *map(str, checks), *notes)
    log = replace(raw, set_aside=tuple(done.set_aside), warnings=warnings, checks=checks)
    log.__dict__["observed"] = raw.observed  # of the same channels
    return log
