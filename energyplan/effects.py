"""The catalogue of further power terms: what a robot may do that the paper's model leaves out.

Each entry is one pure function and one `Term`. A plugin adds its own through the entry-point group
``energyplan.effects``, whose objects are `Term` instances.
"""

from __future__ import annotations

from importlib.metadata import entry_points

import numpy as np

from energyplan.errors import ModelError, UnknownNameError
from energyplan.motion import Motion
from energyplan.power import (
    DRIVE_LOSS,
    HOTEL,
    REGENERATION_LOSS,
    SLIP,
    TRACTION,
    Sides,
    Term,
    tread_forces,
)
from energyplan.vehicle import GRAVITY, Vehicle


def grade(motion: Motion, vehicle: Vehicle) -> Sides:
    """Weight along the heading per unit of mass: ``g sin(slope)`` (docs/theory, section 7)."""
    slope = motion.channel("slope", "the term 'grade'")
    return tread_forces(motion, longitudinal=GRAVITY * np.sin(slope))


def linear_inertia(motion: Motion, vehicle: Vehicle) -> Sides:
    """Force per unit of mass that changes the forward speed: ``dv/dt``."""
    return tread_forces(motion, longitudinal=motion.channel("accel", "the term 'linear_inertia'"))


def angular_inertia(motion: Motion, vehicle: Vehicle) -> Sides:
    """Moment per unit of inertia that changes the yaw rate: ``dw/dt``."""
    return tread_forces(motion, moment=motion.channel("yaw_accel", "the term 'angular_inertia'"))


def viscous_loss(motion: Motion, vehicle: Vehicle) -> Sides:
    """Force proportional to tread speed: grease, belts, soft ground."""
    return Sides(motion.v_left, motion.v_right)


GRADE = Term(
    "grade", "m", "kg", "force", grade, channels=("slope",), bounds=(0.0, np.inf),
    meaning="weight on a slope",
)  # fmt: skip
LINEAR_INERTIA = Term(
    "linear_inertia", "m", "kg", "force", linear_inertia, channels=("accel",), bounds=(0.0, np.inf),
    meaning="speeding up and slowing down",
)  # fmt: skip
ANGULAR_INERTIA = Term(
    "angular_inertia", "I_z", "kg m^2", "force", angular_inertia, channels=("yaw_accel",),
    bounds=(0.0, np.inf), meaning="turning faster and slower",
)  # fmt: skip
VISCOUS_LOSS = Term(
    "viscous_loss", "B_v", "N s/m", "force", viscous_loss, bounds=(0.0, np.inf),
    meaning="resistance that rises with speed",
)  # fmt: skip

_BUILT_IN = (
    SLIP,
    TRACTION,
    HOTEL,
    DRIVE_LOSS,
    REGENERATION_LOSS,
    GRADE,
    LINEAR_INERTIA,
    ANGULAR_INERTIA,
    VISCOUS_LOSS,
)


def catalogue() -> dict[str, Term]:
    """Return every known term by name: the built-in ones and those of plugins.

    Returns
    -------
    dict of str to Term
        The terms.

    Raises
    ------
    ModelError
        If a plugin's entry is not a `Term` or takes a name that is already there.
    """
    found = {term.name: term for term in _BUILT_IN}
    for entry in entry_points(group="energyplan.effects"):
        term = entry.load()
        if not isinstance(term, Term):
            raise ModelError(f"entry point {entry.name!r} of energyplan.effects is no Term")
        if term.name in found:
            raise ModelError(f"entry point {entry.name!r} redefines the term {term.name!r}")
        found[term.name] = term
    return found


def term(name: str) -> Term:
    """Return the term of that name.

    Raises
    ------
    UnknownNameError
        If neither the library nor a plugin has it.
    """
    known = catalogue()
    if name not in known:
        raise UnknownNameError("power term", name, known)
    return known[name]
