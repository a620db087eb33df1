"""Drive logs from whatever file a robot writes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from energyplan.errors import DriveLogError, InvalidInputError
from energyplan.io.bags import TopicMap, bag_fields, is_bag, read_bag, topic_map_of
from energyplan.io.config import read_columns
from energyplan.io.files import same_file
from energyplan.io.husky import NOT_TOLD, is_husky, read_husky
from energyplan.logs import DriveLog
from energyplan.logs.mapping import Column


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


def _of_husky(topics: TopicMap | str | Path | None) -> bool:
    """Tell whether a topic map is that of a Husky; a table says not whose motors these are."""
    if topics is None:
        return False
    return (topics if isinstance(topics, TopicMap) else TopicMap.read(topics)).name == "husky"
