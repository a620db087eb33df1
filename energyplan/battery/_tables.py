"""Measured and published curves of cell chemistries, with their sources."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Chemistry:
    """What all batteries of one chemistry have in common."""

    name: str  # identifier
    soc: tuple[float, ...]  # states of charge at which the open-circuit voltage is known
    ocv: tuple[float, ...]  # open-circuit voltage of one unit at each [V]
    temperature: tuple[float, ...]  # temperatures at which the derating is known [degC]
    capacity_factor: tuple[float, ...]  # capacity at each, over that at 25 degC
    resistance_coefficient: float  # rise of the resistance with each kelvin below 25 degC [1/K]
    peukert: float  # Peukert exponent
    charge_efficiency: float  # charge stored over charge supplied
    cutoff_voltage: float  # voltage of one unit at which discharging must end [V]
    max_voltage: float  # voltage of one unit at which charging must end [V]
    voltage: float  # nominal voltage of one unit [V]
    typical_resistance: float  # of a unit, times its capacity [ohm Ah]; others have half or twice
    charge_rate: float  # largest charging current over the capacity [1/h]
    charging: tuple[float, float]  # least and greatest temperature at which it is charged [degC]
    aliases: tuple[str, ...]  # other names of it
    source: str  # where the voltages, the derating and the charging temperatures come from


LEAD_ACID = Chemistry(
    name="lead_acid",
    soc=(0.0, 0.25, 0.5, 0.75, 1.0),
    ocv=(11.89, 12.06, 12.24, 12.45, 12.65),
    temperature=(-20.0, -18.0, 0.0, 5.0, 10.0, 15.0, 20.0, 25.0, 30.0, 35.0, 40.0),
    capacity_factor=(0.40, 0.45, 0.84, 0.88, 0.90, 0.94, 0.99, 1.0, 1.03, 1.04, 1.05),
    resistance_coefficient=0.01, peukert=1.1, charge_efficiency=0.90, cutoff_voltage=10.5,
    max_voltage=14.4, voltage=12.0, typical_resistance=0.28, charge_rate=0.3,
    charging=(-15.0, 50.0),
    aliases=("lead-acid", "pb", "agm", "gel", "sla", "vrla"),
    source="12 V block at 26.7 degC, specific gravity 1.265 when full: Battery Council "
    "International. Derating from 0 degC: Discover Energy, discharge longer than 60 min. "
    "Below: X2Power's comparison of sealed lead-acid with lithium, 45 % at 0 degF; manuals of "
    "starter batteries agree (Westfalia, 40 % at -18 degC; 40 % at -20 degC). Peukert "
    "exponent: the middle of 1.05 to 1.15, usual for AGM blocks. Charging from -15 to "
    "50 degC: Union Battery on sealed lead-acid. The resistance coefficient is that of "
    "the acid's conductivity, a round figure.",
)  # fmt: skip
"""Valve-regulated lead-acid, one 12 V block of six cells."""

LITHIUM_ION = Chemistry(
    name="lithium_ion",
    soc=(0.0, 0.0151, 0.0452, 0.0955, 0.1508, 0.2915, 0.4573, 0.8342, 0.9497, 1.0),
    ocv=(2.5061, 2.8981, 3.1461, 3.3231, 3.4218, 3.5737, 3.7017, 4.0637, 4.1009, 4.1932),
    temperature=(-20.0, -10.0, 0.0, 25.0, 60.0),
    capacity_factor=(0.60, 0.75, 0.80, 1.0, 1.0),
    resistance_coefficient=0.015, peukert=1.0, charge_efficiency=0.99, cutoff_voltage=2.8,
    max_voltage=4.2, voltage=3.65, typical_resistance=0.10, charge_rate=0.5,
    charging=(0.0, 45.0),
    aliases=("li-ion", "lipo", "nmc", "nca"),
    source="Molicel INR-21700-P42A, mean of discharge and charge at C/32: Sunil, Pattipati, "
    "Balasingam, Piecewise Linear Approximation of Battery Open-Circuit Voltage "
    "Characteristics Using Dynamic Programming (IEEE TIM 2025). Derating: specification of "
    "Samsung SDI INR18650-15L, section 7.5, at a high current, so on the safe side. "
    "Charging from 0 to 45 degC: data sheet of the cell INR21700D40JH; Tenpower allows up to "
    "50 degC for its INR21700-40TG. "
    "Resistance coefficient: a round figure, to be replaced by that of the cell at hand.",
)  # fmt: skip
"""Lithium-ion with a nickel-rich cathode, one cell."""

LITHIUM_IRON_PHOSPHATE = Chemistry(
    name="lithium_iron_phosphate",
    soc=(0.0, 0.0033, 0.0117, 0.0267, 0.0534, 0.0885, 0.2972, 0.9833, 0.995, 1.0),
    ocv=(2.0102, 2.4177, 2.7405, 2.9299, 3.0872, 3.1942, 3.2772, 3.3511, 3.418, 3.5981),
    temperature=(-20.0, 0.0, 25.0, 40.0),
    capacity_factor=(0.70, 0.80, 1.0, 1.0),
    resistance_coefficient=0.02, peukert=1.0, charge_efficiency=0.99, cutoff_voltage=2.5,
    max_voltage=3.65, voltage=3.2, typical_resistance=0.06, charge_rate=0.5,
    charging=(0.0, 45.0),
    aliases=("lifepo4", "lfp", "life"),
    source="Lithium Werks APR-18650M1B, C/32: Sunil, Pattipati, Balasingam (IEEE TIM 2025). "
    "Derating: Canbat on its CLI100-12, 80 % at 0 degC and 70 % at -20 degC; X2Power tells "
    "70 % at 0 degF. Charging from 0 to 45 degC: Sunland on its IFR10440; Alpha Technologies "
    "allows up to 60 degC for its APL48-50LFP, and nothing below 0 degC either. Resistance "
    "coefficient: a round figure, to be replaced by that of the cell at hand.",
)  # fmt: skip
"""Lithium iron phosphate, one cell."""

CHEMISTRIES = {c.name: c for c in (LEAD_ACID, LITHIUM_ION, LITHIUM_IRON_PHOSPHATE)}
"""Chemistries by name."""


def chemistry_of(name: str) -> Chemistry | None:
    """Return the chemistry of a name or alias, however it is written; None where there is none."""

    def plain(text: str) -> str:
        return re.sub(r"[-_\s]", "", text).lower()

    named = (c for c in CHEMISTRIES.values() if plain(name) in map(plain, (c.name, *c.aliases)))
    return next(named, None)


PRESETS: dict[str, dict[str, Any]] = {
    "quadriga": {"chemistry": "lead_acid", "series": 3, "parallel": 2,
                 "unit_capacity": 18 * 3600.0, "unit_resistance": 0.015},
    "husky_a200": {"chemistry": "lead_acid", "series": 2, "parallel": 1,
                   "unit_capacity": 20 * 3600.0, "unit_resistance": 0.014},
    "jackal": {"chemistry": "lithium_ion", "series": 7, "parallel": 3,
               "unit_capacity": 3.6 * 3600.0, "unit_resistance": 0.020, "rated_time": 5 * 3600.0,
               "discharge_rate": 3.0, "charge_rate": 0.7},
}  # fmt: skip
"""Preset packs by name."""
