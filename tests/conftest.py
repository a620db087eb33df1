"""Fixtures that more than one test module uses."""

from __future__ import annotations

import gc
import shutil
from collections.abc import Callable, Generator
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from hypothesis import settings

from energyplan import physics
from energyplan.planning import Budget
from energyplan.power.effects import catalogue

# The same cases in every run, however long each takes; `--hypothesis-profile=varied` draws others.
settings.register_profile("repeatable", derandomize=True, deadline=None)
settings.register_profile("varied", deadline=None)
settings.load_profile("repeatable")

collect_ignore = ["mutation.py"]  # a script for the night


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
def run(capsys: pytest.CaptureFixture[str]) -> Callable[..., Any]:
    """Run a command as from a shell."""
    import commands

    return partial(commands.run, capsys)


@pytest.fixture(scope="session")
def browser() -> Generator[Any, None, None]:
    """Chromium of the distribution's packages, without a network; skips where it is absent."""
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright drives the browser")
    program = next(filter(None, map(shutil.which, ("chromium", "chromium-browser"))), None)
    if program is None:
        pytest.skip("no chromium on the PATH")
    options = [
        "--no-sandbox", "--disable-gpu", "--disable-quic", "--disable-background-networking",
        "--disable-component-update", "--disable-sync", "--no-first-run",
    ]  # fmt: skip
    with playwright.sync_playwright() as driver:
        made = driver.chromium.launch(executable_path=program, args=options)
        yield made
        made.close()


@pytest.fixture
def little_effort(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have plans do little work where they are not told how much: planning is but a part."""
    monkeypatch.setattr("energyplan.planning.budget.EFFORT", 5000)


FEW = ("hotel_load", "grade", "tilted_plane", "viscous_loss", "linear_inertia")
"""Effects to choose from where what the search finds is not what is tried."""
ENOUGH = 2000
"""Units of work of a plan that is asked for many more: also for one of several goals."""
PART = 15
"""Of work that is asked for, one unit in so many is done."""


@pytest.fixture
def few_effects(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have diagnoses choose among few effects: a third of the work."""
    few = {name: entry for name, entry in catalogue().items() if name in FEW}
    assert len(few) == len(FEW)
    monkeypatch.setattr("energyplan.diagnosis.catalogue", lambda: few)


@pytest.fixture
def hurried(few_effects: None, monkeypatch: pytest.MonkeyPatch) -> None:
    """Have a reader's commands do no more than shows that they work, whatever they ask for.

    Plans do no more work than is enough for a route, and diagnoses know few effects. Loops go
    round once, without a designed drive: each round and each drive has all drives so far
    diagnosed.
    """
    budget, loop = Budget.__init__, physics.close_loop

    def init(self: Budget, time_limit: float = float("inf"), *, effort: int | None = None) -> None:
        if effort is not None and effort > PART:
            effort = min(effort // PART, ENOUGH)
        budget(self, time_limit, effort=effort)

    def once(*given: Any, **options: Any) -> object:
        return loop(*given, **options | {"rounds": 1, "survey": 0.0})

    monkeypatch.setattr(Budget, "__init__", init)
    for place in ("energyplan.physics", "energyplan.demo"):
        monkeypatch.setattr(f"{place}.close_loop", once)
