"""Robots of a simulation of their own, most with a cause that the catalogue lacks: what is said.

    python benchmarks/foreign.py COUNT [--first SEED] [--cause NAME...] [--records FILE]
                                 [--write docs/diagnosis.md]

COUNT robots, one cause after the other; the seed draws robot, sensors and drives. Nothing of the
package's simulation or power terms is used: friction rises with the slip speed (tanh), runs differ
by 2 % as a whole, and the noise of the power lasts for 0.05 to 0.5 s. A robot weighs 8 to 900 kg
and logs 5 to 20 readings a second, half of them the power of both sides, three in five a pose. It
learns from two to five brisk drives of a minute to two, and is judged on one more.

    nothing, gain                  hide nothing; the gain of the power, 5 %, is in no log
    hotel, viscous_copper          are in the catalogue, and so are
    lag, clock                     a late power (a lag of 0.3 s; a clock that gains 1.2 %)
    slope                          an accelerometer's or map's slope that is wrong by 2 degrees
    drift, brake                   friction that changes with time; a brake that drags for a while
    transfer, tyres, bumps         friction by lateral load, slip by force, a wavy ground
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pages import write
from scipy.signal import lfilter

from energyplan import DriveLog, Vehicle, diagnose, identify
from energyplan.errors import NotIdentifiableError
from energyplan.fit import fit_residual

Array = NDArray[np.float64]

CAUSES = (
    "nothing", "hotel", "drift", "gain", "viscous_copper", "brake", "lag", "transfer", "clock",
    "slope", "tyres", "bumps",
)  # fmt: skip
SOUND = ("nothing", "gain")
"""Causes that leave the log as two terms say."""
NAMED: dict[str, tuple[frozenset[str], ...]] = {
    "hotel": (frozenset({"hotel_load"}),),
    "viscous_copper": (frozenset({"viscous_loss", "copper_loss"}),),
    "lag": (frozenset({"time_offset"}),),
    "slope": (
        frozenset({"grade", "towing_force"}), frozenset({"towing_force"}), frozenset({"grade"}),
    ),
}  # fmt: skip
"""Names, or sets of names, that are right; a slope's error acts as a force that tows."""
NEAR = {
    "clock": {"time_offset"}, "brake": {"dragging_wheel_left"}, "drift": {"warm_up"},
    "transfer": {"slip_speed_friction", "stribeck_friction"}, "viscous_copper": {"air_drag"},
}  # fmt: skip
"""Names of the catalogue that are next to a cause, and not false."""
FOREIGN = ("drift", "brake", "transfer", "bumps")
"""Causes that no effect of the catalogue is, and that a log shows."""
USUAL = {"linear_inertia", "angular_inertia", "specific_force", "friction_mobilisation"}
"""Effects that nearly every robot has; a simulated robot has mass."""

GRAVITY = 9.81
SPREAD = 0.02
"""Standard deviation of the factor of a run's power."""
STEP = 0.01
"""Step of the simulation [s]."""

RESPONSE = 0.1
"""Time constant of each of two lags of the speeds behind their commands [s]."""


@dataclass(frozen=True)
class Said:
    """What was said of one robot."""

    seed: int
    cause: str
    names: tuple[str, ...]
    verdict: str
    before: float  # relative error of the hold-out drive's energy, of two terms
    after: float  # of the model that is handed on
    within: bool  # whether the 90 % interval holds the measured energy
    seconds: float
    left_open: bool = False  # whether the right names are among those that drives cannot separate

    @property
    def right(self) -> bool:
        """Whether what is hidden is named, and nothing else."""
        return frozenset(self.names) in NAMED.get(self.cause, (frozenset[str](),))

    @property
    def false(self) -> bool:
        """Whether something was named that is not there."""
        there = set(NEAR.get(self.cause, ())).union(*NAMED.get(self.cause, ()))
        return not set(self.names) <= there


@dataclass(frozen=True)
class Machine:
    """A robot: its body, friction and sensors."""

    mass: float
    track: float
    wheelbase: float
    slip_track: float  # distance of the tread ICRs [m]
    roll: float  # resistance of a side [N]
    mu: float
    pace: float  # usual speed [m/s]
    rate: float  # readings a second
    sides: bool
    posed: bool
    noise: float  # of the power [W]
    memory: float  # of that noise [s]

    @classmethod
    def drawn(cls, rng: np.random.Generator) -> Machine:
        """Draw a robot."""
        mass = float(np.exp(rng.uniform(np.log(8.0), np.log(900.0))))
        size = (mass / 60.0) ** (1.0 / 3.0)
        track = 0.55 * size * float(rng.uniform(0.85, 1.15))
        roll = mass * GRAVITY * float(rng.uniform(0.03, 0.08)) / 2.0
        pace = float(rng.uniform(0.5, 1.1)) * float(np.sqrt(size))
        return cls(
            mass, track, 0.9 * track * float(rng.uniform(0.8, 1.2)),
            track * float(rng.uniform(1.3, 2.0)), roll, float(rng.uniform(0.3, 0.8)), pace,
            float(rng.choice([5.0, 10.0, 20.0])), bool(rng.random() < 0.5),
            bool(rng.random() < 0.6), float(rng.uniform(0.02, 0.06)) * 2.0 * roll * pace,
            float(rng.uniform(0.05, 0.5)),
        )  # fmt: skip

    @property
    def vehicle(self) -> Vehicle:
        """What a user knows of it."""
        return Vehicle.from_geometry(
            "foreign", mass=self.mass, wheelbase=self.wheelbase, track=self.track,
            length=1.4 * self.wheelbase, width=1.2 * self.track,
        )  # fmt: skip


def brisk(machine: Machine, rng: np.random.Generator) -> tuple[Array, Array, Array]:
    """Return times, speed and yaw rate of a drive: straights, arcs, spins, stops."""
    spin = machine.pace / (0.5 * machine.slip_track)
    wanted, span = list[tuple[float, float]](), float(rng.uniform(70.0, 120.0))
    lengths = list[float]()
    while sum(lengths) < span:
        kind = rng.choice(4, p=[0.3, 0.4, 0.2, 0.1])
        v = machine.pace * float(rng.uniform(0.3, 1.0)) * float(rng.choice([1.0, 1.0, 1.0, -1.0]))
        w = spin * float(rng.uniform(0.15, 0.7)) * float(rng.choice([1.0, -1.0]))
        wanted.append([(v, 0.0), (v, w), (0.0, w), (0.0, 0.0)][int(kind)])
        lengths.append(float(rng.uniform(1.5, 6.0)))
    count = np.round(np.array(lengths) / STEP).astype(int)
    v, w = (np.repeat(one, count) for one in np.array(wanted).T)
    reach = float(rng.uniform(0.4, 1.0)) * STEP
    out = np.zeros((2, len(v)))
    limits = (reach, reach * spin / machine.pace)
    for row, goal, most in zip(out, (v, w), limits, strict=True):
        now = 0.0
        for k, to in enumerate(goal):
            now += min(max(to - now, -most), most)
            row[k] = now
    fade = float(np.exp(-STEP / RESPONSE))  # motors follow a command with a delay, twice over
    ahead, turn = (
        lfilter([(1.0 - fade) ** 2], [1.0, -2.0 * fade, fade**2], one) for one in out
    )  # fmt: skip
    return STEP * np.arange(len(v)), np.asarray(ahead), np.asarray(turn)


def smooth_sign(speed: Array, scale: float) -> Array:
    """Return friction's share of its whole at a sliding speed."""
    return np.asarray(np.tanh(speed / scale))


def powers(
    machine: Machine, cause: str, t: Array, v: Array, w: Array, size: float, began: float,
    rng: np.random.Generator,
) -> tuple[Array, Array, Array]:  # fmt: skip
    """Return the power of both sides, and the electric power that neither side shows [W]."""
    half = 0.5 * machine.slip_track
    speeds = np.stack([v - half * w, v + half * w])
    weight = machine.mass * GRAVITY
    roll, mu = np.full((2, len(t)), machine.roll), np.full(len(t), machine.mu)
    if cause == "drift":
        mu = mu * (1.0 + 0.5 * size * np.sin(2.0 * np.pi * t / 53.0 + began))
        roll = roll * (1.0 + 0.4 * size * np.cos(2.0 * np.pi * t / 71.0 + began))
    if cause == "transfer":  # the load of the outer side rises with v w
        shift = v * w / GRAVITY * 0.9 * machine.track / machine.track
        mu = mu * np.maximum(1.0 + 3.0 * size * np.abs(shift), 0.2)
        roll = roll * np.stack([1.0 - shift * size, 1.0 + shift * size])
    if cause == "brake":
        start = float(rng.uniform(0.2, 0.5)) * t[-1]
        on = (t > start) & (t < start + 0.3 * t[-1])
        roll[0] += 0.9 * size * machine.roll * on
    arm = 0.25 * np.hypot(machine.track, machine.wheelbase)
    moment = mu * weight * arm * smooth_sign(w * arm, 0.005 * machine.pace)
    inertia = machine.mass / 12.0 * (machine.track**2 + (1.4 * machine.wheelbase) ** 2)
    moment = moment + inertia * np.gradient(w, STEP)
    push = machine.mass * np.gradient(v, STEP)
    if cause == "slope":
        push = push + weight * np.sin(np.radians(2.0)) * size
    if cause == "bumps":
        way = np.cumsum(np.abs(v)) * STEP
        push = push + 0.6 * size * machine.roll * np.sin(2.0 * np.pi * way / machine.wheelbase) \
            * np.sign(v)  # fmt: skip
        push = push + 0.5 * size * machine.roll * np.sign(v) * (np.sin(way / 2.5) > 0.3)
    turn = moment / machine.slip_track
    forces = np.stack([0.5 * push - turn, 0.5 * push + turn])
    forces += roll * smooth_sign(speeds, 0.005 * machine.pace)
    if cause == "viscous_copper":
        forces += 0.35 * size * machine.roll / machine.pace * speeds
    if cause == "tyres":  # a wheel turns faster than the tread by a share that rises with the force
        speeds = speeds * (1.0 + 0.04 * size * np.abs(forces) / (4.0 * machine.roll))
    sides = forces * speeds
    if cause == "viscous_copper":
        sides += 0.09 * size * machine.pace / machine.roll * forces**2
    rest = np.full(len(t), 0.6 * size * machine.roll * machine.pace * (cause == "hotel"))
    return sides[0], sides[1], rest


def remembering(count: int, memory: float, rng: np.random.Generator) -> Array:
    """Return noise of unit deviation that lasts for a time [s]."""
    fade = float(np.exp(-STEP / memory))
    white = rng.normal(0.0, np.sqrt(1.0 - fade**2), count)
    return np.asarray(lfilter([1.0], [1.0, -fade], white))


def driven(
    machine: Machine, cause: str, size: float, rng: np.random.Generator, name: str
) -> DriveLog:
    """Return the log of a drive."""
    t, v, w = brisk(machine, rng)
    left, right, rest = powers(machine, cause, t, v, w, size, float(rng.uniform(0.0, 6.0)), rng)
    factor = 1.0 + SPREAD * float(rng.normal())
    if cause == "gain":
        factor *= 1.05
    noise = machine.noise / (np.sqrt(2.0) if machine.sides else 1.0)
    shown = [left + 0.5 * rest, right + 0.5 * rest] if machine.sides else [left + right + rest]
    shown = [factor * one + noise * remembering(len(t), machine.memory, rng) for one in shown]
    if cause == "lag":
        fade = float(np.exp(-STEP / 0.3))
        shown = [lfilter([1.0 - fade], [1.0, -fade], one) for one in shown]
    at = np.arange(0.0, t[-1], 1.0 / machine.rate)
    of_power = np.minimum(at * (1.012 if cause == "clock" else 1.0), t[-1])
    half = 0.5 * machine.slip_track

    def read(values: Array, when: Array = at) -> Array:
        return np.interp(when, t, values)

    def white(deviation: float) -> Array:
        return rng.normal(0.0, deviation, len(at))

    slow = 0.004 * machine.pace
    yaw = np.cumsum(w) * STEP
    channels = {
        "t": at, "v_left": read(v - half * w) + white(slow), "v_right": read(v + half * w)
        + white(slow),
    }  # fmt: skip
    if machine.posed:
        along = [np.cumsum(v * part(yaw)) * STEP for part in (np.cos, np.sin)]
        channels |= {key: read(one) + white(0.01) for key, one in zip("xy", along, strict=True)}
        channels["yaw"] = read(yaw) + white(0.004)
        channels["yaw_rate"] = read(w) + white(0.01)
    if cause == "slope":  # it is level by the log, and the ground rises
        channels["slope"] = np.zeros(len(at))
    names = ("p_left", "p_right") if machine.sides else ("power",)
    channels |= {key: read(one, of_power) for key, one in zip(names, shown, strict=True)}
    return DriveLog(channels, name, signed=True if machine.sides else None)


def said_of(seed: int, cause: str) -> Said:
    """Make a robot, and diagnose its drives."""
    start = time.process_time()
    rng = np.random.default_rng([seed, 77])
    machine = Machine.drawn(rng)
    size = float(rng.uniform(0.7, 1.3))
    *logs, judging = (
        driven(machine, cause, size, rng, f"robot {seed}, drive {k + 1}")
        for k in range(int(rng.integers(2, 6)) + 1)
    )
    told = diagnose(logs, judging, machine.vehicle)
    try:
        before = fit_residual(identify(logs, machine.vehicle).model, judging).energy_error
    except NotIdentifiableError:
        before = told.before.energy_error
    (one,) = told.predictions
    low, high = one.energy_interval
    names = tuple(effect.name for effect in told.effects if effect.name not in USUAL)
    others = {
        frozenset(names) - {effect.name} | {rival}
        for effect in told.effects for rival in effect.rivals
    }  # fmt: skip
    return Said(
        seed, cause, names, told.verdict, abs(before), abs(one.energy / one.measured - 1.0),
        bool(low <= one.measured <= high), time.process_time() - start,
        not others.isdisjoint(NAMED.get(cause, ())),
    )  # fmt: skip


def report(some: Sequence[Said]) -> str:
    """Return the table of causes, and the figures of all robots."""
    rows = [
        "| cause | robots | named rightly | another name | `unexplained` | error of two terms "
        "| handed on | in the 90 % interval |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for cause in CAUSES:
        own = [one for one in some if one.cause == cause]
        if own:
            right = str(sum(one.right for one in own)) if cause in {*SOUND, *NAMED} else "-"
            before, after = (
                float(np.mean([getattr(one, key) for one in own])) for key in ("before", "after")
            )
            rows.append(
                f"| {cause.replace('_', ' and ')} | {len(own)} | {right} "
                f"| {sum(one.false for one in own)} "
                f"| {sum(one.verdict == 'unexplained' for one in own)} | {100 * before:.1f} % "
                f"| {100 * after:.1f} % | {sum(one.within for one in own)} |"
            )
    figures = dict[str, list[bool]]()
    for one in some:
        marks = {
            "nothing hidden and sound": one.right and one.verdict != "unexplained"
            if one.cause in SOUND else None,
            "foreign causes `unexplained`": one.verdict == "unexplained"
            if one.cause in FOREIGN else None,
            # Where drives cannot separate them and this is said, a name is neither right nor wrong.
            "known causes named": one.right
            if one.cause in NAMED and (one.right or not one.left_open) else None,
            "false names": one.false,
            "in the 90 % interval": one.within,
        }  # fmt: skip
        for what, mark in marks.items():
            if mark is not None:
                figures.setdefault(what, []).append(mark)
    told = [
        f"{what}: {sum(marks)} of {len(marks)} ({100 * np.mean(marks):.0f} %)"
        for what, marks in figures.items()
    ]
    return "\n".join([*rows, "", ";\n".join(told) + "."])


def main() -> None:
    """Diagnose robots; print each, and the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("count", type=int, metavar="COUNT")
    parser.add_argument("--first", type=int, default=7_700_000, metavar="SEED")
    parser.add_argument("--cause", nargs="*", default=CAUSES, choices=CAUSES, metavar="NAME")
    parser.add_argument("--records", type=Path, metavar="FILE", help="keeps what was said")
    parser.add_argument("--write", type=Path, metavar="PAGE", help="page with the table's marks")
    given = parser.parse_args()
    known = dict[tuple[int, str], Said]()
    if given.records is not None and given.records.exists():
        for text in given.records.read_text(encoding="utf-8").splitlines():
            record = json.loads(text)
            one = Said(**{**record, "names": tuple(record["names"])})
            known[one.seed, one.cause] = one
    some = []
    for k in range(given.count):
        seed, cause = given.first + k, given.cause[k % len(given.cause)]
        one = known.get((seed, cause)) or said_of(seed, cause)
        some.append(one)
        print(f"{seed} {cause}: {one.verdict}, {', '.join(one.names) or 'no name'}; "
              f"{100 * one.before:.1f} -> {100 * one.after:.1f} %, within {one.within}, "
              f"{one.seconds:.0f} s", flush=True)  # fmt: skip
        if given.records is not None and (seed, cause) not in known:
            with given.records.open("a", encoding="utf-8") as file:
                file.write(json.dumps(asdict(one)) + "\n")
    text = report(some)
    print(text)
    if given.write is not None:
        write(given.write, "foreign", text)


if __name__ == "__main__":
    main()
