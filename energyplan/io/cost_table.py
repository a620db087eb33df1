"""Write tables of cost as CSV, for planners in any language."""

from __future__ import annotations

from pathlib import Path

from energyplan.cost.table import CostTable
from energyplan.io.files import atomic_write


def write_cost_table(table: CostTable, path: str | Path) -> None:
    """Write a table of cost.

    The first two lines are comments with the half-track [m] and the error; then come a line of
    column names, ``angle`` and the speeds [m/s], and one line for each direction.
    """
    names = ",".join(["angle", *(f"{speed:g}" for speed in table.speed.tolist())])
    rows = (
        ",".join(f"{value:.9g}" for value in (angle, *energies))
        for angle, energies in zip(table.angle.tolist(), table.energy.tolist(), strict=True)
    )
    head = f"# half_track {table.half_track!r}\n# error {table.error:.3g}\n{names}\n"
    atomic_write(Path(path), head + "\n".join(rows) + "\n")
