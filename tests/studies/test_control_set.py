"""Control sets for Nav2's lattice planner: geometry, penalties, files, and routes over them."""

from __future__ import annotations

import json
from datetime import date

import numpy as np
import pytest
import yaml

from energyplan import EnergyCost, Path, Pose, PowerModel
from energyplan.errors import InvalidInputError, MapError
from energyplan.io.nav2 import read_lattice, write_lattice, write_penalties
from energyplan.studies.control_set import (
    control_set,
    headings_of,
    penalties,
    primitive_energy,
)

COST = EnergyCost(PowerModel.preset("quadriga:empty:concrete"))


@pytest.fixture(scope="module")
def controls():
    return control_set(COST, 0.1)


def test_headings_lead_to_cells():
    angles, cells = headings_of(16)
    assert len(angles) == 16
    assert angles[:5] == pytest.approx(np.arctan2([0, 1, 1, 2, 1], [1, 2, 1, 1, 0]))
    assert cells[:5] == ((1, 0), (2, 1), (1, 1), (1, 2), (0, 1))
    with pytest.raises(InvalidInputError, match="multiple of 8"):
        headings_of(12)


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


def test_penalties_tell_the_energy(controls):
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


def test_files_are_read_as_they_were_written(controls, tmp_path):
    file = tmp_path / "lattice.json"
    write_lattice(controls, file, made=date(2026, 1, 2))
    again = read_lattice(file)
    assert again.headings == controls.headings
    assert (again.resolution, again.radius) == (controls.resolution, controls.radius)
    for one, other in zip(again.primitives, controls.primitives, strict=True):
        assert one == pytest.approx(other, abs=2e-5)
    write_lattice(again, tmp_path / "again.json", made=date(2026, 1, 2))
    once, twice = (json.loads((tmp_path / n).read_text()) for n in ("lattice.json", "again.json"))
    assert once["lattice_metadata"] == twice["lattice_metadata"]
    for one, other in zip(once["primitives"], twice["primitives"], strict=True):
        assert np.allclose(one["poses"], other["poses"], atol=3e-5)
    assert once["date_generated"] == "2026-01-02"
    told = penalties(controls, COST)
    write_penalties(told, tmp_path / "nav2.yaml", "lattice.json")
    read = yaml.safe_load((tmp_path / "nav2.yaml").read_text())["GridBased"]
    assert read["rotation_penalty"] == pytest.approx(told.rotation, abs=1e-4)
    assert read["lattice_filepath"] == "lattice.json"


def sample(**changes) -> dict:
    """Return a file with an arc of 0.5 m and straight pieces, by hand."""
    turn = np.arctan2(1, 2)
    tangent = 0.5 * np.tan(turn / 2)
    # 3 cells on and 1 up: the tangents meet where the second heading's line does
    ahead = 0.35 - 0.1 / np.tan(turn)
    slant = 0.1 / np.sin(turn)
    near = min(ahead, slant)
    arc = near / np.tan(turn / 2) * turn
    primitive = {
        "trajectory_id": 0, "start_angle_index": 0, "end_angle_index": 1, "left_turn": True,
        "trajectory_radius": near / np.tan(turn / 2), "arc_length": arc,
        "straight_length": ahead + slant - 2 * near,
        "trajectory_length": arc + ahead + slant - 2 * near,
        "poses": [[0.1, 0.01, 0.2], [0.35, 0.1, turn]],
    }  # fmt: skip
    assert tangent > 0
    spin = {
        "trajectory_id": 1, "start_angle_index": 0, "end_angle_index": 1, "left_turn": True,
        "trajectory_radius": 0.0, "arc_length": 0.0, "straight_length": 0.0,
        "trajectory_length": 0.0, "poses": [[0.0, 0.0, 0.0], [0.0, 0.0, turn]],
    }  # fmt: skip
    metadata = {
        "motion_model": "diff", "turning_radius": 0.4, "grid_resolution": 0.05,
        "stopping_threshold": 5, "num_of_headings": 16,
        "heading_angles": headings_of(16)[0].tolist(), "number_of_trajectories": 2,
    }  # fmt: skip
    for key, value in changes.items():
        (metadata if key in metadata else primitive)[key] = value
    return {"version": 1.0, "lattice_metadata": metadata, "primitives": [primitive, spin]}


def test_files_of_others_are_read(tmp_path):
    (tmp_path / "l.json").write_text(json.dumps(sample()))
    arc, spin = read_lattice(tmp_path / "l.json").primitives
    assert (arc.column, arc.row, arc.start, arc.end) == (7, 2, 0, 1)
    assert min(arc.before, arc.after) == 0
    end = Path(Pose(0, 0, 0), *arc.motions.T).end
    assert end[:2] == pytest.approx((0.35, 0.1), abs=1e-9)
    assert spin.length == 0


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"heading_angles": [0.0, 1.0]}, "2 angles where"),
        ({"number_of_trajectories": 7}, "there are 2 primitives"),
        ({"end_angle_index": 16}, "primitives.0: a heading beyond the 16"),
        ({"poses": [[0.36, 0.11, 0.4]]}, "middle of no cell"),
        ({"poses": [[0.35, 0.15, 0.4]]}, "sideways motion is not taken"),
        ({"arc_length": -1.0}, "primitives.0.arc_length"),
        ({"poses": []}, "primitives.0.poses"),
        ({"grid_resolution": float("nan")}, "grid_resolution"),
        ({"motion_model": "omni"}, "motion_model: primitives of an omnidirectional robot"),
    ],
)
def test_malformed_files_are_told(changes, told, tmp_path):
    (tmp_path / "l.json").write_text(json.dumps(sample(**changes)))
    with pytest.raises(MapError, match=told):
        read_lattice(tmp_path / "l.json")


@pytest.mark.parametrize("content", [b"", b"{", b"[1]", b"\xff\xfe", b"{}"])
def test_what_is_no_lattice_is_told(content, tmp_path):
    (tmp_path / "l.json").write_bytes(content)
    with pytest.raises(MapError, match=r"l\.json"):
        read_lattice(tmp_path / "l.json")


@pytest.mark.parametrize(
    ("resolution", "headings", "told"),
    [
        (1e-9, 16, "reach beyond 1000 cells"),
        (1e-300, 16, "reach beyond"),
        (0.1, 10**6, "up to 512"),
    ],
)
def test_a_lattice_of_more_primitives_than_anyone_needs_is_refused(resolution, headings, told):
    with pytest.raises(InvalidInputError, match=told):
        control_set(COST, resolution, headings=headings)


def test_cells_too_large_for_arcs_are_refused():
    with pytest.raises(InvalidInputError, match="resolution"):
        control_set(COST, 0.0)
