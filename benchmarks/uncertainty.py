"""Does the bound of a mission hold as often as it says: ``python benchmarks/uncertainty.py 2000``.

The state of charge at the end of missions that are drawn and simulated (see
tests/mission/uncertain_missions.py) must be above the bound that the report told in 93 to 97 % of
all draws, at 95 %.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from energyplan.mission import evaluate

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "mission"))

from uncertain_missions import missions, simulated

if __name__ == "__main__":
    draws = int(sys.argv[1]) if len(sys.argv) > 1 else 2000
    for name, mission in missions().items():
        report = evaluate(mission)
        ends = simulated(report, draws)
        held = np.mean(ends >= report.soc_end_lower)
        doubt = report.uncertainty[0]
        print(
            f"{name:10s} {100 * held:5.1f} % of {draws} above the bound (93 to 97 are right); "
            f"end {100 * ends.mean():.1f} % (told {100 * report.soc_end:.1f}, at least "
            f"{100 * report.soc_end_lower:.1f}); dearest unknown: {doubt.source} "
            f"{doubt.energy / 3600:.1f} Wh"
        )
