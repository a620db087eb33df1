"""The battery against closed forms, an independent equivalent-circuit solver and its own twin."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from refusals import check_refusal, lines

from energyplan import Battery
from energyplan.battery import BatteryRun
from energyplan.battery._kernel import discharge
from energyplan.errors import BatteryError


def plain(**changes: Any) -> Battery:
    """A battery of constant voltage and nothing else, but for the changes."""
    basic = Battery("plain", 3600.0, np.array([0.0, 1.0]), np.array([10.0, 10.0]), 0.0)
    return replace(basic, **changes)


def drive_profile(seconds: int, seed: int = 0) -> np.ndarray:
    """Power of a stop-and-go drive with some regeneration [W]."""
    rng = np.random.default_rng(seed)
    level = rng.choice([20.0, 150.0, 250.0, 450.0, -60.0], size=seconds // 10 + 1)
    return np.repeat(level, 10)[:seconds] + rng.normal(0, 10, seconds)


def test_ideal_battery_is_an_integral_of_the_power():
    t = np.arange(0.0, 601.0)
    power = np.where(t < 300, 36.0, -18.0)
    run = plain().simulate(t, power, soc=0.8)
    drawn = np.concatenate([[0.0], np.cumsum(power[:-1])])
    np.testing.assert_allclose(run.soc, 0.8 - drawn / 36000.0, atol=1e-12)
    np.testing.assert_allclose(run.voltage, 10.0)
    assert run.reason == "none"
    assert run.brown_out == np.inf


def test_series_resistance_draws_the_smaller_root():
    # 10 V through 0.1 ohm delivers 90 W at 10 A, where the terminals show 9 V.
    run = plain(resistance=0.1).simulate([0.0, 1.0], [90.0, 0.0])
    assert run.current[0] == pytest.approx(10.0)
    assert run.voltage[0] == pytest.approx(9.0)
    assert run.lost[-1] == pytest.approx(10.0)


def test_pair_relaxes_with_its_time_constant():
    pack = plain(capacity=3.6e8, pair_resistance=0.2, pair_time=30.0, resistance=0.05)
    t = np.arange(0.0, 400.0)
    run = pack.simulate(t, np.where(t < 300, 20.0, 0.0))
    after = run.voltage[300:]
    drop = 10.0 - after
    np.testing.assert_allclose(drop, drop[0] * np.exp(-(t[300:] - 300.0) / 30.0), rtol=1e-6)
    # Settled after ten time constants, the pair holds R1 I.
    assert drop[0] == pytest.approx(0.2 * run.current[299], rel=1e-3)


@pytest.mark.parametrize("name", ["quadriga", "husky_a200", "jackal"])
def test_energy_is_conserved(name):
    pack = replace(Battery.preset(name), peukert=1.0, charge_efficiency=1.0)
    t = np.arange(0.0, 1800.0)
    power = 0.2 * drive_profile(len(t))
    run = pack.simulate(t, power, soc=0.9)
    grid = np.linspace(run.soc_end, 0.9, 20001)
    chemical = pack.available_capacity * np.trapezoid(pack.ocv(grid), grid)
    assert run.braked[-1] == 0.0
    delivered = power[:-1].sum()
    # What is left in the RC pair's capacitor at the end is below a joule.
    assert chemical == pytest.approx(delivered + run.lost[-1], rel=2e-4)


def test_peukert_shortens_the_discharge_by_its_law():
    pack = plain(peukert=1.2, rated_current=1.0, capacity=3600.0)
    # Time to empty at current I is C / (I_r (I/I_r)^k).
    for current in (0.5, 2.0, 8.0):
        expected = 3600.0 / (current if current < 1 else current**1.2)
        run = pack.simulate(np.arange(0.0, 9000.0, 10.0), np.full(900, 10.0 * current))
        assert run.brown_out == pytest.approx(expected, rel=1e-6)
        assert run.reason == "charge"


@pytest.mark.parametrize(
    ("changes", "soc", "current", "soc_end", "braked"),
    [
        ({"charge_efficiency": 0.9}, 0.5, -5.0, 0.5 + 0.9 * 500 / 3600, 0.0),
        ({"max_charge_current": 2.0}, 0.5, -2.0, 0.5 + 200 / 3600, 3000.0),
        # a full battery brakes on resistors, and so does one that gets full
        ({}, 1.0, 0.0, 1.0, 5000.0),
        ({}, 1.0 - 200 / 3600, -5.0, 1.0, 3000.0),
    ],
)
def test_what_a_battery_cannot_store_is_braked(changes, soc, current, soc_end, braked):
    """Of 50 W for 100 s."""
    run = plain(**changes).simulate([0.0, 100.0], [-50.0, 0.0], soc=soc)
    assert run.current[0] == pytest.approx(current)
    assert run.soc_end == pytest.approx(soc_end)
    assert run.braked[-1] == pytest.approx(braked)


def test_the_greatest_voltage_limits_the_current_that_charges():
    run = plain(resistance=0.1, max_voltage=10.2).simulate([0.0, 10.0], [-50.0, 0.0], soc=0.5)
    assert (run.voltage[0], run.current[0]) == pytest.approx((10.2, -2.0))


@pytest.mark.parametrize("degrees", [-10.0, 0.0, 45.0, 50.0])
def test_charge_is_taken_within_the_temperatures_of_charging_alone(degrees: float) -> None:
    pack = plain(temperature=degrees, min_charge_temperature=0.0, max_charge_temperature=45.0)
    run = pack.simulate([0.0, 360.0, 720.0], [-10.0, 10.0, 0.0], soc=0.5)
    taken = 0.1 if degrees in (0.0, 45.0) else 0.0
    assert run.soc == pytest.approx([0.5, 0.5 + taken, 0.4 + taken])
    assert run.braked[-1] == pytest.approx(3600.0 - 36000.0 * taken)
    assert bool(pack.charging_fault) == (taken == 0.0)


WEAK = {"resistance": 0.1, "cutoff_voltage": 9.0}


@pytest.mark.parametrize(
    ("changes", "power", "reason", "instant"),
    [
        (WEAK, [20.0, 20.0, 95.0, 20.0], "voltage", 2.0),
        (WEAK, [20.0, 20.0, 89.0, 20.0], "none", np.inf),
        # no more than V^2 / 4 R = 250 W can be drawn at all
        ({"resistance": 0.1}, [249.0, 0.0], "none", np.inf),
        ({"resistance": 0.1}, [251.0, 0.0], "voltage", 0.0),
        ({"max_discharge_current": 5.0}, [49.0, 51.0, 0.0], "current", 1.0),
    ],
)
def test_a_brown_out_has_its_reason_and_instant(changes, power, reason, instant):
    t = np.arange(float(len(power)))
    run = plain(**changes).simulate(t, power)
    assert (run.reason, run.brown_out) == (reason, instant)
    assert np.all(run.current[t >= instant] == 0.0)


@pytest.mark.parametrize("power", [60.0, 300.0, 900.0, 2500.0])
def test_usable_energy_is_what_a_discharge_delivers(power):
    pack = replace(Battery.preset("quadriga"), cutoff_soc=0.1)
    for soc in (1.0, 0.6):
        run = pack.simulate(np.arange(0.0, 2e5, 30.0), np.full(6667, power), soc=soc)
        assert pack.usable_energy(power, soc) == pytest.approx(power * run.brown_out, rel=3e-3)


@pytest.mark.parametrize("words", ["24 V 20 Ah lead-acid", "7S6P 2.5 Ah li-ion, 0 degC"])
def test_the_charge_that_is_kept_ends_a_discharge(words):
    """Also of a small part of the charge, against a run in small steps from a state of rest."""
    pack = replace(Battery.of(words), pair_resistance=0.0)
    t = np.arange(0.0, 200.0, 0.01)
    run = pack.simulate(t, np.full(len(t), 216.0), soc=0.507)
    reached = float(np.interp(-0.5, -run.soc, t))
    delivered = float(pack.usable_energy(216.0, 0.507, kept=0.5))
    assert delivered == pytest.approx(216.0 * reached, rel=1e-4)
    assert float(pack.usable_energy(216.0, 0.5, kept=0.6)) == 0.0


def test_usable_energy_falls_with_power_cold_and_age():
    pack = Battery.preset("quadriga")
    energy = pack.usable_energy([50.0, 200.0, 800.0])
    assert np.all(np.diff(energy) < 0)
    assert replace(pack, temperature=0.0).usable_energy(200.0) < 0.85 * energy[1]
    assert replace(pack, health=0.7).usable_energy(200.0) < 0.70 * energy[1]
    assert pack.usable_energy(20e3) == 0.0
    assert pack.usable_energy(200.0, 0.0) == 0.0


def test_a_temperature_without_data_is_noted():
    pack = Battery.preset("quadriga")
    assert not replace(pack, temperature=-20.0).temperature_note
    note = replace(pack, temperature=-25.0).temperature_note
    assert "known from -20 to" in note
    assert "at -25 degC that of -20 degC is used" in note
    assert not plain().temperature_note
    assert "known at 25 degC only" in replace(plain(), temperature=5.0).temperature_note


def _thevenin(pack: Battery, t: np.ndarray, power: np.ndarray, soc: float) -> BatteryRun:
    """Run the same profile through the package `thevenin`."""
    thevenin = pytest.importorskip("thevenin")
    sim = thevenin.Simulation(
        {
            "num_RC_pairs": 1, "soc0": soc, "capacity": pack.available_capacity / 3600.0,
            "gamma": 0.0, "ce": pack.charge_efficiency, "mass": 1.0, "isothermal": True,
            "Cp": 1e3, "T_inf": 298.15, "h_therm": 0.0, "A_therm": 1.0,
            "ocv": lambda s: pack.ocv(s), "M_hyst": lambda s: 0.0,
            "R0": lambda s, T: pack.resistance, "R1": lambda s, T: pack.pair_resistance,
            "C1": lambda s, T: pack.pair_time / pack.pair_resistance,
        }
    )  # fmt: skip
    experiment = thevenin.Experiment()
    starts = np.concatenate([[0], np.flatnonzero(np.diff(power)) + 1, [len(t) - 1]])
    starts = np.unique(starts)
    for a, b in pairwise(starts):
        experiment.add_step("power_W", float(power[a]), t[a : b + 1] - t[a])
    solution = sim.run(experiment, t_shift=1e-6).vars
    # The solver gives both ends of a step; the later one is the state under the new power.
    at = np.searchsorted(solution["time_s"], t[:-1] + 5e-4) - 1
    zeros = np.zeros(len(at))
    return BatteryRun(
        t[:-1], solution["soc"][at], solution["voltage_V"][at], solution["current_A"][at],
        zeros, zeros, np.inf, "none",
    )  # fmt: skip


@pytest.mark.parametrize(("name", "scale"), [("quadriga", 1.0), ("jackal", 0.25)])
def test_agrees_with_an_established_equivalent_circuit_solver(name, scale):
    pack = replace(Battery.preset(name), peukert=1.0)
    t = np.arange(0.0, 1801.0, 10.0)
    rng = np.random.default_rng(3)
    power = scale * rng.choice([20.0, 150.0, 250.0, 450.0, -60.0], size=len(t))
    other = _thevenin(pack, t, power, 0.9)
    ours = pack.simulate(t, power, soc=0.9)
    assert ours.soc_end < 0.85
    # Targets: half a percent of charge, one percent of voltage. Reached: far less.
    assert np.max(np.abs(ours.soc[:-1] - other.soc)) < 1e-4
    assert np.max(np.abs(ours.voltage[:-1] / other.voltage - 1)) < 1e-3


@settings(max_examples=20, deadline=None)
@given(
    seed=st.integers(0, 2**31),
    soc=st.floats(0.02, 1.0),
    name=st.sampled_from(["quadriga", "jackal"]),
    gap=st.sampled_from([0.1, 1.0, 37.0]),
)
def test_kernel_equals_its_plain_twin(seed, soc, name, gap):
    pack = Battery.preset(name)
    t = gap * np.arange(60.0)
    power = drive_profile(60, seed)
    outs = [np.empty((5, 60)), np.empty((5, 60))]
    results = [
        kernel(t, power, soc, 0.1, pack.soc_points, pack.ocv_points, pack.circuit(), out)
        for kernel, out in zip((discharge, discharge.py_func), outs, strict=True)
    ]
    assert results[0] == pytest.approx(results[1])
    np.testing.assert_allclose(outs[0], outs[1], rtol=1e-9, atol=1e-9)


def test_a_run_continues_where_the_last_one_ended():
    pack = Battery.preset("quadriga")
    t = np.arange(0.0, 601.0)
    power = drive_profile(len(t), seed=7)
    whole = pack.simulate(t, power, soc=0.7)
    first = pack.simulate(t[:301], power[:301], soc=0.7)
    second = pack.simulate(t[300:], power[300:], soc=first.soc_end, polarisation=first.polarisation)
    np.testing.assert_allclose(second.soc, whole.soc[300:], rtol=1e-12)
    np.testing.assert_allclose(second.voltage, whole.voltage[300:], rtol=1e-12)


@pytest.mark.parametrize("samples", [2, 20_000])
def test_rest_of_any_length_loses_what_the_pair_holds(samples: int) -> None:
    """A pair of R and C discharges itself: C u^2 / 2, with C = tau / R."""
    battery = Battery.preset("quadriga")
    held = 0.2
    t = np.linspace(0.0, 40.0 * battery.pair_time, samples)
    run = battery.simulate(t, np.zeros(samples), soc=0.5, polarisation=held)
    expected = 0.5 * battery.pair_time * held**2 / battery.circuit().pair_resistance
    assert run.lost[-1] == pytest.approx(expected, rel=1e-9)
    assert run.soc_end == 0.5


@pytest.mark.parametrize(
    ("words", "volts", "amp_hours", "ohms"),
    [
        ("24 V 20 Ah lead-acid", 2 * 12.65, 20.0, 2 * 0.28 / 20.0),
        ("24V 480Wh AGM", 2 * 12.65, 20.0, 2 * 0.28 / 20.0),
        ("LiFePO4 25.6 V, 100 Ah", 8 * 3.5981, 100.0, 8 * 0.06 / 100.0),
        ("7S4P 3 Ah li-ion", 7 * 4.1932, 12.0, 7 * 0.10 / 3.0 / 4),
        ("36 V 10000 mAh Li-Ion 80 mohm", 10 * 4.1932, 10.0, 0.080),
        ("7s4p 3Ah NMC 20 mohm", 7 * 4.1932, 12.0, 0.020 * 7 / 4),
    ],
)
def test_a_battery_in_words(words: str, volts: float, amp_hours: float, ohms: float) -> None:
    battery = Battery.of(words)
    assert battery.ocv_points[-1] == pytest.approx(volts)
    assert battery.capacity == pytest.approx(3600 * amp_hours)
    assert battery.resistance == pytest.approx(ohms)
    assert any("typical" in note for note in battery.notes) == ("mohm" not in words)


@pytest.mark.parametrize(
    ("label", "plain"),
    [
        ("36 V 10 Ah li-ion 10S3P", "36 V 10 Ah li-ion"),
        ("36 V 10 Ah 360 Wh li-ion 10S3P", "36 V 10 Ah li-ion"),
        ("10 Ah 365 Wh li-ion 10S3P", "36 V 10 Ah li-ion"),
        ("24 V 20 Ah lead-acid 2S2P", "24 V 20 Ah lead-acid"),
        ("12 V 20 Ah lead-acid 1S2P", "12 V 20 Ah lead-acid"),
        ("24 V 480 Wh li-ion 7S4P", "24 V 480 Wh li-ion"),
        ("480 Wh li-ion 7S4P", "24 V 480 Wh li-ion"),
        ("3.6 V 3 Ah li-ion 7S4P", "7S4P 3 Ah li-ion"),
        ("3.6 V 3 Ah 10.8 Wh li-ion 7S4P", "7S4P 3 Ah li-ion"),
        ("36 V 3.3 Ah 360 Wh li-ion 10S3P", "10S3P 3.3 Ah li-ion"),
        ("36 V 10 Ah li-ion 10S3P 80 mohm", "36 V 10 Ah li-ion 80 mohm"),
    ],
)
def test_values_of_the_pack_beside_its_counts_are_taken_once(label: str, plain: str) -> None:
    one, other = Battery.of(label), Battery.of(plain)
    assert one.capacity == pytest.approx(other.capacity)
    assert one.full_energy == pytest.approx(other.full_energy)
    assert one.resistance == pytest.approx(other.resistance)
    assert one.max_discharge_current == pytest.approx(other.max_discharge_current)


def test_an_energy_in_words_is_what_the_full_pack_holds() -> None:
    """Within what the mean voltage of a discharge differs from the nominal one."""
    for words in ("24 V 480 Wh li-ion 7S4P", "24 V 480 Wh li-ion", "25.6 V 480 Wh LiFePO4 8S2P"):
        assert Battery.of(words).full_energy / 3600 == pytest.approx(480, rel=0.03)
    assert Battery.of("36 V 10 Ah li-ion 10S3P").full_energy / 3600 == pytest.approx(360, rel=0.04)


def test_a_capacity_that_may_be_of_one_cell_is_noted() -> None:
    assert (
        "10 Ah is the capacity of the whole pack" in Battery.of("36 V 10 Ah li-ion 10S3P").notes[0]
    )
    sure = "36 V 10 Ah li-ion 10S1P", "36 V 10 Ah 360 Wh li-ion 10S3P", "10S3P 10 Ah li-ion"
    assert [note for words in sure for note in Battery.of(words).notes if "whole" in note] == []


def test_words_say_what_is_usable_how_healthy_and_how_cold() -> None:
    battery = Battery.of("24 V 20 Ah lead-acid usable 80 %, health 90 % at -5 degC")
    assert battery.cutoff_soc == pytest.approx(0.2)
    assert (battery.health, battery.temperature) == (0.9, -5.0)
    assert Battery.of("husky_a200") == Battery.preset("husky_a200")
    assert "7 units in series" in Battery.of("24 V 20 Ah li-ion 30 mohm").notes[0]


REFUSED = r"""
BatteryError: plain(capacity=-1.0) | capacity is -1.0; give 0.001 to 3.6e\+08 C
BatteryError: plain(capacity=np.nan) | capacity
BatteryError: plain(resistance=-0.1) | resistance
BatteryError: plain(peukert=0.9) | peukert is 0.9; give 1 to 2
BatteryError: plain(health=0.0) | health
BatteryError: plain(cutoff_soc=1.0) | cutoff_soc
BatteryError: plain(cutoff_voltage=11.0) | below the open-circuit voltage
BatteryError: plain(ocv_points=np.array([11.0, 10.0])) | must not descend
BatteryError: plain(soc_points=np.array([0.1, 1.0])) | ascend from 0 to 1
BatteryError: plain(derating_factor=np.array([1.0, 2.0])) | derating
BatteryError: plain(rated_current=0.0) | rated_current
BatteryError: plain(max_discharge_current=-np.inf) | max_discharge_current is -inf
BatteryError: plain(temperature=300.0) | temperature is 300.0; give -40 to 70 degC \(not kelvin
BatteryError: plain(min_charge_temperature=50.0, max_charge_temperature=45.0) | must be below
BatteryError: plain().simulate([0.0, 0.0], [1.0, 1.0]) | does not increase
BatteryError: plain().simulate([0.0, 1.0], [np.nan, 1.0]) | power is not finite at sample
BatteryError: plain().simulate([0.0, 1.0], [1.0, 1.0], soc=1.5) | soc is 1\.5
BatteryError: plain().usable_energy(60.0, 1.5) | soc must be a fraction
UnknownNameError: Battery.preset("none") | battery preset
# words: all that is missing is said at once
BatteryError: Battery.of("20 Ah") | (?=.*voltage)(?=.*chemistry).*24 V 20 Ah lead-acid
BatteryError: Battery.of("24 V li-ion") | its capacity
BatteryError: Battery.of("24 V 20 Ah unobtainium") | 'unobtainium' is no chemistry.*li-ion
BatteryError: Battery.of("30 V 20 Ah lead-acid") | 30 V is no multiple of the 12 V
BatteryError: Battery.of("24 V 0 Ah li-ion") | 0 Ah is not positive
BatteryError: Battery.of("36 V 10 Ah li-ion 7S3P") | 36 V and 10 Ah cannot be those of 7S3P, .*19.6
BatteryError: Battery.of("36 V 10 Ah 500 Wh li-ion 10S3P") | 500 Wh cannot be those of 10S3P
BatteryError: Battery.of("24 V 20 Ah lead-acid 12S1P") | cannot be those of 12S1P, .*126 to 173 V
BatteryError: Battery.of("2x20Ah 24 V lead-acid 2S2P") | both a number of batteries and counts
BatteryError: Battery.of("9" * 400 + "S1P 3 Ah li-ion") | is no chemistry
BatteryError: Battery.of("7S" + "9" * 400 + "P 3 Ah li-ion") | is no chemistry
BatteryError: Battery.of("9" * 5000 + "x20Ah 24 V li-ion") | is no chemistry
BatteryError: Battery.of("0S2P 3 Ah li-ion") | 0s2p is no pack
BatteryError: Battery.of("480 Wh li-ion") | (?=.*voltage).*capacity
BatteryError: Battery.of("12.8 V 20 Ah LiFePO4 -5 C") | '-5 c' may be .* temperature as -5 degC
BatteryError: Battery.of("12.8 V 20 Ah LiFePO4 300 degC") | temperature is 300.0.*not kelvin
BatteryError: Battery.of("nuclear") | unknown battery 'nuclear'.*husky_a200
"""


@pytest.mark.parametrize("case", lines(REFUSED))
def test_bad_input_is_refused(case: str) -> None:
    check_refusal(case, globals())


@pytest.mark.parametrize("wrong", [{"unit_capacity": 0.0}, {"parallel": 0}, {"series": 0}])
def test_a_pack_of_nothing_is_refused_before_its_resistance_is_estimated(
    wrong: dict[str, Any],
) -> None:
    values: dict[str, Any] = {"series": 2, "parallel": 1, "unit_capacity": 3600.0}
    with pytest.raises(BatteryError, match=r"give (1 or )?more"):
        Battery.from_units("a", "lead_acid", **values | wrong)
