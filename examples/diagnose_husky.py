"""What a real robot does that the model leaves out.

    python examples/diagnose_husky.py FOLDER

FOLDER holds runs of one surface of the BorealTC data set: ``pro_NN.csv`` (motor currents and wheel
speeds) and ``imu_NN.csv``. Every third run is held out. With a robot of your own, replace the
reader: anything that makes an ``ep.DriveLog`` with power and tread speeds will do.
"""

from __future__ import annotations

import sys
from pathlib import Path

import energyplan as ep
from energyplan.io.husky import read_husky


def main(folder: Path) -> None:
    """Read, split by run, diagnose, report."""
    logs = [read_husky(file) for file in sorted(folder.glob("pro_*.csv"))]
    inertial = [log for log in logs if log.has("accel_x")]
    # A channel counts only where every run has it.
    chosen = inertial if len(inertial) >= 6 else logs
    unseen = chosen[::3]
    train = [log for log in chosen if log not in unseen]
    print(f"{folder.name}: {len(train)} runs to learn from, {len(unseen)} to judge by")
    for warning in sorted({log.warnings[0] for log in chosen if log.warnings}):
        print(f"  {warning}")

    diagnosis = ep.diagnose(train, holdout=unseen, vehicle=ep.Vehicle.preset("husky_a200"))
    print(f"verdict: {diagnosis.verdict.replace('_', ' ')}")
    for effect in diagnosis.effects:
        rivals = f", or {' or '.join(effect.rivals)}" if effect.rivals else ""
        print(
            f"  {effect.name}{rivals}: {effect.symbol} = {effect.value:.4g} +- "
            f"{effect.std_error:.2g} {effect.unit}; {effect.meaning}"
        )
    for found in diagnosis.unexplained:
        print(f"  unexplained: {found.shape} ({found.explained_variance:.0%} of the error)")
    for name, error in (("before", diagnosis.before), ("after", diagnosis.after)):
        print(
            f"  held-out runs {name:6}: rmse {error.rmse:.1f} W, "
            f"energy {100 * error.energy_error:+.1f} %"
        )
    for line in diagnosis.advice:
        print(f"  advice: {line}")


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    main(Path(sys.argv[1]))
