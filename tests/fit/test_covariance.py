"""What series tell of themselves, against closed forms of autoregressions."""

from __future__ import annotations

import numpy as np
import pytest

from energyplan.fit.solvers import (
    autocorrelation,
    innovation_share,
    local_scale,
    sandwich,
)


def autoregression(a: float, n: int = 4000, seed: int = 1) -> np.ndarray:
    noise = np.random.default_rng(seed).normal(size=n)
    series = np.zeros(n)
    for k in range(1, n):
        series[k] = a * series[k - 1] + noise[k]
    return series


@pytest.mark.parametrize("a", [0.0, 0.5, 0.9])
def test_the_share_of_innovations_is_that_of_the_process(a: float) -> None:
    """Of a first-order autoregression the variance is ``1 / (1 - a^2)`` innovations."""
    assert innovation_share(autoregression(a), [slice(0, 4000)]) == pytest.approx(1 - a**2, rel=0.1)


def test_the_unit_of_a_series_does_not_matter() -> None:
    series = autoregression(0.8)
    told = innovation_share(series, [slice(0, 4000)])
    for unit in (1e-6, 1e3):
        assert innovation_share(unit * series, [slice(0, 4000)]) == pytest.approx(told, rel=1e-9)
        repeats = autocorrelation(series, [slice(0, 4000)]).repeats
        assert autocorrelation(unit * series, [slice(0, 4000)]).repeats == pytest.approx(repeats)


def test_what_a_fit_took_of_slow_noise_is_added_where_it_matters() -> None:
    """A line takes a share of a hundred samples of noise, and next to nothing of ten thousand."""
    for count, matters in ((100, True), (10_000, False)):
        series, pieces = autoregression(0.5, count), [slice(0, count)]
        line = np.linspace(-1.0, 1.0, count)[:, None]
        plain, found = autocorrelation(series, pieces), autocorrelation(series, pieces, line)
        assert np.array_equal(found.rho, plain.rho) != matters


def test_the_scale_around_a_sample_follows_steps_of_the_noise() -> None:
    series = np.r_[np.full(500, 2.0), np.full(500, -6.0)]
    near = local_scale(series, 1.0)
    assert near[:449] == pytest.approx(2.0)
    assert near[551:] == pytest.approx(6.0)
    # in the middle half of a hundred samples are of either kind
    assert near[500] == pytest.approx(np.sqrt(0.5 * (2.0**2 + 6.0**2)), rel=0.02)
    # twenty independent samples take a longer stretch
    assert local_scale(series, 10.0)[401:600] == pytest.approx(
        np.sqrt(np.linspace(4, 36, 201)[1:-1]), rel=0.05
    )
    assert local_scale(series, 10.0)[400] == pytest.approx(2.0)
    assert local_scale(series, 5.0)[450] == pytest.approx(2.0)
    assert local_scale(series, 5.1)[450] > 2.01


def test_a_sandwich_is_that_of_the_matrices_whatever_their_units() -> None:
    rng = np.random.default_rng(5)
    A, B = rng.normal(size=(2, 9, 3)) * [1e-6, 1.0, 1e4]
    bread, meat = A.T @ A, B.T @ B
    by_hand = np.linalg.inv(bread) @ meat @ np.linalg.inv(bread)
    assert sandwich(bread, meat) == pytest.approx(by_hand, rel=1e-6)
