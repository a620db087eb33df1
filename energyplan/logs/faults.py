"""Faults of sensors and publishers: what feeds a standing robot, ends of ranges, zeros between."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from energyplan.logs.consistency import Check, Observed, regress
from energyplan.path import FloatArray


class FaultLimits(NamedTuple):
    """From which on readings show a fault."""

    enough: int = 20  # samples below which nothing is concluded
    fed: float = 0.1  # of the mean power of driving, that flows back at rest where something feeds
    # least time of one stretch, and of all, in which it does [s]
    standing: tuple[float, float] = (1.0, 3.0)
    ceiling: float = 0.03  # of the largest reading, in which those at the end of a range lie
    often: float = 0.1  # share of the driving in which they do, at least
    beyond: float = 1.15  # times as much as they show, that the motion asks for there
    longest_zero: int = 2  # samples that a speed is 0 for a moment, at most
    some_zeros: float = 0.02  # share of the driving in which it is, at least


_FAULT = FaultLimits()


def charged(drive: Observed) -> Iterable[Check]:
    """Find power that flows back while the robot stands: a charger, or a panel, feeds it."""
    top = float(np.quantile(drive.effort, 0.95))
    rest, moving = drive.effort < 0.05 * top, drive.moving
    drawn = float(drive.power[moving].mean()) if np.count_nonzero(moving) >= _FAULT.enough else 0.0
    if drawn <= 0.0:  # of the wrong sign, which is said elsewhere
        return
    found: list[tuple[float, float, float]] = []
    for run in drive.runs:
        standing = rest[run]
        edges = np.flatnonzero(np.diff(np.concatenate([[0], standing.astype(int), [0]])))
        for first, last in edges.reshape(-1, 2) + run.start:
            lasting = float(drive.t[last - 1] - drive.t[first])
            mean = float(drive.power[first:last].mean())
            error = float(drive.power[first:last].std()) / np.sqrt(last - first)
            if lasting >= _FAULT.standing[0] and mean < -max(_FAULT.fed * drawn, 4.0 * error):
                found.append((lasting, mean, float(drive.t[first])))
    if sum(lasting for lasting, _, _ in found) < _FAULT.standing[1]:
        return
    longest, mean, start = max(found)
    yield Check(
        f"the battery is charged while the robot stands: {mean:.3g} W for {longest:.3g} s from t = "
        f"{start:.2f} s, as by a charger, a dock or a solar panel",
        "leave the time on the charger out; where a panel feeds while it drives too, log what the "
        "robot draws, which is the battery's power and the panel's together",
    )


def ceiling(drive: Observed) -> Iterable[Check]:
    """Find readings that stop at the end of a sensor's range where the motion asks for more."""
    moving = drive.moving
    if np.count_nonzero(moving) < 5 * _FAULT.enough:
        return
    for name in drive.electric_names:
        values = drive.channels[name]
        effort, turning = drive.effort, np.abs(drive.difference)
        if drive.sides:
            speed = drive.left if name == "p_left" else drive.right
            effort = np.abs(speed)
        high = float(np.max(values[moving]))
        at_end = moving & (values >= (1.0 - _FAULT.ceiling) * high)
        below = moving & ~at_end
        if high <= 0.0 or np.count_nonzero(at_end) < max(
            _FAULT.enough, _FAULT.often * np.count_nonzero(moving)
        ):
            continue
        if np.count_nonzero(below) < 2 * _FAULT.enough:
            continue
        shapes = [effort, turning, np.ones(len(values))]
        fit = regress([shape[below] for shape in shapes], values[below])
        asked = _sum(fit.values, [shape[at_end] for shape in shapes])
        read = values[at_end]
        spread = float(np.std(asked)) > 3.0 * float(np.std(read))
        if (
            fit.condition < 1e6
            and spread
            and float(asked.mean()) > _FAULT.beyond * float(read.mean())
        ):
            share = np.count_nonzero(at_end) / np.count_nonzero(moving)
            unit = "A" if name == "current" else "W"
            yield Check(
                f"{name} ends at {high:.4g} {unit} in {share:.0%} of the driving, where the motion "
                "asks for more: this is the end of its range",
                "use a sensor with a larger range, or leave such stretches out",
            )


def _sum(factors: FloatArray, shapes: list[FloatArray]) -> FloatArray:
    return np.asarray(factors @ np.stack(shapes))


def zeros_between(drive: Observed) -> Iterable[Check]:
    """Find speeds that fall to 0 for a sample or two while the robot drives on."""
    drive = drive.rows
    found: dict[str, int] = {}
    for name, speed in (("v_left", drive.left), ("v_right", drive.right)):
        size = np.abs(speed)
        typical = float(np.median(size[size > 0.0])) if np.count_nonzero(size) else 0.0
        blank = _short_zeros(speed)
        fast = np.flatnonzero(blank)
        before, after = fast - 1, fast + 1
        while len(fast) and np.any(blank[after]):
            after = np.where(blank[after], after + 1, after)
        while len(fast) and np.any(blank[before]):
            before = np.where(blank[before], before - 1, before)
        low = np.minimum(speed[before] * np.sign(speed[after]), size[after])
        count = int(np.count_nonzero(low > 0.5 * typical))
        if typical > 0.0 and count >= max(
            _FAULT.enough, _FAULT.some_zeros * np.count_nonzero(size > 0.5 * typical)
        ):
            found[name] = count
    if found:
        yield Check(
            f"{' and '.join(found)} {'fall' if len(found) > 1 else 'falls'} to 0 for a moment "
            f"{max(found.values())} times in driving: another publisher sends zeros, or rows "
            "without a reading were filled with 0",
            "stop the other publisher, as a joint_state_publisher beside the driver's, or leave "
            "such cells, or messages, out",
        )


def _short_zeros(speed: FloatArray) -> NDArray[np.bool_]:
    """Return where a speed is 0 for no more than a few samples, neither at its begin nor end."""
    zero = speed == 0.0
    edges = np.flatnonzero(np.diff(np.concatenate([[0], zero.astype(int), [0]]))).reshape(-1, 2)
    result = np.zeros(len(speed), bool)
    for first, last in edges:
        result[first:last] = last - first <= _FAULT.longest_zero and first > 0 and last < len(speed)
    return result
