"""Runs that differ as a whole, what unseen driving is missed by, and robots at rest."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from energyplan import DriveLog, PowerModel, fit, simulate
from energyplan.fit import fit_residual, identify
from energyplan.fit.doubts import pieces_of, unfounded
from energyplan.fit.drive import Drive
from energyplan.fit.estimate import Problem, joint_fit
from energyplan.fit.identification import _draw_at_rest
from energyplan.motion import Motion
from energyplan.power import SLIP, TRACTION, effects

MODEL = PowerModel.preset("quadriga:full:concrete")
TERMS = (SLIP, TRACTION)


def run(factor: float, seed: int) -> Drive:
    """Forty seconds of straights and turns, which take more or less power as a whole."""
    rng = np.random.default_rng(seed)
    left, right = np.repeat(rng.uniform(0.2, 0.8, size=(2, 20)), 20, axis=1)
    motion = Motion(left, right, MODEL.vehicle.icr)
    power = factor * MODEL.power(motion) + rng.normal(0.0, 2.0, 400)
    return Drive(f"run {seed}", 0.1 * np.arange(400), motion, power)


def test_what_runs_share_is_known_no_better_than_their_mean() -> None:
    factors = np.array([0.85, 0.9, 0.97, 1.04, 1.1, 1.14])
    drives = [run(factor, k) for k, factor in enumerate(factors)]
    found = joint_fit(Problem(drives, MODEL.vehicle), TERMS)
    assert found.run_spread == pytest.approx(factors.std(ddof=1), rel=0.15)
    for term, value in zip(TERMS, found.model.coefficients, strict=True):
        error = found.model.std_error(term.name)
        assert error > 0.95 * found.run_spread * value / np.sqrt(6)
        assert error < 3.0 * found.run_spread * value / np.sqrt(6)
    alike = joint_fit(Problem([run(1.0, k) for k in range(6)], MODEL.vehicle), TERMS)
    assert alike.run_spread < 0.02
    assert alike.model.std_error("traction_resistance") < 3.0


def test_only_a_robot_with_both_treads_at_rest_is_at_rest() -> None:
    """It pivots about either tread at unexplained 50 W, and stands for some seconds."""
    at = np.repeat([[0.0, 0.5], [0.0, -0.5], [0.5, 0.0], [-0.5, 0.0], [0.0, 0.0]], 40, axis=0)
    motion = Motion(at[:, 0], at[:, 1], MODEL.vehicle.icr)
    moves = np.any(at != 0.0, axis=1)
    t = 0.1 * np.arange(len(at))
    quiet = Drive("quiet", t, motion, np.where(moves, 50.0, 0.0))
    assert _draw_at_rest([quiet], [np.zeros(200)]) == []
    loaded = Drive("loaded", t, motion, np.where(moves, 50.0, 30.0))
    (said,) = _draw_at_rest([loaded], [np.zeros(200)])
    assert said.startswith("at rest the robot draws 30.0 W that no term explains")
    assert _draw_at_rest([loaded], [np.where(moves, 0.0, 30.0)]) == []
    brief = Drive("brief", t[:179], Motion(*at[:179].T, MODEL.vehicle.icr), loaded.power[:179])
    assert _draw_at_rest([brief], [np.zeros(179)]) == []


def test_stretches_without_a_gap_are_rows_of_all_drives_one_below_the_other() -> None:
    drives = [replace(run(1.0, k), t=0.1 * np.arange(400) + gap * (np.arange(400) >= at))
              for k, (gap, at) in enumerate([(60.0, 150), (0.0, 0), (60.0, 30)])]  # fmt: skip
    pieces = pieces_of(drives)
    told = [(piece.start, piece.stop) for piece in pieces]
    assert told == [(0, 150), (150, 400), (400, 800), (800, 830), (830, 1200)]


@pytest.mark.parametrize(
    ("confidence", "spread", "founded"), [(0.9, 0.0, False), (0.9, 0.05, True), (0.5, 0.0, True)]
)
def test_a_model_without_errors_needs_a_stated_spread_for_bounds(
    confidence: float, spread: float, founded: bool
) -> None:
    model = PowerModel.preset("quadriga:full:concrete")
    bare = replace(model, covariance=None, residual=None)
    assert (unfounded(bare, confidence, spread) == "") == founded
    known = replace(bare, covariance=np.diag([1e-4, 1.0]))
    assert unfounded(known, confidence, spread) == ""


NOISE = {"power_noise": 5.0, "speed_noise": 0.003}


def spiral(seed: int, model: PowerModel = MODEL) -> DriveLog:
    return simulate.drive(model, "spiral", duration=40.0, seed=seed, **NOISE)


def test_what_is_missed_is_what_fits_without_it_miss() -> None:
    """Drives of one robot that grows heavier by a tenth each time, fitted again without each."""
    logs = []
    for k in range(4):
        log = spiral(k)
        power = {name: (1.0 + 0.1 * k) * log.channel(name) for name in ("p_left", "p_right")}
        logs.append(DriveLog({**log.channels, **power}, f"drive {k}"))
    found = identify(logs, MODEL.vehicle, icr="vehicle", method="huber")
    assert found.cross_validation is not None
    refits = [
        identify([one for one in logs if one is not log], MODEL.vehicle, icr="vehicle",
                 method="huber").model
        for log in logs
    ]  # fmt: skip
    errors = [
        abs(fit_residual(model, log).energy_error)
        for model, log in zip(refits, logs, strict=True)
    ]  # fmt: skip
    assert (found.cross_validation.left_out, found.cross_validation.count) == ("drive", 4)
    assert found.cross_validation.duration == pytest.approx(40.0, abs=1.0)
    assert found.cross_validation.error == pytest.approx(np.mean(errors), rel=0.15)
    assert found.cross_validation.largest == pytest.approx(max(errors), rel=0.15)
    assert found.cross_validation.largest > 0.1  # the spread that was put in, and more than is left


def test_a_model_that_lacks_nothing_foretells_and_one_that_lacks_something_says_how_much() -> None:
    cold = MODEL.with_term(effects.term("warm_up"), 150.0)
    warm, warming = (
        identify(simulate.identification_drive(model, seed=1, **NOISE), MODEL.vehicle)
        for model in (MODEL, cold)
    )
    assert warm.cross_validation is not None
    assert warming.cross_validation is not None
    assert (warm.cross_validation.left_out, warm.cross_validation.count) == ("stretch", 5)
    assert warm.cross_validation.error < 0.01 < 0.03 < warming.cross_validation.error
    size = f"energies by some {100 * warming.cross_validation.error:.2g} %"
    assert any(size in text for text in warming.warnings), warming.warnings


def test_drives_that_are_one_motion_only_are_cross_validated_too() -> None:
    """Without turning there is no column of slip to fit; with one sample a stretch, no error."""
    log = simulate.drive(MODEL, (("straight", 30.0),), seed=1, **NOISE)
    found = fit.identify(log, MODEL.vehicle, terms=[effects.term("traction_resistance")])
    assert found.cross_validation is not None
    assert found.cross_validation.error < 0.02
