"""Drives that hold the same readings as others are found by whatever name."""

from __future__ import annotations

import numpy as np
import pytest

from energyplan import DriveLog
from energyplan.errors import InvalidInputError
from energyplan.logs.checks import without_copies
from energyplan.path import FloatArray


def drive(name: str, seed: int = 0, count: int = 200, moves: bool = True) -> DriveLog:
    rng = np.random.default_rng(seed)
    speeds = np.round(rng.uniform(-1.0, 1.0, (2, count)), 1) if moves else np.zeros((2, count))
    return DriveLog.from_columns(
        {
            "t": 0.1 * np.arange(count), "v_left": speeds[0], "v_right": speeds[1],
            "power": np.round(50.0 * np.abs(speeds).sum(axis=0), 0),
        },
        name,
    )  # fmt: skip


def part(log: DriveLog, name: str, samples: slice, late: float = 0.0) -> DriveLog:
    def cut(values: FloatArray) -> FloatArray:
        return values[samples]

    channels = {key: cut(values) for key, values in log.channels.items()}
    return DriveLog.from_columns({**channels, "t": channels["t"] + late}, name)


WHOLE = drive("a")


@pytest.mark.parametrize("samples", [slice(None), slice(50, 150), slice(100)])
@pytest.mark.parametrize("first", [True, False])
def test_of_a_drive_and_a_part_of_it_the_drive_stays(samples: slice, first: bool) -> None:
    """Whatever its clock says, and whichever is given first."""
    same = part(WHOLE, "b", samples, late=1e4)
    train = [WHOLE, same] if first else [same, WHOLE]
    kept, told = without_copies([*train, drive("c", 1)], [])
    longest = train[0] if len(same) == len(WHOLE) else WHOLE
    assert [log.name for log in kept] == [longest.name, "c"]
    (line,) = told
    assert "holds the same readings as" in line


@pytest.mark.parametrize("samples", [slice(None), slice(50, 150)])
@pytest.mark.parametrize("whole_is_held_out", [True, False])
def test_a_part_of_a_drive_is_not_held_out_beside_it(
    samples: slice, whole_is_held_out: bool
) -> None:
    pairs = [[WHOLE], [part(WHOLE, "b", samples, late=1e4)]]
    train, holdout = pairs[::-1] if whole_is_held_out else pairs
    with pytest.raises(InvalidInputError, match="holds the same readings as"):
        without_copies([drive("c", 1), *train], [drive("d", 2), *holdout])
    segments = [WHOLE.segment(0.0, 10.0)], [WHOLE.segment(10.0, np.inf)]
    assert without_copies(*segments) == (segments[0], [])


def test_a_reading_that_differs_makes_another_drive() -> None:
    speeds = WHOLE.channel("v_left").copy()
    speeds[77] += 0.1
    other = DriveLog.from_columns({**WHOLE.channels, "v_left": speeds}, "b")
    kept, told = without_copies([WHOLE, other], [drive("c", 1)])
    assert kept == [WHOLE, other]
    assert [line.split(" hold ")[0] for line in told] == ["a and b"]  # most samples of each other


def test_robots_that_stand_are_no_copies_of_each_other() -> None:
    train = [drive("a", moves=False), drive("b", moves=False)]
    assert without_copies(train, []) == (train, [])


def test_cuts_of_a_drive_that_overlap_are_told() -> None:
    cuts = [part(WHOLE, "b", slice(120)), part(WHOLE, "c", slice(80, 200))]
    moving = np.any([WHOLE.channel(f"v_{side}")[80:120] for side in ("left", "right")], axis=0)
    kept, told = without_copies(cuts, [])
    assert kept == cuts
    assert told[0].startswith(f"b and c hold the same {moving.sum()} samples, which count twice")
    kept, told = without_copies(cuts[:1], cuts[1:])
    assert kept == cuts[:1]
    assert told[0].startswith(f"c holds {moving.sum()} samples of b, which were learned from")
    assert len(told) == 1
