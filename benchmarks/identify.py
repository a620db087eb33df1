"""Speed and quality of identification, batch and online.

``python benchmarks/identify.py [samples]`` times the exact fit of Eq. 7 against Nelder-Mead on the
same log, the whole identification with its standard errors, and one sample online.
``python benchmarks/identify.py --quality`` counts how often intervals hold the truth, how long a
change of surface takes to be found, and false alarms.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable

import numpy as np

from energyplan import simulate
from energyplan.fit import identify, solvers
from energyplan.fit.doubts import linearise
from energyplan.fit.online import OnlineIdentifier
from energyplan.logs import DriveLog
from energyplan.power import PowerModel
from energyplan.simulate import Setpoint

MARBLE = PowerModel.preset("quadriga:empty:marble")
CONCRETE = PowerModel.preset("quadriga:empty:concrete")
MIXED = [
    Setpoint(0.7, 0.7, 1.0), Setpoint(0.6, 0.1, 1.0), Setpoint(0.7, 0.7, 1.0),
    Setpoint(-0.5, 0.5, 1.0), Setpoint(0.5, 0.7, 1.0), Setpoint(0.1, 0.7, 1.0),
]  # fmt: skip


def drive(samples: int) -> DriveLog:
    """Noisy drive of that many samples at 20 Hz."""
    return simulate.drive(
        CONCRETE, ["survey", "stop_and_go", "spiral"], duration=samples / 20.0, power_noise=10.0,
        speed_noise=0.005, correlation_time=1.0, seed=1,
    )  # fmt: skip


def best_of(work: Callable[[], object], repeats: int = 3) -> float:
    """Shortest of a few runs, after one that compiles [s]."""
    work()
    spans = []
    for _ in range(repeats):
        start = time.perf_counter()
        work()
        spans.append(time.perf_counter() - start)
    return min(spans)


def fits(log: DriveLog) -> None:
    """Time the fits of Eq. 7 on one log, and the whole identification."""
    design = linearise(CONCRETE, log.motion(CONCRETE.vehicle.icr)).columns[:, 0]
    power, bounds = log.power, solvers.Bounds(np.zeros(2), np.array([2.0, np.inf]))

    def eq7(c: np.ndarray) -> float:
        return float(np.abs(power - design @ c).sum())

    def paper(c: np.ndarray) -> float:
        return float(np.abs(power - CONCRETE.with_coefficients(c).power(motion)).sum())

    motion = log.motion(CONCRETE.vehicle.icr)
    far = np.array([1.0, 50.0])
    exact = best_of(lambda: solvers.lad(design, power, bounds))
    rows = [
        ("exact linear program", exact, solvers.lad(design, power, bounds)),
        ("Nelder-Mead, columns at hand", best_of(lambda: solvers.simplex(eq7, far, bounds), 1),
         solvers.simplex(eq7, far, bounds)),
        ("Nelder-Mead, model evaluated", best_of(lambda: solvers.simplex(paper, far, bounds), 1),
         solvers.simplex(paper, far, bounds)),
        ("Huber", best_of(lambda: solvers.huber(design, power, bounds)),
         solvers.huber(design, power, bounds)),
    ]  # fmt: skip
    print(
        f"{len(log)} samples\n{'fit alone':32}{'time [s]':>10}{'ratio':>8}  sum of Eq. 7 less best"
    )
    best = min(eq7(c) for _, _, c in rows)
    for label, span, c in rows:
        print(f"{label:32}{span:10.3f}{span / exact:8.2f}  {eq7(c) / best - 1:.1e}")
    print(f"\n{'identify, errors and ICR':32}{'time [s]':>10}")
    for method in ("lad", "huber", "simplex"):
        span = best_of(lambda m=method: identify(log, CONCRETE.vehicle, method=m), 1)
        print(f"{method:32}{span:10.3f}")


def online(log: DriveLog) -> None:
    """Time online identification, sample by sample and over a log."""
    rows = list(
        zip(
            *(log.channel(c).tolist() for c in ("t", "v_left", "v_right")),
            log.power.tolist(),
            strict=True,
        )
    )[:40_000]

    def one_by_one() -> None:
        identifier = OnlineIdentifier(CONCRETE.vehicle)
        for row in rows:
            identifier.update(*row)

    part = log.segment(0.0, 2000.0)
    single = best_of(one_by_one) / len(rows)
    whole = best_of(lambda: OnlineIdentifier(CONCRETE.vehicle).run(part)) / len(part)
    print(f"\n{'online':32}{'per sample [us]':>16}")
    print(f"{'update, sample by sample':32}{1e6 * single:16.1f}")
    print(f"{'run, over a log':32}{1e6 * whole:16.1f}")


def coverage() -> None:
    """Count how often 95 % intervals (1.96 standard errors) hold the truth."""
    print("200 spirals of 60 s, noise 10 W a side and 0.005 m/s; share of intervals with the truth")
    print(f"{'correlation time [s]':24}{'method':8}{'mu':>8}{'K':>8}")
    for tau in (0.0, 0.3, 1.0, 2.0):
        for method in ("lad", "huber"):
            hits = np.zeros(2)
            for seed in range(200):
                log = simulate.drive(
                    CONCRETE, "spiral", power_noise=10.0, speed_noise=0.005, correlation_time=tau,
                    seed=seed,
                )  # fmt: skip
                found = identify(log, CONCRETE.vehicle, method=method).model
                error = np.abs(found.coefficients - CONCRETE.coefficients)
                hits += error < 1.96 * np.sqrt(np.diag(found.covariance))
            print(f"{tau:<24g}{method:8}{hits[0] / 200:8.3f}{hits[1] / 200:8.3f}")


def changes() -> None:
    """Time until a change of surface is found, and the error ten seconds after it."""
    print("\nmarble to concrete, 20 mixed drives, noise 5 W a side; ten seconds after the change")
    print(f"{'correlation time [s]':24}{'found':>6}{'median delay [s]':>18}{'worst [s]':>10}"
          f"{'median error mu, K':>22}")  # fmt: skip
    for tau in (0.0, 0.3, 0.5, 1.0):
        delays, errors = [], []
        for seed in range(20):
            log = simulate.drive(
                MARBLE, MIXED * 8, changes=[(60.0, CONCRETE)], seed=seed, correlation_time=tau,
                accel_limit=0.8, power_noise=5.0, speed_noise=0.005,
            )  # fmt: skip
            identifier = OnlineIdentifier(MARBLE.vehicle)
            identifier.run(log.segment(0.0, 60.0))
            delays += [change.t - 60.0 for change in identifier.run(log.segment(60.0, 70.0))][:1]
            errors.append(np.abs(identifier.model.coefficients / CONCRETE.coefficients - 1))
        mu, K = np.median(errors, axis=0)
        print(f"{tau:<24g}{len(delays):>6}{np.median(delays):18.2f}{max(delays):10.2f}"
              f"{100 * mu:16.1f} %{100 * K:5.1f} %")  # fmt: skip


def false_alarms() -> None:
    """Count changes reported in hours of driving on one surface."""
    print("\nfalse alarms in 8 hours on one surface at 20 Hz, with stops")
    for tau in (0.0, 0.5, 2.0):
        count = 0
        for seed in range(8):
            log = simulate.drive(
                CONCRETE, ["survey", "stop_and_go", "spiral", "rest"] * 10, duration=3600.0,
                seed=100 + seed, correlation_time=tau, power_noise=5.0, speed_noise=0.005,
            )  # fmt: skip
            count += len(OnlineIdentifier(CONCRETE.vehicle).run(log))
        print(f"correlation time {tau:g} s: {count}")


def main() -> None:
    """Print the tables."""
    if "--quality" in sys.argv[1:]:
        coverage()
        changes()
        false_alarms()
        return
    log = drive(int(sys.argv[1]) if len(sys.argv) > 1 else 1_000_000)
    fits(log)
    online(log)


if __name__ == "__main__":
    main()
