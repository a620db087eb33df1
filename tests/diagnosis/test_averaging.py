"""Models for runs to come: averaged by how they predict whole runs that were left out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from energyplan import DriveLog, Vehicle, diagnose, simulate
from energyplan.diagnosis.averaging import averaged
from energyplan.diagnosis.fitting import Part, Problem
from energyplan.diagnosis.joint_fit import final_fit
from energyplan.diagnosis.windows import prepared
from energyplan.power import HOTEL, PowerModel
from energyplan.power.effects import Effect, catalogue

VEHICLE = Vehicle.preset("husky_a200")


def runs(count: int, spread: float, hotel: float = 0.0, seed: int = 0) -> list[DriveLog]:
    """Runs of one robot whose friction differs from run to run."""
    rng = np.random.default_rng(seed)
    made = []
    for k in range(count):
        K, mu = np.array([45.0, 0.5]) * np.exp(spread * rng.standard_normal(2))
        model = PowerModel.paper(VEHICLE, K, mu)
        if hotel:
            model = model.with_term(HOTEL, hotel)
        log = simulate.identification_drive(
            model, seed=seed + k, duration=130.0, rate=6.5, power_noise=3.0, speed_noise=0.003
        )
        made.append(replace(log, name=f"run {k}"))
    return made


def fitted(logs: list[DriveLog], parts: tuple[Part, ...]):
    problem = Problem(prepared(logs, VEHICLE), VEHICLE)
    return problem, final_fit(problem, parts)


def test_three_runs_are_too_few_to_tell() -> None:
    problem, fit = fitted(runs(3, 0.1), ())
    assert averaged(problem, fit) is None


def test_an_explanation_that_foretells_runs_counts_alone() -> None:
    """A load that every run has: two terms miss it by far, the explanation does not."""
    problem, fit = fitted(runs(6, 0.0, hotel=60.0), (Part(Effect.of(HOTEL)),))
    told = averaged(problem, fit)
    weight = 1.0 if told is None else told.weight
    assert weight > 0.9


def test_one_that_foretells_no_better_counts_about_half_and_errors_allow_for_both() -> None:
    problem, fit = fitted(runs(8, 0.25, seed=10), ())
    told = averaged(problem, fit)
    assert told is not None
    assert 0.25 < told.weight < 0.75
    model = told.fitted.model
    assert [term.name for term in model.terms] == [
        "slip_friction", "traction_resistance", "slip_speed_friction",
    ]  # fmt: skip
    low, high = sorted((fit.model.coefficients[1], model.coefficients[1]))
    assert low <= model.coefficients[1] <= high
    assert model.covariance is not None
    assert np.all(np.linalg.eigvalsh(model.covariance) > -1e-9)
    assert told.fitted.run_spread is not None
    assert told.fitted.run_spread == pytest.approx(0.2, abs=0.15)


def test_units_and_size_of_the_robot_do_not_matter() -> None:
    """Ten thousand times the power: the same weight, ten thousand times the coefficients."""
    small = runs(5, 0.2, seed=3)
    large = [
        DriveLog({n: v * (1e4 if n.startswith("p_") else 1.0) for n, v in log.channels.items()},
                 log.name)
        for log in small
    ]  # fmt: skip
    one, other = (averaged(*fitted(logs, ())) for logs in (small, large))
    assert one is not None
    assert other is not None
    assert other.weight == pytest.approx(one.weight, rel=1e-6)
    np.testing.assert_allclose(
        other.fitted.model.coefficients, 1e4 * one.fitted.model.coefficients, rtol=1e-6
    )


def test_a_run_at_rest_says_nothing_and_breaks_nothing() -> None:
    logs = runs(5, 0.1, seed=20)
    still = {name: 0.0 * values for name, values in logs[0].channels.items() if name != "t"}
    logs.append(DriveLog({"t": logs[0].t, **still}, "rest"))
    told = averaged(*fitted(logs, ()))
    assert told is not None
    assert np.all(np.isfinite(told.fitted.model.coefficients))


def test_the_diagnosis_says_what_its_model_is_made_of() -> None:
    logs = runs(6, 0.2, seed=40)
    told = diagnose(logs[:5], logs[5], VEHICLE, effects=[catalogue()["hotel_load"]])
    assert any("the model averages" in line for line in told.advice)
    (one,) = told.predictions
    low, high = one.energy_interval
    assert low < one.energy < high
    power = told.predictions_after[0]
    assert one.energy == pytest.approx(float(logs[5].weights @ power), rel=1e-9)
