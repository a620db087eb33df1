"""Speed profiles: a `Path` timed into a `Trajectory` within the limits of motors and battery.

The tread speeds have to be continuous where the acceleration of the treads is limited. Where the
curvature jumps, at a corner between two arcs, before a spin or at a reversal, they can only be so
at a standstill: the robot stops there. Small jumps may be part of a smooth curve (`smooth`).

Inertia counts only if the model has inertia terms; the limit of acceleration holds in any case.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from energyplan.errors import InfeasibleMotionError, InvalidInputError, PathError
from energyplan.limits.course import SETTINGS, Course, Points, times
from energyplan.limits.drive import Ground
from energyplan.limits.feasibility import Thermal
from energyplan.limits.motor import Limits
from energyplan.limits.reach import UNLIMITED, Reach, over
from energyplan.path import ROUNDING, FloatArray, Path, Pose, Trajectory
from energyplan.power import PowerModel
from energyplan.records import Within, checked
from energyplan.terrain import HeightMap, SurfaceMap, laid_out
from energyplan.vehicle import Vehicle

GROUND_SPEED = "ground_speed"
"""Channel that holds the speed limit of the ground under a segment [m/s]."""


TreadSpeed = Annotated[float, Within((0, 50), (0, 50), "m/s")]


class Rounding(NamedTuple):
    """How corners are driven through; the arguments of that name of `profile`."""

    smooth: float
    tolerance: float


def corner_rounding(tolerance: float) -> Rounding:
    """Return how a vehicle of that tracking tolerance [m] drives through corners.

    Without a tolerance it stops at corners, and drives through the small bends between poses that
    approximate a curve, within 5 mm.
    """
    return Rounding(1.0, tolerance) if tolerance > 0 else Rounding(SETTINGS.fitted, 0.005)


@checked()
def profile(
    path: Path,
    model: PowerModel,
    *,
    objective: Literal["time", "energy"] = "time",
    duration: Annotated[float, Within((1e-6, 1e9), (1e-6, 1e9), "s")] | None = None,
    time_value: Annotated[float, Within((0, 1e9), (0, 1e6), "J/s")] = 0.0,
    vehicle: Vehicle | None = None,
    battery_power: float = np.inf,
    battery_return: float = np.inf,
    lateral_acceleration: float = np.inf,
    start_speed: TreadSpeed = 0.0,
    end_speed: TreadSpeed = 0.0,
    smooth: ArrayLike = 0.0,
    tolerance: Annotated[float, Within((0, 10), (0, 10), "m")] = 0.02,
    channels: Mapping[str, ArrayLike] | None = None,
    surfaces: SurfaceMap | None = None,
    heights: HeightMap | None = None,
    period: Annotated[float, Within((1e-6, 1e4), (1e-6, 1e4), "s")] = 0.05,
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
        chosen.
    duration : float, optional
        Time to take [s]: the profile of least energy that takes it, whatever the `objective`.
    time_value : float
        What a second counts beside the energy, where the `objective` is the energy [J/s].
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
        Surfaces with power models of their own, which limit and price the speed there; `model`
        holds elsewhere. The surfaces' speed limits hold for the speed along the heading while the
        reference point (see `Path`) lies in their area.
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
    them, and every limit is tested at the samples of the trajectory. The least energy is that of
    the cheapest steady speeds, reached with full acceleration; a given duration is met by a price
    on time (docs/limits). Where the continuous power limit does not hold, the robot drives slower
    in the thermal windows that are too warm.

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
    corners = np.asarray(smooth, float)
    _check_options(path, objective, corners)
    limits = Limits.of(
        vehicle or model.vehicle,
        lateral_acceleration=lateral_acceleration,
        battery_power=battery_power,
        battery_return=battery_return,
    )
    about = np.asarray(path.start[:2]) + np.array([[-1.0], [1.0]]) * path.length
    ground = Ground(*laid_out(model, about, surfaces, heights))
    cut = _cut_at_limits(path, ground, corners, channels or {})
    ends = start_speed, end_speed
    course = Course.of(
        cut.path, ground.model.vehicle.icr, cut.channels, cut.smooth, tolerance, ends,
        min(limits.motor.acceleration, UNLIMITED), limits.motor.speed,
    )  # fmt: skip
    timing = _Timing(_reach(course, ground, limits, channels or {}, period), ends)
    rate = timing.rates(objective, duration, time_value)
    found = timing.reach.survey(rate)
    if found.hot:
        rate = timing.cooled(duration)
        found = timing.reach.survey(rate)
    if found.violations:
        first = found.violations[0]
        raise InfeasibleMotionError(
            f"no profile that keeps every limit was found: {first.bound.describe(first.peak)} at "
            f"{first.start:.3g} s; allow a little more of it"
        )
    return timing.reach.sampled(rate).trajectory


def _check_options(path: Path, objective: str, corners: FloatArray) -> None:
    """Refuse options that `profile` cannot use."""
    count = max(len(path) - 1, 0)
    if corners.shape not in ((), (count,)) or not np.all(corners >= 0):
        raise InvalidInputError(
            f"smooth is {corners.tolist()}; give a number >= 0, or one for each of the path's "
            f"{count} corners"
        )
    if objective not in ("time", "energy"):
        raise InvalidInputError(f"objective is {objective!r}; give 'time' or 'energy'")
    if not (path.ds.any() or path.dtheta.any()):
        raise PathError("the path has no length; a speed profile needs a segment that moves")


class _Cut(NamedTuple):
    """A path whose segments have each one speed limit of the ground."""

    path: Path
    smooth: FloatArray  # () or (n - 1,): as in `profile`
    channels: dict[str, ArrayLike]  # () or (n,): with the speed limit


def _cut_at_limits(
    path: Path, ground: Ground, smooth: FloatArray, channels: Mapping[str, ArrayLike]
) -> _Cut:
    """Cut the segments of a path at borders of speed limits."""
    known = dict(channels)
    if ground.surfaces is None or not ground.has_speed_limits:
        return _Cut(path, smooth, known)
    parts = [
        ground.surfaces.cut_at_limits(Path(Pose(*pose), ds, turn, path.longitudinal))
        for pose, ds, turn in zip(
            path.vertices, path.ds[:, None], path.dtheta[:, None], strict=False
        )
    ]
    count = [len(part) for part in parts]
    if smooth.ndim:
        corners, smooth = smooth, np.repeat(np.append(smooth, 0.0), count)[:-1]
        smooth[np.cumsum(count)[:-1] - 1] = corners
    for name, value in channels.items():
        if np.shape(value) == (len(path),):
            known[name] = np.repeat(np.asarray(value), count)
    ds, dtheta = (np.concatenate([getattr(p, of) for p in parts]) for of in ("ds", "dtheta"))
    halves = Path(path.start, np.repeat(ds / 2, 2), np.repeat(dtheta / 2, 2), path.longitudinal)
    known[GROUND_SPEED] = ground.top_speed(halves.vertices[1::2])
    return _Cut(Path(path.start, ds, dtheta, path.longitudinal), smooth, known)


def _reach(
    course: Course, ground: Ground, limits: Limits, channels: Mapping[str, ArrayLike], period: float
) -> Reach:
    """Return points along a path with their limits; the robot is at rest where it stops."""
    top = limits.motor.speed if np.isfinite(limits.motor.speed) else 1.0
    points = course.points(top**2 / (2.0 * min(limits.motor.acceleration, UNLIMITED)))
    corner = np.full(len(points.at), np.inf)
    stops = np.flatnonzero(points.cell == 0)
    corner[stops] = corner[stops + 1] = 0.0
    corner[[0, -1]] = course.corner[[0, -1]]
    if GROUND_SPEED in points.channels:
        np.minimum(corner, _ground_rate(points), out=corner)
    known = {name: course.channels[name] for name in channels}
    if ground.heights is not None:
        known.pop("slope", None)  # that at each instant holds instead
    return Reach(course, points, ground, limits, corner, known, period)


def _ground_rate(points: Points) -> FloatArray:
    """Return the largest rate at each point that the ground about it allows [m/s]."""
    here: FloatArray = points.channels[GROUND_SPEED]
    # A cell lies on the run of its end; one that bends from run to run lies on both.
    cell = np.where(points.bent, np.minimum(here[:-1], here[1:]), here[1:])
    least = np.minimum(np.append(here[0], cell), np.append(cell, here[-1]))
    return over(least, np.abs(points.forward))


@dataclass(frozen=True)
class _Timing:
    """Points along a path with their limits, and the objectives that choose rates there."""

    reach: Reach
    ends: tuple[float, float]  # speed of the faster tread at the start and at the end [m/s]

    def duration(self, rate: FloatArray) -> float:
        """Time that the path takes at given rates [s]."""
        return float(times(self.reach.points.cell, rate).sum())

    def rates(self, objective: str, duration: float | None, time_value: float) -> FloatArray:
        """Return the rates that meet the objective, or take the duration [m/s]."""
        rate = self.fast
        self._check_ends(rate)
        if duration is not None:
            return self._lasting(duration)
        if objective == "energy":
            return self._slowed(self._cheapest(time_value))
        return rate

    @cached_property
    def fast(self) -> FloatArray:
        """The greatest rates within all limits [m/s]."""
        return self.reach.fastest(self.reach.top)

    def _cheapest(self, price: float) -> FloatArray:
        reach, top = self.reach, self.reach.limits.motor.speed
        top = top if np.isfinite(top) else float(reach.top.max())
        return reach.cheapest(price, SETTINGS.slowest * top)

    def _slowed(self, cap: FloatArray) -> FloatArray:
        """Return the greatest rates within caps that leave the speeds at both ends as given."""
        reach, fast = self.reach, self.fast
        if any(self.ends):
            way = np.append(0.0, np.cumsum(self.reach.points.cell))
            most = 0.9 * min(reach.limits.motor.acceleration, UNLIMITED)
            for end, along in zip(self.ends, (way, way[-1] - way), strict=True):
                slowing = np.sqrt(np.maximum(end**2 - 2 * most * along, 0.0))
                cap = np.maximum(cap, np.minimum(slowing, fast))
            rate = reach.fastest(cap)
            if np.allclose(rate[[0, -1]], fast[[0, -1]], rtol=ROUNDING):
                return rate
            cap = reach.top  # braking to the cheapest rate is beyond some limit
        return reach.fastest(cap)

    def _lasting(self, duration: float) -> FloatArray:
        """Search the price of time, then slow all down, until the duration fits."""
        least = self.duration(self.fast)
        if duration < least * (1 - ROUNDING):
            raise InfeasibleMotionError(
                f"the path takes {least:.6g} s at least; {duration:g} s is too short"
            )
        best, longest = self.reach.top, least

        def excess(price: float) -> float:
            nonlocal best, longest
            tried = self._cheapest(float(np.sinh(price)))
            time = self.duration(self._slowed(tried))
            if longest < time <= duration:
                best, longest = tried, time
            return float(np.log(time / duration))

        from scipy.optimize import brentq  # slow to import, and rarely needed

        top = float(np.arcsinh(SETTINGS.time_price))
        if excess(top) < 0 < excess(-top):
            brentq(excess, -top, top, xtol=1e-2)

        # What remains is a jump between two choices: slow the faster one down evenly.
        if not any(self.ends):
            return self._slowed(best) * longest / duration

        def capped(most: float) -> FloatArray:
            return self._slowed(np.minimum(best, most))

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
            if found < wanted * (1 - 1e-6) - ROUNDING:
                raise InfeasibleMotionError(
                    f"{name} {wanted:g} m/s is too high for this path and its limits; "
                    f"{found:.4g} m/s is the most"
                )

    def cooled(self, duration: float | None) -> FloatArray:
        """Return rates within the continuous power too: lower where windows are warm."""
        cell, limits, survey = self.reach.points.cell, self.reach.limits, self.reach.survey
        section = np.append(0, np.cumsum(cell == 0))
        quickest = np.zeros(section[-1] + 1)
        np.maximum.at(quickest, section, self.fast)
        most = np.minimum(self.reach.top, quickest[section])
        level, best, least = most, self.fast, np.inf
        for _ in range(SETTINGS.rounds):
            rate = self._slowed(np.minimum(most, level))
            clock = np.append(0.0, np.cumsum(times(cell, rate)))
            found = survey(rate)
            share = min(1.0, found.thermal.scale(limits.motor))
            if found.hot and clock[-1] < least * share:  # all a little slower may do
                even = rate * share * (1 - SETTINGS.margin)
                if not survey(even).hot:
                    best, least = even, self.duration(even)
            if not found.hot and clock[-1] < least:
                best, least = rate, float(clock[-1])
            warmth = _warmth(found.thermal, limits, clock)
            warmth *= found.warmth / warmth.max()
            level = np.minimum(level * warmth**-SETTINGS.damping, most)
        power = f"continuous power of {limits.motor.continuous_power:g} W"
        if not np.isfinite(least):
            raise InfeasibleMotionError(
                f"the motors' {power} does not suffice in any profile that was tried; allow more "
                "time or take a longer way round"
            )
        self._check_ends(best)
        if duration is None:
            return best
        if least > duration * (1 + ROUNDING):
            raise InfeasibleMotionError(
                f"within the motors' {power} the path takes {least:.6g} s; {duration:g} s is too "
                "short"
            )
        return best * least / duration


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
