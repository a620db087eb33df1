"""Sound files for `test_fuzz`, how they are broken, and what counts as an answer.

An answer is a result without a NaN or a named error. What is none: any other exception, a warning
of NumPy's, more than a minute or more than half a gigabyte for one input.
"""

from __future__ import annotations

import atexit
import contextlib
import functools
import gzip
import json
import os
import re
import resource
import shutil
import signal
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any, NamedTuple

import networkx as nx
import numpy as np
import pandas as pd
from PIL import Image, TiffImagePlugin
from small_bags import TOPICS, record

import energyplan as ep
from energyplan import simulate
from energyplan.errors import EnergyPlanError
from energyplan.export.graph import read_route_graph, write_route_graph
from energyplan.io.bags import TopicMap
from energyplan.io.config import read_model, read_vehicle, write_model, write_vehicle
from energyplan.io.geojson import read_surfaces
from energyplan.io.heights import read_heights
from energyplan.io.husky import read_husky
from energyplan.io.logs import read_log
from energyplan.io.maps import read_map, write_map
from energyplan.io.mission import read_battery, read_mission
from energyplan.io.tables import (
    read_path,
    read_trajectory,
    write_log,
    write_path,
    write_trajectory,
)
from energyplan.path import Path as Route
from energyplan.path import Pose
from energyplan.power import HOTEL, PowerModel

PATIENCE = 60  # processor seconds after which an input counts as a hang
MEMORY = 1 << 29  # bytes that one input may take at its peak
ADDRESSES = 1 << 33  # bytes that one input may ask the system for; a reader may ask and not use
TRIED: Counter[str] = Counter()
"""How many inputs were tried, under ``"inputs"``."""

TOKENS = tuple(
    word.encode()
    for word in (
        "", " ", "0", "-0", "-1", "1", "2", "1e308", "-1e308", "1e-320", "1e999", "nan", "NaN",
        ".nan", "inf", "-inf", ".inf", "null", "~", "true", "[]", "{}", "''", "a", "é", "\0", "\n",
        ",", ":", "- ", "#", '"', "&a [*a]", "*a", "<<", "!!python/object:os.system x", "../../x",
        "/etc/passwd", "99999999999999999999", "0x10", "1_000", "12:30:00", "2001-01-01", "90deg",
        "5 %", "3 h", "t", "power", "x", "\ufeff", "\u2028", "9" * 400, "[" * 60,
    )
)  # fmt: skip
"""What replaces a word: the edges of numbers, YAML, JSON and file names."""

STEP = 9
"""Bytes of a script that one edit takes."""

_WORD = re.compile(rb"[\w.+-]+")
_EDITS = {
    True: ("word", "word", "word", "cut", "double", "byte", "end"),
    False: ("byte", "byte", "cut", "double", "end"),
}


def broken(data: bytes, script: bytes, text: bool) -> bytes:
    """A file with a few edits: words replaced, bytes changed, parts cut or doubled, an early end.

    The script tells them, `STEP` bytes each: what, where, and how much or what instead. It is drawn
    at once, which takes a tenth of the time of drawing each of its parts.
    """
    kinds = _EDITS[text]
    for k in range(0, len(script) - STEP + 1, STEP):
        what, place, how = script[k], script[k + 1 : k + 4], script[k + 4 : k + STEP]
        edit = kinds[what % len(kinds)]
        at = int.from_bytes(place) % (len(data) + 1)
        if edit == "word" and (found := _WORD.search(data, at)):
            data = data[: found.start()] + TOKENS[how[0] % len(TOKENS)] + data[found.end() :]
        elif edit == "byte":
            data = data[:at] + how[1 : 2 + how[0] % 4] + data[at + 1 :]
        elif edit == "end":
            data = data[:at]
        else:
            length = 1 + how[0] % 200
            part, rest = data[at : at + length], data[at + length :]
            data = data[:at] + (part + part if edit == "double" else b"") + rest
    return data


# -- what counts as an answer -------------------------------------------------------------------


@contextlib.contextmanager
def within_a_minute() -> Iterator[None]:
    """Fail after a minute of the processor's, which a busy machine does not shorten."""

    def hang(*_: object) -> None:
        raise AssertionError(f"no answer within {PATIENCE} s of processor time")

    before = signal.signal(signal.SIGPROF, hang)
    signal.setitimer(signal.ITIMER_PROF, PATIENCE)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)


def _peak() -> int:
    """Return the most memory held since the mark was last lowered [byte]."""
    status = Path("/proc/self/status")
    if status.exists() and (found := re.search(r"VmHWM:\s*(\d+) kB", status.read_text())):
        return int(found[1]) * 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


def _lower_the_mark() -> None:
    """Have the high-water mark of memory begin at what is held now, where the system can."""
    with contextlib.suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")


@contextlib.contextmanager
def within_memory() -> Iterator[None]:
    """Hold one input to what it may take; the system stops it before the machine suffers."""
    TRIED["inputs"] += 1
    _lower_the_mark()
    limits, before = resource.getrlimit(resource.RLIMIT_AS), _peak()
    statm = Path("/proc/self/statm")
    if statm.exists():
        used = int(statm.read_bytes().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (used + ADDRESSES, limits[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, limits)
    taken = _peak() - before
    assert taken <= MEMORY, f"one input took {taken >> 20} MiB at its peak"


def assert_no_nan(value: Any, place: str = "result") -> None:
    """Look through a result for numbers that are none."""
    if isinstance(value, float | np.floating):
        assert value == value, f"{place} is NaN"
    elif isinstance(value, np.ndarray):
        if value.dtype.kind == "f":
            assert not np.isnan(value).any(), f"{place} holds NaN"
    elif isinstance(value, Mapping):
        for key, item in value.items():
            assert_no_nan(item, f"{place}.{key}")
    elif isinstance(value, list | tuple):
        for k, item in enumerate(value):
            assert_no_nan(item, f"{place}[{k}]")
    elif is_dataclass(value) and not isinstance(value, type):
        for item in fields(value):
            assert_no_nan(getattr(value, item.name), f"{place}.{item.name}")


def assert_answered(read: Callable[[Path], Any], file: Path) -> None:
    """Hold a reader to a result without NaN, or to a named error that says something."""
    try:
        with within_memory():
            found = read(file)
    except EnergyPlanError as error:
        assert str(error), "an error without a message"
        return
    assert_no_nan(found)


# -- sound files to start from ------------------------------------------------------------------

MODEL = PowerModel.preset("quadriga:empty:concrete")


@functools.cache
def folder() -> Path:
    """A folder with a sound file of each kind, small so that an input takes little time."""
    memory = Path("/dev/shm")  # files in memory, where the system has such a folder
    place = Path(
        tempfile.mkdtemp(
            prefix="energyplan-fuzz-", dir=memory if os.access(memory, os.W_OK) else None
        )
    )
    atexit.register(shutil.rmtree, place, ignore_errors=True)
    log = simulate.drive(MODEL, "spiral", power_noise=5.0, speed_noise=0.002, rate=5.0, seed=1)
    write_log(log.segment(0.0, 40.0), place / "log.csv")
    pd.DataFrame(dict(log.segment(0.0, 5.0).channels)).to_parquet(place / "log.parquet")
    (place / "log.csv.gz").write_bytes(gzip.compress((place / "log.csv").read_bytes()[:3000]))
    husky = np.column_stack([log.t, 1 + 0 * log.t, 1 + 0 * log.t, *(
        log.channel(name) for name in ("v_left", "v_right"))])[:60]  # fmt: skip
    np.savetxt(place / "pro_01.csv", husky, delimiter=",", header="time,curL,curR,velL,velR",
               comments="", fmt="%.4f")  # fmt: skip
    route = Route(Pose(0.6, 0.6, 0.0), ds=[0.4, 0.2], dtheta=[0.0, 0.5])
    write_path(route, place / "path.csv")
    write_trajectory(ep.speed.profile(route, MODEL), place / "trajectory.csv")
    write_vehicle(MODEL.vehicle, place / "vehicle.yaml")
    (place / "preset.yaml").write_text("preset: jackal\nmass: 20\nmotor: {speed: 1.5}\n")
    write_model(MODEL.with_term(HOTEL, 20.0), place / "model.yaml")
    free = np.ones((24, 40), bool)
    free[1:-1, 1:-1] = False
    free[10:14, 18:22] = True
    write_map(ep.OccupancyGrid(free, resolution=0.1), place / "map.yaml")
    pixels = np.where(free, 0, 254).astype(np.uint8)
    Image.fromarray(pixels).save(place / "map.pgm")
    Image.fromarray(pixels).save(place / "map.bmp")
    (place / "square.map").write_text("type octile\nheight 3\nwidth 4\nmap\n....\n.@@.\n....\n")
    square = [[[0, 0], [2, 0], [2, 2], [0, 2], [0, 0]]]
    (place / "surfaces.geojson").write_text(json.dumps({"type": "FeatureCollection", "features": [
        {"type": "Feature", "properties": {"model": "quadriga:empty:marble"},
         "geometry": {"type": "Polygon", "coordinates": square}}]}))  # fmt: skip
    graph = nx.MultiDiGraph()
    graph.add_nodes_from([(0, {"pos": (0.0, 0.0)}), (1, {"pos": (1.0, 1.0)})])
    graph.add_edge(0, 1, key=2)
    write_route_graph(graph, place / "graph.geojson")
    (place / "heights.asc").write_text(
        "ncols 3\nnrows 2\nxllcorner 0\nyllcorner 0\ncellsize 1.0\nNODATA_value -9999\n"
        "0 0.1 0.2\n0 0.1 0.3\n"
    )
    tags = TiffImagePlugin.ImageFileDirectory_v2()
    for tag, value in {33550: (1.0, 1.0, 0.0), 33922: (0.0, 0.0, 0.0, 0.0, 2.0, 0.0)}.items():
        tags.tagtype[tag] = 12
        tags[tag] = value
    Image.fromarray(np.float32([[0.0, 0.1, 0.2], [0.0, 0.1, 0.3]])).save(
        place / "heights.tif", tiffinfo=tags, compression="tiff_lzw"
    )
    (place / "topics.yaml").write_text(
        "kind: topics\nname: mine\nchannels:\n  v_left: {topic: joint_states, field: 'velocity[0]',"
        " scale: 0.2}\n  v_right:\n    - {topic: joint_states, field: 'velocity[*right*]'}\n"
    )
    (place / "mission.yaml").write_text(
        "name: round\nmodel: quadriga:empty:concrete\nmap: map.yaml\nsurfaces: surfaces.geojson\n"
        "battery: {preset: quadriga, health: 80 %}\nsoc: 90 %\nreserve: 20 %\nconfidence: 95 %\n"
        "order: given\nstart: [0.7, 0.7, 0]\ntasks:\n  - name: post\n"
        "    pose: [3.2, 0.7, 90deg]\n    dwell: 2 min\n    power: 15 W\n"
    )
    (place / "battery.yaml").write_text(
        "chemistry: agm\nseries: 2\nparallel: 1\nunit_capacity: 20 Ah\ntemperature: -5\n"
        "soc_points: [0, 1]\nocv_points: [23, 26]\nmin_charge_temperature: -10\n"
    )
    (place / "fleet.yaml").write_text(
        (place / "mission.yaml").read_text().replace("power: 15 W", "power: {mean: 15, std: 2 W}")
        + "    needs: [mop]\n    window: [0, 1 h]\n    payload: 500 g\n"
        "places: {dock: '0.7,0.7,0'}\n"
        "chargers: [{name: dock, pose: dock, power: 200, until: 90 %, places: 2}]\n"
        "waiting: {low: 1, high: 3 s}\nspeed: cheapest\nspreads: {run: 5 %}\n"
        "robots: [{name: a, skills: [mop], speed: 0.5}, {name: b, skills: [mop], soc: 80 %}]\n"
    )
    for name, kind in BAGS.items():
        record(place / name, kind)
    return place


BAGS = {
    "plain.bag": "ros1", "bz2.bag": "ros1-bz2", "lz4.bag": "ros1-lz4", "plain": "mcap",
    "zstd": "mcap-zstd", "lz4": "mcap-lz4", "file": "sqlite", "messages": "sqlite-message",
}  # fmt: skip
"""Small bags, and the kind of each."""


def file_of_kind(name: str) -> Path:
    """Find a sound file; those of ROS 2 bags lie in folders of their own."""
    return next(folder().rglob(name))


def read_bag_file(file: Path) -> Any:
    return read_log(file, topics=TOPICS)


READERS: dict[str, tuple[Callable[[Path], Any], bool]] = {
    "log.csv": (read_log, True),
    "log.csv.gz": (read_log, False),
    "log.parquet": (read_log, False),
    "pro_01.csv": (read_husky, True),
    "path.csv": (read_path, True),
    "trajectory.csv": (read_trajectory, True),
    "vehicle.yaml": (read_vehicle, True),
    "preset.yaml": (read_vehicle, True),
    "model.yaml": (read_model, True),
    "mission.yaml": (read_mission, True),
    "fleet.yaml": (read_mission, True),
    "battery.yaml": (read_battery, True),
    "topics.yaml": (TopicMap.read, True),
    "map.yaml": (read_map, True),
    "map.pgm": (read_map, False),
    "map.bmp": (read_map, False),
    "map.png": (read_map, False),
    "square.map": (read_map, True),
    "surfaces.geojson": (read_surfaces, True),
    "graph.geojson": (read_route_graph, True),
    "heights.asc": (read_heights, True),
    "heights.tif": (read_heights, False),
    "plain.bag": (read_bag_file, False),
    "bz2.bag": (read_bag_file, False),
    "lz4.bag": (read_bag_file, False),
    "plain.mcap": (read_bag_file, False),
    "zstd.mcap": (read_bag_file, False),
    "lz4.mcap": (read_bag_file, False),
    "file.db3": (read_bag_file, False),
    "messages.db3": (lambda file: read_bag_file(file.parent), False),
    "messages/metadata.yaml": (lambda file: read_bag_file(file.parent), True),
}
"""Reader of each file, and whether the file is text."""

IMAGES = ("map.pgm", "map.bmp", "map.png")


class Place(NamedTuple):
    """Where an input goes, and what is read then."""

    content: Path
    read: Path


@contextlib.contextmanager
def place_of(name: str) -> Iterator[Place]:
    """Tell where inputs for a reader go; its sound file is put back at the end.

    An image is read through the map that names it, which does so meanwhile.
    """
    file = file_of_kind(name)
    changed = {file: file.read_bytes()}
    read = file
    if name in IMAGES:
        read = folder() / "map.yaml"
        changed[read] = read.read_bytes()
        read.write_bytes(changed[read].replace(b"map.png", name.encode()))
    try:
        yield Place(file, read)
    finally:
        for path, sound in changed.items():
            path.write_bytes(sound)
