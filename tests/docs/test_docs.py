"""Every code block, command, notebook and example of the documentation runs; links exist.

The blocks of a page run one after the other, in a folder with simulated input. Blocks of Python
are fenced as such, or indented and begin with an import. YAML blocks whose first line is a comment
with a file's name become that file.
"""

from __future__ import annotations

import ast
import contextlib
import importlib.util
import io
import json
import re
import runpy
import shlex
import shutil
import sys
import textwrap
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import own_robot
import pytest

import energyplan as ep
from energyplan import cli, simulate
from energyplan.io.tables import write_log, write_path, write_trajectory
from energyplan.power import HOTEL

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
PAGES = [ROOT / "README.md", *sorted(DOCS.glob("*.md"))]
MODEL = ep.PowerModel.preset("quadriga:full:marble")
FENCED = re.compile(r"^ *```(\w*)[^\n]*\n(.*?)^ *```", re.MULTILINE | re.DOTALL)
LENGTHY = {"closing_the_loop"}
"""Pages whose commands take as long as those of all others."""

Command = Callable[[list[str]], str]


def _script(name: str) -> Any:
    """Import a script of the benchmarks."""
    found = importlib.util.spec_from_file_location(name, ROOT / "benchmarks" / f"{name}.py")
    assert found is not None and found.loader is not None
    module = importlib.util.module_from_spec(found)
    sys.modules[name] = module
    found.loader.exec_module(module)
    return module


pages_of = _script("pages")


class Block(NamedTuple):
    language: str
    text: str
    line: int
    said: str  # what the page goes on with


def blocks(page: Path) -> Iterator[Block]:
    """Yield the code blocks of a page in order."""
    text = page.read_text()
    found = [(m.start(2), m.end(), m[1] or "text", m[2]) for m in FENCED.finditer(text)]
    rest = FENCED.sub(lambda m: re.sub(r"[^\n]", "", m[0]), text)
    for indented in re.finditer(r"(?<=\n\n)((?:    .*\n|\n)+)", rest):
        code = textwrap.dedent(indented[1])
        language = "python" if re.match(r"from |import ", code) else "text"
        found.append((indented.start(), indented.end(), language, code))
    for place, end, language, code in sorted(found):
        yield Block(language, code, text[:place].count("\n") + 1, text[end:])


def python_blocks(page: Path) -> list[Block]:
    return [block for block in blocks(page) if block.language == "python"]


def command_lines(page: Path, program: str = "energyplan") -> Iterator[list[str]]:
    """Yield the words after the program of every command line of a page."""
    for block in blocks(page):
        if block.language not in ("python", "yaml", "json"):
            for line in block.text.replace("\\\n", " ").splitlines():
                words = shlex.split(line, comments=True) if f"{program} " in line else []
                if words[:1] == [program]:
                    yield words[1:]


def pages(having: Callable[[Path], Any]) -> list[Any]:
    """Return the pages that have something, as parameters of a test."""
    night = {True: [pytest.mark.nightly], False: []}
    found = [page for page in PAGES if list(having(page))]
    return [pytest.param(p, id=p.stem, marks=night[p.stem in LENGTHY]) for p in found]


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
    shutil.copy(ROOT / "maps" / "office.png", place / "yard.png")
    (place / "mission.yaml").write_text(
        "model: model.yaml\nmap: office.yaml\nbattery: quadriga\nstart: [1.2, 2.0, 90deg]\n"
        "tasks: [{name: look, pose: [3.9, 2.0, 90deg]}]\n"
    )
    own_robot.bag(place, own_robot.drive())
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


@pytest.fixture
def command(
    hurried: None, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Command:
    """Run a command line, less the program; return what it prints."""
    monkeypatch.setattr("energyplan.serve.run", lambda *arguments: None)  # it would not end

    def run(words: list[str]) -> str:
        monkeypatch.setattr(sys, "argv", ["energyplan", *words])
        with pytest.raises(SystemExit) as left:
            cli.main()
        printed = capsys.readouterr()
        assert not left.value.code, f"{words}: {printed.err}"
        return printed.out

    return run


def write_files(page: Path, folder: Path) -> None:
    """Write the files that a page shows."""
    for block in blocks(page):
        name = re.match(r"\s*#\s*([\w-]+\.yaml)\s*\n", block.text)
        if block.language == "yaml" and name:
            (folder / name[1]).write_text(block.text)


def apart_from_the_report(words: list[str]) -> tuple[str, ...]:
    """Return a command without the file that its page is written to.

    The input that comes with the library is in the folder, too, where commands run.
    """
    at = words.index("--report") if "--report" in words else len(words)
    return tuple(word.removeprefix("examples/") for word in (*words[:at], *words[at + 2 :]))


def run_commands(page: Path, work: Path, command: Command) -> None:
    """Run the command lines of a page in a folder, but for those that a page before it has."""
    write_files(page, work)
    before = PAGES[: PAGES.index(page)]
    done = {apart_from_the_report(words) for other in before for words in command_lines(other)}
    with contextlib.chdir(work):
        for words in command_lines(page):
            asked = ["demo", "--help"] if words[0] == "demo" else words  # run once, by its test
            if apart_from_the_report(words) not in done or "--out" in words:
                command(asked)


@pytest.mark.usefixtures("hurried")
@pytest.mark.parametrize("page", pages(python_blocks))
def test_python_blocks_run(page: Path, material: Path, tmp_path: Path) -> None:
    work = shutil.copytree(material, tmp_path / "work")
    write_files(page, work)
    names = namespace()
    with contextlib.chdir(work), contextlib.redirect_stdout(io.StringIO()):
        for block in python_blocks(page):
            # the file and line of the page stand in a traceback
            exec(compile("\n" * (block.line - 1) + block.text, str(page), "exec"), names)


NUMBER = r"\d+(?:\.\d+)?"
PRINTS = re.compile(rf"\s*It prints ((?:{NUMBER}|[^.\d])*)\.")
"""The sentence after a block that says which numbers it prints."""


def claimed(page: Path) -> list[Block]:
    return [block for block in python_blocks(page) if PRINTS.match(block.said)]


@pytest.mark.parametrize("page", pages(claimed))
def test_a_block_prints_the_numbers_that_the_page_says(
    page: Path, material: Path, tmp_path: Path
) -> None:
    """With all the work that the block asks for, unlike in the test above."""
    names = namespace()
    with contextlib.chdir(shutil.copytree(material, tmp_path / "work")):
        for block in claimed(page):
            with contextlib.redirect_stdout(io.StringIO()) as out:
                exec(compile("\n" * (block.line - 1) + block.text, str(page), "exec"), names)
            said = PRINTS.match(block.said)
            assert said is not None
            assert re.findall(NUMBER, out.getvalue()) == re.findall(NUMBER, said[1])


def after_demo(page: Path) -> bool:
    """Tell whether a page goes on from what the demo makes."""
    return any("demo/" in word for words in command_lines(page) for word in words)


@pytest.mark.parametrize("page", [p for p in pages(command_lines) if not after_demo(p.values[0])])
def test_command_lines_run(page: Path, material: Path, tmp_path: Path, command: Command) -> None:
    run_commands(page, shutil.copytree(material, tmp_path / "work"), command)


def test_the_demo_makes_the_files_it_lists_and_pages_go_on_from_there(
    material: Path, tmp_path: Path, command: Command
) -> None:
    """In one test, so that the demo is run once, however many processes share the tests."""
    folder = tmp_path / "made" / "demo"
    files = [
        Path(name)
        for name in json.loads(command(["demo", "--out", str(folder), "--json"]))["files"]
    ]
    assert set(files) == {file for file in folder.rglob("*") if file.is_file()}
    page = files[-1].read_text()
    assert files[-1].name == "index.html"
    assert page.count("<figure>") == len([f for f in files if f.suffix == ".png"])
    assert "http" not in re.sub(r"base64,[^\"]+", "", page)
    for other in filter(after_demo, PAGES):
        work = shutil.copytree(material, tmp_path / other.stem)
        shutil.copytree(folder, work / "demo")
        run_commands(other, work, command)


def all_commands(group: Any) -> Iterator[Any]:
    """Yield the commands of a group and of the groups in it."""
    for one in group.commands.values():
        yield from all_commands(one) if hasattr(one, "commands") else [one]


COMMANDS = list(all_commands(cli.commands()))
EXAMPLES = {one.name: shlex.split(one.epilog.removeprefix("Example: "))[1:] for one in COMMANDS}
ON_PAGES = {apart_from_the_report(words) for page in PAGES for words in command_lines(page)}


@pytest.mark.parametrize(
    "name", [n for n, words in EXAMPLES.items() if apart_from_the_report(words) not in ON_PAGES]
)
def test_the_example_of_the_help_runs(
    name: str, material: Path, tmp_path: Path, command: Command
) -> None:
    with contextlib.chdir(shutil.copytree(material, tmp_path / "work")):
        command(EXAMPLES[name] if name != "demo" else ["demo", "--help"])


def test_every_option_has_help_and_overviews_name_every_command() -> None:
    options = [(one.name, option) for one in COMMANDS for option in one.params]
    assert [(name, option.name) for name, option in options if not option.help] == []
    index = (DOCS / "index.md").read_text()
    named = [one.name for one in COMMANDS if re.search(rf"`[^`]*\b{one.name}\b", index)]
    assert named == [one.name for one in COMMANDS]


RECORDED = {"diagnose_engine": "quadriga_mujoco", "diagnose_husky": "vulpi/PLOUGHED",
            "husky_log": "vulpi/PLOUGHED"}  # fmt: skip
"""Examples that read recordings, and where these are."""


@pytest.mark.nightly
@pytest.mark.parametrize("name", sorted(file.stem for file in (ROOT / "examples").glob("*.py")))
def test_an_example_runs_as_the_overview_says(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest
) -> None:
    lines = [w for w in command_lines(DOCS / "index.md", "python") if f"/{name}.py" in w[0]]
    assert len(lines) == 1, f"docs/index.md has {len(lines)} commands for {name}"
    folder = tmp_path
    if name in RECORDED:
        folder = request.getfixturevalue("shared_data") / RECORDED[name]
    shutil.copytree(ROOT / "maps", tmp_path / "maps")  # as where one runs them, in a checkout
    words = [str(folder) if word == "FOLDER" else word for word in lines[0]]
    monkeypatch.setattr(sys, "argv", words)
    with contextlib.chdir(tmp_path), contextlib.redirect_stdout(io.StringIO()) as out:
        runpy.run_path(str(ROOT / words[0]), run_name="__main__")
    # figures in a paragraph that names the example as their source are among those it prints
    paragraphs = [part for page in PAGES for part in page.read_text().split("\n\n")]
    said = [part for part in paragraphs if f"(`python examples/{name}.py`)" in part]
    figures = {figure for part in said for figure in re.findall(rf"({NUMBER}) Wh", part)}
    assert figures <= set(re.findall(NUMBER, out.getvalue()))


@pytest.mark.parametrize("file", sorted((DOCS / "notebooks").glob("*.ipynb")), ids=lambda f: f.stem)
@pytest.mark.parametrize(
    "exact", [False, pytest.param(True, marks=pytest.mark.nightly)], ids=["kinds", "exact"]
)
def test_a_notebook_runs_as_its_stored_results_say(file: Path, exact: bool, tmp_path: Path) -> None:
    """`make notebooks` stores them again; that they are the same to the letter is of the night."""
    notebook = json.loads(file.read_text())
    assert notebook["metadata"]["energyplan"] == ep.__version__
    names: dict[str, Any] = {"__name__": "notebook"}
    for k, cell in enumerate(notebook["cells"]):
        if cell["cell_type"] != "code":
            continue
        tree = ast.parse("".join(cell["source"]))
        last = tree.body.pop() if isinstance(tree.body[-1], ast.Expr) else None
        value = None
        with contextlib.chdir(tmp_path), contextlib.redirect_stdout(io.StringIO()) as out:
            exec(compile(tree, f"{file.name}, cell {k}", "exec"), names)
            if isinstance(last, ast.Expr):
                code = compile(ast.Expression(last.value), f"{file.name}, cell {k}", "eval")
                value = eval(code, names)
        stored = {
            kind: text if isinstance(text, str) else "".join(text)
            for output in cell["outputs"]
            for kind, text in output.get("data", {"stdout": output.get("text", "")}).items()
        }
        now = {"stdout": out.getvalue()} if out.getvalue() else {}
        if hasattr(value, "_repr_png_"):
            now["image/png"] = stored.get("image/png", "")  # which differs by the fonts at hand
        elif hasattr(value, "_repr_html_"):
            now["text/html"] = value._repr_html_()
        elif value is not None:
            now["text/plain"] = repr(value)
        assert now.keys() == stored.keys(), f"cell {k}"
        assert now == stored or not exact, f"cell {k}"


def test_tables_that_scripts_write_say_on_which_commit() -> None:
    marks = sum(page.read_text().count("<!-- end of") for page in pages_of.PAGES)
    found = [table for page in pages_of.PAGES for table in pages_of.tables(page)]
    assert len(found) == marks > 0
    assert [table.name for table in found if not table.commit] == []


def test_a_table_that_a_script_writes_is_compared_with_what_it_was(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    text = "| a | saved | CPU time |\n|---|---|---|\n| one | 5.1 % | 0.3 s |"
    page.write_text("Before\n\n<!-- of one: python x.py -->\n<!-- end of of one -->\n")
    with pytest.raises(SystemExit, match="no mark"):
        pages_of.write(page, "another", text)
    page.write_text("Before\n\n<!-- of one: python x.py -->\nold\n<!-- end of of one -->\nAfter")
    pages_of.write(page, "of one", text)
    assert page.read_text().startswith("Before\n\n<!-- of one: python x.py -->\n| a |")
    assert page.read_text().endswith("<!-- end of of one -->\nAfter")
    (kept,) = pages_of.tables(page)
    assert kept.commit
    pages_of.write(page, "of one", text.replace("5.1", "5.2").replace("0.3", "0.9"))
    assert list(pages_of.differences(kept, *pages_of.tables(page))) == []
    pages_of.write(page, "of one", text.replace("5.1", "6.1"))
    assert len(list(pages_of.differences(kept, *pages_of.tables(page)))) == 1


def test_the_readme_has_the_figures_of_the_model_card() -> None:
    """Runs, mean errors, the extremes of the grounds, and how many are in the interval."""
    (grounds,) = [one for one in pages_of.tables(DOCS / "model_card.md") if one.name == "grounds"]
    *each, mean = [row for row in grounds.rows if len(row) > 7 and "%" in row[2]]
    shares = [float(row[4].strip(" %")) for row in each]
    runs, two_terms, handed_on, inside = (mean[k].strip() for k in (1, 2, 4, 7))
    said = " ".join((ROOT / "README.md").read_text().split())
    assert f"{runs} real runs" in said and len(each) == 10
    assert f"by {two_terms} in the mean with two terms, by {handed_on} with effects" in said
    by_ground = dict(zip((row[0].strip() for row in each), shares, strict=True))
    one_drive, other = by_ground.pop("warthog grass"), by_ground["warthog grass 2"]
    least, most = (pick(by_ground, key=by_ground.__getitem__) for pick in (min, max))
    assert f"from {by_ground[least]} % on {least} to {by_ground[most]} % on {most}" in said
    assert (
        f"(parts of one drive on grass: {one_drive} %, five runs on other grass: {other} %)" in said
    )
    assert f"{inside.partition(' (')[0]} lay in their 90 % interval" in said


def test_the_tests_that_pages_name_exist() -> None:
    named = [
        (page.stem, place, word)
        for page in PAGES
        for place, word in re.findall(r"(tests/[\w/.]+) -k (\w+)", page.read_text())
    ]
    assert len(named) > 8
    for page, place, word in named:
        found = ROOT / place
        texts = [file.read_text() for file in ([found] if found.is_file() else found.rglob("*.py"))]
        assert any(re.search(rf"def test_\w*{word}", text) for text in texts), (page, place, word)


def imported(code: str) -> Iterator[str]:
    """Yield the names of this package that code imports."""
    for node in ast.walk(ast.parse(code)):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("energyplan"):
            yield from (f"{node.module}.{alias.name}" for alias in node.names)
        elif isinstance(node, ast.Import):
            names = (alias.name for alias in node.names)
            yield from (name for name in names if name.startswith("energyplan."))


def test_what_readers_are_shown_to_import_is_in_the_reference() -> None:
    """Of pages, examples and notebooks: a name that is listed, or one of a module that is."""
    reference = (DOCS / "reference" / "python.md").read_text()
    listed = set(re.findall(r"^\.\. auto\w+:: (\S+)", reference, re.MULTILINE))
    modules = set(re.findall(r"^\.\. automodule:: (\S+)", reference, re.MULTILINE))
    cells = [
        "".join(cell["source"])
        for file in (DOCS / "notebooks").glob("*.ipynb")
        for cell in json.loads(file.read_text())["cells"]
        if cell["cell_type"] == "code"
    ]
    shown = [block.text for page in PAGES for block in python_blocks(page)] + cells
    shown += [file.read_text() for file in (ROOT / "examples").glob("*.py")]
    names = {name for code in shown for name in imported(code)}
    top = {f"energyplan.{name}" for name in ep.__all__}
    known = listed | modules | top
    packages = {name.rpartition(".")[0] for name in modules}  # with nothing of their own
    hidden = {n for n in names - packages if not {n, n.rpartition(".")[0]} & known}
    assert sorted(hidden) == []
    for name in listed - modules:
        assert getattr(importlib.import_module(name.rpartition(".")[0]), name.rpartition(".")[2])


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_links_and_pictures_exist(page: Path) -> None:
    targets = re.findall(r"\]\(([^)#\s]+)(?:#[^)]*)?\)", page.read_text())
    files = [t for t in targets if not t.startswith(("http:", "https:"))]
    assert [t for t in files if not (page.parent / t).exists()] == []


def test_every_page_is_in_the_table_of_contents() -> None:
    listed = re.findall(r"^(\w[\w/]*)$", (DOCS / "index.md").read_text(), re.MULTILINE)
    pages = {page.stem for page in PAGES[1:]} - {"index"}
    assert pages == {name for name in listed if "/" not in name}


def test_the_messages_of_the_troubleshooting_page_exist() -> None:
    page = (DOCS / "troubleshooting.md").read_text()
    messages = re.findall(r"^\| `(.+?)` \|", page, re.MULTILINE)
    assert len(messages) > 10
    parsed = (ast.parse(file.read_text()) for file in (ROOT / "energyplan").rglob("*.py"))
    texts = [
        node.value for tree in parsed for node in ast.walk(tree)
        if isinstance(node, ast.Constant) and isinstance(node.value, str)
    ]  # fmt: skip
    assert [one for one in messages if not any(one in text for text in texts)] == []
