"""Commands whose answers are kept beside this module: what each is asked, and how equal is equal.

The input is a folder with the bundled maps and examples, and drives, paths, a trajectory and a
route graph that `material` makes. What `plan` answers is kept in `plan.json`, less what depends on
the machine; of a list of more than a few numbers, its length, ends and sum.
"""

from __future__ import annotations

import contextvars
import io
import json
import math
import re
import shlex
import shutil
import sys
from collections.abc import Iterator
from contextlib import chdir, redirect_stderr, redirect_stdout
from fnmatch import fnmatch
from pathlib import Path
from typing import Any, NamedTuple

import energyplan as ep
from energyplan import cli, simulate
from energyplan.io.files import bundle
from energyplan.io.tables import write_log, write_path, write_trajectory
from energyplan.power import HOTEL

HERE = Path(__file__).parent
NUMBER = r"-?\d+(?:\.\d+)?(?:e[+-]?\d+)?"
DROPPED = {"planning_time", "seconds", "version"}
"""Keys whose values depend on the machine."""


class Tolerance(NamedTuple):
    """How much the numbers of an answer may differ, those in its texts too, and why."""

    relative: float
    reason: str
    keys: str = "*"  # pattern of the places that it holds for, such as *.energy
    absolute: float = 0.0

    def admits(self, was: float, now: float) -> bool:
        """Tell whether a number may become another one."""
        return math.isclose(was, now, rel_tol=self.relative, abs_tol=self.absolute)


class Answer(NamedTuple):
    """What a command is asked; of the tolerances the last one that fits a place counts."""

    asked: str
    tolerances: tuple[Tolerance, ...] = ()
    page: str = ""  # section of docs/reference/json.md, if it is not the one of the command


EXACT = Tolerance(1e-9, "nothing changes")
# Of moving start and goal by 1e-12 (`rounding.py`): the largest change seen, and about twice that.
ROUTE = (
    Tolerance(8e-3, "rounding decides ties otherwise: energies changed by 3.7e-3", absolute=1e-6),
    Tolerance(3e-4, "the bound stops elsewhere: 1.4e-4", "*lower_bound"),
    Tolerance(0.015, "another route of the same energy: 7.1e-3", "*length"),
    Tolerance(0.06, "and how it is shared between turning and driving: 2.7e-2", "*turning"),
    Tolerance(0.06, "the same, by term", "*breakdown*"),
    Tolerance(0.2, "a stop more or less at a corner that is rounded or not: 9.7e-2", "*duration"),
    Tolerance(0.15, "work until nothing better is found: 7.7e-2", "*effort"),
    Tolerance(0.15, "of a few per cent, by energy and bound: 7.1e-2", "*gap", absolute=1e-9),
    Tolerance(0.0, "a path ends where it must", "*path.*", absolute=1e-6),
    Tolerance(0.04, "it is sampled elsewhere: 1.8e-2", "*path.length"),
    Tolerance(0.15, "the same: 7.7e-2, of yaws 0.6 rad", "*path.sum*", absolute=1.2),
)
LEARNED = (
    Tolerance(0.05, "another route of the same energy teaches otherwise", "*.value"),
    Tolerance(0.7, "and tells less or more of a term: 4.4e-1", "*.std_error"),
    Tolerance(0.11, "and the next round takes another route: 5.2e-2", "*.rounds.1.energy*"),
    Tolerance(0.2, "what the drives took more than the terms: 8.8e-2", "*.overhead"),
    Tolerance(0.0, "a difference of energies: 3.2e-3 of them", "*.error", absolute=8e-3),
)
MODEL = "--model quadriga:full:marble"
OFFICE = f"--map office.yaml {MODEL}"
WAREHOUSE = (
    "--map warehouse.yaml --surfaces warehouse_surfaces.geojson --model quadriga:full:concrete"
)
ENDS = "--start 1.2,2,90deg --goal 3.9,2,90deg --effort 5000"

ANSWERS = {
    "start": Answer("start drive.csv --track 0.5 --wheelbase 0.475 --mass 147 --out robot.yaml"),
    "identify": Answer("identify drive.csv --vehicle quadriga:full"),
    "identify-windows": Answer("identify drive.csv --vehicle quadriga:full --method windows"),
    "identify-spin": Answer("identify --spin spin.csv --vehicle quadriga:full"),
    "diagnose": Answer("diagnose hidden.csv --holdout unseen.csv --vehicle quadriga:full"),
    "plan": Answer(f"plan {OFFICE} {ENDS}", ROUTE),
    "plan-surfaces": Answer(
        f"plan {WAREHOUSE} --at-battery --start 2,2,0 --goal 20,12,90deg --effort 20000", ROUTE
    ),
    "compare": Answer(f"compare {OFFICE} {ENDS}", ROUTE),
    "plan-former-kept": Answer(
        f"plan --former free.csv {OFFICE} --start 1.2,3,90deg --effort 3000", ROUTE
    ),
    "plan-former": Answer(
        f"plan --former closed.csv {OFFICE} --start 1.2,2,0 --effort 5000", ROUTE
    ),
    "check": Answer(f"check trajectory.csv {MODEL}"),
    "check-fast": Answer(f"check fast.csv {MODEL} --out slow.csv"),
    "check-path": Answer(f"check free.csv {MODEL}"),
    "range": Answer(
        f"range {OFFICE} --start 1.23,2.02,90deg --energy 3000 --return --confidence 0.95 "
        "--spread 0.05",
        (*ROUTE, Tolerance(5e-3, "a few cells of 700 in the smallest", "*area")),
    ),
    "mission": Answer("mission mission_warehouse.yaml --effort 2000", ROUTE),
    "mission-robots": Answer(
        "mission fleet_warehouse.yaml --effort 1000",
        (
            *ROUTE,
            Tolerance(0.2, "a stop more or less, of 17 s: 1.0e-1", "*.robots.*.route.*"),
            Tolerance(0.03, "a robot with two short legs: 1.3e-2", "*.robots.*.energy*"),
        ),
        page="mission, with robots",
    ),
    "watch": Answer("watch drive.csv --vehicle quadriga:full --once"),
    "drive": Answer(
        f"drive trajectory.csv {MODEL} --effect viscous_loss=60 --sensors seed=1 --out log.csv",
        (Tolerance(1e-6, "the trajectory is timed cell by cell"),),
    ),
    "close-the-loop": Answer(
        f"close-the-loop {OFFICE} {ENDS} --effect viscous_loss=60 --rounds 2 --survey 20",
        (*ROUTE, *LEARNED),
    ),
    "design": Answer(
        "design --model found.yaml --screen --duration 20",
        tuple(
            Tolerance(0.5, "arcs of 0.5 and of 0.9 m narrow alike: processors differ", keys)
            for keys in ("*manoeuvres*", "*sentence")
        ),
    ),
    "export-graph": Answer(f"export graph graph.geojson {OFFICE} --effort 1000", ROUTE),
    "export-lattice": Answer(f"export lattice {MODEL} --resolution 0.1 --out lattice.json"),
    "export-table": Answer(f"export table {MODEL} --out cost.csv"),
    "demo": Answer("demo"),
}


def material(folder: Path) -> None:
    """Make what the commands read."""
    for file in bundle().values():
        if file.suffix in {".yaml", ".png", ".geojson"}:
            shutil.copy(file, folder)
    model = ep.PowerModel.preset("quadriga:full:marble")
    noise = {"power_noise": 5.0, "speed_noise": 0.003}
    drive = simulate.identification_drive(model, seed=2, **noise)
    write_log(drive, folder / "drive.csv")
    write_log(simulate.drive(model, "spin", seed=3, **noise), folder / "spin.csv")
    truth = model.with_term(HOTEL, 40.0)
    write_log(simulate.identification_drive(truth, seed=4, **noise), folder / "hidden.csv")
    write_log(simulate.validation_drive(truth, seed=5, **noise), folder / "unseen.csv")
    ep.write_model(ep.identify(drive, model.vehicle).model, folder / "found.yaml")
    start = ep.Pose(1.2, 2.0, math.pi / 2)
    path = ep.Path(start, ds=[2.0, 0.0, 0.8], dtheta=[0.0, -0.34, 0.0])
    write_path(path, folder / "free.csv")
    write_path(ep.Path(ep.Pose(1.2, 2.0, 0.0), ds=[2.7], dtheta=[0.0]), folder / "closed.csv")
    timed = ep.speed.profile(path, model)
    write_trajectory(timed, folder / "trajectory.csv")
    write_trajectory(timed.scaled(0.4), folder / "fast.csv")
    places = {0: (1.2, 2.0), 1: (3.9, 2.0), 2: (-5.0, 2.0)}  # the last is off the map
    features = [
        {"type": "Feature", "properties": {"id": k},
         "geometry": {"type": "Point", "coordinates": at}} for k, at in places.items()
    ] + [
        {"type": "Feature", "properties": {"id": 2 + k, "startid": 0, "endid": k},
         "geometry": {"type": "MultiLineString", "coordinates": [[places[0], places[k]]]}}
        for k in (1, 2)
    ]  # fmt: skip
    graph = {"type": "FeatureCollection", "features": features}
    (folder / "graph.geojson").write_text(json.dumps(graph))


def file(name: str) -> Path:
    """Return the file that keeps an answer."""
    return HERE / f"{name}.json"


def printed(asked: str, folder: Path) -> str:
    """Return what a command prints with --json, run in a folder and within this process."""
    out, err = io.StringIO(), io.StringIO()
    arguments, sys.argv = sys.argv, ["energyplan", *shlex.split(asked), "--json"]
    try:
        with chdir(folder), redirect_stdout(out), redirect_stderr(err):
            contextvars.Context().run(cli.main)  # which presets were used before does not show
    except SystemExit as left:
        assert not left.code, f"energyplan {asked}\n{err.getvalue()}"
    finally:
        sys.argv = arguments
    return out.getvalue()


def answer(name: str, folder: Path) -> Any:
    """Return the answer of a command, less what is not kept of it."""
    text = printed(ANSWERS[name].asked, folder)
    documents = [text] if text.startswith("{\n") else text.splitlines()  # watch prints lines
    return _kept([json.loads(document) for document in documents])


def _kept(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _kept(one) for key, one in value.items() if key not in DROPPED}
    if isinstance(value, list) and len(value) > 8 and not isinstance(value[0], dict | str):
        rows = value if isinstance(value[0], list) else [[one] for one in value]
        sums = [math.fsum(column) for column in zip(*rows, strict=True)]
        return {"length": len(value), "first": value[0], "last": value[-1], "sum": sums}
    return [_kept(one) for one in value] if isinstance(value, list) else value


def differences(name: str, was: Any, now: Any) -> list[str]:
    """Return where two answers of a command differ by more than may be."""
    return list(_differences(ANSWERS[name].tolerances, "", was, now))


def _differences(tolerances: tuple[Tolerance, ...], at: str, was: Any, now: Any) -> Iterator[str]:
    fitting = [one for one in (EXACT, *tolerances) if fnmatch(at, one.keys)]
    allowed = fitting[-1]
    if isinstance(was, dict) and isinstance(now, dict):
        yield from (f"{at}.{key} is new" for key in now.keys() - was.keys())
        yield from (f"{at}.{key} is gone" for key in was.keys() - now.keys())
        for key in was.keys() & now.keys():
            yield from _differences(tolerances, f"{at}.{key}", was[key], now[key])
    elif isinstance(was, list) and isinstance(now, list):
        if len(was) != len(now):
            yield f"{at}: {len(was)} entries -> {len(now)}"
        for number, (a, b) in enumerate(zip(was, now, strict=False)):
            yield from _differences(tolerances, f"{at}.{number}", a, b)
    elif not _alike(allowed, was, now):
        yield f"{at}: {was!r} -> {now!r}"


def _alike(allowed: Tolerance, was: Any, now: Any) -> bool:
    numbers = (int, float)
    if isinstance(was, bool) or isinstance(now, bool) or type(was) is type(now) is type(None):
        return was is now
    if isinstance(was, numbers) and isinstance(now, numbers):
        return allowed.admits(was, now)
    if not (isinstance(was, str) and isinstance(now, str)):
        return False
    found = [re.findall(NUMBER, text) for text in (was, now)]
    texts = [re.sub(NUMBER, "#", text) for text in (was, now)]
    return texts[0] == texts[1] and all(
        allowed.admits(float(a), float(b))
        or (allowed is not EXACT and abs(float(a) - float(b)) <= 1.001 * _place(a))
        for a, b in zip(*found, strict=True)
    )


def _place(text: str) -> float:
    """Return the unit of the last place of a number in a text, to which it is rounded."""
    return float(10.0 ** -len(text.partition(".")[2]))
