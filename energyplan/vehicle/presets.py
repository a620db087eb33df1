"""Ready-made vehicles."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from energyplan.vehicle import MotorLimits, TreadICR, Vehicle

# Morales et al. (2010), section IV and Table I. The paper gives no motor ratings; the limits are
# those of a drive that reaches its 1.2 m/s and can spin on concrete with a full tank.
_quadriga = partial(
    Vehicle.from_geometry, wheelbase=0.475, track=0.5, length=0.82, width=0.64,
    icr=TreadICR.symmetric(0.47),
    motor=MotorLimits(continuous_power=400.0, peak_power=800.0, force=900.0, speed=1.2,
                      acceleration=1.0, regeneration=400.0),
)  # fmt: skip
_empty = partial(_quadriga, "quadriga:empty", mass=83.1, cog=(0.0089, 0.0006))

VEHICLE_PRESETS: dict[str, Callable[[], Vehicle]] = {
    "quadriga": _empty,
    "quadriga:empty": _empty,
    "quadriga:full": partial(_quadriga, "quadriga:full", mass=147.1, cog=(0.0202, -0.0005)),
    # Clearpath Husky A200 as equipped for BorealTC.
    "husky_a200": partial(
        Vehicle.from_geometry, "husky_a200", mass=70.0, wheelbase=0.512, track=0.555, length=0.99,
        width=0.67,
        motor=MotorLimits(peak_power=1000.0, continuous_power=400.0, speed=1.0, acceleration=3.0),
    ),
    # Clearpath Jackal, by the maker's data sheet.
    "jackal": partial(
        Vehicle.from_geometry, "jackal", mass=17.0, wheelbase=0.262, track=0.376, length=0.508,
        width=0.43,
        motor=MotorLimits(peak_power=250.0, continuous_power=125.0, speed=2.0, acceleration=4.0),
    ),
    # Clearpath Warthog as equipped for Norlab's DRIVE data, which give the mass; footprint and
    # speed by the maker's data sheet; contacts that predict the slip track of 1.85 m that the data
    # show. The maker gives no power: half above what the drive on grass takes.
    "warthog": partial(
        Vehicle.from_geometry, "warthog", mass=470.0, wheelbase=0.91, track=1.13, length=1.52,
        width=1.38,
        motor=MotorLimits(peak_power=3600.0, speed=5.0, acceleration=1.0),
    ),
}  # fmt: skip
"""Ready-made vehicles, by name."""
