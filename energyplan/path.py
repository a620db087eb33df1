"""Where the robot goes: `Pose`, `Path` (geometry only) and `Trajectory` (geometry with time)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from energyplan.errors import InvalidInputError, PathError, needs_extra
from energyplan.records import NO_NUMBER, ByValue, amount, checked, described, numbers

if TYPE_CHECKING:
    import pandas as pd

FloatArray = NDArray[np.float64]

ROUNDING = 1e-9  # part of a number by which rounding may change it [1]
PLACE = 1e-9  # distance below which two places are one [m]
ANGLE = 1e-12  # difference below which two headings are one [rad]
STILL = 1e-6  # arc length below which a motion is a turn on the spot [m]


class PathLimits(NamedTuple):
    """Sizes of a path that are mistakes."""

    most_parts: float = 1e8  # of a path that is divided
    full_turn: float = 6.3  # with rounding [rad]
    degrees: float = 10.0  # yaw beyond which whole and half numbers count as degrees


_LIMITS = PathLimits()


class Pose(NamedTuple):
    """Position [m] and heading [rad, counter-clockwise from x] of the body frame.

    Examples
    --------
    >>> Pose(1.0, 2.0, 0.5).yaw
    0.5
    """

    x: float
    y: float
    yaw: float


def refuse_degrees(
    angles: FloatArray, name: str, error: type[InvalidInputError] = InvalidInputError
) -> None:
    """Refuse yaws that seem to be in degrees.

    Yaws in radians are hardly ever whole or half numbers, all of them, beyond ten; those in degrees
    mostly are.
    """
    wide = angles[np.abs(angles) >= _LIMITS.degrees]
    if wide.size and np.all(2 * angles == np.round(2 * angles)):
        raise error(
            f"{name} is {wide[0]:g} rad, which seems to be in degrees; write {wide[0]:g}deg in a "
            f"file or on the command line, math.radians({wide[0]:g}) in Python"
        )


def as_pose(
    value: ArrayLike, name: str, error: type[InvalidInputError] = InvalidInputError
) -> Pose:
    """Return a pose from three finite numbers."""
    words = "x, y [m] and yaw [rad]"
    row = numbers(value, name, error, words=words)
    if row.shape != (3,) or not np.all(np.isfinite(row)):
        raise error(f"{name} is {described(value)}; give {words}, all finite")
    if not isinstance(value, Pose):  # the yaw at a path's end may be any number of turns
        refuse_degrees(row[2:], f"the yaw of {name}", error)
    return Pose(*(float(v) for v in row))


def parse_pose(given: str | Sequence[object]) -> Pose:
    """Return the pose that ``X,Y,YAW``, or a list of texts, stands for."""
    shown = described(given).removeprefix("the text ")
    try:
        x, y, yaw = given.split(",") if isinstance(given, str) else given
        if isinstance(x, bool) or isinstance(y, bool):
            raise ValueError
        pose = Pose(float(x), float(y), float(amount("angle", yaw)))  # type: ignore[arg-type]
        if not np.all(np.isfinite(pose)):
            raise ValueError
    except NO_NUMBER:
        raise InvalidInputError(
            f"pose {shown} is not X,Y,YAW; write it like 2.0,3.5,90deg or 2.0,3.5,1.57"
        ) from None
    if abs(pose.yaw) > _LIMITS.full_turn:
        raise InvalidInputError(
            f"the yaw of pose {shown} is more than a full turn in radians; for degrees write "
            f"{str(yaw).strip().removesuffix('deg')}deg, up to 360"
        )
    return pose


def wrap_angle(angle: ArrayLike) -> FloatArray:
    """Return `angle` [rad] shifted by full turns into (-pi, pi]."""
    return np.asarray(np.pi - np.mod(np.pi - np.asarray(angle, float), 2 * np.pi))


def point_ahead(pose: ArrayLike, distance: ArrayLike) -> FloatArray:
    """Return the point that lies ahead of a pose, along its heading."""
    rows = np.asarray(pose, float)
    heading = np.stack([np.cos(rows[..., 2]), np.sin(rows[..., 2])], axis=-1)
    return np.asarray(rows[..., :2] + np.asarray(distance, float)[..., None] * heading)


def _frozen(value: ArrayLike, name: str, shape: tuple[int, ...] | None = None) -> FloatArray:
    array = np.array(numbers(value, name, PathError), ndmin=1)
    if not np.all(np.isfinite(array)):
        place = int(np.argwhere(~np.isfinite(array))[0][0])
        raise PathError(f"{name} is not finite at index {place}; remove or interpolate it first")
    if shape is not None and array.shape != shape:
        raise PathError(f"{name} has shape {array.shape}, expected {shape}")
    array.setflags(write=False)
    return array


def _chord_factor(dtheta: FloatArray) -> FloatArray:
    """Chord over arc length, ``sin(h)/h`` with h half the turn."""
    return np.asarray(np.sinc(dtheta / (2 * np.pi)))


@dataclass(frozen=True, eq=False)
class Path(ByValue):
    """A geometric path of arcs, each of constant curvature.

    Segment i moves the reference point by the signed arc length ``ds[i]`` along its heading
    (negative: backwards) while the heading turns by ``dtheta[i]``. A straight line has
    ``dtheta = 0``, a spin on the spot ``ds = 0``, a pivot about one tread's ICR
    ``|ds| = C |dtheta|``. The reference point is the body point (`longitudinal`, 0): the point of
    the x axis level with the tread ICRs, the only one there that never moves sideways.

    Parameters
    ----------
    start : Pose
        Pose of the body frame at the start.
    ds : array_like, shape (n,)
        Signed arc lengths [m].
    dtheta : array_like, shape (n,)
        Signed turns [rad].
    longitudinal : float
        x coordinate of the reference point in the body frame [m]; `TreadICR.longitudinal`.

    Raises
    ------
    PathError
        If the arrays differ in shape or hold a value that is not finite.

    Examples
    --------
    >>> path = Path(Pose(0, 0, 0), ds=[1.0, 0.0, 2.0], dtheta=[0.0, np.pi / 2, 0.0])
    >>> path.length, [round(float(v), 3) for v in path.end]
    (3.0, [1.0, 2.0, 1.571])
    """

    start: Pose
    ds: FloatArray
    dtheta: FloatArray
    longitudinal: float = 0.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "start", as_pose(self.start, "start", PathError))
        (longitudinal,) = _frozen([self.longitudinal], "longitudinal", (1,)).tolist()
        object.__setattr__(self, "longitudinal", longitudinal)
        object.__setattr__(self, "ds", _frozen(self.ds, "ds"))
        object.__setattr__(self, "dtheta", _frozen(self.dtheta, "dtheta"))
        if self.ds.ndim != 1 or self.ds.shape != self.dtheta.shape:
            raise PathError(
                f"ds has shape {self.ds.shape} and dtheta {self.dtheta.shape}; "
                "give one value of each per segment"
            )

    def __len__(self) -> int:
        return len(self.ds)

    @property
    def length(self) -> float:
        """Distance that the reference point travels [m]."""
        return float(np.abs(self.ds).sum())

    @property
    def reverse_length(self) -> float:
        """Distance of it that the reference point travels backwards [m]."""
        return float(np.abs(np.minimum(self.ds, 0.0)).sum())

    @property
    def turning(self) -> float:
        """Total turning: the sum of the turns' sizes [rad]."""
        return float(np.abs(self.dtheta).sum())

    @property
    def vertices(self) -> FloatArray:
        """Poses of the body frame at the ends of the segments, shape (n + 1, 3); yaw unwrapped."""
        yaw = self.start.yaw + np.concatenate([[0.0], np.cumsum(self.dtheta)])
        mid = 0.5 * (yaw[:-1] + yaw[1:])
        chord = self.ds * _chord_factor(self.dtheta)
        heading = np.stack([np.cos(mid), np.sin(mid)], axis=1)
        origin = np.array([self.start.x, self.start.y])
        offset = self.longitudinal * np.stack([np.cos(yaw), np.sin(yaw)], axis=1)
        moved = np.vstack([np.zeros((1, 2)), np.cumsum(chord[:, None] * heading, axis=0)])
        return np.column_stack([origin + offset[0] + moved - offset, yaw])

    @property
    def points(self) -> FloatArray:
        """Places of the reference point at the ends of the segments, shape (n + 1, 2) [m]."""
        return point_ahead(self.vertices, self.longitudinal)

    @property
    def end(self) -> Pose:
        """Pose of the body frame at the end; yaw unwrapped."""
        return Pose(*(float(v) for v in self.vertices[-1]))

    @checked(PathError)
    def subdivide(self, max_ds: float = np.inf, max_dtheta: float = np.inf) -> Path:
        """Return the same path with segments of at most `max_ds` [m] and `max_dtheta` [rad]."""
        if not (max_ds > 0 and max_dtheta > 0):
            raise PathError(f"max_ds {max_ds} and max_dtheta {max_dtheta} must be positive")
        pieces = np.ceil(
            np.maximum(np.abs(self.ds) / max_ds, np.abs(self.dtheta) / max_dtheta) - ROUNDING
        )
        if pieces.sum() > _LIMITS.most_parts:
            raise PathError(
                f"max_ds {max_ds:g} and max_dtheta {max_dtheta:g} make {pieces.sum():.3g} "
                f"segments; at most {_LIMITS.most_parts:g} are possible"
            )
        count = np.maximum(pieces, 1).astype(int)
        return Path(
            self.start,
            np.repeat(self.ds / count, count),
            np.repeat(self.dtheta / count, count),
            self.longitudinal,
        )

    def poses(self, max_ds: float = 0.05, max_dtheta: float = 0.05) -> FloatArray:
        """Return poses along the path, shape (m, 3), at steps of at most so much [m], [rad]."""
        return self.subdivide(max_ds, max_dtheta).vertices

    def reversed(self) -> Path:
        """Return the path driven from its end to its start, so that each motion runs backwards."""
        return Path(self.end, -self.ds[::-1], -self.dtheta[::-1], self.longitudinal)

    @checked(PathError)
    def __add__(self, other: Path) -> Path:
        """Return this path followed by `other`, which must start where this one ends."""
        here, there = np.array(self.end), np.array(other.start)
        gap = np.hypot(*(here - there)[:2]) + abs(float(wrap_angle(here[2] - there[2])))
        if gap > 1e-6 or self.longitudinal != other.longitudinal:
            raise PathError(f"the second path starts {gap:.3g} (m + rad) from the first one's end")
        return Path(
            self.start,
            np.concatenate([self.ds, other.ds]),
            np.concatenate([self.dtheta, other.dtheta]),
            self.longitudinal,
        )

    @classmethod
    @checked(PathError)
    def from_poses(
        cls, poses: ArrayLike, longitudinal: float = 0.0, tolerance: float = 0.02
    ) -> Path:
        """Join poses by arcs.

        Each pair of poses is joined by the arc that turns through their difference in heading
        (the shorter way round) and comes nearest to the second position.

        Parameters
        ----------
        poses : array_like, shape (n, 3)
            Poses x, y [m], yaw [rad].
        longitudinal : float
            x coordinate of the reference point [m].
        tolerance : float
            Largest distance between an arc's end and the pose it aims at [m].

        Returns
        -------
        Path
            The path.

        Raises
        ------
        PathError
            If two poses ask for sideways motion beyond `tolerance`; the message names them.
        """
        rows = _frozen(poses, "poses")
        if rows.ndim != 2 or rows.shape[1] != 3 or len(rows) < 1:
            raise PathError(f"poses have shape {rows.shape}; give rows of x, y, yaw")
        yaw = rows[0, 2] + np.concatenate([[0.0], np.cumsum(wrap_angle(np.diff(rows[:, 2])))])
        dtheta = np.diff(yaw)
        rotated = np.column_stack([rows[:, :2], yaw])
        step = np.diff(point_ahead(rotated, longitudinal), axis=0)
        mid = 0.5 * (yaw[:-1] + yaw[1:])
        along = step[:, 0] * np.cos(mid) + step[:, 1] * np.sin(mid)
        across = -step[:, 0] * np.sin(mid) + step[:, 1] * np.cos(mid)
        if len(across) and np.max(np.abs(across)) > tolerance:
            k = int(np.argmax(np.abs(across)))
            raise PathError(
                f"from pose {k} to pose {k + 1} the robot would slide {abs(across[k]):.3g} m "
                "sideways; give headings along the path, or poses closer together"
            )
        return cls(Pose(*rows[0]), along / _chord_factor(dtheta), dtheta, longitudinal)


@dataclass(frozen=True, eq=False)
class Trajectory(ByValue):
    """Poses and speeds over time.

    Parameters
    ----------
    t : array_like, shape (n,)
        Strictly increasing times [s].
    x, y, yaw : array_like, shape (n,)
        Pose of the body frame [m], [rad].
    v, omega : array_like, shape (n,)
        Speed along the heading [m/s] and yaw rate [rad/s].

    Raises
    ------
    PathError
        If shapes differ, a value is not finite, or time does not increase; the message names the
        sample.

    Examples
    --------
    >>> drive = Trajectory([0, 2], x=[0, 1], y=[0, 0], yaw=[0, 0], v=[0.5, 0.5], omega=[0, 0])
    >>> drive.duration, drive.scaled(2.0).duration
    (2.0, 1.0)
    """

    t: FloatArray
    x: FloatArray
    y: FloatArray
    yaw: FloatArray
    v: FloatArray
    omega: FloatArray

    def __post_init__(self) -> None:
        shape = np.shape(self.t)
        for name in ("t", "x", "y", "yaw", "v", "omega"):
            object.__setattr__(self, name, _frozen(getattr(self, name), name, shape))
        if self.t.ndim != 1 or len(self.t) < 2:
            raise PathError(f"t has shape {self.t.shape}; a trajectory needs two samples or more")
        back = np.flatnonzero(np.diff(self.t) <= 0)
        if len(back):
            k = int(back[0])
            raise PathError(
                f"time does not increase at sample {k + 1}: {self.t[k]:g} s, then "
                f"{self.t[k + 1]:g} s; sort the samples and drop repeated ones"
            )

    def __len__(self) -> int:
        return len(self.t)

    @property
    def duration(self) -> float:
        """Time from the first to the last sample [s]."""
        return float(self.t[-1] - self.t[0])

    @property
    def poses(self) -> FloatArray:
        """Poses, shape (n, 3)."""
        return np.column_stack([self.x, self.y, self.yaw])

    def to_frame(self) -> pd.DataFrame:
        """Return the trajectory as a pandas DataFrame.

        Returns
        -------
        DataFrame
            Columns ``t``, ``x``, ``y``, ``yaw``, ``v``, ``omega``; ``Trajectory(**frame)`` makes
            the trajectory again.
        """
        with needs_extra("logs", "a DataFrame"):
            import pandas as pd

        return pd.DataFrame({one.name: np.array(getattr(self, one.name)) for one in fields(self)})

    @checked(PathError)
    def scaled(self, factor: float) -> Trajectory:
        """Return the same geometry driven `factor` times as fast."""
        if not factor > 0:
            raise PathError(f"the speed factor is {factor}; it must be positive")
        t = self.t[0] + (self.t - self.t[0]) / factor
        return Trajectory(t, self.x, self.y, self.yaw, self.v * factor, self.omega * factor)
