"""Tables in HTML, for reports and for results shown in notebooks (private)."""

from __future__ import annotations

import html
from collections.abc import Iterable, Sequence


def number(value: float, digits: int = 4) -> str:
    """Return a number as a reader wants it: `digits` significant ones, no exponent if possible."""
    text = f"{value:.{digits}g}"
    return f"{value:.0f}" if "e" in text and abs(value) >= 1 and abs(value) < 1e9 else text


WIDE = 4
"""A table of more columns than these is shown row by row where a page is narrow."""


def table(header: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Return a table; numbers are aligned to the right and shown with four digits."""
    names = [html.escape(name) for name in header]
    head = "".join(f"<th>{name}</th>" for name in names)
    wide = len(names) > WIDE
    lines = []
    for row in rows:
        labels = names if wide else [""] * len(row)
        cells = (_cell(value, label) for value, label in zip(row, labels, strict=True))
        lines.append(f"<tr>{''.join(cells)}</tr>")
    kind = ' class="wide"' if wide else ""
    return f"<table{kind}><thead><tr>{head}</tr></thead><tbody>{''.join(lines)}</tbody></table>"


def result(
    title: str, header: Sequence[str], rows: Iterable[Sequence[object]], notes: Iterable[str] = ()
) -> str:
    """Return what a notebook shows of a result: a title, a table, and what else is to be said."""
    items = "".join(f"<li>{html.escape(note)}</li>" for note in notes)
    said = f"<ul>{items}</ul>" if items else ""
    return f"<div><b>{html.escape(title)}</b>{table(header, rows)}{said}</div>"


def _cell(value: object, label: str) -> str:
    told = f' data-label="{label}"' if label else ""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return f"<td{told}>{html.escape(str(value))}</td>"
    return f'<td class="number" style="text-align:right"{told}>{number(float(value))}</td>'
