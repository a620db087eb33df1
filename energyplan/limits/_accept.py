"""Profiles that the check accepts: limits are tightened until none is exceeded anywhere."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np

from energyplan.errors import InfeasibleMotionError
from energyplan.limits._check import Survey
from energyplan.limits._timing import Sampled
from energyplan.limits.motor import ROUNDING, Limits
from energyplan.path import Trajectory

TRIES = 20
"""How often limits are tightened at most until a profile keeps the given ones everywhere."""


def accepted(
    solve: Callable[[Limits], Sampled],
    survey: Callable[[Sampled], Survey],
    limits: Limits,
    cool: Callable[[Limits], Sampled] | None = None,
    hasty: bool = True,
) -> Trajectory:
    """Solve, and solve again within tighter limits, until `check` would accept the trajectory.

    A ladder keeps the limits at its rungs. Between them, across smooth corners, on other grounds
    and on slopes that change, a limit may be exceeded a little; it is tightened by as much. The
    continuous power, which looks at the past, is kept by tightening the peak power.
    """
    tight, sampled, found = _within(solve, survey, limits, {"continuous_power"})
    if not found.excesses:
        return sampled.trajectory
    tries: list[Callable[[], Trajectory]] = [
        partial(_cooled, solve, survey, tight, found, limits.motor.continuous_power)
    ]
    if cool is not None:
        warm = partial(_within, cool, survey, tight, set())
        tries.insert(0 if hasty else 1, lambda: warm().sampled.trajectory)
    for attempt in tries[:-1]:
        with suppress(InfeasibleMotionError):
            return attempt()
    return tries[-1]()


class _Within(NamedTuple):
    """A profile, the limits that it was made for, and how it fares within those as they are."""

    limits: Limits
    sampled: Sampled
    found: Survey


def _within(
    solve: Callable[[Limits], Sampled],
    survey: Callable[[Sampled], Survey],
    limits: Limits,
    ignored: set[str],
) -> _Within:
    """Tighten limits until a profile exceeds none of those as they are, but for kinds ignored."""
    tight, gentle = limits, 1.0
    for k in range(TRIES):
        try:
            sampled = solve(tight)
        except InfeasibleMotionError:
            if tight is limits or gentle < 0.2:
                raise
            # Within the tightened limits nothing moves: go easy on all that speed brings about.
            gentle *= 0.9
            tight = _gentler(limits, gentle)
            continue
        found = survey(sampled)
        worst: dict[str, float] = {}
        for excess in found.excesses:
            kind, limit = excess.bound.kind, excess.bound.limit
            worst[kind] = max(worst.get(kind, 1.0), excess.peak / limit if limit > 0 else np.inf)
        if set(worst) <= ignored:
            return _Within(tight, sampled, found)
        worst = {kind: factor for kind, factor in worst.items() if kind not in ignored}
        if max(worst.values()) == np.inf or k >= TRIES // 2:
            # The limit itself, lowered, does not help: less of everything does.
            gentle *= 0.9
            tight = _gentler(limits, gentle)
            continue
        tight = _tightened(tight, worst)
    raise InfeasibleMotionError(
        "no profile that keeps every limit was found: "
        f"{found.excesses[0].bound.describe(found.excesses[0].peak)} at "
        f"{found.excesses[0].start:.3g} s; allow a little more of it"
    )


def _tightened(limits: Limits, excess: Mapping[str, float]) -> Limits:
    """Return limits that are lower by the factors by which they were exceeded."""
    motor = {
        kind: getattr(limits.motor, kind) / (factor * (1 + ROUNDING))
        for kind, factor in excess.items()
        if hasattr(limits.motor, kind)
    }
    whole = {
        kind: getattr(limits, kind) / (factor * (1 + ROUNDING))
        for kind, factor in excess.items()
        if hasattr(limits, kind)
    }
    if "peak_power" in motor:
        continuous = motor.get("continuous_power", limits.motor.continuous_power)
        motor["continuous_power"] = min(continuous, motor["peak_power"])
    return replace(limits, motor=replace(limits.motor, **motor), **whole)


def _gentler(limits: Limits, factor: float) -> Limits:
    """Return limits with lower accelerations and speeds."""
    motor = limits.motor
    speed = motor.speed * factor
    return replace(
        limits,
        motor=replace(motor, speed=speed, acceleration=motor.acceleration * factor**2),
        lateral_acceleration=limits.lateral_acceleration * factor**2,
    )


def _cooled(
    solve: Callable[[Limits], Sampled],
    survey: Callable[[Sampled], Survey],
    limits: Limits,
    found: Survey,
    coolest: float,
) -> Trajectory:
    """Lower the peak power until every thermal window is within the continuous power."""
    low, high = coolest, float(found.thermal.drawn.max())
    cool: list[Trajectory] = []
    for k in range(11):
        power = low if k == 0 else 0.5 * (low + high)
        motor = replace(
            limits.motor,
            peak_power=power,
            continuous_power=min(power, limits.motor.continuous_power),
        )
        try:
            tried = solve(replace(limits, motor=motor))
        except InfeasibleMotionError:
            # With so little power a given duration is too short.
            low = power
            continue
        if survey(tried).excesses:
            high = power
        else:
            low = power
            cool.append(tried.trajectory)
    if not cool:
        raise InfeasibleMotionError(
            f"the motors' continuous power of {limits.motor.continuous_power:g} W does not suffice "
            "in any profile that was tried; allow more time or take a longer way round"
        )
    return cool[-1]
