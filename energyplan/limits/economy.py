"""Which speeds and accelerations take the least energy, with a price on time.

Minimise energy plus `price` times duration. On a run with power P(r, a) the maximum principle
gives one multiplier nu [J/m], the marginal cost of distance: the robot cruises at the rate with
the least ``(P(r, 0) + price) / r``, which is nu, and passes each rate below it with the
acceleration of least ``(P(r, a) + price - nu r) / a``. A run too short for its cruising rate peaks
at a lower one, with the larger nu of that rate.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from energyplan.compilation import AnyBlock, AnyInts, AnyTable, Column, njit
from energyplan.limits.acceleration_table import Ladder, Runs
from energyplan.path import FloatArray

TIE = 1e-9
"""Relative difference of cost below which the faster choice wins."""


@njit
def cheapest(
    gains: AnyBlock,
    power: AnyBlock,
    rate: AnyTable,
    kind: AnyInts,
    nu: Column,
    price: float,
    tie: float,
) -> FloatArray:
    """Acceleration of least ``(P + price - nu r) / a`` on each rung of each run, shape (m, n).

    `gains` and `power` have shape (grades, m, kinds), the greatest acceleration first, `rate` has
    shape (m, kinds). Of equal costs the greatest acceleration wins.
    """
    grades, rungs, _ = gains.shape
    chosen = np.empty((rungs, len(kind)))
    for j in range(rungs):
        for i in range(len(kind)):
            k = kind[i]
            worth = price - nu[i] * rate[j, k]
            least, scale = np.inf, abs(price)
            for g in range(grades):
                least = min(least, (power[g, j, k] + worth) / gains[g, j, k])
                scale = max(scale, abs(power[g, j, k]))
            enough = least + tie * scale / gains[0, j, k]
            for g in range(grades):
                if (power[g, j, k] + worth) / gains[g, j, k] <= enough:
                    chosen[j, i] = gains[g, j, k]
                    break
    return chosen


class Choice(NamedTuple):
    """A ladder and a cruising rate [m/s] for each run."""

    ladder: Ladder
    cruise: FloatArray


class Economy:
    """Powers of each kind of run over rates and accelerations, to choose from at any price."""

    def __init__(self, runs: Runs, fastest: Ladder, slowest: float, grades: int = 12) -> None:
        self._fastest = fastest
        self._lowest = np.minimum(slowest, fastest.rate[-1])
        self._middle = 0.5 * (fastest.rate[:-1] + fastest.rate[1:])
        self._steady = runs.power(fastest.rate[1:])
        self._up = self._tried(runs, fastest.up, 1.0, grades)
        self._down = self._tried(runs, fastest.down, -1.0, grades)

    def _tried(
        self, runs: Runs, bound: FloatArray, sign: float, grades: int
    ) -> tuple[FloatArray, FloatArray]:
        """Accelerations from the greatest down, and power at each; shape (grades + 2, m, n)."""
        even = [bound * part for part in np.linspace(1.0, 1.0 / grades, grades)]
        level = runs.model.forces(runs.motion(self._middle))
        pushed = runs.model.forces(runs.motion(self._middle, sign * bound))
        kinks = []
        for here, there in ((level.left, pushed.left), (level.right, pushed.right)):
            # Where a side stops drawing and starts to return, the power may have a kink.
            change = here - there
            part = np.divide(here, change, out=np.ones_like(here), where=change != 0)
            kinks.append(np.where((part > 1e-3) & (part < 1), part, 1.0) * bound)
        gains = -np.sort(-np.array(even + kinks), axis=0)
        middle = np.broadcast_to(self._middle, gains.shape)
        return gains, runs.power(middle, sign * gains)

    def choose(self, price: float, kinds: NDArray[np.int_], reach: FloatArray) -> Choice:
        """Return ladders and cruising rates of least energy plus `price` times duration."""
        rate = self._fastest.rate[1:]
        worth = (self._steady + price) / rate
        least = np.min(worth, axis=0, where=rate >= self._lowest, initial=np.inf)
        allowed = (rate >= self._lowest) & (worth <= least + TIE * np.abs(worth).max(axis=0))
        best = len(rate) - 1 - np.argmax(allowed[::-1], axis=0)
        keys, place = np.unique(np.column_stack([kinds, reach]), axis=0, return_inverse=True)
        kind, limit = keys[:, 0].astype(int), keys[:, 1]
        high = best[kind]
        up, down = self._gains(price, kind, worth[high, kind])
        short = self._distance(kind, high, up, down) > limit
        if short.any():
            who = np.flatnonzero(short)
            peak = self._peak(price, kind[who], limit[who], worth, high[who])
            up[:, who], down[:, who] = self._gains(price, kind[who], worth[peak, kind[who]])
        place = place.reshape(-1)
        ladder = self._fastest.take(kinds).with_gains(up[:, place], down[:, place])
        return Choice(ladder, rate[best[kinds], kinds])

    def _peak(
        self,
        price: float,
        kind: NDArray[np.int_],
        limit: FloatArray,
        worth: FloatArray,
        high: NDArray[np.int_],
    ) -> NDArray[np.int_]:
        """Lowest rung whose multiplier lets the run climb to it and descend, by bisection."""
        low, high = np.full(kind.shape, -1), high.copy()
        while np.any(high - low > 1):
            middle = np.maximum((low + high) // 2, 0)
            gains = self._gains(price, kind, worth[middle, kind])
            over = self._distance(kind, middle, *gains) > limit
            high, low = np.where(over, middle, high), np.where(over, low, middle)
        return high

    def _gains(
        self, price: float, kind: NDArray[np.int_], nu: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Acceleration and deceleration of least cost on each rung, shape (m, n)."""
        up, down = (
            cheapest(gains, power, self._middle, kind, nu, price, TIE)
            for gains, power in (self._up, self._down)
        )
        return up, down

    def _distance(
        self, kind: NDArray[np.int_], rung: NDArray[np.int_], up: FloatArray, down: FloatArray
    ) -> FloatArray:
        """Distance to climb to the rung and to descend from it [m]."""
        half = 0.5 * np.diff(self._fastest.square[:, kind], axis=0)
        total = np.cumsum(half / up + half / down, axis=0)
        return np.asarray(total[rung, np.arange(len(kind))])
