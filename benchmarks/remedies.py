"""Do the remedies of missions hold when a program applies them: ``python benchmarks/remedies.py``.

Missions are drawn by chance (see tests/mission/troubled_missions.py) until so many remedies were
tried; each must make its task reachable in the whole mission.
"""

from __future__ import annotations

import sys
from collections import Counter
from itertools import count, islice
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "mission"))

from troubled_missions import trials

if __name__ == "__main__":
    wanted = int(sys.argv[1]) if len(sys.argv) > 1 else 200
    tried = list(islice(trials(count()), wanted))
    for trial in tried:
        if not trial.holds:
            print(f"mission {trial.seed}, {trial.task}: {trial.remedy} does not hold")
    kinds = Counter(trial.remedy.kind for trial in tried)
    told = ", ".join(f"{kind} {number}" for kind, number in sorted(kinds.items()))
    print(f"remedies: {sum(trial.holds for trial in tried)} of {len(tried)} hold ({told})")
