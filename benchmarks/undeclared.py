"""Kinds of effect that the catalogue does not have: what a diagnosis says of them.

    python benchmarks/undeclared.py COUNT FIRST [KIND...]    COUNT robots of each, from that seed on
    python benchmarks/undeclared.py COUNT FIRST engine [KIND...]    the physics engine drives them

A line a drive: the kind, the verdict, the noise and the residual, whether the residual is coloured,
the hold-out's error and energy error before and after, the effects with their probabilities, and
the channels that are named.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from calibration import robot

from energyplan import DriveLog, PowerModel, diagnose, simulate
from energyplan.path import FloatArray
from energyplan.physics import Engine, EngineRobot, Run, Sensors, State
from energyplan.power import Sides
from energyplan.vehicle import GRAVITY


class Seen:
    """A robot's noiseless drive: what a kind of effect depends on."""

    def __init__(self, drive: DriveLog, model: PowerModel, size: float) -> None:
        self.t, self.size, self.mass = drive.t, size, model.vehicle.mass
        self.left, self.right = drive.channel("v_left"), drive.channel("v_right")
        self.powers = Sides(drive.channel("p_left"), drive.channel("p_right"))
        self.x, self.y, self.yaw = (drive.channel(name) for name in ("x", "y", "yaw"))
        self.K = model.coefficient("traction_resistance")
        self.v = 0.5 * (self.left + self.right)
        self.span = float(self.t[-1])
        with np.errstate(divide="ignore", invalid="ignore"):
            self.forces = [
                np.where(abs(v) > 0.02, p / v, 0.0)
                for p, v in ((self.powers.left, self.left), (self.powers.right, self.right))
            ]

    def drag(self, force: FloatArray) -> Sides:
        """Return the power of a resistance on both sides."""
        return Sides(force * np.abs(self.left), force * np.abs(self.right))

    def body(self, force: FloatArray) -> Sides:
        """Return the power of a force against the body."""
        return Sides(0.5 * force * self.v, 0.5 * force * self.v)

    def way(self, speed: FloatArray) -> FloatArray:
        """Return the integral of a speed."""
        return np.asarray(np.cumsum(speed * np.diff(self.t, prepend=0.0)))

    def since_start(self, speed: FloatArray) -> FloatArray:
        """Return the time since a tread started or turned round."""
        sign = np.sign(speed)
        starts = np.concatenate([[False], (sign[1:] != sign[:-1]) & (sign[1:] != 0)])
        return self.t - np.maximum.accumulate(np.where(starts, self.t, -np.inf))


def swinging_payload(d: Seen) -> Sides:
    """Let a third of the robot swing on a cable of 0.7 m."""
    stiff, step = GRAVITY / 0.7, float(np.median(np.diff(d.t)))
    angle, rate, force = 0.0, 0.0, 0.0 * d.t
    for k, push in enumerate(np.gradient(d.v, d.t)):
        rate -= (push + stiff * angle + 0.4 * rate) * step
        angle += rate * step
        force[k] = -0.3 * d.size * d.mass * stiff * angle
    return d.body(force)


def gears_slip(d: Seen) -> Sides:
    """More loss beyond a power of a side."""
    limit = 0.6 * float(np.quantile(np.maximum(abs(d.powers.left), abs(d.powers.right)), 0.98))
    more = [d.size * np.clip(p - limit, 0.0, None) for p in (d.powers.left, d.powers.right)]
    return Sides(*more)


def tyres_warm(d: Seen) -> Sides:
    """Resistance that falls with the way."""
    return d.drag(-0.35 * d.size * d.K * (1 - np.exp(-d.way(abs(d.v)) / 30)))


def battery_sags(d: Seen) -> Sides:
    """All that is drawn grows with time."""
    more = 0.25 * d.size * d.t / d.span
    return Sides(more * np.maximum(d.powers.left, 0.0), more * np.maximum(d.powers.right, 0.0))


def stuck_caster(d: Seen) -> Sides:
    """Resistance just after each reversal."""
    return d.body(1.2 * d.size * d.K * np.exp(-d.since_start(d.v) / 0.6) * np.sign(d.v))


def cable(d: Seen) -> Sides:
    """Drag a cable by its length."""
    return d.body(0.15 * d.size * d.K * np.hypot(d.x - d.x[0], d.y - d.y[0]) * np.sign(d.v))


def turning_wind(d: Seen) -> Sides:
    """Turn the wind during the drive."""
    along = 5.0 * np.cos(d.yaw - 4.4 * d.t / d.span) + d.v
    return d.body(d.size * d.K / 25.0 * along * abs(along))


def late_brake(d: Seen) -> Sides:
    """Brakes that let go a second after each start."""
    drags = [1.5 * d.size * d.K * (d.since_start(v) < 1.0) * abs(v) for v in (d.left, d.right)]
    return Sides(*drags)


def dead_band(d: Seen) -> Sides:
    """Drivers that take more at small speeds."""
    most = 0.6 * d.size * d.K
    more = [most * np.exp(-((v / 0.15) ** 2)) * (abs(v) > 0.01) for v in (d.left, d.right)]
    return Sides(*more)


def computer(d: Seen) -> Sides:
    """Load the battery for a part of each period."""
    period = 17.0 * d.size
    on = 0.45 * d.K * (d.t % period < 0.4 * period)
    return Sides(on, on)


def rain(d: Seen) -> Sides:
    """All friction falls from some time on."""
    wet = -0.3 * d.size * np.clip((d.t - 0.4 * d.span) / 30.0, 0.0, 1.0)
    return Sides(wet * d.powers.left, wet * d.powers.right)


def backlash(d: Seen) -> Sides:
    """Knock at each start."""
    knocks = [1.8 * d.size * d.K * (d.since_start(v) < 0.5) * (v != 0.0) for v in (d.left, d.right)]
    return Sides(*knocks)


def bent_axle(d: Seen) -> Sides:
    """Drag at each turn of the left wheels."""
    radius = 0.2 * float(np.sqrt(d.mass / 83.0))
    turn = 1 + np.sin(d.way(d.left) / radius)
    return Sides(0.6 * d.size * d.K * turn * abs(d.left), 0.0 * d.right)


def full_battery(d: Seen) -> Sides:
    """Nothing is returned in the first half."""
    lost = [
        np.where(d.t < 0.5 * d.span, -np.minimum(p, 0.0), 0.0)
        for p in (d.powers.left, d.powers.right)
    ]
    return Sides(*lost)


def cold_bearing(d: Seen) -> Sides:
    """Run a bearing of the left side in."""
    return Sides(1.2 * d.size * d.K * np.exp(-d.t / 35.0) * abs(d.left), 0.0 * d.right)


def stripes(d: Seen) -> Sides:
    """Two floors in stripes of a metre or so."""
    return d.drag(0.5 * d.size * d.K * (np.floor(d.x / (0.8 + 0.6 * d.size)) % 2))


def hill(d: Seen) -> Sides:
    """Lay a ridge across the way that no slope channel shows."""
    at = d.x - float(np.median(d.x))
    climb = -0.2 * d.size * at / 2.25 * np.exp(-(at**2) / 4.5)
    return d.body(d.mass * GRAVITY * np.sin(climb * np.cos(d.yaw)))


def centripetal(d: Seen) -> Sides:
    """Tyres that rub where speed and yaw rate are large together."""
    return d.drag(2.0 * d.size * d.K * abs(d.v * (d.right - d.left)))


def tyre_leaks(d: Seen) -> Sides:
    """Let a left tyre lose its air."""
    return Sides(0.9 * d.size * d.K * (1 - np.exp(-d.t / 60.0)) * abs(d.left), 0.0 * d.right)


def gusts(d: Seen) -> Sides:
    """Blow in gusts of some seconds from one direction."""
    rng, step = np.random.default_rng(len(d.t)), float(np.median(np.diff(d.t)))
    wind, gust = 0.0 * d.t, 0.0
    for k in range(len(d.t)):
        gust += step / 5.0 * -gust + np.sqrt(2 * step / 5.0) * rng.normal()
        wind[k] = max(5.0 + 3.0 * gust, 0.0)
    along = wind * np.cos(d.yaw - 0.7) + d.v
    return d.body(d.size * d.K / 40.0 * along * abs(along))


def motors_heat(d: Seen) -> Sides:
    """Copper loss that grows with what has warmed the motors."""
    step, more = float(np.median(np.diff(d.t))), []
    usual = float(np.mean(np.square(d.forces)))
    for force in d.forces:
        warm, loss = 0.0, 0.0 * d.t
        for k, square in enumerate(force**2 / usual):
            warm += step / 40.0 * (square - warm)
            loss[k] = 0.12 * d.size * d.K * (1 + warm) * square
        more.append(loss)
    return Sides(*more)


def brake_sticks(d: Seen) -> Sides:
    """Hold the left brake until the robot first reverses."""
    freed = np.cumsum(d.left < -0.05) > 0
    return Sides(0.8 * d.size * d.K * ~freed * abs(d.left), 0.0 * d.right)


def regeneration_threshold(d: Seen) -> Sides:
    """Take nothing back below a power."""
    most = 0.5 * float(np.quantile(-np.minimum(d.powers.left, 0.0), 0.98))
    return Sides(
        *(np.where((p < 0) & (p > -most), -p, 0.0) for p in (d.powers.left, d.powers.right))
    )


def belt_slips(d: Seen) -> Sides:
    """Lose speed between motor and tread beyond a force."""
    limit = 0.5 * float(np.quantile(abs(np.concatenate(d.forces)), 0.98))
    more = [
        1.5 * d.size * np.clip(abs(f) - limit, 0.0, None) * abs(v)
        for f, v in zip(d.forces, (d.left, d.right), strict=True)
    ]
    return Sides(*more)


def wet_patch(d: Seen) -> Sides:
    """Lay a wet patch on the way, which dries."""
    middle = len(d.t) // 3
    away = np.hypot(d.x - d.x[middle], d.y - d.y[middle])
    less = -0.4 * d.size * np.exp(-((away / 2.0) ** 2) - d.t / 80.0)
    return Sides(less * d.powers.left, less * d.powers.right)


def resonance(d: Seen) -> Sides:
    """Drag of chains that swing at one speed."""
    at = 0.5 * float(np.quantile(abs(d.v), 0.95))
    force = d.size * d.K * np.exp(-(((abs(d.v) - at) / (0.15 * at)) ** 2))
    return d.drag(force)


def battery_resists(d: Seen) -> Sides:
    """Heat the battery by the square of all that is drawn."""
    total = d.powers.left + d.powers.right
    heat = 0.3 * d.size * total**2 / float(np.quantile(abs(total), 0.98))
    return Sides(0.5 * heat, 0.5 * heat)


def fan(d: Seen) -> Sides:
    """Cool the drivers while the robot moves, and ten seconds more."""
    moving = abs(d.left) + abs(d.right) > 0.02
    last = np.maximum.accumulate(np.where(moving, d.t, -np.inf))
    on = 0.25 * d.size * d.K * (d.t - last < 10.0)
    return Sides(on, on)


def mower(d: Seen) -> Sides:
    """Cut while driving ahead, where nothing was cut before."""
    cell = np.round(np.column_stack([d.x, d.y]) / 0.5).astype(int)
    known, fresh = set[tuple[int, int]](), np.zeros(len(d.t), bool)
    entered = (-1, -1)
    for k, here in enumerate(map(tuple, cell.tolist())):
        fresh[k] = here not in known or here == entered
        if here not in known:
            known.add(here)
            entered = here
    on = 0.4 * d.size * d.K * (fresh & (d.v > 0.02))
    return Sides(on, on)


def oil(d: Seen) -> Sides:
    """Shear grease by the root of the speed."""
    return Sides(*(0.6 * d.size * d.K * np.sqrt(abs(v) / 0.5) * abs(v) for v in (d.left, d.right)))


KINDS: tuple[Callable[[Seen], Sides], ...] = (
    swinging_payload, gears_slip, tyres_warm, battery_sags, stuck_caster, cable, turning_wind,
    late_brake, dead_band, computer, rain, backlash, bent_axle, full_battery, cold_bearing, stripes,
    hill, centripetal, tyre_leaks, gusts, motors_heat, brake_sticks, regeneration_threshold,
    belt_slips, wet_patch, resonance, battery_resists, fan, mower, oil,
)  # fmt: skip


def driven(kind: Callable[[Seen], Sides], seed: int) -> tuple[list[DriveLog], PowerModel]:
    """Return two drives of a random robot with that kind of effect."""
    rng = np.random.default_rng([seed, 77])
    model = robot(rng)
    size = float(rng.uniform(0.7, 1.3))
    total = bool(rng.random() < 0.5)
    rate = float(rng.choice([10.0, 20.0, 50.0]))
    noise = float(rng.uniform(0.01, 0.04)) * model.coefficient("traction_resistance")
    pose = {"yaw_rate": 0.005, "yaw": 0.005, "x": 0.01, "y": 0.01}
    logs = []
    for k, pattern in enumerate((simulate.IDENTIFICATION, simulate.VALIDATION)):
        parts = [(name, 1.2 * time) for name, time in pattern]
        clean = simulate.drive(model, parts, rate=rate, seed=2 * seed + k)
        more = kind(Seen(clean, model, size))
        log = simulate.drive(
            model, parts, rate=rate, seed=2 * seed + k, power_noise=noise, speed_noise=0.003,
            without={"accel_x"}, noise=pose,
        )  # fmt: skip
        channels = dict(log.channels)
        channels["p_left"] = channels["p_left"] + more.left
        channels["p_right"] = channels["p_right"] + more.right
        if total:
            channels["power"] = channels.pop("p_left") + channels.pop("p_right")
        logs.append(DriveLog(channels, f"{kind.__name__} {seed}, drive {k + 1}"))
    return logs, model


def engine_runs(seed: int) -> tuple[list[Run], PowerModel]:
    """Return two drives of a random robot in the physics engine."""
    model, runs = robot(np.random.default_rng([seed, 77])), []
    for k, pattern in enumerate((simulate.IDENTIFICATION, simulate.VALIDATION)):
        asked = simulate.drive(model, pattern, rate=20.0, seed=2 * seed + k)

        def follow(state: State, asked: DriveLog = asked) -> tuple[float, float] | None:
            if state.t > asked.t[-1]:
                return None
            left, right = (
                float(np.interp(state.t, asked.t, asked.channel(f"v_{side}")))
                for side in ("left", "right")
            )
            return left, right

        runs.append(Engine(EngineRobot.from_model(model)).drive(follow))
    return runs, model


def engine_driven(
    kind: Callable[[Seen], Sides], seed: int, runs: list[Run], model: PowerModel
) -> list[DriveLog]:
    """Add a kind of effect to what the engine's motors took."""
    rng = np.random.default_rng([seed, 78])
    size = float(rng.uniform(0.7, 1.3))
    noise = float(rng.uniform(0.01, 0.03)) * model.coefficient("traction_resistance")
    logs = []
    for k, run in enumerate(runs):
        names = ("t", "v_left", "v_right", "x", "y", "yaw")
        clean = DriveLog(
            {name: getattr(run, name) for name in names}
            | {"p_left": run.battery_left, "p_right": run.battery_right},
            "clean",
        )
        more = kind(Seen(clean, model, size))
        taken = replace(
            run, battery_left=run.battery_left + more.left,
            battery_right=run.battery_right + more.right,
        )  # fmt: skip
        sensors = Sensors(power_noise=noise, measured="sides" if rng.random() < 0.5 else "total",
                          without=("accel_x",), seed=2 * seed + k)  # fmt: skip
        logs.append(sensors.log(taken, f"{kind.__name__} {seed}, drive {k + 1}"))
    return logs


def main(count: int, first: int, names: list[str]) -> None:
    """Print what is said of each kind."""
    engine = names[:1] == ["engine"]
    names = names[engine:]
    driven_by = {seed: engine_runs(seed) for seed in range(first, first + count) if engine}
    for kind in KINDS:
        if names and kind.__name__ not in names:
            continue
        for seed in range(first, first + count):
            if engine:
                runs, model = driven_by[seed]
                logs = engine_driven(kind, seed, runs, model)
            else:
                logs, model = driven(kind, seed)
            told = diagnose(logs[0], logs[1], model.vehicle)
            left = told.adequacy
            effects = ", ".join(f"{one.name} {one.probability:.2f}" for one in told.effects)
            seen = "; ".join(f"{one.channel}: {one.shape}" for one in told.unexplained[:2])
            print(
                f"{kind.__name__:16} {seed} {told.verdict:12} noise {left.noise:.2g} "
                f"residual {left.residual:.2g}{' coloured' if left.coloured else ''} "
                f"rmse {told.before.rmse:.2g} -> {told.after.rmse:.2g} "
                f"energy {told.before.energy_error:+.1%} -> {told.after.energy_error:+.1%} "
                f"[{effects}] {seen}",
                flush=True,
            )


if __name__ == "__main__":
    if len(sys.argv) < 3:
        sys.exit(__doc__)
    main(int(sys.argv[1]), int(sys.argv[2]), sys.argv[3:])
