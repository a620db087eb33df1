"""Paths, trajectories and logs as tables: they read back the same, complaints name the line."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from energyplan import simulate
from energyplan.errors import DriveLogError, EnergyPlanError, InvalidInputError, PathError
from energyplan.io.tables import (
    read_drive,
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


PATH = "x,y,yaw\n"
TRAJECTORY = "t,x,y,yaw,v,omega\n"


@pytest.mark.parametrize(
    ("read", "text", "words"),
    [
        (read_path, PATH + "0,0,0\n0,1,0\n", "line 2.*slide 1 m"),
        (read_path, PATH + "0,0,0\n", "1 poses"),
        (read_path, PATH + "0,0,0\n1,,0\n", "line 3: y is empty"),
        (read_path, PATH + "0,0,0\n1,zero,0\n", "line 3: 'y' is 'zero'"),
        (read_path, "x,y\n0,0\n1,0\n", "no column 'yaw'"),
        (read_drive, "t,x,y,yaw\n0,0,0,0\n1,1,0,0\n", "leave t out to have the poses timed"),
        (read_trajectory, PATH + "0,0,0\n1,0,0\n", "plan --trajectory times one"),
        (read_drive, "time,velL,velR,power [W]\n0,0,0,9\n1,1,1,9\n", "energyplan identify"),
        (DriveLog.read, "x,y,yaw\n0,0,0\n1,0,0\n", "energyplan check reads it"),
        (read_path, PATH + "0,0,0\n1e9,0,0\n", "line 3: x is 1e[+]09, beyond"),
        (read_path, PATH + "0,0,0\n9e7,0,0\n", "m long, beyond"),
        (read_trajectory, TRAJECTORY + "0,0,0,0,1,0\n", "1 samples"),
        (read_trajectory, TRAJECTORY + "0,0,0,0,1,0\n0,1,0,0,1,0\n", "line 3: t does not"),
        (read_trajectory, TRAJECTORY + "0,0,0,0,1,inf\n1,1,0,0,1,0\n", "line 2: omega is empty"),
        (read_trajectory, TRAJECTORY + "0,0,0,0,0,1\n1,0,0,57,0,1\n", "line 3: yaw changes by"),
        (read_trajectory, TRAJECTORY + "0,0,0,0,1,0\n1,9,0,0,1,0\n", "line 3: x, y changes by"),
    ],
)  # fmt: skip
def test_malformed_tables_are_refused_with_their_place(tmp_path, read, text, words):
    file = tmp_path / "it.csv"
    file.write_text(text)
    with pytest.raises((PathError, DriveLogError), match=words) as caught:
        read(file)
    assert "it.csv" in str(caught.value)


def test_unknown_kinds_of_file_are_refused(tmp_path, path):
    with pytest.raises(InvalidInputError, match="unknown type"):
        write_path(path, tmp_path / "it.xlsx")
    assert not (tmp_path / "it.xlsx").exists()


@settings(
    max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(
    rows=st.lists(st.lists(st.floats().map(repr), min_size=6, max_size=6), max_size=6),
    head=st.sampled_from([TRAJECTORY, PATH.strip() + ",a,b,c\n"]),
)  # fmt: skip
def test_any_numbers_give_a_result_or_a_named_error(tmp_path, rows, head):
    file = tmp_path / "any.csv"
    file.write_text(head + "".join(",".join(row) + "\n" for row in rows))
    for read in (read_path, read_trajectory):
        try:
            found = read(file)
        except EnergyPlanError as error:
            assert "any.csv" in str(error)
        else:
            assert np.all(np.isfinite(found.vertices if isinstance(found, Path) else found.poses))
