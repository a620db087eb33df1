r"""Malformed files of every kind: each is refused with its name, its place and the remedy.

A line of a table is a change of a file that is right, and what the message says: ``+TEXT`` at the
end, ``OLD => NEW``, ``=TEXT`` for the whole, or ``@`` with what `drawn` makes GeoJSON of. Escapes
are those of Python, ``\xff`` is that byte, and ``{9s}`` are four hundred nines.
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

from energyplan import errors
from energyplan.io.bags import TopicMap
from energyplan.io.config import read_model, read_vehicle
from energyplan.io.flight import read_flight
from energyplan.io.geojson import read_surfaces
from energyplan.io.heights import read_heights
from energyplan.io.logs import read_log
from energyplan.io.maps import read_map
from energyplan.io.mission import read_mission
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
HEAD = "t,v_left,v_right,power\n"
MISSION = """\
name: round
model: quadriga:empty:concrete
map: warehouse.yaml
surfaces: warehouse_surfaces.geojson
battery: {preset: quadriga, health: 80 %, temperature: 10}
soc: 90 %
coefficient_spread: 0.05
start: dock
places:
  dock: [1.5, 1.5, 90deg]
  gate: "11.0,10.4,0"
tasks:
  - name: look
    pose: gate
    dwell: 5 min
    power: 0.1 kW
    prize: 3
  - name: drop
    pose: [2.5, 8.0, 1.5]
    required: false
    window: [1 min, 1 h]
chargers:
  - {name: station, pose: dock, power: 200 W, until: 90 %}
order: free
return_to: charger
reserve: 20 %
"""


class Kind(NamedTuple):
    read: Callable[[Path], object]
    name: str
    right: str = ""
    error: type[errors.InvalidInputError] = errors.InvalidInputError


KINDS = {
    "vehicle": Kind(read_vehicle, "it.yaml", DIMENSIONS, errors.ConfigError),
    "wheels": Kind(read_vehicle, "it.yaml", WHEELS, errors.ConfigError),
    "model": Kind(read_model, "it.yaml", MODEL, errors.ConfigError),
    "topics": Kind(TopicMap.read, "topics.yaml", error=errors.ConfigError),
    "mission": Kind(read_mission, "round.yaml", MISSION, errors.MissionError),
    "mission of a service": Kind(
        partial(read_mission, inside=True), "round.yaml", MISSION, errors.MissionError
    ),
    "map": Kind(read_map, "m.yaml", HEADER, errors.MapError),
    "movingai": Kind(read_map, "a.map", error=errors.MapError),
    "obstacles": Kind(read_map, "o.geojson", error=errors.MapError),
    "surfaces": Kind(read_surfaces, "s.geojson"),
    "site": Kind(partial(read_site, inside=True), "yard.yaml", SITE, errors.MapError),
    "heights": Kind(read_heights, "h.asc", ASC, errors.MapError),
    "path": Kind(read_path, "it.csv"),
    "drive": Kind(read_drive, "it.csv"),
    "trajectory": Kind(read_trajectory, "it.csv"),
    "log": Kind(DriveLog.read, "it.csv", HEAD, errors.DriveLogError),
    "packed log": Kind(DriveLog.read, "it.csv.gz", error=errors.DriveLogError),
    "parquet": Kind(DriveLog.read, "it.parquet", error=errors.DriveLogError),
    "text": Kind(DriveLog.read, "it.txt", error=errors.DriveLogError),
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
120.0 => 120,5 | line 2, mass: .*number.*, not '120,5'; write 120.5
120.0 => 120,5 kg | line 2, mass: .*; write 120.5 kg
120.0 => true | line 2, mass
120.0 => no | line 2, mass
120.0 => 1:30 | line 2, mass
120.0 => 1:30:00 | line 2, mass
120.0 => 2026-01-01 | line 2, mass
120.0 => [true] | line 2, mass
120.0 => {9s} | line 2, mass:
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
=t,v\n0,1\n | plain text, such as a table
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
cm => ell | line 3, clearance: the unit of a length is one of m, cm, mm
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
=t,x,y,yaw,v,omega\n0,0,0,0,1,0\n6,{9s},0,0,1,0\n7,7,0\n | not finite
""",
    "topics": r"""
=channels: {v_left: {topic: a, field: 'b['}}\n | channels.v_left: write a field
=channels: {v_left: {topic: a}}\n | v_left.field: this key is missing
=channels: {v_left: {topic: a, field: b, gain: 2}}\n | no such key
=name: x\n | channels: this key is missing
""",
    "mission": r"""
pose: gate => pose: [0.05, 8.0, 0] | line 14.*touches an obstacle
pose: gate => pose: [99, 8.0, 0] | line 14.*outside the map
pose: gate => pose: garage | line 14.*there is no place 'garage'; the places are dock, gate
pose: gate => pose: [1] | line 14.*the pose is \[1\]; give x, y
pose: gate => pose: [.nan, 2, 0] | line 14.*finite
pose: gate => pose: [true, 2, 0] | line 14.*the pose is \[True, 2, 0\]; give x, y
pose: gate => pose: [2, true, 90deg] | line 14.*is not X,Y,YAW
soc: 90 % => planning_effort: {9s} | line 6.*planning_effort: give 1 to 1e\+09 units
soc: 90 % => planning_effort: 18446744073709551616 | line 6.*planning_effort: give 1 to 1e
until: 90 % => places: 18446744073709551616 | line 23.*give 1 to
until: 90 % => places: {9s} | line 23.*places: give 1 to
until: 90 % => places: true | line 23.*places: give a number
name: drop => name: look | line 18.*stands twice
dwell: 5 min => dwell: 5 moons | line 15.*unit of a time
dwell: 5 min => dwell: -3 | line 15.*dwell: give 0 to 1e\+08 s, not '-3'
power: 0.1 kW => power: .nan | line 16.*power
power: 0.1 kW => watts: 3 | line 16.*no such key
model: quadriga:empty:concrete => model: quadriga:empty:ice | line 2.*unknown model preset
map: warehouse.yaml => map: castle.yaml | line 3.*castle.yaml
surfaces: warehouse_surfaces.geojson => surfaces: m.yaml | line 4, surfaces: .*JSON
temperature: 10 => capacity: -5 Ah | line 5, battery.capacity: give 0.001 to 3.6e\+08 C, not '-5 Ah'
temperature: 10 => capacity: 200 | line 5.*200 has no unit, and would be C; write 200 Ah
temperature: 10 => capacity: '200' | line 5.*200 has no unit
temperature: 10 => capacity: 1e12 Ah | line 5.*battery.capacity: give 0.001 to 3.6e\+08 C
temperature: 10 => usable: [1] | line 5.*battery: usable is no fraction
temperature: 10 => notes: 5 | line 5.*battery.notes
temperature: 10 => helth: 80 % | line 5.*battery.helth: there is no such key
temperature: 10 => temperature: cold | line 5.*battery.temperature: give a number
temperature: 10 => temperature: 300 | line 5.*give -40 to 70 degC \(not kelvin\)
temperature: 10 => temperature: -100 | line 5.*give -40 to 70 degC, not '-100'
temperature: 10 => soc_points: [0, {9s}] | line 5.*give a list of finite numbers
preset: quadriga => chemistry: agm, series: 2 | line 5.*the pack lacks parallel, unit_cap
preset: quadriga => preset: nuclear | line 5.*unknown battery 'nuclear'
soc: 90 % => soc: 190 % | line 6.*soc: give 0 to 1 \(write a percentage with its sign
soc: 90 % => waiting: {mean: 0, std: 3 s} | line 6.*has no spread
soc: 90 % => spreads: {soc: -1 %} | line 6.*spreads.soc: give 0 to 1
soc: 90 % => spreads: {smell: 1 %} | line 6.*no such key
soc: 90 % => speed: 1000 | line 6.*speed: give 0.001 to 50 m/s
soc: 90 % => planning_effort: 1.0e+15 | line 6.*planning_effort: give 1 to 1e\+09 units
spread: 0.05 => spread: 5 | line 7.*coefficient_spread: give 0 to 1 \(write a percentage
\nplaces: => \nplaces: 0\nothers: | line 9.*places: Input should be a valid dictionary
gate: "11.0,10.4,0" => gate: [null, 8.0, 90deg] | line 11.*is not X,Y,YAW
gate: "11.0,10.4,0" => gate: [[1], 8.0, 90deg] | line 11.*is not X,Y,YAW
gate: "11.0,10.4,0" => gate: [{9s}, 8.0, 90deg] | line 11.*is not X,Y,YAW
reserve: 20 % => reserve: '20' | line 26.*reserve: give 0 to 0.99 \(write a percentage with its
reserve: 20 % => reserve: 5 kWh | line 26.*above the battery's capacity
reserve: 20 % => reserve: 95 % | line 26.*not below the state of charge
order: free => order: random | line 24.*'given' or 'free'
until: 90 % => until: 10 % | line 23.*not above the reserve
power: 200 W => power: 0 | line 23.*power: give 0.1 to 1e\+06 W, not '0'
power: 200 W => power: 1e9 W | line 23.*power: give 0.1 to 1e\+06 W, not '1e9 W'
power: 0.1 kW => power: 1e9 | line 16.*power: give 0 to 1e\+06 W, not '1e9'
dwell: 5 min => dwell: {mean: 5 min} | line 15.*mean and std, or low and high
dwell: 5 min => dwell: {mean: 5 min, std: -1} | line 15.*negative spread
dwell: 5 min => dwell: {low: 5 min, high: 4 min} | line 15.*negative spread
dwell: 5 min => dwell: {mean: .nan, std: 1} | line 15.*no mean
dwell: 5 min => dwell: {mean: {9s}, std: 1} | line 15.*give a number
dwell: 5 min => dwell: [5, 6] | line 15.*give a number
+payload_models:\n  quadriga:empty:mud: {64: quadriga:full:concrete}\n | line 28, payload_models
""",
    "mission of a service": r"""
warehouse.yaml => ../m.yaml | line 3, map: .*leaves the file's folder
warehouse_surfaces => ../s | line 4, surfaces: .*leaves the file's folder
quadriga:empty:concrete => ../it.yaml | line 2, model: .*leaves the file's folder
quadriga:empty:concrete => /etc/it.yaml | line 2, model: .*leaves the file's folder
quadriga:empty:concrete => a/../../it.yml | line 2, model: .*leaves the file's folder
+vehicle: ../it.yaml\n | line 27, vehicle: .*leaves the file's folder
+heights: ../h.yaml\n | line 27, heights: .*leaves the file's folder
""",
    "log": r"""
=x,y,yaw\n0,0,0\n1,0,0\n | energyplan check reads it
= | is empty
=\n | is empty
+ | no row follows the names of the columns
+0,1,1,5\n | 1 usable samples
=0,1,1,5\n1,1,1,5\n | line 1 holds numbers
=t;v_left;v_right;power\n0;1;1;5\n | 1 usable samples
=t,v_left,v_left,power\n0,1,1,5\n | 'v_left' twice
=t,v_left,power\n0,1,5\n1,1,5\n | 'v_right' is missing
=t,v_left,v_right\n0,1,5\n1,1,5\n | power is missing
+0,1,1,5\n1,1,oops,5\n | line 3: 'v_right' is 'oops'
+0,1,1,5\n1,1,1,5\n\n0.5,1,1,5\n | line 5: t does not increase
+0,1,1,5\n1,1,1,5\n1,1,1,6\n | line 4: t does not increase
+0,1,1,5,9\n1,1,1,5,9\n | more cells
+0,1,1,5\n1,1,1,5,9\n | in line 3
+0,1,1,"5\n | no table
=\xff\xfe\x00 | save it as UTF-8
+0,1,\xff,5\n | line 2: 'v_right' is
=t,v_left\n\x81,1\n | byte 9 is no UTF-8
=t\x00,v_left\n | NUL
+0,30,1,5\n1,30,1,5\n2,30,1,5\n | line 2, line 3, line 4: v_left is 30 m/s
+0,1,1,5\n60,1,1,5\n120,1,1,5\n | time step of t is 60 s
""",
    "packed log": r"""
=PAR1 this is nothing of the kind | it.csv.gz
""",
    "parquet": r"""
=PAR1 this is nothing of the kind | it.parquet
""",
    "text": r"""
=PAR1 this is nothing of the kind | it.txt
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
    text = change.encode().decode("unicode_escape").replace("{9s}", "9" * 400)
    old, _, new = text.partition(" =>")
    if text[0] == "@":
        return kind, drawn(text[1:]), words
    if text[0] not in "+=":
        assert old in KINDS[kind].right, line
        return kind, KINDS[kind].right.replace(old, new.removeprefix(" "), 1), words
    return kind, KINDS[kind].right * (text[0] == "+") + text[1:], words


REPEATS = "a0: &a0 [x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 9)}]\n" for k in range(1, 12)
)
MERGES = "b0: &b0 {x: 1, y: 2}\n" + "".join(
    f"b{k}: &b{k} {{<<: [{','.join([f'*b{k - 1}'] * 9)}]}}\n" for k in range(1, 10)
)
"""Half a kilobyte of YAML that stands for 9^9 values and more."""
CASES = [
    *(changed(kind, line) for kind, table in TABLES.items() for line in table.split("\n")[1:-1]),
    ("surfaces", "[" * 100_000, "JSON"),
    ("mission", MISSION.partition("tasks:")[0] + "tasks: []\n", "line 12, tasks"),
    (
        "surfaces",
        drawn("POLYGON ((0 0, 1 0, 1 1, 0 0)); model=x").replace("1.0", "1e999"),
        "feat.* 0",
    ),
    ("vehicle", REPEATS, "too many values"),
    ("map", MERGES + HEADER, r"m\.yaml, line \d+: too many values"),
    ("vehicle", "name: " + "x" * (1 << 20), "larger than 1024 KiB"),
    ("vehicle", "a: " + "[" * 5000, "nested too deeply|too deep|no valid YAML"),
]


@pytest.mark.parametrize(("kind", "text", "words"), CASES)
def test_a_malformed_file_is_refused_with_its_place(
    tmp_path: Path, kind: str, text: str, words: str
) -> None:
    read, name, _, error = KINDS[kind]
    Image.fromarray(np.zeros((2, 2), np.uint8)).save(tmp_path / "m.png")
    (tmp_path / "m.yaml").write_text(HEADER)
    (tmp_path / name).write_bytes(text.encode("latin-1"))
    with pytest.raises(error, match=words) as caught:
        read(tmp_path / name)
    assert name in str(caught.value)
    assert "\n" not in str(caught.value)


READERS = [read_mission, read_vehicle, read_model, read_log, read_map, read_site, read_heights]


@pytest.mark.parametrize("read", READERS)
@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("absent.yaml", "absent.yaml|unknown type"),
        ("x" * 5000, "x"),
        ("é" * 200 + ".yaml", "é"),
        ("a\0b.yaml", "b.yaml"),
        ("x" * 300 + ".bag", "x"),
    ],
)
def test_what_is_no_file_is_refused_by_its_name(
    read: Callable[[str], object], name: str, words: str
) -> None:
    with pytest.raises(errors.InvalidInputError, match=words):
        read(name)


def test_a_file_of_another_encoding_is_named_with_its_line(tmp_path):
    file = tmp_path / "robot.yaml"
    file.write_bytes("preset: jackal\nname: Gerät\n".encode("latin-1"))
    with pytest.raises(
        errors.InvalidInputError, match=r"robot\.yaml, line 2 is not in UTF-8; save the"
    ):
        read_vehicle(file)
    file.write_bytes("preset: jackal\nname: Gerät\n".encode("utf-16"))
    assert read_vehicle(file).name == "Gerät"


@pytest.mark.parametrize("name", ["no.ulg", "no.bin", "no.tlog"])
def test_a_log_that_is_not_there_is_said_to_be_so(tmp_path, name):
    with pytest.raises(errors.InvalidInputError, match=f"{name} cannot be read: No such file"):
        read_flight(tmp_path / name)
