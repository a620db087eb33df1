"""Iso-energy surfaces around a pose, and the motions that attain the least energy.

Draws the pictures of docs/planner.md:

    python examples/iso_energy.py [FOLDER]
"""

from __future__ import annotations

import sys
from pathlib import Path as File

import numpy as np
from matplotlib.figure import Figure

from energyplan import EnergyCost, Path, PowerModel, steering
from energyplan.output import plots
from energyplan.output.plots import png

RATIOS = (0.2, 1.0, 2.7)
HEADINGS = (0, 45, 90, 180)
WORDS = (
    (0.0, 1.0, 0),
    (2.0, 1.0, 0),
    (1.0, 0.5, 60),
    (0.4, 0.3, 90),
    (-1.0, 1.5, 180),
    (0.0, 0.15, 0),
)


def surfaces(folder: File) -> File:
    """Draw the least energy to positions around the origin, for several c and goal headings."""
    side = np.linspace(-4, 4, 161)
    x, y = np.meshgrid(side, side)
    figure = Figure(figsize=(plots.WIDTH, 7.6), layout="constrained")
    axes = figure.subplots(len(HEADINGS), len(RATIOS), sharex=True, sharey=True)
    for column, c in zip(axes.T, RATIOS, strict=True):
        cost = EnergyCost.from_coefficients(per_metre=1.0, per_radian=c, icr=1.0)
        for ax, heading in zip(column, HEADINGS, strict=True):
            goals = np.stack([x, y, np.full_like(x, np.deg2rad(heading))], axis=-1)
            energy = steering.energy((0, 0, 0), goals, cost)
            filled = ax.contourf(x, y, energy, levels=np.arange(0, 14.1, 0.5), extend="max")
            ax.contour(x, y, energy, levels=np.arange(0, 14.1, 1.0), colors="k", linewidths=0.4)
            ax.annotate("", (0.8, 0), (0, 0), arrowprops={"arrowstyle": "->", "color": "w"})
            ax.set_aspect("equal")
            ax.set_title(f"c = {c:g}, {heading}°", fontsize="medium", loc="left")
    for ax in axes[-1]:
        ax.set_xticks((-3, 0, 3))
        ax.set_xlabel("x / C [1]")
    for ax in axes[:, 0]:
        ax.set_ylabel("y / C [1]")
    figure.colorbar(filled, ax=axes, label="least energy / (a C) [1]", location="bottom", aspect=40)
    target = folder / "iso_energy.png"
    target.write_bytes(png(figure))
    return target


def _letters(route: Path) -> str:
    """Name the segments: S straight, P pivot, T spin; + forwards, - backwards, l and r by turn."""
    names = []
    for ds, dtheta in zip(route.ds, route.dtheta, strict=True):
        way = "+" if ds > 0 else "-"
        if dtheta == 0:
            names.append(f"S{way}")
        else:
            side = "l" if dtheta > 0 else "r"
            names.append(f"P{side}{way}" if ds else f"T{side}")
    return " ".join(names)


def words(folder: File) -> File:
    """Draw example motions of Quadriga on concrete, with what they cost."""
    cost = EnergyCost(PowerModel.preset("quadriga:empty:concrete"))
    figure = plots.figure(3, 2, size=(plots.WIDTH, 7.6))
    for ax, (x, y, heading) in zip(figure.axes, WORDS, strict=True):
        goal = (x, y, np.deg2rad(heading))
        route = steering.path((0, 0, 0), goal, cost)
        fine = route.poses(max_ds=0.02, max_dtheta=0.03)
        ax.plot(fine[:, 0], fine[:, 1], lw=2, color=plots.BLUE)
        corners = route.vertices
        ax.plot(corners[:, 0], corners[:, 1], "o", ms=4, color=plots.RED)
        for px, py, yaw in corners:
            ax.plot([px, px + 0.12 * np.cos(yaw)], [py, py + 0.12 * np.sin(yaw)], "k", lw=0.8)
        ax.set_title(
            f"{x:g} m, {y:g} m, {heading}°: {cost.energy(route):.0f} J\n{_letters(route)}",
            fontsize="medium", loc="left",
        )  # fmt: skip
        ax.set_aspect("equal", adjustable="datalim")
    for ax in figure.axes[-2:]:
        ax.set_xlabel("x [m]")
    for ax in figure.axes[::2]:
        ax.set_ylabel("y [m]")
    target = folder / "steering_words.png"
    target.write_bytes(png(figure))
    return target


def main() -> None:
    """Draw both pictures into the folder given, or the working directory."""
    folder = File(sys.argv[1] if len(sys.argv) > 1 else ".")
    folder.mkdir(parents=True, exist_ok=True)
    for picture in (surfaces(folder), words(folder)):
        print(picture)


if __name__ == "__main__":
    main()
