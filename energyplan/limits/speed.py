"""Speed profiles: a `Path` timed into a `Trajectory` within the limits of motors and battery.

The tread speeds have to be continuous where the acceleration of the treads is limited. Where the
curvature jumps, at a corner between two arcs, before a spin or at a reversal, they can only be so
at a standstill: the robot stops there. Small jumps may be part of a smooth curve (`smooth`).

Inertia counts only if the model has inertia terms; the limit of acceleration holds in any case.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from energyplan.errors import InfeasibleMotionError, InvalidInputError, PathError
from energyplan.limits.course import SETTINGS, Course, Points, Sampled, times
from energyplan.limits.drive import Drive, Ground
from energyplan.limits.feasibility import LimitedDrive, Survey, Thermal
from energyplan.limits.motor import ROUNDING, Limits
from energyplan.limits.reach import UNLIMITED, Reach
from energyplan.path import FloatArray, Path, Pose, Trajectory
from energyplan.power import PowerModel
from energyplan.records import checked
from energyplan.terrain import HeightMap, SurfaceMap, laid_out
from energyplan.vehicle import Vehicle

GROUND_SPEED = "ground_speed"
"""Channel that holds the speed limit of the ground under a segment [m/s]; 0 where there is none."""


class Rounding(NamedTuple):
    """How corners are driven through; the arguments of that name of `profile`."""

    smooth: float
    tolerance: float


def corner_rounding(tolerance: float) -> Rounding:
    """Return how a vehicle of that tracking tolerance [m] drives through corners.

    Without a tolerance it stops at corners, and drives through the small bends between poses that
    stand for a curve, within 5 mm.
    """
    return Rounding(1.0, tolerance) if tolerance > 0 else Rounding(SETTINGS.fitted, 0.005)


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
        most demanding ground on the path, and keeps the surfaces' speed limits: none is exceeded
        by the speed along the heading while the reference point (see `Path`) lies in its area.
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
    The path is cut into cells; the least time follows from one pass backwards and one forwards over
    them. The least energy is that of the cheapest steady speeds, reached with full acceleration; a
    given duration is met by a price on time (docs/limits). Where the continuous power limit does
    not hold, the robot drives slower in the thermal windows that are too warm.

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
    lasting = 1.0 if duration is None else duration
    for name, value, least in (
        ("start_speed", start_speed, "number >= 0"), ("end_speed", end_speed, "number >= 0"),
        ("tolerance", tolerance, "number >= 0"), ("period", period, "positive number"),
        ("duration", lasting, "positive number"),
    ):  # fmt: skip
        if not (np.isfinite(value) and (value > 0 or (value == 0 and least == "number >= 0"))):
            raise InvalidInputError(f"{name} is {value}; give a {least}")
    rounded = np.asarray(smooth, float)
    if rounded.shape not in ((), (max(len(path) - 1, 0),)) or not np.all(rounded >= 0):
        raise InvalidInputError(
            f"smooth is {rounded.tolist()}; give a number >= 0, or one for each of the path's "
            f"{max(len(path) - 1, 0)} corners"
        )
    if objective not in ("time", "energy"):
        raise InvalidInputError(f"objective is {objective!r}; give 'time' or 'energy'")
    if not (path.ds.any() or path.dtheta.any()):
        raise PathError("the path has no length; a speed profile needs a segment that moves")
    limits = Limits.of(
        vehicle or model.vehicle,
        lateral_acceleration=lateral_acceleration,
        battery_power=battery_power,
        battery_return=battery_return,
    )
    ground = Ground(*laid_out(model, _about(path), surfaces, heights))
    cut = _cut(path, ground, rounded, channels or {})
    speeds = start_speed, end_speed
    gain = min(limits.motor.acceleration, UNLIMITED)
    course = Course.of(
        cut.path, ground.model.vehicle.icr, cut.channels, cut.smooth, tolerance, speeds, gain,
        limits.motor.speed,
    )  # fmt: skip
    top = limits.motor.speed if np.isfinite(limits.motor.speed) else 1.0
    task = _Task(course, course.points(top**2 / (2.0 * gain)), ground.leading(cut.path), speeds)
    known = {name: course.channels[name] for name in channels or {}}
    if ground.heights is not None:
        known.pop("slope", None)  # that at each instant holds instead

    def survey(sampled: Sampled) -> Survey:
        along = {name: value[sampled.run] for name, value in known.items()}
        return LimitedDrive(Drive(sampled.trajectory, ground, along), limits).survey()

    found = _within(partial(task.solved, objective, duration, period), survey, limits)
    if found.hot:
        found = _within(partial(task.cooled, duration, period, survey), survey, found.limits)
    return found.sampled.trajectory


class _Cut(NamedTuple):
    """A path whose segments have each one slope and one speed limit of the ground."""

    path: Path
    smooth: FloatArray  # () or (n - 1,): as in `profile`
    channels: dict[str, ArrayLike]  # () or (n,): with the slope and the speed limit


def _cut(path: Path, ground: Ground, smooth: FloatArray, channels: Mapping[str, ArrayLike]) -> _Cut:
    """Cut the segments of a path at borders of speed limits, and so that each has one slope."""
    surfaces, heights, known = ground.surfaces, ground.heights, dict(channels)
    if heights is None and not ground.has_speed_limits:
        return _Cut(path, smooth, known)
    parts = []
    for pose, ds, turn in zip(path.vertices, path.ds, path.dtheta, strict=False):
        part = Path(Pose(*pose), np.array([ds]), np.array([turn]), path.longitudinal)
        if surfaces is not None and surfaces.speed_limits:
            part = surfaces.cut_at_limits(part)
        if heights is not None:
            part = part.subdivide(max(SETTINGS.sloped, 0.5 * heights.resolution), 0.2)
        parts.append(part)
    count = [len(part) for part in parts]
    if smooth.ndim:
        corners, smooth = smooth, np.repeat(np.append(smooth, 0.0), count)[:-1]
        smooth[np.cumsum(count)[:-1] - 1] = corners
    for name, value in channels.items():
        if np.shape(value) == (len(path),):
            known[name] = np.repeat(np.asarray(value), count)
    ds, dtheta = (np.concatenate([getattr(p, of) for p in parts]) for of in ("ds", "dtheta"))
    path = Path(path.start, ds, dtheta, path.longitudinal)
    if heights is not None:
        known["slope"] = heights.slopes(path)
    if ground.has_speed_limits:
        halves = Path(path.start, np.repeat(ds / 2, 2), np.repeat(dtheta / 2, 2), path.longitudinal)
        top = ground.top_speed(halves.vertices[1::2])
        known[GROUND_SPEED] = np.where(np.isfinite(top), top, 0.0)
    return _Cut(path, smooth, known)


def _about(path: Path) -> FloatArray:
    """Return two corners between which a path lies wherever it turns, shape (2, 2) [m]."""
    return np.asarray(path.start[:2]) + np.array([[-1.0], [1.0]]) * path.length


@dataclass(frozen=True)
class _Task:
    """Points along a path, and what counts as energy there."""

    course: Course
    points: Points
    model: PowerModel
    ends: tuple[float, float]

    def reach(self, limits: Limits) -> Reach:
        """Return the points within limits, at rest where the robot stops."""
        corner = np.full(len(self.points.at), np.inf)
        stops = np.flatnonzero(self.points.cell == 0)
        corner[stops] = corner[stops + 1] = 0.0
        corner[[0, -1]] = self.ends
        if GROUND_SPEED in self.points.channels:
            np.minimum(corner, limits.ground_speed * self._ground_speed(), out=corner)
        return Reach(self.points, self.model, limits, corner)

    def _ground_speed(self) -> FloatArray:
        """Largest rate at each point that the ground under both of its cells allows [m/s]."""
        points = self.points
        here = np.asarray(points.channels[GROUND_SPEED])
        here = np.where(here > 0, here, np.inf)
        # A cell lies on the run of its end; one that bends from run to run lies on both.
        cell = np.where(points.bent, np.minimum(here[:-1], here[1:]), here[1:])
        least: FloatArray = np.minimum(np.append(here[0], cell), np.append(cell, here[-1]))
        forward = np.abs(points.forward)
        rate: FloatArray = np.divide(
            least, forward, out=np.full_like(least, np.inf), where=forward > 0
        )
        return rate

    def duration(self, rate: FloatArray) -> float:
        """Time that the path takes at given rates [s]."""
        return float(times(self.points.cell, rate).sum())

    def solved(
        self, objective: str, duration: float | None, period: float, limits: Limits
    ) -> Sampled:
        """Return the trajectory that meets the objective, or takes the duration."""
        reach = self.reach(limits)
        rate = reach.fastest(reach.top)
        self._check_ends(rate)
        if duration is not None:
            rate = self._lasting(reach, rate, duration)
        elif objective == "energy":
            rate = self._slowed(reach, rate, self._cheapest(reach, 0.0))
        return self.course.timed(self.points, rate, period)

    def _cheapest(self, reach: Reach, price: float) -> FloatArray:
        top = reach.limits.motor.speed
        top = top if np.isfinite(top) else float(reach.top.max())
        return reach.cheapest(price, SETTINGS.slowest * top)

    def _slowed(self, reach: Reach, fast: FloatArray, cap: FloatArray) -> FloatArray:
        """Return the greatest rates within caps that leave the speeds at both ends as given."""
        if any(self.ends):
            way = np.append(0.0, np.cumsum(self.points.cell))
            most = 0.9 * min(reach.limits.motor.acceleration, UNLIMITED)
            for end, along in zip(self.ends, (way, way[-1] - way), strict=True):
                slowing = np.sqrt(np.maximum(end**2 - 2 * most * along, 0.0))
                cap = np.maximum(cap, np.minimum(slowing, fast))
            rate = reach.fastest(cap)
            if np.allclose(rate[[0, -1]], fast[[0, -1]], rtol=ROUNDING):
                return rate
            cap = reach.top  # braking to the cheapest rate is beyond some limit
        return reach.fastest(cap)

    def _lasting(self, reach: Reach, fast: FloatArray, duration: float) -> FloatArray:
        """Search the price of time, then slow all down, until the duration fits."""
        least = self.duration(fast)
        if duration < least * (1 - ROUNDING):
            raise InfeasibleMotionError(
                f"the path takes {least:.6g} s at least; {duration:g} s is too short"
            )
        best, longest = reach.top, least

        def excess(price: float) -> float:
            nonlocal best, longest
            tried = self._cheapest(reach, float(np.sinh(price)))
            taken = self.duration(self._slowed(reach, fast, tried))
            if longest < taken <= duration:
                best, longest = tried, taken
            return float(np.log(taken / duration))

        from scipy.optimize import brentq  # slow to import, and rarely needed

        top = float(np.arcsinh(SETTINGS.dearest))
        if excess(top) < 0 < excess(-top):
            brentq(excess, -top, top, xtol=1e-2)

        # What remains is a jump between two choices: slow the faster one down evenly.
        if not any(self.ends):
            return self._slowed(reach, fast, best) * longest / duration

        def capped(most: float) -> FloatArray:
            return self._slowed(reach, fast, np.minimum(best, most))

        def late(most: float) -> float:
            return float(np.log(self.duration(capped(most)) / duration))

        high = float(best[np.isfinite(best)].max())
        low = 0.5 * high
        while late(low) < 0:
            low *= 0.5
        return capped(high if late(high) >= 0 else brentq(late, low, high, xtol=1e-12, rtol=1e-10))

    def _check_ends(self, rate: FloatArray) -> None:
        for name, wanted, found in zip(
            ("start_speed", "end_speed"), self.ends, rate[[0, -1]], strict=True
        ):
            if found < wanted * (1 - 1e-6) - 1e-9:
                raise InfeasibleMotionError(
                    f"{name} {wanted:g} m/s is too high for this path and its limits; "
                    f"{found:.4g} m/s is the most"
                )

    def cooled(
        self,
        duration: float | None,
        period: float,
        survey: Callable[[Sampled], Survey],
        limits: Limits,
    ) -> Sampled:
        """Return a trajectory within the continuous power too: slower where windows are warm.

        Each point is slowed by the warmest window over it, and quickened where that is cold,
        until the former are as warm as they may be.
        """
        reach = self.reach(limits)
        fast = reach.fastest(reach.top)
        section = np.append(0, np.cumsum(self.points.cell == 0))
        quickest = np.zeros(section[-1] + 1)
        np.maximum.at(quickest, section, fast)
        most = np.minimum(reach.top, quickest[section])
        level, best, least = most, fast, np.inf
        for _ in range(SETTINGS.rounds):
            rate = self._slowed(reach, fast, np.minimum(most, level))
            clock = np.append(0.0, np.cumsum(times(self.points.cell, rate)))
            found = survey(self.course.timed(self.points, rate, period))
            share = min(1.0, found.thermal.scale(limits.motor))
            if found.hot and clock[-1] < least * share:  # all a little slower may do
                even = rate * share * (1 - SETTINGS.margin)
                if not survey(self.course.timed(self.points, even, period)).hot:
                    best, least = even, self.duration(even)
            if not found.hot and clock[-1] < least:
                best, least = rate, float(clock[-1])
            warmth = _warmth(found.thermal, limits, clock)
            warmth *= found.warmth / warmth.max()
            level = np.minimum(level * warmth**-SETTINGS.damping, most)
        if not np.isfinite(least):
            raise InfeasibleMotionError(
                f"the motors' continuous power of {limits.motor.continuous_power:g} W does not "
                "suffice in any profile that was tried; allow more time or take a longer way round"
            )
        self._check_ends(best)
        if duration is not None:
            if least > duration * (1 + ROUNDING):
                raise InfeasibleMotionError(
                    f"within the motors' continuous power of {limits.motor.continuous_power:g} W "
                    f"the path takes {least:.6g} s; {duration:g} s is too short"
                )
            best = best * least / duration
        return self.course.timed(self.points, best, period)


def _warmth(thermal: Thermal, limits: Limits, clock: FloatArray) -> FloatArray:
    """Warmest window over each instant of `clock`, over what the motors can keep up."""
    from scipy.ndimage import maximum_filter1d  # slow to import, and rarely needed

    window, motor = limits.motor.thermal_time, limits.motor
    step = min(window / 50, float(clock[-1]) / 1000)
    ends = np.arange(0.0, clock[-1] + window + step, step)
    size = max(int(np.ceil(window / step)), 1)
    warm = np.zeros(len(ends))
    since = thermal.t - thermal.t[0]
    for power in thermal.drawn:
        pieces = 0.5 * (power[1:] + power[:-1]) * np.diff(since)
        drawn = np.append(0.0, np.cumsum(pieces))
        mean = np.interp(ends, since, drawn) - np.interp(ends - window, since, drawn)
        warm = np.maximum(warm, mean / (window * motor.continuous_power))
    after = maximum_filter1d(warm, size + 1, origin=-((size + 1) // 2), mode="nearest")
    return np.interp(clock, ends, after)


class _Found(NamedTuple):
    """A profile with the limits that it was made for, and whether the motors get too warm."""

    limits: Limits
    sampled: Sampled
    hot: bool


def _within(
    solve: Callable[[Limits], Sampled], survey: Callable[[Sampled], Survey], limits: Limits
) -> _Found:
    """Tighten limits until `check` finds none exceeded but the continuous power.

    Across smooth corners, on other grounds and on slopes that change, a limit may be exceeded a
    little; it is tightened by as much.
    """
    tight, gentle = limits, 1.0
    for k in range(SETTINGS.tries):
        try:
            sampled = solve(tight)
        except InfeasibleMotionError:
            if tight is limits or gentle < 0.2:
                raise
            # Within the tightened limits nothing moves: go easy on all that speed brings about.
            gentle *= 0.9
            tight = _gentler(limits, gentle)
            continue
        found = survey(sampled)
        worst: dict[str, float] = {}
        for one in found.violations:
            excess = one.peak / one.limit if one.limit > 0 else np.inf
            worst[one.kind] = max(worst.get(one.kind, 1.0), excess)
        worst.pop("continuous_power", None)
        if not worst:
            return _Found(tight, sampled, found.hot)
        if max(worst.values()) == np.inf or k >= SETTINGS.tries // 2:
            # The limit itself, lowered, does not help: less of everything does.
            gentle *= 0.9
            tight = _gentler(limits, gentle)
            continue
        tight = _tightened(tight, worst)
    first = found.violations[0]
    raise InfeasibleMotionError(
        f"no profile that keeps every limit was found: {first.bound.describe(first.peak)} at "
        f"{first.start:.3g} s; allow a little more of it"
    )


def _tightened(limits: Limits, excess: Mapping[str, float]) -> Limits:
    """Return limits that are lower by the factors by which they were exceeded."""
    motor = limits.motor
    for kind, factor in excess.items():
        of = motor if hasattr(motor, kind) else limits
        lower = {kind: getattr(of, kind) / (factor * (1 + ROUNDING))}
        if kind == "peak_power":
            lower["continuous_power"] = min(motor.continuous_power, lower[kind])
        if of is motor:
            motor = replace(motor, **lower)
        else:
            limits = replace(limits, **lower)
    return replace(limits, motor=motor)


def _gentler(limits: Limits, factor: float) -> Limits:
    """Return limits with lower accelerations and speeds."""
    motor = limits.motor
    motor = replace(motor, speed=motor.speed * factor, acceleration=motor.acceleration * factor**2)
    lateral = limits.lateral_acceleration * factor**2
    return replace(limits, motor=motor, lateral_acceleration=lateral)
