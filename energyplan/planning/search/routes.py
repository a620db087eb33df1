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

from energyplan.compilation import (
    Floats,
    Ints,
    IntTable,
    ShortInts,
    States,
    Words,
    WordTable,
    inner,
    lean,
    njit,
)
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
    Open,
    angle_between,
    chain_to,
    longer,
    no_open,
    pop,
    push,
    slot_of,
    turning_by,
)
from energyplan.terrain.collision import Space

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


class RoutePrices(NamedTuple):
    """Prices of the steps and turns of a route."""

    turning: Floats  # (classes,): price of a radian on each class of surface
    per_turn: float  # the least of these
    ahead: float  # price of a metre ahead on even ground
    back: float  # price of a metre backwards there
    rest: float  # estimated price of a metre of the rest of the way
    even: bool  # whether all ground is alike


@inner
def _route_prices(setting: KernelProblem, turns: float) -> RoutePrices:
    """Return the prices of a problem, those of turns times `turns`."""
    turning = turn_prices(setting)
    per_turn = inf
    for k in range(len(turning)):
        turning[k] *= turns
        per_turn = min(per_turn, turning[k])
    ahead = price(setting.prices, 0, setting.half_track, 1.0, 0.0)
    back = price(setting.prices, 0, setting.half_track, -1.0, 0.0)
    rest = ROUTES.weight * setting.least_metre
    return RoutePrices(turning, per_turn, ahead, back, rest, setting.surface.size == 1)


@lean
def _turn_price_at(setting: KernelProblem, prices: RoutePrices, pose: Pose) -> float:
    """Return the price of a radian at a pose."""
    return float(prices.turning[0 if prices.even else surface_at(setting, pose)])


class RouteStates(NamedTuple):
    """States of a search of routes: each a node and a facing, and how it was reached."""

    node: ShortInts
    facing: States
    parent: ShortInts  # state it was reached from, -1 at the start
    g: Floats  # price of the way to it; -inf once a cheaper way is known
    h: Floats  # estimated price of the rest
    key: Ints  # its cell and its facing as one number
    table: ShortInts  # hash table from key to state, -1 where empty
    used: Ints  # (1,): number of states
    queue: Open  # those to go on from


class Successor(NamedTuple):
    """Where a step or a turn leads."""

    by: int  # how many places further its end is
    turn: int  # by how many facings
    free: np.uint64  # headings that are free all along it; none if it cannot be driven
    paid: float  # its price


class StepTables(NamedTuple):
    """Tables of the steps and turns between states, the same for a whole search."""

    facings: Words  # (FACINGS,): headings of each facing
    along: IntTable  # (FACINGS, STEPS): steps along each facing, see `_steps_along`
    aside: WordTable  # (STEPS, n): see `headings_aside`
    factors: Floats  # see `to_and_fro`
    midway: IntTable  # see `halfway`


class RouteGoal(NamedTuple):
    """Which heading a route ends at."""

    yaw: float  # in the frame of the grid [rad]
    any_heading: bool  # whether any will do


@inner
def _route_states(room: int) -> RouteStates:
    """Return no states, with room for so many."""
    slots = 1 << 12
    while slots < 2 * room:
        slots *= 2
    return RouteStates(
        np.empty(room, np.int32), np.empty(room, np.int8), np.empty(room, np.int32),
        np.empty(room), np.empty(room), np.empty(room, np.int64), np.full(slots, -1, np.int32),
        np.zeros(1, np.int64), no_open(room),
    )  # fmt: skip


@lean
def _enter(
    states: RouteStates, slot: int, key: int, node: int, facing: int, parent: int, g: float,
    h: float,
) -> None:  # fmt: skip
    """Add a state, in place of one of the same key in the hash table."""
    new = int(states.used[0])
    states.used[0] += 1
    states.node[new] = node
    states.facing[new] = facing
    states.parent[new] = parent
    states.g[new] = g
    states.h[new] = h
    states.key[new] = key
    states.table[slot] = new
    push(states.queue, g + h, new)


@njit
def cheapest_route(
    to_go: CostToGo, setting: KernelProblem, penalties: Floats, most: int, any_heading: bool
) -> PricedRoute:
    """Return the nodes along the way that is cheapest by its length and its turns.

    Where the goal may be reached at any heading, the last turn costs nothing.
    """
    places, space = to_go.places, setting.space
    turn = 2.0 * pi / FACINGS
    goal = RouteGoal(setting.goal.yaw - space.yaw, any_heading)
    start = node_at(to_go, space, setting.start)
    if start < 0 or to_go.distance[start] == inf:
        return PricedRoute(np.empty(0, np.int64), inf, 0, setting.goal.yaw)
    prices = _route_prices(setting, 1.0)
    tables = StepTables(
        _headings_of_facings(), _steps_along(), headings_aside(), to_and_fro(),
        halfway(places.columns + 2 * RIM),
    )  # fmt: skip
    states = _route_states(4 * most + 2 * ROUTES.spare)
    queue = states.queue
    here_turn = _turn_price_at(setting, prices, setting.start)
    for b in range(FACINGS):
        if places.arcs[start] & tables.facings[b] != 0:
            off = max(angle_between(b * turn, setting.start.yaw - space.yaw) - 0.5 * turn, 0.0)
            h = _rest(to_go, prices, goal, start, b * turn)
            key = _key(places, setting, start, b)
            slot = slot_of(states.table, states.key, key)
            _enter(states, slot, key, start, b, -1, here_turn * off, h)
    looked = 0
    best = -1
    least = inf
    while queue.size[0] > 0 and looked < most and states.used[0] + ROUTES.spare < len(states.g):
        f = queue.f[0]
        state = pop(queue)
        if f >= least:
            break
        if f > states.g[state] + states.h[state] + 1e-9:
            continue
        looked += 1
        here = _pose_of(places, space, int(states.node[state]), states.facing[state] * turn)
        here_turn = _turn_price_at(setting, prices, here)
        far = float(to_go.distance[states.node[state]])
        if far <= ROUTES.near * places.spacing:
            off = angle_between(states.facing[state] * turn, goal.yaw) - 0.5 * turn
            last = 0.0 if any_heading else 1.0
            through = states.g[state] + setting.least_metre * far + last * here_turn * max(off, 0.0)
            if through < least:
                least = through
                best = state
        _expand(
            to_go, setting, penalties, prices, tables, states, goal, state, here, here_turn, least
        )
    if best < 0:
        return PricedRoute(np.empty(0, np.int64), inf, looked, setting.goal.yaw)
    heading = space.yaw + states.facing[best] * turn
    return PricedRoute(_chain_of(to_go, states, best), least, looked, heading)


@lean
def _expand(
    to_go: CostToGo, setting: KernelProblem, penalties: Floats, prices: RoutePrices,
    tables: StepTables, states: RouteStates, goal: RouteGoal, state: int, here: Pose,
    here_turn: float, least: float,
) -> None:  # fmt: skip
    """Enter the states that the turns and the steps from a state lead to."""
    places = to_go.places
    turn = 2.0 * pi / FACINGS
    node = int(states.node[state])
    b = int(states.facing[state])
    place = int(places.home[node])
    # a step is as long as there is room for
    stride = 1 << _level(places, setting, place)
    for n in range(2 + STEPS):
        if n < 2:
            side = 1 - 2 * n
            free = places.arcs[node] & tables.facings[(b + side) % FACINGS]
            to = Successor(0, side, free, here_turn * turn)
        else:
            to = _step_from(setting, places, prices, tables, here, node, b, n - 2, stride)
        if to.free == 0:
            continue
        there = place + to.by
        facing = (b + to.turn) % FACINGS
        factor = penalties[there] if penalties.size > 1 and n >= 2 else 1.0
        g = states.g[state] + to.paid * factor
        if g >= least:
            continue
        for other in range(places.first[there], places.first[there + 1]):
            if n < 2 and other != node:
                continue
            if to.free & tables.facings[facing] & places.arcs[other] == 0:
                continue
            key = _key(places, setting, other, facing)
            slot = slot_of(states.table, states.key, key)
            known = int(states.table[slot])
            if known >= 0 and g >= states.g[known] - 1e-9:
                continue
            h = _rest(to_go, prices, goal, other, facing * turn)
            if g + h >= least:
                continue
            if known >= 0:
                states.g[known] = -inf
            _enter(states, slot, key, other, facing, state, g, h)


@lean
def _step_from(
    setting: KernelProblem, places: Places, prices: RoutePrices, tables: StepTables, here: Pose,
    node: int, facing: int, k: int, stride: int,
) -> Successor:  # fmt: skip
    """Return where a step of so many places leads from a node at a pose, driven along a facing."""
    way = tables.along[facing, k]
    none = Successor(0, 0, np.uint64(0), 0.0)
    if way == 0 or way * setting.gear < 0:
        return none
    place = int(places.home[node])
    by, free = _stepped(places, tables.midway, place, places.arcs[node], k, stride)
    free_along = free & tables.facings[facing]
    if free_along == 0:
        return none
    m = 0
    while free_along & tables.aside[k, m] == 0:
        m += 1
    length = stride * places.spacing * hypot(STEP_ROWS[k], STEP_COLUMNS[k]) * tables.factors[m]
    toward = atan2(STEP_ROWS[k], STEP_COLUMNS[k]) + setting.space.yaw
    ahead = Pose(here.x, here.y, toward if way > 0 else toward + pi)
    return Successor(by, 0, free, _metres_price(setting, prices, ahead, way * length))


@lean
def _pose_of(places: Places, space: Space, node: int, yaw: float) -> Pose:
    """Return the pose in the middle of a node's place with a heading in the frame of the grid."""
    x, y = middle_of(places, space, int(places.home[node]))
    return Pose(x, y, space.yaw + yaw)


@lean
def _metres_price(setting: KernelProblem, prices: RoutePrices, here: Pose, length: float) -> float:
    """Return the price of a straight step, driven backwards if its length is negative."""
    if not prices.even:
        return motion_cost(setting, here, length, 0.0)
    return length * prices.ahead if length >= 0.0 else -length * prices.back


class CoarseGrid(NamedTuple):
    """Every fourth place about the start, at each of which there are `EIGHTHS` states."""

    across: int  # places in a row, those of the rim with them
    rows: int  # rows of places
    wide: int  # of the coarse grid, in a row
    first_row: int  # row of places of its first row
    first_column: int  # column of places of its first column


@lean
def _coarse_grid(places: Places, home: int) -> CoarseGrid:
    """Return every fourth place about one of them."""
    across = places.columns + 2 * RIM
    return CoarseGrid(
        across, len(places.masks) // across, (across - 1) // STRIDE + 1, home // across % STRIDE,
        home % across % STRIDE,
    )  # fmt: skip


@lean
def _state_at(grid: CoarseGrid, place: int, eighth: int) -> int:
    """Return the state of a place and a heading."""
    row = place // grid.across // STRIDE
    column = place % grid.across // STRIDE
    return (row * grid.wide + column) * EIGHTHS + eighth


@lean
def _place_at(grid: CoarseGrid, state: int) -> int:
    """Return the place of a state."""
    row = state // EIGHTHS // grid.wide * STRIDE + grid.first_row
    column = state // EIGHTHS % grid.wide * STRIDE + grid.first_column
    return row * grid.across + column


@njit
def straight_route(to_go: CostToGo, setting: KernelProblem, turns: float, most: int) -> PricedRoute:
    """Return the nodes along the cheapest way of long straight steps, turns priced `turns` times.

    Steps lead along the axes of the places and halfway between them, and are four places long. So
    few states show which ways differ by their turns.
    """
    places, space = to_go.places, setting.space
    start = node_at(to_go, space, setting.start)
    if start < 0 or to_go.distance[start] == inf:
        return PricedRoute(np.empty(0, np.int64), inf, 0, setting.goal.yaw)
    prices = _route_prices(setting, turns)
    grid = _coarse_grid(places, int(places.home[start]))
    g = np.full(((grid.rows - 1) // STRIDE + 1) * grid.wide * EIGHTHS, inf)
    parent = np.full(len(g), -1, np.int32)
    queue = no_open(1 << 10)
    passed = _turns_of_eighths()
    eighth = 2.0 * pi / EIGHTHS
    goal_yaw = setting.goal.yaw - space.yaw
    here_turn = _turn_price_at(setting, prices, setting.start)
    for b in range(EIGHTHS):
        if places.arcs[start] & _bit_of(b) != 0:
            state = _state_at(grid, int(places.home[start]), b)
            g[state] = here_turn * angle_between(b * eighth, setting.start.yaw - space.yaw)
            push(queue, g[state], state)
    looked, best, least = 0, -1, inf
    while queue.size[0] > 0 and looked < most:
        f = queue.f[0]
        state = pop(queue)
        if f >= least:
            break
        b = state % EIGHTHS
        node = _node_with(places, _place_at(grid, state), b)
        far = float(to_go.distance[node])
        to_goal = angle_between(b * eighth, goal_yaw)
        rest = prices.rest * far + prices.per_turn * to_goal
        if parent[state] >= 0 and f > g[state] + rest + 1e-9:
            continue
        looked += 1
        here = _pose_of(places, space, node, b * eighth)
        here_turn = _turn_price_at(setting, prices, here)
        if far <= ROUTES.near * places.spacing:
            through = g[state] + setting.least_metre * far + here_turn * to_goal
            if through < least:
                least = through
                best = state
        if queue.size[0] + 4 > len(queue.f):
            queue = longer(queue)
        for n in range(4):
            if n < 2:
                to = _eighth_turned(passed, places.arcs[node], b, 1 - 2 * n, here_turn * eighth)
            else:
                way = 1 if n == 2 else -1
                to = _straight_step(setting, places, prices, grid, here, node, b, way)
            if to.free == 0:
                continue
            there = int(places.home[node]) + to.by
            facing = (b + to.turn) % EIGHTHS
            other = _state_at(grid, there, facing)
            gg = g[state] + to.paid
            if gg >= g[other] - 1e-9:
                continue
            beyond = _node_with(places, there, facing)
            ff = gg + prices.rest * float(to_go.distance[beyond])
            ff += prices.per_turn * angle_between(facing * eighth, goal_yaw)
            if ff >= least:
                continue
            g[other] = gg
            parent[other] = state
            push(queue, ff, other)
    if best < 0:
        return PricedRoute(np.empty(0, np.int64), inf, looked, setting.goal.yaw)
    chain = _straight_chain(places, grid, chain_to(parent, best))
    chain = np.concatenate((chain, chain_from(to_go, int(to_go.after[chain[-1]]))))
    return PricedRoute(chain, least, looked, space.yaw + (best % EIGHTHS) * eighth)


@lean
def _eighth_turned(
    passed: Words, free: np.uint64, eighth: int, side: int, paid: float
) -> Successor:
    """Return where a turn to the next heading leads, if all headings between are free."""
    needed = passed[eighth if side > 0 else (eighth + EIGHTHS - 1) % EIGHTHS]
    return Successor(0, side, needed if free & needed == needed else np.uint64(0), paid)


@inner
def _turns_of_eighths() -> Words:
    """Return the headings that a turn from each eighth to the next one passes."""
    bits = np.zeros(EIGHTHS, np.uint64)
    for b in range(EIGHTHS):
        for k in range(HEADINGS // EIGHTHS + 1):
            bits[b] |= np.uint64(1) << np.uint64((b * (HEADINGS // EIGHTHS) + k) % HEADINGS)
    return bits


@lean
def _straight_step(
    setting: KernelProblem, places: Places, prices: RoutePrices, grid: CoarseGrid, here: Pose,
    node: int, eighth: int, way: int,
) -> Successor:  # fmt: skip
    """Return where four places straight ahead, or backwards, lead from a node."""
    none = Successor(0, 0, np.uint64(0), 0.0)
    if way * setting.gear < 0:
        return none
    k = int(_STEP_OF_EIGHTH[eighth if way > 0 else (eighth + EIGHTHS // 2) % EIGHTHS])
    place = int(places.home[node])
    row = place // grid.across + STRIDE * STEP_ROWS[k]
    column = place % grid.across + STRIDE * STEP_COLUMNS[k]
    if not (0 <= row < grid.rows and 0 <= column < grid.across):
        return none
    step = int(STEP_ROWS[k]) * grid.across + int(STEP_COLUMNS[k])
    free = _bit_of(eighth)
    for far in range(1, STRIDE + 1):
        free &= places.masks[place + far * step]
    if free == 0:
        return none
    length = STRIDE * places.spacing * hypot(STEP_ROWS[k], STEP_COLUMNS[k])
    return Successor(STRIDE * step, 0, free, _metres_price(setting, prices, here, way * length))


@inner
def _straight_chain(places: Places, grid: CoarseGrid, states: Ints) -> Ints:
    """Return the nodes along states: those of the places between on straight steps, too."""
    last = len(states) - 1
    chain = np.empty(STRIDE * last + 1, np.int64)
    place = _place_at(grid, int(states[last]))
    at = len(chain) - 1
    chain[at] = _node_with(places, place, int(states[last]) % EIGHTHS)
    for k in range(last - 1, -1, -1):
        state = int(states[k])
        step = (_place_at(grid, state) - place) // STRIDE
        for _ in range(STRIDE):
            place += step
            at -= 1
            chain[at] = _node_with(places, place, state % EIGHTHS)
    return chain


@lean
def _bit_of(eighth: int) -> np.uint64:
    """Return the bit of an eighth's heading."""
    return np.uint64(1) << np.uint64(eighth * (HEADINGS // EIGHTHS))


@lean
def _node_with(places: Places, place: int, eighth: int) -> int:
    """Return the node of a place that has an eighth's heading."""
    bit = np.uint64(1) << np.uint64(eighth * (HEADINGS // EIGHTHS))
    for node in range(places.first[place], places.first[place + 1]):
        if places.arcs[node] & bit != 0:
            return node
    return -1


@lean
def _stepped(
    places: Places, midway: IntTable, place: int, arc: np.uint64, k: int, stride: int
) -> tuple[int, np.uint64]:
    """Return how far a step of so many places leads, and the headings that are free all along."""
    across = places.columns + 2 * RIM
    step = int(STEP_ROWS[k]) * across + int(STEP_COLUMNS[k])
    if stride == 4:
        # nothing is in the way within the room there is
        row = place // across + stride * int(STEP_ROWS[k])
        column = place % across + stride * int(STEP_COLUMNS[k])
        if row < 0 or row >= len(places.masks) // across or column < 0 or column >= across:
            return 0, np.uint64(0)
        return stride * step, arc & places.masks[place + stride * step]
    by = 0
    for _ in range(stride):
        if arc == 0:
            break
        if k >= 8:
            arc &= places.masks[place + by + midway[k, 0]] | places.masks[place + by + midway[k, 1]]
        by += step
        arc &= places.masks[place + by]
    return by, arc


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
def _chain_of(to_go: CostToGo, states: RouteStates, best: int) -> Ints:
    """Return the nodes on the way to a state, each once, and those from there to the goal."""
    way = chain_to(states.parent, best)
    rest = chain_from(to_go, int(to_go.after[states.node[best]]))
    chain = np.empty(len(way) + len(rest), np.int64)
    used = 0
    for state in way:
        if used == 0 or chain[used - 1] != states.node[state]:
            chain[used] = states.node[state]
            used += 1
    for k in range(len(rest)):  # Numba takes seconds to compile an assignment to a slice
        chain[used + k] = rest[k]
    return chain[: used + len(rest)].copy()


@lean
def _level(places: Places, setting: KernelProblem, place: int) -> int:
    """Return how coarse the search is at a place: steps are of one place, two, or four."""
    spare = float(places.room[place]) - setting.reach
    return 2 if spare >= ROUTES.wide * places.spacing else 1 if spare >= 0.0 else 0


@lean
def _key(places: Places, setting: KernelProblem, node: int, facing: int) -> int:
    """Return the cell of a state, larger where there is room, and its facing, as one number."""
    across = places.columns + 2 * RIM
    place = int(places.home[node])
    row = place // across
    column = place % across
    level = _level(places, setting, place)
    arc = node if level == 0 else (row >> level) * (across >> level) + (column >> level)
    return (arc * 4 + level) * FACINGS + facing


@lean
def _rest(to_go: CostToGo, prices: RoutePrices, goal: RouteGoal, node: int, yaw: float) -> float:
    """Estimate the price of the rest of the way."""
    far = float(to_go.distance[node])
    if far == inf:
        return inf
    way = float(to_go.direction[node])
    turn = 0.0 if goal.any_heading else angle_between(yaw, goal.yaw)
    if far > to_go.far:
        if goal.any_heading:
            turn = min(angle_between(yaw, way), angle_between(yaw, way + pi))
        else:
            turn = max(turn, turning_by(yaw, way, goal.yaw))
    return prices.rest * far + prices.per_turn * max(turn - pi / FACINGS, 0.0)
