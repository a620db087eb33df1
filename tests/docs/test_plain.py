"""Plain fits beside the library's: each finds what it can show, and kept runs are its own."""

from __future__ import annotations

import importlib
import json
import sys
from pathlib import Path

import numpy as np
import pytest

import energyplan as ep
from energyplan import simulate
from energyplan.power import HOTEL

sys.path.append(str(Path(__file__).resolve().parents[2] / "benchmarks"))
plain, card = importlib.import_module("plain"), importlib.import_module("card")


@pytest.fixture(scope="module")
def runs() -> list[ep.DriveLog]:
    """Drives of a robot with a load at rest, which two terms do not have."""
    truth = ep.PowerModel.preset("quadriga:full:concrete").with_term(HOTEL, 60.0)
    return [simulate.identification_drive(truth, power_noise=3.0, seed=k) for k in range(3)]


@pytest.mark.parametrize(
    ("fit", "most"), [("ridge", 0.01), ("LAD", 0.01), ("boosting", 0.05), ("process", 0.02)]
)
def test_a_plain_fit_predicts_a_run_that_it_did_not_see(
    runs: list[ep.DriveLog], fit: str, most: float
) -> None:
    vehicle = ep.Vehicle.preset("quadriga:full")
    paper = ep.identify(runs[:2], vehicle).model
    *learned, unseen = (plain.Windows.of(run, vehicle, paper) for run in runs)
    energy = float(unseen.time @ unseen.power)
    assert energy == pytest.approx(runs[2].energy, rel=1e-9)
    told = float(unseen.time @ plain.PLAIN[fit](learned)(unseen))
    assert abs(told / energy - 1.0) < most
    two_terms = float(unseen.time @ unseen.paper)
    assert abs(told - energy) < abs(two_terms - energy)


def test_the_least_error_of_a_line_is_bold_and_hindsight_is_none() -> None:
    told = plain.line("sand", 3, np.array([0.05, 0.04, 0.06, 0.07, 0.08, 0.09, 0.01]))
    assert told == "| sand | 3 | 5.0 % | **4.0 %** | 6.0 % | 7.0 % | 8.0 % | 9.0 % | 1.0 % |"


def test_kept_predictions_of_another_version_are_not_used(
    runs: list[ep.DriveLog], tmp_path: Path
) -> None:
    file = tmp_path / "kept.jsonl"
    ground = card.Ground("SAND", runs, ep.Vehicle.preset("quadriga:full"))
    figures = [[0.1, 0.2, True, 0.3, 0.4], [0.5, 0.6, False, 0.7, 0.8], [0.9, 1.0, True, 1.1, 1.2]]
    rows = [
        [card.version(), "SAND", f"{k} {run.name}", *one]
        for k, (run, one) in enumerate(zip(runs, figures, strict=True))
    ]
    other = [["of old", *rows[0][1:3], *figures[1]], [*rows[0][:1], "ICE", *rows[0][2:]]]
    file.write_text("".join(json.dumps(row) + "\n" for row in [*rows, *other]))
    assert card.left_out(ground, file) == [card.Run(*one) for one in figures]
    file.write_text("".join(json.dumps(row) + "\n" for row in other))
    assert card.kept_runs(file, "SAND") == {}
