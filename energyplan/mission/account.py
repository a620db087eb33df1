"""What a mission's end tells of its way: drives, charges, the course of the charge, doubts."""

from __future__ import annotations

import numpy as np

from energyplan.mission.condition import Condition
from energyplan.mission.report import ChargerReport, Doubt, LegReport, Timeline
from energyplan.mission.simulation import Walk


def leg_reports(walk: Walk, end: Condition) -> tuple[LegReport, ...]:
    """Return the drives of a mission."""
    names, node, legs = walk.legs.names, walk.start.node, []
    for piece in end.pieces:
        if piece.leg is not None and piece.leg.trajectory is not None:
            legs.append(
                LegReport(
                    names[node], names[piece.goal], float(piece.t[0]), piece.leg.energy.mean,
                    piece.leg.trajectory, piece.soc, piece.soc_lower,
                )
            )  # fmt: skip
        node = piece.goal
    return tuple(legs)


def charger_reports(walk: Walk, end: Condition) -> tuple[ChargerReport, ...]:
    """Return how each charger is used."""
    found = []
    for node in walk.legs.chargers:
        visits = [p for p in end.pieces if p.kind == "charge" and p.goal == node]
        duration = sum(float(p.t[-1] - p.t[0]) for p in visits)
        energy = sum(float(-p.power[:-1] @ np.diff(p.t)) for p in visits)
        found.append(ChargerReport(walk.legs.names[node], len(visits), duration, energy))
    return tuple(found)


def timeline(walk: Walk, end: Condition) -> Timeline:
    """Return the mission over time."""
    columns: list[list[np.ndarray]] = [[] for _ in range(8)]
    for piece in end.pieces:
        drive = None if piece.leg is None else piece.leg.trajectory
        if drive is None:
            x, y, yaw = (np.full(len(piece.t), value) for value in walk.legs.poses[piece.goal])
        else:
            x, y, yaw = drive.x, drive.y, drive.yaw
        mirror = np.minimum(2 * piece.soc - piece.soc_lower, 1.0)
        parts = (piece.t, x, y, yaw, piece.power, piece.soc, piece.soc_lower, mirror)
        for column, part in zip(columns, parts, strict=True):
            column.append(part)
    return Timeline(*(np.concatenate(c) if c else np.zeros(0) for c in columns))


def doubts(walk: Walk, end: Condition) -> tuple[Doubt, ...]:
    """Tell what each unknown costs between the charges where the most is held back."""
    spent = max((*end.stretches, end.spent), key=lambda stretch: stretch.std)
    whole, quantile = spent.std, walk.quantile
    return tuple(
        Doubt(source, std, quantile * (whole - float(np.sqrt(max(whole**2 - std**2, 0.0)))))
        for source, std in walk.legs.grounds.by_source(spent).items()
    )
