"""Write the answers of the commands anew and print what changed: look at it before you keep it.

    python tests/golden/rewrite.py [NAME...]

A changed number within its tolerance is left as it was; NAME is as in `answers.ANSWERS`.
"""

from __future__ import annotations

import json
import sys
import tempfile
from pathlib import Path

import answers


def main(names: list[str]) -> None:
    """Write those of these names, or all."""
    for gone in {one.stem for one in answers.HERE.glob("*.json")} - answers.ANSWERS.keys():
        print(f"{gone}: not asked any more")
        answers.file(gone).unlink()
    with tempfile.TemporaryDirectory() as made:
        answers.material(Path(made))
        for name in names or answers.ANSWERS:
            now, file = answers.answer(name, Path(made)), answers.file(name)
            was = json.loads(file.read_text()) if file.exists() else None
            differing = ["new"] if was is None else answers.differences(name, was, now)
            for difference in differing:
                print(f"{name}: {difference}")
            if differing:
                file.write_text(json.dumps(now, indent=1) + "\n")


if __name__ == "__main__":
    main(sys.argv[1:])
