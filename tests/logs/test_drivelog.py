"""Drive logs: what is refused, what is mended and counted, and parts that keep the energy."""

from __future__ import annotations

import gzip
import json
import pickle
import re
import subprocess
import sys

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.signal import savgol_filter

from energyplan.errors import DriveLogError, MissingChannelError
from energyplan.logs import DriveLog, tables
from energyplan.logs.align import derivative, find_offset
from energyplan.logs.mapping import UNITS, parse_columns
from energyplan.power import PowerModel
from energyplan.power.effects import ANGULAR_INERTIA, GRADE, LINEAR_INERTIA
from energyplan.simulate import Setpoint, drive, identification_drive
from energyplan.vehicle import TreadICR


@pytest.fixture(scope="module")
def model():
    return PowerModel.preset("quadriga:full:concrete")


@pytest.fixture(scope="module")
def noisy(model):
    """A drive with the noise of real sensors."""
    return identification_drive(model, power_noise=5.0, speed_noise=0.005, seed=1)


@pytest.fixture
def raw(noisy):
    """Its channels, free to spoil."""
    return {name: values.copy() for name, values in noisy.channels.items()}


def write(tmp_path, text):
    file = tmp_path / "drive.csv"
    file.write_text(text)
    return file


# -- reading ------------------------------------------------------------------------------------


def test_lines_are_counted_across_pieces(tmp_path, monkeypatch):
    monkeypatch.setattr(tables, "_CHUNK", 7)
    rows = [f"{k},1,1,5,{'word' if k == 33 else k}" for k in range(40)]
    file = write(tmp_path, "\n".join([HEAD.strip() + ",mine", *rows]) + "\n")
    log = DriveLog.read(file)
    assert_array_equal(log.t, np.arange(40.0))
    assert "columns of text are left out: mine" in log.warnings
    with pytest.raises(DriveLogError, match="line 35: 'mine' is 'word'"):
        DriveLog.read(file, "slope=mine")
    rows[20] = "19,1,1,6,0"
    (aside,) = DriveLog.read(write(tmp_path, "\n".join([HEAD.strip() + ",mine", *rows]))).set_aside
    assert (aside.count, aside.where) == (2, "line 21, line 22")


def test_every_unit_is_a_positive_multiple_of_the_first():
    for channel, units in UNITS.items():
        assert next(iter(units.values())) == 1.0
        for unit in units:
            column = parse_columns({channel: f"name[{unit}]"})[channel]
            assert column.conversion.factor > 0
            assert parse_columns({channel: f"name[-{unit}]"})[channel].conversion.factor < 0
    fahrenheit = parse_columns("temperature=T[degF]")["temperature"].conversion
    assert 212.0 * fahrenheit.factor + fahrenheit.offset == pytest.approx(100.0)


@pytest.mark.parametrize(
    ("columns", "words"),
    [
        ("v_left", "CHANNEL=COLUMN"),
        ("v_left=", "CHANNEL=COLUMN"),
        ("yaw=a[deg", "CHANNEL=COLUMN"),
        ("yaw=a[m/s]", "rad, deg"),
        ("yaw=a,yaw=b", "twice"),
        ("v_left=a[*zero]", "factor"),
        ("v_left=a[*0]", "factor"),
        ("mine=a[deg]", "factor"),
        ("v_left=nowhere", "columns are t,"),
        ("v_left=w[rpm]", "wheel radius"),
        ("v_left=enc[counts]", r"metres per count with it, as in .*\[ticks\*0.0001\]"),
    ],
)
def test_bad_mappings_are_refused(noisy, columns, words):
    with pytest.raises(DriveLogError, match=words):
        DriveLog.read(noisy.to_frame(), columns)


HEAD = "t,v_left,v_right,power\n"


def test_truncated_and_exploding_gzip_are_refused(tmp_path):
    text = (HEAD + "".join(f"{k},1,1,5\n" for k in range(20000))).encode()
    cut = tmp_path / "cut.csv.gz"
    cut.write_bytes(gzip.compress(text)[:-40])
    with pytest.raises(DriveLogError, match="sound gzip"):
        DriveLog.read(cut)
    bomb = tmp_path / "bomb.csv.gz"
    bomb.write_bytes(gzip.compress(HEAD.encode() + b"1,1,1,5\n" * (1 << 21)))
    assert bomb.stat().st_size < 1 << 17
    too_much = pytest.raises(DriveLogError, match="more than 1 MiB")
    with tables.unpacked_at_most(1 << 20), too_much:
        DriveLog.read(bomb)


def test_text_and_lists_in_parquet_are_named_and_left_unread(tmp_path):
    """A few kilobytes that stand for three gigabytes of text, or of numbers in a list."""
    pa = pytest.importorskip("pyarrow")
    pq = pytest.importorskip("pyarrow.parquet")
    rows, file = 3000, tmp_path / "drive.parquet"
    one = pa.array(np.ones(rows))
    word = pa.DictionaryArray.from_arrays(np.zeros(rows, int), pa.array(["x" * 1_000_000]))
    ends = pa.array(np.arange(rows + 1))
    columns = {
        "t": pa.array(np.arange(rows) * 0.1), "v_left": one, "v_right": one, "power": one,
        "word": word, "list": pa.ListArray.from_arrays(ends, one),
        "whole": pa.array(range(rows)), "none": pa.nulls(rows),
        "gear": pa.DictionaryArray.from_arrays(np.zeros(rows, int), pa.array([1.5])),
    }  # fmt: skip
    pq.write_table(pa.table(columns), file, compression="zstd", store_schema=False)
    assert file.stat().st_size < 1 << 17
    table = tables.read_table(file, DriveLogError)
    assert set(table.columns) == set(columns) - {"word", "list"}
    assert table.columns["whole"][-1] == rows - 1
    assert np.all(table.columns["gear"] == 1.5)
    assert np.all(np.isnan(table.columns["none"]))
    assert len(DriveLog.read(file).t) == rows
    with pytest.raises(DriveLogError, match=r"row 1: 'word' is of type string, which is no number"):
        DriveLog.read(file, "power=word")
    with pytest.raises(DriveLogError, match=r"'list' is of type list"):
        DriveLog.read(file, "power=list")


DAMAGE = """
import sys, pyarrow as pa, pyarrow.parquet as pq
from pathlib import Path
from energyplan.logs.tables import read_table
from energyplan.errors import DriveLogError
file = Path(sys.argv[1])
pq.write_table(pa.table({"t": [0.0, 1.0], "x": [2.0, None]}), file)
sound, refused = file.read_bytes(), 0
for place in range(len(sound) - 900, len(sound)):
    for bits in (1, 255):
        damaged = bytearray(sound)
        damaged[place] ^= bits
        file.write_bytes(damaged)
        try:
            read_table(file, DriveLogError)
        except DriveLogError:
            refused += 1
print(refused)
"""


def test_damage_to_what_parquet_says_of_itself_never_ends_the_process(tmp_path):
    """Some of pyarrow's functions end it; that is only seen from outside."""
    pytest.importorskip("pyarrow")
    command = [sys.executable, "-c", DAMAGE, str(tmp_path / "damaged.parquet")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert int(done.stdout) > 500


def test_parquet_of_absurd_size_is_refused(tmp_path):
    pa = pytest.importorskip("pyarrow")
    pq = pytest.importorskip("pyarrow.parquet")
    file = tmp_path / "drive.parquet"
    pq.write_table(pa.table({"t": np.random.default_rng(1).normal(size=1000)}), file)
    too_much = pytest.raises(DriveLogError, match=r"holds more than 0 MiB")
    with tables.unpacked_at_most(7000), too_much:
        DriveLog.read(file)
    too_many = pytest.raises(DriveLogError, match="1000 rows of 1 columns")
    with tables.unpacked_at_most(tables.MAX_BYTES, 999), too_many:
        DriveLog.read(file)


def test_absurdly_wide_and_long_tables_are_refused(tmp_path):
    with pytest.raises(DriveLogError, match="5001 columns"):
        DriveLog.read(write(tmp_path, "a," * 5000 + "\n"))
    with pytest.raises(DriveLogError, match="line 1 is longer"):
        DriveLog.read(write(tmp_path, "column," * 1_000_000))
    with pytest.raises(DriveLogError, match="line longer than 1024 KiB"):
        DriveLog.read(write(tmp_path, HEAD + "1," * 1_000_000))
    too_many = pytest.raises(DriveLogError, match="more than 10 rows")
    with tables.unpacked_at_most(tables.MAX_BYTES, 40), too_many:
        DriveLog.read(write(tmp_path, HEAD + "".join(f"{k},1,1,5\n" for k in range(11))))


# -- cleaning -----------------------------------------------------------------------------------


def test_unusable_rows_are_counted_not_lost_in_silence(raw):
    raw["v_left"][5] = np.nan
    raw["p_right"][[9, 11]] = np.inf
    raw["p_left"][40] = 1e9
    raw["x"][20:25] = np.nan
    raw["temperature"] = np.full(len(raw["t"]), np.nan)
    log = DriveLog.from_columns(raw, "drive")
    told = {item.reason: (item.count, item.where) for item in log.set_aside}
    assert told == {
        "p_right is outside -50000 to 50000 W; blanked": (2, "sample 9, sample 11"),
        "p_left is outside -50000 to 50000 W; blanked": (1, "sample 40"),
        "v_left has no usable reading; left out": (1, "sample 5"),
        "p_right has no usable reading; left out": (2, "sample 9, sample 11"),
        "p_left has no usable reading; left out": (1, "sample 40"),
        "x has no usable reading; interpolated": (5, "sample 20, sample 21, sample 22, ..."),
    }
    assert len(log) == len(raw["t"]) - 4
    assert any("temperature is left out: 100%" in warning for warning in log.warnings)


def test_short_holes_are_bridged_across_the_turn_of_yaw(raw, noisy):
    raw["yaw"] = np.angle(np.exp(1j * raw["yaw"]))
    raw["yaw"][1::2] = np.nan
    log = DriveLog.from_columns(raw)
    error = np.angle(np.exp(1j * (log.channels["yaw"] - noisy.channels["yaw"][: len(log)])))
    assert np.abs(error).max() < 0.01


def test_repeated_rows_are_set_aside(raw):
    twice = {name: np.repeat(values, 2) for name, values in raw.items()}
    log = DriveLog.from_columns(twice)
    assert [item.count for item in log.set_aside] == [len(raw["t"])]
    assert_array_equal(log.t, raw["t"])


def test_gaps_are_reported_and_never_bridged(raw):
    raw["t"][1000:] += 30.15
    log = DriveLog.from_columns(raw)
    assert len(log.runs) == 2
    assert any("1 gap" in warning and "30.2 s" in warning for warning in log.warnings)
    whole = float(np.trapezoid(log.power, raw["t"]))
    bridge = 15.1 * (log.power[999] + log.power[1000])
    assert log.energy == pytest.approx(whole - bridge)
    assert log.duration == pytest.approx(150.0 - 0.05)


# -- plausibility -------------------------------------------------------------------------------


@pytest.mark.parametrize("pattern", ["straight", "spin", "spiral", "figure8", "survey"])
@pytest.mark.parametrize("preset", ["quadriga:full:marble", "quadriga:empty:concrete"])
def test_every_pattern_passes_without_a_warning(preset, pattern):
    # The inner motor generates in wide arcs, yet nothing has the wrong sign.
    model = PowerModel.preset(preset)
    for seed, gap in enumerate((0.0, 0.0, 0.0, 20.0)):
        log = drive(model, pattern, power_noise=5.0, speed_noise=0.005, seed=seed)
        t = log.t + gap * (log.t > 0.4 * log.duration)
        assert len(DriveLog.from_columns({**log.channels, "t": t}).warnings) == (gap > 0.0)


def test_descending_with_regeneration_is_no_wrong_sign(model):
    heavy = model.with_term(GRADE, 147.0)
    log = drive(heavy, [Setpoint(0.6, 0.6, 20.0)], slope=-0.3, power_noise=2.0)
    assert log.energy < 0
    again = DriveLog.from_columns(log.channels)
    assert again.energy == log.energy


@pytest.mark.parametrize("channel", ["yaw_rate", "yaw", "power"])
@pytest.mark.parametrize("delay", [-0.5, -0.1, 0.1, 0.33, 1.5])
def test_clock_offsets_are_stated_and_can_be_mended(model, channel, delay):
    heavy = model.with_term(LINEAR_INERTIA, 150.0).with_term(ANGULAR_INERTIA, 13.0)
    delayed = ("p_left", "p_right") if channel == "power" else (channel,)
    late = identification_drive(
        heavy, power_noise=5.0, speed_noise=0.005, seed=3, delays=dict.fromkeys(delayed, delay)
    )
    log = DriveLog.from_columns(late.channels)
    told = [warning for warning in log.warnings if warning.startswith(f"{channel} l")]
    assert len(told) == 1
    found = float(re.search(rf"shifted\({channel}=(\S+)\)", told[0]).group(1))
    assert -found == pytest.approx(delay, abs=0.025)  # half a sample
    mended = log.shifted(**{channel: found})
    assert mended.warnings == ()
    assert DriveLog.from_columns(mended.channels).warnings == ()
    assert sum(item.count for item in mended.set_aside) == pytest.approx(abs(delay) * 20, abs=2)


def test_offset_finder_on_a_known_shift_across_gaps():
    rng = np.random.default_rng(5)
    t = np.concatenate([np.arange(0, 60, 0.05), 100 + np.arange(0, 40, 0.05)])
    smooth = np.convolve(rng.standard_normal(len(t) + 400), np.hanning(81), "same")[200:-200]
    runs = [slice(0, 1200), slice(1200, len(t))]
    late = np.empty_like(smooth)
    for run in runs:
        late[run] = 3.0 + np.interp(t[run] - 0.37, t[run], smooth[run])
    offset = find_offset("it", t, late, [smooth], runs)
    assert offset.seconds == pytest.approx(0.37, abs=0.005)
    assert offset.explained > 0.999
    assert offset.certain


# -- the log itself -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"t": None}, "'t' is missing"),
        ({"p_left": None}, "power is missing"),
        ({"v_left": [0.0, 1.0]}, "shape"),
        ({"v_left": [0.0, np.nan, 1.0]}, "not finite at sample 1"),
        ({"t": [0.0, 2.0, 1.0]}, "at sample 2: 1 s follows 2 s"),
    ],
)
def test_unsound_channels_are_refused(change, words):
    sound = {name: [0.0, 1.0, 2.0] for name in ("t", "v_left", "v_right", "p_left", "p_right")}
    spoiled = {name: value for name, value in {**sound, **change}.items() if value is not None}
    with pytest.raises(DriveLogError, match=words):
        DriveLog(spoiled)


def test_channels_are_read_only_and_survive_pickling(noisy):
    with pytest.raises(ValueError, match="read-only"):
        noisy.channels["t"][0] = 1.0
    for log in (noisy, DriveLog.from_columns(noisy.channels, "checked")):
        again = pickle.loads(pickle.dumps(log))
        assert_array_equal(again.power, log.power)
        assert again.name == log.name
    with pytest.raises(MissingChannelError, match="yaw_rate"):
        noisy.channel("humidity")


def test_power_from_sides_total_and_battery(model):
    sides, total, battery = (
        identification_drive(model, measured=how) for how in ("sides", "total", "battery")
    )
    assert (sides.battery_side, total.battery_side, battery.battery_side) == (False, False, True)
    assert total.sides is None
    assert_allclose(total.power, sides.power)
    assert_allclose(battery.power, sides.power)


def test_segments_and_blocks_partition_the_log(noisy):
    part = noisy.segment(10.0, 20.0)
    assert part.name.endswith("from 10 to 20 s")
    dated = DriveLog({**noisy.channels, "t": noisy.t + 1.7e9}, "dated")
    begin = float(dated.t[0])
    assert dated.segment(begin + 10, begin + 20).name == "dated from 10 to 20 s"
    assert part.t[0] == 10.0
    assert part.t[-1] == pytest.approx(19.95)
    blocks = noisy.blocks(10.0)
    assert len(blocks) == 15
    assert_array_equal(np.concatenate([block.t for block in blocks]), noisy.t)
    with pytest.raises(DriveLogError, match="covers 0 to 150 s"):
        noisy.segment(200.0, 300.0)
    with pytest.raises(DriveLogError, match="positive"):
        noisy.blocks(0.0)


def test_blocks_respect_gaps_and_hold_every_sample(raw):
    raw["t"][501:] += 10.0
    raw["t"][502:] += 10.0  # sample 501 stands alone
    log = DriveLog.from_columns(raw)
    for duration in (0.01, 0.1, 3.0, 1e6):
        blocks = log.blocks(duration)
        assert_array_equal(np.concatenate([block.t for block in blocks]), log.t)
        crossing = [block for block in blocks if len(block.runs) > 1]
        assert len(crossing) == 1
        assert 501 * 0.05 + 10 in crossing[0].t


def test_resampling_keeps_energy_distance_and_gaps(raw):
    raw["t"] = raw["t"] + 0.01 * np.sin(np.arange(len(raw["t"])))  # uneven samples
    raw["t"][1500:] += 8.0
    log = DriveLog.from_columns(raw)
    coarse = log.resample(0.3)
    means = 0.3 * coarse.power.sum()
    ends = sum(item.count for item in coarse.set_aside)
    assert 0 < ends <= 2 * 6
    assert means == pytest.approx(log.energy, rel=5e-3)
    assert np.diff(coarse.t).max() > 8.0
    exact = log.segment(0.0, 75.0)
    k = 100
    inside = (exact.t > coarse.t[k] - 0.15) & (exact.t < coarse.t[k] + 0.15)
    edges = np.sort(np.concatenate([coarse.t[k] + [-0.15, 0.15], exact.t[inside]]))
    integral = np.trapezoid(np.interp(edges, exact.t, exact.power), edges)
    assert coarse.power[k] == pytest.approx(integral / 0.3)


def test_resampling_battery_logs_averages_power(model):
    log = identification_drive(model, measured="battery", noise={"voltage": 1.0})
    coarse = log.resample(1.0)
    assert coarse.power.sum() == pytest.approx(log.energy, rel=1e-9)
    with pytest.raises(DriveLogError, match="positive"):
        log.resample(-1.0)
    with pytest.raises(DriveLogError, match="longer period"):
        log.resample(1e-9)
    with pytest.raises(DriveLogError, match="two are needed"):
        log.resample(140.0)


def test_derivative_is_savitzky_golay_on_even_samples():
    rng = np.random.default_rng(0)
    t, values = 0.1 * np.arange(200), rng.standard_normal(200)
    expected = savgol_filter(values, 7, 2, deriv=1, delta=0.1, mode="interp")
    assert_allclose(derivative(t, values, [slice(0, 200)], 0.6), expected, atol=1e-12)


def test_derivative_is_exact_for_parabolas_on_uneven_samples_and_within_runs():
    rng = np.random.default_rng(1)
    t = np.cumsum(rng.uniform(0.01, 0.2, 300))
    values = 3 + 2 * t - 0.5 * t**2
    values[150:] += 100.0
    runs = [slice(0, 150), slice(150, 298), slice(298, 300)]
    rate = derivative(t, values, runs, 1.0)
    assert_allclose(rate[:298], 2 - t[:298], atol=1e-9)
    chord = np.diff(values[298:]) / np.diff(t[298:])
    assert_allclose(rate[298:], [chord[0]] * 2)


def test_derivative_survives_times_that_all_but_coincide():
    t = np.array([0.0, 1e-15, 2e-15, 1.0, 2.0])
    assert np.all(np.isfinite(derivative(t, t, [slice(0, 5)], 1.0)))


def test_accelerations_are_those_of_the_drive(model):
    log = identification_drive(model, speed_noise=0.005, seed=2)
    motion = log.motion(model.vehicle.icr)
    truth = log.channels["accel_x"]  # level ground
    error = motion.channel("accel") - truth
    plain = np.gradient(motion.v, log.t) - truth
    assert error.std() < 0.6 * plain.std()
    kept = DriveLog({**log.channels, "accel": truth}).motion(TreadICR.symmetric(0.5))
    assert_array_equal(kept.channel("accel"), truth)


# -- recorded drives ----------------------------------------------------------------------------


@pytest.mark.shared
def test_drives_of_another_engine_pass_the_checks(shared_data):
    for file in sorted((shared_data / "quadriga_mujoco").glob("*_s2_ident.csv.gz")):
        log = DriveLog.read(file)
        assert log.warnings == (), file.name
        assert log.set_aside == (), file.name
        truth = json.loads(file.with_name(file.name.replace(".csv.gz", ".json")).read_text())
        measured = truth["energy_J"]["measured_power_integral"]
        assert log.energy == pytest.approx(measured, rel=2e-3), file.name
