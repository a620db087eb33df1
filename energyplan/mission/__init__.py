"""Battery budget missions of one robot or several; see `energyplan.mission.evaluation`."""

from energyplan.mission.evaluation import (
    Doubt,
    Evaluated,
    MissionReport,
    TaskReport,
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
from energyplan.mission.trip import Activity, ChargerReport, Segment, Stop, Timeline
from energyplan.mission.types import Charger, Mission, Remedy, Spreads, Task

__all__ = [
    "Activity", "Charger", "ChargerReport", "Doubt", "Evaluated", "Fleet", "FleetReport", "LeftOut",
    "Mission", "MissionReport", "Remedy", "Robot", "RobotReport", "RobotState", "Routes", "Segment",
    "Spreads", "Stop", "Task", "TaskReport", "Timeline", "evaluate", "evaluate_fleet",
    "evaluate_many",
]  # fmt: skip
