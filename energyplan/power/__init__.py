"""The power model: a sum of terms times coefficients.

The paper's slip friction and traction resistance are two terms; an effect found in data is one
more. Three kinds of term exist, told apart by what they act on:

``force``
    A longitudinal force on each tread; its power is force times tread speed. All force terms
    together are what the motors must hold against the ground.
``power``
    Power that is not drawn by the motors, such as a hotel load.
``loss``
    Power lost between battery and tread, a function of the forces and speeds of both sides, such
    as copper loss or drive efficiency.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

from energyplan import html
from energyplan.errors import ModelError, UnknownNameError
from energyplan.motion import Motion
from energyplan.path import FloatArray
from energyplan.power.terms import (
    DRIVE_LOSS,
    HOTEL,
    REGENERATION_LOSS,
    SLIP,
    TRACTION,
    Kind,
    Sides,
    Term,
    tread_forces,
)
from energyplan.records import ByValue, Finite, check_fields, checked, instance, numbers, record
from energyplan.vehicle import Vehicle

__all__ = [
    "DRIVE_LOSS",
    "HOTEL",
    "REGENERATION_LOSS",
    "SLIP",
    "TABLE_II",
    "TRACTION",
    "Kind",
    "PowerModel",
    "Residual",
    "Sides",
    "Term",
    "tread_forces",
]


_LARGEST_MU = 10.0  # of any friction coefficient; K is larger, which shows who swapped them

USUAL_RUN_SPREAD = 0.05
"""Relative standard deviation of a robot's power from run to run where nobody compared any: that of
a Husky was 2 to 6 % on five grounds, and 24 % on snow (docs/model_card)."""


@record(ModelError)
class Residual:
    """Measured minus predicted power on a set of drives.

    Parameters
    ----------
    rmse, mae, bias : float
        Root mean square, mean absolute and mean residual [W].
    energy_error : float
        Predicted over measured energy, minus 1.
    correlation_time : float
        Integral time scale of the residual's autocorrelation [s].
    duration : float
        Length of the drives [s].
    run_spread : float, optional
        Relative standard deviation of the power between runs, beyond the scatter within them;
        None where too few runs were compared.

    Examples
    --------
    >>> Residual(rmse=12.0, mae=9.5, bias=0.5, energy_error=0.01).rmse
    12.0
    """

    rmse: Finite
    mae: Finite
    bias: Finite
    energy_error: Annotated[float, Field(ge=-np.inf)]  # infinite where no energy was measured
    correlation_time: Finite = 0.0
    duration: Finite = 0.0
    run_spread: Finite | None = None


@dataclass(frozen=True, eq=False)
class PowerModel(ByValue, html.Readable):
    """Power as a sum of terms times coefficients, with their covariance.

    Parameters
    ----------
    vehicle : Vehicle
        The vehicle, with the tread ICRs that the model was identified with.
    terms : sequence of Term
        The terms; names must differ.
    coefficients : array_like, shape (n,)
        One coefficient per term, in the term's unit.
    covariance : array_like, shape (n, n), optional
        Covariance of the coefficients; None where it is not known.
    residual : Residual, optional
        How well the model predicted drives: held out ones where there were any.
    name : str
        What to call the model.

    Raises
    ------
    ModelError
        If the parts do not fit together.

    References
    ----------
    Morales et al. (2010), Eq. 2 to 4.

    Examples
    --------
    >>> model = PowerModel.preset("quadriga:empty:concrete")
    >>> motion = Motion.from_twist(0.5, 0.0, model.vehicle.icr)
    >>> float(model.power(motion))
    113.0
    """

    vehicle: Vehicle
    terms: tuple[Term, ...]
    coefficients: FloatArray
    covariance: FloatArray | None = None
    residual: Residual | None = None
    name: str = "model"

    def __post_init__(self) -> None:
        check_fields(self, ModelError)
        object.__setattr__(self, "terms", tuple(self.terms))
        names = [term.name for term in self.terms]
        if len(set(names)) != len(names):
            raise ModelError(f"a term stands twice in {names}; merge its coefficients")
        values = numbers(self.coefficients, "coefficients", ModelError).copy()
        if values.shape != (len(names),) or not np.all(np.isfinite(values)):
            raise ModelError(
                f"coefficients {values.tolist()} for terms {names}; give one finite value each"
            )
        values.setflags(write=False)
        object.__setattr__(self, "coefficients", values)
        if self.covariance is not None:
            cov = numbers(self.covariance, "covariance", ModelError).copy()
            if cov.shape != (len(names), len(names)) or not np.all(np.isfinite(cov)):
                raise ModelError(
                    f"covariance has shape {cov.shape}; give finite numbers of shape "
                    f"{(len(names), len(names))}, in the order of the terms {names}"
                )
            if not np.allclose(cov, cov.T, rtol=1e-6, atol=1e-300) or np.any(np.diag(cov) < 0):
                raise ModelError("covariance must be symmetric with no negative variance")
            cov.setflags(write=False)
            object.__setattr__(self, "covariance", cov)

    def _summaries(self) -> list[html.Summary]:
        rows = [
            (
                term.name.replace("_", " "), term.symbol, self.coefficient(term.name),
                "-" if (error := self.std_error(term.name)) is None else error,
                html.unit(term.unit),
            )
            for term in self.terms
        ]  # fmt: skip
        title = f"{self.name}, {self.vehicle.name}"
        return [html.Summary(title, ("term", "symbol", "value", "standard error", "unit"), rows)]

    # -- coefficients ---------------------------------------------------------------------------

    def _index(self, name: str) -> int:
        for k, term in enumerate(self.terms):
            if term.name == name:
                return k
        raise UnknownNameError("term", name, [term.name for term in self.terms])

    def has(self, name: str) -> bool:
        """Return whether a term of that name is in the model."""
        return any(term.name == name for term in self.terms)

    def coefficient(self, name: str) -> float:
        """Return the coefficient of the named term.

        Raises
        ------
        UnknownNameError
            If the model has no such term.
        """
        return float(self.coefficients[self._index(name)])

    def std_error(self, name: str) -> float | None:
        """Return the standard error of the named term's coefficient, or None where unknown.

        Raises
        ------
        UnknownNameError
            If the model has no such term.
        """
        k = self._index(name)
        return None if self.covariance is None else float(np.sqrt(self.covariance[k, k]))

    def principal_directions(self) -> FloatArray:
        """Return independent changes of the coefficients, one standard deviation each, (n, k)."""
        if self.covariance is None:
            return np.empty((len(self.terms), 0))
        value, vector = np.linalg.eigh(self.covariance)
        keep = value > 1e-12 * max(float(value.max()), 1e-300)
        return np.asarray(vector[:, keep] * np.sqrt(value[keep]))

    @checked(ModelError)
    def with_term(self, term: Term, value: float) -> PowerModel:
        """Return this model with one more term of known coefficient (variance zero)."""
        cov = self.covariance
        if cov is not None:
            cov = np.pad(cov, ((0, 1), (0, 1)))
        return replace(
            self,
            terms=(*self.terms, term),
            coefficients=np.append(self.coefficients, value),
            covariance=cov,
        )

    def with_coefficients(
        self, coefficients: ArrayLike, covariance: ArrayLike | None = None
    ) -> PowerModel:
        """Return this model with other coefficients, and their covariance where it is known."""
        return replace(
            self,
            coefficients=numbers(coefficients, "coefficients", ModelError),
            covariance=None
            if covariance is None
            else numbers(covariance, "covariance", ModelError),
        )

    # -- power ----------------------------------------------------------------------------------

    def _motion(self, motion: Motion) -> Motion:
        instance(motion, Motion, "motion")
        if motion.icr != self.vehicle.icr:
            return replace(motion, icr=self.vehicle.icr)
        return motion

    def _regressor(self, term: Term, motion: Motion, forces: Sides | None) -> Any:
        if term.kind == "loss":
            return term.function(motion, self.vehicle, forces, **term.params)
        for name in term.channels:
            motion.channel(name, f"the term {term.name!r}")
        return term.function(motion, self.vehicle, **term.params)

    def forces(self, motion: Motion) -> Sides:
        """Longitudinal force that each motor delivers at its tread [N].

        Parameters
        ----------
        motion : Motion, shape (...)
            The motion. Its tread ICRs are replaced by those of the model.

        Returns
        -------
        Sides
            Forces, positive forwards.

        Raises
        ------
        MissingChannelError
            If a term needs a channel that the motion does not have.
        """
        motion = self._motion(motion)
        total = Sides(np.zeros(motion.shape), np.zeros(motion.shape))
        for term, value in zip(self.terms, self.coefficients, strict=True):
            if term.kind == "force":
                total = total + self._regressor(term, motion, None) * float(value)
        return total

    def regressors(self, motion: Motion) -> list[Sides | FloatArray]:
        """Power per unit of each term's coefficient, in the order of the terms [W per unit].

        The `loss` terms depend on the forces and so on the other coefficients; they are taken at
        the model's own.

        Parameters
        ----------
        motion : Motion, shape (...)
            The motion.

        Returns
        -------
        list
            For each term: `Sides` where its power belongs to the treads, an array where it does
            not.
        """
        motion = self._motion(motion)
        lossy = any(term.kind == "loss" for term in self.terms)
        forces = self.forces(motion) if lossy else None
        columns: list[Sides | FloatArray] = []
        for term in self.terms:
            value = self._regressor(term, motion, forces)
            if term.kind == "force":
                value = Sides(value.left * motion.v_left, value.right * motion.v_right)
            columns.append(value)
        return columns

    def sides(self, motion: Motion) -> Sides:
        """Power of each side [W]; power that belongs to no side is left out.

        A side that generates has negative power: the inner one in an arc, as soon as the slip
        force exceeds the traction resistance.

        Parameters
        ----------
        motion : Motion, shape (...)
            The motion.

        Returns
        -------
        Sides
            Power of the left and of the right side.

        References
        ----------
        docs/theory, section 2.
        """
        motion = self._motion(motion)
        total = Sides(np.zeros(motion.shape), np.zeros(motion.shape))
        for column, value in zip(self.regressors(motion), self.coefficients, strict=True):
            if isinstance(column, Sides):
                total = total + column * float(value)
        return total

    def breakdown(self, motion: Motion) -> dict[str, FloatArray]:
        """Power by term [W]; the values add up to `power`."""
        parts = {}
        for term, column, value in zip(
            self.terms, self.regressors(motion), self.coefficients, strict=True
        ):
            whole = column.total if isinstance(column, Sides) else column
            parts[term.name] = np.asarray(whole * value)
        return parts

    def power(self, motion: Motion) -> FloatArray:
        """Total power [W] (Eq. 4).

        Parameters
        ----------
        motion : Motion, shape (...)
            The motion.

        Returns
        -------
        ndarray, shape (...)
            Power, positive when drawn.

        Raises
        ------
        MissingChannelError
            If a term needs a channel that the motion does not have.
        """
        motion = self._motion(motion)
        total = np.zeros(motion.shape)
        for part in self.breakdown(motion).values():
            total = total + part
        return total

    def battery_side(self) -> PowerModel:
        """Return the model of what the battery delivers.

        The vehicle's drive and regeneration efficiencies become loss terms, unless the model
        already holds such a term, found in data.

        Returns
        -------
        PowerModel
            This model, or one with `DRIVE_LOSS` and `REGENERATION_LOSS` added.
        """
        model = self
        losses = (
            (DRIVE_LOSS, 1 / self.vehicle.drive_efficiency - 1),
            (REGENERATION_LOSS, 1 - self.vehicle.regen_efficiency),
        )
        for term, value in losses:
            if value > 0 and not model.has(term.name):
                model = model.with_term(term, value)
        return model

    # -- presets --------------------------------------------------------------------------------

    @classmethod
    @checked(ModelError)
    def paper(
        cls,
        vehicle: Vehicle,
        K: float,
        mu: float,
        covariance: ArrayLike | None = None,
        name: str = "model",
    ) -> PowerModel:
        """Return the paper's model (Eq. 4).

        Parameters
        ----------
        vehicle : Vehicle
            The vehicle.
        K : float
            Traction resistance of each side [N].
        mu : float
            Friction coefficient.
        covariance : array_like, shape (2, 2), optional
            Covariance of (mu, K), in the order of the terms.
        name : str
            What to call it.

        Returns
        -------
        PowerModel
            A model of two terms: slip friction, traction resistance.
        """
        if mu > _LARGEST_MU > K:
            raise ModelError(
                f"K is {K} N and mu is {mu}; they seem to be swapped: give the traction "
                "resistance, then the friction coefficient"
            )
        values = np.array([mu, K], float)
        cov = None if covariance is None else np.asarray(covariance, float)
        return cls(vehicle, (SLIP, TRACTION), values, cov, name=name)

    @classmethod
    def preset(cls, name: str) -> PowerModel:
        """Return a preset model, which was measured on another robot than one's own.

        ``quadriga:<empty|full>:<marble|concrete>`` are those of the paper's Table II, which gives
        no standard errors. The others, such as ``husky_a200:flooring``, have a covariance from the
        spread between drives; `energyplan.power.presets` names the source of each.

        Parameters
        ----------
        name : str
            Name of the preset.

        Returns
        -------
        PowerModel
            The model.

        Raises
        ------
        UnknownNameError
            If there is no such preset.
        """
        from energyplan.power.presets import MODEL_PRESETS

        if name not in MODEL_PRESETS:
            raise UnknownNameError("model preset", name, MODEL_PRESETS)
        return MODEL_PRESETS[name].model(name)


TABLE_II = {
    "quadriga:full:marble": (110.0, 0.431),
    "quadriga:empty:marble": (90.0, 0.427),
    "quadriga:full:concrete": (118.0, 0.647),
    "quadriga:empty:concrete": (113.0, 0.627),
}
"""K [N] and mu of Quadriga (Table II)."""
