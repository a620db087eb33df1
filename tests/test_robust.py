"""Numerical traps, and runs that end early."""

from __future__ import annotations

import math
import os
import signal
import subprocess
import sys
import textwrap
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

import energyplan as ep
from energyplan import Pose, PowerModel, simulate
from energyplan.errors import EnergyPlanError
from energyplan.io.files import atomic_write
from energyplan.path import wrap_angle

MODEL = PowerModel.preset("quadriga:full:concrete")
COST = ep.EnergyCost(MODEL)
ICR = MODEL.vehicle.icr
HALF = ICR.half_track


# -- speeds and curvatures ----------------------------------------------------------------------


@pytest.mark.parametrize("tiny", [0.0, 5e-324, 1e-300, 1e-160, 1e-30])
def test_power_of_vanishing_speeds_vanishes(tiny: float) -> None:
    motion = ep.Motion(np.array([tiny, -tiny]), np.array([tiny, tiny]), ICR)
    power = MODEL.power(motion)
    assert np.all(np.isfinite(power))
    assert_allclose(power, 0.0, atol=1e-25)


def test_spin_is_the_limit_of_tight_arcs_from_either_side() -> None:
    """Curvature passes through infinity where the turn radius changes its sign."""
    radius = np.array([-1e-3, -1e-9, -1e-300, 0.0, 1e-300, 1e-9, 1e-3])
    turn = np.full(radius.shape, 1.0)
    energy = COST.segment_energy(radius * turn, turn)
    spin = COST.segment_energy([0.0], [1.0])[0]
    assert_allclose(energy, spin, rtol=1e-12)


def test_straight_motion_is_the_limit_of_gentle_arcs() -> None:
    turn = np.array([-1e-9, -1e-16, -1e-320, 0.0, 1e-320, 1e-16, 1e-9])
    energy = COST.segment_energy(np.full(turn.shape, 2.0), turn)
    assert_allclose(energy, COST.segment_energy([2.0], [0.0])[0], rtol=1e-8)


def test_arcs_of_vanishing_turn_end_where_straight_lines_do() -> None:
    for turn in (0.0, 1e-320, 1e-16, 1e-12, -1e-9):
        end = ep.Path(Pose(1.0, 2.0, 0.3), ds=[3.0], dtheta=[turn]).end
        assert_allclose(end, [1 + 3 * math.cos(0.3), 2 + 3 * math.sin(0.3), 0.3], atol=1e-8)


def test_profiles_of_spins_and_of_reversals_are_finite_and_come_to_rest() -> None:
    shapes = {
        "spin": ([0.0], [math.pi]),
        "there and back": ([1.0, -1.0], [0.0, 0.0]),
        "both spins": ([0.0, 0.0], [1.0, -1.0]),
        "pivots": ([HALF, -HALF], [1.0, 1.0]),
    }
    for name, (ds, dtheta) in shapes.items():
        path = ep.Path(Pose(0, 0, 0), ds=ds, dtheta=dtheta)
        timed = ep.speed.profile(path, MODEL)
        for channel in (timed.t, timed.x, timed.y, timed.yaw, timed.v, timed.omega):
            assert np.all(np.isfinite(channel)), name
        assert timed.v[-1] == pytest.approx(0.0, abs=1e-9), name
        assert timed.omega[-1] == pytest.approx(0.0, abs=1e-9), name
        report = ep.check(timed, MODEL)
        assert math.isfinite(report.energy), name


# -- headings -----------------------------------------------------------------------------------


@pytest.mark.parametrize("turns", [-3, -1, 1, 2, 1000])
def test_whole_turns_of_a_heading_do_not_matter(turns: int) -> None:
    start, goal = (0.0, 0.0, 3.1), (1.0, 0.4, -3.1)
    plain = ep.steering.energy(start, goal, COST)
    turned = ep.steering.energy(start, (1.0, 0.4, -3.1 + 2 * math.pi * turns), COST)
    assert turned == pytest.approx(plain, rel=1e-9)


def test_a_log_whose_heading_jumps_by_whole_turns_is_the_same_log() -> None:
    log = simulate.drive(MODEL, "spiral", duration=60.0, power_noise=5.0, seed=2)
    columns = dict(log.channels)
    wrapped = ep.DriveLog.from_columns({**columns, "yaw": wrap_angle(columns["yaw"])})
    plain = ep.identify(ep.DriveLog.from_columns(columns), MODEL.vehicle)
    jumped = ep.identify(wrapped, MODEL.vehicle)
    assert_allclose(jumped.model.coefficients, plain.model.coefficients, rtol=1e-6)
    assert_allclose(jumped.icr.left, plain.icr.left, rtol=1e-6)


# -- empty and degenerate input -----------------------------------------------------------------


def test_start_at_the_goal_takes_nothing() -> None:
    hall = ep.OccupancyGrid(np.zeros((40, 40), bool), resolution=0.1)
    plan = ep.plan(ep.PlanningProblem(hall, COST, (2, 2, 1), (2, 2, 1)), effort=50_000)
    assert plan.energy == 0.0
    assert plan.lower_bound == 0.0
    assert math.isfinite(plan.gap)
    told = ep.compare(ep.PlanningProblem(hall, COST, (2, 2, 1), (2, 2, 1)), effort=50_000)
    assert told.saving == 0.0


# -- runs that end early ------------------------------------------------------------------------


def test_a_run_that_is_killed_while_it_writes_leaves_the_old_file_whole(tmp_path: Path) -> None:
    """The writer is stopped between its last byte and the moment the file takes its place."""
    file = tmp_path / "model.yaml"
    atomic_write(file, "as it was\n")
    script = textwrap.dedent(
        f"""
        import os, signal
        from energyplan.io.files import atomic_write
        os.fsync = lambda handle: os.kill(os.getpid(), signal.SIGKILL)
        atomic_write({str(file)!r}, "half a file" * 1000)
        """
    )
    done = subprocess.run([sys.executable, "-c", script], check=False)
    assert done.returncode == -signal.SIGKILL
    assert file.read_text() == "as it was\n"


def test_a_write_that_fails_leaves_neither_a_change_nor_a_rest(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    file = tmp_path / "model.yaml"
    atomic_write(file, "as it was\n")
    monkeypatch.setattr("os.fsync", full)
    with pytest.raises(EnergyPlanError, match=r"model\.yaml.*No space left"):
        atomic_write(file, "new")
    assert file.read_text() == "as it was\n"
    assert [path.name for path in tmp_path.iterdir()] == ["model.yaml"]


def test_ctrl_c_ends_a_command_with_one_line_and_leaves_its_file(tmp_path: Path) -> None:
    """A real process gets a real signal while it works."""
    out = tmp_path / "model.yaml"
    out.write_text("as it was\n")
    script = textwrap.dedent(
        f"""
        import os, signal, sys, time
        from energyplan import cli
        from energyplan.io import logs

        # a background job inherits that the signal is ignored
        signal.signal(signal.SIGINT, signal.default_int_handler)

        def read_recording(*_, **__):
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(60)

        logs.read_recording = read_recording
        sys.argv = "energyplan identify a.csv --vehicle quadriga --out".split() + [{str(out)!r}]
        cli.main()
        """
    )
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=False
    )
    assert done.returncode == 130
    assert done.stdout == ""
    assert done.stderr == "energyplan: interrupted; no file is half written\n"
    assert out.read_text() == "as it was\n"


def test_ctrl_c_while_the_program_still_starts_is_clean() -> None:
    script = textwrap.dedent(
        """
        import signal, sys

        class Interrupting:
            def find_spec(self, name, path, target=None):
                if name == "energyplan.cli":
                    signal.raise_signal(signal.SIGINT)

        signal.signal(signal.SIGINT, signal.default_int_handler)
        sys.meta_path.insert(0, Interrupting())
        from energyplan.__main__ import main
        main()
        """
    )
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=False
    )
    assert done.returncode == 130
    assert done.stderr == "energyplan: interrupted; no file is half written\n"


# -- odd surroundings ---------------------------------------------------------------------------


PLANNED = r"""
from dataclasses import replace
import numpy as np
import energyplan as ep
model = replace(ep.PowerModel.preset("quadriga:full:concrete"), name="gro\u00df \u2603")
again = ep.read_model(ep.write_model(model, "model.yaml"))
hall = ep.OccupancyGrid(np.zeros((60, 60), bool), 0.1)
problem = ep.PlanningProblem(hall, ep.EnergyCost(again), (2, 3, 0), (4, 2, 1))
print(ep.plan(problem, effort=200).path.ds.tobytes().hex(), again.name == model.name)
"""


@pytest.mark.parametrize(
    "optimised", ["0", pytest.param("2", marks=pytest.mark.nightly)]
)  # the latter compiles every module of every library anew
def test_a_plan_does_not_depend_on_where_and_how_python_runs(
    optimised: str, tmp_path: Path
) -> None:
    """No asserts or docstrings, warnings as errors, another time zone, a locale of bytes."""
    odd = {
        "PYTHONOPTIMIZE": optimised, "PYTHONWARNINGS": "error", "TZ": "Pacific/Chatham",
        "LC_ALL": "C", "PYTHONCOERCECLOCALE": "0", "PYTHONUTF8": "0",
    }  # fmt: skip
    folder = tmp_path / "a folder of mine ☃"
    folder.mkdir()
    told = [
        subprocess.run(
            [sys.executable, "-c", PLANNED],
            cwd=folder,
            env=os.environ | more,
            capture_output=True,
            text=True,
            timeout=300,
        )
        for more in ({}, odd)
    ]
    assert [one.stderr for one in told] == ["", ""]
    assert told[0].stdout.endswith(" True\n")
    assert told[0].stdout == told[1].stdout
