"""Manoeuvres that end where they begin, as trajectories: what designed drives consist of."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from energyplan.errors import InvalidInputError
from energyplan.motion import Motion
from energyplan.path import Path, Pose, Trajectory
from energyplan.terrain import OccupancyGrid
from energyplan.vehicle import Vehicle

STEP = 0.05
"""Time between two samples of a designed drive [s]."""


@dataclass(frozen=True)
class Manoeuvre:
    """Tread speeds to reach and to hold, from rest to rest, back where it began."""

    name: str  # what it is, in words
    legs: tuple[tuple[float, float, float], ...]  # tread speeds [m/s] and how long each is held [s]


def manoeuvres(vehicle: Vehicle, speed: float, reach: float) -> Iterator[Manoeuvre]:
    """Yield manoeuvres that end where they begin."""
    yield Manoeuvre("stand for 5 s", ((0.0, 0.0, 5.0),))
    icr = vehicle.icr
    for share in (0.35, 0.65, 1.0):
        v = share * speed
        turn = 2 * np.pi * icr.half_track / v
        yield Manoeuvre(
            f"spin left and right at {v:.2f} m/s", ((-v, v, turn), (0, 0, 0), (v, -v, turn))
        )
        yield Manoeuvre(
            f"drive {reach:.1f} m straight at {v:.2f} m/s and back",
            ((v, v, reach / v), (0, 0, 0), (-v, -v, reach / v)),
        )
        for radius in (1.0, 2.0, 5.0):
            inner = v * (radius - 1.0) / (radius + 1.0)
            time = min(reach, 3.0) / v
            for name, left, right in (("left", inner, v), ("right", v, inner)):
                yield Manoeuvre(
                    f"arc of {radius * icr.half_track:.1f} m to the {name} at {v:.2f} m/s and back",
                    ((left, right, time), (0, 0, 0), (-left, -right, time)),
                )
        for k in range(1, 8):
            angle = k * np.pi / 4 if k <= 4 else k * np.pi / 4 - 2 * np.pi
            held = abs(angle) * icr.half_track / v
            s = float(np.sign(angle))
            yield Manoeuvre(
                f"turn by {np.degrees(angle):.0f} deg, {reach:.1f} m straight at {v:.2f} m/s and "
                "back, turn back",
                (
                    (-s * v, s * v, held), (0, 0, 0), (v, v, reach / v), (0, 0, 0),
                    (-v, -v, reach / v), (0, 0, 0), (s * v, -s * v, held),
                ),
            )  # fmt: skip


@dataclass(frozen=True)
class Option:
    """A manoeuvre and its trajectory from a given pose."""

    manoeuvre: Manoeuvre
    trajectory: Trajectory

    @classmethod
    def of(cls, manoeuvre: Manoeuvre, vehicle: Vehicle, start: Pose, acceleration: float) -> Option:
        """Time the legs with linear ramps between them, and integrate the pose."""
        corners = [(0.0, 0.0, 0.0)]
        for left, right, hold in (*manoeuvre.legs, (0.0, 0.0, 0.0)):
            t, l0, r0 = corners[-1]
            ramp = max(abs(left - l0), abs(right - r0)) / acceleration
            # What the ramps drive is taken off the time at speed, half at either end.
            for step in (ramp, max(hold - ramp, 0.0)):
                if step > 0:
                    t += step
                    corners.append((t, left, right))
        t, left, right = np.array(corners).T
        grid = np.unique(np.concatenate([t, np.arange(0.0, t[-1], STEP)]))
        grid = grid[np.append(True, np.diff(grid) > 1e-6)]
        motion = Motion(np.interp(grid, t, left), np.interp(grid, t, right), vehicle.icr)
        fine = np.linspace(0.0, 1.0, 9)[1:-1]
        v, w, h = motion.v, motion.omega, np.diff(grid)
        yaw = start.yaw + np.concatenate([[0.0], np.cumsum(0.5 * h * (w[1:] + w[:-1]))])
        u = np.concatenate([[0.0], fine, [1.0]])[:, None]
        angle = yaw[:-1] + h * (u * w[:-1] + 0.5 * u**2 * np.diff(w))
        ahead = v[:-1] + u * np.diff(v)
        lag = vehicle.icr.longitudinal * (w[:-1] + u * np.diff(w))
        dx = h * np.trapezoid(ahead * np.cos(angle) + lag * np.sin(angle), u, axis=0)
        dy = h * np.trapezoid(ahead * np.sin(angle) - lag * np.cos(angle), u, axis=0)
        x = start.x + np.concatenate([[0.0], np.cumsum(dx)])
        y = start.y + np.concatenate([[0.0], np.cumsum(dy)])
        return cls(manoeuvre, Trajectory(grid, x, y, yaw, v, w))


def fits(grid: OccupancyGrid, vehicle: Vehicle, trajectory: Trajectory) -> bool:
    """Tell whether a vehicle that follows a trajectory stays on the map and touches nothing."""
    poses = trajectory.poses
    if not np.all(grid.inside(poses[:, :2])):
        return False
    path = Path.from_poses(poses, vehicle.icr.longitudinal)
    return grid.path_free(path, vehicle)


def roomiest(grid: OccupancyGrid, vehicle: Vehicle) -> Pose:
    """Return the pose about which most is free, heading along the longer side of the map."""
    rows, columns = grid.shape
    row, column = np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij")
    rim = np.minimum.reduce([row, column, rows - 1 - row, columns - 1 - column])
    room = np.minimum(grid.clearance, (rim + 0.5) * grid.resolution)
    k, j = np.unravel_index(int(np.argmax(room)), room.shape)
    x, y = grid.to_world(np.array([j + 0.5, k + 0.5]))
    pose = Pose(float(x), float(y), 0.0 if columns >= rows else float(np.pi / 2))
    if not bool(grid.footprint_free(np.array([pose]), vehicle)[0]):
        raise InvalidInputError(f"nowhere on the map is room for {vehicle.name}; give a start")
    return pose


def joined(parts: Sequence[Trajectory]) -> Trajectory:
    """Drive trajectories one after the other; each begins where the one before ended."""
    columns, clock = [], 0.0
    for k, part in enumerate(parts):
        first = 1 if k else 0
        rows = np.column_stack([part.t + clock, part.poses, part.v, part.omega])[first:]
        columns.append(rows)
        clock += part.duration
    t, x, y, yaw, v, omega = np.concatenate(columns).T
    return Trajectory(t, x, y, yaw, v, omega)
