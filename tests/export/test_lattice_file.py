"""Control sets for Nav2's lattice planner: geometry, penalties, files, and routes over them."""

from __future__ import annotations

import json
from datetime import date

import numpy as np
import pytest
import yaml
from refusals import check_refusal, lines
from worlds import COST

from energyplan import EnergyCost, Path, Pose
from energyplan.export.lattice import (
    control_set,
    headings_of,
    penalties,
    primitive_energy,
    write_lattice,
    write_penalties,
)
from energyplan.export.table import tabulate


@pytest.fixture(scope="module")
def controls():
    return control_set(COST, 0.1)


def test_headings_lead_to_cells():
    angles, cells = headings_of(16)
    assert len(angles) == 16
    assert angles[:5] == pytest.approx(np.arctan2([0, 1, 1, 2, 1], [1, 2, 1, 1, 0]))
    assert cells[:5] == ((1, 0), (2, 1), (1, 1), (1, 2), (0, 1))


@pytest.mark.parametrize("count", [8, 16, 24])
@pytest.mark.parametrize("resolution", [0.05, 0.1])
def test_primitives_end_in_cells_at_headings(count, resolution):
    made = control_set(COST, resolution, headings=count)
    assert [p.start for p in made.primitives] == sorted(p.start for p in made.primitives)
    for p in made.primitives:
        end = Path(Pose(0, 0, made.headings[p.start]), *p.motions.T).end
        assert end[:2] == pytest.approx((p.column * resolution, p.row * resolution), abs=1e-9)
        off = end.yaw - made.headings[p.end]
        assert np.cos(off) == pytest.approx(1.0, abs=1e-12)
        assert p.arc == 0 or p.radius >= made.radius * (1 - 1e-9)
        assert min(p.before, p.after) == 0
    # straight on, turns on the spot either way, and arcs either way from every heading
    for start in range(count):
        own = [p for p in made.primitives if p.start == start]
        assert sum(p.turn == 0 for p in own) == 1
        assert sum(p.length == 0 for p in own) == 2
        assert {np.sign(p.turn) for p in own if p.arc > 0} == {-1.0, 1.0}


def test_penalties_of_a_robot_whose_turns_cost_nothing_are_none():
    free = EnergyCost.from_coefficients(per_metre=200.0, per_radian=1e-9, icr=0.4)
    told = penalties(control_set(free, 0.1), free)
    assert (told.non_straight, told.change, told.reverse) == pytest.approx((1.0, 0.0, 1.0))
    assert told.error < 0.2


def test_penalties_tell_the_energy_and_are_parameters_of_the_planner(controls, tmp_path):
    told = penalties(controls, COST)
    unit = float(COST.segment_energy(1.0, 0.0)) * controls.resolution
    spins = [primitive_energy(COST, p) for p in controls.primitives if p.length == 0]
    assert told.rotation * unit == pytest.approx(np.mean(spins))
    assert told.reverse == pytest.approx(1.0)
    arcs = [p for p in controls.primitives if p.arc > 0]
    true = np.array([primitive_energy(COST, p) for p in arcs])
    length = np.array([p.length for p in arcs]) / controls.resolution * unit
    for other in (0.98, 1.02):
        best = np.sum((told.non_straight * length - true) ** 2)
        assert best <= np.sum((other * told.non_straight * length - true) ** 2)
    write_penalties(told, tmp_path / "nav2.yaml", "lattice.json")
    read = yaml.safe_load((tmp_path / "nav2.yaml").read_text())["GridBased"]
    assert read["rotation_penalty"] == pytest.approx(told.rotation, abs=1e-4)
    assert read["lattice_filepath"] == "lattice.json"


def test_files_hold_the_primitives_as_nav2_reads_them(controls, tmp_path):
    file = tmp_path / "lattice.json"
    write_lattice(controls, file, made=date(2026, 1, 2))
    read = json.loads(file.read_text())
    assert read["date_generated"] == "2026-01-02"
    meta = read["lattice_metadata"]
    assert (meta["motion_model"], meta["num_of_headings"]) == ("diff", 16)
    assert meta["heading_angles"] == pytest.approx(controls.headings)
    assert meta["grid_resolution"] == controls.resolution
    assert meta["number_of_trajectories"] == len(read["primitives"]) == len(controls.primitives)
    for k, (one, p) in enumerate(zip(read["primitives"], controls.primitives, strict=True)):
        keys = ("trajectory_id", "start_angle_index", "end_angle_index", "left_turn")
        assert [one[key] for key in keys] == [k, p.start, p.end, p.turn >= 0]
        whole = one["arc_length"] + one["straight_length"]
        assert one["trajectory_length"] == pytest.approx(whole, abs=3e-5)
        # by the lengths of the file alone, on a circle of the file's radius
        ahead = one["arc_length"] / one["trajectory_radius"] if one["arc_length"] else 0.0
        assert ahead == pytest.approx(abs(p.turn) if p.arc else 0.0, abs=1e-3)
        x, y = p.column * controls.resolution, p.row * controls.resolution
        at = [x, y, meta["heading_angles"][p.end]]
        assert one["poses"][-1] == pytest.approx(at, abs=1e-5)
        steps = np.diff([[0.0, 0.0], *(pose[:2] for pose in one["poses"])], axis=0)
        assert np.hypot(*steps.T).sum() == pytest.approx(whole, rel=0.01, abs=1e-4)


REFUSED = """
InvalidInputError: headings_of(12) | multiple of 8
InvalidInputError: control_set(COST, 0.0) | resolution
InvalidInputError: control_set(COST, 1e-9) | reach beyond 1000 cells
InvalidInputError: control_set(COST, 1e-300) | reach beyond
InvalidInputError: control_set(COST, 0.1, headings=10**6) | up to 512
InvalidInputError: tabulate(COST, []) | speeds
InvalidInputError: tabulate(COST, [0.0]) | speeds
InvalidInputError: tabulate(COST, [-1.0]) | speeds
InvalidInputError: tabulate(COST, [np.nan]) | speeds
InvalidInputError: tabulate(COST, tolerance=0.0) | tolerance
"""


@pytest.mark.parametrize("case", lines(REFUSED))
def test_bad_input_is_refused(case):
    check_refusal(case, {"tabulate": tabulate, **globals()})
