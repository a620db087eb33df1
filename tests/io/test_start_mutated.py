"""A sound log under other names, in other units and orders: right, asked about or refused.

Never is a project written whose resistance is off by more than a twentieth.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from foreign_logs import EPOCH, ROVER, At, drive

import energyplan as ep
from energyplan.errors import EnergyPlanError
from energyplan.io.given import Given
from energyplan.io.logs import read_log
from energyplan.io.start import start

AT = At(drive(ROVER), ROVER)
DEGREE, RPM = 180 / np.pi, 30 / np.pi
SIDES = [("left", "right"), ("l", "r"), ("port", "starboard"), ("L", "R"), ("lhs", "rhs"),
         ("links", "rechts"), ("m1", "m2"), ("front_left", "front_right")]  # fmt: skip
SPEEDS = ["{}_speed", "v_{}", "wheel_{}", "{}_wheel_velocity", "motor_{}_vel", "{}.speed",
          "speed{}", "track_{}", "{}Encoder", "{}_motor_speed", "{}"]  # fmt: skip
RATES = {  # how speeds are written: unit, factor; of wheels by their radius
    "m/s": 1.0, "mm/s": 1e3, "cm/s": 1e2, "km/h": 3.6, "mph": 1 / 0.44704, "ft/s": 1 / 0.3048,
    "rad/s": 1 / ROVER.radius, "rpm": RPM / ROVER.radius, "deg/s": DEGREE / ROVER.radius,
    "rev/s": 0.5 / np.pi / ROVER.radius, "dm/s": 10.0, "m/min": 60.0,
}  # fmt: skip
TURNS = {"rad/s": 1.0, "deg/s": DEGREE, "mrad/s": 1e3, "mdps": 1e3 * DEGREE, "rpm": RPM}
POWERS = {"W": 1.0, "kW": 1e-3, "mW": 1e3, "hp": 1 / 745.69987}
ENERGIES = {"Wh": 1 / 3600.0, "J": 1.0, "kJ": 1e-3, "mWh": 1 / 3.6, "Ws": 1.0}
CHARGES = {"Ah": 1 / 3600.0, "mAh": 1 / 3.6, "C": 1.0, "As": 1.0}
VOLTS = {"V": 1.0, "mV": 1e3, "dV": 10.0, "cV": 100.0}
AMPS = {"A": 1.0, "mA": 1e3, "cA": 100.0, "dA": 10.0}
CLOCKS = {"s": 1.0, "ms": 1e3, "us": 1e6, "ns": 1e9}
WRITTEN = ["{} [{}]", "{}_{}", "{} ({})", "{}"]  # how a name bears its unit; the last hides it


class Mutation:
    """Draws how a sound log is written."""

    def __init__(self, seed: int) -> None:
        self.random = np.random.default_rng(seed)

    def one(self, among: Any) -> Any:
        """Draw one of several."""
        several = [*among]
        return several[self.random.integers(len(several))]

    def named(self, name: str, unit: str) -> str:
        """Write a name with its unit, in a usual way or not at all."""
        form = self.one(WRITTEN)
        stated = unit.replace("/", "_") if form == "{}_{}" else unit
        return str(form.format(name, stated))

    def speeds(self, shown: bool) -> dict[str, np.ndarray]:
        """Write the speeds of both sides."""
        left, right = self.one(SIDES)
        name, unit = self.one(SPEEDS), self.one(RATES)
        form = self.one(WRITTEN)
        if form == "{}":  # what no name says, and no reading shows, is in the unit of the library
            unit = self.one(["m/s", "mm/s", "rpm", "rad/s"]) if shown else "m/s"
        stated = unit.replace("/", "_") if form == "{}_{}" else unit
        return {form.format(name.format(side), stated): RATES[unit] * v
                for side, v in ((left, AT.left), (right, AT.right))}  # fmt: skip

    def drawn(self) -> dict[str, np.ndarray]:
        """Write what is drawn: a power, its sides, a counter, or voltage and current."""
        kind = self.one(["power", "sides", "energy", "charge", "electric", "electric", "parts",
                         "beside"])  # fmt: skip
        prefix = self.one(["", "battery_", "total_", "bus_", "pack_", "main_", "input_"])
        if kind == "power":
            unit = self.one(POWERS)
            name = f"{prefix}power [hp]" if unit == "hp" else self.named(f"{prefix}power", unit)
            return {name: POWERS[unit] * AT.power}
        if kind == "sides":
            unit, (left, right) = self.one(["W", "kW", "mW"]), self.one(SIDES)
            return {self.named(f"{side}_power", unit): POWERS[unit] * p
                    for side, p in ((left, AT.p_left), (right, AT.p_right))}  # fmt: skip
        if kind == "energy":
            unit = self.one(ENERGIES)
            return {self.named(f"{prefix}energy", unit): ENERGIES[unit] * AT.summed(AT.power)}
        volts, amps = self.one(VOLTS), self.one(AMPS)
        # Controllers send tenths and hundredths as whole numbers.
        volt, amp = (
            np.round(sizes[unit] * values) if unit[0] in "cd" else sizes[unit] * values
            for sizes, unit, values in ((VOLTS, volts, AT.volts), (AMPS, amps, AT.amps))
        )
        voltage = {self.named(f"{prefix}voltage", volts): volt}
        if kind == "charge":
            unit = self.one(CHARGES)
            used = CHARGES[unit] * AT.summed(AT.amps)
            return voltage | {self.named(f"{prefix}charge", unit): used}
        current = self.named(f"{prefix}current", amps)
        if kind == "parts":  # of two batteries, axles or sources
            first, second = self.one(
                [("front", "rear"), ("a", "b"), ("main", "aux"), ("1", "2"), ("solar", "battery"),
                 ("upper", "lower"), ("drive", "arm")])  # fmt: skip
            share = self.one([0.5, 0.7])
            return voltage | {f"{first}_current": share * AT.amps,
                              f"{second}_current": (1.0 - share) * AT.amps}  # fmt: skip
        if kind == "beside":
            return voltage | {current: amp} | {
                "voltage_5v": 5.0 + 0.0 * AT.t, "cpu_current": 0.4 + 0.0 * AT.t,
                "motor_temp": 30.0 + 0.01 * AT.t, "cmd_left": 1.1 * AT.left,
                "cmd_right": 1.1 * AT.right, "battery_pct": 90.0 - 0.01 * AT.t}  # fmt: skip
        return voltage | {current: amp}

    def log(self) -> pd.DataFrame:
        """Write a sound log, its columns in any order."""
        clock, turn = self.one(CLOCKS), self.one(TURNS)
        since = self.one([0.0, EPOCH])
        columns = {self.named(self.one(["time", "timestamp", "t", "stamp"]), clock):
                   np.round(CLOCKS[clock] * (since + AT.t), 6)}  # fmt: skip
        turning, placed = self.random.random() < 0.7, self.random.random() < 0.3
        columns |= self.speeds(turning or placed) | self.drawn()
        if turning:
            rate = TURNS[turn] * AT.yaw_rate
            columns[self.named(self.one(["gyro_z", "yaw_rate", "imu_wz"]), turn)] = rate
        if placed:
            columns |= {"pose_x": AT.log.channel("x"), "pose_y": AT.log.channel("y"),
                        "heading": AT.yaw}  # fmt: skip
        names = [*columns]
        self.random.shuffle(names)
        return pd.DataFrame({name: columns[name] for name in names})


def outcome(folder: Path, seed: int) -> float | None:
    """Start from a mutated log; return the resistance over the truth; None if none is written."""
    file = folder / "log.csv"
    log = Mutation(seed).log()
    log.to_csv(file, index=False)
    try:
        made = start(file, Given(**ROVER.measures))
    except EnergyPlanError as error:
        assert str(error).strip()  # says something
        return None
    if not made.sound:
        return None
    try:
        found = ep.identify(read_log(file, dict(made.project.columns)), made.project.vehicle)
    except EnergyPlanError:
        return None
    return float(found.model.coefficient("traction_resistance")) / ROVER.K


def check(folder: Path, seeds: range) -> None:
    """No project may be wrong; and most sound logs must be read."""
    found = {seed: outcome(folder, seed) for seed in seeds}
    wrong = {seed: round(k, 3) for seed, k in found.items() if k is not None and abs(k - 1) > 0.05}
    assert not wrong, {seed: [*Mutation(seed).log()] for seed in wrong} | wrong
    assert sum(k is not None for k in found.values()) > 0.25 * len(found)


def test_no_mutated_log_makes_a_wrong_project(tmp_path: Path) -> None:
    check(tmp_path, range(20))


@pytest.mark.nightly
def test_none_of_many_mutated_logs_makes_a_wrong_project(tmp_path: Path) -> None:
    check(tmp_path, range(100, 300))
