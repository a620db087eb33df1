"""Losses that the powers of both sides measure, and the heat of straights, are handed on."""

from __future__ import annotations

from pathlib import Path

import pytest

from energyplan import DriveLog, Vehicle, check, diagnose
from energyplan.diagnosis import Diagnosis
from energyplan.io.tables import read_trajectory

pytestmark = pytest.mark.shared

PLACE = Path("driven")
VEHICLE = Vehicle.preset("quadriga:full")
TRUE = {
    "copper_loss": {"slip_friction": 0.661, "traction_resistance": 118.0, "copper_loss": 0.000632},
    # over the efficiency; what powers tell of both efficiencies is the round trip
    "driver_efficiency": {
        "slip_friction": 0.751, "traction_resistance": 134.1, "regeneration_efficiency": 0.472,
    },
}  # fmt: skip


def logs(shared_data: Path, scenario: str) -> dict[str, DriveLog]:
    files = sorted((shared_data / PLACE).glob(f"{scenario}_*.csv.gz"))
    return {file.name.removesuffix(".csv.gz"): DriveLog.read(file) for file in files}


@pytest.fixture(scope="module", params=sorted(TRUE))
def told(request: pytest.FixtureRequest, shared_data: Path) -> tuple[str, Diagnosis]:
    """Learn from four of six drives that a tracking controller made."""
    every = logs(shared_data, request.param)
    rest = [log for name, log in every.items() if "_1_" not in name]
    judged = [log for name, log in every.items() if "_1_" in name]
    return request.param, diagnose(rest, judged, VEHICLE)


def test_coefficients_of_working_drives_are_right(told: tuple[str, Diagnosis]) -> None:
    scenario, found = told
    for name, true in TRUE[scenario].items():
        assert found.model.coefficient(name) == pytest.approx(true, rel=0.05), name


def test_plans_are_priced(told: tuple[str, Diagnosis], shared_data: Path) -> None:
    scenario, found = told
    for one, route in zip(found.predictions, ("least", "shortest"), strict=True):
        wanted = read_trajectory(shared_data / PLACE / f"{scenario}_1_{route}_trajectory.csv")
        assert check(wanted, found.model).energy == pytest.approx(one.measured, rel=0.06)
        low, high = one.energy_interval
        assert low < one.measured < high


def test_the_owner_is_told_what_the_sides_waste(told: tuple[str, Diagnosis]) -> None:
    _, found = told
    heat = found.effects[-1]
    assert heat.name == "wheel_fight"
    assert heat.unit == "W"
    assert 0.02 < heat.details["share of the energy"] < 0.17
    assert [line for line in found.advice if "a dead band of the heading" in line]
    average = found.average
    assert average is not None
    if average.explanation_error < average.cautious_error:
        assert not [line for line in found.advice if "do not believe" in line]
        assert not [line for line in found.advice if "suspicion" in line]
