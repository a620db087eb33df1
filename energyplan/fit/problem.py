"""Drives and the terms that are to explain them: their columns, losses linearised (private).

What losses take depends on all other coefficients, so that these are found in rounds; a sum of
terms without losses is linear as it is.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from energyplan.fit.drives.columns import columns_of
from energyplan.fit.drives.design import Design, window_means
from energyplan.fit.drives.drive import Drive
from energyplan.fit.drives.late import Late
from energyplan.fit.drives.linear import is_lossy, linearise_drive
from energyplan.fit.drives.windows import SCALES
from energyplan.fit.least_squares import evidence_of, fit, solve, weighted
from energyplan.fit.run_spread import RunSpread
from energyplan.path import FloatArray
from energyplan.power import SLIP, TRACTION, Term
from energyplan.vehicle import Vehicle

PAPER = (SLIP, TRACTION)

FINE = 0.1
"""Part of the floor that likelihoods count as nothing."""

FLOOR = 0.01
"""Error that is not worth an effect, as a fraction of the root mean square power."""

ROUNDS = 20
"""Most steps of a fit with losses."""

_SLIP_LAW = 0.05  # part of the sides' difference that no law of sliding friction foretells
_KEPT = 0.1  # of friction and resistance in a step, at least
_SETTLED = 5e-3  # fall of the negative logarithm of the likelihood that is none
_SHORTER = 0.4  # part of a step that is tried where the step has led to nothing better
_PROMISED = 2.0  # by which a still shorter step is to lower that logarithm, to be tried

_RUNS = 6  # drives from which on each has a factor before effects are looked for
_GOLDEN = 0.5 * (np.sqrt(5.0) - 1.0)  # its multiples spread evenly
_LEVELLING = 4  # rounds in which factors of runs and coefficients settle


@dataclass(frozen=True)
class Tables:
    """Columns of terms on drives, linearised about coefficients."""

    columns: list[FloatArray]  # (n, equations, k): of each drive
    targets: list[FloatArray]  # (n, equations): power that they are to explain [W]
    odds: float


@dataclass(frozen=True)
class _Tried:
    """Coefficients that were tried: the design about them, and what it says of them.

    `misfit` is the negative logarithm of their likelihood, `least` the coefficients that the design
    takes for the most likely, `hoped` what it takes their misfit for. `drag` tells which are the
    paper's, `loss` which are those of losses.
    """

    drag: NDArray[np.bool_]
    loss: NDArray[np.bool_]
    values: FloatArray
    design: Design
    gram: FloatArray
    misfit: float
    least: FloatArray
    hoped: float

    def step(self, to: FloatArray) -> FloatArray:
        """Return coefficients to try next: the paper's, and losses, lose nine tenths at most.

        A loss that multiplies all forces asks for so much less of them that they would push, and
        forces that are too small for so much less of a loss that it would give.
        """
        kept = _KEPT * self.values
        return np.where((self.drag | self.loss) & (kept > 0.0), np.maximum(to, kept), to)

    @property
    def promised(self) -> float:
        """By how much a full step is to lower the misfit."""
        return self.misfit - self.hoped

    @property
    def on(self) -> FloatArray:
        """Coefficients that a full step leads to."""
        return self.step(self.least)

    @property
    def rest(self) -> FloatArray:
        """Coefficients that a step leads to which leaves losses as they are.

        A loss multiplies the forces: the larger the one, the smaller the others. A full step along
        a tangent leaves that valley, and this one leads back into it.
        """
        free = np.flatnonzero(~self.loss)
        onto = np.zeros((len(self.values) + 1, len(free) + 1))
        onto[free, np.arange(len(free))] = 1.0
        onto[:-1, -1] = np.where(self.loss, -self.values, 0.0)
        onto[-1, -1] = 1.0
        to = self.values.copy()
        to[free] = solve(onto.T @ self.gram @ onto)
        return self.step(to)


class Problem:
    """Drives, vehicle, and the columns of terms on them."""

    def __init__(
        self, drives: Sequence[Drive], vehicle: Vehicle, memory: Mapping[str, float] | None = None
    ) -> None:
        both = all(drive.between is not None for drive in drives)
        self.drives = tuple(
            drive if both or drive.between is None else replace(drive, between=None)
            for drive in drives
        )
        self.vehicle = vehicle
        self.memory = dict(memory or {})
        mean_square = np.mean(np.concatenate([drive.power**2 for drive in self.drives]))
        self.floor = np.full(len(SCALES), FLOOR**2 * float(mean_square))
        gaps = [drive.between * drive.slides for drive in self.drives if drive.between is not None]
        if gaps:
            allowed = _SLIP_LAW**2 * float(np.mean(np.concatenate(gaps) ** 2))
            self.floor = np.append(self.floor, np.full(len(SCALES), allowed))

    def without_transitions(self) -> Problem:
        """Return the drives, each throughout in the state that it was in for longer."""
        drives = []
        for drive in self.drives:
            state = round(float(np.mean(drive.motion.channels["changed"])))
            drives.append(drive.with_channels(changed=np.full(len(drive.t), float(state))))
        return Problem(drives, self.vehicle, self.memory)

    def thinned(self, samples: int) -> Problem:
        """Return the drives with so many samples in a shortest window, where they have more."""
        period = max(drive.clock.period for drive in self.drives)
        step = int(SCALES[0] / (samples * period))
        few = [drive.thinned(step) for drive in self.drives] if step > 1 else self.drives
        return Problem(few, self.vehicle, self.memory)

    def averaged(self, period: float) -> Problem:
        """Return means of the drives over a period [s], where they have more samples."""
        drives = [drive.averaged(period) for drive in self.drives]
        return Problem(drives, self.vehicle, self.memory)

    def excerpt(self, samples: int, drives: int) -> Problem:
        """Return some drives, evenly chosen, and pieces of them where they have more samples."""
        some = list(self.drives)
        if len(some) > drives:
            some = [some[k] for k in np.linspace(0, len(some) - 1, drives).round().astype(int)]
        total = sum(len(drive.t) for drive in some)
        if total > samples:
            turns = ((_GOLDEN * np.arange(len(some))) % 1.0).tolist()
            share = samples / total
            some = [drive.pieces(share, turn) for drive, turn in zip(some, turns, strict=True)]
        elif len(some) == len(self.drives):
            return self
        return Problem(some, self.vehicle, self.memory)

    def starting_from(self, known: Mapping[str, float]) -> Problem:
        """Return the drives, for fits that begin with these coefficients, by name of their term."""
        return Problem(self.drives, self.vehicle, known)

    @cached_property
    def of_totals(self) -> Problem:
        """The drives with the power of both sides together alone."""
        if self.drives[0].equations == 1:
            return self
        drives = [replace(drive, between=None) for drive in self.drives]
        return Problem(drives, self.vehicle, self.memory)

    @property
    def as_predicted(self) -> Problem:
        """The totals of the drives as those to come are predicted: nothing known of contacts.

        What contacts hold is told by the power of a drive, which a prediction does not know.
        """
        drives = [replace(drive, between=None, fitted=False) for drive in self.drives]
        return Problem(drives, self.vehicle, self.memory)

    def delayed(self, late: Late) -> Problem:
        """Return the drives with their power taken to be logged late."""
        drives = [replace(drive, late=late) for drive in self.drives]
        return Problem(drives, self.vehicle, self.memory)

    def with_factors(self, factors: Sequence[float]) -> Problem:
        """Return the drives, each with a factor of its power."""
        drives = [replace(d, factor=f) for d, f in zip(self.drives, factors, strict=True)]
        return Problem(drives, self.vehicle, self.memory)

    def levelled(self, terms: Sequence[Term]) -> Problem:
        """Return the drives, each with the factor by which it differs as a whole.

        A random effect of each run, as far as it is more than the scatter within runs (Henderson's
        equations, the model and the factors in turn). Without it long runs decide what all share.
        """
        problem = self
        if len(self.drives) < _RUNS:
            return self
        for _ in range(_LEVELLING):
            design = problem.design(terms)
            values = fit(design, problem.reference(design)).values
            plain = self.design(terms)
            spread = RunSpread.of(plain, values)
            if spread is None:
                return self
            problem = self.with_factors(spread.factors)
        return problem

    def likelihood(self, errors: FloatArray, windows: FloatArray) -> FloatArray:
        """Return the logarithm of the likelihood of terms from their cross-validated errors."""
        count = evidence_of(windows)
        floor = (FINE * self.floor[: len(windows)]).reshape(-1, *[1] * (np.ndim(errors) - 1))
        fall = np.log(np.maximum(errors, 0.0) + floor + 1e-300)
        return np.asarray(-0.5 * np.tensordot(count, fall, axes=(0, 0)))

    def tables(self, terms: Sequence[Term], values: FloatArray) -> Tables:
        """Return, for each drive, the columns of the terms and the power they are to explain.

        Where a loss depends on the forces, and so on the other coefficients, both are linearised
        about `values`.
        """
        columns, targets, odds = [], [], 0.0
        for drive in self.drives:
            if is_lossy(drive, terms):
                about = linearise_drive(drive, self.vehicle, terms, values)
                columns.append(about.columns)
                targets.append(drive.measured - about.power + about.columns @ values)
                odds += about.odds
            else:
                found = np.stack([columns_of(t, drive, self.vehicle) for t in terms], axis=-1)
                columns.append(drive.observed(found))
                targets.append(drive.measured)
        return Tables(columns, targets, odds)

    def design_about(self, terms: Sequence[Term], values: FloatArray) -> Design:
        """Return the design of some terms, losses linearised about `values`."""
        about = self.tables(terms, values)
        return Design.of(self.drives, about.columns, about.targets)

    def odds(self, terms: Sequence[Term], values: FloatArray) -> float:
        """Return what it took from the likelihood that what contacts hold was not known.

        The sum, over stretches on which the total power told it, of the logarithm of the range of
        powers that was possible over the error that it is known to (docs/theory, section 6).
        """
        lossy = [drive for drive in self.drives if is_lossy(drive, terms)]
        return sum(linearise_drive(d, self.vehicle, terms, values, ()).odds for d in lossy)

    def design(
        self,
        terms: Sequence[Term],
        errors: FloatArray | None = None,
        start: Mapping[str, float] | None = None,
        rounds: int = ROUNDS,
    ) -> Design:
        """Return the design of some terms: Gauss-Newton where they are not linear.

        What losses take bends where a side begins to return power, or a stretch to be held, and
        multiplies the forces. A step that leads to nothing better is not undone at once: the other
        coefficients are found for the losses that it led to, once and again. Then the same is tried
        with shorter steps, as long as they promise something. What it takes from the likelihood
        that what contacts hold is not known counts: else a loss that leaves more of it open would
        seem to fit better.
        """
        if not any(is_lossy(drive, terms) for drive in self.drives):
            return self.design_about(terms, np.zeros(len(terms)))
        starts = self._starts(terms, errors) if start is None else [start]
        begun = [
            self._tried(terms, np.array([one.get(term.name, 0.0) for term in terms]), errors)
            for one in starts
        ]
        best = min(begun, key=lambda one: one.misfit)
        values, gain, instead = best.on, np.inf, _instead(best.promised)
        for _ in range(rounds - 1):
            if min(gain, best.promised) < _SETTLED and best.promised < _PROMISED:
                break
            if np.allclose(values, best.values, rtol=1e-4):
                break
            here = self._tried(terms, values, errors)
            if here.misfit < best.misfit:
                gain = best.misfit - here.misfit
                best, values, instead = here, here.on, _instead(here.promised)
            else:
                part = next(instead, 0.0)
                values = here.rest if part is None else best.values + part * (best.on - best.values)
        self.memory |= {t.name: float(v) for t, v in zip(terms, best.values, strict=True)}
        return replace(best.design, ended=best.values) if rounds > 1 else best.design

    def _tried(
        self, terms: Sequence[Term], values: FloatArray, errors: FloatArray | None
    ) -> _Tried:
        """Linearise losses about coefficients, and weigh these."""
        about = self.tables(terms, values)
        design = Design.of(self.drives, about.columns, about.targets)
        scale = np.ones(len(design.rows)) if errors is None else errors
        gram = weighted(design, scale).sum(axis=0)
        least = solve(gram)
        misfit, hoped = (
            self._misfit(design, gram, scale, each) + about.odds for each in (values, least)
        )
        drag = np.array([term in PAPER for term in terms])
        loss = np.array([term.kind == "loss" for term in terms])
        return _Tried(drag, loss, values, design, gram, misfit, least, hoped)

    def _misfit(
        self, design: Design, gram: FloatArray, scale: FloatArray, values: FloatArray
    ) -> float:
        """Return the negative logarithm of the likelihood of coefficients."""
        signed = np.append(values, -1.0)
        nothing = float(np.sum(FINE * self.floor[: len(scale)] / scale))
        loss = max(float(signed @ gram @ signed), 0.0) + nothing + 1e-300
        return 0.5 * float(evidence_of(design.evidence).sum()) * float(np.log(loss))

    def _starts(
        self, terms: Sequence[Term], errors: FloatArray | None
    ) -> list[Mapping[str, float]]:
        """Return coefficients to start from: found before, or of a fit without losses, too."""
        if {term.name for term in terms} <= set(self.memory):
            return [self.memory]
        plain = self._start(terms, errors)
        return [plain, self.memory] if self.memory else [plain]

    def _start(self, terms: Sequence[Term], errors: FloatArray | None) -> dict[str, float]:
        """Return coefficients of a fit without losses.

        What losses take looks like other terms, of any size: those that it makes impossible are
        left out.
        """
        linear = [term for term in terms if term.kind != "loss"]
        if len(linear) == len(terms):
            return {}
        while True:
            design = self.design(linear, errors, {})
            scale = np.ones(len(design.rows)) if errors is None else errors
            values = solve(weighted(design, scale).sum(axis=0))
            found = {term.name: float(v) for term, v in zip(linear, values, strict=True)}
            possible = [
                term for term in linear
                if term in PAPER or term.bounds[0] <= found[term.name] <= term.bounds[1]
            ]  # fmt: skip
            if len(possible) == len(linear):
                return found
            linear = possible

    def means(
        self, extra: Sequence[Term], terms: Sequence[Term] = (), values: FloatArray | None = None
    ) -> list[FloatArray]:
        """Return window means of the columns of further terms beside a model's."""
        columns = []
        for drive in self.drives:
            if values is not None and is_lossy(drive, terms):
                whole = np.append(values, np.zeros(len(extra)))
                wanted = range(len(terms), len(whole))
                about = linearise_drive(drive, self.vehicle, [*terms, *extra], whole, wanted)
                columns.append(about.columns)
            else:
                found = np.stack([columns_of(t, drive, self.vehicle) for t in extra], axis=-1)
                columns.append(drive.observed(found))
        return window_means(self.drives, columns)

    def reference(self, design: Design) -> FloatArray:
        """Return the cross-validated error of a design, plus the floor, at each scale [W^2]."""
        errors = np.full(len(design.rows), 1.0)
        for _ in range(2):
            errors = fit(design, errors).errors + self.floor
        return errors


def _instead(promised: float) -> Iterator[float | None]:
    """Yield what to try where a step has led to nothing better.

    That is such a part of the step, or, where there is no number, `_Tried.rest`. A step that
    promises much is made shorter and shorter.
    """
    part = _SHORTER
    yield from (None, None, part, None)
    while (part := _SHORTER * part) * promised > _PROMISED:
        yield from (part, None)
