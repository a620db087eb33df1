"""Friction inside a robot, from drives with its wheels in the air."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from energyplan.errors import InvalidInputError, NotIdentifiableError
from energyplan.fit.covariance import autocorrelation
from energyplan.logs import DriveLog
from energyplan.logs.checks import find_checks
from energyplan.logs.consistency import correlation, distance_ratio, lasts, yaw_rates
from energyplan.path import FloatArray

_SLOWEST = 0.05  # tread speed from which a side turns [m/s]
_BIN = 0.1  # width of the speed classes that are told [m/s]
_STEADY = 0.15  # largest tread acceleration of a steady sample [m/s^2]
_ENOUGH = 20
_TRAVEL = {"x", "y", "yaw", "yaw_rate", "accel_x"}
_TOGETHER = 0.7  # correlation of the turning with the treads' of a robot that drives
_PILED = 0.05  # share of moving readings at the least one, from which it is a dead band


@dataclass(frozen=True)
class SpeedClass:
    """Mean force of a side in a class of speeds."""

    speed: float  # mean tread speed [m/s]
    force: float  # mean force at the tread [N]
    std_error: float  # its standard error [N]
    samples: int  # how many samples


@dataclass(frozen=True)
class InternalFriction:
    """Friction inside one side of the robot, ``F(v) = force + slope * (|v| - speed)``."""

    side: str  # the side
    force: float  # force at the mean speed of the drives, and its standard error [N]
    force_error: float  # force at the mean speed of the drives, and its standard error [N]
    speed: float  # that mean speed [m/s]
    slope: float  # how the force changes with the tread speed, and its standard error [N s/m]
    slope_error: float  # how the force changes with the tread speed, and its standard error [N s/m]
    classes: tuple[SpeedClass, ...]  # the force by speed
    left_out: int  # moving samples in the sensor's dead band, which give only an upper limit

    @property
    def power_without_speed(self) -> bool:
        """Whether the force falls with speed as if the power did not depend on it."""
        steep = self.slope < -0.5 * self.force / self.speed
        return steep and self.slope < -3 * self.slope_error


def hoisted(
    logs: DriveLog | Sequence[DriveLog], motor_constant: float | None = None
) -> tuple[InternalFriction, ...]:
    """Find the friction inside each side from drives with the wheels in the air.

    Nothing but the friction of motor, gear, chain and bearings resists then. Samples of steady
    speed are used, so that no inertia counts.

    Source: Morales et al. (2010), section IV: 59 N were found so.
    """
    drives = [logs] if isinstance(logs, DriveLog) else list(logs)
    for log in drives:
        _refuse_driving(log)
    return tuple(_side(drives, side, motor_constant) for side in ("left", "right"))


def _refuse_driving(log: DriveLog) -> None:
    """Refuse a drive on the ground, where slip and rolling resist too."""
    difference = log.channels["v_right"] - log.channels["v_left"]
    rates = yaw_rates(log.channels, log.runs)
    turns = [name for name, rate in rates.items()
             if lasts(rate) and correlation(rate, difference) > _TOGETHER]  # fmt: skip
    goes = np.isfinite(distance_ratio(log.channels, log.runs))
    if turns or goes:
        raise NotIdentifiableError(
            f"{log.name}: {turns[0] if turns else 'the pose'} follows the treads, so the wheels "
            "were on the ground; what resists them there is not the friction inside: leave out "
            "--hoisted, or give drives with the wheels in the air"
        )


def doubts_off_the_ground(log: DriveLog) -> tuple[str, ...]:
    """Return the warnings of a log that hold for a robot whose wheels are in the air.

    It neither travels nor turns: what its pose or yaw rate would contradict on the ground, or lag
    behind, is as it should be.
    """
    power, runs = log.power, log.runs
    kept = {name: v for name, v in log.channels.items() if name not in _TRAVEL}
    stale = {*map(str, find_checks(log.channels, power, runs))} - {
        *map(str, find_checks(kept, power, runs))
    }
    return tuple(warning for warning in log.warnings if warning not in stale)


def _side(drives: Sequence[DriveLog], side: str, constant: float | None) -> InternalFriction:
    """Find one side's friction."""
    channel = f"p_{side}" if constant is None else f"current_{side}"
    speeds: list[FloatArray] = []
    forces: list[FloatArray] = []
    lost = 0
    for log in drives:
        if not log.has(channel):
            raise InvalidInputError(
                f"{log.name}: there is no {channel}, and the friction of each side needs "
                f"both; map a column to it, as in {channel}=NAME"
            )
        speed = np.abs(log.channel(f"v_{side}"))
        reading = np.abs(log.channel(channel))
        change = np.gradient(_smooth(speed), log.t)
        moving = (speed > _SLOWEST) & (np.abs(change) < _STEADY)
        if not np.any(moving):
            continue
        if constant is not None:
            floor = float(reading[moving].min())
            piled = moving & (reading <= floor * 1.01 + 1e-12)
            if np.count_nonzero(piled) > _PILED * np.count_nonzero(moving):
                lost += int(np.count_nonzero(piled))
                # What the sensor does not tell lies between nothing and its dead band.
                reading = np.where(piled, 0.5 * floor, reading)
            force = constant * reading
        else:
            force = reading / np.maximum(speed, _SLOWEST)
        speeds.append(speed[moving])
        forces.append(force[moving])
    if not speeds or sum(map(len, speeds)) < _ENOUGH:
        raise NotIdentifiableError(
            f"the {side} side hardly turns at a steady speed: drive it for half a minute at two "
            "speeds or more"
        )
    v, force = np.concatenate(speeds), np.concatenate(forces)
    mean = float(v.mean())
    X = np.stack([np.ones(len(v)), v - mean], axis=1)
    spread = float(np.ptp(v)) > _BIN
    X = X if spread else X[:, :1]
    inverse = np.linalg.inv(X.T @ X)
    found = inverse @ X.T @ force
    residual = force - X @ found
    ends = np.cumsum([0, *map(len, speeds)])
    pieces = [slice(int(a), int(b)) for a, b in pairwise(ends)]
    repeats = autocorrelation(residual, pieces).repeats
    variance = float(residual @ residual) / max(len(v) - X.shape[1], 1) * repeats
    errors = np.sqrt(variance * np.diag(inverse))
    return InternalFriction(
        side, float(found[0]), float(errors[0]), mean,
        float(found[1]) if spread else 0.0, float(errors[1]) if spread else np.inf,
        _classes(v, force, repeats), lost,
    )  # fmt: skip


def _classes(speed: FloatArray, force: FloatArray, repeats: float) -> tuple[SpeedClass, ...]:
    number = np.round(speed / _BIN).astype(int)
    made = []
    for k in np.unique(number):
        some = force[number == k]
        if len(some) >= _ENOUGH:
            error = float(some.std() * np.sqrt(min(repeats, len(some)) / len(some)))
            at = float(speed[number == k].mean())
            made.append(SpeedClass(at, float(some.mean()), error, len(some)))
    return tuple(made)


def _smooth(values: FloatArray) -> FloatArray:
    """Return running means over nine samples: encoders beat."""
    padded = np.pad(values, 4, mode="edge")
    return np.convolve(padded, np.full(9, 1 / 9), mode="valid")
