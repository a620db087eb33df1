"""Signs, sides and sensors that contradict each other in a log, whatever the robot."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from energyplan.logs.evidence import correlation, distance_ratio, lasts, yaw_rates
from energyplan.logs.held import POWERS, held_periods
from energyplan.logs.one_side import (
    compare_powers,
    find_dead,
    find_dying,
    find_false_speeds,
    find_frozen,
    find_lost_sign,
)
from energyplan.path import FloatArray

_POSE = {"x", "y", "yaw"}
_ENOUGH = 20  # samples below which nothing is concluded
_HANGS = 0.3  # time of a repeated reading from which the sensor hangs [s]
_REPEATED = 0.01  # share of the driving that it must do so
_CALM = 0.33  # share of the driving, in which speeds change least, that counts as steady
_STEPS = 0.05  # share of readings that repeat where a sensor reads in steps


def find_contradictions(
    channels: Mapping[str, FloatArray], power: FloatArray, runs: Sequence[slice]
) -> list[str]:
    """Compare the channels of a log with each other."""
    told = [
        *find_false_speeds(channels, runs),
        *find_dead(channels, yaw_rates(channels, runs)),
        *find_dying(channels),
        *find_frozen(channels, yaw_rates(channels, runs)),
        _sides(channels, runs),
        compare_powers(channels),
        find_lost_sign(channels),
        *_repeats(channels, power),
        _course(channels, runs),
        _motor_current(channels, power),
        _distance(channels, runs),
    ]
    return [text for text in told if text]


def _repeats(channels: Mapping[str, FloatArray], power: FloatArray) -> list[str]:
    """Whether a power that changes with every sample stays the same for a while in driving.

    A sensor that hangs, one that drops out and one at the end of its range all repeat a reading to
    the last bit. One that reads in steps does so all the time, or wherever the robot goes steadily.
    """
    t = channels["t"]
    effort = np.abs(channels["v_left"]) + np.abs(channels["v_right"])
    moving = effort > 0.15 * float(np.quantile(effort, 0.95))
    least = max(5, round(_HANGS / float(np.median(np.diff(t)))))
    turned = np.append(False, np.diff(effort) != 0.0)
    speeds = np.stack([channels["v_left"], channels["v_right"]])
    change = np.abs(np.diff(speeds, prepend=speeds[:, :1])).sum(axis=0)
    calm = float(np.quantile(change[moving], _CALM)) if np.any(moving) else 0.0
    steady = moving & (change <= calm)
    told = []
    seldom = held_periods(channels)
    for name in POWERS:
        if name not in channels or name in seldom:
            continue
        values = channels[name]
        starts = np.flatnonzero(np.append(True, np.diff(values) != 0.0))
        counts = np.diff(np.append(starts, len(values)))
        drives = np.logical_and.reduceat(moving, starts)
        if name.startswith("p_"):  # of a side that returns nothing, zero is a reading
            drives &= (values[starts] != 0.0) | (power[starts] == 0.0)
        hangs = drives & (counts >= least)
        lost, usual = int(counts[hangs].sum()), counts[drives & ~hangs]
        if np.count_nonzero(hangs) < 3 or lost < _REPEATED * np.count_nonzero(moving):
            continue
        if not len(usual) or np.mean(usual > 1) > _STEPS:
            continue
        if np.mean(turned[np.repeat(hangs, counts)]) < 0.5:
            continue  # without noise, all that is driven steadily repeats
        held = values[starts[hangs]]
        repeats = np.append(False, np.diff(values) == 0.0)
        if np.ptp(held) > 0.0 and np.mean(repeats[steady]) > 0.5:
            continue
        if np.all(held == held[0]) and held[0] == 0.0:
            what = "drops out to 0"
        elif np.all(held == held[0]) and held[0] in (values.max(), values.min()):
            what = f"ends at {held[0]:.4g}, which is the end of its range"
        else:
            what = "hangs"
        share = lost / np.count_nonzero(moving)
        told.append(
            f"{name} {what} in {share:.0%} of the driving, first {t[starts[hangs][0]] - t[0]:.6g} "
            "s into the log: "
            "it repeats a reading where others change with every sample; mend the sensor, or "
            "leave such stretches out"
        )
    return told


def turning_against(channels: Mapping[str, FloatArray], runs: Sequence[slice], name: str) -> str:
    """Say what is wrong where a yaw rate falls while the right tread is the faster."""
    mirrored = mirrored_side(channels, runs)
    if mirrored:
        return _in_the_mirror(mirrored)
    difference = channels["v_right"] - channels["v_left"]
    signs = {
        source: correlation(rate, difference) for source, rate in yaw_rates(channels, runs).items()
    }
    unit = "rad" if name == "yaw" else "rad/s"
    flip = f"map {name}=NAME[-{unit}]"
    others = [value for source, value in signs.items() if source != name]
    if any(value > 0.3 for value in others):
        kind = "the gyroscope's axis is flipped" if name == "yaw_rate" else "yaw counts clockwise"
        return f"{kind}, for the other channel turns with the treads; {flip}"
    backwards = course(channels, runs)
    if np.isfinite(backwards) and abs(backwards) > 2.4:
        return (
            "the treads run backwards; map both with a minus, as in "
            "v_left=NAME[-m/s],v_right=NAME[-m/s]"
        )
    if abs(backwards) < 0.6:  # the heading goes with the pose
        return (
            "left and right are swapped; swap them in the column mapping; or all of the pose is in "
            "a frame whose z axis points down (NED): map y=NAME[-m],yaw=NAME[-rad] and, if there "
            "is one, yaw_rate=NAME[-rad/s]"
        )
    return (
        f"left and right are swapped, or {name} counts clockwise; swap them in the column mapping, "
        f"or {flip}"
    )


class _Factors(NamedTuple):
    """By what the sides' speeds must be multiplied to make the yaw rate [1/m]."""

    left: float
    right: float

    @property
    def mirrored(self) -> str:
        """The side that counts the other way; empty where none does."""
        if self.left * self.right > 0 and 0.4 < abs(self.right / self.left) < 2.5:
            return "v_right" if self.right < 0 else "v_left"
        return ""


def _factors(channels: Mapping[str, FloatArray], runs: Sequence[slice]) -> list[_Factors]:
    """Return the factors of each yaw rate that the speeds' difference does not make as well."""
    speeds = np.stack([channels["v_left"], channels["v_right"]])
    gram = speeds @ speeds.T
    scale = np.sqrt(np.diag(gram))
    if np.any(scale <= 0):
        return []
    # Speeds that hardly differ but for their sign tell no factor of each, only that of the sum.
    apart = np.linalg.cond(gram / np.outer(scale, scale)) <= 400
    total = speeds.sum(axis=0)
    found = []
    for rate in filter(lasts, yaw_rates(channels, runs).values()):
        if apart:
            factors = np.linalg.solve(gram, speeds @ rate)
        elif speeds[0] @ speeds[1] < 0.0 < total @ total:
            factors = np.full(2, total @ rate / (total @ total))
        else:
            continue
        alike = correlation(factors @ speeds, rate)
        as_they_are = correlation(speeds[1] - speeds[0], rate)
        if alike >= 0.93 and 1.0 - as_they_are**2 >= 2.0 * (1.0 - alike**2):
            found.append(_Factors(*map(float, factors)))
    return found


def mirrored_side(channels: Mapping[str, FloatArray], runs: Sequence[slice]) -> str:
    """Name the side whose speed counts the other way, as of a motor mounted in the mirror."""
    return next((one.mirrored for one in _factors(channels, runs)), "")


def _in_the_mirror(side: str) -> str:
    return (
        "the robot turns with the sum of the tread speeds, not with their difference: "
        f"{side} counts the other way; map {side} with a minus before its unit, as in "
        f"{side}=NAME[-m/s]"
    )


def _sides(channels: Mapping[str, FloatArray], runs: Sequence[slice]) -> str:
    """Whether the sides' speeds count alike: the yaw rate must be that of their difference.

    The yaw rate is fitted by both speeds: with opposite factors of one size if all is well, with
    factors of one sign where a side counts the other way, and with factors of two sizes where the
    sides have two units.
    """
    scale = np.sqrt([np.sum(channels[side] ** 2) for side in ("v_left", "v_right")])
    for one in _factors(channels, runs):
        shares = np.abs(one) * scale
        if shares.min() < 0.08 * shares.max():
            turning = ("v_left", "v_right")[int(np.argmax(shares))]
            return (
                f"the yaw rate follows {turning} alone, as if it were an angular speed and the "
                "other the robot's forward speed: tread speeds are those of the left and of the "
                "right wheels"
            )
        if one.mirrored:
            return _in_the_mirror(one.mirrored)
        size = abs(one.right / one.left) if one.left else np.inf
        if one.left * one.right < 0 and not 0.6 < size < 1.6:
            return (
                f"the yaw rate shows that v_left counts {size:.3g} times as much as v_right: one "
                "side is in another unit or has another wheel radius; give both the same, or map "
                f"v_left=NAME[*{1 / size:.4g}]"
            )
    return ""


def course(channels: Mapping[str, FloatArray], runs: Sequence[slice]) -> float:
    """Angle from where the treads would take the robot to where the pose goes [rad]."""
    if not set(channels) >= _POSE:
        return np.nan
    direct = _courses(channels, runs).direct
    return direct.angle if direct.alike >= 0.7 else np.nan


class _Course(NamedTuple):
    """From where the treads would take the robot to where the pose goes."""

    angle: float  # angle between both [rad]
    alike: float  # how well one follows the other, at most 1


class _Courses(NamedTuple):
    """The pose against the treads' way, and against that way's mirror image in the x axis."""

    direct: _Course
    mirrored: _Course


def _courses(channels: Mapping[str, FloatArray], runs: Sequence[slice]) -> _Courses:
    """Compare the pose with the treads' way, and with that way's mirror image in the x axis."""
    t, speed = channels["t"], 0.5 * (channels["v_left"] + channels["v_right"])
    heading = np.unwrap(channels["yaw"])
    product, image, predicted, measured = 0.0 + 0.0j, 0.0 + 0.0j, 0.0, 0.0
    for run in runs:
        edges = np.arange(t[run][0], t[run][-1], max(1.0, 5 * float(np.median(np.diff(t)))))
        if len(edges) < 2:
            continue
        # The heading amid two readings: in a step, a robot that turns goes along neither.
        amid, rolled = (0.5 * (part[run][1:] + part[run][:-1]) for part in (heading, speed))
        way = np.append(0.0, np.cumsum(rolled * np.exp(1j * amid) * np.diff(t[run])))
        place = channels["x"][run] + 1j * channels["y"][run]
        goes = np.diff(np.interp(edges, t[run], way.real) + 1j * np.interp(edges, t[run], way.imag))
        went = np.diff(
            np.interp(edges, t[run], place.real) + 1j * np.interp(edges, t[run], place.imag)
        )
        product += complex(np.vdot(goes, went))
        image += complex(np.vdot(goes.conj(), went))
        predicted += float(np.vdot(goes, goes).real)
        measured += float(np.vdot(went, went).real)
    norm = np.sqrt(predicted * measured)
    if norm <= 0:
        return _Courses(_Course(np.nan, 0.0), _Course(np.nan, 0.0))
    direct, mirrored = (_Course(float(np.angle(z)), abs(z) / norm) for z in (product, image))
    return _Courses(direct, mirrored)


def _course(channels: Mapping[str, FloatArray], runs: Sequence[slice]) -> str:
    if not set(channels) >= _POSE:
        return ""
    direct, mirrored = _courses(channels, runs)
    if mirrored.alike > 0.9 and direct.alike < 0.9 * mirrored.alike:
        if abs(abs(mirrored.angle) - 0.5 * np.pi) < 0.6:
            return "the pose is a mirror image of the motion: x and y are swapped; swap them"
        return (
            "the pose is a mirror image of the motion: y counts to the right, or x backwards; map "
            f"{'y' if abs(mirrored.angle) < 0.6 else 'x'}=NAME[-m]"
        )
    angle = course(channels, runs)
    if not np.isfinite(angle) or abs(angle) < 0.6:
        return ""
    if abs(angle) > 2.4:
        return (
            "the pose goes backwards where the treads go forwards: map both tread speeds with a "
            "minus and swap their sides, or yaw is half a turn off"
        )
    return (
        f"the pose goes {np.degrees(angle):.0f} degrees beside the heading: yaw is not measured "
        "from the x axis of the pose, or x and y are swapped; map them so that a robot of yaw 0 "
        "drives along +x"
    )


def _motor_current(channels: Mapping[str, FloatArray], power: FloatArray) -> str:
    """Whether the current is that of the motors, which follows torque and not power."""
    left, right = channels["v_left"], channels["v_right"]
    effort = np.abs(left) + np.abs(right)
    top = float(np.quantile(effort, 0.95))
    rest, moving = effort < 0.02 * top, effort > 0.15 * top
    if np.count_nonzero(rest) < _ENOUGH or np.count_nonzero(moving) < 5 * _ENOUGH:
        return ""
    speed = effort[moving]
    low, high = np.quantile(speed, [0.15, 0.85])
    if high < 1.6 * low:
        return ""  # one speed tells nothing of how the power depends on it
    turn = np.abs(right - left)[moving] / speed
    # Power per speed is a force, and depends on how tight the robot turns; a motor's current too.
    # What grows with speed and what does not is held apart for each.
    y = power[moving]
    X = np.stack([speed, speed * turn, np.ones(len(speed)), turn])
    scale = np.sqrt((X * X).sum(axis=1))
    if np.any(scale == 0):
        X, scale = X[[0, 2]], scale[[0, 2]]
    unit = X / scale[:, None]
    gram = unit @ unit.T
    if np.linalg.cond(gram) > 1e4:
        return ""
    found = np.linalg.solve(gram, unit @ y) / scale
    half = len(found) // 2
    mean = X.mean(axis=1)
    flat = float(found[half:] @ mean[half:]) - float(power[rest].mean())
    grown = float(found[:half] @ mean[:half])
    spread = float(np.std(y - found @ X)) / max(abs(float(y.mean())), 1e-300)
    if flat > 0.7 * float(y.mean()) > 0 and flat > 3 * abs(grown) and spread < 0.8:
        return (
            "the power jumps up when the robot begins to move and then hardly depends on its "
            "speed, as a motor's current does: voltage times motor current is no power. Log the "
            "battery's current, or map the power by the motor's constant, as in "
            "p_left=CURRENT*SPEED[*V_S_PER_M]"
        )
    return ""


def _distance(channels: Mapping[str, FloatArray], runs: Sequence[slice]) -> str:
    """Compare tread speeds with the distance travelled."""
    ratio = distance_ratio(channels, runs)
    if not np.isfinite(ratio) or 0.7 < ratio < 1.5:
        return ""
    return (
        f"on straight stretches the treads go {ratio:.3g} times as far as x and y; check the units "
        "and the wheel radius, as in v_left=NAME[*0.165], or the wheels slip"
    )
