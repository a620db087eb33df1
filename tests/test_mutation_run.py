"""Which changes the nightly run makes, what it makes of the tests' answers, and its record."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path

import mutation
import pytest
import yaml

SOURCE = '''
"""A module."""

def f(x: int | None, kind: str) -> int | None:
    if kind == "plain" and x > 1:
        raise ValueError(f"no {x + 1}")
    return x * 2
'''

CHILD = "import subprocess, sys; command = [sys.executable, '-c', 'while True: pass']"
"""A process of the tests that is cut off before they are."""


@pytest.fixture
def module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A module in a folder of its own."""
    pytest.importorskip("cosmic_ray", reason="cosmic-ray is in the nightly group")
    monkeypatch.chdir(tmp_path)
    Path("energyplan").mkdir()
    monkeypatch.syspath_prepend(tmp_path / "energyplan")
    monkeypatch.setenv("PYTHONPATH", "energyplan", os.pathsep)
    monkeypatch.setenv("PYTHONDONTWRITEBYTECODE", "1")
    monkeypatch.setattr(mutation, "digests", dict)
    monkeypatch.setattr(mutation, "EXECUTED", tmp_path / "none.json")
    for name in ("module", "test_it"):
        monkeypatch.delitem(sys.modules, name, raising=False)
    Path("energyplan/module.py").write_text(SOURCE)
    return Path("energyplan/module.py")


def test_what_tests_a_module_exists() -> None:
    """A folder that was renamed is found by day."""
    there = list(mutation.modules(["*"]))
    assert len(there) > 170
    parts = {name.partition("/")[0].removesuffix(".py") for name in there}
    assert set(mutation.TESTS) <= parts
    for file in " ".join(mutation.TESTS.values()).split():
        assert (mutation.ROOT / file).exists()
    assert len(list(mutation.modules(["battery"]))) == 3


def test_the_night_tries_every_module() -> None:
    flow = yaml.safe_load((mutation.ROOT / ".github/workflows/nightly.yml").read_text())
    parts = flow["jobs"]["mutants"]["strategy"]["matrix"]["part"]
    tried = [name for part in parts for name in mutation.modules(part.split())]
    assert sorted(tried) == list(mutation.modules(["*"]))


def test_the_record_is_of_modules_that_exist_and_holds() -> None:
    there = set(mutation.modules(["*"]))
    for name, entry in json.loads(mutation.RECORD.read_text()).items():
        assert name in there
        noticed = sum(map(bool, entry["changes"].values()))
        assert len(entry["changes"]) <= mutation.CHANGES
        assert noticed >= min(mutation.LEAST, len(entry["changes"])), name


def test_a_module_that_is_not_recorded_is_an_error(tmp_path: Path) -> None:
    (tmp_path / "mutants.json").write_text("{}")
    with pytest.raises(SystemExit, match=r"not recorded yet: html\.py; "):
        mutation.main(["--recheck", "html", "--file", str(tmp_path / "mutants.json")])


@pytest.mark.nightly
def test_a_seed_chooses_changes_that_an_edit_elsewhere_leaves(module: Path) -> None:
    every = mutation.chosen(module, 0, count=1000)
    lines = {change.start_pos[0] for change in every.values()}
    assert lines == {5, 7}  # no annotation, no text of an error
    assert not any(what.endswith('"plain" _Eq_Lt') for what in every)
    few = mutation.chosen(module, 0, count=3)
    assert few.keys() < every.keys() != mutation.chosen(module, 1, count=3).keys()
    module.write_text(f"import math\n{SOURCE}")
    assert mutation.chosen(module, 0, count=3).keys() == few.keys()


def changed(source: str) -> bool | None:
    """Return whether one function's code differs from that of `SOURCE`; None if more does."""
    found = list(mutation.codes(*(compile(text, "", "exec") for text in (SOURCE, source))))
    return None if None in found else bool(found)


def test_what_is_outside_of_functions_needs_a_new_process() -> None:
    assert changed(SOURCE) is False
    assert changed(SOURCE.replace("x * 2", "x - 2")) is True
    assert changed(SOURCE.replace("kind: str", "kind: str = 3")) is None
    assert changed(SOURCE + "y = 3\n") is None


def test_tests_of_a_line_are_those_that_execute_its_statement() -> None:
    lines = {"a.py": {"1": [-1], "2": [-1], "3": [0], "4": [1, 2]}}
    times = {"slow": 2.0, "quick": 0.5, "usual": 1.0}
    executed = mutation.Executed({"times": times, "lines": lines, "kernels": {"a.k": [0]}})
    source = "x = 1\ndef f():\n    if (1\n    and 2):\n        pass\n"
    assert executed.at("a.py", 3, source, []) == ["quick", "usual", "slow"]
    source = "x = 1\ndef f():\n    if 1:\n        pass\n"
    assert executed.at("a.py", 4, source, []) == ["quick", "usual"]
    assert executed.at("b.py", 1, "x = 1", ["a.k"]) == ["slow"]
    assert executed.at("a.py", 1, source, []) == ["quick", "usual", "slow"]  # by all its tests
    assert executed.imported("a.py", 2) and not executed.imported("a.py", 3)


def test_what_some_tests_execute_is_added_to_what_is_known_of_the_others() -> None:
    lines = {"a.py": {"1": [-1], "2": [0, 1], "3": [0]}}
    known = mutation.Executed(
        {"times": {"a": 1.0, "b": 2.0}, "lines": lines, "kernels": {"k": [0]}}
    )
    lines = {"a.py": {"2": [1], "4": [0]}, "b.py": {"1": [-1, 0]}}
    known.add(mutation.Executed({"times": {"c": 3.0, "a": 0.1}, "lines": lines}))
    assert known.times == {"b": 2.0, "c": 3.0, "a": 0.1}
    source = "\n".join("1234")
    found = [known.at("a.py", row, source, []) for row in range(1, 5)]
    assert found == [["a", "b", "c"], ["a", "b"], ["a", "b", "c"], ["c"]]
    assert known.at("b.py", 1, source, ["k"]) == ["c"]
    assert known.imported("b.py", 1)


@pytest.mark.nightly
@pytest.mark.parametrize("anew", [False, True])
@pytest.mark.parametrize(
    ("body", "by"),
    [
        ("assert module.f(2, 'other') in (0, 4)", ""),
        ("assert module.f(2, 'other') == 4", "test_it.py::test"),
        ("import os; module.f(2, '') == 4 or os.abort()", "test_it.py::test"),
        ("while module.f(2, '') != 4: pass", ""),
        ("import time; module.f(2, '') == 4 or time.sleep(1e6)", ""),
        (f"{CHILD}; assert module.f(2, '') == 4 or subprocess.call(command) == 0", ""),
    ],
)
def test_only_a_failure_within_the_time_is_noticed(
    module: Path, body: str, by: str, anew: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, value in {"WAITING": 3.0, "STARTING": 3.0}.items():
        monkeypatch.setattr(mutation, name, value)
    changes = mutation.chosen(module, 0, count=1000)
    last = next(change for what, change in changes.items() if "Mul_Sub" in what)
    Path("test_it.py").write_text(f"import module\n\ndef test():\n    {body}\n")
    found = list[tuple[str, str]]()

    def work(trial: mutation.Trial) -> None:
        if anew:
            trial.functions = {}
        found.append(mutation.noticed_by(last, ["test_it.py::test"], trial))

    assert pytest.main(["-qq", "-s", "test_it.py"], plugins=[mutation.Trial(work)]) == 0
    ((noticed, difference),) = found
    assert noticed == by
    assert "-    return x * 2" in difference
    assert Path("energyplan/module.py").read_text() == SOURCE
