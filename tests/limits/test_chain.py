"""What `profile` makes, `check` accepts; and its energy is that of an independent integral."""

from dataclasses import replace

import numpy as np
import pytest
from by_day import by_day
from limits.fine_integral import fine_energy, random_case
from limits.least_drive import least_energy
from scipy.integrate import cumulative_trapezoid
from worlds import room

from energyplan.cost import EnergyCost
from energyplan.limits.feasibility import check
from energyplan.limits.speed import profile
from energyplan.path import Path, Pose, Trajectory
from energyplan.planning.driven import drive_path, priced_models
from energyplan.power import PowerModel
from energyplan.power.effects import term
from energyplan.terrain import HeightMap
from energyplan.vehicle import MotorLimits


@pytest.mark.parametrize("seed", range(4))
def test_every_profile_is_accepted_and_its_energy_is_the_integral(seed):
    """On paths with corners, rounded or not, and on curves, within limits of all kinds."""
    rng = np.random.default_rng([25, seed])
    for k in range(12):
        case = random_case(rng)
        path, smooth = case.path, (0.0, 0.1)[k // 2 % 2]
        if k % 3 == 2:
            path, smooth = smooth_curve(rng), float(rng.choice([0.05, 0.1, 0.3]))
        lateral = {} if k % 4 else {"lateral_acceleration": float(rng.uniform(0.05, 1.0))}
        objective = ("time", "energy")[k % 2]
        made = profile(
            path, case.model, vehicle=case.vehicle, objective=objective, smooth=smooth, **lateral
        )
        report = check(made, case.model, case.vehicle, **lateral)
        assert report.feasible, (k, report.violations[0])
        assert made.poses[[0, -1]] == pytest.approx(np.array([path.start, path.end]), abs=1e-9)
        at_battery = check(made, case.model.battery_side(), case.vehicle)
        for battery, found in ((False, report), (True, at_battery)):
            exact = fine_energy(made, case.model.vehicle, case.size, battery=battery)
            assert found.energy == pytest.approx(exact, rel=1e-5)


def test_energy_is_exact_where_a_drive_brakes_and_turns_round_between_two_samples():
    # Two samples, 4 s apart: forwards at 1 m/s, then backwards; the power jumps in between.
    model = PowerModel.preset("quadriga:empty:concrete").with_term(term("hotel_load"), 7.0)
    lossy = model.with_term(term("linear_inertia"), 83.0).with_term(
        term("regeneration_efficiency"), 1.0
    )
    turn = Trajectory([0.0, 4.0], [0.0, 0.0], [0.0, 0.0], [0.0, 0.0], [1.0, -1.0], [0.0, 0.0])
    # Each half: 1 m at 2 K = 226 N. Of the kinetic energy, 41.5 N m, nothing comes back: braking
    # takes 41.5 N of the 226 N, speeding up adds them.
    assert check(turn, model).energy == pytest.approx(2 * 226.0 + 28.0, rel=1e-12)
    assert check(turn, lossy).energy == pytest.approx(2 * 226.0 + 28.0, rel=1e-9)
    hard = Trajectory([0.0, 0.2], [0.0, 0.0], [0.0, 0.0], [0.0, 0.0], [1.0, -1.0], [0.0, 0.0])
    # Braking from 1 m/s in 0.1 s returns 830 - 226 N over 0.05 m, which is lost.
    expected = (830.0 + 226.0) * 0.05 + 7.0 * 0.2
    assert check(hard, lossy).energy == pytest.approx(expected, rel=1e-7)


def test_the_battery_of_the_vehicle_limits_profile_and_check():
    model = PowerModel.preset("quadriga:empty:concrete").with_term(term("linear_inertia"), 83.0)
    strong = replace(model.vehicle, motor=MotorLimits(speed=1.2, acceleration=4.0))
    weak = replace(strong, battery_power=200.0, battery_return=0.5)
    path = Path(Pose(0, 0, 0), [2.0], [0.0])
    free, made = profile(path, model, vehicle=strong), profile(path, model, vehicle=weak)
    assert made.duration > 1.2 * free.duration
    assert check(made, model, weak).feasible
    kinds = {violation.kind for violation in check(free, model, weak).violations}
    assert kinds == {"battery_power", "battery_return"}


def smooth_curve(rng, step=0.05):
    """Arcs of 5 cm with a curvature that changes slowly, up to 5 1/m; forwards or backwards."""
    n, bump = int(rng.integers(40, 200)), np.hanning(25)
    bend = np.convolve(rng.normal(0, 3, n + 24), bump / bump.sum(), mode="valid")
    step = step * float(rng.choice([1, -1]))
    return Path(Pose(0, 0, 0), np.full(n, step), step * bend * rng.uniform(0.5, 2.5))


def toppra_duration_along(made, icr, speed, acceleration):
    """Least time along the very curve that was driven, by toppra on 1001 points of a spline."""
    toppra = pytest.importorskip("toppra")
    from toppra import algorithm, constraint

    parts = 20
    part = (np.arange(parts) + 0.5) / parts
    step = np.diff(made.t)[:, None] / parts
    v, omega = (x[:-1, None] + np.diff(x)[:, None] * part for x in (made.v, made.omega))
    treads = np.column_stack(
        [((v - icr.left * omega) * step).ravel(), ((v + icr.right * omega) * step).ravel()]
    )
    along = np.append(0.0, np.cumsum(np.abs(treads).max(axis=1)))
    place = np.vstack([np.zeros((1, 2)), np.cumsum(treads, axis=0)])
    even = np.linspace(0, along[-1], 501)
    curve = toppra.SplineInterpolator(
        even, np.column_stack([np.interp(even, along, side) for side in place.T])
    )
    limits = [
        constraint.JointVelocityConstraint(np.array([[-speed, speed]] * 2)),
        constraint.JointAccelerationConstraint(np.array([[-acceleration, acceleration]] * 2)),
    ]
    solver = algorithm.TOPPRA(
        limits, curve, gridpoints=np.linspace(0, along[-1], 1001),
        parametrizer="ParametrizeConstAccel",
    )  # fmt: skip
    return solver.compute_trajectory(0, 0).duration


def test_smooth_curves_take_no_longer_than_toppra_says():
    model = PowerModel.preset("quadriga:empty:concrete")
    motor = MotorLimits(speed=1.2, acceleration=1.0)
    vehicle = replace(model.vehicle, motor=motor)
    rng = np.random.default_rng(1)
    for _ in range(8):
        path = smooth_curve(rng)
        made = profile(path, model, vehicle=vehicle, smooth=0.5)
        assert check(made, model, vehicle).feasible
        # On the very curve that was driven it is no slower, but for how either samples.
        same = toppra_duration_along(made, vehicle.icr, motor.speed, motor.acceleration)
        assert made.duration <= 1.003 * same


def test_a_corner_is_rounded_within_the_tolerance_and_saves_the_stop():
    model = PowerModel.preset("quadriga:empty:concrete").with_term(term("linear_inertia"), 83.0)
    c = model.vehicle.icr.left
    path = Path(Pose(0, 0, 0), [2.0, 1.2 * c, 2.0], [0.0, 1.2, 0.0])
    stops = profile(path, model)
    for tolerance in (0.01, 0.03, 0.1):
        made = profile(path, model, smooth=1.0, tolerance=tolerance)
        assert check(made, model).feasible
        assert made.duration < 0.97 * stops.duration
        between = np.abs(made.t - 0.5 * made.duration) < 0.5 * made.duration - 0.1
        assert np.hypot(made.v, made.omega)[between].min() > 0.05
        # Integrate what is commanded: it ends where the path does but for the tolerance's offsets.
        assert made.poses[-1] == pytest.approx(path.end, abs=1e-9)
        fine = np.linspace(0, made.duration, 20_001)
        v, w = np.interp(fine, made.t, made.v), np.interp(fine, made.t, made.omega)
        step = fine[1]
        yaw = cumulative_trapezoid(w, dx=step, initial=0.0)
        x, y = (np.trapezoid(v * along(yaw), dx=step) for along in (np.cos, np.sin))
        off = np.hypot(x - path.end.x, y - path.end.y)
        assert off <= 2 * 2 * tolerance + 1e-3
        assert yaw[-1] == pytest.approx(path.end.yaw, abs=0.02)


@pytest.mark.parametrize("speed", [0.4, 1.5])
def test_poses_at_a_rounded_corner_are_those_of_the_speeds(speed):
    model = PowerModel.preset("quadriga:empty:concrete")
    vehicle = replace(model.vehicle, motor=MotorLimits(speed=speed, acceleration=1.0))
    path = Path(Pose(0, 0, 0), [2.0, 1.6, 2.0], [0.0, 0.6, 0.0])
    made = profile(path, model, vehicle=vehicle, smooth=1.0, tolerance=0.1, period=0.02)
    chords = np.hypot(np.diff(made.x), np.diff(made.y))
    driven = np.append(0.0, np.cumsum(chords))
    assert driven == pytest.approx(cumulative_trapezoid(made.v, made.t, initial=0.0), abs=0.05)
    before, after = driven < 1.05, driven > 4.55  # of the rounded part
    for straight in (before, after):
        assert np.abs(made.omega[straight]).max() < 1e-9
        assert np.diff(made.t[straight]).max() <= 0.02 + 1e-9
    turned = cumulative_trapezoid(made.omega, made.t, initial=0.0)
    assert turned[after] == pytest.approx(0.6, abs=0.001)


def test_a_corner_is_rounded_only_where_it_may_be_and_where_the_footprint_is_free():
    model = PowerModel.preset("quadriga:empty:concrete")
    c = model.vehicle.icr.left
    path = Path(Pose(1.5, 4, 0), [3.0, 1.2 * c, 2.0, 0.8 * c, 1.0], [0.0, 1.2, 0.0, -0.8, 0.0])

    def stops(made):
        still = np.hypot(made.v, made.omega) < 1e-9
        return np.count_nonzero(still[1:-1])

    assert stops(profile(path, model)) == 4
    for heights in (None, HeightMap(np.zeros((20, 20)), 1.0)):
        made = profile(path, model, smooth=[1, 1, 0, 1], tolerance=0.05, heights=heights)
        assert stops(made) == 1
        assert check(made, model, heights=heights).feasible
    cost = EnergyCost(model, speed=1.2)
    free = drive_path(path, cost, tolerance=0.05, grid=room(120, 120, 0.1))
    assert stops(free.trajectory) == 0
    # A post 3 cm beside the robot where it begins to turn: that corner stays a stop.
    near = drive_path(path, cost, tolerance=0.1, grid=room(120, 120, 0.1, (44, 40)))
    assert 0 < stops(near.trajectory) < 4
    assert near.duration > free.duration


@pytest.mark.parametrize("drawn", by_day([(0, 6), (0, 12), (1, 12)], [(0, 6)]))
def test_no_drive_from_stop_to_stop_takes_less_than_the_infimum_over_all_speeds(drawn):
    seed, cases = drawn
    rng = np.random.default_rng([22, seed])
    close = np.inf
    for k in range(cases):
        case = random_case(rng)
        model = replace(case.model, vehicle=case.vehicle)
        cost = EnergyCost(model, battery=bool(k % 3))
        law = priced_models(cost).model
        least = least_energy(case.path, cost)
        objective = ("time", "energy")[k % 2]
        made = profile(case.path, law, vehicle=case.vehicle, objective=objective)
        taken = check(made, law, case.vehicle).energy
        assert taken >= least * (1 - 1e-6), (k, objective)
        close = min(close, taken / least)
    assert close < 1.03


def test_the_infimum_over_all_speeds_is_known_in_closed_form():
    base = PowerModel.preset("quadriga:empty:concrete")
    model = base.with_term(term("viscous_loss"), 40.0).with_term(term("hotel_load"), 20.0)
    straight = Path(Pose(0, 0, 0), [3.0], [0.0])
    # 226 + 2 * 40 v + 20 / v joules a metre: least at 0.5 m/s.
    assert least_energy(straight, EnergyCost(model, speed=1.0)) == pytest.approx(3 * 306, rel=1e-9)
    creeping = base.with_term(term("viscous_loss"), 40.0)
    assert least_energy(straight, EnergyCost(creeping)) == pytest.approx(3 * 226, rel=1e-6)
    # Continuous power for 0.2 m/s: a short drive can be faster, and computers run for less long.
    slow = replace(base.vehicle, motor=MotorLimits(speed=1.0, continuous_power=113 * 0.2))
    hungry = replace(base, vehicle=slow).with_term(term("hotel_load"), 20.0)
    assert EnergyCost(hungry).energy(straight) == pytest.approx(3 * (226 + 100), rel=1e-9)
    assert least_energy(straight, EnergyCost(hungry)) == pytest.approx(3 * (226 + 20), rel=1e-9)
