"""Sphinx directives for tables that are made from the library: ``effects`` and ``numbers``."""

from __future__ import annotations

from collections.abc import Iterable

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective
from table_rows import effect_rows, number_rows


def _table(head: list[str], rows: Iterable[list[str]], code: int) -> nodes.table:
    """Return a table whose column ``code`` is set as code."""

    def row(cells: list[str], code: int | None = None) -> nodes.row:
        texts = [
            nodes.literal(text=cell) if column == code else nodes.Text(cell)
            for column, cell in enumerate(cells)
        ]
        return nodes.row("", *(nodes.entry("", nodes.paragraph("", "", text)) for text in texts))

    group = nodes.tgroup("", *(nodes.colspec(colwidth=1) for _ in head), cols=len(head))
    group += nodes.thead("", row(head))
    group += nodes.tbody("", *(row(cells, code) for cells in rows))
    return nodes.table("", group)


class Effects(SphinxDirective):
    """The effects of the catalogue, and the sizes in which diagnosis believes."""

    def run(self) -> list[nodes.Node]:
        """Build the table."""
        head = ["effect", "size", "from", "to", "of the mass", "values tried"]
        return [_table(head, effect_rows(), code=0)]


class Numbers(SphinxDirective):
    """What numbers of files may be, and usually are."""

    def run(self) -> list[nodes.Node]:
        """Build the table."""
        return [_table(["file", "key", "possible", "usual"], number_rows(), code=1)]


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the directives."""
    app.add_directive("effects", Effects)
    app.add_directive("numbers", Numbers)
    return {"parallel_read_safe": True}
