"""Drive logs from whatever file a robot writes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from math import isfinite, nan
from pathlib import Path
from shlex import quote

import numpy as np

from energyplan.errors import DriveLogError, InvalidInputError
from energyplan.io.bags import (
    NO_TOPICS,
    TopicMap,
    columns_of,
    is_bag,
    read_bag,
    topic_map,
    topic_map_of,
)
from energyplan.io.config import read_columns
from energyplan.io.files import same_file
from energyplan.io.flight import is_flight, read_flight
from energyplan.io.husky import known_husky
from energyplan.logs import DriveLog
from energyplan.logs.checks import grows
from energyplan.logs.guess import guess, words
from energyplan.logs.mapping import Column, clock_in, parse_columns, scale_of, unit_in
from energyplan.logs.readers import read_recorded
from energyplan.logs.tables import Recording
from energyplan.path import FloatArray


def read_recording(
    path: str | Path,
    columns: str | Mapping[str, str | Column] | None = None,
    topics: TopicMap | None = None,
    progress: Callable[[float], None] | None = None,
) -> Recording:
    """Read what a file of any known kind holds; of a bag, all or what a topic map needs."""
    if not has_messages(path):
        return read_recorded(path, clock_in(columns))
    read = read_flight if is_flight(path) else partial(read_bag, progress=progress)
    if topics is None:
        return read(path)
    sources = [one for several in topics.channels.values() for one in several]
    others = [name for one in sources for name in one.names if name.startswith("/")]
    named = f"{' '.join(others)} {columns}"

    def wanted(topic: str) -> bool:
        return any(one.matches(topic) for one in sources) or f"{topic.strip('/')}." in named

    return read(path, wanted)


def has_messages(path: str | Path) -> bool:
    """Return whether a path is a recording of messages, which a topic map reads."""
    return is_bag(path) or is_flight(path)


def named_columns(
    recording: Recording, columns: str | Mapping[str, str | Column] | None
) -> dict[str, Column]:
    """Return the columns that are named by hand, by the names of a recording's series."""
    also = {written: name for name, written in recording.written.items()}
    also |= {name.removeprefix("/"): name for name in recording.written}
    result = parse_columns(columns, (*recording.columns, *recording.text, *also))
    if recording.kinds and "t" in result:
        raise DriveLogError("messages of a bag bear their own times; leave t out")
    for channel, one in result.items():
        one = one.joined()
        result[channel] = one.renamed(lambda name: also.get(name, name))
    return result


def read_log(
    path: str | Path,
    columns: str | Mapping[str, str | Column] | None = None,
    *,
    topics: TopicMap | str | Path | None = None,
    progress: Callable[[float], None] | None = None,
    table: Recording | None = None,
) -> DriveLog:
    r"""Read a drive log of any known kind; a table may be read already."""
    of_project = isinstance(columns, str) and columns.endswith((".yaml", ".yml"))
    file = Path(path)
    if has_messages(path):
        if topics is None:
            raise DriveLogError(f"{file.name}: {NO_TOPICS.format(file.name)}")
        named, mapped = None if of_project else columns, topic_map(topics)
        recording = read_recording(path, named, mapped, progress)
        mapping = columns_of(recording, mapped) | named_columns(recording, named)
        return DriveLog.of(recording, mapping)
    given = read_columns(str(columns)) if of_project else columns
    recording = table or read_recording(path, given)
    husky = known_husky(recording, file, topics) if given is None else None
    return husky or DriveLog.of(recording, recording.mapping(given, others=not of_project))


def read_drives(
    paths: Sequence[Path],
    vehicle: str,
    columns: str | None = None,
    topics: str | None = None,
    progress: Callable[[float], None] | None = None,
    first: Recording | None = None,
) -> list[DriveLog]:
    """Read drives of one robot, each once, the first of them perhaps already.

    The vehicle gives a bag's topic map if none is given.
    """
    for k, path in enumerate(paths):
        if any(same_file(path, other) for other in paths[:k]):
            raise InvalidInputError(f"{path} is given twice; each drive counts once")
    bags = [path for path in paths if has_messages(path)]
    if topics and topics != vehicle and not bags:  # a project has both
        raise InvalidInputError(
            f"{paths[0]} is no bag, so it has no topics; leave --topics out, and name its columns "
            "with --columns"
        )
    chosen = topics or topic_map_of(vehicle)
    if bags and chosen is None:
        raise InvalidInputError(
            f"{bags[0]}: the topics and the wheel radius are not known: give --topics, or "
            f"a project that energyplan start {quote(str(bags[0]))} --out PROJECT.yaml makes"
        )
    return [
        read_log(path, columns, topics=chosen, progress=progress, table=None if k else first)
        for k, path in enumerate(paths)
    ]


_TASK_WORDS = {
    "distance": ({"distance", "dist", "travelled", "traveled"}, "x"),
    "turning": ({"turning", "turned", "rotation", "turn"}, "yaw"),
    "duration": ({"duration", "elapsed"}, "t"),
    "energy": ({"energy", "consumption", "consumed", "wh", "kwh"}, "power"),
}
"""What a row of a history of tasks holds: words of its columns, and a channel in its units."""
_CHARGE_WORDS = {"soc", "percent", "percentage", "pct", "charge"}


def tasks_of(table: Recording, full: float = nan) -> dict[str, FloatArray] | None:
    """Return the tasks of a table with a row each, in SI units; None where a row is an instant.

    Without energies, the table gives shares of `full`, what the battery holds [J].
    """
    if table.times:  # of each series: that is a recording of instants
        return None
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
