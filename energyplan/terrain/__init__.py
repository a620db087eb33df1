"""The ground: occupancy grids with footprint collision, surfaces and heights."""

from __future__ import annotations

from energyplan.power.effects import knows_ground
from energyplan.terrain.grid import CostMap, OccupancyGrid, footprint
from energyplan.terrain.heights import HeightMap
from energyplan.terrain.surfaces import SpeedLimit, Surface, SurfaceMap, with_limits, with_weights
from energyplan.terrain.terrain import (
    CLEARANCE,
    LaidGround,
    PathPrice,
    Piece,
    Site,
    Terrain,
    laid_out,
    on_laid_ground,
    path_pieces,
    path_price,
)

__all__ = [
    "CLEARANCE", "CostMap", "HeightMap", "LaidGround", "OccupancyGrid", "PathPrice", "Piece",
    "Site", "SpeedLimit", "Surface", "SurfaceMap", "Terrain", "footprint", "knows_ground",
    "laid_out", "on_laid_ground", "path_pieces", "path_price", "with_limits", "with_weights",
]  # fmt: skip
