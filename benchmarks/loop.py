"""The loop closed in the physics engine: energy told beside energy taken, before and after a round.

    python benchmarks/loop.py none 40           # no hidden effect: 40 pairs on four maps
    python benchmarks/loop.py hidden 60         # one or two hidden effects
    python benchmarks/loop.py one 60            # one hidden effect, each kind in turn
    python benchmarks/loop.py one 20 40         # the same, 20 of them from number 40 on
    python benchmarks/loop.py routes 12         # effects that change which route is best
    python benchmarks/loop.py design 10         # designed drives against random ones
    python benchmarks/loop.py table FILE...     # the table of runs made in parts

Each line is printed as soon as it is measured; a Markdown table comes last. Needs the extra
``physics``. The 60 hidden runs take about a quarter of an hour of one quiet core.
"""

from __future__ import annotations

import re
import sys
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import shapely
from forks import FORKS
from scipy.stats import binomtest

import energyplan as ep
from energyplan.diagnosis.design import Hypothesis, TimedManoeuvre, design, joined, manoeuvres
from energyplan.errors import EnergyPlanError
from energyplan.io.files import bundled
from energyplan.limits.speed import profile
from energyplan.physics import (
    EFFECTS,
    EngineRobot,
    HiddenEffect,
    Sensors,
    draw_effects,
    drive,
    switch_on,
)
from energyplan.physics.loop import SPEED_SHARE, EngineDrives, Loop, Round, close_loop
from energyplan.power.effects import catalogue
from energyplan.vehicle import predict_icr

ICR = ep.TreadICR.symmetric(predict_icr(0.475, 0.5))
VEHICLE = ep.Vehicle.preset("quadriga:full").with_mass(147.1).with_icr(ICR)
MODEL = ep.PowerModel.paper(VEHICLE, K=118.0, mu=0.647)
ROBOT = EngineRobot.from_model(MODEL)
EFFORT = 100_000
"""Units of work for each plan: some two seconds."""
SURE = 0.95
"""Probability from which on a question is settled."""
SHARES = (0.5, 0.75, 1.0)
"""By how much the second way is worse without the effect, as `forks` takes it [m]."""


def maps() -> list[ep.OccupancyGrid]:
    """Return the bundled warehouse, and three halls with boxes that stand about."""
    found = [ep.read_map(bundled("warehouse.yaml"))]
    for seed in (1, 2, 3):
        rng = np.random.default_rng(seed)
        boxes = [
            shapely.affinity.rotate(shapely.box(x, y, x + w, y + h), angle)
            for x, y, w, h, angle in zip(
                rng.uniform(2, 16, 9), rng.uniform(2, 12, 9), rng.uniform(0.5, 3.0, 9),
                rng.uniform(0.5, 3.0, 9), rng.uniform(0, 90, 9), strict=True,
            )
        ]  # fmt: skip
        walls = shapely.box(0, 0, 20, 15).boundary.buffer(0.2)
        found.append(
            ep.OccupancyGrid.from_polygons([walls, *boxes], (-0.5, -0.5, 20.5, 15.5), 0.05)
        )
    return found


class Pair(NamedTuple):
    """A map with a start and a goal on it."""

    grid: ep.OccupancyGrid
    start: ep.Pose
    goal: ep.Pose


def pair(grids: list[ep.OccupancyGrid], seed: int) -> Pair:
    """Draw a pair of free poses at least eight metres apart."""
    rng = np.random.default_rng([seed, 7])
    grid = grids[seed % len(grids)]
    rows, columns = grid.shape
    while True:
        cells = rng.uniform(0, 1, (2, 2)) * (columns, rows)
        points, yaw = grid.to_world(cells), rng.uniform(-np.pi, np.pi, 2)
        poses = np.column_stack([points, yaw])
        apart = np.hypot(*(points[1] - points[0]))
        roomy = np.all(grid.clearance_at(points) > 0.7)
        if apart > 8 and roomy and np.all(grid.footprint_free(poses, VEHICLE)):
            return Pair(grid, ep.Pose(*poses[0].tolist()), ep.Pose(*poses[1].tolist()))


def without(count: int, begin: int = 0) -> None:
    """No hidden effect: error of the energy told, and of the saving over the shortest route."""
    grids, errors, savings = maps(), list[float](), list[float]()
    speed = SPEED_SHARE * VEHICLE.motor.speed
    motor = replace(VEHICLE.motor, speed=speed, acceleration=0.5)
    slow = replace(VEHICLE, motor=motor)
    for k in range(begin, begin + count):
        case = pair(grids, k)
        problem = ep.PlanningProblem(case.grid, ep.EnergyCost(MODEL), case.start, case.goal)
        try:
            made = ep.compare(problem, effort=EFFORT)
        except EnergyPlanError as reason:
            print(f"pair {k}: {reason}", flush=True)
            continue
        both = [
            drive(profile(p.path, MODEL, vehicle=slow), ROBOT, MODEL)
            for p in (made.energy_optimal, made.shortest)
        ]
        errors += [b.error for b in both]
        told, taken = (1 - getattr(both[0], key) / getattr(both[1], key)
                       for key in ("energy_predicted", "energy_measured"))  # fmt: skip
        savings.append(told - taken)
        print(
            f"pair {k}: errors {100 * both[0].error:+.2f} % {100 * both[1].error:+.2f} %, saving "
            f"told {100 * told:.1f} %, taken {100 * taken:.1f} %, "
            f"arrived {[b.arrived for b in both]}",
            flush=True,
        )
    e, s = np.abs(errors), np.abs(savings)
    print(f"\n{len(e)} drives: |error| <= 1.5 % in {of(list(e <= 0.015))}, median "
          f"{100 * np.median(e):.2f} %, worst {100 * e.max():.2f} %")  # fmt: skip
    print(f"{len(s)} pairs: saving within 1.5 points in {of(list(s <= 0.015))}, worst "
          f"{100 * s.max():.2f} points")  # fmt: skip


def closed(effects: tuple[HiddenEffect, ...], case: Pair, rounds: int = 2) -> Loop:
    """Close the loop about a robot with effects that the model does not know."""
    problem = ep.PlanningProblem(case.grid, ep.EnergyCost(MODEL), case.start, case.goal)
    source = EngineDrives(switch_on(ROBOT, effects))
    return close_loop(problem, source, rounds=rounds, tolerance=0.0, effort=EFFORT)


def hidden(count: int, single: bool, begin: int = 0) -> None:
    """Hidden effects: error before and after one round, what was found, which takes less."""
    grids, rows = maps(), list[Hidden]()
    kinds = list(EFFECTS)
    for k in range(begin, begin + count):
        case = pair(grids, k)
        middle = (np.array(case.start[:2]) + np.array(case.goal[:2])) / 2
        names = (kinds[k % len(kinds)],) if single else None
        effects = draw_effects(ROBOT, k, 1 if single else None, names, around=middle)
        label = ", ".join(f"{e.name} {e.size:.3g}" for e in effects)
        try:
            made = closed(effects, case)
        except EnergyPlanError as reason:
            print(f"{k}: {label}: {type(reason).__name__}: {reason}", flush=True)
            continue
        first, last = made.rounds[0], made.rounds[-1]
        found = ", ".join(e.name for e in first.effects) or first.note or "-"
        saved = 1 - last.energy_measured / first.energy_measured
        low, high = last.energy_interval or (-np.inf, np.inf)
        half = (high - low) / (2 * last.energy_predicted)
        rows.append(Hidden(k, label, first.error, last.error, half, found, saved))
        print(rows[-1].line(), flush=True)
    table(rows)


class Hidden(NamedTuple):
    """A run with hidden effects: errors before and after a round, and what was found.

    `half` is half the 95 % interval over the energy told, `saved` by how much less the second
    route took.
    """

    number: int
    label: str
    before: float
    after: float
    half: float
    found: str
    saved: float

    def line(self) -> str:
        """Return the run as a line."""
        return (f"{self.number}: {self.label}: {100 * self.before:+.1f} % -> "
                f"{100 * self.after:+.2f} % (+- {100 * self.half:.2f} %), found {self.found}; "
                f"second route takes {100 * self.saved:+.1f} % less")  # fmt: skip

    @classmethod
    def read(cls, line: str) -> Hidden | None:
        """Return the run that a line tells of; None where it tells of none."""
        number = r"([+-]?[\d.]+|[+-]?inf|nan) %"
        found = re.fullmatch(
            rf"(\d+): (.*): {number} -> {number} \(\+- {number}\), found (.*); "
            rf"second route takes {number} less",
            line.strip(),
        )
        if found is None:
            return None
        k, label, *percents, what, saved = found.groups()
        before, after, half = (float(x) / 100 for x in percents)
        return cls(int(k), label, before, after, half, what, float(saved) / 100)


def of(flags: list[bool]) -> str:
    """Return how many of all hold, with the 95 % interval of the share (Clopper and Pearson)."""
    low, high = binomtest(sum(flags), len(flags)).proportion_ci()
    return f"{sum(flags)} of {len(flags)} ({100 * low:.0f} to {100 * high:.0f} %)"


def table(rows: list[Hidden]) -> None:
    """Print runs as a Markdown table, and how many reach what."""
    if not rows:
        print("no run to make a table of")
        return
    print("\n| hidden | found | error before | after | interval | second route saves |\n"
          "|---|---|---|---|---|---|")  # fmt: skip
    for row in sorted(rows):
        print(f"| {row.label} | {row.found} | {100 * row.before:+.1f} % | {100 * row.after:+.2f} % "
              f"| ±{100 * row.half:.1f} % | {100 * row.saved:+.1f} % |")  # fmt: skip
    after = [abs(row.after) for row in rows]
    inside = [abs(row.after) <= row.half * (1 + row.after) for row in rows]
    print("\n| runs | median error | within 3 % | within 6 % | taken in the 95 % interval |\n"
          "|---|---|---|---|---|\n"
          f"| {len(rows)} | {100 * np.median(after):.1f} % | {of([e <= 0.03 for e in after])} | "
          f"{of([e <= 0.06 for e in after])} | {of(inside)} |")  # fmt: skip


def routes(count: int, begin: int = 0) -> None:
    """Effects that change which route is best: by how much less the second one takes."""
    rows = list[tuple[str, Round, Round]]()
    for k in range(begin, begin + count):
        fork = FORKS[k % len(FORKS)](SHARES[k // len(FORKS) % len(SHARES)])
        source = EngineDrives(switch_on(ROBOT, fork.effects), fork.ground)
        try:
            made = close_loop(
                fork.problem(MODEL), source, rounds=2, tolerance=0.0, effort=EFFORT // 2
            )
        except EnergyPlanError as reason:
            print(f"{k}: {fork.name}: {type(reason).__name__}: {reason}", flush=True)
            continue
        first, last = made.rounds[0], made.rounds[-1]
        rows.append((fork.name, first, last))
        print(f"{k}: {fork.name}: error {100 * first.error:+.1f} % -> {100 * last.error:+.1f} %, "
              f"taken {first.energy_measured:.0f} J, then {last.energy_measured:.0f} J "
              f"({100 * less(first, last):+.1f} % less), found "
              f"{', '.join(e.name for e in first.effects) or first.note}", flush=True)  # fmt: skip
    print("\n| map | error before | after | first route [J] | second route [J] | takes less |\n"
          "|---|---|---|---|---|---|")  # fmt: skip
    for name, first, last in rows:
        print(f"| {name} | {100 * first.error:+.1f} % | {100 * last.error:+.1f} % | "
              f"{first.energy_measured:.0f} | {last.energy_measured:.0f} | "
              f"{100 * less(first, last):.1f} % |")  # fmt: skip
    saved = np.array([less(first, last) for _, first, last in rows])
    print(f"\nthe second route takes less in {100 * np.mean(saved > 0):.0f} % of {len(saved)}, "
          f"median {100 * np.median(saved):.1f} %")  # fmt: skip


def less(first: Round, last: Round) -> float:
    """Return how much less one route took than another, as a fraction."""
    return 1 - last.energy_measured / first.energy_measured


PAIRS = (
    (("viscous_loss", 60.0), "air_drag"),
    (("air_drag", 240.0), "viscous_loss"),
    (("drive_efficiency", 0.2), "viscous_loss"),
    (("hotel_load", 30.0), "viscous_loss"),
    (("towing_force", 70.0), "dragging_wheel_left"),
)
"""A hidden effect with its size, about the least that is drawn, and what it may be taken for."""


def settles(log: ep.DriveLog, judge: ep.DriveLog, true: str, other: str) -> float:
    """Return how probable diagnosis holds the true one of two effects to be, without the other."""
    entries = [
        entry for entry in catalogue().values()
        if entry.usual or entry.acts == "hold" or entry.name in (true, other)
    ]  # fmt: skip
    told = ep.diagnose([log], [judge], VEHICLE, effects=entries)
    return sum(e.probability for e in told.explanations
               if true in e.effects and other not in e.effects)  # fmt: skip


def designed(count: int, duration: float = 60.0, noise: float = 20.0) -> None:
    """Two explanations are left: how often a designed drive settles which, and a random one."""
    start = ep.Pose(3.0, 3.0, 0.0)
    family = [
        made
        for m in manoeuvres(VEHICLE, 0.6, 1.5)
        if (made := TimedManoeuvre.of(m, VEHICLE, start, 0.5).trajectory).duration <= duration
    ]
    rows = []
    for k in range(count):
        (true, size), other = PAIRS[k % len(PAIRS)]
        options = [Hypothesis((true,), values={true: size}), Hypothesis((other,))]
        plan = design(MODEL, options, duration=duration, speed=0.6, noise=noise)
        rng = np.random.default_rng(k)
        some: list[ep.Trajectory] = []
        while True:
            more = family[int(rng.integers(len(family)))]
            if sum(part.duration for part in some) + more.duration > duration:
                break
            some.append(more)
        robot = HiddenEffect(true, size).on(ROBOT)
        sensors = Sensors(power_noise=noise / np.sqrt(2), seed=k, without=("accel_x",))
        logs = [
            sensors.log(drive(asked, robot, MODEL).run)
            for asked in (plan.trajectory, joined(some or family[:1]))
        ]
        sure = [settles(log, judge, true, other) for log, judge in (logs, logs[::-1])]
        rows.append((true, other, *sure))
        print(f"{k}: {true}, not {other}: probability {sure[0]:.3f} after the designed drive, "
              f"{sure[1]:.3f} after a random one", flush=True)  # fmt: skip
    print("\n| true | other | designed | random |\n|---|---|---|---|")
    for true, other, *sure in rows:
        print(f"| {true} | {other} | {sure[0]:.2f} | {sure[1]:.2f} |")
    counts = [sum(row[k] >= SURE for row in rows) for k in (2, 3)]
    print(f"\nsettled (probability {SURE:g} or more) by a drive of {duration:g} s at {noise:g} W "
          f"of noise: designed {counts[0]} of {count}, random {counts[1]} of {count}")  # fmt: skip


if __name__ == "__main__":
    what = sys.argv[1] if len(sys.argv) > 1 else "none"
    if what == "table":
        lines = [line for file in sys.argv[2:] for line in Path(file).read_text().splitlines()]
        table([row for line in lines if (row := Hidden.read(line)) is not None])
        sys.exit()
    number = int(sys.argv[2]) if len(sys.argv) > 2 else 4
    first = int(sys.argv[3]) if len(sys.argv) > 3 else 0
    if what == "none":
        without(number, first)
    elif what == "design":
        designed(number)
    elif what == "routes":
        routes(number, first)
    else:
        hidden(number, what == "one", first)
