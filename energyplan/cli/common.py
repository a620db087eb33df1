"""What all commands share: the app, options, checks of outputs, answers, progress."""

from __future__ import annotations

import json as jsonlib
import math
import os
import select
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import typer
from typer.core import TyperCommand, TyperGroup

from energyplan.cli.reports import remember_command
from energyplan.errors import InvalidInputError

if TYPE_CHECKING:
    from energyplan.logs import DriveLog
    from energyplan.path import Pose
    from energyplan.vehicle import Vehicle

_OUTPUTS, _PROJECT, _ARGUMENTS = "energyplan.outputs", "energyplan.project", "energyplan.given"
"""Where the context of a command keeps its outputs, the project's file, and what was given."""
_presets: ContextVar[dict[str, str]] = ContextVar("presets", default={})  # noqa: B039
"""Ready-made models that the command in hand uses, with their sources; never changed in place."""
IMAGES = (".png", ".svg", ".pdf")
TABLES = (".csv", ".gz", ".parquet", ".pq")
YAML = (".yaml", ".yml")
HTML = (".html", ".htm")


def writes(*suffixes: str) -> Callable[..., Path | None]:
    """Return the callback of an option that names a file to be written.

    Such an option is checked before the command begins: its suffix, its folder, and that it is none
    of the files that are read.

    Parameters
    ----------
    *suffixes : str
        What the file's name may end with.

    Returns
    -------
    callable
        The callback, for ``typer.Option(callback=...)``.
    """

    def callback(ctx: typer.Context, param: typer.CallbackParam, value: Path | None) -> Path | None:
        from energyplan.io.files import check_output

        if value is not None and not ctx.resilient_parsing:
            check_output(value, suffixes)
            ctx.meta.setdefault(_OUTPUTS, {})[param.name] = value
        return value

    return callback


def writes_folder(
    ctx: typer.Context, param: typer.CallbackParam, value: Path | None
) -> Path | None:
    """Check a folder of output before the command begins; the callback of such an option."""
    from energyplan.io.files import check_output_folder

    if value is not None and not ctx.resilient_parsing:
        check_output_folder(value)
        ctx.meta.setdefault(_OUTPUTS, {})[param.name] = value
    return value


class Command(TyperCommand):
    """A command that looks at its outputs before it begins, and takes lists and a project.

    An option whose metavar ends with dots takes all that follows it, up to the next option.
    ``--project`` gives the options ``--vehicle``, ``--columns`` and ``--topics`` their value.
    """

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.params.append(_project_option())

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse the arguments, each value of a list as if its option stood before it."""
        ctx.meta[_ARGUMENTS] = list(args)
        lists = {
            name
            for param in self.params
            if (getattr(param, "metavar", None) or "").endswith("...")
            for name in param.opts
            if name.startswith("-")
        }
        spread: list[str] = []
        current = None
        for k, word in enumerate(args):
            if word == "--":
                spread += args[k:]
                break
            if word.startswith("-") and len(word) > 1:
                name, joined, _ = word.partition("=")
                current = name if name in lists else None
                if current is None or joined:
                    spread.append(word)
            elif current is not None:
                spread += [current, word]
            else:
                spread.append(word)
            follows = args[k + 1 :]
            bare = current is not None and word == current
            if bare and (not follows or follows[0].startswith("-")):
                spread.append(word)  # without a value: the parser says so
        return super().parse_args(ctx, spread)

    def invoke(self, ctx: Any) -> Any:
        """Run the command, unless it could not end well."""
        from energyplan.io.files import refuse_overwriting

        check_standard_output()
        for param in self.params:
            if isinstance(value := ctx.params.get(param.name), float) and math.isnan(value):
                raise InvalidInputError(f"{param.opts[0]} is nan; give a number")
        outputs = ctx.meta.get(_OUTPUTS, {})
        given = [value for name, value in ctx.params.items() if name not in outputs]
        values = [v for value in given for v in (value if isinstance(value, list) else [value])]
        inputs = [v for v in (*values, ctx.meta.get(_PROJECT)) if isinstance(v, str | Path)]
        refuse_overwriting(list(outputs.values()), inputs)
        _presets.set(presets_named(inputs))
        words = [*ctx.command_path.split(), *ctx.meta.get(_ARGUMENTS, ())]
        remember_command(words, inputs)
        return super().invoke(ctx)


def presets_named(inputs: list[str | Path]) -> dict[str, str]:
    """Return the ready-made models that a command's values or files name, with their sources."""
    from energyplan.io.files import strings_behind
    from energyplan.power.presets import MODEL_PRESETS

    named = {name for value in inputs for name in (str(value), *strings_behind(value))}
    return {name: preset.source for name, preset in MODEL_PRESETS.items() if name in named}


class _Group(TyperGroup):
    """A group of commands that shows its help where no command is named."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        if not args and not ctx.resilient_parsing:
            say(ctx.get_help())
            raise typer.Exit(0)
        return super().parse_args(ctx, args)


CommandFunction = TypeVar("CommandFunction", bound=Callable[..., Any])


class App(typer.Typer):
    """A group of commands, each a `Command`."""

    def __init__(self, **options: Any) -> None:
        settings = {"help_option_names": ["-h", "--help"]}
        super().__init__(cls=_Group, context_settings=settings, **options)

    def command(
        self, name: str | None = None, **options: Any
    ) -> Callable[[CommandFunction], CommandFunction]:
        """Register a command."""
        return super().command(name, **{"cls": Command, **options})


def _take_project(ctx: typer.Context, value: Path | None) -> Path | None:
    """Let the project give the options that it can the value of its file."""
    if value is not None and not ctx.resilient_parsing:
        from energyplan.io.project import read_project

        project = read_project(value)
        ctx.meta[_PROJECT] = value
        given = {"vehicle": True, "columns": project.columns, "topics": project.topics}
        told = {name: str(value) for name, there in given.items() if there}
        ctx.default_map = {**(ctx.default_map or {}), **told}
    return value


def _project_option() -> Any:
    """Build the option that every command has."""
    from typer.main import get_command

    parts = typer.Typer(add_completion=False)

    @parts.command()
    def take(
        project: Annotated[
            Path | None,
            typer.Option(
                callback=_take_project,
                expose_value=False,
                is_eager=True,
                help="Project written by start, in place of --vehicle, --columns and --topics.",
            ),
        ] = None,
    ) -> None:
        """Hold the option."""

    return next(param for param in get_command(parts).params if param.name == "project")


def check_standard_output() -> None:
    """Refuse to begin where nobody can read the answer.

    Raises
    ------
    InvalidInputError
        If the standard output is closed, or is a pipe that nobody reads.
    """
    if sys.stdout is None:
        raise InvalidInputError("the standard output is closed; the answer has no place to go")
    try:
        number = sys.stdout.fileno()
    except (OSError, ValueError):
        return  # not a file of the system, as where a program caught it
    if hasattr(select, "poll"):
        watch = select.poll()
        watch.register(number, select.POLLOUT)
        if any(event & (select.POLLERR | select.POLLNVAL) for _, event in watch.poll(0)):
            raise InvalidInputError(
                "the standard output is a closed pipe; the answer has no place to go"
            )


def _version(value: bool) -> None:
    if value:
        from energyplan import __version__

        say(f"energyplan {__version__}")
        raise typer.Exit(0)


app = App(
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    help="Energy-aware path planning for wheeled skid-steer robots.",
    epilog="Begin with: energyplan start LOG --out PROJECT.yaml, or energyplan demo",
)


@app.callback()
def _options(
    version: Annotated[
        bool,
        typer.Option("--version", callback=_version, is_eager=True, help="Print the version."),
    ] = False,
) -> None:
    """Energy-aware path planning for wheeled skid-steer robots."""


def _complete(*kinds: str) -> Callable[[str], list[str]]:
    """Return the completion of an option that names a preset."""

    def complete(incomplete: str) -> list[str]:
        from energyplan.io.topics import TOPIC_MAPS
        from energyplan.power.presets import MODEL_PRESETS
        from energyplan.vehicle.presets import VEHICLE_PRESETS

        known = {"vehicle": VEHICLE_PRESETS, "model": MODEL_PRESETS, "topics": TOPIC_MAPS}
        names = [*(name for kind in kinds for name in known[kind]), *_yaml_files(incomplete)]
        return [name for name in names if name.startswith(incomplete)]

    return complete


def _yaml_files(incomplete: str) -> list[str]:
    folder = Path(incomplete).parent if incomplete else Path()
    try:
        return [str(file) for file in sorted(folder.glob("*.y*ml"))]
    except OSError:
        return []


Json = Annotated[bool, typer.Option("--json", help="Print one JSON document and nothing else.")]
Strict = Annotated[bool, typer.Option("--strict", help="End with exit code 3 if the answer is no.")]
Logs = Annotated[
    list[Path],
    typer.Argument(
        metavar="LOG...", help="Drive logs: CSV, CSV.gz, Parquet, bags, Husky recordings."
    ),
]
VehicleName = Annotated[
    str,
    typer.Option(
        "--vehicle",
        metavar="VEHICLE",
        help="A preset such as husky_a200, or a YAML file.",
        autocompletion=_complete("vehicle"),
    ),
]
ModelName = Annotated[
    str,
    typer.Option(
        "--model",
        metavar="MODEL",
        help="A preset such as husky_a200:flooring, or a YAML file.",
        autocompletion=_complete("model"),
    ),
]
Columns = Annotated[
    str | None,
    typer.Option(
        metavar="NAME=COLUMN,...",
        help="Columns with other names or units: v_left=velL,yaw=heading[deg]; or a YAML file.",
    ),
]
Topics = Annotated[
    str | None,
    typer.Option(
        metavar="TOPICS",
        help="Which topics of a bag to read: husky, jackal, warthog, or a YAML file.",
        autocompletion=_complete("topics"),
    ),
]
OutModel = Annotated[
    Path | None,
    typer.Option("--out", callback=writes(*YAML), help="Write the model to this YAML file."),
]
Report = Annotated[
    Path | None,
    typer.Option("--report", callback=writes(*HTML), help="Write a report to this HTML file."),
]

NO, INTERRUPTED = 3, 130
"""Exit codes of a negative answer with ``--strict``, and of Ctrl-C."""


def say(text: str) -> None:
    """Print a line of the answer."""
    sys.stdout.write(text + "\n")


def give_up_stdout() -> None:
    """Write no more answers: Python, when it ends, must not try to write to what was closed."""
    sys.stdout = open(os.devnull, "w")  # noqa: PTH123, SIM115


def warn(text: str) -> None:
    """Print a line that is no part of the answer."""
    sys.stderr.write(text + "\n")


def answer(document: dict[str, Any], lines: list[str], *, json: bool) -> None:
    """Print the answer, as JSON or as lines of text; JSON names ready-made models."""
    presets = [
        {"name": name, "measured": False, "source": source}
        for name, source in _presets.get().items()
    ]
    if presets:
        document = {**document, "preset": presets}
    warn_of_presets()  # with the answer: an error stays one line
    if json:
        say(jsonlib.dumps(document, indent=1, allow_nan=False))
    else:
        say("\n".join(lines))


def warn_of_presets() -> None:
    """Say which ready-made models the command in hand uses."""
    for name, source in _presets.get().items():
        warn(f"preset {name}: not measured on this robot, but taken from {source}")


def verdict(yes: bool, strict: bool) -> None:
    """End with another exit code where the answer is no and ``--strict`` was given."""
    if strict and not yes:
        raise typer.Exit(NO)


@contextmanager
def progress(text: str) -> Iterator[Any]:
    """Show on stderr that work goes on; yields ``update(fraction, text)``."""
    if not sys.stderr.isatty():
        yield lambda fraction, note="": None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    from energyplan.compilation import Compiling, on_compile

    # A bar without a total moves to and fro, until the work tells how far it is.
    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(text, total=None)

        def compiling(what: Compiling) -> None:
            note = what.name.removeprefix("energyplan.")
            if what.total:
                note = f"{what.done + 1} of {what.total} kernels" if what.name else ""
            bar.update(task, description=f"preparing, once: {note}" if note else text)

        ended = on_compile(compiling)
        try:
            yield lambda fraction, note="": bar.update(
                task, total=1.0, completed=fraction, description=note or text
            )
        finally:
            ended()


def read_logs(
    paths: list[Path], columns: str | None, topics: str | None, vehicle: str
) -> list[DriveLog]:
    """Read drive logs; of bags the vehicle tells the topic map where none is given."""
    from energyplan.io.bags import is_bag
    from energyplan.io.logs import read_log
    from energyplan.io.topics import topic_map_of

    bags = [path for path in paths if is_bag(path)]
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
    from energyplan.logs.consistency import Measures, check_consistency
    from energyplan.logs.evidence import gather

    return [
        f"{log.name}: {check}"
        for log in logs
        for check in check_consistency(
            gather(log.channels, log.power, log.runs), Measures.of(vehicle)
        )
        if not check.ok
    ]


def notes(logs: list[DriveLog]) -> list[str]:
    """Return what the readers of logs warned of."""
    return [f"{log.name}: {warning}" for log in logs for warning in log.warnings]


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
