"""A robot and its ground as the engine knows them, and hidden effects to switch on."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike

from energyplan.errors import InvalidInputError, ModelError, UnknownNameError
from energyplan.path import FloatArray
from energyplan.power import PowerModel
from energyplan.records import ReadOnly, Scalar, Within, record
from energyplan.terrain import HeightMap, SurfaceMap
from energyplan.vehicle import GRAVITY, Vehicle

_OF_ITSELF = (
    "slip_friction", "traction_resistance", "grade", "specific_force", "linear_inertia",
    "angular_inertia",
)  # fmt: skip
"""Terms whose cause the engine has in any case."""

_ON_SIDES = {"dragging_wheel_left": (1.0, 0.0)}
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
        """Return which points, shape (n, 2), lie beyond the border."""
        normal = np.array([np.cos(self.direction), np.sin(self.direction)])
        return np.asarray(points @ normal > self.offset)


Amount = Annotated[Scalar, Within((0, 1e6), (0, 1e6))]
Positive = Annotated[Scalar, Within((1e-6, 1e6), (1e-6, 1e6))]
Time = Annotated[Scalar, Within((1e-6, 1e6), (1e-6, 1e6), "s", endless=True)]
Signed = Annotated[Scalar, Within((-1e6, 1e6), (-1e6, 1e6))]
Share = Annotated[Scalar, Within((0, 1), (0, 1))]


@record(InvalidInputError, whose="")
class EngineRobot:
    """A skid-steer robot as the engine knows it: wheels, Coulomb friction, two motors."""

    vehicle: Vehicle  # contacts, loads, footprint (for the inertia), motor limits
    friction: Positive  # coulomb friction coefficient of every contact [1]
    traction: tuple[Amount, Amount]  # traction resistance of the left and of the right side [N]
    rolling_share: Share = 0.5  # share of the traction resistance that grows with the load [1]
    viscous: Amount = 0.0  # force per tread speed of each side [N s/m]
    drag: Amount = 0.0  # force per square of the body's speed [N s^2/m^2]
    towing: Signed = 0.0  # constant force along the body's x axis that a motor must overcome [N]
    tilt: tuple[Signed, Signed] = (0.0, 0.0)  # gradient of the ground towards world x and y [1]
    warm_up: Amount = 0.0  # further traction resistance of each side when cold [N]
    warm_up_time: Positive = 60.0  # time constant in which that vanishes [s]
    slip_speed: Signed = 0.0  # growth of the friction coefficient with the slip speed [s/m]
    border: Border | None = None  # where the ground changes
    drive_loss: Amount = 0.0  # power drawn beyond the shaft power, ``1/eta - 1`` of it [1]
    regeneration_loss: Share = 0.0  # share of returned shaft power that is lost, ``1 - eta_r`` [1]
    copper: Amount = 0.0  # power lost per square of a side's force [W/N^2]
    hotel: Amount = 0.0  # constant draw [W]
    sharing: Time = 0.1  # in which sides that go straight come to share the load [s]
    height: Positive | None = None  # height of the centre of mass [m]

    def __post_init__(self) -> None:
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
    def from_model(cls, model: PowerModel) -> EngineRobot:
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
        named = {"warm_up": "warm_up"}
        named |= {name: k.apply for name, k in _EFFECTS.items() if isinstance(k.apply, str)}
        for term, value in zip(model.terms, model.coefficients.tolist(), strict=True):
            if term.name in named:
                values[named[term.name]] = value
            elif term.name in _ON_SIDES:
                left, right = _ON_SIDES[term.name]
                traction = (traction[0] + left * value, traction[1] + right * value)
            elif term.name in _TILTS:
                tilt[_TILTS.index(term.name)] = value / model.vehicle.mass
            elif term.name not in _OF_ITSELF:
                known = sorted({*named, *_ON_SIDES, *_TILTS, *_OF_ITSELF})
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
class EngineGround:
    """Where friction, resistance and slope change on the way."""

    surfaces: SurfaceMap | None = None  # surfaces
    heights: HeightMap | None = None  # heights of the ground

    def grip(self, robot: EngineRobot, points: FloatArray) -> tuple[FloatArray, FloatArray]:
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

    def gradient(self, robot: EngineRobot, x: float, y: float) -> FloatArray:
        """Return the gradient of the ground at a point, shape (2,) [1]."""
        steep = np.array(robot.tilt)
        if self.heights is not None:
            steep = steep + self.heights.gradient(np.array([x, y]))
        return steep


FULL_EFFORT = 0.5
"""Tread speed [m/s] at which the sizes of drawn effects are compared with the resistance."""


_Apply = Callable[[EngineRobot, float, Mapping[str, float]], EngineRobot]
_Draw = Callable[[EngineRobot, np.random.Generator], float]


def _drags(left: float, right: float) -> _Apply:
    def apply(robot: EngineRobot, size: float, details: Mapping[str, float]) -> EngineRobot:
        here = robot.traction
        return replace(robot, traction=(here[0] + left * size, here[1] + right * size))

    return apply


def _tilts(robot: EngineRobot, size: float, details: Mapping[str, float]) -> EngineRobot:
    direction, steep = details.get("direction", 0.0), float(np.tan(size))
    x, y = robot.tilt
    return replace(
        robot, tilt=(x + steep * np.cos(direction), y + steep * np.sin(direction))
    )  # fmt: skip


def _shifts(robot: EngineRobot, size: float, details: Mapping[str, float]) -> EngineRobot:
    vehicle, direction = robot.vehicle, details.get("direction", 0.0)
    centre = vehicle.loads @ vehicle.contacts / vehicle.loads.sum()
    moved = centre + size * np.array([np.cos(direction), np.sin(direction)])
    return replace(robot, vehicle=vehicle.with_mass(vehicle.mass, moved))


def _loads(robot: EngineRobot, size: float, details: Mapping[str, float]) -> EngineRobot:
    vehicle = robot.vehicle
    factor = (vehicle.mass + size) / vehicle.mass
    if factor <= 0:
        raise InvalidInputError(
            f"a payload of {size} kg leaves nothing of {vehicle.name}'s {vehicle.mass:.4g} kg"
        )
    rolling = 1 + robot.rolling_share * (factor - 1)
    share = robot.rolling_share * factor / rolling
    left, right = robot.traction
    return replace(
        robot,
        vehicle=replace(vehicle, loads=vehicle.loads * factor),
        traction=(left * rolling, right * rolling),
        rolling_share=share,
    )


def _warms(robot: EngineRobot, size: float, details: Mapping[str, float]) -> EngineRobot:
    tau = details.get("time_constant", robot.warm_up_time)
    return replace(robot, warm_up=robot.warm_up + size, warm_up_time=tau)


def _borders(robot: EngineRobot, size: float, details: Mapping[str, float]) -> EngineRobot:
    # The rolling resistance changes in proportion to the friction.
    traction = size / robot.friction * float(np.mean(robot.traction))
    place = Border(
        size, traction, details.get("direction", 0.0), details.get("offset", 0.0)
    )  # fmt: skip
    if robot.border is not None:
        raise InvalidInputError("two borders are more than the engine knows; give surfaces instead")
    return replace(robot, border=place)


@dataclass(frozen=True)
class EffectKind:
    """A kind of effect."""

    apply: _Apply | str  # from robot, size and details to a robot, or the value that grows by it
    unit: str  # unit of the size
    meaning: str  # one line
    draw: _Draw  # ``draw(robot, rng) -> float``, a size large enough to find
    details: tuple[str, ...] = ()  # further numbers that it takes


def _resistance(robot: EngineRobot) -> float:
    return float(np.mean(robot.traction)) or 0.05 * robot.vehicle.mass * GRAVITY / 2


def _times(
    low: float, high: float, scale: Callable[[EngineRobot], float], sign: bool = False
) -> _Draw:
    """Return a draw between two multiples of a scale, of either sign where `sign` is set."""

    def draw(robot: EngineRobot, rng: np.random.Generator) -> float:
        size = rng.uniform(low, high) * scale(robot)
        return float(size if not sign or rng.random() < 0.5 else -size)

    return draw


def _one(robot: EngineRobot) -> float:
    return 1.0


_EFFECTS: dict[str, EffectKind] = {
    "viscous_loss": EffectKind(
        "viscous", "N s/m", "resistance of each side that rises with its speed",
        _times(0.25, 0.8, lambda r: _resistance(r) / FULL_EFFORT),
    ),
    "air_drag": EffectKind(
        "drag", "N s^2/m^2", "resistance that rises with the square of the speed",
        _times(0.25, 0.8, lambda r: 2 * _resistance(r) / FULL_EFFORT**2),
    ),
    "tilted_plane": EffectKind(
        _tilts, "rad", "ground that is one tilted plane", _times(0.02, 0.07, _one),
        details=("direction",),
    ),
    "dragging_wheel_left": EffectKind(
        _drags(1.0, 0.0), "N", "more resistance on the left side",
        _times(0.3, 1.0, _resistance),
    ),
    "dragging_wheel_right": EffectKind(
        _drags(0.0, 1.0), "N", "more resistance on the right side",
        _times(0.3, 1.0, _resistance),
    ),
    "centre_of_mass": EffectKind(
        _shifts, "m", "centre of mass off centre",
        _times(0.1, 0.3, lambda r: float(np.abs(r.vehicle.contacts).min())), ("direction",),
    ),
    "towing_force": EffectKind(
        "towing", "N", "a constant force along the body, against forward motion",
        _times(0.3, 0.8, lambda r: 2 * _resistance(r), sign=True),
    ),
    "payload": EffectKind(
        _loads, "kg", "further mass, spread like the robot's own",
        _times(0.1, 0.35, lambda r: r.vehicle.mass),
    ),
    "surface_border": EffectKind(
        _borders, "1", "more friction, and as many times more resistance, beyond a line",
        _times(0.15, 0.4, lambda r: r.friction, sign=True), ("direction", "offset"),
    ),
    "slip_speed_friction": EffectKind(
        "slip_speed", "s/m", "friction that grows with the slip speed",
        _times(0.3, 0.8, lambda r: r.friction),
    ),
    "warm_up": EffectKind(
        _warms, "N", "further resistance of each side when cold",
        _times(0.4, 1.0, _resistance), ("time_constant",),
    ),
    "hotel_load": EffectKind(
        "hotel", "W", "constant draw",
        _times(0.2, 0.8, lambda r: 2 * _resistance(r) * FULL_EFFORT),
    ),
    "drive_efficiency": EffectKind(
        "drive_loss", "1", "1/eta - 1: power lost while drawing",
        _times(0.1, 0.35, _one),
    ),
    "regeneration_efficiency": EffectKind(
        "regeneration_loss", "1", "1 - eta_r: power lost while returning",
        _times(0.3, 1.0, _one),
    ),
    "copper_loss": EffectKind(
        "copper", "W/N^2", "heat in the windings",
        _times(0.1, 0.35, lambda r: FULL_EFFORT / _resistance(r)),
    ),
}  # fmt: skip

EFFECTS: Mapping[str, EffectKind] = MappingProxyType(_EFFECTS)
"""Effects that the engine can switch on, by name."""


@dataclass(frozen=True)
class HiddenEffect(ReadOnly):
    """An effect that the engine can switch on, and its size."""

    name: str  # one of `EFFECTS`
    size: float  # its size in the unit that `EFFECTS` names
    details: Mapping[str, float] = field(default_factory=dict)  # further numbers

    def __post_init__(self) -> None:
        if self.name not in _EFFECTS:
            raise UnknownNameError("effect of the engine", self.name, _EFFECTS)
        for key in self.details:
            if key not in _EFFECTS[self.name].details:
                known = _EFFECTS[self.name].details or ("none",)
                raise UnknownNameError(f"detail of {self.name}", key, known)
        values = {key: float(value) for key, value in self.details.items()}
        if not np.all(np.isfinite([self.size, *values.values()])):
            raise InvalidInputError(f"the effect {self.name} = {self.size} is not a finite number")
        object.__setattr__(self, "details", MappingProxyType(values))

    def on(self, robot: EngineRobot) -> EngineRobot:
        """Return a robot with this effect switched on."""
        apply = _EFFECTS[self.name].apply
        if isinstance(apply, str):
            changes: dict[str, Any] = {apply: getattr(robot, apply) + self.size}
            return replace(robot, **changes)
        return apply(robot, self.size, self.details)

    @classmethod
    def parse(cls, text: str) -> HiddenEffect:
        """Return the effect that ``NAME=SIZE`` or ``NAME=SIZE,DETAIL=VALUE`` stands for."""
        try:
            pairs = [part.split("=") for part in text.split(",")]
            values = {name.strip(): float(value) for name, value in pairs}
        except ValueError:
            raise InvalidInputError(
                f"effect {text!r} is not NAME=SIZE; write it like viscous_loss=60 or "
                "tilted_plane=0.05,direction=1.57"
            ) from None
        (name, size), *rest = values.items()
        return cls(name, size, dict(rest))


def switch_on(robot: EngineRobot, effects: Iterable[HiddenEffect]) -> EngineRobot:
    """Return a robot with effects switched on, one after the other."""
    for effect in effects:
        robot = effect.on(robot)
    return robot


def draw_effects(
    robot: EngineRobot,
    seed: int,
    count: int | None = None,
    names: tuple[str, ...] | None = None,
    around: ArrayLike = (0.0, 0.0),
) -> tuple[HiddenEffect, ...]:
    """Draw hidden effects."""
    rng = np.random.default_rng([seed, 0x5EED])
    number = int(rng.integers(1, 3)) if count is None else count
    chosen = rng.choice(np.array(names or tuple(_EFFECTS)), number, replace=False)
    drawn = []
    for name in (str(name) for name in chosen):
        kind = _EFFECTS[name]
        details = {}
        if "direction" in kind.details:
            details["direction"] = float(rng.uniform(-np.pi, np.pi))
        if "offset" in kind.details:
            angle = details["direction"]
            details["offset"] = float(np.dot(around, [np.cos(angle), np.sin(angle)]))
        if "time_constant" in kind.details:
            details["time_constant"] = float(rng.uniform(20.0, 60.0))
        drawn.append(HiddenEffect(name, kind.draw(robot, rng), details))
    return tuple(drawn)
