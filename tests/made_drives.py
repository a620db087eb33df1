"""What several tests make of robots: their sizes, and drives to learn from and to judge by."""

from __future__ import annotations

from typing import Any

from energyplan import DriveLog, PowerModel, Vehicle, simulate


def sized(size: float, mass: float | None = None) -> Vehicle:
    """Return a robot so many times as large as one of 60 kg, and as heavy as that makes it."""
    return Vehicle.from_geometry(
        "any", mass=60.0 * size**3 if mass is None else mass, wheelbase=0.5 * size,
        track=0.55 * size, length=0.9 * size, width=0.7 * size,
    )  # fmt: skip


def pair(
    model: PowerModel, seed: int = 1, unseen: int | None = None, **options: Any
) -> tuple[DriveLog, DriveLog]:
    """Return a drive to learn from, and another, of the next seed unless told, to judge by."""
    other = seed + 1 if unseen is None else unseen
    return (
        simulate.identification_drive(model, seed=seed, **options),
        simulate.validation_drive(model, seed=other, **options),
    )
