"""Rows of the tables that pages make from the library."""

from __future__ import annotations

from typing import Any

import energyplan as ep
from energyplan.mission import Spreads
from energyplan.power.effects import catalogue
from energyplan.records import bounds
from energyplan.terrain import SpeedLimit

OWNERS: dict[str, list[Any]] = {
    "vehicle": [ep.Vehicle.from_geometry, ep.Vehicle],
    "vehicle: motor": [ep.MotorLimits],
    "vehicle: icr": [ep.TreadICR],
    "battery": [ep.Battery],
    "mission": [ep.Mission],
    "mission: tasks": [ep.Task],
    "mission: chargers": [ep.Charger],
    "mission: spreads": [Spreads],
    "surfaces": [SpeedLimit],
}
"""Files, and what holds their numbers."""


def number_rows() -> list[list[str]]:
    """Return file, key, possible range and usual range of each number of a file."""
    return [
        [file, name, one.range(one.possible), one.range(one.typical)]
        for file, owners in OWNERS.items()
        for owner in owners
        for name, one in bounds(owner).items()
    ]


def effect_rows() -> list[list[str]]:
    """Return name, size, range, shares of the mass and values tried of each effect."""
    rows = []
    for name, entry in catalogue().items():
        tried = [
            f"{key}: {', '.join(f'{value:g}' for value in values)}"
            for key, values in entry.grid.items()
        ]
        shares = "" if entry.of_mass is None else "{:g} to {:g}".format(*entry.of_mass)
        low, high = (f"{limit:g}" for limit in entry.plausible)
        rows.append([name, f"{entry.symbol} [{entry.unit}]", low, high, shares, "; ".join(tried)])
    return rows
