"""Steering against independent optima, closed forms, symmetries, and the power model."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from by_day import by_day
from hypothesis import given, settings
from hypothesis import strategies as st
from refusals import check_refusal, lines
from steering_optimum import Corners, optimum

from energyplan import EnergyCost, Motion, MotorLimits, Path, Pose, PowerModel, TreadICR, steering
from energyplan.cost.steering import polygon_steering
from energyplan.power import HOTEL, Sides, Term, tread_forces
from energyplan.power.effects import VISCOUS_LOSS
from energyplan.steering.kernels import steer_energy
from energyplan.steering.polygon import polygon_energies

FULL = PowerModel.preset("quadriga:full:marble")
LIMITED = replace(FULL, vehicle=replace(FULL.vehicle, motor=MotorLimits(speed=1.2)))
ASYMMETRIC = replace(
    LIMITED,
    vehicle=replace(
        LIMITED.vehicle.with_icr(TreadICR(0.52, 0.4, 0.06)),
        drive_efficiency=0.85,
        regen_efficiency=0.3,
    ),
)
COSTS = {
    "static": EnergyCost(FULL),
    "asymmetric, lossy": EnergyCost(ASYMMETRIC, battery=True),
    "hotel load": EnergyCost(LIMITED.with_term(HOTEL, 80.0)),
    "asymmetric, lossy, hotel load": EnergyCost(ASYMMETRIC.with_term(HOTEL, 80.0), battery=True),
    "yaw rate limit": EnergyCost(
        replace(LIMITED, vehicle=replace(LIMITED.vehicle, max_yaw_rate=0.8)).with_term(HOTEL, 80.0)
    ),
    "smooth": EnergyCost(LIMITED.with_term(HOTEL, 80.0).with_term(VISCOUS_LOSS, 40.0)),
}
UNIT = EnergyCost.from_coefficients(per_metre=1.0, per_radian=1.5, icr=1.0)


def unit_cost(c: float) -> EnergyCost:
    """Cost with C = 1, a = 1, beta = c."""
    return EnergyCost.from_coefficients(per_metre=1.0, per_radian=c, icr=1.0)


def random_pairs(n: int, seed: int, reach: tuple[float, float]) -> tuple[np.ndarray, np.ndarray]:
    """Pairs of poses at log-uniform distances."""
    rng = np.random.default_rng(seed)
    distance = np.exp(rng.uniform(*np.log(reach), n))
    bearing = rng.uniform(-np.pi, np.pi, n)
    starts = np.column_stack([rng.normal(size=(n, 2)), rng.uniform(-4, 4, n)])
    offsets = distance * np.stack([np.cos(bearing), np.sin(bearing)])
    return starts, np.column_stack([starts[:, :2] + offsets.T, rng.uniform(-4, 4, n)])


def random_motion(rng: np.random.Generator, reach: tuple[float, float]) -> tuple[np.ndarray, float]:
    """A displacement at a log-uniform distance, and a turn."""
    distance = math.exp(rng.uniform(*np.log(reach)))
    bearing, turn = rng.uniform(-np.pi, np.pi, 2)
    return distance * np.array([math.cos(bearing), math.sin(bearing)]), turn


# -- against independent optima ----------------------------------------------------------------


@pytest.mark.parametrize("pairs", by_day([2, 16], [2]))
def test_closed_form_agrees_with_a_linear_program(pairs: int) -> None:
    rng = np.random.default_rng(11)
    for _ in range(pairs):
        c = math.exp(rng.uniform(math.log(0.2), math.log(4.0)))
        d, turn = random_motion(rng, (0.05, 100.0))
        corners = ((-1.0, 1.0 + c), (1.0, 1.0 + c))
        program = optimum(d, turn, Corners(corners, corners, 1.0, 1.0))
        found = one((0, 0, 0), (*d, turn), unit_cost(c))
        # Every solution of the program can be driven: the exact optimum is never above it.
        assert (1 - 1e-3) * program <= found <= (1 + 1e-9) * program


@pytest.mark.parametrize("pairs", by_day([1, 5], [1]))
def test_hotel_load_agrees_with_a_linear_program(pairs: int) -> None:
    cost = COSTS["hotel load"]
    C, a, kappa = cost.half_track, 2 * 110.0, 80.0 / 1.2
    b = a * C + 0.431 * FULL.vehicle.slip_moment
    corners = tuple((m, b + kappa * (C + abs(m))) for m in (-C, 0.0, C))
    rng = np.random.default_rng(12)
    for _ in range(pairs):
        d, turn = random_motion(rng, (0.05, 20.0))
        program = optimum(d, turn, Corners(corners, corners, a + kappa, a + kappa))
        found = one((0, 0, 0), (*d, turn), cost)
        assert (1 - 1e-3) * program <= found <= (1 + 1e-7) * program


def left_drag(motion: Motion, vehicle: object) -> Sides:
    """More resistance on the left tread."""
    return Sides(np.sign(motion.v_left), np.zeros(motion.shape))


def towing(motion: Motion, vehicle: object) -> Sides:
    """A force against driving forwards, and with driving backwards."""
    return tread_forces(motion, longitudinal=1.0)


def pull_aside(motion: Motion, vehicle: object) -> Sides:
    """A moment against turning left, and with turning right."""
    return tread_forces(motion, moment=1.0)


LOPSIDED = (
    LIMITED.with_term(Term("left_drag", "K_l", "N", "force", left_drag), 40.0)
    .with_term(Term("towing", "F", "N", "force", towing), 60.0)
    .with_term(Term("pull_aside", "M", "N m", "force", pull_aside), 50.0)
)


@pytest.mark.parametrize("pairs", by_day([1, 4], [1]))
@pytest.mark.parametrize("hotel", [0.0, 80.0])
def test_lopsided_costs_agree_with_a_linear_program(hotel: float, pairs: int) -> None:
    """Left and right, forwards and backwards all cost different."""
    cost = EnergyCost(LOPSIDED.with_term(HOTEL, hotel))
    C = cost.half_track
    left, right = (
        tuple((m, float(cost.segment_energy(m, way))) for m in (-C, 0.0, C)) for way in (1.0, -1.0)
    )
    ahead, behind = cost.segment_energy([1.0, -1.0], 0.0)
    rng = np.random.default_rng(14)
    for _ in range(pairs):
        d, turn = random_motion(rng, (0.05, 10.0))
        program = optimum(d, turn, Corners(left, right, float(ahead), float(behind)))
        found = one((0, 0, 0), (*d, turn), cost)
        assert (1 - 1e-3) * program <= found <= (1 + 1e-7) * program
        assert cost.energy(steering.path((0, 0, 0), (*d, turn), cost)) == pytest.approx(found)


@pytest.mark.parametrize("c", [0.2, 0.7, 1.5, 4.0])
def test_closed_form_agrees_with_the_dual_search(c: float) -> None:
    """Two algorithms with nothing in common: a list of words, and a search over dual vectors."""
    cost = unit_cost(c)
    starts, goals = random_pairs(2500, seed=int(10 * c), reach=(0.05, 100.0))
    words = steering.energy(starts, goals, cost)
    dual = np.empty(len(starts))
    corners = polygon_steering(cost.gauge, cost.gauge.corners(), cost.icr)
    polygon_energies(starts, goals, corners, dual)
    ratio = words / dual
    assert ratio.min() > 1 - 1e-3
    assert ratio.max() < 1 + 1e-7
    assert np.mean(np.abs(ratio - 1) > 1e-6) < 1e-3


# -- the path attains the energy ----------------------------------------------------------------


@pytest.mark.parametrize("name", COSTS)
def test_path_costs_what_energy_says_and_reaches_the_goal(name: str) -> None:
    cost = COSTS[name]
    starts, goals = random_pairs(150, seed=3, reach=(0.02, 50.0))
    energies = steering.energy(starts, goals, cost)
    model = cost.model.battery_side() if cost.battery else cost.model
    origin = Pose(0, 0, 0)
    spin_rate = 1 / cost.duration(Path(origin, [0.0], [1.0], cost.icr.longitudinal))
    for start, goal, expected in zip(starts, goals, energies, strict=True):
        route = steering.path(start, goal, cost)
        end = route.end
        assert math.hypot(end.x - goal[0], end.y - goal[1]) < 1e-9
        assert abs(math.sin(0.5 * (end.yaw - goal[2]))) < 1e-9
        # Integrate power over time, at the speeds that the cost gives for each curvature.
        spin = route.ds == 0
        rate = np.empty(len(route))
        rate[spin] = spin_rate / np.abs(route.dtheta[spin])
        curvature = route.dtheta[~spin] / route.ds[~spin]
        rate[~spin] = cost.cheapest_speed(curvature) / np.abs(route.ds[~spin])
        motion = Motion.from_twist(rate * route.ds, rate * route.dtheta, cost.icr)
        total = float(np.sum(model.power(motion) / rate))
        assert total == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("name", COSTS)
def test_never_below_the_lower_bound(name: str) -> None:
    cost = COSTS[name]
    starts, goals = random_pairs(500, seed=5, reach=(0.02, 50.0))
    bound = cost.lower_bound()
    turn = np.abs((goals[:, 2] - starts[:, 2] + np.pi) % (2 * np.pi) - np.pi)
    distance = np.hypot(*(goals - starts)[:, :2].T)
    slack = 1 + 2 * cost.gauge.error + 1e-9
    assert np.all(steering.energy(starts, goals, cost) * slack >= bound.energy(distance, turn))


# -- symmetries and inequalities ------------------------------------------------------------------

coordinate = st.floats(-8, 8, allow_nan=False)
angle = st.floats(-3.2, 3.2, allow_nan=False)
poses = st.builds(Pose, coordinate, coordinate, angle)
ratios = st.floats(0.0, 6.0)


def one(start: tuple[float, ...], goal: tuple[float, ...], cost: EnergyCost) -> float:
    return float(steering.energy(start, goal, cost))


@given(poses, poses, ratios, poses)
@settings(max_examples=150, deadline=None)
def test_left_invariance(start: Pose, goal: Pose, c: float, frame: Pose) -> None:
    cost = unit_cost(c)

    def moved(pose: Pose) -> Pose:
        cos, sin = math.cos(frame.yaw), math.sin(frame.yaw)
        x, y, yaw = pose
        return Pose(frame.x + cos * x - sin * y, frame.y + sin * x + cos * y, frame.yaw + yaw)

    # Energy is continuous but rises like the square root of a sideways step.
    expected = pytest.approx(one(start, goal, cost), rel=1e-6, abs=1e-5)
    assert one(moved(start), moved(goal), cost) == expected


@given(poses, ratios)
@settings(max_examples=150, deadline=None)
def test_mirror_and_time_reversal(goal: Pose, c: float) -> None:
    cost, origin, (x, y, yaw) = unit_cost(c), Pose(0, 0, 0), goal
    energy = pytest.approx(one(origin, goal, cost), rel=1e-6, abs=1e-5)
    assert one(origin, (x, -y, -yaw), cost) == energy
    assert one(goal, origin, cost) == energy
    assert one(origin, (-x, y, -yaw), cost) == energy


@given(poses, poses, poses, ratios)
@settings(max_examples=200, deadline=None)
def test_triangle_inequality(a: Pose, b: Pose, c: Pose, ratio: float) -> None:
    cost = unit_cost(ratio)
    assert one(a, c, cost) <= (one(a, b, cost) + one(b, c, cost)) * (1 + 1e-9) + 1e-9


@pytest.mark.parametrize("size", [1e-4, 1e-6, 1e-8, 1e-10, 1e-12])
@pytest.mark.parametrize("towards", [0.0, 0.4, math.pi / 2, 3.0])
@pytest.mark.parametrize("c", [0.0, 0.5, 3.0])
def test_the_least_displacement_is_not_free(size: float, towards: float, c: float) -> None:
    goal = (size * math.cos(towards), size * math.sin(towards), 0.0)
    assert one((0, 0, 0), goal, unit_cost(c)) >= size * (1 - 1e-9)


# -- limits -------------------------------------------------------------------------------------


def test_rounding_errors_in_the_poses_cost_no_more_than_rounding_errors() -> None:
    rng = np.random.default_rng(9)
    for cost in (unit_cost(0.0), unit_cost(2.0), COSTS["hotel load"]):
        scale = float(cost.per_metre(0.0))
        for x, turn in ((5.0, 0.0), (-2.0, 0.0), (0.0, 1.1), (3.0, math.pi)):
            exact = one((0, 0, 0), (x, 0, turn), cost)
            for size in (1e-17, 1e-14, 1e-11, 1e-8):
                goal = np.array([x, 0, turn]) + size * rng.normal(size=3)
                assert abs(one((0, 0, 0), goal, cost) - exact) < scale * (100 * size + 1e-12)


def test_free_turning_beside_the_wheels_travel() -> None:
    """beta = 0 is least wheel rotation: the robot swings about its wheels into a lane beside it.

    Both swings are a quarter turn and a little more, so that the straight line is tangent: length
    ``sqrt((d + 2)^2 - 4) - 4``, each swing ``pi/2 + asin(2/(d + 2))``.
    """
    cost = unit_cost(0.0)
    for d in (6.0, 10.0, 50.0):
        tangent = math.sqrt((d + 2) ** 2 - 4) - 4
        swings = math.pi + 2 * math.asin(2 / (d + 2))
        assert one((0, 0, 0), (0, d, 0), cost) == pytest.approx(swings + tangent, rel=1e-6)


# -- interface ----------------------------------------------------------------------------------


def test_poses_broadcast() -> None:
    starts = np.zeros((4, 1, 3))
    goals = np.random.default_rng(0).normal(size=(5, 3))
    energies = steering.energy(starts, goals, UNIT)
    assert energies.shape == (4, 5)
    assert energies[2, 3] == one((0, 0, 0), tuple(goals[3]), UNIT)
    kernel = steer_energy(goals[3, 0], goals[3, 1], 0.0, goals[3, 2], UNIT.steering_parameters)
    assert energies[2, 3] == kernel


def test_asymmetric_icr_is_a_shift_of_the_reference_point() -> None:
    icr = TreadICR(0.6, 0.4, 0.1)
    shifted = EnergyCost.from_coefficients(200.0, 150.0, icr)
    centred = EnergyCost.from_coefficients(200.0, 150.0, 0.5)

    def centre(pose: np.ndarray) -> tuple[float, float, float]:
        x, y, yaw = pose
        ahead, aside = 0.1 * math.cos(yaw), 0.1 * math.sin(yaw)
        return x + ahead - aside, y + aside + ahead, yaw

    for ends in zip(*random_pairs(50, seed=8, reach=(0.1, 9.0)), strict=True):
        assert one(*ends, shifted) == pytest.approx(one(*map(centre, ends), centred), rel=1e-9)


@pytest.mark.parametrize("turn", [-3.0, 0.02, 1.57, np.pi])
@pytest.mark.parametrize("icr", [(0.47, 0.47, 0.0), (0.5, 0.4, 0.1)])
def test_a_turn_on_the_spot_is_one_spin(icr, turn):
    tread = TreadICR(*icr)
    cost = EnergyCost.from_coefficients(per_metre=200.0, per_radian=100.0, icr=tread)
    start = Pose(1.0, 2.0, 0.7)
    # the body frame turns about the middle between the tread ICRs
    spin = Path(start, [tread.centre[1] * turn], [turn], tread.longitudinal)
    found = steering.path(start, spin.end, cost)
    assert len(found) == 1
    assert np.allclose(found.end[:2], spin.end[:2])
    assert np.cos(found.end.yaw - spin.end.yaw) == pytest.approx(1.0)
    assert cost.energy(found) == pytest.approx(steering.energy(start, spin.end, cost), rel=1e-9)


REFUSED = r"""
InvalidInputError: steering.energy((0, 0), (1, 1, 0), UNIT) | shape
InvalidInputError: steering.energy((0, 0, np.nan), (1, 1, 0), UNIT) | not finite
InvalidInputError: steering.energy(np.zeros((2, 3)), np.zeros((4, 3)), UNIT) | broadcast
InvalidInputError: steering.path(np.zeros((2, 3)), (1, 1, 0), UNIT) | one pose to one
InvalidInputError: steering.energy((0, 0, 0), (1, 0, 0), COSTS["smooth"], reverse=False) | static
"""


@pytest.mark.parametrize("case", lines(REFUSED))
def test_bad_input_is_refused(case: str) -> None:
    check_refusal(case, globals())
