"""Tables with a row for each of several things at a time: a reading, a motor, a robot a row."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from energyplan.errors import InvalidInputError
from energyplan.logs.guess import guess, side_of, words
from energyplan.logs.mapping import is_unit, split_unit
from energyplan.path import FloatArray
from energyplan.records import NO_NUMBER

if TYPE_CHECKING:  # pandas is slow to import, and needed only where a file is read
    import pandas as pd


class ThingLimits(NamedTuple):
    """What a column that distinguishes things holds."""

    most: int = 50  # things that a column distinguishes
    fewest: int = 10  # rows of each of them
    stamps: int = 20  # rows that show whether a column holds stamps


_THINGS_LIMITS = ThingLimits()
_OF_PARTS = {
    "motor", "wheel", "side", "axle", "axis", "joint", "esc", "vesc", "controller", "driver",
    "drive", "channel", "topic", "node", "can", "battery", "pack", "cell", "sensor", "actuator",
    "signal", "name", "field", "key", "measurement", "series", "metric", "variable",
}  # fmt: skip
"""Words of a column that distinguishes parts of one robot, or readings of it."""
_NUMBERS = {*_OF_PARTS, "id", "robot", "unit", "device", "vehicle", "index", "module", "agent"}
"""Last words of a column whose whole numbers distinguish things."""


def numeric(cells: pd.Series) -> pd.Series:
    """Return cells as numbers, NaN where they are none."""
    import pandas as pd

    try:
        return pd.to_numeric(cells, errors="coerce")
    except OverflowError:  # a whole number of hundreds of digits
        return cells.map(number)


def number(content: object) -> float:
    """Return a cell as a number, NaN where it is none."""
    try:
        return float(content)  # type: ignore[arg-type]
    except NO_NUMBER:
        return float("nan")


def with_unit(name: str, unit: str) -> str:
    """Return a name with its unit in brackets."""
    bare = unit.strip().strip("[]()").strip()
    return f"{name} [{bare}]" if bare and is_unit(bare) and not split_unit(name)[1] else name


def numbered(names: Iterable[str]) -> bool:
    """Return whether a column of numbers alone may distinguish things, by its name."""
    return any({*words(name)[-1:]} & _NUMBERS for name in names)


_OF_TASKS = {"task", "tasks", "trip", "mission", "duration", "job", "order"}
"""Words of tables whose rows are tasks, and no instants."""


class _Things(NamedTuple):
    """The column that distinguishes the things of a table's rows, and the one of their times."""

    label: str
    time: str


def pivoted(
    frame: pd.DataFrame, names: Sequence[str], source: object, error: type[InvalidInputError]
) -> pd.DataFrame | None:
    """Return a table with a row a time, of one with a row for each of several things at it.

    None of any other table. Rows of several robots are refused: they are drives of their own.
    """
    found = _things(frame, names)
    if found is None:
        return _of_readings(frame, names)
    label, time = found
    values = [str(value) for value in frame[label].unique()]
    readings = _readings(frame, names, found)
    if not readings:
        return None
    of_parts = {*words(label)} & _OF_PARTS or any(side_of(value, values) for value in values)
    if len(readings) > 1 and not of_parts:
        one = np.asarray(frame[label])[:1].tolist()[0]  # as Python writes it
        raise error(
            f"{source}: rows of several {label!r} ({', '.join(values[:4])}) stand in one table, at "
            f"the same times: keep those of one, as by pandas: table[table[{label!r}] == "
            f"{one!r}].to_csv('one.csv', index=False)"
        )
    if len(readings) == 1:
        frame = _with_units(frame, names, label, [time, *readings])
    cells = frame.assign(**{name: numeric(frame[name]) for name in readings})
    text = not np.issubdtype(np.asarray(frame[label]).dtype, np.number)
    wide = cells.pivot_table(readings, time, label, aggfunc="last", sort=False)
    columns: dict[str, Any] = {}
    for name in readings:
        parts = {f"{one}" if text else f"{label}{one}": wide[name, one] for one in wide[name]}
        first, *rest = parts.values()
        if rest and all(_same(first, other) for other in rest):
            columns[name] = first  # of the robot, and written once for each
        elif len(readings) == 1:
            columns |= parts
        else:
            columns |= {f"{part}.{name}": series for part, series in parts.items()}
    if len(readings) > 1:
        columns |= {
            name: cells[name].iloc[0] for name in names
            if name not in found and cells[name].nunique() == 1
        }  # fmt: skip
    import pandas as pd

    return pd.DataFrame(columns).reset_index(names=time)


def _same(one: pd.Series, other: pd.Series) -> bool:
    """Return whether two columns hold the same wherever both hold something, and often do."""
    both = (one.notna() & other.notna()).to_numpy()
    return bool(np.mean(both) > 0.5 and np.mean((one == other).to_numpy()[both]) > 0.99)


def _times(frame: pd.DataFrame, name: str) -> FloatArray:
    """Return a column of times as numbers, whatever their unit."""
    import pandas as pd

    read = numeric(frame[name])
    if read.isna().all():
        stamps = pd.to_datetime(frame[name], errors="coerce", utc=True, format="ISO8601")
        found = stamps.dt.tz_localize(None).to_numpy("datetime64[ns]")
        return np.where(np.isnat(found), np.nan, found.astype(float))
    return read.to_numpy(float)


def _clocks(frame: pd.DataFrame, names: Sequence[str]) -> list[str]:
    """Return the column of the times: by its name, else the first that holds nothing but stamps."""
    named = [name for name in names if "t" in guess([name])][:1]
    if named:
        return named
    head = frame.iloc[: _THINGS_LIMITS.stamps]
    stamped = (
        name for name in names
        if numeric(head[name]).isna().all() and np.isfinite(_times(head, name)).all()
    )  # fmt: skip
    return [*stamped][:1]


def _things(frame: pd.DataFrame, names: Sequence[str]) -> _Things | None:
    """Find what distinguishes rows of one time: each of its values stands in rows all along."""
    kinds = frame.nunique()
    times = _clocks(frame, [name for name in names if kinds[name] > 1])
    if not times or len(frame) < 2 * _THINGS_LIMITS.fewest:
        return None
    t = _times(frame, times[0])
    if not np.isfinite(t).all():
        return None
    whole, typical = float(np.ptp(t)), float(np.median(np.diff(np.sort(t))))
    of_tasks = any({*words(name)} & _OF_TASKS for name in names)
    text = {name: bool(numeric(frame[name]).isna().all()) for name in names}
    # Of several that distinguish the rows, such as a name and its unit, the finest.
    for name in sorted(names, key=lambda name: (not text[name], -kinds[name])):
        if (
            of_tasks
            or name in times
            or not 2 <= kinds[name] <= min(_THINGS_LIMITS.most, len(frame) / _THINGS_LIMITS.fewest)
        ):
            continue
        if frame[name].isna().any():
            continue
        read = numeric(frame[name])
        if not text[name] and not (
            read.notna().all() and np.all(np.mod(read, 1.0) == 0.0) and numbered([name])
        ):
            continue
        parts = [np.sort(t[rows]) for rows in frame.groupby(name, sort=False).indices.values()]
        if all(
            _all_along(part, typical, whole) for part in parts if len(part) >= _THINGS_LIMITS.fewest
        ) and (
            sum(len(part) for part in parts if len(part) >= _THINGS_LIMITS.fewest) > 0.9 * len(t)
        ):
            return _Things(name, times[0])
    return None


def _all_along(t: FloatArray, typical: float, whole: float) -> bool:
    """Return whether times of some rows are spread over a recording, each farther than a row's."""
    steps = np.diff(t)
    steps = steps[steps > 0.0]
    if not len(steps):
        return False
    step = float(np.median(steps))
    span = float(np.ptp(t))
    return step > 1.5 * typical and len(t) * step > 0.7 * span > 0.35 * whole


def _readings(frame: pd.DataFrame, names: Sequence[str], things: _Things) -> list[str]:
    """Return the columns that hold readings, and no further clock."""
    t = _times(frame, things.time)
    # What each thing has but one of is of the thing: its unit, or its number.
    stated = frame.groupby(things.label).nunique().max()
    found = []
    for name in (name for name in names if name not in things):
        values = numeric(frame[name]).to_numpy(float, na_value=np.nan)
        known = np.isfinite(values)
        if not known.any() or stated[name] <= 1:
            continue
        clock = known.all() and np.corrcoef(t, values)[0, 1] > 0.999999
        if not clock:
            found.append(name)
    return found


def _with_units(
    frame: pd.DataFrame, names: Sequence[str], label: str, others: Sequence[str]
) -> pd.DataFrame:
    """Return a table whose labels bear the units of another column, if there is one of units."""
    for name in (n for n in names if n not in (label, *others)):
        if frame[name].dropna().astype(str).map(is_unit).mean() > 0.5:
            units = [
                with_unit(str(one), unit)
                for one, unit in zip(frame[label], frame[name].astype(str), strict=True)
            ]
            return frame.assign(**{label: units})
    return frame


def _of_readings(frame: pd.DataFrame, names: Sequence[str]) -> pd.DataFrame | None:
    """Return a column for each name of a table of one reading a row; None of any other table."""
    kinds = frame.nunique()
    varied = [name for name in names if kinds[name] > 1]
    times = _clocks(frame, varied)
    said = [
        name for name in varied if name not in times and kinds[name] < len(frame) / 4
        and numeric(frame[name]).isna().all() and frame[name].notna().all()
    ]  # fmt: skip
    said = sorted(said, key=lambda name: -kinds[name])[:1]
    if not times or not said:
        return None
    # What each name has but one of is of the name: its unit, or its number.
    stated = frame.groupby(said[0]).nunique().max()
    readings = [name for name in varied if name not in (*said, *times) and stated[name] > 1]
    if len(readings) != 1:
        return None
    frame = _with_units(frame, varied, said[0], [*times, *readings])
    frame = frame.assign(**{readings[0]: numeric(frame[readings[0]])})
    result = frame.pivot_table(readings[0], times[0], said[0], aggfunc="last", sort=False)
    return result.reset_index()
