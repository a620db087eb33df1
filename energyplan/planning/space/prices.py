"""What the objective makes of motions, and what they cost at least: rates for bounds and guides.

Energy, length and time are weighed, on every ground and slope of a problem.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any, NamedTuple, TypeVar, cast
from weakref import WeakKeyDictionary, ref

import numpy as np
from numpy.typing import ArrayLike, NDArray

from energyplan.cost import EnergyCost
from energyplan.cost.bounds import Infimum, per_metre
from energyplan.errors import InvalidInputError, MapError, ModelError
from energyplan.path import FloatArray
from energyplan.planning.problem import objective_weights
from energyplan.planning.settings import SLOPES
from energyplan.power.effects import reads_slope
from energyplan.terrain import HeightMap, OccupancyGrid, SurfaceMap
from energyplan.terrain.grid import from_raster
from energyplan.terrain.surfaces import NOT_SLOW, SlowAreas

Value = TypeVar("Value")

BINS = 65  # slopes in the price tables of the kernels; odd, so that level ground is one of them
HEADINGS = 128  # headings in the price tables where prices depend on them
SLOPING_HEADINGS = 32  # and where slopes matter too
_TURN_PARTS = 64  # parts of a turn that are priced at the heading in their middle


FLAT = 1e-9  # slopes below this are none


_remembered: WeakKeyDictionary[Any, dict[Hashable, tuple[Callable[[], Any], Any]]]
_remembered = WeakKeyDictionary()


def remembered(owner: Any, part: Any, key: Hashable, make: Callable[[], Value]) -> Value:
    """Return what is computed once for an owner, one part that it is used with, and a key."""
    kept = _remembered.setdefault(owner, {})
    known = kept.get((id(part), key))
    if known is None or known[0]() is not part:
        if len(kept) >= SLOPES.remembered:
            kept.clear()
        known = ref(part) if part is not None else lambda: None, make()
        kept[id(part), key] = known
    return cast("Value", known[1])


def steepest(grid: OccupancyGrid, heights: HeightMap, radius: float) -> float:
    """Return the steepest slope that the robot can be on, as rise over run."""
    key = "steepest", radius
    return remembered(grid, heights, key, lambda: _steepest(grid, heights, radius))


def _steepest(grid: OccupancyGrid, heights: HeightMap, radius: float) -> float:
    from scipy.ndimage import maximum_filter  # slow to import, and rarely needed

    cells = radius / grid.resolution
    # the clearance is that of a cell's centre, off by 0.71 cells from that of a point in it
    may_be = grid.clearance > max(radius - grid.resolution, 0.0)
    if not may_be.any():
        return 0.0
    _check_covered(grid, heights, may_be, cells)
    patch = heights.resolution / grid.resolution
    reach = int(np.ceil(0.71 * patch + 1.0))
    near = maximum_filter(may_be.view(np.uint8), size=2 * reach + 1, mode="constant")
    nodes = heights.heights.shape
    i, j = np.indices((nodes[0] - 1, nodes[1] - 1))
    middle = np.stack([j + 0.5, i + 0.5], axis=-1)
    place = grid.to_cells(from_raster(middle, heights.origin, heights.resolution))
    rows, columns = grid.shape
    beyond = np.any((place < -reach) | (place > np.array([columns, rows]) + reach), axis=-1)
    column = np.clip(place[..., 0].astype(int), 0, columns - 1)
    row = np.clip(place[..., 1].astype(int), 0, rows - 1)
    relevant = (near[row, column] > 0) & ~beyond
    h = heights.heights
    # the gradient of a bilinear patch is greatest in one of its corners
    along = np.maximum(np.abs(np.diff(h, axis=1))[:-1], np.abs(np.diff(h, axis=1))[1:])
    across = np.maximum(np.abs(np.diff(h, axis=0))[:, :-1], np.abs(np.diff(h, axis=0))[:, 1:])
    steep = np.hypot(along, across)[relevant]
    return float(steep.max(initial=0.0)) / heights.resolution


def _check_covered(
    grid: OccupancyGrid, heights: HeightMap, may_be: NDArray[np.bool_], cells: float
) -> None:
    """Check that the rectangle in which the robot can be lies on the raster."""
    ends = []
    for axis in (1, 0):
        used = np.flatnonzero(may_be.any(axis=1 - axis))
        last = may_be.shape[axis]
        ends.append((max(float(used[0]), cells), min(float(used[-1] + 1), last - cells)))
    (x0, x1), (y0, y1) = ends
    corners = grid.to_world([(x0, y0), (x1, y0), (x1, y1), (x0, y1)])
    for corner in corners:
        try:
            heights.height(corner)
        except MapError as error:
            raise MapError(f"the heights do not cover the map: {error}") from None


def check_models(costs: tuple[EnergyCost, ...], surfaces: SurfaceMap | None) -> None:
    """Check that every power model knows what a slope is."""
    names = [
        "the ground",
        *(f"surface {s.name!r}" for s in (surfaces.surfaces if surfaces else ())),
    ]
    for name, cost in zip(names, costs[: len(names)], strict=True):
        if not reads_slope(cost.model):
            raise InvalidInputError(
                f"heights are given, but no term of the model {cost.model.name!r} of {name} reads "
                "the slope; add the weight with energyplan.power.effects.with_weight(model), or in "
                f"its file as the term grade with the coefficient {cost.vehicle.mass:.4g} kg"
            )


class SlopeTable(NamedTuple):
    """Prices less the potential energy; the rows are classes of surface and slopes."""

    kept: FloatArray  # (classes * headings * BINS, rays): what the kernels interpolate
    height_price: float  # the price of height that was taken off


def priced(
    objective: Prices, ds: FloatArray, dtheta: FloatArray, travel: FloatArray, steepest: float,
    yaws: FloatArray | None = None,
) -> SlopeTable:  # fmt: skip
    """Return the prices of motions on slopes up to the steepest, at headings where they matter."""
    key = "priced", steepest, tuple(sorted(objective_weights(objective.objective).items()))
    make = partial(_priced, objective, ds, dtheta, travel, steepest, yaws)
    return remembered(objective.cost, objective.surfaces, key, make)


def _priced(
    objective: Prices, ds: FloatArray, dtheta: FloatArray, travel: FloatArray, steepest: float,
    yaws: FloatArray | None,
) -> SlopeTable:  # fmt: skip
    steep = np.linspace(-steepest, steepest, (BINS - 1) * SLOPES.finer + 1)[:, None]
    rows = [
        objective.motion(ds, dtheta, k, steep, yaw=yaw)
        for k in range(len(objective.costs))
        for yaw in ([None] if yaws is None else yaws[:, 0])
    ]
    fine = np.array(rows)
    rise = np.broadcast_to(steep * ds, fine.shape)
    height_price = potential(fine, np.broadcast_to(travel, fine.shape), rise)
    fine = fine - height_price * rise
    kept = np.ascontiguousarray(fine[:, :: SLOPES.finer])
    return SlopeTable(kept.reshape(-1, len(ds)), height_price)


def potential(prices: FloatArray, travel: FloatArray, rise: FloatArray) -> float:
    """Return the price of height that leaves motions the highest price per metre.

    Among all ``p``, the one with the greatest ``t`` such that ``prices - p rise >= t travel``: a
    linear programme in two variables. The lower envelope of the lines ``(prices - p rise)/travel``
    over ``p`` is concave; two lines that enclose its top are replaced by better ones until they
    meet on it.
    """
    moves = travel > FLAT
    level, fall = (prices[moves] / travel[moves], -rise[moves] / travel[moves])
    descent, climb = int(np.argmax(fall)), int(np.argmin(fall))
    if fall[descent] <= FLAT or fall[climb] >= -FLAT:
        return 0.0
    rounding = 1e-12 * float(np.abs(level).max())
    while True:
        found = (level[climb] - level[descent]) / (fall[descent] - fall[climb])
        values = level + found * fall
        k = int(np.argmin(values))
        if values[k] >= values[climb] - rounding or abs(fall[k]) <= FLAT:
            break
        descent, climb = (k, climb) if fall[k] > 0 else (descent, k)
    if values[k] <= rounding:
        raise ModelError(
            f"climbing {_degrees(-fall[climb]):.1f} deg and descending "
            f"{_degrees(fall[descent]):.1f} deg again returns as much as it takes or more, so that "
            "a robot could drive for ever; check the efficiencies, and that the models of all "
            "surfaces hold the same weight"
        )
    return float(found)


def _degrees(steep: float) -> float:
    return float(np.degrees(np.arctan(steep)))


TIE_BREAK = 0.01  # weight of the energy, as metres of straight driving, in the length objective


@dataclass(frozen=True, eq=False)
class Prices:
    """Prices of motions of `Path`'s reference point."""

    cost: EnergyCost  # cost of motions
    surfaces: SurfaceMap | None = None  # regions with power models of their own
    objective: str | Mapping[str, float] = "energy"  # what to make least, as in `PlanningProblem`

    @cached_property
    def slow(self) -> SlowAreas:
        """The speed limits that change a price."""
        if self.surfaces is None or not self.surfaces.speed_limits:
            return NOT_SLOW
        regions = self.surfaces.costs(self.cost)[: len(self.surfaces.surfaces) + 1]
        timed = self._weights[2] or any(self.surfaces.seconds)
        if not timed and all(cost.same_at_any_speed for cost in regions):
            return NOT_SLOW
        return self.surfaces.slow_areas(self.cost)

    @cached_property
    def costs(self) -> tuple[EnergyCost, ...]:
        """Costs of the classes of ground; that outside all areas is the first."""
        if self.surfaces is None:
            return (self.cost,)
        count = (len(self.surfaces.surfaces) + 1) * (len(self.slow.speeds) + 1)
        return self.surfaces.costs(self.cost)[:count]

    def of_time(self, region: int) -> float:
        """Price of a second in one class of ground."""
        seconds = (0.0,) if self.surfaces is None else self.surfaces.seconds
        return self._weights[2] + seconds[region % len(seconds)]

    def class_at(self, points: ArrayLike) -> NDArray[np.intp]:
        """Return the class of ground at each world point (..., 2) [m]."""
        if self.surfaces is None:
            return np.zeros(np.shape(points)[:-1], np.intp)
        return self.surfaces.class_at(points, self.slow)

    @cached_property
    def _weights(self) -> tuple[float, float, float]:
        """Weights of energy, length and time; of one length the least energy is wanted."""
        given = objective_weights(self.objective)
        length = given.get("length", 0.0)
        tie = TIE_BREAK / float(self.cost.segment_energy(1.0, 0.0))
        return given.get("energy", 0.0) + tie * length, length, given.get("time", 0.0)

    def motion(
        self,
        ds: ArrayLike,
        dtheta: ArrayLike,
        region: int = 0,
        steep: ArrayLike | None = None,
        *,
        exact: bool = False,
        yaw: ArrayLike | None = None,
    ) -> FloatArray:
        """Return the price of arcs within one class of ground.

        Where it depends on the heading and none is given, it is a lower bound.
        """
        cost = self.costs[region]
        energy, length, _ = self._weights
        time = self.of_time(region)
        slope: ArrayLike | None = 0.0 if exact else None
        along = np.asarray(ds, float)
        if steep is not None:
            slope, along = np.arctan(steep), along * np.hypot(1.0, steep)
        total = energy * cost.segment_energy(along, dtheta, slope, exact=exact, yaw=yaw)
        total = total + length * np.abs(ds)
        if time:  # else a vehicle needs no speed limit
            total = total + time * cost.segment_duration(along, dtheta, exact=exact)
        return np.asarray(total)

    def turning(
        self, ds: ArrayLike, dtheta: ArrayLike, region: int = 0, yaw: ArrayLike = 0.0
    ) -> FloatArray:
        """Return the price of arcs within one class of ground that begin at a heading [rad]."""
        if not self.costs[region].of_heading:
            return self.motion(ds, dtheta, region)
        parts = (np.arange(_TURN_PARTS) + 0.5) / _TURN_PARTS
        every = [
            self.motion(ds, dtheta, region, yaw=yaw + part * np.asarray(dtheta)) for part in parts
        ]
        return np.asarray(np.mean(every, axis=0))

    def floor(self, ds: ArrayLike, dtheta: ArrayLike, region: int, steep: ArrayLike) -> FloatArray:
        """Return what arcs on slopes cost at least; arguments as for `motion`.

        Where time is weighed otherwise than the cheapest speed weighs it, durations may jump from
        one direction to the next, so that the fastest admissible speed is used instead.
        """
        cost = self.costs[region]
        energy, length, _ = self._weights
        time = self.of_time(region)
        if time <= energy * cost.time_value * (1.0 + 1e-9):
            return self.motion(ds, dtheta, region, steep)
        along = np.asarray(ds, float) * np.hypot(1.0, steep)
        total = energy * cost.segment_energy(along, dtheta, np.arctan(steep), exact=False)
        least = cost.segment_duration(along, dtheta, fastest=True)
        return np.asarray(total + length * np.abs(ds) + time * least)

    def value(self, energy: float, length: float, duration: float) -> float:
        """Return the price of a whole path, given its energy [J], length [m] and duration [s].

        What seconds on priced ground add comes on top.
        """
        weights = self._weights
        timed = weights[2] * duration if weights[2] else 0.0
        return weights[0] * energy + weights[1] * length + timed


class Minorant(NamedTuple):
    """No motion costs less than ``metre max(|ds|, track |dtheta|) + radian |dtheta|``."""

    metre: float
    radian: float
    track: float


class _Kept(NamedTuple):
    """What is kept of infima: minorants by track, prices of a metre by ground and radian."""

    minorants: dict[float, Minorant]
    metres: dict[tuple[int, float], float]


@dataclass(frozen=True, eq=False)
class LeastPrices:
    """Infima of the prices of motions of the centre that the kernels follow."""

    objective: Prices  # what the objective makes of motions
    steepest: float  # steepest slope, as rise over run
    height_price: float  # price of height, which is taken off [J/m for energy]
    lateral: float  # how far to the left of the path's reference point the centre lies [m]
    radius: float  # of the tightest arcs; back and forth on these replaces tighter turns [m]
    _kept: _Kept

    def price(
        self, x: FloatArray, y: FloatArray, regions: Iterable[int] | None = None,
        yaw: ArrayLike | None = None,
    ) -> FloatArray:  # fmt: skip
        """Return the price on each ground, at its cheapest slope, and heading unless one is given.

        A heading holds on level ground alone.
        """
        turn = y / self.objective.cost.half_track
        regions = range(len(self.objective.costs)) if regions is None else regions
        ahead = np.maximum(np.abs(x), self.radius * np.abs(turn))
        ds = np.where(x < 0.0, -ahead, ahead) + self.lateral * turn
        return np.array([self._cheapest(k, ds, turn, yaw) for k in regions])

    def _cheapest(
        self, ground: int, ds: FloatArray, turn: FloatArray, yaw: ArrayLike | None
    ) -> FloatArray:
        if not self.steepest > 0:
            return self.objective.motion(ds, turn, ground, exact=True, yaw=yaw)

        def sloping(steep: FloatArray) -> FloatArray:
            price = self.objective.floor(ds, turn, ground, steep)
            return np.asarray(price - self.height_price * steep * ds)

        steep = np.linspace(-self.steepest, self.steepest, SLOPES.slopes)[:, None]
        values = sloping(steep)
        best = values.min(axis=0)
        k = values.argmin(axis=0)
        low, high = steep[np.maximum(k - 1, 0), 0], steep[np.minimum(k + 1, SLOPES.slopes - 1), 0]
        cuts = np.arange(1, SLOPES.cuts + 1)[:, None] / (SLOPES.cuts + 1)
        for _ in range(SLOPES.zooms):
            tried = low + (high - low) * cuts
            values = sloping(tried)
            best = np.minimum(best, values.min(axis=0))
            edges = np.vstack([low, tried, high])
            k, column = values.argmin(axis=0), np.arange(len(ds))
            low, high = edges[k, column], edges[k + 2, column]
        return np.asarray(best)

    @cached_property
    def _infimum(self) -> Infimum:
        return Infimum(self.price, 64 if self.steepest == 0 else 32, self._special)

    @cached_property
    def _special(self) -> tuple[float, ...]:
        """Travel over turn times the half slip track where some ground's model may jump."""
        about = [0.0]  # to the left of the reference point: what does not move
        for cost in self.objective.costs:
            lateral = cost.icr.centre[1]
            about += [lateral, lateral - cost.half_track, lateral + cost.half_track]
        half_track = self.objective.cost.half_track
        if self.radius > 0:
            about += [self.lateral - self.radius, self.lateral + self.radius]
        return tuple((point - self.lateral) / half_track for point in about)

    def minorant(self, track: float) -> Minorant:
        """Return the greatest minorant with this `track` [m] below all prices."""
        known = self._kept.minorants
        if track not in known:
            found = self._infimum.rates(self.objective.cost.half_track, track, self.radius)
            known[track] = Minorant(found.per_metre, found.per_radian, track)
        return known[track]

    def metre_excess(self) -> FloatArray:
        """Return by how much a metre on each ground exceeds one on the cheapest, at least."""
        least = self.minorant(0.0)
        return np.maximum(self.metre_prices(least.radian) - least.metre, 0.0)

    def metre_prices(self, radian: float) -> FloatArray:
        """Return the least price of a metre on each ground, beyond that of the radians turned."""
        half_track, known = self.objective.cost.half_track, self._kept.metres
        grounds = range(len(self.objective.costs))
        for ground in [k for k in grounds if (k, radian) not in known]:

            def price(x: FloatArray, y: FloatArray, ground: int = ground) -> FloatArray:
                turning = radian / half_track * np.abs(y)
                return np.asarray(self.price(x, y, (ground,))[0] - turning)

            infimum = Infimum(price, self._infimum.even, self._special)
            metre = infimum.lowered(infimum.least(per_metre(lambda x, y: np.abs(x))))
            known[ground, radian] = metre
        return np.array([known[ground, radian] for ground in grounds])


def least_prices(
    objective: Prices,
    steepest: float = 0.0,
    height_price: float = 0.0,
    lateral: float | None = None,
    radius: float = 0.0,
) -> LeastPrices:
    """Return the infima of prices; what they come to is remembered with the cost."""
    centre = objective.cost.icr.centre[1] if lateral is None else lateral
    weights = tuple(sorted(objective_weights(objective.objective).items()))
    key = "least", steepest, height_price, centre, radius, weights
    known = remembered(objective.cost, objective.surfaces, key, lambda: _Kept({}, {}))
    return LeastPrices(objective, steepest, height_price, centre, radius, known)
