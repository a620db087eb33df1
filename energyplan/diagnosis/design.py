"""Which drive next: the one that best separates the explanations that are left."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from energyplan.errors import InvalidInputError, MissingChannelError
from energyplan.motion import Motion, travelled
from energyplan.path import FloatArray, Path, Pose, Trajectory
from energyplan.power import PowerModel, Sides, Term
from energyplan.power.effects import catalogue
from energyplan.power.effects import term as known_term
from energyplan.records import NO_NUMBER
from energyplan.terrain import OccupancyGrid
from energyplan.vehicle import Vehicle

STEP = 0.05
"""Time between two samples of a designed drive [s]."""


@dataclass(frozen=True)
class Manoeuvre:
    """Tread speeds to reach and to hold, from rest to rest, back where it began."""

    name: str  # what it is, in words
    legs: tuple[tuple[float, float, float], ...]  # tread speeds [m/s] and how long each is held [s]


def manoeuvres(vehicle: Vehicle, speed: float, reach: float) -> Iterator[Manoeuvre]:
    """Yield manoeuvres that end where they begin."""
    yield Manoeuvre("stand for 5 s", ((0.0, 0.0, 5.0),))
    icr = vehicle.icr
    for share in (0.35, 0.65, 1.0):
        v = share * speed
        turn = 2 * np.pi * icr.half_track / v
        yield Manoeuvre(
            f"spin left and right at {v:.2f} m/s", ((-v, v, turn), (0, 0, 0), (v, -v, turn))
        )
        yield Manoeuvre(
            f"drive {reach:.1f} m straight at {v:.2f} m/s and back",
            ((v, v, reach / v), (0, 0, 0), (-v, -v, reach / v)),
        )
        for radius in (1.0, 2.0, 5.0):
            inner = v * (radius - 1.0) / (radius + 1.0)
            time = min(reach, 3.0) / v
            for name, left, right in (("left", inner, v), ("right", v, inner)):
                yield Manoeuvre(
                    f"arc of {radius * icr.half_track:.1f} m to the {name} at {v:.2f} m/s and back",
                    ((left, right, time), (0, 0, 0), (-left, -right, time)),
                )
        for k in range(1, 8):
            angle = k * np.pi / 4 if k <= 4 else k * np.pi / 4 - 2 * np.pi
            held = abs(angle) * icr.half_track / v
            s = float(np.sign(angle))
            yield Manoeuvre(
                f"turn by {np.degrees(angle):.0f} deg, {reach:.1f} m straight at {v:.2f} m/s and "
                "back, turn back",
                (
                    (-s * v, s * v, held), (0, 0, 0), (v, v, reach / v), (0, 0, 0),
                    (-v, -v, reach / v), (0, 0, 0), (s * v, -s * v, held),
                ),
            )  # fmt: skip


@dataclass(frozen=True)
class TimedManoeuvre:
    """A manoeuvre and its trajectory from a given pose."""

    manoeuvre: Manoeuvre
    trajectory: Trajectory

    @classmethod
    def of(
        cls, manoeuvre: Manoeuvre, vehicle: Vehicle, start: Pose, acceleration: float
    ) -> TimedManoeuvre:
        """Time the legs with linear ramps between them, and integrate the pose."""
        corners = [(0.0, 0.0, 0.0)]
        for left, right, hold in (*manoeuvre.legs, (0.0, 0.0, 0.0)):
            t, l0, r0 = corners[-1]
            ramp = max(abs(left - l0), abs(right - r0)) / acceleration
            # What the ramps drive is taken off the time at speed, half at either end.
            for step in (ramp, max(hold - ramp, 0.0)):
                if step > 0:
                    t += step
                    corners.append((t, left, right))
        t, left, right = np.array(corners).T
        grid = np.unique(np.concatenate([t, np.arange(0.0, t[-1], STEP)]))
        grid = grid[np.append(True, np.diff(grid) > 1e-6)]
        motion = Motion(np.interp(grid, t, left), np.interp(grid, t, right), vehicle.icr)
        v, w = motion.v, motion.omega
        ends = (v[:-1], v[1:]), (w[:-1], w[1:])
        x, y, yaw = travelled(start, np.diff(grid), *ends, vehicle.icr.longitudinal).T
        return cls(manoeuvre, Trajectory(grid, x, y, yaw, v, w))


def fits(grid: OccupancyGrid, vehicle: Vehicle, trajectory: Trajectory) -> bool:
    """Return whether a vehicle that follows a trajectory stays on the map and touches nothing."""
    poses = trajectory.poses
    if not np.all(grid.inside(poses[:, :2])):
        return False
    path = Path.from_poses(poses, vehicle.icr.longitudinal)
    return grid.path_free(path, vehicle)


def roomiest(grid: OccupancyGrid, vehicle: Vehicle) -> Pose:
    """Return the pose about which most is free, heading along the longer side of the map."""
    rows, columns = grid.shape
    row, column = np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij")
    rim = np.minimum.reduce([row, column, rows - 1 - row, columns - 1 - column])
    room = np.minimum(grid.clearance, (rim + 0.5) * grid.resolution)
    k, j = np.unravel_index(int(np.argmax(room)), room.shape)
    x, y = grid.to_world(np.array([j + 0.5, k + 0.5]))
    pose = Pose(float(x), float(y), 0.0 if columns >= rows else float(np.pi / 2))
    if not bool(grid.footprint_free(np.array([pose]), vehicle)[0]):
        raise InvalidInputError(f"nowhere on the map is room for {vehicle.name}; give a start")
    return pose


def joined(parts: Sequence[Trajectory]) -> Trajectory:
    """Drive trajectories one after the other; each begins where the one before ended."""
    columns, clock = [], 0.0
    for k, part in enumerate(parts):
        first = 1 if k else 0
        rows = np.column_stack([part.t + clock, part.poses, part.v, part.omega])[first:]
        columns.append(rows)
        clock += part.duration
    t, x, y, yaw, v, omega = np.concatenate(columns).T
    return Trajectory(t, x, y, yaw, v, omega)


SETTLED = 3.0
"""Log-likelihood ratio from which two explanations count as distinct: odds of twenty to one."""

SHARE = 0.15
"""Share of the power that an effect of unknown size is taken to have."""

LONGEST = 3600.0  # [s]; beyond it, driving the same again shows as much


@dataclass(frozen=True)
class Hypothesis:
    """Effects that may be there in addition to the model's own terms."""

    effects: tuple[str, ...]  # names of effects of the catalogue or of terms
    probability: float = 1.0  # how probable it is now
    values: Mapping[str, float] | None = None  # sizes of its terms where they are known

    @property
    def label(self) -> str:
        """Its effects in words."""
        return " and ".join(name.replace("_", " ") for name in self.effects) or "no effect"

    def terms(self) -> tuple[Term, ...]:
        """Return the terms that its effects add."""
        entries = catalogue()
        found: list[Term] = []
        for name in self.effects:
            found += entries[name].terms if name in entries else (known_term(name),)
        return tuple(found)


@dataclass(frozen=True)
class Separation:
    """How well a drive separates two explanations."""

    true: str  # the explanation that holds
    other: str  # the explanation that it is separated from
    log_odds: float


@dataclass(frozen=True)
class Design:
    """A drive that was designed."""

    trajectory: Trajectory  # the drive, from rest to rest
    manoeuvres: tuple[str, ...]  # what it consists of
    separates: tuple[Separation, ...]  # how well it separates explanations, every ordered pair
    probabilities_expected: tuple[tuple[str, float], ...]
    sentence: str  # the drive in words


def design(
    model: PowerModel,
    explanations: Sequence[Hypothesis] = (),
    *,
    grid: OccupancyGrid | None = None,
    square: float = 6.0,
    start: Pose | None = None,
    duration: float = 60.0,
    speed: float | None = None,
    acceleration: float = 0.5,
    noise: float = 5.0,
    correlation_time: float = 0.3,
    screen: bool = False,
) -> Design:
    """Design the drive that best separates explanations, or narrows the model's parameters."""
    # Source: Atkinson and Fedorov (1975), on T-optimality; docs/theory, section 7.
    values = {"square": square, "acceleration": acceleration, "noise": noise,
              "correlation_time": correlation_time}  # fmt: skip
    for name, value in values.items():
        if not (np.isfinite(value) and value > 0):
            raise InvalidInputError(f"{name} is {value}; give a positive number")
    if not 0 < duration <= LONGEST:
        raise InvalidInputError(f"duration is {duration} s; give up to {LONGEST:g} s")
    vehicle = model.vehicle
    top = speed or 0.6 * vehicle.motor.speed
    if not (np.isfinite(top) and top > 0):
        raise InvalidInputError(f"{vehicle.name} has no largest tread speed; give the speed")
    grid = grid or OccupancyGrid.from_polygons([], (0.0, 0.0, square, square))
    here = start or roomiest(grid, vehicle)
    screened = _screened(model) if screen and len(explanations) < 2 else ()
    question = _Question(model, tuple(explanations), noise, correlation_time, screened)
    options = [
        option
        for reach in (1.5, 4.0)
        for option in (
            TimedManoeuvre.of(m, vehicle, here, acceleration)
            for m in manoeuvres(vehicle, top, reach)
        )
        if option.trajectory.duration <= duration and fits(grid, vehicle, option.trajectory)
    ]
    if not options:
        raise InvalidInputError(
            f"no manoeuvre fits in {duration:g} s about ({here.x:.2f}, {here.y:.2f}); give more "
            "time or a freer place"
        )
    chosen, gram = _chosen(question, options, duration)
    trajectory = joined([option.trajectory for option in chosen])
    pairs = question.separations(gram)
    names = tuple(option.manoeuvre.name for option in chosen)
    return Design(trajectory, names, pairs, question.probabilities(pairs), _sentence(names, pairs))


def _chosen(
    question: _Question, options: Sequence[TimedManoeuvre], duration: float
) -> tuple[list[TimedManoeuvre], FloatArray]:
    """Choose manoeuvres by what each adds in its time; return them, and their sum of products."""
    chosen: list[TimedManoeuvre] = []
    gram, clock = question.zero, 0.0
    # Only where a term reads the time do products depend on when a manoeuvre begins.
    early = [question.gram(option.trajectory, 0.0) for option in options]
    question.scale_by(np.sum(early, axis=0))
    probe = question.gram(options[-1].trajectory, 100.0)
    timeless = bool(np.allclose(probe, early[-1], rtol=1e-9))
    while True:
        now = question.criterion(gram)
        gains = [
            ((question.criterion(found) - now) / option.trajectory.duration, k, found)
            for k, option in enumerate(options)
            if clock + option.trajectory.duration <= duration
            for more in [early[k] if timeless else question.gram(option.trajectory, clock)]
            for found in [gram + more]
        ]
        if not gains:
            break
        best = max(gains, key=lambda entry: (entry[0], -entry[1]))
        if not best[0] > 0:
            break
        chosen.append(options[best[1]])
        clock += chosen[-1].trajectory.duration
        gram = best[2]
    if not chosen:
        chosen = [options[0]]
        gram = question.gram(options[0].trajectory, 0.0)
    return chosen, gram


def explanations_of(report: Mapping[str, Any]) -> tuple[Hypothesis, ...]:
    """Return what a diagnosis left open, from the document that ``diagnose --json`` printed."""
    try:
        sizes = {e["name"]: float(e["value"]) for e in report.get("effects", ())}
        if report.get("explanations"):
            found = [
                Hypothesis(tuple(e["effects"]), float(e["probability"]), sizes)
                for e in report["explanations"]
            ]
            return tuple(sorted(found, key=lambda e: -e.probability))
        own = tuple(e["name"] for e in report["effects"])
        found = [Hypothesis(own, 1.0, sizes)]
        for entry in report["effects"]:
            others = tuple(name for name in own if name != entry["name"])
            found += [
                Hypothesis((*others, str(rival)), 1.0, sizes) for rival in entry.get("rivals", ())
            ]
    except (*NO_NUMBER, KeyError, AttributeError):
        raise InvalidInputError(
            "the report is not what `energyplan diagnose --json` prints; give that document"
        ) from None
    return tuple(found)


def _screened(model: PowerModel) -> tuple[Term, ...]:
    """Return the terms of the catalogue that a drive on level ground shows, one by one."""
    own = {term.name for term in model.terms}
    still = Motion.from_twist(np.array([0.5]), np.array([0.2]), model.vehicle.icr, accel=0.1,
                              yaw_accel=0.1, t=1.0, x=0.5, y=0.5, yaw=0.3)  # fmt: skip
    found: dict[str, Term] = {}
    for effect in catalogue().values():
        for term in effect.terms:
            if effect.planner == "no" or term.name in own:
                continue
            try:
                model.with_term(term, 0.0).regressors(still)
            except MissingChannelError:
                continue
            found[term.name] = term
    return tuple(found.values())


# -- the criterion --------------------------------------------------------------------------------


class _Question:
    """Explanations as columns of one matrix of regressors, of which only products are kept."""

    def __init__(
        self,
        model: PowerModel,
        explanations: tuple[Hypothesis, ...],
        noise: float,
        tau: float,
        screened: tuple[Term, ...] = (),
    ) -> None:
        own = [term.name for term in model.terms]
        self._terms = [[term.name for term in e.terms()] for e in explanations]
        more = [*(t for e in explanations for t in e.terms()), *screened]
        extra = {t.name: t for t in more if t.name not in own}
        whole = model
        for term in extra.values():
            whole = whole.with_term(term, 0.0)
        self._model, self.explanations = whole, explanations
        self._names = [term.name for term in whole.terms]
        self._own = [self._names.index(name) for name in own]
        self._weight = STEP / max(STEP, 2 * tau) / noise**2
        self._coefficients = model.coefficients
        self._narrowed = [*self._own, *(self._names.index(t.name) for t in screened)]
        self._scale = np.zeros(len(self._names))
        self.zero = np.zeros((len(self._names), len(self._names)))

    def gram(self, trajectory: Trajectory, clock: float) -> FloatArray:
        """Return the products of all regressors on a drive that begins at a time [s]."""
        motion = Motion.from_trajectory(
            trajectory, self._model.vehicle.icr, t=trajectory.t + clock,
            accel_x=np.gradient(trajectory.v, trajectory.t),
        )  # fmt: skip
        if any(name.startswith("tilt_") for name in self._names):
            channels = {k: v for k, v in motion.channels.items() if k != "slope"}
            motion = Motion(motion.v_left, motion.v_right, motion.icr, channels)
        try:
            columns = self._model.regressors(motion)
        except MissingChannelError as problem:
            raise InvalidInputError(f"no drive is designed for it: {problem}") from None
        rows = np.column_stack([c.total if isinstance(c, Sides) else c for c in columns])
        return np.asarray(self._weight * rows.T @ rows)

    def scale_by(self, gram: FloatArray) -> None:
        """Set the sizes that parameters are narrowed against, by all that could be driven."""
        own = np.where(self._coefficients != 0, np.abs(self._coefficients), 1.0)
        part = gram[np.ix_(self._own, self._own)]
        power = float(self._coefficients @ part @ self._coefficients)
        there = np.diag(gram) > 0
        self._scale[there] = SHARE * np.sqrt(max(power, 0.0) / np.diag(gram)[there])
        self._scale[self._own] = own

    def _columns(self, k: int) -> list[int]:
        extra = [self._names.index(name) for name in self._terms[k]]
        return list(dict.fromkeys([*self._own, *extra]))

    def _sizes(self, gram: FloatArray, k: int) -> FloatArray:
        """Return coefficients of an explanation; unknown ones are as strong as the first."""
        explanation = self.explanations[k]
        known = dict(explanation.values or {})
        full = np.zeros(len(self._names))
        full[self._own] = self._coefficients
        missing = []
        for name in self._terms[k]:
            j = self._names.index(name)
            if name in known:
                full[j] = known[name]
            elif j not in self._own:
                missing.append(j)
        if missing and k:
            # As much energy of the deviation as the first explanation's own terms have.
            first = self._sizes(gram, 0)
            extra = [i for i in range(len(full)) if i not in self._own]
            amount = float(first[extra] @ gram[np.ix_(extra, extra)] @ first[extra])
            for j in missing:
                if gram[j, j] > 0:
                    full[j] = np.sqrt(max(amount, 0.0) / gram[j, j])
        elif missing:
            scale = float(self._coefficients @ gram[np.ix_(self._own, self._own)]
                          @ self._coefficients)  # fmt: skip
            for j in missing:
                if gram[j, j] > 0:
                    full[j] = SHARE * np.sqrt(max(scale, 0.0) / gram[j, j])
        return full

    def separations(self, gram: FloatArray) -> tuple[Separation, ...]:
        """Return the expected log-likelihood ratio of every ordered pair."""
        found = []
        for i, true in enumerate(self.explanations):
            size = self._sizes(gram, i)
            for j, other in enumerate(self.explanations):
                if i == j:
                    continue
                columns = self._columns(j)
                block = gram[np.ix_(columns, columns)]
                cross = gram[columns] @ size
                # Scaled, so that the cut of what the drive does not show means the same for all.
                unit = np.sqrt(np.maximum(np.diag(block), 1e-300))
                solved = np.linalg.pinv(block / np.outer(unit, unit), rcond=1e-9) @ (cross / unit)
                left = float(size @ gram @ size - (cross / unit) @ solved)
                found.append(Separation(true.label, other.label, max(left, 0.0) / 2))
        return tuple(found)

    def criterion(self, gram: FloatArray) -> float:
        """Return how well drives separate explanations, or narrow parameters."""
        if len(self.explanations) > 1:
            odds = np.array([pair.log_odds for pair in self.separations(gram)])
            # Concave, so that a pair which is already distinct counts less than the others.
            return -float(np.sum(np.exp(-odds / (2.0 * SETTLED))))
        scale = self._scale[self._narrowed]
        part = gram[np.ix_(self._narrowed, self._narrowed)] * np.outer(scale, scale)
        return float(np.linalg.slogdet(np.eye(len(part)) + part)[1])

    def probabilities(self, pairs: Sequence[Separation]) -> tuple[tuple[str, float], ...]:
        """Return how probable each explanation will be if it is true."""
        prior = {e.label: max(e.probability, 1e-12) for e in self.explanations}
        found = []
        for label, weight in prior.items():
            rest = sum(prior[p.other] * np.exp(-p.log_odds) for p in pairs if p.true == label)
            found.append((label, float(weight / (weight + rest))))
        return tuple(found)


def _sentence(names: Sequence[str], pairs: Sequence[Separation]) -> str:
    counts = Counter(names)
    what = "; ".join(name if n == 1 else f"{name}, {n} times" for name, n in counts.items())
    open_pairs = {frozenset((p.true, p.other)) for p in pairs if p.log_odds < SETTLED}
    text = f"{what[0].upper()}{what[1:]}."
    if not pairs:
        return text + " This narrows the parameters most."
    if not open_pairs:
        return text + " This separates all explanations."
    named = "; ".join(" from ".join(sorted(pair)) for pair in sorted(open_pairs, key=sorted))
    return text + f" It is not expected to separate: {named}."
