"""Motors that each have a current and a voltage of their own: none serves for another."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from commands import Run

import energyplan as ep
from energyplan import simulate
from energyplan.errors import DriveLogError
from energyplan.io.bags import TopicMap, columns_of, topics_of
from energyplan.io.given import Given
from energyplan.io.logs import read_log
from energyplan.io.start import start
from energyplan.logs.tables import Recording

VEHICLE = ep.Vehicle.from_geometry(
    "four motors", mass=60.0, wheelbase=0.5, track=0.45, length=0.8, width=0.6
)
MODEL = ep.PowerModel.paper(VEHICLE, K=60.0, mu=0.6)
LOG = simulate.identification_drive(MODEL, power_noise=2.0, seed=1)
GIVEN = Given(track=0.45, wheelbase=0.5, mass=60.0, wheel_radius=0.1)
PLACES = ("fl", "fr", "rl", "rr")


def table(
    front: float = 20.0, rear: float = 12.0, current: str = "motor_{}_current",
    voltage: str = "motor_{}_voltage", places: tuple[str, ...] = PLACES,
) -> pd.DataFrame:  # fmt: skip
    """The front motors do 30 % of each side's work."""
    columns = {"t": LOG.t, "gyro_z": LOG.channel("yaw_rate")}
    for k, place in enumerate(places):
        side = ("left", "right")[k % 2]
        volts, share = ((front, 0.3), (rear, 0.7))[k // 2]
        columns[f"wheel_{place}_rpm"] = LOG.channel(f"v_{side}") / 0.1 * 30 / np.pi
        columns[current.format(place)] = share * LOG.channel(f"p_{side}") / volts
        columns[voltage.format(place)] = np.full(len(LOG.t), volts)
    return pd.DataFrame(columns)


def resistance(log: ep.DriveLog) -> float:
    return ep.identify(log, VEHICLE).model.coefficient("traction_resistance")


@pytest.mark.parametrize(
    "names", [("motor_{}_current", "motor_{}_voltage"), ("{}.amps", "{}.volts"),
              ("i_{}_A", "u_{}_V"), ("motor_{}_current_mA", "motor_{}_voltage_mV")],
)  # fmt: skip
def test_each_current_has_the_voltage_of_its_own_motor(
    tmp_path: Path, names: tuple[str, str]
) -> None:
    made = table(current=names[0], voltage=names[1])
    if names[0].endswith("mA"):
        made[[n for n in made if n[-2:] in ("mA", "mV")]] *= 1e3
    made.to_csv(tmp_path / "log.csv", index=False)
    result = start(tmp_path / "log.csv", GIVEN)
    assert result.sound
    assert not any("voltage" in note for note in result.notes)
    log = read_log(tmp_path / "log.csv", dict(result.project.columns))
    assert resistance(log) == pytest.approx(60.0, rel=0.01)


def test_a_project_and_a_mapping_hold_products(tmp_path: Path, run: Run) -> None:
    table().to_csv(tmp_path / "log.csv", index=False)
    project = tmp_path / "p.yaml"
    told = run("start", tmp_path / "log.csv", "--track", 0.45, "--wheelbase", 0.5, "--mass", 60,
               "--wheel-radius", 0.1, "--out", project)  # fmt: skip
    assert told.code == 0, told.err
    terms = run("identify", tmp_path / "log.csv", "--project", project, "--json").json["terms"]
    found = {one["name"]: one["value"] for one in terms}
    assert found["traction_resistance"] == pytest.approx(60.0, rel=0.01)
    log = ep.DriveLog.read(
        tmp_path / "log.csv",
        "v_left=wheel_fl_rpm[rpm*0.1],v_right=wheel_fr_rpm[rpm*0.1],yaw_rate=gyro_z,"
        "p_left=motor_fl_current*motor_fl_voltage + motor_rl_current * motor_rl_voltage,"
        "p_right=motor_fr_current*motor_fr_voltage + 0.5*motor_rr_current*motor_rr_voltage*2",
    )
    assert resistance(log) == pytest.approx(60.0, rel=0.01)


def test_currents_without_voltages_of_their_own_are_asked_about(tmp_path: Path) -> None:
    made = table(voltage="volts_{}").rename(
        columns={"volts_fl": "front_bus_voltage", "volts_rl": "rear_bus_voltage"}
    )
    made.drop(columns=["volts_fr", "volts_rr"]).to_csv(tmp_path / "log.csv", index=False)
    with pytest.raises(DriveLogError, match="voltages that differ") as error:
        start(tmp_path / "log.csv", GIVEN)
    assert "--columns 'p_left=motor_fl_current*front_bus_voltage" in str(error.value)


def test_one_bus_serves_all_motors(tmp_path: Path) -> None:
    table(24.0, 24.0).to_csv(tmp_path / "log.csv", index=False)
    result = start(tmp_path / "log.csv", GIVEN)
    log = read_log(tmp_path / "log.csv", dict(result.project.columns))
    assert resistance(log) == pytest.approx(60.0, rel=0.01)


def test_two_batteries_that_differ_each_have_their_voltage(tmp_path: Path) -> None:
    made = table().drop(columns=[f"motor_{p}_{q}" for p in PLACES for q in ("current", "voltage")])
    for k, (volts, share) in enumerate(((25.0, 0.4), (13.0, 0.6)), 1):
        made[f"battery_{k}_current"] = share * LOG.power / volts
        made[f"battery_{k}_voltage"] = np.full(len(LOG.t), volts)
    made.to_csv(tmp_path / "log.csv", index=False)
    result = start(tmp_path / "log.csv", GIVEN)
    log = read_log(tmp_path / "log.csv", dict(result.project.columns))
    assert resistance(log) == pytest.approx(60.0, rel=0.01)


def test_a_product_in_a_sum_is_no_factor_of_the_sum(tmp_path: Path) -> None:
    t = np.arange(60.0) / 10
    made = pd.DataFrame({"t": t, "v_left": np.sin(t), "v_right": np.cos(t), "a": 2.0 + np.sin(t),
                         "b": 5.0 + np.cos(t), "c": 3.0 + 0.0 * t})  # fmt: skip
    a, b = made["a"], made["b"]
    for text, power in (("a + b*c", a + 3 * b), ("(a+b)*c", 3 * (a + b)),
                        ("a*b - 0.5*c", a * b - 1.5)):  # fmt: skip
        log = ep.DriveLog.read(made, f"power={text}[W]")
        np.testing.assert_allclose(log.power, power)


def test_products_of_fields_of_topics() -> None:
    t = np.arange(50.0) / 10
    columns = {f"/motors.{name}": value + 0.0 * t for name, value in
               {"i1": 2.0, "v1": 20.0, "i2": 3.0, "v2": 12.0, "rate": 1.0}.items()}  # fmt: skip
    recording = Recording("bag", columns, times=dict.fromkeys(columns, t),
                          kinds={"/motors": "own_msgs/msg/Motors"})  # fmt: skip
    fields = {"power": "i1*v1 + i2*v2", "v_left": "rate", "v_right": "rate"}
    topics = TopicMap.model_validate({
        "channels": {name: {"topic": "motors", "field": field} for name, field in fields.items()}
    })  # fmt: skip
    columns = columns_of(recording, topics)
    np.testing.assert_allclose(recording.series(columns["power"]).values, 76.0)
    again = columns_of(recording, topics_of(recording, columns, "bag"))
    np.testing.assert_allclose(recording.series(again["power"]).values, 76.0)


@pytest.mark.parametrize("tag", ["r1", "l2", "R2"])
def test_the_tag_of_a_robot_is_no_side(tmp_path: Path, tag: str) -> None:
    volts = 24.0
    made = {"t": LOG.t}
    for side in ("left", "right"):
        made[f"wheel.{tag}.{side}_rpm"] = LOG.channel(f"v_{side}") / 0.1 * 30 / np.pi
    made |= {f"battery.{tag}.voltage": np.full(len(LOG.t), volts),
             f"battery.{tag}.current": LOG.power / volts,
             f"imu.{tag}.gyro_z": LOG.channel("yaw_rate")}  # fmt: skip
    pd.DataFrame(made).to_csv(tmp_path / "log.csv", index=False)
    columns = start(tmp_path / "log.csv", GIVEN).project.columns
    assert columns["voltage"].field == f"battery.{tag}.voltage"
    assert columns["v_left"].field == f"wheel.{tag}.left_rpm"
    assert columns["yaw_rate"].field == f"imu.{tag}.gyro_z"


def test_numbered_motors_of_both_sides_are_sides(tmp_path: Path) -> None:
    made = table(places=("l1", "r1", "l2", "r2"))
    made.to_csv(tmp_path / "log.csv", index=False)
    result = start(tmp_path / "log.csv", GIVEN)
    assert result.project.columns["v_left"].names == ("wheel_l1_rpm", "wheel_l2_rpm")
    log = read_log(tmp_path / "log.csv", dict(result.project.columns))
    assert resistance(log) == pytest.approx(60.0, rel=0.01)
    alone = made[["t", "wheel_l1_rpm", "wheel_r2_rpm", "gyro_z", "motor_l1_current"]]
    alone.to_csv(tmp_path / "alone.csv", index=False)
    with pytest.raises(DriveLogError, match="nobody but you knows which side"):
        start(tmp_path / "alone.csv", GIVEN)
