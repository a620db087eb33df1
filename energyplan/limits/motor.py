"""Limits at one instant: the loads of a motion on motors and battery, against what they can do.

Shared by `feasibility`, which tests a given motion, and `speed`, which looks for the fastest or
cheapest one inside the same limits. Both evaluate the whole power model, so that an effect found
in data limits the robot as much as the paper's two terms do.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from energyplan.cost.speeds import last_within
from energyplan.errors import InvalidInputError
from energyplan.motion import Motion
from energyplan.path import ROUNDING, FloatArray
from energyplan.power import PowerModel
from energyplan.vehicle import MotorLimits, Vehicle

UNITS = {
    "peak_power": "W",
    "continuous_power": "W",
    "regeneration": "W",
    "force": "N",
    "speed": "m/s",
    "ground_speed": "m/s",
    "acceleration": "m/s^2",
    "yaw_rate": "rad/s",
    "lateral_acceleration": "m/s^2",
    "battery_power": "W",
    "battery_return": "W",
}
"""Every kind of limit, with its unit."""


class Limit(NamedTuple):
    """One limit of one side: what `Limits.loads` compares with."""

    kind: str
    side: str
    limit: float

    def exceeded_by(self, value: FloatArray) -> NDArray[np.bool_]:
        """Whether values are above the limit by more than rounding."""
        return np.asarray(value > self.limit + self.tolerance)

    @property
    def tolerance(self) -> float:
        """What rounding may add to a value at the limit, in its unit."""
        return ROUNDING * max(self.limit, 1.0)

    def describe(self, value: float) -> str:
        """Compare a value with the limit in words, for messages."""
        what = self.kind.replace("_", " ")
        unit = UNITS[self.kind]
        whose = "" if self.side == "both" else f"{self.side} side's "
        return f"the {whose}{what} is {value:.4g} {unit} against a limit of {self.limit:.4g} {unit}"


@dataclass(frozen=True)
class Limits:
    """Limits that hold at every instant; infinite where there is none."""

    motor: MotorLimits = field(default_factory=MotorLimits)  # limits of each side's motor
    yaw_rate: float = np.inf  # largest yaw rate [rad/s]
    lateral_acceleration: float = np.inf  # largest ``|v omega|`` [m/s^2]
    battery_power: float = np.inf  # largest power that the battery delivers [W]
    battery_return: float = np.inf  # largest power that the battery accepts [W]

    def __post_init__(self) -> None:
        for name in ("yaw_rate", "lateral_acceleration", "battery_power", "battery_return"):
            if not getattr(self, name) >= 0:
                raise InvalidInputError(f"{name} is {getattr(self, name)}; give a number >= 0")

    @classmethod
    def of(
        cls,
        vehicle: Vehicle,
        *,
        lateral_acceleration: float = np.inf,
        battery_power: float = np.inf,
        battery_return: float = np.inf,
    ) -> Limits:
        """Return the limits of a vehicle; those that are given may only be tighter."""
        return cls(
            vehicle.motor, vehicle.max_yaw_rate, lateral_acceleration,
            min(battery_power, vehicle.battery_power), min(battery_return, vehicle.battery_return),
        )  # fmt: skip

    @property
    def sustained(self) -> Limits:
        """The limits of a motion that goes on for ever: continuous instead of peak power."""
        power = min(self.motor.continuous_power, self.motor.peak_power)
        return replace(self, motor=replace(self.motor, continuous_power=power, peak_power=power))

    @cached_property
    def bounds(self) -> tuple[Limit, ...]:
        """Every finite limit, in the order of `loads`."""
        motor = self.motor
        both = [
            Limit(kind, side, limit)
            for kind, limit in (
                ("peak_power", motor.peak_power),
                ("regeneration", motor.regeneration),
                ("force", motor.force),
                ("speed", motor.speed),
            )
            for side in ("left", "right")
        ]
        whole = [
            Limit("yaw_rate", "both", self.yaw_rate),
            Limit("lateral_acceleration", "both", self.lateral_acceleration),
            Limit("battery_power", "both", self.battery_power),
            Limit("battery_return", "both", self.battery_return),
        ]
        return tuple(bound for bound in both + whole if np.isfinite(bound.limit))

    def loads(self, model: PowerModel, motion: Motion) -> Loads:
        """Evaluate the loads of a motion.

        Shaft power is tread force times tread speed; losses between battery and shaft count
        towards the battery's limits, not the motor's.
        """
        forces = model.forces(motion)
        left, right = forces.left * motion.v_left, forces.right * motion.v_right
        battery: FloatArray | None = None
        values = []
        for kind, side, _ in self.bounds:
            power, force, speed = (
                (left, forces.left, motion.v_left)
                if side == "left"
                else (right, forces.right, motion.v_right)
            )
            match kind:
                case "peak_power":
                    values.append(power)
                case "regeneration":
                    values.append(-power)
                case "force":
                    values.append(np.abs(force))
                case "speed":
                    values.append(np.abs(speed))
                case "yaw_rate":
                    values.append(np.abs(motion.omega))
                case "lateral_acceleration":
                    values.append(np.abs(motion.v * motion.omega))
                case _:
                    if battery is None:
                        battery = model.battery_side().power(motion)
                    values.append(battery if kind == "battery_power" else -battery)
        return Loads(left, right, values)

    def use(self, model: PowerModel, motion: Motion) -> FloatArray:
        """Largest load relative to its limit at each instant; above 1 a limit is exceeded."""
        worst = np.zeros(motion.shape)
        for bound, value in zip(self.bounds, self.loads(model, motion).values, strict=True):
            np.maximum(worst, relative(value, bound.limit), out=worst)
        return worst

    def room(self, model: PowerModel, motion: Motion) -> Room:
        """Return what the limits leave of the motion at each instant."""
        steady = motion.with_channels(accel=0.0, yaw_accel=0.0)
        room = Room(*(np.full(motion.shape, value) for value in (np.inf, 1.0)))
        loads = (self.loads(model, one).values for one in (steady, motion))
        for bound, before, now in zip(self.bounds, *loads, strict=True):
            over, change, limit = bound.exceeded_by(now), now - before, bound.limit
            left = np.maximum(limit + 0.5 * bound.tolerance - before, 0.0)
            share = np.divide(left, change, out=np.full_like(left, np.inf), where=change > 1e-12)
            np.minimum(room.share, share, out=room.share)
            if over.any():
                fast = bound.exceeded_by(before) & over
                # before s + change s^2 = limit; a force stays as it is when the robot is slower
                root = np.sqrt(np.maximum(before**2 + 4.0 * change * limit, 0.0))
                scale = np.where(before > 0, 2.0 * limit, root - before)
                scale /= np.where(before > 0, before + root, 2.0 * np.where(over, change, 1.0))
                if bound.kind == "force":
                    scale = np.where(fast, limit / now, np.sqrt(share))
                np.minimum(room.scale, np.where(over, np.maximum(scale, 0.5), 1.0), out=room.scale)
                room.share[fast] = -1.0
        return room


class Room(NamedTuple):
    """What limits leave of motions."""

    share: FloatArray  # part of the acceleration within limits [1]; -1 where a steady speed is not
    scale: FloatArray  # part of the speed within limits [1], a half at least


class Loads(NamedTuple):
    """Shaft power of each side [W] and the value that each bound limits."""

    left: FloatArray
    right: FloatArray
    values: list[FloatArray]


def relative(value: FloatArray, limit: float) -> FloatArray:
    """Return value over limit; for a limit of zero, infinite where the value is positive."""
    if limit > 0:
        return np.asarray(value / limit)
    return np.where(value > ROUNDING, np.inf, 0.0)


def largest_within(
    use: Callable[[FloatArray], FloatArray], top: FloatArray, rungs: int = 64
) -> FloatArray:
    """Largest value up to which a limit's use stays at or below 1, elementwise."""
    parts = np.linspace(0.0, 1.0, rungs + 1)
    parts[0] = 1e-6  # friction has a direction only in motion
    exceeded = use(parts[:, None] * top) > 1
    never = ~exceeded.any(axis=0)
    first = np.argmax(exceeded, axis=0)
    # Nothing is left to look for where all or none of the values are within.
    low = np.where(never, 1.0, np.where(first > 0, parts[first - 1], 0.0)) * top
    high = np.where(first > 0, parts[first] * top, low)
    return low if np.array_equal(low, high) else last_within(use, low, high)
