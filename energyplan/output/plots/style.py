"""The one style of all pictures: palette, labels, legends, an empty figure."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from matplotlib.figure import Figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes

BLACK, ORANGE, SKY, GREEN, YELLOW, BLUE, RED, PURPLE = (
    "#000000", "#E69F00", "#56B4E9", "#009E73", "#F0E442", "#0072B2", "#D55E00", "#CC79A7",
)  # fmt: skip
"""Palette of Okabe and Ito (2008)."""


LINES = ((BLUE, "-"), (RED, "--"), (GREEN, "-."), (PURPLE, ":"))
"""Colour and dash of curves that may coincide."""


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


def label(ax: Axes, x: str, y: str, title: str) -> None:
    """Name both axes and the picture."""
    ax.set(xlabel=x, ylabel=y)
    ax.set_title(title, loc="left", fontsize="medium")


def legend(ax: Axes, outside: bool = False, **options: Any) -> None:
    """Add a legend without a frame, beside the axes where asked."""
    if outside:
        options |= {"loc": "upper left", "bbox_to_anchor": (1.0, 1.0)}
    ax.legend(frameon=False, fontsize="small", **options)
