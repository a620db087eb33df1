"""Batteries that are not the library's own, and remedies that a program applies."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import ArrayLike
from test_corridor import METRE, charger, corridor

from energyplan.battery import BatteryRun
from energyplan.mission import evaluate
from energyplan.path import FloatArray


@dataclass(frozen=True)
class Bucket:
    """A battery without voltage: energy goes in and out."""

    full_energy: float
    cutoff_soc: float = 0.0
    charge_efficiency: float = 1.0

    def simulate(
        self, t: ArrayLike, power: ArrayLike, *, soc: float = 1.0, polarisation: float = 0.0
    ) -> BatteryRun:
        times, load = np.asarray(t, float), np.asarray(power, float)
        spent = np.concatenate([[0.0], np.cumsum(load[:-1] * np.diff(times))]) / self.full_energy
        left = soc - spent
        empty = np.flatnonzero(left < self.cutoff_soc - 1e-12)
        died = float(times[empty[0]]) if len(empty) else np.inf
        level, none = np.clip(left, self.cutoff_soc, 1.0), np.zeros(len(times))
        reason = "charge" if len(empty) else "none"
        return BatteryRun(times, level, none, none, none, none, died, reason, polarisation)

    def usable_energy(self, power: ArrayLike, soc: ArrayLike = 1.0) -> FloatArray:
        _, start = np.broadcast_arrays(np.asarray(power, float), np.asarray(soc, float))
        return np.asarray(self.full_energy * np.maximum(start - self.cutoff_soc, 0.0))

    def larger(self, energy: float) -> Bucket:
        return Bucket(self.full_energy + energy, self.cutoff_soc, self.charge_efficiency)


@pytest.mark.parametrize("order", ["given", "free"])
def test_any_battery_with_what_a_mission_reads_will_do(order: str) -> None:
    asked = corridor(
        1.0, {"end": 29.0}, 5.0, order=order, battery=Bucket(2970.0),
        chargers=(charger(15, "near"), charger(25, "far")),
    )  # fmt: skip
    report = evaluate(asked)
    assert report.order == ("near", "far", "end", "far")
    assert report.soc_end == pytest.approx(1 - METRE * 8 / 2970, rel=1e-3)


def test_the_remedy_of_a_battery_of_ones_own_is_sized_by_it() -> None:
    """24 m there and back take 8640 J; the bucket holds 5000 J."""
    told = evaluate(corridor(1.0, {"end": 29.0}, 5.0, battery=Bucket(5000.0))).task("end")
    assert told.reason == "battery"
    assert told.shortfall == pytest.approx(8640 - 5000, rel=1e-3)
    assert "a battery with 2 Wh more" in told.remedy
