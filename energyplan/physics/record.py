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
    """What truly happened, in means over each tick of the controller.

    Parameters
    ----------
    t : ndarray, shape (n,)
        Middle of each tick [s].
    x, y, yaw : ndarray, shape (n,)
        Pose of the body's origin at that time [m], [rad].
    v, omega : ndarray, shape (n,)
        Speed along the heading [m/s] and yaw rate [rad/s].
    v_left, v_right : ndarray, shape (n,)
        Tread speeds: wheel speed times radius [m/s].
    force_left, force_right : ndarray, shape (n,)
        What each motor delivers at its tread [N].
    shaft_left, shaft_right : ndarray, shape (n,)
        Shaft power of each motor [W].
    battery_left, battery_right : ndarray, shape (n,)
        What each side draws from the battery [W].
    hotel : float
        What is drawn beside them [W].
    accel_x : ndarray, shape (n,)
        Forward reading of an accelerometer, gravity included [m/s^2].
    slope : ndarray, shape (n,)
        Slope of the ground along the heading [rad].
    energy : dict of str to float
        Where the battery's energy went, by the term of a power model that stands for it [J]. Of
        what no term stands for, ``contacts`` is what wheels take that are pressed into the ground.
    closure : float
        What the motors did beyond all mechanical terms [J]: the engine's own error.

    Examples
    --------
    >>> from energyplan.physics import Engine, Robot
    >>> from energyplan.power import PowerModel
    >>> robot = Robot.from_model(PowerModel.preset("quadriga:empty:concrete"))
    >>> run = Engine(robot).drive(lambda state: 2 * (min(0.5, state.t),) if state.t < 2.0 else None)
    >>> round(float(run.x[-1]), 1), run.taken > 0, round(run.period, 3)
    (0.9, True, 0.01)
    """

    t: FloatArray
    x: FloatArray
    y: FloatArray
    yaw: FloatArray
    v: FloatArray
    omega: FloatArray
    v_left: FloatArray
    v_right: FloatArray
    force_left: FloatArray
    force_right: FloatArray
    shaft_left: FloatArray
    shaft_right: FloatArray
    battery_left: FloatArray
    battery_right: FloatArray
    hotel: float
    accel_x: FloatArray
    slope: FloatArray
    energy: dict[str, float]
    closure: float

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
    """What a controller is told: time [s], pose [m], [rad], and tread speeds [m/s].

    Examples
    --------
    >>> State(t=0.0, pose=Pose(1.0, 2.0, 0.0), v_left=0.5, v_right=0.5).pose.x
    1.0
    """

    t: float
    pose: Pose
    v_left: float
    v_right: float
