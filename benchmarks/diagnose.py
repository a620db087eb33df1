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

import json
import resource
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from energyplan import DriveLog, diagnose, identify, simulate
from energyplan.diagnosis import Diagnosis
from energyplan.fit import fit_residual
from energyplan.io.husky import read_husky
from energyplan.power import HOTEL, REGENERATION_LOSS, SLIP, TABLE_II, TRACTION, PowerModel
from energyplan.power import effects as catalogue
from energyplan.power.effect_terms import (
    DRAGGING_LEFT,
    MOBILISATION,
    SLIP_SPEED,
    TOWING_FORCE,
    TRACTION_ASYMMETRY,
    TURN_ASYMMETRY,
)
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
        f"{'scenario':23}{'first effect':20}{'size':>10}{'true':>10}{'error':>8}"
        f"{'rmse before':>12}{'after':>8}{'told':>8}{'ratio':>7}{'energy':>9}  then"
    )
    entries, ratios = catalogue.catalogue(), []
    for ident in sorted(folder.glob("*_ident.csv.gz")):
        stem = ident.name.removesuffix("_ident.csv.gz")
        scenario = stem.rpartition("_s")[0]
        vehicle = Vehicle.preset("quadriga" if "empty" in stem else "quadriga:full")
        side_car = json.loads((folder / f"{stem}_ident.json").read_text())
        train, unseen = DriveLog.read(ident), DriveLog.read(folder / f"{stem}_valid.csv.gz")
        told = diagnose(train, unseen, vehicle)
        # Every drive of the engine has inertia, whatever else it hides.
        really = dict.fromkeys(["linear_inertia", "angular_inertia", *_hidden(scenario)])
        known = [entries[name] for name in really]
        oracle = diagnose(train, unseen, vehicle, effects=known, choose=False).after.rmse
        ratios.append(told.after.rmse / oracle)
        wanted, size = TRUE.get(scenario, "linear_inertia"), true_size(scenario, side_car)
        found = next((e for e in told.effects if e.name == wanted), told.effects[0])
        first = told.effects[0].name
        print(
            f"{stem:23}{first:20}{found.value:>10.4g}{size:>10.4g}{found.value / size - 1:>+8.1%}"
            f"{told.before.rmse:>12.2f}{told.after.rmse:>8.2f}{oracle:>8.2f}{ratios[-1]:>7.3f}"
            f"{told.after.energy_error:>+9.2%}  " + ", ".join(e.name for e in told.effects[1:])
        )
    print(f"RMSE after over that of a model that was told: worst {max(ratios):.3f}")


def _hidden(scenario: str) -> list[str]:
    return [TRUE[scenario]] if scenario in TRUE else []


def husky(folder: Path) -> None:
    """Leave one run out after the other: error of the paper's and the extended model.

    All models of a line predict the same samples of the same runs. "All samples" keeps arcs in
    which the inner motor reads nothing and takes its power as zero; "credible" leaves them out. A
    change of payload or surface is dated on the held-out run itself, which flatters it, so that
    the extended model has no such effect here.
    """
    vehicle = Vehicle.preset("husky_a200")
    kinds: tuple[tuple[str, Literal["keep", "drop"]], ...] = (
        ("all samples", "keep"),
        ("credible", "drop"),
    )
    for label, blind in kinds:
        logs = [read_husky(path, blind=blind) for path in sorted(folder.glob("pro_*.csv"))]
        logs = [log for log in logs if log.duration >= 16.0]
        inertial = [log for log in logs if log.has("accel_x")]
        _leave_one_out(f"{folder.name}, {label}", [_wheels(log) for log in logs], vehicle)
        _leave_one_out(f"{folder.name}, {label}, IMU", inertial, vehicle)


def _leave_one_out(label: str, logs: list[DriveLog], vehicle: Vehicle) -> None:
    foretold = [e for e in catalogue.catalogue().values() if e.acts not in ("change", "place")]
    energy, rmse, names, worse = [], [], [], 0
    for k, unseen in enumerate(logs):
        rest = [log for j, log in enumerate(logs) if j != k]
        told = diagnose(rest, unseen, vehicle, effects=foretold)
        paper = identify(rest, vehicle, terms=(SLIP, TRACTION)).model
        scores = (fit_residual(paper, unseen), told.before, told.after)
        energy.append([100 * abs(score.energy_error) for score in scores])
        rmse.append([score.rmse for score in scores])
        names += [effect.name for effect in told.effects]
        worse += bool(told.effects) and told.after.rmse > told.before.rmse
    lad, before, after = np.mean(energy, axis=0)
    print(
        f"{label}, {len(logs)} runs: mean |energy error| LAD {lad:.1f} %, paper's model "
        f"{before:.1f} %, extended {after:.1f} % ({after / lad - 1:+.0%} of LAD's); mean RMSE "
        + ", ".join(f"{value:.1f}" for value in np.mean(rmse, axis=0))
        + f" W; runs that an effect made worse: {worse}"
    )
    often = {name: names.count(name) for name in dict.fromkeys(names)}
    print(f"    effects, and in how many of the fits: {often}")
    for line in told.advice:
        if line.startswith(("drives differ", "linear inertia", "specific force")):
            print(f"    {line}")


def _wheels(log: DriveLog) -> DriveLog:
    channels = {k: v for k, v in log.channels.items() if k not in ("accel_x", "yaw_rate")}
    return replace(log, channels=channels)


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
