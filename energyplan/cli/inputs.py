"""What commands are given: logs, poses."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from energyplan.cli.answers import progress, warn
from energyplan.errors import InvalidInputError

if TYPE_CHECKING:
    from energyplan.logs import DriveLog
    from energyplan.path import Pose
    from energyplan.vehicle import Vehicle


def read_logs(
    paths: list[Path], columns: str | None, topics: str | None, vehicle: str
) -> list[DriveLog]:
    """Read drive logs; of bags the vehicle tells the topic map where none is given."""
    from energyplan.io.bags import is_bag
    from energyplan.io.files import same_file
    from energyplan.io.logs import read_log
    from energyplan.io.topics import topic_map_of

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
    with progress("reading") as update:
        return [read_log(path, columns, topics=chosen, progress=update) for path in paths]


def contradictions(logs: list[DriveLog], vehicle: Vehicle) -> list[str]:
    """Return how logs contradict the vehicle, and what mistake would explain it."""
    from energyplan.logs.consistency import Measures, check_consistency, gather

    return [
        f"{log.name}: {check}"
        for log in logs
        for check in check_consistency(
            gather(log.channels, log.power, log.runs), Measures.of(vehicle)
        )
        if not check.ok
    ]


def warn_of_another_robot(what: str, vehicle: Vehicle, others: Iterable[Vehicle]) -> None:
    """Say where something is of a robot with another footprint than the one that drives has."""
    import numpy as np

    for other in {other.name: other for other in others}.values():
        if not np.allclose(vehicle.footprint, other.footprint, rtol=0.05):
            warn(
                f"{what} of another robot, {other.name}, whose footprint is not that of the "
                f"model's {vehicle.name}"
            )


def notes(logs: list[DriveLog], told: Sequence[str] = ()) -> list[str]:
    """Return what the readers of logs warned of, and is not yet told; once for several logs."""
    from energyplan.output.text import listed

    warned: dict[str, list[str]] = {}
    for log in logs:
        for warning in (one for one in log.warnings if not any(one in text for text in told)):
            warned.setdefault(warning, []).append(log.name)
    return [f"{listed(names)}: {warning}" for warning, names in warned.items()]


def parse_pose(text: str) -> Pose:
    """Return the pose that ``X,Y,YAW`` stands for."""
    from energyplan.path import Pose

    parts = text.split(",")
    try:
        if len(parts) != 3:
            raise ValueError(text)
        yaw = parts[2].strip()
        turn = math.radians(float(yaw[:-3])) if yaw.endswith("deg") else float(yaw)
        pose = Pose(float(parts[0]), float(parts[1]), turn)
        if not all(math.isfinite(value) for value in pose):
            raise ValueError(text)
    except ValueError:
        raise InvalidInputError(
            f"pose {text!r} is not X,Y,YAW; write it like 2.0,3.5,90deg or 2.0,3.5,1.57"
        ) from None
    if abs(pose.yaw) > 6.3:
        raise InvalidInputError(
            f"the yaw of pose {text!r} is more than a full turn in radians; for degrees write "
            f"{parts[2].strip().removesuffix('deg')}deg, up to 360"
        )
    return pose


def number(option: str, kind: str, text: str) -> float:
    """Return the amount that an option gives."""
    from energyplan.io.documents import UNITS, amount

    try:
        return float(amount(kind, text))
    except ValueError:
        units = ", ".join(UNITS[kind])
        raise InvalidInputError(
            f"{option} {text!r} is no number; write one, with its unit if it is not SI: {units}"
        ) from None
