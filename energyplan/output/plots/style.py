"""The one style of all pictures: palette, labels, legends, an empty figure."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes

BLACK, ORANGE, SKY, GREEN, YELLOW, BLUE, RED, PURPLE = (
    "#000000", "#E69F00", "#56B4E9", "#009E73", "#F0E442", "#0072B2", "#D55E00", "#CC79A7",
)  # fmt: skip
"""Palette of Okabe and Ito (2008)."""


CYCLE = (BLUE, ORANGE, GREEN, PURPLE, SKY, RED, YELLOW)
"""Colours of areas and bars, one after the other."""

LINES = ((BLUE, "-"), (RED, "--"), (GREEN, "-."), (PURPLE, ":"))
"""Colour and dash of curves that may coincide."""


WIDTH = 5.2
"""Width of a picture [inch]: its text can be read in a phone's column of 350 pixels."""


def figure(rows: int = 1, columns: int = 1, *, size: tuple[float, float] = (WIDTH, 3.4)) -> Figure:
    """Return an empty figure in the library's style, without a window."""
    made = Figure(figsize=size, layout="constrained")
    for ax in made.subplots(rows, columns, squeeze=False).flat:
        ax.grid(alpha=0.3)
        ax.spines[["top", "right"]].set_visible(False)
    return made


def label(ax: Axes, x: str, y: str, title: str) -> None:
    """Name both axes and the picture."""
    ax.set(xlabel=x, ylabel=y)
    ax.set_title(title, loc="left", fontsize="medium")


COLUMN = 76
"""Letters of small text that fit above a picture's axes."""


def legend(ax: Axes, above: bool = False, **options: Any) -> None:
    """Add a legend without a frame; with `above`, between the axes and their title."""
    if not above:
        ax.legend(frameon=False, fontsize="small", **options)
        return
    handles = options.get("handles") or ax.get_legend_handles_labels()[0]
    if not handles:
        return
    widest = max(len(str(handle.get_label())) for handle in handles)
    columns = int(np.clip(COLUMN // (widest + 6), 1, len(handles)))
    ax.legend(
        handles=handles, frameon=False, fontsize="small", ncols=columns,
        loc="lower left", bbox_to_anchor=(0.0, 1.0), borderaxespad=0.2,
    )  # fmt: skip
    title = ax.get_title(loc="left")
    rows = -(-len(handles) // columns)
    ax.set_title(title, loc="left", fontsize="medium", pad=8 + 13 * rows)
