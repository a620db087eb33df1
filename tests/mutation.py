"""How many changes of the numerical core do the tests notice? Meant for the night.

Each module is changed in some places, one at a time (an operator, a comparison, a number), in a
copy of the checkout, and the tests of its package are run. A change that no test notices survives:
it is printed with its difference. `make mutate` runs it.
"""

from __future__ import annotations

import argparse
import os
import random
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from fnmatch import fnmatch
from pathlib import Path
from typing import NamedTuple

from cosmic_ray.commands.init import _all_work_items
from cosmic_ray.mutating import mutate_and_test
from cosmic_ray.work_item import TestOutcome, WorkerOutcome

ROOT = Path(__file__).resolve().parents[1]
TESTS = {
    "power": "tests/power", "vehicle": "tests/test_vehicle.py",
    "cost": "tests/cost tests/limits/test_chain.py",
    "steering": "tests/steering", "planning/bound": "tests/planning/test_bound.py",
    "fit": "tests/fit tests/diagnosis/test_probabilities.py",
    "mission": "tests/mission", "limits": "tests/limits",
}  # fmt: skip
"""What is changed, below the package, and the tests that should notice."""

LONGEST = 900.0
"""Time that the tests of a change may take [s]; longer counts as noticed."""


class Score(NamedTuple):
    """What became of the changes of a module."""

    module: str
    noticed: int
    tried: int


def try_module(copy: Path, module: Path, tests: str, mutations: int, seed: int) -> Score:
    """Change a module of a copy in some places; print those that no test notices."""
    os.chdir(copy)
    items = list(_all_work_items([module], {}))
    # annotations cannot be noticed, and `is` in place of `==` means the same for short names
    unseen = ("BinaryOperator_BitOr", "_Eq_Is$", "_NotEq_IsNot$")
    wanted = [i for i in items if not any(o in f"{i.mutations[0].operator_name}$" for o in unseen)]
    chosen = random.Random(seed).sample(wanted, min(mutations, len(wanted)))
    command = f"{sys.executable} -m pytest -x -q -p no:cacheprovider {tests}"
    noticed = 0
    for item in chosen:
        result = mutate_and_test(item.mutations, command, LONGEST)
        seen = result.test_outcome != TestOutcome.SURVIVED
        noticed += seen and result.worker_outcome == WorkerOutcome.NORMAL
        if not seen:
            sys.stdout.write(f"not noticed:\n{result.diff}\n")
            sys.stdout.flush()
    return Score(str(module), noticed, len(chosen))


def main(arguments: Sequence[str] | None = None) -> None:
    """Run it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("modules", nargs="*", default=["*"], help="such as power or fit/icr.py")
    parser.add_argument("--mutations", type=int, default=25, help="changes a module")
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args(arguments)
    scores = []
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "checkout"
        left_out = shutil.ignore_patterns(".git", ".venv", "build", "dist", "demo", "__pycache__")
        shutil.copytree(ROOT, copy, ignore=left_out)
        os.environ["PYTHONPATH"] = str(copy)
        for part, tests in TESTS.items():
            place = Path("energyplan") / part
            files = sorted((ROOT / place).rglob("*.py"))
            if not files:
                parser.error(f"{place} has no modules; correct TESTS")
            for file in files:
                module = file.relative_to(ROOT)
                name = str(module.relative_to("energyplan"))
                if any(fnmatch(name, f"{pattern}*") for pattern in asked.modules):
                    subprocess.run(
                        [sys.executable, "-m", "pytest", "-q", *tests.split()],
                        cwd=copy, check=True, stdout=subprocess.DEVNULL,
                    )  # fmt: skip
                    score = try_module(copy, module, tests, asked.mutations, asked.seed)
                    scores.append(score)
                    print(f"{score.module}: {score.noticed} of {score.tried} noticed", flush=True)
    noticed, tried = sum(s.noticed for s in scores), sum(s.tried for s in scores)
    print(f"in all {noticed} of {tried} changes noticed: {100 * noticed / max(tried, 1):.0f} %")


if __name__ == "__main__":
    main()
