"""The moment that contacts hold between the sides, as the powers of both show it (private).

In turns each side obeys the law of sliding friction. Near straight driving the moment is free, up
to that of sliding: the difference of the powers tells it, and only the sum of the forces is fitted.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d, minimum_filter1d, uniform_filter1d

from energyplan.fit.drive import MOMENT, Drive
from energyplan.motion import Motion
from energyplan.path import FloatArray
from energyplan.power import Sides, Term
from energyplan.vehicle import Vehicle

_BISECTIONS = 16
_INSIDE = 12  # bisections by which a moment differs from its limit
_MEASURABLE = 5.0  # multiple of the noise from which the largest moment can be measured


def lost_power(
    losses: Sequence[tuple[Term, float]], motion: Motion, vehicle: Vehicle, forces: Sides
) -> Sides:
    """Power of each side that losses take [W]."""
    whole = Sides(np.zeros(motion.shape), np.zeros(motion.shape))
    for term, value in losses:
        whole = whole + term.function(motion, vehicle, forces, **term.params) * value
    return whole


@dataclass(frozen=True)
class Held:
    """Samples at which contacts hold: their motion, forces, and what losses take without more."""

    vehicle: Vehicle
    losses: Sequence[tuple[Term, float]]
    motion: Motion
    forces: Sides
    without: FloatArray

    @classmethod
    def of(
        cls, drive: Drive, vehicle: Vehicle, losses: Sequence[tuple[Term, float]], forces: Sides,
        some: slice | NDArray[np.intp] = slice(None),
    ) -> Held:  # fmt: skip
        """Take some of the samples of a drive at which contacts hold."""
        held, at = drive.held, np.flatnonzero(drive.holds)[some]
        channels = {name: values[at] for name, values in held.channels.items()}
        motion = Motion(held.v_left[at], held.v_right[at], held.icr, channels)
        own = Sides(forces.left[at], forces.right[at])
        return cls(vehicle, losses, motion, own, lost_power(losses, motion, vehicle, own).total)

    def _lost(self, moment: FloatArray) -> tuple[Sides, Sides]:
        """Tread forces with a moment between the sides, and what losses take of them."""
        push = moment / self.motion.icr.slip_track
        acting = Sides(self.forces.left - push, self.forces.right + push)
        return acting, lost_power(self.losses, self.motion, self.vehicle, acting)

    def cost(self, moment: FloatArray) -> FloatArray:
        """Power that losses take because of a moment between the sides [W]."""
        return np.asarray(self._lost(moment)[1].total - self.without)

    def powers(self, moment: FloatArray) -> Sides:
        """Power of each side with a moment between them [W]."""
        acting, lost = self._lost(moment)
        through = Sides(acting.left * self.motion.v_left, acting.right * self.motion.v_right)
        return through + lost


@dataclass(frozen=True)
class Preload:
    """The moment by which the sides push against each other while contacts hold."""

    moment: FloatArray  # (n,): the moment [N m]
    forces: Sides  # tread forces of the moment [N]
    response: FloatArray  # (n,) [W/(N m)]
    cost: FloatArray  # (n,): by how much the total rises with it [W/(N m)]
    ends: FloatArray  # (n,)
    sure: FloatArray  # (n,): mean square of `response` over the samples around each
    width: int  # samples over which it is taken for one
    alone: NDArray[np.bool_]  # (n,): samples that have a moment of their own

    def followed(self, between: FloatArray, limits: FloatArray) -> FloatArray:
        """Return by how much the total falls as the moment follows coefficients."""
        pulled = self.response[:, None] * between - self.ends[:, None] * limits
        moved = _smoothed(pulled, self.width, self.alone)
        return np.asarray((self.cost / self.sure)[:, None] * moved)


def _alone(held: NDArray[np.bool_], width: int) -> NDArray[np.bool_]:
    """Return which held samples cannot be averaged over so many with their neighbours."""
    long = maximum_filter1d(minimum_filter1d(held.astype(float), width), width) > 0.0
    beside = maximum_filter1d((~held).astype(float), 3) > 0.0
    return np.asarray(held & (beside | ~long))


def _smoothed(values: FloatArray, width: int, alone: NDArray[np.bool_]) -> FloatArray:
    """Return means over so many samples along the first axis, but of those that stand alone."""
    alone = alone.reshape(-1, *[1] * (values.ndim - 1))
    means = uniform_filter1d(np.where(alone, 0.0, values), width, axis=0)
    return np.where(alone, values, means)


def preload(
    drive: Drive,
    between: FloatArray,
    vehicle: Vehicle,
    losses: Sequence[tuple[Term, float]],
    forces: Sides,
    limit: float,
) -> Preload:
    """Find the moment between the sides from the measured difference of their powers."""
    at, held = drive.holds, Held.of(drive, vehicle, losses, forces)
    sign = np.sign(held.motion.v_left + held.motion.v_right)
    track = drive.motion.icr.slip_track
    wanted = drive.in_time(between)[at]

    def too_large(moment: FloatArray) -> NDArray[np.bool_]:
        both = held.powers(moment)
        return np.asarray(sign * (both.right - both.left - wanted) > 0.0)

    if losses:
        found = _bisected(too_large, np.full(len(wanted), -limit), np.full(len(wanted), limit))
    else:
        speed, still = held.motion.v_left + held.motion.v_right, held.powers(np.zeros(len(wanted)))
        free = track * (wanted - still.right + still.left)
        found = np.divide(free, speed, out=np.zeros(len(free)), where=speed != 0.0)
        found = np.clip(found, -limit, limit)
    step = max(1e-3 * limit, 1e-9)
    ahead, behind = held.powers(found + step), held.powers(found - step)
    rise = sign * ((ahead.right - ahead.left) - (behind.right - behind.left)) / (2 * step)
    clear = rise * limit > _MEASURABLE * drive.between_noise
    inside = clear & (np.abs(found) < (1.0 - 2.0**-_INSIDE) * limit)
    weight, moment, response, cost, ends = (np.zeros(len(drive.t)) for _ in range(5))
    weight[at] = np.where(clear, rise, 0.0) ** 2
    moment[at] = found
    response[at] = np.where(inside, sign * rise, 0.0)
    ends[at] = np.where(clear & ~inside, np.sign(found) * rise**2, 0.0)
    width = drive.samples_in(MOMENT)
    alone = _alone(at, width)
    sure = _smoothed(weight, width, alone)
    driving = at & ((drive.held.v_left != 0.0) | (drive.held.v_right != 0.0)) & (sure > 0.0)
    sure = np.where(driving, sure, 1.0)
    smooth = np.where(driving, _smoothed(weight * moment, width, alone) / sure, 0.0)
    cost[at] = (held.cost(smooth[at] + step) - held.cost(smooth[at] - step)) / (2 * step)
    cost = np.where(driving, cost, 0.0)
    forces = Sides(-smooth / track, smooth / track)
    return Preload(smooth, forces, response, cost, ends, sure, width, alone)


def _bisected(
    too_large: Callable[[FloatArray], NDArray[np.bool_]], low: FloatArray, high: FloatArray
) -> FloatArray:
    """Return the largest moments, between bounds, that are not too large."""
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        above = too_large(middle)
        low, high = np.where(above, low, middle), np.where(above, middle, high)
    return 0.5 * (low + high)
