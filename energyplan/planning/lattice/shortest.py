"""A way that is as short as a search finds it at first, made shorter a little.

Of two ways that are refined for their energy the shorter one may stay the dearer, though it is
cheaper once it is short: so it is made short before it competes.
"""

from __future__ import annotations

from energyplan.planning.budget import Budget
from energyplan.planning.lattice.refine import Refiner
from energyplan.planning.lattice.search import Search, lattice_for
from energyplan.planning.lattice.tight_ends import Ends
from energyplan.planning.scene.compiled import Segments
from energyplan.planning.scene.guide_kernels import DistanceToGo
from energyplan.planning.scene.motions import KernelProblem

TRIES = ((2.0, 400), (1.0, 4000))
"""Scales of the lattices on which it is sought, and expansions of each search at most."""

WEIGHT = 2.0
"""Weight of these searches."""

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
    for scale, most in TRIES:
        search = Search(ends.between(setting), to_go, lattice_for(setting, scale), WEIGHT)
        search.run(budget, stop_at_first=True, expansions=most)
        if search.found:
            refiner = Refiner(setting, ends.whole(search.segments()))
            refiner.shortcut(budget)
            refiner.polish(budget, most=POLISH)
            return refiner.segments
    return None
