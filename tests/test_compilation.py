"""Kernels: what runs is what the sources say, wherever machine code can be kept or not."""

from __future__ import annotations

import importlib
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Annotated, Any, TypeVar, get_type_hints

import commands
import numba
import numpy as np
import pytest
from numpy.typing import NDArray
from typing_extensions import TypeAliasType

import energyplan
from energyplan.compilation import (
    KERNELS,
    Kernel,
    LeanKernel,
    _numba_type,
    cache_folder,
    kernel_modules,
)

PACKAGE = Path(energyplan.__file__).parent

CALL = """
from energyplan.compilation import telling
from energyplan.small import outer
compiled = []
with telling(lambda name: compiled.append(name.rpartition(".")[2])):
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


def copied(target: Path) -> Path:
    """Copy the package to a folder, with three kernels more, each of which calls the next one."""
    ignored = shutil.ignore_patterns("__pycache__", "bundle")
    shutil.copytree(PACKAGE, target / "energyplan", ignore=ignored)
    small = {
        "small": "from energyplan.middle import middle\n\n\n@njit\n"
        "def outer(x: float) -> float:\n    return 1.0 + middle(x)\n",
        "middle": "from energyplan.deep import deep\n\n\n@njit\n"
        "def middle(x: float) -> float:\n    return 10.0 * deep(x)\n",
        "deep": "\n\n@njit\ndef deep(x: float) -> float:\n    return x + 1.0\n",
    }
    for name, text in small.items():
        head = "from energyplan.compilation import njit\n"
        (target / "energyplan" / f"{name}.py").write_text(head + text)
    return target


@pytest.fixture
def copy(tmp_path: Path) -> Path:
    return copied(tmp_path / "copy")


@pytest.fixture(scope="module")
def compiled(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with such a copy, and with a folder in which its three kernels are kept."""
    folder = tmp_path_factory.mktemp("compiled")
    kept = str(folder / "new" / "kept")
    first = run(CALL, path=copied(folder / "copy"), ENERGYPLAN_CACHE_DIR=kept)
    assert first.stdout.split() == ["31.0", "outer", "middle", "deep"], first.stderr
    return folder


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


DIGEST = """
from pathlib import Path
import energyplan
from energyplan import sources
root = Path(energyplan.__file__).parent
def digest(outer, deep):
    (root / "small.py").write_text(outer)
    (root / "deep.py").write_text(deep)
    sources._definitions.cache_clear()
    return sources.source_digest(root / "small.py", "outer")
"""


@pytest.mark.parametrize(
    "line",
    [
        "from energyplan.deep import deep\n",
        "from energyplan.deep import deep as other\ndeep = other\n",
        "from energyplan import deep\n",
        "from energyplan import (\n    errors,\n    deep as other,\n)\ndeep = other\n",
        "from energyplan.middle import deep\n",
        "def deep(x: float) -> float:\n    from energyplan.deep import deep\n    return deep(x)\n",
    ],
)
def test_the_digest_follows_imports_of_every_form(copy: Path, line: str) -> None:
    small = line + "def outer(x: float) -> float:\n    return deep(x)\n"
    deep = "def deep(x: float) -> float:\n    return x + {}\n"
    code = f"first, second = (digest({small!r}, {deep!r}.format(k)) for k in (1, 2))\n"
    found = run(DIGEST + code + "print(first != second)", path=copy)
    assert found.stdout.split() == ["True"], found.stderr


DEEP = """
STEP = 1.0
OTHER = 2.0
TABLE = [0.0]
TABLE[0] = STEP


class Pair(NamedTuple):
    low: float
    high: float


@njit
def deep(pair: Pair) -> float:
    return pair.low + STEP


def other() -> str:
    return "a word"
"""


@pytest.mark.parametrize(
    ("former", "new", "counts"),
    [
        ("STEP = 1.0", "STEP = 1.5", True),
        ("TABLE[0] = STEP", "TABLE[0] = 2.0", True),
        ("high: float", "high: int", True),
        ("pair.low + STEP", "pair.high + STEP", True),
        ("OTHER = 2.0", "OTHER = 2.5", False),
        ("a word", "another word", False),
        ("    low: float", '    """What it is."""\n\n    low: float  # [m]', False),
        ("    return pair.low", '    """Say what it does."""\n    return pair.low', False),
        ("STEP = 1.0", "\n\n# why\nSTEP = 1.0", False),
    ],
)
def test_the_digest_has_what_is_used_and_nothing_else(
    copy: Path, former: str, new: str, counts: bool
) -> None:
    assert former in DEEP
    outer = "from energyplan.deep import deep, other\ndef outer(x):\n    return deep(x)\n"
    code = f"print(digest({outer!r}, {DEEP!r}) != digest({outer!r}, {DEEP.replace(former, new)!r}))"
    found = run(DIGEST + code, path=copy)
    assert found.stdout.split() == [str(counts)], found.stderr


def test_a_message_of_an_error_recompiles_nothing(copy: Path) -> None:
    code = "from energyplan.compilation import kernel_digests\nprint(len(kernel_digests()))\n"
    code += "print(hash(tuple(sorted(kernel_digests().items()))))"
    for file in ("errors", "vehicle", "records"):
        place = copy / "energyplan" / f"{file}.py"
        first = run(code, path=copy, PYTHONHASHSEED="0").stdout.split()
        place.write_text(place.read_text() + "\n\ndef later() -> None:\n    pass\n")
        assert first[:1] > ["200"]
        assert run(code, path=copy, PYTHONHASHSEED="0").stdout.split() == first


def test_a_damaged_file_is_a_miss(compiled: Path, tmp_path: Path) -> None:
    copy, kept = compiled / "copy", tmp_path / "kept"
    shutil.copytree(compiled / "new" / "kept", kept)
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


NO_HOME = """
import os, pathlib
def no_home(): raise RuntimeError('no home')
pathlib.Path.home = no_home
"""


@pytest.mark.parametrize(
    ("before", "environment", "kept"),
    [
        ("", {"HOME": "", "XDG_CACHE_HOME": ""}, f"energyplan-{os.getuid()}"),
        ("", {"HOME": "", "XDG_CACHE_HOME": "here"}, f"energyplan-{os.getuid()}"),
        (NO_HOME, {"XDG_CACHE_HOME": ""}, f"energyplan-{os.getuid()}"),
        (NO_HOME + "del os.getuid\n", {"XDG_CACHE_HOME": ""}, "energyplan"),
    ],
)
def test_without_a_home_machine_code_is_kept_among_temporary_files(
    tmp_path: Path, before: str, environment: dict[str, str], kept: str
) -> None:
    code = before + "from energyplan.compilation import cache_folder\nprint(cache_folder())"
    found = run(code, TMPDIR=str(tmp_path), **environment).stdout.split()
    assert found == [str(tmp_path / kept)]


@pytest.mark.parametrize("inner", [False, True])
@pytest.mark.parametrize(
    ("mode", "owner", "told"),
    [
        (0o777, None, "others may write"),
        (0o770, None, "others may write"),
        (0o700, 12345, "user 12345 owns it"),
    ],
)
def test_code_that_others_could_have_written_is_not_run(
    compiled: Path, tmp_path: Path, mode: int, owner: int | None, told: str, inner: bool
) -> None:
    """Code is kept in a folder for this user alone; planted code would print another number."""
    copy, kept = compiled / "copy", tmp_path / "kept"
    shutil.copytree(compiled / "new" / "kept", kept)
    folders = [kept, *(one for one in kept.iterdir() if one.is_dir())]
    assert {folder.stat().st_mode & 0o777 for folder in folders} == {0o700}
    if owner is not None and os.getuid() != 0:
        pytest.skip("only the superuser gives a folder away")
    for folder in folders[1:] if inner else folders[:1]:
        os.chown(folder, owner or os.getuid(), -1)
        folder.chmod(mode)
    found = run(CALL, path=copy, ENERGYPLAN_CACHE_DIR=str(kept))
    assert found.stdout.split()[:2] == ["31.0", "outer"]  # compiled anew
    assert found.stderr.count("KernelCacheWarning") == 1 and told in found.stderr, found.stderr


def test_a_file_of_another_user_is_not_run(compiled: Path, tmp_path: Path) -> None:
    """A folder that was taken back from others may still hold what they planted."""
    if os.getuid() != 0:
        pytest.skip("only the superuser gives a file away")
    copy, kept = compiled / "copy", tmp_path / "kept"
    shutil.copytree(compiled / "new" / "kept", kept)
    for file in (kept / "kernels").iterdir():
        os.chown(file, 12345, -1)
    found = run(CALL, path=copy, ENERGYPLAN_CACHE_DIR=str(kept))
    assert found.stdout.split()[:2] == ["31.0", "outer"]  # compiled anew
    assert "user 12345 owns a file in it; delete it" in found.stderr


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


def test_without_compilation_kernels_are_plain_functions() -> None:
    found = run(
        "from energyplan.planning.space.queues import angle_between\n"
        "from energyplan.compilation import compile_kernels\n"
        "print(angle_between(1.0, 2.0), compile_kernels('energyplan').compiled)",
        NUMBA_DISABLE_JIT="1",
    )
    assert found.stdout.split() == ["1.0", "()"], found.stderr


# -- ahead of the first call ----------------------------------------------------------------------

MANY = """
from energyplan.compilation import compile_kernels, telling
import energyplan.compilation
import energyplan.many
energyplan.compilation.processors = lambda: 2
with telling(lambda name: None):
    made = compile_kernels("energyplan.many", "energyplan.deep")
print(len(made.compiled), made.found, made.processes, made.kept, energyplan.many.top(1.0))
print(*sorted(name.rpartition(".")[2] for name in made.compiled))
"""
"""Seven kernels: one calls five, each of which calls the seventh."""


@pytest.fixture
def many(copy: Path) -> Path:
    parts = "".join(
        f"@njit\ndef part{k}(x: float) -> float:\n    return {k}.0 * deep(x)\n\n\n"
        for k in range(5)
    )
    total = " + ".join(f"part{k}(x)" for k in range(5))
    (copy / "energyplan" / "many.py").write_text(
        "from energyplan.compilation import njit\nfrom energyplan.deep import deep\n\n\n"
        f"{parts}@njit\ndef top(x: float) -> float:\n    return {total}\n"
    )
    return copy


def test_kernels_are_compiled_ahead_side_by_side(many: Path, tmp_path: Path) -> None:
    kept = str(tmp_path / "kept")
    first = run(MANY, path=many, ENERGYPLAN_CACHE_DIR=kept).stdout.splitlines()
    assert first[0] == "7 0 2 True 20.0"
    assert first[1] == "deep part0 part1 part2 part3 part4 top"
    again = run(MANY, path=many, ENERGYPLAN_CACHE_DIR=kept).stdout.splitlines()
    assert again[0] == "0 7 1 True 20.0"


def test_how_far_compiling_is_can_be_shown(many: Path, tmp_path: Path) -> None:
    code = MANY.replace("with telling(lambda name: None):", "with compiling_shown(print):")
    code = code.replace("compile_kernels, telling", "compile_kernels, compiling_shown")
    kept = str(tmp_path / "kept")
    lines = run(code, path=many, ENERGYPLAN_CACHE_DIR=kept).stdout.splitlines()
    shown = [line for line in lines if line.startswith("compiling kernels, once: ")]
    counts = [int(line.split()[3]) for line in shown]
    assert shown[0] == "compiling kernels, once: 0 of 7"
    assert shown[-1] == "compiling kernels, once: 7 of 7, about 0 s left"
    assert counts == sorted(set(counts))
    again = run(code, path=many, ENERGYPLAN_CACHE_DIR=kept).stdout
    assert "compiling" not in again


def test_without_a_second_process_the_first_does_it_all(many: Path, tmp_path: Path) -> None:
    for nobody in ("/nowhere/python", "/bin/false"):
        code = f"import sys\nsys.executable = {nobody!r}\n" + MANY
        kept = str(tmp_path / nobody[1:].replace("/", ""))
        found = run(code, path=many, ENERGYPLAN_CACHE_DIR=kept)
        assert found.stdout.startswith("7 0 2 True 20.0\n"), found.stderr


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


def test_every_kernel_has_one_signature() -> None:
    """An annotation that stands for no one type would have the kernel compiled at its call."""
    for name in kernel_modules():
        importlib.import_module(name)
    assert len(KERNELS) > 100
    for kernel in KERNELS.values():
        assert len(kernel.declared) == kernel.py_func.__code__.co_argcount


def holds_arrays(annotation: Any) -> bool:
    """Return whether what an annotation stands for is an array, or has one among its fields."""
    if annotation is type(None):
        return False
    return any(isinstance(part, numba.types.Array) for part in parts_of(_numba_type(annotation)))


def parts_of(kind: Any) -> list[Any]:
    """Return a type, or those of the fields of a tuple, to any depth."""
    fields = kind.types if isinstance(kind, numba.types.BaseTuple) else ()
    return [kind] if not fields else [part for field in fields for part in parts_of(field)]


def test_kernels_without_references_neither_return_arrays_nor_are_given_new_ones() -> None:
    """Nothing would free an array that such a kernel got from another one."""
    for name in kernel_modules():
        importlib.import_module(name)
    lean = [kernel for kernel in KERNELS.values() if isinstance(kernel, LeanKernel)]
    assert len(lean) > 50
    for kernel in lean:
        function = kernel.py_func
        used = [function.__globals__.get(name) for name in function.__code__.co_names]
        for each in (kernel, *(one for one in used if isinstance(one, Kernel))):
            returned = get_type_hints(each.py_func, include_extras=True)["return"]
            assert not holds_arrays(returned), (kernel.name, each.name)


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


def test_warmup_compiles_and_says_what(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("ENERGYPLAN_CACHE_DIR", str(tmp_path))
    modules = ["energyplan.planning.space.queues"]
    monkeypatch.setattr("energyplan.compilation.kernel_modules", lambda: modules)
    said = commands.run(capsys, "warmup", "--json").json
    assert (said["folder"], said["kept"]) == (str(tmp_path), True)
    assert len(said["compiled"]) + said["found"] > 0


# -- nothing is compiled while the clock runs -----------------------------------------------------

WATCH = """
import numpy as np
import shapely
import energyplan as ep
from numba.core import event
from energyplan.compilation import KERNELS
from energyplan.planning.search import planner
from energyplan.power import HOTEL
from energyplan.reach import energy_map
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


def rest():
    Listener.seen.clear()
    at_rest.update({name: set(kernel.overloads) for name, kernel in KERNELS.items()})


def problem(cost=COST, start=(1.5, 1.5, 0.0), **more):
    blocked = np.zeros((100, 100), bool)
    blocked[33:36, :66] = True
    grid = ep.OccupancyGrid(blocked, 0.1)
    return ep.PlanningProblem(grid, cost, start, (1.5, 8.5, 2.0), **more)


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
}
at_rest = {}
original = planner.compile_kernels


def watched(*modules, load):
    made = original(*modules, load=True)  # as where a clock is about to start
    rest()
    return made


planner.compile_kernels = watched
event.register("numba:compile", Listener())
for planner, name in WAYS:
    kind = KINDS[name]()
    if planner == "compare":
        assert ep.compare(kind, effort=5_000).saving >= -1e-9
    elif planner == "range":
        energy_map(kind, energy=2e3)  # no clock runs: what it calls may be compiled then
        rest()
    elif planner == "drive":
        assert ep.plan(kind, effort=1_000).driven.energy > 0
    else:
        assert ep.plan(kind, planner=planner, effort=5_000).energy > 0
    late = [n for n, k in KERNELS.items() if set(k.overloads) - at_rest.get(n, set())]
    print(planner, name, "late:", *late, *Listener.seen)
"""
"""Plan in ways, and print what was loaded or compiled after the planner said that all is ready."""

WAYS = {
    "static": [
        ("range", "plain"),
        *(("lattice", kind) for kind in ("plain", "tight", "surfaces", "heights", "length")),
        ("lattice", "time"),
        ("compare", "surfaces"), ("bitstar", "surfaces"),
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
from energyplan.compilation import telling
compiled = []
blocked = np.zeros((60, 60), bool)
blocked[20:40, 20:40] = True
cost = ep.EnergyCost(ep.PowerModel.preset("quadriga:empty:concrete"))
grid = ep.OccupancyGrid(blocked, 0.1)
try:
    with telling(compiled.append):
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


def test_calls_with_the_declared_types_are_resolved_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """A kernel with two entries of the same types is ambiguous, and each call resolves it anew."""
    kernel = KERNELS["energyplan.steering.kernels.between_poses"]
    seven = (0.0, 0.0, 0.0, 1.0, 1.0, 0.0, 1.0)
    kernel(*seven)
    asked: list[object] = []
    monkeypatch.setattr(type(kernel), "compile", lambda self, sig=None: asked.append(sig))
    for _ in range(3):
        kernel(*seven)
    assert asked == []
