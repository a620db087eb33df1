"""The loop closed: plan, drive, find the residual, learn, plan again."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import astuple, dataclass, replace
from typing import NamedTuple

import numpy as np

from energyplan import html
from energyplan.diagnosis import diagnose, result
from energyplan.diagnosis.design import Hypothesis, design
from energyplan.errors import (
    DriveLogError,
    InfeasibleMotionError,
    InvalidInputError,
    MissingChannelError,
    ModelError,
    NotIdentifiableError,
)
from energyplan.fit import identify
from energyplan.fit.drive import Drive, split_drives
from energyplan.fit.run import Energy, RunEffect
from energyplan.limits.speed import profile
from energyplan.logs import DriveLog
from energyplan.motion import Motion
from energyplan.path import FloatArray, Trajectory
from energyplan.physics.driving import Driven, Sensors, drive, energy_predicted
from energyplan.physics.engine import require_mujoco
from energyplan.physics.robot import EngineGround, EngineRobot
from energyplan.planning import Plan, PlanningProblem, plan
from energyplan.power import PowerModel
from energyplan.power.effects import reads_slope, with_weight
from energyplan.terrain import HeightMap
from energyplan.vehicle import TreadICR, Vehicle


class LoopLimits(NamedTuple):
    """What a drive is learned from, and judged by."""

    # how far tread ICRs may differ for controllers to steer alike, over half the slip track [1]
    alike: float = 0.02
    shortest: float = 16.0  # shortest drive that diagnosis learns from [s]
    # driving in which effects are looked for; less cannot be parted into learning and judging [s]
    diagnosed: float = 40.0
    # probability from which an explanation counts where the next drive is designed
    likely: float = 0.02
    # width of an interval over its energy beyond which being within it proves nothing
    sharp: float = 0.1


_LIMITS = LoopLimits()


def replayed_energy(model: PowerModel, log: DriveLog) -> float:
    """Return the energy that a model predicts for a log, freed of noise as in a fit [J]."""
    prepared = Drive.of(log, model.vehicle)
    return float(prepared.weights @ model.battery_side().power(prepared.motion))


class Steered(NamedTuple):
    """A drive that followed a trajectory, and the tread ICRs that its controller believed in."""

    reference: Trajectory  # what was to be driven
    log: DriveLog  # what was driven
    icr: TreadICR  # the tread ICRs


def predicted_energy(trajectory: Trajectory, problem: PlanningProblem) -> float:
    """Return what the model and the ground of a problem say that a trajectory takes [J]."""
    ground = EngineGround(problem.surfaces, problem.heights)
    return sum(energy_predicted(trajectory, problem.cost.model, ground).values())


def ratio(
    drive: Steered, model: PowerModel, priced: PlanningProblem, heights: HeightMap | None
) -> float:
    """Return the energy that a drive took, over what a model says of it."""
    icr, law = model.vehicle.icr, priced.cost.model
    shift = np.subtract(astuple(icr), astuple(drive.icr))
    # A tread that was to stand stands with the ICRs that it was steered by; with others it creeps,
    # against all of its resistance.
    as_steered = replace(law, vehicle=law.vehicle.with_icr(drive.icr))
    predicted = predicted_energy(
        drive.reference, replace(priced, cost=replace(priced.cost, model=as_steered))
    )
    if np.abs(shift).max() > _LIMITS.alike * icr.half_track:
        on_slopes = model if heights is None else with_weight(model)
        with suppress(MissingChannelError):  # a sensor less than the model asks for
            predicted = replayed_energy(on_slopes, drive.log)
    return drive.log.energy / predicted


LEVEL = 0.95
"""Probability of the interval of an energy."""


def with_interval(
    energy: float, run: RunEffect, model: PowerModel, motion: Motion, weights: FloatArray
) -> Energy | None:
    """Return an energy with what drives took beyond a model, and its interval if there is one."""
    if model.covariance is None:
        return None
    with suppress(MissingChannelError):
        return run.energy(model, Drive.at(motion, True), LEVEL, energy, weights)
    return None


@dataclass(frozen=True)
class LearnedEffect:
    """An effect in the model of the next round: its name, size, standard error and unit."""

    name: str
    value: float
    std_error: float
    unit: str


class LearnedModel(NamedTuple):
    """A model of all drives so far, the effects in it, and what else may explain them."""

    model: PowerModel | None
    effects: tuple[LearnedEffect, ...]
    explanations: tuple[Hypothesis, ...] = ()
    note: str = ""


def learn(logs: Sequence[DriveLog], vehicle: Vehicle) -> LearnedModel:
    """Diagnose all drives so far, all of each of them."""
    try:
        return _learned(logs, vehicle)
    except (NotIdentifiableError, DriveLogError) as reason:
        return LearnedModel(None, (), note=f"nothing learned: {reason}")


def _learned(logs: Sequence[DriveLog], vehicle: Vehicle) -> LearnedModel:
    long = [log for log in logs if log.duration >= _LIMITS.shortest]
    total = sum(log.duration for log in long)
    if total < _LIMITS.diagnosed:
        model = identify(logs, vehicle, method="huber").model
        note = (
            f"{total:.0f} s of driving are too short to look for effects; "
            "resistance and friction alone were identified"
        )
        return LearnedModel(model, (), note=note)
    drives = split_drives(long)
    outcome = diagnose(*drives, vehicle)
    if outcome.suspects:
        outcome = diagnose(
            *drives, vehicle, border="border" in outcome.suspects,
            change="change" in outcome.suspects,
        )  # fmt: skip
    found = tuple(LearnedEffect(e.name, e.value, e.std_error, e.unit) for e in outcome.effects)
    most = outcome.explanations[0].probability
    likely = [e for e in outcome.explanations if e.probability > _LIMITS.likely * most]
    return LearnedModel(outcome.model, found, tuple(map(_explanation, likely)))


def _explanation(found: result.Explanation) -> Hypothesis:
    model = found.model
    sizes = {term.name: model.coefficient(term.name) for term in model.terms}
    return Hypothesis(found.effects, found.probability, sizes)


SPEED_SHARE = 0.6
"""Share of the largest tread speed at which a vehicle without a default is driven."""
Progress = Callable[[float, str], None]


@dataclass(frozen=True)
class Round:
    """One round of the loop: plan, drive, diagnose."""

    energy_predicted: float  # energy that the model of this round predicts, before the drive [J]
    energy_interval: tuple[float, float] | None  # its 95 % interval [J]
    energy_measured: float  # energy that was measured [J]
    plan: Plan  # the route of this round
    model: PowerModel  # the model that predicted
    effects: tuple[
        LearnedEffect, ...
    ]  # what the diagnosis of all drives so far found, this one included
    log: DriveLog  # the drive
    driven: Driven | None = None  # the drive in the engine
    survey: Driven | None = None  # the designed drive after it, to learn from
    note: str = ""  # why nothing was learned, if so
    overhead: float = 0.0  # share of the prediction that the model's terms do not give

    @property
    def length(self) -> float:
        """Length of the route [m]."""
        return self.plan.length

    @property
    def error(self) -> float:
        """Predicted over measured energy, minus one."""
        return self.energy_predicted / self.energy_measured - 1.0

    @property
    def within(self) -> bool:
        """Whether the measured energy lies in the predicted interval, and that is narrow."""
        if self.energy_interval is None:
            return False
        low, high = self.energy_interval
        return (
            high - low <= _LIMITS.sharp * self.energy_predicted
            and low <= self.energy_measured <= high
        )


@dataclass(frozen=True)
class Loop(html.Readable):
    """The rounds of a loop, and the model in the end."""

    rounds: tuple[Round, ...]  # the rounds, in their order
    model: PowerModel  # the model in the end
    closed: bool  # whether the last prediction was right

    def _summaries(self) -> list[html.Summary]:
        rows = [
            (
                k, r.energy_predicted,
                " to ".join(map(html.number, r.energy_interval or ())) or "-",
                r.energy_measured, f"{100 * r.error:+.1f} %", r.length,
                ", ".join(
                    f"{html.words(e.name)} {html.quantity(e.value, e.std_error, e.unit)}"
                    for e in r.effects
                ) or r.note or "-",
            )
            for k, r in enumerate(self.rounds, 1)
        ]  # fmt: skip
        surveys = [
            f"after round {k} a designed drive of {r.survey.trajectory.duration:.0f} s was made to "
            "learn from"
            for k, r in enumerate(self.rounds, 1)
            if r.survey
        ]
        header = (
            "round", "predicted [J]", "95 % interval [J]", "measured [J]", "error", "length [m]",
            "found",
        )  # fmt: skip
        return [html.Summary(f"the last prediction {self._verdict}", header, rows, surveys)]

    @property
    def _verdict(self) -> str:
        if self.closed:
            return "was right"
        last = self.rounds[-1]
        low, high = last.energy_interval or (np.nan, np.nan)
        if low <= last.energy_measured <= high:
            return "holds the energy taken, but is too wide to count as right; drive more rounds"
        return "was still wrong"


# -- where drives come from -----------------------------------------------------------------------


@dataclass(frozen=True)
class EngineDrives:
    """Drives in the engine: each round's route, followed by the tracking controller."""

    robot: EngineRobot  # what is true
    ground: EngineGround | None = None  # the true ground
    sensors: Sensors | None = None  # how drives are recorded

    def __post_init__(self) -> None:
        require_mujoco()

    def __call__(self, trajectory: Trajectory, model: PowerModel, count: int) -> Driven:
        """Drive a route; `model` serves the controller, `count` numbers the drive."""
        return drive(trajectory, self.robot, model, ground=self.ground)

    def log(self, driven: Driven, count: int) -> DriveLog:
        """Return a drive as the sensors record it; every drive has noise of its own."""
        level = self.ground is None or self.ground.heights is None
        sensors = self.sensors or Sensors(without=("accel_x", "slope") if level else ())
        sensors = replace(sensors, seed=sensors.seed + 1000 * count)
        return sensors.log(driven.run, f"round {count}")


Source = EngineDrives | Sequence[DriveLog]
"""The engine; or logs of a real robot, one for each round."""


# -- the loop -------------------------------------------------------------------------------------


class PredictedDrive(NamedTuple):
    """What a model says of a drive before it learns from it."""

    energy: float  # [J]
    motion: Motion
    weights: FloatArray  # time of each row of the motion [s]
    known: list[float]  # measured over predicted energy of the drives before

    @classmethod
    def of_log(cls, model: PowerModel, log: DriveLog, before: Sequence[DriveLog]) -> PredictedDrive:
        """Replay a log, and those before it."""
        prepared = Drive.of(log, model.vehicle)
        known = [one.energy / replayed_energy(model, one) for one in before]
        return cls(replayed_energy(model, log), prepared.motion, prepared.weights, known)

    def judged(
        self, planned: Plan, model: PowerModel, log: DriveLog, driven: Driven | None, learned: bool
    ) -> Round:
        """Return the round; drives before it count where the model has learned from them."""
        beyond = RunEffect.of(self.known if learned else (), model.residual)
        interval = with_interval(self.energy, beyond, model, self.motion, self.weights)
        return Round(
            self.energy * (1.0 + beyond.mean), None if interval is None else interval[1:],
            log.energy, planned, model, (), log, driven, overhead=beyond.mean,
        )  # fmt: skip


def close_loop(
    problem: PlanningProblem,
    source: Source,
    *,
    rounds: int = 3,
    tolerance: float = 0.01,
    before: Sequence[DriveLog] = (),
    speed: float | None = None,
    survey: float = 60.0,
    time_limit: float = np.inf,
    effort: int | None = None,
    planner: str = "lattice",
    progress: Progress | None = None,
) -> Loop:
    """Plan, drive, diagnose with all logs so far, and plan again."""
    count = _count(source, rounds, tolerance, survey)
    report = progress or (lambda fraction, text: None)
    model = problem.cost.model
    base = problem.vehicle or problem.cost.vehicle
    limit = speed or _usual_speed(problem)
    logs, done = list(before), list[Round]()
    steered = list[Steered]()
    for k in range(count):
        report(k / count, f"round {k + 1}: planning")
        driven = None
        try:
            priced = believed(problem, model, limit)
            planned = plan(priced, planner, time_limit, effort=effort)
            if isinstance(source, EngineDrives):
                trajectory = timed(planned, priced, limit)
        except (InfeasibleMotionError, ModelError) as reason:
            if not done:
                raise
            note = f"what was learned is left out, as nothing can be planned with it: {reason}"
            done[-1] = replace(done[-1], effects=(), note=note)
            model = done[-1].model
            break
        report((k + 0.3) / count, f"round {k + 1}: driving")
        if isinstance(source, EngineDrives):
            driven = source(trajectory, priced.cost.model, k + 1)
            log = source.log(driven, k + 1)
            known = [ratio(one, model, priced, problem.heights) for one in steered]
            motion = _followed(trajectory, model, problem.heights)
            predicted = PredictedDrive(
                predicted_energy(trajectory, priced), motion, np.diff(trajectory.t), known
            )
            steered.append(Steered(trajectory, log, model.vehicle.icr))
        else:
            log = source[k]
            predicted = PredictedDrive.of_log(model, log, logs)
        logs.append(log)
        now = predicted.judged(planned, model, log, driven, model is not problem.cost.model)
        if now.within or abs(now.error) <= tolerance:
            return Loop((*done, now), model, True)
        report((k + 0.6) / count, f"round {k + 1}: diagnosing")
        learned = learn(logs, base)
        if isinstance(source, EngineDrives) and survey and not any(r.survey for r in done):
            report((k + 0.7) / count, f"round {k + 1}: a designed drive")
            wanted = _survey(learned.explanations, model, problem, limit, survey)
            if wanted is not None:
                surveyed = source(wanted, priced.cost.model, k + 1)
                logs.append(source.log(surveyed, count + 1))
                steered.append(Steered(wanted, logs[-1], model.vehicle.icr))
                now = replace(now, survey=surveyed)
                report((k + 0.85) / count, f"round {k + 1}: diagnosing")
                learned = learn(logs, base)
        model = learned.model or model
        done.append(replace(now, effects=learned.effects, note=learned.note))
    return Loop(tuple(done), model, False)


def _count(source: Source, rounds: int, tolerance: float, survey: float) -> int:
    """Return how many rounds there are; refuse options that no loop has."""
    if rounds < 1 or not tolerance >= 0 or not survey >= 0:
        raise InvalidInputError(
            f"rounds is {rounds}, tolerance {tolerance} and survey {survey}; give rounds >= 1, and "
            "neither of the others below 0"
        )
    count = rounds if isinstance(source, EngineDrives) else min(rounds, len(source))
    if count == 0:
        raise InvalidInputError("there is no log to close the loop with; give one or more")
    return count


def _survey(
    explanations: tuple[Hypothesis, ...],
    model: PowerModel,
    problem: PlanningProblem,
    speed: float,
    duration: float,
) -> Trajectory | None:
    """Return the most informative drive; None where the map has no room for one."""
    try:
        return design(
            model, explanations, grid=problem.map, duration=duration, speed=speed, screen=True
        ).trajectory
    except InvalidInputError:
        return None


# -- details --------------------------------------------------------------------------------------


def _usual_speed(problem: PlanningProblem) -> float:
    usual, top = problem.cost.vehicle.usual_speed, problem.cost.vehicle.motor.speed
    if np.isfinite(usual):
        return min(usual, top)
    if not np.isfinite(top):
        raise InvalidInputError(
            f"{problem.cost.vehicle.name} has no largest tread speed; give the speed to drive at"
        )
    return SPEED_SHARE * top


def believed(problem: PlanningProblem, model: PowerModel, speed: float) -> PlanningProblem:
    """Return a problem priced by another model of the same robot, at a tread speed [m/s]."""
    law = model if problem.heights is None else with_weight(model)
    cost = replace(problem.cost, model=law, battery=True, speed=speed)
    return replace(problem, cost=cost, vehicle=problem.vehicle or problem.cost.vehicle)


def timed(planned: Plan, priced: PlanningProblem, speed: float) -> Trajectory:
    """Time a plan to tread speeds [m/s] that leave the controller room."""
    law = priced.cost.model
    acceleration = min(0.5 * law.vehicle.motor.acceleration, 0.5)
    motor = replace(law.vehicle.motor, speed=speed, acceleration=acceleration)
    slope: dict[str, FloatArray | float] = {"slope": 0.0}
    path = planned.path
    if priced.heights is not None:
        path = priced.heights.cut(path)
        slope["slope"] = priced.heights.slopes(path)
    vehicle = replace(law.vehicle, motor=motor)
    return profile(path, law, vehicle=vehicle, channels=slope, smooth=0.0)


def _followed(trajectory: Trajectory, model: PowerModel, heights: HeightMap | None) -> Motion:
    """Return the motion in the middle of each step of a trajectory."""
    step = np.diff(trajectory.t)

    def middle(values: FloatArray) -> FloatArray:
        return np.asarray(0.5 * (values[1:] + values[:-1]))

    x, y, yaw = middle(trajectory.x), middle(trajectory.y), middle(trajectory.yaw)
    channels = {
        "t": middle(trajectory.t), "x": x, "y": y, "yaw": yaw,
        "accel": np.diff(trajectory.v) / step, "yaw_accel": np.diff(trajectory.omega) / step,
    }  # fmt: skip
    if heights is not None:
        channels["slope"] = heights.slope(np.column_stack([x, y, yaw]))
    elif reads_slope(model):
        channels["slope"] = np.zeros(len(x))
    icr = model.vehicle.icr
    return Motion.from_twist(middle(trajectory.v), middle(trajectory.omega), icr, **channels)
