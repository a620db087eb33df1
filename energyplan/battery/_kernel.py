"""The battery's inner loop: an equivalent circuit driven by power.

One series resistance, one resistance-capacitance pair and an open-circuit voltage that depends on
the state of charge. The power is held between samples. Within a sample the state is advanced in
sub-steps so short that neither the state of charge (`_MAX_STEP`) nor the pair's voltage
(a quarter of its time constant) moves far, each with the current of the sub-step's middle.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from energyplan.compilation import njit
from energyplan.compilation.arrays import Column, FloatTable

_MAX_STEP = 1e-3
"""Largest change of the state of charge in one sub-step."""

NONE, VOLTAGE, CHARGE, CURRENT = 0, 1, 2, 3
"""Why a battery gave up: it did not, voltage cut-off, empty, current limit."""


class Circuit(NamedTuple):
    """Constants of a pack.

    Attributes
    ----------
    capacity : float
        Charge [C].
    resistance : float
        Series resistance [ohm].
    pair_resistance, pair_time : float
        Resistance [ohm] and time constant [s] of the resistance-capacitance pair.
    peukert, rated : float
        Peukert's exponent, and the current above which it counts [A].
    efficiency : float
        Fraction of the charge that charging keeps.
    least_voltage, least_charge : float
        Voltage [V] and state of charge at which it cuts off.
    most_voltage : float
        Largest voltage [V].
    most_current, most_charging : float
        Largest discharge and charge current [A].
    """

    capacity: float
    resistance: float
    pair_resistance: float
    pair_time: float
    peukert: float
    rated: float
    efficiency: float
    least_voltage: float
    least_charge: float
    most_voltage: float
    most_current: float
    most_charging: float


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
    """Run a power profile through the battery.

    Parameters
    ----------
    t, power : ndarray, shape (n,)
        Sample times [s] and the power from each to the next [W], positive when drawn.
    soc : float
        State of charge at ``t[0]``.
    u1 : float
        Voltage of the resistance-capacitance pair at ``t[0]`` [V].
    soc_points, ocv_points : ndarray, shape (m,)
        Open-circuit voltage of the pack [V] over state of charge.
    circuit : Circuit
        The other constants of the pack.
    out : ndarray, shape (5, n)
        Filled with state of charge, voltage [V] and current [A] at each sample, and energy [J]
        lost in the battery and burnt on brake resistors since the start.

    Returns
    -------
    tuple of float, int and float
        Instant of the brown-out [s], infinite if there was none, its reason, and the pair's
        voltage at the end [V].
    """
    capacity, r0 = circuit.capacity, circuit.resistance
    r1, tau = circuit.pair_resistance, circuit.pair_time
    peukert, rated, efficiency = circuit.peukert, circuit.rated, circuit.efficiency
    v_cut, soc_cut, v_max = circuit.least_voltage, circuit.least_charge, circuit.most_voltage
    i_max, c_max = circuit.most_current, circuit.most_charging
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
            current, limited = 0.0, False
            root = emf * emf - 4.0 * r0 * wanted
            if wanted > 0.0:
                if soc <= soc_cut:
                    reason = CHARGE
                elif root < 0.0:
                    reason = VOLTAGE
                else:
                    current = 2.0 * wanted / (emf + np.sqrt(root))
                    if emf - r0 * current < v_cut:
                        reason = VOLTAGE
                    elif current > i_max:
                        reason = CURRENT
                if reason != NONE:
                    died, current, wanted = t[k] + done, 0.0, 0.0
            elif wanted < 0.0:
                current = 2.0 * wanted / (emf + np.sqrt(root))
                room = (v_max - emf) / r0 if r0 > 0.0 else c_max
                least = -min(c_max, max(room, 0.0)) if soc < 1.0 else 0.0
                limited = current < least
                current = max(current, least)
            if first:
                out[1, k], out[2, k] = emf - r0 * current, current
                first = False
                if k + 1 == n:
                    break
            rate = efficiency * current
            if current > 0.0:
                rate = current
                if peukert > 1.0 and current > rated:
                    rate = current * (current / rated) ** (peukert - 1.0)
            step = span - done
            if abs(rate) * step > _MAX_STEP * capacity:
                step = _MAX_STEP * capacity / abs(rate)
            if r1 > 0.0 and current != 0.0 and step > 0.25 * tau:
                step = 0.25 * tau
            change = -rate * step / capacity
            bound = -1.0
            if change < 0.0 and soc + change < soc_cut:
                bound = soc_cut
            elif change > 0.0 and soc + change > 1.0:
                bound = 1.0
            if bound >= 0.0:
                step *= (bound - soc) / change
                change = bound - soc
            # Half a step ahead the battery has moved on: correct the current to second order.
            if current != 0.0 and wanted != 0.0:
                ahead = emf + 0.5 * slope * change
                if r1 > 0.0:
                    ahead -= 0.5 * (r1 * current - u1) * step / tau
                root = ahead * ahead - 4.0 * r0 * wanted
                better = 2.0 * wanted / (ahead + np.sqrt(root)) if root > 0.0 else current
                if not limited:
                    change *= better / current
                    current = better
            soc = bound if bound >= 0.0 else min(max(soc + change, 0.0), 1.0)
            lost += r0 * current * current * step
            if r1 > 0.0:
                decay = np.exp(-step / tau)
                after = u1 * decay + r1 * current * (1.0 - decay)
                if current == 0.0:  # what the pair holds ebbs away, however long the step
                    lost += 0.5 * tau * (u1 * u1 - after * after) / r1
                else:
                    lost += 0.5 * (u1 * u1 + after * after) / r1 * step
                    emf -= 0.5 * (after - u1)
                u1 = after
            if limited:
                delivered = (emf + 0.5 * slope * change - r0 * current) * current
                braked += max(delivered - wanted, 0.0) * step
            done += step
            if span - done < 1e-9 * span:
                done = span
    return died, reason, u1
