"""A way that is as short as a search finds it at first, made shorter a little.

Of two ways that are refined for their energy the shorter one may stay the dearer, though it is
cheaper once it is short: so it is made short before it competes.
"""

from __future__ import annotations

from energyplan.planning.budget import Budget
from energyplan.planning.lattice.refine import Refiner
from energyplan.planning.lattice.search import Search, lattice_for
from energyplan.planning.lattice.tight_ends import Ends
from energyplan.planning.lattice.way_along import way_along
from energyplan.planning.scene.compiled import Segments
from energyplan.planning.scene.guide_kernels import DistanceToGo
from energyplan.planning.scene.motions import KernelProblem

TRIES = ((2.0, 400), (1.0, 4000))
"""Scales of the lattices on which it is sought, and expansions of each search at most."""

WEIGHT = 2.0
"""Weight of these searches."""

SEARCHING = 0.5
"""Part of the budget that they may take; the way along the guide may have the rest."""

POLISH = 800
"""Attempts to make it shorter."""


def shortest_way(
    setting: KernelProblem, ends: Ends, to_go: DistanceToGo, budget: Budget
) -> Segments | None:
    """Return motions of little length from the start to the goal.

    Parameters
    ----------
    setting : KernelProblem
        The problem with the length as its objective.
    ends : Ends
        Where the search begins and ends.
    to_go : DistanceToGo
        Distance to go.
    budget : Budget
        What may be spent.

    Returns
    -------
    Segments or None
        The motions, free of collisions; None where none were found.
    """
    way = _searched(ends.between(setting), to_go, budget.part(SEARCHING))
    if way is None:
        way = way_along(ends.between(setting), to_go, budget)
    if way is None:
        return None
    refiner = Refiner(setting, ends.whole(way))
    refiner.shortcut(budget)
    refiner.polish(budget, most=POLISH)
    return refiner.segments


def _searched(setting: KernelProblem, to_go: DistanceToGo, budget: Budget) -> Segments | None:
    """Return the first way that a search finds."""
    for scale, most in TRIES:
        search = Search(setting, to_go, lattice_for(setting, scale), WEIGHT)
        search.run(budget, stop_at_first=True, expansions=most)
        if search.found:
            return search.segments()
    return None
