"""Pictures of drives and models: speeds, power, energy, residuals, limits, trade-offs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import ArrayLike
from scipy.integrate import cumulative_trapezoid

from energyplan import html
from energyplan.logs import DriveLog
from energyplan.output.plots import style
from energyplan.path import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from energyplan.limits.feasibility import FeasibleRegion
    from energyplan.physics import Loop


def tread_speeds(ax: Axes, log: DriveLog) -> Axes:
    """Draw the speeds of both sides over time."""
    t = log.t - log.t[0]
    ax.plot(t, log.channel("v_left"), color=style.BLUE, lw=1.2, label="left")
    ax.plot(t, log.channel("v_right"), color=style.ORANGE, lw=1.2, ls="--", label="right")
    style.label(ax, "time [s]", "tread speed [m/s]", "Tread speeds")
    style.legend(ax, above=True)
    return ax


def power_over_time(ax: Axes, log: DriveLog, predictions: Mapping[str, ArrayLike]) -> Axes:
    """Draw measured and predicted power over time."""
    t = log.t - log.t[0]
    ax.plot(t, log.power, color="0.6", lw=0.8, label="measured")
    return _over_time(ax, t, predictions, "power [W]", "Power")


def energy_over_time(ax: Axes, log: DriveLog, predictions: Mapping[str, ArrayLike]) -> Axes:
    """Draw measured and predicted energy since the start; arguments as in `power_over_time`."""
    t = log.t - log.t[0]
    ax.plot(
        t,
        cumulative_trapezoid(log.power, t, initial=0) / 1e3,
        color="0.6",
        lw=2.5,
        label="measured",
    )
    energies = {
        k: cumulative_trapezoid(np.asarray(p, float), t, initial=0) / 1e3
        for k, p in predictions.items()
    }
    return _over_time(ax, t, energies, "energy [kJ]", "Energy since the start")


def _over_time(
    ax: Axes, t: FloatArray, predictions: Mapping[str, ArrayLike], what: str, title: str
) -> Axes:
    for (label, values), (color, dash) in zip(predictions.items(), style.LINES, strict=False):
        ax.plot(t, values, color=color, ls=dash, lw=1.3, label=label)
    style.label(ax, "time [s]", what, title)
    style.legend(ax, above=True)
    return ax


def prediction(log: DriveLog, predictions: Mapping[str, ArrayLike], title: str = "") -> Figure:
    """Draw tread speeds, power and energy of a drive, as in the paper's figures 6 to 9."""
    picture = style.figure(3, 1, size=(style.WIDTH, 7.0))
    tread_speeds(picture.axes[0], log)
    power_over_time(picture.axes[1], log, predictions)
    energy_over_time(picture.axes[2], log, predictions)
    for ax in picture.axes[:2]:
        ax.set_xlabel("")
    picture.suptitle(title, x=0.01, ha="left", fontsize="large")
    return picture


def bin_means(x: ArrayLike, series: Sequence[ArrayLike], bins: int = 24) -> list[FloatArray]:
    """Average in bins of `x` that hold equally many samples."""
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
    """Draw residuals against a channel: the samples, and the mean in equally filled bins."""
    x = np.asarray(channel, float)
    centre, *means = bin_means(x, list(residuals.values()), bins)
    thin = slice(None, None, max(1, len(x) // 4000))
    for (name, residual), mean, (color, dash) in zip(
        residuals.items(), means, style.LINES, strict=False
    ):
        r = np.asarray(residual, float)
        ax.plot(x[thin], r[thin], ".", ms=2, color=color, alpha=0.15, rasterized=True)
        ax.plot(centre, mean, color=color, ls=dash, marker="o", ms=3, label=f"{name} (bin mean)")
    ax.axhline(0, color=style.BLACK, lw=0.8)
    known = label.partition(" [")[0]
    style.label(ax, html.unit(label), "measured - predicted [W]", f"Residual against the {known}")
    style.legend(ax, above=True)
    return ax


def rounds(loop: Loop) -> Figure:
    """Draw predicted and measured energy by round of a closed loop."""
    drawn = style.figure(size=(style.WIDTH, 2.8))
    ax = drawn.axes[0]
    at = np.arange(1, len(loop.rounds) + 1)
    predicted = np.array([now.energy_predicted for now in loop.rounds]) / 1e3
    spans = [
        now.energy_interval or (now.energy_predicted, now.energy_predicted) for now in loop.rounds
    ]
    ends = np.array(spans).T / 1e3
    away = np.maximum([predicted - ends[0], ends[1] - predicted], 0.0)
    ax.errorbar(at - 0.05, predicted, yerr=away, fmt="none", color=style.BLUE, capsize=5, lw=1.2)
    ax.plot(at - 0.05, predicted, "s", ms=5, color=style.BLUE, label="predicted")
    measured = [now.energy_measured / 1e3 for now in loop.rounds]
    ax.plot(at + 0.05, measured, "o", ms=5, color=style.RED, label="measured")
    ax.set_xticks(at)
    ax.set_xlim(0.5, len(at) + 0.5)
    ax.set_ylim(0.0, 1.08 * max(*measured, *ends[1]))
    style.label(ax, "round", "energy [kJ]", "")
    style.legend(ax, above=True)
    return drawn


def breakdown(ax: Axes, parts: Mapping[str, Mapping[str, float]]) -> Axes:
    """Draw joules by term, one stacked bar per plan."""
    names = list(dict.fromkeys(name for part in parts.values() for name in part))
    below = np.zeros(len(parts))
    for k, name in enumerate(names):
        values = np.array([part.get(name, 0.0) for part in parts.values()]) / 1e3
        ax.barh(
            list(parts), values, left=below, color=style.CYCLE[k % len(style.CYCLE)],
            label=html.words(name),
        )  # fmt: skip
        below = below + values
    style.label(ax, "energy [kJ]", "", "Energy by term")
    style.legend(ax, above=True)
    return ax


def feasible_region(ax: Axes, region: FeasibleRegion) -> Axes:
    """Draw which curvatures and speeds the motors can drive continuously, briefly, or not."""
    bent = region.curvature != 0
    curvature, top = region.curvature[bent], float(region.speed.max())
    last = np.zeros(len(curvature))
    for limit, color, name in (
        (region.max_speed[bent], style.GREEN, "continuously"),
        (region.max_speed_brief[bent], style.YELLOW, "for a short time"),
        (np.full(len(curvature), top), "0.85", "not at all"),
    ):
        ax.fill_between(curvature, last, limit, color=color, alpha=0.7, lw=0, label=name)
        last = np.maximum(limit, last)
    if not bent.all():  # friction jumps where nothing slips
        straight = float(region.max_speed[~bent].max())
        ax.plot(
            0.0, straight, "o", color=style.GREEN, mec=style.BLACK, ms=6,
            label="straight ahead: no slip",
        )  # fmt: skip
    ax.set(xlim=(region.curvature.min(), region.curvature.max()), ylim=(0.0, top))
    style.label(ax, "curvature [1/m]", "speed [m/s]", "What the motors can drive")
    style.legend(ax, above=True)
    ax.grid(visible=False)
    return ax
