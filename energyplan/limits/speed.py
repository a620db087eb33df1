"""Speed profiles: a `Path` timed into a `Trajectory` within the limits of motors and battery.

The tread speeds have to be continuous where the acceleration of the treads is limited. Where the
curvature jumps, at a corner between two arcs, before a spin or at a reversal, they can only be so
at a standstill: the robot stops there. Small jumps may be part of a smooth curve (`smooth`).

Inertia counts only if the model has inertia terms; the limit of acceleration holds in any case.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from energyplan.errors import InfeasibleMotionError, InvalidInputError, PathError
from energyplan.kinds import checked
from energyplan.limits._accept import accepted
from energyplan.limits._check import LimitedDrive, Survey
from energyplan.limits._timing import (
    Course,
    Grid,
    Phases,
    Sampled,
    joined,
    rounding,
    worth_rounding,
)
from energyplan.limits.acceleration_table import UNLIMITED, Ladder, Runs, drift_about
from energyplan.limits.curve import Curve, Points
from energyplan.limits.drive import Drive, Ground
from energyplan.limits.economy import Choice, Economy
from energyplan.limits.motor import ROUNDING, Limits
from energyplan.path import FloatArray, Path, Trajectory
from energyplan.power import PowerModel
from energyplan.terrain import HeightMap, SurfaceMap, laid_out
from energyplan.vehicle import Vehicle

RUNGS = 96
"""Rungs of the speed ladders; matters only where power or force limit the acceleration."""

SAME = 1e-9
"""Difference of the treads' shares in the speed below which two curvatures are one."""

SLOPED = 0.5
"""Length of the pieces in which the slope counts as constant while timing [m]."""

SLOWEST = 0.05
"""Slowest cruising speed that the least energy may ask for, over the motors' speed limit."""

FITTED = 0.5
"""Largest jump of a tread's share at which arcs that join poses count as one curve."""

CELLS, FINEST = 400, 0.002
"""Cells that the straights and arcs of a smooth curve are cut into, and their least length [m]."""

WARM, MOST, FEWEST = 24, 2000, 8
"""Cells per thermal window, cells at most, and cells of a section where the motors warm up."""

DEAREST = 1e6
"""Highest price of time that the search for a duration tries [W]."""


class Rounding(NamedTuple):
    """How corners are driven through; the arguments of that name of `profile`.

    Examples
    --------
    >>> corner_rounding(0.05)._fields
    ('smooth', 'tolerance')
    """

    smooth: float
    tolerance: float


def corner_rounding(tolerance: float) -> Rounding:
    """Return how a vehicle of that tracking tolerance [m] drives through corners.

    Without a tolerance it stops at corners, and drives through the small bends between poses that
    stand for a curve, within 5 mm.

    Examples
    --------
    >>> corner_rounding(0.05).tolerance
    0.05
    """
    return Rounding(1.0, tolerance) if tolerance > 0 else Rounding(FITTED, 0.005)


@checked()
def profile(
    path: Path,
    model: PowerModel,
    *,
    objective: Literal["time", "energy"] = "time",
    duration: float | None = None,
    vehicle: Vehicle | None = None,
    battery_power: float = np.inf,
    battery_return: float = np.inf,
    lateral_acceleration: float = np.inf,
    start_speed: float = 0.0,
    end_speed: float = 0.0,
    smooth: ArrayLike = 0.0,
    tolerance: float = 0.02,
    channels: Mapping[str, ArrayLike] | None = None,
    surfaces: SurfaceMap | None = None,
    heights: HeightMap | None = None,
    period: float = 0.05,
) -> Trajectory:
    """Time a path: in the least time, with the least energy, or in a given duration.

    Parameters
    ----------
    path : Path
        The path: arcs, straights, spins on the spot, forwards and backwards.
    model : PowerModel
        The power model. What counts as energy is its power: hand in `PowerModel.battery_side`
        for what the battery delivers.
    objective : {"time", "energy"}
        What to minimise. With a hotel load the least energy lies between the fastest and the
        slowest; where the model is static, speed cancels and the fastest of the cheapest is
        taken.
    duration : float, optional
        Time to take [s]: the profile of least energy that takes it, whatever the `objective`.
    vehicle : Vehicle, optional
        Whose limits apply; the model's own where not given.
    battery_power, battery_return : float
        Largest power that the battery delivers, and takes back [W], where it is less than the
        vehicle says.
    lateral_acceleration : float
        Largest ``|v omega|`` [m/s^2].
    start_speed, end_speed : float
        Speed of the faster tread at the start and at the end [m/s].
    smooth : array_like, shape () or (n - 1,)
        For all corners, or for each between two segments of the path. Corners at which the share of
        either tread in the speed of the faster one changes by no more than this count as part of a
        smooth curve and are driven through [1]. With 0 every change of curvature is a corner at
        which the robot stops; 0.5 suits paths fitted to poses; with 1 a straight goes over into a
        pivot without a stop. Reversals and spins are stops.
    tolerance : float
        How far the robot may leave the path where it drives through a corner [m].
    channels : mapping of str to array_like, shape () or (n,), optional
        Further channels that the model's terms read, one value per segment of the path or one
        for all, such as the ``slope`` along each segment [rad].
    surfaces : SurfaceMap, optional
        Grounds with power models of their own; `model` holds elsewhere. The speed is that of the
        most demanding ground on the path.
    heights : HeightMap, optional
        Heights of the ground; level where not given.
    period : float
        Largest time between two samples [s].

    Returns
    -------
    Trajectory
        The motion, sampled where its acceleration changes and at least every `period`; poses lie
        on the path exactly.

    Raises
    ------
    InfeasibleMotionError
        If no speed is feasible on some segment, the start or end speed is too high, or the
        duration is too short; the message says what would do.
    InvalidInputError
        If an option is out of range or nothing limits the speed.

    Notes
    -----
    On a stretch of constant curvature the least time is a closed form: full acceleration, top
    speed, full deceleration. Where inertia meets a power or force limit the acceleration follows
    that limit in 96 steps, always from the safe side. The least energy follows from the maximum
    principle at the same steps (docs/limits). The continuous power limit is kept in the least time
    by linear programs (`energyplan.limits.thermal`); else by lowering the peak power until the mean
    over every thermal window is within it, which is safe but not always the cheapest way.

    Examples
    --------
    >>> from energyplan.path import Pose
    >>> model = PowerModel.preset("quadriga:empty:concrete")
    >>> path = Path(Pose(0, 0, 0), ds=[2.4, 0.0], dtheta=[0.0, np.pi / 2])
    >>> round(profile(path, model).duration, 3)
    4.918

    References
    ----------
    Pham and Pham (2018), "A new approach to time-optimal path parameterization based on
    reachability analysis"; docs/theory, sections 2 and 3.
    """
    for name, value in (
        ("start_speed", start_speed), ("end_speed", end_speed), ("tolerance", tolerance),
    ):  # fmt: skip
        if not (np.isfinite(value) and value >= 0):
            raise InvalidInputError(f"{name} is {value}; give a number >= 0")
    rounded = np.asarray(smooth, float)
    if rounded.shape not in ((), (max(len(path) - 1, 0),)) or not np.all(rounded >= 0):
        raise InvalidInputError(
            f"smooth is {rounded.tolist()}; give a number >= 0, or one for each of the path's "
            f"{max(len(path) - 1, 0)} corners"
        )
    if objective not in ("time", "energy"):
        raise InvalidInputError(f"objective is {objective!r}; give 'time' or 'energy'")
    for name, value in (("period", period), ("duration", 1.0 if duration is None else duration)):
        if not (np.isfinite(value) and value > 0):
            raise InvalidInputError(f"{name} is {value} s; give a positive number")
    if not (path.ds.any() or path.dtheta.any()):
        raise PathError("the path has no length; a speed profile needs a segment that moves")
    limits = Limits.of(
        vehicle or model.vehicle,
        lateral_acceleration=lateral_acceleration,
        battery_power=battery_power,
        battery_return=battery_return,
    )
    model, surfaces, heights = laid_out(model, _about(path), surfaces, heights)
    known, ground = dict(channels or {}), Ground(model, surfaces, heights)
    if heights is not None:
        most = max(SLOPED, 0.5 * heights.resolution), 0.2
        if rounded.ndim:
            each = zip(path.ds, path.dtheta, strict=True)
            parts = [len(Path(path.start, ds, turn).subdivide(*most)) for ds, turn in each]
            rounded = np.repeat(np.append(rounded, 0.0), parts)[:-1]
            last = np.cumsum(parts)[:-1] - 1
            rounded[last] = np.asarray(smooth, float)
        path = path.subdivide(*most)
        known["slope"] = heights.slopes(path)
    task = _Task.build(
        path, ground.leading(path), limits, known, rounded, tolerance, (start_speed, end_speed)
    )

    def solve(within: Limits) -> Sampled:
        return task.sampled(within, objective, duration, period)

    def survey(sampled: Sampled) -> Survey:
        along = {name: value[task.kinds[sampled.run]] for name, value in task.runs.channels.items()}
        if heights is not None:
            del along["slope"]
        drive = Drive(sampled.trajectory, ground, along)
        return LimitedDrive(drive, limits).survey()

    hasty = objective == "time" and duration is None
    cool = partial(task.cool, duration) if limits.motor.thermal_time > 0 else None
    return accepted(solve, survey, limits, cool, hasty)


def _about(path: Path) -> FloatArray:
    """Return two corners between which a path lies wherever it turns, shape (2, 2) [m]."""
    return np.asarray(path.start[:2]) + np.array([[-1.0], [1.0]]) * path.length


@dataclass(frozen=True)
class _Task:
    """A path cut into runs, the kinds of runs, and the limits."""

    course: Course
    runs: Runs
    kinds: NDArray[np.int_]

    @classmethod
    def build(
        cls,
        path: Path,
        model: PowerModel,
        limits: Limits,
        channels: Mapping[str, ArrayLike],
        smooth: ArrayLike,
        tolerance: float,
        ends: tuple[float, float],
    ) -> _Task:
        icr, count = model.vehicle.icr, len(path)
        columns = {}
        for name, value in channels.items():
            if np.shape(value) not in ((), (count,)):
                raise InvalidInputError(
                    f"channel {name!r} has shape {np.shape(value)}; give one value, or one for "
                    f"each of the path's {count} segments"
                )
            columns[name] = np.broadcast_to(np.asarray(value, float), (count,))
        # What rounding leaves of a turn on a straight, or of the slower tread in a pivot, is none.
        dtheta = np.where(
            np.abs(path.dtheta) * icr.slip_track < SAME * np.abs(path.ds), 0.0, path.dtheta
        )
        left, right = path.ds - icr.left * dtheta, path.ds + icr.right * dtheta
        length = np.maximum(np.abs(left), np.abs(right))
        moves = length > 1e-12 * length.max()
        share = np.column_stack([left[moves], right[moves]]) / length[moves, None]
        given = np.column_stack([np.zeros(count), *columns.values()])[moves]
        # Neighbours of one curvature and one set of channels are one run.
        fresh = np.any(np.abs(np.diff(share, axis=0)) > SAME, axis=1)
        fresh |= np.any(np.diff(given, axis=0) != 0, axis=1)
        begin = np.flatnonzero(np.append(True, fresh))
        whole = Path(
            path.start,
            np.add.reduceat(path.ds[moves], begin),
            np.add.reduceat(dtheta[moves], begin),
            path.longitudinal,
        )
        length = np.add.reduceat(length[moves], begin)
        share, given = share[begin], given[begin]
        jump = np.max(np.abs(np.diff(share, axis=0)), axis=1, initial=0.0)
        # The faster tread cannot turn round at a jump of 1 or less.
        largest = np.minimum(smooth, 1.0) if tolerance > 0 else np.zeros(())
        if largest.ndim:
            largest = largest[np.flatnonzero(moves)[begin[1:]] - 1]
        through = (jump > SAME) & (jump <= largest + SAME)
        shape = np.column_stack([whole.ds / length, whole.dtheta / length])
        reach = rounding(length, shape, tolerance)
        most = min(limits.motor.acceleration, UNLIMITED)
        through &= worth_rounding(length, reach, jump, most, SLOWEST * limits.motor.speed)
        corner = np.concatenate([ends[:1], np.where((jump <= SAME) | through, np.inf, 0), ends[1:]])
        drift = drift_about(reach, shape, jump * through)
        features = np.column_stack([shape, given, drift])
        _, first, kinds = np.unique(
            features.round(9), axis=0, return_index=True, return_inverse=True
        )
        kind = features[first]
        names = dict(zip(columns, kind.T[3:-4], strict=True))
        runs = Runs(kind[:, 0], kind[:, 1], kind[:, -4:].T, model, names)
        course = Course(whole, length, corner, through, tolerance)
        return cls(course, runs, kinds.reshape(-1))

    def sampled(
        self, limits: Limits, objective: str, duration: float | None, period: float
    ) -> Sampled:
        """Return the trajectory that meets the objective, or takes the duration."""
        course = self.course
        if objective != "time" or duration is not None or not course.through.any():
            return course.sample(self.phases(limits, objective, duration), period)
        parts, first = [], [0]
        for section in course.sections():
            runs = slice(first[-1], first[-1] + len(section.length))
            if section.through.any():
                grid = section.grid(max(float(section.length.sum()) / CELLS, FINEST))
                curve = self._curve(section, grid, runs, limits)
                parts.append(section.at_points(grid, curve.fastest(curve.cap)))
            else:
                # Where nothing is rounded there is no change of curvature to pay for.
                straight = replace(self.runs, drift=np.zeros_like(self.runs.drift))
                task = replace(self, course=section, kinds=self.kinds[runs], runs=straight)
                parts.append(section.sample(task.phases(limits, objective, None), period))
            first.append(runs.stop)
        made = joined(parts, first[:-1])
        self._check_ends(*(self._rates(made)[[0, -1]]))
        return made

    def _rates(self, sampled: Sampled) -> FloatArray:
        made, icr = sampled.trajectory, self.runs.model.vehicle.icr
        left, right = made.v - icr.left * made.omega, made.v + icr.right * made.omega
        return np.maximum(np.abs(left), np.abs(right))

    def _curve(self, section: Course, grid: Grid, part: slice, limits: Limits) -> Curve:
        """Return the points of a section with their largest steady rates."""
        kinds = self.kinds[part][grid.run]
        known = {name: value[kinds] for name, value in self.runs.channels.items()}
        forward, turn = grid.shape.T
        runs = Runs(forward, turn, np.zeros((4, len(turn))), self.runs.model, known)
        cap = runs.top_rate(limits)
        cap[[0, -1]] = np.minimum(cap[[0, -1]], section.corner[[0, -1]])
        points = Points(forward, turn, grid.cell, known)
        return Curve(points, self.runs.model, limits, cap)

    def cool(self, duration: float | None, limits: Limits) -> Sampled:
        """Return a trajectory of least time within the continuous power too, or so slowed down."""
        from energyplan.limits.thermal import Thermal  # slow to import, and rarely needed

        whole, parts, first = float(self.course.length.sum()), [], [0]
        cells = float(np.clip(WARM * self._windows(limits), CELLS, MOST))
        for section in self.course.sections():
            runs = slice(first[-1], first[-1] + len(section.length))
            length = float(section.length.sum())
            grid = section.grid(length / max(cells * length / whole, FEWEST))
            parts.append((section, grid, self._curve(section, grid, runs, limits)))
            first.append(runs.stop)
        rates = Thermal([curve for *_, curve in parts]).rates()

        def driven(share: float) -> Sampled:
            pieces = zip(parts, rates, strict=True)
            sampled = [section.at_points(grid, share * rate) for (section, grid, _), rate in pieces]
            return joined(sampled, first[:-1])

        made = driven(1.0)
        if duration is not None:
            share = made.trajectory.duration / duration
            if share > 1 + ROUNDING:
                raise InfeasibleMotionError(
                    f"within the motors' continuous power of {limits.motor.continuous_power:g} W "
                    f"the path takes {made.trajectory.duration:.6g} s; {duration:g} s is too short"
                )
            made = driven(share)
        self._check_ends(*(self._rates(made)[[0, -1]]))
        return made

    def _windows(self, limits: Limits) -> float:
        """Energy that a side draws along the path, over what one thermal window may hold."""
        motor, slow = limits.motor, 1e-3 * np.ones(len(self.runs.turn))
        motion = self.runs.motion(slow)
        forces = self.runs.model.forces(motion)
        sides = np.stack([forces.left * motion.v_left, forces.right * motion.v_right]) / slow
        drawn = np.maximum(sides, 0.0)[:, self.kinds] @ self.course.length
        return float(drawn.max() / (motor.continuous_power * motor.thermal_time))

    def phases(self, limits: Limits, objective: str, duration: float | None) -> Phases:
        """Return the phases that meet the objective, or take the duration."""
        fastest = Ladder.fastest(self.runs, limits, RUNGS)
        quick = Choice(fastest.take(self.kinds), fastest.rate[-1, self.kinds])
        best = self._drive(quick)
        self._check_ends(best.rate[0], best.rate[-1] + best.gain[-1] * best.time[-1])
        if objective == "time" and duration is None:
            return best
        if duration is not None and duration < best.duration * (1 - ROUNDING):
            raise InfeasibleMotionError(
                f"the path takes {best.duration:.6g} s at least; {duration:g} s is too short"
            )
        top = limits.motor.speed if np.isfinite(limits.motor.speed) else float(fastest.rate.max())
        economy = Economy(self.runs, fastest, SLOWEST * top)
        if duration is None:
            return self._drive(self._choice(economy, 0.0))
        return self._lasting(economy, quick, duration)

    def _choice(self, economy: Economy, price: float) -> Choice:
        still = (self.course.corner[:-1] == 0) & (self.course.corner[1:] == 0)
        return economy.choose(price, self.kinds, np.where(still, self.course.length, np.inf))

    def _drive(self, choice: Choice, cap: float = np.inf) -> Phases:
        return self.course.phases(choice.ladder, np.minimum(choice.cruise, cap))

    def _check_ends(self, first: float, last: float) -> None:
        for name, wanted, found in (
            ("start_speed", self.course.corner[0], first),
            ("end_speed", self.course.corner[-1], last),
        ):
            if found < wanted * (1 - 1e-6) - 1e-9:
                raise InfeasibleMotionError(
                    f"{name} {wanted:g} m/s is too high for this path and its limits; "
                    f"{found:.4g} m/s is the most"
                )

    def _lasting(self, economy: Economy, quick: Choice, duration: float) -> Phases:
        """Search the price of time, then a cap on the speed, until the duration fits."""
        from scipy.optimize import brentq  # slow to import, and rarely needed

        best, longest = quick, 0.0

        def excess(logprice: float) -> float:
            nonlocal best, longest
            tried = self._choice(economy, float(np.sinh(logprice)))
            taken = self._drive(tried).duration
            if longest < taken <= duration:
                best, longest = tried, taken
            return float(np.log(taken / duration))

        top = float(np.arcsinh(DEAREST))
        if excess(top) < 0 < excess(-top):
            brentq(excess, -top, top, xtol=1e-3)

        # What remains is a jump between two choices: slow the faster one down evenly.
        def late(cap: float) -> float:
            return float(np.log(self._drive(best, cap).duration / duration))

        fast = float(best.cruise.max())
        slow = 0.5 * fast
        while late(slow) < 0:
            slow *= 0.5
        if late(fast) >= 0:
            return self._drive(best)
        return self._drive(best, brentq(late, slow, fast, xtol=1e-15, rtol=1e-13))
