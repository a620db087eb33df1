"""Options that several commands have, alone and in groups, and how their values are read."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple

import typer
from typer import Argument, Option

from energyplan.errors import InvalidInputError, needs_extra

if TYPE_CHECKING:
    from energyplan.battery import Battery
    from energyplan.path import Pose
    from energyplan.planning import Goal

OUTPUTS = "energyplan.outputs"
"""Where the context of a command keeps the files that it will write."""
IMAGES = (".png", ".svg", ".pdf")
TABLES = (".csv", ".gz", ".parquet", ".pq")
GEOJSON = (".geojson", ".json")
YAML = (".yaml", ".yml")
HTML = (".html", ".htm")
RECORDING = ".mcap"
_PACKAGES = {
    **dict.fromkeys((*IMAGES, *HTML), ("plots", "matplotlib")),
    **dict.fromkeys((".parquet", ".pq"), ("parquet", "pyarrow")),
    RECORDING: ("bags", "rosbags"),
}  # extra and package that files of a kind are written with


def output(text: str, *suffixes: str, name: str | None = None) -> Any:
    """Return the option of a file that is written, or of a folder if it has no suffixes.

    It is checked before the command begins: its suffix, its folder, that it is none of the files
    that are read, and that what writes it is installed.
    """

    def callback(ctx: typer.Context, param: typer.CallbackParam, value: Path | None) -> Path | None:
        from energyplan.io.files import check_output, check_output_folder

        if value is not None and not ctx.resilient_parsing:
            if suffixes:
                check_output(value, suffixes)
            else:
                check_output_folder(value)
            if found := _PACKAGES.get(value.suffix.lower()):
                with needs_extra(found[0], f"writing {value}"):
                    import_module(found[1])
            ctx.meta.setdefault(OUTPUTS, {})[param.name] = value
        return value

    return Option(*([name] if name else []), callback=callback, help=text)


def number(option: str, kind: str, text: str) -> float:
    """Return the amount that an option gives, such as ``50%`` or ``90deg``."""
    from energyplan.records import NO_NUMBER, UNITS, amount

    try:
        return float(amount(kind, text))
    except NO_NUMBER:
        units = ", ".join(UNITS[kind])
        raise InvalidInputError(
            f"{option} {text!r} is no number; write one, with its unit if it is not SI: {units}"
        ) from None


def fraction(option: str, text: str) -> float:
    """Return the part of a whole that an option gives."""
    value = number(option, "fraction", text)
    if not 0.0 <= value <= 1.0:
        raise InvalidInputError(f"{option} {text} is not between 0 and 1; give a part, as 80%")
    return value


def columns_of(value: str | None) -> Any:
    """Return the value of ``--columns``, or the columns of the project's file that it names."""
    from energyplan.io.config import read_columns

    return read_columns(value) if value and value.endswith(YAML) else value


def _complete(kind: str) -> Callable[[str], list[str]]:
    """Return the completion of an option that names a preset or a file."""

    def complete(incomplete: str) -> list[str]:
        from energyplan.io.bags import TOPIC_MAPS
        from energyplan.power.presets import MODEL_PRESETS
        from energyplan.vehicle import VEHICLE_PRESETS

        known = {"vehicle": VEHICLE_PRESETS, "model": MODEL_PRESETS, "topics": TOPIC_MAPS}
        try:
            files = sorted(Path(incomplete or ".").parent.glob("*.y*ml"))
        except OSError:
            files = []
        return [name for name in [*known[kind], *map(str, files)] if name.startswith(incomplete)]

    return complete


Json = Annotated[bool, Option("--json", help="Print one JSON document and nothing else.")]
Strict = Annotated[bool, Option("--strict", help="End with exit code 3 if the answer is no.")]
Logs = Annotated[
    list[Path],
    Argument(metavar="LOG...", help="Drive logs: CSV, CSV.gz, Parquet, bags, Husky recordings."),
]
VehicleName = Annotated[
    str,
    Option(
        "--vehicle",
        metavar="VEHICLE",
        help="A preset such as husky_a200, or a YAML file.",
        autocompletion=_complete("vehicle"),
    ),
]
ModelName = Annotated[
    str,
    Option(
        "--model",
        metavar="MODEL",
        help="A preset such as husky_a200:flooring, or a YAML file.",
        autocompletion=_complete("model"),
    ),
]
Columns = Annotated[
    str | None,
    Option(
        metavar="NAME=COLUMN,...",
        help="Columns with other names or units: v_left=velL,yaw=heading[deg]; or a YAML file.",
    ),
]
OutModel = Annotated[Path | None, output("Write the model to this YAML file.", *YAML)]
Report = Annotated[Path | None, output("Write a report to this HTML file.", *HTML)]
Plot = Annotated[Path | None, output("Draw it: .png, .svg or .pdf.", *IMAGES)]
PoseText = Annotated[str, Option(metavar="X,Y,YAW", help="In metres and radians, or as 90deg.")]
AtBattery = Annotated[
    bool,
    Option("--at-battery", help="Energy at the battery, with drive losses."),
]
Speed = Annotated[
    str | None,
    Option(
        help="Tread speed [m/s], or 'cheapest'. Default: the vehicle's usual speed; without one, "
        "as fast as its motors go."
    ),
]
Reverse = Annotated[
    Literal["yes", "no"] | None,
    Option(help="Whether it may drive backwards. Default: as the vehicle's key 'reverse' says."),
]
MapFile = Annotated[
    Path, Option("--map", help="YAML file of a map, or of a site; or an image with --resolution.")
]
MaybeSite = Annotated[
    Path | None, Option("--map", help="A map's or a site's file, whose ground is driven on.")
]


@dataclass(frozen=True)
class DriveOptions:
    """What drives, how fast, and where its energy is measured."""

    model: ModelName
    at_battery: AtBattery = False
    speed: Speed = None


class Pack(NamedTuple):
    """A battery and its state of charge."""

    battery: Battery
    soc: float


@dataclass(frozen=True)
class BatteryOptions:
    """The battery at the start."""

    battery: Annotated[
        str | None,
        Option(
            metavar="BATTERY",
            help="A preset, a YAML file, or words such as '24 V 20 Ah lead-acid'; energy is then "
            "counted at the battery.",
        ),
    ] = None
    soc: Annotated[
        str | None, Option(help="State of charge at the start, as 80%. Default: full.")
    ] = None

    @property
    def pack(self) -> Pack | None:
        """The battery and its charge, where one is given; its notes are said."""
        if self.battery is None:
            if self.soc is not None:
                raise InvalidInputError(
                    "--soc is the charge of a battery; give --battery, or leave it out"
                )
            return None
        from energyplan.cli.answers import warn
        from energyplan.io.mission import read_battery  # with all of missions

        charge = 1.0 if self.soc is None else fraction("--soc", self.soc)
        pack = read_battery(self.battery)
        for note in pack.notes:
            warn(note)
        return Pack(pack, charge)

    def measured(self, drive: DriveOptions) -> DriveOptions:
        """Return how a robot is driven, its energy measured at the battery if there is one."""
        return replace(drive, at_battery=drive.at_battery or self.battery is not None)


@dataclass(frozen=True)
class SiteOptions:
    """The place: its map, and what lies on it or closes parts of it."""

    map_file: MapFile
    resolution: Annotated[
        float | None, Option(help="Size of a pixel, where the map is an image alone [m].")
    ] = None
    surfaces: Annotated[
        Path | None, Option(help="GeoJSON of areas, each with a model, a speed or both.")
    ] = None
    keepout: Annotated[Path | None, Option(help="A map whose occupied cells are closed.")] = None
    clearance: Annotated[float | None, Option(help="Distance to keep from obstacles [m].")] = None


OF_ROBOT = "--project --vehicle --columns --topics --unsigned"
OF_ROUTE = (
    "--map --resolution --surfaces --keepout --clearance --model --at-battery --battery --soc "
    "--speed --start --goal --effort --turning --reverse --planner"
)
"""Options that the command which one gives next takes as they are."""

Work = Annotated[
    int | None,
    Option(
        min=1,
        help="Work for each route, the same under any load; 50000 take about 1 s. Default: 30000, "
        "less for each of many routes of a mission.",
    ),
]


@dataclass(frozen=True)
class GoalOptions:
    """Where a route may end."""

    goal: Annotated[
        list[str] | None,
        Option(
            metavar="X,Y[,YAW]",
            help="Where to go: a pose, or a place at any heading. Given several times, the one "
            "that costs least.",
        ),
    ] = None
    goal_heading: Annotated[
        Literal["given", "either", "any"] | None,
        Option(
            help="Whether the heading at the goal is as given, that or its opposite, or any. "
            "Default: given, and any without a YAW."
        ),
    ] = None
    goal_radius: Annotated[
        float, Option(min=0.0, help="How far from the goal the route may end [m].")
    ] = 0.0

    @property
    def goals(self) -> tuple[Goal, ...]:
        """The goals, of which one is to be reached."""
        if not self.goal:
            raise InvalidInputError(
                "--goal is missing; give X,Y,YAW, or X,Y for any heading at a place"
            )
        return _goals(self.goal, self.goal_heading, self.goal_radius)


@dataclass(frozen=True)
class ReturnOptions:
    """Where a robot has to get back to."""

    back: Annotated[bool, Option("--return", help="It must still get back to the start.")] = False
    return_to: Annotated[
        list[str] | None,
        Option(
            metavar="X,Y[,YAW]",
            help="It must still get back to this pose, or place at any heading. Given several "
            "times, or with --return, to the one that costs least.",
        ),
    ] = None
    return_heading: Annotated[
        Literal["given", "either", "any"] | None,
        Option(help="The heading at --return-to, as --goal-heading of plan."),
    ] = None
    return_radius: Annotated[
        float,
        Option(min=0.0, help="How far from --return-to it may be then [m]."),
    ] = 0.0

    def goals(self, start: Pose) -> tuple[Goal, ...]:
        """Return the goals, of which it has to get back to one; none where it need not."""
        if not self.return_to and (self.return_heading or self.return_radius):
            raise InvalidInputError(
                "--return-heading and --return-radius say how to arrive at --return-to; give that"
            )
        known = _goals(self.return_to or (), self.return_heading, self.return_radius)
        return (*_goals([start] if self.back else (), None, 0.0), *known)


def _goals(places: Sequence[str | Pose], heading: str | None, radius: float) -> tuple[Goal, ...]:
    """Return the goals that some texts or poses name, with options for all of them."""
    from energyplan.planning.goal import as_goals

    return tuple(goal for one in places for goal in as_goals(one, heading or "", radius))


@dataclass(frozen=True)
class Effort:
    """How much to plan a route."""

    effort: Work = None
    time_limit: Annotated[
        float,
        Option(help="Time after which the planning of a route stops [s].", show_default=False),
    ] = math.inf


Unsigned = Annotated[
    bool,
    Option(
        "--unsigned",
        help="The sensors of current or power see no sign: what a motor returns is not negative.",
    ),
]


@dataclass(frozen=True)
class RobotOptions:
    """The robot whose logs are read, and how."""

    vehicle: VehicleName
    columns: Columns = None
    topics: Annotated[
        str | None,
        Option(
            metavar="TOPICS",
            help="Which topics of a bag to read: husky, jackal, warthog, or a YAML file.",
            autocompletion=_complete("topics"),
        ),
    ] = None
    unsigned: Unsigned = False
