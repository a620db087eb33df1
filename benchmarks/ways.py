"""How long the ways of docs/getting_started.md take, by step: processor time, cold and warm.

Every command runs as a process of its own in an empty folder that holds only what the reader has.
"Cold" begins with no compiled kernels, "warm" with those of the run before. Installing is not
timed: it depends on the network. All of it takes about ten minutes of processor time.
"""

from __future__ import annotations

import os
import re
import resource
import shlex
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.append(str(ROOT / "tests"))

from own_robot import bag, drive  # noqa: E402

import energyplan as ep  # noqa: E402
from energyplan.io.files import bundled, files_behind  # noqa: E402
from energyplan.io.tables import write_log  # noqa: E402

PAGE = (ROOT / "docs" / "getting_started.md").read_text()
WAYS = dict(re.findall(r"^## (.+?)\n(\nYou have: .*?)(?=^## |\Z)", PAGE, re.MULTILINE | re.DOTALL))


def commands(way: str) -> list[list[str]]:
    """Return the words of each command of a way."""
    lines = re.findall(r"^ *(energyplan .*)$", WAYS[way], re.MULTILINE)
    return [shlex.split(line) for line in lines]


def bring(way: str, folder: Path) -> None:
    """Put into the folder what the reader has, and nothing else."""
    has = re.search(r"You have: (.*?)\n\n", WAYS[way], re.DOTALL)
    assert has is not None
    for name in re.findall(r"`([\w.]+)`", has[1]):
        if name == "drive.csv":
            truth = ep.PowerModel.preset("quadriga:full:marble")
            noise = {"power_noise": 5.0, "speed_noise": 0.003}
            write_log(ep.simulate.identification_drive(truth, seed=2, **noise), folder / name)
        elif name == "bag":
            bag(folder, drive())
        elif name.endswith(".yaml"):
            for file in files_behind(bundled(name)):
                shutil.copy(file, folder)


def spent() -> float:
    """Return the processor time of all processes that have ended [s]."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def run(words: list[str], folder: Path, kernels: Path) -> float:
    """Run a command, a server until it listens; return its processor time [s]."""
    begun = spent()
    call = [sys.executable, "-m", "energyplan", *words[1:]]
    surroundings = {**os.environ, "ENERGYPLAN_CACHE_DIR": str(kernels), "PYTHONUNBUFFERED": "1"}
    if words[1] == "serve":
        call += ["--port", "0"]
        with subprocess.Popen(
            call, cwd=folder, env=surroundings, stderr=subprocess.STDOUT, stdout=subprocess.PIPE
        ) as server:
            assert server.stdout is not None
            server.stdout.readline()
            server.terminate()
        return spent() - begun
    done = subprocess.run(call, cwd=folder, env=surroundings, capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(f"{' '.join(words)}: {done.stderr}")
    return spent() - begun


def main() -> None:
    """Time the ways; print a table."""
    print("| way | steps that run | cold | warm |", "|---|---|---|---|", sep="\n")
    for way in WAYS:
        with tempfile.TemporaryDirectory() as kernels:
            told = []
            for _ in ("cold", "warm"):
                with tempfile.TemporaryDirectory() as name:
                    bring(way, Path(name))
                    told.append([run(c, Path(name), Path(kernels)) for c in commands(way)])
        names = ", ".join(f"`{words[1]}`" for words in commands(way))
        sums = [f"{sum(times):.0f} s ({' + '.join(f'{t:.0f}' for t in times)})" for times in told]
        print(f"| {way} | {names} | {' | '.join(sums)} |", flush=True)


if __name__ == "__main__":
    main()
