"""Kernels, and what is made once for a map, are there before the clock starts."""

from __future__ import annotations

from importlib import import_module

from energyplan.compilation import KERNELS, compile_kernels
from energyplan.cost import EnergyCost
from energyplan.cost.steering import StaticSteering
from energyplan.planning.bound import prepare_bound
from energyplan.planning.problem import PlanningProblem
from energyplan.planning.search.narrow.ends import surely_has_room
from energyplan.planning.space.compiled import compiled
from energyplan.planning.space.cost_to_go import regions_for

PLANNING = tuple(f"energyplan.{of}." for of in ("planning", "terrain", "cost", "steering.kernels",
                                                "limits"))  # fmt: skip
"""What the names of the kernels begin with that planning and driving a plan may call."""

EXACT = ("energyplan.steering.polygon",)
SURFACES = ("energyplan.planning.bound.surfaces", "energyplan.terrain.surfaces")
TIGHT = ("energyplan.planning.search.narrow.ends",)
CLOSED = ("energyplan.planning.search.narrow.infeasible",)
"""Where the kernels are that are needed for costs that are not static, for surfaces, for ends
without room, and for ends that nothing seems to join."""


def kernels(
    cost: EnergyCost | None = None, *, surfaces: bool = False, tight: bool = False
) -> tuple[str, ...]:
    """Return the modules whose kernels planning may call."""
    import_module("energyplan.planning.search.planner")  # knows all that planning may call
    import_module("energyplan.planning.driven")
    static = cost is None or isinstance(cost.steering_parameters, StaticSteering)
    left_out = CLOSED + (() if surfaces else SURFACES) + (() if tight else TIGHT)
    found = {name.rpartition(".")[0] for name in KERNELS if name.startswith(PLANNING)}
    return (*sorted(found.difference(left_out)), *(() if static else EXACT))


def compile_planning(problem: PlanningProblem, *, tight: bool | None = None) -> None:
    """Compile the kernels of planning, or load them, so that no time limit pays for it."""
    surfaces = problem.surfaces is not None
    if tight is None:
        compile_kernels(*kernels(problem.cost, surfaces=surfaces))
        query = compiled(problem)
        tight = not all(surely_has_room(query, end) for end in (problem.start, problem.goal))
        if not tight:
            return
    compile_kernels(*kernels(problem.cost, surfaces=surfaces, tight=tight))


def prepare(problem: PlanningProblem, *, guided: bool = True) -> None:
    """Make what is made once for a map, so that no time limit pays for it.

    These are the distances to obstacles, the surface in each cell, the free configurations of the
    footprint and how they join, and the outlines for the lower bound. All are kept with the map,
    and a second problem on it finds them there. What comes of a plan does not depend on whether
    they were.
    """
    query = compiled(problem)
    if guided:
        regions_for(query.leading.setting)
    prepare_bound(query)
