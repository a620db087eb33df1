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

    Examples
    --------
    >>> import numpy as np
    >>> import energyplan as ep
    >>> hall = ep.OccupancyGrid(np.zeros((40, 60), bool), resolution=0.1)
    >>> model = ep.PowerModel.preset("quadriga:empty:marble")
    >>> problem = ep.PlanningProblem(hall, ep.EnergyCost(model), (1, 2, 0), (4, 2, 0))
    >>> Belief(model, Ground(), problem).planned(0.5).cost.speed
    0.5
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

    Examples
    --------
    >>> import numpy as np
    >>> import energyplan as ep
    >>> from energyplan.power.effects import term
    >>> hall = ep.OccupancyGrid(np.zeros((40, 60), bool), resolution=0.1)
    >>> model = ep.PowerModel.preset("quadriga:empty:marble")
    >>> problem = ep.PlanningProblem(hall, ep.EnergyCost(model), (1, 2, 0), (4, 2, 0))
    >>> found = believed(model.with_term(term("tilt_x"), 20.0), problem)
    >>> found.ground.heights is not None, [t.name for t in found.model.terms]
    (True, ['slip_friction', 'traction_resistance', 'grade'])
    """
    if problem.heights is not None:
        model = with_weight(model)
    ground = laid_out(model, problem.map.corners, problem.surfaces, problem.heights)
    return Belief(ground.model, Ground(ground.surfaces, ground.heights), problem)
