"""What rounding changes in the answers: queries are moved by 1e-12, and the changes printed.

    python tests/golden/rounding.py [NAME...]

On one machine answers are the same bits twice. Another processor rounds otherwise (fused products,
its own sine), by parts of 1e-16; a search decides ties by such bits, and goes on from what it
decided. Moving start and goal by 1e-12 m and rad stands for that. What is printed is the largest
relative change of each key, of `ROUNDS` draws: the tolerances in `answers` are about twice that.
"""

from __future__ import annotations

import math
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import answers
import numpy as np

import energyplan as ep

SIZE, ROUNDS = 1e-12, 3


def moved(pose: ep.Pose, round_: int) -> ep.Pose:
    """Return a pose moved by `SIZE`; within a round the same pose is moved to the same one."""
    at = [abs(math.floor(1e6 * value)) for value in pose]
    signs = np.random.default_rng([round_, *at]).choice([-1, 1], 3)
    return ep.Pose(*(value + SIZE * float(sign) for value, sign in zip(pose, signs, strict=True)))


def changes(at: str, was: Any, now: Any) -> Iterator[tuple[str, float]]:
    """Yield the relative change of each number; infinite where something else changed."""
    if isinstance(was, dict) and isinstance(now, dict) and was.keys() == now.keys():
        for key in was:
            yield from changes(f"{at}.{key}", was[key], now[key])
    elif isinstance(was, list) and isinstance(now, list) and len(was) == len(now):
        for a, b in zip(was, now, strict=True):
            yield from changes(at, a, b)
    elif was != now:
        number = isinstance(was, float | int) and isinstance(now, float | int)
        yield at, abs(was - now) / max(abs(was), abs(now)) if number else math.inf


def main(names: list[str]) -> None:
    """Print the largest change of each key of these answers, or of all that have routes."""
    made = ep.PlanningProblem.__post_init__
    routes = [name for name, one in answers.ANSWERS.items() if one.tolerances]
    with tempfile.TemporaryDirectory() as folder:
        answers.material(Path(folder))
        for name in names or routes:
            was, largest = answers.answer(name, Path(folder)), dict[str, float]()
            for round_ in range(ROUNDS):

                def init(self: ep.PlanningProblem, round_: int = round_) -> None:
                    made(self)
                    for end in ("start", "goal"):
                        object.__setattr__(self, end, moved(getattr(self, end), round_))

                ep.PlanningProblem.__post_init__ = init
                try:
                    now = answers.answer(name, Path(folder))
                finally:
                    ep.PlanningProblem.__post_init__ = made
                for at, change in changes("", was, now):
                    largest[at] = max(change, largest.get(at, 0.0))
            for at, change in sorted(largest.items(), key=lambda one: -one[1]):
                print(f"{name}{at}: {change:.1e}")


if __name__ == "__main__":
    main(sys.argv[1:])
