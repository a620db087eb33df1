import numpy as np
import pytest

from energyplan.cost import EnergyCost
from energyplan.errors import TimeLimitError, UnknownNameError, UnsupportedPlannerError
from energyplan.maps import OccupancyGrid
from energyplan.path import Path, Pose
from energyplan.planners import PlanningProblem, plan
from energyplan.planners import ompl as adapter
from energyplan.planners._query import Query
from energyplan.power import PowerModel

base = pytest.importorskip("ompl.base")
geometric = pytest.importorskip("ompl.geometric")

COST = EnergyCost(PowerModel.preset("quadriga:empty:concrete"))


def hall_with_pillar():
    occupied = np.zeros((80, 100), bool)
    occupied[25:55, 45:55] = True
    return OccupancyGrid(occupied, 0.1)


PROBLEM = PlanningProblem(hall_with_pillar(), COST, (2, 4, 0), (8, 4, 1.0))


@pytest.mark.parametrize("name", ["rrtstar", "informed_rrtstar", "bitstar", "fmt"])
def test_geometric_planners_return_free_paths_priced_by_the_model(name):
    options = {"num_samples": 300} if name == "fmt" else {}
    try:
        found = plan(PROBLEM, name, 2.0, **options)
    except TimeLimitError:
        # a loaded machine: what the planner may say is that it had no time
        found = plan(PROBLEM, name, 10.0, **options)
    assert PROBLEM.map.path_free(found.path, PROBLEM.robot)
    assert found.energy == pytest.approx(COST.energy(found.path), rel=1e-12)
    assert sum(found.breakdown.values()) == pytest.approx(found.energy, rel=1e-9)
    np.testing.assert_allclose(found.path.vertices[0], PROBLEM.start, atol=1e-9)
    end = np.array(found.path.end)
    np.testing.assert_allclose(end[:2], PROBLEM.goal[:2], atol=1e-6)
    assert np.cos(end[2] - PROBLEM.goal.yaw) == pytest.approx(1.0, abs=1e-9)
    best = plan(PROBLEM, "lattice", 2.0)
    assert best.lower_bound <= best.energy <= found.energy * (1 + 1e-9)


def test_objective_is_directed_additive_and_its_heuristic_admissible():
    query = Query(PROBLEM)
    space = adapter.pose_space(query)
    information = base.SpaceInformation(space)
    objective = adapter.EnergyObjective(information, query)
    assert not objective.isSymmetric()
    rng = np.random.default_rng(5)
    for _ in range(50):
        a, b, c = (
            adapter.pose_state(space, *rng.uniform(1, 9, 2), rng.uniform(-3, 3)) for _ in range(3)
        )
        ab, bc, ac = (objective.motionCost(*pair).value() for pair in ((a, b), (b, c), (a, c)))
        assert objective.motionCostHeuristic(a, b).value() <= ab * (1 + 1e-12)
        assert ac <= (ab + bc) * (1 + 1e-9)  # exact steering keeps the triangle inequality


def test_validator_agrees_with_the_map():
    query = Query(PROBLEM)
    space = adapter.pose_space(query)
    information = base.SpaceInformation(space)
    validator = adapter.SteeringValidator(information, query)
    south, north = (4.0, 1.2, 0.0), (6.0, 1.2, 0.0)
    assert validator.checkMotion(
        adapter.pose_state(space, *south), adapter.pose_state(space, *north)
    )
    assert not validator.checkMotion(
        adapter.pose_state(space, 2.0, 4.0, 0.0), adapter.pose_state(space, 8.0, 4.0, 0.0)
    )


@pytest.mark.parametrize("name", ["prm", "prmstar", "aorrtc"])
def test_planners_that_ompl_cannot_run_are_refused_with_a_reason(name):
    with pytest.raises(UnsupportedPlannerError, match=adapter.REFUSED[name][:20]):
        plan(PROBLEM, name, 0.1)


def test_unknown_parameter_names_those_there_are():
    with pytest.raises(UnknownNameError, match="GoalBias"):
        plan(PROBLEM, "rrtstar", 0.1, no_such=1)


def test_control_space_planner_keeps_within_the_motor_limits():
    from energyplan.feasibility import check
    from energyplan.speed import profile

    room = OccupancyGrid(np.zeros((60, 60), bool), 0.1)
    problem = PlanningProblem(room, COST, (2, 3, 0), (4, 3, 0))
    found = plan(problem, "control_rrt", 6.0, goal_bias=0.2)
    assert problem.map.path_free(found.path, problem.robot)
    assert found.energy == pytest.approx(COST.energy(found.path), rel=1e-12)
    assert found.duration < np.inf
    assert check(profile(found.path, COST.model), COST.model).feasible


def test_sst_says_why_it_cannot():
    with pytest.raises(UnsupportedPlannerError, match="control_rrt"):
        plan(PROBLEM, "sst", 1.0)


def test_lattice_planner_inside_simple_setup():
    space = base.ReedsSheppStateSpace(COST.half_track)
    bounds = base.RealVectorBounds(2)
    for axis, high in enumerate((10.0, 8.0)):
        bounds.setLow(axis, 0.0)
        bounds.setHigh(axis, high)
    space.setBounds(bounds)
    setup = geometric.SimpleSetup(space)
    setup.setStateValidityChecker(lambda state: True)
    ends = []
    for pose in (PROBLEM.start, PROBLEM.goal):
        state = space.allocState()
        state.setXY(pose.x, pose.y)
        state.setYaw(pose.yaw)
        ends.append(state)
    setup.setStartAndGoalStates(*ends)
    planner = adapter.LatticePlanner(setup.getSpaceInformation(), PROBLEM.map, COST)
    setup.setPlanner(planner)
    status = setup.solve(2.0)
    assert status.asString() == "Exact solution"
    assert planner.plan is not None
    way = setup.getSolutionPath()
    # OMPL's own measure of the states' Reeds-Shepp way is that of the path planned
    assert way.length() == pytest.approx(planner.plan.length, rel=1e-6)
    poses = [(s.getX(), s.getY(), s.getYaw()) for s in way.getStates()]
    again = Path.from_poses(poses, tolerance=1e-4)
    assert Pose(*again.end)[:2] == pytest.approx(PROBLEM.goal[:2], abs=1e-3)
    assert COST.energy(again) == pytest.approx(planner.plan.energy, rel=1e-3)
