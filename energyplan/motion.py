"""What a power term needs to know at each instant, and kinematics both ways."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from energyplan.errors import InvalidInputError, MissingChannelError
from energyplan.path import FloatArray, Pose, Trajectory
from energyplan.records import ByValue, checked, instance, numbers
from energyplan.vehicle import TreadICR


class Channel(NamedTuple):
    """What a channel holds: its meaning, its unit, and the range in which readings are possible."""

    meaning: str
    unit: str
    least: float
    most: float


LOGGED = {
    "t": Channel("time", "s", -1e11, 1e11),
    "x": Channel("position", "m", -1e8, 1e8),
    "y": Channel("position", "m", -1e8, 1e8),
    "v_left": Channel("speed of the left tread", "m/s", -20.0, 20.0),
    "v_right": Channel("speed of the right tread", "m/s", -20.0, 20.0),
    "cmd_left": Channel("left tread speed that the controller wants", "m/s", -20.0, 20.0),
    "cmd_right": Channel("right tread speed that the controller wants", "m/s", -20.0, 20.0),
    "p_left": Channel("power of the left side", "W", -5e4, 5e4),
    "p_right": Channel("power of the right side", "W", -5e4, 5e4),
    "power": Channel("power of both sides", "W", -1e5, 1e5),
    "voltage": Channel("voltage of the battery", "V", 0.0, 1500.0),
    "current": Channel("current of the battery", "A", -2000.0, 2000.0),
    "yaw": Channel("heading", "rad", -1e6, 1e6),
    "slope": Channel(
        "ground slope along the heading, positive when climbing along +x", "rad", -1.2, 1.2
    ),
    "yaw_rate": Channel("measured yaw rate", "rad/s", -20.0, 20.0),
    "accel_x": Channel("accelerometer's forward reading, gravity included", "m/s^2", -200.0, 200.0),
    "temperature": Channel("temperature", "degC", -100.0, 300.0),
    "payload": Channel("payload", "kg", 0.0, 1e5),
}
"""Channels that a log may hold. Units that they may be read in come with the unit."""

_SPEEDS_AND_POWERS = {"v_left", "v_right", "p_left", "p_right", "power", "voltage", "current"}

CHANNELS = {
    **{
        name: f"{one.meaning} [{one.unit}]"
        for name, one in LOGGED.items() if name not in _SPEEDS_AND_POWERS
    },
    "accel": "rate of change of the forward speed [m/s^2]",
    "yaw_accel": "rate of change of the yaw rate [rad/s^2]",
}  # fmt: skip
"""Channels that a motion may carry besides its tread speeds."""


def _common_shape(arrays: Mapping[str, FloatArray]) -> tuple[int, ...]:
    """Return the shape of all arrays together."""
    try:
        return np.broadcast_shapes(*{array.shape for array in arrays.values()})
    except ValueError:
        shapes = {name: value.shape for name, value in arrays.items()}
        raise InvalidInputError(f"channels do not broadcast together: {shapes}") from None


def _broadcast(array: FloatArray, shape: tuple[int, ...]) -> FloatArray:
    """Return a read-only view of this shape: `numpy.broadcast_to`, quicker where it is trivial."""
    if array.shape == shape:
        view = array.view()
    elif array.ndim == 0:
        view = np.ndarray(shape, float, array, strides=(0,) * len(shape))
    else:
        return np.broadcast_to(array, shape)
    view.flags.writeable = False
    return view


@dataclass(frozen=True, eq=False)
class Motion(ByValue):
    """Tread speeds and further channels at each instant; arrays of one shape.

    Parameters
    ----------
    v_left, v_right : array_like, shape (...)
        Tread speeds along +x, wheel speed times radius [m/s].
    icr : TreadICR
        Tread ICRs that turn tread speeds into body motion.
    channels : mapping of str to array_like, shape (...)
        Further channels (`CHANNELS` or a user's own), broadcast against the speeds.

    Raises
    ------
    InvalidInputError
        If the shapes do not broadcast.

    Examples
    --------
    >>> motion = Motion(0.4, 0.6, TreadICR.symmetric(0.5))
    >>> round(float(motion.v), 3), round(float(motion.omega), 3)
    (0.5, 0.2)
    """

    v_left: FloatArray
    v_right: FloatArray
    icr: TreadICR
    channels: Mapping[str, FloatArray] = field(default_factory=dict)

    def __post_init__(self) -> None:
        left, right = numbers(self.v_left, "v_left"), numbers(self.v_right, "v_right")
        others = {name: numbers(value, name) for name, value in self.channels.items()}
        instance(self.icr, TreadICR, "icr")
        shape = _common_shape({"v_left": left, "v_right": right, **others})
        object.__setattr__(self, "v_left", _broadcast(left, shape))
        object.__setattr__(self, "v_right", _broadcast(right, shape))
        wide = {name: _broadcast(value, shape) for name, value in others.items()}
        object.__setattr__(self, "channels", MappingProxyType(wide))

    @property
    def shape(self) -> tuple[int, ...]:
        """Common shape of all channels."""
        return self.v_left.shape

    @cached_property
    def omega(self) -> FloatArray:
        """Yaw rate from the tread speeds [rad/s] (Eq. 1)."""
        return np.asarray((self.v_right - self.v_left) / self.icr.slip_track)

    @cached_property
    def v(self) -> FloatArray:
        """Speed of the body's origin along +x [m/s]."""
        icr = self.icr
        return np.asarray((icr.right * self.v_left + icr.left * self.v_right) / icr.slip_track)

    def channel(self, name: str, needed_by: str = "a power term") -> FloatArray:
        """Return a channel.

        Parameters
        ----------
        name : str
            Name of the channel.
        needed_by : str
            What needs it, for the message.

        Returns
        -------
        ndarray, shape (...)
            The channel.

        Raises
        ------
        MissingChannelError
            If the motion does not carry it.
        """
        try:
            return self.channels[name]
        except KeyError:
            what = CHANNELS.get(name, "a channel of its own")
            raise MissingChannelError(
                f"{needed_by} needs the channel {name!r}: {what}; this motion has "
                f"{', '.join(sorted(self.channels)) or 'none'}"
            ) from None

    def with_channels(self, **channels: ArrayLike) -> Motion:
        """Return this motion with channels added or replaced."""
        merged = {**self.channels, **{k: np.asarray(v, float) for k, v in channels.items()}}
        return Motion(self.v_left, self.v_right, self.icr, merged)

    @classmethod
    def from_twist(
        cls, v: ArrayLike, omega: ArrayLike, icr: TreadICR, **channels: ArrayLike
    ) -> Motion:
        """Build a motion from forward speed [m/s] and yaw rate [rad/s].

        Parameters
        ----------
        v, omega : array_like, shape (...)
            Forward speed of the body's origin and yaw rate.
        icr : TreadICR
            Tread ICRs.
        **channels : array_like, shape (...)
            Further channels.

        Returns
        -------
        Motion
            Motion with ``v_left = v - left omega`` and ``v_right = v + right omega``.
        """
        speed, rate = numbers(v, "v"), numbers(omega, "omega")
        instance(icr, TreadICR, "icr")
        _common_shape({"v": speed, "omega": rate})
        known = {name: numbers(value, name) for name, value in channels.items()}
        return cls(speed - icr.left * rate, speed + icr.right * rate, icr, known)

    @classmethod
    @checked()
    def from_trajectory(
        cls, trajectory: Trajectory, icr: TreadICR, **channels: ArrayLike
    ) -> Motion:
        """Build the motion along a trajectory, with time, pose and accelerations as channels.

        Accelerations are second-order differences of the speeds. The ground is level unless a
        `slope` is given.
        """
        t = trajectory.t
        known: dict[str, ArrayLike] = {
            "t": t,
            "x": trajectory.x,
            "y": trajectory.y,
            "yaw": trajectory.yaw,
            "accel": np.gradient(trajectory.v, t),
            "yaw_accel": np.gradient(trajectory.omega, t),
            "slope": 0.0,
        }
        return cls.from_twist(trajectory.v, trajectory.omega, icr, **{**known, **channels})


_NODES = 0.5 + 0.5 * np.array([-(0.6**0.5), 0.0, 0.6**0.5])  # Gauss-Legendre, order six
_WEIGHTS = np.array([5.0, 8.0, 5.0]) / 18.0


def travelled(
    start: Pose,
    step: FloatArray,
    v: tuple[FloatArray, FloatArray],
    omega: tuple[FloatArray, FloatArray],
    ahead: FloatArray | float,
) -> FloatArray:
    """Poses from speeds that are linear in each step, given at both ends, shape (n + 1, 3).

    The origin lies `ahead` behind the point that never moves sideways [m].
    """
    rotation = np.concatenate([[0.0], np.cumsum(0.5 * step * (omega[0] + omega[1]))])
    yaw, u = start.yaw + rotation, _NODES[:, None]
    theta = yaw[:-1] + step * (u * omega[0] + 0.5 * u**2 * (omega[1] - omega[0]))
    along = v[0] + u * (v[1] - v[0])
    aside = ahead * (omega[0] + u * (omega[1] - omega[0]))
    dx = step * (_WEIGHTS @ (along * np.cos(theta) + aside * np.sin(theta)))
    dy = step * (_WEIGHTS @ (along * np.sin(theta) - aside * np.cos(theta)))
    x, y = (np.concatenate([[at], at + np.cumsum(d)]) for at, d in ((start.x, dx), (start.y, dy)))
    return np.column_stack([x, y, yaw])
