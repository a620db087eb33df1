"""The battery's inner loop: an equivalent circuit driven by power.

One series resistance, one resistance-capacitance pair and an open-circuit voltage that depends on
the state of charge. The power is held between samples. Within a sample the state is advanced in
sub-steps so short that neither the state of charge (`_MAX_STEP`) nor the pair's voltage
(a quarter of its time constant) moves far, each with the current of the sub-step's middle.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from energyplan.compilation import Column, FloatTable, lean, njit

_MAX_STEP = 1e-3  # largest change of the state of charge in one sub-step

NONE, VOLTAGE, CHARGE, CURRENT = 0, 1, 2, 3
"""Why a battery gave up: it did not, voltage cut-off, empty, current limit."""


class Circuit(NamedTuple):
    """Constants of a pack."""

    capacity: float  # charge [C]
    resistance: float  # series resistance [ohm]
    pair_resistance: float  # resistance of the resistance-capacitance pair [ohm]
    pair_time: float  # time constant of the pair [s]
    peukert: float  # Peukert's exponent
    rated: float  # current above which Peukert's exponent applies [A]
    efficiency: float  # fraction of the charge that charging keeps
    least_voltage: float  # voltage at which it cuts off [V]
    least_charge: float  # state of charge at which it cuts off
    most_voltage: float  # largest voltage [V]
    most_current: float  # largest discharge current [A]
    most_charging: float  # largest charge current [A]


class Draw(NamedTuple):
    """The current that a battery gives for a power."""

    current: float  # [A]
    limited: bool  # whether it is less than the power would charge it with
    reason: int  # why it gives none


class SubStep(NamedTuple):
    """A part of a sample."""

    length: float  # [s]
    change: float  # of the state of charge
    bound: float  # the state of charge that it ends at, if that is the least or a full one; or -1


@lean
def _drawn(circuit: Circuit, emf: float, wanted: float, soc: float) -> Draw:
    """Return the current that delivers a power, if the battery can."""
    r0 = circuit.resistance
    root = emf * emf - 4.0 * r0 * wanted
    if wanted > 0.0:
        if soc <= circuit.least_charge:
            return Draw(0.0, False, CHARGE)
        if root < 0.0:
            return Draw(0.0, False, VOLTAGE)
        current = 2.0 * wanted / (emf + np.sqrt(root))
        if emf - r0 * current < circuit.least_voltage:
            return Draw(0.0, False, VOLTAGE)
        if current > circuit.most_current:
            return Draw(0.0, False, CURRENT)
        return Draw(current, False, NONE)
    if wanted < 0.0:
        current = 2.0 * wanted / (emf + np.sqrt(root))
        room = (circuit.most_voltage - emf) / r0 if r0 > 0.0 else circuit.most_charging
        least = -min(circuit.most_charging, max(room, 0.0)) if soc < 1.0 else 0.0
        return Draw(max(current, least), current < least, NONE)
    return Draw(0.0, False, NONE)


@lean
def _sub_step(circuit: Circuit, current: float, soc: float, left: float) -> SubStep:
    """Return the longest part of a sample in which neither charge nor pair moves far."""
    rate = circuit.efficiency * current
    if current > 0.0:
        rate = current
        if circuit.peukert > 1.0 and current > circuit.rated:
            rate = current * (current / circuit.rated) ** (circuit.peukert - 1.0)
    step = left
    if abs(rate) * step > _MAX_STEP * circuit.capacity:
        step = _MAX_STEP * circuit.capacity / abs(rate)
    if circuit.pair_resistance > 0.0 and current != 0.0 and step > 0.25 * circuit.pair_time:
        step = 0.25 * circuit.pair_time
    change = -rate * step / circuit.capacity
    bound = -1.0
    if change < 0.0 and soc + change < circuit.least_charge:
        bound = circuit.least_charge
    elif change > 0.0 and soc + change > 1.0:
        bound = 1.0
    if bound >= 0.0:
        step *= (bound - soc) / change
        change = bound - soc
    return SubStep(step, change, bound)


@lean
def _halfway(
    circuit: Circuit, emf: float, u1: float, rise: float, wanted: float, current: float, step: float
) -> float:
    """Return the current half a sub-step ahead, where the battery has moved on."""
    r1 = circuit.pair_resistance
    ahead = emf + 0.5 * rise
    if r1 > 0.0:
        ahead -= 0.5 * (r1 * current - u1) * step / circuit.pair_time
    root = ahead * ahead - 4.0 * circuit.resistance * wanted
    return float(2.0 * wanted / (ahead + np.sqrt(root)) if root > 0.0 else current)


@lean
def _pair(circuit: Circuit, u1: float, current: float, step: float) -> tuple[float, float]:
    """Return the voltage of the pair after a sub-step, and what it loses meanwhile."""
    r1, tau = circuit.pair_resistance, circuit.pair_time
    if not r1 > 0.0:
        return u1, 0.0
    decay = np.exp(-step / tau)
    after = u1 * decay + r1 * current * (1.0 - decay)
    if current == 0.0:  # what the pair holds ebbs away, however long the step
        return after, 0.5 * tau * (u1 * u1 - after * after) / r1
    return after, 0.5 * (u1 * u1 + after * after) / r1 * step


@njit
def discharge(
    t: Column,
    power: Column,
    soc: float,
    u1: float,
    soc_points: Column,
    ocv_points: Column,
    circuit: Circuit,
    out: FloatTable,
) -> tuple[float, int, float]:
    """Run a power profile through the battery."""
    r0 = circuit.resistance
    n, m = len(t), len(soc_points)
    lost, braked = 0.0, 0.0
    died, reason = np.inf, NONE
    j = m - 2
    for k in range(n):
        span = t[k + 1] - t[k] if k + 1 < n else 0.0
        out[0, k], out[3, k], out[4, k] = soc, lost, braked
        done, first = 0.0, True
        while first or done < span:
            while j > 0 and soc < soc_points[j]:
                j -= 1
            while j < m - 2 and soc > soc_points[j + 1]:
                j += 1
            slope = (ocv_points[j + 1] - ocv_points[j]) / (soc_points[j + 1] - soc_points[j])
            emf = ocv_points[j] + slope * (soc - soc_points[j]) - u1
            wanted = power[k] if reason == NONE else 0.0
            drawn = _drawn(circuit, emf, wanted, soc)
            current = drawn.current
            if drawn.reason != NONE:
                died, reason, wanted = t[k] + done, drawn.reason, 0.0
            if first:
                out[1, k], out[2, k] = emf - r0 * current, current
                first = False
                if k + 1 == n:
                    break
            part = _sub_step(circuit, current, soc, span - done)
            step, change = part.length, part.change
            if current != 0.0 and not drawn.limited:
                better = _halfway(circuit, emf, u1, slope * change, wanted, current, step)
                change *= better / current
                current = better
            soc = part.bound if part.bound >= 0.0 else min(max(soc + change, 0.0), 1.0)
            lost += r0 * current * current * step
            after, heat = _pair(circuit, u1, current, step)
            lost += heat
            if drawn.limited:
                emf -= 0.5 * (after - u1)
                delivered = (emf + 0.5 * slope * change - r0 * current) * current
                braked += max(delivered - wanted, 0.0) * step
            u1 = after
            done += step
            if span - done < 1e-9 * span:
                done = span
    return died, reason, u1
