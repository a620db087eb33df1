"""Tables: paths, trajectories, drive logs, and energies by place."""

from __future__ import annotations

import csv
import gzip
import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path as File
from typing import TYPE_CHECKING, Any

import numpy as np
import shapely

from energyplan.errors import InvalidInputError, MapError, PathError, needs_extra
from energyplan.io.files import atomic_write
from energyplan.logs import DriveLog
from energyplan.logs.guess import guess, guess_ahead, guess_turns
from energyplan.logs.mapping import Column, time_units, unit_in
from energyplan.logs.tables import Recording, find_stamp, quaternions, read_table
from energyplan.path import FloatArray, Path, Trajectory, wrap_angle

if TYPE_CHECKING:
    from energyplan.reach import Contour, EnergyMap

_LIMITS = {"x": 1e8, "y": 1e8, "yaw": 1e5, "t": 1e11, "v": 100.0, "omega": 100.0}
_PATH = ("x", "y", "yaw")
_TRAJECTORY = ("t", *_PATH, "v", "omega")
_LOGGED = {"v_left", "v_right", "p_left", "p_right", "power", "voltage", "current"}
_LONGEST = 1e6  # longest path that is read [m]
_FIRST = ("t", "v_left", "v_right", "p_left", "p_right", "power", "voltage", "current")


def read_path(file: str | File, longitudinal: float = 0.0) -> Path:
    r"""Read a path from a table with the columns ``x``, ``y``, ``yaw``.

    Parameters
    ----------
    file : str or File
        CSV, CSV.gz or Parquet; poses of the body frame [m], [rad], two or more. Names may say
        another unit (``yaw_deg``, ``x [mm]``); a quaternion (``qz``, ``qw``) is a heading.
    longitudinal : float
        Where the reference point of the path's arcs lies along the body's x axis [m]: the
        ``icr.longitudinal`` of the vehicle that drives it.

    Returns
    -------
    Path
        Arcs and spins through the poses, as `Path.from_poses` finds them.

    Raises
    ------
    PathError
        If a column is missing or a value is no number, or no arc leads from pose to pose; the
        message names file and line.

    Examples
    --------
    >>> import tempfile
    >>> line = Path((0.0, 0.0, 0.0), [2.0], [0.0])
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     round(read_path(write_path(line, File(folder) / "path.csv")).length, 6)
    2.0
    """
    table = _with_poses(read_table(file, PathError))
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


def read_points(file: str | File) -> list[list[float]]:
    """Return the points of a table with x, y, or its poses where it has headings."""
    table = _with_poses(read_table(file, PathError))
    names = [name for name in _PATH if name != "yaw" or name in table.columns]
    _check_kind(table, names)
    rows: list[list[float]] = np.column_stack([_complete(table, name) for name in names]).tolist()
    return rows


def write_path(
    path: Path, file: str | File, *, max_ds: float = 0.05, max_dtheta: float = 0.05
) -> File:
    """Write a path as a table with the columns ``x``, ``y``, ``yaw``.

    Parameters
    ----------
    path : Path
        The path.
    file : str or File
        Where to; its suffix is .csv, .gz or .parquet.
    max_ds, max_dtheta : float
        Largest distance [m] and turn [rad] from pose to pose.

    Returns
    -------
    File
        The file, written whole or not at all.
    """
    poses = path.poses(max_ds, max_dtheta)
    return _write(file, dict(zip(_PATH, poses.T, strict=True)))


def read_trajectory(file: str | File) -> Trajectory:
    r"""Read a trajectory: a table of ``t``, ``x``, ``y``, ``yaw``, ``v``, ``omega``.

    Parameters
    ----------
    file : str or File
        CSV, CSV.gz or Parquet; times [s], poses of the body frame [m], [rad], speed [m/s] and yaw
        rate [rad/s], two rows or more.

    Returns
    -------
    Trajectory
        Its samples; the yaw without jumps.

    Raises
    ------
    PathError
        If a column is missing, times do not increase, or poses and speeds disagree; the message
        names file and line.
    """
    table = _with_poses(read_table(file, PathError))
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
    table = _with_poses(read_table(file, PathError))
    if {"t", "v", "omega"} & (set(table.columns) | set(table.text)):
        return read_trajectory(file)
    return read_path(file, longitudinal)


def _with_poses(table: Recording) -> Recording:
    """Return a table with the columns of a path or trajectory, found as those of a log."""
    names = [name for name in table.columns if name]
    found = {name: one for name, one in guess(names).items() if name in _PATH}
    if (yaw := found.get("yaw")) and not (yaw.unit or yaw.field in _RADIANS):
        del found["yaw"]  # a compass counts in degrees, and clockwise
    turns = quaternions(names)
    if len(turns) == 1:
        found.setdefault("yaw", Column(field=next(iter(turns)), channel="yaw"))
    found |= _of_motion(table, names)
    lacking = [name for name in _TRAJECTORY if name in found and name not in table.columns]
    poses = {name: found[name].value(table.column) for name in lacking}
    return replace(table, columns={**table.columns, **poses})


_RADIANS = ("theta", "Theta", "yaw", "Yaw")  # names of headings that count from the x axis


def _of_motion(table: Recording, names: Sequence[str]) -> dict[str, Column]:
    """Return which columns are the time, the speed and the turn rate of a trajectory."""
    found: dict[str, Column] = {}
    clock = find_stamp(table.columns) or guess(names).get("t")
    if clock is not None:
        times = clock.value(table.column)
        found["t"] = clock if clock.unit else clock.changed(unit=time_units(times)[0] or "s")
    for channel, known in (("v", guess_ahead(names)), ("omega", guess_turns(names))):
        quantity = "v_left" if channel == "v" else "yaw_rate"
        known = [name for name in names if unit_in(quantity, name).bare == channel] or known
        if len(known) == 1:
            unit = unit_in(quantity, known[0]).unit
            found[channel] = Column(field=known[0], unit=unit, channel=quantity)
    return found if {"t", "v", "omega"} <= {*found, *names} else {}


def _check_kind(table: Recording, needed: Sequence[str]) -> None:
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
    if "yaw" in missing and (heading := guess(table.columns).get("yaw")) is not None:
        timed += (
            f"; {heading.field!r} says neither its unit nor where it counts from: name it yaw "
            "[rad] or yaw_deg, counted to the left from the x axis"
        )
    raise PathError(f"{what}; the columns are {', '.join(names[:20])}{timed}")


def _complete(table: Recording, name: str) -> FloatArray:
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
    table: Recording, what: str, said: FloatArray, rate: str, expected: FloatArray, unit: str
) -> None:
    """Refuse poses and speeds that contradict each other on the whole, as degrees would."""
    error = np.abs(said - expected)
    larger = max(float(np.abs(said).sum()), float(np.abs(expected).sum()))
    if larger > 0.1 and error.sum() > 0.5 * larger:
        k = int(np.argmax(error))
        raise PathError(
            f"{table.source}, {table.place(k + 1)}: {what} changes by {said[k]:.3g} {unit} where "
            f"{rate} gives {expected[k]:.3g} {unit}, and so on along the trajectory; check the "
            "units (m, rad, s) and the step between samples"
        )


def write_trajectory(trajectory: Trajectory, file: str | File) -> File:
    """Write a trajectory with the columns ``t``, ``x``, ``y``, ``yaw``, ``v``, ``omega``.

    Parameters
    ----------
    trajectory : Trajectory
        The trajectory, such as that of ``plan.driven`` or of `energyplan.profile`.
    file : str or File
        Where to; its suffix is .csv, .gz or .parquet.

    Returns
    -------
    File
        The file, written whole or not at all; `read_trajectory` reads the same numbers.
    """
    return _write(file, {name: getattr(trajectory, name) for name in _TRAJECTORY})


def write_log(log: DriveLog, file: str | File) -> File:
    """Write a drive log with one column for each of its channels."""
    first = [name for name in _FIRST if log.has(name)]
    rest = sorted(set(log.channels) - set(first))
    return _write(file, {name: log.channels[name] for name in (*first, *rest)})


def _write(file: str | File, columns: Mapping[str, FloatArray]) -> File:
    """Write columns; numbers as the shortest text that reads back the same, NaN as no text."""
    target = File(file)
    suffix = target.suffix.lower()
    if suffix in (".parquet", ".pq"):
        with needs_extra("parquet", f"writing {target}"):
            import pyarrow as pa
            import pyarrow.parquet as pq

        stream = io.BytesIO()
        pq.write_table(pa.table(dict(columns)), stream)
        return atomic_write(target, stream.getvalue())
    lines = io.StringIO()
    table = csv.writer(lines, lineterminator="\n")
    table.writerow(columns)
    cells = (["" if v != v else v for v in values.tolist()] for values in columns.values())
    table.writerows(zip(*cells, strict=True))
    text = lines.getvalue().encode()
    if suffix == ".csv":
        return atomic_write(target, text)
    if suffix == ".gz":
        return atomic_write(target, gzip.compress(text, mtime=0))
    raise InvalidInputError(
        f"{target} is of an unknown type; name a .csv, .csv.gz or .parquet file"
    )


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
