"""Kernels: what runs is what the sources say, wherever machine code can be kept or not."""

from __future__ import annotations

import contextlib
import importlib
import json
import os
import re
import shutil
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Annotated, Any, TypeVar

import numba
import numpy as np
import pytest
from numpy.typing import NDArray
from typing_extensions import TypeAliasType

import energyplan
from energyplan import cli
from energyplan.compilation import cache_folder, kernel_modules
from energyplan.compilation.cache import source_digest
from energyplan.compilation.kernel import KERNELS, _numba_type
from energyplan.compilation.pool import Pool

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
    inherited = {k: v for k, v in os.environ.items() if k != "ENERGYPLAN_CACHE_DIR"}
    return subprocess.run(
        [sys.executable, "-P", "-c", code],
        env={**inherited, "PYTHONPATH": str(path), **environment},
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
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
    # Python's own bytecode goes by the time of a file
    kept = {"ENERGYPLAN_CACHE_DIR": str(tmp_path / "kept"), "PYTHONDONTWRITEBYTECODE": "1"}
    first = run(CALL, path=copy, **kept)
    assert first.stdout.split() == ["31.0", "outer", "middle", "deep"], first.stderr
    assert run(CALL, path=copy, **kept).stdout.split() == ["31.0"]
    deep = copy / "energyplan" / "deep.py"
    before = deep.stat()
    deep.write_text(deep.read_text().replace("x + 1.0", "x + 2.0"))
    os.utime(deep, ns=(before.st_atime_ns, before.st_mtime_ns))  # the content counts, not the time
    assert run(CALL, path=copy, **kept).stdout.split()[0] == "41.0"


def test_an_edit_elsewhere_changes_nothing(copy: Path, tmp_path: Path) -> None:
    kept = str(tmp_path / "kept")
    run(CALL, path=copy, ENERGYPLAN_CACHE_DIR=kept)
    with (copy / "energyplan" / "demo.py").open("a") as file:
        file.write("\n# an edit\n")
    assert run(CALL, path=copy, ENERGYPLAN_CACHE_DIR=kept).stdout.split() == ["31.0"]


def test_the_digest_follows_imports_of_every_form(copy: Path) -> None:
    package = copy / "energyplan"
    lines = (
        "from energyplan.deep import deep",
        "from energyplan import deep",
        "from energyplan import (\n    errors,\n    deep as other,\n)",
        "def later():\n    from energyplan.deep import deep",
        "from energyplan import errors",
    )
    code = "from pathlib import Path\nfrom energyplan.compilation.cache import source_digest\n"
    code += f"small, deep = (Path({str(package)!r}, name) for name in ('small.py', 'deep.py'))\n"
    code += f"for line in {lines!r}:\n    small.write_text(line + '\\n')\n    found = []\n"
    code += "    for text in ('a = 1', 'a = 2'):\n        deep.write_text(text)\n"
    code += "        found.append(source_digest(small))\n    print(found[0] != found[1])"
    found = run(code, path=copy)
    assert found.stdout.split() == ["True"] * 4 + ["False"], found.stderr


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


LONG = """
from energyplan.compilation import on_compile
from energyplan.compilation.cache import ADDRESSED
from energyplan.calls import one, other
compiled = []
on_compile(lambda what: compiled.append(what.name.rpartition(".")[2]))
print(one(0.5) == one.py_func(0.5), other(0.5) == other.py_func(0.5), end=" ")
print(*sorted(name.rpartition(".")[2] for name in ADDRESSED.values()), end=": ")
print(*compiled)
"""


@pytest.fixture
def calls(copy: Path) -> Path:
    """Folder of the copy with two kernels that call a kernel too long to be copied into them."""
    steps = "".join(f"    x = math.sin(x) + {k}.0 * abs(x)\n" for k in range(40))
    (copy / "energyplan" / "calls.py").write_text(
        "import math\nfrom energyplan.compilation import inner, njit\n\n\n"
        f"@inner\ndef long(x: float) -> float:\n{steps}    return x\n\n\n"
        "@inner\ndef between(x: float) -> float:\n    return 2.0 * long(x)\n\n\n"
        "@njit\ndef one(x: float) -> float:\n    return 1.0 + between(x)\n\n\n"
        "@njit\ndef other(x: float) -> float:\n    return 3.0 * long(x)\n"
    )
    return copy


def test_a_long_kernel_is_called_not_copied_and_compiled_anew_where_it_is_no_more(
    calls: Path, tmp_path: Path
) -> None:
    """LLVM ends the process where a symbol is missing."""
    kept = tmp_path / "kept"
    first = run(LONG, path=calls, ENERGYPLAN_CACHE_DIR=str(kept))
    assert first.stdout.strip() == "True True long: one between long other", first.stderr
    (file,) = kept.rglob("energyplan.calls.long-*.nbc")
    for lose in (file.unlink, lambda: file.write_bytes(b"no machine code")):
        lose()
        found = run(LONG, path=calls, ENERGYPLAN_CACHE_DIR=str(kept))
        assert found.stdout.startswith("True True long: "), found.stderr
        assert "long" in found.stdout.split(": ")[1].split()
    again = run(LONG, path=calls, ENERGYPLAN_CACHE_DIR=str(kept))
    assert again.stdout.strip() == "True True long:", again.stderr
    # another process has compiled it for itself meanwhile, under another symbol
    alone = "from energyplan.compilation.kernel import KERNELS\nimport energyplan.calls\n"
    alone += "import energyplan.deep\nKERNELS['energyplan.deep.deep'].prepare()\n"
    alone += "KERNELS['energyplan.calls.long'].prepare()"
    file.unlink()
    run(alone, path=calls, ENERGYPLAN_CACHE_DIR=str(kept))
    found = run(LONG, path=calls, ENERGYPLAN_CACHE_DIR=str(kept))
    assert found.stdout.startswith("True True long: one"), found.stdout + found.stderr


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
    told = [line for line in found.stderr.splitlines() if "kernels" in line]
    assert len(told) == 1
    assert told[0].startswith("energyplan: compiled kernels cannot be kept in " + unwritable)
    assert "Warning" not in found.stderr


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


# -- ahead of the first call ----------------------------------------------------------------------

MANY = """
from energyplan.compilation import compile_kernels, on_compile
from energyplan.compilation import ahead
import energyplan.many
steps = []
on_compile(steps.append)
made = compile_kernels("energyplan.many", "energyplan.deep", processes=2)
print(len(made.compiled), made.found, made.processes, made.kept, energyplan.many.top(1.0))
print(*sorted(k.name.rpartition(".")[2] for k in made.compiled))
print(all(s.total == len(made.compiled) for s in steps), len(steps), [s.done for s in steps][-1:])
"""
"""Seven kernels: one calls five, each of which calls the seventh."""


@pytest.fixture
def many(copy: Path) -> Path:
    parts = "".join(
        f"@inner\ndef part{k}(x: float) -> float:\n    return {k}.0 * deep(x)\n\n\n"
        for k in range(5)
    )
    total = " + ".join(f"part{k}(x)" for k in range(5))
    (copy / "energyplan" / "many.py").write_text(
        "from energyplan.compilation import inner, njit\nfrom energyplan.deep import deep\n\n\n"
        f"{parts}@njit\ndef top(x: float) -> float:\n    return {total}\n"
    )
    return copy


def test_kernels_are_compiled_ahead_side_by_side(many: Path, tmp_path: Path) -> None:
    kept = str(tmp_path / "kept")
    first = run(MANY, path=many, ENERGYPLAN_CACHE_DIR=kept).stdout.splitlines()
    assert first[0] == "7 0 2 True 20.0"
    assert first[1] == "deep part0 part1 part2 part3 part4 top"
    assert first[2] == "True 8 [7]"  # each as it begins, and the end
    again = run(MANY, path=many, ENERGYPLAN_CACHE_DIR=kept).stdout.splitlines()
    assert again[0] == "0 7 1 True 20.0"


def test_without_a_second_process_the_first_does_it_all(many: Path, tmp_path: Path) -> None:
    for nobody in ("/nowhere/python", "/bin/false"):
        code = f"import sys\nsys.executable = {nobody!r}\n" + MANY
        found = run(
            code, path=many, ENERGYPLAN_CACHE_DIR=str(tmp_path / nobody[1:].replace("/", ""))
        )
        assert found.stdout.startswith("7 0 2 True 20.0\n"), found.stderr


def test_where_nothing_can_be_kept_one_process_compiles(many: Path, unwritable: str) -> None:
    found = run(MANY, path=many, ENERGYPLAN_CACHE_DIR=unwritable)
    assert found.stdout.startswith("7 0 1 False 20.0\n"), found.stderr
    assert found.stderr.count("KernelCacheWarning") == 1


BESIDE = """
from energyplan.compilation import compile_kernels, compiling_beside, on_compile
import energyplan.many
names = []
on_compile(lambda what: names.append(what.name.rpartition(".")[2]))
with compiling_beside("energyplan.many", "energyplan.deep"):
    print(energyplan.many.top(1.0))
print(*sorted(names))
print(compile_kernels("energyplan.many", "energyplan.deep").found)
"""


def test_what_is_called_while_others_compile_is_compiled_once(many: Path, tmp_path: Path) -> None:
    """Who is told of a kernel compiles it: there is each of them once, wherever it was compiled."""
    found = run(BESIDE, path=many, ENERGYPLAN_CACHE_DIR=str(tmp_path / "kept"))
    assert found.stdout.splitlines() == ["20.0", "deep part0 part1 part2 part3 part4 top", "7"], (
        found.stderr
    )
    alone = f"import sys\nsys.executable = {'/bin/false'!r}\n" + BESIDE
    found = run(alone, path=many, ENERGYPLAN_CACHE_DIR=str(tmp_path / "other"))
    assert found.stdout.splitlines()[0] == "20.0", found.stderr
    assert found.stdout.splitlines()[2] == "7"


AHEAD = """
from energyplan.compilation import compile_kernels, compiling_beside
import energyplan.many
with compiling_beside("energyplan.many", all_ahead=True):
    made = compile_kernels("energyplan.deep")
    print(*sorted(k.name.rpartition(".")[2] for k in made.compiled))
print(compile_kernels("energyplan.deep").found)
"""


@pytest.mark.parametrize("processors", [1, 2])
def test_what_is_wanted_ahead_is_compiled_when_anything_is(
    many: Path, tmp_path: Path, processors: int
) -> None:
    """The kernel that is asked for, and beside it the one that calls all others."""
    code = f"from energyplan.compilation import ahead\nahead._processes = lambda: {processors}\n"
    found = run(code + AHEAD, path=many, ENERGYPLAN_CACHE_DIR=str(tmp_path / "kept"))
    expected = ["deep part0 part1 part2 part3 part4 top", "1"]
    assert found.stdout.splitlines() == expected, found.stderr


def test_an_error_ends_the_others_at_once(many: Path, tmp_path: Path) -> None:
    """Nobody who mistyped a pose waits until a kernel is compiled that nobody needs."""
    code = (
        "import threading\nimport energyplan.many\n"
        "from energyplan.compilation import compiling_beside, on_compile\n"
        "from energyplan.compilation import ahead\nahead._processes = lambda: 2\n"
        "ahead._WORK = 'import time; time.sleep(1000.0)'\n"
        "begun = threading.Event()\non_compile(lambda what: begun.set())\n"
        "with compiling_beside('energyplan.many'):\n    begun.wait()\n"
        "    raise ValueError('a mistyped pose')\n"
    )
    found = run(code, path=many, ENERGYPLAN_CACHE_DIR=str(tmp_path / "kept"))
    assert "a mistyped pose" in found.stderr


CODE = """
import hashlib
import re
from energyplan.compilation import shortcuts
from energyplan.compilation.kernel import KERNELS, _numba_type
shortcuts.TRIED = {tried}
import energyplan.limits.motor_kernels
for kernel in [k for name, k in KERNELS.items() if name.endswith({kernels})]:
    kernel.prepare()
for name, kernel in sorted(KERNELS.items()):
    for made in kernel.overloads.values():
        code = str(made.library.get_function(made.fndesc.llvm_func_name))
        # constants may be named by the address at which they were made
        code = re.sub(r"picklebuf[.][0-9]+", "picklebuf", code)
        print(name, hashlib.sha256(code.encode()).hexdigest())
"""


@pytest.mark.parametrize(
    ("kernels", "least"),
    [
        (("._onesided", ".energy_drawn", ".window_mean"), 3),
        pytest.param(("",), 5, marks=pytest.mark.nightly),
    ],
)
def test_machine_code_is_the_same_without_shortcuts(
    kernels: tuple[str, ...], least: int, tmp_path: Path
) -> None:
    """As with a release of Numba that nobody has tried."""
    made = [
        run(
            CODE.format(tried=tried, kernels=kernels), ENERGYPLAN_CACHE_DIR=str(tmp_path / str(k))
        ).stdout
        for k, tried in enumerate(("shortcuts.TRIED", "((0, 0), (0, 1))"))
    ]
    assert made[0].count("\n") >= least
    assert made[0] == made[1]


class Fake:
    """What a pool knows of a kernel."""

    def __init__(self, name: str, *called: Fake) -> None:
        self.name, self.called = name, called
        self.py_func = Fake.__init__


def pool_of(*kernels: Fake) -> Pool:
    pool = Pool(lambda name, done, total: None)
    pool.add(kernels, urgent=False)
    return pool


def test_a_pool_hands_out_what_is_called_first_and_what_is_urgent_before_the_rest() -> None:
    deep = Fake("deep")
    top, other = Fake("top", deep), Fake("other")
    pool = pool_of(other, deep, top)
    assert pool.take() is deep  # the longest chain first
    assert pool.take() is other
    late = Fake("late")
    pool.add([late], urgent=True)
    pool.end(deep, 1.0)
    assert [pool.take().name, pool.take().name] == ["late", "top"]
    assert pool.total == 4


def test_a_pool_has_this_process_wait_for_another_one_that_has_begun() -> None:
    kernel, failed, untouched = Fake("kernel"), Fake("failed"), Fake("untouched")
    pool = pool_of(kernel, failed, untouched)
    taken = {pool.take(), pool.take()}
    assert taken == {kernel, failed}
    with ThreadPoolExecutor(2) as threads:
        waits, loses = threads.submit(pool.claim, kernel), threads.submit(pool.claim, failed)
        pool.give_back(failed)
        assert loses.result() is False  # to be compiled here
        assert not waits.done()
        pool.end(kernel, 1.0)
        assert waits.result() is True  # to be loaded
    assert pool.claim(untouched) is False
    assert pool.take(until=[kernel]) is None  # nothing is left, here or elsewhere
    pool.stop()
    assert pool.take() is None


def test_two_programs_may_compile_at_once(many: Path, tmp_path: Path) -> None:
    environment = {
        **os.environ, "PYTHONPATH": str(many), "ENERGYPLAN_CACHE_DIR": str(tmp_path / "kept")
    }  # fmt: skip
    both = [
        subprocess.Popen(
            [sys.executable, "-P", "-c", MANY],
            env=environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        for _ in range(2)
    ]
    for process in both:
        out, err = process.communicate(timeout=120)
        assert out.splitlines()[0].endswith("True 20.0"), err
        assert err == ""
    assert not list((tmp_path / "kept").rglob("tmp*"))


def test_a_terminal_is_told_what_is_compiled(many: Path, tmp_path: Path) -> None:
    pty = pytest.importorskip("pty")
    theirs, ours = pty.openpty()
    code = (
        "from energyplan.cli.answers import progress\n"
        "with progress('planning'):\n"
        "    from energyplan.compilation import compile_kernels\n"
        "    import energyplan.many\n"
        "    compile_kernels('energyplan.many', processes=1)\n"
    )
    environment = {
        **os.environ, "PYTHONPATH": str(many), "ENERGYPLAN_CACHE_DIR": str(tmp_path / "kept"),
        "TERM": "xterm", "COLUMNS": "100",
    }  # fmt: skip
    with subprocess.Popen(
        [sys.executable, "-P", "-c", code], env=environment, stderr=ours, stdout=subprocess.DEVNULL
    ) as process:
        os.close(ours)
        seen = b""
        with contextlib.suppress(OSError):  # at its end a terminal says so
            while part := os.read(theirs, 4096):
                seen += part
        os.close(theirs)
    assert process.returncode == 0
    assert re.search(rb"preparing, once: \d of 7 kernels", seen), seen


def test_every_kernel_has_one_signature() -> None:
    """An annotation that stands for no one type would have the kernel compiled at its call."""
    for name in kernel_modules():
        importlib.import_module(name)
    assert len(KERNELS) > 100
    assert [kernel.name for kernel in KERNELS.values() if kernel.declared is None] == []


@pytest.mark.parametrize("number", [np.float64, np.float32, np.int8, np.bool_])
def test_annotations_mean_the_same_with_each_kind_of_alias(number: type[np.generic]) -> None:
    """`NDArray` has become an alias by the ``type`` statement, where Python has that."""
    number_type = TypeVar("number_type", bound=np.generic)
    of_statement = TypeAliasType(
        "Array", np.ndarray[Any, np.dtype[number_type]], type_params=(number_type,)
    )
    plain = np.ndarray[Any, np.dtype[number]]
    expected = numba.types.Array(numba.np.numpy_support.from_dtype(np.dtype(number)), 2, "C")
    for array in (NDArray[number], plain, of_statement[number]):
        assert _numba_type(Annotated[array, 2]) == expected


def test_warmup_compiles_and_tells_what(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("ENERGYPLAN_CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(
        "energyplan.compilation.kernel_modules", lambda: ["energyplan.planning.scene.field"]
    )
    monkeypatch.setattr(sys, "argv", ["energyplan", "warmup", "--json"])
    with pytest.raises(SystemExit) as end:
        cli.main()
    assert end.value.code == 0
    told = json.loads(capsys.readouterr().out)
    assert told["folder"] == str(tmp_path)
    assert told["kept"] is True
    assert len(told["compiled"]) + told["found"] > 0


# -- nothing is compiled while the clock runs -----------------------------------------------------

WATCH = """
import numpy as np
import shapely
import energyplan as ep
from numba.core import event
from energyplan.compilation.kernel import KERNELS, _numba_type
from energyplan.mission.legs import compiling
from energyplan.planning import ready
from energyplan.power import HOTEL
from energyplan.studies.energy_map import energy_map
from energyplan.terrain import HeightMap, Surface, SurfaceMap

MODEL = ep.PowerModel.preset("quadriga:empty:concrete")
COST = ep.EnergyCost(MODEL)
HOTEL_COST = ep.EnergyCost(MODEL.with_term(HOTEL, 80.0))
UPHILL = ep.EnergyCost(ep.power.effects.with_weight(MODEL))


class Listener(event.Listener):
    seen = []
    def on_start(self, e):
        self.seen.append(e.data["dispatcher"].py_func.__qualname__)
    def on_end(self, e):
        pass


def problem(cost=COST, size=100, resolution=0.1, start=(1.5, 1.5, 0.0), **more):
    blocked = np.zeros((size, size), bool)
    blocked[size // 3 : size // 3 + 3, : 2 * size // 3] = True
    far = size * resolution - 1.5
    grid = ep.OccupancyGrid(blocked, resolution)
    return ep.PlanningProblem(grid, cost, start, (1.5, far, 2.0), **more)


rough = ep.PowerModel.preset("quadriga:full:concrete")
surfaces = SurfaceMap((Surface(shapely.box(0.0, 4.0, 9.0, 6.0), rough),))
hill = HeightMap(0.2 * np.add.outer(np.arange(24), np.zeros(24)) ** 0.5, 0.5)
KINDS = {
    "plain": lambda: problem(),
    "surfaces": lambda: problem(surfaces=surfaces),
    "heights": lambda: problem(UPHILL, heights=hill),
    "speed": lambda: problem(HOTEL_COST),
    "length": lambda: problem(objective="length"),
    "time": lambda: problem(objective={"energy": 1.0, "time": 20.0}),
    "tight": lambda: problem(start=(1.5, 3.297 - MODEL.vehicle.footprint[:, 1].max(), 0.0)),
    "big": lambda: problem(size=500, resolution=0.2),
}
late = []
at_rest = []
original = ready.compile_kernels


def watched(*modules):
    made = original(*modules)
    Listener.seen.clear()
    at_rest[:] = [{name: set(kernel.overloads) for name, kernel in KERNELS.items()}]
    return made


ready.compile_kernels = watched
event.register("numba:compile", Listener())
for planner, name in WAYS:
    kind = KINDS[name]()
    if planner == "compare":
        assert ep.compare(kind, effort=5_000).saving >= -1e-9
    elif planner == "range":
        energy_map(kind, energy=2e3)
        Listener.seen.clear()  # no clock runs: what it calls may be compiled then
        at_rest[:] = [{name: set(kernel.overloads) for name, kernel in KERNELS.items()}]
        assert any(found for n, found in at_rest[0].items() if n.startswith(ready.SEARCHED))
    elif planner == "mission":
        task = ep.Task("look", kind.goal)
        pack = ep.Battery.preset("quadriga")
        asked = ep.Mission(
            MODEL, kind.map, pack, kind.start, [task], planning_effort=1_000, confidence=0.5
        )
        with compiling(asked):
            ready.compile_kernels()
            ready.compile_kernels = original  # from here on nothing is to be loaded
            assert ep.evaluate(asked).feasible
            ready.compile_kernels = watched
    elif planner == "drive":
        with ready.compiling(kind):
            made = ep.plan(kind, effort=1_000)
        assert made.driven.energy > 0
    else:
        assert ep.plan(kind, planner=planner, effort=5_000).energy > 0
    late = [n for n, k in KERNELS.items() if set(k.overloads) - at_rest[0].get(n, set())]
    print(planner, name, "late:", *late, *Listener.seen)
"""
"""Plan in ways, and print what was loaded or compiled after the planner said that all is ready."""

WAYS = {
    "static": [
        ("range", "plain"), ("mission", "plain"),
        *(("lattice", kind) for kind in ("plain", "tight", "surfaces", "heights", "length")),
        ("lattice", "time"),
        ("compare", "surfaces"), ("roadmap", "plain"), ("bitstar", "surfaces"),
        ("drive", "plain"),
    ],
    "with exact steering": [("lattice", "speed")],
}  # fmt: skip
"""Ways whose kernels are the same: what one of them has loaded late, none before it has."""


@pytest.mark.parametrize("kernels", WAYS)
def test_nothing_is_compiled_while_the_clock_runs(kernels: str) -> None:
    ways = WAYS[kernels]
    found = run(WATCH.replace("WAYS", repr(ways)), ENERGYPLAN_CACHE_DIR=str(cache_folder()))
    expected = [f"{planner} {kind} late:" for planner, kind in ways]
    assert found.stdout.splitlines() == expected, found.stdout + found.stderr


AT_OBSTACLE = """
import numpy as np
import energyplan as ep
from energyplan.compilation import on_compile
compiled = []
on_compile(lambda what: compiled.append(what.name))
blocked = np.zeros((60, 60), bool)
blocked[20:40, 20:40] = True
cost = ep.EnergyCost(ep.PowerModel.preset("quadriga:empty:concrete"))
grid = ep.OccupancyGrid(blocked, 0.1)
try:
    ep.plan(ep.PlanningProblem(grid, cost, (3, 3, 0), (5, 5, 0)), planner=NAME)
except ep.errors.StartInCollisionError as error:
    print("told", *{name.rpartition(".")[0] for name in compiled})
"""


@pytest.mark.parametrize("planner", ["lattice", pytest.param("bitstar", marks=pytest.mark.nightly)])
def test_who_starts_in_an_obstacle_is_told_so_at_once(planner: str, tmp_path: Path) -> None:
    code = AT_OBSTACLE.replace("NAME", repr(planner))
    found = run(code, ENERGYPLAN_CACHE_DIR=str(tmp_path))
    told, *modules = found.stdout.split()
    assert told == "told", found.stderr
    assert set(modules) <= {
        "energyplan.terrain.collision",
        "energyplan.terrain.updates",
        "energyplan.cost.direction_table",
    }
