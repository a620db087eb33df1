"""What a drive log tells of the robot that drove it: slip track, distances, forces, inertia."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import inf

import numpy as np

from energyplan.logs._smooth import derivative
from energyplan.path import FloatArray

_WINDOW = 3.0  # length of the stretches over which distances are compared [s]
_ENOUGH = 20  # samples or windows below which nothing is concluded
_JITTER = 6.0  # least displacement of a pose, over the noise of its readings, that tells a length
_CHANCE = 4.0  # standard errors beyond which a mean power is none by chance
_ALIKE = 0.9  # correlation from which the turning tells a slip track
_INERTIA_ERROR = 0.13  # share to which a mass must be told, three of which are the range's margin


@dataclass(frozen=True)
class Evidence:
    """What a log shows of a robot; NaN where it does not."""

    slip_track: float = np.nan  # [m]
    from_pose: bool = False
    distance: float = np.nan  # way of the treads over that of the pose, on straight stretches
    rotation: float = np.nan  # gyroscope's yaw rate over that of the heading, whatever their signs
    top_speed: float = np.nan  # speed that is reached one hundredth of the time [m/s]
    force: float = np.nan  # mean power over mean speed while driving [N]
    electric: float = np.nan  # power over voltage times current
    inertia: float = np.nan  # mass that the power of speeding up tells [kg]
    step: float = np.nan  # time between samples [s]


def gather(
    channels: Mapping[str, FloatArray], power: FloatArray, runs: Sequence[slice]
) -> Evidence:
    """Find what a log shows of the robot."""
    t, left, right = channels["t"], channels["v_left"], channels["v_right"]
    rates = yaw_rates(channels, runs)
    rate = rates.get("yaw_rate", rates.get("yaw"))
    mean = 0.5 * (left + right)
    effort = 0.5 * (np.abs(left) + np.abs(right))
    top = float(np.quantile(effort, 0.99))
    moving = effort > max(0.1 * top, 1e-6)
    force = np.nan
    if np.count_nonzero(moving) >= _ENOUGH:
        drawn = power[moving]
        chance = _CHANCE * float(drawn.std()) / np.sqrt(len(drawn))  # a dead sensor's noise
        if abs(drawn.mean()) > chance:
            force = float(np.abs(drawn.mean()) / effort[moving].mean())
    return Evidence(
        slip_track=np.nan if rate is None else _slip_track(rate, right - left),
        from_pose="yaw_rate" not in rates,
        distance=distance_ratio(channels, runs),
        rotation=_rotation(t, channels, rates),
        top_speed=top if np.count_nonzero(moving) >= _ENOUGH else np.nan,
        force=force if force else np.nan,
        electric=_electric(channels),
        inertia=_inertia(t, mean, effort, right - left, power, runs),
        step=float(np.quantile(np.diff(t), 0.1)) if len(t) >= 5 * _ENOUGH else np.nan,
    )


def yaw_rates(channels: Mapping[str, FloatArray], runs: Sequence[slice]) -> dict[str, FloatArray]:
    """Return the yaw rates that a log tells [rad/s], by the channel that they come from."""
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
    """Tell whether readings are large for long enough to conclude from, not for one jerk."""
    size = np.abs(values)
    return bool(np.count_nonzero(size > 0.2 * np.max(size, initial=0.0)) >= _ENOUGH)


def _slip_track(rate: FloatArray, difference: FloatArray) -> float:
    """Difference of the tread speeds over the yaw rate; NaN where they do not follow each other."""
    if not lasts(difference):
        return np.nan
    if abs(correlation(rate, difference)) < _ALIKE:
        return np.nan
    return abs(float(difference @ difference) / float(difference @ rate))


def _rotation(
    t: FloatArray, channels: Mapping[str, FloatArray], rates: Mapping[str, FloatArray]
) -> float:
    """Gyroscope over heading; of a heading that jitters, over what it changes in some seconds."""
    if len(rates) < 2 or not lasts(rates["yaw_rate"]):
        return np.nan
    gyro, heading = rates["yaw_rate"], rates["yaw"]
    angles = _integral(t, gyro), np.unwrap(channels["yaw"])
    for window in (0.0, _WINDOW, 3 * _WINDOW):
        if window > 0.0:
            edges = np.arange(t[0], t[-1], window)
            gyro, heading = (np.diff(np.interp(edges, t, angle)) for angle in angles)
        if len(gyro) >= _ENOUGH and abs(correlation(gyro, heading)) >= 0.7:
            # The jitter of the heading is in the denominator only where it is the regressor.
            return abs(float(gyro @ gyro) / float(gyro @ heading))
    return np.nan


def distance_ratio(channels: Mapping[str, FloatArray], runs: Sequence[slice]) -> float:
    """Way of the treads over that of the pose, on straight stretches.

    Displacements over whole stretches are compared, not the lengths of paths: a pose that jitters
    goes no further.
    """
    if not {"x", "y"} <= set(channels):
        return np.nan
    t = channels["t"]
    step = float(np.median(np.diff(t)))
    # Some stretches of some samples, whatever their time: its unit may be the mistake.
    window = max(min(_WINDOW, step * len(t) / 40), 10 * step)
    rolled: list[FloatArray] = []
    gone: list[FloatArray] = []
    for run in runs:
        edges = np.arange(t[run][0], t[run][-1], window)
        if len(edges) < 2:
            continue
        x, y = (np.interp(edges, t[run], channels[name][run]) for name in ("x", "y"))
        left, right = (
            np.diff(np.interp(edges, t[run], _integral(t[run], channels[name][run])))
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
    if np.mean(pose**2) < _JITTER**2 * float(np.mean(jitter**2)) / 6.0:
        return np.nan
    ratio = float(wheel @ wheel) / float(wheel @ pose)
    # Stretches that contradict each other (slipping, a lost pose) tell nothing.
    scatter = float(np.std(pose * ratio - wheel) / wheel.mean())
    return ratio if scatter < 0.5 else np.nan


def _integral(t: FloatArray, values: FloatArray) -> FloatArray:
    return np.concatenate([[0.0], np.cumsum(0.5 * np.diff(t) * (values[1:] + values[:-1]))])


def _electric(channels: Mapping[str, FloatArray]) -> float:
    """Power over voltage times current, where a log has both."""
    if not {"voltage", "current"} <= set(channels):
        return np.nan
    if "power" in channels:
        power = channels["power"]
    elif {"p_left", "p_right"} <= set(channels):
        power = channels["p_left"] + channels["p_right"]
    else:
        return np.nan
    product = channels["voltage"] * channels["current"]
    if abs(correlation(power, product)) < 0.8:
        return np.nan
    return abs(float(power @ product) / float(product @ product))


def _inertia(
    t: FloatArray,
    mean: FloatArray,
    effort: FloatArray,
    difference: FloatArray,
    power: FloatArray,
    runs: Sequence[slice],
) -> float:
    """Mass that the power of speeding up tells; NaN where it hardly tells it."""
    accel = derivative(t, mean, runs, 0.4)
    gain = mean * accel
    best, found = inf, np.nan
    for lag in np.arange(-0.2, 0.81, 0.1):
        shifted = np.interp(t - lag, t, np.clip(gain, 0, None))
        back = np.interp(t - lag, t, np.clip(gain, None, 0))
        X = np.stack([shifted, back, effort, np.abs(difference), np.ones(len(t))])
        scale = np.sqrt((X * X).sum(axis=1))
        if np.any(scale[:1] == 0) or not np.all(np.isfinite(scale)):
            return np.nan
        scale[scale == 0] = 1.0
        unit = X / scale[:, None]
        gram = unit @ unit.T + 1e-9 * np.eye(len(X))
        solution = np.linalg.solve(gram, unit @ power)
        residual = power - solution @ unit
        loss = float(residual @ residual)
        if loss < best:
            best = loss
            variance = loss / len(t) * _repeats(residual) * float(np.linalg.inv(gram)[0, 0])
            error = np.sqrt(variance) / scale[0]
            mass = float(solution[0] / scale[0])
            found = mass if mass > 0 and error < _INERTIA_ERROR * mass else np.nan
    return found


def _repeats(residual: FloatArray) -> float:
    """How many neighbouring samples repeat each other: the sum of the autocorrelation."""
    size = float(residual @ residual)
    total = 1.0
    for lag in range(1, len(residual) // 4):
        alike = float(residual[lag:] @ residual[:-lag]) / size if size > 0 else 0.0
        if alike < 0.05:
            break
        total += 2 * alike
    return total
