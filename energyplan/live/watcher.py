"""Watches a drive: learns online, notes changes of ground, keeps an eye on the mission."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import hypot, inf, isfinite
from typing import Any, NamedTuple

import numpy as np

from energyplan.errors import EnergyPlanError, InvalidInputError
from energyplan.fit.online import OnlineIdentifier, RunMemory
from energyplan.live.samples import (
    Changed,
    Done,
    Ended,
    Event,
    Header,
    Learned,
    Line,
    Reassessed,
    Restart,
    Sample,
    Trouble,
    read_samples,
)
from energyplan.logs import DriveLog
from energyplan.logs.checks import find_checks
from energyplan.logs.consistency import contradictions
from energyplan.logs.mapping import Column
from energyplan.mission import Mission, Routes, evaluate
from energyplan.motion import Motion
from energyplan.path import PLACE, FloatArray, Path, Pose, wrap_angle
from energyplan.power import PowerModel
from energyplan.records import checked
from energyplan.vehicle import Vehicle


class WatchLimits(NamedTuple):
    """How a drive is watched."""

    first: int = 20  # samples from which the time between samples is estimated
    # samples in a row, older than one before them, that show that the clock was set
    restart: int = 10
    checked: float = 60.0  # time driven after which what was read so far is checked as a log is [s]
    still: float = 0.02  # speed of the treads below which a robot stands [m/s]
    # distance of places on a path among which the robot's is found [m], and turn [rad]
    fine: float = 0.05
    # poses of a path, as far apart as is near, that a drive may pass between samples
    ahead: int = 10
    facing: float = 0.6  # largest difference of heading at which a robot is at a task's pose [rad]


_WATCH = WatchLimits()


_BACKWARD = "time does not go forward; set aside"


@dataclass(frozen=True)
class Settings:
    """How a drive is watched."""

    every: float = 10.0  # time between two reports of what was learned [s]
    mission_every: float = 60.0  # [s]
    near: float = 0.5  # [m]
    soc: float | None = None  # state of charge at the first sample
    done: tuple[str, ...] = ()  # tasks that were done before

    def __post_init__(self) -> None:
        for label in ("every", "mission_every", "near"):
            value = getattr(self, label)
            if not value > 0:
                raise InvalidInputError(f"{label} is {value}; give a positive number")
        if self.soc is not None and not 0 <= self.soc <= 1:
            raise InvalidInputError(f"soc is {self.soc}; give a fraction in [0, 1]")
        object.__setattr__(self, "done", tuple(self.done))


@checked()
def watch(
    lines: Iterable[Line | Restart],
    prior: PowerModel | Vehicle | None = None,
    mission: Mission | None = None,
    *,
    columns: str | Mapping[str, str | Column] | None = None,
    name: str = "log",
    settings: Settings | None = None,
    former: Sequence[DriveLog] = (),
) -> Iterator[Event]:
    """Watch a drive: learn the power model, notice changes of ground, evaluate the mission's rest.

    Each surface of the mission's map has a model of its own, so that driving from one
    to the other is no change.

    Parameters
    ----------
    lines : iterable of Line or Restart
        The log's lines, as from `follow` and `lines_of`.
    prior : PowerModel or Vehicle, optional
        Where to start learning; the mission's models where not given.
    mission : Mission, optional
        The mission that is under way. Its pose comes from the channels ``x``, ``y`` and ``yaw``,
        the charge from ``soc``, or else from the energy that was drawn.
    columns : str or mapping, optional
        Which column serves as which channel, as for `DriveLog.read`.
    name : str
        What to call the log in messages.
    settings : Settings, optional
        How often to tell what.
    former : sequence of DriveLog
        Runs that the prior was identified from, three or more. What is learned is then the prior
        times a factor of this run: as much of what it took so far, over what the prior predicts, as
        former runs kept from their first quarter to their end.

    Yields
    ------
    Event
        What happens, when it does; `Ended` is the last one.

    Raises
    ------
    InvalidInputError
        If there is neither a prior nor a mission, or the log has no use.

    Examples
    --------
    >>> rows = ["t,v_left,v_right,power"]
    >>> rows += [f"{0.02 * k:.2f},0.5,0.5,80.0" for k in range(600)]
    >>> vehicle = Vehicle.preset("quadriga")
    >>> *_, last = watch([Line(k, row) for k, row in enumerate(rows, 1)], vehicle)
    >>> last.samples, last.changes
    (600, 0)
    """
    if former and not isinstance(prior, PowerModel):
        raise InvalidInputError(
            "former runs go with the model that was identified from them; give prior"
        )
    if prior is None and mission is None:
        raise InvalidInputError("the robot is not known; give a model, a vehicle or a mission")
    if mission is not None and mission.robots:
        names = ", ".join(robot.name for robot in mission.robots)
        told = f"the mission has several robots ({names}), and a log is of one"
        raise InvalidInputError(f"{told}; say whose: --robot NAME, or share(NAME) of its report")
    yield from _Watch(prior, mission, settings or Settings(), former).run(lines, columns, name)


@dataclass
class _GroundLearner:
    """A surface of the map, with its learner and the time driven on it."""

    online: OnlineIdentifier
    t: float = 0.0
    memory: RunMemory | None = None
    prior: PowerModel | None = None  # of former runs
    battery: bool = False  # whether power is measured at the battery
    pending: list[tuple[float, Sample]] = field(default_factory=list)  # time and sample
    energies: tuple[float, float] = (0.0, 0.0)  # measured and predicted [J]

    @property
    def factor(self) -> float:
        """Factor of the power of former runs that the rest of this one has."""
        if self.memory is None or self.prior is None:
            return 1.0
        if self.pending:
            time = np.array([step for step, _ in self.pending])
            samples = [sample for _, sample in self.pending]
            shown = self.prior.battery_side() if self.battery else self.prior
            more = (
                float(time @ [sample.power for sample in samples]),
                float(time @ _power(shown, samples)),
            )
            self.energies = (self.energies[0] + more[0], self.energies[1] + more[1])
            self.pending.clear()
        return self.memory.factor(*self.energies)

    @property
    def model(self) -> PowerModel:
        """The model as it is known now."""
        factor, online = self.factor, self.online.model
        if self.memory is None or self.prior is None:
            return online
        scale = np.array([1.0 if t.kind == "loss" else factor for t in self.prior.terms])
        covariance = self.prior.covariance
        return replace(
            self.prior, coefficients=scale * self.prior.coefficients,
            covariance=None if covariance is None else np.outer(scale, scale) * covariance,
            residual=online.residual,
        )  # fmt: skip


@dataclass
class _Drawn:
    """Battery-side power since the charge was last worked out."""

    t: list[float] = field(default_factory=list)
    samples: list[Sample] = field(default_factory=list)


def _power(model: PowerModel, samples: Sequence[Sample]) -> FloatArray:
    """Power of a model in single samples; without accelerations."""
    names = {channel for term in model.terms for channel in term.channels}
    motion = Motion(
        np.array([sample.v_left for sample in samples]),
        np.array([sample.v_right for sample in samples]),
        model.vehicle.icr,
        {n: np.array([sample.channels.get(n, 0.0) for sample in samples]) for n in names},
    )
    return np.asarray(model.power(motion))


class _RestOfPath(NamedTuple):
    """What is left of a path."""

    poses: FloatArray  # (n, 3): along it, from where the robot is
    driven: float  # how far it is driven [m]
    on_it: bool  # whether the robot is on it


class _Watch:
    def __init__(
        self, prior: PowerModel | Vehicle | None, mission: Mission | None, settings: Settings,
        former: Sequence[DriveLog],
    ) -> None:  # fmt: skip
        self._memory = (
            RunMemory.of(former, prior) if former and isinstance(prior, PowerModel) else None
        )
        self._prior, self._mission, self._settings = prior, mission, settings
        self._known = set(settings.done)
        names = {task.name for task in mission.tasks} if mission is not None else set()
        if self._known - names:
            unknown = ", ".join(sorted(self._known - names))
            raise InvalidInputError(f"done: the mission has no task {unknown}")
        self._battery_side, self._routes = False, Routes()
        self._period = 0.0
        self._grounds: dict[int, _GroundLearner] = {}
        self._clock, self._last = 0.0, -inf  # time driven; time of the last sample
        self._back: list[Sample] = []
        self._told_at = self._looked_at = -inf
        self._stood: dict[str, float] = {}
        self._paths: dict[tuple[str, int], Path] = {}  # of tasks, in each direction
        self._rows: dict[tuple[str, int], FloatArray] = {}  # poses along them
        self._passed: Counter[tuple[str, int]] = Counter()  # how many of them were passed
        if mission is not None:
            for task in mission.tasks:
                for k, one in enumerate(task.options if task.path else ()):
                    path = one.path(mission.vehicle.icr.longitudinal)
                    self._paths[task.name, k] = path
                    self._rows[task.name, k] = path.poses(settings.near, _WATCH.facing)
        self._polarisation = 0.0
        self._soc = settings.soc
        if mission is not None and self._soc is None:
            self._soc = mission.soc
        self._drawn = _Drawn()
        self._pose: Pose | None = None
        self._aside: Counter[str] = Counter()
        self._again: dict[str, Trouble] = {}
        self._here: _GroundLearner | None = None
        self._samples, self._unchecked = 0, list[Sample]()
        self._carries = mission is not None and (
            mission.payload > 0 or any(task.change for task in mission.tasks)
        )

    def run(
        self,
        lines: Iterable[Line | Restart],
        columns: str | Mapping[str, str | Column] | None,
        name: str,
    ) -> Iterator[Event]:
        """Take in lines to their end."""
        first: list[Sample] = []
        for item in read_samples(lines, columns, self._needed(), name):
            if isinstance(item, Header):
                yield from self._begin(item, name)
            elif isinstance(item, Trouble):
                yield from self._trouble(item)
            elif self._period:
                yield from self._timed(item)
                if self._clock >= _WATCH.checked and self._samples == len(self._unchecked):
                    yield from self._doubts(name)
            else:
                first.append(item)
                if len(first) == _WATCH.first:
                    yield from self._release(first)
        yield from self._release(first)
        if self._samples == len(self._unchecked):
            yield from self._doubts(name)
        if self._looked_at < self._clock:
            yield from self._look()
        yield from self._report()
        yield Ended(
            self._samples,
            sum(len(ground.online.changes) for ground in self._grounds.values()),
            tuple(ground.model for ground in self._grounds.values()),
            dict(+self._aside),
        )

    # -- reports ----------------------------------------------------------------------------------

    def _trouble(self, trouble: Trouble) -> Iterator[Event]:
        """Report a kind of trouble at once; how often it came again, with the next report."""
        self._aside[trouble.reason] += 1
        known = self._again.get(trouble.reason)
        if known is None:
            self._again[trouble.reason] = replace(trouble, count=0)
            yield trouble
        else:
            self._again[trouble.reason] = replace(trouble, count=known.count + 1)

    def _doubts(self, name: str) -> Iterator[Event]:
        """Tell, once, what was read so far that contradicts itself or the robot."""
        seen, self._unchecked = self._unchecked, []
        known = self._prior if self._mission is None else self._mission.model
        latest = np.maximum.accumulate([-inf, *(one.t for one in seen)])
        seen = [one for one, before in zip(seen, latest, strict=False) if one.t > before]
        if len(seen) < _WATCH.first or known is None:
            return
        shared = set.intersection(*(set(one.channels) for one in seen))
        rows = [{"t": one.t, "v_left": one.v_left, "v_right": one.v_right, "power": one.power,
                 **{key: one.channels[key] for key in shared}} for one in seen]  # fmt: skip
        log = DriveLog({key: np.array([row[key] for row in rows]) for key in rows[0]}, name)
        checks = find_checks(log.channels, log.power, log.runs)
        told = {one.what: str(one) for one in checks if one.refuses}
        vehicle = known.vehicle if isinstance(known, PowerModel) else known
        told |= {one.what: str(one) for one in contradictions(log, vehicle)}
        yield from (Trouble(name, text) for text in told.values())

    def _report(self) -> Iterator[Event]:
        """Report what was learned, and what went wrong more than once since the last report."""
        yield from (trouble for trouble in self._again.values() if trouble.count)
        self._again.clear()
        if self._here is not None:
            here = self._here
            yield Learned(self._last, here.model, self._samples, here.factor)

    # -- time -------------------------------------------------------------------------------------

    def _release(self, first: list[Sample]) -> Iterator[Event]:
        """Take in the samples that were held back to learn the time between them."""
        if first and not self._period:
            steps = np.diff([sample.t for sample in first])
            steps = steps[steps > 0]
            self._period = float(np.quantile(steps, 0.5, method="lower")) if len(steps) else 0.02
        held = list(first)
        first.clear()
        for sample in held:
            yield from self._timed(sample)

    def _timed(self, sample: Sample) -> Iterator[Event]:
        """Give a sample its place in the time driven."""
        step = sample.t - self._last
        if not isfinite(step):
            step = self._period
        elif step <= 0:
            rising = not self._back or sample.t > self._back[-1].t
            self._back = [*self._back, sample] if rising else [sample]
            if len(self._back) < _WATCH.restart:
                yield from self._trouble(Trouble(sample.place, _BACKWARD))
                return
            again, self._back = self._back, []
            self._aside[_BACKWARD] -= len(again) - 1
            self._again.pop(_BACKWARD, None)
            yield from self._trouble(
                Trouble(again[0].place, "the clock was set back; it goes on from there")
            )
            self._last = -inf
            for one in again:
                yield from self._timed(one)
            return
        else:
            self._back = []
        limit = max(4.0 * self._period, 0.2)
        if step > limit:
            yield from self._trouble(
                Trouble(sample.place, "a gap in time; what was drawn meanwhile is not counted")
            )
        self._clock += step
        self._last = sample.t
        yield from self._take(sample, min(step, limit))

    # -- learning ---------------------------------------------------------------------------------

    def _needed(self) -> tuple[str, ...]:
        """Channels that some model needs in addition to those that follow from the speeds."""
        models: list[PowerModel] = []
        if isinstance(self._prior, PowerModel):
            models.append(self._prior)
        elif self._prior is None and self._mission is not None:
            grounds = self._mission.surfaces.surfaces if self._mission.surfaces else ()
            models += [self._mission.model, *(ground.model for ground in grounds)]
        names = {channel for model in models for term in model.terms for channel in term.channels}
        return tuple(sorted(names - {"accel", "yaw_accel"}))

    def _begin(self, header: Header, name: str) -> Iterator[Event]:
        if self._samples and header.battery_side != self._battery_side:
            raise InvalidInputError(f"{name}: the columns of power changed on the way; start again")
        self._battery_side = header.battery_side
        if self._mission is None:
            return
        if not {"x", "y", "yaw"} <= set(header.channels):
            yield Trouble(name, "without x, y and yaw the rest of the mission is not looked at")
        if "soc" not in header.channels:
            yield Trouble(name, "no channel soc: the charge is worked out from the energy drawn")
        if self._carries:
            yield Trouble(
                name,
                "the mission moves payload: what is learned is reported, and its models stay as "
                "they are",
            )

    def _region(self, sample: Sample) -> int:
        surfaces = None if self._mission is None else self._mission.surfaces
        if surfaces is None or self._prior is not None:
            return 0
        x, y = sample.channels.get("x"), sample.channels.get("y")
        return 0 if x is None or y is None else int(surfaces.region_at((x, y)))

    def _ground(self, region: int) -> _GroundLearner:
        if region not in self._grounds:
            prior = self._prior
            if prior is None and self._mission is not None:
                surfaces = self._mission.surfaces
                known = surfaces.surfaces[region - 1].model if surfaces and region else None
                prior = known or self._mission.model
            if prior is None:
                raise InvalidInputError("the robot is not known; give a model or a vehicle")
            self._grounds[region] = _GroundLearner(
                OnlineIdentifier(prior, battery=self._battery_side, period=self._period),
                memory=self._memory, prior=prior if isinstance(prior, PowerModel) else None,
                battery=self._battery_side,
            )  # fmt: skip
        return self._grounds[region]

    def _take(self, sample: Sample, step: float) -> Iterator[Event]:
        ground = self._ground(self._region(sample))
        self._here = ground
        ground.t += step
        changed = ground.online.update(
            ground.t, sample.v_left, sample.v_right, sample.power, **sample.channels
        )
        if self._samples == len(self._unchecked):
            self._unchecked.append(sample)
        self._samples += 1
        if ground.memory is not None:
            ground.pending.append((step, sample))
        if changed:
            ground.pending, ground.energies = [], (0.0, 0.0)
            change = ground.online.changes[-1]
            ago = change.t - change.onset
            yield Changed(sample.t, sample.t - ago, change.statistic, change.before)
        if self._mission is not None:
            yield from self._follow(sample, step, changed)
        if self._clock - self._told_at >= self._settings.every:
            if self._told_at > -inf:
                yield from self._report()
            self._told_at = self._clock

    # -- the mission ------------------------------------------------------------------------------

    def _follow(self, sample: Sample, step: float, changed: bool) -> Iterator[Event]:
        """Keep track of pose, charge and tasks; look at the mission where it is time to."""
        told = sample.channels
        if {"x", "y", "yaw"} <= told.keys():
            self._pose = Pose(told["x"], told["y"], told["yaw"])
        self._drawn.t.append((self._drawn.t[-1] if self._drawn.t else 0.0) + step)
        self._drawn.samples.append(sample)
        if "soc" in told:
            if 0 <= told["soc"] <= 1:
                self._soc, self._polarisation, self._drawn = told["soc"], 0.0, _Drawn()
            else:
                yield from self._trouble(
                    Trouble(
                        sample.place,
                        "soc is no fraction; of percentages map it as in soc=NAME[*0.01]",
                    )
                )
        done = list(self._finished(sample, step))
        yield from (Done(sample.t, name) for name in done)
        due = self._clock - self._looked_at >= self._settings.mission_every
        if due or changed or done:
            yield from self._look()

    def _finished(self, sample: Sample, step: float) -> Iterator[str]:
        """Yield the tasks that have just been done.

        The robot has stood at their pose for their dwell, or has driven along their path.
        """
        if self._mission is None or self._pose is None:
            return
        standing = max(abs(sample.v_left), abs(sample.v_right)) <= _WATCH.still
        for task in self._mission.tasks:
            if task.name in self._known:
                continue
            if task.pose is None:
                if any(self._drove(one) for one in self._rows if one[0] == task.name):
                    self._known.add(task.name)
                    yield task.name
            elif standing and self._at(task.pose):
                stood = self._stood[task.name] = self._stood.get(task.name, 0.0) + step
                if stood >= task.dwell:
                    self._known.add(task.name)
                    yield task.name

    def _at(self, pose: Sequence[float] | FloatArray) -> bool:
        """Return whether the robot is near a pose, and faces as it does."""
        assert self._pose is not None
        away = hypot(pose[0] - self._pose.x, pose[1] - self._pose.y)
        rotation = abs(float(wrap_angle(pose[2] - self._pose.yaw)))
        return away <= self._settings.near and rotation <= _WATCH.facing

    def _drove(self, row: tuple[str, int]) -> bool:
        """Follow the robot along a path in one direction; return whether it is at its end."""
        poses, passed = self._rows[row], self._passed[row]
        for k in range(passed, min(passed + _WATCH.ahead, len(poses))):
            if self._at(poses[k]):
                self._passed[row] = k + 1
        return self._passed[row] == len(poses)

    def _begun(self) -> dict[str, _RestOfPath]:
        """Return what is left of the paths that are driven in part, by task."""
        found: dict[str, _RestOfPath] = {}
        for row in sorted(self._rows, key=lambda row: self._passed[row]):
            passed = self._passed[row]
            if row[0] not in self._known and 1 < passed < len(self._rows[row]):
                found[row[0]] = self._rest(self._paths[row], self._rows[row][passed - 1])
        return found

    def _rest(self, path: Path, last: FloatArray) -> _RestOfPath:
        """Return what is left of a path from where the robot is on it, or from the last pose."""
        assert self._pose is not None
        fine = path.subdivide(_WATCH.fine, _WATCH.fine)
        poses = fine.vertices
        along, ends = (
            np.append(0.0, np.cumsum(np.abs(one.ds) + np.abs(one.dtheta))) for one in (fine, path)
        )
        at = int(np.argmin(np.abs(poses - last).sum(axis=1)))
        away = np.hypot(poses[:, 0] - self._pose.x, poses[:, 1] - self._pose.y)
        away[np.abs(along - along[at]) > 2 * self._settings.near] = inf
        on_it = bool(away.min() <= self._settings.near)
        at = int(away.argmin()) if on_it else at
        ahead = path.vertices[ends > along[at] + PLACE]
        return _RestOfPath(np.vstack([poses[at], ahead]), float(np.abs(fine.ds[:at]).sum()), on_it)

    def _charge(self) -> float:
        """Return the state of charge now, by the energy that was drawn since it was last known."""
        soc = 1.0 if self._soc is None else self._soc
        if self._mission is None or len(self._drawn.t) < 2:
            return soc
        times = np.array(self._drawn.t)
        run = self._mission.battery.simulate(
            times, self._battery_power(), soc=soc, polarisation=self._polarisation
        )
        last = self._drawn.samples[-1]
        self._soc, self._polarisation = run.soc_end, run.polarisation
        self._drawn = _Drawn([0.0], [last])
        return run.soc_end

    def _battery_power(self) -> FloatArray:
        """Return the power at the battery: as measured, or with what the model says of losses."""
        samples = self._drawn.samples
        measured = np.array([sample.power for sample in samples])
        if self._battery_side or self._here is None:
            return measured
        model = self._here.model
        return measured + _power(model.battery_side(), samples) - _power(model, samples)

    def _look(self) -> Iterator[Event]:
        """Evaluate the rest of the mission."""
        mission, pose = self._mission, self._pose
        if mission is None or pose is None:
            return
        self._looked_at = self._clock
        soc = self._charge()
        done = tuple(task.name for task in mission.tasks if task.name in self._known)
        if len(done) == len(mission.tasks):
            yield Reassessed(self._last, pose, soc, done, {}, None)
            return
        begun = {name: one for name, one in self._begun().items() if len(one.poses) > 1}
        # one that follows a path, a little beside it, goes on along it
        now = next((one.poses[0] for one in begun.values() if one.on_it), pose)
        try:
            rest = self._corrected(mission).resume(
                now, soc, done, time=mission.time + self._clock,
                rows={name: one.poses for name, one in begun.items()},
            )  # fmt: skip
            driven = {name: one.driven for name, one in begun.items()}
            report = evaluate(rest, routes=self._routes)
            yield Reassessed(self._last, pose, soc, done, driven, report)
        except EnergyPlanError as problem:
            yield Trouble(f"at {self._last:g} s", f"the mission cannot be looked at: {problem}")

    def _corrected(self, mission: Mission) -> Mission:
        """Return the mission with what was learned in the place of its models."""
        if self._carries:
            return mission
        changes: dict[str, Any] = {}
        for region, ground in self._grounds.items():
            model, surfaces = ground.model, changes.get("surfaces", mission.surfaces)
            if region == 0:
                changes["model"] = replace(
                    model, vehicle=mission.vehicle.with_icr(model.vehicle.icr)
                )
            elif surfaces is not None:
                known = list(surfaces.surfaces)
                known[region - 1] = replace(known[region - 1], model=model)
                changes["surfaces"] = replace(surfaces, surfaces=tuple(known))
        return replace(mission, **changes)
