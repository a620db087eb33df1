"""What series tell of themselves, against closed forms of autoregressions."""

from __future__ import annotations

import numpy as np
import pytest

from energyplan.fit.covariance import innovation_share


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
