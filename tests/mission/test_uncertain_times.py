"""Windows at the confidence asked, against draws of the times by arithmetic of their own."""

from __future__ import annotations

from dataclasses import replace
from statistics import NormalDist

import numpy as np
import pytest
from corridors import at, charger, corridor

from energyplan.mission import Mission, Spreads, Task, evaluate
from energyplan.path import Pose

SPREADS = replace(Spreads.none(), speed=0.1, dwell=0.2, waiting=1.0)


def rounds(order: str, **changes: float) -> Mission:
    """Three tasks along a corridor; the second opens late, so that some robots wait for it."""
    tasks = (
        at("a", 12.0, dwell=60.0),
        at("b", 20.0, dwell=40.0, window=(changes.get("opens", 0.0), 1e6)),
        at("c", 29.0, window=(0.0, 1e6)),
    )
    return corridor(
        1e6, tasks, 5.0, order=order, speed=0.5, confidence=0.95, spreads=SPREADS,
        coefficient_spread=0.01, waiting=changes.get("waiting", 0.0),
    )  # fmt: skip


def drawn(mission: Mission, count: int) -> np.ndarray:
    """Draw when the last task begins [s]."""
    rng = np.random.default_rng(0)
    legs = [leg.trajectory.duration for leg in evaluate(mission).legs]
    pace = 1 + 0.1 * rng.standard_normal(count)
    time = np.zeros(count)
    for task, leg in zip(mission.tasks, legs, strict=False):
        time = time + pace * leg
        if mission.waiting:
            time = time + rng.exponential(mission.waiting, count)
        begin = np.maximum(time, task.window[0])
        time = begin + task.dwell * (1 + 0.2 * rng.standard_normal(count))
    return begin


@pytest.mark.parametrize(
    "changes",
    [{}, {"opens": 95.0}, {"opens": 110.0}, {"waiting": 20.0}],
    ids=["driving and dwell", "some wait", "most wait", "waiting"],
)
def test_a_start_at_the_bound_holds_in_95_of_100(changes):
    asked = rounds("given", **changes)
    report = evaluate(asked)
    told = report.task("c")
    begin = drawn(asked, 20_000)
    assert told.start_upper > told.start
    on_time = np.mean(begin <= told.start_upper)
    # the sum of three exponential times is no normal one, and waiting for a window cuts it
    assert 0.93 <= on_time <= 0.97
    if not changes.get("opens"):  # who is early waits: the mean is later than what is expected
        assert told.start == pytest.approx(begin.mean(), rel=0.01)


@pytest.mark.parametrize("order", ["given", "free"])
def test_a_window_between_expectation_and_bound_is_late(order):
    asked = rounds(order)
    told = evaluate(rounds("given")).task("c")
    middle = 0.5 * (told.start + told.start_upper)
    shut = replace(asked, tasks=(*asked.tasks[:2], replace(asked.tasks[2], window=(0.0, middle))))
    expected = evaluate(replace(shut, confidence=0.5))
    assert expected.task("c").verdict == "reachable"
    report = evaluate(shut)
    if order == "free":  # it goes there first
        assert report.feasible
        assert report.task("c").start_upper <= middle
        return
    late = report.task("c")
    assert late.verdict == "unreachable"
    assert late.reason in ("late", "blocked_by_earlier")
    applied = [evaluate(shut.with_remedy(remedy)) for remedy in late.remedies]
    assert applied
    assert all(again.task("c").verdict == "reachable" for again in applied)


@pytest.mark.parametrize("order", ["given", "free"])
def test_a_charge_ends_in_time_at_the_bound(order):
    """A whole charge would take too long; the charge that ends in time counts its own spread."""
    asked = corridor(
        4000.0, {"end": 29.0}, 15.0, speed=0.5, soc=0.6, order=order,
        chargers=(charger(25.0, "dock"),), confidence=0.95, coefficient_spread=1e-4,
        spreads=replace(Spreads.none(), speed=0.05),
    )  # fmt: skip
    whole = evaluate(asked).task("end")
    shut = replace(asked, tasks=(replace(asked.tasks[0], window=(0.0, whole.start_upper - 2.5)),))
    told = evaluate(shut).task("end")
    assert told.verdict == "reachable"
    assert told.start_upper <= whole.start_upper - 2.5 + 1e-6
    assert told.start < told.start_upper - 1.0


@pytest.mark.parametrize("order", ["given", "free"])
def test_half_a_turn_in_place_is_a_spin_where_a_window_presses(order):
    """Three pivots take as much as a spin on this ground, and more than twice the time."""
    turned = Task("turned", Pose(15.0, 1.5, np.pi))
    asked = corridor(1e5, (turned,), 15.0, order=order, speed=0.5)
    calm = evaluate(asked)
    radians = np.pi * asked.vehicle.icr.left / 0.5
    soon = replace(turned, window=(0.0, 1.25 * radians))
    pressed = evaluate(replace(asked, tasks=(soon,)))
    assert pressed.feasible
    assert pressed.task("turned").start <= 1.25 * radians
    assert pressed.energy == pytest.approx(calm.energy, rel=0.02)


@pytest.mark.parametrize("spread", [0.25, 1.0])
@pytest.mark.parametrize("kind", ["speed", "waiting", "dwell"])
def test_the_bound_of_a_start_is_that_of_its_one_unknown(kind: str, spread: float) -> None:
    """Of each kind alone: a normal time's quantile, by the durations that were planned."""
    asked = replace(
        rounds("given", waiting=30.0), spreads=replace(Spreads.none(), **{kind: spread})
    )
    report = evaluate(asked)
    told = report.task("c")
    drives = sum(leg.trajectory.duration for leg in report.legs[:3])
    assert told.start == pytest.approx(drives + 3 * 30.0 + 60.0 + 40.0, rel=1e-6)
    deviation = {
        "speed": drives,  # one pace for all drives
        "waiting": np.sqrt(3) * 30.0,  # before each task anew
        "dwell": np.hypot(60.0, 40.0),
    }[kind]
    late = NormalDist().inv_cdf(0.95) * spread * deviation
    assert told.start_upper - told.start == pytest.approx(late, rel=1e-3)
