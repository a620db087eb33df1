"""What a regression makes of drives, piece by piece, against sums and integrals by hand."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from numpy.testing import assert_allclose

from energyplan.errors import DriveLogError, InvalidInputError
from energyplan.fit import drive as drives
from energyplan.fit.contacts import preload
from energyplan.fit.drive import Drive, SampleTimes, prepared
from energyplan.fit.estimate import Problem
from energyplan.fit.regressors import DesignMatrix, linearise_drive
from energyplan.logs import DriveLog
from energyplan.motion import Motion
from energyplan.power import HOTEL, SLIP, TRACTION, PowerModel, Sides, Term, effects

MODEL = PowerModel.preset("quadriga:full:concrete")
ICR = MODEL.vehicle.icr


def drive(n: int = 400, period: float = 0.05, seed: int = 1, gap: bool = False, **more: object):
    """A drive over some seconds at random speeds, with a gap of the clock in its middle."""
    rng = np.random.default_rng(seed)
    t = period * np.arange(n)
    if gap:
        t[n // 2 :] += 3.0
    left, right, power, between, slope = rng.normal(size=(5, n))
    motion = Motion(left, right, ICR, {"slope": 0.1 * slope})
    return Drive("drive", t, motion, power, between=between, **more)


def test_weights_integrate_every_run_by_itself() -> None:
    one = drive(gap=True)
    values = np.sin(one.t)
    by_hand = sum(np.trapezoid(values[s], one.t[s]) for s in (slice(0, 200), slice(200, 400)))
    assert one.weights @ values == pytest.approx(by_hand)
    assert [(s.start, s.stop) for s in one.runs] == [(0, 200), (200, 400)]


@pytest.mark.parametrize("delay", [0.37, -0.22])
def test_a_late_log_shows_what_was_before_within_each_run(delay: float) -> None:
    one = drive(gap=True, late=drives.Late(delay))
    table = np.column_stack([one.power, 2.0 * one.power])
    shown = one.seen(table)
    for run in (slice(0, 200), slice(200, 400)):
        # np.interp holds the first and the last value beyond the ends
        by_hand = np.interp(one.t[run] - delay, one.t[run], one.power[run])
        assert_allclose(shown[run], np.column_stack([by_hand, 2.0 * by_hand]), atol=1e-12)


def test_a_lag_is_that_of_the_differential_equation() -> None:
    """``lag dy/dt = x - y`` from rest, for x that is linear between samples; by fine steps."""
    t, lag, fine = 0.1 * np.arange(60), 0.35, 400
    values = np.random.default_rng(2).normal(size=60)
    x = np.interp(np.arange(59 * fine + 1) * 0.1 / fine, t, values)
    y, step = np.empty_like(x), 0.1 / fine
    y[0] = values[0]
    for k in range(len(x) - 1):
        middle = y[k] + 0.5 * step * (x[k] - y[k]) / lag
        y[k + 1] = y[k] + step * (0.5 * (x[k] + x[k + 1]) - middle) / lag
    assert_allclose(SampleTimes(t).lagged(values, lag), y[::fine], atol=1e-6)
    both = SampleTimes(t).lagged(np.column_stack([values, -values]), lag)
    assert_allclose(both, np.column_stack([y, -y])[::fine], atol=1e-6)
    alone = SampleTimes(np.append(t, t[-1] + 60.0)).lagged(np.append(values, 7.0), lag)
    assert_allclose(alone, np.append(y[::fine], 7.0), atol=1e-6)
    one = drive(gap=True, late=drives.Late(0.0, lag))
    shown = one.seen(one.power)
    assert_allclose(shown[200:], SampleTimes(one.t[200:]).lagged(one.power[200:], lag))


@pytest.mark.parametrize("truth", [-0.73, 0.0, 0.41, 1.4])
def test_the_least_delay_is_found_to_a_fraction_of_a_step(truth: float) -> None:
    found = drives.least_late(lambda late: (late.mean - truth) ** 2 + late.lag, 0.0, 0.05)
    assert found.lag == 0.0
    assert found.delay == pytest.approx(min(truth, drives.DELAYS[-1]), abs=0.01)


def test_windows_are_means_over_their_time() -> None:
    t = 0.1 * np.arange(245)
    values = np.random.default_rng(3).normal(size=(245, 2))
    for length in drives.SCALES:
        cut = drives.Windows.of(t, length)
        edges = [*cut.starts, len(t)]
        count = round(t[-1] / length)  # the last one, if short, joins its neighbour
        assert len(cut.starts) == count
        for k in range(count):
            inside = (t >= k * length - 1e-9) & ((t < (k + 1) * length - 1e-9) | (k == count - 1))
            at = np.flatnonzero(inside)
            assert abs(edges[k] - at[0]) <= 1  # times at an edge are rounded either way
            mine = values[edges[k] : edges[k + 1]]
            assert_allclose(cut.mean(values)[k], mine.mean(axis=0))
            assert cut.counts[k] == len(mine)
            assert cut.blocks[k] == min(
                int(t[edges[k]] / drives.BLOCK + 1e-9), round(t[-1] / drives.BLOCK) - 1
            )


def test_way_and_time_of_a_prepared_log() -> None:
    t = 5.0 + 0.1 * np.arange(200)
    speed = np.where(np.arange(200) < 100, 0.5, -0.5)
    columns = {"t": t, "v_left": speed, "v_right": speed, "p_left": 3.0 + t, "p_right": 7.0 - t}
    one = Drive.of(DriveLog(columns, "straight"), MODEL.vehicle)
    assert one.t[0] == 0.0
    assert one.motion.channels["distance"][-1] == pytest.approx(0.5 * 19.9, abs=0.06)
    assert_allclose(one.between, 4.0 - 2.0 * t)
    assert_allclose(one.power, 10.0)
    assert drives.channels_of([one, one.with_channels(x=t)]) == set(one.motion.channels)
    few = one.thinned(3)
    assert_allclose(few.t, one.t[::3])
    assert_allclose(few.between, (4.0 - 2.0 * t)[::3])
    assert_allclose(few.motion.channels["distance"], one.motion.channels["distance"][::3])


def test_short_logs_are_refused_and_long_ones_thinned(monkeypatch: pytest.MonkeyPatch) -> None:
    def log(seconds: float) -> DriveLog:
        t = np.linspace(0.0, seconds, round(50 * seconds) + 1)
        return DriveLog({"t": t, "v_left": 0 * t + 0.4, "v_right": 0 * t + 0.4, "power": t}, "log")

    drives.check_long_enough([log(16.0)])
    drives.check_long_enough([log(4.0), log(7.9), log(4.1)])
    with pytest.raises(DriveLogError, match=r"log, log: 15\.9 s are too short.* give 16 s or more"):
        drives.check_long_enough([log(8.0), log(7.9)])
    with pytest.raises(DriveLogError, match=r"log: 3\.9 s are too short.* give 4 s or more"):
        drives.check_long_enough([log(30.0), log(3.9)])
    with pytest.raises(DriveLogError, match="too short to learn from, or to judge by"):
        drives.split_drives([log(30.0)])
    with pytest.raises(InvalidInputError, match="no logs"):
        drives.split_drives([])
    learned, judged = drives.split_drives([log(40.0), log(30.0), log(20.0)])
    assert [round(one.duration) for one in learned] == [24, 30]
    assert [round(one.duration) for one in judged] == [16, 20]
    assert [len(d.t) for d in prepared([log(20.0)] * 2, MODEL.vehicle)] == [1001, 1001]
    monkeypatch.setattr(drives, "_MANY", 1001)
    assert [len(d.t) for d in prepared([log(20.0)] * 2, MODEL.vehicle)] == [501, 501]
    monkeypatch.setattr(drives, "_MANY", 1)  # four samples are kept in half a second
    # every sixth of 50 Hz, since seven would be longer than an eighth of a second
    assert [len(d.t) for d in prepared([log(20.0)], MODEL.vehicle)] == [167]


def designed(lengths: list[int]) -> DesignMatrix:
    made = [drive(n, 0.1, seed) for seed, n in enumerate(lengths)]
    columns = [np.random.default_rng(9).normal(size=(n, 2, 3)) for n in lengths]
    targets = [np.random.default_rng(8).normal(size=(n, 2)) for n in lengths]
    return DesignMatrix.of(made, columns, targets)


@pytest.mark.parametrize(
    ("lengths", "comparable"),
    [
        ([160] * 4, True),
        ([160] * 3, False),
        ([640, 160, 160, 160], False),
        ([320, 160, 160, 160], True),
    ],
)
def test_folds_are_whole_drives_where_these_compare(lengths: list[int], comparable: bool) -> None:
    design = designed(lengths)
    assert design.comparable is comparable
    blocks = sum(lengths) // 80
    folds = design.with_folds(100)
    assert len(folds.drives) == (4 if comparable else blocks)
    few = design.with_folds(2)
    assert len(few.drives) == 2
    assert_allclose(few.grams.sum(axis=1), design.grams.sum(axis=1))
    if comparable:
        assert folds.drives.tolist() == [0, 1, 2, 3]


@pytest.mark.parametrize(
    "loss",
    [(effects.COPPER_LOSS, 2e-4), (effects.DRIVE_LOSS, 0.2), (effects.REGENERATION_LOSS, 0.5)],
)
@pytest.mark.parametrize("battery", [False, True])
def test_derivatives_are_differences_of_the_power(battery: bool, loss: tuple[Term, float]) -> None:
    """Of a total, in turns and on straights; the vehicle's own losses count at the battery."""
    vehicle = replace(MODEL.vehicle, drive_efficiency=0.8, regen_efficiency=0.6)
    rng = np.random.default_rng(6)
    left, right = rng.uniform(0.1, 1.0, size=(2, 60))
    right[:20] = left[:20]
    one = Drive("one", 0.1 * np.arange(60), Motion(left, right, ICR), np.ones(60), battery)
    terms, values = (SLIP, TRACTION, HOTEL, loss[0]), np.array([0.6, 110.0, 30.0, loss[1]])
    here = linearise_drive(one, vehicle, terms, values)
    for k, value in enumerate(values):
        step = 1e-5 * value * np.eye(4)[k]
        more, less = (linearise_drive(one, vehicle, terms, values + s, ()) for s in (step, -step))
        assert more.columns.shape == (60, 1, 0)
        slope = (more.power - less.power) / (2e-5 * value)
        assert_allclose(here.columns[:, :, k], slope, rtol=1e-3, atol=1e-3 * np.abs(slope).max())
    # the model itself, where nothing holds
    model = PowerModel(vehicle, terms, values)
    whole = model.battery_side() if battery else model
    assert_allclose(here.power[20:, 0], whole.power(one.motion)[20:])


@pytest.mark.parametrize("speed", [0.5, -0.4])
@pytest.mark.parametrize("copper", [0.0, 3e-4])
def test_what_contacts_hold_is_told_by_the_difference_of_the_sides(
    speed: float, copper: float
) -> None:
    """A constant moment on a straight. Sides draw ``F v + c F^2``, ``F = K -+ M / track``."""
    moment, limit, n = 60.0, 200.0, 80
    v, pull = np.full(n, speed), np.full(n, 110.0 * np.sign(speed))
    push = moment / ICR.slip_track
    left, right = pull - push, pull + push
    between = (right - left) * v + copper * (right**2 - left**2)
    one = Drive("one", 0.05 * np.arange(n), Motion(v, v, ICR), 0 * v, between=between)
    losses = [(effects.COPPER_LOSS, copper)] if copper else []
    found = preload(one, between, MODEL.vehicle, losses, Sides(pull, pull), limit)
    assert_allclose(found.moment, moment, rtol=1e-3)
    assert_allclose(found.forces.right, push, rtol=1e-3)
    assert_allclose(found.forces.left, -push, rtol=1e-3)
    rise_of_total = 2 * copper * (right - left)
    rise_of_difference = 2 * speed + 2 * copper * (right + left)
    falls = found.followed(np.full((n, 1), 2.0), np.ones(1))[:, 0]
    assert_allclose(falls, 2.0 * rise_of_total / rise_of_difference, atol=1e-4)
    # no more than friction allows, and then it follows no coefficient
    most = preload(one, between, MODEL.vehicle, losses, Sides(pull, pull), 30.0)
    assert_allclose(most.moment, 30.0, rtol=1e-3)
    assert_allclose(most.followed(np.ones((n, 1)), np.zeros(1)), 0.0)


def wandering(n: int, period: float = 0.01, gap: float = 0.0) -> Drive:
    """A drive at random speeds, with a gap of the clock after a third of its samples."""
    left, right, power, between = np.random.default_rng(n).normal(size=(4, n))
    t = period * np.arange(n)
    t[n // 3 :] += gap
    yaw = np.angle(np.exp(1j * (3.0 + 0.8 * t)))  # a full turn every eight seconds, wrapped
    motion = Motion(left, right, MODEL.vehicle.icr, {"yaw": yaw, "distance": t**2})
    return Drive("drive", t, motion, power, between=between)


def test_means_are_those_of_samples_between_gaps() -> None:
    whole = wandering(250, gap=5.0)
    few = whole.averaged(0.1)
    # ten samples each, but the last ones before the gap and at the end: 83 and 167 samples
    edges = [*range(0, 83, 10), *range(83, 250, 10), 250]
    assert len(few.t) == 9 + 17
    for part, (a, b) in enumerate(pairwise(edges)):
        assert few.t[part] == pytest.approx(whole.t[a:b].mean())
        assert few.power[part] == pytest.approx(whole.power[a:b].mean())
        assert few.motion.v_right[part] == pytest.approx(whole.motion.v_right[a:b].mean())
    assert few.between is not None
    assert_allclose(np.exp(1j * few.motion.channels["yaw"]), np.exp(1j * (3.0 + 0.8 * few.t)))
    for _ in range(2):
        whole = whole.averaged(0.019)
    assert whole.averaged(0.01) is whole  # it has no more samples than that


def test_an_excerpt_is_of_so_many_drives_and_samples() -> None:
    whole = Problem([wandering(1500, period=0.1) for _ in range(30)], MODEL.vehicle)
    assert whole.excerpt(45_000, 30) is whole
    assert len(whole.excerpt(45_000, 10).drives) == 10
    few = whole.excerpt(20_000, 30)
    assert len(few.drives) == 30
    assert sum(len(one.t) for one in few.drives) == pytest.approx(20_000, rel=0.2)
    # drives that follow the same pattern show all of it together
    shown = np.unique(np.concatenate([one.t for one in few.drives]))
    assert_allclose(shown, whole.drives[0].t)
