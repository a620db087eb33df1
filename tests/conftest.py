"""Fixtures that more than one test module uses."""

from __future__ import annotations

from pathlib import Path

import pytest

collect_ignore = ["fuzz", "mutation.py"]  # scripts for the night


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder of recorded drives and maps beside the checkout; skips where it is absent."""
    folder = Path(__file__).resolve().parents[2] / "shared" / "data"
    if not folder.is_dir():
        pytest.skip(f"the shared data folder {folder} is absent")
    return folder
