"""Heights of the ground from the files that geographic tools and elevation mappers write."""

from __future__ import annotations

import numpy as np
import pytest
from PIL import Image, TiffImagePlugin
from small_bags import Recorder, heading

from energyplan.errors import MapError
from energyplan.io.heights import read_heights

DEFINITIONS = {
    "grid_map_msgs/msg/GridMapInfo": """
float64 resolution
float64 length_x
float64 length_y
geometry_msgs/Pose pose
""",
    "grid_map_msgs/msg/GridMap": """
std_msgs/Header header
grid_map_msgs/GridMapInfo info
string[] layers
string[] basic_layers
std_msgs/Float32MultiArray[] data
uint16 outer_start_index
uint16 inner_start_index
""",
}

ASC = "ncols 3\nnrows 2\nxllcorner 10\nyllcorner 20\ncellsize 2\nNODATA_value -9999\n1 2 3\n4 5 6\n"


def test_esri_grids(tmp_path):
    file = tmp_path / "h.asc"
    file.write_text(ASC)
    ground = read_heights(file)
    # the lower left value stands one metre from the corner either way
    assert ground.height((11, 21)) == 4.0
    assert ground.height((15, 23)) == 3.0
    file.write_text(ASC.replace("corner", "center"))
    assert read_heights(file).height((10, 20)) == 4.0
    file.write_text(ASC.replace("1 2 3", "1 -9999 3"))
    with pytest.raises(MapError, match="1 cells without data, the first in row 1, column 2"):
        read_heights(file)
    file.write_text(ASC.replace("1 2 3", "1 -99 3").replace("NODATA_value -9999\n", ""))
    assert read_heights(file).height((13, 23)) == -99.0


HILL = np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 7.0]])
SCALE, TIE_POINT, TRANSFORM, GEO_KEYS, NO_DATA = 33550, 33922, 34264, 34735, 42113
DOUBLES, TEXTS = 34736, 34737


def geotiff(file, values, tags, **options):
    info = TiffImagePlugin.ImageFileDirectory_v2()
    for tag, value in tags.items():
        info.tagtype[tag] = {GEO_KEYS: 3, NO_DATA: 2, TEXTS: 2}.get(tag, 12)
        info[tag] = value
    Image.fromarray(values).save(file, tiffinfo=info, **options)


def keys(**values):
    names = {"model": 1024, "raster": 1025, "linear": 3076, "vertical": 4099,
             "projected": 3072, "system": 4096, "size": 3077, "citation": 3073,
             "system_citation": 4097}  # fmt: skip
    places = {"size": (DOUBLES, 1), "citation": (TEXTS, 40), "system_citation": (TEXTS, 40)}
    rows = [(names[name], *places.get(name, (0, 1)), value) for name, value in values.items()]
    return tuple(np.array([(1, 1, 0, len(rows)), *rows]).ravel().tolist())


@pytest.mark.parametrize("compression", [None, "tiff_lzw", "tiff_adobe_deflate"])
@pytest.mark.parametrize("kind", [np.float32, np.uint16, np.int32])
def test_geotiff(tmp_path, compression, kind):
    file = tmp_path / "h.tif"
    tags = {SCALE: (2.0, 2.0, 0.0), TIE_POINT: (0.0, 0.0, 0.0, 10.0, 24.0, 0.0)}
    area = {**tags, GEO_KEYS: keys(model=1, raster=1, linear=9001)}
    geotiff(file, HILL.astype(kind), area, compression=compression)
    ground = read_heights(file)
    # as the ASCII grid of the same corner: the first value is at the upper left
    np.testing.assert_allclose(ground.heights, HILL[::-1])
    assert (ground.height((11, 21)), ground.height((15, 23))) == (4.0, 3.0)
    geotiff(file, HILL.astype(kind), {**tags, GEO_KEYS: keys(model=1, raster=2)})
    assert read_heights(file).height((10, 24)) == 1.0  # the points themselves
    # the values of a key may stand in another tag, where its number is a place and no unit
    area[GEO_KEYS] = (1, 1, 0, 2, 1024, 0, 1, 1, 3076, 34736, 1, 0)
    geotiff(file, HILL.astype(kind), area)
    np.testing.assert_array_equal(read_heights(file).heights, HILL[::-1])


def test_a_turned_geotiff(tmp_path):
    c, s = 2 * np.cos(0.3), 2 * np.sin(0.3)
    turned = (c, s, 0, 5.0, s, -c, 0, 6.0, 0, 0, 0, 0, 0, 0, 0, 1)
    geotiff(tmp_path / "h.tif", HILL.astype(np.float32), {TRANSFORM: turned})
    ground = read_heights(tmp_path / "h.tif")
    for row, column in np.ndindex(HILL.shape):
        x = 5.0 + (column + 0.5) * c + (row + 0.5) * s
        y = 6.0 + (column + 0.5) * s - (row + 0.5) * c
        assert ground.height((x, y)) == pytest.approx(HILL[row, column], abs=1e-9)


@pytest.mark.parametrize(
    ("tags", "told"),
    [
        ({GEO_KEYS: keys(model=2)}, "degrees of longitude"),
        ({SCALE: (0.0003, 0.0003, 0.0)}, "degrees of longitude"),
        ({SCALE: (2.0, 3.0, 0.0)}, "cells of 2 by 3"),
        ({GEO_KEYS: keys(model=1, linear=9030)}, "the unit 9030 of EPSG"),
        ({GEO_KEYS: keys(model=1, vertical=9101)}, "the unit 9101 of EPSG"),
        ({GEO_KEYS: keys(model=1, linear=9002)}, "nothing says whether its heights"),
        ({GEO_KEYS: keys(model=1, projected=2277)}, "EPSG:2277 alone"),
        ({GEO_KEYS: keys(model=1, projected=3857)}, "Mercator of web maps"),
        ({GEO_KEYS: keys(model=1, system=6358)}, "heights are of EPSG:6358"),
        ({NO_DATA: "5"}, "1 cells without data, the first in row 2, column 2"),
        ({TIE_POINT: None}, "does not say where it lies"),
    ],
)
def test_geotiffs_that_are_no_heights_in_metres(tmp_path, tags, told):
    usual = {SCALE: (2.0, 2.0, 0.0), TIE_POINT: (0.0, 0.0, 0.0, 10.0, 24.0, 0.0)}
    given = {tag: value for tag, value in {**usual, **tags}.items() if value is not None}
    geotiff(tmp_path / "h.tif", HILL.astype(np.float32), given)
    with pytest.raises(MapError, match=told):
        read_heights(tmp_path / "h.tif")


FOOT, SURVEY_FOOT = 0.3048, 1200 / 3937


@pytest.mark.parametrize(
    ("given", "more", "across", "up"),
    [
        ({"projected": 32633}, {}, 1.0, 1.0),
        ({"projected": 25832, "system": 5773}, {}, 1.0, 1.0),
        ({"projected": 26910, "system": 6360}, {}, 1.0, SURVEY_FOOT),
        ({"projected": 32719, "vertical": 9002}, {}, 1.0, FOOT),
        ({"projected": 2277, "linear": 9003, "system": 8228}, {}, SURVEY_FOOT, FOOT),
        ({"linear": 32767, "size": 0, "vertical": 9001}, {DOUBLES: (0.9144,)}, 0.9144, 1.0),
        (
            {"projected": 32767, "citation": 0, "system_citation": 40},
            {TEXTS: f"{'NAD_1983_StatePlane_Texas_Feet|':40}{'NAVD88 - Geoid12B (ftUS)|':40}"},
            FOOT, SURVEY_FOOT,
        ),
    ],
)  # fmt: skip
def test_a_geotiff_in_the_unit_that_its_keys_say(tmp_path, given, more, across, up):
    tags = {SCALE: (2.0, 2.0, 0.0), TIE_POINT: (0.0, 0.0, 0.0, 10.0, 24.0, 0.0)}
    tags |= {GEO_KEYS: keys(model=1, raster=1, **given), **more}
    geotiff(tmp_path / "h.tif", HILL.astype(np.float32), tags)
    ground = read_heights(tmp_path / "h.tif")
    np.testing.assert_allclose(ground.heights, up * HILL[::-1], rtol=1e-12)
    assert ground.resolution == pytest.approx(2.0 * across, rel=1e-12)
    at = (11 * across, 21 * across)
    assert ground.height(at) == pytest.approx(4.0 * up, rel=1e-9)


METRIC = {
    "WGS 84 / UTM north": (32601, 32660), "WGS 84 / UTM south": (32701, 32760),
    "ETRS89 / UTM": (25828, 25838), "NAD83 / UTM": (26901, 26923),
    "NAD83(2011) / UTM": (6328, 6348), "GDA94 / MGA": (28348, 28358),
    "GDA2020 / MGA": (7846, 7859), "SIRGAS 2000 / UTM": (31965, 31985),
    "ETRS89 / LAEA and LCC Europe": (3034, 3035), "RGF93 / CC42 to CC50": (3942, 3950),
    "Lambert-93": (2154, 2154), "British National Grid": (27700, 27700),
}  # fmt: skip
"""First and last codes of EPSG of projections in metres."""


@pytest.mark.parametrize("name", METRIC)
def test_projections_in_metres_are_known_from_the_first_to_the_last_zone(tmp_path, name):
    tags = {SCALE: (2.0, 2.0, 0.0), TIE_POINT: (0.0, 0.0, 0.0, 10.0, 24.0, 0.0)}
    first, last = METRIC[name]
    file = tmp_path / "h.tif"
    for code in {first, last}:
        geotiff(file, HILL.astype(np.float32), tags | {GEO_KEYS: keys(model=1, projected=code)})
        assert read_heights(file).resolution == 2.0
    for code in (first - 1, last + 1):
        geotiff(file, HILL.astype(np.float32), tags | {GEO_KEYS: keys(model=1, projected=code)})
        with pytest.raises(MapError, match=f"EPSG:{code} alone"):
            read_heights(file)


def test_vertical_systems_in_metres_are_known(tmp_path):
    tags = {SCALE: (2.0, 2.0, 0.0), TIE_POINT: (0.0, 0.0, 0.0, 10.0, 24.0, 0.0)}
    file = tmp_path / "h.tif"
    for code in (
        3855,
        5621,
        5701,
        5703,
        5705,
        5709,
        5714,
        5720,
        5728,
        5730,
        5773,
        5776,
        5783,
        7837,
    ):
        given = keys(model=1, projected=32633, system=code)
        geotiff(file, HILL.astype(np.float32), tags | {GEO_KEYS: given})
        np.testing.assert_array_equal(read_heights(file).heights, HILL[::-1])


@pytest.mark.parametrize("value", [-9999.0, -32768.0, 3.4e38])
def test_heights_that_no_ground_has(tmp_path, value):
    (tmp_path / "h.asc").write_text(ASC.replace("-9999", "-1").replace("5", f"{value:g}"))
    with pytest.raises(MapError, match=r"1 cells of heights that no ground has.*row 2, column 2"):
        read_heights(tmp_path / "h.asc")


def test_a_png_of_16_bits_by_its_yaml(tmp_path):
    values = np.array([[0, 65535, 13107], [26214, 39321, 52428]], np.uint16)
    Image.fromarray(values).save(tmp_path / "hill.png")
    file = tmp_path / "hill.yaml"
    file.write_text(
        "image: hill.png\nresolution: 0.5\norigin: [1, 2, 0]\nmin_height: -1\nmax_height: 4\n"
    )
    ground = read_heights(file)
    np.testing.assert_allclose(ground.heights, [[1, 2, 3], [-1, 4, 0]], atol=1e-9)
    assert ground.height((1.25, 2.25)) == pytest.approx(1.0)
    whole = file.read_text()
    file.write_text(whole.replace("min_height: -1", "").replace("max_height: 4", "max_height: far"))
    with pytest.raises(MapError, match=r"hill\.yaml.*min_height: this key is missing"):
        read_heights(file)
    file.write_text(whole)
    with pytest.raises(MapError, match="give a YAML file with image, resolution"):
        read_heights(tmp_path / "hill.png")
    Image.fromarray(np.uint8(values >> 8)).save(tmp_path / "hill.png")
    with pytest.raises(MapError, match=r"steps of 0\.02 m"):
        read_heights(file)


@pytest.mark.parametrize("form", ["sqlite", "mcap"])
def test_a_grid_map_in_a_bag(tmp_path, form):
    """Each cell stands where grid_map puts it: rows against x, columns against y, in a ring."""
    pytest.importorskip("rosbags", reason="bags need the extra bags")
    rows, columns, size, yaw, start = 4, 3, 0.5, 0.4, (1, 2)
    cells = np.arange(12.0).reshape(rows, columns)
    ring = np.roll(cells, start, (0, 1)).astype(np.float32)
    holes = ring.copy()
    holes[0, 0] = np.nan
    pose = {"position": {"x": 3.0, "y": 4.0}, "orientation": heading(yaw)}
    dims = [
        {"label": label, "size": count, "stride": stride}
        for label, count, stride in (("column_index", 3, 12), ("row_index", 4, 4))
    ]
    with Recorder(tmp_path / "bag", form, DEFINITIONS) as bag:
        bag.write(
            "/elevation_map", "grid_map_msgs/msg/GridMap", 1.0,
            info={"resolution": size, "length_x": rows * size, "length_y": columns * size,
                  "pose": pose},
            layers=["elevation", "elevation_smooth"], basic_layers=["elevation"],
            data=[{"layout": {"dim": dims}, "data": values.T.ravel()} for values in (ring, holes)],
            outer_start_index=start[0], inner_start_index=start[1],
        )  # fmt: skip
    ground = read_heights(tmp_path / "bag")
    for row, column in np.ndindex(rows, columns):
        ahead = 0.5 * rows * size - (row + 0.5) * size
        left = 0.5 * columns * size - (column + 0.5) * size
        x = 3.0 + np.cos(yaw) * ahead - np.sin(yaw) * left
        y = 4.0 + np.sin(yaw) * ahead + np.cos(yaw) * left
        assert ground.height((x, y)) == pytest.approx(cells[row, column], abs=1e-6)


@pytest.mark.parametrize(
    ("given", "odd"), [("xllcorner 10", "xllcorner 5 %"), ("cellsize 2", "cellsize 1_0"),
                       ("4 5 6", "4 1_000 6")]
)  # fmt: skip
def test_text_that_is_no_number_of_an_esri_grid_is_refused(tmp_path, given, odd):
    file = tmp_path / "h.asc"
    file.write_text(ASC.replace(given, odd))
    with pytest.raises(MapError, match=r"h\.asc, line \d"):
        read_heights(file)
