"""The service under load: many clients, and many requests, good and bad.

Run: ``python benchmarks/serve.py MAP.yaml`` for the time that a plan takes through HTTP beyond the
library's own, with 1, 4 and 16 clients; ``--minutes 60`` for requests of all kinds, good and bad,
and the memory of the service as they go on.
"""

from __future__ import annotations

import argparse
import http.client
import json
import os
import shutil
import socket
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from worlds import free_poses

import energyplan as ep

MODEL = "quadriga:empty:concrete"
EFFORT = 5_000
"""Effort of each plan: about a tenth of a second."""


def ask(port: int, path: str, body: Any) -> tuple[int, dict[str, Any]]:
    """Send one request on a connection of its own."""
    link = http.client.HTTPConnection("127.0.0.1", port, timeout=300)
    text = body if isinstance(body, (bytes, str)) else json.dumps(body)
    link.request("POST", f"/api/{path}", text, {"Content-Type": "application/json"})
    answer = link.getresponse()
    told = json.loads(answer.read())
    link.close()
    return answer.status, told


def serve(folder: str, waiting: int) -> tuple[subprocess.Popen[bytes], int]:
    """Start the service, and wait until it answers."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    options = ["--no-token", "--port", str(port), "--waiting", str(waiting)]
    server = subprocess.Popen([sys.executable, "-m", "energyplan", "serve", folder, *options])
    while server.poll() is None:
        try:
            socket.create_connection(("127.0.0.1", port), 1).close()
            return server, port
        except OSError:
            time.sleep(0.1)
    raise SystemExit("the service ended")


def memory(process: subprocess.Popen[bytes]) -> float:
    """Return the memory that a process holds [MiB]."""
    pages = Path(f"/proc/{process.pid}/statm").read_text().split()[1]
    return int(pages) * os.sysconf("SC_PAGE_SIZE") / 2**20


def clients(port: int, queries: list[dict[str, Any]], count: int, each: int) -> None:
    """Print what several clients see that ask at once."""
    rows: list[tuple[int, float, float, int]] = []

    def client(number: int) -> None:
        for k in range(each):
            begun = time.perf_counter()
            status, told = ask(port, "plan", queries[(number * each + k) % len(queries)])
            taken = time.perf_counter() - begun
            rows.append((status, taken, told.get("planning_time", 0.0), number))

    threads = [threading.Thread(target=client, args=(number,)) for number in range(count)]
    begun = time.perf_counter()
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    whole = time.perf_counter() - begun
    taken = np.array([row[1] for row in rows])
    beyond = taken - np.array([row[2] for row in rows])
    by_client = [float(np.sum([r[1] for r in rows if r[3] == number])) for number in range(count)]
    print(
        f"{count:7d} {len(rows) / whole:10.1f} {sum(row[0] != 200 for row in rows):8d}"
        f" {1e3 * np.median(taken):8.0f} {1e3 * np.quantile(taken, 0.99):8.0f}"
        f" {1e3 * np.median(beyond):8.0f} {1e3 * np.quantile(beyond, 0.99):8.0f}"
        f" {max(by_client) / min(by_client):8.2f}",
        flush=True,
    )


def endure(
    server: subprocess.Popen[bytes], port: int, queries: list[dict[str, Any]], minutes: float
) -> None:
    """Print the memory while requests of all kinds go on."""
    bad: list[tuple[str, Any]] = [
        ("plan", b"{"), ("plan", {}), ("plan", {**queries[0], "map": "../x.yaml"}),
        ("plan", {**queries[0], "start": [1e9, 0, 0]}), ("none", {}),
        ("check", {"model": MODEL, "t": [0, 0], "x": [], "y": [], "yaw": [], "v": [], "omega": []}),
        ("mission", {"document": {"tasks": [{}]}}), ("compare", {**queries[0], "model": "no:one"}),
    ]  # fmt: skip
    end, done, failed = time.monotonic() + 60 * minutes, 0, 0
    told = time.monotonic()
    print("   min   requests   5xx   MiB")
    while time.monotonic() < end:
        for query in queries:
            for path, body in [("plan", query), bad[done % len(bad)], ("compare", query)]:
                status, _ = ask(port, path, body)
                done += 1
                failed += status >= 500 and status != 503
        if time.monotonic() >= told:
            gone = minutes - (end - time.monotonic()) / 60
            print(f"{gone:6.1f} {done:10d} {failed:5d} {memory(server):5.0f}", flush=True)
            told += max(60 * minutes / 20, 5)
    print(f"{minutes:6.1f} {done:10d} {failed:5d} {memory(server):5.0f}")


def main() -> None:
    """Run what the arguments ask for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("map", type=Path)
    parser.add_argument("--each", type=int, default=20, help="requests of each client")
    parser.add_argument("--minutes", type=float, default=0.0, help="how long to endure")
    given = parser.parse_args()
    grid = ep.read_map(given.map)
    vehicle = ep.PowerModel.preset(MODEL).vehicle
    poses = free_poses(grid, 40, 1, vehicle)
    with tempfile.TemporaryDirectory() as folder:
        for file in given.map.parent.glob(f"{given.map.stem}.*"):
            shutil.copy(file, folder)
        queries = [
            {
                "map": given.map.name, "model": MODEL, "effort": EFFORT,
                "start": list(start), "goal": list(goal),
            }
            for start, goal in zip(poses[::2], poses[1::2], strict=True)
        ]  # fmt: skip
        server, port = serve(folder, waiting=64)
        try:
            for query in queries:  # compiles, and makes the map's tables
                ask(port, "plan", query)
            if given.minutes:
                endure(server, port, queries, given.minutes)
                return
            print("clients requests/s  not 200  p50 ms   p99 ms  p50 beyond p99  slowest/quickest")
            for count in (1, 4, 16):
                clients(port, queries, count, given.each)
        finally:
            server.terminate()
            server.wait(30)


if __name__ == "__main__":
    main()
