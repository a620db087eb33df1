"""What diagnosis finds, and how fast.

    python benchmarks/diagnose.py                  simulated: false finds, hidden effects, speed
    python benchmarks/diagnose.py engine FOLDER    a physics engine, one hidden effect a drive
    python benchmarks/diagnose.py husky FOLDER...  runs of a Husky, one surface a folder

The engine's folder holds SCENARIO_sSEED_(ident|valid).csv.gz with side-cars of the true effect; a
surface's folder holds pro_NN.csv and imu_NN.csv.
"""

from __future__ import annotations

import json
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from energyplan import DriveLog, diagnose, identify, simulate
from energyplan import effects as catalogue
from energyplan.diagnose import Diagnosis
from energyplan.effects._terms import (
    DRAGGING_LEFT,
    MOBILISATION,
    SLIP_SPEED,
    TOWING_FORCE,
    TRACTION_ASYMMETRY,
    TURN_ASYMMETRY,
)
from energyplan.identify import fit_residual
from energyplan.io.husky import read_husky
from energyplan.power import HOTEL, REGENERATION_LOSS, SLIP, TABLE_II, TRACTION, PowerModel
from energyplan.vehicle import Vehicle

TRUE = {
    "com_offset": "centre_of_mass",
    "copper_loss": "copper_loss",
    "hotel_load": "hotel_load",
    "inertia": "linear_inertia",
    "load_change": "payload_change",
    "slope": "tilted_plane",
    "viscous": "viscous_loss",
    "warmup": "warm_up",
}
"""Effect of the catalogue that each of the engine's scenarios hides."""


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
        "traction_asymmetry": (TRACTION_ASYMMETRY, 20 * share * side),
        "dragging_wheel_left": (DRAGGING_LEFT, 30 * share),
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
    "traction_asymmetry", "dragging_wheel_left", "turn_asymmetry", "slip_speed_friction",
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
    return diagnose(train, unseen, vehicle), size


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


# -- recorded drives ------------------------------------------------------------------------------


def true_size(scenario: str, side_car: dict[str, Any]) -> float:
    """Return the size of a scenario's effect in the unit of the catalogue."""
    effect, true = side_car["effects"].get(scenario, {}), side_car["true"]
    match scenario:
        case "com_offset":
            return float(np.hypot(effect["forward_m"], effect["left_m"]))
        case "copper_loss":
            radius = true["wheel_radius_m"] / effect["kt_Nm_per_A_at_wheel"]
            return float(effect["R_ohm"] * radius**2)
        case "hotel_load":
            return float(effect["power_W_total"])
        case "load_change":
            return float(effect["mass_after_kg"] - effect["mass_before_kg"])
        case "slope":
            return float(np.radians(effect["angle_deg"]))
        case "viscous":
            return float(effect["N_per_mps_per_side"])
        case "warmup":
            return float(effect["relative_excess_at_0"] * true["K_internal_N_per_side"])
        case _:
            return float(true["mass_equivalent_straight_kg"])


def engine(folder: Path) -> None:
    """Print one line for each scenario and seed."""
    print(
        f"{'scenario':22}{'first effect':20}{'size':>10}{'true':>10}{'error':>8}"
        f"{'rmse before':>12}{'after':>8}{'energy':>9}  then"
    )
    for ident in sorted(folder.glob("*_ident.csv.gz")):
        stem = ident.name.removesuffix("_ident.csv.gz")
        scenario = stem.rpartition("_s")[0]
        vehicle = Vehicle.preset("quadriga" if "empty" in stem else "quadriga:full")
        side_car = json.loads((folder / f"{stem}_ident.json").read_text())
        told = diagnose(
            DriveLog.read(ident), DriveLog.read(folder / f"{stem}_valid.csv.gz"), vehicle
        )
        wanted, size = TRUE.get(scenario, "linear_inertia"), true_size(scenario, side_car)
        found = next((e for e in told.effects if e.name == wanted), told.effects[0])
        first = told.effects[0].name
        print(
            f"{stem:22}{first:20}{found.value:>10.4g}{size:>10.4g}{found.value / size - 1:>+8.1%}"
            f"{told.before.rmse:>12.2f}{told.after.rmse:>8.2f}{told.after.energy_error:>+9.2%}  "
            + ", ".join(e.name for e in told.effects[1:])
        )


def husky(folder: Path) -> None:
    """Leave one run out after the other: energy error of the paper's and the extended model.

    A change of payload or surface is dated on the held-out run itself, which flatters it; the
    extended model is therefore shown without such effects as well.
    """
    foretold = [e for e in catalogue.catalogue().values() if e.acts not in ("change", "place")]
    vehicle = Vehicle.preset("husky_a200")
    logs = [read_husky(path) for path in sorted(folder.glob("pro_*.csv"))]
    logs = [log for log in logs if log.duration >= 16.0]
    inertial = [log for log in logs if log.has("accel_x")]
    for label, chosen in (("wheels only", [_wheels(log) for log in logs]), ("with IMU", inertial)):
        before, after, dated, lad, names = [], [], [], [], []
        for k, unseen in enumerate(chosen):
            rest = [log for j, log in enumerate(chosen) if j != k]
            dated.append(diagnose(rest, unseen, vehicle).after.energy_error)
            told = diagnose(rest, unseen, vehicle, effects=foretold)
            before.append(told.before.energy_error)
            after.append(told.after.energy_error)
            paper = identify(rest, vehicle, terms=(SLIP, TRACTION)).model
            lad.append(fit_residual(paper, unseen).energy_error)
            names += [effect.name for effect in told.effects]
        often = {name: names.count(name) for name in dict.fromkeys(names)}
        means = [100 * float(np.mean(np.abs(values))) for values in (lad, before, after, dated)]
        print(
            f"{folder.name:12}{label:12}{len(chosen):3} runs: mean |energy error| "
            f"LAD {means[0]:.1f} %, paper's model {means[1]:.1f} %, extended {means[2]:.1f} %, "
            f"with changes dated on the run {means[3]:.1f} %"
        )
        print(f"{'':24}effects, and in how many of the fits: {often}")
        for line in told.advice[:4]:
            print(f"{'':24}{line}")


def _wheels(log: DriveLog) -> DriveLog:
    channels = {k: v for k, v in log.channels.items() if k not in ("accel_x", "yaw_rate")}
    return replace(log, channels=channels)


if __name__ == "__main__":
    match sys.argv[1:]:
        case []:
            false_finds()
            hidden_finds()
            speed()
        case ["engine", folder]:
            engine(Path(folder))
        case ["husky", *folders] if folders:
            for folder in folders:
                husky(Path(folder))
        case _:
            sys.exit(__doc__)
