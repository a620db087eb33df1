"""The robot: wheel contacts and loads, tread ICRs, footprint, motor limits, drive efficiency."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property, partial

import numpy as np
from numpy.typing import ArrayLike, NDArray

from energyplan import html
from energyplan.errors import UnknownNameError, VehicleError
from energyplan.kinds import check_fields, checked, numbers
from energyplan.records import ByValue

LARGEST_EXTENT = 1e4
"""Largest size of a vehicle [m]: far beyond any, and far from overflow."""


@dataclass(frozen=True)
class TreadICR:
    """Instantaneous centres of rotation of the two treads, in the body frame.

    Parameters
    ----------
    left, right : float
        Lateral distance of the left and of the right tread's ICR from the body's x axis [m],
        both positive: the left one lies at ``y = +left``, the right one at ``y = -right``.
    longitudinal : float
        Their common x coordinate [m].

    Raises
    ------
    VehicleError
        If a value is not finite or the slip track is not positive.

    References
    ----------
    Morales et al. (2010), section II.

    Examples
    --------
    >>> TreadICR(left=0.5, right=0.25).slip_track
    0.75
    """

    left: float
    right: float
    longitudinal: float = 0.0

    def __post_init__(self) -> None:
        check_fields(self, VehicleError, "tread ICR ")
        for name in ("left", "right", "longitudinal"):
            value = getattr(self, name)
            if not abs(value) <= LARGEST_EXTENT:  # not of NaN
                raise VehicleError(f"tread ICR {name} is {value}; give metres")
        if not self.slip_track > 0:
            raise VehicleError(
                f"the slip track left + right is {self.slip_track} m; it must be positive"
            )

    @classmethod
    def symmetric(cls, offset: float) -> TreadICR:
        """Return tread ICRs at equal lateral `offset` [m] on both sides."""
        return cls(offset, offset)

    @property
    def slip_track(self) -> float:
        """Distance between the two tread ICRs, ``B = left + right`` [m]."""
        return self.left + self.right

    @property
    def half_track(self) -> float:
        """Half the slip track [m]: the turn radius of a pivot about one tread's ICR."""
        return 0.5 * self.slip_track

    @property
    def centre(self) -> tuple[float, float]:
        """Body coordinates of the point midway between the tread ICRs [m].

        Seen from this point every vehicle has symmetric tread ICRs.
        """
        return self.longitudinal, 0.5 * (self.left - self.right)


def predict_icr(wheelbase: float, track: float) -> float:
    """Lateral tread ICR offset of a four-wheeled vehicle that was not measured.

    Moment balance of a steady spin with equal point loads and isotropic Coulomb friction:
    ``C = a_x + a_y^2 / a_x`` with half track ``a_x`` and half wheelbase ``a_y``.

    Source: docs/theory, section 1.
    """
    return track / 2 + (wheelbase / 2) ** 2 / (track / 2)


__all__ = [
    "DEFAULT_ACCELERATION",
    "GRAVITY",
    "MotorLimits",
    "TreadICR",
    "Vehicle",
    "predict_icr",
    "wheel_loads",
]

GRAVITY = 9.81
"""Gravitational acceleration [m/s^2]."""


DEFAULT_ACCELERATION = 1.0
"""Acceleration of the treads where none is stated [m/s^2]: what small wheeled robots are commonly
set to. A robot without a limit would reach any speed at once."""

_LARGEST_LOAD = 1e9  # [N]
_OUTSIDE, _SLIPPING = 10.0, 90.0  # times a length that are another unit, such as centimetres


def _require(condition: bool, message: str) -> None:
    if not condition:
        raise VehicleError(message)


@dataclass(frozen=True)
class MotorLimits:
    """What one side's motor can do. Infinite where unknown, but for the acceleration.

    Parameters
    ----------
    continuous_power, peak_power : float
        Shaft power that may be drawn for ever, and for a short time [W].
    thermal_time : float
        Length of the window over which the mean must stay within `continuous_power` [s].
    force : float
        Largest force at the tread [N].
    speed : float
        Largest tread speed [m/s].
    acceleration : float
        Largest tread acceleration [m/s^2]; 1 m/s^2 (`DEFAULT_ACCELERATION`) where not given.
    regeneration : float
        Largest power that the drive takes back [W].

    Examples
    --------
    >>> MotorLimits(continuous_power=200.0, peak_power=400.0).speed
    inf
    """

    continuous_power: float = np.inf
    peak_power: float = np.inf
    thermal_time: float = 30.0
    force: float = np.inf
    speed: float = np.inf
    acceleration: float = DEFAULT_ACCELERATION
    regeneration: float = np.inf

    def __post_init__(self) -> None:
        check_fields(self, VehicleError, "motor limit ")
        for name, value in vars(self).items():
            _require(value >= 0, f"motor limit {name} is {value}; give a number >= 0")
        for name in ("speed", "acceleration", "thermal_time"):
            _require(getattr(self, name) > 0, f"motor limit {name} is 0; give a positive number")
        _require(
            self.peak_power >= self.continuous_power or np.isinf(self.continuous_power),
            f"peak_power {self.peak_power} W is below continuous_power "
            f"{self.continuous_power} W; swap or correct them",
        )


def wheel_loads(
    contacts: ArrayLike, mass: float, cog: ArrayLike = (0.0, 0.0)
) -> NDArray[np.float64]:
    """Vertical load on each wheel from mass and centre of gravity.

    With more than three wheels the loads are statically indeterminate. The chassis is taken as
    rigid on equal springs, so that the load is an affine function of the contact's position:
    the solution of force and moment balance with the least sum of squares.
    """
    points = numbers(contacts, "contacts", VehicleError, last=2, words="x, y [m]")
    centre = numbers(cog, "cog", VehicleError, last=2, words="x, y [m]")
    balance = np.vstack([np.ones(len(points)), points.T])
    weight = mass * GRAVITY
    _require(bool(0 < weight < np.inf), f"mass is {mass} kg; give a positive number, not too large")
    target = weight * np.array([1.0, *centre])
    loads, *_ = np.linalg.lstsq(balance, target, rcond=None)
    _require(
        bool(np.allclose(balance @ loads, target, atol=1e-9 * weight)),
        f"the contacts cannot balance a centre of gravity at {tuple(centre.tolist())}",
    )
    _require(
        bool(np.all(loads >= 0)),
        f"with the centre of gravity at {tuple(centre.tolist())} wheel {int(np.argmin(loads))} "
        "would lift off; check the sign and the unit [m]",
    )
    return np.asarray(loads)


@dataclass(frozen=True, eq=False)
class Vehicle(ByValue, html.Readable):
    """A wheeled skid-steer robot.

    Parameters
    ----------
    name : str
        What to call it.
    contacts : ndarray, shape (n, 2)
        Wheel contact points in the body frame, x forward and y left [m].
    loads : ndarray, shape (n,)
        Vertical load on each contact [N].
    icr : TreadICR
        Tread ICRs.
    footprint : ndarray, shape (2, 2)
        Rectangle ``[[x_min, y_min], [x_max, y_max]]`` in the body frame [m].
    motor : MotorLimits
        Limits of each side's motor.
    drive_efficiency : float
        Battery to tread when drawing, in (0, 1]. The paper's sums take 1.
    regen_efficiency : float
        Tread to battery when returning, in [0, 1]; 0 for drives that brake on a resistor.
    max_yaw_rate : float
        Largest yaw rate [rad/s].
    battery_power, battery_return : float
        Largest power that the battery delivers, and takes back [W].
    usual_speed : float
        Speed of the faster tread at which the vehicle is usually driven [m/s]; as fast as its
        limits allow where infinite.
    tracking_tolerance : float
        How far the vehicle may leave its path [m]: corners are rounded so far, where the ground is
        free, instead of stopping at them. With 0 it stops.

    Raises
    ------
    VehicleError
        If shapes, loads, efficiencies or limits are wrong.

    Examples
    --------
    >>> robot = Vehicle.preset("quadriga:full")
    >>> round(robot.mass, 1), robot.icr.slip_track
    (147.1, 0.94)
    """

    name: str
    contacts: NDArray[np.float64]
    loads: NDArray[np.float64]
    icr: TreadICR
    footprint: NDArray[np.float64]
    motor: MotorLimits = field(default_factory=MotorLimits)
    drive_efficiency: float = 1.0
    regen_efficiency: float = 1.0
    max_yaw_rate: float = np.inf
    battery_power: float = np.inf
    battery_return: float = np.inf
    usual_speed: float = np.inf
    tracking_tolerance: float = 0.0

    def __post_init__(self) -> None:
        check_fields(self, VehicleError)
        for name, width in (("contacts", 2), ("footprint", 2)):
            value = np.array(getattr(self, name), float)
            _require(
                value.ndim == 2 and value.shape[1] == width and len(value) > 0,
                f"{name} has shape {value.shape}; give rows of (x, y) [m]",
            )
            value.setflags(write=False)
            object.__setattr__(self, name, value)
        loads = np.array(self.loads, float)
        loads.setflags(write=False)
        object.__setattr__(self, "loads", loads)
        _require(
            loads.shape == (len(self.contacts),),
            f"{len(self.contacts)} contacts but loads of shape {loads.shape}; give one load each",
        )
        extent = np.max([np.max(np.abs(value)) for value in (self.contacts, self.footprint)])
        _require(
            extent <= LARGEST_EXTENT,  # not of NaN
            f"contacts or footprint reach {extent:g} m from the centre; give finite metres",
        )
        _require(
            bool(np.all((loads >= 0) & (loads <= _LARGEST_LOAD)) and np.any(loads > 0)),
            f"loads are {loads.tolist()}; give newtons from 0 to {_LARGEST_LOAD:g}, not all zero",
        )
        wide, body = (float(np.abs(value).max()) for value in (self.contacts, self.footprint))
        _require(
            wide <= _OUTSIDE * body,
            f"a wheel stands {wide:g} m from the centre, the footprint reaches {body:g} m; give "
            "both in metres",
        )
        reach = max(map(abs, (self.icr.left, self.icr.right, self.icr.longitudinal)))
        _require(
            reach <= _SLIPPING * wide,
            f"a tread ICR lies {reach:g} m from the centre, the wheels at most {wide:g} m; give "
            "both in metres",
        )
        sides = np.sign(self.contacts[:, 1])
        _require(
            bool(np.any(sides > 0) and np.any(sides < 0)),
            "every wheel is on one side; contacts need y > 0 (left) and y < 0 (right)",
        )
        _require(
            self.footprint.shape == (2, 2) and bool(np.all(self.footprint[1] > self.footprint[0])),
            "footprint must be [[x_min, y_min], [x_max, y_max]] with x_max > x_min, y_max > y_min",
        )
        _require(
            0 < self.drive_efficiency <= 1,
            f"drive_efficiency is {self.drive_efficiency}; give a fraction in (0, 1]",
        )
        _require(
            0 <= self.regen_efficiency <= 1,
            f"regen_efficiency is {self.regen_efficiency}; give a fraction in [0, 1]",
        )
        for name in ("max_yaw_rate", "battery_power", "usual_speed"):
            _require(getattr(self, name) > 0, f"{name} is {getattr(self, name)}; must be positive")
        for name in ("battery_return", "tracking_tolerance"):
            _require(getattr(self, name) >= 0, f"{name} is {getattr(self, name)}; give 0 or more")
        _require(self.tracking_tolerance < np.inf, "tracking_tolerance is infinite; give metres")

    def _summaries(self) -> list[html.Summary]:
        rows = {"mass [kg]": self.mass, "slip track [m]": self.icr.slip_track}
        return [html.Summary(self.name, ("", ""), rows.items())]

    @property
    def mass(self) -> float:
        """Mass that rests on the wheels [kg]."""
        return float(self.loads.sum() / GRAVITY)

    @property
    def driving_speed(self) -> float:
        """Tread speed at which it is driven where nothing else is asked for [m/s]."""
        return min(self.usual_speed, self.motor.speed)

    def up_to(self, speed: float) -> Vehicle:
        """Return the vehicle with treads that run at most at some speed [m/s].

        Examples
        --------
        >>> Vehicle.preset("husky_a200").up_to(0.3).motor.speed
        0.3
        """
        motor = replace(self.motor, speed=min(speed, self.motor.speed))
        return replace(self, motor=motor)

    @property
    def yaw_inertia(self) -> float:
        """Moment of inertia about the vertical [kg m^2], taken as that of the footprint's box."""
        length, width = self.footprint[1] - self.footprint[0]
        return self.mass * float(length**2 + width**2) / 12.0

    @cached_property
    def slip_moment(self) -> float:
        """Sum of load times distance of each contact from its tread's ICR [N m] (Eq. 2)."""
        left = self.contacts[:, 1] > 0
        icr_y = np.where(left, self.icr.left, -self.icr.right)
        reach = np.hypot(self.contacts[:, 0] - self.icr.longitudinal, self.contacts[:, 1] - icr_y)
        return float(self.loads @ reach)

    def with_icr(self, icr: TreadICR) -> Vehicle:
        """Return this vehicle with other tread ICRs."""
        return replace(self, icr=icr)

    @checked(VehicleError)
    def with_mass(self, mass: float, cog: ArrayLike = (0.0, 0.0)) -> Vehicle:
        """Return this vehicle with wheel loads from another mass [kg] and centre of gravity [m]."""
        return replace(self, loads=wheel_loads(self.contacts, mass, cog))

    @classmethod
    @checked(VehicleError)
    def from_geometry(
        cls,
        name: str,
        *,
        mass: float,
        wheelbase: float,
        track: float,
        length: float,
        width: float,
        cog: ArrayLike = (0.0, 0.0),
        icr: TreadICR | None = None,
        motor: MotorLimits | None = None,
        **limits: float,
    ) -> Vehicle:
        """Build a four-wheeled vehicle that is symmetric about its centre.

        Parameters
        ----------
        name : str
            What to call it.
        mass : float
            Mass [kg].
        wheelbase, track : float
            Distance between front and rear, and between left and right contacts [m].
        length, width : float
            Footprint [m].
        cog : array_like, shape (2,)
            Centre of gravity [m].
        icr : TreadICR, optional
            Tread ICRs; predicted by `predict_icr` where not given.
        motor : MotorLimits, optional
            Limits of each side's motor.
        **limits : float
            Efficiencies, limits, usual speed and tolerance, as in `Vehicle`.

        Returns
        -------
        Vehicle
            The vehicle.

        Raises
        ------
        VehicleError
            If a dimension or the mass is not positive.
        """
        names = ("mass", "wheelbase", "track", "length", "width")
        for key, value in zip(names, (mass, wheelbase, track, length, width), strict=True):
            _require(bool(np.isfinite(value)) and value > 0, f"{key} is {value}; must be positive")
        x, y = wheelbase / 2, track / 2
        contacts = np.array([(x, y), (-x, y), (x, -y), (-x, -y)])
        return cls(
            name=name,
            contacts=contacts,
            loads=wheel_loads(contacts, mass, cog),
            icr=icr or TreadICR.symmetric(predict_icr(wheelbase, track)),
            footprint=np.array([(-length / 2, -width / 2), (length / 2, width / 2)]),
            motor=motor or MotorLimits(),
            **limits,
        )

    @classmethod
    def preset(cls, name: str) -> Vehicle:
        """Return a ready-made vehicle, such as ``quadriga:full``, ``husky_a200``, ``warthog``.

        Parameters
        ----------
        name : str
            Name of the preset.

        Returns
        -------
        Vehicle
            The vehicle.

        Raises
        ------
        UnknownNameError
            If there is no such preset.

        Examples
        --------
        >>> round(Vehicle.preset("quadriga:full").slip_moment)
        467
        """
        if name not in VEHICLE_PRESETS:
            raise UnknownNameError("vehicle preset", name, VEHICLE_PRESETS)
        return VEHICLE_PRESETS[name]()


# Morales et al. (2010), section IV and Table I. The paper gives no motor ratings; the limits are
# those of a drive that reaches its 1.2 m/s and can spin on concrete with a full tank.
_quadriga = partial(
    Vehicle.from_geometry, wheelbase=0.475, track=0.5, length=0.82, width=0.64,
    icr=TreadICR.symmetric(0.47),
    motor=MotorLimits(continuous_power=400.0, peak_power=800.0, force=900.0, speed=1.2,
                      acceleration=1.0, regeneration=400.0),
)  # fmt: skip
_empty = partial(_quadriga, "quadriga:empty", mass=83.1, cog=(0.0089, 0.0006))

VEHICLE_PRESETS: dict[str, Callable[[], Vehicle]] = {
    "quadriga": _empty,
    "quadriga:empty": _empty,
    "quadriga:full": partial(_quadriga, "quadriga:full", mass=147.1, cog=(0.0202, -0.0005)),
    # Clearpath Husky A200 as equipped for BorealTC.
    "husky_a200": partial(
        Vehicle.from_geometry, "husky_a200", mass=70.0, wheelbase=0.512, track=0.555, length=0.99,
        width=0.67,
        motor=MotorLimits(peak_power=1000.0, continuous_power=400.0, speed=1.0, acceleration=3.0),
    ),
    # Clearpath Jackal, by the maker's data sheet.
    "jackal": partial(
        Vehicle.from_geometry, "jackal", mass=17.0, wheelbase=0.262, track=0.376, length=0.508,
        width=0.43,
        motor=MotorLimits(peak_power=250.0, continuous_power=125.0, speed=2.0, acceleration=4.0),
    ),
    # Clearpath Warthog as equipped for Norlab's DRIVE data, which give the mass; footprint and
    # speed by the maker's data sheet; contacts that predict the slip track of 1.85 m that the data
    # show. The maker gives no power: half above what the drive on grass takes.
    "warthog": partial(
        Vehicle.from_geometry, "warthog", mass=470.0, wheelbase=0.91, track=1.13, length=1.52,
        width=1.38,
        motor=MotorLimits(peak_power=3600.0, speed=5.0, acceleration=1.0),
    ),
}  # fmt: skip
"""Ready-made vehicles, by name."""
