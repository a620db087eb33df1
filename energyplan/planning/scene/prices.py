"""What the objective makes of motions, and what they cost at least: rates for bounds and guides.

Energy, length and time are weighed, on every ground and slope of a problem.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple
from weakref import WeakKeyDictionary, ref

import numpy as np
from numpy.typing import ArrayLike

from energyplan.cost import EnergyCost
from energyplan.cost.bounds import Infimum, per_metre
from energyplan.path import FloatArray
from energyplan.planning.problem import objective_weights
from energyplan.terrain import SurfaceMap

TIE_BREAK = 0.01
"""Weight of the energy, as metres of straight driving, in the length objective."""


@dataclass(frozen=True, eq=False)
class Prices:
    """Prices of motions of `Path`'s reference point."""

    cost: EnergyCost  # cost of motions
    surfaces: SurfaceMap | None = None  # grounds with power models of their own
    objective: str | Mapping[str, float] = "energy"  # what to make least, as in `PlanningProblem`

    @cached_property
    def costs(self) -> tuple[EnergyCost, ...]:
        """Costs of the regions; that outside all surfaces is the first."""
        return (self.cost,) if self.surfaces is None else self.surfaces.costs(self.cost)

    @cached_property
    def _weights(self) -> tuple[float, float, float]:
        """Weights of energy, length and time.

        Of the routes of one length the one of least energy is wanted, so length counts energy too.
        """
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
    ) -> FloatArray:
        """Return the price of arcs within one region."""
        cost = self.costs[region]
        energy, length, time = self._weights
        slope: ArrayLike | None = 0.0 if exact else None
        along = np.asarray(ds, float)
        if steep is not None:
            slope, along = np.arctan(steep), along * np.hypot(1.0, steep)
        total = energy * cost.segment_energy(along, dtheta, slope, exact=exact)
        total = total + length * np.abs(ds)
        if time:  # without need a vehicle without a speed limit is not asked for its time
            total = total + time * cost.segment_duration(along, dtheta, exact=exact)
        return np.asarray(total)

    def floor(self, ds: ArrayLike, dtheta: ArrayLike, region: int, steep: ArrayLike) -> FloatArray:
        """Return what arcs on slopes cost at least; arguments as for `motion`.

        Where time is weighed otherwise than the cheapest speed weighs it, durations may jump from
        one direction to the next, so that the fastest admissible speed stands for them.
        """
        cost = self.costs[region]
        energy, length, time = self._weights
        if time <= energy * cost.time_value * (1.0 + 1e-9):
            return self.motion(ds, dtheta, region, steep)
        along = np.asarray(ds, float) * np.hypot(1.0, steep)
        total = energy * cost.segment_energy(along, dtheta, np.arctan(steep), exact=False)
        least = cost.segment_duration(along, dtheta, fastest=True)
        return np.asarray(total + length * np.abs(ds) + time * least)

    def value(self, energy: float, length: float, duration: float) -> float:
        """Return the price of a whole path, given its energy [J], length [m] and duration [s]."""
        weights = self._weights
        timed = weights[2] * duration if weights[2] else 0.0
        return weights[0] * energy + weights[1] * length + timed


_SLOPES = 9
"""Slopes at which prices are scanned."""

_ZOOMS, _CUTS = 20, 3
"""Rounds in which the cheapest slope is enclosed, and slopes tried in each."""

_REMEMBERED = 16
"""How many rates are kept for a cost."""


class Minorant(NamedTuple):
    """No motion costs less than ``metre max(|ds|, track |dtheta|) + radian |dtheta|``."""

    metre: float
    radian: float
    track: float


class _Remembered(NamedTuple):
    """What is kept of a cost: its minorants by track, and the excess of a metre by ground."""

    surfaces: Callable[[], SurfaceMap | None]
    minorants: dict[float, Minorant]
    excess: dict[int, float]


@dataclass(frozen=True, eq=False)
class LeastPrices:
    """Infima of the prices of motions of the centre that the kernels follow."""

    objective: Prices  # what the objective makes of motions
    steepest: float  # steepest slope, as rise over run
    worth: float  # price of height, which is taken off [J/m for energy]
    lateral: float  # how far to the left of the path's reference point the centre lies [m]
    _kept: _Remembered

    def price(
        self, x: FloatArray, y: FloatArray, grounds: Iterable[int] | None = None
    ) -> FloatArray:
        """Return the price on each ground, at its cheapest slope."""
        turn = y / self.objective.cost.half_track
        ds = x + self.lateral * turn
        grounds = range(len(self.objective.costs)) if grounds is None else grounds
        return np.array([self._cheapest(k, ds, turn) for k in grounds])

    def _cheapest(self, ground: int, ds: FloatArray, turn: FloatArray) -> FloatArray:
        if not self.steepest > 0:
            return self.objective.motion(ds, turn, ground, exact=True)

        def sloping(steep: FloatArray) -> FloatArray:
            price = self.objective.floor(ds, turn, ground, steep)
            return np.asarray(price - self.worth * steep * ds)

        steep = np.linspace(-self.steepest, self.steepest, _SLOPES)[:, None]
        values = sloping(steep)
        best = values.min(axis=0)
        k = values.argmin(axis=0)
        low, high = steep[np.maximum(k - 1, 0), 0], steep[np.minimum(k + 1, _SLOPES - 1), 0]
        cuts = np.arange(1, _CUTS + 1)[:, None] / (_CUTS + 1)
        for _ in range(_ZOOMS):
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
        return tuple((point - self.lateral) / half_track for point in about)

    def minorant(self, track: float) -> Minorant:
        """Return the greatest minorant with this `track` [m] below all prices."""
        known = self._kept.minorants
        if track not in known:
            found = self._infimum.rates(self.objective.cost.half_track, track)
            known[track] = Minorant(found.per_metre, found.per_radian, track)
        return known[track]

    def metre_excess(self) -> FloatArray:
        """Return by how much a metre on each ground exceeds one on the cheapest, at least.

        Beside it every radian costs what it costs at least anywhere.
        """
        least, half_track = self.minorant(0.0), self.objective.cost.half_track
        known = self._kept.excess
        for ground in set(range(len(self.objective.costs))) - set(known):

            def price(x: FloatArray, y: FloatArray, ground: int = ground) -> FloatArray:
                turned = least.radian / half_track * np.abs(y)
                return np.asarray(self.price(x, y, (ground,))[0] - turned)

            infimum = Infimum(price, self._infimum.even, self._special)
            metre = infimum.lowered(infimum.least(per_metre(lambda x, y: np.abs(x))))
            known[ground] = max(metre - least.metre, 0.0)
        return np.array([known[ground] for ground in sorted(known)])


_known: WeakKeyDictionary[EnergyCost, dict[Hashable, _Remembered]] = WeakKeyDictionary()


def least_prices(
    objective: Prices, steepest: float = 0.0, worth: float = 0.0, lateral: float | None = None
) -> LeastPrices:
    """Return the infima of prices; what they come to is remembered with the cost."""
    surfaces = objective.surfaces
    centre = objective.cost.icr.centre[1] if lateral is None else lateral
    weights = tuple(sorted(objective_weights(objective.objective).items()))
    key = id(surfaces), steepest, worth, centre, weights
    kept = _known.setdefault(objective.cost, {})
    # surfaces hold the costs last asked for, so that a cost must not hold surfaces
    known = kept.get(key)
    if known is None or (surfaces is not None and known.surfaces() is not surfaces):
        if len(kept) >= _REMEMBERED:
            kept.clear()
        whose = ref(surfaces) if surfaces is not None else _nothing
        known = kept[key] = _Remembered(whose, {}, {})
    return LeastPrices(objective, steepest, worth, centre, known)


def _nothing() -> None:
    """Stand for the surfaces where there are none."""
