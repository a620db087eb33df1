"""Reports: one self-contained HTML page each, readable on a phone and printable."""

from __future__ import annotations

import base64
import hashlib
import html
import io
import os
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import matplotlib as mpl
from matplotlib.figure import Figure

from energyplan import __version__
from energyplan import html as _html
from energyplan.errors import InvalidInputError, UnknownNameError

if TYPE_CHECKING:
    from energyplan.power import PowerModel

DPI = 240
"""Resolution of images that have one [pixels per inch]."""

_CSS = """
:root { color-scheme: light dark; --text: #1b1b1b; --soft: #555; --line: #d8d8d8; --flag: #fdf2ea;
        --code: #f2f2f2; --back: #fff; }
@media (prefers-color-scheme: dark) {
  :root { --text: #e6e6e6; --soft: #aaa; --line: #444; --flag: #3a2a1e; --code: #2a2a2a;
          --back: #161616; }
  figure img { background: #fff; border-radius: .3rem; }
}
body { font: 16px/1.5 system-ui, sans-serif; color: var(--text); background: var(--back);
       max-width: 60rem; margin: 0 auto; padding: 1rem; }
h1 { font-size: 1.6rem; } h2 { font-size: 1.25rem; margin-top: 2.2rem; }
p.lead { font-size: 1.1rem; }
.flag { border-left: 4px solid #d55e00; background: var(--flag); padding: .5rem .8rem; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; margin: .8rem 0; }
th, td { padding: .3rem .7rem; border-bottom: 1px solid var(--line); text-align: left;
         vertical-align: top; }
th { border-bottom: 2px solid #888; }
td.number { white-space: nowrap; }
figure { margin: 1rem 0; } figure img { width: 100%; height: auto; }
.results { display: grid; grid-template-columns: repeat(auto-fit, minmax(11rem, 1fr)); gap: 1rem; }
.results div { border-top: 3px solid #0072b2; padding-top: .4rem; display: flex;
       flex-direction: column; justify-content: space-between; }
.results dt { color: var(--soft); }
.results dd { margin: 0; font-size: 1.4rem; font-weight: 600; }
figcaption { color: var(--soft); font-size: .9rem; margin-top: .5rem; }
footer { margin-top: 3rem; border-top: 1px solid var(--line); padding-top: .6rem;
         color: var(--soft); font-size: .85rem; overflow-wrap: anywhere; }
footer dl { display: grid; grid-template-columns: max-content 1fr; gap: .3rem 1rem; margin: 0; }
footer dt { font-weight: 600; } footer dd { margin: 0; }
footer .sum { display: block; font-family: monospace; font-size: .75rem; }
code { background: var(--code); padding: .1rem .3rem; overflow-wrap: anywhere; }
@media (max-width: 40rem) {
  table { font-size: .9rem; } th, td { padding: .3rem .4rem; }
  table.wide, table.wide tbody, table.wide tr { display: block; }
  table.wide thead { display: none; }
  table.wide tr { border-bottom: 2px solid #888; padding: .4rem 0; }
  table.wide td, table.wide td.number { display: grid; grid-template-columns: 9rem 1fr;
         border: 0; text-align: left !important; padding: .1rem .2rem; overflow-wrap: anywhere; }
  td.number { white-space: normal; } table.wide td.none:not(:first-child) { display: none; }
  table.wide td:first-child { font-weight: 600; }
  table.wide td::before { content: attr(data-label); color: var(--soft); padding-right: .5rem; }
}
@media print {
  :root { --text: #000; --soft: #444; --line: #bbb; --back: #fff; --code: #f2f2f2;
          --flag: #fdf2ea; }
  body { font-size: 11pt; max-width: none; padding: 0; }
  h2 { break-after: avoid; } figure, table, tr, footer { break-inside: avoid; }
  figure img { max-width: 28rem; } .scroll { overflow: visible; } table { font-size: 9pt; }
}
"""


def svg(figure: Figure) -> bytes:
    """Return a figure as an SVG drawing; dense clouds of points in it are pictures."""
    return image(figure, ".svg")


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


def png(figure: Figure) -> bytes:
    """Return a figure as a PNG image."""
    return image(figure, ".png")


@dataclass
class Page:
    """An HTML page that is built from top to bottom; all text is escaped."""

    title: str  # title of the page
    _parts: list[str] = field(default_factory=list, repr=False)
    _origin: list[tuple[str, str]] = field(default_factory=list, repr=False)

    def heading(self, text: str) -> None:
        """Start a section."""
        self._parts.append(f"<h2>{html.escape(text)}</h2>")

    def paragraph(self, text: str, kind: str = "") -> None:
        """Add a paragraph; `kind` is ``""``, ``"lead"`` or ``"flag"`` (a warning)."""
        self._parts.append(f'<p class="{html.escape(kind)}">{html.escape(text)}</p>')

    def results(self, results: Iterable[tuple[str, str]]) -> None:
        """Add the main results at the top of the page: a label and a value each."""
        items = "".join(
            f"<div><dt>{html.escape(label)}</dt><dd>{html.escape(value)}</dd></div>"
            for label, value in results
        )
        self._parts.insert(0, f'<dl class="results">{items}</dl>')

    def bullets(self, lines: Iterable[str]) -> None:
        """Add a list."""
        items = "".join(f"<li>{html.escape(line)}</li>" for line in lines)
        if items:
            self._parts.append(f"<ul>{items}</ul>")

    def command(self, text: str) -> None:
        """Add a command line."""
        self._parts.append(f"<p><code>{html.escape(text)}</code></p>")

    def table(self, header: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
        """Add a table; numbers are aligned to the right and shown with four digits.

        On a phone a table of more than four columns is shown row by row, each cell with its header.
        """
        self._parts.append(f'<div class="scroll">{_html.table(header, rows)}</div>')

    def picture(self, figure: Figure, caption: str) -> None:
        """Add a figure, as vectors, with its caption."""
        data = base64.b64encode(svg(figure)).decode("ascii")
        text = html.escape(caption)
        self._parts.append(
            f'<figure><img alt="{text}" src="data:image/svg+xml;base64,{data}">'
            f"<figcaption>{text}</figcaption></figure>"
        )

    def made_from(
        self, *, call: str = "", files: Iterable[Path] = (), model: PowerModel | None = None
    ) -> None:
        """Say at the end of the page what it was made from; may be called several times."""
        lines = [("Made by", f"<code>{html.escape(call)}</code>")] if call else []
        if model is not None:
            robot = model.vehicle
            told = f"{robot.name}: {_html.number(robot.mass)} kg, slip track "
            values = ", ".join(
                f"{_html.words(term.name)} {_html.quantity(value, None, term.unit)}"
                for term, value in zip(model.terms, model.coefficients.tolist(), strict=True)
            )
            lines += [
                ("Vehicle", html.escape(f"{told}{_html.number(robot.icr.slip_track)} m")),
                ("Model", html.escape(f"{model.name}: {values}")),
            ]
        lines += [
            ("Read", f'{html.escape(str(f))} <span class="sum">SHA-256 {_checksum(f)}</span>')
            for f in files
        ]
        self._origin.extend(line for line in lines if line not in self._origin)

    def html(self) -> str:
        """Return the page; it loads nothing from elsewhere.

        The date is that of now, or of the environment variable ``SOURCE_DATE_EPOCH`` (seconds since
        1970), with which the same input gives the same bytes.
        """
        title = html.escape(self.title)
        origin = [("Date", _date()), ("Program", f"energyplan {__version__}"), *self._origin]
        end = "".join(f"<dt>{name}</dt><dd>{text}</dd>" for name, text in origin)
        return (
            '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
            '<meta name="viewport" content="width=device-width, initial-scale=1">'
            f"<title>{title}</title><style>{_CSS}</style></head>"
            f"<body><h1>{title}</h1>{''.join(self._parts)}"
            f"<footer><dl>{end}</dl></footer></body></html>\n"
        )


def _date() -> str:
    """Return the date of a page, in UTC."""
    given = os.environ.get("SOURCE_DATE_EPOCH")
    try:
        now = datetime.fromtimestamp(int(given), UTC) if given else datetime.now(UTC)
    except (ValueError, OverflowError, OSError):
        raise InvalidInputError(
            f"SOURCE_DATE_EPOCH is {given!r}; give whole seconds since 1970, or unset it"
        ) from None
    return f"{now:%Y-%m-%d %H:%M} UTC"


def _checksum(file: Path) -> str:
    """Return the SHA-256 checksum of a file."""
    try:
        with file.open("rb") as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()
    except OSError as problem:
        raise InvalidInputError(
            f"{str(file)!r} cannot be read for its checksum: {problem.strerror}"
        ) from None
