"""The terms of a power model: one pure function each, whose body is the equation."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from energyplan.motion import Motion
from energyplan.path import FloatArray
from energyplan.records import ByValue
from energyplan.vehicle import Vehicle

Kind = Literal["force", "power", "loss"]


@dataclass(frozen=True, eq=False)
class Sides(ByValue):
    """A quantity of the left and of the right side, arrays of one shape.

    Examples
    --------
    >>> float(Sides(np.array(100.0), np.array(60.0)).total)
    160.0
    """

    left: FloatArray
    right: FloatArray

    @property
    def total(self) -> FloatArray:
        """Sum of both sides."""
        return self.left + self.right

    def __add__(self, other: Sides) -> Sides:
        return Sides(self.left + other.left, self.right + other.right)

    def __mul__(self, factor: float) -> Sides:
        return Sides(self.left * factor, self.right * factor)


@dataclass(frozen=True, eq=False)
class Term(ByValue):
    """One term of a power model: everything but its coefficient.

    Parameters
    ----------
    name : str
        Identifier, such as ``"slip_friction"``.
    symbol : str
        Symbol of the coefficient.
    unit : str
        Unit of the coefficient; ``"1"`` where it has none.
    kind : {"force", "power", "loss"}
        What `function` returns.
    function : callable
        The regressor, linear in nothing but its coefficient. ``force``: ``f(motion, vehicle,
        **params) -> Sides`` of force [N] per unit of the coefficient. ``power``: ``f(motion,
        vehicle, **params) -> array`` of power [W] per unit. ``loss``: ``f(motion, vehicle,
        forces, **params) -> Sides`` of power [W] per unit, given the tread forces.
    params : mapping of str to float
        Fixed parameters of `function` in which the model is not linear, such as a time constant.
    channels : tuple of str
        Channels that `function` reads from the motion.
    bounds : tuple of float
        Physically possible range of the coefficient.
    meaning : str
        One line for reports.

    Examples
    --------
    >>> drag = Term("drag", "c", "kg/m", "power", lambda motion, params: abs(motion.v) ** 3)
    >>> drag.unit
    'kg/m'
    """

    name: str
    symbol: str
    unit: str
    kind: Kind
    function: Callable[..., Any]
    params: Mapping[str, float] = field(default_factory=dict)
    channels: tuple[str, ...] = ()
    bounds: tuple[float, float] = (-np.inf, np.inf)
    meaning: str = ""


def tread_forces(motion: Motion, longitudinal: ArrayLike = 0.0, moment: ArrayLike = 0.0) -> Sides:
    """Tread forces that supply a longitudinal force and a yaw moment on the body.

    By virtual work: the pair with ``F_l V_l + F_r V_r = longitudinal * v + moment * omega`` for
    every motion.

    Parameters
    ----------
    motion : Motion
        Motion; only its tread ICRs matter.
    longitudinal : array_like, shape (...)
        Force along +x at the body's origin [N].
    moment : array_like, shape (...)
        Moment about the vertical [N m].

    Returns
    -------
    Sides
        Force on the left and on the right tread [N].

    Examples
    --------
    >>> from energyplan.vehicle import TreadICR
    >>> spin = Motion.from_twist(0.0, 1.0, TreadICR.symmetric(0.5))
    >>> forces = tread_forces(spin, moment=10.0)
    >>> float(forces.left), float(forces.right)
    (-10.0, 10.0)
    """
    icr = motion.icr
    fx, mz = np.asarray(longitudinal, float), np.asarray(moment, float)
    left = np.asarray((icr.right * fx - mz) / icr.slip_track)
    right = np.asarray((icr.left * fx + mz) / icr.slip_track)
    if left.shape != motion.shape:  # views take longer to make than most forces to work out
        left, right = (np.broadcast_to(force, motion.shape) for force in (left, right))
    return Sides(left, right)


def slip_friction(motion: Motion, vehicle: Vehicle) -> Sides:
    """Tread forces per unit of mu that hold the slip moment (Eq. 2; docs/theory, section 2)."""
    return tread_forces(motion, moment=vehicle.slip_moment * np.sign(motion.omega))


def traction_resistance(motion: Motion, vehicle: Vehicle) -> Sides:
    """Tread forces per unit of K against rolling and internal friction (Eq. 3)."""
    return Sides(np.sign(motion.v_left), np.sign(motion.v_right))


def hotel_load(motion: Motion, vehicle: Vehicle) -> FloatArray:
    """Constant power of computers, sensors and brakes."""
    return np.ones(motion.shape)


def drive_loss(motion: Motion, vehicle: Vehicle, forces: Sides) -> Sides:
    """Power drawn by each side, of which a constant fraction is lost on the way to the tread."""
    return Sides(
        np.maximum(forces.left * motion.v_left, 0.0), np.maximum(forces.right * motion.v_right, 0.0)
    )


def regeneration_loss(motion: Motion, vehicle: Vehicle, forces: Sides) -> Sides:
    """Power returned by each side, of which a constant fraction never reaches the battery."""
    return Sides(
        np.maximum(-forces.left * motion.v_left, 0.0),
        np.maximum(-forces.right * motion.v_right, 0.0),
    )


SLIP = Term(
    "slip_friction", "mu", "1", "force", slip_friction, bounds=(0.0, 2.0),
    meaning="wheels sliding sideways while the robot turns",
)  # fmt: skip
TRACTION = Term(
    "traction_resistance", "K", "N", "force", traction_resistance, bounds=(0.0, np.inf),
    meaning="rolling resistance and friction of transmission and gears",
)  # fmt: skip
HOTEL = Term(
    "hotel_load", "P_h", "W", "power", hotel_load, bounds=(0.0, np.inf),
    meaning="constant draw of computers and sensors",
)  # fmt: skip
DRIVE_LOSS = Term(
    "drive_efficiency", "1/eta - 1", "1", "loss", drive_loss, bounds=(0.0, np.inf),
    meaning="power lost between battery and tread while drawing",
)  # fmt: skip
REGENERATION_LOSS = Term(
    "regeneration_efficiency", "1 - eta_r", "1", "loss", regeneration_loss, bounds=(0.0, 1.0),
    meaning="power lost between tread and battery while returning",
)  # fmt: skip
