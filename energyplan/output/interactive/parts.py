"""What all interactive plots share: their look, and how curves are thinned (private)."""

from __future__ import annotations

from typing import Any

import numpy as np

from energyplan.output.plots import BLUE, GREEN, PURPLE, RED
from energyplan.path import FloatArray

Plot = dict[str, Any]
"""Plotly's description of a plot: ``data`` and ``layout``."""

GREY = "#999999"
LINES = ((BLUE, "solid"), (RED, "dash"), (GREEN, "dashdot"), (PURPLE, "dot"))
MOST_POINTS = 3000  # of a curve; more cannot be told apart on a screen


def axis(title: str) -> dict[str, Any]:
    """Return an axis with its title, which names the unit."""
    return {
        "title": {"text": title}, "automargin": True, "gridcolor": "#e5e5e5", "zeroline": False,
        "linecolor": "#888888", "ticks": "outside",
    }  # fmt: skip


def layout_of(x: str, y: str) -> dict[str, Any]:
    """Return the layout that all plots share, with the titles of both axes."""
    return {
        "xaxis": axis(x), "yaxis": axis(y), "plot_bgcolor": "white", "paper_bgcolor": "white",
        "margin": {"l": 10, "r": 10, "t": 100, "b": 40},
        "font": {"family": "system-ui, sans-serif"},
        "legend": {"orientation": "h", "x": 0.0, "y": 1.02, "yanchor": "bottom"},
    }  # fmt: skip


def thin(values: FloatArray) -> np.ndarray[Any, np.dtype[np.intp]]:
    """Return which samples draw a curve: of each stretch the least and the largest one."""
    n = len(values)
    width = -(-2 * n // MOST_POINTS)
    if width <= 2:
        return np.arange(n)
    stretches = np.pad(values, (0, -n % width), mode="edge").reshape(-1, width)
    start = np.arange(len(stretches)) * width
    extremes = [start + stretches.argmin(axis=1), start + stretches.argmax(axis=1)]
    return np.unique(np.concatenate([[0, n - 1], *extremes]).clip(0, n - 1))


def single(values: FloatArray) -> np.ndarray[Any, np.dtype[np.float32]]:
    """Return numbers as precise as a screen is, in half the room."""
    return np.asarray(values, np.float32)
