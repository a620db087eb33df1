"""What the nightly run makes of tests that fail, pass, crash, never end or wait."""

from __future__ import annotations

import ast
import sys
from pathlib import Path

import mutation
import pytest

CHILD = "import subprocess, sys; code = subprocess.call([sys.executable, '-c', 'while True: pass'])"
"""A process of the tests that is cut off before they are."""


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("body", "end"),
    [
        ("pass", mutation.SURVIVED),
        ("assert False", mutation.NOTICED),
        ("import os; os.abort()", mutation.NOTICED),
        ("while True: pass", mutation.CUT),
        ("import time; time.sleep(1e6)", mutation.CUT),
        (f"{CHILD}; assert code == 0", mutation.CUT),
    ],
)
def test_only_a_failure_within_the_time_is_noticed(
    body: str, end: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(mutation, "WAITING", 3.0)
    monkeypatch.chdir(tmp_path)
    tests = tmp_path / "test_it.py"
    tests.write_text(f"def test():\n    {body}\n")
    assert mutation.try_tests([sys.executable, "-m", "pytest", "-q", str(tests)], 5.0) == end


@pytest.mark.parametrize(
    ("line", "expected"), [(1, ["b", "a", "c"]), (4, ["a", "c"]), (8, ["b", "a", "c"])]
)
def test_tests_that_call_a_function_are_run_and_all_of_them_for_a_kernel(
    line: int, expected: list[str], tmp_path: Path
) -> None:
    source = (
        "x = 1\n\ndef plain():\n    return 1\n\n@njit(cache=True)\ndef quick():\n    return 2\n"
    )
    file = tmp_path / "module.py"
    calls = {"a": [f"{file}:3", f"{file}:6"], "b": [], "c": [f"{file}:3"]}
    reaches = [
        mutation.Reach(name, took, calls[name])
        for name, took in (("c", 3.0), ("b", 1.0), ("a", 2.0))
    ]
    found = mutation._tests_of((line, 4), file, ast.parse(source), reaches)
    assert [one.test for one in found] == expected


def test_a_change_is_found_again_in_another_module() -> None:
    before = "def f(x):\n    y = x + 1\n    y = x + 1\n    return y\n"
    change = mutation.killed_by(
        "a.py", before, before.replace("1\n    return", "2\n    return"), "number", "t.py"
    )
    assert change is not None
    assert (change.function, change.nth, change.test) == ("f", 1, "t.py")
    assert mutation.find_again(change, {"a.py": before, "b.py": before}) == (
        "a.py", "def f(x):\n    y = x + 1\n    y = x + 2\n    return y\n"
    )  # fmt: skip
    moved = "class A:\n    def g(self):\n        y = x + 1\n"
    assert mutation.find_again(change, {"b.py": moved}) == ("b.py", moved.replace("1", "2"))
    assert mutation.find_again(change, {"b.py": moved, "c.py": moved}) is None
