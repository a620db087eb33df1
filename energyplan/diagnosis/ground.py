"""Lines on the ground that a drive crossed, and those among them that may be a border (private).

A line has a direction, that of its normal [rad], and an offset along it from the map's origin [m].
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np
from numpy.typing import NDArray

from energyplan.diagnosis.part import Part
from energyplan.fit.drives.drive import Drive
from energyplan.path import FloatArray
from energyplan.power.effects import Effect
from energyplan.vehicle import Vehicle

_SHARES = (0.2, 0.35, 0.5, 0.65, 0.8)  # of the time that contacts are on one side of a line
_FINE_SHARES = tuple(np.linspace(0.03, 0.97, 17))
_TURN = np.pi / 16  # between fine lines [rad]
_CLOSE = 0.125  # distance of the closest lines over that of a contact from the robot's middle
_LEAST_SIDE = 0.1  # share of the time on either side of a line, of which it tells
_LEAST_VISITED = 0.03  # of a side that was visited as often as this:
_VISITS = 3


@dataclass(frozen=True)
class Ground:
    """Where the contacts of a robot were while it moved."""

    drives: Sequence[Drive]  # drives with ``x`` and ``y``
    vehicle: Vehicle  # tells where the contacts are

    @cached_property
    def places(self) -> tuple[FloatArray, ...]:
        """Place of each contact on each drive, shape (n, contacts, 2) [m]; NaN at rest.

        A robot that spins on the spot has its contacts on both sides of a line, and its middle on
        none.
        """
        found = []
        for drive in self.drives:
            motion = drive.motion
            at = np.column_stack([motion.channels[name] for name in "xy"])[:, None]
            if "yaw" in motion.channels:
                ahead, aside = (part(motion.channels["yaw"]) for part in (np.cos, np.sin))
                x, y = self.vehicle.contacts.T
                turned = [np.outer(ahead, x) - np.outer(aside, y)]
                turned += [np.outer(aside, x) + np.outer(ahead, y)]
                at = at + np.stack(turned, axis=-1)
            moves = (motion.v_left != 0.0) | (motion.v_right != 0.0)
            found.append(np.where(moves[:, None, None], at, np.nan))
        return tuple(found)

    @cached_property
    def _visited(self) -> FloatArray:
        """Places of all contacts while the robot moved, shape (m, 2) [m]."""
        every = np.concatenate([place.reshape(-1, 2) for place in self.places])
        return np.asarray(every[np.isfinite(every).all(axis=1)])

    @cached_property
    def middle(self) -> FloatArray:
        """Mean place, shape (2,) [m]: lines turn about it, however far the map's origin is."""
        return np.asarray(self._visited.mean(axis=0) if len(self._visited) else np.zeros(2))

    def from_middle(self, line: FloatArray) -> FloatArray:
        """Return a line's direction, and its offset from the middle [m]."""
        direction, offset = line
        return np.array([direction, offset - self.middle @ _normal(direction)])

    def from_origin(self, line: FloatArray) -> FloatArray:
        """Return a line's direction, and its offset from the origin, given that from the middle."""
        direction, apart = line
        return np.array([direction, apart + self.middle @ _normal(direction)])

    def lines(self, effect: Effect, fine: bool = False) -> Iterator[Part]:
        """Yield variants of an effect for lines that cross the ground driven on."""
        count, shares = (16, _FINE_SHARES) if fine else (8, _SHARES)
        for direction in np.arange(count) * np.pi / count:
            along = self._visited @ _normal(direction)
            for offset in np.quantile(along, shares) if len(along) else ():
                line = np.array([direction, offset])
                if not fine or self.crosses(line):
                    yield _at(effect, line)

    @cached_property
    def _span(self) -> float:
        """Length of the ground driven on, but for its fringes [m]."""
        low, high = np.quantile(self._visited, (0.03, 0.97), axis=0)
        return float(np.max(high - low))

    @cached_property
    def levels(self) -> int:
        """How often fine lines are made closer until their ends are close, once at least."""
        turns = 0.5 * _TURN * self._span / (_CLOSE * self._reach)
        return int(np.ceil(np.log2(max(turns, 2.0))))

    def about(self, parts: Sequence[Part], level: int) -> Iterator[Part]:
        """Yield each of some lines, and up to eight about it, the closer the higher the level."""
        steps = self._steps(level)
        for part in parts:
            middle = self.from_middle(part.values)
            for away in product((0, -1, 1), repeat=2):
                line = self.from_origin(middle + np.array(away) * steps)
                if away == (0, 0) or self.crosses(line):
                    yield _at(part.effect, line)

    def apart(self, ranked: Sequence[Part], level: int) -> list[Part]:
        """Return lines without those that are next to a better one, best first."""
        steps = self._steps(level)
        kept: list[Part] = []
        for part in ranked:
            gaps = (np.abs(self._gap(part, other)) for other in kept)
            if all(np.any(gap > 1.5 * steps) for gap in gaps):
                kept.append(part)
        return kept

    def crosses(self, line: FloatArray) -> bool:
        """Tell whether contacts were on both sides of a line for long enough, or often enough."""
        along = [place @ _normal(line[0]) - line[1] for place in self.places]
        beyond = [each > 0.0 for each in along]
        before = [each < 0.0 for each in along]
        counts = [sum(int(np.count_nonzero(each)) for each in side) for side in (before, beyond)]
        share = min(counts) / max(sum(counts), 1)
        if share >= _LEAST_SIDE or share < _LEAST_VISITED:
            return share >= _LEAST_SIDE
        side = before if counts[0] < counts[1] else beyond
        return sum(map(_visits, self.drives, side)) >= _VISITS

    @cached_property
    def _reach(self) -> float:
        """Distance of the outermost contact from the robot's middle [m]."""
        return float(np.hypot(*self.vehicle.contacts.T).max())

    @property
    def first_step(self) -> FloatArray:
        """First step from a line that is close to the best one [rad] and [m]."""
        return np.array([0.25 * _TURN, 2.0 * _CLOSE * self._reach])

    def _steps(self, level: int) -> FloatArray:
        """Distance of neighbouring lines [rad] and [m]: of fine ones first, and of close ones."""
        close, fine = _CLOSE * self._reach, self._span / len(_FINE_SHARES)
        share = level / self.levels
        return np.array([_TURN / 2.0**level, fine ** (1.0 - share) * close**share])

    def _gap(self, one: Part, other: Part) -> FloatArray:
        return self.from_middle(one.values) - self.from_middle(other.values)


def _normal(direction: float) -> FloatArray:
    return np.array([np.cos(direction), np.sin(direction)])


def _at(effect: Effect, line: FloatArray) -> Part:
    return Part(effect, (("direction", float(line[0])), ("offset", float(line[1]))))


def _visits(drive: Drive, there: NDArray[np.bool_]) -> int:
    """Return how often half of the contacts came to a side of a line.

    Half a second after they left it at least: a pose that is noisy seems to come and go while it
    stands by the line.
    """
    half = there.mean(axis=1) >= 0.5
    some = drive.windows[0].mean(half.astype(float)) > 0.0
    return int(np.count_nonzero(np.diff(some, prepend=False) & some))
