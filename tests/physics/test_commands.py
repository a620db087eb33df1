"""Commands in a log: what the owner learns of the heat of straights from them."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import energyplan as ep
from energyplan.diagnosis import Diagnosis
from energyplan.limits.speed import profile
from energyplan.physics import EngineRobot, Sensors, Tracking, drive
from energyplan.power.effects import COPPER_LOSS, catalogue

pytest.importorskip("mujoco")

VEHICLE = ep.Vehicle.preset("quadriga:full")
MODEL = ep.PowerModel.paper(VEHICLE, K=118.0, mu=0.66).with_term(COPPER_LOSS, 0.00063)
NAMES = ("copper_loss", "linear_inertia", "angular_inertia", "wheel_fight")


def driven(seed: int, slack: float) -> ep.DriveLog:
    """Straights of some metres and turns between them, as a tracking controller drives them."""
    rng = np.random.default_rng(seed)
    straights, turns = rng.uniform(2.5, 5.0, 4), rng.choice([-1, 1], 3) * rng.uniform(0.5, 1.6, 3)
    ds = np.ravel(np.column_stack([straights, [*(0.6 * np.abs(turns)), 0.0]]))
    dtheta = np.ravel(np.column_stack([np.zeros(4), [*turns, 0.0]]))
    slow = replace(VEHICLE, motor=replace(VEHICLE.motor, speed=0.8, acceleration=0.4))
    way = profile(ep.Path(ep.Pose(0, 0, 0.3), ds[:-1], dtheta[:-1]), MODEL, vehicle=slow)
    made = drive(way, EngineRobot.from_model(MODEL), MODEL, tracking=Tracking(slack=slack))
    return Sensors(seed=seed, without=("accel_x",)).log(made.run, f"drive {seed}")


def told(logs: list[ep.DriveLog]) -> tuple[Diagnosis, str]:
    *learned, judged = logs
    effects = [catalogue()[name] for name in NAMES]
    found = ep.diagnose(learned, judged, VEHICLE, effects=effects)
    return found, next(line for line in found.advice if "push against each other" in line)


@pytest.fixture(scope="module")
def logs() -> list[ep.DriveLog]:
    return [driven(seed, 0.0) for seed in range(4)]


def test_commands_tell_which_corrections_a_dead_band_has_to_leave_out(
    logs: list[ep.DriveLog],
) -> None:
    """With a dead band as large as is said of it, a good part of the heat is saved."""
    found, line = told(logs)
    said = re.search(r"nearly always by ([\d.]+) rad/s or less: a dead band", line)
    heat = found.effects[-1]
    assert said is not None
    assert heat.details["share while steering"] > 0.6
    assert float(said[1]) == pytest.approx(heat.details["correction [rad/s]"], rel=0.05)
    saved = 1.0 - driven(0, 0.02).energy / logs[0].energy
    assert saved > 0.3 * heat.details["share of the energy"]


def test_what_commands_do_not_ask_for_is_no_correction(logs: list[ep.DriveLog]) -> None:
    """The commands of another drive, and the same wheels: nothing is blamed on the controller."""
    straight = [
        replace(log, channels={**log.channels, "cmd_right": log.channel("cmd_left")})
        for log in logs
    ]
    _, line = told(straight)
    assert "only 0 % of it" in line
    assert "no correction of the heading is behind it" in line


def test_without_commands_the_log_is_to_have_them(logs: list[ep.DriveLog]) -> None:
    bare = [
        replace(log, channels={k: v for k, v in log.channels.items() if not k.startswith("cmd")})
        for log in logs
    ]
    found, line = told(bare)
    assert "log cmd_left and cmd_right" in line
    assert set(found.effects[-1].details) == {"share of the energy"}


def test_commands_have_units_and_are_no_reason_of_a_residual(
    logs: list[ep.DriveLog], tmp_path: Path
) -> None:
    (log, *_) = logs
    wheel = log.channel("cmd_left") / 0.1 * 60 / (2 * np.pi)
    table = pd.DataFrame({**log.channels, "wanted": wheel}).drop(columns="cmd_left")
    table.to_csv(tmp_path / "drive.csv", index=False)
    read = ep.DriveLog.read(tmp_path / "drive.csv", columns="cmd_left=wanted[rpm*0.1]")
    assert np.allclose(read.channel("cmd_left"), log.channel("cmd_left"), atol=1e-9)
    assert np.allclose(read.channel("cmd_right"), log.channel("cmd_right"))
    found, _ = told(logs)
    every = {one.channel for one in (*found.dependences_before, *found.dependences_after)}
    assert not {"cmd_left", "cmd_right"} & every
