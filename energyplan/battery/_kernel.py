"""The battery's inner loop: an equivalent circuit driven by power.

One series resistance, one resistance-capacitance pair and an open-circuit voltage that depends on
the state of charge. The power is held between samples. Within a sample the state is advanced in
sub-steps so short that neither the state of charge (`_MAX_STEP`) nor the pair's voltage
(a quarter of its time constant) moves far, each with the current of the sub-step's middle.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from energyplan.compilation import Column, FloatTable, njit

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
