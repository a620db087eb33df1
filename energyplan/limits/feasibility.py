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
from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from energyplan import html
from energyplan.errors import InvalidInputError
from energyplan.kinds import checked
from energyplan.limits._check import Excess, LimitedDrive, SpeedScale, largest_scale
from energyplan.limits.drive import Drive, Ground
from energyplan.limits.motor import ROUNDING, Limits, largest_within, relative
from energyplan.motion import Motion
from energyplan.path import FloatArray, Trajectory
from energyplan.power import PowerModel
from energyplan.terrain import HeightMap, SurfaceMap, laid_out
from energyplan.vehicle import Vehicle


@dataclass(frozen=True)
class Violation:
    """One interval in which one limit of one side is exceeded.

    Parameters
    ----------
    kind : str
        ``"peak_power"``, ``"continuous_power"``, ``"regeneration"``, ``"force"``, ``"speed"``,
        ``"ground_speed"``, ``"acceleration"``, ``"yaw_rate"``, ``"lateral_acceleration"``,
        ``"battery_power"`` or ``"battery_return"``.
    side : str
        ``"left"``, ``"right"`` or ``"both"``.
    start, end : float
        First and last instant above the limit [s].
    peak : float
        Largest value in between, in the limit's unit.
    limit : float
        The limit [W, N, m/s, m/s^2 or rad/s].

    Examples
    --------
    >>> t = np.linspace(0, 10, 201)
    >>> spin = Trajectory(t, 0 * t, 0 * t, 3 * t, 0 * t, 3 + 0 * t)
    >>> first = check(spin, PowerModel.preset("quadriga:empty:concrete")).violations[0]
    >>> first.kind, first.side, first.start
    ('speed', 'left', 0.0)
    """

    kind: str
    side: str
    start: float
    end: float
    peak: float
    limit: float

    @property
    def margin(self) -> float:
        """Limit minus peak, in the limit's unit; negative."""
        return self.limit - self.peak


class Instant(NamedTuple):
    """The instant at which least is left of a limit.

    Parameters
    ----------
    t : float
        When [s].
    kind, side : str
        Which limit, as in `Violation`.
    value, limit : float
        What is asked, and what there is.
    margin : float
        What is left, as a fraction of the limit; negative where it is exceeded.

    Examples
    --------
    >>> t = np.linspace(0, 10, 201)
    >>> spin = Trajectory(t, 0 * t, 0 * t, 3 * t, 0 * t, 3 + 0 * t)
    >>> check(spin, PowerModel.preset("quadriga:empty:concrete")).worst.kind
    'speed'
    """

    t: float
    kind: str
    side: str
    value: float
    limit: float
    margin: float


@dataclass(frozen=True)
class FeasibilityReport(html.Readable):
    """Whether motors and battery can drive a trajectory, as `check` found.

    Parameters
    ----------
    violations : tuple of Violation
        Every violated interval, by start.
    worst : Instant or None
        The instant with the least margin relative to its limit; None if nothing is limited.
    energy : float
        Energy of the trajectory under the model [J].

    Examples
    --------
    >>> import numpy as np
    >>> import energyplan as ep
    >>> drive = ep.Trajectory([0, 2], x=[0, 1], y=[0, 0], yaw=[0, 0], v=[0.5, 0.5], omega=[0, 0])
    >>> report = ep.check(drive, ep.PowerModel.preset("quadriga:empty:marble"))
    >>> report.feasible, round(report.energy)
    (True, 180)
    """

    violations: tuple[Violation, ...]
    worst: Instant | None
    energy: float
    _search: Callable[[], SpeedScale] = field(repr=False, compare=False)

    def _summaries(self) -> list[html.Summary]:
        rows = [
            (v.kind.replace("_", " "), v.side, v.start, v.end, v.peak, v.limit)
            for v in self.violations
        ]
        title = (
            f"{'feasible' if self.feasible else 'not feasible'}, {html.number(self.energy)} J, "
            f"feasible up to {html.number(self.max_speed_scale)} times this speed"
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
        """Largest factor on the speed with which the same path is feasible.

        Above 1 the robot could go faster. 0 if no speed is feasible, infinite if nothing limits
        it. Computed when first asked for: exact where forces do not depend on speed; otherwise
        by a search downwards in steps of 10 % from the largest speed that the kinematic limits
        allow, then by bisection to 1e-9. The set of feasible factors need not be an interval
        (friction may fall with speed); a feasible band narrower than the step can be missed.
        """
        return self._scale.factor

    @property
    def any_speed_feasible(self) -> bool:
        """True if some speed along the same path is feasible."""
        return self.max_speed_scale > 0

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
        Grounds with power models of their own, and speed limits; `model` holds elsewhere.
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
    drive = LimitedDrive(Drive(trajectory, ground, dict(channels or {})), limits)
    survey = drive.survey()
    violations = sorted(
        (_violation(excess) for excess in survey.excesses), key=lambda v: (v.start, v.end)
    )
    worst = None
    if survey.peaks:
        p = max(survey.peaks, key=lambda peak: (peak.use, peak.value))
        worst = Instant(p.t, *p.bound[:2], p.value, p.bound.limit, 1.0 - p.use)
    return FeasibilityReport(tuple(violations), worst, survey.energy, partial(largest_scale, drive))


@dataclass(frozen=True)
class FeasibleRegion:
    """Which steady motions the motors can drive, over curvature and speed.

    Parameters
    ----------
    curvature : ndarray, shape (n,)
        Path curvature [1/m].
    speed : ndarray, shape (m,)
        Speed along the heading [m/s].
    sustained : ndarray of bool, shape (n, m)
        Feasible for ever: the continuous power suffices.
    brief : ndarray of bool, shape (n, m)
        Feasible for a time shorter than the motors' thermal one: the peak power suffices.
    limiting : ndarray of str, shape (n, m)
        Kind of the limit that is used most in sustained motion.
    side : ndarray of str, shape (n, m)
        The side at which it is.
    use : ndarray, shape (n, m)
        That limit's use: value over limit.
    limiting_brief : ndarray of str, shape (n, m)
        Kind of the limit that is used most in brief motion.
    max_speed, max_speed_brief : ndarray, shape (n,)
        Largest speed up to which every speed is feasible [m/s]; no more than the largest of
        `speed`. 0 where no speed is.

    Examples
    --------
    >>> model = PowerModel.preset("quadriga:full:concrete")
    >>> region = feasible_region(model, [0.0, 1.0], [0.3, 0.6, 0.9])
    >>> region.sustained.shape, bool(region.max_speed[0] > region.max_speed[1])
    ((2, 3), True)
    """

    curvature: FloatArray
    speed: FloatArray
    sustained: NDArray[np.bool_]
    brief: NDArray[np.bool_]
    limiting: NDArray[np.str_]
    side: NDArray[np.str_]
    use: FloatArray
    limiting_brief: NDArray[np.str_]
    max_speed: FloatArray
    max_speed_brief: FloatArray


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
        The power model: it stands for a terrain and a load.
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
    Morales et al. (2010), section I, asks this question; docs/theory, section 2.

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


def _violation(excess: Excess) -> Violation:
    kind, side, limit = excess.bound
    return Violation(kind, side, excess.start, excess.end, excess.peak, limit)
