"""Conventions that hold for every public object: names, docstrings, errors, what text may say."""

from __future__ import annotations

import ast
import functools
import graphlib
import importlib.util
import inspect
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest
from numpydoc.docscrape import FunctionDoc

import energyplan
from energyplan import errors

ROOT = Path(__file__).resolve().parents[2]


REFERENCE = ROOT / "docs" / "reference" / "python.md"


def public_names() -> Iterator[tuple[str, object]]:
    """Yield the names at the top level, and those of the modules that the reference documents."""
    for name in energyplan.__all__:
        value = getattr(energyplan, name)
        if not inspect.ismodule(value):
            yield f"energyplan.{name}", value
    for place, name in re.findall(r"auto(?:class|function):: (\S+)\.(\w+)", REFERENCE.read_text()):
        if place != "energyplan":
            yield f"{place}.{name}", getattr(importlib.import_module(place), name)
    for place in re.findall(r"automodule:: (\S+)", REFERENCE.read_text()):
        module = importlib.import_module(place)
        listed = getattr(module, "__all__", None)
        for name in listed or vars(module):
            value = getattr(module, name)
            own = listed is not None or getattr(value, "__module__", None) == place
            if own and name[0] != "_" and (inspect.isfunction(value) or inspect.isclass(value)):
                yield f"{place}.{name}", value


def documented() -> Iterator[tuple[str, object]]:
    """Yield the public names, and the methods of those that are classes."""
    for name, value in public_names():
        yield name, value
        if inspect.isclass(value):
            for method, function in vars(value).items():
                function = getattr(function, "__func__", function)
                if inspect.isfunction(function) and not method.startswith("_"):
                    yield f"{name}.{method}", function


def fault_of(name: str, value: object) -> str:
    """Return what is wrong with the docstring of a function or class; empty where nothing is."""
    text = inspect.getdoc(value)
    if not text:
        return f"{name} has no docstring"
    if not text.splitlines()[0].endswith("."):
        return f"{name}: the first line is no sentence"
    documented = [p.name for p in FunctionDoc(value, doc=text)["Parameters"]]
    named = [part.strip().lstrip("*") for entry in documented for part in entry.split(",")]
    if not named and (name.count(".") > 1 or inspect.isclass(value)):
        return ""  # one sentence is enough below the top level
    wanted = [
        p for p in inspect.signature(value).parameters if p not in ("self", "cls") and p[0] != "_"
    ]
    return "" if sorted(named) == sorted(wanted) else f"{name} documents {named}, takes {wanted}"


def test_public_docstrings_document_exactly_the_parameters() -> None:
    public = dict(documented())
    assert len(public) > 150
    assert [fault for name in public if (fault := fault_of(name, public[name]))] == []


def test_the_reference_has_every_name_of_the_top_level() -> None:
    text = REFERENCE.read_text()
    assert [n for n in energyplan.__all__ if not re.search(rf"energyplan\.{n}\b", text)] == []


@pytest.mark.parametrize("name", [n for n in dir(errors) if n.endswith("Error")])
def test_errors_share_a_base_and_bad_input_is_a_value_error(name: str) -> None:
    error = getattr(errors, name)
    assert issubclass(error, errors.EnergyPlanError)
    assert issubclass(error, ValueError) is issubclass(error, errors.InvalidInputError)


def test_the_public_names_are_these() -> None:
    """A name that is added or taken away is a decision: change it here and in the changelog."""
    assert sorted(energyplan.__all__) == [
        "Battery", "Candidate", "Charger", "DriveLog", "EnergyCost", "Goal", "HeightMap",
        "Mission", "Motion", "MotorLimits", "OccupancyGrid", "OnlineIdentifier", "Path", "Plan",
        "Planner",
        "PlanningProblem", "Pose", "PowerModel", "Site", "SurfaceMap", "Task", "Trajectory",
        "TreadICR", "Vehicle", "check", "compare", "diagnose", "energy_map", "errors", "evaluate",
        "evaluate_many", "identify", "plan", "plots", "profile", "read_heights", "read_map",
        "read_mission", "read_model", "read_surfaces", "read_vehicle", "simulate", "speed",
        "steering", "watch", "write_model",
    ]  # fmt: skip


FRESH = """
import sys, energyplan.cli
heavy = ("numpy", "numba", "scipy", "matplotlib", "pandas", "ompl")
print([name for name in heavy if name in sys.modules])
import energyplan, energyplan.fit, energyplan.diagnosis, energyplan.comparison
print([n for n in ("identify", "diagnose", "compare") if not callable(getattr(energyplan, n))])
"""


def test_a_fresh_import_is_light_and_no_module_hides_a_function_of_its_name() -> None:
    done = subprocess.run([sys.executable, "-c", FRESH], capture_output=True, text=True, check=True)
    assert done.stdout.split("\n") == ["[]", "[]", ""]


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


def test_scripts_import_what_exists() -> None:
    scripts = [
        file for name in ("benchmarks", "examples", "docs") for file in (ROOT / name).glob("*.py")
    ]
    lost = []
    for file in scripts:
        for node in ast.walk(parsed(file)):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("energyplan"):
                module = importlib.import_module(str(node.module))
                names = [one.name for one in node.names if not hasattr(module, one.name)]
                lost += [
                    f"{file.name}: {module.__name__}.{name}"
                    for name in names
                    if importlib.util.find_spec(f"{module.__name__}.{name}") is None
                ]
    assert lost == []


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
    "demo._Demo", "diagnosis.search.FittedSet", "live.watcher._Drawn",
    "live.watcher._GroundLearner", "mission.energy.Models", "output.pages.Page",
    "planning.search.first.Paths", "planning.search.lattice.Search", "sources._Definition",
    "terrain.updates.Tables",
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


def test_the_package_states_the_licence_of_all_that_it_contains() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    stated = {file for pattern in project["license-files"] for file in ROOT.glob(pattern)}
    vendored = sorted((ROOT / "energyplan").rglob("vendor/*.js"))
    assert stated == {ROOT / "LICENSE", *(file.with_suffix(".LICENSE") for file in vendored)}
    assert len(vendored) == 2
    kinds = {
        "BSD-2-Clause": "Redistribution and use in source",
        "MIT": "Permission is hereby granted",
    }
    texts = [file.read_text() for file in stated]
    assert all(any(words in text for text in texts) for words in kinds.values())
    assert project["license"].split(" AND ") == ["Apache-2.0", *kinds]
