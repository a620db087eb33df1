"""Ground that a model contains, put on the map for planners."""

from __future__ import annotations

from dataclasses import dataclass, replace

from energyplan.physics.robot import Ground
from energyplan.planning import PlanningProblem
from energyplan.power import PowerModel
from energyplan.power.effects import with_weight
from energyplan.terrain import laid_out


@dataclass(frozen=True)
class Belief:
    """A model as planners take it: what belongs to the ground is on the map.

    Parameters
    ----------
    model : PowerModel
        The model without the terms that the ground stands for.
    ground : Ground
        Surfaces and heights.
    asked : PlanningProblem
        The problem.
    """

    model: PowerModel
    ground: Ground
    asked: PlanningProblem

    def planned(self, speed: float) -> PlanningProblem:
        """Return the problem with this model, driven at a tread speed [m/s]."""
        cost = replace(self.asked.cost, model=self.model, battery=True, speed=speed)
        vehicle = self.asked.robot
        return replace(
            self.asked, cost=cost, surfaces=self.ground.surfaces, heights=self.ground.heights,
            vehicle=vehicle,
        )  # fmt: skip


def believed(model: PowerModel, problem: PlanningProblem) -> Belief:
    """Put what a model found of the ground on the map: a tilted plane, another surface.

    Where the map has heights, a model that was learned on level ground gets the vehicle's weight.

    Parameters
    ----------
    model : PowerModel
        The model.
    problem : PlanningProblem
        The problem, with the surfaces and heights known before.

    Returns
    -------
    Belief
        Model and ground.
    """
    if problem.heights is not None:
        model = with_weight(model)
    ground = laid_out(model, problem.map.corners, problem.surfaces, problem.heights)
    return Belief(ground.model, Ground(ground.surfaces, ground.heights), problem)
