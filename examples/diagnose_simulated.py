"""Why does the prediction differ? On drives whose answer is known.

    python examples/diagnose_simulated.py [FOLDER]

A robot drives on ground tilted by 4 degrees, and its computers draw 30 W; the paper's model knows
of neither. With your own logs, read them with ``ep.DriveLog.read`` and go on from step 2. Pictures
go into FOLDER where one is named.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

import energyplan as ep
from energyplan import simulate
from energyplan.diagnosis import Diagnosis
from energyplan.output import plots
from energyplan.output.plots import png
from energyplan.power import HOTEL
from energyplan.power.effects import GRADE


def report(diagnosis: Diagnosis) -> None:
    """Print a diagnosis."""
    print(f"verdict: {diagnosis.verdict.replace('_', ' ')}")
    for effect in diagnosis.effects:
        print(
            f"  {effect.name}: {effect.symbol} = {effect.value:.4g} +- {effect.std_error:.2g} "
            f"{effect.unit} ({effect.meaning}); for a planner: {effect.planner}"
        )
        print(
            f"    error in blocks not fitted to falls by {effect.evidence.improvement:.0%} "
            f"+- {effect.evidence.improvement_std_error:.0%}; "
            f"by chance with probability {effect.evidence.p_value:.1g}"
        )
        if effect.rivals:
            print(f"    these drives cannot separate it from: {', '.join(effect.rivals)}")
    for found in diagnosis.unexplained:
        print(f"  unexplained: {found.shape} ({found.explained_variance:.0%} of the error)")
    rows = (
        ("before", diagnosis.before, diagnosis.before_interval),
        ("after", diagnosis.after, diagnosis.after_interval),
    )
    for name, error, interval in rows:
        low, high = interval.rmse
        print(
            f"  hold-out {name:6}: rmse {error.rmse:6.2f} W ({low:.2f} to {high:.2f}), "
            f"bias {error.bias:+6.2f} W, energy {100 * error.energy_error:+.2f} %"
        )
    for line in diagnosis.advice:
        print(f"  advice: {line}")


def draw(diagnosis: Diagnosis, unseen: ep.DriveLog, folder: Path) -> None:
    """Draw power and energy before and after, and the residual against the heading."""
    folder.mkdir(parents=True, exist_ok=True)
    predicted = {
        "paper's model": diagnosis.predictions_before[0],
        "extended model": diagnosis.predictions_after[0],
    }
    energy = plots.prediction(unseen, predicted, "A drive that was held out")
    (folder / "energy.png").write_bytes(png(energy))
    residuals = {label: unseen.power - power for label, power in predicted.items()}
    heading = np.degrees(np.angle(np.exp(1j * unseen.channel("yaw"))))
    picture = plots.figure()
    plots.residual_against(picture.axes[0], heading, residuals, "heading [deg]")
    (folder / "residual.png").write_bytes(png(picture))
    print(f"pictures: {folder / 'energy.png'}, {folder / 'residual.png'}")


def main(folder: Path | None) -> None:
    """Simulate, diagnose, report."""
    print("1. Two drives to learn from and one to judge by, 5 W of noise on each motor's power")
    vehicle = ep.Vehicle.preset("quadriga:full")
    truth = ep.PowerModel.preset("quadriga:full:concrete")
    truth = truth.with_term(GRADE, vehicle.mass).with_term(HOTEL, 30.0)
    options = {
        "slope": np.radians(4.0), "uphill": 0.7, "power_noise": 5.0, "speed_noise": 0.005,
        "without": {"slope", "accel_x"},  # nobody logged these
    }  # fmt: skip
    train = [simulate.identification_drive(truth, seed=seed, **options) for seed in (1, 2)]
    unseen = simulate.validation_drive(truth, seed=3, **options)

    print("2. The diagnosis")
    diagnosis = ep.diagnose(train, holdout=unseen, vehicle=vehicle)
    report(diagnosis)
    angle = next(effect for effect in diagnosis.effects if effect.name == "tilted_plane")
    print(f"  the ground is tilted by {np.degrees(angle.value):.2f} degrees (true: 4.00)")

    print("3. The extended model in a plan: ten metres straight at two speeds")
    energies = {}
    for speed in (0.3, 1.0):
        cost = ep.EnergyCost(diagnosis.model, speed=speed)
        energies[speed] = float(cost.segment_energy(np.array([10.0]), np.array([0.0]))[0])
        print(f"  at {speed} m/s: {energies[speed]:.0f} J")
    more = energies[0.3] / energies[1.0] - 1.0
    print(
        f"  the slower one takes {abs(more):.0%} {'more' if more > 0 else 'less'}: a constant load "
        "is paid for longer, losses that grow with speed are smaller"
    )
    if folder is not None:
        draw(diagnosis, unseen, folder)


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else None)
