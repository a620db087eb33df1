"""Pictures: functions that take matplotlib axes and return them.

Every axis has its unit. Colours are those of Okabe and Ito, which colour-blind people tell apart;
lines that may coincide differ in style as well.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import matplotlib as mpl
import matplotlib.collections
import matplotlib.colors
import matplotlib.patches
import matplotlib.path
import matplotlib.transforms
import numpy as np
import shapely
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from energyplan.logs import DriveLog
from energyplan.path import FloatArray, Path, Pose

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from shapely.geometry.base import BaseGeometry

    from energyplan.limits.feasibility import FeasibleRegion
    from energyplan.mission import MissionReport
    from energyplan.studies.pareto import ParetoFront
    from energyplan.terrain import OccupancyGrid

BLACK, ORANGE, SKY, GREEN, YELLOW, BLUE, RED, PURPLE = (
    "#000000", "#E69F00", "#56B4E9", "#009E73", "#F0E442", "#0072B2", "#D55E00", "#CC79A7",
)  # fmt: skip
"""Palette of Okabe and Ito (2008)."""


def figure(rows: int = 1, columns: int = 1, *, size: tuple[float, float] = (8.0, 4.5)) -> Figure:
    """Return an empty figure in the library's style, without a window.

    Parameters
    ----------
    rows, columns : int
        Grid of axes.
    size : tuple of float
        Width and height [inch].

    Returns
    -------
    Figure
        The figure; its axes are in ``figure.axes``, row by row.
    """
    made = Figure(figsize=size, layout="constrained")
    for ax in made.subplots(rows, columns, squeeze=False).flat:
        ax.grid(alpha=0.3)
        ax.spines[["top", "right"]].set_visible(False)
    return made


def _label(ax: Axes, x: str, y: str, title: str) -> None:
    ax.set(xlabel=x, ylabel=y)
    ax.set_title(title, loc="left", fontsize="medium")


def _legend(ax: Axes, outside: bool = False, **options: Any) -> None:
    if outside:
        options |= {"loc": "upper left", "bbox_to_anchor": (1.0, 1.0)}
    ax.legend(frameon=False, fontsize="small", **options)


def tread_speeds(ax: Axes, log: DriveLog) -> Axes:
    """Draw the speeds of both sides over time."""
    ax.plot(log.t, log.channel("v_left"), color=BLUE, lw=1.2, label="left")
    ax.plot(log.t, log.channel("v_right"), color=ORANGE, lw=1.2, ls="--", label="right")
    _label(ax, "time [s]", "tread speed [m/s]", "Tread speeds")
    _legend(ax, ncols=2)
    return ax


def power_over_time(ax: Axes, log: DriveLog, predictions: Mapping[str, ArrayLike]) -> Axes:
    """Draw measured and predicted power over time.

    Parameters
    ----------
    ax : Axes
        Where to draw.
    log : DriveLog
        The drive.
    predictions : mapping of str to array_like, shape (n,)
        Predicted power [W] by label.

    Returns
    -------
    Axes
        `ax`.
    """
    ax.plot(log.t, log.power, color="0.6", lw=0.8, label="measured")
    for (label, power), (color, dash) in zip(predictions.items(), _LINES, strict=False):
        ax.plot(log.t, power, color=color, ls=dash, lw=1.2, label=label)
    _label(ax, "time [s]", "power [W]", "Power")
    _legend(ax, ncols=3)
    return ax


def energy_over_time(ax: Axes, log: DriveLog, predictions: Mapping[str, ArrayLike]) -> Axes:
    """Draw measured and predicted energy since the start; arguments as in `power_over_time`."""
    ax.plot(log.t, _integral(log.t, log.power) / 1e3, color="0.6", lw=2.5, label="measured")
    for (label, power), (color, dash) in zip(predictions.items(), _LINES, strict=False):
        energy = _integral(log.t, np.asarray(power, float)) / 1e3
        ax.plot(log.t, energy, color=color, ls=dash, lw=1.4, label=label)
    _label(ax, "time [s]", "energy [kJ]", "Energy since the start")
    _legend(ax)
    return ax


def prediction(log: DriveLog, predictions: Mapping[str, ArrayLike], title: str = "") -> Figure:
    """Draw tread speeds, power and energy of a drive, as in the paper's figures 6 to 9.

    Parameters
    ----------
    log : DriveLog
        A drive, best one that the model was not fitted to.
    predictions : mapping of str to array_like, shape (n,)
        Predicted power [W] by label.
    title : str
        Title of the figure.

    Returns
    -------
    Figure
        Three axes, one above the other.
    """
    made = figure(3, 1, size=(8.0, 8.0))
    tread_speeds(made.axes[0], log)
    power_over_time(made.axes[1], log, predictions)
    energy_over_time(made.axes[2], log, predictions)
    for ax in made.axes[:2]:
        ax.set_xlabel("")
    made.suptitle(title, x=0.01, ha="left", fontsize="large")
    return made


def bin_means(x: ArrayLike, series: Sequence[ArrayLike], bins: int = 24) -> list[FloatArray]:
    """Average in bins of `x` that hold equally many samples.

    Parameters
    ----------
    x : array_like, shape (n,)
        What decides on the bin.
    series : sequence of array_like, shape (n,)
        What is averaged.
    bins : int
        Number of bins; fewer are used where values of `x` repeat.

    Returns
    -------
    list of ndarray, shape (m,)
        The means of `x`, then those of each series, by bin.
    """
    known = np.asarray(x, float)
    edges = np.unique(np.quantile(known, np.linspace(0, 1, bins + 1)))
    place = np.clip(np.searchsorted(edges, known, side="right") - 1, 0, max(len(edges) - 2, 0))
    count = np.bincount(place)
    used = count > 0
    rows = [known, *(np.asarray(values, float) for values in series)]
    return [np.bincount(place, row)[used] / count[used] for row in rows]


def residual_against(
    ax: Axes,
    channel: ArrayLike,
    residuals: Mapping[str, ArrayLike],
    label: str,
    bins: int = 24,
) -> Axes:
    """Draw residuals against a channel: the samples, and the mean in equally filled bins.

    Parameters
    ----------
    ax : Axes
        Where to draw.
    channel : array_like, shape (n,)
        The channel.
    residuals : mapping of str to array_like, shape (n,)
        Measured minus predicted power [W] by label, such as before and after.
    label : str
        Name and unit of the channel.
    bins : int
        Number of bins.

    Returns
    -------
    Axes
        `ax`.
    """
    x = np.asarray(channel, float)
    centre, *means = bin_means(x, list(residuals.values()), bins)
    thin = slice(None, None, max(1, len(x) // 4000))
    for (name, residual), mean, (color, dash) in zip(
        residuals.items(), means, _LINES, strict=False
    ):
        r = np.asarray(residual, float)
        ax.plot(x[thin], r[thin], ".", ms=2, color=color, alpha=0.15, rasterized=True)
        ax.plot(centre, mean, color=color, ls=dash, marker="o", ms=3, label=f"{name} (bin mean)")
    ax.axhline(0, color=BLACK, lw=0.8)
    _label(ax, label, "measured - predicted [W]", f"Residual against {label}")
    _legend(ax)
    return ax


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
    for (label, path), (color, dash) in zip(paths.items(), _LINES, strict=False):
        route(ax, path, label, color, dash)
    made.suptitle(title, x=0.01, ha="left", fontsize="large")
    if paths or surfaces:
        _legend(ax, loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=4)
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
    _label(ax, "time [min]", "state of charge [%]", "")
    ax.set_ylim(0, 105)
    _legend(ax, outside=True)
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
    _label(power, "time [min]", "power [W]", "")
    return made


def breakdown(ax: Axes, parts: Mapping[str, Mapping[str, float]]) -> Axes:
    """Draw joules by term, one stacked bar per plan.

    Parameters
    ----------
    ax : Axes
        Where to draw.
    parts : mapping of str to mapping of str to float
        For each plan's label the energy of each term [J].

    Returns
    -------
    Axes
        `ax`.
    """
    names = list(dict.fromkeys(name for part in parts.values() for name in part))
    below = np.zeros(len(parts))
    colors = (BLUE, ORANGE, GREEN, PURPLE, SKY, RED, YELLOW)
    for k, name in enumerate(names):
        values = np.array([part.get(name, 0.0) for part in parts.values()]) / 1e3
        ax.barh(
            list(parts), values, left=below, color=colors[k % len(colors)],
            label=name.replace("_", " "),
        )  # fmt: skip
        below = below + values
    _label(ax, "energy [kJ]", "", "Energy by term")
    _legend(ax, outside=True)
    return ax


def pareto(ax: Axes, front: ParetoFront) -> Axes:
    """Draw energy against time: the drives known, and below them what no drive can reach.

    Parameters
    ----------
    ax : Axes
        Where to draw.
    front : ParetoFront
        Result of `energyplan.pareto`.

    Returns
    -------
    Axes
        `ax`.
    """
    times, energies = front.duration, front.energy / 1e3
    span = np.linspace(0.95 * times.min(), 1.05 * times.max(), 200)
    least = front.least_energy(span) / 1e3
    ax.fill_between(span, 0, least, color="0.85", lw=0, label="impossible")
    ax.plot(times, energies, "o-", color=BLUE, lw=1.2, ms=5, label="drives")
    for point, x, y in zip(front.points, times, energies, strict=True):
        ax.annotate(
            f"{point.time_value:.0f} J/s", (x, y), xytext=(4, 5), textcoords="offset points",
            fontsize="small",
        )  # fmt: skip
    ax.set(xlim=(span[0], span[-1]), ylim=(0.97 * least.min(), 1.03 * energies.max()))
    _label(ax, "time [s]", "energy [kJ]", "Energy against time, by what a second is worth")
    _legend(ax)
    return ax


def feasible_region(ax: Axes, region: FeasibleRegion) -> Axes:
    """Draw which curvatures and speeds the motors can drive for ever, for a while, or not.

    Parameters
    ----------
    ax : Axes
        Where to draw.
    region : FeasibleRegion
        Result of `energyplan.limits.feasibility.feasible_region`.

    Returns
    -------
    Axes
        `ax`.
    """
    level = region.sustained.astype(float) + region.brief
    shades = mpl.colors.ListedColormap(["0.85", YELLOW, GREEN])
    ax.pcolormesh(
        region.curvature, region.speed, level.T, cmap=shades, vmin=0, vmax=2, alpha=0.7,
        shading="nearest", rasterized=True,
    )  # fmt: skip
    ax.plot(region.curvature, region.max_speed, color=BLACK, lw=1.2)
    handles = [
        mpl.patches.Patch(color=color, alpha=0.7, label=label)
        for color, label in ((GREEN, "for ever"), (YELLOW, "for a while"), ("0.85", "not at all"))
    ]
    _legend(ax, outside=True, handles=handles)
    _label(ax, "curvature [1/m]", "speed [m/s]", "What the motors can drive")
    ax.grid(visible=False)
    return ax


_LINES = ((BLUE, "-"), (RED, "--"), (GREEN, "-."), (PURPLE, ":"))


def _integral(t: FloatArray, power: FloatArray) -> FloatArray:
    steps = 0.5 * (power[1:] + power[:-1]) * np.diff(t)
    return np.concatenate([[0.0], np.cumsum(steps)])
