"""Task requests of Open-RMF's dispatcher as tasks of a mission."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from energyplan.errors import MissionError
from energyplan.io.documents import read_bytes

_MAX_BYTES = 1 << 20
_KINDS = "patrol, delivery, compose, go_to_place"


def read_requests(path: str | Path) -> list[dict[str, Any]]:
    """Read task requests from JSON: one, a list of them, or one a line."""
    file = Path(path)
    content = read_bytes(file, _MAX_BYTES, MissionError, "that is no task list")
    try:
        text = content.decode("utf-8-sig")
        try:
            data = json.loads(text)
        except json.JSONDecodeError:
            data = [json.loads(line) for line in text.splitlines() if line.strip()]
    except (ValueError, RecursionError) as problem:
        raise MissionError(f"{file.name} is no JSON: {problem}") from None
    entries = data if isinstance(data, list) else [data]
    requests = []
    for k, entry in enumerate(entries):
        request = entry.get("request", entry) if isinstance(entry, dict) else None
        if not isinstance(request, dict) or "category" not in request:
            raise MissionError(
                f"{file.name}, request {k + 1} has no category; give requests as the dispatcher "
                "takes them"
            )
        requests.append(request)
    if not requests:
        raise MissionError(f"{file.name} holds no request")
    return requests


def tasks_of(
    requests: list[dict[str, Any]], places: Mapping[str, Any], name: str = "requests"
) -> list[dict[str, Any]]:
    """Return the tasks that requests ask for, in their order, as a mission's file holds them.

    A patrol is a task at each place of each round; a delivery one at the pick-up and one at the
    drop-off; of a composed task each place that it goes to is one, and actions there are its dwell.
    A request's earliest start counts from the earliest of all.
    """
    starts = [_start(r, f"{name}, request {k}") for k, r in enumerate(requests, start=1)]
    first = min((start for start in starts if start > 0), default=0.0)
    tasks: list[dict[str, Any]] = []
    for k, (request, start) in enumerate(zip(requests, starts, strict=True), start=1):
        here = f"{name}, request {k}"
        for stop, dwell in _stops(str(request["category"]), request.get("description"), here):
            pose = _pose(stop, places, here)
            title = f"{k}.{len(tasks) + 1} {request['category']} {_waypoint(stop, here)}"
            window = [max(start - first, 0.0), float("inf")]
            tasks.append({"name": title, "pose": pose, "dwell": dwell, "window": window})
    return tasks


def _start(request: dict[str, Any], here: str) -> float:
    millis = request.get("unix_millis_earliest_start_time") or 0
    if not isinstance(millis, int | float) or not 0 <= millis < 1e15:
        raise MissionError(
            f"{here}: the earliest start is {millis!r}; give milliseconds since 1970"
        )
    return millis / 1e3


def _stops(category: str, told: Any, here: str) -> Iterator[tuple[Any, float]]:
    """Yield the places that a description goes to, with the time spent there [s]."""
    if category == "patrol":
        told = _mapping(told, here)
        rounds = told.get("rounds", 1)
        if not isinstance(rounds, int) or not 1 <= rounds <= 1000:
            raise MissionError(f"{here}: rounds is {rounds!r}; give a number from 1 to 1000")
        for _ in range(rounds):
            yield from ((place, 0.0) for place in _list(told.get("places"), "places", here))
    elif category == "delivery":
        told = _mapping(told, here)
        for part in ("pickup", "dropoff"):
            yield from _stops(part, told.get(part), here)
    elif category in ("pickup", "dropoff"):
        yield _mapping(told, here).get("place"), 0.0
    elif category == "go_to_place":
        yield told, 0.0
    elif category == "compose":
        activities = [
            _mapping(_mapping(phase, here).get("activity"), here)
            for phase in _list(_mapping(told, here).get("phases"), "phases", here)
        ]
        yield from _activities(activities, here)
    else:
        raise MissionError(
            f"{here} is of the category {category!r}, which names no places; known are {_KINDS}"
        )


def _activities(activities: list[Any], here: str) -> Iterator[tuple[Any, float]]:
    """Yield places; what is done at one before the next is its dwell."""
    place: tuple[Any, float] | None = None
    for activity in _flat(activities, here):
        category, told = activity.get("category"), activity.get("description")
        if category == "perform_action":
            millis = _mapping(told, here).get("unix_millis_action_duration_estimate", 0)
            if not isinstance(millis, int | float) or not 0 <= millis < 1e12:
                raise MissionError(f"{here}: an action lasts {millis!r} ms; give 0 or more")
            if place is None:
                raise MissionError(
                    f"{here} begins with an action that has no place; put go_to_place first"
                )
            place = place[0], place[1] + millis / 1e3
            continue
        for stop in _stops(str(category), told, here):
            if place is not None:
                yield place
            place = stop
    if place is not None:
        yield place


def _flat(activities: list[Any], here: str) -> Iterator[dict[str, Any]]:
    for activity in activities:
        one = _mapping(activity, here)
        if one.get("category") == "sequence":
            told = one.get("description")
            inner = told.get("activities") if isinstance(told, dict) else told
            yield from _flat(_list(inner, "activities", here), here)
        else:
            yield one


def _waypoint(place: Any, here: str) -> str:
    """Return the name of a place."""
    if isinstance(place, dict) and "one_of" in place:
        options = _list(place["one_of"], "one_of", here)
        if len(options) != 1:
            raise MissionError(
                f"{here} leaves open which of {len(options)} places; name the one it goes to"
            )
        place = options[0]
    return str(place.get("waypoint", place.get("place")) if isinstance(place, dict) else place)


def _pose(place: Any, places: Mapping[str, Any], here: str) -> Any:
    waypoint = _waypoint(place, here)
    if waypoint not in places:
        known = ", ".join(sorted(places)) or "none"
        raise MissionError(
            f"{here}: there is no place {waypoint!r}; the mission's places are {known}"
        )
    pose = places[waypoint]
    pose = places.get(pose, pose) if isinstance(pose, str) else pose
    yaw = place.get("orientation") if isinstance(place, dict) else None
    if yaw is None:
        return pose
    return [*(pose.split(",") if isinstance(pose, str) else pose)[:2], yaw]


def _mapping(value: Any, here: str) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise MissionError(f"{here}: {str(value)[:40]!r} is no mapping of keys to values")
    return value


def _list(value: Any, key: str, here: str) -> list[Any]:
    if not isinstance(value, list) or not value:
        raise MissionError(f"{here}: {key} is {str(value)[:40]!r}; give a list with an entry")
    return value
