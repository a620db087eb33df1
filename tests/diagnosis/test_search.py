"""The search: what it tries beside the sets that the quick one proposes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from energyplan import DriveLog, PowerModel, diagnose, simulate
from energyplan.diagnosis.candidates import mark_changes
from energyplan.diagnosis.search import EffectSearch
from energyplan.fit.drive import ON_TIME, prepared
from energyplan.fit.estimate import PAPER, Problem
from energyplan.power.effects import SLIP_BEYOND, VISCOUS_LOSS, catalogue

ROBOT = PowerModel.preset("quadriga:full:concrete")


def one_drive(
    model: PowerModel, names: tuple[str, ...], disturbed: float = 0.0, late: float = 0.0
) -> EffectSearch:
    """Return a search over some effects, on a drive with a power that none of them has."""
    log = simulate.drive(
        model, simulate.IDENTIFICATION, rate=10.0, speed=0.7, power_noise=1.0, measured="total",
        without={"accel_x"}, delays={"power": late} if late else None,
    )  # fmt: skip
    size = disturbed * float(np.sqrt(np.mean(log.power**2)))
    swing = np.sqrt(2.0) * size * np.sin(2.0 * np.pi * log.t / 23.0)
    log = DriveLog({**log.channels, "power": log.power + swing}, log.name)
    problem = Problem(prepared([log], ROBOT.vehicle), ROBOT.vehicle)
    made = EffectSearch(problem, [catalogue()[name] for name in names], lambda *_: None, 4)
    made.quick.errors = problem.reference(problem.design(ROBOT.terms))
    return made


@pytest.mark.parametrize("disturbed", [0.0, 0.01])
def test_a_small_effect_is_one_where_less_than_it_is_missing(disturbed: float) -> None:
    search = one_drive(ROBOT.with_term(VISCOUS_LOSS, 2.5), ("viscous_loss",), disturbed)
    candidates = search.quick.candidates_for(None)
    one = search._evaluate((0,), candidates, ON_TIME)
    less = search._evaluate((), candidates, ON_TIME)
    gain = replace(search._gain(one, less, candidates[0].part, 1.0), share=0.003)
    sure = replace(gain, improvement=1.0, lasting=1.0, p_value=0.0, weight=20.0)
    assert search._missing(one) == pytest.approx(disturbed, rel=0.4, abs=1e-3)
    assert search._acceptable(sure, candidates[0], one, less) == (disturbed == 0.0)
    # Small or not, it stays where the others are impossible without it.
    assert search._acceptable(sure, candidates[0], one, replace(less, sound=False))


def test_a_change_leaves_a_tenth_of_a_drive_on_either_side() -> None:
    search = one_drive(ROBOT, ("viscous_loss",))
    drive = search.quick.problem.drives[0]
    late = drive.t > 0.94 * drive.t[-1]
    drive = replace(drive, power=drive.power * np.where(late, 1.5, 1.0))
    problem = Problem([drive], ROBOT.vehicle)
    marked = mark_changes(problem, PAPER, problem.reference(problem.design(PAPER)))
    assert 0.09 < float(np.mean(marked.drives[0].motion.channels["changed"])) < 0.91


def bordered() -> EffectSearch:
    """A search on a drive that begins with spins whose wheels cross a border."""
    line = replace(SLIP_BEYOND, params={"direction": -1.0, "offset": 0.2})
    return one_drive(ROBOT.with_term(line, 0.3), ("surface_border",))


def test_a_border_is_found_that_no_line_of_the_grid_is_near() -> None:
    search = bordered()
    candidates = search.quick.candidates_for(None)
    one = search._evaluate((), candidates, ON_TIME)
    worst = min(candidates, key=lambda c: search.score(search._fitted(one.problem, [c.part])))
    found = dict(search._nearest([worst.part], 0, one).params)
    # Told from the other side, it is the same line.
    way = 1.0 if np.cos(found["direction"] + 1.0) > 0.0 else -1.0
    assert np.cos(found["direction"] + 1.0) * way > np.cos(0.15)
    assert way * found["offset"] == pytest.approx(0.2, abs=0.1)


def test_a_robot_that_hardly_moves_crosses_no_line() -> None:
    log = simulate.drive(ROBOT, "survey", duration=40.0, rate=5.0, power_noise=5.0)
    creeps = {name: 1e-6 * log.channel(name) for name in ("v_left", "v_right")}
    told = diagnose(
        DriveLog({**log.channels, **creeps}, "creeps"),
        simulate.drive(ROBOT, "survey", duration=40.0, rate=5.0, power_noise=5.0, seed=2),
        ROBOT.vehicle, effects=[catalogue()[name] for name in ("surface_border", "hotel_load")],
    )  # fmt: skip
    assert "not tested, as the robot hardly moves: surface border" in told.advice
