"""Every code block of the documentation runs, and every command line in it is one that exists.

The blocks of a page run one after the other, in a folder with simulated input. Blocks of Python
are fenced as such, or indented and begin with an import. YAML blocks whose first line is a comment
with a file's name become that file.
"""

from __future__ import annotations

import contextlib
import io
import json
import re
import shlex
import shutil
import sys
import textwrap
import tomllib
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
import test_paths
import yaml
from by_day import by_day

import energyplan as ep
from energyplan import cli, simulate
from energyplan.cli._fitting import log as log_commands
from energyplan.io.trajectory import write_log, write_path, write_trajectory
from energyplan.power import HOTEL

ROOT = Path(__file__).resolve().parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
MODEL = ep.PowerModel.preset("quadriga:full:marble")

FENCED = re.compile(r"^```(\w*)[^\n]*\n(.*?)^```", re.MULTILINE | re.DOTALL)


class Block(NamedTuple):
    language: str
    text: str
    line: int


def blocks(page: Path) -> Iterator[Block]:
    """Yield the code blocks of a page in order."""
    text = page.read_text()
    found = [(m.start(2), m[1] or "text", m[2]) for m in FENCED.finditer(text) if m[1] != "eval"]
    rest = FENCED.sub(lambda m: re.sub(r"[^\n]", "", m[0]), text)
    lines = rest.splitlines(keepends=True)
    start = None
    for number, line in enumerate([*lines, "end\n"]):
        inside = line.startswith("    ") or (start is not None and not line.strip())
        if inside and start is None and (number == 0 or not lines[number - 1].strip()):
            start = number
        elif not inside and start is not None:
            code = textwrap.dedent("".join(lines[start:number]))
            first = code.split(maxsplit=1)[:1]
            language = {"from": "python", "import": "python", "energyplan": "sh"}
            place = text.splitlines(keepends=True)
            found.append((sum(map(len, place[:start])), language.get("".join(first), "text"), code))
            start = None
    for place, language, code in sorted(found):
        yield Block(language, code, text[:place].count("\n") + 1)


@pytest.fixture(scope="module")
def material(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The input that the pages speak of, simulated."""
    place = tmp_path_factory.mktemp("docs")
    truth = MODEL.with_term(HOTEL, 40.0)
    noise = {"power_noise": 5.0, "speed_noise": 0.003}
    drives = {
        "spiral.csv": simulate.drive(MODEL, "spiral", seed=1, **noise),
        "drive.csv": simulate.identification_drive(truth, seed=2, **noise),
        "other.csv": simulate.validation_drive(truth, seed=3, **noise),
        "drive1.csv": simulate.identification_drive(truth, seed=4, **noise),
        "drive2.csv": simulate.validation_drive(truth, seed=5, **noise),
        "spin.csv": simulate.drive(MODEL, "spin", seed=7, **noise),
        "drive3.csv": simulate.validation_drive(truth, seed=6, **noise),
    }
    for name, same in zip(("monday", "tuesday", "wednesday"), list(drives)[1:4], strict=True):
        drives[f"{name}.csv"] = drives[same]
    for name, same in zip("abc", ("drive1.csv", "drive2.csv", "drive3.csv"), strict=True):
        drives[f"{name}.csv"] = drives[same]
    for name, log in drives.items():
        write_log(log, place / name)
    log = drives["spiral.csv"]
    columns = [log.t, *(log.channel(n) for n in ("v_left", "v_right")), log.power,
               np.degrees(log.channel("yaw"))]  # fmt: skip
    np.savetxt(place / "foreign.csv", np.column_stack(columns), delimiter=",", comments="",
               header="t,velL,velR,power,heading")  # fmt: skip
    rows = zip(*(column.tolist() for column in columns[:4]), strict=True)
    names = ("stamp", "wl", "wr", "watts")
    lines = (json.dumps(dict(zip(names, row, strict=True))) for row in rows)
    (place / "drive.jsonl").write_text("\n".join(lines))
    route = ep.Path(ep.Pose(0, 0, 0), ds=[2.0, 0.5, 1.0], dtheta=[0.0, 1.0, 0.0])
    write_path(route, place / "path.csv")
    write_path(ep.Path(ep.Pose(2, 2, 0), ds=[6.0], dtheta=[0.0]), place / "route.csv")
    ends = {0: (2, 2), 1: (8, 2)}
    points = [({"id": k}, "Point", at) for k, at in ends.items()]
    line = ({"id": 2, "startid": 0, "endid": 1}, "MultiLineString", [[*ends.values()]])
    features = [
        {"type": "Feature", "properties": told, "geometry": {"type": kind, "coordinates": at}}
        for told, kind, at in (*points, line)
    ]
    graph = {"type": "FeatureCollection", "features": features}
    (place / "graph.geojson").write_text(json.dumps(graph))
    write_trajectory(ep.speed.profile(route, MODEL), place / "trajectory.csv")
    for file in (ROOT / "maps").iterdir():
        if file.suffix in (".yaml", ".png", ".geojson"):
            shutil.copy(file, place / file.name)
    for name in ("examples", "maps"):
        shutil.copytree(ROOT / name, place / name)
    shutil.copy(ROOT / "examples" / "mission_warehouse.yaml", place)
    (place / "mission.yaml").write_text(
        "model: model.yaml\nmap: office.yaml\nbattery: quadriga\nstart: [1.2, 2.0, 90deg]\n"
        "tasks: [{name: look, pose: [3.9, 2.0, 90deg]}]\n"
    )
    found = ep.identify(drives["drive.csv"], MODEL.vehicle)
    for name in ("model.yaml", "extended.yaml"):
        ep.write_model(found.model, place / name)
    return place


def namespace() -> dict[str, Any]:
    """Names that pages speak of without making them."""
    model = ep.PowerModel.preset("quadriga:full:concrete")
    hall = ep.OccupancyGrid(np.zeros((60, 60), bool), resolution=0.1)
    cost = ep.EnergyCost(model)
    log = simulate.identification_drive(model, power_noise=5.0)
    return {
        "__name__": "page", "ep": ep, "np": np, "model": model, "cost": cost, "grid": hall,
        "vehicle": model.vehicle, "found": ep.identify(log, model.vehicle),
        "t": 0.0, "v_left": 0.4, "v_right": 0.5, "power": 120.0, "levels": (0.4, 0.9),
        "problem": ep.PlanningProblem(hall, cost, (2, 2, 0), (4, 4, 1.57)),
        "mission": ep.Mission(model=model, map=hall, battery=ep.Battery.preset("quadriga"),
                              start=(2, 2, 0), tasks=[ep.Task("look", (4, 4, 0))]),
    }  # fmt: skip


def pages(kind: str, at_night: Collection[str] = ()) -> list[Any]:
    """The pages that have blocks of a kind, as parameters of a test."""
    having = [p for p in PAGES if list(command_lines(p) if kind == "sh" else python_blocks(p))]
    marks = {page: [pytest.mark.nightly] if page.stem in at_night else [] for page in having}
    return [pytest.param(page, id=page.stem, marks=marks[page]) for page in having]


def python_blocks(page: Path) -> list[Block]:
    return [block for block in blocks(page) if block.language == "python"]


def command_lines(page: Path) -> Iterator[list[str]]:
    """Yield the arguments of every command line of a page."""
    for block in blocks(page):
        if block.language in ("sh", "text", "console", "bash"):
            for line in block.text.replace("\\\n", " ").splitlines():
                words = shlex.split(line, comments=True) if "energyplan " in line else []
                if words[:1] == ["energyplan"]:
                    yield words[1:]


pytestmark = pytest.mark.usefixtures("counted")


@pytest.fixture(autouse=True)
def nothing_is_served(monkeypatch: pytest.MonkeyPatch) -> None:
    """Commands that serve would not end; the tests of the service let them."""
    monkeypatch.setattr("energyplan.serve.server.run", lambda *arguments: None)


@pytest.mark.usefixtures("hurried")
@pytest.mark.parametrize("page", pages("python"))
def test_python_blocks_run(
    page: Path, material: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    work = shutil.copytree(material, tmp_path / "work")
    write_files(page, work)
    monkeypatch.chdir(work)
    names = namespace()
    for block in python_blocks(page):
        # the file and line of the page stand in a traceback
        source = "\n" * (block.line - 1) + block.text
        with contextlib.redirect_stdout(io.StringIO()):
            exec(compile(source, str(page), "exec"), names)


def write_files(page: Path, folder: Path) -> None:
    """Write the files that a page shows."""
    for block in blocks(page):
        name = re.match(r"#\s*([\w-]+\.yaml)\s*\n", block.text)
        if block.language == "yaml" and name:
            (folder / name[1]).write_text(block.text)


def run_commands(
    page: Path,
    work: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> str:
    """Run the command lines of a page in a folder, but for those that a page before it has.

    Returns what they print.
    """
    printed = ""
    write_files(page, work)
    monkeypatch.chdir(work)
    before = PAGES[: PAGES.index(page)]
    done = {apart_from_the_report(words) for other in before for words in command_lines(other)}
    for arguments in command_lines(page):
        if arguments[0] == "demo":  # run once, by its test
            arguments = ["demo", "--help"]
        if apart_from_the_report(arguments) in done and "--out" not in arguments:  # on that page
            continue
        monkeypatch.setattr(sys, "argv", ["energyplan", *arguments])
        with pytest.raises(SystemExit) as left:
            cli.main()
        told = capsys.readouterr()
        assert not left.value.code, f"{page.name}: {arguments}: {told.err}"
        printed += told.out
    return printed


def check_energies_told(page: str, printed: str) -> None:
    """Hold the energies that the README tells of a comparison against what it prints."""
    shown = re.search(
        r"takes\s(\d+) J, and the least-energy route (\d+) J. That saves (\d+) %."
        r"[^.]*less than (\d+) J",
        page,
    )
    found = re.search(
        r"least energy:\s+energy: ([\d.]+) J.*?lower bound (\d+) J.*?"
        r"shortest:\s+energy: ([\d.]+) J",
        printed,
        re.DOTALL,
    )
    assert shown, page
    assert found, printed
    least, bound, shortest = (float(number) for number in found.groups())
    saved = 100.0 * (1.0 - least / shortest)
    told = [round(value) for value in (shortest, least, saved, bound)]
    assert [int(number) for number in shown.groups()] == told


def apart_from_the_report(words: list[str]) -> tuple[str, ...]:
    """Return a command without the file that its page is written to.

    The input that comes with the library is in the folder, too, where commands run.
    """
    at = words.index("--report") if "--report" in words else len(words)
    return tuple(word.removeprefix("examples/") for word in (*words[:at], *words[at + 2 :]))


def after_demo(page: Path) -> bool:
    """Tell whether a page goes on from what the demo makes."""
    return "demo/" in page.read_text()


def command_of(words: list[str]) -> Any:
    """Return the command of a command line; of a group, its own command that is named."""
    found = cli.commands()
    for word in words:
        found = getattr(found, "commands", {}).get(word, found)
    return found


@pytest.mark.parametrize("page", pages("sh"))
def test_command_lines_name_commands_and_options_that_exist(page: Path) -> None:
    for words in command_lines(page):
        command = command_of(words)
        known = {name for p in command.params for name in (*p.opts, *p.secondary_opts)}
        named = {word.partition("=")[0] for word in words if word.startswith("--")}
        assert named - known <= {"--help", "--version"}, words
        assert command.name == words[0] or words[0] in {"log", "--version"}, words


LENGTHY = ("closing_the_loop", "fleets", "gallery")
"""Pages whose commands take as long as those of all others."""


@pytest.mark.usefixtures("hurried")
@pytest.mark.parametrize("page", [p for p in pages("sh", LENGTHY) if not after_demo(p.values[0])])
def test_command_lines_run(
    page: Path,
    material: Path,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    run_commands(page, shutil.copytree(material, tmp_path / "work"), monkeypatch, capsys)


@pytest.mark.parametrize("done", by_day(["hurried", "as asked"], ["hurried"]))
def test_demo_makes_every_file_it_lists_and_pages_go_on_from_there(
    done: str,
    material: Path,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    request: pytest.FixtureRequest,
) -> None:
    """In one test, so that the demo is run once, however many processes share the tests.

    Only what is done as asked, at night, comes to the energies that the README tells.
    """
    if done == "hurried":
        request.getfixturevalue("hurried")
    folder = tmp_path / "made" / "demo"
    monkeypatch.setattr(sys, "argv", ["energyplan", "demo", "--out", str(folder), "--json"])
    with pytest.raises(SystemExit) as left:
        cli.main()
    assert not left.value.code
    files = [Path(name) for name in json.loads(capsys.readouterr().out)["files"]]
    assert set(files) == {file for file in folder.rglob("*") if file.is_file()}
    page = files[-1].read_text()
    assert files[-1].name == "index.html"
    assert page.count("<figure>") == len([f for f in files if f.suffix == ".png"])
    assert "http" not in re.sub(r"base64,[^\"]+", "", page)
    going_on = [parameter.values[0] for parameter in pages("sh")]
    for other in filter(after_demo, going_on):
        work = shutil.copytree(material, tmp_path / other.stem)
        shutil.copytree(folder, work / "demo")
        printed = run_commands(other, work, monkeypatch, capsys)
        if other == PAGES[0] and done == "as asked":
            check_energies_told(other.read_text(), printed)
    for way in test_paths.BEGINNING_WITH_THE_DEMO:
        work = tmp_path / way
        work.mkdir()
        shutil.copytree(folder, work / "demo")
        test_paths.follow(way, work, monkeypatch, capsys)


ON_PAGES = {apart_from_the_report(words) for page in PAGES for words in command_lines(page)}
EXAMPLES = [
    example
    for command in (*cli.app.registered_commands, *log_commands.registered_commands)
    for example in [str(command.epilog).removeprefix("Example: ")]
    if command.callback is not cli.demo  # run by its fixture
    if apart_from_the_report(shlex.split(example)[1:]) not in ON_PAGES  # run there
]


@pytest.mark.usefixtures("hurried")
@pytest.mark.parametrize("example", EXAMPLES, ids=lambda line: line.split()[1])
def test_examples_of_the_help_run(
    example: str,
    material: Path,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(shutil.copytree(material, tmp_path / "work"))
    monkeypatch.setattr(sys, "argv", shlex.split(example))
    with pytest.raises(SystemExit) as left:
        cli.main()
    assert not left.value.code, capsys.readouterr().err


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_links_and_pictures_exist(page: Path) -> None:
    targets = re.findall(r"\]\(([^)#\s]+)(?:#[^)]*)?\)", page.read_text())
    files = [t for t in targets if not t.startswith(("http:", "https:"))]
    assert [t for t in files if not (page.parent / t).exists()] == []


def test_every_page_is_in_the_table_of_contents() -> None:
    index = (ROOT / "docs" / "index.md").read_text()
    listed = re.findall(r"^(\w[\w/]*)$", index, re.MULTILINE)
    pages = {page.stem for page in PAGES[1:]} - {"index"}
    assert pages == {name for name in listed if "/" not in name}


def test_the_citation_names_this_version() -> None:
    cited = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert str(cited["version"]) == ep.__version__ == project["version"]
    assert cited["license"] == project["license"]
    assert {"cff-version", "message", "title", "authors"} <= set(cited)
