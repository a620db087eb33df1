import pickle
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import cumulative_trapezoid

from energyplan import Motion, MotorLimits, PowerModel, Trajectory, check
from energyplan.html import share
from energyplan.limits import drive as limit_drive
from energyplan.limits import motor_kernels
from energyplan.limits.feasibility import feasible_region
from energyplan.power import Sides, Term
from energyplan.power.effects import term

PAPER = PowerModel.preset("quadriga:empty:concrete")
INERTIA = PAPER.with_term(term("linear_inertia"), 83.0).with_term(term("angular_inertia"), 7.5)
FREE = MotorLimits(acceleration=np.inf)


def drive(t, v, omega):
    """Trajectory of given speeds; its poses do not matter for the limits."""
    t, v, omega = np.broadcast_arrays(np.asarray(t, float), v, omega)
    yaw = np.concatenate([[0], np.cumsum(np.diff(t) * 0.5 * (omega[1:] + omega[:-1]))])
    return Trajectory(t, 0 * t, 0 * t, yaw, v, omega)


def limited(**limits):
    return replace(PAPER.vehicle, motor=replace(FREE, **limits))


def wavy(n, seed=0, period=0.05):
    rng = np.random.default_rng(seed)
    t = np.cumsum(rng.uniform(0.5, 1.5, n) * period)
    v = 0.5 + 0.4 * np.sin(0.7 * t + 1)
    return drive(t, v, 0.8 * np.sin(0.31 * t))


def kinds(report):
    return {(violation.kind, violation.side) for violation in report.violations}


# -- kernels against integrals ------------------------------------------------------------------


def test_the_motion_of_pieces_is_that_of_fine_integration():
    """Speeds run straight between samples; poses follow them, and what is left over is spread."""
    rng = np.random.default_rng(4)
    n, left, right = 40, 0.4, 0.55
    t = np.cumsum(rng.uniform(0.02, 0.06, n))
    v, omega = rng.normal(0, 0.5, (2, n))
    fine = np.concatenate([np.linspace(a, b, 2001) for a, b in pairwise(t)])
    speed, rate = np.interp(fine, t, v), np.interp(fine, t, omega)
    heading = 0.3 + cumulative_trapezoid(rate, fine, initial=0.0)
    x = cumulative_trapezoid(speed * np.cos(heading), fine, initial=0.0)
    y = cumulative_trapezoid(speed * np.sin(heading), fine, initial=0.0)
    drift = 0.01 * t  # of a localiser: the same for all parts of an interval
    known = [np.interp(t, fine, x) + drift, np.interp(t, fine, y) + drift]
    known.append(np.interp(t, fine, heading))
    cut = motor_kernels.cut_intervals(v, omega, left, right, 0, n - 1)
    interval, begin, end = cut
    # every change of sign is a cut, and there are no others
    for k in range(n - 1):
        ends = [
            (v[j], omega[j], v[j] - left * omega[j], v[j] + right * omega[j]) for j in (k, k + 1)
        ]
        zeros = sorted(a / (a - b) for a, b in zip(*ends, strict=True) if a * b < 0)
        np.testing.assert_allclose(begin[interval == k][1:], zeros, rtol=1e-9)
    nodes = motor_kernels.piece_nodes(t, *known, v, omega, left, right, *cut, 1.0)
    part = np.column_stack([begin, (begin + end) / 2, end])
    when = t[interval, None] + part * np.diff(t)[interval, None]
    at = [np.interp(when, fine, values) for values in (speed, rate, x, y, heading)]
    np.testing.assert_allclose(nodes.v_left, at[0] - left * at[1], atol=1e-9)
    np.testing.assert_allclose(nodes.v_right, at[0] + right * at[1], atol=1e-9)
    np.testing.assert_allclose(nodes.yaw_accel[:, 1], (np.diff(omega) / np.diff(t))[interval])
    np.testing.assert_allclose(nodes.yaw, at[4], atol=1e-9)
    # within an interval the way is taken along its chord: at most the sagitta of its arc is missed
    step, most = np.diff(t), np.maximum(np.abs([v[1:], omega[1:]]), np.abs([v[:-1], omega[:-1]]))
    sagitta = (most[0] * step * most[1] * step / 8)[interval, None]
    for found, expected in ((nodes.x, at[2]), (nodes.y, at[3])):
        assert np.all(np.abs(found - expected - 0.01 * when) <= sagitta + 1e-9)


def test_intervals_are_those_of_the_interpolated_value():
    run = motor_kernels.intervals
    rng = np.random.default_rng(3)
    for _ in range(20):
        t = np.cumsum(rng.uniform(0.1, 1, 40))
        value = rng.normal(size=40)
        start, stop, peak = run(t, value, 0.5, 0.0)
        fine = np.linspace(t[0], t[-1], 200_001)
        inside = np.interp(fine, t, value) > 0.5
        length = np.sum(stop - start)
        assert length == pytest.approx(np.mean(inside) * (t[-1] - t[0]), abs=1e-3)
        flips = np.count_nonzero(np.diff(np.concatenate([[False], inside, [False]])))
        assert 2 * len(start) == flips
        for a, b, top in zip(start, stop, peak, strict=True):
            assert top == value[(t >= a) & (t <= b)].max()
        assert np.all(start[1:] > stop[:-1])


def brute_window_mean(t, power, window):
    fine = np.linspace(t[0] - window, t[-1], 400_001)
    energy = np.cumsum(np.interp(fine, t, power, left=0.0)) * (fine[1] - fine[0])
    return (np.interp(t, fine, energy) - np.interp(t - window, fine, energy)) / window


@pytest.mark.parametrize("window", [0.03, 2.0, 7.3, 1e3])
def test_window_mean_agrees_with_brute_force(window):
    rng = np.random.default_rng(5)
    t = np.cumsum(rng.uniform(0.05, 0.6, 80))
    power = np.maximum(rng.normal(100, 100, 80), 0)
    # The window before the first sample is empty, where the brute force has a ramp of one step.
    found = motor_kernels.window_mean(t, power, window)
    assert np.allclose(found, brute_window_mean(t, power, window), rtol=5e-3, atol=0.5)


def test_shortest_window_is_where_the_window_mean_meets_the_budget():
    rng = np.random.default_rng(6)
    for _ in range(20):
        t = np.cumsum(rng.uniform(0.05, 0.6, 60))
        power = np.maximum(rng.normal(100, 100, 60), 0)
        budget = float(rng.uniform(50, 1500))
        window = motor_kernels.shortest_window(t, power, budget)
        top = motor_kernels.window_mean(t, power, window).max() * window
        assert top == pytest.approx(budget, rel=1e-9)
    assert motor_kernels.shortest_window(t, power, 1e9) == np.inf


def test_blocks_do_not_show(monkeypatch):
    path = wavy(120)
    vehicle = limited(
        peak_power=90, continuous_power=60, thermal_time=3, speed=0.9, acceleration=0.3,
        force=250, regeneration=1,
    )  # fmt: skip
    whole = check(path, INERTIA, vehicle)
    assert len({kind for kind, _ in kinds(whole)}) >= 5
    scale = whole.max_speed_scale
    for size in (7, 119, 120):
        monkeypatch.setattr(limit_drive, "BLOCK", size)
        parts = check(path, INERTIA, vehicle)
        assert parts.energy == pytest.approx(whole.energy, rel=1e-12)
        assert parts.worst == pytest.approx(whole.worst)
        assert len(parts.violations) == len(whole.violations)
        for a, b in zip(parts.violations, whole.violations, strict=True):
            assert (a.kind, a.side) == (b.kind, b.side)
            assert (a.start, a.end, a.peak) == pytest.approx((b.start, b.end, b.peak))
        assert parts.max_speed_scale == pytest.approx(scale, rel=1e-8)


# -- kinds, sides, intervals --------------------------------------------------------------------


def test_a_crossing_between_samples_is_interpolated():
    t = np.array([0.0, 1.0, 2.0, 3.0, 4.0])
    report = check(drive(t, [0.0, 0.5, 1.0, 0.4, 0.0], 0.0), PAPER, limited(speed=0.8))
    left, right = report.violations
    assert (left.kind, left.side, right.side) == ("speed", "left", "right")
    assert (left.start, left.end) == pytest.approx((1.6, 2 + 1 / 3))
    assert (left.peak, left.limit, left.margin) == pytest.approx((1.0, 0.8, -0.2))
    assert report.worst.t == 2.0
    assert report.worst.margin == pytest.approx(-0.25)


def test_the_outer_motor_is_overloaded_where_the_total_is_not():
    path = drive(np.linspace(0, 5, 101), 0.5, 0.6)
    motion = Motion.from_trajectory(path, PAPER.vehicle.icr)
    sides, total = PAPER.sides(motion), PAPER.power(motion)
    peak = 0.5 * (sides.right[0] + total[0] / 2)
    assert total[0] < 2 * peak < 2 * sides.right[0]
    report = check(path, PAPER, limited(peak_power=peak))
    assert kinds(report) == {("peak_power", "right")}
    mirrored = check(drive(path.t, 0.5, -0.6), PAPER, limited(peak_power=peak))
    assert kinds(mirrored) == {("peak_power", "left")}
    (violation,) = report.violations
    assert (violation.start, violation.end) == (0.0, 5.0)
    assert violation.peak == pytest.approx(sides.right[0])
    assert report.max_speed_scale == pytest.approx(peak / sides.right[0], rel=1e-12)
    assert report.reason.startswith("too fast: at 0 s the right side's peak power is 226 W")
    assert report.reason.endswith(f"feasible at {share(report.max_speed_scale)} of the speed")
    slower = check(path.scaled(0.5 * report.max_speed_scale), PAPER, limited(peak_power=peak))
    assert slower.reason == "every limit holds up to 200 % of the speed"


def test_the_inner_motor_returns_too_much_in_a_forward_arc_on_marble():
    model = PowerModel.preset("quadriga:full:marble")
    path = drive(np.linspace(0, 5, 101), 0.6, 0.4)
    returned = -model.sides(Motion.from_trajectory(path, model.vehicle.icr)).left.min()
    assert returned > 0
    report = check(path, model, limited(regeneration=0.8 * returned))
    assert kinds(report) == {("regeneration", "left")}
    assert report.max_speed_scale == pytest.approx(0.8, rel=1e-12)
    resistorless = check(path, model, limited(regeneration=0.0))
    assert resistorless.max_speed_scale == 0.0


def test_acceleration_is_that_between_samples():
    t = np.array([0.0, 0.1, 0.2, 0.3, 0.4])
    report = check(drive(t, [0, 0, 0.05, 0.05, 0.05], 0.0), PAPER, limited(acceleration=0.4))
    assert kinds(report) == {("acceleration", "left"), ("acceleration", "right")}
    assert (report.violations[0].start, report.violations[0].end) == pytest.approx((0.1, 0.2))
    assert report.violations[0].peak == pytest.approx(0.5)
    assert report.max_speed_scale == pytest.approx(np.sqrt(0.8), rel=1e-9)


@pytest.mark.parametrize("begin", [0.0, 129.3, 3600.1, 86400.7])
def test_rounded_times_are_no_acceleration_beyond_the_limit(begin):
    """Steps of a hundredth of a millisecond late in a drive keep it; larger speeds do not."""
    t = begin + np.concatenate([[0.0], 1.0 + 1e-5 * np.arange(40), [3.0]])
    speed = np.where(np.arange(42) % 2 == 0, 3e-5, 0.0)
    speed[[0, -2, -1]] = 0.0
    for factor, feasible in ((1.0, True), (1.001, False)):
        report = check(drive(t, factor * speed, 0.0), PAPER, limited(acceleration=3.0))
        assert report.feasible is feasible


def test_constant_power_heats_the_motor_until_the_window_is_full():
    path = drive(np.linspace(0, 40, 4001), 1.0, 0.0)
    power = float(PAPER.coefficient("traction_resistance"))
    vehicle = limited(continuous_power=0.5 * power, thermal_time=20.0)
    report = check(path, PAPER, vehicle)
    assert kinds(report) == {("continuous_power", "left"), ("continuous_power", "right")}
    violation = report.violations[0]
    # Rested before: the mean over the last 20 s reaches half the power after 10 s.
    assert (violation.start, violation.end) == pytest.approx((10.0, 40.0), abs=1e-9)
    assert violation.peak == pytest.approx(power)
    assert report.max_speed_scale == pytest.approx(0.5, rel=1e-9)
    short = check(drive(np.linspace(0, 9.9, 100), 1.0, 0.0), PAPER, vehicle)
    assert short.feasible
    assert short.max_speed_scale == np.inf
    idle = check(path, PAPER, limited(continuous_power=0.0, thermal_time=20.0))
    assert idle.max_speed_scale == 0.0


def test_returned_power_does_not_cool_the_motor():
    model = PowerModel.preset("quadriga:full:marble")
    t = np.linspace(0, 30, 3001)
    path = drive(t, 0.6, np.where(t % 2 < 1, 0.4, -0.4))
    left = model.sides(Motion.from_trajectory(path, model.vehicle.icr)).left
    drawn = np.trapezoid(np.maximum(left, 0), t)
    assert drawn > 1.05 * np.trapezoid(left, t)
    limit = drawn / 60.0
    assert not check(path, model, limited(continuous_power=0.99 * limit, thermal_time=60)).feasible
    assert check(path, model, limited(continuous_power=1.01 * limit, thermal_time=60)).feasible


def test_body_and_battery_limits():
    path = drive(np.linspace(0, 5, 101), 0.5, 0.6)
    free = replace(PAPER.vehicle, motor=FREE)
    model = replace(PAPER, vehicle=free).with_term(term("hotel_load"), 40.0)
    total = float(model.power(Motion.from_trajectory(path, free.icr))[0])
    assert kinds(check(path, model, replace(free, max_yaw_rate=0.5))) == {("yaw_rate", "both")}
    report = check(path, model, lateral_acceleration=0.25)
    assert kinds(report) == {("lateral_acceleration", "both")}
    assert report.max_speed_scale == pytest.approx(np.sqrt(0.25 / 0.3), rel=1e-9)
    report = check(path, model, battery_power=0.9 * total)
    assert kinds(report) == {("battery_power", "both")}
    # Hotel load does not shrink with speed.
    scale = (0.9 * total - 40.0) / (total - 40.0)
    assert report.max_speed_scale == pytest.approx(scale, rel=1e-8)
    hopeless = check(path, model, battery_power=39.0)
    assert hopeless.max_speed_scale == 0.0
    assert "the battery power is 40" in hopeless.reason
    lossy = replace(model, vehicle=replace(free, drive_efficiency=0.5))
    assert not check(path, lossy, battery_power=1.1 * total).feasible


def test_the_battery_takes_back_what_a_descent_returns():
    model = PAPER.with_term(term("grade"), 83.0)
    path = drive(np.linspace(0, 5, 11), 1.0, 0.0)
    slope = {"slope": -0.4}
    returned = 83.0 * 9.81 * np.sin(0.4) - 2 * 113.0
    report = check(path, model, limited(), battery_return=0.5 * returned, channels=slope)
    assert kinds(report) == {("battery_return", "both")}
    assert report.violations[0].peak == pytest.approx(returned)
    assert report.max_speed_scale == pytest.approx(0.5)
    each = np.linspace(-0.4, 0.4, 11)
    assert check(path, model, channels={"slope": each}).energy == pytest.approx(
        check(path, model, channels={"slope": each[::-1]}).energy
    )


# -- speed scale --------------------------------------------------------------------------------


def test_friction_above_the_force_limit_never_gets_better():
    model = PowerModel.preset("quadriga:full:concrete")
    report = check(drive(np.linspace(0, 5, 51), 0.0, 0.5), model, limited(force=400.0))
    assert kinds(report) == {("force", "left"), ("force", "right")}
    assert report.max_speed_scale == 0.0
    assert "no speed is feasible" in report.reason
    assert "force is 439.6 N against a limit of 400 N" in report.reason
    # The same with inertia, whose forces do vanish with speed.
    t = np.linspace(0, 5, 51)
    heavy = model.with_term(term("angular_inertia"), 20.0)
    report = check(drive(t, 0.0, 0.5 + 0.1 * np.sin(t)), heavy, limited(force=400.0))
    assert report.max_speed_scale == 0.0


@pytest.mark.parametrize("seed", range(4))
def test_the_largest_scale_of_a_dynamic_model_agrees_with_a_scan(seed):
    rng = np.random.default_rng(seed)
    path = wavy(200, seed)
    vehicle = limited(
        peak_power=float(rng.uniform(80, 200)), force=float(rng.uniform(350, 450)),
        regeneration=float(rng.uniform(30, 200)), continuous_power=float(rng.uniform(60, 80)),
        thermal_time=float(rng.uniform(1, 5)), speed=3.0,
    )  # fmt: skip
    report = check(path, INERTIA, vehicle)
    scale = report.max_speed_scale
    assert 0 < scale < np.inf
    assert check(path.scaled(scale * (1 - 1e-6)), INERTIA, vehicle).feasible
    for more in (1 + 1e-6, 1.01, 1.1, 1.5, 2, 5):
        assert not check(path.scaled(scale * more), INERTIA, vehicle).feasible


def test_friction_that_falls_with_speed_leaves_a_band_of_feasible_speeds():
    def stick(motion, vehicle):
        sides = (motion.v_left, motion.v_right)
        return Sides(*(np.sign(v) * np.exp(-np.abs(v) / 0.2) for v in sides))

    model = PAPER.with_term(Term("stick", "S", "N", "force", stick), 100.0)
    path = drive(np.linspace(0, 5, 21), 0.1, 0.0)
    # 113 N + 100 N exp(-v / 0.2 m/s) <= 150 N from 0.199 m/s; top speed 0.5 m/s.
    report = check(path, model, limited(force=150.0, speed=0.5))
    assert not report.feasible
    assert report.max_speed_scale == pytest.approx(5.0, rel=1e-9)
    assert check(path, model, limited(force=150.0, speed=0.15)).max_speed_scale == 0.0


def test_a_feasible_trajectory_has_a_scale_of_one_or_more():
    def bump(motion, vehicle):
        # A force that is small only in a narrow band of speeds around 0.5 m/s.
        sides = (motion.v_left, motion.v_right)
        return Sides(*(1 - np.exp(-(((np.abs(v) - 0.5) / 0.005) ** 2)) for v in sides))

    model = PAPER.with_term(Term("bump", "S", "N", "force", bump), 100.0)
    path = drive(np.linspace(0, 5, 21), 0.5, 0.0)
    report = check(path, model, limited(force=150.0, speed=1.3))
    assert report.feasible
    assert 1.0 < report.max_speed_scale < 1.02
    assert check(path, model, limited(force=150.0), lateral_acceleration=0.0).feasible
    turning = check(drive(path.t, 0.5, 0.1), INERTIA, lateral_acceleration=0.0)
    assert turning.max_speed_scale == 0.0


def test_nothing_limits_the_speed():
    report = check(wavy(50), INERTIA, limited())
    assert pickle.loads(pickle.dumps(report)) == report
    assert (report.feasible, report.worst, report.max_speed_scale) == (True, None, np.inf)
    assert 1 < check(wavy(50), INERTIA, limited(peak_power=1e4)).max_speed_scale < np.inf


# -- region -------------------------------------------------------------------------------------


@pytest.mark.parametrize("load", ["empty", "full"])
@pytest.mark.parametrize("ground", ["marble", "concrete"])
def test_the_region_ends_where_the_outer_motor_meets_its_power_or_speed(load, ground):
    model = PowerModel.preset(f"quadriga:{load}:{ground}")
    vehicle, motor = model.vehicle, model.vehicle.motor
    kappa = np.linspace(0.02, 4, 60)
    mu, K = model.coefficient("slip_friction"), model.coefficient("traction_resistance")
    push = mu * vehicle.slip_moment / vehicle.icr.slip_track
    outer, inner = 1 + 0.47 * kappa, 1 - 0.47 * kappa
    # Where the inner side turns backwards it draws, too, but less than the outer one.
    returned = np.where(inner > 0, (push - K) * inner, 0.0)
    expected = np.minimum(motor.speed / outer, motor.continuous_power / ((push + K) * outer))
    with np.errstate(divide="ignore"):
        braking = np.where(returned > 0, motor.regeneration / returned, np.inf)
    expected = np.minimum(expected, braking)
    region = feasible_region(model, kappa, np.linspace(0, 1.2, 49))
    assert np.allclose(region.max_speed, expected, rtol=1e-9)
    assert np.all(region.max_speed_brief >= region.max_speed)
    assert np.array_equal(region.sustained, region.speed[None, :] <= expected[:, None] * (1 + 1e-9))
    assert set(region.side[:, -1]) == {"right"}
    mirrored = feasible_region(model, -kappa, region.speed)
    assert np.allclose(mirrored.max_speed, region.max_speed)
    assert set(mirrored.side[:, -1]) == {"left"}


def test_the_region_agrees_with_checking_steady_trajectories():
    t = np.linspace(0, 100, 401)
    kappa, speed = np.array([-2.0, 0.0, 0.7, 1.5, 5.0]), np.array([0.1, 0.4, 0.7, 1.0])
    region = feasible_region(PAPER, kappa, speed)
    for i, k in enumerate(kappa):
        for j, v in enumerate(speed):
            long = check(drive(t, v, k * v), PAPER)
            assert region.sustained[i, j] == long.feasible
            assert region.use[i, j] == pytest.approx(1 - long.worst.margin, rel=1e-6)
            short = check(drive(t[:3], v, k * v), PAPER)
            assert region.brief[i, j] == short.feasible


def test_no_speed_where_friction_exceeds_the_force():
    region = feasible_region(PAPER, [0.0, 1.0], [0.0, 0.5, 1.0], limited(force=200.0, speed=0.8))
    assert region.max_speed.tolist() == [0.8, 0.0]
    assert region.sustained.tolist() == [[True, True, False], [True, False, False]]
    assert region.limiting[1, 1] == "force"
