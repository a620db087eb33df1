"""Mission files: what they may say, and complaints that name the line."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from test_bad_files import MISSION as GOOD

from energyplan.battery import Battery
from energyplan.errors import MissionError
from energyplan.io.config import write_model
from energyplan.io.files import bundled
from energyplan.io.maps import read_map
from energyplan.io.mission import read_mission
from energyplan.mission import Spreads
from energyplan.power import PowerModel

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"


def written(folder: Path, text: str) -> Path:
    file = folder / "round.yaml"
    file.write_text(text, encoding="utf-8")
    return file


def test_everything_arrives_in_si_units(tmp_path):
    mission = read_mission(written(tmp_path, GOOD))
    assert mission.name == "round"
    assert mission.start == pytest.approx((1.5, 1.5, np.pi / 2))
    look, drop = mission.tasks
    assert (look.dwell, look.power, look.prize, look.required) == (300.0, 100.0, 3.0, True)
    assert look.pose == (11.0, 10.4, 0.0)
    assert (drop.required, drop.window) == (False, (60.0, 3600.0))
    assert (mission.soc, mission.reserve, mission.coefficient_spread) == (0.9, 0.2, 0.05)
    station = mission.chargers[0]
    assert (station.power, station.until, station.pose) == (200.0, 0.9, mission.start)
    assert (mission.order, mission.return_to) == ("free", "charger")
    pack = Battery.preset("quadriga")
    assert mission.battery.health == 0.8
    assert mission.battery.temperature == 10
    assert mission.battery.capacity == pack.capacity
    assert mission.surfaces is not None
    assert mission.model.name == "quadriga:empty:concrete"


def test_numbers_may_come_as_distributions(tmp_path):
    told = (
        ("soc: 90 %", "soc: {mean: 90 %, std: 3 %}\nwaiting: {mean: 20 s, std: 5 s}"),
        ("health: 80 %", "health: {mean: 80 %, std: 4 %}, capacity: {mean: 30 Ah, std: 3 Ah}"),
        ("temperature: 10", "temperature: {low: 4, high: 16}"),
        ("dwell: 5 min", "dwell: {mean: 5 min, std: 30 s}"),
        ("power: 0.1 kW", "power: {low: 90 W, high: 0.11 kW}"),
    )
    text = GOOD
    for old, new in told:
        assert old in text
        text = text.replace(old, new)
    mission = read_mission(written(tmp_path, text + "spreads: {run: 8 %}\n"))
    spreads, usual = mission.spreads, Spreads()
    assert (mission.soc, spreads.soc) == (0.9, pytest.approx(0.03))
    assert (mission.waiting, spreads.waiting) == (20.0, pytest.approx(0.25))
    assert (mission.battery.health, spreads.health) == (0.8, pytest.approx(0.04))
    assert (mission.battery.capacity, spreads.capacity) == (30 * 3600.0, pytest.approx(0.1))
    assert mission.battery.temperature == 10.0
    assert spreads.temperature == pytest.approx(12 / np.sqrt(12))
    assert (spreads.run, spreads.power, spreads.dwell) == (0.08, usual.power, usual.dwell)
    look, drop = mission.tasks
    assert (look.dwell, look.dwell_spread) == (300.0, 30.0)
    assert (look.power, look.power_spread) == (100.0, pytest.approx(20 / np.sqrt(12)))
    assert (drop.dwell, drop.dwell_spread) == (0.0, None)


def test_all_numbers_may_be_exact(tmp_path):
    text = GOOD + "spreads: none\n"
    assert read_mission(written(tmp_path, text)).spreads == Spreads.none()
    exact = read_mission(written(tmp_path, text.replace("soc: 90 %", "soc: {mean: 0.9, std: 0.1}")))
    assert exact.spreads.soc == 0.1


def test_a_pack_of_units_and_a_reserve_in_watt_hours(tmp_path):
    text = GOOD.replace(
        "battery: {preset: quadriga, health: 80 %, temperature: 10}",
        "battery: {chemistry: lithium_ion, series: 10, parallel: 4, unit_capacity: 3.5 Ah, "
        "unit_resistance: 0.02, cutoff_soc: 5 %}",
    ).replace("reserve: 20 %", "reserve: 100 Wh")
    mission = read_mission(written(tmp_path, text))
    pack = mission.battery
    assert pack.capacity == pytest.approx(14 * 3600)
    assert pack.cutoff_soc == 0.05
    grid = np.linspace(0, 1, 1001)
    stored = pack.capacity * np.trapezoid(pack.ocv(grid), grid)
    assert mission.reserve * stored == pytest.approx(360e3, rel=1e-3)


def test_a_tiny_pack_in_words_has_its_unit(tmp_path):
    """Its 72 C were taken for a number that the file gives without a unit."""
    words = GOOD.replace(
        "{preset: quadriga, health: 80 %, temperature: 10}", "24 V 20 mAh lead-acid"
    )
    text = words.replace("reserve: 20 %", "reserve: 0.2")
    assert read_mission(written(tmp_path, text)).battery.capacity == pytest.approx(72.0)


@pytest.mark.parametrize("reserve", ["0.25", "'0.25'", "25 %"])
def test_a_reserve_without_a_unit_is_a_fraction_as_text_too(tmp_path, reserve):
    """On the command line all values are text: ``--reserve 0.25`` was a quarter of a joule."""
    mission = read_mission(written(tmp_path, GOOD.replace("reserve: 20 %", f"reserve: {reserve}")))
    assert mission.reserve == 0.25


def test_payload_models(tmp_path):
    text = GOOD.replace("surfaces: warehouse_surfaces.geojson", "surfaces:") + (
        "payload: 64 kg\npayload_models:\n  quadriga:empty:concrete: {64: quadriga:full:concrete}\n"
    )
    mission = read_mission(written(tmp_path, text))
    heavy = mission.payload_models["quadriga:empty:concrete"][64.0]
    full = PowerModel.preset("quadriga:full:concrete")
    np.testing.assert_array_equal(heavy.coefficients, full.coefficients)


def test_examples_are_read():
    assert len(read_mission(EXAMPLES / "mission_warehouse.yaml").tasks) == 5
    orchard = read_mission(EXAMPLES / "mission_orchard.yaml")
    assert sum(bool(task.path) for task in orchard.tasks) == 7
    assert 0.0 <= orchard.payload + sum(task.change for task in orchard.tasks) < 2.0


def test_what_is_unusual_is_accepted_and_said_with_its_line(tmp_path):
    text = GOOD.replace("dwell: 5 min", "dwell: {mean: 5 s, std: 500 s}")
    for old, new in {
        "power: 0.1 kW": "power: 100 kW", "200 W, until: 90 %": "100 kW, until: 90 %",
        "health: 80 %": "health: 30 %", "temperature: 10": "capacity: 2000 Ah",
        "spread: 0.05": "spread: 60 %", "prize: 3": "payload: 5000",
        "soc: 90 %": "soc: 90 %\nspeed: 20", "reserve: 20 %": "reserve: 80 %",
    }.items():  # fmt: skip
        assert old in text
        text = text.replace(old, new)
    mission = read_mission(written(tmp_path, text))
    expected = [
        "line 27, reserve: 0.8", "line 8, coefficient_spread: 0.6", "line 7, speed: 20",
        "line 5, battery.capacity: 7.2e+06", "line 5, battery.health: 0.3",
        "line 17, tasks.0.power: 100000", "line 24, chargers.0.power: 100000",
        "line 18, tasks.0.payload: 5000",
        "line 16, tasks.0.dwell: a standard deviation of 500",
    ]  # fmt: skip
    told = [note for note in mission.notes if note.startswith("round.yaml, line ")]
    assert [one for one in expected if not any(f"yaml, {one} " in note for note in told)] == []
    assert len(told) == len(expected)
    assert read_mission(written(tmp_path, GOOD)).notes == ()


FETCH = "- {name: fetch, pose: [2.0, 5.0, 90deg], payload: 20}"
LEAVE = "- {name: leave, pose: [2.0, 8.0, 90deg], payload: -20}"
"""Tasks that take a payload on board and leave it."""


HERE = "start: [1.5, 1.5, 90deg]"
ROBOTS = (
    "robots: [{name: a, start: [1.5, 1.5, 90deg]}, "
    "{name: b, start: [3.5, 1.5, 90deg], payload: 5 kg}]"
)


def carrying(*tasks: str, more: tuple[str, ...] = (HERE,)) -> str:
    head = "model: quadriga:empty:concrete", "map: warehouse.yaml", "battery: quadriga"
    return "\n".join((*head, *more, "tasks:", *tasks))


@pytest.mark.parametrize(
    ("text", "line", "most"),
    [
        (carrying(LEAVE, FETCH), 6, "at most 0 kg"),
        (carrying(LEAVE, more=(HERE, "order: free", "payload: 5 kg")), 8, "at most 5 kg"),
        (carrying(FETCH, LEAVE.replace("-20", "-500")), 7, "at most 20 kg"),
        (carrying(LEAVE, more=(ROBOTS,)), 6, "at most 5 kg"),
    ],
    ids=["given", "free", "more than was taken", "robots"],
)
def test_a_task_that_leaves_what_cannot_be_on_board_is_refused(tmp_path, text, line, most):
    said = rf"line {line}, tasks\.\d\.payload: it leaves .*{most}"
    with pytest.raises(MissionError, match=said):
        read_mission(written(tmp_path, text))


def test_a_task_that_leaves_what_a_robot_may_have_on_board_is_read(tmp_path):
    for text in (
        carrying(FETCH, LEAVE),
        carrying(LEAVE, FETCH, more=(HERE, "order: free")),
        carrying(LEAVE, FETCH, more=(HERE, "payload: 20 kg")),
        carrying(LEAVE, more=(ROBOTS.replace("5 kg", "20 kg"),)),
    ):
        read_mission(written(tmp_path, text))


def test_a_person_names_files_in_sibling_folders_and_by_their_whole_path(tmp_path):
    for folder in ("maps", "models", "missions"):
        (tmp_path / folder).mkdir()
    for name in ("warehouse.yaml", "warehouse.png"):
        shutil.copy(bundled("warehouse.yaml").parent / name, tmp_path / "maps" / name)
    write_model(PowerModel.preset("quadriga:empty:concrete"), tmp_path / "models" / "mine.yaml")
    text = GOOD.replace("map: warehouse.yaml", "map: ../maps/warehouse.yaml")
    text = text.replace("surfaces: warehouse_surfaces.geojson\n", "")
    text = text.replace("model: quadriga:empty:concrete", f"model: {tmp_path}/models/mine.yaml")
    file = tmp_path / "missions" / "round.yaml"
    file.write_text(text)
    assert read_mission(file).map.shape == read_map(bundled("warehouse.yaml")).shape


def test_a_model_without_a_suffix_is_a_preset_not_a_file(tmp_path, monkeypatch):
    """A mission must not open files by names that are no file's beside it."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "secret").write_text("kind: model\n")
    file = written(tmp_path, GOOD.replace("model: quadriga:empty:concrete", "model: secret"))
    with pytest.raises(MissionError, match=r"line 2, model: .*'secret'"):
        read_mission(file)
