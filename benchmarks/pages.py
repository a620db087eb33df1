"""Tables of pages, written by scripts: each with its command and the commit that it was made on.

    python benchmarks/pages.py [--data FOLDER] [PAGE...]   make them anew, and compare

A table stands between ``<!-- NAME: COMMAND -->`` and ``<!-- end of NAME -->``; `write` puts it
there. Compared is on copies of the pages; what differs is printed, and the exit code is 1. Columns
of processor times are left out, and figures may change by a tenth or by a unit of their last place,
as from one processor to another. Tables of recorded drives need their FOLDER.
"""

from __future__ import annotations

import argparse
import re
import shlex
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from itertools import zip_longest
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md"))]
MARKED = re.compile(r"<!-- ([^:\n]+): (python [^\n]+) -->\n(.*?)\n<!-- end of \1 -->", re.DOTALL)
COMMIT = re.compile(r"\n\n\*Made on commit ([0-9a-f]{7,40})(?:-dirty)?\.\*\Z")
NUMBER = re.compile(r"-?\d+(?:\.\d+)?")
CHANGE = 0.1


class Table(NamedTuple):
    """A table of a page."""

    name: str
    command: str
    rows: list[list[str]]
    commit: str  # empty where the table does not say it


def tables(page: Path) -> Iterator[Table]:
    """Yield the tables of a page that scripts write."""
    for name, command, text in MARKED.findall(page.read_text(encoding="utf-8")):
        found = COMMIT.search(text)
        rows = [line.strip("| ").split("|") for line in COMMIT.sub("", text).splitlines()]
        yield Table(name, command, rows, found[1] if found else "")


def write(page: Path, name: str, text: str) -> None:
    """Write a table between its marks, with the commit that it was made on."""
    asked = ("git", "-C", str(ROOT), "describe", "--always", "--dirty", "--abbrev=8", "--exclude=*")
    commit = subprocess.run(asked, check=True, capture_output=True, text=True).stdout.strip()
    title = re.escape(name)
    mark = re.compile(rf"(<!-- {title}: [^\n]+ -->\n).*?(<!-- end of {title} -->)", re.DOTALL)
    before = page.read_text(encoding="utf-8")
    if not mark.search(before):
        raise SystemExit(f"{page} has no mark <!-- {name}: COMMAND -->")
    made = mark.sub(lambda m: f"{m[1]}{text.strip()}\n\n*Made on commit {commit}.*\n{m[2]}", before)
    page.write_text(made, encoding="utf-8")


def alike(was: str, now: str) -> bool:
    """Tell whether two cells say the same, up to what processors change."""
    figures = [NUMBER.findall(text) for text in (was, now)]
    return NUMBER.sub("#", was).strip() == NUMBER.sub("#", now).strip() and all(
        abs(float(a) - float(b))
        <= max(CHANGE * abs(float(a)), 1.001 * 10.0 ** -len(a.partition(".")[2]))
        for a, b in zip(*figures, strict=True)
    )


def differences(was: Table, now: Table) -> Iterator[str]:
    """Yield what differs, columns of times aside."""
    timed = [k for k, head in enumerate(was.rows[0]) if re.search(r"\b(CPU|time)\b", head)]
    for before, after in zip_longest(was.rows, now.rows, fillvalue=[]):
        for k, (a, b) in enumerate(zip_longest(before, after, fillvalue="nothing")):
            if k not in timed and not alike(a, b):
                yield f"{was.name}, {before[0].strip() if before else 'a new row'}: {a} -> {b}"


def main() -> int:
    """Make the tables anew and compare; return 1 where they differ."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("pages", nargs="*", type=Path, metavar="PAGE", default=PAGES)
    parser.add_argument("--data", metavar="FOLDER", help="recorded drives")
    given = parser.parse_args()
    wrong = 0
    for page in given.pages:
        kept = list(tables(page))
        with tempfile.TemporaryDirectory() as folder:
            copy = Path(folder) / page.name
            copy.write_text(page.read_text(encoding="utf-8"), encoding="utf-8")
            for command in dict.fromkeys(table.command for table in kept):
                words = shlex.split(command)[1:]
                if "FOLDER" in words and given.data is None:
                    print(f"{page.name}: left out, needs --data: {command}")
                    continue
                real = {"FOLDER": str(given.data), str(page.resolve().relative_to(ROOT)): str(copy)}
                words = [sys.executable, *(real.get(word, word) for word in words)]
                subprocess.run(words, check=True, cwd=ROOT, stdout=subprocess.DEVNULL)
            for was, now in zip(kept, tables(copy), strict=True):
                for difference in differences(was, now):
                    wrong += 1
                    print(f"{page.name}: {difference}", flush=True)
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main())
