"""Least time within the continuous power: where to slow down so that no thermal window is too warm.

What a tread draws between two places of a path hardly depends on how fast they are passed; the time
between them does. So the limit asks for time: between any two places that are the window's energy
apart, at least the window's length. Over squared rates accelerations are linear and times convex.
A tangent to the time of a window asks for too much rather than too little, so a linear program
about a profile that keeps the limit finds a better one that keeps it, until nothing is gained. What
depends on the rate in other ways is linear in the program and exact in the profiles between.

Source: Verscheure et al. (2009), "Time-optimal path tracking for robots: a convex optimization
approach"; Lipp and Boyd (2016), "Variations and extension of the convex-concave procedure";
docs/limits.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from energyplan.errors import InfeasibleMotionError
from energyplan.limits._windows import PARTS, Basis, Fine, Rows, Window, Windows, placed
from energyplan.limits.curve import Curve, inside
from energyplan.motion import Motion
from energyplan.path import FloatArray

ROUNDS = 15
"""How often program and profile take turns at most."""

GAIN = 5e-4
"""Fraction of the duration that another turn must save."""

PATIENCE = 3
"""Turns in a row that save less after which nothing more is expected."""

REACH = 9.0
"""Factor by which a program may change a squared rate."""

SCALES = (1 / 9, 1 / 4, 1 / 2, 0.8, 1.0, 1.25, 2.0, 4.0, 9.0)
"""Factors on all squared rates at which durations get a tangent."""

SLOWNESS = (1.0, 1.5, 2.0, 3.0, 5.0, 8.0, 15.0, 30.0)
"""Factors on the slowness at which its square gets a tangent."""

SPREAD = 1e-3
"""Weight of the squared factors on the slowness, over that of the duration."""

SHARES = (1.0, 0.6, 0.3, 0.1)
"""Parts of the way to the program's solution that are tried."""

MARGIN = 1e-3
"""Fraction of the continuous power that is left for windows that begin and end within cells."""

TIGHT = 1e-6
"""Fraction of a window's length by which it may be too short in between."""

SLOWER = 0.9995
"""Factor on the rates, beyond what windows ask for, where one is too short in the end."""

DEAR = 2.0
"""Seconds that a second too little in a window counts for, per window on the path."""

STATIC = 1e-3
"""Change of the drawn energy with the rate, over the energy of a cell, that counts as none."""

PROBE = 1e-4
"""Relative step of the differences that tell how energies change with the rates."""


class _State(NamedTuple):
    """A profile: rates, times and drawn energies up to the points, and how it fares."""

    rate: FloatArray  # (n,): rates [m/s], times [s]
    time: FloatArray  # (n,): rates [m/s], times [s]
    drawn: FloatArray  # (2, n): what the left and the right side drew up to the points [J]
    lack: float  # longest time by which a window is too short [s]
    share: float  # shortest window over its length, at most 1
    windows: list[Windows]  # the windows
    fine: Fine  # the profile at more places

    def merit(self, price: float) -> float:
        """Duration, and the lack of time in windows at a price [s]."""
        return float(self.time[-1]) + price * self.lack


class Thermal:
    """Curves that are driven one after the other, within the continuous power of their limits."""

    def __init__(self, curves: Sequence[Curve]) -> None:
        self.curves, self.model = curves, curves[0].model
        self.acceleration = curves[0].acceleration
        motor = curves[0].limits.motor
        self.window = Window((1 - MARGIN) * motor.continuous_power, motor.thermal_time)
        size = [len(curve.cap) for curve in curves]
        self.ends = np.cumsum(size)
        self.begins = self.ends - size
        # The step from one curve to the next is a cell of no length.
        self.length = np.concatenate([np.append(c.points.length, 0.0) for c in curves])[:-1]
        self.top = np.concatenate([curve.cap for curve in curves])
        self.forward = np.concatenate([curve.points.forward for curve in curves])
        self.turn = np.concatenate([curve.points.turn for curve in curves])
        self.channels = {
            name: np.concatenate([curve.points.channels[name] for curve in curves])
            for name in curves[0].points.channels
        }
        icr = self.model.vehicle.icr
        self.sides = np.stack(
            [self.forward - icr.left * self.turn, self.forward + icr.right * self.turn]
        )
        self.real = self.length > 0

    def rates(self) -> list[FloatArray]:
        """Return the rates at the points of each curve [m/s]."""
        best = self._state(self.top)
        if best.lack <= TIGHT * self.window.time:
            return self._split(best.rate)
        price = DEAR * (1.0 + float(best.drawn[:, -1].max()) / self.window.energy)
        best, idle = self._state(self._slow(best)), 0
        for _ in range(ROUNDS):
            goal, before = self._program(best, price), best.merit(price)
            for share in SHARES:
                square = best.rate**2 + share * (goal**2 - best.rate**2)
                tried = self._state(np.minimum(self.top, np.sqrt(square)))
                if tried.merit(price) < best.merit(price):
                    best = tried
                    break
            idle = idle + 1 if before - best.merit(price) < GAIN * before else 0
            if idle == PATIENCE or best.merit(price) == before:
                break
        return self._split(self._kept(best).rate)

    def _kept(self, state: _State) -> _State:
        """Slow a profile down evenly until it keeps the limit."""
        slower = 1.0
        for _ in range(60):
            tried = state if slower == 1.0 else self._state(slower * state.rate)
            if tried.lack <= TIGHT * self.window.time:
                return tried
            slower *= SLOWER * tried.share
        raise InfeasibleMotionError(
            f"the motors' continuous power of {self.window.power:g} W does not suffice at any "
            "speed; take a longer way round or carry less"
        )

    def _slow(self, free: _State) -> FloatArray:
        """Return caps on the rates: the least time without regard to accelerations.

        Times are linear in the factors on the slowness at knots, at least 1. Of all ways that
        take as long, one is taken that spreads the slowness.
        """
        step = np.diff(free.time)
        basis = Basis.over(free.time, free.drawn.max(axis=0), self.window)
        k = basis.size
        times = basis.between(basis.cumulated(0.5 * step, 0.5 * step))
        rows = Rows(np.concatenate([np.ones(k), free.time[basis.knots], np.ones(k)]))
        rows.unchanged(placed(3 * k, (0, -times.whole), (k, np.diff(np.eye(k), axis=0))))
        rows.unchanged(placed(3 * k, (k, np.eye(1, k))))
        reached = free.fine.at(placed(3 * k, (0, times.inside), (k, basis.picked)))
        for found in free.windows:
            chosen = found.tightest(basis, free.fine, np.inf)
            block = chosen.rows(free.fine, [reached], self.window.power)
            rows.below(-block, chosen.lasts - chosen.least - block @ rows.now)
        for factor in SLOWNESS:
            # Squares of factors, above their tangents.
            block = placed(3 * k, (0, 2 * factor * np.eye(k)), (2 * k, -np.eye(k)))
            rows.below(block, np.full(k, factor**2))
        price = np.zeros(3 * k)
        price[2 * k - 1] = 1.0
        price[2 * k :] = SPREAD * times.whole.sum(axis=0)
        bounds = np.full((3 * k, 2), np.inf)
        bounds[:, 0] = np.repeat([1.0, 0.0, 1.0], k)
        slowness: FloatArray = basis.hats @ rows.solved(price, bounds)[:k]
        return np.asarray(np.minimum(self.top, free.rate / slowness))

    def _split(self, values: FloatArray) -> list[FloatArray]:
        return [values[a:b] for a, b in zip(self.begins, self.ends, strict=True)]

    # -- a profile ------------------------------------------------------------------------------

    def _state(self, cap: FloatArray) -> _State:
        """Drive as fast as caps and limits allow."""
        rate = np.concatenate(
            [curve.fastest(top) for curve, top in zip(self.curves, self._split(cap), strict=True)]
        )
        time = np.append(0.0, np.cumsum(self._steps(rate)))
        fine, length = Fine.of(rate, time, self._energies(rate)), self.window.time
        drawn = fine.drawn[:, ::PARTS]
        windows = [
            Windows.found(fine, self.window, side, forward)
            for side in range(2)
            for forward in (True, False)
        ]
        least = min(float(np.min(found.lasts, initial=length)) for found in windows)
        return _State(rate, time, drawn, length - least, least / length, windows, fine)

    def _steps(self, rate: FloatArray) -> FloatArray:
        """Time that each cell takes [s]."""
        whole = rate[1:] + rate[:-1]
        step = np.divide(2 * self.length, whole, out=np.zeros_like(whole), where=self.real)
        return np.asarray(step)

    def _energies(self, rate: FloatArray) -> FloatArray:
        """Shaft energy that each side draws in parts of cells [J], shape (2, n - 1, PARTS)."""
        step = self._steps(rate)
        safe = np.where(self.real, step, 1.0)[:, None]
        v, omega = self.forward * rate, self.turn * rate
        part = np.clip(np.linspace(0, 1, 2 * PARTS + 1), 1e-6, 1 - 1e-6)

        known = {"slope": np.zeros(()), **{k: inside(c, part) for k, c in self.channels.items()}}
        motion = Motion.from_twist(
            inside(v, part), inside(omega, part), self.model.vehicle.icr,
            accel=np.diff(v)[:, None] / safe, yaw_accel=np.diff(omega)[:, None] / safe, **known,
        )  # fmt: skip
        forces = self.model.forces(motion)
        powers = np.stack([forces.left * motion.v_left, forces.right * motion.v_right])
        drawn = np.maximum(powers, 0.0)
        sums = drawn[..., :-2:2] + 4 * drawn[..., 1::2] + drawn[..., 2::2]
        return np.asarray(sums * step[:, None] / (6 * PARTS))

    # -- the program ----------------------------------------------------------------------------

    def _program(self, state: _State, dear: float) -> FloatArray:
        """Return the rates that a linear program about a profile finds.

        Unknowns are the factors on the squared rates at knots, straight between them; the changes
        of time and of drawn energies up to the knots; the duration between two knots; and by how
        much windows may be too short, at a price.
        """
        rate, step = state.rate, np.diff(state.time)
        basis = Basis.over(state.time, state.drawn.max(axis=0), self.window)
        k = basis.size
        whole = np.where(self.real, rate[1:] + rate[:-1], 1.0)
        # The slowness is the square's power -1/2.
        early, late = -0.5 * step * rate[:-1] / whole, -0.5 * step * rate[1:] / whole
        sums = [basis.between(basis.cumulated(early, late))]
        energy = np.diff(state.drawn, axis=1)
        change = -0.5 * self._changes(rate, energy)
        if np.abs(change).max() > STATIC * energy.max():
            sums += [basis.between(basis.cumulated(*ends)) for ends in change]
        span = (1 + len(sums)) * k
        width = span + k
        lasting = np.add.reduceat(step, basis.knots[:-1])
        rows = Rows(np.concatenate([np.ones(k), np.zeros(span - k), lasting, [state.lack]]))
        reached = []
        for first, each in zip(range(k, span, k), sums, strict=True):
            rows.unchanged(placed(width, (0, -each.whole), (first, np.diff(np.eye(k), axis=0))))
            rows.unchanged(placed(width, (first, np.eye(1, k))))
            block = placed(width, (0, each.inside), (first, basis.picked))
            reached.append(state.fine.at(block))
        for scale in SCALES:
            # Durations between knots, above their tangents where all squares have that factor.
            tangent = scale**-1.5 * sums[0].whole
            rows.below(
                placed(width, (0, tangent), (span, -np.eye(k - 1))), -1.5 * scale**-0.5 * lasting
            )
        for side in self.sides:
            matrix = basis.accelerations(side, rate, self.length)
            most = np.maximum(self.acceleration, np.abs(matrix.sum(axis=1)))
            rows.below(placed(width, (0, matrix)), most)
            rows.below(placed(width, (0, -matrix)), most)
        for found in state.windows:
            chosen = found.tightest(basis, state.fine, REACH * self.window.time)
            block = chosen.rows(state.fine, reached, self.window.power)
            short = placed(width, (width - 1, np.ones((len(chosen.lasts), 1))))
            rows.below(-block - short, chosen.lasts - chosen.least - block @ rows.now)
        ceiling = np.divide(self.top**2, rate**2, out=np.ones_like(rate), where=rate > 0)
        bounds = np.full((width, 2), np.inf)
        bounds[:, 0] = np.repeat([1 / REACH, -np.inf, 0.0], [k, width - k - 1, 1])
        bounds[:k, 1] = np.clip(np.maximum.reduceat(ceiling, basis.middles), 1.0, REACH)
        price = np.append(np.repeat([0.0, 1.0], [span, k - 1]), dear)
        return np.asarray(rate * np.sqrt(basis.hats @ rows.solved(price, bounds)[:k]))

    def _changes(self, rate: FloatArray, energy: FloatArray) -> FloatArray:
        """How energies change with the slowness at either end, shape (2 sides, 2 ends, n - 1)."""
        out = np.zeros((2, 2, len(energy[0])))
        for end in (0, 1):
            for phase in (0, 1):
                # Every other point is slowed: each cell has one end among them.
                slowed = rate.copy()
                slowed[phase::2] /= 1 + PROBE
                change = (self._energies(slowed).sum(axis=2) - energy) / PROBE
                mine = (np.arange(len(rate) - 1) + end) % 2 == phase
                out[:, end, mine] = change[:, mine]
        return out
