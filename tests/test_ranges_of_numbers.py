"""What numbers of files may be: one table, which stands beside the fields and is printed."""

from __future__ import annotations

import re
import runpy
from dataclasses import fields
from pathlib import Path

import pytest

import energyplan as ep
from energyplan.records import bounds, doubts_of

OWNERS = runpy.run_path(str(Path(__file__).parents[1] / "docs" / "table_rows.py"))["OWNERS"]
CHECKED_ELSEWHERE = {
    ("battery", "soc_points"): "ascends from 0 to 1",
    ("mission: tasks", "window"): "a window that is not empty",
    ("mission", "payload_models"): "by payload, within whose range a payload must be",
}


@pytest.mark.parametrize("file", OWNERS)
def test_every_number_of_a_file_has_bounds(file: str) -> None:
    numeric = re.compile(
        r"\b(float|int|NDArray|Numbers?|Time|Power|Mass|Length|Fraction|Amps|Volts|Ohms|Coulombs)\b"
    )
    for owner in OWNERS[file]:
        if not hasattr(owner, "__dataclass_fields__"):
            continue
        for item in fields(owner):
            if item.init and numeric.search(str(item.type)):
                known = item.name in bounds(owner) or (file, item.name) in CHECKED_ELSEWHERE
                assert known, f"{file}: {item.name}"


@pytest.mark.parametrize("name", ["quadriga", "quadriga:full", "husky_a200", "jackal", "warthog"])
def test_what_comes_with_the_library_is_usual(name: str) -> None:
    assert list(doubts_of(ep.Vehicle.preset(name))) == []
    if name in ("quadriga", "husky_a200", "jackal"):
        assert list(doubts_of(ep.Battery.preset(name))) == []


def test_python_warns_of_what_is_unusual_where_it_is_given() -> None:
    with pytest.warns(ep.errors.UnusualValueWarning, match="mass: 9000 is unusual") as said:
        ep.Vehicle.from_geometry("x", mass=9e3, wheelbase=0.4, track=0.5, length=0.6, width=0.6)
    assert [Path(one.filename).name for one in said] == [Path(__file__).name]
