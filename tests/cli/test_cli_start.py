"""The first steps with a robot's own log: start, and the commands that take its project."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from commands import Run
from own_robot import MODEL, RADIUS, ROBOT, bag, drive
from PIL import Image

import energyplan as ep
from energyplan import simulate
from energyplan.io.config import read_project, write_project, write_vehicle
from energyplan.io.given import Given
from energyplan.io.logs import read_log
from energyplan.io.maps import read_map
from energyplan.io.start import start
from energyplan.io.tables import write_log
from energyplan.power.presets import MODEL_PRESETS

pytestmark = pytest.mark.usefixtures("little_effort")

MEASURES = ("--track", 0.4, "--wheelbase", 0.62, "--mass", 30)


def table(log: ep.DriveLog, style: str) -> pd.DataFrame:
    """Write a drive as other people's loggers do."""
    at = {name: np.array(values) for name, values in log.channels.items()}
    noise = np.random.default_rng(5)
    jitter = {name: at[name] + noise.normal(0, 0.01, len(log)) for name in ("x", "y")}
    volts = 25.0 + noise.normal(0, 0.01, len(log))
    if style == "rates":  # wheel rates and both sides' electricity, in milliseconds
        return pd.DataFrame({
            "time_ms": 1e3 * at["t"], "left_wheel_velocity": at["v_left"] / RADIUS,
            "right_wheel_velocity": at["v_right"] / RADIUS, "voltage_left": volts,
            "voltage_right": volts, "current_left": at["p_left"] / volts,
            "current_right": at["p_right"] / volts, "pose_x": jitter["x"], "pose_y": jitter["y"],
            "heading": at["yaw"], "gyro_z": at["yaw_rate"], "cmd_left": at["v_left"] * 0,
        })  # fmt: skip
    if style == "units":  # units in names, degrees, kilometres an hour, kilowatts
        return pd.DataFrame({
            "Time [s]": at["t"], "Speed L [km/h]": 3.6 * at["v_left"],
            "Speed R [km/h]": 3.6 * at["v_right"], "Power, total [kW]": 1e-3 * log.power,
            "Yaw rate [deg/s]": np.degrees(at["yaw_rate"]), "motor temp [degC]": 40 + 0 * at["t"],
        })  # fmt: skip
    if style == "battery":  # the sign of ROS, degrees without a word, the gyroscope upside down
        return pd.DataFrame({
            "stamp": 1.7e9 + at["t"], "vl": at["v_left"], "vr": at["v_right"], "voltage": volts,
            "current": -log.power / volts, "yaw": np.degrees(at["yaw"]), "x": jitter["x"],
            "y": jitter["y"], "imu_gyro_z": -at["yaw_rate"],
        })  # fmt: skip
    if style == "heading":  # nothing but wrapped degrees tells the turning
        heading = np.degrees(np.angle(np.exp(1j * at["yaw"])))
        return pd.DataFrame({"t": at["t"], "velL": at["v_left"], "velR": at["v_right"],
                             "heading": heading, "p_total": log.power})  # fmt: skip
    raise AssertionError(style)


@pytest.mark.parametrize("style", ["rates", "units", "battery", "heading"])
def test_columns_and_units_are_guessed_so_that_all_agrees(tmp_path: Path, style: str) -> None:
    log = drive()
    file = tmp_path / "own.csv"
    table(log, style).to_csv(file, index=False)
    made = start(file, Given(track=0.4, wheelbase=0.62, mass=30.0, wheel_radius=RADIUS))
    assert made.sound, made.checks
    assert len(made.checks) >= 5
    read = ep.DriveLog.read(file, dict(made.project.columns))
    for name in {"v_left", "v_right", "yaw_rate"} & set(read.channels):
        np.testing.assert_allclose(read.channel(name), log.channel(name), atol=1e-6)
    if read.has("yaw"):
        turned = np.exp(1j * (read.channel("yaw") - log.channel("yaw")))
        np.testing.assert_allclose(turned, 1.0, atol=1e-6)
    np.testing.assert_allclose(read.power, log.power, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(read.t - read.t[0], log.t - log.t[0], atol=1e-5)
    assert not {"cmd_left", "motor temp [degC]"} & {c.field for c in made.project.columns.values()}


def test_a_table_with_semicolons_and_decimal_commas_needs_no_help(tmp_path: Path) -> None:
    log = drive()
    at = log.channels
    stamps = pd.Timestamp("2026-05-04T09:12:00Z") + pd.to_timedelta(log.t, unit="s")
    frame = pd.DataFrame({
        "timestamp": stamps.strftime("%Y-%m-%dT%H:%M:%S.%fZ"),
        "speed, left [km/h]": 3.6 * at["v_left"], "speed, right [km/h]": 3.6 * at["v_right"],
        "power, total [W]": log.power, "yaw rate [deg/s]": np.degrees(at["yaw_rate"]),
        "temp. motor": 40.0,
    })  # fmt: skip
    file = tmp_path / "fahrt.csv"
    frame.to_csv(file, sep=";", decimal=",", index=False)
    made = start(file, Given(track=0.4, wheelbase=0.62, mass=30.0))
    assert made.sound, made.checks
    read = ep.DriveLog.read(file, dict(made.project.columns))
    for name in ("v_left", "v_right", "yaw_rate"):
        np.testing.assert_allclose(read.channel(name), log.channel(name), atol=1e-6)
    np.testing.assert_allclose(read.power, log.power, rtol=1e-6, atol=1e-6)
    # A name in quotes is believed as one without: its unit counts where no other is given.
    quoted = 'v_left="speed, left [km/h]",v_right="speed, right [km/h]"[km/h]'
    again = start(file, Given(track=0.4, wheelbase=0.62, mass=30.0, columns=quoted))
    assert again.project.columns["v_left"].unit == again.project.columns["v_right"].unit


def test_the_pose_tells_a_wheel_radius_that_nobody_gave(tmp_path: Path) -> None:
    file = tmp_path / "own.csv"
    frame = table(drive(), "rates").rename(
        columns={f"{side}_wheel_velocity": f"{side} wheel [rad/s]" for side in ("left", "right")}
    )
    frame.to_csv(file, index=False)
    made = start(file, Given(track=0.4, wheelbase=0.62, mass=30.0))
    assert made.project.columns["v_left"].conversion.factor == pytest.approx(RADIUS, rel=0.01)
    frame.drop(columns=["pose_x", "pose_y"]).to_csv(file, index=False)
    with pytest.raises(ep.errors.InvalidInputError, match="--wheel-radius"):
        start(file, Given(track=0.4, wheelbase=0.62, mass=30.0))


def test_a_mistake_in_the_measures_is_told(tmp_path: Path, run: Run) -> None:
    file, out = write_log(drive(), tmp_path / "own.csv"), tmp_path / "p.yaml"
    code, _, error = run("start", file, "--track", 40, "--wheelbase", 62, "--mass", 30)
    assert code == 2 and "give 0.01 to 30 m (not centimetres)" in error
    wrong = ("--track", 0.4, "--wheelbase", 0.62, "--mass", 150 * 9.81, "--json")
    code, text, _ = run("start", file, *wrong, "--out", out)
    told = json.loads(text)
    assert code == 3
    assert not out.exists()
    assert {"columns", "units", "vehicle", "checks"} <= set(told)
    failed = [check for check in told["checks"] if not check["ok"]]
    assert failed
    assert all({"what", "value", "expected", "ok"} <= set(check) for check in told["checks"])
    assert "the mass is a weight in N" in failed[0]["remedy"]
    code, _, _ = run("start", file, *wrong, "--out", out, "--accept")
    assert code == 0
    assert out.exists()


def test_a_wrong_wheel_radius_is_told_by_identify(tmp_path: Path, run: Run) -> None:
    log = drive()
    fast = {name: np.array(values) for name, values in log.channels.items()}
    fast |= {name: fast[name] * 0.1651 / RADIUS for name in ("v_left", "v_right")}
    file = write_log(ep.DriveLog(fast), tmp_path / "fast.csv")
    ep_vehicle = write_vehicle(ROBOT, tmp_path / "robot.yaml")
    told = run("identify", file, "--vehicle", ep_vehicle, "--json").json
    assert any("wheel radius is not" in warning for warning in told["warnings"])


def test_a_bag_of_an_unknown_robot_needs_a_radius_from_somewhere(tmp_path: Path, run: Run) -> None:
    file = bag(tmp_path, drive())
    (tmp_path / "v.yaml").write_text("mass: 30\nwheelbase: 0.62\ntrack: 0.4\nlength: 0.8\n"
                                     "width: 0.5\nname: own\n")  # fmt: skip
    code, _, error = run("identify", file, "--vehicle", tmp_path / "v.yaml")
    assert code == 2
    assert "energyplan start" in error


@pytest.mark.parametrize("pose", [True, False])
def test_the_topics_of_a_bag_are_found(tmp_path: Path, run: Run, pose: bool) -> None:
    log = drive()
    file, out = bag(tmp_path, log, pose), tmp_path / "p.yaml"
    radius = () if pose else ("--wheel-radius", RADIUS)
    begun = run("start", file, *MEASURES, *radius, "--out", out, "--json").json
    assert all(check["ok"] for check in begun["checks"])
    told = run("identify", file, "--project", out, "--json").json
    terms = {term["name"]: term["value"] for term in told["terms"]}
    assert terms["traction_resistance"] == pytest.approx(22.0, rel=0.05)
    assert terms["slip_friction"] == pytest.approx(0.6, rel=0.05)
    if not pose:
        code, _, error = run("start", file, *MEASURES, "--out", out)
        assert code == 2
        assert "--wheel-radius" in error


@pytest.mark.parametrize(
    "joints",
    [
        {"wheel_RR_joint": "v_right", "left_arm": "", "wheel_FL_joint": "v_left", "right_arm": "",
         "wheel_RL_joint": "v_left", "wheel_FR_joint": "v_right"},
        {"drivewhl_r_joint": "v_right", "drivewhl_l_joint": "v_left"},
        {"base/starboard_track": "v_right", "base/port_track": "v_left", "mast": ""},
    ],
    ids=["four wheels and two arms", "short names", "nautical"],
)  # fmt: skip
def test_joints_of_other_names_and_orders_are_found(tmp_path: Path, joints: dict[str, str]) -> None:
    log = simulate.drive(MODEL, "spiral", rate=10.0, power_noise=3.0)
    file = bag(tmp_path, log, joints=joints)
    made = start(file, Given(track=0.4, wheelbase=0.62, mass=30.0, wheel_radius=RADIUS))
    assert made.project.topics is not None
    read = read_log(file, topics=made.project.topics)
    for channel in ("v_left", "v_right"):
        np.testing.assert_allclose(read.channel(channel), log.channel(channel), atol=1e-9)


@pytest.mark.parametrize("name", MODEL_PRESETS)
def test_presets_are_models_with_a_source(name: str) -> None:
    model = ep.PowerModel.preset(name)
    assert model.name == name
    assert len(MODEL_PRESETS[name].source) > 20
    if not name.startswith("quadriga"):
        assert model.covariance is not None
        assert 0 < model.std_error("traction_resistance") < model.coefficient("traction_resistance")
    per_weight = 2 * model.coefficient("traction_resistance") / (9.81 * model.vehicle.mass)
    assert 0.02 < per_weight < 0.5


def test_a_preset_that_a_mission_names_is_told(tmp_path: Path) -> None:
    from energyplan.cli.app import presets_named

    mission = tmp_path / "round.yaml"
    mission.write_text("model: husky_a200:ice\nmap: office.yaml\n")
    assert list(presets_named([mission])) == ["husky_a200:ice"]


@pytest.mark.shared
def test_hoisted_drives_tell_the_friction_inside(shared_data: Path, run: Run) -> None:
    logs = sorted((shared_data / "drive").glob("husky_hoisted_*.csv"))
    command = ("identify", *logs, "--vehicle", "husky_a200", "--hoisted", "--json")
    told = run(*command, "--motor-constant", 21.4).json
    sides = {side["side"]: side for side in told["sides"]}
    # 21.4 N/A times the mean current beyond the dead band: 0.6 to 1.0 A left, 1.2 to 2.1 A right
    assert 12.0 < sides["left"]["force"] < 22.0
    assert 25.0 < sides["right"]["force"] < 45.0
    assert sides["left"]["slope"] > 3 * sides["left"]["slope_error"]
    assert len(sides["left"]["classes"]) >= 8
    assert not any("yaw" in warning for warning in told["warnings"])
    assert any("--motor-constant" in warning for warning in run(*command).json["warnings"])


def test_terms_are_chosen(tmp_path: Path, run: Run) -> None:
    file = write_log(drive(), tmp_path / "own.csv")
    command = ("identify", file, "--vehicle", "quadriga", "--json")
    for names in ("slip_friction,traction_resistance,hotel_load", "traction_resistance"):
        terms = run(*command, "--terms", names).json["terms"]
        assert [term["name"] for term in terms] == names.split(",")
    code, _, error = run(*command, "--terms", "hotel")
    assert code == 2
    assert "hotel_load" in error


def test_powers_without_sign_are_told_once(tmp_path: Path, run: Run) -> None:
    """The reader doubts them, and identify says what follows from it: one note says both."""
    truth = ep.PowerModel.preset("quadriga:full:concrete")
    made = simulate.identification_drive(truth, rate=10.0, power_noise=5.0, seed=1)
    lost = {name: np.abs(made.channel(name)) for name in ("p_left", "p_right")}
    file = write_log(ep.DriveLog({**made.channels, **lost}), tmp_path / "lost.csv")
    code, text, _ = run("identify", file, "--vehicle", "quadriga:full")
    assert code == 0
    assert text.count("never negative") == 1
    assert "these terms are wrong" in text
    assert "unseen driving: stretches of" in text


def test_a_project_keeps_that_sensors_see_no_sign(tmp_path: Path, run: Run) -> None:
    file, out = tmp_path / "own.csv", tmp_path / "p.yaml"
    table(drive(), "rates").to_csv(file, index=False)
    run("start", file, *MEASURES, "--wheel-radius", RADIUS, "--unsigned", "--out", out)
    columns = read_project(out).columns
    assert [name for name, one in columns.items() if one.unsigned] == ["p_left", "p_right"]
    assert ep.DriveLog.read(file, dict(columns)).signed is False
    robot = ("--vehicle", out, "--columns", out, "--json")
    kept = run("identify", file, *robot, "--method", "windows").json
    bare = {name: one.changed(unsigned=False) for name, one in columns.items()}
    assert ep.DriveLog.read(file, bare).signed is None
    project = replace(read_project(out), columns=bare)
    write_project(project, out)
    said = run("identify", file, *robot, "--method", "windows", "--unsigned").json
    assert said["terms"] == kept["terms"]


def test_a_topic_map_says_that_sensors_see_no_sign(tmp_path: Path) -> None:
    file = bag(tmp_path, drive())
    given = Given(track=0.4, wheelbase=0.62, mass=30.0, wheel_radius=RADIUS)
    for unsigned, signed in ((True, False), (False, None)):
        made = start(file, replace(given, unsigned=unsigned))
        assert made.project.topics is not None
        assert read_log(file, topics=made.project.topics).signed is signed


def test_the_image_of_a_map_becomes_its_yaml(tmp_path: Path, run: Run) -> None:
    pixels = np.full((40, 60), 255, np.uint8)
    pixels[[0, -1]] = pixels[:, [0, -1]] = 0
    pixels[10:16, 10:20] = 120
    image, out, seen = (tmp_path / name for name in ("yard.png", "yard.yaml", "seen.png"))
    Image.fromarray(pixels).save(image)
    text = run("start", image, "--resolution", 0.1, "--out", out, "--plot", seen).out
    assert "60 x 40 pixels of 0.1 m: 6 x 4 m; 89.3 % free, 8.2 % occupied, 2.5 % unknown" in text
    assert "paint them black or white" in text
    assert f"next: energyplan compare --map {out}" in text
    assert read_map(out).size == pytest.approx((6.0, 4.0))
    assert seen.read_bytes().startswith(b"\x89PNG")
    found = json.loads(run("start", image, "--resolution", 0.1, "--json").out)
    assert found["size"] == pytest.approx([6.0, 4.0])
    assert found["free"] + found["occupied"] + found["unknown"] == pytest.approx(1.0)
    path = "--start", "1,1,0", "--goal", "5,3,0", "--model", "husky_a200:flooring"
    plans = [
        json.loads(run("plan", "--map", *place, *path, "--json").out)
        for place in ((out,), (image, "--resolution", 0.1))
    ]
    assert plans[0]["path"] == plans[1]["path"]
    assert plans[0]["cost"] == plans[1]["cost"]


def test_what_is_wrong_with_the_image_of_a_map_is_said(tmp_path: Path, run: Run) -> None:
    image = tmp_path / "yard.png"
    Image.fromarray(np.full((40, 60), 255, np.uint8)).save(image)
    out = tmp_path / "yard.yaml"
    write_log(drive(), tmp_path / "drive.csv")
    for words, message in (
        ((image, "--out", out), "give --resolution"),
        ((image,), "--resolution 0.05"),
        ((tmp_path / "drive.csv", "--resolution", 0.1), "--resolution is for the image of a map"),
    ):
        refused = run("start", *words)
        assert refused.code == 2
        assert message in refused.err
    assert not out.exists()


def test_a_robot_that_must_not_reverse_says_so_from_the_start(tmp_path: Path, run: Run) -> None:
    write_log(drive(), tmp_path / "drive.csv")
    project = tmp_path / "robot.yaml"
    asked = ("start", tmp_path / "drive.csv", *MEASURES, "--out", project)
    assert "--reverse no where it must not" in run(*asked).out
    assert read_project(project).vehicle.reverse
    assert "--reverse no" not in run(*asked, "--reverse", "no").out
    assert not read_project(project).vehicle.reverse
