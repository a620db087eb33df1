"""What the direction of a way adds to a lower bound, where prices depend on the heading.

A robot moves along its heading, forwards or backwards, so a displacement costs at least the work
that any force does along it which no metre exceeds in price, whatever its heading. The greatest
work of all such forces is a norm; docs/planner.md derives how it measures ways about obstacles.
"""

from __future__ import annotations

from math import cos, hypot, pi, remainder
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from energyplan.compilation import FloatTable
from energyplan.cost.bounds import SLACK
from energyplan.cost.direction_table import octant_directions, scan_ratios
from energyplan.path import FloatArray
from energyplan.planning.space.compiled import CompiledProblem
from energyplan.planning.space.motions import KernelProblem
from energyplan.planning.space.prices import FLAT, remembered

EUCLIDEAN: FloatTable = np.zeros((0, 2))
"""No forces: lines are measured in metres."""

_HEADINGS = 720  # headings at which a metre is priced
_FORCES = 96  # directions whose greatest force is kept
_SWEEPS = 72  # ranges of axes in half a turn
_RATIOS = 24  # ratios of metres and radians, in each octant, that are tried first
_CUTS, _ZOOMS = 8, 4  # and then between the neighbours of the best
_REST = 1e-4  # part of the least price of a metre that is left to the forces


class HeadingForces(NamedTuple):
    """Forces that no metre's price is below at any heading, in the unit of the objective a metre.

    Both leave radians their least price.
    """

    price: FloatArray  # (n,): of a metre along the axes at ``pi k / n``, beyond that of radians
    total: FloatTable  # (m, 2): for all of the price
    excess: FloatTable  # (m, 2): for what is beyond `rest` of the least price, and of surfaces
    rest: float  # part of the least prices that remains beside `excess`


def heading_forces(query: CompiledProblem) -> HeadingForces | None:
    """Return the forces of a problem; None where the heading does not matter, and on slopes."""
    if query.yaws is None or query.steepest > FLAT:
        return None
    least = query.least_prices
    weights = tuple(sorted(query.problem.weights.items()))
    key = "forces", least.lateral, least.radius, weights
    return remembered(query.problem.cost, query.problem.surfaces, key, lambda: _forces(query))


def _forces(query: CompiledProblem) -> HeadingForces:
    metres = _metre_prices(query)
    least = query.least.metre
    beyond = metres - least - query.least_prices.metre_excess()[:, None]
    rest = 1.0 - _REST
    excess = np.maximum(beyond.min(axis=0), 0.0) + (1.0 - rest) * least
    price = np.maximum(metres.min(axis=0), least)
    return HeadingForces(price, _greatest(price), _greatest(excess), rest)


def least_of_sweeps(price: FloatArray, kernel: KernelProblem, any_heading: bool) -> float:
    """Return a lower bound of metres and radians where a path drives only at headings it has.

    Of each range of headings that holds the start's, it counts what turning through it takes, and
    the least price of the displacement along two of its axes.
    """
    n, step = _SWEEPS, pi / _SWEEPS
    dx, dy = kernel.goal.x - kernel.start.x, kernel.goal.y - kernel.start.y
    # axes of the edges between equal ranges of headings, from the start's on; each has the least
    # price of the ranges on its sides, and a heading within one is a sum of those of its edges
    axes = np.arange(len(price)) * (pi / len(price)) - kernel.start.yaw
    rise = np.abs(np.roll(price, -1) - price)
    # between two axes it may dip as far as the lines lead that come from their other sides
    price = np.maximum(price - 0.5 * np.maximum(rise, np.roll(rise, 1)), kernel.least_metre)
    least = np.full(n, np.inf)
    for near in (-1, 0, 1):
        at = ((axes + near * pi / len(price)) % pi / step).astype(int) % n
        np.minimum.at(least, at, price)
    edge = np.minimum(least, np.roll(least, 1)) * cos(0.5 * step)
    angle = kernel.start.yaw + step * np.arange(n)
    x, y = np.cos(angle), np.sin(angle)
    across = np.abs(x[:, None] * y - y[:, None] * x)
    aside = np.abs(dx * y - dy * x)
    with np.errstate(divide="ignore", invalid="ignore"):
        pair = (aside * edge[:, None] + aside[:, None] * edge) / across
    pair[across < 1e-9] = np.inf
    length = hypot(dx, dy)
    np.fill_diagonal(pair, np.where(aside <= 1e-9 * length, edge * length, np.inf))
    turn = 0.0 if any_heading else remainder(kernel.goal.yaw - kernel.start.yaw, 2.0 * pi)
    lowest = np.inf
    # up to how many edges right of the start's heading, and left of it
    for right in range(n + 1):
        held = np.arange(-right, 1) % n
        cost = float(pair[np.ix_(held, held)].min())
        for left in range(1, n + 1):
            held = np.arange(-right, left + 1) % n
            cost = min(cost, float(pair[left % n, held].min()))
            low, high = -max(right - 1, 0) * step, (left - 1) * step
            lowest = min(
                lowest, cost + kernel.least_radian * _through(low, high, turn, any_heading)
            )
    return lowest


def _through(low: float, high: float, turn: float, any_heading: bool) -> float:
    """Return the least turning from heading 0 through both ends of a range to another heading."""
    if any_heading:
        return high - low + min(high, -low)
    orders = (low, high), (high, low)
    return min(
        abs(first) + high - low + abs(turn + full - last)
        for first, last in orders
        for full in (-2.0 * pi, 0.0, 2.0 * pi)
    )


def _metre_prices(query: CompiledProblem) -> FloatArray:
    """Return the least price of a metre by ground and axis of travel, beyond that of radians.

    Axes lie at ``pi k / n``, of shape (grounds, n); a robot drives along each either way.
    """
    prices, half_track = query.least_prices, query.problem.cost.half_track
    yaw = np.arange(_HEADINGS)[:, None] * (2.0 * pi / _HEADINGS)
    scan = scan_ratios(_RATIOS)

    def rate(ground: int, octant: NDArray[np.intp], ratio: FloatArray) -> FloatArray:
        """Return the price of a metre in directions, shape (headings, n)."""
        x, y = octant_directions(ratio.ravel())
        at = octant.ravel(), np.arange(ratio.size)
        x, y = x[at].reshape(ratio.shape), y[at].reshape(ratio.shape)
        priced = prices.price(x, y, (ground,), yaw)[0]
        radians = query.least.radian / half_track * np.abs(y)
        with np.errstate(divide="ignore", invalid="ignore"):
            rates = np.where(x != 0.0, (priced - radians) / np.abs(x), np.inf)
        return np.broadcast_to(rates, (_HEADINGS, ratio.shape[1]))

    found = []
    for ground in range(len(query.costs)):
        octant, ratio = np.repeat(np.arange(8), len(scan))[None], np.tile(scan, 8)[None]
        values = rate(ground, octant, ratio)
        best, k = values.min(axis=1), values.argmin(axis=1)
        octant, place = k[:, None] // len(scan), k % len(scan)
        low, high = scan[np.maximum(place - 1, 0)], scan[np.minimum(place + 1, len(scan) - 1)]
        cuts = np.arange(_CUTS + 1) / _CUTS
        for _ in range(_ZOOMS):
            ratio = low[:, None] + (high - low)[:, None] * cuts
            values = rate(ground, np.broadcast_to(octant, ratio.shape), ratio)
            best = np.minimum(best, values.min(axis=1))
            rows, k = np.arange(_HEADINGS), values.argmin(axis=1)
            low, high = ratio[rows, np.maximum(k - 1, 0)], ratio[rows, np.minimum(k + 1, _CUTS)]
        found.append(best.reshape(2, -1).min(axis=0) * (1.0 - SLACK))
    return np.array(found)


def _greatest(price: FloatArray) -> FloatTable:
    """Return the greatest forces that do no more work a metre than its price along any axis.

    Between two axes the price is the line between them, or, in a dip, the lines that lead there.
    """
    from scipy.spatial import ConvexHull  # slow to import, and rarely needed

    count = len(price)
    step = pi / count
    before, after = np.roll(price, 1), np.roll(price, -1)
    fall, rise = price - before, np.roll(price, -2) - after
    with np.errstate(divide="ignore", invalid="ignore"):
        part = (after - rise - price) / (fall - rise)
    dip = price + fall * part
    # the lines that lead to it meet below that between the axes
    inside = (part > 0.0) & (part < 1.0) & (dip < price + part * (after - price))
    angle = np.concatenate(
        [np.arange(count) * step, (np.flatnonzero(inside) + part[inside]) * step]
    )
    price = np.concatenate([price, np.maximum(dip[inside], price.min())])
    along = np.column_stack([np.cos(angle), np.sin(angle)])
    reached = along / price[:, None]
    hull = ConvexHull(np.concatenate([reached, -reached]))
    forces = -hull.equations[:, :2] / hull.equations[:, 2:]
    wanted = np.arange(_FORCES) * (pi / _FORCES)
    works = forces @ np.array([np.cos(wanted), np.sin(wanted)])
    forces = forces[np.unique(works.argmax(axis=0))]
    within = price[:, None] / np.maximum(np.abs(along @ forces.T), 1e-300)
    return np.ascontiguousarray(forces * (cos(0.5 * step) * within.min(axis=0))[:, None])
