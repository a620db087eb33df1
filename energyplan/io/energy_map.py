"""Write maps of energy: ESRI ASCII grids, and contours as GeoJSON."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import shapely

from energyplan.errors import MapError
from energyplan.io.files import atomic_write
from energyplan.studies.energy_map import Contour, EnergyMap

NO_DATA = -9999
"""Stands for places that are out of reach."""


def write_energies(found: EnergyMap, path: str | Path) -> None:
    """Write the energies of all places as an ESRI ASCII grid (``.asc``), in joules."""
    if found.origin.yaw != 0.0:
        raise MapError(
            f"{path}: an ESRI ASCII grid lies along the axes, and this map is turned by "
            f"{np.degrees(found.origin.yaw):.4g} deg; write the contours instead"
        )
    rows, columns = found.energy.shape
    header = (
        f"ncols {columns}\nnrows {rows}\nxllcorner {found.origin.x!r}\n"
        f"yllcorner {found.origin.y!r}\ncellsize {found.resolution!r}\nNODATA_value {NO_DATA}\n"
    )
    lines = (
        " ".join(f"{value:.6g}" if np.isfinite(value) else str(NO_DATA) for value in row)
        for row in found.energy[::-1].tolist()
    )
    atomic_write(Path(path), header + "\n".join(lines) + "\n")


def contours_document(areas: Sequence[Contour]) -> dict[str, Any]:
    """Return areas in reach as GeoJSON; each feature has its ``energy`` [J] and ``area`` [m^2]."""
    features = [
        {
            "type": "Feature",
            "properties": {"energy": found.energy, "area": found.area.area},
            "geometry": shapely.geometry.mapping(found.area),
        }
        for found in areas
    ]
    return {"type": "FeatureCollection", "features": features}


def write_contours(areas: Sequence[Contour], path: str | Path) -> None:
    """Write areas in reach to a GeoJSON file; see `contours_document`."""
    atomic_write(Path(path), json.dumps(contours_document(areas), indent=1) + "\n")
