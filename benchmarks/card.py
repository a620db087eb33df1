"""Make the table of the model card: how well energies of unseen drives are predicted.

``python benchmarks/card.py --data FOLDER --out docs/model_card.md`` writes them between the page's
marks; without ``--out`` it prints them. FOLDER holds ``borealtc``, ``vulpi``, ``drive`` and
``quadriga_mujoco`` as docs/model_card.md tells; without it only the simulated rows are made.
Every row learns from some drives and is judged on others. Nothing is left out of a row: a case that
ends in an error is counted. All rows take about twenty minutes on one core. ``--runs`` makes the
second table alone: one run after the other of a ground left out, and predicted from all others.
``--single`` makes the third one alone: each run is predicted from one other alone.
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.optimize import linprog
from scipy.stats import norm

import energyplan as ep
from energyplan.errors import EnergyPlanError, NotIdentifiableError
from energyplan.fit import fit_residual
from energyplan.io.husky import read_husky
from energyplan.power import TRACTION

SEEDS = range(5)
SHORTEST = 16.0
"""Shortest run that the card counts [s]."""

POINT = 0.01
"""One percentage point."""

NORMAL_MAD = 1.4826
"""Standard deviation of normal values over their median size."""

MARKS = ("<!-- tables: python benchmarks/card.py -->", "<!-- end of tables -->")


class Case(NamedTuple):
    """What was learned from and judged on."""

    robot: str
    ground: str
    train: list[ep.DriveLog]
    judge: list[ep.DriveLog]
    vehicle: ep.Vehicle


class Row(NamedTuple):
    """What came of the cases of one robot and ground."""

    robot: str
    ground: str
    drives: int
    within: int
    before: list[float]
    after: list[float]
    failed: int


def simulated() -> Iterator[Case]:
    """Yield drives of the paper's robot that obey its model, with noise; the easiest case."""
    for ground in ("empty:marble", "empty:concrete", "full:marble", "full:concrete"):
        model = ep.PowerModel.preset(f"quadriga:{ground}")
        for seed in SEEDS:
            noise = {"power_noise": 10.0, "correlation_time": 0.2, "speed_noise": 0.005}
            train = ep.simulate.identification_drive(model, seed=seed, **noise)
            judge = ep.simulate.validation_drive(model, seed=100 + seed, **noise)
            yield Case("Quadriga, simulated by the model", ground.replace(":", ", "), [train],
                       [judge], model.vehicle)  # fmt: skip


def engine(folder: Path) -> Iterator[Case]:
    """Yield drives of a physics engine that uses no equation of the model, with hidden effects."""
    for file in sorted(folder.glob("*_s2_ident.csv.gz")):
        stem = file.name.removesuffix("_ident.csv.gz")
        vehicle = ep.Vehicle.preset("quadriga" if "empty" in stem else "quadriga:full")
        plain = "no hidden effect" if stem.startswith("none") else "one hidden effect each"
        judge = ep.DriveLog.read(folder / f"{stem}_valid.csv.gz")
        yield Case(
            "Quadriga in a physics engine", plain, [ep.DriveLog.read(file)], [judge], vehicle
        )


def warthog(file: Path) -> Iterator[Case]:
    """Yield a real Warthog's drive, cut in two."""
    log = ep.DriveLog.read(file)
    cut = float(log.t[0] + 0.6 * (log.t[-1] - log.t[0]))
    first, last = log.segment(float(log.t[0]), cut), log.segment(cut, float(log.t[-1]))
    yield Case("Warthog, real", "grass", [first], [last], ep.Vehicle.preset("warthog"))


class Run(NamedTuple):
    """A run that was left out: relative errors of its energy."""

    name: str
    two_terms: float
    after: float
    within: bool


def runs_of(folder: Path) -> list[ep.DriveLog]:
    """Return the runs of a ground that are long enough to count."""
    logs = [read_husky(file) for file in sorted(folder.glob("pro_*.csv"))]
    return [log for log in logs if log.duration >= SHORTEST]


def grounds(folder: Path, only: Sequence[str]) -> list[Path]:
    """Return the folders of the grounds that are asked for, or of all."""
    found = {one.name: one for one in (*sorted(folder.glob("borealtc/*/")),
                                       *sorted(folder.glob("vulpi/*/")))}  # fmt: skip
    for name in only:
        if name not in found:
            raise SystemExit(f"no ground {name!r} in {folder}; there are {', '.join(found)}")
    return [found[name] for name in only or found]


def single_table(folder: Path, only: Sequence[str] = ()) -> str:
    """Return how each run is predicted from the one before it alone, as Markdown."""
    lines = [
        "| ground | pairs of runs | error of energy, median | mean | in the 90 % interval "
        "| half width of the interval, median |",
        "|---|---|---|---|---|---|",
    ]
    vehicle, made = ep.Vehicle.preset("husky_a200"), list[tuple[str, float, float, bool]]()
    for ground in grounds(folder, only):
        logs = runs_of(ground)
        for train, unseen in pairwise([logs[-1], *logs]):
            (one,) = ep.diagnose(train, holdout=unseen, vehicle=vehicle).predictions
            low, high = one.energy_interval
            size = abs(one.measured)
            made.append((ground.name, abs(one.energy - one.measured) / size,
                         0.5 * (high - low) / size, low <= one.measured <= high))  # fmt: skip
    for name in (*dict.fromkeys(one[0] for one in made), "all"):
        some = [one[1:] for one in made if name in ("all", one[0])]
        error, half, within = np.array(some, float).T
        lines.append(
            f"| {name.lower().replace('_', ' ')} | {len(some)} | {100 * np.median(error):.0f} % "
            f"| {100 * error.mean():.0f} % | {100 * within.mean():.0f} % "
            f"| {100 * np.median(half):.0f} % |"
        )
    return "\n".join(lines)


def runs_left_out(folder: Path) -> list[Run]:
    """Predict each run of a Husky on one ground from all others: two terms, and diagnosis."""
    vehicle, logs = ep.Vehicle.preset("husky_a200"), runs_of(folder)
    found = []
    for unseen in logs:
        rest = [log for log in logs if log is not unseen]
        told = ep.diagnose(rest, holdout=unseen, vehicle=vehicle)
        (one,) = told.predictions
        low, high = one.energy_interval
        found.append(
            Run(unseen.name, two_terms(rest, unseen, vehicle), one.energy / one.measured - 1.0,
                low <= one.measured <= high)
        )  # fmt: skip
    return found


def two_terms(rest: list[ep.DriveLog], unseen: ep.DriveLog, vehicle: ep.Vehicle) -> float:
    """Relative error of a run's energy by the paper's two terms, least absolute deviations."""
    try:
        model = ep.identify(rest, vehicle).model
    except NotIdentifiableError:  # hardly any turning: the message says to leave the term out
        model = ep.identify(rest, vehicle, terms=(TRACTION,)).model
    return fit_residual(model, unseen).energy_error


def with_hindsight(folder: Path) -> float:
    """Mean relative error of the paper's two terms, chosen for these very runs' energies.

    The least that any K and mu reach that hold for all runs of a ground, whatever they are learned
    from: a linear program. What is left is what the runs differ in.
    """
    vehicle = ep.Vehicle.preset("husky_a200")
    logs = [read_husky(file) for file in sorted(folder.glob("pro_*.csv"))]
    logs = [log for log in logs if log.duration >= SHORTEST]
    one, both = (
        np.array([1.0 + fit_residual(model, log).energy_error for log in logs])
        for model in (ep.PowerModel.paper(vehicle, K=1.0, mu=0.0),
                      ep.PowerModel.paper(vehicle, K=1.0, mu=1.0))
    )  # fmt: skip
    X, identity = np.stack([one, both - one], axis=1), np.eye(len(logs))
    found = linprog(
        np.append(np.zeros(2), np.full(len(logs), 1.0 / len(logs))),
        A_ub=np.block([[X, -identity], [-X, -identity]]),
        b_ub=np.repeat([1.0, -1.0], len(logs)),
    )
    return float(found.fun)


def exact_worse(made: list[Run]) -> float:
    """Return how many runs an exact prediction is expected to lose by a point to two terms.

    Exact but for what makes runs of one ground differ, a normal factor of each run that no channel
    records: of the size that diagnosis misses runs by, in the median, and about its predictions.
    Two terms are the better where that factor leads more than half of the way to theirs.
    """
    scatter = NORMAL_MAD * float(np.median([abs(run.after) for run in made]))
    apart = np.abs([run.two_terms - run.after for run in made])
    chance = norm.sf((apart + POINT) / (2.0 * scatter))
    return float(chance[apart > POINT].sum())


def runs_table(folder: Path, only: Sequence[str] = ()) -> str:
    """Return the table of grounds with runs that were left out, as Markdown."""
    lines = [
        "| ground | runs | two terms | with diagnosis | change | two terms with hindsight "
        "| worse by a point | of an exact one | largest | in the 90 % interval |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for ground in grounds(folder, only):
        made = runs_left_out(ground)
        before, after = (
            np.abs([getattr(run, which) for run in made]) for which in ("two_terms", "after")
        )
        for run in made:
            print(f"  {ground.name} {run.name}: {run.two_terms:+.3f} {run.after:+.3f} {run.within}")
        lines.append(
            f"| {ground.name.lower().replace('_', ' ')} | {len(made)} "
            f"| {100 * before.mean():.1f} % | {100 * after.mean():.1f} % "
            f"| {100 * (after.mean() / before.mean() - 1):+.0f} % "
            f"| {100 * with_hindsight(ground):.1f} % "
            f"| {np.count_nonzero(after > before + POINT)} | {exact_worse(made):.1f} "
            f"| {100 * after.max():.0f} % "
            f"| {sum(run.within for run in made)} of {len(made)} |"
        )
        print(lines[-1], flush=True)
    return "\n".join(lines)


def rows(cases: Iterator[Case]) -> Iterator[Row]:
    """Diagnose each case, and gather those of one robot and ground."""
    found: dict[tuple[str, str], Row] = {}
    for case in cases:
        key = (case.robot, case.ground)
        row = found.setdefault(key, Row(*key, 0, 0, [], [], 0))
        try:
            told = ep.diagnose(case.train, holdout=case.judge, vehicle=case.vehicle)
        except EnergyPlanError as error:
            print(f"{case.robot}, {case.ground}: {error}")
            found[key] = row._replace(failed=row.failed + 1)
            continue
        for log, power, one in zip(case.judge, told.predictions_before, told.predictions,
                                   strict=True):  # fmt: skip
            row.before.append(abs(float(log.weights @ power) / one.measured - 1.0))
            row.after.append(abs(one.energy / one.measured - 1.0))
            low, high = one.energy_interval
            row = row._replace(
                drives=row.drives + 1, within=row.within + (low <= one.measured <= high)
            )
        found[key] = row
    yield from found.values()


def table(made: list[Row]) -> str:
    """Return the rows as a Markdown table."""
    lines = [
        "| robot | ground | drives judged | error of energy, paper's model | with diagnosis "
        "| worst | in the 90 % interval | no answer |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for row in made:
        told = ["-"] * 4
        if row.drives:
            told = [
                f"{100 * np.median(row.before):.1f} %", f"{100 * np.median(row.after):.1f} %",
                f"{100 * max(row.after):.1f} %", f"{row.within} of {row.drives}",
            ]  # fmt: skip
        cells = [row.robot, row.ground, str(row.drives), *told, str(row.failed)]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def main() -> None:
    """Make the table; print it or write it into the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, help="folder of recorded drives")
    parser.add_argument("--out", type=Path, help="page whose table is made anew")
    parser.add_argument(
        "--runs", nargs="*", metavar="GROUND", help="runs left out alone, of these grounds or all"
    )
    parser.add_argument(
        "--single", nargs="*", metavar="GROUND", help="runs predicted from one other alone"
    )
    asked = parser.parse_args()
    if asked.single is not None:
        print(single_table(asked.data, asked.single))
        return
    if asked.runs is not None:
        print(runs_table(asked.data, asked.runs))
        return
    made = list(rows(simulated()))
    if asked.data:
        made += rows(warthog(asked.data / "drive" / "warthog_grass.csv"))
        made += rows(engine(asked.data / "quadriga_mujoco"))
    text = table(made)
    if asked.data:
        text += "\n\n" + runs_table(asked.data) + "\n\n" + single_table(asked.data)
    if asked.out is None:
        print(text)
        return
    page = asked.out.read_text()
    pattern = re.compile(f"{re.escape(MARKS[0])}.*?{re.escape(MARKS[1])}", re.DOTALL)
    asked.out.write_text(pattern.sub(lambda _: f"{MARKS[0]}\n{text}\n{MARKS[1]}", page))


if __name__ == "__main__":
    main()
