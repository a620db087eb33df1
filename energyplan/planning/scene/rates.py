"""What motions cost at least, on any ground and slope of a problem: rates for bounds and guides."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple
from weakref import WeakKeyDictionary, ref

import numpy as np

from energyplan.cost import EnergyCost
from energyplan.cost.bounds import Infimum, per_metre
from energyplan.path import FloatArray
from energyplan.planning.problem import objective_weights
from energyplan.planning.scene.prices import Prices
from energyplan.terrain import SurfaceMap

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
    """Infima of the prices of motions of the centre of the tread ICRs.

    Parameters
    ----------
    objective : Prices
        What the objective makes of motions.
    steepest : float
        Steepest slope, as rise over run; zero on level ground.
    worth : float
        Price of height, which is taken off [J/m for energy].
    """

    objective: Prices
    steepest: float
    worth: float
    _kept: _Remembered

    def price(
        self, x: FloatArray, y: FloatArray, grounds: Iterable[int] | None = None
    ) -> FloatArray:
        """Return the price on each ground, at its cheapest slope.

        Parameters
        ----------
        x, y : ndarray, shape (n,)
            Distance of the centre in plan view, and turn times half the slip track [m].
        grounds : iterable of int, optional
            Numbers of the grounds; all where not given.

        Returns
        -------
        ndarray, shape (grounds, n)
            Prices, less what the rise is worth.
        """
        icr = self.objective.cost.icr
        turn = y / icr.half_track
        ds = x + icr.centre[1] * turn
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
        icr = self.objective.cost.icr
        about = [0.0]  # to the left of the reference point: what does not move
        for cost in self.objective.costs:
            lateral = cost.icr.centre[1]
            about += [lateral, lateral - cost.half_track, lateral + cost.half_track]
        return tuple((point - icr.centre[1]) / icr.half_track for point in about)

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


def least_prices(objective: Prices, steepest: float = 0.0, worth: float = 0.0) -> LeastPrices:
    """Return the infima of prices; what they come to is remembered with the cost.

    Parameters
    ----------
    objective : Prices
        What the objective makes of motions.
    steepest, worth : float
        Steepest slope, as rise over run, and the price of height that is taken off.

    Returns
    -------
    LeastPrices
        The infima.
    """
    surfaces = objective.surfaces
    weights = tuple(sorted(objective_weights(objective.objective).items()))
    key = id(surfaces), steepest, worth, weights
    kept = _known.setdefault(objective.cost, {})
    # surfaces hold the costs last asked for, so that a cost must not hold surfaces
    known = kept.get(key)
    if known is None or (surfaces is not None and known.surfaces() is not surfaces):
        if len(kept) >= _REMEMBERED:
            kept.clear()
        whose = ref(surfaces) if surfaces is not None else _nothing
        known = kept[key] = _Remembered(whose, {}, {})
    return LeastPrices(objective, steepest, worth, known)


def _nothing() -> None:
    """Stand for the surfaces where there are none."""
