"""Missions of which everything is drawn by chance, driven by a small simulator.

Ground, run, tools, durations, waiting, gauge, capacity, health and temperature are drawn. The
simulator has its equations from the paper and from textbooks and shares no code with the library.
"""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np

from energyplan.battery import Battery
from energyplan.mission import Charger, Mission, MissionReport, Spreads, Task
from energyplan.path import Pose
from energyplan.power import HOTEL, PowerModel, Residual
from energyplan.terrain import OccupancyGrid

TREAD = 90.0
"""Traction resistance of each side of Quadriga on marble [N]."""
HOTEL_LOAD = 25.0
"""Power of electronics [W]."""
STEP = 2.0
"""Step of the simulator [s]."""


CORRIDOR = OccupancyGrid(np.zeros((30, 700), bool), 0.1)
"""One map for all missions along it, so that each route is planned once."""


def corridor(tasks: dict[str, tuple[float, float, float]], **changes: Any) -> Mission:
    """Return a mission along a corridor: tasks by metres, duration [s] and power [W]."""
    residual = Residual(
        rmse=20.0, mae=16.0, bias=0.0, energy_error=0.02, correlation_time=2.0, run_spread=0.04
    )
    model = PowerModel.preset("quadriga:empty:marble").with_term(HOTEL, HOTEL_LOAD)
    spread = np.diag((np.array([0.03, 0.03, 0.05]) * model.coefficients) ** 2)
    model = replace(model.with_coefficients(model.coefficients, spread), residual=residual)
    values: dict[str, Any] = {
        "model": model, "map": CORRIDOR,
        "battery": Battery.preset("quadriga"), "start": Pose(5.0, 1.5, 0.0), "speed": 0.5,
        "tasks": tuple(
            Task(name, Pose(x, 1.5, 0.0), dwell=dwell, power=power)
            for name, (x, dwell, power) in tasks.items()
        ),
        "soc": 0.9, "reserve": 0.05, "coefficient_spread": 0.03, "waiting": 20.0,
        "planning_effort": 10_000,
    }  # fmt: skip
    return Mission(**{**values, **changes})


def missions() -> dict[str, Mission]:
    """Return missions in which different unknowns decide."""
    mixed = {"a": (20.0, 1200.0, 200.0), "b": (60.0, 1800.0, 200.0), "c": (35.0, 900.0, 80.0)}
    long = {f"t{k}": (65.0 if k % 2 else 6.0, 60.0, 30.0) for k in range(8)}
    tools = {"wash": (15.0, 5400.0, 300.0), "scan": (30.0, 300.0, 20.0)}
    dock = Charger("dock", Pose(10.0, 1.5, 0.0), power=200.0, until=0.9)
    lithium = Battery.from_units(
        "li", "lithium_ion", series=10, parallel=8, unit_capacity=3.6 * 3600, unit_resistance=0.02,
        rated_time=5 * 3600,
    )  # fmt: skip
    aged = replace(Battery.preset("quadriga"), health=0.7)
    return {
        "mixed": corridor(mixed),
        "drives": corridor(long, soc=1.0),
        "tools": corridor(tools, spreads=Spreads(power=0.15, dwell=0.2)),
        "cold": corridor(mixed, battery=replace(aged, temperature=2.0)),
        "frost": corridor(
            mixed, battery=replace(aged, temperature=0.0), spreads=Spreads(temperature=8.0)
        ),
        "lithium": corridor(mixed, battery=lithium),
        "charging": corridor({**mixed, "d": (50.0, 3000.0, 250.0)}, battery=aged, chargers=(dock,)),
    }


def drawn(mission: Mission, count: int, rng: np.random.Generator) -> SimpleNamespace:
    """Return what chance decides, an array over all draws for each; by task for what tasks do.

    `model`, `run`, `holdout`, `ground` and `hotel` are relative errors of the power of driving:
    the identified traction, this run, the model, this day's ground, and hotel load.
    """
    spreads, battery = mission.spreads, mission.battery
    assert isinstance(battery, Battery)
    assert mission.model.residual is not None

    def normal(spread: float) -> np.ndarray:
        return rng.normal(0.0, 1.0, count) * spread

    tools = {task.power: 1.0 + normal(spreads.power) for task in mission.tasks}
    worn = battery.health + normal(spreads.health)
    return SimpleNamespace(
        model=normal(0.03), run=normal(mission.model.residual.run_spread or 0.0),
        holdout=normal(mission.model.residual.energy_error),
        ground=normal(mission.coefficient_spread),
        hotel=normal(0.05) + normal(mission.coefficient_spread),
        tool={t.name: t.power * tools[t.power] for t in mission.tasks},
        dwell={t.name: np.maximum(t.dwell * (1.0 + normal(spreads.dwell)), 0.0)
               for t in mission.tasks},
        wait={t.name: rng.exponential(mission.waiting, count) for t in mission.tasks},
        gauge=normal(spreads.soc), capacity=1.0 + normal(spreads.capacity),
        health=np.maximum(worn, 0.05),
        temperature=battery.temperature + normal(spreads.temperature),
    )  # fmt: skip


class Pack:
    """A battery in small steps: source, resistance, one RC pair, Peukert's law."""

    def __init__(self, battery: Battery, draws: SimpleNamespace, soc: float) -> None:
        self.battery = battery
        warm = np.interp(draws.temperature, battery.derating_temperature, battery.derating_factor)
        self.capacity = battery.capacity * draws.capacity * draws.health * warm
        cold = np.maximum(25.0 - draws.temperature, 0.0)
        self.factor = (1.0 + battery.resistance_coefficient * cold) / draws.health
        self.gauge = draws.gauge
        self.soc = np.clip(soc + draws.gauge, 0.0, 1.0)
        self.pair = np.zeros_like(self.soc)

    def draw(self, power: np.ndarray, seconds: np.ndarray) -> None:
        """Draw a power [W] for so long [s], each draw its own."""
        pack = self.battery
        steps = max(int(np.ceil(seconds.max() / STEP)), 1)
        for step in np.broadcast_to(seconds / steps, (steps, len(seconds))):
            source = np.interp(self.soc, pack.soc_points, pack.ocv_points) - self.pair
            ohms = self.factor * pack.resistance
            root = np.sqrt(np.maximum(source**2 - 4.0 * ohms * power, 0.0))
            current = (source - root) / (2.0 * ohms)
            over = np.maximum(current / pack.rated_current, 1.0) ** (pack.peukert - 1.0)
            self.soc = np.maximum(self.soc - current * over * step / self.capacity, 0.0)
            decay = np.exp(-step / pack.pair_time)
            settled = self.factor * pack.pair_resistance * current
            self.pair = settled + (self.pair - settled) * decay

    def charge(self, until: float) -> None:
        """Charge until the gauge tells that it is enough; the battery rests meanwhile."""
        self.soc = np.clip(until + self.gauge, self.soc, 1.0)
        self.pair = np.zeros_like(self.pair)


def simulated(report: MissionReport, count: int, seed: int = 0) -> np.ndarray:
    """Drive a mission so many times; return the states of charge at its end, shape (count,)."""
    mission, rng = report.mission, np.random.default_rng(seed)
    draws, residual = drawn(mission, count, rng), mission.model.residual
    assert residual is not None
    assert isinstance(mission.battery, Battery)
    pack = Pack(mission.battery, draws, mission.soc)
    until = {charger.name: charger.until for charger in mission.chargers}
    factor = 1.0 + draws.run + draws.holdout
    idle = HOTEL_LOAD * (1.0 + draws.hotel + draws.holdout)
    for before, stop in zip(report.route, report.route[1:], strict=False):
        metres, seconds = abs(stop.pose.x - before.pose.x), stop.arrival - before.departure
        if seconds > 0:
            pull = 2.0 * TREAD * metres / seconds * (1.0 + draws.model + draws.ground)
            hotel = HOTEL_LOAD * (1.0 + draws.hotel)
            noise = rng.normal(0.0, 1.0, count) * np.sqrt(
                2.0 * residual.rmse**2 * residual.correlation_time / seconds
            )
            pack.draw((pull + hotel) * factor + noise, np.full(count, seconds))
        if stop.kind == "task":
            pack.draw(idle, draws.wait[stop.name])
            pack.draw(idle + draws.tool[stop.name], draws.dwell[stop.name])
        if stop.kind == "charge":
            pack.charge(until[stop.name])
    return pack.soc
