"""How many changes of the package do the tests notice? Meant for the night.

cosmic-ray changes each module in ten places, one at a time (an operator, a comparison, a number),
in a copy of the checkout, and tests run that execute the changed line. `make mutate` prints the
changes that no test notices; `make mutate MUTATE="--record power"` writes what became of them to
`mutants.json`. `--recheck` fails where a module is not recorded, or where the tests notice fewer
than eight of its ten changes.

A seed chooses the ten: by a digest of the seed and of the changed line, so that an edit elsewhere
in the module leaves them as they are. Tests that are cut off decide nothing: their change is not
counted as noticed. Some places are never changed: annotations, what is written into an error,
decorators that only make a function faster, whether `zip` compares lengths, which differ only by a
fault of the program; texts compared by the alphabet, and `is` in place of `==`, as nobody would. No
change is left out because it seems to mean the same: that is for its reader to judge.

`--executed` first runs the suite once and keeps which tests execute which line, so that a change is
tried against these alone, the quickest first; `--executed tests/io` runs those tests, and adds them
to what is kept. Without either, a change is tried against the tests of its part. All tests are
collected once. A change inside a function is tried in a fork of that process, which receives the
function's new code; others, and changes of kernels, in a new process.
"""

from __future__ import annotations

import argparse
import ast
import difflib
import gc
import hashlib
import json
import os
import re
import resource
import runpy
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import suppress
from fnmatch import fnmatch
from inspect import CO_OPTIMIZED
from itertools import accumulate, islice
from pathlib import Path
from types import CodeType, FunctionType
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from cosmic_ray.work_item import MutationSpec

ROOT = Path(__file__).resolve().parents[1]

TESTS = {
    "motion": "tests/limits/test_speed.py", "path": "tests/io", "vehicle": "tests/power",
    "compilation": "tests/test_compilation.py tests/docs/test_packages.py", "html": "tests/output",
    "records": "tests/io tests/test_ranges_of_numbers.py tests/test_kinds.py", "errors": "tests/io",
    "sources": "tests/test_compilation.py", "cost": "tests/cost tests/limits tests/steering",
    "fit": "tests/fit tests/diagnosis", "battery": "tests/battery tests/mission",
    "output": "tests/output tests/cli tests/golden", "cli": "tests/cli tests/golden",
    "serve": "tests/serve tests/io/test_doors.py", "terrain": "tests/terrain tests/planning",
}  # fmt: skip
"""Tests of a part of the package besides `tests/PART` and `tests/test_PART.py`."""

ALWAYS = "tests/docs/test_conventions.py::test_data_are_frozen"
"""A test that reads the source of every module: it executes none of them."""

PYTEST = sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider"

RECORD = Path(__file__).with_name("mutants.json")
"""By module: the seed, and for each change the test that noticed it, empty where none did."""

EXECUTED = ROOT / "build" / "executed.json"
"""Which tests execute which line, and the processor time of each [s]."""

CHANGES, LEAST = 10, 8
"""Changes a module, and how many of them the tests must notice."""

FIRST, ENOUGH = 12, 20.0
"""Tests that a change is tried against at first, and processor time of those that follow [s]."""

SLOWER, STARTING, COMPILING = 2.0, 20.0, 120.0
"""Processor time that the tests of a change may take: so many times what they take without it, and
so much more [s]; for kernels, that are compiled anew, the latter."""

WAITING = 20.0
"""Time by the clock after which tests are cut off that wait, in units of that time."""

UNSEEN = ("_Eq_Is", "_NotEq_IsNot", "_Is_Eq", "_IsNot_NotEq")
"""Operators that mean the same for what they are used for here: short names and None."""

ORDER = ("_Lt", "_LtE", "_Gt", "_GtE")
"""Operators that nobody would write for equality of a text: they hold or not by the alphabet."""

FASTER = {"njit", "inner", "lru_cache", "cache"}
"""Decorators without which all is as before, and slower."""


def modules(patterns: Sequence[str], root: Path = ROOT) -> Iterator[str]:
    """Yield the modules that match, below the package."""
    for file in sorted((root / "energyplan").rglob("*.py")):
        name = file.relative_to(root / "energyplan").as_posix()
        if any(fnmatch(name, f"{pattern}*") for pattern in patterns):
            yield name


def tests_of(module: str, root: Path = ROOT) -> list[str]:
    """Return the files and folders of the tests of a module's part."""
    part = module.partition("/")[0].removesuffix(".py")
    usual = f"tests/{part}", f"tests/test_{part}.py", *TESTS.get(part, "").split()
    return [place for place in dict.fromkeys(usual) if (root / place).exists()] or ["tests/io"]


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
    sound = (key for key in ranked if _compiles(source, found[key]))
    return {key: found[key] for key in islice(sound, count)}


def _compiles(source: str, change: MutationSpec) -> bool:
    """Return whether a changed module is Python: the asterisk among parameters is no operator."""
    from cosmic_ray.mutating import mutate_code
    from cosmic_ray.plugins import get_operator

    operator = get_operator(change.operator_name)(**change.operator_args)
    with suppress(SyntaxError):
        ast.parse(mutate_code(source, operator, change.occurrence))
        return True
    return False


def codes(old: CodeType, new: CodeType) -> Iterator[tuple[CodeType, CodeType] | None]:
    """Yield the functions' codes that differ; None where what is outside of functions does."""
    inside = [
        [const for const in code.co_consts if isinstance(const, CodeType)] for code in (old, new)
    ]
    if old.co_flags & CO_OPTIMIZED:
        if old != new:
            yield old, new
    elif len(inside[0]) != len(inside[1]) or _own(old) != _own(new):
        yield None
    for pair in zip(*inside, strict=False):
        yield from codes(*pair)


def _own(code: CodeType) -> tuple[object, ...]:
    """Return what a code does without the functions that it defines."""
    consts = [const for const in code.co_consts if not isinstance(const, CodeType)]
    return code.co_code, code.co_names, repr(consts)


Tests = dict[str, list[int]]
"""Numbers of the tests that execute a line, or call a kernel."""


class Executed:
    """Which tests execute a line or call a kernel, and how long they take."""

    def __init__(self, found: Mapping[str, Any]) -> None:
        self.times: dict[str, float] = found.get("times", {})
        self.names = list(self.times)
        self.lines: dict[str, Tests] = found.get("lines", {})
        self.kernels: Tests = found.get("kernels", {})

    @classmethod
    def read(cls) -> Executed:
        """Return what is kept."""
        return cls(json.loads(EXECUTED.read_text("utf-8")) if EXECUTED.is_file() else {})

    def add(self, other: Executed) -> None:
        """Add what other tests execute, in place of what is known of the same tests."""
        old = [name for name in self.names if name not in other.times]
        kept = {self.names.index(name): number for number, name in enumerate(old)} | {-1: -1}
        new = {number: number + len(old) for number in range(len(other.times))} | {-1: -1}

        def joined(known: Tests, added: Tests) -> Tests:
            return {
                place: sorted(
                    {kept[each] for each in known.get(place, []) if each in kept}
                    | {new[each] for each in added.get(place, [])}
                )
                for place in known | added
            }

        self.times = {name: self.times[name] for name in old} | other.times
        self.names = list(self.times)
        self.lines = {
            module: joined(self.lines.get(module, {}), other.lines.get(module, {}))
            for module in self.lines | other.lines
        }
        self.kernels = joined(self.kernels, other.kernels)

    def at(self, module: str, row: int, source: str, kernels: Sequence[str]) -> list[str]:
        """Return the tests of a place in a module, quickest first; -1 stands for an import."""
        lines, tree = self.lines.get(module, {}), ast.parse(source)
        found = {each for kernel in kernels for each in self.kernels.get(kernel, [])}
        begin, end = 1, row
        for node in ast.walk(tree):  # wider statements come first
            if isinstance(node, ast.stmt) and node.lineno <= row <= (node.end_lineno or 0):
                begin, end = node.lineno, node.end_lineno or 0
                body = getattr(node, "body", None)
                if body and not isinstance(node, ast.FunctionDef | ast.ClassDef):
                    end = body[0].lineno - 1 if row < body[0].lineno else end
        for line in range(begin, end + 1):
            found |= set(lines.get(str(line), []))
        if not found - {-1}:
            found = {each for tests in lines.values() for each in tests}
        names = [self.names[each] for each in found if each >= 0]
        return sorted(names, key=lambda name: (self.times[name], name))

    def imported(self, module: str, row: int) -> bool:
        """Return whether a line is executed while modules are imported."""
        return -1 in self.lines.get(module, {}).get(str(row), [])


class Recording:
    """Keeps which tests execute which line or call which kernel, as they run."""

    def __init__(self) -> None:
        from coverage import Coverage

        self.coverage = Coverage(data_file=None, source=["energyplan"], config_file=False)
        self.times, self.kernels = dict[str, float](), dict[str, set[str]]()
        self.test = ""
        self.coverage.start()

    def pytest_configure(self) -> None:
        """Have kernels say that they are called."""
        from energyplan.compilation import CPUDispatcher, Kernel

        def call(kernel: Kernel, *given: object, **options: object) -> object:
            self.kernels.setdefault(kernel.name, set()).add(self.test)
            return CPUDispatcher.__call__(kernel, *given, **options)

        Kernel.__call__ = call  # type: ignore[method-assign]

    @pytest.hookimpl(wrapper=True, tryfirst=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Generator[None, object, object]:
        """Record a test."""
        self.test, begun = item.nodeid, sum(os.times()[:4])
        self.coverage.switch_context(item.nodeid)
        try:
            return (yield)
        finally:
            self.coverage.switch_context("")
            if self.test in self.times:
                self.times[self.test] = round(sum(os.times()[:4]) - begun, 2)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Keep tests that pass alone."""
        if report.when == "call" and report.passed:
            self.times[report.nodeid] = 0.0

    def pytest_unconfigure(self) -> None:
        """Write it."""
        self.coverage.stop()
        number = {name: k for k, name in enumerate(self.times)} | {"": -1}
        data = self.coverage.get_data()
        lines = {
            Path(file).relative_to(Path("energyplan").resolve()).as_posix(): {
                line: sorted(number[test] for test in tests if test in number)
                for line, tests in data.contexts_by_lineno(file).items()
            }
            for file in data.measured_files()
        }
        kernels = {
            name: sorted(number[test] for test in tests if test in self.times)
            for name, tests in self.kernels.items()
        }
        found = Executed.read()
        found.add(Executed({"times": self.times, "lines": lines, "kernels": kernels}))
        EXECUTED.parent.mkdir(exist_ok=True)
        text = json.dumps({"times": found.times, "lines": found.lines, "kernels": found.kernels})
        EXECUTED.write_text(text, encoding="utf-8")


class Trial:
    """Runs tests of a collected suite against changes, in forks."""

    def __init__(self, work: Callable[[Trial], None]) -> None:
        self.work, self.executed, self.pipe = work, Executed.read(), -1
        self.items: dict[str, pytest.Item] = {}
        self.digests: dict[str, str] = {}
        self.functions: dict[tuple[str, str, int], list[FunctionType]] = {}

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        """Do the work in place of running the tests."""
        self.items = {item.nodeid: item for item in session.items}
        gc.unfreeze()
        for function in gc.get_objects():
            if isinstance(function, FunctionType):
                code = function.__code__
                place = code.co_filename, code.co_qualname, code.co_firstlineno
                self.functions.setdefault(place, []).append(function)
        gc.freeze()
        self.digests = digests()
        self.work(self)
        return True

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """End a fork at the first failure."""
        if report.failed and self.pipe >= 0:
            os.write(self.pipe, report.nodeid.encode())
            os._exit(1)

    def replaced(self, path: str, old: str, new: str) -> list[tuple[FunctionType, CodeType]] | None:
        """Return functions and their codes in the changed module; None where that is not enough."""
        from energyplan.compilation import KERNELS

        compiled = {kernel.py_func for kernel in KERNELS.values()}
        found = []
        for pair in codes(*(compile(text, path, "exec", dont_inherit=True) for text in (old, new))):
            if pair is None:
                return None
            place = path, pair[0].co_qualname, pair[0].co_firstlineno
            found += [(function, pair[1]) for function in self.functions.get(place, [])]
        return None if not found or any(f in compiled for f, _ in found) else found

    def run(
        self, tests: Sequence[str], new: Sequence[tuple[FunctionType, CodeType]], allowed: float
    ) -> str | None:
        """Return the test of these that fails, empty if none does, None if they are cut off."""
        items = [self.items[test] for test in tests if test in self.items]
        receiving, sending = os.pipe()
        if (child := os.fork()) == 0:
            with suppress(BaseException):
                os.setsid()
                resource.setrlimit(resource.RLIMIT_CPU, (int(allowed) + 1, int(allowed) + 1))
                empty = os.open(os.devnull, os.O_RDWR)
                for each in (0, 1, 2):
                    os.dup2(empty, each)
                self.pipe = sending
                for function, code in new:
                    function.__code__ = code
                for item, following in zip(items, [*items[1:], None], strict=True):
                    item.ihook.pytest_runtest_protocol(item=item, nextitem=following)
                os._exit(0)
            os._exit(2)
        os.close(sending)
        end, done, status = time.monotonic() + WAITING * allowed, 0, 0
        used = resource.struct_rusage
        while not done and time.monotonic() < end:
            done, status, used = os.wait4(child, os.WNOHANG)
            time.sleep(0.0 if done else 0.01)
        with suppress(ProcessLookupError):
            os.killpg(child, signal.SIGKILL)
        if not done:
            os.wait4(child, 0)
        by = os.read(receiving, 10_000).decode() if done else ""
        os.close(receiving)
        if not done or used.ru_utime + used.ru_stime >= allowed:
            return None
        return by or ("" if status == 0 else tests[0])


def started(tests: Sequence[str], allowed: float) -> str | None:
    """Return as `Trial.run` does, of a new process."""
    begun = _processor_time()
    limit = lambda: resource.setrlimit(resource.RLIMIT_CPU, (int(allowed) + 1,) * 2)  # noqa: E731
    with tempfile.TemporaryFile("w+") as output:
        process = subprocess.Popen(
            [*PYTEST, "-x", *tests], stdout=output, stderr=output, stdin=subprocess.DEVNULL,
            preexec_fn=limit, start_new_session=True,
        )  # fmt: skip
        try:
            code = process.wait(WAITING * allowed)
        except subprocess.TimeoutExpired:
            code = None
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        output.seek(0)
        text = output.read()
    if code is None or _processor_time() - begun >= allowed:
        return None
    if code in (0, pytest.ExitCode.NO_TESTS_COLLECTED):
        return ""
    failed = re.search(r"^(?:FAILED|ERROR) (.*?)(?: - .*)?$", text, re.MULTILINE)
    return failed[1] if failed else tests[0]


def _processor_time() -> float:
    """Return the processor time that processes started here, and ended, have taken [s]."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def digests() -> dict[str, str]:
    """Return the digests of the sources of all kernels, as they lie on disk."""
    anew = runpy.run_path("energyplan/sources.py", run_name="anew")
    return {
        f"{anew['module_of'](file)}.{name}": anew["source_digest"](file, name)
        for file in anew["sources"]()
        for name in anew["kernels_of"](file)
    }


def noticed_by(change: MutationSpec, tests: Sequence[str], trial: Trial) -> tuple[str, str]:
    """Return the test that notices a change, empty where none does in time, and the difference.

    Tests that are given are tried, or else those of the line.
    """
    from cosmic_ray.mutating import use_mutation
    from cosmic_ray.plugins import get_operator

    path, row = Path(change.module_path), change.start_pos[0]
    module = path.relative_to("energyplan").as_posix()
    operator = get_operator(change.operator_name)(**change.operator_args)
    executed = trial.executed
    with use_mutation(path, operator, change.occurrence) as (old, new):
        if new is None:
            sys.exit(f"{path}: the change {change} could not be made")
        lines = difflib.unified_diff(old.split("\n"), new.split("\n"), lineterm="", n=1)
        difference = "\n".join(list(lines)[2:])  # without the names of files
        functions, kernels = trial.replaced(str(path.resolve()), old, new), list[str]()
        if functions is None and module != "sources.py":
            kernels = [name for name, digest in digests().items() if trial.digests[name] != digest]
        elif executed.imported(module, row):
            functions = None
        tests = tests or executed.at(module, row, old, kernels)
        if not tests:
            places = tuple(tests_of(module))
            tests = [name for name in trial.items if name.startswith(places)]
        always = [] if kernels or functions else [ALWAYS]
        tests = [test for test in [*always, *tests] if test in trial.items]
        for part in (tests[:FIRST], _enough(tests[FIRST:], executed.times)):
            if not part:
                continue
            allowed = SLOWER * sum(executed.times.get(test, 1.0) for test in part)
            if functions is None:
                by = started(part, allowed + (COMPILING if kernels else STARTING))
            else:
                by = trial.run(part, functions, allowed + STARTING)
            if by is None:
                return "", f"cut off\n{difference}"
            if by:
                return by, difference
    return "", difference


def _enough(tests: Sequence[str], times: dict[str, float]) -> list[str]:
    """Return the first tests, as many as fit into the time."""
    total = accumulate(times.get(test, 0.0) for test in tests)
    return [test for test, until in zip(tests, total, strict=True) if until <= ENOUGH]


def try_module(
    name: str, trial: Trial, record: dict[str, str], seed: int, recheck: bool
) -> dict[str, str]:
    """Change a module in some places; print what no test notices and return what became of each.

    To see whether enough is noticed still, what no test noticed last time waits until the end.
    """
    changes = chosen(Path("energyplan") / name, seed)
    became = dict.fromkeys(changes, "")
    for key in sorted(changes, key=lambda key: not record.get(key)):
        if recheck and sum(map(bool, became.values())) >= LEAST:
            break
        first, by, difference = record.get(key, ""), "", ""
        if first in trial.items:
            by, difference = noticed_by(changes[key], [first], trial)
        if not by:
            by, difference = noticed_by(changes[key], [], trial)
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
    parser.add_argument(
        "--executed", nargs="?", const="", metavar="TESTS", help="first find what tests execute"
    )
    parser.add_argument("--file", type=Path, default=RECORD, help="of the record")
    given = parser.parse_args(arguments)
    given.file = given.file.resolve()
    if not (names := list(modules(given.modules))):
        parser.error(f"no module is called {' or '.join(given.modules)}")
    known = json.loads(given.file.read_text(encoding="utf-8"))
    missing = [name for name in names if name not in known]
    if given.recheck and missing:
        sys.exit(f"not recorded yet: {', '.join(missing)}; make mutate MUTATE='--record NAME'")
    few = list[str]()

    def work(trial: Trial) -> None:
        for name in names:
            before = known.get(name, {"seed": given.seed, "changes": {}})
            seed = before["seed"] if given.recheck else given.seed
            became = try_module(name, trial, before["changes"], seed, given.recheck)
            if sum(map(bool, became.values())) < min(LEAST, len(became)):
                few.append(name)
            if given.record:
                now = json.loads(given.file.read_text(encoding="utf-8"))
                now[name] = {"seed": seed, "changes": became}
                text = json.dumps(dict(sorted(now.items())), indent=1) + "\n"
                given.file.write_text(text, encoding="utf-8")

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
        os.environ |= {"PYTHONPATH": str(copy), "PYTHONDONTWRITEBYTECODE": "1"}
        sys.path[:] = [str(copy), *(place for place in sys.path if Path(place) != ROOT / "tests")]
        from energyplan.compilation import FOLDER_VARIABLE, cache_folder

        # machine code of changed kernels is of no use to anybody else
        kernels, kept = Path(folder) / "kernels", cache_folder()
        if kept.is_dir():
            with suppress(shutil.Error):  # what another process is writing is compiled anew
                shutil.copytree(kept, kernels)
        os.environ[FOLDER_VARIABLE] = str(kernels)
        if given.executed is not None:
            if not given.executed:
                EXECUTED.unlink(missing_ok=True)
            if (child := os.fork()) == 0:  # the tests of changes need a process without its marks
                quick = ["-q", "-p", "no:cacheprovider", "-m", "not nightly and not slow"]
                places = given.executed.split()
                os._exit(pytest.main([*quick, *places], plugins=[Recording()]))
            os.waitpid(child, 0)
        trial = Trial(work)
        code = pytest.main(["-qq", "-s", "-p", "no:cacheprovider"], plugins=[trial])
    if code != pytest.ExitCode.OK:
        sys.exit(f"the tests cannot be collected: {code!r}")
    if few:
        sys.exit(f"fewer than {LEAST} of {CHANGES} changes were noticed in {', '.join(few)}")


if __name__ == "__main__":
    main()
