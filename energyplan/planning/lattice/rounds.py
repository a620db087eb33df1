"""The searches that follow upon a first path, and what guides them."""

from __future__ import annotations

from typing import NamedTuple


class Sought(NamedTuple):
    """A search: its lattice, its weight, and what leads it.

    Attributes
    ----------
    scale : float
        Scale of the lattice; above 1 it is coarser.
    weight : float
        Factor on the estimated cost to go.
    penalty : float
        How much longer tight places count for the guide.
    aligned : bool
        Whether headings are counted from the map's axes.
    shortest : bool
        Whether the shortest way is sought instead.
    """

    scale: float
    weight: float
    penalty: float
    aligned: bool = False
    shortest: bool = False


ROUNDS = (
    (Sought(2.0, 1.2, 8.0, True), Sought(1.0, 2.0, 2.0, True)),
    (Sought(2.0, 1.0, 8.0, True), Sought(1.0, 2.0, 8.0, True), Sought(2.0, 1.0, 8.0, False, True)),
    (Sought(1.0, 1.2, 2.0), Sought(2.0, 1.0, 2.0), Sought(1.0, 1.2, 2.0, False, True)),
    (Sought(1.0, 2.0, 1.0, True), Sought(1.0, 2.0, 4.0), Sought(1.0, 1.5, 1.0)),
    (Sought(1.0, 1.5, 2.0, True), Sought(2.0, 1.0, 1.0, True), Sought(1.0, 1.2, 8.0)),
    (Sought(1.0, 1.2, 2.0, True), Sought(1.0, 1.2, 1.0, True), Sought(1.0, 1.0, 1.0)),
    (Sought(1.0, 1.0, 1.0, True), Sought(0.5, 1.0, 1.0), Sought(0.5, 1.0, 1.0, True)),
)
"""Searches that begin, round by round, while those of the rounds before go on.

On a coarse lattice all ways that are not tight are soon compared, down to the weight 1: so that
comes first, by the guide that is known already. Fine lattices find the gaps that it misses. No one
guidance is best: a penalty that spares one problem its blind alleys hides from another the gap it
should have taken.
"""
