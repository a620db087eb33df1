"""What the tests of batches have workers do; workers import little more than this."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

import numpy as np


def square(x: int) -> int:
    return x * x


def picky(x: int) -> int:
    if x % 5 == 3:
        raise ValueError(f"{x} is not to my taste")
    return x


def scaled(x: float, shared: np.ndarray) -> float:
    return float(x * shared.sum())


def deadly(x: int, marker: str) -> int:
    """Kill the worker at item 7 the first time, and at item 11 every time."""
    if x == 11:
        os.kill(os.getpid(), signal.SIGKILL)
    if x == 7 and not Path(marker).exists():
        Path(marker).touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return x


def slow(x: int, shared: str) -> tuple[int, int]:
    time.sleep(0.1)
    return x, os.getpid()
