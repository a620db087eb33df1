"""Battery budget missions of one robot or several; see `energyplan.mission.evaluation`."""

from energyplan.mission.drive import Segment
from energyplan.mission.evaluation import Evaluated, evaluate, evaluate_many
from energyplan.mission.report import (
    Activity,
    Alternative,
    ChargerReport,
    Contribution,
    MissionReport,
    Stop,
    TaskReport,
    Timeline,
)  # fmt: skip
from energyplan.mission.routes import Routes
from energyplan.mission.types import Charger, Mission, Remedy, Robot, RobotState, Spreads, Task

__all__ = [
    "Activity", "Alternative", "Charger", "ChargerReport", "Contribution", "Evaluated", "Mission",
    "MissionReport", "Remedy", "Robot", "RobotState", "Routes", "Segment", "Spreads", "Stop",
    "Task", "TaskReport", "Timeline", "evaluate", "evaluate_many",
]  # fmt: skip
