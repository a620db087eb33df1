"""Tables of numbers from CSV, gzipped CSV and Parquet, with the place of every complaint."""

from __future__ import annotations

import codecs
import gzip
import io
import warnings
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, NamedTuple

from energyplan.errors import InvalidInputError, MissingDependencyError
from energyplan.logs.cells import Columns, Table
from energyplan.logs.dialect import MAX_COLUMNS, MAX_HEADER, MISSING, Dialect, find_dialect
from energyplan.logs.json_lines import read_json_lines
from energyplan.logs.long_format import LongFormat, find_long

if TYPE_CHECKING:  # pandas is slow to import, and needed only where a file is read
    import pandas as pd
    import pyarrow as pa
    from _typeshed import WriteableBuffer

MAX_LINE = 1 << 20
"""Longest line that is read [bytes]."""
MAX_BYTES = 1 << 31
"""Largest table that is read, after decompression [bytes]."""
MAX_CELLS = 100_000_000
"""Most cells that are read."""
_AHEAD = MAX_HEADER + (1 << 16)  # bytes that are looked at to learn how a table is written
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
    """Read a table of numbers with one row of column names."""
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
        raise error(f"{str(file)!r} is a folder; give a .csv, .csv.gz or .parquet file in it")
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
    try:
        with warnings.catch_warnings():
            # Rows wider than the header would lose their surplus with no more than a warning.
            warnings.simplefilter("error", pd.errors.ParserWarning)
            for frame in pd.read_csv(
                readings,
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
    return columns.table(file, error)


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
