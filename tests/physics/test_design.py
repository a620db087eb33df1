"""The next drive, designed: what it promises against what other drives would do."""

from __future__ import annotations

import numpy as np
import pytest

import energyplan as ep
from energyplan import Motion
from energyplan.diagnosis.design import Hypothesis, design, explanations_of
from energyplan.errors import InvalidInputError
from energyplan.power import Sides
from energyplan.power.effects import term

MODEL = ep.PowerModel.preset("quadriga:full:concrete")
SPEEDS = (Hypothesis(("viscous_loss",), values={"viscous_loss": 60.0}), Hypothesis(("air_drag",)))


def test_a_slow_and_a_fast_part_tell_viscous_loss_from_drag() -> None:
    made = design(MODEL, SPEEDS, duration=40.0)
    assert made.trajectory.duration <= 40.0
    assert min(value for _, value in made.probabilities_expected) > 0.95
    assert all(pair.log_odds > 3 for pair in made.separates)
    for values in (made.trajectory.v, made.trajectory.omega):
        assert values[0] == values[-1] == 0.0


def test_the_designed_drive_stays_in_the_free_space() -> None:
    made = design(MODEL, SPEEDS, duration=30.0, square=4.0)
    hall = ep.OccupancyGrid.from_polygons([], (0.0, 0.0, 4.0, 4.0))
    assert np.all(hall.footprint_free(made.trajectory.poses, MODEL.vehicle))


def shown(trajectory: ep.Trajectory, name: str) -> float:
    """Part of an effect's power that the model's own terms cannot take over."""
    motion = Motion.from_trajectory(trajectory, MODEL.vehicle.icr, slope=0.0)
    columns = MODEL.with_term(term(name), 0.0).regressors(motion)
    rows = np.column_stack([c.total if isinstance(c, Sides) else c for c in columns])
    own, effect = rows[:, :-1], rows[:, -1]
    left = effect - own @ np.linalg.lstsq(own, effect, rcond=None)[0]
    return float(np.linalg.norm(left) / max(np.linalg.norm(effect), 1e-9))


def test_a_screening_drive_shows_what_the_parameters_alone_do_not_ask_for() -> None:
    made = design(MODEL, duration=60.0)
    narrow = made.trajectory
    assert made.separates == ()
    assert np.abs(narrow.omega).max() > 0.2  # friction needs turns,
    assert np.abs(narrow.v).max() > 0.2  # and resistance straights
    screen = design(MODEL, duration=60.0, screen=True).trajectory
    for name in ("turn_asymmetry", "towing_force", "friction_mobilisation", "hotel_load"):
        assert shown(screen, name) > shown(narrow, name), name


def test_what_no_drive_can_tell_is_said() -> None:
    """On level ground an accelerometer feels what inertia asks for."""
    made = design(MODEL, [Hypothesis(("linear_inertia",)), Hypothesis(("specific_force",))])
    assert all(pair.log_odds < 0.01 for pair in made.separates)
    assert dict(made.probabilities_expected)["linear inertia"] == pytest.approx(0.5, abs=0.01)
    assert "not expected to separate" in made.sentence


def test_reports() -> None:
    found = {"name": "viscous_loss", "value": 60.0, "rivals": ["air_drag"]}
    pair = explanations_of({"effects": [found]})
    assert [e.effects for e in pair] == [("viscous_loss",), ("air_drag",)]
    listed = [{"effects": ["air_drag"], "probability": 0.3}, {"effects": [], "probability": 0.7}]
    pair = explanations_of({"effects": [], "explanations": listed})
    assert [e.probability for e in pair] == [0.7, 0.3]
    for bad in ({}, {"effects": [3]}, {"effects": 3}):
        with pytest.raises(InvalidInputError, match="diagnose --json"):
            explanations_of(bad)
