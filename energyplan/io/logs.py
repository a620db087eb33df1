"""Drive logs from whatever file a robot writes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from math import isfinite, nan
from pathlib import Path

import numpy as np

from energyplan.errors import DriveLogError, InvalidInputError
from energyplan.io.bags import TopicMap, bag_fields, is_bag, read_bag, topic_map_of
from energyplan.io.config import read_columns
from energyplan.io.files import same_file
from energyplan.io.husky import NOT_TOLD, is_husky, read_husky
from energyplan.logs import DriveLog
from energyplan.logs.checks import grows
from energyplan.logs.guess import guess, words
from energyplan.logs.mapping import Column, scale_of, unit_in
from energyplan.logs.tables import Table, column_names
from energyplan.path import FloatArray


def read_log(
    path: str | Path,
    columns: str | Mapping[str, str | Column] | None = None,
    *,
    topics: TopicMap | str | Path | None = None,
    progress: Callable[[float], None] | None = None,
) -> DriveLog:
    r"""Read a drive log of any known kind."""
    if is_bag(path):
        of_project = isinstance(columns, str) and columns.endswith((".yaml", ".yml"))
        named = None if columns is None or of_project else bag_fields(path).parse(columns)
        return read_bag(path, topics, named, progress=progress)
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


_TASK_WORDS = {
    "distance": ({"distance", "dist", "travelled", "traveled"}, "x"),
    "turning": ({"turning", "turned", "rotation", "turn"}, "yaw"),
    "duration": ({"duration", "elapsed"}, "t"),
    "energy": ({"energy", "consumption", "consumed", "wh", "kwh"}, "power"),
}
"""What a row of a history of tasks holds: words of its columns, and a channel in its units."""
_CHARGE_WORDS = {"soc", "percent", "percentage", "pct", "charge"}


def may_be_tasks(path: Path) -> bool:
    """Tell by the names of its columns whether a table may be a history of tasks."""
    if path.suffix.lower() not in (".csv", ".gz", ".tsv", ".txt") or not path.exists():
        return False
    names = column_names(path, DriveLogError)
    return any(_TASK_WORDS["distance"][0] & set(words(name)) for name in names)


def tasks_of(table: Table, full: float = nan) -> dict[str, FloatArray] | None:
    """Return the tasks of a table with a row each, in SI units; None where a row is an instant.

    Without energies, `full` is what the battery holds [J], of which shares are told.
    """
    found: dict[str, FloatArray] = {}
    for name, values in table.columns.items():
        for key, (names, channel) in _TASK_WORDS.items():
            if key not in found and names & set(words(name)):
                found[key] = scale_of(channel, unit_in(channel, name).unit).factor * values
    # An odometer only grows.
    if "distance" not in found or grows(found["distance"]) or {*guess(table.columns)} & _INSTANT:
        return None
    shares = [name for name in table.columns if _CHARGE_WORDS & set(words(name))]
    if "energy" not in found and shares:
        begin, end = ([n for n in shares if kinds & set(words(n))] for kinds in _ENDS)
        if len(begin) == len(end) == 1:
            used = table.columns[begin[0]] - table.columns[end[0]]
        elif len(shares) == 1:
            used = np.abs(table.columns[shares[0]])
        else:
            return None
        if not isfinite(full):
            raise DriveLogError(
                f"{table.source}: the tasks tell shares of a battery, {', '.join(shares)}; give "
                "what it holds, as in --battery '24 V 20 Ah lead-acid'"
            )
        top = max(float(np.nanmax(table.columns[name])) for name in shares)
        found["energy"] = used * full * (0.01 if top > 1.0 else 1.0)
    return found if "energy" in found else None


_INSTANT = {"v_left", "v_right", "p_left", "p_right", "yaw_rate"}
_ENDS = ({"start", "begin", "before", "from"}, {"end", "after", "to", "stop"})


def _of_husky(topics: TopicMap | str | Path | None) -> bool:
    """Tell whether a topic map is that of a Husky; a table says not whose motors these are."""
    if topics is None:
        return False
    return (topics if isinstance(topics, TopicMap) else TopicMap.read(topics)).name == "husky"
