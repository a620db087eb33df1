"""The first step with a robot's own log: which channel is what, in which unit, and does it fit."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from energyplan.errors import DriveLogError
from energyplan.io.bags import (
    TOPIC_MAPS,
    TopicMap,
    topics_of,
)
from energyplan.io.config import Project
from energyplan.io.draft import draft
from energyplan.io.given import Given, build_vehicle, known_measures
from energyplan.io.husky import known_husky
from energyplan.io.logs import read_log, read_recording
from energyplan.io.settle import named_in, settle
from energyplan.logs import DriveLog
from energyplan.logs.checks import without_copies
from energyplan.logs.consistency import (
    Check,
    check_consistency,
    contradictions,
)
from energyplan.logs.mapping import (
    Column,
)

_MAPPED = re.compile(r"(\w+)=NAME\[([^]]+)\]")  # what a remedy says to map
_NO_REMEDY = "no unit that is known mends it: give its factor to SI, as in NAME[*0.01]"


@dataclass(frozen=True)
class Start:
    """A robot's project, and how well its log bears it out."""

    project: Project  # vehicle, columns or topics, and what was assumed
    checks: tuple[Check, ...]  # what was held against what
    notes: tuple[str, ...]  # what is uncertain about the log

    @property
    def sound(self) -> bool:
        """Whether nothing contradicts anything."""
        return all(check.ok for check in self.checks)


def start_all(paths: Sequence[Path], given: Given) -> Start:
    """Start from the first of a robot's drives, and hold the others against what comes of it."""
    result, first = _started(paths[0], given)
    if len(paths) == 1:
        return result
    project, checks, notes = result.project, [*result.checks], [*result.notes]
    drives = [first]
    for path in paths[1:]:
        log = read_log(path, dict(project.columns) or None, topics=project.topics)
        wrong = [one for one in log.checks if one.refuses] + contradictions(log, project.vehicle)
        said = {str(one): replace(one, what=f"{log.name}: {one.what}") for one in wrong}
        checks += said.values()
        notes += [f"{log.name}: {one}" for one in (*log.set_aside, *log.warnings)
                  if str(one) not in said]  # fmt: skip
        drives.append(log)
    notes += without_copies(drives, [])[1]
    return replace(result, checks=tuple(checks), notes=tuple(notes))


def start(path: str | Path, given: Given | None = None) -> Start:
    """Guess what a log's columns or topics are, and hold them against the robot."""
    return _started(Path(path), given or Given())[0]


def _started(file: Path, known: Given) -> tuple[Start, DriveLog]:
    """Read a file once, map its series to channels, and build the vehicle."""
    recording = read_recording(file, known.columns)
    husky = known_husky(recording, file, known.topics) if known.columns is None else None
    if husky is not None:
        return _finish(file, husky, known, {}, TOPIC_MAPS["husky"], {}), husky
    drafted = draft(recording, known)
    log, columns, assumed, wrong, turned = settle(recording, drafted, known)
    topics = topics_of(recording, columns, file.stem) if recording.kinds else None

    def changed(units: Mapping[str, str]) -> DriveLog | None:
        """Return the log read in other units; None where that is impossible."""
        other = {c: columns[c].changed(unit=unit) for c, unit in units.items() if c in columns}
        try:
            return DriveLog.of(recording, columns | other, refuse=False)
        except DriveLogError:  # impossible readings, as others than glitches are
            return None

    def holds(units: Mapping[str, str]) -> bool:
        """Return whether a log that is read in other units contradicts nothing."""
        other = changed(units)
        if other is None:
            return False
        compared = check_consistency(other.observed, known_measures(known))
        return not any(one.refuses == "reading" for one in other.checks) and all(
            one.ok or one.value is None for one in compared
        )

    def mends(check: Check) -> bool:
        """Return whether a log that is read as a check's remedy says breaks its rule no more."""
        stated = _MAPPED.findall(check.remedy)
        if not stated or not check.rule:
            return True
        ways = (
            [dict(stated)] if len({c for c, _ in stated}) == len(stated) else map(dict, zip(stated))
        )
        others = [changed(way) for way in ways if {*way} <= {*columns}]
        return not others or any(
            other is not None
            and check.rule not in {one.rule for one in other.checks if one.refuses}
            for other in others
        )

    unstated = {c for c, one in drafted.free.items() if not one.unit and one.field != c}
    result = _finish(file, log, known, columns, topics, assumed, holds, mends, unstated)
    checks = (*result.checks, *wrong)
    notes = [*drafted.notes, *turned, *result.notes]
    used = {name for one in columns.values() for name in one.names}
    idle = [] if recording.kinds else [name for name in recording.columns if name not in used]
    if idle:
        notes.insert(len(drafted.notes), f"columns that serve for nothing: {', '.join(idle[:20])}")
    return replace(result, checks=checks, notes=tuple(notes)), log


def _finish(
    file: Path,
    log: DriveLog,
    known: Given,
    columns: Mapping[str, Column],
    topics: TopicMap | None,
    assumed: dict[str, str],
    holds: Callable[[Mapping[str, str]], bool] = lambda units: True,
    mends: Callable[[Check], bool] = lambda check: True,
    unstated: Collection[str] = (),
) -> Start:
    """Build the vehicle, and hold the log against it."""
    drive = log.observed
    robot = build_vehicle(file, log, drive, known)
    compared = check_consistency(drive, known_measures(known), columns, holds)
    rules = {one.rule for one in compared}  # with the measures, which show more
    doubts = [
        one for one in compared if not one.ok and one.value is None
        # A unit that nothing states is a guess, which a likelier one contradicts.
        and not any(f"{channel}=" in one.remedy for channel in unstated)
    ]  # fmt: skip
    checks = [one for one in compared if one not in doubts]
    checks += [
        one if mends(one) else replace(one, remedy=_NO_REMEDY)
        for one in log.checks if one.refuses and one.rule not in rules
    ]  # fmt: skip
    project = Project(
        name=robot.vehicle.name, vehicle=robot.vehicle, topics=topics,
        columns={} if topics else columns,
        log=file.name, defaults={**assumed, **robot.assumed},
    )  # fmt: skip
    said = {str(one) for one in log.checks if one.refuses or one.rule in rules}
    warnings = (one for one in log.warnings if one not in said)
    notes = (*map(str, log.set_aside), *map(str, doubts), *warnings)
    return Start(
        project,
        tuple(replace(one, remedy=named_in(one.remedy, columns)) for one in checks),
        tuple(named_in(note, columns) for note in notes),
    )
