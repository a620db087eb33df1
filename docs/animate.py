"""Animate the least-energy and the shortest route, driven in the physics engine, as a GIF.

Usage: ``python docs/animate.py [FILE.gif]``
"""

from __future__ import annotations

import math
import sys
from dataclasses import replace

import matplotlib as mpl
import numpy as np

mpl.use("Agg")

from matplotlib.animation import FuncAnimation, PillowWriter
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.transforms import Affine2D

import energyplan as ep
from energyplan.io.files import bundled
from energyplan.limits.speed import profile
from energyplan.output import plots
from energyplan.physics import EngineRobot, drive

MOVING, COLOURS = 76, {"least energy": plots.BLUE, "shortest": plots.RED}


FRAMES = [MOVING] * 8 + list(range(MOVING + 1)) + [MOVING] * 16
"""The end comes first: it is what a preview shows."""


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
        name: drive(
            profile(plan.path, model, vehicle=slow), EngineRobot.from_model(model), model
        ).run
        for name, plan in (("least energy", made.energy_optimal), ("shortest", made.shortest))
    }
    figure = Figure(figsize=(plots.WIDTH, 6.2), dpi=110)
    ax = plots.occupancy(figure.add_axes((0.01, 0.36, 0.98, 0.58)), grid)
    ax.set(xlabel="", ylabel="", xticks=[], yticks=[])
    spent = {name: float(np.sum(run.power)) * run.period for name, run in runs.items()}
    saved = 1.0 - spent["least energy"] / spent["shortest"]
    ax.set_title(
        f"Two routes, driven in a physics engine: {100 * saved:.0f} % less energy", loc="left",
        fontsize="medium",
    )  # fmt: skip
    ax.set_autoscale_on(False)
    below = figure.add_axes((0.13, 0.09, 0.52, 0.22))
    below.set(xlabel="progress along the route [%]", ylabel="energy [kJ]", xlim=(0, 100))
    (low_x, low_y), (high_x, high_y) = vehicle.footprint
    drives = {}
    for name, run in runs.items():
        colour = COLOURS[name]
        # progress counts the travel of the wheels, so that turns on the spot count too
        turned = np.abs(np.diff(np.unwrap(run.yaw))) * (high_y - low_y) / 2
        moved = np.hypot(np.diff(run.x), np.diff(run.y)) + turned
        travel = np.concatenate([[0.0], np.cumsum(moved)])
        box = Rectangle((low_x, low_y), high_x - low_x, high_y - low_y, color=colour, alpha=0.8)
        energy = np.cumsum(run.power) * run.period / 1000
        drives[name] = (
            100 * travel / travel[-1],
            energy,
            ax.add_patch(box),
            ax.plot([], [], color=colour, lw=2)[0],
            below.plot([], [], color=colour, lw=2)[0],
            below.text(102, energy[-1], "", color=colour, va="center"),
        )
    below.set_ylim(0, 1.1 * max(energy[-1] for _, energy, *_ in drives.values()))

    def draw(frame: int) -> list[object]:
        now = 100 * frame / MOVING
        for name, (progress, energy, box, route, curve, label) in drives.items():
            run = runs[name]
            k = min(int(np.searchsorted(progress, now)), len(run.t) - 1)
            route.set_data(run.x[: k + 1 : 10], run.y[: k + 1 : 10])
            turn = Affine2D().rotate(run.yaw[k]).translate(run.x[k], run.y[k])
            box.set_transform(turn + ax.transData)
            curve.set_data(progress[: k + 1 : 10], energy[: k + 1 : 10])
            label.set_text(f"{name} {energy[-1]:.2f} kJ" if now == 100 else name)
        return []

    FuncAnimation(figure, draw, frames=FRAMES).save(file, writer=PillowWriter(fps=12))


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else "docs/pictures/closing_the_loop.gif")
