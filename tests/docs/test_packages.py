"""What is published: one version, complete archives, what a release asks for, the image."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path
from xml.etree import ElementTree

import pytest
import yaml
from hatchling.builders.sdist import SdistBuilder
from hatchling.builders.wheel import WheelBuilder

import energyplan as ep
from energyplan.cli import commands

ROOT = Path(__file__).resolve().parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
ROS = ROOT / "ros"


def published() -> list[str]:
    """Return the files of the source archive."""
    files = SdistBuilder(str(ROOT)).recurse_included_files()
    return sorted(Path(file.path).relative_to(ROOT).as_posix() for file in files)


def test_every_package_and_the_citation_have_the_version_of_the_library() -> None:
    assert "version" in PROJECT["dynamic"]
    cited = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    stated = {file: ElementTree.parse(file).findtext("version") for file in ROS.rglob("*.xml")}
    stated |= {
        file: re.findall(r'version="(.*)"', file.read_text())[0] for file in ROS.rglob("setup.py")
    }
    assert len(stated) == 3
    assert {str(cited["version"]), *stated.values()} == {ep.__version__}
    changes = re.findall(r"^## (.*)", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE)
    assert ep.__version__ in changes[:2]
    own, *_ = PROJECT["license"].split(" AND ")  # what comes after is of vendored scripts
    assert cited["license"] == own


def test_the_address_that_the_owner_fills_in_stands_in_one_place() -> None:
    address = PROJECT["urls"]["Repository"]
    owner = re.fullmatch(r"https://github\.com/([\w-]+)/energyplan", address)
    assert owner
    place = f"{owner[1]}/energyplan".encode()
    assert [file for file in published() if place in (ROOT / file).read_bytes()] == [
        "pyproject.toml"
    ]


def test_the_archives_hold_what_runs_and_what_tests_it() -> None:
    needed = {
        ".ci/run", ".github/workflows/ci.yml", ".pre-commit-config.yaml", ".readthedocs.yaml",
        "CITATION.cff", "CONTRIBUTING.md", "Containerfile", "Makefile", "docs/conf.py",
        "examples/mission_yard.yaml", "maps/make_maps.py", "ros/energyplan_ros/package.xml",
        "requirements-test.lock", "benchmarks/right_seeds.txt", "tests/conftest.py",
    }  # fmt: skip
    assert needed - set(published()) == set()
    wheel = {file.distribution_path for file in WheelBuilder(str(ROOT)).recurse_included_files()}
    assert {path.partition("/")[0] for path in wheel} == {"energyplan"}
    bundled = {Path(path).name for path in wheel if path.startswith("energyplan/bundle/")}
    maps = {file.name for file in (ROOT / "maps").iterdir() if file.is_file()} - {"make_maps.py"}
    of_commands = {
        file.name for kind in ("yaml", "json") for file in (ROOT / "examples").glob(f"*.{kind}")
    }
    assert bundled == maps | of_commands
    assert {"energyplan/py.typed", "energyplan/__init__.pyi"} <= wheel


def test_an_installed_package_reads_its_own_files_not_those_beside_it(tmp_path: Path) -> None:
    """Many packages leave a folder `examples` or `maps` among the installed ones."""
    skipped = shutil.ignore_patterns("__pycache__")
    shutil.copytree(ROOT / "energyplan", tmp_path / "energyplan", ignore=skipped)
    shutil.copytree(ROOT / "maps", tmp_path / "energyplan" / "bundle")
    for name in ("maps", "examples"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "warehouse.yaml").write_text("another package's\n")
    asked = "from energyplan.io.files import bundle; print(*bundle().values(), sep='\\n')"
    done = subprocess.run(
        [sys.executable, "-c", asked], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    found = done.stdout.splitlines()
    assert {Path(file).parent for file in found} == {tmp_path.resolve() / "energyplan" / "bundle"}


FAULTS = {
    "": "",
    "energyplan/__init__.py": '__version__ = "9.8.70"\n',
    "CITATION.cff": "version: 9.8.6\n",
    "ros/energyplan_ros/package.xml": "<version>9x8.7</version>\n",
    "CHANGELOG.md": "# Changelog\n\n## Unreleased\n\n## 9.8.7\n",
    "pyproject.toml": '[project.urls]\nRepository = "https://github.com/OWNER/"\n',
    "the tree": "uncommitted",
    "the tag v9.8.7": "tag",
}
"""What stands in the way of release 9.8.7: the file at fault, and what it holds."""


@pytest.mark.skipif(not all(map(shutil.which, ("git", "make"))), reason="needs git and make")
@pytest.mark.parametrize("fault", FAULTS)
def test_a_release_waits_for_tree_versions_changelog_and_tag(tmp_path: Path, fault: str) -> None:
    sound = {
        "energyplan/__init__.py": '__version__ = "9.8.7"\n',
        "CITATION.cff": "version: 9.8.7\n",
        "ros/energyplan_interfaces/package.xml": "<version>9.8.7</version>\n",
        "ros/energyplan_ros/package.xml": "<version>9.8.7</version>\n",
        "ros/energyplan_ros/setup.py": 'version="9.8.7",\n',
        "CHANGELOG.md": "# Changelog\n\n## 9.8.7\n",
        "pyproject.toml": '[project.urls]\nRepository = "https://github.com/somebody/"\n',
    }
    for name, text in (sound | {fault: FAULTS[fault]} if fault in sound else sound).items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    shutil.copy(ROOT / "Makefile", tmp_path)
    git = ["git", "-c", "user.name=a", "-c", "user.email=a@example.org"]
    steps = [["init", "-q"], ["add", "."], ["commit", "-qm", "all"]]
    for step in [*steps, *([["tag", "v9.8.7"]] if FAULTS[fault] == "tag" else [])]:
        subprocess.run([*git, *step], cwd=tmp_path, check=True)
    if FAULTS[fault] == "uncommitted":
        (tmp_path / "new.txt").touch()
    call = ["make", "--no-print-directory", "release", "VERSION=9.8.7"]
    # a `make` that runs the tests hands its own flags to every child
    alone = {name: value for name, value in os.environ.items() if not name.startswith("MAKE")}
    done = subprocess.run(call, cwd=tmp_path, env=alone, capture_output=True, text=True)
    if fault:
        assert done.returncode != 0
        assert done.stderr.startswith(f"release: {fault}")
    else:
        assert (done.returncode, done.stderr) == (0, "")
        assert "git tag --annotate v9.8.7" in done.stdout


def _image() -> list[list[str]]:
    """Return the steps of the container's image, each as its words."""
    lines = (ROOT / "Containerfile").read_text().splitlines()
    return [shlex.split(line) for line in lines if line and not line.startswith("#")]


def test_the_image_copies_all_that_the_wheel_is_built_from() -> None:
    copied = [ROOT / name for step, *names in _image() if step == "COPY" for name in names[:-1]]
    assert all(path.exists() for path in copied)
    needed = [Path(file.path) for file in WheelBuilder(str(ROOT)).recurse_included_files()]
    needed += [ROOT / "pyproject.toml", ROOT / PROJECT["readme"]]
    needed += [file for pattern in PROJECT["license-files"] for file in ROOT.glob(pattern)]
    missing = [f for f in needed if not any(f == top or top in f.parents for top in copied)]
    assert missing == []


def test_the_image_starts_commands_with_options_that_exist() -> None:
    steps = _image()
    assert steps[-1][0] == "CMD"
    called = [words for step, *words in steps if step == "RUN"]
    called.append(re.findall(r'"(.*?)"', (ROOT / "Containerfile").read_text().split("CMD")[-1]))
    own = [words[1:] for words in called if words[0] == "energyplan"]
    for name, *options in own:
        commands().commands[name].make_context(name, options)
    assert [name for name, *_ in own] == ["warmup", "serve"]
    assert {words[0] for words in called} == {"pip", "useradd", "energyplan"}
    (installed,) = (words[-1] for words in called if words[0] == "pip")
    assert installed == ".[serve]"


def test_pages_install_extras_that_exist_and_one_page_lists_all() -> None:
    extras = set(PROJECT["optional-dependencies"])
    pages = [*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md"), *ROS.rglob("*.md")]
    for page in [*pages, ROOT / "Containerfile", ROOT / ".ci" / "run"]:
        named = re.findall(r"(?:\bpip.*|install )(?:energyplan|\.)\[([\w,]+)\]", page.read_text())
        assert {one for names in named for one in names.split(",")} <= extras, page
        # by its name it is installed from a folder of wheels alone
        named = re.findall(r"pip\s+install[^`\n]*energyplan\[[^`\n]*", page.read_text())
        assert [line for line in named if "--find-links" not in line] == [], page
    start = (ROOT / "docs" / "getting_started.md").read_text()
    table = start.partition("| extra |")[2].partition("\n\n")[0]
    assert set(re.findall(r"^\| `(\w+)`", table, re.MULTILINE)) == extras


def test_hooks_are_the_tools_of_lint() -> None:
    hooks = yaml.safe_load((ROOT / ".pre-commit-config.yaml").read_text())["repos"][0]["hooks"]
    used = {" ".join(hook["entry"].split()[:2]).removeprefix(".venv/bin/") for hook in hooks}
    recipe = re.search(r"^lint:.*\n((?:\t.*\n)+)", (ROOT / "Makefile").read_text(), re.MULTILINE)
    assert recipe
    lint = re.findall(r"\$\(BIN\)/([\w-]+(?: check| format)?)", recipe[1])
    assert used == set(lint)


def test_pages_are_built_elsewhere_as_here() -> None:
    there = yaml.safe_load((ROOT / ".readthedocs.yaml").read_text())
    assert there["sphinx"] == {"configuration": "docs/conf.py", "fail_on_warning": True}
    for step in there["python"]["install"]:
        assert (ROOT / (step.get("requirements") or step["path"])).exists()


@pytest.mark.parametrize("lock", sorted(ROOT.glob("requirements-*.lock")))
def test_a_lock_names_no_address_and_no_folder(lock: Path) -> None:
    text = lock.read_text()
    assert text.count("--hash=sha256:") > 100
    assert "://" not in text
    assert "file:" not in text
