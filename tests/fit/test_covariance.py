"""What series tell of themselves, and what leaving out blocks tells of coefficients."""

from __future__ import annotations

import numpy as np
import pytest

from energyplan.fit.solvers import innovation_share, jackknife, repeats_of


def autoregression(a: float, n: int = 4000, seed: int = 1) -> np.ndarray:
    noise = np.random.default_rng(seed).normal(size=n)
    series = np.zeros(n)
    for k in range(1, n):
        series[k] = a * series[k - 1] + noise[k]
    return series


@pytest.mark.parametrize("a", [0.0, 0.5, 0.9])
def test_a_series_tells_its_process_whatever_its_unit(a: float) -> None:
    """Of a first-order autoregression ``1 - a^2`` is new, and ``(1 + a) / (1 - a)`` repeats."""
    series, pieces = autoregression(a), [slice(0, 4000)]
    for unit in (1e-6, 1.0, 1e3):
        assert innovation_share(unit * series, pieces) == pytest.approx(1 - a**2, rel=0.1)
        assert repeats_of(unit * series, pieces) == pytest.approx((1 + a) / (1 - a), rel=0.2)


def test_the_jackknife_of_a_mean_is_the_variance_of_its_mean() -> None:
    values = np.random.default_rng(2).normal(size=(5000, 2)) * [1.0, 3.0]
    moved = (values.sum(axis=0) - values) / (len(values) - 1)
    by_hand = np.cov(values.T) / len(values)
    assert jackknife(moved) == pytest.approx(by_hand, rel=0.01, abs=1e-6)


def test_intervals_of_few_blocks_hold_as_often_as_they_say() -> None:
    rng, inside = np.random.default_rng(3), []
    for _ in range(2000):
        values = rng.normal(size=(8, 1))
        moved = (values.sum(axis=0) - values) / 7
        inside.append(abs(values.mean()) < 1.96 * np.sqrt(jackknife(moved)[0, 0]))
    assert 0.93 < np.mean(inside) < 0.98
