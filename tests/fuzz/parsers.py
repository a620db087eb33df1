"""Coverage-guided malformed input for one reader, with atheris.

    python tests/fuzz/parsers.py READER RUNS [--artifacts FOLDER]

READER is one of `fuzzing.READERS`, such as ``log.csv``. Inputs that take a branch of energyplan, of
rosbags or of PyYAML that none took before are kept and broken further. The sound files, the ways of
breaking them and what counts as an answer are those of `test_fuzz`. The process ends with an error
at the first input without an answer, which it leaves in the folder of artifacts.
"""

from __future__ import annotations

import argparse
import importlib
import pkgutil
import random
import sys
import tempfile
import warnings
from pathlib import Path

import atheris

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

MEGABYTES = 2048  # of the whole process


def compiled() -> list[str]:
    """Modules of compiled kernels, whose code Numba must find as it is written."""
    root = Path(importlib.util.find_spec("energyplan").origin).parent
    return [
        ".".join(("energyplan", *file.relative_to(root).with_suffix("").parts))
        for file in root.rglob("*.py")
        if "compilation import" in file.read_text()
    ]


def main() -> None:
    """Run the fuzzer."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("reader")
    parser.add_argument("runs", type=int)
    parser.add_argument("--artifacts", type=Path, default=Path())
    asked = parser.parse_args()
    with atheris.instrument_imports(include=["energyplan", "rosbags", "yaml"], exclude=compiled()):
        import fuzzing

        import energyplan

        for module in pkgutil.walk_packages(energyplan.__path__, "energyplan."):
            if ".io" in module.name or ".logs" in module.name:
                importlib.import_module(module.name)
        importlib.import_module("rosbags.highlevel")
    if asked.reader not in fuzzing.READERS:
        parser.error(f"there is no reader {asked.reader!r}; give {', '.join(fuzzing.READERS)}")
    read, text = fuzzing.READERS[asked.reader]
    warnings.simplefilter("ignore")
    warnings.filterwarnings("error", category=RuntimeWarning, module="energyplan")

    def mutate(data: bytes, most: int, seed: int) -> bytes:
        draw = random.Random(seed)
        if draw.random() < 0.5:
            return atheris.Mutate(data, most)
        script = draw.randbytes(draw.randint(1, 4) * fuzzing.STEP)
        return fuzzing.broken(data, script, text)[:most]

    with fuzzing.place_of(asked.reader) as place, tempfile.TemporaryDirectory() as corpus:
        sound = place.content.read_bytes()
        (Path(corpus) / "sound").write_bytes(sound)

        def attack(content: bytes) -> None:
            place.content.write_bytes(content)
            fuzzing.assert_answered(read, place.read)

        asked.artifacts.mkdir(parents=True, exist_ok=True)
        atheris.Setup(
            [
                sys.argv[0],
                f"-runs={asked.runs}",
                f"-timeout={fuzzing.PATIENCE}",
                f"-rss_limit_mb={MEGABYTES}",
                f"-max_len={2 * len(sound) + 1000}",
                "-len_control=0",
                "-print_final_stats=1",
                f"-artifact_prefix={asked.artifacts}/",
                corpus,
            ],
            attack,
            custom_mutator=mutate,
        )
        atheris.Fuzz()


if __name__ == "__main__":
    main()
