"""What users read about ready-made robots and models is what the library plans with."""

from __future__ import annotations

from math import inf
from pathlib import Path

import numpy as np
import pytest

from energyplan import PowerModel, Vehicle
from energyplan.power.presets import MODEL_PRESETS
from energyplan.vehicle import VEHICLE_PRESETS

PAGE = Path(__file__).parents[2] / "docs" / "tables.md"


def _table(title: str) -> dict[str, list[str]]:
    section = PAGE.read_text(encoding="utf-8").split(f"\n## {title}\n")[1].split("\n## ")[0]
    rows = [line for line in section.splitlines() if line.startswith("| `")]
    cells = [[cell.strip() for cell in line.strip("|").split(" |")] for line in rows]
    return {name.strip("`"): numbers for name, *numbers in cells}


def _sources() -> dict[str, str]:
    lines = [line for line in PAGE.read_text(encoding="utf-8").splitlines() if line[:3] == "- `"]
    split = [line.partition("`: ") for line in lines]
    return {source.removesuffix("."): names + "`" for names, _, source in split}


def _number(cell: str, otherwise: float) -> float:
    return float(cell) if cell else otherwise


def test_vehicles() -> None:
    table = _table("Vehicles")
    assert set(table) == set(VEHICLE_PRESETS)
    for name, cells in table.items():
        vehicle = Vehicle.preset(name)
        motor = vehicle.motor
        body, wheels = np.ptp(vehicle.footprint, axis=0), np.ptp(vehicle.contacts, axis=0)
        known = [
            vehicle.mass, *wheels, *body, motor.speed, motor.acceleration, motor.force,
            motor.peak_power, motor.continuous_power, motor.regeneration,
        ]  # fmt: skip
        assert known == pytest.approx([_number(cell, inf) for cell in cells]), name


def test_power_models() -> None:
    table = _table("Power models")
    assert set(table) == set(MODEL_PRESETS)
    for name, cells in table.items():
        model, preset = PowerModel.preset(name), MODEL_PRESETS[name]
        traction, its_error, slip, slip_error, half_track, spread = (
            _number(cell, 0.0) for cell in cells
        )
        assert model.coefficient("traction_resistance") == traction, name
        assert model.coefficient("slip_friction") == slip, name
        whole = Vehicle.preset(preset.vehicle).icr.half_track
        assert model.vehicle.icr.half_track == pytest.approx(half_track or whole), name
        assert f"`{name}`" in _sources()[preset.source]
        assert model.vehicle.name == Vehicle.preset(preset.vehicle).name
        known = (model.std_error("traction_resistance"), model.std_error("slip_friction"))
        for error, of_mean, value in zip(
            known, (its_error, slip_error), (traction, slip), strict=True
        ):
            # a run differs from the mean as a whole, and the mean is known to its own error
            stated = np.hypot(of_mean, spread * value)
            assert error == (pytest.approx(stated) if stated else None), name
