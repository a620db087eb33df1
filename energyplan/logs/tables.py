"""Tables of numbers from CSV, gzipped CSV and Parquet, with the place of every complaint."""

from __future__ import annotations

import csv
import gzip
import io
import re
import warnings
import zlib
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, NamedTuple

import numpy as np

from energyplan.errors import InvalidInputError, MissingDependencyError
from energyplan.path import FloatArray

if TYPE_CHECKING:  # pandas is slow to import, and needed only where a file is read
    import pandas as pd
    import pyarrow as pa
    from _typeshed import WriteableBuffer

MAX_COLUMNS = 4096
"""Widest table that is read."""
MAX_HEADER = 1 << 18
"""Longest header line that is read [bytes]."""
MAX_LINE = 1 << 20
"""Longest line that is read [bytes]."""
MAX_BYTES = 1 << 31
"""Largest table that is read, after decompression [bytes]."""
MAX_CELLS = 100_000_000
"""Most cells that are read."""
_AHEAD = 4096  # bytes of readings that are looked at to learn how they are written
_CHUNK = 200_000  # rows parsed at once
_INTERRUPTED = "Calling read(nbytes) on source failed"
"""What the parser makes of Ctrl-C at the moment when it asks for bytes; errors it passes on."""


@dataclass(frozen=True)
class Table:
    """Columns of numbers, and where they came from.

    Parameters
    ----------
    source : str
        Name of the file, for messages.
    columns : mapping of str to ndarray, shape (n,)
        The columns that hold numbers; an empty cell is NaN.
    text : mapping of str to str
        The other columns, each with the place and content of its first cell that is no number.
    first : int
        Number of the first row of data.
    unit : str
        What that number counts: ``"line"`` of a text file or ``"row"`` of another.
    error : type
        Error to raise for bad content.
    """

    source: str
    columns: Mapping[str, FloatArray]
    text: Mapping[str, str]
    first: int
    unit: str
    error: type[InvalidInputError]

    def place(self, row: int) -> str:
        """Name the place of a row, such as ``"line 12"``."""
        return f"{self.unit} {self.first + row}"

    def column(self, name: str) -> FloatArray:
        """Return a column.

        Raises
        ------
        InvalidInputError
            If there is no such column or it holds text.
        """
        if name in self.columns:
            return self.columns[name]
        if name in self.text:
            raise self.error(
                f"{self.source}, {self.text[name]}, which is no number; correct the cell or map "
                "another column"
            )
        there = ", ".join([*self.columns, *self.text][:20])
        raise self.error(f"{self.source}: there is no column {name!r}; the columns are {there}")


def read_table(path: str | Path, error: type[InvalidInputError]) -> Table:
    """Read a table of numbers with one row of column names.

    Parameters
    ----------
    path : str or Path
        A ``.csv``, ``.csv.gz``, ``.parquet`` or ``.pq`` file.
    error : type
        Error to raise for bad content.

    Returns
    -------
    Table
        The table.

    Raises
    ------
    InvalidInputError
        As the given `error`: the file is missing, malformed or absurdly large.
    MissingDependencyError
        If a Parquet file is read without pyarrow.
    """
    file = Path(path)
    with _reading(file, error):
        if _suffix(file, error) == ".parquet":
            return _read_parquet(file, error)
        with file.open("rb") as raw:
            return _read_csv(io.BufferedReader(_Guarded(raw, file, error)), file, error)


def table_of(frame: Any, error: type[InvalidInputError]) -> Table:
    """Take a pandas DataFrame as a table.

    Parameters
    ----------
    frame : DataFrame
        The columns.
    error : type
        Error to raise for bad content.

    Returns
    -------
    Table
        The table; its rows count from 0.

    Raises
    ------
    InvalidInputError
        As the given `error`: it is no DataFrame, or two columns have one name.
    """
    names = [str(label) for label in getattr(frame, "columns", ())]
    if not names or not hasattr(frame, "iloc"):
        raise error(f"{type(frame).__name__} holds no columns; give a pandas DataFrame or a file")
    if len(set(names)) < len(names):
        twice = next(one for one in names if names.count(one) > 1)
        raise error(f"the DataFrame: two columns are named {twice!r}; rename one")
    made = _Columns(names, 0, "row")
    made.add(frame)
    return made.table(Path("DataFrame"), error)


def column_names(path: str | Path, error: type[InvalidInputError]) -> list[str]:
    """Return the column names of a CSV or gzipped CSV file, which is read no further.

    Raises
    ------
    InvalidInputError
        As the given `error`: the file is missing, of another kind, or its first line is malformed.
    """
    file = Path(path)
    with _reading(file, error):
        if _suffix(file, error) == ".parquet":
            raise error(f"{file} is no CSV file")
        with file.open("rb") as raw:
            stream = io.BufferedReader(_Guarded(raw, file, error))
            return _dialect(stream, file, error).names


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
    suffix = {".pq": ".parquet"}.get(file.suffix.lower(), file.suffix.lower())
    if suffix not in (".csv", ".gz", ".parquet"):
        raise error(f"{file} is of an unknown type; give a .csv, .csv.gz or .parquet file")
    return suffix


class _Guarded(io.RawIOBase):
    """A text file, unzipped where need be, with an end to its size and to its lines.

    A few bytes of gzip can hold terabytes, and a line without an end would fill the memory.
    """

    def __init__(self, raw: BinaryIO, file: Path, error: type[InvalidInputError]) -> None:
        super().__init__()
        self._stream = gzip.GzipFile(fileobj=raw) if file.suffix.lower() == ".gz" else raw
        self._file, self._error, self._left, self._line = file, error, MAX_BYTES, 0

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: WriteableBuffer, /) -> int:
        view = memoryview(buffer).cast("B")
        try:
            data = self._stream.read(len(view))
        except (gzip.BadGzipFile, EOFError, zlib.error) as problem:
            raise self._error(
                f"{self._file} is no sound gzip file ({problem}); copy or compress it anew"
            ) from None
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


class _Dialect(NamedTuple):
    """How a text file writes a table: its column names, separator and decimal sign."""

    names: list[str]
    separator: str
    decimal: str


def _dialect(
    stream: io.BufferedReader[Any], file: Path, error: type[InvalidInputError]
) -> _Dialect:
    """Read the line of column names, and look at the lines that follow."""
    line = stream.readline(MAX_HEADER + 1)
    if len(line) > MAX_HEADER:
        raise error(f"{file}, line 1 is longer than {MAX_HEADER >> 10} KiB; it must name columns")
    try:
        text = line.decode("utf-8-sig").rstrip("\r\n")
    except UnicodeDecodeError as problem:
        raise error(f"{file}, line 1, byte {problem.start} is no UTF-8 text; save it so") from None
    if "\0" in text:
        raise error(f"{file}, line 1 holds a NUL byte; this is no text file")
    ahead = stream.peek(_AHEAD)[:_AHEAD].decode("utf-8", "replace").splitlines()[:20]
    rows = {mark: [_cells(row, mark) for row in (text, *ahead[:-1])] for mark in ",;\t"}
    # The separator that cuts names and readings into the same number of cells, the most of them.
    even = {mark: len(cut[0]) for mark, cut in rows.items() if len({len(c) for c in cut[:2]}) == 1}
    whole = {mark: len(cut[0]) for mark, cut in rows.items()}
    counts = even if max(even.values(), default=0) > 1 else whole
    mark = max(counts, key=lambda key: counts[key])
    decimal = "." if not any(map(_comma_number, _flat(rows[mark][1:]))) else ","
    try:
        names = [name.strip() for name in next(csv.reader([text], delimiter=mark), [])]
    except csv.Error as problem:
        raise error(f"{file}, line 1 is no line of column names: {problem}") from None
    if not any(names):
        raise error(f"{file} is empty; line 1 must name the columns")
    if len(names) > MAX_COLUMNS:
        raise error(f"{file} has {len(names)} columns; at most {MAX_COLUMNS} are read")
    if all(_is_number(name) for name in names):
        raise error(f"{file}, line 1 holds numbers; put a line of column names before it")
    twice = [name for name, count in Counter(names).items() if count > 1]
    if twice:
        raise error(f"{file}, line 1 names the column {twice[0]!r} twice; rename one")
    return _Dialect(names, mark, decimal)


def _cells(row: str, mark: str) -> list[str]:
    try:
        return next(csv.reader([row], delimiter=mark, skipinitialspace=True), [])
    except csv.Error:
        return []


def _flat(rows: list[list[str]]) -> Iterator[str]:
    return (cell for row in rows for cell in row)


def _comma_number(cell: str) -> bool:
    """Whether a cell is a number with a decimal comma."""
    return re.fullmatch(r"\s*[-+]?\d*,\d+([eE][-+]?\d+)?\s*", cell) is not None


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _read_csv(stream: io.BufferedReader[Any], file: Path, error: type[InvalidInputError]) -> Table:
    import pandas as pd

    names, separator, decimal = _dialect(stream, file, error)
    most = MAX_CELLS // len(names)
    columns = _Columns(names, 2, "line")
    # before 3.1 pandas is out by the last bit in one number of six, unless it is asked not to be
    old = tuple(map(int, pd.__version__.split(".")[:2])) < (3, 1)
    exact: dict[str, Any] = {"float_precision": "round_trip"} if old else {}
    try:
        with warnings.catch_warnings():
            # Rows wider than the header would lose their surplus with no more than a warning.
            warnings.simplefilter("error", pd.errors.ParserWarning)
            for frame in pd.read_csv(
                stream,
                header=None,
                names=names,
                sep=separator,
                decimal=decimal,
                index_col=False,
                skip_blank_lines=False,  # so that rows keep their line numbers
                skipinitialspace=True,
                low_memory=False,
                chunksize=_CHUNK,  # the parser's memory is several times that of the numbers
                **exact,
            ):
                columns.add(frame)
                if columns.rows > most:
                    raise error(
                        f"{file} has more than {most} rows of {len(names)} columns; split it"
                    )
    except pd.errors.EmptyDataError:
        pass
    except pd.errors.ParserWarning:
        raise error(
            f"{file}: rows have more cells than the {len(names)} names of line 1; name every column"
        ) from None
    except pd.errors.ParserError as problem:
        if _INTERRUPTED in str(problem):
            raise KeyboardInterrupt from None
        raise error(f"{file} is no table: {_with_line(str(problem))}") from None
    except UnicodeDecodeError as problem:
        raise error(f"{file} is no UTF-8 text ({problem.reason}); save it as such") from None
    return columns.table(file, error)


def _with_line(problem: str) -> str:
    """Count the parser's complaint from the file's line 1, which it did not see."""
    text = problem.strip().removeprefix("Error tokenizing data. C error: ")
    head, found, tail = text.partition(" in line ")
    number, _, rest = tail.partition(",")
    return f"{head} in line {int(number) + 1},{rest}" if found and number.isdecimal() else text


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
    columns = _Columns(numbers, 1, "row")
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


def _instants(series: pd.Series[Any]) -> FloatArray | None:
    """Seconds since 1970 of instants written by ISO 8601, NaN where one is none.

    None if the first is none, so that the column holds something else.
    """
    import pandas as pd

    there = series.notna().to_numpy()
    first = str(series[there].iloc[0])
    if re.match(r"\s*\d{4}-?\d\d-?\d\d[T ]\d\d:?\d\d", first) is None:
        return None
    read = pd.to_datetime(series, format="ISO8601", utc=True, errors="coerce")
    stamps = read.dt.tz_localize(None).to_numpy("datetime64[ns]")
    return np.asarray((stamps - np.datetime64(0, "ns")) / np.timedelta64(1, "s"), float)


class _Columns:
    """Columns as they are read, piece by piece, sorted into numbers and text."""

    def __init__(self, names: list[str], first: int, unit: str) -> None:
        self.rows, self._first, self._unit = 0, first, unit
        self._numbers: dict[str, list[FloatArray]] = {name: [] for name in names}
        self._text: dict[str, str] = {}

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
            if series.dtype == object:  # text among numbers, or integers beyond 64 bits
                series = series.astype("string")
            values = pd.to_numeric(series, errors="coerce").to_numpy(float, na_value=np.nan)
            bad = np.flatnonzero(np.isnan(values) & series.notna().to_numpy())
            instants = _instants(series) if len(bad) else None
            if instants is not None:
                values = instants
                bad = np.flatnonzero(np.isnan(values) & series.notna().to_numpy())
            if len(bad):
                k = int(bad[0])
                place = f"{self._unit} {self._first + self.rows + k}"
                self._text[label] = f"{place}: {label!r} is {str(series.iloc[k])[:40]!r}"
                self._numbers[label].clear()
            else:
                self._numbers[label].append(values)
        self.rows += len(frame)

    def table(self, file: Path, error: type[InvalidInputError]) -> Table:
        """Return what was read."""
        numbers = {
            name: np.concatenate(parts) if parts else np.zeros(0)
            for name, parts in self._numbers.items()
            if name not in self._text
        }
        return Table(file.name, numbers, self._text, self._first, self._unit, error)
