"""The way to the goal through the free configurations, which guides searches."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np
from numpy.typing import NDArray

from energyplan.path import Pose
from energyplan.planning.scene.compiled import MARGIN
from energyplan.planning.scene.free_space import FreeSpace, free_space, updated_free_space
from energyplan.planning.scene.guide_kernels import (
    RIM,
    DistanceToGo,
    Places,
    connect_places,
    heights_of_places,
    node_at,
    place_of,
    way_to_go,
)
from energyplan.planning.scene.motions import DIRECTIONS, KernelProblem
from energyplan.planning.scene.region_kernels import (
    Regions,
    fill_beside,
    join_regions,
    ways_between,
)
from energyplan.terrain.collision import Body
from energyplan.terrain.updates import Window, tables_of

AHEAD = 1.5
"""How far ahead the guide looks for the direction of the way [m]."""

REACH = 1.05
"""How much further than the start the guide reaches."""

TURNS = 120
"""Turns of nodes, where distances to go are found, that count as a unit of work."""

AGAIN = 1.5
"""How often a node has its turn, about."""

SINGLE = 1e-5
"""Rounding of lengths that are added in single precision along a way, as a part of it."""

SLACK = 1.0
"""And how much beyond that, in lengths of the body."""


CLOSED = 1
"""How far about a place where the body does not pass others count as closed [places]."""


def places_for(kernel: KernelProblem, enlarged: bool = False) -> Places:
    """Return the free configurations of a problem as nodes, made once for a map and a body."""
    space, body = kernel.space, kernel.body
    fitting = body
    if enlarged:
        # the true footprint, which the margin of planning made larger
        grown = MARGIN * space.resolution
        fitting = Body(
            body.x_min + grown, body.y_min + grown, body.x_max - grown, body.y_max - grown
        )

    def make() -> Places:
        found = free_space(space, fitting, enlarged=enlarged, placed_as=body)
        return connect_places(found.masks, space, found.spacing)

    def update(former: Places, window: Window) -> Places:
        shape = len(former.masks) // (former.columns + 2 * RIM), former.columns + 2 * RIM
        masks = former.masks.reshape(shape)[RIM:-RIM, RIM:-RIM]
        known = FreeSpace(masks, former.spacing, enlarged)
        found = updated_free_space(known, space, fitting, window, placed_as=body)
        return connect_places(found.masks, space, found.spacing)

    return tables_of(space).get(("places", body, enlarged), make, update)


def regions_for(kernel: KernelProblem, enlarged: bool = False) -> Regions:
    """Return the regions of these nodes; see `places_for`."""
    places = places_for(kernel, enlarged)
    key = ("regions", kernel.body, enlarged)
    return tables_of(kernel.space).get(key, lambda: join_regions(places))


def inscribed(kernel: KernelProblem) -> float:
    """Radius of the largest disc about the centre of the tread ICRs inside the body [m]."""
    body = kernel.body
    return max(min(-body.x_min, body.x_max, -body.y_min, body.y_max), 0.0)


def distance_to_go(kernel: KernelProblem, most: float = np.inf) -> DistanceToGo:
    """Return the distance to go to the goal, as far as it is needed."""
    found = _guide(kernel, enlarged=False, most=most)
    if reached(found, kernel):
        return found
    return _guide(kernel, enlarged=True, most=most)


def no_distance() -> DistanceToGo:
    """Return an empty table, for a search without a goal."""
    places = Places(
        np.zeros(1, np.uint64),
        np.zeros(2, np.int32),
        np.zeros(0, np.uint64),
        np.zeros(0, np.int32),
        np.zeros(1, np.float32),
        1,
        1.0,
    )
    none = np.zeros(0, np.float32)
    return DistanceToGo(places, none, none, np.zeros(0, np.int32), 0.0, 0)


def reached(to_go: DistanceToGo, kernel: KernelProblem) -> bool:
    """Tell whether the start leads to the goal."""
    return bool(np.isfinite(distance_at_start(to_go, kernel)))


def distance_at_start(to_go: DistanceToGo, kernel: KernelProblem) -> float:
    """Return the distance to go at the start [m]; infinite where it does not lead to the goal."""
    node = node_at(to_go, kernel.space, kernel.start_x, kernel.start_y, kernel.start_yaw)
    return float(to_go.distance[node]) if node >= 0 else np.inf


def distance_through_slots(
    kernel: KernelProblem, known: float, closed: Sequence[Pose] = ()
) -> DistanceToGo:
    """Return the distance to go where the body may be free, between the poses tested as well."""
    places = places_for(kernel, enlarged=True)
    if closed:
        places = _without(places, places_for(kernel), kernel, closed)
    if not closed and not np.isfinite(known):
        known = 0.0
    return _guide(kernel, enlarged=True, places=places, known=known)


def _without(
    places: Places, tested: Places, kernel: KernelProblem, closed: Sequence[Pose]
) -> Places:
    """Return places that are free about some poses only where poses were tested."""
    across = places.columns + 2 * RIM
    masks, arcs = places.masks.copy(), places.arcs.copy()
    for pose in closed:
        middle = place_of(places, kernel.space, pose.x, pose.y)
        for row in range(-CLOSED, CLOSED + 1):
            for place in range(middle + row * across - CLOSED, middle + row * across + CLOSED + 1):
                if 0 <= place < len(masks):
                    masks[place] &= tested.masks[place]
                    arcs[places.first[place] : places.first[place + 1]] &= tested.masks[place]
    return places._replace(masks=masks, arcs=arcs)


def _guide(
    kernel: KernelProblem,
    enlarged: bool,
    places: Places | None = None,
    known: float = 0.0,
    most: float = np.inf,
) -> DistanceToGo:
    """Return the distance to go near the shortest way, and on all that are not longer than known.

    The places are those of the problem unless given. What takes more than `most` units of work is
    left out, but for the shortest way.
    """
    places = places_for(kernel, enlarged) if places is None else places
    hills, space = kernel.hills, kernel.space
    # where it turns for nothing within this distance, reversing can be cheaper
    far = 2.0 * kernel.least_radian / kernel.least_metre
    distance, direction = np.zeros((2, len(places.arcs)), np.float32)
    after = np.full(len(places.arcs), -1, np.int32)
    to_go = DistanceToGo(places, distance, direction, after, far, 0)
    goal = node_at(to_go, space, kernel.goal_x, kernel.goal_y, kernel.goal_yaw)
    start = node_at(to_go, space, kernel.start_x, kernel.start_y, kernel.start_yaw)
    straight = kernel.prices.reshape(-1, hills.bins, DIRECTIONS + 1)
    # what is uphill forwards is downhill for one who faces the other way
    cheapest = np.minimum(straight[..., 0], straight[:, ::-1, DIRECTIONS // 2])
    surface = _surface(places, kernel)
    dearness = cheapest / kernel.least_metre
    height = heights_of_places(places, hills, space)
    regions = regions_for(kernel, enlarged)
    near = np.ones(len(regions.x), bool)
    work, narrowed = 0, False
    if start >= 0 and goal >= 0:
        ends = int(regions.of_node[goal]), int(regions.of_node[start])
        slack = SLACK * 2.0 * kernel.reach
        back, out = (np.empty(len(near), np.float32) for _ in range(2))
        between = partial(
            ways_between, regions, margin=REACH, slack=slack,
            surface=surface, dearness=dearness, height=height, steepest=hills.steepest,
        )  # fmt: skip
        work += between(start=ends[0], stop=ends[1], leaving=False, distance=back)
        if np.isfinite(back[ends[1]]):
            work += between(start=ends[1], stop=ends[0], leaving=True, distance=out)
            far_off = back + out
            limit = max(REACH * back[ends[1]] + slack, known)
            least = _narrowed(regions, far_off, most * TURNS - work) if most < np.inf else limit
            narrowed = least < limit
            near = far_off <= min(least, limit)
            distance[:] = np.inf
    work += way_to_go(
        places,
        np.array([goal] if goal >= 0 else [], np.int32),
        regions.of_node,
        near,
        AHEAD,
        surface,
        dearness,
        height,
        hills.steepest,
        to_go.distance,
        to_go.direction,
        to_go.after,
    )
    if narrowed and not reached(to_go, kernel):
        # a way may lead beside what was looked at
        whole = _guide(kernel, enlarged, places, known)
        return whole._replace(work=whole.work + work)
    if not near.all():
        fill_beside(regions, near, back, to_go.distance)
    return to_go._replace(work=work)


def _narrowed(regions: Regions, length: NDArray[np.float32], most: float) -> float:
    """Return the length of ways by a region up to which all nodes have no more than so many turns.

    The shortest way is not longer.
    """
    order = np.argsort(length, kind="stable")
    turns = AGAIN * np.cumsum(np.bincount(regions.of_node, minlength=len(length))[order])
    last = int(np.searchsorted(turns, most, side="right")) - 1
    return float(max(length[order[max(last, 0)]], length[order[0]] * (1.0 + SINGLE)))


def _surface(places: Places, kernel: KernelProblem) -> NDArray[np.uint8]:
    """Return the class of the surface at each place; a single one where all are alike."""
    if kernel.surface.size == 1:
        return kernel.surface.ravel()
    rows, columns = kernel.surface.shape
    across = places.columns + 2 * RIM
    place = np.arange(len(places.masks))
    scale = places.spacing / kernel.space.resolution
    row = ((place // across - RIM + 0.5) * scale).astype(int).clip(0, rows - 1)
    column = ((place % across - RIM + 0.5) * scale).astype(int).clip(0, columns - 1)
    return np.asarray(kernel.surface[row, column])
