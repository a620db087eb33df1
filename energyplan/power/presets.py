"""Preset power models, and where each comes from.

They let an owner plan before the first log. None was measured on his robot, and every answer of the
command line that uses one says so.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from energyplan.power import TABLE_II, PowerModel
from energyplan.vehicle import TreadICR, Vehicle


@dataclass(frozen=True)
class ModelPreset:
    """A model of the paper's two terms as it was found once."""

    vehicle: str  # the vehicle's preset
    traction: float  # traction resistance of each side [N]
    slip: float  # friction coefficient [1]
    traction_error: float  # standard error of the traction resistance; 0 where it is not known [N]
    slip_error: float  # standard error of the friction coefficient; 0 where it is not known [1]
    spread: float  # standard deviation of a run's energy over that predicted
    half_track: float | None  # tread ICRs as they were found there [m]
    source: str  # where the values come from

    def model(self, name: str) -> PowerModel:
        """Return the model."""
        vehicle = Vehicle.preset(self.vehicle)
        if self.half_track is not None:
            vehicle = vehicle.with_icr(TreadICR.symmetric(self.half_track))
        values = np.array([self.slip, self.traction])
        errors = np.array([self.slip_error, self.traction_error])
        covariance = None
        if np.any(errors) or self.spread:
            whole = self.spread * values
            covariance = np.outer(whole, whole) + np.diag(errors**2)
        return PowerModel.paper(vehicle, self.traction, self.slip, covariance, name=name)


_PAPER = "Morales et al. (2010), Table II: Quadriga; no standard errors are given"
_BOREALTC = (
    "energyplan identify over all {0} runs on {1} of BorealTC (LaRocque et al. 2024, arXiv "
    "2403.16877), a Husky A200 of 70 kg, {2} s; mechanical power by the motor's constant"
)
_VULPI = (
    "energyplan identify over 6 runs on ploughed soil of Vulpi et al. (2021), a Husky A200, 308 s "
    "with hardly a turn; mechanical power by the motor's constant"
)
_SCALED = (
    "no log of a Jackal: a Husky's friction coefficient on {0}, and its traction resistance in "
    "proportion to the weight; the spread is a guess"
)
_DRIVE = (
    "energyplan identify over one drive of 6 minutes on grass of the DRIVE data (Norlab), a "
    "Warthog of 470 kg; electrical power of both drives, spread between drives not known"
)


def _husky(K: float, mu: float, errors: tuple[float, float], spread: float, half: float,
           runs: int, ground: str, seconds: int) -> ModelPreset:  # fmt: skip
    source = _BOREALTC.format(runs, ground, seconds)
    return ModelPreset("husky_a200", K, mu, *errors, spread, half, source)


def _jackal(K: float, mu: float, ground: str) -> ModelPreset:
    share = 17.0 / 70.0  # of the weights
    return ModelPreset(
        "jackal", round(K * share, 1), mu, 0.0, 0.0, 0.3, None, _SCALED.format(ground)
    )


MODEL_PRESETS: Mapping[str, ModelPreset] = MappingProxyType(
    {
        **{
            name: ModelPreset(name.rpartition(":")[0], K, mu, 0.0, 0.0, 0.0, None, _PAPER)
            for name, (K, mu) in TABLE_II.items()
        },
        "husky_a200:flooring": _husky(
            39.0, 0.686, (0.65, 0.011), 0.09, 0.402, 10, "indoor flooring", 1225
        ),
        "husky_a200:ice": _husky(50.9, 0.123, (0.71, 0.0038), 0.07, 0.398, 13, "ice", 1808),
        "husky_a200:sandy_loam": _husky(
            78.8, 0.718, (1.67, 0.0091), 0.07, 0.488, 14, "sandy loam", 638
        ),
        "husky_a200:snow": _husky(112.5, 0.170, (7.5, 0.056), 0.31, 1.946, 27, "snow", 1376),
        "husky_a200:ploughed": ModelPreset(
            "husky_a200", 101.3, 0.631, 1.07, 0.167, 0.05, 0.582, _VULPI
        ),
        "jackal:flooring": _jackal(39.0, 0.686, "indoor flooring"),
        "jackal:sandy_loam": _jackal(78.8, 0.718, "sandy loam"),
        "warthog:grass": ModelPreset("warthog", 208.4, 1.266, 15.0, 0.12, 0.0, 0.908, _DRIVE),
    }
)
"""Preset models by name: values, errors, spread, source."""
