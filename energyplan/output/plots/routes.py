"""Pictures of places: maps, routes, missions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import matplotlib as mpl
import matplotlib.collections
import matplotlib.colors
import matplotlib.patches
import matplotlib.path
import matplotlib.transforms
import numpy as np
import shapely
from matplotlib.figure import Figure

from energyplan.path import Path, Pose

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from shapely.geometry.base import BaseGeometry

    from energyplan.mission import MissionReport
    from energyplan.studies.energy_map import EnergyMap
    from energyplan.terrain import OccupancyGrid

from energyplan.output.plots.style import (
    BLACK,
    BLUE,
    GREEN,
    LINES,
    ORANGE,
    PURPLE,
    RED,
    SKY,
    YELLOW,
    figure,
    legend,
)
from energyplan.output.plots.style import label as style_label


def occupancy(ax: Axes, grid: OccupancyGrid) -> Axes:
    """Draw a map's occupied cells."""
    x, y, yaw = (float(v) for v in grid.origin)
    rows, columns = grid.occupied.shape
    image = ax.imshow(
        np.ma.masked_where(~grid.occupied, np.full(grid.occupied.shape, 0.25)),
        cmap="gray", vmin=0, vmax=1, origin="lower", interpolation="nearest", zorder=2,
        extent=(0.0, columns * grid.resolution, 0.0, rows * grid.resolution),
    )  # fmt: skip
    turn = mpl.transforms.Affine2D().rotate(yaw).translate(x, y)
    image.set_transform(turn + ax.transData)
    corners = np.array([(0, 0), (columns, 0), (0, rows), (columns, rows)]) * grid.resolution
    placed = turn.transform(corners)
    ax.set_xlim(placed[:, 0].min(), placed[:, 0].max())
    ax.set_ylim(placed[:, 1].min(), placed[:, 1].max())
    ax.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
    ax.grid(visible=False)
    return ax


def energy_map(found: EnergyMap, grid: OccupancyGrid, levels: int = 8) -> Figure:
    """Draw the energy that each place takes, over its map."""
    made = figure(size=(8.0, 6.0))
    ax = occupancy(made.axes[0], grid)
    energy = np.ma.masked_invalid(found.energy / 1e3)
    rows, columns = energy.shape
    image = ax.imshow(
        energy, cmap="viridis", origin="lower", interpolation="nearest", zorder=1,
        extent=(0.0, columns * found.resolution, 0.0, rows * found.resolution),
    )  # fmt: skip
    x, y, yaw = found.origin
    turn = mpl.transforms.Affine2D().rotate(yaw).translate(x, y)
    image.set_transform(turn + ax.transData)
    most = float(energy.max()) if energy.count() else 0.0
    if most > 0:
        for area in found.contours((1e3 * most * np.arange(1, levels) / levels).tolist()):
            for part in area.area.geoms:
                ax.plot(*part.exterior.xy, color="white", lw=0.8, zorder=3)
    ax.plot(found.start.x, found.start.y, "o", color=ORANGE, ms=7, zorder=4)
    ways = "to get there" if found.back is None else "to get there and back"
    made.colorbar(image, ax=ax, label=f"energy {ways} [kJ]")
    return made


def route(
    ax: Axes, path: Path, label: str, color: str = BLUE, dash: str = "-", arrows: bool = True
) -> Axes:
    """Draw a path, its start and, with `arrows`, its headings."""
    poses = path.poses()
    ax.plot(poses[:, 0], poses[:, 1], color=color, ls=dash, lw=2, label=label, zorder=3)
    ax.plot(*poses[0, :2], "o", color=color, ms=5, zorder=3)
    if arrows:
        along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(poses[:, :2], axis=0).T))])
        marks = np.searchsorted(along, np.linspace(0, along[-1], 8)).clip(0, len(poses) - 1)
        ax.quiver(
            poses[marks, 0], poses[marks, 1], np.cos(poses[marks, 2]), np.sin(poses[marks, 2]),
            color=color, angles="xy", scale=30, width=0.004, zorder=3,
        )  # fmt: skip
    return ax


def routes(
    grid: OccupancyGrid,
    paths: Mapping[str, Path],
    title: str = "",
    surfaces: Sequence[tuple[str, BaseGeometry]] = (),
) -> Figure:
    """Draw routes on a map.

    Parameters
    ----------
    grid : OccupancyGrid
        The map.
    paths : mapping of str to Path
        Routes by label.
    title : str
        Title of the figure.
    surfaces : sequence of (name, shapely polygon)
        Ground to colour.

    Returns
    -------
    Figure
        One axes.
    """
    rows, columns = grid.occupied.shape
    height = float(np.clip(8.0 * rows / columns + 1.0, 3.0, 9.0))
    made = figure(size=(9.0, height))
    ax = occupancy(made.axes[0], grid)
    _surfaces(ax, surfaces)
    for (label, path), (color, dash) in zip(paths.items(), LINES, strict=False):
        route(ax, path, label, color, dash)
    made.suptitle(title, x=0.01, ha="left", fontsize="large")
    if paths or surfaces:
        legend(ax, loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=4)
    return made


def _surfaces(ax: Axes, surfaces: Sequence[tuple[str, BaseGeometry]]) -> None:
    tints = (SKY, ORANGE, GREEN, PURPLE, YELLOW)
    names = list(dict.fromkeys(name for name, _ in surfaces))
    for name, area in surfaces:
        outline = mpl.path.Path.make_compound_path(
            *(
                mpl.path.Path(np.asarray(ring.coords), closed=True)
                for part in shapely.get_parts(area)
                for ring in (part.exterior, *part.interiors)
            )
        )
        tint = RED if name == "keep-out" else tints[names.index(name) % len(tints)]
        ax.add_patch(mpl.patches.PathPatch(outline, color=tint, alpha=0.2, lw=0, label=name))


def mission_map(report: MissionReport) -> Figure:
    """Draw a mission's route, coloured by power, and its tasks: crossed where unreachable."""
    mission, line = report.mission, report.timeline
    areas = mission.surfaces.polygons if mission.surfaces else ()
    made = routes(mission.map, {}, surfaces=areas)
    ax = made.axes[0]
    points = np.column_stack([line.x, line.y])
    moving = np.any(np.diff(points, axis=0) != 0, axis=1)
    pairs = np.stack([points[:-1], points[1:]], axis=1)[moving]
    drawn = mpl.collections.LineCollection(
        list(pairs), cmap="viridis", lw=2.5, zorder=3, rasterized=True
    )
    drawn.set_array(line.power[:-1][moving])
    ax.add_collection(drawn)
    made.colorbar(drawn, ax=ax, label="power [W]", shrink=0.8)
    verdicts = {task.name: task.verdict == "reachable" for task in report.tasks}
    for task in mission.tasks:
        good = verdicts[task.name]
        _place(ax, task.name, task.pose, "o" if good else "X", GREEN if good else RED)
    for charger in mission.chargers:
        _place(ax, charger.name, charger.pose, "P", BLUE)
    _place(ax, "start", mission.start, "s", BLACK)
    return made


def _place(ax: Axes, name: str, pose: Pose, marker: str, color: str) -> None:
    ax.plot(pose.x, pose.y, marker, color=color, ms=9, mec="white", zorder=5)
    ax.annotate(
        name, (pose.x, pose.y), xytext=(6, 6), textcoords="offset points", fontsize="small",
        zorder=6,
        bbox={"facecolor": "white", "alpha": 0.7, "edgecolor": "none", "pad": 1},
    )  # fmt: skip


def state_of_charge(ax: Axes, report: MissionReport) -> Axes:
    """Draw the state of charge over a mission, its band at the mission's confidence, the reserve.

    Parameters
    ----------
    ax : Axes
        Where to draw.
    report : MissionReport
        The mission's evaluation.

    Returns
    -------
    Axes
        `ax`.
    """
    line, mission = report.timeline, report.mission
    minutes = line.t / 60
    band = f"{100 * mission.confidence:.0f} % on either side"
    ax.fill_between(
        minutes, 100 * line.soc_lower, 100 * line.soc_upper, color=SKY, alpha=0.5, lw=0, label=band
    )
    ax.plot(minutes, 100 * line.soc, color=BLUE, lw=1.5, label="expected")
    ax.axhline(100 * mission.reserve, color=RED, ls="--", lw=1.2, label="reserve")
    begun = sorted((t for t in report.tasks if np.isfinite(t.start)), key=lambda t: t.start)
    for task in begun:
        ax.axvline(task.start / 60, color="0.6", lw=0.8, ls=":")
        ax.annotate(
            task.name, (task.start / 60, 1.0), xycoords=("data", "axes fraction"),
            xytext=(0, 3), textcoords="offset points", rotation=45, va="bottom", ha="left",
            fontsize="small", color="0.3",
        )  # fmt: skip
    style_label(ax, "time [min]", "state of charge [%]", "")
    ax.set_ylim(0, 105)
    legend(ax, outside=True)
    return ax


def mission_charge(report: MissionReport) -> Figure:
    """Draw the state of charge over a mission, and below it the power at the battery."""
    made = figure(2, 1, size=(9.0, 6.0))
    charge, power = made.axes
    power.sharex(charge)
    state_of_charge(charge, report)
    charge.set_xlabel("")
    line = report.timeline
    power.step(line.t / 60, line.power, color=BLACK, lw=0.8, where="post", rasterized=True)
    style_label(power, "time [min]", "power [W]", "")
    return made
