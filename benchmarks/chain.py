"""From path to profile to check to energy on random vehicles, models and paths.

Run: ``python benchmarks/chain.py [cases]``. Counts the profiles that `check` accepts, and compares
the energies of the driven path, of `check` and of an independent integral in small steps.
"""

from __future__ import annotations

import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from limits.fine_integral import fine_energy, random_case

from energyplan.cost import EnergyCost
from energyplan.errors import EnergyPlanError
from energyplan.limits.feasibility import check
from energyplan.planning.driven import counted, drive_path


def main() -> None:
    """Print the counts."""
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 500
    rng = np.random.default_rng(0)
    accepted, failed, worst, below, spans = 0, 0, 0.0, 0, []
    for k in range(count):
        case = random_case(rng)
        model = replace(case.model, vehicle=case.vehicle)
        speed = float(rng.uniform(0.2, 1.0)) * model.vehicle.motor.speed if k % 2 else None
        tolerance = float(rng.choice([0.0, 0.03]))
        start = time.perf_counter()
        try:
            cost = EnergyCost(model, battery=bool(k % 3), speed=speed)
            told = drive_path(case.path, cost, tolerance=tolerance)
        except EnergyPlanError as error:
            failed += 1
            print(f"case {k}: {error}")
            continue
        spans.append(time.perf_counter() - start)
        report = check(told.trajectory, counted(cost).model)
        accepted += report.feasible
        alone = fine_energy(told.trajectory, model.vehicle, case.size, battery=cost.battery)
        error = max(abs(told.energy - alone), abs(report.energy - alone)) / abs(alone)
        worst = max(worst, error)
        # The least that the path takes at any one of the speeds that motions are priced at.
        least = EnergyCost(model, battery=cost.battery).energy(case.path)
        below += told.energy < least * (1 - 1e-6)
    print(f"{count} cases: {accepted} profiles accepted, {failed} without a profile")
    print(f"largest relative difference of driven, checked and integrated energy: {worst:.1e}")
    print(f"driven for less than the path takes at its cheapest steady speeds: {below}")
    print(f"time of one: {1e3 * np.median(spans):.0f} ms in the median")


if __name__ == "__main__":
    main()
