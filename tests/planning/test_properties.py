"""The guard of what every plan has notices a plan that lacks it."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import energyplan as ep

sys.path.append(str(Path(__file__).parents[2] / "benchmarks"))
properties = importlib.import_module("properties")


@pytest.fixture(scope="module")
def case():
    """A problem whose answer has every property, and the answers to it and to its images."""
    cases = map(properties.drawn, range(20))
    drawn = next(one for one in cases if not one.sided and one.problem.surfaces is None)
    answers = []

    def answer(problem: ep.PlanningProblem) -> ep.Plan:
        answers.append(ep.plan(problem, effort=1000))
        return answers[-1]

    found = answer(drawn.problem)
    assert list(properties.faults(drawn, found, answer)) == []
    assert len(answers) == 8
    return drawn, answers


def longer(plan: ep.Plan, by: float) -> ep.Plan:
    path = plan.path
    ds, dtheta = np.append(path.ds, by), np.append(path.dtheta, 0.0)
    return replace(plan, path=replace(path, ds=ds, dtheta=dtheta))


def faster(plan: ep.Plan) -> ep.Plan:
    other = replace(plan)
    scaled = plan.driven.trajectory.scaled(1.5)
    other.__dict__["driven"] = replace(plan.driven, trajectory=scaled)
    return other


FAULTS: dict[str, Callable[[ep.Plan, int], ep.Plan]] = {
    "lies below the bound": lambda p, _: replace(p, lower_bound_steady=1.01 * p.energy_steady),
    "terms add up": lambda p, _: replace(
        p, breakdown={name: 1.001 * part for name, part in p.breakdown.items()}
    ),
    "arcs add up": lambda p, _: replace(p, energy_steady=1.001 * p.energy_steady),
    "misses the goal": lambda p, _: longer(p, 1e-6),
    "not free": lambda p, _: longer(longer(p, 30.0), -30.0),
    "planned again": lambda p, k: replace(p, energy_steady=p.energy_steady * (1 + 1e-12 * k)),
    "translated: ": lambda p, k: replace(
        p, lower_bound_steady=p.lower_bound_steady * (3 if k == 2 else 1)
    ),
    "rotated: ": lambda p, k: replace(
        p, lower_bound_steady=p.lower_bound_steady * (3 if k == 3 else 1)
    ),
    "rotated by cells: ": lambda p, k: replace(
        p, energy_steady=p.energy_steady * (0.3 if k == 4 else 1)
    ),
    "mirrored: ": lambda p, k: replace(
        p, lower_bound_steady=p.lower_bound_steady * (3 if k == 5 else 1)
    ),
    "ends swapped: ": lambda p, k: replace(
        p, lower_bound_steady=p.lower_bound_steady * (3 if k == 6 else 1)
    ),
    "wider obstacles": lambda p, k: replace(
        p, lower_bound_steady=p.lower_bound_steady * (0.99 if k > 6 else 1)
    ),
    "check refuses": lambda p, _: faster(p),
}


@pytest.mark.parametrize("words", FAULTS)
def test_a_plan_that_lacks_a_property_is_noticed(words, case):
    drawn, answers = case
    found, *others = (FAULTS[words](plan, k) for k, plan in enumerate(answers))
    ready = iter(others)
    told = list(properties.faults(drawn, found, lambda _: next(ready)))
    assert any(words in line for line in told), told
