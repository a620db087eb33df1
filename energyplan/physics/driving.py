"""A trajectory driven in the engine, and its energy beside the prediction of a power model."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from energyplan import html
from energyplan.limits.drive import Drive
from energyplan.limits.drive import Ground as ModelledGround
from energyplan.path import Pose, Trajectory, wrap_angle
from energyplan.physics.engine import Engine
from energyplan.physics.record import Run
from energyplan.physics.robot import Ground, Robot
from energyplan.physics.tracking import Tracker, Tracking
from energyplan.power import PowerModel
from energyplan.terrain import laid_out


@dataclass(frozen=True)
class Driven(html.Readable):
    """A trajectory as it was driven."""

    trajectory: Trajectory  # what was asked
    run: Run  # what happened
    told: dict[str, float]  # energy that the power model predicts for the trajectory, by term [J]
    taken: dict[str, float]  # energy that the battery delivered, by the term that stands for it [J]
    arrived: bool  # whether the robot stands at the end of the trajectory
    tracking_error: float
    heading_error: float
    final_error: float  # distance from the end of the trajectory [m]

    @property
    def energy_told(self) -> float:
        """Energy that the model predicts [J]."""
        return sum(self.told.values())

    @property
    def energy_taken(self) -> float:
        """Energy that the battery delivered [J]."""
        return self.run.taken

    @property
    def error(self) -> float:
        """Predicted over taken energy, minus one."""
        return self.energy_told / self.energy_taken - 1.0

    @property
    def terms(self) -> list[tuple[str, float, float]]:
        """Rows of term, predicted energy [J] and energy taken [J]; the largest first."""
        names = dict.fromkeys([*self.told, *self.taken])
        rows = [(name, self.told.get(name, 0.0), self.taken.get(name, 0.0)) for name in names]
        rows = [row for row in rows if row[1] or row[2]]
        return sorted(rows, key=lambda row: -max(abs(row[1]), abs(row[2])))

    def _summaries(self) -> list[html.Summary]:
        return [
            html.Summary(
                f"predicted {self.energy_told:.0f} J, taken {self.energy_taken:.0f} J "
                f"({100 * self.error:+.1f} %), {'arrived' if self.arrived else 'not arrived'}",
                ("term", "predicted [J]", "measured [J]"),
                self.terms,
            )
        ]


def energy_told(
    trajectory: Trajectory, model: PowerModel, ground: Ground | None = None
) -> dict[str, float]:
    """Return the energy of a trajectory by term, as a power model predicts it [J]."""
    here = ground or Ground()
    law, surfaces, heights = laid_out(model, trajectory.poses[:, :2], here.surfaces, here.heights)
    grounds = () if surfaces is None else surfaces.surfaces
    others = tuple(surface.model.battery_side() for surface in grounds)
    driven_on = ModelledGround(law.battery_side(), surfaces, heights, others)
    return Drive(trajectory, driven_on).breakdown()


def drive(
    trajectory: Trajectory,
    robot: Robot,
    model: PowerModel,
    *,
    ground: Ground | None = None,
    tracking: Tracking | None = None,
) -> Driven:
    """Drive a trajectory in the engine."""
    gains = tracking or Tracking()
    tracker = Tracker(trajectory, model.vehicle, gains)
    start = Pose(*(float(value) for value in trajectory.poses[0]))
    told = energy_told(trajectory, model, ground)
    run = Engine(robot, ground, start).drive(tracker, longest=2 * trajectory.duration + 60.0)
    wanted = np.array([tracker.reference(float(t))[:3] for t in run.t])
    apart = np.hypot(run.x - wanted[:, 0], run.y - wanted[:, 1])
    turned = np.abs(wrap_angle(run.yaw - wanted[:, 2]))
    return Driven(
        trajectory, run, told, run.energy,
        bool(apart[-1] <= gains.position and turned[-1] <= gains.angle),
        float(apart.max()), float(turned.max()), float(apart[-1]),
    )  # fmt: skip
