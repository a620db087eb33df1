"""Motion without the noise of the speed sensors (private)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d, uniform_filter1d
from scipy.signal import savgol_filter

from energyplan.logs.checks import find_runs
from energyplan.motion import Motion
from energyplan.path import FloatArray

_SMOOTHING = 0.45  # width of the local parabola [s]
_LONGER = (1.0, 2.0, 4.0)  # averages that may still tell a slight turn [s]
_SIGMA = 4.0  # standard deviations that noise does not exceed
_NOISELESS = 1e-4  # speed noise not worth smoothing [m/s]
_ROUNDING = 1e-6  # a smaller difference of noiseless speeds is none [m/s]
_CREEP = 2e-3  # a slower tread is at rest [m/s]
_DRIVING = 0.1  # share of the usual speed that is driving, whatever the noise
_SHORTEST = 7  # samples in a stretch below which nothing is smoothed


def quiet(motion: Motion, t: FloatArray) -> Motion:
    """Return a motion without the noise of its speed sensors.

    Friction turns with the sign of a speed, and noise about zero has any sign. Speeds are smoothed
    by a local parabola. A speed that noise can explain is zero. A difference of both treads'
    speeds that noise can explain is averaged over longer and longer stretches, and zero where it
    stays within the noise: the friction of a slight turn is that of a sharp one, so that it matters
    which way the robot turned, however little. Without noise only creep at rest is taken out.

    Parameters
    ----------
    motion : Motion, shape (n,)
        As measured.
    t : ndarray, shape (n,)
        Time [s].

    Returns
    -------
    Motion
        The same channels with cleaned tread speeds.
    """
    left, right = np.array(motion.v_left), np.array(motion.v_right)
    for run in find_runs(t):
        left[run], right[run] = _quiet_run(left[run], right[run], t[run])
    return replace(motion, v_left=left, v_right=right)


def _quiet_run(left: FloatArray, right: FloatArray, t: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return both tread speeds of a stretch without a gap, freed of noise."""
    if len(t) < _SHORTEST:
        return left, right
    noise = max(speed_noise(left), speed_noise(right))
    period = float(np.median(np.diff(t)))
    width = 2 * round(0.5 * _SMOOTHING / period) + 1
    level = _SIGMA * noise
    # Readings that beat with the encoder scatter by a good part of the speed, but are no standstill
    # and no turn: whatever the noise, a good part of the usual speed is driving.
    moving = np.maximum(np.abs(left), np.abs(right))
    usual = float(np.median(moving[moving > 0])) if np.any(moving) else 0.0
    most = _DRIVING * usual
    if noise > _NOISELESS and 5 <= width <= len(t):
        left, right = (savgol_filter(v, width, 2) for v in (left, right))
        level *= 1.5 / np.sqrt(width)  # a parabola leaves 9 / 4n of the variance at its middle
    elif level > most and len(t) >= 2 * _SHORTEST:
        size = min(2 * round(0.5 * _LONGER[0] / period) + 1, _SHORTEST)
        left, right = (uniform_filter1d(v, max(size, 3)) for v in (left, right))
    level = min(level, most)
    mean = 0.5 * (left + right)
    moving = np.maximum(np.abs(left), np.abs(right)) > max(level, _CREEP)
    turn = _turn(right - left, np.sqrt(2) * level, np.sqrt(2) * _SIGMA * noise, moving, period)
    left, right = mean - 0.5 * turn, mean + 0.5 * turn
    level = max(level, _CREEP)
    left, right = (np.where(np.abs(v) < level, 0.0, v) for v in (left, right))
    return left, right


def _turn(
    difference: FloatArray, level: float, sample: float, moving: NDArray[np.bool_], period: float
) -> FloatArray:
    """Difference of the tread speeds, zero where noise can explain it."""
    straight = np.abs(difference) < max(level, _ROUNDING)
    turn = np.where(straight, 0.0, difference)
    if sample < _NOISELESS:
        return turn
    for length in _LONGER:
        size = 2 * round(0.5 * length / period) + 1
        if size > len(turn):
            break
        # Only where the whole stretch is straight so far: nothing leaks in from a turn beside it.
        calm = maximum_filter1d((~straight | ~moving).astype(float), size) == 0.0
        average = uniform_filter1d(difference, size)
        told = calm & (np.abs(average) > sample / np.sqrt(size))
        # A stretch ends where the turn does: carry the finding to its ends.
        reach = maximum_filter1d(told.astype(float), size) > 0.0
        near = reach & straight & moving
        if near.any():
            filled = np.interp(np.arange(len(turn)), np.flatnonzero(told), average[told])
            turn = np.where(near & (turn == 0.0), filled, turn)
    return turn


def speed_noise(values: FloatArray) -> float:
    """Return the deviation of white noise on a smooth signal, from its third differences."""
    return float(1.4826 * np.median(np.abs(np.diff(values, 3))) / np.sqrt(20.0))
