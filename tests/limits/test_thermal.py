"""Least time within the continuous power, against a linear program over the times of cells."""

from dataclasses import replace

import numpy as np
import pytest
from by_day import by_day
from limits.test_chain import smooth_curve
from limits.test_speed import PAPER, START, random_path
from scipy.optimize import linprog
from scipy.sparse import coo_array, diags_array, vstack

from energyplan import Motion, Path, check, profile


def warm_vehicle(rng):
    """The paper's robot with motors that get warm within seconds."""
    motor = replace(
        PAPER.vehicle.motor,
        peak_power=600.0,
        continuous_power=float(rng.uniform(60, 140)),
        thermal_time=float(rng.uniform(4, 20)),
        acceleration=float(rng.uniform(0.5, 2)),
    )
    return replace(PAPER.vehicle, motor=motor)


def warm_path(rng, smooth):
    """A path that is long enough to get warm on."""
    if not smooth:
        return random_path(rng, int(rng.integers(4, 12)))
    curves = [smooth_curve(rng) for _ in range(int(rng.integers(1, 4)))]
    forward = [np.abs(curve.ds) for curve in curves]
    return Path(START, np.concatenate(forward), np.concatenate([c.dtheta for c in curves]))


def shortest_time(path, vehicle, smooth):
    """A lower bound under a static model, by a linear program over the times of cells.

    Every cell takes as long at least as in the fastest profile without the thermal limit, and every
    window's energy, which does not depend on the speed, a window's time. Accelerations are free.
    """
    motor = vehicle.motor
    free = replace(vehicle, motor=replace(motor, continuous_power=motor.peak_power))
    fast = profile(path, PAPER, vehicle=free, smooth=smooth, period=0.02)
    step, middle = np.diff(fast.t), lambda value: 0.5 * (value[1:] + value[:-1])
    motion = Motion.from_twist(middle(fast.v), middle(fast.omega), vehicle.icr)
    forces = PAPER.forces(motion)
    powers = np.stack([forces.left * motion.v_left, forces.right * motion.v_right])
    drawn = np.hstack([np.zeros((2, 1)), np.cumsum(np.maximum(powers, 0.0) * step, axis=1)])
    n, rows = len(step), []
    for energy in drawn:
        for sign in (1.0, -1.0):
            goal = energy + sign * motor.continuous_power * motor.thermal_time
            point = np.flatnonzero((goal >= 0) & (goal <= energy[-1]))
            side = "left" if sign > 0 else "right"
            cell = np.clip(np.searchsorted(energy, goal[point], side=side) - 1, 0, n - 1)
            rise = np.diff(energy)[cell]
            part = np.divide(goal[point] - energy[cell], rise, out=np.ones_like(rise),
                             where=rise > 0)  # fmt: skip
            m = np.arange(len(point))
            entries = np.concatenate([sign * (1 - part), sign * part, np.full(len(m), -sign)])
            place = np.tile(m, 3), np.concatenate([cell, cell + 1, point])
            rows.append(coo_array((entries, place), shape=(len(m), n + 1)))
    windows = vstack(rows)
    cells = diags_array([-np.ones(n), np.ones(n)], offsets=[0, 1], shape=(n, n + 1))
    solved = linprog(
        np.append(np.zeros(n), 1.0),
        A_ub=-vstack([windows, cells]).tocsr(),
        b_ub=-np.append(np.full(windows.shape[0], motor.thermal_time), step),
        bounds=[(0, 0)] + [(0, None)] * n,
    )
    return float(solved.fun)


@pytest.mark.parametrize(
    "drawn", by_day([(0.0, 3, 2), (0.5, 3, 2), (0.0, 5, 3), (0.5, 5, 3)], [(0.0, 3, 2)])
)
def test_the_motors_cool_down_in_little_more_time_than_a_linear_program_says(drawn):
    smooth, paths, least_warm = drawn
    # The program lets the robot stop and go at once, and drives in bursts.
    rng = np.random.default_rng(21)
    warm, excess = 0, []
    for _ in range(paths):
        path, vehicle = warm_path(rng, smooth > 0), warm_vehicle(rng)
        least = shortest_time(path, vehicle, smooth)
        made = profile(path, PAPER, vehicle=vehicle, smooth=smooth)
        assert check(made, PAPER, vehicle).feasible
        # Cells and windows of the program end at samples: it may err by some of a per cent.
        assert made.duration >= 0.99 * least
        excess.append(made.duration / least - 1)
        motor = replace(vehicle.motor, continuous_power=600.0)
        warm += (
            made.duration
            > 1.01
            * profile(path, PAPER, vehicle=replace(vehicle, motor=motor), smooth=smooth).duration
        )
    assert warm >= least_warm
    assert np.median(excess) <= 0.2
