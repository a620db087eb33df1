"""Sloping ground made ready for the kernels: how steep it is, and what height is worth.

Down a slope a motion may cost less than nothing, which no search can use. So every price is taken
less ``potential`` times the rise, and the difference of height between start and goal is paid once,
whichever way leads there. Which potential leaves every price positive, the prices tell.
"""

from __future__ import annotations

from collections.abc import Hashable
from typing import NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from energyplan.cost import EnergyCost
from energyplan.errors import InvalidInputError, MapError, ModelError
from energyplan.path import FloatArray
from energyplan.planning.problem import objective_weights
from energyplan.planning.scene.prices import Prices
from energyplan.power.effects import reads_slope
from energyplan.terrain import HeightMap, OccupancyGrid, SurfaceMap
from energyplan.terrain.frame import from_raster

BINS = 65
"""Slopes in the price tables of the kernels; odd, so that level ground is one of them."""

FINER = 4
"""Slopes between two of these at which the price of height is sought as well."""

FLAT = 1e-9
"""Slopes below this are none."""


_known: WeakKeyDictionary[OccupancyGrid, tuple[HeightMap, float, float]] = WeakKeyDictionary()


def steepest(grid: OccupancyGrid, heights: HeightMap, radius: float) -> float:
    """Return the steepest slope that the robot can be on, as rise over run."""
    known = _known.get(grid)
    if known is None or known[0] is not heights or known[1] != radius:
        known = heights, radius, _steepest(grid, heights, radius)
        _known[grid] = known
    return known[2]


def _steepest(grid: OccupancyGrid, heights: HeightMap, radius: float) -> float:
    from scipy.ndimage import maximum_filter  # slow to import, and rarely needed

    cells = radius / grid.resolution
    # the clearance is that of a cell's centre, off by 0.71 cells from that of a point in it
    may_be = grid.clearance > max(radius - grid.resolution, 0.0)
    if not may_be.any():
        return 0.0
    _check_covered(grid, heights, may_be, cells)
    patch = heights.resolution / grid.resolution
    reach = int(np.ceil(0.71 * patch + 1.0))
    near = maximum_filter(may_be.view(np.uint8), size=2 * reach + 1, mode="constant")
    nodes = heights.heights.shape
    i, j = np.indices((nodes[0] - 1, nodes[1] - 1))
    middle = np.stack([j + 0.5, i + 0.5], axis=-1)
    place = grid.to_cells(from_raster(middle, heights.origin, heights.resolution))
    rows, columns = grid.shape
    beyond = np.any((place < -reach) | (place > np.array([columns, rows]) + reach), axis=-1)
    column = np.clip(place[..., 0].astype(int), 0, columns - 1)
    row = np.clip(place[..., 1].astype(int), 0, rows - 1)
    relevant = (near[row, column] > 0) & ~beyond
    h = heights.heights
    # the gradient of a bilinear patch is greatest in one of its corners
    along = np.maximum(np.abs(np.diff(h, axis=1))[:-1], np.abs(np.diff(h, axis=1))[1:])
    across = np.maximum(np.abs(np.diff(h, axis=0))[:, :-1], np.abs(np.diff(h, axis=0))[:, 1:])
    steep = np.hypot(along, across)[relevant]
    return float(steep.max(initial=0.0)) / heights.resolution


def _check_covered(
    grid: OccupancyGrid, heights: HeightMap, may_be: NDArray[np.bool_], cells: float
) -> None:
    """Check that the rectangle in which the robot can be lies on the raster."""
    ends = []
    for axis in (1, 0):
        used = np.flatnonzero(may_be.any(axis=1 - axis))
        last = may_be.shape[axis]
        ends.append((max(float(used[0]), cells), min(float(used[-1] + 1), last - cells)))
    (x0, x1), (y0, y1) = ends
    corners = grid.to_world([(x0, y0), (x1, y0), (x1, y1), (x0, y1)])
    for corner in corners:
        try:
            heights.height(corner)
        except MapError as error:
            raise MapError(f"the heights do not cover the map: {error}") from None


def check_models(costs: tuple[EnergyCost, ...], surfaces: SurfaceMap | None) -> None:
    """Check that every power model knows what a slope is."""
    names = [
        "the ground",
        *(f"surface {s.name!r}" for s in (surfaces.surfaces if surfaces else ())),
    ]
    for name, cost in zip(names, costs, strict=True):
        if not reads_slope(cost.model):
            raise InvalidInputError(
                f"heights are given, but no term of the model {cost.model.name!r} of {name} reads "
                "the slope; add the weight with energyplan.power.effects.with_weight(model), or in "
                f"its file as the term grade with the coefficient {cost.vehicle.mass:.4g} kg"
            )


class Priced(NamedTuple):
    """Prices less what the rise is worth; the rows are classes of surface and slopes."""

    kept: FloatArray  # (classes * BINS, rays): what the kernels interpolate
    worth: float  # the price of height that was taken off


_tables: WeakKeyDictionary[EnergyCost, dict[Hashable, tuple[SurfaceMap | None, Priced]]] = (
    WeakKeyDictionary()
)
"""Tables by cost; the surfaces stay with them, so that no others take their identity."""

_REMEMBERED = 16
"""How many tables are kept for a cost."""


def priced(
    objective: Prices, ds: FloatArray, dtheta: FloatArray, travel: FloatArray, steepest: float
) -> Priced:
    """Return the prices of motions on slopes up to the steepest; they are remembered by cost."""
    weights = objective_weights(objective.objective)
    key = steepest, tuple(sorted(weights.items())), id(objective.surfaces)
    kept = _tables.setdefault(objective.cost, {})
    known = kept.get(key)
    if known is None:
        if len(kept) >= _REMEMBERED:
            kept.clear()
        known = objective.surfaces, _priced(objective, ds, dtheta, travel, steepest)
        kept[key] = known
    return known[1]


def _priced(
    objective: Prices, ds: FloatArray, dtheta: FloatArray, travel: FloatArray, steepest: float
) -> Priced:
    steep = np.linspace(-steepest, steepest, (BINS - 1) * FINER + 1)[:, None]
    fine = np.array([objective.motion(ds, dtheta, k, steep) for k in range(len(objective.costs))])
    rise = np.broadcast_to(steep * ds, fine.shape)
    worth = potential(fine, np.broadcast_to(travel, fine.shape), rise)
    fine = fine - worth * rise
    kept = np.ascontiguousarray(fine[:, ::FINER])
    return Priced(kept.reshape(-1, len(ds)), worth)


def potential(prices: FloatArray, travel: FloatArray, rise: FloatArray) -> float:
    """Return the price of height that leaves motions the highest price per metre.

    Among all ``p``, the one with the greatest ``t`` such that ``prices - p rise >= t travel``: a
    linear programme in two variables. The lower envelope of the lines ``(prices - p rise)/travel``
    over ``p`` is concave; two lines that enclose its top are replaced by better ones until they
    meet on it.
    """
    moves = travel > FLAT
    level, fall = (prices[moves] / travel[moves], -rise[moves] / travel[moves])
    descent, climb = int(np.argmax(fall)), int(np.argmin(fall))
    if fall[descent] <= FLAT or fall[climb] >= -FLAT:
        return 0.0
    rounding = 1e-12 * float(np.abs(level).max())
    while True:
        found = (level[climb] - level[descent]) / (fall[descent] - fall[climb])
        values = level + found * fall
        k = int(np.argmin(values))
        if values[k] >= values[climb] - rounding or abs(fall[k]) <= FLAT:
            break
        descent, climb = (k, climb) if fall[k] > 0 else (descent, k)
    if values[k] <= rounding:
        raise ModelError(
            f"climbing {_degrees(-fall[climb]):.1f} deg and descending "
            f"{_degrees(fall[descent]):.1f} deg again returns as much as it takes or more, so that "
            "a robot could drive for ever; check the efficiencies, and that the models of all "
            "surfaces hold the same weight"
        )
    return float(found)


def _degrees(steep: float) -> float:
    return float(np.degrees(np.arctan(steep)))
