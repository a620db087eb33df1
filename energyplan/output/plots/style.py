"""The one style of all pictures: palette, labels, legends, an empty figure."""

from __future__ import annotations

import io
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from energyplan.errors import UnknownNameError

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


DPI = 240
"""Resolution of images that have one [pixels per inch]."""

WIDTH = 5.2
"""Width of a picture [inch]: its text can be read in a phone's column of 350 pixels."""


class ShownFigure(Figure):
    """A figure that a notebook shows, whether or not pyplot was imported."""

    def _repr_png_(self) -> tuple[bytes, dict[str, int]]:
        return png(self), {"width": round(100 * self.get_figwidth())}


def figure(
    rows: int = 1, columns: int = 1, *, size: tuple[float, float] = (WIDTH, 3.4), **layout: Any
) -> Figure:
    """Return an empty figure in the library's style, without a window."""
    result = ShownFigure(figsize=size, layout="constrained")
    for ax in result.subplots(rows, columns, squeeze=False, **layout).flat:
        ax.grid(alpha=0.3)
        ax.spines[["top", "right"]].set_visible(False)
    return result


def label(ax: Axes, x: str, y: str, title: str) -> None:
    """Name both axes and the picture."""
    ax.set(xlabel=x, ylabel=y)
    ax.set_title(title, loc="left", fontsize="medium")


COLUMN = 76
"""Letters of small text that fit above a picture's axes."""


def legend(ax: Axes, above: bool = False, **options: Any) -> int:
    """Add a legend without a frame; return its rows `above` the axes, below their title."""
    if not above:
        ax.legend(frameon=False, fontsize="small", **options)
        return 0
    handles = options.get("handles") or ax.get_legend_handles_labels()[0]
    if not handles:
        return 0
    widest = max(len(str(handle.get_label())) for handle in handles)
    columns = int(np.clip(COLUMN // (widest + 6), 1, len(handles)))
    ax.legend(
        handles=handles, frameon=False, fontsize="small", ncols=columns,
        loc="lower left", bbox_to_anchor=(0.0, 1.0), borderaxespad=0.2,
    )  # fmt: skip
    title = ax.get_title(loc="left")
    rows = -(-len(handles) // columns)
    ax.set_title(title, loc="left", fontsize="medium", pad=8 + 13 * rows)
    return rows


def svg(figure: Figure) -> bytes:
    """Return a figure as an SVG drawing; dense clouds of points in it are pictures."""
    return image(figure, ".svg")


def png(figure: Figure) -> bytes:
    """Return a figure as a PNG image."""
    return image(figure, ".png")


def image(figure: Figure, suffix: str) -> bytes:
    """Return a figure as an image of the kind that a file's suffix names."""
    undated: dict[str, dict[str, Any]] = {
        ".png": {"Software": None},
        ".svg": {"Date": None, "Creator": None},
        ".pdf": {"CreationDate": None},
    }
    kind = suffix.lower()
    if kind not in undated:
        raise UnknownNameError("kind of image", suffix, undated)
    stream = io.BytesIO()
    with (
        _laid_out(figure),
        mpl.rc_context({"svg.hashsalt": "energyplan"}),
    ):  # lasting names of parts
        figure.savefig(stream, format=kind[1:], dpi=DPI, metadata=undated[kind])
    return stream.getvalue()


@contextmanager
def _laid_out(figure: Figure) -> Iterator[None]:
    """Lay a picture out, and have it drawn as it is: else it is drawn once more for its layout."""
    engine, dpi = figure.get_layout_engine(), figure.dpi
    try:
        if engine is not None:
            figure.set_dpi(DPI)  # text is measured as it will be drawn
            engine.execute(figure)
            figure.set_layout_engine(None)
        yield
    finally:
        figure.set_dpi(dpi)
        figure.set_layout_engine(engine)
