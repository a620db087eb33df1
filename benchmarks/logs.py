"""Time to simulate and to read a drive of a million samples, beside pandas alone.

Run ``python benchmarks/logs.py [samples]``.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pandas as pd

from energyplan import simulate
from energyplan.io.tables import write_log
from energyplan.logs import DriveLog
from energyplan.power import PowerModel

RATE = 20.0


def timed(work: Callable[[], Any]) -> tuple[float, Any]:
    """Return the time of a call and its result."""
    start = time.perf_counter()
    result = work()
    return time.perf_counter() - start, result


def main(samples: int) -> None:
    """Print the table."""
    model = PowerModel.preset("quadriga:full:concrete")
    noise = {"power_noise": 5.0, "speed_noise": 0.005}
    simulate.identification_drive(model, **noise)  # imports, caches
    seconds, log = timed(
        lambda: simulate.identification_drive(model, duration=samples / RATE, **noise)
    )
    print(f"{len(log)} samples, {len(log.channels)} channels")
    print(f"simulate                       {seconds:7.2f} s")
    with tempfile.TemporaryDirectory() as folder:
        for name, bare in (("drive.csv", pd.read_csv), ("drive.parquet", pd.read_parquet)):
            file = write_log(log, Path(folder) / name)
            alone, _ = timed(lambda read=bare, file=file: read(file))
            ours, read = timed(lambda file=file: DriveLog.read(file))
            print(
                f"read {name:14} pandas {alone:5.2f} s   DriveLog with all checks {ours:5.2f} s"
                f"   ratio {ours / alone:5.1f}"
            )
        seconds, _ = timed(lambda: read.motion(model.vehicle.icr))
        print(f"motion with derivatives        {seconds:7.2f} s")
        seconds, _ = timed(lambda: read.resample(1.0))
        print(f"resample to 1 s                {seconds:7.2f} s")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 1_000_000)
