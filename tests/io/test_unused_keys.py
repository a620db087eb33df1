"""What a file of another tool holds and no answer uses is named, but for what changes none."""

from __future__ import annotations

import json
import warnings
from pathlib import Path
from typing import Any

import pytest

from energyplan.errors import UnusualValueWarning
from energyplan.io.files import bundled
from energyplan.io.geojson import read_obstacles, read_surfaces
from energyplan.io.given import read_like
from energyplan.io.maps import read_map

SQUARE = [[[0, 0], [9, 0], [9, 9], [0, 9], [0, 0]]]


def drawn(folder: Path, **properties: Any) -> Path:
    shape = {"type": "Polygon", "coordinates": SQUARE}
    feature = {"type": "Feature", "geometry": shape, "properties": properties}
    file = folder / "areas.geojson"
    file.write_text(json.dumps({"type": "FeatureCollection", "features": [feature]}))
    return file


def said(read: Any, file: Path) -> list[str]:
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always", UnusualValueWarning)
        read(file)
    return [str(one.message) for one in found if "not used" in str(one.message)]


def test_properties_of_shapes(tmp_path: Path) -> None:
    known = {"surface": "keep_out", "fid": 3, "stroke": "#f00"}
    assert not said(read_surfaces, drawn(tmp_path, **known))
    (note,) = said(read_surfaces, drawn(tmp_path, **known, max_speed=0.5))
    assert note.endswith("areas.geojson: keys that are not used: max_speed")
    (note,) = said(read_obstacles, drawn(tmp_path, kind="wall", height=0.1))
    assert note.endswith("not used: height")


def test_keys_of_maps(tmp_path: Path) -> None:
    text = bundled("office.yaml").read_text()
    image = bundled("office.png" if "office.png" in text else "office.pgm")
    (tmp_path / image.name).write_bytes(image.read_bytes())
    file = tmp_path / "office.yaml"
    file.write_text(f"{text}\nframe_id: map\n")
    assert not said(read_map, file)
    file.write_text(f"{text}\nfloor_height: 3.0\n")
    (note,) = said(read_map, file)
    assert note == "office.yaml: keys that are not used: floor_height"


@pytest.mark.parametrize("limit", [{}, {"linear": {"x": {"max_velocity": 0.5}}}])
def test_parameters_of_a_controller(tmp_path: Path, limit: dict[str, Any]) -> None:
    file = tmp_path / "control.yaml"
    held = {"wheel_separation": 0.5, "wheel_radius": 0.1, "publish_rate": 50.0, **limit}
    file.write_text(json.dumps({"drive_controller": {"ros__parameters": held}}))
    found: dict[str, Any] = {}
    notes = said(lambda one: found.update(read_like(str(one))), file)
    assert found == {"track": 0.5, "wheel_radius": 0.1}
    assert notes == [f"control.yaml: keys that are not used: {key}" for key in limit]
