"""Tables of numbers from CSV, JSON lines and Parquet, with the place of every complaint."""

from __future__ import annotations

import codecs
import gzip
import io
import json
import re
import warnings
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, NamedTuple

import numpy as np
from numpy.typing import NDArray

from energyplan.errors import InvalidInputError, MissingDependencyError
from energyplan.logs.clean import hold_unchanged
from energyplan.logs.dialect import (
    MAX_COLUMNS,
    MAX_HEADER,
    MISSING,
    UNNAMED,
    Dialect,
    Instants,
    find_dialect,
    instants_of,
    over_midnight,
    whole_stamps,
)
from energyplan.logs.guess import guess
from energyplan.logs.mapping import is_unit, scale_of, split_unit, time_unit
from energyplan.path import FloatArray

if TYPE_CHECKING:  # pandas is slow to import, and needed only where a file is read
    import pandas as pd
    import pyarrow as pa
    from _typeshed import WriteableBuffer

_THOUSANDS = re.compile(r"'[-+]?\d{1,3}([,' ]\d{3})+(\.\d*)?'$")
_NO_COMMAS = "write the column without marks between thousands, as in 12345.6"
_CORRECT = "correct the cell or map another column"


@dataclass(frozen=True)
class Table:
    """Columns of numbers, and where they came from."""

    source: str  # name of the file, for messages
    columns: Mapping[str, FloatArray]  # (n,): the columns that hold numbers
    text: Mapping[str, str]
    first: int  # number of the first row of data
    unit: str  # what that number counts
    error: type[InvalidInputError]  # error to raise for bad content
    held: Mapping[str, NDArray[np.intp]] = field(default_factory=dict)
    joined: bool = False  # whether rows are of several files

    def place(self, row: int) -> str:
        """Name the place of a row, such as ``"line 12"``."""
        return f"{self.unit} {self.first + row}"

    def unchanged_held(self) -> Table:
        """Return the table of a drive, its blanks filled where a logger wrote only what changed."""
        if self.joined:
            return self
        held = hold_unchanged(self.columns)
        return replace(self, columns=held.columns, held=held.rows)

    def column(self, name: str) -> FloatArray:
        """Return a column."""
        if name in self.columns:
            return self.columns[name]
        if name in self.text:
            raise self.error(
                f"{self.source}, {self.text[name]}, which is no number; "
                + (_NO_COMMAS if _THOUSANDS.search(self.text[name]) else _CORRECT)
            )
        there = ", ".join([*self.columns, *self.text][:20])
        raise self.error(f"{self.source}: there is no column {name!r}; the columns are {there}")


class Columns:
    """Columns as they are read, piece by piece, sorted into numbers and text."""

    def __init__(self, names: list[str], first: int, unit: str, decimal: str = ".") -> None:
        self.rows, self._first, self._unit, self._decimal = 0, first, unit, decimal
        self._numbers: dict[str, list[FloatArray]] = {name: [] for name in names}
        self._text: dict[str, str] = {}
        self._instants: dict[str, Instants] = {}

    def add(self, frame: pd.DataFrame) -> None:
        """Take in the next rows."""
        import pandas as pd

        for label, series in zip(self._numbers, (frame[name] for name in frame), strict=True):
            if label in self._text:
                continue
            if pd.api.types.is_datetime64_any_dtype(series):
                stamps = series.to_numpy("datetime64[ns]")
                seconds = (stamps - np.datetime64(0, "ns")) / np.timedelta64(1, "s")
                self._numbers[label].append(np.asarray(seconds, float))
                continue
            if not pd.api.types.is_numeric_dtype(
                series
            ):  # text among numbers, or integers beyond 64 bits
                series = self._mended(label, series.astype("string").str.strip())
            values = pd.to_numeric(series, errors="coerce").to_numpy(float, na_value=np.nan)
            bad = np.flatnonzero(np.isnan(values) & series.notna().to_numpy())
            if len(bad):
                written = self._instants.get(label) or instants_of(series)
                if written is not None:
                    self._instants[label] = written
                    values = written.seconds(series)
                    bad = np.flatnonzero(np.isnan(values) & series.notna().to_numpy())
            if len(bad):
                k = int(bad[0])
                place = f"{self._unit} {self._first + self.rows + k}"
                self._text[label] = f"{place}: {label!r} is {str(series.iloc[k])[:40]!r}"
                self._numbers[label].clear()
            else:
                self._numbers[label].append(values)
        self.rows += len(frame)

    def _mended(self, label: str, series: pd.Series[Any]) -> pd.Series[Any]:
        """Blank names and units that stand among readings; decimal commas become points.

        Where recordings were appended to each other, each brought its own line of names.
        """
        bare, unit = split_unit(label)
        series = series.mask(series.isin({label, bare, unit, f"[{unit}]"} - {"", "[]"}))
        return series.str.replace(",", ".", regex=False) if self._decimal == "," else series

    def table(self, file: Path, error: type[InvalidInputError]) -> Table:
        """Return what was read."""
        numbers = {
            name: np.concatenate(parts) if parts else np.zeros(0)
            for name, parts in self._numbers.items()
            if name not in self._text
        }
        for name, written in self._instants.items():
            if written.of_day and name in numbers:
                numbers[name] = over_midnight(numbers[name])
        # Where lines end with a separator, a column without a name holds nothing.
        numbers = {
            name: values
            for name, values in numbers.items()
            if not name.startswith(UNNAMED) or np.isfinite(values).any()
        }
        return Table(file.name, whole_stamps(numbers), self._text, self._first, self._unit, error)


_DEEPEST = 8  # levels of objects in each other that are read
_MOST_PARTS = 4096  # names in a file


def read_json_lines(
    lines: Iterable[bytes], file: object, most: int, error: type[InvalidInputError]
) -> pd.DataFrame:
    """Read rows that are a JSON object each."""
    import pandas as pd

    rows: list[dict[str, Any]] = []
    names: dict[str, None] = {}
    for number, line in enumerate(lines, 1):
        row: dict[str, Any] = {}
        if line.strip():
            try:
                made = json.loads(line)
            except (ValueError, RecursionError) as problem:
                raise error(f"{file}, line {number} is no JSON object: {problem}") from None
            if not isinstance(made, dict):
                raise error(f"{file}, line {number} is no JSON object, which a row of a log is")
            row = dict(_parts("", made, 0))
        rows.append(row)
        names |= dict.fromkeys(row)
        if len(names) > _MOST_PARTS or len(rows) * max(len(names), 1) > most:
            raise error(f"{file} has {len(rows)} rows and {len(names)} names or more; split it")
    if not names:
        raise error(f'{file} is empty; each line must be a JSON object such as {{"t": 0.1}}')
    return pd.DataFrame({name: pd.Series([row.get(name) for row in rows]) for name in names})


def _parts(name: str, value: object, depth: int) -> Iterator[tuple[str, object]]:
    """Yield what an object holds by its name, the parts of its parts with a dot between."""
    if isinstance(value, dict) and depth < _DEEPEST:
        for key, part in value.items():
            yield from _parts(f"{name}.{key}" if name else str(key), part, depth + 1)
    elif isinstance(value, list) and depth < _DEEPEST and len(value) <= 64:
        for k, part in enumerate(value):
            yield from _parts(f"{name}[{k}]", part, depth + 1)
    elif value is None or isinstance(value, str | int | float):
        yield name, value


_TIME = re.compile(r".*(time|stamp|date|zeit|epoch|clock).*|t|ts|sec|secs|seconds", re.IGNORECASE)
_UNIT = re.compile(r"units?|einheit", re.IGNORECASE)
_MOST_NAMES = 500
_OFTEN = 4  # readings of each name, on average


@dataclass(frozen=True)
class LongFormat:
    """Which columns of a table hold the times, the names and the readings."""

    time: str  # names of these columns
    name: str  # names of these columns
    value: str  # names of these columns
    unit: str | None = None  # name of a column of units

    def wide(self, frame: pd.DataFrame) -> pd.DataFrame:
        """Return a row for each time, with a column for each name.

        Of several readings of a name at one time the last stands; a name whose readings are not all
        numbers is a column of text.
        """
        import pandas as pd

        kept = frame[frame[self.name].notna() & frame[self.time].notna()]
        names = kept[self.name].astype("string").str.strip()
        if self.unit is not None:
            units = kept[self.unit].astype("string").str.strip().fillna("")
            known = units.map({unit: is_unit(unit) for unit in units.unique()}).astype(bool)
            names = names.where(~known, names + " [" + units + "]")
        times = kept[self.time]
        # Rows stand in the order of time in which they were written.
        rows = np.cumsum(np.append(0, np.asarray(times.to_numpy()[1:] != times.to_numpy()[:-1])))
        made: dict[str, Any] = {self.time: times[np.diff(rows, prepend=-1) > 0].to_numpy()}
        count = int(rows[-1]) + 1 if len(rows) else 0
        for name in names.unique():
            mine = np.asarray(names == name)
            readings = kept[self.value][mine]
            numbers = pd.to_numeric(readings, errors="coerce")
            text = bool(np.any(numbers.isna() & readings.notna()))
            values = np.full(count, None if text else np.nan, object if text else float)
            values[rows[mine]] = readings if text else numbers.to_numpy(float)
            made[str(name) if name != self.time else f"{name} (name)"] = values
        return pd.DataFrame(made)


def find_long(frame: pd.DataFrame) -> LongFormat | None:
    """Tell whether each row of a table is one reading, with its time and its name.

    Beside a column of times and one of names there is just one of readings; others hold one text
    throughout, or units.
    """
    left = [name for name in map(str, frame) if frame[name].nunique() > 1]
    if not 3 <= len(left) <= 4:
        return None
    times = [name for name in left if _TIME.fullmatch(name.strip())]
    others = [name for name in left if name not in times[:1]]
    words = [name for name in others if _is_text(frame[name])]
    names = _only(words, lambda name: not _UNIT.fullmatch(name.strip()))
    unit = _only(words, lambda name: bool(_UNIT.fullmatch(name.strip())))
    value = _only(others, lambda name: name not in (names, unit))
    if not times or names is None or value is None:
        return None
    distinct = frame[names].nunique()
    if distinct > min(_MOST_NAMES, len(frame) / _OFTEN):
        return None
    return LongFormat(times[0], names, value, unit)


def _only(names: list[str], fits: Callable[[str], bool]) -> str | None:
    """Return the one name that fits."""
    found = [name for name in names if fits(name)]
    return found[0] if len(found) == 1 else None


def _is_text(series: pd.Series[Any]) -> bool:
    """Tell whether most cells are words: neither numbers nor instants."""
    import pandas as pd

    if pd.api.types.is_numeric_dtype(series) or pd.api.types.is_datetime64_any_dtype(series):
        return False
    there = series.dropna().astype("string").str.strip()
    numbers = pd.to_numeric(there, errors="coerce")
    return float(numbers.isna().mean()) > 0.5 and instants_of(there) is None


MAX_LINE = 1 << 20
"""Longest line that is read [bytes]."""
MAX_BYTES = 1 << 31
"""Largest table that is read, after decompression [bytes]."""
MAX_CELLS = 100_000_000
"""Most cells that are read."""
_AHEAD = MAX_HEADER + (1 << 16)  # bytes that are looked at to learn how a table is written
_STRAY_ROWS = 0.01  # share of rows that may be cut short
_CHUNK = 200_000  # rows parsed at once
_SUFFIXES = {
    **dict.fromkeys((".csv", ".tsv", ".txt", ".dat", ".gz"), ".csv"),
    **dict.fromkeys((".jsonl", ".ndjson"), ".jsonl"),
    **dict.fromkeys((".parquet", ".pq"), ".parquet"),
}
_SHEETS = (".xlsx", ".xls", ".xlsm", ".ods")
_INTERRUPTED = "Calling read(nbytes) on source failed"
"""What the parser makes of Ctrl-C at the moment when it asks for bytes; errors it passes on."""


def read_table(path: str | Path, error: type[InvalidInputError]) -> Table:
    """Read a table of numbers with one row of column names, or several, as ``a.csv+b.csv``."""
    parts = parts_of(path)
    if len(parts) > 1:
        return _join([read_table(part, error) for part in parts], error)
    file = Path(path)
    with _reading(file, error):
        if _suffix(file, error) == ".parquet":
            return _read_parquet(file, error)
        with file.open("rb") as raw:
            stream = io.BufferedReader(_Guarded(raw, file, error))
            if _suffix(file, error) == ".jsonl":
                frame = read_json_lines(stream, file, MAX_CELLS, error)
                long = find_long(frame)
                if long is not None:
                    return _widened(frame, long, ".", file, error)
                columns = Columns(list(map(str, frame)), 1, "line")
                columns.add(frame)
                return columns.table(file, error)
            return _read_csv(stream, file, error)


def parts_of(path: str | Path) -> list[str]:
    """Return the files that are to be joined, of a path such as ``left.csv+right.csv``."""
    parts = str(path).split("+")
    joined = len(parts) > 1 and not Path(path).exists() and all(Path(one).suffix for one in parts)
    return parts if joined else [str(path)]


def _join(tables: list[Table], error: type[InvalidInputError]) -> Table:
    """Put the rows of several tables in one, in the order of one clock; cells of others are blank.

    Columns bear the name of their file before their own.
    """
    name = "+".join(table.source for table in tables)
    stems = [Path(table.source).name.partition(".")[0] for table in tables]
    if len(set(stems)) < len(stems):
        raise error(f"{name}: files that are joined must differ in name; rename one")
    clocks, names = [], []
    for table in tables:
        found = guess(table.columns).get("t")
        if found is None:
            raise error(f"{table.source}: no column seems to be the time; name one 'time [s]'")
        times = table.columns[found.name]
        names.append(found.name)
        clocks.append(scale_of("t", found.unit or time_unit(times)).factor * times)
    spans = [(float(np.nanmin(t)), float(np.nanmax(t))) for t in clocks]
    shared = min(end for _, end in spans) - max(start for start, _ in spans)
    if not shared > 0.5 * min(end - start for start, end in spans):
        told = ", ".join(
            f"{one.source} {a:.6g} to {b:.6g} s" for one, (a, b) in zip(tables, spans, strict=True)
        )
        raise error(f"{name}: the clocks do not overlap ({told}); log all with one clock")
    order = np.argsort(np.concatenate(clocks), kind="stable")
    ends = np.cumsum([len(t) for t in clocks])
    columns = {"t": np.concatenate(clocks)[order]}
    text: dict[str, str] = {}
    for stem, clock, table, end in zip(stems, names, tables, ends, strict=True):
        for label, values in table.unchanged_held().columns.items():
            if label == clock:
                continue
            whole = np.full(len(order), np.nan)
            whole[end - len(values) : end] = values
            columns[f"{stem}.{label}"] = whole[order]
        text |= {f"{stem}.{label}": f"{table.source}: {why}" for label, why in table.text.items()}
    return Table(name, columns, text, 1, "joined row", error, joined=True)


def table_of(frame: Any, error: type[InvalidInputError]) -> Table:
    """Take a pandas DataFrame as a table."""
    names = [str(label) for label in getattr(frame, "columns", ())]
    if not names or not hasattr(frame, "iloc"):
        raise error(f"{type(frame).__name__} holds no columns; give a pandas DataFrame or a file")
    if len(set(names)) < len(names):
        twice = next(one for one in names if names.count(one) > 1)
        raise error(f"the DataFrame: two columns are named {twice!r}; rename one")
    named = frame.set_axis(names, axis=1)
    long = find_long(named)
    if long is not None:
        return _widened(named, long, ".", Path("DataFrame"), error)
    made = Columns(names, 0, "row")
    made.add(frame)
    return made.table(Path("DataFrame"), error)


def column_names(path: str | Path, error: type[InvalidInputError]) -> list[str]:
    """Return the column names of a CSV or gzipped CSV file, which is read no further."""
    file = Path(path)
    with _reading(file, error):
        if _suffix(file, error) in (".parquet", ".jsonl"):
            raise error(f"{file} is no CSV file")
        with file.open("rb") as raw:
            stream = io.BufferedReader(_Guarded(raw, file, error))
            return _opened(stream, file, error).dialect.names


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
            f"{str(file)!r} is a folder; give a .csv, .csv.gz or .parquet file in it, or several "
            "as one drive, as in odom.csv+battery.csv"
        )
    if suffix is None and file.suffix.lower() in _SHEETS:
        raise error(f"{file} is a workbook; save the sheet that holds the log as CSV and give that")
    if suffix is None:
        raise error(f"{file} is of an unknown type; give a .csv, .csv.gz, .jsonl or .parquet file")
    return suffix


class _Guarded(io.RawIOBase):
    """A text file, unzipped where need be, with an end to its size and to its lines.

    A few bytes of gzip can hold terabytes, and a line without an end would fill the memory.
    """

    def __init__(self, raw: BinaryIO, file: Path, error: type[InvalidInputError]) -> None:
        super().__init__()
        self._stream = gzip.GzipFile(fileobj=raw) if file.suffix.lower() == ".gz" else raw
        self._file, self._error, self._left, self._line = file, error, MAX_BYTES, 0
        self._utf16: codecs.IncrementalDecoder | None = None
        self._ready, self._begun = b"", False

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: WriteableBuffer, /) -> int:
        view = memoryview(buffer).cast("B")
        if not self._ready:
            self._ready = self._more(len(view))
        data, self._ready = self._ready[: len(view)], self._ready[len(view) :]
        view[: len(data)] = data
        self._left -= len(data)
        if self._left < 0:
            raise self._error(f"{self._file} holds more than {MAX_BYTES >> 20} MiB; split it")
        end = data.rfind(b"\n")
        self._line = len(data) - 1 - end if end >= 0 else self._line + len(data)
        if self._line > MAX_LINE:
            raise self._error(
                f"{self._file} has a line longer than {MAX_LINE >> 10} KiB; this is no table of "
                "numbers"
            )
        return len(data)

    def _more(self, size: int) -> bytes:
        """Return the next bytes, of UTF-16 as UTF-8; none at the end."""
        data = self._raw(size)
        if not self._begun:
            self._begun = True
            if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
                self._utf16 = codecs.getincrementaldecoder("utf-16")()
        while self._utf16 is not None:
            try:
                text = self._utf16.decode(data, final=not data)
            except UnicodeDecodeError as problem:
                raise self._error(
                    f"{self._file} is no sound UTF-16 text ({problem.reason}); save it as UTF-8"
                ) from None
            if text or not data:
                return text.encode()
            data = self._raw(size)
        return data

    def _raw(self, size: int) -> bytes:
        try:
            return self._stream.read(size)
        except (gzip.BadGzipFile, EOFError, zlib.error) as problem:
            raise self._error(
                f"{self._file} is no sound gzip file ({problem}); copy or compress it anew"
            ) from None


class _Rewound(io.RawIOBase):
    """What was read ahead of a stream, and then the stream."""

    def __init__(self, ahead: bytes, stream: io.BufferedReader[Any]) -> None:
        super().__init__()
        self._ahead, self._stream = io.BytesIO(ahead), stream

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: WriteableBuffer, /) -> int:
        return self._ahead.readinto(buffer) or self._stream.readinto(buffer)


class _Rows(io.RawIOBase):
    """Lines on their way to the parser, which does not tell how many cells each had."""

    def __init__(self, stream: io.BufferedReader[Any], separator: str) -> None:
        super().__init__()
        self._stream, self._separator = stream, separator.encode()
        self._counts: list[NDArray[np.int32]] = []
        self._open = 0  # separators in the line that has not ended

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: WriteableBuffer, /) -> int:
        size = self._stream.readinto1(buffer)
        data = np.frombuffer(memoryview(buffer), np.uint8)[:size]
        marks = np.cumsum(data == ord(self._separator), dtype=np.int32)
        ends = marks[data == ord("\n")]
        counts = np.diff(ends, prepend=np.int32(0))
        if len(ends):
            counts[0] += self._open
            self._counts.append(counts)
            self._open = 0
        self._open += int(marks[-1] - (ends[-1] if len(ends) else 0)) if size else 0
        return size

    def short(self, cells: int) -> NDArray[np.intp]:
        """Return which rows have fewer cells, though some."""
        counts = np.concatenate([*self._counts, np.array([self._open], np.int32)])
        return np.flatnonzero((counts > 0) & (counts < cells - 1))


class _Opened(NamedTuple):
    """How a text file writes its table, and its readings."""

    dialect: Dialect
    readings: io.BufferedReader[Any]


def _opened(stream: io.BufferedReader[Any], file: Path, error: type[InvalidInputError]) -> _Opened:
    """Read the line of column names, and look at the lines that follow."""
    head = stream.read(_AHEAD)
    dialect = find_dialect(head, len(head) < _AHEAD, file, error)
    return _Opened(dialect, io.BufferedReader(_Rewound(head[dialect.start :], stream)))


def _read_csv(stream: io.BufferedReader[Any], file: Path, error: type[InvalidInputError]) -> Table:
    import pandas as pd

    dialect, readings = _opened(stream, file, error)
    names = dialect.names
    most = MAX_CELLS // len(names)
    columns = Columns(names, dialect.line, "line", dialect.decimal)
    # before 3.1 pandas is out by the last bit in one number of six, unless it is asked not to be
    old = tuple(map(int, pd.__version__.split(".")[:2])) < (3, 1)
    exact: dict[str, Any] = {"float_precision": "round_trip"} if old else {}
    long: LongFormat | None = None
    parts: list[pd.DataFrame] = []
    rows = _Rows(readings, dialect.separator) if len(dialect.separator) == 1 else None
    try:
        with warnings.catch_warnings():
            # Rows wider than the header would lose their surplus with no more than a warning.
            warnings.simplefilter("error", pd.errors.ParserWarning)
            for frame in pd.read_csv(
                readings if rows is None else io.BufferedReader(rows),
                header=None,
                names=range(len(names)),
                sep=dialect.separator,
                decimal=dialect.decimal,
                encoding=dialect.encoding,
                encoding_errors="replace",  # in text; a number has no such letters
                na_values=list(MISSING),
                index_col=False,
                skip_blank_lines=False,  # so that rows keep their line numbers
                skipinitialspace=True,
                low_memory=False,
                chunksize=_CHUNK,  # the parser's memory is several times that of the numbers
                **exact,
            ):
                frame.columns = names
                if columns.rows == 0 and not parts:
                    long = find_long(frame)
                if long is not None:
                    parts.append(frame)
                    continue
                columns.add(frame)
                if columns.rows > most:
                    raise error(
                        f"{file} has more than {most} rows of {len(names)} columns; split it"
                    )
    except pd.errors.EmptyDataError:
        pass
    except pd.errors.ParserWarning:
        raise error(
            f"{file}: rows have more cells than the {len(names)} names of line "
            f"{max(dialect.line - 1, 1)}; name every column"
        ) from None
    except pd.errors.ParserError as problem:
        if _INTERRUPTED in str(problem):
            raise KeyboardInterrupt from None
        raise error(f"{file} is no table: {_with_line(str(problem), dialect.line)}") from None
    if long is not None:
        return _widened(pd.concat(parts), long, dialect.decimal, file, error)
    table = columns.table(file, error)
    short = np.zeros(0, int) if rows is None else rows.short(dialect.named)
    short = short[short < columns.rows]
    if len(short) > max(1.0, _STRAY_ROWS * columns.rows):
        raise error(
            f"{file}, line {dialect.line + int(short[0])}: the row has fewer cells than the "
            f"{dialect.named} names, and so have {len(short)} of {columns.rows} rows: which cell "
            "is missing cannot be known; write every cell, empty ones too"
        )
    for values in table.columns.values():
        values[short] = np.nan  # which of the cells are missing is not known
    return table


def _widened(
    frame: pd.DataFrame, long: LongFormat, decimal: str, file: Path, error: type[InvalidInputError]
) -> Table:
    """Take a table of one reading a row."""
    if decimal == ",":
        texts = frame[long.value].astype("string")
        frame = frame.assign(**{long.value: texts.str.replace(",", ".", regex=False)})
    if len(frame) * frame[long.name].nunique() > MAX_CELLS:
        raise error(f"{file} has {len(frame)} readings of many names; split it")
    wide = long.wide(frame)
    columns = Columns(list(map(str, wide)), 1, "instant", decimal)
    columns.add(wide)
    return columns.table(file, error)


def _with_line(problem: str, first: int) -> str:
    """Count the parser's complaint from the file's line 1; it saw the readings alone."""
    text = problem.strip().removeprefix("Error tokenizing data. C error: ")
    head, found, tail = text.partition(" in line ")
    number, _, rest = tail.partition(",")
    return (
        f"{head} in line {int(number) + first - 1},{rest}" if found and number.isdecimal() else text
    )


def _read_parquet(file: Path, error: type[InvalidInputError]) -> Table:
    try:
        import pyarrow as pa
        import pyarrow.parquet as pq
    except ImportError:
        raise MissingDependencyError(
            f"reading {file} needs pyarrow; install it with pip install 'energyplan[parquet]'"
        ) from None
    try:
        with pq.ParquetFile(file) as parquet:
            shape = parquet.metadata.num_rows, parquet.metadata.num_columns
            if shape[1] > MAX_COLUMNS or shape[0] * shape[1] > MAX_CELLS:
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
            if sum(group.total_byte_size for group in groups) > MAX_BYTES:
                raise error(f"{file} holds more than {MAX_BYTES >> 20} MiB; split it")
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
    """Tell whether cells of a Parquet type are numbers, times, or nothing at all."""
    from pyarrow import types

    if types.is_dictionary(kind):
        kind = kind.value_type
    return bool(types.is_primitive(kind) or types.is_decimal(kind) or types.is_null(kind))
