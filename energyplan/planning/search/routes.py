"""A* over cells, heading intervals and facings: up to four routes, cheapest by length and turning.

The cost-to-go leads along the shortest route, however much that turns; where turning is expensive a
longer one may cost much less. Each route penalises the cells of those before. Where there is room
steps are long.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import atan2, ceil, hypot, inf, pi
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from energyplan.compilation import Floats, Ints, IntTable, ShortInts, Words, inner, njit
from energyplan.path import Pose
from energyplan.planning.budget import SHARES, UNITS, Budget
from energyplan.planning.search.tracking import Tracked, chain_from, track_route
from energyplan.planning.settings import ROUTES
from energyplan.planning.space.compiled import Segments
from energyplan.planning.space.configurations import HEADINGS
from energyplan.planning.space.cost_to_go import CostToGo, node_at
from energyplan.planning.space.motions import (
    KernelProblem,
    motion_cost,
    price,
    surface_at,
    turn_prices,
)
from energyplan.planning.space.places import (
    RIM,
    STEPS,
    Places,
    halfway,
    headings_aside,
    middle_of,
    place_of,
    to_and_fro,
)
from energyplan.planning.space.queues import (
    STEP_COLUMNS,
    STEP_ROWS,
    angle_between,
    pop,
    push,
    slot_of,
    turning_by,
    with_room,
)

FACINGS = 16  # number of sectors of headings that the search distinguishes
EIGHTHS = 8  # headings of straight steps, along the axes of the places and halfway between
STRIDE = 4  # length of these steps [places]
_STEP_OF_EIGHTH = np.array([0, 4, 1, 5, 2, 7, 3, 6])  # the step along each of these headings


class PricedRoute(NamedTuple):
    """A route whose turns are priced."""

    chain: Ints  # its nodes, from the start to the goal
    cost: float  # price of its length and turns
    looked: int  # states that were expanded
    heading: float  # heading at its end [rad]


def penalised(
    penalties: Floats, places: Places, homes: NDArray[np.integer], within: float, factor: float
) -> Floats:
    """Return the factors on the prices of steps, raised within a distance of some places."""
    across = places.columns + 2 * RIM
    far = ceil(within / places.spacing)
    aside = np.arange(-far, far + 1)
    near = np.hypot(aside[:, None], aside) * places.spacing <= within
    about = (np.unique(homes)[:, None] + (aside[:, None] * across + aside)[near]).ravel()
    raised = np.broadcast_to(penalties, len(places.masks)).copy()
    about = about[(about >= 0) & (about < len(raised))]
    raised[about] = np.maximum(raised[about], factor)
    return raised


class Routes:
    """The cheapest ways, one after the other; each avoids the former and where one was stuck."""

    def __init__(
        self, setting: KernelProblem, to_go: CostToGo, stuck: Sequence[Tracked] = ()
    ) -> None:
        self._setting, self._to_go = setting, to_go
        self._blocked = [place_of(to_go.places, setting.space, one.x, one.y) for one in stuck]
        self._penalties = np.ones(1)
        self.found = 0
        """How many there are so far."""
        self.open = True
        """Whether there may be a further one."""
        self.looked = 0
        """States expanded by the last search."""

    def following(self, budget: Budget, most: int) -> Segments | None:
        """Return motions along the next way, if so many states show one that can be tracked."""
        setting, places, reach = self._setting, self._to_go.places, self._setting.reach
        if self._blocked:
            at = np.array(self._blocked)
            self._penalties = penalised(self._penalties, places, at, reach, ROUTES.blocked)
        found = cheapest_route(self._to_go, setting, self._penalties, most, False)
        self.looked = found.looked
        budget.spend(UNITS.state * found.looked)
        if len(found.chain) == 0:
            self.open = most <= found.looked < ROUTES.states
            return None
        tracked = track_route(setting, self._to_go, budget, found.chain)
        if tracked.motions is not None:
            self.found += 1
            self.open = self.found < ROUTES.most
            homes = places.home[found.chain]
            self._penalties = penalised(self._penalties, places, homes, reach, ROUTES.again)
        elif self.found:
            self.open = False
        else:
            self._blocked.append(place_of(places, setting.space, tracked.x, tracked.y))
        return tracked.motions


def cheapest_routes(
    setting: KernelProblem, to_go: CostToGo, budget: Budget, stuck: Sequence[Tracked] = ()
) -> list[Segments]:
    """Return motions along the cheapest ways; each avoids the former and where one was stuck."""
    ways: list[Segments] = []
    routes = Routes(setting, to_go, stuck)
    for _ in range(ROUTES.most):
        most = int(min(SHARES.stage * budget.left / UNITS.state, ROUTES.states))
        if most < 1 or not routes.open:
            break
        way = routes.following(budget, most)
        ways += [] if way is None else [way]
        if routes.looked == most or UNITS.state * routes.looked > SHARES.aside * budget.left:
            break
    return ways


def straight_way(
    setting: KernelProblem, to_go: CostToGo, turns: float, known: list[Ints], budget: Budget
) -> Segments | None:
    """Return motions along a new way of long straight steps, turns priced `turns` times."""
    found = straight_route(to_go, setting, turns, int(budget.left / UNITS.step))
    budget.spend(UNITS.step * found.looked)
    if len(found.chain) == 0 or any(np.array_equal(found.chain, one) for one in known):
        return None
    way = track_route(setting, to_go, budget, found.chain).motions
    if way is not None:
        known.append(found.chain)
    return way


@njit
def cheapest_route(
    to_go: CostToGo, setting: KernelProblem, penalties: Floats, most: int, any_heading: bool
) -> PricedRoute:
    """Return the nodes along the way that is cheapest by its length and its turns.

    Where the goal may be reached at any heading, the last turn costs nothing.
    """
    places = to_go.places
    space = setting.space
    spacing = places.spacing
    turn = 2.0 * pi / FACINGS
    per_metre = setting.least_metre
    weighed = ROUTES.weight * per_metre
    turning = turn_prices(setting)
    per_turn = here_turn = turning[0]
    for each in turning:
        per_turn = min(per_turn, each)
    here = setting.start
    even = setting.surface.size == 1
    forwards = price(setting.prices, 0, setting.half_track, 1.0, 0.0)
    backwards = price(setting.prices, 0, setting.half_track, -1.0, 0.0)
    aside = headings_aside()
    factors = to_and_fro()
    bits = _headings_of_facings()
    midway = halfway(places.columns + 2 * RIM)
    along = _steps_along()
    room = 4 * most + 2 * ROUTES.spare
    node_of = np.empty(room, np.int32)
    facing = np.empty(room, np.int8)
    parent = np.empty(room, np.int32)
    g = np.empty(room)
    h = np.empty(room)
    key = np.empty(room, np.int64)
    slots = 1 << 12
    while slots < 2 * room:
        slots *= 2
    table = np.full(slots, -1, np.int32)
    heap_f = np.empty(room)
    heap_state = np.empty(room, np.int32)
    none = np.empty(0, np.int64)
    start = node_at(to_go, space, setting.start)
    if start < 0 or to_go.distance[start] == inf:
        return PricedRoute(none, inf, 0, setting.goal.yaw)
    count = 0
    size = 0
    yaw = setting.start.yaw - space.yaw
    goal_yaw = setting.goal.yaw - space.yaw
    last_turn = 0.0 if any_heading else 1.0
    best = -1
    least = inf
    for b in range(FACINGS):
        if places.arcs[start] & bits[b] != 0:
            node_of[count] = start
            facing[count] = b
            parent[count] = -1
            off = max(angle_between(b * turn, yaw) - 0.5 * turn, 0.0)
            if not even:
                here_turn = turning[surface_at(setting, setting.start)]
            g[count] = here_turn * off
            h[count] = _rest(to_go, start, b * turn, goal_yaw, weighed, per_turn, any_heading)
            key[count] = _key(places, setting, start, b)
            table[slot_of(table, key, key[count])] = count
            size = push(heap_f, heap_state, size, g[count] + h[count], count)
            count += 1
    looked = 0
    while size > 0 and looked < most and count + ROUTES.spare < room:
        f = heap_f[0]
        state = int(heap_state[0])
        size = pop(heap_f, heap_state, size)
        if f >= least:
            break
        if f > g[state] + h[state] + 1e-9:
            continue
        looked += 1
        node = int(node_of[state])
        b = int(facing[state])
        place = int(places.home[node])
        arc = places.arcs[node]
        if not even:
            x, y = middle_of(places, space, place)
            here = Pose(x, y, space.yaw + b * turn)
            here_turn = turning[surface_at(setting, here)]
        if to_go.distance[node] <= ROUTES.near * spacing:
            through = (
                g[state] + per_metre * float(to_go.distance[node])
                + last_turn * here_turn * max(angle_between(b * turn, goal_yaw) - 0.5 * turn, 0.0)
            )  # fmt: skip
            if through < least:
                least = through
                best = state
        # a step is as long as there is room for
        stride = 1 << _level(places, setting, place)
        for n in range(2 + STEPS):
            there = place
            bb = b
            gg = g[state]
            common = arc
            if n < 2:
                bb = (b + 1) % FACINGS if n == 0 else (b + FACINGS - 1) % FACINGS
                gg += here_turn * turn
                common &= bits[bb]
                if common == 0:
                    continue
            else:
                k = n - 2
                if along[b, k] == 0 or along[b, k] * setting.gear < 0:
                    continue
                ahead = along[b, k] > 0
                there, common = _stepped(places, midway, place, arc, k, stride)
                if common & bits[b] == 0:
                    continue
                m = 0
                while common & bits[b] & aside[k, m] == 0:
                    m += 1
                length = stride * spacing * hypot(STEP_ROWS[k], STEP_COLUMNS[k]) * factors[m]
                if even:
                    paid = length * (forwards if ahead else backwards)
                else:
                    toward = atan2(STEP_ROWS[k], STEP_COLUMNS[k]) + space.yaw
                    here = Pose(here.x, here.y, toward if ahead else toward + pi)
                    paid = motion_cost(setting, here, length if ahead else -length, 0.0)
                if penalties.size > 1:
                    paid *= penalties[there]
                gg += paid
            if gg >= least:
                continue
            for other in range(places.first[there], places.first[there + 1]):
                if there == place and other != node:
                    continue
                if common & bits[bb] & places.arcs[other] == 0:
                    continue
                kk = _key(places, setting, other, bb)
                slot = slot_of(table, key, kk)
                known = int(table[slot])
                if known >= 0 and gg >= g[known] - 1e-9:
                    continue
                hh = _rest(to_go, other, bb * turn, goal_yaw, weighed, per_turn, any_heading)
                if gg + hh >= least:
                    continue
                if known >= 0:
                    g[known] = -inf
                node_of[count] = other
                facing[count] = bb
                parent[count] = state
                g[count] = gg
                h[count] = hh
                key[count] = kk
                table[slot] = count
                size = push(heap_f, heap_state, size, gg + hh, count)
                count += 1
    if best < 0:
        return PricedRoute(none, inf, looked, setting.goal.yaw)
    heading = space.yaw + facing[best] * turn
    return PricedRoute(_chain_of(to_go, node_of, parent, best), least, looked, heading)


@njit
def straight_route(to_go: CostToGo, setting: KernelProblem, turns: float, most: int) -> PricedRoute:
    """Return the nodes along the cheapest way of long straight steps, turns priced `turns` times.

    Steps lead along the axes of the places and halfway between them, and are four places long. So
    few states show which ways differ by their turns.
    """
    places = to_go.places
    space = setting.space
    weighed = ROUTES.weight * setting.least_metre
    across = places.columns + 2 * RIM
    rows = len(places.masks) // across
    wide = (across - 1) // STRIDE + 1
    per_metre = setting.least_metre
    turning = turns * turn_prices(setting)
    per_turn = turning[0]
    for each in turning:
        per_turn = min(per_turn, each)
    even = setting.surface.size == 1
    forwards = price(setting.prices, 0, setting.half_track, 1.0, 0.0)
    backwards = price(setting.prices, 0, setting.half_track, -1.0, 0.0)
    none = np.empty(0, np.int64)
    start = node_at(to_go, space, setting.start)
    if start < 0 or to_go.distance[start] == inf:
        return PricedRoute(none, inf, 0, setting.goal.yaw)
    home = int(places.home[start])
    first_row = home // across % STRIDE
    first_column = home % across % STRIDE
    states = ((rows - 1) // STRIDE + 1) * wide * EIGHTHS
    g = np.full(states, inf)
    parent = np.full(states, -1, np.int32)
    heap_f = np.empty(1 << 10)
    heap_state = np.empty(1 << 10, np.int32)
    size = 0
    eighth = 2.0 * pi / EIGHTHS
    # places lie in the frame of the grid
    yaw = setting.start.yaw - space.yaw
    goal_yaw = setting.goal.yaw - space.yaw
    passed = _turns_of_eighths()
    here_turn = per_turn if even else turning[surface_at(setting, setting.start)]
    for b in range(EIGHTHS):
        bit = np.uint64(1) << np.uint64(b * (HEADINGS // EIGHTHS))
        if places.arcs[start] & bit != 0:
            state = ((home // across) // STRIDE * wide + (home % across) // STRIDE) * EIGHTHS + b
            g[state] = here_turn * angle_between(b * eighth, yaw)
            size = push(heap_f, heap_state, size, g[state], state)
    looked = 0
    best = -1
    least = inf
    while size > 0 and looked < most:
        f = heap_f[0]
        state = int(heap_state[0])
        size = pop(heap_f, heap_state, size)
        if f >= least:
            break
        b = state % EIGHTHS
        row = state // EIGHTHS // wide * STRIDE + first_row
        column = state // EIGHTHS % wide * STRIDE + first_column
        place = row * across + column
        node = _node_with(places, place, b)
        to_goal = angle_between(b * eighth, goal_yaw)
        far = float(to_go.distance[node])
        rest = weighed * far + per_turn * to_goal
        if parent[state] >= 0 and f > g[state] + rest + 1e-9:
            continue
        looked += 1
        if not even:
            x, y = middle_of(places, space, place)
            here = Pose(x, y, space.yaw + b * eighth)
            here_turn = turning[surface_at(setting, here)]
        if far <= ROUTES.near * places.spacing:
            through = g[state] + per_metre * far + here_turn * to_goal
            if through < least:
                least = through
                best = state
        for n in range(4):
            there = place
            bb = b
            gg = g[state]
            if n < 2:
                bb = (b + 1) % EIGHTHS if n == 0 else (b + EIGHTHS - 1) % EIGHTHS
                needed = passed[b if n == 0 else bb]
                if places.arcs[node] & needed != needed:
                    continue
                gg += here_turn * eighth
            else:
                ahead = n == 2
                k = int(_STEP_OF_EIGHTH[b if ahead else (b + EIGHTHS // 2) % EIGHTHS])
                if (1 if ahead else -1) * setting.gear < 0:
                    continue
                new_row = row + STRIDE * STEP_ROWS[k]
                new_column = column + STRIDE * STEP_COLUMNS[k]
                if not (0 <= new_row < rows and 0 <= new_column < across):
                    continue
                bit = np.uint64(1) << np.uint64(b * (HEADINGS // EIGHTHS))
                step = int(STEP_ROWS[k]) * across + int(STEP_COLUMNS[k])
                free = True
                for _ in range(STRIDE):
                    there += step
                    free = free and places.masks[there] & bit != 0
                if not free:
                    continue
                length = STRIDE * places.spacing * hypot(STEP_ROWS[k], STEP_COLUMNS[k])
                if even:
                    gg += length * (forwards if ahead else backwards)
                else:
                    gg += motion_cost(setting, here, length if ahead else -length, 0.0)
            other = (there // across // STRIDE * wide + there % across // STRIDE) * EIGHTHS + bb
            if gg >= g[other] - 1e-9:
                continue
            beyond = _node_with(places, there, bb)
            ff = gg + weighed * float(to_go.distance[beyond])
            ff += per_turn * angle_between(bb * eighth, goal_yaw)
            if ff >= least:
                continue
            g[other] = gg
            parent[other] = state
            heap_f, heap_state = with_room(heap_f, heap_state, size)
            size = push(heap_f, heap_state, size, ff, other)
    if best < 0:
        return PricedRoute(none, inf, looked, setting.goal.yaw)
    chain = _straight_chain(places, parent, best, first_row, first_column)
    rest = chain_from(to_go, int(to_go.after[chain[-1]]))
    heading = space.yaw + (best % EIGHTHS) * eighth
    return PricedRoute(np.concatenate((chain, rest)), least, looked, heading)


@inner
def _straight_chain(
    places: Places, parent: ShortInts, best: int, first_row: int, first_column: int
) -> Ints:
    """Return the nodes on the way of straight steps that leads to a state."""
    across = places.columns + 2 * RIM
    wide = (across - 1) // STRIDE + 1
    steps = 0
    state = int(parent[best])
    while state >= 0:
        steps += 1
        state = int(parent[state])
    chain = np.empty(STRIDE * steps + 1, np.int64)
    state = best
    row = state // EIGHTHS // wide * STRIDE + first_row
    column = state // EIGHTHS % wide * STRIDE + first_column
    at = len(chain) - 1
    chain[at] = _node_with(places, row * across + column, state % EIGHTHS)
    while at > 0:
        state = int(parent[state])
        up = (state // EIGHTHS // wide * STRIDE + first_row - row) // STRIDE
        along = (state // EIGHTHS % wide * STRIDE + first_column - column) // STRIDE
        for _ in range(STRIDE):
            row += up
            column += along
            at -= 1
            chain[at] = _node_with(places, row * across + column, state % EIGHTHS)
    return chain


@inner
def _node_with(places: Places, place: int, eighth: int) -> int:
    """Return the node of a place that has an eighth's heading."""
    bit = np.uint64(1) << np.uint64(eighth * (HEADINGS // EIGHTHS))
    for node in range(places.first[place], places.first[place + 1]):
        if places.arcs[node] & bit != 0:
            return node
    return -1


@inner
def _turns_of_eighths() -> Words:
    """Return the headings that a turn from each eighth to the next one passes."""
    bits = np.zeros(EIGHTHS, np.uint64)
    for b in range(EIGHTHS):
        for k in range(HEADINGS // EIGHTHS + 1):
            bits[b] |= np.uint64(1) << np.uint64((b * (HEADINGS // EIGHTHS) + k) % HEADINGS)
    return bits


@inner
def _stepped(
    places: Places, midway: IntTable, place: int, arc: np.uint64, k: int, stride: int
) -> tuple[int, np.uint64]:
    """Return where a step of so many places leads, and the headings that are free all along it."""
    across = places.columns + 2 * RIM
    step = int(STEP_ROWS[k]) * across + int(STEP_COLUMNS[k])
    there = place
    if stride == 4:
        # nothing is in the way within the room there is
        row = place // across + stride * int(STEP_ROWS[k])
        column = place % across + stride * int(STEP_COLUMNS[k])
        if row < 0 or row >= len(places.masks) // across or column < 0 or column >= across:
            return place, np.uint64(0)
        there += stride * step
        return there, arc & places.masks[there]
    for _ in range(stride):
        if arc == 0:
            break
        if k >= 8:
            arc &= places.masks[there + midway[k, 0]] | places.masks[there + midway[k, 1]]
        there += step
        arc &= places.masks[there]
    return there, arc


@inner
def _headings_of_facings() -> Words:
    """Return the headings of each facing, one bit a heading."""
    sector = HEADINGS // FACINGS
    bits = np.zeros(FACINGS, np.uint64)
    for b in range(FACINGS):
        for heading in range(b * sector - sector // 2, b * sector + sector // 2 + 1):
            bits[b] |= np.uint64(1) << np.uint64(heading % HEADINGS)
    return bits


@inner
def _steps_along() -> IntTable:
    """Return which steps lead along a facing: 1 ahead, -1 backwards, 0 more than a sector aside."""
    turn = 2.0 * pi / FACINGS
    along = np.zeros((FACINGS, STEPS), np.int64)
    for b in range(FACINGS):
        for k in range(STEPS):
            off = angle_between(atan2(STEP_ROWS[k], STEP_COLUMNS[k]), b * turn)
            if min(off, pi - off) <= ROUTES.aside * turn:
                along[b, k] = 1 if off < 0.5 * pi else -1
    return along


@inner
def _chain_of(to_go: CostToGo, node_of: ShortInts, parent: ShortInts, best: int) -> Ints:
    """Return the nodes on the way to a state, and those from there to the goal."""
    total = 0
    state = best
    while state >= 0:
        total += 1
        state = int(parent[state])
    rest = chain_from(to_go, int(to_go.after[node_of[best]]))
    chain = np.empty(total + len(rest), np.int64)
    first = total
    state = best
    while state >= 0:
        if first == total or chain[first] != node_of[state]:
            first -= 1
            chain[first] = node_of[state]
        state = int(parent[state])
    for k in range(len(rest)):  # Numba takes seconds to compile an assignment to a slice
        chain[total + k] = rest[k]
    return chain[first:].copy()


@inner
def _level(places: Places, setting: KernelProblem, place: int) -> int:
    """Return how coarse the search is at a place: steps are of one place, two, or four."""
    spare = float(places.room[place]) - setting.reach
    return 2 if spare >= ROUTES.wide * places.spacing else 1 if spare >= 0.0 else 0


@inner
def _key(places: Places, setting: KernelProblem, node: int, facing: int) -> int:
    """Return the cell of a state, larger where there is room, and its facing, as one number."""
    across = places.columns + 2 * RIM
    place = int(places.home[node])
    row = place // across
    column = place % across
    level = _level(places, setting, place)
    arc = node if level == 0 else (row >> level) * (across >> level) + (column >> level)
    return (arc * 4 + level) * FACINGS + facing


@inner
def _rest(
    to_go: CostToGo, node: int, yaw: float, goal_yaw: float, per_metre: float, per_turn: float,
    any_heading: bool,
) -> float:  # fmt: skip
    """Estimate the price of the rest of the way."""
    far = float(to_go.distance[node])
    if far == inf:
        return inf
    way = float(to_go.direction[node])
    turn = 0.0 if any_heading else angle_between(yaw, goal_yaw)
    if far > to_go.far:
        if any_heading:
            turn = min(angle_between(yaw, way), angle_between(yaw, way + pi))
        else:
            turn = max(turn, turning_by(yaw, way, goal_yaw))
    return per_metre * far + per_turn * max(turn - pi / FACINGS, 0.0)
