"""Units of a GeoTIFF (OGC 19-008r4): metres of its coordinates, and metres of its heights."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from energyplan.errors import MapError
from energyplan.units import LENGTH

KEYS, DOUBLES, TEXTS, METADATA = 34735, 34736, 34737, 42112
"""Tags of a TIFF: the directory of keys, its numbers and texts, and the metadata of GDAL."""

MODEL, RASTER = 1024, 1025
_CITATION, _PROJECTED, _PROJECTED_CITATION, _LINEAR, _LINEAR_SIZE = 1026, 3072, 3073, 3076, 3077
_VERTICAL, _VERTICAL_CITATION, _VERTICAL_UNITS = 4096, 4097, 4099
_BY_USER = 32767

_FOOT, _SURVEY_FOOT = LENGTH["ft"], 1200 / 3937
_OF_CODE = {9001: 1.0, 9002: _FOOT, 9003: _SURVEY_FOOT, 9036: 1000.0}
"""Metres of the units of length by their code of EPSG."""

_METRIC = (
    (25828, 25838), (26901, 26923), (28348, 28358), (31965, 31985), (32601, 32660), (32701, 32760),
    (3034, 3035), (3040, 3051), (3942, 3950), (6328, 6348), (7846, 7859), (2056, 2056),
    (2154, 2154), (2180, 2180), (2193, 2193), (27700, 27700), (28992, 28992), (31370, 31370),
)  # fmt: skip
"""First and last codes of projections of EPSG with axes in metres: UTM and national grids."""

_STRETCHED = (3857, 3785, 900913)
"""Mercator of web maps: its metres are those of the ground at the equator alone."""

_VERTICAL_METRES = {
    **dict.fromkeys((3855, 5621, 5701, 5703, 5705, 5709, 5714, 5720, 5728, 5730, 5773, 5776, 5783,
                     7837, 7839, 9389), 1.0),
    **dict.fromkeys((5702, 6360), _SURVEY_FOOT), 8228: _FOOT,
}  # fmt: skip
"""Metres of the unit of heights by the code of a vertical system of EPSG."""

_SURVEY = re.compile(r"us[-_ ]*(survey[-_ ]*)?(ft|foot|feet)|(ft|foot|feet)[-_ ]*us", re.I)
_FEET = re.compile(r"(?<![a-z])(ft|foot|feet)(?![a-z])", re.I)

_ITEM = re.compile(r'<Item\b(?=[^>]*\brole="(scale|offset|unittype)")[^>]*>([^<]*)<')
_SAID = {
    **dict.fromkeys(("m", "metre", "meter", "metres", "meters"), 1.0), "dm": 0.1, "cm": 0.01,
    "mm": 0.001, "km": 1000.0, **dict.fromkeys(("ft", "foot", "feet"), _FOOT),
    **dict.fromkeys(("us-ft", "ftus", "us survey foot"), _SURVEY_FOOT),
}  # fmt: skip
"""Metres of the units in which heights are said to be, in GDAL's metadata."""

_REMEDY = "convert the file to metres, as with gdalwarp -t_srs EPSG:326.. (UTM)"


class RasterUnits(NamedTuple):
    """What a GeoTIFF counts in."""

    across: float  # metres of a unit of its coordinates
    up: float  # metres of a unit of its heights, as they are when scaled
    scale: float  # of its values
    offset: float  # of its scaled values, in its unit


def keys_of(tags: Mapping[int, Any]) -> dict[int, int | float | str]:
    """Return the keys of a GeoTIFF with their values, wherever these are written."""
    rows = np.array(tags.get(KEYS, (1, 1, 0, 0)), int).reshape(-1, 4)[1:]
    numbers = np.atleast_1d(np.array(tags.get(DOUBLES, ()), float))
    text = str(tags.get(TEXTS, ""))
    found: dict[int, int | float | str] = {}
    for key, place, count, value in rows.tolist():
        if place == 0:
            found[key] = value
        elif place == DOUBLES and value < len(numbers):
            found[key] = float(numbers[value])
        elif place == TEXTS:
            found[key] = text[value : value + count].rstrip("|\0 ")
    return found


def _of_text(text: str) -> float | None:
    """Return the metres of the unit that a citation names, None where it names no feet."""
    if _SURVEY.search(text):
        return _SURVEY_FOOT
    return _FOOT if _FEET.search(text) else None


def _across(file: Path, keys: Mapping[int, Any]) -> float:
    """Return the metres of a unit of the coordinates."""
    code, unit = keys.get(_PROJECTED, _BY_USER), keys.get(_LINEAR)
    if code in _STRETCHED:
        raise MapError(
            f"{file}: EPSG:{code} is the Mercator of web maps, whose metres are longer than those "
            f"of the ground away from the equator; {_REMEDY}"
        )
    if unit is not None and unit != _BY_USER:
        if unit not in _OF_CODE:
            raise MapError(f"{file}: the unit {unit} of EPSG; {_REMEDY}")
        return _OF_CODE[unit]
    if _LINEAR_SIZE in keys:
        size = float(keys[_LINEAR_SIZE])
        if not (np.isfinite(size) and size > 0):
            raise MapError(f"{file}: a unit of {size} m; {_REMEDY}")
        return size
    if code != _BY_USER:
        if any(first <= code <= last for first, last in _METRIC):
            return 1.0
        raise MapError(
            f"{file}: its projection is known as EPSG:{code} alone, and no key says in which unit "
            f"its coordinates are; {_REMEDY}"
        )
    return _of_text(f"{keys.get(_PROJECTED_CITATION, '')} {keys.get(_CITATION, '')}") or 1.0


def _up(file: Path, keys: Mapping[int, Any], said: str, across: float) -> float:
    """Return the metres of a unit of the heights."""
    if said in _SAID:
        return _SAID[said]
    unit, code = keys.get(_VERTICAL_UNITS, _BY_USER), keys.get(_VERTICAL, _BY_USER)
    if unit != _BY_USER:
        if unit not in _OF_CODE:
            raise MapError(f"{file}: heights in the unit {unit} of EPSG; {_REMEDY}")
        return _OF_CODE[unit]
    if code != _BY_USER:
        if code not in _VERTICAL_METRES:
            raise MapError(
                f"{file}: its heights are of EPSG:{code}, and no key says in which unit; write "
                "VerticalUnitsGeoKey, 9001 for metres"
            )
        return _VERTICAL_METRES[code]
    by_text = _of_text(str(keys.get(_VERTICAL_CITATION, "")))
    if by_text is None and across != 1.0:
        raise MapError(
            f"{file}: a unit of its coordinates is {across:.6g} m, and nothing says whether its "
            "heights are in that unit or in metres; write VerticalUnitsGeoKey: 9001 for metres, "
            "9002 for feet, 9003 for US survey feet"
        )
    return by_text or 1.0


def units(file: Path, tags: Mapping[int, Any]) -> RasterUnits:
    """Return what a GeoTIFF counts in; refuse what nothing says."""
    keys = keys_of(tags)
    scaling = dict(_ITEM.findall(str(tags.get(METADATA, ""))))
    said = scaling.get("unittype", "").strip().lower()
    try:
        scale, offset = float(scaling.get("scale", 1.0)), float(scaling.get("offset", 0.0))
    except ValueError:
        scale = offset = np.nan
    if not np.isfinite(scale + offset) or (said and said not in _SAID):
        raise MapError(f"{file}: heights of {scaling}; convert them to metres")
    across = _across(file, keys)
    return RasterUnits(across, _up(file, keys, said, across), scale, offset)
