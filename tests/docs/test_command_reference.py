"""The page of commands tells every command and every option that the program has."""

from __future__ import annotations

import importlib.util
import re
import sys
from pathlib import Path

import pytest

from energyplan import cli

DOCS = Path(__file__).resolve().parents[2] / "docs"
SPEC = importlib.util.spec_from_file_location("command_reference", DOCS / "command_reference.py")
assert SPEC is not None
assert SPEC.loader is not None
reference = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(reference)
COMMANDS = {command.name: command for command in reference.commands()}


def test_every_command_is_there() -> None:
    named = {str(one.name or one.callback.__name__) for one in cli.app.registered_commands}
    assert {name.split()[1] for name in COMMANDS} == {n.replace("_", "-") for n in named} | {"log"}
    assert "energyplan log info" in COMMANDS


def test_the_help_begins_with_what_a_newcomer_needs() -> None:
    names = [name.split()[1] for name in COMMANDS]
    assert names[:4] == ["start", "identify", "diagnose", "icr"]
    assert names[-1] == "log"


@pytest.mark.parametrize("name", COMMANDS)
def test_the_page_says_what_help_says(
    name: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", [*name.split(), "--help"])
    with pytest.raises(SystemExit):
        cli.main()
    printed = capsys.readouterr().out
    command = COMMANDS[name]
    told = [option.usage.split()[0] for option in command.options]
    options = printed.split("\nOptions:")[1].split("Example:")[0]
    assert told == re.findall(r"^  (--[\w-]+)", options, re.MULTILINE)
    printed = "".join(printed.split())
    for option in (*command.arguments, *command.options):
        assert "".join(option.help.split()) in printed
        assert option.help, f"{name} {option.usage} has no help"
    assert command.example is not None
    assert "".join(command.example.split()) in printed


@pytest.mark.parametrize("page", ["README.md", "docs/index.md"])
def test_overviews_name_every_command(page: str) -> None:
    text = (DOCS.parent / page).read_text()
    missing = [name for name in COMMANDS if not re.search(rf"`[^`]*\b{name.split()[1]}\b", text)]
    assert missing == []
