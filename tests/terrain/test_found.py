"""Ground that a model knows of counts wherever something is planned, timed, checked or budgeted."""

from dataclasses import replace

import numpy as np
import pytest
from worlds import MODEL as LEVEL
from worlds import room

import energyplan as ep
from energyplan.power.effects import term, with_weight
from energyplan.terrain import laid_out, path_price

MASS, TILT = LEVEL.vehicle.mass, np.array([0.06, 0.03])
TILTED = LEVEL.with_term(term("tilt_x"), MASS * TILT[0]).with_term(term("tilt_y"), MASS * TILT[1])
HALL = room(60, 80, 0.2)
START, GOAL = ep.Pose(2.0, 2.0, 0.0), ep.Pose(13.0, 9.0, 1.0)


def sloping() -> ep.HeightMap:
    """The same plane, as heights."""
    steep = TILT / np.sqrt(1.0 - TILT @ TILT)
    i, j = np.indices((13, 17)) * 1.0
    return ep.HeightMap(steep[0] * j + steep[1] * i, 1.0)


@pytest.mark.parametrize("also_grade", [False, True])
def test_a_tilted_plane_is_planned_timed_and_checked_like_the_same_heights(also_grade):
    model = with_weight(TILTED) if also_grade else TILTED
    known = with_weight(LEVEL)
    one, other, level = (
        ep.plan(
            ep.PlanningProblem(HALL, ep.EnergyCost(law), START, GOAL, heights=ground), effort=1500
        )
        for law, ground in ((model, None), (known, sloping()), (LEVEL, None))
    )
    assert one.energy == pytest.approx(other.energy, rel=1e-3)
    assert one.energy > 1.1 * level.energy
    way = ep.Path(ep.Pose(3.0, 3.0, 0.2), ds=[4.0, 3.0, 2.0], dtheta=[0.0, 1.0, 0.0])
    timed = ep.profile(way, model)
    same = ep.profile(way, known, heights=sloping())
    assert timed.duration == pytest.approx(same.duration, rel=1e-3)
    told = ep.check(timed, model).energy
    assert told == pytest.approx(ep.check(timed, known, heights=sloping()).energy, rel=1e-6)
    assert told > 1.1 * ep.check(timed, LEVEL).energy


def test_a_mission_climbs_the_plane_that_its_model_knows_of():
    def climb(model: ep.PowerModel, heights: ep.HeightMap | None = None) -> float:
        mission = ep.Mission(
            model, HALL, ep.Battery.preset("quadriga"), START, (ep.Task("there", GOAL),),
            heights=heights, planning_effort=800, confidence=0.5,
            payload_models={model.name: {10.0: model}},
        )  # fmt: skip
        return ep.evaluate(mission).legs[0].energy

    assert climb(TILTED) == pytest.approx(climb(with_weight(LEVEL), sloping()), rel=1e-3)
    assert climb(TILTED) > 1.1 * climb(LEVEL)


def test_a_surface_beyond_a_line_is_planned_on():
    beyond = replace(term("traction_beyond"), params={"direction": 0.0, "offset": 7.0})
    found = LEVEL.with_term(beyond, 40.0)
    straight = ep.Path(ep.Pose(2.0, 5.0, 0.0), ds=[10.0], dtheta=[0.0])
    across = ep.PlanningProblem(HALL, ep.EnergyCost(found), straight.start, ep.Pose(12.0, 5.0, 0.0))
    more = ep.plan(across, effort=300).energy - path_price(straight, ep.EnergyCost(LEVEL)).energy
    assert more == pytest.approx(2 * 40.0 * 5.0, rel=0.02)
    drive = ep.profile(straight, LEVEL)
    assert ep.check(drive, found).energy - ep.check(drive, LEVEL).energy == pytest.approx(
        400.0, rel=0.02
    )


def test_what_is_given_says_more_than_the_model():
    known = ep.HeightMap(np.zeros((2, 2)), 100.0)
    ground = laid_out(TILTED, HALL.corners, heights=known)
    assert ground.heights is known
    assert not ground.model.has("tilt_x")
    assert laid_out(LEVEL, HALL.corners) == (LEVEL, None, None)
