"""Every command answers as it did: keys are equal, numbers within what `answers` allows."""

from __future__ import annotations

import json
from pathlib import Path

import answers
import pytest


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made: Path = tmp_path_factory.mktemp("golden")
    answers.material(made)
    return made


@pytest.mark.parametrize("name", answers.ANSWERS)
def test_the_answer_is_as_it_was(name: str, folder: Path, request: pytest.FixtureRequest) -> None:
    if name == "demo":  # which files it writes is its answer
        request.getfixturevalue("hurried")
    was = json.loads(answers.file(name).read_text())
    assert answers.differences(name, was, answers.answer(name, folder)) == []


def test_no_answer_is_kept_of_what_is_not_asked() -> None:
    assert {one.stem for one in answers.HERE.glob("*.json")} == set(answers.ANSWERS)


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
