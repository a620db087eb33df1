"""The service under load: many clients, many requests, and clients that mean no good.

Run: ``python benchmarks/serve.py MAP.yaml`` for the time that a plan takes through HTTP beyond the
library's own, with 1, 4 and 16 clients; ``--requests 2000`` for the memory of the service as
requests of all kinds go on, good and bad; ``--crowd 300`` for the time of ``/health``, and of the
event loop, beside eight requests at work and as many idle, slow and greedy connections.
"""

from __future__ import annotations

import argparse
import asyncio
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
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from worlds import free_poses

import energyplan as ep

MODEL = "quadriga:empty:concrete"
EFFORT = 5_000
"""Effort of each plan: about a tenth of a second."""
AT_WORK, SECONDS = 8, 40.0
"""Requests at work beside a crowd, and how long that lasts [s]."""


def ask(port: int, path: str, body: Any, method: str = "POST") -> tuple[int, dict[str, Any]]:
    """Send one request on a connection of its own."""
    link = http.client.HTTPConnection("127.0.0.1", port, timeout=300)
    text = body if isinstance(body, (bytes, str)) else json.dumps(body)
    link.request(method, f"/api/{path}", text, {"Content-Type": "application/json"})
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
    call = [sys.executable, "-m", "energyplan", "serve", folder, *options]
    server = subprocess.Popen(call, stderr=subprocess.DEVNULL)
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


def mixed(queries: list[dict[str, Any]], k: int) -> tuple[str, Any, str]:
    """Return the k-th of requests of all kinds: path, body and method."""
    query = queries[k % len(queries)]
    other = queries[(k + 1) % len(queries)]
    t = [0.0, 1.0, 2.0]
    still = dict.fromkeys(("y", "yaw", "omega"), [0.0] * 3)
    start = [query["start"][0] + 1e-6 * k, *query["start"][1:]]  # that of a robot that moves
    mission = {
        "model": MODEL, "map": query["map"], "battery": "quadriga", "start": start,
        "coefficient_spread": 0.05, "planning_effort": 300,
        "tasks": [{"name": "a", "pose": query["goal"]}, {"name": "b", "pose": other["goal"]}],
    }  # fmt: skip
    kinds: Sequence[tuple[str, Any, str]] = (
        ("plan", query, "POST"),
        ("plan", {**query, "map": "../x.yaml"}, "POST"),
        ("mission", {"document": mission}, "POST"),
        ("plan", b"{", "POST"),
        ("check", {"model": MODEL, "t": t, "x": t, "v": [1.0] * 3, **still}, "POST"),
        (f"maps/{query['map']}", b"", "GET"),
        ("compare", {**query, "model": "no:one"}, "POST"),
        ("plan", {**query, "start": start}, "POST"),
        (f"files/log{k % 50}.csv", b"t,v\n" * 25_000, "PUT"),
        ("range", {**_without(query, "goal", "effort"), "energy": 1500.0}, "POST"),
    )
    return kinds[k % len(kinds)]


def _without(query: dict[str, Any], *keys: str) -> dict[str, Any]:
    return {key: value for key, value in query.items() if key not in keys}


def endure(
    server: subprocess.Popen[bytes], port: int, queries: list[dict[str, Any]], count: int
) -> None:
    """Print the memory while requests of all kinds go on."""
    print("requests   5xx   MiB   beyond that after a tenth")
    failed, first = 0, 0.0
    for k in range(count):
        status, _ = ask(port, *mixed(queries, k))
        failed += status >= 500 and status != 503
        if (k + 1) % max(count // 10, 1) == 0:
            now = memory(server)
            first = first or now
            print(f"{k + 1:8d} {failed:5d} {now:5.0f} {now - first:5.0f}", flush=True)


def attack(port: int, count: int) -> None:
    """Hold connections for ever that send nothing, half a head, or much without reading any."""
    half = b"GET /health HTTP/1.1\r\nHost: localhost\r\nX-a: "
    greedy = b"GET /vendor/leaflet.js HTTP/1.1\r\nHost: localhost\r\n\r\n" * 120
    first, more = (b"", half, greedy), (b"", b"a", b"")
    held: list[socket.socket | None] = [None] * count
    while True:
        for k, link in enumerate(held):
            try:
                if link is None:
                    held[k] = link = socket.create_connection(("127.0.0.1", port), 5)
                    link.setblocking(False)
                    link.send(first[k % 3])
                elif k % 3 < 2 and link.send(more[k % 3]) == 0:
                    link.recv(1, socket.MSG_PEEK)
            except BlockingIOError:
                pass
            except OSError:
                held[k] = None
        time.sleep(0.2)


async def beside(folder: str, queries: list[dict[str, Any]], count: int) -> None:
    """Print the times of ``/health`` and of the event loop, measured in the same process."""
    from energyplan.serve import create_app, listen, server

    sys.setswitchinterval(1e-3)
    listening = listen("127.0.0.1", 0)
    port = listening.getsockname()[1]
    service, inside = server(create_app(folder, waiting=64)), list[float]()
    application = service.config.app

    async def timed(scope: Any, receive: Any, send: Any) -> None:
        begun = time.perf_counter()
        await application(scope, receive, send)
        if scope.get("path") == "/health":
            inside.append(time.perf_counter() - begun)

    service.config.app = timed
    serving = asyncio.create_task(service.serve([listening]))
    loop, delays, times, failed = asyncio.get_running_loop(), list[float](), list[float](), 0
    calls = [["--attack", str(port), str(count)], ["--work", str(port), json.dumps(queries)]]
    others = [subprocess.Popen([sys.executable, __file__, "-", *call]) for call in calls]
    try:
        await asyncio.sleep(10.0)
        until = loop.time() + SECONDS

        async def sleep() -> None:
            while loop.time() < until:
                begun = loop.time()
                await asyncio.sleep(0.02)
                delays.append(loop.time() - begun - 0.02)

        sampling = asyncio.create_task(sleep())
        while loop.time() < until:
            begun = loop.time()
            try:
                reader, writer = await asyncio.open_connection("127.0.0.1", port)
                writer.write(
                    b"GET /health HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n"
                )
                failed += not (await reader.read()).endswith(b"ok")
                writer.close()
            except OSError:
                failed += 1
            times.append(loop.time() - begun)
            await asyncio.sleep(0.05)
        await sampling
    finally:
        for other in others:
            other.terminate()
        service.should_exit = True
        await serving
    told = (("event loop", delays), ("/health inside", inside), ("/health and back", times))
    for name, found in told:
        p50, p95, most = 1e3 * np.quantile(found, (0.5, 0.95, 1.0))
        print(f"{name:16s} {len(found):5d} times: p50 {p50:.0f}, p95 {p95:.0f}, max {most:.0f} ms")
    print(f"{failed} of {len(times)} failed")


def work(port: int, queries: list[dict[str, Any]]) -> None:
    """Keep requests at work."""

    def client(number: int) -> None:
        k = number
        while True:
            k += AT_WORK
            try:
                ask(port, "plan", {**queries[k % len(queries)], "effort": 20 * EFFORT})
            except (OSError, http.client.HTTPException):
                time.sleep(0.1)

    threads = [threading.Thread(target=client, args=(k,)) for k in range(AT_WORK)]
    for thread in threads:
        thread.start()


def main() -> None:
    """Run what the arguments ask for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("map", type=Path)
    parser.add_argument("--each", type=int, default=20, help="requests of each client")
    parser.add_argument("--requests", type=int, default=0, help="requests of all kinds")
    parser.add_argument("--crowd", type=int, default=0, help="connections beside eight requests")
    parser.add_argument("--attack", nargs=2, type=int, help=argparse.SUPPRESS)
    parser.add_argument("--work", nargs=2, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.attack:
        attack(*given.attack)
    if given.work:
        work(int(given.work[0]), json.loads(given.work[1]))
        return
    grid = ep.read_map(given.map)
    vehicle = ep.PowerModel.preset(MODEL).vehicle
    poses = free_poses(grid, 40, 1, vehicle)
    with tempfile.TemporaryDirectory() as folder:
        for file in given.map.parent.glob(f"{given.map.stem}.*"):
            shutil.copy(file, folder)
        queries = [
            {
                "map": given.map.name, "model": MODEL, "effort": EFFORT,
                "start": [float(v) for v in start], "goal": [float(v) for v in goal],
            }
            for start, goal in zip(poses[::2], poses[1::2], strict=True)
        ]  # fmt: skip
        if given.crowd:
            asyncio.run(beside(folder, queries, given.crowd))
            return
        server, port = serve(folder, waiting=64)
        try:
            for query in queries:  # compiles, and makes the map's tables
                ask(port, "plan", query)
            if given.requests:
                endure(server, port, queries, given.requests)
                return
            print("clients requests/s  not 200  p50 ms   p99 ms  p50 beyond p99  slowest/quickest")
            for count in (1, 4, 16):
                clients(port, queries, count, given.each)
        finally:
            server.terminate()
            server.wait(30)


if __name__ == "__main__":
    main()
