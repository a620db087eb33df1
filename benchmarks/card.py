"""Make the tables of the model card: how well energies of drives that were left out are predicted.

    python benchmarks/card.py FOLDER [TABLE...] [--ground NAME...] [--write docs/model_card.md]

FOLDER holds the data that docs/model_card.md lists; each TABLE, by default all, goes between its
marks in the page or is printed:

    grounds      each real run from the others of its ground, and what is left of it after a quarter
    closed_loop  trajectories of a physics engine from the drives between other poses
    other        simulated drives, and the engine's with one hidden effect each
    single       each real run from the one before it alone

A case that ends in an error is counted. Every run is told on stderr. All take about half an hour.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import sys
from collections.abc import Callable, Iterator
from functools import cache, partial
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np
from pages import write
from scipy.optimize import linprog

import energyplan as ep
from energyplan.errors import EnergyPlanError, NotIdentifiableError
from energyplan.fit import fit_residual
from energyplan.fit.online import RunMemory
from energyplan.io.husky import read_husky
from energyplan.io.tables import read_trajectory
from energyplan.power import TRACTION

SHORTEST = 16.0
"""Shortest run that is predicted [s]."""

PARTS = {"MIXED": 8}
"""Parts that a single drive is cut into, where they are not `USUAL_PARTS`."""

USUAL_PARTS = 5

IDLE = 0.1
"""Share of the usual power below which a part tells no relative error."""

POINT = 0.01
"""One percentage point."""

SEEDS = range(5)


# -- real runs -------------------------------------------------------------------------------------


class Ground(NamedTuple):
    """Runs of one robot on one ground."""

    name: str
    runs: list[ep.DriveLog]
    vehicle: ep.Vehicle

    def judged(self) -> Iterator[ep.DriveLog]:
        """Yield the runs in which the robot moves."""
        usual = np.median([log.energy / log.duration for log in self.runs])
        return (log for log in self.runs if log.energy > IDLE * usual * log.duration)


def grounds(folder: Path, only: list[str]) -> Iterator[Ground]:
    """Yield the grounds that are asked for, or all."""
    husky, warthog = (ep.Vehicle.preset(name) for name in ("husky_a200", "warthog"))
    places = [*sorted(folder.glob("borealtc/*/")), *sorted(folder.glob("vulpi/*/"))]
    files = sorted(folder.glob("drive/warthog*.csv"))
    known = [place.stem.upper() for place in (*places, *files)]
    if unknown := [name for name in only if name not in known]:
        raise SystemExit(f"no ground {unknown[0]!r} in {folder}; there are {', '.join(known)}")
    for place, name in zip((*places, *files), known, strict=True):
        if name in (only or known):
            real = place.is_dir()
            logs = [read_husky(file) for file in sorted(place.glob("pro_*.csv"))] if real else [
                ep.DriveLog.read(place)
            ]  # fmt: skip
            yield Ground(name, runs_of(name, logs), husky if real else warthog)


def runs_of(name: str, logs: list[ep.DriveLog]) -> list[ep.DriveLog]:
    """Return the runs that are long enough, and one long drive in parts."""
    if len(logs) == 1:
        (log,) = logs
        cuts = np.linspace(log.t[0], log.t[-1], PARTS.get(name, USUAL_PARTS) + 1).tolist()
        logs = [log.segment(a, b) for a, b in pairwise(cuts)]
    return [log for log in logs if log.duration >= SHORTEST]


def two_terms(rest: list[ep.DriveLog], vehicle: ep.Vehicle) -> ep.PowerModel:
    """Fit the paper's two terms by least absolute deviations."""
    try:
        return ep.identify(rest, vehicle).model
    except NotIdentifiableError:  # hardly any turning: the message says to leave the term out
        return ep.identify(rest, vehicle, terms=(TRACTION,)).model


class Run(NamedTuple):
    """Relative errors of the energy of a run that was left out, and of its last three quarters."""

    two_terms: float
    handed_on: float
    within: bool  # whether the 90 % interval holds the measured energy
    rest: float  # of the last three quarters, by the two terms
    rest_factored: float  # of the same, with the factor of the first quarter


KINDS = ("diagnosis", "fit", "logs", "power")
"""Folders of the package that predictions of runs come from."""


@cache
def version() -> str:
    """Return a digest of what predicts runs, by which kept predictions are known to be its own."""
    place = Path(ep.__file__).parent
    files = [file for kind in KINDS for file in sorted((place / kind).rglob("*.py"))]
    text = b"".join(file.read_bytes() for file in (*files, place / "io" / "husky.py"))
    return hashlib.sha256(text).hexdigest()[:12]


def kept_runs(file: Path | None, ground: str) -> dict[str, Run]:
    """Return the runs of a ground that this version has predicted before, by name."""
    if file is None or not file.exists():
        return {}
    rows = map(json.loads, file.read_text(encoding="utf-8").splitlines())
    return {
        name: Run(*values) for by, place, name, *values in rows
        if (by, place) == (version(), ground)
    }  # fmt: skip


def left_out(ground: Ground, kept: Path | None = None) -> list[Run]:
    """Predict each run from all others; what is kept in a file is not predicted again."""
    made, known = [], kept_runs(kept, ground.name)
    for number, run in enumerate(ground.judged()):
        name = f"{number} {run.name}"
        if name in known:
            made.append(known[name])
            continue
        former = [log for log in ground.runs if log is not run]
        (told,) = ep.diagnose(former, run, ground.vehicle).predictions
        low, high = told.energy_interval
        model = two_terms(former, ground.vehicle)
        cut = float(run.t[0]) + 0.25 * run.duration
        first, left = run.segment(float(run.t[0]), cut), run.segment(cut, float(run.t[-1]))
        so_far, rest = (fit_residual(model, log).energy_error for log in (first, left))
        factor = RunMemory.of(former, model).factor(first.energy, first.energy * (1.0 + so_far))
        made.append(
            Run(fit_residual(model, run).energy_error, told.energy / told.measured - 1.0,
                low <= told.measured <= high, rest, factor * (1.0 + rest) - 1.0)
        )  # fmt: skip
        print(f"  {run.name}: {made[-1]}", file=sys.stderr, flush=True)
        if kept is not None:
            row = [version(), ground.name, name, *map(float, made[-1][:2]), bool(made[-1].within),
                   *map(float, made[-1][3:])]  # fmt: skip
            with kept.open("a", encoding="utf-8") as file:
                file.write(json.dumps(row) + "\n")
    return made


def with_hindsight(ground: Ground) -> float:
    """Mean relative error of the paper's two terms, chosen for these very runs' energies.

    The least that any K and mu reach that hold for all runs of a ground, whatever they are learned
    from: a linear program. What is left is what the runs differ in.
    """
    runs = list(ground.judged())
    one, both = (
        np.array([1.0 + fit_residual(model, log).energy_error for log in runs])
        for model in (ep.PowerModel.paper(ground.vehicle, K=1.0, mu=0.0),
                      ep.PowerModel.paper(ground.vehicle, K=1.0, mu=1.0))
    )  # fmt: skip
    X, identity = np.stack([one, both - one], axis=1), np.eye(len(runs))
    found = linprog(
        np.append(np.zeros(2), np.full(len(runs), 1.0 / len(runs))),
        A_ub=np.block([[X, -identity], [-X, -identity]]),
        b_ub=np.repeat([1.0, -1.0], len(runs)),
    )
    return float(found.fun)


def grounds_table(
    folder: Path, only: list[str], kept: Path | None = None
) -> Iterator[str]:  # fmt: skip
    """Yield a line for each ground, and one for all."""
    yield (
        "| ground | runs | two terms | with hindsight | handed on | ratio | largest "
        "| in the 90 % interval | rest of the run | with its factor | ratio |"
    )
    yield "|---|---|---|---|---|---|---|---|---|---|---|"
    means, every = list[np.ndarray](), list[Run]()
    for ground in grounds(folder, only):
        made = left_out(ground, kept)
        every += made
        size = np.abs(np.array(made, float))
        means.append(size.mean(axis=0))
        name = ground.name.lower().replace("_", " ")
        yield _line(name, made, means[-1], with_hindsight(ground), float(size[:, 1].max()))
    sums = np.mean(means, axis=0)
    yield _line("mean of all", every, sums, None, None)
    worse = sum(abs(run.handed_on) > abs(run.two_terms) + POINT for run in every)
    yield ""
    yield f"{worse} of {len(every)} runs are predicted worse by more than a point than by the two."


def _line(
    name: str, made: list[Run], mean: np.ndarray, hindsight: float | None, largest: float | None
) -> str:
    percent = ["-" if one is None else f"{100 * one:.1f} %" for one in
               (mean[0], hindsight, mean[1], largest, mean[3], mean[4])]  # fmt: skip
    before, best, after, most, rest, factored = percent
    held = sum(run.within for run in made)
    cells = (
        name, len(made), before, best, after, f"{mean[1] / mean[0]:.2f}", most,
        f"{held} of {len(made)} ({100 * held / len(made):.0f} %)", rest, factored,
        f"{mean[4] / mean[3]:.2f}",
    )  # fmt: skip
    return f"| {' | '.join(map(str, cells))} |"


def single_table(folder: Path, only: list[str]) -> Iterator[str]:
    """Yield how each run is predicted from the one before it alone, the first from the last."""
    yield (
        "| ground | pairs of runs | error of energy, median | mean | in the 90 % interval "
        "| half width of the interval, median |"
    )
    yield "|---|---|---|---|---|---|"
    every = list[tuple[float, float, bool]]()
    for ground in grounds(folder, only):
        made = list[tuple[float, float, bool]]()
        runs = list(ground.judged())
        for train, unseen in pairwise([runs[-1], *runs]):
            (one,) = ep.diagnose(train, holdout=unseen, vehicle=ground.vehicle).predictions
            low, high = one.energy_interval
            made.append((abs(one.energy / one.measured - 1.0), 0.5 * (high - low) / one.measured,
                         low <= one.measured <= high))  # fmt: skip
        every += made
        yield _single(ground.name.lower().replace("_", " "), made)
    yield _single("all", every)


def _single(name: str, made: list[tuple[float, float, bool]]) -> str:
    error, half, within = np.array(made, float).T
    return (
        f"| {name} | {len(made)} | {100 * np.median(error):.0f} % | {100 * error.mean():.0f} % "
        f"| {100 * within.mean():.0f} % | {100 * np.median(half):.0f} % |"
    )


# -- drives of the model and of a physics engine ---------------------------------------------------


def closed_loop_table(folder: Path, _: list[str]) -> Iterator[str]:
    """Yield how the trajectories of each pair of poses follow from drives between the others."""
    yield "| effect | pair left out | two terms | handed on | 90 % interval over measured |"
    yield "|---|---|---|---|---|"
    vehicle = ep.Vehicle.preset("quadriga:full")
    place, found = folder / "driven", dict[str, dict[str, list[str]]]()
    for file in sorted(place.glob("*_trajectory.csv")):
        scenario, pair, route = file.stem.removesuffix("_trajectory").rsplit("_", 2)
        found.setdefault(scenario, {}).setdefault(pair, []).append(f"{scenario}_{pair}_{route}")
    for scenario, pairs in found.items():
        logs = {
            name: ep.DriveLog.read(place / f"{name}.csv.gz")
            for names in pairs.values() for name in names
        }  # fmt: skip
        for pair, names in pairs.items():
            rest = [log for name, log in logs.items() if name not in names]
            told = ep.diagnose(rest, [logs[name] for name in names], vehicle)
            plain = two_terms(rest, vehicle)
            for name, one in zip(names, told.predictions, strict=True):
                wanted = read_trajectory(place / f"{name}_trajectory.csv")
                before, after = (
                    100.0 * (ep.check(wanted, model).energy / logs[name].energy - 1.0)
                    for model in (plain, told.model)
                )
                low, high = (end / one.measured for end in one.energy_interval)
                yield (
                    f"| {scenario.replace('_', ' ')} | {pair} | {before:+.1f} % | {after:+.1f} % "
                    f"| {low:.2f} to {high:.2f} |"
                )


class Case(NamedTuple):
    """A drive to learn from, and one to be judged on."""

    robot: str
    ground: str
    train: ep.DriveLog
    judge: ep.DriveLog
    vehicle: ep.Vehicle


def simulated() -> Iterator[Case]:
    """Yield drives of the paper's robot that obey its model, with noise; the easiest case."""
    noise = {"power_noise": 10.0, "correlation_time": 0.2, "speed_noise": 0.005}
    for ground in ("empty:marble", "empty:concrete", "full:marble", "full:concrete"):
        model = ep.PowerModel.preset(f"quadriga:{ground}")
        for seed in SEEDS:
            train = ep.simulate.identification_drive(model, seed=seed, **noise)
            judge = ep.simulate.validation_drive(model, seed=100 + seed, **noise)
            yield Case("Quadriga, simulated by the model", ground.replace(":", ", "), train, judge,
                       model.vehicle)  # fmt: skip


def engine(folder: Path) -> Iterator[Case]:
    """Yield drives of a physics engine that uses no equation of the model, with hidden effects."""
    for file in sorted(folder.glob("quadriga_mujoco/*_s2_ident.csv.gz")):
        stem = file.name.removesuffix("_ident.csv.gz")
        vehicle = ep.Vehicle.preset("quadriga" if "empty" in stem else "quadriga:full")
        plain = "no hidden effect" if stem.startswith("none") else "one hidden effect each"
        judge = ep.DriveLog.read(file.with_name(f"{stem}_valid.csv.gz"))
        yield Case("Quadriga in a physics engine", plain, ep.DriveLog.read(file), judge, vehicle)


def other_table(folder: Path, _: list[str]) -> Iterator[str]:
    """Yield a line for each robot and ground."""
    yield (
        "| robot | ground | drives judged | error of energy, paper's model | with diagnosis "
        "| worst | in the 90 % interval | no answer |"
    )
    yield "|---|---|---|---|---|---|---|---|"
    rows: dict[tuple[str, str], list[tuple[float, float, bool] | None]] = {}
    for case in (*simulated(), *engine(folder)):
        row = rows.setdefault((case.robot, case.ground), [])
        try:
            told = ep.diagnose(case.train, holdout=case.judge, vehicle=case.vehicle)
        except EnergyPlanError as error:
            print(f"  {case.robot}, {case.ground}: {error}", file=sys.stderr)
            row.append(None)
            continue
        (one,), (power,) = told.predictions, told.predictions_before
        low, high = one.energy_interval
        row.append((abs(float(case.judge.weights @ power) / one.measured - 1.0),
                    abs(one.energy / one.measured - 1.0), low <= one.measured <= high))  # fmt: skip
    for (robot, ground), row in rows.items():
        judged = [one for one in row if one is not None]
        before, after, within = np.array(judged, float).reshape(-1, 3).T
        yield (
            f"| {robot} | {ground} | {len(judged)} | {100 * np.median(before):.1f} % "
            f"| {100 * np.median(after):.1f} % | {100 * after.max():.1f} % "
            f"| {within.sum():.0f} of {len(judged)} | {len(row) - len(judged)} |"
        )


TABLES: dict[str, Callable[[Path, list[str]], Iterator[str]]] = {
    "grounds": grounds_table,
    "closed_loop": closed_loop_table,
    "other": other_table,
    "single": single_table,
}


def main() -> None:
    """Make the tables that are asked for; print them and write them into the page."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path, metavar="FOLDER")
    parser.add_argument("tables", nargs="*", metavar="TABLE", help=", ".join(TABLES))
    parser.add_argument("--ground", nargs="*", default=[], help="names of grounds, such as MIXED")
    parser.add_argument(
        "--keep", type=Path, metavar="FILE",
        help="file that keeps predicted runs of grounds, and saves those of the same version",
    )  # fmt: skip
    parser.add_argument("--write", type=Path, metavar="PAGE", help="page with the tables' marks")
    given = parser.parse_args()
    if unknown := [name for name in given.tables if name not in TABLES]:
        parser.error(f"no table is called {unknown[0]}; there are {', '.join(TABLES)}")
    tables = TABLES | {"grounds": partial(grounds_table, kept=given.keep)}
    for name in given.tables or TABLES:
        lines = []
        for line in tables[name](given.folder, given.ground):
            print(line, flush=True)
            lines.append(line)
        if given.write is not None:
            write(given.write, name, "\n".join(lines))


if __name__ == "__main__":
    main()
