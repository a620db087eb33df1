"""Drive logs: named channels over time, checked where they are built."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from energyplan.errors import DriveLogError
from energyplan.motion import Motion
from energyplan.path import FloatArray
from energyplan.power import Sides
from energyplan.vehicle import TreadICR


@dataclass(frozen=True)
class DriveLog:
    """One drive: named channels over time.

    Parameters
    ----------
    channels : mapping of str to array_like, shape (n,)
        ``t`` [s], ``v_left`` and ``v_right`` [m/s], and power as ``p_left`` and ``p_right`` [W],
        or ``power`` [W], or ``voltage`` [V] with ``current`` [A]; further channels as in
        `energyplan.motion.CHANNELS`.
    name : str
        What to call the log in messages.

    Raises
    ------
    DriveLogError
        If a channel is missing or malformed.
    """

    channels: Mapping[str, FloatArray]
    name: str = "log"

    def __post_init__(self) -> None:
        arrays = {key: np.array(value, float) for key, value in self.channels.items()}
        for key in ("t", "v_left", "v_right"):
            if key not in arrays:
                raise DriveLogError(f"{self.name}: channel {key!r} is missing")
        for value in arrays.values():
            value.setflags(write=False)
        object.__setattr__(self, "channels", MappingProxyType(arrays))

    def __len__(self) -> int:
        return len(self.t)

    def has(self, channel: str) -> bool:
        """Tell whether the log carries a channel."""
        return channel in self.channels

    @property
    def t(self) -> FloatArray:
        """Time [s]."""
        return self.channels["t"]

    @property
    def sides(self) -> Sides | None:
        """Measured power of each side [W], or None where only the total was logged."""
        if self.has("p_left") and self.has("p_right"):
            return Sides(self.channels["p_left"], self.channels["p_right"])
        return None

    @property
    def power(self) -> FloatArray:
        """Measured total power [W], positive when drawn."""
        sides = self.sides
        if sides is not None:
            return sides.total
        if self.has("power"):
            return self.channels["power"]
        return np.asarray(self.channels["voltage"] * self.channels["current"])

    def motion(self, icr: TreadICR) -> Motion:
        """Return the log as a motion, with accelerations derived from the tread speeds."""
        speeds = ("v_left", "v_right")
        others = {key: value for key, value in self.channels.items() if key not in speeds}
        motion = Motion(self.channels["v_left"], self.channels["v_right"], icr, others)
        return motion.with_channels(
            accel=np.gradient(motion.v, self.t), yaw_accel=np.gradient(motion.omega, self.t)
        )
