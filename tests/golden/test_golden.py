"""Every command answers as it did: keys are equal, numbers within what `answers` allows."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import answers
import pytest


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made: Path = tmp_path_factory.mktemp("golden")
    answers.material(made)
    return made


# by day the demo is run by the test of the documentation
NAMES = [pytest.param(n, marks=[pytest.mark.nightly] * (n == "demo")) for n in answers.ANSWERS]


@pytest.mark.parametrize("name", NAMES)
def test_the_answer_is_as_it_was(name: str, folder: Path) -> None:
    was = json.loads(answers.file(name).read_text())
    assert answers.differences(name, was, answers.answer(name, folder)) == []


PAGE = answers.HERE.parents[1] / "docs" / "reference" / "json.md"
TABLES = dict(re.findall(r"^## (.+?)\n(.*?)(?=^## |\Z)", PAGE.read_text(), re.M | re.S))
SECTIONS: dict[str, list[tuple[str, str]]] = {}
for title, text in TABLES.items():
    for name, keys, meaning in re.findall(
        r"^\|(?: `([^|]+)` \|)? (`[^|]+) \| (.+) \|$", text, re.M
    ):
        SECTIONS.setdefault(name or title, []).append((keys, meaning))
DESCRIBED = {
    name: section
    for name, answer in answers.ANSWERS.items()
    for section in SECTIONS
    if (section == answer.page if answer.page else answer.asked.startswith(f"{section} "))
}


@pytest.mark.parametrize("name", DESCRIBED)
def test_the_page_describes_the_keys_of_an_answer(name: str) -> None:
    """A row is a key and its meaning; of a list of records the meaning names their keys."""
    (document,) = json.loads(answers.file(name).read_text())
    table = SECTIONS[DESCRIBED[name]]
    said = {key: text for keys, text in table for key in re.findall(r"`(\w+)`", keys)}
    assert said.keys() - answers.DROPPED == document.keys() - {"preset"}
    for key, text in said.items():
        records = [one for one in _list(document.get(key)) if isinstance(one, dict)]
        _, is_list, listed = text.partition("list of ")
        if is_list and records:
            assert set(re.findall(r"`(\w+)`", listed)) == {k for one in records for k in one}


def _list(value: Any) -> list[Any]:
    return value if isinstance(value, list) else []


def test_no_answer_is_kept_of_what_is_not_asked() -> None:
    assert {one.stem for one in answers.HERE.glob("*.json")} == set(answers.ANSWERS)


def test_every_tolerance_of_a_route_is_finite_and_what_it_decides_is_held() -> None:
    """Energy, bound, length and duration of a plan, each changed by more than rounding changes."""
    (plan,) = json.loads(answers.file("plan").read_text())
    for key, part in (("energy", 0.01), ("lower_bound", 0.001), ("length", 0.02), ("duration", 0.3),
                      ("energy_driven", 0.01), ("gap", 0.2), ("cost", 0.01)):  # fmt: skip
        changed = plan | {key: plan[key] * (1 + part)}
        (found,) = answers.differences("plan", [plan], [changed])
        assert f".{key}:" in found
    ends = plan | {"path": plan["path"] | {"last": [0.0, 0.0, 0.0]}}
    assert len(answers.differences("plan", [plan], [ends])) == 3


@pytest.mark.parametrize(
    ("was", "now"),
    [
        ({"a": 1.0}, {"a": 1.0 + 2e-9}),
        ({"a": 1.0}, {"b": 1.0}),
        ({"a": [1, 2]}, {"a": [1]}),
        ("5 J", "5.1 J"),
        ("5 J", "5 W"),
        (True, 1),
        (None, 0),
    ],
)
def test_what_differs_is_seen(was: object, now: object) -> None:
    assert answers.differences("check", was, now)
    assert answers.differences("check", was, was) == []
