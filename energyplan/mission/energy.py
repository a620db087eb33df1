"""Energy with its uncertainty, and the power models that a mission meets on its way.

Every unknown of a mission is written as a standard normal coordinate: the principal directions of
each model's covariance, the spread of its coefficients from day to day, the error that it made on
drives held out from its identification, what differs from run to run, the power of each tool, the
duration of each task, and what the battery holds (see `energyplan.mission.energy`). An energy
carries its sensitivity to each of them. Legs that share a model share its unknowns, so that their
errors add up instead of averaging out; only the noise of the drive itself is each leg's own.
"""

from __future__ import annotations

from collections.abc import Mapping
from copy import copy
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from energyplan.battery import Battery
from energyplan.errors import MissionError
from energyplan.fit.doubts import unfounded
from energyplan.limits.drive import Drive, Ground
from energyplan.mission.types import Mission
from energyplan.motion import Motion
from energyplan.path import FloatArray, Trajectory
from energyplan.power import PowerModel
from energyplan.power.effects import GRADE
from energyplan.vehicle import TreadICR, Vehicle, wheel_loads

RUN = 0
"""Place of what differs from run to run."""


@dataclass(frozen=True)
class Unknowns:
    """Places of the unknowns among their coordinates."""

    labels: tuple[str, ...]  # what each belongs to
    tools: tuple[int, ...]  # place for each task
    dwells: tuple[int, ...]  # place for each task
    waits: tuple[int, ...]  # place for each task
    speed: int  # place of the time that driving takes
    gauge: int  # place of the state of charge
    gauge_energy: float  # energy that one standard deviation of it stands for [J]
    battery: Mapping[int, float]

    @classmethod
    def of(cls, mission: Mission, power: float) -> Unknowns:
        """Return the unknowns of a mission."""
        labels = ["difference from run to run"]

        def new(label: str) -> int:
            labels.append(label)
            return len(labels) - 1

        tools: dict[tuple[float, float | None], int] = {}
        for task in mission.tasks:
            if (task.power, task.power_spread) not in tools:
                tools[task.power, task.power_spread] = new("power of tools")
        battery = {new(label): share for label, share in _shares(mission, power).items()}
        stored = float(mission.battery.usable_energy(power, 1.0)) or mission.battery.full_energy
        return cls(
            tools=tuple(tools[task.power, task.power_spread] for task in mission.tasks),
            dwells=tuple(new("duration of tasks") for _ in mission.tasks),
            waits=tuple(new("waiting") for _ in mission.tasks),
            speed=new("speed of driving"),
            gauge=new("state of charge"),
            gauge_energy=mission.spreads.soc * stored,
            battery=battery,
            labels=tuple(labels),
        )


def _shares(mission: Mission, power: float) -> dict[str, float]:
    """Return the share of the energy by which the battery delivers less, by what is open."""
    battery, spreads = mission.battery, mission.spreads
    shares = {"capacity of the battery": spreads.capacity}
    if not isinstance(battery, Battery):
        return shares

    def usable(changed: Battery) -> float:
        return float(changed.usable_energy(power, 1.0))

    warm, cold = (
        usable(replace(battery, temperature=battery.temperature + sign * spreads.temperature))
        for sign in (1.0, -1.0)
    )
    # one that delivers nothing at all has nothing to lose
    told = max(usable(battery), 1.0)
    # a battery cannot be healthier than new, nor older than nothing
    fresh = min(battery.health + spreads.health, 1.0)
    aged = max(battery.health - spreads.health, 0.1 * battery.health)
    better, worse = (usable(replace(battery, health=h)) for h in (fresh, aged))
    steps = (fresh - aged) / spreads.health if spreads.health else 1.0
    shares["health of the battery"] = (better - worse) / told / steps
    shares["temperature of the battery"] = (warm - cold) / told / 2.0
    return shares


_USUAL_SPEED = 1.0
"""Speed of robots of this kind, where nothing tells theirs [m/s]."""


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

    @property
    def std(self) -> float:
        """Standard deviation [J]."""
        return float(np.sqrt(self.sensitivity @ self.sensitivity + self.noise))

    def upper(self, quantile: float) -> float:
        """Return the mean plus so many standard deviations [J]."""
        return self.mean + quantile * self.std


class _Holdout(NamedTuple):
    """What a model missed on drives that it was not fitted to."""

    error: float  # relative error of the energy
    strength: float  # variance of the energy per second of driving [J^2/s]


@dataclass(frozen=True)
class _Source:
    """A model and its loaded relatives, with the place of their unknowns among the coordinates."""

    payloads: FloatArray
    models: tuple[PowerModel, ...]
    first: int
    roots: tuple[FloatArray, ...]

    @property
    def size(self) -> int:
        """Number of unknowns: covariances, spread of each coefficient, error on the hold-out."""
        return sum(len(root.T) for root in self.roots) + len(self.models[0].terms) + 1


def _root(model: PowerModel) -> FloatArray:
    """Return principal directions of the covariance, one standard deviation each."""
    n = len(model.terms)
    if model.covariance is None:
        return np.empty((n, 0))
    value, vector = np.linalg.eigh(model.covariance)
    keep = value > 1e-12 * max(float(value.max()), 1e-300)
    return np.asarray(vector[:, keep] * np.sqrt(value[keep]))


class Grounds:
    """The power models of a mission, by surface and payload, with their unknowns."""

    def __init__(self, mission: Mission) -> None:
        self._mission = mission
        surfaces = mission.surfaces
        bare = [mission.model, *(s.model for s in (surfaces.surfaces if surfaces else ()))]
        self._sources: list[_Source] = []
        self._source_of: list[int] = []
        seen: dict[tuple[str, bytes], int] = {}
        for model in bare:
            key = (model.name, model.coefficients.tobytes())
            if key not in seen:
                seen[key] = len(self._sources)
                self._sources.append(self._source(model))
            self._source_of.append(seen[key])
        self._known: dict[tuple[int, float], PowerModel] = {}
        self._directions: dict[tuple[int, float], FloatArray] = {}
        self._idle: dict[tuple[int, float], Estimate] = {}
        self._models = sum(source.size for source in self._sources)
        self._unknowns = Unknowns.of(mission, self.driving_power)
        self._refuse_unfounded_bounds()

    def under(self, mission: Mission) -> Grounds:
        """Return these grounds for a mission that differs in battery, charge or speed.

        What is open about a battery depends on the battery.
        """
        other = copy(self)
        other._mission = mission
        other._unknowns = Unknowns.of(mission, other.driving_power)
        other._idle = {}
        return other

    @property
    def size(self) -> int:
        """Number of shared unknowns."""
        return self._models + len(self._unknowns.labels)

    @property
    def labels(self) -> tuple[str, ...]:
        """What each shared unknown belongs to, shape (size,)."""
        labels: list[str] = []
        for source in self._sources:
            name = source.models[0].name
            drawn = sum(len(root.T) for root in source.roots)
            labels += [f"coefficients of {name}"] * drawn
            labels += ["coefficient_spread"] * len(source.models[0].terms)
            labels.append(f"hold-out error of {name}")
        return (*labels, *self._unknowns.labels)

    def by_source(self, energy: Estimate) -> dict[str, float]:
        """Return the standard deviation that each source of doubt alone gives an energy [J].

        The largest comes first; their squares add up to the variance.
        """
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
        heavier = self._mission.payload_models.get(model.name, {})
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
        return _Source(
            np.array([payload for payload, _ in nodes]),
            tuple(other for _, other in nodes),
            sum(source.size for source in self._sources),
            tuple(_root(other) for _, other in nodes),
        )

    def _refuse_unfounded_bounds(self) -> None:
        mission = self._mission
        for model in (model for source in self._sources for model in source.models):
            if reason := unfounded(model, mission.confidence, mission.coefficient_spread):
                raise MissionError(reason, ("model",))

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

    def model(self, region: int, payload: float) -> PowerModel:
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
            spread = self._mission.coefficient_spread * self.model(region, payload).coefficients
            self._directions[key] = np.column_stack([*columns, np.diag(spread)])
        return self._directions[key]

    def drive(self, trajectory: Trajectory, payload: float) -> Drive:
        """Return a trajectory over the grounds with a payload [kg], as the battery feels it."""
        mission = self._mission
        first, *others = (
            self.model(k, payload).battery_side() for k in range(len(self._source_of))
        )
        ground = Ground(first, mission.surfaces, mission.heights, tuple(others))
        return Drive(trajectory, ground)

    def estimate(self, trajectory: Trajectory, payload: float) -> Estimate:
        """Return the energy of a trajectory with a payload [kg], at the battery."""
        total = self.nothing
        for part in self.drive(trajectory, payload).quadrature():
            energy = self._one(part.region, part.motion, part.weight, payload)
            run = self._run_spread(part.region) * energy.mean
            total = total + energy + self._unknown(RUN, run)
        return total

    def spread(self, trajectory: Trajectory, payload: float) -> FloatArray:
        """Return the standard deviation of the power in each interval [W], shape (n - 1,).

        It tells where along a trajectory the uncertainty of its energy arises: energies may
        cancel, uncertainties of powers do not.
        """
        joules = np.zeros(len(trajectory) - 1)
        for part in self.drive(trajectory, payload).quadrature():
            model = self.model(part.region, payload)
            watts = model.battery_side().power(part.motion)
            squares = (self._holdout(part.region, payload).error * watts) ** 2
            squares += (self._run_spread(part.region) * watts) ** 2
            for step in self.directions(part.region, payload).T:
                if step.any():
                    more, less = (
                        model.with_coefficients(model.coefficients + sign * step)
                        .battery_side()
                        .power(part.motion)
                        for sign in (1.0, -1.0)
                    )
                    squares += (0.5 * (more - less)) ** 2
            np.add.at(joules, part.interval, (part.weight * np.sqrt(squares)).sum(axis=-1))
        return np.asarray(joules / np.diff(trajectory.t))

    def _run_spread(self, region: int) -> float:
        """Return how far a model's power differs from run to run, as a fraction."""
        source = self._sources[self._source_of[region]]
        found = [m.residual.run_spread for m in source.models if m.residual is not None]
        known = [spread for spread in found if spread is not None]
        return max(known) if known else self._mission.spreads.run

    def _holdout(self, region: int, payload: float) -> _Holdout:
        """Return what a model missed on the hold-out; models between payloads are weighed."""
        source = self._sources[self._source_of[region]]
        residuals = [m.residual for m in source.models if m.residual is not None]
        if not residuals:
            return _Holdout(0.0, 0.0)
        weights = self._weights(source, payload)[[m.residual is not None for m in source.models]]
        weights = weights / weights.sum() if weights.sum() > 0 else weights + 1 / len(weights)
        return _Holdout(
            float(weights @ [abs(r.energy_error) for r in residuals]),
            float(weights @ [2 * r.rmse**2 * r.correlation_time for r in residuals]),
        )

    def power(self, trajectory: Trajectory, payload: float) -> FloatArray:
        """Return the mean power of each interval of a trajectory [W], shape (n - 1,)."""
        drive = self.drive(trajectory, payload)
        return np.asarray(drive.interval_energies() / np.diff(trajectory.t))

    def idle(self, region: int, duration: float, payload: float) -> Estimate:
        """Return the energy of standing still for so long [s]."""
        key = (region, payload)
        if key not in self._idle:
            motion = _straight(self.model(region, payload), 0.0)
            self._idle[key] = self._one(region, motion, np.ones(1), payload)
        second = self._idle[key]
        # The residual is what the model misses while driving.
        return Estimate(duration * second.mean, duration * second.sensitivity)

    def work(self, region: int, task: int, payload: float) -> Estimate:
        """Return the energy of doing a task, standing still with its tool."""
        asked, spreads = self._mission.tasks[task], self._mission.spreads
        idle = self.idle(region, asked.dwell, payload)
        drawn = asked.power + self.idle(region, 1.0, payload).mean
        tool = spreads.power * asked.power if asked.power_spread is None else asked.power_spread
        done = replace(idle, mean=idle.mean + asked.power * asked.dwell)
        done = done + self._unknown(self._unknowns.tools[task], tool * asked.dwell)
        return done + self._unknown(self._unknowns.dwells[task], self._dwell_spread(task) * drawn)

    def waiting(self, region: int, task: int, payload: float) -> Estimate:
        """Return the energy of the time lost before a task begins."""
        idle = self.idle(region, self._mission.waiting, payload)
        spread = self._mission.spreads.waiting * idle.mean
        return idle + self._unknown(self._unknowns.waits[task], spread)

    # -- time -------------------------------------------------------------------------------------

    def driving_time(self, duration: float) -> FloatArray:
        """Return how a drive's duration changes with each unknown [s], shape (size,)."""
        return self._sensitivity(self._unknowns.speed, self._mission.spreads.speed * duration)

    def waiting_time(self, task: int) -> FloatArray:
        """Return how the time lost before a task changes with each unknown [s]."""
        spread = self._mission.spreads.waiting * self._mission.waiting
        return self._sensitivity(self._unknowns.waits[task], spread)

    def dwell_time(self, task: int) -> FloatArray:
        """Return how the duration of a task changes with each unknown [s]."""
        return self._sensitivity(self._unknowns.dwells[task], self._dwell_spread(task))

    def _dwell_spread(self, task: int) -> float:
        asked = self._mission.tasks[task]
        told = asked.dwell_spread
        return self._mission.spreads.dwell * asked.dwell if told is None else told

    def _sensitivity(self, place: int, value: float) -> FloatArray:
        sensitivity = np.zeros(self.size)
        sensitivity[self._models + place] = value
        return sensitivity

    def _unknown(self, place: int, energy: float) -> Estimate:
        """Return an energy that is nothing but its sensitivity to one unknown [J]."""
        return Estimate(0.0, self._sensitivity(place, energy))

    # -- battery ----------------------------------------------------------------------------------

    def from_battery(self, energy: Estimate) -> Estimate:
        """Return an energy as the battery's charge feels it.

        A battery that holds less than it should is emptied by a drive as one that holds what it
        should is by a dearer drive.
        """
        sensitivity = energy.sensitivity.copy()
        for place, share in self._unknowns.battery.items():
            sensitivity[self._models + place] += share * energy.mean
        return replace(energy, sensitivity=sensitivity)

    @property
    def gauge(self) -> Estimate:
        """What is open about the charge after it was read off the gauge, as an energy."""
        return self._unknown(self._unknowns.gauge, self._unknowns.gauge_energy)

    @property
    def driving_power(self) -> float:
        """Power of driving straight on, at the speed asked or a usual one [W]."""
        mission = self._mission
        model = self.model(0, mission.payload)
        vehicle = model.vehicle
        asked = mission.tread_speed or np.inf
        speed = min(asked, vehicle.usual_speed, vehicle.motor.speed, _USUAL_SPEED)
        power = model.battery_side().power(_straight(model, float(speed)))
        return max(float(power[0]), 1.0)

    def _one(self, region: int, motion: Motion, weight: FloatArray, payload: float) -> Estimate:
        """Integrate over instants of a motion that stand for so much time each [s]."""
        model = self.model(region, payload)
        source = self._sources[self._source_of[region]]

        def energy(coefficients: FloatArray) -> float:
            power = model.with_coefficients(coefficients).battery_side().power(motion)
            return float((weight * power).sum())

        values = model.coefficients
        mean = energy(values)
        sensitivity = np.zeros(self.size)
        for j, step in enumerate(self.directions(region, payload).T):
            if step.any():
                change = 0.5 * (energy(values + step) - energy(values - step))
                sensitivity[source.first + j] = change
        missed = self._holdout(region, payload)
        sensitivity[source.first + source.size - 1] = missed.error * mean
        noise = missed.strength * float(weight.sum())
        return Estimate(mean, sensitivity, noise)


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
