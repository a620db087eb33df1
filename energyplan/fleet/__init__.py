"""Several robots that share tasks and chargers: who does what, and who charges when.

Exact with a certificate for a few robots and tasks; OR-Tools beyond, with a bound on what is lost.
Each robot's battery is then run over what it does, as `energyplan.mission` does it.
"""

from energyplan.fleet.evaluation import evaluate_fleet
from energyplan.fleet.types import Fleet, FleetReport, LeftOut, Robot, RobotReport, RobotState

__all__ = [
    "Fleet", "FleetReport", "LeftOut", "Robot", "RobotReport", "RobotState", "evaluate_fleet",
]  # fmt: skip
