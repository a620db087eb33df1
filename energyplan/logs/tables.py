"""Tables of numbers from CSV and Parquet, with the place of every complaint."""

from __future__ import annotations

import codecs
import csv
import gzip
import io
import re
import warnings
import zlib
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field, replace
from difflib import get_close_matches
from fnmatch import fnmatchcase
from importlib.util import find_spec
from itertools import combinations, product
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from energyplan.errors import DriveLogError, InvalidInputError, needs_extra
from energyplan.logs.align import Series, align, at_common_times, usable
from energyplan.logs.clean import ANY
from energyplan.logs.guess import guess, guess_encoders
from energyplan.logs.mapping import (
    ROW,
    Column,
    count_rate,
    is_unit,
    map_channels,
    parse_columns,
    scale_of,
    time_units,
)
from energyplan.logs.rows import number, numbered, numeric, pivoted, with_unit
from energyplan.path import FloatArray

if TYPE_CHECKING:  # pandas is slow to import, and needed only where a file is read
    import pandas as pd
    import pyarrow as pa

MAX_COLUMNS = 4096
"""Widest table that is read."""


class ReadingLimits(NamedTuple):
    """How a table is read."""

    header: int = 1 << 18  # longest header line that is read [bytes]
    first: int = 64  # bytes that show what a file is
    stray: float = 0.01  # share of rows that may be cut short
    steady: float = 0.9  # share of steps in which a clock must increase
    late: float = 3.0  # steps from row to row within which a clock that started again goes on
    fewest: int = 20  # readings below which nothing is concluded
    same: float = 0.7  # correlation from which one reading explains half of another's variance


_READING = ReadingLimits()
_UNNAMED = "unnamed column "  # how a column without a name is called, before its number
LOOKED_AT = 80  # lines that show how the others are written
_SEPARATORS = (",", ";", "\t", "|")
_SPACES = r"\s+"
_COMMENT = re.compile(r"\s*(#+|//|%%|\*\*)\s*")

_MISSING = ("-", "--", "---", "?", "missing", "1.#INF", "-1.#INF")
"""What stands in cells without a reading, in addition to what pandas knows."""
_NO_NUMBER = {"", "nan", "null", "none", "n/a", "na", "#n/a", "inf", "-inf", *_MISSING}


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
    if head.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        raise error(f"{file} is UTF-16 text; save it as UTF-8")
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
    ends = [match.end() for match in re.finditer(r"\r\n|\n|\r", text[: _READING.header * 2])]
    if (ends[0] if ends else len(text)) > _READING.header:
        raise error(
            f"{file}, line 1 is longer than {_READING.header >> 10} KiB; it must name columns"
        )
    starts = [0, *ends][:LOOKED_AT]
    stops = [*ends, len(text)][:LOOKED_AT]
    if not whole and len(starts) > 1 and stops[-1] == len(text):
        starts, stops = starts[:-1], stops[:-1]  # the last line is cut
    lines = [text[a:b].rstrip("\r\n") for a, b in zip(starts, stops, strict=True)]
    for row, line in enumerate(lines[:2], 1):
        if "\0" in line:
            raise error(
                f"{file}, line {row} holds a NUL byte; save it as text in UTF-8, or "
                "export it as CSV by what wrote it"
            )
    _refuse_pairs(lines, file, error)
    separator, place = _layout(lines)
    first_row = cut(lines[place], separator)
    try:
        if len(separator) == 1:
            next(csv.reader([lines[place]], delimiter=separator, strict=True), [])
    except csv.Error as problem:
        raise error(f"{file}, line {place + 1} is no line of column names: {problem}") from None
    names = [name.strip() for name in _uncommented(first_row)]
    named = len(names) - next((k for k, name in enumerate(reversed(names)) if name), 0)
    body = [cut(line, separator) for line in lines[place + 1 :]]
    first = place + 1
    if body and len(body[0]) == len(names) and _is_unit_row(body[0]):
        names = [with_unit(name, unit) for name, unit in zip(names, body[0], strict=True)]
        body, first = body[1:], first + 1
    _check(names, place + 1, file, error)
    widths = Counter(len(row) for row in body if any(cell.strip() for cell in row))
    width = widths.most_common(1)[0][0] if widths else len(names)
    if width < named:
        raise error(
            f"{file}: line {place + 1} names {named} columns, but the rows have {width} "
            "cells: which name is one too many cannot be known; give names and cells alike"
        )
    comma = _is_comma([cell.strip() for row in body for cell in row], separator)
    start = len(text[: starts[first] if first < len(starts) else stops[first - 1]].encode(encoding))
    return Dialect(
        names, separator or ",", "," if comma else ".", encoding, start + mark, first + 1, named
    )


def _refuse_pairs(lines: Sequence[str], file: object, error: type[InvalidInputError]) -> None:
    """Refuse text of pairs of a name and a value, of which a block is a reading."""
    rows = [re.split(r"\t|=|: |;|,", line.strip(), maxsplit=1) for line in lines if line.strip()]
    first = [row[0].strip() for row in rows if len(row) == 2]
    often = Counter(first)
    words_alone = not any(map(_is_value, often))
    if len(rows) >= 8 and len(first) > 0.8 * len(rows) and words_alone and (
        2 < len(often) <= len(first) / 2 and min(often.values()) > 1
        and all(len(re.split(r"\t|,|;", line.strip())) == 2 for line in lines if line.strip())
    ):  # fmt: skip
        named = ", ".join(list(often)[:3])
        raise error(
            f"{file} holds pairs of a name and a value ({named}, ...), a block "
            "of lines for each reading, as a battery monitor sends them: write a row for each "
            "block, with a column for each name and one for the time"
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
    names[:] = [name or f"{_UNNAMED}{k}" for k, name in enumerate(names, 1)]


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
        rows = [cut(line, separator) for line in lines]
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
    counts = {mark: len(cut(lines[0], mark)) for mark in _SEPARATORS}
    return _Layout(max(counts, key=lambda mark: counts[mark]), 0)


def reads(line: str) -> bool:
    """Whether a line holds readings, whatever separates them."""
    marks = (*_SEPARATORS, _SPACES)
    return not _COMMENT.match(line) and any(_reads(cut(line, mark)) for mark in marks)


def _names_row(rows: list[list[str]], width: int) -> int | None:
    """Return the row that names the columns: the last of words alone before the readings."""
    stated = [(k, row) for k, row in enumerate(rows) if len(_uncommented(row)) == width]
    reading = next((k for k, row in stated if not _is_comment(row) and _reads(row)), len(rows))
    before = [(k, row) for k, row in stated if k < reading and not any(map(_is_value, row))
              and not all(cell.strip().lower() in _NO_NUMBER for cell in row)]  # fmt: skip
    plain = [(k, row) for k, row in before if not _is_comment(row)]
    some = plain or before
    if not some:
        return stated[0][0] if stated and stated[0][0] == 0 else None
    if reading == len(rows):  # nothing but words: the readings are, too
        return some[0][0]
    last = some[-1]
    if len(some) > 1 and _is_unit_row(last[1]):
        return some[-2][0]
    return last[0]


def cut(row: str, separator: str) -> list[str]:
    """Cut a row into its cells."""
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
    return not np.isnan(number(text)) or _comma_number(text) or _INSTANT.fullmatch(text) is not None


_THOUSANDS = re.compile(r"[-+]?[1-9]\d{0,2}(,\d{3})+")
_DOTTED = r"[-+]?[1-9]\d{0,2}(\.\d{3})+(,\d*)?"  # with dots between thousands


def _is_comma(cells: Sequence[str], separator: str) -> bool:
    """Return whether the decimal sign is a comma, and no mark between thousands."""
    commas = [cell for cell in cells if _comma_number(cell)]
    if not commas or not all(map(_THOUSANDS.fullmatch, commas)):
        return bool(commas)
    points = any(re.fullmatch(r"[-+]?\d*\.\d+(e[-+]?\d+)?", cell.lower()) for cell in cells)
    return separator != "," and not points


def _comma_number(cell: str) -> bool:
    """Whether a cell is a number with a decimal comma."""
    return re.fullmatch(r"\s*[-+]?\d*,\d+([eE][-+]?\d+)?\s*", cell) is not None


def _is_unit_row(row: list[str]) -> bool:
    """Whether a row holds the units of columns: no cell is a value, most are units."""
    filled = [cell for cell in row if cell.strip() and cell.strip() not in "-1"]
    if not filled or any(map(_is_value, filled)):
        return False
    return 2 * sum(map(is_unit, filled)) > len(filled)


_REMEDIES = (
    (re.compile(r"""['"][-+]?\d{1,3}([.,'\u2019\u00a0\u202f ]\d{3})+([.,]\d*)?['"]$"""),
     "write the column without marks between thousands, as in 12345.6"),
    (re.compile(r"'\d{1,4}[-./]\d{1,2}[-./]\d{1,4}"),
     "write instants by ISO 8601, as in 2026-05-04T23:58:30.125"),
    (re.compile(r"'\d+:\d\d(\.\d*)?'$"),
     "write times of day as 14:03:27.5, and times since the start in seconds"),
    (re.compile(r"'[-+]?[\d.]+ ?[^\d\s']+'$"),
     "write the unit in the column's name, as in 'speed [m/s]', and numbers alone in its cells"),
    (re.compile(""), "correct the cell or map another column"),
)  # fmt: skip
"""What to do about a cell that is no number, by what it looks like."""


@dataclass(frozen=True)
class Recording:
    """Named series of numbers, with their times where these are known, and their source."""

    source: str  # name of the file, for messages
    columns: Mapping[str, FloatArray]  # the series that hold numbers
    text: Mapping[str, str] = field(default_factory=dict)  # where others do not, by name
    times: Mapping[str, FloatArray] = field(default_factory=dict)  # [s]; of rows none: map them
    kinds: Mapping[str, str] = field(default_factory=dict)  # type of the messages of each topic
    written: Mapping[str, str] = field(default_factory=dict)  # field of a message, by series
    notes: Mapping[str, str] = field(default_factory=dict)  # what is uncertain about a topic
    first: int = 1  # number of the first row of data
    unit: str = "row"  # what that number counts
    error: type[InvalidInputError] = DriveLogError  # error to raise for bad content

    def place(self, row: int) -> str:
        """Name the place of a row, such as ``"line 12"``."""
        return f"{self.unit} {self.first + row}"

    def column(self, name: str) -> FloatArray:
        """Return a series; `ROW` is the number of each row, NAME[A|B*] the mean of elements."""
        if name in self.columns:
            return self.columns[name]
        if name in (turns := quaternions(self.columns)):
            z, w, *more = (self.columns[part] for part in turns[name])
            x, y = more or (0.0, 0.0)
            return np.asarray(np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)))
        if name == ROW and self.columns:
            return np.arange(len(next(iter(self.columns.values()))), dtype=float)
        if self.kinds and (parts := self.elements(name)):
            return _mean_of([self.columns[part] for part in parts])
        if name in self.text:
            cell = self.text[name]
            remedy = next((text for kind, text in _REMEDIES if kind.search(cell)), "")
            if cell.endswith(f" is {name!r}"):
                remedy = "the names stand there again: give each recording a file of its own"
            raise self.error(f"{self.source}, {cell}, which is no number; {remedy}")
        near = get_close_matches(name, self.columns, 5, 0.5) if self.kinds else []
        there = ", ".join(near or [*self.columns, *self.text][:20])
        raise self.error(
            f"{self.source}: there is no column {name!r}; "
            f"{'near it' if near else 'the columns'} are {there}"
        )

    def elements(self, name: str) -> list[str]:
        """Return the series of an array of messages that a field such as ``/a.b[*left*]`` means."""
        label = message_series(name)
        if label in self.columns:
            return [label]
        base, _, element = name.rstrip("]").partition("[")
        every = {one: one[len(base) + 1 :] for one in self.columns if one.startswith(f"{base}.")}
        if element.isdecimal():
            return [*every][int(element) :][:1]
        wanted = element.split("|")
        return [one for one, part in every.items() if any(fnmatchcase(part, w) for w in wanted)]

    def mapping(
        self, columns: str | Mapping[str, str | Column] | None, others: bool = True
    ) -> dict[str, Column]:
        """Return which column serves as which channel: as given, and others by their own names."""
        names = (*self.columns, *self.text)
        if others:
            return map_channels(columns, names, self.text)
        return parse_columns(columns, names)

    def notes_of(self, mapping: Mapping[str, Column]) -> list[str]:
        """Return what is said of the messages that serve as channels, or of text that does not."""
        names = {name for one in mapping.values() for name in one.names}
        if self.kinds:
            served = ", ".join(f"{channel} is {one.written}" for channel, one in mapping.items())
            starts = {topic: f"/{topic.strip('/')}." for topic in self.notes}
            return [f"read: {served}"] + [
                note for topic, note in self.notes.items()
                if any(name.startswith(starts[topic]) for name in names)
            ]  # fmt: skip
        unread = [name for name in self.text if name not in names][:10]
        whole = unread and names.issuperset(self.columns)
        return [f"columns of text are left out: {', '.join(unread)}"] if whole else []

    def clock(self, name: str, rows: FloatArray | None = None) -> FloatArray | None:
        """Return the times of a series; of a table, those of its rows."""
        if not self.times or name in self.times:
            return self.times.get(name, rows)
        parts = self.elements(name) or quaternions(self.columns).get(name, ())
        return self.times.get(next(iter(parts), ""), rows)

    def together(self, one: str, other: str) -> tuple[FloatArray, FloatArray]:
        """Return two series at the times of the one that is read less often, where both are known.

        Rows of a table that hold only one of them are as far apart as their numbers say.
        """
        pair = []
        for name in (one, other):
            values, t = self.column(name), self.clock(name)
            pair.append(Series(np.arange(len(values), dtype=float) if t is None else t, values))
        return at_common_times(*pair)

    def series(self, column: Column, rows: FloatArray | None = None) -> Series:
        """Return a channel at the times of its first column; NaN where it has no reading.

        What has other times, or stands in other rows, is brought to these; a counter gives rates.
        """
        t = self.clock(column.field, rows)
        if t is None:
            return Series(np.zeros(0), np.asarray(column.value(self.column)))

        def nearby(name: str) -> FloatArray:
            values, own = self.column(name), self.clock(name, rows)
            if own is t:
                there, first = (np.isfinite(t) & np.isfinite(one)
                                for one in (values, self.column(column.field)))  # fmt: skip
                few = min(np.count_nonzero(there), np.count_nonzero(first)) < 2
                if few or np.any(there & first) or np.any(np.diff(t[there]) < 0):
                    return values
            found = np.full(len(t), np.nan)
            known = np.isfinite(t) & np.isfinite(self.column(column.field))
            found[known] = align(usable(Series(t if own is None else own, values)), t[known]).values
            return found

        kind = column.counts
        rate = (lambda name: count_rate(t, nearby(name), kind)) if kind else None
        return Series(t, np.asarray(column.value(nearby, rate)))

    def head(self, name: str, rows: int) -> Recording:
        """Return the first rows of a series, and what was recorded until then."""
        if not self.times:
            return replace(self, columns={n: v[:rows] for n, v in self.columns.items()})
        t = self.clock(name)
        end = np.inf if t is None or len(t) <= rows else t[rows]
        cut = {id(one): one[: np.searchsorted(one, end)] for one in self.times.values()}
        times = {name: cut[id(one)] for name, one in self.times.items()}
        return replace(
            self, times=times, columns={n: v[: len(times[n])] for n, v in self.columns.items()}
        )


def _mean_of(parts: Sequence[FloatArray]) -> FloatArray:
    """Return the mean of those that are known in each row."""
    known = sum(np.isfinite(part).astype(int) for part in parts)
    total = sum(np.where(np.isfinite(part), part, 0.0) for part in parts)
    return np.asarray(np.where(known > 0, total / np.maximum(known, 1), np.nan))


def message_series(name: str) -> str:
    """Return the name of the series of a message's field: ``/a.b.c`` of ``/a.b[c]``."""
    return f"/{re.sub(r'[][().]+', '.', name).strip('/.')}"


def of_messages(
    source: str, topics: Mapping[str, Mapping[str, FloatArray]],
    clocks: Mapping[str, FloatArray], kinds: Mapping[str, str], notes: Mapping[str, str],
) -> Recording:  # fmt: skip
    """Return the fields of each topic's messages as series, with their times since the first."""
    columns: dict[str, FloatArray] = {}
    times: dict[str, FloatArray] = {}
    written: dict[str, str] = {}
    first = min((float(np.min(clocks[one])) for one, held in topics.items() if held), default=0.0)
    for topic, fields in topics.items():
        order = np.argsort(clocks[topic], kind="stable")
        t = clocks[topic][order] - first
        for field_, values in fields.items():
            label = message_series(f"{topic}.{field_}")
            columns[label], times[label] = values[order], t
            written[label] = f"/{topic.strip('/')}.{field_}"
    return Recording(source, columns, times=times, kinds=kinds, written=written, notes=notes)


def quaternions(names: Collection[str]) -> dict[str, tuple[str, ...]]:
    """Return the columns z, w and, where they are, x, y of orientations, by ``yaw(NAME)``."""
    found = {}
    for name in names:
        base, last = name[:-1], name[-1:]
        x, y, z = (base + part for part in ("xyz" if last == "w" else "XYZ"))
        if last in ("w", "W") and z in names and (x in names) == (y in names):
            label = base.rstrip("._/ ") or "orientation"
            found[f"yaw({label})"] = (z, name, *((x, y) if x in names else ()))
    return found


class Columns:
    """Columns as they are read, part by part, sorted into numbers and text."""

    def __init__(self, names: list[str], first: int, unit: str, decimal: str = ".") -> None:
        self.rows, self._first, self._unit, self._decimal = 0, first, unit, decimal
        self._numbers: dict[str, list[FloatArray]] = {name: [] for name in names}
        self._text: dict[str, str] = {}
        self._of_day: set[str] = set()

    def add(self, frame: pd.DataFrame) -> None:
        """Take in the next rows."""
        import pandas as pd

        for label, series in zip(self._numbers, (frame[name] for name in frame), strict=True):
            if label in self._text:
                continue
            if pd.api.types.is_datetime64_any_dtype(series):
                self._numbers[label].append(_since_1970(series))
                continue
            if not pd.api.types.is_numeric_dtype(series):  # text, or integers beyond 64 bits
                series = series.astype("string").str.strip()
            comma = self._decimal == "," and not pd.api.types.is_numeric_dtype(series)
            plain = series.str.replace(",", ".", regex=False) if comma else series
            values = numeric(plain).to_numpy(float, na_value=np.nan)
            if comma:
                values = np.where(_with_thousands(series), np.nan, values)
            bad = np.flatnonzero(np.isnan(values) & series.notna().to_numpy())
            # to pandas before 3.0 a number beyond the largest is none
            beyond = [k for k in bad if _BEYOND.fullmatch(str(plain.iloc[k]))]
            values = np.where(np.isin(np.arange(len(values)), beyond), np.inf, values)
            bad = np.setdiff1d(bad, beyond)
            if len(bad) and _OF_DAY.fullmatch(str(series.iloc[bad[0]])):
                values = _of_day(series)
                self._of_day.add(label)
            elif len(bad) and _ISO.match(str(series.iloc[bad[0]])):
                values = _since_1970(series.str.replace(",", ".", regex=False))
            bad = np.flatnonzero(np.isnan(values) & series.notna().to_numpy())
            if len(bad):
                k = int(bad[0])
                place = f"{self._unit} {self._first + self.rows + k}"
                self._text[label] = f"{place}: {label!r} is {str(series.iloc[k])[:40]!r}"
                self._numbers[label].clear()
            else:
                self._numbers[label].append(values)
        self.rows += len(frame)

    def add_numbers(self, cells: FloatArray) -> None:
        """Take in the next rows of a table that holds nothing but numbers."""
        for parts, values in zip(self._numbers.values(), cells.T, strict=True):
            parts.append(values)
        self.rows += len(cells)

    def table(self, file: Path, error: type[InvalidInputError]) -> Recording:
        """Return what was read."""
        numbers = {
            name: np.concatenate(parts) if parts else np.zeros(0)
            for name, parts in self._numbers.items()
            if name not in self._text
        }
        numbers = {n: np.where(np.abs(v) < ANY[1], v, np.nan) for n, v in numbers.items()}
        numbers = {
            name: _over_midnight(values) if name in self._of_day else _unwrapped(values)
            for name, values in numbers.items()
        }
        # Where lines end with a separator, a column without a name holds nothing.
        numbers = {
            name: values
            for name, values in numbers.items()
            if not name.startswith(_UNNAMED) or np.isfinite(values).any()
        }
        return Recording(
            file.name, numbers, self._text, first=self._first, unit=self._unit, error=error
        )


def _with_thousands(cells: pd.Series[Any]) -> NDArray[np.bool_]:
    """Return which cells have dots between thousands, where no dot can be a decimal point."""
    dots = cells.str.contains(".", regex=False, na=False).to_numpy(bool)
    marked = cells.str.fullmatch(_DOTTED, na=False).to_numpy(bool)
    return np.asarray(marked if np.array_equal(dots & marked, dots) else np.zeros(len(dots), bool))


_ISO = re.compile(r"\d{4}-?\d\d-?\d\d[T ]\d\d:?\d\d")
_BEYOND = re.compile(r"[+-]?\d+(\.\d*)?[eE]\+?\d{3,}")
"""A number beyond the largest of floating point, where it cannot be converted."""
_OF_DAY = re.compile(r"\d{1,2}:\d\d:\d\d([.,]\d*|:\d{3})?( ?[AP]M)?|\d{1,3}:\d\d[.,]\d+")
"""A time of day, or minutes and seconds since the start."""
_DAY = 86400.0
_PERIODS = (
    *(size * unit for size in (_DAY, 7 * _DAY) for unit in (1.0, 1e3, 1e6, 1e9)),
    *(2.0**bits * unit for bits in (16, 32) for unit in (1.0, 1e-3, 1e-6)),
)
"""After what clocks start again at zero: a day, a week of satellites, 16 and 32 bits."""


def _since_1970(series: pd.Series[Any], form: str = "ISO8601") -> FloatArray:
    """Return the seconds since 1970 of instants, by ISO 8601; NaN where one cannot be read."""
    import pandas as pd

    read = pd.to_datetime(series, format=form, utc=True, errors="coerce")
    stamps = read.dt.tz_localize(None).to_numpy("datetime64[ns]")
    return np.asarray((stamps - np.datetime64(0, "ns")) / np.timedelta64(1, "s"), float)


def _of_day(series: pd.Series[Any]) -> FloatArray:
    """Return the seconds since midnight of times of day; NaN where one cannot be read."""
    sound = series.where(series.str.fullmatch(_OF_DAY.pattern))
    sound = sound.str.replace(",", ".", regex=False)
    sound = sound.str.replace(r":(\d{3})\b", r".\1", regex=True)
    parts = sound.str.extract(r"^(\d{1,3}):(\d\d\.\d+)$")
    minutes = 60.0 * numeric(parts[0]).to_numpy(float, na_value=np.nan)
    minutes += numeric(parts[1]).to_numpy(float, na_value=np.nan)
    if np.isfinite(minutes).any():
        return minutes
    return _since_1970("1970-01-01 " + sound, "mixed")


def _over_midnight(seconds: FloatArray) -> FloatArray:
    """Count times of day on where a day ends."""
    known = np.isfinite(seconds)
    days = np.cumsum(np.diff(seconds[known], prepend=seconds[known][:1]) < -0.5 * _DAY)
    counted = seconds.copy()
    counted[known] += _DAY * days
    return counted


def _unwrapped(values: FloatArray) -> FloatArray:
    """Return a clock that counts on where it started again at zero; else the same values.

    It must increase but for that, and go on there after one of `_PERIODS` as from row to row.
    """
    known = np.flatnonzero(np.isfinite(values))
    steps = np.diff(values[known])
    back = steps < 0
    count = np.count_nonzero(back)
    clock = 0 < count <= len(steps) // _READING.fewest and np.mean(steps > 0) > _READING.steady
    if not clock or values[known].min() < 0.0:
        return values
    forward = steps[steps > 0]
    step = float(np.median(forward)) if len(forward) else 0.0
    for period in _PERIODS:
        over = steps[back] + period
        # The last row before may be followed by a row that came late.
        if values[known].max() <= period and np.all((over > 0) & (over <= _READING.late * step)):
            found = values.copy()
            found[known] += period * np.cumsum(np.append(False, back))
            return found
    return values


MAX_LINE = 1 << 20
"""Longest line that is read [bytes]."""
MAX_BYTES = 1 << 31
"""Largest table that is read, after decompression [bytes]."""
MAX_CELLS = 100_000_000
"""Most cells that are read."""
_most: ContextVar[tuple[int, int]] = ContextVar("most", default=(MAX_BYTES, MAX_CELLS))
_AHEAD = _READING.header + (1 << 16)  # bytes that are looked at to learn how a table is written
_CHUNK = 200_000  # rows parsed at once
_SUFFIXES = {
    **dict.fromkeys((".csv", ".tsv", ".txt", ".dat", ".log", ".gz"), ".csv"),
    **dict.fromkeys((".parquet", ".pq"), ".parquet"),
}
_JSON = "JSON; pandas.json_normalize(ROWS).to_csv(FILE) makes a table of it"
_MATLAB = (
    "of MATLAB; writetable(struct2table(LOG), 'log.csv') there makes a table of a structure of "
    "columns, and timetable2table of a timetable"
)
_NUMPY = (
    "of NumPy; pandas.DataFrame(COLUMNS).to_csv(FILE) makes a table of it, with a name for each "
    "column"
)
_HDF5 = (
    "of HDF5; pandas.DataFrame(COLUMNS).to_csv(FILE) makes a table of its data sets, with a name "
    "for each"
)
_OF_BUS = "a recording of a bus; export its decoded signals as CSV, as asammdf does"
_WORKBOOK = "a workbook; save the sheet that holds the log as CSV and give that"
_FLIGHT = (
    "a flight controller's: energyplan start reads it alone; to join it, export it as CSV, as "
    "ulog2csv and mavlogdump.py --format csv do"
)
_PICKLE = "of Python's pickle; pandas.read_pickle(FILE).to_csv('log.csv') makes a table of it"
_ARROW = "of Arrow; pandas.read_feather(FILE).to_csv('log.csv') makes a table of it"
_TDMS = "of LabVIEW; nptdms.TdmsFile(FILE).as_dataframe().to_csv('log.csv') makes a table of it"
_OTHERS = {
    **dict.fromkeys((".xlsx", ".xls", ".xlsm", ".ods"), _WORKBOOK),
    **dict.fromkeys((".json", ".jsonl", ".ndjson"), _JSON),
    **dict.fromkeys((".npz", ".npy"), _NUMPY),
    **dict.fromkeys((".h5", ".hdf5", ".hdf"), _HDF5),
    **dict.fromkeys((".blf", ".asc", ".mf4", ".mdf"), _OF_BUS),
    **dict.fromkeys((".ulg", ".tlog", ".bin"), _FLIGHT),
    **dict.fromkeys((".pkl", ".pickle"), _PICKLE),
    **dict.fromkeys((".arrow", ".ipc"), _ARROW), ".mat": _MATLAB, ".tdms": _TDMS,
}  # fmt: skip
"""What files are that are not read, and what makes a table of them, by suffix."""
_BEGINNINGS = {
    rb"ARROW1": "a Feather file; pandas.read_feather(FILE).to_csv('log.csv') makes a table of it",
    rb"\xff\xff\xff\xff.{3}\0": _ARROW,
    rb"SQLite format 3": "an SQLite database; sqlite3 -header -csv FILE 'select * from TABLE' > "
    "log.csv makes a table of it; a ROS 2 bag's is named .db3",
    rb"\x28\xb5\x2f\xfd": "compressed by zstd; unzstd FILE unpacks it; of a ROS 2 bag give the "
    "folder with its metadata.yaml",
    rb"BZh": "compressed; bunzip2 FILE unpacks it",
    rb"\xfd7zXZ": "compressed; unxz FILE unpacks it",
    rb"\x1f\x8b": "compressed; gunzip FILE unpacks it; a table is read as it is by the "
    "ending .csv.gz",
    rb"\x04\x22\x4d\x18": "compressed; unlz4 FILE unpacks it",
    rb"7z\xbc\xaf": "an archive; 7z x FILE unpacks it",
    rb"Rar!": "an archive; unrar x FILE unpacks it",
    rb"PK\x03\x04": "a zip archive, as workbooks are; save the sheet that holds the log as CSV, or "
    "unzip it",
    rb"\xd0\xcf\x11\xe0": _WORKBOOK,
    rb"\x89HDF": _HDF5,
    rb"\x93NUMPY": _NUMPY,
    rb"MATLAB [57]": _MATLAB,
    rb"PAR1": "a Parquet file; name it with the ending .parquet",
    rb"#ROSBAG": "a ROS 1 bag; name it with the ending .bag",
    rb"\x89MCAP": "an MCAP file; name it with the ending .mcap",
    rb"ULog\x01\x12\x35": "a log of PX4; name it with the ending .ulg",
    rb"\xa3\x95\x80": "a log of ArduPilot; name it with the ending .bin",
    rb".{8}[\xfd\xfe].{2,8}\0": "telemetry by MAVLink, it seems; name it with the ending .tlog",
    rb"\x80[\x02-\x05]": _PICKLE,
    rb"TDSm": _TDMS,
    rb"(MDF |UnFinMF |LOGG|date \w{3} \w{3}|\(\d+\.\d+\) \w+ [0-9A-Fa-f]+#)": _OF_BUS,
    rb"\s*[\[{]\s*[\[{\"]": _JSON,
    rb"(?i:\s*<(!doctype|html|\?xml|[a-z]+[ >]))": "a page or XML; save its table as "
    "CSV and give that",
    rb"%PDF": "a document; export what it shows as CSV",
}  # fmt: skip
"""The same by the first bytes, whatever the ending, as regular expressions."""


def other_kind(file: Path) -> str:
    """Return what a file is by its first bytes, and what makes a table of it; empty for text."""
    with file.open("rb") as stream:
        head = stream.read(_READING.first)
    return next((text for mark, text in _BEGINNINGS.items() if re.match(mark, head, re.S)), "")


def read_table(
    path: str | Path, error: type[InvalidInputError], clock: Column | None = None
) -> Recording:
    """Read a table of numbers with one row of column names, or several, as ``a.csv+b.csv``."""
    parts = parts_of(path)
    if len(parts) > 1:
        split = [_SHIFTED.fullmatch(part) for part in parts]
        files = [part if one is None else one[1] for part, one in zip(parts, split, strict=True)]
        shifts = [0.0 if one is None else float(one[2]) * _SHIFTS[one[3]] for one in split]
        return join([read_table(file, error) for file in files], shifts, clock)
    file = Path(path)
    with _reading(file, error):
        parquet = _suffix(file, error) == ".parquet"
        found = _read_parquet(file, error) if parquet else _read_csv(file, error)
    if found.columns and not any(map(len, found.columns.values())):
        raise error(f"{found.source}: no row follows the names of the columns; record it again")
    return found


_SHIFTS = {"s": 1.0, "min": 60.0, "h": 3600.0}
_SHIFTED = re.compile(r"(.+)@([-+]?\d+(?:\.\d*)?)(s|min|h)")
"""A file whose clock is shifted, such as ``bms.csv@-1h``."""


def parts_of(path: str | Path) -> list[str]:
    """Return the files that are to be joined, of a path such as ``left.csv+right.csv``."""
    parts = re.split(r"(?<!@)\+", str(path))  # a plus may stand before a shift, too
    joined = len(parts) > 1 and not Path(path).exists() and all(Path(one).suffix for one in parts)
    return parts if joined else [str(path)]


def counts_rows(values: FloatArray) -> bool:
    """Return whether a column is the number of its row: that is no time."""
    return len(values) > 1 and bool(np.all(np.diff(values) == 1.0))


_PARTS = {"n": 1e-9, "u": 1e-6, "m": 1e-3, "nano": 1e-9, "micro": 1e-6, "milli": 1e-3}
_WHOLE_SECONDS = re.compile(r"(.*?)(tv_)?(secs?|seconds|s)", re.IGNORECASE)
_PART = r"(tv_)?(?:({0})(?:secs?|seconds|s)|(nano|micro|milli)(?:secs?|seconds|s))"


_SEXAGESIMAL = (("hours?|hrs?|hh?|stunden?", 24.0), ("minutes?|mins?|mm|minuten?", 60.0),
                ("seconds?|secs?|ss?|sekunden?", 60.0))  # fmt: skip
"""Names of hours, minutes and seconds that stand in columns of their own; how far they go."""


def _find_sexagesimal(columns: Mapping[str, FloatArray]) -> Column | None:
    """Return the time of hours, minutes and seconds, or of the last two, in columns of each."""
    found: list[dict[str, str]] = []
    for names, most in _SEXAGESIMAL:
        known: dict[str, str] = {}
        for name, values in columns.items():
            match = re.fullmatch(rf"(.*?)({names})", name, re.IGNORECASE)
            read = values[np.isfinite(values)]
            whole = (most == 60.0 and len(found) == 2) or not np.any(np.mod(read, 1.0))
            if match and len(read) and read.min() >= 0.0 and read.max() < most and whole:
                known.setdefault(match[1].lower(), name)
        found.append(known)
    hours, minutes, seconds = found
    for base in [base for base in minutes if base in seconds]:
        parts = [*([hours[base]] if base in hours else []), minutes[base], seconds[base]]
        if np.ptp(columns[parts[-1]][np.isfinite(columns[parts[-1]])]) > 0.0:
            weights = (3600.0, 60.0, 1.0)[-len(parts) :]
            return Column(
                field=parts[0], unit="s", plus=tuple(parts[1:]), weights=weights, channel="t"
            )
    return None


def find_stamp(columns: Mapping[str, FloatArray]) -> Column | None:
    """Return the time of whole seconds and, in a second column, their parts; or of minutes."""
    for name, seconds in columns.items():
        match = _WHOLE_SECONDS.fullmatch(name)
        known = seconds[np.isfinite(seconds)]
        if match is None or not len(known) or np.any(np.mod(known, 1.0)) or np.ptp(known) == 0.0:
            continue
        base = re.escape(match[1])
        for other, parts in columns.items():
            named = re.fullmatch(base + _PART.format("n|u|m"), other, re.IGNORECASE)
            if named is None or other == name:
                continue
            weight = _PARTS[(named[2] or named[3]).lower()]
            size = parts[np.isfinite(parts)]
            if len(size) and size.min() >= 0.0 and size.max() < 1.0 / weight and np.ptp(size) > 0.0:
                return Column(
                    field=name, unit="s", plus=(other,), weights=(1.0, weight), channel="t"
                )
    return _find_sexagesimal(columns)


def find_clock(columns: Mapping[str, FloatArray]) -> Column | None:
    """Return the column that increases all along, if there is one."""
    for name, values in columns.items():
        steps = np.diff(values)
        if len(steps) and np.all(steps > 0) and not counts_rows(values):
            return Column(field=name, channel="t")
    return None


def join(
    parts: Sequence[Recording], shifts: Sequence[float] = (), given: Column | None = None
) -> Recording:
    """Put recordings in one, each with its times by one clock; names begin with the file's."""
    name, error = "+".join(part.source for part in parts), parts[0].error
    stems = [Path(part.source).name.partition(".")[0] for part in parts]
    if len(set(stems)) < len(stems):
        raise error(f"{name}: files that are joined must differ in name; rename one")
    ways: list[list[FloatArray]] = []
    clocks: list[Column] = []
    for part, stem, late in zip(parts, stems, shifts or [0.0] * len(parts), strict=True):
        there = part.columns
        label = "" if given is None else given.field.removeprefix(f"{stem}.")
        found = given.changed(field=label) if given is not None and label in there else None
        found = found or find_stamp(there) or guess(there).get("t") or find_clock(there)
        if found is None:
            raise error(
                f"{part.source}: no column seems to be the time: say which it is with --columns "
                "t=NAME[UNIT]"
            )
        times = found.value(part.column)
        clocks.append(found)
        units = ("s",) if found.unit else time_units(times)
        ways.append([scale_of("t", unit).factor * times + late for unit in units])
    spans = [[(float(np.nanmin(t)), float(np.nanmax(t))) for t in way] for way in ways]
    best = (-np.inf, (0,) * len(parts))
    for units_of in product(*(range(len(way)) for way in ways)):
        chosen = [span[k] for span, k in zip(spans, units_of, strict=True)]
        shared = min(end for _, end in chosen) - max(start for start, _ in chosen)
        share = shared / max(min(end - start for start, end in chosen), 1e-9)
        best = max(best, (share, units_of), key=lambda one: one[0])
    if not best[0] > 0.5:
        said = ", ".join(
            "{} {:.6g} to {:.6g} s".format(part.source, *span[k])
            for part, span, k in zip(parts, spans, best[1], strict=True)
        )
        alike = len({tuple(part.columns) for part in parts}) == 1
        raise error(
            f"{name}: the clocks do not overlap ({said}); "
            + ("these seem to be drives of their own: give them one after the other, as in "
               "a.csv b.csv" if alike else
               "log all with one clock, or shift one, as in a.csv+b.csv@-1h")
        )  # fmt: skip
    _refuse_drives(parts, [way[k] for way, k in zip(ways, best[1], strict=True)])
    columns: dict[str, FloatArray] = {}
    times_of: dict[str, FloatArray] = {}
    text: dict[str, str] = {}
    for part, stem, clock, way, k in zip(parts, stems, clocks, ways, best[1], strict=True):
        order = np.argsort(way[k], kind="stable")[: np.count_nonzero(np.isfinite(way[k]))]
        t = way[k][order]
        for label, values in part.columns.items():
            if label not in clock.names:
                columns[f"{stem}.{label}"], times_of[f"{stem}.{label}"] = values[order], t
        text |= {f"{stem}.{label}": f"{part.source}: {why}" for label, why in part.text.items()}
    return Recording(name, columns, text, times_of, error=error)


def _refuse_drives(parts: Sequence[Recording], clocks: Sequence[FloatArray]) -> None:
    """Refuse to join files that each hold the motion of a robot, of which one differs."""
    moving = []
    for part, t in zip(parts, clocks, strict=True):
        found = guess(part.columns)
        counted = {} if {"v_left", "v_right"} <= {*found} else guess_encoders(part.columns)
        if not counted and not {"v_left", "v_right"} <= {*found}:
            continue
        series = usable(Series(t, part.columns[(counted or found)["v_left"].field]))
        if len(series.t) >= _READING.fewest:
            rate = np.gradient(series.values, series.t) if counted else series.values
            moving.append((part.source, Series(series.t, rate)))
    for (name, one), (other_name, other) in combinations(moving, 2):
        pair = at_common_times(one, other)
        if len(pair[0]) < _READING.fewest or min(map(np.ptp, pair)) == 0.0:
            continue
        if np.corrcoef(*pair)[0, 1] < _READING.same:
            raise parts[0].error(
                f"{name} and {other_name} are two drives: each holds the speeds of both sides, and "
                f"these differ at the same times; name them with a space, as in {name} {other_name}"
            )


def table_of(frame: Any, error: type[InvalidInputError]) -> Recording:
    """Take a pandas DataFrame as a table."""
    names = [str(label) for label in getattr(frame, "columns", ())]
    if not names or not hasattr(frame, "iloc"):
        raise error(f"{type(frame).__name__} holds no columns; give a pandas DataFrame or a file")
    if len(set(names)) < len(names):
        twice = next(one for one in names if names.count(one) > 1)
        raise error(f"the DataFrame: two columns are named {twice!r}; rename one")
    frame = frame.set_axis(names, axis=1)
    wide = pivoted(frame, names, "the DataFrame", error)
    frame = frame if wide is None else wide
    result = Columns([*map(str, frame)], 0, "row")
    result.add(frame)
    return result.table(Path("DataFrame"), error)


@contextmanager
def _reading(file: Path, error: type[InvalidInputError]) -> Iterator[None]:
    """Name the file in what the operating system complains of."""
    try:
        yield
    except OSError as problem:
        raise error(f"{file} cannot be read: {problem.strerror or problem}") from None
    except ValueError as problem:
        if isinstance(problem, InvalidInputError):
            raise
        raise error(f"{str(file)!r} cannot be read: {problem}") from None


def _suffix(file: Path, error: type[InvalidInputError]) -> str:
    suffix = _SUFFIXES.get(file.suffix.lower())
    if file.is_dir():
        raise error(
            f"{str(file)!r} is a folder; give a .csv, .parquet, .mcap or .db3 file in it, or "
            "several as one drive, as in odom.csv+battery.csv"
        )
    named = suffix == ".parquet" or file.suffix.lower() in (".gz", *_OTHERS)
    if not named and file.is_file() and (found := other_kind(file)):
        raise error(f"{file} is {found}")
    if suffix is None and file.suffix.lower() in _OTHERS:
        raise error(f"{file} is {_OTHERS[file.suffix.lower()]}")
    if suffix is None:
        raise error(f"{file} is of an unknown type; give a .csv, .csv.gz or .parquet file")
    if file.exists() and not file.is_file():  # a pipe would be waited for
        raise error(f"{str(file)!r} is no regular file; copy what it gives into one")
    return suffix


@contextmanager
def unpacked_at_most(size: int, cells: int = MAX_CELLS) -> Iterator[None]:
    """Refuse tables of more bytes after decompression, or of more cells, as a service does."""
    token = _most.set((min(size, MAX_BYTES), min(cells, MAX_CELLS)))
    try:
        yield
    finally:
        _most.reset(token)


def _bytes(file: Path, error: type[InvalidInputError]) -> bytes:
    """Return a text file's bytes; a few of gzip can hold terabytes."""
    limit, _ = _most.get()
    try:
        if file.suffix.lower() == ".gz":
            with gzip.open(file) as packed:
                data = _unpacked(packed, file, error)
        else:
            with file.open("rb") as stream:
                data = stream.read(limit + 1)
    except (gzip.BadGzipFile, EOFError, zlib.error) as problem:
        raise error(f"{file} is no sound gzip file ({problem}); copy or compress it anew") from None
    _refuse_larger(len(data), file, error)
    return data


def _refuse_larger(size: int, file: Path, error: type[InvalidInputError]) -> None:
    """Refuse a table of more bytes than are read."""
    limit, _ = _most.get()
    if size > limit:
        raise error(f"{file} holds more than {limit >> 20} MiB; split it")


def _unpacked(stream: gzip.GzipFile, file: Path, error: type[InvalidInputError]) -> bytes:
    """Return unpacked bytes; a line that is too long, or too many bytes, end it at once."""
    found, size, line, zeros = io.BytesIO(), 0, 0, 0
    while part := stream.read(MAX_LINE):
        size += len(part)
        _refuse_larger(size, file, error)
        if not part.strip(b"\0"):  # kept only where more follows
            zeros += len(part)
            continue
        last = part.rfind(b"\n")
        line = max(zeros, len(part) - 1 - last if last >= 0 else line + zeros + len(part))
        if line > MAX_LINE + 1:
            raise error(
                f"{file} has a line longer than {MAX_LINE >> 10} KiB; this is no table of numbers"
            )
        found.write(bytes(zeros) + part)
        zeros = 0
    return found.getvalue()


def _cells(data: bytes, mark: str) -> NDArray[np.intp]:
    """Return how many marks stand in each line."""
    letters = np.frombuffer(data, np.uint8)
    ends = letters == ord("\n")
    places = np.flatnonzero(ends | (letters == ord(mark)))
    lines = np.flatnonzero(ends[places])
    if len(data) and not ends[-1]:
        lines = np.append(lines, len(places))
    return np.diff(lines, prepend=-1) - 1


def _numbers(data: bytes, separator: str, shape: tuple[int, int]) -> FloatArray | None:
    """Return the cells of a table that holds nothing but numbers; None of any other."""
    if not data:
        return None
    mark = None if separator == _SPACES else separator
    try:
        cells = np.loadtxt(io.BytesIO(data), delimiter=mark, comments=None, ndmin=2)
    except ValueError:
        return None
    return cells if cells.shape == shape else None  # blank lines are skipped, but counted


def _read_csv(file: Path, error: type[InvalidInputError]) -> Recording:
    data = _bytes(file, error)
    dialect = find_dialect(data[:_AHEAD], len(data) < _AHEAD, file, error)
    # Zeros at the end are what a file system leaves that lost its power.
    data, names = data[dialect.start :].rstrip(b"\0"), dialect.names
    ends = np.flatnonzero(np.frombuffer(data, np.uint8) == ord("\n"))
    if np.max(np.diff(ends, prepend=-1, append=len(data)), initial=0) > MAX_LINE + 1:
        raise error(
            f"{file} has a line longer than {MAX_LINE >> 10} KiB; this is no table of numbers"
        )
    columns = Columns(names, dialect.line, "line", dialect.decimal)
    rows, most = len(ends) + (not data.endswith(b"\n")), _most.get()[1] // len(names)
    if rows > most:
        raise error(f"{file} has more than {most} rows of {len(names)} columns; split it")
    # Pandas reads a large table five times as fast; a small one is read before it is imported.
    small = len(data) <= _AHEAD or find_spec("pandas") is None
    numbers = _numbers(data, dialect.separator, (rows, len(names))) if small else None
    if numbers is not None and not numbered(names):
        columns.add_numbers(numbers)
        return columns.table(file, error)
    with needs_extra("logs", f"reading {file}, a table of more than numbers,"):
        import pandas as pd

    parts: list[pd.DataFrame] | None = []  # of one reading a row
    for frame in _frames(data, dialect, file, error):
        if columns.rows == 0 and not parts and pivoted(frame, names, file, error) is None:
            parts = None
        if parts is not None:
            parts.append(frame)
            continue
        columns.add(frame)
    wide = pivoted(pd.concat(parts), names, file, error) if parts else None
    if wide is not None:
        columns = Columns(list(map(str, wide)), 1, "instant")
        columns.add(wide)
        return columns.table(file, error)
    table = columns.table(file, error)
    # The parser does not report rows that have fewer cells, though some.
    one = len(dialect.separator) == 1
    cells = (_cells(data, dialect.separator) if one else np.zeros(0, int))[: columns.rows]
    short = np.flatnonzero((cells > 0) & (cells < dialect.named - 1))
    if len(short) > max(1.0, _READING.stray * columns.rows):
        raise error(
            f"{file}, line {dialect.line + int(short[0])}: the row has fewer cells than the "
            f"{dialect.named} names, and so have {len(short)} of {columns.rows} rows: which cell "
            "is missing cannot be known; write every cell, empty ones too"
        )
    for values in table.columns.values():
        values[short] = np.nan  # which of the cells are missing is not known
    return table


def _frames(
    data: bytes, dialect: Dialect, file: Path, error: type[InvalidInputError]
) -> Iterator[pd.DataFrame]:
    """Yield the rows of a table, some at a time, under its names."""
    import pandas as pd

    # before 3.1 pandas is wrong in the last bit of one number of six by default
    old = tuple(map(int, pd.__version__.split(".")[:2])) < (3, 1)
    exact: dict[str, Any] = {"float_precision": "round_trip"} if old else {}
    try:
        reader = pd.read_csv(
            io.BytesIO(data),
            header=None,
            names=range(len(dialect.names)),
            sep=dialect.separator,
            decimal=dialect.decimal,
            encoding=dialect.encoding,
            encoding_errors="replace",  # in text; a number has no such letters
            na_values=list(_MISSING),
            index_col=False,
            skip_blank_lines=False,  # so that rows keep their line numbers
            skipinitialspace=True,
            low_memory=False,
            chunksize=_CHUNK,  # the parser's memory is several times that of the numbers
            **exact,
        )
        while True:
            with warnings.catch_warnings():
                # Rows wider than the header would lose their surplus with no more than a warning.
                warnings.simplefilter("error", pd.errors.ParserWarning)
                frame = next(reader, None)
            if frame is None:
                return
            frame.columns = dialect.names
            yield frame
    except pd.errors.EmptyDataError:
        pass
    except pd.errors.ParserWarning:
        raise error(
            f"{file}: rows have more cells than the {len(dialect.names)} names of line "
            f"{max(dialect.line - 1, 1)}; name every column, and write decimals with a point "
            "where commas separate cells"
        ) from None
    except pd.errors.ParserError as problem:
        raise error(f"{file} is no table: {_with_line(str(problem), dialect.line)}") from None


def _with_line(problem: str, first: int) -> str:
    """Count the parser's complaint from the file's line 1; it saw the readings alone."""
    text = problem.strip().removeprefix("Error tokenizing data. C error: ")
    head, found, tail = text.partition(" in line ")
    number, _, rest = tail.partition(",")
    return (
        f"{head} in line {int(number) + first - 1},{rest}" if found and number.isdecimal() else text
    )


def _read_parquet(file: Path, error: type[InvalidInputError]) -> Recording:
    with needs_extra("parquet", f"reading {file}"):
        import pandas  # noqa: F401 - for the conversion
        import pyarrow as pa
        import pyarrow.parquet as pq
    try:
        with pq.ParquetFile(file) as parquet:
            shape = parquet.metadata.num_rows, parquet.metadata.num_columns
            if shape[1] > MAX_COLUMNS or shape[0] * shape[1] > _most.get()[1]:
                raise error(f"{file} has {shape[0]} rows of {shape[1]} columns; split it")
            schema = parquet.schema_arrow
            names = [str(name) for name in schema.names]
            if len(set(names)) < len(names):
                raise error(f"{file} names a column twice; rename one")
            # Text and lists stay unread: a few bytes can stand for gigabytes of them.
            kinds = {name: schema.field(name).type for name in names}
            numbers = [name for name, kind in kinds.items() if _holds_numbers(kind)]
            # Of groups: where what a column says is damaged, pyarrow ends the process.
            groups = map(parquet.metadata.row_group, range(parquet.metadata.num_row_groups))
            _refuse_larger(sum(group.total_byte_size for group in groups), file, error)
            frame = parquet.read(columns=numbers).to_pandas(ignore_metadata=True)
    except (pa.ArrowException, OSError, RuntimeError) as problem:
        first = (str(problem).splitlines() or [""])[0]
        raise error(f"{file} is no sound Parquet file: {first}") from None
    columns = Columns(numbers, 1, "row")
    columns.add(frame)
    table = columns.table(file, error)
    text = {n: f"row 1: {n!r} is of type {kind}" for n, kind in kinds.items() if n not in numbers}
    return replace(table, text={**table.text, **text})


def _holds_numbers(kind: pa.DataType) -> bool:
    """Return whether cells of a Parquet type are numbers, times, or nothing at all."""
    from pyarrow import types

    if types.is_dictionary(kind):
        kind = kind.value_type
    return bool(types.is_primitive(kind) or types.is_decimal(kind) or types.is_null(kind))
