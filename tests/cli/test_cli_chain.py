"""From map to trajectory in one step, and one energy for plan, check, mission and an integral."""

from __future__ import annotations

import shlex
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import networkx as nx
import numpy as np
import pytest
from commands import Run
from limits.fine_integral import fine_energy

import energyplan as ep
from energyplan import PowerModel, simulate, write_model
from energyplan.export.graph import write_route_graph
from energyplan.io.config import write_vehicle
from energyplan.io.files import bundled
from energyplan.io.maps import write_map
from energyplan.io.tables import read_trajectory, write_log
from energyplan.power.effects import term

pytestmark = pytest.mark.usefixtures("little_effort")

SIZE = {
    "slip_friction": 0.6, "traction_resistance": 100.0, "hotel_load": 40.0, "viscous_loss": 30.0,
    "linear_inertia": 83.0, "angular_inertia": 7.0, "regeneration_efficiency": 0.8,
}  # fmt: skip
LAW = PowerModel(
    replace(PowerModel.preset("quadriga:empty:concrete").vehicle, drive_efficiency=0.9),
    tuple(term(name) for name in SIZE), np.array(list(SIZE.values())), name="own",
)  # fmt: skip

Ask = Callable[..., dict]


@pytest.fixture
def ask(run: Run) -> Ask:
    return lambda *arguments: run(*arguments, "--json").json


@pytest.fixture
def hall(tmp_path: Path) -> list[object]:
    """Write a hall of 8 m with a wall in it; return the options of a plan round the wall."""
    from PIL import Image

    free = np.full((80, 80), 254, np.uint8)
    free[30:, 38:42] = 0
    Image.fromarray(free).save(tmp_path / "hall.png")
    text = "image: hall.png\nresolution: 0.1\norigin: [0, 0, 0]\n"
    text += "occupied_thresh: 0.65\nfree_thresh: 0.196\nnegate: 0\n"
    (tmp_path / "hall.yaml").write_text(text)
    write_model(LAW, tmp_path / "own.yaml")
    return [
        "--map", tmp_path / "hall.yaml", "--model", tmp_path / "own.yaml", "--start", "1.5,2,0",
        "--goal", "6.5,2,-90deg", "--effort", 3000,
    ]  # fmt: skip


def test_one_step_from_map_to_trajectory_and_one_energy(
    ask: Ask, hall: list[object], tmp_path: Path
) -> None:
    model = tmp_path / "own.yaml"
    for battery in ([], ["--at-battery"]):
        told = ask("plan", *hall, "--speed", 0.7, "--trajectory", tmp_path / "t.csv",
                   "--out", tmp_path / "p.csv", *battery)  # fmt: skip
        made = read_trajectory(tmp_path / "t.csv")
        assert told["speed"] == pytest.approx(0.7)
        assert told["duration"] == pytest.approx(made.duration)
        assert told["energy_driven"] > told["energy"]
        assert sum(told["breakdown_driven"].values()) == pytest.approx(told["energy_driven"])
        alone = fine_energy(made, LAW.vehicle, SIZE, battery=bool(battery))
        assert told["energy_driven"] == pytest.approx(alone, rel=1e-5)
        checked = ask("check", tmp_path / "t.csv", "--model", model, *battery)
        assert checked["feasible"]
        assert checked["energy"] == pytest.approx(told["energy_driven"], rel=1e-9)
        timed = ask("check", tmp_path / "p.csv", "--model", model, "--speed", 0.7, *battery)
        assert timed["feasible"]
        assert timed["energy"] == pytest.approx(told["energy_driven"], rel=1e-6)


def test_a_mission_leg_takes_what_the_plan_says(
    ask: Ask, hall: list[object], tmp_path: Path
) -> None:
    (tmp_path / "mission.yaml").write_text(
        "name: there\nmodel: own.yaml\nmap: hall.yaml\nsoc: 90 %\nspeed: 0.7 m/s\n"
        "battery: {preset: quadriga}\nconfidence: 50 %\n"
        "start: [1.5, 2.0, 0]\ntasks:\n- {name: far, pose: [6.5, 2.0, -90deg]}\n"
    )
    legs = tmp_path / "legs"
    told = ask("mission", tmp_path / "mission.yaml", "--trajectories", legs)
    total = 0.0
    for leg in sorted(legs.iterdir()):
        made = read_trajectory(leg)
        alone = fine_energy(made, LAW.vehicle, SIZE, battery=True)
        checked = ask("check", leg, "--model", tmp_path / "own.yaml", "--at-battery")
        assert checked["feasible"]
        assert checked["energy"] == pytest.approx(alone, rel=1e-5)
        total += alone
    assert len(list(legs.iterdir())) == 2  # there and back
    assert told["energy"] == pytest.approx(total, rel=1e-3)


def test_the_usual_speed_is_the_default_and_the_cheapest_a_choice(
    ask: Ask, hall: list[object], tmp_path: Path
) -> None:
    fast = ask("plan", *hall)
    assert fast["speed"] == pytest.approx(1.2)
    cheapest = ask("plan", *hall, "--speed", "cheapest")
    assert cheapest["energy"] < fast["energy"]
    # and driven, with its stops
    assert cheapest["energy_driven"] < fast["energy_driven"]
    assert cheapest["speed"] < 1.2
    slow = replace(LAW, vehicle=replace(LAW.vehicle, usual_speed=0.4))
    write_model(slow, tmp_path / "own.yaml")
    assert ask("plan", *hall)["speed"] == pytest.approx(0.4)


def test_a_range_is_priced_at_the_speed_that_plans_are(
    ask: Ask, hall: list[object], tmp_path: Path
) -> None:
    """Of one place, as places differ in how much of the way to them is turning."""
    place, grid = (6.5, 2.0), tmp_path / "energies.asc"
    planned, reached = {}, {}
    for speed in (1.2, 0.4):
        slow = replace(LAW, vehicle=replace(LAW.vehicle, usual_speed=speed))
        write_model(slow, tmp_path / "own.yaml")
        planned[speed] = ask("plan", *hall[:6], "--goal", "6.5,2", "--effort", 3000)["energy"]
        ask("range", *hall[:6], "--out", grid)
        cell = next(float(line.split()[1]) for line in grid.read_text().splitlines()
                    if line.startswith("cellsize"))  # fmt: skip
        energies = np.loadtxt(grid, skiprows=6)[::-1]
        reached[speed] = energies[int(place[1] / cell), int(place[0] / cell)]
    assert reached[0.4] / reached[1.2] == pytest.approx(planned[0.4] / planned[1.2], rel=0.02)
    assert reached == pytest.approx(planned, rel=0.03)


def test_inputs_that_say_nothing_are_refused(
    ask: Ask, run: Run, hall: list[object], tmp_path: Path
) -> None:
    assert "neither metres per second" in run("plan", *hall, "--speed", "fast").err
    ask("plan", *hall, "--trajectory", tmp_path / "t.csv")
    told = run("check", tmp_path / "t.csv", "--model", tmp_path / "own.yaml", "--speed", 1)
    assert told.code == 2 and "is a trajectory" in told.err
    weak = replace(LAW.vehicle, motor=replace(LAW.vehicle.motor, force=50.0))
    write_model(replace(LAW, vehicle=weak), tmp_path / "own.yaml")
    assert ask("plan", *hall)["energy_driven"] is None
    assert "no speed is feasible" in run("plan", *hall, "--trajectory", tmp_path / "none.csv").err
    assert not (tmp_path / "none.csv").exists()
    write_vehicle(LAW.vehicle, tmp_path / "robot.yaml")
    report = ask("check", tmp_path / "t.csv", "--model", tmp_path / "own.yaml",
                 "--vehicle", tmp_path / "robot.yaml")  # fmt: skip
    assert report["feasible"]


def after(said: str) -> list[str]:
    """Return the words of the command that an answer ends with."""
    program, *words = shlex.split(said.splitlines()[-1].removeprefix("next: "))
    assert program == "energyplan"
    return words


def test_an_answer_ends_with_the_command_that_follows(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    model = ep.PowerModel.preset("quadriga:full:concrete")
    write_log(simulate.identification_drive(model, seed=1, power_noise=5.0), tmp_path / "a b.csv")
    begun = ("--track", 0.5, "--wheelbase", 0.475, "--mass", 147, "--out", "my robot.yaml")
    started = run("start", "a b.csv", *begun).out.splitlines()[-1]
    assert started.startswith("written: my robot.yaml; next: energyplan diagnose ")
    assert after(started.partition("; ")[2])[1:4] == ["a b.csv", "--project", "my robot.yaml"]
    diagnose = after(run("identify", "a b.csv", "--vehicle", "quadriga:full").out)
    assert diagnose == shlex.split(
        "diagnose 'a b.csv' --out diagnosed.yaml --vehicle quadriga:full"
    )
    compare = after(run(*diagnose).out)
    office = str(bundled("office.yaml"))
    values = iter((office, "1.2,2,90deg", "3.9,2,90deg"))
    compare = [next(values) if word in ("MAP.yaml", "X,Y,YAW") else word for word in compare]
    plan = after(run(*compare, "--clearance=0.01").out)
    assert plan[:3] == ["plan", "--trajectory", "drive.csv"]
    assert "--clearance=0.01" in plan
    check = after(run(*plan).out)
    assert check == ["check", "drive.csv", "--map", office, "--model", "diagnosed.yaml"]
    assert after(run(*check).out) == ["mission", "MISSION.yaml"]
    assert (tmp_path / "drive.csv").exists()


def test_a_model_is_named_after_the_days_of_its_drives() -> None:
    model = ep.PowerModel.preset("quadriga:full:concrete")
    drives = [simulate.identification_drive(model, seed=k, power_noise=5.0) for k in (1, 2)]
    day = 1_795_867_200.0  # 2026-11-28
    first, second = (
        replace(drive, channels={**drive.channels, "t": drive.t + day + 3 * 86_400.0 * k})
        for k, drive in enumerate(drives)
    )
    robot = model.vehicle
    assert ep.identify(first, robot).model.name == f"{robot.name}, 2026-11-28"
    both = ep.identify([first, second], robot).model.name
    assert both == f"{robot.name}, 2026-11-28 to 2026-12-01"
    assert "2026" not in ep.identify(drives[0], robot).model.name


def test_a_route_along_planned_edges_leads_to_the_nearest_of_several_nodes(
    run: Run, ask: Ask, tmp_path: Path
) -> None:
    """Export graph prints its energy and where it ends; what a route needs is named."""
    hall = ep.OccupancyGrid(np.zeros((160, 200), bool), 0.05)
    write_map(hall, tmp_path / "hall.yaml")
    places = nx.DiGraph([(0, 1), (1, 2)])
    nx.set_node_attributes(places, {0: (2, 2), 1: (8, 2), 2: (8, 6)}, "pos")
    write_route_graph(places, tmp_path / "graph.geojson")
    words = ["export", "graph", tmp_path / "graph.geojson", "--map", tmp_path / "hall.yaml",
             "--model", "quadriga:empty:concrete"]  # fmt: skip
    answer = ask(*words, "--source", 0, "--target", 2, "--target", 1, "--start-yaw", "0")
    assert answer["route"]["energy"] == pytest.approx(6 * 226.0)
    assert answer["route"]["end"] == pytest.approx([8, 2, 0])
    assert answer["route"]["path"] == [[2, 2, 0], pytest.approx([8, 2, 0])]
    back = ("--goal-yaw", "-90deg", "--goal-heading", "either")
    answer = ask(*words, "--source", 0, "--target", 2, *back)
    assert answer["route"]["end"] == pytest.approx([8, 6, np.pi / 2])
    assert "route from 0 to (8.00, 6.00" in run(*words, "--source", 0, "--target", 2).out
    assert ask(*words)["route"] is None
    for given in (["--source", 0], ["--target", 1], ["--goal-yaw", "0"]):
        refused = run(*words, *given)
        assert refused.code == 2 and "give" in refused.err
