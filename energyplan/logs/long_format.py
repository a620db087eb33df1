"""Tables of one reading a row, beside its time and its name, brought to a column for each name."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from energyplan.logs.instants import instants_of
from energyplan.logs.units import is_unit

if TYPE_CHECKING:
    import pandas as pd

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
