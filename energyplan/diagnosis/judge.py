"""A set of effects as a model, and whether it holds on drives that took no part (private).

All parameters are fitted together, what the model leaves is tested, and errors and energies of
other drives come with intervals.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np
from scipy.optimize import least_squares
from scipy.stats import f as fisher
from scipy.stats import norm

from energyplan.diagnosis.candidates import Part, settle_change, terms_of
from energyplan.diagnosis.residual import Dependence, dependences
from energyplan.diagnosis.result import (
    EnergyPrediction,
    ErrorInterval,
    Evidence,
    FoundEffect,
    Unexplained,
)
from energyplan.diagnosis.search import SIGNIFICANCE, EffectSet, Gain
from energyplan.errors import VehicleError
from energyplan.fit.contacts import Held, preload
from energyplan.fit.doubts import (
    Adequacy,
    adequacy,
    left_over,
    predicted,
    shown_of_contacts,
    statistics,
)
from energyplan.fit.drive import BLOCK, DELAYS, Drive, Late, channels_of, cut
from energyplan.fit.estimate import (
    Fitted,
    Problem,
    joint_fit,
)
from energyplan.fit.regressors import (
    equations_of,
    held_forces,
    is_lossy,
    losses_of,
    slip_limit,
)
from energyplan.fit.run import RunEffect
from energyplan.path import FloatArray
from energyplan.power import USUAL_RUN_SPREAD, PowerModel, Residual
from energyplan.power.effects import WHEEL_FIGHT, Effect, empirical_term
from energyplan.vehicle import GRAVITY, Vehicle, wheel_loads

# -- errors on drives that were held out, with intervals -------------------------------------------

_RESAMPLES = 400


@dataclass(frozen=True)
class Prediction:
    """Predicted power of a drive."""

    drive: Drive  # the drive, in the states that it was in
    power: FloatArray  # (n,): predicted power [W]
    change: float | None = None  # when it changed state [s]


def predict(
    model: PowerModel, parts: Sequence[Part], drive: Drive, *, dated: bool = True
) -> Prediction:
    """Predict a drive; when it changed state is found on the drive itself."""
    for part in parts:
        if part.effect.delays:
            drive = replace(drive, late=Late.of(part.params))
    steps = [
        k for k, term in enumerate(model.terms) if term.name in ("slip_change", "traction_change")
    ]
    if not steps:
        return Prediction(drive, predicted(model, drive))
    if not dated:
        after = drive.with_channels(changed=np.ones(len(drive.t)))
        return Prediction(after, predicted(model, after))
    settled = settle_change(
        drive,
        predicted(model, drive.with_channels(changed=np.zeros(len(drive.t)))),
        [model.terms[k] for k in steps],
        model.coefficients[steps],
        model.vehicle,
    )
    changed = settled.motion.channels["changed"]
    at = np.flatnonzero(np.diff(changed))
    time = float(drive.t[at[0] + 1]) if len(at) else None
    return Prediction(settled, predicted(model, settled), time)


def score(predictions: Sequence[Prediction]) -> Residual:
    """Return the statistics of measured minus predicted power."""
    return statistics([one.drive for one in predictions], [one.power for one in predictions])


def interval(predictions: Sequence[Prediction], seed: int = 0) -> ErrorInterval:
    """Return 95 % intervals of the statistics by resampling blocks of driving."""
    rows = []
    for one in predictions:
        block = cut(one.drive.t, BLOCK)
        r = one.drive.power - one.power
        dt = one.drive.weights
        values = np.column_stack(
            [np.ones(len(r)), r**2, np.abs(r), r, one.drive.power * dt, one.power * dt]
        )
        sums = np.zeros((int(block.max()) + 1, values.shape[1]))
        np.add.at(sums, block, values)
        rows.append(sums[sums[:, 0] > 0])  # none of a gap
    table = np.concatenate(rows)
    draws = np.random.default_rng(seed).integers(0, len(table), (_RESAMPLES, len(table)))
    n, square, absolute, plain, measured, predicted = table[draws].sum(axis=1).T
    with_energy = np.where(measured != 0, measured, 1.0)
    samples = (np.sqrt(square / n), absolute / n, plain / n, predicted / with_energy - 1.0)
    ends = [np.quantile(values, [0.025, 0.975]) for values in samples]
    return ErrorInterval(*((float(low), float(high)) for low, high in ends))


# -- centre of mass from the way the robot moves ---------------------------------------------------

_MOST_SAMPLES = 500
_ROUNDS = 40
_SOFTENING = 1e-3  # slip speed below which friction is not fully developed [m/s]
_LEAST_OFFSET = 0.01  # centre of mass that is as good as centred [m]


@dataclass(frozen=True)
class MassCentre:
    """Centre of mass in the body frame."""

    forward: float  # x in the body frame [m]
    left: float  # y in the body frame [m]
    covariance: FloatArray  # (2, 2): of both [m^2], allowing for correlation within blocks
    improvement: float
    improvement_error: float
    p_value: float  # of a centred mass

    def effect(self, entry: Effect) -> FoundEffect:
        """Return it as an effect of a diagnosis."""
        offset = np.array([self.forward, self.left])
        size = float(np.hypot(*offset))
        along = offset / size
        return FoundEffect(
            entry.name, entry.symbol, size, entry.unit,
            float(np.sqrt(along @ self.covariance @ along)),
            Evidence(self.improvement, self.improvement_error, self.p_value),
            1.0 - self.p_value,
            (),
            {
                "forward": self.forward, "left": self.left,
                "forward_std_error": float(np.sqrt(self.covariance[0, 0])),
                "left_std_error": float(np.sqrt(self.covariance[1, 1])),
            },
            entry.meaning, entry.planner,
        )  # fmt: skip

    @property
    def found(self) -> bool:
        """Whether the offset is real, matters, and explains how the robot moves."""
        return (
            self.p_value < 1e-3
            and float(np.hypot(self.forward, self.left)) > _LEAST_OFFSET
            and self.improvement > max(0.2, 2 * self.improvement_error)
        )


def twist(
    vehicle: Vehicle, shares: FloatArray, left: FloatArray, right: FloatArray, lateral: FloatArray
) -> FloatArray:
    """Forward, sideways and yaw speed that lose the least power to friction."""
    x, y = vehicle.contacts.T
    tread = np.where(y > 0, left[:, None], right[:, None])
    ahead = np.stack([np.ones_like(x), np.zeros_like(x), -y], axis=1)
    aside = np.stack([np.zeros_like(x), np.ones_like(x), x], axis=1)
    both = ahead[:, :, None] * ahead[:, None] + aside[:, :, None] * aside[:, None]
    found = np.column_stack(
        [0.5 * (left + right), 0.0 * left, (right - left) / vehicle.icr.slip_track]
    )
    for _ in range(_ROUNDS):
        slip = np.hypot(found @ ahead.T - tread, found @ aside.T)
        weight = shares / np.hypot(slip, _SOFTENING)
        matrix = (weight @ both.reshape(-1, 9)).reshape(-1, 3, 3)
        target = (weight * tread) @ ahead
        target[:, 1] -= lateral
        before, found = found, np.linalg.solve(matrix, target[..., None])[..., 0]
        if np.max(np.abs(found - before)) < 1e-6:
            break
    return np.asarray(found)


def find_mass_centre(drives: Sequence[Drive], vehicle: Vehicle, mu: float) -> MassCentre | None:
    """Find the centre of mass from pose and tread speeds."""
    if not all({"x", "y", "yaw"} <= set(drive.motion.channels) for drive in drives):
        return None
    data, blocks = _turning(drives)
    if len(data) < 50:
        return None
    left, right, measured = data[:, 0], data[:, 1], data[:, 2:]
    lateral = measured[:, 0] * measured[:, 2] / (max(mu, 0.05) * GRAVITY)

    def residual(offset: FloatArray) -> FloatArray:
        try:
            loads = wheel_loads(vehicle.contacts, vehicle.mass, offset)
        except VehicleError:
            return np.full(measured.size, 10.0)  # a wheel would lift off: no such robot
        shares = loads / loads.sum()
        return np.ravel(twist(vehicle, shares, left, right, lateral) - measured)

    fitted = least_squares(
        residual, [0.01, 0.01], loss="soft_l1", f_scale=0.01, diff_step=(1e-3, 1e-3)
    )
    rows = np.reshape(np.asarray(fitted.jac), (len(data), 3, 2))
    errors = residual(fitted.x).reshape(-1, 3)
    scores = np.einsum("nki,nk->ni", rows, errors / np.sqrt(1 + (errors / 0.01) ** 2))
    _, index = np.unique(blocks, return_inverse=True)
    count = int(index.max()) + 1
    sums = np.zeros((count, 2))
    np.add.at(sums, index, scores)
    bread = np.linalg.pinv(np.einsum("nki,nkj->ij", rows, rows))
    covariance = bread @ (sums.T @ sums) @ bread * count / max(count - 2, 1)
    squared = float(fitted.x @ np.linalg.pinv(covariance) @ fitted.x)
    centred = _symmetric_error(left, right, measured)
    gaps = np.zeros(count)
    np.add.at(gaps, index, centred - np.sum(errors**2, axis=1))
    total = float(np.sum(centred))
    return MassCentre(
        float(fitted.x[0]), float(fitted.x[1]), covariance,
        float(gaps.sum()) / max(total, 1e-300),
        float(np.sqrt(count) * gaps.std(ddof=1)) / max(total, 1e-300),
        float(fisher.sf(squared / 2, 2, max(count - 2, 1))),
    )  # fmt: skip


def _symmetric_error(left: FloatArray, right: FloatArray, measured: FloatArray) -> FloatArray:
    """Squared error of the twist of symmetric tread ICRs with the best slip track."""
    difference = right - left
    rate = difference * float(difference @ measured[:, 2]) / float(difference @ difference)
    predicted = np.column_stack([0.5 * (left + right), 0.0 * left, rate])
    return np.asarray(np.sum((predicted - measured) ** 2, axis=1))


def _turning(drives: Sequence[Drive]) -> tuple[FloatArray, FloatArray]:
    """Pick turning windows: tread speeds and body twist, and the block of each."""
    rows, blocks, first = [], [], 0
    for drive in drives:
        motion, t = drive.motion, drive.t
        yaw = np.unwrap(motion.channels["yaw"])
        width = drive.windows[0]
        speeds = np.column_stack(
            [
                motion.v_left, motion.v_right, np.gradient(motion.channels["x"], t),
                np.gradient(motion.channels["y"], t), np.gradient(yaw, t),
            ]
        )  # fmt: skip
        cos, sin = np.cos(yaw), np.sin(yaw)
        forward = cos * speeds[:, 2] + sin * speeds[:, 3]
        aside = cos * speeds[:, 3] - sin * speeds[:, 2]
        twist_ = np.column_stack([speeds[:, :2], forward, aside, speeds[:, 4]])
        means = width.mean(twist_)
        rows.append(means)
        blocks.append(first + (t[width.starts] // BLOCK))
        first += int(t[-1] // BLOCK) + 1
    data, block = np.concatenate(rows), np.concatenate(blocks)
    turning = np.abs(data[:, 1] - data[:, 0]) > 0.1
    data, block = data[turning], block[turning]
    step = max(len(data) // _MOST_SAMPLES, 1)
    return data[::step], block[::step]


# -- all parameters of an extended model fitted together, with their covariance --------------------

_STEP = 0.02  # relative step of a parameter's derivative
_MOMENT = 0.02  # step of a time offset [s]

_LOOKED_FOR = float(np.ptp(DELAYS) / np.sqrt(12.0))
"""Standard deviation of a delay anywhere among those looked for [s]: none is known less."""


def final_fit(problem: Problem, parts: Sequence[Part]) -> Fitted:
    """Fit the paper's terms and those of the parts together."""
    moved: dict[str, list[FloatArray]] = {}

    def further(values: Mapping[str, float]) -> Sequence[Sequence[FloatArray]]:
        moved.update(_derivatives(problem, parts, values))
        return list(moved.values())

    found = joint_fit(problem, terms_of(parts), further)
    names = [*moved]
    variances = dict(zip(names, np.diag(found.further).tolist(), strict=True))
    late = [k for k, name in enumerate(names) if name in Late._fields]
    if late:
        between = _between_samples(problem, moved[names[late[0]]])
        variances["late"] = float(found.further[np.ix_(late, late)].sum()) + between
        variances["delay"] += between
    errors = {name: float(np.sqrt(max(value, 0.0))) for name, value in variances.items()}
    for name in errors.keys() & {"delay", "late"}:
        errors[name] = min(errors[name], _LOOKED_FOR)
    return replace(found, errors=errors)


def _between_samples(problem: Problem, rise: Sequence[FloatArray]) -> float:
    """Return the variance of a delay that is due to what happens between samples [s^2]."""
    square = fourth = 0.0
    for drive, power in zip(problem.drives, rise, strict=True):
        size = power[:, 0] ** 2
        square += float(size.sum())
        fourth += float(np.sum((np.gradient(drive.t) * size) ** 2))
    return fourth / max(12.0 * square**2, 1e-300)


def _derivatives(
    problem: Problem, parts: Sequence[Part], values: Mapping[str, float]
) -> dict[str, list[FloatArray]]:
    """Differentiate the power by each searched parameter, on each drive."""
    found = {}
    for part in parts:
        if part.effect.delays:
            terms = terms_of(parts)
            whole = PowerModel(
                problem.vehicle, tuple(terms), np.array([values[term.name] for term in terms])
            )
            late = Late.of(part.params)
            for key, _ in late.params:
                ahead, behind = (
                    problem.delayed(late._replace(**{key: getattr(late, key) + step}))
                    for step in (_MOMENT, -_MOMENT)
                )
                found[key] = [
                    (equations_of(whole, a) - equations_of(whole, b)) / (2 * _MOMENT)
                    for a, b in zip(ahead.drives, behind.drives, strict=True)
                ]
        for key, value in part.params:
            if key not in part.effect.grid or not part.terms:
                continue
            step = _STEP * abs(value)
            ends = []
            for x in (value + step, value - step):
                moved = replace(
                    part, params=tuple((k, x if k == key else v) for k, v in part.params)
                )
                coefficients = np.array([values[term.name] for term in moved.terms])
                model = PowerModel(problem.vehicle, moved.terms, coefficients)
                ends.append([equations_of(model, drive) for drive in problem.drives])
            found[key] = [(a - b) / (2 * step) for a, b in zip(*ends, strict=True)]
    return found


def size_error(effect: Effect, model: PowerModel) -> float:
    """Return the standard error of an effect's size, from the covariance of the coefficients."""
    if model.covariance is None:
        return 0.0
    values = np.array(model.coefficients)
    gradient = np.zeros(len(values))
    for k, value in enumerate(values):
        step = 1e-5 * max(abs(float(value)), 1e-6)
        ends = []
        for x in (value + step, value - step):
            moved = values.copy()
            moved[k] = x
            ends.append(effect.value(replace(model, coefficients=moved)))
        gradient[k] = (ends[0] - ends[1]) / (2 * step)
    return float(np.sqrt(max(float(gradient @ model.covariance @ gradient), 0.0)))


# -- what it costs that the sides push against each other on straights -----------------------------

_WORTH = 0.01  # share of the energy from which it is reported
_FEWEST_RUNS = 3  # that show how much it differs; of fewer, it differs by as much as it is
_MOSTLY = 0.5  # share of it from which commands are its reason
_NEARLY_ALL = 0.9  # share of that, which corrections up to a size make


class Steering(NamedTuple):
    """How much of the heat arises while the command turns the way in which the sides push."""

    share: float  # of the heat
    correction: float  # yaw rate of the commands up to which nearly all of that arises [rad/s]

    @classmethod
    def of(cls, heat: FloatArray, moment: FloatArray, turn: FloatArray) -> Steering:
        """Compare heat [J] and moments of samples [N m] with the yaw rate of commands [rad/s]."""
        sign = np.sign(moment * turn)
        order = np.argsort(np.abs(turn))
        caused = np.cumsum(np.where(sign > 0.0, heat, 0.0)[order])
        last = int(np.searchsorted(caused, _NEARLY_ALL * caused[-1]))
        return cls(float(heat @ sign) / float(heat.sum()), float(np.abs(turn[order[last]])))

    @property
    def in_words(self) -> str:
        """Describe what to do."""
        if self.share < _MOSTLY:
            return (
                f"only {100 * max(self.share, 0.0):.0f} % of it while cmd_left and cmd_right turn "
                "the same way: no correction of the heading is behind it; compare the wheel radii "
                "and the speed controllers of both sides"
            )
        return (
            f"{100 * self.share:.0f} % of it while cmd_left and cmd_right correct the heading the "
            f"same way, nearly always by {self.correction:.2g} rad/s or less: a dead band that "
            "leaves such corrections out, or a slower servo, saves it"
        )


@dataclass(frozen=True)
class StraightHeat:
    """Heat of the moment between the sides, by second of straight driving."""

    rate: float  # mean over the runs [W]
    std_error: float  # by which a run to come differs from it [W]
    share: float  # share of the drives' energy that it takes
    model: PowerModel  # the model with the term
    steering: Steering | None  # what commands show of its reason, where they were logged

    @property
    def in_words(self) -> str:
        """How much it is, and what saves it."""
        unknown = (
            "as they do while the controller corrects the heading: a dead band of the heading of "
            "some 0.01 rad, or a slower servo, saves it; log cmd_left and cmd_right, which tell"
        )
        return (
            f"{100 * self.share:.2g} % of the energy, {self.rate:.2g} +- {self.std_error:.2g} W on "
            "straights, is heat of the two sides that push against each other, "
            f"{unknown if self.steering is None else self.steering.in_words}"
        )

    def effect(self, entry: Effect) -> FoundEffect:
        """Return it as an effect of a diagnosis."""
        chance = float(norm.sf(self.rate / max(self.std_error, 1e-12)))
        return FoundEffect(
            entry.name, entry.symbol, self.rate, entry.unit, self.std_error,
            Evidence(0.0, 0.0, chance), 1.0 - chance, (),
            {"share of the energy": self.share, **self._commanded}, entry.meaning, entry.planner,
        )  # fmt: skip

    @property
    def _commanded(self) -> dict[str, float]:
        if self.steering is None:
            return {}
        return {"share while steering": self.steering.share,
                "correction [rad/s]": self.steering.correction}  # fmt: skip


def straight_heat(problem: Problem, model: PowerModel) -> StraightHeat | None:
    """Find the heat that the measured moments between the sides make on straights."""
    vehicle, terms, values = problem.vehicle, model.terms, model.coefficients
    joules, seconds, samples = [], [], list[FloatArray]()
    commanded = {"cmd_left", "cmd_right"} <= channels_of(problem.drives)
    for drive in problem.drives:
        if drive.between is None or not is_lossy(drive, terms):
            return None
        losses = losses_of(drive, vehicle, terms, values)
        forces = held_forces(drive, vehicle, terms, values)
        limit = vehicle.slip_moment * slip_limit(terms, values)
        found = preload(drive, drive.between, vehicle, losses, forces, limit)
        # Where contacts hardly hold, a turn begins or ends: that costs friction of turning.
        moment = np.where(found.alone, 0.0, found.moment)[drive.holds]
        heat = Held.of(drive, vehicle, losses, forces).cost(moment)
        weights = (drive.weights * (drive.held.v_left != 0.0))[drive.holds]
        joules.append(float(weights @ heat))
        seconds.append(float(weights.sum()))
        if commanded:
            turn = drive.motion.channels["cmd_right"] - drive.motion.channels["cmd_left"]
            samples.append(
                np.array([weights * heat, moment, turn[drive.holds] / vehicle.icr.slip_track])
            )
    energy = sum(float(drive.weights @ drive.power) for drive in problem.drives)
    driven, time = np.array(seconds) > 0.0, np.array(seconds)
    if not sum(joules) > _WORTH * abs(energy):
        return None
    rate, count = sum(joules) / float(time.sum()), int(driven.sum())
    variance = rate**2
    if count >= _FEWEST_RUNS:
        apart = np.array(joules)[driven] / time[driven] - rate
        between = float(time[driven] @ apart**2 / time.sum()) * count / (count - 1)
        variance = between * (1.0 + 1.0 / count)
    extended = model.with_term(WHEEL_FIGHT, rate)
    if extended.covariance is not None:
        covariance = np.array(extended.covariance)
        covariance[-1, -1] = variance
        extended = extended.with_coefficients(extended.coefficients, covariance)
    steering = Steering.of(*np.concatenate(samples, axis=1)) if commanded else None
    return StraightHeat(rate, float(np.sqrt(variance)), sum(joules) / energy, extended, steering)


# -- which effects of the best explanation are named, and what the model with them leaves ---------

_ERRORS = 2.0  # standard errors that the size of a named effect exceeds
_MISSING = 2.0  # times what the model lacks, that an effect searched for in time or place exceeds
_TELLING = 0.1  # share of the error that a channel must explain to be called a reason

Why = Literal["range", "size", "missing"]
"""An effect is not named: its size is impossible, it is uncertain, or more than it is missing."""


@dataclass(frozen=True)
class Modelled:
    """A set of effects as a model, and what that leaves."""

    fitted: Fitted  # the model
    heat: StraightHeat | None
    quality: Adequacy  # what the model leaves, against noise

    @classmethod
    def of(
        cls, problem: Problem, parts: Sequence[Part], plain: PowerModel | None, heats: bool
    ) -> Modelled:
        """Fit the paper's terms and some effects; `plain` is the model without any."""
        fitted = final_fit(problem, parts)
        if not parts and plain is not None:
            fitted = replace(fitted, model=plain, assumed=())
        heat = straight_heat(problem, fitted.model) if heats else None
        if heat is not None:
            fitted = replace(fitted, model=heat.model)
        return cls(fitted, heat, adequacy(problem.drives, left_over(fitted.model, problem.drives)))


@dataclass(frozen=True)
class Judged:
    """The effects that are named, the model with them, and what that leaves."""

    effects: tuple[Part, ...]  # the effects
    dropped: list[tuple[Effect, Why]]  # those of the explanation that are not named
    added: Part | None  # A smooth term that the model has in addition to them
    model: Modelled
    dependences: tuple[Dependence, ...]  # how what the effects leave depends on every signal
    left: list[Dependence]  # those that are reasons
    first: Dependence | None  # the one that explains most, other than how drives differ

    @property
    def unexplained(self) -> tuple[Unexplained, ...]:
        """The reasons that are left, as a diagnosis reports them."""
        return tuple(
            Unexplained(
                one.channel, one.shape, one.explained_variance, one.p_value,
                self.added is not None and one is self.first,
            )
            for one in self.left
        )  # fmt: skip

    @property
    def parts(self) -> tuple[Part, ...]:
        """All that the model has in addition to the paper's terms."""
        return self.effects if self.added is None else (*self.effects, self.added)


def doubt(part: Part, gain: Gain, fitted: Fitted, missing: float) -> tuple[float, Why]:
    """Return how doubtful an effect is, from 1 on too much to name it, and why.

    `missing` is what the model lacks, over the root mean square power.
    """
    effect, model = part.effect, fitted.model
    found: list[tuple[float, Why]] = [(0.0, "size")]
    if part.terms:
        size, (low, high) = effect.value(model), effect.limits(model.vehicle)
        if not low <= size <= high:
            return np.inf, "range"
        found.append((_ERRORS * size_error(effect, model) / max(abs(size), 1e-300), "size"))
    # What is searched for at any time or place follows whatever else the model lacks.
    if effect.acts in ("change", "place") or (part.terms and effect.grid and not effect.usual):
        found.append((_MISSING * missing / max(gain.share, 1e-300), "missing"))
    return max(found)


def judged(
    best: EffectSet,
    *,
    choose: bool,
    plain: PowerModel | None,
    heats: bool,
    smooth: Callable[[Part], bool],
) -> Judged:
    """Name the effects of the best explanation that are sure, and test what they leave."""
    problem, parts, dropped = best.problem, best.parts, list[tuple[Effect, Why]]()
    power = float(np.sqrt(np.mean(np.concatenate([d.power**2 for d in problem.drives]))))
    now = Modelled.of(problem, parts, plain, heats)
    while choose and parts:
        missing = float(np.sqrt(max(now.quality.missing))) / max(power, 1e-300)
        doubts = [
            doubt(part, best.gains[best.parts.index(part)], now.fitted, missing) for part in parts
        ]
        (most, why), worst = max(zip(doubts, parts, strict=True), key=lambda one: one[0][0])
        if most < 1.0:
            break
        dropped.append((worst.effect, why))
        parts = tuple(part for part in parts if part is not worst)
        now = Modelled.of(problem, parts, plain, heats)
    tested = dependences(problem, terms_of(parts))
    left = [
        one for one in tested
        if one.p_value < SIGNIFICANCE and one.explained_variance > max(_TELLING, 2 * one.std_error)
        and not (one.channel == "drive" and one.values[0] <= USUAL_RUN_SPREAD)
    ]  # fmt: skip
    first = next((one for one in left if one.channel != "drive"), None)
    added = None
    if first is not None and first.knots:
        term = empirical_term(
            f"empirical_{first.carrier}_{first.channel}", first.knots, first.values
        )
        added = Part(Effect.of(term, planner="where it knows the channel"))
        added = added if smooth(added) else None
    if added is not None:
        now = Modelled.of(problem, (*parts, added), plain, heats)
    return Judged(parts, dropped, added, now, tested, left, first)


# -- does what was found hold on other drives? Prediction intervals of energies --------------------

_HOLDS = 1.5  # error on other drives, over that on the training drives, that is no surprise
_GROSS = 4.0  # residual over noise from which most of it must be explained
_EXPLAINED = 0.5  # error with what was found, over that without, that counts as most


def with_contacts(model: PowerModel, one: Prediction) -> Prediction:
    """Return a prediction with what the drive's total shows of what contacts hold."""
    shown = shown_of_contacts(model, one.drive)
    return one if shown is None else replace(one, power=one.power + shown)


def holds(quality: Adequacy, predictions: Sequence[Prediction]) -> bool:
    """Return whether what was found on the training drives holds on others, but for their factors.

    Each run of a robot has a factor of its own, which those of other runs do not show.
    """
    apart = [
        replace(one, power=one.power * RunEffect.usual_factor(one.power, one.drive.power))
        for one in predictions
    ]
    return score(apart).rmse <= _HOLDS * max(quality.residual, quality.usual)


def explains(quality: Adequacy, usual: bool, before: float, after: float) -> bool:
    """Return whether what was found explains the error, where more is left than noise.

    What nearly every robot has explains nothing beyond that.
    """
    if quality.adequate or usual:
        return quality.adequate
    gross = quality.residual > _GROSS * quality.usual
    return after <= (_EXPLAINED if gross else 1.0) * before


def energies(fitted: Fitted, predictions: Sequence[Prediction]) -> tuple[EnergyPrediction, ...]:
    """Predict the energy of drives that took no part, with intervals."""
    found = []
    for one in predictions:
        energy = fitted.run.energy(fitted.model, one.drive)
        measured = float(one.drive.weights @ one.drive.power)
        found.append(EnergyPrediction(one.drive.name, energy.mean, energy[1:], measured))
    return tuple(found)
