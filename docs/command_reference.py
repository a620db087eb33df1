"""A Sphinx directive, ``commands``: every command of the program, as its own help describes it.

Extensions for Click cannot read Typer's commands since Typer carries a Click of its own, and what
they draw is a picture of a terminal; this is a list that fits a phone and can be linked to.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import typer
from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

from energyplan import cli


class Option(NamedTuple):
    """An option or argument, as ``--help`` prints it."""

    usage: str
    help: str


class CommandHelp(NamedTuple):
    """What ``--help`` says of a command."""

    name: str
    usage: str
    text: list[str]
    arguments: list[Option]
    options: list[Option]
    example: str | None


def commands(group: Any = None, parent: Any = None) -> Iterator[CommandHelp]:
    """Yield every command, those of groups under their whole name."""
    group = group or cli.commands()
    context = parent or typer.Context(group, info_name="energyplan", **group.context_settings)
    for name, command in group.commands.items():
        inner = typer.Context(command, info_name=name, parent=context)
        if hasattr(command, "commands"):
            yield from commands(command, inner)
            continue
        records: dict[str, list[Option]] = {"argument": [], "option": []}
        for parameter in command.get_params(inner):
            record = parameter.get_help_record(inner)
            if record and "--help" not in parameter.opts:
                records[parameter.param_type_name].append(Option(*record))
        yield CommandHelp(
            name=inner.command_path,
            usage=" ".join([inner.command_path, *command.collect_usage_pieces(inner)]),
            text=[" ".join(part.split()) for part in command.help.split("\n\n")],
            arguments=records["argument"],
            options=records["option"],
            example=(command.epilog or "").removeprefix("Example: ") or None,
        )


def _list(options: list[Option]) -> nodes.definition_list:
    items = [
        nodes.definition_list_item(
            "",
            nodes.term("", "", nodes.literal(text=option.usage)),
            nodes.definition("", nodes.paragraph(text=option.help)),
        )
        for option in options
    ]
    return nodes.definition_list("", *items)


class Commands(SphinxDirective):
    """A section for each command, in the order of the program's help."""

    def run(self) -> list[nodes.Node]:
        """Build the sections."""
        return [self._section(command) for command in commands()]

    def _section(self, command: CommandHelp) -> nodes.section:
        title = command.name.removeprefix("energyplan ")
        section = nodes.section(
            ids=[nodes.make_id(title)], names=[nodes.fully_normalize_name(title)]
        )
        section += nodes.title(text=title)
        section += [nodes.paragraph(text=part) for part in command.text]
        section += nodes.literal_block(command.usage, command.usage, language="text")
        if command.example:
            section += nodes.paragraph(text="Example:")
            section += nodes.literal_block(command.example, command.example, language="sh")
        if command.arguments or command.options:
            section += _list([*command.arguments, *command.options])
        return section


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the directive."""
    app.add_directive("commands", Commands)
    return {"parallel_read_safe": True}
