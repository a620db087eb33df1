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

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from energyplan import Motion, MotorLimits, Path, Pose, PowerModel
from energyplan.limits.feasibility import check, feasible_region
from energyplan.limits.speed import profile
from energyplan.output import plots
from energyplan.output.plots import png
from energyplan.power.effects import term

DRIVE = MotorLimits(
    continuous_power=250.0,
    peak_power=400.0,
    thermal_time=20.0,
    force=480.0,
    speed=1.2,
    acceleration=1.0,
    regeneration=120.0,
)

BRIEF = plots.YELLOW
REASONS = {
    "speed": ("wheel speed", plots.SKY),
    "peak_power": ("peak power", plots.RED),
    "regeneration": ("regeneration", plots.GREEN),
    "force": ("force", plots.PURPLE),
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
        curvature, speed, outer, levels=[100, 200, 300], colors="0.35", linewidths=0.6
    )
    ax.clabel(lines, fmt="%g W", fontsize="small")
    ax.axvline(1 / model.vehicle.icr.half_track, color="0.5", lw=0.8, ls=":")
    _, load, ground = model.name.split(":")
    ax.set_title(f"{load} on {ground}", fontsize="medium", loc="left")
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
    for name, colour, dash, trajectory in (
        ("as fast as the wheels turn", plots.RED, "--", wish),
        ("as fast as the motors can", plots.BLUE, "-", fast),
        ("with the least energy", plots.GREEN, "-.", cheap),
    ):
        found = check(trajectory, model)
        print(f"{name}: {trajectory.duration:.1f} s, {found.energy:.0f} J, {found.feasible}")
        sides = model.sides(Motion.from_trajectory(trajectory, icr))
        label = f"{name} ({trajectory.duration:.1f} s, {found.energy:.0f} J)"
        busier = np.maximum(sides.left, sides.right)
        ax.plot(trajectory.t, busier, color=colour, ls=dash, lw=1.2, label=label)
    ax.axhline(DRIVE.peak_power, color="k", lw=0.8, ls="--")
    ax.axhline(DRIVE.continuous_power, color="k", lw=0.8)
    ax.set_xlabel("time [s]")
    ax.set_ylabel("busier motor [W]")
    ax.grid(alpha=0.3)
    ax.set_title("one route, full on concrete", loc="left")
    plots.legend(ax, above=True)


def main() -> None:
    """Draw the maps and the route."""
    folder = FilePath(sys.argv[1]) if len(sys.argv) > 1 else FilePath()
    figure = Figure(figsize=(plots.WIDTH, 8.6), layout="constrained")
    grid = figure.add_gridspec(3, 2)
    for k, name in enumerate(
        f"{load}:{ground}" for ground in ("marble", "concrete") for load in ("empty", "full")
    ):
        ax = figure.add_subplot(grid[divmod(k, 2)])
        draw_region(ax, quadriga(name))
        ax.set_xlabel("curvature [1/m]")
        ax.set_ylabel("speed [m/s]")
    keys = [
        Line2D([], [], color="k", lw=2, label="fastest continuously"),
        Line2D([], [], color="k", lw=1.2, ls="--", label="fastest for a short time"),
        Patch(color=BRIEF, label="only for a short time"),
        *(Patch(color=colour, label=f"not at all: {label}") for label, colour in REASONS.values()),
    ]
    figure.legend(handles=keys, fontsize="small", loc="outside upper left", ncols=2, frameon=False)
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
    (folder / "motor_limits.png").write_bytes(png(figure))
    print(f"wrote {folder / 'motor_limits.png'}")


if __name__ == "__main__":
    main()
