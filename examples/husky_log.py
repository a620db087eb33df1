"""From a Husky's raw recording to its power parameters, step by step.

    python examples/husky_log.py FOLDER

FOLDER holds drives of one surface of the BorealTC data set: ``pro_NN.csv`` (motor currents and
wheel speeds) and ``imu_NN.csv``. Two thirds of the drives are identified from, the others are
predicted.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

import energyplan as ep
from energyplan.errors import EnergyPlanError, NotIdentifiableError
from energyplan.io.husky import HuskyDrive, read_husky


def show_conversion(file: Path) -> None:
    """Show what one recording holds, and what becomes of it."""
    raw = np.genfromtxt(file, delimiter=",", names=True)
    train = HuskyDrive()
    print(f"1. The raw recording {file.parent.name}/{file.name}")
    print(f"   {len(raw)} rows over {raw['time'][-1]:.0f} s: {', '.join(raw.dtype.names)}")
    print(f"   currents from {raw['curL'].min():.2f} to {raw['curL'].max():.2f} A, never negative")

    print("\n2. Motor current to mechanical power")
    print(
        f"   motor constant {train.back_emf:.4f} V s/rad x gear {train.gear:.2f} / wheel radius "
        f"{train.wheel_radius:.3f} m = {train.power_per_current:.1f} V per m/s of tread speed"
    )
    log = read_husky(file)
    k = int(np.argmax(log.power))
    for side in ("left", "right"):
        speed, power = log.channel(f"v_{side}")[k], log.channel(f"p_{side}")[k]
        print(f"   at {log.t[k]:.1f} s the {side} side at {speed:+.3f} m/s takes {power:.0f} W")

    print("\n3. What was mended, and what these sensors cannot tell")
    for item in log.set_aside:
        print(f"   {item}")
    for warning in log.warnings:
        print(f"   {warning}")


def main(folder: Path) -> None:
    """Convert, identify, predict."""
    files = sorted(folder.glob("pro_*.csv"))
    if not files:
        raise SystemExit(f"{folder} holds no pro_NN.csv; name a folder such as borealtc/FLOORING")
    show_conversion(max(files, key=lambda file: file.stat().st_size))

    logs = [read_husky(file) for file in files]
    training = [log for k, log in enumerate(logs) if k % 3 != 2]
    holdout = [log for k, log in enumerate(logs) if k % 3 == 2]
    robot = ep.Vehicle.preset("husky_a200")
    print(f"\n4. Parameters of the {robot.name} on {folder.name}, from {len(training)} drives")
    try:
        found = ep.identify(training, robot)
    except NotIdentifiableError as error:
        raise SystemExit(f"   cannot be found: {error}") from None
    for term in found.model.terms:
        value = found.model.coefficient(term.name)
        unit = "" if term.unit == "1" else term.unit
        print(f"   {term.symbol:3} = {value:7.3f} +- {found.std_error[term.name]:.3f} {unit}")
    icr = found.model.vehicle.icr
    print(
        f"   tread ICRs {icr.left:.3f} m left, {icr.right:.3f} m right; the wheels are at 0.278 m"
    )
    for warning in found.warnings:
        print(f"   {warning}")

    print(f"\n5. Prediction of {len(holdout)} drives that were not fitted")
    for log in holdout:
        predicted = float(log.weights @ found.model.power(log.motion(icr)))
        error = predicted / log.energy - 1
        print(
            f"   {log.name}: {log.energy:6.0f} J measured, {predicted:6.0f} J predicted "
            f"({error:+.1%})"
        )


if __name__ == "__main__":
    if len(sys.argv) != 2:
        raise SystemExit(__doc__)
    try:
        main(Path(sys.argv[1]))
    except EnergyPlanError as problem:
        raise SystemExit(str(problem)) from None
