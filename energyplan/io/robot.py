"""A vehicle from what its owner gives and what its log tells."""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite, nan
from pathlib import Path
from typing import NamedTuple

import numpy as np

from energyplan.errors import InvalidInputError
from energyplan.logs import DriveLog
from energyplan.logs.consistency import Evidence, Measures
from energyplan.vehicle import MotorLimits, TreadICR, Vehicle

_SLIP = 0.93  # slip track over that of equal point loads, as of Huskies and a Warthog
_DENSITY = 250.0  # mass over wheelbase times track of a robot that nobody weighed [kg/m^2]


@dataclass(frozen=True)
class Given:
    """What is known of the robot before its log is read; NaN where it is not."""

    wheel_radius: float = nan  # radius of the wheels [m]
    track: float = nan  # radius of the wheels [m]
    wheelbase: float = nan  # radius of the wheels [m]
    mass: float = nan  # mass as it drives [kg]
    length: float = nan  # footprint [m]
    width: float = nan  # footprint [m]
    name: str = ""  # what to call the robot
    like: Vehicle | None = None  # A vehicle to take the rest from
    columns: str | None = None  # columns that are known, as for `DriveLog.read`
    counts_per_revolution: float = nan  # what an encoder counts while the wheel turns once

    def __post_init__(self) -> None:
        for key in ("wheel_radius", "track", "wheelbase", "mass", "length", "width",
                    "counts_per_revolution"):  # fmt: skip
            value = getattr(self, key)
            if not (np.isnan(value) or (isfinite(value) and value > 0)):
                raise InvalidInputError(f"{key} is {value}; give a positive number")


def known_measures(known: Given) -> Measures:
    """Return the measures that are given, by themselves or by a vehicle alike."""
    like = Measures() if known.like is None else Measures.of(known.like)
    track, wheelbase, mass = (
        getattr(known, key) if isfinite(getattr(known, key)) else getattr(like, key)
        for key in ("track", "wheelbase", "mass")
    )
    return Measures(track, wheelbase, mass, known.wheel_radius)


class Robot(NamedTuple):
    """A vehicle, and what of it nobody gave: what it is by what was taken for it."""

    vehicle: Vehicle
    assumed: dict[str, str]


def build_vehicle(file: Path, log: DriveLog, evidence: Evidence, known: Given) -> Robot:
    """Build a vehicle from what is given; the rest from the log, or as robots usually are."""
    assumed: dict[str, str] = {}
    measures = known_measures(known)
    track, wheelbase, mass = measures.track, measures.wheelbase, measures.mass
    slip = evidence.slip_track
    if not isfinite(track):
        if not isfinite(slip):
            raise InvalidInputError(
                f"{file.name}: the log does not show the track: give the distance between "
                "left and right wheels [m], as in --track 0.555"
            )
        # of a robot a tenth longer than wide, as most are
        ratio = (wheelbase / slip) if isfinite(wheelbase) else nan
        whole = slip / _SLIP
        root = whole**2 / 4 - wheelbase**2 if isfinite(ratio) else nan
        track = whole / 2 + np.sqrt(root) if isfinite(root) and root > 0 else whole / 1.81
        assumed["track"] = f"{track:.3g} m, from the turning"
    if not isfinite(wheelbase):
        wheelbase = 0.9 * track
        square = (slip / _SLIP - track) * track if isfinite(slip) else nan
        if isfinite(square) and 0.25 < square / track**2 < 4:
            wheelbase = float(np.sqrt(square))
        assumed["wheelbase"] = f"{wheelbase:.3g} m, " + (
            "from the turning" if isfinite(square) else "as of most robots"
        )
    if not isfinite(mass):
        mass = _DENSITY * track * wheelbase
        if isfinite(evidence.inertia):
            mass = evidence.inertia
        assumed["mass"] = (
            f"{mass:.3g} kg, {'from speeding up' if isfinite(evidence.inertia) else 'a guess'}; "
            "only its product with the friction coefficient shows in the power"
        )
    like = known.like
    size = None if like is None else np.ptp(like.footprint, axis=0)
    length, width = known.length, known.width
    if not isfinite(length):
        length = float(size[0]) if size is not None else 1.75 * wheelbase
        assumed |= {} if size is not None else {"length": f"{length:.3g} m, 1.75 times wheelbase"}
    if not isfinite(width):
        width = float(size[1]) if size is not None else 1.22 * track
        assumed |= {} if size is not None else {"width": f"{width:.3g} m, 1.22 times track"}
    icr = None
    if isfinite(slip) and 0.6 < slip / (track + wheelbase**2 / track) < 1.45:
        icr = TreadICR.symmetric(float(slip) / 2)
    motor = like.motor if like is not None else _limits(log, assumed)
    vehicle = Vehicle.from_geometry(
        known.name or (like.name if like is not None else file.stem.split(".")[0]),
        mass=mass, wheelbase=wheelbase, track=track, length=length, width=width, icr=icr,
        motor=motor,
        drive_efficiency=1.0 if like is None else like.drive_efficiency,
        regen_efficiency=1.0 if like is None else like.regen_efficiency,
    )  # fmt: skip
    return Robot(vehicle, assumed)


def _limits(log: DriveLog, assumed: dict[str, str]) -> MotorLimits:
    """Limits of a side's motor: what it did in the log, and a usual acceleration."""
    speed = 1.1 * max(
        float(np.quantile(np.abs(log.channel(name)), 0.999)) for name in ("v_left", "v_right")
    )
    sides = log.sides
    drawn = (sides.left, sides.right) if sides is not None else (log.power,)
    peak = 1.5 * max(float(np.quantile(values, 0.999)) for values in drawn)
    found: dict[str, float] = {"acceleration": 1.0}
    assumed["acceleration"] = "1 m/s^2, a usual one"
    if speed > 0:
        found["speed"] = speed
        assumed["speed"] = f"{speed:.3g} m/s, a tenth above what the log reaches"
    if peak > 0:
        found["peak_power"] = peak
        assumed["peak_power"] = f"{peak:.3g} W a side, half above what the log reaches"
    return MotorLimits(**found)
