"""The catalogue of effects: what a robot may do that the paper's model leaves out.

An effect is one or more terms of the power model with what a person needs to know about them: unit,
plausible range, channels needed, the manoeuvre that separates it from its rivals, and whether a
planner can use it. A plugin adds its own through the entry-point group
``energyplan.power.effects``, whose objects are `Effect` or `Term` instances;
`effect` makes one out of one function.

Terms that depend on time, place or heading read a channel only where the motion carries it. A
planner that does not know it gets what the docstring says: the robot is warm, the change has
happened, the headings average out.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from importlib.metadata import EntryPoint, entry_points
from typing import Any, Literal, TypeVar

import numpy as np

from energyplan.errors import ModelError, UnknownNameError
from energyplan.motion import Motion
from energyplan.path import FloatArray
from energyplan.power import (
    DRIVE_LOSS,
    HOTEL,
    REGENERATION_LOSS,
    SLIP,
    TRACTION,
    Kind,
    PowerModel,
    Sides,
    Term,
    tread_forces,
)
from energyplan.power.empirical import empirical_term
from energyplan.power.terms import regeneration_loss
from energyplan.vehicle import GRAVITY, Vehicle

__all__ = [
    "AIR_DRAG", "ANGULAR_INERTIA", "COPPER_LOSS", "GRADE", "LINEAR_INERTIA", "SPECIFIC_FORCE",
    "VISCOUS_LOSS", "WARM_UP", "Effect", "catalogue", "effect", "empirical_term", "most_of",
    "reads_slope", "term", "with_weight",
]  # fmt: skip

Regressor = TypeVar("Regressor", bound=Callable[..., Any])
Acts = Literal["motion", "change", "place", "kinematics", "hold", "log"]


@dataclass(frozen=True)
class Effect:
    """One entry of the catalogue.

    Parameters
    ----------
    name : str
        Identifier.
    terms : tuple of Term
        The terms that it adds to a model; none where it is seen in the motion only.
    symbol, unit : str
        Of its size.
    meaning : str
        One line for reports.
    manoeuvre : str
        What to drive so that it separates from its rivals.
    planner : str
        Whether a planner can use it: ``"yes"``, ``"no"``, or what it needs.
    plausible : tuple of float
        Range in which its size is believed.
    channels : tuple of str
        Channels that a log needs.
    grid : mapping of str to tuple of float
        Values to try of the parameters in which the terms are not linear.
    size : callable, optional
        ``size(model) -> float`` where it is not the coefficient of the only term.
    acts : {"motion", "change", "place", "kinematics", "hold", "log"}
        On the power of every motion, only after a change at an unknown time, only beyond a line on
        the ground, on how the robot moves, while contacts hold, or on the log alone.
    usual : bool
        Whether nearly every robot has it, so that it needs no more evidence than any coefficient.
    common : bool
        Whether robots have it often enough that predictions of future runs average over it.
    of_mass : tuple of float, optional
        Range in which a size in kilograms is believed, in masses of the vehicle.

    Raises
    ------
    ModelError
        If a size does not follow from the terms, or the range is empty.

    Examples
    --------
    >>> entry = catalogue()["hotel_load"]
    >>> entry.unit, [term.name for term in entry.terms]
    ('W', ['hotel_load'])
    """

    name: str
    terms: tuple[Term, ...]
    symbol: str
    unit: str
    meaning: str
    manoeuvre: str = ""
    planner: str = "yes"
    plausible: tuple[float, float] = (-np.inf, np.inf)
    channels: tuple[str, ...] = ()
    grid: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    size: Callable[[PowerModel], float] | None = None
    acts: Acts = "motion"
    usual: bool = False
    common: bool = False
    of_mass: tuple[float, float] | None = None

    def limits(self, vehicle: Vehicle) -> tuple[float, float]:
        """Return the range in which the effect's size is believed on a vehicle."""
        if self.of_mass is None:
            return self.plausible
        low, high = (vehicle.mass * share for share in self.of_mass)
        return max(low, self.plausible[0]), min(high, self.plausible[1])

    @property
    def delays(self) -> bool:
        """Whether it is a delay of the log, which no term has."""
        return self.acts == "log" and not self.terms

    @property
    def on_demand(self) -> bool:
        """Whether it acts from some place or time on: much looks like it, and it is slow to try."""
        return self.acts in ("change", "place")

    def __post_init__(self) -> None:
        if len(self.terms) > 1 and self.size is None:
            raise ModelError(f"effect {self.name!r} has {len(self.terms)} terms; give its size")
        if not self.plausible[0] < self.plausible[1]:
            raise ModelError(f"effect {self.name!r} has the empty range {self.plausible}")

    @classmethod
    def of(cls, term: Term, **details: Any) -> Effect:
        """Return the effect whose size is the coefficient of one term.

        Parameters
        ----------
        term : Term
            The term.
        **details
            Further fields of `Effect`.

        Returns
        -------
        Effect
            The effect, of the term's name, symbol, unit, range and channels.
        """
        known = {
            "name": term.name, "symbol": term.symbol, "unit": term.unit,
            "meaning": term.meaning, "plausible": term.bounds, "channels": term.channels,
        }  # fmt: skip
        return cls(terms=(term,), **{**known, **details})

    def value(self, model: PowerModel) -> float:
        """Return the effect's size in a model that holds its terms."""
        if self.size is not None:
            return float(self.size(model))
        return model.coefficient(self.terms[0].name)


def effect(
    name: str,
    symbol: str,
    unit: str,
    kind: Kind = "force",
    **details: Any,
) -> Callable[[Callable[..., Any]], Effect]:
    """Make an effect out of one function: the whole work of a plugin.

    Parameters
    ----------
    name, symbol, unit : str
        Of the coefficient.
    kind : {"force", "power", "loss"}
        What the function returns; see `energyplan.power.Term`.
    **details
        Further fields of `Effect`, such as ``meaning``, ``plausible``, ``channels``, ``grid``,
        ``manoeuvre`` and ``planner``.

    Returns
    -------
    callable
        A decorator that turns the regressor into an `Effect`.

    Examples
    --------
    >>> @effect("rail_friction", "F_r", "N", meaning="a guide rail that rubs", plausible=(0, 100))
    ... def rail_friction(motion, vehicle):
    ...     return tread_forces(motion, longitudinal=np.sign(motion.v))
    >>> rail_friction.unit
    'N'
    """

    def wrap(function: Callable[..., Any]) -> Effect:
        grid = details.get("grid", {})
        built = Term(
            name, symbol, unit, kind, function,
            params={key: values[len(values) // 2] for key, values in grid.items()},
            channels=tuple(details.get("channels", ())),
            bounds=details.get("plausible", (-np.inf, np.inf)),
            meaning=details.get("meaning", ""),
        )  # fmt: skip
        return Effect.of(built, **details)

    return wrap


# -- the catalogue, in the order in which ties are decided --------------------------------------

_BOTH_WAYS = "drive the same closed loop in both directions"
_TWO_SPEEDS = "drive a straight line at two or more constant speeds"
_SPIN = "spin on the spot both ways at two constant yaw rates"
_RAMPS = "speed up and slow down hard on level ground"
_TURNS = "drive arcs of several radii, from a spin to nearly straight, at one constant speed"

_ANY = (-np.inf, np.inf)
_POSITIVE = (0.0, np.inf)

_TERMS: dict[str, Term] = {}
_ENTRIES: list[Effect] = []


def _entry(
    symbol: str, unit: str, kind: Kind = "force", *, params: Mapping[str, float] | None = None,
    needs: tuple[str, ...] = (), bounds: tuple[float, float] = _POSITIVE, meaning: str = "",
    **details: Any,
) -> Callable[[Regressor], Regressor]:  # fmt: skip
    """Enter a function as a term, and with details as the effect whose size is its coefficient."""

    def enter(function: Regressor) -> Regressor:
        name = function.__name__
        of = Term(name, symbol, unit, kind, function, params or {}, needs, bounds, meaning)
        _TERMS[name] = of
        if details:
            _ENTRIES.append(Effect.of(of, **details))
        return function

    return enter


_ENTRIES.append(Effect.of(
    HOTEL, plausible=(0.0, 2000.0), planner="with the duration", common=True,
    manoeuvre="log a minute at standstill with the drives switched on, and one with them off",
))  # fmt: skip


@_entry(
    "m", "kg", needs=("slope",), meaning="weight on a slope", plausible=(1.0, 1e5),
    manoeuvre=_BOTH_WAYS, planner="with the map's slope", of_mass=(0.5, 2.0),
)  # fmt: skip
def grade(motion: Motion, vehicle: Vehicle) -> Sides:
    """Weight along the heading per unit of mass: ``g sin(slope)`` (docs/theory, section 7)."""
    slope = motion.channel("slope", "the term 'grade'")
    return tread_forces(motion, longitudinal=GRAVITY * np.sin(slope))


def _heading(motion: Motion, offset: float) -> FloatArray:
    """Cosine of the heading; zero where yaw is unknown, or where the map knows the slope."""
    if "slope" in motion.channels or "yaw" not in motion.channels:
        return np.zeros(motion.shape)
    return np.cos(motion.channels["yaw"] - offset)


@_entry("m sin(a_x)", "kg", bounds=_ANY, meaning="ground climbing to yaw 0")
def tilt_x(motion: Motion, vehicle: Vehicle) -> Sides:
    """Weight along the heading on a plane that climbs towards yaw 0, where no slope is known."""
    return tread_forces(motion, longitudinal=GRAVITY * _heading(motion, 0.0))


@_entry("m sin(a_y)", "kg", bounds=_ANY, meaning="ground climbing to yaw 90")
def tilt_y(motion: Motion, vehicle: Vehicle) -> Sides:
    """Weight along the heading on a plane that climbs towards yaw 90 degrees."""
    return tread_forces(motion, longitudinal=GRAVITY * _heading(motion, np.pi / 2))


def _tilt(model: PowerModel) -> float:
    weight = np.hypot(model.coefficient("tilt_x"), model.coefficient("tilt_y"))
    return float(np.arcsin(min(weight / model.vehicle.mass, 1.0)))


_ENTRIES.append(Effect(
    "tilted_plane", (_TERMS["tilt_x"], _TERMS["tilt_y"]), "angle", "rad",
    "ground that is one tilted plane, seen from the heading", _BOTH_WAYS,
    "as the map's slope, with the term grade", (0.0, 0.6), ("yaw",), size=_tilt,
))  # fmt: skip


@_entry(
    "m", "kg", plausible=(1.0, 1e5), channels=("accel_x",), manoeuvre=_RAMPS,
    meaning="weight and inertia together, as an accelerometer feels them",
    planner="with the map's slope", of_mass=(0.5, 2.0), usual=True,
)  # fmt: skip
def specific_force(motion: Motion, vehicle: Vehicle) -> Sides:
    """Force per unit of mass that an accelerometer feels: ``dv/dt + g sin(slope)``.

    Where the slope is known, as on a map, slope and acceleration stand in for the accelerometer.
    """
    slope = motion.channels.get("slope")
    if slope is None:
        return tread_forces(motion, longitudinal=motion.channel("accel_x", "'specific_force'"))
    accel = motion.channels.get("accel", np.zeros(motion.shape))
    return tread_forces(motion, longitudinal=accel + GRAVITY * np.sin(slope))


@_entry(
    "m", "kg", needs=("accel",), meaning="speeding up and slowing down",
    plausible=(1.0, 1e5), manoeuvre=_RAMPS, channels=(), usual=True, common=True,
    of_mass=(0.5, 2.0),
)  # fmt: skip
def linear_inertia(motion: Motion, vehicle: Vehicle) -> Sides:
    """Force per unit of mass that changes the forward speed: ``dv/dt``."""
    return tread_forces(motion, longitudinal=motion.channel("accel", "the term 'linear_inertia'"))


@_entry(
    "I_z", "kg m^2", needs=("yaw_accel",), meaning="turning faster and slower",
    plausible=(0.01, 1e5), manoeuvre=_SPIN, channels=(), usual=True,
)  # fmt: skip
def angular_inertia(motion: Motion, vehicle: Vehicle) -> Sides:
    """Moment per unit of inertia that changes the yaw rate: ``dw/dt``."""
    return tread_forces(motion, moment=motion.channel("yaw_accel", "the term 'angular_inertia'"))


@_entry(
    "B_v", "N s/m", meaning="resistance that rises with speed",
    plausible=(0.0, 1e4), manoeuvre=_TWO_SPEEDS, common=True,
)  # fmt: skip
def viscous_loss(motion: Motion, vehicle: Vehicle) -> Sides:
    """Force proportional to tread speed: grease, belts, soft ground."""
    return Sides(motion.v_left, motion.v_right)


@_entry(
    "k_d", "N s^2/m^2", meaning="resistance that rises with the square of the speed",
    plausible=(0.0, 1e4), manoeuvre=_TWO_SPEEDS,
)  # fmt: skip
def air_drag(motion: Motion, vehicle: Vehicle) -> Sides:
    """Force proportional to the square of the body's speed."""
    return tread_forces(motion, longitudinal=motion.v * np.abs(motion.v))


@_entry(
    "R/k^2", "W/N^2", "loss", meaning="heat in the motor windings",
    plausible=(0.0, 1.0), manoeuvre=_SPIN + "; hold the robot on a slope",
)  # fmt: skip
def copper_loss(motion: Motion, vehicle: Vehicle, forces: Sides) -> Sides:
    """Power lost in the windings: current follows force, so its square does."""
    return Sides(np.square(forces.left), np.square(forces.right))


# What the drive loses forwards shows in the size of all forces alone: forces and mass are those
# over its efficiency, and this is what is lost both ways.
_ENTRIES.append(Effect.of(REGENERATION_LOSS, plausible=(0.0, 1.0), manoeuvre=_TURNS))


@_entry(
    "K_0", "N", params={"time_constant": 60.0}, plausible=(0.0, 1e4),
    meaning="resistance of a cold drive that fades", planner="with the time, else warm",
    manoeuvre="repeat the same route at the end of the drive as at its start",
    grid={"time_constant": (10.0, 20.0, 40.0, 80.0, 160.0, 320.0)},
)  # fmt: skip
def warm_up(motion: Motion, vehicle: Vehicle, time_constant: float) -> Sides:
    """Traction resistance of a cold drive: ``exp(-t / time_constant)``; warm where t is unknown."""
    t = motion.channels.get("t")
    cold = np.zeros(motion.shape) if t is None else np.exp(-t / time_constant)
    return Sides(cold * np.sign(motion.v_left), cold * np.sign(motion.v_right))


def _after(motion: Motion, time: float) -> FloatArray:
    """1 after the change and 0 before: the channel ``changed`` where there is one, else by time."""
    if "changed" in motion.channels:
        return motion.channels["changed"]
    t = motion.channels.get("t")
    return np.ones(motion.shape) if t is None else np.asarray(t >= time, float)


@_entry("dmu", "1", bounds=_ANY, params={"time": 0.0}, meaning="slip friction after the change")
def slip_change(motion: Motion, vehicle: Vehicle, time: float) -> Sides:
    """Slip friction that is there only after a change; changed where time is unknown."""
    after = _after(motion, time)
    return tread_forces(motion, moment=vehicle.slip_moment * np.sign(motion.omega) * after)


@_entry(
    "dK", "N", bounds=_ANY, params={"time": 0.0}, meaning="traction resistance after the change",
)  # fmt: skip
def traction_change(motion: Motion, vehicle: Vehicle, time: float) -> Sides:
    """Traction resistance that is there only after a change; changed where time is unknown."""
    after = _after(motion, time)
    return Sides(after * np.sign(motion.v_left), after * np.sign(motion.v_right))


def _payload(model: PowerModel) -> float:
    friction = model.coefficient("slip_friction") if model.has("slip_friction") else 0.0
    change = model.vehicle.mass * model.coefficient("slip_change")
    return change / friction if friction else float(np.copysign(np.inf, change))


_ENTRIES.append(Effect(
    "payload_change", (_TERMS["slip_change"], _TERMS["traction_change"]), "dm", "kg",
    "payload taken up or set down at some time, or another surface from then on",
    "weigh the robot, or climb the same ramp, before and after", "as the state after it",
    (-1e5, 1e5), size=_payload, acts="change", of_mass=(-0.5, 1.0),
))  # fmt: skip


_LINE = {"direction": 0.0, "offset": 0.0}


def _beyond(motion: Motion, vehicle: Vehicle, direction: float, offset: float) -> FloatArray:
    """Share of the weight beyond a line: wheels cross it one after the other."""
    x, y = motion.channel("x", "a change of place"), motion.channel("y", "a change of place")
    along = x * np.cos(direction) + y * np.sin(direction) - offset
    if "yaw" not in motion.channels:
        return np.asarray(along > 0.0, float)
    rotated = motion.channels["yaw"] - direction
    ahead, aside = np.cos(rotated), np.sin(rotated)
    share = np.zeros(motion.shape)
    for (forward, left), load in zip(vehicle.contacts, vehicle.loads, strict=True):
        share += load * (along + forward * ahead - left * aside > 0.0)
    return np.asarray(share / float(vehicle.loads.sum()))


@_entry(
    "dmu", "1", bounds=_ANY, params=_LINE, needs=("x", "y"), meaning="slip friction beyond a line",
)  # fmt: skip
def slip_beyond(motion: Motion, vehicle: Vehicle, direction: float, offset: float) -> Sides:
    """Slip friction that is there only beyond a line on the ground."""
    there = _beyond(motion, vehicle, direction, offset)
    return tread_forces(motion, moment=vehicle.slip_moment * np.sign(motion.omega) * there)


@_entry(
    "dK", "N", bounds=_ANY, params=_LINE, needs=("x", "y"),
    meaning="traction resistance beyond a line",
)  # fmt: skip
def traction_beyond(motion: Motion, vehicle: Vehicle, direction: float, offset: float) -> Sides:
    """Traction resistance that is there only beyond a line on the ground."""
    there = _beyond(motion, vehicle, direction, offset)
    return Sides(there * np.sign(motion.v_left), there * np.sign(motion.v_right))


def _slip_beyond(model: PowerModel) -> float:
    return model.coefficient("slip_beyond")


_ENTRIES += (
    Effect(
        "surface_border", (_TERMS["slip_beyond"], _TERMS["traction_beyond"]), "dmu", "1",
        "another surface beyond a line on the ground", "cross the line several times",
        "with surface regions on the map", (-2.0, 2.0), ("x", "y"), size=_slip_beyond,
        acts="place",
    ),
    Effect(
        "centre_of_mass", (), "d", "m", "centre of mass off centre: it moves the tread ICRs",
        "weigh the load under each wheel, or spin on the spot both ways", "with its tread ICRs",
        (0.0, 1.0), ("x", "y", "yaw"), acts="kinematics",
    ),
)  # fmt: skip


@_entry(
    "K_d", "N", bounds=_ANY, plausible=(-1e4, 1e4),
    meaning="a wheel or bearing that drags on the left; on the right where it is negative",
    manoeuvre="lift that side, spin its wheels",
)  # fmt: skip
def dragging_wheel_left(motion: Motion, vehicle: Vehicle) -> Sides:
    """Traction resistance that the left side has more than the right one."""
    return Sides(np.sign(motion.v_left), np.zeros(motion.shape))


@_entry(
    "dmu", "1", bounds=(-2.0, 2.0), plausible=(-1.0, 1.0), manoeuvre=_SPIN,
    meaning="turning left costs more than turning right",
)  # fmt: skip
def turn_asymmetry(motion: Motion, vehicle: Vehicle) -> Sides:
    """Slip friction that a left turn has more and a right turn less: a constant moment."""
    return tread_forces(motion, moment=vehicle.slip_moment * np.sign(motion.omega) ** 2)


@_entry(
    "k_mu", "s/m", bounds=_ANY, plausible=(-2.0, 2.0), manoeuvre=_SPIN,
    meaning="slip friction that depends on slip speed",
)  # fmt: skip
def slip_speed_friction(motion: Motion, vehicle: Vehicle) -> Sides:
    """Slip friction that grows with the slip speed, taken as yaw rate times mean slip radius."""
    radius = vehicle.slip_moment / float(vehicle.loads.sum())
    return tread_forces(motion, moment=vehicle.slip_moment * radius * motion.omega)


@_entry(
    "mu_s", "1", params={"slip_speed": 0.1}, bounds=(-2.0, 2.0),
    plausible=(0.0, 2.0), manoeuvre=_SPIN, common=True, grid={"slip_speed": (0.03, 0.08, 0.2)},
    meaning="slip friction that is larger at small slip speeds",
)  # fmt: skip
def stribeck_friction(motion: Motion, vehicle: Vehicle, slip_speed: float) -> Sides:
    """Slip friction that is there at small slip speeds only and fades as they grow.

    ``exp(-r |w| / slip_speed)`` with the mean slip radius ``r`` of the wheels (Stribeck).
    """
    radius = vehicle.slip_moment / float(vehicle.loads.sum())
    fade = np.exp(-radius * np.abs(motion.omega) / slip_speed)
    return tread_forces(motion, moment=vehicle.slip_moment * np.sign(motion.omega) * fade)


@_entry(
    "mu_m", "1", params={"radius": 1.0}, bounds=(-2.0, 2.0),
    plausible=(-2.0, 2.0), manoeuvre=_TURNS, usual=True, common=True,
    grid={"radius": (0.1, 0.3, 1.0, 3.0, 10.0)},
    meaning="slip friction that is smaller in wide turns than in a spin",
)  # fmt: skip
def friction_mobilisation(motion: Motion, vehicle: Vehicle, radius: float) -> Sides:
    """Slip friction that is missing in wide turns: ``-mu S sign(w) |v| / (|v| + radius |w|)``."""
    speed, rate = np.abs(motion.v), radius * np.abs(motion.omega)
    whole = speed + rate
    missing = np.divide(speed, whole, out=np.zeros(motion.shape), where=whole > 0)
    return tread_forces(motion, moment=-vehicle.slip_moment * np.sign(motion.omega) * missing)


@_entry(
    "P_f", "W", "loss", plausible=(0.0, 1e4), acts="hold",
    meaning="heat of sides that push against each other on straights, in drives that lose energy",
    manoeuvre="drive a straight line with the steering control off",
)  # fmt: skip
def wheel_fight(motion: Motion, vehicle: Vehicle, forces: Sides) -> Sides:
    """Heat of sides that push against each other on a straight, where contacts hold a moment."""
    turning = np.abs(motion.omega) * motion.icr.half_track > 1e-6 * np.abs(motion.v)
    straight = ~turning & (motion.v != 0.0)
    return Sides(0.5 * straight, 0.5 * straight)


@_entry(
    "F_d", "N", plausible=(0.0, 1e4), manoeuvre="drive with and without what is towed",
    meaning="something towed that resists whichever way the body moves",
)  # fmt: skip
def towed_drag(motion: Motion, vehicle: Vehicle) -> Sides:
    """Force of something towed, a trailer or a sledge: against the body's own motion."""
    return tread_forces(motion, longitudinal=np.sign(motion.v))


@_entry(
    "F_t", "N", bounds=_ANY, plausible=(-1e4, 1e4),
    manoeuvre="drive one line forwards and backwards",
    meaning="a force that pulls one way, forwards or backwards",
)  # fmt: skip
def towing_force(motion: Motion, vehicle: Vehicle) -> Sides:
    """Constant force along the body, whichever way it drives: a hose, a cable, a head wind."""
    return tread_forces(motion, longitudinal=np.ones(motion.shape))


_ENTRIES.append(Effect(
    "time_offset", (), "delay", "s", "power logged later than speed",
    "start and stop abruptly on level ground", "no", (-2.0, 2.0), acts="log",
    grid={"delay": tuple(k / 10 for k in range(-10, 11) if k)},
))  # fmt: skip


@_entry(
    "s", "1", "loss", bounds=(0.0, 2.0), plausible=(0.7, 1.5), planner="no",
    manoeuvre=_TURNS, acts="log", meaning="a current sensor without the sign of the current",
)  # fmt: skip
def unsigned_power(motion: Motion, vehicle: Vehicle, forces: Sides) -> Sides:
    """Twice the returned power, which a sensor without a sign adds to the sum."""
    return regeneration_loss(motion, vehicle, forces) * 2.0


@_entry(
    "g", "1", "loss", bounds=(-1.0, 1.0), plausible=(-0.5, 0.5), planner="no",
    acts="log", manoeuvre="swap the two sensors",
    meaning="gains of the left and the right power sensor differ",
)  # fmt: skip
def side_gain(motion: Motion, vehicle: Vehicle, forces: Sides) -> Sides:
    """Power that the left side's sensor shows too high and the right side's too low."""
    return Sides(forces.left * motion.v_left, -forces.right * motion.v_right)


(
    AIR_DRAG, ANGULAR_INERTIA, COPPER_LOSS, DRAGGING_LEFT, GRADE, LINEAR_INERTIA, MOBILISATION,
    SIDE_GAIN, SLIP_BEYOND, SLIP_CHANGE, SLIP_SPEED, SPECIFIC_FORCE, STRIBECK, TILT_X, TILT_Y,
    TOWED_DRAG, TOWING_FORCE, TRACTION_BEYOND, TRACTION_CHANGE, TURN_ASYMMETRY, UNSIGNED_POWER,
    VISCOUS_LOSS, WARM_UP, WHEEL_FIGHT,
) = (_TERMS[name] for name in (
    "air_drag", "angular_inertia", "copper_loss", "dragging_wheel_left", "grade",
    "linear_inertia", "friction_mobilisation", "side_gain", "slip_beyond", "slip_change",
    "slip_speed_friction", "specific_force", "stribeck_friction", "tilt_x", "tilt_y",
    "towed_drag", "towing_force", "traction_beyond", "traction_change", "turn_asymmetry",
    "unsigned_power", "viscous_loss", "warm_up", "wheel_fight",
))  # fmt: skip

_ALWAYS = (SLIP, TRACTION, DRIVE_LOSS)
"""Terms of files that are no effects: the paper's, and what a drive's known efficiency takes."""


def catalogue() -> dict[str, Effect]:
    """Return every known effect by name: the built-in ones and those of plugins.

    Returns
    -------
    dict of str to Effect
        The effects, in the order in which ties between them are decided.

    Raises
    ------
    ModelError
        If a plugin's entry is no effect or takes a name that is already there.

    Examples
    --------
    >>> {"grade", "viscous_loss", "hotel_load"} <= set(catalogue())
    True
    """
    return dict(_every(entry_points, tuple(sys.path)))


@lru_cache(maxsize=8)
def _every(finder: Callable[..., Iterable[EntryPoint]], path: tuple[str, ...]) -> dict[str, Effect]:
    """Look plugins up once for each search path: metadata of every package are read for it."""
    found = {entry.name: entry for entry in _ENTRIES}
    taken = {term.name for entry in _ENTRIES for term in entry.terms} | {t.name for t in _ALWAYS}
    for point in finder(group="energyplan.power.effects"):
        built = point.load()
        if isinstance(built, Term):
            built = Effect.of(built)
        if not isinstance(built, Effect):
            raise ModelError(f"entry point {point.name!r} of energyplan.power.effects is no Effect")
        names = {built.name, *(term.name for term in built.terms)}
        if names & (taken | set(found)):
            raise ModelError(f"entry point {point.name!r} redefines {sorted(names)}; rename it")
        found[built.name] = built
    return found


def term(name: str) -> Term:
    """Return the term of that name, be it the paper's, the catalogue's or a plugin's.

    Parameters
    ----------
    name : str
        Name of a term, as a model file holds it.

    Returns
    -------
    Term
        The term with its default parameters.

    Raises
    ------
    UnknownNameError
        If neither the library nor a plugin has it.

    Examples
    --------
    >>> term("viscous_loss").unit
    'N s/m'
    """
    known = {term.name: term for term in _ALWAYS}
    known |= {term.name: term for entry in catalogue().values() for term in entry.terms}
    if name in known:
        return known[name]
    if name.startswith("empirical_"):
        return empirical_term(name)
    raise UnknownNameError("power term", name, known)


def most_of(term: Term, vehicle: Vehicle) -> float:
    """Return the largest coefficient of a term that is believed on a vehicle.

    Examples
    --------
    >>> most_of(LINEAR_INERTIA, Vehicle.preset("quadriga:empty"))
    166.2
    """
    known = (entry for entry in catalogue().values() if entry.size is None)
    limits = [one.limits(vehicle) for one in known if [t.name for t in one.terms] == [term.name]]
    return min([term.bounds[1], *(high for _, high in limits)])


GROUND_TERMS = frozenset(one.name for one in (TILT_X, TILT_Y, SLIP_BEYOND, TRACTION_BEYOND))
"""Terms of a place: the ground that a drive was on, which no other place has."""


def knows_ground(model: PowerModel) -> bool:
    """Return whether a model has terms of a place: a tilted plane, or another surface."""
    return any(term.name in GROUND_TERMS for term in model.terms)


def without_ground(model: PowerModel) -> PowerModel:
    """Return a model without its terms of a place."""
    if not knows_ground(model):
        return model
    keep = np.array([term.name not in GROUND_TERMS for term in model.terms])
    covariance = model.covariance
    return replace(
        model,
        terms=tuple(term for term, stays in zip(model.terms, keep, strict=True) if stays),
        coefficients=model.coefficients[keep],
        covariance=None if covariance is None else covariance[np.ix_(keep, keep)],
    )


def reads_slope(model: PowerModel) -> bool:
    """Return whether the power of steady motion depends on the slope of the ground.

    Examples
    --------
    >>> model = PowerModel.preset("quadriga:empty:concrete")
    >>> reads_slope(model), reads_slope(with_weight(model))
    (False, True)
    """
    steady = dict.fromkeys((name for term in model.terms for name in term.channels), 0.0)
    ahead = np.array([0.5, -0.5])
    level, tilted = (
        model.power(Motion.from_twist(ahead, 0.0, model.vehicle.icr, **{**steady, "slope": slope}))
        for slope in (0.0, 0.1)
    )
    return not np.allclose(level, tilted, rtol=1e-12, atol=0.0)


def reads_heading(model: PowerModel, channels: Mapping[str, float]) -> bool:
    """Return whether the power of steady motion on known ground depends on the heading.

    `channels` are further ones that the terms read.
    """
    steady = dict.fromkeys((name for term in model.terms for name in term.channels), 0.0)
    steady |= {"slope": 0.0, **channels}
    yaw = np.linspace(-3.0, 3.1, 26)[:, None]
    v, omega = np.array([(0.5, 0.0), (-0.5, 0.0), (0.0, 0.5), (0.0, -0.5), (0.3, 0.6)]).T
    ahead, rotated = (
        model.power(
            Motion.from_twist(v, omega, model.vehicle.icr, **{**steady, "yaw": 0.0}).with_channels(
                yaw=at
            )
        )
        for at in (0.0, yaw)
    )
    return not np.array_equal(ahead + 0.0 * yaw, rotated)


def with_weight(model: PowerModel) -> PowerModel:
    """Return the model with the vehicle's weight as its grade term, for use on slopes.

    A model identified on level ground says nothing about slopes, but the wheel loads give the mass.

    Parameters
    ----------
    model : PowerModel
        The model.

    Returns
    -------
    PowerModel
        The model itself where a term of it reads the slope already.

    Examples
    --------
    >>> model = with_weight(PowerModel.preset("quadriga:empty:concrete"))
    >>> round(model.coefficient("grade"), 1)
    83.1
    """
    return model if reads_slope(model) else model.with_term(GRADE, model.vehicle.mass)
