"""Paths and trajectories whose columns are named and scaled as those of logs may be."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from energyplan.errors import PathError
from energyplan.io.tables import read_drive, read_path
from energyplan.path import Trajectory

T = np.linspace(0.0, 10.0, 101)
X = 2.0 + 0.5 * T
NONE = 0.0 * T


def table(folder: Path, columns: dict[str, np.ndarray]) -> Path:
    pd.DataFrame(columns).to_csv(folder / "path.csv", index=False)
    return folder / "path.csv"


@pytest.mark.parametrize("columns", [
    {"x_mm": 1e3 * X, "y_mm": NONE, "yaw": NONE},
    {"x [cm]": 1e2 * X, "y [cm]": NONE, "yaw_deg": NONE},
    {"pos_x": X, "pos_y": NONE, "qx": NONE, "qy": NONE, "qz": NONE, "qw": NONE + 1.0},
])  # fmt: skip
def test_poses_are_found_as_those_of_logs(tmp_path: Path, columns: dict[str, np.ndarray]) -> None:
    path = read_path(table(tmp_path, columns))
    assert path.length == pytest.approx(5.0) and tuple(path.start) == pytest.approx((2.0, 0, 0))


@pytest.mark.parametrize("columns", [
    {"time_ms": 1e3 * T, "x": X, "y": NONE, "yaw": NONE, "v_kmh": 1.8 + NONE, "omega": NONE},
    {"stamp.sec": np.floor(T), "stamp.nanosec": np.round(1e9 * (T % 1.0)), "pos_x": X,
     "pos_y": NONE, "qz": NONE, "qw": NONE + 1.0, "linear_velocity": 0.5 + NONE,
     "angular_velocity_z": NONE},
])  # fmt: skip
def test_motion_is_found_as_that_of_logs(tmp_path: Path, columns: dict[str, np.ndarray]) -> None:
    found = read_drive(table(tmp_path, columns))
    assert isinstance(found, Trajectory)
    np.testing.assert_allclose(found.t, T, atol=1e-9)
    np.testing.assert_allclose(found.v, 0.5)


def test_a_heading_without_a_unit_is_asked_about(tmp_path: Path) -> None:
    file = table(tmp_path, {"x": X, "y": NONE, "Heading": NONE})
    with pytest.raises(PathError, match=r"'Heading' says neither its unit nor .* yaw_deg"):
        read_path(file)
