"""The gallery has every example, with the command that runs it and what comes of it."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "gallery.md").read_text()
EXAMPLES = sorted(file.name for file in (ROOT / "examples").iterdir() if file.is_file())
SECTIONS = re.split(r"^#### ", PAGE, flags=re.MULTILINE)[1:]


def commands(section: str) -> list[str]:
    return re.findall(r"^    (.*examples/.*)$", section, re.MULTILINE)


def section_of(name: str) -> str:
    found = [one for one in SECTIONS if any(f"examples/{name}" in c for c in commands(one))]
    assert len(found) == 1, f"{name} has {len(found)} sections in docs/gallery.md"
    return found[0]


@pytest.mark.parametrize("name", EXAMPLES)
def test_every_example_has_a_section_with_its_command(name: str) -> None:
    section = section_of(name)
    file = f"energyplan {'fleet' if name.startswith('fleet') else 'mission'}"
    starts = file if name.endswith(".yaml") else "python"
    assert any(c.startswith(f"{starts} examples/{name}") for c in commands(section))
    source = (ROOT / "examples" / name).read_text()
    shown = bool(re.search(r"!\[.*\]\(.*\.png\)|^```", section, re.MULTILINE))
    assert shown or "savefig" not in source, f"{name} draws a picture; show it"


def test_every_section_shows_an_example_that_exists() -> None:
    for section in SECTIONS:
        assert commands(section), section.splitlines()[0]
        for command in commands(section):
            assert re.search(r"examples/([\w.]+)", command)[1] in EXAMPLES, command


def test_every_picture_is_shown_somewhere() -> None:
    pages = "".join(page.read_text() for page in (ROOT / "docs").rglob("*.md"))
    pages += (ROOT / "README.md").read_text()
    drawn = [*(ROOT / "docs" / "images").iterdir(), *(ROOT / "docs" / "pictures").iterdir()]
    unused = [file.name for file in drawn if file.name not in pages]
    assert [name for name in unused if name not in DEMO_ONLY] == []


DEMO_ONLY = {"diagnosis-residual.png", "loop.png", "routes-energy.png"}
"""Pictures that the demo draws beside those that the pages show."""
