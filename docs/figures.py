"""Draw the figures that carry the argument, as vectors, into docs/images.

    python docs/figures.py              # all of them, a few minutes
    python docs/figures.py range        # one of them, by its name in FIGURES below

Each is 5.2 inches wide in the library's style: readable in a phone's column and in print.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, NullLocator

import energyplan as ep
from energyplan.io.files import bundled
from energyplan.output import plots
from energyplan.output.plots import image
from energyplan.output.plots.style import CYCLE
from energyplan.physics import (
    EFFECTS,
    EngineDrives,
    EngineRobot,
    close_loop,
    draw_effects,
    switch_on,
)
from energyplan.planning import Budget
from energyplan.planning.search.optimise import Refiner
from energyplan.planning.search.routes import cheapest_route, cheapest_routes
from energyplan.planning.search.tracking import poses_along
from energyplan.planning.space.compiled import CompiledProblem, compiled
from energyplan.planning.space.cost_to_go import CostToGo, cost_to_go
from energyplan.power import HOTEL, effects

HERE = Path(__file__).resolve().parent
MODEL = ep.PowerModel.preset("quadriga:full:concrete")


def warehouse() -> ep.PlanningProblem:
    """Return the problem of the README: through the racks, or round them."""
    return ep.PlanningProblem(
        ep.read_map(bundled("warehouse.yaml")), ep.EnergyCost(MODEL), ep.Pose(2.0, 2.0, 0.0),
        ep.Pose(20.0, 12.0, math.pi / 2),
        surfaces=ep.read_surfaces(bundled("warehouse_surfaces.geojson")),
    )  # fmt: skip


def iso_energy() -> Figure:
    """Least energy from the origin, for two prices of turning and two headings at the goal."""
    side = np.linspace(-3, 3, 121)
    x, y = np.meshgrid(side, side)
    made = Figure(figsize=(plots.WIDTH, 5.2), layout="constrained")
    axes = made.subplots(2, 2, sharex=True, sharey=True)
    for row, (c, ground) in zip(axes, ((0.2, "cheap turns"), (2.7, "expensive turns")),
                                strict=True):  # fmt: skip
        cost = ep.EnergyCost.from_coefficients(per_metre=1.0, per_radian=c, icr=1.0)
        for ax, heading in zip(row, (0, 90), strict=True):
            goals = np.stack([x, y, np.full_like(x, math.radians(heading))], axis=-1)
            energy = ep.steering.energy((0, 0, 0), goals, cost)
            drawn = ax.contour(x, y, energy, levels=np.arange(0.5, 12, 0.5), cmap="viridis",
                               vmax=14)  # fmt: skip
            ax.clabel(drawn, levels=drawn.levels[1::4], fontsize="small")
            ax.annotate("", (0.9, 0), (0, 0), arrowprops={"arrowstyle": "-|>", "lw": 1.5})
            ax.set_title(f"{ground}, ends at {heading}°", fontsize="medium", loc="left")
            ax.set_aspect("equal")
    for ax in axes[-1]:
        ax.set_xlabel("x / C [1]")
    for ax in axes[:, 0]:
        ax.set_ylabel("y / C [1]")
    return made


def turns() -> Figure:
    """Where both routes lose energy to turning: the area of a disc is its joules."""
    problem = warehouse()
    found = ep.compare(problem, effort=100_000)
    made = Figure(figsize=(plots.WIDTH, 5.6), layout="constrained")
    place, bars = made.subplots(2, 1, height_ratios=(4, 1))
    plots.occupancy(place, problem.map)
    both = {"shortest": found.shortest, "least energy": found.energy_optimal}
    looks = {"shortest": (plots.RED, "--"), "least energy": (plots.BLUE, "-")}
    for name, plan in both.items():
        color, dash = looks[name]
        plots.route(
            place, plan.path, f"{name}, {plan.energy_driven:.0f} J", color, dash, arrows=False
        )
        at, joules = turning_losses(plan.path, problem)
        place.scatter(at[:, 0], at[:, 1], s=joules, color=color, alpha=0.35, lw=0, zorder=4)
    place.scatter([], [], s=200, color="0.5", alpha=0.5, lw=0, label="200 J lost to turning")
    plots.legend(place, above=True)
    plots.breakdown(bars, {name: plan.driven.breakdown for name, plan in both.items()})
    for ax in (bars,):
        ax.spines[["top", "right"]].set_visible(False)
    return made


class Steps(NamedTuple):
    """What the steps of the planner make of a problem."""

    to_go: CostToGo
    cells: np.ndarray  # (cells, 3): poses of the cheapest route
    followed: list[ep.Path]  # routes as exact motions
    refined: list[ep.Path]  # each of them after shortcuts and moved poses


def steps_of(query: CompiledProblem, rounds: int) -> Steps:
    """Find, follow and refine the routes of a problem; refine so many times."""
    budget, to_go = Budget(effort=50_000), cost_to_go(query.setting)
    route = cheapest_route(to_go, query.setting, np.ones(1), 50_000, False).chain
    cells = poses_along(to_go.places, query.setting, route)
    ways = cheapest_routes(query.setting, to_go, budget)
    refined = []
    for way in ways:
        refiner, own = Refiner(query.setting, way), budget.part(0.2)
        for shorten in (refiner.shortcut, refiner.again)[:rounds]:
            shorten(own)
            refiner.polish(own)
        refined.append(query.path(refiner.segments))
    return Steps(to_go, cells, [query.path(way) for way in ways], refined)


def planner() -> Figure:
    """Follow the routes of a warehouse by exact motions, and refine them."""
    problem = warehouse()
    query = compiled(problem).leading
    _, cells, followed, refined = steps_of(query, 2)
    best = min(refined, key=query.value)
    made = Figure(figsize=(plots.WIDTH, 4.4), layout="constrained")
    place = made.subplots()
    plots.occupancy(place, problem.map)
    for k, path in enumerate(followed):
        label = {"label": f"{len(followed)} routes, followed by exact motions"} if k == 0 else {}
        place.plot(*path.poses(0.05, 0.05)[:, :2].T, color=plots.RED, lw=1.0, **label)
    place.plot(*cells[:, :2].T, ".", ms=4, color="0.4", label="cells of the first route")
    plots.route(place, best, f"the best, optimised: {query.value(best):.0f} J", plots.BLUE, "-")
    plots.legend(place, above=True)
    return made


def planner_steps() -> Figure:
    """One problem, and what each step of the planner makes of it."""
    problem = warehouse()
    query = compiled(problem).leading
    to_go, cells, followed, refined = steps_of(query, 1)
    plan = ep.plan(problem, effort=50_000)
    made = Figure(figsize=(plots.WIDTH, 5.6), layout="constrained")
    axes = made.subplots(3, 2, sharex=True, sharey=True).ravel()
    places = to_go.places
    free = np.bitwise_count(places.masks).reshape(-1, places.columns + 4)[2:-2, 2:-2] / 64.0
    distance = np.full(places.masks.shape, np.nan)
    np.fmin.at(distance, places.home, np.where(to_go.distance < 1e6, to_go.distance, np.nan))
    distance = distance.reshape(-1, places.columns + 4)[2:-2, 2:-2]
    width, height = places.columns * places.spacing, len(free) * places.spacing
    about = {"origin": "lower", "extent": (0.0, width, 0.0, height), "interpolation": "none"}
    for ax in axes:
        plots.occupancy(ax, problem.map)
        ax.set(xlabel="", ylabel="")
    axes[0].imshow(free, cmap="Blues", alpha=0.8, **about)
    axes[1].imshow(distance, cmap="viridis_r", alpha=0.8, **about)
    axes[2].plot(*cells[:, :2].T, ".", ms=3, color=plots.RED)
    for ax, paths in zip(axes[3:5], (followed, refined), strict=True):
        for path, color in zip(paths, CYCLE, strict=False):
            ax.plot(*path.poses(0.05, 0.05)[:, :2].T, color=color, lw=1.0)
    axes[5].plot(*plan.path.poses(0.05, 0.05)[:, :2].T, color=plots.BLUE, lw=1.4)
    first, last = (f"{min(map(query.value, paths)):.0f} J" for paths in (followed, refined))
    for number, (ax, title) in enumerate(zip(axes, (
        "free headings", "distance to go", "cheapest route, as cells",
        f"{len(followed)} routes, followed: {first}", f"shortcuts, moved poses: {last}",
        f"plan {plan.energy_driven:.0f} J, bound {plan.lower_bound:.0f} J",
    ), strict=True), 1):  # fmt: skip
        ax.set_title(f"{number}. {title}", fontsize="small", loc="left")
    return made


def turning_losses(path: ep.Path, problem: ep.PlanningProblem) -> tuple[np.ndarray, np.ndarray]:
    """Return where a path turns, and the joules of slip friction there."""
    fine = problem.terrain.cut(path)
    joules = np.zeros(len(fine))
    for piece in problem.terrain.pieces(path, problem.cost):
        share = piece.cost.model.coefficient("slip_friction") * piece.cost.vehicle.slip_moment
        joules += share * np.abs(piece.path.dtheta)
    at = 0.5 * (fine.vertices[:-1, :2] + fine.vertices[1:, :2])
    return at[joules > 0], joules[joules > 0]


def bound() -> Figure:
    """How plan and lower bound close in on the least energy as work is spent."""
    problem = warehouse()
    spent = (10_000, 20_000, 50_000, 150_000)
    plans = [ep.plan(problem, effort=effort) for effort in spent]
    made = plots.figure(size=(plots.WIDTH, 3.2))
    ax = made.axes[0]
    upper = [plan.energy_driven / 1e3 for plan in plans]
    lower = [plan.lower_bound / 1e3 for plan in plans]
    ax.plot(spent, upper, "o-", color=plots.BLUE, label="plan found")
    ax.plot(spent, lower, "s--", color=plots.RED, label="no route takes less")
    ax.fill_between(spent, lower, upper, color=plots.SKY, alpha=0.3, lw=0,
                    label="the optimum lies here")  # fmt: skip
    ax.set_xscale("log")
    ax.xaxis.set_major_locator(FixedLocator(spent))
    ax.xaxis.set_minor_locator(NullLocator())
    ax.set_xticklabels([f"{effort // 1000}" for effort in spent])
    ax.set(xlabel="planning effort [1000 units of work]", ylabel="energy [kJ]")
    plots.legend(ax, above=True)
    return made


def residual() -> Figure:
    """Residual before and after the causes are found, on a drive not fitted to."""
    vehicle = MODEL.vehicle
    truth = replace(MODEL, name="hidden").with_term(effects.GRADE, vehicle.mass)
    truth = truth.with_term(HOTEL, 30.0)
    options = {"slope": math.radians(4.0), "uphill": 0.7, "power_noise": 10.0,
               "correlation_time": 0.2, "speed_noise": 0.005}  # fmt: skip
    drives = [ep.simulate.identification_drive(truth, seed=seed, **options) for seed in (1, 2)]
    unseen = ep.simulate.validation_drive(truth, seed=3, **options)
    found = ep.diagnose(drives, holdout=[unseen], vehicle=vehicle)
    made = Figure(figsize=(plots.WIDTH, 4.2), layout="constrained")
    axes = made.subplots(2, 1, sharex=True, sharey=True)
    sides = (("before", found.predictions_before, found.before, plots.RED),
             ("after", found.predictions_after, found.after, plots.BLUE))  # fmt: skip
    for ax, (name, (power,), misfit, color) in zip(axes, sides, strict=True):
        ax.plot(unseen.t, unseen.power - power, color=color, lw=0.8)
        ax.axhline(0.0, color=plots.BLACK, lw=0.8)
        ax.set_title(f"{name}: {misfit.rmse:.0f} W rms, energy {100 * misfit.energy_error:+.1f} %",
                     loc="left", fontsize="medium")  # fmt: skip
        ax.set_ylabel("residual [W]")
        ax.grid(alpha=0.3)
        ax.spines[["top", "right"]].set_visible(False)
    axes[-1].set_xlabel("time [s]")
    return made


def told_taken() -> Figure:
    """Error of the predicted energy in the physics engine, first and last round, level ground."""
    walls = np.zeros((120, 160), bool)
    walls[:70, 80:84] = True  # one wall to go round
    hall = ep.OccupancyGrid(walls, resolution=0.1)
    problem = ep.PlanningProblem(hall, ep.EnergyCost(MODEL, battery=True), (2, 2, 0), (14, 3, 0))
    level = [name for name, kind in EFFECTS.items() if "direction" not in kind.details]
    errors: dict[str, list[float]] = {"first": [], "last": []}
    seeds = range(1, 6)
    for seed in seeds:
        plain = EngineRobot.from_model(MODEL)
        robot = switch_on(plain, draw_effects(plain, seed, names=tuple(level)))
        loop = close_loop(problem, EngineDrives(robot), rounds=3, effort=40_000)
        errors["first"].append(100 * loop.rounds[0].error)
        errors["last"].append(100 * loop.rounds[-1].error)
    made = plots.figure(size=(plots.WIDTH, 3.4))
    ax = made.axes[0]
    for k, (first, last) in enumerate(zip(errors["first"], errors["last"], strict=True), 1):
        ax.plot([first, last], [k, k], color="0.7", lw=1.5, zorder=1)
    ax.plot(errors["first"], list(seeds), "s", color=plots.RED, label="first drive")
    ax.plot(errors["last"], list(seeds), "o", color=plots.BLUE, label="last drive")
    ax.axvline(0.0, color=plots.BLACK, lw=0.8)
    ax.set(
        xlabel="error of the predicted energy [%]",
        ylabel="robot with hidden effects [1]",
        yticks=list(seeds),
    )
    plots.legend(ax, above=True)
    return made


def reach() -> Figure:
    """How far a charge leads, there and back."""
    problem = warehouse()
    return plots.energy_map(ep.energy_map(problem, back=problem.start), problem.map)


def friction() -> Figure:
    """Moment between the sides by yaw rate, and the power that holding one takes."""
    made = Figure(figsize=(plots.WIDTH, 2.6), layout="constrained")
    moment, heat = made.subplots(1, 2)
    limit = MODEL.coefficient("slip_friction") * MODEL.vehicle.slip_moment
    moment.plot([-0.1, 0, 0, 0.1], [-limit, -limit, limit, limit], color=plots.BLUE, lw=2)
    moment.annotate(
        "sticks: anything\nwithin the limit", (0, 0), (0.02, -0.25 * limit), fontsize="small"
    )
    moment.annotate("slides: the limit", (0.05, limit), (0.012, 0.72 * limit), fontsize="small")
    moment.set(xlabel="yaw rate [rad/s]", ylabel="moment [N m]")
    force = MODEL.coefficient("traction_resistance")
    held = np.linspace(-limit, limit, 101)
    push = held / MODEL.vehicle.icr.slip_track
    for name, loss, color, dash in (("no losses", 0.0, plots.BLUE, "-"),
                                    ("copper loss", 6e-4, plots.RED, "--")):  # fmt: skip
        power = 2 * force * 0.5 + loss * ((force - push) ** 2 + (force + push) ** 2)
        heat.plot(held, power, color=color, ls=dash, lw=2, label=name)
    heat.set(
        xlabel="moment held [N m]",
        ylabel="power [W]",
        ylim=(0, None),
    )
    heat.legend(fontsize="small", frameon=False, title="straight ahead, 0.5 m/s")
    for ax in (moment, heat):
        ax.spines[["top", "right"]].set_visible(False)
    return made


FIGURES: dict[str, Callable[[], Figure]] = {
    "iso_energy": iso_energy, "turns": turns, "bound": bound, "residual": residual,
    "told_taken": told_taken, "range": reach, "planner": planner, "planner_steps": planner_steps,
    "friction": friction,
}  # fmt: skip


def main(names: list[str]) -> None:
    """Draw the figures named, or all."""
    for name in names or list(FIGURES):
        file = HERE / "images" / f"{name}.svg"
        file.write_bytes(image(FIGURES[name](), ".svg"))
        print(file)


if __name__ == "__main__":
    main(sys.argv[1:])
