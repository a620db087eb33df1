"""The demo's part that needs an extra; `tests/docs/test_docs.py` runs the whole of it."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

import energyplan as ep
from energyplan import demo
from energyplan.io.files import bundled
from energyplan.output.pages import Page


def driven(folder: Path) -> demo._Demo:
    made = demo._Demo(folder, lambda text: None, Page("demo"))
    demo._driven(made)
    return made


def test_without_the_engine_the_demo_shows_what_it_found_before(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "mujoco", None)
    made = driven(tmp_path)
    page = made.page.html()
    assert "[physics]" in page
    assert f"found by version {ep.__version__}" in page
    assert "less than the first one" in page
    assert "predicted [J]" in page
    assert [file.name for file in made.files] == ["loop.png"]


@pytest.mark.slow
def test_what_the_demo_found_before_is_what_it_finds(tmp_path: Path) -> None:
    """`make pictures` stores it again."""
    pytest.importorskip("mujoco", reason="the engine needs the extra physics")
    made = driven(tmp_path)
    before, now = (json.loads(file.read_text()) for file in (bundled(demo.DRIVEN), made.files[0]))
    for key in ("error", "saving"):
        assert now[key] == pytest.approx(before[key], abs=0.5)
    assert [row[-1] for row in now["tables"][0][2]] == [row[-1] for row in before["tables"][0][2]]
