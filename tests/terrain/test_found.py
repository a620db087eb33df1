"""Ground that a model knows of counts wherever something is planned, timed, checked or budgeted."""

from dataclasses import replace

import numpy as np
import pytest

from energyplan import (
    Battery,
    EnergyCost,
    HeightMap,
    Mission,
    OccupancyGrid,
    Path,
    PlanningProblem,
    Pose,
    PowerModel,
    Task,
    check,
    evaluate,
    plan,
)
from energyplan.limits.speed import profile
from energyplan.power.effects import term, with_weight
from energyplan.terrain import laid_out, path_price

LEVEL = PowerModel.preset("quadriga:empty:concrete")
MASS, TILT = LEVEL.vehicle.mass, np.array([0.06, 0.03])
TILTED = LEVEL.with_term(term("tilt_x"), MASS * TILT[0]).with_term(term("tilt_y"), MASS * TILT[1])
HALL = OccupancyGrid(np.zeros((60, 80), bool), 0.2)
START, GOAL = Pose(2.0, 2.0, 0.0), Pose(13.0, 9.0, 1.0)


def sloping() -> HeightMap:
    """The same plane, as heights."""
    steep = TILT / np.sqrt(1.0 - TILT @ TILT)
    i, j = np.indices((13, 17)) * 1.0
    return HeightMap(steep[0] * j + steep[1] * i, 1.0)


@pytest.mark.parametrize("also_grade", [False, True])
def test_a_tilted_plane_is_planned_timed_and_checked_like_the_same_heights(also_grade):
    model = with_weight(TILTED) if also_grade else TILTED
    known = with_weight(LEVEL)
    one = plan(PlanningProblem(HALL, EnergyCost(model), START, GOAL), effort=1500)
    other = plan(
        PlanningProblem(HALL, EnergyCost(known), START, GOAL, heights=sloping()), effort=1500
    )
    level = plan(PlanningProblem(HALL, EnergyCost(LEVEL), START, GOAL), effort=1500)
    assert one.energy == pytest.approx(other.energy, rel=1e-3)
    assert one.energy > 1.1 * level.energy
    way = Path(Pose(3.0, 3.0, 0.2), ds=[4.0, 3.0, 2.0], dtheta=[0.0, 1.0, 0.0])
    timed = profile(way, model)
    same = profile(way, known, heights=sloping())
    assert timed.duration == pytest.approx(same.duration, rel=1e-3)
    told = check(timed, model).energy
    assert told == pytest.approx(check(timed, known, heights=sloping()).energy, rel=1e-6)
    assert told > 1.1 * check(timed, LEVEL).energy


def test_a_mission_climbs_the_plane_that_its_model_knows_of():
    def climb(model: PowerModel, heights: HeightMap | None = None) -> float:
        mission = Mission(
            model, HALL, Battery.preset("quadriga"), START, (Task("there", GOAL),),
            heights=heights, planning_effort=800, confidence=0.5,
            payload_models={model.name: {10.0: model}},
        )  # fmt: skip
        return evaluate(mission).legs[0].energy

    assert climb(TILTED) == pytest.approx(climb(with_weight(LEVEL), sloping()), rel=1e-3)
    assert climb(TILTED) > 1.1 * climb(LEVEL)


def test_a_surface_beyond_a_line_is_planned_on():
    beyond = replace(term("traction_beyond"), params={"direction": 0.0, "offset": 7.0})
    found = LEVEL.with_term(beyond, 40.0)
    straight = Path(Pose(2.0, 5.0, 0.0), ds=[10.0], dtheta=[0.0])
    across = PlanningProblem(HALL, EnergyCost(found), straight.start, Pose(12.0, 5.0, 0.0))
    more = plan(across, effort=300).energy - path_price(straight, EnergyCost(LEVEL)).energy
    assert more == pytest.approx(2 * 40.0 * 5.0, rel=0.02)
    drive = profile(straight, LEVEL)
    assert check(drive, found).energy - check(drive, LEVEL).energy == pytest.approx(400.0, rel=0.02)


def test_what_is_given_says_more_than_the_model():
    known = HeightMap(np.zeros((2, 2)), 100.0)
    ground = laid_out(TILTED, HALL.corners, heights=known)
    assert ground.heights is known
    assert not ground.model.has("tilt_x")
    assert laid_out(LEVEL, HALL.corners) == (LEVEL, None, None)
