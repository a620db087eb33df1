"""One step of recursive identification: robust, forgetting, watching for change (private).

The state is a handful of small arrays that the kernel changes in place. Coefficients are counted
in units of their prior standard deviation, so that the prior's information is the unit matrix.
"""

from __future__ import annotations

import numpy as np

from energyplan.compilation import AnyTable, Column, FloatBlock, Floats, FloatTable, njit

# Matrices of the state: information and covariance of the coefficients.
INFORMATION, COVARIANCE = range(2)
# Vectors of the state: the coefficients, and by how much they seem to have changed.
COEFFICIENTS, SHIFT = range(2)
# Scalars of the state.
(
    VARIANCE,  # of the residual [W^2]
    SAMPLES,  # that the variance stands on
    REPEATS,  # samples that make one independent sample
    BLOCKS,  # that this stands on; means over them of the sum's size and of the sum of squares
    MEAN_SIZE,
    MEAN_SQUARES,
    EXCITATION,  # mean square of the regressors while driving [W^2]
    LEVEL,  # of the statistic, over what chance alone gives
    BLOCK_SUM,  # of normalised residuals in the present block, their squares, its length [s]
    BLOCK_SQUARES,
    BLOCK_TIME,
    TICK_TIME,  # length of the present tick [s]
    TICKS,  # completed since the last change
    STATISTIC,  # of the window that shows a change best, its length [s], its change of power
    STRETCH,
    MATERIAL,
    TOTAL_TIME,  # since the last change: time; squared, absolute, signed residual; energy
    TOTAL_SQUARES,
    TOTAL_ABSOLUTE,
    TOTAL_RESIDUAL,
    TOTAL_MEASURED,
    SCALARS,
) = range(22)
# Settings.
MEMORY, NOISE_MEMORY, THRESHOLD, LEAST_MATERIAL, SETTINGS = range(5)

CLIP = 4.0
"""Standard deviations beyond which a residual pulls no harder."""

BLOCK = 5.0
"""Length of the blocks that tell the correlation of the residual [s]."""

TICK = 0.25
"""Driving time between two looks for a change [s]."""

LONGEST = 32
"""Ticks in the longest window; the others are a half, a quarter and an eighth of it."""

_IDLE = 0.01
"""Share of the usual excitation below which a sample tells nothing."""

_BEST_OF_FOUR = 1.7
"""Mean of the largest of the windows' statistics, over the number of coefficients."""

_RIDGE = 1e-6


@njit
def inverse(matrix: FloatTable, result: FloatTable) -> None:
    """Invert a small positive definite matrix, by Gauss and Jordan without pivoting."""
    p = len(matrix)
    work = matrix.copy()
    for i in range(p):
        for j in range(p):
            result[i, j] = 1.0 if i == j else 0.0
    for i in range(p):
        pivot = 1.0 / work[i, i]
        for j in range(p):
            work[i, j] *= pivot
            result[i, j] *= pivot
        for k in range(p):
            factor = work[k, i]
            if k != i and factor != 0.0:
                for j in range(p):
                    work[k, j] -= factor * work[i, j]
                    result[k, j] -= factor * result[i, j]


@njit
def _form(left: Column, matrix: FloatTable, right: Column) -> float:
    """Bilinear form ``left' matrix right``."""
    total = 0.0
    for i in range(len(left)):
        for j in range(len(right)):
            total += left[i] * matrix[i, j] * right[j]
    return total


@njit
def look(matrices: FloatBlock, vectors: FloatTable, ring: FloatTable, scalars: Floats) -> None:
    """Test the residuals of the last 1, 2, 4 and 8 s for a change of the coefficients.

    The score test: what the residuals say about the coefficients is compared with the variance
    that correlated noise and the coefficients' own uncertainty give it.
    """
    p = vectors.shape[1]
    covariance = matrices[COVARIANCE]
    ticks = int(scalars[TICKS])
    score, window, energy = np.zeros(p), np.zeros((p, p)), 0.0
    expected, solved = np.empty((p, p)), np.empty((p, p))
    scalars[STATISTIC] = scalars[MATERIAL] = scalars[STRETCH] = 0.0
    size = LONGEST // 8
    for age in range(min(ticks, LONGEST)):
        row = ring[(ticks - 1 - age) % LONGEST]
        for i in range(p):
            score[i] += row[i]
            for j in range(p):
                window[i, j] += row[p + i * p + j]
        energy += row[p + p * p]
        if age + 1 < size:
            continue
        size *= 2
        doubt = window @ covariance @ window
        ridge = 0.0
        for i in range(p):
            for j in range(p):
                expected[i, j] = scalars[REPEATS] * window[i, j] + doubt[i, j]
            ridge += _RIDGE * expected[i, i] / p
        for i in range(p):
            expected[i, i] += ridge
        inverse(expected, solved)
        statistic = _form(score, solved, score)
        if statistic <= scalars[STATISTIC]:
            continue
        # The change that the window shows, for a prior of unit information.
        for i in range(p):
            for j in range(p):
                expected[i, j] = window[i, j] / scalars[REPEATS]
            expected[i, i] += 1.0
        inverse(expected, solved)
        vectors[SHIFT] = solved @ score / scalars[REPEATS]
        change = _form(vectors[SHIFT], window, vectors[SHIFT]) * scalars[VARIANCE]
        scalars[STATISTIC] = statistic
        scalars[STRETCH] = (age + 1) * TICK
        scalars[MATERIAL] = np.sqrt(change / max(energy, 1e-300))


@njit
def advance(
    phi: Column,
    power: float,
    dt: float,
    matrices: FloatBlock,
    vectors: FloatTable,
    ring: FloatTable,
    scalars: Floats,
    settings: Floats,
) -> bool:
    """Take in one sample."""
    p = len(phi)
    information, covariance, c = matrices[INFORMATION], matrices[COVARIANCE], vectors[COEFFICIENTS]
    residual, excitation = power, 0.0
    for i in range(p):
        residual -= phi[i] * c[i]
        excitation += phi[i] * phi[i]
    scalars[TOTAL_TIME] += dt
    scalars[TOTAL_SQUARES] += residual * residual * dt
    scalars[TOTAL_ABSOLUTE] += abs(residual) * dt
    scalars[TOTAL_RESIDUAL] += residual * dt
    scalars[TOTAL_MEASURED] += power * dt
    # Old information fades into the prior's, so that it never fades to nothing.
    keep = np.exp(-dt / settings[MEMORY])
    for i in range(p):
        for j in range(p):
            information[i, j] *= keep
        information[i, i] += 1.0 - keep
    inverse(information, covariance)
    if excitation <= _IDLE * scalars[EXCITATION]:
        return False
    share = min(1.0, dt / settings[NOISE_MEMORY])
    scalars[EXCITATION] += share * (excitation - scalars[EXCITATION])

    variance = scalars[VARIANCE]
    doubt = _form(phi, covariance, phi)
    limit = CLIP * np.sqrt(variance + doubt)
    clipped = min(max(residual, -limit), limit)
    weight = 1.0 if clipped == residual else clipped / residual
    z = min(max(residual / np.sqrt(variance), -CLIP), CLIP)
    row = ring[LONGEST]
    for i in range(p):
        row[i] += phi[i] * z / np.sqrt(variance)
        for j in range(p):
            row[p + i * p + j] += phi[i] * phi[j] / variance
    row[p + p * p] += power * power

    # A sample counts as much as the correlation of its residual with its neighbours' leaves it.
    noise = variance * scalars[REPEATS]
    for i in range(p):
        for j in range(p):
            information[i, j] += weight * phi[i] * phi[j] / noise
    inverse(information, covariance)
    after = power
    for i in range(p):
        for j in range(p):
            c[i] += covariance[i, j] * phi[j] * clipped / noise
    for i in range(p):
        after -= phi[i] * c[i]

    most = max(settings[NOISE_MEMORY] / max(dt, 1e-9), 2.0)
    scalars[SAMPLES] = min(scalars[SAMPLES] + 1.0, most)
    scalars[VARIANCE] += (min(after * after, limit * limit) - variance) / scalars[SAMPLES]
    if doubt < variance:  # else the residual is mostly that of coefficients yet to be found
        scalars[BLOCK_SUM] += z
        scalars[BLOCK_SQUARES] += z * z
        scalars[BLOCK_TIME] += dt
    if scalars[BLOCK_TIME] >= BLOCK:
        fade = np.exp(-scalars[BLOCK_TIME] / settings[NOISE_MEMORY])
        scalars[BLOCKS] = fade * scalars[BLOCKS] + 1.0
        share = 1.0 / scalars[BLOCKS]
        scalars[MEAN_SIZE] += share * (abs(scalars[BLOCK_SUM]) - scalars[MEAN_SIZE])
        scalars[MEAN_SQUARES] += share * (scalars[BLOCK_SQUARES] - scalars[MEAN_SQUARES])
        # By the mean size, not the mean square: one block across a change must not count much.
        spread = 0.5 * np.pi * scalars[MEAN_SIZE] ** 2
        scalars[REPEATS] = max(spread / max(scalars[MEAN_SQUARES], 1e-300), 1.0)
        scalars[BLOCK_SUM] = scalars[BLOCK_SQUARES] = scalars[BLOCK_TIME] = 0.0

    scalars[TICK_TIME] += dt
    if scalars[TICK_TIME] < TICK - 1e-9:
        return False
    ring[int(scalars[TICKS]) % LONGEST] = row
    row[:] = 0.0
    scalars[TICK_TIME] = 0.0
    scalars[TICKS] += 1.0
    look(matrices, vectors, ring, scalars)
    # Where the model is not quite right, the statistic is large from time to time on any ground.
    bound = settings[THRESHOLD] * max(scalars[LEVEL], 1.0)
    usual = min(scalars[STATISTIC], bound) / (_BEST_OF_FOUR * p)
    scalars[LEVEL] += TICK / settings[NOISE_MEMORY] * (usual - scalars[LEVEL])
    return bool(scalars[STATISTIC] > bound and scalars[MATERIAL] > settings[LEAST_MATERIAL])


@njit
def restart(matrices: FloatBlock, vectors: FloatTable, ring: FloatTable, scalars: Floats) -> None:
    """Forget all but the coefficients and the noise."""
    p = vectors.shape[1]
    matrices[:] = 0.0
    for i in range(p):
        matrices[INFORMATION, i, i] = matrices[COVARIANCE, i, i] = 1.0
    vectors[SHIFT] = 0.0
    ring[:] = 0.0
    scalars[BLOCK_SUM:SCALARS] = 0.0


@njit
def advance_all(
    design: AnyTable,
    power: Column,
    dt: Column,
    matrices: FloatBlock,
    vectors: FloatTable,
    ring: FloatTable,
    scalars: Floats,
    settings: Floats,
) -> int:
    """Take in samples up to and with one that reveals a change."""
    for k in range(len(power)):
        if advance(design[k], power[k], dt[k], matrices, vectors, ring, scalars, settings):
            return k
    return len(power)
