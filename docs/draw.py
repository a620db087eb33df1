"""Draw the pictures of the examples in the gallery: ``python docs/draw.py``."""

from __future__ import annotations

import runpy
import sys
from pathlib import Path

from energyplan.io.mission import read_mission
from energyplan.mission import evaluate
from energyplan.output import plots
from energyplan.output.plots import png

HERE = Path(__file__).resolve().parent
IMAGES, EXAMPLES = HERE / "images", HERE.parent / "examples"


def example(name: str, folder: Path, *options: str) -> None:
    """Run an example as its first lines say."""
    sys.argv = [name, *options, str(folder)]
    runpy.run_path(str(EXAMPLES / name), run_name="__main__")


def main() -> None:
    """Draw all of them."""
    example("iso_energy.py", IMAGES)
    example("motor_limits.py", IMAGES)
    example("plan_hill.py", IMAGES, "--out")
    orchard = evaluate(read_mission(EXAMPLES / "mission_orchard.yaml"))
    (IMAGES / "mission_orchard.png").write_bytes(png(plots.mission_map(orchard)))


if __name__ == "__main__":
    main()
