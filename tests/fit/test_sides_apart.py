"""What the sum of both sides' powers shows of friction, and what their difference: one answer."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from energyplan import DriveLog, PowerModel, Vehicle, identify, simulate
from energyplan.fit import Identification

MODEL = PowerModel.preset("quadriga:full:concrete")


def both(logs: list[DriveLog], vehicle: Vehicle) -> list[Identification]:
    return [identify(logs, vehicle, method=method) for method in ("lad", "windows")]


def agree(found: list[Identification]) -> bool:
    values, errors = np.array(
        [(one.model.coefficient("slip_friction"), one.std_error["slip_friction"]) for one in found]
    ).T
    return bool(abs(values[1] - values[0]) < 2.0 * np.hypot(*errors))


def drive(seed: int, heat: float) -> DriveLog:
    """Drive in which both sides lose alike in turns, as a share of the friction there."""
    log = simulate.identification_drive(MODEL, rate=10.0, power_noise=5.0, seed=seed)
    omega = np.abs(log.motion(MODEL.vehicle.icr).omega)
    lost = 0.5 * heat * MODEL.coefficient("slip_friction") * MODEL.vehicle.slip_moment * omega
    sides = {name: log.channel(name) + lost for name in ("p_left", "p_right")}
    return replace(log, channels={**log.channels, **sides})


@pytest.mark.parametrize("heat", [0.0, 1.0])
def test_what_turns_lose_beside_friction_is_said_and_priced(heat: float) -> None:
    found = both([drive(seed, heat) for seed in range(2)], MODEL.vehicle)
    assert agree(found)
    for one in found:
        mu = one.model.coefficient("slip_friction") / MODEL.coefficient("slip_friction")
        assert mu == pytest.approx(1.0 + heat, rel=0.03)
        told = [line for line in one.warnings if "their difference" in line]
        assert len(told) == (heat > 0.0)
        assert not told or "turns take more than friction" in told[0]


@pytest.mark.shared
def test_a_warthog_on_grass_gets_one_answer(shared_data: Path) -> None:
    """The sum showed mu = 1.37, the difference 0.50, by the method alone."""
    whole = DriveLog.read(shared_data / "drive" / "warthog_grass.csv")
    log = whole.segment(80.0, 360.0)
    found = both([log], Vehicle.preset("warthog"))
    assert agree(found)
    assert found[1].residual.rmse == pytest.approx(found[0].residual.rmse, rel=0.05)
    assert all(any("their difference" in line for line in one.warnings) for one in found)
