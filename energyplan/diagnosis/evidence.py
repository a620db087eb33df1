"""What a residual counts as evidence, and which explanations drives cannot tell apart (private)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from energyplan.fit.covariance import innovation_share
from energyplan.fit.drives.design import Design
from energyplan.fit.least_squares import Fit, weighted
from energyplan.path import FloatArray

Likelihood = Callable[[FloatArray, FloatArray], float]

_TOLD = 3.0
"""Logarithm of the odds, some 20 to 1, that drives must be expected to give to tell two apart."""


def residuals(design: Design, values: FloatArray) -> list[FloatArray]:
    """Return what coefficients leave of each window, at each scale [W]."""
    return [table[:, -1] - table[:, :-1] @ values for table in design.rows]


def innovations(design: Design, left: Sequence[FloatArray]) -> FloatArray:
    """Return the share of a residual that its own past does not foretell, at each scale."""
    shares = []
    for table, block, residual in zip(design.rows, design.blocks, left, strict=True):
        kept = np.any(table != 0.0, axis=1)
        owner = design.drives[block[kept]]
        edges = np.concatenate([[0], np.flatnonzero(np.diff(owner)) + 1, [len(owner)]])
        pieces = [slice(a, b) for a, b in pairwise(edges.tolist())]
        shares.append(innovation_share(residual[kept], pieces) if len(owner) else 1.0)
    return np.array(shares)


@dataclass(frozen=True)
class Account:
    """An explanation as it accounts for the drives."""

    design: Design  # its columns about its coefficients
    fit: Fit  # the coefficients
    errors: FloatArray  # (scales,): reference mean square errors, by which scales weigh [W^2]

    def told_from(self, other: Account, likelihood: Likelihood) -> bool:
        """Tell whether drives like these would tell the other explanation apart, were this true.

        The other is fitted to what this one predicts; what it cannot follow would be left in its
        residual, on top of what is left in this one's.
        """
        own = residuals(self.design, self.fit.values)
        gaps = [b - a for a, b in zip(own, residuals(other.design, other.fit.values), strict=True)]
        rows = tuple(
            np.column_stack([table[:, :-1], gap])
            for table, gap in zip(other.design.rows, gaps, strict=True)
        )
        gram = weighted(Design(rows, other.design.blocks, other.design.drives), self.errors)
        normal = gram.sum(axis=0)
        follows = np.linalg.lstsq(normal[:-1, :-1], normal[:-1, -1], rcond=1e-12)[0]
        left = [gap - row[:, :-1] @ follows for gap, row in zip(gaps, rows, strict=True)]
        counts = self.design.counts
        more = np.array([float(np.sum(part**2)) for part in left]) / counts
        plain = self.fit.errors * innovations(self.design, own)
        both = [a + b for a, b in zip(own, left, strict=True)]
        worse = (self.fit.errors + more) * innovations(self.design, both)
        windows = self.design.evidence
        return likelihood(plain, windows) - likelihood(worse, windows) > _TOLD


def classes(accounts: Sequence[Account], likelihood: Likelihood) -> list[int]:
    """Give explanations that the drives cannot tell apart the same number."""
    heads: list[int] = []
    found: list[int] = []
    for k, one in enumerate(accounts):
        for head in heads:
            first = accounts[head]
            if len(first.design.rows) != len(one.design.rows):
                continue
            if not (first.told_from(one, likelihood) and one.told_from(first, likelihood)):
                found.append(head)
                break
        else:
            heads.append(k)
            found.append(k)
    return found
