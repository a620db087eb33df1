"""The search: what it tries beside the quick one's sets, and lines on the ground."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from made_drives import pair

from energyplan import DriveLog, PowerModel, diagnose, simulate
from energyplan.diagnosis.candidates import ContactTraces, mark_changes
from energyplan.diagnosis.search import EffectSearch
from energyplan.fit.drive import ON_TIME, Drive, prepared
from energyplan.fit.estimate import PAPER, Problem
from energyplan.motion import Motion
from energyplan.power.effects import SLIP_BEYOND, VISCOUS_LOSS, catalogue, term

ROBOT = PowerModel.preset("quadriga:full:concrete")


def one_drive(model: PowerModel, disturbed: float = 0.0) -> EffectSearch:
    """Return a search over one effect, on a drive with a power that none of them has."""
    log = simulate.drive(
        model, simulate.IDENTIFICATION, rate=10.0, speed=0.7, power_noise=1.0, measured="total",
        without={"accel_x"},
    )  # fmt: skip
    size = disturbed * float(np.sqrt(np.mean(log.power**2)))
    swing = np.sqrt(2.0) * size * np.sin(2.0 * np.pi * log.t / 23.0)
    log = DriveLog({**log.channels, "power": log.power + swing}, log.name)
    problem = Problem(prepared([log], ROBOT.vehicle), ROBOT.vehicle)
    made = EffectSearch(problem, [catalogue()["viscous_loss"]], lambda *_: None, 4)
    made.quick.errors = problem.reference(problem.design(ROBOT.terms))
    return made


@pytest.mark.parametrize("disturbed", [0.0, 0.01])
def test_a_small_effect_is_one_where_less_than_it_is_missing(disturbed: float) -> None:
    search = one_drive(ROBOT.with_term(VISCOUS_LOSS, 2.5), disturbed)
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
    search = one_drive(ROBOT)
    drive = search.quick.problem.drives[0]
    late = drive.t > 0.94 * drive.t[-1]
    drive = replace(drive, power=drive.power * np.where(late, 1.5, 1.0))
    problem = Problem([drive], ROBOT.vehicle)
    marked = mark_changes(problem, PAPER, problem.reference(problem.design(PAPER)))
    assert 0.09 < float(np.mean(marked.drives[0].motion.channels["changed"])) < 0.91


def test_a_robot_that_hardly_moves_crosses_no_line() -> None:
    log = simulate.drive(ROBOT, "survey", duration=40.0, rate=5.0, power_noise=5.0)
    creeps = {name: 1e-6 * log.channel(name) for name in ("v_left", "v_right")}
    told = diagnose(
        DriveLog({**log.channels, **creeps}, "creeps"),
        simulate.drive(ROBOT, "survey", duration=40.0, rate=5.0, power_noise=5.0, seed=2),
        ROBOT.vehicle, effects=[catalogue()[name] for name in ("surface_border", "hotel_load")],
    )  # fmt: skip
    assert "not tested, as the robot hardly moves: surface border" in told.advice


VEHICLE = ROBOT.vehicle
BORDER = catalogue()["surface_border"]


@pytest.mark.parametrize("rough", [0.0, 0.3])
def test_a_border_is_searched_on_demand_and_the_residual_says_when(rough: float) -> None:
    line = {"direction": 0.4, "offset": 0.3}
    truth = ROBOT
    for name, size in (("slip_beyond", rough), ("traction_beyond", 150.0 * rough)):
        truth = truth.with_term(replace(term(name), params=line), size) if rough else truth
    logs = [
        simulate.drive(
            truth, simulate.IDENTIFICATION, rate=10.0, power_noise=5.0, measured="total",
            without={"accel_x"}, seed=k,
        ) for k in (1, 2)
    ]  # fmt: skip
    told = diagnose(*logs, VEHICLE)
    assert "surface_border" not in [one.name for one in told.effects]
    assert ("border" in told.suspects) == (rough > 0.0)
    assert any("--border (Python: border=True)" in one for one in told.advice) == (rough > 0.0)
    if rough:
        told = diagnose(*logs, VEHICLE, border=True)
        assert "surface_border" in [one.name for one in told.effects]
        assert "border" not in told.suspects


def ground(x: np.ndarray, yaw: np.ndarray, away: float = 0.0) -> ContactTraces:
    """The ground under a robot that always moves, ten samples a second."""
    t = 0.1 * np.arange(len(x))
    channels = {"x": x + away, "y": 0.0 * t - away, "yaw": yaw}
    motion = Motion(0.0 * t - 0.2, 0.0 * t + 0.2, VEHICLE.icr, channels)
    return ContactTraces([replace(Drive.at(motion), t=t)], VEHICLE)


def test_wheels_cross_a_line_that_the_middle_of_the_robot_does_not() -> None:
    t = np.arange(0.0, 20.0, 0.1)
    spun = ground(0.0 * t, 0.5 * t)
    reach = float(np.hypot(*VEHICLE.contacts.T).max())
    assert spun.crosses(np.array([0.0, 0.5 * reach]))
    assert not spun.crosses(np.array([0.0, 1.1 * reach]))
    found = [dict(part.params)["offset"] for part in spun.lines(BORDER)]
    assert np.std(found) > 0.2 * reach


@pytest.mark.parametrize(("visits", "tells"), [(1, False), (3, True)])
def test_what_lies_beyond_is_told_by_a_tenth_of_the_time_or_by_several_visits(
    visits: int, tells: bool
) -> None:
    x = np.zeros(1000)
    for k in range(visits):
        x[200 * k + 100 : 200 * k + 100 + 60 // visits] = 5.0
    assert ground(x, 0.0 * x).crosses(np.array([0.0, 2.5])) == tells
    # seen from the other side, it is the same line
    assert ground(x, 0.0 * x).crosses(np.array([np.pi, -2.5])) == tells
    long = np.repeat([0.0, 5.0], [800, 200])
    assert ground(long, 0.0 * long).crosses(np.array([0.0, 2.5]))
    assert not ground(np.append(long, np.zeros(9000)), np.zeros(10_000)).crosses(
        np.array([0.0, 2.5])
    )


def test_lines_turn_about_the_middle_of_the_ground_wherever_the_origin_is() -> None:
    t = np.arange(0.0, 100.0, 0.1)
    for away in (0.0, 5e5):
        walked = ground(4.0 * np.sin(0.3 * t), 0.2 * t, away)
        part = list(walked.lines(BORDER))[2]
        here = np.array([value for _, value in part.params])
        apart = walked.from_middle(here)
        assert abs(apart[1]) < 5.0
        assert walked.from_origin(apart) == pytest.approx(here)
        near = [np.array([v for _, v in one.params]) for one in walked.about([part], walked.levels)]
        assert len(near) > 5
        gaps = [walked.from_middle(one) - apart for one in near]
        # the closest lines are an eighth of a contact's distance apart
        reach = float(np.hypot(*VEHICLE.contacts.T).max())
        assert np.max(np.abs(gaps), axis=0)[1] == pytest.approx(reach / 8, rel=1e-3)


def shifted(log: DriveLog, away: float) -> DriveLog:
    x, y = (log.channel(name) for name in "xy")
    return DriveLog({**log.channels, "x": x + away, "y": y - away}, log.name)


@pytest.mark.parametrize("away", [0.0, 5e5])
def test_a_border_that_wheels_cross_in_spins_is_found_to_centimetres(away: float) -> None:
    model = PowerModel.preset("husky_a200:flooring")
    direction, offset = 2.658, 0.3
    line = replace(SLIP_BEYOND, params={"direction": direction, "offset": offset})
    truth = model.with_term(line, 0.2)
    noise = {"power_noise": 3.0, "speed_noise": 0.003, "without": {"accel_x"}}
    drives = pair(truth, **noise)
    told = diagnose(
        *(shifted(log, away) for log in drives), model.vehicle, effects=[BORDER], choose=False
    )
    (found,) = told.effects
    way = np.sign(np.cos(found.details["direction"] - direction))
    assert way * np.sin(found.details["direction"] - direction) == pytest.approx(0.0, abs=0.02)
    normal = np.array([np.cos(found.details["direction"]), np.sin(found.details["direction"])])
    at = way * (found.details["offset"] - np.array([away, -away]) @ normal)
    assert at == pytest.approx(offset, abs=0.03)
    assert way * found.value == pytest.approx(0.2, abs=3 * found.std_error)
    assert told.after.rmse < 1.5 * 3.0 * np.sqrt(2)
