"""The searches that follow upon a first path, and what guides them."""

from __future__ import annotations

from typing import NamedTuple


class Guide(NamedTuple):
    """What leads a search: the objective, the penalty on tight places, and the headings."""

    penalty: float
    aligned: bool = False
    shortest: bool = False


ROUNDS = (
    (1.0, 2.0, (Guide(2.0, True),)),
    (1.0, 1.2, (Guide(2.0), Guide(1.0, shortest=True))),
    (1.0, 2.0, (Guide(1.0, True), Guide(4.0), Guide(1.0))),
    (1.0, 1.5, (Guide(2.0, True), Guide(1.0, True), Guide(4.0), Guide(1.0, shortest=True))),
    (1.0, 1.2, (Guide(2.0, True), Guide(1.0, True), Guide(8.0), Guide(2.0), Guide(1.0))),
    (1.0, 1.0, (Guide(1.0, True), Guide(1.0))),
    (0.5, 1.0, (Guide(1.0, True), Guide(1.0))),
)
"""Searches that follow, round by round: scale of the lattice, weight, and guides.

No one guidance is best: a penalty that spares one problem its blind alleys hides from another the
gap it should have taken.
"""
