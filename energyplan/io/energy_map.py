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
    """Write the energies of all places as an ESRI ASCII grid (``.asc``), in joules.

    Parameters
    ----------
    found : EnergyMap
        The energies.
    path : str or Path
        The file. It is replaced as a whole. -9999 stands for places out of reach.

    Raises
    ------
    MapError
        If the map is turned in the world, which such a file cannot say.

    Examples
    --------
    >>> import tempfile
    >>> from energyplan.path import Pose
    >>> start, energy = Pose(0.5, 0.5, 0.0), np.array([[0.0, 80.0, np.inf]])
    >>> found = EnergyMap(energy, 1.0, Pose(0.0, 0.0, 0.0), start, back=None, complete_to=np.inf)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_energies(found, Path(folder) / "reach.asc")
    ...     print((Path(folder) / "reach.asc").read_text().splitlines()[-1])
    ...
    0 80 -9999
    """
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
    """Return areas in reach as GeoJSON; each feature has its ``energy`` [J] and ``area`` [m^2].

    Parameters
    ----------
    areas : sequence of Contour
        The areas.

    Returns
    -------
    dict
        A FeatureCollection.

    Examples
    --------
    >>> area = Contour(5000.0, shapely.MultiPolygon([shapely.box(0, 0, 4, 3)]))
    >>> contours_document([area])["features"][0]["properties"]
    {'energy': 5000.0, 'area': 12.0}
    """
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
    """Write areas in reach to a GeoJSON file; see `contours_document`.

    Parameters
    ----------
    areas : sequence of Contour
        The areas.
    path : str or Path
        The file. It is replaced as a whole.

    Examples
    --------
    >>> import tempfile
    >>> area = Contour(5000.0, shapely.MultiPolygon([shapely.box(0, 0, 4, 3)]))
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_contours([area], Path(folder) / "reach.geojson")
    ...     document = json.loads((Path(folder) / "reach.geojson").read_text())
    ...
    >>> document["features"][0]["geometry"]["type"]
    'MultiPolygon'
    """
    atomic_write(Path(path), json.dumps(contours_document(areas), indent=1) + "\n")
