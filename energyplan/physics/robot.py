"""The true robot and the true ground in the physics engine."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from energyplan.errors import InvalidInputError, ModelError
from energyplan.path import FloatArray
from energyplan.power import PowerModel
from energyplan.terrain import HeightMap, SurfaceMap
from energyplan.vehicle import Vehicle

_OF_ITSELF = (
    "slip_friction", "traction_resistance", "grade", "specific_force", "linear_inertia",
    "angular_inertia",
)  # fmt: skip
"""Terms whose cause the engine has in any case."""

_FIELDS = {
    "viscous_loss": "viscous", "air_drag": "drag", "towing_force": "towing",
    "slip_speed_friction": "slip_speed", "drive_efficiency": "drive_loss",
    "regeneration_efficiency": "regeneration_loss", "copper_loss": "copper",
    "hotel_load": "hotel", "warm_up": "warm_up",
}  # fmt: skip
_ON_SIDES = {
    "dragging_wheel_left": (1.0, 0.0), "dragging_wheel_right": (0.0, 1.0),
    "traction_asymmetry": (1.0, -1.0),
}  # fmt: skip
_TILTS = ("tilt_x", "tilt_y")
"""What a term of a power model is in the engine."""


@dataclass(frozen=True)
class Border:
    """A straight border on the ground, beyond which wheels find another surface."""

    friction: float = 0.0
    traction: float = 0.0
    direction: float = 0.0  # direction of the normal that points beyond the border [rad]
    offset: float = 0.0  # distance of the border from the world's origin along that normal [m]

    def beyond(self, points: FloatArray) -> np.ndarray:
        """Tell which points, shape (n, 2), lie beyond the border."""
        normal = np.array([np.cos(self.direction), np.sin(self.direction)])
        return np.asarray(points @ normal > self.offset)


@dataclass(frozen=True)
class Robot:
    """A skid-steer robot as the engine knows it: four or more wheels, Coulomb friction, two motors.

    The tread ICRs of the vehicle are not used: they follow from the contacts. Only the tracking
    controller believes in them.
    """

    vehicle: Vehicle  # contacts, loads, footprint (for the inertia), motor limits
    friction: float  # coulomb friction coefficient of every contact [1]
    traction: tuple[float, float]  # [N]
    rolling_share: float = 0.5  # [1]
    viscous: float = 0.0  # force per tread speed of each side [N s/m]
    drag: float = 0.0  # force per square of the body's speed [N s^2/m^2]
    towing: float = 0.0  # constant force along the body's x axis that a motor must overcome [N]
    tilt: tuple[float, float] = (0.0, 0.0)  # [1]
    warm_up: float = 0.0
    warm_up_time: float = 60.0
    slip_speed: float = 0.0  # growth of the friction coefficient with a contact's slip speed [s/m]
    border: Border | None = None  # where the ground changes
    drive_loss: float = 0.0  # [1]
    regeneration_loss: float = 0.0  # [1]
    copper: float = 0.0  # power lost per square of a side's force [W/N^2]
    hotel: float = 0.0  # constant draw [W]
    sharing: float = 0.1  # [s]
    height: float | None = None  # height of the centre of mass [m]

    def __post_init__(self) -> None:
        for name in ("friction", "height", "warm_up_time"):
            value = getattr(self, name)
            if value is not None and not (np.isfinite(value) and value > 0):
                raise InvalidInputError(f"{name} is {value}; give a positive number")
        if not self.sharing > 0:
            raise InvalidInputError(f"sharing is {self.sharing}; give a positive time")
        ranges = {
            "rolling_share": 1.0, "viscous": np.inf, "drag": np.inf, "warm_up": np.inf,
            "drive_loss": np.inf, "regeneration_loss": 1.0, "copper": np.inf, "hotel": np.inf,
        }  # fmt: skip
        for name, most in ranges.items():
            value = getattr(self, name)
            if not (np.isfinite(value) and 0 <= value <= most):
                raise InvalidInputError(f"{name} is {value}; give a number from 0 to {most:g}")
        for name in ("traction", "tilt"):
            pair = np.asarray(getattr(self, name), float)
            if pair.shape != (2,) or not np.all(np.isfinite(pair)):
                raise InvalidInputError(f"{name} is {getattr(self, name)}; give two numbers")
            object.__setattr__(self, name, tuple(float(v) for v in pair))
        if min(self.traction) < 0:
            raise InvalidInputError(f"traction is {self.traction}; a side cannot have less than 0")
        if not np.all(np.isfinite([self.towing, self.slip_speed])):
            raise InvalidInputError("towing and slip_speed must be finite numbers")
        if np.hypot(*self.tilt) > 1.0:
            raise InvalidInputError(f"tilt is {self.tilt}; beyond 45 degrees no robot stands")
        points = self.vehicle.contacts[self.vehicle.loads > 0]
        if np.linalg.matrix_rank(points - points.mean(0), tol=1e-6) < 2:
            raise InvalidInputError(
                f"the loaded wheels of {self.vehicle.name} stand on one line, so it would tip "
                "over; give three or more that span an area"
            )

    @property
    def centre_height(self) -> float:
        """Height of the centre of mass [m]."""
        if self.height is not None:
            return self.height
        return 0.35 * float(np.ptp(self.vehicle.contacts[:, 0]))

    @classmethod
    def from_model(cls, model: PowerModel) -> Robot:
        """Return the robot that a power model describes."""
        model = model.battery_side()
        for name in ("slip_friction", "traction_resistance"):
            if not model.has(name):
                raise ModelError(
                    f"model {model.name!r} has no term {name!r}, so nothing holds the wheels; "
                    "give a model that identify or diagnose wrote"
                )
        resistance = model.coefficient("traction_resistance")
        traction, tilt = (resistance, resistance), [0.0, 0.0]
        values: dict[str, float] = {}
        for term, value in zip(model.terms, model.coefficients.tolist(), strict=True):
            if term.name in _FIELDS:
                values[_FIELDS[term.name]] = value
            elif term.name in _ON_SIDES:
                left, right = _ON_SIDES[term.name]
                traction = (traction[0] + left * value, traction[1] + right * value)
            elif term.name in _TILTS:
                tilt[_TILTS.index(term.name)] = value / model.vehicle.mass
            elif term.name not in _OF_ITSELF:
                known = sorted({*_FIELDS, *_ON_SIDES, *_TILTS, *_OF_ITSELF})
                raise ModelError(
                    f"the term {term.name!r} of model {model.name!r} has no counterpart in the "
                    f"engine; it knows {', '.join(known)}"
                )
            if term.name == "warm_up":
                values["warm_up_time"] = float(term.params["time_constant"])
        # A tilt is a gradient: the tangent of the angle whose sine the term gives.
        sine = float(np.hypot(tilt[0], tilt[1]))
        if sine >= 1.0:
            raise ModelError(f"model {model.name!r} tilts the ground by more than a right angle")
        steep = float(1.0 / np.sqrt(1.0 - sine**2))
        robot = cls(
            model.vehicle,
            model.coefficient("slip_friction"),
            traction,
            tilt=(steep * tilt[0], steep * tilt[1]),
        )
        return replace(robot, **values)  # type: ignore[arg-type]


@dataclass(frozen=True)
class Ground:
    """Where friction, resistance and slope change on the way."""

    surfaces: SurfaceMap | None = None  # surfaces
    heights: HeightMap | None = None  # heights of the ground

    def grip(self, robot: Robot, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return friction [1] and a factor on the traction resistance [1] at points (n, 2)."""
        friction = np.full(len(points), robot.friction)
        factor = np.ones(len(points))
        mean = float(np.mean(robot.traction))
        if self.surfaces is not None:
            region = self.surfaces.region_at(points)
            for k, surface in enumerate(self.surfaces.surfaces, start=1):
                friction[region == k] = surface.model.coefficient("slip_friction")
                if mean > 0:
                    here = surface.model.coefficient("traction_resistance")
                    factor[region == k] = here / mean
        if robot.border is not None:
            there = robot.border.beyond(points)
            friction[there] += robot.border.friction
            if mean > 0:
                factor[there] += robot.border.traction / mean
        return np.maximum(friction, 1e-3), np.maximum(factor, 0.0)

    def gradient(self, robot: Robot, x: float, y: float) -> FloatArray:
        """Return the gradient of the ground at a point, shape (2,) [1]."""
        steep = np.array(robot.tilt)
        if self.heights is not None:
            steep = steep + self.heights.gradient(np.array([x, y]))
        return steep
