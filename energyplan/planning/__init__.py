"""Planners: one `PlanningProblem` in, one `Plan` out."""

from energyplan.planning.budget import Budget, cancellable
from energyplan.planning.driven import Candidate
from energyplan.planning.goal import Goal
from energyplan.planning.plans import (
    PLANNERS,
    Plan,
    Planner,
    find,
    plan,
    planners,
)
from energyplan.planning.problem import PlanningProblem

__all__ = [
    "PLANNERS",
    "Budget",
    "Candidate",
    "Goal",
    "Plan",
    "Planner",
    "PlanningProblem",
    "cancellable",
    "find",
    "plan",
    "planners",
]
