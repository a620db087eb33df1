"""The robot: wheel contacts and loads, tread ICRs, footprint, motor limits, drive efficiency."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import field, replace
from functools import cached_property, partial
from typing import Annotated, Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from energyplan import html
from energyplan.errors import UnknownNameError, VehicleError
from energyplan.path import PLACE
from energyplan.records import Array, ByValue, Scalar, Text, Within, checked, numbers, record

ICR = Annotated[Scalar, Within((-1e3, 1e3), (-20, 20), "m")]
Power = Annotated[Scalar, Within((0, 1e6), (0, 5e4), "W", endless=True)]
Speed = Annotated[Scalar, Within((1e-3, 50), (0.05, 15), "m/s", endless=True)]
Size = Annotated[Scalar, Within((0.01, 30), (0.1, 6), "m", "not centimetres")]
Positions = Annotated[Array, Within((-30, 30), (-6, 6), "m")]
Mass = Annotated[Scalar, Within((0.05, 1e5), (0.5, 5e3), "kg", "not grams")]


@record(VehicleError, whose="tread ICR ")
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

    left: ICR
    right: ICR
    longitudinal: ICR = 0.0

    def __post_init__(self) -> None:
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
        """Body coordinates of the point midway between the tread ICRs [m]."""
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
    "layout",
    "predict_icr",
    "wheel_loads",
]

GRAVITY = 9.81  # gravitational acceleration [m/s^2]


DEFAULT_ACCELERATION = 1.0
"""Acceleration of the treads where none is stated [m/s^2]: what small wheeled robots are commonly
set to. A robot without a limit would reach any speed at once."""

_SLIPPING = 90.0  # times the distance of the wheels: a tread ICR that is in another unit
_SIZES, _WHEELS = ("length", "width"), ("wheelbase", "track")  # along x and y


def _require(condition: bool, message: str, *place: str) -> None:
    if not condition:
        raise VehicleError(message, place)


@record(VehicleError, whose="motor limit ")
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

    continuous_power: Power = np.inf
    peak_power: Power = np.inf
    thermal_time: Annotated[Scalar, Within((1e-3, 1e6), (1, 3600), "s", endless=True)] = 30.0
    force: Annotated[Scalar, Within((0, 1e6), (1, 5e4), "N", endless=True)] = np.inf
    speed: Speed = np.inf
    acceleration: Annotated[Scalar, Within((1e-3, 1e3), (0.05, 20), "m/s^2", endless=True)] = (
        DEFAULT_ACCELERATION
    )
    regeneration: Power = np.inf

    def __post_init__(self) -> None:
        _require(
            self.peak_power >= self.continuous_power or np.isinf(self.continuous_power),
            f"peak_power {self.peak_power} W is below continuous_power "
            f"{self.continuous_power} W; swap or correct them",
        )


def layout(
    wheelbase: float, track: float, length: float, width: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return contacts and footprint of four wheels that are symmetric about the centre."""
    x, y = wheelbase / 2, track / 2
    corners = (-length / 2, -width / 2), (length / 2, width / 2)
    return np.array([(x, y), (-x, y), (x, -y), (-x, -y)]), np.array(corners)


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


@record(VehicleError, eq=False, whose="")
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
    reverse : bool
        Whether it may drive backwards. Where it may not, it still turns on the spot.

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

    also: ClassVar = ("kind", "preset", "mass", "cog", "wheelbase", "track", "length", "width")

    name: Text
    contacts: Positions
    loads: Annotated[Array, Within((0, 1e6), (0.1, 1.5e4), "N")]
    icr: TreadICR
    footprint: Positions
    motor: MotorLimits = field(default_factory=MotorLimits)
    drive_efficiency: Annotated[Scalar, Within((0.01, 1), (0.3, 1), "", "90 % is 0.9")] = 1.0
    regen_efficiency: Annotated[Scalar, Within((0, 1), (0, 1), "", "90 % is 0.9")] = 1.0
    max_yaw_rate: Annotated[Scalar, Within((1e-3, 100), (0.05, 20), "rad/s", endless=True)] = np.inf
    battery_power: Annotated[Scalar, Within((0.1, 1e6), (5, 1e5), "W", endless=True)] = np.inf
    battery_return: Annotated[Scalar, Within((0, 1e6), (0, 1e5), "W", endless=True)] = np.inf
    usual_speed: Speed = np.inf
    tracking_tolerance: Annotated[Scalar, Within((0, 10), (0, 0.5), "m")] = 0.0
    reverse: bool = True

    def __post_init__(self) -> None:
        for name, value in (("contacts", self.contacts), ("footprint", self.footprint)):
            _require(
                value.ndim == 2 and value.shape[1] == 2 and len(value) > 0,
                f"{name} has shape {value.shape}; give rows of (x, y) [m]",
                name,
            )
        loads = self.loads
        _require(
            loads.shape == (len(self.contacts),),
            f"{len(self.contacts)} contacts but loads of shape {loads.shape}; give one load each",
        )
        _require(bool(np.any(loads > 0)), "loads are all 0; give newtons")
        _require(
            self.footprint.shape == (2, 2) and bool(np.all(self.footprint[1] > self.footprint[0])),
            "footprint must be [[x_min, y_min], [x_max, y_max]] with x_max > x_min, y_max > y_min",
        )
        beyond = np.maximum(self.footprint[0] - self.contacts, self.contacts - self.footprint[1])
        wheel, axis = np.unravel_index(int(np.argmax(beyond)), beyond.shape)
        _require(
            beyond[wheel, axis] <= PLACE,
            f"wheel {wheel} stands {beyond[wheel, axis]:.3g} m outside the footprint along "
            f"{'xy'[axis]}; the footprint contains all wheels: enlarge {_SIZES[axis]}, or correct "
            f"{_WHEELS[axis]}; both are in metres",
            _SIZES[axis],
        )
        wide = float(np.abs(self.contacts).max())
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

    def _summaries(self) -> list[html.Summary]:
        rows = {"mass [kg]": self.mass, "slip track [m]": self.icr.slip_track}
        return [html.Summary(self.name, ("", ""), rows.items())]

    @property
    def mass(self) -> float:
        """Mass that rests on the wheels [kg]."""
        return float(self.loads.sum() / GRAVITY)

    @property
    def driving_speed(self) -> float:
        """Tread speed at which it is driven by default [m/s]."""
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
        mass: Mass,
        wheelbase: Size,
        track: Size,
        length: Size,
        width: Size,
        cog: ArrayLike = (0.0, 0.0),
        icr: TreadICR | None = None,
        motor: MotorLimits | None = None,
        **limits: Any,
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
        **limits : object
            Efficiencies, limits, usual speed, tolerance and reversing, as in `Vehicle`.

        Returns
        -------
        Vehicle
            The vehicle.

        Raises
        ------
        VehicleError
            If a dimension or the mass is not positive.
        """
        contacts, footprint = layout(wheelbase, track, length, width)
        return cls(
            name=name,
            contacts=contacts,
            loads=wheel_loads(contacts, mass, cog),
            footprint=footprint,
            icr=icr or TreadICR.symmetric(predict_icr(wheelbase, track)),
            motor=motor or MotorLimits(),
            **limits,
        )

    @classmethod
    def preset(cls, name: str) -> Vehicle:
        """Return a preset vehicle, such as ``quadriga:full``, ``husky_a200``, ``warthog``.

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
"""Preset vehicles, by name."""
