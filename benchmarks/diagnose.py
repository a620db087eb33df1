"""What diagnosis finds, and how fast.

    python benchmarks/diagnose.py                  simulated: false finds, hidden effects, speed
    python benchmarks/diagnose.py million          time and memory of a million samples
    python benchmarks/diagnose.py engine FOLDER    a physics engine, one hidden effect a drive
    python benchmarks/diagnose.py husky FOLDER...  runs of a Husky, one surface a folder

"Told" is a model that was told the true effect, fitted to the same drives without any choice. The
engine's folder holds SCENARIO_sSEED_(ident|valid).csv.gz with side-cars of the true effect; a
surface's folder holds pro_NN.csv and imu_NN.csv.
"""

from __future__ import annotations

import resource
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from calibration import advised

from energyplan import DriveLog, diagnose, identify, simulate
from energyplan.diagnosis import Diagnosis
from energyplan.fit import fit_residual
from energyplan.io.husky import read_husky
from energyplan.power import HOTEL, REGENERATION_LOSS, SLIP, TABLE_II, TRACTION, PowerModel
from energyplan.power import effects as catalogue
from energyplan.power.effects import (
    DRAGGING_LEFT,
    MOBILISATION,
    SLIP_SPEED,
    TOWING_FORCE,
    TURN_ASYMMETRY,
)
from energyplan.vehicle import Vehicle

TRUE = {
    "body_force": ("towing_force",),
    "com_offset": ("centre_of_mass",),
    "copper_loss": ("copper_loss",),
    "dragging_wheel": ("dragging_wheel_left",),
    "driver_efficiency": ("regeneration_efficiency",),
    "hotel_load": ("hotel_load",),
    "load_change": ("payload_change",),
    "quadratic_drag": ("air_drag",),
    "slip_friction": ("stribeck_friction",),
    "slope": ("tilted_plane",),
    "slope_copper": ("tilted_plane", "copper_loss"),
    "terrain_change": ("surface_border",),
    "tow": ("towed_drag",),
    "viscous": ("viscous_loss",),
    "warmup": ("warm_up",),
    "warmup_com": ("warm_up", "centre_of_mass"),
}
"""Effects of the catalogue that the engine's scenarios hide; the others show inertia alone."""


# -- simulated drives -----------------------------------------------------------------------------


def hidden_effect(name: str, rng: np.random.Generator, model: PowerModel) -> tuple[Any, ...]:
    """Return a model with a hidden effect of random size, options of the drive, and the size."""
    share, side = rng.uniform(0.6, 1.4), rng.choice([-1.0, 1.0])
    sizes = {
        "hotel_load": (HOTEL, 40 * share),
        "viscous_loss": (catalogue.VISCOUS_LOSS, 50 * share),
        "air_drag": (catalogue.AIR_DRAG, 80 * share),
        "copper_loss": (catalogue.COPPER_LOSS, 5e-4 * share),
        "regeneration_efficiency": (REGENERATION_LOSS, min(0.8 * share, 1.0)),
        "dragging_wheel_left": (DRAGGING_LEFT, 30 * share * side),
        "turn_asymmetry": (TURN_ASYMMETRY, 0.06 * share * side),
        "slip_speed_friction": (SLIP_SPEED, 0.4 * share * side),
        "towing_force": (TOWING_FORCE, 25 * share * side),
    }
    options: dict[str, Any] = {"without": {"accel_x"}}
    if name in sizes:
        term, size = sizes[name]
        return model.with_term(term, size), options, size
    mass = model.vehicle.mass
    match name:
        case "tilted_plane":
            angle = np.radians(4 * share)
            options |= {"slope": angle, "uphill": rng.uniform(-3, 3)}
            options["without"] = {"accel_x", "slope"}
            return model.with_term(catalogue.GRADE, mass), options, angle
        case "grade":
            options |= {"slope": np.radians(4 * share), "uphill": rng.uniform(-3, 3)}
            return model.with_term(catalogue.GRADE, mass), options, mass
        case "linear_inertia":
            options["accel_limit"] = 1.0
            return model.with_term(catalogue.LINEAR_INERTIA, mass * share), options, mass * share
        case "angular_inertia":
            size = 2 * model.vehicle.yaw_inertia * share
            options["accel_limit"] = 1.5
            return model.with_term(catalogue.ANGULAR_INERTIA, size), options, size
        case "warm_up":
            term = replace(catalogue.WARM_UP, params={"time_constant": rng.uniform(30, 90)})
            return model.with_term(term, 35 * share), options, 35 * share
        case "friction_mobilisation":
            term = replace(MOBILISATION, params={"radius": rng.uniform(0.3, 3)})
            size = 0.8 * model.coefficient("slip_friction")
            return model.with_term(term, size), options, size
        case "payload_change":
            factor = 1 + 0.3 * share * side
            lighter = model.with_coefficients(model.coefficients * [factor, 0.5 + 0.5 * factor])
            options["changes"] = [(rng.uniform(45, 80), lighter)]
            return model, options, mass * (factor - 1)
        case _:
            delay = rng.uniform(0.3, 0.8)
            options["delays"] = {"p_left": delay, "p_right": delay}
            return model, options, delay


HIDDEN = (
    "hotel_load", "viscous_loss", "air_drag", "copper_loss", "regeneration_efficiency",
    "dragging_wheel_left", "turn_asymmetry", "slip_speed_friction",
    "towing_force", "tilted_plane", "grade", "linear_inertia", "angular_inertia", "warm_up",
    "friction_mobilisation", "payload_change", "time_offset",
)  # fmt: skip


def simulated_case(seed: int, name: str | None, **noise: float) -> tuple[Diagnosis, float]:
    """Diagnose a pair of simulated drives that hide one effect or none."""
    rng = np.random.default_rng(seed)
    model = PowerModel.preset(str(rng.choice(sorted(TABLE_II))))
    vehicle, options, size = model.vehicle, {"without": {"accel_x"}}, 0.0
    if name is not None:
        model, options, size = hidden_effect(name, rng, model)
    options = {"power_noise": 5.0, "speed_noise": 0.005, **options, **noise}
    train = simulate.identification_drive(model, seed=2 * seed, **options)
    unseen = simulate.validation_drive(model, seed=2 * seed + 1, **options)
    return advised(train, unseen, vehicle), size


def false_finds(count: int = 100) -> None:
    """Count what is claimed on drives that hide nothing."""
    verdicts: dict[str, int] = {}
    for seed in range(count):
        noise = {"correlation_time": (0.0, 0.0, 0.5, 2.0)[seed % 4], "power_noise": 2.0 + seed % 8}
        told, _ = simulated_case(1000 + seed, None, **noise)
        verdicts[told.verdict] = verdicts.get(told.verdict, 0) + 1
        if told.verdict != "no_effect":
            what = [e.name for e in told.effects] or [u.shape for u in told.unexplained[:1]]
            print(f"  drive {seed}: {told.verdict} {what}")
    print(f"{count} drives that hide nothing: {verdicts}\n")


def hidden_finds(count: int = 4) -> None:
    """Name and size hidden effects of random size."""
    print(f"{'hidden':24}{'first':>8}{'rival':>7}{'size error':>12}{'worse':>7}")
    named = total = 0
    for index, name in enumerate(HIDDEN):
        first = rival = worse = 0
        errors = []
        for k in range(count):
            told, size = simulated_case(100 * index + k, name)
            if told.effects and told.effects[0].name == name:
                first += 1
                errors.append(abs(told.effects[0].value / size - 1))
            elif told.effects and name in told.effects[0].rivals:
                rival += 1
            worse += told.after.rmse > told.before.rmse
        named, total = named + first + rival, total + count
        error = f"{100 * np.median(errors):.1f} %" if errors else "-"
        print(f"{name:24}{first:>5}/{count}{rival:>7}{error:>12}{worse:>7}")
    print(f"named: {named} of {total}\n")


def speed() -> None:
    """Time the diagnosis of ten drives."""
    model = PowerModel.preset("quadriga:full:concrete").with_term(HOTEL, 30.0)
    for extra in (catalogue.VISCOUS_LOSS, catalogue.COPPER_LOSS):
        truth = model.with_term(extra, 40.0 if extra.kind == "force" else 4e-4)
        noise = {"power_noise": 5.0, "speed_noise": 0.005}
        train = [simulate.identification_drive(truth, seed=k, **noise) for k in range(10)]
        unseen = simulate.validation_drive(truth, seed=99, **noise)
        start = time.perf_counter()
        told = diagnose(train, unseen, model.vehicle)
        spent = time.perf_counter() - start
        start = time.perf_counter()
        identify(train, model.vehicle)
        ratio = spent / (time.perf_counter() - start)
        names = [effect.name for effect in told.effects]
        print(f"10 drives of 150 s: {spent:.1f} s, {ratio:.0f} times identify; found {names}")


def million() -> None:
    """Time a million samples: few long drives, many short ones, fast and slow sampling."""
    model = PowerModel.preset("quadriga:full:concrete").with_term(HOTEL, 30.0)
    truth = model.with_term(catalogue.VISCOUS_LOSS, 40.0)
    noise = {"power_noise": 5.0, "speed_noise": 0.005}
    for count, rate in ((10, 100.0), (10, 20.0), (333, 20.0)):
        duration = 1e6 / count / rate
        train = [
            simulate.identification_drive(truth, seed=k, rate=rate, duration=duration, **noise)
            for k in range(count)
        ]
        unseen = simulate.validation_drive(truth, seed=999, **noise)
        wall, cpu = time.perf_counter(), time.process_time()
        told = diagnose(train, unseen, model.vehicle)
        wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
        samples = sum(len(log) for log in train)
        print(
            f"{samples} samples in {count} drives at {rate:g} Hz: {wall:.1f} s, "
            f"{cpu:.1f} s of CPU, peak so far {peak:.0f} MB; "
            f"found {[effect.name for effect in told.effects]}"
        )


# -- recorded drives ------------------------------------------------------------------------------


def engine(folder: Path) -> None:
    """Print one line for each scenario and seed, and whether the first explanation is right."""
    entries, ratios, right = catalogue.catalogue(), [], 0
    for ident in sorted(folder.glob("*_ident.csv.gz")):
        stem = ident.name.removesuffix("_ident.csv.gz")
        vehicle = Vehicle.preset("quadriga" if "empty" in stem else "quadriga:full")
        train, unseen = DriveLog.read(ident), DriveLog.read(folder / f"{stem}_valid.csv.gz")
        told = advised(train, unseen, vehicle)
        hidden = TRUE.get(stem.rpartition("_s")[0], ("linear_inertia",))
        # Every drive of the engine has inertia, whatever else it hides.
        really = dict.fromkeys(["linear_inertia", "angular_inertia", *hidden])
        known = [entries[name] for name in really]
        oracle = diagnose(train, unseen, vehicle, effects=known, choose=False).after.rmse
        ratios.append(told.after.rmse / oracle)
        first = told.explanations[0]
        usual = [e.name for e in told.effects if entries[e.name].usual]
        others = [e.name for e in told.effects if e.name not in usual]
        named = set(hidden) <= set(others or usual)
        right += named
        sizes = ", ".join(f"{e.name} {e.value:.4g} +- {e.std_error:.2g}" for e in told.effects)
        print(
            f"{stem:23}{'right' if named else 'WRONG':6} p {first.probability:.2f}  rmse "
            f"{told.before.rmse:6.2f} -> {told.after.rmse:6.2f} (told {oracle:6.2f}), energy "
            f"{told.after.energy_error:+.2%}  {sizes}"
        )
    within = np.mean(np.array(ratios) <= 1.15)
    print(
        f"right first: {right} of {len(ratios)}; RMSE at most 1.15 times that of a model that was "
        f"told in {within:.0%}, worst {max(ratios):.2f}"
    )


def husky(folder: Path) -> None:
    """Leave one run out after the other: errors of energies, and what their intervals hold."""
    vehicle = Vehicle.preset("husky_a200")
    kinds: tuple[Literal["keep", "drop"], ...] = ("keep", "drop")
    for blind in kinds:
        logs = [read_husky(path, blind=blind) for path in sorted(folder.glob("pro_*.csv"))]
        logs = [log for log in logs if log.duration >= 16.0]
        rows, names = [], list[str]()
        for k, unseen in enumerate(logs):
            rest = [log for j, log in enumerate(logs) if j != k]
            told = diagnose(rest, unseen, vehicle)
            paper = identify(rest, vehicle, terms=(SLIP, TRACTION)).model
            (one,) = told.predictions
            low, high = one.energy_interval
            lad = abs(fit_residual(paper, unseen).energy_error)
            rows.append([lad, abs(one.energy / one.measured - 1), low <= one.measured <= high])
            names.append(" + ".join(effect.name for effect in told.effects) or "none")
        lad, after, held = np.mean(rows, axis=0)
        worse = sum(row[1] > row[0] + 0.01 for row in rows)
        often = {name: names.count(name) for name in dict.fromkeys(names)}
        print(
            f"{folder.name}, blind samples: {blind}, {len(logs)} runs: mean |energy error| "
            f"{lad:.1%} by least absolute deviations, {after:.1%} by diagnosis; worse by more than "
            f"a point: {worse}; 90 % intervals that hold the energy: {held:.0%}\n    {often}"
        )


if __name__ == "__main__":
    match sys.argv[1:]:
        case []:
            false_finds()
            hidden_finds()
            speed()
        case ["million"]:
            million()
        case ["engine", folder]:
            engine(Path(folder))
        case ["husky", *folders] if folders:
            for folder in folders:
                husky(Path(folder))
        case _:
            sys.exit(__doc__)
