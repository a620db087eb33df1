"""Energy with its uncertainty, and the power models that a mission meets on its way.

Every unknown of a mission is written as a standard normal coordinate: the principal directions of
each model's covariance, the spread of its coefficients from day to day, its error on
drives held out from its identification, what differs from run to run, the power of each tool, the
duration of each task, and what the battery holds. An energy carries its sensitivity to each of
them. Legs that share a model share its unknowns, so that their errors add up instead of averaging
out; only the noise of the drive itself is each leg's own.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import NamedTuple

import numpy as np

from energyplan.errors import MissionError
from energyplan.fit.doubts import unfounded
from energyplan.fit.run import RunEffect
from energyplan.limits.drive import Ground, Traversal
from energyplan.mission.supply import Gauge
from energyplan.mission.types import Mission, Spreads, Task
from energyplan.motion import Motion
from energyplan.path import PLACE, FloatArray, Trajectory
from energyplan.power import PowerModel
from energyplan.power.effects import GRADE
from energyplan.records import ByValue
from energyplan.terrain import HeightMap, SurfaceMap
from energyplan.vehicle import TreadICR, Vehicle, wheel_loads

_USUAL_SPEED = 1.0  # speed of robots of this kind, where theirs is not known [m/s]

_RUN, _SPEED, _GAUGE = "difference from run to run", "speed of driving", "state of charge"
_TOOLS, _DWELLS, _WAITS = "power of tools", "duration of tasks", "waiting"


@dataclass(frozen=True)
class Estimate:
    """An energy that is not known exactly."""

    mean: float  # expected energy [J]
    sensitivity: FloatArray  # (n,) [J]
    noise: float = 0.0  # variance of its own, independent of everything else [J^2]

    def __add__(self, other: Estimate) -> Estimate:
        return Estimate(
            self.mean + other.mean, self.sensitivity + other.sensitivity, self.noise + other.noise
        )

    def since(self, before: Estimate) -> Estimate:
        """Return what came to it after an earlier one of the same sum."""
        return Estimate(
            self.mean - before.mean,
            self.sensitivity - before.sensitivity,
            self.noise - before.noise,
        )

    @property
    def std(self) -> float:
        """Standard deviation [J]."""
        return float(np.sqrt(self.sensitivity @ self.sensitivity + self.noise))

    def upper(self, quantile: float) -> float:
        """Return the mean plus so many standard deviations [J]."""
        return self.mean + quantile * self.std


class _Source(NamedTuple):
    """A model and its loaded relatives."""

    payloads: FloatArray
    models: tuple[PowerModel, ...]
    places: slice  # of its coefficients' unknowns; that of its error on the hold-out follows
    roots: tuple[FloatArray, ...]


_OF_BATTERY = ("capacity of the battery", "health of the battery", "temperature of the battery")
"""What is open about what a battery holds."""


class Consumption(NamedTuple):
    """What a drive takes."""

    power: FloatArray  # (n,): mean power of each interval of its trajectory [W]
    # (n,): standard deviation of the power in each interval [W]: where along a trajectory the
    # uncertainty of its energy arises; energies may cancel, uncertainties of powers do not
    spread: FloatArray
    energy: Estimate


@dataclass(eq=False)
class Models(ByValue):
    """The power models of a mission, by surface and payload, with their unknowns."""

    model: PowerModel
    surfaces: SurfaceMap | None
    heights: HeightMap | None
    payload_models: Mapping[str, Mapping[float, PowerModel]]
    confidence: float
    coefficient_spread: float
    spreads: Spreads
    tasks: tuple[Task, ...]
    waiting: float

    @classmethod
    def of(cls, mission: Mission) -> Models:
        """Return the models of a mission."""
        return cls(**{part.name: getattr(mission, part.name) for part in fields(cls)})

    def __post_init__(self) -> None:
        self.labels: list[str] = []  # what each shared unknown belongs to
        bare = self.model, *(s.model for s in (self.surfaces.surfaces if self.surfaces else ()))
        seen = {model: self._source(model) for model in dict.fromkeys(bare)}
        self._sources = list(seen.values())
        self._source_of = [[*seen].index(model) for model in bare]
        self._known: dict[tuple[int, float], PowerModel] = {}
        self._directions: dict[tuple[int, float], FloatArray] = {}
        self._idle: dict[tuple[int, float], Estimate] = {}
        tools = dict.fromkeys((task.power, task.power_spread) for task in self.tasks)
        numbers = range(len(self.tasks))
        unknowns = [(_RUN, None), *((_TOOLS, tool) for tool in tools),
                    *((label, None) for label in _OF_BATTERY), *((_DWELLS, k) for k in numbers),
                    *((_WAITS, k) for k in numbers), (_SPEED, None), (_GAUGE, None)]  # fmt: skip
        self._place: dict[tuple[str, object], int] = {
            key: len(self.labels) + k for k, key in enumerate(unknowns)
        }
        self.labels += [label for label, _ in unknowns]
        for model in (model for source in self._sources for model in source.models):
            if reason := unfounded(model, self.confidence, self.coefficient_spread):
                raise MissionError(reason, ("model",))

    @property
    def size(self) -> int:
        """Number of shared unknowns."""
        return len(self.labels)

    def by_source(self, energy: Estimate) -> dict[str, float]:
        """Return the standard deviation of an energy by source [J], the largest first."""
        squares = {"noise of the drive": energy.noise}
        for label, value in zip(self.labels, energy.sensitivity, strict=True):
            squares[label] = squares.get(label, 0.0) + float(value) ** 2
        ranked = sorted(squares.items(), key=lambda item: -item[1])
        return {label: float(np.sqrt(square)) for label, square in ranked if square > 0}

    @property
    def nothing(self) -> Estimate:
        """No energy at all."""
        return Estimate(0.0, np.zeros(self.size))

    def _source(self, model: PowerModel) -> _Source:
        heavier = self.payload_models.get(model.name, {})
        nodes = sorted({0.0: model, **heavier}.items())
        terms = [term.name for term in model.terms]
        for payload, other in nodes:
            if [term.name for term in other.terms] != terms:
                raise MissionError(
                    f"with {payload:g} kg the model {model.name!r} has the terms "
                    f"{[term.name for term in other.terms]}, without payload {terms}; identify "
                    "both with the same terms",
                    ("payload_models",),
                )
        roots, first = tuple(other.principal_directions() for _, other in nodes), len(self.labels)
        self.labels += [f"coefficients of {model.name}"] * sum(len(root.T) for root in roots)
        self.labels += ["coefficient_spread"] * len(terms)
        self.labels.append(f"hold-out error of {model.name}")
        return _Source(
            np.array([payload for payload, _ in nodes]), tuple(other for _, other in nodes),
            slice(first, len(self.labels) - 1), roots,
        )  # fmt: skip

    def _weights(self, source: _Source, payload: float) -> FloatArray:
        nodes = source.payloads
        if len(nodes) == 1:
            return np.ones(1)
        if not nodes[0] - 1e-9 <= payload <= nodes[-1] + 1e-9:
            raise MissionError(
                f"the payload reaches {payload:g} kg, but the models of "
                f"{source.models[0].name!r} cover {nodes[0]:g} to {nodes[-1]:g} kg; identify one "
                "at that payload",
                ("payload_models",),
            )
        upper = int(np.clip(np.searchsorted(nodes, payload), 1, len(nodes) - 1))
        share = float(np.clip((payload - nodes[upper - 1]) / np.diff(nodes)[upper - 1], 0.0, 1.0))
        weights = np.zeros(len(nodes))
        weights[upper - 1], weights[upper] = 1.0 - share, share
        return weights

    def model_of(self, region: int, payload: float) -> PowerModel:
        """Return the model of a region (0 outside all surfaces) with a payload [kg]."""
        key = (self._source_of[region], payload)
        if key not in self._known:
            source = self._sources[key[0]]
            weights = self._weights(source, payload)
            values = weights @ np.array([model.coefficients for model in source.models])
            base = source.models[0]
            if len(source.models) == 1:
                vehicle = _loaded(base.vehicle, payload)
                values = values + payload * np.array([t.name == GRADE.name for t in base.terms])
            else:
                vehicle = _between([m.vehicle for m in source.models], weights)
            self._known[key] = replace(base, vehicle=vehicle, coefficients=values, covariance=None)
        return self._known[key]

    def directions(self, region: int, payload: float) -> FloatArray:
        """Return the change of a model's coefficients per unknown, shape (terms, source size - 1).

        The last unknown of a source, the hold-out error, acts on the energy and has no column.
        """
        key = (self._source_of[region], payload)
        if key not in self._directions:
            source = self._sources[key[0]]
            weights = self._weights(source, payload)
            columns = [w * root for w, root in zip(weights, source.roots, strict=True)]
            spread = self.coefficient_spread * self.model_of(region, payload).coefficients
            self._directions[key] = np.column_stack([*columns, np.diag(spread)])
        return self._directions[key]

    def laden(self, payload: float) -> SurfaceMap | None:
        """Return the surfaces with a payload [kg] on board; their areas to keep out of left out."""
        if self.surfaces is None:
            return None
        laden = (
            replace(surface, model=self.model_of(k, payload))
            for k, surface in enumerate(self.surfaces.surfaces, start=1)
        )
        return replace(self.surfaces, surfaces=tuple(laden), keep_out=())

    def drive(self, trajectory: Trajectory, payload: float) -> Traversal:
        """Return a trajectory over the surfaces with a payload [kg], as the battery feels it."""
        first, *others = (
            self.model_of(k, payload).battery_side() for k in range(len(self._source_of))
        )
        ground = Ground(first, self.surfaces, self.heights, tuple(others))
        return Traversal(trajectory, ground)

    def priced(
        self, trajectory: Trajectory, payload: float, after: float | None = None
    ) -> Consumption:
        """Return what a trajectory takes with a payload [kg], at the battery.

        Where another payload is on board `after` it, the payload changes in proportion to the
        distance, and the power is interpolated between payloads as the models are.
        """
        if after is None or after == payload:
            return self._with(trajectory, payload, np.ones(len(trajectory) - 1))
        steps = np.hypot(np.diff(trajectory.x), np.diff(trajectory.y))
        middle = (np.cumsum(steps) - 0.5 * steps) / max(float(steps.sum()), PLACE)
        known = {float(load) for source in self._sources for load in source.payloads}
        low, high = sorted((payload, after))
        loads = sorted({low, high, *(load for load in known if low < load < high)})
        now = payload + (after - payload) * middle
        shares = [np.interp(now, loads, unit) for unit in np.eye(len(loads))]
        parts = [
            self._with(trajectory, load, share) for load, share in zip(loads, shares, strict=True)
        ]
        return Consumption(
            sum((part.power for part in parts), np.zeros(len(steps))),
            sum((part.spread for part in parts), np.zeros(len(steps))),
            sum((part.energy for part in parts), self.nothing),
        )

    def _with(self, trajectory: Trajectory, payload: float, share: FloatArray) -> Consumption:
        """Return so large a share of what each interval takes with a payload [kg]."""
        total, joules = self.nothing, np.zeros(len(trajectory) - 1)
        drive = self.drive(trajectory, payload)
        for part in drive.quadrature():
            weight = part.weight * share[part.interval][:, None]
            energy, squares = self._one(part.region, part.motion, weight, payload)
            run = self._run(part.region, payload).deviation * energy.mean
            total = total + energy + self._unknown(_RUN, run)
            np.add.at(joules, part.interval, (weight * np.sqrt(squares)).sum(axis=-1))
        duration = np.diff(trajectory.t)
        power = np.asarray(share * drive.interval_energies() / duration)
        return Consumption(power, np.asarray(joules / duration), total)

    def with_tool(self, drive: Consumption, t: FloatArray, task: int) -> Consumption:
        """Return what a drive at times [s] takes with the tool of a task running."""
        job, lasting = self.tasks[task], float(t[-1] - t[0])
        energy = replace(drive.energy, mean=drive.energy.mean + job.power * lasting)
        tool = self._tool(task)
        return Consumption(
            drive.power + job.power,
            np.hypot(drive.spread, tool),
            energy + self._unknown(_TOOLS, tool * lasting, (job.power, job.power_spread)),
        )

    def _tool(self, task: int) -> float:
        """Return the standard deviation of the power of a task's tool [W]."""
        job = self.tasks[task]
        return self.spreads.power * job.power if job.power_spread is None else job.power_spread

    def _run(self, region: int, payload: float) -> RunEffect:
        """Return how a run differs from its model; models between payloads are weighed."""
        source = self._sources[self._source_of[region]]
        known = np.array([model.residual is not None for model in source.models])
        typical = self.spreads.run
        if not known.any():
            return RunEffect(deviation=typical)
        runs = [
            RunEffect.known(m.residual, typical) for m in source.models if m.residual is not None
        ]
        weights = self._weights(source, payload)[known]
        weights = weights / weights.sum() if weights.sum() > 0 else weights + 1 / len(weights)
        return RunEffect(
            deviation=max(run.deviation for run in runs),
            density=float(weights @ [run.density for run in runs]),
            error=float(weights @ [run.error for run in runs]),
        )

    def idle(self, region: int, duration: float, payload: float) -> Estimate:
        """Return the energy of standing still for so long [s]."""
        key = (region, payload)
        if key not in self._idle:
            motion = _straight(self.model_of(region, payload), 0.0)
            self._idle[key] = self._one(region, motion, np.ones(1), payload)[0]
        second = self._idle[key]
        # The residual is what the model misses while driving.
        return Estimate(duration * second.mean, duration * second.sensitivity)

    def work(self, region: int, task: int, payload: float) -> Estimate:
        """Return the energy of doing a task, standing still with its tool."""
        job = self.tasks[task]
        idle = self.idle(region, job.dwell, payload)
        drawn = job.power + self.idle(region, 1.0, payload).mean
        tool = self._tool(task)
        done = replace(idle, mean=idle.mean + job.power * job.dwell)
        done = done + self._unknown(_TOOLS, tool * job.dwell, (job.power, job.power_spread))
        return done + self._unknown(_DWELLS, self._dwell_spread(task) * drawn, task)

    def waited(self, region: int, task: int, payload: float) -> Estimate:
        """Return the energy of the time lost before a task begins."""
        idle = self.idle(region, self.waiting, payload)
        spread = self.spreads.waiting * idle.mean
        return idle + self._unknown(_WAITS, spread, task)

    # -- time -------------------------------------------------------------------------------------

    def driving_time(self, duration: float) -> FloatArray:
        """Return how a drive's duration changes with each unknown [s], shape (size,)."""
        return self._sensitivity(_SPEED, self.spreads.speed * duration)

    def waiting_time(self, task: int) -> FloatArray:
        """Return how the time lost before a task changes with each unknown [s]."""
        spread = self.spreads.waiting * self.waiting
        return self._sensitivity(_WAITS, spread, task)

    def dwell_time(self, task: int) -> FloatArray:
        """Return how the duration of a task changes with each unknown [s]."""
        return self._sensitivity(_DWELLS, self._dwell_spread(task), task)

    def _dwell_spread(self, task: int) -> float:
        job = self.tasks[task]
        own = job.dwell_spread
        return self.spreads.dwell * job.dwell if own is None else own

    def _sensitivity(self, label: str, value: float, which: object = None) -> FloatArray:
        sensitivity = np.zeros(self.size)
        sensitivity[self._place[label, which]] = value
        return sensitivity

    def _unknown(self, label: str, energy: float, which: object = None) -> Estimate:
        """Return an energy that is nothing but its sensitivity to one unknown [J]."""
        return Estimate(0.0, self._sensitivity(label, energy, which))

    # -- battery ----------------------------------------------------------------------------------

    def from_battery(self, energy: Estimate, gauge: Gauge) -> Estimate:
        """Return an energy as the battery's charge feels it."""
        sensitivity = energy.sensitivity.copy()
        for label, share in zip(_OF_BATTERY, gauge.shares, strict=True):
            sensitivity[self._place[label, None]] += share * energy.mean
        return replace(energy, sensitivity=sensitivity)

    def after_reading(self, gauge: Gauge) -> Estimate:
        """Return what is open about the charge after it was read off the gauge, as an energy."""
        return self._unknown(_GAUGE, gauge.soc)

    def driving_power(self, payload: float, speed: float | None) -> float:
        """Return the power of driving straight on, at a tread speed or a typical one [W]."""
        model = self.model_of(0, payload)
        vehicle = model.vehicle
        typical = min(speed or np.inf, vehicle.usual_speed, vehicle.motor.speed, _USUAL_SPEED)
        power = model.battery_side().power(_straight(model, float(typical)))
        return max(float(power[0]), 1.0)

    def _one(
        self, region: int, motion: Motion, weight: FloatArray, payload: float
    ) -> tuple[Estimate, FloatArray]:
        """Integrate instants of so much time each [s]; also return variances of their power."""
        model, source = self.model_of(region, payload), self._sources[self._source_of[region]]

        def power(change: FloatArray | float = 0.0) -> FloatArray:
            changed = model.with_coefficients(model.coefficients + change)
            return np.asarray(changed.battery_side().power(motion))

        def energy(watts: FloatArray) -> float:
            return float((weight * watts).sum())

        watts, run = power(), self._run(region, payload)
        squares = (run.error * watts) ** 2
        squares += (run.deviation * watts) ** 2
        sensitivity = np.zeros(self.size)
        for j, step in enumerate(self.directions(region, payload).T, source.places.start):
            if step.any():
                # of two sides that differ, as where a wheel begins to brake, the worse one
                rises = power(step) - watts, watts - power(-step)
                sensitivity[j] = max(map(energy, rises), key=abs)
                squares += np.maximum(*np.square(rises))
        mean = energy(watts)
        sensitivity[source.places.stop] = run.error * mean
        return Estimate(mean, sensitivity, run.density * float(weight.sum())), squares


def _straight(model: PowerModel, speed: float) -> Motion:
    """Return driving straight on over level ground at one speed [m/s], as one instant."""
    steady = dict.fromkeys((c for term in model.terms for c in term.channels), 0.0)
    return Motion.from_twist(np.full(1, speed), np.zeros(1), model.vehicle.icr, **steady)


def _loaded(vehicle: Vehicle, payload: float) -> Vehicle:
    """Return a vehicle with a payload above its origin."""
    if payload == 0:
        return vehicle
    return replace(vehicle, loads=vehicle.loads + wheel_loads(vehicle.contacts, payload))


def _between(vehicles: list[Vehicle], weights: FloatArray) -> Vehicle:
    """Interpolate wheel loads and tread ICRs."""
    icr = weights @ np.array([(v.icr.left, v.icr.right, v.icr.longitudinal) for v in vehicles])
    return replace(
        vehicles[0],
        loads=weights @ np.array([v.loads for v in vehicles]),
        icr=TreadICR(*(float(value) for value in icr)),
    )
