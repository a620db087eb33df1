"""Whether the probabilities, sizes and errors of a diagnosis are what they say.

    python benchmarks/calibration.py COUNT              as many drives of random robots
    python benchmarks/calibration.py COUNT FIRST        from that seed on, not from 0
    python benchmarks/calibration.py COUNT FIRST --write    the same, into docs/diagnosis.md
    python benchmarks/calibration.py empty COUNT FIRST  as many that hide nothing

Each robot has a size, parameters and sensors of its own: powers of both sides, of both together or
of the battery; 20, 10 or 2 readings a second; steps of speed and power; a late power; long
standstill; a gyroscope and a pose, or neither. It hides up to three effects. Odd drives fit one
number, the temperature at which stated probabilities are true; even ones judge. Effects that no
power can tell apart count as one, and so do explanations that the report says these drives cannot
tell apart.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from scipy.optimize import minimize_scalar

from energyplan import DriveLog, PowerModel, diagnose, simulate
from energyplan.power import HOTEL
from energyplan.power import effects as known
from energyplan.power.effect_terms import (
    DRAGGING_LEFT,
    REVERSE_DRAG,
    SLIP_SPEED,
    TOWED_DRAG,
    TOWING_FORCE,
    TURN_ASYMMETRY,
)
from energyplan.vehicle import Vehicle

SAME = {
    "power_offset": "hotel_load", "traction_asymmetry": "dragging_wheel_left",
    "dragging_wheel_right": "dragging_wheel_left", "surface_change": "payload_change",
    "drive_efficiency": "round_trip", "regeneration_efficiency": "round_trip",
    "unsigned_power": "round_trip", "reverse_drag": "towing_force",
}  # fmt: skip
"""Effects that powers cannot tell apart, and what stands for them."""

BINS = (0.0, 0.05, 0.2, 0.5, 0.8, 0.95, 1.0)
PAGE = Path(__file__).parents[1] / "docs" / "diagnosis.md"
START, END = "<!-- calibration -->\n", "<!-- end of calibration -->\n"


@dataclass(frozen=True)
class Outcome:
    """What one diagnosis said, and what was true."""

    hidden: frozenset[str]
    stated: dict[frozenset[str], float]
    covered: tuple[bool, ...]
    ratio: float
    verdict: str
    adequate: bool

    @property
    def first(self) -> bool:
        """Whether the most probable explanation is the right one."""
        return max(self.stated, key=lambda one: self.stated[one]) == self.hidden


def robot(rng: np.random.Generator) -> PowerModel:
    """Return a random robot on a random ground."""
    size = float(rng.uniform(0.5, 1.2))
    mass = 60.0 * size**3 * float(rng.uniform(0.7, 1.5))
    vehicle = Vehicle.from_geometry(
        "random", mass=mass, wheelbase=0.5 * size, track=0.55 * size, length=0.9 * size,
        width=0.7 * size,
    )  # fmt: skip
    force = float(rng.uniform(0.05, 0.1)) * mass * 9.81 / 2
    return PowerModel.paper(vehicle, K=force, mu=float(rng.uniform(0.3, 0.8)))


@dataclass(frozen=True)
class Hidden:
    """A random robot's two drives, and the sizes of the effects that they hide."""

    logs: tuple[DriveLog, DriveLog]
    vehicle: Vehicle
    sizes: dict[str, float]


def hidden(seed: int, most: int = 3) -> Hidden:
    """Hide one to `most` effects, or none, in two drives of a random robot."""
    rng = np.random.default_rng(seed)
    model = robot(rng)
    vehicle, K = model.vehicle, model.coefficient("traction_resistance")
    mu = model.coefficient("slip_friction")
    side = float(rng.choice([-1.0, 1.0]))
    choices = {
        "hotel_load": (HOTEL, 0.4 * K), "viscous_loss": (known.VISCOUS_LOSS, 0.5 * K),
        "air_drag": (known.AIR_DRAG, 0.9 * K), "copper_loss": (known.COPPER_LOSS, 0.05 / K),
        "dragging_wheel_left": (DRAGGING_LEFT, 0.35 * K), "towed_drag": (TOWED_DRAG, 0.4 * K),
        "towing_force": (TOWING_FORCE, 0.3 * K * side), "reverse_drag": (REVERSE_DRAG, 0.4 * K),
        "turn_asymmetry": (TURN_ASYMMETRY, 0.12 * mu * side),
        "slip_speed_friction": (SLIP_SPEED, 0.5 * mu * side),
        "warm_up": (replace(known.WARM_UP, params={"time_constant": 50.0}), 0.4 * K),
    }  # fmt: skip
    sizes = {}
    number = int(rng.integers(1, most + 1)) if most else 0
    for name in rng.choice(sorted(choices), number, replace=False):
        term, size = choices[str(name)]
        sizes[str(name)] = size * float(rng.uniform(0.6, 1.4))
        model = model.with_term(term, sizes[str(name)])
    measured = str(rng.choice(["sides", "total", "battery"]))
    rate = float(rng.choice([20.0, 20.0, 10.0, 2.0]))
    noise = float(rng.uniform(0.01, 0.05)) * K
    step = float(rng.choice([0.0, 1 / 127, 0.02]))
    delay = float(rng.uniform(0.2, 0.6)) if rng.random() < 0.25 else 0.0
    rest = float(rng.choice([0.0, 60.0]))
    # How the robot turns is told by a gyroscope and a pose, noisy both; one in four has neither.
    other = np.random.default_rng([seed, 1])
    turning = {"yaw_rate": float(other.uniform(0.002, 0.02)), "yaw": 0.005, "x": 0.01, "y": 0.01}
    bias = {"yaw_rate": float(other.normal(0.0, 0.003))}
    without = {"accel_x"}
    if other.random() < 0.25:
        without, turning, bias = without | set(turning), {}, {}
    logs = []
    for k, pattern in enumerate((simulate.IDENTIFICATION, simulate.VALIDATION)):
        names = {"sides": ("p_left", "p_right"), "total": ("power",), "battery": ("current",)}
        parts = [*((name, 1.5 * time) for name, time in pattern), ("rest", rest)]
        log = simulate.drive(
            model.battery_side() if measured == "battery" else model,
            [part for part in parts if part[1] > 0], rate=rate, speed_noise=0.003,
            power_noise=noise, biases=bias,
            noise={**turning, **({"current": noise / 24.0} if measured == "battery" else {})},
            measured=measured, delays=dict.fromkeys(names[measured], delay) if delay else None,
            without=without, seed=2 * seed + k, name=f"case {seed}, drive {k + 1}",
        )  # fmt: skip
        logs.append(stepped(log, step, names[measured]))
    if delay:
        sizes["time_offset"] = delay
    return Hidden((logs[0], logs[1]), vehicle, sizes)


def case(seed: int) -> Outcome:
    """Hide up to three effects, and diagnose."""
    made = hidden(seed)
    logs, vehicle, sizes = made.logs, made.vehicle, made.sizes
    told = diagnose(logs[0], logs[1], vehicle)
    entries = known.catalogue()
    usual = {name for name, entry in entries.items() if entry.usual}

    def told_apart(names: tuple[str, ...]) -> frozenset[str]:
        return frozenset(SAME.get(name, name) for name in names if name not in usual)

    # What the report says that these drives cannot tell apart is one statement: any of them. Where
    # the truth is one of them, it stands for all.
    true = frozenset(SAME.get(name, name) for name in sizes)
    stated: dict[frozenset[str], float] = {}
    for one in told.explanations:
        alike = [told_apart(names) for names in (one.effects, *one.alike)]
        key = true if true in alike else next((k for k in stated if k in alike), alike[0])
        stated[key] = stated.get(key, 0.0) + one.probability
    covered = tuple(
        abs(effect.value - sizes[effect.name]) <= 1.96 * effect.std_error
        for effect in told.effects if effect.name in sizes
    )  # fmt: skip
    oracle = diagnose(
        logs[0], logs[1], vehicle, effects=[entries[name] for name in sizes], choose=False
    ).after.rmse
    return Outcome(
        true, stated, covered, told.after.rmse / oracle, told.verdict, told.adequacy.adequate
    )


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


def tempered(
    stated: dict[frozenset[str], float], temperature: float
) -> dict[frozenset[str], float]:
    """Return probabilities at another temperature than the one that they were stated at."""
    powers = {key: value ** (1.0 / temperature) for key, value in stated.items() if value > 0.0}
    total = sum(powers.values())
    return {key: value / total for key, value in powers.items()}


def surprise(outcomes: list[Outcome], temperature: float) -> float:
    """Mean negative logarithm of what was stated of the truth."""
    said = [tempered(one.stated, temperature).get(one.hidden, 0.0) for one in outcomes]
    return float(-np.mean(np.log(np.maximum(said, 1e-3))))


def report(outcomes: list[Outcome], temperature: float, fitted: int) -> str:
    """Return the figures as a page has them."""
    pairs = [(p, key == one.hidden) for one in outcomes for key, p in one.stated.items()]
    stated, true = (np.array(part, float) for part in zip(*pairs, strict=True))
    rows = ["| stated | statements | mean stated | true |", "|---|---|---|---|"]
    for low, high in pairwise(BINS):
        some = (stated >= low) & ((stated < high) | (high == 1.0))
        if some.any():
            rows.append(
                f"| {low:g} to {high:g} | {some.sum()} | {stated[some].mean():.2f} | "
                f"{true[some].mean():.2f} |"
            )
    first = np.mean([one.first for one in outcomes])
    covered = [hit for one in outcomes for hit in one.covered]
    ratios = np.array([one.ratio for one in outcomes])
    whole = [one for one in outcomes if one.adequate]
    sound = np.mean([one.first for one in whole]) if whole else np.nan
    none = sum(one.verdict == "no_effect" for one in outcomes)
    return "\n".join(
        [
            *rows, "",
            f"{len(outcomes)} of these drives judge. The right explanation came first in",
            f"{first:.0%}. Of {len(covered)} sizes, {np.mean(covered):.0%} lay within their 95 %",
            "interval. The RMSE of the hold-out drive was at most 1.15 times that of a model that",
            f"was given the hidden effects in {np.mean(ratios <= 1.15):.0%} of the drives, and",
            f"{ratios.max():.2f} times at worst. The verdict was `no_effect` {none} times. Where",
            f"`adequacy` reports nothing missing ({len(whole)} drives), the right explanation came",
            f"first in {sound:.0%}. The other {fitted} drives were used to fit a temperature that",
            f"scales the log probabilities: {temperature:.2f}, where 1 changes nothing.", "",
        ]
    )  # fmt: skip


def empty(count: int, first: int) -> None:
    """Count what is claimed of robots that hide nothing."""
    false = 0
    for seed in range(first, first + count):
        made = hidden(seed, most=0)
        told = diagnose(*made.logs, made.vehicle)
        entries = known.catalogue()
        claimed = [one.name for one in told.effects if not entries[one.name].usual]
        claimed = [name for name in claimed if name not in made.sizes]
        false += bool(claimed)
        print(f"{seed:5} {told.verdict} {claimed}", flush=True)
    print(f"{false} of {count} drives that hide nothing were given an effect")


def main(count: int, first: int, write: bool) -> None:
    """Run, print, and write where asked."""
    outcomes = []
    for seed in range(first, first + count):
        outcomes.append(case(seed))
        one = outcomes[-1]
        print(
            f"{seed:3} {'right' if one.first else 'WRONG'} {one.ratio:5.2f} {sorted(one.hidden)} "
            f"{[(sorted(k), round(p, 2)) for k, p in one.stated.items()][:2]}",
            flush=True,
        )
    learned, judged = outcomes[1::2], outcomes[::2]
    found = minimize_scalar(
        lambda log_t: surprise(learned, float(np.exp(log_t))), bounds=(-1.0, 3.0), method="bounded"
    )
    text = report(judged, float(np.exp(found.x)), len(learned))
    print(text)
    if write:
        page = PAGE.read_text()
        before, rest = page.split(START)
        PAGE.write_text(before + START + text + END + rest.split(END)[1])


if __name__ == "__main__":
    match sys.argv[1:]:
        case ["empty", count, start]:
            empty(int(count), int(start))
        case [count]:
            main(int(count), 0, False)
        case [count, start]:
            main(int(count), int(start), False)
        case [count, start, "--write"]:
            main(int(count), int(start), True)
        case _:
            sys.exit(__doc__)
