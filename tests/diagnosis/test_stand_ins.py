"""How well effects stand in for each other, and what that makes of a name where more is left."""

from __future__ import annotations

import numpy as np
import pytest

from energyplan.diagnosis.search import chance_to_stand_in, followed


def gram_of(*columns: np.ndarray) -> np.ndarray:
    table = np.column_stack(columns)
    return np.asarray(table.T @ table)


def test_an_effect_is_followed_as_well_as_it_correlates_beyond_the_base() -> None:
    rng = np.random.default_rng(0)
    base, a, b = np.linalg.qr(rng.normal(size=(400, 3)))[0].T
    near = 0.8 * a + 0.6 * b + 3.0 * base  # what the base holds of it does not count
    shares = followed(gram_of(base, a, near), [0], {"a": [(1,)], "near": [(2,)]})
    assert shares == pytest.approx([0.64, 0.64])


def test_the_chance_to_stand_in_falls_from_one_to_none() -> None:
    known = np.array([0.1, 0.4, 0.9])
    chances = [chance_to_stand_in(share, known) for share in (0.0, 0.1, 0.4, 0.65, 0.9, 1.0)]
    assert chances == pytest.approx([1.0, 0.75, 0.5, 0.375, 0.25, 0.0])
