"""The search: what it tries beside the sets that the quick one proposes."""

from __future__ import annotations

import importlib.util
import math
import sys
import warnings
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from energyplan import DriveLog, PowerModel, diagnose, simulate
from energyplan.diagnosis.change_points import mark_changes
from energyplan.diagnosis.part import Part
from energyplan.diagnosis.proposals import Candidate
from energyplan.diagnosis.search import Search
from energyplan.diagnosis.settled_sets import settled
from energyplan.fit.drives.drive import prepared
from energyplan.fit.drives.late import ON_TIME, Late
from energyplan.fit.problem import PAPER, Problem
from energyplan.path import FloatArray
from energyplan.power import DRIVE_LOSS, HOTEL
from energyplan.power.effect_terms import COPPER_LOSS, DRAGGING_LEFT, SLIP_BEYOND, TOWED_DRAG
from energyplan.power.effects import VISCOUS_LOSS, WARM_UP, catalogue

ROBOT = PowerModel.preset("quadriga:full:concrete")
NAMES = ("copper_loss", "dragging_wheel_left", "towed_drag")


@pytest.fixture
def search(made: Search) -> Search:
    """A search over three effects, on a drive that has them; no set is fitted yet."""
    made.evaluated.clear()
    return made


@pytest.fixture(scope="module")
def made() -> Search:
    """The same for all tests: they number candidates differently, and share what was fitted."""
    model = ROBOT
    for term, size in ((COPPER_LOSS, 4e-4), (DRAGGING_LEFT, 40.0), (TOWED_DRAG, 45.0)):
        model = model.with_term(term, size)
    log = simulate.drive(
        model, simulate.IDENTIFICATION, rate=5.0, speed=0.7, power_noise=2.0, measured="total"
    )
    effects = [catalogue()[name] for name in NAMES]
    problem = Problem(prepared([log], ROBOT.vehicle), ROBOT.vehicle)
    found = Search(problem, effects, lambda *_: None, 4)
    found.errors = problem.reference(problem.design(ROBOT.terms))
    return found


def test_a_set_is_fitted_again_from_a_part_of_it_that_explains_more(search: Search) -> None:
    candidates = search._candidates(None)
    whole, part = (0, 1, 2), (0, 1)
    found = search._evaluate(whole, candidates, ON_TIME)
    stuck = replace(found, fit=replace(found.fit, squares=1e4 * found.fit.squares))
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


def test_the_best_set_with_each_loss_is_tried_whatever_the_quick_search_says(
    search: Search,
) -> None:
    candidates = search._candidates(None)
    plain, lossy = (search._evaluate(some, candidates, ON_TIME) for some in ((1,), (0, 1)))
    sets, scores = [(1, 2), (0, 1), (0, 1, 2), (0,)], np.array([4.0, 1.0, 3.0, 2.0])
    assert search._losses(sets, scores, candidates, plain) == [(0, 1, 2)]
    assert search._losses(sets, scores, candidates, lossy) == []


def test_a_more_probable_set_that_earns_no_place_is_a_stepping_stone(search: Search) -> None:
    pools = {ON_TIME: search._candidates(None)}
    plain, whole = (search._posterior(s, pools[ON_TIME], ON_TIME) for s in ((), (0, 1, 2)))
    assert whole > plain + 6.0
    weighed = {(frozenset[int](), ON_TIME): plain}
    assert search._stepping_stone(weighed, pools, set()) == ((0, 1, 2), ON_TIME)
    # Not twice, not what has earned its place, and nothing that is hardly better than the best.
    tried = {((0, 1, 2), ON_TIME)}
    assert search._stepping_stone(weighed, pools, tried) != ((0, 1, 2), ON_TIME)
    weighed[frozenset((0, 1, 2)), ON_TIME] = whole
    assert search._stepping_stone(weighed, pools, set()) is None


def test_a_further_effect_counts_with_its_odds(search: Search) -> None:
    candidates = search._candidates(None)
    sets = [(0, 1), (0, 2), (0, 1, 2), (1, 2)]

    def odds(*scores: float) -> float:
        return sum(search._odds((0,), sets, np.array(scores), candidates, ON_TIME).values())

    # Two effects more, or another one in place of the first, are none that is further.
    search.evaluated.pop(((0, 1), ON_TIME), None)
    assert odds(-2.0, -3.0, 50.0, 50.0) == pytest.approx(math.exp(-2.0) + math.exp(-3.0))
    # What is more probable than its absence and was not named failed a test: of that, not of size.
    assert odds(9.0, -3.0, 0.0, 0.0) == pytest.approx(math.exp(-3.0))
    gains, _ = search._gains((0, 1), candidates, ON_TIME)
    gains[1] = replace(
        gains[1], improvement=0.04, error=0.01, lasting=0.03, p_value=1e-6, weight=9.0, share=0.003
    )
    assert odds(9.0, -3.0, 0.0, 0.0) == pytest.approx(1.0 + math.exp(-3.0))
    assert odds(9.0, -np.inf, 0.0, 0.0) == 1.0
    gains[1] = replace(gains[1], p_value=0.2)
    assert odds(9.0, -3.0, 0.0, 0.0) == pytest.approx(math.exp(-3.0))


def test_the_best_set_is_weighed_without_each_of_its_effects(search: Search) -> None:
    candidates, key = search._candidates(None), frozenset({0, 1, 2})
    weighed = {(key, ON_TIME): search._posterior((0, 1, 2), candidates, ON_TIME)}
    search._lessened(weighed, (0, 1, 2), candidates, ON_TIME)
    less = {(frozenset(some), ON_TIME) for some in ((0, 1), (0, 2), (1, 2))}
    assert set(weighed) == {(key, ON_TIME)} | less
    assert max(weighed[one] for one in less) < weighed[key, ON_TIME] - 10.0
    # Each can be told: what its effects are worth in it is known.
    assert set(search.evaluated[(0, 2), ON_TIME].gains) == {0, 2}


def one_drive(
    model: PowerModel, names: tuple[str, ...], disturbed: float = 0.0, late: float = 0.0
) -> Search:
    """Return a search over some effects, on a drive with a power that none of them has."""
    log = simulate.drive(
        model, simulate.IDENTIFICATION, rate=10.0, speed=0.7, power_noise=1.0, measured="total",
        without={"accel_x"}, delays={"power": late} if late else None,
    )  # fmt: skip
    size = disturbed * float(np.sqrt(np.mean(log.power**2)))
    swing = np.sqrt(2.0) * size * np.sin(2.0 * np.pi * log.t / 23.0)
    log = DriveLog({**log.channels, "power": log.power + swing}, log.name)
    problem = Problem(prepared([log], ROBOT.vehicle), ROBOT.vehicle)
    made = Search(problem, [catalogue()[name] for name in names], lambda *_: None, 4)
    made.errors = problem.reference(problem.design(ROBOT.terms))
    return made


@pytest.mark.parametrize("disturbed", [0.0, 0.01])
def test_a_small_effect_is_one_where_less_than_it_is_missing(disturbed: float) -> None:
    search = one_drive(ROBOT.with_term(VISCOUS_LOSS, 2.5), ("viscous_loss",), disturbed)
    candidates = search._candidates(None)
    one = search._evaluate((0,), candidates, ON_TIME)
    less = search._evaluate((), candidates, ON_TIME)
    gain = replace(search._gain(one, less, candidates[0].part, 1.0), share=0.003)
    sure = replace(gain, improvement=1.0, lasting=1.0, p_value=0.0, weight=20.0)
    assert search._missing(one) == pytest.approx(disturbed, rel=0.4, abs=1e-3)
    assert search._acceptable(sure, candidates[0], one, less) == (disturbed == 0.0)
    # Small or not, it stays where the others are impossible without it.
    assert search._acceptable(sure, candidates[0], one, replace(less, sound=False))


@pytest.mark.parametrize("left", [0.0, 0.003, 0.1])
@pytest.mark.parametrize("lasting", [-0.1, 0.4, 0.5])
def test_what_one_block_alone_shows_of_a_change_is_none(
    search: Search, lasting: float, left: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The less so where what the set leaves beyond noise is worth no effect."""
    candidate = search._candidates(None)[0]
    one = search._evaluate((0,), search._candidates(None), ON_TIME)
    less = search._evaluate((), search._candidates(None), ON_TIME)
    gain = replace(search._gain(one, less, candidate.part, 1.0), lasting=lasting, improvement=1.0)
    gain = replace(gain, error=0.5, share=0.1, p_value=0.0, weight=40.0)
    monkeypatch.setattr(search, "_missing", lambda _: left)
    limit = 0.45 if left > 0.004 else 0.3
    for name, accepted in (
        ("payload_change", lasting > limit),
        ("surface_border", lasting > limit),
        ("towed_drag", True),
    ):
        part = Part(catalogue()[name])
        assert search._acceptable(gain, replace(candidate, part=part), one, less) == accepted


def test_what_most_blocks_show_of_an_effect_lasts_without_the_one_that_shows_most(
    search: Search,
) -> None:
    """The falls of the blocks' errors, in units of one set, sum up to what it is worth."""
    candidates = search._candidates(None)
    full, less = (search._evaluate(some, candidates, ON_TIME) for some in ((0, 1, 2), (0, 1)))
    gain = search._gain(full, less, candidates[2].part, 1.0)
    fall = (less.fit.squares - full.fit.squares) / (less.errors + search.problem.floor)[:, None]
    blocks = fall.mean(axis=0)
    assert gain.improvement == pytest.approx(blocks.sum(), rel=1e-9)
    assert gain.lasting == pytest.approx(gain.improvement - blocks.max(), rel=1e-9)
    assert gain.lasting > 0.5 * gain.improvement
    assert gain.error == pytest.approx(np.std(blocks, ddof=1) * np.sqrt(len(blocks)), rel=1e-9)


def test_a_change_leaves_a_tenth_of_a_drive_on_either_side() -> None:
    search = one_drive(ROBOT, ("viscous_loss",))
    drive = search.problem.drives[0]
    late = drive.t > 0.94 * drive.t[-1]
    drive = replace(drive, power=drive.power * np.where(late, 1.5, 1.0))
    problem = Problem([drive], ROBOT.vehicle)
    marked = mark_changes(problem, PAPER, problem.reference(problem.design(PAPER)))
    assert 0.09 < float(np.mean(marked.drives[0].motion.channels["changed"])) < 0.91


def test_values_between_those_of_a_grid_are_found_while_a_set_grows() -> None:
    warm = replace(WARM_UP, params={"time_constant": 57.0})
    search = one_drive(ROBOT.with_term(warm, 50.0), ("warm_up",))
    candidates = search._candidates(None)
    sets = [(k,) for k in range(len(candidates))]
    weighed = {
        (frozenset(one), ON_TIME): search._posterior(one, candidates, ON_TIME) for one in sets
    }
    before = max(weighed.values())
    search._settle_best(weighed, {ON_TIME: candidates})
    assert len(candidates) == len(sets) + 1
    assert dict(candidates[-1].part.params)["time_constant"] == pytest.approx(57.0, rel=0.05)
    assert max(weighed.values()) > before
    search._settle_best(weighed, {ON_TIME: candidates})  # and stays there
    assert len(candidates) == len(sets) + 1


def test_a_time_offset_moves_with_the_best_set() -> None:
    search = one_drive(ROBOT, ("time_offset",), late=0.3)
    first = Late(0.25)
    weighed = {(frozenset[int](), first): search._posterior((), [], first)}
    pools: dict[Late, list[Candidate]] = {first: []}
    search._settle_delay(weighed, pools)
    (moved,) = set(pools) - {first}
    assert moved.delay == pytest.approx(0.3, abs=0.02)  # a fifth of a sample
    assert weighed[frozenset(), moved] > weighed[frozenset(), first]


def bordered() -> Search:
    """A search on a drive that begins with spins whose wheels cross a border."""
    line = replace(SLIP_BEYOND, params={"direction": -1.0, "offset": 0.2})
    return one_drive(ROBOT.with_term(line, 0.3), ("surface_border",))


def test_a_border_is_found_that_no_line_of_the_grid_is_near() -> None:
    search = bordered()
    candidates = search._candidates(None)
    one = search._evaluate((), candidates, ON_TIME)
    worst = min(candidates, key=lambda c: search.score(search._fitted(one.problem, [c.part])))
    found = dict(search._nearest([worst.part], 0, one).params)
    # Told from the other side, it is the same line.
    way = 1.0 if np.cos(found["direction"] + 1.0) > 0.0 else -1.0
    assert np.cos(found["direction"] + 1.0) * way > np.cos(0.15)
    assert way * found["offset"] == pytest.approx(0.2, abs=0.1)


def test_a_line_is_looked_for_where_none_of_the_grid_tells_anything() -> None:
    search = bordered()
    place = catalogue()["surface_border"]
    far = Part(place, (("direction", 2.0), ("offset", -1.0)))
    candidates = [replace(search._candidates(None)[0], part=far)]
    ((line,),) = search._with_lines((), candidates, ON_TIME)
    near = candidates[line].part
    assert near.params != far.params
    alone, with_line = (
        search.score(search._evaluate(some, candidates, ON_TIME)) for some in ((), (line,))
    )
    assert with_line > alone + 20.0
    # Beside a line there is no other, and where nothing differs there is none.
    assert search._with_lines((line,), candidates, ON_TIME) == []
    level = one_drive(ROBOT, ("surface_border",))
    assert level._with_lines((), level._candidates(None), ON_TIME) == []


def test_a_loss_beyond_its_bound_is_fitted_from_the_other_side(
    search: Search, monkeypatch: pytest.MonkeyPatch
) -> None:
    parts = [Part(catalogue()[name]) for name in NAMES]
    right = search._fitted(search.problem, parts)
    size = search._coefficients(right)["copper_loss"]
    assert size == pytest.approx(4e-4, rel=0.2)
    starts = []

    def ends(problem, parts, start):  # a fit that ends where it starts
        starts.append(start)
        values = np.array(right.fit.values)
        values[2] = start["copper_loss"]
        return replace(right, fit=replace(right.fit, values=values), sound=values[2] >= 0.0)

    monkeypatch.setattr(search, "_fitted_from", ends)
    again = search._fitted(search.problem, parts, {"copper_loss": -size})
    assert search._coefficients(again)["copper_loss"] == pytest.approx(size)
    assert [start["copper_loss"] for start in starts] == pytest.approx([-size, size])


def test_a_loss_is_weighed_in_place_of_one_that_powers_cannot_tell_it_from() -> None:
    model = ROBOT.with_term(DRIVE_LOSS, 0.5).with_term(HOTEL, 30.0)
    search = one_drive(model, ("drive_efficiency", "hotel_load", "regeneration_efficiency"))
    candidates = search._candidates(None)
    assert search._other_losses((0, 1), candidates, ON_TIME) == [(1, 2)]
    assert search._other_losses((1, 2), candidates, ON_TIME) == [(0, 1)]
    assert search._other_losses((1,), candidates, ON_TIME) == []
    # The current's square is no such loss: it explains much less.
    other = one_drive(model, ("drive_efficiency", "hotel_load", "copper_loss"))
    assert other._other_losses((0, 1), other._candidates(None), ON_TIME) == []


def test_a_robot_that_hardly_moves_crosses_no_line() -> None:
    log = simulate.drive(ROBOT, "survey", duration=40.0, rate=5.0, power_noise=5.0)
    creeps = {name: 1e-6 * log.channel(name) for name in ("v_left", "v_right")}
    told = diagnose(
        DriveLog({**log.channels, **creeps}, "creeps"),
        simulate.drive(ROBOT, "survey", duration=40.0, rate=5.0, power_noise=5.0, seed=2),
        ROBOT.vehicle, effects=[catalogue()[name] for name in ("surface_border", "hotel_load")],
    )  # fmt: skip
    assert "not tested, as the robot hardly moves: surface border" in told.advice


@pytest.fixture
def calibration(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The benchmark that hides effects in drives of random robots."""
    file = Path(__file__).resolve().parents[2] / "benchmarks" / "calibration.py"
    spec = importlib.util.spec_from_file_location("calibration", file)
    assert spec
    assert spec.loader
    module = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, spec.name, module)
    spec.loader.exec_module(module)
    return module


@pytest.mark.nightly
@pytest.mark.parametrize("choose", [True, False])
def test_effects_that_no_single_one_leads_to_are_found(
    calibration: ModuleType, choose: bool
) -> None:
    """Alone, copper loss fits far off, and what lasts of it is no evidence; others hide it."""
    made = calibration.hidden(129529)
    given = None if choose else [catalogue()[name] for name in made.sizes]
    told = diagnose(made.logs[:-1], made.logs[-1], made.vehicle, effects=given, choose=choose)
    effects = {effect.name: effect for effect in told.effects}
    # A resistance of the way back is half of it, always, and a pull.
    assert ("towing_force" in effects) != ("reverse_drag" in effects)
    for name in ("copper_loss", "stribeck_friction"):
        assert effects[name].value == pytest.approx(made.sizes[name], rel=0.1)


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("seed", "drives"),
    [
        (95046, 1), (95087, 1), (98037, 1), (129090, 3), (129481, 1), (129401, 1), (132091, 1),
        (143522, 1),
    ],
    ids=[
        "ends elsewhere", "needs no delay", "masked pair", "delay behind contacts",
        "a border that few blocks show",
        "a border beside a loss", "a border beside all lines of the grid",
        "a border that a slow robot spins upon",
    ],
)  # fmt: skip
def test_effects_that_a_quick_search_misses_are_found(
    seed: int, drives: int, calibration: ModuleType
) -> None:
    made = calibration.hidden(seed, drives=drives)
    told = diagnose(made.logs[:-1], made.logs[-1], made.vehicle)
    effects = {effect.name: effect for effect in told.effects if effect.name != "wheel_fight"}
    assert set(made.sizes) == set(effects)
    for name, size in made.sizes.items():
        assert math.isclose(effects[name].value, made.size(effects[name]), rel_tol=0.15), (
            name,
            size,
        )


def test_a_line_is_looked_for_again_with_what_was_found_after_it(calibration: ModuleType) -> None:
    """Where it was while the rest was missing, it made an error of 3.3 W on the hold-out drive."""
    made = calibration.hidden(131116)
    entries = [catalogue()[name] for name in made.sizes]
    given, found = (
        diagnose(made.logs[:-1], made.logs[-1], made.vehicle, effects=effects, choose=choose)
        for effects, choose in ((entries, False), (None, True))
    )
    assert found.after.rmse < 1.05 * given.after.rmse
    assert {effect.name for effect in found.effects} == set(made.sizes)


def test_a_line_that_no_drive_crosses_stays_where_it_is_without_a_warning() -> None:
    search = one_drive(ROBOT, ("viscous_loss",))
    far = Part(catalogue()["surface_border"], (("direction", 0.0), ("offset", 1e4)))

    def made(values: FloatArray) -> tuple[list[Part], Problem]:
        params = zip(("direction", "offset"), values.tolist(), strict=True)
        return [replace(far, params=tuple(params))], search.problem

    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert settled(far, made, search.errors) is None
