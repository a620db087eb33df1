"""Friction found with the wheels in the air, against friction that the drive was made with."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import energyplan as ep
from energyplan import simulate
from energyplan.errors import InvalidInputError, NotIdentifiableError
from energyplan.fit.identification import doubts_off_the_ground, hoisted
from energyplan.logs import DriveLog

FORCE, SLOPE, AT = 40.0, 8.0, 0.6


def drive(rate: float = 50.0, seed: int = 1, inertia: float = 60.0) -> dict[str, np.ndarray]:
    """Four steady speeds with ramps between; encoders beat, and ramps take power for inertia."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, 48.0, 1.0 / rate)
    steady = np.array([0.3, 0.5, 0.7, 0.9])
    speed = np.interp(t % 12.0, [0.0, 1.0, 11.0, 12.0], [0.0, 1.0, 1.0, 0.0])
    speed = speed * steady[(t // 12.0).astype(int)]
    force = FORCE + SLOPE * (speed - AT) + inertia * np.gradient(speed, t)
    beat = 0.01 * np.sin(2 * np.pi * 8.0 * t)
    channels = {"t": t}
    for side, sign in (("left", 1.0), ("right", -1.0)):
        noise = rng.normal(0.0, 1.0, len(t))
        channels[f"v_{side}"] = sign * (speed + np.where(speed > 0.05, beat, 0.0))
        channels[f"p_{side}"] = force * speed + noise
        channels[f"current_{side}"] = sign * (force * (speed > 0.05) + 0.3 * noise) / 12.0
    return channels


@pytest.mark.parametrize("constant", [None, 12.0])
def test_friction_and_its_slope_are_found(constant: float | None) -> None:
    for found in hoisted(DriveLog(drive(), "hoisted"), constant):
        at_mean = FORCE + SLOPE * (found.speed - AT)
        assert found.force == pytest.approx(at_mean, rel=0.01)
        assert abs(found.force - at_mean) < 4 * found.force_error
        assert found.slope == pytest.approx(SLOPE, abs=max(4 * found.slope_error, 0.5))
        assert found.slope_error < 2.0
        assert found.left_out == 0
        for one in found.classes:
            assert one.force == pytest.approx(FORCE + SLOPE * (one.speed - AT), rel=0.02)


def test_readings_in_a_dead_band_are_counted_and_lie_below_it() -> None:
    channels = drive()
    dead = 3.2  # above the current at the slowest speed, below that at the others
    for side in ("left", "right"):
        reading = channels[f"current_{side}"]
        moving = np.abs(channels[f"v_{side}"]) > 0.05
        low = moving & (np.abs(reading) < dead)
        assert 0.1 < low.sum() / moving.sum() < 0.6
        channels[f"current_{side}"] = np.where(low, np.sign(reading) * dead, reading)
    plain = hoisted(DriveLog(drive(), "plain"), 12.0)
    for found, before in zip(hoisted(DriveLog(channels, "dead"), 12.0), plain, strict=True):
        assert found.left_out > 100
        assert found.force < before.force


def test_what_is_missing_is_named() -> None:
    channels = drive()
    with pytest.raises(InvalidInputError, match="there is no current_left"):
        hoisted(DriveLog({k: v for k, v in channels.items() if "current" not in k}, "x"), 12.0)
    still = {k: v if k == "t" else np.zeros_like(v) for k, v in channels.items()}
    with pytest.raises(NotIdentifiableError, match="the left side hardly turns"):
        hoisted(DriveLog(still, "still"))
    steady = (channels["t"] > 4.0) & (channels["t"] < 4.3)  # fifteen samples
    with pytest.raises(NotIdentifiableError, match="the left side hardly turns"):
        hoisted(DriveLog({k: v[steady] for k, v in channels.items()}, "short"))


def test_two_steady_speeds_give_the_line_through_their_means() -> None:
    """Without noise or ramps; each speed is a drive of its own."""
    logs = []
    for v, force, n in ((0.31, 40.0, 60), (0.58, 46.0, 30), (0.93, 44.0, 19)):
        t = 0.1 * np.arange(n)
        wave = 2.0 * np.sin(t * 9.0)
        sides = {"v_left": 0 * t + v, "v_right": 0 * t - v, "p_left": (force + wave) * v}
        logs.append(DriveLog({"t": t, **sides, "p_right": (force - wave) * v}, f"{v}"))
    left, right = hoisted(logs)
    for found, sign in ((left, 1.0), (right, -1.0)):
        parts = [(0.31, 40.0, 60), (0.58, 46.0, 30), (0.93, 44.0, 19)]
        v = np.concatenate([np.full(n, speed) for speed, _, n in parts])
        force = np.concatenate([f + sign * 2.0 * np.sin(0.9 * np.arange(n)) for _, f, n in parts])
        slope, at_mean = np.polyfit(v - v.mean(), force, 1)
        assert found.speed == pytest.approx(v.mean())
        assert found.force == pytest.approx(at_mean)
        assert found.slope == pytest.approx(slope)
        # both errors come from one variance; the last class has too few samples to be told
        sxx = np.sum((v - v.mean()) ** 2)
        assert found.slope_error / found.force_error == pytest.approx(np.sqrt(len(v) / sxx))
        assert [one.samples for one in found.classes] == [60, 30]
        for one, (speed, *_) in zip(found.classes, parts, strict=False):
            assert one.speed == pytest.approx(speed)
            assert one.force == pytest.approx(force[v == speed].mean())
            assert 0 < one.std_error < 2.0
    one_speed = hoisted(logs[0])[0]
    assert (one_speed.slope, one_speed.slope_error) == (0.0, np.inf)


def test_a_robot_in_the_air_need_not_turn_with_its_wheels() -> None:
    made = drive()
    rng = np.random.default_rng(2)
    still = {name: rng.normal(0.0, 0.01, len(made["t"])) for name in ("x", "y", "yaw", "yaw_rate")}
    made["p_left"] = made["p_left"].copy()
    made["p_left"][100] = np.nan
    log = DriveLog.from_columns({**made, **still}, "hoisted")
    assert any("yaw_rate hardly follows" in text for text in log.warnings)
    kept = doubts_off_the_ground(replace(log, warnings=(*log.warnings, "a column of text")))
    assert not any("yaw" in text or " x and y" in text for text in kept), kept
    assert "a column of text" in kept


@pytest.mark.parametrize("shown", [("yaw_rate",), ("yaw",), ("x", "y")])
def test_a_robot_that_drove_was_not_in_the_air(shown: tuple[str, ...]) -> None:
    """Slip and rolling were told as the friction inside."""
    model = ep.PowerModel.preset("quadriga:empty:marble")
    log = simulate.identification_drive(model, power_noise=5.0, speed_noise=0.005, seed=1)
    kept = {k: v for k, v in log.channels.items() if k not in ("x", "y", "yaw", "yaw_rate")}
    driven = DriveLog({**kept, **{name: log.channel(name) for name in shown}}, "driven")
    with pytest.raises(NotIdentifiableError, match=r"driven: .* the wheels were on the ground"):
        hoisted([DriveLog(drive(), "hoisted"), driven])
