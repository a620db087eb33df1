"""Drive logs from whatever file a robot writes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from energyplan.errors import DriveLogError, InvalidInputError
from energyplan.io.bags import (
    TOPIC_MAPS,
    LogEntry,
    TopicMap,
    bag_info,
    channels_served,
    is_bag,
    read_bag,
    topic_map_of,
)
from energyplan.io.config import read_columns
from energyplan.io.files import same_file
from energyplan.io.husky import NOT_TOLD, WHEEL_COLUMNS, is_husky, read_husky
from energyplan.logs import DriveLog
from energyplan.logs.checks import LONGEST_STEP
from energyplan.logs.clean import POWER_WAYS
from energyplan.logs.guess import guess
from energyplan.logs.mapping import UNITS, Column
from energyplan.logs.tables import Table, read_table

_RESTARTS = 0.01  # share of steps back in time, below which each begins another recording


@dataclass(frozen=True)
class LogInfo:
    r"""What a file of a drive holds, and what it could serve for."""

    name: str  # name of the file
    kind: str  # how it would be read
    duration: float  # time from the first to the last reading [s]
    entries: tuple[LogEntry, ...]  # its columns or topics
    channels: Mapping[str, tuple[str, ...]]  # channels found by the ready-made topic maps, by map
    notes: tuple[str, ...]  # what is missing for a drive log, and what is doubtful about it


def read_log(
    path: str | Path,
    columns: str | Mapping[str, str | Column] | None = None,
    *,
    topics: TopicMap | str | Path | None = None,
    progress: Callable[[float], None] | None = None,
) -> DriveLog:
    r"""Read a drive log of any known kind."""
    if is_bag(path):
        return read_bag(path, topics, progress=progress)
    if isinstance(columns, str) and columns.endswith((".yaml", ".yml")):
        return DriveLog.read(path, read_columns(columns), others=False)
    if columns is None and is_husky(path):
        if not _of_husky(topics):
            raise DriveLogError(f"{Path(path).name}: {NOT_TOLD}")
        return read_husky(path)
    return DriveLog.read(path, columns)


def read_drives(
    paths: Sequence[Path],
    vehicle: str,
    columns: str | None = None,
    topics: str | None = None,
    progress: Callable[[float], None] | None = None,
) -> list[DriveLog]:
    """Read drives of one robot, each once; of bags the vehicle tells the topic map if none does."""
    for k, path in enumerate(paths):
        if any(same_file(path, other) for other in paths[:k]):
            raise InvalidInputError(f"{path} is given twice; each drive counts once")
    bags = [path for path in paths if is_bag(path)]
    if topics and topics != vehicle and not bags:  # a project has both
        raise InvalidInputError(
            f"{paths[0]} is no bag, so it has no topics; leave --topics out, and name its columns "
            "with --columns"
        )
    chosen = topics or topic_map_of(vehicle)
    if bags and chosen is None:
        raise InvalidInputError(
            f"{bags[0]}: the topics and the wheel radius are not known: give --topics, or "
            f"a project that energyplan start {bags[0]} --out PROJECT.yaml makes"
        )
    return [read_log(path, columns, topics=chosen, progress=progress) for path in paths]


def _of_husky(topics: TopicMap | str | Path | None) -> bool:
    """Tell whether a topic map is that of a Husky; a table says not whose motors these are."""
    if topics is None:
        return False
    return (topics if isinstance(topics, TopicMap) else TopicMap.read(topics)).name == "husky"


def describe_log(path: str | Path) -> LogInfo:
    r"""Tell what a file of a drive holds, and what it could serve for.

    Nothing needs to be complete: a file without power or of foreign column names is described too.
    """
    return _describe_bag(Path(path)) if is_bag(path) else _describe_table(Path(path))


def _describe_bag(file: Path) -> LogInfo:
    bag = bag_info(file)
    entries = bag.topics
    names = [entry.name for entry in entries if entry.count]
    channels = {name: channels_served(mapping, names) for name, mapping in TOPIC_MAPS.items()}
    fitting = [name for name, found in channels.items() if not _missing(found)]
    if fitting:
        notes = [f"the topic map {' or '.join(fitting)} reads it; check the wheel radius"]
    else:
        lacks = {name: _missing(found) for name, found in channels.items()}
        best = min(lacks, key=lambda name: len(lacks[name]))
        notes = [
            f"no ready-made topic map finds all it takes; {best} lacks {', '.join(lacks[best])}: "
            "write a topic map of your own"
        ]
    return LogInfo(bag.name, "bag", bag.duration, entries, channels, tuple(notes))


def _describe_table(file: Path) -> LogInfo:
    table = read_table(file, DriveLogError)
    husky = is_husky(file)
    seems = {} if husky else guess([name for name in table.columns if name not in UNITS])
    seems = {channel: one for channel, one in seems.items() if channel not in table.columns}
    duration = _duration(table, "time" if husky else "t", seems.get("t"))
    by_name = {name: (channel, one) for channel, one in seems.items() for name in one.names}
    entries = []
    for name, values in table.columns.items():
        count = int(np.count_nonzero(np.isfinite(values)))
        serves = f"{name} [{next(iter(UNITS[name]))}]" if name in UNITS else ""
        if name in by_name:
            channel, one = by_name[name]
            serves = f"{channel}, it seems{f' [{one.unit}]' if one.unit else ''}"
        if husky and name in WHEEL_COLUMNS:
            serves = "wheel file of a Husky"
        rate = count / duration if duration > 0 else 0.0
        entries.append(LogEntry(name, "numbers", count, rate, serves))
    entries += [LogEntry(name, "text", 0, 0.0, "") for name in table.text]
    found: tuple[str, ...]
    notes: tuple[str, ...]
    try:
        log = read_husky(file) if husky else read_log(file)
    except DriveLogError as problem:
        found = tuple(name for name in table.columns if name in UNITS)
        lacks = ", ".join(_missing(found))
        ways = "map columns, as in v_left=velL"
        if seems:
            ways += f", or let energyplan start {file.name} --out PROJECT.yaml do so"
        remedy = f"it lacks {lacks}; {ways}" if lacks else str(problem)
        notes = (f"it cannot be read as it is: {remedy}",)
    else:
        found = tuple(log.channels)
        notes = (*map(str, log.set_aside), *log.warnings)
        if husky:
            notes = (f"described as if a Husky A200 had made it; {NOT_TOLD}", *notes)
    kind = "husky" if husky else "table"
    return LogInfo(file.name, kind, duration, tuple(entries), {"columns": found}, notes)


def _duration(table: Table, name: str, seems: Column | None) -> float:
    """Return how long a table lasts [s]; 0 where its time, or the unit of it, is not known."""
    unit = 1.0
    if seems is not None:
        name, unit = seems.field, UNITS["t"].get(seems.unit, 1.0)
    times = unit * table.columns.get(name, np.zeros(0))
    times = times[np.isfinite(times)]
    steps = np.diff(times)
    if not len(steps) or (seems is not None and np.median(steps) > LONGEST_STEP):
        return 0.0
    if np.mean(steps < 0.0) < _RESTARTS:  # recordings that follow each other, or a clock set back
        return float(steps[steps > 0.0].sum())
    return float(np.ptp(times))


def _missing(channels: tuple[str, ...]) -> list[str]:
    """Name what a drive log takes beyond these channels."""
    lacks = [name for name in ("t", "v_left", "v_right") if name not in channels]
    there = any(set(way) <= set(channels) for way in POWER_WAYS)
    return lacks if there else [*lacks, "power"]
