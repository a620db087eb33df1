"""Paths, trajectories and logs as tables: they read back the same, complaints name the line."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from energyplan import simulate
from energyplan.errors import InvalidInputError
from energyplan.io.tables import (
    read_path,
    read_trajectory,
    write_log,
    write_path,
    write_trajectory,
)
from energyplan.logs import DriveLog
from energyplan.path import Path, Pose, Trajectory
from energyplan.power import PowerModel

KINDS = ("it.csv", "it.csv.gz", "it.parquet")


@pytest.fixture
def path():
    """Arcs, a spin, a reversal and a turn across the heading pi."""
    return Path(
        Pose(1.0, -2.0, 3.0),
        ds=[1.3, 0.0, -0.7, 0.47 * 2.5],
        dtheta=[0.4, 1.9, 0.3, 2.5],
        longitudinal=0.03,
    )


def trajectory():
    t = np.linspace(0.0, 8.0, 161)
    v, omega = 0.5 * np.sin(t), 1.2 * np.cos(0.5 * t)
    fine = np.linspace(0.0, 8.0, 16001)
    yaw = 3.0 + 2.4 * np.sin(0.5 * fine)
    rate = 0.5 * np.sin(fine)
    x, y = (
        np.concatenate([[0.0], np.cumsum(np.diff(fine) * 0.5 * (f[1:] + f[:-1]))])[::100]
        for f in (rate * np.cos(yaw), rate * np.sin(yaw))
    )
    return Trajectory(t, x, y, yaw[::100], v, omega)


@pytest.mark.parametrize("name", KINDS)
def test_paths_read_back_the_same(tmp_path, path, name):
    again = read_path(write_path(path, tmp_path / name), longitudinal=path.longitudinal)
    assert again.length == pytest.approx(path.length, abs=1e-9)
    assert again.turning == pytest.approx(path.turning, abs=1e-9)
    assert_allclose(again.vertices, path.poses(), atol=1e-9)


@pytest.mark.parametrize("name", KINDS)
def test_trajectories_read_back_the_same(tmp_path, name):
    there = trajectory()
    back = read_trajectory(write_trajectory(there, tmp_path / name))
    for key, value in vars(there).items():
        assert_array_equal(getattr(back, key), value)


def test_wrapped_headings_are_unwrapped(tmp_path):
    there = trajectory()
    wrapped = Trajectory(
        there.t, there.x, there.y, np.angle(np.exp(1j * there.yaw)), there.v, there.omega
    )
    back = read_trajectory(write_trajectory(wrapped, tmp_path / "it.csv"))
    assert_allclose(np.diff(back.yaw), np.diff(there.yaw), atol=1e-12)


@pytest.mark.parametrize("name", KINDS)
def test_logs_read_back_the_same(tmp_path, name):
    log = simulate.drive(PowerModel.preset("quadriga:full:marble"), "survey", power_noise=5.0)
    again = DriveLog.read(write_log(log, tmp_path / name))
    assert list(again.channels)[:5] == ["t", "v_left", "v_right", "p_left", "p_right"]
    for channel, values in log.channels.items():
        assert_array_equal(again.channels[channel], values)
    assert (again.set_aside, again.warnings) == ((), ())


def test_unknown_kinds_of_file_are_refused(tmp_path, path):
    with pytest.raises(InvalidInputError, match="unknown type"):
        write_path(path, tmp_path / "it.xlsx")
    assert not (tmp_path / "it.xlsx").exists()
