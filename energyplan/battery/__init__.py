"""The battery: charge, voltage, what it can still deliver, and when it gives up."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Annotated, Any, ClassVar, Literal, NamedTuple, Protocol, runtime_checkable

import numpy as np
import pydantic
from numpy.typing import ArrayLike

from energyplan import html
from energyplan.battery._kernel import Circuit, discharge
from energyplan.battery._tables import CHEMISTRIES, Chemistry, chemistry_of
from energyplan.battery._tables import PRESETS as PRESETS
from energyplan.errors import BatteryError, UnknownNameError
from energyplan.path import FloatArray
from energyplan.records import (
    Amps,
    ByValue,
    Celsius,
    Coulombs,
    Fraction,
    Number,
    Numbers,
    Ohms,
    Time,
    Volts,
    Within,
    amount,
    amount_of,
    checked,
    numbers,
    record,
)

__all__ = ["Battery", "BatteryModel", "BatteryRun", "BrownOut"]

BrownOut = Literal["none", "voltage", "charge", "current"]


@dataclass(frozen=True)
class BatteryRun:
    """What a power profile does to a battery; after a brown-out it gives and takes nothing."""

    t: FloatArray  # time [s]
    soc: FloatArray  # state of charge at the beginning of each sample
    voltage: FloatArray  # terminal voltage there [V]
    current: FloatArray  # current there [A], positive when discharging
    lost: FloatArray  # energy that the resistances dissipated as heat since the start [J]
    braked: FloatArray  # energy returned that it could not take, left to brake resistors [J]
    brown_out: float  # instant at which the battery gave up [s]; infinite if it did not
    reason: BrownOut  # why: cut-off voltage under the load, empty, too much current
    polarisation: float = 0.0  # voltage of the RC pair at the end [V]

    @property
    def soc_end(self) -> float:
        """State of charge at the end."""
        return float(self.soc[-1])

    @property
    def peak_current(self) -> float:
        """Largest current that it delivers [A]; 0 where it delivers none."""
        return float(max(self.current.max(), 0.0))

    @property
    def peak_power(self) -> float:
        """Largest power that it delivers [W]; 0 where it delivers none."""
        return float(max((self.voltage * self.current).max(), 0.0))


@runtime_checkable
class BatteryModel(Protocol):
    """What a mission reads of a battery: `Battery` is one, and any class with these is another."""

    @property
    def cutoff_soc(self) -> float:
        """State of charge at which it is switched off, in [0, 1)."""

    @property
    def charge_efficiency(self) -> float:
        """Charge stored over charge supplied, in (0, 1]."""

    @property
    def full_energy(self) -> float:
        """Energy that it holds when full [J]."""

    def simulate(
        self, t: ArrayLike, power: ArrayLike, *, soc: float = 1.0, polarisation: float = 0.0
    ) -> BatteryRun:
        """Run a power profile [W] over times [s], both of shape (n,); see `Battery.simulate`."""

    def usable_energy(self, power: ArrayLike, soc: ArrayLike = 1.0) -> FloatArray:
        """Energy [J] that it delivers at constant power [W], shape (...), until it gives up."""

    def larger(self, energy: float) -> BatteryModel:
        """Return a battery of the same make that holds so much more energy [J] when full."""


_UNITS = {"chemistry": "", "series": "", "parallel": "", "unit_capacity": "charge",
          "unit_resistance": "resistance"}  # fmt: skip
"""Keys of a pack of equal units, and the kinds of their amounts."""

_REASONS: tuple[BrownOut, ...] = ("none", "voltage", "charge", "current")
_REFERENCE_TEMPERATURE = 25.0


PERCENT, KELVIN = "write a percentage with its sign, as 80 %", "not kelvin"
"""What a fraction and a temperature that are too large may be."""

Temperature = Annotated[Celsius, Within((-40, 70), (-30, 60), "degC", KELVIN)]
_Charging = Annotated[
    float, amount_of("temperature"), Within((-60, 100), (-30, 60), "degC", KELVIN, endless=True)
]
_Limit = Annotated[Amps, Within((1e-9, 1e6), (0, 2e3), "A", "not milliamperes", endless=True)]

EXAMPLE = "24 V 20 Ah lead-acid"  # a battery in words

_SYMBOLS = {
    "v": ("V", 1.0), "ah": ("Ah", 1.0), "mah": ("Ah", 1e-3), "wh": ("Wh", 1.0),
    "kwh": ("Wh", 1e3), "ohm": ("ohm", 1.0), "mohm": ("ohm", 1e-3), "degc": ("degC", 1.0),
}  # fmt: skip
_COUNTS = re.compile(r"\b(\d{1,6})\s*s(?:\s*(\d{1,6})\s*p)?\b")
_SEVERAL = re.compile(r"\b(\d{1,6})\s*[x\u00d7*]\s*(?=\d+(?:\.\d+)?\s*(m?ah|k?wh|v)(?![a-z]))")
"""So many of one battery, as in ``2x20Ah``."""
_SHARE = re.compile(r"\b(usable|health)\s*:?\s*(\d+(?:\.\d+)?)\s*%")
_CELSIUS = re.compile(r"([-+]?\d+(?:\.\d+)?)\s*[ck]\b")
_AMOUNT = re.compile(r"([-+]?\d+(?:\.\d+)?)\s*(mohm|ohm|mah|ah|kwh|wh|degc|v)(?![a-z])")


SAGS = {
    "voltage": "the voltage sags below cut-off",
    "current": "the battery would have to deliver more current than it may",
}
"""Brown-outs under a power that is too large, as sentences."""
BROWN_OUTS = {**SAGS, "charge": "it is empty"}
"""All brown-outs, as sentences."""
_AGREE = 0.15
"""How much an energy may differ from charge times voltage, whose values on labels are rounded."""


def _require(condition: bool, message: str) -> None:
    if not condition:
        raise BatteryError(message)


class _Words(NamedTuple):
    """What some words say about a battery."""

    given: dict[str, float]  # amounts in their units, shares as fractions
    counts: re.Match[str] | None  # cells in series and side by side
    several: re.Match[str] | None  # batteries side by side, of which an amount holds for one
    left: str  # the words that are none of these


def _read(words: str) -> _Words:
    """Return the amounts and the counts among the words for a battery."""
    rest = words.lower().replace("mω", "mohm").replace("ω", "ohm").replace("°c", "degc")
    rest = re.sub(r"(?<=\d),(?=\d{3}(?!\d))", "", rest).replace("(", " ").replace(")", " ")
    rest = re.sub(r"(?<=\d),(?=\d{1,2}\s*[a-z])", ".", rest)  # a decimal comma
    several = _SEVERAL.search(rest)
    rest = _SEVERAL.sub(" ", rest)
    if several and several[2] == "v":
        raise BatteryError(
            f"battery {words!r}: in series {several[1]} batteries add volts, side by side amp "
            f"hours; give the whole, as in {EXAMPLE!r}"
        )
    counts = _COUNTS.search(rest)
    rest = _COUNTS.sub(" ", rest)
    _require(
        not (several and counts),
        f"battery {words!r}: it has both a number of batteries and counts of cells; give the "
        f"whole, as in {EXAMPLE!r}",
    )
    if warm := _CELSIUS.search(rest):
        raise BatteryError(
            f"battery {words!r}: {warm[0]!r} may be a temperature or a rate; write a "
            f"temperature as {warm[1]} degC"
        )
    given = {name: float(value) / 100.0 for name, value in _SHARE.findall(rest)}
    rest = _SHARE.sub(" ", rest)
    for value, symbol in _AMOUNT.findall(rest):
        unit, factor = _SYMBOLS[symbol]
        given[unit] = float(value) * factor
    if several:
        key = "Wh" if several[2].endswith("wh") else "Ah"
        given[key] *= int(several[1])
    if {"Ah", "Wh"} <= given.keys():
        volts = given["Wh"] / given["Ah"]
        _require(
            counts is not None or abs(given.setdefault("V", volts) / volts - 1.0) < _AGREE,
            f"battery {words!r}: {given['Ah']:g} Ah and {given['Wh']:g} Wh make {volts:.3g} V; "
            "give two of the three",
        )
    left = " ".join(_AMOUNT.sub(" ", rest).replace(",", " ").replace(" at ", " ").split())
    _require(
        bool(counts or given),
        f"unknown battery {words!r}; give its voltage, capacity and chemistry, as in "
        f"{EXAMPLE!r} or '7S4P 3 Ah li-ion', or a preset: {', '.join(PRESETS)}",
    )
    return _Words(given, counts, several, left)


def _chemistry_in(words: str, read: _Words) -> Chemistry:
    """Return the chemistry among the words for a battery, which must lack nothing."""
    given, counts, _, left = read
    lacks = [] if counts or "V" in given else ["its voltage (24 V) or counts (7S4P)"]
    if not ("Ah" in given or ("Wh" in given and (counts or "V" in given))):
        lacks.append("its capacity (20 Ah)")
    names = ", ".join(c.aliases[0] for c in CHEMISTRIES.values())
    kind = chemistry_of(left)
    wrong = [] if kind or not left else [f"{left!r} is no chemistry; known are {names}"]
    if not left:
        lacks.append(f"its chemistry ({names})")
    wrong += [f"it lacks {' and '.join(lacks)}"] if lacks else []
    if kind is None or wrong:
        raise BatteryError(f"battery {words!r}: {'; '.join(wrong)}; write it as {EXAMPLE!r}")
    return kind


def _counted(
    words: str, given: Mapping[str, float], kind: Chemistry, series: int, parallel: int
) -> tuple[float, bool]:
    """Return a pack's capacity [Ah], and whether the one given beside its counts is the pack's."""
    volts, hours, energy = (given.get(unit) for unit in ("V", "Ah", "Wh"))
    nominal = series * kind.voltage
    # units in series of the voltage given, and how often the pack has the capacity and the energy
    readings = [(series, 1, 1), (series, parallel, 1), (1, parallel, series * parallel)]
    for in_series, strings, units in readings if volts or energy else readings[2:]:
        if volts and not kind.cutoff_voltage <= volts / in_series <= kind.max_voltage:
            continue
        capacity = (energy or 0.0) * units / nominal if hours is None else hours * strings
        if energy and abs(energy * units / (capacity * nominal) - 1.0) >= _AGREE:
            continue
        return capacity, in_series == series and strings == 1
    least, most = series * kind.cutoff_voltage, series * kind.max_voltage
    stated = " and ".join(f"{given[unit]:g} {unit}" for unit in ("V", "Ah", "Wh") if unit in given)
    raise BatteryError(
        f"battery {words!r}: {stated} cannot be those of {series}S{parallel}P, which has "
        f"{least:.3g} to {most:.3g} V, {nominal:.3g} V as a rule; give what the whole pack has, or "
        "counts and the capacity of one cell"
    )


@record(BatteryError, eq=False)
class Battery(ByValue, html.Readable):
    """A battery pack as an equivalent circuit (Thevenin): source, resistance, one RC pair.

    Parameters
    ----------
    name : str
        What to call it.
    capacity : float
        Charge it delivers when new, at 25 degC and up to `rated_current` [C].
    soc_points : array_like, shape (m,)
        States of charge, ascending from 0 to 1.
    ocv_points : array_like, shape (m,)
        Open-circuit voltage of the pack there [V], not descending.
    resistance : float
        Series resistance when new, at 25 degC [ohm].
    pair_resistance, pair_time : float
        Resistance [ohm] and time constant [s] of the RC pair; no pair where the resistance is 0.
    peukert : float
        Peukert exponent, 1 where the charge delivered does not depend on the current.
    rated_current : float
        Current at which `capacity` was measured [A]; Peukert's law acts above it.
    charge_efficiency : float
        Charge stored over charge supplied, in (0, 1].
    cutoff_voltage, cutoff_soc : float
        Voltage [V] and state of charge at which the battery is switched off.
    max_voltage : float
        Voltage up to which it may be charged [V].
    max_discharge_current, max_charge_current : float
        Largest currents [A], both positive.
    temperature : float
        Temperature of the pack [degC].
    min_charge_temperature, max_charge_temperature : float
        Temperatures between which it takes charge [degC]: from a charger, and from braking.
    derating_temperature, derating_factor : array_like, shape (k,)
        Temperatures [degC], ascending, and the capacity there over that at 25 degC.
    resistance_coefficient : float
        Relative rise of the resistances per kelvin below 25 degC [1/K].
    health : float
        Capacity left over capacity when new, in (0, 1]. The resistances rise by its inverse.
    notes : tuple of str
        What was assumed about it; missions warn of it.

    Raises
    ------
    BatteryError
        If a value is out of its range.

    References
    ----------
    Peukert's law in its running form draws ``I (I/I_rated)^(k - 1)``. No charge comes back at rest:
    it errs on the safe side (Doerffel and Sharkh, Journal of Power Sources 155, 2006).

    Examples
    --------
    >>> pack = Battery.preset("quadriga")
    >>> round(float(pack.ocv(1.0)), 2), round(pack.capacity / 3600)
    (37.95, 36)
    """

    name: str
    capacity: Annotated[Coulombs, Within((1e-3, 3.6e8), (360, 3.6e6), "C", "1 Ah is 3600 C")]
    soc_points: Numbers
    ocv_points: Annotated[Numbers, Within((0, 5e3), (0, 1e3), "V")]
    resistance: Annotated[Ohms, Within((0, 1e3), (0, 2), "ohm", "not milliohms")]
    pair_resistance: Annotated[Ohms, Within((0, 1e3), (0, 2), "ohm", "not milliohms")] = 0.0
    pair_time: Annotated[Time, Within((1e-3, 1e6), (0.1, 7200), "s", endless=True)] = 60.0
    peukert: Annotated[Number, Within((1, 2), (1, 1.4))] = 1.0
    rated_current: _Limit = np.inf
    charge_efficiency: Annotated[Fraction, Within((0.01, 1), (0.7, 1), "", PERCENT)] = 1.0
    cutoff_voltage: Annotated[Volts, Within((0, 5e3), (0, 1e3), "V")] = 0.0
    cutoff_soc: Annotated[Fraction, Within((0, 0.99), (0, 0.6), "", PERCENT)] = 0.0
    max_voltage: Annotated[Volts, Within((0.1, 5e3), (2, 1e3), "V", endless=True)] = np.inf
    max_discharge_current: _Limit = np.inf
    max_charge_current: Annotated[Amps, Within((0, 1e6), (0, 2e3), "A", endless=True)] = np.inf
    temperature: Temperature = _REFERENCE_TEMPERATURE
    min_charge_temperature: _Charging = -np.inf
    max_charge_temperature: _Charging = np.inf
    derating_temperature: Annotated[Numbers, Within((-60, 100), (-60, 100), "degC", KELVIN)] = (
        field(default_factory=lambda: np.array([_REFERENCE_TEMPERATURE]))
    )
    derating_factor: Annotated[Numbers, Within((0.01, 2), (0.1, 1.2))] = field(
        default_factory=lambda: np.array([1.0])
    )
    resistance_coefficient: Annotated[Number, Within((0, 1), (0, 0.1), "1/K")] = 0.0
    health: Annotated[Fraction, Within((0.01, 1), (0.5, 1), "", PERCENT)] = 1.0
    notes: tuple[str, ...] = ()

    also: ClassVar = ("preset", *_UNITS, "usable")  # keys of a mapping that stand for others

    @pydantic.model_validator(mode="before")
    @classmethod
    def _described(cls, given: Any) -> Any:
        """Read words, or a mapping of a preset, words or equal units with what differs from it."""
        if not isinstance(given, str | dict):
            return given
        parts = {"preset": given} if isinstance(given, str) else given
        given = {key: value for key, value in parts.items() if value is not None}
        if "usable" in given:
            usable = amount("fraction", given.pop("usable"))
            _require(isinstance(usable, int | float), "usable is no fraction; give one, as 80 %")
            given["cutoff_soc"] = 1.0 - usable
        words = given.pop("preset", None)
        units = {
            key: amount(kind, given.pop(key)) if kind else given.pop(key)
            for key, kind in _UNITS.items()
            if key in given
        }
        lacking = [key for key in _UNITS if key not in units and key != "unit_resistance"]
        _require(
            (words is None) != (not units),
            f"give a preset or words, as in {EXAMPLE!r}, or chemistry, series, parallel and "
            "unit_capacity",
        )
        _require(
            not (units and lacking),
            f"the pack lacks {', '.join(lacking)}; or say it in words, as in {EXAMPLE!r}",
        )
        base = cls.from_units(given.get("name", "battery"), **units) if units else cls.of(words)
        notes = () if "resistance" in given else base.notes
        capacity = f"{base.capacity!r} C"  # with its unit: plain numbers of a file may be doubted
        return {**vars(base), "capacity": capacity, "notes": notes, **given}

    def __post_init__(self) -> None:
        soc, ocv = self.soc_points, self.ocv_points
        _require(
            len(soc) == len(ocv) >= 2
            and (soc[0], soc[-1]) == (0, 1)
            and bool((np.diff(soc) > 0).all()),
            f"battery {self.name}: soc_points must ascend from 0 to 1, one ocv_point for each",
        )
        _require(
            bool((np.diff(ocv) >= 0).all()) and ocv[0] > 0,
            f"battery {self.name}: ocv_points must be positive and must not descend",
        )
        heat, factor = self.derating_temperature, self.derating_factor
        _require(
            len(heat) == len(factor) and bool((np.diff(heat) > 0).all() and (factor > 0).all()),
            f"battery {self.name}: derating_temperature must ascend, with one positive "
            "derating_factor for each",
        )
        _require(
            self.min_charge_temperature < self.max_charge_temperature,
            f"battery {self.name}: min_charge_temperature must be below max_charge_temperature",
        )
        _require(
            self.cutoff_voltage < min(ocv[-1], self.max_voltage),
            f"battery {self.name}: cutoff_voltage is {self.cutoff_voltage:g}; it must be below the "
            f"open-circuit voltage of the full battery, {ocv[-1]:g} V, and below max_voltage",
        )

    def _summaries(self) -> list[html.Summary]:
        now = {
            "capacity [Ah]": self.available_capacity / 3600,
            "energy [Wh]": self.full_energy / 3600,
        }
        return [html.Summary(f"battery {self.name}", ("", ""), now.items())]

    # -- state ----------------------------------------------------------------------------------

    @property
    def available_capacity(self) -> float:
        """Charge between full and empty at this temperature and age [C]."""
        warm = np.interp(self.temperature, self.derating_temperature, self.derating_factor)
        return self.capacity * self.health * float(warm)

    @property
    def temperature_note(self) -> str:
        """What to know where there are no data for its temperature; empty where there are."""
        low, high = self.derating_temperature[[0, -1]]
        if low <= self.temperature <= high:
            return ""
        known = f"at {low:g} degC only" if low == high else f"from {low:g} to {high:g} degC"
        return (
            f"battery {self.name}: its capacity is known {known}; at {self.temperature:g} degC "
            f"that of {np.clip(self.temperature, low, high):g} degC is used, which may be too much"
        )

    @property
    def charging_fault(self) -> str:
        """Why it takes no charge at its temperature, and the remedy; empty where it does."""
        low, high = self.min_charge_temperature, self.max_charge_temperature
        if low <= self.temperature <= high:
            return ""
        cold = self.temperature < low
        remedy = f"indoors, above {low:g}" if cold else f"in a cool place, below {high:g}"
        return (
            f"the battery is at {self.temperature:g} degC and is charged from {low:g} to {high:g} "
            f"degC only; charge {remedy} degC"
        )

    @property
    def full_energy(self) -> float:
        """Energy between full and empty at this temperature and age, nothing being lost [J]."""
        grid = np.linspace(0.0, 1.0, 101)
        return self.available_capacity * float(np.trapezoid(self.ocv(grid), grid))

    @property
    def _resistance_factor(self) -> float:
        cold = max(_REFERENCE_TEMPERATURE - self.temperature, 0.0)
        return (1.0 + self.resistance_coefficient * cold) / self.health

    def ocv(self, soc: ArrayLike) -> FloatArray:
        """Open-circuit voltage [V] at a state of charge."""
        at = numbers(soc, "soc", BatteryError)
        return np.asarray(np.interp(at, self.soc_points, self.ocv_points))

    @checked(BatteryError)
    def larger(self, energy: float) -> Battery:
        """Return a battery of the same make that holds so much more energy [J] when full.

        It has more strings in parallel: resistances fall and currents rise with the capacity.
        """
        factor = 1.0 + energy / self.full_energy
        _require(
            factor > 0,
            f"battery {self.name} holds {self.full_energy:g} J; {-energy:g} J less leaves nothing",
        )
        grown = ("capacity", "rated_current", "max_discharge_current", "max_charge_current")
        changes: dict[str, Any] = {name: getattr(self, name) * factor for name in grown}
        for name in ("resistance", "pair_resistance"):
            changes[name] = getattr(self, name) / factor
        return replace(self, **changes)

    # -- what it can do -------------------------------------------------------------------------

    @checked(BatteryError)
    def simulate(
        self, t: ArrayLike, power: ArrayLike, *, soc: float = 1.0, polarisation: float = 0.0
    ) -> BatteryRun:
        """Run a power profile through the battery.

        Parameters
        ----------
        t : array_like, shape (n,)
            Strictly increasing times [s].
        power : array_like, shape (n,)
            Power at the terminals from each time to the next [W], positive when drawn.
        soc : float
            State of charge at the start.
        polarisation : float
            Voltage of the RC pair at the start [V]; 0 where the battery has rested.

        Returns
        -------
        BatteryRun
            State of charge, voltage, current, losses, and any brown-out.

        Raises
        ------
        BatteryError
            If time does not increase, a value is not finite, or `soc` is not in [0, 1].

        Examples
        --------
        >>> run = Battery.preset("quadriga").simulate([0.0, 3600.0], [300.0, 0.0])
        >>> run.brown_out, round(run.soc_end, 2)
        (inf, 0.74)
        """
        times = np.ascontiguousarray(t, float)
        load = np.ascontiguousarray(power, float)
        shapes = f"time has shape {times.shape}, power {load.shape}"
        paired = times.ndim == 1 and len(times) >= 1 and times.shape == load.shape
        _require(paired, f"{shapes}; give one power for each time")
        bad = np.flatnonzero(~np.isfinite(times + load))
        _require(len(bad) == 0, f"time or power is not finite at sample {bad[:1]}; remove it first")
        back = np.flatnonzero(np.diff(times) <= 0)
        _require(len(back) == 0, f"time does not increase after sample {back[:1]}; sort it first")
        _require(0 <= soc <= 1, f"soc is {soc}; give a fraction in [0, 1]")
        out = np.empty((5, len(times)))
        start, curve = (float(soc), float(polarisation)), (self.soc_points, self.ocv_points)
        died, why, left = discharge(times, load, *start, *curve, self.circuit(), out)
        return BatteryRun(times, out[0], out[1], out[2], out[3], out[4], died, _REASONS[why], left)

    @checked(BatteryError)
    def usable_energy(
        self, power: ArrayLike, soc: ArrayLike = 1.0, kept: float = 0.0
    ) -> FloatArray:
        """Energy [J] that it delivers at constant power [W] until it gives up.

        Or until a state of charge that is to be kept. Zero where it cannot deliver that power at
        all. The RC pair is assumed in steady state: the
        discharge lasts long against its time constant.
        """
        load, start = np.broadcast_arrays(np.asarray(power, float), np.asarray(soc, float))
        _require(bool(np.all(load > 0)), "usable energy is asked at a power that is not positive")
        _require(bool(np.all((start >= 0) & (start <= 1))), "soc must be a fraction in [0, 1]")
        share = np.linspace(1.0, 0.0, 1001)
        lowest = max(self.cutoff_soc, kept)
        span = np.maximum(start - lowest, 0.0)
        level = lowest + span[..., None] * share
        current = self._steady_current(load[..., None], level)
        drop = self._resistance_factor * (self.resistance + self.pair_resistance) * current
        alive = self.ocv(level) - drop >= self.cutoff_voltage
        alive &= current <= self.max_discharge_current
        alive = np.logical_and.accumulate(alive, axis=-1)
        with np.errstate(invalid="ignore"):
            excess = np.maximum(current / self.rated_current, 1.0) ** (self.peukert - 1.0)
            seconds = np.where(alive, 1.0 / (current * excess), 0.0)
        width = span * self.available_capacity / (len(share) - 1)
        pairs = 0.5 * (seconds[..., 1:] + seconds[..., :-1]) * alive[..., 1:]
        return np.asarray(load * width * pairs.sum(axis=-1))

    def _steady_current(self, power: FloatArray, soc: FloatArray) -> FloatArray:
        emf = self.ocv(soc)
        resistance = self._resistance_factor * (self.resistance + self.pair_resistance)
        root = emf**2 - 4.0 * resistance * power
        possible = root >= 0
        current = 2.0 * power / (emf + np.sqrt(np.where(possible, root, 0.0)))
        return np.where(possible, current, np.inf)

    def largest_power(self, soc: FloatArray, lasting: FloatArray) -> FloatArray:
        """Largest power that it delivers after some time [s] at states of charge [W], rested."""
        emf, factor = self.ocv(soc), self._resistance_factor
        filled = 1.0 - np.exp(-lasting / self.pair_time)
        resistance = factor * (self.resistance + self.pair_resistance * filled)
        safe = np.maximum(resistance, 1e-12)
        current = np.minimum(emf - self.cutoff_voltage, 0.5 * emf) / safe
        current = np.clip(current, 0.0, self.max_discharge_current)
        power = np.where(np.isfinite(current), (emf - resistance * current) * current, np.inf)
        return np.where(soc > self.cutoff_soc, power, 0.0)

    def circuit(self) -> Circuit:
        """Return the constants that the kernel reads."""
        factor = self._resistance_factor
        given = (
            self.available_capacity, factor * self.resistance, factor * self.pair_resistance,
            self.pair_time, self.peukert, self.rated_current, self.charge_efficiency,
            self.cutoff_voltage, self.cutoff_soc, self.max_voltage, self.max_discharge_current,
            0.0 if self.charging_fault else self.max_charge_current,
        )  # fmt: skip
        return Circuit(*map(float, given))

    # -- presets --------------------------------------------------------------------------------

    @classmethod
    @checked(BatteryError)
    def from_units(
        cls,
        name: str,
        chemistry: str,
        *,
        series: int,
        parallel: int,
        unit_capacity: float,
        unit_resistance: float | None = None,
        rated_time: float = 20 * 3600.0,
        discharge_rate: float = 5.0,
        charge_rate: float | None = None,
        pair_share: float = 0.5,
        pair_time: float = 60.0,
        cutoff_soc: float = 0.0,
    ) -> Battery:
        """Build a pack from equal units in series and in parallel.

        Parameters
        ----------
        name : str
            What to call it.
        chemistry : {"lead_acid", "lithium_ion", "lithium_iron_phosphate"}
            Chemistry, or another name of it, such as ``"LiFePO4"``; a unit is a 12 V block of
            lead-acid, or one lithium cell.
        series, parallel : int
            Units in series, and strings in parallel.
        unit_capacity : float
            Capacity of one unit [C].
        unit_resistance : float, optional
            Series resistance of one unit [ohm]; where not given, one that is typical of the
            chemistry and capacity, which a note says.
        rated_time : float
            Discharge time at which the capacity was measured [s].
        discharge_rate, charge_rate : float
            Largest currents over the current that would empty the pack in an hour.
        pair_share : float
            Resistance of the RC pair over the series resistance.
        pair_time : float
            Time constant of the pair [s].
        cutoff_soc : float
            State of charge at which the pack is switched off.

        Returns
        -------
        Battery
            The pack.

        Raises
        ------
        UnknownNameError
            If there is no such chemistry.
        BatteryError
            If a count or a value is out of its range.
        """
        kind = chemistry_of(chemistry)
        if kind is None:
            raise UnknownNameError("battery chemistry", chemistry, CHEMISTRIES)
        _require(series >= 1 and parallel >= 1, f"{series} x {parallel} units; give 1 or more")
        _require(unit_capacity > 0, f"unit_capacity is {unit_capacity} C; give more than 0")
        notes: tuple[str, ...] = ()
        if unit_resistance is None:
            unit_resistance = kind.typical_resistance * 3600.0 / unit_capacity
            ohms = unit_resistance * series / parallel
            notes = (
                f"battery {name}: its resistance of {1e3 * ohms:.3g} mohm is typical of its "
                f"chemistry and capacity; others have from {500 * ohms:.3g} to "
                f"{2e3 * ohms:.3g} mohm, so give it where you know it",
            )
        capacity = unit_capacity * parallel
        resistance = unit_resistance * series / parallel
        return cls(
            name=name, capacity=capacity, soc_points=np.array(kind.soc),
            ocv_points=series * np.array(kind.ocv), resistance=resistance,
            pair_resistance=pair_share * resistance, pair_time=pair_time, peukert=kind.peukert,
            rated_current=capacity / rated_time, charge_efficiency=kind.charge_efficiency,
            cutoff_voltage=series * kind.cutoff_voltage, cutoff_soc=cutoff_soc,
            max_voltage=series * kind.max_voltage,
            max_discharge_current=discharge_rate * capacity / 3600.0,
            max_charge_current=(charge_rate or kind.charge_rate) * capacity / 3600.0,
            min_charge_temperature=kind.charging[0], max_charge_temperature=kind.charging[1],
            derating_temperature=np.array(kind.temperature),
            derating_factor=np.array(kind.capacity_factor),
            resistance_coefficient=kind.resistance_coefficient, notes=notes,
        )  # fmt: skip

    @classmethod
    @checked(BatteryError)
    def of(cls, words: str) -> Battery:
        """Return the battery that a preset or some words name.

        The words give voltage, capacity (or energy) and chemistry of the whole pack, or, with
        counts as in ``7S4P`` and no voltage or energy, the capacity of one cell. With counts, the
        voltage or energy of the pack must agree with them. In any order there may also be a
        resistance (``30 mohm``, of what the capacity is of), ``usable 80 %``, ``health 90 %`` and a
        temperature (``5 degC``).

        Parameters
        ----------
        words : str
            Such as ``"24 V 20 Ah lead-acid"``, ``"7S4P 3 Ah li-ion"`` or ``"husky_a200"``.

        Returns
        -------
        Battery
            The battery.

        Raises
        ------
        BatteryError
            If something is missing, not understood or contradicts the counts.

        Examples
        --------
        >>> pack = Battery.of("25.6 V 100 Ah LiFePO4, usable 80 %")
        >>> round(pack.full_energy / 3600), round(pack.cutoff_soc, 2)
        (2614, 0.2)
        >>> Battery.of("36 V 10 Ah li-ion 10S3P").capacity / 3600
        10.0
        """
        if words.strip() in PRESETS:
            return cls.preset(words.strip())
        read = _read(words)
        given, counts, several, _ = read
        kind = _chemistry_in(words, read)
        for unit in given.keys() - {"degC"}:
            _require(given[unit] > 0, f"battery {words!r}: {given[unit]:g} {unit} is not positive")
        notes: tuple[str, ...] = ()
        whole = True  # whether the capacity and the resistance are the pack's, not one cell's
        if counts is not None:
            cells = int(counts[1]), int(counts[2] or 1)
            _require(min(cells) >= 1, f"battery {words!r}: {counts[0]} is no pack; give 1 or more")
            capacity, whole = _counted(words, given, kind, *cells)
            if whole and cells[1] > 1 and "Wh" not in given:
                notes = (
                    f"battery {words}: {capacity:g} Ah is the capacity of the whole pack, as its "
                    "voltage is; for that of one cell leave the voltage out",
                )
        else:
            cells = max(round(given["V"] / kind.voltage), 1), 1
            off = cells[0] * kind.voltage / given["V"] - 1.0
            _require(
                abs(off) < 0.12,
                f"battery {words!r}: {given['V']:g} V is no multiple of the {kind.voltage:g} V of "
                f"one unit of {kind.name}; give the counts, as in {cells[0]}S1P",
            )
            if abs(off) > 0.03:
                notes = (f"battery {words}: taken to have {cells[0]} units in series",)
            capacity = given["Ah"] if "Ah" in given else given["Wh"] / (cells[0] * kind.voltage)
        if several:
            side = f"battery {words}: {several[1]} side by side, {capacity:.4g} Ah in all"
            notes = (side, *notes)
        resistance = given.get("ohm")
        if resistance is not None and whole:
            resistance *= cells[1] / cells[0]
        pack = cls.from_units(
            words.strip(), kind.name, series=cells[0], parallel=cells[1],
            unit_capacity=3600.0 * capacity / cells[1], unit_resistance=resistance,
            cutoff_soc=1.0 - given.get("usable", 1.0),
        )  # fmt: skip
        return replace(
            pack,
            temperature=given.get("degC", pack.temperature),
            health=given.get("health", pack.health),
            notes=(*notes, *pack.notes),
        )

    @classmethod
    def preset(cls, name: str) -> Battery:
        """Return a preset battery: ``quadriga``, ``husky_a200``, ``jackal``.

        Quadriga carries six 12 V lead-acid batteries in series-parallel, 36 V in all (Morales et
        al. 2010, section IV); 18 Ah a block is taken here, as the paper gives no capacity. Husky:
        24 V, 20 Ah sealed lead-acid. Jackal: lithium-ion, 270 Wh. Resistances are typical.

        Parameters
        ----------
        name : str
            Name of the preset.

        Returns
        -------
        Battery
            The battery, new and at 25 degC.

        Raises
        ------
        UnknownNameError
            If there is no such preset.
        """
        if name not in PRESETS:
            raise UnknownNameError("battery preset", name, PRESETS)
        return cls.from_units(name, **PRESETS[name])
