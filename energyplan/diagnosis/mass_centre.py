"""Centre of mass from the way the robot moves (private).

A skid-steer robot turns about the point where friction balances, so that a centre of mass off
centre shows in its tread ICRs: ahead, the ICRs move ahead and the slip track shrinks; to the left,
the robot turns about a point further left. At given tread speeds the body's twist is the one that
loses the least power to friction; centripetal force adds a linear term.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares
from scipy.stats import f as fisher

from energyplan.diagnosis.result import Evidence, FoundEffect
from energyplan.errors import VehicleError
from energyplan.fit.drives.drive import Drive
from energyplan.fit.drives.windows import BLOCK
from energyplan.path import FloatArray
from energyplan.power.effects import Effect
from energyplan.vehicle import GRAVITY, Vehicle, wheel_loads

_SAMPLES = 500
_ROUNDS = 40
_SOFTENING = 1e-3  # slip speed below which friction is not fully developed [m/s]
_LEAST_OFFSET = 0.01  # centre of mass that is as good as centred [m]


@dataclass(frozen=True)
class MassCentre:
    """Centre of mass in the body frame."""

    forward: float  # offset [m]
    left: float  # offset [m]
    covariance: FloatArray  # (2, 2): of both [m^2], allowing for correlation within blocks
    improvement: float
    improvement_error: float
    p_value: float  # of a centred mass

    def effect(self, entry: Effect) -> FoundEffect:
        """Return it as an effect of a diagnosis."""
        offset = np.array([self.forward, self.left])
        size = float(np.hypot(*offset))
        along = offset / size
        return FoundEffect(
            entry.name, entry.symbol, size, entry.unit,
            float(np.sqrt(along @ self.covariance @ along)),
            Evidence(self.improvement, self.improvement_error, self.p_value),
            1.0 - self.p_value,
            (),
            {
                "forward": self.forward, "left": self.left,
                "forward_std_error": float(np.sqrt(self.covariance[0, 0])),
                "left_std_error": float(np.sqrt(self.covariance[1, 1])),
            },
            entry.meaning, entry.planner,
        )  # fmt: skip

    @property
    def found(self) -> bool:
        """Whether the offset is real, matters, and explains how the robot moves."""
        return (
            self.p_value < 1e-3
            and float(np.hypot(self.forward, self.left)) > _LEAST_OFFSET
            and self.improvement > max(0.2, 2 * self.improvement_error)
        )


def twist(
    vehicle: Vehicle, shares: FloatArray, left: FloatArray, right: FloatArray, lateral: FloatArray
) -> FloatArray:
    """Forward, sideways and yaw speed that lose the least power to friction."""
    x, y = vehicle.contacts.T
    tread = np.where(y > 0, left[:, None], right[:, None])
    ahead = np.stack([np.ones_like(x), np.zeros_like(x), -y], axis=1)
    aside = np.stack([np.zeros_like(x), np.ones_like(x), x], axis=1)
    both = ahead[:, :, None] * ahead[:, None] + aside[:, :, None] * aside[:, None]
    found = np.column_stack(
        [0.5 * (left + right), 0.0 * left, (right - left) / vehicle.icr.slip_track]
    )
    for _ in range(_ROUNDS):
        slip = np.hypot(found @ ahead.T - tread, found @ aside.T)
        weight = shares / np.hypot(slip, _SOFTENING)
        matrix = (weight @ both.reshape(-1, 9)).reshape(-1, 3, 3)
        target = (weight * tread) @ ahead
        target[:, 1] -= lateral
        before, found = found, np.linalg.solve(matrix, target[..., None])[..., 0]
        if np.max(np.abs(found - before)) < 1e-6:
            break
    return np.asarray(found)


def find_mass_centre(drives: Sequence[Drive], vehicle: Vehicle, mu: float) -> MassCentre | None:
    """Find the centre of mass from pose and tread speeds."""
    if not all({"x", "y", "yaw"} <= set(drive.motion.channels) for drive in drives):
        return None
    data, blocks = _turning(drives)
    if len(data) < 50:
        return None
    left, right, measured = data[:, 0], data[:, 1], data[:, 2:]
    lateral = measured[:, 0] * measured[:, 2] / (max(mu, 0.05) * GRAVITY)

    def residual(offset: FloatArray) -> FloatArray:
        try:
            loads = wheel_loads(vehicle.contacts, vehicle.mass, offset)
        except VehicleError:
            return np.full(measured.size, 10.0)  # a wheel would lift off: no such robot
        shares = loads / loads.sum()
        return np.ravel(twist(vehicle, shares, left, right, lateral) - measured)

    fitted = least_squares(
        residual, [0.01, 0.01], loss="soft_l1", f_scale=0.01, diff_step=(1e-3, 1e-3)
    )
    rows = np.reshape(np.asarray(fitted.jac), (len(data), 3, 2))
    errors = residual(fitted.x).reshape(-1, 3)
    scores = np.einsum("nki,nk->ni", rows, errors / np.sqrt(1 + (errors / 0.01) ** 2))
    _, index = np.unique(blocks, return_inverse=True)
    count = int(index.max()) + 1
    sums = np.zeros((count, 2))
    np.add.at(sums, index, scores)
    bread = np.linalg.pinv(np.einsum("nki,nkj->ij", rows, rows))
    covariance = bread @ (sums.T @ sums) @ bread * count / max(count - 2, 1)
    squared = float(fitted.x @ np.linalg.pinv(covariance) @ fitted.x)
    centred = _symmetric_error(left, right, measured)
    gaps = np.zeros(count)
    np.add.at(gaps, index, centred - np.sum(errors**2, axis=1))
    total = float(np.sum(centred))
    return MassCentre(
        float(fitted.x[0]), float(fitted.x[1]), covariance,
        float(gaps.sum()) / max(total, 1e-300),
        float(np.sqrt(count) * gaps.std(ddof=1)) / max(total, 1e-300),
        float(fisher.sf(squared / 2, 2, max(count - 2, 1))),
    )  # fmt: skip


def _symmetric_error(left: FloatArray, right: FloatArray, measured: FloatArray) -> FloatArray:
    """Squared error of the twist of symmetric tread ICRs with the best slip track."""
    difference = right - left
    rate = difference * float(difference @ measured[:, 2]) / float(difference @ difference)
    predicted = np.column_stack([0.5 * (left + right), 0.0 * left, rate])
    return np.asarray(np.sum((predicted - measured) ** 2, axis=1))


def _turning(drives: Sequence[Drive]) -> tuple[FloatArray, FloatArray]:
    """Pick turning windows: tread speeds and body twist, and the block of each."""
    rows, blocks, first = [], [], 0
    for drive in drives:
        motion, t = drive.motion, drive.t
        yaw = np.unwrap(motion.channels["yaw"])
        width = drive.windows[0]
        speeds = np.column_stack(
            [
                motion.v_left, motion.v_right, np.gradient(motion.channels["x"], t),
                np.gradient(motion.channels["y"], t), np.gradient(yaw, t),
            ]
        )  # fmt: skip
        cos, sin = np.cos(yaw), np.sin(yaw)
        forward = cos * speeds[:, 2] + sin * speeds[:, 3]
        aside = cos * speeds[:, 3] - sin * speeds[:, 2]
        twist_ = np.column_stack([speeds[:, :2], forward, aside, speeds[:, 4]])
        means = width.mean(twist_)
        rows.append(means)
        blocks.append(first + (t[width.starts] // BLOCK))
        first += int(t[-1] // BLOCK) + 1
    data, block = np.concatenate(rows), np.concatenate(blocks)
    turning = np.abs(data[:, 1] - data[:, 0]) > 0.1
    data, block = data[turning], block[turning]
    step = max(len(data) // _SAMPLES, 1)
    return data[::step], block[::step]
