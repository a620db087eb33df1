"""How a vehicle is driven: steadily, at a speed or at the cheapest, and how long that takes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from energyplan.cost import direction_table, speeds
from energyplan.cost.direction_table import SPECIAL, DirectionTable
from energyplan.errors import InvalidInputError, MissingChannelError, ModelError
from energyplan.motion import CHANNELS, Motion
from energyplan.path import ROUNDING, FloatArray, Path
from energyplan.power import PowerModel, Sides
from energyplan.power.effects import without_ground
from energyplan.records import check_fields, numbers
from energyplan.vehicle import TreadICR, Vehicle

_STILL = ("x", "y", "yaw", "slope", "accel", "yaw_accel", "accel_x")
STEADY = {"t": 1e9, "since_start": 1e9, **dict.fromkeys(_STILL, 0.0)}
"""Channels of steady motion on level ground, long after the start."""

_FAR = np.geomspace(1e-3, 1e3, 13)
_PLACES = {"x": np.concatenate([-_FAR, _FAR]), "y": np.concatenate([-_FAR, _FAR])}
"""Channels that every drive has and no cost can know, and values at which they are tried."""
_YAWS = np.linspace(-3.0, 3.1, 26)  # headings at which it is tried whether power depends on them
_ROUND = np.arange(16) * (np.pi / 8)  # headings that the speeds of a motion have to suit


_PROBES = np.array([[0.5, 0.0], [0.0, 0.5], [0.7, 0.4], [-0.3, 0.8], [-0.6, -0.2]]).T
"""Speeds [m/s] and yaw rates [rad/s] at which it is tried what accelerations add."""
_CUT = 0.02  # turn that is priced at the heading in its middle [rad]
_ACCELERATIONS = ((1.0, 0.0), (0.0, 1.0), (-2.0, 3.0), (50.0, -40.0))  # [m/s^2], [rad/s^2]
_TIMES = (0.0, *np.geomspace(1e-2, 1e6, 33))  # times since the start that are tried [s]


def _power_at(
    model: PowerModel, channels: Mapping[str, float], accel: float, yaw_accel: float,
    t: float = STEADY["t"],
) -> FloatArray:  # fmt: skip
    now: dict[str, ArrayLike] = {**STEADY, "yaw": _ROUND[:, None], **channels}
    now |= {"t": t, "accel": accel, "yaw_accel": yaw_accel}
    every = np.zeros((len(_ROUND), len(_PROBES.T)))
    known = {name: np.asarray(value, float) + every for name, value in now.items()}
    v, omega = (probe + np.zeros((len(_ROUND), 1)) for probe in _PROBES)
    return model.power(Motion.from_twist(v, omega, model.vehicle.icr, **known))


def _masses(model: PowerModel, channels: Mapping[str, float]) -> FloatArray | None:
    """Return mass and moment of inertia if all that accelerations add is kinetic energy."""
    steady = _power_at(model, channels, 0.0, 0.0)
    if any(not np.array_equal(_power_at(model, channels, 0.0, 0.0, t), steady) for t in _TIMES):
        return None
    masses = np.array(
        [
            (_power_at(model, channels, *now) - steady)[0, k] / _PROBES[k, k]
            for k, now in enumerate(_ACCELERATIONS[:2])
        ]
    )
    for accel, yaw_accel in _ACCELERATIONS:
        added = masses @ (_PROBES * np.array([[accel], [yaw_accel]]))
        small = 1e-9 * float(max(np.abs(steady).max(), np.abs(added).max()))
        gained = _power_at(model, channels, accel, yaw_accel) - steady
        if not np.allclose(gained, added, rtol=1e-9, atol=small):
            return None
    return np.where(np.abs(masses) > 1e-9 * np.abs(steady).max(), masses, 0.0)


def _pivot_and_rest(x: FloatArray, y: FloatArray) -> FloatArray:
    """Return a pivot, and a line or a spin, that lead where elements lead, shape (2, 2, n)."""
    both = np.minimum(np.abs(x), np.abs(y))
    pivot = np.stack([np.copysign(both, x), np.copysign(both, y)])
    return np.stack([pivot, np.stack([x, y]) - pivot])


def _both_sides(power: Sides | FloatArray) -> FloatArray:
    return np.stack([power.left, power.right]) if isinstance(power, Sides) else np.asarray(power)


@dataclass(frozen=True, eq=False)
class SteadyDriving:
    """Path elements driven steadily on level ground, each at its own speed."""

    model: PowerModel  # the power model with its vehicle
    battery: bool = False  # whether power is that of the battery rather than of the treads
    # tread speed to drive at [m/s], or the cheapest; the vehicle's driving speed where not given
    speed: float | Literal["cheapest"] | None = None
    channels: Mapping[str, float] = field(default_factory=dict)
    time_value: float = 0.0  # value of a second where the speed is chosen [J/s]
    speed_limit: float = np.inf  # largest speed of the reference point [m/s]

    def __post_init__(self) -> None:
        check_fields(self, InvalidInputError)
        if not 0 <= self.time_value < np.inf:
            raise InvalidInputError(f"time_value is {self.time_value}; give joules a second >= 0")
        if isinstance(self.speed, float | int) and not self.speed > 0:
            raise InvalidInputError(f"speed is {self.speed}; give metres per second > 0")
        if not self.speed_limit > 0:
            raise InvalidInputError(
                f"speed_limit is {self.speed_limit}; give metres per second > 0"
            )
        self._check_channels()

    def _check_channels(self) -> None:
        """Refuse a term that reads what a cost cannot know."""
        known = {*STEADY, *self.channels, "yaw_rate"}.difference(_PLACES) | set(self.channels)
        for term in self._anywhere.terms:
            for name in term.channels:
                if name not in known:
                    raise MissingChannelError(self._unknown(term.name, name))
        for name, places in _PLACES.items():
            for of in self._readers(name, places):
                raise MissingChannelError(self._unknown(of, name))

    def _readers(self, channel: str, values: FloatArray) -> list[str]:
        """Return the terms whose power differs between some values of a channel."""
        if channel in self.channels:
            return []
        x, y = (np.repeat(part, len(values)) for part in 0.5 * SPECIAL.T)
        here = self._motion(x, y, np.ones(len(x)))
        there = here.with_channels(**{channel: np.tile(values, len(SPECIAL))})
        powers = (self._anywhere.regressors(motion) for motion in (here, there))
        differ = [
            term
            for term, *both in zip(self._anywhere.terms, *powers, strict=True)
            if not np.array_equal(_both_sides(both[0]), _both_sides(both[1]), True)
        ]
        # a loss differs with the forces, so the force is named first
        return [term.name for term in sorted(differ, key=lambda term: term.kind == "loss")]

    @cached_property
    def of_heading(self) -> tuple[str, ...]:
        """Names of the terms whose power depends on the heading; none of most models."""
        return tuple(self._readers("yaw", _YAWS))

    def check_any_heading(self, what: str) -> None:
        """Refuse a cost that depends on the heading, where `what` holds for any."""
        if self.of_heading:
            raise MissingChannelError(
                f"the term {self.of_heading[0]!r} of the model {self.model.name!r} depends on the "
                f"heading, and {what} holds for any heading; leave the term out of the model, or "
                "give one heading with EnergyCost(model, channels={'yaw': VALUE})"
            )

    def _unknown(self, term: str, channel: str) -> str:
        """Say that a term reads a channel that a cost does not know, and what to do."""
        place = channel in _PLACES
        return (
            f"the term {term!r} of the model {self.model.name!r} reads the channel {channel!r} "
            f"({CHANNELS.get(channel, 'a channel of its own')}), which a cost of motions does not "
            "know: "
            + "it holds for any place; "
            * place
            + "leave the term out of the model, or give the channel a constant value with "
            f"EnergyCost(model, channels={{{channel!r}: VALUE}})"
            + ", or put what differs between places on the map as surfaces or heights"
            * place
        )

    # -- geometry -----------------------------------------------------------------------------

    @property
    def vehicle(self) -> Vehicle:
        """The model's vehicle."""
        return self.model.vehicle

    @property
    def icr(self) -> TreadICR:
        """Tread ICRs."""
        return self.model.vehicle.icr

    @property
    def half_track(self) -> float:
        """Half the slip track ``C`` [m]: the turn radius of a pivot."""
        return self.icr.half_track

    def _element(self, ds: ArrayLike, dtheta: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return the centre's arc length and the turn times the half slip track [m]."""
        way, turn = numbers(ds, "ds"), numbers(dtheta, "dtheta")
        try:
            np.broadcast_shapes(way.shape, turn.shape)
        except ValueError:
            raise InvalidInputError(
                f"ds has shape {way.shape}, dtheta {turn.shape}; give one of each"
            ) from None
        return way - self.icr.centre[1] * turn, self.half_track * turn

    def cut_turns(self, path: Path) -> Path:
        """Return a path cut into segments of one heading each, as far as that matters."""
        return path.subdivide(np.inf, _CUT) if self.of_heading else path

    def _moving(
        self, path: Path, slope: ArrayLike = 0.0, yaw: ArrayLike | None = None
    ) -> list[FloatArray]:
        """Elements of a path that do not vanish, rid of rounding in pivots; slopes and headings.

        Where headings matter and are not given, the path is cut first.
        """
        if path.longitudinal != self.icr.longitudinal:
            raise InvalidInputError(
                f"the path's reference point is at x = {path.longitudinal} m, the tread ICRs are "
                f"at {self.icr.longitudinal} m; build the path with "
                "longitudinal=cost.icr.longitudinal"
            )
        if self.of_heading and yaw is None:
            count, path = len(path), self.cut_turns(path)
            if np.size(slope) > 1 and len(path) != count:
                raise InvalidInputError(
                    "slopes of a path whose turns have to be cut; give the headings too, or cut it "
                    "first: path = cost.cut_turns(path)"
                )
            yaw = 0.5 * (path.vertices[1:, 2] + path.vertices[:-1, 2])
        x, y = self._element(path.ds, path.dtheta)
        pivot = np.abs(np.abs(x) - np.abs(y)) <= ROUNDING * np.abs(y)
        x = np.where(pivot, np.copysign(y, x), x)
        tilt = numbers(slope, "slope")
        if tilt.shape not in ((), (1,), x.shape):
            raise InvalidInputError(
                f"slope has shape {tilt.shape}; give one for each of {len(x)} segments"
            )
        tilt, ahead = (np.broadcast_to(at, x.shape) for at in (tilt, 0.0 if yaw is None else yaw))
        if np.any(stuck := self._stuck(x, y)):
            parts = _pivot_and_rest(x[stuck], y[stuck])
            x, y, tilt, ahead = (
                np.concatenate([whole[~stuck], *split])
                for whole, split in (
                    (x, parts[:, 0]), (y, parts[:, 1]),
                    (tilt, [tilt[stuck]] * 2), (ahead, [ahead[stuck]] * 2),
                )
            )  # fmt: skip
        moves = (x != 0) | (y != 0)
        return [v[moves] for v in (x, y, tilt, ahead)]

    # -- speed ----------------------------------------------------------------------------------

    @cached_property
    def tread_speed(self) -> float | None:
        """Tread speed to drive at [m/s]; None where every motion is driven at its cheapest."""
        if self.speed is None and self.time_value > 0:
            return None
        return speeds.tread_speed(self.speed, self.vehicle)

    @cached_property
    def _anywhere(self) -> PowerModel:
        """The model without the ground of some place."""
        return without_ground(self.model)

    @cached_property
    def _drawn(self) -> PowerModel:
        return self._anywhere.battery_side() if self.battery else self._anywhere

    def _motion(
        self, x: FloatArray, y: FloatArray, rate: ArrayLike, slope: ArrayLike = 0.0,
        yaw: ArrayLike = 0.0,
    ) -> Motion:  # fmt: skip
        """Steady motion through elements ``(x, y)`` at `rate` of them per second."""
        speed = np.asarray(rate, float)
        steady = {
            **STEADY,
            "yaw": yaw,
            **self.channels,
            "slope": slope,
            "yaw_rate": speed * y / self.half_track,
        }
        channels = {name: np.asarray(value, float) for name, value in steady.items()}
        return Motion(speed * (x - y), speed * (x + y), self.icr, channels)

    @cached_property
    def _static(self) -> bool:
        """Whether speed makes no difference to the energy."""
        x, y = np.concatenate([SPECIAL, SPECIAL + np.array([0.3, 0.1])]).T
        slow, fast = (
            self._drawn.power(self._motion(x, y, rate, yaw=_ROUND[:, None] + 0.0 * x)) / rate
            for rate in (0.1, 0.7)
        )
        return bool(np.allclose(slow, fast, rtol=ROUNDING, atol=0.0))

    @property
    def same_at_any_speed(self) -> bool:
        """Whether speed makes no difference to the energy."""
        return self._static

    @cached_property
    def _least_drawn(self) -> PowerModel:
        """The model whose power bounds drives: without losses where these depend on acceleration.

        Losses add to the power, but do not cancel between speeding up and slowing down.
        """
        drawn = self._drawn
        if _masses(drawn, self.channels) is not None:
            return drawn
        kept = [k for k, one in enumerate(drawn.terms) if one.kind != "loss"]
        lossless = PowerModel(
            drawn.vehicle, tuple(drawn.terms[k] for k in kept), drawn.coefficients[kept]
        )
        gained = any(
            np.any(_power_at(drawn, self.channels, *now) < _power_at(lossless, self.channels, *now))
            for now in ((0.0, 0.0), *_ACCELERATIONS)
        )
        return drawn if gained else lossless

    def kinetic_masses(self) -> FloatArray | None:
        """Return mass [kg] and moment of inertia [kg m^2] whose kinetic energy the model counts.

        None where power, less losses, is not linear in the accelerations, or where it changes with
        the time since the start.
        """
        return _masses(self._least_drawn, self.channels)

    def _forces(self, x: FloatArray, y: FloatArray, rate: FloatArray) -> Sides:
        if not self.of_heading:
            return self._anywhere.forces(self._motion(x, y, rate))
        every = [self._anywhere.forces(self._motion(x, y, rate, yaw=yaw)) for yaw in _ROUND]
        left, right = (
            np.mean([getattr(one, side) for one in every], axis=0) for side in ("left", "right")
        )
        return Sides(left, right)

    def _admissible_rate(self, x: FloatArray, y: FloatArray, fastest: float = np.inf) -> FloatArray:
        rate = speeds.admissible_rate(x, y, self.vehicle, self._forces, fastest)
        return self._within_limit(x, y, rate)

    def _within_limit(self, x: FloatArray, y: FloatArray, rate: FloatArray) -> FloatArray:
        """Return rates at which the reference point keeps the speed limit too."""
        if self.speed_limit == np.inf:
            return rate
        with np.errstate(divide="ignore"):
            along = np.abs(x + self.icr.centre[1] / self.half_track * y)
            return np.asarray(np.minimum(rate, self.speed_limit / along))

    def _rate(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """Rate [1/s] at which elements are driven: the cheapest admissible one; 0 if none is."""
        if self.tread_speed is not None:
            return self._admissible_rate(x, y, self.tread_speed)
        limit = self._admissible_rate(x, y)
        if self._static:
            return limit
        moves = np.asarray(limit > 0)
        if not np.all(moves):
            x, y = (np.broadcast_to(part, limit.shape)[moves] for part in (x, y))
            limit[moves] = self._rate(x, y)
            return limit
        if not np.all(np.isfinite(limit)):
            raise ModelError(
                f"the energy of the model {self.model.name!r} depends on speed, but the vehicle "
                f"{self.vehicle.name!r} has no speed limit; set its motor speed, or give speed="
            )
        slowest = speeds.slowest_rate(x, y, limit, self.vehicle)

        def energy(rate: FloatArray) -> FloatArray:
            yaws = _ROUND if self.of_heading else _ROUND[:1]
            powers = [self._drawn.power(self._motion(x, y, rate, yaw=yaw)) for yaw in yaws]
            mean = np.mean(powers, axis=0) if self.of_heading else powers[0]
            return (mean + self.time_value) / rate

        return speeds.cheapest_rate(slowest, limit, energy)

    def _stuck(self, x: FloatArray, y: FloatArray) -> NDArray[np.bool_]:
        """Return which elements the motors cannot drive at any speed."""
        motor = self.vehicle.motor
        if motor.continuous_power > 0 and motor.regeneration > 0:
            return np.zeros(x.shape, bool)
        moves = (x != 0) | (y != 0)
        rate = self._admissible_rate(np.where(moves, x, 1.0), y)
        return np.asarray(moves & (rate == 0))

    def _as_driven(
        self, of: Callable[..., FloatArray], x: FloatArray, y: FloatArray, slope: ArrayLike = 0.0,
        yaw: ArrayLike = 0.0,
    ) -> FloatArray:  # fmt: skip
        """Return what elements take as they are driven; they must not vanish.

        The inner side of an arc may be dragged along. If its motor takes no power back, no speed
        is slow enough for the arc; a pivot and a line lead the same way.
        """
        stuck = self._stuck(x, y)
        if not np.any(stuck):
            return of(x, y, slope, yaw, self._rate(x, y))
        x, y, slope, yaw, stuck = np.broadcast_arrays(x, y, slope, yaw, stuck)
        total = np.zeros(x.shape)
        free = ~stuck
        rate = self._rate(x[free], y[free])
        total[free] = of(x[free], y[free], slope[free], yaw[free], rate)
        for a, b in _pivot_and_rest(x[stuck], y[stuck]):
            moves = (a != 0) | (b != 0)
            a, b, at = np.where(moves, a, 1.0), np.where(moves, b, 0.0), (slope[stuck], yaw[stuck])
            if np.any(moves & self._stuck(a, b)):
                k = int(np.argmax(moves & self._stuck(a, b)))
                raise ModelError(
                    f"no speed lets the motors of {self.vehicle.name!r} drive {a[k]:.3g} m and "
                    f"{b[k] / self.half_track:.3g} rad: their continuous power is "
                    f"{self.vehicle.motor.continuous_power:g} W, and they take back "
                    f"{self.vehicle.motor.regeneration:g} W; correct these limits, or leave them "
                    "out"
                )
            total[stuck] += np.where(moves, of(a, b, *at, self._rate(a, b)), 0.0)
        return total

    def admissible_speed(self, curvature: ArrayLike) -> FloatArray:
        """Return the largest speed that the vehicle's limits allow on arcs of this curvature."""
        return self._admissible_rate(*self._element(np.ones(np.shape(curvature)), curvature))

    def cheapest_speed(self, curvature: ArrayLike) -> FloatArray:
        """Return the speed at which arcs of this curvature are driven."""
        return self._rate(*self._element(np.ones(np.shape(curvature)), curvature))

    # -- duration -------------------------------------------------------------------------------

    def duration(self, path: Path) -> float:
        """Return the time that a path takes at the speeds of this cost [s].

        Speed changes take no time here; `speed.profile` accounts for accelerations.
        """
        return float(np.sum(self._element_duration(*self._moving(path)[:2])))

    def _element_duration(self, x: FloatArray, y: FloatArray) -> FloatArray:

        def duration(
            x: FloatArray, y: FloatArray, slope: ArrayLike, yaw: ArrayLike, rate: FloatArray
        ) -> FloatArray:
            return np.asarray(1.0 / rate)

        found = self._as_driven(duration, x, y)
        if np.all(found > 0):
            return found
        raise InvalidInputError(
            f"the vehicle {self.vehicle.name!r} has no speed limit, so a motion has no "
            "duration; set its motor speed, or give EnergyCost a speed"
        )

    @cached_property
    def _clock(self) -> DirectionTable:
        """Duration over the direction of motion, tabulated like `gauge`."""
        return direction_table.tabulate(self._element_duration)

    def segment_duration(
        self, ds: ArrayLike, dtheta: ArrayLike, *, exact: bool = False, fastest: bool = False
    ) -> FloatArray:
        """Return the time that arcs take, as they are driven [s]; arguments as in `segment_energy`.

        It comes from a table like that of `gauge` unless it must be `exact`, or is that of the
        `fastest` speed within the limits rather than of the cheapest.
        """
        x, y = np.broadcast_arrays(*self._element(ds, dtheta))
        if not exact and not fastest:
            return self._clock(x, y)
        moves = (x != 0) | (y != 0)
        x = np.where(moves, x, 1.0)
        limited = fastest and self.tread_speed is None
        duration = 1.0 / self._admissible_rate(x, y) if limited else self._element_duration(x, y)
        return np.where(moves, duration, 0.0)
