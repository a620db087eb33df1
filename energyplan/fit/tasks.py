"""A power model from a history of tasks: how far, how much turning, how long, and what energy."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from energyplan.errors import InvalidInputError, NotIdentifiableError
from energyplan.path import FloatArray
from energyplan.power import SLIP, TRACTION, PowerModel, Term
from energyplan.power.effects import term
from energyplan.vehicle import Vehicle

_FEWEST = 5  # tasks beyond the number of coefficients
_HUBER = 1.345  # standard deviations beyond which a task counts less
_HARDLY = 0.3  # relative standard error from which a coefficient is hardly known
_SEEN = 2.0  # standard errors from which the tasks show a hotel load


@dataclass(frozen=True)
class TaskFit:
    """What a history of tasks shows about a robot."""

    model: PowerModel  # with the covariance of its coefficients
    errors: FloatArray  # standard errors of its coefficients
    energies: FloatArray  # of each task by the model [J]
    spread: float  # root mean square of the relative errors of the tasks' energies
    warnings: tuple[str, ...]  # what the tasks do not determine, or hardly


def identify_tasks(tasks: Mapping[str, FloatArray], vehicle: Vehicle) -> TaskFit:
    """Find traction resistance, friction coefficient and hotel load from sums over tasks.

    `tasks` holds ``distance`` [m], ``energy`` [J] and, where known, ``turning`` [rad] and
    ``duration`` [s], an entry a task. Turning counts as turning on the spot.
    """
    whole = np.all([np.isfinite(values) for values in tasks.values()], axis=0)
    known = {name: values[whole] for name, values in tasks.items()}
    energy, distance = known["energy"], known["distance"]
    turning = np.abs(known.get("turning", np.zeros(len(energy))))
    half = vehicle.icr.left + vehicle.icr.right  # way of both treads for a radian on the spot
    columns: dict[Term, FloatArray] = {TRACTION: 2.0 * distance + half * turning}
    if np.any(turning > 0):
        columns[SLIP] = vehicle.slip_moment * turning
    if "duration" in known:
        columns[term("hotel_load")] = known["duration"]
    if len(energy) < len(columns) + _FEWEST:
        raise NotIdentifiableError(
            f"{len(energy)} tasks with distance and energy are too few for {len(columns)} "
            f"coefficients; give {len(columns) + _FEWEST} or more"
        )
    if not np.all(energy > 0):
        raise InvalidInputError("a task takes no energy, or gives some back; leave it out")
    hotel = next((one for one in columns if one.name == "hotel_load"), None)
    fitted = _fit(columns, energy)
    warnings: list[str] = []
    if hotel is not None and not _SEEN * fitted.errors[-1] < abs(fitted.values[-1]):
        duration, open_load = columns.pop(hotel), float(fitted.errors[-1])
        fitted = _fit(columns, energy)
        change = fitted.slopes @ (duration / energy)  # of the coefficients, by a watt left out
        most = float(np.min(fitted.values / np.maximum(change, 1e-300)))
        # a load from none to the one that leaves no resistance is as likely as any other
        open_load = min(open_load, most / np.sqrt(12.0))
        covariance = fitted.covariance + open_load**2 * np.outer(change, change)
        fitted = fitted._replace(covariance=covariance)
        warnings.append(
            "the tasks do not show a hotel load apart from the rest: it counts as resistance, and "
            f"each watt of it lowers K by about {change[0]:.2g} N; the standard errors hold a load "
            f"of up to {most:.2g} W"
        )
    values, covariance, rest = fitted.values, fitted.covariance, fitted.rest
    model = PowerModel(
        vehicle=vehicle, terms=tuple(columns), coefficients=values, covariance=covariance,
        name=f"{vehicle.name}: tasks",
    )  # fmt: skip
    warnings += [
        f"{one.name} is hardly known: {value:.4g} {one.unit} with a standard error of {error:.2g}"
        for one, value, error in zip(columns, values, fitted.errors, strict=True)
        if not error < _HARDLY * abs(value)
    ]
    if SLIP not in columns:
        warnings.append("the tasks do not tell how much the robot turned: turning costs nothing "
                        "in this model, and what it took counts as resistance")  # fmt: skip
    else:
        warnings.append(
            f"a turn counts as one on the spot about tread ICRs that are assumed, {half:.3g} m "
            "apart: where the robot turned in arcs, the friction coefficient is higher by up to "
            f"{_of_arcs(model, half):.2g}"
        )
    if "duration" not in known:
        warnings.append("the tasks have no duration: a hotel load counts as resistance")
    warnings.append(
        "a history tells sums alone: a log of one drive, of speeds and power, would tell the tread "
        "ICRs, each side, delays, and what depends on speed; energyplan start LOG begins with it"
    )
    return TaskFit(
        model,
        fitted.errors,
        (1.0 - rest) * energy,
        float(np.sqrt(np.mean(rest**2))),
        tuple(warnings),
    )


class _EnergyFit(NamedTuple):
    values: FloatArray
    covariance: FloatArray
    rest: FloatArray  # relative errors of the tasks' energies
    slopes: FloatArray  # (k, n): change of the values with the relative energies

    @property
    def errors(self) -> FloatArray:
        return np.asarray(np.sqrt(np.diag(self.covariance)))


def _fit(columns: Mapping[Term, FloatArray], energy: FloatArray) -> _EnergyFit:
    """Fit energies by their relative errors, outliers weighted down; robust covariance."""
    X = np.stack(list(columns.values()), axis=1) / energy[:, None]
    scale = np.sqrt((X * X).sum(axis=0))
    if np.linalg.matrix_rank(X / scale, tol=1e-6) < len(scale):
        if len(scale) > 1 and [*columns][-1].name == "hotel_load":
            unknown = np.diag(np.full(len(scale), np.inf))
            return _EnergyFit(np.zeros(len(scale)), unknown, energy, np.zeros_like(X.T))
        raise NotIdentifiableError(
            "the tasks are all alike: distance and turning grow together; give tasks that differ, "
            "as some with much turning, or record a drive"
        )
    weights = np.ones(len(energy))
    for _ in range(50):
        weighted = X * weights[:, None]
        values = np.linalg.solve(weighted.T @ X, weighted.sum(axis=0))
        rest = 1.0 - X @ values
        size = 1.4826 * float(np.median(np.abs(rest))) + 1e-12
        weights = np.minimum(1.0, _HUBER * size / np.maximum(np.abs(rest), 1e-300))
    inverse = np.linalg.inv(weighted.T @ X)
    meat = (weighted * rest[:, None]).T @ (weighted * rest[:, None])
    covariance = len(energy) / (len(energy) - len(values)) * inverse @ meat @ inverse
    return _EnergyFit(values, covariance, rest, inverse @ weighted.T)


def _of_arcs(model: PowerModel, half: float) -> float:
    """Return by how much the friction coefficient rises if all turns were arcs."""
    return model.coefficient("traction_resistance") * half / model.vehicle.slip_moment
