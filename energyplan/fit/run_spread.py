"""How much runs differ as a whole, each by a factor of its power (private)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

from energyplan.fit.drives.design import Design
from energyplan.path import FloatArray


@dataclass(frozen=True)
class RunSpread:
    """How much runs differ as a whole, each by a factor of its power."""

    deviation: float
    factors: tuple[float, ...]
    excess: FloatArray  # each run's own estimate of its factor, less 1, and the variance of that
    variances: FloatArray  # each run's own estimate of its factor, less 1, and the variance of that

    @classmethod
    def of(cls, design: Design, values: FloatArray) -> RunSpread | None:
        """Compare runs by their longest windows (Paule's and Mandel's estimate).

        Source: Paule and Mandel (1982), J. Res. NBS 87, 377-385.
        """
        table, owner = design.longest
        count = int(owner.max()) + 1
        if count < 3 or len(owner) == count:
            return None
        predicted, measured = table[:, :-1] @ values, table[:, -1]
        square = np.bincount(owner, predicted**2, count)
        product = np.bincount(owner, predicted * measured, count)
        excess = product / np.maximum(square, 1e-300) - 1.0
        scatter = measured - predicted * (1.0 + excess[owner])
        windows = np.bincount(owner, minlength=count)
        freedom = float(np.sum(np.maximum(windows - 1, 0)))
        noise = float(scatter @ scatter) / freedom
        variances = np.maximum(noise / np.maximum(square, 1e-300), 1e-12)

        def misfit(between: float) -> float:
            weight = 1.0 / (variances + between)
            return float(weight @ (excess - weight @ excess / weight.sum()) ** 2) - (count - 1)

        between = 0.0
        if misfit(0.0) > 0.0:
            most = 2.0 * float(np.var(excess, ddof=1)) + 1e-12
            between = float(brentq(misfit, 0.0, most)) if misfit(most) < 0.0 else most
        shrunk = excess * between / (between + variances)
        return cls(float(np.sqrt(between)), tuple((1.0 + shrunk).tolist()), excess, variances)
