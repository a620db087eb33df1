"""Fixtures that more than one test module uses."""

from __future__ import annotations

import gc
from collections.abc import Generator
from math import isfinite
from pathlib import Path

import pytest
from hypothesis import settings

from energyplan.planning import Budget
from energyplan.planning.budget import PACE

# The same cases in every run; at night `--hypothesis-profile=varied` draws others.
settings.register_profile("repeatable", derandomize=True)
settings.register_profile("varied")
settings.load_profile("repeatable")

collect_ignore = ["fuzz", "mutation.py"]  # scripts for the night


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Collect tests without looking for garbage, and never look for it among them."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


def pytest_unconfigure() -> None:
    gc.unfreeze()  # what leaves garbage is told as the process ends


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder of recorded drives and maps beside the checkout; skips where it is absent."""
    folder = Path(__file__).resolve().parents[2] / "shared" / "data"
    if not folder.is_dir():
        pytest.skip(f"the shared data folder {folder} is absent")
    return folder


@pytest.fixture
def counted(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have planning count its effort where it is given a time: up to a tenth of a second's worth.

    For tests of what planning is a part of: what comes of them depends on no clock.
    """
    original = Budget.__init__

    def init(self: Budget, time_limit: float = float("inf"), *, effort: int | None = None) -> None:
        if effort is None and time_limit > 0 and isfinite(time_limit):
            effort = max(round(min(time_limit, 0.1) * PACE), 1)
        original(self, time_limit, effort=effort)

    monkeypatch.setattr(Budget, "__init__", init)
