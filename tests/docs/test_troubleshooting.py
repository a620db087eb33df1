"""Every message on the page about troubleshooting is one that the program gives."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import energyplan as ep
from energyplan import cli, simulate
from energyplan.fit import fit_icr
from energyplan.io.maps import write_map
from energyplan.io.trajectory import write_log
from energyplan.logs.tables import read_table

PAGE = Path(__file__).resolve().parents[2] / "docs" / "troubleshooting.md"
MODEL = ep.PowerModel.preset("quadriga:empty:marble")
LOG = simulate.drive(MODEL, "spiral", power_noise=2.0, seed=1)
COLUMNS = {name: np.array(LOG.channel(name)) for name in ("t", "v_left", "v_right", "yaw")}
COLUMNS["power"] = np.array(LOG.power)
ROBOT = "quadriga:empty"


def columns(**changed: object) -> Callable[[Path], object]:
    return lambda folder: ep.DriveLog.from_columns({**COLUMNS, **changed})


def without(*names: str) -> Callable[[Path], object]:
    left = {name: values for name, values in COLUMNS.items() if name not in names}
    return lambda folder: ep.DriveLog.from_columns(left)


def command(*words: str) -> Callable[[Path], object]:
    """Run a command in a folder with a log and a map whose halves are apart."""

    def run(folder: Path) -> None:
        write_log(LOG, folder / "drive.csv")
        (folder / "bag.mcap").write_bytes(b"")
        wall = np.zeros((60, 80), bool)
        wall[:, 38:42] = True
        write_map(ep.OccupancyGrid(wall, resolution=0.1), folder / "halves.yaml")
        sys.argv = ["energyplan", *words]
        cli.main()

    return run


def straight(folder: Path) -> object:
    log = simulate.drive(MODEL, [simulate.Setpoint(0.5, 0.5, hold=10.0)], power_noise=2.0, seed=1)
    return ep.identify(log, MODEL.vehicle)


def without_yaw(folder: Path) -> object:
    left = {k: v for k, v in COLUMNS.items() if k not in ("yaw", "yaw_rate")}
    return fit_icr(ep.DriveLog(left), MODEL.vehicle.icr)


def plan(start: str, goal: str, model: str = "quadriga:empty:marble") -> Callable[[Path], object]:
    return command(
        "plan", "--map", "halves.yaml", "--model", model, "--start", start, "--goal", goal,
        "--effort", "2000",
    )  # fmt: skip


def diagnose(*words: str) -> Callable[[Path], object]:
    return command("diagnose", "drive.csv", "--vehicle", ROBOT, *words)


def parquet(folder: Path) -> object:
    (folder / "drive.parquet").write_bytes(b"PAR1")
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(sys.modules, "pyarrow", None)
        patch.setitem(sys.modules, "pyarrow.parquet", None)
        return read_table(folder / "drive.parquet", ep.errors.DriveLogError)


CAUSES: dict[str, Callable[[Path], object]] = {
    "the channel 'v_right' is missing": without("v_right"),
    "power is missing": without("power"),
    "there is no column 'velL'": command(
        "identify", "drive.csv", "--vehicle", ROBOT, "--columns", "v_left=velL"
    ),
    "between 0.1 ms and 20 s is possible": columns(t=1e3 * COLUMNS["t"]),
    "which no robot reaches": columns(v_left=1e3 * COLUMNS["v_left"]),
    "seems to be in degrees": columns(yaw=np.degrees(COLUMNS["yaw"])),
    "has the wrong sign": columns(power=-COLUMNS["power"]),
    "left and right are swapped": columns(
        v_left=COLUMNS["v_right"], v_right=COLUMNS["v_left"]
    ),
    "the topics and the wheel radius are not known": command(
        "identify", "bag.mcap", "--vehicle", ROBOT
    ),
    "slip_friction (mu) cannot be identified": straight,
    "no log has a channel yaw or yaw_rate": without_yaw,
    "is both a training and a hold-out drive": diagnose("--holdout", "drive.csv"),
    "is read, and would be lost": command(
        "identify", "drive.csv", "--vehicle", "halves.yaml", "--out", "halves.yaml"
    ),
    "is not X,Y,YAW": plan("1,2", "3,2,0"),
    "is more than a full turn in radians": plan("1,2,90", "3,2,0"),
    "touches an obstacle": plan("4,2,0", "3,2,0"),
    "there certainly is none": plan("1,2,0", "6,2,0"),
    "unknown model preset 'husky'": plan("1,2,0", "2,2,0", model="husky"),
    "not measured on this robot": plan("1,2,0", "2,2,0"),
    "install it with pip install 'energyplan[parquet]'": parquet,
}  # fmt: skip

HEADINGS = re.findall(r"^\*\*`(.+?)`\*\*:", PAGE.read_text(), re.MULTILINE)


def test_the_page_and_the_causes_are_the_same() -> None:
    assert list(CAUSES) == HEADINGS


@pytest.mark.parametrize("message", CAUSES)
def test_the_message_is_given(
    message: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", sys.argv)
    try:
        CAUSES[message](tmp_path)
        told = ""
    except SystemExit:
        told = "".join(capsys.readouterr())
    except ep.errors.EnergyPlanError as error:
        told = str(error)
    assert message in told
