"""Does a drive log make sense, whatever the robot: signs, sides, sensors, units and clocks.

A rule looks at a drive and returns what is wrong, with its remedy; `find_checks` runs them all.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import combinations
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from energyplan.errors import InvalidInputError, NotIdentifiableError
from energyplan.logs.align import Offset, derivative, find_offset, gap_limit, time_weights
from energyplan.logs.consistency import (
    POWERS,
    Channels,
    Check,
    Measures,
    Observed,
    check_consistency,
    correlation,
    lasts,
    regress,
)
from energyplan.logs.mapping import LONGEST_STEP, ROW, SHORTEST_STEP, UNITS, dated
from energyplan.path import FloatArray

if TYPE_CHECKING:  # which imports this module
    from energyplan.logs import DriveLog


class CheckLimits(NamedTuple):
    """From which on a drive shows something."""

    enough: int = 20  # samples below which nothing is concluded
    turning: float = 0.05  # difference of the tread speeds from which the robot surely turns [m/s]
    moving: float = 0.03  # tread speed from which it surely moves [m/s]
    by_readings: float = 7.5  # time beyond which energies by the readings are chance [s]
    sparse: float = 1.5  # time from row to row beyond which most of a drive lies between them [s]
    pause: float = 10.0  # median steps without a row that show rows in bursts
    bursts: float = 0.05  # share of the rows that follow such a pause


_LIMITS = CheckLimits()
_EACH_SIDE = (("left", "right"), ("right", "left"))
_BY_SPEED = "p_left=CURRENT*SPEED[*V_S_PER_M]"  # how a motor's current makes a power
_Found = Iterable[Check]


class Rule(NamedTuple):
    """What holds of every drive, and how what breaks it is found."""

    what: str
    find: Callable[[Observed], _Found]
    refuses: str = "trust"  # what a check rules out that says nothing of it
    of_two_sides: bool = False  # of a dead side, the other one seems to break it
    needs: frozenset[str] = frozenset()  # channels without which nothing can be said


def find_checks(channels: Channels, power: FloatArray, runs: Sequence[slice]) -> list[Check]:
    """Return what is wrong with a drive."""
    return checks_of(Observed(channels, power, runs).averaged())


def checks_of(drive: Observed) -> list[Check]:
    """Return what is wrong with a drive, by what it shows."""
    dead = any(True for _ in _dead(drive))
    return [
        replace(check, refuses=check.refuses or one.refuses, rule=check.rule or one.what)
        for one in RULES if one.needs <= set(drive.channels) and not (dead and one.of_two_sides)
        for check in one.find(drive)
    ]  # fmt: skip


def refuse_one_side(logs: Sequence[DriveLog]) -> None:
    """Refuse logs that lack a side: what is identified from the other one is half of what is."""
    for log in logs:
        drive = Observed(log.channels, log.power, log.runs)
        rules = (_dead, _false_speeds, *((_unlike,) if drive.sides else ()))
        for check in (one for rule in rules for one in rule(drive)):
            raise NotIdentifiableError(f"{log.name}: {check}")


# -- time ---------------------------------------------------------------------------------------


def _time(drive: Observed) -> _Found:
    """Time in another unit; rows in bursts; gaps."""
    drive = drive.rows
    t, step = drive.t, drive.typical_step
    if step > LONGEST_STEP and dated(t):
        yield Check(
            f"rows are {step:g} s apart, and what the robot does between them is not seen",
            f"log every second or more often, at least every {LONGEST_STEP:g} s", "reading",
        )  # fmt: skip
        return
    if step > _LIMITS.sparse:
        yield Check(
            f"rows are {step:g} s apart: what the robot does between them is not seen",
            "log more often, as ten times a second",
            "trust" if step > _LIMITS.by_readings else "",
        )
    if not SHORTEST_STEP <= step <= LONGEST_STEP:
        sizes = {name: size for name, size in UNITS["t"].items() if name != "s"}
        unit = min(sizes, key=lambda name: abs(np.log(step * sizes[name] / 0.05)))
        yield Check(
            f"the time step of t is {step:g} s; between {1e3 * SHORTEST_STEP:g} ms and "
            f"{LONGEST_STEP:g} s is possible",
            f"name its unit, as in t=NAME[{unit}]", "reading",
        )  # fmt: skip
    jumps = np.mean(np.diff(t) > _LIMITS.pause * step)
    if jumps > _LIMITS.bursts:
        yield Check(
            f"t jumps by more than {_LIMITS.pause:g} usual steps in {jumps:.0%} of the rows: rows "
            "that were buffered bear the time of their arrival, or the logger sleeps",
            f"of readings at a steady rate, map t={ROW}[*PERIOD] with the time from row to row [s]",
            "trust",
        )
    starts = [t[run][-1] for run in drive.runs[:-1]]
    if starts:
        lost = sum(float(t[run][0]) for run in drive.runs[1:]) - sum(map(float, starts))
        named = ", ".join(f"{start:.2f} s" for start in starts[:3])
        gaps = "1 gap" if len(starts) == 1 else f"{len(starts)} gaps"
        yield Check(
            f"t has {gaps} longer than {gap_limit(t):.2g} s, {lost:.1f} s in all, after "
            f"t = {named}{', ...' if len(starts) > 3 else ''}; nothing is interpolated across them"
        )


class CounterLimits(NamedTuple):
    """From which on a channel is a counter."""

    grows: float = 0.9  # share of all change that is growth, of a counter
    # the same of a drive that speeds up and slows down, or of a side that may return
    steady: float = 0.5
    changes: int = 8  # of a counter, from which chance does not explain that all go one way


_COUNTER = CounterLimits()


def grows(values: FloatArray, share: float = _COUNTER.grows) -> int:
    """Return whether readings go one way all along like a counter: 1 up, -1 down, 0 neither."""
    steps = np.diff(values[np.isfinite(values)])
    total = float(np.abs(steps).sum())
    # A counter that is set back goes far in one step.
    if np.count_nonzero(steps) >= 2 * _COUNTER.changes:
        steps = steps[np.abs(steps) < max(0.5 * total, 1e-300)]
        total = float(np.abs(steps).sum())
    net = float(steps.sum())
    counted = np.count_nonzero(steps) >= _COUNTER.changes and abs(net) > share * total
    return int(np.sign(net)) if counted else 0


def _counters(drive: Observed) -> _Found:
    """Energy or charge for power or current: it only grows, though the robot slows down, too."""
    steps = np.diff(drive.effort)
    total = float(np.abs(steps).sum())
    if abs(float(steps.sum())) > _COUNTER.steady * total or total < 0.5 * float(drive.effort.max()):
        return  # nothing that the robot does would make a power fall
    for name in (name for name in POWERS if name in drive.channels):
        values = drive.channels[name]
        way = grows(values, _COUNTER.steady)
        # A power changes while the robot speeds up; a running total, as long as it drives.
        if way and abs(correlation(np.diff(values), drive.effort[1:])) > 0.5:
            what, units = ("energy", ("Wh", "J"))
            if name == "current":
                what, units = ("charge", ("mAh", "Ah"))
            ways = " or ".join(f"{name}=NAME[{'-' if way < 0 else ''}{unit}]" for unit in units)
            yield Check(
                f"{name} only ever {'grows' if way > 0 else 'falls'}, also where the robot slows "
                f"down: it counts {what}", f"map its rate of change, as in {ways}", "reading",
            )  # fmt: skip


# -- turning and pose ---------------------------------------------------------------------------


def _offset(drive: Observed, name: str, rate: FloatArray) -> Offset | None:
    return find_offset(name, drive.t, rate, [drive.difference], drive.runs, centred=False)


def yaw_rate_offset(log: DriveLog) -> Offset | None:
    """Return the time offset of a log's yaw rate against its tread speeds, if it is clear."""
    return _offset(Observed(log.channels, log.power, log.runs), "yaw_rate", log.channel("yaw_rate"))


def _late(offset: Offset) -> Check:
    way = "lags behind" if offset.seconds > 0 else "leads"
    return Check(
        f"{offset.channel} {way} the tread speeds by {abs(offset.seconds):.3f} s (explained "
        f"variance {offset.before:.3f} as logged, {offset.explained:.3f} once shifted)",
        f"diagnose allows for it, and DriveLog.shifted({offset.channel}={-offset.seconds:.3f}) "
        "puts it right", rule="late", channel=offset.channel,
    )  # fmt: skip


class _Relation(NamedTuple):
    """How a yaw rate goes with the difference of the tread speeds."""

    rate: FloatArray
    alike: float  # correlation as logged
    late: Offset | None  # by how much it is shifted in time, for certain
    sign: int  # -1 where it goes against them, 0 where it is not clear


def _relations(drive: Observed) -> dict[str, _Relation]:
    """Return how the yaw rates go with the treads, where the robot turns at all."""
    found = {}
    difference = drive.difference
    if np.count_nonzero(np.abs(difference) > _LIMITS.turning) < _LIMITS.enough:
        return {}
    for name, rate in drive.rates.items():
        if name == "yaw" and abs(correlation(rate, difference)) < 0.5:
            wrapped = np.unwrap(drive.channels[name], period=360.0)
            degrees = derivative(drive.t, wrapped, drive.runs, 0.5)
            rate = degrees if abs(correlation(degrees, difference)) > 0.5 else rate
        alike, offset = correlation(rate, difference), _offset(drive, name, rate)
        late = offset if offset is not None and offset.certain else None
        sign = late.sign if late is not None and abs(alike) < 0.5 else int(np.sign(alike))
        said = late is not None or abs(alike) > 0.3
        found[name] = _Relation(rate, alike, late, sign if said else 0)
    return found


def _turning(drive: Observed) -> _Found:
    """Measured turning and pose against the tread speeds."""
    relations = _relations(drive)
    yield from _frames(drive, relations)
    for name, (rate, alike, late, sign) in relations.items():
        if not np.any(rate):
            yield Check(f"{name} never changes, though the tread speeds say that the robot turns")
        if late is not None and sign >= 0:
            yield _late(late)
        track = float(drive.difference @ drive.difference) / max(
            float(rate @ drive.difference), 1e-300
        )
        if alike > 0.5 and track < 0.05:
            yield Check(
                f"{name} changes as if the slip track were {track * 1e3:.1f} mm; it seems to be in "
                "degrees", f"map {name}=NAME[{'deg' if name == 'yaw' else 'deg/s'}]", "reading",
            )  # fmt: skip
        if sign == 0 and np.any(rate):
            yield Check(
                f"{name} hardly follows v_right - v_left (correlation {alike:.2f})",
                "the tread ICRs cannot be trusted",
            )


class _Frame(NamedTuple):
    """A mistake of signs or sides, its remedy, and the channels without it."""

    what: str
    remedy: str
    undone: Callable[[Mapping[str, FloatArray]], dict[str, FloatArray]]
    needs: frozenset[str]
    turned: tuple[str, ...] = ()


def _frame(what: str, remedy: str, undone: str) -> _Frame:
    """Read a mistake whose remedy is to take other channels, or their negatives."""
    pairs = [entry.split("=") for entry in undone.split(",")]

    def result(channels: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
        return {
            name: -channels[other[1:]] if other.startswith("-") else channels[other]
            for name, other in pairs if name in channels
        }  # fmt: skip

    alone = len(pairs) == 1 and pairs[0][0] not in "xy"
    needs = frozenset(name for name, _ in pairs if len(pairs) < 3 or name != "yaw_rate")
    return _Frame(what, remedy, result, needs, (pairs[0][0],) if alone else ())


_MIRROR = "{0} counts the other way, as of a motor mounted in the mirror"
_MINUS = "map {0} with a minus before its unit, as in {0}=NAME[-m/s]"
_FRAMES = (
    *(_frame(_MIRROR.format(name), _MINUS.format(name), f"{name}=-{name}")
      for name in ("v_left", "v_right")),
    _frame("left and right are swapped", "swap them in the column mapping",
           "v_left=v_right,v_right=v_left"),
    _frame("the treads run backwards", "map both with a minus, as in v_left=NAME[-m/s],v_right="
           "NAME[-m/s]", "v_left=-v_left,v_right=-v_right"),
    _frame("the robot's rear counts as its front", "map both tread speeds with a minus and swap "
           "their sides", "v_left=-v_right,v_right=-v_left"),
    _frame("the gyroscope's axis is flipped", "map yaw_rate=NAME[-rad/s]", "yaw_rate=-yaw_rate"),
    _frame("yaw counts clockwise", "map yaw=NAME[-rad]", "yaw=-yaw"),
    _frame("all of the pose is in a frame whose z axis points down (NED)", "map y=NAME[-m],"
           "yaw=NAME[-rad] and, if there is one, yaw_rate=NAME[-rad/s]",
           "y=-y,yaw=-yaw,yaw_rate=-yaw_rate"),
    _frame("x and y are swapped", "swap them", "x=y,y=x"),
    _frame("y counts to the right", "map y=NAME[-m]", "y=-y"),
    _frame("x counts backwards", "map x=NAME[-m]", "x=-x"),
)  # fmt: skip
"""Mistakes of signs and sides."""


def _faults(drive: Observed, relations: Mapping[str, _Relation], sure: bool = False) -> list[str]:
    """Say where turning, treads and pose contradict each other; if `sure`, or do not agree."""
    found = [
        f"{name} falls while v_right exceeds v_left (correlation {one.alike:.2f})"
        for name, one in relations.items() if one.sign < 0 or (sure and one.sign == 0)
    ]  # fmt: skip
    turns = (np.mean(np.abs(rate) > _SIDE.turns) > _SIDE.share for rate in drive.rates.values())
    if sure and not relations and any(turns):
        found.append("the treads do not turn the robot")
    if mirrored_side(drive):
        found.append("the robot turns with the sum of the tread speeds, not with their difference")
    if {"x", "y", "yaw"} <= set(drive.channels):
        direct, mirrored = _way(drive), _way(drive, mirrored=True)
        if mirrored.alike > 0.9 and direct.alike < 0.9 * mirrored.alike:
            found.append("the pose is a mirror image of the motion")
        elif abs(direct.angle) > 2.4:
            found.append("the pose goes backwards where the treads go forwards")
        elif abs(direct.angle) >= 0.6 or (sure and np.isnan(direct.angle)):
            found.append(f"the pose goes {np.degrees(direct.angle):.0f} degrees beside the heading")
    return found


def _frames(drive: Observed, relations: Mapping[str, _Relation]) -> _Found:
    """Whether turning, treads and pose have the signs and sides of one robot; if not, why."""
    faults = _faults(drive, relations)
    if not faults:
        return
    against = any("falls while" in fault for fault in faults)
    frames = [one for one in _FRAMES if one.needs <= set(drive.channels)]
    angle = _way(drive).angle if {"x", "y", "yaw"} <= set(drive.channels) else np.nan
    if np.isfinite(angle):
        frames.append(_Frame(
            "yaw is not measured from the x axis of the pose",
            "map them so that a robot of yaw 0 drives along +x",
            lambda channels: {"yaw": channels["yaw"] + angle}, frozenset(),
        ))  # fmt: skip
    left = {}
    for one in frames:
        channels = {**drive.channels, **one.undone(drive.channels)}
        undone = Observed(channels, drive.power, drive.runs)
        left[one] = len(_faults(undone, _relations(undone), sure=True))
    least, before = min(left.values()), len(_faults(drive, relations, sure=True))
    best = [one for one in frames if left[one] == least < before]
    why = ", or ".join(one.what for one in best) or "several mistakes at once"
    yield Check(
        f"{', and '.join(faults)}: {why}",
        "; or ".join(one.remedy for one in best) or "check signs and sides of speeds and pose",
        "reading" if against else "trust", best[0].turned if len(best) == 1 else (),
    )  # fmt: skip


def _factors(drive: Observed) -> Iterator[tuple[float, float]]:
    """Return the sides' factors of each yaw rate that their difference makes worse [1/m]."""
    speeds = np.stack([drive.left, drive.right])
    gram = speeds @ speeds.T
    scale = np.sqrt(np.diag(gram))
    if np.any(scale <= 0):
        return
    # Speeds that hardly differ but for their sign show only the factor of their sum.
    apart = np.linalg.cond(gram / np.outer(scale, scale)) <= 400
    total = speeds.sum(axis=0)
    for rate in filter(lasts, drive.rates.values()):
        if apart:
            factors = np.linalg.solve(gram, speeds @ rate)
        elif gram[0, 1] < 0.0 < total @ total:
            factors = np.full(2, total @ rate / (total @ total))
        else:
            continue
        alike = correlation(factors @ speeds, rate)
        as_it_is = correlation(drive.difference, rate)
        if alike >= 0.93 and 1.0 - as_it_is**2 >= 2.0 * (1.0 - alike**2):
            yield float(factors[0]), float(factors[1])


def mirrored_side(drive: Observed) -> str:
    """Name the side whose speed counts the other way, as of a motor mounted in the mirror."""
    return next(
        ("v_right" if right < 0 else "v_left" for left, right in _factors(drive)
         if left * right > 0 and 0.4 < abs(right / left) < 2.5), "",
    )  # fmt: skip


def _counting(drive: Observed) -> _Found:
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
                "right wheels", "of speed V and yaw rate W make them, as in v_left=V-0.25*W,"
                "v_right=V+0.25*W with half the track",
            )]  # fmt: skip
        if left * right < 0 and not 0.6 < size < 1.6:
            return [Check(
                f"the yaw rate shows that v_left counts {size:.3g} times as much as v_right: one "
                "side is in another unit or has another wheel radius",
                f"give both the same, or map v_left=NAME[*{1 / size:.4g}]",
            )]  # fmt: skip
    return []


class SideLimits(NamedTuple):
    """From which on the two sides contradict each other."""

    opposed: float = 0.7  # share of the driving in which no drive turns on the spot
    long: float = 5.0  # time of driving straight in which no power stays the same [s]
    repeated: int = 5  # samples that show the same, at least, of a sensor that is dead
    turns: float = 0.3  # yaw rate over a second that no robot has which is driven straight [rad/s]
    share: float = 0.05  # share of the samples in which it must
    flips: float = 0.3  # share of the steps that go back at once, of a reading with noise
    few: int = 5  # least number of samples that show a sign
    sign_time: float = 5.0  # least time in which they do [s]
    # times the resistance of straight lines, which no side on the inside draws
    dragged: float = 1.3
    ratio: float = 60.0  # ratio of both sides' powers that no ground explains


_SIDE = SideLimits()


def _opposed(drive: Observed) -> _Found:
    """Without a heading, sides that go against each other as no drive does: one is mirrored."""
    if drive.rates or np.count_nonzero(drive.moving) < _LIMITS.enough:  # rates show more
        return
    effort, driving = drive.effort, float(drive.effort[drive.moving].sum())
    spun = float(effort[drive.moving & (drive.left * drive.right < 0.0)].sum()) / driving
    if {"x", "y"} <= set(drive.channels):  # a robot that turns on the spot stays there
        edges = np.arange(drive.t[0], drive.t[-1], max(3.0, 5 * drive.typical_step))
        steps = 0.25 * np.diff(drive.t) * (effort[1:] + effort[:-1])
        gone = np.hypot(*(np.diff(np.interp(edges, drive.t, drive.channels[n])) for n in "xy"))
        if float(gone.sum()) < 0.5 * float(steps.sum()):
            return
    saves = ""
    if spun < _SIDE.opposed:
        fit = regress([effort, np.abs(drive.difference), np.ones(len(drive.t))], drive.power)
        # Neighbouring samples repeat each other for about a second.
        chance = np.sqrt(max(1.0, 1.0 / drive.typical_step))
        per, turning = fit.values[:2]
        if fit.condition > 1e6 or turning > -max(0.2 * abs(per), 5.0 * chance * fit.errors[1]):
            return
        saves = ", and draw less power then"
    back = "v_left" if float(np.sum(drive.left)) < float(np.sum(drive.right)) else "v_right"
    yield Check(
        f"v_left and v_right go against each other in {spun:.0%} of the driving{saves}: a robot "
        "that turns on the spot all the time, or a motor mounted in the mirror",
        f"map the side that counts backwards with a minus, as in {back}=NAME[-m/s]; or log the yaw "
        "rate, which tells",
    )


class _Way(NamedTuple):
    """From where the treads would take the robot to where the pose goes."""

    angle: float  # angle between both [rad]; NaN where neither follows the other
    alike: float  # how well one follows the other, at most 1


def _way(drive: Observed, mirrored: bool = False) -> _Way:
    """Compare the pose with the treads' way, or with that way's mirror image in the x axis."""
    t, speed = drive.t, 0.5 * (drive.left + drive.right)
    heading = np.unwrap(drive.channels["yaw"]) * (-1.0 if mirrored else 1.0)
    place = drive.channels["x"] + 1j * drive.channels["y"]
    product, size = 0.0 + 0.0j, np.zeros(2)
    for run in drive.runs:
        edges = np.arange(t[run][0], t[run][-1], max(1.0, 5 * drive.typical_step))
        # The heading amid two readings: in a step, a robot that turns goes along neither.
        amid, rolled = (0.5 * (part[run][1:] + part[run][:-1]) for part in (heading, speed))
        way = np.append(0.0, np.cumsum(rolled * np.exp(1j * amid) * np.diff(t[run])))
        goes, went = (np.diff(np.interp(edges, t[run], one)) for one in (way, place[run]))
        product += complex(np.vdot(goes, went))
        size += [np.vdot(goes, goes).real, np.vdot(went, went).real]
    norm = np.sqrt(size.prod())
    alike = abs(product) / norm if norm > 0 else 0.0
    return _Way(float(np.angle(product)) if alike >= 0.7 else np.nan, alike)


def _measured_twice(drive: Observed) -> _Found:
    """Distances, turns and powers that a log holds twice, whatever the robot."""
    return (one for one in check_consistency(drive, Measures()) if not one.ok)


# -- sides --------------------------------------------------------------------------------------


def _ahead(left: FloatArray, right: FloatArray) -> NDArray[np.bool_]:
    """Return where both sides go the same way, about as fast."""
    return np.asarray(np.abs(left - right) < 0.1 * np.abs(left + right))


def _dead(drive: Observed) -> _Found:
    """Find a side that shows nothing while the robot drives."""
    for side, other in _EACH_SIDE:
        speed, theirs = drive.channels[f"v_{side}"], drive.channels[f"v_{other}"]
        about = any(abs(correlation(rate, theirs)) > 0.9 for rate in drive.rates.values())
        moves = np.count_nonzero(theirs) >= _LIMITS.enough and np.ptp(theirs) > 0.0
        if np.ptp(speed) == 0.0 and moves and not about:  # else it turns about the side that stands
            yield Check(
                f"v_{side} is {speed[0]:g} throughout while v_{other} changes: its encoder is "
                "dead, or the column another",
                f"map v_{side} to the speed of the {side} wheels", "fitting",
            )  # fmt: skip
        if not drive.sides:
            continue
        power, drawn = drive.channels[f"p_{side}"], drive.channels[f"p_{other}"]
        # Straight on and on the spot neither side returns power.
        ahead = _ahead(np.abs(speed), np.abs(theirs)) & (drawn > 0)
        if np.ptp(power) == 0.0 < np.ptp(drawn) and np.count_nonzero(ahead) >= _LIMITS.enough:
            yield Check(
                f"p_{side} is {power[0]:g} throughout while p_{other} is not, also where both go "
                "as fast: its sensor is dead, or the column another",
                f"map p_{side} to the power of the {side} motors, or log the battery's", "fitting",
            )  # fmt: skip


def _dying(drive: Observed) -> _Found:
    """Find a sensor that shows the same for a while, though what it measures changes."""
    drive = drive.rows
    time = time_weights(drive.t, drive.runs)
    size = np.abs(drive.difference)
    turns = size > 0.4 * float(np.quantile(size, 0.95))
    electric = ["p_left", "p_right"] if drive.sides else ["power", "current"]
    for name in (n for n in ("v_left", "v_right", *electric, *drive.rates) if n in drive.channels):
        rate = drive.rates.get(name)
        values = drive.channels[name] if rate is None else rate
        active = drive.moving if rate is None else turns
        starts, counts = drive.stretches(name)
        lasts_long = (np.add.reduceat(time * active, starts) > _SIDE.long) & (
            counts >= _SIDE.repeated
        )
        if rate is None:  # amid others, zeros may be of a side that stands, or of little power
            steps = np.diff(values[drive.moving])
            steps = steps[steps != 0.0]
            noisy = (
                len(steps) > _LIMITS.enough and np.mean(steps[1:] * steps[:-1] < 0.0) > _SIDE.flips
            )
            lasts_long[1:-1] &= noisy & (values[starts[1:-1]] != 0.0)
        for first, count in zip(starts[lasts_long], counts[lasts_long], strict=True):
            elsewhere = active.copy()
            elsewhere[first : first + count] = False
            others = values[elsewhere]
            if rate is None:  # without noise, or with few digits, all that is steady repeats
                changes = len(others) >= _LIMITS.enough and len(np.unique(others)) > 0.5 * len(
                    others
                )
            else:  # a steady turn may repeat a reading, but none that is far below all others
                still = np.median(np.abs(values[first : first + count]))
                changes = bool(len(others) and still < 0.1 * np.median(np.abs(others)))
            if changes:
                start, end = drive.t[[first, first + count - 1]]
                though, why = ("the robot drives", "") if rate is None else (
                    "the treads turn", ", or the wheels are off the ground")  # fmt: skip
                yield Check(
                    f"{name} stays at {drive.channels[name][first]:.4g} from t = {start:.2f} to "
                    f"{end:.2f} s while {though}: its sensor is dead there{why}",
                    "leave that stretch out",
                )  # fmt: skip
                break


def _false_speeds(drive: Observed) -> _Found:
    """Speeds that are not those of two sides: one column twice, or without signs."""
    left, right, difference = drive.left, drive.right, drive.difference
    if np.array_equal(left, right):
        second = max(int(1.0 / drive.typical_step), 1)
        for name, rate in drive.rates.items():
            mean = rate[: len(rate) // second * second].reshape(-1, second).mean(axis=1)
            if len(mean) and np.mean(np.abs(mean) > _SIDE.turns) > _SIDE.share:
                yield Check(
                    f"v_left and v_right are the same while {name} shows that the robot turns: "
                    "one column was used for both sides", "map each to its own", "fitting",
                )  # fmt: skip
                return
        return
    # On the spot both treads seem to go the same way where they lost their signs.
    top = float(np.quantile(left + right, 0.99))
    if min(left.min(), right.min()) < -0.02 * top:
        return
    equal = (np.abs(difference) < 0.15 * (left + right)) & (left + right > 0.2 * top)
    for name, rate in drive.rates.items():
        turning = np.abs(rate) > _SIDE.turns
        spinning = equal & turning & (np.abs(rate) > 0.5 * np.quantile(np.abs(rate), 0.99))
        if np.count_nonzero(spinning) <= max(_LIMITS.enough, 0.5 * _SIDE.share * len(left)):
            continue
        if not _turns_by(difference, rate, spinning, turning & ~spinning):
            yield Check(
                f"{name} shows that the robot spins where both treads seem to go forwards: the "
                "tread speeds lost their sign", "log them with it, for unsigned speeds show "
                "neither turns nor reversing", "fitting",
            )  # fmt: skip
            return


def _on_the_spot(drive: Observed) -> _Found:
    """Find, without a heading, that both sides forwards as fast take one of two forces."""
    left, right, effort = drive.left, drive.right, drive.effort
    top = float(np.quantile(effort, 0.99))
    if drive.rates or min(left.min(), right.min()) < -0.02 * top:
        return
    steady = np.abs(derivative(drive.t, effort, drive.runs, 0.5)) < 0.1 * top
    equal = steady & (np.abs(left - right) < 0.15 * effort) & (effort > 0.2 * top)
    if np.count_nonzero(equal) < 5 * _LIMITS.enough:
        return
    force = drive.power[equal] / effort[equal]
    low, high = np.quantile(force, [0.1, 0.9])
    between = np.abs(force - 0.5 * (low + high)) < 0.2 * (high - low)
    if 0.0 < 1.5 * low < high and np.mean(between) < 0.1:
        yield Check(
            "v_left and v_right are never negative, and where both are as fast the power over the "
            f"speed is one of two, {high / low:.2g} to one: the speeds lost their sign, so that "
            "turns on the spot seem straight, or the ground changes",
            "log speeds with their sign, or the yaw rate, which tells",
        )  # fmt: skip


def _turns_by(
    difference: FloatArray, rate: FloatArray, some: NDArray[np.bool_], others: NDArray[np.bool_]
) -> bool:
    """Whether the speeds' difference makes the turns of some samples as it does of others."""
    if abs(correlation(difference[some], rate[some])) < 0.7:
        return False
    if np.count_nonzero(others) < _LIMITS.enough:
        return True
    here, there = (
        abs(float(difference[part] @ rate[part]) / float(rate[part] @ rate[part]))
        for part in (some, others)
    )
    return here > 0.5 * there


def _unlike(drive: Observed) -> _Found:
    """Both sides' powers that are not two powers, or not in one unit."""
    p_left, p_right = drive.channels["p_left"], drive.channels["p_right"]
    apart = np.abs(np.abs(drive.left) - np.abs(drive.right))
    drawn = (p_left != 0) | (p_right != 0)
    drawing = (apart > 0.2 * float(np.quantile(apart, 0.99))) & (apart > 0) & drawn
    # On turns alone the inner side may take next to nothing, and where both sides are as fast,
    # straight on or on the spot, one may be pushed along by the other.
    alike = _ahead(np.abs(drive.left), np.abs(drive.right)) & drawn
    if np.count_nonzero(drawing) < _LIMITS.enough:
        return
    if np.array_equal(p_left[drawing], p_right[drawing]):
        yield Check(
            "p_left and p_right are the same, though the sides go at different speeds: one column "
            "was used for both", "map each to its own, or map a total as power=NAME", "fitting",
        )  # fmt: skip
    elif np.count_nonzero(alike) >= _LIMITS.enough:
        sizes: dict[str, FloatArray] = {
            name: np.array([np.median(np.abs(power[some])) for some in (drawing, alike)])
            for name, power in (("p_left", p_left), ("p_right", p_right))
        }
        less, more = sorted(sizes, key=lambda name: float(sizes[name][0]))
        if np.all((sizes[less] > 0) & (_SIDE.ratio * sizes[less] < sizes[more])):
            yield Check(
                f"{more} is {sizes[more][0] / sizes[less][0]:.3g} times as large as {less}: one "
                f"side is in another unit, or the sensor of {less} is dead",
                f"map both in one unit, as in {less}=NAME[kW]", "fitting",
            )  # fmt: skip


def find_lost_sign(channels: Channels) -> str:
    """Return the reason if the sides' powers, or that of one side, lost their sign."""
    drive = Observed(channels, channels["t"], ())
    return "".join(str(one) for one in _lost_sign(drive)) if drive.sides else ""


def _lost_sign(drive: Observed) -> _Found:
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
    # Samples of a slow log are far between, and few of them show as much.
    enough = int(np.clip(_SIDE.sign_time / drive.typical_step, _SIDE.few, _LIMITS.enough))
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
        shapes = [along * turns, size * turns, size * ~turns, np.ones(len(size))]
        fit = regress([one[some] for one in shapes], power[some])
        slip, resistance, seen = fit.values[:3]
        exchanged = 0.0 < 1.5 * slip < resistance and seen < np.sqrt(slip * resistance)
        if not (exchanged or 0.0 < _SIDE.dragged * seen < resistance - slip):
            return
        lost.append(side)
    if len(lost) == 1 and returned:
        yield Check(
            f"{lost[0]} is never negative, where the other side's is in arcs, and seems to be held "
            "back far more on the inside of them than on straight lines: its sensor shows what it "
            "returns as power drawn", "log it with its sign",
        )  # fmt: skip
    elif lost:
        yield Check(
            "p_left and p_right are never negative, and in arcs the inner side seems to be held "
            "back far more than on straight lines: the sensors show what it returns as power drawn",
            "log signed currents, or give --unsigned (signed=False of a DriveLog)",
        )


# -- power --------------------------------------------------------------------------------------


def _powers(drive: Observed) -> _Found:
    """Power against the tread speeds: its digits, its sign, its side, its time."""
    channels, effort = drive.channels, drive.effort
    moving = effort > 2 * _LIMITS.moving
    driven = int(np.count_nonzero(moving))
    if driven < _LIMITS.enough:
        yield Check(
            "the robot hardly moves; its power parameters cannot be found"
            if 2 * driven < len(drive.t) else
            f"{driven} readings of driving are too few: power parameters cannot be found from this "
            "log alone, nor mistakes with it; log longer, or more often"
        )  # fmt: skip
        return
    if not np.any(drive.power):
        yield Check("power is zero all along")
        return
    yield from _steps(drive.rows)
    held = drive.rows.held
    together: dict[str, list[str]] = {}
    for name, period in held.items():
        together.setdefault(f"{period:.2g}", []).append(name)
    for period_text, names in together.items():
        yield Check(
            f"{' and '.join(names)} {'are' if len(names) > 1 else 'is'} read every {period_text} s "
            f"only, and repeated from row to row between: {0.5 * float(period_text):.2g} s late in "
            "the mean, which diagnose allows for", "log the power as often as the speeds",
        )  # fmt: skip
    flipped = [name for name in ("p_left", "p_right") if drive.sides and _flipped(drive, name)]
    if len(flipped) != 1:
        wrong = _wrong_sign(drive.power[moving]) and not _descends(drive)
        flipped = list(drive.electric_names) if wrong else []
    if flipped:
        unit = "A" if flipped == ["current"] else "W"
        yield Check(
            f"{' and '.join(flipped)} has the wrong sign: power drawn counts positive, and so does "
            "the current of a discharge",
            f"map it with a minus in its unit, as in {flipped[0]}=NAME[-{unit}]", "reading",
            tuple(flipped),
        )  # fmt: skip
    elif drive.sides:
        fast = np.abs(drive.right) - np.abs(drive.left)
        arcs = (np.abs(fast) > 0.15 * effort) & moving
        excess = (channels["p_right"] - channels["p_left"])[arcs]
        if len(excess) >= _LIMITS.enough and correlation((fast * effort)[arcs], excess) < -0.5:
            yield Check(
                "p_left and p_right seem to be swapped: in arcs the outer, faster tread must draw "
                "the more", refuses="trust",
            )  # fmt: skip
    shapes = power_regressors(channels, drive.runs)
    offset = find_offset("power", drive.t, drive.power, shapes, drive.runs)
    # Readings that are held are late by up to the time between them, which is reported already.
    longest = max(held.values(), default=0.0)
    certain = offset is not None and offset.certain and offset.explained > 0.75
    if offset is not None and certain and not 0.0 < offset.seconds < longest:
        yield _late(offset)


def power_regressors(channels: Channels, runs: Sequence[slice]) -> list[FloatArray]:
    """Shapes that the power of any skid-steer robot consists of: rolling, sliding, speeding up."""
    t, left, right = channels["t"], channels["v_left"], channels["v_right"]
    mean, difference = left + right, right - left
    return [
        np.abs(left) + np.abs(right), np.abs(difference),
        mean * derivative(t, mean, runs, 0.5), difference * derivative(t, difference, runs, 0.5),
    ]  # fmt: skip


def _step(values: FloatArray, typical: float) -> float:
    """Return the step in which readings come; 0 where it is below a tenth of `usual`."""
    found = np.unique(np.round(values, 9))
    if not 4 <= len(found) <= len(values) / 4:
        return 0.0
    step = float(np.append(np.abs(found[found != 0.0]), np.diff(found)).min())
    coarse = step >= 0.1 * typical and np.all(np.abs(found / step - np.round(found / step)) <= 0.02)
    return step if coarse else 0.0


def _steps(drive: Observed) -> _Found:
    """Find readings with so few digits that a steady one is not known, however long it lasts."""
    moving = drive.effort > 2 * _LIMITS.moving
    speeds = np.abs(np.concatenate([drive.left, drive.right]))
    read = {"the tread speeds": (speeds[speeds > _LIMITS.moving], "m/s")}
    for name in drive.electric_names:
        read[name] = drive.channels[name][moving], "A" if name == "current" else "W"
    for name, (values, unit) in read.items():
        typical = float(np.median(np.abs(values)))
        if typical > 0.0 and (step := _step(values, typical)):
            yield Check(
                f"{name} {'come' if unit == 'm/s' else 'comes'} in steps of {step:.3g} {unit}, "
                f"where {typical:.2g} {unit} is usual: power parameters may be wrong by "
                f"{50 * step / typical:.0f} %, and more than their standard errors",
                "log more digits",
            )


def held_periods(channels: Channels) -> dict[str, float]:
    """Return the powers that are held, and the time after which they are read again [s]."""
    return Observed(channels, channels["t"], ()).held


def _flipped(drive: Observed, side: str) -> bool:
    """Whether a side's power is negative where the side can only draw.

    On the outside of an arc and on the spot it works against slip and resistance at once. The inner
    side of an arc generates, and on a straight line one side may push the other along; but where
    there are straight lines only, two sides that work equally against each other go nowhere.
    """
    right = side == "p_right"
    speed = drive.right if right else drive.left
    turn = drive.difference if right else -drive.difference
    outer = (turn * speed > 0) & (np.abs(turn) > np.maximum(_LIMITS.turning, 0.15 * drive.effort))
    outer &= np.abs(speed) > _LIMITS.moving
    enough = max(_LIMITS.enough, 3.0 / drive.typical_step)  # stops, which give back, are short
    drawn = drive.channels[side][outer]
    negative = _wrong_sign(drawn)
    if len(drawn) >= enough or (len(drawn) and not negative):
        return negative
    straight = (np.abs(turn) < 0.1 * drive.effort) & (drive.effort > 2 * _LIMITS.moving)
    # An arc of a large radius, to one side, looks the same, and ends elsewhere.
    bent = abs(float(turn[straight].sum())) > 0.01 * float(drive.effort[straight].sum())
    if np.count_nonzero(straight) < enough or bent:
        return False
    power = drive.channels[side][straight]
    opposite = drive.channels["p_left" if right else "p_right"][straight]
    return _wrong_sign(power) and bool(0.5 < -opposite.mean() / power.mean() < 2.0)


def _directed(drive: Observed) -> _Found:
    """Find a power that counts backwards where the robot goes so, as torques and currents may."""
    found = []
    for name in drive.electric_names:
        power, speed, some = drive.power, drive.left + drive.right, drive.moving
        if drive.sides:  # the inner side of an arc may return power
            one, other = (drive.left, drive.right)[:: 1 if name == "p_left" else -1]
            power, speed = drive.channels[name], one
            some = some & ((np.abs(one) >= 0.95 * np.abs(other)) | (one * other < 0.0))
        ahead, back = (some & (sign * speed > _LIMITS.moving) for sign in (1.0, -1.0))
        enough = min(np.count_nonzero(ahead), np.count_nonzero(back)) >= _LIMITS.enough
        if enough and _wrong_sign(-power[ahead]) and _wrong_sign(power[back]):
            found.append(name)
    if found:
        yield Check(
            f"{' and '.join(found)} {'are' if len(found) > 1 else 'is'} positive forwards and "
            "negative backwards, as a motor's torque or current with the sign of its direction is: "
            "who drives draws power both ways",
            f"log the battery's current, or multiply by the speed, as in {_BY_SPEED}",
        )


def _wrong_sign(power: FloatArray) -> bool:
    """Whether power is negative on the whole, beyond chance."""
    return bool(len(power) and power.mean() < -0.3 * np.abs(power).mean() and np.median(power) < 0)


def _descends(drive: Observed) -> bool:
    """Whether the drive goes downhill on the whole, as far as the log shows."""
    forward = drive.left + drive.right
    slope = drive.channels.get("slope", np.zeros(1))
    return float(np.sum(np.sin(slope) * forward)) < -0.02 * float(np.abs(forward).sum())


class MotionLimits(NamedTuple):
    """From which on a power does not follow the motion."""

    chopped: float = 1.2  # times as many zeros while it drives slowly, of pulses
    follows: float = 0.15  # share of a power's variance that the motion explains, at least
    episodes: int = 4  # of driving, and as many of standing, that show whether one draws more
    beyond: float = 3.0  # standard errors by which it does, at least
    far: float = 24 * 3600.0  # time by which a clock may be off [s]
    zone: float = 900.0  # which it then is by some whole quarters of an hour [s]
    # correlation of power and speeds from which a shift explains why they differ
    shifted: float = 0.5


_MOTION = MotionLimits()


def _repeats(drive: Observed) -> _Found:
    """Find a power that changes with every sample, but stays the same for a while in driving."""
    drive = drive.rows
    t, moving = drive.t, drive.moving
    least = max(5, round(0.3 / drive.typical_step))
    turned = np.append(False, np.diff(drive.effort) != 0.0)
    speeds = np.stack([drive.left, drive.right])
    change = np.abs(np.diff(speeds, prepend=speeds[:, :1])).sum(axis=0)
    calm = float(np.quantile(change[moving], 0.33)) if np.any(moving) else 0.0
    steady = moving & (change <= calm)
    seldom = drive.held
    for name in (name for name in POWERS if name in drive.channels and name not in seldom):
        values = drive.channels[name]
        starts, counts = drive.stretches(name)
        drives = np.logical_and.reduceat(moving, starts)
        if name.startswith("p_"):  # of a side that returns nothing, zero is a reading
            drives &= (values[starts] != 0.0) | (drive.power[starts] == 0.0)
        blank = (values[starts] == 0.0) & (counts < least) & drives
        if name in ("power", "current") and np.count_nonzero(blank) > max(
            _LIMITS.enough, 0.01 * len(t)
        ):
            what, remedy = "rows without a reading were filled with 0", "leave such cells empty"
            # Pulses of a bridge are the longer the faster it drives; a lost reading is chance.
            slow = moving & (drive.effort < float(np.median(drive.effort[moving])))
            zero = [float(np.mean(values[part] == 0.0)) for part in (slow, moving & ~slow)]
            if zero[0] > max(_MOTION.chopped * zero[1], 0.1):
                what, remedy = (
                    "it is chopped, as beside a PWM bridge, and its mean is what is drawn",
                    "average each column over some 0.1 s before the log is written, zeros too, as "
                    "by pandas: table.groupby(table.t // 0.1).mean()",
                )
            yield Check(
                f"{name} falls to 0 for a moment {np.count_nonzero(blank)} times in driving: "
                f"{what}", remedy,
            )  # fmt: skip
        hangs = drives & (counts >= least)
        lost, typical = int(counts[hangs].sum()), counts[drives & ~hangs]
        held, share = values[starts[hangs]], lost / max(int(np.count_nonzero(moving)), 1)
        often = np.count_nonzero(hangs) >= 3 and share >= 0.01
        if not often or not len(typical) or np.mean(typical > 1) > 0.05:
            continue
        # Without noise, all that is driven steadily repeats, but for rounding in its last digits.
        lively = np.mean(turned[np.repeat(hangs, counts)]) >= 0.5
        repeats = np.append(False, np.diff(values) == 0.0)
        bends = np.abs(np.diff(values, 3))[~(repeats[1:-2] | repeats[2:-1] | repeats[3:])]
        smooth = len(bends) and np.median(bends) <= 1e-9 * np.ptp(values)
        if not lively or smooth or (np.ptp(held) > 0.0 and np.mean(repeats[steady]) > 0.5):
            continue
        what = "hangs"
        if np.all(held == 0.0):
            what = "drops out to 0"
        elif np.ptp(held) == 0.0 and held[0] in (values.max(), values.min()):
            what = f"ends at {held[0]:.4g}, which is the end of its range"
        yield Check(
            f"{name} {what} in {share:.0%} of the driving, first {t[starts[hangs][0]] - t[0]:.6g} "
            "s into the log: it repeats a reading where others change with every sample",
            "mend the sensor, or leave such stretches out",
        )


def _unmoved(drive: Observed) -> _Found:
    """Find a power that does not rise when the robot drives: of another time, or another thing."""
    t = drive.t
    shapes = power_regressors(drive.channels, drive.runs)
    rest = regress([*shapes, np.ones(len(t))], drive.power).rest
    if rest.var() < (1.0 - _MOTION.follows) * drive.power.var() or _descends(drive):
        return
    offset = find_offset("power", t, drive.power, shapes, drive.runs)
    if offset is not None and offset.certain:
        return  # which is said already
    span = min(float(t[-1] - t[0]), _MOTION.far)
    shifts = [
        sign * k * _MOTION.zone
        for k in range(1, int(span / _MOTION.zone) + 1)
        for sign in (1.0, -1.0)
    ]
    rated: list[tuple[float, float]] = []
    for shift in shifts:
        inside = (t + shift >= t[0]) & (t + shift <= t[-1])
        if np.count_nonzero(inside) > max(5 * _LIMITS.enough, 0.2 * len(t)):
            moved = np.interp(t[inside] + shift, t, drive.power)
            speed = drive.effort[inside]
            alike = correlation(moved - moved.mean(), speed - speed.mean())
            rated.append((alike, shift))
    best, shift = max(rated, default=(0.0, 0.0))
    rise = _rise(t, drive.effort, drive.power)
    if best <= _MOTION.shifted and any(True for _ in _charged(drive)):
        return
    if best <= _MOTION.shifted and (rise is None or rise > _MOTION.beyond):
        return
    why = "its clock is not that of the speeds, or it is that of another consumer, or a counter"
    remedy = "log speed and power with one clock, and the power that the motors draw"
    if best > _MOTION.shifted:
        late, hours = "ahead" if shift > 0 else "behind", abs(shift) / 3600.0
        sign = "-" if shift > 0 else "+"
        why = f"the clock of the power is {hours:g} h {late} (correlation {best:.2f} once shifted)"
        remedy = f"give its file shifted, as in speeds.csv+power.csv@{sign}{hours:g}h"
    yield Check(f"the power does not rise when the robot drives: {why}", remedy)


def _rise(t: FloatArray, effort: FloatArray, power: FloatArray) -> float | None:
    """Return by how many standard errors driving draws more than standing; None if unseen."""
    top = float(np.quantile(effort, 0.95))
    if top < 2 * _LIMITS.moving:
        return None
    kind = np.where(effort > 0.5 * top, 1, np.where(effort < 0.25 * top, -1, 0))
    rows = np.flatnonzero(kind)
    if not len(rows):
        return None
    starts = np.flatnonzero(np.diff(kind[rows], prepend=0))
    means = np.add.reduceat(power[rows], starts) / np.diff(np.append(starts, len(rows)))
    driving, standing = (means[kind[rows][starts] == sign] for sign in (1, -1))
    if min(len(driving), len(standing)) < _MOTION.episodes:
        return None
    error = np.sqrt(driving.var(ddof=1) / len(driving) + standing.var(ddof=1) / len(standing))
    return float((driving.mean() - standing.mean()) / max(error, 1e-300))


def _motor_current(drive: Observed) -> _Found:
    """Find a current that is that of the motors, which follows torque and not power."""
    top = float(np.quantile(drive.effort, 0.95))
    rest, moving = drive.effort < 0.02 * top, drive.effort > 0.15 * top
    if np.count_nonzero(rest) < _LIMITS.enough or np.count_nonzero(moving) < 5 * _LIMITS.enough:
        return
    speed, power = drive.effort[moving], drive.power[moving]
    low, high = np.quantile(speed, [0.15, 0.85])
    if high < 1.6 * low:
        return  # one speed does not show how the power depends on it
    turn = np.abs(drive.difference)[moving] / speed
    # Power per speed is a force, and depends on how tight the robot turns; a motor's current too.
    # Each has a part that grows with speed and a part that does not.
    shapes = [speed, speed * turn, np.ones(len(speed)), turn]
    fit = regress(shapes if np.any(turn) else shapes[::2], power)
    if fit.condition > 1e4:
        return
    half = len(fit.values) // 2
    flat = float(fit.means[half:].sum()) - float(drive.power[rest].mean())
    grown = float(fit.means[:half].sum())
    spread = float(np.std(fit.rest)) / max(abs(float(power.mean())), 1e-300)
    if any(True for _ in _charged(drive)):  # which lowers the power at rest
        return
    if flat > 0.7 * float(power.mean()) > 0 and flat > 3 * abs(grown) and spread < 0.8:
        yield Check(
            "the power jumps up when the robot begins to move and then hardly depends on its "
            "speed, as a motor's current does: voltage times motor current is no power",
            "log the battery's current, or map the power by the motor's constant, as in "
            + _BY_SPEED,
        )


# -- sensors and publishers ----------------------------------------------------------------------


class FaultLimits(NamedTuple):
    """From which on readings show a fault."""

    fed: float = 0.1  # of the mean power of driving, that flows back at rest where something feeds
    # least time of one stretch, and of all, in which it does [s]
    standing: tuple[float, float] = (1.0, 3.0)
    ceiling: float = 0.03  # of the largest reading, in which those at the end of a range lie
    often: float = 0.1  # share of the driving in which they do, at least
    beyond: float = 1.15  # times as much as they show, that the motion asks for there
    longest_zero: int = 2  # samples that a speed is 0 for a moment, at most
    some_zeros: float = 0.02  # share of the driving in which it is, at least


_FAULT = FaultLimits()


def _charged(drive: Observed) -> _Found:
    """Find power that flows back while the robot stands: a charger, or a panel, feeds it."""
    top = float(np.quantile(drive.effort, 0.95))
    rest, moving = drive.effort < 0.05 * top, drive.moving
    drawn = float(drive.power[moving].mean()) if np.count_nonzero(moving) >= _LIMITS.enough else 0.0
    if drawn <= 0.0:  # of the wrong sign, which is said elsewhere
        return
    found: list[tuple[float, float, float]] = []
    for run in drive.runs:
        standing = rest[run]
        edges = np.flatnonzero(np.diff(np.concatenate([[0], standing.astype(int), [0]])))
        for first, last in edges.reshape(-1, 2) + run.start:
            lasting = float(drive.t[last - 1] - drive.t[first])
            mean = float(drive.power[first:last].mean())
            error = float(drive.power[first:last].std()) / np.sqrt(last - first)
            if lasting >= _FAULT.standing[0] and mean < -max(_FAULT.fed * drawn, 4.0 * error):
                found.append((lasting, mean, float(drive.t[first])))
    if sum(lasting for lasting, _, _ in found) < _FAULT.standing[1]:
        return
    longest, mean, start = max(found)
    yield Check(
        f"the battery is charged while the robot stands: {mean:.3g} W for {longest:.3g} s from t = "
        f"{start:.2f} s, as by a charger, a dock or a solar panel",
        "leave the time on the charger out; where a panel feeds while it drives too, log what the "
        "robot draws, which is the battery's power and the panel's together",
    )


def _ceiling(drive: Observed) -> _Found:
    """Find readings that stop at the end of a sensor's range where the motion asks for more."""
    moving = drive.moving
    if np.count_nonzero(moving) < 5 * _LIMITS.enough:
        return
    for name in drive.electric_names:
        values = drive.channels[name]
        effort, turning = drive.effort, np.abs(drive.difference)
        if drive.sides:
            speed = drive.left if name == "p_left" else drive.right
            effort = np.abs(speed)
        high = float(np.max(values[moving]))
        at_end = moving & (values >= (1.0 - _FAULT.ceiling) * high)
        below = moving & ~at_end
        if high <= 0.0 or np.count_nonzero(at_end) < max(
            _LIMITS.enough, _FAULT.often * np.count_nonzero(moving)
        ):
            continue
        if np.count_nonzero(below) < 2 * _LIMITS.enough:
            continue
        shapes = [effort, turning, np.ones(len(values))]
        fit = regress([shape[below] for shape in shapes], values[below])
        asked = _sum(fit.values, [shape[at_end] for shape in shapes])
        read = values[at_end]
        spread = float(np.std(asked)) > 3.0 * float(np.std(read))
        if (
            fit.condition < 1e6
            and spread
            and float(asked.mean()) > _FAULT.beyond * float(read.mean())
        ):
            share = np.count_nonzero(at_end) / np.count_nonzero(moving)
            unit = "A" if name == "current" else "W"
            yield Check(
                f"{name} ends at {high:.4g} {unit} in {share:.0%} of the driving, where the motion "
                "asks for more: this is the end of its range",
                "use a sensor with a larger range, or leave such stretches out",
            )


def _sum(factors: FloatArray, shapes: list[FloatArray]) -> FloatArray:
    return np.asarray(factors @ np.stack(shapes))


def _zeros_between(drive: Observed) -> _Found:
    """Find speeds that fall to 0 for a sample or two while the robot drives on."""
    drive = drive.rows
    found: dict[str, int] = {}
    for name, speed in (("v_left", drive.left), ("v_right", drive.right)):
        size = np.abs(speed)
        typical = float(np.median(size[size > 0.0])) if np.count_nonzero(size) else 0.0
        blank = _short_zeros(speed)
        fast = np.flatnonzero(blank)
        before, after = fast - 1, fast + 1
        while len(fast) and np.any(blank[after]):
            after = np.where(blank[after], after + 1, after)
        while len(fast) and np.any(blank[before]):
            before = np.where(blank[before], before - 1, before)
        low = np.minimum(speed[before] * np.sign(speed[after]), size[after])
        count = int(np.count_nonzero(low > 0.5 * typical))
        if typical > 0.0 and count >= max(
            _LIMITS.enough, _FAULT.some_zeros * np.count_nonzero(size > 0.5 * typical)
        ):
            found[name] = count
    if found:
        yield Check(
            f"{' and '.join(found)} {'fall' if len(found) > 1 else 'falls'} to 0 for a moment "
            f"{max(found.values())} times in driving: another publisher sends zeros, or rows "
            "without a reading were filled with 0",
            "stop the other publisher, as a joint_state_publisher beside the driver's, or leave "
            "such cells, or messages, out",
        )


def _short_zeros(speed: FloatArray) -> NDArray[np.bool_]:
    """Return where a speed is 0 for no more than a few samples, neither at its begin nor end."""
    zero = speed == 0.0
    edges = np.flatnonzero(np.diff(np.concatenate([[0], zero.astype(int), [0]]))).reshape(-1, 2)
    result = np.zeros(len(speed), bool)
    for first, last in edges:
        result[first:last] = last - first <= _FAULT.longest_zero and first > 0 and last < len(speed)
    return result


_SIDES = frozenset({"p_left", "p_right"})
RULES = (
    Rule("time steps are those of a drive, without gaps", _time, ""),
    Rule("a power falls where the robot slows down", _counters, ""),
    Rule("the robot turns, and goes, as its treads say", _turning, "", True),
    Rule("who drives draws power, at that time", _powers, "", True),
    Rule("speeds are those of two sides, with their signs", _false_speeds),
    Rule("both sides forwards take one force", _on_the_spot, ""),
    Rule("both sides show something", _dead),
    Rule("what sensors show changes to the end", _dying),
    Rule("both speeds count alike", _counting),
    Rule("sides seldom go against each other", _opposed),
    Rule("two powers are two, in one unit", _unlike, needs=_SIDES),
    Rule("a side that returns power has a negative one", _lost_sign, needs=_SIDES),
    Rule("a noisy power does not repeat", _repeats),
    Rule("a speed does not fall to 0 for a moment", _zeros_between),
    Rule("no power ends where the motion asks for more", _ceiling),
    Rule("nothing feeds a robot that stands", _charged),
    Rule("power depends on speed", _motor_current),
    Rule("power rises when the robot drives", _unmoved, of_two_sides=True),
    Rule("power is drawn backwards, too", _directed, of_two_sides=True),
    Rule("what is measured twice is the same", _measured_twice),
)
"""What is checked of every drive, in the order in which it is reported."""

# -- drives that are the same -------------------------------------------------------------------


def without_copies(
    train: Sequence[DriveLog], holdout: Sequence[DriveLog]
) -> tuple[list[DriveLog], list[str]]:
    """Take each drive once: what is read twice makes nothing surer, and judges nothing."""
    for log in holdout:
        same = next((other.name for other in train if log is other or _alike(log, other)), None)
        if same is not None:
            raise InvalidInputError(
                f"{log.name} is held out and holds the same readings as {same}, which is learned "
                "from: errors on it say nothing of other drives; hold out another one"
            )
    kept: list[DriveLog] = []
    left_out: dict[int, str] = {}
    # The longest first: of a drive and a part of it, the drive stays.
    for k in sorted(range(len(train)), key=lambda k: -len(train[k])):
        known = next((other.name for other in kept if _alike(train[k], other)), None)
        if known is None:
            kept.append(train[k])
        else:
            left_out[k] = (
                f"{train[k].name} holds the same readings as {known}; they were learned from once"
            )
    learned = [log for k, log in enumerate(train) if k not in left_out]
    said = [left_out[k] for k in sorted(left_out)]
    said += [
        f"{one.name} and {other.name} hold the same {shared} samples, which count twice: "
        "standard errors are too small; give each sample once"
        for one, other in combinations(learned, 2) if (shared := _shared(one, other))
    ]  # fmt: skip
    for log in holdout:
        said += [
            f"{log.name} holds {shared} samples of {other.name}, which were learned from: "
            "errors on them say nothing of other drives; hold out others"
            for other in learned if (shared := _shared(log, other))
        ]  # fmt: skip
    return learned, said


def _alike(one: DriveLog, other: DriveLog) -> bool:
    """Return whether the shorter of two drives is part of the longer one."""
    short, long = (_readings(log) + 0.0 for log in sorted((one, other), key=len))  # no zero is -0
    return bool(np.any(short[0])) and short.T.tobytes() in long.T.tobytes()


def _shared(one: DriveLog, other: DriveLog) -> int:
    """Count the samples of a moving robot that stand in two drives at the same times."""
    _, mine, theirs = np.intersect1d(one.t, other.t, assume_unique=True, return_indices=True)
    some, others = _readings(one)[:, mine], _readings(other)[:, theirs]
    alike = np.all(some == others, axis=0) & np.any(some[:2] != 0.0, axis=0)
    count = int(np.count_nonzero(alike))
    return count if count >= _LIMITS.enough else 0


def _readings(log: DriveLog) -> FloatArray:
    """Return what every drive has, (3, n): the speeds of both sides, and the power."""
    return np.stack([log.channel("v_left"), log.channel("v_right"), log.power])
