"""Whether the probabilities, sizes and errors of a diagnosis are what they say.

    python benchmarks/calibration.py hidden COUNT    drives that hide one to three effects
    python benchmarks/calibration.py empty COUNT     drives that hide none
    python benchmarks/calibration.py hidden COUNT --first 4000 --robots large --fewest 3

`--first` is the seed of the first drive, `--robots` their size (small, 3 to 10 kg; usual; large, 1
to 4 t; any), `--fewest` and `--most` the number of effects, `--drives` how many drives of a robot
are diagnosed together (1; one more judges). `--records FILE` keeps what was found of each seed, a
line a drive: a later run with that file goes on where the former one ended. `--write` puts the
figures into a page, docs/diagnosis.md. `--right FILE` names the seeds that are right and not in
FILE, and those that are in it and wrong; with `--rewrite` FILE is written anew.

Each robot has a size, parameters and sensors of its own: powers of both sides, of both together or
of the battery; 100, 20, 10 or 2 readings a second; steps of speed and power; a late power; long
standstill; a gyroscope and a pose, or neither. Where the advice says that --border or --change
looks for what is left, it is followed. Explanations that the report says these drives
cannot tell apart count as one. A border that no wheel of the training drives crosses is not hidden
in them, and has the sign of the side that the report calls beyond.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from pages import write

from energyplan import DriveLog, PowerModel, diagnose, simulate
from energyplan.diagnosis import Diagnosis, FoundEffect
from energyplan.power import HOTEL, REGENERATION_LOSS
from energyplan.power import effects as known
from energyplan.power.effects import (
    DRAGGING_LEFT,
    SLIP_BEYOND,
    SLIP_SPEED,
    STRIBECK,
    TOWED_DRAG,
    TOWING_FORCE,
    TURN_ASYMMETRY,
)
from energyplan.vehicle import Vehicle

BINS = (0.0, 0.05, 0.2, 0.5, 0.8, 0.95, 1.0)

SIZES = {"small": (0.35, 0.5), "usual": (0.5, 1.2), "large": (2.5, 3.6)}
"""Sizes of robots, over that of one of 60 kg."""


@dataclass(frozen=True)
class Outcome:
    """What one diagnosis said, and what was true.

    `others` are effects that were reported and not hidden, `excess` the residual over the noise, of
    samples and of means over two seconds, whichever is more; `ratio` is the error of the hold-out
    drive over that of a model that was told, `left` over that of the paper's model.
    """

    seed: int
    hidden: tuple[str, ...]
    stated: tuple[tuple[tuple[str, ...], float], ...]
    covered: tuple[bool, ...]
    ratio: float
    left: float
    verdict: str
    adequate: bool
    excess: float
    others: tuple[str, ...]
    kind: str
    seconds: float

    @classmethod
    def of(cls, record: dict[str, Any]) -> Outcome:
        """Return what a line of records holds."""
        stated = tuple((tuple(names), float(p)) for names, p in record.pop("stated"))
        lists = {key: tuple(record.pop(key)) for key in ("hidden", "covered", "others")}
        return cls(stated=stated, **lists, **record)

    @property
    def first(self) -> bool:
        """Whether the most probable explanation is the right one."""
        return max(self.stated, key=lambda one: one[1])[0] == self.hidden


@dataclass(frozen=True)
class Hidden:
    """A random robot's drives, the sizes of the effects that they hide, and what it is.

    The last drive judges. `direction` is that of a border.
    """

    logs: tuple[DriveLog, ...]
    vehicle: Vehicle
    sizes: dict[str, float]
    kind: str
    direction: float

    def size(self, effect: FoundEffect) -> float:
        """Return the size of an effect that powers tell."""
        if effect.name == "surface_border":
            apart = float(effect.details["direction"]) - self.direction
            return self.sizes[effect.name] * float(np.sign(np.cos(apart)))
        return self.sizes[effect.name]


def robot(rng: np.random.Generator, sizes: tuple[float, float] = SIZES["usual"]) -> PowerModel:
    """Return a random robot on a random ground."""
    size = float(rng.uniform(*sizes))
    mass = 60.0 * size**3 * float(rng.uniform(0.7, 1.5))
    vehicle = Vehicle.from_geometry(
        "random", mass=mass, wheelbase=0.5 * size, track=0.55 * size, length=0.9 * size,
        width=0.7 * size,
    )  # fmt: skip
    force = float(rng.uniform(0.05, 0.1)) * mass * 9.81 / 2
    return PowerModel.paper(vehicle, K=force, mu=float(rng.uniform(0.3, 0.8)))


def hidden(
    seed: int, robots: str = "any", fewest: int = 1, most: int = 3, drives: int = 1
) -> Hidden:
    """Hide effects in drives of a random robot, of which one more judges.

    Further drives have the parts of the first in another order, at another speed.
    """
    rng = np.random.default_rng([seed, 2])
    kind = str(rng.choice([*SIZES])) if robots == "any" else robots
    model = robot(rng, SIZES[kind])
    vehicle, K = model.vehicle, model.coefficient("traction_resistance")
    mu = model.coefficient("slip_friction")
    speed = 0.75 * max(1.0, (vehicle.mass / 60.0) ** (1 / 6))  # as pendulums of their size do
    side = float(rng.choice([-1.0, 1.0]))
    choices = {
        "hotel_load": (HOTEL, 0.5 * K * speed),
        "viscous_loss": (known.VISCOUS_LOSS, 0.4 * K / speed),
        "air_drag": (known.AIR_DRAG, 0.5 * K / speed**2),
        "copper_loss": (known.COPPER_LOSS, 0.07 * speed / K),
        "dragging_wheel_left": (DRAGGING_LEFT, 0.35 * K), "towed_drag": (TOWED_DRAG, 0.4 * K),
        "towing_force": (TOWING_FORCE, 0.3 * K * side),
        "turn_asymmetry": (TURN_ASYMMETRY, 0.12 * mu * side),
        "slip_speed_friction": (SLIP_SPEED, 0.4 * mu * side / speed),
        "warm_up": (replace(known.WARM_UP, params={"time_constant": 50.0}), 0.4 * K),
        "regeneration_efficiency": (REGENERATION_LOSS, 0.5),
        "stribeck_friction": (replace(STRIBECK, params={"slip_speed": 0.08}), 0.4 * mu),
    }  # fmt: skip
    posed, direction, offset = rng.random() >= 0.25, 0.0, 0.3
    if posed:  # what depends on the place or the heading
        direction = float(rng.uniform(-3, 3))
        line = replace(SLIP_BEYOND, params={"direction": direction, "offset": offset})
        choices["surface_border"] = (line, 0.3 * mu * side)
        choices["tilted_plane"] = (known.GRADE, float(np.radians(3.0)))
    sizes, ground = {}, {}
    number = int(rng.integers(fewest, most + 1))
    for name in rng.choice(sorted(choices), number, replace=False):
        term, size = choices[str(name)]
        size = sizes[str(name)] = size * float(rng.uniform(0.6, 1.4))
        if term is known.GRADE:
            ground = {"slope": size, "uphill": float(rng.uniform(-3, 3))}
            size = vehicle.mass
        model = model.with_term(term, size)
    measured = str(rng.choice(["sides", "total", "battery"]))
    rate = float(rng.choice([100.0, 20.0, 20.0, 10.0, 2.0]))
    noise = float(rng.uniform(0.01, 0.05)) * K * speed
    step = float(rng.choice([0.0, 1 / 127, 0.02]))
    delay = float(rng.uniform(0.2, 0.6)) if rng.random() < 0.25 else 0.0
    rest = float(rng.choice([0.0, 60.0]))
    # How the robot turns is told by a gyroscope and a pose, noisy both; one in four has neither.
    turning = {"yaw_rate": float(rng.uniform(0.002, 0.02)), "yaw": 0.005, "x": 0.01, "y": 0.01}
    bias = {"yaw_rate": float(rng.normal(0.0, 0.003))}
    without = {"accel_x"} | ({"slope"} if ground else set())
    if not posed:
        without, turning, bias = without | set(turning), {}, {}
    logs = []
    first, last = (list(some) for some in (simulate.IDENTIFICATION, simulate.VALIDATION))
    patterns = [(first, speed, 2 * seed), (last, speed, 2 * seed + 1)]
    further = np.random.default_rng([seed, 3])
    for _ in range(drives - 1):
        order = [first[k] for k in further.permutation(len(first))]
        slower = speed * float(further.uniform(0.5, 1.0))
        patterns.insert(-1, (order, slower, int(further.integers(1 << 30))))
    names = {"sides": ("p_left", "p_right"), "total": ("power",), "battery": ("current",)}
    for k, (pattern, pace, drawn) in enumerate(patterns):
        parts = [*((name, 1.5 * time * speed / pace) for name, time in pattern), ("rest", rest)]
        log = simulate.drive(
            model.battery_side() if measured == "battery" else model,
            [part for part in parts if part[1] > 0], rate=rate, speed=pace,
            accel_limit=0.4 * speed, speed_noise=0.003, power_noise=noise, biases=bias,
            noise={**turning, **({"current": noise / 24.0} if measured == "battery" else {})},
            measured=measured, delays=dict.fromkeys(names[measured], delay) if delay else None,
            without=without, seed=drawn, name=f"case {seed}, drive {k + 1}", **ground,
        )  # fmt: skip
        logs.append(stepped(log, step, names[measured]))
    if delay:
        sizes["time_offset"] = delay
    if "surface_border" in sizes:
        places = [np.array([log.channels[name] for name in ("x", "y")]) for log in logs[:-1]]
        normal = np.array([np.cos(direction), np.sin(direction)])
        along = normal @ np.hstack(places) - offset
        wheels = float(np.max(np.hypot(*vehicle.contacts.T)))
        if along.max() < -wheels or along.min() > wheels:
            del sizes["surface_border"]
    told = "with" if posed else "without"
    words = f"{kind}, {vehicle.mass:.0f} kg, {measured} at {rate:g} Hz, {told} pose"
    return Hidden(tuple(logs), vehicle, sizes, words, direction)


def advised(
    logs: DriveLog | list[DriveLog], judging: DriveLog, vehicle: Vehicle
) -> Diagnosis:  # fmt: skip
    """Diagnose drives, and once more with the options that the advice says."""
    told = diagnose(logs, judging, vehicle)
    border, change = (name in told.suspects for name in ("border", "change"))
    if not (border or change):
        return told
    return diagnose(logs, judging, vehicle, border=border, change=change)


def case(seed: int, robots: str, fewest: int, most: int, drives: int) -> Outcome:
    """Hide effects in the drives of a random robot, and diagnose them."""
    start = time.process_time()
    made = hidden(seed, robots, fewest, most, drives)
    (*logs, judging), vehicle, sizes = made.logs, made.vehicle, made.sizes
    told = advised(logs, judging, vehicle)
    entries = known.catalogue()
    usual = {name for name, entry in entries.items() if entry.usual}

    def told_apart(names: tuple[str, ...]) -> tuple[str, ...]:
        return tuple(sorted({name for name in names if name not in usual}))

    true = told_apart(tuple(sizes))
    stated: dict[tuple[str, ...], float] = {}
    for one in told.explanations:
        key = told_apart(one.effects)
        stated[key] = stated.get(key, 0.0) + one.probability
    covered = tuple(
        bool(abs(effect.value - made.size(effect)) <= 1.96 * effect.std_error)
        for effect in told.effects if effect.name in sizes
    )  # fmt: skip
    oracle = diagnose(
        logs, judging, vehicle, effects=[entries[name] for name in sizes], choose=False
    ).after.rmse if sizes else told.before.rmse  # fmt: skip
    quality = told.adequacy
    claimed = [one.name for one in told.effects if one.name not in {*usual, *sizes}]
    return Outcome(
        seed, true, tuple(stated.items()), covered, told.after.rmse / oracle,
        told.after.rmse / told.before.rmse, told.verdict, quality.adequate,
        max(
            quality.residual / quality.usual,
            quality.slow_residual / max(quality.slow_noise, quality.negligible),
        ),
        tuple(claimed), made.kind, time.process_time() - start,
    )  # fmt: skip


def outcomes(
    part: str,
    count: int,
    first: int,
    robots: str,
    fewest: int,
    most: int,
    drives: int,
    records: Path | None,
) -> Iterator[Outcome]:
    """Diagnose drive after drive, but for those that the records hold."""
    known_already: dict[int, Outcome] = {}
    if records is not None and records.exists():
        for line in records.read_text().splitlines():
            one = Outcome.of(json.loads(line))
            known_already[one.seed] = one
    for seed in range(first, first + count):
        if seed in known_already:
            yield known_already[seed]
            continue
        one = case(seed, robots, *((0, 0) if part == "empty" else (fewest, most)), drives)
        if records is not None:
            with records.open("a") as file:
                file.write(json.dumps(asdict(one)) + "\n")
        yield one


def stepped(log: DriveLog, step: float, powers: tuple[str, ...]) -> DriveLog:
    """Return a log whose sensors read in steps."""
    if not step:
        return log
    channels = dict(log.channels)
    for name in ("v_left", "v_right"):
        channels[name] = step * np.round(channels[name] / step)
    for name in powers:
        fine = 0.01 * float(np.max(np.abs(channels[name])))
        channels[name] = fine * np.round(channels[name] / fine)
    return DriveLog(channels, log.name)


def report(some: list[Outcome]) -> str:
    """Return the figures as a page has them."""
    pairs = [(p, key == one.hidden) for one in some for key, p in one.stated]
    stated, true = (np.array(part, float) for part in zip(*pairs, strict=True))
    rows = ["| stated | statements | mean stated | true |", "|---|---|---|---|"]
    for low, high in pairwise(BINS):
        within = (stated >= low) & ((stated < high) | (high == 1.0))
        if within.any():
            rows.append(
                f"| {low:g} to {high:g} | {within.sum()} | {stated[within].mean():.2f} | "
                f"{true[within].mean():.2f} |"
            )
    covered = [hit for one in some for hit in one.covered]
    ratios = np.array([one.ratio for one in some])
    left = np.array([one.left for one in some if one.verdict == "effect_found"] or [1.0])
    whole = [one for one in some if one.adequate]
    sound = np.mean([one.first for one in whole]) if whole else np.nan
    silent = [one for one in some if one.verdict == "no_effect"]
    return "\n".join(
        [
            *rows, "",
            f"{len(some)} drives, {sum(one.seconds for one in some) / 60:.0f} min of CPU. The",
            f"right explanation came first in {np.mean([one.first for one in some]):.0%}. Of",
            f"{len(covered)} sizes, {np.mean(covered):.0%} lay within their 95 % interval. The",
            "RMSE of the hold-out drive was at most 1.15 times that of a model that was given the",
            f"hidden effects in {np.mean(ratios <= 1.15):.0%}, and {ratios.max():.2f} times at",
            f"worst. Where an effect was found, it was {np.median(left):.2f} times that of the",
            f"paper's model in the median, and more than that in {np.sum(left > 1.0)} of",
            f"{len(left)} drives, {left.max():.2f} times at most. The verdict was",
            f"`no_effect` {len(silent)} times,",
            f"{sum(one.excess > 2.0 for one in silent)} of them with a residual of more than twice",
            f"the noise. Where `adequacy` reports nothing missing ({len(whole)} drives), the right",
            f"explanation came first in {sound:.0%}.", "",
        ]
    )  # fmt: skip


def line_of(one: Outcome) -> str:
    """Return one drive's outcome in a line."""
    stated = [("+".join(names) or "nothing", round(p, 2)) for names, p in one.stated[:2]]
    return (
        f"{one.seed:6} {'right' if one.first else 'WRONG'} {one.verdict:12} ratio {one.ratio:.2f} "
        f"excess {one.excess:.1f} hidden {'+'.join(one.hidden) or 'nothing'}; stated {stated} "
        f"({one.kind})"
    )


def turned(found: list[Outcome], file: Path) -> list[str]:
    """Return a line for each seed whose answer is right, or wrong, other than in a list."""
    right = {int(seed) for seed in file.read_text().split()}
    return [
        f"turned {'right' if one.first else 'wrong'}: {line_of(one).strip()}"
        for one in found
        if one.first is not (one.seed in right)
    ]


def main() -> None:
    """Run, print, and write where asked."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("part", choices=("hidden", "empty"))
    parser.add_argument("count", type=int)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--robots", choices=(*SIZES, "any"), default="any")
    parser.add_argument("--fewest", type=int, default=1)
    parser.add_argument("--most", type=int, default=3)
    parser.add_argument("--drives", type=int, default=1)
    parser.add_argument("--records", type=Path)
    parser.add_argument("--write", type=Path, metavar="PAGE")
    parser.add_argument("--right", type=Path, metavar="FILE")
    parser.add_argument("--rewrite", action="store_true")
    asked = parser.parse_args()
    found = []
    for one in outcomes(
        asked.part,
        asked.count,
        asked.first,
        asked.robots,
        asked.fewest,
        asked.most,
        asked.drives,
        asked.records,
    ):
        found.append(one)
        print(line_of(one), flush=True)
    if asked.part == "empty":
        false = sum(bool(one.others) for one in found)
        print(f"{false} of {len(found)} drives that hide nothing were given an effect")
        for one in found:
            if one.others:
                print(f"seed {one.seed} was given {' and '.join(one.others)}")
        more = sum(one.verdict == "unexplained" for one in found)
        print(f"{more} were called unexplained")
        return
    text = report(found)
    print(text)
    if asked.write:
        write(asked.write, "calibration", text)
    if asked.right:
        if asked.rewrite:
            seeds = (f"{one.seed}\n" for one in found if one.first)
            asked.right.write_text("".join(seeds))
        lines = turned(found, asked.right)
        print("\n".join([*lines, f"{len(lines)} of {len(found)} seeds turned"]))
        if lines:
            options = " ".join(sys.argv[1:])
            print(f"turned on purpose: python benchmarks/calibration.py {options} --rewrite")


if __name__ == "__main__":
    main()
