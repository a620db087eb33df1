"""The demo's part that needs an extra; `tests/docs/test_docs.py` runs the whole of it."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from energyplan import demo
from energyplan.output.pages import Page


def test_without_the_engine_the_demo_says_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "mujoco", None)
    made = demo._Demo(tmp_path, lambda text: None, Page("demo"))
    demo._driven(made)
    assert "[physics]" in made.page.html()
    assert made.files == []
