from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from energyplan import Path, Pose, Trajectory
from energyplan.errors import PathError
from energyplan.path import wrap_angle

number = st.floats(-3, 3)
segments = st.lists(st.tuples(number, number), min_size=1, max_size=6)


@given(st.floats(-1e3, 1e3))
def test_wrapped_angles(angle: float) -> None:
    wrapped = float(wrap_angle(angle))
    assert -np.pi < wrapped <= np.pi
    assert np.exp(1j * wrapped) == pytest.approx(np.exp(1j * angle), abs=1e-9)


@pytest.mark.parametrize("longitudinal", [0.0, 0.3])
def test_vertices_agree_with_integrated_kinematics(longitudinal: float) -> None:
    start = Pose(1.0, -2.0, 0.4)
    path = Path(start, [1.0, 0.0, -0.7, 0.5], [0.0, 1.2, -2.0, 0.3], longitudinal)

    def twist(_: float, pose: np.ndarray, ds: float, dtheta: float) -> list[float]:
        c, s = np.cos(pose[2]), np.sin(pose[2])
        sideways = -longitudinal * dtheta
        return [ds * c - sideways * s, ds * s + sideways * c, dtheta]

    pose = np.array(start)
    for k in range(len(path)):
        pose = solve_ivp(
            twist, (0, 1), pose, args=(path.ds[k], path.dtheta[k]), rtol=1e-11, atol=1e-12
        ).y[:, -1]
        assert path.vertices[k + 1] == pytest.approx(pose, abs=1e-8)


@given(segments, st.floats(-0.5, 0.5))
def test_reversing_returns_to_the_start(parts: list[tuple[float, float]], offset: float) -> None:
    path = Path(Pose(0.3, 0.1, -1.0), *np.array(parts).T, offset)
    back = path.reversed()
    assert np.array(back.end) == pytest.approx(np.array(path.start), abs=1e-9)
    assert back.length == pytest.approx(path.length)
    assert back.turning == pytest.approx(path.turning)


@given(segments)
def test_subdividing_changes_nothing(parts: list[tuple[float, float]]) -> None:
    path = Path(Pose(0, 0, 0), *np.array(parts).T)
    fine = path.subdivide(0.1, 0.2)
    assert np.abs(fine.ds).max() <= 0.1 + 1e-12
    assert np.abs(fine.dtheta).max() <= 0.2 + 1e-12
    assert np.array(fine.end) == pytest.approx(np.array(path.end), abs=1e-9)
    assert fine.length == pytest.approx(path.length)


@given(segments, st.sampled_from([0.0, 0.25]))
def test_poses_give_the_path_back(parts: list[tuple[float, float]], offset: float) -> None:
    path = Path(Pose(1, 2, 3), *np.array(parts).T, offset)
    again = Path.from_poses(path.poses(0.2, 0.5), offset, tolerance=1e-6)
    assert np.array(again.end) == pytest.approx(np.array(path.end), abs=1e-7)
    assert again.length == pytest.approx(path.length, abs=1e-7)
    assert again.turning == pytest.approx(path.turning, abs=1e-7)


def test_sideways_motion_is_refused_with_its_place() -> None:
    with pytest.raises(PathError, match="from pose 1 to pose 2"):
        Path.from_poses([(0, 0, 0), (1, 0, 0), (1, 1, 0)])


def test_paths_join_only_where_they_meet() -> None:
    first = Path(Pose(0, 0, 0), [1.0], [0.5])
    both = first + Path(first.end, [2.0], [0.0])
    assert both.length == pytest.approx(3.0)
    with pytest.raises(PathError, match="starts"):
        first + Path(Pose(5, 0, 0), [2.0], [0.0])


def test_scaling_a_trajectory_keeps_the_geometry() -> None:
    t = np.linspace(0, 4, 5)
    slow = Trajectory(t, t, 0 * t, 0 * t, np.ones(5), np.zeros(5))
    fast = slow.scaled(2.0)
    assert fast.duration == pytest.approx(2.0)
    assert fast.v * np.gradient(fast.t) == pytest.approx(slow.v * np.gradient(slow.t))
    assert fast.poses == pytest.approx(slow.poses)
