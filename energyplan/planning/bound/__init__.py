"""What no path can cost less than.

Two bounds hold for every path, and the greater one is used (docs/theory, section 5): the least cost
without obstacles, which steering knows exactly, and the least cost of a disc inside the footprint
that pays for metres and radians separately. A search over the corners of the obstacles finds the
second; docs/planner.md derives why it is a bound.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from functools import partial
from math import asin, hypot, pi, remainder
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from energyplan.compilation import FloatTable, processors
from energyplan.planning.bound.corners import DiscEnds, least_over_corners, ways_to_goal
from energyplan.planning.bound.headings import EUCLIDEAN, heading_forces, least_of_sweeps
from energyplan.planning.bound.line import Rates
from energyplan.planning.bound.outline import DETAILS, Outline, Sights, sights
from energyplan.planning.bound.surfaces import certain_regions, least_excess, least_of_metres
from energyplan.planning.budget import SHARES, UNITS, Budget, Work
from energyplan.planning.settings import BOUND
from energyplan.planning.space.compiled import MARGIN, SHORT_TRACK, CompiledProblem
from energyplan.planning.space.configurations import grown
from energyplan.planning.space.motions import KernelProblem, free_energy
from energyplan.steering.forwards import forward_energies
from energyplan.steering.kernels import steer_energies
from energyplan.terrain import OccupancyGrid

EFFORT = 5e7
"""Steps of the searches over corners after which the bound known is returned: below 0.1 s."""


_FIRST = 64  # intervals of headings to begin with
_HALVINGS = 14  # of these intervals, at most
_ALIKE = 1e-6  # part of the least cost that the bound over all headings may lie below it

Spent = dict[Sights, NDArray[np.bool_]]
"""The corners of outlines whose lines are paid for with effort already."""


class Bound(NamedTuple):
    """What a path costs at least, and whether more effort or a better path cannot raise it."""

    value: float
    final: bool
    steps: float = 0.0  # of the searches over corners


class Disc(NamedTuple):
    """Where a path may end: within a disc about the goal's place, in which nothing is in the way.

    The disc of the bound has to be free in all of it, or no path about obstacles leads on to its
    middle.
    """

    around: float = 0.0  # its radius [m]
    any_heading: bool = False
    free: float | None = None  # least cost without obstacles, if that is known
    radius: float | None = None  # of the disc in the footprint, where a smaller one is wanted [m]


POSE = Disc()
"""The goal itself."""


def lower_bound(
    query: CompiledProblem,
    cost: float,
    effort: float = EFFORT,
    spent: Spent | None = None,
    target: Disc = POSE,
) -> Bound:
    """Return a lower bound on the cost of every path from the start to the goal, or near it."""
    setting = query.setting
    free = target.free
    if free is None:
        free = least_without_obstacles(setting, target)
    radius = inscribed(query) if target.radius is None else target.radius
    limit = BOUND.beyond * cost
    if free >= limit or radius <= 0:
        return Bound(float(free), True)
    spent = {} if spent is None else spent
    excess = least_excess(query, radius, limit, target.around)
    forces = heading_forces(query)
    total = 0.0
    if forces is not None:
        extent = partial(_least_extent, query.grid, setting, radius, target.around)
        turn = 0.0 if target.any_heading else _turn(setting)
        total = setting.least_radian * turn
        total += extent(forces.total, limit, effort, spent)
        if target.around == 0.0:
            total = max(total, least_of_sweeps(forces.price, setting, target.any_heading))
        if total >= limit:
            return Bound(total, True)
        excess += extent(forces.excess, limit, effort, spent)
    # what expensive surfaces and headings add comes on top of the rates alone
    separate = setting if excess == 0.0 else _separate(setting)
    direct = free if excess == 0.0 else _paid_separately(setting, target)
    among, final, steps = _among_obstacles(
        query.grid, separate, radius, float(direct), limit - excess, effort, spent, target
    )
    share = 1.0 if forces is None else forces.rest
    metres = least_of_metres(query, radius, limit, target.around)
    return Bound(max(float(free), share * among + excess, metres, total), final, steps)


def least_without_obstacles(kernel: KernelProblem, target: Disc = POSE) -> float:
    """Return a lower bound of the least cost without obstacles to a goal, or to a disc about it.

    A path to a point of the disc, turned on the spot at its ends and with each of its metres
    stretched alike, leads to the middle: that costs as much more at most.
    """
    dx, dy = kernel.goal.x - kernel.start.x, kernel.goal.y - kernel.start.y
    away, around = hypot(dx, dy), target.around
    turn = 0.0 if target.any_heading else _turn(kernel)
    if away <= around:
        return kernel.steering.per_radian * turn
    if target.any_heading:
        middle = least_at_any_heading(kernel)
    else:
        middle = float(free_energy(kernel, kernel.start))
    if around == 0.0:
        return middle
    about = (1.0 if target.any_heading else 2.0) * asin(around / away)
    less = (middle - kernel.steering.per_radian * about) * (1.0 - around / away)
    return max(less, kernel.least_metre * (away - around) + kernel.least_radian * turn)


def least_at_any_heading(kernel: KernelProblem) -> float:
    """Return a lower bound of the least cost without obstacles to the goal's place at any heading.

    Turning on the spot costs `per_radian` a radian, so the least cost changes by no more than that
    from one heading to the next. Intervals of headings are halved until what one may lie below the
    least cost found is negligible.
    """
    solve = steer_energies if kernel.gear == 0 else forward_energies
    half = pi / _FIRST
    middle = np.arange(_FIRST) * 2.0 * half
    best, lowest = np.inf, 0.0
    for _ in range(_HALVINGS):
        goals = np.empty((len(middle), 3))
        goals[:] = kernel.goal
        goals[:, 2] = middle
        starts = np.empty_like(goals)
        starts[:] = kernel.start
        cost = np.empty(len(middle))
        solve(starts, goals, kernel.steering, cost)
        best = min(best, float(cost.min()))
        least = cost - kernel.steering.per_radian * half
        left = least < best * (1.0 - _ALIKE)
        lowest = min(best * (1.0 - _ALIKE), float(least.min()))
        if not left.any():
            break
        half *= 0.5
        middle = np.concatenate([middle[left] - half, middle[left] + half])
    return max(lowest, 0.0)


def prepare_bound(query: CompiledProblem) -> None:
    """Make what the bound needs of a map and keeps with it: surfaces by cell, and outlines."""
    setting, grid = query.setting, query.grid
    radius = inscribed(query)
    if radius <= 0:
        return
    surfaces = query.problem.surfaces
    if surfaces is not None:
        certain_regions(query, surfaces)
    ends = DiscEnds(*setting.start[:2], *setting.goal[:2])
    straight = hypot(ends.goal_x - ends.start_x, ends.goal_y - ends.start_y)
    coarsest = sights(grid, radius, DETAILS[-1]).outline
    finest = _finest(coarsest, ends, BOUND.detours[0] * straight)
    last = _finest(coarsest, ends, BOUND.detours[1] * straight)
    with ThreadPoolExecutor(processors()) as pool:
        list(pool.map(partial(sights, grid, radius), DETAILS[finest : last + 1]))


def inscribed(query: CompiledProblem) -> float:
    """Radius of the largest disc in the footprint about the centre of the tread ICRs [m]."""
    body = query.setting.body
    within = min(-body.x_min, body.x_max, -body.y_min, body.y_max)
    return max(within, 0.0) - MARGIN * query.grid.resolution


def _paid_separately(kernel: KernelProblem, target: Disc) -> float:
    """Return the least cost without obstacles where metres and radians are paid separately."""
    metre, radian = kernel.least_metre, kernel.least_radian
    if radian <= metre * SHORT_TRACK:
        away = hypot(kernel.goal.x - kernel.start.x, kernel.goal.y - kernel.start.y)
        return metre * max(away - target.around, 0.0)
    return least_without_obstacles(_separate(kernel), target)


def _separate(kernel: KernelProblem) -> KernelProblem:
    """Return the problem with metres and radians paid separately in steering too."""
    metre, radian = kernel.least_metre, kernel.least_radian
    steering = kernel.steering._replace(half_track=SHORT_TRACK, per_metre=metre, per_radian=radian)
    return kernel._replace(steering=steering)


def _turn(kernel: KernelProblem) -> float:
    """Return the angle between the headings at the start and at the goal [rad]."""
    return abs(remainder(kernel.goal.yaw - kernel.start.yaw, 2.0 * pi))


def _least_extent(
    grid: OccupancyGrid,
    kernel: KernelProblem,
    radius: float,
    around: float,
    forces: FloatTable,
    limit: float,
    effort: float,
    spent: Spent,
) -> float:
    """Return the least extent of all ways of a disc from start to goal, at most the limit."""
    largest = float(np.hypot(*forces.T).max())
    ends = DiscEnds(*kernel.start[:2], *kernel.goal[:2])
    found = sights(grid, radius, DETAILS[-1])
    found = sights(grid, radius, DETAILS[_finest(found.outline, ends, limit / kernel.least_metre)])
    paid = spent.setdefault(found, np.zeros(len(found.outline.point), bool))
    with found.lock:
        ways = ways_to_goal(
            kernel.space, found.outline, found.links, paid, ends, forces, limit,
            SHARES.stage * effort, around * largest,
        )  # fmt: skip
        found.links = ways.links
    return float(ways.least)


def _among_obstacles(
    grid: OccupancyGrid,
    kernel: KernelProblem,
    radius: float,
    free: float,
    cost: float,
    effort: float,
    spent: Spent,
    target: Disc,
) -> Bound:
    ends = DiscEnds(*kernel.start[:2], *kernel.goal[:2])
    turn = 0.0 if target.any_heading else _turn(kernel)
    # ways of that length cost more than the path that is known
    longest = (cost - kernel.least_radian * turn) / kernel.least_metre
    coarsest = sights(grid, radius, DETAILS[-1])
    found = sights(grid, radius, DETAILS[_finest(coarsest.outline, ends, longest)])
    true_body = grown(kernel.body, -MARGIN * grid.resolution)
    rates = Rates(
        kernel.least_metre,
        kernel.least_radian,
        kernel.start.yaw,
        kernel.goal.yaw,
        free,
        kernel.steering,
        target.any_heading,
        target.around,
    )
    paid = spent.setdefault(found, np.zeros(len(found.outline.point), bool))
    with found.lock:
        ways = ways_to_goal(
            kernel.space, found.outline, found.links, paid, ends, EUCLIDEAN, longest,
            SHARES.stage * effort, target.around,
        )  # fmt: skip
        found.links = ways.links
        steps = float(ways.steps)
        value, final = 0.0, True
        # what steering takes at the ends comes second: it takes longer than the rest
        for steer in (False, True):
            least = least_over_corners(
                kernel.space,
                true_body,
                found.outline,
                paid,
                ends,
                ways,
                rates,
                cost,
                effort - steps,
                steer,
            )
            # links that grew have moved
            found.links = least.links
            ways = ways._replace(links=found.links)
            steps += least.steps
            value, final = max(value, float(least.value)), bool(least.final)
            if value >= cost or not final:
                break
    return Bound(value, final, steps)


def _finest(coarsest: Outline, ends: DiscEnds, longest: float) -> int:
    """Return which detail is the finest that has few corners near ways of that length."""
    x, y = coarsest.point.T
    way = np.hypot(x - ends.start_x, y - ends.start_y) + np.hypot(x - ends.goal_x, y - ends.goal_y)
    near = int(np.count_nonzero(way < longest))
    for k, detail in enumerate(DETAILS[:-1]):
        # from the coarsest to this one corners grow in number as the tolerance falls, or slower
        if (DETAILS[-1].slack / detail.slack) ** 0.6 * near <= BOUND.corners:
            return k
    return len(DETAILS) - 1


class Bounding:
    """The best lower bound so far, less the potential, and how to raise it."""

    def __init__(self, query: CompiledProblem) -> None:
        self._query = query
        free = query.least_in_free_space - query.potential(query.problem.goal)
        self._bound = Bound(free, False)
        self._spent: Spent = {}

    @property
    def value(self) -> float:
        """What every path costs at least."""
        return self._bound.value

    def know(self, value: float) -> None:
        """Use a lower bound that was found elsewhere; none is searched for then."""
        self._bound = Bound(value, True)

    def work(self, cost: float, units: float) -> list[Work]:
        """Return the search for a better bound, where there can be one."""

        def run(own: Budget) -> Bound:
            given = min(units, own.left)
            found = lower_bound(self._query, cost, UNITS.steps * given, self._spent)
            if not found.final:
                own.spend(given)
            return found

        def take(found: Bound) -> None:
            self._bound = Bound(max(found.value, self.value), found.final)

        return [] if self._bound.final else [Work(run, units, take)]
