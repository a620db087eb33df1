"""The ground: occupancy grids with footprint collision, surfaces and heights."""

from __future__ import annotations

from energyplan.terrain.grid import OccupancyGrid, footprint
from energyplan.terrain.heights import HeightMap, Piece, with_weights
from energyplan.terrain.surfaces import Surface, SurfaceMap

__all__ = [
    "HeightMap",
    "OccupancyGrid",
    "Piece",
    "Surface",
    "SurfaceMap",
    "footprint",
    "with_weights",
]
