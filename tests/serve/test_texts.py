"""The texts of the page: every language has the same ones, and none stands outside their files."""

from __future__ import annotations

import json
import re
from html.parser import HTMLParser
from pathlib import Path
from typing import Any, get_args

import pytest

from energyplan.diagnosis.result import Verdict
from energyplan.mission.report import Reason
from energyplan.mission.types import RemedyKind

PAGE = Path(__file__).resolve().parents[2] / "energyplan" / "serve" / "page"
TEXTS: dict[str, dict[str, Any]] = {
    file.stem: json.loads(file.read_text("utf-8")) for file in PAGE.glob("texts/*.json")
}
CODE = {file.name: file.read_text("utf-8") for file in PAGE.glob("*.js")}
INDEX = (PAGE / "index.html").read_text("utf-8")
STRING = re.compile(r"""(["'])((?:(?!\1)[^\\\n])*)\1""")
UNITS = {"%", "W", "m", "kg"}


def values(text: str) -> set[str]:
    """Return the names of what is filled into a text."""
    return set(re.findall(r"\{(\w+)\}", text))


@pytest.mark.parametrize("name", sorted(TEXTS))
def test_every_language_has_the_same_texts(name: str) -> None:
    mine, english = TEXTS[name], TEXTS["en"]
    assert list(mine) == list(english)
    assert len(mine["terms"]) == len(english["terms"])
    for key, text in mine.items():
        if key != "terms":
            assert values(text) == values(english[key]), key
            assert text.strip()
    same = [key for key in mine if key != "terms" and mine[key] == english[key]]
    assert name == "en" or len(same) < 0.1 * len(mine), same


def test_the_page_offers_every_language() -> None:
    offered = re.findall(r'<option value="(\w+)" lang="\1">', INDEX)
    listed = re.search(r"LANGUAGES = (\[.*?\])", CODE["texts.js"])
    assert listed is not None
    assert sorted(offered) == sorted(TEXTS) == sorted(json.loads(listed[1]))


def test_every_kind_that_the_service_answers_has_a_text() -> None:
    for prefix, kinds in (("reason", Reason), ("remedy", RemedyKind), ("verdict", Verdict)):
        known = {key.split(".")[1] for key in TEXTS["en"] if key.startswith(f"{prefix}.")}
        assert known == {*get_args(kinds)} - {"none"}, prefix


def test_every_text_is_used_and_every_key_known() -> None:
    """A key stands in quotes, or begins with what a template has before its first value."""
    code = "\n".join(CODE.values())
    used = {text for _, text in STRING.findall(code)} | set(
        re.findall(r'data-(?:text|label|placeholder|hint)="(\w+)"', INDEX)
    )
    begun = set(re.findall(r"`([a-z]+[._])\$\{", code)) | {"in_reach"}
    plural = {key.rpartition(".")[0] for key in TEXTS["en"] if re.search(r"\.(one|other)$", key)}
    unused = [
        key
        for key in TEXTS["en"]
        if key not in used
        and key.rpartition(".")[0] not in plural & used
        and not key.startswith(tuple(begun))
    ]
    assert unused == []
    asked = re.findall(r'\b(?:t|tell)\("(\w+)"', code) + re.findall(r'counted\("(\w+)"', code)
    assert {*asked} <= {*TEXTS["en"]} | plural


class _Words(HTMLParser):
    """Collects what a reader of a page without a script would see."""

    def __init__(self) -> None:
        super().__init__()
        self.words: list[str] = []
        self.inside = ""

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        self.inside = tag
        self.words += [
            value or ""
            for name, value in attributes
            if name in ("title", "placeholder", "aria-label")
        ]

    def handle_data(self, data: str) -> None:
        if self.inside not in ("title", "h1", "option"):
            self.words.append(data.strip())


def test_no_sentence_stands_outside_the_files_of_texts() -> None:
    parser = _Words()
    parser.feed(INDEX)
    assert {*parser.words} - {""} <= UNITS
    for name, code in CODE.items():
        plain = re.sub(r"^\s*//.*$|  // .*$", "", code, flags=re.MULTILINE)
        strings = [text for _, text in STRING.findall(plain)]
        strings += [re.sub(r"\$\{.*?\}", "", text) for text in re.findall(r"`([^`]*)`", plain)]
        sentences = [
            text
            for text in strings
            if re.search(r"\b[A-Z][a-z]+ [a-z]|[a-z]{2,} [a-z]+ [a-z]{2,}", text)
        ]
        assert sentences == [], name
