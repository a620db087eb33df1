"""Fleets by chance against every share in every order."""

from __future__ import annotations

import pytest
from random_fleets import compared


@pytest.mark.parametrize("seed", [0, 3, 12, 25])
def test_a_fleet_is_as_good_as_every_share_in_every_order(seed: int) -> None:
    found = compared(seed)
    assert found.charges > 0
    assert found.lost <= 0.0
    assert found.excess == pytest.approx(0.0, abs=1e-6)
    assert found.booked == ()
    assert found.bound_holds
