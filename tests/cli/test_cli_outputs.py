"""Nothing is lost or mixed up: outputs that are inputs, impossible outputs, what is held out."""

from __future__ import annotations

import json
import os
import re
import shlex
import shutil
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from commands import Run

import energyplan as ep
from energyplan import cli, simulate
from energyplan.cli.answers import answer
from energyplan.io.config import write_vehicle
from energyplan.io.files import bundled, files_behind, refuse_overwriting
from energyplan.io.tables import write_log, write_trajectory

pytestmark = pytest.mark.usefixtures("little_effort", "few_effects")

MODEL = ep.PowerModel.preset("quadriga:full:marble")


@pytest.fixture(scope="module")
def drives(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four drives, a vehicle, a model and a map with its image."""
    place = tmp_path_factory.mktemp("drives")
    for k, name in enumerate(("a", "b", "c", "d")):
        make = simulate.identification_drive if k < 2 else simulate.validation_drive
        log = make(MODEL, power_noise=5.0, speed_noise=0.003, seed=k)
        write_log(log, place / f"{name}.csv")
    write_vehicle(MODEL.vehicle, place / "robot.yaml")
    ep.write_model(MODEL, place / "model.yaml")
    for file in files_behind(bundled("office.yaml")):
        shutil.copy(file, place / file.name)
    return place


@pytest.fixture
def folder(drives: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The working folder, with a copy of the drives."""
    site = shutil.copytree(drives, tmp_path / "site")
    monkeypatch.chdir(site)
    return site


def refused(folder: Path, run: Run, *arguments: object) -> str:
    """Assert that a command refuses in one line and leaves the folder as it was."""
    before = {file: file.read_bytes() for file in folder.rglob("*") if file.is_file()}
    code, out, error = run(*arguments)
    assert (code, out) == (2, ""), error
    assert len(error.splitlines()) == 1
    after = {file: file.read_bytes() for file in folder.rglob("*") if file.is_file()}
    assert after == before
    return error


PLAN = ("plan", "--map", "office.yaml", "--model", "model.yaml", "--start", "1.2,2,90deg", "--goal",
        "3.9,2,90deg")  # fmt: skip


def test_only_what_is_read_is_guarded(folder: Path, run: Run) -> None:
    """An empty text, or one that happens to name a folder, is no input."""
    (folder / "kept.yaml").write_text("kind: project")
    (folder / "own").mkdir()
    for name in ("", "own", "."):
        code, _, error = run("start", "a.csv", "--track", 0.5, "--name", name, "--out",
                             "kept.yaml")  # fmt: skip
        assert code == 0, error


def test_one_drive_is_cut_into_what_is_learned_from_and_what_is_judged_on(
    folder: Path, run: Run
) -> None:
    told = run("diagnose", "a.csv", "--vehicle", "robot.yaml", "--json").json
    (learned,), (judged,) = told["training"], told["judging"]
    cut = learned.rpartition(" to ")[2].removesuffix(" s")
    assert judged.startswith(f"a.csv from {cut} to ")


def test_short_drives_are_judged_on_whole_and_what_was_set_aside_counts_once(
    folder: Path, run: Run
) -> None:
    """Recordings are often short; one of 12 s among others is no reason to refuse them all."""
    whole = ep.DriveLog.read("a.csv")
    bounds = (0.0, 45.0, 57.0, 69.0)
    parts = ("long.csv", "one.csv", "two.csv")
    for name, (since, until) in zip(parts, pairwise(bounds), strict=True):
        rows = (folder / "a.csv").read_text().splitlines()
        first, last = np.searchsorted(whole.t, [since, until])
        blank = ",".join("" for _ in rows[0].split(","))
        lines = [rows[0], *rows[1 + first : 1 + last], blank]
        (folder / name).write_text("\n".join(lines) + "\n")
    told = run("diagnose", *parts, "--vehicle", "robot.yaml", "--json").json
    assert told["training"] == ["long.csv from 0 to 26.97 s", "one.csv"]
    assert told["judging"] == ["long.csv from 26.97 to 44.95 s", "two.csv"]
    assert {name: sum(of.values()) for name, of in told["set_aside"].items()} == dict.fromkeys(
        parts, 1
    )


def test_what_a_mission_names_is_behind_it(folder: Path) -> None:
    mission = folder / "round.yaml"
    mission.write_text("model: model.yaml\nmap: office.yaml\nsurfaces: grounds.geojson\n")
    (folder / "grounds.geojson").write_text('{"features": [{"model": "robot.yaml"}]}')
    names = {file.name for file in files_behind(mission)}
    assert {"round.yaml", "model.yaml", "office.yaml", "grounds.geojson", "robot.yaml"} < names
    mission.write_text("map: warehouse.yaml\n")  # of the library
    names = {file.name for file in files_behind(mission)}
    assert names == {"round.yaml", "warehouse.yaml", "warehouse.png"}
    mission.write_text("model: model.yaml\nmap: office.yaml\nsurfaces: grounds.geojson\n")
    with pytest.raises(ep.errors.InvalidInputError, match=r"belongs to round\.yaml"):
        refuse_overwriting(["robot.yaml"], [Path("round.yaml")])


def test_a_full_disk_is_told_before_the_work(
    folder: Path, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(number: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.fsync", full)
    error = refused(folder, run, *PLAN, "--out", "path.csv")
    assert "No space left" in error


@pytest.mark.skipif(sys.platform == "win32", reason="a shell of POSIX")
@pytest.mark.parametrize(("words", "code"), [("--version", 0), ("check absent.csv --model a", 2)])
def test_a_closed_standard_error_hides_no_answer(words: str, code: int) -> None:
    command = f"{shlex.quote(sys.executable)} -m energyplan {words} 2>&-"
    done = subprocess.run(["sh", "-c", command], stdout=subprocess.PIPE, check=False)
    assert done.returncode == code and bool(done.stdout) == (code == 0)


@pytest.mark.skipif(sys.platform == "win32", reason="pipes of POSIX")
def test_a_closed_pipe_is_one_line() -> None:
    reading, writing = os.pipe()
    os.close(reading)
    command = [sys.executable, "-m", "energyplan", "check", "absent.csv", "--model", "absent"]
    done = subprocess.run(command, stdout=writing, stderr=subprocess.PIPE, check=False, text=True)
    os.close(writing)
    assert done.returncode == 2
    assert done.stderr == (
        "energyplan: the standard output is a closed pipe; the answer has no place to go\n"
    )


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="the system has no /dev/full")
def test_an_answer_that_cannot_be_printed_is_one_line() -> None:
    with Path("/dev/full").open("w") as full:
        command = [sys.executable, "-m", "energyplan", "--version"]
        done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, check=False, text=True)
    assert done.returncode == 1
    assert len(done.stderr.splitlines()) == 1


def program(code: str, *arguments: str, **environment: str) -> subprocess.CompletedProcess[bytes]:
    """Run Python in a process of its own, and return what it printed."""
    command = [sys.executable, "-c", code, *arguments]
    return subprocess.run(
        command, capture_output=True, check=False, timeout=120, env={**os.environ, **environment}
    )


PRINTING = r"""
from energyplan import cli
from energyplan.cli.answers import answer, warn
def work(**_):
    warn("\u00dcber")
    answer({}, ["pr\u00fcfen"], json=False)
cli.commands = lambda: work
cli.main()
"""


@pytest.mark.parametrize(("encoding", "shown"), [("utf-8", "prüfen"), ("ascii", "pr\\xfcfen")])
def test_an_encoding_that_lacks_a_letter_prints_the_answer(encoding: str, shown: str) -> None:
    locale = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    done = program(PRINTING, PYTHONIOENCODING=encoding, **locale)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == [shown.encode(encoding)]
    assert len(done.stderr.splitlines()) == 1


@pytest.mark.parametrize(("turns", "told"), [(1.0, False), (2.0, True)])
def test_an_angle_that_the_yaw_contradicts_is_told(
    folder: Path, run: Run, turns: float, told: bool
) -> None:
    spin = simulate.drive(MODEL, "spin")
    write_log(spin, Path("spin.csv"))
    angle = turns * float(np.abs(np.diff(spin.channel("yaw"))).sum())
    icr = ("identify", "spin.csv", "--vehicle", "robot.yaml", "--spin")
    code, _, error = run(*icr, "--angle", f"{angle}")
    assert code == 0
    assert ("which is right?" in error) == told


@pytest.mark.parametrize("robot", ["quadriga:empty", "husky_a200"])
def test_what_belongs_to_another_robot_is_told(folder: Path, run: Run, robot: str) -> None:
    """Another load of the same robot is no other robot."""
    path = ep.Path(ep.Pose(1.2, 2.0, 0.0), ds=[1.0], dtheta=[0.0])
    write_trajectory(ep.speed.profile(path, MODEL), Path("t.csv"))
    _, _, error = run("check", "t.csv", "--model", "model.yaml", "--vehicle", robot)
    assert ("limits are of another robot, husky" in error) == (robot == "husky_a200")
    (folder / "ground.yaml").write_text(
        f"map: office.yaml\nsurfaces: {bundled('office_surfaces.geojson')}\n"
    )
    ground = ("--map", "ground.yaml")
    ground_model = {"husky_a200": "husky_a200:flooring"}.get(robot, "quadriga:empty:marble")
    _, _, error = run("check", "t.csv", "--model", ground_model, *ground)
    assert ("surfaces are of another robot, quad" in error) == (robot == "husky_a200")


@pytest.mark.parametrize(
    "arguments",
    [("a.csv", "--holdout", "c.csv", "d.csv"), ("--holdout", "c.csv", "d.csv", "--", "a.csv"),
     ("a.csv", "--holdout=c.csv", "d.csv"), ("a.csv", "--holdout", "c.csv", "--holdout", "d.csv")],
)  # fmt: skip
def test_all_that_follows_holdout_is_held_out(
    folder: Path, run: Run, arguments: tuple[str, ...]
) -> None:
    vehicle = ("--vehicle", "robot.yaml", "--json")
    told = run("diagnose", *vehicle, *arguments).json
    assert told["training"] == ["a.csv"]
    assert told["judging"] == ["c.csv", "d.csv"]


BAD_INPUTS = """
diagnose a.csv --holdout a.csv --vehicle robot.yaml | a.csv is both a training and a hold-out drive
diagnose a.csv --holdout same.csv --vehicle robot.yaml | hold-out
diagnose a.csv --holdout | --holdout is given without a value
diagnose a.csv --holdout --vehicle robot.yaml | --holdout is given without a value
identify a.csv ../site/a.csv --vehicle robot.yaml | given twice
identify absent.csv --vehicle quadriga | absent.csv
identify broken.csv --vehicle quadriga | broken.csv, line 4
identify a.csv --vehicle quadrga | husky_a200
identify a.csv --vehicle quadriga --method magic | 'magic' is not one of 'lad', 'simplex', 'huber'
identify a.csv --vehicle office.yaml | seems to be a map
identify a.csv --vehicle empty.yaml | empty.yaml is empty
identify . --vehicle quadriga | is a folder
identify a.csv | or a project's, by --project
identify --nonsense | --nonsense
check absent.csv --model quadriga:full:marble | absent.csv
check a.csv --model quadriga:full:ice | quadriga:full:marble
--json check t.csv | give it after the command
plan | --map
plan | see energyplan plan --help
plna | Did you mean 'plan'
{plan} --goal 0,0,0 | goal
{plan} --goal -50,0,0 | outside
{plan} --goal 4 2 0 | are one word each
{plan} --goal 1 | 90deg
{plan} --goal 1,2,3,4 | 90deg
{plan} --goal 1,2,north | 90deg
{plan} --goal 1,nan,0 | 90deg
{plan} --goal '' | 90deg
{plan} --goal 1,2,90 | 90deg
{plan} --goal 2,2,0 --map . | is a folder
{plan} --goal 2,2,0 --map round.yaml | seems to be a mission
{plan} --goal 2,2,0 --map site.yaml | site.yaml, line 2, surfaces: 'gone.geojson' cannot be read
{plan} --goal 2,2,0 --model office.yaml | line 1
{plan} --goal 2,2,0 --model office.yaml | seems to be a map
{plan} --goal 2,2,0 --costmap-weight 5 | a site's file that names a costmap
{plan} --goal 2,2,0 --heights h.asc | No such option: --heights; see energyplan plan --help
range --start 2,2,0 --energy 5kJ | '5kJ' should be a valid number in J
range --map {surfaces} --model model.yaml --start 1.2,2,0 | these are surfaces and no obstacles
{plan} --goal 2,2,0 --clearance -1 | clearance is -1.0; give 0 to 20 m
range {site} --energy 5000 --spread -1 | give
range {site} --energy -3 | the energy is -3.0 J; give a positive number
range {site} --energy inf | --energy is infinite; leave it out
export table --model model.yaml --out t.csv --speeds 0.2,1e308 | up to 50
range {site} --out range.tif | .asc
range {site} --soc 0.5 | --battery
range {site} --spread 0.1 | --confidence
range {site} --battery quadriga --energy 5 | give one
range --map office.yaml --model quadriga:full:marble --start 1.2,2,0 --confidence 0.95 | spread
mission absent.yaml | absent.yaml
mission model.yaml | this file seems to be a power model
mission round.yaml --fail a@1 | has robots
mission round.yaml --soc '5 %' | No such option: --soc
mission --map office.yaml | No such option: --map
mission | MISSION.yaml
icr a.csv --vehicle quadriga | No such command 'icr'
start a.csv --track nan --out new.yaml | --track is nan; give a number
design --model model.yaml --duration 1e9 | give
export lattice --model model.yaml --out l.json --resolution 1e-9 | give
export graph none.geojson --map office.yaml --model model.yaml | none.geojson: no nodes or no edges
{plan} --former none.csv | none.csv
watch - | give --model, --vehicle or --mission
watch - --model a --vehicle b | give one of them
watch none.csv --vehicle quadriga --once | none.csv cannot be read
identify none.csv --vehicle quadriga --angle 9rad | goes with --spin
identify a.csv --vehicle robot.yaml --out robot.yaml | would be lost
identify a.csv --vehicle robot.yaml --out ./robot.yaml | would be lost
identify a.csv --vehicle robot.yaml --out ../site/robot.yaml | would be lost
identify a.csv --vehicle robot.yaml --out soft.yaml | would be lost
identify a.csv --vehicle robot.yaml --out hard.yaml | would be lost
identify a.csv --vehicle robot.yaml --out here/robot.yaml | would be lost
identify a.csv --vehicle quadriga --out a.yaml | would be lost
diagnose a.csv --holdout c.csv --vehicle robot.yaml --out robot.yaml | would be lost
{plan} --goal 3.9,2,90deg --map other.yaml --plot floor.png | would be lost
compare {site} --goal 3.9,2,90deg --map other.yaml --plot floor.png | would be lost
{plan} --goal 3.9,2,90deg --out route.csv --plot two.png | twice
{plan} --goal 3.9,2,90deg --out path.yaml | .csv
{plan} --goal 3.9,2,90deg --out none/path.csv | folder
{plan} --goal 3.9,2,90deg --plot p.gif | .svg
{plan} --goal 3.9,2,90deg --out locked.csv | written
{plan} --goal 3.9,2,90deg --plot folder.png | folder
serve . --port=99999 | '99999' should be less than
"""


@pytest.mark.parametrize("case", BAD_INPUTS.strip().splitlines())
def test_bad_input_is_refused_in_one_line_that_tells_the_remedy(
    folder: Path, run: Run, case: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def work(*_: object, **__: object) -> None:
        raise AssertionError("the work has begun")

    if "--out" in case or "--plot" in case:
        monkeypatch.setattr("energyplan.planning.plan", work)
    monkeypatch.setattr(
        "os.access", lambda path, mode, **_: mode != os.W_OK or "locked" not in str(path)
    )
    links = {"same.csv": "a.csv", "soft.yaml": "robot.yaml", "two.png": "route.csv", "here": "."}
    for name, target in links.items():
        (folder / name).symlink_to(target)
    for name, target in {"hard.yaml": "robot.yaml", "a.yaml": "a.csv"}.items():
        os.link(target, name)
    (folder / "folder.png").mkdir()
    (folder / "locked.csv").write_text("kept")
    image = next(file.name for file in folder.glob("office.p*"))
    shutil.copy(image, "floor.png")  # which only the map names
    (folder / "other.yaml").write_text(Path("office.yaml").read_text().replace(image, "floor.png"))
    (folder / "broken.csv").write_text("t,v_left,v_right,power\n0,0,0,1\n1,0,0,1\n0.5,0,0,1\n")
    (folder / "empty.yaml").write_text("# to be written\n")
    (folder / "none.geojson").write_text('{"type": "FeatureCollection", "features": []}')
    (folder / "site.yaml").write_text("map: office.yaml\nsurfaces: gone.geojson\n")
    (folder / "round.yaml").write_text(
        "model: quadriga:full:marble\nmap: office.yaml\nbattery: quadriga\n"
        "start: [1.2, 2, 90deg]\ncoefficient_spread: 5 %\n"
        "tasks: [{name: m, pose: [3.9, 2, 90deg]}]\n"
    )
    command, said = case.split(" | ")
    site = "--map office.yaml --model model.yaml --start 1.2,2,90deg"
    places = {"plan": f"plan {site}", "site": site, "surfaces": bundled("office_surfaces.geojson")}
    assert said in refused(folder, run, *shlex.split(command.format(**places)))


def test_without_a_command_it_says_what_to_do_first(run: Run) -> None:
    code, out, error = run()
    assert (code, error) == (0, "")
    assert len(out.splitlines()) <= 20
    named = set(re.findall(r"energyplan (\w+)", out))
    assert {"demo", "start", "diagnose", "plan", "mission"} == named
    code, out, error = run("export")
    assert (code, error) == (0, "")
    assert "lattice" in out


def test_a_project_is_no_second_vehicle_beside_a_model(folder: Path, run: Run) -> None:
    start = ("start", "a.csv", "--like", "robot.yaml", "--out", "project.yaml")
    assert run(*start)[0] == 0
    words = ("watch", "a.csv", "--once", "--model", "model.yaml", "--project", "project.yaml")
    code, out, error = run(*words)
    assert code == 0, error
    assert out
    assert "--model and --vehicle" in refused(folder, run, *words, "--vehicle", "robot.yaml")


def test_the_version_is_printed(run: Run) -> None:
    for option in ("--version", "-V"):
        assert run(option) == (0, f"energyplan {ep.__version__}\n", "")


def test_escape_codes_of_a_file_never_reach_the_terminal(
    folder: Path, run: Run, capsys: pytest.CaptureFixture[str]
) -> None:
    name = "\x1b[31mga\x07te\x9b"
    (folder / name).write_text("t,v_left,v_right,power\n0,0,0,1\n")
    code, out, error = run("identify", name, "--vehicle", "robot.yaml")
    assert (code, out) == (2, "")
    assert r"\u001b[31mga\u0007te\u009b" in error
    assert error.rstrip("\n").isprintable()
    answer({"name": name}, [], json=True)
    printed = capsys.readouterr().out
    assert json.loads(printed) == {"name": name}
    assert printed.replace("\n", "").isprintable()
    answer({}, [f"{name}: reachable"], json=False)
    assert capsys.readouterr().out.rstrip("\n").isprintable()


def test_every_output_is_checked_before_the_work() -> None:
    """An option that names a file to be written says so to the guard."""
    waiting, seen = [cli.commands()], []
    while waiting:
        command = waiting.pop()
        waiting += getattr(command, "commands", {}).values()
        for param in command.params:
            text = (getattr(param, "help", None) or "").lower()
            if text.startswith(("write", "draw", "folder for")):
                seen.append(param.name)
                assert param.callback is not None, f"{command.name} --{param.name}"
    assert {"out", "report", "plot"} <= set(seen)


def test_presets_and_files_complete(folder: Path) -> None:
    environment = {**os.environ, "_ENERGYPLAN_COMPLETE": "complete_bash", "COMP_CWORD": "3",
                   "COMP_WORDS": "energyplan identify --vehicle husk"}  # fmt: skip
    command = [sys.executable, "-c", "from energyplan.cli import main; main()"]
    done = subprocess.run(command, env=environment, capture_output=True, check=False, text=True)
    assert "husky_a200" in done.stdout, done.stderr
