"""Cost: path elements evaluated per second, and how long a cost takes to build.

python benchmarks/cost.py
"""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np

from energyplan.cost import EnergyCost
from energyplan.power import HOTEL, PowerModel
from energyplan.power.effects import VISCOUS_LOSS

ELEMENTS = 2_000_000


def main() -> None:
    """Print a table: every row is one model, evaluated by its table and through the model."""
    paper = PowerModel.preset("quadriga:full:marble")
    lossy = replace(
        paper, vehicle=replace(paper.vehicle, drive_efficiency=0.8, regen_efficiency=0.3)
    )
    models = {
        "the paper's": (paper, False),
        "battery side, lossy": (lossy, True),
        "with hotel load": (lossy.with_term(HOTEL, 60.0), True),
        "with viscous loss": (lossy.with_term(HOTEL, 60.0).with_term(VISCOUS_LOSS, 40.0), True),
    }
    ds, dtheta = np.random.default_rng(0).normal(size=(2, ELEMENTS))
    few = ELEMENTS // 100
    flat = np.zeros(few)
    print(f"{'model':22}{'build [ms]':>11}{'table [M/s]':>13}{'model [M/s]':>13}{'error':>10}")
    for name, (model, battery) in models.items():
        EnergyCost(model, battery=battery).segment_energy(ds[:2], dtheta[:2])
        begun = time.perf_counter()
        cost = EnergyCost(model, battery=battery)
        built = time.perf_counter() - begun
        times = []
        for _ in range(3):
            begun = time.perf_counter()
            cost.segment_energy(ds, dtheta)
            times.append(time.perf_counter() - begun)
        begun = time.perf_counter()
        cost.segment_energy(ds[:few], dtheta[:few], flat)
        through = time.perf_counter() - begun
        print(
            f"{name:22}{1e3 * built:11.1f}{1e-6 * ELEMENTS / min(times):13.1f}"
            f"{1e-6 * few / through:13.3f}{cost.gauge.error:10.1e}"
        )


if __name__ == "__main__":
    main()
