"""Least time within the continuous power: where to slow down so that no thermal window is too warm.

What a tread draws between two places of a path hardly depends on how fast they are passed; the time
between them does. So the limit asks for time: between any two places that are the window's energy
apart, at least the window's length. Over squared rates accelerations are linear and times convex.
A tangent to the time of a window asks for too much rather than too little, so a linear program
about a profile that keeps the limit finds a better one that keeps it, until nothing is gained. What
depends on the rate in other ways is linear in the program and exact in the profiles between.

References
----------
Verscheure et al. (2009), "Time-optimal path tracking for robots: a convex optimization approach";
Lipp and Boyd (2016), "Variations and extension of the convex-concave procedure"; docs/limits.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linprog
from scipy.sparse import csr_array, diags_array, hstack, vstack

from energyplan.errors import InfeasibleMotionError
from energyplan.limits.curve import Curve
from energyplan.motion import Motion
from energyplan.path import FloatArray

ROUNDS = 15
"""How often program and profile take turns at most."""

GAIN = 5e-4
"""Fraction of the duration that another turn must save."""

PATIENCE = 3
"""Turns in a row that save less after which nothing more is expected."""

KNOTS = 12
"""Knots per thermal window between which a program changes the rates."""

FEWEST, MOST = 60, 400
"""Knots at least and at most."""

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

PARTS = 4
"""Parts of a cell in which windows begin and end."""

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

STEEP = 10.0
"""Longest time per joule, in units of the window's, that counts where a window ends."""

PROBE = 1e-4
"""Relative step of the differences that tell how energies change with the rates."""


class Window(NamedTuple):
    """The continuous power [W] and the time [s] over which its mean is taken."""

    power: float
    time: float

    @property
    def energy(self) -> float:
        """What a side may draw in one window [J]."""
        return self.power * self.time


class _Fine(NamedTuple):
    """A profile at places between its points: a window may begin and end anywhere.

    Parameters
    ----------
    rate, time : ndarray, shape (m,)
        Rates [m/s], times [s].
    drawn : ndarray, shape (2, m)
        What either side drew up to there [J].
    cell : ndarray of int, shape (m,)
        The cell in which the place lies.
    part : ndarray, shape (m,)
        Which part of the cell's time has gone.
    """

    rate: FloatArray
    time: FloatArray
    drawn: FloatArray
    cell: NDArray[np.intp]
    part: FloatArray

    @classmethod
    def of(cls, rate: FloatArray, time: FloatArray, drawn: FloatArray) -> _Fine:
        """Cut every cell into parts of one duration, in each of which `drawn` is drawn."""
        cell = np.append(np.repeat(np.arange(len(rate) - 1), PARTS), len(rate) - 2)
        part = np.append(np.tile(np.arange(PARTS) / PARTS, len(rate) - 1), 1.0)
        here = rate[cell] + part * np.diff(rate)[cell]
        total = time[cell] + part * np.diff(time)[cell]
        energy = np.hstack([np.zeros((2, 1)), np.cumsum(drawn.reshape(2, -1), axis=1)])
        return cls(here, total, energy, cell, part)

    def at(self, rows: csr_array) -> csr_array:
        """Return what is known at the points, one row each, at the places."""
        m = np.arange(len(self.cell))
        weight = np.concatenate([1 - self.part, self.part])
        place = np.concatenate([m, m]), np.concatenate([self.cell, self.cell + 1])
        return csr_array(csr_array((weight, place), shape=(len(m), rows.shape[0])) @ rows)


def _gone(way: FloatArray, first: FloatArray, here: FloatArray, last: FloatArray) -> FloatArray:
    """Part of a cell's time that has gone after a part of its way: squared rates run straight."""
    sums = first + here
    return np.divide(way * (first + last), sums, out=np.ones_like(way) * way, where=sums > 0)


class _State(NamedTuple):
    """A profile: rates, times and drawn energies up to the points, and how it fares.

    Parameters
    ----------
    rate, time : ndarray, shape (n,)
        Rates [m/s], times [s].
    drawn : ndarray, shape (2, n)
        What the left and the right side drew up to the points [J].
    lack : float
        Longest time by which a window is too short [s].
    share : float
        Shortest window over its length, at most 1.
    windows : list of _Windows
        The windows.
    fine : _Fine
        The profile at more places.
    """

    rate: FloatArray
    time: FloatArray
    drawn: FloatArray
    lack: float
    share: float
    windows: list[_Windows]
    fine: _Fine

    def merit(self, price: float) -> float:
        """Duration, and the lack of time in windows at a price [s]."""
        return float(self.time[-1]) + price * self.lack


class Thermal:
    """Curves that are driven one after the other, within the continuous power of their limits.

    Parameters
    ----------
    curves : sequence of Curve
        The curves, from stop to stop, of one model and one set of limits.
    """

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
        """Return the rates at the points of each curve [m/s].

        Raises
        ------
        InfeasibleMotionError
            If the motors get too warm however slowly the robot drives.
        """
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
        basis = _Basis.over(free.time, free.drawn.max(axis=0), self.window)
        k = basis.size
        times = basis.between(basis.cumulated(0.5 * step, 0.5 * step))
        rows = _Rows(np.concatenate([np.ones(k), free.time[basis.knots], np.ones(k)]))
        rows.unchanged(_placed(3 * k, (0, -times.whole), (k, np.diff(np.eye(k), axis=0))))
        rows.unchanged(_placed(3 * k, (k, np.eye(1, k))))
        reached = free.fine.at(_placed(3 * k, (0, times.inside), (k, basis.picked)))
        for found in free.windows:
            chosen = found.tightest(basis, free.fine, np.inf)
            block = chosen.rows(free.fine, [reached], self.window.power)
            rows.below(-block, chosen.lasts - chosen.least - block @ rows.now)
        for factor in SLOWNESS:
            # Squares of factors, above their tangents.
            block = _placed(3 * k, (0, 2 * factor * np.eye(k)), (2 * k, -np.eye(k)))
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
        fine, length = _Fine.of(rate, time, self._energies(rate)), self.window.time
        drawn = fine.drawn[:, ::PARTS]
        windows = [
            _Windows.found(fine, self.window, side, forward)
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

        def between(value: FloatArray) -> FloatArray:
            return np.asarray(value[:-1, None] + np.diff(value)[:, None] * part)

        known = {"slope": np.zeros(()), **{k: between(c) for k, c in self.channels.items()}}
        motion = Motion.from_twist(
            between(v), between(omega), self.model.vehicle.icr,
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
        basis = _Basis.over(state.time, state.drawn.max(axis=0), self.window)
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
        rows = _Rows(np.concatenate([np.ones(k), np.zeros(span - k), lasting, [state.lack]]))
        reached = []
        for first, each in zip(range(k, span, k), sums, strict=True):
            rows.unchanged(_placed(width, (0, -each.whole), (first, np.diff(np.eye(k), axis=0))))
            rows.unchanged(_placed(width, (first, np.eye(1, k))))
            block = _placed(width, (0, each.inside), (first, basis.picked))
            reached.append(state.fine.at(block))
        for scale in SCALES:
            # Durations between knots, above their tangents where all squares have that factor.
            tangent = scale**-1.5 * sums[0].whole
            rows.below(
                _placed(width, (0, tangent), (span, -np.eye(k - 1))), -1.5 * scale**-0.5 * lasting
            )
        for side in self.sides:
            matrix = basis.accelerations(side, rate, self.length)
            most = np.maximum(self.acceleration, np.abs(matrix.sum(axis=1)))
            rows.below(_placed(width, (0, matrix)), most)
            rows.below(_placed(width, (0, -matrix)), most)
        for found in state.windows:
            chosen = found.tightest(basis, state.fine, REACH * self.window.time)
            block = chosen.rows(state.fine, reached, self.window.power)
            short = _placed(width, (width - 1, np.ones((len(chosen.lasts), 1))))
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


class _Sums(NamedTuple):
    """Sums over cells by the factors at knots: from knot to knot, and from the knot behind on."""

    whole: FloatArray
    inside: FloatArray


class _Basis(NamedTuple):
    """Knots among the points, and the hat functions between them.

    Parameters
    ----------
    knots : ndarray of int, shape (k,)
        The points that are knots.
    behind : ndarray of int, shape (n,)
        The knot at or before each point.
    hats : ndarray, shape (n, k)
        Weights of the knots at each point.
    """

    knots: NDArray[np.intp]
    behind: NDArray[np.intp]
    hats: FloatArray

    @classmethod
    def over(cls, time: FloatArray, drawn: FloatArray, window: Window) -> _Basis:
        """Spread knots evenly over time and drawn energy together."""
        n = len(time)
        place = time / time[-1] + drawn / drawn[-1]
        count = int(np.clip(KNOTS * drawn[-1] / window.energy, FEWEST, MOST))
        wanted = np.linspace(0.0, place[-1], min(count, n))
        knots = np.unique(np.append(np.searchsorted(place, wanted).clip(0, n - 1), [0, n - 1]))
        behind = np.searchsorted(knots, np.arange(n), side="right") - 1
        after = np.minimum(behind + 1, len(knots) - 1)
        gap = place[knots[after]] - place[knots[behind]]
        part = np.divide(place - place[knots[behind]], gap, out=np.zeros(n), where=gap > 0)
        hats = np.zeros((n, len(knots)))
        hats[np.arange(n), behind] = 1 - part
        hats[np.arange(n), after] += part
        return cls(knots, behind, hats)

    @property
    def size(self) -> int:
        """Number of knots."""
        return len(self.knots)

    @property
    def middles(self) -> NDArray[np.intp]:
        """First point of the part that is nearest to each knot."""
        return np.append(0, (self.knots[:-1] + self.knots[1:] + 1) // 2)

    @property
    def picked(self) -> FloatArray:
        """For each point, 1 at the knot at or before it."""
        out = np.zeros_like(self.hats)
        out[np.arange(len(out)), self.behind] = 1.0
        return out

    def cumulated(self, before: FloatArray, after: FloatArray) -> FloatArray:
        """Sum over cells, up to each point, of what factors at their ends change, shape (n, k)."""
        each = before[:, None] * self.hats[:-1] + after[:, None] * self.hats[1:]
        return np.vstack([np.zeros(self.size), np.cumsum(each, axis=0)])

    def between(self, total: FloatArray) -> _Sums:
        """Split sums up to each point at the knots."""
        at_knots = total[self.knots]
        return _Sums(np.diff(at_knots, axis=0), total - at_knots[self.behind])

    def accelerations(self, side: FloatArray, rate: FloatArray, length: FloatArray) -> FloatArray:
        """Acceleration of a tread by the knots' factors, at the telling cells.

        With s the share of the tread in the rate r, it is ``s' r^2 + s (r^2)' / 2``.
        """
        square, safe = rate**2, np.where(length > 0, 2 * length, np.inf)
        turn, mean = np.diff(side), 0.5 * (side[1:] + side[:-1])
        first, last = (turn - mean) * square[:-1] / safe, (turn + mean) * square[1:] / safe
        now = first + last
        cells = []
        for pick in (np.argmax, np.argmin):
            for a, b in zip(self.knots[:-1], self.knots[1:], strict=True):
                cells.append(a + int(pick(now[a:b])))
        which = np.unique(np.append(cells, self.knots[1:] - 1))
        matrix = first[which, None] * self.hats[which] + last[which, None] * self.hats[which + 1]
        return np.asarray(matrix)


class _Windows(NamedTuple):
    """Windows of one side: from or to a point, over the energy that one window may hold.

    Parameters
    ----------
    side : int
        Left or right.
    forward : bool
        Whether they begin, or end, at the points.
    point : ndarray of int, shape (m,)
        The points.
    cell : ndarray of int, shape (m,)
        Cell in which the other end lies.
    part : ndarray, shape (m,)
        Where in the cell, as a fraction.
    lasts : ndarray, shape (m,)
        How long they last [s].
    least : float
        How long they must last [s].
    """

    side: int
    forward: bool
    point: NDArray[np.intp]
    cell: NDArray[np.intp]
    part: FloatArray
    lasts: FloatArray
    least: float

    @classmethod
    def found(cls, fine: _Fine, window: Window, side: int, forward: bool) -> _Windows:
        """Find the windows of a profile."""
        time, drawn = fine.time, fine.drawn[side]
        wanted = drawn + (window.energy if forward else -window.energy)
        point = np.flatnonzero((wanted <= drawn[-1]) & (wanted >= 0.0))
        goal = wanted[point]
        # Where nothing is drawn, the place nearest to the point.
        after = np.searchsorted(drawn, goal, side="left" if forward else "right")
        cell = np.clip(after - 1, 0, len(drawn) - 2)
        rise = drawn[cell + 1] - drawn[cell]
        way = np.divide(goal - drawn[cell], rise, out=np.ones_like(rise), where=rise > 0)
        first, last = fine.rate[cell], fine.rate[cell + 1]
        here = np.sqrt(np.maximum(first**2 + way * (last**2 - first**2), 0.0))
        part = _gone(way, first, here, last)
        place = time[cell] + part * (time[cell + 1] - time[cell])
        lasts = np.abs(place - time[point])
        return cls(side, forward, point, cell, part, lasts, window.time)

    def tightest(self, basis: _Basis, fine: _Fine, longest: float) -> _Windows:
        """Return the shortest window between any two knots, and the first one; none too long."""
        between = basis.behind[fine.cell[self.point]]
        order = np.lexsort((self.lasts, between))
        _, shortest = np.unique(between[order], return_index=True)
        _, first = np.unique(between, return_index=True)
        which = np.unique(np.append(order[shortest], first)).astype(int)
        which = which[self.lasts[which] < longest]
        return self._replace(
            point=self.point[which], cell=self.cell[which], part=self.part[which],
            lasts=self.lasts[which],
        )  # fmt: skip

    def rows(self, fine: _Fine, reached: Sequence[csr_array], power: float) -> csr_array:
        """Return how long the windows last by the program's unknowns, but for a constant.

        `reached` are the rows of time, and where they change those of the drawn energies.
        """
        sign = 1.0 if self.forward else -1.0
        change = self._across(reached[0])
        if len(reached) > 1:
            span, rise = np.diff(fine.time)[self.cell], np.diff(fine.drawn[self.side])[self.cell]
            # Seconds per joule where the window ends: more energy before it moves the end.
            pace = np.divide(span, rise, out=np.zeros_like(span), where=rise > 0)
            pace = np.minimum(pace, STEEP / power)
            change = change - _times(pace, self._across(reached[1 + self.side]))
        return csr_array(sign * change)

    def _across(self, rows: csr_array) -> csr_array:
        """Return what lies between the points and the windows' other ends."""
        there = _times(1 - self.part, rows[self.cell]) + _times(self.part, rows[self.cell + 1])
        return csr_array(there - rows[self.point])


class _Rows:
    """Rows of a linear program: unknowns at a present value, and what they must not exceed."""

    def __init__(self, now: FloatArray) -> None:
        self.now = now
        self._above: list[csr_array] = []
        self._limit: list[FloatArray] = []
        self._equal: list[csr_array] = []

    def below(self, rows: csr_array, limit: FloatArray) -> None:
        """Demand that rows do not exceed a limit."""
        self._above.append(rows)
        self._limit.append(limit)

    def unchanged(self, rows: csr_array) -> None:
        """Demand that rows stay what they are."""
        self._equal.append(rows)

    def solved(self, price: FloatArray, bounds: FloatArray) -> FloatArray:
        """Return the cheapest unknowns; the present ones where none were found."""
        equal = vstack(self._equal, format="csr")
        above = vstack(self._above, format="csr")
        # scipy's annotations know no sparse matrices.
        found = linprog(  # type: ignore[call-overload]
            price, above, np.concatenate(self._limit), equal, equal @ self.now, bounds
        )
        return self.now if found.x is None else np.asarray(found.x)


def _times(factor: FloatArray, rows: csr_array) -> csr_array:
    return csr_array(diags_array(factor) @ rows)


def _placed(width: int, *blocks: tuple[int, FloatArray]) -> csr_array:
    """Return a sparse matrix with blocks from given columns on."""
    parts, column = [], 0
    height = blocks[0][1].shape[0]
    for first, block in blocks:
        parts += [csr_array((height, first - column)), csr_array(block)]
        column = first + block.shape[1]
    return csr_array(hstack([*parts, csr_array((height, width - column))], format="csr"))
