"""What is handed on is possible: by what the log shows at rest, and by the vehicle's mass."""

from __future__ import annotations

import numpy as np
import pytest

from energyplan import DriveLog, PowerModel, diagnose, simulate
from energyplan.diagnosis import Diagnosis
from energyplan.diagnosis.candidates import Part
from energyplan.diagnosis.judge import doubt
from energyplan.diagnosis.search import Gain
from energyplan.fit.estimate import Fitted
from energyplan.fit.run import RunEffect
from energyplan.motion import Motion
from energyplan.power.effects import catalogue

ROBOT = PowerModel.preset("quadriga:full:concrete")
EFFECTS = [catalogue()[name] for name in ("hotel_load", "viscous_loss", "payload_change")]


def told(more: float, friction: float) -> Diagnosis:
    """Diagnose drives that take more power while they move, on less friction from a time on."""
    slippery = ROBOT.with_coefficients(ROBOT.coefficients * friction)
    drives = []
    for seed, pattern in enumerate((simulate.IDENTIFICATION, simulate.VALIDATION)):
        log = simulate.drive(
            ROBOT, pattern, power_noise=3.0, speed_noise=0.002, seed=seed,
            changes=[(60.0, slippery)] if friction < 1.0 else [],
        )  # fmt: skip
        moves = np.maximum(abs(log.channel("v_left")), abs(log.channel("v_right"))) > 0.02
        own = {side: log.channel(side) + 0.5 * more * moves for side in ("p_left", "p_right")}
        drives.append(DriveLog({**log.channels, **own}, f"drive {seed}"))
    return diagnose(drives[0], drives[1], ROBOT.vehicle, effects=EFFECTS)


def test_no_constant_load_where_the_power_is_zero_at_rest() -> None:
    found = told(17.0, 1.0)
    assert "hotel_load" not in [effect.name for effect in found.effects]
    still = Motion.from_twist(0.0, 0.0, found.model.vehicle.icr)
    assert float(found.model.power(still)) < 1.0


def test_a_robot_sets_down_no_more_than_half_of_itself() -> None:
    """Friction that falls by 0.6 is another surface: no 88 kg of 147 kg were set down."""
    found = told(0.0, 0.4)
    assert "payload_change" not in [effect.name for effect in found.effects]
    assert found.verdict == "unexplained"


@pytest.mark.parametrize(
    ("size", "error", "missing", "why"),
    [
        (40.0, 5.0, 0.01, None),
        (40.0, 25.0, 0.01, "size"),
        (40.0, 5.0, 0.03, "missing"),
        (1e6, 5.0, 0.01, "range"),
    ],
)
def test_an_effect_is_named_by_its_size_over_its_error_and_over_what_is_missing(
    size: float, error: float, missing: float, why: str | None
) -> None:
    part = Part(catalogue()["warm_up"], (("time_constant", 60.0),))
    model = ROBOT.with_term(part.terms[0], size)
    model = model.with_coefficients(model.coefficients, np.diag([0.01, 1.0, error**2]))
    gain = Gain(1.0, 0.1, 0.0, 20.0, share=0.05, lasting=1.0)
    most, reason = doubt(part, gain, Fitted(model, RunEffect(), (), np.zeros((0, 0))), missing)
    assert (reason if most >= 1.0 else None) == why
