"""Sides in different units are told from sides of which one takes next to nothing on turns."""

from __future__ import annotations

import numpy as np

from energyplan.logs.one_side import compare_powers


def _channels(unit: float) -> dict[str, np.ndarray]:
    """Straight on with 100 W a side, then turns on which the left side takes 1 W."""
    turns = np.repeat([0.0, 1.0], 50)
    return {
        "t": 0.1 * np.arange(100),
        "v_left": 0.5 - 0.3 * turns,
        "v_right": 0.5 + 0.3 * turns,
        "p_left": unit * (100.0 - 99.0 * turns),
        "p_right": 100.0 + 100.0 * turns,
    }


def test_an_inner_side_that_takes_next_to_nothing_is_in_no_other_unit() -> None:
    assert compare_powers(_channels(1.0)) == ""


def test_a_side_in_kilowatts_is_told() -> None:
    assert "map both in one unit, as in p_left=NAME[kW]" in compare_powers(_channels(1e-3))
