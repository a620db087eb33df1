"""Whether what a model leaves of the drives that it was fitted to is no more than noise."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from scipy.stats import f as fisher

from energyplan.fit.covariance import autocorrelation
from energyplan.fit.drives.denoise import speed_noise
from energyplan.fit.drives.drive import Drive
from energyplan.fit.drives.linear import equations_of, is_lossy, linearise_drive, power_of
from energyplan.fit.drives.windows import SCALES
from energyplan.fit.residuals import pieces_of
from energyplan.fit.solvers import column_scale
from energyplan.path import FloatArray
from energyplan.power import PowerModel, Term
from energyplan.power.effect_terms import SLIP_CHANGE, TRACTION_CHANGE, WHEEL_FIGHT
from energyplan.power.effects import Effect, catalogue

_FLOOR = 0.01
"""What is no more than this fraction of the root mean square power is as good as nothing."""
_CHANCE = 1e-3  # that noise alone is called coloured, over all lengths of means
_RESTING = 20  # samples at rest that tell the noise
_STEADY = 3.0  # standard errors by which coefficients move where a model lacks nothing
_MOVED = 0.01  # part of a coefficient by which it may move all the same
_SIGMA = 4.0  # standard deviations that noise does not exceed


@dataclass(frozen=True)
class Adequacy:
    """Residual on the drives of a fit, beside the noise that no model can explain."""

    noise: float  # of a sample [W]
    residual: float  # root mean square residual of the model [W]
    slow_noise: float  # the same of means over `time` [W]
    slow_residual: float  # the same of means over `time` [W]
    coloured: bool  # whether the residual lasts longer than noise would, by more than chance
    time: float  # [s]
    missing: tuple[float, ...] = (0.0, 0.0, 0.0)  # [W^2]

    @property
    def adequate(self) -> bool:
        """Whether the model leaves no more than noise: less than twice its size, and no colour."""
        return self.residual <= 2.0 * self.noise and not self.coloured

    @property
    def in_words(self) -> str:
        """What is left, what noise makes, and how one differs from the other."""
        what = "lasts longer than noise would" if self.coloured else "is larger than noise"
        return (
            f"{self.residual:.3g} W, where noise makes {self.noise:.3g} W, and in means over "
            f"{self.time:.2g} s {self.slow_residual:.3g} W, where noise makes "
            f"{self.slow_noise:.3g} W: what is left {'is noise' if self.adequate else what}"
        )


def predicted(model: PowerModel, drive: Drive) -> FloatArray:
    """Power that a drive's log would show by a model [W]."""
    whole = model.battery_side() if drive.battery else model
    return drive.seen(power_of(whole, drive))


def shown_of_contacts(model: PowerModel, drive: Drive) -> FloatArray | None:
    """Return what the powers of a drive show of what contacts hold, beyond a prediction [W].

    None where they show nothing: without losses it costs nothing. Nor where nobody knows when the
    robot changed. A model may have a term for its mean, which what they show replaces.
    """
    changes = any(term.name in (SLIP_CHANGE.name, TRACTION_CHANGE.name) for term in model.terms)
    undated = changes and "changed" not in drive.motion.channels
    if undated or not is_lossy(drive, model.terms):
        return None
    told = equations_of(_without_fight(model), replace(drive, fitted=True))[:, 0]
    alone = equations_of(model, replace(drive, between=None, fitted=False))[:, 0]
    return told - alone if np.any(told != alone) else None


def _without_fight(model: PowerModel) -> PowerModel:
    keep = [k for k, term in enumerate(model.terms) if term.name != WHEEL_FIGHT.name]
    return PowerModel(model.vehicle, tuple(model.terms[k] for k in keep), model.coefficients[keep])


def left_over(model: PowerModel, drives: Sequence[Drive]) -> list[FloatArray]:
    """Return what a model leaves of each drive's power, what contacts hold taken out [W]."""
    left = []
    for drive in drives:
        shown = shown_of_contacts(model, drive)
        residual = drive.power - predicted(model, drive)
        left.append(residual if shown is None else residual - shown)
    return left


@dataclass(frozen=True)
class Beside:
    """What further terms do to a fitted model."""

    residuals: list[FloatArray]  # (n,): what is left of each drive [W]
    moved: FloatArray  # (k,): by how much the model's own coefficients move
    errors: FloatArray  # (k,)

    def moves(self, model: PowerModel) -> list[str]:
        """Name the coefficients that move by more than their standard errors admit."""
        return [
            f"{term.symbol} from {value:.4g} to {value + by:.4g}"
            for term, value, by, error in zip(
                model.terms, model.coefficients, self.moved, self.errors, strict=True
            )
            if abs(by) > _MOVED * abs(value)
            and abs(by) > _STEADY * np.hypot(error, model.std_error(term.name) or 0.0)
        ]


def usual_effects(entries: Iterable[Effect] | None = None) -> list[Effect]:
    """Return what of some effects, or of all known ones, nearly every drive shows.

    Such as need a channel of their own are left out.
    """
    every = catalogue().values() if entries is None else entries
    return [effect for effect in every if effect.usual and not effect.channels]


def usual_terms(terms: Sequence[Term]) -> list[Term]:
    """Return the terms of what nearly every drive shows, beside those of a model."""
    names = {term.name for term in terms}
    return [
        replace(term, params={**term.params, **dict(zip(effect.grid, values, strict=True))})
        for effect in usual_effects()
        for values in product(*effect.grid.values())
        for term in effect.terms
        if term.name not in names
    ]


def beside(terms: Sequence[Term], model: PowerModel, drives: Sequence[Drive]) -> Beside:
    """Fit further terms beside those of a model.

    One step of least squares, about the model's coefficients, of all that those terms and the
    model's own can explain.
    """
    every, own = (*model.terms, *terms), len(model.terms)
    about = np.append(model.coefficients, np.zeros(len(terms)))
    tables = [linearise_drive(d, model.vehicle, every, about).columns[:, 0] for d in drives]
    left = left_over(model, drives)
    X, y = np.concatenate(tables), np.concatenate(left)
    scale = column_scale(X)
    inverse = np.linalg.pinv((X.T @ X) / np.outer(scale, scale), 1e-10, hermitian=True)
    step = inverse @ (X.T @ y / scale) / scale
    rest = y - X @ step
    repeats = autocorrelation(rest, pieces_of(drives)).repeats
    variance = float(rest @ rest) / len(y) * repeats * np.diag(inverse) / scale**2
    residuals = [r - table @ step for r, table in zip(left, tables, strict=True)]
    return Beside(residuals, step[:own], np.sqrt(variance[:own]))


def adequacy(drives: Sequence[Drive], residuals: Sequence[FloatArray]) -> Adequacy:
    """Compare what a model leaves of the drives that it was fitted to with their noise.

    The noise of a sample is what neighbouring samples differ by beyond a smooth curve, or the
    scatter at rest where that is larger; how much of it lasts is told by the samples at rest. The
    residual is coloured where its means over half a second, two or eight seconds scatter by more
    than noise would by chance (Fisher's distribution, of as many means as are independent, and of
    as many samples as told the noise), and by more than is as good as nothing. What contacts hold
    on a straight no model foretells: where losses make it cost, what the total shows of it is no
    residual.
    """
    rests: list[FloatArray] = []
    whites: list[float] = []
    seldom: list[float] = []  # of readings between which the power really changes
    for drive, residual in zip(drives, residuals, strict=True):
        if len(residual) > 4:
            readings = drive.power if drive.hold is None else drive.power[drive.hold.first]
            (whites if drive.hold is None else seldom).append(speed_noise(readings))
        if np.count_nonzero(drive.rests) >= _RESTING:
            resting = residual[drive.rests]
            rests.append(resting - np.median(resting))
    every = np.concatenate(residuals)
    size = float(np.sqrt(np.mean(np.concatenate([d.power for d in drives]) ** 2)))
    known = whites or ([] if rests else seldom) or [0.0]
    noise, repeats, told = float(np.median(known)), 1.0, float(len(every))
    if rests:
        rest = np.concatenate(rests)
        # A load that comes and goes at rest is no noise: what most samples scatter by is.
        spread = 1.4826 * float(np.median(np.abs(rest)))
        if spread > 0:
            stops = np.cumsum([len(part) for part in rests]).tolist()
            pieces = [slice(a, b) for a, b in zip([0, *stops[:-1]], stops, strict=True)]
            usual = np.clip(rest, -_SIGMA * spread, _SIGMA * spread)
            repeats = autocorrelation(usual, pieces).repeats if spread > 0.5 * noise else 1.0
            # Noise that lasts is known by as many samples as are independent.
            told = len(rest) / repeats if repeats > 1.0 else told
        noise = max(noise, spread)
    noise = max(noise, _FLOOR * size)
    repeats = max(repeats, *(drive.hold.rows if drive.hold else 1.0 for drive in drives), 1.0)
    slow = [
        _means(drives, residuals, k, _Noise(noise, repeats, told), _FLOOR * size)
        for k in range(len(SCALES))
    ]
    most = max(slow, key=lambda one: one.residual / one.limit)
    return Adequacy(
        noise, float(np.sqrt(np.mean(every**2))), most.noise, most.residual,
        bool(most.residual > most.limit), most.time,
        tuple(max(one.residual**2 - one.noise**2, 0.0) for one in slow),
    )  # fmt: skip


@dataclass(frozen=True)
class _Noise:
    """Noise of a sample [W], how many samples repeat each other, and how many told it."""

    deviation: float
    repeats: float
    told: float


@dataclass(frozen=True)
class _Means:
    """Scatter of means of a residual: what noise makes, what there is, what noise may make [W]."""

    time: float
    noise: float
    residual: float
    limit: float


def _means(
    drives: Sequence[Drive],
    residuals: Sequence[FloatArray],
    scale: int,
    noise: _Noise,
    nothing: float,
) -> _Means:
    """Compare means of a residual over one time with those of noise."""
    windows = [drive.windows[scale] for drive in drives]
    means = np.concatenate([w.mean(r) for w, r in zip(windows, residuals, strict=True)])
    number = float(np.median(np.concatenate([w.counts for w in windows])))
    own = noise.deviation * float(np.sqrt(min(noise.repeats / number, 1.0)))
    independent = min(float(len(means)), sum(map(len, residuals)) / noise.repeats)
    by_chance = float(fisher.isf(_CHANCE / len(SCALES), independent, noise.told))
    limit = float(np.sqrt(own**2 * by_chance + nothing**2))
    return _Means(windows[0].length, own, float(np.sqrt(np.mean(means**2))), limit)
