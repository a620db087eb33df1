"""The four ways of docs/paths.md: at most five steps each, run in an empty folder."""

from __future__ import annotations

import re
import shlex
import shutil
import sys
from pathlib import Path

import pytest
from own_robot import bag, drive

import energyplan as ep
from energyplan import cli
from energyplan.io.bundled import bundled
from energyplan.io.files import files_behind
from energyplan.io.trajectory import write_log

PAGE = Path(__file__).resolve().parents[2] / "docs" / "paths.md"
WAYS = dict(re.findall(r"^## (.+?)\n(.*?)(?=^## |\Z)", PAGE.read_text(), re.MULTILINE | re.DOTALL))


def commands(way: str) -> list[list[str]]:
    lines = re.findall(r"^   (energyplan .*)$", WAYS[way], re.MULTILINE)
    return [shlex.split(line) for line in lines]


def bring(way: str, folder: Path) -> None:
    """Put into the folder what the reader has, and nothing else."""
    has = re.search(r"You have: (.*?)\n\n", WAYS[way], re.DOTALL)
    assert has is not None
    for name in re.findall(r"`([\w.]+)`", has[1]):
        if name == "drive.csv":
            truth = ep.PowerModel.preset("quadriga:full:marble")
            log = ep.simulate.identification_drive(
                truth, power_noise=5.0, speed_noise=0.003, seed=2
            )
            write_log(log, folder / name)
        elif name == "bag":
            bag(folder, drive())
        elif name.endswith(".yaml"):
            for file in files_behind(bundled(name)):
                shutil.copy(file, folder)


def test_each_way_has_at_most_five_steps() -> None:
    assert len(WAYS) == 4
    for text in WAYS.values():
        steps = [int(number) for number in re.findall(r"^(\d)\. ", text, re.MULTILINE)]
        assert steps == list(range(1, len(steps) + 1))
        assert 1 <= len(steps) <= 5


BEGINNING_WITH_THE_DEMO = [way for way in WAYS if commands(way)[0][1] == "demo"]


def follow(
    way: str, folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Take the steps of a way; what the demo makes is there already if it is the first."""
    bring(way, folder)
    monkeypatch.chdir(folder)
    monkeypatch.setattr("energyplan.serve.server.run", lambda *arguments: None)
    for words in commands(way):
        if words[1] == "demo":
            assert words[2:] == ["--out", "demo"]
            assert (folder / "demo").is_dir()
            continue
        monkeypatch.setattr(sys, "argv", words)
        with pytest.raises(SystemExit) as left:
            cli.main()
        assert not left.value.code, f"{words}: {capsys.readouterr().err}"
    named = {word for words in commands(way) for word in words if word.endswith(".html")}
    for name in named:
        assert "SHA-256" in (folder / name).read_text()


@pytest.mark.slow
@pytest.mark.usefixtures("hurried")
@pytest.mark.parametrize("way", [way for way in WAYS if way not in BEGINNING_WITH_THE_DEMO])
def test_a_way_leads_to_its_end(
    way: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The ways that begin with the demo are followed by the test of the demo."""
    follow(way, tmp_path, monkeypatch, capsys)
