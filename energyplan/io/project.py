"""A project: what a robot's logs are to be read with, in one file that every command takes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any

import yaml

from energyplan.errors import ConfigError, DriveLogError
from energyplan.io.config import ProjectFile, plain_vehicle, read_vehicle
from energyplan.io.documents import load
from energyplan.io.files import atomic_write
from energyplan.io.topics import TopicMap
from energyplan.logs.mapping import Column, column_from
from energyplan.records import ReadOnly
from energyplan.vehicle import Vehicle


@dataclass(frozen=True)
class Project(ReadOnly):
    """How a robot's logs are read, and the robot."""

    name: str  # what to call it
    vehicle: Vehicle  # the robot
    columns: Mapping[str, Column] = field(default_factory=lambda: MappingProxyType({}))
    topics: TopicMap | None = None  # which field of a bag serves as which channel
    log: str = ""  # name of the log that the project was made from
    defaults: Mapping[str, Any] = field(default_factory=lambda: MappingProxyType({}))


def read_project(path: str | Path) -> Project:
    """Read a project."""
    document = load(path, ConfigError)
    if document.data.get("kind") != "project":
        raise document.fail(
            ("kind",),
            "this file holds no project; energyplan start LOG --out FILE.yaml makes one",
        )
    spec = document.check(ProjectFile)
    columns: dict[str, Column] = {}
    for channel, item in spec.columns.items():
        told = {"column": item} if isinstance(item, str) else item.model_dump()
        try:
            columns[channel] = column_from(channel, **told)
        except DriveLogError as problem:
            raise document.fail(("columns", channel), str(problem)) from None
    topics = None
    if spec.topics is not None:
        topics = TopicMap.model_validate(spec.topics)
    return Project(
        spec.name, read_vehicle(Path(path)), columns, topics, spec.log or "", spec.defaults
    )


def read_columns(path: str | Path) -> dict[str, Column]:
    """Read which column serves as which channel from a project's file."""
    project = read_project(path)
    if not project.columns:
        raise ConfigError(f"{path}: the project has no columns: it was made from a bag")
    return dict(project.columns)


def write_project(project: Project, path: str | Path) -> Path:
    """Write a project as YAML, whole or not at all."""
    data: dict[str, Any] = {"kind": "project", "name": project.name}
    data |= {"log": project.log} if project.log else {}
    data["vehicle"] = plain_vehicle(project.vehicle)
    if project.columns:
        data["columns"] = {
            channel: {key: value for key, value in column.described().items() if value}
            for channel, column in project.columns.items()
        }
    if project.topics is not None:
        data["topics"] = project.topics.model_dump(exclude_defaults=True)
    if project.defaults:
        data["defaults"] = dict(project.defaults)
    return atomic_write(path, yaml.safe_dump(data, sort_keys=False, allow_unicode=True, width=100))
