"""Map where the motors can drive a trajectory of given speed and curvature, and time a route.

The paper asks whether motors can provide the power for a given speed and curvature on a given
ground. This example answers it for Quadriga on marble and concrete, empty and with a full tank,
first as a map over curvature and speed, then for one route timed three ways. Run ``python
examples/motor_limits.py [folder]``; it writes ``motor_limits.png``.

The paper gives no motor ratings. `DRIVE` is a drive that one might think of fitting: enough for
the empty robot, too weak for the full one on concrete at full speed.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path as FilePath

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from energyplan.limits.feasibility import check, feasible_region
from energyplan.limits.speed import profile
from energyplan.motion import Motion
from energyplan.path import Path, Pose
from energyplan.power import PowerModel
from energyplan.power.effects import term
from energyplan.vehicle import MotorLimits

DRIVE = MotorLimits(
    continuous_power=250.0,
    peak_power=400.0,
    thermal_time=20.0,
    force=480.0,
    speed=1.2,
    acceleration=1.0,
    regeneration=120.0,
)

BRIEF = "#f6e3b5"
REASONS = {
    "speed": ("wheel speed", "#9fb8d1"),
    "peak_power": ("peak power", "#c8553d"),
    "regeneration": ("regeneration", "#7a9e7e"),
    "force": ("force", "#6d597a"),
}


def quadriga(name: str) -> PowerModel:
    """Return a model of the paper's Table II with the drive in question."""
    model = PowerModel.preset(f"quadriga:{name}")
    return replace(model, vehicle=replace(model.vehicle, motor=DRIVE))


def draw_region(ax: Axes, model: PowerModel) -> None:
    """Colour what keeps the robot from each pair of curvature and speed."""
    # Straight ahead nothing slips: friction jumps at curvature 0, so begin beside it.
    curvature, speed = np.linspace(0.005, 4, 241), np.linspace(0, 1.4, 141)
    region = feasible_region(model, curvature, speed)
    colours = ["white", BRIEF, *(colour for _, colour in REASONS.values())]
    number = np.where(region.sustained, 0.0, 1.0)
    for k, name in enumerate(REASONS):
        number[~region.brief & (region.limiting_brief == name)] = 2 + k
    ax.pcolormesh(
        curvature,
        speed,
        number.T,
        cmap=ListedColormap(colours),
        vmin=-0.5,
        vmax=len(colours) - 0.5,
        rasterized=True,
    )
    ax.plot(curvature, region.max_speed, "k", lw=2)
    ax.plot(curvature, region.max_speed_brief, "k--", lw=1.2)
    motion = Motion.from_twist(speed[:, None], curvature * speed[:, None], model.vehicle.icr)
    outer = model.sides(motion).right
    lines = ax.contour(
        curvature, speed, outer, levels=[100, 200, 300, 400, 600], colors="0.35", linewidths=0.6
    )
    ax.clabel(lines, fmt="%g W", fontsize=7)
    ax.axvline(1 / model.vehicle.icr.half_track, color="0.5", lw=0.8, ls=":")
    _, load, ground = model.name.split(":")
    ax.set_title(f"{load} on {ground}", fontsize=10)
    ax.set_xlim(0, 4)
    ax.set_ylim(0, 1.4)


def draw_route(ax: Axes, model: PowerModel) -> None:
    """Power of the outer motor on one route: as fast as the wheels turn, and as the motors can."""
    route = Path(
        Pose(0, 0, 0),
        ds=[3.0, 3.0, 0.0, 3.0, 4.0],
        dtheta=[0.0, 3.0, -np.pi, -2.0, 0.0],
    )
    icr = model.vehicle.icr
    # A planner that knows the robot's top speed only would ask for this.
    wheels = MotorLimits(speed=DRIVE.speed, acceleration=DRIVE.acceleration)
    wish = profile(route, model, vehicle=replace(model.vehicle, motor=wheels))
    fast, cheap = profile(route, model), profile(route, model, objective="energy")
    report = check(wish, model)
    print(f"as fast as the wheels turn: {wish.duration:.1f} s, feasible: {report.feasible}")
    for v in report.violations:
        print(f"  {v.kind}, {v.side}: {v.start:.2f} s to {v.end:.2f} s, {v.peak:.0f} > {v.limit:g}")
    print(f"  {report.reason}")
    for name, colour, trajectory in (
        ("as fast as the wheels turn", "#c8553d", wish),
        ("as fast as the motors can", "#33658a", fast),
        ("with the least energy", "#4f772d", cheap),
    ):
        found = check(trajectory, model)
        print(f"{name}: {trajectory.duration:.1f} s, {found.energy:.0f} J, {found.feasible}")
        sides = model.sides(Motion.from_trajectory(trajectory, icr))
        label = f"{name} ({trajectory.duration:.1f} s, {found.energy:.0f} J)"
        ax.plot(
            trajectory.t, np.maximum(sides.left, sides.right), color=colour, lw=1.2, label=label
        )
    ax.axhline(DRIVE.peak_power, color="k", lw=0.8, ls="--")
    ax.axhline(DRIVE.continuous_power, color="k", lw=0.8)
    ax.set_xlabel("time [s]")
    ax.set_ylabel("power of the busier motor [W]")
    ax.legend(fontsize=8, loc="upper right")
    ax.set_title(
        "one route, full on concrete, with inertia, viscous loss and hotel load", fontsize=10
    )


def main() -> None:
    """Draw the maps and the route."""
    folder = FilePath(sys.argv[1]) if len(sys.argv) > 1 else FilePath()
    figure = plt.figure(figsize=(9, 9.5), layout="constrained")
    grid = figure.add_gridspec(3, 2)
    for k, name in enumerate(
        f"{load}:{ground}" for ground in ("marble", "concrete") for load in ("empty", "full")
    ):
        ax = figure.add_subplot(grid[divmod(k, 2)])
        draw_region(ax, quadriga(name))
        ax.set_xlabel("curvature [1/m]")
        ax.set_ylabel("speed [m/s]")
    keys = [
        Line2D([], [], color="k", lw=2, label="fastest for ever"),
        Line2D([], [], color="k", lw=1.2, ls="--", label="fastest for a while"),
        Patch(color=BRIEF, label="only for a while"),
        *(Patch(color=colour, label=f"never: {label}") for label, colour in REASONS.values()),
    ]
    figure.legend(handles=keys, fontsize=8, loc="outside upper center", ncols=4)
    heavy = quadriga("full:concrete")
    for name, value in (
        ("linear_inertia", heavy.vehicle.mass),
        ("angular_inertia", heavy.vehicle.yaw_inertia),
        ("viscous_loss", 40.0),
        ("hotel_load", 40.0),
    ):
        heavy = heavy.with_term(term(name), value)
    draw_route(figure.add_subplot(grid[2, :]), heavy)
    folder.mkdir(parents=True, exist_ok=True)
    figure.savefig(folder / "motor_limits.png", dpi=110)
    print(f"wrote {folder / 'motor_limits.png'}")


if __name__ == "__main__":
    main()
