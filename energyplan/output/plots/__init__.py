"""Pictures: functions that take matplotlib axes and return them.

Every axis has its unit. Colours are those of Okabe and Ito, which suit colour-blind people;
lines that may coincide differ in style as well.
"""

from energyplan.errors import needs_extra

with needs_extra("plots", "a picture"):
    import matplotlib  # noqa: F401

from energyplan.output.plots.drives import (
    bin_means,
    breakdown,
    energy_over_time,
    feasible_region,
    power_over_time,
    prediction,
    residual_against,
    rounds,
    tread_speeds,
)  # fmt: skip
from energyplan.output.plots.routes import (
    energy_map,
    mission_charge,
    mission_map,
    occupancy,
    planned,
    priced,
    route,
    routes,
    state_of_charge,
)  # fmt: skip
from energyplan.output.plots.style import (
    BLACK,
    BLUE,
    GREEN,
    ORANGE,
    PURPLE,
    RED,
    SKY,
    WIDTH,
    YELLOW,
    figure,
    image,
    legend,
    png,
    svg,
)  # fmt: skip

__all__ = [
    "BLACK", "BLUE", "GREEN", "ORANGE", "PURPLE", "RED", "SKY", "WIDTH", "YELLOW", "bin_means",
    "breakdown", "energy_map", "energy_over_time", "feasible_region", "figure", "image", "legend",
    "mission_charge", "mission_map", "occupancy", "planned", "png", "power_over_time", "prediction",
    "priced", "residual_against", "rounds", "route", "routes", "state_of_charge", "svg",
    "tread_speeds",
]  # fmt: skip
