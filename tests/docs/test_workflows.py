"""The workflows are sound YAML, may do no more than they must, and start what there is."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).resolve().parents[2]
WORKFLOWS = sorted((ROOT / ".github" / "workflows").glob("*"))
TARGETS = set(re.findall(r"^([a-z]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))


@pytest.mark.parametrize("file", WORKFLOWS, ids=lambda file: file.name)
def test_a_workflow_may_read_the_source_and_only_publishing_more(file: Path) -> None:
    flow = yaml.safe_load(file.read_text())
    assert flow["permissions"] == {"contents": "read"}
    more = {name: job["permissions"] for name, job in flow["jobs"].items() if "permissions" in job}
    assert more == ({"publish": {"id-token": "write"}} if file.name == "release.yml" else {})
    for step in (step for job in flow["jobs"].values() for step in job["steps"]):
        if str(step.get("uses", "")).startswith("actions/checkout@"):
            assert step["with"]["persist-credentials"] is False


@pytest.mark.parametrize("file", WORKFLOWS, ids=lambda file: file.name)
def test_a_workflow_starts_targets_and_scripts_that_exist(file: Path) -> None:
    flow = yaml.safe_load(file.read_text())
    for job in flow["jobs"].values():
        matrix = job.get("strategy", {}).get("matrix", {})
        commands = [step["run"] for step in job["steps"] if "run" in step]
        for key, values in matrix.items():
            hole = "${{ matrix." + key + " }}"
            commands = [
                line.replace(hole, str(value))
                for line in commands
                for value in (values if hole in line else [""])
            ]
        for command in commands:
            assert "${{" not in command, command
            word, target = command.split()[:2]
            assert (word == "make" and target in TARGETS) or (
                word == "bash" and (ROOT / target).exists()
            ), command


def test_actions_are_pinned_to_a_commit_and_say_its_release() -> None:
    files = [*WORKFLOWS, *(ROOT / ".github" / "actions").rglob("*.yml")]
    used = [line for file in files for line in re.findall(r"uses: (.*)", file.read_text())]
    assert len(used) > 5
    for action in used:
        local = action.startswith("./") and (ROOT / action / "action.yml").exists()
        assert local or re.fullmatch(r"[\w/-]+@[0-9a-f]{40} # v[\d.]+", action), action
