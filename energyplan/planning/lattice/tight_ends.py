"""Ends so tight that a lattice does not join them: a way leads out of each to where there is room.

Most searches end a hand's breadth from a goal that they cannot turn into, and one that starts there
does not get away. The way out is found first, by motions as short as the room there is, and the
searches begin and end where it does. It is a way as any other: refinement makes of it what is best.

Best paths touch obstacles, and one that was planned without a margin may be free or not by
rounding. If it is not, planning is done anew between the two poses that have room.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np

from energyplan.errors import PlanningError
from energyplan.path import Path, Pose
from energyplan.planning.budget import Budget, side_by_side
from energyplan.planning.lattice import escape_kernels as kernels
from energyplan.planning.lattice.refine import Refiner
from energyplan.planning.problem import PlanningProblem
from energyplan.planning.scene.compiled import CompiledProblem, Segments
from energyplan.planning.scene.motions import KernelProblem, motion_cost, steering_cost
from energyplan.steering.kernels import arc_end
from energyplan.terrain.collision import motion_free

TURN = 0.2
"""What the body can turn on the spot where there is room, both ways together [rad]."""

WAYS = 6
"""Ways out of an end, of which the best is taken."""

EFFORT = 3000.0
"""Units of work for each kind of way out of each end, at most."""

TEST = 0.07
"""Units of work that the test of a motion counts as."""

SLICE = 2000
"""Tests between two looks at the budget."""

NODES = 1 << 13
"""Poses that the search for a way out remembers."""

ONLY = (0.0, 1.0, -1.0)
"""Kinds of ways: any, only forwards, only backwards. The first one is to and fro at times."""

NOTHING = Segments(np.empty(0), np.empty(0))


@dataclass(frozen=True, eq=False)
class Ends:
    """Where searches begin and end, and the motions between there and the problem's own ends."""

    query: CompiledProblem  # the problem
    out: Segments = NOTHING
    back: Segments = NOTHING

    @property
    def eased(self) -> bool:
        """Whether searches begin or end elsewhere than the problem does."""
        return len(self.out.ds) + len(self.back.ds) > 0

    @cached_property
    def problem(self) -> PlanningProblem:
        """The problem between the two poses."""
        problem = self.query.problem
        out, back = (self.query.reference(*part) for part in (self.out, self.back))
        longitudinal = problem.cost.icr.longitudinal
        away = Path(problem.goal, -back.ds[::-1], -back.dtheta[::-1], longitudinal)
        return replace(
            problem,
            start=Path(problem.start, out.ds, out.dtheta, longitudinal).end,
            goal=away.end,
        )

    def between(self, setting: KernelProblem) -> KernelProblem:
        """Return the kernels' problem between the two poses, with the margin where it fits."""
        if not self.eased:
            return setting
        query = self.query
        ends = self.problem.start, self.problem.goal
        start, goal = (query.centre(end) for end in ends)
        return setting._replace(
            body=query.grown if all(query.roomy(end) for end in ends) else setting.body,
            start_x=start.x,
            start_y=start.y,
            start_yaw=start.yaw,
            goal_x=goal.x,
            goal_y=goal.y,
            goal_yaw=goal.yaw,
        )

    def around(self, inner: Path) -> Path:
        """Return the path from the problem's start to its goal by way of one in between."""
        out, back = (self.query.reference(*part) for part in (self.out, self.back))
        return replace(
            inner,
            start=self.query.problem.start,
            ds=np.concatenate([out.ds, inner.ds, back.ds]),
            dtheta=np.concatenate([out.dtheta, inner.dtheta, back.dtheta]),
        )

    def refined(self, inner: Path, budget: Budget) -> Path:
        """Return `around(inner)`, refined with the margin where it fits."""
        query = self.query
        whole = self.around(inner)
        # what is not free with the margin stays as it is
        motions = query.of_centre(whole.ds, whole.dtheta)
        refiner = Refiner(query.setting._replace(body=query.grown), motions)
        refiner.shortcut(budget)
        refiner.polish(budget)
        try:
            return min(whole, query.path(refiner.segments), key=query.value)
        except PlanningError:
            return whole

    def whole(self, inner: Segments) -> Segments:
        """Return the motions from the problem's start to its goal by way of those in between."""
        return Segments(
            np.concatenate([self.out.ds, inner.ds, self.back.ds]),
            np.concatenate([self.out.dtheta, inner.dtheta, self.back.dtheta]),
        )


def tight(query: CompiledProblem, end: Pose, turn: float = TURN) -> bool:
    """Tell whether a start or a goal lacks the margin, or room for a turn up to `TURN` [rad]."""
    if surely_roomy(query, end):
        return False
    room = kernels.spin_room(query.grid.space, query.body, *query.centre(end), TURN)
    return not query.roomy(end) or room < turn


def surely_roomy(query: CompiledProblem, end: Pose) -> bool:
    """Tell whether an end has the margin, and room for the whole `TURN` one way or the other."""
    space, body, pose = query.grid.space, query.body, query.centre(end)
    return query.roomy(end) and any(
        motion_free(space, body, *pose, 0.0, way, 0.0) for way in (TURN, -TURN)
    )


class Way(NamedTuple):
    """A way out of an end, or into it."""

    motions: Segments  # its motions, as they are driven
    promise: float  # what it costs, and the motion between where it has room and the other end


def _way_out(
    query: CompiledProblem, goal: bool, only: float, turn: float, budget: Budget
) -> Way | None:
    """Return the way that costs least on the whole with what is left then, if any is known."""
    problem = query.problem
    ends = (problem.goal, problem.start) if goal else (problem.start, problem.goal)
    pose, far = (query.centre(end) for end in ends)
    space, body, setting = query.grid.space, query.body, query.setting
    tree = kernels.Escape(
        x=np.zeros(NODES),
        y=np.zeros(NODES),
        yaw=np.zeros(NODES),
        g=np.zeros(NODES),
        room=np.zeros(NODES),
        parent=np.full(NODES, -1, np.int32),
        ds=np.zeros(NODES),
        dtheta=np.zeros(NODES),
        key=np.zeros(NODES, np.int64),
        table=np.full(4 * NODES, -1, np.int32),
        heap_f=np.zeros(NODES),
        heap_node=np.zeros(NODES, np.int32),
        roomy=np.zeros(NODES, np.int32),
        counts=np.zeros(4, np.int64),
    )
    kernels.plant_escape(tree, space, body, *pose, setting.reach, TURN)
    more = True
    while more and int(tree.counts[2]) < WAYS and not budget.over:
        before = int(tree.counts[3])
        more = kernels.grow_escape(
            tree,
            space,
            body,
            query.grown,
            max(setting.half_track, setting.least_radius),
            setting.least_radius == 0.0,
            setting.reach,
            TURN,
            goal,
            only,
            turn,
            before + min(SLICE, int(budget.left / TEST) + 1),
            WAYS,
        )
        budget.spend(TEST * (int(tree.counts[3]) - before))
    ways = []
    for node in tree.roomy[: int(tree.counts[2])].tolist():
        room = Pose(float(tree.x[node]), float(tree.y[node]), float(tree.yaw[node]))
        chain = []
        while tree.parent[node] >= 0:
            chain.append((float(tree.ds[node]), float(tree.dtheta[node])))
            node = int(tree.parent[node])
        here = room if goal else pose
        begin, end = (far, room) if goal else (room, far)
        rest = steering_cost(setting, *begin, *end)
        for ds, dtheta in chain if goal else chain[::-1]:
            rest += motion_cost(setting, *here, ds, dtheta)
            here = arc_end(here, ds, dtheta)
        ways.append(Way(Segments(*np.array(chain if goal else chain[::-1]).T), rest))
    return min(ways, key=lambda way: way.promise, default=None)


def ways_out(query: CompiledProblem, budget: Budget, turn: float = TURN) -> list[Ends]:
    """Return ends with room, the most promising first."""
    ends = query.problem.start, query.problem.goal
    kinds = [
        (goal, only) for goal in (False, True) if tight(query, ends[goal], turn) for only in ONLY
    ]
    tasks = [partial(_way_out, query, goal, only, turn) for goal, only in kinds]
    found: dict[bool, list[Way]] = {False: [], True: []}
    for (goal, _), way in zip(kinds, side_by_side(budget, tasks, EFFORT), strict=True):
        if way is not None:
            found[goal].append(way)
    outs, backs = (
        [way.motions for way in sorted(found[goal], key=lambda way: way.promise)] or [NOTHING]
        for goal in (False, True)
    )
    several = max(len(outs), len(backs))
    return [Ends(query, outs[k % len(outs)], backs[k % len(backs)]) for k in range(several)]
