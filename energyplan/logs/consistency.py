"""Do a log, a robot's measures and its mass belong together, and what would explain it if not.

Odometry, gyroscope, pose, power, mass and geometry give some quantities twice. Each such pair is a
ratio that lies in a known range whatever the robot and the ground; a unit, a wheel radius or a
measure that is wrong multiplies some of the ratios by a known factor. A mistake is named if undoing
it, and nothing else, brings every ratio back.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import islice
from math import inf, isfinite, log, nan
from types import MappingProxyType
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from energyplan.logs.align import derivative, integral
from energyplan.logs.mapping import (
    LONGEST_STEP,
    SHORTEST_STEP,
    UNITS,
    Column,
    dated,
    known_unit,
)
from energyplan.path import FloatArray
from energyplan.units import RATES
from energyplan.vehicle import GRAVITY, Vehicle, predict_icr

if TYPE_CHECKING:
    from energyplan.logs import DriveLog


class ComparisonLimits(NamedTuple):
    """From which on channels show a ratio."""

    window: float = 3.0  # length of the stretches over which distances are compared [s]
    enough: int = 20  # samples or windows below which nothing is concluded
    # least displacement of a pose, over its readings' noise, that shows a length
    jitter: float = 6.0
    close: float = 0.01  # time between means of rows, at least [s]
    far: float = 0.1  # the same, at most [s]
    most_rows: int = 100_000  # rows that suffice to compare channels
    chance: float = 4.0  # standard errors beyond which a mean power is none by chance
    alike: float = 0.9  # correlation from which the turning shows a slip track
    few_numbers: int = 25  # whole numbers beyond which they may be of a finer unit
    # relative error of a mass, at most; three of them are the range's margin
    inertia_error: float = 0.13


_COMPARED = ComparisonLimits()
POWERS = ("p_left", "p_right", "power", "current")
"""Channels of what is drawn."""


Channels = Mapping[str, FloatArray]


class Observed:
    """What a drive shows of a robot, each computed when it is needed; NaN if unseen."""

    def __init__(self, channels: Channels, power: FloatArray, runs: Sequence[slice]) -> None:
        self.channels, self.power, self.runs = channels, power, runs
        self.t, self.left, self.right = (channels[name] for name in ("t", "v_left", "v_right"))
        self.difference = self.right - self.left
        self.effort = np.abs(self.left) + np.abs(self.right)  # [m/s], whatever their signs
        self.sides = {"p_left", "p_right"} <= set(channels)
        self.typical_step = float(np.median(np.diff(self.t))) if len(self.t) > 1 else np.nan
        # Nothing but the heading shows the slip track.
        self.from_pose = "yaw_rate" not in channels
        battery = "current" in channels and "power" not in channels
        self.electric_names = (
            ("p_left", "p_right") if self.sides else ("current",) if battery else ("power",)
        )

    @cached_property
    def rows(self) -> Observed:
        """The same of every row, where this is of their means."""
        return self

    def averaged(self) -> Observed:
        """Return what means show, where rows are so close, or so many, that means suffice."""
        close = (
            _COMPARED.close / self.typical_step
            if self.typical_step < 0.5 * _COMPARED.close
            else 1.0
        )
        many = min(len(self.t) / _COMPARED.most_rows, _COMPARED.far / self.typical_step)
        count = int(max(close, many, 1.0))
        runs = [run for run in self.runs if run.stop - run.start >= 100 * count]
        if count < 2 or sum(run.stop - run.start for run in runs) < 0.9 * len(self.t):
            return self
        sizes = [(run.stop - run.start) // count for run in runs]
        ends = np.cumsum(sizes)

        def means(values: FloatArray) -> FloatArray:
            return np.concatenate([
                values[run.start : run.start + size * count].reshape(size, count).mean(axis=1)
                for run, size in zip(runs, sizes, strict=True)
            ])  # fmt: skip

        channels = {
            name: means(np.unwrap(values) if name == "yaw" else values)
            for name, values in self.channels.items()
        }
        result = Observed(
            channels, means(self.power),
            [slice(int(end) - size, int(end)) for end, size in zip(ends, sizes, strict=True)],
        )  # fmt: skip
        result.__dict__ |= {"rows": self, "step": self.step, "whole": self.whole}
        return result

    def stretches(self, name: str) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Where a channel's readings change, and how many samples each lasts."""
        starts = np.flatnonzero(np.append(True, np.diff(self.channels[name]) != 0.0))
        return starts, np.diff(np.append(starts, len(self.t)))

    @cached_property
    def held(self) -> dict[str, float]:
        """Powers that repeat their reading, by the time after which they are read again [s]."""
        changing = np.append(False, np.diff(self.effort) != 0.0)
        found = {}
        for name in (name for name in POWERS if name in self.channels):
            starts, counts = self.stretches(name)
            drives = np.logical_and.reduceat(self.moving, starts)
            counts, driving = counts[:-1], drives[:-1] & drives[1:]
            if np.count_nonzero(driving) < 8:
                continue
            typical = float(np.median(counts[driving]))
            rows = np.flatnonzero(np.repeat(driving, counts))
            if typical < 3 or np.mean(changing[rows]) < 0.1:
                continue
            # A reading that is the one before by chance makes two of one; and one may be late.
            times = counts[driving] / typical
            regular = np.abs(times - np.clip(np.round(times), 1, 3)) * typical <= 1.0
            if np.mean(regular) > 0.9:
                found[name] = float(np.median(np.diff(self.t[starts])[driving]))
        return found

    @cached_property
    def moving(self) -> NDArray[np.bool_]:
        """Where it moves, relative to the drive's speeds."""
        return self.effort > 0.15 * float(np.quantile(self.effort, 0.95))

    @cached_property
    def rates(self) -> dict[str, FloatArray]:
        """Yaw rates by the channel that they come from [rad/s]."""
        return yaw_rates(self.channels, self.runs)

    @cached_property
    def step(self) -> float:
        """Time between samples where they are close [s]."""
        steps = np.diff(self.t)
        return float(np.quantile(steps, 0.1)) if len(self.t) >= 5 * _COMPARED.enough else np.nan

    @cached_property
    def slip_track(self) -> float:
        """Difference of the tread speeds over the yaw rate [m]; NaN if they are not alike."""
        rate = self.rates.get("yaw_rate", self.rates.get("yaw"))
        if rate is None or not lasts(self.difference):
            return np.nan
        if abs(correlation(rate, self.difference)) < _COMPARED.alike:
            return np.nan
        return abs(float(self.difference @ self.difference) / float(self.difference @ rate))

    @cached_property
    def distance(self) -> float:
        """Way of the treads over that of the pose, on straight stretches."""
        return distance_ratio(self.channels, self.runs)

    @cached_property
    def rotation(self) -> float:
        """Gyroscope over heading; of a heading that jitters, over what it changes in seconds."""
        if len(self.rates) < 2 or not lasts(self.rates["yaw_rate"]):
            return np.nan
        t, gyro, heading = self.t, self.rates["yaw_rate"], self.rates["yaw"]
        angles = integral(t, gyro), np.unwrap(self.channels["yaw"])
        for window in (0.0, _COMPARED.window, 3 * _COMPARED.window):
            if window > 0.0:
                edges = np.arange(t[0], t[-1], window)
                gyro, heading = (np.diff(np.interp(edges, t, angle)) for angle in angles)
            if len(gyro) >= _COMPARED.enough and abs(correlation(gyro, heading)) >= 0.7:
                # The jitter of the heading is in the denominator only where it is the regressor.
                return abs(float(gyro @ gyro) / float(gyro @ heading))
        return np.nan

    @cached_property
    def _driving(self) -> NDArray[np.bool_]:
        """Where it surely moves; nowhere if that is too seldom to conclude from."""
        fast = self.effort > max(0.1 * float(np.quantile(self.effort, 0.99)), 2e-6)
        return fast if np.count_nonzero(fast) >= _COMPARED.enough else np.zeros(len(fast), bool)

    @cached_property
    def top_speed(self) -> float:
        """Speed that is reached one hundredth of the time [m/s]."""
        return 0.5 * float(np.quantile(self.effort, 0.99)) if self._driving.any() else np.nan

    @cached_property
    def force(self) -> float:
        """Mean power over mean speed while driving [N]."""
        drawn = self.power[self._driving]
        # A dead sensor's noise has a mean, too.
        if not len(drawn) or abs(drawn.mean()) <= _COMPARED.chance * drawn.std() / np.sqrt(
            len(drawn)
        ):
            return np.nan
        return float(2.0 * np.abs(drawn.mean()) / self.effort[self._driving].mean())

    @cached_property
    def electric(self) -> float:
        """Power over voltage times current, where a log has both."""
        if not {"voltage", "current"} <= set(self.channels):
            return np.nan
        if not (self.sides or "power" in self.channels):
            return np.nan
        product = self.channels["voltage"] * self.channels["current"]
        if abs(correlation(self.power, product)) < 0.8:
            return np.nan
        return abs(float(self.power @ product) / float(product @ product))

    @cached_property
    def voltage(self) -> float:
        """Median voltage [V]."""
        return float(np.median(self.channels["voltage"])) if "voltage" in self.channels else np.nan

    @cached_property
    def inertia(self) -> float:
        """Mass that the power of speeding up shows [kg]; NaN where it hardly shows it."""
        mean = 0.5 * (self.left + self.right)
        gain = mean * derivative(self.t, mean, self.runs, 0.4)
        best, found = inf, np.nan
        for lag in np.arange(-0.2, 0.81, 0.1):
            shifted, back = (
                np.interp(self.t - lag, self.t, np.clip(gain, *ends))
                for ends in ((0, None), (None, 0))
            )
            rest = [0.5 * self.effort, np.abs(self.difference), np.ones(len(self.t))]
            fit = regress([shifted, back, *rest], self.power)
            loss = float(fit.rest @ fit.rest)
            if loss < best:
                best, mass = loss, float(fit.values[0])
                error = fit.errors[0] * np.sqrt(_repeats(fit.rest))
                found = mass if mass > 0 and error < _COMPARED.inertia_error * mass else np.nan
        return found

    @cached_property
    def whole(self) -> frozenset[str]:
        """Electric channels that come in many whole numbers."""
        return frozenset(n for n in (*POWERS, "voltage") if _whole(self.channels.get(n)))


def _whole(values: FloatArray | None) -> bool:
    """Return whether readings are whole numbers, more than a few of them."""
    if values is None or np.any(np.mod(values, 1.0) != 0.0):
        return False
    return len(np.unique(values)) > _COMPARED.few_numbers or float(np.median(np.abs(values))) > 60.0


class Regression(NamedTuple):
    """A fit by least squares, and what it leaves."""

    values: FloatArray  # (k,): factors of the shapes
    errors: FloatArray  # (k,): their standard errors, were all samples independent
    means: FloatArray  # (k,): what each shape makes in the mean
    rest: FloatArray  # (n,): what is left
    condition: float  # of the normal equations; large where shapes are alike


def regress(shapes: Sequence[FloatArray], y: FloatArray) -> Regression:
    """Fit a sum of shapes to readings; one that is zero throughout gets the factor 0."""
    X = np.stack(shapes)
    scale = np.sqrt((X * X).sum(axis=1))
    scale[scale == 0] = 1.0
    unit = X / scale[:, None]
    gram = unit @ unit.T
    inverse = np.linalg.pinv(gram, rcond=1e-10, hermitian=True)
    values = inverse @ (unit @ y)
    rest = y - values @ unit
    errors = np.sqrt(float(rest @ rest) / len(y) * np.diag(inverse)) / scale
    condition = float(np.linalg.cond(gram)) if np.all(np.any(X, axis=1)) else np.inf
    return Regression(values / scale, errors, values / scale * X.mean(axis=1), rest, condition)


def yaw_rates(channels: Channels, runs: Sequence[slice]) -> dict[str, FloatArray]:
    """Return the yaw rates that a log holds [rad/s], by the channel that they come from."""
    found = {}
    if "yaw_rate" in channels:
        found["yaw_rate"] = channels["yaw_rate"]
    if "yaw" in channels:
        found["yaw"] = derivative(channels["t"], np.unwrap(channels["yaw"]), runs, 0.5)
    return found


def correlation(one: FloatArray, other: FloatArray) -> float:
    """Correlation through the origin; 0 where one is zero throughout."""
    norm = float(np.sqrt((one @ one) * (other @ other)))
    return float(one @ other) / norm if norm > 0 else 0.0


def lasts(values: FloatArray) -> bool:
    """Return whether readings are large for long enough to conclude from, not for one jerk."""
    size = np.abs(values)
    return bool(np.count_nonzero(size > 0.2 * np.max(size, initial=0.0)) >= _COMPARED.enough)


def distance_ratio(channels: Channels, runs: Sequence[slice]) -> float:
    """Way of the treads over that of the pose, on straight stretches."""
    if not {"x", "y"} <= set(channels):
        return np.nan
    t = channels["t"]
    step = float(np.median(np.diff(t)))
    # Some stretches of some samples, whatever their time: its unit may be the mistake.
    window = max(min(_COMPARED.window, step * len(t) / 40), 10 * step)
    rolled: list[FloatArray] = []
    gone: list[FloatArray] = []
    for run in runs:
        edges = np.arange(t[run][0], t[run][-1], window)
        if len(edges) < 2:
            continue
        x, y = (np.interp(edges, t[run], channels[name][run]) for name in ("x", "y"))
        left, right = (
            np.diff(np.interp(edges, t[run], integral(t[run], channels[name][run])))
            for name in ("v_left", "v_right")
        )
        way = 0.5 * np.abs(left + right)
        straight = np.abs(right - left) < 0.1 * way
        rolled.append(way[straight])
        gone.append(np.hypot(np.diff(x), np.diff(y))[straight])
    if not rolled:
        return np.nan
    wheel, pose = np.concatenate(rolled), np.concatenate(gone)
    if not len(wheel):
        return np.nan
    far = wheel > 0.3 * wheel.max()
    wheel, pose = wheel[far], pose[far]
    if len(wheel) < 3 or not np.any(pose):
        return np.nan
    jitter = np.concatenate(
        [np.diff(channels[name][run], 2) for name in ("x", "y") for run in runs]
    )
    if np.mean(pose**2) < _COMPARED.jitter**2 * float(np.mean(jitter**2)) / 6.0:
        return np.nan
    ratio = float(wheel @ wheel) / float(wheel @ pose)
    # Stretches that contradict each other (slipping, a lost pose) show nothing.
    scatter = float(np.std(pose * ratio - wheel) / wheel.mean())
    return ratio if scatter < 0.5 else np.nan


def _repeats(residual: FloatArray) -> float:
    """How many neighbouring samples repeat each other: the sum of the autocorrelation."""
    size = float(residual @ residual)
    spectrum = np.fft.rfft(residual, 2 * len(residual))
    alike = np.fft.irfft(np.abs(spectrum) ** 2)[1 : len(residual) // 4] / max(size, 1e-300)
    uncorrelated = np.flatnonzero(alike < 0.05)
    return 1.0 + 2.0 * float(alike[: uncorrelated[0] if len(uncorrelated) else None].sum())


class UnitLimits(NamedTuple):
    """When another unit is named, and between which sizes of wheels and gears."""

    wheel_radii: tuple[float, float] = (0.02, 0.45)  # of skid-steer robots [m]
    gear_ratios: tuple[float, float] = (4.0, 250.0)  # between a motor and its wheel
    named: int = 3  # mistakes that are named, where several explain the same
    # by how much less unusual another unit must be to be named where nothing is wrong
    gain: float = 0.05
    slips: float = 0.25  # relative error of a size of speeds that turning shows


_UNIT = UnitLimits()
_UNUSUAL = "speed and power are possible together, but another unit would be far more usual"

_Columns = Mapping[str, Column]


@dataclass(frozen=True)
class Check:
    """What was compared or found in a log, whether it is right, and what to do if not."""

    what: str  # what was compared, or what is wrong
    remedy: str = ""  # what to do if it is wrong
    refuses: str = ""  # what it rules out: "reading" the log, "fitting" anything to it, or "trust"
    turned: tuple[str, ...] = ()  # channels that count the other way
    value: float | None = None  # what came out
    expected: str = ""  # what was expected
    ok: bool = False  # whether it came out so
    rule: str = ""  # which rule it is of
    channel: str = ""  # the channel that it is about, where it is about one alone

    def __str__(self) -> str:
        compared = f": {self.value:.3g}, expected {self.expected}" if self.value is not None else ""
        return f"{self.what}{compared}" + (f"; {self.remedy}" if self.remedy else "")


@dataclass(frozen=True)
class Measures:
    """A robot's measures; NaN where they are not known."""

    track: float = nan  # distance between left and right wheels [m]
    wheelbase: float = nan  # distance between front and rear wheels [m]
    mass: float = nan  # mass as it drives [kg]
    wheel_radius: float = nan  # radius of the wheels [m]

    @classmethod
    def of(cls, vehicle: Vehicle) -> Measures:
        """Return the measures of a vehicle's outermost contacts."""
        wheelbase, track = np.ptp(vehicle.contacts, axis=0)
        return cls(float(track), float(wheelbase), vehicle.mass)


@dataclass(frozen=True)
class _Range:
    """A ratio's name, where it may lie, and where it usually does."""

    what: str
    low: float
    high: float
    typical: float
    why: str

    @property
    def expected(self) -> str:
        return f"{self.low:g} to {self.high:g} ({self.why})"

    def holds(self, value: float) -> bool:
        return self.low <= value <= self.high

    def strain(self, value: float) -> float:
        """How far a value is from the typical one, in widths of the range, squared."""
        return (log(value / self.typical) / log(self.high / self.low)) ** 2 if value > 0 else inf


# The slip track of real drives lies at 0.76 to 1.08 of that of equal point loads (Husky on floor,
# ice, loam; Warthog on grass), with a gyroscope's error on top; treads that dig themselves in turn
# less than they indicate, and are left out for want of correlation.
_RANGES = {
    "turning": _Range(
        "slip track over that of the wheel positions", 0.6, 1.45, 0.93, "moment balance"
    ),
    "distance": _Range(
        "distance by the treads over that by the pose", 0.8, 1.35, 1.0, "little slip"
    ),
    "rotation": _Range("yaw rate over the rate of the heading", 0.75, 1.35, 1.0, "same turning"),
    "top_speed": _Range("largest speed [m/s]", 0.02, 8.0, 0.7, "skid-steer robots"),
    "force": _Range("power over weight times speed", 0.008, 4.0, 0.25, "resistance of wheels"),
    "electric": _Range("power over voltage times current", 0.8, 1.25, 1.0, "the same power"),
    "density": _Range(
        "mass over wheelbase times track [kg/m^2]", 40.0, 3000.0, 300.0, "built robots"
    ),
    "aspect": _Range("wheelbase over track", 0.33, 2.5, 0.95, "skid-steer robots"),
    "inertia": _Range(
        "mass by acceleration over that given", 0.62, 12.0, 1.1, "more with heavy drives"
    ),
    "step": _Range("time step [s]", SHORTEST_STEP, LONGEST_STEP, 0.05, "logs of drives"),
    "voltage": _Range("voltage [V]", 3.0, 1000.0, 30.0, "batteries of robots"),
}
# Whole numbers may be tenths or hundredths, so that they are held to narrower ranges.
_RANGES |= {
    "whole_force": replace(
        _RANGES["force"], high=1.2, why="resistance of wheels, read in whole numbers"
    ),
    "rough_force": replace(
        _RANGES["force"], low=8e-4, high=40.0, why="resistance of wheels, weight by size"
    ),
    "of_drives": replace(
        _RANGES["electric"], low=0.25, why="what the drives draw of the battery's power"
    ),
    "whole_voltage": replace(
        _RANGES["voltage"], high=100.0, why="batteries of robots, read in whole numbers"
    ),
}


def _ratios(seen: Mapping[str, float], drive: Observed) -> list[tuple[_Range, float]]:
    """Return the known ratios that drive and measures make."""
    track, wheelbase, mass = (seen[key] for key in ("track", "wheelbase", "mass"))
    geometric = 2 * predict_icr(wheelbase, track) if track and wheelbase else nan
    force = "whole_force" if drive.whole & set(POWERS) else "force"
    weight = mass * GRAVITY
    if not isfinite(mass):
        force = "rough_force"
        weight = (
            _RANGES["density"].typical
            * track
            * (wheelbase if isfinite(wheelbase) else track)
            * GRAVITY
        )
    found = {
        "step": seen["step"], "top_speed": seen["top_speed"], "distance": seen["distance"],
        "rotation": seen["rotation"], "turning": seen["slip_track"] / geometric,
        "aspect": wheelbase / track, "density": mass / (wheelbase * track),
        force: seen["force"] / weight,
        "of_drives" if drive.sides else "electric": seen["electric"],
        "whole_voltage" if "voltage" in drive.whole else "voltage": seen["voltage"],
        "inertia": seen.get("inertia", nan) / mass,
    }  # fmt: skip
    return [(_RANGES[name], value) for name, value in found.items() if isfinite(value)]


_ACTS: dict[tuple[str, ...], dict[str, int]] = {
    ("v_left", "v_right"): {
        "slip_track": 1, "distance": 1, "top_speed": 1, "force": -1, "inertia": -2},
    ("t",): {"step": 1, "distance": 1, "rotation": 1, "inertia": 1},
    ("yaw_rate",): {"rotation": 1},
    ("yaw",): {"rotation": -1},
    ("x", "y"): {"distance": -1},
    ("p_left", "p_right"): {"force": 1, "electric": 1, "inertia": 1},
    ("power",): {"force": 1, "electric": 1, "inertia": 1},
    ("current",): {"force": 1, "inertia": 1},
    ("voltage",): {"force": 1, "inertia": 1, "voltage": 1},
    ("voltage", "current"): {"force": 1, "inertia": 1, "voltage": 1},
    ("track",): {"track": 1},
    ("wheelbase",): {"wheelbase": 1},
    ("track", "wheelbase"): {"track": 1, "wheelbase": 1},
    ("mass",): {"mass": 1},
}  # fmt: skip
"""With which power of a factor on these readings what is seen changes."""


class _Mistake(NamedTuple):
    """Readings that may be in another unit than they are taken for, and the factor to SI."""

    channels: tuple[str, ...]
    name: str
    unit: str  # what to write in brackets; of measures what to give
    factor: float
    rarity: float = 0.0
    instead: str = ""  # what to do, where that is not to map the channels in the unit

    def undo(self, seen: Mapping[str, float], drive: Observed, factor: float) -> dict[str, float]:
        """Return what would be seen without the mistake."""
        acts = dict(_ACTS[self.channels])
        if self.channels[0] in ("t", "yaw", "yaw_rate"):  # that the slip track is computed from
            power = {"t": 1, "yaw": -1, "yaw_rate": -1}[self.channels[0]]
            acts["slip_track"] = power * (drive.from_pose != (self.channels[0] == "yaw_rate"))
        if self.channels[-1] in ("voltage", "current") and isfinite(drive.electric):
            acts = {"electric": -1, "voltage": acts.get("voltage", 0)}
        size = factor**2 if self.channels == ("voltage", "current") else factor
        return {
            key: value * (factor if key == "voltage" else size) ** acts.get(key, 0)
            for key, value in seen.items()
        }


def _units(channels: str, names: str, what: str, rare: str = "") -> list[_Mistake]:
    """Return the mistakes of readings that are in one of some units."""
    each = tuple(channels.split(","))
    return [
        _Mistake(
            each, f"{what} in {unit}", unit, UNITS[each[0]][unit], 0.1 * (unit in rare.split())
        )
        for unit in names.split()
    ]


_MISTAKES = [
    *_units("v_left,v_right", "km/h mm/s cm/s mph ft/s in/s", "the tread speeds are",
            "mph ft/s in/s"),
    *_units("t", "ms us ns min", "t is"),
    *_units("yaw_rate", "deg/s rpm", "yaw_rate is", "rpm"),
    *_units("yaw", "deg", "yaw is"),
    *_units("x,y", "cm mm ft in", "x and y are", "ft in"),
    *_units("p_left,p_right", "kW mW hp", "the power is", "hp"),
    *_units("power", "kW mW hp", "the power is", "hp"),
    *_units("current", "mA", "the current is"),
    *_units("voltage", "mV", "the voltage is", "mV"),
    *(
        _Mistake(channels, f"{what} in {name}", f"*{size:g}", size, 0.1)
        for name, size in (("tenths", 0.1), ("hundredths", 0.01), ("thousandths", 1e-3))
        for channels, what in (
            (("voltage",), "the voltage counts"), (("current",), "the current counts"),
            (("voltage", "current"), "voltage and current count"),
            (("power",), "the power counts"), (("p_left", "p_right"), "the power counts"),
        )
        if name != "thousandths" or channels == ("voltage", "current")
    ),
    *(
        _Mistake(("track", "wheelbase"), f"track and wheelbase are in {name}", "metres", size, rare)
        for name, size, rare in (("cm", 1e-2, 0.0), ("mm", 1e-3, 0.0), ("inches", 0.0254, 0.1))
    ),
    *(
        _Mistake((what,), f"the {what} is in {name}", "metres", size)
        for what in ("track", "wheelbase") for name, size in (("cm", 1e-2), ("mm", 1e-3))
    ),
    *(
        _Mistake(("mass",), f"the mass is {name}", "kilograms", size, rare)
        for name, size, rare in (("in g", 1e-3, 0.0), ("in lb", 0.45359237, 0.0),
                                 ("a weight in N", 1 / 9.81, 0.1), ("in t", 1e3, 0.0))
    ),
]  # fmt: skip
"""What may have gone wrong, in the order of how often it does."""


_USUAL_RATES = ("rad/s", "deg/s", "rpm", "rev/s")
_BY_HAND = (
    "give what they are, of the wheels or the motors, with radius, gear and, of an electrical "
    "rate, pole pairs: turning shows it to a quarter only, and a pose exactly"
)


def _of_speeds(seen: Mapping[str, float], known: Measures, columns: _Columns) -> list[_Mistake]:
    """Return the mistakes that speeds of another size than pose, or turning, ask for may be."""
    geometric = 2 * predict_icr(known.wheelbase, known.track)
    distance = seen["distance"]
    wanted = (
        1 / distance
        if isfinite(distance)
        else _RANGES["turning"].typical * geometric / seen["slip_track"]
    )
    sides = ("v_left", "v_right")
    if not (isfinite(wanted) and wanted > 0):
        return [
            _Mistake(sides, f"the tread speeds are the wheels' rates in {unit}",
                     f"{unit}*{known.wheel_radius:.3g}", rate * known.wheel_radius, 0.1)
            for unit, rate in RATES.items() if isfinite(known.wheel_radius)
        ]  # fmt: skip
    found = []
    mapped = columns.get("v_left")
    unit = "" if mapped is None else mapped.unit.lstrip("-").partition("*")[0]
    rolls = mapped is None or known_unit("v_left", unit) in RATES
    scale = _scale(mapped)
    shown = isfinite(distance)  # turning shows a size to a quarter alone, for want of the slip
    for unit, rate in RATES.items():
        radius = wanted * scale / rate
        as_given = isfinite(known.wheel_radius) and abs(log(radius / known.wheel_radius)) < 0.1
        near = isfinite(known.wheel_radius) and abs(log(radius / known.wheel_radius)) < _UNIT.slips
        as_given = as_given or (near and not shown)
        if not shown and not as_given and isfinite(known.wheel_radius):
            continue
        if _UNIT.wheel_radii[0] <= radius <= _UNIT.wheel_radii[1] and unit in _USUAL_RATES:
            size = known.wheel_radius if as_given else radius
            rare = -0.2 if as_given else {"deg/s": 0.3, "rev/s": 0.15}.get(unit, 0.0)
            about = "" if as_given else f": the wheel radius is about {radius:.3g} m"
            give = "" if shown or as_given else f"give the wheel radius, as in [{unit}*RADIUS]"
            found.append(
                _Mistake(sides, f"the tread speeds are the wheels' rates in {unit}{about}",
                         f"{unit}*{size:.3g}", wanted, rare, give)
            )  # fmt: skip
    if 1 / _UNIT.gear_ratios[1] <= wanted <= 1 / _UNIT.gear_ratios[0]:
        name = "the tread speeds are those of the motors, before their gear of about"
        unit = f"*{wanted * scale:.3g}"
        give = "" if shown else _BY_HAND
        found.append(_Mistake(sides, f"{name} {1 / wanted:.3g}", unit, wanted, 0.1, give))
    if 0.3 <= wanted <= 3.3:
        name = f"the tread speeds are {1 / wanted:.3g} times what they should be"
        give = "" if shown else _BY_HAND
        if rolls:
            give = f"{name}: give {wanted:.3g} times the wheel radius"
            name = "the wheel radius is not this robot's"
        found.append(_Mistake(sides, name, f"*{wanted * scale:.4g}", wanted, 0.2, give))
    if rolls:
        name = "a wheel's diameter is in the place of its radius"
        found.append(_Mistake(sides, name, "", 0.5, instead="give half the wheel radius"))
    return found


def check_consistency(
    drive: Observed,
    known: Measures,
    columns: _Columns = MappingProxyType({}),
    holds: Callable[[Mapping[str, str]], bool] = lambda units: True,
) -> list[Check]:
    """Compare the quantities of a log with each other and with the robot's measures.

    A remedy is offered if a log that is read in its units `holds`.
    """
    seen = _seen(drive, known)
    ratios = _ratios(seen, drive)
    wrong = [span for span, value in ratios if not span.holds(value)]
    found = _explain(seen, drive, known, columns, bool(wrong))
    remedy = "; or ".join(_sound(found, holds)) if wrong else ""
    if wrong and not remedy:
        remedy = (
            "no single mistake explains it: check that the vehicle is this robot, the units, the "
            "wheel radius and the measures"
        )
    result = [
        Check(span.what, remedy if span in wrong[:1] else "", value=value, expected=span.expected,
              ok=span not in wrong, rule=span.what)
        for span, value in ratios
    ]  # fmt: skip
    weighed = any(span.what == _RANGES["force"].what for span, _ in ratios)
    cost = sum(span.strain(value) for span, value in ratios)
    unusual = [one for one in found if one.strain < cost - _UNIT.gain]
    if weighed and not wrong and (remedies := _sound(unusual, holds)):
        result.append(Check(_UNUSUAL, "; or ".join(remedies), rule=_UNUSUAL))
    return result


class _Mended(NamedTuple):
    """What would explain a log, how unusual it leaves it, and the units to read it in."""

    strain: float
    text: str
    units: dict[str, str]


def _sound(remedies: Sequence[_Mended], holds: Callable[[Mapping[str, str]], bool]) -> list[str]:
    """Return the first remedies that help where they are applied."""
    return [
        one.text
        for one in islice(
            (one for one in remedies if not one.units or holds(one.units)), _UNIT.named
        )
    ]


def contradictions(log: DriveLog, vehicle: Vehicle) -> list[Check]:
    """Return what of a drive contradicts the vehicle, and what mistake would explain it."""
    return [one for one in check_consistency(log.observed, Measures.of(vehicle)) if not one.ok]


def _seen(drive: Observed, known: Measures) -> dict[str, float]:
    """Return what is seen of log and robot, by name."""
    quantities = ["slip_track", "distance", "rotation", "top_speed", "force", "electric", "step",
                  "voltage", *(["inertia"] if isfinite(known.mass) else [])]  # fmt: skip
    return {key: getattr(drive, key) for key in quantities} | {
        "track": known.track, "wheelbase": known.wheelbase, "mass": known.mass
    }  # fmt: skip


def strain(drive: Observed, known: Measures) -> float:
    """How far drive and measures are from what is typical: the sum of squares over the ratios."""
    return sum(span.strain(value) for span, value in _ratios(_seen(drive, known), drive))


def _explain(
    seen: Mapping[str, float], drive: Observed, known: Measures, columns: _Columns, wrong: bool
) -> list[_Mended]:
    """Name the mistakes without which all ratios hold, by how unusual they leave them."""
    # Where nothing is wrong, measures and batteries of any size are believed.
    there, tried = {*drive.channels} - {"voltage", "t"}, []
    no_units: dict[str, str] = {}
    if wrong:
        there = {*drive.channels, "track", "wheelbase", "mass"}
        swapped = {**seen, "track": seen["wheelbase"], "wheelbase": seen["track"]}
        tried.append((0.1, "track and wheelbase are swapped: swap them", swapped, no_units))
    for one in [*_MISTAKES, *_of_speeds(seen, known, columns)]:
        mapped = columns.get(one.channels[0])
        factor = one.factor / (_scale(mapped) if one in _MISTAKES else 1.0)
        if one.channels == ("t",) and (dated(drive.t) or (mapped is not None and mapped.unit)):
            continue  # a calendar's time, or a clock whose unit is known
        if there.issuperset(one.channels) and abs(log(factor)) > 0.1:  # else it is read so
            units = _units_of(one, columns)
            text = f"{one.name}: {_remedy(one, units, columns)}"
            tried.append((one.rarity, text, one.undo(seen, drive, factor), units))
    fitting: list[_Mended] = []
    for rarity, text, undone, units in tried:
        ratios = _ratios(undone, drive)
        if all(span.holds(value) for span, value in ratios):
            cost = sum(span.strain(value) for span, value in ratios) + rarity
            fitting.append(_Mended(cost, f"perhaps {text}", units))
    return sorted(fitting, key=lambda one: one[:2])


def _scale(mapped: Column | None) -> float:
    """Return the factor that a column's readings have; of a mean of wheels, that of each."""
    if mapped is None:
        return 1.0
    return abs(mapped.conversion.factor / mapped.changed(unit="").mean().conversion.factor)


def _units_of(one: _Mistake, columns: _Columns) -> dict[str, str]:
    """Return the units to map the readings in, by channel; none of a robot's measures."""
    if one.instead or one.channels[0] in ("track", "wheelbase", "mass"):
        return {}
    units = {}
    for channel in one.channels:
        mapped = columns.get(channel)
        sign = "-" if mapped is not None and mapped.conversion.factor < 0 else ""
        units[channel] = f"{sign}{one.unit}"
        if mapped is not None:
            units[channel] = mapped.changed(unit=units[channel]).mean().unit
    return units


def _remedy(one: _Mistake, units: Mapping[str, str], columns: _Columns) -> str:
    """Say how to map the readings."""
    if not units:
        return one.instead or f"give {one.unit}"
    names = {
        channel: columns[channel].written if channel in columns else "NAME" for channel in units
    }
    return (
        f"map {','.join(f'{channel}={names[channel]}[{unit}]' for channel, unit in units.items())}"
    )
