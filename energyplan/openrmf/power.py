"""The battery estimate of Open-RMF from an identified model, and the error that it leaves.

`rmf_battery` knows a mass, a moment of inertia and one friction coefficient: driving straight takes
``f m g`` a metre, every change of speed takes kinetic energy, up and down alike, and a turn at a
constant rate takes nothing.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from energyplan.battery import Battery
from energyplan.errors import InvalidInputError
from energyplan.mission import Mission, Task
from energyplan.mission.legs import Legs
from energyplan.motion import Motion
from energyplan.path import Pose, Trajectory
from energyplan.power import PowerModel
from energyplan.terrain import OccupancyGrid, SurfaceMap
from energyplan.vehicle import GRAVITY

_STEP = 0.5
"""Step in which `SimpleMotionPowerSink` sums up [s]."""

_SPEED = 0.5
"""Tread speed where the vehicle names none [m/s]."""

_HOUR = 3600.0


@dataclass(frozen=True)
class FleetConfig:
    """What a fleet adapter's configuration says of a robot's energy."""

    name: str  # name of the fleet
    voltage: float  # nominal voltage [V]
    capacity: float  # capacity [Ah]
    charging_current: float  # [A]
    mass: float  # [kg]
    moment_of_inertia: float  # about the vertical axis [kg m^2], of a plate of the footprint's size
    friction_coefficient: float  # of driving straight
    ambient_power: float  # of standing still [W]
    tool_power: float  # of a tool at work [W]
    linear: tuple[float, float]
    angular: tuple[float, float]
    footprint: float  # radius of a disc that holds the footprint [m]
    reversible: bool = True  # whether the robot may drive backwards
    recharge_threshold: float = 0.2
    recharge_soc: float = 1.0  # state of charge below which it goes to charge, and up to which
    notes: tuple[str, ...] = ()  # what stands on an assumption

    def __post_init__(self) -> None:
        for key in ("voltage", "capacity", "charging_current", "mass", "moment_of_inertia",
                    "friction_coefficient"):  # fmt: skip
            value = getattr(self, key)
            if not (np.isfinite(value) and value > 0):
                raise InvalidInputError(
                    f"{key} is {value:g}; Open-RMF takes positive numbers only: give one"
                )

    def document(self) -> dict[str, Any]:
        """Return the configuration as a fleet adapter's YAML file holds it."""
        return {
            "rmf_fleet": {
                "name": self.name,
                "limits": {"linear": list(self.linear), "angular": list(self.angular)},
                "profile": {"footprint": self.footprint, "vicinity": self.footprint},
                "reversible": self.reversible,
                "battery_system": {
                    "voltage": self.voltage,
                    "capacity": self.capacity,
                    "charging_current": self.charging_current,
                },
                "mechanical_system": {
                    "mass": self.mass,
                    "moment_of_inertia": self.moment_of_inertia,
                    "friction_coefficient": self.friction_coefficient,
                },
                "ambient_system": {"power": self.ambient_power},
                "tool_system": {"power": self.tool_power},
                "recharge_threshold": self.recharge_threshold,
                "recharge_soc": self.recharge_soc,
                "account_for_battery_drain": True,
            }
        }


@dataclass(frozen=True)
class PowerError:
    """What Open-RMF's estimate misses on routes of a map."""

    routes: int  # routes that were looked at
    energy: float  # energy of all of them by the model, and by Open-RMF [J]
    estimate: float  # energy of all of them by the model, and by Open-RMF [J]
    bias: float  # relative error of their sum
    rms: float  # root mean square, and the largest, of the relative errors of single routes
    worst: float  # root mean square, and the largest, of the relative errors of single routes
    turning: float  # part of the energy that is beyond that of driving as far straight on
    fitted_friction: float  # friction coefficient that is right for the sum of every other route
    fitted_bias: float  # the same errors with it, on the routes that did not choose it
    fitted_rms: float  # the same errors with it, on the routes that did not choose it
    fitted_worst: float  # the same errors with it, on the routes that did not choose it
    errors: tuple[float, ...] = field(repr=False, default=())  # relative error of each route


def _power(model: PowerModel, speed: float) -> float:
    """Power at the battery of driving straight on level ground [W]."""
    steady = dict.fromkeys((c for term in model.terms for c in term.channels), 0.0)
    motion = Motion.from_twist(np.full(1, speed), np.zeros(1), model.vehicle.icr, **steady)
    return float(model.battery_side().power(motion)[0])


def _speed(model: PowerModel) -> float:
    speed = float(min(model.vehicle.usual_speed, model.vehicle.motor.speed))
    return speed if np.isfinite(speed) else _SPEED


def fleet_config(
    model: PowerModel,
    battery: Battery,
    *,
    charging_current: float | None = None,
    tool_power: float = 0.0,
    moment_of_inertia: float | None = None,
    friction_coefficient: float | None = None,
    reserve: float = 0.2,
    name: str = "",
) -> FleetConfig:
    """Return what a fleet adapter's configuration needs, from a model and a battery."""
    vehicle, speed = model.vehicle, _speed(model)
    notes = []
    if charging_current is None:
        charging_current = battery.max_charge_current
        if not np.isfinite(charging_current):
            raise InvalidInputError(
                f"the charging current of {battery.name} is not known; give it, in amperes"
            )
        notes.append("the charging current is the largest that the battery takes")
    mass = vehicle.mass
    (x_min, y_min), (x_max, y_max) = vehicle.footprint.tolist()
    if moment_of_inertia is None:
        moment_of_inertia = mass * ((x_max - x_min) ** 2 + (y_max - y_min) ** 2) / 12.0
        notes.append("the moment of inertia is that of a plate of the footprint's size")
    idle, driving = _power(model, 0.0), _power(model, speed)
    if friction_coefficient is None:
        friction_coefficient = (driving - idle) / (mass * GRAVITY * speed)
    if tool_power == 0:
        notes.append("no tool power was given")
    grid = np.linspace(0.0, 1.0, 101)
    voltage = float(np.trapezoid(battery.ocv(grid), grid))
    stored = float(battery.usable_energy(max(driving, 1.0), 1.0))
    track = vehicle.icr.slip_track
    acceleration = float(vehicle.motor.acceleration)
    return FleetConfig(
        name=name or vehicle.name.replace(":", "_"),
        voltage=voltage,
        capacity=stored / voltage / _HOUR,
        charging_current=float(charging_current),
        mass=mass,
        moment_of_inertia=moment_of_inertia,
        friction_coefficient=friction_coefficient,
        ambient_power=idle,
        tool_power=tool_power,
        linear=(speed, acceleration),
        angular=(2.0 * speed / track, 2.0 * acceleration / track),
        footprint=float(np.hypot(max(-x_min, x_max), max(-y_min, y_max))),
        recharge_threshold=reserve,
        notes=tuple(notes),
    )


def sink_energy(config: FleetConfig, trajectory: Trajectory) -> Mapping[str, float]:
    """Return the energy that Open-RMF counts for a trajectory [J]."""
    t = np.arange(trajectory.t[0], trajectory.t[-1] + 1e-9, _STEP)
    v = np.abs(np.interp(t, trajectory.t, trajectory.v))
    w = np.abs(np.interp(t, trajectory.t, trajectory.omega))
    a = np.abs(np.interp(t, trajectory.t, np.gradient(trajectory.v, trajectory.t)))
    alpha = np.abs(np.interp(t, trajectory.t, np.gradient(trajectory.omega, trajectory.t)))
    weight = config.friction_coefficient * config.mass * GRAVITY
    return {
        "friction": float(weight * v.sum() * _STEP),
        "acceleration": float(
            (config.mass * a * v + config.moment_of_inertia * alpha * w).sum() * _STEP
        ),
        "ambient": config.ambient_power * trajectory.duration,
    }


def power_error(
    config: FleetConfig,
    model: PowerModel,
    battery: Battery,
    grid: OccupancyGrid,
    *,
    surfaces: SurfaceMap | None = None,
    routes: int = 20,
    seed: int = 0,
    effort: int = 3000,
) -> PowerError:
    """Measure the error of Open-RMF's estimate on routes of least energy between random places."""
    if routes < 4:
        raise InvalidInputError(f"{routes} routes are too few; ask for 4 or more")
    places = _places(model, grid, surfaces, routes + 1, seed)
    mission = Mission(
        model=model, map=grid, battery=battery, start=places[0], surfaces=surfaces,
        tasks=tuple(Task(f"place {k}", pose) for k, pose in enumerate(places[1:])),
        confidence=0.5, planning_effort=effort, reserve=battery.cutoff_soc,
    )  # fmt: skip
    legs = Legs(mission)
    true, counted, metres, straight = [], [], [], []
    idle, speed = _power(model, 0.0), _speed(model)
    per_metre = (_power(model, speed) - idle) / speed
    for k in range(routes):
        leg = legs.leg(k, k + 1, 0.0)
        if leg.trajectory is None:
            continue
        true.append(leg.energy.mean)
        counted.append(sink_energy(config, leg.trajectory))
        drive = leg.trajectory
        metres.append(float(np.abs(drive.v[:-1] * np.diff(drive.t)).sum()))
        straight.append(per_metre * metres[-1] + idle * leg.duration)
    if len(true) < 4:
        raise InvalidInputError(
            f"only {len(true)} of {routes} routes can be driven on this map; ask for more"
        )
    energy = np.array(true)
    friction = np.array([one["friction"] for one in counted])
    rest = np.array([one["acceleration"] + one["ambient"] for one in counted])
    told = _errors(energy, friction + rest)
    chosen = np.arange(len(energy)) % 2 == 0
    factor = float((energy - rest)[chosen].sum() / friction[chosen].sum())
    right = _errors(energy[~chosen], (factor * friction + rest)[~chosen])
    fits = factor > 0
    return PowerError(
        routes=len(energy),
        energy=float(energy.sum()),
        estimate=float((friction + rest).sum()),
        bias=told[0],
        rms=told[1],
        worst=told[2],
        turning=float(1.0 - sum(straight) / energy.sum()),
        fitted_friction=factor * config.friction_coefficient if fits else np.nan,
        fitted_bias=right[0] if fits else np.nan,
        fitted_rms=right[1] if fits else np.nan,
        fitted_worst=right[2] if fits else np.nan,
        errors=tuple(((friction + rest) / energy - 1.0).tolist()),
    )


def _errors(energy: np.ndarray, estimate: np.ndarray) -> list[float]:
    """Return relative errors: of the sum, root mean square, and the largest."""
    single = estimate / energy - 1.0
    worst = single[np.argmax(np.abs(single))]
    sums = estimate.sum() / energy.sum() - 1.0
    return [float(sums), float(np.sqrt((single**2).mean())), float(worst)]


def _places(
    model: PowerModel, grid: OccupancyGrid, surfaces: SurfaceMap | None, count: int, seed: int
) -> list[Pose]:
    """Draw free poses from which one can get to the others, as far as that is known."""
    kept = surfaces.keep_out if surfaces is not None else ()
    free = grid.with_blocked(kept) if kept else grid
    rng = np.random.default_rng(seed)
    found: list[Pose] = []
    rows, columns = grid.shape
    for _ in range(50):
        drawn = rng.uniform((0.0, 0.0, -np.pi), (columns, rows, np.pi), (200, 3))
        drawn[:, :2] = grid.to_world(drawn[:, :2])
        good = drawn[free.footprint_free(drawn, model.vehicle)]
        found += [Pose(*map(float, row)) for row in good]
        if len(found) >= count:
            return found[:count]
    raise InvalidInputError(
        f"{len(found)} of {count} places were found where the robot fits; take another map"
    )
