"""Guards and gates: what was not tested is never green without a word, and who falls is named."""

from __future__ import annotations

import importlib
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
sys.path.append(str(ROOT / "benchmarks"))  # behind the tests: both have a module of commands
gates = importlib.import_module("gates")
GATES, GUARDS, Gate = gates.GATES, gates.GUARDS, gates.Gate


def test_rows_without_their_data_are_counted_apart_and_alone_they_fail(tmp_path: Path) -> None:
    script, data = ROOT / "benchmarks" / "gates.py", tmp_path / "absent"
    done = subprocess.run(
        [sys.executable, script, "--only", "willow*", "--data", data],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    *rows, last = done.stdout.splitlines()
    assert len(rows) == sum(gate.name.startswith("willow") for gate in GATES) > 0
    assert all(row.endswith(f"skipped: {data} is absent") for row in rows)
    assert last.startswith(f"0 held, 0 fell, {len(rows)} skipped; skipped: {data} is absent; ")
    assert done.returncode == 1


def test_what_held_fell_and_was_skipped_is_told_apart() -> None:
    skipped = "skipped: no data"
    assert gates.summary(["holds"]) == ("1 held, 0 fell, 0 skipped", True)
    assert gates.summary(["holds", skipped]) == (f"1 held, 0 fell, 1 skipped; {skipped}", True)
    assert gates.summary(["holds", "FALLS", "FALLS, exit code 1: no"])[1] is False
    assert gates.summary([skipped, skipped]) == (f"0 held, 0 fell, 2 skipped; {skipped}", False)


@pytest.mark.parametrize(("right", "verdict"), [(3, "holds"), (2, "FALLS")])
def test_a_row_that_falls_names_what_was_at_fault(
    right: int, verdict: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    script = tmp_path / "script.py"
    script.write_text(f"print('turned wrong: 7')\nprint('{right} of 3 right')\n")
    gate = Gate("seeds", str(script), r"^(\d+) of 3", 3, names="^turned")
    assert list(gates.verdicts([gate], 1, tmp_path)) == [verdict]
    first, *more = capsys.readouterr().out.splitlines()
    assert first.split() == ["seeds", str(right), "at", "least", "3", verdict]
    assert more == ([] if right == 3 else ["    turned wrong: 7"])


def test_a_script_that_fails_or_prints_no_figure_falls(tmp_path: Path) -> None:
    gate = Gate("seeds", "script.py", r"^(\d+) right", 3)
    assert gates.judged(gate, gates.Printed(["7 wrong"])) == (
        "",
        "FALLS, no such figure was printed",
    )
    assert gates.judged(gate, gates.Printed(["9 right"], failed="exit code 2"))[1].startswith(
        "FALLS"
    )
    script = tmp_path / "script.py"
    script.write_text("raise SystemExit('nothing to do')\n")
    (told,) = gates.verdicts([gate._replace(command=str(script))], 1, tmp_path)
    assert told == "FALLS, exit code 1: nothing to do"


def test_guards_name_what_is_at_fault_and_draw_what_no_page_shows() -> None:
    used = {seed for gate in GATES for seed in re.findall(r"--first (\d+)", gate.command)}
    firsts = {seed for gate in GUARDS for seed in re.findall(r"--first (\d+)", gate.command)}
    assert len(firsts) == 2
    assert used & firsts == set()
    counted = {gate.command for gate in GUARDS if gate.names}
    assert counted == {gate.command for gate in GUARDS}
    seeds = [int(line) for line in (ROOT / "benchmarks/right_seeds.txt").read_text().split()]
    assert seeds == sorted(set(seeds))
    assert set(seeds) <= set(range(520000, 520100))
    assert len(seeds) >= 88


def test_every_change_runs_the_guards() -> None:
    assert "\nmake guards\n" in (ROOT / ".ci" / "run").read_text()
    recipe = re.search(r"^guards: .*\n\t(.*)", (ROOT / "Makefile").read_text(), re.MULTILINE)
    assert recipe is not None
    assert recipe[1].endswith("benchmarks/gates.py --guards")
