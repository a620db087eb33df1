"""Drive logs from whatever file a robot writes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

from energyplan.drivelog import DriveLog
from energyplan.io.bags import is_bag, read_bag
from energyplan.io.husky import is_husky, read_husky
from energyplan.io.topics import TopicMap


def read_log(
    path: str | Path,
    columns: str | Mapping[str, str] | None = None,
    *,
    topics: TopicMap | str | Path = "husky",
    progress: Callable[[float], None] | None = None,
) -> DriveLog:
    """Read a drive log of any known kind.

    Parameters
    ----------
    path : str or Path
        A table for `DriveLog.read`, a bag for `read_bag`, or a Husky's wheel file for
        `read_husky`.
    columns : str or mapping of str to str, optional
        Which column serves as which channel, as for `DriveLog.read`; a table is then read as is.
    topics : TopicMap, str or Path
        Which message field of a bag serves as which channel, as for `read_bag`.
    progress : callable, optional
        Called with the fraction of a bag that is read.

    Returns
    -------
    DriveLog
        The log.

    Raises
    ------
    DriveLogError
        If the file is malformed or of an unknown kind; the message names file, line and channel.
    MissingDependencyError
        If reading such a file takes a package that is not installed.
    """
    if is_bag(path):
        return read_bag(path, topics, progress=progress)
    if columns is None and is_husky(path):
        return read_husky(path)
    return DriveLog.read(path, columns)
