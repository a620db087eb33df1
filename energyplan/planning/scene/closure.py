"""Whether the body gets from start to goal where the poses that were tested do not join them.

What the poses tested leave open is looked at closer, along one way after the other that may lead
through. So it is proven that no way exists, or that none leads over poses that lie close together,
or there may be one.
"""

from __future__ import annotations

from math import ceil, floor, log2, pi
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from energyplan.planning.budget import Budget
from energyplan.planning.scene.closure_kernels import (
    Chain,
    chain_between,
    look_closer,
    places_reached,
)
from energyplan.planning.scene.compiled import MARGIN
from energyplan.planning.scene.guide import TURNS, places_for
from energyplan.planning.scene.guide_kernels import HEADINGS, RIM, place_of
from energyplan.planning.scene.motions import KernelProblem
from energyplan.terrain.collision import Body

FINEST = 2.5e-3
"""Distance between poses down to which it is looked closer [m], unless a cell's part is larger."""

OF_A_CELL = 0.1
"""That part."""

BESIDE = 1
"""Places about a step that is not known to be open that are looked at as well."""

TURNED = 2
"""And headings."""

TEST = 0.03
"""Units of work that a test counts as."""

Words = NDArray[np.uint64]


class Closure(NamedTuple):
    """What is known of ways from start to goal.

    Attributes
    ----------
    proven : bool
        Whether there certainly is none.
    resolution : float
        Distance between poses over which none leads [m]; infinite where there may be one.
    reached : ndarray of int64
        Places that the start leads to; none where there may be a way.
    """

    proven: bool
    resolution: float
    reached: NDArray[np.int64]


def closure(kernel: KernelProblem, budget: Budget) -> Closure:
    """Find out whether ways from start to goal are closed.

    Parameters
    ----------
    kernel : KernelProblem
        The problem.
    budget : Budget
        What may be spent; where it is over before anything is known there may be a way.

    Returns
    -------
    Closure
        What is known.
    """
    return _Closer(kernel, budget).found()


class _Closer:
    """The free configurations of a problem, and what looking closer made of them."""

    def __init__(self, kernel: KernelProblem, budget: Budget) -> None:
        self.kernel, self.budget = kernel, budget
        space = kernel.space
        self.places = places_for(kernel, enlarged=True)
        self.across = self.places.columns + 2 * RIM
        finest = max(FINEST, OF_A_CELL * space.resolution)
        self.halvings = max(ceil(log2(self.places.spacing / finest)), 0)
        self.resolution = self.places.spacing * 0.5**self.halvings
        self.tested = places_for(kernel).masks & self.places.masks
        self.may, self.free = self.places.masks.copy(), self.places.masks.copy()
        self.known = self.tested.copy()
        self.ends = [
            (
                int(place_of(self.places, space, x, y)),
                floor((yaw - space.yaw) * (HEADINGS / (2.0 * pi)) + 0.5) % HEADINGS,
            )
            for x, y, yaw in (
                (kernel.start_x, kernel.start_y, kernel.start_yaw),
                (kernel.goal_x, kernel.goal_y, kernel.goal_yaw),
            )
        ]
        for place, heading in self.ends:
            bit = np.uint64(1 << heading)
            for words in (self.may, self.free, self.known):
                words[place] |= bit
        grown = MARGIN * space.resolution
        body = kernel.body
        self.body = Body(
            body.x_min + grown, body.y_min + grown, body.x_max - grown, body.y_max - grown
        )

    def found(self) -> Closure:
        """Return what is known in the end."""
        for words, proven in ((self.may, True), (self.free, False)):
            if self._closed(words):
                (start, begin), _ = self.ends
                reached = places_reached(words, self.across, start, begin)
                return Closure(proven, self.resolution, np.flatnonzero(reached))
            if self.budget.over:
                break
        return Closure(False, np.inf, np.empty(0, np.int64))

    def _chain(self, words: Words) -> Chain:
        (start, begin), (goal, end) = self.ends
        found = chain_between(words, self.tested, self.across, start, begin, goal, end)
        self.budget.spend(found.work / TURNS)
        return found

    def _closed(self, words: Words) -> bool:
        """Look closer along ways, until there is none or all of one is known."""
        while not self.budget.over:
            chain = self._chain(words)
            if len(chain.place) == 0:
                return True
            if not self._look(chain):
                return False
        return False

    def _look(self, chain: Chain) -> bool:
        """Look closer about the steps of a way that are not known; tell whether there were any."""
        wanted: dict[int, int] = {}
        place, headings = chain.place.tolist(), chain.headings.tolist()
        for k in range(len(place) - 1):
            one, two = place[k], place[k + 1]
            open_ones = int(self.tested[one]) & int(self.tested[two])
            if open_ones & headings[k] & headings[k + 1]:
                continue
            bits = _turned(headings[k] | headings[k + 1])
            for middle in (one, two):
                for row in range(-BESIDE, BESIDE + 1):
                    for column in range(-BESIDE, BESIDE + 1):
                        at = middle + row * self.across + column
                        left = bits & int(self.places.masks[at]) & ~int(self.known[at])
                        if left:
                            wanted[at] = wanted.get(at, 0) | left
        if not wanted:
            return False
        which = np.array(list(wanted), np.int64)
        bits_of = np.array(list(wanted.values()), np.uint64)
        most = int(min(self.budget.left / TEST, 1 << 40))
        looked = look_closer(
            self.kernel.space, self.body, self.places, which, bits_of, self.halvings, most
        )
        self.budget.spend(TEST * looked.tests)
        self.known[which] |= bits_of
        self.may[which] &= looked.may | ~bits_of
        self.free[which] &= looked.free | ~bits_of
        return True


def _turned(bits: int) -> int:
    """Return these headings and those next to them."""
    every = (1 << HEADINGS) - 1
    for _ in range(TURNED):
        bits |= (bits << 1 | bits >> (HEADINGS - 1) | bits >> 1 | bits << (HEADINGS - 1)) & every
    return bits
