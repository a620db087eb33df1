"""How many changes of the numerical core do the tests notice? Meant for the night.

Each module is changed in some places, one at a time (an operator, a comparison, a number), in a
copy of the checkout, and the tests of its package that reach the changed function are run, quick
ones first. A change that no test notices survives: it is printed with its difference. `make mutate`
runs it.

No place is changed where nothing can come of it: annotations, what is written into an error,
decorators that only make a function faster, and whether `zip` watches over lengths, which differ
only by a fault of the program. No text is compared by the alphabet, as nobody would.
"""

from __future__ import annotations

import argparse
import ast
import cProfile
import json
import os
import random
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from fnmatch import fnmatch
from pathlib import Path
from typing import NamedTuple

import pytest
from cosmic_ray.commands.init import _all_work_items
from cosmic_ray.mutating import mutate_and_test
from cosmic_ray.work_item import TestOutcome, WorkerOutcome

ROOT = Path(__file__).resolve().parents[1]
TESTS = {
    "power": "tests/power", "vehicle": "tests/test_vehicle.py tests/power/test_tables.py",
    "cost": "tests/cost tests/limits/test_chain.py tests/steering",
    "steering": "tests/steering", "planning/bound": "tests/planning/test_bound.py",
    "fit": "tests/fit tests/diagnosis/test_one_core.py tests/diagnosis/test_probabilities.py "
           "tests/diagnosis/test_both_sides.py",
    "mission": "tests/mission", "limits": "tests/limits",
}  # fmt: skip
"""What is changed, below the package, and the tests that should notice."""

LONGEST = 300.0
"""Time that the tests of a change may take [s]; longer counts as noticed."""


UNSEEN = ("_Eq_Is$", "_NotEq_IsNot$", "_Is_Eq$", "_IsNot_NotEq$")
"""Operators that mean the same for what they are used for here: short names and None."""

ORDER = ("_Lt", "_LtE", "_Gt", "_GtE")
"""Operators that nobody would write for equality of a text: they hold or not by the alphabet."""

FASTER = {"njit", "inner", "lru_cache", "cache"}
"""Decorators without which all is as before, and slower."""

Span = tuple[tuple[int, int], tuple[int, int]]
"""Where a piece of source begins and ends: line and column."""


class Score(NamedTuple):
    """What became of the changes of a module."""

    module: str
    noticed: int
    tried: int


def _texts(tree: ast.Module) -> list[Span]:
    """Return the comparisons with a text."""
    found: list[ast.AST | None] = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Compare):
            sides = [node.left, *node.comparators]
            if any(isinstance(s, ast.Constant) and isinstance(s.value, str) for s in sides):
                found.append(node)
    return _spans(found)


def _silent(tree: ast.Module) -> list[Span]:
    """Return the places where a change has no effect on what a program computes."""
    found: list[ast.AST | None] = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Raise):
            found.append(node)
        elif isinstance(node, ast.AnnAssign | ast.arg):
            found.append(node.annotation)
        elif isinstance(node, ast.FunctionDef):
            found.append(node.returns)
            found += [d for d in node.decorator_list if FASTER & set(ast.unparse(d).split("("))]
        elif isinstance(node, ast.Call) and ast.unparse(node.func) == "zip":
            found += [keyword.value for keyword in node.keywords]
        elif isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
            found.append(node)
    return _spans(found)


def _spans(nodes: Sequence[ast.AST | None]) -> list[Span]:
    return [
        ((node.lineno, node.col_offset - 1), (node.end_lineno, node.end_col_offset))
        for node in nodes
        if isinstance(node, ast.expr | ast.stmt)
        and node.end_lineno is not None
        and node.end_col_offset is not None
    ]


class Recorder:
    """Notes the functions of the package that each test calls, and how long it takes."""

    def __init__(self) -> None:
        self.tests: list[Reach] = []

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Iterator[None]:
        profile, begun = cProfile.Profile(), time.process_time()
        profile.enable()
        try:
            return (yield)
        finally:
            profile.disable()
            took = time.process_time() - begun
            codes = [entry.code for entry in profile.getstats() if not isinstance(entry.code, str)]
            calls = {f"{Path(c.co_filename)}:{c.co_firstlineno}" for c in codes}
            self.tests.append(Reach(item.nodeid, took, sorted(calls)))


class Reach(NamedTuple):
    """A test, what it takes [s] and what it calls, as file:line."""

    test: str
    took: float
    calls: list[str]


def _reaches(copy: Path, tests: str) -> list[Reach]:
    """Run the tests of a part as they are; return what each of them calls."""
    out = copy / "reached.json"
    asked = [
        sys.executable,
        str(copy / "tests" / "mutation.py"),
        "--record",
        str(out),
        *tests.split(),
    ]
    subprocess.run(asked, cwd=copy, check=True, stdout=subprocess.DEVNULL)
    return [Reach(*test) for test in json.loads(out.read_text(encoding="utf-8"))]


def _record(out: Path, tests: Sequence[str]) -> int:
    recorder = Recorder()
    failed = pytest.main(["-q", "-p", "no:cacheprovider", *tests], plugins=[recorder])
    out.write_text(json.dumps(recorder.tests), encoding="utf-8")
    return int(failed)


def _tests_of(
    place: tuple[int, int], file: Path, tree: ast.Module, reaches: list[Reach]
) -> list[str]:
    """Return the tests to run where this place is changed, quick ones first.

    They are those that call the function; all where none is seen to: outside of functions, and in
    kernels, which run as machine code.
    """
    around = [
        node
        for node in ast.walk(tree)
        if isinstance(node, ast.FunctionDef)
        and (node.lineno, node.col_offset)
        <= place
        <= (node.end_lineno or 0, node.end_col_offset or 0)
    ]
    chosen = reaches
    if around:
        first = min(node.lineno for node in around)
        outer = next(node for node in around if node.lineno == first)
        line = min([first, *(d.lineno for d in outer.decorator_list)])
        chosen = [reach for reach in reaches if f"{file}:{line}" in reach.calls] or reaches
    return [reach.test for reach in sorted(chosen, key=lambda reach: reach.took)]


def try_module(copy: Path, module: Path, reaches: list[Reach], mutations: int, seed: int) -> Score:
    """Change a module of a copy in some places; print those that no test notices."""
    os.chdir(copy)
    tree = ast.parse(module.read_text(encoding="utf-8"))
    silent, texts = _silent(tree), _texts(tree)
    wanted = [
        item
        for item in _all_work_items([module], {})
        if not any(word in f"{item.mutations[0].operator_name}$" for word in UNSEEN)
        and not any(a <= item.mutations[0].start_pos < b for a, b in silent)
        and not (
            item.mutations[0].operator_name.endswith(ORDER)
            and any(a <= item.mutations[0].start_pos < b for a, b in texts)
        )
    ]
    chosen = random.Random(seed).sample(wanted, min(mutations, len(wanted)))
    # what noticed the last change is tried first
    command = f"{sys.executable} -m pytest -x -q --failed-first @tests.txt"
    noticed = 0
    for item in chosen:
        tests = _tests_of(item.mutations[0].start_pos, copy / module, tree, reaches)
        Path("tests.txt").write_text("\n".join(tests), encoding="utf-8")
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
    parser.add_argument("--record", type=Path, help=argparse.SUPPRESS)
    asked = parser.parse_args(arguments)
    if asked.record:
        sys.exit(_record(asked.record, asked.modules))
    scores = []
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "checkout"
        data = ROOT.parent / "shared"
        if data.is_dir():
            (Path(folder) / "shared").symlink_to(data, target_is_directory=True)
        left_out = shutil.ignore_patterns(".git", ".venv", "build", "dist", "demo", "__pycache__")
        shutil.copytree(ROOT, copy, ignore=left_out)
        os.environ["PYTHONPATH"] = str(copy)
        for part, tests in TESTS.items():
            place = Path("energyplan") / part
            files = [file.relative_to(ROOT) for file in sorted((ROOT / place).rglob("*.py"))]
            if not files:
                parser.error(f"{place} has no modules; correct TESTS")
            names = {file: str(file.relative_to("energyplan")) for file in files}
            asked_for = [
                file
                for file in files
                if any(fnmatch(names[file], f"{pattern}*") for pattern in asked.modules)
            ]
            reaches = _reaches(copy, tests) if asked_for else []
            for module in asked_for:
                score = try_module(copy, module, reaches, asked.mutations, asked.seed)
                scores.append(score)
                print(f"{score.module}: {score.noticed} of {score.tried} noticed", flush=True)
    noticed, tried = sum(s.noticed for s in scores), sum(s.tried for s in scores)
    print(f"in all {noticed} of {tried} changes noticed: {100 * noticed / max(tried, 1):.0f} %")


if __name__ == "__main__":
    main()
