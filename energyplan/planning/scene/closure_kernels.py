"""Kernels that tell whether free configurations join two poses, and look closer where they may.

Places and headings are those of the guide: a word of 64 bits holds the headings of a place. A flood
goes from place to place, from both ends in turns, over what was tested first. Boxes of poses are
halved until a pose in one is free, or the body is in the way at all of them.
"""

from __future__ import annotations

from math import pi
from typing import NamedTuple

import numpy as np

from energyplan.compilation import Flags, Ints, Words, njit
from energyplan.planning.scene.field import STEP_COLUMNS, STEP_ROWS, longer_ints
from energyplan.planning.scene.free_space_kernels import shrunk
from energyplan.planning.scene.guide_kernels import HEADINGS, RIM, Places
from energyplan.terrain.collision import Body, Space, pose_free

NEIGHBOURS = 8
"""Neighbours of a place from which one gets to it."""

SAFE = 1e-5
"""How much smaller a body is than the one that is in the way for certain [cells]: more than what
the collision test counts as touched."""


class Chain(NamedTuple):
    """A way from place to place."""

    place: Ints  # (n,): its places, from the start to the goal
    headings: Words  # (n,): headings with which each may be reached
    work: int  # steps that the flood took


class Queue(NamedTuple):
    """Places and headings in the order in which they came; there may be room for more."""

    place: Ints  # (n,): the places
    bits: Words  # (n,): headings of each
    parent: Ints  # (n,): where each was reached from
    side: Ints  # (n,): the end whose flood it belongs to


@njit
def _queue(room: int) -> Queue:
    """Return a queue with room for some entries."""
    return Queue(
        np.empty(room, np.int64), np.empty(room, np.uint64),
        np.empty(room, np.int64), np.empty(room, np.int64),
    )  # fmt: skip


@njit
def _added(queue: Queue, count: int, place: int, bits: np.uint64, parent: int, side: int) -> Queue:
    """Return a queue with an entry behind the first `count`: a longer one where it is full."""
    if count == len(queue.place):
        longer = _queue(2 * count)
        for k in range(count):
            longer.place[k] = queue.place[k]
            longer.bits[k] = queue.bits[k]
            longer.parent[k] = queue.parent[k]
            longer.side[k] = queue.side[k]
        queue = longer
    queue.place[count] = place
    queue.bits[count] = bits
    queue.parent[count] = parent
    queue.side[count] = side
    return queue


@njit
def _beside(bits: np.uint64) -> np.uint64:
    """Return the headings next to some."""
    ahead = (bits << np.uint64(1)) | (bits >> np.uint64(63))
    return ahead | (bits >> np.uint64(1)) | (bits << np.uint64(63))


@njit
def _spread(bits: np.uint64, mask: np.uint64) -> np.uint64:
    """Return all headings of a mask that are joined with some of them."""
    bits &= mask
    while True:
        wider = (bits | _beside(bits)) & mask
        if wider == bits:
            return bits
        bits = wider


@njit
def chain_between(
    passable: Words, tested: Words, across: int, start: int, begin: int, goal: int, end: int
) -> Chain:
    """Return a way from place to place between two of them, through tested headings mostly."""
    count = len(passable)
    reached = np.zeros((2, count), np.uint64)
    waiting = np.zeros((2, count), np.uint64)
    rows = STEP_ROWS
    columns = STEP_COLUMNS
    steps = np.empty(NEIGHBOURS, np.int64)
    for k in range(NEIGHBOURS):
        steps[k] = rows[k] * across + columns[k]
    # what was reached in the order in which it was, of both ends; what waits for its turn
    found = _queue(1024)
    later = _queue(1024)
    events = 0
    laters = 0
    head = np.zeros(2, np.int64)
    later_head = np.zeros(2, np.int64)
    for who in range(2):
        place = start if who == 0 else goal
        heading = np.uint64(1) << np.uint64(begin if who == 0 else end)
        later = _added(later, laters, place, heading, -1, who)
        laters += 1
    work = 0
    who = 1
    while True:
        who = 1 - who
        # the next of what this end reached
        while head[who] < events and found.side[head[who]] != who:
            head[who] += 1
        if head[who] == events:
            # a step further, where nothing was tested
            further = False
            while later_head[who] < laters and not further:
                k = later_head[who]
                later_head[who] += 1
                if later.side[k] != who:
                    continue
                there = later.place[k]
                waiting[who, there] &= ~later.bits[k]
                fresh = later.bits[k] & passable[there] & ~reached[who, there]
                if fresh == 0:
                    continue
                fresh |= _spread(fresh, tested[there] & passable[there]) & ~reached[who, there]
                found = _added(found, events, there, fresh, later.parent[k], who)
                reached[who, there] |= fresh
                events += 1
                further = True
                if reached[1 - who, there] & fresh != 0:
                    return _joined(found, events, work)
            if not further:
                return Chain(np.empty(0, np.int64), np.empty(0, np.uint64), work)
            continue
        at = head[who]
        head[who] += 1
        here = found.place[at]
        # this place's other headings, then its neighbours
        for k in range(-1, NEIGHBOURS):
            work += 1
            there = here if k < 0 else here + steps[k]
            mask = passable[there]
            if mask == 0:
                continue
            if k >= 0:
                known = tested[there] & mask
                fresh = _spread(found.bits[at] & tested[here] & known, known) & ~reached[who, there]
                if fresh != 0:
                    found = _added(found, events, there, fresh, at, who)
                    reached[who, there] |= fresh
                    events += 1
                    if reached[1 - who, there] & fresh != 0:
                        return _joined(found, events, work)
                fresh = found.bits[at] & mask
            else:
                fresh = _beside(found.bits[at]) & mask
            fresh &= ~(reached[who, there] | waiting[who, there])
            if fresh != 0:
                later = _added(later, laters, there, fresh, at, who)
                waiting[who, there] |= fresh
                laters += 1


@njit
def _joined(found: Queue, events: int, work: int) -> Chain:
    """Return the way by the last thing reached, and by what the other end reached there."""
    place, bits, parent, side = found.place, found.bits, found.parent, found.side
    last = events - 1
    other = last - 1
    while not (
        place[other] == place[last] and side[other] != side[last] and bits[other] & bits[last] != 0
    ):
        other -= 1
    if side[last] == 1:
        last, other = other, last
    before = 0
    k = last
    while k >= 0:
        before += 1
        k = parent[k]
    count = before
    k = other
    while k >= 0:
        count += 1
        k = parent[k]
    out = np.empty(count, np.int64)
    headings = np.empty(count, np.uint64)
    k = last
    for n in range(before):
        out[before - 1 - n] = place[k]
        headings[before - 1 - n] = bits[k]
        k = parent[k]
    k = other
    for n in range(before, count):
        out[n] = place[k]
        headings[n] = bits[k]
        k = parent[k]
    return Chain(out, headings, work)


@njit
def places_reached(passable: Words, across: int, start: int, begin: int) -> Flags:
    """Tell which places a place and heading leads to."""
    reached = np.zeros(len(passable), np.uint64)
    out = np.zeros(len(passable), np.bool_)
    rows = STEP_ROWS
    columns = STEP_COLUMNS
    queue = np.empty(1024, np.int32)
    reached[start] = _spread(np.uint64(1) << np.uint64(begin), passable[start])
    queue[0] = start
    size = 1
    while size > 0:
        size -= 1
        here = queue[size]
        out[here] = True
        for k in range(NEIGHBOURS):
            there = here + rows[k] * across + columns[k]
            fresh = _spread(reached[here], passable[there]) & ~reached[there]
            if fresh != 0:
                reached[there] |= fresh
                if size == len(queue):
                    queue = longer_ints(queue)
                queue[size] = there
                size += 1
    return out


class Looked(NamedTuple):
    """What looking closer found."""

    may: Words  # (n,)
    free: Words  # (n,)
    tests: int  # poses that were tested


@njit
def look_closer(
    space: Space, body: Body, places: Places, which: Ints, headings: Words, halvings: int, most: int
) -> Looked:
    """Halve the boxes of some places and headings until it is known whether the body fits there.

    A box is a place's square with half a step of heading on either side. Where none of the poses at
    the centres of its parts is free, all of them were tested, but for those of parts in which the
    body is in the way everywhere.
    """
    across = places.columns + 2 * RIM
    may = np.zeros(len(which), np.uint64)
    free = np.zeros(len(which), np.uint64)
    less = SAFE * space.resolution
    turn = 2.0 * pi / HEADINGS
    depth = np.empty(8 * halvings + 8, np.int64)
    box = np.empty((8 * halvings + 8, 3))
    tests = 0
    for n in range(len(which)):
        row = which[n] // across - RIM
        column = which[n] % across - RIM
        for h in range(HEADINGS):
            bit = np.uint64(1) << np.uint64(h)
            if headings[n] & bit == 0:
                continue
            size = 1
            depth[0] = 0
            box[0, 0] = (column + 0.5) * places.spacing
            box[0, 1] = (row + 0.5) * places.spacing
            box[0, 2] = h * turn
            while size > 0:
                size -= 1
                level = depth[size]
                along = box[size, 0]
                up = box[size, 1]
                heading = box[size, 2]
                x = space.x + space.cos * along - space.sin * up
                y = space.y + space.sin * along + space.cos * up
                tests += 1
                if tests > most or pose_free(space, body, x, y, space.yaw + heading):
                    may[n] |= bit
                    free[n] |= bit
                    break
                part = 0.5**level
                small = shrunk(body, part * places.spacing, heading, 0.5 * part * turn)
                small = Body(
                    small.x_min + less, small.y_min + less, small.x_max - less, small.y_max - less
                )
                fits = small.x_min < small.x_max and small.y_min < small.y_max
                if fits and not pose_free(space, small, x, y, space.yaw + heading):
                    continue
                if level == halvings:
                    may[n] |= bit
                    continue
                for k in range(8):
                    depth[size] = level + 1
                    box[size, 0] = along + part * places.spacing * (0.25 if k & 1 else -0.25)
                    box[size, 1] = up + part * places.spacing * (0.25 if k & 2 else -0.25)
                    box[size, 2] = heading + part * turn * (0.25 if k & 4 else -0.25)
                    size += 1
    return Looked(may, free, tests)
