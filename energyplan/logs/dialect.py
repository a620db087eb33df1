"""How a text file writes a table: encoding, line of names, separator, decimal sign, instants."""

from __future__ import annotations

import codecs
import csv
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from energyplan.errors import InvalidInputError
from energyplan.logs.mapping import is_unit, split_unit
from energyplan.path import FloatArray

if TYPE_CHECKING:
    import pandas as pd

MAX_COLUMNS = 4096
"""Widest table that is read."""
MAX_HEADER = 1 << 18
"""Longest header line that is read [bytes]."""
UNNAMED = "unnamed column "
"""How a column without a name is called, before its number."""
_LOOKED_AT = 80  # lines that tell how the others are written
_SEPARATORS = (",", ";", "\t", "|")
_SPACES = r"\s+"
_COMMENT = re.compile(r"\s*(#+|//|%%|\*\*)\s*")

MISSING = (
    "-", "--", "---", "----", "?", "nil", "none", "NONE", "NAN", "Null", "missing", "MISSING",
    "void",
    "n.a.", "N.A.", "na", "Na", "no data", "undefined", "invalid", "error", "1.#INF", "-1.#INF",
    "1.#IND", "-1.#IND", "#VALUE!", "#DIV/0!", "#NUM!", "#REF!", "#NAME?",
)  # fmt: skip
"""What stands in cells without a reading, beside what pandas knows."""
_NO_NUMBER = {"", "nan", "null", "none", "n/a", "na", "#n/a", "inf", "-inf"} | {
    word.lower() for word in MISSING
}


class Dialect(NamedTuple):
    """How a text file writes a table."""

    names: list[str]
    separator: str
    decimal: str  # decimal sign
    encoding: str  # encoding
    start: int  # where the readings begin [bytes]
    line: int  # number of the first line of readings, from 1
    named: int  # how many cells a row has, but for empty ones that no column names


def find_dialect(head: bytes, whole: bool, file: object, error: type[InvalidInputError]) -> Dialect:
    """Learn from its beginning how a text file writes a table."""
    mark = len(codecs.BOM_UTF8) if head.startswith(codecs.BOM_UTF8) else 0
    encoding = "utf-8"
    try:
        text = codecs.getincrementaldecoder(encoding)().decode(head[mark:], whole)
    except UnicodeDecodeError as problem:
        encoding = "cp1252"  # of Windows where it is no UTF-8
        try:
            text = head[mark:].decode(encoding)
        except UnicodeDecodeError:
            raise error(
                f"{file}, byte {problem.start + mark} is no UTF-8 text; save it so"
            ) from None
    ends = [match.end() for match in re.finditer(r"\r\n|\n|\r", text[: MAX_HEADER * 2])]
    if (ends[0] if ends else len(text)) > MAX_HEADER:
        raise error(f"{file}, line 1 is longer than {MAX_HEADER >> 10} KiB; it must name columns")
    starts = [0, *ends][:_LOOKED_AT]
    stops = [*ends, len(text)][:_LOOKED_AT]
    if not whole and len(starts) > 1 and stops[-1] == len(text):
        starts, stops = starts[:-1], stops[:-1]  # the last line is cut
    lines = [text[a:b].rstrip("\r\n") for a, b in zip(starts, stops, strict=True)]
    for number, line in enumerate(lines[:2], 1):
        if "\0" in line:
            raise error(f"{file}, line {number} holds a NUL byte; this is no text file")
    separator, place = _layout(lines)
    cut = _cells(lines[place], separator) if separator else [lines[place]]
    try:
        if len(separator) == 1:
            next(csv.reader([lines[place]], delimiter=separator, strict=True), [])
    except csv.Error as problem:
        raise error(f"{file}, line {place + 1} is no line of column names: {problem}") from None
    names = [name.strip() for name in _uncommented(cut)]
    named = len(names) - next((k for k, name in enumerate(reversed(names)) if name), 0)
    body = [_cells(line, separator) for line in lines[place + 1 :]]
    first = place + 1
    if body and len(body[0]) == len(names) and _is_unit_row(body[0]):
        names = [_with_unit(name, unit) for name, unit in zip(names, body[0], strict=True)]
        body, first = body[1:], first + 1
    _check(names, place + 1, file, error)
    widths = Counter(len(row) for row in body if any(cell.strip() for cell in row))
    width = widths.most_common(1)[0][0] if widths else len(names)
    if width < named:
        raise error(
            f"{file}: line {place + 1} names {named} columns, but the rows have {width} "
            "cells: which name is one too many cannot be known; give names and cells alike"
        )
    comma = any(_comma_number(cell) for row in body for cell in row)
    start = len(text[: starts[first] if first < len(starts) else stops[first - 1]].encode(encoding))
    return Dialect(
        names, separator or ",", "," if comma else ".", encoding, start + mark, first + 1, named
    )


def _check(names: list[str], line: int, file: object, error: type[InvalidInputError]) -> None:
    """Refuse names that cannot serve, and number those that are empty."""
    if not any(names):
        raise error(f"{file} is empty; line 1 must name the columns")
    if len(names) > MAX_COLUMNS:
        raise error(f"{file} has {len(names)} columns; at most {MAX_COLUMNS} are read")
    filled = [name for name in names if name]
    values = sum(map(_is_value, filled))
    if 4 * values >= len(filled) + 3 * (len(filled) < 4) or _reads(names):
        raise error(
            f"{file}, line {line} holds numbers, and no line names the columns ('ros2 topic echo "
            f"--csv' writes none): put one before it, with a name for each of the {len(names)} "
            "columns"
        )
    twice = [name for name, count in Counter(names).items() if count > 1 and name]
    if twice:
        raise error(f"{file}, line {line} names the column {twice[0]!r} twice; rename one")
    names[:] = [name or f"{UNNAMED}{k}" for k, name in enumerate(names, 1)]


class _Layout(NamedTuple):
    """What separates cells, and which line names the columns, from 0."""

    separator: str
    place: int


def _layout(lines: Sequence[str]) -> _Layout:
    """Find the separator that cuts names and readings into as many cells, the most of them."""
    best: tuple[int, _Layout] | None = None
    for separator in (*_SEPARATORS, _SPACES):
        if separator == _SPACES and best is not None:
            break
        rows = [_cells(line, separator) for line in lines]
        filled = [row for row in rows if any(cell.strip() for cell in row)]
        body = filled[len(filled) // 3 :] if len(filled) > 2 else filled[1:]
        if not body:
            continue
        width, often = Counter(map(len, body)).most_common(1)[0]
        place = _names_row(rows, width) if width > 1 and 2 * often > len(body) else None
        if place is not None and (best is None or width > best[0]):
            best = width, _Layout(separator, place)
    if best is not None:
        return best[1]
    # Nothing fits: line 1 is taken for the names, so that the complaint names its fault.
    counts = {mark: len(_cells(lines[0], mark)) for mark in _SEPARATORS}
    return _Layout(max(counts, key=lambda mark: counts[mark]), 0)


def _names_row(rows: list[list[str]], width: int) -> int | None:
    """Return the row that names the columns: the last of words alone before the readings."""
    told = [(k, row) for k, row in enumerate(rows) if len(_uncommented(row)) == width]
    reading = next((k for k, row in told if not _is_comment(row) and _reads(row)), len(rows))
    before = [(k, row) for k, row in told if k < reading and not any(map(_is_value, row))]
    plain = [(k, row) for k, row in before if not _is_comment(row)]
    some = plain or before
    if not some:
        return told[0][0] if told and told[0][0] == 0 else None
    if reading == len(rows):  # nothing but words: the readings are, too
        return some[0][0]
    last = some[-1]
    if len(some) > 1 and _is_unit_row(last[1]):
        return some[-2][0]
    return last[0]


def _cells(row: str, separator: str) -> list[str]:
    if separator == _SPACES:
        bare = _COMMENT.sub("", row, count=1) if _COMMENT.match(row) else row
        return bare.split()
    try:
        return next(csv.reader([row], delimiter=separator or ",", skipinitialspace=True), [])
    except csv.Error:
        return []


def _is_comment(row: list[str]) -> bool:
    return bool(row) and _COMMENT.match(row[0]) is not None


def _uncommented(row: list[str]) -> list[str]:
    return [_COMMENT.sub("", row[0], count=1), *row[1:]] if _is_comment(row) else row


def _reads(row: list[str]) -> bool:
    """Whether a row holds readings: most of its cells."""
    filled = [cell for cell in row if cell.strip()]
    values = sum(map(_is_value, filled)) + sum(
        cell.strip().lower() in _NO_NUMBER for cell in filled
    )
    return any(map(_is_value, filled)) and 2 * values > len(filled)


_INSTANT = re.compile(
    r"\d{1,4}[-./]\d{1,2}[-./]\d{1,4}([T ].*)?|\d{1,2}:\d\d(:\d\d.*)?|\d{8}T\d+.*"
)


def _is_value(cell: str) -> bool:
    """Whether a cell is a number or an instant."""
    text = cell.strip()
    if text.lower() in _NO_NUMBER:
        return False
    return _is_number(text) or _comma_number(text) or _INSTANT.fullmatch(text) is not None


def _comma_number(cell: str) -> bool:
    """Whether a cell is a number with a decimal comma."""
    return re.fullmatch(r"\s*[-+]?\d*,\d+([eE][-+]?\d+)?\s*", cell) is not None


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _is_unit_row(row: list[str]) -> bool:
    """Whether a row tells the units of columns: no cell is a value, most are units."""
    filled = [cell for cell in row if cell.strip() and cell.strip() not in "-1"]
    if not filled or any(map(_is_value, filled)):
        return False
    return 2 * sum(map(is_unit, filled)) > len(filled)


def _with_unit(name: str, unit: str) -> str:
    """Return a name with its unit in brackets."""
    bare = unit.strip().strip("[]()").strip()
    return f"{name} [{bare}]" if bare and is_unit(bare) and not split_unit(name)[1] else name


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
