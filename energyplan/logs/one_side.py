"""Sides whose sensors are dead, are one for both, lost signs, or measure in different units."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from energyplan.errors import NotIdentifiableError
from energyplan.logs.evidence import correlation, yaw_rates
from energyplan.path import FloatArray

if TYPE_CHECKING:  # which imports this module
    from energyplan.logs import DriveLog

_ENOUGH = 20  # samples below which nothing is concluded
_LONG = 5.0  # time of driving straight in which no power stays the same [s]
_FOLLOWS = 0.9  # correlation with a side's speed, of a robot that turns about the other
_TURNS = 0.3  # yaw rate over a second that no robot has which is driven straight [rad/s]
_SHARE = 0.05  # share of the samples in which it must
_BY_DIFFERENCE = 0.7  # correlation of a yaw rate with the speeds' difference that makes it
_FEW, _TOLD = 5, 5.0  # samples, and seconds, that tell a sign at least
_DRAGGED = 1.3  # times the resistance of straight lines, which no side on the inside draws
_UNLIKE = 60.0  # ratio of both sides' powers that no ground explains


def _ahead(left: FloatArray, right: FloatArray) -> NDArray[np.bool_]:
    """Tell where both sides go the same way, about as fast."""
    return np.asarray(np.abs(left - right) < 0.1 * np.abs(left + right))


def find_dead(channels: Mapping[str, FloatArray], rates: Mapping[str, FloatArray]) -> list[str]:
    """Tell whether a side shows nothing all along while the robot drives."""
    told = []
    for side, other in (("left", "right"), ("right", "left")):
        speed, theirs = channels[f"v_{side}"], channels[f"v_{other}"]
        if np.ptp(speed) == 0.0 and np.count_nonzero(theirs) >= _ENOUGH and np.ptp(theirs) > 0.0:
            if any(abs(correlation(rate, theirs)) > _FOLLOWS for rate in rates.values()):
                continue  # it turns about the side that stands
            told.append(
                f"v_{side} is {speed[0]:g} throughout while v_{other} changes: its encoder is "
                f"dead, or the column another; map v_{side} to the speed of the {side} wheels"
            )
        power, drawn = channels.get(f"p_{side}"), channels.get(f"p_{other}")
        # Straight on and on the spot neither side returns power.
        ahead = _ahead(np.abs(speed), np.abs(theirs))
        if power is None or drawn is None or np.ptp(power) > 0.0 or np.ptp(drawn) == 0.0:
            continue
        if np.count_nonzero(ahead & (drawn > 0)) >= _ENOUGH:
            told.append(
                f"p_{side} is {power[0]:g} throughout while p_{other} is not, also where both go "
                f"as fast: its sensor is dead, or the column another; map p_{side} to the power of "
                f"the {side} motors, or log the battery's"
            )
    return told


def find_dying(channels: Mapping[str, FloatArray]) -> list[str]:
    """Find a side's power that is the same from or up to some time, while both go ahead."""
    told = []
    t, left, right = (channels[name] for name in ("t", "v_left", "v_right"))
    time = np.gradient(t) * _ahead(left, right)
    for side, other in (("left", "right"), ("right", "left")):
        power, drawn = channels.get(f"p_{side}"), channels.get(f"p_{other}")
        if power is None or drawn is None or np.ptp(power) == 0.0:
            continue
        starts = np.concatenate([[0], np.flatnonzero(np.diff(power)) + 1])
        lasts = np.append(starts[1:], len(power)) - 1
        changes = np.cumsum(np.diff(drawn, prepend=drawn[0]) != 0.0)
        driven = np.add.reduceat(time * (drawn > 0), starts)
        # What died stays dead; between others, such a stretch may be one of little power.
        at_an_end = (starts == 0) | (lasts == len(power) - 1)
        varied = changes[lasts] - changes[starts] >= _ENOUGH
        long = np.flatnonzero(at_an_end & varied & (driven > _LONG))
        if len(long):
            first, last = t[starts[long[0]]], t[lasts[long[0]]]
            told.append(
                f"p_{side} stays at {power[starts[long[0]]]:g} from t = {first:.2f} to {last:.2f} "
                f"s while p_{other} changes, on straight lines too: its sensor is dead there; "
                "leave that stretch out"
            )
    return told


def find_frozen(channels: Mapping[str, FloatArray], rates: Mapping[str, FloatArray]) -> list[str]:
    """Tell whether a yaw is the same from some time on, or up to it, while the treads turn."""
    t, difference = channels["t"], channels["v_right"] - channels["v_left"]
    turns = np.abs(difference) > 0.4 * float(np.quantile(np.abs(difference), 0.95))
    time = np.gradient(t) * turns
    told = []
    for name, rate in rates.items():
        starts = np.concatenate([[0], np.flatnonzero(np.diff(channels[name])) + 1])
        lasts = np.append(starts[1:], len(t)) - 1
        turned = np.add.reduceat(time, starts)
        for k in {0, len(starts) - 1}:
            frozen = np.zeros(len(t), bool)
            frozen[starts[k] : lasts[k] + 1] = True
            alive = np.abs(rate[turns & ~frozen])
            # A steady turn may repeat a reading; one that is far below all others does not.
            still = len(alive) and np.median(np.abs(rate[frozen])) < 0.1 * np.median(alive)
            if turned[k] > _LONG and still:
                told.append(
                    f"{name} stays at {channels[name][starts[k]]:.4g} from t = {t[starts[k]]:.2f} "
                    f"to {t[lasts[k]]:.2f} s while the treads turn: its sensor is dead there, or "
                    "the wheels are off the ground; leave that stretch out"
                )
    return told


def find_false_speeds(channels: Mapping[str, FloatArray], runs: Sequence[slice]) -> list[str]:
    """Tell whether the speeds are not those of two sides: one column twice, or without signs."""
    rates = yaw_rates(channels, runs)
    return [text for text in (_same(channels, rates), _signs(channels, rates)) if text]


def _same(channels: Mapping[str, FloatArray], rates: Mapping[str, FloatArray]) -> str:
    """Whether one column was taken for both speeds: they are equal while the robot turns."""
    if not np.array_equal(channels["v_left"], channels["v_right"]):
        return ""
    second = max(int(1.0 / float(np.median(np.diff(channels["t"])))), 1)
    turning = []
    for name, rate in rates.items():
        mean = rate[: len(rate) // second * second].reshape(-1, second).mean(axis=1)
        if len(mean) and np.mean(np.abs(mean) > _TURNS) > _SHARE:
            turning.append(name)
    if not turning:
        return ""
    return (
        f"v_left and v_right are the same while {turning[0]} shows that the robot turns: one "
        "column was used for both sides; map each to its own"
    )


def _signs(channels: Mapping[str, FloatArray], rates: Mapping[str, FloatArray]) -> str:
    """Whether speeds lost their sign: on the spot both treads seem to go the same way."""
    left, right = channels["v_left"], channels["v_right"]
    top = float(np.quantile(left + right, 0.99))
    if min(left.min(), right.min()) < -0.02 * top or np.array_equal(left, right):
        return ""
    difference = right - left
    equal = (np.abs(difference) < 0.15 * (left + right)) & (left + right > 0.2 * top)
    for name, rate in rates.items():
        turning = np.abs(rate) > _TURNS
        spinning = equal & turning & (np.abs(rate) > 0.5 * np.quantile(np.abs(rate), 0.99))
        if np.count_nonzero(spinning) <= max(_ENOUGH, 0.5 * _SHARE * len(left)):
            continue
        if not _turns_by(difference, rate, spinning, turning & ~spinning):
            return (
                f"{name} shows that the robot spins where both treads seem to go forwards: the "
                "tread speeds lost their sign; log them with it, for unsigned speeds show "
                "neither turns nor reversing"
            )
    return ""


def _turns_by(
    difference: FloatArray, rate: FloatArray, some: NDArray[np.bool_], others: NDArray[np.bool_]
) -> bool:
    """Whether the speeds' difference makes the turns of some samples, as it does those of others.

    So it does in wide arcs of a robot that never turns on the spot: both sides are about as fast.
    """
    if abs(correlation(difference[some], rate[some])) < _BY_DIFFERENCE:
        return False
    if np.count_nonzero(others) < _ENOUGH:
        return True
    tracks = [
        float(difference[part] @ rate[part]) / float(rate[part] @ rate[part])
        for part in (some, others)
    ]
    return abs(tracks[0]) > 0.5 * abs(tracks[1])


def compare_powers(channels: Mapping[str, FloatArray]) -> str:
    """Tell whether both sides' powers are two powers, in one unit."""
    if not {"p_left", "p_right"} <= set(channels):
        return ""
    p_left, p_right = channels["p_left"], channels["p_right"]
    apart = np.abs(np.abs(channels["v_left"]) - np.abs(channels["v_right"]))
    unlike = apart > 0.2 * float(np.quantile(apart, 0.99))
    drawing = unlike & (apart > 0) & ((p_left != 0) | (p_right != 0))
    if np.count_nonzero(drawing) < _ENOUGH:
        return ""
    if np.array_equal(p_left[drawing], p_right[drawing]):
        return (
            "p_left and p_right are the same, though the sides go at different speeds: one column "
            "was used for both; map each to its own, or map a total as power=NAME"
        )
    # On turns alone the inner side may take next to nothing, and where both sides are as fast,
    # straight on or on the spot, one may be pushed along by the other.
    alike = _ahead(np.abs(channels["v_left"]), np.abs(channels["v_right"]))
    alike &= (p_left != 0) | (p_right != 0)
    if np.count_nonzero(alike) < _ENOUGH:
        return ""
    sizes = [
        [float(np.median(np.abs(power[some]))) for power in (p_left, p_right)]
        for some in (drawing, alike)
    ]
    for less, more in ((0, 1), (1, 0)):
        if all(0 < _UNLIKE * size[less] < size[more] for size in sizes):
            ratio = sizes[0][more] / sizes[0][less]
            names = "p_left", "p_right"
            return (
                f"{names[more]} is {ratio:.3g} times as large as {names[less]}: one side is in "
                f"another unit, or the sensor of {names[less]} is dead; map both in one unit, as "
                f"in {names[less]}=NAME[kW]"
            )
    return ""


def find_lost_sign(channels: Mapping[str, FloatArray]) -> str:
    """Tell whether the sides' powers, or that of one side, lost their sign.

    In arcs a force of slip F and a resistance K give the outer side (F + K) v, the inner one
    (K - F) v, which it returns where F is the larger. Without its sign, that looks as if F and K
    were exchanged. On straight lines the resistance alone remains: there it is seen which of the
    two it is. An inner side that is held back more than a straight line costs is pushed by the
    other.
    """
    if not {"p_left", "p_right"} <= set(channels):
        return ""
    left, right = channels["v_left"], channels["v_right"]
    difference = right - left
    turns = np.abs(difference) > 0.2 * float(np.quantile(np.abs(difference), 0.95))
    straight = np.abs(difference) < 0.01 * np.abs(left + right)
    # Samples of a slow log lie apart, and few of them tell as much.
    enough = int(np.clip(_TOLD / np.median(np.diff(channels["t"])), _FEW, _ENOUGH))
    lost: list[str] = []
    returned = False
    for name, speed, outwards in (("p_left", left, -1.0), ("p_right", right, 1.0)):
        power = channels[name]
        along = outwards * np.sign(difference) * speed
        inner = turns & (along < 0.0)
        if min(np.count_nonzero(inner), np.count_nonzero(straight)) < enough:
            continue  # a robot that turns one way alone
        if np.mean(power[inner] < 0.0) > 0.02:
            returned = True
            continue
        some, size = turns | straight, np.abs(speed)
        X = np.stack([along * turns, size * turns, size * ~turns, np.ones(len(size))], axis=1)
        slip, resistance, seen, _ = np.linalg.lstsq(X[some], power[some], rcond=None)[0]
        exchanged = 0.0 < 1.5 * slip < resistance and seen < np.sqrt(slip * resistance)
        pushed = 0.0 < _DRAGGED * seen < resistance - slip
        if not (exchanged or pushed):
            return ""
        lost.append(name)
    if not lost:
        return ""
    if len(lost) == 1 and returned:
        return (
            f"{lost[0]} is never negative, where the other side's is in arcs, and seems to be held "
            "back far more on the inside of them than on straight lines: its sensor shows what it "
            "returns as power drawn. Log it with its sign"
        )
    return (
        "p_left and p_right are never negative, and in arcs the inner side seems to be held back "
        "far more than on straight lines: the sensors show what it returns as power drawn. Log "
        "signed currents, or let diagnose find unsigned_power"
    )


def refuse_one_side(logs: Sequence[DriveLog]) -> None:
    """Refuse logs that lack a side: what is identified from the other one is half of what is."""
    for log in logs:
        reasons = [
            *find_dead(log.channels, yaw_rates(log.channels, log.runs)),
            *find_false_speeds(log.channels, log.runs),
            compare_powers(log.channels),
        ]
        for reason in filter(None, reasons):
            raise NotIdentifiableError(f"{log.name}: {reason}")
