"""The search: what it tries beside the sets that the quick one proposes."""

from __future__ import annotations

import importlib.util
import math
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from energyplan import PowerModel, diagnose, simulate
from energyplan.diagnosis.search import Search
from energyplan.fit.drives.late import ON_TIME, Late
from energyplan.fit.drives.windows import prepared
from energyplan.fit.least_squares import Problem
from energyplan.power.effect_terms import COPPER_LOSS, DRAGGING_LEFT, TOWED_DRAG
from energyplan.power.effects import catalogue

ROBOT = PowerModel.preset("quadriga:full:concrete")
NAMES = ("copper_loss", "dragging_wheel_left", "towed_drag")


@pytest.fixture(scope="module")
def search() -> Search:
    """A search over three effects, on a drive that has them."""
    model = ROBOT
    for term, size in ((COPPER_LOSS, 4e-4), (DRAGGING_LEFT, 40.0), (TOWED_DRAG, 45.0)):
        model = model.with_term(term, size)
    log = simulate.drive(
        model, simulate.IDENTIFICATION, rate=5.0, speed=0.7, power_noise=2.0, measured="total"
    )
    effects = [catalogue()[name] for name in NAMES]
    problem = Problem(prepared([log], ROBOT.vehicle), ROBOT.vehicle)
    made = Search(problem, effects, lambda *_: None, 4)
    made.errors = problem.reference(problem.design(ROBOT.terms))
    return made


def test_a_set_is_fitted_again_from_a_part_of_it_that_explains_more(search: Search) -> None:
    candidates = search._candidates(None)
    whole, part = (0, 1, 2), (0, 1)
    found = search._evaluate(whole, candidates, ON_TIME)
    stuck = replace(found, fit=replace(found.fit, errors=1e4 * found.fit.errors))
    search.evaluated[whole, ON_TIME] = stuck
    search._fit_from(part, whole, candidates, ON_TIME)
    again = search._evaluate(whole, candidates, ON_TIME)
    assert search.score(again) == pytest.approx(search.score(found), abs=0.01)
    # Where it explains as much as the part, nothing is done.
    search._fit_from(part, whole, candidates, ON_TIME)
    assert search._evaluate(whole, candidates, ON_TIME) is again


def test_the_best_set_is_weighed_at_each_delay(search: Search) -> None:
    late = Late(0.2)
    pools = {late: search._candidates(None), ON_TIME: list(reversed(search._candidates(None)))}
    key = frozenset({0, 1, 2})
    weighed = {(key, late): search._posterior((0, 1, 2), pools[late], late)}
    search._redelay(weighed, pools)
    assert (frozenset({0, 1, 2}), ON_TIME) in weighed
    assert weighed[key, ON_TIME] > weighed[key, late]  # the drive's power is not late


def test_pairs_hold_the_set_and_two_effects_more(search: Search) -> None:
    candidates = search._candidates(None)
    singles = [(0, 1), (0, 2), (1,)]
    assert search._pairs((0,), singles, np.zeros(3), candidates) == [(0, 1, 2)]


@pytest.mark.nightly
@pytest.mark.parametrize(
    "seed", [95046, 95087, 98037], ids=["ends elsewhere", "needs no delay", "masked pair"]
)
def test_effects_that_a_quick_search_misses_are_found(
    seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = Path(__file__).resolve().parents[2] / "benchmarks" / "calibration.py"
    spec = importlib.util.spec_from_file_location("calibration", file)
    assert spec
    assert spec.loader
    calibration = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, spec.name, calibration)
    spec.loader.exec_module(calibration)
    made = calibration.hidden(seed)
    told = diagnose(made.logs[0], made.logs[1], made.vehicle)
    effects = {effect.name: effect for effect in told.effects}
    assert set(made.sizes) == set(effects)
    for name, size in made.sizes.items():
        assert math.isclose(effects[name].value, made.size(effects[name]), rel_tol=0.15), (
            name,
            size,
        )
