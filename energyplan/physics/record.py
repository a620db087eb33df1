"""What the engine records of a drive."""

from __future__ import annotations

from dataclasses import dataclass

from energyplan.path import FloatArray, Pose

STEP = 0.002
"""Time step of the engine [s]."""
TICK = 5
"""Steps between two decisions of the controller."""
PERIOD = STEP * TICK
"""Time between two decisions of the controller [s]."""


@dataclass(frozen=True)
class Run:
    """What truly happened, in means over each tick of the controller."""

    t: FloatArray  # (n,): middle of each tick [s]
    x: FloatArray  # (n,): pose of the body's origin at that time [m], [rad]
    y: FloatArray  # (n,): pose of the body's origin at that time [m], [rad]
    yaw: FloatArray  # (n,): pose of the body's origin at that time [m], [rad]
    v: FloatArray  # (n,): speed along the heading [m/s] and yaw rate [rad/s]
    omega: FloatArray  # (n,): speed along the heading [m/s] and yaw rate [rad/s]
    v_left: FloatArray  # (n,): tread speeds [m/s]
    v_right: FloatArray  # (n,): tread speeds [m/s]
    force_left: FloatArray  # (n,): what each motor delivers at its tread [N]
    force_right: FloatArray  # (n,): what each motor delivers at its tread [N]
    shaft_left: FloatArray  # (n,): shaft power of each motor [W]
    shaft_right: FloatArray  # (n,): shaft power of each motor [W]
    battery_left: FloatArray  # (n,): what each side draws from the battery [W]
    battery_right: FloatArray  # (n,): what each side draws from the battery [W]
    hotel: float  # what is drawn beside them [W]
    accel_x: FloatArray  # (n,): forward reading of an accelerometer, gravity included [m/s^2]
    slope: FloatArray  # (n,): slope of the ground along the heading [rad]
    energy: dict[str, float]  # [J]
    closure: float  # what the motors did beyond all mechanical terms [J]

    @property
    def period(self) -> float:
        """Time between two ticks [s]."""
        return PERIOD

    @property
    def power(self) -> FloatArray:
        """What the battery delivers [W]."""
        return self.battery_left + self.battery_right + self.hotel

    @property
    def taken(self) -> float:
        """Energy that the battery delivered [J]."""
        return float(self.power.sum() * self.period)


@dataclass(frozen=True)
class State:
    """What a controller is told: time [s], pose [m], [rad], and tread speeds [m/s]."""

    t: float
    pose: Pose
    v_left: float
    v_right: float
