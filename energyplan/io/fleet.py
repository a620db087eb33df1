"""Fleets as YAML files: a mission's file with robots, needs of tasks and places of chargers."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field

from energyplan.errors import MissionError
from energyplan.io.documents import Checked, Document, Loc, load
from energyplan.io.mission import build
from energyplan.kinds import Within, checked
from energyplan.mission import Fleet, Robot

_OWN = (
    "model", "vehicle", "battery", "start", "home", "soc", "reserve", "payload", "payload_models",
    "speed", "return_to", "planning_effort", "planning_time",
)  # fmt: skip
"""Keys of a mission that each robot may have for itself."""


class _Robot(Checked, BaseModel):
    model_config = ConfigDict(extra="allow", frozen=True)
    name: str
    skills: list[str] = []


class _Needs(Checked, BaseModel):
    model_config = ConfigDict(extra="allow", frozen=True)
    needs: list[str] = []


class _Charger(Checked, BaseModel):
    model_config = ConfigDict(extra="allow", frozen=True)
    places: Annotated[int, Within((1, 1000), (1, 20))] = 1


class _Fleet(Checked, BaseModel):
    model_config = ConfigDict(extra="allow", frozen=True)
    robots: Annotated[list[_Robot], Field(min_length=1, max_length=100)]
    tasks: Annotated[list[_Needs], Field(min_length=1, max_length=1000)]
    chargers: Annotated[list[_Charger], Field(max_length=100)] = []


@checked(MissionError)
def read_fleet(path: str | Path) -> Fleet:
    """Read a fleet from YAML.

    The file is that of a mission (`read_mission`), with ``robots``: a list of mappings with
    ``name``, ``skills`` and whatever of the mission's keys is each one's own. A task may have
    ``needs``: only robots with all these skills can do it. A charger may have ``places``.

    Parameters
    ----------
    path : str or Path
        The file.

    Returns
    -------
    Fleet
        The fleet.

    Raises
    ------
    MissionError
        If the file is malformed, or a task is for nobody; the message names file, line and key.

    Examples
    --------
    >>> from energyplan.io.files import bundled
    >>> len(read_fleet(bundled("fleet_warehouse.yaml")).robots) > 1
    True
    """
    return fleet_from(load(path, MissionError), Path(path).parent)


def fleet_from(document: Document, folder: Path) -> Fleet:
    """Build a fleet from what a mission's file holds."""
    spec = document.check(_Fleet)
    common = {k: v for k, v in document.data.items() if k != "robots"}
    robots: list[Robot] = []
    taken: set[int] = set()
    for k, robot in enumerate(spec.robots):
        extra = robot.model_extra or {}
        foreign = [key for key in extra if key not in _OWN]
        if foreign:
            raise document.fail(
                ("robots", k, foreign[0]),
                f"a robot has no such key; it may have name, skills, {', '.join(_OWN)}",
            )
        able = [j for j, task in enumerate(spec.tasks) if set(task.needs) <= set(robot.skills)]
        if not able:
            raise document.fail(
                ("robots", k), f"robot {robot.name!r} has the skills for no task; leave it out"
            )
        taken |= set(able)
        data: dict[str, Any] = {
            "order": "free", **common, **extra, "name": robot.name,
            "tasks": [_without(document.data["tasks"][j], "needs") for j in able],
            "chargers": [_without(one, "places") for one in common.get("chargers", ())],
        }  # fmt: skip
        lines = _lines(document, k, able, set(extra))
        own = Document(document.source, data, lines, MissionError)
        mission = build(own, folder)
        if robots:  # one map, so that routes are planned once for all
            mission = replace(mission, map=robots[0].mission.map)
        robots.append(Robot(robot.name, mission))
    for j, task in enumerate(spec.tasks):
        if j not in taken:
            raise document.fail(
                ("tasks", j, "needs"), f"no robot has {', '.join(task.needs)}; give it to one"
            )
    places = {
        str((charger.model_extra or {}).get("name")): charger.places for charger in spec.chargers
    }
    return Fleet(tuple(robots), places, str(document.data.get("name", "fleet")))


def _without(mapping: dict[str, Any], key: str) -> dict[str, Any]:
    return {name: value for name, value in mapping.items() if name != key}


def _lines(document: Document, robot: int, able: list[int], own: set[str]) -> dict[Loc, int]:
    """Return the lines of what one robot's mission is made of."""
    lines: dict[Loc, int] = {}
    for place, line in document.lines.items():
        if place[:1] == ("tasks",) and len(place) > 1:
            if place[1] in able:
                lines[("tasks", able.index(int(place[1])), *place[2:])] = line
        elif place[:2] == ("robots", robot):
            lines[place[2:]] = line
        elif place[:1] != ("robots",) and place[:1] not in {(key,) for key in own}:
            lines.setdefault(place, line)
    return lines
