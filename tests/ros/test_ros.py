"""Messages of ROS 2, serialised as on the wire and back, and what the library makes of them."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import shapely

import energyplan as ep
from energyplan import ros
from energyplan.errors import (
    CancelledError,
    FrameError,
    InvalidInputError,
    MapError,
    MessageError,
    VehicleError,
)
from energyplan.fit.online import OnlineIdentifier
from energyplan.io.bags import TopicMap
from energyplan.io.maps import write_map
from energyplan.path import wrap_angle

pytest.importorskip("rosbags", reason="the messages' definitions need the extra bags")
import definitions

DISTRIBUTIONS = ("humble", "jazzy", "kilted")
COST = ep.EnergyCost(ep.PowerModel.preset("quadriga:empty:concrete"))
TO_POSE = "nav2_msgs/action/ComputePathToPose_Goal"
THROUGH = "nav2_msgs/action/ComputePathThroughPoses_Goal"


class Wire:
    """Makes messages of one distribution, and sends them through CDR."""

    def __init__(self, distribution: str) -> None:
        self.distribution = distribution
        self.store = definitions.store(distribution)
        self.stamp = self.make("builtin_interfaces/msg/Time", sec=7, nanosec=5)

    def make(self, kind: str, **fields: Any) -> Any:
        return self.store.types[kind](**fields)

    def sent(self, message: Any) -> Any:
        kind = message.__msgtype__
        return self.store.deserialize_cdr(self.store.serialize_cdr(message, kind), kind)

    def header(self, frame: str = "map") -> Any:
        return self.make("std_msgs/msg/Header", stamp=self.stamp, frame_id=frame)

    def turn(self, yaw: float, tilt: float = 0.0) -> Any:
        """Return the rotation by a tilt about the body's y after a yaw about z."""
        c, s = np.cos(tilt / 2), np.sin(tilt / 2)
        return self.make(
            "geometry_msgs/msg/Quaternion",
            x=float(-np.sin(yaw / 2) * s), y=float(np.cos(yaw / 2) * s),
            z=float(np.sin(yaw / 2) * c), w=float(np.cos(yaw / 2) * c),
        )  # fmt: skip

    def pose(self, x: float, y: float, yaw: float, tilt: float = 0.0) -> Any:
        point = self.make("geometry_msgs/msg/Point", x=x, y=y, z=0.3)
        return self.make("geometry_msgs/msg/Pose", position=point, orientation=self.turn(yaw, tilt))

    def stamped(self, x: float, y: float, yaw: float, frame: str = "map") -> Any:
        return self.make(
            "geometry_msgs/msg/PoseStamped", header=self.header(frame), pose=self.pose(x, y, yaw)
        )

    def map(self, cells: Any, origin: Any = (0.0, 0.0, 0.0), **fields: Any) -> Any:
        cells = np.asarray(cells)
        info = {
            "map_load_time": self.stamp, "resolution": 0.1, "width": cells.shape[1],
            "height": cells.shape[0], "origin": self.pose(*origin),
        }  # fmt: skip
        return self.make(
            "nav_msgs/msg/OccupancyGrid",
            header=self.header(),
            info=self.make("nav_msgs/msg/MapMetaData", **(info | fields)),
            data=cells.astype(np.int8).ravel(),
        )

    def to_pose(self, goal: Any, start: Any = None, planner_id: str = "") -> Any:
        return self.make(
            TO_POSE, goal=goal, start=start or self.stamped(0, 0, 0), planner_id=planner_id,
            use_start=start is not None,
        )  # fmt: skip

    def result(self, found: ros.PlanResult) -> Any:
        """Fill an action's result with an answer, and send it."""
        more = {} if self.distribution == "humble" else {"error_code": 9, "error_msg": "?"}
        empty = self.make(
            "nav2_msgs/action/ComputePath_Result",
            path=self.make("nav_msgs/msg/Path", header=self.header(), poses=[]),
            planning_time=self.make("builtin_interfaces/msg/Duration", sec=0, nanosec=0), **more,
        )  # fmt: skip
        filled = ros.fill_result(empty, found, "map", self.stamp, self.store.types.__getitem__)
        assert filled is empty
        return self.sent(filled)

    def through(self, goals: list[Any], start: Any) -> Any:
        if self.distribution == "kilted":
            goals = self.make("nav_msgs/msg/Goals", header=self.header(), goals=goals)
        return self.make(THROUGH, goals=goals, start=start, planner_id="GridBased", use_start=True)


@pytest.fixture(scope="module", params=DISTRIBUTIONS)
def wire(request: pytest.FixtureRequest) -> Wire:
    return Wire(request.param)


@pytest.fixture(scope="module")
def jazzy() -> Wire:
    return Wire("jazzy")


HALL = np.zeros((80, 80), int)
HALL[:, 78:] = 100
GRID = ros.grid_from_message(Wire("jazzy").map(HALL))


def test_a_map_comes_with_its_turned_origin_and_unknown_cells(wire: Wire) -> None:
    cells = [[0, 100, -1], [64, 65, 0]]
    grid = ros.grid_from_message(wire.sent(wire.map(cells, (3.0, -2.0, 2.5))))
    np.testing.assert_array_equal(grid.occupied, [[False, True, False], [False, True, False]])
    np.testing.assert_array_equal(grid.unknown, [[False, False, True], [False, False, False]])
    np.testing.assert_allclose(grid.origin, (3.0, -2.0, 2.5), atol=1e-12)
    assert grid.resolution == pytest.approx(0.1, rel=1e-7)
    # the middle of the cell in row 1, column 2
    expected = np.array([3.0, -2.0]) + 0.1 * np.array(
        [2.5 * np.cos(2.5) - 1.5 * np.sin(2.5), 2.5 * np.sin(2.5) + 1.5 * np.cos(2.5)]
    )
    np.testing.assert_allclose(grid.to_world((2.5, 1.5)), expected, atol=1e-7)
    assert grid.blocked[0, 2]
    free = ros.grid_from_message(wire.map(cells), unknown_is_free=True)
    assert not free.blocked[0, 2]
    inflated = ros.grid_from_message(wire.map([[99, 100]]), occupied_from=100)
    np.testing.assert_array_equal(inflated.occupied, [[False, True]])


def test_a_costmap_is_blocked_where_lethal_alone(wire: Wire) -> None:
    metadata = wire.make(
        "nav2_msgs/msg/CostmapMetaData", map_load_time=wire.stamp, update_time=wire.stamp,
        layer="master", resolution=0.05, size_x=5, size_y=1, origin=wire.pose(0, 0, 0),
    )  # fmt: skip
    data = np.array([0, 252, 253, 254, 255], np.uint8)
    message = wire.make("nav2_msgs/msg/Costmap", header=wire.header(), metadata=metadata, data=data)
    grid = ros.grid_from_message(wire.sent(message))
    np.testing.assert_array_equal(grid.occupied, [[False, False, False, True, False]])
    np.testing.assert_array_equal(grid.unknown, [[False, False, False, False, True]])
    inscribed = ros.grid_from_message(message, occupied_from=253)
    np.testing.assert_array_equal(inscribed.occupied, [[False, False, True, True, False]])


BAD_MAPS: list[tuple[dict[str, Any], type[Exception], str]] = [
    ({"width": 3}, MessageError, "3 by 2 cells, but data has 4"),
    ({"width": 0, "height": 0, "data": []}, MessageError, "0 by 0 cells"),
    ({"resolution": 0.0}, MapError, "resolution is 0.0 m"),
    ({"resolution": float("nan")}, MessageError, "resolution .* finite"),
    ({"width": None}, MessageError, "give numbers"),
    ({"data": [0, 0, 101, 0]}, MessageError, r"data\[2\] is 101"),
    ({"data": [0, -2, 0, 0]}, MessageError, r"data\[1\] is -2"),
    ({"data": [0.5, 0, 0, 0]}, MessageError, "whole numbers"),
    ({"data": [[0], [0, 1]]}, MessageError, "no row of numbers"),
    ({"origin": (0.0, 0.0, 1.0, 0.1)}, MessageError, "tilted"),
    ({"occupied_from": 0}, InvalidInputError, "occupied_from is 0"),
]
"""What is changed of a sound map of 2 by 2 cells, and what is said."""


@pytest.mark.parametrize(("changes", "error", "text"), BAD_MAPS)
def test_bad_maps_are_named(
    jazzy: Wire, changes: dict[str, Any], error: type[Exception], text: str
) -> None:
    fields = dict(changes)
    options = {name: fields.pop(name) for name in ("occupied_from",) if name in fields}
    data = fields.pop("data", None)
    message = jazzy.map(np.zeros((2, 2)), **fields)
    message.data = message.data if data is None else data
    with pytest.raises(error, match=text):
        ros.grid_from_message(message, **options)


def test_bad_poses_are_named(jazzy: Wire) -> None:
    unset = jazzy.pose(1.0, 2.0, 0.0)
    unset.orientation.w = 0.0
    assert ros.pose_from_message(jazzy.stamped(1, 2, 0, "/map"), "map") == (1, 2, 0)
    for message, error, text in (
        (unset, MessageError, "length 0"),
        (jazzy.pose(float("nan"), 0.0, 0.0), MessageError, r"position.x.*finite"),
        (jazzy.stamped(1, 2, 0, "odom"), FrameError, "'odom', expected 'map'"),
    ):
        with pytest.raises(error, match=text):
            ros.pose_from_message(message, "map" if error is FrameError else None)
    with pytest.raises(MessageError, match="no field 'info'"):
        ros.grid_from_message(unset)


@pytest.mark.parametrize("yaw", [0.0, 1.0, 3.1, -3.1, np.pi])
@pytest.mark.parametrize("tilt", [0.0, 0.2])
def test_a_heading_comes_back_also_on_a_slope(wire: Wire, yaw: float, tilt: float) -> None:
    message = wire.sent(wire.pose(1.5, -2.0, yaw, tilt))
    found = ros.pose_from_message(message)
    assert (found.x, found.y) == (1.5, -2.0)
    assert float(wrap_angle(found.yaw - yaw + 1.0)) == pytest.approx(1.0, abs=1e-12)


def test_a_footprint_becomes_the_rectangle_around_it(wire: Wire) -> None:
    corners = [(0.5, 0.0), (0.0, 0.3), (-0.4, 0.1), (0.0, -0.3)]
    points = [wire.make("geometry_msgs/msg/Point32", x=x, y=y, z=0.0) for x, y in corners]
    polygon = wire.sent(wire.make("geometry_msgs/msg/Polygon", points=points))
    found = ros.footprint_from_message(polygon, COST.vehicle)
    np.testing.assert_allclose(found.footprint, [[-0.4, -0.3], [0.5, 0.3]], atol=1e-7)
    stamped = wire.make(
        "geometry_msgs/msg/PolygonStamped", header=wire.header("map"), polygon=polygon
    )
    with pytest.raises(FrameError, match="footprint is in the frame 'map', expected 'base_link'"):
        ros.footprint_from_message(stamped, COST.vehicle, "base_link")
    polygon.points = points[:2]
    with pytest.raises(MessageError, match="2 corners"):
        ros.footprint_from_message(polygon, COST.vehicle)
    polygon.points = [points[0]] * 3
    with pytest.raises(VehicleError, match="x_max > x_min"):
        ros.footprint_from_message(polygon, COST.vehicle)


def test_a_path_comes_back_from_the_wire(wire: Wire) -> None:
    path = ep.Path((1.0, 2.0, 3.0), ds=[1.0, 0.0, -0.5], dtheta=[0.4, 2.0, 0.0])
    second = ep.Path(path.end, ds=[0.3], dtheta=[0.1])
    message = wire.sent(
        ros.path_to_message([path, second], "map", wire.stamp, wire.store.types.__getitem__)
    )
    assert message.header.frame_id == "map" and message.header.stamp.sec == 7
    assert all(p.header.frame_id == "map" for p in message.poses)
    poses = np.array([ros.pose_from_message(p, "map") for p in message.poses])
    steps = np.diff(poses, axis=0)
    assert np.hypot(steps[:, 0], steps[:, 1]).max() <= 0.05 + 1e-12
    assert np.abs(wrap_angle(steps[:, 2])).max() <= 0.1 + 1e-12
    assert np.abs(steps).max(axis=1).min() > 0  # the pose between two legs is there once
    again = ep.Path.from_poses(poses)
    assert again.length == pytest.approx(path.length + second.length, rel=1e-9)
    assert again.turning == pytest.approx(path.turning + second.turning, rel=1e-9)


def test_a_goal_is_planned_and_its_result_sent(wire: Wire) -> None:
    grid = ros.grid_from_message(wire.sent(wire.map(HALL)))
    request = wire.sent(wire.to_pose(wire.stamped(5, 4, 0.5), wire.stamped(2, 2, 0)))
    found = ros.answer(request, grid, COST, effort=20_000)
    assert found.code == ros.ToPoseError.NONE and found.message == ""
    same = ep.plan(ep.PlanningProblem(grid, COST, (2, 2, 0), (5, 4, 0.5)), effort=20_000)
    assert found.energy == pytest.approx(same.energy, rel=1e-9)
    assert found.lower_bound <= found.energy * (1 + 1e-9)
    result = wire.result(found)
    np.testing.assert_allclose(
        ros.pose_from_message(result.path.poses[-1], "map"), (5, 4, 0.5), atol=1e-6
    )
    took = result.planning_time.sec + 1e-9 * result.planning_time.nanosec
    assert took == pytest.approx(found.planning_time, abs=2e-9)
    assert hasattr(result, "error_code") is (wire.distribution != "humble")


def test_goals_are_driven_through_in_order(wire: Wire) -> None:
    goals = [wire.stamped(4, 2, 0), wire.stamped(4, 4, 1.57)]
    request = wire.sent(wire.through(goals, wire.stamped(2, 2, 0)))
    found = ros.answer(request, GRID, COST, effort=40_000)
    assert found.code == ros.ThroughPosesError.NONE, found.message
    assert len(found.plans) == 2
    assert found.energy == pytest.approx(sum(p.energy for p in found.plans))
    ends = [p.path.end for p in found.plans]
    np.testing.assert_allclose(ends, [(4, 2, 0), (4, 4, 1.57)], atol=1e-6)


ASIDE = np.pi / 2  # across the way to the goal


@pytest.mark.parametrize(
    ("mode", "headings"),
    [("DEFAULT", [2.5]), ("BIDIRECTIONAL", [2.5, 2.5 - np.pi]), ("ALL_DIRECTION", [])],
)
def test_goals_have_the_headings_that_smacs_modes_name(
    wire: Wire, mode: str, headings: list[float]
) -> None:
    """What a mode leaves open saves turns, and the same request again is planned on."""
    request = wire.sent(wire.to_pose(wire.stamped(5, 2, 2.5), wire.stamped(2, 2, 0)))
    given = ros.answer(request, GRID, COST, effort=5000)
    found = ros.answer(request, GRID, COST, effort=5000, heading_mode=mode)
    end = found.plans[0].path.end
    assert end[:2] == pytest.approx((5, 2), abs=1e-6)
    off = [abs(float(wrap_angle(end.yaw - yaw))) for yaw in headings]
    assert not off or min(off) < 1e-6
    assert found.energy <= (1.0 if mode == "DEFAULT" else 0.99) * given.energy
    again = ros.answer(request, GRID, COST, effort=5000, heading_mode=mode, former=found)
    assert again.plans[0].effort == 0
    assert again.energy == pytest.approx(found.energy, rel=1e-6)
    other = wire.sent(wire.to_pose(wire.stamped(5, 4, 2.5), wire.stamped(2, 2, 0)))
    elsewhere = ros.answer(other, GRID, COST, effort=5000, heading_mode=mode, former=found)
    assert elsewhere.plans[0].path.end.y == pytest.approx(4.0, abs=1e-6)


def test_goals_of_free_headings_are_driven_through_as_one_path(wire: Wire) -> None:
    """Each leg begins where the one before it ends, and one within the tolerance is there."""
    goals = [wire.stamped(4, 2, ASIDE), wire.stamped(4, 4, 0)]
    request = wire.sent(wire.through(goals, wire.stamped(2, 2, 0)))
    free = {"heading_mode": "ALL_DIRECTION", "tolerance": 0.3}
    found = ros.answer(request, GRID, COST, effort=10_000, **free)
    assert found.code == ros.ThroughPosesError.NONE, found.message
    first, then = (one.path for one in found.plans)
    assert then.start == pytest.approx(first.end)
    for path, goal in ((first, (4, 2)), (then, (4, 4))):
        assert np.hypot(path.end.x - goal[0], path.end.y - goal[1]) == pytest.approx(0.3, abs=0.01)
    given = ros.answer(request, GRID, COST, effort=10_000)
    assert found.energy < 0.8 * given.energy
    assert ros.answer(request, GRID, COST, effort=10_000, former=found, **free).energy == (
        pytest.approx(found.energy, rel=1e-6)
    )
    here = wire.sent(wire.to_pose(wire.stamped(4, 2, 0), wire.stamped(3.9, 2, 0)))
    near = ros.answer(here, GRID, COST, **free)
    assert near.code == ros.ToPoseError.NONE and near.energy == 0.0
    assert len(wire.result(near).path.poses) == 1


def test_a_heading_mode_that_smac_lacks_is_named(wire: Wire) -> None:
    request = wire.to_pose(wire.stamped(4, 2, 0), wire.stamped(2, 2, 0))
    found = ros.answer(request, GRID, COST, heading_mode="any")
    assert found.code == 200
    assert "'any'; give one of DEFAULT, BIDIRECTIONAL, ALL_DIRECTION" in found.message


def test_viapoints_of_newer_goals_come_before_the_goal(jazzy: Wire) -> None:
    request = SimpleNamespace(
        goal=jazzy.stamped(4, 4, 0), start=jazzy.stamped(2, 2, 0), planner_id="", use_start=True,
        viapoints=[jazzy.stamped(3, 2, 0)],
    )  # fmt: skip
    problems = ros.request_to_problems(request, GRID, COST)
    assert [(p.start, p.goal) for p in problems] == [
        ((2, 2, 0), (3, 2, 0)), ((3, 2, 0), (4, 4, 0)),
    ]  # fmt: skip


def test_poses_in_other_frames_are_brought_into_the_maps(wire: Wire) -> None:
    transform = wire.make(
        "geometry_msgs/msg/TransformStamped", header=wire.header("map"), child_frame_id="odom",
        transform=wire.make(
            "geometry_msgs/msg/Transform",
            translation=wire.make("geometry_msgs/msg/Vector3", x=1.0, y=2.0, z=0.0),
            rotation=wire.turn(np.pi / 2),
        ),
    )  # fmt: skip
    frames = {"odom": wire.sent(transform), "base": wire.sent(transform)}
    request = wire.to_pose(wire.stamped(2, -1, 0.5, "odom"))
    (problem,) = ros.request_to_problems(
        request, GRID, COST, base="base", lookup=frames.__getitem__, clearance=0.1
    )
    np.testing.assert_allclose(problem.start, (1, 2, np.pi / 2), atol=1e-12)
    np.testing.assert_allclose(problem.goal, (2, 4, np.pi / 2 + 0.5), atol=1e-12)
    assert problem.clearance == 0.1
    started = wire.to_pose(wire.stamped(2, -1, 0.5, "odom"), wire.stamped(2, 2, 0))
    assert ros.answer(started, GRID, COST).code == 202  # no way to transform
    assert ros.answer(wire.to_pose(wire.stamped(2, 2, 0)), GRID, COST).code == 202  # no start
    none = ros.answer(started, None, COST)
    assert none.code == 200 and "no map" in none.message


WALLED = HALL.copy()
WALLED[:, 40] = 100


@pytest.mark.parametrize(
    ("start", "goals", "planner", "code"),
    [
        ((-1, 2, 0), [(9, 2, 0)], "", 203),
        ((2, 2, 0), [(9, 2, 0)], "", 204),
        ((7.7, 2, 0), [(4, 2, 0)], "", 205),
        ((2, 2, 0), [(7.7, 2, 0)], "", 206),
        ((2, 2, 0), [(4, 2, 0)], "NavfnPlanner", 201),
        ((2, 2, 0), [(float("inf"), 2, 0)], "", 200),
        ((2, 2, 0), [(6, 2, 0)], "", 208),
        ((2, 2, 0), [(3, 2, 0), (9, 2, 0), (3, 4, 0)], "", 304),
        ((2, 2, 0), [(3, 2, 0), (7.7, 2, 0), (3, 4, 0)], "", 306),
        ((2, 2, 0), [], "", 309),
    ],
)
@pytest.mark.parametrize("mode", ros.HEADING_MODES)
def test_what_cannot_be_has_nav2s_code(
    jazzy: Wire, start: Any, goals: Any, planner: str, code: int, mode: str
) -> None:
    """Behind a wall, where nothing else is wrong."""
    grid = ros.grid_from_message(jazzy.map(WALLED if code == 208 else HALL))
    there, ends = jazzy.stamped(*start), [jazzy.stamped(*goal) for goal in goals]
    one = len(ends) == 1
    request = jazzy.to_pose(*ends, there, planner) if one else jazzy.through(ends, there)
    found = ros.answer(jazzy.sent(request), grid, COST, effort=50_000, heading_mode=mode)
    assert (found.code, found.plans) == (code, ()) and found.message
    result = jazzy.result(found)
    assert result.error_code == code and len(result.path.poses) == 0


def test_a_cancelled_goal_ends(jazzy: Wire) -> None:
    request = jazzy.to_pose(jazzy.stamped(6, 2, 0), jazzy.stamped(2, 2, 0))
    with pytest.raises(CancelledError):
        ros.answer(request, GRID, COST, effort=50_000, unwanted=lambda: True)


@pytest.mark.parametrize("through", [False, True])
def test_the_same_goal_again_is_planned_on_from_the_answer_before(
    wire: Wire, through: bool
) -> None:
    goal = wire.stamped(5, 4, 0.5)

    def ask(start: Any, over: ep.OccupancyGrid, **before: Any) -> ros.PlanResult:
        there = wire.stamped(*start)
        request = wire.through([goal], there) if through else wire.to_pose(goal, there)
        return ros.answer(wire.sent(request), over, COST, effort=5000, **before)

    first = ask((2, 2, 0), GRID)
    here = first.plans[0].path.subdivide(0.1, 0.1).vertices[6]
    # the map comes again, unchanged: nothing is searched
    rest = ask(here, ros.grid_from_message(wire.map(HALL)), former=first)
    assert rest.code.name == "NONE" and rest.plans[0].effort == 0
    assert rest.energy < first.energy
    # and a chain of answers
    assert ask(here, GRID, former=rest).energy == pytest.approx(rest.energy, rel=1e-6)
    # a box on the way
    x, y = GRID.to_cells(rest.plans[0].path.subdivide(0.1, 0.1).vertices[-12][:2]).astype(int)
    shut = GRID.updated(np.ones((2, 2), bool), row=int(y), column=int(x))
    round_it = ask(here, shut, former=rest)
    assert round_it.code.name == "NONE"
    assert round_it.energy > rest.energy
    assert shut.path_free(round_it.plans[0].path, COST.vehicle)
    # which is taken away again
    assert ask(here, GRID, former=round_it).energy < round_it.energy


def test_a_start_that_was_moved_off_an_obstacle_is_left_behind(jazzy: Wire) -> None:
    goal, front = jazzy.stamped(4, 4, 0), COST.vehicle.footprint[1, 0]
    touching = jazzy.to_pose(goal, jazzy.stamped(7.82 - front, 2, 0))
    first = ros.answer(touching, GRID, COST, effort=5000)
    assert "touches an obstacle" in first.notes[0]
    for here in first.plans[0].path.poses()[[20, 60]]:
        again = ros.answer(
            jazzy.to_pose(goal, jazzy.stamped(*here)), GRID, COST, effort=5000, former=first
        )
        assert (again.code.name, again.message) == ("NONE", "")


def test_another_goal_or_cost_is_planned_anew(jazzy: Wire) -> None:
    start = jazzy.stamped(2, 2, 0)
    request = jazzy.to_pose(jazzy.stamped(5, 4, 0.5), start)
    first = ros.answer(request, GRID, COST, effort=2000)
    other = jazzy.to_pose(jazzy.stamped(5, 3, 0.5), start)
    assert ros.answer(other, GRID, COST, effort=2000, former=first).plans[0].path.end.y == (
        pytest.approx(3.0)
    )
    dear = ep.EnergyCost(ep.PowerModel.preset("quadriga:full:concrete"))
    changed = ros.answer(request, GRID, dear, effort=2000, former=first)
    assert changed.energy > first.energy and changed.plans[0].effort > 0
    failed = ros.answer(request, None, COST, former=first)
    assert failed.plans == ()
    assert ros.answer(request, GRID, COST, effort=2000, former=failed).code.name == "NONE"


def test_a_plan_is_told_as_diagnostics(wire: Wire) -> None:
    request = wire.to_pose(wire.stamped(5, 4, 0.5), wire.stamped(2, 2, 0))
    found = ros.answer(request, GRID, COST, effort=5_000)
    failed = ros.answer(wire.to_pose(wire.stamped(50, 4, 0)), GRID, COST)
    for answer, level in ((found, 0), (failed, 2)):
        message = wire.sent(
            ros.diagnostics_message(
                "energyplan: plan", "a plan", ros.plan_values(answer), wire.stamp,
                wire.store.types.__getitem__, error=not answer.plans,
            )
        )  # fmt: skip
        (status,) = message.status
        assert (status.level, status.name) == (level, "energyplan: plan")
        told = {pair.key: pair.value for pair in status.values}
        if answer.plans:
            assert float(told["energy [J]"]) == pytest.approx(found.energy, rel=1e-5)
            assert float(told["lower bound [J]"]) <= float(told["energy [J]"]) * (1 + 1e-5)
        else:
            assert told == {"error": failed.message} and failed.message
    values = ros.model_values(COST.model)
    assert float(values["slip_friction [1]"].split()[0]) == pytest.approx(
        COST.model.coefficient("slip_friction")
    )


def test_a_mission_is_answered_as_text(tmp_path: Path) -> None:
    write_map(ep.OccupancyGrid(np.zeros((40, 60), bool), 0.1), tmp_path / "room.yaml")
    text = (
        "model: quadriga:full:concrete\nmap: room.yaml\nbattery: quadriga\nstart: [1, 2, 0]\n"
        "coefficient_spread: 5 %\n"
        "planning_effort: 1000\ntasks:\n- {name: look, pose: [4, 2, 0]}\n"
        "- {name: wash, pose: [2, 3, 0], dwell: 2 h, power: 450 W, required: false}\n"
    )
    told = json.loads(ros.mission_answer(text, tmp_path))
    verdicts = [(task["name"], task["verdict"]) for task in told["tasks"]]
    assert verdicts == [("look", "reachable"), ("wash", "unreachable")]
    for wrong, word in (
        ("tasks: [", "YAML"),
        ("{}", "model"),
        (text.replace("map: ", "map: ../"), ".."),
    ):
        assert word in json.loads(ros.mission_answer(wrong, tmp_path))["error"]
    long = json.loads(ros.mission_answer("#" * (1 << 21), tmp_path))
    assert "larger than" in long["error"]


TOPICS = TopicMap.model_validate(
    {
        "channels": {
            "v_left": {"topic": "joint_states", "field": "velocity[*left*]", "scale": 0.2},
            "v_right": {"topic": "joint_states", "field": "velocity[*right*]", "scale": 0.2},
            "voltage": {"topic": "battery_state", "field": "voltage"},
            "current": {"topic": "battery_state", "field": "current", "scale": -1.0},
        }
    }
)


def test_a_model_is_learned_from_messages_while_driving(wire: Wire) -> None:
    """Joint rates at 50 Hz and a battery at 10 Hz, sent over the wire, lead to the true model."""
    truth = ep.PowerModel.preset("quadriga:full:marble")
    log = ep.simulate.drive(truth, "survey", rate=50.0, power_noise=2.0)
    online = OnlineIdentifier(truth.vehicle)
    feed = ros.DriveFeed(online, TOPICS)
    assert feed.topics == ("joint_states", "battery_state")
    names = ["front_left", "front_right", "rear_left", "rear_right"]
    speeds = log.channel("v_left"), log.channel("v_right")
    for k, t in enumerate(log.t.tolist()):
        left, right = speeds[0][k] / 0.2, speeds[1][k] / 0.2
        joints = wire.make(
            "sensor_msgs/msg/JointState", header=wire.header(), name=names,
            position=np.zeros(4), velocity=np.array([left, right, left, right]), effort=np.zeros(4),
        )  # fmt: skip
        feed.take("/robot/joint_states", wire.sent(joints), t)
        if k % 5 == 4:
            current = -log.power[k - 4 : k + 1].mean() / 25.0
            feed.take("/battery_state", battery_state(wire, 25.0, float(current)), t + 1e-3)
    assert feed.samples == len(log.t) // 5
    for term in ("slip_friction", "traction_resistance"):
        known = online.model.coefficient(term)
        assert known == pytest.approx(truth.coefficient(term), rel=0.05)


def battery_state(wire: Wire, voltage: float, current: float) -> Any:
    nan, none = float("nan"), np.zeros(0, np.float32)
    return wire.sent(
        wire.make(
            "sensor_msgs/msg/BatteryState", header=wire.header(), voltage=voltage, current=current,
            temperature=nan, charge=nan, capacity=nan, design_capacity=nan, percentage=nan,
            power_supply_status=2, power_supply_health=0, power_supply_technology=0, present=True,
            cell_voltage=none, cell_temperature=none, location="", serial_number="",
        )
    )  # fmt: skip


def test_a_sample_waits_for_every_channel_and_old_values_do_not_count(jazzy: Wire) -> None:
    feed = ros.DriveFeed(OnlineIdentifier(COST.model), TOPICS)
    wheels = SimpleNamespace(name=["left", "right"], velocity=[1.0, 1.0])
    battery = SimpleNamespace(voltage=25.0, current=-2.0)
    feed.take("battery_state", battery, 0.0)
    assert feed.samples == 0  # no speeds yet
    feed.take("joint_states", wheels, 0.1)
    feed.take("battery_state", battery, 0.2)
    feed.take("battery_state", battery, 0.3)
    assert feed.samples == 2
    feed.take("battery_state", battery, 0.3)  # the same instant again
    feed.take("battery_state", battery, 5.0)  # the wheels are silent
    feed.take("other", wheels, 5.1)
    feed.take("joint_states", SimpleNamespace(name=["left", "right"], velocity=[np.nan, 1.0]), 5.2)
    feed.take("battery_state", battery, 5.3)
    assert feed.samples == 2
    only = TopicMap.model_validate({"channels": {"v_left": {"topic": "a", "field": "b"}}})
    with pytest.raises(MessageError, match="v_right"):
        ros.DriveFeed(OnlineIdentifier(COST.model), only)


def test_a_plan_is_recorded_with_its_map(tmp_path: Path) -> None:
    """The file is read by rosbags' own reader, by the definitions that it carries itself."""
    from rosbags.highlevel import AnyReader

    cells = np.zeros((30, 40), bool)
    cells[3, 7] = True
    unknown = np.zeros_like(cells)
    unknown[5, 6] = True
    grid = ep.OccupancyGrid(cells, 0.1, ep.Pose(1.0, 2.0, 0.3), unknown)
    path = ep.Path((1.0, 2.0, 3.0), ds=[1.0, 0.0, -0.5], dtheta=[0.4, 2.0, 0.0])
    file = tmp_path / "plan.mcap"
    ros.write_recording({"/plan": path}, file, grid)
    first = file.read_bytes()
    assert b"ros2msg" in first and b"PoseStamped[] poses" in first  # viewers need the definitions
    with AnyReader([file]) as reader:
        told = {
            connection.topic: reader.deserialize(raw, connection.msgtype)
            for connection, _, raw in reader.messages()
        }
    assert set(told) == {"/plan", "/map"}
    again = ros.grid_from_message(told["/map"])
    np.testing.assert_array_equal(again.occupied, cells)
    np.testing.assert_array_equal(again.unknown, unknown)
    np.testing.assert_allclose(again.origin, grid.origin, atol=1e-12)
    last = ros.pose_from_message(told["/plan"].poses[-1], "map")
    np.testing.assert_allclose(last[:2], path.end[:2], atol=1e-9)
    ros.write_recording({"/plan": path}, file, grid)
    assert file.read_bytes() == first
    assert list(tmp_path.iterdir()) == [file]


def test_an_update_goes_into_the_map(jazzy: Wire) -> None:
    GRID.space  # noqa: B018  what is made of it is kept
    patch = SimpleNamespace(
        header=jazzy.header(), x=10, y=20, width=3, height=2,
        data=np.array([0, 100, -1, 65, 64, 0], np.int8),
    )  # fmt: skip
    now = ros.updated_grid(GRID, patch)
    np.testing.assert_array_equal(now.occupied[20:22, 10:13], [[0, 1, 0], [1, 0, 0]])
    assert now.unknown is not None
    assert now.unknown.sum() == 1
    assert now.unknown[20, 12]
    assert (now.occupied != GRID.occupied).sum() == 2
    with pytest.raises(MapError, match="does not lie on the map"):
        ros.updated_grid(GRID, SimpleNamespace(**{**vars(patch), "x": 78}))
    with pytest.raises(MessageError, match="data has 6"):
        ros.updated_grid(GRID, SimpleNamespace(**{**vars(patch), "width": 4}))


def test_costs_of_a_costmap_become_soft_costs(jazzy: Wire) -> None:
    soft = ros.costs_from_message(jazzy.map([[0, 50, -1], [100, 25, 0]], (1.0, 2.0, 0.5)))
    np.testing.assert_allclose(soft.costs, [[0, 0.5, 0], [1, 0.25, 0]])
    np.testing.assert_allclose(soft.origin, (1.0, 2.0, 0.5), atol=1e-12)


def test_an_update_without_a_frame_is_in_the_maps(jazzy: Wire) -> None:
    patch = SimpleNamespace(
        header=jazzy.header(""), x=10, y=20, width=1, height=1, data=np.array([100], np.int8)
    )
    assert ros.updated_grid(GRID, patch, frame="map").occupied[20, 10]
    patch.header = jazzy.header("odom")
    with pytest.raises(FrameError, match="'odom', expected 'map'"):
        ros.updated_grid(GRID, patch, frame="map")


def test_open_cells_of_a_keepout_mask_are_counted(jazzy: Wire) -> None:
    note = ros.note_of_keepout(jazzy.map([[0, 1, 99], [100, -1, 50]]))
    assert note.startswith("3 cells from 1 to 99 and 1 unknown cells are open")
    assert ros.note_of_keepout(jazzy.map([[0, 100]])) == ""


def test_a_speed_limit_is_of_speed_or_share_and_zero_lifts_it() -> None:
    area = shapely.box(0, 0, 1, 1)

    def limit(speed: float, percentage: bool) -> Any:
        message = SimpleNamespace(speed_limit=speed, percentage=percentage)
        return ros.speed_limit_from_message(message, area)

    assert limit(0.0, False) is None
    assert limit(0.0, True) is None
    assert limit(0.3, False).of(COST.vehicle) == 0.3
    assert limit(50.0, True).of(COST.vehicle) == pytest.approx(0.5 * COST.vehicle.motor.speed)
    for speed, percentage in ((-1.0, False), (120.0, True), (np.nan, False)):
        with pytest.raises((MapError, MessageError)):
            limit(speed, percentage)


def test_a_power_below_zero_is_named_after_a_hundred_samples() -> None:
    feed = ros.DriveFeed(OnlineIdentifier(COST.model), TOPICS)
    wheels = SimpleNamespace(name=["left", "right"], velocity=[1.0, 1.0])
    for k in range(99):
        feed.take("joint_states", wheels, 0.1 * k)
        feed.take("battery_state", SimpleNamespace(voltage=25.0, current=2.0), 0.1 * k + 0.01)
    assert feed.wrong_sign == ""
    feed.take("joint_states", wheels, 9.9)
    feed.take("battery_state", SimpleNamespace(voltage=25.0, current=2.0), 9.91)
    assert "below zero in 100 of 100 samples" in feed.wrong_sign
    assert "scale of current" in feed.wrong_sign
    for k in range(101, 202):
        feed.take("joint_states", wheels, 0.1 * k)
        feed.take("battery_state", SimpleNamespace(voltage=25.0, current=-2.0), 0.1 * k + 0.01)
    assert feed.wrong_sign == ""
