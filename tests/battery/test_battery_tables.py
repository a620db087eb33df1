"""The ready-made chemistries and packs have the values that their sources print."""

from __future__ import annotations

from typing import Any

import pytest

from energyplan import Battery

UNITS: dict[str, dict[str, Any]] = {
    # Battery Council International, 12 V block at rest (densities 1.120 to 1.265)
    "lead_acid": {
        "ocv": {0.0: 11.89, 0.25: 12.06, 0.5: 12.24, 0.75: 12.45, 1.0: 12.65},
        # X2Power, 45 % at 0 degF; Westfalia, 40 % at -20 degC; Discover Energy above that
        "derating": {
            -20.0: 0.40, -18.0: 0.45, 0.0: 0.84, 5.0: 0.88, 10.0: 0.90, 15.0: 0.94,
            20.0: 0.99, 25.0: 1.0, 30.0: 1.03, 35.0: 1.04, 40.0: 1.05,
        },
        "resistance_coefficient": 0.01, "peukert": 1.1, "charge_efficiency": 0.90,
        "cutoff_voltage": 10.5, "max_voltage": 14.4, "resistance": 0.28,
        "max_charge_current": 0.3, "rated_current": 0.05, "words": "12 V 1 Ah AGM",
        # Union Battery on sealed lead-acid: charging from 5 to 122 degF
        "min_charge_temperature": -15.0, "max_charge_temperature": 50.0,
    },
    # Molicel INR-21700-P42A at C/32: Sunil, Pattipati, Balasingam, IEEE TIM 2025
    "lithium_ion": {
        "ocv": {
            0.0: 2.5061, 0.0151: 2.8981, 0.0452: 3.1461, 0.0955: 3.3231, 0.1508: 3.4218,
            0.2915: 3.5737, 0.4573: 3.7017, 0.8342: 4.0637, 0.9497: 4.1009, 1.0: 4.1932,
        },
        # Samsung SDI INR18650-15L, specification 3.21, section 7.5, and 4.2 V of section 7.1
        "derating": {-20.0: 0.60, -10.0: 0.75, 0.0: 0.80, 25.0: 1.0, 60.0: 1.0},
        "max_voltage": 4.2,
        "resistance_coefficient": 0.015, "peukert": 1.0, "charge_efficiency": 0.99,
        "cutoff_voltage": 2.8, "resistance": 0.10, "max_charge_current": 0.5,
        "rated_current": 0.05, "words": "3.65 V 1 Ah NMC",
        # data sheet of the cell INR21700D40JH
        "min_charge_temperature": 0.0, "max_charge_temperature": 45.0,
    },
    # Lithium Werks APR-18650M1B at C/32: the same paper
    "lithium_iron_phosphate": {
        "ocv": {
            0.0: 2.0102, 0.0033: 2.4177, 0.0117: 2.7405, 0.0267: 2.9299, 0.0534: 3.0872,
            0.0885: 3.1942, 0.2972: 3.2772, 0.9833: 3.3511, 0.995: 3.418, 1.0: 3.5981,
        },
        # Canbat CLI100-12: 80 Ah of 100 Ah at 0 degC, 70 Ah at -20 degC
        "derating": {-20.0: 0.70, 0.0: 0.80, 25.0: 1.0, 40.0: 1.0},
        "resistance_coefficient": 0.02, "peukert": 1.0, "charge_efficiency": 0.99,
        "cutoff_voltage": 2.5, "max_voltage": 3.65, "resistance": 0.06,
        "max_charge_current": 0.5, "rated_current": 0.05, "words": "3.2 V 1 Ah LFP",
        # Sunland IFR10440: 0.5 C from 15 to 45 degC, 0.2 C below, none below 0 degC
        "min_charge_temperature": 0.0, "max_charge_temperature": 45.0,
    },
}  # fmt: skip
"""Of one unit of 1 Ah; what has no source of its own is the round figure of the reference."""

PACKS = {
    # Morales et al. (2010): lead-acid; the 18 Ah of a block are assumed (docs/missions.md)
    "quadriga": ("lead_acid", 3, 36.0, 22.5, 20.0, 5.0, 0.3),
    # Clearpath, Husky A200 manual (2014), p. 19: sealed 24 V VRLA, 20 Ah
    "husky_a200": ("lead_acid", 2, 20.0, 28.0, 20.0, 5.0, 0.3),
    # Clearpath, Jackal data sheet: lithium-ion, 270 Wh (here 25.5 V and 10.8 Ah, 276 Wh)
    "jackal": ("lithium_ion", 7, 10.8, 140.0 / 3.0, 5.0, 3.0, 0.7),
}
"""Chemistry, units in series, capacity [Ah], resistance [mohm], rated time [h], rates [1/h]."""


@pytest.mark.parametrize("chemistry", UNITS)
def test_chemistries(chemistry: str) -> None:
    stated = dict(UNITS[chemistry])
    words = stated.pop("words")
    curve, derating = stated.pop("ocv"), stated.pop("derating")
    unit = Battery.from_units("unit", chemistry, series=1, parallel=1, unit_capacity=3600.0)
    assert dict(zip(unit.soc_points, unit.ocv_points, strict=True)) == curve
    assert dict(zip(unit.derating_temperature, unit.derating_factor, strict=True)) == derating
    assert {name: getattr(unit, name) for name in stated} == pytest.approx(stated)
    voltage, rest = words.split(" ", 1)
    for series in (1, 10):  # the nominal voltage of a unit
        pack = Battery.of(f"{series * float(voltage):g} {rest}")
        assert pack.ocv(1.0) == pytest.approx(series * curve[1.0])
        assert pack.max_voltage == pytest.approx(series * stated["max_voltage"])


@pytest.mark.parametrize("name", PACKS)
def test_packs(name: str) -> None:
    chemistry, series, capacity, resistance, hours, discharge, charge = PACKS[name]
    pack, unit = Battery.preset(name), UNITS[chemistry]
    assert pack.ocv(1.0) == pytest.approx(series * unit["ocv"][1.0])
    assert pack.cutoff_voltage == pytest.approx(series * unit["cutoff_voltage"])
    assert pack.capacity == pytest.approx(3600.0 * capacity)
    assert 1e3 * pack.resistance == pytest.approx(resistance)
    assert pack.rated_current == pytest.approx(capacity / hours)
    assert pack.max_discharge_current == pytest.approx(discharge * capacity)
    assert pack.max_charge_current == pytest.approx(charge * capacity)


def test_a_battery_that_holds_twice_as_much_has_twice_the_strings() -> None:
    one, two = (
        Battery.from_units("pack", "lead_acid", series=2, parallel=n, unit_capacity=7.2e4)
        for n in (1, 2)
    )
    grown = one.larger(one.full_energy)
    for name in ("capacity", "resistance", "pair_resistance", "rated_current", "max_voltage",
                 "max_discharge_current", "max_charge_current", "full_energy"):  # fmt: skip
        assert getattr(grown, name) == pytest.approx(getattr(two, name)), name
