"""What a physics engine hides, found without being told.

    python examples/diagnose_engine.py FOLDER [SCENARIO]

FOLDER holds drives of a robot in a physics engine that uses no equation of the model:
``SCENARIO_sSEED_ident.csv.gz`` to learn from, ``..._valid.csv.gz`` to judge by, and a side-car
``.json`` that names the hidden effect. The diagnosis never sees the side-car. For drives of your
own simulator write the same columns: t, v_left, v_right, p_left, p_right, x, y, yaw, yaw_rate.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import energyplan as ep


def main(folder: Path, chosen: str | None) -> None:
    """Diagnose every scenario of the folder, or one."""
    drives = sorted(folder.glob(f"{chosen or '*'}_s*_ident.csv.gz"))
    if not drives:
        sys.exit(f"{folder} holds no drive {chosen or 'SCENARIO'}_sSEED_ident.csv.gz")
    for ident in drives:
        stem = ident.name.removesuffix("_ident.csv.gz")
        # The vehicle file is all that the diagnosis knows beside the logs.
        vehicle = ep.Vehicle.preset("quadriga" if "empty" in stem else "quadriga:full")
        train = ep.DriveLog.read(ident)
        unseen = ep.DriveLog.read(folder / f"{stem}_valid.csv.gz")
        diagnosis = ep.diagnose(train, holdout=unseen, vehicle=vehicle)
        hidden = json.loads((folder / f"{stem}_ident.json").read_text())["effects"]
        print(f"\n{stem}, which hides {hidden or 'nothing'}")
        for effect in diagnosis.effects:
            more = ", ".join(f"{name} {value:.3g}" for name, value in effect.details.items())
            rivals = f", or {' or '.join(effect.rivals)}" if effect.rivals else ""
            print(
                f"  {effect.name}{rivals}: {effect.symbol} = {effect.value:.4g} "
                f"+- {effect.std_error:.2g} {effect.unit}" + (f" ({more})" if more else "")
            )
        print(
            f"  hold-out: rmse {diagnosis.before.rmse:.1f} W before, "
            f"{diagnosis.after.rmse:.1f} W after; "
            f"energy {100 * diagnosis.before.energy_error:+.2f} % before, "
            f"{100 * diagnosis.after.energy_error:+.2f} % after"
        )


if __name__ == "__main__":
    if len(sys.argv) not in (2, 3):
        sys.exit(__doc__)
    main(Path(sys.argv[1]), sys.argv[2] if len(sys.argv) == 3 else None)
