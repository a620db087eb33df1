"""Time and peak memory of reading a bag, against its size.

A camera's raw images make up nearly all of the bag; the tread speeds and the power beside them are
what is wanted. Each bag is read in a process of its own. The last row is the same drive without a
camera: what memory it takes is the drive's, the rest the file's. Sizes are those of the content;
compressed, it takes half on the disk, as half of each picture is plain and half is noise.

Run ``python benchmarks/bags.py [--size MEGABYTES] [--kind KIND]``.
"""

from __future__ import annotations

import argparse
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
from small_bags import writer

RATE, FRAMES = 50.0, 10.0  # of the drive, of the camera [Hz]
SHAPE = (720, 1280, 3)
START = 1_700_000_000
KINDS = ("mcap", "mcap-zstd", "mcap-lz4", "sqlite", "sqlite-zstd", "ros1", "ros1-lz4", "ros1-bz2")
STATUS = """\
float64 left_driver_current
float64 right_driver_current
float64 left_driver_voltage
float64 right_driver_voltage
"""


def write(path: Path, seconds: float, kind: str, camera: bool) -> float:
    """Write a bag of so many seconds; return the megabytes that it holds, 28 a second of images."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    first = kind.startswith("ros1")
    store = get_typestore(Stores.ROS1_NOETIC if first else Stores.ROS2_HUMBLE)
    store.register(get_types_from_msg(STATUS, "husky_msgs/msg/HuskyStatus"))
    types = store.types
    dump = store.serialize_ros1 if first else store.serialize_cdr
    rng = np.random.default_rng(1)
    pixels = rng.integers(0, 256, np.prod(SHAPE), dtype=np.uint8)
    pixels[: len(pixels) // 2] = 200
    none, held = np.zeros(0), 0
    with writer(path, kind) as bag:

        def send(topic: str, name: str, t: float, message: Any) -> None:
            nonlocal held
            if topic not in known:
                known[topic] = bag.add_connection(topic, name, typestore=store)
            raw = dump(message, name)
            held += len(raw)
            bag.write(known[topic], round((START + t) * 1e9), raw)

        known: dict[str, Any] = {}
        for k in range(round(seconds * RATE)):
            t = k / RATE
            seconds_, nanoseconds = divmod(round((START + t) * 1e9), 10**9)
            stamp = types["builtin_interfaces/msg/Time"](sec=seconds_, nanosec=nanoseconds)
            more = {"seq": k} if first else {}
            header = types["std_msgs/msg/Header"](stamp=stamp, frame_id="base", **more)
            speed = 0.5 + 0.3 * np.sin(0.5 * t)
            joints = types["sensor_msgs/msg/JointState"](
                header=header, name=["left_wheel", "right_wheel"], position=none, effort=none,
                velocity=np.array([speed, 0.8 * speed]) / 0.1651,
            )  # fmt: skip
            send("/joint_states", "sensor_msgs/msg/JointState", t, joints)
            status = types["husky_msgs/msg/HuskyStatus"](
                left_driver_current=4.0, right_driver_current=3.0, left_driver_voltage=24.0,
                right_driver_voltage=24.0,
            )  # fmt: skip
            send("/status", "husky_msgs/msg/HuskyStatus", t, status)
            if camera and k % round(RATE / FRAMES) == 0:
                image = types["sensor_msgs/msg/Image"](
                    header=header, height=SHAPE[0], width=SHAPE[1], encoding="rgb8",
                    is_bigendian=0, step=SHAPE[1] * SHAPE[2], data=pixels,
                )  # fmt: skip
                send("/camera/image_raw", "sensor_msgs/msg/Image", t, image)
    return held / 1e6


def read(bag: Path) -> None:
    """Read a bag; print samples, seconds and the megabytes that doing so took at its peak."""
    from energyplan.io.logs import read_log

    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    start = time.perf_counter()
    log = read_log(bag, topics="husky")
    seconds = time.perf_counter() - start
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    print(len(log), seconds, peak / 1024, (peak - before) / 1024)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--size", type=float, default=200.0, help="largest bag [MB]")
    parser.add_argument("--kind", choices=KINDS, default="mcap")
    parser.add_argument("--read", type=Path, help=argparse.SUPPRESS)
    asked = parser.parse_args()
    if asked.read:
        read(asked.read)
        return
    second = FRAMES * float(np.prod(SHAPE)) / 1e6
    print("size [MB]  on disk  samples   read [s]   peak [MB]   of it reading [MB]")
    for size, camera in (
        (asked.size / 4, True), (asked.size / 2, True), (asked.size, True), (asked.size, False)
    ):  # fmt: skip
        with tempfile.TemporaryDirectory() as folder:
            bag = Path(folder) / ("drive.bag" if asked.kind.startswith("ros1") else "drive")
            held = write(bag, size / second, asked.kind, camera)
            files = bag.iterdir() if bag.is_dir() else [bag]
            actual = sum(file.stat().st_size for file in files) / 1e6
            child = subprocess.run(
                [sys.executable, __file__, "--read", str(bag)],
                capture_output=True, text=True, check=True,
            )  # fmt: skip
            samples, seconds, peak, added = child.stdout.split()
            print(
                f"{held:9.0f} {actual:8.0f} {samples:>8} {float(seconds):10.2f} "
                f"{float(peak):11.0f} {float(added):20.1f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
