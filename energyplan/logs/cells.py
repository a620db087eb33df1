"""Tables of numbers, and cells on their way into them: numbers, instants, text."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from energyplan.errors import InvalidInputError
from energyplan.logs.dialect import UNNAMED
from energyplan.logs.instants import Instants, instants_of, over_midnight, whole_stamps
from energyplan.logs.joining import hold_unchanged
from energyplan.logs.units import split_unit
from energyplan.path import FloatArray

if TYPE_CHECKING:
    import pandas as pd

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

    def place(self, row: int) -> str:
        """Name the place of a row, such as ``"line 12"``."""
        return f"{self.unit} {self.first + row}"

    def unchanged_held(self) -> Table:
        """Return the table of a drive, its blanks filled where a logger wrote only what changed."""
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
