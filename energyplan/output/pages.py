"""Reports: one self-contained HTML page each, readable on a phone and printable."""

from __future__ import annotations

import base64
import hashlib
import os
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from scipy.integrate import cumulative_trapezoid

from energyplan import __version__
from energyplan.errors import InvalidInputError
from energyplan.html import Cells, Summary, number, quantity, rendered, words
from energyplan.output import plots
from energyplan.output.plots.style import LINES, svg
from energyplan.path import wrap_angle
from energyplan.power.empirical import described, signal

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from energyplan.comparison import Comparison
    from energyplan.diagnosis import Diagnosis
    from energyplan.logs import DriveLog
    from energyplan.mission import MissionReport
    from energyplan.physics import Loop
    from energyplan.planning import PlanningProblem
    from energyplan.power import PowerModel
    from energyplan.terrain import SurfaceMap


@dataclass
class Page:
    """An HTML page that is built from top to bottom; its template escapes all text."""

    title: str  # title of the page
    _parts: list[tuple[str, Any]] = field(default_factory=list, repr=False)
    _results: list[tuple[str, str]] = field(default_factory=list, repr=False)
    _origin: dict[tuple[str, str], str] = field(default_factory=dict, repr=False)

    def heading(self, text: str) -> None:
        """Start a section."""
        self._parts.append(("heading", text))

    def paragraph(self, text: str, kind: str = "") -> None:
        """Add a paragraph; `kind` is ``""``, ``"lead"`` or ``"flag"`` (a warning)."""
        self._parts.append(("paragraph", (text, kind)))

    def results(self, results: Iterable[tuple[str, str]]) -> None:
        """Add the main results at the top of the page: a label and a value each."""
        self._results += results

    def bullets(self, lines: Iterable[str]) -> None:
        """Add a list."""
        self._parts.append(("bullets", list(lines)))

    def command(self, text: str) -> None:
        """Add a command line."""
        self._parts.append(("command", text))

    def table(self, header: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
        """Add a table; numbers are aligned to the right and shown with four digits."""
        self._parts.append(("table", Cells.of(header, rows)))

    def summaries(self, found: Iterable[Summary]) -> None:
        """Add titled rows: a section for each, with its notes below."""
        for one in found:
            self.heading(f"{one.title[:1].upper()}{one.title[1:]}")
            if rows := list(one.rows):
                self.table(one.header, rows)
            self.bullets(one.notes)

    def pictures(self, pictures: Iterable[Picture]) -> None:
        """Add figures with their captions."""
        for _, figure, caption in pictures:
            self.picture(figure, caption)

    def picture(self, figure: Figure, caption: str) -> None:
        """Add a figure, as vectors, with its caption."""
        self._parts.append(("picture", (base64.b64encode(svg(figure)).decode("ascii"), caption)))

    def made_from(
        self, *, call: str = "", files: Iterable[Path] = (), model: PowerModel | None = None
    ) -> None:
        """State at the end of the page what it was built from; may be called several times."""
        lines = {("Made by", call): ""} if call else {}
        if model is not None:
            robot = model.vehicle
            values = ", ".join(
                f"{words(term.name)} {quantity(value, None, term.unit)}"
                for term, value in zip(model.terms, model.coefficients.tolist(), strict=True)
            )
            track = f"slip track {number(robot.icr.slip_track)} m"
            lines["Vehicle", f"{robot.name}: {number(robot.mass)} kg, {track}"] = ""
            lines["Model", f"{model.name}: {values}"] = ""
        lines |= {("Read", str(file)): f"SHA-256 {_checksum(file)}" for file in files}
        self._origin = {**self._origin, **lines}

    def html(self) -> str:
        """Return the page; it loads nothing from elsewhere.

        The date is that of now, or of the environment variable ``SOURCE_DATE_EPOCH`` (seconds since
        1970), with which the same input gives the same bytes.
        """
        here = {("Date", _date()): "", ("Program", f"energyplan {__version__}"): ""}
        return rendered(
            "page.html", title=self.title, results=self._results, parts=self._parts,
            origin={**here, **self._origin},
        )  # fmt: skip


def _date() -> str:
    """Return the date of a page, in UTC."""
    given = os.environ.get("SOURCE_DATE_EPOCH")
    try:
        now = datetime.fromtimestamp(int(given), UTC) if given else datetime.now(UTC)
    except (ValueError, OverflowError, OSError):
        raise InvalidInputError(
            f"SOURCE_DATE_EPOCH is {given!r}; give whole seconds since 1970, or unset it"
        ) from None
    return f"{now:%Y-%m-%d %H:%M} UTC"


def _checksum(file: Path) -> str:
    """Return the SHA-256 checksum of a file."""
    try:
        with file.open("rb") as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()
    except OSError as problem:
        raise InvalidInputError(
            f"{str(file)!r} cannot be read for its checksum: {problem.strerror}"
        ) from None


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


def diagnosis_page(report: Diagnosis, holdout: Sequence[DriveLog]) -> Page:
    """Return the report of a diagnosis; `holdout` are the drives that it was judged on."""
    page = Page("Diagnosis of a power model")
    page.made_from(model=report.model)
    before, after = (f"{number(one.rmse, 3)} W" for one in (report.before, report.after))
    found = " and ".join(words(effect.name) for effect in report.effects) or "none"
    cause = (
        f"Of the known causes, {found} explains the residual best; more than noise is left, so "
        "that there may be another one."
        if report.no_probability is not None
        else f"The most probable cause of the residual is {found}, with a probability of "
        f"{report.chance(report.explanations[0].probability)}."
    )
    page.paragraph(
        {
            "effect_found": f"{cause} On drives that were not "
            f"fitted to, the root mean square error is {before} without it and {after} with it.",
            "no_effect": "No effect of the catalogue predicts these drives better than the paper's "
            "model alone.",
            "unexplained": "More is left than noise, and no effect of the catalogue explains it.",
        }[report.verdict],
        "lead",
    )
    page.pictures(diagnosis_pictures(report, holdout))
    page.summaries(report.tables)
    return page


def diagnosis_pictures(report: Diagnosis, holdout: Sequence[DriveLog]) -> Iterator[Picture]:
    """Yield the residual against the guilty channel, and power and energy, before and after."""
    if any(one.knots for one in report.dependences_before):
        yield _guilty_channel(report, holdout)
    longest = int(np.argmax([log.duration for log in holdout]))
    log = holdout[longest]
    both = {
        "before": report.predictions_before[longest],
        "after": report.predictions_after[longest],
    }
    yield Picture(
        "power",
        plots.prediction(log, both, f"Hold-out drive: {log.name}"),
        "Power and energy of a drive that was not fitted to, before and after.",
    )


def _guilty_channel(report: Diagnosis, holdout: Sequence[DriveLog]) -> Picture:
    # What has no knots is no channel of a log: drives as a whole, waves, forces of the model.
    channel = next(one.channel for one in report.dependences_before if one.knots)
    icr = report.model.vehicle.icr
    values = np.concatenate([signal(log.motion(icr), channel) for log in holdout])
    if channel == "yaw":
        values = wrap_angle(values)
    residuals = {
        label: np.concatenate(
            [log.power - power for log, power in zip(holdout, predicted, strict=True)]
        )
        for label, predicted in (
            ("before", report.predictions_before),
            ("after", report.predictions_after),
        )
    }
    figure = plots.figure()
    plots.residual_against(figure.axes[0], values, residuals, str(described(channel)))
    return Picture("residual", figure, "The residual against the channel that it depends on most.")


def comparison_page(result: Comparison, problem: PlanningProblem) -> Page:
    """Return the report of a comparison; `problem` is what was planned."""
    page = Page("Least energy against the shortest route")
    _models(page, problem.cost.model, problem.surfaces)
    least, most = result.spent
    page.paragraph(
        f"{'Driven with its stops, the' if result.driven else 'At steady speeds, the'} route of "
        f"least energy takes {number(least.energy)} J, the shortest one {number(most.energy)} J. "
        f"That saves {result.sentence}.",
        "lead",
    )
    page.pictures(comparison_pictures(result, problem))
    page.summaries(result.tables)
    return page


def comparison_pictures(result: Comparison, problem: PlanningProblem) -> Iterator[Picture]:
    """Yield both routes on the map, the energy along them, and their energy by term."""
    plans = {"least energy": result.energy_optimal, "shortest": result.shortest}
    yield Picture("map", plots.planned(problem, plots.priced(plans)), "Both routes on the map.")
    if result.driven:
        figure = plots.figure()
        ax = figure.axes[0]
        for (label, plan), (color, dash) in zip(plans.items(), LINES, strict=False):
            drive = plan.driven
            t, v = drive.trajectory.t, np.abs(drive.trajectory.v)
            metres = cumulative_trapezoid(v, t, initial=0)
            ax.plot(metres, drive.energy_since_start, color=color, ls=dash, label=label)
        ax.set(xlabel="distance travelled [m]", ylabel="energy since the start [J]")
        plots.legend(ax, above=True)
        yield Picture(
            "energy", figure, "Energy along both routes; turns on the spot are upright steps."
        )
    figure = plots.figure(size=(plots.WIDTH, 2.0))
    terms = dict(zip(plans, (spent.by_term for spent in result.spent), strict=True))
    plots.breakdown(figure.axes[0], terms)
    yield Picture("terms", figure, "Energy of both routes by term of the model.")


def mission_page(
    report: MissionReport, failure: str = "", after: MissionReport | None = None
) -> Page:
    """Return the report of a mission; `after` is what comes of it after a robot's failure."""
    page = Page(f"Mission: {report.mission.name}")
    _models(page, report.mission.model, report.mission.surfaces)
    _mission(page, report)
    if after is not None:
        page.heading(f"If {failure}")
        _mission(page, after, ", after the failure")
    return page


def _mission(page: Page, report: MissionReport, when: str = "") -> None:
    """Add what comes of a mission to its page, flagged tasks first."""
    end = "" if report.robots else f" It ends at {report.end}."
    page.paragraph(f"{report.sentence[0].upper()}{report.sentence[1:]}.{end}", "lead")
    for sentence in filter(None, (report.doubt, report.compared)):
        page.paragraph(f"{sentence[0].upper()}{sentence[1:]}.")
    for task in report.left_out:
        remedy = f"; remedy: {task.remedy}" if task.remedy else ""
        page.paragraph(f"{task.name} is out of reach: {task.detail}{remedy}", "flag")
    for warning in report.warnings:
        page.paragraph(f"Warning: {warning}.", "flag")
    if report.trip and report.tasks:
        page.pictures(mission_pictures(report))
    page.summaries(report.tables)
    for robot in report.robots:
        page.heading(f"{robot.mission.name}{when}")
        _mission(page, robot)


def mission_pictures(report: MissionReport) -> Iterator[Picture]:
    """Yield the route on the map, coloured by the state of charge, and the charge over time."""
    rows = any(task.path for task in report.mission.tasks)
    yield Picture(
        "map",
        plots.mission_map(report),
        "The route; its colour is the state of charge."
        + (" Wide bands are the paths of tasks." if rows else ""),
    )
    yield Picture(
        "charge",
        plots.mission_charge(report),
        "State of charge over the mission with its band, what the robot does, and the power at the "
        "battery.",
    )


def loop_page(result: Loop, problem: PlanningProblem) -> Page:
    """Return the report of a closed loop; `problem` is what was planned."""
    page = Page("Plan, drive, learn, plan again")
    _models(page, problem.cost.model, problem.surfaces)
    page.made_from(model=result.model)
    first, last = result.rounds[0], result.rounds[-1]
    later = f" and {_off(last.error)} it in round {len(result.rounds)}" if last is not first else ""
    page.paragraph(
        f"The predicted energy was {_off(first.error)} what was measured in the first "
        f"round{later}. "
        f"The first drive took {number(first.energy_measured)} J, the last one "
        f"{number(last.energy_measured)} J.",
        "lead",
    )
    page.pictures(loop_pictures(result, problem))
    page.summaries(result.tables)
    for k, now in enumerate(result.rounds, 1):
        if now.driven is not None:
            energy = now.driven.tables[0]
            page.summaries([energy._replace(title=f"Round {k}, {energy.title}")])
    return page


def _off(error: float) -> str:
    """Return how a prediction lies to what was measured."""
    return f"{100 * abs(error):.1f} % {'above' if error > 0 else 'below'}"


def loop_pictures(result: Loop, problem: PlanningProblem) -> Iterator[Picture]:
    """Yield predicted and measured energy by round, and the first and the last route."""
    yield Picture(
        "rounds",
        plots.rounds(result),
        "Predicted energy, with its 95 % interval, and measured energy.",
    )
    paths = {f"round {k}": now.plan.path for k, now in enumerate(result.rounds, 1)}
    shown = dict(list(paths.items())[:1] + list(paths.items())[-1:])
    yield Picture("routes", plots.planned(problem, shown), "The first and the last route.")
