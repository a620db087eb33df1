"""What readings a robot's channels can hold, and the unit of those that they cannot."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from energyplan.path import FloatArray

LIMITS = {
    "t": (-1e11, 1e11, "s"),
    "v_left": (-20.0, 20.0, "m/s"),
    "v_right": (-20.0, 20.0, "m/s"),
    "p_left": (-5e4, 5e4, "W"),
    "p_right": (-5e4, 5e4, "W"),
    "power": (-1e5, 1e5, "W"),
    "voltage": (0.0, 1500.0, "V"),
    "current": (-2000.0, 2000.0, "A"),
    "x": (-1e8, 1e8, "m"),
    "y": (-1e8, 1e8, "m"),
    "yaw": (-1e6, 1e6, "rad"),
    "yaw_rate": (-20.0, 20.0, "rad/s"),
    "slope": (-1.2, 1.2, "rad"),
    "accel_x": (-200.0, 200.0, "m/s^2"),
    "temperature": (-100.0, 300.0, "degC"),
    "payload": (0.0, 1e5, "kg"),
}
"""Range in which a reading is possible at all, by channel."""
ANY = (-1e30, 1e30, "in its unit")
"""The same of other channels."""
_MOST = 0.99  # share of readings that are possible where a channel is in its unit
_OTHER_UNIT = {
    "s": "ns",
    "rad": "deg",
    "rad/s": "deg/s",
    "m/s": "km/h",
    "V": "mV",
    "A": "mA",
    "W": "mW",
}
_SPEED_UNITS = {
    "km/h": 1 / 3.6,
    "cm/s": 1e-2,
    "mm/s": 1e-3,
    "rad/s*WHEEL_RADIUS": 0.15,
    "rpm*WHEEL_RADIUS": 0.015,
    "deg/s*WHEEL_RADIUS": 0.0025,
}
_USUAL_SPEED = 0.7  # of robots that skid, as they are driven [m/s]


def possible(channels: Mapping[str, FloatArray]) -> bool:
    """Tell whether nearly all readings are such as a robot's channels can hold."""
    for name, values in channels.items():
        low, high, _ = LIMITS.get(name, ANY)
        if np.mean((values >= low) & (values <= high)) < _MOST:
            return False
    return True


def likely_unit(name: str, unit: str, values: FloatArray) -> str:
    """Guess the unit of readings that are impossible in the library's."""
    if name not in ("v_left", "v_right"):
        return _OTHER_UNIT.get(unit, "*0.001")
    size = float(np.nanquantile(np.abs(values), 0.9))
    likely = {key: factor * size for key, factor in _SPEED_UNITS.items()}
    near = sorted(likely, key=lambda key: abs(np.log(max(likely[key], 1e-300) / _USUAL_SPEED)))
    text = "] or [".join(near[:3])
    return f"{text}], or, if these are the motors' rates, divide by the gear ratio, as in [*0.033"
