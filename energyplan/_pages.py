"""The reports of the commands: which tables and pictures, in which order."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from matplotlib.figure import Figure

from energyplan import plots
from energyplan._html import number
from energyplan.effects._empirical import signal
from energyplan.motion import CHANNELS
from energyplan.path import wrap_angle
from energyplan.report import Page

if TYPE_CHECKING:
    from energyplan.diagnose import Diagnosis
    from energyplan.drivelog import DriveLog
    from energyplan.mission import MissionReport
    from energyplan.power import Residual


class Picture(NamedTuple):
    """A figure with a short name for files and a caption for readers."""

    name: str
    figure: Figure
    caption: str


def diagnosis_page(told: Diagnosis, holdout: Sequence[DriveLog]) -> Page:
    """Return the report of a diagnosis; `holdout` are the drives that it was judged on."""
    page = Page("Diagnosis of a power model")
    saved = 1 - told.after.rmse / told.before.rmse if told.before.rmse > 0 else 0.0
    page.paragraph(
        {
            "effect_found": f"The residual has a cause: {_names(told)}. With it, the error on "
            f"drives that were not fitted to falls by {100 * saved:.0f} %.",
            "no_effect": "No effect of the catalogue predicts these drives better than the paper's "
            "model alone.",
            "unexplained": "Part of the residual depends on a channel in a way that no effect of "
            "the catalogue explains.",
        }[told.verdict],
        "lead",
    )
    if told.effects:
        page.heading("Effects, in the order in which they were added")
        page.table(
            ("effect", "symbol", "value", "std. error", "unit", "p", "cannot be told from"),
            [
                (
                    effect.name.replace("_", " "), effect.symbol, effect.value, effect.std_error,
                    effect.unit, effect.evidence.p_value, ", ".join(effect.rivals) or "-",
                )
                for effect in told.effects
            ],
        )  # fmt: skip
    page.heading("Error on the hold-out drives")
    rows = (
        ("before", told.before, told.before_interval),
        ("after", told.after, told.after_interval),
    )
    page.table(
        ("", "rmse [W]", "mae [W]", "bias [W]", "energy error [%]"),
        [
            (
                name, *(_with_interval(residual, interval, key) for key in ("rmse", "mae", "bias")),
                _with_interval(residual, interval, "energy_error", 100.0),
            )
            for name, residual, interval in rows
        ],
    )  # fmt: skip
    page.paragraph("In brackets: 95 % intervals from resampled blocks of the drives.")
    for found in told.unexplained:
        page.paragraph(
            f"Unexplained: the residual depends on {found.channel} ({found.shape}); "
            f"{100 * found.explained_variance:.0f} % of its variance.",
            "flag",
        )
    for _, figure, caption in diagnosis_pictures(told, holdout):
        page.picture(figure, caption)
    if told.advice:
        page.heading("What to do next")
        page.bullets(told.advice)
    return page


def diagnosis_pictures(told: Diagnosis, holdout: Sequence[DriveLog]) -> Iterator[Picture]:
    """Yield the residual against the guilty channel, and power and energy, before and after."""
    if told.dependences_before:
        yield _guilty_channel(told, holdout)
    longest = int(np.argmax([log.duration for log in holdout]))
    log = holdout[longest]
    both = {
        "before": told.predictions_before[longest],
        "after": told.predictions_after[longest],
    }
    yield Picture(
        "power",
        plots.prediction(log, both, f"Hold-out drive {log.name}"),
        "Power and energy of a drive that was not fitted to, before and after.",
    )


def _guilty_channel(told: Diagnosis, holdout: Sequence[DriveLog]) -> Picture:
    channel = told.dependences_before[0].channel
    icr = told.model.vehicle.icr
    values = np.concatenate([signal(log.motion(icr), channel) for log in holdout])
    if channel == "yaw":
        values = wrap_angle(values)
    residuals = {
        label: np.concatenate(
            [log.power - power for log, power in zip(holdout, predicted, strict=True)]
        )
        for label, predicted in (
            ("before", told.predictions_before),
            ("after", told.predictions_after),
        )
    }
    figure = plots.figure(size=(8.0, 4.5))
    plots.residual_against(figure.axes[0], values, residuals, f"{channel} [{_unit(channel)}]")
    return Picture("residual", figure, "The residual against the channel that it depends on most.")


def mission_page(told: MissionReport) -> Page:
    """Return the report of a mission, flagged tasks first."""
    page = Page(f"Mission {told.mission.name}")
    flagged = [task for task in told.tasks if task.verdict == "unreachable"]
    page.paragraph(
        f"{len(told.tasks) - len(flagged)} of {len(told.tasks)} tasks can be done. It takes "
        f"{told.duration / 60:.0f} minutes and {number(told.energy / 3600)} Wh, at "
        f"{100 * told.mission.confidence:.0f} % confidence no more than "
        f"{number(told.energy_upper / 3600)} Wh, and ends at {told.end} with "
        f"{100 * told.soc_end:.0f} % of the battery's charge.",
        "lead",
    )
    for task in flagged:
        page.paragraph(f"{task.name} is out of reach: {task.detail} {task.remedy}", "flag")
    page.table(MISSION_HEADER, mission_rows(told))
    for _, figure, caption in mission_pictures(told):
        page.picture(figure, caption)
    return page


MISSION_HEADER = (
    "task", "verdict", "reason", "alone", "energy [Wh]", "at most [Wh]", "charge after", "remedy",
)  # fmt: skip
"""Header of `mission_rows`."""


def mission_rows(told: MissionReport) -> Iterator[Sequence[object]]:
    """Yield a row for each task, flagged ones first."""
    for task in map(told.task, told.table["name"]):
        yield (
            task.name, task.verdict, str(task.reason).replace("_", " "),
            "yes" if task.reachable_alone else "no", *(
                number(joules / 3600) if np.isfinite(joules) else "-"
                for joules in (task.energy, task.energy_upper)
            ),
            f"{100 * task.soc_after:.0f} %" if np.isfinite(task.soc_after) else "-",
            task.remedy or "-",
        )  # fmt: skip


def mission_pictures(told: MissionReport) -> Iterator[Picture]:
    """Yield the route on the map, coloured by power, and the state of charge over time."""
    yield Picture(
        "map", plots.mission_map(told), "The route, coloured by the power at the battery."
    )
    figure = plots.figure(size=(8.0, 4.0))
    plots.state_of_charge(figure.axes[0], told)
    yield Picture("charge", figure, "State of charge over the mission, with its band.")


def _unit(channel: str) -> str:
    derived = {"v": "m/s", "omega": "rad/s", "curvature": "1/m"}
    described = CHANNELS.get(channel, "")
    return derived.get(channel) or described.partition("[")[2].rstrip("]") or "its own unit"


def _names(told: Diagnosis) -> str:
    return " and ".join(effect.name.replace("_", " ") for effect in told.effects)


def _with_interval(residual: Residual, interval: object, key: str, scale: float = 1.0) -> str:
    low, high = getattr(interval, key)
    value = getattr(residual, key)
    return f"{number(scale * value, 3)} ({number(scale * low, 3)} to {number(scale * high, 3)})"
