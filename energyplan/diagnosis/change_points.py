"""When a payload or a surface changed (private).

Every drive is in one of two states, or passes once from one to the other. The state of all drives
together is found by taking one drive after the other to its best time, from sums over windows that
are computed once.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from energyplan.fit.drives.columns import column
from energyplan.fit.drives.drive import Drive
from energyplan.fit.least_squares import solve, squared_errors
from energyplan.fit.problem import PAPER, Problem
from energyplan.path import FloatArray
from energyplan.power import Term
from energyplan.vehicle import Vehicle

_SWEEPS = 3
_LEAST_SIDE = 0.1  # share of a drive before a change in it, and after


def _window_grams(problem: Problem, terms: Sequence[Term], values: FloatArray) -> list[FloatArray]:
    """Cumulative Gram matrices over half-second windows of [columns, paper's columns, power]."""
    sums = []
    about = problem.tables(terms, values)
    for drive, table, target in zip(problem.drives, about.columns, about.targets, strict=True):
        windows = drive.windows[0]
        table, target = table[:, 0], target[:, 0]  # of the total
        paper = [drive.seen(column(term, drive, problem.vehicle)) for term in PAPER]
        rows = windows.mean(np.column_stack([table, *paper, target]))
        products = np.einsum("ni,nj->nij", rows, rows)
        sums.append(np.concatenate([np.zeros((1, *products.shape[1:])), np.cumsum(products, 0)]))
    return sums


def _masked(total: FloatArray, after: FloatArray, count: int) -> FloatArray:
    """Gram matrix in which the last two columns count only in the windows `after`."""
    gram = np.broadcast_to(total, after.shape).copy()
    late = slice(count, count + 2)
    gram[..., late, :] = after[..., late, :]
    gram[..., :, late] = after[..., :, late]
    return gram


def _loss(gram: FloatArray) -> FloatArray:
    return squared_errors(gram, solve(gram))


def mark_changes(problem: Problem, terms: Sequence[Term], errors: FloatArray) -> Problem:
    """Find when each drive changed state, and give the drives the channel ``changed``."""
    design = problem.design(terms, errors)
    values = solve(design.grams.sum(axis=(0, 1)))
    sums = _window_grams(problem, terms, values)
    count = len(terms)
    totals = [part[-1] for part in sums]
    afters = [np.zeros_like(total) for total in totals]
    splits: list[tuple[int, bool]] = [(len(part) - 1, True) for part in sums]
    for _ in range(_SWEEPS):
        settled = list(splits)
        for k, part in enumerate(sums):
            others_total = sum((totals[j] for j in range(len(sums)) if j != k), 0.0 * totals[k])
            others_after = sum((afters[j] for j in range(len(sums)) if j != k), 0.0 * totals[k])
            margin = int(np.ceil(_LEAST_SIDE * len(part)))
            times = np.arange(margin, len(part) - margin)
            if not len(times):
                continue  # too short to have changed within
            late = part[-1] - part[times]
            options = [late] if k == 0 else [late, part[times], part[-1:], 0.0 * part[-1:]]
            best = (np.inf, splits[k], afters[k])
            for number, after in enumerate(options):
                grams = _masked(others_total + totals[k], others_after + after, count)
                losses = _loss(grams)
                place = int(np.argmin(losses))
                if losses[place] < best[0] * (1 - 1e-9):
                    time = (int(times[place]), int(times[place]), 0, len(part) - 1)[number]
                    best = (float(losses[place]), (time, number != 1), after[place])
            splits[k], afters[k] = best[1], best[2]
        if settled == splits:
            break
    return Problem(
        [_marked(drive, *split) for drive, split in zip(problem.drives, splits, strict=True)],
        problem.vehicle,
        problem.memory,
    )


def _marked(drive: Drive, window: int, rising: bool) -> Drive:
    starts = np.append(drive.windows[0].starts, len(drive.t))
    after = np.arange(len(drive.t)) >= starts[window]
    return drive.with_channels(changed=np.asarray(after if rising else ~after, float))


def settle_change(
    drive: Drive, base: FloatArray, terms: Sequence[Term], values: FloatArray, vehicle: Vehicle
) -> Drive:
    """Find when a drive changed state, its coefficients known."""
    whole = drive.with_channels(changed=np.ones(len(drive.t)))
    step = sum(
        (column(term, whole, vehicle) * float(v)
         for term, v in zip(terms, values, strict=True)),
        np.zeros(len(drive.t)),
    )  # fmt: skip
    windows = drive.windows[0]
    residual = windows.mean(drive.power - base)
    shift = windows.mean(drive.seen(np.asarray(step)))
    before, after = residual**2, (residual - shift) ** 2
    early = np.concatenate([[0.0], np.cumsum(before - after)])
    rising, falling = early, -early + early[-1]
    # Sum of squares of changing at window k, less that of having changed all along.
    k_up, k_down = int(np.argmin(rising)), int(np.argmin(falling))
    if rising[k_up] <= falling[k_down]:
        return _marked(drive, k_up, True)
    return _marked(drive, k_down, False)


def change_time(drive: Drive) -> dict[str, float]:
    """Return when a drive changed state [s], by the words of a report; nothing where it did not."""
    if "changed" not in drive.motion.channels:
        return {}
    changed = drive.motion.channels["changed"]
    at = np.flatnonzero(np.diff(changed))
    return {f"time in {drive.name}": float(drive.t[at[0] + 1])} if len(at) else {}
