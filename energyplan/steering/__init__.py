"""The exact minimum-energy motion between two poses in free space.

The minimum is taken over all motions that a skid-steer robot can make: every arc radius, spins,
pivots about either tread's ICR, straight lines, forwards and backwards. It is attained by straight
lines, pivots and spins (docs/theory, section 4).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from energyplan.cost import EnergyCost
from energyplan.cost.steering import StaticSteering
from energyplan.errors import InvalidInputError
from energyplan.path import PLACE, ROUNDING, FloatArray, Path, Pose, refuse_degrees
from energyplan.records import checked, numbers
from energyplan.steering.forwards import forward_energies, forward_path
from energyplan.steering.kernels import MAX_SEGMENTS, steer_energies, steer_path
from energyplan.steering.polygon import polygon_energies, polygon_path

FARTHEST = 1e9  # largest coordinate of a pose [m]; far beyond it energies overflow


def _poses(value: ArrayLike, name: str) -> FloatArray:
    poses = numbers(value, name)
    if poses.ndim == 0 or poses.shape[-1] != 3:
        raise InvalidInputError(
            f"{name} has shape {poses.shape}; give x, y, yaw along its last axis"
        )
    if not np.isfinite(poses).all():
        raise InvalidInputError(f"{name} holds a value that is not finite")
    if np.abs(poses[..., :2]).max(initial=0.0) > FARTHEST:
        raise InvalidInputError(f"{name} lies beyond {FARTHEST:g} m; give metres")
    refuse_degrees(poses[..., 2], f"the yaw of {name}")
    return poses


@checked()
def energy(
    start: ArrayLike, goal: ArrayLike, cost: EnergyCost, *, reverse: bool = True
) -> FloatArray:
    """Return the least energy of any motion from start to goal in free space.

    Parameters
    ----------
    start, goal : array_like, shape (..., 3)
        Poses x, y [m], yaw [rad] of the body frame; they broadcast against each other. Full turns
        of the yaw make no difference.
    cost : EnergyCost
        What motion costs.
    reverse : bool
        Whether the robot may drive backwards; it turns on the spot in any case.

    Returns
    -------
    ndarray, shape (...)
        Energy [J].

    Raises
    ------
    InvalidInputError
        If the poses have a wrong shape, do not broadcast, or are not finite; or if the robot may
        not reverse and its cost is not the paper's, which alone is solved exactly then.

    References
    ----------
    docs/theory, section 4; docs/steering.

    Examples
    --------
    >>> cost = EnergyCost.from_coefficients(per_metre=200.0, per_radian=100.0, icr=0.5)
    >>> energy((0, 0, 0), [(3, 0, 0), (0, 0, 1), (1, 0.2, 0)], cost).round(2)
    array([600.  , 200.  , 248.53])
    """
    first, last = _poses(start, "start"), _poses(goal, "goal")
    try:
        first, last = np.broadcast_arrays(first, last)
    except ValueError:
        raise InvalidInputError(
            f"start of shape {first.shape} and goal of shape {last.shape} do not broadcast"
        ) from None
    out = np.empty(first.shape[:-1])
    starts = np.array(first, order="C").reshape(-1, 3)  # no views, of which NumPy warns
    goals = np.array(last, order="C").reshape(-1, 3)
    read = cost.steering_parameters
    if isinstance(read, StaticSteering):
        solve = steer_energies if reverse else forward_energies
        solve(starts, goals, read, out.reshape(-1))
    else:
        _refuse_forwards(reverse)
        polygon_energies(starts, goals, read, out.reshape(-1))
    return out


@checked()
def path(start: ArrayLike, goal: ArrayLike, cost: EnergyCost, *, reverse: bool = True) -> Path:
    """Return a motion from start to goal that takes the least energy.

    Parameters
    ----------
    start, goal : array_like, shape (3,)
        Poses x, y [m], yaw [rad] of the body frame.
    cost : EnergyCost
        What motion costs.
    reverse : bool
        Whether the robot may drive backwards; it turns on the spot in any case.

    Returns
    -------
    Path
        Straight lines, pivots and spins; a turn on the spot is one spin where pivots take no less.
        The yaw at its end is the goal's up to full turns.

    Raises
    ------
    InvalidInputError
        If a pose has a wrong shape or is not finite; or, without reversing, as for `energy`.

    References
    ----------
    docs/theory, section 4; docs/steering.

    Examples
    --------
    >>> cost = EnergyCost.from_coefficients(per_metre=200.0, per_radian=100.0, icr=0.5)
    >>> route = path((0, 0, 0), (1, 0.2, 0), cost)
    >>> [round(v, 9) for v in route.end], round(cost.energy(route), 2)
    ([1.0, 0.2, 0.0], 248.53)
    """
    first, last = _poses(start, "start"), _poses(goal, "goal")
    if first.shape != (3,) or last.shape != (3,):
        raise InvalidInputError(
            f"start has shape {first.shape} and goal {last.shape}; a path joins one pose to one"
        )
    ds, dtheta = np.empty(MAX_SEGMENTS), np.empty(MAX_SEGMENTS)
    cost.check_any_heading("exact steering")
    between = last[0] - first[0], last[1] - first[1], first[2], last[2]
    read = cost.steering_parameters
    if isinstance(read, StaticSteering):
        n = (steer_path if reverse else forward_path)(*between, read, ds, dtheta)
    else:
        _refuse_forwards(reverse)
        n = polygon_path(*between, read, ds, dtheta)
    found = Path(Pose(*(float(v) for v in first)), ds[:n], dtheta[:n], cost.icr.longitudinal)
    return _spin_if_as_good(found, last, cost)


def _refuse_forwards(reverse: bool) -> None:
    if not reverse:
        raise InvalidInputError(
            "steering without reversing is exact for static models only, whose energy two numbers "
            "describe; leave reverse out, or give EnergyCost.from_coefficients"
        )


def _spin_if_as_good(found: Path, goal: FloatArray, cost: EnergyCost) -> Path:
    """Return the turn on the spot where that leads to the goal for no more energy."""
    turn = float(found.dtheta.sum())
    moved = np.array([cost.icr.centre[1] * turn])
    spin = Path(found.start, moved, np.array([turn]), found.longitudinal)
    misses = np.hypot(*np.subtract(spin.end, goal)[:2]) > PLACE
    if len(found) < 2 or misses or abs(turn) > np.pi + ROUNDING:
        return found
    return spin if cost.energy(spin) <= cost.energy(found) * (1.0 + ROUNDING) else found
