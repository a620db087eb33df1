"""The rigid-body engine: MuJoCo, with contacts that slide as Coulomb says.

MuJoCo's contacts are meant for grasping: with its defaults a sliding wheel is lifted, hops, and
the instantaneous centre of rotation lies anywhere between 0.5 and 1.3 m where 0.476 m is right. So

- every contact is a spring and damper of its own, in proportion to the wheel's load. The impedance
  is the least that MuJoCo allows, so that the soft constraint adds next to nothing to it: a wheel
  sinks by `SINK`, whatever its slip;
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
  run ahead of its treads, and do work on it at each start and stop.

The ground is a plane. Slopes tilt gravity.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from energyplan.errors import InvalidInputError, MissingDependencyError, PhysicsError
from energyplan.path import FloatArray, Pose
from energyplan.physics.record import PERIOD, STEP, TICK, Run, State
from energyplan.physics.robot import Ground, Robot
from energyplan.vehicle import GRAVITY

if TYPE_CHECKING:
    import mujoco

SINK = 2e-4
"""How far a wheel sinks in under its own load [m]."""
REACH = 1e-3
"""Height above the plane up to which a contact is watched [m]."""
TREAD_SHARE = 1e-3
"""Share of the robot's mass that each tread has [1]."""
ROTOR_SHARE = 5e-3
"""Inertia of each side's wheels and motor, seen at the tread, over the robot's mass [1]."""
SERVO = 0.005
"""Time constant of the velocity servos [s]."""
RESET = 0.1
"""Reset time of their integral part [s]."""
SETTLE = 0.3
"""Time at standstill before the start, in which the wheels find their loads [s]."""

_BALL = 0.1  # radius of the spheres that touch the ground [m]; any will do
_IMPEDANCE = 1e-4  # the least that MuJoCo takes
_SLIDE = 1.0 / STEP  # damping of the tangential reference: slip ends within a step [1/s]
_RATIO = 1e7  # stiffness of the tangential directions over the normal one


def require_mujoco() -> Any:
    """Return the engine's module.

    Raises
    ------
    MissingDependencyError
        If it is not installed; the message names the extra.
    """
    try:
        import mujoco
    except ImportError:
        raise MissingDependencyError(
            "driving in a physics engine needs MuJoCo; install the extra: "
            "pip install 'energyplan[physics]'"
        ) from None
    return mujoco


class Outer(NamedTuple):
    """Where the robot is at the start of a tick, and what pulls at it from outside."""

    place: FloatArray
    yaw: float
    gravity: FloatArray
    gradient: FloatArray
    pull: float


Controller = Callable[[State], tuple[float, float] | None]
"""Returns the tread speeds to reach by the next tick [m/s], or None at the end."""


class Engine:
    """A robot on its ground in MuJoCo.

    Parameters
    ----------
    robot : Robot
        The robot.
    ground : Ground, optional
        The ground; even and level where not given.
    start : Pose
        Where it stands.

    Raises
    ------
    MissingDependencyError
        If MuJoCo is not installed.

    Examples
    --------
    >>> from energyplan.power import PowerModel
    >>> from energyplan.physics import Engine, Robot
    >>> robot = Robot.from_model(PowerModel.preset("quadriga:empty:concrete"))
    >>> run = Engine(robot).drive(lambda state: 2 * (min(0.5, state.t),) if state.t < 2.0 else None)
    >>> round(float(run.x[-1]), 1), run.taken > 0
    (0.9, True)
    """

    def __init__(
        self, robot: Robot, ground: Ground | None = None, start: Pose | None = None
    ) -> None:
        self.mujoco = require_mujoco()
        self.robot, self.ground = robot, ground or Ground()
        self.start = start or Pose(0.0, 0.0, 0.0)
        vehicle = robot.vehicle
        left = vehicle.contacts[:, 1] > 0
        loaded = [np.flatnonzero((vehicle.loads > 0) & side) for side in (left, ~left)]
        if not all(len(side) for side in loaded):
            raise InvalidInputError("all load rests on one side; give loads on both sides")
        order = np.concatenate(loaded)  # the wheels on the left come first
        self.points, self.loads = vehicle.contacts[order], vehicle.loads[order]
        self.left = len(loaded[0])
        self.model = self._build()

    # -- the model --------------------------------------------------------------------------------

    def _build(self) -> mujoco.MjModel:
        robot, vehicle = self.robot, self.robot.vehicle
        mass = vehicle.mass
        centre = np.append(self.loads @ self.points / self.loads.sum(), robot.centre_height)
        tread = TREAD_SHARE * mass
        body = mass - 2 * tread
        length, width = vehicle.footprint[1] - vehicle.footprint[0]
        tall = 2 * robot.centre_height
        box = np.array([width**2 + tall**2, length**2 + tall**2, length**2 + width**2])
        treads = []
        for side, wheels in enumerate(np.split(np.arange(len(self.loads)), [self.left])):
            spheres = "".join(
                f'<geom name="wheel{k}" type="sphere" size="{_BALL}" mass="0" contype="0" '
                f'conaffinity="0" pos="{self.points[k, 0]} {self.points[k, 1]} {_BALL}"/>'
                for k in wheels
            )
            # The armature is that of the wheels, and what the tread's own mass takes off.
            treads.append(
                f'<body name="tread{side}"><joint name="tread{side}" type="slide" axis="-1 0 0" '
                f'frictionloss="1" damping="{robot.viscous}" '
                f'armature="{ROTOR_SHARE * mass + tread}" '
                f'solreffriction="{2 * STEP} 1" solimpfriction="0.99 0.99 0.01 0.5 1"/>'
                f'<inertial pos="{_words(centre)}" mass="{tread}" '
                f'diaginertia="{_words(tread / 12 * box)}"/>{spheres}</body>'
            )
        pairs = [
            f'<pair geom1="ground" geom2="wheel{k}" condim="3" margin="{REACH}" gap="0" '
            f'friction="1 1 0 0 0" solimp="{_IMPEDANCE} {_IMPEDANCE} 1 0.5 1"/>'
            for k in range(len(self.loads))
        ]
        text = (
            f'<mujoco><option timestep="{STEP}" cone="elliptic" impratio="{_RATIO}" '
            'solver="Newton" iterations="50" tolerance="1e-12"><flag eulerdamp="disable"/></option>'
            "<worldbody>"
            '<geom name="ground" type="plane" size="1 1 1" contype="0" conaffinity="0"/>'
            f'<body name="robot" pos="0 0 {REACH - SINK}"><freejoint/>'
            f'<inertial pos="{_words(centre)}" mass="{body}" '
            f'diaginertia="{_words(body / 12 * box)}"/>{"".join(treads)}</body></worldbody>'
            f"<contact>{''.join(pairs)}</contact></mujoco>"
        )
        model = self.mujoco.MjModel.from_xml_string(text)
        springs = self.loads / SINK
        dampers = 2 * np.sqrt(GRAVITY / SINK) * self.loads / GRAVITY
        # MuJoCo scales a contact's reference by its impedance and its force by the inertia there.
        yields = np.repeat(model.body_invweight0[2:, 0], (self.left, len(self.loads) - self.left))
        weight = _IMPEDANCE / ((1 - _IMPEDANCE) * yields)
        model.pair_solref[:, 0] = -springs / weight * _IMPEDANCE
        model.pair_solref[:, 1] = -dampers / weight * _IMPEDANCE
        model.pair_solreffriction[:] = (0.0, -_SLIDE * _IMPEDANCE)
        return model

    # -- driving ----------------------------------------------------------------------------------

    def drive(self, controller: Controller, longest: float = 3600.0) -> Run:
        """Let a controller drive the robot.

        Parameters
        ----------
        controller : callable
            ``controller(state) -> (v_left, v_right)``, asked every tick; None ends the drive.
        longest : float
            When to give up [s].

        Returns
        -------
        Run
            What happened.

        Raises
        ------
        PhysicsError
            If a wheel leaves the ground, the motion diverges, or the time is up.
        """
        data = self.mujoco.MjData(self.model)
        data.qpos[:2] = self.start[:2]
        data.qpos[3:7] = (np.cos(self.start.yaw / 2), 0.0, 0.0, np.sin(self.start.yaw / 2))
        book = _Book(self, data)
        for _ in range(round(SETTLE / (PERIOD))):
            book.tick((0.0, 0.0), -SETTLE)
        book.open()
        while (command := controller(book.state())) is not None:
            if book.t >= longest:
                raise PhysicsError(f"the drive is not over after {longest:g} s")
            book.tick(command, book.t)
        return book.close()


def _words(values: FloatArray) -> str:
    return " ".join(repr(float(v)) for v in values)


_COLUMNS = (
    "x", "y", "yaw", "v", "omega", "v_left", "v_right", "force_left", "force_right", "shaft_left",
    "shaft_right", "battery_left", "battery_right", "accel_x", "slope",
)  # fmt: skip


class _Book:
    """Steps the engine and keeps the books.

    Of velocities the first six are the body's, the last two the treads'. Of constraint forces the
    first two are the treads' dry friction, then come three for each contact: load and tangential.
    """

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
        self._gain, self._most = 0.5 * robot.vehicle.mass / SERVO, robot.vehicle.motor.force
        self._armature = engine.model.dof_armature[6:].copy()
        self._centre = engine.loads @ engine.points / engine.loads.sum()
        self._integral, self._target = np.zeros(2), np.zeros(2)
        self._count = 0
        self._rows: list[FloatArray] = []
        self._sums: list[FloatArray] = []
        self._kinetic = 0.0
        self._force = np.zeros((TICK + 1, wheels, 3))
        self._force[:, :, 0] = engine.loads
        self._slip = np.zeros((TICK + 1, wheels, 3))

    @property
    def t(self) -> float:
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

    def state(self) -> State:
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
        return Outer(np.array([x, y]), yaw, model.opt.gravity[:2].copy(), gradient, pull)

    def tick(self, command: tuple[float, float], t: float) -> None:
        """Drive towards the commanded tread speeds for one tick."""
        data, model, step = self._data, self._model, self._mj_step
        outer = self._prepare(t)
        before, self._target = self._target, np.array(command)
        error = before - data.qvel[6:]
        gain, stiff = self._gain, STEP * self._gain
        most = self._most / gain
        self._integral = np.clip(self._integral + error * (PERIOD / RESET), -most, most)
        still = self._armature + STEP * self._engine.robot.viscous
        speeds = np.empty((TICK + 1, 8))
        motor, friction = np.empty((TICK, 2)), np.empty((TICK, 2))
        speeds[0] = data.qvel
        self._force[0], self._slip[0] = self._force[-1], self._slip[-1]
        rows = 2 + 3 * self._wheels
        shares = np.arange(1, TICK + 1)[:, None] / TICK
        aims = before + (self._target - before) * shares + self._integral
        applied, armature = data.qfrc_applied[6:], model.dof_armature[6:]
        for k in range(TICK):
            wanted = gain * (aims[k] - speeds[k, 6:])
            free = stiff * (np.abs(wanted) < self._most)
            applied[:] = np.minimum(np.maximum(wanted, -self._most), self._most)
            armature[:] = still + free
            step(model, data)
            force = data.efc_force
            if len(force) != rows:
                raise PhysicsError(
                    f"a wheel left the ground at {max(t, 0.0):.2f} s; the robot tips over: lower "
                    "the centre of mass, the slope or the acceleration"
                )
            data.qpos[7:] = 0.0
            speeds[k + 1] = data.qvel
            motor[k] = applied - free * data.qacc[6:]
            friction[k] = force[:2]
            self._force[k + 1] = force[2:].reshape(-1, 3)
            self._slip[k + 1] = data.efc_vel[2:].reshape(-1, 3)
        if not np.all(np.isfinite(speeds)):
            raise PhysicsError(f"the motion diverged at {max(t, 0.0):.2f} s")
        self._count += 1
        self._enter(outer, speeds, motor, friction)

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
        # A contact's velocity is known at the start of each step, its force for the step.
        ends = np.concatenate([self._slip[1:], self._slip[-1:]])
        slip = 0.5 * (ends[:-1] + ends[1:])
        sliding = -float(np.sum(self._force[1:, :, 1:] * slip[:, :, 1:]))
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
        pulled = -outer.pull * ahead * time
        accel = (speeds[-1, :2] - speeds[0, :2]) / time - outer.gravity
        self._rows.append(np.array([
            *here, yaw, ahead, omega, *tread.mean(axis=0), *motor.mean(axis=0),
            *shaft.mean(axis=0), *(shaft + losses.sum(axis=0)).mean(axis=0),
            accel @ [c, s], np.arctan(outer.gradient @ [c, s]),
        ]))  # fmt: skip
        self._sums.append(np.array([
            STEP * shaft.sum(), STEP * sliding, STEP * dry, STEP * damped, lifted, pulled,
            *(STEP * losses.sum(axis=(1, 2))),
        ]))  # fmt: skip

    def close(self) -> Run:
        """Return what was booked."""
        if not self._rows:
            raise PhysicsError("the drive was over before it began")
        robot, time = self._engine.robot, PERIOD
        rows = np.array(self._rows).T
        motor, sliding, dry, damped, lifted, pulled, *losses = np.sum(self._sums, axis=0)
        mechanical = {
            "slip_friction": sliding, "traction_resistance": dry, "viscous_loss": damped,
            "grade": lifted, "towing_and_drag": pulled,
            "kinetic": self._kinetic_energy() - self._kinetic,
        }  # fmt: skip
        closure = motor - sum(mechanical.values())
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
