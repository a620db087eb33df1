"""The rigid-body engine: MuJoCo, with contacts that slide as Coulomb says.

MuJoCo's contacts are meant for grasping: with its defaults a sliding wheel is lifted, hops, and
the instantaneous centre of rotation lies anywhere between 0.5 and 1.3 m where 0.476 m is right. So

- every contact is a spring and damper of its own, in proportion to the wheel's load. The impedance
  is the least that MuJoCo allows, so that the soft constraint adds next to nothing to it: a wheel
  sinks by `_CONTACT.sink`, whatever its slip; further where a wide stance about a light body would
  rock faster than the steps can follow, for wheels would hop then;
- the tangential directions have a reference of their own, damped only, and are much stiffer than
  the normal one (``impratio``): a contact sticks, or slides with friction times load;
- rolling resistance is dry friction of the drive, in proportion to the loads measured at the
  contacts, not MuJoCo's rolling friction, which is a torque about a soft contact;
- the wheels of a side turn together: what they press on the ground is one tread, a body that slides
  along the robot and is put back after each step. Wheels on axles of their own, coupled by stiff
  constraints, shake against the contacts and lose their grip. Their inertia is an armature;
- a velocity servo drives each side, with the speed at the end of each step, for it is stiff. That
  is the same as its gain times the step in armature. MuJoCo's own implicit integrator would tell
  the contacts nothing of it: they would believe in more acceleration than there is, let the body
  run ahead of its treads, and do work on it at each start and stop. Whether a motor is at its
  largest force is decided by the end of the step too, and the step repeated where that was wrong:
  treads are so light that a force chosen beforehand would throw them to and fro.

The ground is a plane. Slopes tilt gravity.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from scipy.linalg import eigh

from energyplan.errors import InvalidInputError, PhysicsError, needs_extra
from energyplan.path import FloatArray, Pose
from energyplan.physics.robot import EngineGround, EngineRobot
from energyplan.vehicle import GRAVITY

if TYPE_CHECKING:
    import mujoco


STEP = 0.002
"""Time step of the engine [s]."""
TICK = 5
"""Steps between two decisions of the controller."""
PERIOD = STEP * TICK
"""Time between two decisions of the controller [s]."""


@dataclass(frozen=True)
class Run:
    """What truly happened, in means over each tick of the controller."""

    t: FloatArray  # (n,): middle of each tick [s]
    x: FloatArray  # (n,): x of the body's origin at that time [m]
    y: FloatArray  # (n,): y of the body's origin at that time [m]
    yaw: FloatArray  # (n,): heading of the body at that time [rad]
    v: FloatArray  # (n,): speed along the heading [m/s]
    omega: FloatArray  # (n,): yaw rate [rad/s]
    v_left: FloatArray  # (n,): left tread speed [m/s]
    v_right: FloatArray  # (n,): right tread speed [m/s]
    force_left: FloatArray  # (n,): force that the left motor delivers at its tread [N]
    force_right: FloatArray  # (n,): force that the right motor delivers at its tread [N]
    shaft_left: FloatArray  # (n,): shaft power of the left motor [W]
    shaft_right: FloatArray  # (n,): shaft power of the right motor [W]
    battery_left: FloatArray  # (n,): power that the left side draws from the battery [W]
    battery_right: FloatArray  # (n,): power that the right side draws from the battery [W]
    hotel: float  # constant draw in addition [W]
    accel_x: FloatArray  # (n,): forward reading of an accelerometer, gravity included [m/s^2]
    slope: FloatArray  # (n,): slope of the ground along the heading [rad]
    cmd_left: FloatArray  # (n,): left tread speed that the controller wants by the end [m/s]
    cmd_right: FloatArray  # (n,): right tread speed that it wants [m/s]
    energy: dict[str, float]  # [J]
    closure: float  # what the motors did beyond all mechanical terms [J]

    @property
    def period(self) -> float:
        """Time between two ticks [s]."""
        return PERIOD

    @property
    def power(self) -> FloatArray:
        """What the battery delivers [W]."""
        return self.battery_left + self.battery_right + self.hotel

    @property
    def taken(self) -> float:
        """Energy that the battery delivered [J]."""
        return float(self.power.sum() * self.period)


@dataclass(frozen=True)
class State:
    """Input of a controller: time [s], pose [m], [rad], and tread speeds [m/s]."""

    t: float
    pose: Pose
    v_left: float
    v_right: float


class ServoSettings(NamedTuple):
    """The velocity servos."""

    time: float = 0.005  # time constant of the velocity servos [s]
    reset: float = 0.1  # reset time of their integral part [s]
    # how often a step is done at most until it is right which motors are at their largest force
    guesses: int = 6


_SERVO = ServoSettings()
BALANCE = 0.005
"""Share of the work of the motors that may be unaccounted for [1]."""


class Outer(NamedTuple):
    """Where the robot is at the start of a tick, and what pulls at it from outside."""

    place: FloatArray
    height: float
    yaw: float
    gravity: FloatArray
    gradient: FloatArray
    pull: float


def _absorbed(force: FloatArray, speed: FloatArray) -> FloatArray:
    """Return the work of contacts along load and both tangential directions, shape (3,) [J]."""
    return np.asarray(-STEP * np.sum(force * 0.5 * (speed[:-1] + speed[1:]), axis=(0, 1)))


_COLUMNS = (
    "x", "y", "yaw", "v", "omega", "v_left", "v_right", "force_left", "force_right", "shaft_left",
    "shaft_right", "battery_left", "battery_right", "accel_x", "slope", "cmd_left", "cmd_right",
)  # fmt: skip


class Book:
    """Steps the engine and keeps the books."""

    def __init__(self, engine: Engine, data: mujoco.MjData) -> None:
        self._engine, self._data, self._model = engine, data, engine.model
        robot, wheels = engine.robot, len(engine.loads)
        self._mj_step = engine.mujoco.mj_step
        self._wheels = wheels
        self._side = np.repeat([0, 1], (engine.left, wheels - engine.left))
        loads = np.bincount(self._side, engine.loads)
        self._share = engine.loads / loads[self._side]
        traction = np.array(robot.traction)
        self._dry = (1 - robot.rolling_share) * traction
        self._rolling = robot.rolling_share * traction / loads
        self._gain = 0.5 * robot.vehicle.mass / _SERVO.time
        self._most = max(robot.vehicle.motor.force, 1e-9)  # with none at all it would turn freely
        self._fade = float(np.exp(-PERIOD / robot.sharing))
        self._centre = engine.loads @ engine.points / engine.loads.sum()
        self._armature = engine.model.dof_armature[6:].copy()
        self._still = (self._armature + STEP * robot.viscous).tolist()
        self._tall = float(robot.centre_height)
        self._integral, self._target, self._held = np.zeros(2), np.zeros(2), [0.0, 0.0]
        self._count = 0
        self._rows: list[FloatArray] = []
        self._sums: list[FloatArray] = []
        self._kinetic = 0.0
        self._force = np.zeros((TICK + 1, wheels, 3))
        self._force[:, :, 0] = engine.loads
        self._slip = np.zeros((TICK + 1, wheels, 3))

    @property
    def t(self) -> float:
        """Return the time since the start [s]."""
        return self._count * PERIOD

    def open(self) -> None:
        """Start counting."""
        self._count = 0
        self._rows.clear()
        self._sums.clear()
        self._kinetic = self._kinetic_energy()

    def _kinetic_energy(self) -> float:
        speed = self._data.qvel
        product = np.zeros(len(speed))
        self._engine.mujoco.mj_mulM(self._model, self._data, product, speed)
        product[6:] -= (self._model.dof_armature[6:] - self._armature) * speed[6:]
        return 0.5 * float(speed @ product)

    def _yaw(self) -> float:
        w, x, y, z = self._data.qpos[3:7]
        return float(np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)))

    def _height(self) -> float:
        """Height of the centre of mass over the plane [m]."""
        data, (x, y) = self._data, self._centre
        a, b, c, d = data.qpos[3:7]
        upright = (2 * (b * d - a * c), 2 * (c * d + a * b), 1 - 2 * (b * b + c * c))
        return float(data.qpos[2] + np.dot(upright, (x, y, self._tall)))

    def state(self) -> State:
        """Return the pose and the speeds of the robot."""
        data = self._data
        pose = Pose(float(data.qpos[0]), float(data.qpos[1]), self._yaw())
        return State(self.t, pose, float(data.qvel[6]), float(data.qvel[7]))

    def _prepare(self, t: float) -> Outer:
        """Set friction, gravity and outer forces for the next tick."""
        engine, data, model = self._engine, self._data, self._model
        robot, ground = engine.robot, engine.ground
        x, y = float(data.qpos[0]), float(data.qpos[1])
        yaw = self._yaw()
        c, s = np.cos(yaw), np.sin(yaw)
        points = np.array([x, y]) + engine.points @ np.array([[c, s], [-s, c]])
        friction, factor = ground.grip(robot, points)
        if robot.slip_speed:
            slip = np.hypot(self._slip[-1, :, 1], self._slip[-1, :, 2])
            friction = np.maximum(friction + robot.slip_speed * slip, 1e-3)
        model.pair_friction[:, 0] = friction
        model.pair_friction[:, 1] = friction
        loads = np.maximum(self._force[-1, :, 0], 0.0)
        resistance = factor * (
            self._dry[self._side] * self._share + self._rolling[self._side] * loads
        )
        cold = robot.warm_up * np.exp(-max(t, 0.0) / robot.warm_up_time)
        model.dof_frictionloss[6:] = np.bincount(self._side, resistance) + cold
        gradient = ground.gradient(robot, x, y)
        norm = float(np.sqrt(1 + gradient @ gradient))
        model.opt.gravity[:] = (-GRAVITY / norm) * np.array([gradient[0], gradient[1], 1.0])
        ahead = float(data.qvel[0] * c + data.qvel[1] * s)
        pull = -robot.towing - robot.drag * ahead * abs(ahead)
        # Along the body's centre line, wherever the centre of mass is.
        data.xfrc_applied[1] = (pull * c, pull * s, 0.0, 0.0, 0.0, pull * self._centre[1])
        here = np.array([x, y])
        return Outer(here, self._height(), yaw, model.opt.gravity[:2].copy(), gradient, pull)

    def tick(self, command: FloatArray, t: float) -> None:
        """Drive towards the commanded tread speeds, shape (2,) [m/s], for one tick."""
        data = self._data
        outer = self._prepare(t)
        before, self._target = self._target, command
        error = before - data.qvel[6:]
        most = self._most / self._gain
        self._integral = np.clip(self._integral + error * (PERIOD / _SERVO.reset), -most, most)
        if command[0] == command[1]:  # straight ahead, or standing: they share the load
            mean = self._integral.mean()
            self._integral = mean + self._fade * (self._integral - mean)
        speeds = np.empty((TICK + 1, 8))
        motor, friction = np.empty((TICK, 2)), np.empty((TICK, 2))
        speeds[0] = data.qvel
        self._force[0], self._slip[0] = self._force[-1], self._slip[-1]
        shares = np.arange(1, TICK + 1)[:, None] / TICK
        aims = before + (self._target - before) * shares + self._integral
        for k in range(TICK):
            motor[k] = self._step(aims[k])
            force = data.efc_force
            if len(force) != 2 + 3 * self._wheels:
                raise PhysicsError(
                    f"a wheel left the ground at {max(t, 0.0):.2f} s; the robot tips over: lower "
                    "the centre of mass, the slope or the acceleration"
                )
            data.qpos[7:] = 0.0
            speeds[k + 1] = data.qvel
            friction[k] = force[:2]
            self._force[k + 1] = force[2:].reshape(-1, 3)
            self._slip[k + 1] = data.efc_vel[2:].reshape(-1, 3)
        if not np.all(np.isfinite(speeds)):
            raise PhysicsError(f"the motion diverged at {max(t, 0.0):.2f} s")
        self._count += 1
        self._enter(outer, speeds, motor, friction)

    def _step(self, aim: FloatArray) -> list[float]:
        """Do one step and return the motors' forces, left and right, by its last speeds [N]."""
        data, most, gain = self._data, self._most, self._gain
        state = data.qpos, data.qvel, data.qacc_warmstart
        before = [values.copy() for values in state]
        speed, acceleration, armature = data.qvel, data.qacc, self._model.dof_armature
        applied, sides = data.qfrc_applied, (0, 1)
        aims, begun, held = aim.tolist(), before[1][6:].tolist(), self._held
        # Numbers one by one: arrays of two take longer to make than all of this.
        for guess in range(_SERVO.guesses):
            if guess:
                for values, former in zip(state, before, strict=True):
                    values[:] = former
            free = [0.0 if held[k] else STEP * gain for k in sides]
            force = [held[k] or gain * (aims[k] - begun[k]) for k in sides]
            applied[6:] = force
            armature[6:] = [self._still[k] + free[k] for k in sides]
            self._mj_step(self._model, data)
            force = [force[k] - free[k] * float(acceleration[6 + k]) for k in sides]
            wanted = [gain * (aims[k] - float(speed[6 + k])) for k in sides]
            former_held = held
            held = [math.copysign(most, w) if abs(w) > most else 0.0 for w in wanted]
            if held == former_held:
                break
        self._held = held
        return force

    def _enter(
        self, outer: Outer, speeds: FloatArray, motor: FloatArray, friction: FloatArray
    ) -> None:
        """Book a tick: work is force times the mean of the speeds before and after the step."""
        robot, data, time = self._engine.robot, self._data, PERIOD
        middle = 0.5 * (speeds[1:] + speeds[:-1])
        tread = middle[:, 6:]
        shaft = motor * tread
        drawing, returning = np.maximum(shaft, 0.0), np.maximum(-shaft, 0.0)
        losses = np.array([
            robot.drive_loss * drawing, robot.regeneration_loss * returning,
            robot.copper * np.square(motor),
        ])  # fmt: skip
        # Up to the last step but one: of that one the speeds at its end are not known yet.
        pressed, *slid = _absorbed(self._force[:-1], self._slip)
        dry = -float(np.sum(friction * tread))
        damped = robot.viscous * float(np.sum(speeds[1:, 6:] * tread))
        turn = (self._yaw() - outer.yaw + np.pi) % (2 * np.pi) - np.pi
        yaw, omega = outer.yaw + 0.5 * turn, turn / time
        c, s = np.cos(yaw), np.sin(yaw)
        velocity = (data.qpos[:2] - outer.place) / time
        ahead = float(velocity @ [c, s])
        here = outer.place + 0.5 * time * velocity
        x, y = self._centre
        swing = omega * np.array([-s * x - c * y, c * x - s * y])
        lifted = -robot.vehicle.mass * time * float(outer.gravity @ (velocity + swing))
        risen = (
            robot.vehicle.mass
            * -float(self._model.opt.gravity[2])
            * (self._height() - outer.height)
        )
        pulled = -outer.pull * ahead * time
        accel = (speeds[-1, :2] - speeds[0, :2]) / time - outer.gravity
        means = np.array([tread, motor, shaft, shaft + losses.sum(axis=0)]).mean(axis=1)
        self._rows.append(np.array([
            *here, yaw, ahead, omega, *means.ravel(),
            accel @ [c, s], np.arctan(outer.gradient @ [c, s]), *self._target,
        ]))  # fmt: skip
        self._sums.append(np.array([
            STEP * shaft.sum(), sum(slid), pressed + risen, STEP * dry, STEP * damped, lifted,
            pulled, *(STEP * losses.sum(axis=(1, 2))),
        ]))  # fmt: skip

    def _refuse_unbalanced(self, closure: float, moved: float) -> None:
        # Wheels that find their loads take the work of sinking in.
        sinking = self._engine.robot.vehicle.mass * GRAVITY * self._engine.sink
        if abs(closure) > BALANCE * moved + sinking:
            raise PhysicsError(
                f"of {moved:.4g} J that the motors moved {closure:.3g} J are unaccounted for, more "
                f"than {100 * BALANCE:g} %: the wheels hop or chatter; lower the centre of mass, "
                "give a lower motor force or commands that change more slowly"
            )

    def close(self) -> Run:
        """Return what was booked."""
        if not self._rows:
            raise PhysicsError("the drive was over before it began")
        robot, time = self._engine.robot, PERIOD
        rows = np.array(self._rows).T
        motor, sliding, pressed, dry, damped, lifted, pulled, *losses = np.sum(self._sums, axis=0)
        self._engine.mujoco.mj_forward(self._model, self._data)
        last = self._data.efc_vel[2:].reshape(-1, 3)
        if len(last) == self._wheels:
            ending = _absorbed(self._force[-1:], np.array([self._slip[-1], last]))
            pressed, sliding = pressed + ending[0], sliding + ending[1:].sum()
        mechanical = {
            "slip_friction": sliding, "traction_resistance": dry, "viscous_loss": damped,
            "grade": lifted, "towing_and_drag": pulled,
            "contacts": pressed, "kinetic": self._kinetic_energy() - self._kinetic,
        }  # fmt: skip
        closure = motor - sum(mechanical.values())
        moved = time * float(np.abs(rows[_COLUMNS.index("shaft_left")]).sum()
                             + np.abs(rows[_COLUMNS.index("shaft_right")]).sum())  # fmt: skip
        self._refuse_unbalanced(closure, moved)
        names = ("drive_efficiency", "regeneration_efficiency", "copper_loss")
        electrical = dict(zip(names, losses, strict=True))
        electrical["hotel_load"] = robot.hotel * time * rows.shape[1]
        energy = mechanical | electrical | {"other": closure}
        columns = dict(zip(_COLUMNS, rows, strict=True))
        columns["yaw"] = np.unwrap(columns["yaw"])
        return Run(
            t=np.asarray(time * (np.arange(rows.shape[1]) + 0.5)),
            hotel=robot.hotel,
            energy={name: float(value) for name, value in energy.items()},
            closure=float(closure),
            **columns,
        )


class ContactSettings(NamedTuple):
    """Contacts of the wheels, and masses that turn."""

    # how far a wheel sinks in under its own load, unless the robot would rock too fast [m]
    sink: float = 2e-4
    # height above the plane up to which a contact is watched, over how far a wheel sinks in [1]
    reach: float = 5.0
    tread_share: float = 1e-3  # share of the robot's mass that each tread has [1]
    # inertia of each side's wheels and motor, seen at the tread, over the robot's mass [1]
    rotor_share: float = 5e-3
    # time at standstill before the start, in which the wheels find their loads [s]
    settle: float = 0.3
    ball: float = 0.1  # radius of the spheres that touch the ground [m]; any will do
    impedance: float = 1e-4  # the least that MuJoCo takes
    ratio: float = 1e7  # stiffness of the tangential directions over the normal one


_CONTACT = ContactSettings()
_SLIDE = 1.0 / STEP  # damping of the tangential reference: slip ends within a step [1/s]


def require_mujoco() -> Any:
    """Return the engine's module."""
    with needs_extra("physics", "driving in a physics engine"):
        import mujoco
    return mujoco


Controller = Callable[[State], tuple[float, float] | None]
"""Returns the tread speeds to reach by the next tick [m/s], or None at the end."""


class Engine:
    """A robot on its ground in MuJoCo."""

    def __init__(
        self, robot: EngineRobot, ground: EngineGround | None = None, start: Pose | None = None
    ) -> None:
        self.mujoco = require_mujoco()
        self.robot, self.ground = robot, ground or EngineGround()
        self.start = start or Pose(0.0, 0.0, 0.0)
        vehicle = robot.vehicle
        left = vehicle.contacts[:, 1] > 0
        loaded = [np.flatnonzero((vehicle.loads > 0) & side) for side in (left, ~left)]
        if not all(len(side) for side in loaded):
            raise InvalidInputError("all load rests on one side; give loads on both sides")
        order = np.concatenate(loaded)  # the wheels on the left come first
        self.points, self.loads = vehicle.contacts[order], vehicle.loads[order]
        self.left = len(loaded[0])
        length, width = vehicle.footprint[1] - vehicle.footprint[0]
        tall = 2 * robot.centre_height
        self._box = np.array([width**2 + tall**2, length**2 + tall**2, length**2 + width**2]) / 12
        self.sink = _CONTACT.sink * max(1.0, self._rocking())
        self.model = self._build()

    # -- the model --------------------------------------------------------------------------------

    def _rocking(self) -> float:
        """Return the square of the fastest of heave, roll and pitch, over that of heave alone."""
        share = self.loads / self.loads.sum()
        x, y = (self.points - share @ self.points).T
        moves = np.column_stack([np.ones(len(share)), y, -x])
        stiffness = moves.T @ (share[:, None] * moves)
        inertia = np.diag([1.0, self._box[0], self._box[1]])
        return float(eigh(stiffness, inertia, eigvals_only=True)[-1])

    def _build(self) -> mujoco.MjModel:
        robot, vehicle = self.robot, self.robot.vehicle
        mass = vehicle.mass
        centre = np.append(self.loads @ self.points / self.loads.sum(), robot.centre_height)
        tread = _CONTACT.tread_share * mass
        body = mass - 2 * tread
        box, reach = self._box, _CONTACT.reach * self.sink
        treads = []
        for side, wheels in enumerate(np.split(np.arange(len(self.loads)), [self.left])):
            spheres = "".join(
                f'<geom name="wheel{k}" type="sphere" size="{_CONTACT.ball}" mass="0" contype="0" '
                f'conaffinity="0" pos="{self.points[k, 0]} {self.points[k, 1]} {_CONTACT.ball}"/>'
                for k in wheels
            )
            # The armature is that of the wheels, and what the tread's own mass takes off.
            treads.append(
                f'<body name="tread{side}"><joint name="tread{side}" type="slide" axis="-1 0 0" '
                f'frictionloss="1" damping="{robot.viscous}" '
                f'armature="{_CONTACT.rotor_share * mass + tread}" '
                f'solreffriction="{2 * STEP} 1" solimpfriction="0.99 0.99 0.01 0.5 1"/>'
                f'<inertial pos="{_words(centre)}" mass="{tread}" '
                f'diaginertia="{_words(tread * box)}"/>{spheres}</body>'
            )
        pairs = [
            f'<pair geom1="ground" geom2="wheel{k}" condim="3" margin="{reach}" gap="0" '
            f'friction="1 1 0 0 0" solimp="{_CONTACT.impedance} {_CONTACT.impedance} 1 0.5 1"/>'
            for k in range(len(self.loads))
        ]
        text = (
            f'<mujoco><option timestep="{STEP}" cone="elliptic" impratio="{_CONTACT.ratio}" '
            'solver="Newton" iterations="50" tolerance="1e-12"><flag eulerdamp="disable"/></option>'
            "<worldbody>"
            '<geom name="ground" type="plane" size="1 1 1" contype="0" conaffinity="0"/>'
            f'<body name="robot" pos="0 0 {reach - self.sink}"><freejoint/>'
            f'<inertial pos="{_words(centre)}" mass="{body}" '
            f'diaginertia="{_words(body * box)}"/>{"".join(treads)}</body></worldbody>'
            f"<contact>{''.join(pairs)}</contact></mujoco>"
        )
        model = self.mujoco.MjModel.from_xml_string(text)
        springs = self.loads / self.sink
        dampers = 2 * np.sqrt(_CONTACT.sink / GRAVITY) * springs  # critical for the fastest motion
        # MuJoCo scales a contact's reference by its impedance and its force by the inertia there.
        yields = np.repeat(model.body_invweight0[2:, 0], (self.left, len(self.loads) - self.left))
        weight = _CONTACT.impedance / ((1 - _CONTACT.impedance) * yields)
        model.pair_solref[:, 0] = -springs / weight * _CONTACT.impedance
        model.pair_solref[:, 1] = -dampers / weight * _CONTACT.impedance
        model.pair_solreffriction[:] = (0.0, -_SLIDE * _CONTACT.impedance)
        return model

    # -- driving ----------------------------------------------------------------------------------

    def drive(self, controller: Controller, longest: float = 3600.0) -> Run:
        """Let a controller drive the robot."""
        data = self.mujoco.MjData(self.model)
        data.qpos[:2] = self.start[:2]
        data.qpos[3:7] = (np.cos(self.start.yaw / 2), 0.0, 0.0, np.sin(self.start.yaw / 2))
        book = Book(self, data)
        for _ in range(round(_CONTACT.settle / (PERIOD))):
            book.tick(np.zeros(2), -_CONTACT.settle)
        book.open()
        while (command := controller(book.state())) is not None:
            if book.t >= longest:
                raise PhysicsError(f"the drive is not over after {longest:g} s")
            speeds = np.asarray(command, float)
            if speeds.shape != (2,) or not np.all(np.isfinite(speeds)):
                raise InvalidInputError(
                    f"the controller asked for tread speeds {command} at {book.t:.2f} s; "
                    "give two finite numbers, or None to end the drive"
                )
            book.tick(speeds, book.t)
        return book.close()


def _words(values: FloatArray) -> str:
    return " ".join(repr(float(v)) for v in values)
