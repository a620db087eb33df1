"""Command line: keys, exit codes, one-line errors, nothing but JSON on stdout."""

from __future__ import annotations

import hashlib
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from commands import Run
from PIL import Image

import energyplan as ep
from energyplan import PowerModel, Trajectory
from energyplan.html import number
from energyplan.io.bags import opened_bag
from energyplan.io.config import write_model
from energyplan.io.files import bundled
from energyplan.io.maps import write_map
from energyplan.io.tables import read_trajectory, write_path, write_trajectory
from energyplan.power.effects import term

CONCRETE = "quadriga:empty:concrete"
OFFICE = ("--map", bundled("office.yaml"), "--model", CONCRETE, "--start", "1.2,2,90deg")
pytestmark = pytest.mark.usefixtures("little_effort")


def test_compare_reports_both_routes(run: Run, tmp_path: Path) -> None:
    report = tmp_path / "routes.html"
    told = run("compare", *OFFICE, "--goal", "3.9,2,90deg", "--report", report, "--json").json
    page = report.read_text()
    assert page.startswith("<!doctype html>")
    body = page[page.index("<body>") :]
    assert f"{100 * told['saving']:.1f} % of the shortest route" in body
    for key in ("energy_optimal", "shortest"):
        assert told[key]["effort_limit"] == 5000  # of `little_effort`: no clock, but work
        assert f">{number(told[key]['length'])}</td>" in body
    assert body.count("<figure>") == 3
    end = body[body.index("<footer>") :]
    assert f"energyplan compare --map {bundled('office.yaml')} --model {CONCRETE}" in end
    for name in ("office.yaml", "office.png"):
        assert hashlib.sha256(bundled(name).read_bytes()).hexdigest() in end


def arc(speed: float) -> Trajectory:
    t = np.linspace(0, 4, 81)
    rate = speed * 1.5
    yaw = rate * t
    return Trajectory(
        t, np.sin(yaw) / 1.5, (1 - np.cos(yaw)) / 1.5, yaw, 0 * t + speed, 0 * t + rate
    )


def test_check_answers_no_and_strict_says_so(run: Run, tmp_path: Path) -> None:
    file = write_trajectory(arc(1.1), tmp_path / "fast.csv")
    result = run("check", file, "--model", "quadriga:full:marble", "--json")
    assert result.code == 0
    assert result.json["feasible"] is False
    assert {v["kind"] for v in result.json["violations"]} >= {"speed"}
    scale = result.json["max_speed_scale"]
    assert 0 < scale < 1
    assert run("check", file, "--model", "quadriga:full:marble", "--strict").code == 3
    assert result.json["duration"] == pytest.approx(arc(1.1).duration)


@pytest.mark.parametrize("speed", [0.2, 1.1, 7.3])
def test_check_writes_what_the_motors_can_drive(run: Run, tmp_path: Path, speed: float) -> None:
    """A fast trajectory is slowed, a slow one stays as it is, and a path is timed."""
    model = ("--model", "quadriga:full:marble")
    file = write_trajectory(arc(speed), tmp_path / "asked.csv")
    told = run("check", file, *model, "--out", tmp_path / "slow.csv", "--json").json
    share = min(told["max_speed_scale"], 1.0)
    assert told["feasible"] == (share == 1.0) == (speed == 0.2)
    slow = read_trajectory(tmp_path / "slow.csv")
    assert slow.duration == pytest.approx(arc(speed).duration / share)
    assert told["out_duration"] == slow.duration
    again = run("check", tmp_path / "slow.csv", *model, "--strict", "--out", tmp_path / "same.csv")
    assert again.code == 0
    assert f"same.csv: {slow.duration:.4g} s, at 100 % of these speeds" in again.out
    assert read_trajectory(tmp_path / "same.csv") == slow
    path = write_path(ep.Path.from_poses(arc(speed).poses), tmp_path / "path.csv")
    timed = run("check", path, *model, "--out", tmp_path / "timed.csv", "--json").json
    assert timed["feasible"]
    made = read_trajectory(tmp_path / "timed.csv")
    assert timed["duration"] == timed["out_duration"] == made.duration
    assert run("check", tmp_path / "timed.csv", *model, "--strict").code == 0


def test_check_writes_nothing_where_no_speed_is_slow_enough(run: Run, tmp_path: Path) -> None:
    model = PowerModel.preset("quadriga:full:marble")
    weak = replace(model.vehicle, motor=replace(model.vehicle.motor, force=50.0))
    write_model(replace(model, vehicle=weak), tmp_path / "weak.yaml")
    file = write_trajectory(arc(0.2), tmp_path / "asked.csv")
    told = run("check", file, "--model", tmp_path / "weak.yaml", "--out", tmp_path / "slow.csv")
    assert told.code == 0
    assert "slow.csv is not written: the motors drive this trajectory at no speed" in told.err
    assert not (tmp_path / "slow.csv").exists()


def test_plan_and_compare_write_tables_recordings_and_pictures(run: Run, tmp_path: Path) -> None:
    options = (*OFFICE, "--goal", "3.9,2,90deg", "--effort", 1000)
    out, plot, recorded = (tmp_path / name for name in ("path.csv", "path.png", "routes.mcap"))
    assert run("plan", *options, "--out", out, "--plot", plot).code == 0
    assert out.read_text().startswith("x,y,yaw\n")
    assert plot.read_bytes().startswith(b"\x89PNG")
    assert run("compare", *options, "--out", recorded).code == 0
    with opened_bag(recorded) as bag:
        assert "/map" in bag.topics
    assert recorded.read_bytes().startswith(b"\x89MCAP0")


def test_the_same_route_twice_is_told_of_once(run: Run) -> None:
    result = run("compare", *OFFICE, "--goal", "1.2,2,90deg", "--effort", 100)
    assert result.code == 0
    assert result.err.count("the path has no length") == 1


def test_why_routes_cannot_be_timed_is_said_once_for_a_vehicle_s_file(
    run: Run, tmp_path: Path
) -> None:
    model = PowerModel.preset(CONCRETE)
    free = replace(model.vehicle, motor=ep.MotorLimits())
    write_model(replace(model, name="own", vehicle=free), tmp_path / "own.yaml")
    result = run("compare", *OFFICE[:2], "--model", tmp_path / "own.yaml", "--start",
                 "3.1,3,90deg", "--goal", "15,9,0", "--effort", 1000)  # fmt: skip
    assert result.code == 0
    assert result.err.count("nothing limits the speed; give the vehicle's motor a speed") == 1
    assert "MotorLimits(" not in result.err


def test_range_tells_how_far_an_energy_leads(run: Run, tmp_path: Path) -> None:
    asc, areas, picture = (tmp_path / f"range.{end}" for end in ("asc", "geojson", "svg"))
    options = ("range", *OFFICE, "--json")
    result = run(*options, "--energy", 2000, "--reserve", 0.25, "--out", asc,
                 "--contours", areas, "--plot", picture)  # fmt: skip
    assert result.code == 0
    told = result.json["contours"]
    assert [c["energy"] for c in told] == pytest.approx([300, 600, 900, 1200, 1500])
    assert told[-1]["area"] <= result.json["area"] * 1.05
    drawn = json.loads(areas.read_text())["features"]
    assert [f["properties"] for f in drawn] == told
    assert asc.read_text().startswith("ncols ")
    assert picture.read_text().count("<svg") == 1
    both = run(*options, "--energy", 1500, "--return")
    docks = run(*options, "--energy", 1500, "--return", "--return-to", "1.2,5,80deg",
                "--return-heading", "either", "--return-radius", 0.5)  # fmt: skip
    assert both.json["area"] < docks.json["area"] < result.json["area"]
    alone = run(*options, "--energy", 1500, "--return-radius", 0.2)
    assert alone.code == 2 and "give that" in alone.err


PACK = """
preset: 24 V 20 Ah lead-acid
soc_points: [0, 1]
ocv_points: [24, 24]
resistance: 0.1
pair_resistance: 0
peukert: 1
max_discharge_current: {most}
"""


def test_check_says_what_a_drive_asks_of_a_battery(run: Run, tmp_path: Path) -> None:
    """A steady drive, of a battery without memory, has a current in closed form."""
    file, pack = write_trajectory(arc(0.4), tmp_path / "drive.csv"), tmp_path / "pack.yaml"
    pack.write_text(PACK.format(most=100))
    asked = ("check", file, "--model", "quadriga:full:marble", "--battery", pack, "--soc", "50%")
    told = run(*asked, "--json").json
    power = told["energy"] / 4.0
    current = (24.0 - (24.0**2 - 4 * 0.1 * power) ** 0.5) / (2 * 0.1)
    found = told["battery"]
    assert (found["peak_power"], found["peak_current"]) == pytest.approx((power, current), 1e-6)
    assert found["soc_end"] == pytest.approx(0.5 - 4 * current / 72000, 1e-6)
    assert (found["reason"], found["brown_out"]) == ("none", None)
    line = f"battery: at most {number(power)} W and {number(current)} A, "
    assert line in run(*asked).out
    pack.write_text(PACK.format(most=0.9 * current))
    assert "the battery would have to deliver more current" in run(*asked).out
    assert run(*asked, "--json").json["battery"]["reason"] == "current"


def test_plan_says_what_its_drive_asks_of_a_battery(run: Run, tmp_path: Path) -> None:
    words, drive = "24 V 20 Ah lead-acid", tmp_path / "drive.csv"
    asked = (*OFFICE, "--goal", "3.9,2,90deg", "--battery", words, "--soc", "80%", "--json")
    told = run("plan", *asked, "--trajectory", drive).json
    checked = run("check", drive, "--model", CONCRETE, "--battery", words, "--soc", 0.8, "--json")
    for key in ("peak_power", "peak_current", "soc_end"):
        assert told["battery"][key] == pytest.approx(checked.json["battery"][key], rel=1e-3)
    compared = run("compare", *asked).json
    for key in ("energy_optimal", "shortest"):
        one = compared[key]
        assert one["battery"]["peak_power"] > one["energy_driven"] / one["duration"]
        assert 0.79 < one["battery"]["soc_end"] < 0.8
    assert run("plan", *OFFICE, "--goal", "3.9,2,90deg", "--json").json["battery"] is None


def test_range_takes_what_a_battery_holds_above_the_reserve(run: Run) -> None:
    """A reserve is a state of charge, as that of a mission."""
    told = run("range", *OFFICE, "--battery", "quadriga", "--soc", 0.5012, "--reserve", 0.5,
               "--json").json["contours"]  # fmt: skip
    cost = ep.EnergyCost(PowerModel.preset(CONCRETE), battery=True)
    power = cost.segment_energy(1.0, 0.0) / cost.segment_duration(1.0, 0.0)
    above, below = ep.Battery.preset("quadriga").usable_energy(power, [0.5012, 0.5])
    assert told[-1]["energy"] == pytest.approx(float(above - below), rel=0.02)


@pytest.mark.parametrize(
    ("options", "why"),
    [
        ("--battery quadriga --soc 20% --reserve 20%",
         "the reserve 0.2 is not below the state of charge 0.2; charge first"),
        ("--battery quadriga --soc 0", "the reserve 0 is not below the state of charge 0"),
        ("--energy 500 --reserve 100%", "--reserve 100% leaves nothing of the energy"),
    ],
)  # fmt: skip
def test_range_says_what_leaves_nothing(run: Run, options: str, why: str) -> None:
    told = run("range", *OFFICE, *options.split())
    assert told.code == 2
    assert why in told.err


@pytest.mark.parametrize(
    ("words", "why"),
    [
        ("24 V 20 Ah lead-acid, usable 80 %", "is not above 0.2, at which the battery is cut off"),
        ("24 V 4 Ah lead-acid 10 mohm", "deliver more current than it may"),
        ("24 V 20 Ah lead-acid 900 mohm", "the voltage sags below cut-off"),
    ],
)  # fmt: skip
def test_range_says_why_a_battery_delivers_nothing(run: Run, words: str, why: str) -> None:
    told = run("range", *OFFICE, "--battery", words, "--soc", "20%")
    assert told.code == 2
    assert why in told.err
    assert "the energy is" not in told.err


def test_plan_counts_a_costmap_beside_the_energy(run: Run, tmp_path: Path) -> None:
    write_map(ep.OccupancyGrid(np.zeros((60, 120), bool), 0.1), tmp_path / "hall.yaml")
    costs = np.zeros((60, 120), np.uint8)
    costs[25:40, 50:70] = 100
    Image.fromarray(costs[::-1]).save(tmp_path / "costs.pgm")
    header = "image: costs.pgm\nmode: raw\nresolution: 0.1\norigin: [0, 0, 0]\n"
    (tmp_path / "costs.yaml").write_text(header)
    (tmp_path / "site.yaml").write_text("map: hall.yaml\ncostmap: costs.yaml\n")
    options = ("plan", "--map", tmp_path / "site.yaml", "--model", "quadriga:empty:concrete",
               "--start", "2,3,0", "--goal", "10,3,0", "--effort", 5000, "--json")  # fmt: skip
    plain, soft = run(*options), run(*options, "--costmap-weight", 1000)
    assert plain.json["soft_cost"] == 0
    assert plain.json["cost"] == plain.json["energy"]
    assert soft.json["energy"] > plain.json["energy"]
    told = soft.json["energy"] + soft.json["soft_cost"]
    assert soft.json["cost"] == pytest.approx(told)
    assert soft.json["cost"] < plain.json["energy"] + 2000


def test_a_path_that_is_shut_has_no_way_round(run: Run, tmp_path: Path) -> None:
    hall = tmp_path / "hall.yaml"
    asked = ("--map", hall, "--model", CONCRETE, "--start", "3,4,0", "--effort", 3000)
    former = tmp_path / "path.csv"
    former.write_text("x,y,yaw\n1,4,0\n11,4,0\n")
    cells = np.zeros((80, 120), bool)
    cells[:, 60:64] = True
    write_map(ep.OccupancyGrid(cells, 0.1), hall)
    assert run("plan", "--former", former, *asked, "--strict").code == 3


def test_a_path_that_is_driven_gives_way_to_a_better_one_that_has_opened(
    run: Run, tmp_path: Path
) -> None:
    hall, shut, former = (tmp_path / name for name in ("open.yaml", "shut.yaml", "former.csv"))
    cells = np.zeros((100, 200), bool)
    write_map(ep.OccupancyGrid(cells, 0.1), hall)
    cells[:85, 100:104] = True
    write_map(ep.OccupancyGrid(cells, 0.1), shut)
    asked = ("plan", "--model", CONCRETE, "--effort", 10000, "--json")
    to = ("--start", "2,2,0", "--goal", "18,2,0")
    run(*asked, "--map", shut, *to, "--out", former)
    here = (*asked, "--map", hall, "--start", "4,2,0")
    again, fresh = run(*here, "--former", former), run(*here, "--goal", "18,2,0")
    assert again.json["energy"] == pytest.approx(fresh.json["energy"], rel=1e-3)
    assert again.json["energy"] < 0.7 * run(*here, "--former", former, "--map", shut).json["energy"]


@pytest.mark.parametrize(
    "command",
    [("export", "lattice", "--resolution", 0.1, "--out"), ("export", "table", "--out")],
    ids=lambda c: c[0],
)
def test_what_knows_no_map_says_that_it_leaves_a_slope_out(
    run: Run, tmp_path: Path, command: tuple[object, ...]
) -> None:
    level = PowerModel.preset(CONCRETE)
    tilted = ep.write_model(level.with_term(term("tilt_x"), 20.0), tmp_path / "tilted.yaml")
    plain = ep.write_model(level, tmp_path / "level.yaml")
    out = {"lattice": "out.json", "table": "out.csv"}[str(command[1])]
    code, _, err = run(*command, tmp_path / out, "--model", tilted)
    assert code == 0, err
    assert "left out" in err
    code, _, err = run(*command, tmp_path / out, "--model", plain)
    assert code == 0, err
    assert "left out" not in err


@pytest.mark.parametrize("label", ["36 V 10 Ah li-ion 10S3P", "36 V 10 Ah 365 Wh li-ion 10S3P"])
def test_a_mission_holds_what_its_pack_is_labelled_with(
    run: Run, tmp_path: Path, label: str
) -> None:
    """Three hours at 200 W are not to be had from 360 Wh, however many strings it has."""
    told = {}
    for name, words in (("label", label), ("plain", "36 V 10 Ah li-ion")):
        file = tmp_path / f"{name}.yaml"
        file.write_text(
            f"model: {CONCRETE}\nmap: office.yaml\nbattery: {words}\nstart: [1.2, 2.0, 90deg]\n"
            "coefficient_spread: 0.05\nplanning_effort: 500\ntasks:\n"
            "- {name: work, pose: [3.9, 2.0, 90deg], dwell: 3 h, power: 200 W}\n"
        )
        told[name] = run("mission", file, "--json").json
    assert not told["label"]["feasible"]
    (one,), (other,) = (told[name]["tasks"] for name in told)
    assert one["shortfall"] == pytest.approx(other["shortfall"], rel=1e-6)
    assert one["detail"] == other["detail"]
    assert "Wh more than there is above the reserve" in one["detail"]
    assert one["detail"] in run("mission", tmp_path / "label.yaml").out


def test_a_mission_with_a_label_that_contradicts_itself_is_refused(
    run: Run, tmp_path: Path
) -> None:
    file = tmp_path / "round.yaml"
    file.write_text(
        f"model: {CONCRETE}\nmap: office.yaml\nbattery: 36 V 10 Ah li-ion 7S3P\n"
        "start: [1.2, 2.0, 90deg]\ntasks:\n- {name: look, pose: [3.9, 2.0, 90deg]}\n"
    )
    told = run("mission", file)
    assert told.code == 2
    assert "round.yaml, line 3, battery: " in told.err
    assert "36 V and 10 Ah cannot be those of 7S3P" in told.err
