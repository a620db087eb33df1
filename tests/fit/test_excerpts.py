"""Means and pieces of drives, on which a search works where there are more than it needs."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from numpy.testing import assert_allclose

from energyplan.fit.drive import BLOCK, SCALES, Drive, Hold, Windows
from energyplan.fit.estimate import Problem
from energyplan.motion import Motion
from energyplan.power import PowerModel

VEHICLE = PowerModel.preset("quadriga:full:concrete").vehicle


def drive(n: int, period: float = 0.01, gap: float = 0.0) -> Drive:
    """A drive at random speeds, with a gap of the clock after a third of its samples."""
    left, right, power, between = np.random.default_rng(n).normal(size=(4, n))
    t = period * np.arange(n)
    t[n // 3 :] += gap
    yaw = np.angle(np.exp(1j * (3.0 + 0.8 * t)))  # a full turn every eight seconds, wrapped
    motion = Motion(left, right, VEHICLE.icr, {"yaw": yaw, "distance": t**2})
    return Drive("drive", t, motion, power, between=between)


def test_means_are_those_of_samples_between_gaps() -> None:
    whole = drive(250, gap=5.0)
    few = whole.averaged(0.1)
    # ten samples each, but the last ones before the gap and at the end: 83 and 167 samples
    edges = [*range(0, 83, 10), *range(83, 250, 10), 250]
    assert len(few.t) == 9 + 17
    for part, (a, b) in enumerate(pairwise(edges)):
        assert few.t[part] == pytest.approx(whole.t[a:b].mean())
        assert few.power[part] == pytest.approx(whole.power[a:b].mean())
        assert few.motion.v_right[part] == pytest.approx(whole.motion.v_right[a:b].mean())
    assert few.between is not None
    assert_allclose(np.exp(1j * few.motion.channels["yaw"]), np.exp(1j * (3.0 + 0.8 * few.t)))
    for _ in range(2):
        whole = whole.averaged(0.019)
    assert whole.averaged(0.01) is whole  # it has no more samples than that


def test_readings_that_stand_in_rows_are_not_mixed() -> None:
    whole = replace(drive(400), hold=Hold(np.repeat(np.arange(0, 400, 20), 20), 20))
    few = whole.averaged(0.1)
    assert len(few.t) == 80  # each reading stands in four rows still, and is late by none
    assert few.hold is not None
    assert few.hold.rows == 4
    assert_allclose(few.power, whole.power[::5])


@pytest.mark.parametrize("share", [0.05, 0.3, 0.8])
def test_pieces_are_a_share_of_a_drive_and_spread_over_it(share: float) -> None:
    whole = drive(20_000, period=0.1)
    few = whole.pieces(share, 0.4)
    assert len(few.t) == pytest.approx(share * 20_000, rel=0.2)
    assert 1 <= len(few.runs) <= 16
    at = np.searchsorted(whole.t, few.t)
    assert_allclose(few.power, whole.power[at])
    gaps = np.diff(np.concatenate([[0.0], few.t, [2000.0]]))
    assert gaps.max() < 1.5 * (1 - share) * 2000.0 / max(len(few.runs) - 1, 1)
    assert not np.array_equal(whole.pieces(share, 0.9).t, few.t)


@pytest.mark.parametrize("turn", [0.0, 0.5, 0.99])
def test_pieces_of_a_drive_with_a_long_gap_are_of_what_was_logged(turn: float) -> None:
    """A robot that was parked for a week between two drives."""
    whole = drive(3000, period=0.1, gap=6e5)
    few = whole.pieces(0.1, turn)
    assert len(few.t) == pytest.approx(300, rel=0.3)


def test_an_excerpt_is_of_so_many_drives_and_samples() -> None:
    whole = Problem([drive(1500, period=0.1) for _ in range(30)], VEHICLE)
    assert whole.excerpt(45_000, 30) is whole
    assert len(whole.excerpt(45_000, 10).drives) == 10
    few = whole.excerpt(20_000, 30)
    assert len(few.drives) == 30
    assert sum(len(one.t) for one in few.drives) == pytest.approx(20_000, rel=0.2)
    # drives that follow the same pattern show all of it together
    shown = np.unique(np.concatenate([one.t for one in few.drives]))
    assert_allclose(shown, whole.drives[0].t)


def test_a_drive_takes_over_the_times_of_a_change_from_its_means() -> None:
    whole = drive(1000)
    few = whole.averaged(0.1)
    marked = whole.changed_as(few.with_channels(changed=(few.t > 4.0).astype(float)))
    after = marked.motion.channels["changed"]
    assert whole.t[np.flatnonzero(after)[0]] == pytest.approx(4.0, abs=0.011)
    assert np.all(np.diff(after) >= 0.0)


def test_blocks_are_those_that_have_samples() -> None:
    """A gap is no evidence, and takes none from what was driven."""
    t = np.concatenate([np.arange(0.0, 24.0, 0.1), np.arange(1000.0, 1040.0, 0.1)])
    for length in SCALES:
        windows = Windows.of(t, length)
        assert windows.blocks[0] == 0
        assert np.unique(windows.blocks).tolist() == list(range(8))
        driven = t[windows.starts] < 24.0 - 0.5 * BLOCK
        assert np.all(windows.blocks[driven] <= 2)
