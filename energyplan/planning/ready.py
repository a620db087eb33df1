"""Kernels are there before the clock starts."""

from __future__ import annotations

from importlib import import_module

from energyplan.compilation import compile_kernels
from energyplan.cost import EnergyCost
from energyplan.cost.steering import StaticSteering

PLANNING = (
    "energyplan.planning",
    "energyplan.terrain",
    "energyplan.cost",
    "energyplan.steering.kernels",
)
"""Where the kernels are that a planner may call, whatever the problem."""


def compiled(cost: EnergyCost | None = None) -> None:
    """Compile all kernels of planning, or load them from disk, so that no time limit pays for it.

    Those of exact steering are among them where a `cost` is given that is not static.

    Whatever kind of problem comes, its kernels are among them. It is called when the problem has
    been checked: who starts in an obstacle is told so at once.
    """
    import_module("energyplan.planning.lattice.planner")  # knows all that planning may call
    static = cost is None or isinstance(cost.steering_parameters, StaticSteering)
    compile_kernels(*PLANNING, *(() if static else ("energyplan.steering.polygon",)))
