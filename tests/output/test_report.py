from __future__ import annotations

import re
from html.parser import HTMLParser
from pathlib import Path

import pytest

from energyplan import PowerModel, __version__
from energyplan.errors import InvalidInputError
from energyplan.html import Summary, column, quantity, share, unit
from energyplan.output import plots
from energyplan.output.pages import Page
from energyplan.output.plots import svg


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


def test_the_footer_says_what_made_the_page(tmp_path: Path) -> None:
    page = Page("Title")
    file = tmp_path / "a<b>.csv"
    file.write_bytes(b"abc")
    model = PowerModel.preset("quadriga:full:marble")
    page.made_from(call="energyplan <x>", files=[file], model=model)
    page.made_from(files=[file], model=model)
    text = parsed(page).text
    assert text.count("energyplan <x>") == text.count("Model") == text.count("Vehicle") == 1
    assert f"energyplan {__version__}" in text
    assert text.count(f"{file} ") == 1
    # FIPS 180-2, appendix B.1
    known = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"
    assert f"SHA-256 {known}" in text
    assert any(line.startswith("quadriga:full: 147.1 kg") for line in text)
    with pytest.raises(InvalidInputError, match="checksum"):
        page.made_from(files=[tmp_path / "absent.csv"])


def test_the_date_of_a_page_can_be_given(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "86400")
    assert "1970-01-02 00:00 UTC" in parsed(Page("Title")).text
    for wrong in ("now", "1e99", "9" * 30):
        monkeypatch.setenv("SOURCE_DATE_EPOCH", wrong)
        with pytest.raises(InvalidInputError, match="SOURCE_DATE_EPOCH"):
            Page("Title").html()


def test_cells_of_wide_tables_carry_their_header() -> None:
    wide = Summary("", ("a", "b", "c", "d", "<e>"), [(1, 2, 3, 4, "x")]).html()
    assert wide.count("data-label=") == 5
    assert 'data-label="&lt;e&gt;"' in wide
    assert "data-label=" not in Summary("", ("a", "b"), [(1, 2)]).html()


def test_columns_of_numbers_stand_to_the_right_and_what_is_absent_is_told() -> None:
    rows = [("a 1", "1 to 2", "-", 1.5), ("b", "-", "-", 2)]
    made = Summary("", ("name", "span", "gone", "size"), rows).html()
    assert made.count('<th style="text-align:right">') == 2
    assert re.findall(r'<td class="([a-z ]+)"[^>]*>([^<]*)', made) == [
        ("number", "1 to 2"), ("none", "-"), ("number", "1.5"),
        ("number none", "-"), ("none", "-"), ("number", "2"),
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("value", "error", "symbol", "text"),
    [
        (144.1963, 2.794, "kg", "144.2 ± 2.8 kg"), (26161.0, 412.0, "J", "26161 ± 412 J"),
        (6.907e-4, 1.3e-5, "W/N^2", "0.000691 ± 0.000013 W/N²"), (0.5, 0.0, "1", "0.5"),
        (1.5e-12, 2e-13, "m", "1.5e-12 ± 2e-13 m"), (2.0, float("nan"), "m", "2 m"),
    ],
)  # fmt: skip
def test_an_error_decides_on_the_digits(value: float, error: float, symbol: str, text: str) -> None:
    assert quantity(value, error, symbol) == text


def test_numbers_that_are_compared_have_the_decimals_of_the_largest() -> None:
    assert column([23.41, 1.26, 9.4e-5]) == ["23", "1", "0"]
    assert column([0.0712, 0.0056, 1e-9]) == ["0.071", "0.006", "0.000"]
    assert column([1e3, -1e-12], 4) == ["1000", "0"]
    assert column([0.0]) == ["0"] and column([]) == []


def test_a_part_of_a_limit_that_is_printed_keeps_the_limit() -> None:
    parts = (2 / 3, 1.0, 0.99999, 2.5, 0.012345, 0.0)
    assert [share(one) for one in parts] == ["66.6 %", "100 %", "99.9 %", "250 %", "1.23 %", "0 %"]


def test_units_are_printed_with_raised_powers() -> None:
    assert [unit(u) for u in ("m/s^2", "kg m^2", "m^-1", "1", "W")] == [
        "m/s²", "kg m²", "m⁻¹", "", "W",
    ]  # fmt: skip


def test_a_figure_is_the_same_bytes_twice() -> None:
    drawn = []
    for _ in range(2):
        figure = plots.figure()
        figure.axes[0].plot([0, 1], [0, 1], label="a")
        figure.axes[0].legend()
        drawn.append(svg(figure))
    assert drawn[0] == drawn[1]
