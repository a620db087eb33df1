"""Compare the model that is handed on with plain fits on real runs, each predicted from the others.

    python benchmarks/plain.py FOLDER [--ground NAME...] [--keep FILE] [--write docs/model_card.md]

FOLDER holds the data that docs/model_card.md lists. The columns are the mean size of the relative
error of a run's energy by

    two terms         `identify`
    handed on         `diagnose`
    ridge, LAD        six features by least squares with a penalty, and by least absolute errors
    boosting          trees of speed, turn and acceleration, by absolute errors
    process           a Gaussian process on what two terms leave
    with hindsight    the K and mu that fit these very energies best

Features are means over a second of |v_l| + |v_r|, |d|, v_l^2 + v_r^2, v dv/dt,
|d v| / (|v| + 1.5 |d|) and 1, with d = v_r - v_l. They and all settings are the same on every
ground; penalties are chosen by leaving out a run that is learned from.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from card import Ground, grounds, left_out, two_terms, with_hindsight
from numpy.typing import NDArray
from pages import write
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import minimize
from scipy.spatial.distance import cdist

import energyplan as ep
from energyplan.fit.drive import Drive
from energyplan.fit.solvers import Bounds, lad

Array = NDArray[np.float64]

WINDOW = 1.0
"""Length of a window [s]."""

MOBILISATION = 1.5
"""Radius of a turn, over that of the difference of the speeds, at which friction is half there."""

PENALTIES = np.logspace(-4.0, 2.0, 13)
"""Penalties of the ridge, for features of unit deviation, by row."""

ROUNDS, RATE, DEPTH, BINS, SMALLEST = 150, 0.1, 3, 32, 10
"""Of boosting: trees, step, depth, bins of a feature, and windows in a leaf."""

POINTS, TRIED = 350, 120
"""Windows that a Gaussian process learns from, and those that its scales are chosen by."""


class Windows(NamedTuple):
    """Means of a run over windows."""

    features: Array  # (w, 6)
    motion: Array  # (w, 3): |v|, |d|, dv/dt
    power: Array  # (w,) [W]
    paper: Array  # (w,): what two terms say [W]; zero before they are fitted
    time: Array  # (w,): [s]

    @classmethod
    def of(cls, log: ep.DriveLog, vehicle: ep.Vehicle, paper: ep.PowerModel | None) -> Windows:
        """Average a run."""
        drive = Drive.of(log, vehicle)
        left, right = drive.motion.v_left, drive.motion.v_right
        v, d, rise = 0.5 * (left + right), right - left, drive.motion.channels["accel"]
        part = np.abs(d * v) / np.maximum(np.abs(v) + MOBILISATION * np.abs(d), 1e-9)
        said = np.zeros(len(v)) if paper is None else paper.power(drive.motion)
        every = np.column_stack([
            np.abs(left) + np.abs(right), np.abs(d), left**2 + right**2, v * rise, part,
            np.ones(len(v)), np.abs(v), np.abs(d), rise, drive.power, said,
        ])  # fmt: skip
        window = (drive.t / WINDOW).astype(int)
        time = np.bincount(window, drive.weights)
        sums = np.stack([np.bincount(window, drive.weights * one) for one in every.T], axis=1)
        means = sums[time > 0.0] / time[time > 0.0, None]
        return cls(means[:, :6], means[:, 6:9], means[:, 9], means[:, 10], time[time > 0.0])


def together(runs: Sequence[Windows]) -> Windows:
    """Return the windows of several runs."""
    return Windows(*map(np.concatenate, zip(*runs, strict=True)))


Predict = Callable[[Windows], Array]


def ridge(runs: Sequence[Windows]) -> Predict:
    """Fit six features by least squares; a penalty holds all but the constant."""
    spread = np.std(together(runs).features, axis=0)
    scale = np.where(spread > 1e-9, spread, 1.0)
    held = np.append(np.ones(len(scale) - 1), 0.0)

    def fitted(some: Sequence[Windows], penalty: float) -> Array:
        rows = together(some)
        X = rows.features / scale
        return np.linalg.solve(
            X.T @ X + np.diag(penalty * len(X) * held + 1e-9), X.T @ rows.power
        ) / scale  # fmt: skip

    def missed(penalty: float) -> float:
        others = ((one, [run for run in runs if run is not one]) for one in runs)
        return sum(
            float(one.time @ (one.features @ fitted(rest, penalty) - one.power) ** 2)
            for one, rest in others
        )

    best = min(PENALTIES, key=missed) if len(runs) > 1 else PENALTIES[0]
    values = fitted(runs, best)
    return lambda run: run.features @ values


def least_absolute(runs: Sequence[Windows]) -> Predict:
    """Fit six features by least absolute errors."""
    rows, free = together(runs), np.full(6, np.inf)
    values = lad(rows.features, rows.power, Bounds(-free, free))
    return lambda run: run.features @ values


class Node(NamedTuple):
    """A node of a tree: what is below a limit of a feature goes to one side."""

    value: float
    feature: int = -1
    limit: float = 0.0
    below: Node | None = None
    above: Node | None = None

    def of(self, X: Array) -> Array:
        """Return the value of the leaf of each row."""
        if self.below is None or self.above is None:
            return np.full(len(X), self.value)
        below = X[:, self.feature] <= self.limit
        found = np.empty(len(X))
        found[below], found[~below] = self.below.of(X[below]), self.above.of(X[~below])
        return found


def grown(X: Array, rest: Array, limits: Sequence[Array], depth: int) -> Node:
    """Grow a tree that parts the signs of what is left; a leaf is the median of it."""
    leaf = Node(float(np.median(rest)))
    if depth == 0 or len(rest) < 2 * SMALLEST:
        return leaf
    best, sign = (0.0, -1, 0.0), np.sign(rest)
    for k, steps in enumerate(limits):
        at = np.searchsorted(steps, X[:, k], side="left")
        count = np.cumsum(np.bincount(at, minlength=len(steps) + 1))[:-1]
        total = np.cumsum(np.bincount(at, sign, minlength=len(steps) + 1))[:-1]
        other = len(rest) - count
        there = (count >= SMALLEST) & (other >= SMALLEST)
        gain = total**2 / np.maximum(count, 1) + (sign.sum() - total) ** 2 / np.maximum(other, 1)
        gain = np.where(there, gain - sign.sum() ** 2 / len(rest), 0.0)
        if len(gain) and gain.max() > best[0]:
            best = float(gain.max()), k, float(steps[gain.argmax()])
    _, feature, limit = best
    if feature < 0:
        return leaf
    below = X[:, feature] <= limit
    sides = (grown(X[some], rest[some], limits, depth - 1) for some in (below, ~below))
    return Node(leaf.value, feature, limit, *sides)


def boosted(runs: Sequence[Windows]) -> Predict:
    """Boost trees of the motion by absolute errors."""
    rows = together(runs)
    inner = np.linspace(0.0, 1.0, BINS + 1)[1:-1]
    limits = [np.unique(np.quantile(one, inner)) for one in rows.motion.T]
    start = float(np.median(rows.power))
    said, trees = np.full(len(rows.power), start), list[Node]()
    for _ in range(ROUNDS):
        trees.append(grown(rows.motion, rows.power - said, limits, DEPTH))
        said += RATE * trees[-1].of(rows.motion)
    return lambda run: start + RATE * np.sum([one.of(run.motion) for one in trees], axis=0)


def process(runs: Sequence[Windows]) -> Predict:
    """Predict what two terms leave by a Gaussian process of the motion."""
    rows, draw = together(runs), np.random.default_rng(0)
    scale = np.where(np.std(rows.motion, axis=0) > 1e-9, np.std(rows.motion, axis=0), 1.0)
    some = np.sort(draw.permutation(len(rows.power))[:POINTS])
    X, rest = rows.motion[some] / scale, (rows.power - rows.paper)[some]
    size = float(np.std(rest)) or 1.0
    fewer = np.sort(draw.permutation(len(some))[:TRIED])

    def kernel(a: Array, b: Array, scales: Array) -> Array:
        near = cdist(a / np.exp(scales[:3]), b / np.exp(scales[:3]), "sqeuclidean")
        return np.asarray(np.exp(2.0 * scales[3] - 0.5 * near))

    def misfit(scales: Array) -> float:
        K = kernel(X[fewer], X[fewer], scales)
        K[np.diag_indices_from(K)] += np.exp(2.0 * scales[4]) + 1e-8
        root, y = np.linalg.cholesky(K), rest[fewer] / size
        white = np.linalg.solve(root, y)
        usual = float(np.sum((scales / 2.0) ** 2))  # a wide prior of the logarithms
        return 0.5 * float(white @ white) + float(np.log(np.diag(root)).sum()) + 0.5 * usual

    found = minimize(
        misfit, np.array([0.0, 0.0, 0.0, -0.5, -0.5]), method="L-BFGS-B", bounds=[(-4.0, 4.0)] * 5
    ).x
    K = kernel(X, X, found) + (np.exp(2.0 * found[4]) + 1e-8) * np.eye(len(X))
    weights = cho_solve(cho_factor(K), rest)
    return lambda run: run.paper + kernel(run.motion / scale, X, found) @ weights


PLAIN: dict[str, Callable[[Sequence[Windows]], Predict]] = {
    "ridge": ridge, "LAD": least_absolute, "boosting": boosted, "process": process,
}  # fmt: skip


def errors(ground: Ground) -> Iterator[tuple[float, ...]]:
    """Yield the relative errors of each run by the plain fits."""
    for run in ground.judged():
        former = [log for log in ground.runs if log is not run]
        paper = two_terms(former, ground.vehicle)
        *learned, unseen = (
            Windows.of(log, ground.vehicle, paper) for log in (*former, run)
        )  # fmt: skip
        energy = float(unseen.time @ unseen.power)
        yield tuple(
            float(unseen.time @ fit(learned)(unseen)) / energy - 1.0 for fit in PLAIN.values()
        )


def lines(folder: Path, only: list[str], kept: Path | None) -> Iterator[str]:
    """Yield a line for each ground, and the means of all."""
    heads = ("ground", "runs", "two terms", "handed on", *PLAIN, "with hindsight")
    yield f"| {' | '.join(heads)} |"
    yield "|---" * len(heads) + "|"
    every = list[Array]()
    for ground in grounds(folder, only):
        plain = np.mean(np.abs(list(errors(ground))), axis=0)
        print(ground.name, dict(zip(PLAIN, plain.round(4), strict=True)), file=sys.stderr)
        made = left_out(ground, kept)
        ours = np.mean(np.abs([(run.two_terms, run.handed_on) for run in made]), axis=0)
        every.append(np.array([*ours, *plain, with_hindsight(ground)]))
        yield line(ground.name.lower().replace("_", " "), len(made), every[-1])
    yield line("mean of all", "", np.mean(every, axis=0))


def line(name: str, count: int | str, sizes: Array) -> str:
    """Return a line of the table, with the least of all fits without hindsight in bold."""
    cells = [f"{100 * size:.1f} %" for size in sizes]
    best = int(np.argmin(sizes[:-1]))
    cells[best] = f"**{cells[best]}**"
    return f"| {' | '.join([name, str(count), *cells])} |"


def main() -> None:
    """Make the table; print it and write it into the page."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path, metavar="FOLDER")
    parser.add_argument("--ground", nargs="*", default=[], help="names of grounds, such as MIXED")
    parser.add_argument("--keep", type=Path, metavar="FILE", help="as of card.py")
    parser.add_argument("--write", type=Path, metavar="PAGE", help="page with the table's marks")
    given = parser.parse_args()
    made = []
    for one in lines(given.folder, given.ground, given.keep):
        print(one, flush=True)
        made.append(one)
    if given.write is not None:
        write(given.write, "plain", "\n".join(made))


if __name__ == "__main__":
    main()
