"""The notebooks run from top to bottom, and hold no results."""

from __future__ import annotations

import ast
import contextlib
import io
import json
from pathlib import Path
from typing import Any

import pytest

FOLDER = Path(__file__).resolve().parents[2] / "docs" / "notebooks"
NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))


def cells(file: Path) -> list[dict[str, Any]]:
    document = json.loads(file.read_text())
    assert document["nbformat"] == 4
    found = document["cells"]
    assert isinstance(found, list)
    return found


def show(value: object) -> str:
    """Return what Jupyter shows of a cell's last expression."""
    made = getattr(value, "_repr_html_", None)
    return str(made() if made else repr(value))


@pytest.mark.parametrize("file", NOTEBOOKS, ids=lambda file: file.stem)
def test_a_notebook_runs(file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {"__name__": "notebook"}
    for k, cell in enumerate(cells(file)):
        if cell["cell_type"] != "code":
            continue
        tree = ast.parse("".join(cell["source"]))
        last = tree.body.pop() if isinstance(tree.body[-1], ast.Expr) else None
        with contextlib.redirect_stdout(io.StringIO()):
            exec(compile(tree, f"{file.name}, cell {k}", "exec"), names)
            if isinstance(last, ast.Expr):
                code = compile(ast.Expression(last.value), f"{file.name}, cell {k}", "eval")
                assert show(eval(code, names))


def test_there_are_three() -> None:
    assert len(NOTEBOOKS) == 3


@pytest.mark.parametrize("file", NOTEBOOKS, ids=lambda file: file.stem)
def test_a_notebook_holds_no_results(file: Path) -> None:
    for cell in cells(file):
        assert not cell.get("outputs")
        assert cell.get("execution_count") is None
