"""Powers that are read once in a while: what their readings show, as samples and as means."""

from __future__ import annotations

import numpy as np
import pytest

from energyplan import DriveLog, PowerModel, identify, simulate
from energyplan.fit.drive import Drive, prepared

MODEL = PowerModel.preset("quadriga:full:concrete")
NOISE = 5.0
EACH = 20  # rows a reading


def read_seldom(mean: bool, measured: str) -> DriveLog:
    """A drive whose powers are read in every twentieth row, by a meter or a sampler."""
    log = simulate.drive(MODEL, simulate.IDENTIFICATION, rate=20.0, power_noise=NOISE, seed=2)
    start = np.arange(len(log)) // EACH * EACH
    channels = dict(log.channels)
    for name in ("p_left", "p_right"):
        values = channels[name]
        if mean:
            total = np.concatenate([[0.0], np.cumsum(values)])
            last = np.maximum(start, EACH)
            values = (total[last] - total[last - EACH]) / EACH
        channels[name] = values[start]
    if measured == "total":
        channels["power"] = channels.pop("p_left") + channels.pop("p_right")
    return DriveLog(channels, "seldom")


@pytest.mark.parametrize("measured", ["sides", "total"])
@pytest.mark.parametrize("mean", [False, True])
def test_readings_are_predicted_as_what_they_are(mean: bool, measured: str) -> None:
    log = read_seldom(mean, measured)
    drive = Drive.of(log, MODEL.vehicle)
    assert drive.hold is not None
    assert (drive.hold.mean, drive.hold.rows) == (mean, EACH)
    found = identify(log, MODEL.vehicle)
    # Of readings at rest nothing is told, and their noise is that of both sides.
    noise = np.sqrt(2.0) * NOISE / (np.sqrt(EACH) if mean else 1.0)
    assert found.residual.rmse < 1.5 * noise + 0.01 * np.abs(log.power).max()
    np.testing.assert_allclose(found.model.coefficients, MODEL.coefficients, rtol=0.02)
    thin = prepared([log], MODEL.vehicle)[0].thinned(4).hold
    assert thin is not None
    assert thin.rows == EACH // 4
    assert np.all(thin.starts % (EACH // 4) == 0)


def test_what_is_read_with_every_row_or_side_by_side_is_not_held() -> None:
    """Where sides are read in turn, their sum is no reading at any instant."""
    log = simulate.drive(MODEL, "spiral", rate=20.0, power_noise=NOISE, seed=2)
    assert Drive.of(log, MODEL.vehicle).hold is None
    together = read_seldom(False, "sides")
    late = np.maximum(np.arange(len(together)) - EACH // 2, 0)
    apart = {**together.channels, "p_right": together.channels["p_right"][late]}
    assert Drive.of(together, MODEL.vehicle).hold is not None
    assert Drive.of(DriveLog(apart, "apart"), MODEL.vehicle).hold is None
