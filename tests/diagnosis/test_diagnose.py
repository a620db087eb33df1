"""Diagnosis: hidden effects are named and sized, nothing is claimed where nothing is hidden."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from by_day import by_day
from made_drives import pair
from scipy.ndimage import minimum_filter1d
from scipy.stats import kstest

from energyplan import DriveLog, EnergyCost, diagnose, simulate
from energyplan.diagnosis import Dependence, Diagnosis
from energyplan.diagnosis.judge import find_mass_centre, twist
from energyplan.diagnosis.residual import dependences
from energyplan.errors import DriveLogError, InvalidInputError
from energyplan.fit.drive import Drive, quiet, speed_noise
from energyplan.fit.estimate import Fit, Problem, fit
from energyplan.fit.regressors import block_grams
from energyplan.motion import Motion
from energyplan.power import HOTEL, SLIP, TABLE_II, TRACTION, PowerModel, Sides, Term, effects
from energyplan.power.effects import catalogue
from energyplan.vehicle import GRAVITY, Vehicle, wheel_loads

NOISE: dict[str, Any] = {"power_noise": 5.0, "speed_noise": 0.005}
PAPER = PowerModel.preset("quadriga:full:concrete")
VEHICLE = PAPER.vehicle
FEW = [catalogue()[name] for name in ("hotel_load", "air_drag", "copper_loss")]
"""Effects to choose from where the search is not what is tried."""


def _told(
    model: PowerModel, seed: int = 1, count: int = 1, keep: tuple[str, ...] = (), **options: Any
) -> Diagnosis:
    """Diagnose simulated drives of a model, without slope and accelerometer channels."""
    hidden = {"accel_x", *(("slope",) if options.get("slope") else ())} - set(keep)
    options = {**NOISE, **options, "without": hidden}
    train = [
        simulate.identification_drive(model, seed=10 * seed + k, name=f"train {k}", **options)
        for k in range(count)
    ]
    unseen = simulate.validation_drive(model, seed=10 * seed + 9, name="unseen", **options)
    return diagnose(train, unseen, model.vehicle)


@cache
def _told_load() -> Diagnosis:
    """Diagnose a load of 30 W: for two tests."""
    return _told(PAPER.with_term(HOTEL, 30.0))


HIDDEN: dict[str, tuple[Term, float, dict[str, Any]]] = {
    "hotel_load": (HOTEL, 25.0, {}),
    "grade": (effects.GRADE, 147.1, {"slope": 0.06, "uphill": 0.7, "keep": ("slope",)}),
    "linear_inertia": (effects.LINEAR_INERTIA, 150.0, {"accel_limit": 1.0}),
    "angular_inertia": (effects.ANGULAR_INERTIA, 30.0, {"accel_limit": 1.5}),
    "viscous_loss": (effects.VISCOUS_LOSS, 40.0, {}),
    "air_drag": (effects.AIR_DRAG, 90.0, {}),
    "copper_loss": (effects.COPPER_LOSS, 4e-4, {}),
    "warm_up": (replace(effects.WARM_UP, params={"time_constant": 50.0}), 35.0, {}),
    "dragging_wheel_left": (effects.DRAGGING_LEFT, -30.0, {}),
    "turn_asymmetry": (effects.TURN_ASYMMETRY, -0.06, {}),
    "slip_speed_friction": (effects.SLIP_SPEED, 0.35, {}),
    "friction_mobilisation": (replace(effects.MOBILISATION, params={"radius": 1.0}), 0.4, {}),
    "towing_force": (effects.TOWING_FORCE, -25.0, {}),
}

ALONE = (
    "grade", "angular_inertia", "air_drag", "warm_up", "dragging_wheel_left",
    "slip_speed_friction", "friction_mobilisation", "towing_force",
)  # fmt: skip
"""Effects that no other test finds by day."""


@pytest.mark.parametrize("name", by_day(HIDDEN, ALONE))
def test_a_hidden_effect_is_named_and_sized(name: str) -> None:
    term, size, options = HIDDEN[name]
    told = _told(PAPER.with_term(term, size), **options)
    assert told.verdict == "effect_found"
    first = told.effects[0]
    assert name == first.name or name in first.rivals
    if name == first.name:
        assert abs(first.value - size) < max(0.15 * abs(size), 3 * first.std_error)
    assert told.after.rmse < told.before.rmse
    assert abs(told.after.energy_error) < 0.02
    assert told.after_interval.rmse[0] <= told.after.rmse <= told.after_interval.rmse[1]


def test_a_tilted_plane_is_found_from_the_heading_alone() -> None:
    told = _told(PAPER.with_term(effects.GRADE, VEHICLE.mass), slope=0.07, uphill=-1.1)
    first = told.effects[0]
    assert first.name == "tilted_plane"
    assert first.value == pytest.approx(0.07, abs=4 * first.std_error)
    uphill = np.arctan2(first.details["tilt_y"], first.details["tilt_x"])
    assert uphill == pytest.approx(-1.1, abs=0.05)


def test_an_accelerometer_shows_weight_and_inertia_together() -> None:
    model = PAPER.with_term(effects.GRADE, 160.0).with_term(effects.LINEAR_INERTIA, 160.0)
    options = {**NOISE, "slope": 0.05, "without": {"slope", "x", "y", "yaw"}, "accel_limit": 0.6}
    first = diagnose(*pair(model, **options), VEHICLE).effects[0]
    assert first.name == "specific_force"
    assert first.value == pytest.approx(160.0, rel=0.05)


def test_a_payload_change_is_found_with_its_time() -> None:
    lighter = PAPER.with_coefficients(PAPER.coefficients * [0.7, 0.85])
    options = {**NOISE, "without": {"accel_x"}}
    drives = [
        make(PAPER, seed=k, name=f"drive {k}", changes=[(time, lighter)], **options)
        for k, (make, time) in enumerate(
            [(simulate.identification_drive, 70.0), (simulate.validation_drive, 55.0)]
        )
    ]
    told = diagnose(drives[0], drives[1], VEHICLE)
    assert "payload_change" not in [effect.name for effect in told.effects]
    assert "change" in told.suspects
    assert any("--change (Python: change=True)" in line for line in told.advice)
    told = diagnose(drives[0], drives[1], VEHICLE, change=True)
    assert "change" not in told.suspects
    first = told.effects[0]
    assert first.name == "payload_change"
    assert first.value == pytest.approx(-0.3 * VEHICLE.mass, abs=3 * first.std_error + 1.0)
    assert first.details["time in drive 0"] == pytest.approx(70.0, abs=1.0)
    assert first.details["time in drive 1"] == pytest.approx(55.0, abs=1.0)
    # A planner gets the robot as it is now.
    slip = told.model.breakdown(Motion.from_twist(0.0, 1.0, VEHICLE.icr, t=0.0))
    now = float(slip["slip_friction"] + slip["slip_change"]) / VEHICLE.slip_moment
    assert now == pytest.approx(0.7 * PAPER.coefficient("slip_friction"), rel=0.03)


def test_power_logged_late_is_the_logs_fault_and_stays_out_of_the_plan() -> None:
    told = _told(PAPER, delays={"p_left": 0.5, "p_right": 0.5})
    first = told.effects[0]
    assert (first.name, first.planner) == ("time_offset", "no")
    assert first.value == pytest.approx(0.5, abs=2 * first.std_error)
    assert [term.name for term in told.model.terms] == ["slip_friction", "traction_resistance"]
    assert told.model.coefficient("traction_resistance") == pytest.approx(118.0, rel=0.02)
    assert any("belongs to the log" in line for line in told.advice)


@pytest.mark.parametrize("seed", by_day(range(12), [0, 1, 2]))
def test_nothing_is_claimed_where_nothing_is_hidden(seed: int) -> None:
    names = list(TABLE_II)
    model = PowerModel.preset(names[seed % len(names)])
    told = _told(model, seed=100 + seed, correlation_time=(0.0, 0.3, 1.0)[seed % 3])
    assert told.verdict == "no_effect", told.effects
    assert told.after == told.before


def _wear(motion: Motion, vehicle: Vehicle) -> Sides:
    share = motion.channel("t") / 100.0
    return Sides(share * np.sign(motion.v_left), share * np.sign(motion.v_right))


def test_probabilities_of_explanations_sum_to_one_and_rivals_share_them() -> None:
    told = _told_load()
    stated = sum(one.probability for one in told.explanations)
    assert stated == pytest.approx(1.0)
    first = told.explanations[0]
    assert first.effects == tuple(effect.name for effect in told.effects)
    with_hotel = [one.probability for one in told.explanations if "hotel_load" in one.effects]
    assert told.effects[0].probability == pytest.approx(sum(with_hotel))
    assert first.model.coefficient("hotel_load") == pytest.approx(30.0, rel=0.05)


def test_two_effects_that_hide_each_other_are_found_together() -> None:
    truth = PAPER.with_term(effects.GRADE, VEHICLE.mass).with_term(effects.COPPER_LOSS, 7e-4)
    told = _told(truth, slope=0.087, uphill=0.7)
    assert {effect.name for effect in told.effects} == {"tilted_plane", "copper_loss"}
    sizes = {effect.name: effect for effect in told.effects}
    assert sizes["tilted_plane"].value == pytest.approx(0.087, rel=0.1)
    assert sizes["copper_loss"].value == pytest.approx(7e-4, rel=0.1)
    # Which way it turned on a straight is below the noise of the speeds, and a loss counts it.
    assert told.after.rmse < 0.5 * told.before.rmse


def test_while_more_than_noise_is_left_the_answer_is_never_no_effect() -> None:
    def ripple(motion: Motion, vehicle: Vehicle) -> np.ndarray:
        return np.asarray(np.sin(motion.channel("t") ** 2 / 60.0) * np.abs(motion.v))

    told = _told(PAPER.with_term(Term("ripple", "P", "N", "power", ripple), 90.0))
    assert told.verdict != "no_effect"
    assert not told.adequacy.adequate
    assert told.adequacy.noise == pytest.approx(np.hypot(5.0, 5.0), rel=0.1)
    assert any("something is missing" in line for line in told.advice)


@pytest.mark.parametrize("width", [1, 2, 3])
def test_without_an_effect_p_values_are_uniform(width: int) -> None:
    """The mean of blocks and its covariance, as the jackknife of a mean is: Hotelling's T^2."""
    rng = np.random.default_rng(width)
    count, mixed = 9, np.array([[1.0, 0.4, -0.2], [0.0, 0.8, 0.5], [0.0, 0.0, 2.0]])
    which = list(range(3 - width, 3))
    p_values = []
    for _ in range(400):
        blocks = rng.normal(size=(count, 3)) @ mixed
        covariance = np.cov(blocks, rowvar=False) / count
        made = Fit(blocks.mean(axis=0), np.zeros(1), covariance, np.zeros((1, 1)), count, blocks)
        p_values.append(made.p_value(which))
    assert kstest(p_values, "uniform").pvalue > 1e-3


def test_what_the_catalogue_lacks_is_told_with_its_channel_and_a_smooth_term_improves() -> None:
    model = PAPER.with_term(Term("wear", "k", "N", "force", _wear), 30.0)
    logs = [simulate.identification_drive(model, seed=k, **NOISE) for k in (1, 2)]
    unseen = simulate.validation_drive(model, seed=3, **NOISE)
    plain = diagnose(logs, unseen, VEHICLE)
    smooth = diagnose(logs, unseen, VEHICLE, effects=FEW, empirical=True)
    assert plain.verdict == "unexplained" and not plain.effects
    assert plain.unexplained[0].channel in ("t", "distance")
    assert plain.unexplained[0].shape.startswith("traction resistance rises")
    assert plain.unexplained[0].explained_variance > 0.8
    assert plain.after == plain.before
    assert smooth.unexplained[0].empirical
    assert smooth.after.rmse < 0.7 * smooth.before.rmse
    assert smooth.model.terms[-1].name.startswith("empirical_")


def test_the_extended_model_goes_straight_into_the_cost() -> None:
    told = _told_load()
    hotel = told.effects[0].value
    cost = EnergyCost(told.model, speed=0.5)
    straight = float(cost.segment_energy(np.array([1.0]), np.array([0.0]))[0])
    K = told.model.coefficient("traction_resistance")
    assert straight == pytest.approx(2 * K + hotel / 0.5, rel=1e-6)
    assert told.model.residual == told.after
    assert told.model.covariance is not None


def test_drives_and_their_errors_are_checked() -> None:
    log = simulate.identification_drive(PAPER)
    short = log.segment(0.0, 10.0)
    with pytest.raises(InvalidInputError, match="train is empty"):
        diagnose([], log, VEHICLE)
    with pytest.raises(InvalidInputError, match="holdout is empty"):
        diagnose(log, [], VEHICLE)
    with pytest.raises(InvalidInputError, match="is held out and holds the same readings"):
        diagnose([log], [log], VEHICLE)
    with pytest.raises(DriveLogError, match="too short to learn from"):
        diagnose(short, simulate.validation_drive(PAPER), VEHICLE)


def test_effects_that_are_told_go_in_whether_they_help_or_not() -> None:
    truth = PAPER.with_term(HOTEL, 25.0)
    train, unseen = pair(truth, **NOISE)
    entries = [catalogue()[name] for name in ("air_drag", "hotel_load", "warm_up")]
    told = diagnose(train, unseen, VEHICLE, effects=entries, choose=False)
    assert [effect.name for effect in told.effects] == [entry.name for entry in entries]
    found = {effect.name: effect for effect in told.effects}
    assert found["hotel_load"].value == pytest.approx(25.0, abs=3 * found["hotel_load"].std_error)
    assert abs(found["air_drag"].value) < 4 * found["air_drag"].std_error
    chosen = diagnose(train, unseen, VEHICLE, effects=entries)
    assert told.after.rmse == pytest.approx(chosen.after.rmse, rel=0.02)


def _runs(spread: float, seed: int, count: int = 10, **noise: float) -> tuple[list[DriveLog], Any]:
    """Return short drives of one robot whose power differs from drive to drive by a factor."""
    factors = 1 + spread * np.random.default_rng(seed).standard_normal(count)
    options = {**NOISE, **noise, "duration": 120.0, "without": {"accel_x"}}
    logs = [
        simulate.identification_drive(
            PAPER.with_coefficients(PAPER.coefficients * factor), seed=100 * seed + k, **options
        )
        for k, factor in enumerate(factors)
    ]
    return logs, factors


def _between(logs: list[DriveLog]) -> Dependence:
    problem = Problem([Drive.of(log, VEHICLE) for log in logs], VEHICLE)
    found = dependences(problem, (SLIP, TRACTION), ("power",))
    return next(one for one in found if one.channel == "drive")


def test_drives_that_differ_as_a_whole_are_told_with_what_no_model_can_reach() -> None:
    logs, factors = _runs(0.06, seed=4)
    found = _between(logs[:-1])
    assert found.p_value < 1e-6
    # Half a percent is what the coefficients' common fit and the noise leave open.
    assert found.values[0] == pytest.approx(float(np.std(factors[:-1], ddof=1)), abs=0.005)
    told = diagnose(logs[:-1], logs[-1], VEHICLE, effects=FEW)
    (line,) = (line for line in told.advice if line.startswith("drives differ as a whole"))
    average = float(line.split("at least ")[1].split(" %")[0])
    assert average == pytest.approx(100 * np.sqrt(2 / np.pi) * found.values[0], abs=0.3)


# -- parts, against second algorithms -------------------------------------------------------------


def _problem(model: PowerModel = PAPER, **options: Any) -> Problem:
    logs = [simulate.identification_drive(model, seed=k, **NOISE, **options) for k in (1, 2)]
    return Problem([Drive.of(log, VEHICLE) for log in logs], VEHICLE)


def test_leaving_out_blocks_equals_fitting_without_them() -> None:
    problem = _problem(duration=120.0)
    design = problem.design((SLIP, TRACTION))
    errors = np.array([3.0, 2.0, 1.0, 2.5, 1.5, 0.5])
    found = fit(design, errors)

    def rows(keep: np.ndarray) -> np.ndarray:
        parts = [
            table[keep[block]] / np.sqrt(error * count)
            for table, block, error, count in zip(
                design.rows, design.blocks, errors, design.counts, strict=True
            )
        ]
        return np.concatenate(parts)

    whole = rows(np.ones(len(design.drives), bool))
    direct = np.linalg.lstsq(whole[:, :-1], whole[:, -1], rcond=None)[0]
    assert found.values == pytest.approx(direct, rel=1e-6)
    for block in (0, 5, len(design.drives) - 1):
        keep = np.arange(len(design.drives)) != block
        part, out = rows(keep), rows(~keep)
        held = np.linalg.lstsq(part[:, :-1], part[:, -1], rcond=None)[0]
        loss = float(np.sum((out[:, -1] - out[:, :-1] @ held) ** 2))
        assert found.losses[block] == pytest.approx(loss, rel=1e-6)


def test_compiled_sums_of_products_equal_plain_ones() -> None:
    rng = np.random.default_rng(0)
    table, block = rng.normal(size=(200, 5)), np.sort(rng.integers(0, 9, 200))
    plain = np.zeros((10, 5, 5))
    np.add.at(plain, block, np.einsum("ni,nj->nij", table, table))
    assert block_grams(table, block, 10) == pytest.approx(plain, rel=1e-12, abs=1e-12)


def test_noise_is_measured_and_taken_out_without_moving_the_truth() -> None:
    options = {"seed": 3, "rate": 20.0}
    clean = simulate.identification_drive(PAPER, **options)
    noisy = simulate.identification_drive(PAPER, speed_noise=0.005, **options)
    assert speed_noise(noisy.channels["v_left"]) == pytest.approx(0.005, rel=0.1)
    truth = clean.motion(VEHICLE.icr)
    before, after = noisy.motion(VEHICLE.icr), quiet(noisy.motion(VEHICLE.icr), noisy.t)
    still = (truth.v_left == 0) & (truth.v_right == 0)
    rest = minimum_filter1d(still, 11)  # starts and stops are smoothed over half a second
    assert np.mean(after.v_left[rest] == 0.0) > 0.95 and np.mean(before.v_left[rest] == 0.0) < 0.05
    assert np.std(after.v_left - truth.v_left) < 0.6 * np.std(before.v_left - truth.v_left)


def test_the_twist_of_least_loss_balances_friction() -> None:
    loads = wheel_loads(VEHICLE.contacts, VEHICLE.mass, (0.06, 0.03))
    left, right = np.array([0.3, -0.4, 0.6]), np.array([0.5, 0.4, 0.2])
    found = twist(VEHICLE, loads / loads.sum(), left, right, np.zeros(3))
    x, y = VEHICLE.contacts.T
    for (u, q, w), one, two in zip(found, left, right, strict=True):
        ahead = u - w * y - np.where(y > 0, one, two)
        aside = q + w * x
        size = np.hypot(np.hypot(ahead, aside), 1e-3)
        fx, fy = loads * ahead / size, loads * aside / size
        # Sideways and in yaw, and forwards, the ground's forces cancel: the treads carry none.
        assert np.sum(fx) == pytest.approx(0.0, abs=1e-3 * loads.sum())
        assert np.sum(fy) == pytest.approx(0.0, abs=1e-3 * loads.sum())
        assert np.sum(x * fy - y * fx) == pytest.approx(0.0, abs=1e-3 * loads.sum())
    # Spinning with the mass in the middle, the tread ICRs lie where docs/theory, section 1 says.
    even = np.full(4, 0.25)
    spin = twist(VEHICLE, even, np.array([-0.4]), np.array([0.4]), np.zeros(1))[0]
    assert 0.4 / spin[2] == pytest.approx(0.4756, rel=1e-3)


def test_the_centre_of_mass_is_found_from_the_motion() -> None:
    offset = (0.05, -0.03)
    loads = wheel_loads(VEHICLE.contacts, VEHICLE.mass, offset)
    t = np.arange(0.0, 60.0, 0.05)
    left, right = 0.4 * np.sin(0.2 * t) + 0.1, 0.4 * np.cos(0.13 * t)
    body = twist(VEHICLE, loads / loads.sum(), left, right, np.zeros(len(t)))
    yaw = np.concatenate([[0.0], np.cumsum(0.05 * 0.5 * (body[1:, 2] + body[:-1, 2]))])
    cos, sin = np.cos(yaw), np.sin(yaw)
    speed = np.stack([cos * body[:, 0] - sin * body[:, 1], sin * body[:, 0] + cos * body[:, 1]])
    steps = 0.05 * 0.5 * (speed[:, 1:] + speed[:, :-1])
    x, y = np.concatenate([np.zeros((2, 1)), np.cumsum(steps, axis=1)], axis=1)
    log = DriveLog({"t": t, "v_left": left, "v_right": right, "power": 100 + 0 * t, "x": x, "y": y,
                    "yaw": yaw})  # fmt: skip
    found = find_mass_centre([Drive.of(log, VEHICLE)], VEHICLE, mu=1e6 / GRAVITY)
    assert found is not None and found.found
    assert (found.forward, found.left) == pytest.approx(offset, abs=0.003)
    centred = simulate.identification_drive(PAPER, seed=1)
    none = find_mass_centre([Drive.of(centred, VEHICLE)], VEHICLE, mu=0.6)
    assert none is not None and not none.found


# -- recorded drives ------------------------------------------------------------------------------

TRUE: dict[str, tuple[str, Callable[[dict[str, Any], dict[str, Any]], float]]] = {
    "com_offset": ("centre_of_mass", lambda e, _: np.hypot(e["forward_m"], e["left_m"])),
    "copper_loss": ("copper_loss", lambda e, robot: (
        e["R_ohm"] * (robot["wheel_radius_m"] / e["kt_Nm_per_A_at_wheel"]) ** 2)),
    "hotel_load": ("hotel_load", lambda e, _: e["power_W_total"]),
    "inertia": ("linear_inertia", lambda _, robot: robot["mass_equivalent_straight_kg"]),
    "load_change": ("payload_change", lambda e, _: e["mass_after_kg"] - e["mass_before_kg"]),
    "slope": ("tilted_plane", lambda e, _: np.radians(e["angle_deg"])),
    "viscous": ("viscous_loss", lambda e, _: e["N_per_mps_per_side"]),
    "warmup": ("warm_up", lambda e, robot: (
        e["relative_excess_at_0"] * robot["K_internal_N_per_side"])),
}  # fmt: skip
"""By what the engine hides: its name here, and its size by what the engine says of it and of the
robot."""


def _recorded(folder: Path, stem: str) -> tuple[Diagnosis, Diagnosis]:
    """Diagnose a pair of drives, and fit the model that was told the true effect."""
    vehicle = Vehicle.preset("quadriga" if "empty" in stem else "quadriga:full")
    train, unseen = (
        DriveLog.read(folder / f"{stem}_{drive}.csv.gz") for drive in ("ident", "valid")
    )
    # Every drive of the engine has inertia, whatever else it hides.
    hidden = [TRUE[name][0] for name in [stem.rpartition("_s")[0]] if name in TRUE]
    names = dict.fromkeys(["linear_inertia", "angular_inertia", *hidden])
    told = [catalogue()[name] for name in names]
    return (
        diagnose(train, unseen, vehicle, change="payload_change" in names),
        diagnose(train, unseen, vehicle, effects=told, choose=False),
    )


@pytest.mark.shared
@pytest.mark.parametrize("seed", [pytest.param(1, marks=pytest.mark.nightly), 2])
@pytest.mark.parametrize("scenario", by_day(sorted(TRUE), ("com_offset", "slope")))
def test_a_physics_engines_hidden_effect_is_found(
    shared_data: Path, scenario: str, seed: int
) -> None:
    folder = shared_data / "quadriga_mujoco"
    told, oracle = _recorded(folder, f"{scenario}_s{seed}")
    side_car = json.loads((folder / f"{scenario}_s{seed}_ident.json").read_text())
    name, size = TRUE[scenario]
    first = told.effects[0]
    assert name == first.name or name in first.rivals
    found = next(effect for effect in told.effects if effect.name == name)
    true = size(side_car["effects"][scenario], side_car["true"])
    assert found.value == pytest.approx(true, rel=0.15)
    assert name in {effect.name for effect in oracle.effects}
    assert told.after.rmse < told.before.rmse
    assert told.after.rmse <= 1.15 * oracle.after.rmse
    assert abs(told.after.energy_error) < 0.02


@pytest.mark.shared
@pytest.mark.parametrize("seed", [pytest.param(1, marks=pytest.mark.nightly), 2])
@pytest.mark.parametrize(
    "scenario",
    by_day(
        ["none", "none_concrete_empty", "none_marble_empty", "none_marble_full"],
        ["none_marble_empty"],
    ),
)
def test_without_a_hidden_effect_only_the_inertia_that_is_there_is_found(
    shared_data: Path, scenario: str, seed: int
) -> None:
    folder, stem = shared_data / "quadriga_mujoco", f"{scenario}_s{seed}"
    told, oracle = _recorded(folder, stem)
    side_car = json.loads((folder / f"{stem}_ident.json").read_text())
    linear, angular = told.effects[:2]
    assert (linear.name, angular.name) == ("linear_inertia", "angular_inertia")
    mass = side_car["true"]["mass_equivalent_straight_kg"]
    # The second seed's drives carry noise, which the standard error must cover.
    assert abs(linear.value - mass) < (0.05 * mass if seed == 1 else 3 * linear.std_error)
    assert linear.std_error < 0.05 * mass
    assert told.after.rmse < 0.85 * told.before.rmse
    assert told.after.rmse <= 1.15 * oracle.after.rmse
