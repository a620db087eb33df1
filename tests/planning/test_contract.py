"""What a planner hands back is checked and priced by `plan` alone."""

from __future__ import annotations

import re
import sys
from dataclasses import replace
from pathlib import Path as File

import numpy as np
import pytest
import shapely
from worlds import COST, MODEL, room

import energyplan as ep
from energyplan import errors
from energyplan.planning import Budget, planners
from energyplan.planning.driven import drive_plan
from energyplan.power.effects import with_weight
from energyplan.terrain import HeightMap, Surface, SurfaceMap
from energyplan.vehicle import TreadICR

PROBLEM = ep.PlanningProblem(room(100, 100, 0.1), COST, (1, 5, 0), (9, 5, 0))
RAMP = HeightMap(np.tile(0.05 * np.arange(0.0, 10.5, 0.5), (21, 1)), 0.5)


def straight(problem, budget):
    """8 m straight ahead."""
    budget.spend(1)
    return ep.Candidate(ep.Path(problem.start, [8.0], [0.0], problem.cost.icr.longitudinal))


def documented():
    """The planner that docs/extending.md prints."""
    text = (File(__file__).parents[2] / "docs" / "extending.md").read_text()
    blocks = re.findall(r"```python\n(.*?)```", text, re.S)
    code = next(block for block in blocks if "def turn_drive_turn" in block)
    known = {"np": np, "ep": ep, "model": MODEL}
    exec(code, known)
    return known["straight"]


def test_the_documented_planner_is_priced_on_the_ground_as_it_is():
    """8 m at 2 * 113 N, or half of them at 2 * 600 N: the planner does not know of surfaces."""
    mud = ep.PowerModel.paper(MODEL.vehicle, K=600.0, mu=0.627, name="mud")
    ground = SurfaceMap([Surface(shapely.box(3, -1, 7, 11), mud)])
    plain = ep.plan(PROBLEM, documented(), effort=1000)
    assert plain.energy == pytest.approx(8 * 226.0)
    found = ep.plan(replace(PROBLEM, surfaces=ground), documented(), effort=1000)
    assert found.energy == pytest.approx(4 * 226.0 + 4 * 1200.0)
    assert sum(found.breakdown.values()) == pytest.approx(found.energy)
    # every way leads through the mud, 4 m of it
    assert 0.5 * found.energy < found.lower_bound <= found.energy
    assert found.planner == "turn_drive_turn"


def test_a_plugin_on_slopes_pays_for_the_climb():
    heavy = replace(PROBLEM, cost=ep.EnergyCost(with_weight(MODEL)), heights=RAMP)
    found = ep.plan(heavy, documented(), effort=1000)
    climb = MODEL.vehicle.mass * 9.81 * 8 * 0.05
    assert found.energy == pytest.approx(8 * 226.0 * np.hypot(1, 0.05) + climb, rel=1e-6)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda p: ep.Path(p.start, [7.0], [0.0]), r"ends at \(8.000, 5.000"),
        (lambda p: ep.Path(p.goal, [8.0], [0.0]), r"starts at \(9.000, 5.000"),
        (lambda p: ep.Path(p.start, [8.0], [0.0], 0.1), "reference point at x = 0.1 m"),
        (lambda p: ep.Path(p.start, [8.0], [1e-3]), r"0.1 deg\) in place of"),
        (lambda p: "a path", "a str in place of a Path"),
    ],
)
def test_what_is_no_answer_is_refused_by_name(make, words):
    def wrong(problem, budget):
        return ep.Candidate(make(problem))

    with pytest.raises(errors.InvalidPathError, match=f"'wrong' returned .*{words}") as told:
        ep.plan(PROBLEM, ep.Planner(wrong))
    assert PROBLEM.fault(make(PROBLEM)) in str(told.value)
    assert PROBLEM.fault(straight(PROBLEM, Budget()).path) is None


def test_what_a_plugin_says_of_driving_is_computed_anew():
    def boasting(problem, budget):
        found = straight(problem, budget)
        drive = drive_plan(problem, found.path)
        return replace(found, driven=replace(drive, energy=1.0))

    found = ep.plan(PROBLEM, ep.Planner(boasting))
    assert found.energy_driven == drive_plan(PROBLEM, found.path).energy > 1.0


def test_a_path_through_an_obstacle_is_refused_with_its_place():
    walled = replace(PROBLEM, map=room(100, 100, 0.1, np.s_[45:55, 50]))
    with pytest.raises(errors.InvalidPathError, match=r"'straight' .*segment 0.*\(1.000, 5.000"):
        ep.plan(walled, ep.Planner(straight))


def test_a_path_off_the_map_or_through_a_keep_out_area_is_refused():
    def around(problem, budget):
        turns = 0.5 * np.pi * np.array([1, 0, -1, 0, -1, 0, 1])
        return ep.Candidate(ep.Path(problem.start, [0, 8, 0, 8, 0, 8, 0], turns))

    with pytest.raises(errors.InvalidPathError, match=r"leaves the map, .* x from 0 to 10 m"):
        ep.plan(PROBLEM, ep.Planner(around))
    closed = SurfaceMap([], keep_out=[shapely.box(4, 4, 5, 6)])
    with pytest.raises(errors.InvalidPathError, match="touches an obstacle"):
        ep.plan(replace(PROBLEM, surfaces=closed), ep.Planner(straight, surfaces=True))


def test_something_else_than_a_candidate_is_refused():
    with pytest.raises(errors.PlanningError, match=r"'plan' returned a Path; .*Candidate"):

        def plan(problem, budget):
            return straight(problem, budget).path

        ep.plan(PROBLEM, ep.Planner(plan))


@pytest.mark.parametrize("over", [1e-6, 0.1, 1.0])
def test_a_bound_above_the_cost_of_a_path_is_an_error(over):
    def boastful(problem, budget):
        path = straight(problem, budget).path
        return ep.Candidate(path, lower_bound=COST.energy(path) * (1 + over))

    with pytest.raises(errors.LowerBoundError, match=r"'boastful' lies above the cost 1808"):
        ep.plan(PROBLEM, ep.Planner(boastful, bound=True))


def test_bound_and_gap_are_reported_as_computed():
    def modest(problem, budget):
        return ep.Candidate(straight(problem, budget).path, lower_bound=904.0)

    found = ep.plan(PROBLEM, ep.Planner(modest, bound=True))
    assert found.lower_bound == 904.0
    assert found.gap == pytest.approx(1.0)
    nothing = ep.plan(PROBLEM, ep.Planner(lambda p, b: replace(modest(p, b), lower_bound=0.0)))
    assert nothing.gap == np.inf


def test_a_planner_is_refused_where_it_cannot_be_used_and_others_are_named():
    plain = ep.Planner(straight)
    ground = SurfaceMap([Surface(shapely.box(3, 0, 7, 10), MODEL)])
    for problem, words in (
        (replace(PROBLEM, surfaces=ground), "surfaces; use one of lattice, rrtstar"),
        (replace(PROBLEM, heights=RAMP), "heights; use one of lattice, rrtstar"),
        (replace(PROBLEM, objective={"energy": 1.0, "time": 2.0}), "the objective time; use"),
    ):
        said = f"'straight' cannot be used with {words}"
        with pytest.raises(errors.UnsupportedPlannerError, match=said):
            ep.plan(problem, plain)
    with pytest.raises(errors.UnsupportedPlannerError, match="effort instead of a time limit"):
        ep.plan(PROBLEM, plain, effort=100)
    # weights of nothing ask for nothing
    assert ep.plan(replace(PROBLEM, objective={"energy": 1.0, "time": 0.0}), plain).cost == 1808.0
    with pytest.raises(errors.InvalidInputError, match="beauty"):
        ep.Planner(straight, objectives=("beauty",))


def test_a_vehicle_whose_reference_point_lies_ahead():
    ahead = replace(MODEL, vehicle=MODEL.vehicle.with_icr(TreadICR(0.4, 0.5, 0.1)))
    problem = replace(PROBLEM, cost=ep.EnergyCost(ahead))
    assert ep.plan(problem, ep.Planner(straight)).path.longitudinal == 0.1


@pytest.fixture
def install(tmp_path, monkeypatch):
    """Install modules of a package, whose planners are known by the names of the entry points."""

    def installed(package, entries, **modules):
        info = tmp_path / f"{package}-1.0.dist-info"
        for folder in (info, tmp_path / package):
            folder.mkdir()
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {package}\nVersion: 1.0\n")
        points = [f"{name} = {package}.{place}" for name, place in entries.items()]
        (info / "entry_points.txt").write_text("\n".join(["[energyplan.planning]", *points]))
        for name, text in modules.items():
            (tmp_path / package / f"{name}.py").write_text(text)
        monkeypatch.syspath_prepend(str(tmp_path))

    return installed


def test_an_installed_plugin(install):
    install(
        "birds",
        {"crow": "crows:crow", "fly": "crows:fly"},
        crows="import energyplan as ep\n"
        "def fly(problem, budget, *, far=8.0):\n"
        "    return ep.Candidate(ep.Path(problem.start, [far], [0.0]))\n"
        "crow = ep.Planner(fly)\n",
    )
    assert {"crow", "fly"} <= set(planners())
    assert ep.plan(PROBLEM, "crow", 0.5).planner == "crow"
    with pytest.raises(errors.InvalidPathError, match="'crow' returned a path that ends"):
        ep.plan(PROBLEM, "crow", far=7.0)
    with pytest.raises(errors.PlanningError, match=r"'fly' of .* is a function; .*Planner"):
        ep.plan(PROBLEM, "fly")


def test_a_mistake_in_a_plugin_is_told_at_its_own_line(install):
    install(
        "shaky",
        {name: f"{name}:one" for name in ("fly", "broken", "unread")},
        broken="import energyplan\nraise OSError('no file')\n",
        unread="def f(:\n",
        helper="import numpy as np\ndef half(pose):\n    return np.reshape(pose, 7)\n",
        fly="import energyplan as ep\n"
        "from energyplan.errors import InvalidInputError, NoPathError\n"
        "from shaky.helper import half\n"
        "def fly(problem, budget, *, how='name'):\n"
        "    if how == 'name':\n"
        "        return problem.robot.length\n"
        "    if how == 'shape':\n"
        "        return half(problem.start)\n"
        "    if how == 'ours':\n"
        "        return ep.Path(problem.start, [1.0], [0.0, 2.0])\n"
        "    if how == 'no way':\n"
        "        raise NoPathError('a river is in between')\n"
        "    raise InvalidInputError(f'how is {how}; give a name')\n"
        "one = ep.Planner(fly)\n",
    )
    for name, how, file, words in (
        ("fly", "name", "fly.py, line 6", "AttributeError: 'Vehicle' object has no attribute"),
        ("fly", "shape", "helper.py, line 3", "ValueError: cannot reshape"),
        ("fly", "ours", "fly.py, line 10", "PathError: "),
        ("broken", "", "broken.py, line 2", "OSError: no file"),
        ("unread", "", "unread.py, line 1", "SyntaxError: "),
    ):
        options = {"how": how} if how else {}
        with pytest.raises(errors.PlannerError) as told:
            ep.plan(PROBLEM, name, **options)
        message = str(told.value)
        assert file in message and words in message and f"{name!r} failed" in message
        assert "\n" not in message
        assert type(told.value.__cause__).__name__ == words.partition(":")[0]
    # what a planner says itself is passed on
    with pytest.raises(errors.NoPathError, match=r"^a river"):
        ep.plan(PROBLEM, "fly", how="no way")
    with pytest.raises(errors.InvalidInputError, match=r"^how is fast; give a name"):
        ep.plan(PROBLEM, "fly", how="fast")


def test_a_mistake_in_the_library_itself_is_no_plugins(monkeypatch):
    def broken(*given, **options):
        raise ZeroDivisionError("ours")

    monkeypatch.setattr("energyplan.planning.search.planner.compiled", broken)
    with pytest.raises(ZeroDivisionError):
        ep.plan(PROBLEM, effort=100)


def test_a_planner_whose_package_is_absent_says_so(monkeypatch):
    ours = ("ompl", "energyplan.planning.ompl")
    for name in [name for name in sys.modules if name.startswith(ours)]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "ompl", None)
    with pytest.raises(errors.MissingDependencyError, match="needs the package ompl; install"):
        ep.plan(PROBLEM, "rrtstar", effort=100)
    assert ep.plan(PROBLEM, effort=5000).energy == pytest.approx(1808.0)
