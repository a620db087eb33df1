"""What the commands print for people: results as lines of text."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from energyplan.battery import BROWN_OUTS
from energyplan.html import clock, number, unit
from energyplan.output.documents import occupancy as shares
from energyplan.output.documents import terms

GREY = 0.01
"""Share of a map's pixels that may be unknown without a word."""

if TYPE_CHECKING:
    from energyplan.battery import BatteryRun
    from energyplan.diagnosis.design import Design
    from energyplan.errors import NoPathError
    from energyplan.fit import ICREstimate
    from energyplan.fit.identification import InternalFriction
    from energyplan.fit.tasks import TaskFit
    from energyplan.io.start import Start
    from energyplan.live import Event
    from energyplan.mission import MissionReport
    from energyplan.path import FloatArray
    from energyplan.power import PowerModel
    from energyplan.reach import Contour, EnergyMap
    from energyplan.terrain import OccupancyGrid


def hoisted(sides: Sequence[InternalFriction]) -> list[str]:
    """Return what ``energyplan identify --hoisted`` prints."""
    lines = []
    for side in sides:
        lines.append(
            f"friction inside the {side.side} side: {number(side.force)} +- "
            f"{number(side.force_error, 2)} N at {number(side.speed)} m/s, changing by "
            f"{number(side.slope)} +- {number(side.slope_error, 2)} N per m/s"
        )
        lines += [
            f"  {number(one.speed)} m/s: {number(one.force)} +- {number(one.std_error, 2)} N"
            for one in side.classes
        ]
        if side.left_out:
            lines.append(f"  {side.left_out} samples in the sensor's dead band: half of it used")
    return lines


def start(result: Start) -> list[str]:
    """Return what ``energyplan start`` prints."""
    project = result.project
    topics = {} if project.topics is None else project.topics.channels
    sources = {**project.columns, **{channel: many[0] for channel, many in topics.items()}}
    lines = [
        f"{channel}: {f'{one.topic} {one.written}'.strip()}"
        f"{f' [{one.unit}]' if one.unit and not one.field.endswith(f'[{one.unit}]') else ''}"
        for channel, one in sources.items()
    ]
    lines += [f"assumed {what}: {value}" for what, value in project.defaults.items()]
    for check in result.checks:
        lines.append(f"{'ok' if check.ok else 'WRONG'}: {check}")
    return [*lines, *(f"note: {note}" for note in result.notes)]


def occupancy(grid: OccupancyGrid) -> list[str]:
    """Return what ``energyplan start`` prints of the image of a map."""
    found = shares(grid)
    width, height = (number(side, 4) for side in found["size"])
    lines = [
        f"{found['columns']} x {found['rows']} pixels of {number(grid.resolution)} m: {width} x "
        f"{height} m; {100 * found['free']:.1f} % free, {100 * found['occupied']:.1f} % occupied, "
        f"{100 * found['unknown']:.1f} % unknown"
    ]
    if found["unknown"] > GREY:
        lines.append(
            "note: pixels between dark and bright are unknown, where the robot does not drive; "
            "paint them black or white, or move the thresholds in the YAML"
        )
    return lines


def tasks(found: TaskFit, history: Mapping[str, FloatArray]) -> list[str]:
    """Return what ``energyplan identify`` prints of a history of tasks."""
    model = found.model
    lines = [
        f"{one.name}: {one.symbol} = {number(value, 4)} +- {number(error, 2)} {one.unit}"
        for one, value, error in zip(model.terms, model.coefficients, found.errors, strict=True)
    ]
    lines.append(
        f"from {len(found.energies)} tasks of {number(np.nansum(history['distance']), 4)} m, whose "
        f"energies are missed by {100 * found.spread:.2g} %"
    )
    return [*lines, *(f"note: {one}" for one in found.warnings)]


def icr(found: ICREstimate) -> list[str]:
    """Return what ``energyplan identify --spin`` prints."""
    lines = [
        f"{name}: {number(getattr(found.icr, name), 4)} m +- {number(error, 2)}"
        for name, error in found.std_error.items()
    ]
    return [*lines, f"from {found.source}, {number(found.turning)} rad of turning"]


def event(result: Event) -> list[str]:
    """Return the line of an event of ``energyplan watch``."""
    from energyplan.live import Changed, Done, Learned, Reassessed, Trouble

    if isinstance(result, Trouble):
        often = f" ({result.count} times more)" if result.count > 1 else ""
        return [f"{result.place}: {result.reason}{often}"]
    if isinstance(result, Learned):
        factor = f"; {number(result.factor, 3)} times former runs" if result.factor != 1.0 else ""
        return [
            f"{result.t:.1f} s: {_coefficients(result.model)}; {result.samples} samples{factor}"
        ]
    if isinstance(result, Changed):
        return [
            f"{result.t:.1f} s: the ground changed about {result.onset:.1f} s (chi-squared "
            f"{number(result.statistic)}); it was {_coefficients(result.before)}"
        ]
    if isinstance(result, Done):
        return [f"{result.t:.1f} s: task {result.task} is done"]
    if isinstance(result, Reassessed):
        report = result.report
        said = "all tasks are done" if report is None else "; ".join(mission(report))
        rows = "".join(f"{name} driven for {far:.1f} m; " for name, far in result.driven.items())
        return [f"{result.t:.1f} s: charge {100 * result.soc:.1f} %; {rows}{said}"]
    aside = ", ".join(f"{count} x {reason}" for reason, count in result.set_aside.items())
    return [
        f"the end: {result.samples} samples, {result.changes} changes of ground"
        + (f"; reported: {aside}" if aside else "")
    ]


def _coefficients(model: PowerModel) -> str:
    return ", ".join(
        f"{row['symbol']} = {number(row['value'])}"
        + ("" if row["std_error"] is None else f" +- {number(row['std_error'], 2)}")
        + f" {unit(row['unit'])}".rstrip()
        for row in terms(model)
    )


def no_path(error: NoPathError) -> list[str]:
    """Return what ``energyplan plan`` prints where there is no path."""
    proven = error.certainty == "proven"
    return [f"{'there is no path' if proven else 'no path was found'}: {error}"]


def energy_map(found: EnergyMap, areas: Sequence[Contour]) -> list[str]:
    """Return what ``energyplan range`` prints."""
    way = "there" if found.back is None else "there and back"
    sure = "" if found.confidence is None else f" (at {100 * found.confidence:g} % confidence)"
    lines = [
        f"with {number(a.energy, 4)} J the robot gets {way} on {number(a.area.area)} m^2{sure}"
        for a in areas
    ]
    if not lines:
        lines = ["no place can be reached with this energy"]
    if math.isfinite(found.complete_to):
        lines.append(
            f"places that take more than {number(found.complete_to, 4)} J were not searched"
        )
    return lines


def battery(run: BatteryRun | None, which: str = "") -> list[str]:
    """Return what a drive does to a battery, in a line; no line without one."""
    if run is None:
        return []
    line = f"at most {number(run.peak_power)} W and {number(run.peak_current)} A"
    line += f", {100 * run.soc_end:.1f} % of charge left"
    if run.reason != "none":
        line += f"; it gives up at {number(run.brown_out)} s: {BROWN_OUTS[run.reason]}"
    return [f"battery{f', {which}' if which else ''}: {line}"]


def mission(report: MissionReport) -> list[str]:
    """Return what ``energyplan mission`` prints."""
    tables = [line for one in report.tables for line in one.text().splitlines()]
    why = () if report.robots else report.obstacles  # of several robots a table has them
    warnings = (f"warning: {warning}" for warning in report.warnings)
    compared = filter(None, (report.doubt, report.compared))
    return [report.sentence, *compared, *why, *warnings, *tables]


def failure(report: MissionReport, name: str, time: float) -> str:
    """Return when one of several robots fails, and what it has not done by then."""
    robot = report.robot(name)
    left = [task.name for task in robot.tasks if task.name not in robot.done_by(time)]
    undone = f"without having done {', '.join(left)}" if left else "with all its tasks done"
    return f"{name} fails at {clock(time)}, {undone}"


def design(result: Design) -> list[str]:
    """Return what ``energyplan design`` prints."""
    expected = [
        f"if it is {label}: {100 * value:.0f} % sure of it after the drive"
        for label, value in result.probabilities_expected
    ]
    return [f"{result.trajectory.duration:.0f} s: {result.sentence}", *expected]
