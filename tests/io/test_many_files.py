"""Many files on the processes of one machine, and files of results."""

from __future__ import annotations

import os
import signal
from concurrent.futures import Executor, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

from energyplan.errors import InvalidInputError
from energyplan.io.many import answers, cluster


def measured(file: Path) -> dict[str, Any]:
    return {"size": file.stat().st_size, "process": os.getpid()}


def killed(file: Path) -> dict[str, Any]:
    """Answer a file; the process is killed at the first try, or at each."""
    died = file.with_suffix(".died")
    if file.name == "always.csv" or (file.name == "once.csv" and not died.exists()):
        died.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return measured(file)


def test_a_killed_process_loses_no_other_answer(tmp_path: Path) -> None:
    files = [tmp_path / name for name in ("always.csv", "once.csv", "a.csv", "b.csv")]
    for file in files:
        file.write_text("12345")
    with cluster("local") as executor:
        lines = {Path(line["file"]).name: line for line in answers(killed, files, executor)}
    assert files[1].with_suffix(".died").exists()
    assert "killed 3 times" in lines.pop("always.csv")["error"]
    assert [line["size"] for line in lines.values()] == [5, 5, 5]


def test_the_cores_of_this_machine_are_processes_without_a_port(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("12345")
    with cluster("local") as executor:
        (line,) = answers(measured, [tmp_path / "a.csv"], executor)
    assert line["size"] == 5 and line["process"] != os.getpid()


def test_a_cluster_without_encryption_is_refused() -> None:
    with pytest.raises(InvalidInputError, match="runs code as you"), cluster("tcp://127.0.0.1:9"):
        pass


def test_certificates_go_with_encryption_and_must_be_readable(tmp_path: Path) -> None:
    with (
        pytest.raises(InvalidInputError, match="uses no certificates"),
        cluster("local", ca=tmp_path / "ca.pem"),
    ):
        pass
    pytest.importorskip("distributed", reason="a cluster needs the extra cluster")
    with (
        pytest.raises(InvalidInputError, match=r"ca\.pem.* cannot be read"),
        cluster("tls://127.0.0.1:9", ca=tmp_path / "ca.pem"),
    ):
        pass


def test_encryption_without_a_certificate_names_the_options() -> None:
    pytest.importorskip("distributed", reason="a cluster needs the extra cluster")
    with (
        pytest.raises(InvalidInputError, match="wants a certificate; give --cluster-ca"),
        cluster("tls://127.0.0.1:9"),
    ):
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
