"""The catalogue of effects: what a robot may do that the paper's model leaves out.

An effect is one or more terms of the power model with what a person needs to know about them: unit,
plausible range, channels needed, the manoeuvre that separates it from its rivals, and whether a
planner can use it. A plugin adds its own through the entry-point group
``energyplan.power.effects``, whose objects are `Effect` or `Term` instances;
`effect` makes one out of one function.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from importlib.metadata import EntryPoint, entry_points
from typing import Any, Literal

import numpy as np

from energyplan.errors import ModelError, UnknownNameError
from energyplan.motion import Motion
from energyplan.power import DRIVE_LOSS, HOTEL, REGENERATION_LOSS, SLIP, TRACTION, PowerModel, Term
from energyplan.power.effect_terms import (
    AIR_DRAG,
    ANGULAR_INERTIA,
    COPPER_LOSS,
    DRAGGING_LEFT,
    GRADE,
    LINEAR_INERTIA,
    MOBILISATION,
    SIDE_GAIN,
    SLIP_BEYOND,
    SLIP_CHANGE,
    SLIP_SPEED,
    SPECIFIC_FORCE,
    STRIBECK,
    TILT_X,
    TILT_Y,
    TOWED_DRAG,
    TOWING_FORCE,
    TRACTION_BEYOND,
    TRACTION_CHANGE,
    TURN_ASYMMETRY,
    UNSIGNED_POWER,
    VISCOUS_LOSS,
    WARM_UP,
    WHEEL_FIGHT,
)
from energyplan.power.empirical import empirical_term
from energyplan.vehicle import Vehicle

__all__ = [
    "AIR_DRAG", "ANGULAR_INERTIA", "COPPER_LOSS", "GRADE", "LINEAR_INERTIA", "SPECIFIC_FORCE",
    "VISCOUS_LOSS", "WARM_UP", "Effect", "catalogue", "effect", "empirical_term", "most_of",
    "reads_slope", "term", "with_weight",
]  # fmt: skip

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
        Whether robots have it often enough that predictions of runs to come average over it.
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
    kind: Literal["force", "power", "loss"] = "force",
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
        made = Term(
            name, symbol, unit, kind, function,
            params={key: values[len(values) // 2] for key, values in grid.items()},
            channels=tuple(details.get("channels", ())),
            bounds=details.get("plausible", (-np.inf, np.inf)),
            meaning=details.get("meaning", ""),
        )  # fmt: skip
        return Effect.of(made, **details)

    return wrap


def _tilt(model: PowerModel) -> float:
    weight = np.hypot(model.coefficient("tilt_x"), model.coefficient("tilt_y"))
    return float(np.arcsin(min(weight / model.vehicle.mass, 1.0)))


def _payload(model: PowerModel) -> float:
    friction = model.coefficient("slip_friction") if model.has("slip_friction") else 0.0
    change = model.vehicle.mass * model.coefficient("slip_change")
    return change / friction if friction else float(np.copysign(np.inf, change))


def _slip_beyond(model: PowerModel) -> float:
    return model.coefficient("slip_beyond")


_BOTH_WAYS = "drive the same closed loop in both directions"
_TWO_SPEEDS = "drive a straight line at two or more constant speeds"
_STAND = "log a minute at standstill with the drives switched on, and one with them off"
_SPIN = "spin on the spot both ways at two constant yaw rates"
_RAMPS = "speed up and slow down hard on level ground"
_TURNS = "drive arcs of several radii, from a spin to nearly straight, at one constant speed"
_REPEAT = "repeat the same route at the end of the drive as at its start"

_ENTRIES = (
    Effect.of(HOTEL, plausible=(0.0, 2000.0), manoeuvre=_STAND, planner="with the duration",
              common=True),
    Effect.of(GRADE, plausible=(1.0, 1e5), manoeuvre=_BOTH_WAYS, planner="with the map's slope",
              of_mass=(0.5, 2.0)),
    Effect(
        "tilted_plane", (TILT_X, TILT_Y), "angle", "rad",
        "ground that is one tilted plane, seen from the heading", _BOTH_WAYS,
        "as the map's slope, with the term grade",
        (0.0, 0.6), ("yaw",), size=_tilt,
    ),
    Effect.of(
        SPECIFIC_FORCE, plausible=(1.0, 1e5), channels=("accel_x",), manoeuvre=_RAMPS,
        of_mass=(0.5, 2.0), usual=True,
        planner="with the map's slope",
    ),
    Effect.of(LINEAR_INERTIA, plausible=(1.0, 1e5), manoeuvre=_RAMPS, channels=(), usual=True,
              common=True, of_mass=(0.5, 2.0)),
    Effect.of(ANGULAR_INERTIA, plausible=(0.01, 1e5), manoeuvre=_SPIN, channels=(), usual=True),
    Effect.of(VISCOUS_LOSS, plausible=(0.0, 1e4), manoeuvre=_TWO_SPEEDS, common=True),
    Effect.of(AIR_DRAG, plausible=(0.0, 1e4), manoeuvre=_TWO_SPEEDS),
    Effect.of(
        COPPER_LOSS, plausible=(0.0, 1.0), manoeuvre=_SPIN + "; hold the robot on a slope",
    ),
    # What the drive loses forwards shows in the size of all forces alone: forces and mass are those
    # over its efficiency, and this is what is lost both ways.
    Effect.of(REGENERATION_LOSS, plausible=(0.0, 1.0), manoeuvre=_TURNS),
    Effect.of(WARM_UP, plausible=(0.0, 1e4), manoeuvre=_REPEAT, planner="with the time, else warm",
              grid={"time_constant": (10.0, 20.0, 40.0, 80.0, 160.0, 320.0)}),
    Effect(
        "payload_change", (SLIP_CHANGE, TRACTION_CHANGE), "dm", "kg",
        "payload taken up or set down at some time, or another surface from then on",
        "weigh the robot, or climb the same ramp, before and after",
        "as the state after it", (-1e5, 1e5), size=_payload, acts="change", of_mass=(-0.5, 1.0),
    ),
    Effect(
        "surface_border", (SLIP_BEYOND, TRACTION_BEYOND), "dmu", "1",
        "another surface beyond a line on the ground", "cross the line several times",
        "with surface regions on the map", (-2.0, 2.0), ("x", "y"), size=_slip_beyond,
        acts="place",
    ),
    Effect(
        "centre_of_mass", (), "d", "m", "centre of mass off centre: it moves the tread ICRs",
        "weigh the load under each wheel, or spin on the spot both ways", "with its tread ICRs",
        (0.0, 1.0), ("x", "y", "yaw"), acts="kinematics",
    ),
    Effect.of(DRAGGING_LEFT, plausible=(-1e4, 1e4), manoeuvre="lift that side, spin its wheels"),
    Effect.of(TURN_ASYMMETRY, plausible=(-1.0, 1.0), manoeuvre=_SPIN),
    Effect.of(SLIP_SPEED, plausible=(-2.0, 2.0), manoeuvre=_SPIN),
    Effect.of(STRIBECK, plausible=(0.0, 2.0), manoeuvre=_SPIN, common=True,
              grid={"slip_speed": (0.03, 0.08, 0.2)}),
    Effect.of(MOBILISATION, plausible=(-2.0, 2.0), manoeuvre=_TURNS, usual=True, common=True,
              grid={"radius": (0.1, 0.3, 1.0, 3.0, 10.0)}),
    Effect.of(WHEEL_FIGHT, plausible=(0.0, 1e4), acts="hold",
              manoeuvre="drive a straight line with the steering control off"),
    Effect.of(TOWED_DRAG, plausible=(0.0, 1e4), manoeuvre="drive with and without what is towed"),
    Effect.of(TOWING_FORCE, plausible=(-1e4, 1e4),
              manoeuvre="drive one line forwards and backwards"),
    Effect(
        "time_offset", (), "delay", "s", "power logged later than speed",
        "start and stop abruptly on level ground", "no", (-2.0, 2.0), acts="log",
        grid={"delay": tuple(k / 10 for k in range(-10, 11) if k)},
    ),
    Effect.of(UNSIGNED_POWER, plausible=(0.7, 1.5), manoeuvre=_TURNS, planner="no", acts="log"),
    Effect.of(SIDE_GAIN, plausible=(-0.5, 0.5), manoeuvre="swap the two sensors", planner="no",
              acts="log"),
)  # fmt: skip

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
        made = point.load()
        if isinstance(made, Term):
            made = Effect.of(made)
        if not isinstance(made, Effect):
            raise ModelError(f"entry point {point.name!r} of energyplan.power.effects is no Effect")
        names = {made.name, *(term.name for term in made.terms)}
        if names & (taken | set(found)):
            raise ModelError(f"entry point {point.name!r} redefines {sorted(names)}; rename it")
        found[made.name] = made
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


def reads_slope(model: PowerModel) -> bool:
    """Tell whether the power of steady motion depends on the slope of the ground.

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
