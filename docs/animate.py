"""Animate the least-energy and the shortest route, driven in the physics engine, as a GIF.

Usage: ``python docs/animate.py [FILE.gif]``
"""

from __future__ import annotations

import math
import sys
from dataclasses import replace

import matplotlib as mpl

mpl.use("Agg")

from matplotlib.animation import FuncAnimation, PillowWriter
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.transforms import Affine2D

import energyplan as ep
from energyplan.io.bundled import bundled
from energyplan.limits.speed import profile
from energyplan.output import plots
from energyplan.physics import Robot, drive

FRAMES, COLOURS = 90, {"least energy": plots.BLUE, "shortest": plots.RED}


def main(file: str) -> None:
    """Plan, drive and draw."""
    model = ep.PowerModel.preset("quadriga:full:concrete")
    vehicle = model.vehicle
    grid = ep.read_map(bundled("warehouse.yaml"))
    problem = ep.PlanningProblem(
        grid, ep.EnergyCost(model), ep.Pose(2, 2, 0), ep.Pose(20, 12, math.pi / 2)
    )
    made = ep.compare(problem, effort=100_000)
    slow = replace(vehicle, motor=replace(vehicle.motor, speed=0.7, acceleration=0.5))
    runs = {
        name: drive(profile(plan.path, model, vehicle=slow), Robot.from_model(model), model).run
        for name, plan in (("least energy", made.energy_optimal), ("shortest", made.shortest))
    }
    figure = Figure(figsize=(plots.WIDTH, 4.3), dpi=110)
    ax = plots.occupancy(figure.add_axes((0.01, 0.12, 0.98, 0.8)), grid)
    ax.set(xlabel="", ylabel="", xticks=[], yticks=[])
    ax.set_title("driven in a physics engine", loc="left", fontsize="medium")
    ax.set_autoscale_on(False)
    (low_x, low_y), (high_x, high_y) = vehicle.footprint
    boxes, lines, labels = {}, {}, {}
    for k, (name, colour) in enumerate(COLOURS.items()):
        (lines[name],) = ax.plot([], [], color=colour, lw=2)
        box = Rectangle((low_x, low_y), high_x - low_x, high_y - low_y, color=colour, alpha=0.8)
        boxes[name] = ax.add_patch(box)
        place = (0.02, -0.04 - 0.06 * k)
        labels[name] = ax.text(*place, "", color=colour, transform=ax.transAxes, va="top")
    longest = max(run.t[-1] for run in runs.values())

    def draw(frame: int) -> list[object]:
        now = min(1.0, frame / (FRAMES - 12)) * longest
        for name, run in runs.items():
            k = min(int(now / run.period), len(run.t) - 1)
            lines[name].set_data(run.x[: k + 1 : 10], run.y[: k + 1 : 10])
            turn = Affine2D().rotate(run.yaw[k]).translate(run.x[k], run.y[k])
            boxes[name].set_transform(turn + ax.transData)
            spent = float(run.power[: k + 1].sum() * run.period)
            labels[name].set_text(f"{name}: {run.t[k]:.0f} s, {spent:.0f} J")
        return []

    FuncAnimation(figure, draw, frames=FRAMES).save(file, writer=PillowWriter(fps=12))


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else "docs/pictures/closing_the_loop.gif")
