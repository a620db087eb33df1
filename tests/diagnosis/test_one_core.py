"""Identification, diagnosis and the online estimator agree on one log with the same terms."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from by_day import by_day
from made_drives import pair, sized

from energyplan import diagnose, identify, simulate
from energyplan.fit import fit_residual
from energyplan.fit.doubts import leaves_open
from energyplan.fit.online import OnlineIdentifier
from energyplan.io.husky import read_husky
from energyplan.logs import DriveLog
from energyplan.power import HOTEL, SLIP, TRACTION, PowerModel
from energyplan.power.effects import catalogue
from energyplan.vehicle import Vehicle


def _robot(seed: int) -> PowerModel:
    if seed == 0:
        return PowerModel.preset("quadriga:full:concrete")
    rng = np.random.default_rng(seed)
    vehicle = sized(float(rng.uniform(0.5, 1.1)))
    K = float(rng.uniform(0.06, 0.1)) * vehicle.mass * 9.81 / 2
    return PowerModel.paper(vehicle, K=K, mu=float(rng.uniform(0.4, 0.8)))


@pytest.mark.parametrize("tau", [0.0, 1.0], ids=["white", "correlated"])
@pytest.mark.parametrize("seed", by_day(range(4), [0, 3]))
def test_three_ways_to_the_same_terms_agree_within_their_errors(seed: int, tau: float) -> None:
    model = _robot(seed)
    K = model.coefficient("traction_resistance")
    truth = model.with_term(HOTEL, 0.3 * K)
    noise: dict[str, Any] = {"power_noise": 0.05 * K, "speed_noise": 0.002, "correlation_time": tau}
    noise |= {"measured": "total"}  # the same data for all three
    log, unseen = pair(truth, seed, seed + 50, **noise)
    terms = (SLIP, TRACTION, HOTEL)
    found = identify(log, model.vehicle, terms=terms)
    told = diagnose(
        log, unseen, model.vehicle, effects=[catalogue()["hotel_load"]], choose=False
    ).model
    # Nothing is forgotten where the whole log is one surface.
    online = OnlineIdentifier(found.model.vehicle, terms=terms, memory=1e9)
    assert online.run(log) == ()
    for term in terms:
        ways = [
            (one.coefficient(term.name), one.std_error(term.name) or 0.0)
            for one in (found.model, told, online.model)
        ]
        values, errors = np.array(ways).T
        # Three estimators of one number: no further apart than errors of their own.
        assert np.ptp(values) < 4 * errors.max()
        assert errors.max() < 3 * errors.min()


def _agree(train: list[DriveLog], unseen: DriveLog, vehicle: Vehicle) -> None:
    """Hold the paper's terms and what they leave of a drive against each other, to rounding.

    A friction that drives leave open is handed on with what is known of other robots.
    """
    found = identify(train, vehicle)
    told = diagnose(train, unseen, vehicle, effects=[], choose=False)
    judged = [(told.paper, told.before), (told.model, told.after)][: 2 - leaves_open(found.model)]
    for model, _ in judged:
        for term in (SLIP.name, TRACTION.name):
            assert model.coefficient(term) == pytest.approx(
                found.model.coefficient(term), rel=1e-12
            )
            assert model.std_error(term) == pytest.approx(found.std_error[term], rel=1e-12)
    left = fit_residual(found.model, unseen)
    for _, errors in judged:
        for name in ("rmse", "mae", "bias", "energy_error", "correlation_time", "duration"):
            assert getattr(errors, name) == pytest.approx(getattr(left, name), rel=1e-9), name


@pytest.mark.parametrize(
    "case",
    by_day(
        ["sides 1", "sides 4", "total 1", "total 4", "battery 1", "battery 4"],
        ["sides 1", "total 4", "battery 1"],
    ),
)
def test_identify_and_diagnose_are_one_core(case: str) -> None:
    measured, count = case.split()
    model = _robot(2)
    model = replace(model, vehicle=replace(model.vehicle, drive_efficiency=0.8))
    noise: dict[str, Any] = {"power_noise": 8.0, "speed_noise": 0.005, "correlation_time": 0.5}
    noise["measured"] = measured
    logs = [simulate.identification_drive(model, seed=k, **noise) for k in range(int(count))]
    # A pause in the record, over which no energy is counted.
    parts = {k: np.delete(v, slice(700, 900)) for k, v in logs[0].channels.items()}
    logs[0] = DriveLog(parts)
    _agree(logs, simulate.validation_drive(model, seed=50, **noise), model.vehicle)


@pytest.mark.parametrize("measured", by_day(["sides", "total"], ["total"]))
def test_identify_fits_windows_as_diagnosis_does(measured: Any) -> None:
    entries = [catalogue()[name] for name in ("hotel_load", "viscous_loss", "linear_inertia")]
    terms = [SLIP, TRACTION, *(term for entry in entries for term in entry.terms)]
    model = _robot(1)
    truth = model.with_term(HOTEL, 20.0).with_term(entries[1].terms[0], 30.0)
    noise: dict[str, Any] = {"power_noise": 4.0, "speed_noise": 0.002, "measured": measured}
    logs = [simulate.identification_drive(truth, seed=k, **noise) for k in range(3)]
    unseen = simulate.validation_drive(truth, seed=50, **noise)
    told = diagnose(logs, unseen, model.vehicle, effects=entries, choose=False).model
    icr = told.vehicle.icr  # given: nothing of its error is passed on
    found = identify(logs, model.vehicle, terms=terms, method="windows", icr=icr)
    assert found.method == "windows"
    for term in terms:
        value, error = told.coefficient(term.name), told.std_error(term.name)
        assert found.model.coefficient(term.name) == pytest.approx(value, rel=1e-9)
        assert found.std_error[term.name] == pytest.approx(error, rel=1e-9)


@pytest.mark.shared
def test_identify_and_diagnose_are_one_core_on_recorded_drives(shared_data: Path) -> None:
    log = DriveLog.read(shared_data / "drive" / "warthog_grass.csv")
    cut = float(log.t[0] + 0.6 * log.duration)
    first, last = log.segment(float(log.t[0]), cut), log.segment(cut, float(log.t[-1]))
    _agree([first], last, Vehicle.preset("warthog"))
    folder = shared_data / "borealtc" / "FLOORING"
    runs = [read_husky(folder / f"pro_{k:02d}.csv") for k in (0, 1, 2, 3)]
    _agree(runs[:3], runs[3], Vehicle.preset("husky_a200"))
