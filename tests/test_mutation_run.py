"""Which changes the nightly run makes, what it makes of the tests' answers, and its record."""

from __future__ import annotations

import json
from pathlib import Path

import mutation
import pytest

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
    Path("module.py").write_text(SOURCE)
    return Path("module.py")


def test_what_is_changed_and_tested_exists() -> None:
    """A folder that was renamed is found by day."""
    there = dict(mutation.modules(["*"]))
    assert len(there) > 50
    files = {file for tests in there.values() for file in tests.split()}
    assert {file for file in files if not (mutation.ROOT / file).exists()} == set()
    assert len(dict(mutation.modules(["battery"]))) == 3


def test_the_record_is_of_modules_that_exist_and_holds() -> None:
    there = dict(mutation.modules(["*"]))
    for name, entry in json.loads(mutation.RECORD.read_text()).items():
        assert name in there
        noticed = sum(map(bool, entry["changes"].values()))
        assert len(entry["changes"]) <= mutation.CHANGES
        assert noticed >= min(mutation.LEAST, len(entry["changes"])), name


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


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("body", "by"),
    [
        ("assert module.f(2, 'other') in (0, 4)", ""),
        ("assert module.f(2, 'other') == 4", "test_it.py::test"),
        ("import os; module.f(2, '') == 4 or os.abort()", "a crash"),
        ("while module.f(2, '') != 4: pass", ""),
        ("import time; module.f(2, '') == 4 or time.sleep(1e6)", ""),
        (f"{CHILD}; assert module.f(2, '') == 4 or subprocess.call(command) == 0", ""),
    ],
)
def test_only_a_failure_within_the_time_is_noticed(
    module: Path, body: str, by: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(mutation, "WAITING", 3.0)
    monkeypatch.syspath_prepend(".")
    changes = mutation.chosen(module, 0, count=1000)
    last = next(change for what, change in changes.items() if "Mul_Sub" in what)
    Path("test_it.py").write_text(f"import module\n\ndef test():\n    {body}\n")
    found, difference = mutation.noticed_by(last, ["test_it.py"], 5.0)
    assert found == by
    assert "-    return x * 2" in difference
    assert Path("module.py").read_text() == SOURCE
