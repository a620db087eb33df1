"""Wherever a saving is shown, it is what the two energies beside it give.

The robot draws power at rest, so that driving with stops takes more than the steady speeds do.
"""

from __future__ import annotations

import html
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import energyplan as ep
from energyplan.io.files import bundled
from energyplan.output.pages import comparison_pictures
from energyplan.power import HOTEL

PAPER = ep.PowerModel.preset("quadriga:full:concrete")
MODEL = PAPER.with_term(HOTEL, 40.0)
EFFORT = 5_000


def saving(least: str, most: str) -> float:
    """Return the saving that two printed energies give [%]."""
    return 100 * (1 - float(least) / float(most))


def test_the_command_its_report_and_its_json_say_one_saving(
    tmp_path: Path, run: Callable[..., Any]
) -> None:
    ep.write_model(MODEL, tmp_path / "model.yaml")
    words = ["compare", "--map", bundled("warehouse.yaml"), "--model", tmp_path / "model.yaml",
             "--start", "2,2,0", "--goal", "20,12,90deg", "--effort", EFFORT]  # fmt: skip
    page = tmp_path / "page.html"
    text = run(*words, "--report", page).out
    answer = run(*words, "--json").json
    best, shortest = (answer[name] for name in ("energy_optimal", "shortest"))
    kind = answer["saving_of"]
    assert kind == "energy_driven"
    assert answer["saving"] == pytest.approx(1 - best[kind] / shortest[kind], rel=1e-9)
    # driving is another energy than that at steady speeds, by more than what is compared below
    steady = 1 - best["energy"] / shortest["energy"]
    assert abs(answer["saving"] - steady) > 0.002
    said = 100 * answer["saving"]

    found = re.search(r"saving: (\S+) %.*\n.*\n\s+energy as driven.*?\[J\]\s+(\S+)\s+(\S+)", text)
    assert found is not None, text
    assert float(found[1]) == pytest.approx(said, abs=0.05)
    assert saving(found[2], found[3]) == pytest.approx(said, abs=0.1)

    shown = html.unescape(re.sub(r"<[^>]+>", "|", page.read_text()))
    lead = re.search(r"takes (\S+) J, the shortest one (\S+) J. That saves (\S+) %", shown)
    assert lead is not None
    assert float(lead[3]) == pytest.approx(said, abs=0.05)
    assert saving(lead[1], lead[2]) == pytest.approx(said, abs=0.1)
    row = re.search(r"energy as driven, with its stops \[J\]\|+([\d.]+)\|+([\d.]+)", shown)
    assert row is not None
    assert (row[1], row[2]) == (lead[1], lead[2]) == (found[2], found[3])


def test_pictures_say_the_energies_that_the_saving_compares() -> None:
    grid = ep.read_map(bundled("warehouse.yaml"))
    problem = ep.PlanningProblem(grid, ep.EnergyCost(MODEL), (2, 2, 0), (20, 12, 1.57))
    found = ep.compare(problem, effort=EFFORT)
    pictures = {one.name: one.figure.axes[0] for one in comparison_pictures(found, problem)}
    legend = pictures["map"].get_legend()
    assert legend is not None
    energies = [re.search(r": (\d+) J", text.get_text()) for text in legend.get_texts()]
    least, most = (one[1] for one in energies if one is not None)
    assert saving(least, most) == pytest.approx(100 * found.saving, abs=0.05)
    steady = 1 - found.energy_optimal.energy / found.shortest.energy
    assert abs(found.saving - steady) > 0.002
    ends = [float(line.get_ydata()[-1]) for line in pictures["energy"].get_lines()]
    assert ends == pytest.approx([one.energy for one in found.spent], rel=1e-9)
    bars = pictures["terms"].patches
    assert 1e3 * sum(bar.get_width() for bar in bars) == pytest.approx(sum(ends), rel=1e-9)
    assert sum(found.by_term.values()) == pytest.approx(found.saving * ends[1], rel=1e-9)
