"""Parameters of Open-RMF's battery estimate from a power model, and how wrong that estimate is.

    python examples/openrmf_config.py [--model M] [--battery B] [--current A] [--map MAP.yaml]

`rmf_battery` knows a mass, a moment of inertia and one friction coefficient: a metre takes `f m g`,
every change of speed takes kinetic energy, up and down alike, and turning at a constant rate takes
nothing. The configuration is printed as YAML; with a map, also the error on routes of least energy.
"""

from __future__ import annotations

import argparse
from itertools import pairwise
from typing import Any

import numpy as np
import yaml

import energyplan as ep

GRAVITY = 9.81
STEP = 0.5  # in which `SimpleMotionPowerSink` sums up [s]


def power(model: ep.PowerModel, speed: float) -> float:
    """Return the power at the battery of driving straight on level ground [W]."""
    steady = dict.fromkeys((c for term in model.terms for c in term.channels), 0.0)
    motion = ep.Motion.from_twist(np.full(1, speed), np.zeros(1), model.vehicle.icr, **steady)
    return float(model.battery_side().power(motion)[0])


def config(model: ep.PowerModel, battery: ep.Battery, current: float) -> dict[str, Any]:
    """Return what a fleet adapter's file says of energy; currents in [A]."""
    vehicle, track = model.vehicle, model.vehicle.icr.slip_track
    speed, acceleration = vehicle.driving_speed, float(vehicle.motor.acceleration)
    low, high = vehicle.footprint
    idle, driving = power(model, 0.0), power(model, speed)
    charge = np.linspace(0.0, 1.0, 101)
    voltage = float(np.trapezoid(battery.ocv(charge), charge))
    stored = float(battery.usable_energy(max(driving, 1.0), 1.0))
    radius = float(np.hypot(*np.maximum(-low, high)))
    return {
        "limits": {
            "linear": [speed, acceleration],
            "angular": [2.0 * speed / track, 2.0 * acceleration / track],
        },
        "profile": {"footprint": radius, "vicinity": radius},
        "reversible": True,
        "battery_system": {
            "voltage": voltage, "capacity": stored / voltage / 3600, "charging_current": current,
        },
        "mechanical_system": {
            "mass": vehicle.mass,
            # of a plate of the footprint's size
            "moment_of_inertia": vehicle.mass * float((high - low) @ (high - low)) / 12.0,
            "friction_coefficient": (driving - idle) / (vehicle.mass * GRAVITY * speed),
        },
        "ambient_system": {"power": idle},
        "tool_system": {"power": 0.0},
        "recharge_threshold": 0.2,
        "recharge_soc": 1.0,
        "account_for_battery_drain": True,
    }  # fmt: skip


def estimate(settings: dict[str, Any], drive: ep.Trajectory) -> float:
    """Return the energy that Open-RMF counts for a trajectory [J]."""
    t = np.arange(drive.t[0], drive.t[-1] + 1e-9, STEP)
    rates = drive.v, drive.omega, np.gradient(drive.v, drive.t), np.gradient(drive.omega, drive.t)
    v, w, a, alpha = (np.abs(np.interp(t, drive.t, rate)) for rate in rates)
    mass, inertia, friction = settings["mechanical_system"].values()
    moving = friction * mass * GRAVITY * v + mass * a * v + inertia * alpha * w
    return float(moving.sum() * STEP + settings["ambient_system"]["power"] * drive.duration)


def drives(model: ep.PowerModel, grid: ep.OccupancyGrid, count: int) -> list[Any]:
    """Return routes of least energy between random free poses, as they are driven."""
    rng, cost = np.random.default_rng(0), ep.EnergyCost(model, battery=True)
    drawn = rng.uniform((0.0, 0.0, -np.pi), (*grid.shape[::-1], np.pi), (50 * count, 3))
    drawn[:, :2] = grid.to_world(drawn[:, :2])
    poses = drawn[grid.footprint_free(drawn, model.vehicle)][: count + 1]
    driven = []
    for start, goal in pairwise(poses):
        try:
            problem = ep.PlanningProblem(grid, cost, start, goal)
            driven.append(ep.plan(problem, effort=3000).driven)
        except ep.errors.PlanningError:
            pass
    return driven


def main() -> None:
    """Print the configuration, and with a map the error of the estimate."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--model", default="quadriga:full:concrete")
    parser.add_argument("--battery", default="quadriga")
    parser.add_argument("--current", type=float, default=10.0, help="charging current [A]")
    parser.add_argument("--map")
    parser.add_argument("--routes", type=int, default=20)
    options = parser.parse_args()
    model = ep.read_model(options.model)
    settings = config(model, ep.Battery.preset(options.battery), options.current)
    print(yaml.safe_dump({"rmf_fleet": {"name": model.vehicle.name, **settings}}, sort_keys=False))
    if options.map:
        driven = drives(model, ep.read_map(options.map), options.routes)
        energy = np.array([one.energy for one in driven])
        ratio = np.array([estimate(settings, one.trajectory) for one in driven]) / energy
        total = 100 * (ratio @ energy / energy.sum() - 1)
        single = 100 * np.sqrt(((ratio - 1) ** 2).mean())
        print(f"# {len(driven)} routes: sum {total:+.0f} %, single routes {single:.0f} % (rms)")


if __name__ == "__main__":
    main()
