"""Does a drive log make sense? Swapped sides, wrong signs and units, channels offset in time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from energyplan.errors import DriveLogError
from energyplan.logs._smooth import derivative
from energyplan.logs.align import gap_limit
from energyplan.logs.contradictions import find_contradictions, turning_against
from energyplan.logs.evidence import correlation, yaw_rates
from energyplan.logs.held import held_periods
from energyplan.logs.one_side import find_dead
from energyplan.logs.units import UNITS
from energyplan.path import FloatArray

if TYPE_CHECKING:  # which imports this module
    from energyplan.logs import DriveLog

LARGEST_OFFSET = 2.0
"""Longest time offset between channels that is looked for [s]."""
_USUAL_STEP = 0.05  # of logs of drives [s]
LONGEST_STEP = 20.0
"""Longest usual time from sample to sample [s]: beyond, it is in another unit."""
_SUFFICIENT = 200_000  # samples that tell a time offset as well as more would
_ENOUGH = 20  # samples below which nothing is concluded
_TURNING = 0.05  # difference of the tread speeds from which the robot surely turns [m/s]
_POWERS = {"p_left", "p_right", "power"}
_DIGITS = 4  # different speeds below which no step is concluded
_TELLING = 3.0  # time that a side must do what shows a sign [s]: stops, which give back, are short
_MOVING = 0.03  # tread speed from which it surely moves [m/s]


@dataclass(frozen=True)
class Offset:
    """Time offset of a channel against the tread speeds."""

    channel: str  # the channel
    seconds: float  # by how much it lags behind [s]
    explained: float  # share of its variance that the tread speeds explain once it is shifted
    before: float  # the same as logged
    sign: int  # sign of the relation at that offset
    duration: float  # length of the stretches compared [s]

    @property
    def certain(self) -> bool:
        """Whether the shift explains clearly more, over a long enough time."""
        return (
            self.duration >= 30.0
            and self.explained > 0.3
            and 1 - self.before > 1.15 * (1 - self.explained)
        )


def find_offset(
    channel: str,
    t: FloatArray,
    values: FloatArray,
    regressors: Sequence[FloatArray],
    runs: Sequence[slice],
    *,
    largest: float = LARGEST_OFFSET,
    centred: bool = True,
) -> Offset | None:
    """Find the time offset at which regressors explain a channel best.

    For each lag the explained variance of the least-squares fit follows from cross-correlations
    and running sums, so that all lags together cost a few Fourier transforms; a parabola through
    the best lag and its neighbours refines it.
    """
    long = [run for run in runs if t[run][-1] - t[run][0] >= 4 * largest]
    if not long:
        return None
    # Where most samples crowd together the grid must not grow without bound.
    spread = sum(float(t[run][-1] - t[run][0]) for run in long) / (4 * len(t))
    step = max(float(np.median(np.diff(t))), spread)
    lags = round(largest / step)
    if lags < 1:
        return None
    columns = [*regressors, np.ones(len(t))] if centred else list(regressors)
    size = len(columns)
    cross, gram = np.zeros((2 * lags + 1, size)), np.zeros((2 * lags + 1, size, size))
    square = total = count = 0.0
    for run in long:
        grid = t[run][0] + step * np.arange(int((t[run][-1] - t[run][0]) / step) + 1)
        # The channel's samples that every lag can reach; the regressors move past them.
        y = np.interp(grid, t[run], values[run])[lags:-lags]
        X = np.stack([np.interp(grid, t[run], column[run]) for column in columns])
        square, total, count = square + float(y @ y), total + float(y.sum()), count + len(y)
        length = 1 << (X.shape[1] - 1).bit_length()
        spectrum = np.conj(np.fft.rfft(y, length))
        for j in range(size):
            # Correlation at every lag at once; it wraps round only beyond the lags wanted.
            product = np.fft.rfft(X[j], length) * spectrum
            cross[:, j] += np.fft.irfft(product, length)[2 * lags :: -1]
            for k in range(size):
                sums = np.concatenate([[0.0], np.cumsum(X[j] * X[k])])
                gram[:, j, k] += (sums[len(y) :] - sums[: 2 * lags + 1])[::-1]
    if square - centred * total**2 / max(count, 1.0) <= 1e-12 * square:
        return None
    scale = np.sqrt(np.einsum("ijj->ij", gram))
    if np.any(scale <= 0):
        return None
    # Regressors may be collinear, as those of a robot that never turns or has one side dead.
    unit = gram / (scale[:, :, None] * scale[:, None, :])
    inverse = np.linalg.pinv(unit, rcond=1e-9, hermitian=True)
    weights = (inverse @ (cross / scale)[..., None])[..., 0] / scale
    mean = total**2 / count if centred else 0.0
    explained = (np.einsum("ij,ij->i", cross, weights) - mean) / (square - mean)
    best = int(np.argmax(explained))
    shift = 0.0
    if 0 < best < 2 * lags:
        a, b, c = explained[best - 1 : best + 2]
        shift = 0.5 * float(a - c) / float(a - 2 * b + c) if a - 2 * b + c < 0 else 0.0
    return Offset(
        channel,
        (best - lags + shift) * step,
        float(explained[best]),
        float(explained[lags]),
        int(np.sign(weights[best, 0])),
        count * step,
    )


def yaw_rate_offset(log: DriveLog) -> Offset | None:
    """Return the time offset of a log's yaw rate against its tread speeds, if the drive tells."""
    difference = log.channel("v_right") - log.channel("v_left")
    rate = log.channel("yaw_rate")
    return find_offset("yaw_rate", log.t, rate, [difference], _enough(log.runs), centred=False)


def _enough(runs: Sequence[slice]) -> list[slice]:
    """Stretches that suffice to find a time offset: the first hours of a long log."""
    some: list[slice] = []
    left = _SUFFICIENT
    for run in runs:
        if left <= 0:
            break
        some.append(slice(run.start, min(run.stop, run.start + left)))
        left -= run.stop - run.start
    return some


def power_regressors(channels: Mapping[str, FloatArray], runs: Sequence[slice]) -> list[FloatArray]:
    """Shapes that the power of any skid-steer robot is made of: rolling, sliding, speeding up."""
    t, left, right = channels["t"], channels["v_left"], channels["v_right"]
    mean, difference = left + right, right - left
    return [
        np.abs(left) + np.abs(right),
        np.abs(difference),
        mean * derivative(t, mean, runs, 0.5),
        difference * derivative(t, difference, runs, 0.5),
    ]


def find_doubts(
    channels: Mapping[str, FloatArray], power: FloatArray, runs: Sequence[slice], label: str
) -> list[str]:
    """Compare the channels with each other."""
    told = _check_time(channels["t"], runs, label)
    contradictions = find_contradictions(channels, power, runs)
    if not find_dead(channels, yaw_rates(channels, runs)):
        # One side alone seems to turn or to draw the wrong way.
        told += _check_turning(channels, runs, label)
        told += _check_power(channels, power, runs, label)
    return [*told, *contradictions]


def _check_time(t: FloatArray, runs: Sequence[slice], label: str) -> list[str]:
    """Refuse time in another unit; report gaps."""
    step = float(np.median(np.diff(t)))
    if not 1e-4 <= step <= LONGEST_STEP:
        sizes = {name: size for name, size in UNITS["t"].items() if name != "s"}
        unit = min(sizes, key=lambda name: abs(np.log(step * sizes[name] / _USUAL_STEP)))
        raise DriveLogError(
            f"{label}: the time step of t is {step:g} s; between 0.1 ms and "
            f"{LONGEST_STEP:g} s is possible; name "
            f"its unit, as in t=NAME[{unit}]"
        )
    if len(runs) < 2:
        return []
    starts = [t[run][-1] for run in runs[:-1]]
    lost = sum(float(t[b][0] - t[a][-1]) for a, b in pairwise(runs))
    named = ", ".join(f"{start:.2f} s" for start in starts[:3])
    gaps = "1 gap" if len(starts) == 1 else f"{len(starts)} gaps"
    return [
        f"t has {gaps} longer than {gap_limit(t):.2g} s, {lost:.1f} s in all, after "
        f"t = {named}{', ...' if len(starts) > 3 else ''}; nothing is interpolated across them"
    ]


def _check_turning(
    channels: Mapping[str, FloatArray], runs: Sequence[slice], label: str
) -> list[str]:
    """Compare measured turning with the tread speeds."""
    t, difference = channels["t"], channels["v_right"] - channels["v_left"]
    turning = np.abs(difference) > _TURNING
    told: list[str] = []
    for name in ("yaw_rate", "yaw"):
        if name not in channels or np.count_nonzero(turning) < _ENOUGH:
            continue
        rate = channels[name]
        if name == "yaw":
            rate = derivative(t, np.unwrap(rate), runs, 0.5)
            if abs(correlation(rate, difference)) < 0.5:
                degrees = derivative(t, np.unwrap(channels[name], period=360.0), runs, 0.5)
                rate = degrees if abs(correlation(degrees, difference)) > 0.5 else rate
        if not np.any(rate):
            told.append(f"{name} never changes, though the tread speeds say that the robot turns")
            continue
        product = float(rate @ difference)
        alike = correlation(rate, difference)
        offset = find_offset(name, t, rate, [difference], _enough(runs), centred=False)
        shifted = offset is not None and offset.certain
        sign = (
            offset.sign if offset is not None and shifted and abs(alike) < 0.5 else np.sign(alike)
        )
        if sign < 0 and (shifted or alike < -0.3):
            raise DriveLogError(
                f"{label}: {name} falls while v_right exceeds v_left (correlation {alike:.2f}): "
                f"{turning_against(channels, runs, name)}"
            )
        if offset is not None and shifted:
            told.append(_offset_warning(offset))
        track = float(difference @ difference) / product if product > 0 else np.inf
        if alike > 0.5 and track < 0.05:
            raise DriveLogError(
                f"{label}: {name} changes as if the slip track were {track * 1e3:.1f} mm; it seems "
                f"to be in degrees; map {name}=NAME[{'deg' if name == 'yaw' else 'deg/s'}]"
            )
        if not shifted and abs(alike) < 0.3:
            told.append(
                f"{name} hardly follows v_right - v_left (correlation {alike:.2f}); the tread ICRs "
                "cannot be trusted"
            )
    return told


def _offset_warning(offset: Offset) -> str:
    way = "lags behind" if offset.seconds > 0 else "leads"
    return (
        f"{offset.channel} {way} the tread speeds by {abs(offset.seconds):.3f} s (explained "
        f"variance {offset.before:.3f} as logged, {offset.explained:.3f} once shifted); "
        f"diagnose allows for it, and DriveLog.shifted({offset.channel}={-offset.seconds:.3f}) "
        "puts it right"
    )


def _step(values: FloatArray, usual: float) -> float:
    """Return the step in which readings come; 0 where it is below a tenth of what is usual."""
    found = np.unique(np.round(values, 9))
    if not _DIGITS <= len(found) <= len(values) / 4:
        return 0.0
    step = float(min(np.abs(found[found != 0.0]).min(), np.diff(found).min()))
    if step < 0.1 * usual or np.any(np.abs(found / step - np.round(found / step)) > 0.02):
        return 0.0
    return step


def _check_steps(channels: Mapping[str, FloatArray], moving: NDArray[np.bool_]) -> list[str]:
    """Tell of readings with so few digits that a steady one is not known, however long it lasts."""
    told = []
    speeds = np.abs(np.concatenate([channels["v_left"], channels["v_right"]]))
    speeds = speeds[speeds > _MOVING]
    usual = float(np.median(speeds))
    if step := _step(speeds, usual):
        told.append(
            f"the tread speeds come in steps of {step:.3g} m/s, where {usual:.2g} m/s is usual: a "
            f"steady speed, and with it the power parameters, may be wrong by "
            f"{50 * step / usual:.0f} %; log more digits"
        )
    for name in ("p_left", "p_right", "power", "current"):
        if name not in channels or (name == "current" and _POWERS & set(channels)):
            continue
        usual = float(np.median(np.abs(channels[name][moving])))
        if usual > 0.0 and (step := _step(channels[name][moving], usual)):
            unit = "A" if name == "current" else "W"
            told.append(
                f"{name} comes in steps of {step:.3g} {unit}, where {usual:.2g} {unit} is usual: "
                f"power parameters may be wrong by {50 * step / usual:.0f} %, and more than their "
                "standard errors; log more digits"
            )
    return told


def _check_power(
    channels: Mapping[str, FloatArray], power: FloatArray, runs: Sequence[slice], label: str
) -> list[str]:
    """Compare power with the tread speeds: its sign, its side, its time."""
    t, left, right = channels["t"], channels["v_left"], channels["v_right"]
    effort = np.abs(left) + np.abs(right)
    moving = effort > 2 * _MOVING
    told: list[str] = []
    driven = np.count_nonzero(moving)
    if driven < _ENOUGH and 2 * driven < len(t):
        return ["the robot hardly moves; its power parameters cannot be found"]
    if driven < _ENOUGH:
        return [
            f"{driven} readings of driving are too few: power parameters cannot be found from this "
            "log alone, nor mistakes with it; log longer, or more often"
        ]
    if not np.any(power):
        return ["power is zero all along"]
    told += _check_steps(channels, moving)
    held = held_periods(channels)
    together: dict[str, list[str]] = {}
    for name, period in held.items():
        together.setdefault(f"{period:.2g}", []).append(name)
    told += [
        f"{' and '.join(names)} {'are' if len(names) > 1 else 'is'} read every {period} s only, and"
        f" repeated from row to row between: {0.5 * float(period):.2g} s late in the mean, which "
        "diagnose allows for; log the power as often as the speeds"
        for period, names in together.items()
    ]
    sides = [name for name in ("p_left", "p_right") if {"p_left", "p_right"} <= set(channels)]
    flipped = [name for name in sides if _flipped(channels, name)]
    if len(flipped) != 1:
        wrong = _wrong_sign(power[moving]) and not _descends(channels)
        source = ["current"] if "current" in channels and "power" not in channels else ["power"]
        flipped = (sides or source) if wrong else []
    if flipped:
        unit = "A" if flipped == ["current"] else "W"
        raise DriveLogError(
            f"{label}: {' and '.join(flipped)} has the wrong sign: power drawn counts positive, and"
            f" so does the current of a discharge; map it with a minus in its unit, as in "
            f"{flipped[0]}=NAME[-{unit}]"
        )
    if sides:
        arcs = np.abs(np.abs(right) - np.abs(left)) > 0.15 * effort
        lean = (np.abs(right) ** 2 - np.abs(left) ** 2)[arcs & moving]
        excess = (channels["p_right"] - channels["p_left"])[arcs & moving]
        if len(lean) >= _ENOUGH and correlation(lean, excess) < -0.5:
            told.append(
                "p_left and p_right seem to be swapped: in arcs the outer, faster tread must draw "
                "the more"
            )
    some = _enough(runs)
    offset = find_offset("power", t, power, power_regressors(channels, some), some)
    if offset is not None and offset.certain and offset.explained > 0.75:
        # Readings that are held are late by up to the time between them, which is told already.
        by_hold = 0.0 < offset.seconds < max(held.values(), default=0.0)
        told += [] if by_hold else [_offset_warning(offset)]
    return told


def _flipped(channels: Mapping[str, FloatArray], side: str) -> bool:
    """Whether a side's power is negative where the side can only draw.

    On the outside of an arc and on the spot it works against slip and resistance at once. The inner
    side of an arc generates, and on a straight line one side may push the other along; but where
    there are straight lines only, two sides that work equally against each other go nowhere.
    """
    other = "p_left" if side == "p_right" else "p_right"
    speed = channels["v_right" if side == "p_right" else "v_left"]
    outwards = 1.0 if side == "p_right" else -1.0
    turn = outwards * (channels["v_right"] - channels["v_left"])
    effort = np.abs(channels["v_left"]) + np.abs(channels["v_right"])
    outer = (turn * speed > 0) & (np.abs(turn) > np.maximum(_TURNING, 0.15 * effort))
    outer &= np.abs(speed) > _MOVING
    enough = max(_ENOUGH, _TELLING / float(np.median(np.diff(channels["t"]))))
    drawn = channels[side][outer]
    negative = _wrong_sign(drawn)
    if len(drawn) >= enough or (len(drawn) and not negative):
        return negative
    straight = (np.abs(turn) < 0.1 * effort) & (effort > 2 * _MOVING)
    # An arc of a large radius, to one side, looks the same, and ends elsewhere.
    bent = abs(float(turn[straight].sum())) > 0.01 * float(effort[straight].sum())
    if np.count_nonzero(straight) < enough or bent:
        return False
    power, opposite = channels[side][straight], channels[other][straight]
    return _wrong_sign(power) and bool(0.5 < -opposite.mean() / power.mean() < 2.0)


def _wrong_sign(power: FloatArray) -> bool:
    """Whether power is negative on the whole, beyond chance."""
    return bool(len(power) and power.mean() < -0.3 * np.abs(power).mean() and np.median(power) < 0)


def _descends(channels: Mapping[str, FloatArray]) -> bool:
    """Whether the drive goes downhill on the whole, as far as the log tells."""
    if "slope" not in channels:
        return False
    forward = channels["v_left"] + channels["v_right"]
    return float(np.sin(channels["slope"]) @ forward) < -0.02 * float(np.abs(forward).sum())
