"""Making a drivable path cheaper with exact steering, as long as that gains anything.

`Refiner` works on one path: dynamic programming over its poses finds the shortcuts, then poses are
moved, removed and inserted at random. The path is free of collisions and costs no more after
each step, so it can stop at any time.

`Portfolio` divides the budget among several paths. How cheap a path becomes shows only when it is
refined, and a path that starts cheaper often ends more expensive. So all of them are refined a
little, the best to the end, and after it those of the best four that are not much worse.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from math import atan2, cos, hypot, inf, pi, sin
from typing import NamedTuple

import numpy as np

from energyplan.compilation import Flags, Floats, FloatTable, Words, inner, njit
from energyplan.path import Path, Pose
from energyplan.planning.budget import UNITS, Budget, Work
from energyplan.planning.settings import REFINING
from energyplan.planning.space.compiled import Segments, merged
from energyplan.planning.space.motions import KernelProblem, join, motion_cost, pose_at, put_pose
from energyplan.steering.kernels import MAX_SEGMENTS, arc_end, steer_energy


class Chain(NamedTuple):
    """Poses and what it costs to get from each to the next."""

    poses: FloatTable  # (capacity, 3): poses of the centre of the tread ICRs
    cost: Floats  # (capacity,): cost from each pose to the next
    kept: Flags  # (capacity,): whether the motion to the next pose is a given one
    ds: Floats  # (capacity,): length of the motion to the next pose [m]
    dtheta: Floats  # (capacity,): turn of that motion [rad]
    step: Floats  # (capacity,): distance by which to try moving each pose [m]


class Shortened(NamedTuple):
    """What is left of a chain."""

    poses: int  # how many poses
    steered: int
    tested: int


@njit
def shortcut(
    chain: Chain, setting: KernelProblem, count: int, reach: int, most: float
) -> Shortened:
    """Shortcutting: the chain keeps the poses of its cheapest sequence of joins.

    Dynamic programming over all pairs of poses within `reach` of each other in the chain; `cost` of
    the motions given must be filled in. Beyond `most` units of work the motions given are kept.
    """
    ds = np.empty(MAX_SEGMENTS)
    dtheta = np.empty(MAX_SEGMENTS)
    best = np.empty(count)
    before = np.empty(count, np.int64)
    joined = np.empty(count, np.bool_)
    edge = np.empty(count)
    steered = 0
    tested = 0
    best[0] = 0.0
    before[0] = -1
    for j in range(1, count):
        best[j] = best[j - 1] + chain.cost[j - 1]
        before[j] = j - 1
        joined[j] = not chain.kept[j - 1]
        edge[j] = chain.cost[j - 1]
        blocked = 0
        for i in range(j - 1, max(0, j - reach) - 1, -1):
            if blocked == REFINING.hopeless:
                break
            if UNITS.steer * steered + UNITS.join * tested >= most:
                break
            limit = best[j] - best[i] - 1e-9 - setting.stop
            if setting.stop > 0.0:  # of equal ways that of fewer poses, which move as one
                limit += 2e-9
            if limit <= 0:
                continue
            a = pose_at(chain.poses, i)
            b = pose_at(chain.poses, j)
            dx = b.x - a.x
            dy = b.y - a.y
            if setting.least_metre * hypot(dx, dy) >= limit:
                continue
            steered += 1
            least = steer_energy(dx, dy, a.yaw, b.yaw, setting.steering)
            if least >= limit:
                continue
            tested += 1
            cost, _ = join(setting, a, b, limit + setting.stop, ds, dtheta)
            if cost < inf:
                blocked = 0
            elif least < limit * (1.0 - REFINING.clear):  # else it may only cost too much
                blocked += 1
            if cost < limit + setting.stop:
                best[j] = best[i] + cost
                before[j] = i
                joined[j] = True
                edge[j] = cost
    order = np.empty(count, np.int64)
    n = 0
    j = count - 1
    while j >= 0:
        order[n] = j
        n += 1
        j = before[j]
    for k in range(n):
        j = order[n - 1 - k]
        put_pose(chain.poses, k, pose_at(chain.poses, j))
        chain.step[k] = REFINING.first
        if k > 0:
            chain.cost[k - 1] = edge[j]
            chain.kept[k - 1] = not joined[j]
            if not joined[j]:
                chain.ds[k - 1] = chain.ds[j - 1]
                chain.dtheta[k - 1] = chain.dtheta[j - 1]
    return Shortened(n, steered, tested)


@inner
def _goes_on(chain: Chain, k: int) -> bool:
    """Whether the motion from pose `k` goes on as the one before it."""
    if k == 0 or not (chain.kept[k] and chain.kept[k - 1]):
        return False
    across = chain.ds[k] * chain.dtheta[k - 1] - chain.ds[k - 1] * chain.dtheta[k]
    along = chain.ds[k] * chain.ds[k - 1] + chain.dtheta[k] * chain.dtheta[k - 1]
    return bool(along > 0.0 and abs(across) <= 1e-9 * along)


@inner
def random_number(state: Words) -> float:
    """Return a random number in [0, 1) (xorshift)."""
    word = state[0]
    word ^= (word << np.uint64(13)) & np.uint64(0xFFFFFFFFFFFFFFFF)
    word ^= word >> np.uint64(7)
    word ^= (word << np.uint64(17)) & np.uint64(0xFFFFFFFFFFFFFFFF)
    state[0] = word
    return float(word >> np.uint64(11)) / 9007199254740992.0


@inner
def _copy(chain: Chain, k: int, other: int) -> None:
    """Copy one place of the chain to another."""
    put_pose(chain.poses, k, pose_at(chain.poses, other))
    chain.cost[k] = chain.cost[other]
    chain.kept[k] = chain.kept[other]
    chain.ds[k] = chain.ds[other]
    chain.dtheta[k] = chain.dtheta[other]
    chain.step[k] = chain.step[other]


@inner
def _try_move(
    chain: Chain, setting: KernelProblem, k: int, left_out: int, pose: Pose, ds: Floats,
    dtheta: Floats,
) -> bool:  # fmt: skip
    """Move pose `k` and leave out some poses after it, if that is cheaper and free."""
    old = 0.0
    for i in range(k - 1, k + 1 + left_out):
        old += chain.cost[i]
    a = pose_at(chain.poses, k - 1)
    b = pose_at(chain.poses, k + 1 + left_out)
    steering = setting.steering
    before = steer_energy(pose.x - a.x, pose.y - a.y, a.yaw, pose.yaw, steering)
    rest = steer_energy(b.x - pose.x, b.y - pose.y, pose.yaw, b.yaw, steering)
    if before + rest >= old:
        return False
    # the way there, then the way on
    costs = (inf, inf)
    limit = old - rest
    for part in range(2):
        first = a if part == 0 else pose
        last = pose if part == 0 else b
        cost, _ = join(setting, first, last, limit, ds, dtheta)
        if cost == inf:
            return False
        costs = (costs[1], cost)
        limit = old - cost - 1e-9
    put_pose(chain.poses, k, pose)
    chain.cost[k - 1] = costs[0]
    chain.cost[k] = costs[1]
    chain.kept[k - 1] = False
    chain.kept[k] = False
    return True


@inner
def _between(chain: Chain, setting: KernelProblem, k: int, state: Words) -> Pose:
    """Return a pose near pose `k` and the next one, turned to where it is reached from or left to.

    What is driven straight there or from there needs no turn, so that it ends with one stop fewer.
    """
    share = random_number(state)
    here = pose_at(chain.poses, k)
    there = pose_at(chain.poses, k + 1)
    step = chain.step[k] + 0.5 * hypot(there.x - here.x, there.y - here.y)
    x = here.x + share * (there.x - here.x) + step * (2.0 * random_number(state) - 1.0)
    y = here.y + share * (there.y - here.y) + step * (2.0 * random_number(state) - 1.0)
    return _facing(chain, k, Pose(x, y, here.yaw), 1, state)


@inner
def _facing(chain: Chain, k: int, pose: Pose, left_out: int, state: Words) -> Pose:
    """Return a place for pose `k`, facing along the straight line from or to its neighbour.

    Where the neighbour nearly faces along it too, the place is on its line: no tiny turn is left.
    """
    if random_number(state) < 0.5:
        other = pose_at(chain.poses, k - 1)
        yaw = atan2(pose.y - other.y, pose.x - other.x)
    else:
        other = pose_at(chain.poses, k + 1 + left_out)
        yaw = atan2(other.y - pose.y, other.x - pose.x)
    if cos(yaw - pose.yaw) < 0.0:
        yaw += pi
    if abs(sin(0.5 * (yaw - other.yaw))) < REFINING.aligned:
        ahead = (pose.x - other.x) * cos(other.yaw) + (pose.y - other.y) * sin(other.yaw)
        x = other.x + ahead * cos(other.yaw)
        y = other.y + ahead * sin(other.yaw)
        return Pose(x, y, other.yaw)
    return Pose(pose.x, pose.y, yaw)


@inner
def insert_pose(
    chain: Chain,
    setting: KernelProblem,
    count: int,
    k: int,
    fraction: float,
    ds: Floats,
    dtheta: Floats,
) -> int:
    """Put one more pose onto the motion from pose `k` to the next one; return the new number."""
    a = pose_at(chain.poses, k)
    b = pose_at(chain.poses, k + 1)
    pose = a
    costs = (inf, inf)
    # the whole motion, on which the pose is chosen; then the way there, and the way on
    for part in range(3):
        first = pose if part == 2 else a
        last = pose if part == 1 else b
        cost, n = join(setting, first, last, inf, ds, dtheta)
        if part == 0:
            if n == 0:
                return count
            pose = _along(setting, a, fraction, ds, dtheta, n)
        costs = (costs[1], cost)
    if costs[0] + costs[1] > chain.cost[k] * (1.0 + 1e-9) + 1e-9:
        return count
    for i in range(count, k + 1, -1):
        _copy(chain, i, i - 1)
    put_pose(chain.poses, k + 1, pose)
    chain.cost[k] = costs[0]
    chain.cost[k + 1] = costs[1]
    chain.kept[k + 1] = False
    chain.step[k + 1] = REFINING.first
    return count + 1


@inner
def _along(
    setting: KernelProblem, start: Pose, fraction: float, ds: Floats, dtheta: Floats, n: int
) -> Pose:
    """Return the pose after a fraction of a motion, by its length and turning."""
    total = 0.0
    for i in range(n):
        total += abs(ds[i]) + setting.half_track * abs(dtheta[i])
    left = fraction * total
    here = start
    for i in range(n):
        size = abs(ds[i]) + setting.half_track * abs(dtheta[i])
        part = min(left / size, 1.0) if size > 0 else 1.0
        here = arc_end(here, part * ds[i], part * dtheta[i])
        left -= part * size
        if part < 1.0:
            break
    return here


@inner
def _without(chain: Chain, count: int, k: int) -> int:
    """Leave out pose `k`, whatever motions cost then; return the new number."""
    for i in range(k, count - 1):
        _copy(chain, i, i + 1)
    return count - 1


@njit
def polish(chain: Chain, setting: KernelProblem, count: int, trials: int, state: Words) -> int:
    """Move, remove and insert poses at random where that is cheaper; return their number."""
    ds = np.empty(MAX_SEGMENTS)
    dtheta = np.empty(MAX_SEGMENTS)
    most = min(len(chain.cost) - 1, count + 4)
    for _ in range(trials):
        what = random_number(state)
        if count < 3 or (what < REFINING.insert and count < most):
            k = int(random_number(state) * (count - 1))
            if not chain.kept[k]:
                count = insert_pose(chain, setting, count, k, random_number(state), ds, dtheta)
            if count < 3:
                return count
            continue
        k = 1 + int(random_number(state) * (count - 2))
        if what < REFINING.insert + REFINING.remove:
            old = chain.cost[k - 1] + chain.cost[k]
            a = pose_at(chain.poses, k - 1)
            b = pose_at(chain.poses, k + 1)
            limit = old * (1 + 1e-12)
            cost, _ = join(setting, a, b, limit, ds, dtheta)
            if cost < inf:
                count = _without(chain, count, k)
                chain.cost[k - 1] = cost
                chain.kept[k - 1] = False
            continue
        if setting.stop > 0.0 and k < count - 2 and what > 1.0 - REFINING.merge:
            pose = _between(chain, setting, k, state)
            if _try_move(chain, setting, k, 1, pose, ds, dtheta):
                cost = chain.cost[k]
                count = _without(chain, count, k + 1)
                chain.cost[k] = cost
                chain.kept[k] = False
            continue
        step = chain.step[k]
        x = chain.poses[k, 0]
        y = chain.poses[k, 1]
        yaw = chain.poses[k, 2]
        kind = random_number(state)
        if kind < REFINING.shift:
            x += step * (2.0 * random_number(state) - 1.0)
            y += step * (2.0 * random_number(state) - 1.0)
        if kind > 1.0 - REFINING.turn:
            yaw += step / setting.half_track * (2.0 * random_number(state) - 1.0)
        pose = Pose(x, y, yaw)
        if setting.stop > 0.0 and random_number(state) < 0.5:
            pose = _facing(chain, k, pose, 0, state)
        if _try_move(chain, setting, k, 0, pose, ds, dtheta):
            chain.step[k] = min(step * REFINING.longer, REFINING.largest)
        else:
            chain.step[k] = max(step * REFINING.shorter, REFINING.smallest)
            if chain.step[k] == REFINING.smallest:
                chain.step[k] = REFINING.anew
    return count


@njit
def fill_costs(chain: Chain, setting: KernelProblem, count: int) -> None:
    """Price the motions given between the poses of a chain; the stop that ends one is of the next.

    A motion given that goes on as the one before it has no stop.
    """
    for k in range(count - 1):
        chain.cost[k] = motion_cost(setting, pose_at(chain.poses, k), chain.ds[k], chain.dtheta[k])
        if not _goes_on(chain, k):
            chain.cost[k] += setting.stop


@njit
def unfold(
    chain: Chain,
    setting: KernelProblem,
    count: int,
    ds: Floats,
    dtheta: Floats,
) -> int:
    """Write the motions of a chain and return how many there are."""
    part_ds = np.empty(MAX_SEGMENTS)
    part_dtheta = np.empty(MAX_SEGMENTS)
    n = 0
    for k in range(count - 1):
        if chain.kept[k]:
            ds[n] = chain.ds[k]
            dtheta[n] = chain.dtheta[k]
            n += 1
            continue
        a = pose_at(chain.poses, k)
        b = pose_at(chain.poses, k + 1)
        _, m = join(setting, a, b, inf, part_ds, part_dtheta)
        for i in range(m):
            ds[n + i] = part_ds[i]
            dtheta[n + i] = part_dtheta[i]
        n += m
    return n


class Refiner:
    """A path that becomes cheaper."""

    def __init__(self, setting: KernelProblem, segments: Segments, seed: int = 1) -> None:
        self.setting = setting
        self._state = np.array([0x9E3779B97F4A7C15 ^ (seed * 0x2545F4914F6CDD1D % 2**63)], "u8")
        self._load(segments)

    def _load(self, segments: Segments) -> None:
        """Set the chain to some motions, cut into short ones."""
        setting = self.setting
        whole = merged(segments)
        path = Path(setting.start, whole.ds, whole.dtheta)
        extent = path.length + setting.half_track * path.turning
        spare = max(REFINING.poses - len(path), REFINING.spare)
        piece = max(extent / spare, REFINING.piece)
        turn = max(piece / setting.half_track, REFINING.pivot)
        fine = path.subdivide(max_ds=piece, max_dtheta=turn)
        count = len(fine) + 1
        room = count + 16
        self.chain = Chain(
            np.zeros((room, 3)),
            np.zeros(room),
            np.ones(room, bool),
            np.zeros(room),
            np.zeros(room),
            np.full(room, REFINING.first),
        )
        self.count = count
        self.chain.poses[:count] = fine.vertices
        # the last pose is the goal itself, not the sum of rounded motions
        self.chain.poses[count - 1] = setting.goal
        self.chain.ds[: count - 1] = fine.ds
        self.chain.dtheta[: count - 1] = fine.dtheta
        fill_costs(self.chain, setting, count)

    @property
    def cost(self) -> float:
        """Cost of the path as it is."""
        return float(self.chain.cost[: self.count - 1].sum())

    @property
    def segments(self) -> Segments:
        """The motions as they are."""
        room = self.count * MAX_SEGMENTS
        ds, dtheta = np.empty(room), np.empty(room)
        n = unfold(self.chain, self.setting, self.count, ds, dtheta)
        return Segments(ds[:n].copy(), dtheta[:n].copy())

    def shortcut(self, budget: Budget) -> None:
        """Leave out the poses without which the path is cheaper."""
        # of many poses most are left out by short shortcuts, which take little work
        reach = REFINING.near
        while self.count > REFINING.span > reach and not budget.over:
            before = self.count
            self._shortcut(reach, budget)
            if self.count > REFINING.fewer * before:
                reach *= 2
        self._shortcut(REFINING.span, budget)

    def _shortcut(self, span: int, budget: Budget) -> None:
        # few poses take little work, and a path whose first part alone is shortened gains less
        most = budget.left if self.count > REFINING.span else np.inf
        left = shortcut(self.chain, self.setting, self.count, span, most)
        self.count = int(left.poses)
        budget.spend(UNITS.steer * left.steered + UNITS.join * left.tested)

    def again(self, budget: Budget) -> None:
        """Cut the path into short motions once more, and search for shortcuts between them."""
        before = self.chain, self.count, self.cost
        self._load(self.segments)
        self.shortcut(budget)
        if self.cost > before[2]:
            self.chain, self.count = before[0], before[1]

    def polish(self, budget: Budget, enough: float = 0.0, most: int = REFINING.trials) -> None:
        """Move poses, so many times at most, until the budget is over or the cost is `enough`."""
        for _ in range(0, most, REFINING.trials):
            if budget.over or self.cost <= enough or self.count < 3:
                break
            trials = REFINING.trials
            self.count = int(polish(self.chain, self.setting, self.count, trials, self._state))
            budget.spend(UNITS.join * trials)

    def steps(self) -> Iterator[Callable[[Budget], None]]:
        """Yield the steps that make the path better, until little is gained."""
        for shorten in (self.shortcut, self.again):
            yield shorten
            mark, since = self.cost, 0
            while since < REFINING.patience and self.count >= 3:
                yield self.polish
                since += REFINING.trials
                if self.cost < mark * (1.0 - REFINING.gain):
                    mark, since = self.cost, 0


class Portfolio:
    """The best motions known, and those that have not been refined yet."""

    def __init__(self, setting: KernelProblem, seed: int) -> None:
        self.setting = setting
        self.best = Segments(np.empty(0), np.empty(0))
        self.cost = np.inf
        self.seed = seed
        self._entered: list[float] = []
        self._fresh: list[Refiner] = []
        self._kept: list[Refiner] = []
        self._steps: dict[Refiner, Iterator[Callable[[Budget], None]]] = {}

    def enter(self, motions: Segments) -> None:
        """Take in motions from the start to the goal, free of collisions."""
        entrant = Refiner(self.setting, motions, self.seed)
        if any(abs(entrant.cost - cost) <= REFINING.same * cost for cost in self._entered):
            return
        self._entered.append(entrant.cost)
        if entrant.cost < self.cost:
            self.cost, self.best = entrant.cost, motions
        self._fresh.append(entrant)

    def priced(self, stop: float) -> Portfolio:
        """Return a portfolio of the best motions in which every stop has a price."""
        other = Portfolio(self.setting._replace(stop=stop), self.seed)
        other.enter(self.best)
        return other

    def _offer(self, entrant: Refiner) -> None:
        """Take in what a path was refined to."""
        if entrant.cost < self.cost:
            self.cost, self.best = entrant.cost, entrant.segments

    @property
    def fresh(self) -> bool:
        """Whether a path that was entered has not been refined yet."""
        return bool(self._fresh)

    def work(self, enough: float) -> Work | None:
        """Return the next step of refining: of a path not refined yet, or of the best that gains.

        Nothing is gained by a path whose cost is `enough`.
        """
        if self._fresh:
            entrant = self._fresh.pop(0)
            steps = self._steps[entrant] = entrant.steps()

            def first(own: Budget) -> None:
                next(steps)(own)  # its shortcuts, then some moved poses
                if entrant.cost > enough:
                    next(steps)(own)

            return Work(first, REFINING.opening, partial(self._keep, entrant))
        for entrant in self._kept:
            if self.cost <= enough or entrant.cost > REFINING.hope * self.cost:
                break
            step = next(self._steps[entrant], None)
            if step is not None:
                return Work(step, REFINING.step, partial(self._keep, entrant))
        return None

    def _keep(self, entrant: Refiner, _: object = None) -> None:
        """Take in what a path was refined to, and keep the best few."""
        self._offer(entrant)
        kept = dict.fromkeys([*self._kept, entrant])
        self._kept = sorted(kept, key=lambda one: one.cost)[: REFINING.kept]
