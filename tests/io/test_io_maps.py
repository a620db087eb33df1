"""Map files: what they mean, and that hostile ones are refused by name."""

from __future__ import annotations

import io
import itertools
import math
import os
import struct
import tracemalloc
import zlib
from dataclasses import replace
from fractions import Fraction
from functools import partial
from math import floor
from threading import Thread

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from PIL import Image
from test_bad_files import drawn

from energyplan.battery import Battery
from energyplan.cost import EnergyCost
from energyplan.errors import ConfigError, InvalidInputError, MapError, UnusualValueWarning
from energyplan.io.documents import read_json
from energyplan.io.geojson import read_surfaces, write_surfaces
from energyplan.io.heights import read_heights
from energyplan.io.logs import read_log
from energyplan.io.maps import at_most, read_map, write_map, write_map_of_image
from energyplan.io.sites import read_site
from energyplan.mission import Mission, Task
from energyplan.path import Pose
from energyplan.planning import PlanningProblem
from energyplan.power import PowerModel
from energyplan.terrain import CostMap, OccupancyGrid, Site, Surface, SurfaceMap

HEADER = {
    "image": "m.png",
    "resolution": 0.1,
    "origin": [1.0, -2.0, 0.5],
    "negate": 0,
    "occupied_thresh": 0.65,
    "free_thresh": 0.25,
}


def write(folder, pixels, image="m.png", mode=None, **header):
    Image.fromarray(np.asarray(pixels), mode).save(folder / image)
    lines = {**HEADER, "image": image, **header}
    file = folder / "m.yaml"
    file.write_text("\n".join(f"{k}: {v}" for k, v in lines.items()))
    return file


def states(grid):
    """Return o, u or . for each cell, top row first, as one looks at the image."""
    unknown = np.zeros(grid.shape, bool) if grid.unknown is None else grid.unknown
    letters = np.where(grid.occupied, "o", np.where(unknown, "u", "."))
    return ["".join(row) for row in letters[::-1]]


LEVELS = np.arange(256, dtype=np.uint8).reshape(16, 16)


def saved(pixels, mode=None, **options):
    """Return the bytes of an image file, PNG unless named otherwise."""
    stream = io.BytesIO()
    Image.fromarray(np.asarray(pixels), mode).save(stream, **{"format": "PNG", **options})
    return stream.getvalue()


def paletted(**options):
    image = Image.fromarray(LEVELS[::-1].copy(), "P")
    image.putpalette([255 - k // 3 for k in range(768)])  # colours stand in reverse
    stream = io.BytesIO()
    image.save(stream, "PNG", **options)
    return stream.getvalue()


def plain_pgm(top):
    rows = "\n".join(" ".join(str(int(v) * top // 255) for v in row) for row in LEVELS)
    return f"P2\n# drawn by hand\n16 16\n{top}\n{rows}\n".encode()


SOLID = np.full((16, 16), 255, np.uint8)
VEIL = np.where(np.indices((16, 16)).sum(axis=0) % 3 == 0, 254, 255).astype(np.uint8)
BITS = np.where(LEVELS > 127, 255, 0).astype(np.uint8)
GREY = [LEVELS] * 3
FORMATS = {
    "8 bit": (saved(LEVELS), GREY, SOLID),
    "16 bit": (saved(LEVELS.astype(np.uint16) * 257), GREY, SOLID),
    "RGB": (saved(np.stack(GREY, 2)), GREY, SOLID),
    "opaque RGBA": (saved(np.stack([*GREY, SOLID], 2)), GREY, SOLID),
    "RGBA": (saved(np.stack([*GREY, VEIL], 2)), GREY, VEIL),
    "grey and alpha": (saved(np.stack([LEVELS, VEIL], 2)), GREY, VEIL),
    "palette": (paletted(), [255 - LEVELS[::-1]] * 3, SOLID),
    "palette with a clear colour": (
        paletted(transparency=7), [255 - LEVELS[::-1]] * 3, np.where(LEVELS[::-1] == 7, 0, 255),
    ),
    "grey with a clear shade": (
        saved(LEVELS, transparency=7), GREY, np.where(LEVELS == 7, 0, 255),
    ),
    "bit": (saved(BITS > 0), [BITS] * 3, SOLID),
    "BMP": (saved(LEVELS, format="BMP"), GREY, SOLID),
    "PGM P5": (saved(LEVELS, format="PPM"), GREY, SOLID),
    "PGM P2": (plain_pgm(255), GREY, SOLID),
    "PGM P2 of 16 bits": (plain_pgm(65535), GREY, SOLID),
    "colours": (
        saved(np.stack([LEVELS, LEVELS.T, LEVELS[::-1]], 2)), [LEVELS, LEVELS.T, LEVELS[::-1]],
        SOLID,
    ),
}  # fmt: skip


def map_servers_value(colour, alpha, mode, negate, occupied, free):
    """Return what map_server makes of a pixel: 0 to 100, -1 unknown.

    nav2_map_server/src/map_io.cpp, in exact numbers. Of a coloured pixel, grey is the mean in
    releases up to Jazzy and the luma since: the more occupied of the two is the safe one.
    """
    mean = round(Fraction(sum(colour), 3))
    luma = round(sum(f * c for f, c in zip((0.212656, 0.715158, 0.072186), colour, strict=True)))
    if mode == "raw":
        return mean if mean <= 100 else -1
    if alpha < 255:
        return -1
    shade = max(mean, luma) if negate else min(mean, luma)
    darkness = Fraction(shade if negate else 255 - shade, 255)
    high, low = Fraction(str(occupied)), Fraction(str(free))
    if darkness >= high:
        return 100
    if darkness <= low:
        return 0
    return (
        -1 if mode == "trinary" else floor((darkness - low) / (high - low) * 100 + Fraction(1, 2))
    )


@pytest.mark.parametrize("kind", FORMATS)
def test_every_mode_and_pixel_format_by_map_servers_rules(tmp_path, kind):
    content, colours, alpha = FORMATS[kind]
    (tmp_path / "m.png").write_bytes(content)
    file = tmp_path / "m.yaml"
    clear = OccupancyGrid(np.zeros((16, 16), bool), 0.1, Pose(*HEADER["origin"]))
    pixels = list(zip(*(np.asarray(c).ravel().tolist() for c in (*colours, alpha)), strict=True))
    for mode, negate, (occupied, free) in itertools.product(
        ("trinary", "Scale", "RAW"),
        (0, 1, "true"),
        ((0.65, 0.25), (0.65, 0.196), (1.0, 0.0), (0.9, 0.1), (0.4, 0.4)),
    ):
        told = {"mode": mode, "negate": negate, "occupied_thresh": occupied, "free_thresh": free}
        file.write_text("\n".join(f"{k}: {v}" for k, v in {**HEADER, **told}.items()))
        values = np.array([
            map_servers_value(colour, a, mode.lower(), bool(negate), occupied, free)
            for *colour, a in pixels
        ]).reshape(16, 16)  # fmt: skip
        most_free = 100 * free if mode == "RAW" else 0
        expected = np.where(
            values == 100, "o", np.where((values < 0) | (values > most_free), "u", ".")
        )
        grid = read_map(file)
        assert states(grid) == ["".join(row) for row in expected], told
        # as a keep-out mask: only 100 is lethal to Nav2's filter
        np.testing.assert_array_equal(clear.with_mask(grid).blocked[::-1], values == 100)


@pytest.mark.parametrize(
    ("mask", "why"),
    [
        (
            OccupancyGrid(np.eye(40, dtype=bool), 0.1, Pose(50.0, 0.0, 0.0)),
            "covers x from 50 to 54",
        ),
        (OccupancyGrid(np.zeros((40, 40), bool), 0.1), "none of its own is occupied"),
        (OccupancyGrid(np.arange(1600).reshape(40, 40) == 0, 0.1), "blocked already"),
        (OccupancyGrid(np.eye(40, dtype=bool), 0.1), None),
        (OccupancyGrid(np.eye(40, dtype=bool), 0.07, Pose(0.2, 0.1, 0.3)), None),
    ],
)
def test_a_mask_that_closes_no_cell_is_told(mask, why):
    cells = np.zeros((40, 40), bool)
    cells[0, 0] = True
    note = OccupancyGrid(cells, 0.1).note_of_mask(mask)
    assert note is None if why is None else "closes no cell" in note and why in note


def test_an_image_beside_the_map_may_be_named_by_its_whole_path(tmp_path):
    """As ROS 1's map_saver does."""
    file = write(tmp_path, np.zeros((2, 2), np.uint8))
    file.write_text(file.read_text().replace("image: m.png", f"image: {tmp_path / 'm.png'}"))
    assert read_map(file).occupied.all()


def test_unknown_is_free_on_request(tmp_path):
    file = write(tmp_path, np.full((3, 3), 128, np.uint8))
    assert read_map(file).blocked.all()
    assert not read_map(file, unknown_is_free=True).blocked.any()


def test_movingai(tmp_path):
    file = tmp_path / "a.map"
    file.write_text("type octile\nheight 2\nwidth 4\nmap\n.G@T\nSW.O\n")
    grid = read_map(file)
    assert states(grid) == ["..oo", ".o.o"]
    assert grid.resolution == 1.0


@pytest.mark.shared
@pytest.mark.parametrize("name", ["depot", "tb3_sandbox"])
def test_nav2_maps(shared_data, name):
    """Against a plain reading of the image with the formula of the map format."""
    folder = shared_data / "maps"
    grid = read_map(folder / f"{name}.yaml")
    pixels = np.asarray(Image.open(folder / f"{name}.pgm").convert("L"), float)[::-1]
    occupied = (255 - pixels) / 255 > 0.65
    assert np.array_equal(grid.occupied, occupied)
    if name == "depot":
        assert grid.shape == (307, 604)
        assert grid.size == pytest.approx((30.2, 15.35))
    else:
        assert grid.origin == Pose(-10.0, -10.0, 0.0)
        assert np.mean(grid.unknown) > 0.5


@pytest.mark.shared
def test_maps_and_masks_as_people_have_them(shared_data):
    field = shared_data / "field"
    with pytest.raises(MapError, match="occupied_thresh, free_thresh are missing"):
        read_map(field / "thresholds_missing" / "map.yaml")
    with pytest.raises(MapError, match="seems to be a building of Open-RMF"):
        read_map(field / "openrmf_building_as_map" / "site.building.yaml")
    file = field / "rgba_opaque_png"
    grey = np.asarray(Image.open(file / "map.png").convert("L"))
    assert np.array_equal(read_map(file / "map.yaml").unknown, grey[::-1] == 205)
    off, full = field / "keepout_off_the_map", field / "keepout_scale_full_range"
    note = read_map(off / "room.yaml").note_of_mask(read_map(off / "keepout.yaml"))
    assert "it covers x from -150 to -130 m" in note
    room = read_map(full / "room.yaml")
    shut = room.with_mask(read_map(full / "keepout.yaml")).blocked & ~room.blocked
    rows, columns = np.nonzero(shut)
    corners = room.to_world([(columns.min(), rows.min()), (columns.max() + 1, rows.max() + 1)])
    assert corners[:, 0] == pytest.approx([9.0, 11.0])
    assert corners[1, 1] == pytest.approx(6.0)


@settings(max_examples=30, deadline=None)
@given(st.integers(1, 12), st.integers(1, 12), st.integers(0, 2**32 - 1))
def test_maps_come_back_as_they_were_written(tmp_path_factory, rows, columns, seed):
    rng = np.random.default_rng(seed)
    occupied, unknown = rng.random((2, rows, columns)) < 0.3
    origin = Pose(*rng.normal(size=3))
    grid = OccupancyGrid(occupied, 0.05, origin, unknown=unknown & ~occupied)
    file = tmp_path_factory.mktemp("maps") / "m.yaml"
    write_map(grid, file)
    back = read_map(file)
    assert np.array_equal(back.occupied, grid.occupied)
    assert np.array_equal(back.unknown, grid.unknown)
    assert back.origin == grid.origin
    assert back.resolution == grid.resolution


# -- hostile files ----------------------------------------------------------------------------


def png_claiming(width, height):
    """Return a PNG whose header claims a size, with next to no data behind it."""

    def chunk(kind, body):
        return (
            struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))
        )

    head = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    data = zlib.compress(bytes(1 << 16), 9)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", data) + chunk(b"IEND", b"")


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("m.png", png_claiming(100_000, 100_000)),
        ("m.png", png_claiming(2**31 - 1, 2**31 - 1)),
        ("m.png", png_claiming(20_000, 20_000)),
        ("m.png", png_claiming(12_000, 9_000)),
        ("m.pgm", b"P5\n99999999 99999999\n255\n\0\0"),
    ],
)
def test_decompression_bombs_are_refused(tmp_path, name, content):
    file = write(tmp_path, np.zeros((2, 2), np.uint8), name)
    (tmp_path / name).write_bytes(content)
    with pytest.raises(MapError, match=rf"{name}.*(pixels|cells)"):
        read_map(file)


@pytest.mark.parametrize(
    "name", ["../m.png", "/etc/passwd", "a/../../m.png", "link.png", "..\\m.png"]
)
def test_images_outside_the_folder_are_refused(tmp_path, name):
    folder = tmp_path / "maps"
    folder.mkdir()
    file = write(folder, np.zeros((2, 2), np.uint8))
    write(tmp_path, np.zeros((2, 2), np.uint8))
    (folder / "link.png").symlink_to(tmp_path / "m.png")
    file.write_text(file.read_text().replace("m.png", f"'{name}'"))
    with pytest.raises(MapError, match="folder"):
        read_map(file)


def test_missing_and_strange_files(tmp_path):
    with pytest.raises(MapError, match="cannot be read"):
        read_map(tmp_path / "none.yaml")
    with pytest.raises(MapError, match="unknown kind"):
        read_map(tmp_path / "map.gif")
    (tmp_path / "folder.yaml").mkdir()
    with pytest.raises(MapError, match=r"is a folder; give the map's \.yaml in it"):
        read_map(tmp_path / "folder.yaml")
    with pytest.raises(MapError, match="cannot be read: embedded null"):
        read_map("a\0.yaml")


def test_json_of_any_size_is_refused_by_name(tmp_path):
    file = tmp_path / "report.json"
    file.write_text("[" + 200_000 * " " + "]")
    with pytest.raises(ConfigError, match=r"report\.json is larger than 128 KiB.*; give another"):
        read_json(file, 1 << 17, ConfigError, "give another")


# -- surfaces ---------------------------------------------------------------------------------


BOX = shapely.box(0, 0, 2, 1)


def test_surfaces(tmp_path):
    file = tmp_path / "s.geojson"
    own = PowerModel.preset("quadriga:full:marble")
    file.write_text(
        drawn(
            f"{BOX}; model=quadriga:empty:marble; surface=hall"
            f" & {shapely.MultiPolygon([BOX])}; surface=mine"
            f" & {shapely.box(5, 5, 6, 6)}; surface=keep-out"
        )
    )
    ground = read_surfaces(file, {"mine": own})
    assert [s.name for s in ground.surfaces] == ["hall", "mine"]
    assert ground.surfaces[0].model.coefficient("traction_resistance") == 90.0
    assert ground.surfaces[1].model is own
    assert ground.keep_out[0].bounds == (5, 5, 6, 6)
    assert [name for name, _ in ground.polygons] == ["hall", "mine", "keep-out"]


def test_surfaces_that_lie_beside_the_map_are_told():
    marble = PowerModel.preset("quadriga:full:marble")
    hall = OccupancyGrid(np.zeros((40, 40), bool), 0.1, Pose(10.0, 0.0, 0.0))
    inside = shapely.box(11, 1, 12, 2)
    assert SurfaceMap([Surface(inside, marble, "m")], [inside]).notes_on(hall) == ()
    (note,) = SurfaceMap([Surface(inside, marble, "m")], [BOX]).notes_on(hall)
    assert "none of the keep-out areas lies on the map" in note
    (note,) = SurfaceMap([Surface(BOX, marble, "m")]).notes_on(hall)
    assert "none of the surfaces lies on the map, which covers x from 10" in note


def test_surfaces_come_back_as_they_were_written(tmp_path):
    ring = shapely.Point(1, 2).buffer(3).difference(shapely.Point(1, 2).buffer(1))
    marble = PowerModel.preset("quadriga:full:marble")
    ground = SurfaceMap([Surface(ring, marble, "ring")], [BOX])
    write_surfaces(ground, tmp_path / "s.geojson")
    back = read_surfaces(tmp_path / "s.geojson")
    assert shapely.equals_exact(back.surfaces[0].area, ring, 1e-12)
    assert back.surfaces[0].model.name == marble.name
    assert back.surfaces[0].name == "ring"
    assert back.keep_out[0].equals(BOX)


def test_a_map_of_obstacles(tmp_path):
    file = tmp_path / "o.geojson"
    wall = shapely.LineString([(1, 1), (1, 3)])
    room = shapely.Polygon([(0, 0), (4, 0), (4, 4), (2, 4), (2, 3), (0, 3)])
    box = shapely.box(3, 1, 3.5, 2)
    file.write_text(drawn(f"{room}; kind=boundary & {wall} & {box}"))
    grid = read_map(file)
    assert grid.shape == (80, 80)
    centres = [(0.5, 0.5), (1.01, 2.0), (3.2, 1.5), (1.0, 3.5), (3.0, 3.5)]
    column, row = np.floor(grid.to_cells(centres)).astype(int).T
    assert grid.occupied[row, column].tolist() == [False, True, True, True, False]
    # whatever is not free of obstacles is occupied, and nothing two cells away from them
    free = shapely.transform(
        shapely.union_all(
            [shapely.box(c, r, c + 1, r + 1) for r, c in np.argwhere(~grid.occupied)]
        ),
        grid.to_world,
    )
    drivable = room.difference(box)
    assert free.difference(drivable).area < 1e-9
    assert drivable.difference(wall.buffer(0.1)).difference(free.buffer(0.08)).area < 1e-9


def test_degrees_are_told_from_metres_by_the_longer_side(tmp_path):
    file = tmp_path / "o.geojson"
    for area, told in (
        (shapely.box(0, 0, 5, 0.05), None),
        (shapely.box(0, 0, 0.05, 5), None),
        (shapely.box(8.1, 50.1, 8.1 + 9e-2, 50.1 + 1e-2), "reach over 0.09, as degrees"),
    ):
        file.write_text(drawn(f"{area}"))
        if told is None:
            assert read_map(file).occupied.all()
        else:
            with pytest.raises(MapError, match=told):
                read_map(file)


SITE = "map: m.yaml\nkeepout: m.yaml\nclearance: 20 cm\n"


def test_a_site_stands_for_its_parts(tmp_path):
    write(tmp_path, np.array([[254, 254], [254, 0]], np.uint8))
    (tmp_path / "sites").mkdir()
    file = tmp_path / "sites" / "yard.yaml"
    file.write_text(SITE.replace("m.yaml", "../m.yaml"))
    site = read_site(file)
    assert (site.clearance, site.surfaces, site.notes[0][:16]) == (0.2, None, "the keep-out mas")
    assert read_site(tmp_path / "m.yaml").grid.shape == (2, 2)
    open_hall = Site(OccupancyGrid(np.zeros((40, 60), bool), 0.1), clearance=0.3)
    mask = OccupancyGrid(np.ones((5, 5), bool), 0.1)
    cost = EnergyCost(PowerModel.preset("quadriga:empty:marble"))
    problem = PlanningProblem(replace(open_hall, keepout=mask), cost, (2, 2, 0), (4, 2, 0))
    closed = open_hall.map.with_mask(mask).occupied
    assert (problem.clearance, np.array_equal(problem.map.occupied, closed)) == (0.3, True)
    assert PlanningProblem(open_hall, cost, (2, 2, 0), (4, 2, 0), clearance=0.1).clearance == 0.1
    battery = Battery.preset("quadriga")
    tasks = [Task("look", (4, 2, 0))]
    soft = replace(open_hall, costmap=CostMap(np.zeros((40, 60)), 0.1))
    mission = Mission(cost.model, soft, battery, (2, 2, 0), tasks, confidence=0.5)
    assert (mission.clearance, "costmap" in mission.notes[0]) == (0.3, True)


def test_grey_weights_of_a_keep_out_mask_are_soft_costs(tmp_path):
    grey = np.array([[0, 0, 255, 255], [127, 127, 127, 255]], np.uint8)  # closed, half closed, free
    file = write(tmp_path, grey, occupied_thresh=1.0, free_thresh=0.0)
    (tmp_path / "map.yaml").write_text(file.read_text())
    file.write_text(file.read_text() + "\nmode: scale\n")
    (tmp_path / "site.yaml").write_text("map: map.yaml\nkeepout: m.yaml\n")
    site = read_site(tmp_path / "site.yaml")
    assert_array_equal(site.keepout.occupied, [[0, 0, 0, 0], [1, 1, 0, 0]])
    assert_allclose(site.costmap.costs, [[0.5, 0.5, 0.5, 0.0], [1.0, 1.0, 0.0, 0.0]], atol=0.005)
    (tmp_path / "site.yaml").write_text("map: map.yaml\nkeepout: m.yaml\ncostmap: m.yaml\n")
    with pytest.warns(UnusualValueWarning, match="weights of the keep-out mask are ignored"):
        read_site(tmp_path / "site.yaml")
    (tmp_path / "site.yaml").write_text("map: map.yaml\nclearance: 21\n")
    with pytest.raises(MapError, match="line 2, clearance: give 0 to 20 m, not '21"):
        read_site(tmp_path / "site.yaml")


@pytest.mark.parametrize("colours", [1, 3])
def test_a_map_takes_little_memory_beside_its_cells(tmp_path, colours, monkeypatch):
    """A small file holds many cells; 60 bytes for each would let two requests end a service."""
    monkeypatch.setattr("energyplan.io.maps.MAX_FILE", 2**20)  # as much is set aside to read it
    side = 1500
    file = write(tmp_path, np.full((side, side, 3)[: 1 + (colours > 1)], 254, np.uint8))
    read_map(file)
    tracemalloc.start()
    grid = read_map(file)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert not grid.occupied.any()
    assert peak < 14 * side**2 + 2**24


def test_a_service_reads_fewer_cells(tmp_path):
    file = write(tmp_path, np.zeros((20, 30), np.uint8))
    (tmp_path / "h.asc").write_text(
        "ncols 30\nnrows 20\nxllcorner 0\nyllcorner 0\ncellsize 1\n" + "0 " * 30 + "\n"
    )
    with at_most(599):
        for read, name in ((read_map, file), (read_heights, tmp_path / "h.asc")):
            with pytest.raises(MapError, match="20 rows of 30 cells; at most 599"):
                read(name)
    assert read_map(file).shape == (20, 30)


@pytest.mark.parametrize("name", ["m.yaml", "m.map", "m.geojson", "image", "h.asc", "log.csv",
                                  "log.csv.gz", "log.parquet", "log.bag", "log.mcap"])  # fmt: skip
def test_a_pipe_in_place_of_a_file_is_not_waited_for(tmp_path, name):
    """Nobody writes into it: whoever opened it would wait for ever."""
    if name == "image":
        file = write(tmp_path, np.zeros((4, 4), np.uint8))
        (tmp_path / "m.png").unlink()
        os.mkfifo(tmp_path / "m.png")
    else:
        file = tmp_path / name
        os.mkfifo(file)
    read = {"m": read_map, "h": read_heights}.get(name[0], read_map)
    if name.startswith("log"):
        read = partial(read_log, topics="husky")
    said = []

    def answer():
        with pytest.raises(InvalidInputError) as caught:
            read(file)
        said.append(str(caught.value))

    found = Thread(target=answer, daemon=True)
    found.start()
    found.join(60)
    assert said, "it waits"
    assert "regular file" in said[0] or "there is no 'm.png'" in said[0]


def drawn_yard(folder):
    """Write the image of a walled yard with a grey spot, 60 x 40 pixels."""
    pixels = np.full((40, 60, 3), 255, np.uint8)
    pixels[[0, -1]] = pixels[:, [0, -1]] = 0
    pixels[30:, 20:24] = 0
    pixels[5:10, 40:50] = 120
    Image.fromarray(pixels).save(folder / "yard.png")
    return folder / "yard.png"


def test_an_image_alone_is_a_map_by_the_size_of_its_pixels(tmp_path):
    image = drawn_yard(tmp_path)
    grid = read_map(image, resolution=0.1)
    assert grid.size == pytest.approx((6.0, 4.0))
    assert tuple(grid.origin) == (0.0, 0.0, 0.0)
    assert grid.occupied[5, 21]
    assert not grid.occupied[15, 21]
    assert grid.unknown is not None
    assert grid.unknown.sum() == 50
    cells = write_map_of_image(image, 0.1, tmp_path / "yard.yaml")
    for other in (cells, read_map(tmp_path / "yard.yaml")):
        assert_array_equal(other.occupied, grid.occupied)
        assert_array_equal(other.unknown, grid.unknown)
        assert (other.resolution, other.origin) == (grid.resolution, grid.origin)
    site = tmp_path / "site.yaml"
    site.write_text("map: yard.png\nresolution: 10 cm\nclearance: 0.1\n")
    assert_array_equal(read_site(site).grid.occupied, grid.occupied)


def test_an_image_alone_is_refused_with_what_is_missing(tmp_path):
    image = drawn_yard(tmp_path)
    with pytest.raises(MapError, match=r"give the size of a pixel .* energyplan start .*yard.png"):
        read_map(image)
    for size in (0.0, -1.0, math.nan, math.inf):
        with pytest.raises(MapError, match="give a positive size"):
            read_map(image, resolution=size)
    with pytest.raises(MapError, match=r"write the YAML of yard.png in its folder"):
        write_map_of_image(image, 0.1, tmp_path / "maps" / "yard.yaml")
    written = tmp_path / "yard.yaml"
    write_map_of_image(image, 0.1, written)
    with pytest.raises(MapError, match=r"give .*yard.yaml, which names it"):
        read_map(image)
    with pytest.raises(MapError, match="has a resolution of its own"):
        read_site(written, resolution=0.1)
    site = tmp_path / "site.yaml"
    site.write_text("map: yard.yaml\n")
    with pytest.raises(MapError, match="is a site; write its map's resolution there"):
        read_site(site, resolution=0.1)
    site.write_text("map: yard.png\nresolution: -1\n")
    with pytest.raises(MapError, match="line 2"):
        read_site(site)


def test_a_map_of_sixty_kilometres_is_doubted(tmp_path):
    image = drawn_yard(tmp_path)
    with pytest.warns(UnusualValueWarning, match=r"60 x 40 km") as found:
        read_map(image, resolution=1000.0)
    assert "check that its resolution, 1000, is in m" in str(found[0].message)
