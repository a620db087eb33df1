"""How the logged power is behind the motion: by a delay, and by the lag of its sensor (private)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar
from scipy.signal import lfilter

from energyplan.logs.align import find_runs
from energyplan.path import FloatArray

DELAYS = np.round(np.arange(-1.0, 1.01, 0.1), 1)
"""Delays of the power that are tried first [s]."""

_LAGS = (0.1, 0.2, 0.4, 0.8, 1.6)  # of its sensor [s]
_SHARES = (0.6, 1.0)  # of a lag, by which it is as good as a delay


class Late(NamedTuple):
    """How the logged power is behind the motion."""

    delay: float = 0.0  # time after which it is logged [s]
    lag: float = 0.0  # [s]

    @property
    def mean(self) -> float:
        """Mean time by which the power is late [s]."""
        return self.delay + self.lag

    @property
    def params(self) -> tuple[tuple[str, float], ...]:
        """Parameters by name; the lag where there is one."""
        told = (("delay", self.delay), ("lag", self.lag))
        return told if self.lag > 0.0 else told[:1]

    @classmethod
    def of(cls, params: Sequence[tuple[str, float]]) -> Late:
        """Return what parameters by name say; a lag is not negative."""
        named = dict(params)
        return cls(named["delay"], max(named.get("lag", 0.0), 0.0))


ON_TIME = Late()


class Clock:
    """When the samples of a log were taken, and what they show late."""

    def __init__(self, t: FloatArray) -> None:
        self.t = t
        self.runs = tuple(find_runs(t))
        self.period = _period(t)
        self._periods = [_period(t[run]) for run in self.runs]
        self._before: dict[bool, tuple[float, NDArray[np.intp], FloatArray]] = {}

    def delayed(self, values: FloatArray, delay: float) -> FloatArray:
        """Return values, shape (n, ...), as they were a time before: linear between samples.

        Nothing passes across a gap.
        """
        known, k, share = self._before.get(delay < 0.0, (np.nan, None, None))
        if known != delay or k is None or share is None:
            parts = [(run.start, *_before(self.t[run], delay)) for run in self.runs]
            k = np.concatenate([start + at for start, at, _ in parts])
            share = np.concatenate([part for _, _, part in parts])
            self._before[delay < 0.0] = delay, k, share
        share = share.reshape(-1, *[1] * (values.ndim - 1))
        after = np.minimum(k + 1, len(values) - 1)
        return np.asarray(values[k] * (1.0 - share) + values[after] * share)

    def lagged(self, values: FloatArray, lag: float) -> FloatArray:
        """Return values, shape (n, ...), as a first-order lag shows them, each run from rest."""
        pairs = zip(self.runs, self._periods, strict=True)
        return np.concatenate([_lagged(values[run], period, lag) for run, period in pairs])


def _period(t: FloatArray) -> float:
    """Return the usual time between samples; infinite where there is one."""
    return float(np.median(np.diff(t))) if len(t) > 1 else np.inf


def _before(t: FloatArray, delay: float) -> tuple[NDArray[np.intp], FloatArray]:
    """Return the sample that was last a time before each, and the share of the next one."""
    if len(t) < 2:
        return np.zeros(len(t), np.intp), np.zeros(len(t))
    at = t - delay
    k = np.clip(np.searchsorted(t, at) - 1, 0, len(t) - 2)
    return k, np.clip((at - t[k]) / (t[k + 1] - t[k]), 0.0, 1.0)


def _lagged(values: FloatArray, period: float, lag: float) -> FloatArray:
    """Return values, shape (n, ...), as a first-order lag passes them on, at rest to begin with.

    Exact for values that are linear between samples a period apart.
    """
    ratio = period / lag
    fade = float(np.exp(-ratio))
    new = 1.0 + np.expm1(-ratio) / ratio
    old = 1.0 - fade - new
    start = (1.0 - new) * values[:1]
    found, _ = lfilter([new, old], [1.0, -fade], values, axis=0, zi=start)
    return np.asarray(found)


def least_late(loss: Callable[[Late], float], worth: float, shortest: float) -> list[Late]:
    """Return the time offsets of least loss among those near them, the least one first.

    A lag smears as well as it delays, and is taken where that is worth it.
    """
    losses = np.array([loss(Late(delay)) for delay in DELAYS.tolist()])
    near = np.pad(losses, 1, constant_values=np.inf)
    lowest = np.flatnonzero((losses <= near[:-2]) & (losses < near[2:]))
    found = (_near(loss, k, worth, shortest) for k in lowest.tolist())
    return [late for _, late in sorted(found)]


def _near(
    loss: Callable[[Late], float], k: int, worth: float, shortest: float
) -> tuple[float, Late]:
    """Return the least loss near a delay that was tried, and its time offset."""
    found = minimize_scalar(
        lambda delay: loss(Late(float(delay))),
        bounds=(float(DELAYS[max(k - 1, 0)]), float(DELAYS[min(k + 1, len(DELAYS) - 1)])),
        method="bounded",
        options={"xatol": 0.005},
    )
    least, delay = float(found.fun), float(found.x)
    if delay < shortest:
        return least, Late(delay)
    trials = [
        Late(delay - share * lag, lag)
        for lag in _LAGS for share in _SHARES if share * lag <= delay + shortest
    ]  # fmt: skip
    losses = [loss(trial) for trial in trials]
    if not losses or min(losses) >= least - worth:
        return least, Late(delay)
    return min(losses), trials[int(np.argmin(losses))]
