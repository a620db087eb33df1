"""Readers of logs from other packages."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import commands
import numpy as np
import pytest

from energyplan import DriveLog, PowerModel, simulate
from energyplan.errors import DriveLogError
from energyplan.io.logs import read_log
from energyplan.logs import readers
from energyplan.logs.tables import Recording

COLUMNS = "t=at,v_left=left[cm/s],v_right=right[cm/s],power=watts"


class Point:
    """An entry point that needs no package."""

    def __init__(self, name: str, made: Any) -> None:
        self.name, self._made = name, made

    def load(self) -> Any:
        return self._made


def pairs(path: Path) -> Recording | None:
    """Read lines such as ``left=0.4 right=0.5 watts=80 at=12.5``."""
    if path.suffix != ".pairs":
        return None
    rows = [dict(pair.split("=") for pair in line.split()) for line in path.open()]
    columns = {name: np.array([float(row[name]) for row in rows]) for name in rows[0]}
    return Recording(path.name, columns, unit="line")


Install = Callable[..., None]


@pytest.fixture
def install(monkeypatch: pytest.MonkeyPatch) -> Install:
    """Return a function that makes readers known."""

    def made(*some: tuple[str, Any]) -> None:
        points = [Point(*one) for one in some]
        monkeypatch.setattr(
            readers, "entry_points", lambda group: points if group == "energyplan.logs" else []
        )

    return made


@pytest.fixture
def log() -> DriveLog:
    """Return a drive."""
    model = PowerModel.preset("quadriga:full:concrete")
    return simulate.identification_drive(model, power_noise=2.0, seed=1)


@pytest.fixture
def file(log: DriveLog, tmp_path: Path) -> Path:
    """Return a file of a format that only a reader of another package knows."""
    place = tmp_path / "drive.pairs"
    rows = zip(
        log.t, 100.0 * log.channel("v_left"), 100.0 * log.channel("v_right"), log.power,
        strict=True,
    )  # fmt: skip
    place.write_text("".join(
        f"at={t!r} left={left!r} right={right!r} watts={power!r}\n"
        for t, left, right, power in (map(float, row) for row in rows)
    ))  # fmt: skip
    return place


def test_a_file_is_read_by_the_reader_that_knows_it(
    install: Install, file: Path, log: DriveLog
) -> None:
    with pytest.raises(DriveLogError):
        DriveLog.read(file, COLUMNS)
    install(("pairs", pairs))
    for read in (DriveLog.read, read_log):
        found = read(file, COLUMNS)
        assert found.energy == pytest.approx(log.energy)
        assert found.channel("v_left") == pytest.approx(log.channel("v_left"))


def test_start_and_identify_read_it_too(
    install: Install, file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    install(("pairs", pairs))
    project = tmp_path / "robot.yaml"
    named = ("--columns", COLUMNS, "--like", "quadriga:full", "--out", project)
    assert commands.run(capsys, "start", file, *named).code == 0
    found = commands.run(capsys, "identify", file, "--project", project, "--json")
    assert found.json["terms"]


def test_a_file_of_another_kind_is_left_to_the_others(
    install: Install, log: DriveLog, tmp_path: Path
) -> None:
    install(("nothing", lambda path: None), ("pairs", pairs))
    place = tmp_path / "drive.csv"
    rows = zip(log.t, log.channel("v_left"), log.channel("v_right"), log.power, strict=True)
    text = "\n".join(",".join(repr(float(one)) for one in row) for row in rows)
    place.write_text(f"t,v_left,v_right,power\n{text}\n")
    assert DriveLog.read(place).energy == pytest.approx(log.energy)
    with pytest.raises(DriveLogError, match=r"absent\.pairs"):
        DriveLog.read(tmp_path / "absent.pairs")


def fails(path: Path) -> Recording:
    raise ValueError("the third byte is odd")


@pytest.mark.parametrize(
    ("reader", "said"),
    [
        (fails, "'odd' of the entry point energyplan.logs failed: ValueError"),
        (lambda path: {"t": [0.0]}, "'odd' of the entry point energyplan.logs returned a dict"),
    ],
)
def test_a_reader_that_fails_is_named(install: Install, file: Path, reader: Any, said: str) -> None:
    install(("odd", reader))
    with pytest.raises(DriveLogError, match=said):
        DriveLog.read(file, COLUMNS)
