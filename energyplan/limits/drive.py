"""What a trajectory is between its samples, and what it takes: one definition for all who ask.

Between two samples the forward speed and the yaw rate change evenly: both accelerations are
constant there and jump at the samples. The pose follows the speeds; what the samples' poses differ
from that is spread evenly. `Traversal` cuts each interval where a tread, the body or the yaw rate
comes to a standstill, because friction changes its direction there, and evaluates the whole power
model at the ends and in the middle of each subinterval. Energies come from Simpson's rule on these,
which is exact while the power is a cubic in time; where it is not, they are halved until it nearly
is.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from energyplan.errors import InvalidInputError
from energyplan.limits.motor_kernels import cut_intervals, piece_nodes
from energyplan.motion import Motion
from energyplan.path import FloatArray, Trajectory, point_ahead
from energyplan.power import PowerModel
from energyplan.terrain import HeightMap, SurfaceMap

if TYPE_CHECKING:
    from energyplan.battery import BatteryModel, BatteryRun

BLOCK = 8192  # intervals per block: what is evaluated at once stays in the processor's cache
SIMPSON = np.array([1.0, 4.0, 1.0]) / 6.0  # weights of the nodes of a subinterval

PRECISION = 1e-8
"""Accepted error of a subinterval's mean power, as a fraction of the mean size of all powers."""

HALVINGS = 30  # maximum number of times that a subinterval is halved


@dataclass(frozen=True)
class Ground:
    """What is driven on: power models by place, and the slope."""

    model: PowerModel  # the model outside all surfaces
    surfaces: SurfaceMap | None = None  # surfaces with models of their own
    heights: HeightMap | None = None  # heights of the ground
    others: tuple[PowerModel, ...] | None = None

    def __post_init__(self) -> None:
        count = 0 if self.surfaces is None else len(self.surfaces.surfaces)
        if self.others is not None and len(self.others) != count:
            raise InvalidInputError(
                f"{len(self.others)} models for {count} surfaces; give each one"
            )

    @property
    def has_speed_limits(self) -> bool:
        """Whether the robot must drive slowly somewhere."""
        return self.surfaces is not None and bool(self.surfaces.speed_limits)

    @property
    def models(self) -> tuple[PowerModel, ...]:
        """The models, that of no surface first."""
        if self.others is not None:
            return (self.model, *self.others)
        own = () if self.surfaces is None else tuple(s.model for s in self.surfaces.surfaces)
        return (self.model, *own)

    def regions(self, poses: FloatArray) -> NDArray[np.intp]:
        """Index among `models` of the one that holds at poses (..., 3)."""
        if self.surfaces is None:
            return np.zeros(poses.shape[:-1], np.intp)
        return self.surfaces.region_at(self._reference(poses)[..., :2])

    def slopes(self, poses: FloatArray) -> FloatArray:
        """Slope along the heading at poses (..., 3) [rad]."""
        if self.heights is None:
            return np.zeros(poses.shape[:-1])
        return self.heights.slope(self._reference(poses))

    def top_speed(self, poses: FloatArray) -> FloatArray:
        """Largest speed that the ground allows at poses (..., 3) [m/s]; infinite where any."""
        if self.surfaces is None:
            return np.full(poses.shape[:-1], np.inf)
        return self.surfaces.top_speed(self._reference(poses)[..., :2], self.model.vehicle)

    def _reference(self, poses: FloatArray) -> FloatArray:
        lever = self.model.vehicle.icr.longitudinal
        if not lever:
            return poses
        return np.concatenate([point_ahead(poses, lever), poses[..., 2:]], axis=-1)


class Pieces(NamedTuple):
    """Subintervals of the intervals between samples."""

    interval: NDArray[np.int_]  # (m,): the interval that contains it
    begin: FloatArray  # (m,): where it begins, as a fraction of the interval
    end: FloatArray  # (m,): where it ends, as a fraction of the interval

    @property
    def parts(self) -> FloatArray:
        """Begin, middle and end of each subinterval as fractions of the interval, shape (m, 3)."""
        return np.column_stack([self.begin, 0.5 * (self.begin + self.end), self.end])

    def take(self, which: NDArray[np.bool_]) -> Pieces:
        """Return some of the subintervals."""
        return Pieces(self.interval[which], self.begin[which], self.end[which])

    def halved(self) -> Pieces:
        """Return the halves of the subintervals, the two halves of one next to each other."""
        middle = 0.5 * (self.begin + self.end)
        return Pieces(
            np.repeat(self.interval, 2),
            np.column_stack([self.begin, middle]).reshape(-1),
            np.column_stack([middle, self.end]).reshape(-1),
        )


class GroundPieces(NamedTuple):
    """Subintervals on one ground, with their motion."""

    model: PowerModel  # the power model there
    region: int  # its place among the ground's models
    which: NDArray[np.intp]  # (m,): indices of these subintervals
    motion: Motion  # (m, 3): motion at the beginning, the middle and the end of each one


class Quadrature(NamedTuple):
    """Parts of a drive on one ground, with weights that turn powers into energy."""

    region: int  # the ground's place among its models
    motion: Motion  # (m, 3): motion at three instants of each subinterval
    weight: FloatArray  # (m, 3): duration assigned to each instant [s]
    interval: NDArray[np.int_]  # (m,): interval between samples that contains each one


@dataclass(frozen=True)
class Traversal:
    """A trajectory with what is known along it and what it is driven on."""

    trajectory: Trajectory  # the trajectory
    ground: Ground  # power models and slope
    channels: Mapping[str, ArrayLike] = field(default_factory=dict)  # ()

    def __post_init__(self) -> None:
        wide = {}
        for name, value in self.channels.items():
            array = np.asarray(value, float)
            if array.shape not in ((), (len(self.trajectory),)):
                raise InvalidInputError(
                    f"channel {name!r} has shape {array.shape}; give one value, or one for each "
                    f"of the trajectory's {len(self.trajectory)} samples"
                )
            wide[name] = array
        object.__setattr__(self, "channels", wide)

    @property
    def block_count(self) -> int:
        """Number of blocks."""
        return -(-(len(self.trajectory) - 1) // BLOCK)

    def pieces(self, k: int) -> Pieces:
        """Return the k-th block of intervals, cut where something comes to a standstill."""
        path, icr = self.trajectory, self.ground.model.vehicle.icr
        last = min((k + 1) * BLOCK, len(path) - 1)
        return Pieces(*cut_intervals(path.v, path.omega, icr.left, icr.right, k * BLOCK, last))

    def times(self, pieces: Pieces, scale: float = 1.0) -> FloatArray:
        """Return the times of begin, middle and end of subintervals [s], shape (m, 3)."""
        t = self.trajectory.t
        first = t[pieces.interval] - t[0]
        last = t[pieces.interval + 1] - t[0]
        step = last - first
        out = np.empty((len(first), 3))
        out[:, 0] = first + pieces.begin * step
        out[:, 1] = first + 0.5 * (pieces.begin + pieces.end) * step
        # Exact at both ends, so that neighbours agree.
        out[:, 2] = np.where(pieces.end == 1.0, last, first + pieces.end * step)
        if scale != 1.0:
            out /= scale
        out += t[0]
        return out

    def widths(self, pieces: Pieces, scale: float = 1.0) -> FloatArray:
        """Return the durations of subintervals [s], shape (m,)."""
        t = self.trajectory.t
        step = t[pieces.interval + 1] - t[pieces.interval]
        return np.asarray((pieces.end - pieces.begin) * step / scale)

    def speed_limits(self, pieces: Pieces) -> FloatArray:
        """Top speed of the ground at begin, middle and end of subintervals [m/s], shape (m, 3)."""
        return self.ground.top_speed(self._poses(pieces))

    def speeds(self, pieces: Pieces, scale: float = 1.0) -> FloatArray:
        """Absolute speed along the heading at begin, middle, end of subintervals [m/s], (m, 3)."""
        return np.abs(self._between(scale * self.trajectory.v, pieces))

    def parts(self, pieces: Pieces, scale: float = 1.0) -> Iterator[GroundPieces]:
        """Yield the motion of subintervals, driven `scale` times as fast, ground by ground."""
        if self.ground.surfaces is None:
            yield GroundPieces(
                self.ground.model, 0, np.arange(len(pieces.interval)),
                self._motion(self.ground.model, pieces, scale),
            )  # fmt: skip
            return
        regions = self.ground.regions(self._poses(pieces)[:, 1])
        for region in np.unique(regions):
            here = regions == region
            model = self.ground.models[region]
            motion = self._motion(model, pieces.take(here), scale)
            yield GroundPieces(model, int(region), np.flatnonzero(here), motion)

    def _poses(self, pieces: Pieces) -> FloatArray:
        """Poses at the beginning, in the middle and at the end of subintervals, shape (m, 3, 3)."""
        path = self.trajectory
        nodes = piece_nodes(
            path.t, path.x, path.y, path.yaw, path.v, path.omega, 1.0, 1.0, *pieces, 1.0
        )
        return np.stack([nodes.x, nodes.y, nodes.yaw], axis=-1)

    def _motion(self, model: PowerModel, pieces: Pieces, scale: float) -> Motion:
        path, icr = self.trajectory, model.vehicle.icr
        nodes = piece_nodes(
            path.t, path.x, path.y, path.yaw, path.v, path.omega,
            icr.left, icr.right, *pieces, scale,
        )  # fmt: skip
        known: dict[str, FloatArray] = {
            "t": self.times(pieces, scale),
            "x": nodes.x,
            "y": nodes.y,
            "yaw": nodes.yaw,
            "accel": nodes.accel,
            "yaw_accel": nodes.yaw_accel,
            "slope": np.zeros(()),
        }
        v_left, v_right = nodes.v_left, nodes.v_right
        if self.ground.heights is not None:
            slope = self.ground.slopes(np.stack([nodes.x, nodes.y, nodes.yaw], axis=-1))
            # Along the slope the way is longer than in plan view.
            longer = 1.0 / np.cos(slope) - 1.0
            more = longer * (icr.right * v_left + icr.left * v_right) / icr.slip_track
            v_left, v_right = v_left + more, v_right + more
            known |= {"slope": slope, "accel": nodes.accel * (1.0 + longer)}
        for name, value in self.channels.items():
            known[name] = self._between(np.asarray(value), pieces)
        return Motion(v_left, v_right, icr, known)

    def _between(self, value: FloatArray, pieces: Pieces) -> FloatArray:
        if not value.ndim:
            return value
        before, after = value[pieces.interval, None], value[pieces.interval + 1, None]
        return np.asarray(before + pieces.parts * (after - before))

    def largest_speed(self) -> float:
        """Return the largest absolute tread speed [m/s]."""
        most = 0.0
        for k in range(self.block_count):
            for part in self.parts(self.pieces(k)):
                for side in (part.motion.v_left, part.motion.v_right):
                    most = max(most, float(np.max(np.abs(side), initial=0.0)))
        return most

    # -- energy -------------------------------------------------------------------------------

    def power(self, pieces: Pieces, scale: float = 1.0) -> FloatArray:
        """Return the power at begin, middle and end of subintervals [W], shape (m, 3)."""
        out = np.empty((len(pieces.interval), 3))
        for part in self.parts(pieces, scale):
            out[part.which] = part.model.power(part.motion)
        return out

    def _rounding(self, pieces: Pieces, scale: float) -> float:
        """Return what rounding may leave of the power [W]: its terms may be in balance."""
        most = 0.0
        for part in self.parts(pieces, scale):
            terms = part.model.breakdown(part.motion).values()
            most = max(most, float(np.max(sum(np.abs(term) for term in terms))))
        return 4.0 * float(np.finfo(float).eps) * most

    def refined(
        self, pieces: Pieces, power: FloatArray, scale: float = 1.0
    ) -> Iterator[tuple[Pieces, FloatArray]]:
        """Yield subintervals with their mean power [W], halved until Simpson's rule gives it."""
        enough = PRECISION * float(np.mean(np.abs(power)))
        bent = np.abs(power[:, 0] - 2 * power[:, 1] + power[:, 2]) > enough
        if self.ground.surfaces is not None:
            regions = self.ground.regions(self._poses(pieces))
            bent |= (regions != regions[:, 1:2]).any(axis=1)
        mean = power @ SIMPSON
        yield pieces.take(~bent), mean[~bent]
        pieces, mean = pieces.take(bent), mean[bent]
        share = pieces.end - pieces.begin
        rounding = 0.0
        for k in range(HALVINGS):
            if not len(pieces.interval):
                return
            halves = pieces.halved()
            finer = self.power(halves, scale) @ SIMPSON
            # The tolerance applies to energy: a subinterval halved often may have a larger error.
            error = np.abs(0.5 * finer.reshape(-1, 2).sum(axis=1) - mean) / 15
            open_ = error * (pieces.end - pieces.begin) / share > enough
            if k == 0 and open_.any():
                rounding = self._rounding(halves, scale)
            open_ &= error > rounding
            again = np.repeat(open_, 2)
            yield halves.take(~again), finer[~again]
            pieces, mean, share = halves.take(again), finer[again], np.repeat(share[open_], 2)
        yield pieces, mean

    def time_by_region(self) -> FloatArray:
        """Return the time spent on the ground of each of the models [s]."""
        out = np.zeros(len(self.ground.models))
        for k in range(self.block_count):
            pieces = self.pieces(k)
            for _ in range(HALVINGS):
                regions = self.ground.regions(self._poses(pieces))
                crossing = (regions != regions[:, 1:2]).any(axis=1)
                np.add.at(out, regions[~crossing, 1], self.widths(pieces.take(~crossing)))
                pieces = pieces.take(crossing).halved()
                if not len(pieces.interval):
                    break
            np.add.at(out, self.ground.regions(self._poses(pieces))[:, 1], self.widths(pieces))
        return out

    def interval_energies(self, scale: float = 1.0) -> FloatArray:
        """Return the energy of each interval between samples [J], shape (n - 1,)."""
        out = np.zeros(len(self.trajectory) - 1)
        for k in range(self.block_count):
            pieces = self.pieces(k)
            for some, mean in self.refined(pieces, self.power(pieces, scale), scale):
                np.add.at(out, some.interval, mean * self.widths(some, scale))
        return out

    def energy(self, scale: float = 1.0) -> float:
        """Return the energy of the drive [J]."""
        return float(self.interval_energies(scale).sum())

    def quadrature(self) -> Iterator[Quadrature]:
        """Yield instants and weights that integrate powers over the drive, ground by ground."""
        for k in range(self.block_count):
            pieces = self.pieces(k)
            found = [some for some, _ in self.refined(pieces, self.power(pieces))]
            pieces = Pieces(*(np.concatenate(column) for column in zip(*found, strict=True)))
            weight = self.widths(pieces)[:, None] * SIMPSON
            for part in self.parts(pieces):
                yield Quadrature(
                    part.region, part.motion, weight[part.which], pieces.interval[part.which]
                )

    def breakdown(self) -> dict[str, float]:
        """Return the energy by term of the power models [J]; the values add up to `energy`."""
        total: dict[str, float] = {}
        models = self.ground.models
        for part in self.quadrature():
            for name, power in models[part.region].breakdown(part.motion).items():
                total[name] = total.get(name, 0.0) + float((part.weight * power).sum())
        return total

    def drawn(self, battery: BatteryModel, soc: float = 1.0) -> BatteryRun:
        """Run a battery through the drive."""
        return drawn(battery, self.trajectory.t, self.interval_energies(), soc)


def drawn(
    battery: BatteryModel, t: FloatArray, energies: FloatArray, soc: float = 1.0
) -> BatteryRun:
    """Run a battery through intervals between times [s] that take so much energy each [J]."""
    return battery.simulate(t, np.append(energies / np.diff(t), 0.0), soc=soc)
