"""What must not get worse: figures of benchmarks and tests, with the gates that they have to hold.

    python benchmarks/gates.py [--guards] [--only GLOB] [--jobs 2] [--data FOLDER]
    python benchmarks/gates.py --write CONTRIBUTING.md    the gates, as tables into that page

A line a row: name, value, gate, verdict. A row is a figure that a benchmark or a test prints;
rows of one command share its run. Effort and processor time count, not the clock, but for the
service. Rows that need recorded data are skipped where FOLDER (by default `shared/data` beside the
checkout) lacks it. The last line counts the rows that held, fell and were skipped apart. Ends with
exit code 1 if a gate falls, or if every row was skipped. All take about 45 minutes of two cores;
the guards, which are smaller and run on every change, about 5.
"""

from __future__ import annotations

import argparse
import os
import re
import resource
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from fnmatch import fnmatch
from math import inf
from pathlib import Path
from statistics import fmean
from typing import NamedTuple

from pages import write

HERE = Path(__file__).resolve().parent


class Gate(NamedTuple):
    """A figure, and between which values it has to be."""

    name: str
    command: str  # a script of this folder or a file of tests, and its arguments
    figure: str  # pattern whose group is the number, in a line of what the command prints
    least: float = -inf
    most: float = inf
    unit: str = ""
    of: Callable[[Sequence[float]], float] | None = None  # of several figures; else each counts
    names: str = ""  # pattern of the lines that say what was at fault, where the row falls

    def bounds(self) -> str:
        """Return the gate in words."""
        if self.least == self.most:
            return f"{self.most:g}{self.unit}"
        if -inf < self.least and self.most < inf:
            return f"{self.least:g} to {self.most:g}{self.unit}"
        return (
            f"at most {self.most:g}{self.unit}"
            if self.most < inf
            else f"at least {self.least:g}{self.unit}"
        )


class Printed(NamedTuple):
    """What a command printed, or why it was not run."""

    lines: list[str]
    failed: str = ""
    skipped: str = ""


WILLOW = "planners.py --pairs-file DATA/maps/willow_pairs.json --effort 5000 50000"
PAIRS = "planners.py --pairs-file PAIRS --effort 5000 50000"
ORDERS, PLACES = "orders.py 36", "places.py 20"
UNCERTAIN, CHAIN, SPEED = "uncertainty.py 2000", "chain.py 500", "speed.py 100"
HIDDEN = "calibration.py hidden 200 --first 910000"
EMPTY = "calibration.py empty 200 --first 910000"
RUNS, SINGLE = "card.py DATA grounds", "card.py DATA single"
DRIVEN = "card.py DATA closed_loop"
ENGINE = "diagnose.py engine DATA/quadriga_mujoco"
UNDECLARED = "undeclared.py 2 400"
NONE, LOOP = "loop.py none 12", "loop.py hidden 12 200"
SERVICE, COLD = "serve.py DATA/maps/depot.yaml", "cold.py --repeat 1"
ALONE = (SERVICE, COLD)
"""Commands that run when all others have ended."""
EXCESS = r"excess over the best .*\(mean ([\d.]+)\)", r"excess over the best .* / ([\d.]+) %; gap"


def _tests(name: str, files: str) -> Gate:
    return Gate(f"tests: {name}", files, r"^(\d+) passed", 1, unit=" pass, none fails")


# fmt: off
GATES = (
    Gate("willow: found at 5000", WILLOW, r"effort 5000: (\d+) of 30 found", 30),
    Gate("willow: found at 50,000", WILLOW, r"effort 50000: (\d+) of 30 found", 30),
    Gate("willow: worst excess at 5000", WILLOW, f"effort 5000:.*{EXCESS[1]}", most=6.5, unit=" %"),
    Gate("willow: mean excess at 50,000", WILLOW, f"effort 50000:.*{EXCESS[0]}", most=0.15,
         unit=" %"),
    Gate("willow: worst excess at 50,000", WILLOW, f"effort 50000:.*{EXCESS[1]}", most=0.7,
         unit=" %"),
    Gate("willow: median gap at 5000", WILLOW, r"effort 5000:.*gap ([\d.]+) /", most=25.5,
         unit=" %"),
    Gate("willow: median gap at 50,000", WILLOW, r"effort 50000:.*gap ([\d.]+) /", most=4.3,
         unit=" %"),
    Gate("willow: gap of nine in ten at 50,000", WILLOW,
         r"effort 50000:.*gap [\d.]+ / ([\d.]+) /", most=10, unit=" %"),
    Gate("maps and floors: pairs found at 50,000", PAIRS, r"effort 50000: (\d+) of \d+ found", 48,
         of=sum),
    Gate("maps and floors: mean excess at 50,000", PAIRS, f"effort 50000:.*{EXCESS[0]}", most=0.15,
         unit=" %", of=fmean),
    Gate("maps and floors: worst excess at 50,000", PAIRS, f"effort 50000:.*{EXCESS[1]}", most=2.5,
         unit=" %"),
    _tests("tight ends", "tests/planning/test_tight_ends.py"),
    _tests("narrow passages", "tests/planning/test_passages.py tests/planning/test_slots.py"),
    _tests("closed rooms are proven closed", "tests/planning/test_closure.py"),
    _tests("never dearer than the shortest route", "tests/planning/test_never_dearer.py"),
    _tests("lower bound below every cost", "tests/planning/test_bound.py"),
    _tests("replanning after a patch", "tests/planning/test_replanning.py"),
    _tests("logs of foreign formats", "tests/logs/test_foreign_logs.py"),
    Gate("orders of tasks: proven", ORDERS, r"^(\d+) of 36 proven", 36),
    Gate("orders of tasks: median CPU", ORDERS, r"median ([\d.]+) s of CPU", most=0.5, unit=" s"),
    Gate("missions: draws above the bound", UNCERTAIN, r"([\d.]+) % of \d+ above", 93, 97, " %"),
    Gate("missions of places: most over brute force", PLACES, r"largest \| ([\d.-]+) %", most=1,
         unit=" %"),
    Gate("missions of places: mean below heading 0", PLACES, r"0, mean \| ([\d.-]+) %", 3,
         unit=" %"),
    Gate("missions: remedies that hold", "remedies.py 200", r"remedies: (\d+) of 200 hold", 200),
    Gate("from path to energy: profiles accepted", CHAIN, r"500 cases: (\d+) profiles", 500),
    Gate("from path to energy: largest difference", CHAIN, r"integrated energy: ([\de.+-]+)",
         most=1e-5),
    Gate("least time over a linear program's", SPEED, r"minus 1: [\de.+-]+ to ([\de.+-]+)$",
         most=5e-4),
    Gate("least energy over a dynamic program's", SPEED,
         r"^ +[\d.-]+ +[\d.-]+ +[\d.]+ +([\de.+-]+) +[\d.]+ +[\d.]+$", most=3e-3),
    Gate("least time of hot motors: median over a program's", SPEED,
         r"minus 1: median ([\d.+-]+)%.* above 3 %", most=20, unit=" %"),
    Gate("least time of hot motors: feasible", SPEED, r"above 3 %; feasible: (\d+) of 100", 100),
    Gate("diagnosis: engine, right first of 42", ENGINE, r"right first: (\d+) of 42", 38),
    Gate("diagnosis: nothing hidden, an effect named", EMPTY, r"^(\d+) of 200 drives", most=3),
    Gate("diagnosis: simulated, right first", HIDDEN, r"^right explanation came first in (\d+)%",
         90, unit=" %"),
    Gate("diagnosis: simulated, sizes in their interval", HIDDEN, r"sizes, (\d+)% lay", 88,
         unit=" %"),
    Gate("diagnosis: simulated, hold-out within 1.15 of the true model's", HIDDEN,
         r"^hidden effects in (\d+)%", 93, unit=" %"),
    Gate("diagnosis: causes unknown to the catalogue, unexplained", UNDECLARED,
         r"^\w+ +(\d+) unexplained", 31, of=len),
    Gate("real runs: handed on over two terms, worst ground", RUNS,
         r"^\| (?!mean).*% \| ([\d.]+) \| [\d.]+ % \| \d+ of", most=1.03),
    Gate("real runs: handed on over two terms, all grounds", RUNS,
         r"^\| mean of all .*% \| ([\d.]+) \| - \|", most=0.9),
    Gate("real runs: in the 90 % interval", RUNS, r"^\| mean of all .* \((\d+) %\) \|", 85, 97,
         " %"),
    Gate("real runs: rest of a run over former runs alone, worst ground", RUNS,
         r"^\| (?!mean).* ([\d.]+) \|$", most=1.03),
    Gate("real runs: rest of a run over former runs alone, all grounds", RUNS,
         r"^\| mean of all .* ([\d.]+) \|$", most=0.75),
    Gate("real runs: pairs in the 90 % interval", SINGLE, r"^\| all .* (\d+) % \| [\d.]+ % \|$", 85,
         97, " %"),
    Gate("trajectories of closed-loop drives, nothing hidden", DRIVEN,
         r"^\| none \|.* ([+-][\d.]+) % \| [\d.]+ to", -3, 3, " %"),
    Gate("trajectories of closed-loop drives, lossy drives", DRIVEN,
         r"^\| (?:copper|driver) .* ([+-][\d.]+) % \| [\d.]+ to", -6, 6, " %"),
    Gate("closed loop: nothing hidden, worst error", NONE, r"drives: .* worst ([\d.]+) %", most=1.5,
         unit=" %"),
    Gate("closed loop: hidden effects, error within 3 % of 12", LOOP,
         r"^\| 12 \| [\d.]+ % \| (\d+) of 12", 11),
    Gate("closed loop: hidden effects, median error after", LOOP, r"^\| 12 \| ([\d.]+) %",
         most=0.5, unit=" %"),
    Gate("service: median over the library's time", SERVICE,
         r"^ +1 +[\d.]+ +0 +\d+ +\d+ +(\d+) ", most=20, unit=" ms"),
    Gate("start: a cold plan, over the imports", COLD, r"^plan +cold +[\d.]+ +([\d.]+)", most=100),
    Gate("start: a warm plan, over the imports", COLD, r"^plan +warm +[\d.]+ +([\d.]+)", most=4),
    Gate("start: --help, over the imports", COLD, r"^help +warm +[\d.]+ +([\d.]+)", most=0.6),
    Gate("replanning where the rest is kept: CPU", COLD, r"^replan .*: ([\d.]+) ms", most=10,
         unit=" ms"),
)
# fmt: on

CALIBRATED = "calibration.py hidden 100 --first 520000 --right benchmarks/right_seeds.txt"
SILENT = "calibration.py empty 60 --first 521000"
FEW = "chain.py 100"
# fmt: off
GUARDS = (
    Gate("diagnosis: right first", CALIBRATED, r"^right explanation came first in (\d+)%", 88,
         unit=" %"),
    Gate("diagnosis: sizes in their interval", CALIBRATED, r"sizes, (\d+)% lay", 86, unit=" %"),
    Gate("diagnosis: seeds other than listed", CALIBRATED, r"^(\d+) of 100 seeds turned", most=0,
         names="^turned "),
    Gate("diagnosis: nothing hidden, an effect named", SILENT, r"^(\d+) of 60 drives", most=1,
         names="^seed .* was given"),
    Gate("plans: problems that lack no property", "properties.py 60 --first 520000",
         r"^(\d+) of 60 problems", 60, names="^problem "),
    Gate("plans: pairs of maps and floors found", PAIRS.replace(" 50000", ""),
         r"effort 5000: (\d+) of \d+ found", 48, of=sum, names="effort 5000"),
    *(gate._replace(command=WILLOW.replace(" 50000", ""), names="effort 5000")
      for gate in GATES if gate.name.startswith("willow") and gate.name.endswith("at 5000")),
    Gate("orders of tasks: proven", ORDERS, r"^(\d+) of 36 proven", 36, names="not below"),
    Gate("missions: remedies that hold", "remedies.py 40", r"remedies: (\d+) of 40 hold", 40,
         names="does not hold$"),
    Gate("from path to energy: profiles accepted", FEW, r"100 cases: (\d+) profiles", 100,
         names="^case "),
    Gate("from path to energy: largest difference", FEW, r"integrated energy: ([\de.+-]+)",
         most=1e-5),
)
# fmt: on
"""Gates that every change runs; no table of a page has the seeds of their drives and problems."""


def run(command: str, data: Path) -> Printed:
    """Run a command of a gate."""
    script, *arguments = command.split()
    if "DATA" in command and not data.is_dir():
        return Printed([], skipped=f"{data} is absent")
    if script.startswith("tests/"):
        options = ["-m", "nightly or not nightly", "-q", "-p", "no:cacheprovider"]
        asked = ["-m", "pytest", *options, script, *arguments]
    else:
        pairs = [str(file) for file in sorted((HERE / "pairs").glob("*.json"))]
        asked = [str(HERE / script)]
        for argument in arguments:
            asked += pairs if argument == "PAIRS" else [argument.replace("DATA", str(data))]
    ended = subprocess.run(
        [sys.executable, *asked], cwd=HERE.parent, capture_output=True, text=True, check=False,
        env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},  # sums that no number of cores changes
    )  # fmt: skip
    lines = list(dict.fromkeys(ended.stdout.splitlines()))
    said = (ended.stderr.strip() or ended.stdout.strip() or "nothing said").splitlines()[-1]
    return Printed(lines, f"exit code {ended.returncode}: {said}" if ended.returncode else "")


def judged(gate: Gate, printed: Printed) -> tuple[str, str]:
    """Return the value of a gate's figure, and the verdict."""
    if printed.skipped:
        return "", f"skipped: {printed.skipped}"
    if printed.failed:
        return "", f"FALLS, {printed.failed}"
    found = [match for line in printed.lines if (match := re.search(gate.figure, line))]
    values = [float(match[1]) for match in found]
    values = values and ([float(gate.of(values))] if gate.of else values)
    if not values:
        return "", "FALLS, no such figure was printed"
    holds = all(gate.least <= value <= gate.most for value in values)
    low, high = min(values), max(values)
    value = f"{low:.4g}{gate.unit}" if low == high else f"{low:.4g} to {high:.4g}{gate.unit}"
    return value.removesuffix(", none fails"), "holds" if holds else "FALLS"


def verdicts(gates: Sequence[Gate], jobs: int, data: Path) -> Iterator[str]:
    """Print a line for each gate, and what was at fault beneath it; yield the verdict."""
    begun: dict[str, Future[Printed]] = {}
    commands = list(dict.fromkeys(gate.command for gate in gates))
    width = max(len(gate.name) for gate in gates)
    with ThreadPoolExecutor(jobs) as pool, ThreadPoolExecutor(1) as alone:
        for command in commands:
            if command not in ALONE:
                begun[command] = pool.submit(run, command, data)
        others = list(begun.values())

        def later(command: str) -> Printed:
            for one in others:
                one.exception()  # waits
            return run(command, data)

        begun |= {c: alone.submit(later, c) for c in commands if c in ALONE}
        for gate in gates:
            printed = begun[gate.command].result()
            value, verdict = judged(gate, printed)
            print(f"{gate.name:{width}}  {value:18}  {gate.bounds():28}  {verdict}", flush=True)
            if verdict.startswith("FALLS") and gate.names:
                for line in printed.lines:
                    if re.search(gate.names, line):
                        print(f"    {line}", flush=True)
            yield verdict


def summary(told: Sequence[str]) -> tuple[str, bool]:
    """Return what became of all gates in words, and whether something was tested and none fell."""
    skipped = [verdict for verdict in told if verdict.startswith("skipped")]
    fell = sum(verdict.startswith("FALLS") for verdict in told)
    held = len(told) - fell - len(skipped)
    words = [f"{held} held, {fell} fell, {len(skipped)} skipped", *dict.fromkeys(skipped)]
    return "; ".join(words), held > 0 and not fell


def table(gates: Sequence[Gate]) -> str:
    """Return gates as Markdown."""
    said = {gate.command: gate.name for gate in reversed(gates)}
    rows = [
        f"| {gate.name} | {gate.bounds()} | "
        + (f"`{gate.command}` |" if said[gate.command] == gate.name else "|")
        for gate in gates
    ]
    return "\n".join(["| figure | gate | of |", "|---|---|---|", *rows])


def main() -> None:
    """Run what the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--guards", action="store_true", help="those that every change runs")
    parser.add_argument("--only", default="*", help="names of gates, such as 'willow*'")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--data", type=Path, default=HERE.parents[1] / "shared" / "data")
    parser.add_argument("--write", type=Path, metavar="PAGE.md")
    given = parser.parse_args()
    if given.write:
        write(given.write, "guards", table(GUARDS))
        write(given.write, "gates", table(GATES))
        return
    pattern = given.only if "*" in given.only else f"{given.only}*"
    gates = [gate for gate in (GUARDS if given.guards else GATES) if fnmatch(gate.name, pattern)]
    if not gates:
        parser.error(f"no gate is called {given.only}")
    words, sound = summary(list(verdicts(gates, given.jobs, given.data)))
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    print(f"{words}; {(used.ru_utime + used.ru_stime) / 60:.1f} min of CPU")
    sys.exit(not sound)


if __name__ == "__main__":
    main()
