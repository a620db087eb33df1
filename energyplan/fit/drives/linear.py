"""A drive's power about given coefficients, and its derivatives (private).

Selection asks hundreds of times for the same drives and terms, so that the force of each term is
computed once a drive and kept; only the losses are evaluated anew.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from energyplan.fit.drives.columns import columns_of, field_of, of_equations
from energyplan.fit.drives.late import ON_TIME, Late
from energyplan.fit.drives.windows import MOMENT, Drive
from energyplan.motion import Motion
from energyplan.path import FloatArray
from energyplan.power import DRIVE_LOSS, REGENERATION_LOSS, SLIP, PowerModel, Sides, Term
from energyplan.vehicle import Vehicle

_STEP = 1e-4
_BISECTIONS = 16
_INSIDE = 6  # bisections by which a moment differs from its limit
_TOLD = 5.0  # noise that the largest moment exceeds where its size can be told


@dataclass(frozen=True)
class Linear:
    """Power of a drive and its derivatives, as `Drive.observed` shows them.

    Parameters
    ----------
    power : ndarray, shape (n, e)
        Predicted power of each equation [W].
    columns : ndarray, shape (n, e, k)
        Its derivative by each coefficient [W per unit].
    """

    power: FloatArray
    columns: FloatArray


def is_lossy(drive: Drive, terms: Sequence[Term]) -> bool:
    """Tell whether the power is not linear in the coefficients."""
    return drive.battery or any(term.kind == "loss" for term in terms)


def linearise_drive(
    drive: Drive,
    vehicle: Vehicle,
    terms: Sequence[Term],
    values: FloatArray,
    wanted: Sequence[int] | None = None,
) -> Linear:
    """Linearise the power of a drive about coefficients.

    Parameters
    ----------
    drive : Drive
        The drive.
    vehicle : Vehicle
        The vehicle; its efficiencies count where power was measured at the battery.
    terms : sequence of Term
        The terms.
    values : ndarray, shape (k,)
        Their coefficients.
    wanted : sequence of int, optional
        Terms to differentiate by; all where not given.

    Returns
    -------
    Linear
        Power, and one column for each wanted term.
    """
    held = drive.held
    losses = losses_of(drive, vehicle, terms, values)
    total = held_forces(drive, vehicle, terms, values)
    fight = None
    if drive.between is not None and is_lossy(drive, terms):
        limit = vehicle.slip_moment * slip_limit(terms, values)
        fight = preload(drive, drive.between, vehicle, losses, total, limit)
        total = total + fight.forces

    rise = _rise(losses, drive, vehicle, total) if losses else None
    columns = []
    for k in range(len(terms)) if wanted is None else wanted:
        term = terms[k]
        if term.kind == "loss":
            own = of_equations(term.function(held, vehicle, total, **term.params), drive)
        else:
            own = columns_of(term, drive, vehicle)
        if term.kind == "force" and rise is not None:
            acting = field_of(term, drive, vehicle, held=True)
            own = own + rise.left * acting.left[:, None] + rise.right * acting.right[:, None]
        columns.append(own)
    power = np.zeros((len(drive.t), drive.equations))
    if losses:
        power = power + of_equations(lost_power(losses, held, vehicle, total), drive)
    for term, value in zip(terms, values, strict=True):
        if term.kind != "loss":
            power = power + float(value) * columns_of(term, drive, vehicle)
    table = np.stack(columns, axis=-1) if columns else np.zeros((*power.shape, 0))
    if fight is not None:
        # The moment follows the coefficients so that the sides' difference stays as measured.
        table[:, 0] -= fight.share[:, None] * table[:, 1]
        known, most = _at_rest(drive, power[:, 0], held_loss(vehicle, terms, values, drive))
        power[:, 0] += most
        table[known, 0] = 0.0
    return Linear(drive.observed(power), drive.observed(table))


def equations_of(model: PowerModel, drive: Drive) -> FloatArray:
    """Return the power of a drive by a model in each equation, as the log shows it [W]."""
    for term in model.terms:
        for name in term.channels:
            drive.motion.channel(name, f"the term {term.name!r}")
    return linearise_drive(drive, model.vehicle, model.terms, model.coefficients, ()).power


def power_of(model: PowerModel, drive: Drive) -> FloatArray:
    """Return the power of a drive by a model, with contacts that hold on a straight [W]."""
    return equations_of(model, replace(drive, between=None, late=ON_TIME, factor=1.0))[:, 0]


def held_loss(vehicle: Vehicle, terms: Sequence[Term], values: FloatArray, drive: Drive) -> float:
    """Return the most that losses take at rest, where contacts hold all that friction allows [W].

    Parameters
    ----------
    vehicle : Vehicle
        The vehicle.
    terms : sequence of Term
        Terms of the model.
    values : ndarray, shape (k,)
        Their coefficients.
    drive : Drive
        Tells the slip track, and whether efficiencies count.

    Returns
    -------
    float
        Zero where no loss acts at rest.
    """
    push = np.array(vehicle.slip_moment * slip_limit(terms, values) / drive.motion.icr.slip_track)
    losses = losses_of(drive, vehicle, terms, values)
    still = Motion(np.array(0.0), np.array(0.0), drive.motion.icr)
    return float(lost_power(losses, still, vehicle, Sides(-push, push)).total)


def _at_rest(drive: Drive, power: FloatArray, most: float) -> tuple[NDArray[np.bool_], FloatArray]:
    """Return which samples at rest a held moment explains, and what it takes at each [W].

    At rest the sides' difference is zero whatever contacts hold. What is drawn beyond the model, up
    to what they can hold, is no evidence against it, nor for any coefficient.
    """
    rest = drive.holds & (drive.held.v_left == 0.0)  # which is that of both where contacts hold
    early = replace(drive, late=Late(-drive.late.mean), factor=1.0)
    beyond = uniform_filter1d(
        np.asarray(early.seen(drive.power) / drive.factor) - power, drive.samples_in(MOMENT)
    )
    taken = np.where(rest, np.clip(beyond, 0.0, most), 0.0)
    return rest & (beyond > 0.0) & (beyond < most), taken


def losses_of(
    drive: Drive, vehicle: Vehicle, terms: Sequence[Term], values: FloatArray
) -> list[tuple[Term, float]]:
    """Return the losses that are there, with their coefficients, known efficiencies included."""
    names = {term.name for term in terms}
    losses = [
        (term, float(value)) for term, value in zip(terms, values, strict=True)
        if term.kind == "loss" and value != 0.0
    ]  # fmt: skip
    if drive.battery:
        known = (
            (DRIVE_LOSS, 1 / vehicle.drive_efficiency - 1),
            (REGENERATION_LOSS, 1 - vehicle.regen_efficiency),
        )
        losses += [(term, value) for term, value in known if term.name not in names and value > 0]
    return losses


def held_forces(drive: Drive, vehicle: Vehicle, terms: Sequence[Term], values: FloatArray) -> Sides:
    """Tread forces of a drive with contacts that hold, without what they hold [N]."""
    total = Sides(np.zeros(drive.motion.shape), np.zeros(drive.motion.shape))
    for term, value in zip(terms, values, strict=True):
        if term.kind == "force":
            total = total + field_of(term, drive, vehicle, held=True) * float(value)
    return total


def slip_limit(terms: Sequence[Term], values: FloatArray) -> float:
    """Return the friction coefficient that bounds what contacts hold."""
    for term, value in zip(terms, values, strict=True):
        if term.name == SLIP.name:
            return max(float(value), 0.0)
    return 0.0


def lost_power(
    losses: Sequence[tuple[Term, float]], motion: Motion, vehicle: Vehicle, forces: Sides
) -> Sides:
    """Power of each side that losses take [W]."""
    whole = Sides(np.zeros(motion.shape), np.zeros(motion.shape))
    for term, value in losses:
        whole = whole + term.function(motion, vehicle, forces, **term.params) * value
    return whole


@dataclass(frozen=True)
class Preload:
    """The moment by which the sides push against each other while contacts hold.

    Parameters
    ----------
    moment : ndarray, shape (n,)
        The moment [N m]; zero where contacts slide.
    share : ndarray, shape (n,)
        By how much the total rises with it, over by how much the sides' difference does.
    forces : Sides
        Tread forces of the moment [N].
    """

    moment: FloatArray
    share: FloatArray
    forces: Sides


def preload(
    drive: Drive,
    between: FloatArray,
    vehicle: Vehicle,
    losses: Sequence[tuple[Term, float]],
    forces: Sides,
    limit: float,
) -> Preload:
    """Find the moment between the sides from the measured difference of their powers.

    Parameters
    ----------
    drive : Drive
        The drive.
    between : ndarray, shape (n,)
        Measured power of its right side less that of the left one [W].
    vehicle : Vehicle
        The vehicle.
    losses : sequence of tuple of Term and float
        The losses that act, with their coefficients.
    forces : Sides
        Tread forces without the moment [N].
    limit : float
        Largest moment that contacts hold [N m].

    Returns
    -------
    Preload
        The moment, by bisection: the difference rises with it wherever losses take less than what
        passes through them. Means over a moment of time, as sure as each sample is; zero where the
        robot is too slow to tell.
    """
    at, motion = drive.holds, drive.holding
    own = Sides(forces.left[at], forces.right[at])
    sign = np.sign(motion.v_left + motion.v_right)
    track = drive.motion.icr.slip_track
    # As the model has it: in time with the motion, and without the run's own factor.
    early = replace(drive, late=Late(-drive.late.mean), factor=1.0)
    wanted = np.asarray(early.seen(between) / drive.factor)[at]

    def powers(moment: FloatArray) -> Sides:
        push = moment / track
        acting = Sides(own.left - push, own.right + push)
        through = Sides(acting.left * motion.v_left, acting.right * motion.v_right)
        return through + lost_power(losses, motion, vehicle, acting)

    if losses:
        low, high = np.full(len(wanted), -limit), np.full(len(wanted), limit)
        for _ in range(_BISECTIONS):
            middle = 0.5 * (low + high)
            both = powers(middle)
            above = sign * (both.right - both.left - wanted) > 0.0
            low, high = np.where(above, low, middle), np.where(above, middle, high)
        found = 0.5 * (low + high)
    else:
        speed = motion.v_left + motion.v_right
        still = powers(np.zeros(len(wanted)))
        free = track * (wanted - still.right + still.left)
        found = np.divide(free, speed, out=np.zeros(len(free)), where=speed != 0.0)
        found = np.clip(found, -limit, limit)
    step = max(1e-3 * limit, 1e-9)
    ahead, behind = powers(found + step), powers(found - step)
    rise = sign * ((ahead.right - ahead.left) - (behind.right - behind.left)) / (2 * step)
    clear = rise * limit > _TOLD * drive.between_noise
    inside = clear & (np.abs(found) < (1.0 - 2.0**-_INSIDE) * limit)
    total = sign * (ahead.total - behind.total) / (2 * step)
    weight, moment, share = (np.zeros(len(drive.t)) for _ in range(3))
    weight[at] = np.where(clear, rise, 0.0) ** 2
    moment[at] = found
    share[at] = np.where(inside, total / np.where(inside, rise, 1.0), 0.0)
    width = drive.samples_in(MOMENT)
    sure = uniform_filter1d(weight, width)
    smooth = uniform_filter1d(weight * moment, width) / np.where(sure > 0.0, sure, 1.0)
    driving = at & ((drive.held.v_left != 0.0) | (drive.held.v_right != 0.0))
    smooth = np.where(driving & (sure > 0.0), smooth, 0.0)
    return Preload(smooth, share, Sides(-smooth / track, smooth / track))


def _rise(
    losses: Sequence[tuple[Term, float]], drive: Drive, vehicle: Vehicle, forces: Sides
) -> Sides:
    """Rise of the losses in each equation with the force of each side, shape (n, equations) each.

    Central differences: exact where losses are linear or quadratic in the forces.
    """
    size = max(float(np.max(np.abs(forces.left))), float(np.max(np.abs(forces.right))), 1.0)
    step = _STEP * size

    def lost(left: float, right: float) -> FloatArray:
        moved = Sides(forces.left + left, forces.right + right)
        return of_equations(lost_power(losses, drive.held, vehicle, moved), drive)

    return Sides(
        (lost(step, 0.0) - lost(-step, 0.0)) / (2 * step),
        (lost(0.0, step) - lost(0.0, -step)) / (2 * step),
    )
