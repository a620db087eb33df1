"""How well energies of real runs are predicted from the others of their ground.

``python benchmarks/real.py FOLDER [GROUND ...]`` leaves out one run after the other of every ground
and prints a line for each ground (each run is told on stderr): mean size of the relative error of a
run's energy by the paper's two terms and by the model that diagnosis hands on, both learned from
the other runs, and how many 90 % intervals hold the measured energy. FOLDER holds ``borealtc``,
``vulpi`` and ``drive`` as docs/model_card.md tells. A ground that is one long drive is cut into
parts of equal length, and parts in which the robot hardly moves are left out of the errors, not of
the training.
``--rest`` predicts what is left of each run after its first quarter instead: by two terms of the
former runs alone, and as `energyplan.watch` does, with this run's factor.
``--driven`` predicts the trajectories of closed-loop drives of a physics engine, FOLDER, from the
drives of the other routes: NAME_K_ROUTE.csv.gz with NAME_K_ROUTE_trajectory.csv, K the pair of
poses that is left out, for a robot whose sides push against each other.
All grounds take about ten minutes on one core.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np

import energyplan as ep
from energyplan.errors import NotIdentifiableError
from energyplan.fit import fit_residual
from energyplan.fit.online import RunMemory
from energyplan.io.husky import read_husky
from energyplan.io.tables import read_trajectory
from energyplan.power import TRACTION

SHORTEST = 16.0
"""Shortest run that is predicted [s]."""

PARTS = {"MIXED": 8, "WARTHOG_GRASS": 5, "WARTHOG_GRASS_2": 5}
"""Parts that a single drive is cut into."""

IDLE = 0.1
"""Share of the usual power below which a part tells no relative error."""


class Ground(NamedTuple):
    """Runs of one robot on one ground."""

    name: str
    runs: list[ep.DriveLog]
    vehicle: ep.Vehicle


class Row(NamedTuple):
    """Relative errors of the runs of a ground that were left out."""

    two_terms: list[float]
    handed_on: list[float]
    within: list[bool]

    def line(self, name: str) -> str:
        """Return the row as a line of Markdown."""
        before, after = (100.0 * float(np.mean(np.abs(errors))) for errors in self[:2])
        return (
            f"| {name.lower().replace('_', ' ')} | {len(self.within)} | {before:.1f} % "
            f"| {after:.1f} % | {after / before:.2f} | {sum(self.within)} of {len(self.within)} |"
        )


def grounds(folder: Path) -> Iterator[Ground]:
    """Yield the grounds that have two runs or more."""
    husky, warthog = (ep.Vehicle.preset(name) for name in ("husky_a200", "warthog"))
    for place in (*sorted(folder.glob("borealtc/*/")), *sorted(folder.glob("vulpi/*/"))):
        logs = [read_husky(file) for file in sorted(place.glob("pro_*.csv"))]
        yield Ground(place.name, parts_of(place.name, logs), husky)
    for file in sorted(folder.glob("drive/warthog*.csv")):
        name = file.stem.upper()
        yield Ground(name, parts_of(name, [ep.DriveLog.read(file)]), warthog)


def parts_of(name: str, logs: list[ep.DriveLog]) -> list[ep.DriveLog]:
    """Return the runs that are long enough, and one long drive in parts."""
    if len(logs) == 1:
        (log,) = logs
        cuts = np.linspace(log.t[0], log.t[-1], PARTS.get(name, 5) + 1).tolist()
        logs = [log.segment(a, b) for a, b in pairwise(cuts)]
    return [log for log in logs if log.duration >= SHORTEST]


def two_terms(rest: list[ep.DriveLog], vehicle: ep.Vehicle) -> ep.PowerModel:
    """Fit the paper's two terms by least absolute deviations."""
    try:
        return ep.identify(rest, vehicle).model
    except NotIdentifiableError:  # hardly any turning: the message says to leave the term out
        return ep.identify(rest, vehicle, terms=(TRACTION,)).model


def left_out(ground: Ground) -> Row:
    """Predict each run from all others."""
    row = Row([], [], [])
    usual = np.median([log.energy / log.duration for log in ground.runs])
    for unseen in ground.runs:
        if not unseen.energy > IDLE * usual * unseen.duration:
            continue
        rest = [log for log in ground.runs if log is not unseen]
        told = ep.diagnose(rest, unseen, ground.vehicle)
        (one,) = told.predictions
        low, high = one.energy_interval
        row.two_terms.append(fit_residual(two_terms(rest, ground.vehicle), unseen).energy_error)
        row.handed_on.append(one.energy / one.measured - 1.0)
        row.within.append(low <= one.measured <= high)
        print(
            f"  {unseen.name}: {row.two_terms[-1]:+.3f} {row.handed_on[-1]:+.3f} {row.within[-1]} "
            f"half {0.5 * (high - low) / one.measured:.2f} {told.average}",
            file=sys.stderr,
        )
    return row


def rest_of_runs(ground: Ground) -> str:
    """Predict what is left of each run after its first quarter; a line of Markdown."""
    alone, watched = list[float](), list[float]()
    usual = np.median([log.energy / log.duration for log in ground.runs])
    for run in ground.runs:
        former = [log for log in ground.runs if log is not run]
        cut = float(run.t[0]) + 0.25 * run.duration
        first, left = run.segment(float(run.t[0]), cut), run.segment(cut, float(run.t[-1]))
        if not left.energy > IDLE * usual * left.duration:
            continue
        model = two_terms(former, ground.vehicle)
        so_far, error = (fit_residual(model, log).energy_error for log in (first, left))
        memory = RunMemory.of(former, model)
        factor = memory.factor(first.energy, first.energy * (1.0 + so_far))
        alone.append(error)
        watched.append(factor * (1.0 + error) - 1.0)
    before, after = (100.0 * float(np.mean(np.abs(errors))) for errors in (alone, watched))
    return (
        f"| {ground.name.lower().replace('_', ' ')} | {len(alone)} | {before:.1f} % "
        f"| {after:.1f} % | {after / before:.2f} |"
    )


def closed_loop(folder: Path) -> Iterator[str]:
    """Predict trajectories of each pair of poses from the drives of the others, by scenario."""
    vehicle = ep.Vehicle.preset("quadriga:full")
    found: dict[str, dict[str, list[str]]] = {}
    for file in sorted(folder.glob("*_trajectory.csv")):
        scenario, pair, route = file.stem.removesuffix("_trajectory").rsplit("_", 2)
        found.setdefault(scenario, {}).setdefault(pair, []).append(f"{scenario}_{pair}_{route}")
    for scenario, pairs in found.items():
        logs = {
            name: ep.DriveLog.read(folder / f"{name}.csv.gz")
            for names in pairs.values() for name in names
        }  # fmt: skip
        for pair, names in pairs.items():
            rest = [log for name, log in logs.items() if name not in names]
            told = ep.diagnose(rest, [logs[name] for name in names], vehicle)
            plain = two_terms(rest, vehicle)
            for name, one in zip(names, told.predictions, strict=True):
                asked = read_trajectory(folder / f"{name}_trajectory.csv")
                before, after = (
                    100.0 * (ep.check(asked, model).energy / logs[name].energy - 1.0)
                    for model in (plain, told.model)
                )
                low, high = (end / one.measured for end in one.energy_interval)
                yield (
                    f"| {scenario.replace('_', ' ')} | {pair} | {before:+.1f} % | {after:+.1f} % "
                    f"| {low:.2f} to {high:.2f} |"
                )


def main() -> None:
    """Print a line for each ground, and one for all."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("grounds", nargs="*", help="names of grounds; all where none is given")
    parser.add_argument("--rest", action="store_true", help="predict the rest of each run")
    parser.add_argument("--driven", action="store_true", help="predict closed-loop drives")
    asked = parser.parse_args()
    rows = []
    if asked.driven:
        print("| effect | pair left out | two terms | handed on | 90 % interval over measured |")
        print("|---|---|---|---|---|")
        for line in closed_loop(asked.folder):
            print(line, flush=True)
        return
    if not asked.rest:
        print("| ground | runs | two terms | handed on | ratio | in the 90 % interval |")
        print("|---|---|---|---|---|---|")
    for ground in grounds(asked.folder):
        if asked.grounds and ground.name not in asked.grounds:
            continue
        if asked.rest:
            print(rest_of_runs(ground), flush=True)
            continue
        row = left_out(ground)
        rows.append(row)
        print(row.line(ground.name), flush=True)
    if rows:
        means = np.array([[np.mean(np.abs(errors)) for errors in row[:2]] for row in rows])
        within = [one for row in rows for one in row.within]
        print(
            f"ratio of the sums over grounds {means[:, 1].sum() / means[:, 0].sum():.2f}, "
            f"mean of the ratios {np.mean(means[:, 1] / means[:, 0]):.2f}; "
            f"in the interval {100 * np.mean(within):.0f} % of {len(within)}"
        )


if __name__ == "__main__":
    main()
