"""Infeasibility proofs: whether there is a path at all, and what is certain if none was found.

Where the poses that were tested do not join start and goal, what they leave open is looked at
closer, along one chain of places after the other. So it is proven that no path exists, or that none
leads over poses that lie close together, or there may be one.
"""

from __future__ import annotations

from math import ceil, hypot, log2, pi
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from energyplan.compilation import Ints, Words, inner, lean, njit
from energyplan.errors import NoPathError, TimeLimitError
from energyplan.planning.budget import UNITS, Budget
from energyplan.planning.settings import PROOF
from energyplan.planning.space.compiled import MARGIN, CompiledProblem
from energyplan.planning.space.configurations import HEADINGS, grown, shrunk
from energyplan.planning.space.cost_to_go import CostToGo, cost_to_go, reached
from energyplan.planning.space.motions import KernelProblem
from energyplan.planning.space.places import (
    NEIGHBOURS,
    RIM,
    Places,
    heading_of,
    place_of,
    places_for,
)
from energyplan.planning.space.queues import STEP_COLUMNS, STEP_ROWS
from energyplan.terrain.collision import Body, Space, pose_free


class Queue(NamedTuple):
    """Places and headings in the order in which they came; there may be room for more."""

    place: Ints  # (n,): the places
    bits: Words  # (n,): headings of each
    parent: Ints  # (n,): where each was reached from


class PlaceChain(NamedTuple):
    """A chain of places, empty where there is none, and what was reached."""

    place: Ints  # (n,): its places, from the start to the goal
    headings: Words  # (n,): headings with which each may be reached
    reached: Words  # headings that were reached at every place
    work: int  # steps that it took


@inner
def _queue(room: int) -> Queue:
    """Return a queue with room for some entries."""
    return Queue(np.empty(room, np.int64), np.empty(room, np.uint64), np.empty(room, np.int64))


@inner
def _added(queue: Queue, count: int, place: int, bits: np.uint64, parent: int) -> Queue:
    """Return a queue with an entry behind the first `count`: a longer one where it is full."""
    if count == len(queue.place):
        longer = _queue(2 * count)
        for k in range(count):
            longer.place[k] = queue.place[k]
            longer.bits[k] = queue.bits[k]
            longer.parent[k] = queue.parent[k]
        queue = longer
    queue.place[count] = place
    queue.bits[count] = bits
    queue.parent[count] = parent
    return queue


@lean
def _neighbours(bits: np.uint64) -> np.uint64:
    """Return the headings next to some."""
    ahead = (bits << np.uint64(1)) | (bits >> np.uint64(63))
    return ahead | (bits >> np.uint64(1)) | (bits << np.uint64(63))


@inner
def _spread(bits: np.uint64, mask: np.uint64) -> np.uint64:
    """Return all headings of a mask that are joined with some of them."""
    bits &= mask
    while True:
        wider = (bits | _neighbours(bits)) & mask
        if wider == bits:
            return bits
        bits = wider


@njit
def chain_between(
    passable: Words, tested: Words, across: int, start: int, begin: int, goal: int, end: int
) -> PlaceChain:
    """Return a chain of places between two of them, mostly through tested headings."""
    reached = np.zeros(len(passable), np.uint64)
    waiting = np.zeros(len(passable), np.uint64)
    # what was reached, in that order, and what waits until all tested headings were
    found = _queue(1024)
    later = _added(_queue(1024), 0, start, np.uint64(1) << np.uint64(begin), -1)
    events = head = later_head = work = 0
    laters = 1
    while True:
        if head == events:
            # a step further, where nothing was tested
            if later_head == laters:
                return PlaceChain(np.empty(0, np.int64), np.empty(0, np.uint64), reached, work)
            there = later.place[later_head]
            waiting[there] &= ~later.bits[later_head]
            fresh = later.bits[later_head] & passable[there] & ~reached[there]
            if fresh != 0:
                fresh |= _spread(fresh, tested[there] & passable[there]) & ~reached[there]
                found = _added(found, events, there, fresh, later.parent[later_head])
                reached[there] |= fresh
                events += 1
            later_head += 1
            continue
        at = head
        head += 1
        here = found.place[at]
        if here == goal and found.bits[at] & (np.uint64(1) << np.uint64(end)) != 0:
            return _chain_to(found, at, reached, work)
        # this place's other headings, then its neighbours
        for k in range(-1, NEIGHBOURS):
            work += 1
            there = here
            if k >= 0:
                there += STEP_ROWS[k] * across + STEP_COLUMNS[k]
            mask = passable[there]
            if mask == 0:
                continue
            if k >= 0:
                known = tested[there] & mask
                fresh = _spread(found.bits[at] & tested[here] & known, known) & ~reached[there]
                if fresh != 0:
                    found = _added(found, events, there, fresh, at)
                    reached[there] |= fresh
                    events += 1
                fresh = found.bits[at] & mask
            else:
                fresh = _neighbours(found.bits[at]) & mask
            fresh &= ~(reached[there] | waiting[there])
            if fresh != 0:
                later = _added(later, laters, there, fresh, at)
                waiting[there] |= fresh
                laters += 1


@inner
def _chain_to(found: Queue, last: int, reached: Words, work: int) -> PlaceChain:
    """Return the chain to what was reached last."""
    count = 0
    k = last
    while k >= 0:
        count += 1
        k = found.parent[k]
    place = np.empty(count, np.int64)
    headings = np.empty(count, np.uint64)
    k = last
    for n in range(count - 1, -1, -1):
        place[n] = found.place[k]
        headings[n] = found.bits[k]
        k = found.parent[k]
    return PlaceChain(place, headings, reached, work)


class Looked(NamedTuple):
    """What looking closer found."""

    may: Words  # (n,): headings, as bits, at which the body may fit
    free: Words  # (n,): headings at which a pose was found where it fits
    tests: int  # poses that were tested


@njit
def look_closer(
    space: Space, body: Body, places: Places, which: Ints, headings: Words, halvings: int, most: int
) -> Looked:
    """Halve the boxes of some places and headings until it is known whether the body fits there.

    A box is a place's square with half a step of heading on either side. Where none of the poses at
    the centres of its parts is free, all of them were tested, but for those of parts in which the
    body is in the way everywhere.
    """
    across = places.columns + 2 * RIM
    may = np.zeros(len(which), np.uint64)
    free = np.zeros(len(which), np.uint64)
    less = PROOF.safe * space.resolution
    turn = 2.0 * pi / HEADINGS
    depth = np.empty(8 * halvings + 8, np.int64)
    box = np.empty((8 * halvings + 8, 3))
    tests = 0
    for n in range(len(which)):
        row = which[n] // across - RIM
        column = which[n] % across - RIM
        for h in range(HEADINGS):
            bit = np.uint64(1) << np.uint64(h)
            if headings[n] & bit == 0:
                continue
            size = 1
            depth[0] = 0
            box[0, 0] = (column + 0.5) * places.spacing
            box[0, 1] = (row + 0.5) * places.spacing
            box[0, 2] = h * turn
            while size > 0:
                size -= 1
                level = depth[size]
                along = box[size, 0]
                up = box[size, 1]
                heading = box[size, 2]
                x = space.x + space.cos * along - space.sin * up
                y = space.y + space.sin * along + space.cos * up
                tests += 1
                if tests > most or pose_free(space, body, x, y, space.yaw + heading):
                    may[n] |= bit
                    free[n] |= bit
                    break
                part = 0.5**level
                small = shrunk(body, part * places.spacing, heading, 0.5 * part * turn)
                small = grown(small, -less)
                fits = small.x_min < small.x_max and small.y_min < small.y_max
                if fits and not pose_free(space, small, x, y, space.yaw + heading):
                    continue
                if level == halvings:
                    may[n] |= bit
                    continue
                for k in range(8):
                    depth[size] = level + 1
                    box[size, 0] = along + part * places.spacing * (0.25 if k & 1 else -0.25)
                    box[size, 1] = up + part * places.spacing * (0.25 if k & 2 else -0.25)
                    box[size, 2] = heading + part * turn * (0.25 if k & 4 else -0.25)
                    size += 1
    return Looked(may, free, tests)


class Proof(NamedTuple):
    """What is known of paths from start to goal."""

    proven: bool  # whether there is certainly none
    resolution: float  # distance between poses over which none leads [m]
    reached: NDArray[np.int64]  # places that the start leads to


class Prover:
    """The free configurations of a problem, and what halving boxes showed of them."""

    def __init__(self, kernel: KernelProblem, budget: Budget) -> None:
        self.kernel, self.budget = kernel, budget
        space = kernel.space
        self.places = places_for(kernel, enlarged=True)
        self.across = self.places.columns + 2 * RIM
        finest = max(PROOF.finest, PROOF.part * space.resolution)
        self.halvings = max(ceil(log2(self.places.spacing / finest)), 0)
        self.resolution = self.places.spacing * 0.5**self.halvings
        self.tested = places_for(kernel).masks & self.places.masks
        self.may, self.free = self.places.masks.copy(), self.places.masks.copy()
        self.known = self.tested.copy()
        self.ends = [
            (int(place_of(self.places, space, x, y)), heading_of(space, yaw))
            for x, y, yaw in (kernel.start, kernel.goal)
        ]
        for place, heading in self.ends:
            bit = np.uint64(1 << heading)
            for words in (self.may, self.free, self.known):
                words[place] |= bit
        self.body = grown(kernel.body, -MARGIN * space.resolution)

    def found(self) -> Proof:
        """Return what is known in the end."""
        for words, proven in ((self.may, True), (self.free, False)):
            reached = self._closed(words)
            if reached is not None:
                return Proof(proven, self.resolution, np.flatnonzero(reached))
            if self.budget.over:
                break
        return Proof(False, np.inf, np.empty(0, np.int64))

    def _chain(self, words: Words) -> PlaceChain:
        (start, begin), (goal, end) = self.ends
        found = chain_between(words, self.tested, self.across, start, begin, goal, end)
        self.budget.spend(found.work / UNITS.nodes)
        return found

    def _closed(self, words: Words) -> Words | None:
        """Halve boxes until a whole chain is known; return what is reached if there is none."""
        while not self.budget.over:
            chain = self._chain(words)
            if len(chain.place) == 0:
                return chain.reached
            if not self._look(chain):
                break
        return None

    def _look(self, chain: PlaceChain) -> bool:
        """Halve boxes about the unknown steps of a chain; return whether there were any."""
        wanted: dict[int, int] = {}
        place, headings = chain.place.tolist(), chain.headings.tolist()
        for k in range(len(place) - 1):
            one, two = place[k], place[k + 1]
            open_ones = int(self.tested[one]) & int(self.tested[two])
            if open_ones & headings[k] & headings[k + 1]:
                continue
            bits = _widened(headings[k] | headings[k + 1])
            for middle in (one, two):
                for row in range(-PROOF.places, PROOF.places + 1):
                    for column in range(-PROOF.places, PROOF.places + 1):
                        at = middle + row * self.across + column
                        left = bits & int(self.places.masks[at]) & ~int(self.known[at])
                        if left:
                            wanted[at] = wanted.get(at, 0) | left
        if not wanted:
            return False
        which = np.array(list(wanted), np.int64)
        bits_of = np.array(list(wanted.values()), np.uint64)
        most = int(min(self.budget.left / UNITS.pose, 1 << 40))
        looked = look_closer(
            self.kernel.space, self.body, self.places, which, bits_of, self.halvings, most
        )
        self.budget.spend(UNITS.pose * looked.tests)
        self.known[which] |= bits_of
        self.may[which] &= looked.may | ~bits_of
        self.free[which] &= looked.free | ~bits_of
        return True


def _widened(bits: int) -> int:
    """Return some headings and those next to them."""
    every = (1 << HEADINGS) - 1
    for _ in range(PROOF.headings):
        bits |= (bits << 1 | bits >> (HEADINGS - 1) | bits >> 1 | bits << (HEADINGS - 1)) & every
    return bits


CANNOT = "the footprint cannot get through, whichever way it turns, so there certainly is none"
"""What is said where that is proven."""


def check_configurations(query: CompiledProblem, to_go: CostToGo) -> None:
    """Check that the footprint may get from start to goal."""
    setting = query.setting
    if reached(to_go, setting):
        return
    away = cost_to_go(setting._replace(start=setting.goal, goal=setting.start))
    homes = away.places.home[np.isfinite(away.distance)]
    raise _none(query, away.places, homes, CANNOT, certainty="proven")


def check_proof(query: CompiledProblem, setting: KernelProblem, proof: Proof) -> None:
    """Check that looking closer left a way from start to goal."""
    if len(proof.reached) == 0:
        return
    places = places_for(setting, enlarged=True)
    if proof.proven:
        raise _none(query, places, proof.reached, CANNOT, certainty="proven")
    why = (
        f"none leads over poses {1e3 * proof.resolution:.2g} mm apart, though one might through a "
        "gap that leaves less room than that (finer cells of the map, or a smaller clearance, may "
        "show one)"
    )
    raise _none(query, places, proof.reached, why, resolution=proof.resolution)


def _none(
    query: CompiledProblem, places: Places, homes: NDArray[np.integer], why: str, **verdict: Any
) -> NoPathError:
    """Return the error that names the nearest to the goal of some places."""
    row, column = np.divmod(homes, places.columns + 2 * RIM)
    cells = np.column_stack([column, row]) - RIM + 0.5
    place = query.grid.to_world(cells * places.spacing / query.grid.resolution)
    end = np.array(query.problem.goal[:2])
    x, y = place[np.argmin(np.hypot(*(place - end).T))].tolist()
    return NoPathError(_message(query, why, (x, y)), **verdict)


def none_found(
    query: CompiledProblem, spacing: float, near: list[tuple[float, float]]
) -> NoPathError:
    """Return the error that says that none was found among poses so far apart."""
    why = (
        f"none was found along the free poses {spacing:.3g} m apart, though one might lead through "
        "a gap that leaves less room than that (finer cells of the map, or a smaller clearance, "
        "may show one)"
    )
    return NoPathError(_message(query, why, _nearest(query, near)), resolution=spacing)


def _nearest(query: CompiledProblem, near: list[tuple[float, float]]) -> tuple[float, float]:
    """Return which of the start and some places lies nearest to the goal."""
    goal = query.problem.goal
    places = [(query.problem.start.x, query.problem.start.y), *near]
    return min(places, key=lambda at: hypot(goal.x - at[0], goal.y - at[1]))


def none_in_time(
    query: CompiledProblem, budget: Budget, done: str, near: list[tuple[float, float]]
) -> TimeLimitError:
    """Return the error that says that none was found before a budget was over."""
    goal, (x, y) = query.problem.goal, _nearest(query, near)
    return TimeLimitError(
        f"no path was found in {budget.name}: {done}; the place nearest to the goal that was "
        f"reached is ({x:.2f}, {y:.2f}), {hypot(goal.x - x, goal.y - y):.2f} m from it; give more "
        f"{budget.remedy}",
        budget.remedy,
    )


def _message(query: CompiledProblem, why: str, near: tuple[float, float]) -> str:
    start, goal = query.problem.start, query.problem.goal
    left = float(np.hypot(goal.x - near[0], goal.y - near[1]))
    return (
        f"no path leads from ({start.x:.2f}, {start.y:.2f}) to ({goal.x:.2f}, {goal.y:.2f}): "
        f"{why}; the nearest place to the goal that was reached is ({near[0]:.2f}, {near[1]:.2f}), "
        f"{left:.2f} m from it; check the map for closed doors and unknown cells"
    )
