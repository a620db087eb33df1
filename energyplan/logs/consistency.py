"""Do a log, a robot's measures and its mass belong together, and what would explain it if not.

Odometry, gyroscope, pose, power, mass and geometry tell some quantities twice. Each such pair is a
ratio that lies in a known range whatever the robot and the ground; a unit, a wheel radius or a
measure that is wrong multiplies some of the ratios by a known factor. A mistake is named if undoing
it, and nothing else, brings every ratio back.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from math import isfinite, log, pi
from typing import Any

import numpy as np

from energyplan.logs.evidence import Evidence
from energyplan.vehicle import GRAVITY, Vehicle, predict_icr

_WHEEL_RADII = (0.04, 0.45)  # of skid-steer robots [m]
_GEAR_RATIOS = (4.0, 250.0)  # between a motor and its wheel
_NAMED = 4  # mistakes that are named, where several explain the same


@dataclass(frozen=True)
class Check:
    """A quantity that is in a log twice, or that must lie in a range."""

    what: str  # what was compared
    value: float  # what came out
    expected: str  # what was expected
    ok: bool  # whether it came out so
    remedy: str = ""  # what to do if not

    def __str__(self) -> str:
        return f"{self.what}: {self.value:.3g}, expected {self.expected}" + (
            f"; {self.remedy}" if self.remedy else ""
        )


@dataclass(frozen=True)
class Measures:
    """A robot's measures: track and wheelbase [m], mass [kg]; NaN where they are not known."""

    track: float = np.nan
    wheelbase: float = np.nan
    mass: float = np.nan

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
    usual: float
    why: str

    @property
    def expected(self) -> str:
        return f"{self.low:g} to {self.high:g} ({self.why})"

    def holds(self, value: float) -> bool:
        return not isfinite(value) or self.low <= value <= self.high

    def strain(self, value: float) -> float:
        """How far from usual a value is, in widths of the range."""
        if not isfinite(value):
            return 0.0
        return (log(value / self.usual) / log(self.high / self.low)) ** 2


# The slip track of real drives lies at 0.76 to 1.08 of that of equal point loads (Husky on floor,
# ice, loam; Warthog on grass), with a gyroscope's error on top; treads that dig themselves in turn
# less than they tell, and are left out for want of correlation.
_TURNING = _Range("slip track over that of the wheel positions", 0.6, 1.45, 0.93, "moment balance")
_DISTANCE = _Range("distance by the treads over that by the pose", 0.8, 1.35, 1.0, "little slip")
_ROTATION = _Range("yaw rate over the rate of the heading", 0.75, 1.35, 1.0, "same turning")
_TOP_SPEED = _Range("largest speed [m/s]", 0.02, 8.0, 0.7, "skid-steer robots")
_FORCE = _Range("power over weight times speed", 0.008, 4.0, 0.25, "resistance of wheels")
_ELECTRIC = _Range("power over voltage times current", 0.8, 1.25, 1.0, "the same power")
_DENSITY = _Range("mass over wheelbase times track [kg/m^2]", 40.0, 3000.0, 300.0, "built robots")
_ASPECT = _Range("wheelbase over track", 0.33, 2.5, 0.95, "skid-steer robots")
_INERTIA = _Range("mass by acceleration over that given", 0.62, 12.0, 1.1, "more with heavy drives")
_STEP = _Range("time step [s]", 1e-4, 3.0, 0.05, "logs of drives")


def _ratios(evidence: Evidence, known: Measures) -> list[tuple[_Range, float]]:
    """Return the ratios that evidence and measures make."""
    track, wheelbase = known.track, known.wheelbase
    geometric = 2 * predict_icr(wheelbase, track) if track and wheelbase else np.nan
    return [
        (_STEP, evidence.step),
        (_TOP_SPEED, evidence.top_speed),
        (_DISTANCE, evidence.distance),
        (_ROTATION, evidence.rotation),
        (_TURNING, evidence.slip_track / geometric),
        (_ASPECT, wheelbase / track),
        (_DENSITY, known.mass / (wheelbase * track)),
        (_FORCE, evidence.force / (known.mass * GRAVITY)),
        (_ELECTRIC, evidence.electric),
        (_INERTIA, evidence.inertia / known.mass),
    ]


@dataclass(frozen=True)
class _State:
    evidence: Evidence
    known: Measures

    def seeing(self, **values: Any) -> _State:
        """Return the state with other evidence."""
        return replace(self, evidence=replace(self.evidence, **values))


@dataclass(frozen=True)
class _Mistake:
    """Something that may have gone wrong, what undoes it, and how to say so."""

    name: str
    remedy: str
    undo: Callable[[_State], _State]
    rarity: float = 0.0


def _speeds(factor: float) -> Callable[[_State], _State]:
    """Undo tread speeds that are too large by the inverse of a factor."""

    def undo(state: _State) -> _State:
        seen = state.evidence
        return state.seeing(
            slip_track=seen.slip_track * factor,
            distance=seen.distance * factor,
            top_speed=seen.top_speed * factor,
            force=seen.force / factor,
            inertia=seen.inertia / factor**2,
        )

    return undo


def _gyro(factor: float) -> Callable[[_State], _State]:
    def undo(state: _State) -> _State:
        seen = state.evidence
        turned = seen.slip_track if seen.from_pose else seen.slip_track / factor
        return state.seeing(slip_track=turned, rotation=seen.rotation * factor)

    return undo


def _heading(factor: float) -> Callable[[_State], _State]:
    def undo(state: _State) -> _State:
        seen = state.evidence
        turned = seen.slip_track / factor if seen.from_pose else seen.slip_track
        return state.seeing(slip_track=turned, rotation=seen.rotation / factor)

    return undo


def _pose(factor: float) -> Callable[[_State], _State]:
    return lambda state: state.seeing(distance=state.evidence.distance / factor)


def _time(factor: float) -> Callable[[_State], _State]:
    def undo(state: _State) -> _State:
        seen = state.evidence
        return state.seeing(
            step=seen.step * factor,
            distance=seen.distance * factor,
            rotation=seen.rotation * factor,
            slip_track=seen.slip_track * factor if seen.from_pose else seen.slip_track,
            inertia=seen.inertia * factor,
        )

    return undo


def _power(factor: float) -> Callable[[_State], _State]:
    def undo(state: _State) -> _State:
        seen = state.evidence
        return state.seeing(
            force=seen.force * factor,
            electric=seen.electric * factor,
            inertia=seen.inertia * factor,
        )

    return undo


def _electricity(factor: float) -> Callable[[_State], _State]:
    """Undo a voltage or a current that is too large by the inverse of a factor."""

    def undo(state: _State) -> _State:
        electric = state.evidence.electric
        if isfinite(electric):  # the power was measured beside them
            return state.seeing(electric=electric / factor)
        return _power(factor)(state)

    return undo


def _measures(
    track: float = 1.0, wheelbase: float = 1.0, mass: float = 1.0, swap: bool = False
) -> Callable[[_State], _State]:
    def undo(state: _State) -> _State:
        known = state.known
        sizes = (known.wheelbase, known.track) if swap else (known.track, known.wheelbase)
        return replace(
            state, known=Measures(sizes[0] * track, sizes[1] * wheelbase, known.mass * mass)
        )

    return undo


def _mistakes(state: _State) -> list[_Mistake]:
    """Return what may have gone wrong, in the order of how often it does."""
    evidence = state.evidence
    both = "v_left=NAME[{0}],v_right=NAME[{0}]".format
    found = [
        _Mistake("the tread speeds are in km/h", f"map {both('km/h')}", _speeds(1 / 3.6)),
        _Mistake("the tread speeds are in mm/s", f"map {both('mm/s')}", _speeds(1e-3)),
        _Mistake("the tread speeds are in cm/s", f"map {both('cm/s')}", _speeds(1e-2)),
        _Mistake("the tread speeds are in mph", f"map {both('mph')}", _speeds(0.44704), 0.1),
        _Mistake("the tread speeds are in ft/s", f"map {both('ft/s')}", _speeds(0.3048), 0.1),
        _Mistake(
            "a wheel's diameter is in the place of its radius", "give half the wheel radius",
            _speeds(0.5),
        ),
        _Mistake("t is in ms", "map t=NAME[ms]", _time(1e-3)),
        _Mistake("t is in us", "map t=NAME[us]", _time(1e-6)),
        _Mistake("t is in ns", "map t=NAME[ns]", _time(1e-9)),
        _Mistake("t is in minutes", "map t=NAME[min]", _time(60.0)),
        _Mistake("yaw_rate is in degrees", "map yaw_rate=NAME[deg/s]", _gyro(pi / 180)),
        _Mistake("yaw_rate is in rpm", "map yaw_rate=NAME[rpm]", _gyro(pi / 30), 0.1),
        _Mistake("yaw is in degrees", "map yaw=NAME[deg]", _heading(pi / 180)),
        _Mistake("x and y are in cm", "map x=NAME[cm],y=NAME[cm]", _pose(1e-2)),
        _Mistake("x and y are in mm", "map x=NAME[mm],y=NAME[mm]", _pose(1e-3)),
        _Mistake("x and y are in ft", "map x=NAME[ft],y=NAME[ft]", _pose(0.3048), 0.1),
        _Mistake("the power is in kW", "map it with its unit, power=NAME[kW]", _power(1e3)),
        _Mistake("the power is in mW", "map it with its unit, power=NAME[mW]", _power(1e-3)),
        _Mistake("the power is in hp", "map it with its unit, power=NAME[hp]", _power(745.7), 0.1),
        _Mistake("the current is in mA", "map current=NAME[mA]", _electricity(1e-3)),
        _Mistake("the voltage is in mV", "map voltage=NAME[mV]", _electricity(1e-3), 0.1),
        _Mistake("track and wheelbase are in cm", "give metres", _measures(1e-2, 1e-2)),
        _Mistake("track and wheelbase are in mm", "give metres", _measures(1e-3, 1e-3)),
        _Mistake(
            "track and wheelbase are in inches", "give metres", _measures(0.0254, 0.0254), 0.1
        ),
        _Mistake("the track is in cm", "give metres", _measures(track=1e-2)),
        _Mistake("the track is in mm", "give metres", _measures(track=1e-3)),
        _Mistake("the wheelbase is in cm", "give metres", _measures(wheelbase=1e-2)),
        _Mistake("the wheelbase is in mm", "give metres", _measures(wheelbase=1e-3)),
        _Mistake("track and wheelbase are swapped", "swap them", _measures(swap=True), 0.1),
        _Mistake("the mass is in g", "give kilograms", _measures(mass=1e-3)),
        _Mistake("the mass is in lb", "give kilograms", _measures(mass=0.45359237)),
        _Mistake("the mass is a weight in N", "give kilograms", _measures(mass=1 / 9.81), 0.1),
        _Mistake("the mass is in t", "give kilograms", _measures(mass=1e3)),
    ]  # fmt: skip
    # The factor that the pose asks for, or else the turning: what a wheel radius would have to be.
    geometric = 2 * predict_icr(state.known.wheelbase, state.known.track)
    wanted = (
        1 / evidence.distance
        if isfinite(evidence.distance)
        else (_TURNING.usual * geometric / evidence.slip_track)
    )
    if isfinite(wanted) and wanted > 0:
        for unit, rate in (("rad/s", 1.0), ("rpm", pi / 30), ("deg/s", pi / 180)):
            radius = wanted / rate
            if _WHEEL_RADII[0] <= radius <= _WHEEL_RADII[1]:
                found.append(
                    _Mistake(
                        f"the tread speeds are the wheels' rates in {unit}",
                        f"map {both(f'{unit}*{radius:.3g}')}: the wheel radius is about "
                        f"{radius:.3g} m",
                        _speeds(wanted),
                        0.0 if unit != "deg/s" else 0.3,
                    )
                )
        if 1 / _GEAR_RATIOS[1] <= wanted <= 1 / _GEAR_RATIOS[0]:
            found.append(
                _Mistake(
                    "the tread speeds are those of the motors, before their gear",
                    f"divide them by its ratio, about {1 / wanted:.3g}, as in "
                    f"{both(f'*{wanted:.3g}')}",
                    _speeds(wanted),
                    0.1,
                )
            )
        if 0.3 <= wanted <= 3.3:
            found.append(
                _Mistake(
                    "the wheel radius is not this robot's",
                    f"the tread speeds are {1 / wanted:.3g} times what they should be: give "
                    f"{wanted:.3g} times the wheel radius",
                    _speeds(wanted),
                    0.2,
                )
            )
    return found


def check_consistency(evidence: Evidence, known: Measures) -> list[Check]:
    """Compare the quantities of a log with each other and with the robot's measures."""
    state = _State(evidence, known)
    ratios = [(span, value) for span, value in _ratios(evidence, known) if isfinite(value)]
    wrong = [span for span, value in ratios if not span.holds(value)]
    remedy = _explain(state) if wrong else ""
    if wrong and not remedy:
        remedy = (
            "no single mistake explains it: check that the vehicle is this robot, the units, the "
            "wheel radius and the measures"
        )
    return [
        Check(span.what, value, span.expected, span not in wrong, remedy if span in wrong else "")
        for span, value in ratios
    ]


def strain(evidence: Evidence, known: Measures) -> float:
    """How far evidence and measures are from what is usual: the sum of squares over the ratios."""
    ratios = [(span, value) for span, value in _ratios(evidence, known) if isfinite(value)]
    return sum(span.strain(value) for span, value in ratios)


def _explain(state: _State) -> str:
    """Name the mistakes that explain all the ratios, the likeliest first."""
    fitting = []
    for mistake in _mistakes(state):
        undone = mistake.undo(state)
        ratios = [pair for pair in _ratios(undone.evidence, undone.known) if isfinite(pair[1])]
        if all(span.holds(value) for span, value in ratios):
            strain = sum(span.strain(value) for span, value in ratios) + mistake.rarity
            fitting.append((strain, mistake))
    fitting.sort(key=lambda pair: pair[0])
    named = [f"perhaps {mistake.name}: {mistake.remedy}" for _, mistake in fitting[:_NAMED]]
    return "; or ".join(named)
