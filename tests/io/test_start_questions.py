"""What a log leaves open is a question, whose every answer is read as it is printed."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from foreign_logs import ROVER, At, drive

import energyplan as ep
from energyplan.errors import DriveLogError
from energyplan.io.given import Given
from energyplan.io.logs import read_log
from energyplan.io.start import Start, start

AT = At(drive(ROVER), ROVER)
SPEEDS = {"time": AT.t, "left_speed": AT.left, "right_speed": AT.right, "gyro_z": AT.yaw_rate}
UNKNOWN = {name: values for name, values in SPEEDS.items() if name != "gyro_z"}


def table(folder: Path, **columns: object) -> Path:
    """Write a log; its columns in the order in which they are named."""
    file = folder / "log.csv"
    pd.DataFrame(columns).to_csv(file, index=False)
    return file


def begun(file: Path, columns: str | None = None) -> Start:
    """Start from a log, with what is mapped by hand."""
    return start(file, Given(**ROVER.measures, columns=columns))


def resistance(file: Path, made: Start) -> float:
    """Return what is identified of a project's log, as a share of the truth."""
    log = read_log(file, dict(made.project.columns))
    found = ep.identify(log, ROVER.vehicle).model.coefficient("traction_resistance")
    return float(found) / ROVER.K


def answers(question: str) -> list[str]:
    """Return the mappings that a question offers."""
    return re.findall(r"(?:--columns|or) ['\"]([^'\"]+=[^'\"]+)['\"]", question)


def settled(file: Path, right: str, columns: str | None = None) -> str:
    """Ask; every answer must be read as it is printed, and the right one be right."""
    with pytest.raises(DriveLogError) as asked:
        begun(file, columns)
    offered = answers(str(asked.value))
    assert right in offered, str(asked.value)
    for one in offered:
        begun(file, one)  # asks no more
    made = begun(file, right)
    assert made.sound, made.checks
    assert resistance(file, made) == pytest.approx(1.0, rel=0.05)
    return str(asked.value)


HALF = 0.5 * AT.volts
LEFT, RIGHT = AT.p_left / AT.volts, AT.p_right / AT.volts
PANEL = 30.0 + 5.0 * np.sin(AT.t / 20.0)


@pytest.mark.parametrize(
    ("columns", "right"),
    [
        # two for one: in series, in parallel, on two axles
        ({"u_akku_vorn": HALF, "u_akku_hinten": 0.98 * HALF, "i_akku": AT.amps},
         "voltage=u_akku_vorn+u_akku_hinten"),
        ({"pack_a_volts": HALF, "pack_b_volts": HALF, "amps": AT.amps},
         "voltage=pack_a_volts+pack_b_volts"),
        ({"volts": AT.volts, "house_battery_amps": 0.4 * AT.amps,
          "drive_battery_amps": 0.6 * AT.amps},
         "current=house_battery_amps+drive_battery_amps"),
        ({"bogie_power": 0.5 * AT.power, "chassis_power": 0.5 * AT.power},
         "power=bogie_power+chassis_power"),
        # what feeds beside the battery
        ({"pv_power": PANEL, "pack_power": AT.power - PANEL, "drive_power": AT.power},
         "power=drive_power"),
        ({"volts": AT.volts, "mppt_amps": PANEL / AT.volts,
          "battery_amps": AT.amps - PANEL / AT.volts}, "current=battery_amps+mppt_amps"),
        # one of several wheels
        ({"volts": AT.volts, "fl_amps": LEFT / 2, "rl_amps": LEFT / 2, "fr_amps": RIGHT / 2},
         "p_left=(fl_amps + rl_amps) * volts,p_right=2*fr_amps*volts"),
        ({"front_left_power": AT.p_left / 2, "front_right_power": AT.p_right / 2},
         "p_left=2*front_left_power,p_right=2*front_right_power"),
    ],
)  # fmt: skip
def test_a_part_is_not_taken_for_the_whole(
    tmp_path: Path, columns: dict[str, np.ndarray], right: str
) -> None:
    settled(table(tmp_path, **SPEEDS, **columns), right)


@pytest.mark.parametrize(
    "columns",
    [
        {"battery_power": AT.power, "drive_power": 0.9 * AT.power},
        {"power": AT.power, "power_filtered": np.convolve(AT.power, np.ones(3) / 3, "same")},
        {"volts": AT.volts, "total_amps": AT.amps, "motor_amps": 3.0 * AT.amps},
        {"battery_volts": AT.volts, "logic_volts": 0.0 * AT.volts + 5.0, "battery_amps": AT.amps},
        {"supply_v": AT.volts, "supply_a": AT.amps},
        {"power_v": AT.volts, "power_a": AT.amps, "cpu_temp_c": 40.0},
    ],
)
def test_what_names_or_readings_decide_is_not_asked_for(
    tmp_path: Path, columns: dict[str, np.ndarray]
) -> None:
    file = table(tmp_path, **SPEEDS, **columns)
    made = begun(file)
    assert made.sound and resistance(file, made) == pytest.approx(1.0, rel=0.05)


@pytest.mark.parametrize(
    "columns",
    [
        {"volts": AT.volts, "q_As": AT.summed(AT.amps)},
        {"volts": AT.volts, "used charge [mC]": 1e3 * AT.summed(AT.amps)},
        {"volts": AT.volts, "charge_coulombs": AT.summed(AT.amps)},
        {"energy_kJ": 1e-3 * AT.summed(AT.power)},
        {"work_Ws": AT.summed(AT.power)},
        {"used_mWh": AT.summed(AT.power) / 3.6},
        {"supply_dV": 10.0 * AT.volts, "supply_cA": 100.0 * AT.amps},
    ],
)
def test_units_that_names_state_are_known(tmp_path: Path, columns: dict[str, np.ndarray]) -> None:
    file = table(tmp_path, **SPEEDS, **columns)
    made = begun(file)
    assert made.sound and resistance(file, made) == pytest.approx(1.0, rel=0.05)


@pytest.mark.parametrize(
    ("name", "size"),
    [("gz_mdps", 180_000 / np.pi), ("gyro_z_cdeg_s", 18_000 / np.pi), ("gyro_z [mrad/s]", 1e3),
     ("yaw_rate_deg_per_s", 180 / np.pi), ("gyro_z_rpm", 30 / np.pi)],
)  # fmt: skip
def test_turn_rates_are_read_by_their_unit(tmp_path: Path, name: str, size: float) -> None:
    file = table(tmp_path, **UNKNOWN, power=AT.power, **{name: size * AT.yaw_rate})
    made = begun(file)
    assert made.sound
    log = read_log(file, dict(made.project.columns))
    np.testing.assert_allclose(log.channel("yaw_rate"), AT.yaw_rate, atol=1e-9)


@pytest.mark.parametrize(
    ("size", "right"),
    [(180 / np.pi / ROVER.radius, "deg/s*0.11"), (1e3, "mm/s"), (1.0 / ROVER.radius, "rad/s*0.11")],
)
def test_a_unit_of_speeds_that_nothing_shows_is_asked_for(
    tmp_path: Path, size: float, right: str
) -> None:
    speeds = {f"{side}_motor_speed": size * v for side, v in
              (("left", AT.left), ("right", AT.right))}  # fmt: skip
    file = table(tmp_path, time=AT.t, power=AT.power, **speeds)
    settled(file, f"v_left=left_motor_speed[{right}],v_right=right_motor_speed[{right}]")


@pytest.mark.parametrize(
    ("column", "given", "right"),
    [("energy_J", "power=energy_J[Wh]", "power=energy_J[J*3600]"),
     ("power_kW", "power=power_kW[W]", "power=power_kW[kW*0.001]")],
)  # fmt: skip
def test_a_unit_by_hand_that_the_name_contradicts_is_asked_for(
    tmp_path: Path, column: str, given: str, right: str
) -> None:
    readings = AT.summed(AT.power) / 3600.0 if column == "energy_J" else AT.power
    settled(table(tmp_path, **SPEEDS, **{column: readings}), right, given)


@pytest.mark.parametrize(("unit", "size"), [("rpm*0.11", 30 / np.pi / 0.11), ("km/h", 3.6)])
def test_speeds_of_wheels_are_not_added(tmp_path: Path, unit: str, size: float) -> None:
    wheels = {f"{axle}{k}": size * v for axle in "ab"
              for k, v in enumerate((AT.left, AT.right), 1)}  # fmt: skip
    file = table(tmp_path, time=AT.t, power=AT.power, **wheels)
    mean = f"v_left=0.5*a1+0.5*b1[{unit}],v_right=0.5*a2+0.5*b2[{unit}]"
    settled(file, mean, f"v_left=a1+b1[{unit}],v_right=a2+b2[{unit}]")


def test_currents_of_the_sides_and_one_voltage_are_mapped_by_hand(tmp_path: Path) -> None:
    columns = {"pack": np.round(10 * AT.volts), "m1": np.round(100 * LEFT), "m2": 100 * RIGHT}
    file = table(tmp_path, **SPEEDS, **columns)
    made = begun(file, "current_left=m1[*0.01],current_right=m2[*0.01],voltage=pack[*0.1]")
    assert made.sound and resistance(file, made) == pytest.approx(1.0, rel=0.05)


def test_speeds_of_sides_that_no_name_tells_are_not_the_body_s(tmp_path: Path) -> None:
    columns = {"vasen_speed": AT.left, "oikea_speed": AT.right, "gyro_z": AT.yaw_rate}
    with pytest.raises(DriveLogError, match="nothing seems to be v_left or v_right"):
        begun(table(tmp_path, time=AT.t, power=AT.power, **columns))


def test_a_hint_speaks_of_what_the_log_holds(tmp_path: Path) -> None:
    file = table(tmp_path, time=AT.t, power=AT.power, left_ref=AT.left, right_ref=AT.right)
    with pytest.raises(DriveLogError) as asked:
        begun(file)
    assert "body's speed" not in str(asked.value)
    file = table(tmp_path, time=AT.t, power=AT.power, rail_12v=12.0, rail_5v=5.0)
    with pytest.raises(DriveLogError) as asked:
        begun(file)
    assert "which side each is" not in str(asked.value)


def test_pairs_of_a_name_and_a_value_are_no_table(tmp_path: Path) -> None:
    file = tmp_path / "monitor.txt"
    file.write_text("".join(f"U\t{24 + k}\nI\t{k}\nP\t{k}\n" for k in range(40)))
    with pytest.raises(DriveLogError, match="pairs of a name and a value"):
        begun(file)


def test_speeds_and_turn_rates_that_may_both_be_in_another_unit_are_asked_for(
    tmp_path: Path,
) -> None:
    rpm = 30 / np.pi
    columns = {"v_port": rpm / ROVER.radius * AT.left, "v_starboard": rpm / ROVER.radius * AT.right,
               "gyro_z": rpm * AT.yaw_rate}  # fmt: skip
    file = table(tmp_path, time=AT.t, power=AT.power, **columns)
    with pytest.raises(DriveLogError, match=r"v_port could be in .*rpm\*0.11"):
        begun(file)
