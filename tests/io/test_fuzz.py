"""Malformed input: every reader and every command ends in a result or in a named error.

The suite tries a few inputs for each; ``ENERGYPLAN_FUZZ=100000`` in the environment tries that
many, drawn anew in each run. What counts as an answer is told in `fuzzing`; of a command also that
its message is one line.
"""

from __future__ import annotations

import contextlib
import functools
import importlib.metadata
import json
import os
import sys
from collections.abc import Callable, Iterator

import pytest
from commands import Result, Run
from fuzzing import (
    IMAGES,
    READERS,
    STEP,
    TRIED,
    assert_answered,
    assert_no_nan,
    broken,
    folder,
    place_of,
    within_a_minute,
    within_memory,
)
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

import energyplan as ep
from energyplan.errors import EnergyPlanError
from energyplan.path import parse_pose

MANY = int(os.environ.get("ENERGYPLAN_FUZZ", "0"))
SCRIPTS = st.integers(1, 4).flatmap(lambda n: st.binary(min_size=n * STEP, max_size=n * STEP))


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


@pytest.fixture(autouse=True)
def count_inputs(record_property: Callable[[str, object], None]) -> Iterator[None]:
    """Tell the test's report how many inputs were tried."""
    TRIED.clear()
    yield
    record_property("inputs", TRIED["inputs"])


@pytest.mark.parametrize("name", READERS)
def test_readers_refuse_by_name(name: str) -> None:
    read, text = READERS[name]
    with place_of(name) as place:
        found = read(place.read)
        assert found is not None
        if name in IMAGES:
            assert found.shape == (24, 40)
        sound = place.content.read_bytes()

        @fuzzed(25)
        @given(SCRIPTS.map(lambda script: broken(sound, script, text)))
        def attack(content: bytes) -> None:
            place.content.write_bytes(content)
            with within_a_minute():
                assert_answered(read, place.read)

        attack()


# -- commands -----------------------------------------------------------------------------------


@pytest.fixture
def at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Spare a command run many times in one process what a process does once.

    The packages that are installed are not searched anew for plugins.
    """
    search = functools.cache(importlib.metadata.entry_points)
    for module in [m for n, m in sys.modules.items() if n.startswith("energyplan.")]:
        if getattr(module, "entry_points", None) is importlib.metadata.entry_points:
            monkeypatch.setattr(module, "entry_points", search)


def assert_told(result: Result) -> None:
    """Hold a command to an answer, or to an error whose last line names what is wrong."""
    assert result.code in (0, 1, 2, 3)
    assert "Traceback" not in result.err
    if result.code in (1, 2):
        assert result.out == ""
        assert result.err.rstrip("\n").splitlines()[-1].startswith("energyplan: "), result.err


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
        "start": ((where("log.csv"), "--json"), ("log.csv",)),
    }  # fmt: skip


COUNTS = {"identify": 15, "diagnose": 6, "plan": 12, "compare": 6, "check": 20, "mission": 12,
          "start": 20}  # fmt: skip


@pytest.mark.parametrize("name", COUNTS)
@pytest.mark.usefixtures("at_once")
def test_commands_refuse_by_name(name: str, run: Run) -> None:
    arguments, files = commands()[name]
    # too little time to be sure of a plan on any machine; a short log may leave something untold
    found = run(name, *("2" if word == "0.01" else word for word in arguments))
    assert found.code in (0, 2), found.err
    with contextlib.ExitStack() as stack:
        places = {file: stack.enter_context(place_of(file)).content for file in files}
        sound = {file: place.read_bytes() for file, place in places.items()}

        @fuzzed(COUNTS[name])
        @given(
            st.sampled_from(files).flatmap(
                lambda file: SCRIPTS.map(
                    lambda script: (file, broken(sound[file], script, READERS[file][1]))
                )
            )
        )
        def attack(case: tuple[str, bytes]) -> None:
            file, content = case
            places[file].write_bytes(content)
            try:
                with within_a_minute(), within_memory():
                    result = run(name, *arguments)
                assert_told(result)
                if result.code in (0, 3):
                    document = json.loads(result.out)  # strict: `--json` never prints NaN
                    for key in ("energy", "length", "lower_bound_steady", "saving"):
                        assert document.get(key, 0.0) is not None or document.get("tasks"), key
                    if document.get("lower_bound", 0.0) is None:
                        assert any("no gap" in note for note in document["notes"])
            finally:
                places[file].write_bytes(sound[file])

        attack()


WORDS = ("--json", "--strict", "--map", "--model", "--start", "--goal", "--vehicle", "--columns",
         "--planner", "--objective", "--time-limit", "--method", "--holdout", "--surfaces", "",
         "nan", "-1", "1e999", "0,0,0", "nan,0,0", "1e308,1e308,1e308", "quadriga", "jackal",
         "quadriga:full:marble", "energy", "fmt", "huber", "v_left=", "=", "a=b[c", "power=x[W]",
         ".", "/", "/dev/null", "\0", "é", "--", "x" * 5000)  # fmt: skip


@pytest.mark.usefixtures("at_once")
@fuzzed(35)
@given(
    st.sampled_from(sorted(COUNTS)),
    st.lists(st.one_of(st.sampled_from(WORDS), st.text(max_size=8)), max_size=6),
    st.lists(st.integers(0, 12), max_size=3),
)
def test_arguments_are_refused_by_name(
    run: Run, name: str, extra: list[str], places: list[int]
) -> None:
    """Words of a sound command line replaced or added; what would write a file is left out."""
    if name == "diagnose":
        name = "identify"  # the same arguments, in a tenth of the time
    arguments = list(commands()[name][0])
    for word, place in zip(extra, places, strict=False):
        arguments[place % len(arguments)] = word
    arguments += extra[len(places) :]
    if any(word.startswith(("--o", "--pl", "--r", "--h")) for word in arguments):
        return
    with within_a_minute(), within_memory():
        result = run(name, *arguments)
    assert_told(result)


@fuzzed(100)
@given(st.text(max_size=40))
def test_column_maps_and_poses_are_refused_by_name(text: str) -> None:
    with within_memory(), contextlib.suppress(EnergyPlanError):
        ep.DriveLog.read(folder() / "log.csv", columns=text)
    with contextlib.suppress(EnergyPlanError):
        assert_no_nan(tuple(parse_pose(text)))
