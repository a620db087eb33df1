"""Turns that are driven at speed: arcs whose curvature changes gradually, in place of stops.

A turn on the spot or an arc beside a straight line makes the robot stop, as the speeds of its
treads may not jump. While it drives on with its outer tread, the inner one may slow down, stop or
run backwards, and speed up again. Over the distance of the outer tread, the difference between the
two treads then grows at a constant rate, stays, and falls: a turn's `Shape` is that rate and the
largest difference. `Turns.reshaped` puts such turns into the corners of a path; at its start and
its end, where the robot stands anyway, the difference is there from the first on.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import atan2, ceil, cos, hypot, isfinite, pi, remainder, sin, sqrt, tan
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from energyplan.path import FloatArray, Path
from energyplan.planning.budget import UNITS, Budget
from energyplan.planning.driven import corners_free
from energyplan.planning.problem import PlanningProblem
from energyplan.planning.settings import MOVING_TURNS
from energyplan.vehicle import TreadICR


class Shape(NamedTuple):
    """How a turn at speed changes the curvature."""

    slope: float  # growth of the treads' difference over the outer tread's distance [1/m]
    most: float  # largest difference, over the outer tread's: 1 stops the inner one, 2 spins [1]
    out: float = 0.0  # how far its corner is moved outwards, over what it cuts off [1]


class _Stretch(NamedTuple):
    """Straight lines in one direction that turns join, from a standstill to the next one."""

    start: FloatArray  # (2,): where the reference point starts [m]
    end: FloatArray  # (2,): where it ends [m]
    corners: FloatArray  # (n - 1, 2): where the n lines meet [m]
    ahead: float  # 1 forwards, -1 backwards
    yaw: float  # heading at the start [rad]
    turns: tuple[float, ...]  # (n + 1,): turn before each line and after the last one [rad]
    places: tuple[int, ...]  # (n + 1,): how many lines of the path come before each turn


class _Arcs(NamedTuple):
    """Motions one after the other."""

    ds: FloatArray
    dtheta: FloatArray

    def reach(self) -> FloatArray:
        """Return the way of the reference point from a heading of 0, shape (2,) [m]."""
        yaw = np.cumsum(self.dtheta) - 0.5 * self.dtheta
        chord = self.ds * np.sinc(self.dtheta / (2 * pi))
        return np.array([chord @ np.cos(yaw), chord @ np.sin(yaw)])


_NONE = _Arcs(np.zeros(0), np.zeros(0))


class Turns(NamedTuple):
    """A path whose turns can be replaced."""

    path: Path
    parts: tuple[_Stretch | _Arcs, ...]

    @property
    def places(self) -> list[int]:
        """How many lines of the path come before each turn that has a shape."""
        stretches = (part for part in self.parts if isinstance(part, _Stretch))
        return [place for part in stretches for place in part.places]

    @classmethod
    def of(cls, path: Path, kept: frozenset[int] = frozenset()) -> Turns:
        """Divide a path at standstills; turns after as many lines as in `kept` stay as they are."""
        lines = np.flatnonzero((path.dtheta == 0.0) & (path.ds != 0.0)).tolist()
        if not lines:
            return cls(path, (_Arcs(path.ds, path.dtheta),))
        points, yaws = path.points, path.vertices[:, 2]
        parts: list[_Stretch | _Arcs] = []
        first = lines[0] if 0 in kept else 0
        if first:
            parts.append(_Arcs(path.ds[:first], path.dtheta[:first]))
        turns, places = [float(yaws[lines[0]] - yaws[first])], [0]
        corners: list[FloatArray] = []
        for k, this in enumerate(lines):
            last = k + 1 == len(lines)
            other = len(path) if last else lines[k + 1]
            on = not last and path.ds[this] * path.ds[other] > 0
            if on and other == this + 1:
                continue
            turn = float(yaws[other] - yaws[this])
            place = None if last else _corner(points, yaws, this, other)
            free = k + 1 not in kept and (last or place is not None)
            if place is not None and free and on and abs(turn) < MOVING_TURNS.widest:
                turns.append(turn)
                corners.append(place)
                places.append(k + 1)
                continue
            # a turn before driving the other way ends the stretch; others stay as they are
            ended = free and not on
            end = other if ended else this + 1
            turns.append(turn if ended else 0.0)
            parts.append(
                _Stretch(
                    points[first], points[end], np.array(corners).reshape(-1, 2),
                    float(np.sign(path.ds[this])), float(yaws[first]), tuple(turns),
                    (*places, k + 1),
                )
            )  # fmt: skip
            if end < other:
                parts.append(_Arcs(path.ds[end:other], path.dtheta[end:other]))
            first, turns, corners, places = other, [0.0], [], [k + 1]
        return cls(path, tuple(parts))

    def reshaped(self, shapes: Sequence[Shape], icr: TreadICR) -> Reshaped:
        """Return a path with turns of given shapes."""
        whole: list[_Arcs] = []
        turns: list[NDArray[np.int_]] = []
        first = 0
        for part in self.parts:
            if isinstance(part, _Arcs):
                whole.append(part)
                turns.append(np.full((len(part.ds), 2), -1))
                continue
            last = first + len(part.turns)
            found = _joined(part, shapes[first:last], icr)
            if isinstance(found, int):
                return Reshaped(None, np.array([[first + found] * 2]))
            for k, arcs in enumerate(found):  # turns and lines alternate
                whole.append(arcs)
                turns.append(np.tile([first + k // 2, first + (k + 1) // 2], (len(arcs.ds), 1)))
            first = last
        ds, dtheta = (np.concatenate(column) for column in zip(*whole, strict=True))
        path = Path(self.path.start, ds, dtheta, self.path.longitudinal)
        return Reshaped(path, np.concatenate(turns))


class Reshaped(NamedTuple):
    """A path with turns at speed."""

    path: Path | None  # none where a line is too short
    turns: NDArray[np.int_]  # (n, 2): turns that decide on each segment, or on the line; -1 none


def _corner(points: FloatArray, yaws: FloatArray, this: int, other: int) -> FloatArray | None:
    """Return where two lines meet; None where they hardly do."""
    gap = points[other] - points[this + 1]
    if hypot(*gap) < MOVING_TURNS.still:
        return np.asarray(points[other])
    across = sin(yaws[other] - yaws[this])
    if abs(across) < MOVING_TURNS.parallel:
        return None
    along = (gap[0] * sin(yaws[other]) - gap[1] * cos(yaws[other])) / across
    heading = np.array([cos(yaws[this]), sin(yaws[this])])
    return np.asarray(points[this + 1] + along * heading)


def _joined(part: _Stretch, shapes: Sequence[Shape], icr: TreadICR) -> list[_Arcs] | int:
    """Return turns and lines of a stretch; or which turn is too long for its lines."""
    # where the first line begins and the last one ends depends on their headings, and these on it
    turns = list(part.turns)
    final = part.yaw + sum(turns)
    error = np.inf
    corners = _moved(part, shapes, icr)
    for _ in range(MOVING_TURNS.rounds):
        # without a turn before or after the lines, their headings may change by a small one
        begin = _arcs(turns[0], shapes[0], part.ahead, icr, False, part.turns[0] != 0.0)
        end = _arcs(turns[-1], shapes[-1], part.ahead, icr, part.turns[-1] != 0.0, False)
        way, back = begin.reach(), end.reach()
        longest = 0 if hypot(*way) > hypot(*back) else len(turns) - 1
        if error < MOVING_TURNS.exact:
            break
        places = np.vstack([
            part.start + _rotated(way, part.yaw),
            corners,
            part.end - _rotated(back, final - turns[-1]),
        ])  # fmt: skip
        steps = part.ahead * np.diff(places, axis=0)
        lengths = np.hypot(*steps.T)
        if lengths.min() < MOVING_TURNS.still:
            return longest
        yaw, error = part.yaw, 0.0
        for k, (x, y) in enumerate(steps):
            change = remainder(atan2(y, x) - yaw - turns[k], 2 * pi)
            turns[k] += change
            yaw += turns[k]
            error = max(error, abs(change))
        turns[-1] = final - yaw
    else:
        return longest
    count = len(lengths)
    between = [_arcs(turns[k], shapes[k], part.ahead, icr) for k in range(1, count)]
    cuts = [_cut(arcs, turn, part.ahead) for arcs, turn in zip(between, turns[1:-1], strict=True)]
    found = [begin]
    for k, arcs in enumerate([*between, end]):
        before, after = ([0.0, *cuts, 0.0])[k : k + 2]
        rest = lengths[k] - before - after
        if rest < 0.0:
            return k if before > after else k + 1
        found += [_Arcs(np.array([part.ahead * rest]), np.zeros(1)), arcs]
    return found


def _moved(part: _Stretch, shapes: Sequence[Shape], icr: TreadICR) -> FloatArray:
    """Return the corners of a stretch, moved outwards."""
    corners = part.corners.copy()
    yaw = part.yaw + np.cumsum(part.turns)
    for k, corner in enumerate(corners):
        turn, shape = part.turns[k + 1], shapes[k + 1]
        if shape.out:
            cut = _cut(_arcs(turn, shape, part.ahead, icr), turn, part.ahead)
            aside = yaw[k] + 0.5 * turn - 0.5 * pi * np.sign(turn)
            size = part.ahead * shape.out * cut * tan(0.25 * abs(turn))
            corner += size * np.array([cos(aside), sin(aside)])
    return corners


def _cut(arcs: _Arcs, turn: float, ahead: float) -> float:
    """Return how far from the corner a turn leaves one line and joins the other [m]."""
    x, y = arcs.reach()
    return float(ahead * (x * cos(0.5 * turn) + y * sin(0.5 * turn)) / (2.0 * cos(0.5 * turn)))


def _rotated(way: FloatArray, yaw: float) -> FloatArray:
    """Return a way turned by an angle."""
    return np.array([
        way[0] * cos(yaw) - way[1] * sin(yaw), way[0] * sin(yaw) + way[1] * cos(yaw)
    ])  # fmt: skip


def _arcs(
    turn: float, shape: Shape, ahead: float, icr: TreadICR,
    arrives: bool = True, leaves: bool = True,
) -> _Arcs:  # fmt: skip
    """Return a turn of a shape as arcs, which arrives on a line and leaves on one.

    Otherwise it begins, or ends, at a standstill.
    """
    area = abs(turn) * icr.slip_track
    if area < MOVING_TURNS.still**2:
        return _NONE
    ramps = leaves + arrives
    most = min(shape.most, sqrt(2.0 * area * shape.slope / ramps)) if ramps else shape.most
    ramp = most / shape.slope
    count = max(ceil(most / MOVING_TURNS.step), 2)
    rising = (np.arange(count) + 0.5) / count * most
    up, down = count * arrives, count * leaves
    difference = np.concatenate([rising[:up], [most], rising[::-1][:down]])
    outer = np.full(len(difference), ramp / count)
    outer[up] = area / most - 0.5 * ramps * ramp
    some = outer > MOVING_TURNS.still * outer.sum()
    outer, difference = outer[some], difference[some]
    dtheta = outer * difference / icr.slip_track
    dtheta *= turn / dtheta.sum()
    lever = icr.right if ahead * turn > 0 else icr.left
    return _Arcs(ahead * (outer - lever * np.abs(dtheta)) + 0.0, dtheta)


class _Shaped(NamedTuple):
    """A path's turns with their shapes."""

    corners: Turns
    shapes: list[Shape]


class TurnSearch:
    """The search for shapes of a path's turns with which driving it takes least.

    `candidate` returns the next path to drive, and `take` what came of it. All turns get one slope
    first, each moved outwards or a sharper one where it is not free; where that gains nothing, one
    turn alone does. Then the shape of each is changed by smaller and smaller steps.
    """

    def __init__(self, problem: PlanningProblem, path: Path, value: float) -> None:
        self._problem = problem
        icr, motor = problem.cost.icr, problem.cost.vehicle.motor
        self._icr = icr
        self._widest = min(2.0, icr.slip_track / (max(problem.radii) + 0.5 * icr.slip_track))
        speed = min(float(problem.cost.cheapest_speed(0.0)), motor.speed)
        self._slope = motor.acceleration / speed**2  # one tread slows down while the other does not
        self.value = value
        self._path = path
        self._corners = Turns.of(path)
        self._best: _Shaped | None = None
        self._tried: _Shaped | None = None
        self._proposals = self._proposed()
        self.over = False

    def candidate(self, budget: Budget) -> Path | None:
        """Return the next path to drive; None where the shapes tried allow none."""
        budget.spend(UNITS.reshaped)
        try:
            return next(self._proposals)
        except StopIteration:
            self.over = True
            return None

    def take(self, value: float) -> None:
        """Take what driving the candidate takes."""
        if value < self.value:
            self.value, self._best = value, self._tried

    def _proposed(self) -> Iterator[Path | None]:
        """Yield paths to drive, and None where one is not allowed."""
        if not (isfinite(self._slope) and self._slope > 0.0):
            return
        yield from self._with_slopes(frozenset())
        if self._best is None:
            # of all turns that can be driven at speed, those that gain by themselves
            every = frozenset(Turns.of(self._path).places)
            gaining: set[int] = set()
            for place in sorted(every):
                before = self.value
                yield from self._with_slopes(every - {place})
                if self.value < before:
                    gaining.add(place)
            if len(gaining) > 1:
                yield from self._with_slopes(every - gaining)
        if self._best is not None:
            yield from self._improved()

    def _improved(self) -> Iterator[Path | None]:
        """Yield paths with the shape of one turn after the other changed."""
        if self._best is not None:
            self._corners = self._best.corners
        step = MOVING_TURNS.first
        while step > MOVING_TURNS.last:
            before = self.value
            for k in range(len(self._corners.places)):
                yield from self._varied(k, "slope", step)
                yield from self._varied(k, "most", sqrt(step))
                yield from self._varied(k, "out", step)
            if self.value > before * (1.0 - MOVING_TURNS.gain):
                step = sqrt(step)

    def _varied(self, k: int, name: str, factor: float) -> Iterator[Path | None]:
        """Yield paths with one number of one turn changed, on as long as that gains."""
        for change in (factor, 1.0 / factor):
            gains = True
            while gains:
                shapes, before = list(self._best.shapes if self._best else ()), self.value
                number = getattr(shapes[k], name)
                number = number + change - 1.0 if name == "out" else number * change
                shapes[k] = shapes[k]._replace(**{name: number})
                if shapes[k].most > self._widest * (1.0 + 1e-9):
                    break
                yield self._allowed(shapes)
                gains = self.value < before
            if self.value < before:
                return

    def _with_slopes(self, kept: frozenset[int]) -> Iterator[Path | None]:
        """Yield paths whose turns have one slope, but for those to keep.

        Where a turn is not free it gets another shape, and after the last one it is kept too.
        """
        for factor in MOVING_TURNS.slopes:
            self._corners = Turns.of(self._path, kept)
            levels = dict.fromkeys(self._corners.places, 0)
            while places := self._corners.places:
                shapes = [self._shape(factor, levels[place]) for place in places]
                blocked = {places[k] for k in self._blocked(shapes)}
                if not blocked:
                    yield self._allowed(shapes)
                    break
                ends = places[0], places[-1]  # which no corner moves
                for place in blocked:
                    levels[place] += len(MOVING_TURNS.out) if place in ends else 1
                stay = {place for place in places if levels[place] >= MOVING_TURNS.levels} - kept
                if stay:
                    kept |= stay
                    self._corners = Turns.of(self._path, kept)
                elif max(levels.values()) >= MOVING_TURNS.levels:
                    return
                yield None

    def _shape(self, factor: float, level: int) -> Shape:
        """Return a shape that is moved outwards, then sharper, from level to level."""
        sharper, out = divmod(level, len(MOVING_TURNS.out))
        slope = factor * MOVING_TURNS.sharper**sharper * self._slope
        return Shape(slope, self._widest, MOVING_TURNS.out[out])

    def _blocked(self, shapes: Sequence[Shape]) -> set[int]:
        """Return turns that are too wide at places that are not free."""
        found = self._corners.reshaped(shapes, self._icr)
        if found.path is None:
            return {*found.turns.ravel().tolist()}
        at = self._problem.first_collision(found.path)
        if at is not None:
            return {*found.turns[min(at, len(found.turns) - 1)].tolist()} - {-1}
        problem, turns = self._problem, found.turns
        rounded = corners_free(found.path, problem.cost, problem.robot, problem.terrain.obstacles)
        inside = (turns[:-1] == turns[1:]).all(axis=1) & (turns[1:, 0] == turns[1:, 1])
        return {*turns[1:, 0][inside & ~rounded].tolist()} - {-1}

    def _allowed(self, shapes: list[Shape]) -> Path | None:
        """Return the path with turns of given shapes if the problem allows it."""
        path = self._corners.reshaped(shapes, self._icr).path
        if path is None or self._problem.fault(path) is not None:
            return None
        self._tried = _Shaped(self._corners, shapes)
        return path
