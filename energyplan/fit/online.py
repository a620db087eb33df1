"""Parameters while driving: recursive estimation of the power model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import fsum

import numpy as np
from scipy.stats import chi2

from energyplan.compilation import AnyTable, Column, FloatBlock, Floats, FloatTable, inner, njit
from energyplan.errors import InvalidInputError, MissingChannelError
from energyplan.fit.doubts import energy_error, is_linear, linearise
from energyplan.fit.drive import Drive
from energyplan.fit.identification import without_each
from energyplan.logs import DriveLog
from energyplan.motion import Motion
from energyplan.path import FloatArray
from energyplan.power import SLIP, TRACTION, PowerModel, Residual, Sides, Term
from energyplan.records import checked, described
from energyplan.vehicle import Vehicle

# -- one step of recursive identification: robust, forgetting, watching for change -----------------

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
MEMORY, NOISE_MEMORY, THRESHOLD, LEAST_MATERIAL, LEAST_VARIANCE, SETTINGS = range(6)

CLIP = 4.0
"""Standard deviations beyond which a residual pulls no harder."""

BLOCK = 5.0
"""Length of the blocks that the correlation of the residual is estimated from [s]."""

TICK = 0.25
"""Driving time between two looks for a change [s]."""

LONGEST = 32
"""Ticks in the longest window; the others are a half, a quarter and an eighth of it."""

_UNEXCITED = 0.01  # share of the typical excitation below which a sample is not used

_BEST_OF_FOUR = 1.7
"""Mean of the largest of the windows' statistics, over the number of coefficients."""

_RIDGE = 1e-6


@inner
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


@inner
def _form(left: Column, matrix: FloatTable, right: Column) -> float:
    """Bilinear form ``left' matrix right``."""
    total = 0.0
    for i in range(len(left)):
        for j in range(len(right)):
            total += left[i] * matrix[i, j] * right[j]
    return total


@inner
def look(matrices: FloatBlock, vectors: FloatTable, ring: FloatTable, scalars: Floats) -> None:
    """Test the residuals of the last 1, 2, 4 and 8 s for a change of the coefficients."""
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


@inner
def _learn_noise(
    z: float, square: float, uncertainty: float, dt: float, scalars: Floats, settings: Floats
) -> None:
    """Learn the residual's variance, and how many samples repeat each other, from one sample."""
    variance = scalars[VARIANCE]
    most = max(settings[NOISE_MEMORY] / max(dt, 1e-9), 2.0)
    scalars[SAMPLES] = min(scalars[SAMPLES] + 1.0, most)
    learned = variance + (square - variance) / scalars[SAMPLES]
    scalars[VARIANCE] = max(learned, settings[LEAST_VARIANCE])
    if uncertainty < variance:  # else the residual is mostly that of coefficients yet to be found
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


@inner
def _total(residual: float, power: float, dt: float, scalars: Floats) -> None:
    """Add a sample to the sums since the last change."""
    scalars[TOTAL_TIME] += dt
    scalars[TOTAL_SQUARES] += residual * residual * dt
    scalars[TOTAL_ABSOLUTE] += abs(residual) * dt
    scalars[TOTAL_RESIDUAL] += residual * dt
    scalars[TOTAL_MEASURED] += power * dt


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
    _total(residual, power, dt, scalars)
    # Old information fades into the prior's, so that it never fades to nothing.
    keep = np.exp(-dt / settings[MEMORY])
    for i in range(p):
        for j in range(p):
            information[i, j] *= keep
        information[i, i] += 1.0 - keep
    inverse(information, covariance)
    if excitation <= _UNEXCITED * scalars[EXCITATION]:
        return False
    share = min(1.0, dt / settings[NOISE_MEMORY])
    scalars[EXCITATION] += share * (excitation - scalars[EXCITATION])

    variance = scalars[VARIANCE]
    uncertainty = _form(phi, covariance, phi)
    limit = CLIP * np.sqrt(variance + uncertainty)
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

    _learn_noise(z, min(after * after, limit * limit), uncertainty, dt, scalars, settings)
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
    level = min(scalars[STATISTIC], bound) / (_BEST_OF_FOUR * p)
    scalars[LEVEL] += TICK / settings[NOISE_MEMORY] * (level - scalars[LEVEL])
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


# -- recursive identification while driving, and detection of a change of ground -------------------

_TYPICAL = {"N": 0.7, "W": 0.15, "kg": 0.7}
"""Order of magnitude of coefficients by unit and kilogram of the vehicle, where none is known."""

_FRICTION = 0.5  # the same of what does not grow with the vehicle
_NOISE = 0.07  # of the power, by kilogram of the vehicle, where nothing is known [W/kg]
_FINEST = 1e-4  # of that noise: no meter is better, and residuals that are all zero show nothing
_NOISE_MEMORY = 120.0
_CORRELATION_TIME = 0.5  # of the residual, until the drive shows its own [s]

_FEWEST = 3  # former runs from which the share that the rest of a run keeps is estimated
_SHARES = 21  # values of that share
_DRAWS = 200  # of the Bayesian bootstrap
_EXACT = 1e-6  # relative error that is none
_IDLE = 0.1  # share of the typical power, up to which a part of a run is not used

_RAMP_TIME = 0.15  # time constant of the filter that accelerations of single samples come from [s]


@dataclass(frozen=True)
class SurfaceChange:
    """A change of the coefficients that came too fast for forgetting."""

    t: float  # when it was detected [s]
    onset: float  # about when it happened [s]
    statistic: float  # how clear it is
    before: PowerModel  # the model up to then


@dataclass(frozen=True)
class RunMemory:
    """How much of a run's departure from former runs the rest of it keeps."""

    share: float  # of the logarithm of measured over predicted energy, in [0, 1]
    quarter: float  # typical energy of the first quarter of a run [J]

    @classmethod
    def of(cls, logs: Sequence[DriveLog], model: PowerModel) -> RunMemory:
        """Learn it from former runs, each predicted from the others by the model's terms."""
        usual = 0.25 * float(np.median([log.energy for log in logs])) if logs else np.inf
        known = _departures(logs, model) if len(logs) >= _FEWEST else np.zeros((0, 2))
        if not len(known):
            return cls(0.0, usual)
        shares = np.linspace(0.0, 1.0, _SHARES)
        missed = np.abs(np.expm1(shares * known[:, :1] - known[:, 1:]))
        weights = np.random.default_rng(0).dirichlet(np.ones(len(known)), _DRAWS)
        odds = -len(known) * np.log(weights @ missed + _EXACT)
        odds[:, 0] += np.log(_SHARES - 1) + 1.0
        chance = np.exp(odds - odds.max(axis=1, keepdims=True))
        chance /= chance.sum(axis=1, keepdims=True)
        return cls(float(np.mean(chance @ shares)), usual)

    def factor(self, measured: float, predicted: float) -> float:
        """Factor of the rest's energy, from energies so far [J]; little driving shows little."""
        if not (measured > 0.0 and predicted > 0.0 and self.quarter > 0.0):
            return 1.0
        shown = min(measured / self.quarter, predicted / self.quarter, 1.0)
        return float((measured / predicted) ** (self.share * shown))


def _departures(logs: Sequence[DriveLog], model: PowerModel) -> FloatArray:
    """Logarithms of measured over predicted energy: of first quarter and rest, (runs, 2)."""
    drives = [Drive.of(log, model.vehicle) for log in logs]
    usual = sum(log.energy for log in logs) / sum(log.duration for log in logs)
    found = []
    for drive, power in zip(drives, without_each(drives, model), strict=True):
        first = drive.t <= 0.25 * drive.t[-1]
        parts = [
            (float(drive.weights[some] @ p[some])) for some in (first, ~first)
            for p in (drive.power, power)
        ]  # fmt: skip
        time = [float(drive.weights[some].sum()) for some in (first, ~first) for _ in range(2)]
        if all(e > _IDLE * usual * t for e, t in zip(parts, time, strict=True)):
            found.append((np.log(parts[0] / parts[1]), np.log(parts[2] / parts[3])))
    return np.array(found).reshape(-1, 2)


def _typical(term: Term, vehicle: Vehicle) -> float:
    """Order of magnitude of a term's coefficient on a vehicle."""
    if term.unit in _TYPICAL:
        return _TYPICAL[term.unit] * vehicle.mass
    return _FRICTION if term.unit == "1" else 1.0


class OnlineIdentifier:
    """Identifies a power model sample by sample.

    This is recursive least squares in information form, with three precautions. Old information
    fades towards that of the prior, so a coefficient that the drive does not excite becomes
    uncertain, but not wrong. A residual counts as four standard deviations at most. And a sample
    counts only as much as the correlation of the residual allows, so that the covariance holds.

    Four times a second the residuals of the last 1, 2, 4 and 8 s of driving are tested for a change
    of the coefficients, with the variance of correlated noise and of the coefficients themselves.
    After a change the coefficients start again, from a wide prior about what the test found.

    Parameters
    ----------
    prior : PowerModel or Vehicle
        Where to start: a model, with the covariance that it has, or a vehicle of which nothing is
        known.
    terms : sequence of Term
        The terms, where only a vehicle is given.
    memory : float
        Time over which old samples are forgotten on one surface [s].
    false_alarms : float
        Changes per hour of driving that may be reported where there is none.
    material : float
        Least relative change of power that counts as a change of surface.
    spread : float
        Standard deviation of a coefficient on an unknown surface, as a fraction of its value.
    battery : bool
        Whether the power that will be given was measured at the battery.
    period : float, optional
        Time between samples [s]; if not given, that of the first two samples or of the first log.

    Raises
    ------
    InvalidInputError
        If a setting is out of range.

    References
    ----------
    Morales et al. (2010), section V; Kulhavy and Zarrop (1993), "On a general concept of
    forgetting", Int. J. Control 58; Basseville and Nikiforov (1993), Detection of Abrupt Changes.

    Examples
    --------
    >>> from energyplan import simulate
    >>> marble = PowerModel.preset("quadriga:full:marble")
    >>> concrete = PowerModel.preset("quadriga:full:concrete")
    >>> log = simulate.drive(marble, "survey", changes=[(30.0, concrete)], power_noise=3.0)
    >>> online = OnlineIdentifier(marble)
    >>> [change] = online.run(log)
    >>> 30.0 < change.t < 40.0
    True
    """

    @checked()
    def __init__(
        self,
        prior: PowerModel | Vehicle,
        *,
        terms: Sequence[Term] = (SLIP, TRACTION),
        memory: float = 300.0,
        false_alarms: float = 1e-3,
        material: float = 0.05,
        spread: float = 0.5,
        battery: bool = False,
        period: float | None = None,
    ) -> None:
        settings = {"memory": memory, "false_alarms": false_alarms, "spread": spread}
        if period is not None:
            settings["period"] = period
        for label, value in settings.items():
            if not (np.isfinite(value) and value > 0):
                raise InvalidInputError(f"{label} is {value}; give a positive number")
        if not 0 <= material < 1:
            raise InvalidInputError(f"material is {material}; give a fraction in [0, 1)")
        if isinstance(prior, PowerModel):
            self._model = prior
        else:
            values = [np.clip(_typical(term, prior), *term.bounds) for term in terms]
            self._model = PowerModel(prior, tuple(terms), np.array(values), name="online")
        self._battery, self._spread = battery, spread
        self._linear = is_linear(self._model.battery_side() if battery else self._model)
        self._filtered = np.full(2, np.nan)
        self._needed = {name for term in self._model.terms for name in term.channels}
        p = len(self._model.terms)
        self._ramps = bool(self._needed & {"accel", "yaw_accel"})
        # Looks are not independent, so that this bounds the rate of false alarms.
        threshold = float(chi2.isf(false_alarms * TICK / 3600.0, p))
        finest = (_FINEST * _NOISE * self._model.vehicle.mass) ** 2
        self._settings = np.array([memory, _NOISE_MEMORY, threshold, material, finest])
        self._matrices, self._vectors = np.zeros((2, p, p)), np.zeros((2, p))
        self._ring = np.zeros((LONGEST + 1, p + p * p + 1))
        self._scalars = np.zeros(SCALARS)
        self._t, self._changes = np.nan, list[SurfaceChange]()
        self._period = np.nan
        self._start()
        if period is not None:
            self._begin(-np.inf, period)

    def _start(self) -> None:
        """Set the state from the prior model."""
        model = self._model
        self._unit = self._units(model.coefficients)
        restart(self._matrices, self._vectors, self._ring, self._scalars)
        self._vectors[COEFFICIENTS] = model.coefficients / self._unit
        if model.covariance is not None:
            scaled = model.covariance / np.outer(self._unit, self._unit)
            # A prior surer than any log could make it would never learn.
            scaled = scaled + 1e-8 * np.eye(len(self._unit))
            self._matrices[INFORMATION] = np.linalg.inv(scaled)
            self._matrices[COVARIANCE] = scaled
        known = model.residual is not None and model.residual.rmse > 0
        noise = (
            model.residual.rmse
            if model.residual is not None and known
            else _NOISE * model.vehicle.mass
        )
        self._scalars[VARIANCE] = noise**2
        # A guess that fits a robot of some size says little about another.
        self._scalars[SAMPLES] = 40.0 if known else 2.0

    def _units(self, coefficients: FloatArray) -> FloatArray:
        """Prior standard deviations."""
        typical = [_typical(term, self._model.vehicle) for term in self._model.terms]
        size = np.maximum(np.abs(coefficients), 0.2 * np.array(typical))
        return np.asarray(self._spread * size)

    def _begin(self, t: float, period: float) -> None:
        """Set the sample period, in which the correlation of the noise is expressed."""
        self._t, self._period = t - period, period
        residual = self._model.residual
        time = residual.correlation_time if residual else 0.0
        repeats = max(2.0 * (time if time > 0 else _CORRELATION_TIME) / period, 1.0)
        self._scalars[REPEATS] = repeats
        count = BLOCK / period
        self._scalars[BLOCKS] = 4.0
        self._scalars[MEAN_SIZE] = np.sqrt(2.0 / np.pi * repeats * count)
        self._scalars[MEAN_SQUARES] = count

    # -- samples --------------------------------------------------------------------------------

    def update(
        self, t: float, v_left: float, v_right: float, power: float, **channels: float
    ) -> bool:
        """Take in one sample.

        Parameters
        ----------
        t : float
            Time [s].
        v_left, v_right : float
            Tread speeds [m/s].
        power : float
            Measured power [W].
        **channels : float
            Further channels that the model's terms need, such as ``slope``. ``accel`` and
            ``yaw_accel`` follow from the speeds where they are not given.

        Returns
        -------
        bool
            Whether the sample reveals a change of surface; `changes` has details.

        Raises
        ------
        InvalidInputError
            If time does not increase or a value is not finite.
        MissingChannelError
            If a term needs a channel that is not given.
        """
        try:
            fsum((t, v_left, v_right, power, *channels.values()))
        except TypeError:
            given = ", ".join(map(described, (t, v_left, v_right, power, *channels.values())))
            raise InvalidInputError(f"a sample holds {given}; give one number of each") from None
        if not np.isfinite(v_left + v_right + power + t) or t <= self._t:
            raise InvalidInputError(
                f"sample at {t} s after {self._t} s: v_left {v_left}, v_right {v_right}, power "
                f"{power}; time must increase and every value be finite"
            )
        if np.isnan(self._period):
            if np.isnan(self._t):  # the first sample only sets the clock
                self._t = t
                return False
            self._begin(t, t - self._t)
        dt = min(t - self._t, 4.0 * self._period)
        if self._ramps:
            channels = {**self._accelerations(v_left, v_right, dt), **channels}
        phi, target = self._sample(v_left, v_right, power, channels)
        changed = advance(
            phi, target, dt, self._matrices, self._vectors, self._ring, self._scalars,
            self._settings,
        )  # fmt: skip
        self._t = t
        if changed:
            self._change()
        return bool(changed)

    def _accelerations(self, v_left: float, v_right: float, dt: float) -> dict[str, float]:
        """Rates of change of the speeds, by the lag of a first-order filter behind them."""
        speeds, icr = np.array([v_left, v_right]), self._model.vehicle.icr
        if np.isnan(self._filtered[0]):
            self._filtered = speeds
        self._filtered = speeds + (self._filtered - speeds) * np.exp(-dt / _RAMP_TIME)
        # In a steady ramp the filter lags by this much for each unit of acceleration.
        left, right = (speeds - self._filtered) * np.expm1(dt / _RAMP_TIME) / dt
        return {
            "accel": float((icr.right * left + icr.left * right) / icr.slip_track),
            "yaw_accel": float((right - left) / icr.slip_track),
        }

    def _sample(
        self, v_left: float, v_right: float, power: float, channels: dict[str, float]
    ) -> tuple[FloatArray, float]:
        """Regressors in prior units, and the power that they are to explain."""
        missing = self._needed - channels.keys()
        if missing:
            raise MissingChannelError(f"a term needs {', '.join(sorted(missing))} in each sample")
        if not self._linear:
            motion = Motion(
                np.array([v_left]), np.array([v_right]), self._model.vehicle.icr,
                {name: np.array([value]) for name, value in channels.items()},
            )  # fmt: skip
            design, target = self._linearised(motion, np.array([power]))
            return design[0], float(target[0])
        left, right = np.float64(v_left), np.float64(v_right)
        # A checked construction of the motion would take longer than all the rest.
        motion = object.__new__(Motion)
        known = {name: np.float64(value) for name, value in channels.items()}
        vars(motion).update(v_left=left, v_right=right, icr=self._model.vehicle.icr, channels=known)
        phi = np.empty(len(self._unit))
        for k, term in enumerate(self._model.terms):
            value = term.function(motion, self._model.vehicle, **term.params)
            if isinstance(value, Sides):
                value = value.left * left + value.right * right
            phi[k] = value * self._unit[k]
        return phi, power

    def _linearised(self, motion: Motion, power: FloatArray) -> tuple[FloatArray, FloatArray]:
        coefficients = self._vectors[COEFFICIENTS] * self._unit
        model = self._model.with_coefficients(coefficients)
        known = linearise(model, motion, self._battery)
        columns = known.columns[:, 0]
        target = power - known.power[:, 0] + columns @ coefficients
        return columns * self._unit, target

    @checked()
    def run(self, log: DriveLog) -> tuple[SurfaceChange, ...]:
        """Take in a log, sample by sample, as it would have come in while driving.

        Speeds are used as they are: unlike `identify`, it cannot separate noise at rest from
        creeping.

        Parameters
        ----------
        log : DriveLog
            The drive; it follows what came before, whatever its clock says.

        Returns
        -------
        tuple of SurfaceChange
            Changes in this log, in the log's time.

        Raises
        ------
        MissingChannelError
            If a term needs a channel that the log lacks.
        """
        motion = log.motion(self._model.vehicle.icr)
        period = float(np.median(np.diff(log.t)))
        if np.isnan(self._period):
            self._begin(float(log.t[0]), period)
        dt = np.minimum(np.diff(log.t, prepend=log.t[0] - period), 4.0 * period)
        known, first = len(self._changes), 0
        # Where the model is not linear it is linearised anew every second.
        step = len(log) if self._linear else max(1, round(1.0 / period))
        while first < len(log):
            last = min(first + step, len(log))
            part = Motion(
                motion.v_left[first:last], motion.v_right[first:last], motion.icr,
                {name: values[first:last] for name, values in motion.channels.items()},
            )  # fmt: skip
            design, target = self._linearised(part, log.power[first:last])
            found = advance_all(
                design, target, dt[first:last], self._matrices, self._vectors, self._ring,
                self._scalars, self._settings,
            )  # fmt: skip
            if found < last - first:
                self._t = float(log.t[first + found])
                self._change()
                last = first + found + 1
            first = last
        self._t = float(log.t[-1])
        return tuple(self._changes[known:])

    def _change(self) -> None:
        """Note a change and start afresh from a wide prior about the last coefficients."""
        before, scalars = self.model, self._scalars
        onset = self._t - float(scalars[STRETCH])
        statistic = float(scalars[STATISTIC])
        self._changes.append(SurfaceChange(self._t, onset, statistic, before))
        found = self._bounded(self._vectors.sum(axis=0) * self._unit)
        self._unit = self._units(np.maximum(np.abs(found), np.abs(before.coefficients)))
        restart(self._matrices, self._vectors, self._ring, scalars)
        self._vectors[COEFFICIENTS] = found / self._unit

    def _bounded(self, coefficients: FloatArray) -> FloatArray:
        bounds = np.array([term.bounds for term in self._model.terms])
        return np.asarray(np.clip(coefficients, *bounds.T))

    # -- what is known --------------------------------------------------------------------------

    @property
    def changes(self) -> tuple[SurfaceChange, ...]:
        """Changes of surface so far."""
        return tuple(self._changes)

    @property
    def model(self) -> PowerModel:
        """The model as it is known now, with covariance; a coefficient stays within its bounds."""
        values = self._bounded(self._vectors[COEFFICIENTS] * self._unit)
        covariance = self._matrices[COVARIANCE] * np.outer(self._unit, self._unit)
        covariance = 0.5 * (covariance + covariance.T)
        model = self._model.with_coefficients(values, covariance)
        time = self._scalars[TOTAL_TIME]
        if not time > 0:
            return model
        missing, measured = (self._scalars[k] for k in (TOTAL_RESIDUAL, TOTAL_MEASURED))
        residual = Residual(
            rmse=float(np.sqrt(self._scalars[TOTAL_SQUARES] / time)),
            mae=float(self._scalars[TOTAL_ABSOLUTE] / time),
            bias=float(missing / time),
            energy_error=energy_error(float(missing), float(measured)),
            correlation_time=float(0.5 * self._scalars[REPEATS] * self._period),
            duration=float(time),
            run_spread=self._model.residual.run_spread if self._model.residual else None,
        )
        return PowerModel(
            model.vehicle, model.terms, values, covariance, residual, self._model.name
        )
