"""From path to profile to check to energy on random vehicles, models and paths.

Run: ``python benchmarks/chain.py [cases]``. Counts the profiles that `check` accepts, and compares
the energies of the driven path, of `check` and of an independent integral in small steps. Then the
driven energy is held against the least that any way of driving takes.
"""

from __future__ import annotations

import sys
import time
from dataclasses import replace
from pathlib import Path as FilePath

import numpy as np

sys.path.insert(0, str(FilePath(__file__).parents[1] / "tests"))

from limits.fine_integral import fine_energy, random_case
from limits.least_drive import least_energy

from energyplan.cost import EnergyCost
from energyplan.errors import EnergyPlanError
from energyplan.limits.feasibility import check
from energyplan.path import Path, Pose, Trajectory
from energyplan.planning.driven import drive_path, priced_models


def arcs_from_stop_to_stop(trajectory: Trajectory) -> bool:
    """Tell whether the robot stands still wherever its curvature changes."""
    v, omega = trajectory.v, trajectory.omega
    inner = slice(1, -1)
    cross = np.abs(v[:-2] * omega[2:] - v[2:] * omega[:-2])
    moving = np.hypot(v, omega)[inner] > 1e-9
    return bool(np.all(cross[moving] < 1e-9))


def as_driven(trajectory: Trajectory, longitudinal: float, parts: int = 16) -> Path:
    """Return what was driven, in short arcs."""
    part = (np.arange(parts) + 0.5) / parts
    step = np.diff(trajectory.t)[:, None] / parts
    v, omega = (
        values[:-1, None] + np.diff(values)[:, None] * part
        for values in (trajectory.v, trajectory.omega)
    )
    ds, dtheta = (v * step).ravel(), (omega * step).ravel()
    dtheta = np.where(np.abs(dtheta) < 1e-9 * np.abs(ds), 0.0, dtheta)
    return Path(Pose(*trajectory.poses[0]), ds, dtheta, longitudinal)


def main() -> None:
    """Print the counts."""
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 500
    rng = np.random.default_rng(0)
    accepted, failed, worst, spans = 0, 0, 0.0, []
    above: dict[bool, list[float]] = {True: [], False: []}
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
        report = check(told.trajectory, priced_models(cost).model)
        accepted += report.feasible
        alone = fine_energy(told.trajectory, model.vehicle, case.size, battery=cost.battery)
        error = max(abs(told.energy - alone), abs(report.energy - alone)) / abs(alone)
        worst = max(worst, error)
        stops = arcs_from_stop_to_stop(told.trajectory)
        path = case.path if stops else as_driven(told.trajectory, case.path.longitudinal)
        above[stops].append(told.energy / least_energy(path, cost) - 1)
    print(f"{count} cases: {accepted} profiles accepted, {failed} without a profile")
    print(f"largest relative difference of driven, checked and integrated energy: {worst:.1e}")
    kinds = {True: "with a stop after each arc", False: "some corners driven through"}
    for stops, name in kinds.items():
        excess = np.array(above[stops])
        low = np.count_nonzero(excess < -1e-6)
        print(
            f"{len(excess)} drives, {name}: {low} take less than the least over all speeds; over "
            f"it by {excess.min():+.1e} at least, {np.median(excess):+.1e} in the median"
        )
    print(f"time of one: {1e3 * np.median(spans):.0f} ms in the median")


if __name__ == "__main__":
    main()
