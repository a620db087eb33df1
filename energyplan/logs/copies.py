"""Drives that hold the same readings as others, by whatever name."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import combinations

import numpy as np

from energyplan.errors import InvalidInputError
from energyplan.logs import DriveLog
from energyplan.path import FloatArray

_COMPARED = 16  # samples of which all must be found before all others are compared
_ENOUGH = 20  # samples at the same times that are alike by no chance


def without_copies(
    train: Sequence[DriveLog], holdout: Sequence[DriveLog]
) -> tuple[list[DriveLog], list[str]]:
    """Take each drive once: what is read twice makes nothing surer, and judges nothing."""
    if any(log is other for log in train for other in holdout):
        raise InvalidInputError("a drive stands in train and in holdout; give it to one of them")
    kept: list[DriveLog] = []
    left_out: dict[int, str] = {}
    # The longest first: of a drive and a part of it, the drive stays.
    for k in sorted(range(len(train)), key=lambda k: -len(train[k])):
        known = _named(train[k], kept)
        if known is None:
            kept.append(train[k])
        else:
            left_out[k] = (
                f"{train[k].name} holds the same readings as {known}; they were learned from once"
            )
    learned = [log for k, log in enumerate(train) if k not in left_out]
    told = [left_out[k] for k in sorted(left_out)]
    told += [
        f"{one.name} and {other.name} hold the same {shared} samples, which count twice: "
        "standard errors are too small; give each sample once"
        for one, other in combinations(learned, 2) if (shared := _shared(one, other))
    ]  # fmt: skip
    for log in holdout:
        known = _named(log, learned)
        if known is not None:
            told.append(
                f"{log.name} holds the same readings as {known}, which was learned from: errors on "
                "it say nothing of other drives; hold out another one"
            )
            continue
        told += [
            f"{log.name} holds {shared} samples of {other.name}, which were learned from: "
            "errors on them say nothing of other drives; hold out others"
            for other in learned if (shared := _shared(log, other))
        ]  # fmt: skip
    return learned, told


def _named(log: DriveLog, others: Iterable[DriveLog]) -> str | None:
    """Return the name of a drive that holds all of another one's readings, or is part of it."""
    return next((other.name for other in others if _alike(log, other)), None)


def _alike(one: DriveLog, other: DriveLog) -> bool:
    """Tell whether the shorter of two drives is part of the longer one.

    Of robots that stand all readings may be the same.
    """
    few, many = sorted((one, other), key=len)
    short, long = _readings(few), _readings(many)
    if not np.any(short[0]):
        return False
    firsts = np.arange(len(many) - len(few) + 1)
    for place in np.linspace(0, len(few) - 1, _COMPARED).astype(int):
        for part, whole in zip(short, long, strict=True):
            firsts = firsts[whole[firsts + place] == part[place]]
    return any(
        all(
            np.array_equal(part, whole[first : first + len(few)])
            for part, whole in zip(short, long, strict=True)
        )
        for first in firsts
    )


def _shared(one: DriveLog, other: DriveLog) -> int:
    """Count the samples of a moving robot that stand in two drives at the same times."""
    _, mine, theirs = np.intersect1d(one.t, other.t, assume_unique=True, return_indices=True)
    some, others = (
        np.stack(_readings(log))[:, rows] for log, rows in ((one, mine), (other, theirs))
    )
    alike = np.all(some == others, axis=0) & np.any(some[:2] != 0.0, axis=0)
    count = int(np.count_nonzero(alike))
    return count if count >= _ENOUGH else 0


def _readings(log: DriveLog) -> list[FloatArray]:
    """Return what every drive has: the speeds of both sides, and the power."""
    return [log.channel("v_left"), log.channel("v_right"), log.power]
