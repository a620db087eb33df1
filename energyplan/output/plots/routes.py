"""Pictures of places: maps, routes, missions."""

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

from energyplan.path import Path

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
    WIDTH,
    YELLOW,
    figure,
    legend,
)
from energyplan.output.plots.style import label as style_label

TOP = (0.5, 1.0)
"""Where a map lies in the room left by a bar of colours: else no room is made for what is above."""

OCCUPIED, UNKNOWN = 0.25, 0.85
"""Greys of cells, from black to white."""

MARK = 5.0
"""Half of the room that the mark of a place takes, its edge included [points]."""


def occupancy(ax: Axes, grid: OccupancyGrid) -> Axes:
    """Draw a map's occupied cells, and those of which it knows nothing in a light grey.

    Examples
    --------
    >>> import numpy as np
    >>> import energyplan as ep
    >>> hall = ep.OccupancyGrid(np.zeros((40, 60), bool), resolution=0.1)
    >>> [float(x) for x in occupancy(figure().axes[0], hall).get_xlim()]
    [0.0, 6.0]
    """
    x, y, yaw = (float(v) for v in grid.origin)
    rows, columns = grid.occupied.shape
    shade = np.where(grid.occupied, OCCUPIED, np.nan)
    if grid.unknown is not None:
        shade[grid.unknown & ~grid.occupied] = UNKNOWN
    image = ax.imshow(
        np.ma.masked_invalid(shade),
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
    """Draw the energy that each place takes, over its map.

    Examples
    --------
    >>> import numpy as np
    >>> import energyplan as ep
    >>> hall = ep.OccupancyGrid(np.zeros((40, 60), bool), resolution=0.1)
    >>> model = ep.PowerModel.preset("quadriga:empty:marble")
    >>> problem = ep.PlanningProblem(hall, ep.EnergyCost(model), (1, 2, 0), (4, 2, 0))
    >>> made = energy_map(ep.energy_map(problem), hall)
    >>> made.axes[-1].get_xlabel()
    'energy to get there [kJ]'
    """
    made = figure(size=(WIDTH, 4.4))
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
        along, up = ((np.arange(n) + 0.5) * found.resolution for n in (columns, rows))
        ax.contour(
            along, up, energy, most * np.arange(1, levels) / levels, colors="white",
            linewidths=0.8, zorder=3, transform=turn + ax.transData,
        )  # fmt: skip
    ax.plot(found.start.x, found.start.y, "o", color=ORANGE, ms=7, zorder=4)
    if found.back is not None and found.back != found.start:
        ax.plot(found.back.x, found.back.y, "s", color=RED, ms=7, zorder=4)
    ways = "to get there" if found.back is None else "to get there and back"
    sure = "" if found.confidence is None else f", with {100 * found.confidence:g} %"
    label = f"energy {ways}{sure} [kJ]"
    made.colorbar(image, ax=ax, label=label, location="bottom", aspect=40, panchor=TOP)
    return made


def route(
    ax: Axes, path: Path, label: str, color: str = BLUE, dash: str = "-", arrows: bool = True
) -> Axes:
    """Draw a path, its start and, with `arrows`, its headings.

    Examples
    --------
    >>> import numpy as np
    >>> import energyplan as ep
    >>> hall = ep.OccupancyGrid(np.zeros((40, 60), bool), resolution=0.1)
    >>> path = ep.Path(ep.Pose(1, 2, 0), ds=[3.0], dtheta=[0.0])
    >>> route(occupancy(figure().axes[0], hall), path, "straight on").get_ylabel()
    'y [m]'
    """
    poses = path.poses()
    ax.plot(poses[:, 0], poses[:, 1], color=color, ls=dash, lw=2, label=label, zorder=3)
    ax.plot(*poses[0, :2], "o", color=color, ms=5, zorder=3)
    if arrows:
        along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(poses[:, :2], axis=0).T))])
        marks = np.searchsorted(along, np.linspace(0, along[-1], 8)).clip(0, len(poses) - 1)
        marks[-1] = len(poses) - 1  # after a turn on the spot
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

    Examples
    --------
    >>> import numpy as np
    >>> import energyplan as ep
    >>> hall = ep.OccupancyGrid(np.zeros((40, 60), bool), resolution=0.1)
    >>> path = ep.Path(ep.Pose(1, 2, 0), ds=[3.0], dtheta=[0.0])
    >>> made = routes(hall, {"straight on": path})
    >>> [text.get_text() for text in made.axes[0].get_legend().get_texts()]
    ['straight on']
    """
    rows, columns = grid.occupied.shape
    height = float(np.clip((WIDTH - 0.7) * rows / columns + 1.0, 2.4, 7.5))
    made = figure(size=(WIDTH, height))
    ax = occupancy(made.axes[0], grid)
    _surfaces(ax, surfaces)
    for (label, path), (color, dash) in zip(paths.items(), LINES, strict=False):
        route(ax, path, label, color, dash)
    made.suptitle(title, x=0.01, ha="left", fontsize="large")
    if paths or surfaces:
        legend(ax, above=True)
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
    """Draw a mission's route, coloured by power, and its tasks: crossed where unreachable.

    Examples
    --------
    >>> import numpy as np
    >>> import energyplan as ep
    >>> hall = ep.OccupancyGrid(np.zeros((40, 60), bool), resolution=0.1)
    >>> model = ep.PowerModel.preset("quadriga:empty:marble")
    >>> mission = ep.Mission(
    ...     model, hall, ep.Battery.preset("quadriga"), (1, 2, 0),
    ...     (ep.Task("look", (4, 2, 0), dwell=60.0, power=20.0),),
    ...     planning_effort=1000, coefficient_spread=0.05,
    ... )
    >>> report = ep.evaluate(mission)
    >>> mission_map(report).axes[-1].get_xlabel()
    'power [W]'
    """
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
    made.set_figheight(made.get_figheight() + 0.7)
    made.colorbar(drawn, ax=ax, label="power [W]", location="bottom", aspect=40, panchor=TOP)
    verdicts = {task.name: task.verdict == "reachable" for task in report.tasks}
    places = [("start", mission.start, "s", BLACK)]
    for task in mission.tasks:
        good = verdicts[task.name]
        places.append((task.name, task.pose, "o" if good else "X", GREEN if good else RED))
    places += [(charger.name, charger.pose, "P", BLUE) for charger in mission.chargers]
    for _, pose, marker, color in places:
        ax.plot(pose.x, pose.y, marker, color=color, ms=2 * MARK - 2, mec="white", zorder=5)
    _name_places(made, {name: (pose.x, pose.y) for name, pose, *_ in places}, points)
    return made


def _short(name: str) -> str:
    """Return a name that leaves room for the picture beside it."""
    return name if len(name) <= 28 else f"{name[:27]}…"


def _name_places(figure: Figure, places: Mapping[str, tuple[float, float]], line: Any) -> None:
    """Write names beside places: off marks, lines and each other, within the axes if possible."""
    ax = figure.axes[0]
    marks = list(places.values())
    notes = [
        ax.annotate(
            _short(name), at, xytext=(0, 0), textcoords="offset points", fontsize="small", zorder=6,
            va="bottom",
            bbox={"facecolor": "white", "alpha": 0.8, "edgecolor": "none", "pad": 1},
            arrowprops={"arrowstyle": "-", "lw": 0.6, "color": "0.4", "shrinkA": 0},
        )
        for name, at in places.items()
    ]  # fmt: skip
    for note in notes:
        note.set_in_layout(False)  # names must not move the map that they are placed on
    figure.draw_without_rendering()
    scale = figure.dpi / 72
    frame = ax.get_window_extent()
    drawn = ax.transData.transform(line)
    steps = np.linspace(0.0, 1.0, 50)[:, None, None]  # closer than a name is high
    between = drawn[:-1] + steps * np.diff(drawn, axis=0)
    busy_x, busy_y = np.vstack([between.reshape(-1, 2), ax.transData.transform(marks)]).T.copy()
    half = MARK * scale
    taken: list[Any] = [(at - half, at + half) for at in ax.transData.transform(marks)]
    turns = np.arange(16) * np.pi / 8 + np.pi / 4
    for note, at in zip(notes, marks, strict=True):
        box = note.get_window_extent()
        wide, high = box.width + 2 * scale, box.height + 2 * scale
        centre = ax.transData.transform(at)
        best, least = (0.0, 0.0), np.inf
        for gap in (7.0, 16.0, 28.0):
            for turn in turns:
                way = np.array([np.cos(turn), np.sin(turn)])
                middle = centre + way * (gap * scale + 0.5 * np.abs(way) * (wide, high))
                low, top = (
                    middle - 0.5 * np.array([wide, high]),
                    middle + 0.5 * np.array([wide, high]),
                )
                out = np.any(low < frame.min) or np.any(top > frame.max)
                hit = sum(bool(np.all(low < b) and np.all(a < top)) for a, b in taken)
                price = 1e6 * out + 1e4 * hit + gap
                if price < least:
                    beside = (busy_x > low[0]) & (busy_x < top[0])
                    over = beside & (busy_y > low[1]) & (busy_y < top[1])
                    price += 10.0 * np.count_nonzero(over)
                if price < least:
                    best, least, place = tuple((low - centre) / scale + 1), price, (low, top)
        note.set_position(best)
        taken.append(place)


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

    Examples
    --------
    >>> import numpy as np
    >>> import energyplan as ep
    >>> hall = ep.OccupancyGrid(np.zeros((40, 60), bool), resolution=0.1)
    >>> model = ep.PowerModel.preset("quadriga:empty:marble")
    >>> mission = ep.Mission(
    ...     model, hall, ep.Battery.preset("quadriga"), (1, 2, 0),
    ...     (ep.Task("look", (4, 2, 0), dwell=60.0, power=20.0),),
    ...     planning_effort=1000, coefficient_spread=0.05,
    ... )
    >>> report = ep.evaluate(mission)
    >>> state_of_charge(figure().axes[0], report).get_ylabel()
    'state of charge [%]'
    """
    line, mission = report.timeline, report.mission
    minutes = line.t / 60
    band = f"{100 * mission.confidence:.0f} % on either side"
    ax.fill_between(
        minutes, 100 * line.soc_lower, 100 * line.soc_upper, color=SKY, alpha=0.5, lw=0, label=band
    )
    ax.plot(minutes, 100 * line.soc, color=BLUE, lw=1.5, label="expected")
    ax.axhline(100 * mission.reserve, color=RED, ls="--", lw=1.2, label="reserve")
    style_label(ax, "time [min]", "state of charge [%]", "")
    ax.set_ylim(0, 105)
    legend(ax, above=True)
    return ax


def visits(ax: Axes, report: MissionReport) -> Axes:
    """Draw when the robot is where: a bar for each stop, with its name beside the axis."""
    names = list(dict.fromkeys(stop.name for stop in report.route))
    colors = {"charge": BLUE, "task": GREEN, "start": BLACK, "end": BLACK}
    for stop in report.route:
        begin, stay = stop.arrival / 60, (stop.departure - stop.arrival) / 60
        row = names.index(stop.name)
        ax.barh(row, stay, left=begin, height=0.6, color=colors[stop.kind])
        ax.plot(begin, row, "|", color=colors[stop.kind], ms=8)
    ax.set_yticks(range(len(names)), [_short(name) for name in names], fontsize="small")
    ax.set_ylim(len(names) - 0.5, -0.5)
    style_label(ax, "time [min]", "", "")
    return ax


def mission_charge(report: MissionReport) -> Figure:
    """Draw charge over a mission, where the robot is, and the power at the battery.

    Examples
    --------
    >>> import numpy as np
    >>> import energyplan as ep
    >>> hall = ep.OccupancyGrid(np.zeros((40, 60), bool), resolution=0.1)
    >>> model = ep.PowerModel.preset("quadriga:empty:marble")
    >>> mission = ep.Mission(
    ...     model, hall, ep.Battery.preset("quadriga"), (1, 2, 0),
    ...     (ep.Task("look", (4, 2, 0), dwell=60.0, power=20.0),),
    ...     planning_effort=1000, coefficient_spread=0.05,
    ... )
    >>> report = ep.evaluate(mission)
    >>> [ax.get_ylabel() for ax in mission_charge(report).axes]
    ['state of charge [%]', '', 'power [W]']
    """
    count = len({stop.name for stop in report.route})
    made = Figure(figsize=(WIDTH, 4.2 + 0.22 * count), layout="constrained")
    charge, where, power = made.subplots(
        3, 1, sharex=True, height_ratios=(2.2, 0.3 + 0.22 * count, 1.4)
    )
    for ax in made.axes:
        ax.grid(alpha=0.3)
        ax.spines[["top", "right"]].set_visible(False)
    state_of_charge(charge, report)
    visits(where, report)
    line = report.timeline
    power.step(line.t / 60, line.power, color=BLACK, lw=0.8, where="post", rasterized=True)
    style_label(power, "time [min]", "power [W]", "")
    for ax in (charge, where):
        ax.set_xlabel("")
    return made
