"""Whether the motors can drive a trajectory; if not, where not, and how fast they could.

Every limit is tested per side through the whole power model: a total never shows an overloaded
outer motor. Between samples, speeds are linear in time (`energyplan.limits.drive`). Powers and
forces are evaluated at the beginning, the middle and the end of each interval, and are linear in
between. So a violated interval begins and ends where the value crosses its limit.

Inertia counts towards forces and power exactly if the model has inertia terms; the acceleration
limit is tested in any case.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from energyplan import html
from energyplan.errors import InvalidInputError
from energyplan.limits.drive import Ground, Pieces, Traversal
from energyplan.limits.motor import UNITS, Limit, Limits, largest_within, relative
from energyplan.limits.motor_kernels import intervals, shortest_window, window_mean
from energyplan.motion import Motion
from energyplan.path import ROUNDING, FloatArray, Trajectory
from energyplan.power import PowerModel
from energyplan.records import checked
from energyplan.terrain import HeightMap, SurfaceMap, laid_out
from energyplan.vehicle import MotorLimits, Vehicle


@dataclass(frozen=True)
class Violation:
    """One interval in which one limit of one side is exceeded."""

    kind: str  # which limit, as in `UNITS`
    side: str  # "left", "right" or "both"
    start: float  # first instant above the limit [s]
    end: float  # last one [s]
    peak: float  # largest value in between, in the limit's unit
    limit: float  # the limit [W, N, m/s, m/s^2 or rad/s]

    @property
    def margin(self) -> float:
        """Limit minus peak, in the limit's unit; negative."""
        return self.limit - self.peak

    @property
    def bound(self) -> Limit:
        """The limit that is exceeded."""
        return Limit(self.kind, self.side, self.limit)


class Instant(NamedTuple):
    """The instant at which least is left of a limit."""

    t: float  # when [s]
    kind: str  # which limit, as in `Violation`
    side: str  # "left", "right" or "both"
    value: float  # the load
    limit: float  # what limits it
    margin: float  # what is left, as a fraction of the limit; negative where it is exceeded


@dataclass(frozen=True)
class FeasibilityReport(html.Readable):
    """Whether motors and battery can drive a trajectory, as `check` found.

    Examples
    --------
    >>> import numpy as np
    >>> import energyplan as ep
    >>> drive = ep.Trajectory([0, 2], x=[0, 1], y=[0, 0], yaw=[0, 0], v=[0.5, 0.5], omega=[0, 0])
    >>> report = ep.check(drive, ep.PowerModel.preset("quadriga:empty:marble"))
    >>> report.feasible, round(report.energy)
    (True, 180)
    """

    violations: tuple[Violation, ...]  # every violated interval, by start
    worst: Instant | None  # that with the least margin; None if nothing is limited
    energy: float  # energy of the trajectory under the model [J]
    duration: float  # time that the trajectory takes [s]
    _search: Callable[[], SpeedScale] = field(repr=False, compare=False)

    def _summaries(self) -> list[html.Summary]:
        rows = [
            (f"{html.words(v.kind)} [{unit}]", v.side, v.start, v.end, v.peak, v.limit)
            for v in self.violations
            for unit in [html.unit(UNITS[v.kind])]
        ]
        top = f"up to {html.share(self.max_speed_scale)} of these speeds"
        title = (
            f"{'feasible' if self.feasible else 'not feasible'}, {html.number(self.energy)} J "
            f"in {html.number(self.duration)} s, feasible "
            f"{top if np.isfinite(self.max_speed_scale) else 'at any speed'}"
        )
        header = ("limit exceeded", "side", "from [s]", "to [s]", "peak", "limit")
        return [html.Summary(title, header, rows, [self.reason])]

    @property
    def feasible(self) -> bool:
        """True if no limit is exceeded."""
        return not self.violations

    @cached_property
    def _scale(self) -> SpeedScale:
        return self._search()

    @property
    def max_speed_scale(self) -> float:
        """Largest factor on all speeds of the trajectory with which it is feasible.

        Above 1 the robot could go faster; another timing of its path may be faster still. 0 if no
        speed is feasible, infinite if nothing limits it. Computed when first needed: exact
        where forces do not depend on speed; otherwise by a search downwards in steps of 10 % from
        the largest speed that the kinematic limits allow, then by bisection to 1e-9. The set of
        feasible factors need not be an interval (friction may fall with speed); a feasible band
        narrower than the step can be missed.
        """
        return self._scale.factor

    @property
    def reason(self) -> str:
        """What is wrong and whether driving slower helps, in one sentence."""
        return self._scale.reason


@checked()
def check(
    trajectory: Trajectory,
    model: PowerModel,
    vehicle: Vehicle | None = None,
    *,
    battery_power: float = np.inf,
    battery_return: float = np.inf,
    lateral_acceleration: float = np.inf,
    channels: Mapping[str, ArrayLike] | None = None,
    surfaces: SurfaceMap | None = None,
    heights: HeightMap | None = None,
) -> FeasibilityReport:
    """Test a trajectory against the limits of motors and battery.

    Parameters
    ----------
    trajectory : Trajectory
        The trajectory, from any source.
    model : PowerModel
        The power model; on slopes it needs a grade term and `channels` a ``slope``.
    vehicle : Vehicle, optional
        Whose limits apply; the model's own vehicle where not given. Power, and with it loads
        and tread ICRs, always come from the model.
    battery_power, battery_return : float
        Largest power that the battery delivers, and takes back [W], where it is less than the
        vehicle says.
    lateral_acceleration : float
        Largest ``|v omega|`` [m/s^2].
    channels : mapping of str to array_like, shape () or (n,)
        Further channels that the model's terms read, one value per sample or one for all.
    surfaces : SurfaceMap, optional
        Surfaces with power models of their own, and speed limits; `model` holds elsewhere.
    heights : HeightMap, optional
        Heights of the ground; level where not given. A model without a term that reads the slope
        does not feel them (`energyplan.power.effects.with_weight`).

    Returns
    -------
    FeasibilityReport
        Violations, the worst instant, the largest feasible speed scale, and the energy.

    Raises
    ------
    MissingChannelError
        If a term needs a channel that is not given.
    InvalidInputError
        If a limit is negative or a channel has another length than the trajectory.

    Notes
    -----
    Peak power, force and regeneration limit each side's tread force and shaft power (force times
    tread speed); losses on the way to the shaft count towards the battery's limits. The
    continuous limit holds for the mean of the drawn shaft power over every window of
    `MotorLimits.thermal_time`; returned power does not make up for drawn power, and the motors
    come rested: before the trajectory they drew nothing. A value within 1e-9 of its limit is
    within it. `energyplan.limits.drive` says what the trajectory is between its samples.

    Examples
    --------
    >>> model = PowerModel.preset("quadriga:empty:concrete")
    >>> t = np.linspace(0, 10, 201)
    >>> spin = Trajectory(t, 0 * t, 0 * t, 3 * t, 0 * t, 3 + 0 * t)
    >>> report = check(spin, model)
    >>> [(v.kind, v.side, round(v.peak, 2), v.limit) for v in report.violations]
    [('speed', 'left', 1.41, 1.2), ('speed', 'right', 1.41, 1.2)]
    >>> round(report.max_speed_scale, 4)
    0.8511

    References
    ----------
    docs/theory, section 2; Morales et al. (2010), section I.
    """
    limits = Limits.of(
        vehicle or model.vehicle,
        lateral_acceleration=lateral_acceleration,
        battery_power=battery_power,
        battery_return=battery_return,
    )
    ground = Ground(*laid_out(model, trajectory.poses[:, :2], surfaces, heights))
    drive = LimitedDrive(Traversal(trajectory, ground, dict(channels or {})), limits)
    survey = drive.survey()
    violations = sorted(survey.violations, key=lambda v: (v.start, v.end))
    worst = None
    if survey.peaks:
        p = max(survey.peaks, key=lambda peak: (peak.use, peak.value))
        worst = Instant(p.t, *p.bound[:2], p.value, p.bound.limit, 1.0 - p.use)
    return FeasibilityReport(
        tuple(violations), worst, survey.energy, trajectory.duration, partial(largest_scale, drive)
    )


@dataclass(frozen=True)
class FeasibleRegion:
    """Which steady motions the motors can drive, over n curvatures and m speeds."""

    curvature: FloatArray  # (n,): path curvature [1/m]
    speed: FloatArray  # (m,): speed along the heading [m/s]
    sustained: NDArray[np.bool_]  # (n, m): feasible for ever, within the continuous power
    brief: NDArray[np.bool_]  # (n, m): the same for less than the thermal time, within the peak
    limiting: NDArray[np.str_]  # (n, m): kind of the limit that is used most when sustained
    side: NDArray[np.str_]  # (n, m): the side at which it is
    use: FloatArray  # (n, m): value over that limit
    limiting_brief: NDArray[np.str_]  # (n, m): kind of the limit that is used most when brief
    max_speed: FloatArray  # (n,): largest up to which every speed is feasible [m/s]; 0 for none
    max_speed_brief: FloatArray  # (n,): the same when brief


@checked()
def feasible_region(
    model: PowerModel,
    curvature: ArrayLike,
    speed: ArrayLike,
    vehicle: Vehicle | None = None,
    *,
    battery_power: float = np.inf,
    battery_return: float = np.inf,
    lateral_acceleration: float = np.inf,
    channels: Mapping[str, float] | None = None,
) -> FeasibleRegion:
    """Map where motors and battery can keep up a motion of given curvature and speed.

    Parameters
    ----------
    model : PowerModel
        The power model: it represents a terrain and a load.
    curvature : array_like, shape (n,)
        Path curvature, positive to the left [1/m].
    speed : array_like, shape (m,)
        Speeds along the heading, not negative [m/s].
    vehicle : Vehicle, optional
        Whose limits apply; the model's own where not given.
    battery_power, battery_return, lateral_acceleration : float
        As in `check`.
    channels : mapping of str to float, optional
        Further channels that the model's terms read, such as a constant ``slope`` [rad]; ground
        is level and speeds are steady where they are not given.

    Returns
    -------
    FeasibleRegion
        Masks, the limit that is nearest, and the largest speed at each curvature.

    Raises
    ------
    InvalidInputError
        If curvature or speed is not a finite vector, or a speed is negative.

    References
    ----------
    Morales et al. (2010), section I, poses this question; docs/theory, section 2.

    Examples
    --------
    >>> model = PowerModel.preset("quadriga:full:concrete")
    >>> region = feasible_region(model, [0.0, 1.0], [0.3, 0.6, 0.9])
    >>> region.sustained.tolist()
    [[True, True, True], [True, True, False]]
    >>> str(region.limiting[1, 2]), str(region.side[1, 2])
    ('continuous_power', 'right')
    """
    kappa, v = np.asarray(curvature, float), np.asarray(speed, float)
    for name, value in (("curvature", kappa), ("speed", v)):
        if value.ndim != 1 or not len(value) or not np.all(np.isfinite(value)):
            raise InvalidInputError(f"{name} has shape {value.shape}; give a vector of numbers")
    if np.any(v < 0):
        raise InvalidInputError(f"a speed is {v.min()} m/s; drive backwards by the mirror image")
    brief = Limits.of(
        vehicle or model.vehicle,
        lateral_acceleration=lateral_acceleration,
        battery_power=battery_power,
        battery_return=battery_return,
    )
    steady = {"accel": 0.0, "yaw_accel": 0.0, "slope": 0.0, **(channels or {})}

    def motion(speeds: FloatArray) -> Motion:
        return Motion.from_twist(speeds, kappa * speeds, model.vehicle.icr, **steady)

    grid = motion(v[:, None])
    sustained = brief.sustained
    always, awhile = _most_used(sustained, model, grid), _most_used(brief, model, grid)
    kinds = always.kind
    if sustained.motor.peak_power < brief.motor.peak_power:
        kinds = np.where(kinds == "peak_power", "continuous_power", kinds)
    top = np.full(kappa.shape, v.max())
    return FeasibleRegion(
        curvature=kappa, speed=v, sustained=always.use <= 1 + ROUNDING,
        brief=awhile.use <= 1 + ROUNDING, limiting=kinds, side=always.side, use=always.use,
        limiting_brief=awhile.kind,
        max_speed=largest_within(lambda speeds: sustained.use(model, motion(speeds)), top),
        max_speed_brief=largest_within(lambda speeds: brief.use(model, motion(speeds)), top),
    )  # fmt: skip


class _Nearest(NamedTuple):
    """Kind, side and use of the limit that is used most, shape (n, m)."""

    kind: NDArray[np.str_]
    side: NDArray[np.str_]
    use: FloatArray


def _most_used(limits: Limits, model: PowerModel, motion: Motion) -> _Nearest:
    kinds, sides, uses = ["none"], ["both"], [np.zeros(motion.shape)]
    for bound, value in zip(limits.bounds, limits.loads(model, motion).values, strict=True):
        kinds.append(bound.kind)
        sides.append(bound.side)
        uses.append(relative(value, bound.limit))
    most = np.argmax(uses, axis=0).T
    return _Nearest(np.array(kinds)[most], np.array(sides)[most], np.max(uses, axis=0).T)


# -- a drive held against all limits ---------------------------------------------------------------


class Peak(NamedTuple):
    """Where a bound is used most: time, value, and value over limit."""

    bound: Limit
    t: float
    value: float
    use: float


class Thermal(NamedTuple):
    """Shaft power that the left and the right side draw over time, shape (2, n)."""

    t: FloatArray
    drawn: FloatArray

    def scale(self, motor: MotorLimits) -> float:
        """Largest factor on the speed within the continuous power, if forces do not change."""
        if not np.isfinite(motor.continuous_power) or not self.drawn.any():
            return np.inf
        budget = motor.continuous_power * motor.thermal_time
        if budget <= 0:
            return motor.continuous_power / float(self.drawn.max())
        shortest = min(shortest_window(self.t, power, budget) for power in self.drawn)
        return shortest / motor.thermal_time


class PieceLoads(NamedTuple):
    """Shaft power of each side, power under the model [W], and what each bound limits."""

    left: FloatArray
    right: FloatArray
    power: FloatArray
    values: list[FloatArray]


class Survey(NamedTuple):
    """What one pass finds."""

    peaks: list[Peak]
    violations: list[Violation]
    energy: float
    thermal: Thermal

    @property
    def hot(self) -> bool:
        """Whether a thermal window exceeds the continuous power."""
        return any(found.kind == "continuous_power" for found in self.violations)

    @property
    def warmth(self) -> float:
        """Power in the warmest thermal window, over the continuous power."""
        kind = "continuous_power"
        return max((peak.use for peak in self.peaks if peak.bound.kind == kind), default=0.0)


@dataclass(frozen=True)
class LimitedDrive:
    """A drive with the limits that hold on it."""

    drive: Traversal
    limits: Limits

    def survey(self, scale: float = 1.0) -> Survey:
        """Evaluate every limit at the beginning, the middle and the end of every subinterval."""
        drive = self.drive
        watch = _LimitMonitor()
        energy = 0.0
        times: list[FloatArray] = []
        drawn: list[FloatArray] = []
        for k in range(drive.block_count):
            pieces = drive.pieces(k)
            t = drive.times(pieces, scale).reshape(-1)
            loads = self.loads(pieces, scale)
            for bound, value in zip(self.limits.bounds, loads.values, strict=True):
                watch.see(bound, t, value.reshape(-1))
            if drive.ground.has_speed_limits:
                limits, speeds = drive.speed_limits(pieces), drive.speeds(pieces, scale)
                for limit in np.unique(limits[np.isfinite(limits)]):
                    bound = Limit("ground_speed", "both", float(limit))
                    watch.see(bound, t, np.where(limits == limit, speeds, 0.0).reshape(-1))
            self._see_acceleration(watch, pieces, scale)
            if np.isfinite(self.limits.motor.continuous_power):
                sides = np.stack([loads.left, loads.right])
                drawn.append(np.maximum(sides, 0.0).reshape(2, -1))
                times.append(t)
            energy += sum(
                float(mean @ drive.widths(some, scale))
                for some, mean in drive.refined(pieces, loads.power, scale)
            )
        thermal = Thermal(np.zeros(0), np.zeros((2, 0)))
        if drawn:
            thermal = Thermal(np.concatenate(times), np.concatenate(drawn, axis=1))
            window = self.limits.motor.thermal_time
            for side, power in zip(("left", "right"), thermal.drawn, strict=True):
                mean = window_mean(thermal.t, power, window) if window > 0 else power
                bound = Limit("continuous_power", side, self.limits.motor.continuous_power)
                watch.see(bound, thermal.t, mean)
        return Survey(list(watch.peaks.values()), watch.violations, energy, thermal)

    def loads(self, pieces: Pieces, scale: float) -> PieceLoads:
        """Evaluate the loads of subintervals, ground by ground; arrays of shape (m, 3)."""
        count = len(pieces.interval)
        out = np.empty((3 + len(self.limits.bounds), count, 3))  # for more than one ground
        for part in self.drive.parts(pieces, scale):
            found = self.limits.loads(part.model, part.motion)
            # A model of forces alone spends exactly its shaft power.
            lossless = all(term.kind == "force" for term in part.model.terms)
            power = found.left + found.right if lossless else part.model.power(part.motion)
            if len(part.which) == count:
                return PieceLoads(found.left, found.right, power, found.values)
            for row, value in zip(
                out, (found.left, found.right, power, *found.values), strict=True
            ):
                row[part.which] = value
        return PieceLoads(out[0], out[1], out[2], list(out[3:]))

    def _see_acceleration(self, watch: _LimitMonitor, pieces: Pieces, scale: float) -> None:
        limit = self.limits.motor.acceleration
        if not np.isfinite(limit):
            return
        path, icr = self.drive.trajectory, self.drive.ground.model.vehicle.icr
        part = slice(int(pieces.interval[0]), int(pieces.interval[-1]) + 2)
        # late times are rounded more: a short step may have been as much longer
        step = np.diff(path.t[part]) + np.spacing(path.t[part][1:])
        t = path.t[0] + (path.t[part] - path.t[0]) / scale
        v, omega = path.v[part], path.omega[part]
        for side, speed in (("left", v - icr.left * omega), ("right", v + icr.right * omega)):
            rate = scale**2 * np.abs(np.diff(speed)) / step
            bound = Limit("acceleration", side, limit)
            watch.see(bound, np.repeat(t, 2)[1:-1], np.repeat(rate, 2))


class _LimitMonitor:
    """Collects peaks and violations, joining intervals that meet where two blocks do."""

    def __init__(self) -> None:
        self.peaks: dict[Limit, Peak] = {}
        self.violations: list[Violation] = []
        self._latest: dict[Limit, int] = {}

    def see(self, bound: Limit, t: FloatArray, value: FloatArray) -> None:
        k = int(np.argmax(value))
        top = float(value[k])
        if bound not in self.peaks or top > self.peaks[bound].value:
            self.peaks[bound] = Peak(
                bound, float(t[k]), top, float(relative(np.asarray(top), bound.limit))
            )
        tolerance = ROUNDING * max(bound.limit, 1.0)
        if top <= bound.limit + tolerance:
            return
        for start, end, peak in np.transpose(intervals(t, value, bound.limit, tolerance)).tolist():
            last = self._latest.get(bound)
            if last is not None and self.violations[last].end == start:
                old = self.violations[last]
                self.violations[last] = replace(old, end=end, peak=max(old.peak, peak))
            else:
                self._latest[bound] = len(self.violations)
                self.violations.append(Violation(*bound[:2], start, end, peak, bound.limit))


SLOWEST, FASTEST, STEP = 1e-4, 1e6, 1.1
"""Range of speed scales that the search tries, and the ratio of neighbouring ones."""

KINEMATIC = {
    "speed": 1, "ground_speed": 1, "yaw_rate": 1, "acceleration": 2, "lateral_acceleration": 2,
}  # fmt: skip
"""Power of the speed scale with which a limited quantity grows, whatever the model."""

STATIC = {"peak_power": 1, "regeneration": 1, "force": 0, "battery_power": 1, "battery_return": 1}
"""The same for a model whose forces do not depend on speed."""


class SpeedScale(NamedTuple):
    """Largest feasible factor on the speed, and one sentence for the user."""

    factor: float
    reason: str


def largest_scale(drive: LimitedDrive) -> SpeedScale:
    """Return the largest feasible speed scale and say what limits it."""
    survey = drive.survey()
    if not survey.peaks:
        return SpeedScale(np.inf, "nothing limits the speed")
    if _is_static(drive):
        factor = min(
            _closed_form(survey, KINEMATIC | STATIC), survey.thermal.scale(drive.limits.motor)
        )
        slowest = survey
    else:
        factor = _search(drive, _closed_form(survey, KINEMATIC))
        slowest = survey if factor > 0 else drive.survey(SLOWEST)
    return SpeedScale(factor, _reason(factor, survey.peaks, slowest.peaks))


def _is_static(drive: LimitedDrive) -> bool:
    """Return whether every limited quantity grows with the pure powers of `STATIC`."""
    for k in range(drive.drive.block_count):
        pieces = drive.drive.pieces(k)
        now = drive.loads(pieces, 1.0)
        for scale in (0.5, 2.0):
            then = drive.loads(pieces, scale)
            pairs = [(now.left * scale, then.left), (now.right * scale, then.right)]
            for bound, a, b in zip(drive.limits.bounds, now.values, then.values, strict=True):
                if bound.kind in STATIC:
                    pairs.append((a * scale ** STATIC[bound.kind], b))
            for expected, found in pairs:
                size = float(np.max(np.abs(expected)))
                if np.max(np.abs(expected - found)) > 1e-12 * size:
                    return False
    return True


def _closed_form(survey: Survey, exponents: dict[str, int]) -> float:
    """Return the scale at which the first of the quantities with known growth meets its limit."""
    factor = np.inf
    for peak in survey.peaks:
        exponent = exponents.get(peak.bound.kind)
        if exponent is None or peak.value <= 0:
            continue
        ratio = peak.bound.limit / peak.value
        if exponent:
            factor = min(factor, ratio ** (1 / exponent))
        elif ratio < 1 - ROUNDING:
            factor = 0.0
    return float(factor)


def _search(drive: LimitedDrive, ceiling: float) -> float:
    """Look downwards for the first feasible scale, then bisect towards the last infeasible one."""
    if ceiling == 0:
        return 0.0
    bounded = np.isfinite(ceiling)
    high = ceiling if bounded else FASTEST

    def exceeded(scale: float) -> bool:
        return max(peak.use for peak in drive.survey(scale).peaks) > 1 + ROUNDING

    if not exceeded(high):
        return high if bounded else np.inf
    low = _below(high)
    while exceeded(low):
        high, low = low, _below(low)
        if low < SLOWEST:
            return 0.0
    while high / low > 1 + ROUNDING:
        middle = np.sqrt(low * high)
        if exceeded(middle):
            high = middle
        else:
            low = middle
    return float(low)


def _below(scale: float) -> float:
    """Return the next scale to try; the trajectory as it is always is one."""
    lower = scale / STEP
    return 1.0 if lower < 1.0 < scale else lower


def _reason(factor: float, peaks: list[Peak], slowest: list[Peak]) -> str:
    if factor == np.inf:
        return "nothing limits the speed"
    worst = max(peaks if factor > 0 else slowest, key=lambda peak: peak.use)
    what = f"at {worst.t:.3g} s {worst.bound.describe(worst.value)}"
    if factor == 0:
        return (
            f"no speed is feasible: {what} however slowly the robot drives; it takes other "
            "ground, less load, another path or stronger motors"
        )
    if factor >= 1 - ROUNDING:
        if factor < 1.00005:
            return (
                "some limit is reached: this trajectory cannot be sped up evenly; another timing "
                "of its path, as check finds for x,y,yaw alone, may be faster"
            )
        return f"every limit holds up to {html.share(factor)} of the speed"
    return f"too fast: {what}; feasible at {html.share(factor)} of the speed"
