"""The cost as a table: what a planner in another language reads off it."""

from __future__ import annotations

import csv
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from random_models import random_model

from energyplan import EnergyCost, PowerModel
from energyplan.export.table import tabulate, write_cost_table

MODEL = PowerModel.preset("quadriga:full:marble")


def test_the_error_of_the_table_is_as_stated() -> None:
    rng = np.random.default_rng(3)
    for seed in range(6):
        cost = random_model(seed)
        table = tabulate(cost, [0.3, 0.6])
        angle = rng.uniform(-np.pi, np.pi, 3000)
        ds, dtheta = np.cos(angle), np.sin(angle) / cost.half_track
        for speed, column in zip(table.speed, table.energy.T, strict=True):
            exact = replace(cost, speed=speed).segment_energy(ds, dtheta)
            read = np.interp(angle, table.angle, column)
            # between the probes it may be a little more
            assert np.abs(read / exact - 1).max() <= 2 * max(table.error, 1e-6)
    table = tabulate(EnergyCost(MODEL, speed="cheapest"))
    exact = EnergyCost(MODEL, speed="cheapest").segment_energy(1.0, 0.5)
    angle = np.arctan2(0.5 * table.half_track, 1.0)
    read = np.hypot(1.0, 0.5 * table.half_track) * np.interp(angle, table.angle, table.energy[:, 0])
    assert read == pytest.approx(exact, rel=1e-3)


def test_a_program_without_the_library_reads_the_file(tmp_path: Path) -> None:
    cost = EnergyCost(MODEL)
    write_cost_table(tabulate(cost, [0.5]), tmp_path / "cost.csv")
    lines = (tmp_path / "cost.csv").read_text().splitlines()
    half = float(lines[0].split()[-1])
    rows = list(csv.DictReader(lines[2:]))
    angles = [float(row["angle"]) for row in rows]
    energies = [float(row["0.5"]) for row in rows]
    exact = EnergyCost(MODEL, speed=0.5)
    for ds, dtheta in ((1.0, 0.0), (0.0, 1.0), (-0.7, 0.2), (0.3, -2.0)):
        where = math.atan2(half * dtheta, ds)
        read = math.hypot(ds, half * dtheta) * float(np.interp(where, angles, energies))
        assert read == pytest.approx(float(exact.segment_energy(ds, dtheta)), rel=1.1e-3)
