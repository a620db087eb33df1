"""The app, and what every command does before it begins."""

from __future__ import annotations

import inspect
import math
import re
import select
import sys
from collections.abc import Callable
from dataclasses import MISSING, fields, is_dataclass
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, TypeVar, get_type_hints

import typer
from typer.core import TyperCommand, TyperGroup

from energyplan.cli.answers import presets_used, remember_command, say, short_names
from energyplan.cli.options import OUTPUTS
from energyplan.errors import InvalidInputError

_PROJECT, _ARGUMENTS = "energyplan.project", "energyplan.given"
"""Where the context of a command keeps the project's file, and the arguments as they were given."""
_OF_PROJECT = {"vehicle", "columns", "topics"}  # options that a project gives their value


def misuse(error: typer.TyperException) -> str:
    """Say what is wrong with the words of a command, the value given, and where to look."""
    message = error.format_message().removesuffix(".")
    if (context := getattr(error, "ctx", None)) is None:
        return message
    param = getattr(error, "param", None)
    names = getattr(param, "opts", ())
    unit = re.search(r"\[(.+?)\]", getattr(param, "help", None) or "")
    words = context.meta.get(_ARGUMENTS, [])
    if "--vehicle" in names and message.startswith("Missing option"):
        message += " (or a project's, by --project)"
    if message.startswith("Got unexpected extra argument"):
        message += "; a pose, a list and a value with blanks are one word each, as in 2.0,3.5,90deg"
    if message.startswith("No such option") and isinstance(context.command, TyperGroup):
        message = (
            message.partition(" (Possible")[0] + ", before a command; give it after the command"
        )
    for word, following in [*pairwise([*words, ""])][::-1]:  # what is given last counts
        name, joined, value = word.partition("=")
        if name in names:
            given = value if joined else following
            wrong, _, _ = message.partition(", unable to parse")
            message = wrong.replace("Input should be", f"{given!r} should be")
            if unit and message.endswith("a valid number"):
                message += f" in {unit.group(1)}, without the unit"
    return f"{message}; see {context.command_path} --help"


class Command(TyperCommand):
    """A command that looks at its outputs before it begins, and takes a project.

    An option whose metavar ends with dots takes all that follows it, up to the next option.
    """

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
                elif not args[k + 1 :] or args[k + 1].startswith("-"):
                    raise InvalidInputError(f"{word} is given without a value")
            elif current is not None:
                spread += [current, word]
            else:
                spread.append(word)
        return super().parse_args(ctx, spread)

    def invoke(self, ctx: Any) -> Any:
        """Run the command, unless it could not end well."""
        from energyplan.io.files import refuse_overwriting

        check_standard_output()
        for param in self.params:
            if isinstance(value := ctx.params.get(param.name), float) and math.isnan(value):
                raise InvalidInputError(f"{param.opts[0]} is nan; give a number")
        source = ctx.get_parameter_source("vehicle")
        if ctx.params.get("model") and source is not None and source.name == "DEFAULT_MAP":
            ctx.params["vehicle"] = None  # a model has its vehicle, the project's is another word
        outputs = ctx.meta.get(OUTPUTS, {})
        given = [value for name, value in ctx.params.items() if name not in outputs]
        values = [v for value in given for v in (value if isinstance(value, list) else [value])]
        inputs = [v for v in (*values, ctx.meta.get(_PROJECT)) if isinstance(v, str | Path)]
        refuse_overwriting(list(outputs.values()), inputs)
        presets_used.set(presets_named(inputs))
        short_names.set(stand_for(ctx.params))
        words = [*ctx.command_path.split(), *ctx.meta.get(_ARGUMENTS, ())]
        remember_command(words, inputs)
        return super().invoke(ctx)


def presets_named(inputs: list[str | Path]) -> dict[str, str]:
    """Return the preset models that a command's values or files name, with their sources."""
    from energyplan.io.files import strings_behind
    from energyplan.power.presets import MODEL_PRESETS

    named = {name for value in inputs for name in (str(value), *strings_behind(value))}
    return {name: preset.source for name, preset in MODEL_PRESETS.items() if name in named}


def stand_for(given: dict[str, Any]) -> list[str]:
    """Say which presets the short names of vehicles stand for, such as one without its load."""
    from energyplan.vehicle import VEHICLE_PRESETS

    notes = []
    for name in (given.get("vehicle"), given.get("like")):
        if name in VEHICLE_PRESETS and (meant := VEHICLE_PRESETS[name]()).name != name:
            known = ", ".join(other for other in VEHICLE_PRESETS if other.startswith(f"{name}:"))
            notes.append(f"{name} stands for {meant.name}, of {meant.mass:g} kg; known: {known}")
    return notes


_FIRST_STEPS = """\
energyplan: energy-aware path planning for wheeled skid-steer robots

See it work              energyplan demo
Read your own log        energyplan start LOG --track 0.5 --wheelbase 0.475 --mass 147 \\
                           --out robot.yaml
Learn a power model      energyplan diagnose LOG --project robot.yaml --out model.yaml
Plan a route             energyplan plan --map MAP.yaml --model model.yaml \\
                           --start 2,2,0 --goal 20,12,90deg
Will the battery last?   energyplan mission MISSION.yaml

All commands: energyplan --help. One command: energyplan plan --help."""


class _Group(TyperGroup):
    """A group of commands; without one it says what to do first, or lists those of a subgroup."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        if not args and not ctx.resilient_parsing:
            say(ctx.get_help() if ctx.parent else _FIRST_STEPS)
            raise typer.Exit(0)
        return super().parse_args(ctx, args)


def grouped(function: Callable[..., Any]) -> Callable[..., Any]:
    """Give a command the options of its groups: parameters whose type is a dataclass of options."""
    hints = get_type_hints(function, include_extras=True)
    groups: dict[str, Any] = {name: kind for name, kind in hints.items() if is_dataclass(kind)}
    options: dict[str, inspect.Parameter] = {}
    for name, parameter in inspect.signature(function).parameters.items():
        if name not in groups:
            annotation = hints[name]
            options[name] = parameter.replace(
                annotation=annotation, kind=inspect.Parameter.KEYWORD_ONLY
            )
            continue
        annotations = get_type_hints(groups[name], include_extras=True)
        for option in fields(groups[name]):
            options[option.name] = inspect.Parameter(
                option.name,
                inspect.Parameter.KEYWORD_ONLY,
                default=inspect.Parameter.empty if option.default is MISSING else option.default,
                annotation=annotations[option.name],
            )

    option = typer.Option(
        callback=_take_project, expose_value=False, is_eager=True,
        hidden=not _OF_PROJECT & options.keys(),
        help="Project written by start, in place of --vehicle, --columns and --topics.",
    )  # fmt: skip
    options["project"] = inspect.Parameter(
        "project", inspect.Parameter.KEYWORD_ONLY, default=None,
        annotation=Annotated[Path | None, option],
    )  # fmt: skip

    def command(project: None = None, **values: Any) -> Any:
        for name, kind in groups.items():
            values[name] = kind(**{option.name: values.pop(option.name) for option in fields(kind)})
        return function(**values)

    command.__name__, command.__doc__ = function.__name__, function.__doc__
    command.__annotations__ = {name: option.annotation for name, option in options.items()}
    command.__signature__ = inspect.Signature(list(options.values()))  # type: ignore[attr-defined]
    return command


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
        register = super().command(name, **{"cls": Command, **options})

        def decorate(function: CommandFunction) -> CommandFunction:
            register(grouped(function))
            return function

        return decorate


def _take_project(ctx: typer.Context, value: Path | None) -> Path | None:
    """Let the project give the options that it can the value of its file."""
    if value is not None and not ctx.resilient_parsing:
        from energyplan.io.config import read_project

        project = read_project(value)
        ctx.meta[_PROJECT] = value
        given = {"columns": project.columns, "topics": project.topics}
        values = {name: str(value) for name, there in given.items() if there}
        values |= dict.fromkeys(("vehicle", "like"), str(value))
        ctx.default_map = {**(ctx.default_map or {}), **values}
    return value


def check_standard_output() -> None:
    """Refuse to begin where nobody can read the answer."""
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
        typer.Option(
            "--version", "-V", callback=_version, is_eager=True, help="Print the version."
        ),
    ] = False,
) -> None:
    """Energy-aware path planning for wheeled skid-steer robots."""
