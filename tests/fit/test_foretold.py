"""What unseen driving is missed by, against refits without it and against truth."""

from __future__ import annotations

import numpy as np
import pytest

from energyplan import DriveLog, PowerModel, fit, simulate
from energyplan.fit import fit_residual, identify
from energyplan.power import effects

TRUTH = PowerModel.preset("quadriga:full:concrete")
NOISE = {"power_noise": 5.0, "speed_noise": 0.003}


def spiral(seed: int, model: PowerModel = TRUTH) -> DriveLog:
    return simulate.drive(model, "spiral", duration=40.0, seed=seed, **NOISE)


def test_what_is_missed_is_what_fits_without_it_miss() -> None:
    """Drives of one robot that grows heavier by a tenth each time, fitted again without each."""
    logs = []
    for k in range(4):
        log = spiral(k)
        power = {name: (1.0 + 0.1 * k) * log.channel(name) for name in ("p_left", "p_right")}
        logs.append(DriveLog({**log.channels, **power}, f"drive {k}"))
    found = identify(logs, TRUTH.vehicle, icr="vehicle", method="huber")
    assert found.foretold is not None
    refits = [
        identify([one for one in logs if one is not log], TRUTH.vehicle, icr="vehicle",
                 method="huber").model
        for log in logs
    ]  # fmt: skip
    errors = [
        abs(fit_residual(model, log).energy_error)
        for model, log in zip(refits, logs, strict=True)
    ]  # fmt: skip
    assert (found.foretold.left_out, found.foretold.count) == ("drive", 4)
    assert found.foretold.duration == pytest.approx(40.0, abs=1.0)
    assert found.foretold.error == pytest.approx(np.mean(errors), rel=0.15)
    assert found.foretold.largest == pytest.approx(max(errors), rel=0.15)
    assert found.foretold.largest > 0.1  # the spread that was put in, and more than is left


def test_a_model_that_lacks_nothing_foretells_and_one_that_lacks_something_says_how_much() -> None:
    cold = TRUTH.with_term(effects.term("warm_up"), 150.0)
    warm, warming = (
        identify(simulate.identification_drive(model, seed=1, **NOISE), TRUTH.vehicle)
        for model in (TRUTH, cold)
    )
    assert warm.foretold is not None
    assert warming.foretold is not None
    assert (warm.foretold.left_out, warm.foretold.count) == ("stretch", 5)
    assert warm.foretold.error < 0.01 < 0.03 < warming.foretold.error
    size = f"energies by some {100 * warming.foretold.error:.2g} %"
    assert any(size in text for text in warming.warnings), warming.warnings


def test_drives_that_are_one_motion_only_are_foretold_too() -> None:
    """Without turning there is no column of slip to fit; with one sample a stretch, no error."""
    log = simulate.drive(TRUTH, (("straight", 30.0),), seed=1, **NOISE)
    found = fit.identify(log, TRUTH.vehicle, terms=[effects.term("traction_resistance")])
    assert found.foretold is not None
    assert found.foretold.error < 0.02
