"""Interactive maps: obstacles as a picture beneath, surfaces as tinted areas (private)."""

from __future__ import annotations

import base64
import html
import io
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import shapely
from PIL import Image

from energyplan.output.interactive.parts import Plot, layout_of
from energyplan.output.plots import GREEN, ORANGE, PURPLE, RED, SKY, YELLOW
from energyplan.path import FloatArray, Pose

if TYPE_CHECKING:
    from shapely.geometry.base import BaseGeometry

    from energyplan.terrain import OccupancyGrid

_MOST_CELLS = 1600  # along the longer side of a map's picture


def map_plot(grid: OccupancyGrid, areas: Sequence[tuple[str, BaseGeometry]]) -> Plot:
    """Describe a map: its obstacles as a picture beneath, its surfaces as tinted areas."""
    rows, columns = grid.occupied.shape
    corners = grid.to_world([(0, 0), (columns, 0), (columns, rows), (0, rows)])
    low, high = corners.min(axis=0), corners.max(axis=0)
    layout = layout_of("x [m]", "y [m]")
    layout["xaxis"] |= {"range": [low[0], high[0]], "showgrid": False, "constrain": "domain"}
    layout["yaxis"] |= {
        "range": [low[1], high[1]], "showgrid": False, "scaleanchor": "x", "constrain": "domain",
    }  # fmt: skip
    layout["images"] = [
        {
            "source": _obstacles(grid, low, high), "xref": "x", "yref": "y", "x": low[0],
            "y": high[1], "sizex": high[0] - low[0], "sizey": high[1] - low[1],
            "sizing": "stretch", "layer": "below",
        }
    ]  # fmt: skip
    tints = (SKY, ORANGE, GREEN, PURPLE, YELLOW)
    names = list(dict.fromkeys(name for name, _ in areas))
    tint = {
        name: RED if name == "keep-out" else tints[k % len(tints)] for k, name in enumerate(names)
    }
    layout["shapes"] = [
        {
            "type": "path", "path": _outline(area), "fillcolor": tint[name], "opacity": 0.2,
            "line": {"width": 0}, "layer": "below", "fillrule": "evenodd",
        }
        for name, area in areas
    ]  # fmt: skip
    legend: list[Plot] = [
        {
            "x": [None], "y": [None], "mode": "markers", "name": html.escape(name),
            "marker": {"symbol": "square", "size": 12, "color": color, "opacity": 0.3},
        }
        for name, color in tint.items()
    ]  # fmt: skip
    return {"data": legend, "layout": layout}


def _outline(area: BaseGeometry) -> str:
    """Return the rings of an area as an SVG path."""
    rings = [
        shapely.get_coordinates(ring)
        for part in shapely.get_parts(area)
        for ring in (part.exterior, *part.interiors)
    ]
    return " ".join("M" + " L".join(f"{x:.9g},{y:.9g}" for x, y in ring) + " Z" for ring in rings)


def _obstacles(grid: OccupancyGrid, low: FloatArray, high: FloatArray) -> str:
    """Return a map's obstacles as a picture whose axes are the world's, however it is turned."""
    # Cells are merged, not left out, where there are too many: thin walls shall stay.
    k = -(-max(grid.occupied.shape) // _MOST_CELLS)
    rows, columns = (-(-n // k) for n in grid.occupied.shape)
    padded = np.zeros((rows * k, columns * k), bool)
    padded[: grid.occupied.shape[0], : grid.occupied.shape[1]] = grid.occupied
    coarse = np.any(padded.reshape(rows, k, columns, k), axis=(1, 3))
    width, height = np.maximum(np.rint((high - low) / (grid.resolution * k)), 1).astype(int)
    x = low[0] + (np.arange(width) + 0.5) * (high[0] - low[0]) / width
    y = high[1] - (np.arange(height) + 0.5) * (high[1] - low[1]) / height
    cells = grid.to_cells(np.stack(np.meshgrid(x, y), axis=-1)) / k
    column = np.floor(cells[..., 0]).astype(int)
    row = np.floor(cells[..., 1]).astype(int)
    inside = (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
    taken = np.zeros(inside.shape, bool)
    taken[inside] = coarse[row[inside], column[inside]]
    pixels = np.zeros((*taken.shape, 2), np.uint8)
    pixels[taken] = (64, 255)
    stream = io.BytesIO()
    Image.fromarray(pixels, "LA").save(stream, format="PNG")
    return "data:image/png;base64," + base64.b64encode(stream.getvalue()).decode("ascii")


def place(name: str, pose: Pose, symbol: str, color: str, where: str = "top center") -> Plot:
    """Describe a place with its name."""
    return {
        "x": [pose.x], "y": [pose.y], "mode": "markers+text", "text": [html.escape(name)],
        "textposition": where, "showlegend": False, "hoverinfo": "text", "cliponaxis": False,
        "textfont": {"size": 11},
        "marker": {
            "symbol": symbol, "color": color, "size": 12, "line": {"color": "white", "width": 1},
        },
    }  # fmt: skip
