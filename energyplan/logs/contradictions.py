"""Signs, sides and sensors that contradict each other in a log, whatever the robot."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from energyplan.logs.evidence import correlation, distance_ratio, yaw_rates
from energyplan.path import FloatArray

_ENOUGH = 20  # samples below which nothing is concluded


def find_contradictions(
    channels: Mapping[str, FloatArray], power: FloatArray, runs: Sequence[slice]
) -> list[str]:
    """Compare the channels of a log with each other.

    Parameters
    ----------
    channels : mapping of str to ndarray, shape (n,)
        Sound channels.
    power : ndarray, shape (n,)
        Total power [W].
    runs : sequence of slice
        Stretches without a gap.

    Returns
    -------
    list of str
        What contradicts each other, and what would mend it.
    """
    told = [
        _sides(channels, runs),
        _course(channels, runs),
        _motor_current(channels, power),
        _distance(channels, runs),
    ]
    return [text for text in told if text]


def turning_against(channels: Mapping[str, FloatArray], runs: Sequence[slice], name: str) -> str:
    """Say what is wrong where a yaw rate falls while the right tread is the faster.

    Parameters
    ----------
    channels : mapping of str to ndarray, shape (n,)
        Sound channels.
    runs : sequence of slice
        Stretches without a gap.
    name : str
        The channel, ``yaw`` or ``yaw_rate``.

    Returns
    -------
    str
        The causes that the other channels leave, and the remedies.
    """
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
        return "left and right are swapped; swap them in the column mapping"
    return (
        f"left and right are swapped, or {name} counts clockwise; swap them in the column mapping, "
        f"or {flip}"
    )


def _sides(channels: Mapping[str, FloatArray], runs: Sequence[slice]) -> str:
    """Whether the sides' speeds count alike: the yaw rate must be that of their difference.

    The yaw rate is fitted by both speeds: with opposite factors of one size if all is well, with
    factors of one sign where a side counts the other way, as of a motor mounted in the mirror, and
    with factors of two sizes where the sides have two units.
    """
    speeds = np.stack([channels["v_left"], channels["v_right"]])
    gram = speeds @ speeds.T
    scale = np.sqrt(np.diag(gram))
    if np.any(scale <= 0) or np.linalg.cond(gram / np.outer(scale, scale)) > 400:
        return ""
    for rate in yaw_rates(channels, runs).values():
        factors = np.linalg.solve(gram, speeds @ rate)
        if correlation(factors @ speeds, rate) < 0.93:
            continue
        left, right = (float(factor) for factor in factors)
        size = abs(right / left) if left else np.inf
        if left * right > 0 and 0.4 < size < 2.5:
            side = "v_right" if right < 0 else "v_left"
            return (
                "the robot turns with the sum of the tread speeds, not with their difference: "
                f"{side} counts the other way; map {side}=NAME[-m/s]"
            )
        if left * right < 0 and not 0.6 < size < 1.6:
            return (
                f"the yaw rate tells that v_left counts {size:.3g} times as much as v_right: one "
                "side is in another unit or has another wheel radius; give both the same, or map "
                f"v_left=NAME[*{1 / size:.4g}]"
            )
    return ""


def course(channels: Mapping[str, FloatArray], runs: Sequence[slice]) -> float:
    """Angle from where the treads would take the robot to where the pose goes [rad].

    Parameters
    ----------
    channels : mapping of str to ndarray, shape (n,)
        Sound channels.
    runs : sequence of slice
        Stretches without a gap.

    Returns
    -------
    float
        The angle; NaN where there is no pose, or it does not follow the treads.
    """
    if not {"x", "y", "yaw"} <= set(channels):
        return np.nan
    t, speed = channels["t"], 0.5 * (channels["v_left"] + channels["v_right"])
    heading = np.unwrap(channels["yaw"])
    product, predicted, measured = 0.0 + 0.0j, 0.0, 0.0
    for run in runs:
        edges = np.arange(t[run][0], t[run][-1], max(1.0, 5 * float(np.median(np.diff(t)))))
        if len(edges) < 2:
            continue
        steps = np.diff(t[run], prepend=t[run][0])
        way = np.cumsum(speed[run] * np.exp(1j * heading[run]) * steps)
        place = channels["x"][run] + 1j * channels["y"][run]
        goes = np.diff(np.interp(edges, t[run], way.real) + 1j * np.interp(edges, t[run], way.imag))
        went = np.diff(
            np.interp(edges, t[run], place.real) + 1j * np.interp(edges, t[run], place.imag)
        )
        product += complex(np.vdot(goes, went))
        predicted += float(np.vdot(goes, goes).real)
        measured += float(np.vdot(went, went).real)
    norm = np.sqrt(predicted * measured)
    if norm <= 0 or abs(product) < 0.7 * norm:
        return np.nan
    return float(np.angle(product))


def _course(channels: Mapping[str, FloatArray], runs: Sequence[slice]) -> str:
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
