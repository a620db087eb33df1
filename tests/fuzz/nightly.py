"""Try many malformed inputs on every reader and every command, and count them.

    python tests/fuzz/nightly.py [--runs 100000] [--jobs 1] [--list] [TARGET ...]

A target is a reader with an engine (``atheris:log.csv``, ``hypothesis:log.csv``) or a command
(``command:plan``); patterns such as ``'atheris:*'`` pick several, so that machines can share the
work. Each target is a process of its own. The inputs that had no answer, and the output
of what failed, are left in the folder named at the end.
"""

from __future__ import annotations

import argparse
import importlib.util
import os
import re
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from fnmatch import fnmatchcase
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

TESTS = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(TESTS))

_EXECUTED = re.compile(r"number_of_executed_units: (\d+)|^#(\d+)\t", re.MULTILINE)


class Outcome(NamedTuple):
    """What came of a target."""

    target: str
    inputs: int
    seconds: float
    processor: float
    sound: bool


def targets() -> list[str]:
    """Name everything that malformed input is tried on."""
    from fuzzing import READERS

    sys.path.insert(0, str(TESTS / "io"))
    from test_fuzz import COUNTS

    engines = ["hypothesis"]
    if importlib.util.find_spec("atheris"):
        engines.insert(0, "atheris")
    return [
        *(f"{engine}:{reader}" for engine in engines for reader in READERS),
        *(f"command:{name}" for name in (*COUNTS, "arguments", "columns")),
    ]


def test_of(target: str) -> str:
    """Return the test that tries a target with hypothesis."""
    kind, _, name = target.partition(":")
    if kind == "hypothesis":
        return f"test_readers_refuse_by_name[{name}]"
    return {
        "arguments": "test_arguments_are_refused_by_name",
        "columns": "test_column_maps_and_poses_are_refused_by_name",
    }.get(name, f"test_commands_refuse_by_name[{name}]")


def attempt(target: str, runs: int, folder: Path) -> Outcome:
    """Try a target in a process of its own."""
    place = folder / re.sub(r"[^\w.-]", "_", target)
    place.mkdir(parents=True, exist_ok=True)
    report = place / "report.xml"
    name = target.partition(":")[2]
    if target.startswith("atheris:"):
        script = str(TESTS / "fuzz" / "parsers.py")
        command = [sys.executable, script, name, str(runs), "--artifacts", str(place)]
    else:
        test = f"{TESTS / 'io' / 'test_fuzz.py'}::{test_of(target)}"
        command = [sys.executable, "-m", "pytest", "-q", "-ojunit_family=xunit1"]
        command += [f"--junitxml={report}", test]
    one = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")
    environment = {**os.environ, **one, "ENERGYPLAN_FUZZ": str(runs)}
    start = time.monotonic()
    with (place / "output.txt").open("w") as output:
        process = subprocess.Popen(
            command, stdout=output, stderr=subprocess.STDOUT, env=environment
        )
        _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    seconds = time.monotonic() - start
    inputs = 0
    if report.exists():
        found = ElementTree.parse(report).iterfind(".//property[@name='inputs']")
        inputs = sum(int(one.get("value", "0")) for one in found)
    elif told := _EXECUTED.findall((place / "output.txt").read_text(errors="replace")):
        inputs = max(int(final or running) for final, running in told)
    processor = usage.ru_utime + usage.ru_stime
    return Outcome(target, inputs, seconds, processor, process.returncode == 0)


def main() -> int:
    """Try what is asked for, and print a count of each."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("targets", nargs="*", metavar="TARGET", default=["*"])
    parser.add_argument("--runs", type=int, default=100_000, help="inputs for each target")
    parser.add_argument("--jobs", type=int, default=1, help="processes at a time")
    parser.add_argument("--folder", type=Path, default=Path("build/fuzz"))
    parser.add_argument("--list", action="store_true", help="name the targets and stop")
    asked = parser.parse_args()
    everything = targets()
    chosen = list(  # in the order asked for
        dict.fromkeys(t for like in asked.targets for t in everything if fnmatchcase(t, like))
    )
    if not chosen:
        parser.error("no such target; --list names them")
    if asked.list:
        print("\n".join(chosen))
        return 0
    outcomes = []
    print(f"{'target':28} {'inputs':>9} {'time [s]':>9} {'CPU [s]':>8}  outcome", flush=True)
    with ThreadPoolExecutor(asked.jobs) as pool:
        for one in pool.map(lambda t: attempt(t, asked.runs, asked.folder), chosen):
            told = "answered" if one.sound else "FAILED"
            print(
                f"{one.target:28} {one.inputs:9,} {one.seconds:9.0f} {one.processor:8.0f}  {told}",
                flush=True,
            )
            outcomes.append(one)
    failed = [one.target for one in outcomes if not one.sound]
    inputs, processor = sum(o.inputs for o in outcomes), sum(o.processor for o in outcomes)
    rest = f"{len(failed)} of {len(outcomes)} failed"
    print(f"{'all':28} {inputs:9,} {'':9} {processor:8.0f}  {rest}")
    if failed:
        print(f"inputs and output are in {asked.folder}: {', '.join(failed)}")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
