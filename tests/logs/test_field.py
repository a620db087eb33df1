"""Logs as people have them: read right, or refused with what to write; never wrong in silence."""

from __future__ import annotations

import re
import shlex
import shutil
import tomllib
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from commands import Run
from foreign_logs import ROVER, At, drive
from own_robot import MODEL, bag
from pydantic import ValidationError

import energyplan as ep
from energyplan import simulate
from energyplan.errors import DriveLogError
from energyplan.fit.tasks import identify_tasks
from energyplan.io.bags import TopicMap, of_types, read_message, topics_of
from energyplan.io.draft import refuse
from energyplan.io.given import Given, read_like
from energyplan.io.logs import named_columns, read_log, tasks_of
from energyplan.io.start import start, start_all
from energyplan.logs.tables import Recording, message_series, read_table

AT = At(drive(ROVER), ROVER)
MEASURES = Given(**ROVER.measures)
CASES = {
    "charge_counter_as_current": ("", "current=BAT.CurrTot[mAh]"),
    "delay_of_nothing": ("", ""),
    "header_longer_than_rows": ("", "names 7 columns, but the rows have 6 cells"),
    "hundredths_volts_and_amps": ("", "25.2 V in [*0.01]"),
    "inches_per_second": ("", ""),
    "mirrored_motor_no_heading": (
        "v_left=left_vel[rev/s*0.1],v_right=right_vel[rev/s*0.1]", "motor mounted in the mirror"),
    "nan_in_a_check": ("", "never negative"),
    "odom_twist_and_battery": ("", ""),
    "topic_echo_csv_no_header": ("", "no line names the columns"),
    "turns_per_second_wrong_remedy": (
        "v_left=left_vel_estimate,v_right=right_vel_estimate", "left_vel_estimate[rev/s*0.1]"),
    "watt_hours_beside_volt_amp": ("", ""),
    "watt_hours_only": ("", ""),
}  # fmt: skip


SOME = (
    "bag_battery_positive_discharge", "bag_camera_imu_first", "bag_eighteen_joints",
    "bag_humble_custom_topic_beside", "bag_panther_two_batteries", "bag_two_joint_publishers",
    "bms_one_hour_off", "clearpath_robot_yaml", "effort_times_velocity", "epoch_five_seconds",
    "fleet_task_history", "geotiff_scaled_heights", "mcap_json_encoding", "pwm_chopped_current",
    "quaternion_pose", "surfaces_shapefile", "vda5050_order", "vesc_tool_two_controllers",
)  # fmt: skip


@pytest.mark.shared
@pytest.mark.parametrize("name", CASES)
def test_cases_of_the_field(shared_data: Path, name: str) -> None:
    """The truth is K = 30 N a side."""
    columns, told = CASES[name]
    file = shared_data / "field" / name / "log.csv"
    known = Given(track=0.5, wheelbase=0.4, mass=50.0, wheel_radius=0.1, columns=columns or None)
    try:
        made = start(file, known)
    except DriveLogError as error:
        assert told and told in str(error)
        return
    said = " ".join(str(check) for check in made.checks if not check.ok)
    assert made.sound == (not told) and (not told or said.count(told) == 1) and "nan" not in said
    if made.sound:
        assert not any("tread speeds by" in note for note in made.notes)
        found = ep.identify(read_log(file, dict(made.project.columns)), made.project.vehicle)
        assert found.model.coefficient("traction_resistance") == pytest.approx(30.0, rel=0.01)


REFUSED = {
    "bms_one_hour_off": "clock of .* 1 h",
    "clearpath_robot_yaml": "",
    "effort_times_velocity": "rear_left_effort",
    "epoch_five_seconds": "5 s apart",
    "fleet_task_history": "a row is a task",
    "mcap_json_encoding": "messages in JSON",
    "pwm_chopped_current": "average",
    "surfaces_shapefile": "ogr2ogr",
    "vda5050_order": "VDA 5050",
}
"""Cases that need not be read, and what their refusal says."""


@pytest.mark.shared
@pytest.mark.parametrize("name", SOME)
def test_commands_of_the_field(
    shared_data: Path, name: str, tmp_path: Path, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each case is read right, to K = 30 N, or refused in the words that help."""
    folder = shared_data / "field" / name
    case = tomllib.loads((folder / "case.toml").read_text())
    shutil.copytree(folder, tmp_path / "case")
    monkeypatch.chdir(tmp_path / "case")
    told, project = "", Path("p.yaml")
    for command in map(shlex.split, case["commands"]):
        if command[1] == "identify" and not project.exists():
            continue
        answer = run(*command[1:], *(["--json"] if command[1] in ("identify", "plan") else []))
        assert answer.code in (0, 2, 3), answer.err
        if answer.code == 0 and command[1] == "identify":
            terms = {one["name"]: one["value"] for one in answer.json["terms"]}
            assert terms["traction_resistance"] == pytest.approx(30.0, rel=0.05)
            assert answer.json["icr"]["left"] == pytest.approx(0.43, rel=0.05)
            return
        if answer.code == 0 and command[1] == "plan":
            assert answer.json["energy"] == pytest.approx(1888.0, rel=0.03)
            return
        told += answer.err + answer.out
    if name in REFUSED:
        assert re.search(REFUSED[name], told), told
    else:
        assert project.exists(), told
        log = next(iter(case["commands"])).split()[2]
        terms = run("identify", log, "--project", project, "--json").json["terms"]
        assert terms[1]["value"] == pytest.approx(30.0, rel=0.05)


OF_TOOLS = (
    "behaviour_tree_as_mission", "geotiff_state_plane_code", "geotiff_untold_no_data",
    "geotiff_vertical_epsg_feet", "nav2_rviz_waypoints", "path_with_quaternions",
    "vda5050_speed_of_edges", "vector_objects_as_keepout", "waypoints_of_mavlink",
)  # fmt: skip
"""Files of other tools: what an answer or a refusal must hold stands in the case."""


@pytest.mark.shared
@pytest.mark.parametrize("name", OF_TOOLS)
def test_files_of_other_tools(
    shared_data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, run: Run, name: str
) -> None:
    folder = shared_data / "field" / name
    case = tomllib.loads((folder / "case.toml").read_text())
    shutil.copytree(folder, tmp_path / "case")
    monkeypatch.chdir(tmp_path / "case")
    words, *_ = map(shlex.split, case["commands"])
    answer = run(*words[1:])
    if answer.code in (0, 3) and not case["words"]:
        energy = re.findall(r"energy as driven.*?([\d.]+)\n", answer.out)[0]
        assert float(energy) == pytest.approx(1888.0, rel=0.03)
    else:
        assert re.search(case["words"] or "metres", answer.err + answer.out), answer.err


SHARED = {
    "bag_default_zero_publisher": "to 0 for a moment",
    "bag_jackal_feedback": "drivers.0.measured_velocity",
    "bag_two_vescs_erpm": "electrical rate",
    "charge_in_coulombs": "",
    "charging_before_the_drive": "charged while",
    "current_of_nan": "never measured",
    "current_that_saturates": "end of its range",
    "currents_three_of_four": "a wheel's is missing",
    "foxglove_plot_csv": "",
    "gyro_in_mdps": "",
    "motor_name_rows": "",
    "odometers_in_metres": "",
    "power_v_power_a": "",
    "roboclaw_units": "",
    "secs_and_nsecs": "",
    "solar_small_beside_load": "power=load_power",
    "ten_seconds_fleet": "10 s apart",
    "thousands_german": "thousands",
    "thousands_in_the_time": "thousands",
    "two_robots_one_table": "several 'robot'",
    "vedirect_text": "pairs of a name and a value",
    "vesc_tool_midnight": "",
    "voltages_front_rear": r"voltage=v_bat_front\+v_bat_rear",
    "voltages_upper_lower": r"voltage=upper_battery_voltage\+lower_battery_voltage",
    "wheels_added_two": "write their mean",
    "wheels_in_deg_s": "deg/s",
}
"""Logs that are read right, if nothing is said of them, or asked about in these words."""


@pytest.mark.shared
@pytest.mark.parametrize("name", SHARED)
def test_logs_of_the_field_are_right_or_asked_about(
    shared_data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, run: Run, name: str
) -> None:
    folder = shared_data / "field" / name
    case = tomllib.loads((folder / "case.toml").read_text())
    shutil.copytree(folder, tmp_path / "case", copy_function=shutil.copyfile)
    monkeypatch.chdir(tmp_path / "case")
    said, log, project = "", "", Path("p.yaml")
    for words in map(shlex.split, case["commands"]):
        if words[0] == "sed":
            continue
        if words[1] == "start":
            answer = run(*words[1:])
            said, log = said + answer.err + answer.out, words[2]
            if SHARED[name] and re.search(SHARED[name], said):  # what follows is an answer to it
                break
    assert project.exists() == (not SHARED[name]), said
    assert re.search(SHARED[name], said), said
    if project.exists():
        terms = run("identify", log, "--project", project, "--json").json["terms"]
        found = {one["name"]: one["value"] for one in terms}
        assert found["traction_resistance"] == pytest.approx(30.0, rel=0.05)


def test_a_side_in_the_mirror_is_doubted_without_a_heading() -> None:
    columns = {"t": AT.t, "v_left": AT.left, "v_right": -AT.right, "power": AT.power}
    (warning,) = ep.DriveLog.from_columns(columns).warnings
    assert "motor mounted in the mirror" in warning and "NAME[-m/s]" in warning
    assert not ep.DriveLog.from_columns({**columns, "v_right": AT.right}).warnings


@pytest.mark.parametrize(("unit", "size"), [("Wh", 3600.0), ("J", 1.0), ("-kJ", -1000.0)])
def test_counters_are_refused_as_power_and_read_by_their_unit(unit: str, size: float) -> None:
    mean = 0.5 * (AT.power[1:] + AT.power[:-1]) * np.diff(AT.t)
    made = pd.DataFrame({"t": AT.t, "v_left": AT.left, "v_right": AT.right})
    made["counter"] = 9.0 + np.append(0.0, np.cumsum(mean)) / size
    with pytest.raises(DriveLogError, match=r"power only ever .* as in power=NAME\[-?Wh"):
        ep.DriveLog.read(made, "power=counter")
    log = ep.DriveLog.read(made, f"power=counter[{unit}]")
    assert log.energy == pytest.approx(float(mean.sum()), rel=1e-3)


def test_a_coarse_counter_keeps_the_energy() -> None:
    mean = 0.5 * (AT.power[1:] + AT.power[:-1]) * np.diff(AT.t)
    made = pd.DataFrame({"t": AT.t, "v_left": AT.left, "v_right": AT.right})
    made["Wh"] = np.floor(np.append(0.0, np.cumsum(mean)) / 36.0) / 100.0
    log = ep.DriveLog.read(made, "power=Wh")
    assert log.energy == pytest.approx(float(mean.sum()), abs=2 * 36.0)


@pytest.mark.parametrize(
    "formula",
    ["v-0.225*w", "v - w*0.225", "-0.225*w+v", "(v-0.225*w)[m/s]", "2*v-v-0.225*w"],
)
def test_columns_are_made_of_others(formula: str) -> None:
    speed, turn = 0.5 * (AT.left + AT.right), (AT.right - AT.left) / 0.45
    made = pd.DataFrame({"t": AT.t, "v": speed, "w": turn, "power": AT.power})
    log = ep.DriveLog.read(made, f"v_left={formula},v_right=v+0.225*w")
    np.testing.assert_allclose(log.channel("v_left"), AT.left, atol=1e-9)
    np.testing.assert_allclose(log.channel("v_right"), AT.right, atol=1e-9)


def test_units_of_a_formula_must_agree() -> None:
    made = pd.DataFrame({"t": AT.t, "v_kmh": AT.left, "w": AT.right, "power": AT.power})
    with pytest.raises(DriveLogError, match="do not tell one unit"):
        ep.DriveLog.read(made, "v_left=v_kmh-0.2*w,v_right=v_kmh+0.2*w")


def test_two_logs_make_one_drive(tmp_path: Path) -> None:
    """As of a controller a side, and a battery, with one clock."""
    late = AT.t + 0.04
    sides = {"left": AT.left, "right": np.interp(late, AT.t, AT.right)}
    for side, t in (("left", AT.t), ("right", late)):
        frame = pd.DataFrame({"time": t, "speed": sides[side], "gyro_z": AT.yaw_rate})
        frame.drop(columns="gyro_z" if side == "right" else []).to_csv(
            tmp_path / f"{side}.csv", index=False
        )
    battery = {"time_ms": 1e3 * AT.t[::3], "volts": AT.volts[::3], "amps": AT.amps[::3]}
    pd.DataFrame(battery).to_csv(tmp_path / "battery.csv", index=False)
    path = "+".join(str(tmp_path / f"{name}.csv") for name in ("left", "right", "battery"))
    made = start(path, MEASURES)
    assert made.sound
    log = read_log(path, dict(made.project.columns))
    assert len(log) > 0.98 * len(AT.t)
    found = ep.identify(log, ROVER.vehicle).model.coefficients
    np.testing.assert_allclose(found, [ROVER.mu, ROVER.K], rtol=0.05)
    pd.DataFrame({**battery, "time_ms": 1e12 + battery["time_ms"]}).to_csv(
        tmp_path / "battery.csv", index=False
    )
    with pytest.raises(DriveLogError, match="the clocks do not overlap"):
        start(path, MEASURES)


def test_speed_and_turn_rate_of_the_body_tell_that_slip_is_unseen(tmp_path: Path) -> None:
    made = {"stamp": AT.t, "twist.linear.x": 0.5 * (AT.left + AT.right),
            "twist.angular.z": (AT.right - AT.left) / ROVER.track, "power": AT.power}  # fmt: skip
    pd.DataFrame(made).to_csv(tmp_path / "odom.csv", index=False)
    assert any("slip in turns is unseen" in n for n in start(tmp_path / "odom.csv", MEASURES).notes)
    with pytest.raises(DriveLogError, match="as in --track"):
        start(tmp_path / "odom.csv", Given(mass=30.0))


def of_messages(kind: str, topic: str, **fields: float) -> Recording:
    t = np.arange(3.0)
    names = {message_series(f"{topic}.{field}"): field for field in fields}
    columns = {name: np.full(3, fields[field]) for name, field in names.items()}
    written = {name: f"{topic}.{field}" for name, field in names.items()}
    times = dict.fromkeys(names, t)
    return Recording("a.mcap", columns, times=times, kinds={topic: kind}, written=written)


def test_a_topic_map_makes_tread_speeds_of_a_twist() -> None:
    """As of the odometry that every Nav2 robot has."""
    parts = {"twist.twist.linear.x": 0.7, "twist.twist.angular.z": 0.4}
    recording = of_messages("nav_msgs/msg/Odometry", "/odom", **parts)
    typed = of_types(recording, {}, {}, 0.5)
    assert not typed.rates
    mapped = topics_of(recording, typed.sources, "odometry").channels
    twist = SimpleNamespace(linear=SimpleNamespace(x=0.7), angular=SimpleNamespace(z=0.4))
    message = SimpleNamespace(twist=SimpleNamespace(twist=twist))
    assert read_message(mapped["v_left"][0], message) == pytest.approx(0.6)
    assert read_message(mapped["v_right"][0], message) == pytest.approx(0.8)
    with pytest.raises(ValidationError, match="write a field"):
        TopicMap(channels={"x": {"topic": "odom", "field": "a.b c.d"}})


def test_efforts_of_joints_make_a_power_as_it_is_told() -> None:
    sizes = {"velocity[left_a]": 2.0, "velocity[left_b]": 2.0, "velocity[right_a]": 9.0,
             "effort[left_a]": 3.0, "effort[left_b]": 4.0, "effort[right_a]": 1.0}  # fmt: skip
    recording = of_messages("sensor_msgs/msg/JointState", "/joints", **sizes)
    with pytest.raises(DriveLogError, match="nothing seems to be power") as refused:
        refuse(recording, ["power"])
    text = str(refused.value).partition('in --columns "')[2].partition('"')[0]
    column = named_columns(recording, text)["p_left"]
    assert recording.series(column).values == pytest.approx(2.0 * 3.0 + 2.0 * 4.0)
    message = SimpleNamespace(
        name=["left_a", "left_b", "right_a"], velocity=[2.0, 2.0, 9.0], effort=[3.0, 4.0, 9.0]
    )
    (source,) = topics_of(recording, {"p_left": column}, "joints").channels["p_left"]
    assert read_message(source, message) == pytest.approx(2.0 * 3.0 + 2.0 * 4.0)


TENTHS = {"volts": np.round(10 * AT.volts), "amps": np.round(10 * AT.amps)}
HUNDREDTHS = {"volts": AT.volts, "amps": np.round(100 * AT.amps)}
USED = {"volts": AT.volts, "charge_used": np.cumsum(AT.amps) * 0.1 / 3.6}
SPEEDS = {"left_speed": np.round(100 * AT.left), "right_speed": np.round(100 * AT.right)}


@pytest.mark.parametrize(
    ("columns", "told"),
    [
        (TENTHS, r"whole numbers, .* 'current=amps\[\*0.1\]'"),
        (HUNDREDTHS, r"whole numbers, .* 'current=amps\[\*0.01\]'"),
        (USED, r"map its rate of change .* current=charge_used\[mAh\]"),
        ({**SPEEDS, "power": AT.power}, "left_speed could be in rpm.* or cm/s"),
    ],
)
def test_what_could_be_one_unit_or_another_is_asked_for(
    tmp_path: Path, columns: dict[str, np.ndarray], told: str
) -> None:
    made = {"time": AT.t, "left_speed": AT.left, "right_speed": AT.right, "gyro_z": AT.yaw_rate}
    pd.DataFrame({**made, **columns}).to_csv(tmp_path / "log.csv", index=False)
    with pytest.raises(DriveLogError, match=told):
        start(tmp_path / "log.csv", MEASURES)


def written(folder: Path, name: str = "log.csv", **columns: object) -> Path:
    made = {"time": AT.t, "left_speed": AT.left, "right_speed": AT.right} | columns
    pd.DataFrame(made).to_csv(folder / name, index=False)
    return folder / name


HALF = {"volts": AT.volts, "main_battery_current": 0.5 * AT.amps,
        "aux_battery_current": 0.5 * AT.amps}  # fmt: skip


def test_two_batteries_are_not_one(tmp_path: Path) -> None:
    with pytest.raises(DriveLogError, match=r"main_battery_current\+aux_battery_current"):
        start(written(tmp_path, gyro_z=AT.yaw_rate, **HALF), MEASURES)


def test_a_power_without_a_wheel_is_wrong(tmp_path: Path) -> None:
    torque = {f"{place}_{side}_effort": 0.5 * power / np.where(speed == 0.0, 1.0, speed)
              for place in ("front", "rear")
              for side, speed, power in (("left", AT.left, AT.p_left),
                                         ("right", AT.right, AT.p_right))}  # fmt: skip
    file = written(tmp_path, gyro_z=AT.yaw_rate, **torque)
    one = "p_left=front_left_effort*left_speed,p_right=front_right_effort*right_speed"
    made = start(file, Given(**ROVER.measures, columns=one))
    told = [check for check in made.checks if not check.ok and "rear_left_effort" in check.what]
    assert not made.sound and len(told) == 1
    whole = "{0}=(front_{1}_effort+rear_{1}_effort)*{1}_speed"
    assert whole.format("p_left", "left") in told[0].remedy
    both = ",".join(whole.format(f"p_{side}", side) for side in ("left", "right"))
    assert start(file, Given(**ROVER.measures, columns=both)).sound


@pytest.mark.parametrize("compass", [False, True])
def test_east_and_north_with_a_heading_are_a_pose(tmp_path: Path, compass: bool) -> None:
    """USER: ``odom_east_m, odom_north_m, heading_deg``; the wheel radius comes from it."""
    at = AT.log.channels
    heading = np.degrees(at["yaw"])
    file = written(
        tmp_path, left_speed=AT.left / 0.15, right_speed=AT.right / 0.15, power=AT.power,
        odom_east_m=at["x"], odom_north_m=at["y"],
        heading_deg=(90.0 - heading if compass else heading) % 360.0,
    )  # fmt: skip
    columns = "v_left=left_speed[rad/s*0.15],v_right=right_speed[rad/s*0.15]"
    made = start(file, Given(**ROVER.measures, columns=columns))
    assert made.sound, made.checks
    log = read_log(file, dict(made.project.columns))
    rate = np.gradient(np.unwrap(log.channel("yaw")), log.t)
    assert np.corrcoef(rate, log.channel("v_right") - log.channel("v_left"))[0, 1] > 0.9
    assert not any("pose" in warning for warning in log.warnings)


def test_an_orientation_is_a_heading(tmp_path: Path) -> None:
    half = 0.5 * AT.log.channels["yaw"]
    file = written(tmp_path, power=AT.power, qx=0.0, qy=0.0, qz=np.sin(half), qw=np.cos(half))
    columns = start(file, MEASURES).project.columns
    log = read_log(file, dict(columns))
    np.testing.assert_allclose(np.unwrap(log.channel("yaw")), np.unwrap(2.0 * half), atol=1e-9)


def test_a_clock_that_is_an_hour_off_is_named_and_shifted(tmp_path: Path) -> None:
    hours = np.arange(0.0, 9000.0, 2.0)
    phase = np.cumsum(np.random.default_rng(3).uniform(0.1, 0.3, len(hours)))
    speed = np.where(np.sin(phase) > 0.0, 0.6, 0.0)
    frame = {"time": 1.7e9 + hours, "left_speed": speed, "right_speed": speed}
    pd.DataFrame(frame).to_csv(tmp_path / "wheels.csv", index=False)
    battery = {"time": 1.7e9 + hours + 3600.0, "power": 100.0 * speed + 5.0}
    pd.DataFrame(battery).to_csv(tmp_path / "battery.csv", index=False)
    path = f"{tmp_path / 'wheels.csv'}+{tmp_path / 'battery.csv'}"
    (wrong,) = [check for check in start(path, MEASURES).checks if not check.ok]
    assert "clock of the power is 1 h ahead" in wrong.what and "@-1h" in wrong.remedy
    assert start(f"{path}@-1h", MEASURES).sound


@pytest.mark.parametrize(("step", "unit"), [(5.0, "s"), (5e-3, "ms")])
def test_rows_seconds_apart_are_told_from_milliseconds(
    tmp_path: Path, step: float, unit: str
) -> None:
    t = np.arange(0.0, 600.0 if unit == "s" else 30.0, step)
    speed = 0.4 * (1 + np.sign(np.sin(t / 40.0))) if unit == "s" else 0.8 * np.sin(t / 3.0) ** 2
    clock = t if unit == "s" else 1e3 * t
    frame = {"clock": clock, "left_speed": speed, "right_speed": speed, "power": 90 * speed}
    pd.DataFrame(frame).to_csv(tmp_path / "log.csv", index=False)
    assert start(tmp_path / "log.csv", MEASURES).project.columns["t"].unit in (unit, "")
    log = read_log(
        tmp_path / "log.csv", dict(start(tmp_path / "log.csv", MEASURES).project.columns)
    )
    assert np.median(np.diff(log.t)) == pytest.approx(step)


def test_several_drives_make_one_project(tmp_path: Path, run: Run) -> None:
    extra = {"power": AT.power, "gyro_z": AT.yaw_rate}
    first, second = (written(tmp_path, name, **extra) for name in ("a.csv", "b.csv"))
    third = written(tmp_path, "c.csv", power=-AT.power, gyro_z=AT.yaw_rate)
    options = ("--track", 0.45, "--wheelbase", 0.5, "--mass", 30, "--out", tmp_path / "p.yaml")
    told = run("start", first, second, *options)
    assert told.code == 0 and "holds the same readings" in told.out
    wanted = f"next: energyplan diagnose {first} {second} --project {tmp_path / 'p.yaml'}"
    assert f"{wanted} --out model.yaml" in told.out
    told = run("start", first, third, *options)
    assert told.code == 2 and "c.csv" in told.err and "wrong sign" in told.err


def test_a_history_of_tasks_tells_resistance_and_friction(tmp_path: Path, run: Run) -> None:
    noise = np.random.default_rng(2)
    distance, turning = noise.uniform(20, 90, 50), noise.uniform(1, 20, 50)
    duration = distance / 0.7 + noise.uniform(10, 400, 50)
    vehicle = ROVER.vehicle
    joules = ROVER.K * (2 * distance + (vehicle.icr.left + vehicle.icr.right) * turning)
    joules = joules + ROVER.mu * vehicle.slip_moment * turning + 15.0 * duration
    made = {"distance_m": distance, "turning_deg": np.degrees(turning), "duration_min":
            duration / 60.0, "energy_Wh": joules / 3600.0 * noise.normal(1, 0.01, 50)}  # fmt: skip
    pd.DataFrame(made).to_csv(tmp_path / "tasks.csv", index=False)
    found = identify_tasks(tasks_of(read_table(tmp_path / "tasks.csv", DriveLogError)), vehicle)
    truth = [ROVER.K, ROVER.mu, 15.0]
    assert np.all(np.abs(found.model.coefficients - truth) < 4 * found.errors)
    np.testing.assert_allclose(found.model.coefficients, truth, rtol=0.1)
    with pytest.raises(DriveLogError, match="a row is a task"):
        start(tmp_path / "tasks.csv", MEASURES)


@pytest.mark.parametrize(
    ("name", "text", "found"),
    [
        ("robot.yaml", "serial_number: j100-0001\nplatform: {}\n", {"like": "jackal"}),
        ("base.yaml", "c:\n  ros__parameters: {wheel_separation: 0.5, wheel_radius: 0.1}\n",
         {"track": 0.5, "wheel_radius": 0.1}),
        ("r.urdf", '<robot><link name="w"><inertial><mass value="9"/></inertial><visual><geometry>'
         '<cylinder radius="0.1"/></geometry></visual></link><joint name="left_wheel" type='
         '"continuous"><origin xyz="0.2 0.25 0"/><child link="w"/></joint><joint name="right_wheel"'
         ' type="continuous"><origin xyz="-0.2 -0.25 0"/></joint></robot>',
         {"mass": 9.0, "wheelbase": 0.4, "track": 0.5, "wheel_radius": 0.1}),
    ],
)  # fmt: skip
def test_files_of_other_tools_tell_the_robot(
    tmp_path: Path, name: str, text: str, found: dict[str, object]
) -> None:
    (tmp_path / name).write_text(text)
    told = read_like(str(tmp_path / name))
    assert {key: getattr(one, "name", one) for key, one in told.items()} == found


def test_a_remedy_is_what_mends_the_log(tmp_path: Path) -> None:
    """Of a mean of wheels, it keeps the mean; what does not help is not offered."""
    wheels = {f"{side}{k}": 3.6 * speed for k in "ab"
              for side, speed in (("l", AT.left), ("r", AT.right))}  # fmt: skip
    at = AT.log.channels
    file = written(tmp_path, power=AT.power, gyro_z=AT.yaw_rate, x=at["x"], y=at["y"], **wheels)
    both = "v_left=la+lb[*0.5],v_right=ra+rb[*0.5]"
    made = start(file, Given(**ROVER.measures, columns=both))
    (remedy,) = {check.remedy for check in made.checks if check.remedy}
    said = re.findall(r"map ([^;]*km/h[^;]*)", remedy)
    assert said, remedy
    again = start(file, Given(**ROVER.measures, columns=said[0]))
    assert again.sound
    log = read_log(file, dict(again.project.columns))
    np.testing.assert_allclose(log.channel("v_left"), AT.left, atol=1e-9)


@pytest.mark.parametrize("kind", ["csv", "bag", "command"])
def test_a_file_is_read_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str, run: Run
) -> None:
    """Also where a side is turned round, and where a second drive is held against the first."""
    count = Counter()
    read = np.loadtxt

    def counted(*args: object, **options: object) -> object:
        count["csv"] += 1
        return read(*args, **options)

    monkeypatch.setattr(np, "loadtxt", counted)
    if kind == "csv":
        extra = {"power": AT.power, "gyro_z": AT.yaw_rate}
        files = [written(tmp_path, "a.csv", **extra | {"left_speed": -AT.left}),
                 written(tmp_path, "b.csv", **extra | {"left_speed": -AT.left})]  # fmt: skip
        made = start_all(files, MEASURES)
        assert any("opposite sign" in note for note in made.notes)
        assert count["csv"] == 2
    elif kind == "command":  # by its distance this could be a history of tasks
        log = AT.house().assign(distance=np.cumsum(AT.left))
        log.to_csv(tmp_path / "a.csv", index=False)
        answer = run("identify", tmp_path / "a.csv", "--vehicle", "husky_a200")
        assert (answer.code, count["csv"]) == (0, 1), answer.err
    else:
        pytest.importorskip("rosbags")
        from rosbags import rosbag2

        messages = rosbag2.Reader.messages

        def passed(*args: object, **options: object) -> Iterator[object]:
            for one in messages(*args, **options):
                count[one[0].topic] += 1
                yield one

        monkeypatch.setattr(rosbag2.Reader, "messages", passed)
        log = simulate.drive(MODEL, "spiral", rate=10.0)
        start(bag(tmp_path, log), Given(**ROVER.measures | {"wheel_radius": 0.1}))
        assert max(count.values()) == len(log) + 1  # a look at the first tells images


def test_ten_thousand_readings_a_second_tell_as_much_as_ten(tmp_path: Path) -> None:
    """Of a motor controller; the checks compare means of them."""
    t = np.arange(0.0, AT.t[-1], 1e-3)
    noise = np.random.default_rng(4)
    fine = {name: np.interp(t, AT.t, values) for name, values in AT.log.channels.items()}
    frame = {"time": t, "power": np.interp(t, AT.t, AT.power),
             "gyro_z": np.degrees(fine["yaw_rate"]) + noise.normal(0, 1, len(t)),
             **{f"{side}_speed": 3.6 * fine[f"v_{side}"] + noise.normal(0, 0.05, len(t))
                for side in ("left", "right")}}  # fmt: skip
    pd.DataFrame(frame).to_csv(tmp_path / "fast.csv", index=False)
    made = start(tmp_path / "fast.csv", MEASURES)
    assert made.sound, made.checks
    units = {channel: one.unit for channel, one in made.project.columns.items()}
    assert (units["v_left"], units["yaw_rate"]) == ("km/h", "deg/s")
