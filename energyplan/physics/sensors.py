"""The robot's sensors: they turn a drive in the engine into a `DriveLog`."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Literal

import numpy as np
from pydantic import TypeAdapter, ValidationError

from energyplan.errors import InvalidInputError, UnknownNameError
from energyplan.logs import DriveLog
from energyplan.path import FloatArray
from energyplan.physics.engine import Run


@dataclass(frozen=True)
class Sensors:
    """How a drive is recorded."""

    rate: float = 20.0  # samples per second [Hz]
    power_noise: float = 2.0  # standard deviation of each side's power [W]
    speed_noise: float = 0.002  # [m/s]
    speed_step: float = 0.0  # [m/s]
    current_step: float = 0.0  # [A]
    pose_noise: float = 0.0
    yaw_noise: float = 0.0
    delay: float = 0.0  # by how much power is logged later than speed [s]
    unsigned: bool = False  # whether the sensors of the sides lose the sign of the power
    measured: Literal["sides", "total", "battery"] = "sides"
    voltage: float = 24.0  # battery voltage [V]
    without: tuple[str, ...] = ()  # channels that the log does not have
    seed: int = 0  # seed of the noise

    def __post_init__(self) -> None:
        if self.measured not in ("sides", "total", "battery"):
            raise UnknownNameError(
                "way to measure power", str(self.measured), ("sides", "total", "battery")
            )
        for item in fields(self):
            value = getattr(self, item.name)
            if isinstance(value, float | int) and not isinstance(value, bool):
                positive = item.name in ("rate", "voltage")
                if not np.isfinite(value) or value < 0 or (positive and value == 0):
                    raise InvalidInputError(
                        f"{item.name} is {value}; give a {'positive ' * positive}number"
                        f"{'' if positive else ' >= 0'}"
                    )

    @classmethod
    def parse(cls, text: str, seed: int = 0) -> Sensors:
        """Return the sensors that ``NAME=VALUE,NAME=VALUE`` stands for."""
        known = [item.name for item in fields(cls) if item.name not in ("without", "seed")]
        given: dict[str, str] = {}
        for part in filter(None, text.split(",")):
            name, _, value = (word.strip() for word in part.partition("="))
            if name not in known:
                raise UnknownNameError("property of sensors", name, known)
            given[name] = value
        try:
            return TypeAdapter(cls).validate_python({**given, "seed": seed})
        except ValidationError as problem:
            wrong = problem.errors(include_url=False)[0]
            place = ".".join(map(str, wrong["loc"]))
            raise InvalidInputError(
                f"sensors {text!r}: {place + ': ' * bool(place)}{wrong['msg']}; write NAME=VALUE, "
                "like rate=50,measured=battery"
            ) from None

    def log(self, run: Run, name: str = "engine drive") -> DriveLog:
        """Return a drive as these sensors record it."""
        wide = max(1, round(1.0 / (self.rate * run.period)))
        count = len(run.t) // wide
        if count < 2:
            raise InvalidInputError(
                f"the drive of {len(run.t) * run.period:.2f} s is too short for two samples at "
                f"{self.rate:g} Hz; give a higher rate or a longer drive"
            )

        def mean(values: FloatArray) -> FloatArray:
            return np.asarray(values[: count * wide].reshape(count, wide).mean(axis=1))

        rng = np.random.default_rng([self.seed, 0x106])

        def noisy(values: FloatArray, deviation: float) -> FloatArray:
            return values + deviation * rng.standard_normal(count)

        t = mean(run.t)
        speeds = [noisy(mean(v), self.speed_noise) for v in (run.v_left, run.v_right)]
        if self.speed_step:
            speeds = [np.round(v / self.speed_step) * self.speed_step for v in speeds]
        drawn = [power + run.hotel / 2 for power in (run.battery_left, run.battery_right)]
        sides = [noisy(self._late(t, mean(p)), self.power_noise) for p in drawn]
        channels = {"t": t, "v_left": speeds[0], "v_right": speeds[1], **self._power(sides)}
        channels |= {
            "x": noisy(mean(run.x), self.pose_noise),
            "y": noisy(mean(run.y), self.pose_noise),
            "yaw": noisy(mean(run.yaw), self.yaw_noise),
            "yaw_rate": noisy(mean(run.omega), self.yaw_noise),
            "accel_x": mean(run.accel_x),
        }
        if np.any(run.slope != 0.0):
            channels["slope"] = mean(run.slope)
        for channel in sorted(set(self.without) - {*channels, "slope"}):
            raise UnknownNameError("channel of this drive", channel, channels)
        kept = {key: values for key, values in channels.items() if key not in self.without}
        return DriveLog(kept, name)

    def _late(self, t: FloatArray, power: FloatArray) -> FloatArray:
        return np.interp(t - self.delay, t, power) if self.delay else power

    def _power(self, sides: list[FloatArray]) -> dict[str, FloatArray]:
        if self.measured == "sides":
            seen = [self._read(p) for p in sides]
            return {"p_left": seen[0], "p_right": seen[1]}
        total = sides[0] + sides[1]
        if self.measured == "total":
            return {"power": self._read(total)}
        current = self._read(total) / self.voltage
        return {"voltage": np.full_like(current, self.voltage), "current": current}

    def _read(self, power: FloatArray) -> FloatArray:
        """Round the current behind a power, and lose its sign, as the sensor does."""
        if self.current_step:
            step = self.current_step * self.voltage
            power = np.trunc(power / step) * step
        return np.abs(power) if self.unsigned else power
