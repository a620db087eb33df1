"""Instants as text: dates with times by ISO 8601 and as people write them, and times of day."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from energyplan.path import FloatArray

if TYPE_CHECKING:
    import pandas as pd

_ISO = re.compile(r"\d{4}-?\d\d-?\d\d[T ]\d\d:?\d\d")
_ISO_DATE = r"(?P<y>\d{4})[-/.](?P<m>\d{1,2})[-/.](?P<d>\d{1,2})"
_DATE = r"(?P<a>\d{1,2})(?P<sign>[-/.])(?P<b>\d{1,2})[-/.](?P<y>\d{4}|\d\d)"
_TIME = (
    r"(?P<hour>\d{1,2}):(?P<minute>\d\d):(?P<second>\d\d(?:[.,:]\d+)?)"
    r"\s*(?P<half>[AaPp]\.?[Mm]\.?)?"
)
_DAY = 86400.0
_SECONDS = re.compile(r"(.*?)[\W_]*(?<![a-z])(?:secs?|seconds?)", re.IGNORECASE)
_FRACTIONS = {
    r"n(?:ano)?secs?|nanoseconds?|ns": 1e-9,
    r"(?:u|micro)secs?|microseconds?|us": 1e-6,
    r"(?:m|milli)secs?|milliseconds?|ms": 1e-3,
}
"""Names of what is counted beside the whole seconds of a stamp, and its size [s]."""


@dataclass(frozen=True)
class Instants:
    """How instants are written."""

    pattern: str  # regular expression of their parts
    day_first: bool = True  # whether the day stands before the month

    @property
    def of_day(self) -> bool:
        """Whether these are times of day, without a date."""
        return bool(self.pattern) and "<y>" not in self.pattern

    def seconds(self, series: pd.Series[Any]) -> FloatArray:
        """Return seconds since 1970, or since midnight; NaN where an instant cannot be read."""
        import pandas as pd

        if not self.pattern:
            read = pd.to_datetime(series, format="ISO8601", utc=True, errors="coerce")
            return _since_1970(read)
        parts = series.str.extract(f"^{self.pattern}$")
        clock = parts["second"].str.replace(r"[,:]", ".", regex=True)
        hour, minute, second = (
            pd.to_numeric(part, errors="coerce").to_numpy(float, na_value=np.nan)
            for part in (parts["hour"], parts["minute"], clock)
        )
        half = parts["half"].str.lower().str[:1]
        hour = np.where(half.isin(["a", "p"]), hour % 12, hour)
        of_day = (
            3600.0 * (hour + 12.0 * (half == "p").fillna(False).to_numpy(bool))
            + 60.0 * minute
            + second
        )
        if self.of_day:
            return np.asarray(of_day, float)
        if "<a>" in self.pattern:
            day, month = ("a", "b") if self.day_first else ("b", "a")
        else:
            day, month = "d", "m"
        year = parts["y"].where(parts["y"].str.len() == 4, "20" + parts["y"])
        dates = year + "-" + parts[month].str.zfill(2) + "-" + parts[day].str.zfill(2)
        midnight = _since_1970(pd.to_datetime(dates, errors="coerce", utc=True))
        return np.asarray(midnight + of_day, float)


def instants_of(series: pd.Series[Any]) -> Instants | None:
    """Learn from texts how their instants are written."""
    there = series.dropna()
    if not len(there):
        return None
    first = str(there.iloc[0])
    if _ISO.match(first):
        return Instants("")
    for date in (_ISO_DATE, _DATE, ""):
        pattern = rf"{date}[T,\s]+{_TIME}" if date else _TIME
        match = re.fullmatch(pattern, first)
        if match is None:
            continue
        if date != _DATE or match["sign"] == ".":
            return Instants(pattern)
        # Day or month first: the order in which all can be read, and lie closer together.
        spans = {}
        for day_first in (False, True):
            seconds = Instants(pattern, day_first).seconds(there)
            spans[day_first] = float(np.ptp(seconds)) if np.all(np.isfinite(seconds)) else np.inf
        return Instants(pattern, min(spans, key=lambda key: spans[key]))
    return None


def over_midnight(seconds: FloatArray) -> FloatArray:
    """Count times of day on where a day ends."""
    known = np.isfinite(seconds)
    days = np.cumsum(np.diff(seconds[known], prepend=seconds[known][:1]) < -0.5 * _DAY)
    counted = seconds.copy()
    counted[known] += _DAY * days
    return counted


def whole_stamps(numbers: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
    """Join stamps that stand in two columns each: whole seconds, and what is beyond them.

    So stamps of ROS messages do, as ``header.stamp.sec`` and ``header.stamp.nanosec``.
    """
    made: dict[str, FloatArray] = {}
    parts: set[str] = set()
    for name, seconds in numbers.items():
        match = _SECONDS.fullmatch(name.strip())
        joined = f"{match[1] or 'stamp'} [s]" if match else ""
        if match is None or joined in (*made, *numbers):
            continue
        for words, size in _FRACTIONS.items():
            beside = re.compile(rf"{re.escape(match[1])}[\W_]*(?:{words})", re.IGNORECASE)
            rest = [other for other in numbers if beside.fullmatch(other.strip())]
            # What is beyond whole seconds is less than one; else it is a clock of its own.
            if len(rest) == 1 and not np.any(numbers[rest[0]] * size >= 1.0):
                made[joined] = seconds + size * numbers[rest[0]]
                parts |= {name, rest[0]}
                break
    return {**made, **{name: values for name, values in numbers.items() if name not in parts}}


def _since_1970(read: pd.Series[Any]) -> FloatArray:
    stamps = read.dt.tz_localize(None).to_numpy("datetime64[ns]")
    return np.asarray((stamps - np.datetime64(0, "ns")) / np.timedelta64(1, "s"), float)
