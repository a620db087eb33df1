"""The reports of the commands: which tables and pictures, in which order."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from matplotlib.figure import Figure

from energyplan.html import number
from energyplan.output import plots
from energyplan.output.report import Page
from energyplan.path import wrap_angle
from energyplan.power.empirical import signal, unit
from energyplan.studies.comparison import energy_along

if TYPE_CHECKING:
    from energyplan.diagnosis import Diagnosis
    from energyplan.logs import DriveLog
    from energyplan.mission import MissionReport
    from energyplan.physics import Loop
    from energyplan.planning import PlanningProblem
    from energyplan.power import PowerModel, Residual
    from energyplan.studies.comparison import Comparison
    from energyplan.terrain import SurfaceMap


class Picture(NamedTuple):
    """A figure with a short name for files and a caption for readers."""

    name: str
    figure: Figure
    caption: str


def _models(page: Page, model: PowerModel, surfaces: SurfaceMap | None) -> None:
    """Name the models of a page: the common one, and those of surfaces."""
    page.made_from(model=model)
    for surface in surfaces.surfaces if surfaces else ():
        page.made_from(model=surface.model)


def _illustrate(page: Page, pictures: Iterable[Picture]) -> None:
    for _, figure, caption in pictures:
        page.picture(figure, caption)


def diagnosis_page(told: Diagnosis, holdout: Sequence[DriveLog]) -> Page:
    """Return the report of a diagnosis; `holdout` are the drives that it was judged on."""
    page = Page("Diagnosis of a power model")
    page.made_from(model=told.model)
    before, after = (f"{number(one.rmse, 3)} W" for one in (told.before, told.after))
    page.paragraph(
        {
            "effect_found": f"The most probable cause of the residual is {_names(told)}, with a "
            f"probability of {_probability(told):.2f}. On drives that were not fitted to, the root "
            f"mean square error is {before} without it and {after} with it.",
            "no_effect": "No effect of the catalogue predicts these drives better than the paper's "
            "model alone.",
            "unexplained": "Part of the residual depends on a channel in a way that no effect of "
            "the catalogue explains.",
        }[told.verdict],
        "lead",
    )
    if told.effects:
        page.heading("Effects found, largest first")
        page.table(
            ("effect", "symbol", "value", "std. error", "unit", "probability", "or instead"),
            [
                (
                    effect.name.replace("_", " "), effect.symbol, effect.value, effect.std_error,
                    effect.unit, effect.probability, ", ".join(effect.rivals) or "-",
                )
                for effect in told.effects
            ],
        )  # fmt: skip
    if len(told.explanations) > 1:
        page.heading("Possible explanations")
        page.table(
            ("effects", "probability", "not told apart from"),
            [
                (
                    _together(one.effects),
                    f"{one.probability:.2f}" if one.probability >= 0.01 else "below 0.01",
                    "; ".join(_together(names) for names in one.alike) or "-",
                )
                for one in told.explanations
            ],
        )
    page.heading("Error on the hold-out drives")
    rows = (
        ("before", told.before, told.before_interval),
        ("after", told.after, told.after_interval),
    )
    page.table(
        ("model", "rmse [W]", "mae [W]", "bias [W]", "energy error [%]"),
        [
            (
                name, *(_with_interval(residual, interval, key) for key in ("rmse", "mae", "bias")),
                _with_interval(residual, interval, "energy_error", 100.0),
            )
            for name, residual, interval in rows
        ],
    )  # fmt: skip
    page.paragraph("In brackets: 95 % intervals from resampled blocks of the drives.")
    page.table(
        ("drive", "predicted energy [J]", "90 % interval [J]", "measured energy [J]"),
        [
            (
                one.drive, number(one.energy),
                f"{number(one.energy_interval[0])} to {number(one.energy_interval[1])}",
                number(one.measured),
            )
            for one in told.predictions
        ],
    )  # fmt: skip
    if told.set_aside:
        page.heading("Samples that were set aside")
        page.table(
            ("drive", "reason", "samples"),
            [
                (drive, reason, count)
                for drive, reasons in told.set_aside.items()
                for reason, count in reasons.items()
            ],
        )
    for found in told.unexplained:
        page.paragraph(
            f"Unexplained: the residual depends on {found.channel} ({found.shape}); "
            f"{100 * found.explained_variance:.0f} % of its variance.",
            "flag",
        )
    _illustrate(page, diagnosis_pictures(told, holdout))
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
    figure = plots.figure()
    plots.residual_against(figure.axes[0], values, residuals, f"{channel} [{unit(channel)}]")
    return Picture("residual", figure, "The residual against the channel that it depends on most.")


def comparison_page(made: Comparison, problem: PlanningProblem) -> Page:
    """Return the report of a comparison; `problem` is what was planned."""
    page = Page("Least energy against the shortest route")
    _models(page, problem.cost.model, problem.surfaces)
    best, shortest = made.energy_optimal, made.shortest
    page.paragraph(
        f"The route of least energy takes {number(best.energy)} J, the shortest one "
        f"{number(shortest.energy)} J: {100 * made.saving:.1f} % saved. No route takes less than "
        f"{number(best.lower_bound)} J.",
        "lead",
    )
    page.table(
        ("route", "energy [J]", "length [m]", "turning [deg]", "duration [s]"),
        [
            (label, plan.energy, plan.length, float(np.degrees(plan.turning)), plan.duration)
            for label, plan in (("least energy", best), ("shortest", shortest))
        ],
    )
    page.heading("Where the energy goes")
    page.table(
        ("term", "least energy [J]", "shortest [J]", "saved [J]"),
        [
            (
                name.replace("_", " "), best.breakdown.get(name, 0.0),
                shortest.breakdown.get(name, 0.0), saved,
            )
            for name, saved in made.by_term.items()
        ],
    )  # fmt: skip
    _illustrate(page, comparison_pictures(made, problem))
    return page


def comparison_pictures(made: Comparison, problem: PlanningProblem) -> Iterator[Picture]:
    """Yield both routes on the map, the energy along them, and their energy by term."""
    plans = {"least energy": made.energy_optimal, "shortest": made.shortest}
    paths = {label: plan.path for label, plan in plans.items()}
    areas = problem.surfaces.polygons if problem.surfaces else ()
    walls = plots.routes(problem.map, paths, surfaces=areas)
    if problem.heights is not None:
        problem.heights.contours(walls.axes[0])
    yield Picture("map", walls, "Both routes on the map.")
    figure = plots.figure()
    ax = figure.axes[0]
    for (label, path), (color, dash) in zip(
        paths.items(), ((plots.BLUE, "-"), (plots.RED, "--")), strict=True
    ):
        along = energy_along(path, problem)
        ax.plot(along.metres, along.joules, color=color, ls=dash, label=label)
    ax.set(xlabel="distance travelled [m]", ylabel="energy since the start [J]")
    plots.legend(ax, above=True)
    yield Picture(
        "energy", figure, "Energy along both routes; turns on the spot are upright steps."
    )
    figure = plots.figure(size=(plots.WIDTH, 2.0))
    plots.breakdown(figure.axes[0], {label: plan.breakdown for label, plan in plans.items()})
    yield Picture("terms", figure, "Energy of both routes by term of the model.")


def mission_page(told: MissionReport) -> Page:
    """Return the report of a mission, flagged tasks first."""
    page = Page(f"Mission {told.mission.name}")
    _models(page, told.mission.model, told.mission.surfaces)
    flagged = [task for task in told.tasks if task.verdict == "unreachable"]
    page.paragraph(
        f"{told.headline[0].upper()}{told.headline[1:]}. It takes "
        f"{told.duration / 60:.0f} minutes and {number(told.energy / 3600)} Wh, at "
        f"{100 * told.mission.confidence:.0f} % confidence no more than "
        f"{number(told.energy_upper / 3600)} Wh, and ends at {told.end} with "
        f"{100 * told.soc_end:.0f} % of the battery's charge.",
        "lead",
    )
    for task in flagged:
        remedy = f"; remedy: {task.remedy}" if task.remedy else ""
        page.paragraph(f"{task.name} is out of reach: {task.detail}{remedy}", "flag")
    for warning in told.warnings:
        page.paragraph(f"Warning: {warning}.", "flag")
    page.table(MISSION_HEADER, mission_rows(told))
    _illustrate(page, mission_pictures(told))
    return page


MISSION_HEADER = (
    "task", "verdict", "reason", "remedy", "energy [Wh]", "at most [Wh]", "charge after",
    "as the only task",
)  # fmt: skip
"""Header of `mission_rows`."""


def mission_rows(told: MissionReport) -> Iterator[Sequence[object]]:
    """Yield a row for each task, flagged ones first."""
    for task in map(told.task, told.table["name"]):
        yield (
            task.name, task.verdict, str(task.reason).replace("_", " "), task.remedy or "-", *(
                number(joules / 3600) if np.isfinite(joules) else "-"
                for joules in (task.energy, task.energy_upper)
            ),
            f"{100 * task.soc_after:.0f} %" if np.isfinite(task.soc_after) else "-",
            "reachable" if task.reachable_alone else "unreachable",
        )  # fmt: skip


def mission_pictures(told: MissionReport) -> Iterator[Picture]:
    """Yield the route on the map, coloured by power, and the state of charge over time."""
    yield Picture(
        "map", plots.mission_map(told), "The route, coloured by the power at the battery."
    )
    yield Picture(
        "charge",
        plots.mission_charge(told),
        "State of charge over the mission with its band, what the robot does, and the power at the "
        "battery.",
    )


def _probability(told: Diagnosis) -> float:
    """Probability of the explanation that is reported."""
    return told.explanations[0].probability


def _together(names: Sequence[str]) -> str:
    """Return effects that act together."""
    return " and ".join(name.replace("_", " ") for name in names) or "none"


def _names(told: Diagnosis) -> str:
    return " and ".join(effect.name.replace("_", " ") for effect in told.effects)


def _with_interval(residual: Residual, interval: object, key: str, scale: float = 1.0) -> str:
    low, high = getattr(interval, key)
    value = getattr(residual, key)
    return f"{number(scale * value, 3)} ({number(scale * low, 3)} to {number(scale * high, 3)})"


def loop_page(made: Loop, problem: PlanningProblem) -> Page:
    """Return the report of a closed loop; `problem` is what was planned."""
    page = Page("Plan, drive, learn, plan again")
    _models(page, problem.cost.model, problem.surfaces)
    first, last = made.rounds[0], made.rounds[-1]
    page.paragraph(
        f"The predicted energy was off by {100 * first.error:+.1f} % in the first round and by "
        f"{100 * last.error:+.1f} % in round {len(made.rounds)}. "
        f"The first drive took {number(first.energy_taken)} J, the last one "
        f"{number(last.energy_taken)} J.",
        "lead",
    )
    page.table(
        ("round", "predicted [J]", "95 % interval [J]", "measured [J]", "error", "length [m]",
         "found"),
        [
            (
                k, now.energy_told,
                " to ".join(number(v) for v in now.energy_interval or ()) or "-",
                now.energy_taken, f"{100 * now.error:+.1f} %", now.length,
                ", ".join(
                    f"{e.name.replace('_', ' ')} {number(e.value)} {e.unit}" for e in now.effects
                ) or now.note or "-",
            )
            for k, now in enumerate(made.rounds, 1)
        ],
    )  # fmt: skip
    paths = {f"round {k}": now.plan.path for k, now in enumerate(made.rounds, 1)}
    shown = dict(list(paths.items())[:1] + list(paths.items())[-1:])
    areas = problem.surfaces.polygons if problem.surfaces else ()
    page.picture(plots.routes(problem.map, shown, surfaces=areas), "The first and the last route.")
    for k, now in enumerate(made.rounds, 1):
        if now.driven is not None:
            page.heading(f"Round {k}: where the energy went")
            page.table(("term", "predicted [J]", "measured [J]"), now.driven.terms)
    return page
