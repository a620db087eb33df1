"""Sensors that end, batteries that are charged, zeros between readings: each is named."""

from __future__ import annotations

import numpy as np
import pytest
from foreign_logs import HEAVY, ROVER, At, Robot, drive

import energyplan as ep


def told(at: At, **changed: np.ndarray) -> str:
    """Return what is doubted of a drive."""
    columns = {"t": at.t, "v_left": at.left, "v_right": at.right, "power": at.power,
               "yaw_rate": at.yaw_rate} | changed  # fmt: skip
    return " ".join(ep.DriveLog.from_columns(columns).warnings)


@pytest.mark.parametrize("noise", [0.0, 0.004])
@pytest.mark.parametrize("robot", [ROVER, HEAVY])
def test_an_end_of_a_range_is_found(robot: Robot, noise: float) -> None:
    at = At(drive(robot), robot)
    high = 0.8 * float(np.median(at.power[np.abs(at.left) + np.abs(at.right) > 0.5 * robot.speed]))
    rough = noise * high * np.random.default_rng(5).normal(size=len(at.t))
    assert "end of its range" in told(at, power=np.minimum(at.power, high) + rough)
    assert "end of its range" not in told(at)


@pytest.mark.parametrize(("amount", "always"), [(0.3, True), (0.3, False), (4.0, False)])
def test_a_battery_that_is_charged_is_named(amount: float, always: bool) -> None:
    """By a panel all the time, or by a charger for half a minute before the drive."""
    at = At(drive(ROVER), ROVER)
    mean = float(at.power.mean())
    if always:
        said = told(at, power=at.power - amount * mean)
    else:
        t = np.append(np.arange(0.0, 30.0, 0.1), 30.0 + at.t)
        still = np.zeros(len(t) - len(at.t))
        said = told(
            at, t=t, v_left=np.append(still, at.left), v_right=np.append(still, at.right),
            yaw_rate=np.append(still, at.yaw_rate),
            power=np.append(still - amount * mean, at.power),
        )  # fmt: skip
    assert "is charged while the robot stands" in said
    assert "as a motor's current does" not in said and "does not rise" not in said
    assert "is charged" not in told(at)


@pytest.mark.parametrize("every", [2, 7])
def test_zeros_between_speeds_are_named(every: int) -> None:
    at = At(drive(ROVER), ROVER)
    blank = np.arange(len(at.t)) % every == 0
    left, right = (np.where(blank, 0.0, speed) for speed in (at.left, at.right))
    assert "v_left and v_right fall to 0 for a moment" in told(at, v_left=left, v_right=right)
    assert "to 0 for a moment" not in told(at)


@pytest.mark.parametrize(("step", "doubted"), [(9.0, True), (2.0, False)])
def test_rows_far_apart_are_doubted(step: float, doubted: bool) -> None:
    t = np.arange(0.0, 3000.0, step)
    speed = np.where(np.sin(t / 70.0) > 0.0, 0.6, 0.0)
    columns = {"t": t, "v_left": speed, "v_right": speed, "power": 90.0 * speed + 3.0}
    checks = ep.DriveLog.from_columns(columns).checks
    assert any("s apart" in one.what and one.refuses for one in checks) == doubted
