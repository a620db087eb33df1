"""Pictures of places: maps, routes, missions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import shapely
from matplotlib.collections import LineCollection
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import PathPatch
from matplotlib.path import Path as Outline
from matplotlib.ticker import FuncFormatter, MultipleLocator
from matplotlib.transforms import Affine2D, ScaledTranslation, blended_transform_factory

from energyplan.html import clock
from energyplan.output.plots import style
from energyplan.path import FloatArray, Path
from energyplan.planning.plans import spending

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.cm import ScalarMappable
    from matplotlib.image import AxesImage
    from shapely.geometry.base import BaseGeometry

    from energyplan.mission import MissionReport
    from energyplan.path import Pose
    from energyplan.planning import Goal, Plan, PlanningProblem
    from energyplan.reach import EnergyMap
    from energyplan.terrain import OccupancyGrid


ARROWS = 7
"""How many arrows a route has that is as long as its map is wide."""

OCCUPIED, UNKNOWN = 0.25, 0.85
"""Greys of cells, from black to white."""

CHARGE = LinearSegmentedColormap.from_list("charge", (style.RED, style.PURPLE, style.BLUE))
"""Colours of states of charge: black arrows and white lines are seen on each."""

CHARGING = style.ORANGE
"""Colour of what charges."""

STEPS = (1, 5, 10, 30, 60, 120, 300, 600, 900, 1800, 3600, 7200, 14400, 28800, 86400)
"""Distances of marks on an axis of times [s]."""

MARK = 6.0
"""Half of the size of the mark of a place [points]."""


def occupancy(ax: Axes, grid: OccupancyGrid) -> Axes:
    """Draw a map's occupied cells, and those of which it knows nothing in a light grey."""
    shade = np.where(grid.occupied, OCCUPIED, np.nan)
    if grid.unknown is not None:
        shade[grid.unknown & ~grid.occupied] = UNKNOWN
    _, turn = _cells(ax, shade, grid, cmap="gray", vmin=0, vmax=1, zorder=2)
    rows, columns = grid.occupied.shape
    corners = np.array([(0, 0), (columns, 0), (0, rows), (columns, rows)]) * grid.resolution
    placed = turn.transform(corners)
    ax.set_xlim(placed[:, 0].min(), placed[:, 0].max())
    ax.set_ylim(placed[:, 1].min(), placed[:, 1].max())
    ax.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
    ax.grid(visible=False)
    return ax


def _cells(
    ax: Axes, values: FloatArray, frame: OccupancyGrid | EnergyMap, **look: Any
) -> tuple[AxesImage, Affine2D]:
    """Draw values in cells; return the image, and how its frame is turned."""
    rows, columns = values.shape
    image = ax.imshow(
        np.ma.masked_invalid(values), origin="lower", interpolation="nearest",
        extent=(0.0, columns * frame.resolution, 0.0, rows * frame.resolution), **look,
    )  # fmt: skip
    x, y, yaw = map(float, frame.origin)
    turn = Affine2D().rotate(yaw).translate(x, y)
    image.set_transform(turn + ax.transData)
    return image, turn


def _colour_bar(ax: Axes, drawn: ScalarMappable, label: str) -> None:
    """Add a bar of colours below a map, as wide as the map and clear of its axis' label."""
    picture = ax.get_figure(root=True)
    assert picture is not None
    below = picture.dpi_scale_trans + ScaledTranslation(0.0, 0.0, ax.transAxes)  # type: ignore[arg-type]
    inches = blended_transform_factory(ax.transAxes, below)
    bar = ax.inset_axes((0.0, -0.65, 1.0, 0.1), transform=inches)
    picture.colorbar(drawn, cax=bar, label=label, orientation="horizontal")
    ax.set_anchor("S")  # else the layout reckons with more room below than there is
    picture.set_figheight(picture.get_figheight() + 0.75)


def energy_map(found: EnergyMap, grid: OccupancyGrid, levels: int = 8) -> Figure:
    """Draw the energy that each place takes, over its map."""
    picture = routes(grid, {})
    ax = picture.axes[0]
    energy = np.ma.masked_invalid(found.energy / 1e3)
    image, turn = _cells(ax, energy, found, cmap="viridis", zorder=1)
    most = float(energy.max()) if energy.count() else 0.0
    if most > 0:
        along, up = ((np.arange(n) + 0.5) * found.resolution for n in energy.shape[::-1])
        ax.contour(
            along, up, energy, most * np.arange(1, levels) / levels, colors="white",
            linewidths=0.8, zorder=3, transform=turn + ax.transData,
        )  # fmt: skip
    ends: list[tuple[str, str, str, Pose | Goal]] = [("start", "o", style.ORANGE, found.start)]
    if found.back is not None and (found.goals or found.back != found.start):
        for place in found.goals or (found.back,):
            name = "" if len(ends) > 1 else "back at"
            ends.append((name, "s", style.RED, place))
    for name, marker, color, place in ends:
        label = name or None
        ax.plot(place.x, place.y, marker, color=color, mec="white", ms=7, zorder=4, label=label)
    style.legend(ax, above=True)
    ways = "to get there" if found.back is None else "to get there and back"
    sure = "" if found.confidence is None else f", at {100 * found.confidence:g} % confidence"
    _colour_bar(ax, image, f"energy {ways}{sure} [kJ]")
    return picture


def route(
    ax: Axes, path: Path, label: str, color: str = style.BLUE, dash: str = "-", arrows: bool = True
) -> Axes:
    """Draw a path from its start (a disc) to its goal (a ring); `arrows` point where it goes.

    The last arrow is the heading at the goal. What is driven in reverse has a white line inside,
    and its length stands in the legend.
    """
    poses = path.poses()
    if path.reverse_length >= 0.05:
        label += f", {path.reverse_length:.1f} m in reverse (white inside)"
    ax.plot(poses[:, 0], poses[:, 1], color=color, ls=dash, lw=2, label=label, zorder=3)
    ax.plot(*poses[0, :2], "o", color=color, ms=5, zorder=3)
    ax.plot(*poses[-1, :2], "o", color=color, mfc="white", ms=7, mew=1.5, zorder=3)
    if arrows:
        _directions(ax, poses, color, [poses[-1]])
    return ax


def _directions(ax: Axes, poses: FloatArray, color: str, ends: Sequence[FloatArray] = ()) -> None:
    """Draw arrows along a motion and at some poses, and a white line where it goes backwards."""
    steps = np.diff(poses[:, :2], axis=0)
    length = np.hypot(*steps.T)
    along = np.cumsum(length)
    count = int(np.ceil(ARROWS * along[-1] / np.ptp(ax.get_xlim())))
    marks = np.searchsorted(along, along[-1] * (np.arange(count) + 0.5) / count)
    at = np.array([*poses[marks, :2], *(pose[:2] for pose in ends)])
    ways = np.array([*(steps[marks] / length[marks, None]),
                     *((np.cos(pose[2]), np.sin(pose[2])) for pose in ends)])  # fmt: skip
    if len(at):
        ax.quiver(*at.T, *ways.T, color=color, angles="xy", scale=30, width=0.004, zorder=4)
    ahead = steps[:, 0] * np.cos(poses[:-1, 2]) + steps[:, 1] * np.sin(poses[:-1, 2])
    pairs = np.stack([poses[:-1, :2], poses[1:, :2]], axis=1)[ahead < -0.5 * length]
    ax.add_collection(LineCollection(list(pairs), color="white", lw=0.8, zorder=3.5))


def routes(
    grid: OccupancyGrid,
    paths: Mapping[str, Path],
    title: str = "",
    surfaces: Sequence[tuple[str, BaseGeometry]] = (),
) -> Figure:
    """Draw routes on a map."""
    picture = style.figure()
    ax = occupancy(picture.axes[0], grid)
    shape = np.ptp(ax.get_ylim()) / np.ptp(ax.get_xlim())
    height = float(np.clip((style.WIDTH - 0.7) * shape + 1.0, 2.4, 7.5))
    _surfaces(ax, surfaces)
    for (label, path), (color, dash) in zip(paths.items(), style.LINES, strict=False):
        route(ax, path, label, color, dash)
    picture.suptitle(title, x=0.01, ha="left", fontsize="large")
    picture.set_figheight(height + 0.2 * max(style.legend(ax, above=True) - 1, 0))
    return picture


def priced(plans: Mapping[str, Plan]) -> dict[str, Path]:
    """Return the paths of plans by their names with what they take, all as driven or none."""
    spent = spending(*plans.values())
    return {
        f"{name}: {one.energy:.0f} J": plan.path
        for (name, plan), one in zip(plans.items(), spent, strict=True)
    }


def planned(problem: PlanningProblem, paths: Mapping[str, Path]) -> Figure:
    """Draw paths over what was planned on: map, surfaces and heights."""
    picture = routes(
        problem.map, paths, surfaces=problem.surfaces.polygons if problem.surfaces else ()
    )
    if problem.heights is not None:
        problem.heights.contours(picture.axes[0])
    return picture


def _surfaces(ax: Axes, surfaces: Sequence[tuple[str, BaseGeometry]]) -> None:
    tints = (style.SKY, style.ORANGE, style.GREEN, style.PURPLE, style.YELLOW)
    names = list(dict.fromkeys(name for name, _ in surfaces))
    for name, area in surfaces:
        outline = Outline.make_compound_path(
            *(
                Outline(np.asarray(ring.coords), closed=True)
                for part in shapely.get_parts(area)
                for ring in (part.exterior, *part.interiors)
            )
        )
        tint = style.RED if name == "keep-out" else tints[names.index(name) % len(tints)]
        ax.add_patch(PathPatch(outline, color=tint, alpha=0.2, lw=0, label=name))


def mission_map(report: MissionReport) -> Figure:
    """Draw a mission's route, coloured by the state of charge, and its places, numbered.

    The colours span from the reserve to a full battery.
    """
    mission, line = report.mission, report.timeline
    picture = routes(
        mission.map, {}, surfaces=mission.surfaces.polygons if mission.surfaces else ()
    )
    ax = picture.axes[0]
    poses = np.column_stack([line.x, line.y, line.yaw])
    moving = np.any(np.diff(poses[:, :2], axis=0) != 0, axis=1)
    pairs = np.stack([poses[:-1, :2], poses[1:, :2]], axis=1)[moving]
    drawn = LineCollection(list(pairs), cmap=CHARGE, lw=2.5, zorder=3, rasterized=True)
    drawn.set_array(100 * line.soc[:-1][moving])
    drawn.set_clim(100 * min(mission.reserve, float(line.soc.min())), 100)
    ax.add_collection(drawn)
    _directions(ax, poses, style.BLACK)
    reverse = sum(path.reverse_length for path in report.paths)
    inside = f"; white inside: {reverse:.1f} m in reverse" if reverse >= 0.05 else ""
    _colour_bar(ax, drawn, f"state of charge [%]{inside}")
    stops = [stop.name for stop in report.route]
    good = {task.name: task.verdict == "reachable" for task in report.tasks}
    ordered = sorted(
        (task for task in mission.tasks if task.name in good),
        key=lambda task: stops.index(task.name) if task.name in stops else len(stops),
    )
    places = [("S", "start", mission.start, "s", style.BLACK)]
    for k, task in enumerate(ordered, start=1):
        look = ("o", style.GREEN) if good[task.name] else ("D", style.RED)
        option = task.options[0]
        row = report.rows.get(task.name)
        if option.points:
            x, y, *_ = np.array(option.points if row is None else row.vertices).T
            ax.plot(x, y, color=look[1], lw=7, alpha=0.35, zorder=2)
        places.append((str(k), task.name, option.entry if row is None else row.start, *look))
    places += [("C", charger.name, charger.pose, "p", style.BLUE) for charger in mission.chargers]
    signs: dict[tuple[float, float], list[str]] = {}
    for sign, _, pose, *_ in places:
        signs.setdefault((pose.x, pose.y), []).append(sign)
    handles = []
    for sign, name, pose, marker, color in places:
        mark: Any = {"marker": marker, "color": color, "mec": "white", "ls": "none"}
        if len(signs[pose.x, pose.y]) == 1:
            ax.plot(pose.x, pose.y, ms=2 * MARK, zorder=5, **mark)
        name = f"{sign}  {_short(name)}" + ("" if marker != "D" else " (out of reach)")
        handles.append(Line2D([], [], ms=2 * MARK - 2, label=name, **mark))
    frame = {"boxstyle": "round,pad=0.25", "fc": style.BLACK, "ec": "white"}
    for at, names in signs.items():
        ax.annotate(
            ",".join(names), at, ha="center", va="center_baseline", color="white", zorder=6,
            fontsize="x-small", fontweight="bold", bbox=frame if len(names) > 1 else None,
        )  # fmt: skip
    picture.legend(
        handles=handles, loc="outside lower left", ncols=2, frameon=False, fontsize="small"
    )
    picture.set_figheight(picture.get_figheight() + 0.2 * -(-len(handles) // 2))
    return picture


def _short(name: str) -> str:
    """Return a name short enough to leave room for the plot."""
    return name if len(name) <= 28 else f"{name[:27]}…"


def state_of_charge(ax: Axes, report: MissionReport) -> Axes:
    """Draw the state of charge over a mission, its band, and the reserve."""
    line, mission = report.timeline, report.mission
    band = f"{100 * mission.confidence:.0f} % band"
    ax.fill_between(
        line.t, 100 * line.soc_lower, 100 * line.soc_upper, color=style.SKY, alpha=0.5, lw=0,
        label=band,
    )  # fmt: skip
    ax.plot(line.t, 100 * line.soc, color=style.BLUE, lw=1.5, label="expected")
    ax.axhline(100 * mission.reserve, color=style.RED, ls="--", lw=1.2, label="reserve")
    _clock(ax, "state of charge [%]")
    ax.set_ylim(0, 105)
    style.legend(ax, above=True)
    return ax


def visits(ax: Axes, report: MissionReport) -> Axes:
    """Draw when the robot is where: a bar for each stop, with its name at the axis."""
    names = list(dict.fromkeys(stop.name for stop in report.route))
    colors = {"charge": CHARGING, "task": style.GREEN, "start": style.BLACK, "end": style.BLACK}
    for stop in report.route:
        begin, stay = stop.arrival, stop.departure - stop.arrival
        row = names.index(stop.name)
        ax.barh(row, stay, left=begin, height=0.6, color=colors[stop.kind])
        ax.plot(begin, row, "|", color=colors[stop.kind], ms=8)
    ax.set_yticks(range(len(names)), [_short(name) for name in names], fontsize="small")
    ax.set_ylim(len(names) - 0.5, -0.5)
    _clock(ax, "")
    return ax


def _clock(ax: Axes, what: str) -> None:
    """Name both axes; times are written as the timetable has them."""
    style.label(ax, "time [h:min:s]", what, "")
    first, last = ax.dataLim.intervalx
    step = next((step for step in STEPS if last - first <= 6 * step), (last - first) / 6)
    ax.xaxis.set_major_locator(MultipleLocator(step))
    ax.xaxis.set_major_formatter(FuncFormatter(lambda at, _: clock(at)))


def mission_charge(report: MissionReport) -> Figure:
    """Draw charge over a mission, where the robot is, and the power at the battery."""
    count = len({stop.name for stop in report.route})
    picture = style.figure(
        3, 1, size=(style.WIDTH, 4.2 + 0.22 * count), sharex=True,
        height_ratios=(2.2, 0.3 + 0.22 * count, 1.4),
    )  # fmt: skip
    charge, where, power = picture.axes
    state_of_charge(charge, report)
    visits(where, report)
    line = report.timeline
    moved = np.any(np.diff(np.column_stack([line.x, line.y, line.yaw]), axis=0) != 0, axis=1)
    driving = np.append(moved, False)
    for which, color, name in (
        (driving, style.BLUE, "driving"),
        (~driving & (line.power >= 0), style.GREEN, "standing"),
        (~driving & (line.power < 0), CHARGING, "charging"),
    ):
        if not np.any(which):
            continue
        power.fill_between(
            line.t, np.where(which, line.power, 0.0), step="post", color=color, lw=0.4,
            label=name, rasterized=True,
        )  # fmt: skip
    _clock(power, "power [W]")
    style.legend(power, above=True)
    for ax in (charge, where):
        ax.set_xlabel("")
    return picture
