"""What a mission does not know beside its models: tools, durations, waiting, and the battery.

Each unknown is one standard normal coordinate, behind those of the models. What is open about the
battery is told as the share by which the energy that it delivers changes with one standard
deviation, at the power of driving.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from energyplan.battery import Battery
from energyplan.mission.types import Mission

RUN = 0
"""Place of what differs from run to run."""


@dataclass(frozen=True)
class Unknowns:
    """Places of the unknowns among their coordinates."""

    labels: tuple[str, ...]  # what each belongs to
    tools: tuple[int, ...]  # place for each task
    dwells: tuple[int, ...]  # place for each task
    waits: tuple[int, ...]  # place for each task
    speed: int  # place of the time that driving takes
    gauge: int  # place of the state of charge
    gauge_energy: float  # energy that one standard deviation of it stands for [J]
    battery: Mapping[int, float]

    @classmethod
    def of(cls, mission: Mission, power: float) -> Unknowns:
        """Return the unknowns of a mission."""
        labels = ["difference from run to run"]

        def new(label: str) -> int:
            labels.append(label)
            return len(labels) - 1

        tools: dict[tuple[float, float | None], int] = {}
        for task in mission.tasks:
            if (task.power, task.power_spread) not in tools:
                tools[task.power, task.power_spread] = new("power of tools")
        battery = {new(label): share for label, share in _shares(mission, power).items()}
        stored = float(mission.battery.usable_energy(power, 1.0)) or mission.battery.full_energy
        return cls(
            tools=tuple(tools[task.power, task.power_spread] for task in mission.tasks),
            dwells=tuple(new("duration of tasks") for _ in mission.tasks),
            waits=tuple(new("waiting") for _ in mission.tasks),
            speed=new("speed of driving"),
            gauge=new("state of charge"),
            gauge_energy=mission.spreads.soc * stored,
            battery=battery,
            labels=tuple(labels),
        )


def _shares(mission: Mission, power: float) -> dict[str, float]:
    """Return the share of the energy by which the battery delivers less, by what is open."""
    battery, spreads = mission.battery, mission.spreads
    shares = {"capacity of the battery": spreads.capacity}
    if not isinstance(battery, Battery):
        return shares

    def usable(changed: Battery) -> float:
        return float(changed.usable_energy(power, 1.0))

    warm, cold = (
        usable(replace(battery, temperature=battery.temperature + sign * spreads.temperature))
        for sign in (1.0, -1.0)
    )
    # one that delivers nothing at all has nothing to lose
    told = max(usable(battery), 1.0)
    # a battery cannot be healthier than new, nor older than nothing
    fresh = min(battery.health + spreads.health, 1.0)
    aged = max(battery.health - spreads.health, 0.1 * battery.health)
    better, worse = (usable(replace(battery, health=h)) for h in (fresh, aged))
    steps = (fresh - aged) / spreads.health if spreads.health else 1.0
    shares["health of the battery"] = (better - worse) / told / steps
    shares["temperature of the battery"] = (warm - cold) / told / 2.0
    return shares
