"""The one step along an arc: where a motion of constant curvature leads."""

from __future__ import annotations

from math import cos, sin

from energyplan.compilation import inner
from energyplan.path import Pose


@inner
def chord_factor(dtheta: float) -> float:
    """Length of the chord of an arc, in units of the arc's length."""
    half = 0.5 * dtheta
    return sin(half) / half if half != 0.0 else 1.0


@inner
def arc_end(pose: Pose, ds: float, dtheta: float) -> Pose:
    """Return where the motion ends that turns by `dtheta` over the arc length `ds`.

    Parameters
    ----------
    pose : Pose
        Where it starts. The arc is that of the point whose position the pose is.
    ds, dtheta : float
        Signed arc length [m] and signed turn [rad].

    Returns
    -------
    Pose
        The end; the yaw is the sum of the turns, not wrapped.
    """
    middle = pose.yaw + 0.5 * dtheta
    chord = ds * chord_factor(dtheta)
    return Pose(pose.x + chord * cos(middle), pose.y + chord * sin(middle), pose.yaw + dtheta)
