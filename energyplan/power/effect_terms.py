"""Former place of the terms."""

from energyplan.power.effects import *  # noqa: F403
from energyplan.power.effects import (
    MOBILISATION as MOBILISATION,
)
from energyplan.power.effects import (
    SLIP_BEYOND as SLIP_BEYOND,
)
from energyplan.power.effects import (
    SLIP_CHANGE as SLIP_CHANGE,
)
from energyplan.power.effects import (
    STRIBECK as STRIBECK,
)
from energyplan.power.effects import (
    TILT_X as TILT_X,
)
from energyplan.power.effects import (
    TILT_Y as TILT_Y,
)
from energyplan.power.effects import (
    TRACTION_BEYOND as TRACTION_BEYOND,
)
from energyplan.power.effects import (
    TRACTION_CHANGE as TRACTION_CHANGE,
)
from energyplan.power.effects import (
    WHEEL_FIGHT as WHEEL_FIGHT,
)
