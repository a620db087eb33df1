"""The energy of motions as a table, for planners in any language."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from energyplan.cost import EnergyCost
from energyplan.cost.speeds import CHEAPEST
from energyplan.errors import InvalidInputError
from energyplan.io.files import atomic_write
from energyplan.path import FloatArray

MOST = 4000
"""Largest number of directions of a table."""

PROBES = (0.25, 0.5, 0.75)
"""Where between two directions the error is measured."""

FASTEST = 50.0
"""Largest tread speed of a table, as of a profile [m/s]."""


@dataclass(frozen=True, eq=False)
class CostTable:
    """Energies by direction and speed."""

    angle: FloatArray  # (n,): directions, rising from -pi to pi [rad]
    speed: FloatArray  # (m,): speeds of the faster tread, rising [m/s]
    energy: FloatArray  # (n, m): energy per size of a motion [J/m]
    half_track: float  # the C of sizes and directions [m]
    error: float  # largest relative error between two neighbouring directions, as measured


def tabulate(
    cost: EnergyCost, speeds: Sequence[float] | None = None, tolerance: float = 1e-3
) -> CostTable:
    """Return the table of a cost, as fine as it must be."""
    if not tolerance > 0:
        raise InvalidInputError(f"tolerance is {tolerance}; give a positive number")
    cost.check_any_heading("a table of costs")
    wanted = [cost.tread_speed] if speeds is None else sorted(set(map(float, speeds)))
    if not wanted or any(v is not None and not 0 < v <= FASTEST for v in wanted):
        raise InvalidInputError(
            f"speeds are {wanted}; give one or more positive numbers, up to {FASTEST:g} [m/s]"
        )
    costs = [replace(cost, speed=v or CHEAPEST) for v in wanted]
    half = cost.half_track

    def energies(angle: FloatArray) -> FloatArray:
        x, y = np.cos(angle), np.sin(angle) / half
        return np.column_stack([one.segment_energy(x, y) for one in costs])

    angle = np.linspace(-np.pi, np.pi, 65)
    energy = energies(angle)
    while True:
        gap = np.diff(angle)
        error = np.zeros(len(gap))
        for share in PROBES:
            exact = energies(angle[:-1] + share * gap)
            read = (1 - share) * energy[:-1] + share * energy[1:]
            error = np.maximum(error, np.abs(read / exact - 1.0).max(axis=1))
        # entries ever closer to a jump do not make it smaller
        split = (error > tolerance) & (gap > 1e-5)
        if not split.any() or len(angle) + split.sum() > MOST:
            break
        between = angle[:-1][split] + 0.5 * gap[split]
        where = np.flatnonzero(split) + 1
        angle = np.insert(angle, where, between)
        energy = np.insert(energy, where, energies(between), axis=0)
    listed = np.array([0.0 if v is None else v for v in wanted])
    return CostTable(angle, listed, energy, half, float(error.max()))


def write_cost_table(table: CostTable, path: str | Path) -> None:
    """Write a table of cost."""
    names = ",".join(["angle", *(f"{speed:g}" for speed in table.speed.tolist())])
    rows = (
        ",".join(f"{value:.9g}" for value in (angle, *energies))
        for angle, energies in zip(table.angle.tolist(), table.energy.tolist(), strict=True)
    )
    head = f"# half_track {table.half_track!r}\n# error {table.error:.3g}\n{names}\n"
    atomic_write(Path(path), head + "\n".join(rows) + "\n")
