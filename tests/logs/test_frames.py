"""Logs and trajectories as pandas DataFrames, in and out."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import energyplan as ep
from energyplan import simulate
from energyplan.errors import DriveLogError
from energyplan.logs.tables import read_table

MODEL = ep.PowerModel.preset("quadriga:empty:marble")


def test_a_log_survives_the_way_through_a_frame() -> None:
    log = simulate.drive(MODEL, "figure8", power_noise=5.0, seed=1)
    again = ep.DriveLog.read(log.to_frame())
    assert set(again.channels) == set(log.channels)
    for name, values in log.channels.items():
        assert np.array_equal(again.channel(name), values)


def test_frames_of_other_programs_are_read_as_files_are() -> None:
    frame = pd.DataFrame(
        {
            "t": pd.to_datetime([0, 500, 1000, 1500], unit="ms"),
            "velL": [50, 50, None, 50],
            "velR": pd.array([50, 50, 50, 50], dtype="Int64"),
            "watt": ["120", "120", "120", "120"],
            "state": ["a", "b", "c", "d"],
        }
    )
    log = ep.DriveLog.read(frame, "v_left=velL[cm/s],v_right=velR[cm/s],power=watt")
    assert log.t == pytest.approx([0.0, 0.5, 1.5])
    assert log.channel("v_left") == pytest.approx(0.5)
    assert [one.count for one in log.set_aside] == [1]
    assert any("state" in warning for warning in log.warnings)


def test_numbers_are_read_alike_with_and_without_other_columns(tmp_path: Path) -> None:
    """A table of numbers alone is read by NumPy, any other by pandas."""
    rng = np.random.default_rng(0)
    numbers = rng.normal(size=(200, 3)) * 10.0 ** rng.integers(-9, 9, (200, 3))
    rows = [",".join(map(repr, row)) for row in numbers.tolist()]
    rows[7] = "1e400, -0 ,1E30"
    plain, mixed = tmp_path / "plain.csv", tmp_path / "mixed.csv"
    plain.write_text("\n".join(["a,b,c", *rows]))
    mixed.write_text("\n".join(["a,b,c,word", *(f"{row},x" for row in rows)]))
    one, other = (read_table(file, DriveLogError) for file in (plain, mixed))
    assert list(other.text) == ["word"]
    for name in "abc":
        np.testing.assert_array_equal(one.column(name), other.column(name))
    np.testing.assert_array_equal(np.delete(one.column("b"), 7), np.delete(numbers[:, 1], 7))


@pytest.mark.parametrize(
    ("frame", "told"),
    [
        (pd.DataFrame({"t": [0.0, 1.0], "v_left": 0.5}), "v_right"),
        (pd.DataFrame({"t": [0.0, 1.0], "v_left": 0.5, "v_right": ["a", "b"], "power": 1.0}),
         "row 0"),
        (pd.DataFrame([[0, 0], [1, 1]], columns=["t", "t"]), "two columns are named 't'"),
        (pd.DataFrame(), "no columns"),
        ([1, 2], "give a pandas DataFrame"),
    ],
)  # fmt: skip
def test_frames_that_are_no_log_are_refused(frame: pd.DataFrame, told: str) -> None:
    with pytest.raises(DriveLogError, match=told):
        ep.DriveLog.read(frame)


def test_a_trajectory_survives_the_way_through_a_frame() -> None:
    drive = ep.Trajectory([0, 2], x=[0, 1], y=[0, 0], yaw=[0, 0], v=[0.5, 0.5], omega=[0, 0])
    frame = drive.to_frame()
    assert list(frame.columns) == ["t", "x", "y", "yaw", "v", "omega"]
    again = ep.Trajectory(**frame)
    assert np.array_equal(again.poses, drive.poses)
