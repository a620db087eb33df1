"""What a mission's battery gives and takes; search, simulation and report read the same."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from energyplan.battery import Battery, BatteryModel, BatteryRun
from energyplan.mission.types import Charger, Spreads, at_charger
from energyplan.path import FloatArray
from energyplan.records import bounds


class Charging(NamedTuple):
    """Constants of the time steps of charges."""

    step: float = 30.0  # time between two samples [s]
    parts: int = 300  # parts of the step in which a charge ends
    hours: int = 48  # longest charge [h]
    least_rise: float = 1e-3  # rise of the state of charge in an hour below which a charge ends
    same: float = 1e-6  # part of the offered power by which it changes no more
    halvings: int = 40  # of the state of charge, in the search for the least that gives a power


CHARGING = Charging()


Shares = Sequence[tuple[float, float]]
"""Which part of a charger's power a battery gets, from so long after its charge began [s]."""


class Gauge(NamedTuple):
    """What is open about a battery."""

    shares: tuple[float, float, float]  # by which share a drive empties it more, by source
    soc: float  # energy of one standard deviation of the state of charge [J]


class Charged(NamedTuple):
    """A charge from its begin on, until it suffices or rises no more."""

    time: FloatArray  # (n,): time since it began [s]
    charge: FloatArray  # (n,): state of charge then
    joules: FloatArray  # (n,): energy that the battery took until then, at its terminals [J]


@dataclass(frozen=True, eq=False)
class Supply:
    """A battery with what is not certain about it, at so many standard deviations."""

    battery: BatteryModel
    spreads: Spreads
    quantile: float

    def drain(self, power: float) -> Gauge:
        """Return what is open about the battery at a power [W], read where the bound lies.

        That is a quantile of standard deviations to the worse side, which is exact for an unknown
        that is alone, also where a table of capacities has a kink.
        """
        battery, spreads = self.battery, self.spreads
        stored, steps = float(battery.usable_energy(power, 1.0)), max(self.quantile, 1.0)
        soc = spreads.soc * (stored or battery.full_energy)

        def emptied(left: float) -> float:
            # one that delivers nothing at all has nothing to lose
            return max(max(stored, 1.0) / max(left, 1.0) - 1.0, 0.0) / steps

        capacity = emptied(stored * (1.0 - steps * spreads.capacity))
        if not isinstance(battery, Battery):
            return Gauge((capacity, 0.0, 0.0), soc)

        def worse(name: str, spread: float) -> float:
            now, (low, high) = getattr(battery, name), bounds(Battery)[name].possible
            sides = (min(max(now + sign * steps * spread, low), high) for sign in (-1.0, 1.0))
            changed = (replace(battery, **{name: side}) for side in sides)
            return emptied(min(float(one.usable_energy(power, 1.0)) for one in changed))

        health, warmth = worse("health", spreads.health), worse("temperature", spreads.temperature)
        return Gauge((capacity, health, warmth), soc)

    def stored(self, power: float, charge: ArrayLike) -> FloatArray:
        """Return the energy that it delivers at a power [W] from states of charge on [J]."""
        return self.battery.usable_energy(power, charge)

    def limit(self, charge: ArrayLike, lasting: ArrayLike = 0.0) -> FloatArray:
        """Return the largest power that it delivers for a time [s] at states of charge [W]."""
        soc, seconds = np.broadcast_arrays(np.asarray(charge, float), np.asarray(lasting, float))
        if not isinstance(self.battery, Battery):
            return np.full(soc.shape, np.inf)
        return self.battery.largest_power(soc, seconds)

    def least_charge(self, power: ArrayLike, lasting: ArrayLike = 0.0) -> FloatArray:
        """Return the least states of charge at which it delivers powers [W]; infinite if none."""
        load, seconds = np.broadcast_arrays(np.asarray(power, float), np.asarray(lasting, float))
        low, high = np.zeros(load.shape), np.ones(load.shape)
        for _ in range(CHARGING.halvings):
            middle = 0.5 * (low + high)
            enough = self.limit(middle, seconds) >= load
            low, high = np.where(enough, low, middle), np.where(enough, middle, high)
        high = np.where(self.limit(np.zeros(load.shape), seconds) >= load, 0.0, high)
        return np.where(self.limit(np.ones(load.shape), seconds) >= load, high, np.inf)

    def fastest(self, charger: Charger) -> float:
        """Return the power with which a charger fills it at most [W]."""
        power = float(np.max(charger.offers(_levels(charger))))
        if not isinstance(self.battery, Battery):
            return power
        current = self.battery.max_charge_current
        return min(power, float(self.battery.ocv(1.0)) * current)

    def charge(self, charge: float, until: float, charger: Charger, shares: Shares = ()) -> Charged:
        """Charge at a charger from a state of charge until another, or until it rises no more."""
        battery = at_charger(self.battery, charger)
        t, soc, joules = [0.0], [charge], [0.0]
        steps: FloatArray = CHARGING.step * np.arange(int(3600 / CHARGING.step) + 1.0)
        for _ in range(CHARGING.hours):
            begun, hour, before = soc[-1], t[-1], joules[-1]
            if begun >= until:
                break
            run, power = _filled(battery, charger, steps, begun, _parts(shares, hour + steps))
            offered = np.concatenate([[0.0], np.cumsum(power[:-1] * np.diff(steps))])
            taken = before + offered - run.braked
            reached = np.flatnonzero(run.soc >= until)
            stop = int(reached[0]) if len(reached) else len(steps)
            t.extend(hour + steps[1:stop])
            soc.extend(run.soc[1:stop])
            joules.extend(taken[1:stop])
            if len(reached):
                # the last step ends when it suffices
                short, last = np.linspace(0.0, CHARGING.step, CHARGING.parts + 1), power[stop - 1]
                run = battery.simulate(
                    short, np.full(len(short), -last), soc=float(run.soc[stop - 1])
                )
                # the shorter steps need not get there by the last bit
                enough = np.flatnonzero(run.soc >= until)
                end = int(enough[0]) if len(enough) else CHARGING.parts
                t.append(hour + steps[stop - 1] + short[end])
                soc.append(until)
                joules.append(float(taken[stop - 1] + last * short[end] - run.braked[end]))
            elif run.soc_end - begun < CHARGING.least_rise:
                break
        return Charged(np.array(t), np.array(soc), np.array(joules))


def _levels(charger: Charger) -> FloatArray:
    """Return states of charge among which a charger offers its largest power."""
    return np.array([soc for soc, _ in charger.power] if isinstance(charger.power, tuple) else 1.0)


def _parts(shares: Shares, t: FloatArray) -> FloatArray:
    """Return the mean share of a charger's power from each time to the next."""
    if not shares:
        return np.ones(len(t))
    begin, part = np.array(shares, float).T
    # the sum of the shares up to each of their begins, and up to the end of the times
    ends = np.append(begin, max(float(begin[-1]), float(t[-1])) + CHARGING.step)
    whole = np.concatenate([[0.0], np.cumsum(part * np.diff(ends))])
    return np.asarray(np.diff(np.interp(np.append(t, t[-1] + CHARGING.step), ends, whole))
                      / np.diff(np.append(t, t[-1] + CHARGING.step)))  # fmt: skip


def _filled(
    battery: BatteryModel, charger: Charger, t: FloatArray, soc: float, part: FloatArray
) -> tuple[BatteryRun, FloatArray]:
    """Return a battery while it is charged, and the power that it is offered from each time on.

    The power follows the state of charge in the middle of each step, on which the step before
    decides. Each pass has at least one step more right, so the passes end.
    """
    power = float(charger.offers(soc)) * part
    while True:
        run = battery.simulate(t, -power, soc=soc)
        rise = np.diff(run.soc, prepend=run.soc[0])
        then = charger.offers(np.minimum(run.soc + 0.5 * rise, 1.0)) * part
        if np.all(np.abs(then - power) <= CHARGING.same * then):
            return run, power
        power = then
