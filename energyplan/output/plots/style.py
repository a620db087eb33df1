"""The one style of all pictures: palette, labels, legends, an empty figure."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from matplotlib.backends.backend_agg import RendererAgg
from matplotlib.figure import Figure
from matplotlib.layout_engine import LayoutEngine, PlaceHolderLayoutEngine
from matplotlib.legend import Legend

if TYPE_CHECKING:
    from matplotlib.axes import Axes

BLACK, ORANGE, SKY, GREEN, YELLOW, BLUE, RED, PURPLE = (
    "#000000", "#E69F00", "#56B4E9", "#009E73", "#F0E442", "#0072B2", "#D55E00", "#CC79A7",
)  # fmt: skip
"""Palette of Okabe and Ito (2008)."""


LINES = ((BLUE, "-"), (RED, "--"), (GREEN, "-."), (PURPLE, ":"))
"""Colour and dash of curves that may coincide."""


WIDTH = 5.2
"""Width of a picture [inch]: its text can be read in a phone's column of 350 pixels."""


def figure(rows: int = 1, columns: int = 1, *, size: tuple[float, float] = (WIDTH, 3.4)) -> Figure:
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

    Examples
    --------
    >>> made = figure(2, 1)
    >>> len(made.axes), float(made.get_figwidth())
    (2, 5.2)
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


_ABOVE = "legend above its axes"


def legend(ax: Axes, above: bool = False, **options: Any) -> None:
    """Add a legend without a frame; with `above`, over the axes, where no curve is.

    Examples
    --------
    >>> ax = figure().axes[0]
    >>> _ = ax.plot([0, 1], [0, 1], label="predicted")
    >>> legend(ax, above=True)
    >>> [text.get_text() for text in ax.get_legend().get_texts()]
    ['predicted']
    """
    if not above:
        ax.legend(frameon=False, fontsize="small", **options)
        return
    handles = options.get("handles") or ax.get_legend_handles_labels()[0]
    if handles:
        _put_above(ax, handles, [str(handle.get_label()) for handle in handles], len(handles))
        root = ax.get_figure(root=True)
        engine = None if root is None else root.get_layout_engine()
        if root is not None and not isinstance(engine, (LegendsAbove, PlaceHolderLayoutEngine)):
            root.set_layout_engine(LegendsAbove(engine))


class LegendsAbove(LayoutEngine):
    """Fits legends above axes to the picture's width, and puts titles over them.

    It lays a picture out by its former engine, with the legends left out, then places them and
    lays it out once more. So nothing is drawn to find out where a legend goes.
    """

    def __init__(self, inner: LayoutEngine | None) -> None:
        super().__init__()
        self._inner = inner
        self._adjust_compatible = inner is None or inner.adjust_compatible
        self._colorbar_gridspec = inner is None or inner.colorbar_gridspec

    def set(self, **options: Any) -> None:
        """Set what the former engine knows."""
        if self._inner is not None:
            self._inner.set(**options)

    def execute(self, fig: Figure) -> None:
        """Lay a picture out."""
        above = [
            (ax, made)
            for ax in fig.axes
            if (made := ax.get_legend()) is not None and made.get_gid() == _ABOVE
        ]
        for _, made in above:
            made.set_in_layout(False)
        self._lay_out(fig)  # puts the axes where they belong
        renderer = RendererAgg(1, 1, fig.dpi)  # type: ignore[no-untyped-call]  # measures text
        for ax, made in above:
            handles, names = made.legend_handles, [text.get_text() for text in made.get_texts()]
            for columns in range(len(names), 0, -1):
                made = _put_above(ax, handles, names, columns)
                if made.get_window_extent(renderer).x1 <= fig.bbox.x1:
                    break
            made.set_in_layout(True)
            pad = 2 + made.get_window_extent(renderer).height * 72 / fig.dpi
            ax.set_title(ax.get_title(loc="left"), loc="left", fontsize="medium", pad=pad)
        self._lay_out(fig)

    def _lay_out(self, fig: Figure) -> None:
        if self._inner is not None:
            self._inner.execute(fig)


def _put_above(ax: Axes, handles: Sequence[Any], names: Sequence[str], columns: int) -> Legend:
    made = ax.legend(
        handles=handles, labels=names, frameon=False, fontsize="small", ncols=columns,
        loc="lower left", bbox_to_anchor=(0.0, 1.0), borderaxespad=0.2,
    )  # fmt: skip
    made.set_gid(_ABOVE)
    made.set_in_layout(False)  # a legend that is too wide must not squeeze the axes
    return made
