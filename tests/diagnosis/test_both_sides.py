"""Powers of both sides: what their sum hides, sides that push against each other, and losses."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from by_day import by_day
from made_drives import pair, sized

from energyplan import DriveLog, Vehicle, check, diagnose, simulate
from energyplan.diagnosis import Diagnosis
from energyplan.fit.drive import prepared
from energyplan.fit.estimate import Problem, fit, problem_of, with_signs
from energyplan.io.tables import read_trajectory
from energyplan.motion import Motion
from energyplan.power import HOTEL, SLIP, TRACTION, PowerModel, effects
from energyplan.simulate import Setpoint


def _robot(rng: np.random.Generator) -> PowerModel:
    """A robot of random size, from a small rover to one of a hundred kilograms."""
    size = float(rng.uniform(0.5, 1.3))
    vehicle = sized(size, 40.0 * size**3 * float(rng.uniform(0.7, 1.5)))
    K = float(rng.uniform(0.06, 0.12)) * vehicle.mass * 9.81 / 2
    return PowerModel.paper(vehicle, K=K, mu=float(rng.uniform(0.3, 0.8)))


def _straights_and_spins(rng: np.random.Generator) -> list[Setpoint]:
    """Both treads as fast as each other, all the time."""
    setpoints = []
    for k in range(16):
        speed = float(rng.uniform(0.2, 0.6)) * float(rng.choice([-1.0, 1.0]))
        setpoints += [
            Setpoint(speed if k % 2 else -speed, speed, hold=5.0),
            Setpoint(0.0, 0.0, hold=0.5),
        ]
    return setpoints


@pytest.mark.parametrize("seed", range(4))
def test_which_side_drags_is_told_where_treads_are_always_as_fast_as_each_other(seed: int) -> None:
    # In the sum, what drags on one side is half of what drags on both.
    rng = np.random.default_rng(seed)
    model = _robot(rng)
    drag = 0.4 * model.coefficient("traction_resistance")
    truth = model.with_term(effects.DRAGGING_LEFT, drag)
    noise = 0.02 * float(np.max(truth.power(Motion.from_twist(0.4, 0.5, model.vehicle.icr))))
    log = simulate.drive(truth, _straights_and_spins(rng), power_noise=noise, seed=seed)
    problem = Problem(prepared([log], model.vehicle), model.vehicle)
    terms = (SLIP, TRACTION, effects.DRAGGING_LEFT)

    def found(case: Problem) -> Any:
        design = case.design(terms)
        return fit(design, case.reference(design))

    both, total = found(problem), found(problem.of_totals)
    error = np.sqrt(np.diag(both.reported))
    assert np.all(np.abs(both.values - truth.coefficients) < 4 * error)
    assert error[2] < 0.1 * drag
    # Told by the sum: how much drags together; not: where.
    together = total.values[1] + 0.5 * total.values[2]
    assert together == pytest.approx(truth.coefficients[1] + 0.5 * drag, rel=0.02)
    assert abs(total.values[2] - drag) > 0.5 * drag


@pytest.mark.parametrize("seed", by_day(range(4), [0]))
def test_losses_of_each_side_are_found_on_robots_of_any_size(seed: int) -> None:
    rng = np.random.default_rng(10 + seed)
    model = _robot(rng)
    K = model.coefficient("traction_resistance")
    size = 0.04 / K  # 8 % of what rolling takes at half a metre a second
    truth = model.with_term(effects.COPPER_LOSS, size).with_term(effects.DRAGGING_LEFT, 0.4 * K)
    noise = {"power_noise": 0.01 * K, "speed_noise": 0.003, "without": {"accel_x"}}
    told = diagnose(*pair(truth, seed, seed + 50, **noise), model.vehicle)
    sizes = {effect.name: effect for effect in told.effects}
    assert "copper_loss" in sizes
    assert "dragging_wheel_left" in sizes
    copper = sizes["copper_loss"]
    assert abs(copper.value - size) < 4 * copper.std_error


def _tracked(model: PowerModel, seed: int) -> DriveLog:
    """A drive whose straights are held by a controller: the sides push against each other there."""
    rng = np.random.default_rng(seed)
    made = simulate.identification_drive(model, seed=seed, without={"accel_x"})
    t = np.arange(0.0, 100.0, 0.05)
    track = model.vehicle.icr.slip_track
    steer = 0.008 * track * np.sin(2 * np.pi * t / 5.3)
    speed = 0.35 + 0.25 * np.sin(2 * np.pi * t / 37.0)
    motion = Motion(speed - 0.5 * steer, speed + 0.5 * steer, model.vehicle.icr)
    # What steering built up has nothing to do with the way it turns just now.
    limit = model.coefficient("slip_friction") * model.vehicle.slip_moment
    moment = 0.9 * limit * np.sin(2 * np.pi * t / 23.0 + rng.uniform(0, 6))
    K = model.coefficient("traction_resistance")
    forces = (K - moment / track, K + moment / track)
    lost, returning = _losses(model)
    pushed = [force * v for force, v in zip(forces, (motion.v_left, motion.v_right), strict=True)]
    powers = [p + lost * np.maximum(p, 0.0) + returning * np.maximum(-p, 0.0) for p in pushed]
    columns = {
        "v_left": motion.v_left, "v_right": motion.v_right, "p_left": powers[0],
        "p_right": powers[1], "yaw_rate": motion.omega,
    }  # fmt: skip
    joined = {
        name: np.concatenate([made.channel(name), values]) for name, values in columns.items()
    }
    noisy = {
        name: values + 3.0 * rng.standard_normal(len(values)) if name.startswith("p_") else values
        for name, values in joined.items()
    }
    return DriveLog(
        {"t": np.concatenate([made.t, made.t[-1] + 0.05 + t]), **noisy}, f"tracked {seed}"
    )


LOSSY = (
    PowerModel.preset("quadriga:full:concrete")
    .with_term(effects.DRIVE_LOSS, 1 / 0.85 - 1)
    .with_term(effects.REGENERATION_LOSS, 0.5)
)


def _losses(model: PowerModel) -> tuple[float, float]:
    """Return the shares that are lost of power drawn and of power returned."""
    lost, returning = (
        model.coefficient(name) if model.has(name) else 0.0
        for name in ("drive_efficiency", "regeneration_efficiency")
    )
    return lost, returning


def test_sides_that_push_against_each_other_are_named_where_that_costs_energy() -> None:
    told = diagnose(_tracked(LOSSY, 1), _tracked(LOSSY, 2), LOSSY.vehicle)
    names = [effect.name for effect in told.effects]
    assert names[-1] == "wheel_fight"
    lost, returning = _losses(told.model)
    # of the efficiencies, powers tell what comes back of drawn power
    assert (1.0 - returning) / (1.0 + lost) == pytest.approx(0.85 * 0.5, abs=0.02)
    # A planner counts it: a straight line costs more than its traction resistance.
    straight = told.model.breakdown(Motion.from_twist(0.5, 0.0, LOSSY.vehicle.icr))
    fight = float(straight["wheel_fight"])
    assert fight > 0.05 * (sum(map(float, straight.values())) - fight)
    assert abs(told.after.energy_error) < 0.02


def test_sides_that_push_against_each_other_cost_nothing_without_losses() -> None:
    model = PowerModel.preset("quadriga:full:concrete")
    told = diagnose(_tracked(model, 3), _tracked(model, 4), model.vehicle)
    assert "wheel_fight" not in [effect.name for effect in told.effects]
    assert told.after.energy_error == pytest.approx(0.0, abs=0.01)


@pytest.mark.parametrize(
    ("returned", "hotel"),
    [(0.0, 0.0), (0.0, 30.0), (0.4, 30.0), (1.0, 0.0), (1.0, 10.0)],
)
def test_motors_that_return_little_are_no_sensors_without_a_sign(
    returned: float, hotel: float
) -> None:
    model = PowerModel.preset("quadriga:full:concrete").with_term(HOTEL, hotel)
    truth = model.with_term(effects.REGENERATION_LOSS, 1.0 - returned)
    log = simulate.identification_drive(truth, seed=1, **NOISE)
    assert _equations(log, model.vehicle) == 2
    if returned == 1.0:
        shown = {name: np.abs(log.channel(name)) for name in ("p_left", "p_right")}
        rectified = DriveLog({**log.channels, **shown}, "rectified")
        assert _equations(rectified, model.vehicle) == 1


NOISE: dict[str, Any] = {"power_noise": 5.0, "speed_noise": 0.002, "without": {"accel_x"}}


def _equations(log: DriveLog, vehicle: Vehicle) -> int:
    return problem_of([log], vehicle, ()).drives[0].equations


PLACE = Path("driven")
QUADRIGA = Vehicle.preset("quadriga:full")
TRUE = {
    "copper_loss": {"slip_friction": 0.661, "traction_resistance": 118.0, "copper_loss": 0.000632},
    # over the efficiency; what powers tell of both efficiencies is the round trip
    "driver_efficiency": {
        "slip_friction": 0.751, "traction_resistance": 134.1, "regeneration_efficiency": 0.472,
    },
}  # fmt: skip


def driven(shared_data: Path, scenario: str) -> dict[str, DriveLog]:
    files = sorted((shared_data / PLACE).glob(f"{scenario}_*.csv.gz"))
    return {file.name.removesuffix(".csv.gz"): DriveLog.read(file) for file in files}


@pytest.fixture(scope="module", params=sorted(TRUE))
def told(request: pytest.FixtureRequest, shared_data: Path) -> tuple[str, Diagnosis]:
    """Learn from four of six drives that a tracking controller made."""
    every = driven(shared_data, request.param)
    rest = [log for name, log in every.items() if "_1_" not in name]
    judged = [log for name, log in every.items() if "_1_" in name]
    return request.param, diagnose(rest, judged, QUADRIGA)


@pytest.mark.shared
def test_coefficients_of_working_drives_are_right(told: tuple[str, Diagnosis]) -> None:
    scenario, found = told
    for name, true in TRUE[scenario].items():
        assert found.model.coefficient(name) == pytest.approx(true, rel=0.05), name


@pytest.mark.shared
def test_plans_are_priced(told: tuple[str, Diagnosis], shared_data: Path) -> None:
    scenario, found = told
    for one, route in zip(found.predictions, ("least", "shortest"), strict=True):
        wanted = read_trajectory(shared_data / PLACE / f"{scenario}_1_{route}_trajectory.csv")
        assert check(wanted, found.model).energy == pytest.approx(one.measured, rel=0.06)
        low, high = one.energy_interval
        assert low < one.measured < high


@pytest.mark.shared
def test_the_owner_is_told_what_the_sides_waste(told: tuple[str, Diagnosis]) -> None:
    _, found = told
    heat = found.effects[-1]
    assert heat.name == "wheel_fight"
    assert heat.unit == "W"
    assert 0.02 < heat.details["share of the energy"] < 0.17
    assert [line for line in found.advice if "a dead band of the heading" in line]
    average = found.average
    assert average is not None
    if average.explanation_error < average.cautious_error:
        assert not [line for line in found.advice if "do not believe" in line]
        assert not [line for line in found.advice if "suspicion" in line]


def test_the_sign_of_powers_is_what_the_logs_say_or_all_of_them_show() -> None:
    model = PowerModel.preset("quadriga:full:concrete").with_term(HOTEL, 30.0)
    one, other = (
        simulate.identification_drive(model, seed=seed, **NOISE) for seed in (1, 2)
    )  # fmt: skip
    shown = {name: np.abs(one.channel(name)) for name in ("p_left", "p_right")}
    lost = DriveLog({**one.channels, **shown}, "lost")

    def equations(*logs: DriveLog) -> int:
        return problem_of(logs, model.vehicle, ()).drives[0].equations

    assert equations(one, other) == 2
    assert equations(replace(one, signed=False), other) == 1
    assert equations(lost, other) == 1
    assert equations(replace(lost, signed=True), replace(other, signed=True)) == 2
    signed = with_signs([lost, other], model.vehicle, ())
    assert [log.signed for log in signed] == [False, False]
    assert [equations(log) for log in signed] == [1, 1]  # of any part of the set
    assert [log.signed for log in with_signs([one, other], model.vehicle, ())] == [True, True]
