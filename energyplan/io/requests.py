"""A mission's file with other tasks than its own."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from energyplan.errors import MissionError
from energyplan.io._yaml import Document, load
from energyplan.io.mission import MissionReader
from energyplan.mission import Mission


def read_mission_for(
    path: str | Path, tasks: Callable[[Mapping[str, Any]], list[dict[str, Any]]]
) -> Mission:
    """Read a mission from YAML and put other tasks in the place of its own, in the order given.

    Parameters
    ----------
    path : str or Path
        The file.
    tasks : callable
        Called with the poses that have names in the file (places, tasks and chargers), as they are
        written; returns the tasks as the file would hold them.

    Returns
    -------
    Mission
        The mission.

    Raises
    ------
    MissionError
        If the file or a task is malformed.
    """
    document = load(path, MissionError)
    named: dict[str, Any] = {}
    for key in ("chargers", "tasks"):
        entries = document.data.get(key)
        for entry in entries if isinstance(entries, list) else []:
            if isinstance(entry, dict) and "pose" in entry:
                named[str(entry.get("name"))] = entry["pose"]
    places = document.data.get("places")
    named |= places if isinstance(places, dict) else {}
    data = {**document.data, "tasks": tasks(named), "order": "given"}
    lines = {place: line for place, line in document.lines.items() if place[:1] != ("tasks",)}
    return MissionReader(
        Document(document.source, data, lines, MissionError), Path(path).parent
    ).mission()
