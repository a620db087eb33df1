"""The ROS package is consistent: manifest, setup, parameters, launch file and README."""

from __future__ import annotations

import ast
import sys
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest
import yaml

from energyplan import ros

ROOT = Path(__file__).resolve().parents[2] / "ros" / "energyplan_ros"
NODES = {
    name: ast.parse((ROOT / "energyplan_ros" / f"{name}.py").read_text())
    for name in ("planner", "identifier", "running", "bond")
}
MAINS = ("planner", "identifier")


def test_manifest_setup_and_marker_name_the_same_package() -> None:
    manifest = ElementTree.parse(ROOT / "package.xml").getroot()
    setup = (ROOT / "setup.py").read_text()
    version = manifest.findtext("version")
    assert manifest.findtext("name") == "energyplan_ros"
    assert f'version="{version}"' in setup
    assert manifest.findtext("export/build_type") == "ament_python"
    assert (ROOT / "resource" / "energyplan_ros").is_file()
    for name in MAINS:
        functions = [n.name for n in NODES[name].body if isinstance(n, ast.FunctionDef)]
        assert f"{name}:main" in setup and "main" in functions


def test_the_manifest_names_every_ros_package_that_the_node_imports() -> None:
    manifest = ElementTree.parse(ROOT / "package.xml").getroot()
    depends = {element.text for element in manifest.iter("exec_depend")}
    imported = {
        (node.module or "").split(".")[0]
        for tree in NODES.values()
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom)
    }
    foreign = imported - {*sys.stdlib_module_names, "energyplan", "energyplan_ros"}
    assert {"tf2_ros_py" if name == "tf2_ros" else name for name in foreign} <= depends


def test_every_file_of_parameters_is_installed() -> None:
    setup = (ROOT / "setup.py").read_text()
    files = list((ROOT / "config").iterdir())
    assert len(files) == 3
    for file in files:
        assert f'"config/{file.name}"' in setup
        assert "ros__parameters" in next(iter(yaml.safe_load(file.read_text()).values()))


@pytest.mark.parametrize("name", MAINS)
def test_the_nodes_use_only_what_the_library_has(name: str) -> None:
    used = {
        node.attr
        for node in ast.walk(NODES[name])
        if isinstance(node, ast.Attribute)
        and isinstance(node.value, ast.Name)
        and node.value.id == "ros"
    }
    assert used and used <= set(ros.__all__)


@pytest.mark.parametrize("name", MAINS)
def test_the_examples_set_parameters_that_the_nodes_declare(name: str) -> None:
    (table,) = (
        ast.literal_eval(node.value)
        for node in NODES[name].body
        if isinstance(node, ast.Assign) and getattr(node.targets[0], "id", "") == "PARAMETERS"
    )
    content = yaml.safe_load((ROOT / "config" / f"{name}.yaml").read_text())
    given = content["/**"]["ros__parameters"]
    assert set(given) <= set(table)
    for key, value in given.items():
        assert type(value) is type(table[key]), key
