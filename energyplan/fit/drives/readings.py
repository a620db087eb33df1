"""What sensors that read in steps leave uncertain of coefficients (private).

A reading is wrong by up to half a step. Noise of a step or more makes that average out; with less
noise a steady state is read alike, and wrongly by as much, whenever and however long it is driven.
Blocks of time that agree with each other do not show it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from energyplan.fit.drives.denoise import Steps
from energyplan.fit.drives.design import Design
from energyplan.fit.drives.drive import Drive, parted
from energyplan.fit.drives.linear import linearise_drive
from energyplan.fit.drives.windows import SCALES
from energyplan.fit.least_squares import weighted
from energyplan.fit.problem import Problem
from energyplan.path import FloatArray
from energyplan.power import Term
from energyplan.vehicle import Vehicle

_SHARE = 1e-3  # step of the logarithm of a speed


def _covariance_of(sources: Sequence[tuple[NDArray[np.int64], FloatArray]]) -> FloatArray:
    """Return the covariance of coefficients, each state of a sensor erring alike whenever it is.

    Of each drive come the states of its samples, shape (n, m), and what the standard error of its
    state, in that sample, does to the coefficients, shape (n, k).
    """
    _, state = np.unique(np.concatenate([one[0] for one in sources]), axis=0, return_inverse=True)
    moved = np.concatenate([one[1] for one in sources])
    sums = np.stack([np.bincount(state.ravel(), column) for column in moved.T], axis=-1)
    return np.asarray(sums.T @ sums)


def moved_by(drives: Sequence[Drive], design: Design, errors: FloatArray) -> list[FloatArray]:
    """Return what one watt more in a sample of each equation does to the coefficients."""
    normal = weighted(design, errors).sum(axis=0)[:-1, :-1]
    scale = 1.0 / np.sqrt(np.maximum(np.diagonal(normal), 1e-300))
    unit = np.linalg.pinv(normal * np.outer(scale, scale), 1e-12, hermitian=True)
    inverse = unit * np.outer(scale, scale)
    found = [np.zeros((len(drive.t), drive.equations, len(normal))) for drive in drives]
    for k, (table, error, count) in enumerate(zip(design.rows, errors, design.counts, strict=True)):
        step, first = table[:, :-1] @ inverse / (error * count), 0
        for drive, table_of in zip(drives, found, strict=True):
            windows = drive.windows[k % len(SCALES)]
            own = step[first : first + len(windows.counts)] / windows.counts[:, None]
            table_of[:, k // len(SCALES)] += np.repeat(own, windows.counts.astype(np.intp), axis=0)
            first += len(windows.counts)
    return found


def reading_covariance(
    problem: Problem, terms: Sequence[Term], values: FloatArray, design: Design, errors: FloatArray
) -> FloatArray:
    """Return the covariance of coefficients that the steps of sensors leave."""
    width = design.rows[0].shape[1] - 1
    found = np.zeros((width, width))
    moved = moved_by(problem.drives, design, errors)
    powers = [_powers(drive.power, drive.between) for drive in problem.drives]
    expected = [_expected(drive, problem.vehicle, terms, values) for drive in problem.drives]
    for side in range(problem.drives[0].equations):
        steps = Steps.of(
            np.concatenate([one[side] for one in powers]),
            np.concatenate([one[side] for one in expected]),
        )
        if steps.error > 0.0:
            found += _covariance_of(
                [
                    (steps.states(one[side])[:, None], steps.error * _by_side(drive, by, side))
                    for drive, one, by in zip(problem.drives, powers, moved, strict=True)
                ]
            )  # fmt: skip
    sources = []
    for drive, by in zip(problem.drives, moved, strict=True):
        if drive.steps.error <= 0.0:
            continue
        motion = drive.motion
        speed = np.hypot(motion.v_left, motion.v_right) / np.sqrt(2.0)
        share = np.divide(
            drive.steps.error, speed, out=np.zeros(len(speed)), where=speed > drive.steps.size
        )
        late = round(drive.late.mean / drive.clock.period)
        at = np.clip(np.arange(len(speed)) - late, 0, len(speed) - 1)
        states = [drive.steps.states(v)[at] for v in (motion.v_left, motion.v_right)]
        rise = _rise_with_speed(drive, problem.vehicle, terms, values)
        sources.append(
            (np.column_stack(states), np.einsum("te,tek->tk", rise * share[at, None], by))
        )
    return found + _covariance_of(sources) if sources else found


def _powers(total: FloatArray, between: FloatArray | None) -> tuple[FloatArray, ...]:
    """Return what each sensor of power reads: the total, or the left side and the right one."""
    return (total,) if between is None else parted(total, between)


def _expected(
    drive: Drive, vehicle: Vehicle, terms: Sequence[Term], values: FloatArray
) -> tuple[FloatArray, ...]:
    """Return what each sensor of power should read."""
    power = linearise_drive(drive, vehicle, terms, values, ()).power
    return _powers(power[:, 0], None if drive.between is None else power[:, 1])


def _by_side(drive: Drive, moved: FloatArray, side: int) -> FloatArray:
    """Return what a watt more that one sensor of power reads does to the coefficients."""
    if drive.between is None:
        return moved[:, 0]
    return np.asarray(moved[:, 0] + (-1.0, 1.0)[side] * drive.slides[:, None] * moved[:, 1])


def _rise_with_speed(
    drive: Drive, vehicle: Vehicle, terms: Sequence[Term], values: FloatArray
) -> FloatArray:
    """Return by how much the power in each equation rises with the logarithm of the speed [W]."""
    ends = []
    for factor in (1.0 + _SHARE, 1.0 - _SHARE):
        motion = drive.motion
        faster = replace(motion, v_left=factor * motion.v_left, v_right=factor * motion.v_right)
        moved = replace(
            drive, motion=faster, breakaway=factor * drive.breakaway, drift=factor * drive.drift,
            fitted=False, fields={},
        )  # fmt: skip
        ends.append(linearise_drive(moved, vehicle, terms, values, ()).power)
    return np.asarray((ends[0] - ends[1]) / (2.0 * _SHARE))
