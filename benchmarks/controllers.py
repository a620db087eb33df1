"""Which controller follows these plans? Two of them drive the same plans in the physics engine.

    python benchmarks/controllers.py 20
    python benchmarks/controllers.py 20 --write docs/ros.md

One is the library's tracking controller, on the plan's timetable. The other is Nav2's regulated
pure pursuit, written from its description with the default values of its parameters and with those
that the page recommends; what it does about obstacles is left out. Plans are forwards only, since
it cannot reverse. Needs the extra ``physics``; some ten minutes of one quiet core.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from loop import MODEL, ROBOT, VEHICLE, Pair, maps, pair
from pages import write

import energyplan as ep
from energyplan.errors import EnergyPlanError
from energyplan.limits.speed import profile
from energyplan.path import wrap_angle
from energyplan.physics import drive
from energyplan.physics.engine import PERIOD, Engine, Run, State

SPIN = np.radians(20.0)
"""Least turn on the spot of a plan that a controller should follow [rad]."""
NEAR, WITHIN = 0.25, 0.25
"""Where such a turn counts as followed: both its headings are reached, so far from its place [m],
to so much [rad]; Nav2's goal checker has these tolerances."""


@dataclass(frozen=True)
class Pursuit:
    """Parameters of regulated pure pursuit, with Nav2's names and defaults."""

    # Source: Macenski et al. (2023), "Regulated Pure Pursuit for Robot Path Tracking"; Nav2's
    # configuration guide.

    desired_linear_vel: float = 0.5
    lookahead_dist: float = 0.6
    regulated_linear_scaling_min_radius: float = 0.9
    regulated_linear_scaling_min_speed: float = 0.25
    rotate_to_heading_angular_vel: float = 1.8
    rotate_to_heading_min_angle: float = 0.785
    max_angular_accel: float = 3.2
    approach_velocity_scaling_dist: float = 0.6
    min_approach_linear_velocity: float = 0.05
    xy_goal_tolerance: float = 0.25  # of the goal checker
    yaw_goal_tolerance: float = 0.25
    controller_frequency: float = 20.0


class Pursuer:
    """Regulated pure pursuit along the poses of a path."""

    def __init__(self, path: ep.Path, at: Pursuit) -> None:
        self.at, self.poses = at, path.poses(0.05, 0.1)
        step = np.hypot(*np.diff(self.poses[:, :2], axis=0).T)
        self.along = np.concatenate([[0.0], np.cumsum(step)])
        self.first, self.rate, self.arrived = 0, 0.0, False
        self.every = round(1.0 / (at.controller_frequency * PERIOD))
        self.ticks, self.treads = 0, (0.0, 0.0)

    def __call__(self, state: State) -> tuple[float, float] | None:
        """Return the tread speeds to reach by the next tick [m/s], or None at the goal."""
        if self.ticks % self.every == 0:
            command = self._command(state)
            if command is None:
                return None
            v, self.rate = command
            self.treads = (v - VEHICLE.icr.left * self.rate, v + VEHICLE.icr.right * self.rate)
        self.ticks += 1
        return self.treads

    def _command(self, state: State) -> tuple[float, float] | None:
        """Return the speed [m/s] and the yaw rate [rad/s], or None at the goal."""
        at, here = self.at, np.array(state.pose)
        # the path is pruned up to its nearest pose, not further than a window ahead
        window = slice(
            self.first, int(np.searchsorted(self.along, self.along[self.first] + 3.0)) + 1
        )
        apart = np.hypot(*(self.poses[window, :2] - here[:2]).T)
        self.first += int(np.argmin(apart))
        goal = self.poses[-1]
        close = np.hypot(*(goal - here)[:2]) < at.xy_goal_tolerance
        self.arrived |= bool(close and self._left() < 2 * at.lookahead_dist)
        if self.arrived:
            left = float(wrap_angle(goal[2] - here[2]))
            return None if abs(left) < at.yaw_goal_tolerance else (0.0, self._turned(left))
        ahead = self.poses[self.first :]
        far = np.hypot(*(ahead[:, :2] - here[:2]).T) >= at.lookahead_dist
        carrot = ahead[int(np.argmax(far))] if far.any() else goal
        c, s = np.cos(here[2]), np.sin(here[2])
        dx, dy = carrot[:2] - here[:2]
        x, y = c * dx + s * dy, c * dy - s * dx
        angle = float(np.arctan2(y, x))
        if abs(angle) > at.rotate_to_heading_min_angle:
            return 0.0, self._turned(angle)
        curvature = 2.0 * y / max(x * x + y * y, 1e-3)
        v, radius = at.desired_linear_vel, 1.0 / max(abs(curvature), 1e-6)
        if radius < at.regulated_linear_scaling_min_radius:
            v *= radius / at.regulated_linear_scaling_min_radius
        v = max(v, at.regulated_linear_scaling_min_speed)
        left = self._left()
        if left < at.approach_velocity_scaling_dist:
            slowed = v * left / at.approach_velocity_scaling_dist
            v = min(v, max(slowed, at.min_approach_linear_velocity))
        return float(v), float(v * curvature)

    def _left(self) -> float:
        """Return how much of the path is left [m]."""
        return float(self.along[-1] - self.along[self.first])

    def _turned(self, angle: float) -> float:
        """Return the yaw rate of a turn on the spot, within its acceleration."""
        step = self.at.max_angular_accel / self.at.controller_frequency
        wanted = float(np.sign(angle)) * self.at.rotate_to_heading_angular_vel
        rate = float(np.clip(wanted, self.rate - step, self.rate + step))
        stopping = float(np.sqrt(2.0 * self.at.max_angular_accel * abs(angle)))
        return float(np.clip(rate, -stopping, stopping))


class Case(NamedTuple):
    """How a plan was followed."""

    energy: float  # over the prediction, minus one
    aside: float  # largest distance from the path [m]
    spins: list[bool]  # whether each turn on the spot was followed


def followed(path: ep.Path, run: Run, predicted: float) -> Case:
    """Return how a drive followed a path."""
    line = path.poses(0.02, 0.05)
    at = np.column_stack([run.x, run.y])[::5]
    aside = max(float(np.hypot(*(line[:, :2] - one).T).min()) for one in at)
    still, spins = np.hypot(path.ds, 0.0) < 1e-6, list[bool]()
    corners = path.vertices
    for k in np.flatnonzero(still & (np.abs(path.dtheta) > SPIN)):
        near = np.hypot(run.x - corners[k, 0], run.y - corners[k, 1]) < NEAR
        off = [np.abs(wrap_angle(run.yaw[near] - corners[j, 2])) for j in (k, k + 1)]
        spins.append(bool(near.any()) and all(bool(one.min() < WITHIN) for one in off))
    return Case(run.taken / predicted - 1.0, aside, spins)


WAYS = {
    "tracking controller of the library": None,
    "regulated pure pursuit, Nav2's defaults": Pursuit(),
    "regulated pure pursuit, `lookahead_dist: 0.3`, `rotate_to_heading_min_angle: 0.35`": Pursuit(
        lookahead_dist=0.3, rotate_to_heading_min_angle=0.35
    ),
}


def driven(case: Pair, speed: float) -> dict[str, Case]:
    """Plan between two poses, forwards only, and drive the plan with each controller."""
    cost = ep.EnergyCost(MODEL)
    robot = replace(VEHICLE, reverse=False)
    problem = ep.PlanningProblem(case.grid, cost, case.start, case.goal, vehicle=robot)
    path = ep.plan(problem, effort=50_000).path
    slow = replace(VEHICLE, motor=replace(VEHICLE.motor, speed=speed, acceleration=0.5))
    trajectory = profile(path, MODEL, vehicle=slow)
    found = {}
    for name, at in WAYS.items():
        if at is None:
            tracked = drive(trajectory, ROBOT, MODEL)
            run, predicted = tracked.run, tracked.energy_predicted
        else:
            run = Engine(ROBOT, None, path.start).drive(Pursuer(path, at), longest=600.0)
        found[name] = followed(path, run, predicted)
    return found


def main() -> None:
    """Drive, and print or write the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("plans", nargs="?", type=int, default=4)
    parser.add_argument("--write", type=Path, metavar="PAGE.md")
    given = parser.parse_args()
    grids, cases = maps(), list[dict[str, Case]]()
    for seed in range(given.plans):
        try:
            cases.append(driven(pair(grids, 9000 + seed), 0.5))
        except EnergyPlanError as error:
            print(f"plan {seed}: {error}", flush=True)
            continue
        print(f"plan {seed}: " + "; ".join(
            f"{100 * one.energy:+.1f} %, {100 * one.aside:.0f} cm, {sum(one.spins)} of "
            f"{len(one.spins)}" for one in cases[-1].values()), flush=True)  # fmt: skip
    lines = [
        "| controller | energy over the prediction, median / worst | largest distance from the "
        "path, median / worst | turns on the spot followed |",
        "|---|---|---|---|",
    ]
    for name in WAYS:
        some = [one[name] for one in cases]
        over, aside = ([getattr(one, key) for one in some] for key in ("energy", "aside"))
        spins = [spin for one in some for spin in one.spins]
        worst = max(over, key=abs)
        lines.append(
            f"| {name} | {100 * np.median(over):+.1f} / {100 * worst:+.1f} % | "
            f"{100 * np.median(aside):.0f} / {100 * max(aside):.0f} cm | {sum(spins)} of "
            f"{len(spins)} |"
        )
    print("\n" + "\n".join(lines))
    if given.write:
        write(given.write, "measured controllers", "\n".join(lines))


if __name__ == "__main__":
    main()
