"""Interactive plots of the reports, drawn by plotly where it is installed (private).

A plot is plotly's own description of it, a dictionary, so that describing one takes no plotly;
`fragment` turns it into HTML. Text from files is escaped, for plotly takes text for markup.
"""

from __future__ import annotations

import html
from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from energyplan.motion import CHANNELS
from energyplan.output.interactive.map import map_plot, place
from energyplan.output.interactive.parts import (
    GREY,
    LINES,
    MOST_POINTS,
    Plot,
    axis,
    layout_of,
    single,
    thin,
)
from energyplan.output.plots import BLACK, BLUE, GREEN, ORANGE, PURPLE, RED, SKY, YELLOW, bin_means
from energyplan.path import FloatArray, Path, wrap_angle
from energyplan.power.empirical import signal

if TYPE_CHECKING:
    from energyplan.cost import EnergyCost
    from energyplan.diagnosis import Diagnosis
    from energyplan.logs import DriveLog
    from energyplan.mission import MissionReport
    from energyplan.planning import PlanningProblem
    from energyplan.studies.comparison import Comparison

ABSENT = "The pictures stand still; pip install 'energyplan[reports]' makes them interactive."
_MOST_DOTS = 1500  # of a cloud
_BINS = 24
# A finger that moves over a plot shall scroll the page; zooming is left to the buttons. Where there
# is little room, long names are shown at a touch only.
_PHONE = """
const plot = document.getElementById('{plot_id}');
if (matchMedia('(pointer: coarse)').matches) Plotly.relayout(plot, 'dragmode', false);
const long = plot.data.flatMap((t, k) => t.mode == 'markers+text' && t.text[0].length > 8 ? k : []);
if (innerWidth < 600 && long.length) Plotly.restyle(plot, 'mode', 'markers', long);
"""
_BUTTONS = ["zoom2d", "pan2d", "zoomIn2d", "zoomOut2d", "resetScale2d", "toImage"]


def available() -> bool:
    """Tell whether plotly is installed."""
    return find_spec("plotly") is not None


def library() -> str:
    """Return plotly's JavaScript, which a page with plots holds once."""
    from plotly.offline import get_plotlyjs

    return str(get_plotlyjs())


def fragment(plot: Plot, name: str) -> str:
    """Return the HTML of a plot.

    Parameters
    ----------
    plot : dict
        The plot.
    name : str
        Its name, once per page.

    Returns
    -------
    str
        A ``div`` that fits the width of its page; the page must hold `library` before it.
    """
    from plotly.io import to_html

    body = to_html(
        plot, full_html=False, include_plotlyjs=False, validate=False, div_id=f"plot-{name}",
        default_height="100%", post_script="{" + _PHONE + "}",
        config={
            "displaylogo": False, "responsive": True, "plotlyServerURL": "",
            "modeBarButtons": [_BUTTONS],
        },
    )  # fmt: skip
    kind = " tall" if "yaxis2" in plot["layout"] else " low" if "barmode" in plot["layout"] else ""
    return f'<div class="plot{kind}">{body}</div>'


def diagnosis_plots(told: Diagnosis, holdout: Sequence[DriveLog]) -> dict[str, Plot]:
    """Return the plots of a diagnosis, by the names of its pictures."""
    longest = int(np.argmax([log.duration for log in holdout]))
    both = {"before": told.predictions_before[longest], "after": told.predictions_after[longest]}
    plots = {"power": prediction(holdout[longest], both)}
    if told.dependences_before:
        motions = [log.motion(told.model.vehicle.icr) for log in holdout]
        names = dict.fromkeys(found.channel for found in told.dependences_before)
        channels = {
            name: np.concatenate([signal(motion, name) for motion in motions]) for name in names
        }
        residuals = {
            label: np.concatenate(
                [log.power - power for log, power in zip(holdout, predicted, strict=True)]
            )
            for label, predicted in (
                ("before", told.predictions_before), ("after", told.predictions_after)
            )
        }  # fmt: skip
        plots["residual"] = residual_by_channel(channels, residuals)
    return plots


def prediction(log: DriveLog, predictions: Mapping[str, ArrayLike]) -> Plot:
    """Describe power and energy of a drive, measured and predicted [W], over one time axis."""
    data = []
    lines = ((GREY, "solid"), *LINES)
    for (label, power), (color, dash) in zip(
        {"measured": log.power, **predictions}.items(), lines, strict=False
    ):
        watts = np.asarray(power, float)
        steps = 0.5 * (watts[1:] + watts[:-1]) * np.diff(log.t)
        energy = np.concatenate([[0.0], np.cumsum(steps)]) / 1e3
        style = {"name": html.escape(label), "legendgroup": label, "mode": "lines"}
        line = {"color": color, "dash": dash, "width": 1.5}
        for scale, values, letters in (("y", watts, "W"), ("y2", energy, "kJ")):
            kept = thin(values)
            data.append(
                {
                    **style, "x": single(log.t[kept]), "y": single(values[kept]), "yaxis": scale,
                    "line": line, "showlegend": scale == "y",
                    "hovertemplate": f"%{{y:.4g}} {letters}",
                }
            )  # fmt: skip
    layout = layout_of("time [s]", "power [W]") | {"hovermode": "x unified"}
    layout["yaxis"]["domain"] = [0.54, 1.0]
    layout["yaxis2"] = {**axis("energy [kJ]"), "domain": [0.0, 0.46]}
    layout["xaxis"]["anchor"] = "y2"
    return {"data": data, "layout": layout}


def residual_by_channel(
    channels: Mapping[str, FloatArray], residuals: Mapping[str, FloatArray]
) -> Plot:
    """Describe residuals [W] against the channel that the reader picks; the first one at first."""
    data: list[Plot] = []
    for number, (channel, values) in enumerate(channels.items()):
        x = wrap_angle(values) if channel == "yaw" else np.asarray(values, float)
        some = slice(None, None, max(1, -(-len(x) // _MOST_DOTS)))
        centre, *means = bin_means(x, list(residuals.values()), _BINS)
        for (label, residual), mean, (color, dash) in zip(
            residuals.items(), means, LINES, strict=False
        ):
            shared = {"legendgroup": label, "visible": number == 0}
            data += [
                {
                    **shared, "x": single(x[some]), "y": single(residual[some]),
                    "mode": "markers", "showlegend": False, "hoverinfo": "skip",
                    "marker": {"color": color, "size": 3, "opacity": 0.2},
                },
                {
                    **shared, "x": centre, "y": mean, "mode": "lines+markers",
                    "name": f"{html.escape(label)} (bin mean)",
                    "line": {"color": color, "dash": dash, "width": 2},
                    "hovertemplate": "%{y:.3g} W at %{x:.3g}",
                },
            ]  # fmt: skip
    each = 2 * len(residuals)
    names = [html.escape(f"{name} [{unit(name)}]") for name in channels]
    buttons = [
        {
            "label": name, "method": "update",
            "args": [
                {"visible": [k // each == number for k in range(len(data))]},
                {"xaxis.title.text": name, "xaxis.autorange": True},
            ],
        }
        for number, name in enumerate(names)
    ]  # fmt: skip
    layout = layout_of(names[0] if names else "", "measured - predicted [W]")
    layout["updatemenus"] = [
        {"buttons": buttons, "x": 0.0, "xanchor": "left", "y": 1.02, "yanchor": "bottom"}
    ]
    layout["legend"] |= {"yref": "container", "y": 0.0, "yanchor": "bottom"}
    layout["margin"]["b"] = 80
    layout["yaxis"]["zeroline"] = True
    return {"data": data, "layout": layout}


def unit(channel: str) -> str:
    """Return the unit of a channel or of a signal derived from the tread speeds."""
    derived = {"v": "m/s", "omega": "rad/s", "curvature": "1/m"}
    described = CHANNELS.get(channel, "")
    return derived.get(channel) or described.partition("[")[2].rstrip("]") or "its own unit"


def comparison_plots(made: Comparison, problem: PlanningProblem) -> dict[str, Plot]:
    """Return the plots of a comparison, by the names of its pictures."""
    paths = {"least energy": made.energy_optimal.path, "shortest": made.shortest.path}
    areas = problem.surfaces.polygons if problem.surfaces else ()
    walls = map_plot(problem.map, areas)
    along: Plot = {
        "data": [],
        "layout": layout_of("distance travelled [m]", "energy since the start [J]"),
    }
    for (label, path), (color, dash) in zip(paths.items(), LINES, strict=False):
        metres, joules, places = energy_along(path, problem)
        line = {"color": color, "dash": dash, "width": 3}
        shared = {"name": label, "mode": "lines", "line": line}
        walls["data"].append(
            {
                **shared, "x": places[:, 0], "y": places[:, 1],
                "customdata": np.column_stack([metres, joules]),
                "hovertemplate": "%{customdata[0]:.1f} m, %{customdata[1]:.0f} J",
            }
        )  # fmt: skip
        along["data"].append(
            {**shared, "x": metres, "y": joules, "hovertemplate": "%{y:.0f} J at %{x:.1f} m"}
        )
    ends = (("start", problem.start, "square", BLACK), ("goal", problem.goal, "star", BLACK))
    walls["data"] += [place(*end) for end in ends]
    return {"map": walls, "energy": along, "terms": _terms(made)}


def _terms(made: Comparison) -> Plot:
    """Describe the energy of both routes by term, as stacked bars."""
    plans = {"shortest": made.shortest, "least energy": made.energy_optimal}
    colors = (BLUE, ORANGE, GREEN, PURPLE, SKY, RED, YELLOW)
    data = [
        {
            "type": "bar", "orientation": "h", "name": html.escape(name.replace("_", " ")),
            "x": [plan.breakdown.get(name, 0.0) for plan in plans.values()], "y": list(plans),
            "marker": {"color": colors[k % len(colors)]}, "hovertemplate": "%{x:.0f} J",
        }
        for k, name in enumerate(made.by_term)
    ]  # fmt: skip
    layout = layout_of("energy [J]", "") | {"barmode": "relative"}
    return {"data": data, "layout": layout}


class Along(NamedTuple):
    """Distance travelled [m] and energy since the start [J] at places (n, 3) along a path."""

    metres: FloatArray
    joules: FloatArray
    places: FloatArray


def energy_along(path: Path, problem: PlanningProblem) -> Along:
    """Return the energy along a path, on the problem's ground; it ends with the path's own."""
    if problem.heights is not None:
        fine = problem.heights.cut(path)
        pieces = problem.heights.pieces(path, problem.cost, problem.surfaces)
        each = sum(p.cost.segment_energy(p.path.ds, p.path.dtheta, p.slope) for p in pieces)
        return _along(fine, np.asarray(each))
    fine = path.subdivide(0.1, 0.1)
    costs: tuple[EnergyCost, ...] = (problem.cost,)
    shares = np.ones((len(fine), 1))
    if problem.surfaces is not None:
        costs, shares = problem.surfaces.costs(problem.cost), problem.surfaces.shares(fine)
    each = np.zeros(len(fine))
    for cost, share in zip(costs, shares.T, strict=True):
        each += cost.segment_energy(fine.ds * share, fine.dtheta * share)
    return _along(fine, each)


def _along(fine: Path, each: FloatArray) -> Along:
    joules = np.concatenate([[0.0], np.cumsum(each)])
    metres = np.concatenate([[0.0], np.cumsum(np.abs(fine.ds))])
    return Along(metres, joules, fine.vertices)


def mission_plots(told: MissionReport) -> dict[str, Plot]:
    """Return the plots of a mission, by the names of its pictures."""
    return {"map": _mission_map(told), "charge": _mission_charge(told)}


def _mission_map(told: MissionReport) -> Plot:
    mission, line = told.mission, told.timeline
    plot = map_plot(mission.map, mission.surfaces.polygons if mission.surfaces else ())
    moved = np.hypot(np.diff(line.x), np.diff(line.y)) > 0
    moving = np.flatnonzero(moved)
    kept = moving[:: max(1, -(-len(moving) // MOST_POINTS))]
    plot["data"] += [
        {
            "x": single(line.x), "y": single(line.y), "mode": "lines", "showlegend": False,
            "hoverinfo": "skip", "line": {"color": GREY, "width": 1},
        },
        {
            "x": single(line.x[kept]), "y": single(line.y[kept]), "mode": "markers",
            "showlegend": False,
            "marker": {
                "color": single(line.power[kept]), "colorscale": "Viridis", "size": 5,
                "colorbar": {
                    "orientation": "h", "yref": "container", "y": 0.0, "yanchor": "bottom",
                    "thickness": 12,
                    "title": {"text": "power [W]", "side": "bottom"},
                },
            },
            "customdata": np.column_stack([line.t / 60, line.power, 100 * line.soc])[kept],
            "hovertemplate": "%{customdata[0]:.1f} min: %{customdata[1]:.0f} W, "
            "charge %{customdata[2]:.0f} %<extra></extra>",
        },
    ]  # fmt: skip
    plot["layout"]["margin"]["b"] = 100
    for number, task in enumerate(mission.tasks):
        good = told.task(task.name).verdict == "reachable"
        style = ("circle", GREEN) if good else ("x", RED)
        where = ("top center", "bottom center")[number % 2]  # names of neighbours overlap less
        plot["data"].append(place(task.name, task.pose, *style, where))
    for charger in mission.chargers:
        plot["data"].append(place(charger.name, charger.pose, "cross", BLUE))
    plot["data"].append(place("start", mission.start, "square", BLACK))
    return plot


def _mission_charge(told: MissionReport) -> Plot:
    line, mission = told.timeline, told.mission
    kept = thin(line.power)
    minutes = single(line.t / 60)[kept]
    band = f"{100 * mission.confidence:.0f} % band"
    edge = {"mode": "lines", "line": {"width": 0}, "hoverinfo": "skip", "x": minutes}
    percent = {"x": minutes, "mode": "lines", "hovertemplate": "%{y:.1f} %"}
    data: list[Plot] = [
        {**edge, "y": single(100 * line.soc_lower[kept]), "showlegend": False},
        {
            **edge, "y": single(100 * line.soc_upper[kept]), "name": band, "fill": "tonexty",
            "fillcolor": "rgba(86, 180, 233, 0.4)",
        },
        {
            **percent, "y": single(100 * line.soc[kept]), "name": "expected",
            "line": {"color": BLUE, "width": 2},
        },
        {
            "x": minutes[[0, -1]], "y": [100 * mission.reserve] * 2, "mode": "lines",
            "name": "reserve", "line": {"color": RED, "dash": "dash"},
            "hovertemplate": "%{y:.0f} %",
        },
        {
            "x": minutes, "y": single(line.power[kept]), "yaxis": "y2", "mode": "lines",
            "showlegend": False, "name": "power",
            "line": {"color": BLACK, "width": 1, "shape": "hv"}, "hovertemplate": "%{y:.0f} W",
        },
    ]  # fmt: skip
    layout = layout_of("time [min]", "charge [%]") | {"hovermode": "x unified"}
    layout["yaxis"] |= {"domain": [0.46, 1.0], "range": [0, 105]}
    layout["yaxis2"] = {**axis("power [W]"), "domain": [0.0, 0.38]}
    layout["xaxis"]["anchor"] = "y2"
    begun = [task for task in told.tasks if np.isfinite(task.start)]
    layout["shapes"] = [
        {
            "type": "line", "x0": task.start / 60, "x1": task.start / 60, "yref": "paper", "y0": 0,
            "y1": 1, "line": {"color": GREY, "width": 1, "dash": "dot"},
        }
        for task in begun
    ]  # fmt: skip
    layout["annotations"] = [
        {
            "x": task.start / 60, "y": 0.47, "yref": "paper", "text": html.escape(task.name),
            "textangle": -90, "showarrow": False, "xanchor": "right", "yanchor": "bottom",
            "font": {"size": 11},
        }
        for task in begun
    ]  # fmt: skip
    return {"data": data, "layout": layout}
