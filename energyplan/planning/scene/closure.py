"""Whether there is a way at all, and what can be said for certain if none was found.

Where the poses that were tested do not join start and goal, what they leave open is looked at
closer, along one way after the other that may lead through. So it is proven that no way exists, or
that none leads over poses that lie close together, or there may be one.
"""

from __future__ import annotations

from math import ceil, hypot, log2, sqrt
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from energyplan.errors import NoPathError, TimeLimitError
from energyplan.planning.budget import Budget
from energyplan.planning.scene.closure_kernels import (
    Chain,
    chain_between,
    look_closer,
    places_reached,
)
from energyplan.planning.scene.compiled import MARGIN, CompiledProblem
from energyplan.planning.scene.guide import TURNS, distance_to_go, places_for, reached
from energyplan.planning.scene.guide_kernels import (
    HEADINGS,
    RIM,
    DistanceToGo,
    Places,
    heading_of,
    place_of,
)
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
    """What is known of ways from start to goal."""

    proven: bool  # whether there certainly is none
    resolution: float  # distance between poses over which none leads [m]
    reached: NDArray[np.int64]  # places that the start leads to


def closure(kernel: KernelProblem, budget: Budget) -> Closure:
    """Find out whether ways from start to goal are closed."""
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
            (int(place_of(self.places, space, x, y)), heading_of(space, yaw))
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


CANNOT = "the footprint cannot get through, whichever way it turns, so there certainly is none"
"""What is said where that is proven."""


def _parts(query: CompiledProblem) -> NDArray[np.int32]:
    """Return the connected parts of the map's cells in which the centre of a disc may lie.

    The disc is the largest one about the centre of the tread ICRs inside the footprint. Where its
    centre is anywhere in a cell, the clearance of the cell's centre is at least the disc's radius
    less half a diagonal. So the centre's way leads through such cells only, from each to one of
    the eight around it: two parts that do not touch are apart for certain.
    """
    body, grid = query.body, query.grid
    radius = max(min(-body.x_min, body.x_max, -body.y_min, body.y_max), 0.0)
    # a thousandth of a cell is far above rounding
    least = radius - (sqrt(0.5) + 1e-3) * grid.resolution

    def label() -> NDArray[np.int32]:
        from scipy import ndimage  # slow to import, and rarely needed

        found, _ = ndimage.label(grid.clearance >= least, np.ones((3, 3)))
        return np.asarray(found, np.int32)

    return query.terrain.bare.remember(("parts a disc can be in", least), label)


def _cells(query: CompiledProblem) -> list[tuple[int, int]]:
    """Return row and column of the cells that hold the centre of the tread ICRs at both ends."""
    grid = query.grid
    ends = [query.centre(pose)[:2] for pose in (query.problem.start, query.problem.goal)]
    rows, columns = grid.shape
    cells = np.floor(grid.to_cells(ends)).astype(int)
    return [(min(max(r, 0), rows - 1), min(max(c, 0), columns - 1)) for c, r in cells.tolist()]


def check_way(query: CompiledProblem) -> None:
    """Check that a disc inside the footprint may get from start to goal."""
    parts, (start, goal) = _parts(query), _cells(query)
    if parts[start] == parts[goal] or 0 in (parts[start], parts[goal]):
        return
    row, column = np.nonzero(parts == parts[start])
    place = query.grid.to_world(np.column_stack([column + 0.5, row + 0.5]))
    end = np.array(query.problem.goal[:2])
    x, y = place[np.argmin(np.hypot(*(place - end).T))].tolist()
    raise NoPathError(
        _told(
            query,
            "a disc inside the footprint cannot get through, so there certainly is none",
            (x, y),
        ),
        certainty="proven",
    )


def check_configurations(query: CompiledProblem, to_go: DistanceToGo) -> None:
    """Check that the footprint may get from start to goal."""
    setting = query.setting
    if reached(to_go, setting):
        return
    check_way(query)
    back = setting._replace(
        start_x=setting.goal_x, start_y=setting.goal_y, start_yaw=setting.goal_yaw,
        goal_x=setting.start_x, goal_y=setting.start_y, goal_yaw=setting.start_yaw,
    )  # fmt: skip
    away = distance_to_go(back)
    homes = away.places.home[np.isfinite(away.distance)]
    raise _none(query, away.places, homes, CANNOT, certainty="proven")


def check_closer(query: CompiledProblem, setting: KernelProblem, closed: Closure) -> None:
    """Check that looking closer left a way from start to goal."""
    if len(closed.reached) == 0:
        return
    places = places_for(setting, enlarged=True)
    if closed.proven:
        raise _none(query, places, closed.reached, CANNOT, certainty="proven")
    why = (
        f"none leads over poses {1e3 * closed.resolution:.2g} mm apart, though one might through a "
        "gap that leaves less room than that (finer cells of the map, or a smaller clearance, may "
        "show one)"
    )
    raise _none(query, places, closed.reached, why, resolution=closed.resolution)


def _none(
    query: CompiledProblem, places: Places, homes: NDArray[np.integer], why: str, **verdict: Any
) -> NoPathError:
    """Return the error that names the nearest to the goal of some places."""
    row, column = np.divmod(homes, places.columns + 2 * RIM)
    cells = np.column_stack([column, row]) - RIM + 0.5
    place = query.grid.to_world(cells * places.spacing / query.grid.resolution)
    end = np.array(query.problem.goal[:2])
    x, y = place[np.argmin(np.hypot(*(place - end).T))].tolist()
    return NoPathError(_told(query, why, (x, y)), **verdict)


def none_found(query: CompiledProblem, cell: float, near: tuple[float, float]) -> NoPathError:
    """Return the error that says that none was found at a resolution, or that there is none."""
    try:
        check_way(query)
    except NoPathError as proven:
        return proven
    why = (
        f"none was found in cells of {cell:.3g} m, though a finer search might find one (the "
        "lattice planner's option finest halves them)"
    )
    return NoPathError(_told(query, why, near), resolution=cell)


def none_in_time(
    query: CompiledProblem, budget: Budget, done: str, near: list[tuple[float, float]]
) -> TimeLimitError:
    """Return the error that says that none was found before a budget was over."""
    goal = query.problem.goal
    left, x, y = min((hypot(goal.x - x, goal.y - y), x, y) for x, y in near)
    return TimeLimitError(
        f"no path was found in {budget.name}: {done}; the place nearest to the goal that was "
        f"reached is ({x:.2f}, {y:.2f}), {left:.2f} m from it; give more {budget.remedy}"
    )


def _told(query: CompiledProblem, why: str, near: tuple[float, float]) -> str:
    start, goal = query.problem.start, query.problem.goal
    left = float(np.hypot(goal.x - near[0], goal.y - near[1]))
    return (
        f"no path leads from ({start.x:.2f}, {start.y:.2f}) to ({goal.x:.2f}, {goal.y:.2f}): "
        f"{why}; the nearest place to the goal that was reached is ({near[0]:.2f}, {near[1]:.2f}), "
        f"{left:.2f} m from it; check the map for closed doors and unknown cells"
    )
