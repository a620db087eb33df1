"""Malformed files of every kind: each is refused with its name, its place and the remedy.

A line of a table is a change of a file that is right, and what the message says: ``+TEXT`` at the
end, ``OLD => NEW``, ``=TEXT`` for the whole, or ``@`` with what `drawn` makes GeoJSON of.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
import shapely
from PIL import Image

from energyplan.errors import InvalidInputError
from energyplan.io.config import read_model, read_vehicle
from energyplan.io.geojson import read_surfaces
from energyplan.io.heights import read_heights
from energyplan.io.maps import read_map
from energyplan.io.sites import read_site
from energyplan.io.tables import read_drive, read_path, read_trajectory
from energyplan.logs import DriveLog

DIMENSIONS = """\
name: mule
mass: 120.0
wheelbase: 0.6
track: 0.7
length: 1.0
width: 0.9
"""
WHEELS = """\
name: mule
contacts: [[0.3, 0.35], [-0.3, 0.35], [0.3, -0.35], [-0.3, -0.35]]
footprint: [[-0.5, -0.45], [0.5, 0.45]]
mass: 120.0
"""
MODEL = """\
name: by hand
vehicle: quadriga:full
terms:
- {name: slip_friction, value: 0.5, std_error: 0.1}
- {name: traction_resistance, value: 100.0, std_error: 2.0}
"""
HEADER = """\
image: m.png
resolution: 0.1
origin: [1.0, -2.0, 0.5]
negate: 0
occupied_thresh: 0.65
free_thresh: 0.25
"""
ASC = "ncols 3\nnrows 2\nxllcorner 10\nyllcorner 20\ncellsize 2\nNODATA_value -9999\n1 2 3\n4 5 6\n"
SITE = "map: m.yaml\nkeepout: m.yaml\nclearance: 20 cm\n"


class Kind(NamedTuple):
    read: Callable[[Path], object]
    name: str
    right: str = ""


KINDS = {
    "vehicle": Kind(read_vehicle, "it.yaml", DIMENSIONS),
    "wheels": Kind(read_vehicle, "it.yaml", WHEELS),
    "model": Kind(read_model, "it.yaml", MODEL),
    "map": Kind(read_map, "m.yaml", HEADER),
    "movingai": Kind(read_map, "a.map"),
    "obstacles": Kind(read_map, "o.geojson"),
    "surfaces": Kind(read_surfaces, "s.geojson"),
    "site": Kind(partial(read_site, inside=True), "yard.yaml", SITE),
    "heights": Kind(read_heights, "h.asc", ASC),
    "path": Kind(read_path, "it.csv"),
    "drive": Kind(read_drive, "it.csv"),
    "trajectory": Kind(read_trajectory, "it.csv"),
    "log": Kind(DriveLog.read, "it.csv"),
}
TABLES = {
    "surfaces": r"""
={ | JSON
=[] | FeatureCollection
@ | no features; draw a polygon for each ground
@POLYGON ((8.5 47.1, 8.5001 47.1, 8.5001 47.1001, 8.5 47.1)); model=jackal:flooring | longitude and
={"features": [{"type": "Feature", "geometry": null}]} | feature 0 has no geometry
@POLYGON ((0 0, 2 0, 2 1, 0 0)) | feature 0: no property
@POLYGON ((0 0, 1e9 0, 1e9 1, 0 0)); model=x | feature 0: reaches beyond
@POLYGON ((0 0, 2 0, 2 1, 0 0)); model=ice | feature 0.*unknown model preset 'ice'
@POLYGON ((0 0, 2 0, 2 1, 0 0)); model=../m.yaml | folder
@POINT (0 0); model=x | feature 0: a Point; give
@POLYGON ((0 0, 1 1, 1 0, 0 1, 0 0)); model=x | Self-intersection
={"features":[{"geometry":{"type":"Polygon","coordinates":[[[0,0],[1,"a"]]]}}]} | coordinates
""",
    "obstacles": r"""
@ | no features
@POINT (0 0) | feature 0: a Point
@LINESTRING (0 0, 1 0); kind=boundary | feature 0: a Line
@POLYGON ((0 0, 9e6 0, 9e6 9e6, 0 0)) | coarser
@LINESTRING (0 0, 1 0) | make no map
""",
    "vehicle": r"""
+colour: red\n | line 7, colour: there is no such key; the keys are name
+motor: {pawer: 3}\n | line 7, motor.pawer: .* continuous_power
+motor:\n  speed: fast\n | line 8, motor.speed: .* not 'fast'
+motor:\n  speed: -1\n | line 8, motor.speed: give 0.001 to 50 m/s, not '-1'
+mass: 3\n | line 7: 'mass' stands twice
mass: 120.0\n => | mass: the key is missing
120.0 => .nan | line 2, mass: give .*, not 'nan'
120.0 => -3 | line 2, mass: give .*, not '-3'
120.0 => 147000 | line 2, mass: give .* 100000 kg \(not grams\)
+usual_speed: 1.0e+6\n | line 7, usual_speed: give 0.001 to 50 m/s
+motor: {speed: 1.0e+6}\n | line 7, motor.speed: give 0.001 to 50 m/s
=preset: jackal\nloads: [1, 1, 1, 3.9e+8]\n | line 2, loads.3: give 0 to 1e.06 N, not '390000000.0'
+loads: [1, 2, 3, 4]\n | line 7, loads: the key contradicts
+icr: {left: 0.4}\n | line 7, icr.right: this key is missing
+icr: {left: -1, right: 0.5}\n | slip track
+drive_efficiency: 1.5\n | drive_efficiency: give 0.01 to 1 .*, not '1.5'
+cog: [2.0, 0.0]\n | lift off
=preset: horse\n | line 1, preset: unknown vehicle preset
=preset: jackal\ntrack: 1\n | line 2, track: the key contradicts
=kind: model\n | holds a 'model', where a vehicle
= | is empty
=- 1\n | must hold a mapping
=a: [1\n | line 2 is no valid YAML
=a: !!python/object/apply:os.system [x]\n | line 1: leave the tag
=a: !!python/name:os.system x\n | line 1: .* cannot be read
=? [1, 2]\n: 3\n | plain word
=a: !!int x\n | line 1: 'x' cannot be read
=a: &a [*a]\n | too deep|no valid YAML|unhashable
=a: \x07\n | no valid YAML
""",
    "wheels": r"""
mass: 120.0\n => | loads: the key is missing
0.3, 0.35], [ => | icr: the key is missing
0.3, 0.35 => 0.3 | line 2, contacts.0: .* at least 2
+loads: [1, 2, 3, 4]\n | loads: the key contradicts
[[0.3, 0.35], [-0.3, 0.35], [0.3, -0.35], [-0.3, -0.35]] => 3 | line 2, contacts: .* list, not '3'
0.35 => 0.35e999 | line 2, contacts.0.1: .* finite
+motor: 3\n | line 5, motor: .* dictionary
+icr: {left: 0.4, right: fast}\n | line 5, icr.right: give a number, not 'fast'
""",
    "model": r"""
, std_error: 2.0 => | give every term a std_error
slip_friction => slippery | line 4, terms.0: unknown power term
traction_resistance => slip_friction | line 3, terms: a term stands twice
100.0 => much | line 5, terms.1.value: .* not 'much'
100.0 => .inf | line 5, terms.1.value: .* finite
quadriga:full => horse | line 2, vehicle: unknown vehicle preset
quadriga:full => {preset: jackal, mass: -1} | line 2, vehicle
vehicle: quadriga:full\n => | vehicle: this key is missing
+- {name: warm_up, value: 1, params: {tau: 3}}\n | terms.2: .*time_constant
+- {name: hotel_load, value: 1, unit: kW}\n | terms.2: the unit .* 'W'
+covariance: [[1, 0], [0]]\n | line 6, covariance.1: the row has 1 of 2
+covariance: [[1, 5], [0, 1]]\n | symmetric
+covariance: [[1]]\n | shape
+residual: {rmse: 1}\n | residual: the keys mae, bias, energy_error are missing
+residual: {rmse: 1, mae: 1, bias: 0, energy_error: .nan}\n | energy_error:
=kind: vehicle\n | holds a 'vehicle', where a model
""",
    "map": r"""
=levels:\n  L1: {elevation: 0}\nname: site\n | seems to be a building of Open-RMF, not a map of
=tasks: []\nbattery: quadriga\n | seems to be a mission, not a map of map_server
0.1 => 0 | resolution
0.1 => 'five' | resolution
0.1 => .nan | resolution
0.1 => 1e-300 | resolution
1.0, -2.0, 0.5 => 0, 0 | origin
1.0, -2.0, 0.5 => 1e300, 0, 0 | origin
1.0, -2.0, 0.5 => 0, 0, .inf | origin
1.0, -2.0, 0.5 => 0, 0, 90 | line \d+, origin: .* in degrees
+\nmode: quaternary | mode
0.25 => 0.9 | free_thresh
0.65 => 7 | occupied_thresh
occupied_thresh: 0.65\n => | occupied_thresh: this key is missing
0.65\nfree_thresh: 0.25 => 0.65 | free_thresh: this key is missing
occupied_thresh => occupied_threshold | line 5, occupied_threshold: .* it occ
+\nMode: raw | Mode: there is no such key; write it mode
m.png => missing.png | there is no 'missing\.png' beside the map
m.png => m.yaml | not a PGM
m.png => [1 | line \d+ is no valid YAML
m.png => !!python/object/apply:os.getcwd [] | line 1: leave the tag
m.png => !!python/name:os.getcwd | line 1: .*cannot be read
""",
    "movingai": r"""
= | a.map
=type octile\nheight 2\nwidth 2\n | a.map
=type octile\nheight 2\nmap\n..\n..\n | a.map
=height 0\nwidth 2\nmap\n | a.map
=height 2\nwidth 2\nmap\n..\n.\n | a.map
=height 3\nwidth 2\nmap\n..\n..\n | a.map
=height 999999999\nwidth 999999999\nmap\n | a.map
=height -2\nwidth 2\nmap\n..\n..\n | a.map
""",
    "site": r"""
clearance => clearnce | line 3, clearnce: there is no such key
20 => -20 | line 3, clearance
cm => inch | line 3, clearance: the unit of a length is one of m, cm, mm
keepout: m => keepout: none | line 2, keepout: .*none.yaml
keepout => heights | line 2, heights
map:  => map: ../ | line 1, map: .*leaves the file's folder
""",
    "heights": r"""
cellsize 2 => cellsize | line 5: cellsize
cellsize 2 => cellsize 0 | resolution
cellsize 2\n => | no cellsize
cellsize 2 => cellsize 0.00028 | degrees of longitude and latitude
2 => 1e9 | rows of 3
2 => 2.5 | whole
2 => nan | finite
2 => 3 | 2 rows
5 6 => 5 | line 8: 2 heights
5 => x | line 8
5 => nan | 1 cells without data, the first in row 2, column 2
5 => -9999 | 1 cells without data, the first in row 2, column 2
""",
    "path": r"""
=x,y,yaw\n0,0,0\n0,1,0\n | line 2.*slide 1 m
=x,y,yaw\n0,0,0\n | 1 poses
=x,y,yaw\n0,0,0\n1,,0\n | line 3: y is empty
=x,y,yaw\n0,0,0\n1,zero,0\n | line 3: 'y' is 'zero'
=x,y\n0,0\n1,0\n | no column 'yaw'
=x,y,yaw\n0,0,0\n1e9,0,0\n | line 3: x is 1e[+]09, beyond
=x,y,yaw\n0,0,0\n9e7,0,0\n | m long, beyond
""",
    "drive": r"""
=t,x,y,yaw\n0,0,0,0\n1,1,0,0\n | leave t out to have the poses timed
=time,velL,velR,power [W]\n0,0,0,9\n1,1,1,9\n | energyplan identify
""",
    "trajectory": r"""
=x,y,yaw\n0,0,0\n1,0,0\n | plan --trajectory times one
=t,x,y,yaw,v,omega\n0,0,0,0,1,0\n | 1 samples
=t,x,y,yaw,v,omega\n0,0,0,0,1,0\n0,1,0,0,1,0\n | line 3: t does not
=t,x,y,yaw,v,omega\n0,0,0,0,1,inf\n1,1,0,0,1,0\n | line 2: omega is empty
=t,x,y,yaw,v,omega\n0,0,0,0,0,1\n1,0,0,57,0,1\n | line 3: yaw changes by
=t,x,y,yaw,v,omega\n0,0,0,0,1,0\n1,9,0,0,1,0\n | line 3: x, y changes by
""",
    "log": r"""
=x,y,yaw\n0,0,0\n1,0,0\n | energyplan check reads it
""",
}


def drawn(text: str) -> str:
    """Return GeoJSON of features that are written as ``WKT; NAME=VALUE & WKT``."""
    features = []
    for one in filter(None, text.split(" & ")):
        shape, *pairs = one.split("; ")
        geometry = shapely.geometry.mapping(shapely.from_wkt(shape))
        properties = dict(pair.split("=") for pair in pairs)
        features.append({"type": "Feature", "properties": properties, "geometry": geometry})
    return json.dumps({"type": "FeatureCollection", "features": features})


def changed(kind: str, line: str) -> tuple[str, str, str]:
    change, words = line.split(" | ", 1)
    text = change.encode().decode("unicode_escape")
    old, _, new = text.partition(" =>")
    if text[0] == "@":
        return kind, drawn(text[1:]), words
    if text[0] not in "+=":
        assert old in KINDS[kind].right, line
        return kind, KINDS[kind].right.replace(old, new.removeprefix(" "), 1), words
    return kind, KINDS[kind].right * (text[0] == "+") + text[1:], words


CASES = [
    *(changed(kind, line) for kind, table in TABLES.items() for line in table.split("\n")[1:-1]),
    ("surfaces", "[" * 100_000, "JSON"),
    (
        "surfaces",
        drawn("POLYGON ((0 0, 1 0, 1 1, 0 0)); model=x").replace("1.0", "1e999"),
        "feat.* 0",
    ),
    ("vehicle", DIMENSIONS.replace("120.0", "9" * 400), "line 2, mass: "),
    ("vehicle", "a: " + "[" * 5000, "nested too deeply|too deep|no valid YAML"),
]


@pytest.mark.parametrize(("kind", "text", "words"), CASES)
def test_a_malformed_file_is_refused_with_its_place(
    tmp_path: Path, kind: str, text: str, words: str
) -> None:
    read, name, _ = KINDS[kind]
    Image.fromarray(np.zeros((2, 2), np.uint8)).save(tmp_path / "m.png")
    (tmp_path / "m.yaml").write_text(HEADER)
    (tmp_path / name).write_text(text)
    with pytest.raises(InvalidInputError, match=words) as caught:
        read(tmp_path / name)
    assert name in str(caught.value) or words == "folder"
    assert "\n" not in str(caught.value)
