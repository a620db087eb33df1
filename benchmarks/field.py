"""Files as people have them: read right, asked about, refused with a way, or wrong.

    python benchmarks/field.py FOLDER [--only NAME...] [--said]

FOLDER holds a folder for each case, with its files and a case.toml: the commands, what a good
answer holds (words), and how near 30 N the resistance of its drive must come (share). A case
without one has its commands in case.md. Commands run in a copy, one after the other, until one
decides.

    right      the resistance is near enough, or the answer holds the words
    asks       a question, or a doubt, that names a way, and no project
    refuses    an error that holds the words, and no project
    wrong      anything else
    not known  a case without a case.toml, and without a drive
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
import tomllib
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from unittest import mock

from energyplan import cli

RESISTANCE = 30.0
"""Traction resistance of the robot whose drives these are, a side [N]."""
ENERGY = 1888.0
"""Energy of the plan over the maps of heights, in metres [J]."""
SHARE = 0.05
"""How near the resistance must come where the case says nothing."""


@dataclass(frozen=True)
class Said:
    """What a command printed, and its exit code."""

    code: int
    out: str
    err: str

    @property
    def text(self) -> str:
        """All that it printed."""
        return f"{self.err}\n{self.out}"


def run(words: Sequence[str]) -> Said:
    """Run a command of energyplan as from a shell."""
    out, err, code = io.StringIO(), io.StringIO(), 0
    with mock.patch.object(sys, "argv", [*words]), contextlib.ExitStack() as stack:
        stack.enter_context(contextlib.redirect_stdout(out))
        stack.enter_context(contextlib.redirect_stderr(err))
        try:
            cli.main()
        except SystemExit as left:
            code = int(left.code or 0)
    return Said(code, out.getvalue(), err.getvalue())


def read_case(folder: Path) -> dict[str, Any]:
    """Return a case's commands, and what is right."""
    file = folder / "case.toml"
    case: dict[str, Any] = tomllib.loads(file.read_text()) if file.exists() else {
        "commands": re.findall(r"^    \$ (energyplan .*)$", (folder / "case.md").read_text(), re.M),
    }  # fmt: skip
    logs = [shlex.split(one)[2] for one in case["commands"] if " start " in one]
    if logs and not any(" identify " in one for one in case["commands"]):
        case["commands"].append(f"energyplan identify {logs[-1]} --project p.yaml")
    return {"share": SHARE, "words": "", **case}


def judge(folder: Path) -> tuple[str, str]:
    """Run a case's commands in a copy; return the verdict and what decided it."""
    case, printed = read_case(folder), ""
    if "name" not in case and " start " not in case["commands"][0]:
        return "not known", ""
    for command in case["commands"]:
        words = shlex.split(command)
        if words[0] != "energyplan":
            subprocess.run(words, check=True)
            continue
        if words[1] == "identify":
            project = Path(words[words.index("--project") + 1])
            if not project.exists():
                break
            found = run([*words, "--json"])
            if found.code == 0:
                terms = {one["name"]: one["value"] for one in json.loads(found.out)["terms"]}
                size = terms["traction_resistance"]
                near = not case["share"] or abs(size / RESISTANCE - 1) <= case["share"]
                return "right" if near else "wrong", f"K = {size:.1f} N\n{printed}"
            return "refuses", found.err
        said = run(words)
        printed += said.text
        named = bool(re.search(case["words"], said.text)) if case["words"] else False
        if words[1] != "start":
            if case["words"] and named:
                return "right" if said.code in (0, 3) else "refuses", printed
            energy = re.search(r"energy as driven.*?([\d.]+)\n", said.out)
            if energy and words[1] == "plan" and not case["words"]:
                near = abs(float(energy[1]) / ENERGY - 1) <= 0.03
                return "right" if near else "wrong", printed
            if said.code == 2 and not case["words"]:
                return "refuses", printed
        elif said.code != 0 and (named or not case["words"]):
            return "asks" if said.out.strip() else "refuses", printed
    return "wrong", printed


def main() -> None:
    """Judge all cases of a folder."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--only", nargs="*", default=[])
    parser.add_argument("--said", action="store_true", help="print what decided each case")
    options = parser.parse_args()
    os.environ["COLUMNS"] = "1000"
    count: Counter[str] = Counter()
    for folder in sorted(one.resolve() for one in options.folder.iterdir() if one.is_dir()):
        if options.only and folder.name not in options.only:
            continue
        with tempfile.TemporaryDirectory() as scratch:
            copy = Path(scratch) / folder.name
            shutil.copytree(folder, copy, copy_function=shutil.copyfile)
            with contextlib.chdir(copy):
                verdict, printed = judge(folder)
        count[verdict] += 1
        print(f"{verdict:9} {folder.name}", flush=True)
        if options.said:
            print(re.sub(r"^", "    ", printed.strip(), flags=re.M))
    print(f"{count.total()} cases: {', '.join(f'{n} {one}' for one, n in count.most_common())}")


if __name__ == "__main__":
    main()
