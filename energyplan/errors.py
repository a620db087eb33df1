"""Named errors. Each says what was wrong, where, and what would be right.

Bad input derives from both `EnergyPlanError` and `ValueError`; a question that has no answer
(no path, a parameter that the log does not determine) derives from `EnergyPlanError` alone.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager


class EnergyPlanError(Exception):
    """Base of every error that the library raises on purpose."""


class InvalidInputError(EnergyPlanError, ValueError):
    """The input is wrong; the message names the place and the remedy.

    Parameters
    ----------
    message : str
        What is wrong.
    place : sequence of str and int
        The way to the value, such as ``("tasks", 2, "pose")``.
    """

    def __init__(self, message: str, place: Sequence[str | int] = ()) -> None:
        super().__init__(message)
        self.place = tuple(place)


class UnusualValueWarning(UserWarning):
    """A value is possible but unusual: perhaps it is in another unit."""


class StorageError(EnergyPlanError):
    """A file cannot be written because of the disk, such as a full one."""


class UnknownNameError(InvalidInputError):
    """A preset, term, planner or place has no such name; the known ones are listed."""

    def __init__(self, kind: str, name: str, known: object) -> None:
        names = ", ".join(sorted(str(k) for k in known)) if hasattr(known, "__iter__") else known
        super().__init__(f"unknown {kind} {name!r}; known: {names}")


class VehicleError(InvalidInputError):
    """A vehicle's geometry, loads or limits are inconsistent."""


class PathError(InvalidInputError):
    """A path or trajectory is malformed, or no skid-steer robot can drive it."""


class ModelError(InvalidInputError):
    """A power model is built from parts that do not fit together."""


class MissingChannelError(InvalidInputError):
    """A power term needs a channel that the motion does not have."""


class DriveLogError(InvalidInputError):
    """A drive log is malformed; the message names file, line and channel."""


class MapError(InvalidInputError):
    """A map, its image or its surfaces are malformed."""


class ConfigError(InvalidInputError):
    """A configuration file is malformed; the message names file, place and remedy."""


class MissionError(InvalidInputError):
    """A mission is malformed; the message names the task or the line."""


class MessageError(InvalidInputError):
    """A ROS message is malformed; the message names the field and the remedy."""


class FrameError(MessageError):
    """A pose is in a frame that cannot be brought into the map's, or the robot's is not known."""


class NoViapointsError(MessageError):
    """A request to plan through poses names none."""


class NotIdentifiableError(EnergyPlanError):
    """The data do not determine a parameter; the message says what to drive instead."""


class PlanningError(EnergyPlanError):
    """Base of the errors that planners raise."""


class NoPathError(PlanningError):
    """No drivable path joins start and goal, or none was found at a resolution.

    Parameters
    ----------
    message : str
        What was tried, and what may help.
    certainty : {"at_resolution", "proven"}
        Whether it is proven that there is none, or whether none was found in steps of some size.
    resolution : float
        That size [m]; NaN where there is no such thing.
    """

    def __init__(
        self, message: str, certainty: str = "at_resolution", resolution: float = float("nan")
    ) -> None:
        super().__init__(message)
        self.certainty = certainty
        self.resolution = resolution


class StartInCollisionError(PlanningError):
    """The footprint at the start is not free."""


class GoalInCollisionError(PlanningError):
    """The footprint at the goal is not free."""


class OutsideMapError(PlanningError):
    """A pose lies outside the map."""


class TimeLimitError(PlanningError):
    """The time limit passed, or the effort was spent, before a first plan was found.

    Parameters
    ----------
    message : str
        How far the search got, and what may help.
    remedy : {"time_limit", "effort"}
        The option that gives more.
    """

    def __init__(self, message: str, remedy: str = "time_limit") -> None:
        super().__init__(message)
        self.remedy = remedy


class CancelledError(EnergyPlanError):
    """Nobody waits for the result any more."""


class InvalidPathError(PlanningError):
    """What a planner returned is no answer to the problem; the message says what is wrong."""


class PlannerError(PlanningError):
    """A planner of another package failed; the message names its file and line."""


class LowerBoundError(PlanningError):
    """A lower bound lies above what a path costs: the bound is wrong."""


class UnsupportedPlannerError(PlanningError):
    """The planner cannot be used with this problem; the message says which can."""


class MissingDependencyError(EnergyPlanError, ImportError):
    """An optional package is missing; the message names the extra to install."""


@contextmanager
def needs_extra(extra: str, what: str) -> Iterator[None]:
    """Import optional packages; where one is missing, say which extra is needed for `what`."""
    try:
        yield
    except ImportError as error:
        package = (error.name or "energyplan").partition(".")[0]
        if package == "energyplan":  # no package is missing: the import failed in another way
            raise
        raise MissingDependencyError(
            f"{what} needs {package}; install it with {installation(extra)}"
        ) from error


def installation(extra: str) -> str:
    """Return the command that installs an extra from where this installation came from."""
    import importlib.metadata as metadata
    import json
    import shlex
    from pathlib import Path
    from urllib.parse import urlsplit
    from urllib.request import url2pathname

    try:
        record = metadata.distribution("energyplan").read_text("direct_url.json")
        origin = json.loads(record or "{}")
    except (metadata.PackageNotFoundError, ValueError):
        origin = {}
    editable = "-e " if origin.get("dir_info", {}).get("editable") else ""
    checkout, address = Path(__file__).resolve().parents[1], str(origin.get("url", ""))
    if (checkout / "pyproject.toml").is_file():
        return f"pip install {editable}{shlex.quote(f'{checkout}[{extra}]')}"
    if not address:  # it came from an index, or from a folder of wheels, by its name
        return f"pip install 'energyplan[{extra}]'"
    if not address.startswith("file:"):
        version = origin.get("vcs_info", {})
        commit = f"@{version['commit_id']}" if "commit_id" in version else ""
        kind = f"{version['vcs']}+" if "vcs" in version else ""
        return f"pip install {shlex.quote(f'energyplan[{extra}] @ {kind}{address}{commit}')}"
    place = Path(url2pathname(urlsplit(address).path))
    if place.exists():
        return f"pip install {shlex.quote(f'{place}[{extra}]')}"
    return f"pip install '.[{extra}]' in a checkout of energyplan ({place}, before, is no more)"


class BatteryError(InvalidInputError):
    """A battery or a power profile is inconsistent; the message says which value."""


class InfeasibleMotionError(EnergyPlanError):
    """No speed, or not the requested one, keeps the motion within the limits."""


class PhysicsError(EnergyPlanError):
    """The physics engine cannot go on: a wheel left the ground, or the motion diverged."""
