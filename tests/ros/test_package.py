"""The ROS package is consistent; the node itself needs ROS 2 and is not run here."""

from __future__ import annotations

import ast
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest
import yaml

from energyplan import ros

ROOT = Path(__file__).resolve().parents[2] / "ros" / "energyplan_ros"
NODE = ast.parse((ROOT / "energyplan_ros" / "planner.py").read_text())


def test_manifest_setup_and_marker_name_the_same_package() -> None:
    manifest = ElementTree.parse(ROOT / "package.xml").getroot()
    setup = (ROOT / "setup.py").read_text()
    version = manifest.findtext("version")
    assert manifest.findtext("name") == "energyplan_ros"
    assert f'version="{version}"' in setup
    assert manifest.findtext("export/build_type") == "ament_python"
    assert (ROOT / "resource" / "energyplan_ros").is_file()
    functions = [n.name for n in NODE.body if isinstance(n, ast.FunctionDef)]
    assert "planner:main" in setup and "main" in functions


def test_the_manifest_names_every_ros_package_that_the_node_imports() -> None:
    manifest = ElementTree.parse(ROOT / "package.xml").getroot()
    depends = {element.text for element in manifest.iter("exec_depend")}
    imported = {
        (node.module or "").split(".")[0] for node in NODE.body if isinstance(node, ast.ImportFrom)
    }
    foreign = imported - {"__future__", "functools", "threading", "typing", "energyplan"}
    assert {"tf2_ros_py" if name == "tf2_ros" else name for name in foreign} <= depends


def test_the_node_uses_only_what_the_library_has() -> None:
    used = {
        node.attr
        for node in ast.walk(NODE)
        if isinstance(node, ast.Attribute)
        and isinstance(node.value, ast.Name)
        and node.value.id == "ros"
    }
    assert used and used <= set(ros.__all__)


def test_the_example_sets_parameters_that_the_node_declares() -> None:
    (table,) = (
        ast.literal_eval(node.value)
        for node in NODE.body
        if isinstance(node, ast.Assign) and getattr(node.targets[0], "id", "") == "PARAMETERS"
    )
    content = yaml.safe_load((ROOT / "config" / "planner.yaml").read_text())
    given = content["energyplan_planner"]["ros__parameters"]
    assert set(given) <= set(table)
    for name, value in given.items():
        assert type(value) is type(table[name]), name


@pytest.mark.parametrize("claim", ["has not run under ROS 2", "has not been built"])
def test_the_readme_says_what_was_not_tested(claim: str) -> None:
    assert claim in " ".join((ROOT / "README.md").read_text().split())
