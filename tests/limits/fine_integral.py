"""The energy of a trajectory straight from the equations of docs/theory, in small steps.

Nothing of the library but plain numbers is used: samples in, joules out. Between two samples the
speeds run straight. Beside it: random vehicles, models and paths, as plain numbers as well.
"""

from dataclasses import dataclass, replace

import numpy as np

from energyplan import MotorLimits, Path, Pose, PowerModel, TreadICR, Vehicle
from energyplan.power.effects import term

STEPS = 400


def fine_energy(trajectory, vehicle, size, battery=False, steps=STEPS):
    """Energy [J] by the midpoint rule, `steps` to an interval; `size` maps effects to numbers."""
    t, v, w = trajectory.t, trajectory.v, trajectory.omega
    part = (np.arange(steps) + 0.5) / steps
    step = np.diff(t)[:, None]
    speed = v[:-1, None] + np.diff(v)[:, None] * part
    rate = w[:-1, None] + np.diff(w)[:, None] * part
    accel = np.broadcast_to(np.diff(v)[:, None] / step, speed.shape)
    spin = np.broadcast_to(np.diff(w)[:, None] / step, speed.shape)
    left, right, track = vehicle.icr.left, vehicle.icr.right, vehicle.icr.slip_track
    # A straight line and a pivot are so but for rounding.
    rate = np.where(np.abs(rate) * track < 1e-9 * np.abs(speed), 0.0, rate)
    v_l, v_r = speed - left * rate, speed + right * rate
    v_l = np.where(np.abs(v_l) < 1e-9 * np.abs(v_r), 0.0, v_l)
    v_r = np.where(np.abs(v_r) < 1e-9 * np.abs(v_l), 0.0, v_r)

    slip = vehicle.slip_moment
    moment = slip * size.get("slip_friction", 0.0) * np.sign(rate)
    moment = moment + size.get("angular_inertia", 0.0) * spin
    radius = slip / vehicle.loads.sum()
    moment = moment + size.get("slip_speed_friction", 0.0) * slip * radius * rate
    along = size.get("linear_inertia", 0.0) * accel
    along = along + size.get("air_drag", 0.0) * speed * np.abs(speed)
    along = along + size.get("towing_force", 0.0)
    traction, viscous = size.get("traction_resistance", 0.0), size.get("viscous_loss", 0.0)
    f_l = (right * along - moment) / track + traction * np.sign(v_l) + viscous * v_l
    f_r = (left * along + moment) / track + traction * np.sign(v_r) + viscous * v_r
    p_l, p_r = f_l * v_l, f_r * v_r
    drive, back = size.get("drive_efficiency", 0.0), size.get("regeneration_efficiency", 0.0)
    if battery and "drive_efficiency" not in size:
        drive = 1 / vehicle.drive_efficiency - 1
    if battery and "regeneration_efficiency" not in size:
        back = 1 - vehicle.regen_efficiency
    power = p_l + p_r + size.get("hotel_load", 0.0)
    power = power + size.get("copper_loss", 0.0) * (f_l**2 + f_r**2)
    power = power + drive * (np.maximum(p_l, 0) + np.maximum(p_r, 0))
    power = power + back * (np.maximum(-p_l, 0) + np.maximum(-p_r, 0))
    return float((power.mean(axis=1) * step[:, 0]).sum())


@dataclass(frozen=True)
class Case:
    """A vehicle, the sizes of the effects in its model, and a path."""

    vehicle: Vehicle
    size: dict
    model: PowerModel
    path: Path


def random_case(rng):
    """A vehicle from a toy to a tractor, a model of two to ten effects, a path."""
    mass = float(np.exp(rng.uniform(np.log(8), np.log(800))))
    reach = 0.25 * (mass / 20) ** (1 / 3)
    wheelbase, track = reach * rng.uniform(0.7, 2.0), reach * rng.uniform(0.8, 2.0)
    top = float(rng.uniform(0.5, 3.0))
    vehicle = Vehicle.from_geometry(
        "random", mass=mass, wheelbase=wheelbase, track=track,
        length=1.4 * wheelbase, width=1.3 * track,
        drive_efficiency=float(rng.uniform(0.6, 1.0)),
        regen_efficiency=float(rng.choice([0.0, rng.uniform(0, 1), 1.0])),
        motor=MotorLimits(speed=top),
    )  # fmt: skip
    if rng.random() < 0.5:
        c = vehicle.icr.left
        vehicle = vehicle.with_icr(TreadICR(c * rng.uniform(0.8, 1.3), c * rng.uniform(0.8, 1.3)))
    weight = 9.81 * mass
    size = {
        "slip_friction": float(rng.uniform(0.1, 0.9)),
        "traction_resistance": float(weight * rng.uniform(0.01, 0.1)),
    }
    extra = {
        "linear_inertia": mass * rng.uniform(0.9, 1.3),
        "angular_inertia": vehicle.yaw_inertia * rng.uniform(0.8, 1.5),
        "hotel_load": 0.1 * mass * rng.uniform(0.2, 3),
        "viscous_loss": weight * rng.uniform(0.005, 0.05),
        "air_drag": weight * rng.uniform(0.0005, 0.005),
        "copper_loss": rng.uniform(0.1, 1.0) / weight,
        "drive_efficiency": rng.uniform(0.05, 0.6),
        "regeneration_efficiency": rng.uniform(0.0, 1.0),
        "slip_speed_friction": rng.uniform(0.0, 0.2),
        "towing_force": weight * rng.uniform(0.0, 0.005),
    }
    size |= {name: float(value) for name, value in extra.items() if rng.random() < 0.4}
    model = PowerModel(
        vehicle, tuple(term(name) for name in size), np.array(list(size.values())), name="random"
    )
    n = int(rng.integers(1, 7))
    ds = reach * rng.uniform(-4.0, 12.0, n) * (rng.random(n) > 0.25)
    dtheta = rng.uniform(-2.5, 2.5, n) * (rng.random(n) > 0.3)
    empty = (ds == 0) & (dtheta == 0)
    ds[empty] = reach * rng.uniform(0.1, 8, int(empty.sum()))
    if rng.random() < 0.3:  # pivots about a tread's ICR
        k = int(rng.integers(n))
        dtheta[k] = dtheta[k] or 1.0
        ds[k] = vehicle.icr.left * dtheta[k]
    path = Path(Pose(*rng.uniform(-2, 2, 3)), ds, dtheta)
    return Case(limited(rng, vehicle, size), size, model, path)


def limited(rng, vehicle, size):
    """The vehicle with a random set of limits, each wide enough to crawl on any path."""
    weight = 9.81 * vehicle.mass
    force = (
        size["traction_resistance"]
        + vehicle.slip_moment
        * (size["slip_friction"] + size.get("slip_speed_friction", 0.0))
        / vehicle.icr.slip_track
        + size.get("towing_force", 0.0)
    )
    top = vehicle.motor.speed
    peak = force * top * rng.uniform(0.3, 2.0)
    limits = {
        "acceleration": float(rng.uniform(0.3, 4.0)),
        "force": force * rng.uniform(1.15, 2.0) + 0.02 * weight,
        "peak_power": peak,
        "continuous_power": peak * rng.uniform(0.4, 1.0),
        "thermal_time": float(rng.uniform(1.0, 30.0)),
        "regeneration": force * top * rng.uniform(0.1, 1.0),
    }
    chosen = {name: float(value) for name, value in limits.items() if rng.random() < 0.5}
    if "continuous_power" in chosen:
        chosen["peak_power"] = float(peak)
    whole = {
        "battery_power": 2 * peak * rng.uniform(0.5, 1.5) + size.get("hotel_load", 0.0),
        "battery_return": peak * rng.uniform(0.1, 1.0),
        "max_yaw_rate": float(rng.uniform(0.5, 3.0)),
    }
    others = {name: float(value) for name, value in whole.items() if rng.random() < 0.3}
    return replace(vehicle, motor=replace(vehicle.motor, **chosen), **others)
