"""Malformed input: every reader and every command ends in a result or in a named error.

The suite tries a few inputs for each; ``ENERGYPLAN_FUZZ=100000`` in the environment tries that
many, drawn anew in each run. What counts as a failure: any other exception, a warning of NumPy's, a
NaN in a result, more than a minute for one input, and for a command a message that is not one line.
"""

from __future__ import annotations

import contextlib
import functools
import gzip
import io
import json
import os
import re
import signal
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import networkx as nx
import numpy as np
import pandas as pd
import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st
from PIL import Image

import energyplan as ep
from energyplan import cli, simulate
from energyplan.errors import EnergyPlanError
from energyplan.io.config import read_model, read_vehicle, write_model, write_vehicle
from energyplan.io.geojson import read_surfaces
from energyplan.io.heights import read_heights
from energyplan.io.husky import read_husky
from energyplan.io.logs import describe_log, read_log
from energyplan.io.maps import read_map, write_map
from energyplan.io.mission import read_mission
from energyplan.io.route_graph import read_route_graph, write_route_graph
from energyplan.io.topics import TopicMap
from energyplan.io.trajectory import (
    read_path,
    read_trajectory,
    write_log,
    write_path,
    write_trajectory,
)
from energyplan.path import Path as Route
from energyplan.path import Pose
from energyplan.power import HOTEL, PowerModel

MANY = int(os.environ.get("ENERGYPLAN_FUZZ", "0"))
PATIENCE = 60  # seconds after which an input counts as a hang

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

_WORD = re.compile(rb"[\w.+-]+")


@st.composite
def broken(draw: st.DrawFn, seeds: Sequence[bytes], text: bool) -> bytes:
    """A sound file with a few edits: words replaced, bytes flipped, parts cut, doubled or moved."""
    data = draw(st.sampled_from(seeds))
    edits = ("word", "word", "word", "cut", "double", "byte", "end") if text else (
        "byte", "byte", "cut", "double", "end")  # fmt: skip
    for _ in range(draw(st.integers(1, 4))):
        place = draw(st.integers(0, len(data)))
        edit = draw(st.sampled_from(edits))
        if edit == "word" and (found := _WORD.search(data, place)):
            data = data[: found.start()] + draw(st.sampled_from(TOKENS)) + data[found.end() :]
        elif edit == "byte":
            data = data[:place] + draw(st.binary(min_size=1, max_size=4)) + data[place + 1 :]
        elif edit == "end":
            data = data[:place]
        else:
            length = draw(st.integers(1, 200))
            part = data[place : place + length]
            rest = data[place + length :]
            data = data[:place] + (part + part if edit == "double" else b"") + rest
    return data


def fuzzed(count: int) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Run a test on `count` inputs, always the same, or on as many as the environment asks for."""
    return settings(
        max_examples=MANY or count,
        derandomize=not MANY,
        database=None,
        deadline=None,  # hangs are seen by `within_a_minute`; nothing else is timed
        phases=(Phase.generate, Phase.shrink) if MANY else (Phase.generate,),
        suppress_health_check=list(HealthCheck),
    )


@contextlib.contextmanager
def within_a_minute() -> Iterator[None]:
    def hang(*_: object) -> None:
        raise AssertionError(f"no answer within {PATIENCE} s")

    before = signal.signal(signal.SIGALRM, hang)
    signal.alarm(PATIENCE)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


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


# -- sound files to start from ------------------------------------------------------------------

MODEL = PowerModel.preset("quadriga:empty:concrete")


@functools.cache
def folder() -> Path:
    """A folder with a sound file of each kind, small so that an input takes little time."""
    place = Path(tempfile.mkdtemp(prefix="energyplan-fuzz-"))
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
    (place / "bag").mkdir()
    _record(place / "bag")
    return place


def _record(place: Path) -> None:
    """Write a bag of each kind with two joints' speeds."""
    from rosbags.rosbag1 import Writer as Writer1
    from rosbags.rosbag2 import StoragePlugin
    from rosbags.rosbag2 import Writer as Writer2
    from rosbags.typesys import Stores, get_typestore

    kind = "sensor_msgs/msg/JointState"
    for name in ("one.bag", "two", "three"):
        first = name.endswith(".bag")
        store = get_typestore(Stores.ROS1_NOETIC if first else Stores.ROS2_HUMBLE)
        plugin = StoragePlugin.MCAP if name == "two" else StoragePlugin.SQLITE3
        with (
            Writer1(place / name)
            if first
            else Writer2(place / name, version=9, storage_plugin=plugin)
        ) as bag:
            topic = bag.add_connection("/joint_states", kind, typestore=store)
            for k in range(20):
                stamp = store.types["builtin_interfaces/msg/Time"](sec=5, nanosec=k * 10**7)
                header = store.types["std_msgs/msg/Header"](
                    stamp=stamp, frame_id="", **({"seq": k} if first else {})
                )
                message = store.types[kind](
                    header=header, name=["left", "right"], position=np.zeros(0),
                    effort=np.ones(2), velocity=np.array([1.0, 1.0]),
                )  # fmt: skip
                dump = store.serialize_ros1 if first else store.serialize_cdr
                bag.write(topic, 5 * 10**9 + k * 10**7, dump(message, kind))


def _file_of_kind(name: str) -> Path:
    """A file that bears a suffix for its reader: bags lie in folders of their own."""
    return next(folder().rglob(name)) if "*" in name else folder() / name


BAG_TOPICS = TopicMap.model_validate(
    {
        "channels": {
            "v_left": {"topic": "joint_states", "field": "velocity[left]"},
            "v_right": {"topic": "joint_states", "field": "velocity[right]"},
            "power": {"topic": "joint_states", "field": "effort[0]"},
        }
    }
)


def read_bag_file(file: Path) -> Any:
    return describe_log(file), read_log(file, topics=BAG_TOPICS)


READERS: dict[str, tuple[Callable[[Path], Any], bool]] = {
    "log.csv": (lambda file: (describe_log(file), read_log(file)), True),
    "log.csv.gz": (read_log, False),
    "log.parquet": (read_log, False),
    "pro_01.csv": (read_husky, True),
    "path.csv": (read_path, True),
    "trajectory.csv": (read_trajectory, True),
    "vehicle.yaml": (read_vehicle, True),
    "preset.yaml": (read_vehicle, True),
    "model.yaml": (read_model, True),
    "mission.yaml": (read_mission, True),
    "topics.yaml": (TopicMap.read, True),
    "map.yaml": (read_map, True),
    "map.pgm": (read_map, False),
    "map.bmp": (read_map, False),
    "map.png": (read_map, False),
    "square.map": (read_map, True),
    "surfaces.geojson": (read_surfaces, True),
    "graph.geojson": (read_route_graph, True),
    "heights.asc": (read_heights, True),
    "one*.bag": (read_bag_file, False),
    "*.mcap": (read_bag_file, False),
    "*.db3": (read_bag_file, False),
}
"""Reader of each file, and whether the file is text."""


@contextlib.contextmanager
def replaced(name: str, content: bytes) -> Iterator[Path]:
    """Put other content into a file of a copy of the folder, as long as a test looks at it."""
    file = _file_of_kind(name)
    sound = file.read_bytes()
    file.write_bytes(content)
    try:
        yield file
    finally:
        file.write_bytes(sound)


@pytest.mark.parametrize("name", READERS)
def test_readers_take_sound_files(name: str) -> None:
    read, _ = READERS[name]
    if name in ("map.pgm", "map.bmp"):
        text = (folder() / "map.yaml").read_bytes().replace(b"map.png", name.encode())
        with replaced("map.yaml", text) as file:
            assert read(file).shape == (24, 40)
    else:
        file = folder() / "map.yaml" if name == "map.png" else _file_of_kind(name)
        assert read(file) is not None


@pytest.mark.parametrize("name", READERS)
def test_readers_refuse_by_name(name: str) -> None:
    read, text = READERS[name]
    header = (folder() / "map.yaml").read_bytes()
    image = name in ("map.pgm", "map.bmp", "map.png")

    @fuzzed(40)
    @given(broken([_file_of_kind(name).read_bytes()], text))
    def attack(content: bytes) -> None:
        with contextlib.ExitStack() as stack:
            file = stack.enter_context(replaced(name, content))
            if image:
                named = header.replace(b"map.png", name.encode())
                file = stack.enter_context(replaced("map.yaml", named))
            stack.enter_context(within_a_minute())
            try:
                found = read(file)
            except EnergyPlanError as error:
                assert str(error)
                return
        assert_no_nan(found)

    attack()


# -- commands -----------------------------------------------------------------------------------


def command(*arguments: object) -> tuple[int, str, str]:
    """Run a command in this process; return its exit code, and what it printed."""
    out, err, argv = io.StringIO(), io.StringIO(), sys.argv
    sys.argv = ["energyplan", *(str(a) for a in arguments)]
    try:
        with (
            contextlib.redirect_stdout(out),
            contextlib.redirect_stderr(err),
            pytest.raises(SystemExit) as left,
        ):
            cli.main()
    finally:
        sys.argv = argv
    return int(left.value.code or 0), out.getvalue(), err.getvalue()


def assert_answered(result: tuple[int, str, str]) -> None:
    code, out, err = result
    assert code in (0, 1, 2, 3)
    if code in (1, 2):
        assert out == ""
        last = err.rstrip("\n").splitlines()[-1]
        assert last.startswith("energyplan: "), err
    else:
        document = json.loads(out)  # strict: `--json` never prints NaN
        for key in ("energy", "length", "lower_bound", "saving"):
            assert document.get(key, 0.0) is not None or document.get("tasks"), key


def where(name: str) -> str:
    return str(folder() / name)


def commands() -> dict[str, tuple[tuple[str, ...], tuple[str, ...]]]:
    """Arguments of each command, and which of its files are broken."""
    plan = ("--map", where("map.yaml"), "--model", where("model.yaml"), "--surfaces",
            where("surfaces.geojson"), "--start", "0.7,0.7,0", "--goal", "3.2,0.7,90deg",
            "--time-limit", "0.01", "--json")  # fmt: skip
    return {
        "identify": (
            (where("log.csv"), "--vehicle", where("vehicle.yaml"), "--json"),
            ("log.csv", "vehicle.yaml"),
        ),
        "diagnose": (
            (where("log.csv"), "--holdout", where("log.csv"), "--vehicle", where("vehicle.yaml"),
             "--json"),
            ("log.csv", "vehicle.yaml"),
        ),
        "plan": (plan, ("map.yaml", "map.png", "model.yaml", "surfaces.geojson")),
        "compare": (plan, ("map.yaml", "map.png", "model.yaml", "surfaces.geojson")),
        "check": (
            (where("trajectory.csv"), "--model", where("model.yaml"), "--vehicle",
             where("vehicle.yaml"), "--json"),
            ("trajectory.csv", "model.yaml", "vehicle.yaml"),
        ),
        "mission": ((where("mission.yaml"), "--json"), ("mission.yaml", "map.yaml")),
        "log": (("info", where("log.csv"), "--json"), ("log.csv",)),
    }  # fmt: skip


COUNTS = {"identify": 30, "diagnose": 12, "plan": 25, "compare": 12, "check": 40, "mission": 25,
          "log": 40}  # fmt: skip


@pytest.mark.parametrize("name", COUNTS)
def test_commands_take_sound_files(name: str) -> None:
    hasty = commands()[name][0]  # too little time to be sure of a plan on any machine
    result = command(name, *("2" if word == "0.01" else word for word in hasty))
    assert result[0] in (0, 2), result  # a short log may leave something untold
    assert_answered(result)


@pytest.mark.parametrize("name", COUNTS)
def test_commands_refuse_by_name(name: str) -> None:
    arguments, files = commands()[name]

    @fuzzed(COUNTS[name])
    @given(st.data())
    def attack(data: st.DataObject) -> None:
        file = data.draw(st.sampled_from(files))
        text = READERS[file][1]
        content = data.draw(broken([(folder() / file).read_bytes()], text))
        with replaced(file, content), within_a_minute():
            assert_answered(command(name, *arguments))

    attack()


WORDS = ("--json", "--strict", "--map", "--model", "--start", "--goal", "--vehicle", "--columns",
         "--planner", "--objective", "--time-limit", "--method", "--holdout", "--surfaces", "",
         "nan", "-1", "1e999", "0,0,0", "nan,0,0", "1e308,1e308,1e308", "quadriga", "jackal",
         "quadriga:full:marble", "energy", "fmt", "huber", "v_left=", "=", "a=b[c", "power=x[W]",
         ".", "/", "/dev/null", "\0", "é", "--", "info", "x" * 5000)  # fmt: skip


@fuzzed(70)
@given(
    st.sampled_from(sorted(COUNTS)),
    st.lists(st.one_of(st.sampled_from(WORDS), st.text(max_size=8)), max_size=6),
    st.lists(st.integers(0, 12), max_size=3),
)
def test_arguments_are_refused_by_name(name: str, extra: list[str], places: list[int]) -> None:
    """Words of a sound command line replaced or added; what would write a file is left out."""
    if name == "diagnose":
        name = "identify"  # the same arguments, in a tenth of the time
    arguments = list(commands()[name][0])
    for word, place in zip(extra, places, strict=False):
        arguments[place % len(arguments)] = word
    arguments += extra[len(places) :]
    if any(word.startswith(("--o", "--pl", "--r", "--h")) for word in arguments):
        return
    with within_a_minute():
        code, out, err = command(name, *arguments)
    assert code in (0, 1, 2, 3)
    if code in (1, 2):
        assert out == ""
        assert err.rstrip("\n").splitlines()[-1].startswith("energyplan: ")
    assert "Traceback" not in err


@fuzzed(100)
@given(st.text(max_size=40))
def test_column_maps_and_poses_are_refused_by_name(text: str) -> None:
    with contextlib.suppress(EnergyPlanError):
        ep.DriveLog.read(folder() / "log.csv", columns=text)
    with contextlib.suppress(EnergyPlanError):
        assert_no_nan(tuple(cli._pose(text)))
