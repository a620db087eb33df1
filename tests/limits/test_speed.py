from dataclasses import replace

import numpy as np
import pytest
from refusals import check_refusal, lines
from scipy.integrate import solve_ivp
from scipy.optimize import linprog
from scipy.sparse import diags_array, vstack
from shapely import box

from energyplan.errors import PathError
from energyplan.limits.feasibility import check, feasible_region
from energyplan.limits.speed import profile
from energyplan.motion import Motion
from energyplan.path import Path, Pose, Trajectory
from energyplan.power import PowerModel, Term
from energyplan.power.effects import term, with_weight
from energyplan.terrain import HeightMap, Surface, SurfaceMap
from energyplan.vehicle import GRAVITY, MotorLimits, TreadICR

PAPER = PowerModel.preset("quadriga:empty:concrete")
INERTIA = PAPER.with_term(term("linear_inertia"), 83.0).with_term(term("angular_inertia"), 7.5)
HOTEL = INERTIA.with_term(term("hotel_load"), 30.0).with_term(term("viscous_loss"), 60.0)
LOSSY = HOTEL.with_term(term("drive_efficiency"), 0.3).with_term(
    term("regeneration_efficiency"), 1.0
)
START = Pose(1.0, -2.0, 0.7)


def with_motor(**limits):
    return replace(PAPER.vehicle, motor=replace(PAPER.vehicle.motor, **limits))


def random_path(rng, segments=None):
    """Straights, arcs, spins on the spot and reversals; no two neighbours of one curvature."""
    n = segments or int(rng.integers(1, 7))
    ds = rng.uniform(-1.0, 3.0, n) * (rng.random(n) > 0.25)
    dtheta = rng.uniform(-2.0, 2.0, n) * (rng.random(n) > 0.3)
    for k in range(n):
        alike = k and (dtheta[k] == dtheta[k - 1] == 0 or ds[k] == ds[k - 1] == 0)
        if alike or ds[k] == dtheta[k] == 0:
            ds[k], dtheta[k] = rng.uniform(0.1, 1), rng.uniform(0.1, 1)
    return Path(START, ds, dtheta)


def tread_length(path, icr):
    left, right = path.ds - icr.left * path.dtheta, path.ds + icr.right * path.dtheta
    return np.maximum(np.abs(left), np.abs(right))


def shortest_time_lp(path, vehicle, lateral, nodes=150):
    """Minimum time by a linear program over squared tread rates on a grid of the path.

    Within a cell the acceleration is constant, so every solution can be driven: its time is an
    upper bound that falls to the minimum as the grid is refined.
    """
    length = tread_length(path, vehicle.icr)
    motor, total = vehicle.motor, 0.0
    for k, whole in enumerate(length):
        cap = motor.speed
        if path.dtheta[k]:
            cap = min(cap, vehicle.max_yaw_rate * whole / abs(path.dtheta[k]))
        if path.ds[k] and path.dtheta[k]:
            cap = min(cap, np.sqrt(lateral * whole**2 / abs(path.ds[k] * path.dtheta[k])))
        step = whole / nodes
        change = diags_array([-1.0, 1.0], offsets=[0, 1], shape=(nodes, nodes + 1))
        bounds = np.tile([0.0, cap**2], (nodes + 1, 1))
        bounds[[0, -1]] = 0.0
        solved = linprog(
            -np.ones(nodes + 1),
            A_ub=vstack([change, -change]),
            b_ub=np.full(2 * nodes, 2 * motor.acceleration * step),
            bounds=bounds,
        )
        rate = np.sqrt(np.maximum(solved.x, 0.0))
        total += float(np.sum(2 * step / (rate[1:] + rate[:-1])))
    return total


def least_cost_dp(model, ds, dtheta, price=0.0, cells=100, levels=400):
    """Least energy plus `price` times duration from standstill to standstill, by dynamic
    programming over squared tread rates on one arc."""
    vehicle = model.vehicle
    whole = float(tread_length(Path(START, [ds], [dtheta]), vehicle.icr)[0])
    step = whole / cells
    square = np.linspace(0.0, vehicle.motor.speed**2, levels + 1)
    rate = np.sqrt(square)
    gain = (square[None, :] - square[:, None]) / (2 * step)
    mean = 0.5 * (rate[None, :] + rate[:, None])
    allowed = (np.abs(gain) <= vehicle.motor.acceleration * (1 + 1e-9)) & (mean > 0)
    mean = np.where(mean > 0, mean, 1.0)
    forward, turn = ds / whole, dtheta / whole
    motion = Motion.from_twist(
        forward * mean, turn * mean, vehicle.icr, accel=forward * gain, yaw_accel=turn * gain
    )
    cost = np.where(allowed, (model.power(motion) + price) * step / mean, np.inf)
    value = np.full(levels + 1, np.inf)
    value[0] = 0.0
    for _ in range(cells):
        value = np.min(value[:, None] + cost, axis=0)
    return float(value[0])


# -- least time ---------------------------------------------------------------------------------


def test_straight_and_spin_take_the_time_of_trapezoid_and_triangle():
    motor = PAPER.vehicle.motor
    for ds, dtheta in ((2.4, 0.0), (-3.0, 0.0), (0.5, 0.0), (0.0, 4.0), (0.0, -0.3)):
        whole = abs(ds) + 0.47 * abs(dtheta)
        ramp = motor.speed**2 / motor.acceleration
        expected = (
            whole / motor.speed + motor.speed / motor.acceleration
            if whole >= ramp
            else 2 * np.sqrt(whole / motor.acceleration)
        )
        found = profile(Path(START, [ds], [dtheta]), PAPER).duration
        assert found == pytest.approx(expected, rel=5e-5)


def test_least_time_agrees_with_a_linear_program_on_random_paths():
    rng = np.random.default_rng(4)
    for _ in range(30):
        path = random_path(rng)
        lateral = float(rng.uniform(0.05, 0.6))
        motor = MotorLimits(
            acceleration=float(rng.uniform(0.3, 3)), speed=float(rng.uniform(0.4, 1.2))
        )
        vehicle = replace(PAPER.vehicle, motor=motor, max_yaw_rate=float(rng.uniform(0.5, 2.5)))
        found = profile(path, PAPER, vehicle=vehicle, lateral_acceleration=lateral).duration
        bound = shortest_time_lp(path, vehicle, lateral)
        assert found <= bound * (1 + 5e-4)  # both cut the path into cells
        assert found >= bound * (1 - 3e-4)


def test_power_limited_acceleration_agrees_with_integrating_the_equation_of_motion():
    # Each side pulls K and half the mass; beyond some speed the motor's power is the limit.
    vehicle = with_motor(peak_power=220.0, continuous_power=220.0, acceleration=2.0, force=190.0)
    mass, K = 83.0, 113.0
    motor = vehicle.motor
    assert K * motor.speed < motor.peak_power < motor.speed * motor.force

    def push(v):
        return min(motor.force, motor.peak_power / max(v, 1e-9)) - K

    def rhs(t, state):
        return [state[1], push(state[1]) / (mass / 2)]

    reached = solve_ivp(
        rhs, (0, 20), [0.0, 0.0], events=lambda t, s: s[1] - 1.19, rtol=1e-9, atol=1e-12,
        dense_output=True,
    )  # fmt: skip
    t, distance = float(reached.t_events[0][0]), float(reached.y_events[0][0][0])
    path = Path(START, [distance], [0.0])
    found = profile(path, INERTIA, vehicle=vehicle, end_speed=1.18, period=0.01)
    assert t <= found.duration * (1 + 1e-6)
    assert found.duration <= t * 1.0005
    assert check(found, INERTIA, vehicle).feasible


def test_asymmetric_treads_and_offset_reference_point():
    vehicle = PAPER.vehicle.with_icr(TreadICR(0.3, 0.6, 0.1))
    model = replace(PAPER, vehicle=vehicle)
    path = Path(START, [1.0, 0.0, 2.0], [0.8, -1.0, -0.5], longitudinal=0.1)
    found = profile(path, model)
    assert check(found, model).feasible
    # Between samples positions follow the speeds: the reference point only moves forwards.
    point = found.poses[:, :2] + 0.1 * np.column_stack([np.cos(found.yaw), np.sin(found.yaw)])
    mid = 0.5 * (found.yaw[1:] + found.yaw[:-1])
    moved = np.diff(point, axis=0)
    assert np.allclose(-moved[:, 0] * np.sin(mid) + moved[:, 1] * np.cos(mid), 0, atol=1e-12)
    along = moved[:, 0] * np.cos(mid) + moved[:, 1] * np.sin(mid)
    speed = 0.5 * (found.v[1:] + found.v[:-1])
    assert np.allclose(along, speed * np.diff(found.t), atol=1e-5)
    assert found.poses[-1] == pytest.approx(path.end, abs=1e-12)


# -- corners ------------------------------------------------------------------------------------


def test_it_stops_exactly_where_the_curvature_jumps():
    path = Path(START, [1.0, 1.0, -1.0, 0.0, 0.7], [0.0, 0.8, 0.0, 1.0, 0.0])
    found = profile(path, PAPER)
    for vertex in path.vertices:
        k = int(np.argmin(np.abs(found.poses - vertex).sum(axis=1)))
        assert np.allclose(found.poses[k], vertex, atol=1e-12)
        assert found.v[k] == found.omega[k] == 0.0


# -- least energy and given duration ------------------------------------------------------------


@pytest.mark.parametrize("model", [HOTEL, LOSSY])
@pytest.mark.parametrize(
    ("ds", "dtheta"), [(1.0, 0.0), (4.0, 0.0), (0.0, 1.5), (1.0, 1.0), (-0.4, 0.9), (3.0, 0.3)]
)
def test_least_energy_agrees_with_dynamic_programming(model, ds, dtheta):
    found = profile(Path(START, [ds], [dtheta]), model, objective="energy", period=0.01)
    energy = check(found, model).energy
    reference = least_cost_dp(model, ds, dtheta)
    # The grid of the reference costs it up to one per cent on short arcs; its midpoint rule
    # flatters it by less than one per mille.
    assert reference * 0.98 <= energy <= reference * 1.001


def test_the_cruising_speed_balances_hotel_load_and_viscous_loss():
    # Straight ahead the power is 2 K v + 2 B v^2 + P_h; per metre it is least at sqrt(P_h / 2 B).
    found = profile(Path(START, [30.0], [0.0]), HOTEL, objective="energy")
    cruise = np.median(found.v)
    assert cruise == pytest.approx(np.sqrt(30.0 / (2 * 60.0)), rel=0.02)
    fastest = profile(Path(START, [30.0], [0.0]), HOTEL).duration
    assert fastest < found.duration


def test_each_ground_is_driven_at_its_own_cheapest_speed():
    grass = INERTIA.with_term(term("hotel_load"), 30.0).with_term(term("viscous_loss"), 540.0)
    meadow = SurfaceMap([Surface(box(10, -9, 29, 9), grass)])
    path = Path(Pose(0, 0, 0), [30.0], [0.0])
    found = profile(path, HOTEL, objective="energy", surfaces=meadow)
    for x, viscous in ((5.0, 60.0), (20.0, 540.0)):
        speed = np.interp(x, found.x, found.v)
        assert speed == pytest.approx(np.sqrt(30.0 / (2 * viscous)), rel=0.03)


@pytest.mark.parametrize("model", [with_weight(HOTEL), with_weight(LOSSY)])
def test_over_hills_some_limit_is_used_at_every_instant(model):
    """A drive in the least time leaves nothing of all limits together."""
    y, x = np.mgrid[:9, :60] * 0.5
    hills = HeightMap(0.3 * np.sin(0.7 * x) + 0.0 * y, 0.5, (-2.0, -2.0, 0.0))
    vehicle = with_motor(peak_power=330.0, continuous_power=330.0, acceleration=0.8)
    found = profile(Path(Pose(0, 0, 0), [25.0], [0.0]), model, vehicle=vehicle, heights=hills)
    assert check(found, model, vehicle, heights=hills).feasible
    middle = 0.5 * (found.t[1:] + found.t[:-1])
    v, slope = np.interp(middle, found.t, found.v), hills.slope(found.poses)
    tilt = np.interp(middle, found.t, slope)
    gain = np.diff(found.v) / np.diff(found.t)
    motion = Motion.from_twist(
        v / np.cos(tilt), 0 * v, vehicle.icr, accel=gain / np.cos(tilt), yaw_accel=0.0, slope=tilt
    )
    power = model.forces(motion).left * motion.v_left
    use = np.max([power / 330.0, np.abs(gain) / 0.8, motion.v / 1.2], axis=0)
    assert np.average(use > 0.98, weights=np.diff(found.t)) > 0.97


def test_least_energy_is_least_among_given_durations():
    path = Path(START, [2.0, 0.0, 1.0], [0.0, 1.5, 0.6])
    best = profile(path, LOSSY, objective="energy", period=0.01)
    least = check(best, LOSSY).energy
    energies = []
    for part in (0.75, 0.9, 1.0, 1.2, 1.6):
        found = profile(path, LOSSY, duration=part * best.duration, period=0.01)
        assert found.duration == pytest.approx(part * best.duration, rel=1e-9)
        assert check(found, LOSSY).feasible
        energies.append(check(found, LOSSY).energy)
    assert min(energies) == energies[2] == pytest.approx(least, rel=1e-4)
    assert energies[0] > energies[1] > energies[2] < energies[3] < energies[4]


def test_energy_of_a_given_duration_meets_its_lagrangian_bound():
    # Weak duality: E(T) >= min(E + price T) - price T, for any price.
    found = profile(Path(START, [2.0], [0.4]), LOSSY, duration=3.6, period=0.01)
    energy = check(found, LOSSY).energy
    bounds = [least_cost_dp(LOSSY, 2.0, 0.4, price) - price * 3.6 for price in range(0, 120, 10)]
    assert max(bounds) * 0.999 <= energy <= max(bounds) * 1.005


def test_in_a_static_model_speed_cancels():
    path = Path(START, [2.0, 0.0, 1.0], [0.0, 1.5, 0.6])
    fast = profile(path, PAPER)
    cheap = profile(path, PAPER, objective="energy")
    slow = profile(path, PAPER, duration=60.0)
    assert cheap.duration == pytest.approx(fast.duration)
    assert slow.duration == pytest.approx(60.0, rel=1e-9)
    assert check(slow, PAPER).energy == pytest.approx(check(fast, PAPER).energy, rel=1e-9)


def test_start_and_end_speed():
    path = Path(START, [3.0], [0.0])
    found = profile(path, LOSSY, objective="energy", start_speed=0.9, end_speed=0.3)
    assert found.v[[0, -1]] == pytest.approx([0.9, 0.3])
    assert check(found, LOSSY).feasible


# -- thermal, channels, errors ------------------------------------------------------------------


def test_a_given_duration_keeps_the_motors_cool():
    path = Path(START, [0.0, 1.0], [12.0, 0.0])
    cool = with_motor(continuous_power=120.0, thermal_time=1.2)
    least = profile(path, PAPER, vehicle=cool).duration
    for part in (1.0, 1.3):
        found = profile(path, PAPER, vehicle=cool, duration=part * least)
        assert found.duration == pytest.approx(part * least, rel=1e-9)
        assert check(found, PAPER, cool).feasible


def test_a_slope_slows_the_climb_and_not_the_descent():
    model = INERTIA.with_term(term("grade"), 83.0)
    vehicle = with_motor(peak_power=150.0, continuous_power=150.0)
    path = Path(START, [3.0], [0.0])
    level, climb, descent = (
        profile(path, model, vehicle=vehicle, channels={"slope": slope}).duration
        for slope in (0.0, 0.15, -0.15)
    )
    assert descent <= level < climb
    halves = Path(START, [1.5, 1.5], [0.0, 0.0])
    mixed = profile(halves, model, vehicle=vehicle, channels={"slope": [0.0, 0.15]}).duration
    assert level < mixed < climb


def test_a_force_limit_beside_friction_makes_no_drive_crawl():
    """The drive that knows no such limit keeps it where it is driven evenly slower."""
    arc = Path(START, [3.0], [3.0])
    free, bound = (profile(arc, HOTEL, vehicle=with_motor(force=f)) for f in (np.inf, 310.0))
    slower = check(free, HOTEL, with_motor(force=310.0)).max_speed_scale
    assert bound.duration < free.duration / slower


@pytest.mark.parametrize("objective", ["time", "energy"])
def test_a_motion_of_next_to_no_length_is_stopped_at_not_crawled_through(objective):
    """What planning leaves of rounding between two straights has no room to be rounded in."""
    vehicle = replace(PAPER.vehicle, motor=replace(PAPER.vehicle.motor, acceleration=0.5))
    bend = {"ds": [3.0, 2.7e-7, 4.0], "dtheta": [0.0, 2e-7, 0.0]}
    path, straight = Path(Pose(0, 0, 0), **bend), Path(Pose(0, 0, 0), [3.0, 4.0], [0.0, 0.0])
    made, plain = (
        profile(way, PAPER, vehicle=vehicle, objective=objective, smooth=1.0, tolerance=0.04)
        for way in (path, straight)
    )
    stop = float(vehicle.motor.speed) / 0.5
    assert made.duration <= plain.duration + 1.1 * stop


def test_splitting_a_segment_changes_nothing():
    path = Path(START, [2.0, 1.5], [0.0, 1.0])
    whole, parts = profile(path, LOSSY), profile(path.subdivide(0.1, 0.1), LOSSY)
    assert parts.duration == pytest.approx(whole.duration, rel=1e-9)


def test_without_an_acceleration_limit_the_profile_is_length_over_speed():
    path = Path(START, [2.0, 1.5, 0.0], [0.0, 1.0, 1.0])
    vehicle = replace(PAPER.vehicle, motor=MotorLimits(speed=0.8, acceleration=np.inf))
    length = tread_length(path, vehicle.icr)
    found = profile(path, PAPER, vehicle=vehicle).duration
    assert found == pytest.approx(length.sum() / 0.8, rel=1e-5)


def test_a_steady_speed_is_held_back_by_no_inertia():
    curvature, speed = np.linspace(0.0, 2.0, 5), np.linspace(0.0, 1.5, 16)
    still, heavy = (feasible_region(model, curvature, speed) for model in (PAPER, INERTIA))
    assert 0 < still.sustained.sum() < still.sustained.size
    assert np.array_equal(still.sustained, heavy.sustained)
    np.testing.assert_allclose(still.use, heavy.use)
    np.testing.assert_allclose(still.max_speed, heavy.max_speed)


def test_energy_up_a_slope_is_that_of_the_longer_way_and_the_climb():
    """Resistance acts along the ground, which is longer than the plan, and gravity up it."""
    model = PAPER.with_term(term("grade"), 50.0)
    rise = 0.3
    ground = HeightMap(rise * np.arange(12.0) * np.ones((4, 1)), 1.0)
    trajectory = profile(Path(Pose(2.0, 2.0, 0.0), [6.0], [0.0]), model, heights=ground)
    found = check(trajectory, model, heights=ground).energy
    resistance = 2.0 * model.coefficient("traction_resistance") * 6.0 * np.hypot(1.0, rise)
    assert found == pytest.approx(resistance + 50.0 * GRAVITY * rise * 6.0, rel=1e-3)


LINE, SHORT, ARC = Path(START, [1.3], [0]), Path(START, [0.2], [0]), Path(START, [1], [1])
SPIN, LONG_SPIN = Path(START, [1, 0], [0, 1]), Path(START, [0, 1], [12, 0])
WEAK = with_motor(force=200.0)
LEAST = 2.0 * np.sqrt(1.3)  # [s], speeding up and braking
COOL = with_motor(continuous_power=120.0, thermal_time=1.2)
STUCK = replace(PAPER.vehicle, motor=MotorLimits())
STICKY = PAPER.with_term(Term("own", "a", "N", "force", None, channels=("stickiness",)), 1.0)
DRIVEN = Trajectory([0, 1], [0, 1], [0, 0], [0, 0], [1, 1], [0, 0])
GROUND = SurfaceMap([Surface(box(-9, -9, 9, 9), PAPER)])
FLAT = HeightMap(np.zeros((9, 9)), 2.0, (-8.0, -8.0, 0.0))
REFUSED = r"""
InfeasibleMotionError: profile(SHORT, PAPER, start_speed=1.1) | start_speed 1.1 .* too high
InfeasibleMotionError: profile(SHORT, PAPER, end_speed=1.1) | end_speed
InfeasibleMotionError: profile(LINE, PAPER, duration=0.999 * LEAST) | takes 2.*s at least
InfeasibleMotionError: profile(LONG_SPIN, PAPER, vehicle=COOL, duration=9) | continuous power of 120
InfeasibleMotionError: profile(ARC, PAPER, lateral_acceleration=0.0) | limit of 0
InfeasibleMotionError: profile(ARC, PAPER, lateral_acceleration=1e-30) | too long to sample
InfeasibleMotionError: profile(SPIN, PAPER, vehicle=WEAK) | on the spot .* force .* limit of 200
InvalidInputError: profile(LINE, PAPER, vehicle=STUCK) | nothing limits the speed
InvalidInputError: profile(LINE, PAPER, objective="length") | objective
InvalidInputError: profile(LINE, PAPER, period=0.0) | period
InvalidInputError: profile(LINE, PAPER, smooth=-1.0) | smooth
InvalidInputError: profile(SPIN, PAPER, smooth=[1.0, 0.0]) | corners
InvalidInputError: profile(LINE, PAPER, start_speed=-0.1) | start_speed is -0.1
InvalidInputError: profile(LINE, PAPER, channels={"slope": [0.0, 0.1]}) | 'slope' has shape
InvalidInputError: MotorLimits(speed=1.0, acceleration=0.0) | motor limit acceleration is 0
InvalidInputError: check(DRIVEN, PAPER, channels={"slope": [0.0, 0.1, 0.2]}) | 'slope' has shape
InvalidInputError: check(DRIVEN, PAPER, battery_power=-1.0) | battery_power is -1
MissingChannelError: check(DRIVEN, STICKY) | 'stickiness'
InvalidInputError: feasible_region(PAPER, [[0.0]], [1.0]) | curvature has shape
InvalidInputError: feasible_region(PAPER, [0.0], [-1.0]) | backwards
"""


@pytest.mark.parametrize("case", lines(REFUSED))
def test_bad_input_is_refused(case):
    check_refusal(case, globals())


def test_what_is_just_possible_is_not_refused():
    assert profile(LINE, PAPER, duration=1.001 * LEAST).duration > LEAST
    assert profile(LINE, PAPER, lateral_acceleration=0.0).duration == pytest.approx(LEAST)
    assert profile(LINE, PAPER, vehicle=WEAK).duration > 0


@pytest.mark.parametrize("segments", [[], [0.0], [0.0, 0.0]])
@pytest.mark.parametrize("ground", [{}, {"surfaces": GROUND}, {"heights": FLAT}])
def test_a_path_that_leads_nowhere_is_refused_on_any_ground(segments, ground):
    smooth = np.full(max(len(segments) - 1, 0), 0.1)
    with pytest.raises(PathError, match="no length"):
        profile(Path(START, segments, segments), with_weight(PAPER), smooth=smooth, **ground)
