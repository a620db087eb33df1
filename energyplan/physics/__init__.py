"""A robot in a physics engine (MuJoCo) that knows nothing of the power model.

`drive` follows a trajectory with a tracking controller, and returns the energy that was taken and
the energy that a model predicts. `HiddenEffect` switches on what the model does not know. `Sensors`
makes a drive log. `close_loop` plans, drives, diagnoses and plans again. The extra ``physics``
installs the engine.
"""

from energyplan.physics.driving import Driven, Sensors, Tracking, drive, energy_predicted
from energyplan.physics.engine import Engine, Run, State
from energyplan.physics.loop import EngineDrives, Loop, Round, close_loop
from energyplan.physics.robot import (
    EFFECTS,
    Border,
    EngineGround,
    EngineRobot,
    HiddenEffect,
    draw_effects,
    switch_on,
)

__all__ = [
    "EFFECTS",
    "Border",
    "Driven",
    "Engine",
    "EngineDrives",
    "EngineGround",
    "EngineRobot",
    "HiddenEffect",
    "Loop",
    "Round",
    "Run",
    "Sensors",
    "State",
    "Tracking",
    "close_loop",
    "draw_effects",
    "drive",
    "energy_predicted",
    "switch_on",
]  # fmt: skip
