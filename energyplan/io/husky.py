"""Drives of a Clearpath Husky A200 as BorealTC records them, converted to drive logs.

A drive is a file ``pro_NN.csv`` with ``time`` [s], ``curL``, ``curR`` [A], ``velL``, ``velR`` [m/s]
and mostly a file ``imu_NN.csv`` with ``time``, ``wx``, ``wy``, ``wz`` [rad/s], ``ax``, ``ay``,
``az`` [m/s^2] from a clock of its own.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import pi
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from energyplan.errors import DriveLogError
from energyplan.io.bags import TopicMap, topic_map
from energyplan.io.files import is_file
from energyplan.logs import DriveLog, SetAside
from energyplan.logs.align import LARGEST_OFFSET, Offset, find_offset, find_runs
from energyplan.logs.tables import Recording, read_table
from energyplan.path import FloatArray

WHEEL_COLUMNS = ("time", "curL", "curR", "velL", "velR")
"""Columns of a wheel file."""
NOT_SAID = (
    "time, curL, curR, velL, velR may be a Husky's motor currents, from which its motors and wheel "
    "radius make a power; nothing in the file says whose they are. If they are a Husky's, give "
    "--vehicle husky_a200 (start: --like husky_a200; Python: topics='husky'); else say which "
    "columns are what, as in --columns t=time,v_left=velL,v_right=velR,power=NAME"
)
"""What to say of such a file where nobody said whose it is."""
_CREDIBLE = 0.3  # share of the yaw rate's variance from which a clock offset is believed


@dataclass(frozen=True)
class HuskyDrive:
    """The drive train, as far as the conversion of current to power needs it."""

    back_emf: float = 0.141 / pi
    gear: float = 78.71  # reduction from motor to wheel
    wheel_radius: float = 0.165  # wheel radius [m]
    dead_band: float = 0.59  # smallest current that the sensor shows [A]
    quantum: float = 1 / 127  # step of the speed readings [m/s]

    @property
    def power_per_current(self) -> float:
        """Mechanical power per ampere and tread speed [V s/m]: 21.4 for a Husky."""
        return self.back_emf * self.gear / self.wheel_radius


def read_husky(wheels: str | Path, *, blind: Literal["keep", "drop"] = "keep") -> DriveLog:
    r"""Read a drive of a Husky.

    The mechanical power of a side is motor constant times current times tread speed. Currents in
    the dead band count as half of it. The clock offset of the IMU is the one at which its yaw rate
    follows the tread speeds best; its readings are then averaged around each wheel sample.

    The sensors read nothing while a motor generates, as the inner one may in an arc. Such samples
    show only that a side draws less than the dead band; `set_aside` counts them. So the log says
    that its powers have no sign, and fits use the total of both sides.

    Source: LaRocque et al. (2024), arXiv 2403.16877.
    """
    return husky_log(read_table(wheels, DriveLogError), Path(wheels), blind)


def known_husky(
    table: Recording, wheels: Path, topics: TopicMap | str | Path | None
) -> DriveLog | None:
    """Return the drive of a Husky's wheel file, if the robot is said to be one; of others none."""
    if not set(WHEEL_COLUMNS) <= set(table.columns):
        return None
    if topics is None or topic_map(topics).name != "husky":
        raise DriveLogError(f"{wheels.name}: {NOT_SAID}")
    return husky_log(table, wheels)


def husky_log(table: Recording, wheels: Path, blind: Literal["keep", "drop"] = "keep") -> DriveLog:
    """Return the drive of a wheel file and of its IMU's file in the same folder."""
    train = HuskyDrive()
    t, current_left, current_right, left, right = map(table.column, WHEEL_COLUMNS)
    channels = {"t": t, "v_left": left, "v_right": right}
    aside: list[SetAside] = []
    for name, current, speed in (
        ("p_left", current_left, left), ("p_right", current_right, right)
    ):  # fmt: skip
        faint = current <= train.dead_band
        drawn = np.where(faint, 0.5 * train.dead_band, current)
        channels[name] = train.power_per_current * drawn * np.abs(speed)
        reason = f"{name}: current within the dead band of {train.dead_band:g} A; half of it used"
        _note(aside, table, faint & (speed != 0), reason)
    channels = {name: np.array(values) for name, values in channels.items()}
    # In an arc, beyond rounding, both treads roll the same way at different speeds.
    slow, step = {"left": np.abs(left), "right": np.abs(right)}, 1.5 * train.quantum
    arc = (left * right > 0) & (np.minimum(*slow.values()) > step)
    lost = np.zeros(len(t), bool)
    for side, other, current in (
        ("left", "right", current_left), ("right", "left", current_right)
    ):  # fmt: skip
        inner = arc & (slow[other] - slow[side] > step) & (current <= train.dead_band)
        channels[f"p_{side}"][inner] = 0.0
        lost |= inner
    fate = "taken as drawing nothing" if blind == "keep" else "left out"
    _note(aside, table, lost, f"the inner motor of an arc reads nothing and may generate; {fate}")
    warnings = [
        f"speeds come in steps of {train.quantum:.4f} m/s",
        "the current sensors see no direction: what a motor returns while it generates or "
        "brakes is not known",
    ]
    file = _beside(wheels)
    if file is None:
        warnings.append("there is no IMU, so the yaw rate and the tread ICRs are not known")
    else:
        readings = read_table(file, DriveLogError)
        channels |= _inertial(readings, t, right - left, warnings)
    label = "/".join(wheels.parts[-2:])
    log = DriveLog.from_columns(channels, label, table.place)
    if blind == "drop":
        log = _without(log, t[lost])
    return replace(
        log, set_aside=(*aside, *log.set_aside), warnings=(*warnings, *log.warnings), signed=False
    )


def _without(log: DriveLog, times: FloatArray) -> DriveLog:
    """Return a log without the samples at these times."""
    kept = ~np.isin(log.t, times)
    if np.count_nonzero(kept) < 2:
        raise DriveLogError(
            f"{log.name}: the inner motor reads nothing in all samples but "
            f"{np.count_nonzero(kept)}; drive straight and on the spot too, or read with "
            "blind='keep'"
        )
    return replace(log, channels={name: values[kept] for name, values in log.channels.items()})


def _note(aside: list[SetAside], table: Recording, chosen: NDArray[np.bool_], reason: str) -> None:
    """Count samples."""
    some = np.flatnonzero(chosen)
    if len(some):
        names = ", ".join(table.place(int(k)) for k in some[:3])
        where = f"{names}, ..." if len(some) > 3 else names
        aside.append(SetAside(reason, len(some), where))


def _beside(wheels: Path) -> Path | None:
    """Return the IMU file that belongs to the wheel file."""
    file = wheels.with_name(wheels.name.replace("pro_", "imu_", 1))
    return file if file != wheels and is_file(file) else None


def _inertial(
    imu: Recording, t: FloatArray, difference: FloatArray, warnings: list[str]
) -> dict[str, FloatArray]:
    """Yaw rate and forward acceleration at the times of the wheel samples; NaN where unknown."""
    clock, rate, forward = map(imu.column, ("time", "wz", "ax"))
    bad = ~(np.isfinite(clock) & np.isfinite(rate) & np.isfinite(forward))
    if np.any(bad) or len(clock) < 3 or np.any(np.diff(clock) <= 0):
        k = int(np.argmax(bad if np.any(bad) else np.append(False, np.diff(clock) <= 0)))
        raise DriveLogError(
            f"{imu.source}, {imu.place(k)}: time must increase, and wz and ax must be finite, over "
            "three rows or more; repair the file or read the drive without it"
        )
    offset = _clock_offset(clock, rate, t, difference)
    seconds = 0.0
    if offset is None:
        warnings.append(
            "the turning is too steady to find the IMU's clock offset; zero is assumed, but it "
            "may be a second or more"
        )
    else:
        seconds = offset.seconds
        way = "behind" if seconds > 0 else "ahead of"
        warnings.append(
            f"the IMU's clock is {abs(seconds):.3f} s {way} the wheels'; set right (its yaw rate "
            f"then explains {offset.explained:.3f} of the variance, {offset.before:.3f} as logged)"
        )
    half = 0.5 * float(np.median(np.diff(t)))
    edges = np.stack([t - half, t + half]) + seconds
    inside = (edges[0] >= clock[0]) & (edges[1] <= clock[-1])
    found = {}
    for name, values in (("yaw_rate", rate), ("accel_x", forward)):
        steps = 0.5 * np.diff(clock) * (values[1:] + values[:-1])
        integral = np.concatenate([[0.0], np.cumsum(steps)])
        low, high = np.interp(edges, clock, integral)
        found[name] = np.where(inside, (high - low) / (2 * half), np.nan)
    return found


def _clock_offset(
    clock: FloatArray, rate: FloatArray, t: FloatArray, difference: FloatArray
) -> Offset | None:
    """Find by how much the IMU's clock lags behind the wheels', if the drive shows it."""
    common = (clock >= t[0]) & (clock <= t[-1])
    count = int(np.count_nonzero(common))
    if count < 3:
        return None
    now = clock[common]
    regressor = np.interp(now, t, difference)
    if np.std(regressor) < 0.02:  # a couple of speed steps: straight, or one steady spin
        return None
    largest = min(LARGEST_OFFSET, float(now[-1] - now[0]) / 5)
    offset = find_offset(
        "yaw_rate", now, rate[common], [regressor], find_runs(now), largest=largest
    )
    usable = offset is not None and offset.explained > _CREDIBLE and offset.sign > 0
    return offset if usable else None
