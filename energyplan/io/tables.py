"""Tables: paths, trajectories, drive logs, costs of motion, and energies by place."""

from __future__ import annotations

import gzip
import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path as File
from typing import Any

import numpy as np
import shapely
from numpy.typing import ArrayLike

from energyplan.cost import EnergyCost
from energyplan.errors import InvalidInputError, MapError, MissingDependencyError, PathError
from energyplan.io.files import atomic_write
from energyplan.logs import DriveLog
from energyplan.logs.guess import guess
from energyplan.logs.tables import Table, read_table
from energyplan.path import FloatArray, Path, Trajectory, wrap_angle
from energyplan.studies.energy_map import Contour, EnergyMap

_LIMITS = {"x": 1e8, "y": 1e8, "yaw": 1e5, "t": 1e11, "v": 100.0, "omega": 100.0}
_PATH = ("x", "y", "yaw")
_TRAJECTORY = ("t", *_PATH, "v", "omega")
_LOGGED = {"v_left", "v_right", "p_left", "p_right", "power", "voltage", "current"}
_LONGEST = 1e6  # longest path that is read [m]
_FIRST = ("t", "v_left", "v_right", "p_left", "p_right", "power", "voltage", "current")


def read_path(file: str | File, longitudinal: float = 0.0) -> Path:
    r"""Read a path from a table with the columns ``x``, ``y``, ``yaw``."""
    table = read_table(file, PathError)
    _check_kind(table, _PATH)
    poses = np.column_stack([_complete(table, name) for name in _PATH])
    if len(poses) < 2:
        raise PathError(f"{table.source} holds {len(poses)} poses; a path needs two or more")
    try:
        path = Path.from_poses(poses, longitudinal)
    except PathError as problem:
        raise PathError(f"{table.source} (pose 0 is {table.place(0)}): {problem}") from None
    if path.length > _LONGEST:
        raise PathError(
            f"{table.source} is {path.length:g} m long, beyond {_LONGEST:g} m; check the unit (m)"
        )
    return path


def write_path(
    path: Path, file: str | File, *, max_ds: float = 0.05, max_dtheta: float = 0.05
) -> File:
    """Write a path as a table with the columns ``x``, ``y``, ``yaw``."""
    poses = path.poses(max_ds, max_dtheta)
    return _write(file, dict(zip(_PATH, poses.T, strict=True)))


def read_trajectory(file: str | File) -> Trajectory:
    r"""Read a trajectory: a table of ``t``, ``x``, ``y``, ``yaw``, ``v``, ``omega``."""
    table = read_table(file, PathError)
    _check_kind(table, _TRAJECTORY)
    t, x, y, yaw, v, omega = (_complete(table, name) for name in _TRAJECTORY)
    if len(t) < 2:
        raise PathError(f"{table.source} holds {len(t)} samples; a trajectory needs two or more")
    back = np.flatnonzero(np.diff(t) <= 0)
    if len(back):
        k = int(back[0])
        raise PathError(
            f"{table.source}, {table.place(k + 1)}: t does not increase: {t[k + 1]:g} s follows "
            f"{t[k]:g} s; sort the rows and drop repeated ones"
        )
    step = np.diff(t)
    turn = 0.5 * step * (omega[1:] + omega[:-1])
    way = 0.5 * step * (v[1:] + v[:-1]) * np.sinc(turn / (2 * np.pi))
    _agree(table, "yaw", wrap_angle(np.diff(yaw)), "omega", wrap_angle(turn), "rad")
    _agree(table, "x, y", np.hypot(np.diff(x), np.diff(y)), "v", np.abs(way), "m")
    return Trajectory(t, x, y, np.unwrap(yaw), v, omega)


def read_drive(file: str | File, longitudinal: float = 0.0) -> Trajectory | Path:
    r"""Read a trajectory, or a path where the table has no times."""
    table = read_table(file, PathError)
    if {"t", "v", "omega"} & (set(table.columns) | set(table.text)):
        return read_trajectory(file)
    return read_path(file, longitudinal)


def _check_kind(table: Table, needed: Sequence[str]) -> None:
    """Refuse a table without some columns, and say what it looks like instead."""
    names = [*table.columns, *table.text]
    missing = [name for name in needed if name not in names]
    if not missing:
        return
    found = guess(names)
    logged = [one.field for channel, one in found.items() if channel in _LOGGED]
    what = (
        f"{table.source} has no column {', '.join(map(repr, missing))}; a path has "
        f"{','.join(_PATH)}, a trajectory {','.join(_TRAJECTORY)}"
    )
    if logged:
        raise PathError(
            f"{what}. It looks like a drive log, with {', '.join(logged[:3])}: energyplan identify "
            "and energyplan diagnose read logs"
        )
    more = ", ".join(name for name in _TRAJECTORY if name in names and name not in _PATH)
    timed = f"; leave {more} out to have the poses timed" if set(_PATH) <= set(names) else ""
    if timed and not more:
        timed = "; energyplan check and plan --former read a path, plan --trajectory times one"
    raise PathError(f"{what}; the columns are {', '.join(names[:20])}{timed}")


def _complete(table: Table, name: str) -> FloatArray:
    """Return a column without holes or absurd values."""
    values = table.column(name)
    hole = np.flatnonzero(~np.isfinite(values))
    if len(hole):
        raise PathError(
            f"{table.source}, {table.place(int(hole[0]))}: {name} is empty or not finite; fill it "
            "in or drop the row"
        )
    far = np.flatnonzero(np.abs(values) > _LIMITS[name])
    if len(far):
        raise PathError(
            f"{table.source}, {table.place(int(far[0]))}: {name} is {values[far[0]]:g}, beyond "
            f"{_LIMITS[name]:g}; check the unit (m, rad, s)"
        )
    return values


def _agree(
    table: Table, what: str, told: FloatArray, rate: str, expected: FloatArray, unit: str
) -> None:
    """Refuse poses and speeds that contradict each other on the whole, as degrees would."""
    error = np.abs(told - expected)
    larger = max(float(np.abs(told).sum()), float(np.abs(expected).sum()))
    if larger > 0.1 and error.sum() > 0.5 * larger:
        k = int(np.argmax(error))
        raise PathError(
            f"{table.source}, {table.place(k + 1)}: {what} changes by {told[k]:.3g} {unit} where "
            f"{rate} gives {expected[k]:.3g} {unit}, and so on along the trajectory; check the "
            "units (m, rad, s) and the step between samples"
        )


def write_trajectory(trajectory: Trajectory, file: str | File) -> File:
    """Write a trajectory with the columns ``t``, ``x``, ``y``, ``yaw``, ``v``, ``omega``."""
    return _write(file, {name: getattr(trajectory, name) for name in _TRAJECTORY})


def write_log(log: DriveLog, file: str | File) -> File:
    """Write a drive log with one column for each of its channels."""
    first = [name for name in _FIRST if log.has(name)]
    rest = sorted(set(log.channels) - set(first))
    return _write(file, {name: log.channels[name] for name in (*first, *rest)})


def _write(file: str | File, columns: Mapping[str, FloatArray]) -> File:
    """Write columns; numbers as the shortest text that reads back the same."""
    import pandas as pd  # slow to import, and needed only where a file is written

    target = File(file)
    frame = pd.DataFrame(dict(columns))
    suffix = target.suffix.lower()
    if suffix in (".parquet", ".pq"):
        stream = io.BytesIO()
        try:
            frame.to_parquet(stream)
        except ImportError:
            raise MissingDependencyError(
                f"writing {target} needs pyarrow; install it with pip install 'energyplan[parquet]'"
            ) from None
        return atomic_write(target, stream.getvalue())
    text = frame.to_csv(index=False, lineterminator="\n").encode()
    if suffix == ".csv":
        return atomic_write(target, text)
    if suffix == ".gz":
        return atomic_write(target, gzip.compress(text, mtime=0))
    raise InvalidInputError(
        f"{target} is of an unknown type; name a .csv, .csv.gz or .parquet file"
    )


MOST = 4000
"""Largest number of directions of a table."""

PROBES = (0.25, 0.5, 0.75)
"""Where between two directions the error is measured."""


@dataclass(frozen=True, eq=False)
class CostTable:
    """Energies by direction and speed."""

    angle: FloatArray  # (n,): directions, rising from -pi to pi [rad]
    speed: FloatArray  # (m,): speeds of the faster tread, rising [m/s]
    energy: FloatArray  # (n, m): energy per size of a motion [J/m]
    half_track: float  # the C of sizes and directions [m]
    error: float  # largest relative error between two neighbouring directions, as measured

    def segment_energy(self, ds: ArrayLike, dtheta: ArrayLike, speed: ArrayLike) -> FloatArray:
        """Return energies read off the table, as a planner would."""
        x, y, v = np.broadcast_arrays(
            np.asarray(ds, float), self.half_track * np.asarray(dtheta, float), speed
        )
        angle = np.arctan2(y, x)
        k = np.clip(np.searchsorted(self.angle, angle) - 1, 0, len(self.angle) - 2)
        share = (angle - self.angle[k]) / (self.angle[k + 1] - self.angle[k])
        column = np.interp(v, self.speed, np.arange(len(self.speed)))
        j = np.minimum(column.astype(int), max(len(self.speed) - 2, 0))
        beside = np.minimum(j + 1, len(self.speed) - 1)
        low = (1 - share) * self.energy[k, j] + share * self.energy[k + 1, j]
        high = (1 - share) * self.energy[k, beside] + share * self.energy[k + 1, beside]
        return np.asarray(np.hypot(x, y) * (low + (column - j) * (high - low)))


def tabulate(
    cost: EnergyCost, speeds: Sequence[float] | None = None, tolerance: float = 1e-3
) -> CostTable:
    """Return the table of a cost, as fine as it must be."""
    if not tolerance > 0:
        raise InvalidInputError(f"tolerance is {tolerance}; give a positive number")
    asked = [cost.speed] if speeds is None else sorted(set(map(float, speeds)))
    if not asked or any(v is not None and not (np.isfinite(v) and v > 0) for v in asked):
        raise InvalidInputError(f"speeds are {asked}; give one or more positive numbers [m/s]")
    costs = [replace(cost, speed=v) for v in asked]
    half = cost.half_track

    def energies(angle: FloatArray) -> FloatArray:
        x, y = np.cos(angle), np.sin(angle) / half
        return np.column_stack([one.segment_energy(x, y) for one in costs])

    angle = np.linspace(-np.pi, np.pi, 65)
    energy = energies(angle)
    while True:
        gap = np.diff(angle)
        error = np.zeros(len(gap))
        for share in PROBES:
            exact = energies(angle[:-1] + share * gap)
            read = (1 - share) * energy[:-1] + share * energy[1:]
            error = np.maximum(error, np.abs(read / exact - 1.0).max(axis=1))
        # a jump is not made smaller by entries ever closer to it
        split = (error > tolerance) & (gap > 1e-5)
        if not split.any() or len(angle) + split.sum() > MOST:
            break
        between = angle[:-1][split] + 0.5 * gap[split]
        where = np.flatnonzero(split) + 1
        angle = np.insert(angle, where, between)
        energy = np.insert(energy, where, energies(between), axis=0)
    told = np.array([0.0 if v is None else v for v in asked])
    return CostTable(angle, told, energy, half, float(error.max()))


def write_cost_table(table: CostTable, path: str | File) -> None:
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
    atomic_write(File(path), head + "\n".join(rows) + "\n")


NO_DATA = -9999
"""Stands for places that are out of reach."""


def write_energies(found: EnergyMap, path: str | File) -> None:
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
    atomic_write(File(path), header + "\n".join(lines) + "\n")


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


def write_contours(areas: Sequence[Contour], path: str | File) -> None:
    """Write areas in reach to a GeoJSON file; see `contours_document`."""
    atomic_write(File(path), json.dumps(contours_document(areas), indent=1) + "\n")
