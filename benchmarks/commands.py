"""Time and memory of every command on its largest example, and how fast Ctrl-C ends it.

    python benchmarks/commands.py [--once]

Input is simulated or comes with the library. Each command runs twice as a process of its own, as
a user runs it: the second time counts, since compiled kernels are cached by then. Then it runs a
third time and is interrupted half-way. ``--once`` leaves the interruption out.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import NamedTuple

HOUR = 3600.0


class Run(NamedTuple):
    """What a run took."""

    seconds: float
    megabytes: float
    code: int


def run(arguments: list[str], interrupt: float | None = None) -> Run:
    """Run a command; time counts from the interruption where there is one."""
    command = [str(Path(sys.executable).with_name("energyplan")), *arguments]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    begun = time.perf_counter()
    if interrupt is not None:
        time.sleep(interrupt)
        begun = time.perf_counter()
        process.send_signal(signal.SIGINT)
    _, status, usage = os.wait4(process.pid, 0)
    took = time.perf_counter() - begun
    process.returncode = os.waitstatus_to_exitcode(status)
    return Run(took, usage.ru_maxrss / 1024, process.returncode)


def examples(folder: Path) -> dict[str, list[str]]:
    """Make the input, and return the arguments of each command."""
    import energyplan as ep
    from energyplan import simulate
    from energyplan.io.files import bundled
    from energyplan.io.tables import write_log, write_trajectory
    from energyplan.power import HOTEL

    model = ep.PowerModel.preset("quadriga:full:concrete")
    truth = model.with_term(HOTEL, 40.0)
    noise = {"power_noise": 5.0, "speed_noise": 0.003}
    hour = write_log(
        simulate.identification_drive(truth, duration=HOUR, seed=1, **noise), folder / "hour.csv"
    )
    other = write_log(simulate.validation_drive(truth, seed=2, **noise), folder / "other.csv")
    drive = write_log(simulate.identification_drive(truth, seed=3, **noise), folder / "drive.csv")
    turns = 400
    route = ep.Path(ep.Pose(0, 0, 0), ds=[4.0, 0.5] * turns, dtheta=[0.0, 0.6] * turns)
    timed = ep.speed.profile(route, model)
    trajectory = write_trajectory(timed, folder / "trajectory.csv")
    name = "quadriga:full:concrete"
    ends = ["--start", "2,2,0", "--goal", "20,12,90deg"]
    route_of = ["--map", str(bundled("warehouse.yaml")), "--surfaces",
                str(bundled("warehouse_surfaces.geojson")), "--model", name, *ends]  # fmt: skip
    vehicle = ["--vehicle", "quadriga:full"]
    return {
        "--help": ["--help"],
        "start, the list (an hour)": ["start", str(hour)],
        "identify (an hour)": ["identify", str(hour), *vehicle],
        "diagnose (two drives)": ["diagnose", str(drive), "--holdout", str(other), *vehicle],
        "plan (warehouse, 1 s)": ["plan", *route_of],
        "compare (warehouse, 1 s)": ["compare", *route_of],
        f"check ({timed.t[-1] / 60:.0f} minutes)": ["check", str(trajectory), "--model", name],
        "mission (warehouse)": ["mission", str(bundled("mission_warehouse.yaml"))],
        "demo": ["demo", "--out", str(folder / "demo")],
    }


def main() -> None:
    """Print the table."""
    interrupting = "--once" not in sys.argv
    head = "   ends after Ctrl-C" if interrupting else ""
    print(f"{'command':28s} {'first':>8s} {'warm':>8s} {'memory':>9s}{head}")
    # The system counts a parent's memory as its child's until the child starts its program, so
    # that the input is made by another process.
    with (
        tempfile.TemporaryDirectory() as folder,
        ProcessPoolExecutor(1, mp_context=get_context("spawn")) as other,
    ):
        for name, arguments in other.submit(examples, Path(folder)).result().items():
            first, warm = run(arguments), run(arguments)
            if warm.code:
                raise SystemExit(f"energyplan {' '.join(arguments)} ended with {warm.code}")
            line = (
                f"{name:28s} {first.seconds:6.2f} s {warm.seconds:6.2f} s {warm.megabytes:6.0f} MB"
            )
            if interrupting and name != "--help":
                ended = run(arguments, interrupt=0.5 * warm.seconds)
                line += f"   {ended.seconds:.2f} s, code {ended.code}"
            print(line, flush=True)


if __name__ == "__main__":
    main()
