"""Means and pieces of drives, on which a search works where there are more than it needs."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from numpy.testing import assert_allclose

from energyplan.fit.drive import Drive
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
