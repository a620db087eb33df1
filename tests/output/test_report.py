from __future__ import annotations

from html.parser import HTMLParser

import pytest

from energyplan import __version__
from energyplan.html import number
from energyplan.output import plots
from energyplan.output.report import Page, svg


class Collector(HTMLParser):
    """Collects tags, attributes that would load something, and text."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.links: list[str] = []
        self.text: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.links += [v or "" for k, v in attrs if k in ("src", "href")]
        if tag not in ("meta", "img"):
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text.append(data)


def parsed(page: Page) -> Collector:
    collector = Collector()
    collector.feed(page.html())
    assert collector.open == []
    return collector


def test_pages_are_well_formed_and_self_contained() -> None:
    page = Page("Title")
    page.heading("Section")
    page.paragraph("Text", "flag")
    page.bullets(["one", "two"])
    page.table(("name", "value"), [("a", 1.5), ("b", 2)])
    figure = plots.figure()
    figure.axes[0].plot([0, 1], [0, 1])
    page.picture(figure, "A line")
    links = parsed(page).links
    assert len(links) == 1
    assert links[0].startswith("data:image/svg+xml;base64,")


def test_text_from_files_cannot_become_markup() -> None:
    evil = "<script>alert(1)</script>"
    page = Page(evil)
    page.heading(evil)
    page.paragraph(evil)
    page.bullets([evil])
    page.table((evil,), [(evil,)])
    page.command(evil)
    assert "<script" not in page.html()
    assert parsed(page).text.count(evil) == 8


def test_an_empty_list_leaves_no_trace() -> None:
    page = Page("Title")
    page.bullets([])
    assert "<ul>" not in page.html()


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.0, "0"), (12345.6, "12346"), (0.123456, "0.1235"), (-3.0, "-3"), (1e-7, "1e-07")],
)
def test_numbers_read_well(value: float, text: str) -> None:
    assert number(value) == text


def test_the_footer_says_what_made_the_page() -> None:
    page = Page("Title")
    page.footer(["vehicle <robot>"])
    text = parsed(page).text
    assert "vehicle <robot>" in text
    assert any(line.startswith(f"energyplan {__version__}, 20") for line in text)


def test_a_figure_is_the_same_bytes_twice() -> None:
    drawn = []
    for _ in range(2):
        figure = plots.figure()
        figure.axes[0].plot([0, 1], [0, 1], label="a")
        figure.axes[0].legend()
        drawn.append(svg(figure))
    assert drawn[0] == drawn[1]
