"""How many changes of the numerical core do the tests notice? Meant for the night.

cosmic-ray changes each module in ten places, one at a time (an operator, a comparison, a number),
in a copy of the checkout, and the tests of the module's part run. `make mutate` prints the changes
that no test notices; `make mutate MUTATE="--record power"` writes what became of them to
`mutants.json`, and `--recheck` fails where the tests notice fewer than eight of the ten changes of
a module that is recorded.

A seed chooses the ten: by a digest of the seed and of the changed line, so that an edit elsewhere
in the module leaves them as they are. Tests that are cut off decide nothing: their change is not
counted as noticed. Some places are never changed: annotations, what is written into an error,
decorators that only make a function faster, whether `zip` compares lengths, which differ only by a
fault of the program; texts compared by the alphabet, and `is` in place of `==`, as nobody would. No
change is left out because it seems to mean the same: that is for its reader to judge.
"""

from __future__ import annotations

import argparse
import ast
import hashlib
import json
import math
import os
import re
import resource
import shlex
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import suppress
from fnmatch import fnmatch
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

from energyplan.compilation import FOLDER_VARIABLE, cache_folder

if TYPE_CHECKING:
    from cosmic_ray.work_item import MutationSpec

ROOT = Path(__file__).resolve().parents[1]
TESTS = {
    "motion.py": "tests/test_motion.py tests/limits/test_speed.py",
    "path.py": "tests/test_path.py tests/io",
    "vehicle.py": "tests/test_vehicle.py tests/power/test_tables.py",
    "battery": "tests/battery", "power": "tests/power", "steering": "tests/steering",
    "cost": "tests/cost tests/limits/test_chain.py tests/steering",
    "planning/bound": "tests/planning/test_bound.py", "limits": "tests/limits",
    "fit": "tests/fit tests/diagnosis/test_one_core.py tests/diagnosis/test_both_sides.py "
           "tests/diagnosis/test_adequacy.py",
    "diagnosis": "tests/diagnosis", "mission": "tests/mission",
}  # fmt: skip
"""What is changed, below the package, and the tests that should notice."""

ALWAYS = "tests/docs/test_conventions.py::test_data_are_frozen"
"""A test that should notice changes of any part."""

PYTEST = sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider"

RECORD = Path(__file__).with_name("mutants.json")
"""By module: the seed, and for each change the test that noticed it, empty where none did."""

CHANGES, LEAST = 10, 8
"""Changes a module, and how many of them the tests must notice."""

SLOWER, COMPILING = 2.0, 120.0
"""Processor time that the tests of a change may take: so many times what they take without it, and
so much more [s], for kernels that are compiled anew."""

WAITING = 20.0
"""Time by the clock after which tests are cut off that wait, in units of that time."""

UNSEEN = ("_Eq_Is", "_NotEq_IsNot", "_Is_Eq", "_IsNot_NotEq")
"""Operators that mean the same for what they are used for here: short names and None."""

ORDER = ("_Lt", "_LtE", "_Gt", "_GtE")
"""Operators that nobody would write for equality of a text: they hold or not by the alphabet."""

FASTER = {"njit", "inner", "lru_cache", "cache"}
"""Decorators without which all is as before, and slower."""


def modules(patterns: Sequence[str], root: Path = ROOT) -> Iterator[tuple[str, str]]:
    """Yield the modules that match, below the package, and the tests of each."""
    for part, tests in TESTS.items():
        place = root / "energyplan" / part
        files = [place] if place.is_file() else sorted(place.rglob("*.py"))
        if not files:
            sys.exit(f"energyplan/{part} has no modules; correct TESTS in tests/mutation.py")
        for file in files:
            name = file.relative_to(root / "energyplan").as_posix()
            if any(fnmatch(name, f"{pattern}*") for pattern in patterns):
                yield name, tests


def _silent(tree: ast.Module) -> Iterator[tuple[ast.AST | None, bool]]:
    """Yield the places where a change has no effect, and comparisons of texts (second is true)."""
    for node in ast.walk(tree):
        match node:
            case ast.Raise() | ast.If(test=ast.Name(id="TYPE_CHECKING")):
                yield node, False
            case ast.AnnAssign() | ast.arg():
                yield node.annotation, False
            case ast.FunctionDef():
                yield node.returns, False
                for each in node.decorator_list:
                    if FASTER & set(ast.unparse(each).split("(")):
                        yield each, False
            case ast.Call(func=ast.Name(id="zip")):
                yield from ((keyword.value, False) for keyword in node.keywords)
            case ast.Compare():
                sides = [node.left, *node.comparators]
                if any(isinstance(s, ast.Constant) and isinstance(s.value, str) for s in sides):
                    yield node, True


def chosen(module: Path, seed: int, count: int = CHANGES) -> dict[str, MutationSpec]:
    """Return the changes of a module that a seed chooses, by what they are."""
    from cosmic_ray.commands.init import _all_work_items

    source = module.read_text(encoding="utf-8")
    lines, places = source.split("\n"), list(_silent(ast.parse(source)))
    found: dict[str, MutationSpec] = {}
    for item in _all_work_items([module], {}):
        change = item.mutations[0]
        name, (row, column) = change.operator_name, change.start_pos
        inside = [
            texts
            for node, texts in places
            if isinstance(node, ast.expr | ast.stmt)
            and (node.lineno, node.col_offset - 1) <= (row, column)
            and (row, column) < (node.end_lineno or 0, node.end_col_offset or 0)
        ]
        if name.endswith(UNSEEN) or False in inside or (inside and name.endswith(ORDER)):
            continue
        line = lines[row - 1]
        what = f"{change.definition_name or ''}: {line.strip()} @{column - line.find(line.strip())}"
        key = what = f"{what} {name.removeprefix('core/')}"
        while key in found:  # the same line again in the same function
            key += "'"
        found[key] = change
    ranked = sorted(found, key=lambda key: hashlib.sha256(f"{seed} {key}".encode()).digest())
    return {key: found[key] for key in ranked[:count]}


def _processor_time() -> float:
    """Return the processor time that processes started here, and ended, have taken [s]."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


@cache
def _unchanged(tests: str) -> tuple[frozenset[str], float]:
    """Return the tests of a part that pass without a change, and the time for those of one [s]."""
    begun = _processor_time()
    command = [*PYTEST, "-vv", *tests.split(), ALWAYS]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        sys.exit(f"these tests fail without a change: {tests}\n{done.stdout[-3000:]}")
    passed = re.findall(r"^(\S.*) PASSED", done.stdout, re.MULTILINE)
    return frozenset(passed), SLOWER * (_processor_time() - begun) + COMPILING


def noticed_by(change: MutationSpec, tests: Sequence[str], allowed: float) -> tuple[str, str]:
    """Return the test that notices a change, empty where none does in time, and the difference.

    Processes of the tests are cut off too, so what fails after that time decides nothing.
    """
    from cosmic_ray.mutating import mutate_and_test
    from cosmic_ray.work_item import TestOutcome

    limited = "sh", "-c", 'ulimit -t "$0"; exec "$@"', str(math.ceil(allowed))
    begun = _processor_time()
    command = shlex.join([*limited, *PYTEST, "-x", *tests])
    result = mutate_and_test([change], command, WAITING * allowed)
    cut_off = result.output == "timeout" or _processor_time() - begun >= allowed
    if result.test_outcome is TestOutcome.INCOMPETENT or result.diff is None:
        sys.exit(f"{change.module_path}: the change could not be made\n{result.output}")
    difference = str(result.diff).partition("\n@@")[2].partition("\n")[2]
    if result.test_outcome is TestOutcome.SURVIVED:
        return "", difference
    if cut_off:
        return "", f"cut off after {allowed:.0f} s of processor time\n{difference}"
    failed = re.search(r"^(?:FAILED|ERROR) (.*?)(?: - .*)?$", str(result.output), re.MULTILINE)
    return failed[1] if failed else "a crash", difference


def try_module(name: str, tests: str, record: dict[str, str], seed: int) -> dict[str, str]:
    """Change a module in some places; print what no test notices and return what became of each."""
    (there, allowed), became = _unchanged(tests), dict[str, str]()
    for key, change in chosen(Path("energyplan") / name, seed).items():
        first = record.get(key, "")
        hint, by = [first] if first in there else [], ""
        if hint:
            by, difference = noticed_by(change, hint, allowed)
        if not by:
            by, difference = noticed_by(change, [*tests.split(), ALWAYS], allowed)
        became[key] = by
        if not by:
            print(f"not noticed: {name}, {key}\n{difference}\n", flush=True)
    print(f"{name}: {sum(map(bool, became.values()))} of {len(became)} noticed", flush=True)
    return became


def main(arguments: Sequence[str] | None = None) -> None:
    """Run it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("modules", nargs="*", default=["*"], help="such as power or fit/icr.py")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--record", action="store_true", help="write what became of the changes")
    parser.add_argument("--recheck", action="store_true", help="fail where a record is not kept")
    given = parser.parse_args(arguments)
    if not (names := list(modules(given.modules))):
        parser.error(f"no module of the numerical core is called {' or '.join(given.modules)}")
    known = json.loads(RECORD.read_text(encoding="utf-8"))
    few, unknown = list[str](), list[str]()
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "checkout"
        data = ROOT.parent / "shared"
        if data.is_dir():
            (Path(folder) / "shared").symlink_to(data, target_is_directory=True)
        left_out = shutil.ignore_patterns(
            ".git", ".venv", "build", "dist", "demo", "__pycache__", ".kernels"
        )
        shutil.copytree(ROOT, copy, ignore=left_out)
        os.chdir(copy)
        os.environ["PYTHONPATH"] = str(copy)
        # machine code of changed kernels is of no use to anybody else
        kernels, kept = Path(folder) / "kernels", cache_folder()
        if kept.is_dir():
            with suppress(shutil.Error):  # what another process is writing is compiled anew
                shutil.copytree(kept, kernels)
        os.environ[FOLDER_VARIABLE] = str(kernels)
        for name, tests in names:
            if given.recheck and name not in known:
                unknown.append(name)
                continue
            before = known.get(name, {"seed": given.seed, "changes": {}})
            seed = before["seed"] if given.recheck else given.seed
            became = try_module(name, tests, before["changes"], seed)
            if sum(map(bool, became.values())) < min(LEAST, len(became)):
                few.append(name)
            if given.record:
                known[name] = {"seed": seed, "changes": became}
                text = json.dumps(dict(sorted(known.items())), indent=1) + "\n"
                RECORD.write_text(text, encoding="utf-8")
    if unknown:
        print(f"not recorded yet: {', '.join(unknown)}")
    if few:
        sys.exit(f"fewer than {LEAST} of {CHANGES} changes were noticed in {', '.join(few)}")


if __name__ == "__main__":
    main()
