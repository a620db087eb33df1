"""Open-RMF's battery estimate in closed form, its file, and its task requests."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from energyplan import cli
from energyplan.battery import Battery
from energyplan.errors import InvalidInputError, MissionError
from energyplan.io.fleet import read_mission_for
from energyplan.openrmf import (
    fleet_config,
    power_error,
    read_requests,
    sink_energy,
    tasks_of,
)
from energyplan.path import Trajectory
from energyplan.power import HOTEL, PowerModel
from energyplan.terrain import OccupancyGrid

MODEL = PowerModel.preset("quadriga:empty:marble")
BATTERY = Battery.preset("quadriga")
CONFIG = fleet_config(MODEL, BATTERY, charging_current=10.0)


def drive(duration: float, v: float, omega: float) -> Trajectory:
    """At constant velocities, which is where Open-RMF's sum is known."""
    t = np.linspace(0.0, duration, 201)
    still = np.zeros(len(t))
    return Trajectory(t, v * t, still, omega * t, still + v, still + omega)


def test_driving_straight_is_counted_right_and_a_spin_not_at_all() -> None:
    """Its sum has a sample at both ends: one step of half a second more than the time."""
    straight, spin = drive(60.0, 0.5, 0.0), drive(60.0, 0.0, 0.5)
    counted = sink_energy(CONFIG, straight)
    force = float(2 * MODEL.battery_side().coefficients[1])
    assert counted["friction"] == pytest.approx(force * 0.5 * 60.5, rel=1e-9)
    assert counted["acceleration"] == pytest.approx(0.0, abs=1e-9)
    assert sum(sink_energy(CONFIG, spin).values()) == pytest.approx(0.0, abs=1e-9)


def test_changes_of_speed_are_counted_up_and_down() -> None:
    t = np.linspace(0.0, 40.0, 4001)
    v = np.minimum(t, 40.0 - t) / 20.0
    still = np.zeros(len(t))
    told = sink_energy(CONFIG, Trajectory(t, np.cumsum(v) * 0.01, still, still, v, still))
    # half m v^2 to 1 m/s and back, by a sum in steps of 0.5 s
    assert told["acceleration"] == pytest.approx(CONFIG.mass, rel=0.03)


def test_the_file_holds_what_the_model_and_battery_say() -> None:
    config = fleet_config(MODEL.with_term(HOTEL, 40.0), BATTERY, charging_current=10.0)
    assert config.ambient_power == pytest.approx(40.0)
    assert config.friction_coefficient == pytest.approx(CONFIG.friction_coefficient)
    assert config.mass == pytest.approx(MODEL.vehicle.mass)
    weight = MODEL.vehicle.mass * 9.81
    assert config.friction_coefficient == pytest.approx(2 * MODEL.coefficients[1] / weight)
    told = yaml.safe_load(yaml.safe_dump(config.document()))["rmf_fleet"]
    assert told["mechanical_system"]["friction_coefficient"] == config.friction_coefficient
    assert told["battery_system"]["charging_current"] == 10.0
    stored = told["battery_system"]["capacity"] * told["battery_system"]["voltage"] * 3600
    # at the power of driving, what Open-RMF thinks is in the battery is what the battery gives
    power = 40.0 + 2 * MODEL.coefficients[1] * config.linear[0]
    assert stored == pytest.approx(float(BATTERY.usable_energy(power, 1.0)), rel=1e-6)
    cold = fleet_config(MODEL, replace(BATTERY, health=0.5), charging_current=10.0)
    assert cold.capacity == pytest.approx(0.5 * CONFIG.capacity, rel=0.1)


def test_what_nothing_tells_or_open_rmf_does_not_take_is_refused() -> None:
    with pytest.raises(InvalidInputError, match=r"the charging current of .* is not known"):
        fleet_config(MODEL, replace(BATTERY, max_charge_current=np.inf))
    with pytest.raises(InvalidInputError, match="friction_coefficient is -1; Open-RMF takes"):
        fleet_config(MODEL, BATTERY, charging_current=1.0, friction_coefficient=-1.0)
    grid = OccupancyGrid(np.ones((30, 30), bool), 0.1)
    with pytest.raises(InvalidInputError, match="0 of 5 places"):
        power_error(CONFIG, MODEL, BATTERY, grid, routes=4)


def test_the_error_is_that_of_turning_where_nothing_else_differs() -> None:
    """Without mass to accelerate, what is missing is what turning takes, on a turned map too."""
    friction = CONFIG.friction_coefficient * CONFIG.mass / 1e-9
    light = replace(CONFIG, mass=1e-9, moment_of_inertia=1e-9, friction_coefficient=friction)
    cells = np.zeros((100, 120), bool)
    for origin in ((0.0, 0.0, 0.0), (3.0, -2.0, 0.7)):
        grid = OccupancyGrid(cells, 0.1, origin)
        error = power_error(light, MODEL, BATTERY, grid, routes=8, effort=1000)
        assert error.routes == 8
        assert error.turning > 0.02
        assert error.bias == pytest.approx(-error.turning, abs=0.02)
        assert max(error.errors) < 0.06  # half a second more or less of driving
        assert error.fitted_friction > light.friction_coefficient
        assert abs(error.worst) >= error.rms


# -- task requests -------------------------------------------------------------------------------

PLACES: dict[str, Any] = {"pantry": [1.0, 2.0, 0.0], "lounge": "3,4,90deg", "hub": "lounge"}


def envelope(category: str, description: Any, start: float = 0) -> dict[str, Any]:
    request = {"category": category, "description": description}
    if start:
        request["unix_millis_earliest_start_time"] = start
    return {"type": "dispatch_task_request", "request": request}


def told(*requests: dict[str, Any], folder: Path) -> list[dict[str, Any]]:
    file = folder / "tasks.json"
    file.write_text(json.dumps(list(requests)))
    return tasks_of(read_requests(file), PLACES)


def test_requests_become_tasks_in_their_order(tmp_path: Path) -> None:
    action = {"category": "perform_action",
              "description": {"unix_millis_action_duration_estimate": 60000, "category": "scan",
                              "description": {}}}  # fmt: skip
    go = {"category": "go_to_place", "description": {"waypoint": "lounge", "orientation": 1.5}}
    back = {"category": "go_to_place", "description": {"one_of": [{"waypoint": "pantry"}]}}
    sequence = {"category": "sequence", "description": {"activities": [go, action, action, back]}}
    tasks = told(
        envelope("patrol", {"places": ["pantry", "lounge"], "rounds": 2}, 1000_000),
        envelope("delivery", {"pickup": {"place": "pantry", "handler": "a"},
                              "dropoff": {"place": "hub", "handler": "b"}}, 1060_000),
        envelope("compose", {"category": "x", "phases": [{"activity": sequence}]}),
        folder=tmp_path,
    )  # fmt: skip
    pantry, lounge = [1.0, 2.0, 0.0], "3,4,90deg"
    assert [task["pose"] for task in tasks] == [
        pantry, lounge, pantry, lounge, pantry, lounge, ["3", "4", 1.5], pantry,
    ]  # fmt: skip
    assert [task["dwell"] for task in tasks] == [0, 0, 0, 0, 0, 0, 120.0, 0]
    assert [task["window"][0] for task in tasks] == [0, 0, 0, 0, 60.0, 60.0, 0, 0]
    assert len({task["name"] for task in tasks}) == 8


@pytest.mark.parametrize(
    ("request_", "message"),
    [
        (envelope("clean", {"zone": "a"}), "category 'clean', which names no places"),
        (envelope("patrol", {"places": ["attic"]}), "no place 'attic'; the mission's places are"),
        (envelope("patrol", {"places": []}), "places is '\\[\\]'; give a list"),
        (envelope("patrol", {"places": ["pantry"], "rounds": 0}), "rounds is 0"),
        (envelope("patrol", ["pantry"]), "is no mapping"),
        (envelope("patrol", {"places": ["pantry"]}, -5), "the earliest start is -5"),
        (envelope("go_to_place", {"one_of": [{"waypoint": "pantry"}, {"waypoint": "hub"}]}),
         "leaves open which of 2 places"),
        (envelope("compose", {"phases": [{"activity": {
            "category": "perform_action", "description": {}}}]}), "begins with an action"),
        ({"type": "cancel_task_request"}, "request 1 has no category"),
    ],
)  # fmt: skip
def test_requests_that_cannot_be_read_are_refused(
    request_: dict[str, Any], message: str, tmp_path: Path
) -> None:
    with pytest.raises(MissionError, match=message):
        told(request_, folder=tmp_path)


def test_a_request_a_line_and_what_is_no_json(tmp_path: Path) -> None:
    file = tmp_path / "tasks.jsonl"
    one = json.dumps(envelope("patrol", {"places": ["pantry"]}))
    file.write_text(f"{one}\n{one}\n")
    assert len(read_requests(file)) == 2
    file.write_text("{")
    with pytest.raises(MissionError, match="is no JSON"):
        read_requests(file)
    file.write_text("[]")
    with pytest.raises(MissionError, match="holds no request"):
        read_requests(file)
    with pytest.raises(MissionError, match="cannot be read"):
        read_requests(tmp_path / "none.json")


ROOT = Path(__file__).resolve().parents[2]


def test_a_mission_is_evaluated_for_requests(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "tasks.json"
    file.write_text(json.dumps(envelope("patrol", {"places": ["gate", "dock"]})))
    mission = ROOT / "examples" / "mission_warehouse.yaml"
    asked = read_mission_for(mission, lambda places: tasks_of(read_requests(file), places))
    assert [task.pose.x for task in asked.tasks] == [11.0, 1.5]
    words = ["energyplan", "mission", str(mission), "--requests", str(file), "--json"]
    monkeypatch.setattr("sys.argv", [*words, "--effort", "2000"])
    with pytest.raises(SystemExit) as left:
        cli.main()
    assert not left.value.code
    names = [task["name"] for task in json.loads(capsys.readouterr().out)["tasks"]]
    assert names == ["1.1 patrol gate", "1.2 patrol dock"]


def test_the_command_writes_the_file_and_tells_the_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "config.yaml"
    words = ["energyplan", "rmf", "--model", "quadriga:empty:marble", "--battery", "quadriga"]
    words += ["--charging-current", "10", "--json"]
    extra = ["--map", str(ROOT / "maps" / "office.yaml"), "--routes", "4", "--fit"]
    monkeypatch.setattr("sys.argv", [*words, *extra, "--out", str(out)])
    with pytest.raises(SystemExit) as left:
        cli.main()
    assert not left.value.code
    answer = json.loads(capsys.readouterr().out)
    written = yaml.safe_load(out.read_text())
    assert written["rmf_fleet"] == answer["rmf_fleet"]
    friction = written["rmf_fleet"]["mechanical_system"]["friction_coefficient"]
    assert friction == pytest.approx(answer["error"]["fitted_friction"])
    monkeypatch.setattr("sys.argv", [*words, "--fit"])
    with pytest.raises(SystemExit) as left:
        cli.main()
    assert left.value.code == 2
