"""How well one effect stands in for another that a catalogue lacks (private).

Where more than noise is left of drives, something is missing, and what was named may only stand in
for it: of many effects one is always like it. How like, these drives tell: each effect of the
catalogue, taken out, is followed by the best of the others to some degree. A cause that the
catalogue lacks is taken to be followed as they are.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from energyplan.diagnosis.explanations import Evaluated, Found
from energyplan.diagnosis.part import Part
from energyplan.diagnosis.proposals import Candidate
from energyplan.diagnosis.residual import Dependence
from energyplan.fit.adequacy import Adequacy
from energyplan.fit.drives.design import Design
from energyplan.fit.least_squares import WEIGHTS, weighted
from energyplan.fit.problem import PAPER
from energyplan.path import FloatArray

_ALMOST = 1e-9  # share of a column's square that the model's own columns leave of it, and is none


def followed(
    gram: FloatArray, base: Sequence[int], groups: Mapping[str, Sequence[tuple[int, ...]]]
) -> FloatArray:
    """Return how well each effect is followed by the best other one."""
    own = list(base)
    size = np.diagonal(gram)
    scale = 1.0 / np.sqrt(np.maximum(size, 1e-300))
    unit = gram * np.outer(scale, scale)
    left = (
        unit
        - unit[:, own] @ np.linalg.pinv(unit[np.ix_(own, own)], 1e-9, hermitian=True) @ unit[own]
    )
    square = np.diagonal(left)
    shown = square > _ALMOST
    best: dict[str, FloatArray] = {}
    for name, variants in groups.items():
        most = np.zeros(len(left))
        for columns in variants:
            some = [k for k in columns if shown[k]]
            if some:
                cross = left[:, some]
                inner = np.linalg.pinv(left[np.ix_(some, some)], 1e-9, hermitian=True)
                most = np.maximum(most, np.einsum("ki,ij,kj->k", cross, inner, cross))
        best[name] = most
    shares = []
    for name, variants in groups.items():
        others = [best[other] for other in groups if other != name]
        mine = [k for columns in variants for k in columns if shown[k]]
        if others and mine:
            most = np.max(others, axis=0)[mine] / square[mine]
            shares.append(float(np.median(np.clip(most, 0.0, 1.0))))
    return np.sort(np.array(shares))


def followed_in(design: Design, candidates: Sequence[Candidate], best: Evaluated) -> FloatArray:
    """Return how well each effect is followed by the best other one in drives."""
    base, groups = [*range(len(PAPER))], dict[str, list[tuple[int, ...]]]()
    usual = {part.effect.name for part in best.parts if part.effect.usual}
    for one in candidates:
        if one.name in usual:
            base.extend(one.columns)
        else:
            groups.setdefault(one.name, []).append(one.columns)
    return followed(weighted(design, best.errors).sum(axis=0)[:-1, :-1], base, groups)


def chance_to_stand_in(share: float, known: FloatArray) -> float:
    """Return the chance that a cause the catalogue lacks is followed as well as this, or better."""
    at = np.concatenate([[0.0], known, [1.0]])
    return float(np.interp(share, at, np.linspace(1.0, 0.0, len(at))))


@dataclass(frozen=True)
class Presence:
    """Whether what was named is there, or stands in for what the catalogue lacks."""

    chances: Mapping[str, float]  # of each effect, that it is there
    stranger: float  # that behind a name, or behind none, is something that the catalogue lacks

    def of(self, name: str) -> float:
        """Return the chance that an effect is there."""
        return self.chances.get(name, 1.0)


def presence(
    searched: Found,
    parts: Sequence[Part],
    quality: Adequacy,
    left: Sequence[Dependence],
    otherwise: bool,
) -> Presence:
    """Return the chances that effects are there, and do not stand in for what is missing.

    Where more than noise is left, a name is as probable as few effects of the catalogue, were they
    not known, would be followed as well by another. What lasts counts for more, as in the
    likelihood of explanations.
    """
    depends = max((one.explained_variance for one in left if one.channel != "drive"), default=0.0)
    if (quality.adequate and depends == 0.0) or not len(searched.followed):
        return Presence({}, 0.0)
    missing = np.maximum(quality.missing, depends * quality.slow_residual**2)
    chances, named = dict[str, float](), list[float]()
    for part, gain in zip(searched.best.parts, searched.best.gains, strict=True):
        if part not in parts:
            continue
        falls = np.maximum(gain.falls, 0.0)
        share = float(WEIGHTS @ (falls / np.maximum(falls + missing, 1e-300)))
        if not part.effect.usual:
            chances[part.effect.name] = 1.0 - chance_to_stand_in(share, searched.followed)
            named.append(chances[part.effect.name])
    return Presence(chances, 1.0 - min(named, default=1.0 if otherwise else 0.0))
