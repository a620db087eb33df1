"""Kernels, and what is made once for a map, are there before the clock starts."""

from __future__ import annotations

from importlib import import_module

from energyplan.compilation import compile_kernels
from energyplan.cost import EnergyCost
from energyplan.cost.steering import StaticSteering
from energyplan.planning.bound import prepare_bound
from energyplan.planning.problem import PlanningProblem
from energyplan.planning.scene.compiled import CompiledProblem
from energyplan.planning.scene.guide import regions_for

PLANNING = (
    "energyplan.planning",
    "energyplan.terrain",
    "energyplan.cost",
    "energyplan.steering.kernels",
)
"""Where the kernels are that a planner may call, whatever the problem."""


def kernels(cost: EnergyCost | None = None) -> tuple[str, ...]:
    """Return the modules, or packages, whose kernels planning may call, whatever the problem.

    Those of exact steering are among them where a `cost` is given that is not static.
    """
    import_module("energyplan.planning.lattice.planner")  # knows all that planning may call
    static = cost is None or isinstance(cost.steering_parameters, StaticSteering)
    return PLANNING if static else (*PLANNING, "energyplan.steering.polygon")


def compiled(cost: EnergyCost | None = None) -> None:
    """Compile all kernels of planning, or load them from disk, so that no time limit pays for it.

    Whatever kind of problem comes, its kernels are among them. It is called when the problem has
    been checked: who starts in an obstacle is told so at once.
    """
    compile_kernels(*kernels(cost))


def prepare(problem: PlanningProblem, *, guided: bool = True) -> None:
    """Make what is made once for a map, so that no time limit pays for it.

    These are the distances to obstacles, the surface in each cell, the free configurations of the
    footprint and how they join, and the outlines for the lower bound. All are kept with the map,
    and a second problem on it finds them there. What comes of a plan does not depend on whether
    they were.

    Parameters
    ----------
    problem : PlanningProblem
        The problem, whose poses have been checked.
    guided : bool
        Whether the planner looks at the free configurations.
    """
    query = CompiledProblem(problem)
    if guided:
        regions_for(query.setting)
    prepare_bound(query)
