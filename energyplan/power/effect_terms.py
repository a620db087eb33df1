"""Former place of the terms."""

from energyplan.power.effects import *  # noqa: F403
from energyplan.power.effects import (
    SLIP_BEYOND as SLIP_BEYOND,
    SLIP_CHANGE as SLIP_CHANGE,
    STRIBECK as STRIBECK,
    TILT_X as TILT_X,
    TILT_Y as TILT_Y,
    TRACTION_BEYOND as TRACTION_BEYOND,
    TRACTION_CHANGE as TRACTION_CHANGE,
    WHEEL_FIGHT as WHEEL_FIGHT,
)
