import numpy as np
import pytest

from energyplan.cost import EnergyCost
from energyplan.errors import UnknownNameError
from energyplan.path import Path, Pose
from energyplan.planning import PlanningProblem, plan
from energyplan.planning import ompl as adapter
from energyplan.planning.scene.compiled import CompiledProblem
from energyplan.power import PowerModel
from energyplan.terrain import OccupancyGrid

base = pytest.importorskip("ompl.base")
geometric = pytest.importorskip("ompl.geometric")
tools = pytest.importorskip("ompl.tools")

COST = EnergyCost(PowerModel.preset("quadriga:empty:concrete"))


def hall_with_pillar():
    occupied = np.zeros((80, 100), bool)
    occupied[25:55, 45:55] = True
    return OccupancyGrid(occupied, 0.1)


PROBLEM = PlanningProblem(hall_with_pillar(), COST, (2, 4, 0), (8, 4, 1.0))


@pytest.mark.parametrize("name", ["rrtstar", "informed_rrtstar", "bitstar", "fmt"])
def test_geometric_planners_return_free_paths_priced_by_the_model(name):
    options = {"num_samples": 200} if name == "fmt" else {}
    found = plan(PROBLEM, name, effort=40_000 if name == "fmt" else 15_000, **options)
    assert PROBLEM.map.path_free(found.path, PROBLEM.robot)
    assert found.energy == pytest.approx(COST.energy(found.path), rel=1e-12)
    assert sum(found.breakdown.values()) == pytest.approx(found.energy, rel=1e-9)
    np.testing.assert_allclose(found.path.vertices[0], PROBLEM.start, atol=1e-9)
    end = np.array(found.path.end)
    np.testing.assert_allclose(end[:2], PROBLEM.goal[:2], atol=1e-6)
    assert np.cos(end[2] - PROBLEM.goal.yaw) == pytest.approx(1.0, abs=1e-9)
    best = plan(PROBLEM, effort=10_000)
    assert best.lower_bound <= best.energy <= found.energy * (1 + 1e-9)


def test_objective_is_directed_additive_and_its_heuristic_admissible():
    query = CompiledProblem(PROBLEM)
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
    query = CompiledProblem(PROBLEM)
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


def test_unknown_parameter_names_those_there_are():
    with pytest.raises(UnknownNameError, match="GoalBias"):
        plan(PROBLEM, "rrtstar", effort=5000, no_such=1)


def test_control_space_planner_keeps_within_the_motor_limits():
    from energyplan.limits.feasibility import check
    from energyplan.limits.speed import profile

    room = OccupancyGrid(np.zeros((60, 60), bool), 0.1)
    problem = PlanningProblem(room, COST, (2, 3, 0), (4, 3, 0))
    found = plan(problem, "control_rrt", effort=60_000, goal_bias=0.2)
    assert problem.map.path_free(found.path, problem.robot)
    assert found.energy == pytest.approx(COST.energy(found.path), rel=1e-12)
    assert found.duration < np.inf
    # not the first path that a random tree finds, which costs several times the least
    assert found.gap < 0.15
    assert check(profile(found.path, COST.model), COST.model).feasible


def simple_setup():
    """OMPL's own way to set up a problem, with the footprint tested in OMPL's states."""
    space = base.ReedsSheppStateSpace(COST.half_track)
    bounds = base.RealVectorBounds(2)
    for axis, high in enumerate((10.0, 8.0)):
        bounds.setLow(axis, 0.0)
        bounds.setHigh(axis, high)
    space.setBounds(bounds)
    setup = geometric.SimpleSetup(space)

    def is_free(state):
        pose = state.getX(), state.getY(), state.getYaw()
        return bool(PROBLEM.map.footprint_free([pose], PROBLEM.robot)[0])

    setup.setStateValidityChecker(is_free)
    ends = []
    for pose in (PROBLEM.start, PROBLEM.goal):
        state = space.allocState()
        state.setXY(pose.x, pose.y)
        state.setYaw(pose.yaw)
        ends.append(state)
    setup.setStartAndGoalStates(*ends)
    return setup


def test_lattice_planner_inside_simple_setup():
    setup = simple_setup()
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


def test_lattice_planner_in_ompls_benchmark(tmp_path):
    """Beside one of OMPL's own; the log holds its runs, found exact and correct by OMPL itself."""
    plan(PROBLEM, effort=10_000)  # compile first
    setup = simple_setup()
    information = setup.getSpaceInformation()
    benchmark = tools.Benchmark(setup, "pillar")
    planner = adapter.LatticePlanner(information, PROBLEM.map, COST)
    benchmark.addPlanner(planner)
    benchmark.addPlanner(geometric.RRTConnect(information))
    request = tools.Request(2.0, 4096.0, 2)
    request.displayProgress = request.saveConsoleOutput = False
    request.simplify = False
    benchmark.benchmark(request)
    log = tmp_path / "pillar.log"
    assert benchmark.saveResultsToFile(str(log))
    lines = log.read_text().splitlines()
    place = lines.index("geometric_EnergyLattice", lines.index("2 planners"))
    count = next(k for k in range(place, len(lines)) if lines[k].endswith("for each run"))
    number = int(lines[count].split()[0])
    names = [line.rsplit(" ", 1)[0] for line in lines[count + 1 : count + 1 + number]]
    assert lines[count + 1 + number] == "2 runs"
    assert planner.plan is not None
    for line in lines[count + 2 + number : count + 4 + number]:
        run = dict(zip(names, (cell.strip() for cell in line.split(";")), strict=False))
        assert run["status"] == "6"  # exact solution
        assert run["solved"] == run["correct solution"] == run["correct solution strict"] == "1"
        assert float(run["solution length"]) == pytest.approx(planner.plan.length, rel=0.05)
