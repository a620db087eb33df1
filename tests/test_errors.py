"""What a message says of a package that is missing."""

from __future__ import annotations

import importlib.metadata
import json
import shlex
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from energyplan import errors

SITE = "lib/site-packages/energyplan/errors.py"
"""Where the module is in an installed package."""


def installed(
    monkeypatch: pytest.MonkeyPatch, folder: Path, origin: dict[str, Any] | None
) -> list[str]:
    """Return the words of the command for a package that was installed from an origin."""
    told = SimpleNamespace(read_text=lambda name: None if origin is None else json.dumps(origin))
    monkeypatch.setattr(importlib.metadata, "distribution", lambda name: told)
    monkeypatch.setattr(errors, "__file__", str(folder / SITE))
    return shlex.split(errors.installation("serve"))


def test_a_missing_package_is_installed_from_where_the_library_was(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """As PEP 610 says: a folder, an archive, a repository; or an index by the name alone."""
    checkout = tmp_path / "my checkout"
    checkout.mkdir()
    wheel = tmp_path / "energyplan-1-py3-none-any.whl"
    wheel.touch()
    address = "https://example.org/energyplan.git"
    for origin, words in (
        (None, ["energyplan[serve]"]),
        ({"url": checkout.as_uri(), "dir_info": {}}, [f"{checkout}[serve]"]),
        ({"url": wheel.as_uri(), "archive_info": {}}, [f"{wheel}[serve]"]),
        ({"url": address, "vcs_info": {"vcs": "git", "commit_id": "abc"}},
         [f"energyplan[serve] @ git+{address}@abc"]),
        ({"url": "https://example.org/e.whl", "archive_info": {}},
         ["energyplan[serve] @ https://example.org/e.whl"]),
    ):  # fmt: skip
        found = installed(monkeypatch, tmp_path, origin)
        assert found == ["pip", "install", *words], origin


def test_a_checkout_is_installed_by_its_path_and_stays_editable(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (tmp_path / "lib" / "site-packages").mkdir(parents=True)
    (tmp_path / "lib" / "site-packages" / "pyproject.toml").touch()
    checkout = tmp_path / "lib" / "site-packages"
    told = {"url": checkout.as_uri(), "dir_info": {"editable": True}}
    assert installed(monkeypatch, tmp_path, told)[2:] == ["-e", f"{checkout}[serve]"]
    assert installed(monkeypatch, tmp_path, None)[2:] == [f"{checkout}[serve]"]


def test_a_folder_that_is_no_more_is_not_proposed(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    gone = tmp_path / "gone"
    found = installed(monkeypatch, tmp_path, {"url": gone.as_uri(), "dir_info": {}})
    assert found[:4] == ["pip", "install", ".[serve]", "in"]
