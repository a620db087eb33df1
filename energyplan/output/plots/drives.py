"""Pictures of drives and models: speeds, power, energy, residuals, limits, trade-offs."""

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
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from energyplan import html
from energyplan.logs import DriveLog
from energyplan.path import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from energyplan.limits.feasibility import FeasibleRegion
    from energyplan.physics import Loop

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


def tread_speeds(ax: Axes, log: DriveLog) -> Axes:
    """Draw the speeds of both sides over time.

    Examples
    --------
    >>> import energyplan as ep
    >>> model = ep.PowerModel.preset("quadriga:empty:marble")
    >>> log = ep.simulate.drive(model, [ep.simulate.Setpoint(0.4, 0.5, hold=5.0)])
    >>> tread_speeds(figure().axes[0], log).get_ylabel()
    'tread speed [m/s]'
    """
    ax.plot(log.t, log.channel("v_left"), color=BLUE, lw=1.2, label="left")
    ax.plot(log.t, log.channel("v_right"), color=ORANGE, lw=1.2, ls="--", label="right")
    style_label(ax, "time [s]", "tread speed [m/s]", "Tread speeds")
    legend(ax, above=True)
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

    Examples
    --------
    >>> import energyplan as ep
    >>> model = ep.PowerModel.preset("quadriga:empty:marble")
    >>> log = ep.simulate.drive(model, [ep.simulate.Setpoint(0.4, 0.5, hold=5.0)])
    >>> predicted = model.power(log.motion(model.vehicle.icr))
    >>> ax = power_over_time(figure().axes[0], log, {"predicted": predicted})
    >>> [line.get_label() for line in ax.lines]
    ['measured', 'predicted']
    """
    ax.plot(log.t, log.power, color="0.6", lw=0.8, label="measured")
    for (label, power), (color, dash) in zip(predictions.items(), LINES, strict=False):
        ax.plot(log.t, power, color=color, ls=dash, lw=1.2, label=label)
    style_label(ax, "time [s]", "power [W]", "Power")
    legend(ax, above=True)
    return ax


def energy_over_time(ax: Axes, log: DriveLog, predictions: Mapping[str, ArrayLike]) -> Axes:
    """Draw measured and predicted energy since the start; arguments as in `power_over_time`.

    Examples
    --------
    >>> import energyplan as ep
    >>> model = ep.PowerModel.preset("quadriga:empty:marble")
    >>> log = ep.simulate.drive(model, [ep.simulate.Setpoint(0.4, 0.5, hold=5.0)])
    >>> predicted = model.power(log.motion(model.vehicle.icr))
    >>> energy_over_time(figure().axes[0], log, {"predicted": predicted}).get_ylabel()
    'energy [kJ]'
    """
    ax.plot(log.t, _integral(log.t, log.power) / 1e3, color="0.6", lw=2.5, label="measured")
    for (label, power), (color, dash) in zip(predictions.items(), LINES, strict=False):
        energy = _integral(log.t, np.asarray(power, float)) / 1e3
        ax.plot(log.t, energy, color=color, ls=dash, lw=1.4, label=label)
    style_label(ax, "time [s]", "energy [kJ]", "Energy since the start")
    legend(ax, above=True)
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

    Examples
    --------
    >>> import energyplan as ep
    >>> model = ep.PowerModel.preset("quadriga:empty:marble")
    >>> log = ep.simulate.drive(model, [ep.simulate.Setpoint(0.4, 0.5, hold=5.0)])
    >>> predicted = model.power(log.motion(model.vehicle.icr))
    >>> made = prediction(log, {"predicted": predicted}, "Figure-8")
    >>> [ax.get_ylabel() for ax in made.axes]
    ['tread speed [m/s]', 'power [W]', 'energy [kJ]']
    """
    made = figure(3, 1, size=(WIDTH, 7.0))
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

    Examples
    --------
    >>> x, twice = bin_means([1.0, 2.0, 3.0, 4.0], [[2.0, 4.0, 6.0, 8.0]], bins=2)
    >>> x.tolist(), twice.tolist()
    ([1.5, 3.5], [3.0, 7.0])
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

    Examples
    --------
    >>> speed = np.linspace(0.1, 1.0, 50)
    >>> left = {"before": 30.0 * speed, "after": 0.0 * speed}
    >>> ax = residual_against(figure().axes[0], speed, left, "forward speed [m/s]")
    >>> ax.get_title(loc="left")
    'Residual against the forward speed'
    """
    x = np.asarray(channel, float)
    centre, *means = bin_means(x, list(residuals.values()), bins)
    thin = slice(None, None, max(1, len(x) // 4000))
    for (name, residual), mean, (color, dash) in zip(residuals.items(), means, LINES, strict=False):
        r = np.asarray(residual, float)
        ax.plot(x[thin], r[thin], ".", ms=2, color=color, alpha=0.15, rasterized=True)
        ax.plot(centre, mean, color=color, ls=dash, marker="o", ms=3, label=f"{name} (bin mean)")
    ax.axhline(0, color=BLACK, lw=0.8)
    known = label.partition(" [")[0]
    style_label(ax, html.unit(label), "measured - predicted [W]", f"Residual against the {known}")
    legend(ax, above=True)
    return ax


def rounds(made: Loop) -> Figure:
    """Draw predicted and measured energy by round of a closed loop.

    Parameters
    ----------
    made : Loop
        Result of `energyplan.physics.close_loop`.

    Returns
    -------
    Figure
        One axes.

    Examples
    --------
    >>> from types import SimpleNamespace as Some
    >>> first = Some(energy_told=900.0, energy_interval=None, energy_taken=1200.0)
    >>> last = Some(energy_told=1100.0, energy_interval=(1050.0, 1150.0), energy_taken=1120.0)
    >>> rounds(Some(rounds=(first, last))).axes[0].get_ylabel()
    'energy [kJ]'
    """
    drawn = figure(size=(WIDTH, 2.8))
    ax = drawn.axes[0]
    at = np.arange(1, len(made.rounds) + 1)
    told = np.array([now.energy_told for now in made.rounds]) / 1e3
    spans = [now.energy_interval or (now.energy_told, now.energy_told) for now in made.rounds]
    ends = np.array(spans).T / 1e3
    away = np.maximum([told - ends[0], ends[1] - told], 0.0)
    ax.errorbar(at - 0.05, told, yerr=away, fmt="none", color=BLUE, capsize=5, lw=1.2)
    ax.plot(at - 0.05, told, "s", ms=5, color=BLUE, label="predicted")
    taken = [now.energy_taken / 1e3 for now in made.rounds]
    ax.plot(at + 0.05, taken, "o", ms=5, color=RED, label="measured")
    ax.set_xticks(at)
    ax.set_xlim(0.5, len(at) + 0.5)
    ax.set_ylim(0.0, 1.08 * max(*taken, *ends[1]))
    style_label(ax, "round", "energy [kJ]", "")
    legend(ax, above=True)
    return drawn


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

    Examples
    --------
    >>> parts = {"shortest": {"slip_friction": 900.0, "traction_resistance": 5000.0}}
    >>> ax = breakdown(figure().axes[0], parts)
    >>> [text.get_text() for text in ax.get_legend().get_texts()]
    ['slip friction', 'traction resistance']
    """
    names = list(dict.fromkeys(name for part in parts.values() for name in part))
    below = np.zeros(len(parts))
    colors = (BLUE, ORANGE, GREEN, PURPLE, SKY, RED, YELLOW)
    for k, name in enumerate(names):
        values = np.array([part.get(name, 0.0) for part in parts.values()]) / 1e3
        ax.barh(
            list(parts), values, left=below, color=colors[k % len(colors)],
            label=html.words(name),
        )  # fmt: skip
        below = below + values
    style_label(ax, "energy [kJ]", "", "Energy by term")
    legend(ax, above=True)
    return ax


def feasible_region(ax: Axes, region: FeasibleRegion) -> Axes:
    """Draw which curvatures and speeds the motors can drive continuously, for a short time, or not.

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

    Examples
    --------
    >>> import energyplan as ep
    >>> model = ep.PowerModel.preset("quadriga:full:concrete")
    >>> from energyplan.limits.feasibility import feasible_region as region_of
    >>> region = region_of(model, [-1.0, 0.0, 1.0], [0.3, 0.6, 0.9])
    >>> feasible_region(figure().axes[0], region).get_xlabel()
    'curvature [1/m]'
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
        for color, label in (
            (GREEN, "continuously"),
            (YELLOW, "for a short time"),
            ("0.85", "not at all"),
        )
    ]
    style_label(ax, "curvature [1/m]", "speed [m/s]", "What the motors can drive")
    legend(ax, above=True, handles=handles)
    ax.grid(visible=False)
    return ax


def _integral(t: FloatArray, power: FloatArray) -> FloatArray:
    steps = 0.5 * (power[1:] + power[:-1]) * np.diff(t)
    return np.concatenate([[0.0], np.cumsum(steps)])
