"""Lower bounds on the cost of any motion: true infima over its direction.

A table is linear between its directions and lies above a model that bends between them. What no
motion may cost less than is therefore searched on the model itself.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from energyplan.cost.direction_table import SPECIAL, octant_directions, scan_ratios
from energyplan.path import ROUNDING, FloatArray
from energyplan.vehicle import TreadICR

SLACK = 1e-6
"""Part by which a rate is reported lower than the least value that the search for it met."""


class DirectionSearch(NamedTuple):
    """The search for the least value of directions."""

    # part by which a price may be off by rounding, where differences are taken
    difference: float = 1e-13
    basins: int = 8  # local minima of the scan that are followed
    zooms: int = 7  # rounds in which a minimum is enclosed
    cuts: int = 9  # places tried in each of them
    places: int = 48  # places of an interval that are scanned
    dips: int = 3  # minima of them that are followed
    winding: float = 0.1  # turn of a typical path, for each half slip track of its length [rad]
    # the most that a typical path turns, for each least radius of its length [rad]
    arcs: float = 0.5


_SEARCH = DirectionSearch()


_Value = Callable[[FloatArray, FloatArray, FloatArray], FloatArray]
"""A value of directions ``(x, y)`` and their prices."""


@dataclass(frozen=True)
class LowerBound:
    """Coefficients of a lower bound on the energy of any motion."""

    per_metre: float  # least energy per metre that a body point travels [J/m]
    per_radian: float  # least energy per radian of turning, on top of it [J/rad]

    def energy(self, length: ArrayLike, turn: ArrayLike) -> FloatArray:
        """Return the bound [J] for a length travelled [m] and a turn [rad]."""
        return np.asarray(
            self.per_metre * np.abs(np.asarray(length, float))
            + self.per_radian * np.abs(np.asarray(turn, float))
        )


def least_between(
    value: Callable[[FloatArray], FloatArray], low: float, high: float, shape: tuple[int, ...]
) -> FloatArray:
    """Return the least values of functions on an interval, found like an `Infimum`.

    `value` takes places of shape (n, ...), where (...) is `shape`, and returns as many values.
    """
    wide = (-1, *[1] * len(shape))
    at = np.linspace(low, high, _SEARCH.places + 1)
    scanned = value(np.broadcast_to(at.reshape(wide), (len(at), *shape)))
    best = scanned.min(axis=0)
    beside = np.full((1, *shape), np.inf)
    lowest = (scanned <= np.concatenate([beside, scanned[:-1]])) & (
        scanned <= np.concatenate([scanned[1:], beside])
    )
    place = np.argsort(np.where(lowest, scanned, np.inf), axis=0, kind="stable")[: _SEARCH.dips]
    begin, end = at[np.maximum(place - 1, 0)], at[np.minimum(place + 1, _SEARCH.places)]
    part = (np.arange(1, _SEARCH.cuts + 1) / (_SEARCH.cuts + 1)).reshape(-1, *[1] * place.ndim)
    for _ in range(_SEARCH.zooms):
        cuts = begin + (end - begin) * part
        found = value(cuts.reshape(-1, *shape)).reshape(cuts.shape)
        best = np.minimum(best, found.min(axis=(0, 1)))
        k = found.argmin(axis=0)[None]
        edges = np.concatenate([begin[None], cuts, end[None]])
        begin, end = (np.take_along_axis(edges, k + side, axis=0)[0] for side in (0, 2))
    return np.asarray(best)


@dataclass(frozen=True)
class Infimum:
    """Least values over all directions of motion, searched on the model itself.

    Directions ``(x, y) = (ds, C dtheta)`` lie on the square ``max(|x|, |y|) = 1``. They are
    scanned, the more closely the nearer to straight motion, spin and pivot, and the lowest places
    of the scan are enclosed ever more tightly. So a value is found up to `SLACK` unless it hides in
    a dip that is narrower than the intervals of the scan and lies away from all others.
    """

    price: Callable[[FloatArray, FloatArray], FloatArray]
    even: int = 64  # intervals of each octant that are scanned
    around: tuple[float, ...] = ()

    @cached_property
    def _scan(self) -> FloatArray:
        """Ratios of the scan, shape (m,)."""
        near = np.concatenate([[0.0], np.geomspace(1e-7, 0.5 / self.even, 20)])
        places = [scan_ratios(self.even)]
        for value in np.abs(self.around):
            ratio = float(value if value <= 1.0 else 1.0 / value)
            places += [ratio - near, ratio + near]
        scan = np.unique(np.concatenate(places))
        return scan[(scan >= 0.0) & (scan <= 1.0)]

    @cached_property
    def _scanned(self) -> FloatArray:
        """Prices of the scan, shape (..., 8, m)."""
        x, y = octant_directions(self._scan)
        values = np.asarray(self.price(x.ravel(), y.ravel()))
        return values.reshape(*values.shape[:-1], *x.shape)

    @cached_property
    def special(self) -> FloatArray:
        """Prices of straight motion, spins and pivots as ordered in `SPECIAL`, shape (..., 8)."""
        return np.asarray(self.price(SPECIAL[:, 0], SPECIAL[:, 1]))

    @cached_property
    def slack(self) -> float:
        """Part by which a rate is lowered: none where prices are linear within the octants."""
        inner, ratio = self._scanned[..., 1:-1], self._scan[1:-1]
        part = (ratio - ratio[0]) / (ratio[-1] - ratio[0])
        line = inner[..., :1] * (1.0 - part) + inner[..., -1:] * part
        return 0.0 if np.all(np.abs(line - inner) <= 1e-12 * np.abs(inner)) else SLACK

    def lowered(self, rate: float) -> float:
        """Return a rate less the part that the search for it may have missed."""
        return rate - self.slack * abs(rate)

    def least(self, value: _Value) -> float:
        """Return the least value over all directions and surfaces."""

        def lowest(octant: FloatArray, ratio: FloatArray) -> FloatArray:
            x, y = (
                part[octant.ravel().astype(int), np.arange(ratio.size)]
                for part in octant_directions(ratio.ravel())
            )
            found = value(x, y, np.asarray(self.price(x, y)))
            return np.asarray(found.reshape(-1, x.size).min(axis=0)).reshape(ratio.shape)

        x, y = octant_directions(self._scan)
        scanned = value(x, y, self._scanned)
        scanned = scanned.reshape(-1, *x.shape).min(axis=0)
        best = float(scanned.min())
        if self.slack == 0.0:
            return best  # rates of linear prices are least at the ends of an octant
        left = np.column_stack([np.full(8, np.inf), scanned[:, :-1]])
        right = np.column_stack([scanned[:, 1:], np.full(8, np.inf)])
        octant, place = np.nonzero(np.isfinite(scanned) & (scanned <= left) & (scanned <= right))
        order = np.argsort(scanned[octant, place], kind="stable")[: _SEARCH.basins]
        octant, place = octant[order], place[order]
        low = self._scan[np.maximum(place - 1, 0)]
        high = self._scan[np.minimum(place + 1, len(self._scan) - 1)]
        cuts = np.arange(1, _SEARCH.cuts + 1) / (_SEARCH.cuts + 1)
        for _ in range(_SEARCH.zooms):
            ratio = low[:, None] + (high - low)[:, None] * cuts
            found = lowest(np.broadcast_to(octant[:, None], ratio.shape), ratio)
            best = min(best, float(found.min()))
            k = found.argmin(axis=1)
            rows = np.arange(len(k))
            edges = np.column_stack([low, ratio, high])
            low, high = edges[rows, k], edges[rows, k + 2]
        return best

    def rates(self, half_track: float, track: float = 0.0, radius: float = 0.0) -> LowerBound:
        """Return rates: no price is below ``metre max(|ds|, track |dtheta|) + radian |dtheta|``.

        Of such rates they are the best for a typical path, whose arcs have this `radius` at least.
        """

        def travel(x: FloatArray, y: FloatArray) -> FloatArray:
            return np.maximum(np.abs(x), track / half_track * np.abs(y))

        # A path that turned all the way on the tightest arcs would favour no metre over a radian:
        # any split of such an arc's price gives the same bound, even one that leaves metres free
        widest = max(track, radius)
        winding = min(_SEARCH.winding / half_track, _SEARCH.arcs / widest if widest > 0 else np.inf)
        metre = self._balanced(travel, half_track, winding)
        radian = self.least(beyond(metre, travel, half_track))
        if radian < 0:
            metre, radian = min(metre, self.least(per_metre(travel))), 0.0
        return LowerBound(self.lowered(metre), self.lowered(radian))

    def _balanced(
        self,
        travel: Callable[[FloatArray, FloatArray], FloatArray],
        half_track: float,
        winding: float,
    ) -> float:
        """Return the price of a metre which, with that of a radian, is best for a typical path.

        Such a path turns by `winding` for each metre that it travels [rad/m].
        """
        x, y = octant_directions(self._scan)
        way, turn = travel(x, y), np.abs(y) / half_track
        lowest = self._scanned.reshape(-1, *x.shape).min(axis=0)
        turns = turn > 0
        price, way, turn = lowest[turns], way[turns], turn[turns]

        def value(metre: float) -> float:
            radian = float(((price * (1.0 + _SEARCH.difference) - metre * way) / turn).min())
            return metre + winding * radian if radian >= 0 else -np.inf

        # the price of a radian is concave in that of a metre, and so is their sum
        low, high = 0.0, float(self.special[..., :2].min())
        straight = high
        for _ in range(60):
            third = (high - low) / 3.0
            if value(low + third) < value(high - third) > -np.inf:
                low += third
            else:
                high -= third
        found = 0.5 * (low + high)
        return straight if value(straight) >= value(found) * (1.0 - ROUNDING) else found


def per_metre(travel: Callable[[FloatArray, FloatArray], FloatArray]) -> _Value:
    """Return what a motion costs for each metre that it travels."""

    def value(x: FloatArray, y: FloatArray, price: FloatArray) -> FloatArray:
        way = travel(x, y)
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(way > 0, price / way, np.inf)

    return value


def beyond(
    metre: float, travel: Callable[[FloatArray, FloatArray], FloatArray], half_track: float
) -> _Value:
    """Return what a motion costs for each radian, beyond a price of the metres that it travels."""

    def value(x: FloatArray, y: FloatArray, price: FloatArray) -> FloatArray:
        turn = np.abs(y) / half_track
        with np.errstate(divide="ignore", invalid="ignore"):
            rest = (price * (1.0 + _SEARCH.difference) - metre * travel(x, y)) / turn
        return np.where(turn > 0, rest, np.inf)

    return value


def lower_bound(
    price: Callable[[FloatArray, FloatArray], FloatArray], icr: TreadICR, point: tuple[float, float]
) -> LowerBound:
    """Return the coefficients for the path of a body point."""
    lx, ly = icr.centre

    def travel(x: FloatArray, y: FloatArray) -> FloatArray:
        turn = y / icr.half_track
        return np.hypot(x - (point[1] - ly) * turn, (point[0] - lx) * turn)

    infimum = Infimum(price, around=(ly / icr.half_track,))
    metre = infimum.lowered(infimum.least(per_metre(travel)))
    radian = infimum.least(beyond(metre, travel, icr.half_track))
    return LowerBound(metre, max(infimum.lowered(radian), 0.0))
