"""Control sets of state lattices, as Nav2's SmacPlannerLattice plans with them.

A primitive leads from the middle of a cell at one of the lattice's headings to the middle of
another cell at another heading: straight on, in an arc with a straight part before or after it, or
turning on the spot by one heading. The headings are those of cells of the grid, so that straight
primitives end in one. SmacPlannerLattice counts what it drives in cells, and multiplies it by
penalties; here they are those that come nearest to the energy.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from datetime import date
from pathlib import Path as File
from typing import Any, NamedTuple

import numpy as np
import yaml
from numpy.typing import NDArray

from energyplan.cost import EnergyCost
from energyplan.errors import InvalidInputError
from energyplan.io.files import atomic_write
from energyplan.path import FloatArray, Path, Pose, wrap_angle

TURNS = 3
"""Headings that a primitive turns by, at most."""

FARTHEST = 2.5
"""How far primitives end away, in turning radii and one cell."""


class Primitive(NamedTuple):
    """A motion from the middle of cell (0, 0)."""

    start: int  # number of the heading at its start
    end: int  # number of the heading at its end
    before: float  # length of the straight line before the arc [m]
    arc: float  # length of the arc [m]
    after: float  # length of the straight line after the arc [m]
    turn: float  # turn, positive to the left [rad]
    column: int  # column of the cell that it ends in
    row: int  # row of that cell

    @property
    def length(self) -> float:
        """Its length [m]; zero where it turns on the spot."""
        return self.before + self.arc + self.after

    @property
    def radius(self) -> float:
        """Radius of its arc [m]; zero where it has none."""
        return self.arc / abs(self.turn) if self.arc > 0 else 0.0

    @property
    def motions(self) -> FloatArray:
        """Arc lengths [m] and turns [rad] of its pieces, driven forwards, shape (n, 2)."""
        pieces = [(self.before, 0.0), (self.arc, self.turn), (self.after, 0.0)]
        return np.array([piece for piece in pieces if piece != (0.0, 0.0)])


@dataclass(frozen=True)
class ControlSet:
    """The primitives of a state lattice."""

    resolution: float  # size of a cell [m]
    radius: float  # smallest radius of arcs [m]
    headings: tuple[float, ...]  # the headings, ascending from 0 [rad]
    primitives: tuple[Primitive, ...]  # the primitives, by their first heading


class Penalties(NamedTuple):
    """Parameters of SmacPlannerLattice that say what a motion costs."""

    non_straight: float  # factor of primitives with an arc
    change: float  # what is added to it where the turning direction changes
    reverse: float  # factor of primitives driven backwards
    rotation: float  # cost of turning on the spot by one heading [cells]
    error: float


USUAL = Penalties(1.05, 0.0, 2.0, 5.0, np.nan)
"""What is set where nothing is known of a robot; that of a change of direction left out."""


DIGITS = 5
"""Digits of lengths in the file [m] after the point."""

MOST_HEADINGS = 512
"""Most headings of a lattice."""

MOST_CELLS = 1000
"""Most cells that a primitive may reach."""


def headings_of(count: int) -> tuple[FloatArray, tuple[tuple[int, int], ...]]:
    """Return the headings of a lattice [rad], and for each the cell that it leads to."""
    if count % 8 or not 8 <= count <= MOST_HEADINGS:
        raise InvalidInputError(
            f"a lattice of {count} headings; give a multiple of 8, up to {MOST_HEADINGS}"
        )
    half = count // 8
    around = range(-half, half + 1)
    rim = [(x, y) for x in around for y in around if max(abs(x), abs(y)) == half]
    rim.sort(key=lambda cell: np.arctan2(cell[1], cell[0]) % (2 * np.pi))
    cells = []
    for x, y in rim:
        common = int(np.gcd(x, y))
        cells.append((x // common, y // common))
    return np.array([np.arctan2(y, x) % (2 * np.pi) for x, y in rim]), tuple(cells)


def control_set(
    cost: EnergyCost, resolution: float, *, headings: int = 16, radius: float | None = None
) -> ControlSet:
    """Return a control set (Pivtoraiko and Kelly 2005): per turn the primitive of least energy."""
    cost.check_any_heading("a control set")
    least = cost.half_track if radius is None else radius
    if not (0 < resolution < np.inf and 0 < least < np.inf):
        raise InvalidInputError(
            f"a resolution of {resolution} m and a radius of {least} m; give lengths above 0"
        )
    angles, steps = headings_of(headings)
    if FARTHEST * least / resolution > MOST_CELLS:
        raise InvalidInputError(
            f"arcs of radius {least:g} m reach beyond {MOST_CELLS} cells of {resolution:g} m; give "
            "larger cells or a smaller radius"
        )
    reach = int(np.ceil(FARTHEST * least / resolution)) + 1
    row, column = np.indices((2 * reach + 1, 2 * reach + 1)).reshape(2, -1) - reach
    found = []
    for start, angle in enumerate(angles):
        x, y = steps[start]
        ahead = float(np.hypot(x, y)) * resolution
        found.append(Primitive(start, start, ahead, 0.0, 0.0, 0.0, x, y))
        for side in (-1, 1):
            for bins in range(1, TURNS + 1):
                end = (start + side * bins) % headings
                turn = float(wrap_angle(angles[end] - angle))
                if bins == 1:
                    found.append(Primitive(start, end, 0.0, 0.0, 0.0, turn, 0, 0))
                arc = _least_arc(cost, resolution, least, (start, end), angles, column, row)
                if arc is not None:
                    found.append(arc)
    if not any(primitive.arc > 0 for primitive in found):
        raise InvalidInputError(
            f"no arc of {least:g} m fits between cells of {resolution:g} m; choose smaller cells"
        )
    found.sort(key=lambda p: (p.start, p.end, p.length))
    return ControlSet(float(resolution), float(least), tuple(angles.tolist()), tuple(found))


def _least_arc(
    cost: EnergyCost,
    resolution: float,
    radius: float,
    ends: tuple[int, int],
    angles: FloatArray,
    column: NDArray[np.intp],
    row: NDArray[np.intp],
) -> Primitive | None:
    """Return the primitive of least energy between two headings, if there is one."""
    a, b = angles[ends[0]], angles[ends[1]]
    turn = float(wrap_angle(b - a))
    if abs(turn) > 0.75 * np.pi:
        return None
    # the tangents at both ends meet so far from either
    det = np.sin(b - a)
    x, y = column * resolution, row * resolution
    first = (x * np.sin(b) - y * np.cos(b)) / det
    then = (y * np.cos(a) - x * np.sin(a)) / det
    tangent = np.minimum(first, then)
    wide = tangent / np.tan(0.5 * abs(turn))
    fits = np.flatnonzero(wide >= radius * (1 - 1e-9))
    if len(fits) == 0:
        return None
    arc = wide * abs(turn)
    straight = np.maximum(first - tangent, 0.0) + np.maximum(then - tangent, 0.0)
    energy = cost.segment_energy(arc[fits], turn) + cost.segment_energy(straight[fits], 0.0)
    k = int(fits[np.lexsort((row[fits], column[fits], np.round(energy, 9)))[0]])
    before, after = (
        0.0 if rest < 1e-9 * resolution else float(rest)
        for rest in (first[k] - tangent[k], then[k] - tangent[k])
    )
    return Primitive(*ends, before, float(arc[k]), after, turn, int(column[k]), int(row[k]))


def primitive_energy(cost: EnergyCost, primitive: Primitive, gear: int = 1) -> float:
    """Return what a primitive takes [J], driven forwards (1) or backwards (-1)."""
    ds, turn = primitive.motions.T
    return float(np.sum(cost.segment_energy(gear * ds, turn)))


def penalties(controls: ControlSet, cost: EnergyCost) -> Penalties:
    """Return the penalties whose costs come nearest to the energy of the primitives."""
    unit = float(cost.segment_energy(1.0, 0.0)) * controls.resolution
    cells = np.array([p.length for p in controls.primitives]) / controls.resolution
    there, back = (
        np.array([primitive_energy(cost, p, gear) for p in controls.primitives]) / unit
        for gear in (1, -1)
    )
    moves = cells > 0
    arcs = np.array([p.arc > 0 for p in controls.primitives])
    curved = max(float(cells[arcs] @ there[arcs] / (cells[arcs] @ cells[arcs])), 1.0)
    ahead = cells * np.where(arcs, curved, 1.0)
    reverse = max(float(ahead[moves] @ back[moves] / (ahead[moves] @ ahead[moves])), 1.0)
    rotation = float(there[~moves].mean())
    predicted = np.concatenate([np.where(moves, ahead, rotation), reverse * ahead[moves]])
    true = np.concatenate([there, back[moves]])
    error = float(np.sqrt(np.mean((predicted / true - 1.0) ** 2)))
    return Penalties(curved, 0.0, reverse, rotation, error)


def write_lattice(controls: ControlSet, file: str | File, *, made: date | None = None) -> None:
    """Write a control set for SmacPlannerLattice (its parameter ``lattice_filepath``)."""
    document = {
        "version": 1.0,
        "date_generated": (date.today() if made is None else made).isoformat(),
        "lattice_metadata": {
            "motion_model": "diff",
            "turning_radius": controls.radius,
            "grid_resolution": controls.resolution,
            "stopping_threshold": 0,
            "num_of_headings": len(controls.headings),
            "heading_angles": list(controls.headings),
            "number_of_trajectories": len(controls.primitives),
        },
        "primitives": [
            _written(k, primitive, controls) for k, primitive in enumerate(controls.primitives)
        ],
    }
    atomic_write(File(file), json.dumps(document, indent=1) + "\n")


def _written(number: int, primitive: Primitive, controls: ControlSet) -> dict[str, Any]:
    """Return a primitive as it stands in the file."""
    start = controls.headings[primitive.start]
    ds, turn = primitive.motions.T
    path = Path(Pose(0.0, 0.0, start), ds, turn)
    fine = path.subdivide(controls.resolution, 0.2)
    poses = fine.vertices[1:] if primitive.length > 0 else fine.vertices
    poses[-1] = (
        primitive.column * controls.resolution,
        primitive.row * controls.resolution,
        controls.headings[primitive.end],
    )
    rounded = [
        [round(x, DIGITS) + 0.0, round(y, DIGITS) + 0.0, yaw % (2 * np.pi)]
        for x, y, yaw in poses.tolist()
    ]
    return {
        "trajectory_id": number,
        "start_angle_index": primitive.start,
        "end_angle_index": primitive.end,
        "left_turn": primitive.turn >= 0,
        "trajectory_radius": round(primitive.radius, DIGITS),
        "trajectory_length": round(primitive.length, DIGITS),
        "arc_length": round(primitive.arc, DIGITS),
        "straight_length": round(primitive.before + primitive.after, DIGITS),
        "poses": rounded,
    }


def write_penalties(penalties: Penalties, file: str | File, lattice: str | File) -> None:
    """Write the penalties as parameters of SmacPlannerLattice (YAML)."""
    parameters = {
        "plugin": "nav2_smac_planner::SmacPlannerLattice",
        "lattice_filepath": str(lattice),
        "allow_reverse_expansion": True,
        "non_straight_penalty": round(penalties.non_straight, 4),
        "change_penalty": round(penalties.change, 4),
        "reverse_penalty": round(penalties.reverse, 4),
        "rotation_penalty": round(penalties.rotation, 4),
        "retrospective_penalty": 0.0,
    }
    atomic_write(File(file), yaml.safe_dump({"GridBased": parameters}, sort_keys=False))
