"""Reports of commands in a real browser: no error, nothing cut off on a phone, pictures drawn."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import pytest

import energyplan as ep
from energyplan import cli
from energyplan.io.files import bundled
from energyplan.io.tables import write_log

PHONE, DESKTOP = 390, 1200
MODEL = ep.PowerModel.preset("quadriga:full:marble")
OFFICE = ("--map", bundled("office.yaml"), "--surfaces", bundled("office_surfaces.geojson"))
ENDS = ("--start", "1.2,2,90deg", "--goal", "3.9,2,90deg", "--effort", 5000)
REPORTS = {
    "diagnosis": ("diagnose", "drive.csv", "--vehicle", "quadriga:full"),
    "comparison": ("compare", *OFFICE, "--model", MODEL.name, *ENDS),
    "mission": ("mission", bundled("mission_warehouse.yaml"), "--effort", 1000),
}


@pytest.mark.usefixtures("few_effects")
@pytest.mark.parametrize("name", REPORTS)
def test_a_report_is_sound_in_a_browser(
    name: str, browser: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    drive = ep.simulate.identification_drive(MODEL, power_noise=5.0, gains={"p_left": 1.1}, seed=1)
    write_log(drive, Path("drive.csv"))
    report = tmp_path / f"{name}.html"
    words = ["energyplan", *map(str, REPORTS[name]), "--report", str(report)]
    monkeypatch.setattr(sys, "argv", words)
    with pytest.raises(SystemExit) as left:
        cli.main()
    assert not left.value.code
    for width in (PHONE, DESKTOP):
        page = browser.new_page(viewport={"width": width, "height": 844})
        errors: list[str] = []
        page.on("pageerror", lambda error, errors=errors: errors.append(str(error)))
        page.on("console", lambda told, errors=errors: errors.append(told.text))
        page.goto(report.as_uri())
        assert errors == []
        assert page.evaluate("document.documentElement.scrollWidth") <= width
        assert page.evaluate("document.body.innerText.length") > 300
        loaded = page.evaluate("[...document.images].map((image) => image.naturalWidth)")
        assert len(loaded) >= 1
        assert all(loaded)
        page.close()
