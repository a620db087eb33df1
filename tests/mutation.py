"""How many changes of the numerical core do the tests notice? Meant for the night.

Each module is changed in some places, one at a time (an operator, a comparison, a number), in a
copy of the checkout, and the tests of its package that reach the changed function are run, quick
ones first. A change that no test notices survives: it is printed with its difference. `make mutate`
runs it.

Tests are given processor time, not time by the clock, so that a loaded machine finds what an idle
one finds. Tests that are cut off decide nothing: their change is counted as cut, not as noticed.

Some places are not changed, and how many they are is printed by rule: annotations, what is written
into an error, decorators that only make a function faster, and whether `zip` watches over lengths,
which differ only by a fault of the program; texts compared by the alphabet, and `is` in place of
`==`, as nobody would. No change is left out of the score because it seems to mean the same: whether
a survivor changes only the work or the rounding is for its reader to judge.

`--killed FILE` adds what was noticed to a list, and `--recheck FILE` makes those changes again
wherever their lines still stand, also in another module, and names those that no test notices any
more: so tests can be deleted. That needs no cosmic-ray.
"""

from __future__ import annotations

import argparse
import ast
import cProfile
import json
import math
import os
import random
import re
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import suppress
from difflib import unified_diff
from fnmatch import fnmatch
from itertools import accumulate
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import pytest

if TYPE_CHECKING:
    from cosmic_ray.work_item import MutationSpec

ROOT = Path(__file__).resolve().parents[1]
TESTS = {
    "power": "tests/power", "vehicle": "tests/test_vehicle.py tests/power/test_tables.py",
    "cost": "tests/cost tests/limits/test_chain.py tests/steering",
    "steering": "tests/steering", "planning/bound": "tests/planning/test_bound.py",
    "fit": "tests/fit tests/diagnosis/test_one_core.py tests/diagnosis/test_probabilities.py "
           "tests/diagnosis/test_both_sides.py tests/diagnosis/test_adequacy.py",
    "diagnosis": "tests/diagnosis", "mission": "tests/mission", "limits": "tests/limits",
    "battery": "tests/battery",
}  # fmt: skip
"""What is changed, below the package, and the tests that should notice."""

ALWAYS = "tests/docs/test_conventions.py::test_data_are_frozen"
"""A test that should notice changes of any part."""

SLOWER = 2.0
"""How much more processor time the tests of a change may take than without it."""

STARTING = 30.0
"""Processor time that the tests of a change may take besides [s]."""

COMPILING = 90.0
"""Processor time that they may take besides where a kernel is changed: it is compiled anew [s]."""

WAITING = 20.0
"""Time by the clock after which tests are cut that wait, in units of their processor time."""

RECHECKING = 600.0
"""Processor time that the tests of a package may take in a recheck [s]."""

OUTCOME = "outcome.txt"
"""What the tests of a change print, in the copy."""

NOTICED, CUT, SURVIVED = "noticed", "cut off", "not noticed"
"""What may become of a change."""


UNSEEN = ("_Eq_Is$", "_NotEq_IsNot$", "_Is_Eq$", "_IsNot_NotEq$")
"""Operators that mean the same for what they are used for here: short names and None."""

ORDER = ("_Lt", "_LtE", "_Gt", "_GtE")
"""Operators that nobody would write for equality of a text: they hold or not by the alphabet."""

FASTER = {"njit", "inner", "lru_cache", "cache"}
"""Decorators without which all is as before, and slower."""

COMPILED = {"njit", "inner"}
"""Decorators of what runs as machine code, where no profiler sees it."""

Span = tuple[tuple[int, int], tuple[int, int]]
"""Where a piece of source begins and ends: line and column."""


class Score(NamedTuple):
    """What became of the changes of a module."""

    module: str
    became: Counter[str]
    spared: Counter[str]

    def __str__(self) -> str:
        spared = ", ".join(f"{count} {rule}" for rule, count in sorted(self.spared.items()))
        return f"{self.module}: {_told(self.became)}; places spared: {spared or 'none'}"


def _told(became: Counter[str]) -> str:
    """Return how many changes were noticed, of how many, and what became of the others."""
    tried = became.total()
    others = "".join(f", {became[end]} {end}" for end in (SURVIVED, CUT))
    return f"{became[NOTICED]} of {tried} noticed ({became[NOTICED] / max(tried, 1):.0%}){others}"


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


class Killed(NamedTuple):
    """A change that a test noticed; lines are without their indentation."""

    module: str
    function: str  # the innermost one around it, "" outside of all
    nth: int  # of the places in the function that read like this one, from 0
    before: list[str]
    after: list[str]
    operator: str
    test: str  # the file whose test noticed it first


def _functions(source: str) -> list[str]:
    """Return for each line the name of the innermost function around it."""
    names = [""] * (len(source.split("\n")) + 1)
    for node in ast.walk(ast.parse(source)):  # outer ones come first
        if isinstance(node, ast.FunctionDef):
            lines = range(node.lineno - 1, node.end_lineno or node.lineno)
            names[lines.start : lines.stop] = [node.name] * len(lines)
    return names


def _places(source: str, before: Sequence[str]) -> list[tuple[int, str]]:
    """Return where these lines stand in a source, and in which function."""
    lines, names = [line.strip() for line in source.split("\n")], _functions(source)
    return [
        (start, names[start])
        for start in range(len(lines) - len(before) + 1)
        if lines[start : start + len(before)] == list(before)
    ]


def killed_by(module: str, before: str, after: str, operator: str, test: str) -> Killed | None:
    """Describe a change by its lines; None if it adds lines or takes lines away alone."""
    old, new = before.split("\n"), after.split("\n")
    first = next(i for i, (a, b) in enumerate(zip(old, new, strict=False)) if a != b)
    last = next(i for i, (a, b) in enumerate(zip(old[::-1], new[::-1], strict=False)) if a != b)
    gone = [line.strip() for line in old[first : len(old) - last]]
    come = [line.strip() for line in new[first : len(new) - last]]
    function = _functions(before)[first]
    alike = [start for start, name in _places(before, gone) if name == function]
    return (
        Killed(module, function, alike.index(first), gone, come, operator, test)
        if gone and come
        else None
    )


def find_again(change: Killed, sources: dict[str, str]) -> tuple[str, str] | None:
    """Return the module in which the lines of a change still stand, and its source with it made.

    They are looked for in the same function of the same module, in a function of that name in any
    module, and anywhere if they stand in one place only.
    """
    found = [
        (module, start, name)
        for module, source in sources.items()
        if all(line in source for line in change.before)
        for start, name in _places(source, change.before)
    ]
    same = [one for one in found if one[0] == change.module and one[2] == change.function]
    named = [one for one in found if one[2] == change.function]
    if len(same) > change.nth:
        chosen = same[change.nth]
    elif len(named) == 1 or len(found) == 1:
        chosen = (named or found)[0]
    else:
        return None
    module, start, _ = chosen
    lines = sources[module].split("\n")
    stop = start + len(change.before)
    indents = [len(line) - len(line.lstrip()) for line in lines[start:stop]]
    indents += indents[-1:] * (len(change.after) - len(indents))
    made = [" " * indent + line for indent, line in zip(indents, change.after, strict=False)]
    return module, "\n".join(lines[:start] + made + lines[stop:])


def _first_failed() -> str:
    """Return the file of the test that failed, as the tests of the last change printed it."""
    printed = Path(OUTCOME).read_text(encoding="utf-8", errors="replace")
    found = re.search(r"^(?:FAILED|ERROR) ([^:\s]+)", printed, re.MULTILINE)
    return found[1] if found else ""


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
) -> list[Reach]:
    """Return the tests to run where this place is changed, quick ones first.

    They are those that call the function; all where none is seen to: outside of functions, and in
    kernels, of which only a test that calls the Python that they were made from is seen.
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
        compiled = {ast.unparse(d).split("(")[0] for d in outer.decorator_list} & COMPILED
        if not compiled:
            chosen = [reach for reach in reaches if f"{file}:{line}" in reach.calls] or reaches
    return sorted(chosen, key=lambda reach: reach.took)


def try_tests(command: Sequence[str], allowed: float) -> str:
    """Run tests with so much processor time [s]; return whether one noticed the change.

    A failure decides only within this time, as a process of the tests may have been cut off too.
    """

    def limited() -> None:
        seconds = math.ceil(allowed)
        resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds + 5))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))

    # bytecode of one change may be as old as the source of the next
    environment = {**os.environ, "PYTHONDONTWRITEBYTECODE": "1"}
    with Path(OUTCOME).open("wb") as printed:
        tests = subprocess.Popen(
            command,
            env=environment,
            stdout=printed,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
            preexec_fn=limited,
        )
    waits = threading.Timer(WAITING * allowed, os.killpg, [tests.pid, signal.SIGKILL])
    waits.start()
    _, status, used = os.wait4(tests.pid, 0)
    waits.cancel()
    tests.returncode = ended = os.waitstatus_to_exitcode(status)
    with suppress(ProcessLookupError):
        os.killpg(tests.pid, signal.SIGKILL)  # what the tests began and left
    if ended == pytest.ExitCode.OK:
        return SURVIVED
    within = used.ru_utime + used.ru_stime < allowed
    decided = ended != pytest.ExitCode.NO_TESTS_COLLECTED and ended != -signal.SIGKILL
    return NOTICED if within and decided else CUT


def _rule(mutation: MutationSpec, silent: list[Span], texts: list[Span]) -> str | None:
    """Return the rule by which a place is not changed, if any."""
    place, name = mutation.start_pos, f"{mutation.operator_name}$"
    if any(word in name for word in UNSEEN):
        return "is for =="
    if any(a <= place < b for a, b in silent):
        return "without effect"
    if mutation.operator_name.endswith(ORDER) and any(a <= place < b for a, b in texts):
        return "text by the alphabet"
    return None


def try_module(
    copy: Path,
    module: Path,
    reaches: list[Reach],
    mutations: int,
    seed: int,
    killed: Path | None = None,
    at_most: float = math.inf,
) -> Score:
    """Change a module of a copy in some places; print those that no test notices.

    The tests of a change take `at_most` so much processor time [s]: the quick ones are run.
    """
    from cosmic_ray.commands.init import _all_work_items
    from cosmic_ray.mutating import use_mutation
    from cosmic_ray.plugins import get_operator

    os.chdir(copy)
    before = module.read_text(encoding="utf-8")
    tree = ast.parse(before)
    silent, texts = _silent(tree), _texts(tree)
    besides = STARTING + COMPILING * any(word in before for word in ("@njit", "@inner"))
    places = [item.mutations[0] for item in _all_work_items([module], {})]
    rules = [_rule(place, silent, texts) for place in places]
    wanted = [place for place, rule in zip(places, rules, strict=True) if rule is None]
    score = Score(str(module), Counter(), Counter(rule for rule in rules if rule is not None))
    for place in random.Random(f"{seed} {module}").sample(wanted, min(mutations, len(wanted))):
        tests = _tests_of(place.start_pos, copy / module, tree, reaches)
        total = list(accumulate(test.took for test in tests))
        tests = tests[: max(sum(took <= at_most for took in total), 1)]
        Path("tests.txt").write_text("\n".join(test.test for test in tests), encoding="utf-8")
        # what noticed the last change is tried first
        command = [sys.executable, "-m", "pytest", "-x", "-q", "--failed-first", "@tests.txt"]
        with use_mutation(place.module_path, get_operator(place.operator_name)(), place.occurrence):
            after = module.read_text(encoding="utf-8")
            end = try_tests(command, besides + SLOWER * sum(test.took for test in tests))
        score.became[end] += 1
        if end == NOTICED and killed is not None:
            name, operator = str(module), place.operator_name
            change = killed_by(name, before, after, operator, _first_failed())
            if change is not None:
                with killed.open("a", encoding="utf-8") as out:
                    out.write(json.dumps(change._asdict()) + "\n")
        if end != NOTICED:
            lines = unified_diff(before.split("\n"), after.split("\n"), lineterm="")
            print(f"{end}: {module}\n" + "\n".join([*lines][2:]) + "\n", flush=True)
    return score


def recheck(copy: Path, listed: Path, patterns: Sequence[str]) -> bool:
    """Make listed changes again where their lines still stand; return whether all are noticed."""
    os.chdir(copy)
    became: Counter[str] = Counter()
    for line in listed.read_text(encoding="utf-8").splitlines():
        change = Killed(**json.loads(line))
        if not any(fnmatch(change.module, f"energyplan/{pattern}*") for pattern in patterns):
            continue
        modules = [str(file) for file in sorted(Path("energyplan").rglob("*.py"))]
        sources = {name: Path(name).read_text(encoding="utf-8") for name in modules}
        found = find_again(change, sources)
        if found is None:
            became["gone"] += 1
            continue
        module, after = found
        part = next((p for p in TESTS if f"{module}/".startswith(f"energyplan/{p}")), None)
        tests = [[change.test], [*TESTS[part].split(), ALWAYS] if part else ["tests"]]
        Path(module).write_text(after, encoding="utf-8")
        ends = []
        for files in tests:
            files = [file for file in files if Path(file.split("::")[0]).exists()]
            if files and NOTICED not in ends:
                command = [sys.executable, "-m", "pytest", "-x", "-q", *files]
                ends.append(try_tests(command, RECHECKING))
        Path(module).write_text(sources[module], encoding="utf-8")
        end = NOTICED if NOTICED in ends else CUT if CUT in ends else SURVIVED
        became[end] += 1
        if end != NOTICED:
            lines = "\n".join([f"-{line}" for line in change.before])
            lines += "\n" + "\n".join([f"+{line}" for line in change.after])
            print(
                f"{end}: {module}, {change.function}, once by {change.test}\n{lines}\n", flush=True
            )
    gone = became.pop("gone", 0)
    print(f"{_told(became)}; lines of {gone} more stand nowhere any longer")
    return became.total() == became[NOTICED]


def main(arguments: Sequence[str] | None = None) -> None:
    """Run it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("modules", nargs="*", default=["*"], help="such as power or fit/icr.py")
    parser.add_argument("--mutations", type=int, default=25, help="changes a module")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--killed", type=Path, help="add the changes that are noticed to this list")
    parser.add_argument("--recheck", type=Path, help="only make the changes of this list again")
    parser.add_argument(
        "--at-most", type=float, default=math.inf, help="processor time of a change's tests [s]"
    )
    parser.add_argument("--record", type=Path, help=argparse.SUPPRESS)
    asked = parser.parse_args(arguments)
    if asked.record:
        sys.exit(_record(asked.record, asked.modules))
    killed, listed = (file and file.resolve() for file in (asked.killed, asked.recheck))
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "checkout"
        data = ROOT.parent / "shared"
        if data.is_dir():
            (Path(folder) / "shared").symlink_to(data, target_is_directory=True)
        left_out = shutil.ignore_patterns(".git", ".venv", "build", "dist", "demo", "__pycache__")
        shutil.copytree(ROOT, copy, ignore=left_out)
        os.environ["PYTHONPATH"] = str(copy)
        if listed:
            sys.exit(not recheck(copy, listed, asked.modules))
        scores = []
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
            reaches = _reaches(copy, f"{tests} {ALWAYS}") if asked_for else []
            for module in asked_for:
                scores.append(
                    try_module(
                        copy, module, reaches, asked.mutations, asked.seed, killed, asked.at_most
                    )
                )
                print(scores[-1], flush=True)
    print(f"in all {_told(sum((score.became for score in scores), Counter()))}")


if __name__ == "__main__":
    main()
