"""Mission files: what they may say, and complaints that name the line."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import numpy as np
import pytest

from energyplan.battery import Battery
from energyplan.errors import EnergyPlanError, MissionError
from energyplan.io.config import read_model, read_vehicle, write_model
from energyplan.io.files import bundled
from energyplan.io.logs import read_log
from energyplan.io.maps import read_map
from energyplan.io.mission import read_mission
from energyplan.mission import Spreads
from energyplan.power import PowerModel

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"

GOOD = """\
name: round
model: quadriga:empty:concrete
map: warehouse.yaml
surfaces: warehouse_surfaces.geojson
battery: {preset: quadriga, health: 80 %, temperature: 10}
soc: 90 %
coefficient_spread: 0.05
start: dock
places:
  dock: [1.5, 1.5, 90deg]
  gate: "11.0,10.4,0"
tasks:
  - name: look
    pose: gate
    dwell: 5 min
    power: 0.1 kW
    prize: 3
  - name: drop
    pose: [2.5, 8.0, 1.5]
    required: false
    window: [1 min, 1 h]
chargers:
  - {name: station, pose: dock, power: 200 W, until: 90 %}
order: free
return_to: charger
reserve: 20 %
"""


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


@pytest.mark.parametrize("name", ["warehouse", "orchard"])
def test_examples_are_read(name):
    mission = read_mission(EXAMPLES / f"mission_{name}.yaml")
    assert len(mission.tasks) == 5


@pytest.mark.parametrize(
    ("old", "new", "line", "message"),
    [
        ("pose: gate", "pose: [0.05, 8.0, 0]", 14, "touches an obstacle"),
        ("pose: gate", "pose: [99, 8.0, 0]", 14, "outside the map"),
        ("pose: gate", "pose: garage", 14, "there is no place 'garage'; the places are dock, gate"),
        ("pose: gate", "pose: [1, 2]", 14, "the pose is [1, 2]; give x, y"),
        ("pose: gate", "pose: [.nan, 2, 0]", 14, "finite"),
        ("name: drop", "name: look", 18, "stands twice"),
        ("dwell: 5 min", "dwell: 5 hours", 15, "unit of a time"),
        ("dwell: 5 min", "dwell: -3", 15, "dwell: give 0 to 1e+08 s, not '-3'"),
        ("power: 0.1 kW", "power: .nan", 16, "power"),
        ("power: 0.1 kW", "watts: 3", 16, "no such key"),
        ("model: quadriga:empty:concrete", "model: quadriga:empty:ice", 2, "unknown model preset"),
        ("map: warehouse.yaml", "map: castle.yaml", 3, "castle.yaml"),
        (
            "temperature: 10",
            "capacity: -5 Ah",
            5,
            "battery.capacity: give 0.001 to 3.6e+08 C, not '-5 Ah'",
        ),
        ("temperature: 10", "capacity: 200", 5, "200 has no unit, and would be C; write 200 Ah"),
        ("temperature: 10", "capacity: '200'", 5, "200 has no unit"),
        (
            "reserve: 20 %",
            "reserve: '20'",
            26,
            "reserve: give 0 to 0.99 (write a percentage with its sign",
        ),
        ("temperature: 10", "usable: [1]", 5, "battery: usable is no fraction"),
        ("temperature: 10", "notes: 5", 5, "battery.notes"),
        ("\nplaces:", "\nplaces: 0\nothers:", 9, "places: Input should be a valid dictionary"),
        ("temperature: 10", "helth: 80 %", 5, "battery.helth: there is no such key"),
        ("temperature: 10", "temperature: cold", 5, "battery.temperature: give a number"),
        ("preset: quadriga", "chemistry: agm, series: 2", 5, "the pack lacks parallel, unit_cap"),
        ("preset: quadriga", "preset: nuclear", 5, "unknown battery 'nuclear'"),
        ("soc: 90 %", "soc: 190 %", 6, "soc: give 0 to 1 (write a percentage with its sign"),
        ("reserve: 20 %", "reserve: 5 kWh", 26, "above the battery's capacity"),
        ("reserve: 20 %", "reserve: 95 %", 26, "not below the state of charge"),
        ("order: free", "order: random", 24, "'given' or 'free'"),
        ("until: 90 %", "until: 10 %", 23, "not above the reserve"),
        ("power: 200 W", "power: 0", 23, "power: give 0.1 to 1e+06 W, not '0'"),
        ("dwell: 5 min", "dwell: {mean: 5 min}", 15, "mean and std, or low and high"),
        ("dwell: 5 min", "dwell: {mean: 5 min, std: -1}", 15, "negative spread"),
        ("dwell: 5 min", "dwell: {low: 5 min, high: 4 min}", 15, "negative spread"),
        ("dwell: 5 min", "dwell: {mean: .nan, std: 1}", 15, "no mean"),
        ("dwell: 5 min", "dwell: [5, 6]", 15, "give a number"),
        ("soc: 90 %", "waiting: {mean: 0, std: 3 s}", 6, "has no spread"),
        (
            "soc: 90 %",
            "spreads: {soc: -1 %}",
            6,
            "spreads.soc: give 0 to 1",
        ),
        ("soc: 90 %", "spreads: {smell: 1 %}", 6, "no such key"),
        ("temperature: 10", "temperature: 300", 5, "give -40 to 70 degC (not kelvin)"),
        ("temperature: 10", "temperature: -100", 5, "give -40 to 70 degC, not '-100'"),
        ("temperature: 10", "capacity: 1e12 Ah", 5, "battery.capacity: give 0.001 to 3.6e+08 C"),
        ("spread: 0.05", "spread: 5", 7, "coefficient_spread: give 0 to 1 (write a percentage"),
        ("power: 0.1 kW", "power: 1e9", 16, "power: give 0 to 1e+06 W, not '1e9'"),
        ("power: 200 W", "power: 1e9 W", 23, "power: give 0.1 to 1e+06 W, not '1e9 W'"),
        ("soc: 90 %", "speed: 1000", 6, "speed: give 0.001 to 50 m/s"),
        ("soc: 90 %", "planning_effort: 1.0e+15", 6, "planning_effort: give 1 to 1e+09 units"),
        ('gate: "11.0,10.4,0"', "gate: [null, 8.0, 90deg]", 11, "is not X,Y,YAW"),
        ('gate: "11.0,10.4,0"', "gate: [[1], 8.0, 90deg]", 11, "is not X,Y,YAW"),
        ('gate: "11.0,10.4,0"', f"gate: [{'9' * 400}, 8.0, 90deg]", 11, "is not X,Y,YAW"),
        ("dwell: 5 min", f"dwell: {{mean: {'9' * 400}, std: 1}}", 15, "give a number"),
        ("temperature: 10", f"soc_points: [0, {'9' * 400}]", 5, "give a list of finite numbers"),
    ],
)
def test_complaints_name_the_line(tmp_path, old, new, line, message):
    assert old in GOOD
    with pytest.raises(MissionError) as caught:
        read_mission(written(tmp_path, GOOD.replace(old, new, 1)))
    assert f"round.yaml, line {line}" in str(caught.value)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_what_is_unusual_is_accepted_and_said_with_its_line(tmp_path):
    text = GOOD.replace("dwell: 5 min", "dwell: {mean: 5 s, std: 500 s}")
    for old, new in {
        "power: 0.1 kW": "power: 100 kW", "200 W, until: 90 %": "100 kW, until: 90 %",
        "health: 80 %": "health: 30 %", "temperature: 10": "capacity: 2000 Ah",
        "spread: 0.05": "spread: 60 %", "prize: 3": "payload: -500",
        "soc: 90 %": "soc: 90 %\nspeed: 20", "reserve: 20 %": "reserve: 80 %",
    }.items():  # fmt: skip
        assert old in text
        text = text.replace(old, new)
    mission = read_mission(written(tmp_path, text))
    expected = [
        "line 27, reserve: 0.8", "line 8, coefficient_spread: 0.6", "line 7, speed: 20",
        "line 5, battery.capacity: 7.2e+06", "line 5, battery.health: 0.3",
        "line 17, tasks.0.power: 100000", "line 24, chargers.0.power: 100000",
        "line 18, tasks.0.payload: it leaves 500",
        "line 16, tasks.0.dwell: a standard deviation of 500",
    ]  # fmt: skip
    told = [note for note in mission.notes if note.startswith("round.yaml, line ")]
    assert [one for one in expected if not any(f"yaml, {one} " in note for note in told)] == []
    assert len(told) == len(expected)
    assert read_mission(written(tmp_path, GOOD)).notes == ()


def test_an_empty_task_list_is_named(tmp_path):
    head, _, tail = GOOD.partition("tasks:\n")
    text = head + "tasks: []\n" + tail[tail.index("chargers:") :]
    with pytest.raises(MissionError, match="line 12, tasks"):
        read_mission(written(tmp_path, text))


def test_an_unknown_surface_is_named(tmp_path):
    (tmp_path / "ground.geojson").write_text(
        '{"type": "FeatureCollection", "features": [{"type": "Feature", "properties": '
        '{"model": "moon"}, "geometry": {"type": "Polygon", "coordinates": '
        "[[[0, 0], [1, 0], [1, 1], [0, 0]]]}}]}",
        encoding="utf-8",
    )
    text = GOOD.replace("warehouse_surfaces.geojson", "ground.geojson")
    with pytest.raises(MissionError, match=r"round\.yaml, line 4, surfaces: .*moon"):
        read_mission(written(tmp_path, text))


def test_payload_models_of_a_model_that_is_not_there(tmp_path):
    text = GOOD + "payload_models:\n  quadriga:empty:mud: {64: quadriga:full:concrete}\n"
    with pytest.raises(MissionError, match="line 28, payload_models"):
        read_mission(written(tmp_path, text))


@pytest.mark.parametrize("key", ["map", "surfaces", "heights", "model", "vehicle"])
@pytest.mark.parametrize("name", ["../other.yaml", "/etc/other.yaml", "a/../../other.yml"])
def test_files_outside_the_mission_s_folder_are_refused_for_a_service(tmp_path, key, name):
    text = (EXAMPLES / "mission_warehouse.yaml").read_text()
    changed = re.sub(rf"^{key}: .*\n", "", text, flags=re.MULTILINE) + f"\n{key}: {name}\n"
    file = tmp_path / "mission.yaml"
    file.write_text(changed)
    with pytest.raises(MissionError, match=rf"mission\.yaml, line \d+, {key}: .*leaves the file's"):
        read_mission(file, inside=True)


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
    text = (EXAMPLES / "mission_warehouse.yaml").read_text()
    file = tmp_path / "mission.yaml"
    file.write_text(re.sub(r"^model: .*$", "model: secret", text, flags=re.MULTILINE))
    with pytest.raises(MissionError, match=r"line \d+, model: .*'secret'"):
        read_mission(file)


@pytest.mark.parametrize("name", ["x" * 5000, "é" * 200 + ".yaml", "a\0b", "x" * 300 + ".bag"])
def test_names_that_no_file_can_bear_are_refused_by_name(name):
    for read in (read_mission, read_vehicle, read_model, read_log):
        with pytest.raises(EnergyPlanError):
            read(name)
