"""Kernels: what runs is what the sources say, wherever machine code can be kept or not."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import energyplan
from energyplan.compilation import cache_folder
from energyplan.compilation.cache import source_digest

PACKAGE = Path(energyplan.__file__).parent

CALL = """
from energyplan.compilation import on_compile
from energyplan.small import outer
compiled = []
on_compile(lambda what: compiled.append(what.name.rpartition(".")[2]))
print(outer(2.0), *compiled)
"""


def run(
    code: str, *, path: Path = PACKAGE.parent, **environment: str
) -> subprocess.CompletedProcess:
    """Run a program in a process of its own."""
    outside = {k: v for k, v in os.environ.items() if k not in ("HOME", "XDG_CACHE_HOME")}
    return subprocess.run(
        [sys.executable, "-P", "-c", code],
        env={**outside, "PYTHONPATH": str(path), **environment},
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )


@pytest.fixture
def copy(tmp_path: Path) -> Path:
    """Folder with a copy of the package and three kernels more, each calling the next one."""
    target = tmp_path / "copy"
    ignored = shutil.ignore_patterns("__pycache__", "bundle")
    shutil.copytree(PACKAGE, target / "energyplan", ignore=ignored)
    small = {
        "small": "from energyplan.middle import middle\n\n\n@njit\n"
        "def outer(x: float) -> float:\n    return 1.0 + middle(x)\n",
        "middle": "from energyplan.deep import deep\n\n\n@inner\n"
        "def middle(x: float) -> float:\n    return 10.0 * deep(x)\n",
        "deep": "\n\n@inner\ndef deep(x: float) -> float:\n    return x + 1.0\n",
    }
    for name, text in small.items():
        head = "from energyplan.compilation import inner, njit  # noqa\n"
        (target / "energyplan" / f"{name}.py").write_text(head + text)
    return target


def test_an_edit_two_calls_away_changes_what_runs(copy: Path, tmp_path: Path) -> None:
    kept = str(tmp_path / "kept")
    first = run(CALL, path=copy, ENERGYPLAN_CACHE_DIR=kept)
    assert first.stdout.split() == ["31.0", "outer", "middle", "deep"], first.stderr
    assert run(CALL, path=copy, ENERGYPLAN_CACHE_DIR=kept).stdout.split() == ["31.0"]
    deep = copy / "energyplan" / "deep.py"
    before = deep.stat()
    deep.write_text(deep.read_text().replace("x + 1.0", "x + 2.0"))
    os.utime(deep, ns=(before.st_atime_ns, before.st_mtime_ns))  # the content counts, not the time
    assert run(CALL, path=copy, ENERGYPLAN_CACHE_DIR=kept).stdout.split()[0] == "41.0"


def test_an_edit_elsewhere_changes_nothing(copy: Path, tmp_path: Path) -> None:
    kept = str(tmp_path / "kept")
    run(CALL, path=copy, ENERGYPLAN_CACHE_DIR=kept)
    with (copy / "energyplan" / "demo.py").open("a") as file:
        file.write("\n# an edit\n")
    assert run(CALL, path=copy, ENERGYPLAN_CACHE_DIR=kept).stdout.split() == ["31.0"]


def test_the_digest_follows_imports_of_every_form(copy: Path) -> None:
    package = copy / "energyplan"
    for line in (
        "from energyplan.deep import deep",
        "from energyplan import deep",
        "from energyplan import (\n    errors,\n    deep as other,\n)",
        "def later():\n    from energyplan.deep import deep",
    ):
        (package / "small.py").write_text(line + "\n")
        (package / "deep.py").write_text("a = 1\n")
        code = "from pathlib import Path\nfrom energyplan.compilation.cache import source_digest\n"
        code += f"print(source_digest(Path({str(package / 'small.py')!r})))"
        before = run(code, path=copy).stdout
        (package / "deep.py").write_text("a = 2\n")
        assert before
        assert run(code, path=copy).stdout != before, line


def test_a_damaged_file_is_a_miss(copy: Path, tmp_path: Path) -> None:
    kept = tmp_path / "kept"
    run(CALL, path=copy, ENERGYPLAN_CACHE_DIR=str(kept))
    files = sorted(kept.rglob("*.nbc"))
    assert len(files) == 3
    for content in (b"no machine code", files[0].read_bytes()[:-100]):
        for file in files:
            file.write_bytes(content)
        again = run(CALL, path=copy, ENERGYPLAN_CACHE_DIR=str(kept))
        assert again.stdout.split() == ["31.0", "outer", "middle", "deep"], again.stderr
        assert again.stderr == ""
        assert run(CALL, path=copy, ENERGYPLAN_CACHE_DIR=str(kept)).stdout.split() == ["31.0"]


@pytest.fixture
def unwritable(tmp_path: Path) -> str:
    """A place where nobody can make a folder, not even the superuser: below a file."""
    (tmp_path / "file").write_text("")
    return str(tmp_path / "file" / "kept")


def test_without_a_folder_the_library_warns_once_and_works(copy: Path, unwritable: str) -> None:
    found = run(CALL, path=copy, ENERGYPLAN_CACHE_DIR=unwritable)
    assert found.stdout.split()[0] == "31.0"
    assert found.stderr.count("KernelCacheWarning") == 1
    assert unwritable in found.stderr
    assert "ENERGYPLAN_CACHE_DIR" in found.stderr


def test_without_a_home_machine_code_is_kept_among_temporary_files(tmp_path: Path) -> None:
    code = (
        "import os, pathlib\n"
        "def no_home(): raise RuntimeError('no home')\n"
        "pathlib.Path.home = no_home\n"
        "from energyplan.compilation import cache_folder\n"
        "print(cache_folder())\n"
        "del os.getuid\n"
        "print(cache_folder())"
    )
    found = run(code, TMPDIR=str(tmp_path)).stdout.split()
    assert found == [str(tmp_path / f"energyplan-{os.getuid()}"), str(tmp_path / "energyplan")]


def test_the_command_line_says_it_in_one_line(unwritable: str, tmp_path: Path) -> None:
    trajectory = tmp_path / "trajectory.csv"
    trajectory.write_text("t,x,y,yaw,v,omega\n0,0,0,0,0.5,0\n1,0.5,0,0,0.5,0\n2,1,0,0,0.5,0\n")
    code = "import sys\nfrom energyplan.cli import main\nsys.argv[1:] = "
    code += repr(["check", str(trajectory), "--model", "quadriga:empty:concrete", "--json"])
    found = run(code + "\nmain()", ENERGYPLAN_CACHE_DIR=unwritable)
    assert found.returncode == 0
    assert found.stdout.startswith("{")
    (line,) = found.stderr.splitlines()
    assert line.startswith("energyplan: compiled kernels cannot be kept in " + unwritable)


def test_the_folder_is_where_the_environment_says(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", "/somewhere")
    monkeypatch.delenv("ENERGYPLAN_CACHE_DIR", raising=False)
    assert cache_folder() == Path("/somewhere/energyplan")
    monkeypatch.setenv("ENERGYPLAN_CACHE_DIR", "/elsewhere")
    assert cache_folder() == Path("/elsewhere")


def test_without_compilation_kernels_are_plain_functions() -> None:
    found = run(
        "from energyplan.planning.scene.field import angle_between\n"
        "from energyplan.compilation import compile_kernels\n"
        "print(angle_between(1.0, 2.0), compile_kernels('energyplan').compiled)",
        NUMBA_DISABLE_JIT="1",
    )
    assert found.stdout.split() == ["1.0", "()"], found.stderr


def test_the_digest_is_that_of_one_source() -> None:
    here = source_digest(PACKAGE / "planning" / "scene" / "field.py")
    assert here == source_digest(PACKAGE / "planning" / "scene" / "field.py")
    assert here != source_digest(PACKAGE / "planning" / "scene" / "motions.py")
