"""The yaw rate up to which contacts hold, from the power of both sides (private)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from energyplan.fit.drives.columns import columns_of
from energyplan.fit.drives.drive import Drive, parted
from energyplan.fit.least_squares import fit
from energyplan.fit.problem import PAPER, Problem
from energyplan.path import FloatArray
from energyplan.power import HOTEL, REGENERATION_LOSS, SLIP, TRACTION, Term
from energyplan.power.effect_terms import COPPER_LOSS

_SLIP_SPEEDS = np.geomspace(0.003, 0.15, 12)  # mean slip speeds at which classes end [m/s]
_SCATTER = 0.4  # misfit of the moment between the sides, over it, from which they do not slide
_LOST = 0.5  # such misfit at its least, from which the difference tells nothing
_CLEAR = 3.0  # noise beyond which a side should return power
_RISES = 0.3  # rise of what a side shows with what it should return, from which it lacks a sign
_LITTLE = 0.4  # of the resistance, with which sides return much
_BETTER = 0.5  # part of the loss that signs given back may leave, where sensors lack them
_TURNS = 20  # fits in which signs settle, at most
_ENOUGH = 20  # samples that a class needs
_LOSSES = (COPPER_LOSS, REGENERATION_LOSS)  # by which a total shows what contacts hold
_CLEARLY = 5.0  # logarithm of the odds from which on they do
_PERIOD, _SAMPLES, _DRIVES = 0.1, 20_000, 10  # of means, and of what is enough to tell that
_LEFT = 0.1  # share of the samples that must slide


def with_breakaway(problem: Problem, usual: Sequence[Term]) -> Problem:
    """Return the drives with the yaw rate up to which their contacts hold.

    While contacts slide, the moment between the sides follows from the way the robot turns; while
    they hold it is whatever steering built up (docs/theory, section 6). Classes of yaw rate in
    which the moment scatters by more than noise, from the slowest on, are those that hold.
    In the slowest one a fit takes contacts to hold in any case.
    """
    vehicle = problem.vehicle
    edges = _SLIP_SPEEDS / (vehicle.slip_moment / float(vehicle.loads.sum()))
    # In the slowest class steering drifts about a straight, and no sensor is sure which way.
    drifting = [replace(drive, drift=float(edges[0]), fields={}) for drive in problem.drives]
    problem = Problem(drifting, vehicle, problem.memory)
    if problem.drives[0].equations == 1:
        return _of_totals(problem, usual)
    terms = [*PAPER, *usual]
    sure = problem.of_totals
    for edge in [*edges[::-1], 0.0]:
        sure = _holding(problem, float(edge))
        if sure.drives[0].equations == 2:
            break
    if sure.drives[0].equations == 1:
        return _of_totals(problem, usual)
    design = sure.design(terms)
    values = fit(design, sure.reference(design)).values
    scatter = _scatter(problem, terms, values, edges)
    told = np.flatnonzero(np.isfinite(scatter))
    if not len(told) or scatter[told].min() > _LOST or _unsigned(sure, terms, values):
        return _of_totals(problem, usual)
    # What is misfitted throughout is no matter of holding, but of what the model lacks.
    usual_misfit = float(np.median(scatter[told[len(told) // 2 :]]))
    slides = told[scatter[told] < max(_SCATTER, 2.0 * usual_misfit)]
    held = told[told < (slides[0] if len(slides) else len(edges))]
    return _holding(problem, float(edges[held[-1]]) if len(held) else 0.0)


def _of_totals(problem: Problem, usual: Sequence[Term]) -> Problem:
    """Return the totals of drives, with contacts that hold where steering drifts, or do not.

    If they hold, what is lost there follows from no motion, and no law of sliding explains it.
    """
    drives = problem.of_totals.drives
    free, held = (
        Problem(
            [replace(one, breakaway=breakaway, drift=0.0, fields={}) for one in drives],
            problem.vehicle, problem.memory,
        )
        for breakaway in (0.0, drives[0].drift)
    )  # fmt: skip
    drifting = (
        one.holds & (one.motion.omega != 0.0) & (one.motion.v != 0.0) for one in held.drives
    )
    if not any(some.any() for some in drifting):
        return free
    slides, sticks = (
        max(_likelihood(some, [*PAPER, *usual, HOTEL, loss]) for loss in _LOSSES)
        for some in (one.averaged(_PERIOD).excerpt(_SAMPLES, _DRIVES) for one in (free, held))
    )
    return held if sticks > slides + _CLEARLY else free


def _likelihood(problem: Problem, terms: Sequence[Term]) -> float:
    """Logarithm of the likelihood of terms, with what it took that moments were not known."""
    errors = problem.reference(problem.design(terms))
    design = problem.design(terms, errors)
    found = fit(design, errors)
    likelihood = float(problem.likelihood(found.errors, design.evidence))
    return likelihood - problem.odds(terms, found.values)


def _holding(problem: Problem, breakaway: float) -> Problem:
    """Return the drives with a breakaway; with the total alone where they hardly slide then."""
    drives = [replace(drive, breakaway=breakaway, fields={}) for drive in problem.drives]
    held = Problem(drives, problem.vehicle, problem.memory)
    share = np.mean(np.concatenate([drive.slides for drive in held.drives]))
    return held if share > _LEFT else held.of_totals


def _scatter(
    problem: Problem, terms: Sequence[Term], values: FloatArray, edges: FloatArray
) -> FloatArray:
    """Misfit of the moment between the sides in classes of yaw rate, beyond that of noise.

    As a fraction of the moment of sliding, with what a class has in common.
    """
    pushes, residuals, rates, noises = [], [], [], []
    for drive in problem.drives:
        columns = np.column_stack([columns_of(t, drive, problem.vehicle)[:, 1] for t in terms])
        push = columns[:, terms.index(SLIP)] * values[terms.index(SLIP)]
        if drive.between is not None:
            pushes.append(push)
            residuals.append(drive.between - columns @ values)
            rates.append(np.abs(drive.motion.omega))
            noises.append(np.full(len(push), drive.between_noise))
    push, residual, rate, noise = (
        np.concatenate(parts) for parts in (pushes, residuals, rates, noises)
    )
    found = np.full(len(edges), np.nan)
    for k, (low, high) in enumerate(zip([0.0, *edges[:-1]], edges, strict=True)):
        mine = (rate > low) & (rate <= high) & (push != 0.0)
        if np.count_nonzero(mine) < _ENOUGH:
            continue
        size = float(push[mine] @ push[mine])
        beyond = float(residual[mine] @ residual[mine]) - float(noise[mine] @ noise[mine])
        found[k] = np.sqrt(max(beyond, 0.0) / size)
    return found


def _unsigned(problem: Problem, terms: Sequence[Term], values: FloatArray) -> bool:
    """Tell whether sensors show what sides return as if it were drawn.

    A side that should return the more shows the more then. Of a motor that returns nothing, or less
    than it should, what is shown is flat, or falls. Only where contacts slide is it known which
    side should. Where none should, what it returns may be taken for resistance.
    """
    due, shown = [], []
    faint, lowest = 0, np.inf
    for drive in problem.drives:
        if drive.between is None:
            continue
        for side, measured in _sides(drive, problem, terms, values):
            returns = (side < -_CLEAR * drive.between_noise) & (drive.slides > 0.0)
            faint += int(np.count_nonzero(side < 0.0))
            lowest = min(lowest, float(measured.min()))
            due.append(-side[returns])
            shown.append(measured[returns])
    expected, seen = np.concatenate(due), np.concatenate(shown)
    if len(expected) < _ENOUGH:
        never = lowest >= 0.0 and faint >= _ENOUGH
        return never or _signs_lost(problem, terms, values)
    return float(np.polyfit(expected, seen, 1)[0]) > _RISES


def _signs_lost(problem: Problem, terms: Sequence[Term], values: FloatArray) -> bool:
    """Tell whether the drives fit better with the signs given back that their model asks for.

    Motors may return nothing or a part of what they should: those are fitted, too. From two starts
    each, since resistance enough that no side returns power is a fit of both.
    """
    wide = [*terms, HOTEL]
    found = dict(zip([term.name for term in terms], values.tolist(), strict=True))
    little = {TRACTION.name: _LITTLE * found[TRACTION.name]}
    errors = problem.reference(problem.design(terms))
    plain, back = [], []
    for start in (found, {**found, **little}):
        held = Problem(problem.drives, problem.vehicle)
        for share in (0.0, 1.0):
            about = {**start, REGENERATION_LOSS.name: share}
            plain.append(fit(held.design([*wide, REGENERATION_LOSS], errors, about), errors).loss)
        now = np.array([start.get(term.name, 0.0) for term in wide])
        for _ in range(_TURNS):
            signed = _with_signs(held, wide, now)
            one = fit(signed.design(wide, errors), errors)
            settled = np.allclose(one.values, now, rtol=1e-3)
            now = one.values
            if settled:
                break
        back.append(one.loss)
    return min(back) < _BETTER * min(plain)


def _with_signs(problem: Problem, terms: Sequence[Term], values: FloatArray) -> Problem:
    """Return the drives, the power of each side with the sign that a model has there."""
    drives = []
    for drive in problem.drives:
        left, right = (
            np.copysign(measured, side) for side, measured in _sides(drive, problem, terms, values)
        )
        drives.append(replace(drive, power=left + right, between=right - left))
    return Problem(drives, problem.vehicle)


def _sides(
    drive: Drive, problem: Problem, terms: Sequence[Term], values: FloatArray
) -> list[tuple[FloatArray, FloatArray]]:
    """Return the power of the left side and of the right one: by a model, and as measured [W]."""
    table = np.stack([columns_of(term, drive, problem.vehicle) for term in terms], axis=-1)
    total, more = (table @ values).T
    between = np.zeros(len(total)) if drive.between is None else drive.between
    return list(zip(parted(total, more), parted(drive.power, between), strict=True))
