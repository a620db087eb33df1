"""What a residual depends on: every channel and derived signal, tested honestly (private).

A dependence is a smooth function of one signal, as a power, as a force that scales with the
traction resistance, the slip moment or all forces, or as a force along the ground. It is fitted
beside the model's own terms, so that what the model could have absorbed does not count, and its
p-value allows for autocorrelation (by blocks) and for the number of signals tried (Holm).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from energyplan.fit.drive import Drive, channels_of
from energyplan.fit.estimate import Fit, Problem, difference, fit
from energyplan.fit.regressors import DesignMatrix, held_forces, window_means
from energyplan.fit.run import RunEffect
from energyplan.motion import CHANNELS
from energyplan.path import FloatArray
from energyplan.power import Sides, Term
from energyplan.power.empirical import (
    CARRIERS,
    DERIVED,
    carries,
    carry,
    described,
    signal,
)

_KNOTS = 6
_NOT_SIGNALS = {"changed", "p_left", "p_right", "power", "yaw_rate", "cmd_left", "cmd_right"}
_POWER_PARTS = ("current", "voltage")  # of a battery, a motor, a side: parts of power, no reasons
_CONSEQUENCE = 0.9  # correlation with the measured power from which a channel is a part of it
_PERIODS = (2.0, 60.0)  # of a periodic load [s]
_WAVES = 12  # drives in which a periodic load is looked for


@dataclass(frozen=True)
class Dependence:
    """How a residual depends on one signal."""

    channel: str  # the signal
    carrier: str
    shape: str  # in words
    explained_variance: float
    std_error: float  # standard error of that share
    p_value: float  # adjusted for the number of signals tried
    knots: tuple[float, ...] = ()  # values of the signal at the corners of the fitted shape
    values: tuple[float, ...] = ()  # the fitted shape at the knots, in the carrier's unit


def signals(drives: Sequence[Drive]) -> list[str]:
    """Names of the signals that every drive has and that vary."""
    names = [*DERIVED, *sorted(channels_of(drives) - _NOT_SIGNALS)]
    kept = []
    power = np.concatenate([drive.power for drive in drives])
    steady = np.ptp(power) == 0.0  # nothing follows from what never changes
    for name in names:
        if name.startswith(_POWER_PARTS):
            continue
        spread = np.ptp(np.concatenate([signal(drive.motion, name) for drive in drives]))
        if spread <= 1e-6:
            continue
        if name not in DERIVED and name not in CHANNELS and not steady:
            values = np.concatenate([signal(drive.motion, name) for drive in drives])
            if abs(np.corrcoef(values, power)[0, 1]) > _CONSEQUENCE:
                continue
        kept.append(name)
    return kept


def _knots(values: FloatArray) -> FloatArray:
    low, high = np.quantile(values, [0.01, 0.99])
    # A signal that settles spends most of the time there; the way there is what is informative.
    within = values[(values > low) & (values < high)]
    inner = np.quantile(within if len(within) else values, np.linspace(0, 1, _KNOTS)[1:-1])
    even = np.linspace(low, high, _KNOTS)[1:-1]
    places = np.unique(np.round(np.concatenate([[low], 0.5 * (inner + even), [high]]), 9))
    gap = (high - low) / (3 * _KNOTS)
    kept = [places[0]]
    for at in places[1:]:
        if at - kept[-1] > gap:
            kept.append(at)
    return np.array(kept)


def _shape_columns(
    problem: Problem,
    name: str,
    carrier: str,
    knots: FloatArray,
    skipped: int,
    signals: Sequence[FloatArray],
    forces: Sequence[Sides],
) -> list[FloatArray]:
    """Columns of hat functions over the knots, at each sample of each drive."""
    tables = []
    for drive, values, acting in zip(problem.drives, signals, forces, strict=True):
        columns = []
        for k in range(len(knots)):
            if k == skipped:
                continue
            hat = np.interp(values, knots, np.eye(len(knots))[k])
            part = carry(drive.motion, problem.vehicle, carrier, name, hat, acting)
            if isinstance(part, Sides):
                part = part.left * drive.motion.v_left + part.right * drive.motion.v_right
            columns.append(part)
        tables.append(drive.seen(np.column_stack(columns))[:, None])
    return tables


def dependences(
    problem: Problem, terms: Sequence[Term], carriers: Sequence[str] = tuple(CARRIERS)
) -> tuple[Dependence, ...]:
    """Test the residual of a model against every signal; runs count without their own factors."""
    problem = problem.of_totals
    errors = problem.reference(problem.design(terms))
    design = problem.design(terms, errors)
    now = fit(design, errors)
    between = _between_drives(now, design)
    if between:
        problem = _apart(problem, now, design)
        errors = problem.reference(problem.design(terms))
        design = problem.design(terms, errors)
        now = fit(design, errors)
    width = len(terms)
    found = []
    forces = [held_forces(d, problem.vehicle, terms, now.values) for d in problem.drives]
    known = channels_of(problem.drives)
    for name in signals(problem.drives):
        each = [signal(drive.motion, name) for drive in problem.drives]
        values = np.concatenate(each)
        knots = _knots(values)
        if len(knots) < 3:
            continue
        usual = int(np.argmin(np.abs(knots - np.median(values))))
        for carrier in carriers:
            if not carries(carrier, name, known):
                continue
            # The model has a constant of each but of a force along the ground.
            skipped = -1 if carrier == "ground" else usual
            columns = _shape_columns(problem, name, carrier, knots, skipped, each, forces)
            full = design.joined(window_means(problem.drives, columns))
            new = fit(full, errors)
            shape = new.values[width:]
            shape = shape if skipped < 0 else np.insert(shape, skipped, 0.0)
            found.append(_dependence(name, carrier, knots, shape, now, new, width))
    found += _periodic(problem, now, errors, design)
    every = [*_holm(found), *between]
    return tuple(sorted(every, key=lambda one: -one.explained_variance))


def _apart(problem: Problem, now: Fit, design: DesignMatrix) -> Problem:
    """Return the drives, each without the factor by which its power differs from its like."""
    table, owner = design.longest
    said, measured = table[:, :-1] @ now.values, table[:, -1]
    factors = [
        RunEffect.usual_factor(said[owner == k], measured[owner == k])
        for k in range(len(problem.drives))
    ]
    pairs = zip(problem.drives, factors, strict=True)
    return problem.on([replace(drive, power=drive.power / by) for drive, by in pairs])


def _between_drives(now: Fit, design: DesignMatrix) -> list[Dependence]:
    """Test whether drives differ as a whole, each by a factor of its power."""
    found = RunEffect.between(design, now.values, 0.0)
    if not found.compared:
        return []
    squares = [float(np.mean((rows[:, :-1] @ now.values) ** 2)) for rows in design.rows]
    share = np.mean(np.minimum(found.deviation**2 * np.array(squares) / now.errors, 1.0))
    words = (
        f"drives differ as a whole, by {100 * found.deviation:.1f} % of their power (standard "
        "deviation)"
    )
    return [
        Dependence(
            "drive", "power", words, float(share), 0.0, found.p_value, (), (found.deviation,)
        )
    ]


def _dependence(
    name: str, carrier: str, knots: FloatArray, shape: FloatArray, now: Fit, new: Fit, width: int
) -> Dependence:
    gain, error = difference(now.losses, new.losses)
    p_value = new.p_value(range(width, len(new.values)))
    scale = len(now.errors)
    return Dependence(
        name, carrier, in_words(name, carrier, knots, shape), gain / scale, error / scale,
        p_value, tuple(knots.tolist()), tuple(shape.tolist()),
    )  # fmt: skip


def _periodic(
    problem: Problem, now: Fit, errors: FloatArray, design: DesignMatrix
) -> list[Dependence]:
    """Test for a load that comes and goes with a fixed period, its phase free in each drive."""
    length = np.array([float(drive.t[-1]) for drive in problem.drives])
    # A column for each drive and phase: of very many drives the longest are used.
    chosen = np.sort(np.argsort(-length, kind="stable")[:_WAVES])
    drives, design = [problem.drives[k] for k in chosen], design.of_drives(chosen)
    longest = float(length.max())
    step = min(drive.windows[0].length for drive in drives)
    padded = int(np.ceil(2 * longest / step)) + 2
    frequencies = np.fft.rfftfreq(padded, step)
    band = (frequencies >= 1 / min(_PERIODS[1], longest / 3)) & (frequencies < 1 / _PERIODS[0])
    frequencies = frequencies[band]
    table, owner = design.rows[0], design.drives[design.blocks[0]]
    residual, explained = table[:, -1] - table[:, :-1] @ now.values, 0.0 * frequencies
    for k, drive in enumerate(drives):
        part = residual[owner == k]
        grid = np.zeros(padded)
        grid[(drive.t[drive.windows[0].starts] / step).astype(np.intp)] = part - part.mean()
        explained += np.abs(np.fft.rfft(grid)[band]) ** 2 / len(part)
    frequency = float(frequencies[np.argmax(explained)])
    tables = []
    for k, drive in enumerate(drives):
        waves = np.zeros((len(drive.t), 2 * len(drives)))
        angle = 2 * np.pi * frequency * drive.t
        waves[:, 2 * k], waves[:, 2 * k + 1] = np.cos(angle), np.sin(angle)
        tables.append(waves[:, None])
    # A load that is on for a part of its period has a mean, which is no wave.
    level = window_means(drives, [np.ones((len(drive.t), 1, 1)) for drive in drives])
    design = design.joined(level)
    joined = design.joined(window_means(drives, tables))
    new = fit(joined, errors, by_block=True)
    gain, error = difference(fit(design, errors, by_block=True).losses, new.losses)
    width = len(now.values) + 1
    p_value = min(new.p_value(range(width, len(new.values))) * len(frequencies), 1.0)
    words = f"periodic load, period {1 / frequency:.2g} s"
    return [Dependence("t", "power", words, gain / len(errors), error / len(errors), p_value)]


def _holm(found: Sequence[Dependence]) -> list[Dependence]:
    order = np.argsort([one.p_value for one in found])
    adjusted, running = np.zeros(len(found)), 0.0
    for rank, index in enumerate(order):
        running = max(running, min((len(found) - rank) * found[index].p_value, 1.0))
        adjusted[index] = running
    return [replace(one, p_value=float(p)) for one, p in zip(found, adjusted, strict=True)]


_CARRIED = {
    "power": "power", "traction": "traction resistance", "slip": "slip moment",
    "whole": "power of all forces", "ground": "force along the ground",
}  # fmt: skip


def in_words(name: str, carrier: str, knots: FloatArray, shape: FloatArray) -> str:
    """Describe a shape: rises, falls, step, only on one side, a valley or a hump."""
    what, name = _CARRIED[carrier], described(name).name
    spread = float(np.ptp(shape))
    steps = np.diff(shape)
    if spread == 0.0:
        return f"{what} does not depend on {name}"
    sides = [
        shape[knots > 0.05 * np.max(np.abs(knots))],
        shape[knots < -0.05 * np.max(np.abs(knots))],
    ]
    if all(len(side) for side in sides):
        ends = [float(np.mean(side)) for side in sides]
        flat = [float(np.ptp(side)) < 0.5 * spread for side in sides]
        if all(flat) and abs(ends[0] - ends[1]) > 0.5 * spread:
            more = "positive" if ends[0] > ends[1] else "negative"
            return f"more {what} where {name} is {more}"
    largest = int(np.argmax(np.abs(steps)))
    if abs(steps[largest]) > 0.75 * spread and len(steps) > 2:
        place = 0.5 * (knots[largest] + knots[largest + 1])
        way = "up" if steps[largest] > 0 else "down"
        return f"{what} steps {way} at {name} = {place:.3g}"
    if np.sum(np.maximum(-steps, 0)) < 0.2 * spread:
        return f"{what} rises with {name}"
    if np.sum(np.maximum(steps, 0)) < 0.2 * spread:
        return f"{what} falls with {name}"
    middle = float(np.mean(shape[1:-1]))
    edge = 0.5 * (shape[0] + shape[-1])
    return f"{what} has a {'valley' if middle < edge else 'hump'} over {name}"
