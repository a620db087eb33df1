"""The further power terms, one pure function each; `energyplan.power.effects` publishes them.

Terms that depend on time, place or heading read a channel only where the motion carries it. A
planner that does not know it gets what the docstring says: the robot is warm, the change has
happened, the headings average out.
"""

from __future__ import annotations

import numpy as np

from energyplan.motion import Motion
from energyplan.path import FloatArray
from energyplan.power import Sides, Term, tread_forces
from energyplan.vehicle import GRAVITY, Vehicle

_ANY = (-np.inf, np.inf)
_POSITIVE = (0.0, np.inf)


# -- ground and gravity ---------------------------------------------------------------------------


def grade(motion: Motion, vehicle: Vehicle) -> Sides:
    """Weight along the heading per unit of mass: ``g sin(slope)`` (docs/theory, section 7)."""
    slope = motion.channel("slope", "the term 'grade'")
    return tread_forces(motion, longitudinal=GRAVITY * np.sin(slope))


def specific_force(motion: Motion, vehicle: Vehicle) -> Sides:
    """Force per unit of mass that an accelerometer feels: ``dv/dt + g sin(slope)``.

    Where the slope is known, as on a map, slope and acceleration stand in for the accelerometer.
    """
    slope = motion.channels.get("slope")
    if slope is None:
        return tread_forces(motion, longitudinal=motion.channel("accel_x", "'specific_force'"))
    accel = motion.channels.get("accel", np.zeros(motion.shape))
    return tread_forces(motion, longitudinal=accel + GRAVITY * np.sin(slope))


def _heading(motion: Motion, offset: float) -> FloatArray:
    """Cosine of the heading; zero where yaw is unknown, or where the map knows the slope."""
    if "slope" in motion.channels or "yaw" not in motion.channels:
        return np.zeros(motion.shape)
    return np.cos(motion.channels["yaw"] - offset)


def tilt_x(motion: Motion, vehicle: Vehicle) -> Sides:
    """Weight along the heading on a plane that climbs towards yaw 0, where no slope is known."""
    return tread_forces(motion, longitudinal=GRAVITY * _heading(motion, 0.0))


def tilt_y(motion: Motion, vehicle: Vehicle) -> Sides:
    """Weight along the heading on a plane that climbs towards yaw 90 degrees."""
    return tread_forces(motion, longitudinal=GRAVITY * _heading(motion, np.pi / 2))


# -- inertia --------------------------------------------------------------------------------------


def linear_inertia(motion: Motion, vehicle: Vehicle) -> Sides:
    """Force per unit of mass that changes the forward speed: ``dv/dt``."""
    return tread_forces(motion, longitudinal=motion.channel("accel", "the term 'linear_inertia'"))


def angular_inertia(motion: Motion, vehicle: Vehicle) -> Sides:
    """Moment per unit of inertia that changes the yaw rate: ``dw/dt``."""
    return tread_forces(motion, moment=motion.channel("yaw_accel", "the term 'angular_inertia'"))


# -- speed ----------------------------------------------------------------------------------------


def viscous_loss(motion: Motion, vehicle: Vehicle) -> Sides:
    """Force proportional to tread speed: grease, belts, soft ground."""
    return Sides(motion.v_left, motion.v_right)


def air_drag(motion: Motion, vehicle: Vehicle) -> Sides:
    """Force proportional to the square of the body's speed."""
    return tread_forces(motion, longitudinal=motion.v * np.abs(motion.v))


def towing_force(motion: Motion, vehicle: Vehicle) -> Sides:
    """Constant force along the body, whichever way it drives: a hose, a cable, a head wind."""
    return tread_forces(motion, longitudinal=np.ones(motion.shape))


def towed_drag(motion: Motion, vehicle: Vehicle) -> Sides:
    """Force of something towed, a trailer or a sledge: against the body's own motion."""
    return tread_forces(motion, longitudinal=np.sign(motion.v))


# -- asymmetry ------------------------------------------------------------------------------------


def dragging_left(motion: Motion, vehicle: Vehicle) -> Sides:
    """Traction resistance that the left side has more than the right one."""
    return Sides(np.sign(motion.v_left), np.zeros(motion.shape))


def turn_asymmetry(motion: Motion, vehicle: Vehicle) -> Sides:
    """Slip friction that a left turn has more and a right turn less: a constant moment."""
    return tread_forces(motion, moment=vehicle.slip_moment * np.sign(motion.omega) ** 2)


# -- friction -------------------------------------------------------------------------------------


def slip_speed_friction(motion: Motion, vehicle: Vehicle) -> Sides:
    """Slip friction that grows with the slip speed, taken as yaw rate times mean slip radius."""
    radius = vehicle.slip_moment / float(vehicle.loads.sum())
    return tread_forces(motion, moment=vehicle.slip_moment * radius * motion.omega)


def stribeck_friction(motion: Motion, vehicle: Vehicle, slip_speed: float) -> Sides:
    """Slip friction that is there at small slip speeds only and fades as they grow.

    ``exp(-r |w| / slip_speed)`` with the mean slip radius ``r`` of the wheels (Stribeck).
    """
    radius = vehicle.slip_moment / float(vehicle.loads.sum())
    fade = np.exp(-radius * np.abs(motion.omega) / slip_speed)
    return tread_forces(motion, moment=vehicle.slip_moment * np.sign(motion.omega) * fade)


def friction_mobilisation(motion: Motion, vehicle: Vehicle, radius: float) -> Sides:
    """Slip friction that is missing in wide turns: ``-mu S sign(w) |v| / (|v| + radius |w|)``."""
    speed, rate = np.abs(motion.v), radius * np.abs(motion.omega)
    whole = speed + rate
    missing = np.divide(speed, whole, out=np.zeros(motion.shape), where=whole > 0)
    return tread_forces(motion, moment=-vehicle.slip_moment * np.sign(motion.omega) * missing)


def wheel_fight(motion: Motion, vehicle: Vehicle, forces: Sides) -> Sides:
    """Heat of sides that push against each other on a straight, where contacts hold a moment."""
    turning = np.abs(motion.omega) * motion.icr.half_track > 1e-6 * np.abs(motion.v)
    straight = ~turning & (motion.v != 0.0)
    return Sides(0.5 * straight, 0.5 * straight)


# -- time and place -------------------------------------------------------------------------------


def warm_up(motion: Motion, vehicle: Vehicle, time_constant: float) -> Sides:
    """Traction resistance of a cold drive: ``exp(-t / time_constant)``; warm where t is unknown."""
    t = motion.channels.get("t")
    cold = np.zeros(motion.shape) if t is None else np.exp(-t / time_constant)
    return Sides(cold * np.sign(motion.v_left), cold * np.sign(motion.v_right))


def _after(motion: Motion, time: float) -> FloatArray:
    """1 after the change and 0 before: the channel ``changed`` where there is one, else by time."""
    if "changed" in motion.channels:
        return motion.channels["changed"]
    t = motion.channels.get("t")
    return np.ones(motion.shape) if t is None else np.asarray(t >= time, float)


def slip_change(motion: Motion, vehicle: Vehicle, time: float) -> Sides:
    """Slip friction that is there only after a change; changed where time is unknown."""
    after = _after(motion, time)
    return tread_forces(motion, moment=vehicle.slip_moment * np.sign(motion.omega) * after)


def traction_change(motion: Motion, vehicle: Vehicle, time: float) -> Sides:
    """Traction resistance that is there only after a change; changed where time is unknown."""
    after = _after(motion, time)
    return Sides(after * np.sign(motion.v_left), after * np.sign(motion.v_right))


def _beyond(motion: Motion, vehicle: Vehicle, direction: float, offset: float) -> FloatArray:
    """Share of the weight beyond a line: wheels cross it one after the other."""
    x, y = motion.channel("x", "a change of place"), motion.channel("y", "a change of place")
    along = x * np.cos(direction) + y * np.sin(direction) - offset
    if "yaw" not in motion.channels:
        return np.asarray(along > 0.0, float)
    turned = motion.channels["yaw"] - direction
    ahead, aside = np.cos(turned), np.sin(turned)
    share = np.zeros(motion.shape)
    for (forward, left), load in zip(vehicle.contacts, vehicle.loads, strict=True):
        share += load * (along + forward * ahead - left * aside > 0.0)
    return np.asarray(share / float(vehicle.loads.sum()))


def slip_beyond(motion: Motion, vehicle: Vehicle, direction: float, offset: float) -> Sides:
    """Slip friction that is there only beyond a line on the ground."""
    there = _beyond(motion, vehicle, direction, offset)
    return tread_forces(motion, moment=vehicle.slip_moment * np.sign(motion.omega) * there)


def traction_beyond(motion: Motion, vehicle: Vehicle, direction: float, offset: float) -> Sides:
    """Traction resistance that is there only beyond a line on the ground."""
    there = _beyond(motion, vehicle, direction, offset)
    return Sides(there * np.sign(motion.v_left), there * np.sign(motion.v_right))


# -- electrical -----------------------------------------------------------------------------------


def copper_loss(motion: Motion, vehicle: Vehicle, forces: Sides) -> Sides:
    """Power lost in the windings: current follows force, so its square does."""
    return Sides(np.square(forces.left), np.square(forces.right))


def unsigned_power(motion: Motion, vehicle: Vehicle, forces: Sides) -> Sides:
    """Twice the returned power, which a sensor without a sign adds to the sum."""
    return Sides(
        2.0 * np.maximum(-forces.left * motion.v_left, 0.0),
        2.0 * np.maximum(-forces.right * motion.v_right, 0.0),
    )


def side_gain(motion: Motion, vehicle: Vehicle, forces: Sides) -> Sides:
    """Power that the left side's sensor shows too high and the right side's too low."""
    return Sides(forces.left * motion.v_left, -forces.right * motion.v_right)


# -- the terms ------------------------------------------------------------------------------------

GRADE = Term(
    "grade", "m", "kg", "force", grade, channels=("slope",), bounds=_POSITIVE,
    meaning="weight on a slope",
)  # fmt: skip
SPECIFIC_FORCE = Term(
    "specific_force", "m", "kg", "force", specific_force, bounds=_POSITIVE,
    meaning="weight and inertia together, as an accelerometer feels them",
)  # fmt: skip
TILT_X = Term("tilt_x", "m sin(a_x)", "kg", "force", tilt_x, meaning="ground climbing to yaw 0")
TILT_Y = Term("tilt_y", "m sin(a_y)", "kg", "force", tilt_y, meaning="ground climbing to yaw 90")
LINEAR_INERTIA = Term(
    "linear_inertia", "m", "kg", "force", linear_inertia, channels=("accel",), bounds=_POSITIVE,
    meaning="speeding up and slowing down",
)  # fmt: skip
ANGULAR_INERTIA = Term(
    "angular_inertia", "I_z", "kg m^2", "force", angular_inertia, channels=("yaw_accel",),
    bounds=_POSITIVE, meaning="turning faster and slower",
)  # fmt: skip
VISCOUS_LOSS = Term(
    "viscous_loss", "B_v", "N s/m", "force", viscous_loss, bounds=_POSITIVE,
    meaning="resistance that rises with speed",
)  # fmt: skip
AIR_DRAG = Term(
    "air_drag", "k_d", "N s^2/m^2", "force", air_drag, bounds=_POSITIVE,
    meaning="resistance that rises with the square of the speed",
)  # fmt: skip
TOWING_FORCE = Term(
    "towing_force", "F_t", "N", "force", towing_force, bounds=_ANY,
    meaning="a force that pulls one way, forwards or backwards",
)  # fmt: skip
TOWED_DRAG = Term(
    "towed_drag", "F_d", "N", "force", towed_drag, bounds=_POSITIVE,
    meaning="something towed that resists whichever way the body moves",
)  # fmt: skip
STRIBECK = Term(
    "stribeck_friction", "mu_s", "1", "force", stribeck_friction, {"slip_speed": 0.1},
    bounds=(-2.0, 2.0), meaning="slip friction that is larger at small slip speeds",
)  # fmt: skip
DRAGGING_LEFT = Term(
    "dragging_wheel_left", "K_d", "N", "force", dragging_left, bounds=_ANY,
    meaning="a wheel or bearing that drags on the left; on the right where it is negative",
)  # fmt: skip
TURN_ASYMMETRY = Term(
    "turn_asymmetry", "dmu", "1", "force", turn_asymmetry, bounds=(-2.0, 2.0),
    meaning="turning left costs more than turning right",
)  # fmt: skip
SLIP_SPEED = Term(
    "slip_speed_friction", "k_mu", "s/m", "force", slip_speed_friction, bounds=_ANY,
    meaning="slip friction that depends on slip speed",
)  # fmt: skip
MOBILISATION = Term(
    "friction_mobilisation", "mu_m", "1", "force", friction_mobilisation, {"radius": 1.0},
    bounds=(-2.0, 2.0), meaning="slip friction that is smaller in wide turns than in a spin",
)  # fmt: skip
WHEEL_FIGHT = Term(
    "wheel_fight", "P_f", "W", "loss", wheel_fight, bounds=_POSITIVE,
    meaning="heat of sides that push against each other on straights, in drives that lose energy",
)  # fmt: skip
WARM_UP = Term(
    "warm_up", "K_0", "N", "force", warm_up, {"time_constant": 60.0}, bounds=_POSITIVE,
    meaning="resistance of a cold drive that fades",
)  # fmt: skip
SLIP_CHANGE = Term(
    "slip_change", "dmu", "1", "force", slip_change, {"time": 0.0}, bounds=_ANY,
    meaning="slip friction after the change",
)  # fmt: skip
TRACTION_CHANGE = Term(
    "traction_change", "dK", "N", "force", traction_change, {"time": 0.0}, bounds=_ANY,
    meaning="traction resistance after the change",
)  # fmt: skip
SLIP_BEYOND = Term(
    "slip_beyond", "dmu", "1", "force", slip_beyond, {"direction": 0.0, "offset": 0.0},
    ("x", "y"), _ANY, "slip friction beyond a line",
)  # fmt: skip
TRACTION_BEYOND = Term(
    "traction_beyond", "dK", "N", "force", traction_beyond, {"direction": 0.0, "offset": 0.0},
    ("x", "y"), _ANY, "traction resistance beyond a line",
)  # fmt: skip
COPPER_LOSS = Term(
    "copper_loss", "R/k^2", "W/N^2", "loss", copper_loss, bounds=_POSITIVE,
    meaning="heat in the motor windings",
)  # fmt: skip
UNSIGNED_POWER = Term(
    "unsigned_power", "s", "1", "loss", unsigned_power, bounds=(0.0, 2.0),
    meaning="a current sensor without the sign of the current",
)  # fmt: skip
SIDE_GAIN = Term(
    "side_gain", "g", "1", "loss", side_gain, bounds=(-1.0, 1.0),
    meaning="gains of the left and the right power sensor differ",
)  # fmt: skip
