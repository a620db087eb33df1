"""Robots of the foreign simulation: what they say of the package, and their own soundness."""

from __future__ import annotations

import importlib
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from by_day import by_day

sys.path.append(str(Path(__file__).resolve().parents[2] / "benchmarks"))
foreign = importlib.import_module("foreign")


@pytest.mark.parametrize("seed", by_day([7_700_000, 7_700_002, 7_700_006, 7_700_010], [7_700_002]))
def test_runs_that_hide_nothing_are_sound_whatever_an_average_hands_on(seed: int) -> None:
    said = foreign.said_of(seed, "nothing")
    assert said.right
    assert not said.false
    assert said.verdict != "unexplained"
    assert said.within


def test_a_foreign_log_is_what_its_body_does() -> None:
    machine = replace(foreign.Machine.drawn(np.random.default_rng(1)), noise=0.0, sides=True)
    log = foreign.driven(machine, "nothing", 1.0, np.random.default_rng(2), "one")
    kinetic = 0.5 * machine.mass * (0.5 * (log.channel("v_left") + log.channel("v_right"))) ** 2
    drawn = float(log.weights @ log.power)
    assert drawn > float(np.ptp(kinetic))
    again = foreign.driven(machine, "nothing", 1.0, np.random.default_rng(2), "one")
    assert np.array_equal(again.power, log.power)


@pytest.mark.parametrize(
    ("cause", "names", "right", "false"),
    [
        ("nothing", (), True, False),
        ("nothing", ("surface_border",), False, True),
        ("slope", ("towing_force",), True, False),
        ("viscous_copper", ("copper_loss", "air_drag"), False, False),
        ("drift", ("hotel_load",), False, True),
    ],
)
def test_names_are_right_near_or_false(
    cause: str, names: tuple[str, ...], right: bool, false: bool
) -> None:
    said = foreign.Said(1, cause, names, "effect_found", 0.1, 0.1, True, 1.0)
    assert (said.right, said.false) == (right, false)
    assert "robots" in foreign.report([said])


@pytest.mark.parametrize("seed", by_day([8_800_000, 8_800_002, 8_800_004], [8_800_002]))
def test_a_name_next_to_the_cause_explains_no_dependence_that_is_left(seed: int) -> None:
    """Friction rises with the load of the outer side, and is named as one by slip speed."""
    said = foreign.said_of(seed, "transfer")
    assert said.names
    assert said.verdict == "unexplained"


def test_a_load_that_the_catalogue_has_is_found() -> None:
    said = foreign.said_of(8_800_003, "hotel")
    assert (said.verdict, said.names) == ("effect_found", ("hotel_load",))
