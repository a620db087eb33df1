"""Conventions that hold for every public object: names, docstrings, errors, what text may say."""

from __future__ import annotations

import ast
import functools
import graphlib
import importlib
import inspect
import pkgutil
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from numpydoc.docscrape import FunctionDoc

import energyplan
from energyplan import errors

ROOT = Path(__file__).resolve().parents[2]


def modules() -> list[str]:
    found = pkgutil.walk_packages(energyplan.__path__, "energyplan.")
    return sorted(m.name for m in found if not re.search(r"\._", m.name))


def public_functions() -> Iterator[tuple[str, object]]:
    for name in modules():
        module = importlib.import_module(name)
        for key, value in vars(module).items():
            if key.startswith("_") or getattr(value, "__module__", None) != name:
                continue
            if inspect.isfunction(value):
                yield f"{name}.{key}", value
            elif inspect.isclass(value):
                yield f"{name}.{key}", value
                for method, function in vars(value).items():
                    function = getattr(function, "__func__", function)
                    if inspect.isfunction(function) and not method.startswith("_"):
                        yield f"{name}.{key}.{method}", function


COMMANDS = "energyplan.cli."  # typer's own help strings document the options of commands


def fault_of(name: str, value: object) -> str:
    """Return what is wrong with the docstring of a function or class; empty where nothing is."""
    text = inspect.getdoc(value)
    if not text:
        return f"{name} has no docstring"
    if not text.splitlines()[0].endswith("."):
        return f"{name}: the first line is no sentence"
    documented = [p.name for p in FunctionDoc(value, doc=text)["Parameters"]]
    if name.startswith(COMMANDS) or not documented:
        return ""
    named = [part.strip().lstrip("*") for entry in documented for part in entry.split(",")]
    wanted = [
        p for p in inspect.signature(value).parameters if p not in ("self", "cls") and p[0] != "_"
    ]
    return "" if sorted(named) == sorted(wanted) else f"{name} documents {named}, takes {wanted}"


def test_docstrings_document_exactly_the_parameters() -> None:
    public = dict(public_functions())
    assert len(public) > 1000
    assert [fault for name in public if (fault := fault_of(name, public[name]))] == []


LIBRARY = (
    "batch", "battery", "cost", "diagnosis", "fit", "fleet", "io.bags", "io.bundled", "io.config",
    "io.cost_table", "io.energy_map", "io.files", "io.geojson", "io.husky", "io.logs", "io.maps",
    "io.mission", "io.nav2_lattice", "io.route_graph", "io.topics", "io.trajectory", "limits",
    "limits.feasibility", "limits.speed", "live", "logs", "mission", "openrmf", "output.plots",
    "output.report", "path", "physics", "planning", "planning.ompl", "planning.roadmap", "power",
    "power.effects", "ros", "serve", "simulate", "steering", "studies", "terrain", "vehicle",
    "physics.design", "physics.interval", "physics.manoeuvres",
    "planning.replanning", "planning.roadmap.planned",
    "studies.comparison", "studies.control_set", "studies.doubt",
)  # fmt: skip
"""Packages whose functions and classes have an example each, as all names of ``energyplan`` have.
"""

FOR_KERNELS = {"terrain.footprint"}
"""What serves the kernels of other packages, not users."""


def names_with_examples() -> Iterator[tuple[str, object]]:
    for name in energyplan.__all__:
        value = getattr(energyplan, name)
        if not inspect.ismodule(value):
            yield name, value
    for package in LIBRARY:
        module = importlib.import_module(f"energyplan.{package}")
        listed = hasattr(module, "__all__")
        for name in getattr(module, "__all__", vars(module)):
            value = getattr(module, name)
            home = getattr(value, "__module__", "")
            own = home.startswith("energyplan.") if listed else home == module.__name__
            shown = inspect.isfunction(value) or inspect.isclass(value)
            if own and shown and name[0] != "_" and f"{package}.{name}" not in FOR_KERNELS:
                yield f"{package}.{name}", value


def test_public_names_have_an_example() -> None:
    """The examples run with the doctests."""
    shown = dict(names_with_examples())
    assert len(shown) > 300
    assert [name for name in shown if ">>> " not in (inspect.getdoc(shown[name]) or "")] == []


@pytest.mark.parametrize("name", [n for n in dir(errors) if n.endswith("Error")])
def test_errors_share_a_base_and_bad_input_is_a_value_error(name: str) -> None:
    error = getattr(errors, name)
    assert issubclass(error, errors.EnergyPlanError)
    assert issubclass(error, ValueError) is issubclass(error, errors.InvalidInputError)


def test_every_public_name_can_be_imported() -> None:
    for name in energyplan.__all__:
        assert getattr(energyplan, name) is not None


def test_the_public_names_are_these() -> None:
    """A name that is added or taken away is a decision: change it here and in the changelog."""
    assert sorted(energyplan.__all__) == [
        "Battery", "Budget", "Candidate", "Charger", "Comparison", "Diagnosis", "DriveLog",
        "EnergyCost", "EnergyMap", "FeasibilityReport", "HeightMap", "Identification", "Mission",
        "MissionReport", "Motion", "MotorLimits", "OccupancyGrid", "OnlineIdentifier",
        "ParetoFront", "ParetoPoint", "Path", "Plan", "Planner", "PlanningProblem", "Pose",
        "PowerModel", "Residual", "Sides", "SurfaceMap", "Task", "Term", "Terrain", "Trajectory",
        "TreadICR", "Vehicle", "battery", "check", "compare", "diagnose", "energy_map", "errors",
        "evaluate", "feasibility", "fleet", "identify", "pareto", "plan", "plots", "read_fleet",
        "read_heights", "read_map", "read_mission", "read_model", "read_surfaces", "read_vehicle",
        "replan", "simulate", "speed", "steering", "watch", "write_model",
    ]  # fmt: skip


def test_functions_are_not_hidden_by_modules_of_the_same_name() -> None:
    code = (
        "import energyplan, energyplan.fit, energyplan.diagnosis, energyplan.studies.comparison\n"
        "from energyplan.fit import fit_residual\n"
        "print(all(callable(getattr(energyplan, n)) for n in ('identify', 'diagnose', 'compare')))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "True"


def test_importing_the_package_imports_nothing_heavy() -> None:
    code = (
        "import sys, energyplan.cli\n"
        "print([m for m in ('numpy', 'numba', 'scipy', 'matplotlib', 'pandas', 'ompl') "
        "if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


@functools.cache
def parsed(file: Path) -> ast.Module:
    return ast.parse(file.read_text())


def _imports(file: Path) -> Iterator[tuple[str, str]]:
    """Yield what a module imports from this package: the module named, and the name."""
    for node in ast.walk(parsed(file)):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("energyplan"):
            for alias in node.names:
                yield node.module or "", alias.name
        elif isinstance(node, ast.Import):
            for alias in node.names:
                if alias.name.startswith("energyplan."):
                    yield alias.name, ""


def test_no_module_imports_private_parts_of_another_package() -> None:
    """What two packages need is public within the library."""
    reached = []
    for file in sorted((ROOT / "energyplan").rglob("*.py")):
        here = file.relative_to(ROOT).with_suffix("").parts[:-1]
        for module, name in _imports(file):
            parts = (*module.split("."), name)
            private = [k for k, part in enumerate(parts) if re.match(r"_(?!_)", part)]
            if private and here[: private[0]] != parts[: private[0]]:
                reached.append(f"{file.relative_to(ROOT)}: {module} {name}")
    assert reached == []


def test_no_modules_import_each_other_in_a_circle() -> None:
    """What is imported for types alone, or within a function, makes none."""
    files = sorted((ROOT / "energyplan").rglob("*.py"))
    names = {f: ".".join(f.relative_to(ROOT).with_suffix("").parts) for f in files}
    modules = {name.removesuffix(".__init__") for name in names.values()}
    needed: dict[str, set[str]] = {}
    for file, name in names.items():
        needed[name.removesuffix(".__init__")] = {
            module if (module := f"{node.module}.{alias.name}") in modules else str(node.module)
            for node in parsed(file).body
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("energyplan")
            for alias in node.names
        }
    try:
        graphlib.TopologicalSorter(needed).prepare()
    except graphlib.CycleError as error:
        pytest.fail(f"a circle: {' -> '.join(error.args[1])}")


CHANGING = {
    "batch._Flight", "demo._Demo", "diagnosis.explanations.Evaluated", "fleet.evaluation._Drive",
    "live.watcher._Drawn", "live.watcher._Ground", "output.report.Page",
    "planning.lattice.search.Search", "terrain.updates.Tables",
}  # fmt: skip
"""Dataclasses that hold what a computation has so far."""


def test_data_are_frozen() -> None:
    thawed = set()
    for path in (ROOT / "energyplan").rglob("*.py"):
        module = ".".join(path.relative_to(ROOT / "energyplan").with_suffix("").parts)
        classes = [n for n in ast.walk(parsed(path)) if isinstance(n, ast.ClassDef)]
        for each in classes:
            made = [made for d in each.decorator_list if "dataclass" in (made := ast.unparse(d))]
            if made and "frozen=True" not in made[0]:
                thawed.add(f"{module}.{each.name}")
    assert thawed == CHANGING


def test_no_module_is_long() -> None:
    lengths = {
        path.relative_to(ROOT).as_posix(): len(path.read_text().splitlines())
        for path in (ROOT / "energyplan").rglob("*.py")
    }
    assert {name: count for name, count in lengths.items() if count > 470} == {}
