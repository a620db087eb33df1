"""Reports: one self-contained HTML page each, readable on a phone and printable."""

from __future__ import annotations

import base64
import html
import io
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from typing import Any

import matplotlib as mpl
from matplotlib.figure import Figure

from energyplan import __version__
from energyplan import html as _html
from energyplan.errors import UnknownNameError

_CSS = """
:root { color-scheme: light; }
body { font: 16px/1.5 system-ui, sans-serif; color: #1b1b1b; max-width: 62rem; margin: 0 auto;
       padding: 1rem; }
h1 { font-size: 1.6rem; } h2 { font-size: 1.25rem; margin-top: 2.2rem; }
p.lead { font-size: 1.1rem; }
.flag { border-left: 4px solid #d55e00; background: #fdf2ea; padding: .5rem .8rem; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; margin: .8rem 0; }
th, td { padding: .3rem .7rem; border-bottom: 1px solid #d8d8d8; text-align: left;
         vertical-align: top; }
th { border-bottom: 2px solid #888; }
td.number { text-align: right; }
figure { margin: 1rem 0; } figure img { max-width: 100%; height: auto; }
figcaption { color: #555; font-size: .9rem; margin-top: .5rem; }
footer { margin-top: 3rem; border-top: 1px solid #d8d8d8; padding-top: .6rem; color: #555;
         font-size: .85rem; overflow-wrap: anywhere; }
footer p { margin: .2rem 0; }
code { background: #f2f2f2; padding: .1rem .3rem; overflow-wrap: anywhere; }
@media (max-width: 40rem) { table { font-size: .9rem; } th, td { padding: .3rem .4rem; } }
@media print { h2 { break-after: avoid; } figure, table { break-inside: avoid; } }
"""


def svg(figure: Figure) -> bytes:
    """Return a figure as an SVG drawing; dense clouds of points in it are pictures."""
    return image(figure, ".svg")


def image(figure: Figure, suffix: str) -> bytes:
    """Return a figure as an image of the kind that a file's suffix names.

    Parameters
    ----------
    figure : Figure
        The figure.
    suffix : {".png", ".svg", ".pdf"}
        The kind.

    Returns
    -------
    bytes
        The image, the same for the same figure: it holds no date.

    Raises
    ------
    UnknownNameError
        If there is no such kind.
    """
    undated: dict[str, dict[str, Any]] = {
        ".png": {"Software": None},
        ".svg": {"Date": None, "Creator": None},
        ".pdf": {"CreationDate": None},
    }
    kind = suffix.lower()
    if kind not in undated:
        raise UnknownNameError("kind of image", suffix, undated)
    stream = io.BytesIO()
    with mpl.rc_context({"svg.hashsalt": "energyplan"}):  # names of parts that do not change
        figure.savefig(stream, format=kind[1:], dpi=150, metadata=undated[kind])
    return stream.getvalue()


def png(figure: Figure) -> bytes:
    """Return a figure as a PNG image."""
    return image(figure, ".png")


@dataclass
class Page:
    """An HTML page that is built from top to bottom; all text is escaped.

    Parameters
    ----------
    title : str
        Title of the page.

    Examples
    --------
    >>> page = Page("Energy of a route")
    >>> page.paragraph("Within 2 % of the measurement.")
    >>> "<h1>Energy of a route</h1>" in page.html()
    True
    """

    title: str
    _parts: list[str] = field(default_factory=list, repr=False)
    _footer: list[str] = field(default_factory=list, repr=False)

    def heading(self, text: str) -> None:
        """Start a section."""
        self._parts.append(f"<h2>{html.escape(text)}</h2>")

    def paragraph(self, text: str, kind: str = "") -> None:
        """Add a paragraph; `kind` is ``""``, ``"lead"`` or ``"flag"`` (a warning)."""
        self._parts.append(f'<p class="{html.escape(kind)}">{html.escape(text)}</p>')

    def bullets(self, lines: Iterable[str]) -> None:
        """Add a list."""
        items = "".join(f"<li>{html.escape(line)}</li>" for line in lines)
        if items:
            self._parts.append(f"<ul>{items}</ul>")

    def command(self, text: str) -> None:
        """Add a command line."""
        self._parts.append(f"<p><code>{html.escape(text)}</code></p>")

    def table(self, header: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
        """Add a table; numbers are aligned to the right and shown with four digits."""
        self._parts.append(f'<div class="scroll">{_html.table(header, rows)}</div>')

    def picture(self, figure: Figure, caption: str) -> None:
        """Add a figure, as vectors, with its caption."""
        data = base64.b64encode(svg(figure)).decode("ascii")
        text = html.escape(caption)
        self._parts.append(
            f'<figure><img alt="{text}" src="data:image/svg+xml;base64,{data}">'
            f"<figcaption>{text}</figcaption></figure>"
        )

    def footer(self, lines: Iterable[str]) -> None:
        """Say at the end of the page what it was made from."""
        self._footer.extend(lines)

    def html(self) -> str:
        """Return the page; it loads nothing from elsewhere."""
        title = html.escape(self.title)
        made = f"energyplan {__version__}, {datetime.now().astimezone():%Y-%m-%d %H:%M %Z}"
        end = "".join(f"<p>{html.escape(line)}</p>" for line in (*self._footer, made))
        return (
            '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
            '<meta name="viewport" content="width=device-width, initial-scale=1">'
            f"<title>{title}</title><style>{_CSS}</style></head>"
            f"<body><h1>{title}</h1>{''.join(self._parts)}"
            f"<footer>{end}</footer></body></html>\n"
        )
