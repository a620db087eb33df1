"""The rigid-body engine: MuJoCo, with contacts that slide as Coulomb says.

MuJoCo's contacts are meant for grasping: with its defaults a sliding wheel is lifted, hops, and
the instantaneous centre of rotation lies anywhere between 0.5 and 1.3 m where 0.476 m is right. So

- every contact is a spring and damper of its own, in proportion to the wheel's load. The impedance
  is the least that MuJoCo allows, so that the soft constraint adds next to nothing to it: a wheel
  sinks by `SINK`, whatever its slip; further where a wide stance about a light body would rock
  faster than the steps can follow, for wheels would hop then;
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

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.linalg import eigh

from energyplan.errors import InvalidInputError, MissingDependencyError, PhysicsError
from energyplan.path import FloatArray, Pose
from energyplan.physics._books import Book
from energyplan.physics.record import PERIOD, STEP, Run, State
from energyplan.physics.robot import Ground, Robot
from energyplan.vehicle import GRAVITY

if TYPE_CHECKING:
    import mujoco

SINK = 2e-4
"""How far a wheel sinks in under its own load, unless the robot would rock too fast [m]."""
REACH = 5.0
"""Height above the plane up to which a contact is watched, over how far a wheel sinks in [1]."""
TREAD_SHARE = 1e-3
"""Share of the robot's mass that each tread has [1]."""
ROTOR_SHARE = 5e-3
"""Inertia of each side's wheels and motor, seen at the tread, over the robot's mass [1]."""
SETTLE = 0.3
"""Time at standstill before the start, in which the wheels find their loads [s]."""
_BALL = 0.1  # radius of the spheres that touch the ground [m]; any will do
_IMPEDANCE = 1e-4  # the least that MuJoCo takes
_SLIDE = 1.0 / STEP  # damping of the tangential reference: slip ends within a step [1/s]
_RATIO = 1e7  # stiffness of the tangential directions over the normal one


def require_mujoco() -> Any:
    """Return the engine's module."""
    try:
        import mujoco
    except ImportError:
        raise MissingDependencyError(
            "driving in a physics engine needs MuJoCo; install the extra: "
            "pip install 'energyplan[physics]'"
        ) from None
    return mujoco


Controller = Callable[[State], tuple[float, float] | None]
"""Returns the tread speeds to reach by the next tick [m/s], or None at the end."""


class Engine:
    """A robot on its ground in MuJoCo."""

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
        length, width = vehicle.footprint[1] - vehicle.footprint[0]
        tall = 2 * robot.centre_height
        self._box = np.array([width**2 + tall**2, length**2 + tall**2, length**2 + width**2]) / 12
        self.sink = SINK * max(1.0, self._rocking())
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
        tread = TREAD_SHARE * mass
        body = mass - 2 * tread
        box, reach = self._box, REACH * self.sink
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
                f'diaginertia="{_words(tread * box)}"/>{spheres}</body>'
            )
        pairs = [
            f'<pair geom1="ground" geom2="wheel{k}" condim="3" margin="{reach}" gap="0" '
            f'friction="1 1 0 0 0" solimp="{_IMPEDANCE} {_IMPEDANCE} 1 0.5 1"/>'
            for k in range(len(self.loads))
        ]
        text = (
            f'<mujoco><option timestep="{STEP}" cone="elliptic" impratio="{_RATIO}" '
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
        dampers = 2 * np.sqrt(SINK / GRAVITY) * springs  # critical for the fastest motion
        # MuJoCo scales a contact's reference by its impedance and its force by the inertia there.
        yields = np.repeat(model.body_invweight0[2:, 0], (self.left, len(self.loads) - self.left))
        weight = _IMPEDANCE / ((1 - _IMPEDANCE) * yields)
        model.pair_solref[:, 0] = -springs / weight * _IMPEDANCE
        model.pair_solref[:, 1] = -dampers / weight * _IMPEDANCE
        model.pair_solreffriction[:] = (0.0, -_SLIDE * _IMPEDANCE)
        return model

    # -- driving ----------------------------------------------------------------------------------

    def drive(self, controller: Controller, longest: float = 3600.0) -> Run:
        """Let a controller drive the robot."""
        data = self.mujoco.MjData(self.model)
        data.qpos[:2] = self.start[:2]
        data.qpos[3:7] = (np.cos(self.start.yaw / 2), 0.0, 0.0, np.sin(self.start.yaw / 2))
        book = Book(self, data)
        for _ in range(round(SETTLE / (PERIOD))):
            book.tick(np.zeros(2), -SETTLE)
        book.open()
        while (command := controller(book.state())) is not None:
            if book.t >= longest:
                raise PhysicsError(f"the drive is not over after {longest:g} s")
            asked = np.asarray(command, float)
            if asked.shape != (2,) or not np.all(np.isfinite(asked)):
                raise InvalidInputError(
                    f"the controller asked for tread speeds {command} at {book.t:.2f} s; "
                    "give two finite numbers, or None to end the drive"
                )
            book.tick(asked, book.t)
        return book.close()


def _words(values: FloatArray) -> str:
    return " ".join(repr(float(v)) for v in values)
