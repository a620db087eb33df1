"""Does a drive log make sense, whatever the robot: signs, sides, sensors, units and clocks.

Each check looks at a drive and returns what is wrong, with its remedy; `find_checks` runs them all.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, pairwise
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from energyplan.errors import InvalidInputError, NotIdentifiableError
from energyplan.logs.align import Offset, derivative, find_offset, gap_limit
from energyplan.logs.consistency import (
    Channels,
    Check,
    Drive,
    Measures,
    check_consistency,
    correlation,
    lasts,
)
from energyplan.logs.mapping import ROW, UNITS
from energyplan.path import FloatArray

if TYPE_CHECKING:  # which imports this module
    from energyplan.logs import DriveLog

POWERS = ("p_left", "p_right", "power", "current")
"""Channels of what is drawn."""
LONGEST_STEP = 20.0
"""Longest usual time from sample to sample [s]: beyond, it is in another unit."""
_ENOUGH = 20  # samples below which nothing is concluded
_TURNING = 0.05  # difference of the tread speeds from which the robot surely turns [m/s]
_MOVING = 0.03  # tread speed from which it surely moves [m/s]
_PAUSE, _BURSTS = 10.0, 0.05  # usual steps, and share of the rows, that tell rows in bursts


_EACH_SIDE = (("left", "right"), ("right", "left"))
_Found = Iterable[Check]


@dataclass(frozen=True)
class Invariant:
    """What holds of every drive, and how what breaks it is found."""

    what: str
    needs: frozenset[str]  # channels without which nothing can be said
    find: Callable[[Drive], _Found]
    refuses: str = "trust"  # what a check rules out that says nothing of it
    of_two_sides: bool = False  # of a dead side, the other one seems to break it


def find_checks(channels: Channels, power: FloatArray, runs: Sequence[slice]) -> list[Check]:
    """Return what is wrong with a drive."""
    drive = Drive(channels, power, runs)
    dead = any(True for _ in _dead(drive))
    return [
        check if check.refuses else replace(check, refuses=one.refuses)
        for one in INVARIANTS if one.needs <= set(channels) and not (dead and one.of_two_sides)
        for check in one.find(drive)
    ]  # fmt: skip


def refuse_one_side(logs: Sequence[DriveLog]) -> None:
    """Refuse logs that lack a side: what is identified from the other one is half of what is."""
    for log in logs:
        drive = Drive(log.channels, log.power, log.runs)
        rules = (_dead, _false_speeds, *((_unlike,) if drive.sides else ()))
        for check in (one for rule in rules for one in rule(drive)):
            raise NotIdentifiableError(f"{log.name}: {check}")


# -- time ---------------------------------------------------------------------------------------


def _time(drive: Drive) -> _Found:
    """Time in another unit; gaps."""
    t, runs, step = drive.t, drive.runs, drive.usual_step
    if not 1e-4 <= step <= LONGEST_STEP:
        sizes = {name: size for name, size in UNITS["t"].items() if name != "s"}
        unit = min(sizes, key=lambda name: abs(np.log(step * sizes[name] / 0.05)))
        yield Check(
            f"the time step of t is {step:g} s; between 0.1 ms and {LONGEST_STEP:g} s is possible",
            remedy=f"name its unit, as in t=NAME[{unit}]", refuses="reading",
        )  # fmt: skip
    steps = np.diff(t)
    if np.mean(steps > _PAUSE * step) > _BURSTS:
        yield Check(
            f"t jumps by more than {_PAUSE:g} usual steps in {np.mean(steps > _PAUSE * step):.0%} "
            "of the rows: rows that were buffered bear the time of their arrival, or the logger "
            "sleeps",
            remedy=f"of readings at a steady rate, map t={ROW}[*PERIOD] with the time from row to "
            "row [s]", refuses="trust",
        )  # fmt: skip
    if len(runs) < 2:
        return
    starts = [t[run][-1] for run in runs[:-1]]
    lost = sum(float(t[b][0] - t[a][-1]) for a, b in pairwise(runs))
    named = ", ".join(f"{start:.2f} s" for start in starts[:3])
    gaps = "1 gap" if len(starts) == 1 else f"{len(starts)} gaps"
    yield Check(
        f"t has {gaps} longer than {gap_limit(t):.2g} s, {lost:.1f} s in all, after "
        f"t = {named}{', ...' if len(starts) > 3 else ''}; nothing is interpolated across them"
    )


_GROWS = 0.9  # share of all change that is growth, of a counter
_STEADY = 0.5  # the same of a drive that speeds up and slows down, or of a side that may return
_CHANGES = 8  # of a counter, from which chance does not explain that all go one way


def grows(values: FloatArray, share: float = _GROWS) -> int:
    """Tell whether readings go one way all along, as a counter does: 1 up, -1 down, 0 neither."""
    steps = np.diff(values[np.isfinite(values)])
    total = float(np.abs(steps).sum())
    # A counter that is set back goes far in one step.
    if np.count_nonzero(steps) >= 2 * _CHANGES:
        steps = steps[np.abs(steps) < max(0.5 * total, 1e-300)]
        total = float(np.abs(steps).sum())
    net = float(steps.sum())
    counted = np.count_nonzero(steps) >= _CHANGES and abs(net) > share * total
    return int(np.sign(net)) if counted else 0


def _counters(drive: Drive) -> _Found:
    """Energy or charge for power or current: it only grows, though the robot slows down, too."""
    steps = np.diff(drive.effort)
    total = float(np.abs(steps).sum())
    if abs(float(steps.sum())) > _STEADY * total or total < 0.5 * float(drive.effort.max()):
        return  # nothing that the robot does would make a power fall
    for name in (name for name in POWERS if name in drive.channels):
        values = drive.channels[name]
        way = grows(values, _STEADY)
        # A power changes as the robot speeds up; what is counted, as long as it drives.
        if way and abs(correlation(np.diff(values), drive.effort[1:])) > 0.5:
            what, unit, other = (
                ("charge", "mAh", "Ah") if name == "current" else ("energy", "Wh", "J")
            )
            sign = "-" if way < 0 else ""
            yield Check(
                f"{name} only ever {'grows' if way > 0 else 'falls'}, also where the robot slows "
                f"down: it counts {what}",
                remedy=f"map its rate of change, as in {name}=NAME[{sign}{unit}] or "
                f"{name}=NAME[{sign}{other}]", refuses="reading",
            )  # fmt: skip


# -- turning ------------------------------------------------------------------------------------


def _some(runs: Sequence[slice], most: int = 200_000) -> list[slice]:
    """Stretches that suffice to find a time offset: the first hours of a long log."""
    some: list[slice] = []
    for run in runs:
        if most > 0:
            some.append(slice(run.start, min(run.stop, run.start + most)))
        most -= run.stop - run.start
    return some


def yaw_rate_offset(log: DriveLog) -> Offset | None:
    """Return the time offset of a log's yaw rate against its tread speeds, if the drive tells."""
    difference = log.channel("v_right") - log.channel("v_left")
    rate = log.channel("yaw_rate")
    return find_offset("yaw_rate", log.t, rate, [difference], _some(log.runs), centred=False)


def _late(offset: Offset) -> Check:
    way = "lags behind" if offset.seconds > 0 else "leads"
    return Check(
        f"{offset.channel} {way} the tread speeds by {abs(offset.seconds):.3f} s (explained "
        f"variance {offset.before:.3f} as logged, {offset.explained:.3f} once shifted)",
        remedy=f"diagnose allows for it, and DriveLog.shifted({offset.channel}="
        f"{-offset.seconds:.3f}) puts it right",
    )


def _turning(drive: Drive) -> _Found:
    """Measured turning against the tread speeds."""
    t, difference, runs = drive.t, drive.difference, drive.runs
    if np.count_nonzero(np.abs(difference) > _TURNING) < _ENOUGH:
        return
    for name, rate in drive.rates.items():
        if name == "yaw" and abs(correlation(rate, difference)) < 0.5:
            wrapped = np.unwrap(drive.channels[name], period=360.0)
            degrees = derivative(t, wrapped, runs, 0.5)
            rate = degrees if abs(correlation(degrees, difference)) > 0.5 else rate
        if not np.any(rate):
            yield Check(f"{name} never changes, though the tread speeds say that the robot turns")
            continue
        product, alike = float(rate @ difference), correlation(rate, difference)
        offset = find_offset(name, t, rate, [difference], _some(runs), centred=False)
        shifted = offset if offset is not None and offset.certain else None
        sign = shifted.sign if shifted is not None and abs(alike) < 0.5 else np.sign(alike)
        if sign < 0 and (shifted is not None or alike < -0.3):
            yield _against(drive, name, alike)
        elif shifted is not None:
            yield _late(shifted)
        track = float(difference @ difference) / product if product > 0 else np.inf
        if alike > 0.5 and track < 0.05:
            yield Check(
                f"{name} changes as if the slip track were {track * 1e3:.1f} mm; it seems to be in "
                "degrees",
                remedy=f"map {name}=NAME[{'deg' if name == 'yaw' else 'deg/s'}]", refuses="reading",
            )  # fmt: skip
        if shifted is None and abs(alike) < 0.3:
            yield Check(
                f"{name} hardly follows v_right - v_left (correlation {alike:.2f})",
                remedy="the tread ICRs cannot be trusted",
            )


def _against(drive: Drive, name: str, alike: float) -> Check:
    """Say what is wrong where a yaw rate falls while the right tread is the faster."""
    said = f"{name} falls while v_right exceeds v_left (correlation {alike:.2f}): "
    mirrored = mirrored_side(drive)
    if mirrored:
        one = _in_the_mirror(mirrored)
        return Check(said + one.what, remedy=one.remedy, turned=one.turned, refuses="reading")
    flip = f"map {name}=NAME[-{'rad' if name == 'yaw' else 'rad/s'}]"
    others = [correlation(r, drive.difference) for key, r in drive.rates.items() if key != name]
    backwards = _way(drive).angle
    if any(value > 0.3 for value in others):
        kind = "the gyroscope's axis is flipped" if name == "yaw_rate" else "yaw counts clockwise"
        what, remedy = f"{kind}, for the other channel turns with the treads", flip
        return Check(said + what, remedy=remedy, turned=(name,), refuses="reading")
    if np.isfinite(backwards) and abs(backwards) > 2.4:
        what, remedy = (
            "the treads run backwards",
            "map both with a minus, as in v_left=NAME[-m/s],v_right=NAME[-m/s]",
        )
    elif abs(backwards) < 0.6:  # the heading goes with the pose
        what, remedy = (
            "left and right are swapped, or all of the pose is in a frame whose z axis points down "
            "(NED)",
            "swap them in the column mapping; or map y=NAME[-m],yaw=NAME[-rad] and, if there is "
            "one, yaw_rate=NAME[-rad/s]",
        )
    else:
        what, remedy = (
            f"left and right are swapped, or {name} counts clockwise",
            f"swap them in the column mapping, or {flip}",
        )
    return Check(said + what, remedy=remedy, refuses="reading")


def _factors(drive: Drive) -> Iterator[tuple[float, float]]:
    """Return by what the sides' speeds make each yaw rate that their difference makes worse [1/m].

    They have opposite signs and one size if all is well, one sign where a side counts the other
    way, and two sizes where the sides have two units.
    """
    speeds = np.stack([drive.left, drive.right])
    gram = speeds @ speeds.T
    scale = np.sqrt(np.diag(gram))
    if np.any(scale <= 0):
        return
    # Speeds that hardly differ but for their sign tell no factor of each, only that of the sum.
    apart = np.linalg.cond(gram / np.outer(scale, scale)) <= 400
    total = speeds.sum(axis=0)
    for rate in filter(lasts, drive.rates.values()):
        if apart:
            factors = np.linalg.solve(gram, speeds @ rate)
        elif gram[0, 1] < 0.0 < total @ total:
            factors = np.full(2, total @ rate / (total @ total))
        else:
            continue
        alike, as_they_are = (
            correlation(factors @ speeds, rate),
            correlation(drive.difference, rate),
        )
        if alike >= 0.93 and 1.0 - as_they_are**2 >= 2.0 * (1.0 - alike**2):
            yield float(factors[0]), float(factors[1])


def mirrored_side(drive: Drive) -> str:
    """Name the side whose speed counts the other way, as of a motor mounted in the mirror."""
    found = (_mirrored(left, right) for left, right in _factors(drive))
    return next(found, "")


def _mirrored(left: float, right: float) -> str:
    """Name the side that counts the other way by the factors of both; empty where none does."""
    if left * right > 0 and 0.4 < abs(right / left) < 2.5:
        return "v_right" if right < 0 else "v_left"
    return ""


def _in_the_mirror(side: str) -> Check:
    return Check(
        "the robot turns with the sum of the tread speeds, not with their difference: "
        f"{side} counts the other way",
        remedy=f"map {side} with a minus before its unit, as in {side}=NAME[-m/s]", turned=(side,),
    )  # fmt: skip


def _counting(drive: Drive) -> _Found:
    """Whether the sides' speeds count alike: the yaw rate must be that of their difference."""
    scale = np.sqrt([np.sum(speed**2) for speed in (drive.left, drive.right)])
    for left, right in _factors(drive):
        shares = np.abs((left, right)) * scale
        size = abs(right / left) if left else np.inf
        if shares.min() < 0.08 * shares.max():
            turning = ("v_left", "v_right")[int(np.argmax(shares))]
            return [Check(
                f"the yaw rate follows {turning} alone, as if it were an angular speed and the "
                "other the robot's forward speed: tread speeds are those of the left and of the "
                "right wheels",
                remedy="of speed V and yaw rate W make them, as in v_left=V-0.25*W,v_right="
                "V+0.25*W with half the track",
            )]  # fmt: skip
        if _mirrored(left, right):
            return [_in_the_mirror(_mirrored(left, right))]
        if left * right < 0 and not 0.6 < size < 1.6:
            return [Check(
                f"the yaw rate shows that v_left counts {size:.3g} times as much as v_right: one "
                "side is in another unit or has another wheel radius",
                remedy=f"give both the same, or map v_left=NAME[*{1 / size:.4g}]",
            )]  # fmt: skip
    return []


_OPPOSED = 0.7  # share of the driving in which no drive turns on the spot


def _opposed(drive: Drive) -> _Found:
    """Without a heading, sides that go against each other as no drive does: one is mirrored.

    They do so nearly all the time, or it costs less power than to go the same way.
    """
    if drive.rates or np.count_nonzero(drive.moving) < _ENOUGH:  # rates tell more
        return
    effort, driving = drive.effort, float(drive.effort[drive.moving].sum())
    spun = float(effort[drive.moving & (drive.left * drive.right < 0.0)].sum()) / driving
    if {"x", "y"} <= set(drive.channels):  # a robot that turns on the spot stays there
        edges = np.arange(drive.t[0], drive.t[-1], max(3.0, 5 * drive.usual_step))
        steps = 0.25 * np.diff(drive.t) * (effort[1:] + effort[:-1])
        gone = np.hypot(*(np.diff(np.interp(edges, drive.t, drive.channels[n])) for n in "xy"))
        if float(gone.sum()) < 0.5 * float(steps.sum()):
            return
    if spun < _OPPOSED and not _turning_saves(drive):
        return
    back = "v_left" if float(np.sum(drive.left)) < float(np.sum(drive.right)) else "v_right"
    yield Check(
        f"v_left and v_right go against each other in {spun:.0%} of the driving"
        + (", and draw less power then" if spun < _OPPOSED else "")
        + ": a robot that turns on the spot all the time, or a motor mounted in the mirror",
        remedy=f"map the side that counts backwards with a minus, as in {back}=NAME[-m/s]; or log "
        "the yaw rate, which tells",
    )


def _turning_saves(drive: Drive) -> bool:
    """Whether the power falls the more the sides' speeds differ, beyond chance."""
    X = np.stack([drive.effort, np.abs(drive.difference), np.ones(len(drive.t))], axis=1)
    if np.linalg.matrix_rank(X / np.maximum(np.abs(X).max(axis=0), 1e-300), 1e-3) < 3:
        return False
    found = np.linalg.lstsq(X, drive.power, rcond=None)[0]
    rest = drive.power - X @ found
    # Neighbouring samples repeat each other for about a second.
    repeats = max(1.0, 1.0 / drive.usual_step)
    error = float(np.sqrt(np.mean(rest**2) * repeats * np.linalg.inv(X.T @ X)[1, 1]))
    return bool(found[1] < -0.2 * abs(found[0]) and found[1] < -5.0 * error)


class _Way(NamedTuple):
    """From where the treads would take the robot to where the pose goes."""

    angle: float  # angle between both [rad]; NaN where neither follows the other
    alike: float  # how well one follows the other, at most 1


def _way(drive: Drive, mirrored: bool = False) -> _Way:
    """Compare the pose with the treads' way, or with that way's mirror image in the x axis."""
    if not {"x", "y", "yaw"} <= set(drive.channels):
        return _Way(np.nan, 0.0)
    t, speed = drive.t, 0.5 * (drive.left + drive.right)
    heading = np.unwrap(drive.channels["yaw"]) * (-1.0 if mirrored else 1.0)
    place = drive.channels["x"] + 1j * drive.channels["y"]
    product, size = 0.0 + 0.0j, np.zeros(2)
    for run in drive.runs:
        edges = np.arange(t[run][0], t[run][-1], max(1.0, 5 * drive.usual_step))
        # The heading amid two readings: in a step, a robot that turns goes along neither.
        amid, rolled = (0.5 * (part[run][1:] + part[run][:-1]) for part in (heading, speed))
        way = np.append(0.0, np.cumsum(rolled * np.exp(1j * amid) * np.diff(t[run])))
        goes, went = (np.diff(np.interp(edges, t[run], one)) for one in (way, place[run]))
        product += complex(np.vdot(goes, went))
        size += [np.vdot(goes, goes).real, np.vdot(went, went).real]
    norm = np.sqrt(size.prod())
    alike = abs(product) / norm if norm > 0 else 0.0
    return _Way(float(np.angle(product)) if alike >= 0.7 else np.nan, alike)


def _pose(drive: Drive) -> _Found:
    """Whether the pose goes where treads and heading take the robot."""
    direct, mirrored = _way(drive), _way(drive, mirrored=True)
    if mirrored.alike > 0.9 and direct.alike < 0.9 * mirrored.alike:
        if abs(abs(mirrored.angle) - 0.5 * np.pi) < 0.6:
            what, remedy = "x and y are swapped", "swap them"
        else:
            what = "y counts to the right, or x backwards"
            remedy = f"map {'y' if abs(mirrored.angle) < 0.6 else 'x'}=NAME[-m]"
        yield Check(f"the pose is a mirror image of the motion: {what}", remedy=remedy)
        return
    angle = direct.angle
    if not np.isfinite(angle) or abs(angle) < 0.6:
        return
    if abs(angle) > 2.4:
        yield Check(
            "the pose goes backwards where the treads go forwards",
            remedy="map both tread speeds with a minus and swap their sides, or yaw is half a turn "
            "off",
        )
    else:
        yield Check(
            f"the pose goes {np.degrees(angle):.0f} degrees beside the heading: yaw is not "
            "measured from the x axis of the pose, or x and y are swapped",
            remedy="map them so that a robot of yaw 0 drives along +x",
        )


def _measured_twice(drive: Drive) -> _Found:
    """Ways, turns and powers that a log tells twice, whatever the robot."""
    return (one for one in check_consistency(drive, Measures()) if not one.ok)


# -- sides --------------------------------------------------------------------------------------

_LONG = 5.0  # time of driving straight in which no power stays the same [s]
_TURNS = 0.3  # yaw rate over a second that no robot has which is driven straight [rad/s]
_SHARE = 0.05  # share of the samples in which it must
_FEW, _TOLD = 5, 5.0  # samples, and seconds, that tell a sign at least
_DRAGGED = 1.3  # times the resistance of straight lines, which no side on the inside draws
_UNLIKE = 60.0  # ratio of both sides' powers that no ground explains


def _ahead(left: FloatArray, right: FloatArray) -> NDArray[np.bool_]:
    """Tell where both sides go the same way, about as fast."""
    return np.asarray(np.abs(left - right) < 0.1 * np.abs(left + right))


def _dead(drive: Drive) -> _Found:
    """Find a side that shows nothing while the robot drives."""
    for side, other in _EACH_SIDE:
        speed, theirs = drive.channels[f"v_{side}"], drive.channels[f"v_{other}"]
        about = any(abs(correlation(rate, theirs)) > 0.9 for rate in drive.rates.values())
        moves = np.count_nonzero(theirs) >= _ENOUGH and np.ptp(theirs) > 0.0
        if np.ptp(speed) == 0.0 and moves and not about:  # else it turns about the side that stands
            yield Check(
                f"v_{side} is {speed[0]:g} throughout while v_{other} changes: its encoder is "
                "dead, or the column another",
                remedy=f"map v_{side} to the speed of the {side} wheels", refuses="fitting",
            )  # fmt: skip
        if not drive.sides:
            continue
        power, drawn = drive.channels[f"p_{side}"], drive.channels[f"p_{other}"]
        # Straight on and on the spot neither side returns power.
        ahead = _ahead(np.abs(speed), np.abs(theirs)) & (drawn > 0)
        if np.ptp(power) == 0.0 < np.ptp(drawn) and np.count_nonzero(ahead) >= _ENOUGH:
            yield Check(
                f"p_{side} is {power[0]:g} throughout while p_{other} is not, also where both go "
                "as fast: its sensor is dead, or the column another",
                remedy=f"map p_{side} to the power of the {side} motors, or log the battery's",
                refuses="fitting",
            )


def _ends(values: FloatArray) -> Iterator[slice]:
    """Yield the stretches at the beginning and at the end in which a reading stays the same."""
    starts = np.concatenate([[0], np.flatnonzero(np.diff(values)) + 1])
    ends = np.append(starts[1:], len(values))
    for k in sorted({0, len(starts) - 1}):
        yield slice(int(starts[k]), int(ends[k]))


def _dying(drive: Drive) -> _Found:
    """Find a sensor that shows the same from or up to some time, while what it measures changes.

    What died stays dead; between others, such a stretch may be one of little power.
    """
    time = np.gradient(drive.t)
    electric = ["p_left", "p_right"] if drive.sides else ["power", "current"]
    for name in (n for n in ("v_left", "v_right", *electric) if n in drive.channels):
        values = drive.channels[name]
        for some in _ends(values):
            elsewhere = drive.moving.copy()
            elsewhere[some] = False
            others = values[elsewhere]
            # Without noise, or with few digits, all that is steady repeats.
            lively = len(others) >= _ENOUGH and len(np.unique(others)) > 0.5 * len(others)
            if lively and float((time * drive.moving)[some].sum()) > _LONG:
                yield _stays(drive, name, some, "the robot drives", "is dead there")
                break
    size = np.abs(drive.difference)
    turns = size > 0.4 * float(np.quantile(size, 0.95))
    for name, rate in drive.rates.items():
        for some in _ends(drive.channels[name]):
            alive = turns.copy()
            alive[some] = False
            # A steady turn may repeat a reading; one that is far below all others does not.
            still = alive.any() and np.median(np.abs(rate[some])) < 0.1 * np.median(
                np.abs(rate[alive])
            )
            if float((time * turns)[some].sum()) > _LONG and still:
                yield _stays(drive, name, some, "the treads turn",
                             "is dead there, or the wheels are off the ground")  # fmt: skip


def _stays(drive: Drive, name: str, some: slice, though: str, why: str) -> Check:
    """Say of a sensor that it shows the same for a stretch."""
    value, t = drive.channels[name][some.start], drive.t[some]
    return Check(
        f"{name} stays at {value:.4g} from t = {t[0]:.2f} to {t[-1]:.2f} s while {though}: its "
        f"sensor {why}",
        remedy="leave that stretch out",
    )


def _false_speeds(drive: Drive) -> _Found:
    """Speeds that are not those of two sides: one column twice, or without signs."""
    left, right, difference = drive.left, drive.right, drive.difference
    second = max(int(1.0 / drive.usual_step), 1)
    if np.array_equal(left, right):
        for name, rate in drive.rates.items():
            mean = rate[: len(rate) // second * second].reshape(-1, second).mean(axis=1)
            if len(mean) and np.mean(np.abs(mean) > _TURNS) > _SHARE:
                yield Check(
                    f"v_left and v_right are the same while {name} shows that the robot turns: "
                    "one column was used for both sides",
                    remedy="map each to its own", refuses="fitting",
                )  # fmt: skip
                return
        return
    # On the spot both treads seem to go the same way where they lost their signs.
    top = float(np.quantile(left + right, 0.99))
    if min(left.min(), right.min()) < -0.02 * top:
        return
    equal = (np.abs(difference) < 0.15 * (left + right)) & (left + right > 0.2 * top)
    for name, rate in drive.rates.items():
        turning = np.abs(rate) > _TURNS
        spinning = equal & turning & (np.abs(rate) > 0.5 * np.quantile(np.abs(rate), 0.99))
        if np.count_nonzero(spinning) <= max(_ENOUGH, 0.5 * _SHARE * len(left)):
            continue
        if not _turns_by(difference, rate, spinning, turning & ~spinning):
            yield Check(
                f"{name} shows that the robot spins where both treads seem to go forwards: the "
                "tread speeds lost their sign",
                remedy="log them with it, for unsigned speeds show neither turns nor reversing",
                refuses="fitting",
            )
            return


def _turns_by(
    difference: FloatArray, rate: FloatArray, some: NDArray[np.bool_], others: NDArray[np.bool_]
) -> bool:
    """Whether the speeds' difference makes the turns of some samples, as it does those of others.

    So it does in wide arcs of a robot that never turns on the spot: both sides are about as fast.
    """
    if abs(correlation(difference[some], rate[some])) < 0.7:
        return False
    if np.count_nonzero(others) < _ENOUGH:
        return True
    tracks = [
        float(difference[part] @ rate[part]) / float(rate[part] @ rate[part])
        for part in (some, others)
    ]
    return abs(tracks[0]) > 0.5 * abs(tracks[1])


def _unlike(drive: Drive) -> _Found:
    """Both sides' powers that are not two powers, or not in one unit."""
    p_left, p_right = drive.channels["p_left"], drive.channels["p_right"]
    apart = np.abs(np.abs(drive.left) - np.abs(drive.right))
    drawn = (p_left != 0) | (p_right != 0)
    drawing = (apart > 0.2 * float(np.quantile(apart, 0.99))) & (apart > 0) & drawn
    # On turns alone the inner side may take next to nothing, and where both sides are as fast,
    # straight on or on the spot, one may be pushed along by the other.
    alike = _ahead(np.abs(drive.left), np.abs(drive.right)) & drawn
    if np.count_nonzero(drawing) < _ENOUGH:
        return
    if np.array_equal(p_left[drawing], p_right[drawing]):
        yield Check(
            "p_left and p_right are the same, though the sides go at different speeds: one column "
            "was used for both",
            remedy="map each to its own, or map a total as power=NAME", refuses="fitting",
        )  # fmt: skip
        return
    if np.count_nonzero(alike) < _ENOUGH:
        return
    sizes = {
        name: [float(np.median(np.abs(power[some]))) for some in (drawing, alike)]
        for name, power in (("p_left", p_left), ("p_right", p_right))
    }
    for less, more in (("p_left", "p_right"), ("p_right", "p_left")):
        pairs = list(zip(sizes[less], sizes[more], strict=True))
        if all(0 < _UNLIKE * small < large for small, large in pairs):
            yield Check(
                f"{more} is {pairs[0][1] / pairs[0][0]:.3g} times as large as {less}: one side is "
                f"in another unit, or the sensor of {less} is dead",
                remedy=f"map both in one unit, as in {less}=NAME[kW]", refuses="fitting",
            )  # fmt: skip


def find_lost_sign(channels: Channels) -> str:
    """Tell whether the sides' powers, or that of one side, lost their sign."""
    drive = Drive(channels, channels["t"], ())
    return "".join(str(one) for one in _lost_sign(drive)) if drive.sides else ""


def _lost_sign(drive: Drive) -> _Found:
    """Powers of the sides, or of one side, that lost their sign.

    In arcs a force of slip F and a resistance K give the outer side (F + K) v, the inner one
    (K - F) v, which it returns where F is the larger. Without its sign, that looks as if F and K
    were exchanged. On straight lines the resistance alone remains: there it is seen which of the
    two it is. An inner side that is held back more than a straight line costs is pushed by the
    other.
    """
    difference = drive.difference
    turns = np.abs(difference) > 0.2 * float(np.quantile(np.abs(difference), 0.95))
    straight = np.abs(difference) < 0.01 * np.abs(drive.left + drive.right)
    # Samples of a slow log lie apart, and few of them tell as much.
    enough = int(np.clip(_TOLD / drive.usual_step, _FEW, _ENOUGH))
    lost: list[str] = []
    returned = False
    for side, speed, outwards in (("p_left", drive.left, -1.0), ("p_right", drive.right, 1.0)):
        power = drive.channels[side]
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
            return
        lost.append(side)
    if len(lost) == 1 and returned:
        yield Check(
            f"{lost[0]} is never negative, where the other side's is in arcs, and seems to be held "
            "back far more on the inside of them than on straight lines: its sensor shows what it "
            "returns as power drawn",
            remedy="log it with its sign",
        )
    elif lost:
        yield Check(
            "p_left and p_right are never negative, and in arcs the inner side seems to be held "
            "back far more than on straight lines: the sensors show what it returns as power drawn",
            remedy="log signed currents, or let diagnose find unsigned_power",
        )


# -- power --------------------------------------------------------------------------------------


def _powers(drive: Drive) -> _Found:
    """Power against the tread speeds: its sign, its side, its time."""
    t, channels, effort = drive.t, drive.channels, drive.effort
    moving = effort > 2 * _MOVING
    driven = int(np.count_nonzero(moving))
    if driven < _ENOUGH:
        few = f"{driven} readings of driving are too few", "nor mistakes with it; log longer"
        if 2 * driven < len(t):
            yield Check("the robot hardly moves; its power parameters cannot be found")
        else:
            yield Check(
                f"{few[0]}: power parameters cannot be found from this log alone, {few[1]}, or "
                "more often"
            )
        return
    if not np.any(drive.power):
        yield Check("power is zero all along")
        return
    yield from _steps(drive, moving)
    held = held_periods(channels)
    together: dict[str, list[str]] = {}
    for name, period in held.items():
        together.setdefault(f"{period:.2g}", []).append(name)
    for period_text, names in together.items():
        yield Check(
            f"{' and '.join(names)} {'are' if len(names) > 1 else 'is'} read every {period_text} s "
            f"only, and repeated from row to row between: {0.5 * float(period_text):.2g} s late in "
            "the mean, which diagnose allows for",
            remedy="log the power as often as the speeds",
        )
    flipped = [name for name in ("p_left", "p_right") if drive.sides and _flipped(drive, name)]
    if len(flipped) != 1:
        wrong = _wrong_sign(drive.power[moving]) and not _descends(drive)
        source = ["current"] if "current" in channels and "power" not in channels else ["power"]
        flipped = (["p_left", "p_right"] if drive.sides else source) if wrong else []
    if flipped:
        unit = "A" if flipped == ["current"] else "W"
        yield Check(
            f"{' and '.join(flipped)} has the wrong sign: power drawn counts positive, and so does "
            "the current of a discharge",
            remedy=f"map it with a minus in its unit, as in {flipped[0]}=NAME[-{unit}]",
            turned=tuple(flipped), refuses="reading",
        )  # fmt: skip
    elif drive.sides:
        speeds = np.abs(drive.left), np.abs(drive.right)
        arcs = (np.abs(speeds[1] - speeds[0]) > 0.15 * effort) & moving
        lean = (speeds[1] ** 2 - speeds[0] ** 2)[arcs]
        excess = (channels["p_right"] - channels["p_left"])[arcs]
        if len(lean) >= _ENOUGH and correlation(lean, excess) < -0.5:
            yield Check(
                "p_left and p_right seem to be swapped: in arcs the outer, faster tread must draw "
                "the more",
                refuses="trust",
            )
    some = _some(drive.runs)
    offset = find_offset("power", t, drive.power, power_regressors(channels, some), some)
    # Readings that are held are late by up to the time between them, which is told already.
    longest = max(held.values(), default=0.0)
    certain = offset is not None and offset.certain and offset.explained > 0.75
    if offset is not None and certain and not 0.0 < offset.seconds < longest:
        yield _late(offset)


def power_regressors(channels: Channels, runs: Sequence[slice]) -> list[FloatArray]:
    """Shapes that the power of any skid-steer robot is made of: rolling, sliding, speeding up."""
    t, left, right = channels["t"], channels["v_left"], channels["v_right"]
    mean, difference = left + right, right - left
    return [
        np.abs(left) + np.abs(right),
        np.abs(difference),
        mean * derivative(t, mean, runs, 0.5),
        difference * derivative(t, difference, runs, 0.5),
    ]


def _step(values: FloatArray, usual: float) -> float:
    """Return the step in which readings come; 0 where it is below a tenth of what is usual."""
    found = np.unique(np.round(values, 9))
    if not 4 <= len(found) <= len(values) / 4:
        return 0.0
    step = float(min(np.abs(found[found != 0.0]).min(), np.diff(found).min()))
    coarse = step >= 0.1 * usual and np.all(np.abs(found / step - np.round(found / step)) <= 0.02)
    return step if coarse else 0.0


def _steps(drive: Drive, moving: NDArray[np.bool_]) -> _Found:
    """Find readings with so few digits that a steady one is not known, however long it lasts."""
    speeds = np.concatenate([drive.left, drive.right])
    read = {"the tread speeds": (speeds[np.abs(speeds) > _MOVING], "m/s")}
    for name in (name for name in POWERS if name in drive.channels):
        if name != "current" or not {"p_left", "p_right", "power"} & set(drive.channels):
            read[name] = drive.channels[name][moving], "A" if name == "current" else "W"
    for name, (values, unit) in read.items():
        usual = float(np.median(np.abs(values)))
        values = np.abs(values) if unit == "m/s" else values
        if usual > 0.0 and (step := _step(values, usual)):
            yield Check(
                f"{name} {'come' if unit == 'm/s' else 'comes'} in steps of {step:.3g} {unit}, "
                f"where {usual:.2g} {unit} is usual: power parameters may be wrong by "
                f"{50 * step / usual:.0f} %, and more than their standard errors",
                remedy="log more digits",
            )


def held_periods(channels: Channels) -> dict[str, float]:
    """Return the powers that are held, and the time after which they are read again [s].

    Held readings change with a clock. Those that are steady, or have few digits, do not.
    """
    drive = Drive(channels, channels["t"], ())
    changing = np.append(False, np.diff(drive.effort) != 0.0)
    found = {}
    for name in (name for name in POWERS if name in channels):
        starts = np.flatnonzero(np.append(True, np.diff(channels[name]) != 0.0))
        drives = np.logical_and.reduceat(drive.moving, starts)
        counts, driving = np.diff(starts), drives[:-1] & drives[1:]
        if np.count_nonzero(driving) < 8:
            continue
        usual = float(np.median(counts[driving]))
        rows = np.flatnonzero(np.repeat(driving, counts))
        if usual < 3 or np.mean(changing[rows]) < 0.1:
            continue
        # A reading that is the one before by chance makes two of one; and one may be a row late.
        times = counts[driving] / usual
        regular = np.abs(times - np.clip(np.round(times), 1, 3)) * usual <= 1.0
        if np.mean(regular) > 0.9:
            found[name] = float(np.median(np.diff(drive.t[starts])[driving]))
    return found


def _flipped(drive: Drive, side: str) -> bool:
    """Whether a side's power is negative where the side can only draw.

    On the outside of an arc and on the spot it works against slip and resistance at once. The inner
    side of an arc generates, and on a straight line one side may push the other along; but where
    there are straight lines only, two sides that work equally against each other go nowhere.
    """
    right = side == "p_right"
    speed = drive.right if right else drive.left
    turn = drive.difference if right else -drive.difference
    outer = (turn * speed > 0) & (np.abs(turn) > np.maximum(_TURNING, 0.15 * drive.effort))
    outer &= np.abs(speed) > _MOVING
    enough = max(_ENOUGH, 3.0 / drive.usual_step)  # stops, which give back, are short
    drawn = drive.channels[side][outer]
    negative = _wrong_sign(drawn)
    if len(drawn) >= enough or (len(drawn) and not negative):
        return negative
    straight = (np.abs(turn) < 0.1 * drive.effort) & (drive.effort > 2 * _MOVING)
    # An arc of a large radius, to one side, looks the same, and ends elsewhere.
    bent = abs(float(turn[straight].sum())) > 0.01 * float(drive.effort[straight].sum())
    if np.count_nonzero(straight) < enough or bent:
        return False
    power = drive.channels[side][straight]
    opposite = drive.channels["p_left" if right else "p_right"][straight]
    return _wrong_sign(power) and bool(0.5 < -opposite.mean() / power.mean() < 2.0)


def _directed(drive: Drive) -> _Found:
    """Find a power that counts backwards where the robot goes so, as torques and currents may."""
    name = "current" if "current" in drive.channels and "power" not in drive.channels else "power"
    parts = [(name, drive.power, drive.left + drive.right, drive.moving)]
    if drive.sides:
        size = {"left": np.abs(drive.left), "right": np.abs(drive.right)}
        parts = [  # the inner side of an arc may return power
            (f"p_{one}", drive.channels[f"p_{one}"], drive.channels[f"v_{one}"],
             drive.moving & ((size[one] >= 0.95 * size[two]) | (drive.left * drive.right < 0.0)))
            for one, two in _EACH_SIDE
        ]  # fmt: skip
    found = []
    for name, power, speed, some in parts:
        ahead, back = (some & (sign * speed > _MOVING) for sign in (1.0, -1.0))
        enough = min(np.count_nonzero(ahead), np.count_nonzero(back)) >= _ENOUGH
        if enough and _wrong_sign(-power[ahead]) and _wrong_sign(power[back]):
            found.append(name)
    if found:
        yield Check(
            f"{' and '.join(found)} {'are' if len(found) > 1 else 'is'} positive forwards and "
            "negative backwards, as a motor's torque or current with the sign of its direction is: "
            "who drives draws power both ways",
            remedy="log the battery's current, or multiply by the speed, as in "
            "p_left=CURRENT*SPEED[*V_S_PER_M]",
        )


def _wrong_sign(power: FloatArray) -> bool:
    """Whether power is negative on the whole, beyond chance."""
    return bool(len(power) and power.mean() < -0.3 * np.abs(power).mean() and np.median(power) < 0)


def _descends(drive: Drive) -> bool:
    """Whether the drive goes downhill on the whole, as far as the log tells."""
    if "slope" not in drive.channels:
        return False
    forward = drive.left + drive.right
    return float(np.sin(drive.channels["slope"]) @ forward) < -0.02 * float(np.abs(forward).sum())


def _repeats(drive: Drive) -> _Found:
    """Find a power that changes with every sample, but stays the same for a while in driving.

    A sensor that hangs, one that drops out and one at the end of its range all repeat a reading to
    the last bit. One that reads in steps does so all the time, or wherever the robot goes steadily.
    """
    t, moving = drive.t, drive.moving
    least = max(5, round(0.3 / drive.usual_step))
    turned = np.append(False, np.diff(drive.effort) != 0.0)
    speeds = np.stack([drive.left, drive.right])
    change = np.abs(np.diff(speeds, prepend=speeds[:, :1])).sum(axis=0)
    calm = float(np.quantile(change[moving], 0.33)) if np.any(moving) else 0.0
    steady = moving & (change <= calm)
    seldom = held_periods(drive.channels)
    for name in (name for name in POWERS if name in drive.channels and name not in seldom):
        values = drive.channels[name]
        starts = np.flatnonzero(np.append(True, np.diff(values) != 0.0))
        counts = np.diff(np.append(starts, len(values)))
        drives = np.logical_and.reduceat(moving, starts)
        if name.startswith("p_"):  # of a side that returns nothing, zero is a reading
            drives &= (values[starts] != 0.0) | (drive.power[starts] == 0.0)
        blank = (values[starts] == 0.0) & (counts < least) & drives
        if name in ("power", "current") and np.count_nonzero(blank) > max(_ENOUGH, 0.01 * len(t)):
            yield Check(
                f"{name} falls to 0 for a moment {np.count_nonzero(blank)} times in driving: rows "
                "without a reading were filled with 0",
                remedy="leave such cells empty",
            )
        hangs = drives & (counts >= least)
        lost, usual = int(counts[hangs].sum()), counts[drives & ~hangs]
        if np.count_nonzero(hangs) < 3 or lost < 0.01 * np.count_nonzero(moving):
            continue
        if not len(usual) or np.mean(usual > 1) > 0.05:
            continue
        if np.mean(turned[np.repeat(hangs, counts)]) < 0.5:
            continue  # without noise, all that is driven steadily repeats
        held = values[starts[hangs]]
        if np.ptp(held) > 0.0 and np.mean(np.append(False, np.diff(values) == 0.0)[steady]) > 0.5:
            continue
        what = "hangs"
        if np.all(held == held[0]) and held[0] == 0.0:
            what = "drops out to 0"
        elif np.all(held == held[0]) and held[0] in (values.max(), values.min()):
            what = f"ends at {held[0]:.4g}, which is the end of its range"
        share = lost / np.count_nonzero(moving)
        yield Check(
            f"{name} {what} in {share:.0%} of the driving, first {t[starts[hangs][0]] - t[0]:.6g} "
            "s into the log: it repeats a reading where others change with every sample",
            remedy="mend the sensor, or leave such stretches out",
        )


def _motor_current(drive: Drive) -> _Found:
    """Find a current that is that of the motors, which follows torque and not power."""
    top = float(np.quantile(drive.effort, 0.95))
    rest, moving = drive.effort < 0.02 * top, drive.effort > 0.15 * top
    if np.count_nonzero(rest) < _ENOUGH or np.count_nonzero(moving) < 5 * _ENOUGH:
        return
    speed = drive.effort[moving]
    low, high = np.quantile(speed, [0.15, 0.85])
    if high < 1.6 * low:
        return  # one speed tells nothing of how the power depends on it
    turn = np.abs(drive.difference)[moving] / speed
    # Power per speed is a force, and depends on how tight the robot turns; a motor's current too.
    # What grows with speed and what does not is held apart for each.
    y = drive.power[moving]
    X = np.stack([speed, speed * turn, np.ones(len(speed)), turn])
    scale = np.sqrt((X * X).sum(axis=1))
    if np.any(scale == 0):
        X, scale = X[[0, 2]], scale[[0, 2]]
    unit = X / scale[:, None]
    gram = unit @ unit.T
    if np.linalg.cond(gram) > 1e4:
        return
    found = np.linalg.solve(gram, unit @ y) / scale
    half, mean = len(found) // 2, X.mean(axis=1)
    flat = float(found[half:] @ mean[half:]) - float(drive.power[rest].mean())
    grown = float(found[:half] @ mean[:half])
    spread = float(np.std(y - found @ X)) / max(abs(float(y.mean())), 1e-300)
    if flat > 0.7 * float(y.mean()) > 0 and flat > 3 * abs(grown) and spread < 0.8:
        yield Check(
            "the power jumps up when the robot begins to move and then hardly depends on its "
            "speed, as a motor's current does: voltage times motor current is no power",
            remedy="log the battery's current, or map the power by the motor's constant, as in "
            "p_left=CURRENT*SPEED[*V_S_PER_M]",
        )


_SIDES, _PLACE = frozenset({"p_left", "p_right"}), frozenset({"x", "y"})
_ALL: frozenset[str] = frozenset()
INVARIANTS = (
    Invariant("time steps are those of a drive, without gaps", _ALL, _time, ""),
    Invariant("a power falls where the robot slows down", _ALL, _counters, ""),
    Invariant("the robot turns as its treads say", _ALL, _turning, "", of_two_sides=True),
    Invariant("who drives draws power, at that time", _ALL, _powers, "", of_two_sides=True),
    Invariant("speeds are those of two sides, with their signs", _ALL, _false_speeds),
    Invariant("both sides show something", _ALL, _dead),
    Invariant("what sensors show changes to the end", _ALL, _dying),
    Invariant("both speeds count alike", _ALL, _counting),
    Invariant("sides seldom go against each other", _ALL, _opposed),
    Invariant("two powers are two, in one unit", _SIDES, _unlike),
    Invariant("a side that returns power has a negative one", _SIDES, _lost_sign),
    Invariant("a noisy power does not repeat", _ALL, _repeats),
    Invariant("the pose goes where treads and heading do", _PLACE | {"yaw"}, _pose),
    Invariant("power depends on speed", _ALL, _motor_current),
    Invariant("power is drawn backwards, too", _ALL, _directed, of_two_sides=True),
    Invariant("what is measured twice is the same", _ALL, _measured_twice),
)
"""What is asked of every drive, in the order in which it is told."""

# -- drives that are the same -------------------------------------------------------------------

_COMPARED = 16  # samples of which all must be found before all others are compared
_ENOUGH = 20  # samples at the same times that are alike by no chance


def without_copies(
    train: Sequence[DriveLog], holdout: Sequence[DriveLog]
) -> tuple[list[DriveLog], list[str]]:
    """Take each drive once: what is read twice makes nothing surer, and judges nothing."""
    if any(log is other for log in train for other in holdout):
        raise InvalidInputError("a drive stands in train and in holdout; give it to one of them")
    kept: list[DriveLog] = []
    left_out: dict[int, str] = {}
    # The longest first: of a drive and a part of it, the drive stays.
    for k in sorted(range(len(train)), key=lambda k: -len(train[k])):
        known = _named(train[k], kept)
        if known is None:
            kept.append(train[k])
        else:
            left_out[k] = (
                f"{train[k].name} holds the same readings as {known}; they were learned from once"
            )
    learned = [log for k, log in enumerate(train) if k not in left_out]
    told = [left_out[k] for k in sorted(left_out)]
    told += [
        f"{one.name} and {other.name} hold the same {shared} samples, which count twice: "
        "standard errors are too small; give each sample once"
        for one, other in combinations(learned, 2) if (shared := _shared(one, other))
    ]  # fmt: skip
    for log in holdout:
        known = _named(log, learned)
        if known is not None:
            told.append(
                f"{log.name} holds the same readings as {known}, which was learned from: errors on "
                "it say nothing of other drives; hold out another one"
            )
            continue
        told += [
            f"{log.name} holds {shared} samples of {other.name}, which were learned from: "
            "errors on them say nothing of other drives; hold out others"
            for other in learned if (shared := _shared(log, other))
        ]  # fmt: skip
    return learned, told


def _named(log: DriveLog, others: Iterable[DriveLog]) -> str | None:
    """Return the name of a drive that holds all of another one's readings, or is part of it."""
    return next((other.name for other in others if _alike(log, other)), None)


def _alike(one: DriveLog, other: DriveLog) -> bool:
    """Tell whether the shorter of two drives is part of the longer one.

    Of robots that stand all readings may be the same.
    """
    few, many = sorted((one, other), key=len)
    short, long = _readings(few), _readings(many)
    if not np.any(short[0]):
        return False
    firsts = np.arange(len(many) - len(few) + 1)
    for place in np.linspace(0, len(few) - 1, _COMPARED).astype(int):
        for part, whole in zip(short, long, strict=True):
            firsts = firsts[whole[firsts + place] == part[place]]
    return any(
        all(
            np.array_equal(part, whole[first : first + len(few)])
            for part, whole in zip(short, long, strict=True)
        )
        for first in firsts
    )


def _shared(one: DriveLog, other: DriveLog) -> int:
    """Count the samples of a moving robot that stand in two drives at the same times."""
    _, mine, theirs = np.intersect1d(one.t, other.t, assume_unique=True, return_indices=True)
    some, others = (
        np.stack(_readings(log))[:, rows] for log, rows in ((one, mine), (other, theirs))
    )
    alike = np.all(some == others, axis=0) & np.any(some[:2] != 0.0, axis=0)
    count = int(np.count_nonzero(alike))
    return count if count >= _ENOUGH else 0


def _readings(log: DriveLog) -> list[FloatArray]:
    """Return what every drive has: the speeds of both sides, and the power."""
    return [log.channel("v_left"), log.channel("v_right"), log.power]
