"""Tread ICRs from a spin, from any log with yaw, from any log with pose (private).

Wheel speeds and yaw are both noisy, so neither may serve as an exact regressor. Both are compared
over whole increments through an instrument: the difference of the tread speeds around, but not
at, each instant, which knows the manoeuvre and not the noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from energyplan.errors import NotIdentifiableError
from energyplan.logs import DriveLog
from energyplan.path import FloatArray
from energyplan.vehicle import TreadICR

_LEAST_TURNING = 1.0  # total yaw of a log from which an ICR can be estimated [rad]

_WINDOW = 200  # samples over which the noise of increments is judged

_LARGEST_ERROR = 0.25
"""Standard error of a slip track over it; beyond, what wheelbase and track predict is better."""

_LEAST_GRIP = 0.05
"""Measured turning over what the wheels say; below, the wheels do not drive the body."""


@dataclass(frozen=True)
class ICREstimate:
    """Tread ICRs identified from logs."""

    icr: TreadICR  # the tread ICRs
    covariance: FloatArray  # (3, 3): covariance of left, right and longitudinal [m^2]
    turning: float  # total yaw of the logs [rad]
    source: str  # what it comes from

    @property
    def std_error(self) -> dict[str, float]:
        """Standard error of left, right and longitudinal [m]."""
        error = np.sqrt(np.maximum(np.diag(self.covariance), 0.0))
        return dict(zip(("left", "right", "longitudinal"), map(float, error), strict=True))


@dataclass(frozen=True)
class _Increments:
    """Sums over the time between neighbouring samples."""

    dt: FloatArray
    difference: FloatArray  # integral of V_r - V_l [m]
    mean: FloatArray  # integral of (V_l + V_r)/2 [m]
    yaw: FloatArray  # change of yaw [rad]
    forward: FloatArray  # body-frame displacement [m]; zero without a pose
    sideways: FloatArray
    around: FloatArray  # instrument of the difference [m/s]
    along: FloatArray  # instrument of the mean [m/s]


def yaw_channel(logs: Sequence[DriveLog]) -> str | None:
    """Name the channel of the logs that measures the yaw or its rate, or None."""
    there = [name for name in ("yaw", "yaw_rate") if any(log.has(name) for log in logs)]
    alive = [
        name for name in there
        if any(log.has(name) and np.ptp(log.channels[name]) > 0.0 for log in logs)
    ]  # fmt: skip
    return next(iter([*alive, *there]), None)


def _neighbours(speed: FloatArray, period: float) -> FloatArray:
    """Mean speed around each increment, without the samples that it and its neighbours share."""
    reach = max(3, round(0.5 / period))
    kernel = np.ones(2 * reach + 1)
    kernel[reach - 1 : reach + 2] = 0.0
    if len(speed) < len(kernel):
        return np.full(len(speed), speed.mean())
    return np.asarray(
        np.convolve(speed, kernel, "same") / np.convolve(np.ones(len(speed)), kernel, "same")
    )


def _increments(log: DriveLog, channel: str, pose: bool) -> _Increments:
    dt = np.diff(log.t)
    left, right = log.channels["v_left"], log.channels["v_right"]

    def between(values: FloatArray) -> FloatArray:
        return 0.5 * (values[1:] + values[:-1])

    difference, mean = between(right - left), between(0.5 * (left + right))
    values = log.channels[channel]
    change = np.diff(np.unwrap(values)) if channel == "yaw" else between(values) * dt
    forward = sideways = np.zeros(len(dt))
    if pose:
        heading = between(np.unwrap(log.channels["yaw"]))
        dx, dy = np.diff(log.channels["x"]), np.diff(log.channels["y"])
        forward = np.cos(heading) * dx + np.sin(heading) * dy
        sideways = np.cos(heading) * dy - np.sin(heading) * dx
    period = float(np.median(dt))
    found = _Increments(
        dt, difference * dt, mean * dt, change, forward, sideways,
        _neighbours(difference, period), _neighbours(mean, period),
    )  # fmt: skip
    parts: dict[str, FloatArray] = vars(found)
    good = np.all([np.isfinite(value) for value in parts.values()], axis=0) & (dt < 3 * period)
    return _Increments(**{name: value[good] for name, value in parts.items()})


def _stack(logs: Sequence[DriveLog], channel: str, pose: bool) -> tuple[_Increments, list[slice]]:
    parts = [_increments(log, channel, pose) for log in logs]
    stops = np.cumsum([len(part.dt) for part in parts])
    pieces = [slice(int(a), int(b)) for a, b in zip([0, *stops[:-1]], stops, strict=True)]
    joined = {
        name: np.concatenate([getattr(part, name) for part in parts])
        for name in vars(parts[0])
    }  # fmt: skip
    return _Increments(**joined), pieces


def turned(logs: Sequence[DriveLog], icr: TreadICR) -> bool:
    """Return whether the yaw shows the robot turning as its wheels say, however slipping."""
    channel = yaw_channel(logs)
    if channel is None:
        return True
    data, _ = _stack([log for log in logs if log.has(channel)], channel, pose=False)
    return _turns(data, icr)


def _turns(data: _Increments, icr: TreadICR) -> bool:
    way = np.sign(data.around)
    wheels = float(way @ data.difference) / icr.slip_track
    return not (wheels > _LEAST_TURNING and float(way @ data.yaw) < _LEAST_GRIP * wheels)


def fit_icr(
    logs: DriveLog | Sequence[DriveLog], prior: TreadICR, *, asymmetric: bool | None = None
) -> ICREstimate:
    """Identify tread ICRs from any logs with yaw or yaw rate."""
    # Source: Morales et al. (2010), Eq. 1 and 5; docs/theory, section 1.
    drives = [logs] if isinstance(logs, DriveLog) else list(logs)
    channel = yaw_channel(drives)
    drives = [log for log in drives if channel and log.has(channel)]
    if channel is None:
        raise NotIdentifiableError(
            "the tread ICRs cannot be identified: no log has a channel yaw or yaw_rate; "
            "record one, or measure a spin's angle for icr_from_spin"
        )
    posed = channel == "yaw" and all(log.has("x") and log.has("y") for log in drives)
    if asymmetric and not posed:
        raise NotIdentifiableError(
            "left, right and longitudinal tread ICR cannot be separated without the channels x, "
            "y and yaw; record a pose, or ask for symmetric ICRs"
        )
    pose = posed if asymmetric is None else asymmetric
    data, pieces = _stack(drives, channel, pose)
    turning = float(np.abs(np.sign(data.around) @ data.yaw)) if len(data.dt) else 0.0
    if turning < _LEAST_TURNING or not _turns(data, prior):
        raise NotIdentifiableError(
            f"the tread ICRs cannot be identified: by {channel} the robot turned through "
            f"{turning:.2f} rad only; add a spin of several turns, wheels on the ground"
        )
    nuisance = data.dt if channel == "yaw_rate" else None
    equations = [_Equation(data.difference, nuisance, np.ones_like(data.dt))]
    if pose:
        equations.append(_Equation(data.forward - data.mean, data.mean, data.along))
        equations.append(_Equation(data.sideways, data.mean, data.along))
    value, variance = zip(*(_instrumented(eq, data, pieces) for eq in equations), strict=True)
    # The equations see different noise: that of the speeds' difference, of their mean, of the pose.
    covariance = np.diag(np.pad(np.array(variance), (0, 3 - len(variance))))
    if not np.sqrt(variance[0]) <= _LARGEST_ERROR * value[0]:
        raise NotIdentifiableError(
            f"the tread ICRs cannot be identified: by {channel} the slip track is {value[0]:.3g} "
            f"+- {np.sqrt(variance[0]):.2g} m; log speeds and yaw more often, or add a spin of "
            "several turns"
        )
    track, shift = value[0], value[1] if pose else 0.5 * (prior.left - prior.right)
    ahead = -value[2] if pose else prior.longitudinal
    turn = np.array([[0.5, 1.0, 0.0], [0.5, -1.0, 0.0], [0.0, 0.0, -1.0]])
    icr = TreadICR(0.5 * track + shift, 0.5 * track - shift, ahead)
    return ICREstimate(icr, turn @ covariance @ turn.T, turning, "pose" if pose else channel)


@dataclass(frozen=True)
class _Equation:
    """``target = slope * dyaw + factor * nuisance``."""

    target: FloatArray
    nuisance: FloatArray | None
    instrument: FloatArray


def _instrumented(
    equation: _Equation, data: _Increments, pieces: Sequence[slice]
) -> tuple[float, float]:
    """Slope by instrumental variables, and its variance."""
    regressors, instruments = [data.yaw], [data.around]
    if equation.nuisance is not None:
        regressors.append(equation.nuisance)
        instruments.append(equation.instrument)
    X, Z = np.column_stack(regressors), np.column_stack(instruments)
    scale = np.sqrt(np.einsum("ij,ij->j", Z, Z)), np.sqrt(np.einsum("ij,ij->j", X, X))
    product = Z.T @ X
    if len(regressors) == 2:
        unit = product / np.maximum(np.outer(*scale), 1e-300)
        if abs(np.linalg.det(unit)) < 0.02:  # one manoeuvre throughout: the nuisance shows nowhere
            X, Z, product = X[:, :1], Z[:, :1], product[:1, :1]
    inverse = np.linalg.inv(product)
    solution = inverse @ (Z.T @ equation.target)
    residual = equation.target - X @ solution
    return float(solution[0]), _variance(Z @ inverse[0], residual, pieces)


def _variance(weight: FloatArray, residual: FloatArray, pieces: Sequence[slice]) -> float:
    """Variance of the weighted sum of an autocorrelated residual."""
    # Errors of a yaw cancel from one increment to the next, all but completely. Sums over windows
    # are positive whatever comes.
    length = min(_WINDOW, max(len(residual) // 10, 1))
    sums = (np.convolve(weight[s] * residual[s], np.ones(length)) for s in pieces)
    return sum(float(part @ part) for part in sums) / length


def icr_from_spin(
    log: DriveLog, angle: float | None = None, angle_error: float = 0.0
) -> ICREstimate:
    """Symmetric tread ICR from a spin on the spot (Eq. 5)."""
    # Source: Morales et al. (2010), Eq. 5.
    channel = yaw_channel([log])
    if angle is None and channel is None:
        raise NotIdentifiableError(
            f"{log.name}: the log has neither yaw nor yaw_rate; give the angle turned through"
        )
    speeds = {"yaw_rate": np.zeros(len(log)), **log.channels}
    source = DriveLog({**speeds}, log.name) if channel is None else log
    data = _increments(source, channel or "yaw_rate", pose=False)
    way = np.sign(data.around)
    travel = 0.5 * float(way @ data.difference)
    drift = float(np.abs(way * data.mean).sum())
    if travel <= 0 or drift > 0.2 * travel:
        raise NotIdentifiableError(
            f"{log.name}: no spin on the spot: the treads went {travel:.2f} m against and "
            f"{drift:.2f} m with each other; cut the spin out, or take the log for "
            "any drive (fit_icr, icr without --spin)"
        )
    turning = float(way @ data.yaw) if angle is None else float(angle)
    if turning < _LEAST_TURNING:
        raise NotIdentifiableError(
            f"{log.name}: the robot turned through {turning:.2f} rad only; spin for several turns"
        )
    C = travel / turning
    if angle is None:
        residual = 0.5 * data.difference - C * data.yaw
        variance = _variance(way / turning, residual, [slice(0, len(residual))])
    else:
        variance = (C * angle_error / turning) ** 2
    covariance = np.zeros((3, 3))
    covariance[:2, :2] = variance
    return ICREstimate(TreadICR.symmetric(C), covariance, turning, "spin")
