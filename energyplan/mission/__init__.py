"""Battery budget missions of one robot or several; see `energyplan.mission.evaluation`."""

from energyplan.mission.evaluation import (
    ChargerReport,
    Doubt,
    Evaluated,
    LegReport,
    MissionReport,
    Stop,
    TaskReport,
    Timeline,
    evaluate,
    evaluate_many,
)
from energyplan.mission.legs import Routes
from energyplan.mission.robots import (
    Fleet,
    FleetReport,
    LeftOut,
    Robot,
    RobotReport,
    RobotState,
    evaluate_fleet,
)
from energyplan.mission.types import Charger, Mission, Remedy, Spreads, Task

__all__ = [
    "Charger", "ChargerReport", "Doubt", "Evaluated", "Fleet", "FleetReport", "LeftOut",
    "LegReport", "Mission", "MissionReport", "Remedy", "Robot", "RobotReport", "RobotState",
    "Routes", "Spreads", "Stop", "Task", "TaskReport", "Timeline", "evaluate", "evaluate_fleet",
    "evaluate_many",
]  # fmt: skip
