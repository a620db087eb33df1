"""Encoders that count: speeds from counters that run over, are set back, or miss a row."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

import energyplan as ep
from energyplan.logs.mapping import TOTAL, count_rate

RATE = 20.0


def counted(bits: int | None = None, per_metre: float = 5000.0) -> tuple[np.ndarray, ...]:
    """Time, a speed that comes and goes, and what an encoder makes of it."""
    t = np.arange(0.0, 60.0, 1 / RATE)
    speed = 0.8 * np.sin(0.3 * t)
    way = 0.8 / 0.3 * (1 - np.cos(0.3 * t))
    counts = np.floor(per_metre * way)
    return t, speed, counts if bits is None else counts % 2.0**bits


@pytest.mark.parametrize("bits", [None, 16, 32])
def test_a_counter_tells_the_speed_where_it_runs_over_too(bits: int | None) -> None:
    t, speed, counts = counted(bits, per_metre=5000.0 if bits != 32 else 2e9)
    found = count_rate(t, counts, TOTAL) / (5000.0 if bits != 32 else 2e9)
    # One count over two rows, and the curvature of the speed.
    np.testing.assert_allclose(found, speed, atol=RATE / 2 / 5000.0 + 0.003)


def test_a_counter_that_is_set_back_begins_anew() -> None:
    t, speed, counts = counted()
    counts[600:] -= counts[600]
    found = count_rate(t, counts, TOTAL) / 5000.0
    np.testing.assert_allclose(found, speed, atol=RATE / 5000.0 + 0.02)


def test_holes_pauses_and_repeated_times_are_not_counted_across() -> None:
    t, speed, counts = counted()
    counts[100:130] = np.nan
    later = np.where(np.arange(len(t)) >= 800, t + 30.0, t)
    later[401], counts[401] = later[400], counts[400]
    found = count_rate(later, counts, TOTAL) / 5000.0
    known = np.isfinite(counts)
    assert np.array_equal(np.isfinite(found), known)
    np.testing.assert_allclose(found[known], speed[known], atol=0.05)


def test_the_newest_row_first_is_no_robot_that_reverses() -> None:
    t, speed, counts = counted()
    np.testing.assert_allclose(count_rate(t[::-1], counts[::-1], TOTAL)[::-1] / 5000.0, speed,
                               atol=0.01)  # fmt: skip


@pytest.mark.parametrize(
    "values", [[], [5.0], [np.nan, np.nan], [7.0, 7.0, 7.0]], ids=["none", "one", "holes", "still"]
)
def test_what_tells_no_speed_is_none(values: list[float]) -> None:
    found = count_rate(np.arange(float(len(values))), np.array(values), TOTAL)
    assert not np.nan_to_num(found).any()


def test_counters_of_several_wheels_run_over_one_by_one() -> None:
    t, speed, counts = counted(16)
    columns = {"t": t, "a": counts, "b": (counts + 3e4) % 65536, "power": 50.0 + 0.0 * t}
    log = ep.DriveLog.read(
        pd.DataFrame(columns), f"v_left=a+b[ticks*{0.5 / 5000}],v_right=a[ticks*{1 / 5000}]"
    )  # fmt: skip
    for name in ("v_left", "v_right"):
        np.testing.assert_allclose(log.channel(name), speed, atol=0.01)
