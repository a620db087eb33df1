"""How profiles are brought within limits, with a solver whose excess is known."""

from __future__ import annotations

import numpy as np
import pytest

from energyplan.errors import InfeasibleMotionError
from energyplan.limits._accept import accepted
from energyplan.limits._check import Excess, Survey, Thermal
from energyplan.limits._timing import Sampled, _crowded
from energyplan.limits.motor import Limit, Limits
from energyplan.path import Trajectory
from energyplan.vehicle import MotorLimits

LIMITS = Limits(
    MotorLimits(speed=1.0, acceleration=2.0, peak_power=500.0, continuous_power=400.0),
    yaw_rate=1.5, lateral_acceleration=0.8, battery_power=900.0, battery_return=300.0,
)  # fmt: skip
WHOLE = ("yaw_rate", "lateral_acceleration", "battery_power", "battery_return")
STILL = Trajectory(*np.zeros((6, 2)) + np.array([[0.0, 1.0]] + 5 * [[0.0, 0.0]]))


def limit_of(limits: Limits, kind: str) -> float:
    return float(getattr(limits if kind in WHOLE else limits.motor, kind))


@pytest.mark.parametrize("kind", ["speed", "acceleration", "peak_power", *WHOLE])
@pytest.mark.parametrize("over", [1.02, 1.6])
def test_a_limit_is_lowered_by_as_much_as_a_profile_exceeds_it(kind: str, over: float) -> None:
    """The solver's profiles go beyond what it is told by a factor; nothing else need be lowered."""
    given = limit_of(LIMITS, kind)
    told: list[Limits] = []

    def solve(limits: Limits) -> Sampled:
        told.append(limits)
        return Sampled(STILL, np.zeros(2, np.int_))

    def survey(sampled: Sampled) -> Survey:
        peak = over * limit_of(told[-1], kind)
        excess = [Excess(Limit(kind, "both", given), 0.0, 1.0, peak)] if peak > given else []
        return Survey([], excess, 0.0, Thermal(np.zeros(2), np.zeros((2, 2))))

    assert accepted(solve, survey, LIMITS) is STILL
    assert len(told) == 2
    assert limit_of(told[1], kind) == pytest.approx(given / over, rel=1e-4)
    for other in ("speed", "acceleration", *WHOLE):
        if other != kind:
            assert limit_of(told[1], other) == limit_of(LIMITS, other)


def test_a_limit_that_no_profile_keeps_is_named() -> None:
    def survey(sampled: Sampled) -> Survey:
        excess = Excess(Limit("yaw_rate", "both", 1.5), 0.25, 1.0, 3.0)
        return Survey([], [excess], 0.0, Thermal(np.zeros(2), np.zeros((2, 2))))

    with pytest.raises(InfeasibleMotionError, match=r"yaw rate is 3 .* limit of 1\.5 .* 0\.25 s"):
        accepted(lambda limits: Sampled(STILL, np.zeros(2, np.int_)), survey, LIMITS)


@pytest.mark.parametrize("moves", [True, False])
def test_where_a_lower_limit_does_not_help_all_is_done_more_gently(moves: bool) -> None:
    """Nor where nothing moves within it: a tenth less of speed, and what that brings about."""
    told: list[Limits] = []

    def solve(limits: Limits) -> Sampled:
        if not moves and limits.yaw_rate < LIMITS.yaw_rate:
            raise InfeasibleMotionError("nothing moves")
        told.append(limits)
        return Sampled(STILL, np.zeros(2, np.int_))

    def survey(sampled: Sampled) -> Survey:
        excess = Excess(Limit("yaw_rate", "both", LIMITS.yaw_rate), 0.0, 1.0, 1.02 * 1.5)
        excesses = [excess] if told[-1].motor.speed > 0.9 else []
        return Survey([], excesses, 0.0, Thermal(np.zeros(2), np.zeros((2, 2))))

    assert accepted(solve, survey, LIMITS) is STILL
    assert [limits.motor.speed for limits in told[:-1]] == [1.0] * (len(told) - 1)
    assert told[-1].motor.speed == pytest.approx(0.9)
    assert told[-1].motor.acceleration == pytest.approx(0.81 * 2.0)
    assert told[-1].lateral_acceleration == pytest.approx(0.81 * 0.8)
    assert told[-1].yaw_rate == 1.5


def test_samples_close_to_another_go_but_never_corners_and_ends() -> None:
    t = np.array([0.0, 1e-7, 1.0, 2.0, 2.0 + 1e-7, 3.0, 4.0, 4.0 + 1e-7])
    at = np.array([0.0, 0.1, 0.5, 0.7, 0.0, 0.4, 0.9, 1.0])  # a run begins at the fifth
    left_out = _crowded(t, np.zeros(8, np.int_), at)
    assert np.flatnonzero(left_out).tolist() == [1, 3, 6]
