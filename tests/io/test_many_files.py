"""Many files on the processes of one machine, and files of results."""

from __future__ import annotations

from concurrent.futures import Executor, ProcessPoolExecutor, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

from energyplan.errors import InvalidInputError
from energyplan.io.many import answers, cluster


def measured(file: Path) -> dict[str, Any]:
    return {"size": file.stat().st_size}


def test_the_cores_of_this_machine_are_processes_without_a_port(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("12345")
    with cluster("local") as executor:
        assert isinstance(executor, ProcessPoolExecutor)
        assert [line["size"] for line in answers(measured, [tmp_path / "a.csv"], executor)] == [5]


def test_a_cluster_without_encryption_is_refused() -> None:
    with pytest.raises(InvalidInputError, match="runs code as you"), cluster("tcp://127.0.0.1:9"):
        pass


def worked(results: Path, executor: Executor) -> list[dict[str, Any]]:
    (results.parent / "a.csv").write_text("12345")
    return [*answers(measured, [results.parent / "a.csv"], executor, results)]


@pytest.mark.parametrize(
    "content", [b"a note without an end", b'{"a": 1}', b'{"file": "x"}', b"\xff"]
)
def test_what_is_no_file_of_results_stays_as_it_is(tmp_path: Path, content: bytes) -> None:
    results = tmp_path / "r.jsonl"
    results.write_bytes(content)
    with ThreadPoolExecutor(1) as pool, pytest.raises(InvalidInputError, match="another file"):
        worked(results, pool)
    assert results.read_bytes() == content


@pytest.mark.parametrize("content", ["", "{", '{"file": "a.csv", "check'])
def test_an_answer_that_was_cut_off_is_computed_again(tmp_path: Path, content: str) -> None:
    results = tmp_path / "r.jsonl"
    results.write_text(content)
    with ThreadPoolExecutor(1) as pool:
        assert [line["size"] for line in worked(results, pool)] == [5]
    assert len(results.read_text().splitlines()) == 1
